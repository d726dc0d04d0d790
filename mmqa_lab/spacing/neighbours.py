"""The nearest points in sectors around each point, found by a tree of scipy."""

from __future__ import annotations

import numpy as np

__all__ = ["by_direction", "by_quadrant", "nearest_by_sector", "tree_of"]

STEP_DEG = 4.0
"""Step between the directions that are tried, degrees."""

SECTOR_STEPS = 15
"""Width of a sector in steps of STEP_DEG: 60 degrees, a third of all directions."""

AT_ONCE = 1_000_000
"""Number of neighbours that are searched together; it limits the memory."""

PER_THREAD = 30_000
"""Number of points that a thread of scipy searches."""


def tree_of(xy):
    """Return a tree of points that is quickly made."""
    from scipy.spatial import cKDTree

    return cKDTree(xy, balanced_tree=False, compact_nodes=False)


def nearest_by_sector(xy, tree, rows, radius, reach, ranks, fold):
    """Return the result of ``fold`` for the neighbours of the points in rows, (len(rows), ranks).

    ``fold`` takes the distances of the k nearest points (rows, k), infinite beyond the radius and
    for the point itself, and their offsets x + iy (rows, k). If a result is infinite, ``fold`` is
    called again with more neighbours.
    """
    found = np.empty((len(rows), ranks))
    places = np.append(xy[:, 0] + 1j * xy[:, 1], np.inf)  # scipy gives the last if there is none
    waiting = _portions(np.arange(len(rows)), min(reach, len(xy)))
    while waiting:
        part, reach = waiting.pop()
        bound = radius * (1 + 1e-9)  # a little larger, since scipy compares squares
        choices = {"distance_upper_bound": bound, "workers": 1 + len(part) // PER_THREAD}
        _, other = tree.query(xy[rows[part]], np.arange(1, reach + 1), **choices)
        offset = places[other] - places[rows[part], None]
        away = np.sqrt(offset.real**2 + offset.imag**2)
        all_seen = np.isinf(away[:, -1]) | (reach == len(xy))
        away[(away > radius) | (away == 0)] = np.inf
        found[part] = fold(away, offset)
        is_open = ~all_seen & np.isinf(found[part]).any(axis=1)
        waiting += _portions(part[is_open], min(2 * reach, len(xy)))
    return found


def _portions(rows, reach):
    """Blocks of rows whose ``reach`` nearest points fit into memory, each with ``reach``."""
    parts = np.array_split(rows, 1 + len(rows) * reach // AT_ONCE)
    return [(part, reach) for part in parts if len(part)]


def by_quadrant(away, offset):
    """Return the least distance in each quadrant, sorted; quadrants follow from exact signs."""
    dx, dy = offset.real, offset.imag
    place = np.where(dy > 0, dx <= 0, np.where(dy < 0, 2 + (dx >= 0), 2 * (dx < 0)))
    return np.sort(_least(away, place, 4), axis=1)


def by_direction(away, offset):
    """Return the least distance within 30 degrees of each direction that is tried, either way."""
    count = round(180 / STEP_DEG)
    turn = np.angle(offset) / np.pi * count
    steps = _least(away, np.floor(turn + 0.5).astype(int) % count, count)
    half = SECTOR_STEPS // 2
    steps = np.concatenate([steps[:, -half:], steps, steps[:, :half]], axis=1)
    for shift in (1, 2, 4, 7):  # the least of 2, 4, 8 and 15 steps
        steps = np.minimum(steps[:, shift:], steps[:, :-shift])
    return steps


def _least(away, place, count):
    """The least distance of each row in each of ``count`` sectors; infinite in empty sectors."""
    found = np.full(len(away) * count, np.inf)
    first = count * np.arange(len(away))[:, None]
    np.minimum.at(found, (first + place).ravel(), away.ravel())
    return found.reshape(-1, count)
