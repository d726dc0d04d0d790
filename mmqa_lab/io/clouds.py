"""Clouds from and to files.

LAS, LAZ and COPC are read by laspy, PLY by plyfile (it keeps double precision and every property;
VTK's reader rounds coordinates to float32), text by pandas, E57 by pye57 where it is installed.
All of it arrives as :class:`mmqa_lab.cloud.Cloud`.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_points, check_positive
from mmqa_lab.cloud import Cloud, as_cloud
from mmqa_lab.io._files import damage_named, write_atomically
from mmqa_lab.io._formats import e57_tables, pcd_tables, ply_tables
from mmqa_lab.io._las import las_data, las_tables
from mmqa_lab.io._text import text_tables

LAS_ENDINGS = (".las", ".laz")
TEXT_ENDINGS = (".txt", ".csv", ".xyz", ".asc", ".pts")
CLOUD_ENDINGS = (*LAS_ENDINGS, ".ply", ".pcd", ".e57", *TEXT_ENDINGS)


def read_cloud(path: str | os.PathLike, *, columns: Sequence[str] | None = None) -> Cloud:
    """Read a cloud file whole.

    Parameters
    ----------
    path : path
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), PLY (``.ply``), PCD (``.pcd``), E57
        (``.e57``, needs pye57), or text (``.txt``, ``.csv``, ``.xyz``, ``.asc``, ``.pts``). Columns
        of text stand between white space, commas or semicolons; a header names x, y, z or easting,
        northing, height, in any order among others; without a header x, y, z come first. ``#`` and,
        before the data, ``//`` begin a comment; a first line with the count of points is skipped.
    columns : sequence of str, optional
        The per-point columns to keep; all when not given.

    Returns
    -------
    Cloud
        Points in float64. Columns are kept as read, but for ``scan_angle``, which is in degrees.
        Its ``resolution`` is the scale of a LAS header, or the step of single precision at the
        largest coordinate of PLY and PCD; NaN else.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no cloud, is damaged or cut short, holds no points, or lacks a column.

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
    path = Path(path)
    chunk = check_count(chunk, "chunk")
    if not path.is_file():
        raise FileNotFoundError(f"Invalid cloud {path}: no such file. Must exist.")
    ending = path.suffix.lower()
    if ending not in CLOUD_ENDINGS:
        listed = ", ".join(CLOUD_ENDINGS)
        raise ValueError(f"Invalid cloud {path} with ending {ending!r}. Must be one of {listed}.")
    bare = columns is not None and not len(columns)
    for points, attributes, resolution in _tables(path, ending, chunk, bare):
        yield _finite_cloud(path, points, _chosen(path, attributes, columns), resolution)


def write_cloud(path: str | os.PathLike, cloud: Cloud, *, scale: float = 0.001) -> None:
    """Write a cloud as LAS or LAZ 1.4, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in ``.las`` or ``.laz``; an existing file is replaced.
    cloud : Cloud, array_like of shape (n, 3) or DataFrame
        Columns that LAS knows (``gps_time`` in seconds, ``intensity``, ``scan_angle`` in
        degrees, ``classification``, ...) go to their fields, the others to extra dimensions.
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
    """Points, attributes and resolution of a file's pieces."""
    if ending in LAS_ENDINGS:
        with damage_named(path, "a complete LAS or LAZ file"):
            yield from las_tables(path, chunk, bare=bare)
    elif ending in TEXT_ENDINGS:
        yield from ((*table, np.nan) for table in text_tables(path, chunk))
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


def _finite_cloud(path, points, attributes, resolution):
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
    return Cloud(points, attributes, Path(path).stem, resolution)
