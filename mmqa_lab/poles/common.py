"""What all detectors share: points near an axis, the height above ground, the table of poles.

Points are sorted by rows of northing and, within a row, by easting; a cylinder looks into the few
rows that it crosses. Memory grows with the points and the rows, not with the area.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numba import njit
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

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


GROUND_CELL_M = 1.0
GROUND_WINDOW = 9
"""Cells: lowest points that stand out from a window of 9 m x 9 m are roofs and crowns."""

GROUND_STEP_M = 0.5
GROUND_SUPPORT = 3
"""A lowest point far below the cells around it is the ground only with so many points within half a
metre above it, itself included: single stray points below the road are none."""


def height_above_ground(points, *, at=None, cell=GROUND_CELL_M):
    """Return the height above the ground of each point, or of the points ``at``, metres.

    The lowest point of each cell is the ground, unless it lies more than 0.5 m above what a
    morphological opening leaves, or stands alone more than 0.5 m below one in five of the cells
    around; cells without ground take the nearest cell's. Between cell centres the ground is
    bilinear.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    at : array, shape (m, 3), optional
    cell : float
        Metres.

    Returns
    -------
    array, shape (n,) or (m,)

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2))
    >>> street = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> float(height_above_ground(np.vstack([street, [[10, 10, 3]]]))[-1])
    3.0
    """
    if not len(points):
        return np.empty(0)
    low = points[:, :2].min(axis=0)
    place = (points[:, :2] - low) / cell
    column, row = place.astype(np.int64).T
    shape = int(row.max()) + 1, int(column.max()) + 1
    number = row * shape[1] + column
    lowest = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(lowest, number, points[:, 2])
    support = np.bincount(
        number[points[:, 2] <= lowest[number] + GROUND_STEP_M], minlength=len(lowest)
    )
    ground = _opened(_without_strays(lowest.reshape(shape), support.reshape(shape)))
    at = points if at is None else at
    place = (at[:, 1::-1] - low[::-1]) / cell - 0.5
    return at[:, 2] - ndimage.map_coordinates(ground, place.T, order=1, mode="nearest")


def _without_strays(lowest, support):
    """Lowest heights without single points far below the cells around them."""
    alone = (support < GROUND_SUPPORT) & np.isfinite(lowest)
    supported = support >= GROUND_SUPPORT
    if not alone.any() or not supported.any():
        return lowest
    sure = _filled(lowest, supported)
    usual = ndimage.percentile_filter(sure, 20, size=GROUND_WINDOW, mode="nearest")
    return np.where(alone & (lowest < usual - GROUND_STEP_M), np.inf, lowest)


def _opened(lowest):
    """Lowest heights without what stands out, and without gaps."""
    filled = _filled(lowest, np.isfinite(lowest))
    opened = ndimage.grey_opening(filled, size=(GROUND_WINDOW, GROUND_WINDOW), mode="nearest")
    known = np.isfinite(lowest) & (lowest - opened <= GROUND_STEP_M)
    return _filled(lowest, known) if known.any() else filled


def _filled(values, known):
    """Values with gaps taken from the nearest known cell."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


COLUMNS = (
    *("x_m", "y_m", "z_base_m", "height_m", "diameter_m", "tilt_deg", "score", "method"),
    *("lean_x", "lean_y"),
)


def pole_table(rows, method, *, explain=False):
    """Return candidates as a DataFrame, the accepted ones or all of them with their verdict.

    Parameters
    ----------
    rows : dict of str to array
        ``x_m``, ``y_m`` (the axis at half height), ``z_base_m``, ``height_m``, ``diameter_m``,
        ``lean_x``, ``lean_y`` (m/m), ``score``, ``rejected_by`` (empty for accepted); of the
        component method also ``is_tree``.
    method : str
    explain : bool

    Returns
    -------
    DataFrame
        Ordered by northing, then easting.
    """
    frame = pd.DataFrame(rows)
    frame["tilt_deg"] = np.degrees(np.arctan(np.hypot(frame["lean_x"], frame["lean_y"])))
    frame["method"] = method
    if not explain:
        frame = frame[frame["rejected_by"] == ""]
    columns = [*COLUMNS, *frame.columns.intersection(["is_tree"]), *["rejected_by"] * explain]
    return frame.sort_values(["y_m", "x_m"], ignore_index=True)[columns]


def first_reason(n, **failed):
    """Name, for each of ``n`` candidates, the first test it failed; empty where none.

    Examples
    --------
    >>> first_reason(2, length=np.array([True, False]), tilt=np.array([True, False])).tolist()
    ['length', '']
    """
    reason = np.full(n, "", dtype=object)
    for name, wrong in reversed(failed.items()):
        reason[np.asarray(wrong)] = name
    return reason


def drop_duplicates(rows, distance):
    """Reject what lies nearer than ``distance`` to an accepted candidate with a higher score.

    Writes ``duplicate`` into ``rejected_by`` of the lower one.
    """
    kept = np.flatnonzero(rows["rejected_by"] == "")
    if len(kept) < 2:
        return
    xy = np.column_stack([rows["x_m"], rows["y_m"]])[kept]
    rank = np.lexsort([xy[:, 0], xy[:, 1], -rows["score"][kept]])
    near = cKDTree(xy).query_ball_point(xy, distance)
    gone = np.zeros(len(kept), dtype=bool)
    for k in rank:
        if not gone[k]:
            gone[[other for other in near[k] if other != k]] = True
    rows["rejected_by"][kept[gone]] = "duplicate"


def joined(a, b, n):
    """Number of the connected component of each of n things."""
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
