"""What a file is, and what it contains: clouds, outlines, paths, rasters, images and tables."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mmqa_lab._checks import check_file, check_polygon, listed, refuse
from mmqa_lab.cloud import Cloud, describe
from mmqa_lab.io.clouds import iterate_cloud
from mmqa_lab.io.files import RAW_ENDINGS, form_of, plain_text, refuse_unread
from mmqa_lab.io.images import IMAGE_ENDINGS, read_bands
from mmqa_lab.io.outlines import OUTLINE_ENDINGS, stored_outlines
from mmqa_lab.io.rasters import is_raster, open_raster, system_of
from mmqa_lab.io.tables import read_table
from mmqa_lab.io.trajectories import SBET_ENDINGS, path_table

__all__ = ["describe_file"]

# A header of a path names an attitude or a place on the globe beside its time.
PATH_WORDS = re.compile(
    rb"(?im)^(?=.*time)(?=.*(heading|yaw|latitude|\bq_?w\b|q_rs_w)).*$"
    rb"|^([-+.\de]+[ \t]+){7}[-+.\de]+$"
)
TABLE_ENDINGS = (".xlsx", ".xlsm")


def describe_file(path: str | os.PathLike) -> Mapping[str, Any]:
    """Return what a file is (``kind``) and what it contains, whatever it is of what is read.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict
        ``kind``, and of a cloud and of outlines what :func:`mmqa_lab.cloud.describe` tells.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it is not read.

    Examples
    --------
    >>> from mmqa_lab import samples
    >>> found = describe_file(samples.path("road_patch"))
    >>> found["kind"], found["points"]
    ('LAS cloud', 28185)
    """
    path = check_file(path, "file")
    ending, form = path.suffix.lower(), form_of(path)
    if ending in OUTLINE_ENDINGS:
        names, rings, crs = stored_outlines(path)
        flat = [check_polygon(np.pad(ring, ((0, 0), (0, 1)))[:, :3]) for ring in rings]
        known = describe(Cloud(np.concatenate(flat), crs=crs)) | {"outlines": listed(names)}
        return {"kind": f"{len(names)} outlines", **known}
    if ending in RAW_ENDINGS.split():
        refuse_unread(path, "file")
    if is_raster(path):
        with contextlib.suppress(ImportError):  # without rasterio a TIFF file is an image
            if found := _raster(path):
                return found
            placeless = ending not in IMAGE_ENDINGS
            refuse(placeless, f"raster {path}", "no place or no size of its cells", "with both")
    if ending in IMAGE_ENDINGS:
        bands, rows, columns = read_bands(path).shape
        return {"kind": "image", "image": f"{columns} x {rows} pixels, {bands} bands"}
    if ending in SBET_ENDINGS or (not form and ending not in TABLE_ENDINGS and _is_path(path)):
        table = path_table(path)
        kind = "path (SBET)" if ending in SBET_ENDINGS else "path"
        return {"kind": kind, "points": len(table), "columns": listed(table.columns)}
    try:
        return _cloud(path, form)
    except ValueError:
        table = _table(path) if not form else None
        if table is None:
            raise
        return {"kind": "table", "points": len(table), "columns": listed(table.columns)}


def _cloud(path, form):
    """What a cloud contains, piece by piece."""
    parts = list(iterate_cloud(path))
    whole = Cloud.concatenate(replace(part, crs=None) for part in parts)
    kind = f"{form.upper() or 'text'} cloud"
    kind += f", scans: {len(parts)}" if form in ("e57", "ptx") else ""
    return {"kind": kind, **describe(replace(whole, crs=parts[0].crs if parts else None))}


def _raster(path):
    """What a raster contains; nothing of an image without a place."""
    with open_raster(path, "raster", first=True) as (file, names):
        place, crs = file.transform, system_of(file, f"raster {path}")
        if place.is_identity:
            return {}
        west, south, east, north = file.bounds
        size = f"{file.width} x {file.height} cells of {abs(place.a):g}"
        size += f", {len(names) or file.count} bands"
    box = {"x_low_m": west, "x_high_m": east, "y_low_m": south, "y_high_m": north}
    named = {"columns": listed(names)} if names else {}
    return {"kind": "raster", "image": size, **box, "crs": crs.name if crs else "", **named}


def _is_path(path):
    """Whether the beginning of a text is that of a path."""
    try:
        return PATH_WORDS.search(plain_text(path)[:4096]) is not None
    except ValueError:
        return False


def _table(path):
    """A table of named columns; None for another file."""
    try:
        table = read_table(path, "table")
    except ValueError:
        return None
    return table if table.shape[1] > 1 else None
