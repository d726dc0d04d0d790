"""Reference heights from files: lists of points, and rasters as points at the cells' middles."""

from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_points
from mmqa_lab.io import CLOUD_ENDINGS, read_cloud

RASTER_ENDINGS = (".asc", ".npz", ".tif", ".tiff")

HEIGHT_NAMES = ("ground", "height", "heights", "z")
"""Arrays of an ``.npz`` that are taken for heights, in this order."""

_SCALE_TAG, _TIE_TAG, _EMPTY_TAG = 33550, 33922, 42113
"""GeoTIFF: size of a cell, a cell and its place, the value that stands for nothing (GDAL)."""


def read_heights(path):
    """Read reference points from a list or a raster.

    Parameters
    ----------
    path : path
        Any cloud file (``io.read_cloud``): CSV or text with x, y, z first. Rasters: GeoTIFF
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
        If it is neither, is damaged, or holds no height.

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
        points = _cells(*_from_arrays(path))
    elif ending in (".tif", ".tiff"):
        points = _cells(*_from_tiff(path))
    elif ending == ".asc" and _is_grid(path):
        points = _cells(*_from_grid(path))
    elif ending in CLOUD_ENDINGS:
        points = read_cloud(path, columns=()).points
    else:
        listed = ", ".join(dict.fromkeys((*CLOUD_ENDINGS, *RASTER_ENDINGS)))
        raise ValueError(f"Invalid reference {path}. Must end in one of {listed}.")
    return check_points(points, name=f"reference {path}")


def _damaged(path, wanted):
    """The error of a file that cannot be read."""
    return ValueError(f"Invalid reference {path}: damaged. Must be {wanted}.")


def _cells(x, y, heights):
    """Middles of the cells that have a height, as points."""
    known = np.isfinite(heights)
    rows, columns = np.nonzero(known)
    return np.column_stack([x[columns], y[rows], heights[known]])


def _from_arrays(path):
    """x, y and heights of an ``.npz``."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], dtype=np.float64) for name in file.files}
    except (OSError, ValueError, TypeError) as error:
        raise ValueError(
            f"Invalid reference {path}: damaged. Must be arrays of numbers."
        ) from error
    x, y = arrays.get("x"), arrays.get("y")
    name = next((n for n in HEIGHT_NAMES if n in arrays), None)
    if x is None or y is None or name is None or arrays[name].shape != (y.size, x.size):
        raise ValueError(
            f"Invalid reference {path} with arrays {', '.join(arrays) or 'none'}. Must have x, y "
            f"and {' or '.join(HEIGHT_NAMES)} of shape (y, x)."
        )
    return x.ravel(), y.ravel(), arrays[name]


def _from_tiff(path):
    """x, y and heights of a north-up GeoTIFF."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            heights = np.asarray(image, dtype=np.float64)
            tags = {tag: image.tag_v2.get(tag) for tag in (_SCALE_TAG, _TIE_TAG, _EMPTY_TAG)}
    except (OSError, UnidentifiedImageError) as error:
        raise _damaged(path, "a GeoTIFF") from error
    if tags[_SCALE_TAG] is None or tags[_TIE_TAG] is None or heights.ndim != 2:
        raise ValueError(
            f"Invalid reference {path}. Must be a GeoTIFF of one band whose cells have a place."
        )
    dx, dy = tags[_SCALE_TAG][:2]
    column, row, _, x0, y0, _ = tags[_TIE_TAG][:6]
    if tags[_EMPTY_TAG]:
        heights[heights == float(tags[_EMPTY_TAG])] = np.nan
    x = x0 + (np.arange(heights.shape[1]) + 0.5 - column) * dx
    y = y0 - (np.arange(heights.shape[0]) + 0.5 - row) * dy
    return x, y, heights


def _is_grid(path):
    """Whether a text file begins as an Esri ASCII grid does."""
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.readline().strip().lower().startswith("ncols")


def _from_grid(path):
    """x, y and heights of an Esri ASCII grid."""
    header, lines = {}, 0
    try:
        with open(path, encoding="utf-8") as file:
            for line in file:
                words = line.split()
                if not words or not words[0][0].isalpha():
                    break
                header[words[0].lower()] = float(words[1])
                lines += 1
        heights = np.loadtxt(path, skiprows=lines, ndmin=2)
        size = header["cellsize"]
        middle = {axis: _middle(header, axis, size) for axis in "xy"}
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise ValueError(
            f"Invalid reference {path}: damaged. Must be an Esri ASCII grid."
        ) from error
    if heights.shape != (header.get("nrows"), header.get("ncols")):
        raise ValueError(
            f"Invalid reference {path} of shape {heights.shape}. Must have nrows and ncols cells."
        )
    heights[heights == header.get("nodata_value", -9999.0)] = np.nan
    rows, columns = heights.shape
    x = middle["x"] + np.arange(columns) * size
    y = middle["y"] + np.arange(rows)[::-1] * size
    return x, y, heights


def _middle(header, axis, size):
    """Middle of the lower left cell."""
    if f"{axis}llcenter" in header:
        return header[f"{axis}llcenter"]
    return header[f"{axis}llcorner"] + size / 2
