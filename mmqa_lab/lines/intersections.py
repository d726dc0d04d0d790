"""Edges: where adjacent planes of a cloud meet, with the uncertainty that the planes leave."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab.lines import Segments
from mmqa_lab.lines.patches import CELLS_PER_SIZE, detect_planes


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a cloud and how well they are known.

    Parameters
    ----------
    segments : Segments
        n edges, m.
    covariance : array, shape (n, 2, 3, 3)
        Of both ends across the edge, square metres. Where an edge ends is a matter of support, not
        of this covariance.
    support : array of int, shape (n, 2)
        Points of either plane beside the edge.
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
        return np.sqrt(np.linalg.eigvalsh(self.covariance)[..., -1])

    def to_frame(self):
        """Return one row per edge: ends, length, angle, support, standard deviations."""
        ends = [f"{axis}{end}_m" for end in (1, 2) for axis in "xyz"]
        frame = pd.DataFrame(self.segments.ends.reshape(-1, 6), columns=ends)
        frame["length_m"] = self.segments.lengths
        frame["angle_deg"] = self.angle
        frame[["n_first", "n_second"]] = self.support
        frame[["sigma_first_mm", "sigma_second_mm"]] = 1000 * self.sigma
        return frame


def intersect_patches(points, patches, *, size=2.0, angle=20.0, support=20):
    """Intersect adjacent planes and clip the lines to where both planes have points.

    The line of two planes is cut into bins of a quarter of ``size``. A bin counts where both
    patches have points within half of ``size`` of the line; runs of bins, gaps of one bin closed,
    are edges.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        The cloud of which the patches are made, m.
    patches : list of Patch
    size : float
        As in :func:`detect_planes`, m; edges are half of it long at least.
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
        If a point is not finite, or ``size``, ``angle`` or ``support`` is out of its range.

    Notes
    -----
    The uncertainty is that of two planes whose points err independently by their residual standard
    deviation. Errors that neighbouring points share (positioning, relief, a bowed wall) are not in
    it: take it as the lower limit.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges as intersections of adjacent planes.

    Examples
    --------
    >>> flat = np.random.default_rng(0).uniform(0, 5, (4000, 3))
    >>> points = np.concatenate([flat * [1, 1, 0], flat * [1, 0, 1]])
    >>> edges = intersect_patches(points, detect_planes(points))
    >>> edges.angle.round(6).tolist(), edges.patches.tolist()
    ([90.0], [[0, 1]])
    """
    points = check_points(points, minimum=0)
    size = check_positive(size, "size", unit="m")
    angle = check_number(angle, "angle", low=0, high=90, unit="degrees")
    support = check_count(support, "support")
    rows = []
    boxes = [_box(points[patch.index], size / 2) for patch in patches]
    for a, b in combinations(range(len(patches)), 2):
        if (boxes[a][0] > boxes[b][1]).any() or (boxes[b][0] > boxes[a][1]).any():
            continue
        rows += _edges_of_pair(points, patches, (a, b), size, angle, support)
    columns = list(zip(*rows, strict=True)) if rows else [(), (), (), (), ()]
    return Edges(
        segments=Segments(np.array(columns[0]).reshape(-1, 2, 3)),
        covariance=np.array(columns[1]).reshape(-1, 2, 3, 3),
        support=np.array(columns[2], dtype=int).reshape(-1, 2),
        angle=np.array(columns[3], dtype=float),
        patches=np.array(columns[4], dtype=int).reshape(-1, 2),
    )


def extract_edges(points, *, tolerance=0.05, size=2.0, minimum=200, angle=20.0, support=20, seed=0):
    """Detect planes and intersect those that meet.

    :func:`detect_planes`, then :func:`intersect_patches`, with their parameters.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance, size, minimum, seed
        See :func:`detect_planes`.
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
    points = check_points(points, minimum=0)
    patches = detect_planes(points, tolerance=tolerance, size=size, minimum=minimum, seed=seed)
    return intersect_patches(points, patches, size=size, angle=angle, support=support)


def _box(points, margin):
    """Lower and upper corner of a box around points."""
    return points.min(axis=0) - margin, points.max(axis=0) + margin


def _edges_of_pair(points, patches, pair, size, angle, support):
    """Ends, covariances, support, angle and numbers of each edge that two planes form."""
    first, second = (patches[number].plane for number in pair)
    direction = np.cross(first.normal, second.normal)
    sine = np.linalg.norm(direction)
    if sine < np.sin(np.radians(angle)):
        return []
    direction /= sine
    normals = np.array([first.normal, second.normal])
    apart = ((second.centre - first.centre) * second.normal).sum()
    foot = first.centre + np.linalg.lstsq(normals, np.array([0.0, apart]), rcond=None)[0]
    along = [_beside(points[patches[k].index], foot, direction, size / 2) for k in pair]
    rows = []
    for low, high, counts in _common_runs(along, size / CELLS_PER_SIZE):
        if high - low < size / 2 or min(counts) < support:
            continue
        ends = foot + np.array([[low], [high]]) * direction
        covariance = [_across(end, [patches[k] for k in pair], normals) for end in ends]
        opening = np.degrees(np.arcsin(min(sine, 1.0)))
        rows.append((ends, covariance, counts, opening, pair))
    return rows


def _beside(points, foot, direction, reach):
    """Stations along a line of the points within ``reach`` of it."""
    local = points - foot
    station = local @ direction
    across = local - station[:, None] * direction
    return station[(across**2).sum(axis=1) <= reach**2]


def _common_runs(along, cell):
    """Runs of bins where both sides have points: low, high and the numbers of points."""
    if not (len(along[0]) and len(along[1])):
        return
    low = max(side.min() for side in along)
    bins = int(np.ceil((min(side.max() for side in along) - low) / cell))
    if bins < 1:
        return
    edges = low + cell * np.arange(bins + 1)
    both = np.all([np.histogram(side, edges)[0] > 0 for side in along], axis=0)
    both[1:-1] |= both[:-2] & both[2:]
    change = np.flatnonzero(np.diff(np.r_[False, both, False].astype(int)))
    for start, stop in change.reshape(-1, 2):
        inside = [side[(side >= edges[start]) & (side <= edges[stop])] for side in along]
        ends = max(side.min() for side in inside), min(side.max() for side in inside)
        yield *ends, [len(side) for side in inside]


def _across(point, patches, normals):
    """Covariance (3, 3) of the line at a point on it, from the heights of both planes there."""
    variances = np.diag([patch.offset_variance(point) for patch in patches])
    solve = np.linalg.pinv(normals)
    return solve @ variances @ solve.T
