"""Clouds in LAS and LAZ files, and what their headers must not contradict."""

from __future__ import annotations

import os
import re
import struct
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_columns, check_points, refuse
from mmqa_lab.cloud import Cloud, extent
from mmqa_lab.io.files import check_bytes, reading, write_atomically
from mmqa_lab.io.marks import FLAGS, Piece
from mmqa_lab.io.outlines import plan_extent
from mmqa_lab.io.systems import las_system

__all__ = ["LAS_ENDINGS", "address_of", "copc_pieces", "las_pieces", "write_cloud"]

LAS_ENDINGS = (".las", ".laz")

LEAST, LARGEST = -(2**31), 2**31 - 1
LAS = "a complete LAS or LAZ file"
COPC = "a COPC file whose host answers, also to ranges"

# Points that are fetched from an address without an outline, and around an outline, m.
MOST_FETCHED, MARGIN_M = 5_000_000, 1.0

# Points of a chunk of LAZ, and of all, that need no larger file.
LARGEST_CHUNK = 1_000_000

# Degrees per unit of the LAS 1.4 field ``scan_angle`` (LAS 1.4 R15, point formats 6-10).
SCAN_ANGLE_STEP = 0.006

LONGEST_NAME = 32

# Names of columns that a LAS file uses itself.
NO_COLUMN = ("x", "y", "z", "xyz", "header")

# The first format in layers, and how many formats 6 to 10 have without extra bytes.
FIRST_LAYERED, LAYERS = 6, (9, 10, 11, 10, 12)

# Bytes of the head of a record before the points.
RECORD_HEAD = 54


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
        If the ending is another, the cloud has no points or is too wide for the step, or a column
        has a value that its field cannot hold.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab.io import read_cloud
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
    fields = {one.name: one for one in header.point_format.dimensions}
    columns = {name: _storable(name, cloud[name], fields.get(name)) for name in cloud.columns}
    for name in columns.keys() - fields.keys():
        header.add_extra_dim(laspy.ExtraBytesParams(name, columns[name].dtype))
    las = laspy.LasData(header)
    las.xyz = points
    for name, values in columns.items():
        las[name] = values
    write_atomically(path, lambda temporary: las.write(str(temporary)))


def _storable(name, values, field):
    """The values of a column as LAS holds them; what it cannot hold gives one sentence."""
    if values.ndim != 1 or values.dtype.kind not in "biuf":
        raise ValueError(f"Invalid column {name!r}. Must be one number for each point.")
    if name.lower() in NO_COLUMN or len(name.encode()) > LONGEST_NAME:
        wanted = f"other than {', '.join(NO_COLUMN)} and at most {LONGEST_NAME} letters long"
        raise ValueError(f"Invalid column name {name!r}. Must be {wanted}.")
    if field is None or field.name == "gps_time":
        odd = values.dtype.kind == "f" and values.dtype.itemsize not in (4, 8)
        kind = np.float64 if odd else np.uint8 if values.dtype.kind == "b" else values.dtype
        return values.astype(kind)
    angle = name == "scan_angle"
    low, high = (-180, 180) if angle else (field.min, field.max)
    numbers = values.astype(np.float64)
    bad = ~((numbers >= low) & (numbers <= high)) | ((numbers % 1 != 0) & (not angle))
    if bad.any():
        row, kind = int(bad.argmax()), "degrees" if angle else "whole numbers"
        wanted = f"{kind} from {low} to {high}"
        raise ValueError(f"Invalid {name} {values[row]} in row {row + 1}. Must be {wanted}.")
    return np.round(numbers / SCAN_ANGLE_STEP if angle else numbers).astype(np.int64)


def _check_sizes(path):
    """Raise where records or chunks are said to be larger than their file, before they are read.

    A library believes what a header says, and works for hours on it or ends the process.
    """
    with Path(path).open("rb") as file:
        head = file.read(375).ljust(375, b"\0")
        length, at_points, count = struct.unpack_from("<HII", head, 94)
        extended, more = struct.unpack_from("<QI", head, 235) if head[25] >= 4 else (0, 0)
        size, chunk, place = Path(path).stat().st_size, 0, length
        if length + 54 * count > min(at_points, size) or extended + 60 * more > size:
            raise ValueError("more records than bytes")
        for _ in range(count):
            file.seek(place)
            record = file.read(54).ljust(54, b"\0")
            place += 54 + struct.unpack_from("<H", record, 20)[0]
            if record[2:16] == b"laszip encoded":
                chunk = struct.unpack_from("<I", file.read(16).ljust(16, b"\0"), 12)[0]
        if place > at_points or max(LARGEST_CHUNK, size) < chunk < 2**32 - 1:
            raise ValueError("records behind the first point, or a chunk of too many points")


