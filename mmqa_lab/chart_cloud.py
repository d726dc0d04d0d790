"""The point-distribution chart: from a selection of points to its quality figures.

Pfeifer et al. 2021 (doi 10.3390/rs13020237), sections 3.3 and 4.2 and Appendix A.
"""

import numbers
import warnings
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_number, check_points, check_positive
from mmqa_lab._polygons import check_flatness, polygon_parts, polygon_vertices
from mmqa_lab._results import Shown
from mmqa_lab.cloud import as_cloud
from mmqa_lab.planes import (
    CONSISTENT_SCALE,
    Plane,
    fit_plane,
    flat_points,
    sigma_mad,
    turned_axes,
)
from mmqa_lab.spacing.quadrants import spacing

AXES = ("principal", "horizontal")

STEEPEST = 0.5
"""Cosine of the slope up to which a polygon in plan is laid onto the surface under it."""

CHART_MARGIN_M = 0.145
"""Leaves 0.71 m x 0.71 m, half a square metre, of a 1 m x 1 m chart."""


@dataclass(frozen=True, eq=False)
class CloudQuality(Shown):
    """The quality figures of the points on one planar surface.

    Parameters
    ----------
    n : int
        Points evaluated.
    area_polygon_m2, area_hull_m2 : float
        Area of the selection polygon projected into the plane (NaN without a polygon), and of
        the convex hull of the projected points.
    std_mm, sigma_mad_mm : float
        Dispersion of the orthogonal distances from the plane.
    d1_mm, d2_mm, d3_mm, d4_mm : float
        Medians of the sorted quadrant distances; NaN where no point has that many.
    incomplete_share : float
        Share of points with an empty quadrant within the search radius.
    coincident : int
        Points that share their place with another one.
    axes : str
        The axes of the quadrants.
    plane : Plane
    xy : array, shape (n, 2)
        The points in the plane along those axes, from its centre, m.
    distances_mm : array, shape (n, 4)
        Their sorted quadrant distances, NaN where a quadrant is empty.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20) * 0.02, np.arange(10) * 0.04)
    >>> quality = evaluate_cloud(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1))
    >>> round(quality.d1_mm, 6), round(quality.d4_mm, 6), round(quality.f, 6)
    (20.0, 40.0, 2.0)
    """

    n: int
    area_polygon_m2: float
    area_hull_m2: float
    std_mm: float
    sigma_mad_mm: float
    d1_mm: float
    d2_mm: float
    d3_mm: float
    d4_mm: float
    incomplete_share: float
    coincident: int
    axes: str
    plane: Plane
    xy: np.ndarray = field(repr=False)
    distances_mm: np.ndarray = field(repr=False)

    @property
    def density_polygon_per_m2(self):
        """Points per square metre of the selection polygon (text of the paper)."""
        return self.n / self.area_polygon_m2

    @property
    def density_hull_per_m2(self):
        """Points per square metre of their convex hull (Appendix A of the paper)."""
        return self.n / self.area_hull_m2 if self.area_hull_m2 > 0 else np.nan

    @property
    def linear_point_distance_mm(self):
        """sqrt(1 / density), of the polygon where there is one, else of the hull."""
        polygon = np.isfinite(self.area_polygon_m2)
        density = self.density_polygon_per_m2 if polygon else self.density_hull_per_m2
        return 1000 / np.sqrt(density)

    @property
    def f(self):
        """Inhomogeneity d4 / d1; NaN where d1 is zero or either is not measurable."""
        return self.d4_mm / self.d1_mm if self.d1_mm > 0 else np.nan

    def to_frame(self):
        """Return one row with every figure in the field's units."""
        names = (
            *("n", "area_polygon_m2", "area_hull_m2"),
            *("density_polygon_per_m2", "density_hull_per_m2", "linear_point_distance_mm"),
            *("std_mm", "sigma_mad_mm", "d1_mm", "d2_mm", "d3_mm", "d4_mm", "f"),
            *("incomplete_share", "coincident", "axes"),
        )
        return pd.DataFrame([{name: getattr(self, name) for name in names}])


