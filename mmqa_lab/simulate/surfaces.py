"""Surfaces with known geometry, reflectance, label and id: rectangles, discs, round shafts.

A surface is one thing with one id; it may consist of many primitives (a box of six faces, a crown
of a thousand leaves). ``Scene`` puts surfaces side by side and casts rays. Lengths are metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count, check_number, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.simulate.primitives import (
    DISC,
    RECTANGLE,
    SHAFT,
    Surface,
    discs,
    group,
    planar_shape,
    surface,
    vector,
)

__all__ = [
    "DISC", "SHAFT", "Surface", "board", "box", "chart_corners", "cylinder", "disc", "foliage",
    "ground", "group", "rectangle", "wall",
]  # fmt: skip


def rectangle(
    corner: ArrayLike,
    along: ArrayLike,
    up: ArrayLike,
    *,
    label: str = "wall",
    reflectance: float = 0.5,
) -> Surface:
    """Return a rectangle or parallelogram from a corner and the two sides that leave it.

    Parameters
    ----------
    corner, along, up : array_like, shape (3,)
        Metres.
    label : str
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If the sides are parallel or the reflectance lies outside 0 to 1.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> wall = Scene([rectangle((0, 5, 0), (2, 0, 0), (0, 0, 1))])
    >>> wall.cast([[1.9, 0, 0.5], [2.1, 0, 0.5]], [[0, 1, 0]] * 2).range_m.tolist()
    [5.0, nan]
    """
    u, v = vector(along, "along") / 2, vector(up, "up") / 2
    centre, half = vector(corner, "corner") + u + v, np.abs(u) + np.abs(v)
    return surface(label, RECTANGLE, centre, planar_shape(u, v), half, reflectance)


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

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> flat = Scene([ground(-0.5)])
    >>> float(flat.cast([0, 0, 2], [[0, 0, -1]]).range_m[0])
    2.5
    """
    a, b = size
    low = centre[0] - a / 2, centre[1] - b / 2, height
    return rectangle(low, (a, 0, 0), (0, b, 0), label="ground", reflectance=0.2)


def board(
    centre: ArrayLike,
    width: float,
    height: float,
    *,
    heading: float = 0.0,
    label: str = "board",
    reflectance: float = 0.8,
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
    reflectance : float

    Returns
    -------
    Surface

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> sign = Scene([board((0, 5, 2), 1, 1, heading=180)])
    >>> float(sign.cast([0, 0, 2], [[0, 1, 0]]).range_m[0])
    5.0
    """
    sides = _board_sides(centre, width, height, heading)
    return rectangle(*sides, label=label, reflectance=reflectance)


def disc(centre: ArrayLike, normal: ArrayLike, radius: float) -> Surface:
    """Return a flat disc from its centre, its normal (of any length) and its radius in metres.

    Returns
    -------
    Surface

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> sign = Scene([disc((0, 5, 2), (0, -1, 0), 0.3)])
    >>> sign.cast([[0.29, 0, 2], [0.31, 0, 2]], [[0, 1, 0]] * 2).surface.tolist()
    [0, -1]
    """
    return discs("board", centre, vector(normal, "normal")[None], radius, 0.5)


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
        If the radius is not above zero, ``top_radius`` is negative or both ends are the same.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> cone = Scene([cylinder((0, 5, 0), (0, 5, 2), 1.0, top_radius=0.0)])
    >>> round(float(cone.cast([0, 0, 1], [[0, 1, 0]]).range_m[0]), 9)  # half way up
    4.5
    """
    base, top = vector(base, "base"), vector(top, "top")
    check_positive(radius, "radius", unit="m")
    end = radius if top_radius is None else check_number(top_radius, "top_radius", low=0, unit="m")
    length = np.linalg.norm(top - base)
    if length == 0:
        raise ValueError(f"Invalid top {top.tolist()}. Must differ from the base.")
    axis = (top - base) / length
    shape = np.array([*axis, length / 2, (radius + end) / 2, (end - radius) / length, capped, 0, 0])
    half = np.abs(axis) * length / 2 + max(radius, end) * np.sqrt(np.maximum(1 - axis**2, 0))
    return surface(label, SHAFT, (base + top) / 2, shape, half, reflectance)


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

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> car = Scene([box((0, 10, 0), (2, 4, 1.5))])
    >>> float(car.cast([0, 0, 1], [[0, 1, 0]]).range_m[0])
    8.0
    """
    base = vector(base, "base")
    width, length, height = np.asarray(size, dtype=np.float64)
    h = np.radians(heading)
    a = width * np.array([np.cos(h), -np.sin(h), 0])
    b = length * np.array([np.sin(h), np.cos(h), 0])
    c = np.array([0, 0, height])
    low, high = base - a / 2 - b / 2, base + a / 2 + b / 2 + c
    faces = [(low, a, b), (low, b, c), (low, a, c), (high, -a, -b), (high, -b, -c), (high, -a, -c)]
    return group([rectangle(*face, reflectance=reflectance) for face in faces], label=label)


def foliage(
    centre: ArrayLike,
    radii: ArrayLike,
    *,
    leaves: int,
    leaf_radius: float,
    seed: int,
    label: str = "crown",
) -> Surface:
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

    Examples
    --------
    >>> crown = foliage((0, 0, 5), 2.0, leaves=500, leaf_radius=0.1, seed=1)
    >>> len(crown), bool((abs(crown.centre - [0, 0, 5]) <= 2).all())
    (500, True)
    """
    rng = stream(seed, "foliage")
    n = check_count(leaves, "leaves")
    way, places = rng.standard_normal((n, 3)), rng.random((n, 1)) ** (1 / 3)
    ball = places * way / np.linalg.norm(way, axis=1, keepdims=True)
    normals = rng.standard_normal((n, 3))
    return discs(label, np.asarray(centre) + ball * np.asarray(radii), normals, leaf_radius, 0.4)


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
    corner, along = vector(corner, "corner"), vector(along, "along")
    height = check_positive(height, "height", unit="m")
    length = np.linalg.norm(along)
    level, upward = along / length, np.array([0.0, 0.0, 1.0])
    inward = check_number(reveal, "reveal", low=0, unit="m") * np.cross(level, upward)
    front, reveals, panes, end = [], [], [], 0.0
    for s, z, width, rise in sorted(openings):
        if min(s - end, z, width, rise) <= 0 or s + width >= length or z + rise >= height:
            raise ValueError(
                f"Invalid opening {s, z, width, rise}. Must lie within {length:.3f} m x {height} m "
                f"of wall, beside the others."
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


def chart_corners(centre: ArrayLike, *, heading: float) -> np.ndarray:
    """Return the corners of a chart of 1 m, from the lower left around, as one looks at its front.

    Parameters
    ----------
    centre, heading
        See :func:`board`.

    Returns
    -------
    array, shape (4, 3)
        Metres.

    Examples
    --------
    >>> chart_corners((5, 0, 1), heading=-90)[0].round(9).tolist()
    [5.0, 0.5, 0.5]
    """
    low, along, up = _board_sides(centre, 1.0, 1.0, heading)
    return np.array([low, low + along, low + along + up, low + up])


def _board_sides(centre, width, height, heading):
    """Lower left corner of a board as one looks at its front, and the sides from there."""
    h = np.radians(check_number(heading, "heading"))
    along, up = width * np.array([-np.cos(h), np.sin(h), 0]), np.array([0.0, 0.0, height])
    return vector(centre, "centre") - along / 2 - up / 2, along, up
