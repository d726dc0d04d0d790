"""The first polygon on a surface, and typed ones."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from mmqa_lab._checks import check_polygon
from mmqa_lab.spacing import quadrant_distances

__all__ = ["SHOWN", "corners_of", "largest_rectangle"]

# Most points drawn, and tried for a rectangle. All are used.
SHOWN = 10_000


def corners_of(text: str) -> np.ndarray:
    """Return typed corners, shape (m, 3): a line each, decimals behind a point or a comma.

    Examples
    --------
    >>> corners_of("1.5, 2, 3; 4,5 6 7; 0 0 1").tolist()
    [[1.5, 2.0, 3.0], [4.5, 6.0, 7.0], [0.0, 0.0, 1.0]]
    """
    rows = [one.strip(" ,") for one in re.split(r"[;\n]", text) if one.strip(" ,")]
    cut = [re.split(r",?\s+", one) if re.search(r"\s", one) else one.split(",") for one in rows]
    return check_polygon([[float(one.replace(",", ".")) for one in row] for row in cut])


def largest_rectangle(xy: ArrayLike) -> np.ndarray:
    """Return the largest rectangle along the axes without gaps between points.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates, m.

    Returns
    -------
    array, shape (4, 2)
        Its corners, m, in steps of a sixtieth of the longer extent or three times the spacing.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05))
    >>> band = np.column_stack([x.ravel(), y.ravel()])[(abs(x - y) < 1).ravel()]
    >>> corners = largest_rectangle(band)
    >>> bool((np.abs(corners @ [1, -1]) < 1.25).all())
    True
    """
    xy = np.asarray(xy, dtype=np.float64)
    extent = np.ptp(xy, axis=0)
    some = np.arange(len(xy)) % (1 + len(xy) // SHOWN) == 0
    away = quadrant_distances(xy, radius=extent.max() / 4, of=some)[:, -1]
    away = away[~np.isnan(away)]
    edge = max(extent.max() / 60, 3 * np.median(away)) if len(away) else extent.max() / 10
    cells = np.maximum(1, (extent / edge).astype(int))
    counts, x, y = np.histogram2d(xy[:, 0], xy[:, 1], bins=cells)
    filled = ndimage.binary_closing(np.pad(counts > 0, 1))[1:-1, 1:-1] | (counts > 0)
    best, heights = (0, 0, 0, 0, 0), np.zeros(filled.shape[1], dtype=int)
    for end, row in enumerate(filled, 1):
        heights = (heights + 1) * row
        for first in range(len(row)):
            lowest = np.minimum.accumulate(heights[first:])
            areas = lowest * np.arange(1, len(lowest) + 1)
            k = np.argmax(areas)
            best = max(best, (areas[k], end - lowest[k], first, end, first + k + 1))
    _, x0, y0, x1, y1 = best
    return np.array([(x[x0], y[y0]), (x[x1], y[y0]), (x[x1], y[y1]), (x[x0], y[y1])])
