"""Text tables, the paths of vehicles, polygons and segments; files written whole.

The layout of a text file is found out from its first lines, its columns from their names.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import warnings
from collections.abc import Callable
from itertools import islice, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mmqa_lab._checks import (
    WEEK_S,
    check_choice,
    check_columns,
    check_crs,
    check_file,
    check_metres,
    coordinate_columns,
)
from mmqa_lab._polygons import CrsNotCompared, polygon_parts

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from shapely import MultiPolygon, Polygon



def write_atomically(path: str | os.PathLike, write: Callable | str | pd.DataFrame) -> None:
    """Call ``write(temporary_path)`` and put the file in its place only when that succeeded.

    The temporary file lies in the same folder and has the same ending; it is removed when
    ``write`` fails.

    Parameters
    ----------
    path : path
        Folders are made where missing; an existing file is replaced.
    write : callable, str or DataFrame
        Takes the path of the temporary file. A text is written as it is, a table as CSV without its
        index.

    Raises
    ------
    OSError
        If no file can be made there.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "f.txt", "whole")
    ...     [path.name for path in Path(folder).iterdir()]
    ['f.txt']
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    _check_writable(path, temporary)
    try:
        if isinstance(write, pd.DataFrame):
            write.to_csv(temporary, index=False)
        elif isinstance(write, str):
            temporary.write_text(write, encoding="utf-8")
        else:
            write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _check_writable(path, temporary):
    """Raise one sentence where no file can be made beside ``path``; folders are made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        temporary.unlink()
    except OSError as error:
        raise OSError(
            f"Invalid file {path}: {error.strerror}. Must lie in a folder that can be written to."
        ) from error


@contextlib.contextmanager
def damage_named(path, wanted):
    """Turn whatever a reader raises on a damaged file into one sentence."""
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # the Rust reader of LAZ panics outside of Exception
        reason = first_sentence(error)
        raise ValueError(f"Invalid cloud {path}: {reason}. Must be {wanted}.") from error


def first_sentence(error):
    """The first line of an error's text, without its full stop."""
    lines = str(error).strip().splitlines()
    return (lines[0] if lines else type(error).__name__).rstrip(". ")


SAMPLED_LINES = 50
"""Lines of data that are looked at to find out the layout."""

HIGHEST_M, EARTH_M = 20_000.0, (6.33e6, 6.41e6)
"""No height of a point is larger; least and largest distance of points from the earth's centre."""

FASTEST_M_S = 150.0
"""No vehicle or helicopter is faster."""

TRAJECTORY_COLUMNS = {
    "time_s": ("time_s", "time", "gps_time", "gpstime", "t"),
    "easting_m": ("easting_m", "easting", "east", "x_m", "x"),
    "northing_m": ("northing_m", "northing", "north", "y_m", "y"),
    "height_m": ("height_m", "height", "altitude", "up", "z_m", "z"),
    "roll_deg": ("roll_deg", "roll"),
    "pitch_deg": ("pitch_deg", "pitch"),
    "heading_deg": ("heading_deg", "heading", "yaw"),
}


