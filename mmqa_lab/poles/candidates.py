"""Candidates for poles: columns of a fine plan grid with points over many heights.

Every cell of 0.1 m keeps one bit for each 0.25 m of height with a point: a column over 16 m
is one 64-bit number, and the emptiness around it is a bitwise operation. The work is linear in the
number of points and of cells.
"""

import numpy as np
from numba import njit

CELL_M = 0.1
BIN_M = 0.25
BINS = 64
LEAST_BINS = 3
TILE_M = 80.0
MARGIN_M = 1.0

SCALES = ((1, 4), (2, 5), (4, 7), (1, 0))
"""Half width of the core and of the ring around it, in cells; a ring of 0 asks for no emptiness."""


def candidates(points, height):
    """Return plan positions of candidates.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    height : array, shape (n,)
        Above ground, metres; only 0.1 to 16 m are used.

    Returns
    -------
    array, shape (k, 2)

    Notes
    -----
    On each scale in ``SCALES`` a candidate is a cell whose count of occupied core bins with an
    empty ring is a local maximum, at least 3; ties go to the cell with more points.
    """
    used = (height > 0.1) & (height < BINS * BIN_M)
    points, height = points[used], height[used]
    if not len(points):
        return np.empty((0, 2))
    xy = points[:, :2]
    origin = np.floor(xy.min(axis=0) / CELL_M) * CELL_M
    tile = np.floor((xy - origin) / TILE_M).astype(np.int64)
    key = tile[:, 0] * (tile[:, 1].max() + 2) + tile[:, 1]
    tiles = tile[np.unique(key, return_index=True)[1]]
    return np.concatenate([_tile(xy, height, tile, origin) for tile in tiles])


def _tile(xy, height, tile, origin):
    """Candidates whose cell lies in one tile."""
    low = origin + tile * TILE_M
    inside = ((xy >= low - MARGIN_M) & (xy < low + TILE_M + MARGIN_M)).all(axis=1)
    place = np.floor((xy[inside] - (low - MARGIN_M)) / CELL_M).astype(np.int64)
    size = round((TILE_M + 2 * MARGIN_M) / CELL_M)
    border = round(MARGIN_M / CELL_M)
    level = (height[inside] / BIN_M).astype(np.int64)
    cells, count = _bits(place, level, size)
    found = _maxima(cells, count, border, np.array(SCALES))
    return low - MARGIN_M + (found + 0.5) * CELL_M


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
    size = len(cells)
    found = []
    for core, ring in scales:
        value = np.zeros((size, size), np.float32)
        bits = _spread(cells, core)
        for i in range(border - 5, size - border + 5):
            for j in range(border - 5, size - border + 5):
                if cells[i, j] and bits[i, j]:
                    clean = bits[i, j]
                    if ring:
                        clean &= ~_ring(cells, i, j, ring)
                    n = set_bits(clean)
                    if n >= LEAST_BINS:
                        value[i, j] = n + _share(count, i, j, core)
        reach = max(core + 1, 3)
        for i in range(border, size - border):
            for j in range(border, size - border):
                if value[i, j] > 0 and _is_top(value, i, j, reach):
                    found.append((i, j))
    out = np.zeros((len(found), 2), np.int64)
    for k in range(len(found)):
        out[k] = found[k]
    return out


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
