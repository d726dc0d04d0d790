"""Polygons of any kind as rings of vertices: arrays, shapely and GeoPandas geometries, files; and
the distance from a path."""

from __future__ import annotations

import os

import numpy as np

from mmqa_lab._checks import check_metres, check_points, is_table

OFF_PLANE = 0.05
"""A vertex may lie this share of the vertices' spread (rms distance from their mean) off the plane
of a polygon."""


class CrsNotCompared(UserWarning):
    """A polygon states a coordinate system that cannot be compared with the cloud's."""


def polygon_crs(polygon):
    """The coordinate reference system of a geometry or of a GeoJSON file, None without one."""
    if isinstance(polygon, str | os.PathLike):
        from mmqa_lab.io.tables import stated_crs

        return stated_crs(polygon)
    return getattr(polygon, "crs", None)


def polygon_parts(polygon, *, name="polygon"):
    """Return the parts of a polygon, each a list of its outer ring and its holes.

    Parameters
    ----------
    polygon : array_like of shape (m, 3), geometry or path
        Vertices in order; or whatever has ``__geo_interface__`` (shapely, GeoPandas): polygons,
        with heights or in plan; or what ``io.read_polygon`` reads.
    name : str
        For messages.

    Returns
    -------
    list of list of array, shape (m, 3) or, without heights, (m, 2)
        The first vertex of a ring is not repeated.

    Raises
    ------
    ValueError
        If there is no polygon in it, a ring has less than three vertices, or coordinates are in
        degrees.
    """
    if isinstance(polygon, str | os.PathLike):
        from mmqa_lab.io import read_polygon

        polygon = read_polygon(polygon)
    check_metres(getattr(polygon, "crs", None), name)
    if not hasattr(polygon, "__geo_interface__"):
        return [[_ring(polygon, name)]]
    parts = [list(rings) for rings in _coordinates(polygon.__geo_interface__) if len(rings)]
    if not parts:
        raise ValueError(f"Invalid {name} without an area. Must be a polygon.")
    return [[_ring(ring, name) for ring in rings] for rings in parts]


def polygon_vertices(polygon, *, name="polygon"):
    """Return the vertices of a polygon of one part without holes, shape (m, 3).

    Raises
    ------
    ValueError
        If it has holes, several parts or no heights.
    """
    parts = polygon_parts(polygon, name=name)
    if len(parts) > 1 or len(parts[0]) > 1:
        rings = sum(map(len, parts))
        raise ValueError(f"Invalid {name} of {rings} rings. Must be one ring without holes.")
    return check_points(parts[0][0], name=name, minimum=3)


def check_flatness(vertices, plane, *, name="polygon"):
    """Raise where a polygon's vertices lie off their plane by too great a share of their spread."""
    off = np.abs(plane.residuals).max()
    spread = np.sqrt(np.mean(np.sum((vertices - plane.centre) ** 2, axis=1)))
    if off > OFF_PLANE * spread:
        raise ValueError(
            f"Invalid {name}: a vertex is {1000 * off:.0f} mm off the plane of all, "
            f"{100 * off / spread:.0f} % of their spread. Must be at most {100 * OFF_PLANE:.0f} %."
        )


def path_distance(xy, path):
    """Return the horizontal distance of points (n, 2) from a polyline (m, 2), metres.

    Examples
    --------
    >>> path_distance(np.array([[1.0, 5.0], [0.0, 12.0]]), np.array([[0.0, 0.0], [0.0, 10.0]]))
    array([1., 2.])
    """
    import shapely

    line = shapely.LineString(path) if len(path) > 1 else shapely.Point(path[0])
    return shapely.distance(shapely.points(xy), line)


def _ring(vertices, name):
    """A ring's vertices, the first not repeated."""
    if is_table(vertices):
        vertices = check_points(vertices, name=name)
    try:
        ring = np.asarray(vertices)
    except ValueError:  # some vertices have heights
        raise ValueError(
            f"Invalid {name}: vertices of different lengths. Must all have heights, or none."
        ) from None
    columns = 2 if ring.ndim == 2 and ring.shape[1] == 2 else 3
    ring = check_points(ring, name=name, columns=columns)
    closed = len(ring) > 1 and np.array_equal(ring[0], ring[-1])
    return check_points(ring[:-1] if closed else ring, name=name, columns=columns, minimum=3)


def _coordinates(node):
    """The rings of every polygon in a GeoJSON-like mapping."""
    if node is None:  # a row without a geometry
        return []
    kind = node["type"]
    if kind == "Feature":
        return _coordinates(node["geometry"])
    if kind in ("FeatureCollection", "GeometryCollection"):
        inner = node["features"] if kind == "FeatureCollection" else node["geometries"]
        return [part for other in inner for part in _coordinates(other)]
    if kind == "MultiPolygon":
        return node["coordinates"]
    return [node["coordinates"]] if kind == "Polygon" else []
