"""A learned detector with named measures and small decision trees.

The cloud is thinned, and columns of points become candidates. Each candidate gets an axis and the
``MEASURES``. Shallow trees, grown on simulated streets, give the score. The method needs no scan
lines. ``python -m mmqa_lab.studies.poles_training`` grows ``trees.csv`` again.
"""

from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import ndimage
from threadpoolctl import threadpool_limits

from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.poles.common import drop_duplicates, first_reason, ground, lowest, pairs, table

__all__ = [
    "MEASURES", "Trees", "describe", "detect", "grow", "lessons", "own_frame", "shipped", "write",
]  # fmt: skip

VOXEL_M = 0.04
PLACES = ((0, 0, 0, 0), (0.5, 0.5, 0.5, 22), (0.25, 0.75, 0.25, 45), (0.75, 0.25, 0.75, 67))
"""Shifts (voxels) and turns (degrees) of the thinning grid; scores are averaged over them."""

GRID_M, BIN_M, BINS = 0.1, 0.25, 64
"""Plan cells of candidates; height bins and their number, 16 m in all."""

LOW_M = 0.1
"""Points lower than this above the ground belong to the ground."""

RADII_M = np.array([0.08, 0.15, 0.25, 0.40, 0.55])
SHELL_M, CLEAN = 0.25, 0.15
"""Width of the shell. A bin is clean if the shell has at most this share of the core's points."""

NARROW = 0.5
"""The core is the narrowest with this share of the longest clean run: boards stay outside."""

REACH_M, COARSE_M, WIDE_M, ARCS = 1.0, 0.3, 4.0, 24
MAX_LEAN, WIDEST_M, APART_M = 0.27, 0.6, 0.6
THRESHOLD, DOUBT, LENGTH_M = 0.37, 0.02, 1.0
"""Scores are calibrated on streets of two generators of the tests; on others they are a probability
above .7 and an order below. The threshold, the lessons and the measures were chosen on simulated
streets of three generators, on posts and with the real street of study 06 in sight. Tests, studies
and benchmarks use other streets."""

MEASURES = {
    "run_m": ("longest stretch with points in the core and hardly any around it", 1),
    "clean_150_m": ("the same of a core of 15 cm", 1),
    "clean_400_m": ("the same of a core of 40 cm", 1),
    "core_m": ("radius of the core", 0),
    "low_m": ("height above ground where the run begins", -1),
    "column_m": ("longest stretch with points in the core, whatever is around", 0),
    "points": ("log of the core's points a metre, after thinning", 1),
    "above_shell": ("share of the 2 m above the run with points in a shell around the core", 0),
    "roof": ("share of the plan within 1 m with points right above the run", 0),
    "beside": ("share of the run's bins with points up to 1 m beside", -1),
    "crowd": ("log of the points within 0.7 m, up to 5 m high, after thinning", 0),
    "off_line_m": ("distance of the axis from the line of what stands beside, in plan", 0),
    "radius_m": ("of the circle through the run's points", 0),
    "rough": ("root mean square distance of the points from the circle, by the radius", 0),
    "arc": ("share of the circle's directions with points", 0),
    "slender": ("length of the run by the circle's diameter", 1),
    "head": ("mean distance from the centre 8 to 28 cm below the top, by that farther down", 0),
    "top_m": ("foot of the highest bin with points within 1 m", 0),
    "around_low": ("share of directions with points 1 to 4 m away, up to 1 m high", 0),
    "around_mid": ("the same, 1 to 2.5 m high", 0),
    "around_high": ("the same, 2.5 to 5 m high", 0),
    "around_top": ("the same, above 5 m", 0),
    "wide_m": ("extent of the run's points in plan, as of a straight line as scattered", 0),
    "slim": ("height of the highest point within 1 m, by that extent", 1),
}
"""Features of a candidate: description, and whether the score may only rise (1) or fall (-1)."""


class Thin(NamedTuple):
    """Thinned points (n, 3) up to 16 m above ground, heights (n,), centres of coarse cells, m."""

    points: np.ndarray
    height: np.ndarray
    coarse: np.ndarray


def thinned(points, height_of, place=PLACES[0]):
    """Return the ``Thin`` cloud: the mean point of each voxel, and the centres of coarse cells.

    Points (n, 3) in metres; ``height_of`` gives the ground; ``place`` is one of ``PLACES``.
    """
    if not len(points):
        return Thin(points, points[:, 2], points)
    turn = np.exp(1j * np.radians(place[3]))
    turned = points @ [[turn.real, turn.imag, 0], [-turn.imag, turn.real, 0], [0, 0, 1]]
    turned += VOXEL_M * np.array(place[:3])
    order, starts, _ = sort_into_cells(turned, VOXEL_M)
    sums = [np.add.reduceat(axis[order], starts[:-1]) for axis in points.T]  # no copy of the cloud
    centres = np.column_stack(sums) / np.diff(starts)[:, None]
    height = (centres[:, 2] - height_of(centres)).clip(0, BINS * BIN_M - 1e-6)
    cells = np.column_stack([centres[:, :2], height * (COARSE_M / 0.5)])
    coarse = (sort_into_cells(cells, COARSE_M)[2] + 0.5) * [COARSE_M, COARSE_M, 0.5]
    return Thin(centres, height, coarse)


