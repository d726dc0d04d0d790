"""Images and rasters of heights from files, and between grey values and linear light."""

from __future__ import annotations

import os
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice, check_crs, check_file, check_metres, check_points
from mmqa_lab.io.clouds import CLOUD_ENDINGS, LAS_ENDINGS, TEXT_ENDINGS, read_cloud

GAMMAS = ("srgb", "linear")

SRGB_KNEE = 0.0031308

PHOTOMETRIC, COLOUR_FILTERS = {"little": b"\x06\x01", "big": b"\x01\x06"}, 32803
"""TIFF's field for what values mean, and its value for a mosaic."""


def read_grey(path: str | os.PathLike) -> np.ndarray:
    """Read an image file as grey values, in the type of the file.

    Parameters
    ----------
    path : path
        JPEG, PNG, TIFF or another format that OpenCV decodes, 8 or 16 bits.

    Returns
    -------
    array of uint8 or uint16, shape (rows, columns)

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no image or damaged.

    Examples
    --------
    >>> import tempfile
    >>> import cv2
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = cv2.imwrite(f"{folder}/dark.png", np.full((4, 6), 1000, np.uint16))
    ...     grey = read_grey(f"{folder}/dark.png")
    >>> grey.shape, str(grey.dtype), int(grey.max())
    ((4, 6), 'uint16', 1000)
    """
    import cv2

    path = _checked_path(path)
    # OpenCV prints what it dislikes of a file; the sentence below says it
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        grey = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if grey is None or grey.dtype.kind != "u" or min(grey.shape) < 3:
        raise ValueError(
            f"Invalid image {path}. Must be JPEG, PNG or TIFF with 8 or 16 bits and 3 x 3 pixels "
            "or more; export HEIC and raw photographs as one of these."
        )
    return grey


@contextmanager
def _raster(path):
    """An image file as rasterio reads it."""
    import rasterio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        try:
            with rasterio.open(_checked_path(path)) as file:
                yield file
        except rasterio.errors.RasterioError:
            raise ValueError(f"Invalid image {path}. Must be JPEG, PNG or TIFF.") from None


def image_size(path):
    """Return columns and rows of an image file from its header; nothing is decoded."""
    with _raster(path) as file:
        return file.width, file.height


def image_tags(path):
    """Return what the EXIF of an image file says, by its names without EXIF_; perhaps nothing."""
    with _raster(path) as file:
        tags = file.tags() | file.tags(ns="EXIF")
    return {name.removeprefix("EXIF_"): text for name, text in tags.items()}


def read_colours(path, origin, last):
    """Return red, green and blue between two pixels (column, row), or None of a grey file."""
    with _raster(path) as file:
        if file.count < 3:
            return None
        (first_column, first_row), (column, row) = origin, last
        part = file.read((1, 2, 3), window=((first_row, row), (first_column, column)))
    return np.moveaxis(part, 0, -1)


@dataclass(frozen=True, eq=False)
class Bands:
    """The bands of an image: ``values`` (bands, rows, columns), their names ``bands``, and
    ``exposure``, time in seconds and f-number of its EXIF or None."""

    values: np.ndarray
    bands: list
    exposure: tuple | None


def read_bands(path):
    """Read all bands of an image file in the type of the file: a :class:`Bands`."""
    with _raster(path) as file:
        values, tags = file.read(), file.tags() | file.tags(ns="EXIF")
        bands = [name or str(k) for k, name in enumerate(file.descriptions, start=1)]
    if values.dtype.kind not in "uif":
        raise ValueError(f"Invalid image {path}. Must be JPEG, PNG or TIFF.")
    numbers = [exif_number(tags.get(f"EXIF_{name}", "")) for name in ("ExposureTime", "FNumber")]
    return Bands(values, bands, tuple(numbers) if all(numbers) else None)


def exif_number(text):
    """A number as GDAL writes it, in brackets; None for none."""
    try:
        return float(text.strip("() "))
    except ValueError:
        return None


def check_image(image, *, convert=True):
    """Return a grey image as float64, or in its own type without ``convert``.

    Raises
    ------
    TypeError, ValueError
        If it is no array of real numbers with two dimensions, or has values that are not finite.
    """
    values = np.asarray(image)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"Invalid image of type {values.dtype}. Must be real numbers.")
    if values.ndim != 2 or min(values.shape) < 3:
        raise ValueError(f"Invalid image of shape {values.shape}. Must be grey, 3 x 3 or larger.")
    if not np.isfinite(values).all():
        raise ValueError("Invalid image: values that are not finite. Must be finite.")
    return values.astype(np.float64) if convert else values


def encode(values, gamma):
    """Return values 0..1 of linear light as the file's: unchanged, or by sRGB's curve."""
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    values = np.clip(values, 0, 1)
    curve = 1.055 * np.maximum(values, SRGB_KNEE) ** (1 / 2.4) - 0.055
    return np.where(values <= SRGB_KNEE, 12.92 * values, curve).astype(values.dtype)


