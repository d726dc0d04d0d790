"""Spacing of points in a plane: quadrant distances, d1..d4, f, spacing by direction, g.

Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 3.3: the distances to the nearest point in
each of four quadrants, sorted, show whether points lie evenly or in lines. f = d4/d1 sorts them and
so forgets their directions. The *spacing ratio* g keeps them: the spacing across the direction in
which points lie closest, divided by the spacing along it.

:func:`quadrants` gives d1..d4 and f, :func:`directional` the spacing by direction and g, each with
95 % intervals; :func:`exempt` says where f does not matter.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_number, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.planes import flat_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "DirectionalSpacing",
    "Spacing",
    "directional",
    "exempt",
    "poisson_spacing",
    "quadrant_distances",
    "quadrants",
    "turned_f",
]
__dir__ = __all__.copy

_ONE_AT_A_TIME = threading.Lock()
"""Some of numba's threading layers stop the process when two threads enter them at once."""

STEP_DEG = 4.0
"""Distance between the directions that are tried."""

AT_ONCE = 1_000_000
"""Neighbours that are searched together: bounds the memory."""

SECTOR_STEPS = 15
"""Width of a sector in those steps: 60 degrees, a third of all directions."""

FEW = 50_000
"""Points that are searched without numba, whose import would take longest."""

MOST_PAIRS = 2_000_000
"""Pairs that are compared at once up to which that is so."""


