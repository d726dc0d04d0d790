"""Every file in and out: clouds, polygons, trajectories, lines, heights and images.

Files are written whole or not at all. A damaged file gives one sentence. Functions of other rooms
take arrays; columns, units and coordinate systems of files are checked here.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    check_choice,
    check_columns,
    check_file,
    check_points,
    check_polygon,
    check_same_crs,
)
from mmqa_lab.cloud import Cloud, unit_remarks

LAS_ENDINGS = (".las", ".laz")
TIFF_ENDINGS = (".tif", ".tiff")
IMAGES = "a complete JPEG, PNG or TIFF file of 8 or 16 bits"
CLOUD_ENDINGS = (*LAS_ENDINGS, ".ply", ".txt", ".csv", ".xyz")

# Degrees per unit of the LAS 1.4 field ``scan_angle`` (LAS 1.4 R15, point formats 6-10).
SCAN_ANGLE_STEP = 0.006

# Names of numpy's types in PLY, besides its own: int8, float32, ...
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
PLY_TYPES |= {"float": "f4", "double": "f8"}

PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

# Columns of tables that are taken for coordinates, the first that are there.
PLAN_NAMES = (("x", "y"), ("easting", "northing"), ("east", "north"))
HEIGHT_NAMES = ("z", "height", "elevation", "altitude", "up")

# Columns of a vehicle's path, and other names of them.
PATH_COLUMNS = ["time_s", "easting_m", "northing_m", "height_m"]
PATH_COLUMNS += ["roll_deg", "pitch_deg", "heading_deg"]
PATH_NAMES = {"time": "time_s", "gps_time": "time_s", "t": "time_s", "yaw": "heading_deg"}
PATH_NAMES |= {"roll": "roll_deg", "pitch": "pitch_deg", "heading": "heading_deg"}

SEGMENT_COLUMNS = ["x1", "y1", "z1", "x2", "y2", "z2"]

# Numbers as large as this are no heights; -9999 and -32768 stand for none.
NO_HEIGHT_M = 9999.0


def write_atomically(path: str | os.PathLike, write: Callable | str | pd.DataFrame) -> None:
    """Call ``write(temporary_path)`` and put the file in its place only when that succeeded.

    Parameters
    ----------
    path : path
        Folders are made where missing; an existing file is replaced, of a symbolic link the file
        that it names.
    write : callable, str or DataFrame
        Takes the path of the temporary file, which has the same ending. A text is written as it
        is, a table as CSV without its index.

    Raises
    ------
    OSError
        If no file can be made there, or something is there that is no file, as a device.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "f.txt", "whole")
    ...     [path.name for path in Path(folder).iterdir()]
    ['f.txt']
    """
    path = Path(path).resolve()
    if path.exists() and not path.is_file():
        raise OSError(f"Invalid file {path}: a folder or device. Must be a file.")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise OSError(f"Invalid file {path}: {error.strerror}. Must be writable.") from error
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


def read_cloud(path: str | os.PathLike, *, columns: Sequence[str] | None = None) -> Cloud:
    """Read a cloud file whole.

    Parameters
    ----------
    path : path
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), PLY (``.ply``) or text (``.txt``, ``.csv``,
        ``.xyz``). Columns of text stand between white space, commas or semicolons; a header names
        x, y, z or easting, northing, height, in any order among others; without a header x, y, z
        come first. ``#`` and ``//`` begin a comment.
    columns : sequence of str, optional
        The per-point columns to keep; all when not given.

    Returns
    -------
    Cloud
        Points in float64. Columns are kept as read, but for ``scan_angle``, which is in degrees.
        Its ``resolution`` is the scale of a LAS header, or the step of single precision at the
        largest coordinate of PLY; NaN else. Its ``crs`` is what a LAS header names.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no cloud, is damaged or cut short, has no points, lacks a column, or is not in
        metres.

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
        raise ValueError(f"Invalid cloud {path}: no points. Must contain one or more.")
    for remark in unit_remarks(cloud, crs=cloud.crs):
        warnings.warn(f"{path}: {remark}", stacklevel=2)
    return cloud


