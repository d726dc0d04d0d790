"""Clouds, polygons and trajectories from and to files.

LAS, LAZ and COPC are read by laspy, PLY by plyfile (it keeps double precision and every property;
VTK's reader rounds coordinates to float32), text by pandas. All of it arrives as
:class:`mmqa_lab.cloud.Cloud`.
"""

import contextlib
import json
import os
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_count, check_points, check_positive
from mmqa_lab._las import las_data, las_tables
from mmqa_lab.cloud import Cloud

LAS_ENDINGS = (".las", ".laz")
TEXT_ENDINGS = (".txt", ".csv", ".xyz", ".asc")
CLOUD_ENDINGS = (*LAS_ENDINGS, ".ply", *TEXT_ENDINGS)


def read_cloud(path, *, columns=None):
    """Read a cloud file whole.

    Parameters
    ----------
    path : path
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), PLY (``.ply``), or text (``.txt``, ``.csv``,
        ``.xyz``, ``.asc``: x, y, z first, then any columns; white space or commas; header
        optional; ``#`` begins a comment).
    columns : sequence of str, optional
        The per-point columns to keep; all when not given.

    Returns
    -------
    Cloud
        Points in float64. Columns are kept as read, but for ``scan_angle``, which is in degrees.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no cloud, is damaged or cut short, holds no points, or lacks a column.

    Warns
    -----
    UserWarning
        If points with non-finite coordinates were dropped; says how many.

    Examples
    --------
    >>> from mmqa_lab import samples
    >>> cloud = read_cloud(samples.path("road_patch"))
    >>> len(cloud), "gps_time" in cloud
    (28185, True)
    """
    cloud = Cloud.concatenate(iterate_cloud(path, columns=columns), name=Path(path).stem)
    if not len(cloud):
        raise ValueError(f"Invalid cloud {path}: no points. Must hold one or more.")
    return cloud


def iterate_cloud(path, *, columns=None, chunk=1_000_000):
    """Yield a cloud file in pieces of at most ``chunk`` points, for files larger than memory.

    PLY files arrive in one piece.

    Parameters
    ----------
    path, columns
        See :func:`read_cloud`.
    chunk : int
        Most points of a piece.

    Yields
    ------
    Cloud

    Raises
    ------
    FileNotFoundError, ValueError
        See :func:`read_cloud`.

    Examples
    --------
    >>> from mmqa_lab import samples
    >>> [len(part) for part in iterate_cloud(samples.path("road_patch"), chunk=20_000)]
    [20000, 8185]
    """
    path = Path(path)
    chunk = check_count(chunk, "chunk")
    if not path.is_file():
        raise FileNotFoundError(f"Invalid cloud {path}: no such file. Must exist.")
    ending = path.suffix.lower()
    if ending not in CLOUD_ENDINGS:
        listed = ", ".join(CLOUD_ENDINGS)
        raise ValueError(f"Invalid cloud {path} with ending {ending!r}. Must be one of {listed}.")
    if ending in LAS_ENDINGS:
        bare = columns is not None and not len(columns)
        tables = _sound(las_tables(path, chunk, bare=bare), path, "a complete LAS or LAZ file")
    elif ending == ".ply":
        tables = _ply_tables(path)
    else:
        tables = _text_tables(path, chunk)
    for points, attributes in tables:
        yield _finite_cloud(path, points, _chosen(path, attributes, columns))


def write_cloud(path, cloud, *, scale=0.001):
    """Write a cloud as LAS or LAZ 1.4, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in ``.las`` or ``.laz``; an existing file is replaced.
    cloud : Cloud
        Columns that LAS knows (``gps_time`` in seconds, ``intensity``, ``scan_angle`` in
        degrees, ``classification``, ...) go to their fields, the others to extra dimensions.
    scale : float
        Coordinates are rounded to this step, m.

    Raises
    ------
    ValueError
        If the ending is another, the cloud has no points or is too wide for the step.

    Examples
    --------
    >>> import tempfile
    >>> cloud = Cloud([[500_000.1234, 0, 0]], {"gps_time": np.array([1.5])})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_cloud(Path(folder) / "one.laz", cloud)
    ...     again = read_cloud(Path(folder) / "one.laz")
    >>> again.points[0].round(6).tolist(), again["gps_time"].tolist()
    ([500000.123, 0.0, 0.0], [1.5])
    """
    path = Path(path)
    check_choice(path.suffix.lower(), "ending", LAS_ENDINGS)
    scale = check_positive(scale, "scale", unit="m")
    check_points(cloud.points)
    if np.ptp(cloud.points, axis=0).max() / scale >= 2**31:
        raise ValueError(f"Invalid scale {scale}. Must be coarser for a cloud as wide as this.")
    las = las_data(cloud, scale)
    write_atomically(path, lambda temporary: las.write(str(temporary)))


