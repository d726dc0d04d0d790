"""Planes of a whole cloud, from local trials and growth over a grid of cells, in linear time.

A trial of three neighbouring points needs no normals. Profiles of mobile scanners are dense along
the line and sparse across it, so normals from nearest neighbours describe a scan line, not the
wall. Every trial and every step of growth uses only the cells around it. So a kilometre of street
is treated like a room, and no cloud is thinned. Poreba & Goulette 2013 name principal planes, such
as walls and roads, and leave their detection to a companion paper.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.special import lambertw

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab._compiled import in_threads
from mmqa_lab.cloud import extent, sort_into_cells
from mmqa_lab.planes import Plane, fit_plane, sigma_mad

__all__ = ["CELLS_PER_SIZE", "Grid", "PlanePart", "detect_planes", "usual_size"]

# Cells of the grid along the smallest plane, and its least area in squared sizes (1 m2 at 2 m).
# Points of a plane are connected across one cell.
CELLS_PER_SIZE, LEAST_AREA = 4, 0.25

# Limits of the least number of points of a plane; its least area sets the number in between.
FEWEST_LIMITS = 10, 30

# Default extents of the smallest plane, m: for points that fill the cells, for scan lines that are
# too far apart for that, and the largest extent, for thin clouds.
USUAL_SIZES = 1.5, 2.0, 3.0

# Points farther from their plane than TRIM standard deviations are not fitted. The factor TRIMMED
# corrects the standard deviation of trimmed normal errors, and that of their mean.
TRIM, TRIMMED = 2.5, 1.05

# Least number of points of a trial; the most from one cell, so that dense and sparse parts count
# alike; the most in all, the nearest ones.
LEAST_TRIAL, DRAWN, NEAREST = 6, 3, 64


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
    for _ in range(4):
        if not search.round():
            break
    return search.parts(order[grid.order])


def usual_size(points: np.ndarray) -> float:
    """Extent of the smallest plane that points (n, 3) support, m."""
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


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their lowest corner ``low`` and in the order of the cells; ``order``
    has their rows in the cloud. ``start`` bounds the cells and ``places`` has their indices.
    """

    def __init__(self, points, edge):
        self.edge, self.low = edge, extent(points)[0]
        points = points - self.low
        self.order, self.start, self.places = sort_into_cells(points, edge)
        self.points = points[self.order]
        # with five more places no cell follows one that it does not touch
        self.shape = self.places.max(axis=0) + 5
        self.keys = np.ravel_multi_index((self.places + 2).T, self.shape)

    def near(self, cells: np.ndarray, reach: int) -> np.ndarray:
        """Runs (first, last + 1) of cells within ``reach`` of ascending cells, (n, columns, 2)."""
        side = np.arange(-reach, reach + 1)
        column = (side[:, None] * self.shape[1] + side).ravel() * self.shape[2]
        runs = np.empty((len(cells), len(column), 2), np.int32)
        _find_runs(self.keys, cells, column, reach, runs)
        return runs


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
        in_threads(_try_planes, len(seeds), *given, *limits, planes, scores)
        best = np.argsort(-scores, kind="stable")
        best = best[scores[best] > LEAST_TRIAL / 2]
        seeds, planes = seeds[best], planes[best]
        marks, seen = np.zeros((2, len(counts)), dtype=np.int64)
        done, limits = 0, (self.tolerance, self.least)
        while done < len(seeds):
            given = self.cells, self.owner, len(self.planes), seeds, planes, limits
            done, n = _grow(*given, done, marks, seen)
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
            values = _assign(self.cells, *surfaces, self.tolerance, owner, height, clear)
        order = np.argsort(owner, kind="stable")
        starts = np.searchsorted(owner[order], np.arange(len(planes) + 1))
        parts = []
        for k, index in enumerate(np.split(order, starts)[1:-1]):
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


@njit(cache=True)
def _find_runs(keys, cells, column, reach, runs):
    """Write the cells with keys within ``reach`` of each cell's key and what leads to a column."""
    for j in range(len(column)):
        first, last = 0, 0
        for k in range(len(cells)):
            middle = keys[cells[k]] + column[j]
            while first < len(keys) and keys[first] < middle - reach:
                first += 1
            while last < len(keys) and keys[last] <= middle + reach:
                last += 1
            runs[k, j, 0], runs[k, j, 1] = first, last


