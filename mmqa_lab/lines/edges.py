"""Edges: where adjacent planes of a cloud meet, with the uncertainty that the planes leave."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab.lines.geometry import Segments
from mmqa_lab.planes import _cells, detect_planes
from mmqa_lab.planes.detection import CELLS_PER_SIZE

LEAST_BIN = 0.25
"""A bin of an edge has this share of the median of its side, so that strays do not lengthen it."""

END_NOISE = 2.0
"""Share of the points' variance in that of an end: the outermost of many noisy points marks it."""

LONGEST_GAP = 5.0
"""An edge goes on beyond its last full bin while its points are nearer than this, in mean gaps."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a cloud and how well they are known.

    Parameters
    ----------
    segments : Segments
        n edges, m.
    covariance : array, shape (n, 2, 3, 3)
        Of both ends, square metres: across the edge from the planes, along it from the distances
        and the noise of the points beside it.
    support : array of int, shape (n, 2)
        Points of either plane beside the edge and clear of the other plane.
    angle : array, shape (n,)
        Angle between the planes, degrees, 0 to 90.
    patches : array of int, shape (n, 2)
        Numbers of the two patches.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (4000, 3)) + 0.005 * rng.standard_normal((4000, 3))
    >>> edges = extract_edges(np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]]))
    >>> edges.angle.round(3).tolist(), edges.to_frame()["length_m"].round(1).tolist()
    ([90.0], [5.0])
    """

    segments: Segments
    covariance: np.ndarray
    support: np.ndarray
    angle: np.ndarray
    patches: np.ndarray

    def __len__(self):
        return len(self.segments)

    @property
    def sigma(self):
        """Standard deviation across the edge in its worst direction at each end, (n, 2), m."""
        if not len(self):
            return np.empty((0, 2))
        axes = self.segments.directions
        rest = np.eye(3) - axes[:, :, None] * axes[:, None]
        across = rest[:, None] @ self.covariance @ rest[:, None]
        return np.sqrt(np.linalg.eigvalsh(across)[..., -1])

    @property
    def sigma_along(self):
        """Standard deviation of each end along the edge, (n, 2), m."""
        axes = self.segments.directions
        return np.sqrt(np.einsum("nd,nkde,ne->nk", axes, self.covariance, axes))

    def to_frame(self):
        """Return one row per edge: ends, length, angle, support, standard deviations."""
        ends = [f"{axis}{end}_m" for end in (1, 2) for axis in "xyz"]
        frame = pd.DataFrame(self.segments.ends.reshape(-1, 6), columns=ends)
        frame["length_m"] = self.segments.lengths
        frame["angle_deg"] = self.angle
        frame[["n_first", "n_second"]] = self.support
        frame[["sigma_first_mm", "sigma_second_mm"]] = 1000 * self.sigma
        frame[["sigma_along_first_mm", "sigma_along_second_mm"]] = 1000 * self.sigma_along
        return frame

    def _repr_html_(self):
        return self.to_frame()._repr_html_()


def extract_edges(points, *, tolerance=0.05, size=2.0, minimum=None, angle=20.0, support=6):
    """Detect planes and intersect those that meet.

    :func:`mmqa_lab.planes.detect_planes`, then :func:`intersect_patches`, with their parameters.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance, size, minimum
        See :func:`mmqa_lab.planes.detect_planes`.
    angle, support
        See :func:`intersect_patches`.

    Returns
    -------
    Edges

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (4000, 3))
    >>> edges = extract_edges(np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]]))
    >>> len(edges), edges.segments.lengths.round(1).tolist()
    (1, [5.0])
    """
    patches = detect_planes(points, tolerance=tolerance, size=size, minimum=minimum)
    return intersect_patches(
        points, patches, tolerance=tolerance, size=size, angle=angle, support=support
    )


def intersect_patches(points, patches, *, tolerance=0.05, size=2.0, angle=20.0, support=6):
    """Intersect adjacent planes and clip the lines to where both planes have points.

    The line of two planes is cut into bins of a quarter of ``size``. A bin counts where both
    patches have points within half of ``size`` of the line that are clear of the other plane, and a
    quarter of what their other bins have at least; runs of bins, gaps of one bin closed, are edges.
    An edge ends where its first side ends: at the last point and half a gap, which is what
    the end of a row of points leaves open.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        The cloud of which the patches are made, m.
    patches : list of Patch
    tolerance : float
        As in :func:`mmqa_lab.planes.detect_planes`, m: points within it of both planes support
        neither.
    size : float
        As in :func:`mmqa_lab.planes.detect_planes`, m; edges are half of it long at least.
    angle : float
        Least angle between two planes, degrees.
    support : int
        Least number of points beside the edge on either plane.

    Returns
    -------
    Edges

    Raises
    ------
    ValueError
        If a point is not finite, or a setting is out of its range.

    Notes
    -----
    The uncertainty is that of two planes whose points err independently by their residual standard
    deviation. Errors that neighbouring points share (positioning, relief, a bowed wall) are not in
    it: compare surveys to see those.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges where principal planes meet.

    Examples
    --------
    >>> from mmqa_lab.planes import detect_planes
    >>> flat = np.random.default_rng(0).uniform(0, 5, (4000, 3))
    >>> points = np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]])
    >>> edges = intersect_patches(points, detect_planes(points))
    >>> edges.angle.round(6).tolist(), edges.patches.tolist()
    ([90.0], [[0, 1]])
    """
    points = check_points(points, minimum=0)
    tolerance = check_positive(tolerance, "tolerance", unit="m")
    size = check_positive(size, "size", unit="m")
    angle = check_number(angle, "angle", low=0, high=90, unit="degrees")
    support = check_count(support, "support")
    rows = []
    if len(patches) > 1:
        lines = _Lines(patches, *_neighbours(points, patches, size / 2), angle)
        for line, sides in lines.supported(tolerance, size / 2):
            for low, high, counts in _runs(sides, size / CELLS_PER_SIZE):
                if high[0] - low[0] >= size / 2 and min(counts) >= support:
                    rows.append(lines.edge(line, low, high, counts))
    columns = list(zip(*rows, strict=True)) if rows else [()] * 5
    return Edges(
        segments=Segments(np.array(columns[0]).reshape(-1, 2, 3)),
        covariance=np.array(columns[1]).reshape(-1, 2, 3, 3),
        support=np.array(columns[2], dtype=int).reshape(-1, 2),
        angle=np.array(columns[3], dtype=float),
        patches=np.array(columns[4], dtype=int).reshape(-1, 2),
    )


