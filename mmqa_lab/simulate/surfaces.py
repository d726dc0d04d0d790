"""Surfaces with known geometry, reflectance, label and id.

A surface is one thing with one id; it may consist of many primitives (a box of six faces, a crown
of a thousand leaves). ``Scene`` holds surfaces and casts rays.
"""

from dataclasses import dataclass, replace

import numpy as np

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.simulate import tree


@dataclass(frozen=True, eq=False)
class Surface:
    """Primitives that share an id, a label and a way of reflecting.

    Made by the functions of this room (``rectangle``, ``cylinder``, ...), not by hand.

    Parameters
    ----------
    label : str
        What it is, in words of your choice: ``"wall"``, ``"lamp"``.
    kind, centre, shape, half : arrays, shapes (n,), (n, 3), (n, 9), (n, 3)
        Kind of each primitive, its centre in metres, its shape numbers (``tree.Tree``), the
        half extents of its box.
    outline, cells : arrays of int, shapes (n, 2), (n, 3)
        Where each primitive's edges begin and end in ``edges``; where its cells begin in
        ``reflectance``, and how many rows and columns of them there are.
    edges : array, shape (m, 4)
        Edges of the outline and the holes of a polygon, in its own plane.
    reflectance : array, shape (k,)
        Of all cells, between 0 and 1; one cell where a primitive is plain.

    Examples
    --------
    >>> from mmqa_lab.simulate import box
    >>> car = box((0, 0, 0), (1.8, 4.2, 1.5))
    >>> len(car), car.label, car.centre[:, 2].max().item()  # six faces
    (6, 'car', 1.5)
    """

    label: str
    kind: np.ndarray
    centre: np.ndarray
    shape: np.ndarray
    half: np.ndarray
    outline: np.ndarray
    cells: np.ndarray
    edges: np.ndarray
    reflectance: np.ndarray

    def __len__(self):
        return len(self.kind)


def rectangle(corner, along, up, *, label="wall", reflectance=0.5):
    """Return a rectangle or parallelogram from a corner and the two sides that leave it.

    Parameters
    ----------
    corner, along, up : array_like, shape (3,)
        Metres.
    label : str
    reflectance : float or array_like, shape (rows, columns)
        Of the whole, or of cells: rows from the corner upwards, columns along.

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the sides are parallel or a reflectance lies outside 0 to 1.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> halves = Scene([rectangle((0, 5, 0), (2, 0, 0), (0, 0, 1), reflectance=[[0.1, 0.9]])])
    >>> halves.cast([[0.5, 0, 0.5], [1.5, 0, 0.5]], [[0, 1, 0]] * 2).reflectance.tolist()
    [0.1, 0.9]
    """
    corner, along, up = (
        vector(v, n) for v, n in ((corner, "corner"), (along, "along"), (up, "up"))
    )
    u, v = along / 2, up / 2
    shape = _planar_shape(u, v)
    half = np.abs(u) + np.abs(v)
    return primitives(
        label, tree.PARALLELOGRAM, corner + u + v, shape, half, reflectance=reflectance
    )


def ground(
    height=0.0, *, centre=(0.0, 0.0), size=(2000.0, 2000.0), label="ground", reflectance=0.2
):
    """Return a level rectangle: ``height``, ``centre`` (x, y) and ``size`` (x, y) in metres.

    Parameters
    ----------
    height : float
        Metres.
    centre, size : (float, float)
        Along x and y, metres.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the height is not finite or a size is not above zero.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> flat = Scene([ground(-0.5)])
    >>> float(flat.cast([0, 0, 2], [[0, 0, -1]]).range_m[0])
    2.5
    """
    height = check_number(height, "height", unit="m")
    a, b = check_positive(size[0], "size", unit="m"), check_positive(size[1], "size", unit="m")
    corner = (centre[0] - a / 2, centre[1] - b / 2, height)
    return rectangle(corner, (a, 0, 0), (0, b, 0), label=label, reflectance=reflectance)


