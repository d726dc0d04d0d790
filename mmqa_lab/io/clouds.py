"""Clouds from and to files.

LAS, LAZ and COPC are read by laspy, PLY by plyfile (it keeps double precision and every property;
VTK's reader rounds coordinates to float32), PCD by numpy, text by pandas, E57 by pye57 where it is
installed. All of it arrives as :class:`mmqa_lab.cloud.Cloud`.

LAS and LAZ headers are distrusted: what they say is checked before anything is allocated. A damaged
count would otherwise make the readers loop for minutes, or ask for more memory than there is, which
ends the process.
"""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_file, check_points, check_positive
from mmqa_lab.cloud import Cloud, as_cloud
from mmqa_lab.io.tables import damage_named, first_sentence, text_tables, write_atomically

LAS_ENDINGS = (".las", ".laz")
TEXT_ENDINGS = (".txt", ".csv", ".xyz", ".asc", ".pts")
CLOUD_ENDINGS = (*LAS_ENDINGS, ".ply", ".pcd", ".e57", *TEXT_ENDINGS)

PCD_TYPES = {"F": "f", "I": "i", "U": "u"}

SCAN_ANGLE_STEP = 0.006
"""Degrees per unit of the LAS 1.4 field ``scan_angle`` (LAS 1.4 R15, point formats 6-10)."""

LAS_POINT_FORMAT = 6

VLR_HEADER, EVLR_HEADER = 54, 60
"""Bytes of the header of a variable length record and of an extended one (LAS 1.4 R15)."""

LASZIP_CHUNK = 50_000
"""Points in a chunk where the writer does not choose."""

NOISE = (7, 18)
"""Classes of low and high noise (LAS 1.4 R15, table 17)."""

LAYERED = 3
"""The compressor of point formats 6-10 in a LASzip record."""

ITEMS = {
    **{0: (6,), 1: (6, 7), 2: (6, 8), 3: (6, 7, 8), 4: (6, 7, 9), 5: (6, 7, 8, 9)},
    **{6: (10,), 7: (10, 11), 8: (10, 12), 9: (10, 13), 10: (10, 12, 13)},
}
EXTRA_BYTES = (0, 14)
"""Items of a LASzip record by the point format, and those of extra bytes."""

LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of the items of a point (point, RGB, RGB and NIR, wave packet); else one a byte."""

BOX_STEPS, BOX_M = 2.0, 0.02
"""Steps of the coordinates, and metres, by which the points may differ from the header's box."""


def read_cloud(path: str | os.PathLike, *, columns: Sequence[str] | None = None) -> Cloud:
    """Read a cloud file whole.

    Parameters
    ----------
    path : path
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), PLY (``.ply``), PCD (``.pcd``), E57
        (``.e57``, needs pye57, which gives coordinates, intensities and colours), or text
        (``.txt``, ``.csv``, ``.xyz``, ``.asc``, ``.pts``). Columns of text stand between white
        space, commas or semicolons; a header names x, y, z or easting, northing, height, in any
        order among others; without a header x, y, z come first. ``#`` and, before the data, ``//``
        begin a comment; a first line with the count of points is skipped.
    columns : sequence of str, optional
        The per-point columns to keep; all when not given.

    Returns
    -------
    Cloud
        Points in float64. Columns are kept as read, but for ``scan_angle``, which is in degrees.
        Its ``resolution`` is the scale of a LAS header, or the step of single precision at the
        largest coordinate of PLY and PCD; NaN else. Its ``crs`` is what a LAS header names.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no cloud, is damaged or cut short, has no points, or lacks a column.

    Warns
    -----
    UserWarning
        If points with non-finite coordinates were dropped; says how many. If the header of a LAS
        or LAZ file contradicts itself or its points: another count, another box, bytes that
        nothing describes.

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
    return cloud


def iterate_cloud(
    path: str | os.PathLike, *, columns: Sequence[str] | None = None, chunk: int = 1_000_000
) -> Iterator[Cloud]:
    """Yield a cloud file in pieces of at most ``chunk`` points, for files larger than memory.

    PLY and PCD files arrive in one piece, E57 files in a piece for each scan.

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
    chunk = check_count(chunk, "chunk")
    if Path(path).is_dir():
        raise IsADirectoryError(f"Invalid cloud {path}: a folder. Must be a file.")
    path = check_file(path, "cloud")
    ending = path.suffix.lower()
    if ending not in CLOUD_ENDINGS:
        listed = ", ".join(CLOUD_ENDINGS)
        raise ValueError(f"Invalid cloud {path} with ending {ending!r}. Must be one of {listed}.")
    bare = columns is not None and not len(columns)
    for points, attributes, about in _tables(path, ending, chunk, bare):
        yield _finite_cloud(path, points, _chosen(path, attributes, columns), about)


