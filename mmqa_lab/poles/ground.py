"""Height above ground, from the lowest points of a plan grid."""

import numpy as np
from scipy import ndimage

CELL_M = 1.0
WINDOW = 9
"""Cells: lowest points that stand out from a window of 9 m x 9 m are roofs and crowns."""

STEP_M = 0.5
SUPPORT = 3
"""A lowest point far below the cells around it is the ground only with so many points within half a
metre above it, itself included: single stray points below the road are none."""


def height_above_ground(points, *, at=None, cell=CELL_M):
    """Return the height above the ground of each point, or of the points ``at``, metres.

    The lowest point of each cell is the ground, unless it lies more than 0.5 m above what a
    morphological opening leaves, or stands alone more than 0.5 m below one in five of the cells
    around; cells without ground take the nearest cell's. Between cell centres the ground is
    bilinear.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    at : array, shape (m, 3), optional
    cell : float
        Metres.

    Returns
    -------
    array, shape (n,) or (m,)

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2))
    >>> street = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> float(height_above_ground(np.vstack([street, [[10, 10, 3]]]))[-1])
    3.0
    """
    if not len(points):
        return np.empty(0)
    low = points[:, :2].min(axis=0)
    place = (points[:, :2] - low) / cell
    column, row = place.astype(np.int64).T
    shape = int(row.max()) + 1, int(column.max()) + 1
    number = row * shape[1] + column
    lowest = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(lowest, number, points[:, 2])
    support = np.bincount(number[points[:, 2] <= lowest[number] + STEP_M], minlength=len(lowest))
    ground = _opened(_without_strays(lowest.reshape(shape), support.reshape(shape)))
    at = points if at is None else at
    place = (at[:, 1::-1] - low[::-1]) / cell - 0.5
    return at[:, 2] - ndimage.map_coordinates(ground, place.T, order=1, mode="nearest")


def _without_strays(lowest, support):
    """Lowest heights without single points far below the cells around them."""
    alone = (support < SUPPORT) & np.isfinite(lowest)
    if alone.all() or not alone.any():
        return lowest
    sure = _filled(lowest, support >= SUPPORT)
    usual = ndimage.percentile_filter(sure, 20, size=WINDOW, mode="nearest")
    return np.where(alone & (lowest < usual - STEP_M), np.inf, lowest)


def _opened(lowest):
    """Lowest heights without what stands out, and without gaps."""
    filled = _filled(lowest, np.isfinite(lowest))
    opened = ndimage.grey_opening(filled, size=(WINDOW, WINDOW), mode="nearest")
    known = np.isfinite(lowest) & (lowest - opened <= STEP_M)
    return _filled(lowest, known) if known.any() else filled


def _filled(values, known):
    """Values with gaps taken from the nearest known cell."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[tuple(nearest)]
