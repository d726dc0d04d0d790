"""The point-distribution chart: quality figures of a selection of points.

The source is Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
Every figure has a 95 % confidence interval from the points, see :meth:`CloudQuality.intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike

from mmqa_lab import stats
from mmqa_lab._checks import check_choice, check_number, check_points, check_polygon, check_positive
from mmqa_lab._results import Shown, sentences
from mmqa_lab.planes import CONSISTENT_SCALE, Plane, checked_plane, sigma_mad
from mmqa_lab.spacing import (
    FEWEST_POINTS,
    DirectionalSpacing,
    EmptySpace,
    Spacing,
    block_numbers,
    checked_spacing,
    empty_space,
    exempt,
    line_parts,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CloudQuality", "chart_polygon", "evaluate_cloud", "inside_polygon"]
__dir__ = __all__.copy

UPRIGHT_COSINE = 0.7
"""A surface is upright if the cosine of its slope is smaller. Its default axes are horizontal."""

ALIKE = 1.1
"""Ratio of the two largest variances below which the principal axes have a random direction."""

FAR_QUANTILES = 3.0
"""Points farther than this many 90 % quantiles of all distances get a remark."""

PAIRS = 5.0
"""Points come in pairs if d2 / d1 is larger. It is 1.7 for random points and 2 on lines."""

COARSE_MM = 1e-3
"""Smaller steps of coordinates are never too coarse."""

FULL = 1.5
"""Ratio of a polygon's area to the hull of its points above which a remark is given."""

DUPLICATES = 0.001
"""Share of points in the place of another up to which they do not count for the density."""

BENT = 0.5
"""Share of the variance of the distances, explained by a surface of second degree, above which a
remark is given."""

MOST_DRAWN = 10_000
"""Most points that are drawn."""

GRID = (np.arange(100) + 0.5) / 100
"""Places along each side of an outline's box. Their number in a strip measures its area."""

CHART_MARGINS_M = (0.29, 0.094, 0.094, 0.094)
"""Lower, right, upper and left margins. They leave half a square metre of the random pattern of a
1 m x 1 m chart. The border (5 cm) and the plain squares (up to 25 cm above the lower edge) are 4 cm
away, more than twice the assumed error of a click. The paper prints neither size; the sizes come
from :func:`mmqa_lab.charts.point_chart`."""


