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

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import lambertw

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab._compiled import in_threads
from mmqa_lab.cloud import sort_into_cells
from mmqa_lab.planes import Plane, fit_plane

CELLS_PER_SIZE = 4
"""Cells of the grid along the smallest plane: points hang together across one of them."""

LEAST_AREA = 0.25
"""Area of the smallest plane in squared sizes: 1 m2 at a size of 2 m."""

FEWEST = 10, 30
"""The points of a plane at least, by default: what its least area holds, between these."""

USUAL_SIZES = 1.5, 2.0, 3.0
"""Default extents of the smallest plane, m: where points fill its cells, where lines of points are
too far apart to, and the largest, in thin clouds."""

FILLED = 0.8
"""Occupied cells per occupied cell of twice their side, in those of points at random: 1 on surfaces
without gaps, 1/2 where lines are apart."""

USUAL_COUNT = 3.2
"""Points of a surface per cell, for which the default extent is enlarged in thin clouds; of 2.4 to
4.4 those from 2.8 to 3.8 found most edges of simulated streets at 10 and 20 points/m2."""

ROUGHEST = 0.48
"""Largest residual standard deviation in tolerances; points without any plane have 0.58."""

NARROWEST = 1.2
"""Least standard deviation of a plane's points along its shorter axis, in tolerances."""

ROUNDS = 4
"""Trials are repeated this often among the points that are left."""

THINNEST = 1.0
"""Fewest points per cell of a surface that still hangs together."""

PER_CELL = 3
"""Points of a cell that take part in a trial: dense and sparse parts then count alike."""

REACH = 2
"""Cells on either side that a trial looks at."""

AROUND = (2 * REACH + 1) ** 3
TRIALS = 32
SHARE = 0.25
"""A plane takes a cell in which it has this share of all points: tails of a noisy wall and strips
of a floor have less."""

STANDS_OUT = 1.5
"""Least number of points on a plane for one beside it, within three tolerances and in all cells
that were looked at; a volume filled with points has 1/2."""

BESIDE = 10
"""Place of that count behind the ten moments."""

PASSES = 4
MOST_AROUND = 64
"""Planes that a cell may have around it."""

