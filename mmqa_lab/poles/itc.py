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
from scipy.spatial import cKDTree

from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.poles.common import drop_duplicates, first_reason, ground, joined, table

GROUND_M = 0.3
"""Points lower than this above the ground belong to the ground."""

LINK_M, SLICE_M = 0.25, 0.3
"""Edge of the cells, which are connected where they touch; height of a slice."""

DIAGONAL_M, SHIFT_M, GROWTH_M, MISSING = 0.6, 0.15, 0.25, 1
"""Longest diagonal of the rectangle of a pole-like slice; largest shift of the centre and change of
the diagonal from slice to slice; most empty slices in a row within a stack."""

LENGTH_M = 1.0

PLANE_CELL_M, THICK_M, TURN_DEG, OFF_M, WALL_M = 0.4, 0.03, 12.0, 0.10, (1.5, 2.0)
"""Edge of the cells in which planes are fitted; largest thickness of a plane; largest angle and
offset between neighbouring planes; least length and height of a wall."""


def detect(points, *, explain=False):
    """Return the poles of a cloud (n, 3) as :func:`mmqa_lab.poles.detect` does.

    Lengths are in metres. The diameter is the median of the rectangles' longer sides.
    """
    above = points[:, 2] - ground(points)(points) >= GROUND_M if len(points) else slice(None)
    points = points[above]
    stacks = np.empty((0, 8))
    if len(points):
        component = components(points)
        level = np.floor((points[:, 2] - points[:, 2].min()) / SLICE_M).astype(np.int64)
        order = np.lexsort([level, component])
        cuts = np.flatnonzero(np.diff(component[order])) + 1
        parts = np.split(order, cuts)
        stacks = np.array([_stack(points[part, :2], level[part]) for part in parts])
    x, y, lean_x, lean_y, first, last, diameter, share = stacks.T
    height = (last - first) * SLICE_M
    reason = first_reason(len(stacks), length=height < LENGTH_M)
    drop_duplicates(np.column_stack([x, y]), share, reason, 2 * SHIFT_M)
    base = first * SLICE_M + points[:, 2].min(initial=np.inf)
    rows = {"x_m": x, "y_m": y, "z_base_m": base, "height_m": height, "diameter_m": diameter}
    rows |= {"lean_x": lean_x, "lean_y": lean_y, "score": share, "rejected_by": reason}
    return table(rows, "itc", explain=explain)


def components(points):
    """Return the number of the connected component of each point (n, 3, metres), shape (n,)."""
    cell, places = _cells(points, LINK_M)
    return joined(*_touching(places).T, len(places))[cell]


def _cells(points, size):
    """Number of the occupied cell of each point (n,), and the indices of the cells (k, 3)."""
    order, starts, places = sort_into_cells(points, size)
    cell = np.empty(len(points), np.int64)
    cell[order] = np.repeat(np.arange(len(places)), np.diff(starts))
    return cell, places


def _touching(places):
    """Pairs (k, 2) of occupied cells that share a face, an edge or a corner."""
    return cKDTree(places).query_pairs(1.5, p=np.inf, output_type="ndarray")


def _stack(xy, level):
    """The longest stack of similar small slices of a component whose points are sorted by level.

    Returns place, lean, first level, last level + 1, diameter, and the stack's share of slices.
    """
    first = np.flatnonzero(np.diff(level, prepend=-1))
    boxes = [cv2.minAreaRect(part.astype(np.float32)) for part in np.split(xy - xy[0], first[1:])]
    centre, size = (np.array([box[k] for box in boxes]) for k in (0, 1))
    diagonal, level = np.hypot(*size.T), level[first]
    breaks = (np.diff(level) > MISSING + 1) | (np.abs(np.diff(diagonal)) > GROWTH_M)
    breaks |= np.hypot(*np.diff(centre, axis=0).T) > SHIFT_M
    narrow = diagonal <= DIAGONAL_M
    breaks |= ~(narrow[1:] & narrow[:-1])
    ends = np.concatenate([[0], np.flatnonzero(breaks) + 1, [len(level)]])
    begin, end = ends[:-1], ends[1:]
    lengths = np.where(narrow[begin] & (end - begin > 1), level[end - 1] - level[begin] + 1, 0)
    best = lengths.argmax()
    part = slice(begin[best], end[best])
    height = (level[part] + 0.5) * SLICE_M
    middle = (height[0] + height[-1]) / 2
    lean, place = np.zeros(2), np.median(centre[part], axis=0)
    if len(height) > 2:
        lean, place = np.polyfit(height - middle, centre[part], 1)
    low = level[begin[best]]
    share = (end[best] - begin[best]) / len(level)
    ends = low, low + lengths[best]
    return [*(xy[0] + place), *lean, *ends, np.median(size[part].max(axis=1)), share]


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
    cell, places = _cells(points, PLANE_CELL_M)
    n = len(places)
    count = np.bincount(cell, minlength=n)[:, None]
    centre = np.stack([np.bincount(cell, axis, n) for axis in points.T], axis=1) / count
    off = points - centre[cell]
    products = (off[:, :, None] * off[:, None, :]).reshape(-1, 9)
    scatter = np.stack([np.bincount(cell, values, n) for values in products.T], axis=1) / count
    values, vectors = np.linalg.eigh(scatter.reshape(-1, 3, 3))
    normal, flat = vectors[:, :, 0], (count[:, 0] >= 4) & (values[:, 0] < THICK_M**2)
    flat &= (values[:, 1] > 4 * values[:, 0]) & (values[:, 1] > (PLANE_CELL_M / 10) ** 2)
    a, b = _touching(places).T
    joint = centre[b] - centre[a]
    agree = np.abs((normal[a] * normal[b]).sum(axis=1)) > np.cos(np.radians(TURN_DEG))
    for k in (a, b):
        agree &= np.abs((joint * normal[k]).sum(axis=1)) < OFF_M
    agree &= flat[a] & flat[b]
    part = joined(a[agree], b[agree], n)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, part[flat], centre[flat])
    np.maximum.at(high, part[flat], centre[flat])
    extent = np.where(np.isfinite(low), high - low, 0)
    wall = flat & (np.abs(normal[:, 2]) < np.sin(np.radians(15)))
    long, high = np.hypot(extent[:, 0], extent[:, 1]) >= WALL_M[0], extent[:, 2] >= WALL_M[1]
    return (wall & (long & high)[part])[cell]