def write_cloud(path: str | os.PathLike, cloud: Cloud, *, scale: float = 0.001) -> None:
    """Write a cloud as LAS or LAZ 1.4, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in ``.las`` or ``.laz``; an existing file is replaced.
    cloud : Cloud, array_like of shape (n, 3) or DataFrame
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
    path = Path(path)
    check_choice(path.suffix.lower(), "ending", LAS_ENDINGS)
    scale = check_positive(scale, "scale", unit="m")
    cloud = as_cloud(cloud)
    check_points(cloud.points)
    if np.ptp(cloud.points, axis=0).max() / scale >= 2**31:
        raise ValueError(f"Invalid scale {scale}. Must be coarser for a cloud as wide as this.")
    las = las_data(cloud, scale)
    write_atomically(path, lambda temporary: las.write(str(temporary)))


def _tables(path, ending, chunk, bare):
    """Points, attributes, and resolution and CRS of a file's pieces."""
    if ending in LAS_ENDINGS:
        with damage_named(path, "a complete LAS or LAZ file"):
            yield from las_tables(path, chunk, bare=bare)
    elif ending in TEXT_ENDINGS:
        yield from ((*table, {}) for table in text_tables(path, chunk))
    else:
        yield from {".ply": ply_tables, ".pcd": pcd_tables, ".e57": e57_tables}[ending](path)


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


def _finite_cloud(path, points, attributes, about):
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
    return Cloud(points, attributes, path.stem, **about)


def las_tables(path, chunk, *, bare=False):
    """Yield points (n, 3), attributes, and scale and CRS, at most ``chunk`` points at a time.

    ``bare`` leaves the attributes out, and compressed where the file's format allows it.

    Raises
    ------
    Exception
        Whatever the readers raise on a damaged file; ``ValueError`` where a check here finds it.
    """
    import laspy

    _check_header(path)
    kinds = laspy.DecompressionSelection
    bare_kinds = kinds.XY_RETURNS_CHANNEL | kinds.Z | kinds.FLAGS | kinds.CLASSIFICATION
    wanted = bare_kinds if bare else kinds.all()
    with laspy.open(path, decompression_selection=wanted) as reader:
        header = reader.header
        if not (np.isfinite([*header.scales, *header.offsets]).all() and min(header.scales) > 0):
            raise ValueError(f"scales {header.scales} and offsets {header.offsets}")
        if header.are_points_compressed:
            _check_compression(path, header)
        doubts = _doubts(path, header)
        names = [n for n in header.point_format.dimension_names if n not in ("X", "Y", "Z")]
        names = [] if bare else names
        about = {"resolution": float(max(header.scales)), "crs": _las_crs(path, header)}
        read, useless, low, high = 0, 0, np.full(3, np.inf), np.full(3, -np.inf)
        for part in reader.chunk_iterator(chunk):
            read += len(part)
            useless += (np.asarray(part.withheld, bool) | np.isin(part.classification, NOISE)).sum()
            attributes = {name: np.array(part[name]) for name in names}
            if "scan_angle" in attributes:
                attributes["scan_angle"] = attributes["scan_angle"] * SCAN_ANGLE_STEP
            points = np.stack([np.asarray(axis) for axis in (part.x, part.y, part.z)], 1)
            if len(points):
                low, high = np.fmin(low, points.min(axis=0)), np.fmax(high, points.max(axis=0))
            yield points, attributes, about
        if read < header.point_count:
            raise ValueError(f"{read} points where the header says {header.point_count}")
        off = np.maximum(np.abs(low - header.mins), np.abs(high - header.maxs))
        if read and not (off <= _box_limits(header)).all():
            doubts.append(f"its points leave or do not fill the header's box, by {off.max():.6g} m")
    for doubt in doubts:
        warnings.warn(f"{path} may be damaged: {doubt}.", stacklevel=2)
    if useless:
        said = f"{useless} of {read} points of {path} are withheld (deleted) or classed as noise"
        warnings.warn(f"{said}. They count.", stacklevel=2)