LEAST_TRIAL = 6
LEAST_SPREAD = 0.5
"""Of a trial triangle: twice its area in squared cells."""

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
    owner, clear = search.assigned()
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

    ``points`` are relative to their mean and in the order of the cells; ``order`` are their rows;
    ``keys`` number the cells so that neighbours in z follow each other; ``start`` bounds them.
    """

    def __init__(self, points, edge):
        self.edge = edge
        middle, low = points.mean(axis=0), points.min(axis=0)
        points = points - low
        self.order, self.start, places = sort_into_cells(points, edge)
        points += low - middle
        self.shape = places.max(axis=0) + 8
        self.keys = np.ravel_multi_index((places + 3).T, self.shape)
        self.points = points[self.order]

    @property
    def layout(self):
        """Points, keys, bounds, and what a step in x and in y adds to a key."""
        steps = np.array([self.shape[1] * self.shape[2], self.shape[2]])
        return self.points, self.keys, self.start, steps

    def fullest(self, counts):
        """Of every eight cells the one with the highest count, where it is above zero."""
        index = np.stack(np.unravel_index(self.keys, self.shape))
        blocks = np.ravel_multi_index(index // 2, self.shape)
        order = np.lexsort((-counts, blocks))
        first = np.r_[True, np.diff(blocks[order]) != 0]
        cells = order[first]
        return cells[counts[cells] > 0]


class _Search:
    """Planes found so far and the points that they own."""

    def __init__(self, grid, tolerance, least_points):
        self.grid, self.tolerance = grid, tolerance
        self.least = float(least_points), LEAST_AREA * CELLS_PER_SIZE**2
        self.owner = np.full(len(grid.points), -1, dtype=np.int32)
        self.centres, self.normals = np.empty((0, 3)), np.empty((0, 3))
        self.taken = np.empty((2, 0), dtype=np.int64)  # cells and the planes that take them
        self.trials = np.random.default_rng(0).random((TRIALS, 3))

    def round(self):
        """Try planes among the points that nobody owns and grow them; whether any was found."""
        grid, tolerance = self.grid, self.tolerance
        free = np.add.reduceat((self.owner < 0).astype(np.int64), grid.start[:-1])
        seeds = grid.fullest(free)
        thin = LEAST_SPREAD * grid.edge**2
        pieces, scores = np.zeros((len(seeds), 2, 3)), np.zeros(len(seeds))
        trials = self.trials, tolerance, thin
        in_threads(_try_planes, len(seeds), grid.layout, self.owner, seeds, *trials, pieces, scores)
        best = np.argsort(-scores, kind="stable")
        best = best[scores[best] > LEAST_TRIAL / 2]
        starts, limits = (seeds[best], pieces[best]), (tolerance, self.least)
        found, taken = _grow_all(grid.layout, self.owner, *starts, *limits, len(self.centres))
        self.centres = np.concatenate([self.centres, found[:, 0]])
        self.normals = np.concatenate([self.normals, found[:, 1]])
        self.taken = np.concatenate([self.taken, taken], axis=1)
        return len(found) > 0

    def assigned(self):
        """Owner of each point (-1: none) and whether it lies on that plane alone; input order."""
        grid = self.grid
        cells, planes = self.taken[:, np.argsort(self.taken[0], kind="stable")]
        near = np.searchsorted(cells, np.arange(len(grid.keys) + 1)), planes
        for _ in range(2):
            surfaces = self.centres, self.normals
            owner = np.full(len(grid.points), -1, dtype=np.int32)
            clear = np.zeros(len(grid.points), dtype=bool)
            given = grid.layout, near, surfaces, self.tolerance, owner, clear
            in_threads(_assign, len(grid.keys), *given, least=1000)
            _refit(grid.points, owner, clear, *surfaces)
        rows = np.empty(len(owner), dtype=np.int32), np.empty(len(owner), dtype=bool)
        rows[0][grid.order], rows[1][grid.order] = owner, clear
        return rows


@numba.njit(cache=True)
def _around(keys, steps, cell, reach, out):
    """Occupied cells within ``reach`` of a cell along each axis; how many."""
    n = 0
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            key = keys[cell] + i * steps[0] + j * steps[1]
            k = np.searchsorted(keys, key - reach)
            while k < len(keys) and keys[k] <= key + reach:
                out[n] = k
                n += 1
                k += 1
    return n


@numba.njit(cache=True)
def _distance(points, p, centre, normal):
    """Signed distance of a point from a plane."""
    x, y, z = points[p, 0] - centre[0], points[p, 1] - centre[1], points[p, 2] - centre[2]
    return x * normal[0] + y * normal[1] + z * normal[2]


@numba.njit(cache=True)
def _add(moments, points, p, origin):
    """Add a point to count, sums and products (10 numbers) about an origin."""
    moments[0] += 1
    k = 4
    for i in range(3):
        along = points[p, i] - origin[i]
        moments[1 + i] += along
        for j in range(i, 3):
            moments[k] += along * (points[p, j] - origin[j])
            k += 1


@numba.njit(cache=True)
def _fit(moments, origin, centre, normal):
    """Write centre and unit normal of the least-squares plane; return its mean square residual."""
    scatter, k = np.empty((3, 3)), 4
    for i in range(3):
        for j in range(i, 3):
            means = moments[1 + i] / moments[0] * (moments[1 + j] / moments[0])
            scatter[i, j] = scatter[j, i] = moments[k] / moments[0] - means
            k += 1
    values, vectors = np.linalg.eigh(scatter)
    for i in range(3):
        centre[i], normal[i] = origin[i] + moments[1 + i] / moments[0], vectors[i, 0]
    return max(values[0], 0.0)


@numba.njit(cache=True)
def _free_around(grid, owner, cell, room, out):
    """Free points around a cell, at most PER_CELL of each cell, evenly drawn; how many."""
    _, keys, start, steps = grid
    n = 0
    for c in room[: _around(keys, steps, cell, np.int64(REACH), room)]:
        free = 0
        for p in range(start[c], start[c + 1]):
            free += owner[p] < 0
        stride = (free + PER_CELL - 1) // PER_CELL
        seen = 0
        for p in range(start[c], start[c + 1]):
            if owner[p] < 0:
                if seen % stride == 0:
                    out[n] = p
                    n += 1
                seen += 1
    return n


@numba.njit(cache=True)
def _step(points, a, b):
    """From one point to another."""
    return points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]


@numba.njit(cache=True)
def _best_trial(points, near, trials, tolerance, least, centre, normal):
    """Write centre and normal of the trial that most neighbours lie on; return their number."""
    best, trial = 0, np.empty(3)
    for t in range(len(trials)):
        n = len(near)
        a, b = near[int(trials[t, 0] * n)], near[int(trials[t, 1] * n)]
        c = near[int(trials[t, 2] * n)]
        ux, uy, uz = _step(points, a, b)
        vx, vy, vz = _step(points, a, c)
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(x * x + y * y + z * z)
        if length <= least:
            continue
        trial[0], trial[1], trial[2] = x / length, y / length, z / length
        votes = 0
        for p in near:
            votes += abs(_distance(points, p, points[a], trial)) <= tolerance
        if votes > best:
            best = votes
            for i in range(3):
                centre[i], normal[i] = points[a, i], trial[i]
    return best


@numba.njit(cache=True)
def _refine(points, near, centre, normal, tolerance):
    """Fit the plane to the neighbours on it; return their number less what chance would give."""
    moments, origin, score = np.empty(10), centre.copy(), 0.0
    for _ in range(3):
        moments[:] = 0.0
        for p in near:
            if abs(_distance(points, p, centre, normal)) <= tolerance:
                _add(moments, points, p, origin)
        if moments[0] < LEAST_TRIAL:
            return 0.0
        square = _fit(moments, origin, centre, normal)
        score = moments[0] * (1 - square / (ROUGH * tolerance**2))
    return score


@numba.njit(cache=True, nogil=True)
def _try_planes(begin, end, grid, owner, seeds, trials, tolerance, thin, pieces, scores):
    """A plane piece around each seed cell: (centre, normal) as (n, 2, 3), and scores."""
    room = np.empty(AROUND, dtype=np.int64)
    near = np.empty(PER_CELL * AROUND, dtype=np.int64)
    for s in range(begin, end):
        n = _free_around(grid, owner, seeds[s], room, near)
        centre, normal = pieces[s, 0], pieces[s, 1]
        if n < LEAST_TRIAL:
            continue
        if _best_trial(grid[0], near[:n], trials, tolerance, thin, centre, normal):
            scores[s] = _refine(grid[0], near[:n], centre, normal, tolerance)


@numba.njit(cache=True)
def _takes(grid, owner, cell, centre, normal, tolerance, moments, origin):
    """Whether a plane takes a cell; its free points there are then added to the moments."""
    points, first, last = grid[0], grid[2][cell], grid[2][cell + 1]
    on, near = 0, 0
    for p in range(first, last):
        d = abs(_distance(points, p, centre, normal))
        near += owner[p] < 0 and d <= 3 * tolerance
        on += owner[p] < 0 and d <= tolerance
    if on == 0 or on < SHARE * (last - first):
        moments[BESIDE] += near
        return False
    moments[BESIDE] += near - on
    for p in range(first, last):
        if owner[p] < 0 and abs(_distance(points, p, centre, normal)) <= tolerance:
            _add(moments, points, p, origin)
    return True


@numba.njit(cache=True)
def _grow(grid, owner, seed, plane, tolerance, refit, mark, desk):
    """Cells that hang together with the seed's on a plane: their number; they are in the queue.

    The plane, (2, 3), is fitted to their points; with ``refit`` anew whenever they have doubled.
    ``desk`` are arrays to work on: marks, queue, room, moments.
    """
    (marks, queue, room, moments), origin = desk, plane[0].copy()
    centre, normal = plane[0], plane[1]
    moments[:] = 0.0
    marks[seed] = mark
    if not _takes(grid, owner, seed, centre, normal, tolerance, moments, origin):
        return 0
    queue[0], done, n, fitted = seed, 0, 1, 4.0 * LEAST_TRIAL
    while True:
        full = done == n
        enough = 3.0 if full else 2 * fitted
        if (full or (refit and done > 0)) and moments[0] >= enough:
            fitted = moments[0]
            _fit(moments, origin, centre, normal)
        if full:
            return n
        around = _around(grid[1], grid[3], queue[done], np.int64(1), room)
        done += 1
        for k in range(around):
            other = room[k]
            if marks[other] == mark:
                continue
            marks[other] = mark
            if _takes(grid, owner, other, centre, normal, tolerance, moments, origin):
                queue[n] = other
                n += 1


@numba.njit(cache=True)
def _own(grid, owner, cells, centre, normal, tolerance, number):
    """Give the free points of the cells near the plane to it."""
    for cell in cells:
        for p in range(grid[2][cell], grid[2][cell + 1]):
            if owner[p] < 0 and abs(_distance(grid[0], p, centre, normal)) <= tolerance:
                owner[p] = number


@numba.njit(cache=True)
def _grow_all(grid, owner, seeds, pieces, tolerance, least, first):
    """Grow one piece after the other: planes (n, 2, 3), and (cell, plane) of cells they take."""
    cells = len(grid[1])
    marks, queue = np.full(cells, -1, dtype=np.int64), np.empty(cells, dtype=np.int64)
    moments = np.zeros(BESIDE + 1)
    desk = marks, queue, np.empty(27, dtype=np.int64), moments
    found, mark = 0, np.int64(0)  # a bare 0 would be compiled as a kind of its own
    planes, taken, grown = np.empty((len(seeds), 2, 3)), [], np.empty((2, 3))
    for s in range(len(seeds)):
        plane, size, n = pieces[s], 0, 0
        for turn in range(PASSES):
            _copy(plane, grown)
            n = _grow(grid, owner, seeds[s], grown, tolerance, turn == 0, mark, desk)
            mark += 1
            if n < least[1] or moments[0] < least[0]:
                size = 0
                break
            if turn and n <= size:
                break
            size = n
            _copy(grown, plane)
        if size == 0 or moments[0] < STANDS_OUT * moments[BESIDE]:
            continue
        _own(grid, owner, queue[:n], plane[0], plane[1], tolerance, first + found)
        for k in range(n):
            taken.append((queue[k], first + found))
        _copy(plane, planes[found])
        found += 1
    return planes[:found], _rows(taken, 2).T


@numba.njit(cache=True)
def _copy(values, into):
    """Write an array into another one; slices take three seconds longer to compile."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            into[i, j] = values[i, j]


