"""The nearest point in each of four quadrants: d1..d4 and f.

In Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 3.3, the sorted distances to the nearest
point in each of four quadrants show whether points lie evenly or in lines. Sorting loses the
directions, and so does f = d4/d1.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_number, check_positive, check_values
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points
from mmqa_lab.spacing.directions import (
    FEWEST_POINTS,
    DirectionalSpacing,
    directional,
    line_parts,
    table_of,
)
from mmqa_lab.spacing.neighbours import by_quadrant, nearest_by_sector, tree_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

__all__ = [
    "Spacing", "checked_spacing", "exempt", "poisson_spacing", "quadrant_distances", "quadrants",
    "turned_f",
]  # fmt: skip

FEW_FOR_SCIPY = 30_000
"""Most points that scipy searches in a process: to load the compiled search takes as long."""

_searched = [0]  # points so far


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
        table = table_of(["d1", "d2", "d3", "d4", "f"], [*self.d, self.f], self._bounds)
        return table.assign(n=[*self.counts, self.counts[-1]])

    to_frame = intervals


def quadrant_distances(
    xy: ArrayLike, *, radius: float = 0.5, angle: float = 0.0, of: ArrayLike | None = None
) -> np.ndarray:
    """Return the distance from each point to the nearest other point in each of four quadrants.

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
    """Return medians d1..d4 of the sorted quadrant distances, and their ratio f.

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
    """Return the expected d1..d4 of a homogeneous Poisson pattern.

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


def _turned(xy, angle):
    """``xy`` in axes turned by ``angle`` degrees; quarter turns give the same quadrants."""
    turn = np.radians(angle % 90)
    if turn == 0:
        return xy
    c, s = np.cos(turn), np.sin(turn)
    return (xy - xy.min(axis=0)) @ np.array([[c, -s], [s, c]])


def _nearest_per_quadrant(xy, radius, of):
    """The compiled search, or the search by scipy of the first points while numba is not imported.

    Both find the same distances, to the last bit.
    """
    _searched[0] += len(xy)
    if "numba" in sys.modules or _searched[0] > FEW_FOR_SCIPY:
        from mmqa_lab.spacing._search import nearest_per_quadrant

        return nearest_per_quadrant(xy, radius, of)
    places, place = np.unique(xy, axis=0, return_inverse=True)
    found = nearest_by_scipy(places, radius)[place]
    found[~of] = np.nan
    return found


def nearest_by_scipy(xy, radius):
    """Return the sorted distances to the nearest point in each quadrant, NaN last."""
    found = nearest_by_sector(xy, tree_of(xy), np.arange(len(xy)), radius, 16, 4, by_quadrant)
    return np.where(np.isinf(found), np.nan, found)
