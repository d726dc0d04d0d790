"""What scan lines tell: the lines of a cloud, short groups of points on them, and rays.

Lines are as recorded, or recovered from time and scan angle.

Groups: a shaft cuts a short piece of about the same width out of one scan line after the other, at
the same place in plan; leaves do so at random places. Groups that stack up over a metre are
candidates, and how well they stack says what a cloud without its order cannot: whether points that
stand among foliage belong together.

Rays: foliage lets some through wherever it is; a shaft lets none through, over all its height.
Along a scan line pulses follow each other by equal angles, so that the pulses that pass an axis are
known from the points beside it, and what they hit, in front of the axis, at it or behind, is read
from the line. The place of the scanner is not needed: where one pulse hits leaves and the next one
what stands behind them, the step between the two points lies along the ray.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from mmqa_lab._compiled import in_threads, median, ranked, sort
from mmqa_lab.poles.common import beside, near_axis, rows
from mmqa_lab.poles.features import BIN_M, BINS, MAX_LEAN, fit_axis, longest_run, set_bits
from mmqa_lab.scan_pattern import revolutions_from_time


def scan_lines(cloud):
    """Return the scan line (n,) of each point of a cloud and its place along the line, or None.

    They are ``scan_line`` and ``pulse`` or ``gps_time``, or come from ``gps_time``, ``scan_angle``
    or both. Where there is a ``head`` or a ``point_source_id`` (one for each drive in LAS), lines
    of different heads and drives are not neighbours.

    A column whose values are all equal, as LAS files have it where nothing was recorded, says
    nothing. Without ``scan_line``, a line ends where the scan angle turns back by more than a
    quarter of its range while time runs on: this finds the turns of a full-circle profiler and the
    ends of an oscillating one. Without time, the points must lie in the order in which they were
    measured. From time alone, lines are cut in the pause that all revolutions share, the sky above
    the vehicle; without such a pause there is no answer.

    Examples
    --------
    >>> from mmqa_lab.cloud import Cloud
    >>> angle = np.tile(np.arange(-180.0, 180, 45), 3)
    >>> columns = {"gps_time": np.arange(24.0), "scan_angle": angle}
    >>> line, place = scan_lines(Cloud(np.zeros((24, 3)), columns))
    >>> line[[0, 7, 8, 23]].tolist()
    [0, 0, 1, 2]
    """
    source = _source(cloud)
    along = "pulse" if "pulse" in cloud else "gps_time"
    if "scan_line" in cloud and along in cloud:
        line, place = np.asarray(cloud["scan_line"], dtype=np.int64), cloud[along]
    elif _varies(cloud, "scan_angle"):
        order = cloud["gps_time"] if _varies(cloud, "gps_time") else np.arange(len(cloud))
        place = np.asarray(order, dtype=np.float64)
        line = _lines_by_angle(place, np.asarray(cloud["scan_angle"], dtype=np.float64), source)
    elif _varies(cloud, "gps_time"):
        place = np.asarray(cloud["gps_time"], dtype=np.float64)
        line = _lines_by_time(place, source)
    else:
        line = None
    if line is None:
        return None
    apart = np.ptp(line) + 10 if len(line) else 0  # lines of other heads are no neighbours
    return line - line.min(initial=0) + source * apart, np.asarray(place, dtype=np.float64)


def pulse_numbers(line, place):
    """Return pulses counted from 0 from places along lines that may be times.

    Times become numbers by their most frequent step; whole numbers stay as they are.
    """
    if not len(place) or np.array_equal(place, np.floor(place)):
        return place
    order = np.lexsort([place, line])
    steps = np.diff(place[order])[np.diff(line[order]) == 0]
    steps = steps[steps > 0]
    step = np.median(steps) if len(steps) else 1.0
    return np.round((place - place.min()) / step)


class Lines(NamedTuple):
    """Points in the order in which they were measured.

    ``points`` (n, 3), ``line`` (n,) numbered from 0, ``pulse`` (n,), ``near`` (lines, 2): a place
    in plan near the scanner at each line.
    """

    points: np.ndarray
    line: np.ndarray
    pulse: np.ndarray
    near: np.ndarray


def in_order(points, line, place):
    """Return the ``Lines`` of points (n, 3) with their line and place, as of ``scan_lines``."""
    pulse = np.asarray(pulse_numbers(line, place), float)  # searches are compiled for one kind
    order = np.lexsort([pulse, line])
    points, line, pulse = points[order], line[order], pulse[order]
    number = np.cumsum(np.diff(line, prepend=line[:1]) != 0)
    start = np.searchsorted(number, np.arange(number.max(initial=-1) + 2))
    near = np.zeros((len(start) - 1, 2))
    in_threads(_nearest, len(near), points, pulse, start, near)
    return Lines(points, number, pulse, near)


@njit(cache=True, nogil=True)
def _nearest(begin, end, points, pulse, start, near):
    """Where the points of each line lie closest: the foot of the scanner, or not far from it."""
    for k in range(begin, end):
        low, n = start[k], start[k + 1] - start[k]
        gap, sorting = np.empty(n), np.empty(n)
        for i in range(n):
            gap[i] = math.inf
            if i + 1 < n and pulse[low + i + 1] - pulse[low + i] == 1:
                gap[i] = _gap(points, low + i)
            sorting[i] = gap[i]
        least, x, y, count = ranked(sorting, n, n // 10), 0.0, 0.0, 0
        for i in range(n):
            if gap[i] <= least:
                x += points[low + i, 0]
                y += points[low + i, 1]
                count += 1
        near[k, 0], near[k, 1] = x / count, y / count


@njit(cache=True)
def _gap(points, k):
    """Distance of a point from the next one."""
    x, y = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    z = points[k + 1, 2] - points[k, 2]
    return math.sqrt(x * x + y * y + z * z)


def _varies(cloud, name):
    """Whether a cloud has a column with more than one value."""
    return name in cloud and len(cloud) > 0 and np.ptp(cloud[name]) > 0


def _source(cloud):
    """A number for each head and drive."""
    source = np.zeros(len(cloud), dtype=np.int64)
    for name in ("head", "point_source_id"):
        if name in cloud:
            _, number = np.unique(cloud[name], return_inverse=True)
            source = source * (number.max(initial=0) + 1) + number
    return source


def _lines_by_angle(time, angle, source):
    """Lines numbered along time, a new one where the angle turns back."""
    order = np.lexsort([angle, time, source])
    step = np.diff(angle[order])
    turned = step < -0.25 * np.ptp(angle) if len(angle) else step
    if not turned.any():
        turned = step > 0.25 * np.ptp(angle)
    line = np.empty(len(time), dtype=np.int64)
    line[order] = np.concatenate([[0], np.cumsum(turned)])
    return line


def _lines_by_time(time, source):
    """Lines cut in the pause of each source's revolutions, or None where one has none."""
    line = np.empty(len(time), dtype=np.int64)
    for number in np.unique(source):
        own = source == number
        try:
            line[own] = revolutions_from_time(time[own])
        except ValueError:
            return None
    return line


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

