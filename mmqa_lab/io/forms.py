"""Clouds as other programs store them: E57 and PTX with the poses of scans, PCD and PLY."""

from __future__ import annotations

import codecs
import re
import struct
import warnings
from io import BytesIO
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import listed, needs, refuse, type_step
from mmqa_lab.io.files import HEAD, PTX_HEAD, check_bytes, plain_text, reading
from mmqa_lab.io.marks import Piece
from mmqa_lab.io.tables import NO_NUMBERS

__all__ = ["e57_pieces", "ptx_pieces", "read_pcd", "read_ply"]

E57 = "a complete E57 file with scans of points"

# Fields that are no columns, and the names of those that LAS has, too.
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ", "cartesianInvalidState")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation", "sphericalInvalidState")
E57_COLUMNS = {"colorRed": "red", "colorGreen": "green", "colorBlue": "blue"}
E57_COLUMNS |= {"rowIndex": "row", "columnIndex": "column", "timeStamp": "time"}


def e57_pieces(path, scan=None):
    """The scans of an E57 file, or the one of this number or name; numbers in a column ``scan``."""
    pye57 = needs("files", "pye57")
    with reading(path, "cloud", E57):
        file = pye57.E57(str(path))
        headers = [file.get_header(number) for number in range(file.scan_count)]
        total = sum(header.point_count for header in headers)
    what = f"cloud {path}"
    refuse(not headers, what, "no scans", E57)
    check_bytes(path, what, f"{total} points", total, E57)
    for number, header in enumerate(headers):
        if scan is not None and str(scan) not in (str(number), _scan_name(header)):
            continue
        with reading(path, "cloud", E57):
            places = CARTESIAN if CARTESIAN[0] in header.point_fields else SPHERICAL
            fields = [f for f in header.point_fields if f in pye57.e57.SUPPORTED_POINT_FIELDS]
            unread = listed(sorted({*header.point_fields} - {*fields}))
            data, buffers = file.make_buffers(fields, header.point_count)
            reader = header.points.reader(buffers)
            read = reader.read() if header.point_count else 0
            reader.close()
            stored = np.stack([data.pop(field) for field in places[:3]], axis=1)
            if places is SPHERICAL:
                stored = pye57.utils.convert_spherical_to_cartesian(stored)
            pose = header.has_pose()
            points = file.to_global(stored, header.rotation, header.translation) if pose else stored
        if unread:
            warnings.warn(f"Not read of {what}: {unread}.", stacklevel=4)
        found = f"{read} points where its header says {header.point_count}"
        refuse(read != header.point_count, what, found, "as many")
        invalid = data.pop(places[3], np.zeros(read, np.int8)) != 0
        columns = {E57_COLUMNS.get(field, field): values for field, values in data.items()}
        single = np.isfinite(stored).all() and (stored == stored.astype(np.float32)).all()
        step = type_step(stored.astype(np.float32)) if single and read else np.nan
        yield Piece(
            np.asarray(points, dtype=np.float64),
            {**columns, "scan": np.full(read, number)},
            {"resolution": step},
            total,
            {"their scanner marked as invalid": invalid},
        )


def _scan_name(header):
    """The name of a scan; "" for none."""
    return header["name"].value() if header.node.isDefined("name") else ""


PTX = "a complete PTX file"

PTX_ROW = re.compile(rb"[^\n]*\S[^\n]*(?:\n|$)")


def ptx_pieces(path, scan=None):
    """Return the scans of a PTX file, or the one of this number; numbers in a column ``scan``."""
    text, at, number = plain_text(path), 0, 0
    while text[at:].strip():
        head = PTX_HEAD.match(text, at)
        refuse(head is None, f"cloud {path}", f"no header of scan {number}", PTX)
        wide, high, at = int(head[1]), int(head[2]), head.end()
        ends = [found.end() for found in islice(PTX_ROW.finditer(text, at), wide * high)]
        found = f"{len(ends)} rows where the header of scan {number} says {wide * high}"
        refuse(len(ends) < wide * high, f"cloud {path}", found, "as many")
        end = ends[-1] if ends else at
        with reading(path, "cloud", PTX):
            matrix = np.array(head[4].split(), dtype=float).reshape(4, 4)
            rows = pd.read_csv(BytesIO(text[at:end]), sep=r"\s+", header=None, dtype=float)
            names = ["x", "y", "z", "intensity", "red", "green", "blue"][: rows.shape[1]]
            rows = rows.set_axis(names, axis=1)
            own = rows[["x", "y", "z"]].to_numpy()
        columns = {name: rows[name].to_numpy() for name in names[3:]}
        columns["scan"] = np.full(len(rows), number)
        columns["column"], columns["row"] = np.divmod(np.arange(len(rows)), high)
        none = {"have no return": (own == 0).all(axis=1)}
        if scan in (None, number, str(number)):
            yield Piece(own @ matrix[:3, :3] + matrix[3, :3], columns, left=none)
        at, number = end, number + 1


