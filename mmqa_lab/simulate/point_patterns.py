"""Planar point patterns of known density, anisotropy and direction.

A pattern is drawn where it is isotropic, or as regular across as along, then compressed along one
direction and stretched across it by the same factor, turned, moved by chance and cut to a window:
its density stays, and the *ratio* across / along is known.
"""

from __future__ import annotations

from functools import partial
from math import comb

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_choice, check_number, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.spacing import poisson_spacing

__all__ = [
    "HOLE_SHARE", "KINDS", "SLOPE", "aligned_lines_f", "expected_f", "hard_core_points",
    "point_pattern", "thin", "true_ratio",
]  # fmt: skip

SLOPE = 0.8
"""Gradients: density changes from 1 - SLOPE to 1 + SLOPE of the mean across the turned window."""

HOLE_RADIUS, HOLE_SHARE = 4.0, 0.2
"""Holes: radius in units of sqrt(1 / density), and share of the area they cover on average."""


def point_pattern(
    kind: str,
    *,
    density: float,
    size: float,
    seed: int,
    ratio: float = 1.0,
    angle: float = 0.0,
    noise: float = 0.0,
    rounding: float = 0.0,
    jitter: float = 0.1,
) -> np.ndarray:
    """Return a point pattern in a square window.

    Parameters
    ----------
    kind : str
        One of ``KINDS``:

        - ``lattice``: square, or rectangular when stretched.
        - ``scan_lines``: parallel lines, each with an offset of its own, jittered along.
        - ``hexagonal``: the densest packing.
        - ``poisson``: homogeneous, purely random.
        - ``hard_core``: random, no two points closer than a limit, like dense image matching.
        - ``clusters``: a Thomas process.
        - ``gradient``: random, density grows linearly along ``angle``.
        - ``holes``: random with round gaps.
        - ``two_heads``: two sets of scan lines with half of the density each, at right angles.
    density : float
        Mean points per square metre.
    size : float
        Width of the window, m.
    seed : int
    ratio : float
        Spacing across / along, >= 1.
    angle : float
        Direction along, counter-clockwise from the first axis of the window, degrees.
    noise : float
        Standard deviation of both coordinates, m.
    rounding : float
        Grid to which coordinates are rounded, m; 0 for none.
    jitter : float
        Of scan lines: standard deviation along the line, as a share of the point spacing.

    Returns
    -------
    array, shape (n, 2)
        Metres, from 0 to ``size``; in no particular order.

    Raises
    ------
    ValueError
        If the kind is unknown or a number is out of its range.

    Notes
    -----
    A Poisson pattern stretched by any ratio is a Poisson pattern: it has no direction.
    :func:`true_ratio` says what a measure of anisotropy should find.

    References
    ----------
    Illian et al. 2008, Statistical Analysis and Modelling of Spatial Point Patterns, chapter 6.
    doi:10.1002/9780470725160

    Examples
    --------
    >>> xy = point_pattern("lattice", density=2500, size=1, seed=1, ratio=4)
    >>> len(xy), sorted(set(np.diff(np.unique(xy[:, 1].round(6))).round(6).tolist()))
    (2500, [0.04])
    """
    check_choice(kind, "kind", KINDS)
    density = check_positive(density, "density", unit="points per m2")
    size = check_positive(size, "size", unit="m")
    ratio = check_number(ratio, "ratio", low=1)
    check_number(noise, "noise", low=0, unit="m")
    rng = stream(seed, "point_pattern")
    reach = size * np.sqrt(0.5) + 5 * noise
    lines = kind in ("scan_lines", "two_heads")
    drawn = partial(_scan_lines, jitter=jitter) if lines else _DRAWN[kind]
    turns = (angle, angle + 90) if kind == "two_heads" else (angle,)
    parts = [_placed(drawn, rng, density / len(turns), reach, ratio, turn) for turn in turns]
    xy = np.concatenate(parts)
    xy = xy + noise * rng.standard_normal(xy.shape)
    xy = xy[(np.abs(xy) < size / 2).all(axis=1)] + size / 2
    return rounding * np.round(xy / rounding) if rounding else xy


def true_ratio(kind: str, ratio: float) -> float:
    """Return the ratio across / along that a measure of anisotropy should find.

    Random patterns have the same law however they are stretched, with a gradient or holes too, and
    two heads whose lines cross at a right angle look the same after a quarter turn: 1.

    Examples
    --------
    >>> true_ratio("scan_lines", 8), true_ratio("poisson", 8), true_ratio("two_heads", 8)
    (8.0, 1.0, 1.0)
    """
    check_choice(kind, "kind", KINDS)
    ratio = check_number(ratio, "ratio", low=1)
    return 1.0 if kind in ("poisson", "gradient", "holes", "two_heads") else ratio


