"""Functions shared by the detectors: ground, pairs of places and points, table of poles.

A cloud thinned to the mean point of each voxel, and the part of a cloud near some places.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mmqa_lab._compiled import njit
from mmqa_lab.cloud import group_axes, sort_into_cells

__all__ = [
    "Thin", "around", "drop_duplicates", "first_reason", "ground", "joined", "lowest", "pairs",
    "rows_near", "stripes", "table", "thinned",
]  # fmt: skip


GROUND_CELL_M, GROUND_WINDOW, GROUND_STEP_M = 1.0, 9, 0.5
"""Cell, window (cells) and step: low points higher than the opening by the step are no ground."""

MOST_GROUND_CELLS = 200_000_000
"""Cells of the ground that are held at a time."""

ROOF_WINDOW, ROOF_M = 13, 2.5
"""Low points this much above the lowest cell of a window are no ground: nothing is seen behind a
roof, so the opening keeps it."""

VOXEL_M = 0.04

PLACES = ((0, 0, 0, 0), (0.5, 0.5, 0.5, 22), (0.25, 0.75, 0.25, 45), (0.75, 0.25, 0.75, 67))
"""Shifts (voxels) and turns (degrees) of the thinning grid; scores are averaged over them."""

BIN_M, BINS, COARSE_M = 0.25, 64, 0.3
"""Height bins and their number, 16 m in all; side of coarse cells in plan."""


def ground(points):
    """Return a function of points that gives the height of the ground under them.

    The third lowest point of a cell is the ground, unless it stands out from a morphological
    opening. A cell without ground takes the height of the nearest cell with ground. Heights are
    interpolated bilinearly between the centres of the cells.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres, n >= 1.

    Returns
    -------
    callable
        Takes places (m, 2) or (m, 3) and returns heights (m,), metres.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2))
    >>> street = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> ground(street)(np.array([[10.0, 10.0]])).tolist()
    [0.0]
    """
    points = points[points[:, 2].argsort()]
    order, starts, places = sort_into_cells(points[:, :2], GROUND_CELL_M)
    third = order[np.minimum(starts[:-1] + 2, starts[1:] - 1)]
    squeezed = [_squeezed(axis) for axis in places.T]
    places = np.column_stack(
        [squeeze(axis) for squeeze, axis in zip(squeezed, places.T, strict=True)]
    )
    size = places.max(axis=0).astype(np.int64) + 1
    if size.prod() > MOST_GROUND_CELLS:
        raise ValueError(
            f"Invalid cloud of {size[0]} m by {size[1]} m without its gaps. "
            f"Must be handed over in parts of at most {MOST_GROUND_CELLS:.0e} m2."
        )
    lowest = np.full(size, np.inf)
    lowest[tuple(places.astype(np.int64).T)] = points[third, 2]
    filled = _filled(lowest, np.isfinite(lowest))
    opened = ndimage.grey_opening(filled, size=(GROUND_WINDOW, GROUND_WINDOW), mode="nearest")
    known = lowest - opened <= GROUND_STEP_M  # the lowest cell of all is always known
    known &= lowest <= ndimage.minimum_filter(lowest, ROOF_WINDOW) + ROOF_M
    grid = _filled(lowest, known)

    def height(xy):
        """Height of the ground at places (m, 2) or (m, 3)."""
        axes = np.asarray(xy)[:, :2].T / GROUND_CELL_M - 0.5
        place = [at(axis) for at, axis in zip(squeezed, axes, strict=True)]
        return ndimage.map_coordinates(grid, place, order=1, mode="nearest")

    return height


def lowest(points):
    """Return the three lowest points of each cell of the ground, which are enough for ``ground``.

    Examples
    --------
    >>> lowest(np.array([[0, 0, 3.0], [0, 0, 1.0], [0, 0, 4.0], [0, 0, 2.0]]))[:, 2].tolist()
    [1.0, 2.0, 3.0]
    """
    points = points[points[:, 2].argsort()]
    order, starts, _ = sort_into_cells(points[:, :2], GROUND_CELL_M)
    rank = np.arange(len(order)) - np.repeat(starts[:-1], np.diff(starts))
    return points[order[rank < 3]]


def _squeezed(cells):
    """Function of places along an axis, in cells: from 0, gaps cut to twice the window of a roof.

    So a stray point far away costs no memory, and nothing nearby changes.
    """
    used = np.unique(cells)
    gaps = np.minimum(np.diff(used), 2 * ROOF_WINDOW)
    return partial(np.interp, xp=used, fp=np.append(0, np.cumsum(gaps)))


def _filled(values, known):
    """Values of a grid, gaps filled from the nearest known cell."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def pairs(xy, points, reach):
    """Return the pairs of places (k, 2) and points (n, 2 or 3) nearer than ``reach`` in plan.

    Two arrays of equal length: the row of the place and the row of the point of each pair.

    Examples
    --------
    >>> pairs(np.zeros((1, 2)), np.array([[0.3, 0.0], [0.6, 0.0]]), 0.5)
    (array([0]), array([0]))
    """
    order, *places = rows_near(xy, points, reach)
    a, b = np.empty((2, _near(*places, reach**2, *np.empty((2, 0), np.int64))), np.int64)
    _near(*places, reach**2, a, b)
    return a, order[b]


