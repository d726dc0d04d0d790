"""Surfaces with known geometry, reflectance, label and id.

A surface is one thing with one id; it may consist of many primitives (a box of six faces, a crown
of a thousand leaves). ``Scene`` puts surfaces side by side and casts rays. Lengths are metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab import charts
from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab.planes import across

PARALLELOGRAM, ELLIPSE, POLYGON, FRUSTUM, ELLIPSOID = range(5)
"""Kinds of primitives; ``scenes.Tree`` says what their nine shape numbers mean."""

CELL_MM = 10.0
"""Cells of the printed chart; a scanner sees their mean reflectance."""

BRIGHT, DARK = 0.8, 0.1


@dataclass(frozen=True, eq=False)
class Surface:
    """Primitives that share an id, a label and a way of reflecting.

    Made by the functions of this module (``rectangle``, ``cylinder``, ...), not by hand.

    Parameters
    ----------
    label : str
        What it is, in words of your choice: ``"wall"``, ``"lamp"``.
    kind, centre, shape, half : arrays, shapes (n,), (n, 3), (n, 9), (n, 3)
        Kind of each primitive, its centre, its shape numbers (``scenes.Tree``), the half
        extents of its box.
    outline, cells : arrays of int, shapes (n, 2), (n, 3)
        Where each primitive's edges begin and end in ``edges``; where its cells begin in
        ``reflectance``, and how many rows and columns of them there are.
    edges : array, shape (m, 4)
        Edges of the outline and the holes of a polygon, in its own plane.
    reflectance : array, shape (k,)
        Of all cells, between 0 and 1; one cell where a primitive is plain.

    Examples
    --------
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


def group(surfaces, *, label):
    """Return one surface, with one id, of several.

    Parameters
    ----------
    surfaces : iterable of Surface
        Lists of them may stand in it.
    label : str

    Returns
    -------
    Surface

    Examples
    --------
    >>> lamp = group([cylinder((0, 0, 0), (0, 0, 5), 0.1), ellipsoid((0, 0, 5), 0.3)], label="lamp")
    >>> len(lamp), lamp.label
    (2, 'lamp')
    """
    return Surface(label=label, **merged(list(flattened(surfaces))))


def rectangle(
    corner: ArrayLike,
    along: ArrayLike,
    up: ArrayLike,
    *,
    label: str = "wall",
    reflectance: ArrayLike = 0.5,
) -> Surface:
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
    u, v = _vector(along, "along") / 2, _vector(up, "up") / 2
    centre = _vector(corner, "corner") + u + v
    shape, half = _planar_shape(u, v), np.abs(u) + np.abs(v)
    return _surface(label, PARALLELOGRAM, centre, shape, half, reflectance)


def ground(
    height: float = 0.0,
    *,
    centre: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float] = (2000.0, 2000.0),
) -> Surface:
    """Return a level rectangle called ``"ground"``, of reflectance 0.2.

    Parameters
    ----------
    height : float
        Metres.
    centre, size : (float, float)
        Along x and y, metres.

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
    a, b = (check_positive(side, "size", unit="m") for side in size)
    low = (centre[0] - a / 2, centre[1] - b / 2, check_number(height, "height", unit="m"))
    return rectangle(low, (a, 0, 0), (0, b, 0), label="ground", reflectance=0.2)


def board(
    centre: ArrayLike,
    width: float,
    height: float,
    *,
    heading: float = 0.0,
    label: str = "board",
    reflectance: ArrayLike = 0.8,
) -> Surface:
    """Return a rectangular board that faces ``heading``.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    width, height : float
        Metres.
    heading : float
        Horizontal direction its front looks to, degrees clockwise from +y (north).
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
    sides = _board_sides(centre, width, height, heading)
    return rectangle(*sides, label=label, reflectance=reflectance)