def iterate_cloud(
    path: str | os.PathLike, *, columns: Sequence[str] | None = None, chunk: int = 1_000_000
) -> Iterator[Cloud]:
    """Yield a cloud file in pieces; LAS and LAZ in such of at most ``chunk`` points.

    Parameters and errors are those of :func:`read_cloud`.

    Examples
    --------
    >>> from mmqa_lab import samples
    >>> [len(part) for part in iterate_cloud(samples.path("road_patch"), chunk=20_000)]
    [20000, 8185]
    """
    path = check_file(path, "cloud")
    ending = check_choice(path.suffix.lower(), f"cloud {path} with ending", CLOUD_ENDINGS)
    whole = _ply_cloud if ending == ".ply" else _text_cloud
    pieces = _las_clouds(path, chunk, columns) if ending in LAS_ENDINGS else whole(path)
    for points, attributes, about in pieces:
        if columns is not None:
            check_columns(attributes, columns, f"cloud {path}")
            attributes = {name: attributes[name] for name in columns}
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            lost = f"{(~finite).sum()} of {len(points)} points of {path}"
            warnings.warn(f"Dropped {lost} whose coordinates are not finite.", stacklevel=2)
        kept = {name: values[finite] for name, values in attributes.items()}
        yield Cloud(points[finite], kept, path.stem, **about)


def write_cloud(path: str | os.PathLike, cloud: Cloud | ArrayLike, *, scale: float = 0.001) -> None:
    """Write a cloud as LAS or LAZ 1.4, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in ``.las`` or ``.laz``; an existing file is replaced.
    cloud : Cloud or array_like, shape (n, 3)
        Columns that LAS knows (``gps_time`` in seconds, ``intensity``, ``scan_angle`` in
        degrees, ``classification``, ...) go to their fields, the others to extra dimensions. Its
        ``crs`` goes to the header.
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
    import laspy

    check_choice(Path(path).suffix.lower(), "ending", LAS_ENDINGS)
    cloud = cloud if isinstance(cloud, Cloud) else Cloud(cloud)
    points = check_points(cloud.points)
    if not np.ptp(points, axis=0).max() < scale * 2**31:
        raise ValueError(f"Invalid scale {scale}. Must be coarser for a cloud as wide as this.")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, scale), np.floor(points.min(axis=0))
    if cloud.crs is not None:
        header.add_crs(cloud.crs)
    for name in cloud.columns.keys() - set(header.point_format.dimension_names):
        values = cloud[name]
        if values.ndim != 1 or values.dtype.kind not in "fiu":
            raise ValueError(f"Invalid column {name!r}. Must be one number for each point.")
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype))
    las = laspy.LasData(header)
    las.xyz = points
    for name, values in cloud.columns.items():
        las[name] = values
    if "scan_angle" in cloud:
        wrapped = (np.asarray(cloud["scan_angle"], dtype=np.float64) + 180) % 360 - 180
        las["scan_angle"] = np.round(wrapped / SCAN_ANGLE_STEP).astype(np.int16)
    write_atomically(path, lambda temporary: las.write(str(temporary)))


@contextlib.contextmanager
def _damage_named(path, wanted, name="cloud"):
    """Turn any error of a reader on a damaged file into one sentence."""
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # the Rust reader of LAZ panics outside of Exception
        reason = (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(". ")
        raise ValueError(f"Invalid {name} {path}: {reason}. Must be {wanted}.") from error


def _las_clouds(path, chunk, columns):
    """Points, attributes, and resolution and coordinate system of a LAS or LAZ file's pieces."""
    import laspy

    with _damage_named(path, "a complete LAS or LAZ file"), laspy.open(path) as reader:
        header, read = reader.header, 0
        names = [n for n in header.point_format.dimension_names if n not in ("X", "Y", "Z")]
        if columns is not None:
            names = [name for name in names if name in columns]
        about = {"resolution": float(max(header.scales)), "crs": _las_crs(path, header)}
        for part in reader.chunk_iterator(chunk):
            read += len(part)
            attributes = {name: np.array(part[name]) for name in names}
            if "scan_angle" in attributes:
                attributes["scan_angle"] = attributes["scan_angle"] * SCAN_ANGLE_STEP
            yield np.stack([part.x, part.y, part.z], axis=1), attributes, about
        if read < header.point_count:
            raise ValueError(f"bytes for {read} points where the header says {header.point_count}")


