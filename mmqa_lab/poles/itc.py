"""The component method of ITC (University of Twente).

The cloud is clipped to a corridor and the ground is removed. The remaining points form connected
components. Each component is cut into horizontal slices, and the enclosing rectangles of
neighbouring slices are compared (EuroSDR 2013, section 4.2; Pu et al. 2011, ISPRS Journal 66,
S28-S39, doi:10.1016/j.isprsjprs.2011.08.006). The method needs no scan lines.

All thresholds are ours, since the report prints none. Two steps differ from section 4.2: the ground
comes from the lowest points and not from segments, and poles are not classified as signs or
trees.
"""

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.poles.common import drop_duplicates, ground, joined, principal_axes, table

__all__ = ["detect", "walls"]

GROUND_M = 0.3
"""Points lower than this above the ground belong to the ground."""

LINK_M, SLICE_M = 0.25, 0.3
"""Edge of the cells, which are connected where they touch; height of a slice."""

DIAGONAL_M, SHIFT_M, GROWTH_M, EMPTY_SLICES = 0.6, 0.15, 0.25, 1
"""Longest diagonal of the rectangle of a pole-like slice; largest shift of the centre and change of
the diagonal from slice to slice; most empty slices in a row within a stack."""

LEAST_STACK_M = 1.0

STACK_COLUMNS = ["x_m", "y_m", "z_base_m", "height_m", "diameter_m", "lean_x", "lean_y", "score"]

PLANE_CELL_M, THICK_M, TURN_DEG, OFF_M, WALL_M = 0.4, 0.03, 12.0, 0.10, (1.5, 2.0)
"""Edge of the cells in which planes are fitted; largest thickness of a plane; largest angle and
offset between neighbouring planes; least length and height of a wall."""


def detect(points, *, explain=False):
    """Return the poles of a cloud (n, 3) as :func:`mmqa_lab.poles.detect` does.

    Lengths are in metres. The diameter is the median of the rectangles' longer sides.
    """
    if len(points):
        points = points[points[:, 2] - ground(points)(points) >= GROUND_M]
    stacks, base = [], points[:, 2].min(initial=np.inf)
    if len(points):
        cell, count, touching = _cells(points, LINK_M)
        component = joined(*touching, count)[cell]
        level = ((points[:, 2] - base) / SLICE_M).astype(np.int64)
        order = np.lexsort([level, component])
        parts = np.split(order, np.flatnonzero(np.diff(component[order])) + 1)
        stacks = [_stack(points[part, :2], level[part]) for part in parts]
    rows = pd.DataFrame(stacks, columns=STACK_COLUMNS, dtype=float)
    rows["z_base_m"] += base
    reason = np.where(rows["height_m"] < LEAST_STACK_M, "length", "").astype(object)
    drop_duplicates(rows[["x_m", "y_m"]].to_numpy(), rows["score"], reason, 2 * SHIFT_M)
    return table(rows.assign(rejected_by=reason), "itc", explain=explain)


def _cells(points, size):
    """Occupied cell of each point (n,), number of cells, pairs (2, k) of cells that touch.

    Cells touch at a face, an edge or a corner.
    """
    order, starts, places = sort_into_cells(points, size)
    cell = np.empty(len(points), np.int64)
    cell[order] = np.repeat(np.arange(len(places)), np.diff(starts))
    pairs = cKDTree(places).query_pairs(1.5, p=np.inf, output_type="ndarray")
    return cell, len(places), pairs.T


def _stack(xy, level):
    """``STACK_COLUMNS`` of the longest stack of similar small slices, its base from level 0.

    The points, (n, 2) in metres, are sorted by level. The score is the stack's share of the slices.
    """
    first = np.flatnonzero(np.diff(level, prepend=-1))
    boxes = [cv2.minAreaRect(part.astype(np.float32)) for part in np.split(xy - xy[0], first[1:])]
    centre, size = (np.array([box[k] for box in boxes]) for k in (0, 1))
    diagonal, level = np.hypot(*size.T), level[first]
    narrow = diagonal <= DIAGONAL_M
    breaks = ~(narrow[1:] & narrow[:-1]) | (np.diff(level) > EMPTY_SLICES + 1)
    breaks |= np.abs(np.diff(diagonal)) > GROWTH_M
    breaks |= np.hypot(*np.diff(centre, axis=0).T) > SHIFT_M
    parts = np.split(np.arange(len(level)), np.flatnonzero(breaks) + 1)
    best = max(parts, key=lambda part: np.ptp(level[part]))
    low, high = level[best[0]], level[best[-1]]
    rise = SLICE_M * (level[best] - (low + high) / 2)
    lean, place = np.linalg.lstsq(np.stack([rise, np.ones(len(best))], axis=1), centre[best])[0]
    diameter, share = np.median(size[best].max(axis=1)), len(best) / len(level)
    return [*xy[0] + place, SLICE_M * low, SLICE_M * (high + 1 - low), diameter, *lean, share]


def walls(points):
    """Return whether each point (n, 3, metres) lies on a wall, shape (n,).

    A wall is a large, upright group of cells whose fitted planes continue each other.

    Examples
    --------
    >>> y, z = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 3, 0.05))
    >>> wall = np.stack([0 * y.ravel() + 0.01, y.ravel(), z.ravel()], axis=1)
    >>> bool(walls(wall).all())
    True
    """
    cell, count, (a, b) = _cells(points, PLANE_CELL_M)
    centre, values, vectors = principal_axes(points, cell)
    normal, flat = vectors[:, :, 0], (np.bincount(cell) >= 4) & (values[:, 0] < THICK_M**2)
    flat &= (values[:, 1] > 4 * values[:, 0]) & (values[:, 1] > (PLANE_CELL_M / 10) ** 2)
    joint = centre[b] - centre[a]
    agree = np.abs((normal[a] * normal[b]).sum(axis=1)) > np.cos(np.radians(TURN_DEG))
    for k in (a, b):
        agree &= flat[k] & (np.abs((joint * normal[k]).sum(axis=1)) < OFF_M)
    part = joined(a[agree], b[agree], count)
    groups = pd.DataFrame(centre[flat]).groupby(part[flat])
    x, y, z = (groups.max() - groups.min()).reindex(part).to_numpy().T
    wall = flat & (np.abs(normal[:, 2]) < np.sin(np.radians(15)))
    return (wall & (np.hypot(x, y) >= WALL_M[0]) & (z >= WALL_M[1]))[cell]
