"""What leaves the house: a table of poles as CSV, GeoJSON or GeoPackage, and a page to check it.

The page has a map and a picture of each pole, the doubtful ones first. Whoever checks it accepts or
rejects each and saves the decisions as a file, which ``mmqa poles --decisions`` reads.
"""

from __future__ import annotations

import base64
import json
import os
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_metres
from mmqa_lab.io import read_table, write_atomically
from mmqa_lab.poles.common import beside, near_axis, rows
from mmqa_lab.poles.scores import match

TABLE = "poles"

GATE_M = 0.3
"""A decision is about the pole found that near to where it was decided."""

DECISIONS = ("accept", "reject")

PIXEL_M = 0.05
HALF_M = 2.0
HIGHEST_M = 12.0
MAP_PIXELS = 1000
"""Pictures show 2 m to either side and 12 m of height at 5 cm a pixel; the map's longer side."""

GEOPACKAGE = """
PRAGMA application_id = 0x47504B47;
PRAGMA user_version = 10300;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
  description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT PRIMARY KEY, data_type TEXT NOT NULL,
  identifier TEXT UNIQUE, description TEXT DEFAULT '',
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
  srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL UNIQUE REFERENCES gpkg_contents,
  column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys, z TINYINT NOT NULL, m TINYINT NOT NULL,
  PRIMARY KEY (table_name, column_name));
"""
"""The tables that every GeoPackage has (OGC 12-128r18, annex C)."""


def write_poles(path: str | os.PathLike, table: pd.DataFrame, *, crs: object = None) -> None:
    """Write a table of poles as CSV, GeoJSON or GeoPackage, after the ending of the file.

    Parameters
    ----------
    path : path
        ``.csv``, ``.geojson`` or ``.gpkg``. Points stand at ``x_m``, ``y_m``, ``z_base_m``.
    table : DataFrame
        Of :func:`mmqa_lab.poles.detect`, metres.
    crs : pyproj.CRS or what it is made from, optional
        Of the coordinates. A CSV file does not name it. GeoJSON names it as GDAL does, in the
        member ``crs``: RFC 7946 knows longitudes and latitudes alone.

    Raises
    ------
    ValueError
        If the file has another ending, or the coordinate system is unknown or not in metres.

    Examples
    --------
    >>> import tempfile
    >>> table = pd.DataFrame({"x_m": [2.0], "y_m": [3.0], "z_base_m": [0.5], "class": ["trunk"]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_poles(f"{folder}/poles.geojson", table, crs="EPSG:25832")
    ...     json.loads(Path(f"{folder}/poles.geojson").read_text())["features"][0]["geometry"]
    {'type': 'Point', 'coordinates': [2.0, 3.0, 0.5]}
    """
    import pyproj

    path = check_ending(path)
    crs = check_metres(None if crs is None else pyproj.CRS(crs), "poles")
    write_atomically(path, lambda temporary: WRITERS[path.suffix](temporary, table, crs))


def check_ending(path):
    """Return the path of a file that poles can be written to."""
    path = Path(path)
    if path.suffix not in WRITERS:
        raise ValueError(f"Invalid file {path}. Must end in {', '.join(WRITERS)}.")
    return path


def _write_csv(path, table, crs):
    """The table alone."""
    table.to_csv(path, index=False)


def _write_geojson(path, table, crs):
    """Points in the coordinates of the cloud; null: not measurable."""
    features = []
    for row in _plain_rows(table):
        place = [round(row[name], 4) for name in ("x_m", "y_m", "z_base_m")]
        rest = {name: value for name, value in row.items() if name not in ("x_m", "y_m")}
        geometry = {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": geometry, "properties": rest})
    made = {"type": "FeatureCollection", "name": TABLE, "features": features}
    authority = None if crs is None else crs.to_authority()
    if authority is not None:
        name = "urn:ogc:def:crs:{}::{}".format(*authority)
        made["crs"] = {"type": "name", "properties": {"name": name}}
    path.write_text(json.dumps(made, indent=1), encoding="utf-8")


def _write_geopackage(path, table, crs):
    """Points as a layer of their own."""
    kinds = {"i": "INTEGER", "u": "INTEGER", "f": "REAL", "b": "BOOLEAN"}
    columns = {name: kinds.get(table[name].dtype.kind, "TEXT") for name in table}
    number, system = _system(crs)
    names = ", ".join(f'"{name}" {kind}' for name, kind in columns.items())
    marks = ", ".join("?" * (len(columns) + 1))
    low, high = (table[["x_m", "y_m"]].agg(end).tolist() for end in ("min", "max"))
    with closing(sqlite3.connect(path)) as file, file:
        file.executescript(GEOPACKAGE)
        for one in {0: _system(None, 0), -1: _system(None, -1), number: (number, system)}.values():
            file.execute("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, NULL)", one[1])
        file.execute(f"CREATE TABLE {TABLE} (fid INTEGER PRIMARY KEY, geom POINT, {names})")
        file.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, min_x, min_y, max_x, "
            "max_y, srs_id) VALUES (?, 'features', ?, ?, ?, ?, ?, ?)",
            (TABLE, TABLE, *low, *high, number),
        )
        file.execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', 'POINT', ?, 1, 0)",
            (TABLE, number),
        )
        quoted = ", ".join(f'"{name}"' for name in ["geom", *columns])
        points = ((_point(row, number), *row.values()) for row in _plain_rows(table))
        file.executemany(f"INSERT INTO {TABLE} ({quoted}) VALUES ({marks})", points)