PCD = "a complete PCD file with fields x, y, z"

# LZF puts at most so many bytes into one.
MOST_OF_A_BYTE = 100


def read_pcd(path):
    """Return the points, columns and {"resolution": step} of a PCD file."""
    pypcd4, what = needs("files", "pypcd4"), f"cloud {path}"
    with path.open("rb") as file:
        head = file.read(HEAD)
    end = re.search(rb"^DATA[^\n]*\n", head, re.M)
    refuse(end is None, what, "no line DATA", PCD)
    with reading(path, "cloud", PCD):
        about = pypcd4.MetaData.parse_header(head[: end.end()].decode().splitlines())
        row = sum(size * count for size, count in zip(about.size, about.count, strict=True))
    found, size = f"{about.points} points", about.points * row
    check_bytes(path, what, found, size, PCD, most=MOST_OF_A_BYTE)
    with reading(path, "cloud", PCD):
        rows = np.atleast_1d(pypcd4.PointCloud.from_path(path).pc_data)
    refuse(not {*"xyz"} <= {*rows.dtype.names}, what, f"fields {', '.join(about.fields)}", PCD)
    behind = path.read_bytes()[end.end() :]
    there = len(behind) // row
    if about.data.value == "ascii":
        there = len(behind.splitlines())
    elif about.data.value == "binary_compressed":
        there = int.from_bytes(behind[4:8], "little") // row
    found = f"{there} points where its header says {about.points}"
    refuse({there, len(rows)} != {about.points}, what, found, "as many")
    if tuple(about.viewpoint) != (0, 0, 0, 1, 0, 0, 0):
        told = " ".join(f"{value:g}" for value in about.viewpoint)
        warnings.warn(f"{path} states a viewpoint, {told}, which is not applied.", stacklevel=4)
    points = np.stack([rows[axis] for axis in "xyz"], axis=1)
    finite = points[np.isfinite(points).all(axis=1)]
    step = type_step(finite) if len(finite) and points.dtype == np.float32 else np.nan
    columns = {name: np.array(rows[name]) for name in rows.dtype.names if name not in "xyz"}
    for name in {"rgb", "rgba"} & columns.keys():  # packed into four bytes
        packed = columns.pop(name).view(np.uint32)
        for place, colour in enumerate(("blue", "green", "red")):
            columns[colour] = (packed >> 8 * place & 255).astype(np.uint8)
    return points.astype(np.float64), columns, {"resolution": step}


PLY = "a PLY file with vertices x, y, z"

# Types of properties by both of their names.
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
PLY_TYPES |= {"float": "f4", "double": "f8"}
PLY_TYPES |= {np.dtype(kind).name: kind for kind in (*PLY_TYPES.values(), "i8", "u8")}

PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


def read_ply(path):
    """Return the points, columns and {"resolution": step} of a PLY file's vertices."""
    data = Path(path).read_bytes().removeprefix(codecs.BOM_UTF8)
    end = re.search(rb"end_header[ \t]*(\r\n|\n|\r)", data)
    headed = data.startswith(b"ply") and end is not None
    refuse(not headed, f"cloud {path}", "no header", PLY)
    order, elements = _ply_header(data[: end.start()].decode(errors="replace"), path)
    found = [name for name, _, fields in elements if {*"xyz"} <= {*map(str.lower, fields)}]
    found.sort(key="vertex".__ne__)  # others, as cameras, may have a place, too
    refuse(not found, f"cloud {path}", "no element has x, y, z", PLY)
    read = _binary if order else _text
    rows = read(data, end.end(), elements, found[0], path, order)
    axes = {name.lower(): name for name in reversed(rows.dtype.names)}
    points = np.stack([rows[axes[axis]] for axis in "xyz"], axis=1)
    finite = points[np.isfinite(points)]
    single = finite.astype(np.float32)
    alike = not order and np.allclose(finite, single, rtol=1e-15, atol=0)  # as pandas reads text
    stored = points.dtype == np.float32 or alike
    step = float(np.spacing(np.abs(single).max(initial=0))) if stored else np.nan
    names = [name for name in rows.dtype.names if name not in {axes[axis] for axis in "xyz"}]
    columns = {name: np.array(rows[name]) for name in names}
    return points.astype(np.float64), columns, {"resolution": step}


