"""Edges of clouds, where planes meet, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_points
from mmqa_lab._results import NORMAL
from mmqa_lab.plane_search import CELLS_PER_SIZE, Grid, detect_planes, usual_size

__all__ = ["Edges", "extract_edges"]

# Least angle between two planes with an edge.
LEAST_DEG = 20.0

# Points beside an edge count as off their plane from this height, in standard deviations. A larger
# limit misses faces that are joined within the tolerance and have few points, such as those of
# cars.
MISFIT = 0.5

# One row of points in 40 ends farther before the end of its face than the spread allows. The
# shorter of two rows then exceeds it in 5 % of all cases.
BEYOND = 40.0


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a cloud and their uncertainty.

    Parameters
    ----------
    segments : array, shape (n, 2, 3)
        Edges, m.
    covariance : array, shape (n, 2, 3, 3)
        Of both ends, square metres. Across the edge it comes from the planes. Along the edge it
        comes from the spacing and noise of the points beside it, or from a third plane.
    """

    segments: np.ndarray
    covariance: np.ndarray

    def __len__(self):
        return len(self.segments)


def extract_edges(
    points: ArrayLike, *, tolerance: float = 0.05, size: float | None = None
) -> Edges:
    """Detect planes and intersect neighbours with an angle of 20 degrees or more.

    The line of two planes is cut into bins of a quarter of ``size``. A bin is full if both planes
    have points within half of ``size`` of the line and clear of all other planes. Each needs a
    quarter of its usual number at least. Points of both must also come as near to the line as their
    spacing allows, since a plane that ends before the line has no edge there. Runs of full bins are
    edges; gaps of a single bin are closed. An edge ends where its shorter side ends: half a gap
    beyond the last point, or where a third plane meets both within the uncertainty of that end.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance, size
        As in :func:`mmqa_lab.plane_search.detect_planes`, m. Points within the tolerance of two
        planes support neither. Edges are half of ``size`` long at least. A face smaller than a
        quarter of ``size`` squared has no edges. Default size: 1.5 m, or 2 m if scan lines are far
        apart. In thin clouds it grows up to 3 m, for about three points in a square with a side of
        a quarter of ``size``.

    Returns
    -------
    Edges

    Raises
    ------
    ValueError
        If a point is not finite, or a setting is out of its range.

    Notes
    -----
    The uncertainty assumes independent errors of the points with their residual standard deviation.
    If the points beside an edge lie off their plane, this height is added. An example is the body
    of a car that is joined with its cabin within the tolerance. On simulated streets of 10 to 300
    points per square metre the 95 % ellipse across the edge contained 96 to 97 % of the ends, and
    89 to 97 % of those of cars. Errors shared by neighbouring points (positioning, relief) are not
    included; a comparison of surveys shows them.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges where principal planes meet.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (4000, 3))
    >>> edges = extract_edges(np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]]))
    >>> len(edges), np.ptp(edges.segments, axis=1).max(axis=1).round(1).tolist()
    (1, [5.0])
    """
    points = check_points(points, minimum=0)
    size = usual_size(points) if size is None else size
    patches = detect_planes(points, tolerance=tolerance, size=size)
    rows = []
    if len(patches) > 1:
        lines = _Lines(points, patches, size / 2, tolerance)
        for line, sides in lines.supported():
            clear = tolerance / np.sqrt(lines.sine2[line])
            for low, high, counts in _runs(sides, size / CELLS_PER_SIZE, clear):
                if high[0] - low[0] >= size / 2 and min(counts) >= 4:
                    rows.append(lines.edge(line, low, high, sides, size))
    segments, covariance = zip(*rows, strict=True) if rows else ((), ())
    return Edges(np.array(segments).reshape(-1, 2, 3), np.array(covariance).reshape(-1, 2, 3, 3))