def _system(crs, unknown=-1):
    """Number of a coordinate system in a GeoPackage, and its row; -1 and 0 are undefined ones."""
    if crs is None:
        kind = {-1: "cartesian", 0: "geographic"}[unknown]
        return unknown, (f"Undefined {kind}", unknown, "NONE", unknown, "undefined")
    authority = crs.to_authority()
    organization, code = authority if authority is not None else ("NONE", "100000")
    number = int(code) if code.isdigit() else 100_000
    return number, (crs.name, number, organization, number, crs.to_wkt("WKT1_GDAL"))


def _point(row, number):
    """A place as the binary geometry of a GeoPackage: header, then well-known binary with z."""
    header = struct.pack("<2sBBi", b"GP", 0, 1, number)
    return header + struct.pack("<BI3d", 1, 1001, row["x_m"], row["y_m"], row["z_base_m"])


def _plain_rows(table):
    """Rows as dicts of plain Python values, None for what is not measurable."""
    return table.astype(object).where(table.notna(), None).to_dict(orient="records")


WRITERS = {".csv": _write_csv, ".geojson": _write_geojson, ".gpkg": _write_geopackage}


def read_decisions(path):
    """Return the decisions that a page saved: ``x_m``, ``y_m``, ``decision``.

    Raises
    ------
    ValueError
        If the file has other columns or a decision is neither accept nor reject.
    """
    table = read_table(path, "decisions", ("x_m", "y_m", "decision"))
    for decision in table["decision"]:
        check_choice(decision, f"decision in {path}", DECISIONS)
    return table


def with_decisions(table, decisions):
    """Return poles with what was decided about each, and the number of decisions about no pole."""
    pairs = match(table, decisions[["x_m", "y_m"]], gate=GATE_M)
    decided = np.full(len(table), "", dtype=object)
    decided[pairs["detection"]] = decisions["decision"].to_numpy()[pairs["reference"]]
    return table.assign(decision=decided), len(decisions) - len(pairs)


def write_report(path, points, table, *, title, lines=()):
    """Write a page with a map, and a picture and the figures of each pole, doubtful ones first.

    Parameters
    ----------
    path : Path
    points : array, shape (n, 3)
        The cloud, metres.
    table : DataFrame
        Of :func:`mmqa_lab.poles.detect`; a column ``decision`` is shown as decided.
    title : str
    lines : sequence of str
        What else is said at the top.
    """
    from jinja2 import Environment, FileSystemLoader

    doubt = table[["score", "class_probability"]].min(axis=1)
    shown = table.assign(decision=table.get("decision", ""), doubt=1 - doubt)
    shown["picture"] = [_data(picture) for picture in _pictures(points, table)]
    plan, frame = _plan_picture(points, table)
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    text = environment.get_template("report.html.j2").render(
        title=title,
        lines=lines,
        plan=_data(plan),
        frame=frame,
        poles=shown.sort_values("doubt", ascending=False).to_dict("records"),
    )
    write_atomically(path, text)


def _pictures(points, table):
    """Yield a picture of each pole: from the south and, right of it, from the west."""
    middle = table[["x_m", "y_m"]].to_numpy()
    chosen = points[beside(points, middle, 2 * HALF_M)]
    found = rows(chosen)
    for at, one in zip(middle, table.itertuples(), strict=True):
        near = found.points[near_axis(*found[:3], *at, 1.5 * HALF_M)]
        foot = one.z_base_m + one.height_m - np.nan_to_num(one.total_height_m, nan=one.height_m)
        local = near - [*at, min(foot, one.z_base_m) - 0.5]
        views = [_side(local[:, [axis, 2]], local[:, 1 - axis]) for axis in (0, 1)]
        both = np.hstack([views[0], np.full((len(views[0]), 4), 255, np.uint8), views[1]])
        dark = np.flatnonzero((both < 255).any(axis=1))
        yield both[max(dark[0] - 4, 0) :] if len(dark) else both


def _side(across, depth):
    """Points (n, 2) across and up as dark pixels; what stands farther off in depth is paler."""
    wide, high = round(2 * HALF_M / PIXEL_M), round(HIGHEST_M / PIXEL_M)
    column, row = np.floor((across + [HALF_M, 0]) / PIXEL_M).astype(int).T
    inside = (column >= 0) & (column < wide) & (row >= 0) & (row < high)
    shade = np.where(np.abs(depth) < 0.5, 0, 170).astype(np.uint8)
    picture = np.full((high, wide), 255, np.uint8)
    np.minimum.at(picture, (high - 1 - row[inside], column[inside]), shade[inside])
    return picture


def _plan_picture(points, table):
    """The cloud from above in grey, and the places of the poles in it as pixels."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    pixel = max((high - low).max() / MAP_PIXELS, 0.05)
    wide, tall = (np.floor((high - low) / pixel).astype(int) + 1).tolist()
    column, row = np.floor((points[:, :2] - low) / pixel).astype(int).T
    count = np.bincount((tall - 1 - row) * wide + column, minlength=wide * tall)
    dark = np.log1p(count) / np.log1p(max(count.max(), 1))
    picture = (255 - 150 * dark).astype(np.uint8).reshape(tall, wide)
    place = (table[["x_m", "y_m"]].to_numpy() - low) / pixel
    spots = {
        int(i): (float(x), float(tall - y)) for i, (x, y) in zip(table["id"], place, strict=True)
    }
    return picture, {"width": wide, "height": tall, "spots": spots, "metres": wide * pixel}


def _data(picture):
    """A grey picture as PNG in a data address."""
    import cv2

    coded = cv2.imencode(".png", picture)[1].tobytes()
    return "data:image/png;base64," + base64.b64encode(coded).decode()