def _las_crs(path, header):
    """The coordinate reference system that a LAS header names; None without one."""
    try:
        return header.parse_crs()
    except Exception:
        warnings.warn(f"{path} names a coordinate system that is not known.", stacklevel=2)


def _ply_cloud(path):
    """Yield points, attributes and the resolution of a PLY file's vertices, its first element."""
    with _damage_named(path, "a PLY file with vertices x, y, z"), open(path, "rb") as file:
        lines = iter(lambda: file.readline().decode("ascii").split(), ["end_header"])
        words = list(islice(lines, 1000))
        order = next(PLY_ORDERS[row[1]] for row in words if row[0] == "format")
        first, *others = [k for k, row in enumerate(words) if row[0] == "element"] + [len(words)]
        count = int(words[first][2])
        fields = [row for row in words[first : others[0]] if row[0] == "property"]
        kind = np.dtype([(row[-1], PLY_TYPES.get(row[1], row[1])) for row in fields])
        if order:
            rows = np.frombuffer(file.read(count * kind.itemsize), kind.newbyteorder(order))
        else:
            rows = np.loadtxt(file, dtype=kind, max_rows=count, ndmin=1)
        if len(rows) != count:
            raise ValueError(f"{len(rows)} points where the header says {count}")
        points = np.stack([rows[axis] for axis in "xyz"], axis=1)
        largest = np.abs(points[np.isfinite(points)]).max(initial=0)
        step = float(np.spacing(largest)) if points.dtype.itemsize == 4 else np.nan
        rest = {field: np.array(rows[field]) for field in kind.names if field not in "xyz"}
        yield points.astype(np.float64), rest, {"resolution": step}


def _text_cloud(path):
    """Yield points and attributes of a text file."""
    table = _read_text(path, "cloud")
    names = coordinate_columns(table.columns)
    if len(names) < 3:
        listed = ", ".join(map(str, table.columns))
        raise ValueError(f"Invalid cloud {path} with columns {listed}. Must have x, y, z.")
    points = with_numbers(table, names, f"cloud {path}", finite=False)[names]
    rest = {name: table[name].to_numpy() for name in table.columns.drop(names)}
    yield points.to_numpy(), rest, {}


def _read_text(path, name):
    """A text file as a table; columns without names are x, y, z, column_4, column_5, ..."""
    with open(check_file(path, name), encoding="utf-8-sig", errors="replace") as file:
        lines = [line.strip() for line in islice(file, 60)]
    rows = [k for k, line in enumerate(lines) if line and not line.startswith(("#", "//"))]
    if not rows:
        raise ValueError(f"Invalid {name} {path}: no rows. Must be rows of columns.")
    first, separator = rows[0], _separator(lines[rows[-1]])
    names, comma = None, separator != "," and "," in lines[rows[-1]]
    if not _is_data(_words(lines[first])):
        names, first = _words(lines[first]), first + 1
    elif first and len(coordinate_columns(_words(lines[first - 1].lstrip("#/ ")))) == 3:
        names = _words(lines[first - 1].lstrip("#/ "))
    layout = {"header": None, "comment": "#", "skiprows": first, "decimal": "," if comma else "."}
    table = _read_csv(path, name, sep=separator, **layout)
    return _with_names(table, names, f"{name} {path}")


def _read_csv(path, name, **layout):
    """A file as pandas reads it; a file that pandas cannot read gives one sentence."""
    try:
        return pd.read_csv(path, skipinitialspace=True, encoding="utf-8-sig", **layout)
    except ValueError as error:  # pandas' own errors and those of decoding are such
        raise ValueError(f"Invalid {name} {path}: {error}. Must be rows of columns.") from error


