"""Spacing of points in a plane: quadrant distances, d1..d4, f, spacing by direction, g.

In Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 3.3, the sorted distances to the nearest
point in each of four quadrants show whether points lie evenly or in lines. Sorting loses the
directions, and so does f = d4/d1. The *spacing ratio* g keeps them: it is the spacing across the
direction in which points lie closest, divided by the spacing along that direction. Both compare
spacings with each other. The *empty-space distance* e95 is a length of its own: 95 % of the places
of the surface lie within e95 of a point.

:func:`quadrants` gives d1..d4 and f, :func:`directional` the spacing by direction and g, each with
95 % confidence intervals. :func:`empty_space` gives e95 and the share of details of a size that
have points. :func:`exempt` tells where f does not matter.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_count, check_number, check_points, check_positive, check_values
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "DirectionalSpacing", "EmptySpace", "Spacing", "directional", "empty_space", "exempt",
    "poisson_spacing", "quadrant_distances", "quadrants", "turned_f",
]  # fmt: skip
__dir__ = __all__.copy

STEP_DEG = 4.0
"""Step between the directions that are tried, degrees."""

SECTOR_STEPS = 15
"""Width of a sector in steps of STEP_DEG: 60 degrees, a third of all directions."""

MOST_DIRECTED = 100_000
"""Most points whose spacing by direction is measured; with more points, a random choice of them."""

AT_ONCE = 1_000_000
"""Number of neighbours that are searched together; it limits the memory."""

FEW_FOR_SCIPY = 10_000
"""Most points that scipy searches while numba is not imported, which would take longer."""

PER_THREAD = 30_000
"""Number of points that a thread of scipy searches."""

CHANCE = 3.2
"""95 % of random patterns of n points have a g below 1 + CHANCE / sqrt(n)."""

FEWEST_POINTS = 50
"""Least number of points for an interval."""

EMPTY_PLACES = 10_000
"""Number of places of a surface from which points are sought; four times as many move e95 by 1 %
at most, on random points, lines and clusters."""

STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps from place to place as shares of the box of an outline: powers of the root of
x^3 = x + 1. They fill the box evenly and never in step with rows of points."""


@dataclass(frozen=True, eq=False)
class Spacing(Shown):
    """The typical point spacings of a pattern in the plane.

    Parameters
    ----------
    xy : array, shape (n, 2)
        The points, m.
    distances : array, shape (n, 4)
        The sorted quadrant distances of each point, NaN where a quadrant is empty, m.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> found = quadrants(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(6).tolist(), round(found.f, 6)
    ([0.02, 0.02, 0.04, 0.04], 2.0)
    """

    xy: np.ndarray
    distances: np.ndarray

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.xy)

    @cached_property
    def d(self) -> np.ndarray:
        """Medians d1..d4 of the distances, m; NaN if no point has a neighbour of that rank."""
        known = (values[~np.isnan(values)] for values in self.distances.T)
        return np.array([np.median(values) if len(values) else np.nan for values in known])

    @property
    def counts(self) -> np.ndarray:
        """Number of points in each median, shape (4,)."""
        return (~np.isnan(self.distances)).sum(axis=0)

    @property
    def incomplete_share(self) -> float:
        """Share of the points with at least one empty quadrant within the radius."""
        return float(np.isnan(self.distances[:, -1]).mean())

    @cached_property
    def coincident(self) -> int:
        """Number of points that share their place with another point."""
        x = np.sort(self.xy[:, 0])
        if (x[1:] > x[:-1]).all():  # the usual case, which takes a tenth of the time
            return 0
        # numpy orders complex numbers by their real, then their imaginary part
        places = np.sort(np.ascontiguousarray(self.xy).view(np.complex128).ravel())
        same = places[1:] == places[:-1]
        return int((np.append(same, False) | np.append(False, same)).sum())

    @property
    def f(self) -> float:
        """Inhomogeneity d4 / d1, equation (1); NaN if d1 or d4 is not measurable."""
        return float(self.d[-1] / self.d[0])

    @cached_property
    def directional(self) -> DirectionalSpacing:
        """The spacing by direction, with the ratio g."""
        return directional(self.xy)

    @cached_property
    def _bounds(self):
        """95 % confidence intervals of d1..d4 (m) and f, shape (5, 2)."""
        ends = [stats.median_interval(distances, self.parts) for distances in self.distances.T]
        nearest, farthest = self.distances.T[[0, -1]]
        return np.array([*ends, stats.median_ratio_interval(farthest, nearest, self.parts)])

    @cached_property
    def parts(self) -> np.ndarray:
        """Parts of the order of the points, for the intervals: :func:`line_parts`."""
        return line_parts(self.xy, self.directional if self.n >= FEWEST_POINTS else None)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the nearest and the farthest quadrant distances of all points, and their medians."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = subplots()[1] if ax is None else ax
        nearest, farthest = 1000 * self.distances[:, [0, -1]].T
        known = [some for one in (farthest, nearest) if len(some := one[np.isfinite(one)])]
        bins = np.linspace(0, 1.1 * np.percentile(known[0], 98) if known else 1, 56)
        for values, name, middle, colour in (
            (nearest, "$d_1$", 1000 * self.d[0], "blue"),
            (farthest, "$d_4$", 1000 * self.d[-1], "orange"),
        ):
            filled = {"color": COLOURS[colour], "alpha": 0.6, "histtype": "stepfilled"}
            ax.hist(values[np.isfinite(values)], bins=bins, **filled)
            ax.axvline(middle, color=COLOURS[colour], label=f"median {name} = {middle:.1f} mm")
        ax.set(xlabel="distance to the next point (mm)", ylabel="points", xlim=(0, bins[-1]))
        ax.legend(loc="upper left", bbox_to_anchor=(0, 1.32), borderaxespad=0)
        return ax

    def intervals(self) -> pd.DataFrame:
        """Return a row for each of d1..d4 (mm) and f: value, 95 % interval, number of points.

        Intervals allow for errors of whole scan lines if points lie in lines: :func:`line_parts`.
        """
        table = _table(["d1", "d2", "d3", "d4", "f"], [*self.d, self.f], self._bounds)
        return table.assign(n=[*self.counts, self.counts[-1]])

    to_frame = intervals


