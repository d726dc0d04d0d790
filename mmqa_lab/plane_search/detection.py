"""The planes of a cloud, and how small they may be."""

from __future__ import annotations

import contextlib
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import lambertw

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab._compiled import in_threads
from mmqa_lab._progress import progress
from mmqa_lab.cloud import extent, sort_into_cells
from mmqa_lab.plane_search.growth import (
    CELLS_PER_SIZE,
    LEAST_AREA,
    LEAST_TRIAL,
    Grid,
    assign,
    grow,
    try_planes,
)
from mmqa_lab.planes import Plane, fit_plane, sigma_mad

__all__ = ["PlanePart", "detect_planes", "usual_size"]


# Limits of the least number of points of a plane; its least area sets the number in between.
FEWEST_LIMITS = 10, 30


# Default extents of the smallest plane, m: for points that fill the cells, for scan lines that are
# too far apart for that, and the largest extent, for thin clouds.
USUAL_SIZES = 1.5, 2.0, 3.0


# Points farther from their plane than TRIM standard deviations are not fitted. The factor TRIMMED
# corrects the standard deviation of trimmed normal errors, and that of their mean.
TRIM, TRIMMED = 2.5, 1.05


@dataclass(frozen=True, eq=False)
class PlanePart:
    """A connected planar part of a cloud.

    Parameters
    ----------
    plane : Plane
        Fitted to the points that lie within 2.5 standard deviations of this plane and on no
        neighbouring plane.
    index : array of int, shape (n,)
        Rows of the cloud within the tolerance, nearest to this plane.
    clear : array of int, shape (m,)
        Those of them whose foot on the plane is clear of all other planes.
    moments : array, shape (2,)
        Sums of the squared coordinates of the fitted points along the plane's axes, square metres.
    sigma : float
        Standard deviation of the points about the plane, m, if their errors are independent.
    """

    plane: Plane
    index: np.ndarray
    clear: np.ndarray
    moments: np.ndarray
    sigma: float

    def __len__(self):
        return len(self.index)

    def offset_variance(self, point: np.ndarray) -> float:
        """Variance of the plane's height at a point (3,), m^2, for independent residuals."""
        square = self.plane.project(point[None])[0] ** 2
        return (TRIMMED * self.sigma) ** 2 * (1 / self.plane.n + (square / self.moments).sum())


def detect_planes(
    points: ArrayLike, *, tolerance: float = 0.05, size: float = 2.0
) -> list[PlanePart]:
    """Find the planes of a cloud of any size.

    The space is cut into cells with an edge of a quarter of ``size``. In every block of eight cells
    planes through three neighbouring points are tried around the fullest cell. The plane with most
    points of the neighbourhood is fitted to them. The best of these planes grow first, cell by
    cell, are fitted again and grow again. The trials are repeated among the remaining points. At
    the end each point goes to the nearest plane around it. The planes are then fitted again to the
    points that belong to a single plane.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance : float
        Largest distance of a point from its plane, m: about three times the noise.
    size : float
        Extent of the smallest plane sought, m. Points of a plane are connected across gaps of up to
        a quarter of ``size``, which should exceed the distance between scan lines. The least area
        of a plane is a quarter of ``size`` squared. The least number of points is the number on
        that area, limited to 10 to 30.

    Returns
    -------
    list of PlanePart
        Sorted by number of points, largest first; empty if there is no plane.

    Raises
    ------
    ValueError
        If a setting is not positive, a coordinate is not finite, or the cloud has too many cells to
        number.

    Warns
    -----
    UserWarning
        If the cloud is too thin for planes of this size.

    See Also
    --------
    mmqa_lab.planes.fit_plane : the plane of points that are known to lie on one.

    Notes
    -----
    Time and memory grow linearly with the number of points. Equal clouds give equal planes. A
    curved or rough surface gives several planes or none. Planes closer to each other than the
    tolerance are merged.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges where principal planes meet.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (1500, 3))
    >>> floor, wall = flat * [1, 1, 0], flat * [1, 0, 1]
    >>> [len(part) > 1400 for part in detect_planes(np.concatenate([floor, wall]))]
    [True, True]
    """
    points = check_points(points, minimum=0)
    tolerance = check_positive(tolerance, "tolerance", unit="m")
    size = check_positive(size, "size", unit="m")
    if len(points) < FEWEST_LIMITS[0]:
        return []
    # sums and trials depend on the points alone, not on the order of their rows
    x, y, z = (points - extent(points)[0]).T
    order = np.argsort(x + np.sqrt(2) * y + np.sqrt(3) * z, kind="stable")
    grid = Grid(points[order], size / CELLS_PER_SIZE)
    in_cell = _points_per_cell(grid.start)
    if in_cell < 1:  # surfaces are not connected
        thin = f"Few cells of {grid.edge:g} m have a second point."
        warnings.warn(
            f"{thin} Planes of {size:g} m may be missing or cut into parts.", stacklevel=2
        )
    minimum = int(np.clip(LEAST_AREA * CELLS_PER_SIZE**2 * in_cell, *FEWEST_LIMITS))
    search = _Search(grid, tolerance, minimum)
    found = True
    for _ in progress(range(4), "round"):  # to its end: no bar stays
        found = found and search.round()
    return search.parts(order[grid.order])