def decode(values, gamma):
    """Return a file's values 0..1 as linear light, the inverse of :func:`encode`.

    Examples
    --------
    >>> bool(np.isclose(decode(encode(np.array([0.2]), "srgb"), "srgb"), 0.2)[0])
    True
    """
    if check_choice(gamma, "gamma", GAMMAS) == "linear":
        return values
    curve = ((np.maximum(values, 12.92 * SRGB_KNEE) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 12.92 * SRGB_KNEE, values / 12.92, curve).astype(values.dtype)


def _is_complete(path):
    """Whether a JPEG or PNG file has its end; decoders fill up what is missing."""
    with path.open("rb") as file:
        if not file.read(1):
            return False
        with mmap(file.fileno(), 0, access=ACCESS_READ) as whole:
            if whole[:2] == b"\xff\xd8":
                return whole.find(b"\xff\xd9", _scan_of_jpeg(whole)) > 0
            return whole[1:4] != b"PNG" or whole.rfind(b"IEND") > 0


def _scan_of_jpeg(whole):
    """Where a JPEG's coded pixels begin, behind the previews that may come first."""
    place = 2
    while place < len(whole) and whole[place : place + 2] != b"\xff\xda":
        place += 2 + int.from_bytes(whole[place + 2 : place + 4], "big")
    return place


def _is_mosaic(path):
    """Whether a TIFF file's pixels lie behind a mosaic of colour filters, as in raw photographs."""
    with path.open("rb") as file:
        head = file.read(8)
        order = {b"II*\0": "little", b"MM\0*": "big"}.get(head[:4])
        if order is None:
            return False
        file.seek(int.from_bytes(head[4:], order))
        fields = [file.read(12) for _ in range(int.from_bytes(file.read(2), order))]
    kinds = [int.from_bytes(one[8:10], order) for one in fields if one[:2] == PHOTOMETRIC[order]]
    return COLOUR_FILTERS in kinds


def _checked_path(path):
    """The path of a complete file."""
    path = check_file(path, "image")
    if not _is_complete(path):
        raise ValueError(f"Invalid image {path}: cut short. Must be a complete file.")
    if _is_mosaic(path):
        raise ValueError(f"Invalid image {path}: a raw mosaic of colours. Must be developed first.")
    return path


RASTER_ENDINGS = (".asc", ".npz", ".tif", ".tiff")

ARRAY_NAMES = ("ground", "height", "heights", "z")
"""Arrays of an ``.npz`` that are taken for heights, in this order."""

NO_HEIGHT_M = 9999.0
"""Reference heights as large as this stand for none, -9999, -32768 and -3.4e38 among them."""


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
        Metres; cells without a height are left out, and those of 9999 m or more above or below.
        Repeated points of a text file count once.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is neither, is damaged, has no height, or is not in metres.

    Warns
    -----
    UserWarning
        How many points of a file were left out.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "levelled.csv").write_text("x,y,z\\n0,0,1.25\\n1,0,1.5\\n")
    ...     read_heights(Path(folder) / "levelled.csv").tolist()
    [[0.0, 0.0, 1.25], [1.0, 0.0, 1.5]]
    """
    path = check_file(path, "reference")
    ending = path.suffix.lower()
    if ending == ".npz":
        points = _from_arrays(path)
    elif is_raster(path):
        points = _from_raster(path)
    elif ending in CLOUD_ENDINGS:
        points = _listed(path, ending)
    else:
        listed = ", ".join(dict.fromkeys((*CLOUD_ENDINGS, *RASTER_ENDINGS)))
        raise ValueError(f"Invalid reference {path}. Must end in one of {listed}.")
    points = check_points(points, name=f"reference {path}")
    points = points[np.abs(points[:, 2]) < NO_HEIGHT_M]
    if not len(points):
        raise ValueError(f"Invalid reference {path}: no height below {NO_HEIGHT_M:g} m. Must have.")
    return points


def _listed(path, ending):
    """The points of a file of points; what of them will not count is said."""
    points = read_cloud(path, columns=()).points
    said = {f"without a height below {NO_HEIGHT_M:g} m": np.abs(points[:, 2]) >= NO_HEIGHT_M}
    if ending in TEXT_ENDINGS:
        again = np.ones(len(points), dtype=bool)
        again[np.unique(points, axis=0, return_index=True)[1]] = False
        said["that repeat"] = again
        points = points[~again]
    for what, which in said.items():
        if which.any():
            warnings.warn(f"Dropped {which.sum()} points of {path} {what}.", stacklevel=3)
    return points


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
                heights = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
                heights = heights * raster.scales[0] + raster.offsets[0]
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
    if raster.crs is not None:
        check_metres(check_crs(raster.crs.to_wkt()), f"reference {path}")


def _is_grid(path):
    """Whether a text file begins as an Esri ASCII grid does."""
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.readline().strip().lower().startswith("ncols")