def quadrant_distances(
    xy: ArrayLike, *, radius: float = 0.5, angle: float = 0.0, of: ArrayLike | None = None
) -> np.ndarray:
    """Distance from each point to the nearest other point in each of four quadrants.

    The quadrants about a point are half open and do not overlap: [dx > 0, dy >= 0],
    [dx <= 0, dy > 0], [dx < 0, dy <= 0], [dx >= 0, dy < 0]. The search is exact.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres.
    radius : float
        Neighbours up to this far count, m.
    angle : float
        Turns the axes of the quadrants counter-clockwise, degrees.
    of : array_like of bool, shape (n,), optional
        Measure from these points only. All other points count as neighbours; their rows are NaN.

    Returns
    -------
    array, shape (n, 4)
        Metres, ascending in each row, NaN last. Each quadrant without a point within the radius
        gives a NaN. Rows are in the order of the points.

    Raises
    ------
    ValueError
        If there is no point, a coordinate is not finite, the radius is not positive, or ``of`` is
        not one truth value for each point.

    Notes
    -----
    A coincident point lies in no quadrant and does not count. Distances depend on the axes. If the
    axes run along noisy scan lines, all four quadrants find neighbours on the point's own line and
    miss the gap to the next line.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> quadrant_distances([[0, 0], [0.3, 0], [0, 0.4], [-0.1, 0]])[0]
    array([0.1, 0.3, 0.4, nan])
    """
    xy = flat_points(xy)
    of = np.asarray(np.ones(len(xy), dtype=bool) if of is None else of)
    if of.dtype != bool or of.shape != (len(xy),):
        raise ValueError(
            f"Invalid of, {of.dtype} of shape {of.shape}. Must be bool of shape ({len(xy)},)."
        )
    return checked_spacing(xy, radius, angle, of).distances


def checked_spacing(xy, radius, angle=0.0, of=None):
    """The Spacing of coordinates in a plane that are checked; NaN for points not asked for."""
    radius = check_positive(radius, "radius", unit="m")
    turned = _turned(xy, check_number(angle, "angle", unit="degrees"))
    of = np.ones(len(xy), dtype=bool) if of is None else of
    return Spacing(xy, _nearest_per_quadrant(turned, radius, of))


