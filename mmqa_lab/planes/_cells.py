"""Compiled search for planes over a grid of cells that knows only the occupied ones."""

import numba
import numpy as np

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


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their mean and in the order of the cells; ``order`` are their rows;
    ``keys`` number the cells so that neighbours in z follow each other; ``start`` bounds them.
    """

    def __init__(self, points, edge):
        self.edge = edge
        origin = points.mean(axis=0)
        low = points.min(axis=0) - origin
        shape = np.floor((points.max(axis=0) - origin - low) / edge) + 8
        if shape.prod() > 2.0**62:
            raise ValueError(
                f"Invalid cloud of {shape.max() * edge:.3g} m in cells of {edge:g} m. "
                "Must be smaller, or have a larger size."
            )
        self.shape = shape.astype(np.int64)
        keys = np.zeros(len(points), dtype=np.int64)
        for axis in range(3):
            along = ((points[:, axis] - origin[axis] - low[axis]) / edge).astype(np.int64) + 3
            keys = keys * self.shape[axis] + along
        self.order = np.argsort(keys, kind="stable")
        keys = keys[self.order]
        first = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
        self.keys, self.start = keys[first], np.r_[first, len(keys)]
        self.points = points[self.order] - origin

    @property
    def steps(self):
        """What a step in x and in y adds to a key."""
        return np.array([self.shape[1] * self.shape[2], self.shape[2]])

    def points_per_cell(self):
        """Points that a cell of a surface has on average, empty cells of the surface included.

        A surface with x points per cell shows x / (1 - exp(-x)) per occupied cell.
        """
        seen = np.median(np.diff(self.start[:: max(1, len(self.start) // 100_000)]))
        mean = max(float(np.diff(self.start).mean()), 1.0 + 1e-9) if seen < 3 else seen
        x = mean
        for _ in range(50):
            x = mean * (1 - np.exp(-x))
        return x

    def fullest(self, counts):
        """Of every eight cells the one with the highest count, where it is above zero."""
        index = np.stack(np.unravel_index(self.keys, self.shape))
        blocks = np.ravel_multi_index(index // 2, self.shape)
        order = np.lexsort((-counts, blocks))
        first = np.r_[True, np.diff(blocks[order]) != 0]
        cells = order[first]
        return cells[counts[cells] > 0]


class Search:
    """Planes found so far and the points that they own."""

    def __init__(self, grid, tolerance, least_points, least_cells):
        self.grid, self.tolerance = grid, tolerance
        self.least = np.array([least_points, least_cells], dtype=np.float64)
        self.owner = np.full(len(grid.points), -1, dtype=np.int32)
        self.centres, self.normals = np.empty((0, 3)), np.empty((0, 3))
        self.cells, self.planes = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        self.trials = np.random.default_rng(0).random((TRIALS, 3))

    def round(self):
        """Try planes among the points that nobody owns and grow them; whether any was found."""
        grid = self.grid
        free = np.add.reduceat((self.owner < 0).astype(np.int64), grid.start[:-1])
        seeds = grid.fullest(free)
        layout = (grid.points, grid.keys, grid.start, grid.steps, self.owner)
        centres, normals, scores = _try_planes(
            *layout, seeds, self.trials, self.tolerance, LEAST_SPREAD * grid.edge**2
        )
        best = np.argsort(-scores, kind="stable")
        best = best[scores[best] > LEAST_TRIAL / 2]
        found = _grow_all(
            *layout,
            seeds[best],
            centres[best],
            normals[best],
            self.tolerance,
            self.least,
            len(self.centres),
        )
        pieces, cells, planes = found
        self.centres = np.concatenate([self.centres, *(c[None] for c, _ in pieces)])
        self.normals = np.concatenate([self.normals, *(n[None] for _, n in pieces)])
        self.cells = np.concatenate([self.cells, *cells])
        self.planes = np.concatenate([self.planes, *planes])
        return len(pieces) > 0

    def assigned(self):
        """Owner of each point (-1: none) and whether it lies on that plane alone; input order."""
        grid = self.grid
        order = np.argsort(self.cells, kind="stable")
        bounds = np.searchsorted(self.cells[order], np.arange(len(grid.keys) + 1))
        near = bounds, self.planes[order]
        for _ in range(2):
            owner, clear = _assign(
                grid.points,
                grid.keys,
                grid.start,
                grid.steps,
                *near,
                self.centres,
                self.normals,
                self.tolerance,
            )
            _refit(grid.points, owner, clear, self.centres, self.normals)
        rows = np.empty(len(owner), dtype=np.int32), np.empty(len(owner), dtype=bool)
        rows[0][grid.order], rows[1][grid.order] = owner, clear
        return rows


@numba.njit(cache=True)
def _column(keys, key):
    """First cell whose key is at least ``key``."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@numba.njit(cache=True)
