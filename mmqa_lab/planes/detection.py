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
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree
from scipy.special import lambertw

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.planes import Plane, fit_plane

CELLS_PER_SIZE, LEAST_AREA = 4, 0.25
"""Cells of the grid along the smallest plane: points hang together across one of them; and its area
in squared sizes, 1 m2 at a size of 2 m."""

FEWEST = 10, 30
"""The points of a plane at least, by default: what its least area holds, between these."""

USUAL_SIZES = 1.5, 2.0, 3.0
"""Default extents of the smallest plane, m: where points fill its cells, where lines of points are
too far apart to, and the largest, in thin clouds."""

FILLED, USUAL_COUNT, THINNEST = 0.8, 3.2, 1.0
"""Occupied cells per occupied cell of twice their side, in those of points at random; points of a
surface per cell, for which the default extent is enlarged in thin clouds (of 2.4 to 4.4 those from
2.8 to 3.8 found most edges of simulated streets); and fewest for a surface to hang together."""

ROUGHEST, NARROWEST = 0.48, 1.2
"""Largest residual standard deviation in tolerances (points without any plane have 0.58); least
standard deviation of a plane's points along its shorter axis, in tolerances."""

ROUNDS, PASSES = 4, 4
"""Trials are repeated this often among the points that are left; growth of a plane is."""

PER_CELL, REACH, MOST_NEAR = 3, 2.5, 64
"""Of the points of a trial: so many of a cell (dense and sparse parts then count alike), within so
many cells along each axis, so many at most."""

TRIALS, LEAST_TRIAL, LEAST_SPREAD, CHUNK = 32, 6, 0.5, 1000
"""Trials around a seed, its points at least, twice the area of a trial's triangle in squared cells,
and seeds at a time."""

SHARE, STANDS_OUT = 0.25, 1.5
"""A plane takes a cell in which it has this share of all points: tails of a noisy wall and strips
of a floor have less. It has so many points at least for one beside it, within three tolerances and
in all cells that were looked at; a volume filled with points has 1/2."""

ROUGH = 1 / 3
"""Mean square residual, in squared tolerances, of points without any plane."""


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
    """

    plane: Plane
    index: np.ndarray
    moments: np.ndarray
    sigma: float

    def __len__(self):
        return len(self.index)

    def offset_variance(self, point: np.ndarray) -> float:
        """Variance of the plane's height at a point, square metres: independent residuals."""
        square = self.plane.project(point[None])[0] ** 2
        return self.sigma**2 * (1 / self.plane.n + (square / self.moments).sum())


def detect_planes(
    points: ArrayLike, *, tolerance: float = 0.05, size: float = 2.0, minimum: int | None = None
) -> list[Patch]:
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
        Least number of points of a plane, beside its least area of a quarter of ``size`` squared.
        Default: what that area holds, 10 to 30.

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
    minimum = None if minimum is None else check_count(minimum, "minimum", low=3)
    if len(points) < (minimum or FEWEST[0]):
        return []
    grid = Grid(points, size / CELLS_PER_SIZE)
    _warn_if_thin(grid, size)
    expected = LEAST_AREA * CELLS_PER_SIZE**2 * _points_per_cell(grid.start)
    minimum = minimum or int(np.clip(expected, *FEWEST))
    search = _Search(grid, tolerance, minimum)
    for _ in range(ROUNDS):
        if not search.round():
            break
    owner, clear = np.full(len(points), -1), np.zeros(len(points), dtype=bool)
    owner[grid.order], clear[grid.order] = search.assigned()
    return _patches(points, owner, clear, tolerance, minimum)


def usual_size(points):
    """The extent of the smallest plane that points carry, m."""
    if not len(points):
        return USUAL_SIZES[1]
    fine = sort_into_cells(points, USUAL_SIZES[0] / CELLS_PER_SIZE)
    doubled = sort_into_cells(fine.places, 2)
    in_cell = _points_per_cell(fine.starts)
    at_random = 4 * np.expm1(-in_cell) / np.expm1(-4 * in_cell)
    filled = len(fine.places) >= FILLED * at_random * len(doubled.places)
    carried = USUAL_SIZES[0] * np.sqrt(USUAL_COUNT / in_cell)
    return float(np.clip(carried, USUAL_SIZES[0 if filled else 1], USUAL_SIZES[2]))


