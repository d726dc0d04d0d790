"""Features of a candidate: its axis, its emptiness over height and azimuth, what stands around it.

Everything is counted in height bins that are occupied or not, in sectors and in shares, rather than
in points: a denser scanner changes them little.
"""

import math

import numpy as np
from numba import njit

from mmqa_lab._compiled import in_threads, median, ranked
from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.poles.common import near_axis, rows

GRID_M = 0.1
BIN_M = 0.25
BINS = 64
LEAST_BINS = 3
TILE_M = 80.0
MARGIN_M = 1.0

SCALES = ((1, 4), (2, 5), (4, 7), (1, 0))
"""Half width of the core and of the ring around it, in cells; a ring of 0 asks for no emptiness."""


def candidates(points, height):
    """Return plan positions (k, 2) of candidates.

    ``points`` (n, 3) are metres from an origin nearby; of their ``height`` (n,) above ground only
    0.1 to 16 m are used. On each scale in ``SCALES`` a candidate is a cell whose count of occupied
    core bins with an empty ring is a local maximum, at least 3; ties go to the cell with more
    points.
    """
    used = (height > 0.1) & (height < BINS * BIN_M)
    points, height = points[used], height[used]
    if not len(points):
        return np.empty((0, 2))
    xy = points[:, :2]
    origin = np.floor(xy.min(axis=0) / GRID_M) * GRID_M
    tile = np.floor((xy - origin) / TILE_M).astype(np.int64)
    key = tile[:, 0] * (tile[:, 1].max() + 2) + tile[:, 1]
    tiles = tile[np.unique(key, return_index=True)[1]]
    return np.concatenate([_tile(xy, height, tile, origin) for tile in tiles])


def _tile(xy, height, tile, origin):
    """Candidates whose cell lies in one tile."""
    low = origin + tile * TILE_M
    inside = ((xy >= low - MARGIN_M) & (xy < low + TILE_M + MARGIN_M)).all(axis=1)
    place = np.floor((xy[inside] - (low - MARGIN_M)) / GRID_M).astype(np.int64)
    size = round((TILE_M + 2 * MARGIN_M) / GRID_M)
    border = round(MARGIN_M / GRID_M)
    level = (height[inside] / BIN_M).astype(np.int64)
    cells, count = _bits(place, level, size)
    found = _maxima(cells, count, border, np.array(SCALES))
    return low - MARGIN_M + (found + 0.5) * GRID_M


@njit(cache=True)
def _bits(place, level, size):
    """Occupied height bins and points of each cell."""
    cells = np.zeros((size, size), np.uint64)
    count = np.zeros((size, size), np.int32)
    for k in range(len(place)):
        i, j = min(place[k, 0], size - 1), min(place[k, 1], size - 1)
        cells[i, j] |= np.uint64(1) << np.uint64(level[k])
        count[i, j] += 1
    return cells, count


@njit(cache=True)
def set_bits(bits):
    """Number of set bits."""
    n = 0
    while bits:
        bits &= bits - np.uint64(1)
        n += 1
    return n


@njit(cache=True)
def _spread(cells, half):
    """Every cell with the bits of the square of half width ``half`` around it."""
    size = len(cells)
    along, both = np.zeros_like(cells), np.zeros_like(cells)
    for i in range(size):
        for j in range(size):
            if cells[i, j]:
                for m in range(max(j - half, 0), min(j + half + 1, size)):
                    along[i, m] |= cells[i, j]
    for i in range(size):
        for j in range(size):
            if along[i, j]:
                for m in range(max(i - half, 0), min(i + half + 1, size)):
                    both[m, j] |= along[i, j]
    return both


@njit(cache=True)
def _ring(cells, i, j, half):
    """Bits on the square ring of half width ``half``, two cells thick."""
    bits = np.uint64(0)
    for h in (half - 1, half):
        for m in range(-h, h + 1):
            bits |= cells[i - h, j + m] | cells[i + h, j + m]
            bits |= cells[i + m, j - h] | cells[i + m, j + h]
    return bits