def polygon(vertices, *, holes=(), label="wall", reflectance=0.5):
    """Return a flat polygon with holes.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        The outline in order, metres, closed by itself; convex or not.
    holes : list of array_like, shape (m, 3)
        Outlines of holes in the same plane.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If there are fewer than three vertices, on a line, or off one plane by more than 1e-6 m.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> square, hole = np.array([[0, 5, 0], [4, 5, 0], [4, 5, 4], [0, 5, 4.0]]), [1, 0, 1]
    >>> front = Scene([polygon(square, holes=[square / [2, 1, 2] + hole])])
    >>> front.cast([[2, 0, 2], [0.5, 0, 2]], [[0, 1, 0]] * 2).surface.tolist()
    [-1, 0]
    """
    rings = [check_points(ring, name="vertices", minimum=3) for ring in (vertices, *holes)]
    middle = rings[0].mean(axis=0)
    u, v, normal = _plane_axes(rings[0] - middle)
    off = max(np.abs((ring - middle) @ normal).max() for ring in rings)
    if off > 1e-6:
        raise ValueError(f"Invalid vertices, {off:.2g} m off one plane. Must be flat to 1e-6 m.")
    flat = [(ring - middle) @ np.array([u, v]).T for ring in rings]
    edges = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in flat])
    reach = np.abs(flat[0]).max(axis=0)
    half = reach[0] * np.abs(u) + reach[1] * np.abs(v)
    shape = np.concatenate([u, v, normal])
    made = primitives(label, tree.POLYGON, middle, shape, half, reflectance=reflectance)
    return replace(made, edges=edges, outline=np.array([[0, len(edges)]]))


def disc(centre, normal, radius, *, label="board", reflectance=0.5):
    """Return a flat disc from its centre, its normal (any length) and its radius in metres.

    Parameters
    ----------
    centre, normal : array_like, shape (3,)
        Metres; the normal of any length.
    radius : float
        Metres.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the radius or the normal's length is not above zero.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> sign = Scene([disc((0, 5, 2), (0, -1, 0), 0.3)])
    >>> sign.cast([[0.29, 0, 2], [0.31, 0, 2]], [[0, 1, 0]] * 2).surface.tolist()
    [0, -1]
    """
    centre, normal = vector(centre, "centre"), _unit(normal, "normal")
    radius = check_positive(radius, "radius", unit="m")
    u, v = radius * perpendicular(normal[None])[0]
    half = radius * np.sqrt(1 - normal**2)
    return primitives(
        label, tree.ELLIPSE, centre, _planar_shape(u, v), half, reflectance=reflectance
    )


def board(centre, width, height, *, heading=0.0, lean=0.0, label="board", reflectance=0.8):
    """Return a rectangular board that faces ``heading``.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    width, height : float
        Metres.
    heading : float
        Horizontal direction its front looks to, degrees clockwise from +y (north).
    lean : float
        Degrees by which its front looks up.
    label : str
    reflectance : float or array_like, shape (rows, columns)
        Rows from the bottom up, columns from left to right as one looks at the front.

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If a size is not above zero or an angle is not finite.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> sign = Scene([board((0, 5, 2), 1, 1, heading=180)])
    >>> float(sign.cast([0, 0, 2], [[0, 1, 0]]).range_m[0])
    5.0
    """
    centre = vector(centre, "centre")
    h, t = np.radians([check_number(heading, "heading"), check_number(lean, "lean")])
    along = check_positive(width, "width", unit="m") * np.array([-np.cos(h), np.sin(h), 0])
    rise = np.array([-np.sin(h) * np.sin(t), -np.cos(h) * np.sin(t), np.cos(t)])
    up = check_positive(height, "height", unit="m") * rise
    corner = centre - along / 2 - up / 2
    return rectangle(corner, along, up, label=label, reflectance=reflectance)