@numba.njit(cache=True)
def _rows(found, width):
    """Tuples of whole numbers as rows of an array."""
    rows = np.empty((len(found), width), dtype=np.int64)
    for k in range(len(found)):
        for j in range(width):
            rows[k, j] = found[k][j]
    return rows


@numba.njit(cache=True)
def _planes_around(keys, steps, bounds, planes, cell, room, out):
    """Different planes that take a cell or one beside it; how many."""
    n = 0
    for c in room[: _around(keys, steps, cell, np.int64(1), room)]:
        for k in range(bounds[c], bounds[c + 1]):
            if n < len(out) and planes[k] not in out[:n]:
                out[n] = planes[k]
                n += 1
    return n


@numba.njit(cache=True, nogil=True)
def _assign(begin, end, grid, near, surfaces, tolerance, owner, clear):
    """The nearest plane around each point within the tolerance (-1: none), and whether the only.

    It is where its foot on that plane is clear of the others: noise then takes as many points off
    one side of the plane as off the other.
    """
    (points, keys, start, steps), (centres, normals) = grid, surfaces
    room, around = np.empty(27, dtype=np.int64), np.empty(MOST_AROUND, dtype=np.int64)
    for cell in range(begin, end):
        n = _planes_around(keys, steps, near[0], near[1], cell, room, around)
        for p in range(start[cell], start[cell + 1]):
            least, own = tolerance, -1
            for plane in around[:n]:
                d = abs(_distance(points, p, centres[plane], normals[plane]))
                if d <= least:
                    least, own = d, plane
            owner[p], clear[p] = own, own >= 0
            for plane in around[:n]:
                if own < 0 or plane == own:
                    continue
                height = _distance(points, p, centres[own], normals[own])
                cosine = (normals[own] * normals[plane]).sum()
                d = _distance(points, p, centres[plane], normals[plane]) - cosine * height
                clear[p] &= abs(d) > tolerance


