"""Line segments from CSV, GeoJSON and DXF files, and to CSV files."""

from __future__ import annotations

import json
import os
import re
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mmqa_lab.io._files import write_atomically

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mmqa_lab.lines import Segments

COLUMNS = ("x1", "y1", "z1", "x2", "y2", "z2")


def read_segments(path: str | os.PathLike) -> Segments:
    """Read line segments from a CSV or text file, GeoJSON or DXF.

    Parameters
    ----------
    path : path
        GeoJSON: the pieces of all LineStrings and MultiLineStrings. DXF (needs ``ezdxf``): the
        pieces of all LINE, LWPOLYLINE and POLYLINE entities. Other files: a segment in a line: six
        numbers x1, y1, z1, x2, y2, z2 in metres, separated by commas, semicolons or white space.
        A header is optional; one with the names x1, y1, z1, x2, y2, z2
        may have them in any order among others. ``#`` begins a comment.

    Returns
    -------
    Segments
        Named after the file; none for a file with a header alone.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a file is damaged or ``ezdxf`` is not installed; if a line lacks six finite numbers or a
        segment has no length; names the line.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "edges.csv"
    >>> _ = file.write_text("x1,y1,z1,x2,y2,z2\\n0,0,0,0,0,12\\n0,0,12,9,0,12\\n")
    >>> read_segments(file).lengths.tolist()
    [12.0, 9.0]
    """
    from mmqa_lab.lines import Segments

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid segments {path}: no such file. Must exist.")
    if path.suffix.lower() in READERS:
        pieces = [pair for chain in READERS[path.suffix.lower()](path) for pair in pairwise(chain)]
        return Segments(np.array(pieces, dtype=np.float64).reshape(-1, 2, 3), name=path.stem)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"Invalid segments {path}: no text. Must be lines of numbers.") from error
    rows, numbers, places = [], [], None
    for number, line in enumerate(lines, start=1):
        words = _words(line)
        if not any(words):
            continue
        if not rows and places is None and _is_header(words):
            places = _places(path, words)
            continue
        rows.append(_row(path, number, words, places or range(6)))
        numbers.append(number)
    if not rows and places is None:
        raise ValueError(f"Invalid segments {path}: empty. Must have a header or lines of numbers.")
    ends = np.array(rows, dtype=np.float64).reshape(-1, 2, 3)
    short = np.flatnonzero((ends[:, 0] == ends[:, 1]).all(axis=1))
    if len(short):
        raise ValueError(
            f"Invalid segments {path}: no length in line {numbers[short[0]]}. "
            "Must have two different ends."
        )
    return Segments(ends, name=path.stem)


def write_segments(path: str | os.PathLike, segments: Segments | ArrayLike) -> None:
    """Write line segments as CSV with a header, to the last bit, whole or not at all.

    Parameters
    ----------
    path : path
        An existing file is replaced.
    segments : Segments or array_like

    Raises
    ------
    ValueError
        If a segment is not finite or has no length.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_segments(f"{folder}/edges.csv", [[[0, 0, 0], [0, 0, 2.5]]])
    ...     read_segments(f"{folder}/edges.csv").lengths.tolist()
    [2.5]
    """
    from mmqa_lab.lines.segments import check_segments

    frame = pd.DataFrame(check_segments(segments).ends.reshape(-1, 6), columns=list(COLUMNS))
    write_atomically(path, lambda temporary: frame.to_csv(temporary, index=False))


def _chains_of_geojson(path):
    """Vertices (n, 3) of each line of a GeoJSON file; those without a height lie at 0."""
    try:
        node = json.loads(path.read_text(encoding="utf-8-sig"))
        features = node.get("features", [node])
        geometries = [feature.get("geometry", feature) for feature in features]
        chains = []
        for geometry in geometries:
            if geometry["type"] == "LineString":
                chains.append(geometry["coordinates"])
            elif geometry["type"] == "MultiLineString":
                chains += geometry["coordinates"]
        return [[(*vertex, 0.0)[:3] for vertex in chain] for chain in chains]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"Invalid segments {path}. Must be GeoJSON with lines of 3-D vertices."
        ) from error


def _chains_of_dxf(path):
    """Vertices (n, 3) of each line of a DXF file."""
    try:
        import ezdxf
    except ImportError as error:
        raise ValueError(
            f"Invalid segments {path}: ezdxf is not installed. Must be CSV or GeoJSON without it."
        ) from error
    try:
        entities = ezdxf.readfile(path).modelspace()
    except (OSError, ezdxf.DXFError) as error:
        raise ValueError(f"Invalid segments {path}. Must be a DXF file.") from error
    chains = [(line.dxf.start, line.dxf.end) for line in entities.query("LINE")]
    chains += [line.vertices_in_wcs() for line in entities.query("LWPOLYLINE")]
    chains += [line.points_in_wcs() for line in entities.query("POLYLINE")]
    return [[tuple(vertex) for vertex in chain] for chain in chains]


READERS = {".geojson": _chains_of_geojson, ".json": _chains_of_geojson, ".dxf": _chains_of_dxf}


def _words(line):
    """The words of a line without its comment; empty ones between two commas."""
    return re.split(r"\s*[,;]\s*|\s+", line.split("#")[0].strip())


def _places(path, names):
    """The places of x1 to z2 among a header's names."""
    plain = [name.lower().strip('"') for name in names]
    if all(column in plain for column in COLUMNS):
        return [plain.index(column) for column in COLUMNS]
    if len(names) > len(COLUMNS):
        raise ValueError(
            f"Invalid segments {path} with columns {', '.join(names)}. "
            f"Must have {', '.join(COLUMNS)}."
        )
    return range(6)


def _is_header(words):
    """Whether no word of the first line is a number."""
    return not any(_number(word) is not None for word in words)


def _row(path, number, words, places):
    """The six words as finite numbers, or the sentence that names the line."""
    values = [_number(words[place]) for place in places if place < len(words)]
    if len(values) < 6 or any(value is None or not np.isfinite(value) for value in values):
        raise ValueError(
            f"Invalid segments {path}: {' '.join(words)[:60]!r} in line {number}. "
            "Must be six finite numbers x1,y1,z1,x2,y2,z2."
        )
    return values


def _number(word):
    """A word as a float, None where it is none."""
    try:
        return float(word)
    except ValueError:
        return None