def _with_names(table, names, what):
    """A table of a text file with the names of its columns."""
    count = len(table.columns)
    if names is not None and len(names) != count:
        raise ValueError(f"Invalid {what}: {len(names)} names over {count} columns. Must agree.")
    if names is None and len(table) > 2 and count > 3:
        first, third = (pd.to_numeric(table[k], errors="coerce") for k in (0, 2))
        if (first.diff()[1:] == 1).all() or (third.abs() > NO_HEIGHT_M).any():
            found = "its first columns are not x, y, z"
            raise ValueError(f"Invalid {what}: {found}. Must have a header that names them.")
    names = names or [*"xyz", *(f"column_{k}" for k in range(4, count + 1))][:count]
    return table.set_axis(names, axis=1)


def _separator(line):
    """The separator of the words of a line; a comma within a number is its decimal sign."""
    for mark in (";", "\t"):
        if mark in line:
            return mark
    words = line.split()
    inside = len(words) > 2 and all(word.strip(",") == word for word in words)
    return "," if "," in line and not (inside and _is_data(words)) else r"\s+"


def _words(line):
    """The words of a line."""
    return [word.strip(' "') for word in re.split(_separator(line), line)]


def _is_data(words):
    """Whether a line has numbers rather than names."""
    try:
        return bool([float(word.replace(",", ".")) for word in words if word])
    except ValueError:
        return False


def coordinate_columns(names: Sequence[str]) -> list[str]:
    """Return which of the columns of a table are x, y and z; fewer where it has not all.

    Case, a unit in brackets or behind ``_`` and white space do not count: ``X``, ``x_m`` and
    ``x [m]`` are x. ``easting``, ``northing`` and ``height`` and a few others are known too.

    Examples
    --------
    >>> coordinate_columns(["id", "Easting", "Northing", "Height (m)"])
    ['Easting', 'Northing', 'Height (m)']
    >>> coordinate_columns(["x_m", "y_m"]), coordinate_columns(["a", "b", "c"])
    (['x_m', 'y_m'], [])
    """
    plain = {_plain_name(name): name for name in reversed(names)}
    plan = next((pair for pair in PLAN_NAMES if all(name in plain for name in pair)), ())
    height = next((name for name in HEIGHT_NAMES if plan and name in plain), None)
    return [plain[name] for name in (*plan, height) if name is not None]


def _plain_name(name):
    """A column's name without case and unit."""
    return re.sub(r"(_m|[\[(]m[\])])$", "", str(name).lower().strip()).strip()


def read_table(path: str | os.PathLike, name: str, columns: Sequence[str] = ()) -> pd.DataFrame:
    """Return a CSV file as a table, or raise a sentence where it is none or a column is missing.

    Semicolons between columns are read too, then with decimal commas where there are some.
    """
    with open(check_file(path, name), encoding="utf-8-sig", errors="replace") as file:
        head, rows = file.readline(), file.read()
    marks = {"sep": ";", "decimal": "," if re.search(r"\d,\d", rows) else "."}
    table = _read_csv(path, name, **(marks if head.count(";") > head.count(",") else {}))
    check_columns(table, columns, f"{name} {path}")
    return table


def with_numbers(
    table: pd.DataFrame, columns: Sequence[str], name: str, *, finite: bool = True
) -> pd.DataFrame:
    """Return a table with numbers in these columns; a sentence names the first bad line."""
    check_columns(table, columns, name)
    found = table[list(columns)].apply(pd.to_numeric, errors="coerce").astype(float)
    bad = ~np.isfinite(found) if finite else found.isna() & table[list(columns)].notna()
    if bad.any(axis=None):
        row = bad.any(axis=1).argmax() + 1
        raise ValueError(f"Invalid {name}: no finite number in row {row}. Must be numbers.")
    return table.assign(**found)


