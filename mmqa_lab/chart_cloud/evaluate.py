"""Evaluate a selection of points as a point-distribution chart.

The source is Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_number, check_points, check_positive
from mmqa_lab.chart_cloud.doubts import (
    remark_on_form,
    remark_on_gaps,
    remark_on_layers,
    remarks_on_points,
)
from mmqa_lab.chart_cloud.parts import remark_on_part
from mmqa_lab.chart_cloud.quality import CloudQuality
from mmqa_lab.chart_cloud.selection import outline_on, selected
from mmqa_lab.planes import CONSISTENT_SCALE, checked_plane, sigma_mad
from mmqa_lab.spacing.quadrants import checked_spacing

__all__ = ["evaluate_cloud", "plan_chart", "step_of"]

UPRIGHT_COSINE = 0.7
"""A surface is upright if the cosine of its slope is smaller. Its default axes are horizontal."""


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
        polygon, inside, surface = selected(points, polygon, thickness)
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
    outline = hull if polygon is None else outline_on(polygon, framed, surface.normal)
    sigma_mad_mm = 1000 * sigma_mad(plane.residuals, scale)
    step_mm = 1000 * np.fmax.reduce([resolution, step_of(points), np.spacing(np.abs(points).max())])
    remarks = remarks_on_points(gaps, step_mm, sigma_mad_mm, hull.area, outline.area, axes)
    if outline.area:
        remarks += remark_on_gaps(xy, outline, polygon is not None)
    remarks += tuple(remark_on_layers(1000 * plane.residuals, step_mm))
    remarks += remark_on_part(points, plane, sigma_mad_mm, scale, step_mm)
    remarks += tuple(remark_on_form(xy, 1000 * plane.residuals, step_mm, scale))
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


def plan_chart(points, side, radius):
    """The chart of points (n, 3) in a square of the plan from (0, 0), m, axes along its sides."""
    plane = checked_plane(points)
    hull = shapely.convex_hull(shapely.multipoints(points[:, :2]))
    outline = shapely.box(0, 0, side, side)
    return CloudQuality(
        area_polygon_m2=outline.area,
        area_hull_m2=float(hull.area),
        sigma_mad_mm=1000 * sigma_mad(plane.residuals),
        axes="of the plan",
        rho0_per_m2=np.nan,
        step_mm=np.nan,
        remarks=(),
        plane=plane,
        spacing=checked_spacing(np.ascontiguousarray(points[:, :2]), radius),
        outline=outline,
    )


def _directions(plane, axes):
    """The axes of the quadrants, shape (2, 3)."""
    if not isinstance(axes, str):
        turn = np.radians(check_number(axes, "axes", unit="degrees"))
        return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ plane.axes
    check_choice(axes, "axes", ("principal", "horizontal"))
    return plane.axes if axes == "principal" else plane.horizontal_axes()


def step_of(points):
    """The coarsest step, m, of which all coordinates are multiples; NaN without such a step."""
    local = points[:: 1 + len(points) // 1000] - points[0]
    steps = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
    places = (local / step for step in steps)
    fits = [np.abs(place - np.round(place)).max() < 1e-4 for place in places]
    return max(np.compress(fits, steps), default=np.nan) if len(points) > 10 else np.nan