@njit(cache=True)
def _off(points, p, plane):
    """Signed distance of a point from a plane."""
    x, y, z = points[p, 0] - plane[0, 0], points[p, 1] - plane[0, 1], points[p, 2] - plane[0, 2]
    return x * plane[1, 0] + y * plane[1, 1] + z * plane[1, 2]


@njit(cache=True)
def _add(moments, points, p, plane):
    """Add a point to the moments (4, 4): products of 1, x, y and z about a plane's centre."""
    x, y, z = points[p, 0] - plane[0, 0], points[p, 1] - plane[0, 1], points[p, 2] - plane[0, 2]
    place = 1.0, x, y, z
    for i in range(4):
        for j in range(4):
            moments[i, j] += place[i] * place[j]


@njit(cache=True)
def _fit(moments, plane):
    """Write the least-squares plane of moments about its centre; return the sums of squares."""
    n, sums, scatter = moments[0, 0], moments[0, 1:], moments[1:, 1:].copy()
    for i in range(3):
        plane[0, i] += sums[i] / n
        for j in range(3):
            scatter[i, j] -= sums[i] * sums[j] / n
    values, vectors = np.linalg.eigh(scatter)
    plane[1] = vectors[:, 0]
    return values


@njit(cache=True)
def _drawn(cells, owner, counts, near, seed, local, far):
    """Write free points around a seed cell, evenly drawn, as columns; return their number."""
    points, start, _ = cells
    n, middle = 0, start[seed]
    for first, last in near:
        for cell in range(first, last):
            stride, free = (counts[cell] + DRAWN - 1) // DRAWN, 0
            for p in range(start[cell], start[cell + 1]):
                if owner[p] < 0:
                    if free % stride == 0:
                        far[n] = 0.0
                        for i in range(3):
                            local[i, n] = points[p, i]
                            far[n] = max(far[n], abs(points[p, i] - points[middle, i]))
                        n += 1
                    free += 1
    if n > NEAREST:
        reach, k = np.sort(far[:n])[NEAREST - 1], 0
        for j in range(n):
            for i in range(3):
                local[i, k] = local[i, j]
            k += far[j] <= reach
        n = k
    return n


@njit(cache=True, nogil=True)
def _try_planes(
    begin, end, cells, owner, counts, seeds, near, trials, tolerance, edge, planes, scores
):
    """Write the plane fitted to what the best plane of three points takes, and its score."""
    room, far = np.empty((3, DRAWN * 125)), np.empty(DRAWN * 125)
    for s in range(begin, end):
        n, best, plane = _drawn(cells, owner, counts, near[s], seeds[s], room, far), 0, planes[s]
        if n < LEAST_TRIAL:
            continue
        x, y, z = room[0, :n], room[1, :n], room[2, :n]
        for t in range(len(trials)):
            a, b, c = int(trials[t, 0] * n), int(trials[t, 1] * n), int(trials[t, 2] * n)
            ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
            vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area = math.sqrt(nx * nx + ny * ny + nz * nz)
            if area <= 0.5 * edge**2:
                continue
            nx, ny, nz = nx / area, ny / area, nz / area
            offset, votes = x[a] * nx + y[a] * ny + z[a] * nz, 0
            for k in range(n):
                votes += abs(x[k] * nx + y[k] * ny + z[k] * nz - offset) <= tolerance
            if votes > best:
                best = votes
                plane[0, 0], plane[0, 1], plane[0, 2] = x[a], y[a], z[a]
                plane[1, 0], plane[1, 1], plane[1, 2] = nx, ny, nz
        if best < LEAST_TRIAL:
            continue
        moments = np.zeros((4, 4))
        for k in range(n):
            if abs(_off(room.T, k, plane)) <= tolerance:
                _add(moments, room.T, k, plane)
        # points without any plane have a mean square residual of a third of the squared tolerance
        number = moments[0, 0]
        scores[s] = number - _fit(moments, plane)[0] / (tolerance**2 / 3)


