"""Photographs and rasters: grey values, bands, and heights of cells."""

from __future__ import annotations

import logging
import os
import re
import warnings
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_file, check_same_crs, refuse
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import systems
from mmqa_lab.io.clouds import read_cloud
from mmqa_lab.io.files import HEAD, reading
from mmqa_lab.io.tables import NO_HEIGHT_M

__all__ = ["IMAGE_ENDINGS", "read_bands", "read_heights", "read_image"]

TIFF_ENDINGS = (".tif", ".tiff")
IMAGE_ENDINGS = (*TIFF_ENDINGS, ".jpg", ".jpeg", ".png")
IMAGES = "a complete JPEG, PNG or TIFF file of 8 or 16 bits"
RASTERS = "a GeoTIFF of one band with north upwards and an EPSG number"

# Kinds of pages and of grey values in TIFF 6.0, and how each orientation is turned upright.
MASK, WHITE_IS_ZERO, PALETTE, ORIENTATION = 4, 0, 3, 274
ORIENTATIONS = {2: (0, 1), 3: (2, 0), 4: (2, 1), 5: (3, 1), 6: (3, 0), 7: (1, 1), 8: (1, 0)}

# Markers of JPEG without a length (ISO 10918-1, B.1.1.3).
BARE_MARKERS = (0x01, *range(0xD0, 0xD9), 0xFF)

# Cells narrower than this are in degrees.
NARROWEST_CELL_M = 0.001


def read_image(path: str | os.PathLike) -> np.ndarray:
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
        If it is no image, or cut short.

    Examples
    --------
    >>> import tempfile
    >>> import cv2
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = cv2.imwrite(f"{folder}/dark.png", np.full((4, 6), 1000, np.uint16))
    ...     grey = read_image(f"{folder}/dark.png")
    >>> grey.shape, str(grey.dtype), int(grey.max())
    ((4, 6), 'uint16', 1000)
    """
    import cv2

    if check_file(path, "image").suffix.lower() in TIFF_ENDINGS:
        bands = read_bands(path)
        colour = np.ascontiguousarray(np.moveaxis(bands[:3], 0, 2))
        grey = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY) if len(bands) > 2 else bands[0]
    else:
        grey = _decoded(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    odd = grey.dtype not in (np.uint8, np.uint16) or min(grey.shape) < 3
    found = f"{grey.shape[0]} x {grey.shape[1]} pixels of type {grey.dtype}"
    refuse(odd, f"image {path}", found, IMAGES)
    return grey


def read_bands(path: str | os.PathLike) -> np.ndarray:
    """Read all bands of an image file, in its type and order; shape (bands, rows, columns).

    Upright as viewers show it and :func:`read_image` returns it, with white as the largest value;
    a palette becomes red, green, blue.
    """
    import cv2

    if check_file(path, "image").suffix.lower() not in TIFF_ENDINGS:
        pixels = np.atleast_3d(_decoded(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH))
        return np.moveaxis(pixels[..., ::-1], 2, 0)  # OpenCV begins with blue
    with _tiff(path, "image", IMAGES) as file:
        page = _first_page(path, file)
        pixels, decoded = _page(path, page, IMAGES)
        kind, turn = page.photometric, page.tags.valueof(ORIENTATION, default=1)
        colours = page.colormap if kind == PALETTE else None
    inverted = kind == WHITE_IS_ZERO and not (decoded and pixels.dtype == np.uint8)
    if inverted and pixels.dtype.kind == "u":
        pixels = (2**page.bitspersample - 1 - pixels).astype(pixels.dtype)
    if colours is not None and not decoded:
        pixels = np.moveaxis(colours[:, pixels[..., 0]] >> 8, 0, 2).astype(np.uint8)
    quarters, mirrored = ORIENTATIONS.get(1 if decoded else turn, (0, 0))
    pixels = np.rot90(pixels, quarters)
    return np.moveaxis(pixels[:, ::-1] if mirrored else pixels, 2, 0)


def _tiff(path, name, wanted):
    """An open TIFF file."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # a sentence says what is wrong
    with reading(path, name, wanted):
        file = tifffile.TiffFile(path)
        file.pages.first  # noqa: B018 - or an error, where there is no page
        return file