def _ply_header(text, path):
    """The order of bytes, and name, count and fields {name: types} of each element."""
    order, elements = None, []
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", kind, *_] if kind in PLY_ORDERS:
                order = PLY_ORDERS[kind]
            case ["element", name, count] if count.isdigit():
                elements.append((name, int(count), {}))
            case ["property", kind, name] if elements and (
                kind in PLY_TYPES and name not in elements[-1][2]
            ):
                elements[-1][2][name] = (PLY_TYPES[kind],)
            case ["property", "list", size, kind, name] if elements and (
                {size, kind} <= {*PLY_TYPES} and PLY_TYPES[size][0] != "f"
            ):
                elements[-1][2][name] = (PLY_TYPES[size], PLY_TYPES[kind])
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"Invalid cloud {path}: line {line[:60]!r}. Must be {PLY}.")
    refuse(order is None, f"cloud {path}", "no known format", PLY)
    return order, elements


def _row(fields, order, path):
    """The type of a row of fields without lists."""
    lists = any(len(types) == 2 for types in fields.values())
    refuse(lists, f"cloud {path}", "a list in its vertices", PLY)
    return np.dtype([(name, order + types[0]) for name, types in fields.items()])


def _binary(data, at, elements, wanted, path, order):
    """The rows of an element of a binary file."""
    place = [name for name, _, _ in elements].index(wanted)
    for _, count, fields in elements[:place]:
        if any(len(types) == 2 for types in fields.values()):
            with reading(path, "cloud", PLY):
                at = _behind_lists(data, at, count, fields, order)
        else:
            at += count * _row(fields, order, path).itemsize
    _, count, fields = elements[place]
    kind = _row(fields, order, path)
    there = (len(data) - at) // kind.itemsize
    last = not any(later for _, later, _ in elements[place + 1 :])
    _check_count(there < count or (last and there > count), path, there, count)
    return np.frombuffer(data, kind, count, at)


def _behind_lists(data, at, count, fields, order):
    """The place behind rows with lists."""
    sizes = [[np.dtype(kind) for kind in types] for types in fields.values()]
    for _ in range(count):
        for length, *item in sizes:
            number = struct.unpack_from((order or "=") + length.char, data, at)[0] if item else 0
            if number < 0:
                raise ValueError("a list of fewer than no items")
            at += length.itemsize + (number * item[0].itemsize if item else 0)
    return at


def _text(data, at, elements, wanted, path, _):
    """The rows of an element of a text file."""
    lines = [line for line in data[at:].splitlines() if line.strip()]
    counts = [count for _, count, _ in elements]
    place = [name for name, _, _ in elements].index(wanted)
    before, count, (*_, fields) = sum(counts[:place]), counts[place], elements[place]
    _check_count(len(lines) != sum(counts), path, len(lines), sum(counts))
    kind = _row(fields, "", path)
    if not count:
        return np.empty(0, kind)
    layout = {"sep": r"\s+", "header": None, "names": [*fields]}
    with reading(path, "cloud", PLY):
        rows = BytesIO(b"\n".join(lines[before : before + count]))
        table = pd.read_csv(rows, index_col=False, na_values=NO_NUMBERS, **layout)
        whole = [name for name in fields if table[name].notna().all()]
        types = {name: kind[name] for name in whole}
        types |= {name: float for name in fields if name.lower() in [*"xyz"]}  # with all digits
        return table.astype(types).to_records(index=False)


def _check_count(wrong, path, there, count):
    """Raise where the rows of a file are not as many as its header says."""
    refuse(wrong, f"cloud {path}", f"{there} rows where its header says {count}", "as many")