@dataclass(frozen=True, eq=False)
class CloudQuality(Shown):
    """The quality figures of the points on a planar surface.

    Parameters
    ----------
    area_polygon_m2, area_hull_m2 : float
        Area of the selection polygon on the plane (NaN without a polygon), and area of the convex
        hull of the points in the plane.
    sigma_mad_mm : float
        Dispersion of the orthogonal distances from the plane.
    axes : str
        The axes of the quadrants.
    rho0_per_m2 : float
        Required density; NaN if not given.
    step_mm : float
        The step that coordinates were rounded to.
    remarks : tuple of str
        Warnings about the figures, for example on coordinates that are too coarse, coincident
        points or random axes.
    plane : Plane
        The regression plane of the points; its axes are those of the quadrants.
    spacing : Spacing
        Spacing of the points in the plane. Coordinates are along the axes from the plane's centre.
    outline : shapely geometry
        The polygon, or the hull without a polygon, in the same coordinates, m.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> quality = evaluate_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> round(quality.d1_mm, 6), round(quality.d4_mm, 6), round(quality.f, 6)
    (20.0, 40.0, 2.0)
    """

    area_polygon_m2: float
    area_hull_m2: float
    sigma_mad_mm: float
    axes: str
    rho0_per_m2: float
    step_mm: float
    remarks: tuple[str, ...]
    plane: Plane = field(repr=False)
    spacing: Spacing = field(repr=False)
    outline: object = field(repr=False)

    @property
    def n(self) -> int:
        """Number of points evaluated."""
        return self.spacing.n

    @property
    def xy(self) -> np.ndarray:
        """The points in the plane, shape (n, 2), m."""
        return self.spacing.xy

    @property
    def std_mm(self) -> float:
        """Standard deviation of the orthogonal distances from the plane, mm."""
        return 1000 * self.plane.std

    @property
    def d_mm(self) -> np.ndarray:
        """Medians of the sorted quadrant distances, shape (4,), mm; NaN if not measurable."""
        return 1000 * self.spacing.d

    @property
    def d1_mm(self) -> float:
        """Median distance to the nearest of the four quadrant neighbours, mm."""
        return float(self.d_mm[0])

    @property
    def d4_mm(self) -> float:
        """Median distance to the farthest of the four quadrant neighbours, mm."""
        return float(self.d_mm[3])

    @property
    def density_polygon_per_m2(self) -> float:
        """Points per square metre of the selection polygon (section 3.3)."""
        return self.n / self.area_polygon_m2

    @property
    def density_hull_per_m2(self) -> float:
        """Points per square metre of their convex hull (Appendix A)."""
        return self.n / self.area_hull_m2 if self.area_hull_m2 > 0 else np.nan

    @property
    def f(self) -> float:
        """Inhomogeneity d4 / d1; NaN if not measurable, or if d1 is below the coordinates' step."""
        return np.nan if is_below_step(self.d1_mm, self.step_mm) else self.spacing.f

    @property
    def f_exempt(self) -> bool | None:
        """Whether f does not matter (section 3.3), see :func:`mmqa_lab.spacing.exempt`.

        None if no density is required.
        """
        if np.isnan(self.rho0_per_m2):
            return None
        return bool(exempt(self.spacing.d[0], self.spacing.d[-1], self.rho0_per_m2))

    @property
    def directional(self) -> DirectionalSpacing:
        """The spacing by direction, with the ratio g."""
        return self.spacing.directional

    @property
    def g(self) -> float:
        """Spacing across the direction in which points lie closest, over that along it."""
        return self.directional.g

    @cached_property
    def empty_space(self) -> EmptySpace:
        """Distances from places within the outline to their nearest points."""
        return empty_space(self.xy, outline=self.outline)

    @property
    def e95_mm(self) -> float:
        """Empty-space distance: 95 % of the places within the outline have a point this near."""
        return 1000 * self.empty_space.e95

    def details(self, size: float, *, points: int = 3) -> tuple[float, np.ndarray]:
        """Return the share of places that would show a detail of a size, and those that would not.

        Parameters
        ----------
        size : float
            Diameter of the detail, m.
        points : int
            A detail is shown by so many points or more.

        Returns
        -------
        share : float
            Of the places where the detail lies within the outline; NaN if there are none.
        missed : array, shape (m, 2)
            Places that would not show it, along the axes of the quadrants, m.

        Raises
        ------
        ValueError
            If ``size`` is not above zero or ``points`` is not a count.

        Examples
        --------
        >>> x, y = np.meshgrid(np.arange(40) * 0.005, np.arange(9) * 0.06)
        >>> quality = evaluate_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
        >>> share, missed = quality.details(0.05)  # lines 6 cm apart
        >>> round(share, 1), missed.shape[1]
        (0.8, 2)
        """
        reach = check_positive(size, "size", unit="m") / 2
        found = empty_space(self.xy, outline=self.outline, rank=points)
        missed = (found.distances > reach) & (found.border >= reach)
        return found.share(reach), found.places[missed]

    def intervals(self) -> pd.DataFrame:
        """Return every figure with its 95 % confidence interval.

        Returns
        -------
        DataFrame
            ``figure``, ``value``, ``low``, ``high``, ``unit``. NaN if not measurable. Fewer than
            50 points give no interval. Neither do d1..d4 and f along axes that are by chance, nor
            e95.

        Notes
        -----
        These are confidence intervals of the mean over scans with the same mean pattern. The figure
        of another scan has its own error and lies inside in about 83 % of cases. Points of the same
        scan line share errors. So the intervals follow from slow waves across and along the lines
        (:func:`mmqa_lab.spacing.line_parts`). sigma_MAD, d1..d4 and the two spacings of g are
        medians (:func:`mmqa_lab.stats.median_interval`). f and g are ratios of two medians
        (:func:`mmqa_lab.stats.median_ratio_interval`). The density and the variance of std are
        means. The operator's error is not included, see
        :func:`mmqa_lab.repeatability.repeatability`.

        Some intervals are too wide. The density of points on lines hardly varies between scans,
        because the errors of neighbouring lines cancel. Slow waves show only a part of this, so the
        interval of the density is several times too wide. Without a direction of lines, the wider
        of two intervals is given (about a third too wide for random points), and the direction of
        g is chosen from the points. This narrows the distribution of g, but not its interval.

        Examples
        --------
        >>> points = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * [2, 1, 0.01]
        >>> table = evaluate_cloud(points).intervals().set_index("figure")
        >>> table.index.tolist()
        ['density', 'std', 'sigma_mad', 'd1', 'd2', 'd3', 'd4', 'f', 'g', 'e95']
        >>> table = table.dropna()
        >>> bool((table["low"] < table["value"]).all() and (table["value"] < table["high"]).all())
        True
        """
        block, residuals_mm = self.spacing.parts, 1000 * self.plane.residuals
        off = np.abs(residuals_mm - np.median(residuals_mm))
        factor = self.sigma_mad_mm / max(np.median(off), 1e-300)
        ends = np.multiply(factor, stats.median_interval(off, block))
        reach = stats.mean_reach(residuals_mm**2, block)
        variances = np.clip(self.std_mm**2 + np.array([-reach, reach]), 0, None)
        rows = [
            ("density", *self._density_interval(), "points/m2"),
            ("std", self.std_mm, *np.sqrt(variances), "mm"),
            ("sigma_mad", self.sigma_mad_mm, *ends, "mm"),
        ]
        names = ["figure", "value", "low", "high", "unit"]
        empty = pd.DataFrame([("e95", self.e95_mm, np.nan, np.nan, "mm")], columns=names)
        spacing = self.spacing.intervals()
        if _by_chance(self.xy, self.axes):
            spacing[["low", "high"]] = np.nan
        spacing.loc[spacing["figure"] == "f", "value"] = self.f
        spacing.loc[spacing["value"].isna(), ["low", "high"]] = np.nan
        parts = [spacing, self.directional.intervals().iloc[2:], empty]
        parts = [pd.DataFrame(rows, columns=names), *(part[names] for part in parts)]
        return pd.concat(parts, ignore_index=True)

    def to_frame(self) -> pd.DataFrame:
        """Return a row with every figure; the names of its columns end with the units."""
        first = ("n", "area_polygon_m2", "area_hull_m2", "density_polygon_per_m2")
        first += ("density_hull_per_m2", "std_mm", "sigma_mad_mm")
        row = {name: getattr(self, name) for name in first}
        row |= {f"d{k}_mm": d for k, d in enumerate(self.d_mm, 1)}
        row |= {"f": self.f, "f_exempt": self.f_exempt, "g": self.g, "e95_mm": self.e95_mm}
        row |= {name: getattr(self.spacing, name) for name in ("incomplete_share", "coincident")}
        return pd.DataFrame([row | {"axes": self.axes, "remarks": " ".join(self.remarks)}])

    def plot(self, frame: Plane | None = None, *, detail: float | None = None) -> Figure:
        """Draw the points and the outline, their distances from the plane, and both histograms.

        At most 10,000 points are drawn; the histograms are of all points.

        Parameters
        ----------
        frame : Plane, optional
            The picture is along the axes of this plane and counts from its centre, by default
            along the axes of the quadrants.
        detail : float, optional
            Mark the places that would not show a detail of this size, m, by three points.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from mmqa_lab import plots

        figure, axes = plots.subplots(2, 2, width="double", height_mm=130)
        step, limit = 1 + self.n // MOST_DRAWN, 3 * self.sigma_mad_mm
        ring = shapely.get_coordinates(shapely.boundary(self.outline))
        missed = np.empty((0, 2)) if detail is None else self.details(detail)[1]
        xy, ring, missed = (
            (frame or self.plane).project(self.plane.centre + flat @ self.plane.axes)
            for flat in (self.xy[::step], ring, missed)
        )
        plots.draw_points(xy, ax=axes[0, 0])
        axes[0, 0].plot(*missed.T, ".", ms=2, mew=0, color=plots.COLOURS["vermilion"])
        axes[0, 0].plot(*ring.T, color=plots.COLOURS["green"])
        shades = {"vmin": -limit, "vmax": limit, "cmap": plots.DIVERGING_MAP}
        residuals_mm = 1000 * self.plane.residuals[::step]
        dots = plots.draw_points(xy, ax=axes[0, 1], c=residuals_mm, **shades)
        figure.colorbar(dots, ax=axes[0, 1], label="distance from plane (mm)", shrink=0.85)
        self.draw_histograms(*axes[1])
        return figure

    def draw_histograms(self, spacings: Axes, residuals: Axes) -> None:
        """Draw two histograms on two matplotlib Axes.

        Parameters
        ----------
        spacings : Axes
            For the nearest and the farthest quadrant distance of each point, with d1, d4 and e95.
        residuals : Axes
            For the distances from the plane, with std and sigma_MAD on both sides of zero.
        """
        from mmqa_lab.plots import COLOURS

        self.spacing.plot(ax=spacings)
        e95 = {"color": COLOURS["black"], "ls": ":", "label": f"$e_{{95}}$ = {self.e95_mm:.1f} mm"}
        spacings.axvline(self.e95_mm, **e95)
        spacings.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
        half = max(4 * self.sigma_mad_mm, 0.5)
        shown = np.clip(1000 * self.plane.residuals, -half, half)
        residuals.hist(shown, bins=61, color=COLOURS["sky"], histtype="stepfilled")
        for value, name, colour, dash in (
            (self.std_mm, "std", "vermilion", "-"),
            (self.sigma_mad_mm, r"$\sigma_\mathrm{MAD}$", "black", "--"),
        ):
            label = f"±{name} = {value:.1f} mm"
            residuals.axvline(-value, color=COLOURS[colour], ls=dash)
            residuals.axvline(value, color=COLOURS[colour], ls=dash, label=label)
        residuals.set(xlabel="distance from plane (mm)", ylabel="points", xlim=(-half, half))
        residuals.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)

    def _repr_html_(self):
        return self.intervals().to_html(index=False, float_format="{:.4g}".format)

    def _density_interval(self):
        """Density in the outline and its interval."""
        density = self.n / self.outline.area if self.outline.area else np.nan
        if np.isnan(density) or self.n < FEWEST_POINTS:
            return density, np.nan, np.nan
        low, high = np.reshape(self.outline.bounds, (2, 2))
        x, y = np.meshgrid(*(low + (high - low) * GRID[:, None]).T)
        places = np.column_stack([x.ravel(), y.ravel()])
        places = places[shapely.contains_xy(self.outline, *places.T)]
        block = line_parts(np.vstack([self.xy, places]), self.directional)
        # a point counts 1, a place of the grid minus the points expected per place
        expected = np.full(len(places), self.n / len(places))
        signs = np.concatenate([np.ones(self.n), -expected])
        reach = stats.mean_reach(signs, block) * len(signs) / self.outline.area
        return density, max(density - reach, 0.0), density + reach


def evaluate_cloud(
    points: ArrayLike,
    *,
    polygon: ArrayLike | None = None,
    thickness: float = 0.1,
    axes: str | float | None = None,
    radius: float = 0.5,
    scale: float = CONSISTENT_SCALE,
    rho0: float | None = None,
) -> CloudQuality:
    """Evaluate the points on a planar surface.

    A regression plane is fitted to the selected points by orthogonal distances. Its residuals give
    std and sigma_MAD. In the plane, the distances to the nearest point in each of four quadrants
    are sorted for each point. The medians of the sorted distances are d1..d4.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        The cloud, m; three points or more after selection.
    polygon : array_like, shape (m, 3), optional
        Outline of the selection, m, see :func:`inside_polygon`; by default all points are selected.
    thickness : float
        Largest distance of selected points from the polygon's plane, m.
    axes : {"principal", "horizontal"} or float, optional
        Axes of the quadrants. ``"principal"`` takes the principal axes of the selected points.
        ``"horizontal"`` takes the horizontal line and the line of greatest slope of the plane. A
        number turns the principal axes by this angle in degrees. By default horizontal on surfaces
        steeper than 45 degrees, otherwise principal.
    radius : float
        Largest distance of a neighbour, m.
    scale : float
        Factor of sigma_MAD, see :func:`mmqa_lab.planes.sigma_mad`.
    rho0 : float, optional
        Required density, points per m2. If d1 and d4 are both at most sqrt(1 / rho0), f does not
        matter (``f_exempt``).

    Returns
    -------
    CloudQuality

    Raises
    ------
    ValueError
        If fewer than three points are selected, if they lie on a line, or if an argument is
        invalid.

    See Also
    --------
    mmqa_lab.repeatability.evaluate_selections : the same for many polygons.
    mmqa_lab.maps.map_cloud : the same figures in cells of a whole cloud.

    Notes
    -----
    A remark is given if the step of the coordinates is larger than sigma_MAD or than a fifth of d1.
    The step is the ``resolution`` of the cloud, or a larger step of which all coordinates are
    multiples, from 1 mm to 0.1 m.

    The principal axes of a nearly square selection have a random direction (a remark states this).
    f depends on the axes: scan lines along an axis and oblique scan lines give different f.
    A homogeneous random pattern has f = 3.257 at every density. The criterion f < 2 therefore
    requires a more regular pattern. The hull is smaller than the surface by about (8/3) ln(n)/n for
    a square, so its density is too high. The medians are of all distances, whereas the histograms
    of Appendix A end at 0.3 m and have bins of 5 mm.

    References
    ----------
    Pfeifer et al. 2021, sections 3.3, 4.2, Appendix A. doi:10.3390/rs13020237

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> quality = evaluate_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> quality.n, round(quality.d1_mm), round(quality.d4_mm), round(quality.f, 1)
    (200, 20, 40, 2.0)
    """
    resolution = getattr(points, "resolution", np.nan)
    points = check_points(points, minimum=3)
    rho0 = np.nan if rho0 is None else check_positive(rho0, "rho0", unit="points per m2")
    if polygon is not None:
        polygon, inside, surface = _selected(points, polygon, thickness)
        if inside.sum() < 3:
            away = np.linalg.norm(points - surface.centre, axis=1).min()
            raise ValueError(
                f"Invalid points inside the polygon: {inside.sum()} given. Must be 3 or more. The "
                f"nearest point of the cloud is {away:.3g} m from its centre."
            )
        points = points[inside]
    plane = checked_plane(points)
    if axes is None:
        axes = "horizontal" if abs(plane.normal[2]) < UPRIGHT_COSINE else "principal"
    framed = replace(plane, axes=_directions(plane, axes))
    xy = framed.project(points)
    gaps = checked_spacing(xy, radius)
    hull = shapely.convex_hull(shapely.linestrings(xy))
    outline = hull if polygon is None else _outline(polygon, framed, surface.normal)
    sigma_mad_mm = 1000 * sigma_mad(plane.residuals, scale)
    step_mm = 1000 * np.fmax.reduce([resolution, _step(points), np.spacing(np.abs(points).max())])
    remarks = _remarks_on_points(gaps, step_mm, sigma_mad_mm, hull.area, outline.area, axes)
    remarks += tuple(_remark_on_layers(1000 * plane.residuals, step_mm))
    remarks += tuple(_remark_on_form(xy, 1000 * plane.residuals, step_mm, scale))
    return CloudQuality(
        area_polygon_m2=np.nan if polygon is None else outline.area,
        area_hull_m2=float(hull.area),
        sigma_mad_mm=sigma_mad_mm,
        axes=axes if isinstance(axes, str) else f"principal + {float(axes):g} degrees",
        rho0_per_m2=rho0,
        step_mm=step_mm,
        remarks=remarks,
        plane=framed,
        spacing=gaps,
        outline=outline,
    )


def inside_polygon(points: ArrayLike, polygon: ArrayLike, *, thickness: float = 0.1) -> np.ndarray:
    """Return the mask of the points inside a 3-D polygon's projection and near its plane.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        The cloud, m.
    polygon : array_like, shape (m, 3)
        Vertices in order, m; convex or concave.
    thickness : float
        Largest distance from the polygon's plane on either side, m.

    Returns
    -------
    array of bool, shape (n,)

    Raises
    ------
    ValueError
        If the polygon has fewer than three vertices, crosses itself or has no area, or if a vertex
        is farther than half of ``thickness`` from the plane of all: points near it would be missed.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> inside_polygon([[0.5, 0.5, 0.01], [0.5, 0.5, 0.2], [2, 0, 0]], square).tolist()
    [True, False, False]
    """
    points = check_points(points, minimum=0)
    return _selected(points, polygon, thickness)[1]


def chart_polygon(
    corners: ArrayLike, *, margins: float | tuple[float, ...] = CHART_MARGINS_M
) -> np.ndarray:
    """Return the outline of a chart's evaluated part from its four surveyed corners.

    Parameters
    ----------
    corners : array_like, shape (4, 3)
        Corners in order around the chart, from the lower left corner, m.
    margins : float or sequence of four
        Widths of the margins at the lower, right, upper and left edge, m. The default margins leave
        half a square metre of the random pattern of a 1 m chart, without the border and the plain
        squares in the lower part (section 3.3).

    Returns
    -------
    array, shape (4, 3)
        Corners of the outline in the same order, m.

    Raises
    ------
    ValueError
        If there are not four corners, or if the margins are negative or leave no area.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> chart_polygon([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], margins=0.25).tolist()[0]
    [0.25, 0.0, 0.25]
    """
    corners = check_polygon(corners, name="corners")
    if len(corners) != 4:
        raise ValueError(f"Invalid corners: {len(corners)} given. Must be four.")
    low, right, high, left = np.broadcast_to(np.asarray(margins, dtype=np.float64), 4)
    a, b, c, d = corners
    width, height = np.linalg.norm(b - a), np.linalg.norm(d - a)
    if left + right >= width or low + high >= height or np.min(margins) < 0:
        raise ValueError(f"Invalid margins {margins}. Must be >= 0 m and leave some of the chart.")
    u = np.array([left, width - right, width - right, left])[:, None] / width
    v = np.array([low, low, height - high, height - high])[:, None] / height
    return a + (b - a) * u * (1 - v) + (d - a) * v * (1 - u) + (c - a) * u * v


def _directions(plane, axes):
    """The axes of the quadrants, shape (2, 3)."""
    if not isinstance(axes, str):
        turn = np.radians(check_number(axes, "axes", unit="degrees"))
        return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ plane.axes
    check_choice(axes, "axes", ("principal", "horizontal"))
    return plane.axes if axes == "principal" else plane.horizontal_axes()


def _remarks_on_points(gaps, step_mm, sigma_mm, hull_m2, outline_m2, axes):
    """Remarks on figures that these points cannot give or give wrongly."""
    d1_mm, d2_mm = 1000 * gaps.d[:2]
    away = np.hypot(*(gaps.xy - np.median(gaps.xy, axis=0)).T)
    far = away > FAR_QUANTILES * np.quantile(away, 0.9)
    coarse = [f"sigma_MAD {sigma_mm:.3g} mm"] * int(step_mm > sigma_mm)
    coarse += [f"d1 {d1_mm:.3g} mm"] * int(step_mm > d1_mm / 5)
    return sentences(
        (
            step_mm > COARSE_MM and coarse,
            f"Coordinates are in steps of {step_mm:.3g} mm: too coarse for {' and '.join(coarse)}.",
        ),
        (
            is_below_step(d1_mm, step_mm),
            "f is not measured: points lie nearer to each other than the steps of coordinates.",
        ),
        (
            far.any(),
            f"{far.sum()} points lie far from the others, up to {away.max():.4g} m: they widen the "
            "hull, which lowers its density, and turn the plane.",
        ),
        (
            gaps.incomplete_share == 1,
            "No point has neighbours in all four quadrants within the search radius: d4 and f are "
            "not measured.",
        ),
        (
            gaps.coincident > 0,
            f"{gaps.coincident} points ({100 * gaps.coincident / gaps.n:.3g} %) share their place "
            "with another"
            + (": they raise the density." if gaps.coincident > DUPLICATES * gaps.n else "."),
        ),
        (
            d2_mm > PAIRS * d1_mm,
            lambda: (
                f"d2 is {d2_mm / d1_mm:.0f} times d1: points come in pairs, as from two returns of "
                "a pulse or from a repeated scan; density and f count both."
            ),
        ),
        (gaps.n < FEWEST_POINTS, f"Fewer than {FEWEST_POINTS} points: no confidence intervals."),
        (
            _by_chance(gaps.xy, axes),
            "Points spread alike in all directions: principal axes, and f, are by chance. So d1 to "
            "d4 and f have no intervals.",
        ),
        (
            outline_m2 > FULL * hull_m2,
            lambda: (
                f"Points lie on {100 * hull_m2 / outline_m2:.0f} % of the polygon: its density "
                "counts the rest too."
            ),
        ),
    )


def is_below_step(d1_mm: ArrayLike, step_mm: float) -> np.ndarray:
    """Return whether a spacing is due to rounding alone: points in a grid of steps lie farther.

    Examples
    --------
    >>> is_below_step([0.1, 9.0], 10.0).tolist()
    [True, False]
    """
    return np.multiply(2, d1_mm) < step_mm


def _by_chance(xy, axes):
    """Whether the axes of the quadrants follow from points that spread alike everywhere."""
    narrow, wide = np.linalg.eigvalsh(np.cov(xy.T))
    return axes != "horizontal" and wide < ALIKE * narrow


def _remark_on_form(xy, residuals_mm, step_mm, scale):
    """A remark if the form of a surface, bent or stepped, is most of its distances from a plane."""
    if len(xy) < FEWEST_POINTS or np.std(residuals_mm) < max(step_mm / 4, COARSE_MM):
        return []
    x, y = (xy / np.abs(xy).max()).T
    terms = np.array([np.ones_like(x), x, y, x * x, x * y, y * y])
    rest = residuals_mm - np.linalg.pinv(terms @ terms.T) @ (terms @ residuals_mm) @ terms
    share = 1 - np.var(rest) / np.var(residuals_mm)
    if share >= BENT:
        return [
            f"The surface is bent: its form is {100 * share:.0f} % of the variance of the "
            f"distances. Without it sigma_MAD is {sigma_mad(rest, scale):.1f} mm."
        ]
    block = block_numbers(xy, side=int(min(8, (len(xy) / 8) ** 0.5)))
    counts = np.maximum(np.bincount(block), 1)
    within = residuals_mm - (np.bincount(block, residuals_mm) / counts)[block]
    # the means of the blocks take a part of the noise
    noise_mm = sigma_mad(within, scale) * (len(xy) / (len(xy) - len(counts))) ** 0.5
    all_mm = sigma_mad(residuals_mm, scale)
    # of few points a median halves by chance, so the variance without outliers must agree
    form = np.bincount(block, np.clip(residuals_mm, -3 * all_mm, 3 * all_mm)) / counts
    if noise_mm**2 > (1 - BENT) * all_mm**2 or np.var(form[block]) < BENT / 2 * all_mm**2:
        return []
    return [
        "The surface is stepped or uneven: most of its distances from the plane are its form. "
        f"Within {len(counts)} blocks sigma_MAD is {noise_mm:.1f} mm."
    ]


def _remark_on_layers(residuals_mm, step_mm):
    """A remark if the distances from the plane have two peaks, so they are not noise alone."""
    low, high = np.quantile(residuals_mm, [0.005, 0.995])
    width = max(np.std(residuals_mm) / 4, 1.5 * step_mm)
    if len(residuals_mm) < 100 or not high - low > 4 * width:
        return []
    counts, edges = np.histogram(residuals_mm, np.arange(low, high + width, width))
    before, after = np.maximum.accumulate(counts), np.maximum.accumulate(counts[::-1])[::-1]
    lower = np.minimum(before, after)
    k = np.argmax(lower - counts)
    if 2 * counts[k] > lower[k] or lower[k] < 0.05 * len(residuals_mm):
        return []
    peaks = [edges[np.argmax(counts[:k])], edges[k + np.argmax(counts[k:])]]
    a, b = np.add(peaks, width / 2)
    return [f"Distances from the plane have two layers, {a:.0f} and {b:.0f} mm: not noise alone."]


def _step(points):
    """The coarsest step, m, of which all coordinates are multiples; NaN without such a step."""
    local = points[:: 1 + len(points) // 1000] - points[0]
    steps = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
    places = (local / step for step in steps)
    fits = [np.abs(place - np.round(place)).max() < 1e-4 for place in places]
    return max(np.compress(fits, steps), default=np.nan) if len(points) > 10 else np.nan


def _selected(points, polygon, thickness):
    """The vertices of a polygon, the mask of its points, and its plane."""
    thickness = check_positive(thickness, "thickness", unit="m")
    vertices = check_polygon(polygon)
    plane = checked_plane(vertices)
    off_mm = 1000 * np.abs(plane.residuals).max()
    if off_mm > 500 * thickness:
        raise ValueError(
            f"Invalid polygon: a vertex is {off_mm:.0f} mm off the plane of all. Must be at most "
            f"{500 * thickness:.0f} mm, half of the thickness."
        )
    near = np.abs(plane.distances(points)) <= thickness
    x, y = plane.project(points[near]).T
    near[near] = shapely.contains_xy(_outline(vertices, plane, plane.normal), x, y)
    return vertices, near, plane


def _outline(vertices, plane, normal):
    """A polygon projected onto a plane along a direction, in plane coordinates."""
    reach = plane.distances(vertices) / (normal @ plane.normal)
    polygon = shapely.Polygon(plane.project(vertices - reach[:, None] * normal))
    if not polygon.is_valid or polygon.area == 0:
        reason = "crosses itself" if polygon.area else "has no area"
        raise ValueError(f"Invalid polygon: {reason}. Must be an outline that encloses an area.")
    return polygon
