"""Polygons from and to files."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mmqa_lab._checks import check_points
from mmqa_lab._polygons import polygon_parts
from mmqa_lab.io._files import write_atomically
from mmqa_lab.io._text import text_tables

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from shapely import MultiPolygon, Polygon

IN_DEGREES = ("CRS84", "4326", "4979")
"""Parts of the names of coordinate systems in degrees that GeoJSON files state most often."""


def read_polygon(source: str | os.PathLike) -> np.ndarray | Polygon | MultiPolygon:
    """Read a polygon: its vertices, or a geometry where it has holes or several parts.

    Parameters
    ----------
    source : path or str
        A CSV file with a vertex in a line (x, y, z; header optional); a GeoJSON file, all of whose
        polygons count; or the vertices themselves: ``"x,y,z; x,y,z; x,y,z"``.

    Returns
    -------
    array, shape (m, 3) or (m, 2), or shapely geometry
        Metres, m >= 3, in order, the first vertex not repeated at the end; two columns where a
        GeoJSON file has no heights. A Polygon with holes or a MultiPolygon where there are.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no polygon, or its coordinate system is in degrees.

    Warns
    -----
    UserWarning
        If a GeoJSON file states a coordinate system: clouds are not compared with it.

    Examples
    --------
    >>> read_polygon("0,0,0; 1,0,0; 1,1,0").shape
    (3, 3)
    """
    text = str(source)
    if ";" in text:
        vertices = _inline(text)
    elif not Path(source).is_file():
        raise FileNotFoundError(f"Invalid polygon {text}: no such file. Must exist.")
    elif Path(source).suffix.lower() in (".json", ".geojson"):
        return _from_geojson(Path(source))
    else:
        vertices, _ = next(text_tables(Path(source), 1_000_000))
    vertices = check_points(vertices, name=f"polygon {text}")
    return polygon_parts(vertices, name=f"polygon {text}")[0][0]


def write_polygon(path: str | os.PathLike, vertices: ArrayLike | Polygon | MultiPolygon) -> None:
    """Write a polygon as GeoJSON that :func:`read_polygon` reads back to the bit.

    Parameters
    ----------
    path : path
        An existing file is replaced.
    vertices : array_like of shape (n, 3), or geometry
        Metres, n >= 3; or a shapely or GeoPandas geometry.

    Raises
    ------
    ValueError
        If there are fewer than three vertices or one is not finite.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_polygon(Path(folder) / "p.geojson", [[0, 0, 0], [1, 0, 0], [1, 0, 0.1]])
    ...     read_polygon(Path(folder) / "p.geojson")[2].tolist()
    [1.0, 0.0, 0.1]
    """
    parts = [
        [[*ring.tolist(), ring[0].tolist()] for ring in rings] for rings in polygon_parts(vertices)
    ]
    node = {"type": "Polygon", "coordinates": parts[0]}
    if len(parts) > 1:
        node = {"type": "MultiPolygon", "coordinates": parts}
    text = json.dumps(node)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


class _Geometry:
    """A GeoJSON object as something that has ``__geo_interface__``."""

    def __init__(self, node):
        self.__geo_interface__ = node


def _inline(text):
    """Vertices written as x,y,z; x,y,z; ..."""
    rows = [vertex.split(",") for vertex in text.split(";") if vertex.strip()]
    try:
        return np.array([[float(word) for word in row] for row in rows])
    except ValueError as error:
        raise ValueError(f"Invalid polygon {text}. Must be vertices x,y,z; x,y,z; ...") from error


def _from_geojson(path):
    """The vertices of a GeoJSON file's polygon, or the geometry of all its polygons."""
    import shapely

    try:
        node = json.loads(path.read_text(encoding="utf-8"))
        _remark_on_crs(path, node.get("crs"))
        parts = polygon_parts(_Geometry(node), name=f"polygon {path}")
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"Invalid polygon {path}. Must be GeoJSON with a polygon of 3-D vertices."
        ) from error
    if len(parts) == 1 and len(parts[0]) == 1:
        return parts[0][0]
    polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in parts]
    return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)


def _remark_on_crs(path, crs):
    """Say that a stated coordinate system is not looked at, or refuse one in degrees."""
    if crs is None:
        return
    stated = str(crs.get("properties", {}).get("name", crs))
    if any(part in stated for part in IN_DEGREES):
        raise ValueError(f"Invalid polygon {path} in {stated}. Must be projected, in metres.")
    warnings.warn(
        f"{path} states the coordinate system {stated}; it is taken for that of the cloud.",
        stacklevel=4,
    )