def evaluate_cloud(
    points, *, polygon=None, thickness=0.1, axes="principal", radius=0.5, scale=CONSISTENT_SCALE
):
    """Evaluate the points on one planar surface.

    The points, or those that the polygon selects, get an orthogonal regression plane; its residuals
    give std and sigma_MAD. In the plane, the distances to the nearest point in each of four
    quadrants are sorted point by point, and their medians are d1..d4.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        Metres; three or more after selection.
    polygon : array_like of shape (m, 3), shapely or GeoPandas geometry, or path, optional
        The selection, metres; see :func:`inside_polygon`.
    thickness : float
        Points up to this far from the polygon's plane are selected, m.
    axes : {"principal", "horizontal"} or float
        Axes of the quadrants: the principal axes of the selected points, the horizontal line and
        the line of greatest slope of the plane, or the principal axes turned by so many degrees.
    radius : float
        Neighbours farther than this do not count, m.
    scale : float
        Factor of sigma_MAD, see :func:`mmqa_lab.planes.sigma_mad`.

    Returns
    -------
    CloudQuality

    Raises
    ------
    ValueError
        If fewer than three points are left or they lie on a line, or an argument is invalid.

    Warns
    -----
    UserWarning
        If the ``resolution`` of the cloud's coordinates is coarser than sigma_MAD or than a fifth
        of d1.

    Notes
    -----
    f depends on the axes: the same scan lines give another f when they run along an axis than when
    they run across both. A homogeneous random pattern has f = 3.257 at every density, so f <= 2
    asks for more regularity than chance gives. The hull's area is smaller than that of the surface
    the points were drawn from, by about (8/3) ln(n)/n for a square, so its density is too high.

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
    cloud = as_cloud(points)
    points = check_points(cloud, minimum=3)
    if polygon is not None:
        inside, polygon = _selected(points, polygon, thickness)
        points = check_points(points[inside], name="points inside the polygon", minimum=3)
    plane = fit_plane(points)
    directions = _directions(plane, axes)
    xy = (points - plane.centre) @ directions.T
    gaps = spacing(xy, radius=radius)
    d = 1000 * np.asarray(gaps.d)
    sigma_mad_mm = 1000 * sigma_mad(plane.residuals, scale)
    _remark_on_resolution(1000 * cloud.resolution, sigma_mad_mm, d[0])
    return CloudQuality(
        n=len(points),
        area_polygon_m2=np.nan if polygon is None else _outline(polygon, plane).area,
        area_hull_m2=hull_area(xy),
        std_mm=1000 * plane.std,
        sigma_mad_mm=sigma_mad_mm,
        **{f"d{k + 1}_mm": float(d[k]) for k in range(4)},
        incomplete_share=gaps.incomplete_share,
        coincident=gaps.coincident,
        axes=axes if isinstance(axes, str) else f"principal + {float(axes):g} degrees",
        plane=plane,
        xy=xy,
        distances_mm=1000 * gaps.distances,
    )


def inside_polygon(points, polygon, *, thickness=0.1):
    """Return the mask of the points inside a 3-D polygon's projection and near its plane.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    polygon : array_like of shape (m, 3), shapely or GeoPandas geometry, or path
        Vertices in order, metres, convex or concave. Holes are left out, the parts of a
        MultiPolygon and the rows of a GeoDataFrame count together. A polygon in plan (without
        heights) is laid onto the robust regression plane of the points above and below it.
    thickness : float
        Largest distance from the polygon's plane to either side, m.

    Returns
    -------
    array of bool, shape (n,)

    Raises
    ------
    ValueError
        If the polygon has fewer than three vertices, crosses itself or has no area; if a vertex
        lies off the plane of all by more than 5 % of their spread (the rms distance from their
        mean); if a polygon in plan lies over a surface steeper than 60 degrees.

    Warns
    -----
    UserWarning
        If a vertex lies off the plane by more than a quarter of ``thickness``: points near it may
        be missed.

    Examples
    --------
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> inside_polygon([[0.5, 0.5, 0.01], [0.5, 0.5, 0.2], [2, 0, 0]], square).tolist()
    [True, False, False]
    """
    return _selected(check_points(points, minimum=0), polygon, thickness)[0]


def chart_polygon(corners, *, margins=CHART_MARGIN_M):
    """Return the part of a chart to evaluate, from its four surveyed corners.

    Parameters
    ----------
    corners : array_like, shape (4, 3)
        Metres, in order around the chart, from the lower left one.
    margins : float or sequence of four
        Width left out inwards from the lower, right, upper and left edge, m; by default half a
        square metre in the middle of a 1 m chart remains, without the border. Give wider
        margins on the sides where the plain squares lie.

    Returns
    -------
    array, shape (4, 3)

    Raises
    ------
    ValueError
        If there are not four corners or the margins leave nothing.

    Examples
    --------
    >>> chart_polygon([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], margins=0.25).tolist()[0]
    [0.25, 0.0, 0.25]
    """
    corners = polygon_vertices(corners, name="corners")
    if len(corners) != 4:
        raise ValueError(f"Invalid corners: {len(corners)} given. Must be four.")
    given = np.asarray(margins, dtype=np.float64)
    if given.ndim > 1 or given.size not in (1, 4) or (given < 0).any():
        raise ValueError(f"Invalid margins {margins}. Must be one or four widths >= 0 m.")
    low, right, high, left = np.broadcast_to(given, 4)
    a, b, _, d = corners
    width, height = np.linalg.norm(b - a), np.linalg.norm(d - a)
    if left + right >= width or low + high >= height:
        raise ValueError(
            f"Invalid margins {margins}. Must leave some of the {width:.3f} m x {height:.3f} m."
        )
    u = np.array([left, width - right, width - right, left])[:, None] / width
    v = np.array([low, low, height - high, height - high])[:, None] / height
    return a + (b - a) * u * (1 - v) + (d - a) * v * (1 - u) + (corners[2] - a) * u * v


def hull_area(xy):
    """Return the area of the convex hull of points in a plane, m2; 0 when they lie on a line.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Metres.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If there are no points or one is not finite.

    Examples
    --------
    >>> hull_area([[0, 0], [2, 0], [2, 1], [0, 1], [1, 0.5]]), hull_area([[0, 0], [1, 1]])
    (2.0, 0.0)
    """
    import shapely

    xy = flat_points(xy)
    outline = xy if len(xy) > 1 else np.repeat(xy, 2, axis=0)
    return float(shapely.convex_hull(shapely.linestrings(outline)).area)


def _directions(plane, axes):
    """The axes of the quadrants, shape (2, 3)."""
    if isinstance(axes, numbers.Real) and not isinstance(axes, bool):
        return turned_axes(plane.axes, check_number(axes, "axes", unit="degrees"))
    check_choice(axes, "axes", AXES)
    return plane.axes if axes == "principal" else plane.horizontal_axes()


def _remark_on_resolution(step_mm, sigma_mm, d1_mm):
    """Say where the stored coordinates are too coarse for the dispersion or the spacing."""
    if step_mm > sigma_mm or step_mm > d1_mm / 5:
        warnings.warn(
            f"The coordinates are in steps of {step_mm:.3g} mm: too coarse for sigma_MAD "
            f"{sigma_mm:.3g} mm or d1 {d1_mm:.3g} mm.",
            stacklevel=3,
        )


def _selected(points, polygon, thickness):
    """Which points a polygon selects, and its parts with heights."""
    import shapely

    thickness = check_positive(thickness, "thickness", unit="m")
    parts = polygon_parts(polygon)
    if any(ring.shape[1] == 2 for rings in parts for ring in rings):
        parts = _draped(parts, points)
    plane = _polygon_plane(parts, thickness)
    outline = _outline(parts, plane)
    near = np.abs(plane.distances(points)) <= thickness
    x, y = plane.project(points[near]).T
    near[near] = shapely.contains_xy(outline, x, y)
    return near, parts


def _polygon_plane(parts, thickness):
    """The plane of a polygon's vertices, with a remark where it is not quite flat."""
    vertices = np.concatenate([ring for rings in parts for ring in rings])
    plane = fit_plane(vertices)
    check_flatness(vertices, plane)
    off = np.abs(plane.residuals).max()
    if off > thickness / 4:
        warnings.warn(
            f"A vertex of the polygon is {1000 * off:.0f} mm off the plane of all. Points farther "
            f"than {1000 * thickness:.0f} mm from that plane do not count.",
            stacklevel=4,
        )
    return plane


