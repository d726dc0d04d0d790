"""What is measured of a candidate: its clean run, its section, and what stands around it."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from mmqa_lab._compiled import njit
from mmqa_lab.poles.axes import circles
from mmqa_lab.poles.common import BIN_M, BINS, around, pairs, rows_near

__all__ = ["MEASURES", "longest_runs", "measure", "sections"]


RADII_M = np.array([0.08, 0.15, 0.25, 0.40, 0.55])

SHELL_M, CLEAN = 0.25, 0.15
"""Width of the shell. A bin is clean if the shell has at most this share of the core's points."""

NARROW = 0.5
"""The core is the narrowest with this share of the longest clean run: boards stay outside."""

REACH_M, WIDE_M, ARCS, BANDS_M = 1.0, 4.0, 24, (1.0, 2.5, 5.0)

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

GROUPS, FEWEST, ROUGH_M, CORNERS, COVERED = 8, 15, 0.03, 3.0, 1.5
"""Height groups that are left out in turn; fewest points and largest misfit of a usable circle;
largest wave of its residuals, four to a turn as those of a square, in standard errors; least width
of what is seen, in radii: a flat face is narrower than its circle."""

SHARE, FLOOR_M = 0.02, 0.002
"""Error of a circle beyond its scatter (taper, bark, split beams): share of the diameter, m."""


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


def measure(thin, axes, before=None):
    """Return axes (k, 5), their ``MEASURES`` as a DataFrame, and the extent of each shaft.

    What stands around is taken from those ``before`` of the same axes, where they are given.

    Returns
    -------
    array, DataFrame, dict of array
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
    found = runs | around_run | rounds
    found |= _wide(thin.coarse, axes) if before is None else dict(before.filter(like="around_"))
    shaft = {"low": low, "high": high, "centre": centre}
    return axes, pd.DataFrame(found)[list(MEASURES)].round(4), shaft


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
    centre, r, rough = circles(own.axis, own.off, own.k)
    spoke = own.off - centre[own.axis]
    found = {"points": np.log1p(n / np.maximum(rise, BIN_M)), "radius_m": r}
    found |= {"rough": rough / (r + 0.02), "arc": _arcs(own.axis, spoke, own.k)}
    found |= {"slender": np.minimum(run / (2 * r + 0.02), 100)}
    found |= {"wide_m": np.sqrt(12) * _scatter(own.axis, own.off, own.k)[2]}
    found["head"] = _head(own.axis, np.hypot(*spoke.T), own.height, own.k)
    return found, centre


def _wide(coarse, axes):
    """Measures of what stands 1 to 4 m away: shares of directions in four bands of height."""
    order, *places = rows_near(axes[:, :2], coarse, WIDE_M)
    band = np.searchsorted(BANDS_M, coarse[order, 2], side="right")
    seen = np.zeros((len(axes), len(BANDS_M) + 1, ARCS), bool)
    _look_around(*places, band, seen)
    names = [f"around_{name}" for name in ("low", "mid", "high", "top")]
    return dict(zip(names, seen.mean(axis=2).T, strict=True))


@njit(cache=True)
def _look_around(points, xy, first, last, band, seen):
    """Mark the directions in which each place has points of each band, 1 to 4 m away."""
    for row in range(len(first)):
        x, y = xy[row // 3]
        for k in range(first[row], last[row]):
            u, v = points[k, 0] - x, points[k, 1] - y
            if 1.0 < u * u + v * v < WIDE_M**2:
                arc = int((np.arctan2(v, u) / (2 * np.pi) % 1) * ARCS) % ARCS
                seen[row // 3, band[k], arc] = True


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
    seen = np.zeros((k, ARCS), bool)
    seen[a, arc] = True
    return seen.sum(axis=1) / ARCS


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
    centre, radius, rough = circles(a, off, k, steps=30, hold=1e-3)
    count, spoke = np.maximum(np.bincount(a, minlength=k), 1), (off - centre[a]) @ [1, 1j]
    turned = (np.abs(spoke) - radius[a]) * np.exp(4j * np.angle(spoke))
    wave = np.hypot(*(np.bincount(a, part, k) for part in (turned.real, turned.imag))) / count
    others = [
        circles(a[part != g], off[part != g], k, steps=30, hold=1e-3)[1] for g in range(GROUPS)
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