@numba.njit(cache=True)
def _refit(points, owner, clear, centres, normals):
    """Fit all planes to the points that lie on them alone."""
    moments, origins = np.zeros((len(centres), 10)), centres.copy()
    for p in range(len(points)):
        if owner[p] >= 0 and clear[p]:
            _add(moments[owner[p]], points, p, origins[owner[p]])
    for k in range(len(centres)):
        if moments[k, 0] >= 3:
            _fit(moments[k], origins[k], centres[k], normals[k])


def neighbours(grid, owner, n):
    """Rows (cell, a, b): owner a of points in a cell, b of others there or in a cell beside it."""
    cell = np.repeat(np.arange(len(grid.keys)), np.diff(grid.start))
    cells, owners = np.divmod(np.unique(cell * n + owner), n)
    bounds = np.searchsorted(cells, np.arange(len(grid.keys) + 1))
    return _neighbours(grid.layout, bounds, owners)


@numba.njit(cache=True)
def _neighbours(grid, bounds, owners):
    """The rows of :func:`neighbours`."""
    room, near = np.empty(27, dtype=np.int64), np.empty(MOST_AROUND, dtype=np.int64)
    found = []
    for cell in range(len(grid[1])):
        k = _planes_around(grid[1], grid[3], bounds, owners, cell, room, near)
        for a in owners[bounds[cell] : bounds[cell + 1]]:
            for b in near[:k]:
                if a != b:
                    found.append((cell, a, b))
    return _rows(found, 3)


