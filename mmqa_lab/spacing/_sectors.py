"""The search for the nearest point near each of many directions."""

import numpy as np
from numba import njit


def nearest_per_sector(xy, limit, count, width):
    """Distances to the nearest point in each of ``count`` overlapping sectors, shape (n, count).

    Directions are axial: 0 to 180 degrees in ``count`` steps, each the middle of a sector ``width``
    (odd) steps wide that is open both ways. Infinite where no point is within ``limit``.
    """
    low = xy.min(axis=0)
    extent = np.ptp(xy, axis=0).max()
    cell = max(np.sqrt(2 * np.prod(np.ptp(xy, axis=0)) / len(xy)), extent / len(xy), limit / 64)
    cells = ((xy - low) / cell).astype(np.int64)
    shape = cells.max(axis=0) + 1
    flat = cells[:, 1] * shape[0] + cells[:, 0]
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(np.prod(shape) + 1))
    nearest = np.empty((len(xy), count))
    _search(xy[order] - low, cells[order], shape, first, cell, limit, width, nearest)
    back = np.empty_like(nearest)
    back[order] = nearest
    return back


@njit(cache=True, nogil=True)
def _search(xy, cells, shape, first, cell, limit, width, out):
    """Widen a square of cells around each point until every sector has its nearest point."""
    count = out.shape[1]
    steps, wide = np.empty(count), np.empty(count + width - 1)
    for i in range(len(xy)):
        steps[:] = np.inf
        x, y = xy[i]
        cx, cy = cells[i]
        ring = 0
        while True:
            for row in range(max(cy - ring, 0), min(cy + ring, shape[1] - 1) + 1):
                whole = abs(row - cy) == ring
                for column in range(cx - ring, cx + ring + 1, 1 if whole else 2 * ring):
                    if 0 <= column < shape[0]:
                        at = row * shape[0] + column
                        for j in range(first[at], first[at + 1]):
                            _note(xy[j, 0] - x, xy[j, 1] - y, steps)
            # all points up to that distance have been seen
            seen = min(x - (cx - ring) * cell, (cx + ring + 1) * cell - x)
            seen = min(seen, y - (cy - ring) * cell, (cy + ring + 1) * cell - y)
            farthest = _widened(steps, width, wide, out[i])
            if seen >= min(farthest, limit):
                break
            ring += 1
        for k in range(count):
            if out[i, k] > limit:
                out[i, k] = np.inf


@njit(cache=True, nogil=True, inline="always")
def _note(dx, dy, steps):
    """Keep a neighbour when it is the nearest of its step of direction."""
    distance = np.sqrt(dx * dx + dy * dy)
    if distance > 0:
        turn = np.arctan2(dy, dx) / np.pi * len(steps)
        k = int(np.floor(turn + 0.5)) % len(steps)
        steps[k] = min(steps[k], distance)


@njit(cache=True, nogil=True)
def _widened(steps, width, wide, nearest):
    """The nearest over ``width`` steps about each; returns the largest of them."""
    count, half = len(steps), width // 2
    for k in range(len(wide)):
        wide[k] = steps[(k - half) % count]
    span = 1
    while 2 * span <= width:  # minima over 2, 4, 8, ... steps
        for k in range(len(wide) - span):
            wide[k] = min(wide[k], wide[k + span])
        span *= 2
    farthest = 0.0
    for k in range(count):
        nearest[k] = min(wide[k], wide[k + width - span])
        farthest = max(farthest, nearest[k])
    return farthest