def _around(keys, steps, cell, reach, out):
    """Occupied cells within ``reach`` of a cell along each axis; how many."""
    n = 0
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            key = keys[cell] + i * steps[0] + j * steps[1]
            k = _column(keys, key - reach)
            while k < len(keys) and keys[k] <= key + reach:
                out[n] = k
                n += 1
                k += 1
    return n


@numba.njit(cache=True)
def _distance(points, p, centre, normal):
    """Signed distance of a point from a plane."""
    return (
        (points[p, 0] - centre[0]) * normal[0]
        + (points[p, 1] - centre[1]) * normal[1]
        + (points[p, 2] - centre[2]) * normal[2]
    )


@numba.njit(cache=True)
def _add(moments, points, p, origin):
    """Add a point to count, sums and products (10 numbers) about an origin."""
    x, y, z = points[p, 0] - origin[0], points[p, 1] - origin[1], points[p, 2] - origin[2]
    moments[0] += 1
    moments[1] += x
    moments[2] += y
    moments[3] += z
    moments[4] += x * x
    moments[5] += x * y
    moments[6] += x * z
    moments[7] += y * y
    moments[8] += y * z
    moments[9] += z * z


@numba.njit(cache=True)
def _fit(moments, origin):
    """Centre, unit normal and mean square residual of the least-squares plane of moments."""
    mean = moments[1:4] / moments[0]
    scatter = np.empty((3, 3))
    k = 4
    for i in range(3):
        for j in range(i, 3):
            scatter[i, j] = scatter[j, i] = moments[k] / moments[0] - mean[i] * mean[j]
            k += 1
    values, vectors = np.linalg.eigh(scatter)
    return origin + mean, vectors[:, 0].copy(), max(values[0], 0.0)


@numba.njit(cache=True)
def _free_around(grid, owner, cell, room, out):
    """Free points around a cell, at most PER_CELL of each cell, evenly drawn; how many."""
    _, keys, start, steps = grid
    n = 0
    for c in room[: _around(keys, steps, cell, REACH, room)]:
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
def _triangle(points, a, b, c, least):
    """Unit normal of three points; zero for a thin triangle."""
    normal = np.cross(points[b] - points[a], points[c] - points[a])
    length = np.sqrt((normal**2).sum())
    if length <= least:
        return np.zeros(3)
    return normal / length


@numba.njit(cache=True)
def _best_trial(points, near, trials, tolerance, least):
    """Centre and normal of the trial that most neighbours lie on."""
    best, centre, normal = 0, np.zeros(3), np.zeros(3)
    for t in range(len(trials)):
        chosen = (trials[t] * len(near)).astype(np.int64)
        a, b, c = near[chosen[0]], near[chosen[1]], near[chosen[2]]
        trial = _triangle(points, a, b, c, least)
        if not trial.any():
            continue
        votes = 0
        for p in near:
            votes += abs(_distance(points, p, points[a], trial)) <= tolerance
        if votes > best:
            best, centre, normal = votes, points[a].copy(), trial
    return centre, normal


@numba.njit(cache=True)
def _refined(points, near, centre, normal, tolerance):
    """The plane fitted to the neighbours on it; score: their number less what chance would give."""
    moments, origin, score = np.zeros(10), centre.copy(), 0.0
    for _ in range(3):
        moments[:] = 0
        for p in near:
            if abs(_distance(points, p, centre, normal)) <= tolerance:
                _add(moments, points, p, origin)
        if moments[0] < LEAST_TRIAL:
            return centre, normal, 0.0
        centre, normal, square = _fit(moments, origin)
        score = moments[0] * (1 - square / (ROUGH * tolerance**2))
    return centre, normal, score