def write_atomically(path, write):
    """Call ``write(temporary_path)`` and put the file in its place only when that succeeded.

    The temporary file lies in the same folder and has the same ending; it is removed when
    ``write`` fails.

    Parameters
    ----------
    path : path
        Folders are made where missing; an existing file is replaced.
    write : callable
        Takes the path of the temporary file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "f.txt", lambda file: file.write_text("whole"))
    ...     [path.name for path in Path(folder).iterdir()]
    ['f.txt']
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_polygon(source):
    """Read the 3-D vertices of a polygon.

    Parameters
    ----------
    source : path or str
        A CSV file with a vertex in a line (x, y, z; header optional), a GeoJSON file whose first
        polygon has 3-D coordinates, or the vertices themselves: ``"x,y,z; x,y,z; x,y,z"``.

    Returns
    -------
    array, shape (m, 3)
        Metres, m >= 3, in order, the first vertex not repeated at the end.

    Raises
    ------
    FileNotFoundError, ValueError

    Examples
    --------
    >>> read_polygon("0,0,0; 1,0,0; 1,1,0").shape
    (3, 3)
    """
    text = str(source)
    if ";" in text:
        rows = [vertex.split(",") for vertex in text.split(";") if vertex.strip()]
        vertices = _numbers(rows, text)
    elif not Path(source).is_file():
        raise FileNotFoundError(f"Invalid polygon {text}: no such file. Must exist.")
    elif Path(source).suffix.lower() in (".json", ".geojson"):
        vertices = _geojson_vertices(Path(source))
    else:
        points, _ = next(_text_tables(Path(source), 1_000_000))
        vertices = points
    vertices = check_points(vertices, name=f"polygon {text}", minimum=1)
    if len(vertices) > 1 and np.array_equal(vertices[0], vertices[-1]):
        vertices = vertices[:-1]
    return check_points(vertices, name=f"polygon {text}", minimum=3)


def write_polygon(path, vertices):
    """Write 3-D vertices as a GeoJSON polygon that :func:`read_polygon` reads back to the bit.

    Parameters
    ----------
    path : path
        An existing file is replaced.
    vertices : array_like, shape (n, 3)
        Metres, n >= 3.

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
    vertices = check_points(vertices, name="polygon", minimum=3)
    ring = [*vertices.tolist(), vertices[0].tolist()]
    text = json.dumps({"type": "Polygon", "coordinates": [ring]})
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


TRAJECTORY_COLUMNS = {
    "time_s": ("time_s", "time", "gps_time", "gpstime", "t"),
    "easting_m": ("easting_m", "easting", "east", "x_m", "x"),
    "northing_m": ("northing_m", "northing", "north", "y_m", "y"),
    "height_m": ("height_m", "height", "altitude", "up", "z_m", "z"),
    "roll_deg": ("roll_deg", "roll"),
    "pitch_deg": ("pitch_deg", "pitch"),
    "heading_deg": ("heading_deg", "heading", "yaw"),
}


def read_trajectory(path, *, time_unit="s", angle_unit="degrees"):
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
        If a needed column is missing, a value is no finite number, or a time repeats.

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
    if not path.is_file():
        raise FileNotFoundError(f"Invalid trajectory {path}: no such file. Must exist.")
    raw = _read_csv(path, sep=",", skipinitialspace=True)
    lower = {str(name).strip().lower(): name for name in raw.columns}
    found = {}
    for column, names in TRAJECTORY_COLUMNS.items():
        present = next((lower[name] for name in names if name in lower), None)
        if present is not None:
            found[column] = pd.to_numeric(raw[present], errors="coerce").astype(float)
        elif column in ("time_s", "easting_m", "northing_m", "height_m"):
            raise ValueError(f"Invalid trajectory {path}: no column {column!r}. Must have one.")
    table = pd.DataFrame(found)
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        raise ValueError(
            f"Invalid trajectory {path}: no finite number in line {bad.idxmax() + 2}. "
            "Must be numbers throughout."
        )
    table["time_s"] *= seconds[time_unit]
    if angle_unit == "radians":
        angles = [column for column in table if column.endswith("_deg")]
        table[angles] = np.degrees(table[angles])
    table = table.sort_values("time_s", ignore_index=True)
    if (table["time_s"].diff() <= 0).any():
        raise ValueError(f"Invalid trajectory {path}: a time repeats. Must be distinct times.")
    return table


