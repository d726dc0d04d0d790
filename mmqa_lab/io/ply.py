"""Clouds in PLY files, of any order of elements, in text or binary."""

from __future__ import annotations

import codecs
import re
import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import refuse
from mmqa_lab.io.files import reading
from mmqa_lab.io.tables import NO_NUMBERS

__all__ = ["read_ply"]

WANTED = "a PLY file with vertices x, y, z"

# Types of properties by both of their names.
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8"}
TYPES |= {np.dtype(kind).name: kind for kind in (*TYPES.values(), "i8", "u8")}

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


def read_ply(path):
    """Return the points, columns and {"resolution": step} of a PLY file's vertices."""
    data = Path(path).read_bytes().removeprefix(codecs.BOM_UTF8)
    end = re.search(rb"end_header[ \t]*(\r\n|\n|\r)", data)
    headed = data.startswith(b"ply") and end is not None
    refuse(not headed, f"cloud {path}", "no header", WANTED)
    order, elements = _header(data[: end.start()].decode(errors="replace"), path)
    found = [name for name, _, fields in elements if {*"xyz"} <= {*map(str.lower, fields)}]
    found.sort(key="vertex".__ne__)  # others, as cameras, may have a place, too
    refuse(not found, f"cloud {path}", "no element has x, y, z", WANTED)
    read = _binary if order else _text
    rows = read(data, end.end(), elements, found[0], path, order)
    axes = {name.lower(): name for name in reversed(rows.dtype.names)}
    points = np.stack([rows[axes[axis]] for axis in "xyz"], axis=1)
    largest = np.abs(points[np.isfinite(points)]).max(initial=0)
    step = float(np.spacing(largest)) if points.dtype == np.float32 else np.nan
    names = [name for name in rows.dtype.names if name not in {axes[axis] for axis in "xyz"}]
    columns = {name: np.array(rows[name]) for name in names}
    return points.astype(np.float64), columns, {"resolution": step}


def _header(text, path):
    """The order of bytes, and name, count and fields {name: types} of each element."""
    order, elements = None, []
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", kind, *_] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdigit():
                elements.append((name, int(count), {}))
            case ["property", kind, name] if elements and (
                kind in TYPES and name not in elements[-1][2]
            ):
                elements[-1][2][name] = (TYPES[kind],)
            case ["property", "list", size, kind, name] if elements and (
                {size, kind} <= {*TYPES} and TYPES[size][0] != "f"
            ):
                elements[-1][2][name] = (TYPES[size], TYPES[kind])
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"Invalid cloud {path}: line {line[:60]!r}. Must be {WANTED}.")
    refuse(order is None, f"cloud {path}", "no known format", WANTED)
    return order, elements


def _row(fields, order, path):
    """The type of a row of fields without lists."""
    lists = any(len(types) == 2 for types in fields.values())
    refuse(lists, f"cloud {path}", "a list in its vertices", WANTED)
    return np.dtype([(name, order + types[0]) for name, types in fields.items()])


def _binary(data, at, elements, wanted, path, order):
    """The rows of an element of a binary file."""
    place = [name for name, _, _ in elements].index(wanted)
    for _, count, fields in elements[:place]:
        if any(len(types) == 2 for types in fields.values()):
            with reading(path, "cloud", WANTED):
                at = _behind_lists(data, at, count, fields, order)
        else:
            at += count * _row(fields, order, path).itemsize
    _, count, fields = elements[place]
    kind = _row(fields, order, path)
    there = (len(data) - at) // kind.itemsize
    last = sum(later for _, later, _ in elements) == count
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
    with reading(path, "cloud", WANTED):
        rows = BytesIO(b"\n".join(lines[before : before + count]))
        table = pd.read_csv(rows, index_col=False, na_values=NO_NUMBERS, **layout)
        whole = [name for name in fields if table[name].notna().all()]
        return table.astype({name: kind[name] for name in whole}).to_records(index=False)


def _check_count(wrong, path, there, count):
    """Raise where the rows of a file are not as many as its header says."""
    refuse(wrong, f"cloud {path}", f"{there} rows where its header says {count}", "as many")
