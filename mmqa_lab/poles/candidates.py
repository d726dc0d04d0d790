"""Candidates: places in plan where points stand above each other with nothing around them."""

import numpy as np
from scipy import ndimage

from mmqa_lab.poles.thinning import BIN_M

__all__ = ["candidates"]

GRID_M = 0.1
"""Plan cells of candidates."""

SCALES = ((1, 4), (2, 5), (4, 7), (1, 0))
"""Half width of the core and of the ring around it, in cells; a ring of 0 is not tested."""

SCATTER_M, WIDEST = (0.25, 0.06), 4
"""Scatter about the axis on the widest and on all other scales, m; core of the widest, cells."""

TILE, MARGIN = 200, 12
"""Cells along the side of a tile, few enough for a processor's cache, and what counts beside it."""


def candidates(thin):
    """Return plan places (k, 2) and the scatter of points about the axis (k,), metres.

    On one of four scales a place is a local maximum of the count of clean height bins: bins with
    points in the core and an empty ring.
    """
    cell = np.floor(thin.points[:, :2] / GRID_M).astype(np.int64)
    rows = np.unique(np.column_stack([cell, (thin.height / BIN_M).astype(np.int64)]), axis=0)
    low = rows[:, :2].min(axis=0)
    tiles = np.unique((rows[:, :2] - low) // TILE, axis=0)
    found = []
    for corner in low + tiles * TILE - MARGIN:
        ends = np.searchsorted(rows[:, 0], corner[0] + [0, TILE + 2 * MARGIN])
        place = rows[slice(*ends)] - [*corner, 0]
        x, y, level = place[(place[:, 1] >= 0) & (place[:, 1] < TILE + 2 * MARGIN)].T
        bits = np.zeros((TILE + 2 * MARGIN,) * 2, np.uint64)
        np.add.at(bits, (x, y), np.uint64(1) << level.astype(np.uint64))  # unique: sum = union
        found.append(_tops(bits) + [*corner, 0])
    found = np.unique(np.concatenate(found), axis=0)
    return (found[:, :2] + 0.5) * GRID_M, np.where(found[:, 2], *SCATTER_M)


def _spread(bits, half, axis):
    """Union over the cells up to ``half`` away along an axis."""
    out, width, wanted = np.moveaxis(bits.copy(), axis, 0), 1, 2 * half + 1
    while width < wanted:  # windows of twice the width, then of the one that is asked for
        step = min(width, wanted - width)
        out[:-step] |= out[step:]
        width += step
    return np.roll(np.moveaxis(out, 0, axis), half, axis)


def _tops(bits):
    """Local maxima of clean bins in a tile: row, column, and 1 on the widest scale, else 0."""
    held = np.bitwise_count(bits).astype(np.float32)
    found = np.zeros((*bits.shape, 2), bool)
    for core, ring in SCALES:
        clean = _spread(_spread(bits, core, 0), core, 1)
        for half in (ring - 1, ring) if ring else ():
            for axis in (0, 1):
                side = _spread(bits, half, axis)
                clean &= ~(np.roll(side, half, 1 - axis) | np.roll(side, -half, 1 - axis))
        value = np.bitwise_count(clean).astype(np.float32)
        if core == WIDEST:  # a wide shaft seen from all sides is hollow
            more, inside = 80 * ndimage.gaussian_filter(held, 3.5, truncate=2.0), True
        else:
            box = 2 * core + 1
            more, inside = 4 * held + ndimage.uniform_filter(held, box) * box**2, bits > 0
        value = np.where((value >= 3) & inside, value + more / (more + 50), 0)
        size = 2 * max(core + 1, 3) + 1
        found[..., int(core == WIDEST)] |= (value > 0) & (
            value == ndimage.maximum_filter(value, size)
        )
    found[:MARGIN] = found[-MARGIN:] = found[:, :MARGIN] = found[:, -MARGIN:] = False
    return np.argwhere(found)