def expected_f(kind: str, ratio: float) -> float:
    """Return f = d4/d1 in closed form, without edges and noise, for axes turned off the lines.

    With the unit along the line and the line spacing ``a``, d1 is 1 and d4 the larger of the
    distances to the nearest points on both neighbouring lines. On a lattice that is a. On scan
    lines with offsets of their own it is sqrt(a^2 + t^2 / 4), t the larger of two uniform numbers,
    its median 1 / sqrt(2). On a hexagonal lattice the next row is sqrt(3)/2 a away and moved by
    1/2. A Poisson pattern has :func:`mmqa_lab.spacing.poisson_spacing`, however stretched.

    Returns
    -------
    float
        NaN where no closed form is known here.

    Examples
    --------
    >>> [round(expected_f(k, 4), 3) for k in ("lattice", "scan_lines", "hexagonal", "poisson")]
    [4.0, 4.016, 3.5, 3.257]
    """
    check_choice(kind, "kind", KINDS)
    ratio = check_number(ratio, "ratio", low=1)
    d1, _, _, d4 = poisson_spacing(1.0)
    forms = {"lattice": ratio, "poisson": float(d4 / d1)}
    forms["scan_lines"] = float(np.hypot(ratio, np.sqrt(1 / 8)))
    forms["hexagonal"] = float(np.hypot(0.5, np.sqrt(0.75) * ratio))
    return forms.get(kind, np.nan)


def aligned_lines_f() -> float:
    """Return f of scan lines along an axis, with the least noise across: 5, at any line spacing.

    The neighbours along the line then lie above or below by chance, and fill the quadrants above
    and below. A point whose height has the rank u on its line finds its k next ones on one side all
    above or all below with probability (1 - u)^k + u^k. So d4 is at most k points away with the
    probability of the mean of (1 - (1 - u)^k - u^k)^2 over u: 1 - 4 / (k + 1) + 2 / (2k + 1)
    + 2 k!^2 / (2k + 1)!, which passes one half at k = 5.

    Notes
    -----
    True where lines are more than 5 point spacings apart and the noise is well below one.

    Examples
    --------
    >>> aligned_lines_f()
    5
    """
    shares = {k: 1 - 4 / (k + 1) + 2 / (2 * k + 1) * (1 + 1 / comb(2 * k, k)) for k in range(1, 99)}
    return min(k for k, share in shares.items() if share >= 0.5)


def thin(points: ArrayLike, least: float, *, period: ArrayLike | None = None) -> np.ndarray:
    """Say which points remain if no two of them may be nearer than a least distance.

    A point is removed if an earlier point that remains is nearer. Programs that thin clouds in
    object space this way make the density independent of the distance.

    Parameters
    ----------
    points : array_like, shape (n, 2) or (n, 3)
        Metres, in the order in which they are taken.
    least : float
        Metres.
    period : array_like, optional
        Size of a window whose opposite sides are joined; coordinates then run from 0.

    Returns
    -------
    array of bool, shape (n,)

    Examples
    --------
    >>> thin([[0, 0], [0.6, 0], [1.2, 0]], least=1.0).tolist()
    [True, False, True]
    """
    points = np.asarray(points, dtype=np.float64)
    keep = np.ones(len(points), dtype=bool)
    tree = cKDTree(points, boxsize=period)
    near = tree.query_pairs(check_positive(least, "least"), output_type="ndarray")
    first, later = np.sort(near, axis=1).T
    while len(first):
        waits, gone = np.zeros((2, len(points)), dtype=bool)
        waits[later] = True
        gone[later[~waits[first]]] = True  # the one before it stays for sure
        keep &= ~gone
        open_pairs = waits[first] & ~gone[first] & ~gone[later]
        first, later = first[open_pairs], later[open_pairs]
    return keep


