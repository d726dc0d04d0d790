"""Clouds in PLY, PCD and E57 files."""

from __future__ import annotations

import numpy as np

from mmqa_lab.io._files import damage_named

PCD_TYPES = {"F": "f", "I": "i", "U": "u"}


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
    with damage_named(path, "an E57 file with Cartesian coordinates"):
        file = pye57.E57(str(path))
        for number in range(file.scan_count):
            scan = file.read_scan(number, intensity=True, colors=True, ignore_missing_fields=True)
            axes = [scan.pop(f"cartesian{axis}") for axis in "XYZ"]
            scan = {name: np.asarray(values) for name, values in scan.items()}
            points = np.stack(axes, axis=1).astype(np.float64)
            yield points, scan, _e57_resolution(file.get_header(number), points)


def _e57_resolution(header, points):
    """The step of a scan's coordinates before they were placed; NaN for double precision."""
    from pye57 import libe57

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
        _resolution(points),
    )


def _resolution(points):
    """The step of single precision at the largest coordinate; NaN for double precision."""
    finite = points[np.isfinite(points)]
    if points.dtype != np.float32 or not len(finite):
        return np.nan
    return float(np.spacing(np.abs(finite).max()))
