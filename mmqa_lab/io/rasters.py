"""Rasters: reference heights of cells, as GDAL reads them, and bands with names that it writes."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_file, check_same_crs, needs, refuse
from mmqa_lab.cloud import Cloud
from mmqa_lab.io.clouds import read_cloud
from mmqa_lab.io.files import check_bytes, reading, write_atomically
from mmqa_lab.io.images import MOST_VALUES, TIFF_ENDINGS
from mmqa_lab.io.marks import without_height
from mmqa_lab.io.systems import named_system
from mmqa_lab.io.tables import NO_HEIGHT_M

__all__ = ["is_raster", "open_raster", "read_heights", "system_of", "write_raster"]

RASTERS = "a raster of one band, as GeoTIFF, ESRI grid or NetCDF, with its place"

# The parts of GDAL that may read a file, by how it begins.
DRIVERS = {"GTiff": rb"II[*+]\0|MM\0[*+]", "AAIGrid": rb"\s*ncols\s+\d"}
DRIVERS |= {"netCDF": rb"CDF[\1\2\5]|\x89HDF"}

# Cells narrower than this are in degrees.
NARROWEST_CELL_M = 0.001

# Cells of a raster of heights that need no larger file.
FEW_CELLS = 20_000_000

METRES = ("", "m", "metre", "meter", "metres", "meters")


def is_raster(path: str | os.PathLike) -> bool:
    """Return whether a file begins or ends as rasters do."""
    return _driver(path) != "" or Path(path).suffix.lower() in TIFF_ENDINGS


def _driver(path):
    """The part of GDAL that reads a file which begins so; "" for none."""
    with Path(path).open("rb") as file:
        head = file.read(64).lower()
    return next((name for name, mark in DRIVERS.items() if re.match(mark, head, re.I)), "")


def read_heights(path: str | os.PathLike, *, crs: object = None) -> np.ndarray:
    """Read reference points from a list or a raster.

    Parameters
    ----------
    path : path
        Any file of :func:`read_cloud`, as CSV with x, y, z; or a raster of one band that
        GDAL reads: GeoTIFF, ESRI grid or NetCDF.
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
    cloud, total = _raster_cloud(path) if is_raster(path) else (read_cloud(path, columns=()), 0)
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
    points = cloud.points[~high]
    if total:  # no cell is there twice
        return points
    first = np.sort(np.unique(points, axis=0, return_index=True)[1])
    if twice := len(points) - len(first):
        warnings.warn(f"Dropped {twice} points of {path} that are given twice.", stacklevel=2)
    return points[first]


@contextlib.contextmanager
def open_raster(
    path: str | os.PathLike, name: str, *, first: bool = False
) -> Iterator[tuple[Any, list[str]]]:
    """Hold a raster open as rasterio's dataset, with the names of all in its file.

    Of several the ``first`` is held, else they are refused with their names.
    """
    rasterio, what = needs("files", "rasterio"), f"{name} {path}"
    logging.getLogger("rasterio").setLevel(logging.CRITICAL)  # a sentence says what is wrong
    with contextlib.ExitStack() as held:
        held.enter_context(warnings.catch_warnings(action="ignore"))
        with reading(path, name, RASTERS):
            driver = _driver(path) or "GTiff"
            file = held.enter_context(rasterio.open(path, driver=driver))
            inside = file.subdatasets
            if not file.count and (len(inside) == 1 or (first and inside)):
                file = held.enter_context(rasterio.open(inside[0], driver=driver))
        names = [one.rpartition(":")[2] for one in inside]
        refuse(not file.count, what, f"several rasters, {', '.join(names[:9])}", RASTERS)
        found = f"{file.width} x {file.height} x {file.count} cells"
        refuse(file.width * file.height * file.count > MOST_VALUES, what, found, "of fewer")
        yield file, names


