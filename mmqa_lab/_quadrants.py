"""The search for the nearest point in each quadrant."""

import numpy as np
from scipy.spatial import cKDTree


def nearest_per_quadrant(xy, radius):
    """Sorted distances to the nearest point in each quadrant, shape (n, 4), NaN last."""
    tree = cKDTree(xy)
    best = np.full((len(xy), 4), np.inf)
    open_rows, k = np.arange(len(xy)), 16
    while len(open_rows):
        k = min(k, len(xy))
        for rows in np.array_split(open_rows, max(1, len(open_rows) * k // 4_000_000)):
            best[rows] = _of_nearest(tree, xy, rows, k, radius)
        if k == len(xy):
            break
        open_rows, k = open_rows[~np.isfinite(best[open_rows]).all(axis=1)], 4 * k
    best[~(best <= radius)] = np.nan
    return np.sort(best, axis=1)


def _of_nearest(tree, xy, rows, k, radius):
    """Nearest per quadrant among the k nearest points."""
    _, near = tree.query(xy[rows], k=k, distance_upper_bound=1.001 * radius)
    near = near.reshape(len(rows), k)
    dx, dy = np.moveaxis(np.vstack([xy, [np.inf, np.inf]])[near] - xy[rows][:, None], 2, 0)
    quadrants = [(dx > 0) & (dy >= 0), (dx <= 0) & (dy > 0), (dx < 0) & (dy <= 0)]
    quadrants.append((dx >= 0) & (dy < 0))
    d = np.sqrt(dx * dx + dy * dy)
    return np.stack([np.where(q, d, np.inf).min(axis=1) for q in quadrants], axis=1)
