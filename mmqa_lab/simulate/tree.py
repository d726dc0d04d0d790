"""The search tree over a scene's primitives: a bounding volume hierarchy.

Nodes are cut where a binned surface-area heuristic says; the left child lies next to its parent.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

PARALLELOGRAM, ELLIPSE, POLYGON, FRUSTUM, ELLIPSOID = range(5)
"""Kinds of primitives; the meaning of their nine shape numbers stands in ``Tree``."""

BINS = 16
LEAF_SIZE = 4
DEEPEST = 60  # levels cut where the heuristic says; below, halves, so that STACK suffices
STACK = 128


class Tree(NamedTuple):
    """Primitives in the order of their bounding volume hierarchy.

    ``shape`` holds, for planar kinds, the dual vectors p and q (local coordinates s = p.x, t = q.x
    from the centre) and the unit normal; for a frustum its unit axis, half length, radius at
    the centre, growth of the radius along the axis, whether it is capped; for an ellipsoid the
    rows of the matrix that maps it to the unit sphere.
    """

    low: np.ndarray  # (nodes, 3) corner of each node's box
    high: np.ndarray
    link: np.ndarray  # (nodes,) first primitive of a leaf, right child of an inner node
    count: np.ndarray  # (nodes,) primitives of a leaf, 0 in inner nodes
    axis: np.ndarray  # (nodes,) split axis
    kind: np.ndarray  # (n,)
    centre: np.ndarray  # (n, 3) from the origin of the scene
    shape: np.ndarray  # (n, 9)
    surface: np.ndarray  # (n,) id of the surface a primitive belongs to
    outline: np.ndarray  # (n, 2) first and last edge of a polygon
    cells: np.ndarray  # (n, 3) first reflectance, rows, columns
    edges: np.ndarray  # (m, 4) s, t of the start and the end of each polygon edge
    reflectance: np.ndarray  # (k,) of the cells


def build(*, kind, centre, shape, half, surface, outline, cells, edges, reflectance):
    """Return the ``Tree`` of primitives whose boxes are ``centre`` +- ``half``."""
    order, low, high, link, count, axis = _hierarchy(centre - half, centre + half)
    sorted_ = (a[order] for a in (kind, centre, shape, surface, outline, cells))
    return Tree(low, high, link, count, axis, *sorted_, edges, reflectance)


@njit(cache=True)
def _hierarchy(box_low, box_high):
    """Order of the primitives and the nodes over them, left child next to its parent."""
    n = len(box_low)
    centre = 0.5 * (box_low + box_high)
    order = np.arange(n)
    size = max(2 * n, 1)
    low, high = np.full((size, 3), np.inf), np.full((size, 3), -np.inf)
    link, count = np.zeros(size, np.int64), np.zeros(size, np.int64)
    axis = np.zeros(size, np.int64)
    todo = [(0, n, -1, 0)]
    nodes = 0
    while len(todo):
        start, stop, parent, depth = todo.pop()
        node = nodes
        nodes += 1
        if parent >= 0:
            link[parent] = node
        for i in order[start:stop]:
            for k in range(3):
                low[node, k] = min(low[node, k], box_low[i, k] - 1e-9)
                high[node, k] = max(high[node, k], box_high[i, k] + 1e-9)
        if stop - start <= LEAF_SIZE:
            link[node], count[node] = start, stop - start
            continue
        middle = (start + stop) // 2
        if depth < DEEPEST:
            split, position = _best_split(order[start:stop], box_low, box_high, centre)
            middle = _partition(order, start, stop, centre[:, split], position)
            axis[node] = split
        todo.append((middle, stop, node, depth + 1))
        todo.append((start, middle, -1, depth + 1))
    return order, low[:nodes], high[:nodes], link[:nodes], count[:nodes], axis[:nodes]


@njit(cache=True)
def _best_split(members, box_low, box_high, centre):
    """Axis and position where the surface-area heuristic cuts a node."""
    best, best_axis, best_position = np.inf, 0, np.nan
    for k in range(3):
        first, last = np.inf, -np.inf
        for i in members:
            first, last = min(first, centre[i, k]), max(last, centre[i, k])
        if last <= first:
            continue
        cost = _bin_costs(members, box_low, box_high, centre, k, first, last)
        b = int(np.argmin(cost))
        if cost[b] < best:
            best, best_axis = cost[b], k
            best_position = first + (last - first) * (b + 1) / BINS
    return best_axis, best_position


@njit(cache=True)
def _bin_costs(members, box_low, box_high, centre, k, first, last):
    """Cost of cutting axis ``k`` after each bin."""
    lows, highs = np.full((BINS, 3), np.inf), np.full((BINS, 3), -np.inf)
    held = np.zeros(BINS)
    for i in members:
        b = min(int(BINS * (centre[i, k] - first) / (last - first)), BINS - 1)
        held[b] += 1
        for j in range(3):
            lows[b, j] = min(lows[b, j], box_low[i, j])
            highs[b, j] = max(highs[b, j], box_high[i, j])
    cost = np.zeros(BINS - 1)
    for side in (1, -1):
        low, high, n = np.full(3, np.inf), np.full(3, -np.inf), 0.0
        for step in range(BINS - 1):
            b = step if side == 1 else BINS - 1 - step
            n += held[b]
            low, high = np.minimum(low, lows[b]), np.maximum(high, highs[b])
            e = np.maximum(high - low, 0.0)
            area = e[0] * e[1] + e[1] * e[2] + e[2] * e[0]
            cost[b if side == 1 else b - 1] += n * area if n > 0 else 0.0
    return cost


@njit(cache=True)
def _partition(order, start, stop, key, position):
    """Move members below ``position`` to the front; halves where nothing separates them."""
    i = start
    for j in range(start, stop):
        if key[order[j]] < position:
            order[i], order[j] = order[j], order[i]
            i += 1
    return i if start < i < stop else (start + stop) // 2