GROUPS_TO_M = 8.0
"""Groups higher above the ground are not looked at."""

STACK_NAMES = (
    *("stack_m", "stack_lines", "stack_share", "stack_width_m", "stack_width_spread"),
    *("stack_wobble_m", "free_both", "free_one", "stack_points_per_line", "stack_rivals"),
    *("stack_filled", "stack_spacing_m"),
)
"""What the columns of :func:`describe_stacks` mean: length of the stack of groups, log of their
number, their share of the points near the axis, their median width and its spread, how far they
stray from the axis, shares with two free ends and with one, points per group, groups nearby that
are not aligned for each that is, share of the stack's height bins with a group, median spacing of
points."""


class Groups(NamedTuple):
    """Groups sorted in plan rows.

    ``middle`` (m, 3); ``start`` and ``base`` as :func:`mmqa_lab.poles.common.near_axis` takes
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
    """Return the ``Groups`` of ``Lines``; ``height_of`` gives heights above ground of points."""
    points, line, pulse = lines[:3]
    first, last, free = _cut(points, line, pulse)
    count = last - first + 1
    ends = points[last] - points[first]
    middle = np.add.reduceat(points, first, axis=0) / count[:, None]
    kept = np.flatnonzero((count >= 2) & (np.sqrt((ends**2).sum(axis=1)) <= WIDEST_M))
    height = height_of(middle[kept])
    used = (height > 0.1) & (height < GROUPS_TO_M)
    found = rows(middle[kept[used]])
    kept, height = kept[used][found.order], height[used][found.order]
    return Groups(*found[:3], height, np.hypot(*ends[kept, :2].T), count[kept], free[kept])


@njit(cache=True)
def _cut(points, line, pulse):
    """First and last point of each group of sorted lines, and its number of free ends."""
    n = len(points)
    gap = np.full(n + 1, np.inf)
    for k in range(1, n):
        if line[k] == line[k - 1] and pulse[k] - pulse[k - 1] <= MISSING:
            gap[k] = _gap(points, k - 1)
    first, last, free = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    begin, groups = 0, 0
    for k in range(1, n + 1):
        if gap[k] <= GAP_M[0]:
            continue
        around = gap[max(k - 4, 0) : k + 5].copy()
        if gap[k] > min(3 * ranked(around, len(around), min(len(around) - 1, 2)), GAP_M[1]):
            first[groups], last[groups] = begin, k - 1
            free[groups] = (gap[begin] > FREE_M) + (gap[k] > FREE_M)
            begin, groups = k, groups + 1
    return first[:groups], last[:groups], free[:groups]


def stack_candidates(groups):
    """Return plan positions (k, 2) where groups stack up."""
    n = len(groups.middle)
    support, xy, top = np.zeros(n), np.zeros((n, 2)), np.zeros(n, bool)
    in_threads(_support, n, *groups[:5], support, xy)
    in_threads(_tops, n, *groups[:4], support, top)
    return xy[top]


@njit(cache=True, nogil=True)
def _support(begin, end, middle, start, low, height, width, support, xy):
    """Bins filled above and below each group, 0 without contrast, and the middle of its stack."""
    for g in range(begin, end):
        near = near_axis(middle, start, low, middle[g, 0], middle[g, 1], AROUND_M)
        bits, inside, around, x, y = np.uint64(0), 0, 0, 0.0, 0.0
        for k in near:
            rise = height[k] - height[g]
            if abs(rise) >= SPAN_M:
                continue
            away = math.hypot(middle[k, 0] - middle[g, 0], middle[k, 1] - middle[g, 1])
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


@njit(cache=True, nogil=True)
def _tops(begin, end, middle, start, low, height, support, top):
    """Whether the support of a group is the largest within 0.3 m in plan, first of equals."""
    for g in range(begin, end):
        if support[g] == 0:
            continue
        top[g] = True
        for k in near_axis(middle, start, low, middle[g, 0], middle[g, 1], 0.3):
            lower = height[k] < height[g] or (height[k] == height[g] and k < g)
            if support[k] > support[g] or (support[k] == support[g] and lower):
                top[g] = False
                break


def axes_of(middle, start, low, height, xy):
    """Return robust axes (k, 5) of the stacks at plan positions ``xy``."""
    out = np.zeros((len(xy), 5))
    in_threads(_axes, len(xy), middle, start, low, height, xy, out)
    return out


@njit(cache=True, nogil=True)
def _axes(begin, end, middle, start, low, height, xy, out):
    """Write the axes of :func:`axes_of`."""
    for c in range(begin, end):
        fit_axis(middle, height, start, low, xy[c], 0.4, (0.12, 0.04), 10, 2.0, out[c])


def describe_stacks(groups, axes):
    """Return the features (k, len(STACK_NAMES)) of the stack at each axis, and its ends (k, 2).

    ``axes`` (k, 5 or more): x, y at height ``middle`` above ground, lean x, lean y, middle.
    """
    features, ends = np.zeros((len(axes), len(STACK_NAMES))), np.zeros((len(axes), 2))
    in_threads(_stacks, len(axes), *groups, np.ascontiguousarray(axes[:, :5]), features, ends)
    return features, ends


@njit(cache=True, nogil=True)
def _stacks(begin, end, middle, start, low, height, width, count, free, axes, features, ends):
    """Write features and ends of each axis."""
    for c in range(begin, end):
        ax, ay, lx, ly, at = axes[c, 0], axes[c, 1], axes[c, 2], axes[c, 3], axes[c, 4]
        reach = AROUND_M + MAX_LEAN * GROUPS_TO_M / 2
        near = near_axis(middle, start, low, ax, ay, reach)
        away = np.empty(len(near))
        for i in range(len(near)):
            k = near[i]
            u = height[k] - at
            away[i] = math.hypot(middle[k, 0] - ax - lx * u, middle[k, 1] - ay - ly * u)
        _stack(near, away, height, width, count, free, features[c], ends[c])


@njit(cache=True)
def _stack(near, away, height, width, count, free, out, end):
    """Write features and ends of one axis; all zero where no group is aligned."""
    wide, n = np.empty(len(near)), np.int64(0)
    for i in range(len(near)):
        if away[i] <= ALIGNED_M:
            wide[n] = width[near[i]]
            n += 1
    if n == 0:
        return
    usual = median(wide, n)
    filled = np.zeros(BINS, np.bool_)
    for i in range(len(near)):
        if away[i] <= ALIGNED_M and width[near[i]] <= 2 * usual + 0.05:
            filled[int(height[near[i]] / BIN_M)] = True
    begin, stop = longest_run(filled, np.int64(2))
    spacing = np.empty(len(near))
    n, points, others, rivals, square, both, one = 0, 0, 0, 0, 0.0, 0, 0
    for i in range(len(near)):
        k = near[i]
        if not begin * BIN_M <= height[k] < stop * BIN_M:
            continue
        if away[i] <= ALIGNED_M and width[k] <= 2 * usual + 0.05:
            wide[n], spacing[n] = width[k], width[k] / (count[k] - 1)
            points += count[k]
            square += away[i] ** 2
            both += free[k] == 2
            one += free[k] == 1
            n += 1
        elif away[i] <= AROUND_M:
            rivals += 1
            if away[i] <= 0.5 * usual + 0.25:
                others += count[k]
    if n == 0:
        return
    out[0], out[1] = (stop - begin) * BIN_M, math.log1p(n)
    out[2], out[3] = points / (points + others), median(wide, n)
    for i in range(n):
        wide[i] = abs(wide[i] - out[3])
    out[4] = median(wide, n) / (out[3] + 0.02)
    out[5], out[6], out[7] = math.sqrt(square / n), both / n, one / n
    out[8], out[9] = points / n, rivals / n
    bins = 0
    for b in range(begin, stop):
        bins += filled[b]
    out[10] = bins / (stop - begin)
    out[11] = median(spacing, n)
    end[0], end[1] = begin * BIN_M, stop * BIN_M


RAYS_REACH_M = 0.7
"""Points within that distance of an axis tell the rays' direction and the pulses that pass it."""

