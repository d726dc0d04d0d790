"""Outlines of surfaces: of a GIS, of tables and of texts, with names, placed on their cloud."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    check_choice,
    check_file,
    check_polygon,
    check_same_crs,
    is_file,
    needs,
    polygon_rings,
    refuse,
)
from mmqa_lab.io.files import plain_text, reading, write_atomically
from mmqa_lab.io.systems import named_system
from mmqa_lab.io.tables import text_places

if TYPE_CHECKING:
    from pyproj import CRS

__all__ = ["OUTLINE_ENDINGS", "read_outlines", "read_polygon", "write_outlines", "write_polygon"]

JSON_ENDINGS = (".json", ".geojson")
OUTLINE_ENDINGS = (*JSON_ENDINGS, ".gpkg", ".shp", ".fgb", ".kml", ".dxf", ".wkt")

# Fields that name an outline, the first that is there.
NAME_FIELDS = ("name", "label", "title", "id", "fid", "layer")

# What reads a file of a GIS: the systems of its layers, and fields and shape of each row.
GDAL = """
import contextlib, json, sys, warnings
warnings.simplefilter("ignore")
sys.modules.update(dict.fromkeys(("pandas", "pyarrow", "shapely")))  # would take most of the time
with contextlib.suppress(ImportError, ValueError):
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))
import pyogrio
pyogrio.set_gdal_config_options({"SHAPE_RESTORE_SHX": "YES"})
systems, rows = [], []
for layer, _ in pyogrio.list_layers(sys.argv[1]):
    about, _, shapes, fields = pyogrio.raw.read(sys.argv[1], layer=layer)
    systems.append(about["crs"])
    for row, shape in enumerate(() if shapes is None else shapes):
        known = {name: field[row] for name, field in zip(about["fields"], fields)}
        if shape is not None:
            rows.append([known, shape.hex()])
json.dump([systems, rows], sys.stdout, default=str)
"""
GDAL_S = 12.0

# A surface narrower than this is no surface: its vertices are degrees.
NARROWEST_M = 0.001

# A residual this many times the median one is no point of the surface.
FAR_OFF = 5.0


def read_outlines(
    source: str | os.PathLike,
    *,
    crs: object = None,
    points: ArrayLike | None = None,
) -> tuple[tuple[str, np.ndarray], ...]:
    """Read the outlines of one or more surfaces.

    Parameters
    ----------
    source : path or str
        GeoPackage, shapefile, FlatGeobuf, KML, DXF, GeoJSON or WKT (also in a column of a CSV
        file); a CSV file with a vertex in a line (x, y, z; header optional); or the vertices
        themselves: ``"x,y,z; x,y,z; x,y,z"``.
    crs : pyproj.CRS, optional
        Of the cloud: outlines in another are transformed in plan, their heights stay.
    points : array_like, shape (n, 3), optional
        The cloud: outlines without heights are laid onto the plane of its points inside them.

    Returns
    -------
    tuple of (name, array of shape (m, 3))
        Metres, m >= 3, in order, the first vertex not repeated at the end. A hole is a closed ring
        behind the first vertex once more. Without names they are numbered from 1.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If there is no outline, one has neither heights nor a cloud, or it is not in metres and the
        cloud names no coordinate system.

    See Also
    --------
    read_polygon : the one outline of a file.
    """
    text = str(source)
    if ";" in text and not is_file(source):
        rows = [row.split(",") for row in text.split(";") if row.strip()]
        try:
            vertices = np.array(rows, dtype=np.float64)
        except ValueError as error:
            raise ValueError(f"Invalid polygon {text!r}. Must be 'x,y,z; x,y,z; x,y,z'.") from error
        return (("1", check_polygon(vertices)),)
    names, rings, own = stored_outlines(source)
    points = None if points is None else np.asarray(points)
    placed = [_placed(ring, own, crs, points, f"polygon {source}") for ring in rings]
    return tuple(zip(names, placed, strict=True))


def stored_outlines(source: str | os.PathLike) -> tuple[list[str], list[np.ndarray], Any]:
    """The names of a file's outlines, their vertices as they stand there, and their system."""
    path, what = check_file(source, "polygon"), f"polygon {source}"
    ending = path.suffix.lower()
    if ending in JSON_ENDINGS:
        shapes, own = _of_geojson(path, what)
    elif ending in OUTLINE_ENDINGS and ending != ".wkt":
        shapes, own = _of_gis(path, what)
    elif b"POLYGON" in (raw := plain_text(path)):
        import shapely

        with reading(path, "polygon", "WKT"):
            found = re.findall(r"(?:MULTI)?POLYGON[^A-Z\"]*Z?[^A-Z\"]*", raw.decode())
            shapes, own = [(None, shapely.from_wkt(one)) for one in found], None
    else:
        return ["1"], [check_polygon(text_places(source, "polygon")[0], name=what)], None
    rings = [(name, ring) for name, shape in shapes for ring in _rings(shape)]
    kinds = ", ".join(sorted({shape.geom_type for _, shape in shapes})) or "unknown"
    refuse(not rings, what, f"of type {kinds}", "one polygon or more")
    names = [str(name or number) for number, (name, _) in enumerate(rings, 1)]
    names = [f"{one} ({k})" if one in names[:k] else one for k, one in enumerate(names)]
    return names, [ring for _, ring in rings], own