class _Lines:
    """The lines in which neighbouring planes meet at an angle."""

    def __init__(self, patches, grid, owner, origin, angle):
        self.patches, self.grid, self.owner, self.origin = patches, grid, owner, origin
        self.normals = np.array([patch.plane.normal for patch in patches])
        self.centres = np.array([patch.plane.centre for patch in patches]) - origin
        pairs = _cells.neighbouring_owners(grid, owner, len(patches))
        first, second = self.normals[pairs].swapaxes(0, 1)
        cosine = (first * second).sum(axis=1)
        meet = 1 - cosine**2 >= np.sin(np.radians(angle)) ** 2
        self.pairs, first, second, cosine = pairs[meet], first[meet], second[meet], cosine[meet]
        self.sine2 = 1 - cosine**2
        self.direction = np.cross(first, second) / np.sqrt(self.sine2)[:, None]
        start, other = self.centres[self.pairs].swapaxes(0, 1)
        height = ((other - start) * second).sum(axis=1) / self.sine2
        self.foot = start + height[:, None] * (second - cosine[:, None] * first)

    def supported(self, tolerance, reach):
        """Each line with the sorted stations of the points beside it, those of either plane."""
        found = _cells.beside_lines(self.grid, self.owner, self, tolerance=tolerance, reach=reach)
        side, station = found
        order = np.lexsort((station, side))
        side, station = side[order], station[order]
        bounds = np.searchsorted(side, np.arange(2 * len(self.pairs) + 1))
        for line in range(len(self.pairs)):
            a, b, c = bounds[2 * line : 2 * line + 3]
            if a < b < c:
                yield line, (station[a:b], station[b:c])

    def edge(self, line, low, high, counts):
        """Ends, covariances, support, angle and numbers of an edge."""
        direction, pair = self.direction[line], self.pairs[line]
        ends = self.origin + self.foot[line] + np.outer([low[0], high[0]], direction)
        solve = np.linalg.pinv(self.normals[pair])
        noise = max(self.patches[number].sigma for number in pair)
        covariance = []
        for end, (_, gap) in zip(ends, (low, high), strict=True):
            heights = np.diag([self.patches[number].offset_variance(end) for number in pair])
            along = (gap**2 + END_NOISE * noise**2) * np.outer(direction, direction)
            covariance.append(solve @ heights @ solve.T + along)
        opening = np.degrees(np.arcsin(np.sqrt(min(self.sine2[line], 1.0))))
        return ends, covariance, counts, opening, pair


def _neighbours(points, patches, reach):
    """Cells of the points that patches own, the owners, and the cells' origin."""
    owner = np.full(len(points), -1, dtype=np.int32)
    for number, patch in enumerate(patches):
        owner[patch.index] = number
    owned = np.flatnonzero(owner >= 0)
    grid = _cells.Grid(points[owned], reach)
    return grid, owner[owned][grid.order], points[owned].mean(axis=0)


def _runs(sides, cell):
    """Edges along a line: (low end, gap there), (high end, gap), numbers of points."""
    low = max(side[0] for side in sides)
    bins = int(np.ceil((min(side[-1] for side in sides) - low) / cell))
    if bins < 1:
        return
    edges = low + cell * np.arange(bins + 1)
    both = np.all([_full(np.histogram(side, edges)[0]) for side in sides], axis=0)
    both[1:-1] |= both[:-2] & both[2:]
    change = np.flatnonzero(np.diff(np.r_[False, both, False].astype(int)))
    for start, stop in change.reshape(-1, 2):
        first, last = edges[start], edges[stop]
        ends = [_ends(side, first, last, cell) for side in sides]
        low_end = max((end[:2] for end in ends), key=lambda end: end[0])
        high_end = min((end[2:4] for end in ends), key=lambda end: end[0])
        yield low_end, high_end, [end[4] for end in ends]


def _full(counts):
    """Bins with a fair share of the points, less what chance takes away."""
    usual = np.median(counts[counts > 0]) if counts.any() else 0
    return counts >= max(1, LEAST_BIN * usual - np.sqrt(usual))


def _ends(side, first, last, cell):
    """Low end and gap, high end and gap, number of points of one side about a run of bins."""
    inside = side[np.searchsorted(side, first - cell) : np.searchsorted(side, last + cell, "right")]
    gaps = np.diff(inside)
    core = (inside >= first) & (inside <= last)
    within = gaps[core[1:] & core[:-1]]
    gap = (within**2).sum() / (2 * within.sum()) if within.sum() else cell
    broken = np.flatnonzero(gaps > LONGEST_GAP * gap)
    a, b = np.flatnonzero(core)[[0, -1]] if core.any() else (0, len(inside) - 1)
    a = max((k + 1 for k in broken if k < a), default=0)
    b = min((k for k in broken if k >= b), default=len(inside) - 1)
    return inside[a] - gap, gap, inside[b] + gap, gap, b - a + 1
