"""Outlines of surfaces: GeoJSON, tables and texts."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_file, check_polygon, check_same_crs, refuse
from mmqa_lab.io.files import plain_text, reading, write_atomically
from mmqa_lab.io.systems import named_system
from mmqa_lab.io.tables import text_places

__all__ = ["OUTLINE_ENDINGS", "read_polygon", "write_polygon"]

OUTLINE_ENDINGS = (".json", ".geojson")

# A surface narrower than this is no surface: its vertices are degrees.
NARROWEST_M = 0.001


def read_polygon(source: str | os.PathLike, *, crs: object = None) -> np.ndarray:
    """Read the vertices of a polygon.

    Parameters
    ----------
    source : path or str
        A CSV file with a vertex in a line (x, y, z; header optional); GeoJSON; or the vertices
        themselves: ``"x,y,z; x,y,z; x,y,z"``.
    crs : pyproj.CRS, optional
        Of the cloud: a GeoJSON file that names another is refused.

    Returns
    -------
    array, shape (m, 3)
        Metres, m >= 3, in order, the first vertex not repeated at the end.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no polygon of one ring with heights, or it is not in metres.

    Examples
    --------
    >>> read_polygon("0,0,0; 1,0,0; 1,1,0").shape
    (3, 3)
    """
    text = str(source)
    if ";" in text:
        rows = [row.split(",") for row in text.split(";") if row.strip()]
        try:
            vertices = np.array(rows, dtype=np.float64)
        except ValueError as error:
            raise ValueError(f"Invalid polygon {text!r}. Must be 'x,y,z; x,y,z; x,y,z'.") from error
        return check_polygon(vertices)
    if check_file(source, "polygon").suffix.lower() in OUTLINE_ENDINGS:
        return _polygon_of_geojson(Path(source), crs)
    return check_polygon(text_places(source, "polygon")[0], name=f"polygon {source}")


def _polygon_of_geojson(path, crs):
    """The one ring of a GeoJSON file's polygon, as QGIS writes it, too."""
    what = f"polygon {path}"
    with reading(path, "polygon", "GeoJSON"):
        whole = json.loads(plain_text(path))
    node, wanted = whole, "one polygon of one ring"
    for key in ("features", "geometry", "geometries"):
        inside = node.get(key) if isinstance(node, dict) else None
        if isinstance(inside, list):
            _check_one(inside, key, what)
            inside = inside[0]
        node = node if inside is None else inside
    kind = node.get("type") if isinstance(node, dict) else None
    rings = node.get("coordinates") if kind in ("Polygon", "MultiPolygon") else None
    if not isinstance(rings, list):
        raise ValueError(f"Invalid {what} of type {kind or 'unknown'}. Must be {wanted}.")
    if kind == "MultiPolygon":
        _check_one(rings, "polygons", what)
        rings = rings[0]
    _check_one(rings, "rings, so a hole" if rings else "rings", what)
    ring = rings[0] if isinstance(rings[0], list) else [rings[0]]
    high = all(isinstance(vertex, list) and len(vertex) >= 3 for vertex in ring)
    refuse(not high, what, "vertices without heights", "x, y, z")
    with reading(path, "polygon", "GeoJSON with numbers as vertices"):
        places = np.array([vertex[:3] for vertex in ring], dtype=np.float64)
    vertices = check_polygon(places, name=what)
    _check_place(whole.get("crs"), vertices, what, crs)
    return vertices


def _check_one(found, of, what):
    """Raise where a list of a GeoJSON file has not one entry."""
    count = len(found) if isinstance(found, list) else 0
    refuse(count != 1, what, f"{count} {of}", "one polygon of one ring")


def _check_place(node, vertices, what, crs):
    """Compare what a GeoJSON file says of its coordinate system with the cloud's."""
    about = node.get("properties") if isinstance(node, dict) else None
    name = about.get("name") if isinstance(about, dict) else None
    if name is not None:
        check_same_crs(what, named_system(name, what), "cloud", crs)
    elif node is not None:
        warnings.warn(f"The coordinate system of {what} is not read: no name.", stacklevel=4)
    plan = vertices[:, :2]
    narrow = np.abs(plan).max() <= 180 and np.ptp(plan, axis=0).max() < NARROWEST_M
    refuse(name is None and narrow, what, "it looks like degrees", "projected, in metres")
    if np.abs(plan).max() > 1000 and not vertices[:, 2].any():
        warnings.warn(f"All heights of {what} are 0.", stacklevel=4)


def write_polygon(path: str | os.PathLike, vertices: ArrayLike) -> None:
    """Write the vertices of a polygon, shape (m, 3), as GeoJSON that is read back to the bit.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_polygon(Path(folder) / "p.geojson", [[0, 0, 0], [1, 0, 0], [1, 0, 0.1]])
    ...     read_polygon(Path(folder) / "p.geojson")[2].tolist()
    [1.0, 0.0, 0.1]
    """
    ring = check_polygon(vertices).tolist()
    node = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
    write_atomically(path, json.dumps(node))
