"""Planes of a whole cloud, from local trials and growth over a grid of cells, in linear time.

A trial of three neighbouring points needs no normals. Profiles of mobile scanners are dense along
the line and sparse across it, so normals from nearest neighbours describe a scan line, not the
wall. Every trial and every step of growth uses only the cells around it. So a kilometre of street
is treated like a room, and no cloud is thinned. Poreba & Goulette 2013 name principal planes, such
as walls and roads, and leave their detection to a companion paper.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, eye_array
from scipy.spatial import cKDTree
from scipy.special import lambertw

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.planes import Plane, fit_plane, sigma_mad

__all__ = ["CELLS_PER_SIZE", "Grid", "PlanePart", "detect_planes", "own_order", "usual_size"]

CELLS_PER_SIZE, LEAST_AREA = 4, 0.25
"""Cells of the grid along the smallest plane, and its least area in squared sizes (1 m2 at 2 m).
Points of a plane are connected across one cell."""

FEWEST_LIMITS = 10, 30
"""Limits of the least number of points of a plane; its least area sets the number in between."""

USUAL_SIZES = 1.5, 2.0, 3.0
"""Default extents of the smallest plane, m: for points that fill the cells, for scan lines that are
too far apart for that, and the largest extent, for thin clouds."""

TRIM, TRIMMED = 2.5, 1.05
"""Points farther from their plane than TRIM standard deviations are not fitted. The factor TRIMMED
corrects the standard deviation of trimmed normal errors, and that of their mean."""

LEAST_TRIAL = 6
"""Least number of points of a trial."""


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
    order = own_order(points)
    grid = Grid(points[order], size / CELLS_PER_SIZE)
    in_cell = _points_per_cell(grid.start)
    if in_cell < 1:  # surfaces are not connected
        warnings.warn(
            f"Few cells of {grid.edge:g} m have a second point. "
            f"Planes of {size:g} m may be missing or cut into parts.",
            stacklevel=2,
        )
    minimum = int(np.clip(LEAST_AREA * CELLS_PER_SIZE**2 * in_cell, *FEWEST_LIMITS))
    search = _Search(grid, tolerance, minimum)
    for _ in range(4):
        if not search.round():
            break
    owner, clear = (values[np.argsort(order[grid.order])] for values in search.assigned())
    return _parts(points, owner, clear, tolerance, minimum)


def own_order(points: np.ndarray) -> np.ndarray:
    """Rows of points (n, 3) in an order that depends on the points alone."""
    x, y, z = (points - points.min(axis=0, initial=np.inf)).T
    return np.argsort(x + np.sqrt(2) * y + np.sqrt(3) * z, kind="stable")


def usual_size(points: np.ndarray) -> float:
    """Extent of the smallest plane that points (n, 3) support, m."""
    if not len(points):
        return USUAL_SIZES[1]
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


def _parts(points, owner, clear, tolerance, minimum):
    """Fitted parts of each owner's points; groups without a clear plane are left out."""
    parts = []
    for index in _members(owner, owner.max() + 1):
        fitted = index[clear[index]]
        if len(index) < minimum or len(fitted) < 3:
            continue
        plane = fit_plane(points[fitted])
        width = np.std(plane.project(points[fitted])[:, 1])
        # points without any plane have a ratio of 0.58
        if plane.std > 0.48 * tolerance or width < 1.2 * tolerance:
            continue
        # points of window reveals lie on one side of a wall, within the tolerance
        for _ in range(2):
            most = TRIM * max(sigma_mad(plane.residuals), 0.02 * tolerance)
            core = fitted[np.abs(plane.distances(points[fitted])) <= most]
            plane = fit_plane(points[core])
        moments = (plane.project(points[core]) ** 2).sum(axis=0)
        sigma = TRIMMED * np.sqrt((plane.residuals**2).sum() / max(len(core) - 3, 1))
        parts.append(PlanePart(plane, index, fitted, moments, float(sigma)))
    return sorted(parts, key=len, reverse=True)


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their mean and in the order of the cells; ``order`` has their rows in
    the cloud, ``cell`` their cells. ``start`` bounds the cells and ``size`` counts their points.
    ``near`` (cells, cells) is true where two cells are the same or touch. ``places`` has the
    indices of the cells.
    """

    def __init__(self, points, edge):
        self.edge, low = edge, points.min(axis=0)
        self.order, self.start, self.places = sort_into_cells(points - low, edge)
        self.points = (points - points.mean(axis=0))[self.order]
        self.size = np.diff(self.start)
        n = len(self.size)
        self.cell = np.repeat(np.arange(n), self.size)
        pairs = cKDTree(self.places).query_pairs(1, p=np.inf, output_type="ndarray").T
        half = csr_array((np.ones(pairs.shape[1], dtype=bool), pairs.astype(np.int32)), (n, n))
        self.near = csr_array(half + half.T + eye_array(n, dtype=bool))

    def rows(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the points in some cells, and the index at which each cell begins."""
        first = np.cumsum(self.size[cells]) - self.size[cells]
        total = self.size[cells].sum()
        return np.repeat(self.start[cells] - first, self.size[cells]) + np.arange(total), first

    def around(self, cells: np.ndarray) -> np.ndarray:
        """The given cells and all cells that touch one of them."""
        bounds, places = self.near.indptr, self.near.indices
        first, number = bounds[cells], bounds[cells + 1] - bounds[cells]
        rest = np.repeat(first - np.cumsum(number) + number, number)
        return np.unique(places[rest + np.arange(len(rest))])