def read_trajectory(path: str | os.PathLike) -> pd.DataFrame:
    """Read a vehicle's path from a CSV file with a header.

    Parameters
    ----------
    path : path
        Needs time in seconds, easting, northing and height in metres under any usual name; roll,
        pitch and heading in degrees are read when present.

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
        If a needed column is missing, a value is no finite number or a time repeats.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "path.csv").write_text("time,x,y,z,heading\\n0.5,0,0,2,90\\n")
    ...     path = read_trajectory(Path(folder) / "path.csv")
    >>> path[["time_s", "height_m", "heading_deg"]].to_numpy().tolist()
    [[0.5, 2.0, 90.0]]
    """
    raw = read_table(path, "trajectory")
    raw.columns = [_plain_name(name) for name in raw.columns]
    names = dict(zip(coordinate_columns(raw.columns), PATH_COLUMNS[1:4], strict=False))
    table = raw.rename(columns=names | PATH_NAMES).filter(PATH_COLUMNS)
    table = with_numbers(table, [*PATH_COLUMNS[:4], *table.columns[4:]], f"trajectory {path}")
    table = table.sort_values("time_s", ignore_index=True)
    if (table["time_s"].diff() <= 0).any():
        raise ValueError(f"Invalid trajectory {path}: a time repeats. Must be distinct times.")
    return table


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
        with _damage_named(text, "'x,y,z; x,y,z; x,y,z'", "polygon"):
            rows = [row.split(",") for row in text.split(";") if row.strip()]
            vertices = np.array(rows, dtype=np.float64)
        return check_polygon(vertices)
    if check_file(source, "polygon").suffix.lower() in (".json", ".geojson"):
        return _polygon_of_geojson(Path(source), crs)
    return check_polygon(next(_text_cloud(Path(source)))[0], name=f"polygon {source}")


def _polygon_of_geojson(path, crs):
    """The one ring of a GeoJSON file's polygon."""
    with _damage_named(path, "GeoJSON with one ring of vertices with heights", "polygon"):
        node = json.loads(path.read_text(encoding="utf-8"))
        stated = node.get("crs", {}).get("properties", {}).get("name")
        if node["type"] == "FeatureCollection":
            (node,) = node["features"]
        (ring,) = node.get("geometry", node)["coordinates"]
        vertices = check_polygon(ring, name="vertices")
    if stated is not None:
        import pyproj

        check_same_crs("polygon", pyproj.CRS(stated), "cloud", crs)
    return vertices


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


def read_segments(path: str | os.PathLike) -> np.ndarray:
    """Read line segments from a CSV or text file.

    Parameters
    ----------
    path : path
        A segment in a line: x1, y1, z1, x2, y2, z2 in metres, between commas, semicolons or white
        space. A header is optional; one with these names may have them in any order among others.

    Returns
    -------
    array, shape (n, 2, 3)
        Both ends of each.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a line lacks six finite numbers; names it.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "edges.csv"
    >>> _ = file.write_text("x1,y1,z1,x2,y2,z2\\n0,0,0,0,0,12\\n0,0,12,9,0,12\\n")
    >>> read_segments(file)[1].tolist()
    [[0.0, 0.0, 12.0], [9.0, 0.0, 12.0]]
    """
    table = _read_text(path, "segments")
    if "x1" not in table and len(table.columns) == 6:
        table = table.set_axis(SEGMENT_COLUMNS, axis=1)
    numbers = with_numbers(table, SEGMENT_COLUMNS, f"segments {path}")
    return numbers[SEGMENT_COLUMNS].to_numpy().reshape(-1, 2, 3)


