"""The quality figures of the points on a planar surface, with intervals and pictures.

Every figure has a 95 % confidence interval from the points, see :meth:`CloudQuality.intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from mmqa_lab import stats
from mmqa_lab._checks import check_positive
from mmqa_lab._results import Shown, printed
from mmqa_lab.chart_cloud.doubts import is_below_step, is_by_chance, is_coarse, remarks_on
from mmqa_lab.metrics.pattern import Pattern
from mmqa_lab.planes import Plane
from mmqa_lab.spacing import (
    DirectionalSpacing,
    EmptySpace,
    Spacing,
    empty_space,
    exempt,
    line_parts,
)  # fmt: skip
from mmqa_lab.spacing.directions import FEWEST_POINTS
from mmqa_lab.spacing.empty import places_within

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CloudQuality"]

MOST_DRAWN = 10_000
"""Most points that are drawn."""


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
    across_mm : float
        Their step along the normal, larger where one axis has fewer digits.
    scale : float
        Factor of sigma_MAD.
    beams : int
        Beams of a spinning scanner that the points come from; 0 if it is not known.
    plane : Plane
        The regression plane of the points; its axes are those of the quadrants.
    spacing : Spacing
        Spacing of the points in the plane. Coordinates are along the axes from the plane's centre.
    outline : shapely geometry
        The polygon, or the hull without a polygon, in the same coordinates, m.

    Examples
    --------
    >>> from mmqa_lab.chart_cloud import evaluate_cloud
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
    across_mm: float
    scale: float
    beams: int
    plane: Plane = field(repr=False)
    spacing: Spacing = field(repr=False)
    outline: Any = field(repr=False)

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """Warnings about the figures, for example on coordinates that are too coarse."""
        return remarks_on(self)

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
        return self.pattern.empty() if self.outline.area else empty_space(self.xy)

    @cached_property
    def pattern(self) -> Pattern:
        """What the metrics of :data:`mmqa_lab.metrics.METRICS` share."""
        return Pattern(self.xy, self.outline, self.plane.residuals)

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
        >>> from mmqa_lab.chart_cloud import evaluate_cloud
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

        They hold for what one scan can show. The phases of a scanner's turns it cannot: intervals
        of d1..d4, f and g of one sweep of a scanner with 64 beams held in 37 to 60 % of sweeps
        (simulated). Nor can it show that the next pass is faster: where speeds of passes differ by
        1 to 2 %, intervals of the density held in a quarter of simulated passes, of d3 and d4 in 22
        to 48 %, of f and g in 53 to 80 %; those of d1, d2 and the noise do not depend on it. Of a
        tilted board with a gradient they held in 72 to 88 % of one simulation and in 93 to 100 %
        of another. Of a grid whose points jitter by a tenth of its spacing those of g held in 77 to
        82 %. Figures whose points lie in coarse steps of coordinates have none.

        Some intervals are too wide. The density of points on lines hardly varies between scans,
        because the errors of neighbouring lines cancel. Slow waves show only a part of this, so the
        interval of the density is several times too wide. Without a direction of lines, the wider
        of two intervals is given (about a third too wide for random points), and the direction of
        g is chosen from the points. This narrows the distribution of g, but not its interval.

        Examples
        --------
        >>> from mmqa_lab.chart_cloud import evaluate_cloud
        >>> points = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * [2, 1, 0.01]
        >>> table = evaluate_cloud(points).intervals().set_index("figure")
        >>> table.index.tolist()
        ['density', 'std', 'sigma_mad', 'd1', 'd2', 'd3', 'd4', 'f', 'g', 'e95']
        >>> table = table.dropna()
        >>> bool((table["low"] < table["value"]).all() and (table["value"] < table["high"]).all())
        True
        """
        import pandas as pd

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
        directed = self.directional.intervals().iloc[2:]
        coarse = is_coarse(self.d1_mm, self.step_mm)
        if coarse or is_by_chance(self.xy, self.axes):
            spacing[["low", "high"]] = np.nan
        if coarse:
            directed[["low", "high"]] = np.nan
        spacing.loc[spacing["figure"] == "f", "value"] = self.f
        spacing.loc[spacing["value"].isna(), ["low", "high"]] = np.nan
        parts = [spacing, directed, empty]
        parts = [pd.DataFrame(rows, columns=names), *(part[names] for part in parts)]
        return pd.concat(parts, ignore_index=True)

    def to_frame(self) -> pd.DataFrame:
        """Return a row with every figure; the names of its columns end with the units."""
        import pandas as pd

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
            For the nearest and the farthest quadrant distance of each point with d1 and d4, and for
            the distances of places, dotted and scaled to the number of points, with e95.
        residuals : Axes
            For the distances from the plane, with std and sigma_MAD on both sides of zero.
        """
        from mmqa_lab.plots import COLOURS

        self.spacing.plot(ax=spacings)
        black, away = {"color": COLOURS["black"], "ls": ":"}, 1000 * self.empty_space.distances
        low, high = spacings.get_xlim()
        bins, each = np.linspace(low, high, 56), np.full(len(away), self.n / len(away))
        spacings.hist(away, bins=bins, weights=each, histtype="step", **black)
        spacings.axvline(self.e95_mm, label=f"places: $e_{{95}}$ = {self.e95_mm:.1f} mm", **black)
        spacings.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
        half = max(4 * self.sigma_mad_mm, 0.5)
        shown = np.clip(1000 * self.plane.residuals, -half, half)
        width = half / 30
        if self.step_mm > width / 9:  # bins that are no multiples of the step would be a comb
            width = self.step_mm * max(1, round(width / self.step_mm))
        edges = width * (np.arange(-np.ceil(half / width), np.ceil(half / width) + 2) - 0.5)
        residuals.hist(shown, bins=edges, color=COLOURS["sky"], histtype="stepfilled")
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
        return printed(self.intervals()).to_html(index=False)

    def _density_interval(self):
        """Density in the outline and its interval."""
        density = self.n / self.outline.area if self.outline.area else np.nan
        if np.isnan(density) or self.directional.n < FEWEST_POINTS:
            return density, np.nan, np.nan
        places = places_within(self.outline)
        block = line_parts(np.vstack([self.xy, places]), self.directional)
        # a point counts 1, a place of the grid minus the points expected per place
        expected = np.full(len(places), self.n / len(places))
        signs = np.concatenate([np.ones(self.n), -expected])
        reach = stats.mean_reach(signs, block) * len(signs) / self.outline.area
        return density, max(density - reach, 0.0), density + reach
