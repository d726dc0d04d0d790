"""Quadrant distances in the tangent planes of many patches in one search.

Each patch is flattened into its plane together with the points around it that lie near the plane.
The flat pieces stand in a row, farther apart than the search reaches, and one call of
:func:`mmqa_lab.spacing.quadrant_distances` searches them all. Coordinates in the planes are
rounded to 2^-30 m, a nanometre, so that shifting a piece along the row changes no bit of a
distance.

Most points have their four neighbours close by, so a first round gives each piece a narrow margin;
patches with a point that needs more get a wider one in the next, up to the radius.
"""

import numpy as np

from mmqa_lab.maps._grouped import flatten, outline_patches
from mmqa_lab.spacing import quadrant_distances

MARGINS = (4.0, 8.0, np.inf)
"""Of the rounds, in mean spacings. Of random points, one quadrant in 300 000 is empty out to the
first; the second is for scan lines, which lie farther apart than the mean says."""

AT_ONCE = 4_000_000
"""Points looked at for one search, which bounds the memory."""


def distances_in_planes(patches, tangents, chosen, around, *, radius, thickness):
    """Sorted quadrant distances of the points of some patches, each in its patch's plane.

    Parameters
    ----------
    patches : Cubes
        Cubes, or piles of them.
    tangents : Tangents
    chosen : array of int
        The patches of interest; they have planes.
    around : function
        ``around(chosen, distance)`` gives the ranges of points as far as ``distance`` from patches,
        shape (m, k, 2).
    radius, thickness : float
        Neighbours lie within ``radius`` in the plane and ``thickness`` to either side of it, m.

    Returns
    -------
    array, shape (n, 4)
        For all points, m; NaN for points of other patches and points off the plane.
    """
    distances = np.full((patches.xyz.shape[1], 4), np.nan)
    choices = {"thickness": thickness, "around": around, "distances": distances}
    for margin in MARGINS:
        near = np.minimum(margin * patches.cell / np.sqrt(patches.counts[chosen]), radius)
        unsettled = np.zeros(len(chosen), dtype=bool)
        cells = np.ceil((near + 2 * thickness) / patches.cell)
        for wide in np.unique(cells):
            part = np.flatnonzero(cells == wide)
            unsettled[part] = _search(patches, tangents, chosen[part], near[part], **choices)
        chosen = chosen[unsettled & (near < radius)]
    return distances


def _search(patches, tangents, chosen, margins, *, thickness, around, distances):
    """Fill in the distances of the chosen patches; mask of those the margin did not settle."""
    planes = tangents.centres, tangents.axes
    outlines = outline_patches(patches.xyz, patches.starts, chosen, *planes, thickness)
    ranges = around(chosen, margins.max() + 2 * thickness)
    candidates = (ranges[:, :, 1] - ranges[:, :, 0]).sum(axis=1)
    some = np.flatnonzero(outlines[:, 0] <= outlines[:, 1])
    batches = np.cumsum(candidates[some]) // AT_ONCE
    unsettled = np.zeros(len(chosen), dtype=bool)
    for batch in np.unique(batches):
        part = some[batches == batch]
        most = candidates[part].sum()
        xy, rows = np.empty((most, 2)), np.empty(most, np.int64)
        counts = flatten(
            patches.xyz, patches.starts, ranges[part], chosen[part], *planes, margins[part],
            thickness, outlines[part], _side_by_side(outlines[part], margins[part]), xy, rows,
        )  # fmt: skip
        rows = rows[: counts.sum()]
        own = rows >= 0
        found = quadrant_distances(xy[: len(rows)], radius=margins[part].max(), of=own)[own]
        distances[rows[own]] = found
        piece = np.repeat(part, counts)[own]
        beyond = ~(found[:, 3] <= margins[piece])
        unsettled |= np.bincount(piece, weights=beyond, minlength=len(chosen)) > 0
    return unsettled


def _side_by_side(outlines, margins):
    """Shifts along the row that keep the pieces apart; whole 1024ths of a metre, so exact."""
    left = np.floor(1024 * (outlines[:, 0] - margins)) / 1024
    wide = np.ceil(1024 * (outlines[:, 1] + margins - left + 1.01 * margins.max())) / 1024
    return np.append(0.0, np.cumsum(wide)[:-1]) - left
