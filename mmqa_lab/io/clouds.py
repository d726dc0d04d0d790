"""Clouds of any form: LAS and LAZ here, PLY and text by their rooms; and marks of their points."""

from __future__ import annotations

import os
import struct
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    FARTHEST_M,
    check_choice,
    check_columns,
    check_file,
    check_points,
    refuse,
)
from mmqa_lab.cloud import Cloud, extent, unit_remarks
from mmqa_lab.io.files import reading, write_atomically
from mmqa_lab.io.ply import read_ply
from mmqa_lab.io.systems import las_system
from mmqa_lab.io.tables import text_places

__all__ = ["CLOUD_ENDINGS", "LAS_ENDINGS", "iterate_cloud", "read_cloud", "write_cloud"]

LAS_ENDINGS = (".las", ".laz")
TEXT_ENDINGS = (".txt", ".csv", ".xyz", ".pts", ".asc")
CLOUD_ENDINGS = (*LAS_ENDINGS, ".ply", *TEXT_ENDINGS)

LEAST, LARGEST = -(2**31), 2**31 - 1
LAS = "a complete LAS or LAZ file"

# Degrees per unit of the LAS 1.4 field ``scan_angle`` (LAS 1.4 R15, point formats 6-10).
SCAN_ANGLE_STEP = 0.006

# Columns that tell which records are no points of a surface (LAS 1.4 R15).
FLAGS = ("withheld", "classification", "synthetic", "overlap", "return_number", "number_of_returns")
LONGEST_NAME = 32

FIRST_LAYERED = 6

NOISE = (7, 18)
OLD_OVERLAP = 12

# Heights that stand for none.
NO_DATA = (-9999.0, -99999.0, -999999.0, -32767.0, -32768.0)

# As many records at 0, 0, 0 are no points, and a single one where the others lie this far away.
MOST_ZEROS = 10
FAR_FROM_ZERO_M = 1000.0


class Piece(NamedTuple):
    """A part of a file: its points, columns, ``about`` the cloud; points in all if these are not.

    ``left`` are masks of points to leave out by the reason, ``said`` of points to mention.
    """

    points: np.ndarray
    columns: dict
    about: Mapping = MappingProxyType({})
    total: int = 0
    left: Mapping = MappingProxyType({})
    said: Mapping = MappingProxyType({})