def _first_page(path, file):
    """The first page of a TIFF file; that there are others of its size is said."""
    page = file.pages[0]
    same = sum(one.shape == page.shape and not one.subfiletype for one in file.pages)
    if same > 1:
        warnings.warn(f"Read the first of {same} pages of {path}.", stacklevel=3)
    return page


def _page(path, page, wanted):
    """The pixels of a TIFF page, bands last, and whether OpenCV decoded and turned them."""
    import cv2

    try:
        pixels = np.atleast_3d(page.asarray())
        return (np.moveaxis(pixels, 0, 2) if page.axes[0] == "S" else pixels), False
    except Exception as error:  # LZW and JPEG need another library; OpenCV has them for 4 bands
        if "imagecodecs" not in str(error):
            found = "damaged or cut short"
            raise ValueError(f"Invalid image {path}: {found}. Must be {wanted}.") from error
    pixels = np.atleast_3d(_decoded(path, cv2.IMREAD_UNCHANGED))
    order = [2, 1, 0, 3][: pixels.shape[2]] if pixels.shape[2] > 2 else [0]
    return pixels[..., order], True


def _decoded(path, flags):
    """An image as OpenCV decodes it, which fills up what is missing of a JPEG or PNG file."""
    import cv2

    data = Path(path).read_bytes()
    gamma = re.search(rb"gAMA(.{4})", data[:HEAD], re.DOTALL) if data[:2] == b"\x89P" else None
    value = int.from_bytes(gamma[1], "big") / 1e5 if gamma else 0.45
    if not 0.4 < value < 0.5:
        told = "linear in light" if abs(value - 1) < 0.01 else f"of gamma {value:.2g}"
        warnings.warn(f"{path} states that its values are {told}, not sRGB.", stacklevel=3)
    refuse(not _is_complete(data), f"image {path}", "cut short", IMAGES)
    # OpenCV prints what it dislikes of a file; the sentence says it
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    with reading(path, "image", IMAGES):
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)  # any letters in the path
    refuse(pixels is None, f"image {path}", "no image that can be decoded", IMAGES)
    return pixels


def _is_complete(data):
    """Whether a JPEG or PNG file has its end, whatever stands behind it, as the film of a phone."""
    if data[:2] == b"\x89P":
        return b"IEND" in data
    if data[:2] != b"\xff\xd8":
        return True
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] not in (b"\xda", b""):
        bare = data[at + 1] in BARE_MARKERS
        at += 2 + (0 if bare else int.from_bytes(data[at + 2 : at + 4], "big"))
    return data.find(b"\xff\xd9", at) >= 0


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
    raster = check_file(path, "reference").suffix.lower() in TIFF_ENDINGS
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
    with _tiff(path, "reference", RASTERS) as file:
        page = _first_page(path, file)
        refuse(page.samplesperpixel != 1, what, f"{page.samplesperpixel} bands", RASTERS)
        place = _place(page.tags, what)
        rows = np.reshape(page.tags.valueof("GeoKeyDirectoryTag", default=()), (-1, 4))[1:]
        keys = {number: value for number, place_of, _, value in rows.tolist() if place_of == 0}
        stored, _ = _page(path, page, RASTERS)
        refuse(stored.dtype.kind not in "iuf", what, f"values of type {stored.dtype}", "heights")
        heights = stored[..., 0].astype(np.float64)
        nothing = _number(page.tags.valueof("GDAL_NODATA"), "no-data value", what, np.nan)
        heights[stored[..., 0] == nothing] = np.nan
        scale, offset = _scale(page.tags.valueof("GDAL_METADATA", default=""), what)
        masks = [_page(path, one, RASTERS)[0] for one in file.pages[1:] if one.subfiletype == MASK]
    if Path(f"{path}.msk").is_file():
        with _tiff(f"{path}.msk", "mask", RASTERS) as file:
            masks.append(_page(f"{path}.msk", file.pages[0], RASTERS)[0])
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