def usual_size(points: np.ndarray) -> float:
    """Return the extent of the smallest plane that points (n, 3) support, m."""
    points = check_points(points, minimum=0)
    if not len(points):
        return USUAL_SIZES[1]
    points = points - extent(points)[0]
    _, starts, fine = sort_into_cells(points, USUAL_SIZES[0] / CELLS_PER_SIZE)
    doubled = sort_into_cells(fine, 2)[2]
    in_cell = _points_per_cell(starts)
    at_random = 4 * np.expm1(-in_cell) / np.expm1(-4 * in_cell)
    filled = len(fine) >= 0.8 * at_random * len(doubled)
    # of 2.4 to 4.4 points per cell, 2.8 to 3.8 gave most edges on simulated streets
    carried = USUAL_SIZES[0] * np.sqrt(3.2 / in_cell)
    return float(np.clip(carried, USUAL_SIZES[0 if filled else 1], USUAL_SIZES[2]))


def _points_per_cell(start):
    """Mean number of points per cell of a surface, its empty cells included.

    With a mean of x, the occupied cells (bounded by ``start``) have x / (1 - exp(-x)) on average.
    """
    seen = np.median(np.diff(start)[:: max(1, len(start) // 100_000)])
    mean = max(float(np.diff(start).mean()), 1.0 + 1e-9) if seen < 3 else seen
    return mean + lambertw(-mean * np.exp(-mean)).real


class _Search:
    """Planes found so far (centre, normal), the cells around each, and the owners of the points."""

    def __init__(self, grid, tolerance, least_points):
        self.grid, self.tolerance, self.least = grid, tolerance, least_points
        self.cells = grid.points, grid.start, grid.near(np.arange(len(grid.keys)), 1)
        self.owner = np.full(len(grid.points), -1)
        self.planes, self.around = [], []
        self.trials = np.random.default_rng(0).random((32, 3))

    def round(self):
        """Try planes among the free points and grow them; return whether any was found."""
        grid, before = self.grid, len(self.planes)
        counts = np.add.reduceat(self.owner < 0, grid.start[:-1], dtype=np.int64)
        # the fullest cell of every block of eight
        fullest = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
        blocks = np.ravel_multi_index((grid.places[fullest] // 2).T, grid.shape)
        seeds = np.sort(fullest[np.unique(blocks, return_index=True)[1]])
        planes, scores = np.zeros((len(seeds), 2, 3)), np.zeros(len(seeds))
        given = self.cells, self.owner, counts, seeds, grid.near(seeds, 2), self.trials
        limits = self.tolerance, grid.edge
        in_threads(try_planes, len(seeds), *given, *limits, planes, scores)
        best = np.argsort(-scores, kind="stable")
        best = best[scores[best] > LEAST_TRIAL / 2]
        seeds, planes = seeds[best], planes[best]
        marks, seen = np.zeros((2, len(counts)), dtype=np.int64)
        done, limits = 0, (self.tolerance, self.least)
        while done < len(seeds):
            given = self.cells, self.owner, len(self.planes), seeds, planes, limits
            done, n = grow(*given, done, marks, seen)
            if n:
                self.planes.append(planes[done - 1])
                self.around.append(seen[:n].copy())
        return len(self.planes) > before

    def parts(self, rows):
        """Fitted parts of a cloud with these rows in the cells; none without a clear plane.

        The owner of a point is the nearest plane around it within the tolerance. That is the only
        plane of the point if its foot there is clear of all others. With this rule noise removes
        as many points on one side of the plane as on the other.
        """
        if not self.planes:
            return []
        planes, n = np.array(self.planes), len(rows)
        bounds = np.cumsum([0, *map(len, self.around)])
        surfaces = np.concatenate(self.around), bounds, planes
        for _ in range(2):
            owner, height, clear = np.full(n, -1), np.full(n, self.tolerance), np.full(n, True)
            values = assign(self.cells, *surfaces, self.tolerance, owner, height, clear)
        order = np.argsort(owner, kind="stable")
        starts = np.searchsorted(owner[order], np.arange(len(planes) + 1))
        parts, found = [], enumerate(np.split(order, starts)[1:-1])
        for k, index in progress(found, "plane", total=len(planes)):
            fitted = index[clear[index]]
            if len(index) < self.least or len(fitted) < 3:
                continue
            spread = np.sqrt(np.maximum(values[k], 0) / len(fitted))
            # points without any plane have a ratio of 0.58
            if spread[0] > 0.48 * self.tolerance or spread[1] < 1.2 * self.tolerance:
                continue
            with contextlib.suppress(ValueError):  # all but strays lie on one line
                plane, *spreads = _trimmed(self.grid.points[fitted], *planes[k], self.tolerance)
                plane = replace(plane, centre=plane.centre + self.grid.low)
                parts.append(PlanePart(plane, rows[index], rows[fitted], *spreads))
        return sorted(parts, key=len, reverse=True)


def _trimmed(points, centre, normal, tolerance):
    """Plane of the points near it, their moments along its axes, and their standard deviation."""
    off = residuals = (points - centre) @ normal
    # points of window reveals lie on one side of a wall, within the tolerance
    for _ in range(2):
        most = TRIM * max(sigma_mad(residuals), 0.02 * tolerance)
        core = points[np.abs(off - np.median(residuals)) <= most]
        plane = fit_plane(core)
        off, residuals = plane.distances(points), plane.residuals
    sigma = TRIMMED * np.sqrt((residuals**2).sum() / max(len(core) - 3, 1))
    local = core - plane.centre
    return plane, ((plane.axes @ (local.T @ local)) * plane.axes).sum(axis=1), float(sigma)
