"""Quadrant distances in each cube's own tangent plane, many cubes in one search.

Each cube is flattened into its plane together with the points around it that lie near the plane.
The flat pieces stand in a row, farther apart than the search reaches, and one call of
:func:`mmqa_lab.neighbourhoods.quadrant_distances` searches them all. Coordinates in the planes are
rounded to 2^-30 m, a nanometre, so that shifting a piece along the row changes no bit of a
distance.

Most points have their four neighbours close by, so a first round gives each piece a narrow margin;
cubes with a point that needs more get the whole radius in a second round.
"""

import numpy as np

from mmqa_lab.maps._grouped import count_near, flatten
from mmqa_lab.maps.cubes import ranges_around
from mmqa_lab.neighbourhoods import quadrant_distances

FIRST_MARGIN = 4.0
"""In mean spacings. Of random points, one quadrant in 300 000 is empty that far."""

AT_ONCE = 2_000_000
"""Flattened points in one search, which bounds the memory."""


def distances_in_planes(cubes, tangents, chosen, *, radius, thickness):
    """Sorted quadrant distances of the points of some cubes, each in its cube's plane.

    Parameters
    ----------
    cubes : Cubes
        With the points around those of interest, as far as ``radius + 2 thickness``.
    tangents : Tangents
    chosen : array of int
        The cubes of interest; they have planes.
    radius, thickness : float
        Neighbours lie within ``radius`` in the plane and ``thickness`` to either side of it, m.

    Returns
    -------
    array, shape (n, 4)
        For all points of ``cubes``, m; NaN for points of other cubes and points off the plane.
    """
    distances = np.full((cubes.xyz.shape[1], 4), np.nan)
    near = FIRST_MARGIN * cubes.cell / np.sqrt(cubes.counts[chosen])
    open_ = _search(cubes, tangents, chosen, np.minimum(near, radius), thickness, distances)
    _search(cubes, tangents, chosen[open_], np.full(open_.sum(), radius), thickness, distances)
    return distances


def _search(cubes, tangents, chosen, margins, thickness, distances):
    """Fill in the distances of the chosen cubes; mask of those that the margin did not settle."""
    unsettled = np.zeros(len(chosen), dtype=bool)
    if not len(chosen):
        return unsettled
    reach = int(np.ceil((margins.max() + 2 * thickness) / cubes.cell))
    ranges = ranges_around(cubes, chosen, reach)
    outlines, counts = count_near(
        cubes.xyz, cubes.starts, ranges, chosen, tangents.centres, tangents.axes, margins, thickness
    )
    batches = np.cumsum(counts) // AT_ONCE
    for batch in np.unique(batches):
        part = np.flatnonzero(batches == batch)
        unsettled[part] = _search_batch(
            cubes, tangents, chosen[part], margins[part], thickness, distances,
            ranges[part], outlines[part], counts[part],
        )  # fmt: skip
    return unsettled


def _search_batch(cubes, tangents, chosen, margins, thickness, distances, ranges, outlines, counts):
    """One row of flat pieces, one search."""
    if not counts.sum():
        return np.zeros(len(chosen), dtype=bool)
    radius = margins.max()
    left = np.floor(1024 * (outlines[:, 0] - margins)) / 1024
    wide = np.ceil(1024 * (outlines[:, 1] + margins - left + 1.01 * radius)) / 1024
    shift = np.append(0.0, np.cumsum(wide)[:-1]) - left
    xy = np.empty((counts.sum(), 2))
    rows = np.empty(len(xy), np.int64)
    flatten(
        cubes.xyz, cubes.starts, ranges, chosen, tangents.centres, tangents.axes, margins,
        thickness, outlines, shift, xy, rows,
    )  # fmt: skip
    found = quadrant_distances(xy, radius=radius)
    own = rows >= 0
    distances[rows[own]] = found[own]
    piece = np.repeat(np.arange(len(chosen)), counts)[own]
    beyond = ~(found[own, 3] <= margins[piece])
    return np.bincount(piece, weights=beyond, minlength=len(chosen)) > 0