def hard_core_points(
    size: np.ndarray, density: float, hard_core: float, rng: np.random.Generator
) -> np.ndarray:
    """Return points of a Matern hard-core process of the second kind, (n, 2).

    Poisson points get random ages; those with an older one within the core go. The Poisson density
    is chosen so that ``density`` remains.

    Parameters
    ----------
    size : array, shape (2,)
        Width and height of the window.
    density : float
        Points per unit area.
    hard_core : float
        Core radius as a share of 1 / sqrt(density), 0 to 0.56.
    rng : numpy.random.Generator

    References
    ----------
    Illian, Penttinen, Stoyan & Stoyan 2008, Statistical Analysis and Modelling of Spatial Point
    Patterns, section 6.5.2.
    """
    core = hard_core / np.sqrt(density)
    disc = np.pi * core**2
    needed = -np.log(1 - density * disc) / disc if core else density
    low, high = np.array([-core, -core]), size + core
    points = rng.uniform(low, high, (rng.poisson(needed * np.prod(high - low)), 2))
    if core:
        pairs = cKDTree(points).query_pairs(core, output_type="ndarray")
        points = np.delete(points, pairs.max(axis=1), axis=0)
    return points[((points >= 0) & (points < size)).all(axis=1)]


def _placed(drawn, rng, density, reach, ratio, angle):
    """A pattern stretched and turned, covering a disc of radius ``reach``."""
    root = np.sqrt(ratio)
    half = reach * np.array([root, 1 / root])
    xy = drawn(rng, density, half) / [root, 1 / root]
    turn = np.radians(angle)
    c, s = np.cos(turn), np.sin(turn)
    return xy @ np.array([[c, s], [-s, c]])


def _grid(rng, steps, half):
    """Indices of a grid over the rectangle, moved by chance, shape (m, 2), and the offsets."""
    reach = np.ceil(half / steps) + 1
    x, y = np.meshgrid(*(np.arange(-cells, cells) for cells in reach))
    return np.stack([x.ravel(), y.ravel()], axis=1), rng.random(2)


def _lattice(rng, density, half):
    """Square lattice."""
    step = 1 / np.sqrt(density)
    cells, offset = _grid(rng, step, half)
    return step * (cells + offset)


def _scan_lines(rng, density, half, jitter):
    """Lines as far apart as the points along them, each with its own offset and jitter."""
    step = 1 / np.sqrt(density)
    cells, offset = _grid(rng, step, half)
    line = (cells[:, 1] - cells[0, 1]).astype(int)
    along = cells[:, 0] + rng.random(line.max() + 1)[line] + jitter * rng.standard_normal(len(line))
    return step * np.stack([along, cells[:, 1] + offset[1]], axis=1)


def _hexagonal(rng, density, half):
    """Rows sqrt(3)/2 of the spacing apart, every other one moved by half of it."""
    step = np.sqrt(2 / (np.sqrt(3) * density))
    steps = step * np.array([1, np.sqrt(3) / 2])
    cells, offset = _grid(rng, steps, half)
    cells[:, 0] += 0.5 * (cells[:, 1] % 2)
    return steps * (cells + offset)


def _poisson(rng, density, half):
    """A Poisson number of points, each anywhere."""
    count = rng.poisson(density * 4 * half[0] * half[1])
    return rng.uniform(-half, half, (count, 2))


def _hard_core(rng, density, half):
    """Random sequential packing: points arrive one by one and stay where 0.7 spacings are free."""
    candidates = rng.uniform(0, 2 * half, (round(8 * density * 4 * half[0] * half[1]), 2))
    kept = thin(candidates, 0.7 / np.sqrt(density), period=2 * half)
    return candidates[kept][: len(candidates) // 8] - half


def _clusters(rng, density, half):
    """Thomas process: normal clouds of 8 points on average about random parents."""
    spread = 0.6 / np.sqrt(density)
    parents = _poisson(rng, density / 8, half + 5 * spread)
    parents = np.repeat(parents, rng.poisson(8, len(parents)), axis=0)
    return parents + spread * rng.standard_normal(parents.shape)


def _gradient(rng, density, half):
    """Random points, denser towards +x."""
    xy = _poisson(rng, (1 + SLOPE) * density, half)
    kept = (1 + SLOPE * xy[:, 0] / half[0]) / (1 + SLOPE)
    return xy[rng.random(len(xy)) < kept]


def _holes(rng, density, half):
    """Random points outside of random discs."""
    radius = HOLE_RADIUS / np.sqrt(density)
    centres = _poisson(rng, -np.log1p(-HOLE_SHARE) / (np.pi * radius**2), half + radius)
    xy = _poisson(rng, density / (1 - HOLE_SHARE), half)
    return xy[cKDTree(centres).query(xy)[0] > radius]


_DRAWN = {
    "lattice": _lattice,
    "hexagonal": _hexagonal,
    "poisson": _poisson,
    "hard_core": _hard_core,
    "clusters": _clusters,
    "gradient": _gradient,
    "holes": _holes,
}

KINDS = ("scan_lines", "two_heads", *_DRAWN)
"""The patterns that :func:`point_pattern` knows."""
