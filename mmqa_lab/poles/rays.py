"""What rays say: those that a shaft stops, those that pass beside it, those that pass where it is.

Foliage lets some rays through wherever it is; a shaft lets none through, over all its height. Along
a scan line pulses follow each other by equal angles, so that the pulses that pass an axis are known
from the points beside it, and what they hit, in front of the axis, at it or behind, is read from
the line. The place of the scanner is not needed: where one pulse hits leaves and the next one what
stands behind them, the step between the two points lies along the ray.
"""

import numpy as np
from numba import njit, prange

from mmqa_lab.poles.common import beside, near_axis, rows
from mmqa_lab.poles.features import BIN_M, BINS, longest_run, set_bits

REACH_M = 0.7
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
LOWEST_M = 0.2
HIGHEST_M = 7.0
MOST = 600
"""Of more rays every second, third, ... is tried; all count in the end."""

NAMES = (
    *("solid_m", "solid_run_m", "solid_rival_m", "rays_stopped", "rays_through"),
    *("rays_before", "stop_spread_m", "beside_open", "beside_closed", "beside_level"),
)
"""What the columns of :func:`describe` mean: height over which rays are stopped near the axis and
none passes, the longest piece of it, the same at the best place beside; log of the rays stopped,
share of those that reach the place and pass through, share that is stopped before; spread of the
stopped ones along the rays; of the rays beside, share that passes on the more and on the less open
side, and share that is stopped at the same depth."""


def describe(lines, axes, ground):
    """Return the features (k, len(NAMES)) of the rays at each axis.

    Parameters
    ----------
    lines : mmqa_lab.poles.profiles.Lines
    axes : array, shape (k, 5 or more)
        x, y at height ``middle`` above ground, lean x, lean y, middle.
    ground : array, shape (k,)
        Height of the ground at each.
    """
    chosen = beside(lines.points, axes[:, :2], REACH_M)
    found = rows(lines.points[chosen])
    features = np.zeros((len(axes), len(NAMES)))
    where = (found.points, found.start, found.base, chosen[found.order])
    _all(*lines, *where, np.ascontiguousarray(axes[:, :5]), ground, features)
    return features


@njit(cache=True, parallel=True)
def _all(points, line, pulse, near, plan, start, low, order, axes, ground, features):
    """Write the features of each axis."""
    for c in prange(len(axes)):
        ax, ay = axes[c, 0], axes[c, 1]
        close = near_axis(plan, start, low, ax, ay, REACH_M)
        n = 0
        for i in close:
            h = plan[i, 2] - ground[c]
            if LOWEST_M < h < HIGHEST_M:
                close[n] = order[i]
                n += 1
        if n < 3:
            continue
        close = np.sort(close[:n])
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
            step = np.hypot(dx, dy)
            if step > STEP_M:
                weight = min(step, 1.0) / step**2
                xx += weight * dx * dx
                xy += weight * dx * dy
                yy += weight * dy * dy
                total += min(step, 1.0)
    view = np.array([ax - ox, ay - oy])
    if total > 0:
        turn = 0.5 * np.arctan2(2 * xy, xx - yy)
        along = np.array([np.cos(turn), np.sin(turn)])
        view = along if (along * view).sum() > 0 else -along
    return view / max(np.sqrt((view**2).sum()), 1e-9)


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
    out, size, first = np.empty((64, 3)), 0, 0
    while slope != 0 and first < n:
        best, last = first, first
        while last < n and line[close[last]] == line[close[first]]:
            best = last if abs(u[last]) < abs(u[best]) else best
            last += 1
        first = last
        if abs(u[best]) <= NEAREST_M:
            rise = h[best] - axis[4]
            foot = np.array([axis[0] + axis[2] * rise, axis[1] + axis[3] * rise])
            middle = pulse[close[best]] - u[best] / slope
            added = size
            out, size = _read(
                points, line, pulse, close[best], middle, slope, foot, view, out, size
            )
            out[added:size, 2] = np.floor(h[best] / BIN_M)
    return out[:size]


@njit(cache=True)
def _read(points, line, pulse, at, middle, slope, foot, view, out, size):
    """Append the rays of one line, from point ``at`` to both sides; ``middle`` is at the axis."""
    for way in (-1, 1):
        i = at if way < 0 else at + 1
        while 0 <= i < len(line) and line[i] == line[at]:
            side = (pulse[i] - middle) * slope
            if abs(side) > WINDOW_M:
                break
            if size == len(out):
                grown = np.empty((2 * size, 3))
                grown[:size] = out
                out = grown
            dx, dy = points[i, 0] - foot[0], points[i, 1] - foot[1]
            out[size, 0], out[size, 1] = side, view[0] * dx + view[1] * dy
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
def _solid(rays, side, depth):
    """Bits of the height bins in which rays are stopped at a place and none passes it."""
    stopped, through = np.uint64(0), np.uint64(0)
    for k in range(len(rays)):
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
    step = max(len(rays) // MOST, 1)
    value = np.zeros((2 * SIDES + 1, 2 * DEPTHS + 1))
    best, chosen, place = -1.0, 0, 0
    for i in range(2 * SIDES + 1):
        side = (i - SIDES) * SIDE_M
        tried = rays[::step]
        tried = tried[np.abs(tried[:, 0] - side) <= HALF_M]
        for j in range(2 * DEPTHS + 1):
            value[i, j] = set_bits(_solid(tried, side, (j - DEPTHS) * DEEP_M))
            rank = value[i, j] - 0.01 * (abs(i - SIDES) + abs(j - DEPTHS))
            if abs(i - SIDES) <= SHIFTS and rank > best:
                best, chosen, place = rank, i, j
    side, depth = (chosen - SIDES) * SIDE_M, (place - DEPTHS) * DEEP_M
    bits = _solid(rays, side, depth)
    flags = np.zeros(BINS, np.bool_)
    for k in range(BINS):
        flags[k] = (bits >> np.uint64(k)) & np.uint64(1)
    begin, stop = longest_run(flags, 2)
    rival = 0.0
    for i in range(2 * SIDES + 1):
        if abs(i - chosen) >= APART:
            rival = max(rival, value[i].max())
    out[0], out[1], out[2] = set_bits(bits) * BIN_M, (stop - begin) * BIN_M, rival * BIN_M
    _shares(rays, begin, stop, side, depth, out[3:])


@njit(cache=True)
def _shares(rays, begin, stop, side, depth, out):
    """Write what becomes of the rays within the run, at the place and beside it."""
    stopped, through, before = 0.0, 0.0, 0.0
    total, square = 0.0, 0.0
    flank = np.zeros((2, 3))
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
    out[0], out[1] = np.log1p(stopped), through / max(stopped + through, 1)
    out[2] = before / max(stopped + through + before, 1)
    mean = total / max(stopped, 1)
    out[3] = np.sqrt(max(square / max(stopped, 1) - mean * mean, 0))
    sides = flank[:, 2] / np.maximum(flank.sum(axis=1), 1)
    out[4], out[5] = max(sides[0], sides[1]), min(sides[0], sides[1])
    out[6] = flank[:, 1].sum() / max(flank.sum(), 1)
