"""Clouds in PCD files of the Point Cloud Library: ascii, binary and compressed."""

from __future__ import annotations

import re
import warnings

import numpy as np

from mmqa_lab._checks import needs, refuse, type_step
from mmqa_lab.io.files import HEAD, reading

__all__ = ["read_pcd"]

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
    most = MOST_OF_A_BYTE * path.stat().st_size
    refuse(about.points * row > most, what, f"{about.points} points in so few bytes", PCD)
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