def _raster_cloud(path):
    """The cells of a raster that have a height, and the number of all."""
    what = f"reference {path}"
    with open_raster(path, "reference") as (file, _):
        pages = len(file.subdatasets)
        refuse(file.count != 1, what, f"{file.count} bands", RASTERS)
        found, cells = f"{file.width} x {file.height} cells", file.width * file.height
        check_bytes(path, what, found, cells, RASTERS, few=FEW_CELLS)
        one_bit = file.tags(1, ns="IMAGE_STRUCTURE").get("NBITS") == "1"
        kind = "bool" if one_bit else file.dtypes[0]
        refuse(one_bit or kind.startswith("complex"), what, f"values of type {kind}", "heights")
        unit, scale, offset = file.units[0] or "", file.scales[0], file.offsets[0]
        refuse(unit.strip().lower() not in METRES, what, f"heights in {unit}", "in metres")
        usable = np.isfinite([scale, offset]).all() and scale != 0
        found = f"scale {scale:g} and offset {offset:g}"
        refuse(not usable, what, found, "numbers, no scale of 0")
        place = file.transform
        crs = system_of(file, what)
        nowhere = place.is_identity or (crs is None and place.c == place.f == 0)
        refuse(nowhere, what, "no tie point or no size of its cells", RASTERS)
        width = min(np.hypot(place.a, place.d), np.hypot(place.b, place.e))
        degrees = crs is None and width < NARROWEST_CELL_M
        refuse(degrees, what, f"cells of {width:g}, as of degrees", "in metres")
        with reading(path, "reference", RASTERS):
            heights = file.read(1, masked=True)
    if pages > 1:
        warnings.warn(f"Read the first of {pages} pages of {path}.", stacklevel=3)
    known = ~np.ma.getmaskarray(heights) & np.isfinite(heights.data)
    row, column = np.nonzero(known & ~without_height(heights.data.astype(np.float64)))
    x = place.a * (column + 0.5) + place.b * (row + 0.5) + place.c
    y = place.d * (column + 0.5) + place.e * (row + 0.5) + place.f
    z = scale * heights.data[row, column].astype(np.float64) + offset
    return Cloud(np.stack([x, y, z], axis=1), crs=crs), heights.size


def system_of(file, what):
    """The coordinate system of a raster; None for one in metres without a place on the globe."""
    crs = named_system(file.crs.to_wkt(), what) if file.crs else None
    local = crs is not None and not (crs.is_geographic or crs.is_projected or crs.is_compound)
    return None if local and crs.axis_info[0].unit_conversion_factor == 1 else crs


def write_raster(
    path: str | os.PathLike,
    bands: Mapping[str, ArrayLike],
    *,
    corner: Sequence[float],
    cell: float,
    crs: object,
    units: Sequence[str] = (),
) -> None:
    """Write bands with names, from north to south, as GeoTIFF of single precision.

    Parameters
    ----------
    path : path
    bands : dict of str to array_like, shape (rows, columns)
        NaN stands for no value.
    corner : (float, float)
        Easting and northing of the upper left corner, m.
    cell : float
        Side of a cell, m.
    crs : pyproj.CRS
    units : sequence of str
        Of each band.

    See Also
    --------
    mmqa_lab.maps.write_map : a map of a campaign.
    """
    rasterio = needs("files", "rasterio")
    values = np.stack([np.asarray(band, dtype=np.float32) for band in bands.values()])
    layout = {"driver": "GTiff", "count": len(bands), "dtype": "float32", "nodata": np.nan}
    layout |= {"height": values.shape[1], "width": values.shape[2], "compress": "deflate"}
    layout |= {"transform": rasterio.Affine(cell, 0, corner[0], 0, -cell, corner[1])}

    def write(file):
        with rasterio.open(file, "w", crs=crs.to_wkt(), interleave="band", **layout) as raster:
            raster.write(values)
            raster.descriptions = [*bands]
            raster.units = [*units] or [""] * len(bands)

    write_atomically(path, write)