@dataclass(frozen=True, eq=False)
class Spacing(Shown):
    """The typical point spacings of a pattern in the plane.

    Parameters
    ----------
    d : array, shape (4,), or as many as there are sectors
        Medians d1..d4 of the sorted quadrant distances, m; NaN where no point has a neighbour of
        that rank.
    counts : array of int, shape (4,)
        Points behind each median.
    incomplete_share : float
        Share of the points with at least one empty quadrant within the radius.
    coincident : int
        Points that share their place with another one.
    xy : array, shape (n, 2)
        The points, m.
    distances : array, shape (n, 4)
        The sorted quadrant distances of each point, NaN where a quadrant is empty, m.
    statistic : float
        The percentile that d is of the distances: 50 for medians.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> found = quadrants(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(6).tolist(), round(found.f, 6)
    ([0.02, 0.02, 0.04, 0.04], 2.0)
    """

    d: np.ndarray
    counts: np.ndarray
    incomplete_share: float
    coincident: int
    xy: np.ndarray = field(repr=False)
    distances: np.ndarray = field(repr=False)
    statistic: float = 50.0

    @property
    def n(self) -> int:
        """Points in all."""
        return len(self.xy)

    @property
    def f(self) -> float:
        """Inhomogeneity d4 / d1, equation (1); NaN where one of them is not measurable."""
        return float(self.d[-1] / self.d[0])

    @cached_property
    def intervals(self) -> np.ndarray:
        """95 % intervals of d1..d4 (m) and f, shape (5, 2), from 4 x 4 blocks of the points.

        See :func:`mmqa_lab.stats.median_interval`.
        """
        block, share = stats.blocks(self.xy), self.statistic / 100
        ranks = self.distances.T
        ends = [stats.median_interval(distances, block, share=share) for distances in ranks]
        ratio = stats.median_ratio_interval(ranks[-1], ranks[0], block, share=share)
        return np.array([*ends, ratio])

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the nearest and the farthest quadrant distances of all points, and their medians."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = subplots()[1] if ax is None else ax
        nearest, farthest = 1000 * self.distances[:, [0, -1]].T
        top = np.nanpercentile(farthest, 98) if np.isfinite(farthest).any() else np.nanmax(nearest)
        bins = np.linspace(0, 1.1 * top, 56)
        measure = "median" if self.statistic == 50 else f"{self.statistic:g} % quantile"
        for values, name, middle, colour in (
            (nearest, "d1", 1000 * self.d[0], "blue"),
            (farthest, f"d{len(self.d)}", 1000 * self.d[-1], "orange"),
        ):
            filled = {"color": COLOURS[colour], "alpha": 0.6, "histtype": "stepfilled"}
            ax.hist(values[np.isfinite(values)], bins=bins, **filled)
            ax.axvline(middle, color=COLOURS[colour], label=f"{measure} {name} = {middle:.1f} mm")
        ax.set(xlabel="distance to the next point (mm)", ylabel="points", xlim=(0, bins[-1]))
        ax.legend(loc="upper left", bbox_to_anchor=(0, 1.32), borderaxespad=0)
        return ax

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each of d1..d4 (mm) and f: value, 95 % interval and points."""
        values = np.column_stack([[*self.d, self.f], self.intervals])
        values[:-1] *= 1000
        table = pd.DataFrame(values, columns=["value", "low", "high"])
        ranks = len(self.d)
        table.insert(0, "figure", [*(f"d{k + 1}" for k in range(ranks)), "f"])
        return table.assign(unit=["mm"] * ranks + ["1"], n=[*self.counts, self.counts[-1]])


def quadrant_distances(
    xy: ArrayLike, *, radius: float = 0.5, angle: float = 0.0, of: ArrayLike | None = None
) -> np.ndarray:
    """Distance from each point to the nearest other one in each of four quadrants.

    The quadrants about a point are half open and share no place: [dx > 0, dy >= 0],
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
        Measure from these points only; the others are neighbours, and their rows NaN.

    Returns
    -------
    array, shape (n, 4)
        Metres, in each row ascending and NaN last: one NaN for each quadrant without a point
        within the radius. Rows are in the order of the points.

    Raises
    ------
    ValueError
        If there is no point, a coordinate is not finite, the radius is not positive, or ``of`` is
        not one truth value for each point.

    Notes
    -----
    Coincident points lie in none of each other's quadrants and count for nothing here. Distances
    depend on the axes: where these run along noisy scan lines, all four quadrants find neighbours
    on the point's own line, and the gap to the next line goes unseen.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> quadrant_distances([[0, 0], [0.3, 0], [0, 0.4], [-0.1, 0]])[0]
    array([0.1, 0.3, 0.4, nan])
    """
    xy = flat_points(xy)
    radius = check_positive(radius, "radius", unit="m")
    angle = check_number(angle, "angle", unit="degrees")
    _check_width(xy)
    of = np.ones(len(xy), dtype=bool) if of is None else np.asarray(of)
    if of.dtype != bool or of.shape != (len(xy),):
        raise ValueError(
            f"Invalid of, {of.dtype} of shape {of.shape}. Must be bool of shape ({len(xy)},)."
        )
    return _nearest_per_quadrant(_turned(xy, angle), radius, of)


def quadrants(
    xy: ArrayLike,
    *,
    radius: float = 0.5,
    angle: float = 0.0,
    sectors: int | str = 4,
    statistic: float = 50.0,
) -> Spacing:
    """Medians d1..d4 of the sorted quadrant distances, and their ratio f.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        Coordinates in the plane, metres.
    radius : float
        Neighbours up to this far count, m.
    angle : float
        Turns the axes of the quadrants counter-clockwise, degrees.
    sectors : int or str
        Equal sectors in place of the four quadrants, the first from the first axis on; "nearest 8"
        takes the 8 nearest points in any direction, "nearest" four. The source has quadrants only.
    statistic : float
        The percentile of the distances; 50 is the median, which the source has.

    Returns
    -------
    Spacing

    Raises
    ------
    ValueError
        As :func:`quadrant_distances`, or if there are not 4 to 36 sectors or nearest points, or no
        such percentile.

    Notes
    -----
    Each median is over the points that have a neighbour of that rank; points at the edge lack
    neighbours on one side. Repeated points leave d as it is and raise the density; see
    ``coincident``. f of a homogeneous random pattern is 3.257, see :func:`poisson_spacing`.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(9) * 0.02, np.arange(9) * 0.04)
    >>> found = quadrants(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> found.d.round(3), round(found.f, 3), round(found.incomplete_share, 2)
    (array([0.02, 0.02, 0.04, 0.04]), 2.0, 0.4)
    >>> quadrants([[0, 0], [0.02, 0], [0, 0.04], [0.06, 0]], sectors="nearest").distances[0]
    array([0.02, 0.04, 0.06,  nan])
    """
    xy = flat_points(xy)
    share = check_number(statistic, "statistic", low=0, high=100, unit="%") / 100
    if sectors == 4:
        distances = quadrant_distances(xy, radius=radius, angle=angle)
    else:
        radius = check_positive(radius, "radius", unit="m")
        distances = _sector_distances(xy, radius, check_number(angle, "angle"), sectors)
    known = ~np.isnan(distances)
    ranks = zip(distances.T, known.T, strict=True)
    return Spacing(
        d=np.array([_quantile(values[here], share) for values, here in ranks]),
        counts=known.sum(axis=0),
        incomplete_share=float(1 - known[:, -1].mean()),
        coincident=_count_coincident(xy),
        xy=xy,
        distances=distances,
        statistic=float(statistic),
    )


def exempt(d1: ArrayLike, d4: ArrayLike, rho0: float) -> np.ndarray:
    """Say where f does not matter, since the points are dense enough in both directions.

    Section 3.3 of the source exempts a surface from the threshold of f where d1 and d4 are both at
    most d0 = sqrt(1 / rho0), the linear point distance of the density that is asked for.

    Parameters
    ----------
    d1, d4 : array_like
        Smallest and largest median quadrant distance, m.
    rho0 : float
        Density that is asked for, points per m2.

    Returns
    -------
    array of bool
        A single one for numbers; False where d1 or d4 is not measurable.

    Raises
    ------
    ValueError
        If the density is not above zero.

    Notes
    -----
    A random pattern has d4 = 1.53 / sqrt(rho), so it is exempt from 2.34 rho0 on.

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

    The area pi r^2 / 4 of a quadrant out to its nearest point is exponential, so the k-th of the
    four sorted distances has the median d_k = sqrt(-4 ln(1 - q_k) / (pi density)), with q_k the
    median of the k-th of four uniform order statistics, Beta(k, 5 - k).

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
    d4 / d1 = 3.257 at every density, without edges and for a radius well above d4. A threshold of
    f <= 2 therefore asks for more regularity than chance gives.

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
    def direction_deg(self) -> float:
        """Direction along the scan lines: where points lie closest, 0 to 180 degrees.

        The phase of the second harmonic of log spacing, so that the whole turn has a say.
        """
        wave = np.exp(2j * np.radians(self.directions_deg))
        return float(np.degrees(np.angle(-np.log(self._filled()) @ wave)) / 2 % 180)

    @property
    def along(self) -> float:
        """Spacing along that direction."""
        return self.at(self.direction_deg)

    @property
    def across(self) -> float:
        """Spacing at a right angle to it; NaN when not measurable."""
        return self.at(self.direction_deg + 90)

    @property
    def g(self) -> float:
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

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the spacing (mm) over the direction, and the direction that was found."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        ax.plot(self.directions_deg, 1000 * self.spacing)
        ax.axvline(self.direction_deg, color="0.5", ls=":")
        ax.set(xlabel="direction (degrees)", ylabel="spacing (mm)", ylim=(0, None))
        return ax

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
    xy, found = flat_points(xy), []
    for angle in angles:
        distances = quadrant_distances(xy, radius=radius, angle=float(angle))
        first, last = (_quantile(d[~np.isnan(d)], 0.5) for d in distances[:, [0, 3]].T)
        found.append(last / first)
    return np.array(found)


def _count_coincident(xy):
    """Number of points that share their place with another one."""
    # numpy orders complex numbers by their real, then their imaginary part.
    places = np.sort(np.ascontiguousarray(xy).view(np.complex128).ravel())
    same = places[1:] == places[:-1]
    return int((np.append(same, False) | np.append(False, same)).sum())


def said_coincident(count, n):
    """A sentence on points that share their place with another one, "" without any."""
    return (
        f"{count} points ({100 * count / n:.3g} %) share their place with another: they raise the "
        "density."
        if count
        else ""
    )


def _check_width(xy):
    """Reject coordinates whose differences, squared, would overflow."""
    with np.errstate(over="ignore"):
        width = max(np.ptp(xy[:, 0]), np.ptp(xy[:, 1]))
    if width >= 1e150:
        raise ValueError(f"Invalid xy, {width:g} m wide. Must be less than 1e+150 m.")


def _turned(xy, angle):
    """``xy`` in axes turned by ``angle`` degrees; four quarter turns are the same quadrants."""
    turn = np.radians(angle % 90)
    if turn == 0:
        return xy
    c, s = np.cos(turn), np.sin(turn)
    return (xy - xy.min(axis=0)) @ np.array([[c, -s], [s, c]])


def _quantile(values, share):
    """Quantile, NaN of nothing."""
    if share == 0.5:
        return float(np.median(values)) if len(values) else np.nan
    return float(np.quantile(values, share)) if len(values) else np.nan


def _sector_distances(xy, radius, angle, sectors):
    """Sorted distances to the nearest point in each sector, or to the nearest of all; NaN last."""
    from scipy.spatial import cKDTree

    tree, (ranks, directed) = cKDTree(xy), _ranks(sectors)
    found, waiting = np.empty((len(xy), ranks)), _portions(np.arange(len(xy)), 4 * ranks)
    while waiting:
        rows, reach = waiting.pop()
        away, other = tree.query(xy[rows], k=np.arange(1, reach + 1))
        away[away > radius] = np.inf
        all_seen = np.isinf(away[:, -1])
        away[away == 0] = np.inf
        if directed:
            offset = xy[np.minimum(other, len(xy) - 1)] - xy[rows, None]
            away = _nearest_in_sectors(away, offset, angle, ranks)
        found[rows] = np.sort(away)[:, :ranks]
        waiting += _portions(rows[~all_seen & np.isinf(found[rows, -1])], 2 * reach)
    found[np.isinf(found)] = np.nan
    return found


def _ranks(sectors):
    """How many distances belong to a point, and whether each is that of a sector."""
    word, _, number = str(sectors).partition(" ")
    ranks = (number or "4") if word == "nearest" else word
    if not ranks.isdigit() or not 4 <= int(ranks) <= 36:
        raise ValueError(f"Invalid sectors {sectors!r}. Must be 4 to 36, or 'nearest 4' to 36.")
    return int(ranks), word != "nearest"


def _portions(rows, reach):
    """Rows whose ``reach`` nearest points fit into the memory together, and that number."""
    parts = np.array_split(rows, 1 + len(rows) * reach // AT_ONCE)
    return [(part, reach) for part in parts if len(part)]


def _nearest_in_sectors(away, offset, angle, sectors):
    """The least distance in each sector, shape (n, sectors)."""
    turn = np.arctan2(offset[..., 1], offset[..., 0]) / (2 * np.pi) - angle / 360
    sector = np.floor(turn * sectors) % sectors
    near = [np.where(sector == k, away, np.inf).min(axis=1) for k in range(sectors)]
    return np.column_stack(near)


def _directions():
    """The directions that are tried, degrees."""
    return np.arange(0, 180, STEP_DEG)


def _nearest_per_quadrant(xy, radius, of):
    """The compiled search, but for small clouds where numba is not imported yet."""
    if len(xy) <= FEW and "numba" not in sys.modules:
        found = _nearest_of_few(xy, radius, of)
        if found is not None:
            return found
    from mmqa_lab.spacing._search import nearest_per_quadrant

    with _ONE_AT_A_TIME:
        return nearest_per_quadrant(xy, radius, of)


def _nearest_of_few(xy, radius, of):
    """What the compiled search gives, bit for bit, from points sorted into square cells.

    None where that would take longer than importing numba.
    """
    cells = _Cells(xy)
    found = np.full((len(xy), 4), np.inf)
    for quadrant, towards in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        rows, reach = np.flatnonzero(of), 1
        while len(rows):
            first, count = cells.windows(rows, towards, reach)
            if count.sum() > MOST_PAIRS:
                return None
            best = _nearest_in_windows(xy, rows, cells.order, first, count, quadrant)
            found[rows, quadrant] = np.where(best <= radius, best, np.inf)
            # cells are rounded
            seen = (1 - 1e-9) * reach * cells.side
            open_ = np.minimum(best, radius) >= seen
            rows, reach = rows[open_ & (reach < cells.shape.max())], 2 * reach
    found[np.isinf(found)] = np.nan
    return np.sort(found, axis=1)


class _Cells:
    """Points sorted into square cells, two a cell on average."""

    def __init__(self, xy):
        extent, n = np.ptp(xy, axis=0), len(xy)
        self.side = max(np.sqrt(2 / n * extent[0]) * np.sqrt(extent[1]), extent.max() / n) or 1.0
        self.place = ((xy - xy.min(axis=0)) / self.side).astype(int)
        self.shape = self.place.max(axis=0) + 1
        cell = self.place @ [self.shape[1], 1]
        self.order = np.argsort(cell, kind="stable")
        self.starts = np.searchsorted(cell[self.order], np.arange(np.prod(self.shape) + 1))

    def windows(self, rows, towards, reach):
        """First point and number of points in each line of cells of a point's own quadrant."""
        i, j = self.place[rows].T
        lines = i[:, None] + towards[0] * np.arange(reach + 1)
        inside = (lines >= 0) & (lines < self.shape[0])
        ends = np.sort([j, j + towards[1] * reach], axis=0).clip(0, self.shape[1] - 1)
        at = np.where(inside, lines, 0) * self.shape[1]
        first, last = (self.starts[at + end[:, None]] for end in (ends[0], ends[1] + 1))
        return first, np.where(inside, last - first, 0)


def _nearest_in_windows(xy, rows, order, first, count, quadrant):
    """The nearest point to each row in one of its quadrants; each window has the row itself."""
    size, ends = count.sum(axis=1), np.cumsum(count)
    shift = np.repeat(first.ravel() - (ends - count.ravel()), count.ravel())
    offset = xy[order[np.arange(ends[-1]) + shift]] - np.repeat(xy[rows], size, axis=0)
    dx, dy = offset.T
    for _ in range(quadrant):  # turned back into the first quadrant
        dx, dy = dy, -dx
    distances = np.where((dx > 0) & (dy >= 0), np.sqrt(dx * dx + dy * dy), np.inf)
    return np.minimum.reduceat(distances, np.cumsum(size) - size)


def _nearest_by_sector(xy, radius):
    """The nearest distance of each point in each sector, infinite where not found.

    The search goes only as far as the medians: what lies beyond cannot change them.
    """
    from mmqa_lab.spacing._search import nearest_per_sector

    extent = np.ptp(xy, axis=0)
    limit = 3 * max(np.sqrt(np.prod(extent) / len(xy)), extent.max() / len(xy))
    while True:
        limit = min(limit, radius)
        nearest = nearest_per_sector(xy, limit, len(_directions()), SECTOR_STEPS)
        if limit == radius or (np.isfinite(nearest).mean(axis=0) > 0.5).all():
            return nearest
        limit *= 2