def read_polygon(
    source: str | os.PathLike, *, crs: object = None, points: ArrayLike | None = None
) -> np.ndarray:
    """Read the vertices of a polygon, shape (m, 3): the one outline of :func:`read_outlines`.

    Parameters, errors and formats are those of that function; several outlines are refused.

    Examples
    --------
    >>> read_polygon("0,0,0; 1,0,0; 1,1,0").shape
    (3, 3)
    """
    found = read_outlines(source, crs=crs, points=points)
    refuse(len(found) != 1, f"polygon {source}", f"{len(found)} outlines", "one")
    return found[0][1]


def _of_geojson(path, what):
    """The shapes of a GeoJSON file with their names, and the system that it names."""
    from shapely.geometry import shape

    text = plain_text(path)
    with reading(path, "polygon", "GeoJSON"):
        whole = json.loads(text)
    node = whole if isinstance(whole, dict) else {}
    shapes = []
    for one in node.get("features") or [node]:
        about = one if isinstance(one, dict) else {}
        geometry = about.get("geometry", about if "type" in about else None)
        if isinstance(geometry, dict) and geometry.get("type") != "FeatureCollection":
            with reading(path, "polygon", "GeoJSON with numbers as vertices"):
                shapes.append((_name(about.get("properties") or {}), shape(geometry)))
    crs = node.get("crs")
    about = crs.get("properties") if isinstance(crs, dict) else None
    name = about.get("name") if isinstance(about, dict) else None
    if crs is not None and name is None:
        warnings.warn(f"The coordinate system of {what} is not read: no name.", stacklevel=4)
    return shapes, None if name is None else named_system(name, what)


def _of_gis(path, what):
    """The shapes of a file that GDAL reads with their names, and its system.

    GDAL reads in a process of its own, which ends where a damaged file lets it die or never end.
    """
    import shapely

    needs("files", "pyogrio")
    must = f"outlines of a GIS ({path.suffix})"
    with reading(path, "polygon", must), tempfile.TemporaryDirectory() as folder:
        for part in path.parent.glob(f"{path.stem}.*"):  # an index is made beside a shapefile
            if part == path or path.suffix.lower() == ".shp":
                shutil.copy(part, folder)
        order = [sys.executable, "-P", "-c", GDAL, str(Path(folder) / path.name)]
        seconds = GDAL_S + path.stat().st_size / 1e6
        done = subprocess.run(order, capture_output=True, check=True, timeout=seconds)
        systems, rows = json.loads(done.stdout)
        shapes = [(_name(known), shapely.from_wkb(shape)) for known, shape in rows]
    system = next(filter(None, systems), None)
    return shapes, None if system is None else named_system(system, what)


def _name(fields):
    """What the fields of an outline call it; None without a name."""
    plain = {str(name).lower(): value for name, value in fields.items()}
    return next((plain[name] for name in NAME_FIELDS if plain.get(name) not in (None, "")), None)


def _rings(shape):
    """The vertices of a shape's polygons with their holes; a line that is closed is one, too."""
    import shapely

    for part in shapely.get_parts(shape):
        if part.geom_type in ("MultiPolygon", "GeometryCollection"):
            yield from _rings(part)
        closed = part.geom_type == "LineString" and part.is_closed
        if part.geom_type == "Polygon" or closed:
            lines = [part] if closed else [part.exterior, *part.interiors]
            outline, *holes = (shapely.get_coordinates(one, include_z=part.has_z) for one in lines)
            yield np.concatenate([outline, *(np.append(h, outline[:1], axis=0) for h in holes)])


def plan_extent(source: str | os.PathLike, crs: object = None) -> np.ndarray:
    """Return the least and the largest easting and northing of outlines in the cloud's system."""
    text = str(source)
    if ";" in text and not is_file(source):
        rings = [read_polygon(source)]
    else:
        _, stored, own = stored_outlines(source)
        rings = [_in_system(ring, own, crs, f"polygon {source}") for ring in stored]
    plan = np.concatenate([ring[:, :2] for ring in rings])
    return np.array([plan.min(axis=0), plan.max(axis=0)])