def quadrants(xy: ArrayLike, *, radius: float = 0.5, angle: float = 0.0) -> Spacing:
    """Medians d1..d4 of the sorted quadrant distances, and their ratio f.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres.
    radius : float
        Neighbours up to this far count, m.
    angle : float
        Turns the axes of the quadrants counter-clockwise, degrees.

    Returns
    -------
    Spacing

    Raises
    ------
    ValueError
        As for :func:`quadrant_distances`.

    See Also
    --------
    empty_space : from places of the surface instead of points; what a detail needs.
    directional : the spacing by direction, where points lie in lines.

    Notes
    -----
    Each median is over the points that have a neighbour of that rank. Points at the edge lack
    neighbours on one side. Repeated points do not change d, but increase the density; see
    ``coincident``. A homogeneous random pattern has f = 3.257; see :func:`poisson_spacing`.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(9) * 0.02, np.arange(9) * 0.04)
    >>> found = quadrants(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(3), round(found.f, 3), round(found.incomplete_share, 2)
    (array([0.02, 0.02, 0.04, 0.04]), 2.0, 0.4)
    """
    return checked_spacing(flat_points(xy), radius, angle)


def exempt(d1: ArrayLike, d4: ArrayLike, rho0: float) -> np.ndarray:
    """Return where f does not matter because the points are dense enough in both directions.

    Section 3.3 of the source exempts a surface from the threshold of f if d1 and d4 are both at
    most d0 = sqrt(1 / rho0), the linear point distance of the required density.

    Parameters
    ----------
    d1, d4 : array_like
        Smallest and largest median quadrant distance, m.
    rho0 : float
        Required density, points per m2.

    Returns
    -------
    array of bool
        A single value for numbers; False if d1 or d4 is not measurable.

    Raises
    ------
    ValueError
        If the density is not above zero.

    Notes
    -----
    A random pattern has d4 = 1.53 / sqrt(rho), so it is exempt if rho is at least 2.34 rho0.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> exempt([0.003, 0.010], [0.008, 0.025], 3000).tolist()  # C and B at 5 m, Table 2
    [True, False]
    """
    d0 = np.sqrt(1 / check_positive(rho0, "rho0", unit="points per m2"))
    return (np.asarray(d1) <= d0) & (np.asarray(d4) <= d0)


def poisson_spacing(density: float) -> np.ndarray:
    """Expected d1..d4 of a homogeneous Poisson pattern.

    The area pi r^2 / 4 of a quadrant out to its nearest point is exponentially distributed. So the
    k-th of the four sorted distances has the median d_k = sqrt(-4 ln(1 - q_k) / (pi density)). q_k
    is the median of the k-th of four uniform order statistics, Beta(k, 5 - k).

    Parameters
    ----------
    density : float
        Points per square metre.

    Returns
    -------
    array, shape (4,)
        Metres.

    Raises
    ------
    ValueError
        If the density is not positive.

    Notes
    -----
    d4 / d1 = 3.257 at every density, without edge effects and for a radius well above d4. So a
    threshold of f <= 2 requires more regularity than a random pattern has.

    Examples
    --------
    >>> d = poisson_spacing(2500)
    >>> (1000 * d).round(1), round(float(d[3] / d[0]), 3)
    (array([ 9.4, 15.8, 22. , 30.6]), 3.257)
    """
    from scipy.stats import beta

    density = check_positive(density, "density", unit="points per m2")
    k = np.arange(1, 5)
    return np.sqrt(-4 * np.log1p(-beta.median(k, 5 - k)) / (np.pi * density))


