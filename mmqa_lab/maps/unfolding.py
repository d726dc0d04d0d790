"""Quadrant distances in the tangent planes of many patches in one search.

Each patch is flattened into its plane together with the points around it that lie near the plane.
The flat pieces stand in a row, farther apart than the search reaches, and one call of
:func:`mmqa_lab.neighbourhoods.quadrant_distances` searches them all. Coordinates in the planes are
rounded to 2^-30 m, a nanometre, so that shifting a piece along the row changes no bit of a
distance.

Most points have their four neighbours close by, so a first round gives each piece a narrow margin;
patches with a point that needs more get a wider one in the next, up to the radius.
"""

import numpy as np

from mmqa_lab.maps._grouped import count_near, flatten
from mmqa_lab.neighbourhoods import quadrant_distances

MARGINS = (4.0, 8.0, np.inf)
"""Of the rounds, in mean spacings. Of random points, one quadrant in 300 000 is empty out to the
first; the second is for scan lines, which lie farther apart than the mean says."""

AT_ONCE = 2_000_000
"""Flattened points in one search, which bounds the memory."""


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
        unsettled = _search(patches, tangents, chosen, near, **choices)
        chosen = chosen[unsettled & (near < radius)]
    return distances


def _search(patches, tangents, chosen, margins, *, thickness, around, distances):
    """Fill in the distances of the chosen patches; mask of those the margin did not settle."""
    unsettled = np.zeros(len(chosen), dtype=bool)
    if not len(chosen):
        return unsettled
    ranges = around(chosen, margins.max() + 2 * thickness)
    planes = tangents.centres, tangents.axes
    outlines, counts = count_near(
        patches.xyz, patches.starts, ranges, chosen, *planes, margins, thickness
    )
    some = np.flatnonzero(counts)
    batches = np.cumsum(counts[some]) // AT_ONCE
    for batch in np.unique(batches):
        part = some[batches == batch]
        shift = _side_by_side(outlines[part], margins[part])
        xy, rows = np.empty((counts[part].sum(), 2)), np.empty(counts[part].sum(), np.int64)
        flatten(
            patches.xyz, patches.starts, ranges[part], chosen[part], *planes, margins[part],
            thickness, outlines[part], shift, xy, rows,
        )  # fmt: skip
        found = quadrant_distances(xy, radius=margins[part].max())
        own = rows >= 0
        distances[rows[own]] = found[own]
        piece = np.repeat(part, counts[part])[own]
        beyond = ~(found[own, 3] <= margins[piece])
        unsettled |= np.bincount(piece, weights=beyond, minlength=len(chosen)) > 0
    return unsettled


def _side_by_side(outlines, margins):
    """Shifts along the row that keep the pieces apart; whole 1024ths of a metre, so exact."""
    left = np.floor(1024 * (outlines[:, 0] - margins)) / 1024
    wide = np.ceil(1024 * (outlines[:, 1] + margins - left + 1.01 * margins.max())) / 1024
    return np.append(0.0, np.cumsum(wide)[:-1]) - left
