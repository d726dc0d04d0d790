"""Points in plan rows: which of them stand in a vertical or leaning cylinder, without a big grid.

Points are sorted by rows of northing and, within a row, by easting; a cylinder looks into the few
rows it crosses. Memory grows with the points and the rows, not with the area.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

ROW_M = 0.5


class Rows(NamedTuple):
    """Sorted points.

    ``points`` (n, 3) from ``origin``; ``start`` (rows + 1,) first point of each row; ``order`` (n,)
    their numbers in the given array.
    """

    points: np.ndarray
    start: np.ndarray
    order: np.ndarray


def rows(points):
    """Return the ``Rows`` of points (n, 3)."""
    row = np.floor(points[:, 1] / ROW_M).astype(np.int64)
    row -= row.min() if len(row) else 0
    width = np.ptp(points[:, 0]) + 1.0 if len(points) else 1.0
    order = np.argsort(row * width + (points[:, 0] - points[:, 0].min(initial=np.inf)))
    start = np.searchsorted(row[order], np.arange(row.max(initial=-1) + 2))
    return Rows(np.ascontiguousarray(points[order]), start, order)


@njit(cache=True)
def first_at(points, low, high, x):
    """First of the sorted points low..high whose easting is not below ``x``."""
    while low < high:
        middle = (low + high) // 2
        if points[middle, 0] < x:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def near_axis(points, start, base, x, y, radius):
    """Return the numbers of the sorted points within ``radius`` of (x, y) in plan.

    ``base`` is the northing where row 0 begins.
    """
    n = 0
    out = np.empty(64, np.int64)
    first = max(int(np.floor((y - radius - base) / ROW_M)), 0)
    last = min(int(np.floor((y + radius - base) / ROW_M)), len(start) - 2)
    for row in range(first, last + 1):
        for i in range(first_at(points, start[row], start[row + 1], x - radius), start[row + 1]):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            if dx > radius:
                break
            if dx * dx + dy * dy <= radius * radius:
                if n == len(out):
                    grown = np.empty(2 * n, np.int64)
                    grown[:n] = out
                    out = grown
                out[n] = i
                n += 1
    return out[:n]


def beside(points, xy, reach):
    """Return the numbers of points (n, 3) that may lie within ``reach`` of a place xy (k, 2), m.

    Told by cells of 1 m: none within reach is left out, some farther ones are among them.
    """
    if not len(xy):
        return np.empty(0, np.int64)
    pad = int(np.ceil(reach))
    low = np.floor(xy.min(axis=0)) - pad
    place = np.floor(xy - low).astype(np.int64)
    grid = np.zeros(place.max(axis=0) + pad + 1, dtype=bool)
    for i in range(-pad, pad + 1):
        for j in range(-pad, pad + 1):
            grid[place[:, 0] + i, place[:, 1] + j] = True
    return np.flatnonzero(_in_cells(points, grid, low))


@njit(cache=True)
def _in_cells(points, grid, low):
    """Which points lie in a set cell of 1 m."""
    inside = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        i, j = int(np.floor(points[k, 0] - low[0])), int(np.floor(points[k, 1] - low[1]))
        if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
            inside[k] = grid[i, j]
    return inside


def base(found):
    """Northing where row 0 of sorted points begins."""
    if not len(found.points):
        return 0.0
    return float(np.floor(found.points[found.start[0], 1] / ROW_M) * ROW_M)