@numba.njit(cache=True, parallel=True)
def _try_planes(points, keys, start, steps, owner, seeds, trials, tolerance, least):
    """A plane piece around each seed cell: centres, normals, scores."""
    centres, normals = np.zeros((len(seeds), 3)), np.zeros((len(seeds), 3))
    scores = np.zeros(len(seeds))
    for s in numba.prange(len(seeds)):
        room = np.empty(AROUND, dtype=np.int64)
        near = np.empty(PER_CELL * AROUND, dtype=np.int64)
        n = _free_around((points, keys, start, steps), owner, seeds[s], room, near)
        if n < LEAST_TRIAL:
            continue
        centre, normal = _best_trial(points, near[:n], trials, tolerance, least)
        if normal.any():
            centre, normal, scores[s] = _refined(points, near[:n], centre, normal, tolerance)
            centres[s], normals[s] = centre, normal
    return centres, normals, scores


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
def _grow(grid, owner, seed, centre, normal, tolerance, refit, marks, mark, queue, room, moments):
    """Cells that hang together with the seed's on a plane: their number (in ``queue``), the plane.

    With ``refit`` the plane is fitted anew whenever the points have doubled.
    """
    keys, steps, origin = grid[1], grid[3], centre.copy()
    moments[:] = 0
    marks[seed] = mark
    if not _takes(grid, owner, seed, centre, normal, tolerance, moments, origin):
        return 0, centre, normal
    queue[0], done, n, fitted = seed, 0, 1, 4 * LEAST_TRIAL
    while done < n:
        cell = queue[done]
        done += 1
        for k in range(_around(keys, steps, cell, 1, room)):
            other = room[k]
            if marks[other] == mark:
                continue
            marks[other] = mark
            if _takes(grid, owner, other, centre, normal, tolerance, moments, origin):
                queue[n] = other
                n += 1
        if refit and moments[0] >= 2 * fitted:
            fitted = moments[0]
            centre, normal, _ = _fit(moments, origin)
    if moments[0] >= 3:
        centre, normal, _ = _fit(moments, origin)
    return n, centre, normal


@numba.njit(cache=True)
def _own(grid, owner, cells, centre, normal, tolerance, number):
    """Give the free points of the cells near the plane to it."""
    for cell in cells:
        for p in range(grid[2][cell], grid[2][cell + 1]):
            if owner[p] < 0 and abs(_distance(grid[0], p, centre, normal)) <= tolerance:
                owner[p] = number


@numba.njit(cache=True)
def _grow_all(points, keys, start, steps, owner, seeds, centres, normals, tolerance, least, first):
    """Grow one piece after the other; planes found, and (cell, plane) of all cells they take."""
    grid = (points, keys, start, steps)
    marks, queue = np.full(len(keys), -1, dtype=np.int64), np.empty(len(keys), dtype=np.int64)
    room, moments, mark = np.empty(27, dtype=np.int64), np.zeros(BESIDE + 1), 0
    found = []
    cells, planes = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for s in range(len(seeds)):
        centre, normal, size = centres[s], normals[s], 0
        for turn in range(PASSES):
            n, new_centre, new_normal = _grow(
                grid,
                owner,
                seeds[s],
                centre,
                normal,
                tolerance,
                turn == 0,
                marks,
                mark,
                queue,
                room,
                moments,
            )
            mark += 1
            if n < least[1] or moments[0] < least[0]:
                size = 0
                break
            if turn and n <= size:
                break
            size, centre, normal = n, new_centre, new_normal
        if size == 0 or moments[0] < STANDS_OUT * moments[BESIDE]:
            continue
        _own(grid, owner, queue[:n], centre, normal, tolerance, first + len(found))
        planes.append(np.full(n, first + len(found)))
        cells.append(queue[:n].copy())
        found.append((centre, normal))
    return found, cells, planes


@numba.njit(cache=True)
def _planes_around(keys, steps, bounds, planes, cell, room, out):
    """Different planes that take a cell or one beside it; how many."""
    n = 0
    for c in room[: _around(keys, steps, cell, 1, room)]:
        for k in range(bounds[c], bounds[c + 1]):
            known = False
            for other in out[:n]:
                known |= other == planes[k]
            if not known and n < len(out):
                out[n] = planes[k]
                n += 1
    return n


@numba.njit(cache=True, parallel=True)
def _assign(points, keys, start, steps, bounds, planes, centres, normals, tolerance):
    """The nearest plane around each point within the tolerance (-1: none), and whether the only."""
    owner = np.full(len(points), -1, dtype=np.int32)
    clear = np.zeros(len(points), dtype=np.bool_)
    for cell in numba.prange(len(keys)):
        room, near = np.empty(27, dtype=np.int64), np.empty(MOST_AROUND, dtype=np.int64)
        n = _planes_around(keys, steps, bounds, planes, cell, room, near)
        for p in range(start[cell], start[cell + 1]):
            least, claims = tolerance, 0
            for plane in near[:n]:
                d = abs(_distance(points, p, centres[plane], normals[plane]))
                claims += d <= tolerance
                if d <= least:
                    least = d
                    owner[p] = plane
            clear[p] = claims == 1
    return owner, clear