@dataclass(frozen=True, eq=False)
class DirectionalSpacing(Shown):
    """The spacing of a pattern by direction.

    Parameters
    ----------
    directions_deg : array, shape (45,)
        0, 4, ..., 176 degrees counter-clockwise from the first axis.
    spacing : array, shape (45,)
        Median distance to the nearest other point near the direction or its opposite, in the unit
        of the coordinates; NaN if fewer than half of the points have such a neighbour.
    xy : array, shape (n, 2)
        The points measured from: all without repeated places, at most 100,000.
    nearest : array, shape (n, 45)
        Distance of each point to the nearest other point by direction; infinite without neighbour.

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
        """Number of points measured from."""
        return len(self.xy)

    @cached_property
    def direction_deg(self) -> float:
        """Direction in which points lie closest, along the scan lines, 0 to 180 degrees.

        It is the phase of the second harmonic of log spacing, which uses all directions.
        """
        known = np.isfinite(self.spacing)
        largest = self.spacing[known].max(initial=0) or 1.0
        wave = np.exp(2j * np.radians(self.directions_deg))
        phase = np.angle(-np.log(np.where(known, self.spacing, 2 * largest)) @ wave)
        return float(np.degrees(phase) / 2 % 180)

    @property
    def along(self) -> float:
        """Spacing along ``direction_deg``, in the unit of the coordinates."""
        return self.at(self.direction_deg)

    @property
    def across(self) -> float:
        """Spacing at a right angle to ``direction_deg``; NaN if not measurable."""
        return self.at(self.direction_deg + 90)

    @property
    def g(self) -> float:
        """Spacing ratio across / along, independent of the axes; 1 without a direction."""
        return self.across / self.along

    @cached_property
    def _bounds(self):
        """95 % confidence intervals of along, across and g, shape (3, 2)."""
        block = line_parts(self.xy, self)
        places = (self.direction_deg + np.array([0, 90])) / STEP_DEG
        along, across = self.nearest[:, places.round().astype(int) % len(self.directions_deg)].T
        ends = [stats.median_interval(distances, block) for distances in (along, across)]
        found = np.array([*ends, stats.median_ratio_interval(across, along, block)])
        return np.where(np.isfinite(found), found, np.nan)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the spacing (mm) over the direction, and the direction that was found."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        ax.plot(self.directions_deg, 1000 * self.spacing)
        ax.axvline(self.direction_deg, color="0.5", ls=":")
        ax.set(xlabel="direction (degrees)", ylabel="spacing (mm)", ylim=(0, None))
        return ax

    def intervals(self) -> pd.DataFrame:
        """Return rows for along, across (mm) and g: value, 95 % interval, direction, n.

        The intervals hold for the direction found, and come from :func:`line_parts`.
        """
        values = [self.along, self.across, self.g]
        table = _table(["along", "across", "g"], values, self._bounds)
        return table.assign(direction_deg=self.direction_deg, n=self.n)

    to_frame = intervals

    def at(self, direction: float) -> float:
        """Spacing in a direction (degrees), interpolated between the directions tried."""
        return float(np.interp(direction, self.directions_deg, self.spacing, period=180))


def directional(xy: ArrayLike, *, radius: float = 0.5) -> DirectionalSpacing:
    """Median distance to the nearest point near each direction.

    Directions are 4 degrees apart. For each direction and each point the nearest other point within
    30 degrees of the direction or its opposite is found; the spacing is the median over the points.
    Unlike the quadrants of f, the sectors turn with the direction, and their distances are not
    sorted.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres; n >= 2.
    radius : float
        Neighbours up to this far count, m.

    Returns
    -------
    DirectionalSpacing
        With ``g``, ``direction_deg`` and the spacing by direction.

    Raises
    ------
    ValueError
        If there are fewer than two points or an argument is invalid.

    See Also
    --------
    quadrants : the published figures d1..d4 and f, in one system of axes.
    empty_space : the largest gaps, in whatever direction.

    Notes
    -----
    Since the direction is chosen from the pattern, random patterns of n points have a mean g of
    1 + 1.6 / sqrt(n). In 95 % of such patterns g is below 1 + 3.2 / sqrt(n) (simulated, n = 200 to
    10,000). The direction is accurate to about 2 degrees. Repeated points are counted once. Of more
    than 100,000 points a random choice of this number is measured, with all as neighbours. On scan
    lines blurred by more than their point spacing, the nearest point across lies on the same line.
    g then falls towards 1, since the pattern has no direction at that scale. Elongated clusters
    have their direction along their length.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(10) * 0.04)
    >>> found = directional(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.g, 3), round(abs(found.direction_deg - 90), 1)
    (4.0, 90.0)
    """
    xy = flat_points(xy, minimum=2)
    radius = check_positive(radius, "radius", unit="m")
    local = np.ascontiguousarray(xy - xy.mean(axis=0)).view(np.complex128)
    local = np.sort(local, axis=0)  # by x, then by y
    xy = local[np.append(True, local[1:] != local[:-1])].view(np.float64)
    directions = np.arange(0, 180, STEP_DEG)
    extent = np.ptp(xy, axis=0)
    limit = 3 * max(np.sqrt(np.prod(extent) / len(xy)), extent.max() / len(xy), 1e-9)
    rows = np.sort(np.random.default_rng(0).permutation(len(xy))[:MOST_DIRECTED])
    medians, reach, tree = np.array(np.inf), 16, _tree(xy)
    while np.isinf(medians).any():  # points beyond the medians cannot change them
        limit = min(limit, radius)
        nearest = _nearest(xy, tree, rows, limit, reach, len(directions), _by_direction)
        # faster than a median
        middle = np.sort(nearest.T)[:, [(len(rows) - 1) // 2, len(rows) // 2]]
        medians = middle.mean(axis=1)
        if limit == radius:
            break
        limit, reach = 2 * limit, 4 * reach
    spacing = np.where(np.isinf(medians), np.nan, medians)
    return DirectionalSpacing(directions, spacing, xy[rows], nearest)


@dataclass(frozen=True, eq=False)
class EmptySpace(Shown):
    """How far the places of a surface are from its points.

    Parameters
    ----------
    places : array, shape (m, 2)
        Places spread evenly over the surface, m.
    distances : array, shape (m,)
        From each place to its nearest point, or to the k-th nearest, m; infinite without one.
    border : array, shape (m,)
        From each place to the outline, m.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(50) * 0.02, np.arange(50) * 0.02)
    >>> found = empty_space(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> round(found.e95, 3), round(found.share(0.01), 2)  # pi / 4 of a square lie within
    (0.012, 0.78)
    """

    places: np.ndarray = field(repr=False)
    distances: np.ndarray = field(repr=False)
    border: np.ndarray = field(repr=False)

    _metres = ("e95",)
    _derived = ("e95",)

    @cached_property
    def _within(self):
        """The distances in order, and the share of places up to each (Kaplan and Meier)."""
        reach = np.minimum(self.distances, self.border)
        order = np.argsort(reach, kind="stable")
        known = (self.distances <= self.border)[order]
        return reach[order], 1 - np.cumprod(1 - known / np.arange(len(reach), 0, -1))

    @property
    def e95(self) -> float:
        """The distance within which 95 % of the places have a point, m; NaN if not measurable."""
        reach, share = self._within
        return float(np.append(reach, np.nan)[np.searchsorted(share, 0.95)])

    def share(self, distance: float) -> float:
        """Share of the places that have a point within a distance, m.

        Details of a diameter that show k points are the places whose k-th point is within half of
        it. NaN for a distance that no place is away from the outline.
        """
        reach, share = self._within
        if distance > self.border.max(initial=0):
            return np.nan
        return float(np.append(0, share)[np.searchsorted(reach, distance, "right")])


def empty_space(xy: ArrayLike, *, outline: object = None, rank: int = 1) -> EmptySpace:
    """Distances from the places of a surface to their nearest points: the empty-space function.

    While d1..d4, f and g start at points, these distances start at places with or without a point.
    So they tell how large a gap is, whatever the density.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres.
    outline : array_like of shape (m, 2), or shapely polygon, optional
        The surface, in the same coordinates; by default the convex hull of the points.
    rank : int
        Distances are to the nearest point (1), or to the point of this rank.

    Returns
    -------
    EmptySpace
        With ``e95`` and ``share``.

    Raises
    ------
    ValueError
        If there is no point, a coordinate is not finite, or ``rank`` is not a count.

    See Also
    --------
    quadrants : distances between points, by which f compares directions.

    Notes
    -----
    The nearest point of a place near the outline may lie beyond it. So a place counts up to its
    distance from the outline only (Kaplan-Meier estimator of Baddeley and Gill). Coincident points
    count each. e95 of random points is sqrt(ln 20 / (pi density)), 0.98 / sqrt(density).

    References
    ----------
    Diggle 2013, Statistical Analysis of Spatial and Spatio-Temporal Point Patterns, section 2.3;
    Illian et al. 2008, Statistical Analysis and Modelling of Spatial Point Patterns; Baddeley and
    Gill 1997, Annals of Statistics 25, 263-292, doi:10.1214/aos/1034276629.

    Examples
    --------
    >>> line = np.stack([np.arange(2000) * 0.001, np.zeros(2000)], axis=1)
    >>> xy = np.vstack([line + [0, 0.04 * k] for k in range(30)])  # lines 4 cm apart
    >>> round(empty_space(xy).e95, 3)  # 95 % of half the gap
    0.019
    """
    xy, rank = flat_points(xy), check_count(rank, "rank")
    if outline is None:
        outline = shapely.convex_hull(shapely.multipoints(xy))
    elif not isinstance(outline, shapely.Geometry):
        outline = shapely.Polygon(check_points(outline, name="outline", columns=2, minimum=3))
    low, high = np.reshape(outline.bounds, (2, 2))
    count = EMPTY_PLACES * min(100, np.prod(high - low) / max(outline.area, 1e-300))
    places = np.outer(np.arange(count if outline.area else 0), STEPS) % 1 * (high - low) + low
    places = places[shapely.contains_xy(outline, *places.T)]
    distances = _tree(xy - low).query(places - low, [rank])[0][:, 0]
    sides = shapely.transform(shapely.boundary(outline), lambda xy: xy - low)
    shapely.prepare(sides)
    return EmptySpace(places, distances, shapely.distance(sides, shapely.points(places - low)))


def block_numbers(xy: ArrayLike, *, side: int = 4) -> np.ndarray:
    """Number the points by the square blocks of a grid over them.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in a plane.
    side : int
        Blocks along each axis.

    Returns
    -------
    array of int, shape (n,)
        0 to side^2 - 1.

    Examples
    --------
    >>> block_numbers([[0, 0], [4, 0], [4, 4]], side=2).tolist()
    [0, 2, 3]
    """
    xy = np.asarray(xy, dtype=np.float64)
    low, extent = xy.min(axis=0), np.ptp(xy, axis=0)
    place = (xy - low) / np.where(extent > 0, extent, 1) * side
    column, row = np.minimum(place.astype(np.int64), side - 1).T
    return column * side + row


def line_parts(xy: ArrayLike, found: DirectionalSpacing | None = None) -> np.ndarray:
    """Return the parts of the points' order across and along the scan lines, for intervals.

    An error of a whole line, such as its distance from the next line, is common to all of its
    points. The waves follow the direction in which points lie closest. Without such a direction
    there are two pairs of waves, along the axes and at 45 degrees to them: the crossing lines of
    two scan heads on an upright board have no common direction.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in the plane, metres.
    found : DirectionalSpacing, optional
        Spacing by direction of these points, if known.

    Returns
    -------
    array of int, shape (2, n) or (4, n)
        See :func:`mmqa_lab.stats.order_parts`. A single block, so no interval, shape (n,), for
        fewer than 50 points or points at a single place.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(16) * 0.04)
    >>> line_parts(np.stack([x.ravel(), y.ravel()], axis=1)).shape
    (2, 640)
    """
    xy = np.asarray(xy, dtype=np.float64)
    if len(xy) < FEWEST_POINTS or not np.ptp(xy, axis=0).any():
        return np.zeros(len(xy), dtype=np.intp)
    found = directional(xy) if found is None else found
    if found.g > 1 + CHANCE / np.sqrt(found.n):
        return stats.order_parts(xy, found.direction_deg)
    return np.vstack([stats.order_parts(xy, 0), stats.order_parts(xy, 45)])


def turned_f(xy: ArrayLike, *, angles: ArrayLike, radius: float = 0.5) -> np.ndarray:
    """Return f = d4/d1 for axes turned by each of several angles.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Metres.
    angles : float or array_like, shape (k,)
        Degrees.
    radius : float
        Neighbours up to this far count, m.

    Returns
    -------
    array, shape (k,)
        f for each angle.

    Raises
    ------
    ValueError
        As for :func:`quadrant_distances`.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40) * 0.01, np.arange(10) * 0.04)
    >>> turned_f(np.stack([x.ravel(), y.ravel()], axis=1), angles=[10, 30]).round(2)
    array([4., 4.])
    """
    xy, angles = flat_points(xy), np.atleast_1d(check_values(angles, "angles"))
    return np.array([checked_spacing(xy, radius, float(angle)).f for angle in angles])


def _table(names, values, intervals):
    """Rows of figures with their intervals; all figures but the last are lengths."""
    numbers = np.column_stack([values, intervals])
    numbers[:-1] *= 1000
    table = pd.DataFrame(numbers, columns=["value", "low", "high"])
    table.insert(0, "figure", names)
    return table.assign(unit=["mm"] * (len(names) - 1) + ["1"])


def _turned(xy, angle):
    """``xy`` in axes turned by ``angle`` degrees; quarter turns give the same quadrants."""
    turn = np.radians(angle % 90)
    if turn == 0:
        return xy
    c, s = np.cos(turn), np.sin(turn)
    return (xy - xy.min(axis=0)) @ np.array([[c, -s], [s, c]])


def _nearest_per_quadrant(xy, radius, of):
    """The compiled search, or the search by scipy for few points while numba is not imported.

    Both find the same distances, to the last bit.
    """
    if "numba" in sys.modules or len(xy) > FEW_FOR_SCIPY:
        from mmqa_lab.spacing._search import nearest_per_quadrant

        return nearest_per_quadrant(xy, radius, of)
    places, place = np.unique(xy, axis=0, return_inverse=True)
    found = _nearest_by_scipy(places, radius)[place]
    found[~of] = np.nan
    return found


def _nearest_by_scipy(xy, radius):
    """Sorted distances to the nearest point in each quadrant, NaN last."""
    found = _nearest(xy, _tree(xy), np.arange(len(xy)), radius, 16, 4, _by_quadrant)
    return np.where(np.isinf(found), np.nan, found)


def _tree(xy):
    """A tree of points that is quickly made."""
    from scipy.spatial import cKDTree

    return cKDTree(xy, balanced_tree=False, compact_nodes=False)


def _nearest(xy, tree, rows, radius, reach, ranks, fold):
    """Return the result of ``fold`` for the neighbours of the points in rows, (len(rows), ranks).

    ``fold`` takes the distances of the k nearest points (rows, k), infinite beyond the radius and
    for the point itself, and their offsets x + iy (rows, k). If a result is infinite, ``fold`` is
    called again with more neighbours.
    """
    found = np.empty((len(rows), ranks))
    places = np.append(xy[:, 0] + 1j * xy[:, 1], np.inf)  # scipy gives the last if there is none
    waiting = _portions(np.arange(len(rows)), min(reach, len(xy)))
    while waiting:
        part, reach = waiting.pop()
        bound = radius * (1 + 1e-9)  # a little larger, since scipy compares squares
        choices = {"distance_upper_bound": bound, "workers": 1 + len(part) // PER_THREAD}
        _, other = tree.query(xy[rows[part]], np.arange(1, reach + 1), **choices)
        offset = places[other] - places[rows[part], None]
        away = np.sqrt(offset.real**2 + offset.imag**2)
        all_seen = np.isinf(away[:, -1]) | (reach == len(xy))
        away[(away > radius) | (away == 0)] = np.inf
        found[part] = fold(away, offset)
        is_open = ~all_seen & np.isinf(found[part]).any(axis=1)
        waiting += _portions(part[is_open], min(2 * reach, len(xy)))
    return found


def _portions(rows, reach):
    """Blocks of rows whose ``reach`` nearest points fit into memory, each with ``reach``."""
    parts = np.array_split(rows, 1 + len(rows) * reach // AT_ONCE)
    return [(part, reach) for part in parts if len(part)]


def _by_quadrant(away, offset):
    """The least distance in each quadrant, sorted; quadrants follow from exact signs."""
    dx, dy = offset.real, offset.imag
    place = np.where(dy > 0, dx <= 0, np.where(dy < 0, 2 + (dx >= 0), 2 * (dx < 0)))
    return np.sort(_least(away, place, 4), axis=1)


def _by_direction(away, offset):
    """The least distance within 30 degrees of each direction that is tried, either way."""
    count = round(180 / STEP_DEG)
    turn = np.angle(offset) / np.pi * count
    steps = _least(away, np.floor(turn + 0.5).astype(int) % count, count)
    half = SECTOR_STEPS // 2
    steps = np.concatenate([steps[:, -half:], steps, steps[:, :half]], axis=1)
    for shift in (1, 2, 4, 7):  # the least of 2, 4, 8 and 15 steps
        steps = np.minimum(steps[:, shift:], steps[:, :-shift])
    return steps


def _least(away, place, count):
    """The least distance of each row in each of ``count`` sectors; infinite in empty sectors."""
    found = np.full(len(away) * count, np.inf)
    first = count * np.arange(len(away))[:, None]
    np.minimum.at(found, (first + place).ravel(), away.ravel())
    return found.reshape(-1, count)
