"""Reference heights: rasters, and lists of points."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_file, check_same_crs, refuse
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import systems
from mmqa_lab.io.clouds import read_cloud
from mmqa_lab.io.images import MASK, TIFF_ENDINGS, first_page, open_tiff, tiff_pixels
from mmqa_lab.io.tables import NO_HEIGHT_M

__all__ = ["read_heights"]

RASTERS = "a GeoTIFF of one band with north upwards and an EPSG number"

# Cells narrower than this are in degrees.
NARROWEST_CELL_M = 0.001


def read_heights(path: str | os.PathLike, *, crs: object = None) -> np.ndarray:
    """Read reference points from a list or a raster.

    Parameters
    ----------
    path : path
        Any file of :func:`read_cloud`, as CSV with x, y, z; or a GeoTIFF of one band.
    crs : pyproj.CRS, optional
        Of the cloud: a file that names another is refused.

    Returns
    -------
    array, shape (n, 3)
        Metres; what has no height is left out with a count, and what is 9999 m or more above or
        below.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is neither, is damaged, has no height, or is not in metres.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "levelled.csv").write_text("x,y,z\\n0,0,1.25\\n1,0,1.5\\n")
    ...     read_heights(Path(folder) / "levelled.csv").tolist()
    [[0.0, 0.0, 1.25], [1.0, 0.0, 1.5]]
    """
    path = check_file(path, "reference")
    raster = path.suffix.lower() in TIFF_ENDINGS
    cloud, total = _raster_cloud(path) if raster else (read_cloud(path, columns=()), 0)
    check_same_crs(f"reference {path}", cloud.crs, "cloud", crs)
    high = np.abs(cloud.points[:, 2]) >= NO_HEIGHT_M
    if high.all():
        ends = [f"{end:.6g}" for end in np.sort(cloud.points[:, 2])[[0, -1]]] if len(high) else []
        found = f"heights of {' to '.join(ends)}" if ends else "no height"
        raise ValueError(f"Invalid reference {path}: {found}. Must be below {NO_HEIGHT_M:.0f} m.")
    lost = max(total - len(cloud), 0) + int(high.sum())
    if lost:
        told = f"Dropped {lost} of {max(total, len(cloud))} heights of {path}"
        warnings.warn(f"{told}: none, or {NO_HEIGHT_M:.0f} m and more.", stacklevel=2)
    return cloud.points[~high]


def _raster_cloud(path):
    """The cells of a GeoTIFF that have a height, and the number of all."""
    what = f"reference {path}"
    with open_tiff(path, "reference", RASTERS) as file:
        page = first_page(path, file)
        refuse(page.samplesperpixel != 1, what, f"{page.samplesperpixel} bands", RASTERS)
        place = _place(page.tags, what)
        rows = np.reshape(page.tags.valueof("GeoKeyDirectoryTag", default=()), (-1, 4))[1:]
        keys = {number: value for number, place_of, _, value in rows.tolist() if place_of == 0}
        stored, _ = tiff_pixels(path, page, RASTERS)
        refuse(stored.dtype.kind not in "iuf", what, f"values of type {stored.dtype}", "heights")
        heights = stored[..., 0].astype(np.float64)
        nothing = _number(page.tags.valueof("GDAL_NODATA"), "no-data value", what, np.nan)
        heights[stored[..., 0] == nothing] = np.nan
        scale, offset = _scale(page.tags.valueof("GDAL_METADATA", default=""), what)
        masks = [
            tiff_pixels(path, one, RASTERS)[0] for one in file.pages[1:] if one.subfiletype == MASK
        ]
    if Path(f"{path}.msk").is_file():
        with open_tiff(f"{path}.msk", "mask", RASTERS) as file:
            masks.append(tiff_pixels(f"{path}.msk", file.pages[0], RASTERS)[0])
    for mask in masks:
        other = mask.shape[:2] != heights.shape
        refuse(other, what, "a mask of other size", "as large as heights")
        heights[mask[..., 0] == 0] = np.nan
    number = keys.get(systems.PLAN_SYSTEM, keys.get(systems.GLOBE_SYSTEM))
    found = "a coordinate system without an EPSG number"
    refuse(number == systems.USER_DEFINED, what, found, RASTERS)
    crs = None if number is None else systems.named_system(number, what)
    crs = systems.system_of_keys(keys, crs, what)
    middle = 0.5 if keys.get(1025, 1) == 1 else 0.0
    row, column = np.indices(heights.shape) + middle
    x = place[0, 0] * column + place[0, 3]
    y = place[1, 1] * row + place[1, 3]
    points = np.stack([x, y, scale * heights + offset], axis=-1)
    return Cloud(points[np.isfinite(heights)], crs=crs), heights.size


def _place(tags, what):
    """The matrix from columns and rows to easting and northing of a raster with north upwards."""
    matrix = np.eye(4)
    if (given := tags.valueof("ModelTransformationTag")) is not None:
        matrix = np.reshape(given, (4, 4)).astype(float)
    else:
        tie, size = tags.valueof("ModelTiepointTag"), tags.valueof("ModelPixelScaleTag")
        lacks = "tie point" if tie is None else "size of its cells" if size is None else ""
        found = f"no {lacks}" if lacks else "several tie points"
        refuse(lacks or len(tie) != 6, what, found, RASTERS)
        matrix[0, 0], matrix[1, 1] = size[0], -size[1]
        matrix[:2, 3] = tie[3] - tie[0] * size[0], tie[4] + tie[1] * size[1]
    width, depth = matrix[0, 0], -matrix[1, 1]
    turned = matrix[0, 1] or matrix[1, 0] or not min(width, depth) > 0
    refuse(turned, what, "turned or mirrored", RASTERS)
    narrow = max(width, depth) < NARROWEST_CELL_M
    refuse(narrow, what, f"cells of {width:g}, as of degrees", "in metres")
    return matrix


def _number(text, name, what, usual):
    """A number that a raster states as text; the usual one where there is none."""
    try:
        return float(text) if text is not None and str(text).strip() else usual
    except ValueError:
        raise ValueError(f"Invalid {what} with {name} {text!r}. Must be a number.") from None


def _scale(text, what):
    """The scale and offset of a raster's values in GDAL's metadata; a unit must be metres."""
    found = dict(re.findall(r'role="(scale|offset|unittype)"[^>]*>([^<]*)<', str(text)))
    unit = found.get("unittype", "m").strip().lower()
    if unit not in ("", "m", "metre", "meter", "metres", "meters"):
        raise ValueError(f"Invalid {what} with heights in {unit}. Must be in metres.")
    usual = {"scale": 1.0, "offset": 0.0}
    scale, offset = (_number(found.get(name), name, what, one) for name, one in usual.items())
    usable = np.isfinite([scale, offset]).all() and scale != 0
    refuse(not usable, what, f"scale {scale:g} and offset {offset:g}", "numbers, no scale of 0")
    return scale, offset