def _plain_source(path):
    """What to give to the reader of LAS: the path, or a copy with plain letters in its names.

    Letters beside ASCII in identifiers and descriptions are replaced by question marks there.
    """
    with Path(path).open("rb") as file:
        start, points, records = struct.unpack("<94xHII", file.read(104))
        file.seek(0)
        before = bytearray(file.read(points))
        spans, at = [slice(26, 90)], start
        for _ in range(records):
            spans += [slice(at + 2, at + 18), slice(at + 22, at + RECORD_HEAD)]
            at += RECORD_HEAD + struct.unpack("<H", before[at + 20 : at + 22])[0]
        if all(bytes(before[span]).isascii() for span in spans):
            return path
        for span in spans:
            before[span] = bytes(byte if byte < 128 else ord("?") for byte in before[span])
        return BytesIO(bytes(before) + file.read())


def las_pieces(path, chunk, columns):
    """Return the pieces of a LAS or LAZ file."""
    import laspy

    with path.open("rb") as file:
        version = (*file.read(26)[24:], 1, 4)[:2]
    newer = not (1, 0) <= version <= (1, 4)
    refuse(newer, f"cloud {path}", f"LAS {version[0]}.{version[1]}", "LAS 1.0 to 1.4")
    with reading(path, "cloud", LAS):
        _check_sizes(path)
        reader = laspy.open(_plain_source(path))
    with reader:
        header, read = reader.header, 0
        count = header.point_count
        check_bytes(path, f"cloud {path}", f"{count} points", count, LAS, few=LARGEST_CHUNK)
        _check_header(path, header)
        extra = len(header.vlrs.get("ExtraBytesVlr"))
        if extra > 1:
            told = f"Read the first of {extra} records of extra bytes of {path}."
            warnings.warn(told, stacklevel=4)
        about = {"resolution": float(max(header.scales)), "crs": las_system(header, path)}
        names = [n for n in header.point_format.dimension_names if n not in ("X", "Y", "Z")]
        if columns is not None:
            check_columns(names, columns, f"cloud {path}")
            names = [name for name in names if name in columns or name in FLAGS]
        low, high = header.mins - 2 * header.scales, header.maxs + 2 * header.scales
        parts = reader.chunk_iterator(chunk)
        while True:
            with reading(path, "cloud", LAS):
                part = next(parts, None)
                if part is None:
                    break
                points, attributes = _taken(part, names)
                raw = [np.asarray(part[axis]) for axis in "XYZ"]
            read += len(points)
            over = outside = np.zeros(1, bool)
            for axis in raw:
                if axis.min() == LEAST or axis.max() == LARGEST:
                    over = over | (axis == LEAST) | (axis == LARGEST)
            box = extent(points)
            if not ((box[0] >= low) & (box[1] <= high)).all():
                outside = ((points < low) | (points > high)).any(axis=1)
            left = {"hold the least or largest integer, an overflow of their 32 bits": over}
            said = {"lie outside the box that its header states": outside}
            yield Piece(points, attributes, about, header.point_count, left, said)
    found = f"bytes for {read} points where the header says {header.point_count}"
    refuse(read < header.point_count, f"cloud {path}", found, LAS)


def _taken(part, names):
    """The points and columns of a part as laspy holds it."""
    columns = {name: np.array(part[name]) for name in names}
    if "scan_angle" in columns:
        columns["scan_angle"] = columns["scan_angle"] * SCAN_ANGLE_STEP
    return np.stack([part.x, part.y, part.z], axis=1), columns


def address_of(path: str | os.PathLike) -> str:
    """The address that a path spells, also with one slash as pathlib leaves it; "" for a file."""
    found = re.fullmatch(r"(https?):/+(.+)", str(path).replace("\\", "/"))
    return f"{found[1]}://{found[2]}" if found else ""


