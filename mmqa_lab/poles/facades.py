"""Features of a candidate on a facade: the longest wall within a few metres, and how far it is.

A column, a pipe or the side of a bay is as slender as a pole; what tells them is that they stand
at a wall, which windows, balconies and what is parked before it leave in pieces.
"""

import numpy as np
from numba import njit, prange

from mmqa_lab.poles.candidates import BIN_M, BINS, set_bits
from mmqa_lab.poles.columns import base, near_axis, rows

CELL_M = 0.2
LEAST_BINS = 10
REACH_M = 4.0
OWN_M = 0.3
"""Plan cells with points over 2.5 m of height, within 4 m of the axis, but for the pole's own."""

TURNS = 36
STRIP_M = 0.4
"""Directions in which walls are looked for, and the depth of one in plan."""

NAMES = ("facade_m", "facade_off_m", "facade_share", "facade_bins")
"""Of the straight strip in plan that holds the most tall cells along it: its length that they
cover, how far the axis stands from it, its share of the tall cells around, and the mean number of
their occupied height bins."""


def describe(points, height, axes):
    """Return the features (k, 4) of candidates.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    height : array, shape (n,)
        Above ground, metres.
    axes : array, shape (k, 8)
        Of :func:`mmqa_lab.poles.features.describe`.
    """
    found = rows(tall_cells(points, height))
    out = np.zeros((len(axes), len(NAMES)))
    _facades(found.points, found.start, base(found), axes[:, :2], out)
    return out


def tall_cells(points, height):
    """Return centre and number of occupied height bins, (m, 3), of the tall cells in plan.

    Examples
    --------
    >>> height = np.arange(0.2, 4, 0.1)
    >>> wall = np.stack([0 * height, 0 * height, height], axis=1)
    >>> tall_cells(wall, height).tolist()
    [[0.1, 0.1, 16.0]]
    """
    used = (height > 0.1) & (height < BINS * BIN_M)
    cell = np.floor(points[used, :2] / CELL_M).astype(np.int64)
    low = cell.min(axis=0, initial=0)
    wide = cell[:, 1].max(initial=0) - low[1] + 1
    key = (cell[:, 0] - low[0]) * wide + cell[:, 1] - low[1]
    held = np.unique(key * BINS + (height[used] / BIN_M).astype(np.int64))
    place, bins = np.unique(held // BINS, return_counts=True)
    tall = bins >= LEAST_BINS
    at = np.stack(np.divmod(place[tall], wide), axis=1) + low
    return np.column_stack([(at + 0.5) * CELL_M, bins[tall]])


@njit(cache=True, parallel=True)
def _facades(cells, start, base, xy, out):
    """Write the features of each candidate."""
    for c in prange(len(xy)):
        near = near_axis(cells, start, base, xy[c, 0], xy[c, 1], REACH_M)
        u, v = cells[near, 0] - xy[c, 0], cells[near, 1] - xy[c, 1]
        other = np.hypot(u, v) > OWN_M
        _strip(u[other], v[other], cells[near[other], 2], out[c])


@njit(cache=True)
def _strip(u, v, bins, out):
    """Write length, distance, share and mean bins of the strip that is covered the farthest."""
    half = STRIP_M / 2
    steps = int(2 * REACH_M / half) + 2
    out[0], out[1], out[2], out[3] = 0.0, REACH_M, 0.0, 0.0
    held = np.zeros(steps, np.uint64)  # a bit for each cell's length along the strip
    count, total = np.zeros(steps), np.zeros(steps)
    for turn in range(TURNS):
        c, s = np.cos(np.pi * turn / TURNS), np.sin(np.pi * turn / TURNS)
        held[:] = 0
        count[:] = 0
        total[:] = 0
        for k in range(len(u)):
            step = int((u[k] * s - v[k] * c + REACH_M) / half)
            held[step] |= np.uint64(1) << np.uint64((u[k] * c + v[k] * s + REACH_M) / CELL_M)
            count[step] += 1
            total[step] += bins[k]
        for k in range(steps - 1):
            length = CELL_M * set_bits(held[k] | held[k + 1])
            if length > out[0]:
                n = count[k] + count[k + 1]
                out[0], out[1] = length, abs((k + 1) * half - REACH_M)
                out[2], out[3] = n / len(u), (total[k] + total[k + 1]) / n
