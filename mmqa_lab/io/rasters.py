"""Heights from files."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_crs, check_points
from mmqa_lab.io.clouds import CLOUD_ENDINGS, LAS_ENDINGS, read_cloud

RASTER_ENDINGS = (".asc", ".npz", ".tif", ".tiff")

ARRAY_NAMES = ("ground", "height", "heights", "z")
"""Arrays of an ``.npz`` that are taken for heights, in this order."""

USUAL_NODATA = -9999.0
"""What an Esri ASCII grid takes for no height where it does not say."""


def read_heights(path: str | os.PathLike) -> np.ndarray:
    """Read reference points from a list or a raster.

    Parameters
    ----------
    path : path
        Any cloud file (:func:`read_cloud`), as CSV with x, y, z. Rasters: GeoTIFF of one band
        (``.tif``), Esri ASCII grid (``.asc``), or ``.npz`` with one-dimensional ``x`` and ``y`` of
        the cells' middles and a two-dimensional array of heights.

    Returns
    -------
    array, shape (n, 3)
        Metres; cells without a height are left out.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is neither, is damaged, has no height, or is in degrees.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "levelled.csv").write_text("x,y,z\\n0,0,1.25\\n1,0,1.5\\n")
    ...     read_heights(Path(folder) / "levelled.csv").tolist()
    [[0.0, 0.0, 1.25], [1.0, 0.0, 1.5]]
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid reference {path}: no such file. Must exist.")
    ending = path.suffix.lower()
    if ending == ".npz":
        points = _from_arrays(path)
    elif is_raster(path):
        points = _from_raster(path)
    elif ending in CLOUD_ENDINGS:
        points = read_cloud(path, columns=()).points
    else:
        listed = ", ".join(dict.fromkeys((*CLOUD_ENDINGS, *RASTER_ENDINGS)))
        raise ValueError(f"Invalid reference {path}. Must end in one of {listed}.")
    return check_points(points, name=f"reference {path}")


def heights_crs(path):
    """The coordinate reference system of a file that :func:`read_heights` reads; None without."""
    import rasterio

    path = Path(path)
    if path.suffix.lower() in LAS_ENDINGS:
        return read_cloud(path, columns=()).crs
    if path.suffix.lower() not in (".tif", ".tiff"):
        return None
    with rasterio.open(path) as raster:
        return None if raster.crs is None else check_crs(raster.crs.to_wkt())


def is_raster(path):
    """Whether a file is a raster of heights rather than a list of points."""
    ending = Path(path).suffix.lower()
    return ending in (".npz", ".tif", ".tiff") or (ending == ".asc" and _is_grid(path))


def _from_arrays(path):
    """The raster of an ``.npz``, a DataArray."""
    import xarray as xr

    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], dtype=np.float64) for name in file.files}
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(
            f"Invalid reference {path}: damaged. Must be arrays of numbers."
        ) from error
    x, y = arrays.get("x"), arrays.get("y")
    name = next((n for n in ARRAY_NAMES if n in arrays), None)
    if x is None or y is None or name is None or arrays[name].shape != (y.size, x.size):
        raise ValueError(
            f"Invalid reference {path} with arrays {', '.join(arrays) or 'none'}. Must have x, y "
            f"and {' or '.join(ARRAY_NAMES)} of shape (y, x)."
        )
    return xr.DataArray(arrays[name], {"y": y.ravel(), "x": x.ravel()}, ("y", "x"))


def _from_raster(path):
    """The cells of a GeoTIFF or an Esri ASCII grid that have a height, as points."""
    import rasterio

    grid = path.suffix.lower() == ".asc"
    choices = {"driver": "AAIGrid", "datatype": "Float64"} if grid else {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path, **choices) as raster:
                _check_raster(path, raster)
                heights = _unmasked(raster, USUAL_NODATA if grid else None)
                place = raster.transform
    except rasterio.errors.RasterioError as error:
        wanted = "an Esri ASCII grid" if grid else "a GeoTIFF"
        raise ValueError(f"Invalid reference {path}: damaged. Must be {wanted}.") from error
    rows, columns = np.nonzero(np.isfinite(heights))
    x, y = rasterio.transform.xy(place, rows, columns)
    return np.column_stack([x, y, heights[rows, columns]])


def _check_raster(path, raster):
    """Whether a raster has one band, places and metres."""
    if raster.count != 1 or raster.transform.is_identity:
        raise ValueError(
            f"Invalid reference {path}. Must be a GeoTIFF of one band whose cells have a place."
        )
    if raster.crs is not None and raster.crs.is_geographic:
        raise ValueError(
            f"Invalid reference {path} in degrees ({raster.crs}). Must be projected, in metres."
        )


def _unmasked(raster, usual):
    """The heights of a raster's band, NaN where there are none."""
    heights = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
    if raster.nodata is None and usual is not None:
        heights[heights == usual] = np.nan
    return heights * raster.scales[0] + raster.offsets[0]


def _is_grid(path):
    """Whether a text file begins as an Esri ASCII grid does."""
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.readline().strip().lower().startswith("ncols")