def _sound(tables, path, wanted):
    """The tables of a reader, with whatever it raises turned into one sentence."""
    with _damage_named(path, wanted):
        yield from tables


def _ply_tables(path):
    """Points and attributes of a PLY file's vertices."""
    from plyfile import PlyData

    with _damage_named(path, "a PLY file with vertices x, y, z"):
        vertices = PlyData.read(path)["vertex"].data
        points = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    names = [name for name in vertices.dtype.names if name not in ("x", "y", "z")]
    yield points, {name: np.array(vertices[name]) for name in names}


def _text_tables(path, chunk):
    """Points and attributes of a text file, piece by piece."""
    with open(path, encoding="utf-8", errors="replace") as file:
        first = next((line for line in file if line.split("#")[0].strip()), "")
    separator = "," if "," in first else r"\s+"
    header = None if all(_is_number(word) for word in _words(first, separator)) else 0
    frames = _read_csv(path, sep=separator, header=header, comment="#", chunksize=chunk)
    with _damage_named(path, "rows of numbers, x y z first"):
        for frame in frames:
            if frame.shape[1] < 3:
                raise ValueError(f"{frame.shape[1]} columns")
            coordinates = frame.iloc[:, :3].apply(pd.to_numeric, errors="raise")
            named = {_column_name(c): frame[c].to_numpy() for c in frame.columns[3:]}
            yield coordinates.to_numpy(dtype=np.float64), named


def _read_csv(path, **choices):
    """``pandas.read_csv`` with one sentence where the file is no table."""
    try:
        return pd.read_csv(path, **choices)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        reason = _sentence(error)
        raise ValueError(f"Invalid table {path}: {reason}. Must be rows of columns.") from error


def _words(line, separator):
    return line.split(",") if separator == "," else line.split()


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _column_name(column):
    """The header's name, or a number counted from 1 where there is none."""
    return f"column_{column + 1}" if isinstance(column, int) else str(column).strip()


@contextlib.contextmanager
def _damage_named(path, wanted):
    """Turn whatever a reader raises on a damaged file into one sentence."""
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # the Rust reader of LAZ panics outside of Exception
        reason = _sentence(error)
        raise ValueError(f"Invalid cloud {path}: {reason}. Must be {wanted}.") from error


def _sentence(error):
    """The first line of an error's text, without its full stop."""
    lines = str(error).strip().splitlines()
    return (lines[0] if lines else type(error).__name__).rstrip(". ")


def _chosen(path, attributes, columns):
    """The wanted columns of those read."""
    if columns is None:
        return attributes
    for column in columns:
        if column not in attributes:
            present = ", ".join(attributes) or "none"
            raise ValueError(
                f"Invalid column {column!r} for {path}. Must be one of those present: {present}."
            )
    return {column: attributes[column] for column in columns}


def _finite_cloud(path, points, attributes):
    """A cloud of the finite points, with a warning that counts the others."""
    if not np.isfinite(points).all():
        finite = np.isfinite(points).all(axis=1)
        warnings.warn(
            f"Dropped {(~finite).sum()} of {len(points)} points of {path} whose coordinates are "
            "not finite.",
            stacklevel=3,
        )
        points = points[finite]
        attributes = {key: values[finite] for key, values in attributes.items()}
    return Cloud(points, attributes, Path(path).stem)


def _numbers(rows, text):
    """Rows of words as rows of three numbers."""
    try:
        return np.array([[float(word) for word in row] for row in rows])
    except ValueError as error:
        raise ValueError(f"Invalid polygon {text}. Must be vertices x,y,z; x,y,z; ...") from error


def _geojson_vertices(path):
    """The outer ring of the first polygon of a GeoJSON file."""
    try:
        node = json.loads(path.read_text(encoding="utf-8"))
        if node.get("type") == "FeatureCollection":
            node = node["features"][0]
        if node.get("type") == "Feature":
            node = node["geometry"]
        ring = node["coordinates"][0]
        return np.array([[float(v) for v in vertex] for vertex in ring])
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise ValueError(
            f"Invalid polygon {path}. Must be GeoJSON with a polygon of 3-D vertices."
        ) from error