def disc(centre, normal, radius):
    """Return a flat disc from its centre, its normal (of any length) and its radius in metres.

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
    normal = _vector(normal, "normal")
    if not normal.any():
        raise ValueError(f"Invalid normal {normal.tolist()}. Must be > 0 m long.")
    normal = normal / np.linalg.norm(normal)
    radius = check_positive(radius, "radius", unit="m")
    shape = _planar_shape(*radius * across(normal[None])[0])
    half = radius * np.sqrt(1 - normal**2)
    return _surface("board", ELLIPSE, _vector(centre, "centre"), shape, half, 0.5)


def polygon(
    vertices: ArrayLike,
    *,
    holes: Sequence[ArrayLike] = (),
    label: str = "wall",
    reflectance: float = 0.5,
) -> Surface:
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
    normal = _plane_normal(rings[0] - middle)
    u, v = across(normal[None])[0]
    off = max(np.abs((ring - middle) @ normal).max() for ring in rings)
    if off > 1e-6:
        raise ValueError(f"Invalid vertices, {off:.2g} m off one plane. Must be flat to 1e-6 m.")
    flat = [(ring - middle) @ np.array([u, v]).T for ring in rings]
    edges = np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in flat])
    reach = np.abs(flat[0]).max(axis=0)
    half = reach[0] * np.abs(u) + reach[1] * np.abs(v)
    shape = np.concatenate([u, v, normal])
    made = _surface(label, POLYGON, middle, shape, half, reflectance)
    return replace(made, edges=edges, outline=np.array([[0, len(edges)]]))


def cylinder(
    base: ArrayLike,
    top: ArrayLike,
    radius: float,
    *,
    top_radius: float | None = None,
    capped: bool = True,
    label: str = "post",
    reflectance: float = 0.5,
) -> Surface:
    """Return a round post, lamp or trunk, upright or tilted, tapering where ``top_radius`` says so.

    Parameters
    ----------
    base, top : array_like, shape (3,)
        Ends of the axis, metres.
    radius, top_radius : float
        At the base and at the top, metres; ``top_radius`` may be 0 (a cone).
    capped : bool
        Whether discs close the ends.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the radius is not above zero, ``top_radius`` is negative or the ends are one.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> cone = Scene([cylinder((0, 5, 0), (0, 5, 2), 1.0, top_radius=0.0)])
    >>> round(float(cone.cast([0, 0, 1], [[0, 1, 0]]).range_m[0]), 9)  # half way up
    4.5
    """
    base, top = _vector(base, "base"), _vector(top, "top")
    radius = check_positive(radius, "radius", unit="m")
    end = radius if top_radius is None else check_number(top_radius, "top_radius", low=0, unit="m")
    length = np.linalg.norm(top - base)
    if length == 0:
        raise ValueError(f"Invalid top {top.tolist()}. Must differ from the base.")
    axis = (top - base) / length
    shape = np.array([*axis, length / 2, (radius + end) / 2, (end - radius) / length, capped, 0, 0])
    half = np.abs(axis) * length / 2 + max(radius, end) * np.sqrt(np.maximum(1 - axis**2, 0))
    return _surface(label, FRUSTUM, (base + top) / 2, shape, half, reflectance)


def box(
    base: ArrayLike,
    size: ArrayLike,
    *,
    heading: float = 0.0,
    label: str = "car",
    reflectance: float = 0.4,
) -> Surface:
    """Return a box from the middle of its bottom.

    Parameters
    ----------
    base : array_like, shape (3,)
        Metres.
    size : array_like, shape (3,)
        Across, along its heading, and up, metres.
    heading : float
        Degrees clockwise from +y.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If a size is not above zero or the heading is not finite.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> car = Scene([box((0, 10, 0), (2, 4, 1.5))])
    >>> float(car.cast([0, 0, 1], [[0, 1, 0]]).range_m[0])
    8.0
    """
    base = _vector(base, "base")
    width, length, height = (check_positive(s, "size", unit="m") for s in size)
    h = np.radians(check_number(heading, "heading", unit="degrees"))
    a = width * np.array([np.cos(h), -np.sin(h), 0])
    b = length * np.array([np.sin(h), np.cos(h), 0])
    c = np.array([0, 0, height])
    low, high = base - a / 2 - b / 2, base + a / 2 + b / 2 + c
    faces = [(low, a, b), (low, b, c), (low, a, c), (high, -a, -b), (high, -b, -c), (high, -a, -c)]
    return group([rectangle(*face, reflectance=reflectance) for face in faces], label=label)


def ellipsoid(centre, radii):
    """Return a solid ellipsoid with axes along x, y, z.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    radii : float or array_like, shape (3,)
        Half axes, metres.

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If a half axis is not above zero.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> ball = Scene([ellipsoid((0, 5, 0), (1, 2, 1))])
    >>> round(float(ball.cast([0, 0, 0], [[0, 1, 0]]).range_m[0]), 9)
    3.0
    """
    centre, radii = _vector(centre, "centre"), _radii(radii)
    shape = np.diag(1 / radii).ravel()
    return _surface("sphere", ELLIPSOID, centre, shape, radii, 0.5)


def foliage(centre, radii, *, leaves, leaf_radius, seed, label="crown"):
    """Return a crown or shrub: flat round leaves, at random in an ellipsoid, turned at random.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    radii : float or array_like, shape (3,)
        Half axes along x, y, z, metres.
    leaves : int
        Number of leaves. A ray through the middle meets ``leaves * leaf_radius**2 * pi / 2 * 3 /
        (4 pi rx ry rz) * length`` of them on average.
    leaf_radius : float
        Metres.
    seed : int
    label : str

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If there are no leaves or a size is not above zero.

    Examples
    --------
    >>> crown = foliage((0, 0, 5), 2.0, leaves=500, leaf_radius=0.1, seed=1)
    >>> len(crown), bool((abs(crown.centre - [0, 0, 5]) <= 2).all())
    (500, True)
    """
    rng = np.random.default_rng(seed)
    n = check_count(leaves, "leaves")
    radius = check_positive(leaf_radius, "leaf_radius", unit="m")
    ball = _unit_rows(rng.standard_normal((n, 3))) * rng.random((n, 1)) ** (1 / 3)
    normal = _unit_rows(rng.standard_normal((n, 3)))
    dual = across(normal) / radius
    shape = np.concatenate([dual[:, 0], dual[:, 1], normal], axis=1)
    half = radius * np.sqrt(np.maximum(1 - normal**2, 0))
    points = _vector(centre, "centre") + ball * _radii(radii)
    return _surface(label, ELLIPSE, points, shape, half, 0.4)


def wall(
    corner: ArrayLike,
    along: ArrayLike,
    height: float,
    *,
    openings: Sequence[tuple[float, float, float, float]] = (),
    reveal: float = 0.2,
    label: str = "wall",
) -> list[Surface]:
    """Return a wall with openings, their reveals and the panes behind them.

    Parameters
    ----------
    corner : array_like, shape (3,)
        A lower corner, metres.
    along : array_like, shape (3,)
        The lower edge from there, level, metres; it runs to the left as one looks at the front.
    height : float
        Metres.
    openings : list of (float, float, float, float)
        Distance along, height above the lower edge, width and height of each, metres; beside each
        other.
    reveal : float
        Depth from the wall to the panes, metres; 0 for a flat front.
    label : str
        Of the wall; the others are called ``"reveal"`` and ``"pane"``. Wall and reveals have a
        reflectance of 0.5, panes of 0.1.

    Returns
    -------
    list of Surface
        The wall, all reveals, all panes.

    Raises
    ------
    ValueError
        If an opening does not lie within the wall or two are not beside each other.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> front = Scene(wall((5, 0, 0), (0, 9, 0), 6, openings=[(4, 1, 1, 2)]))
    >>> hits = front.cast([[0, 4.5, 2], [0, 7, 2]], [[1, 0, 0]] * 2)
    >>> [front.surfaces[k].label for k in hits.surface], hits.range_m.round(6).tolist()
    (['pane', 'wall'], [5.2, 5.0])
    """
    corner, along = _vector(corner, "corner"), _vector(along, "along")
    height = check_positive(height, "height", unit="m")
    length = np.linalg.norm(along)
    level, upward = along / length, np.array([0.0, 0.0, 1.0])
    inward = check_number(reveal, "reveal", low=0, unit="m") * np.cross(level, upward)
    front, reveals, panes, end = [], [], [], 0.0
    for s, z, width, rise in sorted(openings):
        if min(s - end, z, width, rise) <= 0 or s + width >= length or z + rise >= height:
            raise ValueError(
                f"Invalid opening {s, z, width, rise}. Must lie beside the others "
                f"within {length:.3f} m x {height} m of wall."
            )
        low, side, up = corner + s * level + z * upward, width * level, rise * upward
        lintel = height - z - rise
        front.append(rectangle(corner + end * level, (s - end) * level, height * upward))
        front.append(rectangle(low - z * upward, side, z * upward))
        front.append(rectangle(low + up, side, lintel * upward))
        starts = [(low, side), (low + up, side), (low, up), (low + side, up)] if reveal else []
        reveals += [rectangle(start, edge, inward) for start, edge in starts]
        panes.append(rectangle(low + inward, side, up, reflectance=0.1))
        end = s + width
    front.append(rectangle(corner + end * level, (length - end) * level, height * upward))
    parts = {label: front, "reveal": reveals, "pane": panes}
    return [group(part, label=name) for name, part in parts.items() if part]


def kerb(line, height=0.12, *, label="kerb"):
    """Return the upright faces of a kerb along a line: a surface for each of its stretches.

    Parameters
    ----------
    line : array_like, shape (n, 3)
        Points at the foot of the kerb, two or more, metres.
    height : float
        Metres.
    label : str

    Returns
    -------
    list of Surface

    Raises
    ------
    ValueError
        If there are fewer than two points, two in a row are the same, or the height is not > 0.

    Examples
    --------
    >>> len(kerb([(4, 0, 0), (4, 20, 0), (3, 22, 0)]))
    2
    """
    line = check_points(line, name="line", minimum=2)
    up = (0, 0, check_positive(height, "height", unit="m"))
    look = {"label": label, "reflectance": 0.4}
    return [rectangle(start, end - start, up, **look) for start, end in pairwise(line)]


def chart(centre: ArrayLike, *, heading: float, layout: charts.Layout | None = None) -> Surface:
    """Return the point chart as it is printed, as a surface that scanners and cameras see.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    heading : float
        Where its front looks to, degrees clockwise from +y.
    layout : Layout, optional
        What is printed; by default :func:`mmqa_lab.charts.point_chart`.

    Returns
    -------
    Surface
        With the mean reflectance of each cell of 10 mm; 0.8 is white and 0.1 black.

    References
    ----------
    Pfeifer et al. 2021, section 3.3 (doi:10.3390/rs13020237); the random cells are this package's.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> there = Scene([chart((5, 0, 1), heading=-90)])
    >>> corners = [[0, 0.35, 0.65], [0, -0.35, 0.65]]  # the plain squares below, left and right
    >>> there.cast(corners, [[1, 0, 0]] * 2).reflectance.round(6).tolist()
    [0.1, 0.8]
    """
    layout = charts.point_chart() if layout is None else layout
    tones = charts.reflectance(layout, cell=CELL_MM).astype(np.float64)
    size = layout.width / 1000, layout.height / 1000
    pattern = DARK + (BRIGHT - DARK) * tones
    return board(centre, *size, heading=heading, label="chart", reflectance=pattern)


def chart_corners(centre: ArrayLike, *, heading: float) -> np.ndarray:
    """Return the corners of a chart of 1 m, from the lower left around, as one looks at its front.

    Parameters
    ----------
    centre, heading
        See :func:`chart`.

    Returns
    -------
    array, shape (4, 3)
        Metres.

    Raises
    ------
    ValueError
        If the heading is not finite.

    Examples
    --------
    >>> chart_corners((5, 0, 1), heading=-90)[0].round(9).tolist()
    [5.0, 0.5, 0.5]
    """
    low, along, up = _board_sides(centre, 1.0, 1.0, heading)
    return np.array([low, low + along, low + along + up, low + up])


def _surface(label, kind, centre, shape, half, reflectance):
    """A surface of primitives of one kind that share their cells."""
    centre, shape, half = (np.atleast_2d(np.asarray(a, np.float64)) for a in (centre, shape, half))
    cells = np.atleast_2d(np.asarray(reflectance, dtype=np.float64))
    if not ((cells >= 0) & (cells <= 1)).all():
        raise ValueError(f"Invalid reflectance {reflectance}. Must be between 0 and 1.")
    n = len(centre)
    kinds, outline = np.full(n, kind, np.int8), np.zeros((n, 2), np.int64)
    places = np.tile([0, *cells.shape], (n, 1))
    no_edges = np.zeros((0, 4))
    return Surface(label, kinds, centre, shape, half, outline, places, no_edges, cells.ravel())


def merged(surfaces):
    """The arrays of several surfaces as one, with their places in the shared ones shifted."""
    names = ("kind", "centre", "shape", "half", "edges", "reflectance")
    arrays = {name: np.concatenate([getattr(s, name) for s in surfaces]) for name in names}
    edge = np.cumsum([0, *(len(s.edges) for s in surfaces)])
    cell = np.cumsum([0, *(len(s.reflectance) for s in surfaces)])
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


def _vector(values, name):
    """Three finite numbers as float64."""
    return check_points(np.atleast_2d(values), name=name)[0]


def _radii(values):
    """Three half axes above zero."""
    values = np.broadcast_to(values, 3).astype(float)
    return np.array([check_positive(radius, "radii", unit="m") for radius in values.tolist()])


def _board_sides(centre, width, height, heading):
    """Lower left corner of a board as one looks at its front, and the sides from there."""
    h = np.radians(check_number(heading, "heading"))
    along = check_positive(width, "width", unit="m") * np.array([-np.cos(h), np.sin(h), 0])
    up = np.array([0.0, 0.0, check_positive(height, "height", unit="m")])
    return _vector(centre, "centre") - along / 2 - up / 2, along, up


def _unit_rows(vectors):
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


def _plane_normal(ring):
    """Unit normal (Newell) of a closed outline."""
    normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    if np.linalg.norm(normal) <= 1e-12 * np.abs(ring).max() ** 2:
        raise ValueError("Invalid vertices on one line. Must span a plane.")
    return normal / np.linalg.norm(normal)
