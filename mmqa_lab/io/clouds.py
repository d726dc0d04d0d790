"""Clouds of any form, whole or in pieces; what is no point is left out with a count."""

from __future__ import annotations

import os
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_columns, check_file, refuse
from mmqa_lab.cloud import Cloud, unit_remarks
from mmqa_lab.io.files import form_of, refuse_unread
from mmqa_lab.io.forms import e57_pieces, ptx_pieces, read_pcd, read_ply
from mmqa_lab.io.las import LAS_ENDINGS, address_of, copc_pieces, las_pieces
from mmqa_lab.io.marks import FLAGS, Piece, marked
from mmqa_lab.io.tables import text_places

__all__ = ["CLOUD_ENDINGS", "iterate_cloud", "read_cloud"]

# Columns that other functions ask for, by their letters alone, as programs name them.
KNOWN_COLUMNS = {name.replace("_", ""): name for name in ("gps_time", "scan_line", *FLAGS)}

# Files larger than this of forms that are not read in pieces are named before they are read.
LARGE_BYTES = 2_000_000_000

TEXT_ENDINGS = (".txt", ".csv", ".xyz", ".pts", ".asc")
CLOUD_ENDINGS = (*LAS_ENDINGS, ".e57", ".pcd", ".ply", ".ptx", *TEXT_ENDINGS)


def read_cloud(
    path: str | os.PathLike,
    *,
    columns: Sequence[str] | None = None,
    scan: int | str | None = None,
    within: str | os.PathLike | None = None,
) -> Cloud:
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
        LAS 1.2-1.4, LAZ or COPC (``.las``, ``.laz``), the http address of a COPC file, E57, PCD,
        PLY, PTX or text (``.txt``, ``.csv``, ``.xyz``, ``.pts``, ``.asc``). The scans of E57 and
        PTX stand at their poses, with their numbers in the column ``scan``. Columns of text stand
        between white space, commas or semicolons; a header names x, y, z or easting, northing,
        height, in any order among others; without a header x, y, z come first. ``#``, ``//`` and
        ``%`` begin a comment.
    columns : sequence of str, optional
        The per-point columns to keep; all when not given.
    scan : int or str, optional
        The scan of an E57 or PTX file to read, by its number from 0, or by its name.
    within : path or str, optional
        Outlines as of :func:`read_outlines`: only what lies around them is fetched from an address.

    Returns
    -------
    Cloud
        Points in float64. Columns are kept as read, but for ``scan_angle``, which is in degrees,
        and names such as GPSTime, which are those of LAS.
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
    cloud = Cloud.concatenate(
        iterate_cloud(path, columns=columns, scan=scan, within=within), name=Path(path).stem
    )
    if not len(cloud):
        raise ValueError(f"Invalid cloud {path}: no points. Must contain one or more.")
    return cloud


def iterate_cloud(
    path: str | os.PathLike,
    *,
    columns: Sequence[str] | None = None,
    scan: int | str | None = None,
    within: str | os.PathLike | None = None,
    chunk: int = 1_000_000,
) -> Iterator[Cloud]:
    """Yield a cloud file in pieces; LAS and LAZ in such of at most ``chunk`` points.

    Parameters and errors are those of :func:`read_cloud`.

    Examples
    --------
    >>> from mmqa_lab import samples
    >>> [len(part) for part in iterate_cloud(samples.path("road_patch"), chunk=20_000)]
    [20000, 8185]
    """
    address = address_of(path)
    path = Path(address) if address else check_file(path, "cloud")
    form, ending = "copc" if address else form_of(path), path.suffix.lower()
    if not form:
        refuse_unread(path, "cloud")
        check_choice(ending, f"cloud {path} with ending", CLOUD_ENDINGS)
        form = ending[1:]
    size = 0 if form in ("copc", "las", "laz") else path.stat().st_size
    if size > LARGE_BYTES:
        told = f"{path} of {size / 1e9:.3g} GB is read as a whole, E57 and PTX scan by scan"
        warnings.warn(f"{told}. LAS and LAZ are read in pieces.", stacklevel=3)
    scanned, others = {"e57": e57_pieces, "ptx": ptx_pieces}, {"pcd": read_pcd, "ply": read_ply}
    if address:
        pieces = copc_pieces(address, columns, within)
    elif form in ("las", "laz"):
        pieces = las_pieces(path, chunk, columns)
    elif form in scanned:
        pieces = scanned[form](path, scan)
    else:
        read = others[form](path) if form in others else text_places(path, "cloud", finite=False)
        pieces = [Piece(*read)]
    unscanned = scan is not None and form not in scanned
    refuse(unscanned, f"scan {scan} of cloud {path}", "no scans in it", "left away")
    read, dropped, counted = 0, Counter(), Counter()
    for piece in pieces:
        piece = piece._replace(columns=_known(piece.columns))
        left, said = marked(piece)
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
            for remark in unit_remarks(cloud.points, crs=cloud.crs, share=share):
                warnings.warn(f"{path}: {remark}", stacklevel=3)
        yield cloud
    refuse(scan is not None and not read, f"scan {scan} of cloud {path}", "none of it", "in it")
    told = [("Dropped", *row) for row in dropped.items()]
    for verb, reason, count in [*told, *(("Counted", *row) for row in (+counted).items())]:
        warnings.warn(f"{verb} {count} of {read} points of {path} that {reason}.", stacklevel=3)


def _known(columns):
    """Columns under the names that other functions ask for, as GPSTime or scalar_Gps_Time."""
    plain = {name: re.sub(r"^scalar_|[\W_]", "", name.lower()) for name in columns}
    names = {name: KNOWN_COLUMNS.get(letters, name) for name, letters in plain.items()}
    names = {name: name if new in columns else new for name, new in names.items()}
    return {names[name]: values for name, values in columns.items()}