def read_cloud(path: str | os.PathLike, *, columns: Sequence[str] | None = None) -> Cloud:
    """Read a cloud file whole.

    Points that their producer took out of the surface are left out with a count, as the LAS
    standard asks of its readers: withheld ones, and noise (classes 7 and 18), which would widen
    hulls and turn planes. So are records that are no points: coordinates that are not finite, that
    overflowed, or that stand for no data (-9999; 0, 0, 0 far from all others). What is a measured
    surface in the eyes of some is kept with a count: synthetic points, which may be a whole cloud,
    overlap, and later returns of a pulse, since a density counts returns.

    Parameters
    ----------
    path : path
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), PLY (``.ply``) or text (``.txt``, ``.csv``,
        ``.xyz``). Columns of text stand between white space, commas or semicolons; a header names
        x, y, z or easting, northing, height, in any order among others; without a header x, y, z
        come first. ``#``, ``//`` and ``%`` begin a comment. PTS (``.pts``) and ``.asc`` are text.
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
        How many points were dropped or are marked, and what speaks against metres
        (:func:`mmqa_lab.cloud.unit_remarks`).

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
    if ending in LAS_ENDINGS:
        pieces = _las_pieces(path, chunk, columns)
    else:
        ply = ending == ".ply"
        pieces = [Piece(*(read_ply(path) if ply else text_places(path, "cloud", finite=False)))]
    read, dropped, counted = 0, Counter(), Counter()
    for piece in pieces:
        left, said = _marked(piece)
        out = np.any([np.zeros(len(piece.points), bool), *left.values()], axis=0)
        dropped.update({reason: int(mask.sum()) for reason, mask in left.items()})
        counted.update({reason: int((mask & ~out).sum()) for reason, mask in said.items()})
        names = piece.columns if columns is None else columns
        check_columns(piece.columns, names, f"cloud {path}")
        kept, read = ~out if left else slice(None), read + len(out)
        attributes = {name: piece.columns[name][kept] for name in names}
        cloud = Cloud(piece.points[kept], attributes, path.stem, **piece.about)
        if read == len(out):  # the first piece
            share = len(out) / max(piece.total, len(out), 1)
            for remark in unit_remarks(cloud, crs=cloud.crs, share=share):
                warnings.warn(f"{path}: {remark}", stacklevel=3)
        yield cloud
    told = [("Dropped", *row) for row in dropped.items()]
    for verb, reason, count in [*told, *(("Counted", *row) for row in counted.items())]:
        warnings.warn(f"{verb} {count} of {read} points of {path} that {reason}.", stacklevel=3)


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
    if name.lower() in ("x", "y", "z") or len(name.encode()) > LONGEST_NAME:
        wanted = f"other than x, y, z and at most {LONGEST_NAME} letters long"
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


def _las_pieces(path, chunk, columns):
    """The pieces of a LAS or LAZ file."""
    import laspy

    with reading(path, "cloud", LAS):
        reader = laspy.open(path)
    with reader:
        header, read = reader.header, 0
        _check_header(path, header)
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
                attributes = {name: np.array(part[name]) for name in names}
                points = np.stack([part.x, part.y, part.z], axis=1)
                raw = [np.asarray(part[axis]) for axis in "XYZ"]
            read += len(points)
            if "scan_angle" in attributes:
                attributes["scan_angle"] = attributes["scan_angle"] * SCAN_ANGLE_STEP
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
    begin with a point and their number of points (LASzip's ``layered`` chunks).
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
        held = 0
        for end in ends[:-1]:
            file.seek(end + size)
            held += struct.unpack("<I", file.read(4))[0]
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


def _marked(piece):
    """Masks of the points of a piece to leave out, and of those to mention, by the reason."""
    points, none = piece.points, np.zeros(1, np.uint8)
    numbers = {name.lower(): v for name, v in piece.columns.items() if v.dtype.kind in "biuf"}
    withheld, kind, synthetic, overlap, number, returns = (numbers.get(n, none) for n in FLAGS)
    several = number.max(initial=0) > 1 and ((number == 1) & (returns > 1)).any()
    old = kind == OLD_OVERLAP if "overlap" not in numbers else none
    left = {
        **piece.left,
        **_no_points(points),
        "are marked as withheld": withheld > 0,
        "are of a noise class, 7 or 18": (kind == NOISE[0]) | (kind == NOISE[1]),
    }
    said = {
        **piece.said,
        "are marked as synthetic": synthetic > 0,
        "are marked as overlap": (overlap > 0) | (old > 0),
        "are later returns of their pulses": (number > 1) & several,
    }
    whole = len(points)
    return [
        {why: np.broadcast_to(m, whole) for why, m in one.items() if m.any()}
        for one in (left, said)
    ]


def _no_points(points):
    """Masks of rows that are not finite, and of those that stand for no point.

    These have -9999 and the like as height or as easting and northing, or 0, 0, 0 far from others.
    """
    if not len(points):
        return {}
    low, high = extent(points)
    inside = (low > -FARTHEST_M).all() and (high < FARTHEST_M).all()  # false for NaN
    if inside and low.min() > max(NO_DATA) and not ((low <= 0) & (high >= 0)).all():
        return {}
    finite = np.isfinite(points).all(axis=1)
    x, y, z = points.T
    none = np.isin(z, NO_DATA) | ((x == y) & np.isin(x, NO_DATA))
    none |= finite & (np.abs(points) > FARTHEST_M).any(axis=1)
    zeros = (points == 0).all(axis=1)
    others = points[finite & ~zeros & ~none]
    if zeros.any() and len(others):
        middle = np.median(others, axis=0)
        spread = np.median(np.abs(others - middle), axis=0)
        far = (np.abs(middle) > FAR_FROM_ZERO_M + 20 * spread).any()
        none |= zeros & (far or zeros.sum() > MOST_ZEROS)
    return {
        "are not finite": ~finite,
        "stand for no data (-9999 and the like, or 0, 0, 0 far from others)": none,
    }