def rows_near(xy, points, reach):
    """Return an order of points (n, 2 or 3), their plan so, the places (k, 2), and ends of rows.

    The points nearer than ``reach`` to place k are from ``first[row]`` to ``last[row]`` in that
    order, for the rows 3 k, 3 k + 1 and 3 k + 2; others are among them.
    """
    cell, other = (np.floor(part[:, :2] / reach).astype(np.int64) for part in (xy, points))
    wide = 2**31  # more than any number of cells along x
    key = other[:, 1] * wide + other[:, 0]
    order = np.argsort(key, kind="stable")
    key = key[order]
    rows = cell[:, 1, None] * wide + cell[:, :1] + wide * np.array([-1, 0, 1])
    first, last = (np.searchsorted(key, (rows + end).ravel()) for end in (-1, 2))
    return order, points[:, :2][order], xy, first, last


@njit(cache=True)
def _near(points, xy, first, last, square, a, b):
    """Number of near pairs among three rows of sorted points for each place, which are kept."""
    n = 0
    for row in range(len(first)):
        x, y = xy[row // 3]
        for k in range(first[row], last[row]):
            if (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2 < square:
                if len(a):
                    a[n], b[n] = row // 3, k
                n += 1
    return n


def table(rows, method, *, explain=False):
    """Return the accepted or all candidates as a DataFrame, from south to north.

    Parameters
    ----------
    rows : dict of str to array
        ``x_m``, ``y_m`` (the axis at half height), ``z_base_m``, ``height_m``, ``diameter_m``,
        ``lean_x``, ``lean_y`` (m/m), ``score``, ``rejected_by`` (empty if accepted).
    method : str
        Name of the detector.
    explain : bool
        Keep the rejected candidates.
    """
    frame = pd.DataFrame(rows)
    lean = np.hypot(frame["lean_x"], frame["lean_y"])
    frame.insert(5, "tilt_deg", np.degrees(np.arctan(lean)))
    frame["method"] = method
    if not explain:
        frame = frame[frame["rejected_by"] == ""].drop(columns="rejected_by")
    return frame.sort_values(["y_m", "x_m"], ignore_index=True)


def first_reason(**failed):
    """Name, for each candidate, the first test it failed; empty if none.

    Examples
    --------
    >>> first_reason(length=np.array([True, False]), tilt=np.array([True, False])).tolist()
    ['length', '']
    """
    return np.select([*failed.values()], [*failed], "").astype(object)


def drop_duplicates(xy, score, reason, distance):
    """Write ``duplicate`` in ``reason`` where an accepted candidate of higher score is near."""
    kept = np.flatnonzero(reason == "")
    near = cKDTree(xy[kept]).query_ball_point(xy[kept], distance) if len(kept) else []
    for k in np.lexsort([*xy[kept].T, -score[kept]]):
        if reason[kept[k]] == "":
            reason[kept[[other for other in near[k] if other != k]]] = "duplicate"


def joined(a, b, n):
    """Number of the connected component of each of n nodes, from the linked pairs (a, b)."""
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def principal_axes(points, part):
    """Return centres (k, 3), variances (k, 3, ascending) and axes (k, 3, 3) of parts of a cloud.

    The columns of the axes are unit vectors. Points (n, 3) in metres; ``part`` (n,) has all of the
    numbers from 0 to k - 1.

    Examples
    --------
    >>> _, variances, _ = principal_axes(np.array([[0, 0, 0], [0, 0, 2.0]]), np.zeros(2, int))
    >>> variances.tolist()
    [[0.0, 0.0, 1.0]]
    """
    order = np.argsort(part, kind="stable")
    return group_axes(points[order], np.flatnonzero(np.diff(part[order], prepend=-1)))[2:]


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


STRIPE, BESIDE_M = 2000, 6.0
"""Places of a stripe, few enough for a processor's cache, and how far the cloud beside it goes."""


def stripes(thin, xy):
    """Yield the rows of some places (k, 2), from south to north, and the ``Thin`` beside them.

    Examples
    --------
    >>> line = np.arange(90.0)[:, None] * [0, 1, 0]
    >>> [(rows, part), *_] = stripes(Thin(line, line[:, 2], line), np.zeros((1, 2)))
    >>> rows.tolist(), len(part.points)
    ([0], 6)
    """
    north = xy[:, 1].argsort(kind="stable")
    orders = [part[:, 1].argsort(kind="stable") for part in (thin.points, thin.coarse)]
    points, height = thin.points[orders[0]], thin.height[orders[0]]
    coarse = thin.coarse[orders[1]]
    for first in range(0, len(xy), STRIPE):
        rows = north[first : first + STRIPE]
        ends = xy[rows[[0, -1]], 1] + [-BESIDE_M, BESIDE_M]
        near, wide = (slice(*part[:, 1].searchsorted(ends)) for part in (points, coarse))
        yield rows, Thin(points[near], height[near], coarse[wide])


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