def las_data(cloud, scale):
    """Return a cloud as laspy's LAS 1.4 data, coordinates in steps of ``scale``."""
    import laspy

    header = laspy.LasHeader(point_format=LAS_POINT_FORMAT, version="1.4")
    header.scales = np.full(3, scale)
    header.offsets = np.floor(cloud.points.min(axis=0))
    if cloud.crs is not None:
        header.add_crs(cloud.crs)
    fields = set(header.point_format.dimension_names)
    for key, values in cloud.columns.items():
        if key not in fields:
            kind = _extra_type(key, values)
            header.add_extra_dim(laspy.ExtraBytesParams(name=key, type=kind))
    las = laspy.LasData(header)
    las.xyz = cloud.points
    for key, values in cloud.columns.items():
        las[key] = _angle_steps(values) if key == "scan_angle" else values
    return las


def _las_crs(path, header):
    """The coordinate reference system that a LAS header names, None without one."""
    try:
        return header.parse_crs()
    except Exception as error:
        reason = first_sentence(error)
        warnings.warn(
            f"{path} names a coordinate system that is not known: {reason}.", stacklevel=2
        )
        return None


def _check_header(path):
    """Whether the records that the header counts fit into the file."""
    size = path.stat().st_size
    with open(path, "rb") as file:
        head = file.read(375)
    if len(head) < 227 or head[:4] != b"LASF":
        raise ValueError("no LAS header")
    header_size, points_at, records = struct.unpack_from("<HII", head, 94)
    if header_size + VLR_HEADER * records > points_at or points_at > size:
        raise ValueError(f"{records} records before byte {points_at} of {size}")
    if head[25] >= 4 and len(head) >= 247:
        start, extended = struct.unpack_from("<QI", head, 235)
        if extended and not points_at <= start <= size - EVLR_HEADER * extended:
            raise ValueError(f"{extended} extended records from byte {start} of {size}")
        _check_extended(path, start, extended, size)


def _check_extended(path, start, count, size):
    """Whether extended records end within the file; a damaged length would fill the memory."""
    with open(path, "rb") as file:
        for _ in range(count):
            file.seek(start + 20)
            start += EVLR_HEADER + int.from_bytes(file.read(8), "little")
            if start > size:
                raise ValueError(f"an extended record that ends at byte {start} of {size}")


def _doubts(path, header):
    """What in a LAS header does not agree with the file or with itself."""
    doubts, by_return = [], int(np.sum(header.number_of_points_by_return, dtype=np.int64))
    if by_return and by_return != header.point_count:
        doubts.append(f"the returns are {by_return}, the points {header.point_count}")
    if not header.are_points_compressed:
        end = header.start_of_first_evlr if header.number_of_evlrs else path.stat().st_size
        room = (end - header.offset_to_point_data) // header.point_format.size
        if room < header.point_count:  # before memory for them is asked for
            raise ValueError(f"room for {room} points where the header says {header.point_count}")
        if room > header.point_count:
            doubts.append(f"it has room for {room} points, the header says {header.point_count}")
    undescribed = header.point_format.num_extra_bytes and not header.vlrs.get("ExtraBytesVlr")
    if undescribed:
        doubts.append(f"{header.point_format.num_extra_bytes} bytes a point are not described")
    return doubts


