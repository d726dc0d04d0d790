"""The planes of a whole cloud: local trials, then growth over a grid of cells, in linear time.

Trials of three neighbouring points need no normals: the profiles of mobile scanners are dense along
and sparse across, and normals from nearest neighbours then describe one scan line, not the wall.
Every trial and every step of growth looks only at the cells around it, so that a kilometre of
street is treated like a room, and no cloud is thinned (Poreba & Goulette 2013 name modelled
principal planes, walls and roads, and leave their detection to a companion paper).
"""

import math
import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.planes import _cells
from mmqa_lab.planes.regression import Plane, fit_plane

CELLS_PER_SIZE = 4
"""Cells of the grid along the smallest plane: points hang together across one of them."""

LEAST_AREA = 0.375
"""Area of the smallest plane in squared sizes: a strip of 1.5 m2 at a size of 2 m."""

ROUGHEST = 0.48
"""Largest residual standard deviation in tolerances; points without any plane have 0.58."""

NARROWEST = 1.2
"""Least standard deviation of a plane's points along its shorter axis, in tolerances."""

ROUNDS = 4
"""Trials are repeated this often among the points that are left."""

THINNEST = 1.0
"""Fewest points per cell of a surface that still hangs together."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A connected planar part of a cloud.

    Parameters
    ----------
    plane : Plane
        Fitted to the points that lie on this plane only, not also on a neighbouring one.
    index : array of int, shape (n,)
        Rows of the cloud within the tolerance, nearest to this plane.
    moments : array, shape (2,)
        Sums of the squared coordinates of the fitted points along the plane's axes, square metres.
    sigma : float
        Standard deviation of the points about the plane, corrected for the tolerance that cuts its
        tails off, m.

    Examples
    --------
    >>> flat = np.random.default_rng(0).uniform(0, 5, (4000, 3)) * [1, 1, 0]
    >>> floor = detect_planes(flat)[0]
    >>> len(floor), floor.plane.normal.round(9).tolist()
    (4000, [0.0, 0.0, 1.0])
    """

    plane: Plane
    index: np.ndarray
    moments: np.ndarray
    sigma: float

    def __len__(self):
        return len(self.index)

    def offset_variance(self, point):
        """Variance of the plane's height at a point, square metres: independent residuals."""
        square = self.plane.project(point[None])[0] ** 2
        return self.sigma**2 * (1 / self.plane.n + (square / self.moments).sum())


def detect_planes(points, *, tolerance=0.05, size=2.0, minimum=None):
    """Find the planes of a cloud of any size.

    The space is cut into cells of a quarter of ``size``. Around the fullest cell of every eight,
    planes through three neighbouring points are tried; the one that most of the neighbourhood lies
    on is refined. The best of these plane pieces grow first, cell by cell, refitted on the way;
    trials are repeated among what is left. At the end each point goes to the nearest plane around
    it, and the planes are fitted again to the points that belong to one plane alone.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance : float
        Largest distance of a point from its plane, m: about three times the noise.
    size : float
        Extent of the smallest plane sought, m. Points of a plane hang together across gaps up
        to a quarter of it: keep that above the distance of scan lines.
    minimum : int, optional
        Least number of points of a plane, beside its least area of 0.375 ``size`` squared, which
        grows with the density by itself. Default 30.

    Returns
    -------
    list of Patch
        The one with the most points first; empty when there is none.

    Raises
    ------
    ValueError
        If a setting is not positive, a coordinate is not finite, or the cloud is too large for its
        cells to be numbered.

    Warns
    -----
    UserWarning
        If the cloud is too thin for planes of this size.

    Notes
    -----
    Time and memory grow linearly with the points. Nothing is random: equal clouds give equal
    planes. Curved and rough surfaces come out as several planes or none. Planes closer to each
    other than the tolerance are one.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges where principal planes meet.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (1500, 3))
    >>> floor, wall = flat * [1, 1, 0], flat * [1, 0, 1]
    >>> [len(patch) > 1400 for patch in detect_planes(np.concatenate([floor, wall]))]
    [True, True]
    """
    points = check_points(points, minimum=0)
    tolerance = check_positive(tolerance, "tolerance", unit="m")
    size = check_positive(size, "size", unit="m")
    minimum = check_count(30 if minimum is None else minimum, "minimum", low=3)
    if len(points) < minimum:
        return []
    grid = _cells.Grid(points, size / CELLS_PER_SIZE)
    _warn_if_thin(grid, size)
    search = _cells.Search(grid, tolerance, max(minimum, 3), LEAST_AREA * CELLS_PER_SIZE**2)
    for _ in range(ROUNDS):
        if not search.round():
            break
    owner, clear = search.assigned()
    return _patches(points, owner, clear, tolerance, minimum)


def _warn_if_thin(grid, size):
    """Say when surfaces have too few points for their cells to hang together."""
    in_cell = grid.points_per_cell()
    if in_cell < THINNEST:
        density = in_cell / grid.edge**2
        needed = size * np.sqrt(THINNEST / in_cell)
        warnings.warn(
            f"About {density:.2g} points per square metre are too few for planes of {size:g} m: "
            f"some will be missed. Must have a size of {needed:.2g} m or more.",
            stacklevel=3,
        )


def _patches(points, owner, clear, tolerance, minimum):
    """Fitted patches of each owner's points, those without a clear plane left out."""
    order = np.argsort(owner, kind="stable")
    bounds = np.searchsorted(owner[order], np.arange(owner.max(initial=-1) + 2))
    patches = []
    for first, last in pairwise(bounds):
        index = order[first:last]
        fitted = index[clear[index]]
        if len(index) < minimum or len(fitted) < 3:
            continue
        plane = fit_plane(points[fitted])
        moments = (plane.project(points[fitted]) ** 2).sum(axis=0)
        narrow = np.sqrt(moments.min() / plane.n) < NARROWEST * tolerance
        if plane.std <= ROUGHEST * tolerance and not narrow:
            patches.append(Patch(plane, index, moments, _untruncated(plane.std, tolerance)))
    return sorted(patches, key=len, reverse=True)


def _untruncated(std, tolerance):
    """Standard deviation of normal errors of which only those within the tolerance were seen."""
    sigma = std
    for _ in range(20):
        cut = tolerance / max(sigma, 1e-12)
        lost = cut * np.sqrt(2 / np.pi) * np.exp(-(cut**2) / 2) / math.erf(cut / np.sqrt(2))
        sigma = std / np.sqrt(max(1 - lost, 0.34))
    return float(sigma)