class _Search:
    """Planes found so far and the points that they own."""

    def __init__(self, grid, tolerance, least_points):
        self.grid, self.tolerance, self.least = grid, tolerance, least_points
        self.owner = np.full(len(grid.points), -1)
        self.seen, self.spreads = np.zeros(len(grid.size), dtype=int), 0
        self.planes, self.taken = [], []
        self.trials = np.random.default_rng(0).random((32, 3))

    def round(self):
        """Try planes among the free points and grow them; return whether any was found."""
        grid, before = self.grid, len(self.planes)
        free = np.flatnonzero(self.owner < 0)
        counts = np.bincount(grid.cell[free], minlength=len(grid.size))
        # the fullest cell of every block of eight
        fullest = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
        seeds = fullest[np.unique(grid.places[fullest] // 2, axis=0, return_index=True)[1]]
        first = np.searchsorted(grid.cell[free], np.arange(len(counts)))
        rank = np.arange(len(free)) - first[grid.cell[free]]
        # about three points per cell, so that dense and sparse parts count alike
        stride = -(-counts // 3)[grid.cell[free]]
        drawn = grid.points[free[rank % stride == 0]]
        tree, low = cKDTree(drawn), grid.points[grid.start[seeds]]
        pieces = []
        for part in np.array_split(low, len(low) // 100 + 1):
            near = tree.query(part, 64, p=np.inf, distance_upper_bound=2.5 * grid.edge)[1]
            pieces.append(_pieces(drawn, near, self.trials, self.tolerance, grid.edge))
        scores, centres, normals = (np.concatenate(part) for part in zip(*pieces, strict=True))
        for k in np.argsort(-scores, kind="stable"):
            if scores[k] <= LEAST_TRIAL / 2:
                break
            self.grow(seeds[k], centres[k], normals[k])
        return len(self.planes) > before

    def grow(self, seed, centre, normal):
        """Keep the plane of the points connected with the cell of a seed, if it is large enough."""
        cells, grown = np.array([seed]), 0
        for _ in range(4):
            cells, rows, beside = self._spread(cells, centre, normal)
            if len(cells) < LEAST_AREA * CELLS_PER_SIZE**2 or len(rows) < self.least:
                return
            if len(cells) <= grown:
                break
            grown, (centre, normal) = len(cells), _fitted(self.grid.points[rows])
        if len(rows) < 1.5 * beside:  # a filled volume has twice as many points beside
            return
        self.owner[rows] = len(self.planes)
        self.planes.append((centre, normal))
        self.taken.append(cells)

    def _spread(self, front, centre, normal):
        """Connected cells that a plane takes, its free points in them, number of points beside."""
        cells, rows, beside = [], [], 0
        self.spreads += 1
        while len(front):
            self.seen[front] = self.spreads
            within, first = self.grid.rows(front)
            off = np.abs((self.grid.points[within] - centre) @ normal)
            free = self.owner[within] < 0
            on = free & (off <= self.tolerance)
            # tails of a noisy wall and strips of a floor have a smaller share
            least = np.maximum(1, 0.25 * self.grid.size[front])
            takes = np.add.reduceat(on, first, dtype=int) >= least
            cells.append(front[takes])
            rows.append(within[on & np.repeat(takes, self.grid.size[front])])
            beside += (free & (off <= 3 * self.tolerance)).sum() - len(rows[-1])
            front = self.grid.around(cells[-1])
            front = front[self.seen[front] < self.spreads]
        return np.concatenate(cells), np.concatenate(rows), beside

    def assigned(self):
        """Owner (the nearest plane) of each point, and whether it is the only plane.

        The owner is -1 if no plane is within the tolerance. A plane is the only plane of a point if
        the foot of the point on it is clear of all others. With this rule noise removes as many
        points on one side of the plane as on the other.
        """
        grid, points, planes = self.grid, self.grid.points, list(self.planes)
        around = [grid.rows(grid.around(cells))[0] for cells in self.taken]
        for _ in range(2):
            least = np.full(len(points), self.tolerance)
            owner, height = np.full(len(points), -1), np.zeros(len(points))
            for k, (centre, normal) in enumerate(planes):
                rows = around[k]
                off = (points[rows] - centre) @ normal
                nearer = np.abs(off) <= least[rows]
                rows, off = rows[nearer], off[nearer]
                owner[rows], height[rows], least[rows] = k, off, np.abs(off)
            clear, normals = owner >= 0, np.array([normal for _, normal in planes]).reshape(-1, 3)
            for k, (centre, normal) in enumerate(planes):
                rows = around[k][(owner[around[k]] >= 0) & (owner[around[k]] != k)]
                foot = (points[rows] - centre) @ normal
                foot -= (normals @ normal)[owner[rows]] * height[rows]
                clear[rows] &= np.abs(foot) > self.tolerance
            for k, rows in enumerate(_members(np.where(clear, owner, -1), len(planes))):
                if len(rows) >= 3:
                    planes[k] = _fitted(points[rows])
        return owner, clear


def _members(owner, number):
    """Rows of the points of each owner."""
    order = np.argsort(owner, kind="stable")
    return np.split(order, np.searchsorted(owner[order], np.arange(number + 1)))[1:-1]


def _fitted(points):
    """Centre and unit normal of the least-squares plane."""
    centre = points.mean(axis=0)
    local = points - centre
    return centre, np.linalg.eigh(local.T @ local)[1][:, 0]


def _pieces(drawn, near, trials, tolerance, edge):
    """Planes fitted to what the best planes of three points take: score, centre, normal.

    ``near`` (seeds, points) are rows of ``drawn``, or one behind its last where there is none.
    """
    there = near < len(drawn)
    local = np.concatenate([drawn, np.zeros((1, 3))])[near]  # (seeds, points, 3)
    picks = (trials * there.sum(axis=1)[:, None, None]).astype(int)  # (seeds, trials, 3)
    normals, offsets, wide = _through_three(local, picks, edge)
    off = np.abs(np.einsum("std,snd->stn", normals, local) - offsets[..., None])
    near_plane = (off <= tolerance) & there[:, None]  # (seeds, trials, points)
    votes = near_plane.sum(axis=2) * wide
    chosen = near_plane[np.arange(len(votes)), votes.argmax(axis=1)]
    score, centre, normal = _fitted_to(local, chosen, tolerance)
    return np.where(votes.max(axis=1) >= LEAST_TRIAL, score, 0.0), centre, normal


def _through_three(local, picks, edge):
    """Planes through three points: normals, distances from the origin, whether wide enough."""
    a, b, c = (np.take_along_axis(local, picks[..., i, None], axis=1) for i in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=2)
    normals = across / np.maximum(area, 1e-12)[..., None]
    return normals, (normals * a).sum(axis=2), area > 0.5 * edge**2


def _fitted_to(local, chosen, tolerance):
    """Least-squares planes of the chosen points (seeds, points): score, centre, normal."""
    number = np.maximum(chosen.sum(axis=1), 1)
    centre = (local * chosen[..., None]).sum(axis=1) / number[:, None]
    shifted = (local - centre[:, None]) * chosen[..., None]
    values, vectors = np.linalg.eigh(shifted.swapaxes(1, 2) @ shifted)
    # points without any plane have a mean square residual of a third of the squared tolerance
    return number * (1 - values[:, 0] / number / (tolerance**2 / 3)), centre, vectors[:, :, 0]