@numba.njit(cache=True)
def _refit(points, owner, clear, centres, normals):
    """Fit all planes to the points that lie on them alone."""
    moments, origins = np.zeros((len(centres), 10)), centres.copy()
    for p in range(len(points)):
        if owner[p] >= 0 and clear[p]:
            _add(moments[owner[p]], points, p, origins[owner[p]])
    for k in range(len(centres)):
        if moments[k, 0] >= 3:
            centres[k], normals[k], _ = _fit(moments[k], origins[k])


def neighbouring_owners(grid, owner, n):
    """Pairs (a < b) of owners with points in cells beside each other, shape (k, 2)."""
    bounds, owners = _owners(grid, owner, n)
    keys = _pairs_around(grid.keys, grid.steps, bounds, owners, n)
    return np.stack(np.divmod(np.unique(keys), n), axis=1)


def beside_lines(grid, owner, lines, *, tolerance, reach):
    """Points within ``reach`` of a line of their plane with another, and clear of that other.

    Returns the side of each (twice the line's number, plus one for the second plane) and
    its station along the line, m.
    """
    n = len(lines.normals)
    bounds, owners = _owners(grid, owner, n)
    keys = lines.pairs[:, 0] * n + lines.pairs[:, 1]
    return _beside(
        grid.points,
        grid.keys,
        grid.start,
        grid.steps,
        owner,
        bounds,
        owners,
        keys,
        lines.foot,
        lines.direction,
        lines.centres,
        lines.normals,
        tolerance,
        reach,
    )


def _owners(grid, owner, n):
    """Different owners in each cell: bounds and numbers."""
    cell = np.repeat(np.arange(len(grid.keys)), np.diff(grid.start))
    both = np.unique(cell * n + owner)
    cells, owners = np.divmod(both, n)
    return np.searchsorted(cells, np.arange(len(grid.keys) + 1)), owners


@numba.njit(cache=True)
def _pairs_around(keys, steps, bounds, owners, n):
    """Keys a n + b of owners a < b of each cell and those beside it."""
    room, near = np.empty(27, dtype=np.int64), np.empty(MOST_AROUND, dtype=np.int64)
    found = {np.int64(-1)}
    for cell in range(len(keys)):
        k = _planes_around(keys, steps, bounds, owners, cell, room, near)
        for a in owners[bounds[cell] : bounds[cell + 1]]:
            for b in near[:k]:
                if a != b:
                    found.add(min(a, b) * n + max(a, b))
    found.remove(np.int64(-1))
    out = np.empty(len(found), dtype=np.int64)
    for k, key in enumerate(found):
        out[k] = key
    return out


@numba.njit(cache=True)
def _beside(
    points, keys, start, steps, owner, bounds, owners, pairs, foot, direction, centres, normals,
    tolerance, reach,
):  # fmt: skip
    """Sides and stations of the points beside the lines of pairs of planes."""
    room, near = np.empty(27, dtype=np.int64), np.empty(MOST_AROUND, dtype=np.int64)
    sides, stations, n = np.empty(len(points), np.int64), np.empty(len(points)), 0
    for cell in range(len(keys)):
        k = _planes_around(keys, steps, bounds, owners, cell, room, near)
        for a in owners[bounds[cell] : bounds[cell + 1]]:
            for b in near[:k]:
                key = min(a, b) * len(normals) + max(a, b)
                line = _column(pairs, key)
                if a == b or line == len(pairs) or pairs[line] != key:
                    continue
                for p in range(start[cell], start[cell + 1]):
                    if (
                        owner[p] != a
                        or abs(_distance(points, p, centres[b], normals[b])) <= tolerance
                    ):
                        continue
                    station = _distance(points, p, foot[line], direction[line])
                    square = ((points[p] - foot[line]) ** 2).sum() - station**2
                    if square <= reach**2:
                        if n == len(sides):
                            sides = np.concatenate((sides, np.empty_like(sides)))
                            stations = np.concatenate((stations, np.empty_like(stations)))
                        sides[n], stations[n] = 2 * line + (a > b), station
                        n += 1
    return sides[:n], stations[:n]