@njit(cache=True)
def _spread(cells, owner, seed, plane, tolerance, mark, marks, seen, moments):
    """Cells seen from those that a plane takes, from a seed on: their number and that of taken.

    ``moments`` become those of its free points there. ``marks`` of cells seen become ``mark``, of
    those taken one more. The last number returned is that of free points beside the plane.
    """
    points, start, near = cells
    marks[seed], seen[0] = mark, seed
    done, n, taken, beside = 0, 1, 0, 0
    moments[:] = 0
    while done < n:
        cell, on = seen[done], 0
        done += 1
        for p in range(start[cell], start[cell + 1]):
            if owner[p] < 0:
                off = abs(_off(points, p, plane))
                on += off <= tolerance
                beside += off <= 3 * tolerance
        # tails of a noisy wall and strips of a floor have a smaller share
        if on == 0 or on < 0.25 * (start[cell + 1] - start[cell]):
            continue
        taken, beside, marks[cell] = taken + 1, beside - on, mark + 1
        for p in range(start[cell], start[cell + 1]):
            if owner[p] < 0 and abs(_off(points, p, plane)) <= tolerance:
                _add(moments, points, p, plane)
        for first, last in near[cell]:
            for other in range(first, last):
                if marks[other] < mark:
                    marks[other], seen[n] = mark, other
                    n += 1
    return n, taken, beside


@njit(cache=True)
def _grow(cells, owner, number, seeds, planes, limits, done, marks, seen):
    """Grow planes until one is large enough, which gets the number.

    Returns the number of seeds done and that of cells around the plane, 0 if there is none.
    """
    (points, start, _), moments = cells, np.zeros((4, 4))
    tolerance, least = limits
    for s in range(done, len(seeds)):
        grown, enough = 0, True
        for turn in range(4):
            mark = 8 * s + 2 * turn + 1
            if turn:
                _fit(moments, planes[s])
            n, taken, beside = _spread(
                cells, owner, seeds[s], planes[s], tolerance, mark, marks, seen, moments
            )
            enough = taken >= LEAST_AREA * CELLS_PER_SIZE**2 and moments[0, 0] >= least
            if not enough or taken <= grown:
                break
            grown = taken
        # a filled volume has twice as many points beside
        if not enough or moments[0, 0] < 1.5 * beside:
            continue
        for cell in seen[:n]:
            for p in range(start[cell], start[cell + 1] if marks[cell] > mark else 0):
                if owner[p] < 0 and abs(_off(points, p, planes[s])) <= tolerance:
                    owner[p] = number
        return s + 1, n
    return len(seeds), 0


@njit(cache=True)
def _assign(cells, around, bounds, planes, tolerance, owner, height, clear):
    """Write the owner of each point, its height above that plane and whether it is the only one.

    The planes are then fitted to those points. Returns their sums of squares (planes, 3) about the
    centre, along the normal first.
    """
    (points, start, _), n = cells, len(planes)
    for k in range(n):
        for cell in around[bounds[k] : bounds[k + 1]]:
            for p in range(start[cell], start[cell + 1]):
                off = _off(points, p, planes[k])
                if abs(off) <= abs(height[p]):
                    owner[p], height[p] = k, off
    for k in range(n):
        for cell in around[bounds[k] : bounds[k + 1]]:
            for p in range(start[cell], start[cell + 1]):
                own = owner[p]
                if own >= 0 and own != k:
                    cosine = 0.0
                    for i in range(3):
                        cosine += planes[k, 1, i] * planes[own, 1, i]
                    clear[p] &= abs(_off(points, p, planes[k]) - cosine * height[p]) > tolerance
    moments, values = np.zeros((n, 4, 4)), np.zeros((n, 3))
    for p in range(len(points)):
        if owner[p] >= 0 and clear[p]:
            _add(moments[owner[p]], points, p, planes[owner[p]])
    for k in range(n):
        if moments[k, 0, 0] >= 3:
            values[k] = _fit(moments[k], planes[k])
    return values