def read_image(path: str | os.PathLike) -> np.ndarray:
    """Read an image file as grey values, in the type of the file.

    Parameters
    ----------
    path : path
        JPEG, PNG, TIFF or another format that OpenCV decodes, 8 or 16 bits.

    Returns
    -------
    array of uint8 or uint16, shape (rows, columns)

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no image, or cut short.

    Examples
    --------
    >>> import tempfile
    >>> import cv2
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = cv2.imwrite(f"{folder}/dark.png", np.full((4, 6), 1000, np.uint16))
    ...     grey = read_image(f"{folder}/dark.png")
    >>> grey.shape, str(grey.dtype), int(grey.max())
    ((4, 6), 'uint16', 1000)
    """
    import cv2

    with _damage_named(check_file(path, "image"), IMAGES, "image"):
        grey = _pixels(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if grey.dtype.kind != "u" or min(grey.shape) < 3:
            raise ValueError(f"{grey.shape} pixels of type {grey.dtype}")
    return grey


def read_bands(path: str | os.PathLike) -> np.ndarray:
    """Read all bands of an image file, in its type and order; shape (bands, rows, columns)."""
    import cv2
    import tifffile

    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    with _damage_named(check_file(path, "image"), IMAGES, "image"):
        if Path(path).suffix.lower() not in TIFF_ENDINGS:
            bands_last = np.atleast_3d(_pixels(path, flags))[..., ::-1]  # OpenCV begins with blue
            return np.moveaxis(bands_last, 2, 0)
        with tifffile.TiffFile(path) as file:
            page = file.pages[0]
            values = page.asarray()
        return values if page.axes[0] == "S" else np.moveaxis(np.atleast_3d(values), 2, 0)


def _pixels(path, flags):
    """An image as OpenCV decodes it, which fills up what is missing of a JPEG or PNG file."""
    import cv2

    data = Path(path).read_bytes()
    end = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND"}.get(data[:2], b"")
    if end not in data[-4096:]:
        raise ValueError("cut short")
    # OpenCV prints what it dislikes of a file; the sentence of the caller says it
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    pixels = cv2.imread(str(path), flags)
    if pixels is None:
        raise ValueError("no image that can be decoded")
    return pixels


def read_heights(path: str | os.PathLike, *, crs: object = None) -> np.ndarray:
    """Read reference points from a list or a raster.

    Parameters
    ----------
    path : path
        Any file of :func:`read_cloud`, as CSV with x, y, z; or a GeoTIFF of one band.
    crs : pyproj.CRS, optional
        Of the cloud: a file that names another is refused.

    Returns
    -------
    array, shape (n, 3)
        Metres; cells without a height are left out, and those of 9999 m or more above or below.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is neither, is damaged, has no height, or is not in metres.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "levelled.csv").write_text("x,y,z\\n0,0,1.25\\n1,0,1.5\\n")
    ...     read_heights(Path(folder) / "levelled.csv").tolist()
    [[0.0, 0.0, 1.25], [1.0, 0.0, 1.5]]
    """
    raster = check_file(path, "reference").suffix.lower() in TIFF_ENDINGS
    cloud = _raster_cloud(path) if raster else read_cloud(path, columns=())
    check_same_crs(f"reference {path}", cloud.crs, "cloud", crs)
    points = cloud.points[np.abs(cloud.points[:, 2]) < NO_HEIGHT_M]
    return check_points(points, name=f"heights of {path}")


def _raster_cloud(path):
    """The cells of a GeoTIFF that have a height."""
    import cv2
    import pyproj
    import tifffile

    wanted = "a GeoTIFF of one band with north upwards and an EPSG number"
    with _damage_named(path, wanted, "reference"), tifffile.TiffFile(path) as file:
        tags, keys = file.pages[0].tags, file.pages[0].geotiff_tags or {}
        column, row, _, east, north, _ = tags["ModelTiepointTag"].value[:6]
        width, depth, _ = tags["ModelPixelScaleTag"].value
        number = keys.get("ProjectedCSTypeGeoKey", keys.get("GeographicTypeGeoKey"))
        crs = None if number is None else pyproj.CRS(int(number))
        pixels = _pixels(path, cv2.IMREAD_UNCHANGED)
        rows, columns = np.indices(pixels.shape)
        nothing = float(tags.valueof("GDAL_NODATA", default="nan"))
    heights = np.where(pixels == nothing, np.nan, pixels)
    middle = 0.5 if keys.get("GTRasterTypeGeoKey", 1) == 1 else 0.0
    x, y = east + (columns + middle - column) * width, north - (rows + middle - row) * depth
    points = np.stack([x, y, heights], axis=-1)
    return Cloud(points[np.isfinite(heights)], crs=crs)
