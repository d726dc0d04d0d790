"""Bodies to scan: posts, cars, spheres, crowns of trees."""

import numpy as np

from mmqa_lab._checks import check_count, check_number, check_positive
from mmqa_lab.simulate import tree
from mmqa_lab.simulate.surfaces import (
    group,
    perpendicular,
    primitives,
    rectangle,
    unit_rows,
    vector,
)


def cylinder(base, top, radius, *, top_radius=None, capped=True, label="post", reflectance=0.5):
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
    base, top = vector(base, "base"), vector(top, "top")
    radius = check_positive(radius, "radius", unit="m")
    end = radius if top_radius is None else check_number(top_radius, "top_radius", low=0, unit="m")
    length = np.linalg.norm(top - base)
    if length == 0:
        raise ValueError(f"Invalid top {top.tolist()}. Must differ from the base.")
    axis = (top - base) / length
    shape = np.array([*axis, length / 2, (radius + end) / 2, (end - radius) / length, capped, 0, 0])
    half = np.abs(axis) * length / 2 + max(radius, end) * np.sqrt(np.maximum(1 - axis**2, 0))
    return primitives(label, tree.FRUSTUM, (base + top) / 2, shape, half, reflectance=reflectance)


def box(base, size, *, heading=0.0, label="car", reflectance=0.4):
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
    base = vector(base, "base")
    width, length, height = (check_positive(s, "size", unit="m") for s in size)
    h = np.radians(check_number(heading, "heading", unit="degrees"))
    a = width * np.array([np.cos(h), -np.sin(h), 0])
    b = length * np.array([np.sin(h), np.cos(h), 0])
    c = np.array([0, 0, height])
    low, high = base - a / 2 - b / 2, base + a / 2 + b / 2 + c
    faces = [(low, a, b), (low, b, c), (low, a, c), (high, -a, -b), (high, -b, -c), (high, -a, -c)]
    sides = [rectangle(*face, reflectance=reflectance) for face in faces]
    return group(sides, label=label)


def ellipsoid(centre, radii, *, label="sphere", reflectance=0.5):
    """Return a solid ellipsoid with axes along x, y, z; ``radii`` in metres, one or three.

    Parameters
    ----------
    centre : array_like, shape (3,)
        Metres.
    radii : float or array_like, shape (3,)
        Half axes, metres.
    label : str
    reflectance : float

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
    centre = vector(centre, "centre")
    radii = _radii(radii)
    shape = np.diag(1 / radii).ravel()
    return primitives(label, tree.ELLIPSOID, centre, shape, radii, reflectance=reflectance)


def foliage(centre, radii, *, leaves, leaf_radius, seed, label="crown", reflectance=0.4):
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
    reflectance : float

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        If there are no leaves or a size is not above zero.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene
    >>> crown = Scene([foliage((0, 0, 5), 2.0, leaves=500, leaf_radius=0.1, seed=1)])
    >>> low, high = crown.table()[["z_min_m", "z_max_m"]].iloc[0]
    >>> bool(2.9 < low < high < 7.1)  # no leaf ends beyond its radius outside the crown
    True
    """
    rng = np.random.default_rng(seed)
    n = check_count(leaves, "leaves")
    radius = check_positive(leaf_radius, "leaf_radius", unit="m")
    ball = unit_rows(rng.standard_normal((n, 3))) * rng.random((n, 1)) ** (1 / 3)
    normal = unit_rows(rng.standard_normal((n, 3)))
    dual = perpendicular(normal) / radius
    shape = np.concatenate([dual[:, 0], dual[:, 1], normal], axis=1)
    half = radius * np.sqrt(np.maximum(1 - normal**2, 0))
    points = vector(centre, "centre") + ball * _radii(radii)
    return primitives(label, tree.ELLIPSE, points, shape, half, reflectance=reflectance)


def _radii(values):
    """Three half axes above zero."""
    return np.array(
        [check_positive(float(r), "radii", unit="m") for r in np.broadcast_to(values, 3)]
    )