class _Lines:
    """Intersection lines of neighbouring planes."""

    def __init__(self, points, patches, reach, tolerance):
        self.patches, self.reach, self.tolerance = patches, reach, tolerance
        owned = np.concatenate([patch.clear for patch in patches])
        owner = np.repeat(np.arange(len(patches)), [len(patch.clear) for patch in patches])
        self.origin, grid = points[owned].mean(axis=0), Grid(points[owned], reach)
        self.points = grid.points + (grid.low - self.origin)
        self.normals = np.array([patch.plane.normal for patch in patches])
        self.centres = np.array([patch.plane.centre for patch in patches]) - self.origin
        self.least = np.sin(np.radians(LEAST_DEG))
        self._intersect(self._met(grid, owner[grid.order]))

    def _met(self, grid, owner):
        """Pairs of patches that meet in neighbouring cells; keeps where they do."""
        # a run of points of one patch in one cell: its first point, cell and patch
        cell = np.repeat(np.arange(len(grid.keys)), np.diff(grid.start))
        change = (cell[1:] != cell[:-1]) | (owner[1:] != owner[:-1])
        self.start = np.flatnonzero(np.concatenate([[True], change, [True]]))
        cell, owner = cell[self.start[:-1]], owner[self.start[:-1]]
        which, other = _ranges(*np.searchsorted(cell, grid.near(cell, 1)).reshape(-1, 2).T)
        run = which // 9
        run, other = run[owner[run] != owner[other]], owner[other[owner[run] != owner[other]]]
        count = len(self.patches)
        meetings = np.unique((owner[run] * count + other) * len(cell) + run)
        self.meeting, self.run = np.divmod(meetings, len(cell))
        met = np.stack(np.divmod(np.unique(self.meeting), count), axis=1)
        self.near = np.split(met[:, 1], np.searchsorted(met[:, 0], np.arange(1, count)))
        return met[met[:, 0] < met[:, 1]]

    def _intersect(self, pairs):
        """Keep the pairs of planes with an edge, its direction and its foot."""
        first, second = self.normals[pairs].swapaxes(0, 1)
        cosine = (first * second).sum(axis=1)
        meet = 1 - cosine**2 >= self.least**2
        self.pairs, first, second, cosine = pairs[meet], first[meet], second[meet], cosine[meet]
        self.sine2 = 1 - cosine**2
        self.direction = np.cross(first, second) / np.sqrt(self.sine2)[:, None]
        start, other = self.centres[self.pairs].swapaxes(0, 1)
        height = ((other - start) * second).sum(axis=1) / self.sine2
        self.foot = start + height[:, None] * (second - cosine[:, None] * first)

    def supported(self):
        """Yield each line with its points on both planes, as rows station, depth, height."""
        for line, pair in enumerate(self.pairs):
            sides = [self._beside(line, *order) for order in (pair, pair[::-1])]
            if all(side.size for side in sides):
                yield line, sides

    def _beside(self, line, own, other):
        """Points of a patch within reach of its line with another, sorted by station."""
        meeting = own * len(self.patches) + other
        runs = self.run[slice(*np.searchsorted(self.meeting, [meeting, meeting + 1]))]
        points = self.points[_ranges(self.start[runs], self.start[runs + 1])[1]]
        way = self.direction[line]
        axes = np.stack([way, np.cross(self.normals[own], way), self.normals[own]])
        side = axes @ (points - self.foot[line]).T
        side = side[:, np.abs(side[1]) <= self.reach]
        return side[:, np.argsort(side[0], kind="stable")]

    def edge(self, line, low, high, sides, size):
        """Ends (2, 3) of an edge and their covariances."""
        direction, pair = self.direction[line], self.pairs[line]
        solve = np.linalg.pinv(self.normals[pair])
        noise = max(self.patches[number].sigma for number in pair)
        misfits = np.transpose([_misfits(side, low[0], high[0], size / 3) for side in sides])
        # points within the tolerance of a third plane do not count, so its corner lies that far off
        most = (high[0] - low[0]) / 4
        low, high = (
            self._corner(line, end, min(NORMAL * np.hypot(end[1], noise) + self.tolerance, most))
            for end in (low, high)
        )
        ends = self.origin + self.foot[line] + np.outer([low[0], high[0]], direction)
        covariance = []
        for end, (_, spread), misfit in zip(ends, (low, high), misfits, strict=True):
            heights = [self.patches[number].offset_variance(end) for number in pair] + misfit**2
            along = spread**2 + noise**2
            across = solve @ np.diag(heights) @ solve.T
            covariance.append(across + along * np.outer(direction, direction))
        return ends, covariance

    def _corner(self, line, end, most):
        """The corner with a third plane within ``most`` of an end, with its spread; else the end.

        Three planes determine the corner of a face far better than the gap after its last point.
        """
        near = np.intersect1d(*(self.near[number] for number in self.pairs[line]))
        slope = self.normals[near] @ self.direction[line]
        near, slope = near[np.abs(slope) >= self.least], slope[np.abs(slope) >= self.least]
        station = ((self.centres[near] - self.foot[line]) * self.normals[near]).sum(axis=1) / slope
        off = np.abs(station - end[0])
        if off.min(initial=np.inf) > most:
            return end
        best = off.argmin()
        place = self.origin + self.foot[line] + station[best] * self.direction[line]
        variance = self.patches[near[best]].offset_variance(place)
        return station[best], np.sqrt(variance) / abs(slope[best])