PLOT_M, TABLE = 1.5, 2**20
"""Side of a plot, not less than the reach of any measure of thinned points; places of a table."""


def around(points, axes):
    """Return the points (n, 3) on the plots of the axes and on those that touch them.

    Plots are looked up by remainders of their numbers, so a few other plots come along.
    """

    def remainder(plot):
        return (plot[..., 0] * 73_856_093 ^ plot[..., 1] * 19_349_663) % TABLE

    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 2), axis=-1).reshape(-1, 2)
    wanted = np.zeros(TABLE, bool)
    wanted[remainder(np.floor(axes[:, None, :2] / PLOT_M).astype(np.int64) + steps)] = True
    return points[wanted[remainder(np.floor(points[:, :2] / PLOT_M).astype(np.int64))]]


SCALES = ((1, 4), (2, 5), (4, 7), (1, 0))
"""Half width of the core and of the ring around it, in cells; a ring of 0 is not tested."""

SCATTER_M, WIDEST = (0.25, 0.06), 4
"""Scatter about the axis on the widest and on all other scales, m; core of the widest, cells."""

TILE, MARGIN = 600, 10


def candidates(thin):
    """Return plan places (k, 2) and the scatter of points about the axis (k,), metres.

    On one of four scales a place is a local maximum of the count of clean height bins: bins with
    points in the core and an empty ring.
    """
    cell = np.floor(thin.points[:, :2] / GRID_M).astype(np.int64)
    rows = np.unique(np.column_stack([cell, (thin.height / BIN_M).astype(np.int64)]), axis=0)
    low = rows[:, :2].min(axis=0)
    tiles = np.unique((rows[:, :2] - low) // TILE, axis=0)
    found = []
    for corner in low + tiles * TILE - MARGIN:
        place = rows[:, :2] - corner
        inside = ((place >= 0) & (place < TILE + 2 * MARGIN)).all(axis=1)
        bits = np.zeros((TILE + 2 * MARGIN,) * 2, np.uint64)
        level = np.uint64(1) << rows[inside, 2].astype(np.uint64)
        np.add.at(bits, tuple(place[inside].T), level)  # each bit is unique: sum = union
        found.append(_tops(bits) + [*corner, 0])
    found = np.unique(np.concatenate(found), axis=0)
    return (found[:, :2] + 0.5) * GRID_M, np.where(found[:, 2], *SCATTER_M)


def _spread(bits, half, axis):
    """Union over the cells up to ``half`` away along an axis."""
    out = bits.copy()
    for k in range(1, half + 1):
        out |= np.roll(bits, k, axis) | np.roll(bits, -k, axis)
    return out


def _tops(bits):
    """Local maxima of clean bins in a tile: row, column, and 1 on the widest scale, else 0."""
    held = np.bitwise_count(bits).astype(np.float32)
    found = np.zeros((*bits.shape, 2), bool)
    for core, ring in SCALES:
        clean = _spread(_spread(bits, core, 0), core, 1)
        for half in (ring - 1, ring) if ring else ():
            for axis in (0, 1):
                side = _spread(bits, half, axis)
                clean &= ~(np.roll(side, half, 1 - axis) | np.roll(side, -half, 1 - axis))
        value = np.bitwise_count(clean).astype(np.float32)
        if core == WIDEST:  # a wide shaft seen from all sides is hollow
            more, inside = 80 * ndimage.gaussian_filter(held, 3.5, truncate=2.0), True
        else:
            box = 2 * core + 1
            more, inside = 4 * held + ndimage.uniform_filter(held, box) * box**2, bits > 0
        value = np.where((value >= 3) & inside, value + more / (more + 50), 0)
        size = 2 * max(core + 1, 3) + 1
        found[..., int(core == WIDEST)] |= (value > 0) & (
            value == ndimage.maximum_filter(value, size)
        )
    found[:MARGIN] = found[-MARGIN:] = found[:, :MARGIN] = found[:, -MARGIN:] = False
    return np.argwhere(found)


def fit_axes(thin, xy, scatter):
    """Return robust straight axes (k, 5): place (x, y), lean (x, y), height of the place; m, m/m.

    Reweighted least squares of the points within 0.5 m, with Geman-McClure weights whose scale
    shrinks from 0.15 to 0.06 m. A prior of 1 m2 draws leans towards 0. On the widest scale, if the
    points within 0.65 m lie on a circle, the axis stands upright in its centre.
    """
    a, b = pairs(xy, thin.points, 0.65)
    away = np.hypot(*(thin.points[b, :2] - xy[a]).T)
    near = (away < 0.5) | (scatter[a] > SCATTER_M[1])
    a, b, k = a[near], b[near], len(xy)
    sums = lambda values: np.bincount(a, values, k)  # noqa: E731
    height = thin.height[b]
    middle = sums(height) / np.maximum(np.bincount(a, minlength=k), 1)
    rise, place = height - middle[a], thin.points[b, :2] - xy[a]
    axes = np.zeros((k, 4))
    for scale in (0.15, 0.13, 0.11, 0.09, 0.075, 0.06, 0.06, 0.06):
        off = place - axes[a, :2] - axes[a, 2:] * rise[:, None]
        w = (1 + (off**2).sum(axis=1) / np.maximum(scale, scatter[a]) ** 2) ** -2.0
        w0, w1, w2 = sums(w) + 1e-9, sums(w * rise), sums(w * rise**2) + 1.0
        det = w0 * w2 - w1**2
        for i in (0, 1):
            s, t = sums(w * place[:, i]), sums(w * rise * place[:, i])
            axes[:, i], axes[:, 2 + i] = (w2 * s - w1 * t) / det, (w0 * t - w1 * s) / det
        axes[:, 2:] = axes[:, 2:].clip(-MAX_LEAN, MAX_LEAN)
    centre, radius, rough = _circles(a, place, k)
    wide = (scatter > SCATTER_M[1]) & (radius > 0.25) & (rough < 0.18 * radius)
    axes[wide] = np.column_stack([centre, 0 * centre])[wide]
    return np.column_stack([xy + axes[:, :2], axes[:, 2:], middle])


def longest_runs(flags):
    """Return first and last + 1 of the longest run of set flags in each row (k, bins).

    Gaps of a single flag are allowed.

    Examples
    --------
    >>> longest_runs(np.array([[1, 1, 0, 1, 0, 0, 1]], bool))
    (array([0]), array([4]))
    """
    low, last = np.full(len(flags), -9), np.full(len(flags), -9)
    best = np.zeros((2, len(flags)), np.int64)
    for k, flag in enumerate(flags.T):
        low = np.where(flag & (k - last > 2), k, low)
        last = np.where(flag, k, last)
        longer = flag & (k + 1 - low > best[1] - best[0])
        best = np.where(longer, [low, np.full(len(flags), k + 1)], best)
    return best[0], best[1]


class Near(NamedTuple):
    """Thinned points near k axes: number of the axis, offset from it (n, 2), distance, height."""

    axis: np.ndarray
    off: np.ndarray
    across: np.ndarray
    height: np.ndarray
    k: int

    def held(self, which):
        """Number of the points per axis and bin, (k, bins)."""
        place = self.axis[which] * BINS + (self.height[which] / BIN_M).astype(np.int64)
        return np.bincount(place, minlength=self.k * BINS).reshape(self.k, BINS)

    def some(self, which):
        """The chosen points."""
        return Near(*(part[which] for part in self[:4]), self.k)


def measure(thin, axes, coarse=None):
    """Return the ``MEASURES`` of axes (k, 5) as a DataFrame, and the extent of each shaft.

    Returns
    -------
    DataFrame, dict of array
        The shaft: ``low``, ``high`` (k,) of the run above ground, ``centre`` (k, 2) of the circle
        beside the axis, metres.
    """
    a, b = pairs(axes[:, :2], thin.points, REACH_M + 0.3)
    height = thin.height[b]
    off = thin.points[b, :2] - axes[a, :2] - axes[a, 2:4] * (height - axes[a, 4])[:, None]
    near = Near(a, off, np.hypot(*off.T), height, len(axes))
    near = near.some(near.across < REACH_M)
    runs, low, high = _runs(near)
    in_run = (near.height >= low[near.axis]) & (near.height < high[near.axis])
    core = runs["core_m"][near.axis]
    beside = near.some(in_run & (near.across > core + 0.03))
    around_run = _beside(near, beside, low, high)
    rounds, centre = _shape(near.some(in_run & (near.across <= core)), runs["run_m"], high - low)
    top = np.zeros(near.k)
    np.maximum.at(top, near.axis, near.height)
    rounds["slim"] = np.minimum(top / (rounds["wide_m"] + 0.02), 100)
    rounds["top_m"] = BIN_M * np.floor(top / BIN_M)
    found = runs | around_run | rounds | _wide(thin.coarse if coarse is None else coarse, axes)
    shaft = {"low": low, "high": high, "centre": centre}
    return pd.DataFrame(found)[list(MEASURES)].round(4), shaft


def _filled(counts, first, last):
    """Share of the bins from first to last with points."""
    bins = np.arange(BINS)
    inside = (bins >= first[:, None]) & (bins < last[:, None]) & (counts > 0)
    return inside.sum(axis=1) / np.maximum(last - first, 1)


def _runs(near):
    """Measures of the clean runs, and the ends of the run above ground (k,), metres."""
    cores = [near.held(near.across <= r) for r in RADII_M]
    shells = [near.held((near.across > r) & (near.across <= r + SHELL_M)) for r in RADII_M]
    runs = [longest_runs((c > 0) & (s <= CLEAN * c)) for c, s in zip(cores, shells, strict=True)]
    clean = np.array([last - first for first, last in runs])
    chosen = (clean >= NARROW * clean.max(axis=0)).argmax(axis=0)
    rows = np.arange(near.k)
    low, high = np.array(runs)[chosen, :, rows].T
    first, last = longest_runs(np.array(cores)[chosen, rows] > 0)
    low, high = np.where(high > low, low, first), np.where(high > low, high, last)
    above = _filled(np.array(shells)[chosen, rows], high, np.minimum(high + 8, BINS))
    found = {"run_m": BIN_M * clean[chosen, rows], "clean_150_m": BIN_M * clean[1]}
    found |= {"clean_400_m": BIN_M * clean[3], "core_m": RADII_M[chosen], "low_m": BIN_M * low}
    found |= {"column_m": BIN_M * (last - first), "above_shell": above}
    return found, BIN_M * low, BIN_M * high


def _beside(near, beside, low, high):
    """Measures of what is around the run: within 1 m, and among it ``beside`` the core."""
    over = near.some((near.height >= high[near.axis]) & (near.height < high[near.axis] + 3 * BIN_M))
    cell = np.floor(over.off / 0.25).astype(np.int64) + 4
    seen = np.unique((over.axis * 8 + cell[:, 0]) * 8 + cell[:, 1]) // 64
    crowd = (near.across < 0.7) & (near.height < 5)
    ends = ((end / BIN_M).astype(np.int64) for end in (low, high))
    return {
        "roof": np.bincount(seen, minlength=near.k) / 52,
        "beside": _filled(beside.held(...), *ends),
        "crowd": np.log1p(np.bincount(near.axis[crowd], minlength=near.k)),
        "off_line_m": _off_line(beside.axis, beside.off, near.k),
    }


def _shape(own, run, rise):
    """Measures of the shaft's own points, and the circle's centre (k, 2), metres."""
    n = np.bincount(own.axis, minlength=own.k)
    centre, r, rough = _circles(own.axis, own.off, own.k)
    spoke = own.off - centre[own.axis]
    found = {"points": np.log1p(n / np.maximum(rise, BIN_M)), "radius_m": r}
    found |= {"rough": rough / (r + 0.02), "arc": _arcs(own.axis, spoke, own.k)}
    found |= {"slender": np.minimum(run / (2 * r + 0.02), 100)}
    found |= {"wide_m": np.sqrt(12) * _scatter(own.axis, own.off, own.k)[2]}
    found["head"] = _head(own.axis, np.hypot(*spoke.T), own.height, own.k)
    return found, centre


def _wide(coarse, axes):
    """Measures of what stands 1 to 4 m away: shares of directions in four bands of height."""
    a, b = pairs(axes[:, :2], coarse, WIDE_M)
    off, z = coarse[b, :2] - axes[a, :2], coarse[b, 2]
    bands = {"low": (0, 1), "mid": (1, 2.5), "high": (2.5, 5), "top": (5, 99)}
    found = {}
    for name, (least, most) in bands.items():
        which = (np.hypot(*off.T) > 1.0) & (z >= least) & (z < most)
        found[f"around_{name}"] = _arcs(a[which], off[which], len(axes))
    return found


def _head(a, across, height, k):
    """Mean distance from the centre below the top over the mean farther down; 1 if unknown."""
    top = np.zeros(k)
    np.maximum.at(top, a, height)
    below = top[a] - height
    parts = (below > 0.08) & (below < 0.28), below >= 0.28
    n, m = (np.bincount(a[part], minlength=k) for part in parts)
    upper, lower = (np.bincount(a[part], across[part], k) for part in parts)
    ratio = (upper * m) / np.maximum(lower * n, 1e-9)
    return np.where((n > 1) & (m > 1), ratio.clip(0, 3), 1)


def _arcs(a, off, k):
    """Share of the directions in which each of k candidates has points."""
    arc = ((np.arctan2(off[:, 1], off[:, 0]) / (2 * np.pi) % 1) * ARCS).astype(np.int64) % ARCS
    return np.bincount(np.unique(a * ARCS + arc) // ARCS, minlength=k) / ARCS


def _scatter(a, off, k):
    """Mean (k, 2), direction and size of the largest scatter in plan of each candidate's points."""
    n = np.maximum(np.bincount(a, minlength=k), 1)
    u, v = (np.bincount(a, c, k) / n for c in off.T)
    x, y = off[:, 0] - u[a], off[:, 1] - v[a]
    xx, xy, yy = (np.bincount(a, c, k) / n for c in (x * x, x * y, y * y))
    largest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    return np.column_stack([u, v]), np.arctan2(2 * xy, xx - yy) / 2, np.sqrt(largest)


def _off_line(a, off, k):
    """Distance of the axis from the line in plan through the points of each candidate."""
    mean, turn, _ = _scatter(a, off, k)
    away = np.abs(mean[:, 0] * np.sin(turn) - mean[:, 1] * np.cos(turn))
    return np.where(np.bincount(a, minlength=k) < 5, REACH_M, away)


def _circles(a, off, k, steps=5, hold=0.02):
    """Centre, radius and misfit of the circle through the points of each of k candidates.

    An algebraic circle (Kasa), then robust Gauss-Newton steps.
    """
    n = np.maximum(np.bincount(a, minlength=k), 1)
    mean = lambda values: np.bincount(a, values, k) / n  # noqa: E731

    def solved(terms, right, weight, hold):
        """Coefficients (k, 3) of the terms by weighted and damped least squares."""
        m = np.array([[mean(weight * s * t) for t in terms] for s in terms]).transpose(2, 0, 1)
        m[:, range(3), range(3)] += hold
        sums = np.stack([mean(weight * s * right) for s in terms], -1)
        return np.linalg.solve(m, sums[..., None])[..., 0]

    middle = np.column_stack([mean(c) for c in off.T])
    x, y = (off - middle[a]).T
    one, square = np.ones(len(x)), x * x + y * y
    centre = solved((one, x, y), square, one, 1e-6)[:, 1:] / 2  # the steps below correct its bias
    centre /= np.maximum(np.hypot(*centre.T) / WIDEST_M, 1)[:, None]
    r = np.sqrt(mean(square) + (centre**2).sum(axis=1))
    for _ in range(steps):
        u, v = x - centre[a, 0], y - centre[a, 1]
        d = np.maximum(np.hypot(u, v), 1e-6)
        e = d - r[a]
        step = solved((one, u / d, v / d), e, 1 / (1 + (e / 0.03) ** 2) ** 2, hold)
        r, centre = np.clip(r + step[:, 0], 0.01, WIDEST_M), centre + step[:, 1:]
    e = np.hypot(x - centre[a, 0], y - centre[a, 1]) - r[a]
    rough = np.minimum(np.sqrt(mean(e * e)), np.sqrt(np.maximum(mean(square), 1e-9)))
    return middle + centre, r, rough


class Trees(NamedTuple):
    """Nodes of all trees in arrays of shape (n,).

    If ``feature`` is at most ``limit`` the next node is ``left``, else ``right``; leaves have -1 in
    both. ``value`` is the contribution of the node to the log odds.
    """

    feature: np.ndarray
    limit: np.ndarray
    left: np.ndarray
    right: np.ndarray
    value: np.ndarray

    def parts(self, measures):
        """Return the contribution of each measure to the log odds, (k, measures), and the offset.

        A candidate passes from node to node of a tree. Each change of the value counts for the
        measure that the node tests.
        """
        x = np.asarray(measures, float)
        rows, parts = np.arange(len(x)), np.zeros(x.shape)
        roots = np.setdiff1d(np.arange(len(self.left)), [self.left, self.right])
        for root in roots:
            node = np.full(len(x), root)
            for _ in range(DEPTH):
                asked = self.feature[node]
                inner = self.left[node] >= 0
                less = x[rows, asked] <= self.limit[node]
                new = np.where(inner, np.where(less, self.left[node], self.right[node]), node)
                parts[rows, asked] += self.value[new] - self.value[node]
                node = new
        return parts, self.value[roots].sum()

    def log_odds(self, measures):
        """Return the log odds (k,) that each candidate is a pole."""
        parts, first = self.parts(measures)
        return parts.sum(axis=1) + first

    def score(self, measures):
        """Return the score (k,) of each candidate, from 0 to 1."""
        return 1 / (1 + np.exp(-self.log_odds(measures)))


DEPTH = 6


def grow(measures, label, weight=None, *, start=None, rounds=200, leaves=16, rate=0.08, leave=()):
    """Return ``Trees`` grown by gradient boosting of the log loss.

    Parameters
    ----------
    measures : DataFrame
        From :func:`measure`, k rows.
    label : array, shape (k,)
        1 for poles, 0 for others.
    weight : array, shape (k,), optional
        Weights of the candidates; equal by default.
    start : Trees, optional
        Trees that come first; the new ones correct their score.
    rounds, leaves, rate : int, int, float
        Number of new trees, leaves per tree, learning rate.
    leave : tuple of str
        Measures that the new trees may not use.
    """
    import lightgbm

    x = measures.to_numpy(float) * ~np.isin(list(MEASURES), leave)
    fewest = int(np.clip(len(label) / 280, 5, 100))  # of candidates in a leaf
    choices = {"objective": "binary", "num_leaves": leaves, "learning_rate": rate}
    choices |= {"max_depth": DEPTH, "min_data_in_leaf": fewest, "lambda_l2": fewest / 5}
    choices |= {"feature_fraction_bynode": 0.4, "deterministic": True, "force_row_wise": True}
    choices |= {"num_threads": 1, "seed": 0, "verbose": -1}
    choices["monotone_constraints"] = [way for _, way in MEASURES.values()]
    first = None if start is None else start.log_odds(measures)
    weight = None if weight is None else weight / np.mean(weight)
    data = lightgbm.Dataset(x, label, weight=weight, init_score=first)
    nodes = lightgbm.train(choices, data, num_boost_round=rounds).trees_to_dataframe()
    before = 0 if start is None else len(start.left)
    row_of = pd.Series(nodes.index + before, nodes["node_index"])
    left, right = (row_of.reindex(nodes[f"{side}_child"]).fillna(-1) for side in ("left", "right"))
    feature = nodes["split_feature"].fillna("Column_0").str.removeprefix("Column_").astype(int)
    columns = feature, nodes["threshold"].fillna(0), left.astype(int), right.astype(int)
    trees = Trees(*(column.to_numpy() for column in (*columns, nodes["value"])))
    return trees if start is None else Trees(*map(np.concatenate, zip(start, trees, strict=True)))


class Described(NamedTuple):
    """Candidates of a cloud: ``axes`` (k, 5), ``measures``, ``shaft``, ``ground`` (a function).

    ``above`` has the points up to 16 m above the ground, ``coarse`` the centres of their cells.
    """

    axes: np.ndarray
    measures: pd.DataFrame
    shaft: dict
    ground: Callable
    above: np.ndarray
    coarse: np.ndarray

    @property
    def middle(self):
        """Place of the axes at half the height of the run, (k, 2), m.

        If the points lie on a circle, the place is its centre.
        """
        half = (self.shaft["low"] + self.shaft["high"]) / 2 - self.axes[:, 4]
        centre, radius = self.shaft["centre"], self.measures["radius_m"].to_numpy()
        is_arc = (self.measures["arc"].to_numpy() > 0.2) & (np.hypot(*centre.T) < 1.3 * radius)
        shift = self.axes[:, 2:4] * half[:, None] + centre * is_arc[:, None]
        return self.axes[:, :2] + shift


def own_frame(points):
    """Return an origin (3,) and axes in columns (3, 3) that turn and move with points (n, 3), m.

    The third axis is upright. The second follows the longest extent in plan, as in the streets of
    the lessons, so directions are told from the street and not from north. Far points hardly count.
    Of a large cloud the points of some levels are asked, the same whatever their order.

    Examples
    --------
    >>> origin, axes = own_frame(np.array([[0, 0, 5], [3, 3, 5], [6, 6, 5.0]]))
    >>> origin.round(9).tolist(), np.abs(axes[:, 1]).round(3).tolist()
    ([3.0, 3.0, 5.0], [0.707, 0.707, 0.0])
    """
    level = (points[:, 2] - np.median(points[:, 2])) % LEVEL_M
    asked = level * max(len(points) // MOST_ASKED, 1) <= LEVEL_M
    plan, first = (points[asked, :2] - points[0, :2]) @ [1, 1j], points[0, :2]
    weight = np.ones(len(plan))
    for _ in range(10):
        centre = np.average(plan, weights=weight)
        away = np.abs(plan - centre)
        weight = (1 + (away / (2 * np.median(away) + LOW_M)) ** 2) ** -2.0
    off = plan - centre
    angle = np.angle((weight * off**2).sum()) / 2
    angle += np.pi * ((weight * (off * np.exp(-1j * angle)).real ** 3).sum() < 0)
    along = np.array([np.cos(angle), np.sin(angle), 0])
    axes = np.column_stack([np.cross(along, [0, 0, 1]), along, [0, 0, 1]])
    return np.array([*first + [centre.real, centre.imag], np.floor(points[:, 2].min())]), axes


def describe(points, frame=None):
    """Return the ``Described`` candidates of points (n, 3), m, in a frame such as ``own_frame``."""
    origin, turn = frame or (0.0, np.eye(3))

    def parts():
        """The points in that frame, a part at a time: a large cloud is held once."""
        for first in range(0, len(points), PART):
            yield (points[first : first + PART] - origin) @ turn

    def over_ground(part):
        height = part[:, 2] - height_of(part)
        return part[(height > LOW_M) & (height < BINS * BIN_M)]

    height_of = ground(np.concatenate([lowest(part) for part in parts()]))
    above = np.concatenate([over_ground(part) for part in parts()])
    thin = thinned(above, height_of)
    axes = fit_axes(thin, *candidates(thin)) if len(above) else np.empty((0, 5))
    return Described(axes, *measure(thin, axes), height_of, above, thin.coarse)


PART, MOST_ASKED, LEVEL_M = 1_000_000, 50_000, 0.01
"""Points that are handled at a time while the ground is sought; about so many give the frame, those
in the lowest part of each level."""


@threadpool_limits.wrap(limits=1)  # products with a small matrix, which threads make slow
def detect(points, *, threshold=THRESHOLD, trees=None, explain=False):
    """Return the poles of points (n, 3) as :func:`mmqa_lab.poles.detect` does.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    threshold : float
        Least score of a pole.
    trees : Trees, optional
        By default the trees of the package.
    explain : bool
        Return all candidates with the test that rejected them, the measures, and the contribution
        of each measure to the log odds.

    Returns
    -------
    DataFrame
        The columns of :func:`mmqa_lab.poles.common.table`, the interval of the diameter, and
        ``section_m``.
    """
    trees = shipped() if trees is None else trees
    points = points if len(points) else np.zeros((1, 3))  # ground without poles
    origin, turned = own_frame(points)
    found = describe(points, (origin, turned))
    axes, height_of = found.axes, found.ground
    score = trees.score(found.measures)
    doubtful = score > DOUBT
    near = around(found.above, axes[doubtful])
    for place in PLACES[1:]:
        again = measure(thinned(near, height_of, place), axes[doubtful], found.coarse)[0]
        score[doubtful] += trees.score(again)
    score[doubtful] /= len(PLACES)
    low, high = found.shaft["low"], found.shaft["high"]
    short = found.measures["column_m"].to_numpy() < LENGTH_M
    tilted = np.hypot(*axes[:, 2:4].T) > np.tan(np.radians(TILT_DEG))
    reason = first_reason(score=score < threshold, length=short, tilt=tilted)
    xy = found.middle
    drop_duplicates(xy, score, reason, APART_M)
    kept = reason == ""
    sizes = pd.DataFrame(sections(found, kept), index=np.flatnonzero(kept))
    top = found.measures["top_m"].to_numpy()[kept] + BIN_M
    reason[kept] = np.where(top < STOUT * sizes["section_m"], "section", "")
    foot = np.column_stack([xy, height_of(axes) + low]) @ turned.T + origin
    lean = axes[:, 2:4] @ turned[:2, :2].T
    rows = dict(zip(("x_m", "y_m", "z_base_m"), foot.T, strict=True))
    rows |= {"height_m": high - low} | dict(sizes.reindex(range(len(axes))))
    rows |= {"lean_x": lean[:, 0], "lean_y": lean[:, 1], "score": score, "rejected_by": reason}
    if explain:
        parts = pd.DataFrame(trees.parts(found.measures)[0], columns=[*MEASURES])
        rows |= dict(found.measures) | dict(parts.add_prefix("adds_"))
    return table(rows, "learned", explain=explain)


SLENDER, STOUT, TILT_DEG = 6.0, 5.0, 12.0
"""A pole is at least six times as high as wide, what it carries counted as height, and leans at
most so far: guy wires lean more. A find is dropped below five, since scatter widens a section."""

GROUPS, FEWEST, ROUGH_M, CORNERS, COVERED = 8, 15, 0.03, 3.0, 1.5
"""Height groups that are left out in turn; fewest points and largest misfit of a usable circle;
largest wave of its residuals, four to a turn as those of a square, in standard errors; least width
of what is seen, in radii: a flat face is narrower than its circle."""

SHARE, FLOOR_M = 0.02, 0.002
"""Error of a circle beyond its scatter (taper, bark, split beams): share of the diameter, m."""


def sections(found, kept):
    """Return the size of kept candidates halfway up their run, metres.

    A circle is fitted to the points around each axis. Its interval comes from a jackknife that
    leaves out each of eight height groups in turn.

    Returns
    -------
    dict of array
        ``diameter_m``, ``diameter_low_m``, ``diameter_high_m``, NaN where no circle fits, and for
        square shafts; ``section_m``, the diameter, or the width of what is seen.
    """
    axes, low, high = found.axes[kept], found.shaft["low"][kept], found.shaft["high"][kept]
    core, k = found.measures["core_m"].to_numpy()[kept], kept.sum()
    near = around(found.above, axes)
    a, b = pairs(axes[:, :2], near, REACH_M)
    height = near[b, 2] - found.ground(near[b])
    off = near[b, :2] - axes[a, :2] - axes[a, 2:4] * (height - axes[a, 4])[:, None]
    own = (np.hypot(*off.T) <= core[a]) & (height >= low[a]) & (height < high[a])
    a, off, height = a[own], off[own], height[own]
    part = ((height - low[a]) / (high - low)[a] * GROUPS).astype(np.int64)
    centre, radius, rough = _circles(a, off, k, steps=30, hold=1e-3)
    count, spoke = np.maximum(np.bincount(a, minlength=k), 1), (off - centre[a]) @ [1, 1j]
    turned = (np.abs(spoke) - radius[a]) * np.exp(4j * np.angle(spoke))
    wave = np.hypot(*(np.bincount(a, part, k) for part in (turned.real, turned.imag))) / count
    others = [
        _circles(a[part != g], off[part != g], k, steps=30, hold=1e-3)[1] for g in range(GROUPS)
    ]
    std = np.sqrt((GROUPS - 1) * np.var(others, axis=0)) * 2
    width = _width(a, off, k)
    told = (count >= FEWEST) & (rough < ROUGH_M) & (width > COVERED * radius)
    told &= 2 * wave < CORNERS * rough * np.sqrt(2 / count)
    half = np.hypot(3 * std, FLOOR_M + SHARE * 2 * radius)
    told &= half < radius
    diameter = np.where(told, 2 * radius, np.nan)
    found = {"diameter_m": diameter, "diameter_low_m": diameter - half}
    found |= {"diameter_high_m": diameter + half}
    return found | {"section_m": np.where(told, diameter, width)}


def _width(a, off, k):
    """Widest extent in plan of the inner 95 % of each candidate's points, of 12 directions."""
    widest, ends = np.zeros(k), np.searchsorted(np.sort(a), np.arange(k + 1))
    count = np.diff(ends)
    for turn in np.arange(12) * np.pi / 12:
        along = off @ [np.cos(turn), np.sin(turn)]
        along = np.append(along[np.lexsort([along, a])], 0.0)
        low, high = (along[ends[:-1] + (share * count).astype(int)] for share in (0.025, 0.975))
        widest = np.maximum(widest, np.where(count > 0, high - low, 0))
    return widest


def lessons(points, targets, *, weight=1.0, poles=2.5):
    """Return the training data of a cloud: measures, labels (1 for visible poles), weights.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    targets : DataFrame
        Poles: ``x_m``, ``y_m`` at half height, ``lean_x``, ``lean_y``, ``z_base_m``, ``height_m``,
        ``visible``.
    weight : float
        Weight of the cloud. It is spread so that a cloud of k candidates counts as sqrt(k).
    poles : float
        Weight of a pole beside that of another candidate, since scores of sparse and rough poles of
        real streets are too low otherwise.

    Returns
    -------
    DataFrame, Series, Series
        Candidates nearer than 0.3 m to a visible pole count as poles. Other candidates within 0.6 m
        of any pole are left out.
    """
    origin = np.floor(points.min(axis=0))
    found = describe(points - origin)
    half = targets["height_m"].to_numpy() / 2
    height = found.ground(found.axes) + (found.shaft["low"] + found.shaft["high"]) / 2 + origin[2]
    rise = np.clip(height[:, None] - targets["z_base_m"].to_numpy() - half, -half, half)
    off = found.middle[:, None] + origin[:2] - targets[["x_m", "y_m"]].to_numpy()
    away = np.linalg.norm(off - targets[["lean_x", "lean_y"]].to_numpy() * rise[..., None], axis=2)
    right = ((away < 0.3) & targets["visible"].to_numpy()).any(axis=1)
    use = right | (away > 0.6).all(axis=1)
    label = pd.Series(right[use].astype(int))
    return (
        found.measures[use],
        label,
        (1 + (poles - 1) * label) * weight / np.sqrt(max(use.sum(), 1)),
    )


FILE = resources.files("mmqa_lab.poles").joinpath("trees.csv")


def write(path, trees):
    """Write ``Trees`` to a text file, one node per row."""
    frame = pd.DataFrame(trees._asdict()).round({"value": 6})
    frame.to_csv(path, index=False, float_format="%.10g", lineterminator="\n")


@cache
def shipped():
    """Return the trees that come with the package."""
    with FILE.open() as file:
        return Trees(*(column.to_numpy() for _, column in pd.read_csv(file).items()))
