"""What all detectors share: points near an axis, ground, diameters, the table of poles.

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

from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.planes import algebraic_circle

ROW_M = 0.5


class Rows(NamedTuple):
    """Sorted points.

    ``points`` (n, 3); ``start`` (rows + 1,) first point of each row; ``base`` northing where row 0
    begins; ``order`` (n,) their numbers in the given array.
    """

    points: np.ndarray
    start: np.ndarray
    base: float
    order: np.ndarray


def rows(points):
    """Return the ``Rows`` of points (n, 3)."""
    row = np.floor(points[:, 1] / ROW_M).astype(np.int64)
    first = row.min() if len(row) else 0
    x = points[:, 0]
    wide = 2 * np.ptp(x) + 1 if len(row) else 1
    order = np.argsort((row - first) * wide + (x - x.min(initial=np.inf)))
    start = np.searchsorted(row[order], first + np.arange(np.ptp(row) + 2 if len(row) else 1))
    return Rows(np.ascontiguousarray(points[order]), start, float(first * ROW_M), order)


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
    first = max(int(np.floor((y - radius - base) / ROW_M)), 0)
    last = min(int(np.floor((y + radius - base) / ROW_M)), len(start) - 2)
    n = 0
    for row in range(first, last + 1):
        n += first_at(points, start[row], start[row + 1], x + radius + 1e-3)  # room for rounding
        n -= first_at(points, start[row], start[row + 1], x - radius)
    out, n = np.empty(n, np.int64), 0
    for row in range(first, last + 1):
        for i in range(first_at(points, start[row], start[row + 1], x - radius), start[row + 1]):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            if dx > radius:
                break
            if dx * dx + dy * dy <= radius * radius:
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


GROUND_CELL_M = 1.0
GROUND_WINDOW = 9
"""Cells: lowest points that stand out from a window of 9 m x 9 m are roofs and crowns."""

GROUND_STEP_M = 0.5
GROUND_SUPPORT = 3
"""A lowest point far below the cells around it is the ground only with so many points within half a
metre above it, itself included: single stray points below the road are none."""


class Ground(NamedTuple):
    """Heights of the ground at the centres of square cells: ``grid``, its corner, their side."""

    grid: np.ndarray
    low: np.ndarray
    cell: float

    def height(self, points):
        """Height above the ground of points (n, 3), (n,), metres."""
        return _above(points, *self)


def fit_ground(points):
    """Return the ``Ground`` under points.

    The lowest point of each cell is the ground, unless it lies more than 0.5 m above what a
    morphological opening leaves, or stands alone more than 0.5 m below one in five of the cells
    around; cells without ground take the nearest cell's. Between cell centres the ground is
    bilinear.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres; one or more.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2))
    >>> street = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> fit_ground(street).height(np.array([[10.0, 10.0, 3.0]])).tolist()
    [3.0]
    """
    low, high = (np.array([end(axis) for axis in points[:, :2].T]) for end in (np.min, np.max))
    cell = GROUND_CELL_M
    low = np.floor(low / cell) * cell
    shape = tuple(((high - low) / cell).astype(np.int64)[::-1] + 1)
    return Ground(_opened(_without_strays(*_lowest(points, low, cell, shape))), low, cell)


@njit(cache=True)
def _lowest(points, low, cell, shape):
    """Lowest height of each cell, inf without points, and the points within half a metre above."""
    lowest, support = np.full(shape, np.inf), np.zeros(shape, np.int64)
    for k in range(len(points)):
        i, j = int((points[k, 1] - low[1]) / cell), int((points[k, 0] - low[0]) / cell)
        lowest[i, j] = min(lowest[i, j], points[k, 2])
    for k in range(len(points)):
        i, j = int((points[k, 1] - low[1]) / cell), int((points[k, 0] - low[0]) / cell)
        support[i, j] += points[k, 2] <= lowest[i, j] + GROUND_STEP_M
    return lowest, support


@njit(cache=True)
def _above(points, ground, low, cell):
    """Height above a grid of heights, bilinear between the centres of cells."""
    out = np.empty(len(points))
    last = ground.shape[0] - 1, ground.shape[1] - 1
    for k in range(len(points)):
        v = min(max((points[k, 1] - low[1]) / cell - 0.5, 0.0), float(last[0]))
        u = min(max((points[k, 0] - low[0]) / cell - 0.5, 0.0), float(last[1]))
        i, j = int(v), int(u)
        v, u = v - i, u - j
        below, right = min(i + 1, last[0]), min(j + 1, last[1])
        near = (1 - u) * ground[i, j] + u * ground[i, right]
        far = (1 - u) * ground[below, j] + u * ground[below, right]
        out[k] = points[k, 2] - (1 - v) * near - v * far
    return out


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


LEAST_CHORDS = 5
"""That agree; fewer tell no diameter of a shaft."""

TAPERS = np.arange(0, 0.031, 0.003)
"""By how much a shaft may narrow upwards, m/m."""

TAPER_GAIN = 0.01
"""A taper must win one more chord for each so many m/m."""


def shaft_diameter(points, axis_direction, line):
    """Return the diameter halfway up a shaft, from the chords that scan lines cut.

    A ray every ``s`` metres meets a post of diameter d between floor(d / s) and ceil(d / s) times,
    d / s times on average, and the chord from the first to the last hit is one spacing less: the
    diameter is the mean chord plus one ray spacing. A shaft may taper, and what stands in front of
    it or is mounted on it has chords of its own: a straight line of chord over height is sought on
    which the most agree within two spacings. Boards and boxes are wider than their post: the
    narrowest chords that agree, a quarter of all at least, are the shaft's.

    Parameters
    ----------
    points : array, shape (n, 3)
        On the shaft, metres.
    axis_direction : array, shape (3,)
        Unit vector of the axis.
    line : array of int, shape (n,)
        Scan line of each.

    Returns
    -------
    float
        Metres; NaN where fewer than five chords agree.

    Notes
    -----
    Lines with a single hit tell no spacing and are left out, which makes thin, far posts too wide;
    the spacing is the median over lines. A front-facing arc is less wide than the post by less
    than 1 % unless the scanner is nearer than ten radii.

    References
    ----------
    The estimator is ours.
    """
    shaft = shaft_chords(points, axis_direction, line)
    if not len(shaft.chords):
        return np.nan
    upright = shaft.chords + shaft.taper * (shaft.heights - shaft.middle)
    return float(upright.mean() + shaft.spacing)


class Shaft(NamedTuple):
    """Chords of a shaft that agree.

    ``chords`` (k,) and ``heights`` (k,), none where fewer than five agree; ``taper`` m/m;
    ``spacing`` of the rays and ``middle`` height of all chords, metres.
    """

    chords: np.ndarray
    heights: np.ndarray
    taper: float
    spacing: float
    middle: float


def shaft_chords(points, axis_direction, line):
    """Return the ``Shaft`` that the chords of scan lines show; as :func:`shaft_diameter` says."""
    chords, height, spacing = _chords(points, axis_direction, line)
    best = 0.0, np.zeros(len(chords), bool), 0.0
    middle = (height.min() + height.max()) / 2 if len(height) else np.nan
    for taper in TAPERS if len(chords) >= LEAST_CHORDS else ():
        upright = chords + taper * (height - middle)
        ranked = np.sort(upright)
        last = np.searchsorted(ranked, ranked + 2 * spacing, side="right")
        agree = last - np.arange(len(ranked))
        enough = agree >= min(agree.max(), max(2, len(chords) / 4))
        narrow = ranked <= ranked[np.argmax(enough)] + 2 * spacing
        first = np.argmax(np.where(enough & narrow, agree, 0))
        shaft = np.abs(upright - np.median(ranked[first : last[first]])) <= 2 * spacing
        won = agree[first] - taper / TAPER_GAIN
        if won > best[0] and shaft.sum() >= LEAST_CHORDS:
            best = won, shaft, taper
    _, shaft, taper = best
    return Shaft(chords[shaft], height[shaft], float(taper), spacing, middle)


def _chords(points, axis_direction, line):
    """Length and height of each line's chord, and the median ray spacing.

    A chord is measured in the direction in which it and its two neighbours scatter the most: noise
    in depth would turn and lengthen a short one.
    """
    if not len(points):
        return np.empty(0), np.empty(0), np.nan
    centred = points - points.mean(axis=0)
    flat = centred @ (np.eye(3) - np.outer(axis_direction, axis_direction))
    order = np.argsort(line, kind="stable")
    first = np.flatnonzero(np.diff(line[order], prepend=line[order[0]] - 1))
    parts = [part for part in np.split(order, first[1:]) if len(part) >= 2]
    if not parts:
        return np.empty(0), np.empty(0), np.nan
    offs = [flat[part] - flat[part].mean(axis=0) for part in parts]
    scatter = np.pad([off.T @ off for off in offs], ((1, 1), (0, 0), (0, 0)))
    _, axes = np.linalg.eigh(scatter[:-2] + scatter[1:-1] + scatter[2:])
    chords = np.array([np.ptp(off @ wide) for off, wide in zip(offs, axes[:, :, 2], strict=True)])
    height = np.array([points[part, 2].mean() for part in parts])
    spacing = np.median(chords / [len(part) - 1 for part in parts])
    return chords, height, spacing


SLICE_M = 0.25
LEAST_OF_SLICE = 4


def slice_widths(off, z):
    """Return the widths in plan of level slices of a shaft, and what is added to the points' own.

    Parameters
    ----------
    off : array, shape (n, 2)
        Points from the axis, metres.
    z : array, shape (n,)
        Their heights; slices are 0.25 m high, those of fewer than four points are left out.

    Returns
    -------
    array, shape (k, 2)
        Metres.

    Notes
    -----
    The side of a shaft falls into a gap between points, on average into a wide one: at both sides
    together the mean of the squared gaps over the mean gap is lost. It is one spacing where lines
    fall in step, and 2 / (n + 1) of the width of n points at random.
    """
    level = np.floor(z / SLICE_M)
    parts = [off[level == number] for number in np.unique(level)]
    widths = [_width(part) for part in parts if len(part) >= LEAST_OF_SLICE]
    return np.array(widths).reshape(-1, 2)


def _width(off):
    """Largest width in plan with what is lost on average beyond the last points, and that loss."""
    wide = np.linalg.svd(off - off.mean(axis=0), full_matrices=False)[2][0]
    gaps = np.diff(np.sort(off @ wide))
    lost = gaps @ gaps / max(gaps.sum(), 1e-9)
    return gaps.sum() + lost, lost


CIRCLE_SLICE_M, WIDEST_CIRCLE_M = 0.5, 1.0


def circle_diameter(points, axis_direction, line=None):
    """Return the median diameter of circles fitted to slices across an axis.

    Each slice gets an algebraic circle (Pratt's normalisation is not needed where noise is small
    against the radius); slices with fewer than five points or a circle wider than 1 m
    are left out; scan lines do not matter.

    Returns
    -------
    float
        Metres; NaN where no slice is measurable.

    References
    ----------
    Kasa 1976, IEEE Transactions on Instrumentation and Measurement 25, 8-14,
    doi:10.1109/TIM.1976.6312298.
    """
    if len(points) < 5:
        return np.nan
    centred = points - points.mean(axis=0)
    along = centred @ axis_direction
    u = np.cross(axis_direction, np.eye(3)[np.argmin(np.abs(axis_direction))])
    u /= np.linalg.norm(u)
    plan = centred @ np.stack([u, np.cross(axis_direction, u)], axis=1)
    found = []
    level = np.floor(along / CIRCLE_SLICE_M)
    for number in np.unique(level):
        part = plan[level == number]
        if len(part) >= 5:
            found.append(2 * algebraic_circle(part)[2])
    found = np.array([d for d in found if np.isfinite(d) and d <= WIDEST_CIRCLE_M])
    return float(np.median(found)) if len(found) else np.nan


def thinned(points, voxel):
    """Return the centre of the points of each occupied cube.

    Examples
    --------
    >>> thinned(np.array([[0, 0, 0], [0.01, 0, 0], [1, 0, 0]]), 0.05).tolist()
    [[0.005, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    order, starts, _ = sort_into_cells(points, voxel)
    return np.add.reduceat(points[order], starts[:-1], axis=0) / np.diff(starts)[:, None]


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


def axis_rows(middle, low, lean, height):
    """Return the rows of straight axes: ``middle`` (k, 2), ``low`` (k,) ends, ``lean`` (k, 2)."""
    return {
        "x_m": middle[:, 0],
        "y_m": middle[:, 1],
        "z_base_m": low,
        "height_m": height,
        "lean_x": lean[:, 0],
        "lean_y": lean[:, 1],
    }


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


def drop_hanging(rows, points, highest_foot):
    """Reject what begins higher above the ground under points (n, 3), metres; none where inf.

    Writes ``foot`` into ``rejected_by``.
    """
    kept = np.flatnonzero(rows["rejected_by"] == "")
    if len(kept) and np.isfinite(highest_foot):
        feet = np.column_stack([rows[name][kept] for name in ("x_m", "y_m", "z_base_m")])
        hanging = fit_ground(points).height(feet) > highest_foot
        rows["rejected_by"][kept[hanging]] = "foot"


def moments(points, member, n):
    """Count, centre and covariance of the points of each of ``n`` members."""
    count = np.bincount(member, minlength=n)
    weight = np.maximum(count, 1)[:, None]
    centre = np.stack([np.bincount(member, axis, n) for axis in points.T], axis=1) / weight
    off = points - centre[member]
    covariance = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            sums = np.bincount(member, off[:, i] * off[:, j], n) / weight[:, 0]
            covariance[:, i, j] = covariance[:, j, i] = sums
    return count, centre, covariance


def extremes(values, member, n):
    """Least and largest value of each of ``n`` members; inf and -inf of those without any."""
    low = np.full((n, *values.shape[1:]), np.inf)
    high = -low
    np.minimum.at(low, member, values)
    np.maximum.at(high, member, values)
    return low, high


def cells(points, size):
    """Number of the occupied cell of each point, and the cells' indices, (k, 3)."""
    order, starts, places = sort_into_cells(points - points.min(axis=0), size)
    cell = np.empty(len(points), np.int64)
    cell[order] = np.repeat(np.arange(len(places)), np.diff(starts))
    return cell, places


def joined(a, b, n):
    """Number of the connected component of each of n things."""
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
