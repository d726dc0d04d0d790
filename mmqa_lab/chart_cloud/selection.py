"""Which points lie on a surface: polygons, outlines and charts."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_points, check_polygon, check_positive
from mmqa_lab.planes import checked_plane

__all__ = ["CHART_MARGINS_M", "chart_polygon", "inside_polygon"]

CHART_MARGINS_M = (0.29, 0.094, 0.094, 0.094)
"""Lower, right, upper and left margins. They leave half a square metre of the random pattern of a
1 m x 1 m chart. The border (5 cm) and the plain squares (up to 25 cm above the lower edge) are 4 cm
away, more than twice the assumed error of a click. The paper prints neither size; the sizes come
from :func:`mmqa_lab.charts.point_chart`."""


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
    low, right, high, left = np.broadcast_to(np.asarray(margins, dtype=np.float64), 4)
    a, b, c, d = corners
    width, height = np.linalg.norm(b - a), np.linalg.norm(d - a)
    if left + right >= width or low + high >= height or np.min(margins) < 0:
        raise ValueError(f"Invalid margins {margins}. Must be >= 0 m and leave some of the chart.")
    u = np.array([left, width - right, width - right, left])[:, None] / width
    v = np.array([low, low, height - high, height - high])[:, None] / height
    return a + (b - a) * u * (1 - v) + (d - a) * v * (1 - u) + (c - a) * u * v


def selected(points, polygon, thickness):
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
    near[near] = shapely.contains_xy(outline_on(vertices, plane, plane.normal), x, y)
    return vertices, near, plane


def outline_on(vertices, plane, normal):
    """A polygon projected onto a plane along a direction, in plane coordinates."""
    reach = plane.distances(vertices) / (normal @ plane.normal)
    polygon = shapely.Polygon(plane.project(vertices - reach[:, None] * normal))
    if not polygon.is_valid or polygon.area == 0:
        reason = "crosses itself" if polygon.area else "has no area"
        raise ValueError(f"Invalid polygon: {reason}. Must be an outline that encloses an area.")
    return polygon