@njit(cache=True)
def _maxima(cells, count, border, scales):
    """Cells (i, j) that are local maxima of clean bins on one of the scales."""
    size, n = len(cells), 0
    found = np.empty((len(scales) * (size // 4 + 1) ** 2, 2), np.int64)  # tops are 4 cells apart
    for scale in range(len(scales)):
        core, ring = scales[scale, 0], scales[scale, 1]
        value = np.zeros((size, size), np.float32)
        bits = _spread(cells, core)
        for i in range(border - 5, size - border + 5):
            for j in range(border - 5, size - border + 5):
                if cells[i, j] and bits[i, j]:
                    value[i, j] = _height_of(bits[i, j], cells, count, i, j, core, ring)
        reach = max(core + 1, 3)
        for i in range(border, size - border):
            for j in range(border, size - border):
                if value[i, j] > 0 and _is_top(value, i, j, reach):
                    found[n, 0], found[n, 1] = i, j
                    n += 1
    return found[:n]


@njit(cache=True)
def _height_of(clean, cells, count, i, j, core, ring):
    """The number of clean bins of a cell and its share of points; 0 where they are too few."""
    if ring:
        clean &= ~_ring(cells, i, j, ring)
    k = set_bits(clean)
    return k + _share(count, i, j, core) if k >= LEAST_BINS else 0.0


@njit(cache=True)
def _share(count, i, j, core):
    """A number below one that grows with the points in the core, most with those in its middle."""
    n = 4.0 * count[i, j]
    for a in range(i - core, i + core + 1):
        for b in range(j - core, j + core + 1):
            n += count[a, b]
    return n / (n + 50.0)


@njit(cache=True)
def _is_top(value, i, j, reach):
    """Whether no cell within reach is higher, or as high and earlier."""
    for a in range(i - reach, i + reach + 1):
        for b in range(j - reach, j + reach + 1):
            if value[a, b] > value[i, j]:
                return False
            if value[a, b] == value[i, j] and (a < i or (a == i and b < j)):
                return False
    return True


RADII_M = np.array([0.06, 0.10, 0.15, 0.20, 0.30, 0.40])
SHELL_M = 0.25
CLEAN = 0.15
"""A bin is clean when the shell has at most this share of the points in the core."""

NARROW = 0.6
"""The core is the narrowest whose clean run is that share of the longest: boards stay outside."""

SECTORS = 12
REACH_M = 2.0
CELL_M = 0.2
HALF = 5
"""Slabs are looked for in plan cells of 0.2 m, within 1 m of the axis."""

CROWD_M, SHAFT_TOP_M = 0.7, 5.0
"""Points so near to the axis, and so high, are a crowd; shafts are fitted to points so high."""

MAX_LEAN = 0.27
"""Largest lean that an axis may take, m/m (15 degrees)."""

NAMES = (
    *(f"clean_run_{int(100 * r):02d}_m" for r in RADII_M),
    *("radius_m", "run_m", "run_low_m", "run_high_m", "column_m", "column_high_m"),
    *("run_share", "column_share", "run_points", "run_points_per_m", "run_filled"),
    *("mean_across", "spread_across", "median_across_m", "wide_across_m", "taper"),
    *("tilt_deg", "wobble_m", "sectors_near", "empty_arc", "opposite_near"),
    *("beside_050", "beside_100", "beside_200", "sectors_100", "sectors_200", "opposite_200"),
    *("flatness", "off_line_m", "above_core", "above_shell", "below_shell"),
    *("slab_above", "slab_below", "highest_200_m", "inner_count_share", "elongation"),
    *("below_core", "crowd"),
)
"""What the columns of :func:`describe` mean; ``across`` is the distance from the axis.

``beside_R``: share of the run's height bins with points between the last radius and R cm;
``flatness``: how much what stands beside lies on a line in plan; ``off_line_m``: how far the axis
stands from that line; ``slab``: share of the plan around occupied right above or below the run;
``below_core``: share of the height bins between the ground and the run with points in the core;
``crowd``: log of the points around the axis, up to 5 m above the ground.
"""


RINGS_M = np.array([0.6, 1.5, 3.0, 5.0])
BANDS_M = np.array([0.1, 1.0, 2.5, 5.0, 9.0, 16.0])
"""Of what stands around: distances from the axis and heights above the ground. Walls, crowns, cars
and fences fill other bands and rings than a pole among them."""

AROUND_NAMES = tuple(
    f"{what}_band{band}_ring{ring}"
    for band in range(len(BANDS_M) - 1)
    for ring in range(len(RINGS_M) - 1)
    for what in ("arcs", "cells")
)
"""Share of the 24 arcs of a ring with points in a band of heights, and log of its plan cells."""


@njit(cache=True)
def fit_axis(points, height, start, base, at, out):
    """Write a robust straight axis (x, y at h = middle, lean x, lean y, middle) near ``at``.

    Twelve steps of iteratively reweighted least squares of the points within 0.5 m, with
    Geman-McClure weights whose scale shrinks from 0.15 to 0.06 m; a moment of 1 m2 draws leans
    towards 0.
    """
    near, n, middle = near_axis(points, start, base, at[0], at[1], 0.5 + 1e-9), 0, 0.0
    x, y, h = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
    for i in near:
        x[n], y[n], h[n] = points[i, 0], points[i, 1], height[i]
        if 0.1 < h[n] < BINS * BIN_M and math.hypot(x[n] - at[0], y[n] - at[1]) < 0.5:
            middle += h[n]
            n += 1
    middle /= max(n, 1)
    ax, ay, lx, ly = at[0], at[1], 0.0, 0.0
    for step in range(12):
        scale = max(0.15 * 0.85**step, 0.06)
        w0, w1, w2 = 1e-9, 0.0, 0.0
        sx, sy, tx, ty = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            u = h[k] - middle
            dx, dy = x[k] - ax - lx * u, y[k] - ay - ly * u
            w = 1.0 / (1.0 + (dx * dx + dy * dy) / (scale * scale)) ** 2
            w0 += w
            w1 += w * u
            w2 += w * u * u
            sx += w * x[k]
            sy += w * y[k]
            tx += w * x[k] * u
            ty += w * y[k] * u
        w2 += 1.0
        det = w0 * w2 - w1 * w1
        ax, lx = (w2 * sx - w1 * tx) / det, (w0 * tx - w1 * sx) / det
        ay, ly = (w2 * sy - w1 * ty) / det, (w0 * ty - w1 * sy) / det
        lx, ly = min(max(lx, -MAX_LEAN), MAX_LEAN), min(max(ly, -MAX_LEAN), MAX_LEAN)
    out[0], out[1], out[2], out[3], out[4] = ax, ay, lx, ly, middle


@njit(cache=True)
def longest_run(flags):
    """First and last + 1 of the longest run of set flags, gaps of one bin allowed."""
    best_low, best_high = 0, 0
    low, last = -1, -1
    for k in range(len(flags)):
        if flags[k]:
            if low < 0 or k - last > 2:
                low = k
            last = k
            if last + 1 - low > best_high - best_low:
                best_low, best_high = low, last + 1
    return best_low, best_high


@njit(cache=True)
def _profile(across, level, radius, core, shell):
    """Points of each height bin within the radius and in the shell around it."""
    for k in range(BINS):
        core[k], shell[k] = 0, 0
    for k in range(len(across)):
        if across[k] <= radius:
            core[level[k]] += 1
        elif across[k] <= radius + SHELL_M:
            shell[level[k]] += 1


@njit(cache=True)
def _flatness(xx, xy, yy):
    """1 - smaller over larger eigenvalue of a plan covariance, and the direction of the larger."""
    mean, half = (xx + yy) / 2, math.sqrt((xx - yy) ** 2 / 4 + xy * xy)
    if mean + half <= 0:
        return 0.0, 0.0
    return 1 - (mean - half) / (mean + half), 0.5 * math.atan2(2 * xy, xx - yy)


@njit(cache=True)
def _arc(sectors):
    """Longest empty arc and number of opposite occupied pairs of a circle of sectors."""
    empty, longest, opposite = 0, 0, 0
    n = len(sectors)
    for k in range(2 * n):
        empty = 0 if sectors[k % n] else min(empty + 1, n)
        longest = max(longest, empty)
    for k in range(n // 2):
        opposite += sectors[k] and sectors[k + n // 2]
    return longest, opposite


@njit(cache=True)
def _describe(dx, dy, across, level, axis, out):
    """Write the features; ends and radius of the pole-like part go into ``axis``."""
    f = len(RADII_M)
    core, shell = np.zeros(BINS), np.zeros(BINS)
    runs, flags, longest = np.zeros((f, 2), np.int64), np.zeros(BINS, np.bool_), 0.0
    for r in range(f):
        _profile(across, level, RADII_M[r], core, shell)
        for k in range(BINS):
            flags[k] = core[k] > 0 and shell[k] <= CLEAN * core[k]
        runs[r, 0], runs[r, 1] = longest_run(flags)
        out[r] = (runs[r, 1] - runs[r, 0]) * BIN_M
        longest = max(longest, out[r])
    r = 0
    while out[r] < NARROW * longest:
        r += 1
    low, high, radius = runs[r, 0], runs[r, 1], RADII_M[r]
    _profile(across, level, radius, core, shell)
    for k in range(BINS):
        flags[k] = core[k] > 0
    first, last = longest_run(flags)
    if high == low:
        low, high = first, last
    run = max(high - low, 1)
    out[f], out[f + 1], out[f + 2], out[f + 3] = radius, run * BIN_M, low * BIN_M, high * BIN_M
    out[f + 4], out[f + 5] = (last - first) * BIN_M, last * BIN_M
    dense = _sum(core, low, high)
    out[f + 6] = dense / max(dense + _sum(shell, low, high), 1.0)
    whole = _sum(core, first, last)
    out[f + 7] = whole / max(whole + _sum(shell, first, last), 1.0)
    out[f + 8], out[f + 9] = math.log1p(dense), math.log1p(dense / (run * BIN_M))
    out[f + 10] = _filled(core, low, high) / run
    _shape(dx, dy, across, level, low, high, radius, out[f + 11 :])
    out[f + 16] = math.degrees(math.atan(math.hypot(axis[2], axis[3])))
    _beside(dx, dy, across, level, low, high, radius, out[f + 18 :])
    _around(dx, dy, across, level, low, high, radius, out[f + 27 :])
    top = min(high + 8, BINS)
    out[f + 29], out[f + 30] = _filled(core, high, top) / 8, _filled(shell, high, top) / 8
    out[f + 31] = _filled(shell, 0, low) / max(low, 1)
    out[f + 35] = _sum(core, 0, BINS) / max(len(dx), 1)
    out[f + 37], crowd = _filled(core, 0, low) / max(low, 1), 0
    for k in range(len(dx)):
        crowd += level[k] * BIN_M < SHAFT_TOP_M and math.hypot(dx[k], dy[k]) < CROWD_M
    out[f + 38] = math.log1p(crowd)
    axis[5], axis[6], axis[7] = low * BIN_M, high * BIN_M, radius


@njit(cache=True)
def _sum(values, first, last):
    """Sum of a stretch of an array."""
    total = 0.0
    for k in range(first, last):
        total += values[k]
    return total


@njit(cache=True)
def _filled(counts, first, last):
    """Number of bins of a stretch with points."""
    n = 0
    for k in range(first, last):
        n += counts[k] > 0
    return n


@njit(cache=True)
def _shape(dx, dy, across, level, low, high, radius, out):
    """Distances from the axis within the run: mean, spread, median, 90 %, taper.

    At place 6 the root mean square distance of the bins' centres from the axis, at place 25 the
    length of the run over twice the median distance.
    """
    rho, lower, upper = np.empty(len(across)), np.empty(len(across)), np.empty(len(across))
    sums, n, above = np.zeros((BINS, 3)), 0, 0
    total, half = 0.0, (low + high) / 2
    for k in range(len(across)):
        if low <= level[k] < high and across[k] <= radius:
            rho[n] = across[k]
            if level[k] < half:
                lower[n - above] = across[k]
            else:
                upper[above] = across[k]
                above += 1
            total += across[k]
            n += 1
            sums[level[k], 0] += dx[k]
            sums[level[k], 1] += dy[k]
            sums[level[k], 2] += 1
    wobble, bins = 0.0, 0
    for b in range(low, high):
        if sums[b, 2] > 0:
            wobble += (sums[b, 0] / sums[b, 2]) ** 2 + (sums[b, 1] / sums[b, 2]) ** 2
            bins += 1
    out[6] = math.sqrt(wobble / max(bins, 1))
    mean, square = total / max(n, 1), 0.0
    for k in range(n):
        square += (rho[k] - mean) * (rho[k] - mean)
    if n:
        out[25] = min((high - low) * BIN_M / (2 * median(rho, n) + 0.01), 100.0)
    if n < 2:
        return
    out[0], out[1] = mean / radius, math.sqrt(square / n) / radius
    out[2], out[3] = ranked(rho, n, n // 2), ranked(rho, n, int(0.9 * (n - 1)))
    if above > 1 and n - above > 1:
        out[4] = (median(upper, above) - median(lower, n - above)) / radius


@njit(cache=True)
def _beside(dx, dy, across, level, low, high, radius, out):
    """What stands beside the run, by distance and azimuth: 9 numbers."""
    held, sectors = np.zeros((3, BINS)), np.zeros((4, SECTORS), np.bool_)
    for k in range(len(dx)):
        if level[k] < low or level[k] >= high or across[k] <= radius + 0.03:
            continue
        ring = 0 if across[k] <= 0.5 else (1 if across[k] <= 1.0 else 2)
        held[ring, level[k]] = 1
        turn = (math.atan2(dy[k], dx[k]) / (2 * np.pi)) % 1.0
        sector = min(int(turn * SECTORS), SECTORS - 1)
        sectors[ring, sector] = sectors[3, sector] = True
    run = max(high - low, 1)
    empty, opposite = _arc(sectors[0])
    out[1], out[2], out[8] = empty, opposite, _arc(sectors[3])[1]
    for k in range(SECTORS):
        out[0] += sectors[0, k]
        out[6] += sectors[1, k]
        out[7] += sectors[2, k]
    for ring in range(3):
        out[3 + ring] = _sum(held[ring], 0, BINS) / run


@njit(cache=True)
def _around(dx, dy, across, level, low, high, radius, out):
    """Lines and slabs around the run, and the highest point: numbers 0, 1, 5, 6 and 7."""
    above, below = np.zeros((2 * HALF) ** 2), np.zeros((2 * HALF) ** 2)
    n, u, v, uu, uv, vv, highest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for k in range(len(dx)):
        i, j = math.floor(dx[k] / CELL_M), math.floor(dy[k] / CELL_M)
        highest = max(highest, level[k])
        if -HALF <= i < HALF and -HALF <= j < HALF:
            cell = (i + HALF) * 2 * HALF + j + HALF
            if high <= level[k] < high + 2:
                above[cell] = 1
            if low - 2 <= level[k] < low:
                below[cell] = 1
        if low <= level[k] < high and across[k] > radius + 0.03:
            n += 1
            u += dx[k]
            v += dy[k]
            uu += dx[k] * dx[k]
            uv += dx[k] * dy[k]
            vv += dy[k] * dy[k]
    out[0], out[1] = 0.0, REACH_M
    if n >= 5:
        u, v, uu, uv, vv = u / n, v / n, uu / n, uv / n, vv / n
        out[0], turn = _flatness(uu - u**2, uv - u * v, vv - v**2)
        out[1] = abs(u * math.sin(turn) - v * math.cos(turn))
    out[5] = _sum(above, 0, len(above)) / len(above)
    out[6] = _sum(below, 0, len(below)) / len(below)
    out[7] = highest * BIN_M


def describe(where, xy, given):
    """Return features (k, len(NAMES)) and axes (k, 8) of candidates at ``xy`` (k, 2).

    ``where``: points, height (n,) above ground, start and base, as of
    :func:`mmqa_lab.poles.common.rows`; ``given`` (k, 5): axes that are known (x, y, lean x, lean y,
    middle), NaN where they are to be fitted. ``axes``: x, y, lean x, lean y at height ``middle``
    above ground, then that height, lower and upper end of the pole-like part above ground, radius
    of the core.
    """
    features, axes = np.zeros((len(xy), len(NAMES))), np.zeros((len(xy), 8))
    in_threads(_candidates, len(xy), *where, xy, given, features, axes)
    return features, axes


@njit(cache=True, nogil=True)
def _candidates(begin, end, points, height, start, base, xy, given, features, axes):
    """Write the features and the axes of the candidates from ``begin`` to ``end``."""
    for c in range(begin, end):
        axis = axes[c]
        for k in range(5):
            axis[k] = given[c, k]
        if math.isnan(axis[0]):
            fit_axis(points, height, start, base, xy[c], axis)
        near, n = near_axis(points, start, base, xy[c, 0], xy[c, 1], REACH_M), 0
        dx, dy, across = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
        level = np.empty(len(near), np.int64)
        for i in near:
            if 0.1 < height[i] < BINS * BIN_M:
                rise = height[i] - axis[4]
                dx[n] = points[i, 0] - axis[0] - axis[2] * rise
                dy[n] = points[i, 1] - axis[1] - axis[3] * rise
                across[n] = math.sqrt(dx[n] * dx[n] + dy[n] * dy[n])
                level[n] = int(height[i] / BIN_M)
                n += 1
        _describe(dx[:n], dy[:n], across[:n], level[:n], axis, features[c])


SHAFT_M = (0.02, 0.55)
THIN_M = np.array([0.03, 0.05, 0.08, 0.12, 0.18])
CENTRE_M, SEEN_M = 0.6, 1.0
CIRCLES, TRIED = 160, 200
ARCS, SEEN_ARCS = 24, 10
"""Upright shafts of any width: least and largest radius, radii tried about the axis itself, how far
from the axis the centre of others and the points may lie. Circles are drawn through three points,
and of more than 200 points every second, third, ... is tried; of 24 arcs of a circle ten are seen
from one side."""

ROUND_NAMES = (
    *("round_radius_m", "round_m", "round_share", "round_arc", "round_even", "round_head"),
    *("round_points", "round_slender", "round_width", "round_width_spread"),
)
"""Of the best circle: its radius; length over which it has points and neither its inside nor what
lies around it, up to two radii, has many; share on it of the points up to two radii; share of its
arcs that are seen; spread over height of the mean distance from its centre, by the radius; points
of the same column up to 0.75 m above that length, by those of one of its bins; log of the points a
metre; length over diameter; width across the view by the diameter, and its spread over height."""


@njit(cache=True)
def _shell(r):
    """Distances between which points are on a circle, and up to which they are around it."""
    band = 0.03 + 0.05 * r
    return r - band, r + band, max(2 * r, r + 0.15)


@njit(cache=True)
def _arc_of(u, v):
    """Number of the arc in a direction."""
    return min(int((math.atan2(v, u) / (2 * np.pi) % 1.0) * ARCS), ARCS - 1)


@njit(cache=True)
def _circle_value(x, y, bit, cx, cy, r):
    """How good a circle is: bins without points inside, share on it, arc that is seen."""
    low, high, outer = _shell(r)
    held, inner, beyond, arc = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
    on, off = 0, 0
    for k in range(len(x)):
        u, v = x[k] - cx, y[k] - cy
        if u * u + v * v > outer * outer:
            continue
        d = math.sqrt(u * u + v * v)
        if low <= d <= high:
            held |= bit[k]
            on += 1
            arc |= np.uint64(1) << np.uint64(_arc_of(u, v))
            continue
        off += 1
        if d > high:
            beyond |= bit[k]
        else:
            inner |= bit[k]
    clean = set_bits(held & ~inner) + set_bits(held & ~inner & ~beyond)
    return clean * (on / (on + off + 1.0)) * (0.3 + min(set_bits(arc), SEEN_ARCS) / SEEN_ARCS)


@njit(cache=True)
def _through(x, y, i, j, k):
    """Centre and radius of the circle through three points; radius 0 where they lie on a line."""
    bx, by, cx, cy = x[j] - x[i], y[j] - y[i], x[k] - x[i], y[k] - y[i]
    d = 2 * (bx * cy - by * cx)
    if abs(d) < 1e-5:
        return 0.0, 0.0, 0.0
    bb, cc = bx * bx + by * by, cx * cx + cy * cy
    u, v = (cy * bb - by * cc) / d, (bx * cc - cx * bb) / d
    return x[i] + u, y[i] + v, math.sqrt(u * u + v * v)


@njit(cache=True)
def _fitted(x, y, cx, cy, r):
    """The circle after four steps of Gauss and Newton, slightly held where it was."""
    for _ in range(4):
        xx, xy, x1, yy, y1, n, xe, ye, e1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        reach = 1.5 * (0.03 + 0.05 * r)
        for k in range(len(x)):
            u, v = x[k] - cx, y[k] - cy
            d = math.sqrt(u * u + v * v)
            e = d - r
            if abs(e) > reach or d < 1e-6:
                continue
            p, q = u / d, v / d
            xx, xy, x1, yy, y1, n = xx + p * p, xy + p * q, x1 + p, yy + q * q, y1 + q, n + 1.0
            xe, ye, e1 = xe + p * e, ye + q * e, e1 + e
        if n < 3:
            break
        damp = 0.05 * n
        xx, yy, n = xx + damp, yy + damp, n + damp
        a, b, c = yy * n - y1 * y1, xy * n - y1 * x1, xy * y1 - yy * x1
        det = xx * a - xy * b + x1 * c
        if abs(det) < 1e-9:
            break
        s, t, w = ye * n - y1 * e1, ye * y1 - yy * e1, xy * e1 - ye * x1
        cx += (xe * a - xy * s + x1 * t) / det
        cy += (xx * s - xe * b + x1 * w) / det
        r = min(max(r + (-xx * t - xy * w + xe * c) / det, SHAFT_M[0]), SHAFT_M[1])
    return cx, cy, r


@njit(cache=True)
def _best_circle(h, x, y):
    """Centre and radius of the best of the circles tried on the points up to 5 m."""
    low, n = np.empty(len(h), np.int64), 0
    for k in range(len(h)):
        if h[k] < SHAFT_TOP_M:
            low[n] = k
            n += 1
    step = max(-(-n // TRIED), 1)
    n = (n + step - 1) // step
    u, v, bit = np.empty(n), np.empty(n), np.empty(n, np.uint64)
    for k in range(n):
        i = low[k * step]
        u[k], v[k], bit[k] = x[i], y[i], np.uint64(1) << np.uint64(h[i] / BIN_M)
    best, bx, by, br = -1.0, 0.0, 0.0, THIN_M[0]
    state = np.uint64(88172645463325252)  # of Marsaglia's xorshift
    for k in range(len(THIN_M) + (CIRCLES if n >= 3 else 0)):
        cx, cy, r = 0.0, 0.0, THIN_M[min(k, len(THIN_M) - 1)]
        if k >= len(THIN_M):
            state ^= state << np.uint64(13)
            state ^= state >> np.uint64(7)
            state ^= state << np.uint64(17)
            i, j = state % np.uint64(n), (state >> np.uint64(20)) % np.uint64(n)
            cx, cy, r = _through(u, v, i, j, (state >> np.uint64(40)) % np.uint64(n))
        if SHAFT_M[0] <= r <= SHAFT_M[1] and cx * cx + cy * cy <= CENTRE_M**2:
            value = _circle_value(u, v, bit, cx, cy, r)
            if value > best:
                best, bx, by, br = value, cx, cy, r
    cx, cy, r = _fitted(u, v, bx, by, br)
    return (cx, cy, r) if _circle_value(u, v, bit, cx, cy, r) >= best else (bx, by, br)


@njit(cache=True)
def _round(h, x, y, out):
    """Write what the shaft with the best circle is like."""
    cx, cy, r = _best_circle(h, x, y)
    least, most, outer = _shell(r)
    d, level, held = np.empty(len(h)), np.empty(len(h), np.int64), np.zeros((4, BINS))
    for k in range(len(h)):
        x[k], y[k], level[k] = x[k] - cx, y[k] - cy, int(h[k] / BIN_M)
        d[k] = math.sqrt(x[k] * x[k] + y[k] * y[k])
        if d[k] <= outer:
            held[2 if d[k] > most else (1 if d[k] < least else 0), level[k]] += 1
        if d[k] <= most:
            held[3, level[k]] += d[k]
    on, inside, beside = held[0], held[1], held[2]
    flags, column = np.zeros(BINS, np.bool_), np.zeros(BINS, np.bool_)
    for b in range(BINS):
        column[b] = on[b] + inside[b] > 0
        flags[b] = on[b] > 0 and inside[b] <= CLEAN * on[b] and beside[b] <= CLEAN * on[b]
    low, high = longest_run(flags)
    clean = (high - low) * BIN_M
    if high == low:
        low, high = longest_run(column)
    own, within, around = _sum(on, low, high), _sum(inside, low, high), _sum(beside, low, high)
    bins, wide = max(high - low, 1), max(r, 0.05)
    out[0], out[1], out[2] = r, clean, own / max(own + within + around, 1.0)
    above = min(high + 3, BINS)
    head = _sum(on, high, above) + _sum(inside, high, above)
    out[5] = head / max((own + within) / bins, 1.0)
    out[6], out[7] = math.log1p(own / (bins * BIN_M)), clean / (2 * r)
    arc, mean = np.uint64(0), np.empty(BINS)
    for k in range(len(h)):
        if low <= level[k] < high and least <= d[k] <= most:
            arc |= np.uint64(1) << np.uint64(_arc_of(x[k], y[k]))
    out[3], n = set_bits(arc) / ARCS, 0
    for b in range(low, high):
        if on[b] + inside[b] >= 2:
            mean[n] = held[3, b] / (on[b] + inside[b])
            n += 1
    out[4] = _spread_of(mean, n) / wide
    _across(x, y, d, level, (low, high), most, out[8:])
    out[8] /= 2 * max(r, 0.03) if out[9] >= 0 else 1.0


@njit(cache=True)
def _spread_of(values, n):
    """Standard deviation of the first n numbers."""
    mean, square = _sum(values, 0, n) / max(n, 1), 0.0
    for k in range(n):
        square += (values[k] - mean) ** 2
    return math.sqrt(square / max(n, 1))


@njit(cache=True)
def _across(x, y, d, level, run, reach, out):
    """Write the median and the relative spread of the width of the bins across the view."""
    low, high = run
    u, v = 0.0, 0.0
    for k in range(len(d)):
        if low <= level[k] < high and 1e-6 < d[k] <= reach:
            u, v = u + x[k] / d[k], v + y[k] / d[k]
    length = max(math.sqrt(u * u + v * v), 1e-9)
    first, last, count = np.full(BINS, np.inf), np.full(BINS, -np.inf), np.zeros(BINS)
    for k in range(len(d)):
        if low <= level[k] < high and d[k] <= reach:
            side, b = (u * y[k] - v * x[k]) / length, level[k]
            first[b], last[b], count[b] = min(first[b], side), max(last[b], side), count[b] + 1
    wide, n = np.empty(BINS), 0
    for b in range(low, high):
        if count[b] >= 3:
            wide[n] = (last[b] - first[b]) * (count[b] + 1) / (count[b] - 1)
            n += 1
    out[0], out[1] = -1.0, -1.0
    if n:
        out[1] = _spread_of(wide, n) / max(_sum(wide, 0, n) / n, 0.02)
        out[0] = median(wide, n)


def describe_rounds(where, axes):
    """Return the features (k, len(ROUND_NAMES)) of the round shaft at each axis (k, 5 or more).

    ``where`` as of :func:`describe`.
    """
    out = np.zeros((len(axes), len(ROUND_NAMES)))
    in_threads(_rounds, len(axes), *where, np.ascontiguousarray(axes[:, :5]), out)
    return out


@njit(cache=True, nogil=True)
def _rounds(begin, end, points, height, start, base, axes, out):
    """Write the features of the axes from ``begin`` to ``end``."""
    for c in range(begin, end):
        ax, ay, lx, ly, at = axes[c, 0], axes[c, 1], axes[c, 2], axes[c, 3], axes[c, 4]
        near, n = near_axis(points, start, base, ax, ay, SEEN_M + 0.3), 0
        x, y, h = np.empty(len(near)), np.empty(len(near)), np.empty(len(near))
        for i in near:
            if 0.1 < height[i] < BINS * BIN_M:
                x[n] = points[i, 0] - ax - lx * (height[i] - at)
                y[n] = points[i, 1] - ay - ly * (height[i] - at)
                h[n] = height[i]
                n += x[n] * x[n] + y[n] * y[n] < SEEN_M**2
        if n >= 3:
            _round(h[:n], x[:n], y[:n], out[c])


def describe_around(points, height, axes):
    """Return the features (k, len(AROUND_NAMES)) of axes from points (n, 3) and their height."""
    out = np.zeros((len(axes), len(AROUND_NAMES)))
    used = (height > BANDS_M[0]) & (height < BANDS_M[-1])
    if used.any():
        band = np.searchsorted(BANDS_M, height[used], side="right") - 1
        scaled = np.column_stack([points[used, :2] / CELL_M, band])
        place = sort_into_cells(scaled, 1.0).places
        found = rows(np.column_stack([(place[:, :2] + 0.5) * CELL_M, place[:, 2]]))
        cells = found.points, found.start, found.base
        in_threads(_around_axes, len(axes), *cells, axes[:, :2].copy(), out)
    return out


@njit(cache=True, nogil=True)
def _around_axes(begin, end, cells, start, base, xy, out):
    """Write the features of the axes from ``begin`` to ``end``; cells have x, y and their band."""
    bands, rings = len(BANDS_M) - 1, len(RINGS_M) - 1
    for c in range(begin, end):
        arcs = np.zeros((bands, rings), np.uint64)
        count = np.zeros((bands, rings))
        for k in near_axis(cells, start, base, xy[c, 0], xy[c, 1], RINGS_M[-1]):
            u, v, band = cells[k, 0] - xy[c, 0], cells[k, 1] - xy[c, 1], int(cells[k, 2])
            ring = np.searchsorted(RINGS_M, math.hypot(u, v), side="right") - 1
            if 0 <= ring < rings:
                arcs[band, ring] |= np.uint64(1) << np.uint64(_arc_of(u, v))
                count[band, ring] += 1
        for i in range(bands * rings):
            band, ring = divmod(i, rings)
            out[c, 2 * i] = set_bits(arcs[band, ring]) / ARCS
            out[c, 2 * i + 1] = math.log1p(count[band, ring])