def _ranges(first, last):
    """The whole numbers of several ranges one after the other, after the range of each."""
    number = last - first
    which = np.repeat(np.arange(len(first)), number)
    return which, (first - np.cumsum(number) + number)[which] + np.arange(len(which))


def _misfits(side, low, high, reach):
    """Heights (2,) at both ends of the points beside a line; zero if they may be due to chance.

    Two faces that are joined within the tolerance lie off their common plane.
    """
    heights = np.zeros(2)
    side = side[:, (np.abs(side[1]) <= reach) & (side[0] >= low) & (side[0] <= high)]
    for half in (side[1] > 0, side[1] < 0):
        station, depth, height = side[:, half]
        freedom = len(height) - 3
        if freedom < 2:
            continue
        part = (station - low) / (high - low)
        design = np.column_stack([1 - part, part, depth])
        inverse = np.linalg.pinv(design.T @ design)
        found = inverse @ design.T @ height
        variance = ((height - design @ found) ** 2).sum() / freedom * np.diag(inverse)[:2]
        off = np.abs(found[:2])
        heights = np.maximum(heights, np.where(off > MISFIT * np.sqrt(variance), off, 0))
    return heights


def _runs(sides, cell, clear):
    """Yield the edges along a line: (low end, spread), (high end, spread), numbers of points."""
    gaps = [np.median(np.diff(side[0])) / np.log(2) for side in sides if side.shape[1] > 1]
    # a bin spans four mean gaps at least, so that few bins of a thin cloud are empty by chance
    cell = max(cell, 4 * max(gaps, default=0.0))
    low = max(side[0, 0] for side in sides)
    bins = int(np.ceil((min(side[0, -1] for side in sides) - low) / cell))
    if bins < 1:
        return
    edges = low + cell * np.arange(bins + 1)
    full = np.array([_full(side, edges, cell, clear) for side in sides])
    full[:, 1:-1] |= full[:, :-2] & full[:, 2:]
    change = np.flatnonzero(np.diff(np.r_[False, full.all(axis=0), False].astype(int)))
    for start, stop in change.reshape(-1, 2):
        first, last = edges[start], edges[stop]
        if not all(_full(side, edges[[start, stop]], cell, clear)[0] for side in sides):
            continue
        ends = [_reached(side[0], first, last, cell) for side in sides]
        lows, highs, counts = zip(*ends, strict=True)
        yield max(lows), min(highs), counts


def _full(side, edges, cell, clear):
    """Whether each bin has enough points, with a margin for chance, and reaches the line."""
    station, distance = side[0], np.abs(side[1])
    bins = np.searchsorted(edges, station, "right") - 1
    inside = (bins >= 0) & (bins < len(edges) - 1)
    counts = np.bincount(bins[inside], minlength=len(edges) - 1)
    usual = np.median(counts[counts > 0]) if counts.any() else 0
    nearest = np.full(len(counts), np.inf)
    np.minimum.at(nearest, bins[inside], distance[inside])
    lines_apart = np.diff(np.sort(distance)).max(initial=0)
    # four mean gaps across the line
    away = np.maximum(max(cell / 4, lines_apart), 8 * cell / (counts + 1))
    # stray points do not lengthen an edge
    fair = counts >= max(1, 0.25 * usual - np.sqrt(usual))
    return fair & (nearest <= clear + away)


def _reached(side, first, last, cell):
    """Both ends of a side about a run of bins, and the number of points between them.

    An end is its station along the line and its standard deviation, m.
    The gap after the last point is exponentially distributed. Its mean is estimated from n gaps, so
    that one gap in 40 is longer than n (40^(1/n) - 1) means. By the same law a side is cut at a gap
    that occurs by chance on one side in 40.
    """
    inside = side[np.searchsorted(side, first - cell) : np.searchsorted(side, last + cell, "right")]
    gaps = np.diff(inside)
    core = (inside >= first) & (inside <= last)
    within = gaps[core[1:] & core[:-1]]
    gap = (within**2).sum() / (2 * within.sum()) if within.sum() else cell
    n = max(within.sum() / (2 * gap), 1.0)
    broken = np.flatnonzero(gaps > _beyond(n, BEYOND * len(gaps)) * gap)
    a, b = np.flatnonzero(core)[[0, -1]] if core.any() else (0, len(inside) - 1)
    a = max((k + 1 for k in broken if k < a), default=0)
    b = min((k for k in broken if k >= b), default=len(inside) - 1)
    spread = gap * (_beyond(n, BEYOND) - 1) / NORMAL
    return (inside[a] - gap, spread), (inside[b] + gap, spread), b - a + 1


def _beyond(n, draws):
    """Length that one gap in ``draws`` exceeds, as a multiple of the mean estimated from n gaps."""
    return n * (draws ** (1 / n) - 1)