STEP_M = 0.15
"""Consecutive points farther apart lie along the ray."""

NEAREST_M = 0.4
"""A line with no point so close beside the axis does not count."""

WINDOW_M = 0.5
"""Rays that pass the axis at that distance, to either side, are read."""

HALF_M = 0.05
DEPTH_M = 0.10
"""Half width and half depth of what stops rays."""

SIDE_M = 0.04
SIDES = 10
SHIFTS = 4
DEEP_M = 0.06
DEPTHS = 4
"""Places that are tried: steps across the rays, and how many of them are looked at and may be
chosen to either side; steps along the rays."""

APART = 4
"""A rival stands at least that many steps beside the chosen place."""

FLANK_M = (0.15, 0.4)
RAYS_FROM_M = 0.2
RAYS_TO_M = 7.0
MOST = 600
"""Of more rays every second, third, ... is tried; all count in the end."""

RAY_NAMES = (
    *("solid_m", "solid_run_m", "solid_rival_m", "rays_stopped", "rays_through"),
    *("rays_before", "stop_spread_m", "beside_open", "beside_closed", "beside_level"),
)
"""What the columns of :func:`describe_rays` mean: height over which rays are stopped near the axis
and none passes, the longest piece of it, the same at the best place beside; log of the rays
stopped, share of those that reach the place and pass through, share that is stopped before; spread
of the stopped ones along the rays; of the rays beside, share that passes on the more and on the
less open side, and share that is stopped at the same depth."""


