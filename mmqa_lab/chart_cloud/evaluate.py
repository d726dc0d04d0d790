"""Evaluate the points of a surface, chosen by a polygon or all, as a point-distribution chart.

The source is Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    check_points,
    check_polygon,
    check_positive,
    check_values,
    polygon_rings,
    refuse,
)
from mmqa_lab.chart_cloud.quality import CloudQuality
from mmqa_lab.cloud import Cloud, step_of
from mmqa_lab.planes import CONSISTENT_SCALE, checked_plane, sigma_mad
from mmqa_lab.spacing.quadrants import checked_spacing

__all__ = [
    "CHART_MARGINS_M", "chart_polygon", "evaluate_cloud", "inside_polygon", "plan_chart",
]  # fmt: skip


UPRIGHT_COSINE = 0.7
"""A surface is upright if the cosine of its slope is smaller. Its default axes are horizontal."""

LEAST_ALONG = 0.5
"""A polygon is not projected onto a plane that it is turned to by more: the cosine of the angle."""

CHART_MARGINS_M = (0.29, 0.094, 0.094, 0.094)
"""Lower, right, upper and left margins. They leave half a square metre of the random pattern of a
1 m x 1 m chart. The border (5 cm) and the plain squares (up to 25 cm above the lower edge) are 4 cm
away, more than twice the assumed error of a click. The paper prints neither size; the sizes come
from :func:`mmqa_lab.charts.point_chart`."""


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
    multiples, from 0.1 mm to 0.1 m; for sigma_MAD also that of one axis alone, as of heights in
    centimetres, for its part along the normal.

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
    ring = points.columns.get("ring", ()) if isinstance(points, Cloud) else ()
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
        points, ring = points[inside], ring[inside] if len(ring) else ring
    step_mm = 1000 * np.fmax.reduce([resolution, step_of(points), np.spacing(np.abs(points).max())])
    plane = checked_plane(points)
    across = np.abs(plane.normal) * [step_of(axis[:, None]) for axis in points.T]
    across_mm = np.fmax(step_mm, 1000 * np.fmax.reduce(across))
    sigma_mad_mm = 1000 * sigma_mad(plane.residuals, scale)
    if axes is None:
        axes = "horizontal" if abs(plane.normal[2]) < UPRIGHT_COSINE else "principal"
    framed = replace(plane, axes=plane.directions(axes))
    xy = framed.project(points)
    hull = shapely.convex_hull(shapely.linestrings(xy))
    outline = hull if polygon is None else outline_on(polygon, framed, surface.normal)
    gaps = checked_spacing(xy, radius)
    return CloudQuality(
        area_polygon_m2=np.nan if polygon is None else outline.area,
        area_hull_m2=float(hull.area),
        sigma_mad_mm=sigma_mad_mm,
        axes=axes if isinstance(axes, str) else f"principal + {float(axes):g} degrees",
        rho0_per_m2=rho0,
        step_mm=step_mm,
        across_mm=across_mm,
        scale=scale,
        beams=len(np.unique(ring)),
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
        across_mm=np.nan,
        scale=CONSISTENT_SCALE,
        beams=0,
        plane=plane,
        spacing=checked_spacing(np.ascontiguousarray(points[:, :2]), radius),
        outline=outline,
    )


def inside_polygon(points: ArrayLike, polygon: ArrayLike, *, thickness: float = 0.1) -> np.ndarray:
    """Return the mask of the points inside a 3-D polygon's projection and near its plane.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        The cloud, m.
    polygon : array_like, shape (m, 3)
        Vertices in order, m; convex or concave. A hole follows as a closed ring behind the first
        vertex once more, as :func:`mmqa_lab.io.read_outlines` reads it.
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
    return selected(points, polygon, thickness)[1]


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
    margins = check_values(margins, "margins")
    refuse(margins.size not in (1, 4), "margins", f"{margins.size} given", "one or four")
    low, right, high, left = np.broadcast_to(margins, 4)
    a, b, c, d = corners
    width, height = np.linalg.norm(b - a), np.linalg.norm(d - a)
    if left + right >= width or low + high >= height or np.min(margins) < 0:
        raise ValueError(f"Invalid margins {margins}. Must be >= 0 m and leave some of the chart.")
    u = np.array([left, width - right, width - right, left])[:, None] / width
    v = np.array([low, low, height - high, height - high])[:, None] / height
    return a + (b - a) * u * (1 - v) + (d - a) * v * (1 - u) + (c - a) * u * v


def selected(points, polygon, thickness):
    """Return the vertices of a polygon, the mask of its points, and its plane."""
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
    near[near] = shapely.contains_xy(outline_on(vertices, plane, plane.normal), x, y)
    return vertices, near, plane


def outline_on(vertices, plane, normal):
    """Return a polygon projected onto a plane along a direction, in plane coordinates."""
    along = abs(normal @ plane.normal)
    turn = f"{np.degrees(np.arccos(min(along, 1))):.0f} degrees to the surface of its points"
    refuse(along < LEAST_ALONG, "polygon", turn, "along it, or 60 degrees off at most")
    reach = plane.distances(vertices) / (normal @ plane.normal)
    flat = plane.project(vertices - reach[:, None] * normal)
    rings = [flat[rows] for rows in polygon_rings(vertices)]
    polygon = shapely.Polygon(rings[0], rings[1:])
    if not polygon.is_valid or polygon.area == 0:
        reason = "crosses itself" if polygon.area else "has no area"
        raise ValueError(f"Invalid polygon: {reason}. Must be an outline that encloses an area.")
    return polygon