def _box_limits(header):
    """By how much the points' extent may differ from the box in a header, along each axis."""
    rounding = 4 * np.spacing(np.abs([header.mins, header.maxs]).max(axis=0))
    return np.fmin(BOX_STEPS * header.scales, BOX_M) + rounding


def _check_compression(path, header):
    """Whether the chunks of a LAZ file are as many and as long as the file."""
    import lazrs

    record = lazrs.LazVlr(header.vlrs.get("LasZipVlr")[0].record_data)
    if record.item_size() != header.point_format.size:
        raise ValueError(f"points of {record.item_size()} bytes, not {header.point_format.size}")
    fixed = not record.uses_variable_size_chunks()
    if fixed and not 0 < record.chunk_size() <= max(header.point_count, LASZIP_CHUNK):
        raise ValueError(f"chunks of {record.chunk_size()} points")
    size, first = path.stat().st_size, header.offset_to_point_data + 8
    with open(path, "rb") as file:
        file.seek(first - 8)
        table = int.from_bytes(file.read(8), "little", signed=True)
        if table == -1:  # written to a stream: the place of the table stands at the end
            file.seek(size - 8)
            table = int.from_bytes(file.read(8), "little", signed=True)
        if not first <= table <= size - 8:
            raise ValueError(f"a table of chunks at byte {table} of {size}")
        file.seek(table + 4)
        chunks = int.from_bytes(file.read(4), "little")
        if chunks > (table - first) // header.point_format.size + 1:
            raise ValueError(f"{chunks} chunks in {table - first} bytes")
        file.seek(first - 8)
        lengths = [length for _, length in lazrs.read_chunk_table(file, record) or []]
    if sum(lengths) > table - first:
        raise ValueError(f"chunks of {sum(lengths)} bytes in {table - first}")
    _check_layers(path, header, first, lengths)


def _check_layers(path, header, first, lengths):
    """Whether points have the items of their format, and layers fit into their chunk.

    A damaged length would fill the memory. A chunk of point formats 6-10
    begins with its first point, the count of points and the lengths of its layers (LAZ
    specification 1.4 R1, layered compression).
    """
    record = header.vlrs.get("LasZipVlr")[0].record_data
    count = int.from_bytes(record[32:34], "little")
    items = np.frombuffer(record[34 : 34 + 6 * count], "<u2")
    kinds, sizes = items[::3].tolist(), items[1::3].tolist()
    wanted = ITEMS.get(header.point_format.id)
    if tuple(kind for kind in kinds if kind not in EXTRA_BYTES) != wanted:
        raise ValueError(f"items {kinds} in points of format {header.point_format.id}")
    if int.from_bytes(record[:2], "little") != LAYERED:
        return
    layers = sum(LAYERS.get(kind, size) for kind, size in zip(kinds, sizes, strict=True))
    head = sum(sizes) + 4
    with open(path, "rb") as file:
        for length in lengths:
            file.seek(first + head)
            found = np.frombuffer(file.read(4 * layers), "<u4").sum(dtype=np.int64)
            if head + 4 * layers + found > length:
                raise ValueError(f"layers of {found} bytes in a chunk of {length}")
            first += length


def _extra_type(name, values):
    """The LAS extra-bytes type of a column."""
    if values.ndim != 1 or values.dtype.kind not in "fiub":
        raise ValueError(
            f"Invalid column {name!r} of type {values.dtype} and shape {values.shape}. "
            "Must be one number for each point."
        )
    return np.uint8 if values.dtype.kind == "b" else values.dtype


def _angle_steps(degrees):
    """Scan angles as LAS 1.4 stores them, -180 to 180 degrees in steps of 0.006."""
    wrapped = (np.asarray(degrees, dtype=np.float64) + 180) % 360 - 180
    return np.round(wrapped / SCAN_ANGLE_STEP).astype(np.int16)