def describe_rays(lines, axes, ground):
    """Return the features (k, len(RAY_NAMES)) of the rays at each axis.

    ``axes`` as of :func:`describe_stacks`; ``ground`` (k,): height of the ground at each.
    """
    chosen = beside(lines.points, axes[:, :2], RAYS_REACH_M)
    found = rows(lines.points[chosen])
    features = np.zeros((len(axes), len(RAY_NAMES)))
    where = (found.points, found.start, found.base, chosen[found.order])
    axes = np.ascontiguousarray(axes[:, :5])
    in_threads(_all, len(axes), *lines, *where, axes, ground, features)
    return features


@njit(cache=True, nogil=True)
def _all(begin, end, points, line, pulse, near, plan, start, low, order, axes, ground, features):
    """Write the features of each axis."""
    for c in range(begin, end):
        ax, ay = axes[c, 0], axes[c, 1]
        close = near_axis(plan, start, low, ax, ay, RAYS_REACH_M)
        n = 0
        for i in close:
            h = plan[i, 2] - ground[c]
            if RAYS_FROM_M < h < RAYS_TO_M:
                close[n] = order[i]
                n += 1
        if n < 3:
            continue
        close = close[:n]
        sort(close)
        view = _view(points, line, pulse, near, close, ax, ay)
        rays = _rays(points, line, pulse, close, view, axes[c], ground[c])
        if len(rays):
            _judge(rays, features[c])


