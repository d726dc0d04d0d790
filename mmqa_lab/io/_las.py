"""LAS and LAZ files, distrusted: what their headers say is checked before anything is allocated.

A damaged count would otherwise make the readers loop for minutes, or ask for more memory than there
is, which ends the process.
"""

import struct

import numpy as np

SCAN_ANGLE_STEP = 0.006
"""Degrees per unit of the LAS 1.4 field ``scan_angle`` (LAS 1.4 R15, point formats 6-10)."""

LAS_POINT_FORMAT = 6

VLR_HEADER, EVLR_HEADER = 54, 60
"""Bytes of the header of a variable length record and of an extended one (LAS 1.4 R15)."""

LASZIP_CHUNK = 50_000
"""Points in a chunk where the writer does not choose."""


def las_tables(path, chunk, *, bare=False):
    """Yield points (n, 3), attributes and the coarsest scale, at most ``chunk`` points at a time.

    ``bare`` leaves the attributes out, and compressed where the file's format allows it.

    Raises
    ------
    Exception
        Whatever the readers raise on a damaged file; ``ValueError`` where a check here finds it.
    """
    import laspy

    _check_header(path)
    kinds = laspy.DecompressionSelection
    wanted = kinds.XY_RETURNS_CHANNEL | kinds.Z if bare else kinds.all()
    with laspy.open(path, decompression_selection=wanted) as reader:
        header = reader.header
        if header.are_points_compressed:
            _check_compression(path, header)
        names = [n for n in header.point_format.dimension_names if n not in ("X", "Y", "Z")]
        names = [] if bare else names
        read = 0
        for part in reader.chunk_iterator(chunk):
            read += len(part)
            attributes = {name: np.array(part[name]) for name in names}
            if "scan_angle" in attributes:
                attributes["scan_angle"] = attributes["scan_angle"] * SCAN_ANGLE_STEP
            points = np.stack([np.asarray(axis) for axis in (part.x, part.y, part.z)], 1)
            yield points, attributes, float(max(header.scales))
        if read < header.point_count:
            raise ValueError(f"{read} points where the header says {header.point_count}")


def las_data(cloud, scale):
    """Return a cloud as laspy's LAS 1.4 data, coordinates in steps of ``scale``."""
    import laspy

    header = laspy.LasHeader(point_format=LAS_POINT_FORMAT, version="1.4")
    header.scales = np.full(3, scale)
    header.offsets = np.floor(cloud.points.min(axis=0))
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
        if extended and start + EVLR_HEADER * extended > size:
            raise ValueError(f"{extended} extended records from byte {start} of {size}")


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