def group(surfaces, *, label):
    """Return one surface, with one id, of several.

    Parameters
    ----------
    surfaces : iterable of Surface
        May hold lists of them.
    label : str

    Returns
    -------
    Surface

    Examples
    --------
    >>> from mmqa_lab.simulate import cylinder, ellipsoid
    >>> lamp = group([cylinder((0, 0, 0), (0, 0, 5), 0.1), ellipsoid((0, 0, 5), 0.3)], label="lamp")
    >>> len(lamp), lamp.label
    (2, 'lamp')
    """
    surfaces = list(flattened(surfaces))
    return Surface(label=label, **merged(surfaces))


def primitives(label, kind, centre, shape, half, *, reflectance):
    """A surface of primitives of one kind that share their cells."""
    centre, shape, half = (np.atleast_2d(np.asarray(a, np.float64)) for a in (centre, shape, half))
    cells = np.atleast_2d(np.asarray(reflectance, dtype=np.float64))
    if not ((cells >= 0) & (cells <= 1)).all():
        raise ValueError(f"Invalid reflectance {reflectance}. Must be between 0 and 1.")
    n = len(centre)
    return Surface(
        label=label,
        kind=np.full(n, kind, np.int8),
        centre=centre,
        shape=shape,
        half=half,
        outline=np.zeros((n, 2), np.int64),
        cells=np.tile([0, *cells.shape], (n, 1)),
        edges=np.zeros((0, 4)),
        reflectance=cells.ravel(),
    )


def merged(surfaces):
    """The arrays of several surfaces as one, with their places in the shared ones shifted."""
    edge = np.cumsum([0, *(len(s.edges) for s in surfaces)])
    cell = np.cumsum([0, *(len(s.reflectance) for s in surfaces)])
    names = ("kind", "centre", "shape", "half", "edges", "reflectance")
    arrays = {name: np.concatenate([getattr(s, name) for s in surfaces]) for name in names}
    outline = [s.outline + first for s, first in zip(surfaces, edge, strict=False)]
    cells = [s.cells + [first, 0, 0] for s, first in zip(surfaces, cell, strict=False)]
    return arrays | {"outline": np.concatenate(outline), "cells": np.concatenate(cells)}


def flattened(surfaces):
    """Surfaces out of nested lists."""
    for item in surfaces:
        if isinstance(item, Surface):
            yield item
        elif isinstance(item, str | bytes) or not hasattr(item, "__iter__"):
            raise TypeError(f"Invalid surface {item!r}. Must be a Surface or a list of them.")
        else:
            yield from flattened(item)


def vector(values, name):
    """Three finite numbers as float64."""
    return check_points(np.atleast_2d(values), name=name)[0]


def _unit(values, name):
    """A vector of length one."""
    direction = vector(values, name)
    length = np.linalg.norm(direction)
    if length == 0:
        raise ValueError(f"Invalid {name} {direction.tolist()}. Must be > 0 m long.")
    return direction / length


def unit_rows(vectors):
    """Rows of length one."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _planar_shape(u, v):
    """Dual vectors and normal of the half sides ``u`` and ``v``."""
    normal = np.cross(u, v)
    area = np.linalg.norm(normal)
    if area <= 1e-12 * np.linalg.norm(u) * np.linalg.norm(v):
        raise ValueError(f"Invalid sides {2 * u} and {2 * v}. Must not be parallel or zero.")
    normal = normal / area
    return np.concatenate([np.cross(v, normal) / area, np.cross(normal, u) / area, normal])


def perpendicular(normal):
    """Two unit vectors, shape (n, 2, 3), square to unit normals and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    u = unit_rows(np.cross(normal, helper))
    return np.stack([u, np.cross(normal, u)], axis=1)


def _plane_axes(ring):
    """In-plane unit axes and the normal (Newell) of a closed outline."""
    normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    if np.linalg.norm(normal) <= 1e-12 * np.abs(ring).max() ** 2:
        raise ValueError("Invalid vertices on one line. Must span a plane.")
    normal = normal / np.linalg.norm(normal)
    u, v = perpendicular(normal[None])[0]
    return u, v, normal
