"""Measures of the anisotropy of a point pattern in the plane.

f = d4/d1 (Pfeifer et al. 2021, doi 10.3390/rs13020237) sorts the distances of four quadrants and so
forgets their directions. Here are its values over a turn of the axes, measures from spatial
statistics, and the *spacing ratio* g, which keeps the directions: the spacing across the direction
in which points lie closest, divided by the spacing along it.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_count, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points
from mmqa_lab.spacing._quadrants import quadrants

STEP_DEG = 4.0
"""Distance between the directions that are tried."""

SECTOR_STEPS = 15
"""Width of a sector in those steps: 60 degrees, a third of all directions."""


@dataclass(frozen=True, eq=False)
class DirectionalSpacing(Shown):
    """The spacing of a pattern by direction.

    Parameters
    ----------
    directions_deg : array, shape (45,)
        0, 4, ..., 176 degrees counter-clockwise from the first axis.
    spacing : array, shape (45,)
        Median distance to the nearest other point near that direction, either way, in the unit of
        the coordinates; NaN where fewer than half of the points have one.
    xy : array, shape (n, 2)
        The points, each place once.
    nearest : array, shape (n, 45)
        Distance of each point to the nearest other one by direction, infinite where none is near.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(60) * 0.01, np.arange(15) * 0.04)
    >>> found = directional(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.along, 3), round(found.across, 3), round(found.g, 3)
    (0.01, 0.04, 4.0)
    """

    directions_deg: np.ndarray
    spacing: np.ndarray
    xy: np.ndarray = field(repr=False)
    nearest: np.ndarray = field(repr=False)

    @property
    def n(self) -> int:
        """Points in all."""
        return len(self.xy)

    @property
    def direction_deg(self):
        """Direction along the scan lines: where points lie closest, 0 to 180 degrees.

        The phase of the second harmonic of log spacing, so that the whole turn has a say.
        """
        wave = np.exp(2j * np.radians(self.directions_deg))
        return float(np.degrees(np.angle(-np.log(self._filled()) @ wave)) / 2 % 180)

    @property
    def along(self):
        """Spacing along that direction."""
        return self.at(self.direction_deg)

    @property
    def across(self):
        """Spacing at a right angle to it; NaN when not measurable."""
        return self.at(self.direction_deg + 90)

    @property
    def g(self):
        """Spacing ratio across / along: 1 without a direction; needs no axes."""
        return self.across / self.along

    @cached_property
    def intervals(self) -> np.ndarray:
        """95 % intervals of along, across and g, shape (3, 2), from 4 x 4 blocks of the points.

        For the direction that was found. See :func:`mmqa_lab.stats.median_interval`.
        """
        block = stats.blocks(self.xy)
        places = (self.direction_deg + np.array([0, 90])) / STEP_DEG
        along, across = self.nearest[:, places.round().astype(int) % len(self.directions_deg)].T
        ends = [stats.median_interval(distances, block) for distances in (along, across)]
        found = np.array([*ends, stats.median_ratio_interval(across, along, block)])
        return np.where(np.isfinite(found), found, np.nan)

    def to_frame(self) -> pd.DataFrame:
        """Return rows for along and across (mm) and g: value, 95 % interval, direction, points."""
        values = np.column_stack([[self.along, self.across, self.g], self.intervals])
        values[:2] *= 1000
        table = pd.DataFrame(values, columns=["value", "low", "high"])
        table.insert(0, "figure", ["along", "across", "g"])
        return table.assign(unit=["mm", "mm", "1"], direction_deg=self.direction_deg, n=self.n)

    def at(self, direction: float) -> float:
        """Spacing in a direction (degrees), between those tried."""
        return float(np.interp(direction, self.directions_deg, self.spacing, period=180))

    def _filled(self):
        """Spacing, twice the largest one where there is none."""
        known = np.isfinite(self.spacing)
        if not known.any():
            return np.ones(len(self.spacing))
        return np.where(known, self.spacing, 2 * np.nanmax(self.spacing))


def directional(xy: ArrayLike, *, radius: float = 0.5) -> DirectionalSpacing:
    """Median distance to the nearest point near each direction.

    For directions 4 degrees apart: from every point the nearest other one within 30 degrees of that
    direction or its opposite; then the median over the points. Unlike the quadrants of f, the
    sectors turn with the direction, and their distances are not sorted.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres; n >= 2.
    radius : float
        Neighbours up to this far count, m.

    Returns
    -------
    DirectionalSpacing
        ``g`` and ``direction_deg`` among others.

    Raises
    ------
    ValueError
        If there are fewer than two points or an argument is invalid.

    Notes
    -----
    Because the direction is sought, a random pattern of n points has g = 1 + 1.6 / sqrt(n) on
    average, and 95 % of them stay below 1 + 3.2 / sqrt(n) (simulated, n = 200 to 10,000). The
    direction is found to about 2 degrees. Repeated points are counted once. On scan lines blurred
    by more than their point spacing, the nearest point across lies on the same line: g falls
    towards 1, as the pattern has no direction at that scale. Elongated clusters have their
    direction along their length.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(10) * 0.04)
    >>> found = directional(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.g, 3), round(abs(found.direction_deg - 90), 1)
    (4.0, 90.0)
    """
    xy = flat_points(xy, minimum=2)
    radius = check_positive(radius, "radius", unit="m")
    xy = np.unique(xy - xy.mean(axis=0), axis=0)
    nearest = _nearest_by_sector(xy, radius)
    medians = np.median(nearest, axis=0)
    medians[np.isinf(medians)] = np.nan
    return DirectionalSpacing(_directions(), medians, xy, nearest)


def turned_f(xy: ArrayLike, *, angles: ArrayLike, radius: float = 0.5) -> np.ndarray:
    """Return f = d4/d1 for axes turned by each of ``angles`` (degrees), an array of that shape.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Metres.
    angles : array_like, shape (k,)
        Degrees.
    radius : float
        Of the search, m.

    Returns
    -------
    array, shape (k,)

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(10) * 0.04)
    >>> turned_f(np.stack([x.ravel(), y.ravel()], axis=1), angles=[10, 30]).round(2)
    array([4., 4.])
    """
    return np.array([quadrants(xy, radius=radius, angle=float(angle)).f for angle in angles])


def structure_tensor_ratio(xy: ArrayLike, *, k: int = 16) -> float:
    """Return the median over the points of sqrt(largest / smallest eigenvalue) of a neighbourhood.

    The eigenvalues are those of the scatter matrix of the k nearest points about each point.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Any unit, n >= 3.
    k : int
        Neighbours, 2 or more.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If there are fewer than three points or k is below two.

    Notes
    -----
    Random neighbourhoods are longer than wide: a Poisson pattern has about 1.5 for k = 16. On lines
    the k nearest points are all on one line and the ratio is infinite.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20), np.arange(20))
    >>> round(structure_tensor_ratio(np.stack([x.ravel(), y.ravel()], axis=1), k=8), 3)
    1.0
    """
    from scipy.spatial import cKDTree

    xy = flat_points(xy, minimum=3)
    k = check_count(k, "k", low=2)
    near = cKDTree(xy).query(xy, k=min(k + 1, len(xy)))[1][:, 1:]
    offsets = xy[near] - xy[:, None]
    scatter = np.einsum("nki,nkj->nij", offsets, offsets)
    smallest, largest = np.clip(np.linalg.eigvalsh(scatter), 0, None).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.sqrt(largest / smallest)))


def pair_contrast(xy: ArrayLike, *, reach: float) -> float:
    """Contrast of Ripley's K between the directions with most and fewest pairs: 0 none, 1 all.

    Counts the pairs of points up to ``reach`` apart within 45 degrees of a direction, N, and at a
    right angle to it, M: (N - M) / (N + M), for the direction of the second harmonic.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Metres.
    reach : float
        Largest distance of a pair, m.

    Returns
    -------
    float
        NaN without pairs.

    Raises
    ------
    ValueError
        If there are fewer than two points or the reach is not above zero.

    Notes
    -----
    Directional K without edge correction: a square window loses as many pairs in one direction as
    in the other. With a reach below the line spacing every line pattern has 1.

    References
    ----------
    Illian et al. 2008, section 4.5 (directional second-order characteristics).
    doi:10.1002/9780470725160

    Examples
    --------
    >>> pair_contrast([[0, 0], [0.1, 0], [0.2, 0]], reach=0.15)
    1.0
    """
    from scipy.spatial import cKDTree

    xy = flat_points(xy, minimum=2)
    reach = check_positive(reach, "reach", unit="m")
    first, second = cKDTree(xy).query_pairs(reach, output_type="ndarray").T
    if not len(first):
        return np.nan
    angle = np.arctan2(*(xy[second] - xy[first]).T[::-1])
    mean = np.angle(np.exp(2j * angle).sum()) / 2
    return float(np.mean(np.where(np.cos(2 * (angle - mean)) > 0, 1.0, -1.0)))


def clark_evans(xy: ArrayLike) -> float:
    """Clark and Evans's index: mean nearest distance over that of a random pattern.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Any unit, n >= 3, not on one line.

    Returns
    -------
    float
        1 for a random pattern, above for regular ones (2.149 on a hexagonal lattice), below for
        clusters. With Donnelly's correction for the edges of the points' convex hull.

    Raises
    ------
    ValueError
        If there are fewer than three points.

    Notes
    -----
    An index of regularity: it knows no direction.

    References
    ----------
    Clark and Evans 1954, Ecology 35, 445-453, doi:10.2307/1931034; Donnelly 1978.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50), np.arange(50))
    >>> round(clark_evans(np.stack([x.ravel(), y.ravel()], axis=1)), 1)
    2.0
    """
    from scipy.spatial import ConvexHull, cKDTree

    xy = flat_points(xy, minimum=3)
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    hull = ConvexHull(xy - xy.mean(axis=0))
    n, area, outline = len(xy), hull.volume, hull.area
    expected = 0.5 * np.sqrt(area / n) + (0.0514 + 0.041 / np.sqrt(n)) * outline / n
    return float(nearest.mean() / expected)


def _directions():
    """The directions that are tried, degrees."""
    return np.arange(0, 180, STEP_DEG)


def _nearest_by_sector(xy, radius):
    """The nearest distance of each point in each sector, infinite where not found.

    The search goes only as far as the medians: what lies beyond cannot change them.
    """
    from mmqa_lab.spacing._sectors import nearest_per_sector

    extent = np.ptp(xy, axis=0)
    limit = 3 * max(np.sqrt(np.prod(extent) / len(xy)), extent.max() / len(xy))
    while True:
        limit = min(limit, radius)
        nearest = nearest_per_sector(xy, limit, len(_directions()), SECTOR_STEPS)
        if limit == radius or (np.isfinite(nearest).mean(axis=0) > 0.5).all():
            return nearest
        limit *= 2