def _in_system(ring, own, crs, what):
    """A ring in the cloud's system."""
    narrow = np.abs(ring[:, :2]).max() <= 180 and np.ptp(ring[:, :2], axis=0).max() < NARROWEST_M
    if own is None and narrow and crs is not None:
        own = named_system("OGC:CRS84", what)
    refuse(own is None and narrow, what, "it looks like degrees", "projected, in metres")
    if own is not None and crs is not None and not own.to_2d().equals(crs.to_2d(), True):
        import pyproj

        refuse(crs.is_geocentric, "cloud", f"in {crs.name}", "projected, beside outlines")
        to = pyproj.Transformer.from_crs(own.to_2d(), crs.to_2d(), always_xy=True)
        plan = np.stack(to.transform(*ring[:, :2].T), axis=1)
        refuse(not np.isfinite(plan).all(), what, f"outside of {crs.name}", "where the cloud is")
        return np.column_stack([plan, ring[:, 2:]])
    check_same_crs(what, own, "cloud", crs)
    return ring


def _placed(ring, own, crs, points, what):
    """A ring in the cloud's system, with heights."""
    ring = _in_system(ring, own, crs, what)
    flat = ring.shape[1] < 3 or not np.isfinite(ring[:, 2]).all()
    zero = not flat and np.abs(ring[:, :2]).max() > 1000 and not ring[:, 2].any()
    if points is not None and (flat or (zero and points[:, 2].min() > 1)):
        return _laid(ring[:, :2], points, what)
    refuse(flat, what, "vertices without heights", "x, y, z, or beside a cloud")
    if zero:
        warnings.warn(f"All heights of {what} are 0.", stacklevel=4)
    return check_polygon(ring, name=what)


def _laid(plan, points, what):
    """An outline in plan on the plane of the points inside it."""
    import shapely

    middle = plan.mean(axis=0)
    inside = points[shapely.contains_xy(_shape(plan), *points[:, :2].T)]
    refuse(len(inside) < 3, what, f"{len(inside)} points inside it", "over the cloud")
    sides = np.column_stack([inside[:, :2] - middle, np.ones(len(inside))])
    near = np.ones(len(inside), bool)
    for _ in range(10):  # again without what stands on the surface
        slope = np.linalg.lstsq(sides[near], inside[near, 2], rcond=None)[0]
        off = np.abs(inside[:, 2] - sides @ slope)
        near = off <= FAR_OFF * np.median(off)
    warnings.warn(f"The outlines of {what} have no heights: laid onto the cloud.", stacklevel=5)
    heights = (plan - middle)[:, 0] * slope[0] + (plan - middle)[:, 1] * slope[1] + slope[2]
    return check_polygon(np.column_stack([plan, heights]), name=what)


def _shape(vertices):
    """A polygon with its holes."""
    import shapely

    rings = [vertices[rows] for rows in polygon_rings(vertices)]
    return shapely.Polygon(rings[0], rings[1:])


def write_outlines(
    path: str | os.PathLike, outlines: Mapping[str, ArrayLike], *, crs: CRS | None = None
) -> None:
    """Write named outlines, each of shape (m, 3), as GeoJSON or GeoPackage.

    :func:`read_outlines` reads them back to the bit.

    Parameters
    ----------
    path : path
        Its ending says which: ``.geojson``, ``.json`` or ``.gpkg``.
    outlines : dict of str to array_like, shape (m, 3)
        Vertices in metres.
    crs : pyproj.CRS, optional
        Of the vertices.

    Raises
    ------
    ValueError
        If there is none, or the ending is another.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_outlines(f"{folder}/o.geojson", {"wall": [[0, 0, 0], [1, 0, 0], [1, 0, 0.1]]})
    ...     [(name, len(ring)) for name, ring in read_outlines(f"{folder}/o.geojson")]
    [('wall', 3)]
    """
    ending = check_choice(Path(path).suffix.lower(), "ending", (*JSON_ENDINGS, ".gpkg"))
    refuse(not outlines, "outlines", "none", "one or more")
    rings = {name: check_polygon(ring, name=f"outline {name}") for name, ring in outlines.items()}
    if ending == ".gpkg":
        import shapely

        pyogrio = needs("files", "pyogrio")
        shapes = np.array([shapely.to_wkb(_shape(ring)) for ring in rings.values()], dtype=object)
        names = [np.array([*map(str, rings)], dtype=object)]
        layout = {"geometry_type": "Polygon Z", "driver": "GPKG", "layer": "outlines"}
        wkt = None if crs is None else crs.to_wkt()
        write_atomically(
            path, lambda file: pyogrio.raw.write(file, shapes, names, ["name"], crs=wkt, **layout)
        )
        return
    features = [
        {
            "type": "Feature",
            "properties": {"name": str(name)},
            "geometry": _shape(ring).__geo_interface__,
        }
        for name, ring in rings.items()
    ]
    node: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if crs is not None:
        node["crs"] = {"type": "name", "properties": {"name": crs.to_string()}}
    write_atomically(path, json.dumps(node))


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
    check_choice(Path(path).suffix.lower(), "ending", JSON_ENDINGS)
    write_atomically(path, json.dumps(_shape(check_polygon(vertices)).__geo_interface__))