def read_trajectory(
    path: str | os.PathLike, *, time_unit: str = "s", angle_unit: str = "degrees"
) -> pd.DataFrame:
    """Read a vehicle's path from a CSV file with a header.

    Parameters
    ----------
    path : path
        Needs time, easting, northing and height under any usual name; roll, pitch and heading
        are read when present.
    time_unit : {"s", "ms", "us"}
    angle_unit : {"degrees", "radians"}

    Returns
    -------
    DataFrame
        ``time_s``, ``easting_m``, ``northing_m``, ``height_m`` and, where present,
        ``roll_deg``, ``pitch_deg``, ``heading_deg``; in the order of time.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a needed column is missing, a value is no finite number, a time repeats, the seconds of
        a GPS week begin again, or no vehicle is as fast.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "path.csv").write_text("time,x,y,z,heading\\n500,0,0,2,90\\n")
    ...     path = read_trajectory(Path(folder) / "path.csv", time_unit="ms")
    >>> path[["time_s", "height_m", "heading_deg"]].to_numpy().tolist()
    [[0.5, 2.0, 90.0]]
    """
    path = Path(path)
    seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
    check_choice(time_unit, "time_unit", tuple(seconds))
    check_choice(angle_unit, "angle_unit", ("degrees", "radians"))
    raw = read_table(path, "trajectory", encoding_errors="replace")
    lower = {str(name).strip().lower(): name for name in raw.columns}
    found = {}
    for column, names in TRAJECTORY_COLUMNS.items():
        present = next((lower[name] for name in names if name in lower), None)
        if present is not None:
            found[column] = raw[present]
    check_columns(found, list(TRAJECTORY_COLUMNS)[:4], f"trajectory {path}")
    table = with_numbers(pd.DataFrame(found), list(found), f"trajectory {path}")
    table["time_s"] *= seconds[time_unit]
    if angle_unit == "radians":
        angles = [column for column in table if column.endswith("_deg")]
        table[angles] = np.degrees(table[angles])
    if (table["time_s"].diff() < -WEEK_S / 2).any() and table["time_s"].max() <= WEEK_S:
        raise ValueError(f"Invalid trajectory {path}: the week begins again. Must count on.")
    table = table.sort_values("time_s", ignore_index=True)
    if (table["time_s"].diff() <= 0).any():
        raise ValueError(f"Invalid trajectory {path}: a time repeats. Must be distinct times.")
    moved = np.linalg.norm(table[["easting_m", "northing_m", "height_m"]].diff(), axis=1)
    speed = moved / table["time_s"].diff()
    if speed.max() > FASTEST_M_S:
        raise ValueError(
            f"Invalid trajectory {path}: {speed.max():.4g} m/s in line {speed.argmax() + 2} by time"
            f". Must be {FASTEST_M_S:g} m/s at most; is the unit of time right?"
        )
    return table


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
        If there is no polygon, or its coordinate system is not in metres.

    Warns
    -----
    UserWarning
        If a GeoJSON file states a coordinate system: the vertices do not carry it. Where a cloud is
        evaluated with the path itself, both are compared.

    Examples
    --------
    >>> read_polygon("0,0,0; 1,0,0; 1,1,0").shape
    (3, 3)
    """
    text = str(source)
    if ";" in text:
        vertices = _inline(text)
    elif check_file(source, "polygon").suffix.lower() in (".json", ".geojson"):
        return _from_geojson(Path(source))
    else:
        vertices, _ = next(text_tables(Path(source), 1_000_000))
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
    write_atomically(path, text)


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
        parts = polygon_parts(SimpleNamespace(__geo_interface__=node), name=f"polygon {path}")
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"Invalid polygon {path}. Must be GeoJSON with a polygon of 3-D vertices."
        ) from error
    if len(parts) == 1 and len(parts[0]) == 1:
        return parts[0][0]
    polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in parts]
    return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)


def stated_crs(path):
    """The coordinate reference system that a GeoJSON file names; None where none, or not known."""
    path = Path(path)
    if path.suffix.lower() in (".json", ".geojson") and path.is_file():
        with contextlib.suppress(
            ValueError, KeyError, AttributeError, TypeError
        ):  # told where vertices are read
            return check_crs(_crs_name(json.loads(path.read_text(encoding="utf-8"))["crs"]))
    return None


def _crs_name(member):
    """The name in a GeoJSON member ``crs``."""
    return str(member.get("properties", {}).get("name", member))


def _remark_on_crs(path, member):
    """Say that a stated coordinate system is not compared here, or refuse one not in metres."""
    if member is None:
        return
    stated = _crs_name(member)
    known = stated_crs(path)
    check_metres(known, f"polygon {path}")
    warnings.warn(
        f"{path} states the coordinate system {stated}; it is taken for that of the cloud.",
        CrsNotCompared,
        stacklevel=4,
    )


def text_tables(path, chunk):
    """Yield points (n, 3) and attributes of a text file, at most ``chunk`` points at a time."""
    choices, coordinates = _layout_of(path)
    same = {"header": None, "comment": "#", "skipinitialspace": True, "index_col": False}
    frames = _read_csv(path, chunksize=chunk, **same, **choices)
    with damage_named(path, "rows of numbers, x y z first or named in a header"):
        for frame in frames:
            points = frame[coordinates].apply(pd.to_numeric, errors="raise")
            rest = frame.columns.drop(coordinates)
            yield points.to_numpy(dtype="float64"), {name: frame[name].to_numpy() for name in rest}


def read_table(path, name, columns=(), encoding_errors="strict", **choices):
    """Return a CSV file as a table, or raise a sentence where it is none or a column is missing.

    Names must be UTF-8: a letter that cannot be read would make another name of it. Semicolons
    between columns are read too, then with decimal commas where there are some.
    """
    choices = {"skipinitialspace": True, "encoding_errors": encoding_errors} | choices
    with open(check_file(path, name), encoding="utf-8-sig", errors="replace") as file:
        head = file.readline()
        if head.count(";") > head.count(","):
            choices |= {"sep": ";", "decimal": "," if re.search(r"\d,\d", file.read()) else "."}
    table = _read_csv(path, name, **choices)
    check_columns(table, columns, f"{name} {path}")
    return table


def with_numbers(table, columns, name):
    """Return a table with finite numbers in these columns; a sentence names the first bad line."""
    check_columns(table, columns, name)
    found = table[list(columns)].apply(pd.to_numeric, errors="coerce").astype(float)
    bad = ~np.isfinite(found).all(axis=1)
    if bad.any():
        line = bad.idxmax() + 2
        raise ValueError(f"Invalid {name}: no finite number in line {line}. Must be numbers.")
    return table.assign(**found)


def _read_csv(path, name="table", encoding_errors="replace", **choices):
    """``pandas.read_csv`` with one sentence where the file is no table."""
    choices |= {"encoding": "utf-8-sig", "encoding_errors": encoding_errors}
    try:
        return pd.read_csv(path, **choices)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, ValueError) as error:
        reason = first_sentence(error)
        raise ValueError(f"Invalid {name} {path}: {reason}. Must be rows of columns.") from error


def _layout_of(path):
    """How pandas is to read a text file, and its columns of x, y and z; from its first lines."""
    before, lines = _first_lines(path)
    if len(lines) > 1 and lines[0][1].isdigit() and len(_words(lines[1][1])) > 1:
        lines = lines[1:]  # the count of points in front of PTS files
    skip, first = lines[0]
    separator = _separator(lines[-1][1])
    header = None
    if not _is_data(_words(first, separator)):
        header, skip, lines = _words(first), skip + 1, lines[1:]
    rows = [_words(line, separator) for _, line in lines]
    comma = separator != "," and any("," in word for row in rows for word in row)
    names = header or _commented_names(before, rows)
    if names is None:
        names = _numbered(path, rows)
        coordinates = names[:3]
    else:
        names, coordinates = _named(path, names, rows)
    choices = {"skiprows": skip, "sep": r"\s+" if separator == " " else separator}
    return choices | {"decimal": "," if comma else ".", "names": names}, coordinates


def _first_lines(path):
    """The comments before the first other line; the first of the others with their numbers."""
    before, lines = [], []
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(islice(file, 1000)):
            if line.startswith("//") and not lines:
                before.append(line)
            elif line.split("#")[0].strip():
                lines.append((number, line.split("#")[0].strip()))
            elif not lines:
                before.append(line)
            if len(lines) > SAMPLED_LINES:
                break
    if not lines:
        raise ValueError(f"Invalid table {path}: no rows. Must be rows of columns.")
    return before, lines


def _separator(line):
    """What stands between the words of a line; a comma within a number is its decimal sign."""
    words = line.split()
    if len(words) > 2 and _is_data(words) and all(word.strip(",") == word for word in words):
        return "\t" if "\t" in line else " "
    return next((mark for mark in (";", ",", "\t") if mark in line), " ")


def _words(line, separator=None):
    """The words of a line, between the marks that stand in it where none is given."""
    separator = separator or _separator(line)
    words = line.split() if separator == " " else line.split(separator)
    return [word.strip().strip('"') for word in words]


def _is_data(words):
    """Whether a line has numbers rather than names."""
    try:
        [float(word.replace(",", ".")) for word in words if word]
    except ValueError:
        return False
    return True


def _commented_names(before, rows):
    """The names of the columns from the last comment, where it has names for x, y, z and all."""
    comments = [line.strip().lstrip("#/").strip() for line in before if line.strip()]
    if not comments or not rows:
        return None
    words = _words(comments[-1])
    named = len(words) == len(rows[0]) and len(coordinate_columns(words)) == 3
    return words if named else None


def _named(path, names, rows):
    """The names of the columns, each once, and those of x, y, z."""
    if rows and len(rows[0]) != len(names):
        raise ValueError(
            f"Invalid table {path}: {len(names)} names over {len(rows[0])} columns. "
            "Must be a name for each column."
        )
    unique = [
        name if name and name not in names[:place] else f"{name or 'column'}_{place + 1}"
        for place, name in enumerate(names)
    ]
    coordinates = coordinate_columns(unique)
    if len(coordinates) < 3:
        raise ValueError(
            f"Invalid table {path} with columns {', '.join(unique)}. "
            "Must have x, y, z or easting, northing, height."
        )
    return unique, coordinates


def _numbered(path, rows):
    """Names for columns without any: x, y, z and the numbers of the others."""
    count = len(rows[0])
    if count < 3:
        raise ValueError(
            f"Invalid table {path}: {count} columns. Must be rows of numbers, x y z first."
        )
    said = _no_place(pd.DataFrame(rows).replace(",", ".", regex=True))
    if said:
        raise ValueError(f"Invalid table {path}: {said}. Must have a header that names x, y, z.")
    return ["x", "y", "z", *(f"column_{k + 1}" for k in range(3, count))]


def _no_place(rows):
    """What in the first rows of a table without names speaks against x, y, z as first columns."""
    values = rows.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    first, counted = values[:, 0], np.arange(len(values))
    whole = (values % 1 == 0).all(axis=0)
    if values.shape[1] > 3 and len(values) > 2:
        if any(np.array_equal(first, counted + start) for start in (0, 1)):
            return "its first column numbers the rows"
        for before, said in ((1, "its first column has"), (3, "its first three columns have")):
            after = whole[before : before + 3]
            if whole[:before].all() and len(after) == 3 and np.ptp(first) > 0 and not after.any():
                return f"{said} whole numbers, the next three have not"
    away = np.linalg.norm(values[:, :3], axis=1)
    geocentric = (EARTH_M[0] < away) & (away < EARTH_M[1])
    high = values[np.isfinite(away) & ~geocentric & (np.abs(values[:, 2]) > HIGHEST_M), 2]
    if len(high):
        return f"its third column has {high[0]:.10g}, which is no height"
    return ""


SEGMENT_COLUMNS = ("x1", "y1", "z1", "x2", "y2", "z2")


def read_segments(path: str | os.PathLike) -> np.ndarray:
    """Read line segments from a CSV or text file, GeoJSON or DXF.

    Parameters
    ----------
    path : path
        GeoJSON: the pieces of all LineStrings and MultiLineStrings. DXF in metres (needs
        ``ezdxf``): the straight pieces of all LINE, LWPOLYLINE and POLYLINE entities, those of
        blocks too; arcs and points are left out. Other files: a segment in a line: six
        numbers x1, y1, z1, x2, y2, z2 in metres, separated by commas, semicolons or white space.
        A header is optional; one with the names x1, y1, z1, x2, y2, z2
        may have them in any order among others. ``#`` begins a comment.

    Returns
    -------
    array, shape (n, 2, 3)
        Metres; none for a file with a header alone.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a file is damaged or ``ezdxf`` is not installed; if a line lacks six finite numbers or a
        segment has no length; names the line.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "edges.csv"
    >>> _ = file.write_text("x1,y1,z1,x2,y2,z2\\n0,0,0,0,0,12\\n0,0,12,9,0,12\\n")
    >>> read_segments(file).tolist()
    [[[0.0, 0.0, 0.0], [0.0, 0.0, 12.0]], [[0.0, 0.0, 12.0], [9.0, 0.0, 12.0]]]
    """
    from mmqa_lab.lines.segments import check_segments

    path = check_file(path, "segments")
    if path.suffix.lower() in SEGMENT_READERS:
        pieces = [
            pair for chain in SEGMENT_READERS[path.suffix.lower()](path) for pair in pairwise(chain)
        ]
        return check_segments(np.array(pieces, dtype=np.float64).reshape(-1, 2, 3))
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"Invalid segments {path}: no text. Must be lines of numbers.") from error
    # the words of a line without its comment; empty ones between two commas
    words = (re.split(r"\s*[,;]\s*|\s+", line.split("#")[0].strip()) for line in lines)
    rows = {number: row for number, row in enumerate(words, start=1) if any(row)}
    if not rows:
        raise ValueError(f"Invalid segments {path}: empty. Must have a header or lines of numbers.")
    first, places = next(iter(rows)), range(6)
    if all(_number(word) is None for word in rows[first]):
        places = _places(path, rows.pop(first))
    ends = [_ends(path, number, row, places) for number, row in rows.items()]
    return check_segments(np.array(ends).reshape(-1, 2, 3))


def write_segments(path: str | os.PathLike, segments: ArrayLike) -> None:
    """Write line segments as CSV with a header, to the last bit, whole or not at all.

    Parameters
    ----------
    path : path
        An existing file is replaced.
    segments : array_like, shape (n, 2, 3)

    Raises
    ------
    ValueError
        If a segment is not finite or has no length.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_segments(f"{folder}/edges.csv", [[[0, 0, 0], [0, 0, 2.5]]])
    ...     read_segments(f"{folder}/edges.csv").tolist()
    [[[0.0, 0.0, 0.0], [0.0, 0.0, 2.5]]]
    """
    from mmqa_lab.lines.segments import check_segments

    frame = pd.DataFrame(
        check_segments(segments).reshape(-1, 6), columns=list(SEGMENT_COLUMNS)
    )
    write_atomically(path, frame)


def _chains_of_geojson(path):
    """Vertices (n, 3) of each line of a GeoJSON file; those without a height lie at 0."""
    try:
        node = json.loads(path.read_text(encoding="utf-8-sig"))
        features = node.get("features", [node])
        geometries = [feature.get("geometry", feature) for feature in features]
        chains = []
        for geometry in geometries:
            if geometry["type"] == "LineString":
                chains.append(geometry["coordinates"])
            elif geometry["type"] == "MultiLineString":
                chains += geometry["coordinates"]
        return [[(*vertex, 0.0)[:3] for vertex in chain] for chain in chains]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"Invalid segments {path}. Must be GeoJSON with lines of 3-D vertices."
        ) from error


def _chains_of_dxf(path):
    """Ends of each straight line of a DXF file, those of blocks and polylines too."""
    try:
        import ezdxf
        from ezdxf.disassemble import recursive_decompose
    except ImportError as error:
        raise ValueError(
            f"Invalid segments {path}: ezdxf is not installed. Must be CSV or GeoJSON without it."
        ) from error
    try:
        drawing = ezdxf.readfile(path)
    except (OSError, StopIteration, ezdxf.DXFError) as error:
        raise ValueError(f"Invalid segments {path}. Must be a DXF file.") from error
    if drawing.units not in (0, 6):  # none stated, or metres
        unit = ezdxf.units.unit_name(drawing.units)
        raise ValueError(f"Invalid segments {path} in {unit} ($INSUNITS). Must be in metres.")
    found = recursive_decompose(drawing.modelspace().query("LINE LWPOLYLINE POLYLINE INSERT"))
    pieces = (one.virtual_entities() if "POLY" in one.dxftype() else [one] for one in found)
    lines = [one.dxf for part in pieces for one in part if one.dxftype() == "LINE"]
    return [[tuple(line.start), tuple(line.end)] for line in lines if line.start != line.end]


SEGMENT_READERS = {
    ".geojson": _chains_of_geojson,
    ".json": _chains_of_geojson,
    ".dxf": _chains_of_dxf,
}


def _places(path, names):
    """The places of x1 to z2 among a header's names."""
    plain = [name.lower().strip('"') for name in names]
    if all(column in plain for column in SEGMENT_COLUMNS):
        return [plain.index(column) for column in SEGMENT_COLUMNS]
    if len(names) > len(SEGMENT_COLUMNS):
        raise ValueError(
            f"Invalid segments {path} with columns {', '.join(names)}. "
            f"Must have {', '.join(SEGMENT_COLUMNS)}."
        )
    return range(6)


def _ends(path, number, words, places):
    """The six words as finite numbers, or the sentence that names the line."""
    values = [_number(words[place]) for place in places if place < len(words)]
    if len(values) < 6 or any(value is None or not np.isfinite(value) for value in values):
        raise ValueError(
            f"Invalid segments {path}: {' '.join(words)[:60]!r} in line {number}. "
            "Must be six finite numbers x1,y1,z1,x2,y2,z2."
        )
    if values[:3] == values[3:]:
        raise ValueError(f"Invalid segments {path}: no length in line {number}. Must have one.")
    return values


def _number(word):
    """A word as a float, None where it is none."""
    try:
        return float(word)
    except ValueError:
        return None