@njit(cache=True)
def _view(points, line, pulse, near, close, ax, ay):
    """Direction of the rays in plan, away from the scanner, as a unit vector."""
    xx, xy, yy, total = 0.0, 0.0, 0.0, 0.0
    ox, oy = 0.0, 0.0
    for i in close:
        ox += near[line[i], 0] / len(close)
        oy += near[line[i], 1] / len(close)
        for j in (i - 1, i + 1):
            if not 0 <= j < len(line) or line[j] != line[i] or abs(pulse[j] - pulse[i]) > 3:
                continue
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            step = math.hypot(dx, dy)
            if step > STEP_M:
                weight = min(step, 1.0) / step**2
                xx += weight * dx * dx
                xy += weight * dx * dy
                yy += weight * dy * dy
                total += min(step, 1.0)
    u, v = ax - ox, ay - oy
    if total > 0:
        turn = 0.5 * math.atan2(2 * xy, xx - yy)
        c, s = math.cos(turn), math.sin(turn)
        u, v = (c, s) if c * u + s * v > 0 else (-c, -s)
    length = max(math.sqrt(u * u + v * v), 1e-9)
    return u / length, v / length


@njit(cache=True)
def _rays(points, line, pulse, close, view, axis, ground):
    """Distance beside the axis, depth behind it and height bin of each ray, (m, 3)."""
    n = len(close)
    u, h = np.empty(n), np.empty(n)
    for m in range(n):
        h[m] = points[close[m], 2] - ground
        dx = points[close[m], 0] - axis[0] - axis[2] * (h[m] - axis[4])
        dy = points[close[m], 1] - axis[1] - axis[3] * (h[m] - axis[4])
        u[m] = view[0] * dy - view[1] * dx
    slope = _slope(line, pulse, close, u)
    out, size, first = np.empty((64, 3)), np.int64(0), 0
    while slope != 0 and first < n:
        best, last = first, first
        while last < n and line[close[last]] == line[close[first]]:
            best = last if abs(u[last]) < abs(u[best]) else best
            last += 1
        first = last
        if abs(u[best]) <= NEAREST_M:
            rise = h[best] - axis[4]
            foot = axis[0] + axis[2] * rise, axis[1] + axis[3] * rise
            middle, level = pulse[close[best]] - u[best] / slope, math.floor(h[best] / BIN_M)
            there = close[best], middle, slope, foot, view, level
            out, size = _read(points, line, pulse, there, out, size)
    return out[:size]


@njit(cache=True)
def _read(points, line, pulse, there, out, size):
    """Append the rays of one line, from point ``at`` to both sides; ``middle`` is at the axis."""
    at, middle, slope, foot, view, level = there
    for way in (-1, 1):
        i = at if way < 0 else at + 1
        while 0 <= i < len(line) and line[i] == line[at]:
            side = (pulse[i] - middle) * slope
            if abs(side) > WINDOW_M:
                break
            if size == len(out):
                out = np.concatenate((out, out))
            dx, dy = points[i, 0] - foot[0], points[i, 1] - foot[1]
            out[size, 0], out[size, 1], out[size, 2] = side, view[0] * dx + view[1] * dy, level
            size += 1
            i += way
    return out, size