def beside_lines(lines, tolerance, reach):
    """Points within ``reach`` of a line of their plane with another, and clear of that other.

    Returns the side of each (twice the line's number, plus one for the second plane), its
    station along the line and its distance from it, m.
    """
    n, (cells, a, b) = len(lines.normals), lines.meetings.T
    keys = lines.pairs @ [n, 1]
    wanted = np.minimum(a, b) * n + np.maximum(a, b)
    line = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    meets = keys[line] == wanted if len(keys) else np.zeros(len(a), dtype=bool)
    meetings = np.stack([cells, a, b, line], axis=1)[meets]
    room = int(np.diff(lines.grid.start)[meetings[:, 0]].sum())
    frames = lines.foot, lines.direction, lines.centres, lines.normals
    return _beside(lines.grid.layout, lines.owner, meetings, frames, tolerance, reach, room)


@numba.njit(cache=True)
def _beside(grid, owner, meetings, frames, tolerance, reach, room):
    """The sides, stations and distances of :func:`beside_lines`, at most ``room``."""
    points, start = grid[0], grid[2]
    foot, direction, centres, normals = frames
    sides, places, n = np.empty(room, dtype=np.int64), np.empty((2, room)), 0
    for cell, a, b, line in meetings:
        for p in range(start[cell], start[cell + 1]):
            if owner[p] != a or abs(_distance(points, p, centres[b], normals[b])) <= tolerance:
                continue
            station = _distance(points, p, foot[line], direction[line])
            square = ((points[p] - foot[line]) ** 2).sum() - station**2
            if square <= reach**2:
                sides[n], places[0, n], places[1, n] = 2 * line + (a > b), station, square
                n += 1
    return sides[:n], places[0, :n], np.sqrt(np.maximum(places[1, :n], 0))