def _draped(parts, points):
    """The parts of a polygon in plan with the heights of the surface that the points lie on."""
    import shapely

    parts = [[ring[:, :2] for ring in rings] for rings in parts]
    outline = shapely.union_all([_polygon(*rings) for rings in parts])
    inside = shapely.contains_xy(outline, points[:, 0], points[:, 1])
    found = check_points(points[inside], name="points inside the polygon", minimum=3)
    plane = fit_plane(found, robust=True)
    if abs(plane.normal[2]) < STEEPEST:
        raise ValueError(
            "Invalid polygon without heights over a surface steeper than 60 degrees. "
            "Must have heights there."
        )
    slopes = -plane.normal[:2] / plane.normal[2]

    def lifted(ring):
        """A ring with heights of the plane."""
        return np.column_stack([ring, plane.centre[2] + (ring - plane.centre[:2]) @ slopes])

    return [[lifted(ring) for ring in rings] for rings in parts]


def _outline(parts, plane):
    """The area of a polygon's parts in a plane, without their holes."""
    import shapely

    flat = [_polygon(*(plane.project(ring) for ring in rings)) for rings in parts]
    return flat[0] if len(flat) == 1 else shapely.union_all(flat)


def _polygon(xy, *holes):
    """A valid polygon in the plane."""
    import shapely

    polygon = shapely.Polygon(xy, holes)
    if not polygon.is_valid or polygon.area == 0:
        reason = shapely.is_valid_reason(polygon) if polygon.area else "no area"
        raise ValueError(f"Invalid polygon: {reason}. Must be an outline that encloses an area.")
    return polygon