@njit(cache=True)
def _slope(line, pulse, close, u):
    """Metres beside the axis for each pulse, over all lines; 0 where it cannot be told."""
    across, along = 0.0, 0.0
    first, n = 0, len(close)
    while first < n:
        last, mean_u, mean_k = first, 0.0, 0.0
        while last < n and line[close[last]] == line[close[first]]:
            mean_u += u[last]
            mean_k += pulse[close[last]]
            last += 1
        mean_u /= last - first
        mean_k /= last - first
        for m in range(first, last):
            k = pulse[close[m]] - mean_k
            across += k * (u[m] - mean_u)
            along += k * k
        first = last
    if along == 0 or abs(across / along) < 1e-4:
        return 0.0
    return across / along


@njit(cache=True)
def _solid(rays, which, side, depth):
    """Bits of the height bins in which some of the rays are stopped at a place and none passes."""
    stopped, through = np.uint64(0), np.uint64(0)
    for k in which:
        if abs(rays[k, 0] - side) <= HALF_M and rays[k, 1] >= depth - DEPTH_M:
            bit = np.uint64(1) << np.uint64(rays[k, 2])
            if rays[k, 1] <= depth + DEPTH_M:
                stopped |= bit
            else:
                through |= bit
    return stopped & ~through


@njit(cache=True)
def _judge(rays, out):
    """Write the features of the rays about one axis."""
    step, which = max(len(rays) // MOST, 1), np.empty(len(rays), np.int64)
    value = np.zeros((2 * SIDES + 1, 2 * DEPTHS + 1))
    best, chosen, place = -1.0, 0, 0
    for i in range(2 * SIDES + 1):
        side, n = (i - SIDES) * SIDE_M, 0
        for k in range(0, len(rays), step):
            if abs(rays[k, 0] - side) <= HALF_M:
                which[n] = k
                n += 1
        for j in range(2 * DEPTHS + 1):
            value[i, j] = set_bits(_solid(rays, which[:n], side, (j - DEPTHS) * DEEP_M))
            rank = value[i, j] - 0.01 * (abs(i - SIDES) + abs(j - DEPTHS))
            if abs(i - SIDES) <= SHIFTS and rank > best:
                best, chosen, place = rank, i, j
    side, depth = (chosen - SIDES) * SIDE_M, (place - DEPTHS) * DEEP_M
    bits = _solid(rays, np.arange(len(rays)), side, depth)
    flags = np.zeros(BINS, np.bool_)
    for k in range(BINS):
        flags[k] = (bits >> np.uint64(k)) & np.uint64(1)
    begin, stop = longest_run(flags, np.int64(2))
    rival = 0.0
    for i in range(2 * SIDES + 1):
        for j in range(2 * DEPTHS + 1):
            if abs(i - chosen) >= APART:
                rival = max(rival, value[i, j])
    out[0], out[1], out[2] = set_bits(bits) * BIN_M, (stop - begin) * BIN_M, rival * BIN_M
    _shares(rays, begin, stop, side, depth, out[3:])


@njit(cache=True)
def _shares(rays, begin, stop, side, depth, out):
    """Write what becomes of the rays within the run, at the place and beside it."""
    stopped, through, before = 0.0, 0.0, 0.0
    total, square = 0.0, 0.0
    flank = np.zeros((3, 3))
    for k in range(len(rays)):
        if not begin <= rays[k, 2] < stop:
            continue
        away, behind = rays[k, 0] - side, rays[k, 1] - depth
        fate = 0 if behind < -DEPTH_M else (1 if behind <= DEPTH_M else 2)
        if abs(away) <= HALF_M:
            before += fate == 0
            through += fate == 2
            if fate == 1:
                stopped += 1
                total += behind
                square += behind * behind
        elif FLANK_M[0] <= abs(away) <= FLANK_M[1]:
            flank[int(away > 0), fate] += 1
            flank[2, fate] += 1
    out[0], out[1] = math.log1p(stopped), through / max(stopped + through, 1)
    out[2] = before / max(stopped + through + before, 1)
    mean = total / max(stopped, 1)
    out[3] = math.sqrt(max(square / max(stopped, 1) - mean * mean, 0))
    left = flank[0, 2] / max(flank[0, 0] + flank[0, 1] + flank[0, 2], 1)
    right = flank[1, 2] / max(flank[1, 0] + flank[1, 1] + flank[1, 2], 1)
    out[4], out[5] = max(left, right), min(left, right)
    out[6] = flank[2, 1] / max(flank[2, 0] + flank[2, 1] + flank[2, 2], 1)