def ply_tables(path):
    """Yield points, attributes and the resolution of coordinates of a PLY file's vertices."""
    from plyfile import PlyData

    with damage_named(path, "a PLY file with vertices x, y, z"):
        vertices = PlyData.read(path)["vertex"].data
        yield _table(vertices)


def pcd_tables(path):
    """Yield points, attributes and the resolution of coordinates of a PCD file (0.7).

    Raises
    ------
    ValueError
        If it is damaged, compressed, or has no x, y, z.
    """
    with damage_named(path, "a PCD file with x, y, z, ascii or binary"), open(path, "rb") as file:
        header = _pcd_header(file)
        fields = _pcd_fields(header)
        count, size = int(header["POINTS"][0]), path.stat().st_size
        kind = header["DATA"][0].lower()
        if kind == "ascii":
            rows = np.loadtxt(file, dtype=fields, ndmin=1, max_rows=count)
        elif kind == "binary":
            rows = np.frombuffer(file.read(min(count * fields.itemsize, size)), fields)
        else:
            raise ValueError(f"data are {kind}")
        if len(rows) != count:
            raise ValueError(f"{len(rows)} points where the header says {count}")
        yield _table(rows)


def e57_tables(path):
    """Yield points, attributes and the resolution of coordinates of an E57 file, scan by scan.

    Raises
    ------
    ValueError
        If pye57 is not installed, or the file is damaged.
    """
    try:
        import pye57
    except ImportError:
        raise ValueError(
            f"Invalid cloud {path}: E57 needs the package pye57. Install it by pip install pye57."
        ) from None
    with damage_named(path, "an E57 file with Cartesian or spherical coordinates"):
        file = pye57.E57(str(path))
        for number in range(file.scan_count):
            scan = file.read_scan(number, intensity=True, colors=True, ignore_missing_fields=True)
            axes = [scan.pop(f"cartesian{axis}") for axis in "XYZ"]
            scan = {name: np.asarray(values) for name, values in scan.items()}
            points = np.stack(axes, axis=1).astype(np.float64)
            yield points, scan, {"resolution": _e57_resolution(file.get_header(number), points)}


def _e57_resolution(header, points):
    """The step of a scan's coordinates before they were placed; NaN for double precision, and for
    scans that give ranges and angles."""
    from pye57 import libe57

    if "cartesianX" not in header.point_fields:
        return np.nan
    node = libe57.StructureNode(header.points.prototype())["cartesianX"]
    if isinstance(node, libe57.ScaledIntegerNode):
        return float(node.scale())
    if node.precision() != libe57.E57_SINGLE or not len(points):
        return np.nan
    return float(np.spacing(np.float32(np.abs(points - header.translation).max())))


def _pcd_header(file):
    """The entries of a PCD header, up to the line before the data."""
    header = {}
    for line in iter(file.readline, b""):
        words = line.decode("ascii").split("#")[0].split()
        if words:
            header[words[0].upper()] = words[1:]
        if "DATA" in header or len(header) > 20:
            break
    return header


def _pcd_fields(header):
    """The type of a PCD file's rows; padding fields get names of their own."""
    names = [name if name != "_" else f"_{k}" for k, name in enumerate(header["FIELDS"])]
    counts = header.get("COUNT", ["1"] * len(names))
    kinds = [PCD_TYPES[t] + size for t, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    parts = zip(names, kinds, map(int, counts), strict=True)
    return np.dtype([(name, kind) if n == 1 else (name, kind, n) for name, kind, n in parts])


def _table(rows):
    """Points, attributes and resolution of an array with fields x, y, z."""
    points = np.stack([rows[axis] for axis in "xyz"], axis=1)
    rest = [name for name in rows.dtype.names if name not in "xyz" and not name.startswith("_")]
    return (
        points.astype(np.float64),
        {name: np.array(rows[name]) for name in rest},
        {"resolution": _resolution(points)},
    )


def _resolution(points):
    """The step of single precision at the largest coordinate; NaN for double precision."""
    finite = points[np.isfinite(points)]
    if points.dtype != np.float32 or not len(finite):
        return np.nan
    return float(np.spacing(np.abs(finite).max()))
