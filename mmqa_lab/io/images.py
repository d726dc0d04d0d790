"""Images from files, and between their grey values and linear light."""

from __future__ import annotations

import os
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice

GAMMAS = ("srgb", "linear")

SRGB_KNEE = 0.0031308


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
        raise ValueError(f"Invalid image {path}. Must be JPEG, PNG or TIFF with 8 or 16 bits.")
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


def _checked_path(path):
    """The path of a complete file."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid image {path}: no such file. Must exist.")
    if not _is_complete(path):
        raise ValueError(f"Invalid image {path}: cut short. Must be a complete file.")
    return path