def copc_pieces(address, columns, within):
    """The points of a COPC file at an address, around the outlines of ``within`` if it is given."""
    import laspy

    with reading(address, "cloud", COPC):
        reader = laspy.CopcReader.open(address)
        header = reader.header
    crs, count = las_system(header, address), header.point_count
    found, wanted = f"{count} points at an address", f"at most {MOST_FETCHED}, or with an outline"
    refuse(within is None and count > MOST_FETCHED, f"cloud {address}", found, wanted)
    box = None
    if within is not None:
        low, high = plan_extent(within, crs) + [[-MARGIN_M], [MARGIN_M]]
        box = laspy.copc.Bounds(low, high)
    with reading(address, "cloud", COPC):
        part = reader.query(box)
        names = [name for name in header.point_format.dimension_names if name not in "XYZ"]
        names = [name for name in names if columns is None or name in (*columns, *FLAGS)]
        points, attributes = _taken(part, names)
    about = {"resolution": float(max(header.scales)), "crs": crs}
    yield Piece(points, attributes, about, len(points))


def _check_header(path, header):
    """Raise where a LAS header contradicts itself or its file."""
    scales = ", ".join(f"{scale:g}" for scale in header.scales)
    usable = np.isfinite(header.scales).all() and (header.scales > 0).all()
    refuse(not usable, f"cloud {path}", f"scale {scales} in its header", "above 0")
    with Path(path).open("rb") as file:
        (legacy,) = struct.unpack("<107xI", file.read(111))
    if header.are_points_compressed:
        with reading(path, "cloud", LAS):
            held = _laz_points(path, header)
    else:
        behind = (header.start_of_first_evlr, header.start_of_waveform_data_packet_record)
        end = min([Path(path).stat().st_size, *filter(None, behind)])  # 0 where there is none
        held = (end - header.offset_to_point_data) // header.point_format.size
        held = max(held, header.point_count)  # where it is cut short is said when it is read
    held = max(held, legacy if header.point_count == 0 else 0)
    found = f"{held or 'another number of'} points where the header says {header.point_count}"
    refuse(held != header.point_count, f"cloud {path}", found, "as many")


def _laz_points(path, header):
    """How many points the chunks of a LAZ file hold.

    The table of chunks stands where the points begin to say, or the last bytes of a file that was
    written as a stream. A damaged one would ask for any amount of memory. Chunks of formats 6 to 10
    begin with a point, their number of points and the bytes of each layer (LASzip's ``layered``
    chunks).
    """
    import lazrs

    record = header.vlrs.get_by_id("laszip encoded")[0].record_data
    vlr, size, first = lazrs.LazVlr(record), header.point_format.size, header.offset_to_point_data
    with Path(path).open("rb") as file:
        for place, whence in ((first, 0), (-8, 2)):
            file.seek(place, whence)
            (table,) = struct.unpack("<q", file.read(8))
            if table != -1:
                break
        file.seek(table)
        if struct.unpack("<4xI", file.read(8))[0] > Path(path).stat().st_size:
            raise ValueError("more chunks than bytes")
        file.seek(first)
        chunks = lazrs.read_chunk_table(file, vlr)
        ends = first + 8 + np.cumsum([0, *(length for _, length in chunks)])
        if ends[-1] != table:
            raise ValueError("chunks that do not reach from the first point to their table")
        if header.point_format.id < FIRST_LAYERED and chunks:
            return _pointwise(file, record, header, chunks, ends)
        held, kind = 0, header.point_format
        layers = LAYERS[kind.id - FIRST_LAYERED] + kind.num_extra_bytes
        for end, (_, length) in zip(ends, chunks, strict=False):
            file.seek(end + size)
            count, *sizes = struct.unpack(f"<{1 + layers}I", file.read(4 * (1 + layers)))
            if sum(sizes) > length:
                raise ValueError("layers of more bytes than their chunk")
            held += count
        return held


def _pointwise(file, record, header, chunks, ends):
    """How many points the chunks of formats 0 to 5 hold; 0 if all that is known is not as many.

    The last chunk has no count: its bytes must be those of the points that the header leaves to it.
    """
    import lazrs

    size, most = header.point_format.size, sum(count for count, _ in chunks)
    before = most - chunks[-1][0]
    if not before < header.point_count <= most:
        return before + 1 if header.point_count <= before else most
    file.seek(ends[-2])
    stored = file.read(chunks[-1][1]).rstrip(b"\0")
    file.seek(header.offset_to_point_data)
    reader = lazrs.LasZipDecompressor(file, record)
    reader.seek(before)
    points = bytearray((header.point_count - before) * size)
    reader.decompress_many(points)
    again = bytes(lazrs.compress_points(lazrs.LazVlr(record), bytes(points), False))
    written = again[8 : struct.unpack("<q", again[:8])[0]].rstrip(b"\0")
    return header.point_count if written == stored else 0
