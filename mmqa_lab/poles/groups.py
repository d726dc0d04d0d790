"""Short groups of consecutive points on scan lines: what a shaft looks like between leaves.

A shaft cuts a short piece of about the same width out of one scan line after the other, at the same
place in plan; leaves do so at random places. Groups that stack up over a metre are candidates, and
how well they stack says what a cloud without its order cannot: whether points that stand among
foliage belong together.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from mmqa_lab.poles.common import near_axis, rows
from mmqa_lab.poles.features import BIN_M, BINS, MAX_LEAN, fit_axis, longest_run, set_bits

WIDEST_M = 0.8
"""Longest chord of a group; a line on a wall or the ground is longer."""

GAP_M = (0.04, 0.15)
"""Least and largest distance of two consecutive points that ends a group; in between, three times
the spacing of the points around, so that a denser scanner is cut as finely as its spacing allows.
"""

FREE_M = 0.3
"""An end is free where the next point of the line is farther away, or missing."""

MISSING = 3
"""Pulses without a point that end a group."""

ALIGNED_M = 0.08
"""Largest distance of the middle of a group from the axis of a stack."""

SUPPORT_M = 0.12
AROUND_M = 0.5
SPAN_M = 1.5
LEAST_BINS = 4
CONTRAST = 2.5
"""A candidate is a group above and below which others within 0.12 m in plan fill at least 4 bins of
0.25 m within 1.5 m, 2.5 times as densely as they stand within half a metre."""

HIGHEST_M = 8.0
"""Groups higher above the ground are not looked at."""

NAMES = (
    *("stack_m", "stack_lines", "stack_share", "stack_width_m", "stack_width_spread"),
    *("stack_wobble_m", "free_both", "free_one", "stack_points_per_line", "stack_rivals"),
    *("stack_filled", "stack_spacing_m"),
)
"""What the columns of :func:`describe` mean: length of the stack of groups, log of their number,
their share of the points near the axis, their median width and its spread, how far they
stray from the axis, shares with two free ends and with one, points per group, groups nearby that
are not aligned for each that is, share of the stack's height bins with a group, median spacing of
points."""


class Groups(NamedTuple):
    """Groups sorted in plan rows.

    ``middle`` (m, 3); ``start`` and ``base`` as :func:`mmqa_lab.poles.columns.near_axis` takes
    them; ``height`` (m,) above ground; ``width`` (m,) in plan; ``count`` (m,) points; ``free`` (m,)
    number of free ends.
    """

    middle: np.ndarray
    start: np.ndarray
    base: float
    height: np.ndarray
    width: np.ndarray
    count: np.ndarray
    free: np.ndarray


def line_groups(lines, height_of):
    """Return the groups of scan lines.

    Parameters
    ----------
    lines : mmqa_lab.poles.profiles.Lines
        Metres from an origin nearby.
    height_of : callable
        Heights above ground (m,) of points (m, 3).

    Returns
    -------
    Groups
    """
    points, line, pulse = lines[:3]
    first, last, free = _cut(points, line, pulse)
    count = last - first + 1
    ends = points[last] - points[first]
    middle = np.add.reduceat(points, first, axis=0) / count[:, None]
    kept = (count >= 2) & (np.sqrt((ends**2).sum(axis=1)) <= WIDEST_M)
    kept = np.flatnonzero(kept)
    height = height_of(middle[kept])
    used = (height > 0.1) & (height < HIGHEST_M)
    kept, height = kept[used], height[used]
    found = rows(middle[kept])
    kept = kept[found.order]
    where = (found.points, found.start, found.base, height[found.order])
    return Groups(*where, np.hypot(*ends[kept, :2].T), count[kept], free[kept])


@njit(cache=True)
def _cut(points, line, pulse):
    """First and last point of each group of sorted lines, and its number of free ends."""
    n = len(points)
    gap = np.full(n + 1, np.inf)
    for k in range(1, n):
        if line[k] == line[k - 1] and pulse[k] - pulse[k - 1] <= MISSING:
            gap[k] = np.sqrt(((points[k] - points[k - 1]) ** 2).sum())
    first, last, free = [], [], []
    begin = 0
    for k in range(1, n + 1):
        if gap[k] > GAP_M[0] and gap[k] > min(3 * _third(gap, k), GAP_M[1]):
            first.append(begin)
            last.append(k - 1)
            free.append((gap[begin] > FREE_M) + (gap[k] > FREE_M))
            begin = k
    return np.array(first), np.array(last), np.array(free)


@njit(cache=True)
def _third(gap, k):
    """Third smallest of the nine gaps around gap ``k``."""
    a = b = c = np.inf
    for i in range(max(k - 4, 0), min(k + 5, len(gap))):
        if gap[i] < a:
            a, b, c = gap[i], a, b
        elif gap[i] < b:
            b, c = gap[i], b
        elif gap[i] < c:
            c = gap[i]
    return c


def candidates(groups):
    """Return plan positions (k, 2) where groups stack up."""
    support, xy = _support(*groups[:5])
    top = _tops(*groups[:4], support)
    return xy[top]


@njit(cache=True, parallel=True)
def _support(middle, start, low, height, width):
    """Bins filled above and below each group, 0 without contrast, and the middle of its stack."""
    support, xy = np.zeros(len(middle)), np.zeros((len(middle), 2))
    for g in prange(len(middle)):
        near = near_axis(middle, start, low, middle[g, 0], middle[g, 1], AROUND_M)
        bits, inside, around, x, y = np.uint64(0), 0, 0, 0.0, 0.0
        for k in near:
            rise = height[k] - height[g]
            if abs(rise) >= SPAN_M:
                continue
            away = np.hypot(middle[k, 0] - middle[g, 0], middle[k, 1] - middle[g, 1])
            if away > SUPPORT_M:
                around += 1
            elif abs(width[k] - width[g]) <= 0.5 * max(width[k], width[g]) + 0.03:
                bits |= np.uint64(1) << np.uint64((rise + SPAN_M) / BIN_M)
                inside += 1
                x += middle[k, 0]
                y += middle[k, 1]
        xy[g, 0], xy[g, 1] = x / inside, y / inside
        ratio = (AROUND_M / SUPPORT_M) ** 2 - 1
        n = set_bits(bits)
        if n >= LEAST_BINS and inside * ratio >= CONTRAST * around:
            support[g] = n + inside / (inside + 50.0)
    return support, xy


@njit(cache=True, parallel=True)
def _tops(middle, start, low, height, support):
    """Whether the support of a group is the largest within 0.3 m in plan, first of equals."""
    top = np.zeros(len(middle), np.bool_)
    for g in prange(len(middle)):
        if support[g] == 0:
            continue
        top[g] = True
        for k in near_axis(middle, start, low, middle[g, 0], middle[g, 1], 0.3):
            if support[k] > support[g] or (
                support[k] == support[g] and (height[k], k) < (height[g], g)
            ):
                top[g] = False
                break
    return top


@njit(cache=True, parallel=True)
def axes_of(middle, start, low, height, xy):
    """Robust axes (k, 5) of the stacks at plan positions ``xy``."""
    out = np.zeros((len(xy), 5))
    for c in prange(len(xy)):
        near = near_axis(middle, start, low, xy[c, 0], xy[c, 1], 0.4)
        x, y, h = middle[near, 0], middle[near, 1], height[near]
        out[c] = np.array(fit_axis(x, y, h, xy[c, 0], xy[c, 1], 0.12, 0.04, 10, 2.0))
    return out


def describe(groups, axes):
    """Return the features (k, len(NAMES)) of the stack at each axis, and its ends (k, 2).

    Parameters
    ----------
    groups : Groups
    axes : array, shape (k, 5 or more)
        x, y at height ``middle`` above ground, lean x, lean y, middle.
    """
    features, ends = np.zeros((len(axes), len(NAMES))), np.zeros((len(axes), 2))
    _stacks(*groups, np.ascontiguousarray(axes[:, :5]), features, ends)
    return features, ends


@njit(cache=True, parallel=True)
def _stacks(middle, start, low, height, width, count, free, axes, features, ends):
    """Write features and ends of each axis."""
    for c in prange(len(axes)):
        ax, ay, lx, ly, at = axes[c]
        reach = AROUND_M + MAX_LEAN * HIGHEST_M / 2
        near = near_axis(middle, start, low, ax, ay, reach)
        away = np.empty(len(near))
        for i, k in enumerate(near):
            u = height[k] - at
            away[i] = np.hypot(middle[k, 0] - ax - lx * u, middle[k, 1] - ay - ly * u)
        _stack(near, away, height, width, count, free, features[c], ends[c])


@njit(cache=True)
def _stack(near, away, height, width, count, free, out, end):
    """Write features and ends of one axis; all zero where no group is aligned."""
    chosen = away <= ALIGNED_M
    if not chosen.any():
        return
    usual = np.median(width[near[chosen]])
    chosen &= width[near] <= 2 * usual + 0.05
    filled = np.zeros(BINS, np.bool_)
    for k in near[chosen]:
        filled[int(height[k] / BIN_M)] = True
    begin, stop = longest_run(filled, 2)
    inside = (height[near] >= begin * BIN_M) & (height[near] < stop * BIN_M)
    own = near[chosen & inside]
    if not len(own):
        return
    points, others, rivals = count[own].sum(), 0, 0
    for i, k in enumerate(near):
        if inside[i] and not chosen[i] and away[i] <= AROUND_M:
            rivals += 1
            if away[i] <= 0.5 * usual + 0.25:
                others += count[k]
    wide = width[own]
    out[0], out[1] = (stop - begin) * BIN_M, np.log1p(len(own))
    out[2] = points / (points + others)
    out[3] = np.median(wide)
    out[4] = np.median(np.abs(wide - out[3])) / (out[3] + 0.02)
    out[5] = np.sqrt((away[chosen & inside] ** 2).mean())
    out[6], out[7] = (free[own] == 2).mean(), (free[own] == 1).mean()
    out[8] = points / len(own)
    out[9] = rivals / len(own)
    out[10] = filled[begin:stop].sum() / (stop - begin)
    out[11] = np.median(wide / (count[own] - 1))
    end[0], end[1] = begin * BIN_M, stop * BIN_M