def _points_per_cell(start):
    """Points that a cell of a surface has on average, empty cells of the surface included.

    A surface with x points per cell shows x / (1 - exp(-x)) in those that ``start`` bounds.
    """
    seen = np.median(np.diff(start)[:: max(1, len(start) // 100_000)])
    mean = max(float(np.diff(start).mean()), 1.0 + 1e-9) if seen < 3 else seen
    return mean + lambertw(-mean * np.exp(-mean)).real


def _warn_if_thin(grid, size):
    """Say when surfaces have too few points for their cells to hang together."""
    in_cell = _points_per_cell(grid.start)
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


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their mean and in the order of the cells; ``order`` are their rows,
    ``cell`` their cells; ``start`` bounds the cells, ``size`` counts their points; ``near`` (cells,
    cells) tells which are the same or touch, and ``places`` where they are.
    """

    def __init__(self, points, edge):
        self.edge, low = edge, points.min(axis=0)
        self.order, self.start, self.places = sort_into_cells(points - low, edge)
        self.points = (points - points.mean(axis=0))[self.order]
        self.size = np.diff(self.start)
        n = len(self.size)
        self.cell = np.repeat(np.arange(n), self.size)
        shape = self.places.max(axis=0) + 3
        keys = np.ravel_multi_index((self.places + 1).T, shape)
        pairs = []
        for step in product((-1, 0, 1), repeat=3):
            wanted = keys + np.dot(step, [shape[1] * shape[2], shape[2], 1])
            at = np.minimum(np.searchsorted(keys, wanted), n - 1)
            here = np.flatnonzero(keys[at] == wanted)
            pairs.append(np.stack([here, at[here]]))
        pairs = np.concatenate(pairs, axis=1).astype(np.int32)
        self.near = csr_array(coo_array((np.ones(pairs.shape[1], bool), pairs), shape=(n, n)))

    def rows(self, cells):
        """Rows of the points in some cells, and where each cell's begin."""
        first = np.cumsum(self.size[cells]) - self.size[cells]
        total = self.size[cells].sum()
        return np.repeat(self.start[cells] - first, self.size[cells]) + np.arange(total), first

    def around(self, cells):
        """The same cells and all that touch one of them."""
        ends = self.near.indptr[cells], self.near.indptr[cells + 1]
        sizes = ends[1] - ends[0]
        first = np.cumsum(sizes) - sizes
        return np.unique(
            self.near.indices[np.repeat(ends[0] - first, sizes) + np.arange(sizes.sum())]
        )

    def fullest(self, counts):
        """Of every eight cells the one with the highest count, where it is above zero."""
        blocks = self.places // 2
        order = np.lexsort((-counts, *blocks.T))
        cells = order[np.r_[True, (np.diff(blocks[order], axis=0) != 0).any(axis=1)]]
        return cells[counts[cells] > 0]


class _Search:
    """Planes found so far and the points that they own."""

    def __init__(self, grid, tolerance, least_points):
        self.grid, self.tolerance, self.least = grid, tolerance, least_points
        self.owner = np.full(len(grid.points), -1)
        self.seen = np.zeros(len(grid.size), dtype=bool)
        self.planes, self.taken = [], []
        self.trials = np.random.default_rng(0).random((TRIALS, 3))

    def round(self):
        """Try planes among the points that nobody owns and grow them; whether any was found."""
        grid, before = self.grid, len(self.planes)
        free = np.flatnonzero(self.owner < 0)
        counts = np.bincount(grid.cell[free], minlength=len(grid.size))
        seeds = grid.fullest(counts)
        first = np.searchsorted(grid.cell[free], np.arange(len(counts)))
        rank = np.arange(len(free)) - first[grid.cell[free]]
        stride = -(-counts // PER_CELL)[grid.cell[free]]
        drawn = grid.points[free[rank % stride == 0]]
        pieces = [
            _pieces(drawn, tree_near, self.trials, self.tolerance, grid.edge)
            for tree_near in _neighbourhoods(drawn, grid, seeds)
        ]
        if not pieces:
            return False
        scores, centres, normals = (np.concatenate(part) for part in zip(*pieces, strict=True))
        for k in np.argsort(-scores, kind="stable"):
            if scores[k] <= LEAST_TRIAL / 2:
                break
            self.grow(seeds[k], centres[k], normals[k])
        return len(self.planes) > before

    def grow(self, seed, centre, normal):
        """Keep the plane of the points that hang together with a seed's cell, if it is large."""
        cells, grown = np.array([seed]), 0
        for turn in range(PASSES):
            cells, number, beside, plane = self._spread(cells, centre, normal, refit=turn == 0)
            if len(cells) < LEAST_AREA * CELLS_PER_SIZE**2 or number < self.least:
                return
            if len(cells) <= grown:
                break
            grown, (centre, normal) = len(cells), plane
        if number < STANDS_OUT * beside:
            return
        rows, _ = self.grid.rows(cells)
        rows = rows[self.owner[rows] < 0]
        off = np.abs((self.grid.points[rows] - centre) @ normal)
        self.owner[rows[off <= self.tolerance]] = len(self.planes)
        self.planes.append((centre, normal))
        self.taken.append(cells)

    def _spread(self, front, centre, normal, refit):
        """Cells that hang together on a plane, its points, those beside it, and the fitted plane.

        With ``refit`` the plane is fitted anew whenever its points have doubled; never to those of
        the first cell alone, which may lie on one scan line.
        """
        cells, points, beside, looked, fitted = [], [], 0, [], 4 * LEAST_TRIAL
        while len(front):
            self.seen[front] = True
            looked.append(front)
            taken, found, aside = self._takes(front, centre, normal)
            cells.append(taken)
            points.append(found)
            beside += aside
            if refit and len(cells) > 1 and sum(map(len, points)) >= 2 * fitted:
                fitted = sum(map(len, points))
                centre, normal = _fitted(np.concatenate(points))
            front = self.grid.around(taken)
            front = front[~self.seen[front]]
        self.seen[np.concatenate(looked)] = False
        points = np.concatenate(points)
        plane = _fitted(points) if len(points) >= 3 else (centre, normal)
        return np.concatenate(cells), len(points), beside, plane

    def _takes(self, cells, centre, normal):
        """Those of the cells that a plane takes, its free points there, how many are beside it."""
        rows, first = self.grid.rows(cells)
        points = self.grid.points[rows]
        off, free = np.abs((points - centre) @ normal), self.owner[rows] < 0
        on = free & (off <= self.tolerance)
        counts = np.add.reduceat(on, first, dtype=int)
        takes = (counts > 0) & (counts >= SHARE * self.grid.size[cells])
        beside = (free & (off <= 3 * self.tolerance)).sum() - counts[takes].sum()
        return cells[takes], points[on & np.repeat(takes, self.grid.size[cells])], beside

    def assigned(self):
        """Owner of each point (-1: none), the nearest plane around it within the tolerance, and
        whether it is the only one.

        It is where its foot on that plane is clear of the others: noise then takes as many points
        off one side of the plane as off the other.
        """
        grid, points, planes = self.grid, self.grid.points, list(self.planes)
        around = [grid.around(cells) for cells in self.taken]
        for _ in range(2):
            least = np.full(len(points), self.tolerance)
            owner, height = np.full(len(points), -1), np.zeros(len(points))
            for k, (centre, normal) in enumerate(planes):
                rows, _ = grid.rows(around[k])
                off = (points[rows] - centre) @ normal
                nearer = np.abs(off) <= least[rows]
                rows, off = rows[nearer], off[nearer]
                owner[rows], height[rows], least[rows] = k, off, np.abs(off)
            clear, normals = owner >= 0, np.array([normal for _, normal in planes]).reshape(-1, 3)
            for k, (centre, normal) in enumerate(planes):
                rows, _ = grid.rows(around[k])
                rows = rows[(owner[rows] >= 0) & (owner[rows] != k)]
                foot = (points[rows] - centre) @ normal
                foot -= (normals @ normal)[owner[rows]] * height[rows]
                clear[rows] &= np.abs(foot) > self.tolerance
            own = np.flatnonzero(clear)
            own = own[np.argsort(owner[own], kind="stable")]
            bounds = np.searchsorted(owner[own], np.arange(len(planes) + 1))
            for k, (first, last) in enumerate(pairwise(bounds)):
                if last - first >= 3:
                    planes[k] = _fitted(points[own[first:last]])
        return owner, clear


def _fitted(points):
    """Centre and unit normal of the least-squares plane."""
    centre = points.mean(axis=0)
    local = points - centre
    return centre, np.linalg.eigh(local.T @ local)[1][:, 0]


def _neighbourhoods(drawn, grid, seeds):
    """Rows of the drawn points around some seeds at a time; their number where there is none."""
    tree = cKDTree(drawn)
    low = grid.points[grid.start[seeds]]
    for first in range(0, len(seeds), CHUNK):
        yield tree.query(
            low[first : first + CHUNK], MOST_NEAR, p=np.inf, distance_upper_bound=REACH * grid.edge
        )[1]


def _pieces(drawn, near, trials, tolerance, edge):
    """Planes through three points on which most neighbours lie, refined: score, centre, normal."""
    there = near < len(drawn)
    local = np.concatenate([drawn, np.full((1, 3), np.nan)])[near]
    picks = (trials * there.sum(axis=1)[:, None, None]).astype(int)
    a, b, c = (np.take_along_axis(local, picks[..., i, None], axis=1) for i in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=2)
    normals = across / np.maximum(area, 1e-12)[..., None]
    off = np.abs(np.einsum("std,snd->stn", normals, local) - (normals * a).sum(axis=2)[..., None])
    votes = (off <= tolerance).sum(axis=2) * (area > LEAST_SPREAD * edge**2)
    best = votes.argmax(axis=1)[:, None, None]
    centre = np.take_along_axis(a, best, axis=1)[:, 0]
    normal = np.take_along_axis(normals, best, axis=1)[:, 0]
    good = (there.sum(axis=1) >= LEAST_TRIAL) & (votes.max(axis=1) > 0)
    local = np.where(there[..., None], local, 0.0)
    for _ in range(3):
        on = there & (np.abs(np.einsum("snd,sd->sn", local - centre[:, None], normal)) <= tolerance)
        number = np.maximum(on.sum(axis=1), 1)
        good &= number >= LEAST_TRIAL
        centre = (local * on[..., None]).sum(axis=1) / number[:, None]
        shifted = (local - centre[:, None]) * on[..., None]
        values, vectors = np.linalg.eigh(shifted.swapaxes(1, 2) @ shifted)
        normal = vectors[:, :, 0]
    score = number * (1 - values[:, 0] / number / (ROUGH * tolerance**2))
    return np.where(good, score, 0.0), centre, normal
