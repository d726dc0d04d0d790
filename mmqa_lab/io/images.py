"""Photographs: grey values and bands."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import struct
import tempfile
import threading
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_file, refuse
from mmqa_lab.io.files import HEAD, RAW_ENDINGS, reading, refuse_unread

__all__ = ["IMAGE_ENDINGS", "read_bands", "read_image"]

TIFF_ENDINGS = (".tif", ".tiff")
DNG_ENDINGS = (".dng",)
IMAGE_ENDINGS = (*TIFF_ENDINGS, *DNG_ENDINGS, ".jpg", ".jpeg", ".png")
IMAGES = "a complete JPEG, PNG or TIFF file of 8 or 16 bits"

# Kinds of grey values and of a last band in TIFF 6.0, and how each orientation is turned upright.
WHITE_IS_ZERO, PALETTE, ORIENTATION = 0, 3, 274
ALPHA = (1, 2)
ORIENTATIONS = {2: (0, 1), 3: (2, 0), 4: (2, 1), 5: (3, 1), 6: (3, 0), 7: (1, 1), 8: (1, 0)}

# Values of a picture of 300 megapixels in colour: more are not decoded.
MOST_VALUES = 9e8

# Pages of a TIFF file that are compared with its first.
LISTED_PAGES = 100

# What libjpeg and libtiff print of a picture that they then fill up, on the process's stream.
DAMAGED = re.compile(
    rb"Corrupt JPEG data(?!: \d+ extraneous bytes before marker 0xd9)|Premature end|TIFF_Error"
)
DECODING = threading.Lock()

# Colour filters of a sensor (DNG), linear RAW, and inks.
RAW, INKS = (32803, 34892), 5

# Curves of an ICC profile (ICC.1, 10.6 and 10.18) that leave values as they are, and its head.
LINEAR_CURVES = (
    b"curv" + bytes(8), b"curv" + bytes(4) + b"\0\0\0\1\1\0", b"para" + bytes(8) + b"\0\1\0\0"
)  # fmt: skip
ICC_HEAD = 128

# What may stand before a marker of JPEG, those without a length, and those of frames (ISO 10918-1,
# B.1.1.2 and B.1.1.3); bands by kind of PNG, and those with transparency.
FILL, BARE_MARKERS = 0xFF, (0x01, *range(0xD0, 0xD9))
FRAME_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
PNG_BANDS, PNG_ALPHA = {2: 3, 3: 3, 4: 2, 6: 4}, (4, 6)


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

    Warns
    -----
    UserWarning
        If pixels are transparent: they have the colours that are stored below.

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

    path = check_file(path, "image")
    if path.suffix.lower() in (*TIFF_ENDINGS, *DNG_ENDINGS):
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

    path = check_file(path, "image")
    if path.suffix.lower() not in (*TIFF_ENDINGS, *DNG_ENDINGS):
        pixels = np.atleast_3d(_decoded(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH))
        return np.moveaxis(pixels[..., ::-1], 2, 0)  # OpenCV begins with blue
    with _open_tiff(path) as file:
        page = _first_page(path, file)
        pixels, decoded = _tiff_pixels(path, page)
        kind, turn = page.photometric, page.tags.valueof(ORIENTATION, default=1)
        colours = page.colormap if kind == PALETTE else None
        if {*page.extrasamples} & {*ALPHA}:
            _say_transparent(path, pixels[..., -1])
    inverted = kind == WHITE_IS_ZERO and not (decoded and pixels.dtype == np.uint8)
    if inverted and pixels.dtype.kind == "u":
        pixels = (2**page.bitspersample - 1 - pixels).astype(pixels.dtype)
    if colours is not None and not decoded:
        pixels = np.moveaxis(colours[:, pixels[..., 0]] >> 8, 0, 2).astype(np.uint8)
    quarters, mirrored = ORIENTATIONS.get(1 if decoded else turn, (0, 0))
    pixels = np.rot90(pixels, quarters)
    return np.moveaxis(pixels[:, ::-1] if mirrored else pixels, 2, 0)


def _open_tiff(path):
    """An open TIFF file."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # a sentence says what is wrong
    with reading(path, "image", IMAGES):
        return tifffile.TiffFile(path)


def _first_page(path, file):
    """The first whole picture of a TIFF file; that there are others of its size is said."""
    with reading(path, "image", IMAGES):
        tops = list(file.pages[:LISTED_PAGES])
        inside = [one for top in tops for one in (top, *(top.pages or ()))]
        page = next((one for one in inside if not one.subfiletype & 1), tops[0])
        same = sum(one.shape == page.shape and not one.subfiletype for one in tops)
    _check_pixels(path, page.shape)
    what = f"image {path}"
    refuse(page.photometric in RAW, what, "a RAW photograph", "developed, and saved as TIFF")
    refuse(page.photometric == INKS, what, "of inks (CMYK)", "of grey or RGB; save it as such")
    if same > 1:
        warnings.warn(f"Read the first of {same} pages of {path}.", stacklevel=3)
    return page


def _check_pixels(path, shape):
    """Raise before a picture is decoded that needs more memory than a stranger's file may take."""
    found = f"{' x '.join(map(str, shape))} values"
    wrong = np.prod(shape, dtype=float) > MOST_VALUES
    refuse(wrong, f"image {path}", found, f"at most {MOST_VALUES:.1g} values")


def _tiff_pixels(path, page):
    """The pixels of a TIFF page, bands last, and whether OpenCV decoded and turned them."""
    import cv2

    try:
        pixels = np.atleast_3d(page.asarray())
        return (np.moveaxis(pixels, 0, 2) if page.axes[0] == "S" else pixels), False
    except Exception as error:  # LZW and JPEG need another library; OpenCV has them for 4 bands
        if "imagecodecs" not in str(error):
            found = "damaged or cut short"
            raise ValueError(f"Invalid image {path}: {found}. Must be {IMAGES}.") from error
    pixels = np.atleast_3d(_decoded(path, cv2.IMREAD_UNCHANGED))
    order = [2, 1, 0, 3][: pixels.shape[2]] if pixels.shape[2] > 2 else [0]
    return pixels[..., order], True


@contextlib.contextmanager
def _printed_below():
    """What a compiled library prints of its own on the stream of errors, as it decodes."""
    printed = BytesIO()
    with DECODING, tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield printed
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            printed.write(file.read())


def _decoded(path, flags):
    """An image as OpenCV decodes it, which fills up what is missing of a JPEG or PNG file."""
    import cv2

    data = Path(path).read_bytes()
    gamma = re.search(rb"gAMA(.{4})", data[:HEAD], re.DOTALL) if data[:2] == b"\x89P" else None
    value = int.from_bytes(gamma[1], "big") / 1e5 if gamma else 0.45
    if not 0.4 < value < 0.5:
        told = "linear in light" if abs(value - 1) < 0.01 else f"of gamma {value:.2g}"
        warnings.warn(f"{path} states that its values are {told}, not sRGB.", stacklevel=3)
    complete, shape = _shape(data)
    refuse(not complete, f"image {path}", "cut short", IMAGES)
    _check_pixels(path, shape)
    _say_profile(data, path)
    log = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 4, and 5
    log.setLogLevel(2)  # errors alone
    with reading(path, "image", IMAGES), _printed_below() as printed:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)  # any letters in the path
    if pixels is None:
        refuse_unread(path, "image", endings=RAW_ENDINGS)
    refuse(DAMAGED.search(printed.getvalue()), f"image {path}", "damaged", IMAGES)
    refuse(pixels is None, f"image {path}", "no image that can be decoded", IMAGES)
    if data[:2] == b"\x89P" and (data[25] in PNG_ALPHA or b"tRNS" in data[:HEAD]):
        whole = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if whole.ndim == 3 and whole.shape[2] == 4:
            _say_transparent(path, whole[..., 3])
    return pixels


def _say_transparent(path, alpha):
    """Say it if pixels are transparent, of which the stored colours are read."""
    share = np.mean(alpha < (np.iinfo(alpha.dtype).max if alpha.dtype.kind in "iu" else 1))
    if share:
        told = f"{100 * share:.3g} % of the pixels of {path} are transparent"
        warnings.warn(f"{told}: the colours stored below are read.", stacklevel=4)


def _say_profile(data, path):
    """Say that the colour profile of an image is linear."""
    from PIL import Image

    with contextlib.suppress(Exception), Image.open(BytesIO(data)) as image:  # or without one
        profile = image.info.get("icc_profile", b"")
        entry = profile.find(b"TRC", ICC_HEAD)
        start = int.from_bytes(profile[entry + 3 : entry + 7], "big")
        if entry > 0 and profile[start:].startswith(LINEAR_CURVES):
            told = f"{path} has a colour profile that is linear in light."
            warnings.warn(told, stacklevel=4)


def _shape(data):
    """Whether a JPEG or PNG file has its end, whatever stands behind it, and its pixels and bands.

    Of other files OpenCV itself refuses more than 2^30 pixels.
    """
    if data[:2] == b"\x89P":
        wide, high, _, kind = struct.unpack(">IIBB", data[16:26].ljust(10, b"\0"))
        return b"IEND" in data, (high, wide, PNG_BANDS.get(kind, 1))
    if data[:2] != b"\xff\xd8":
        return True, ()
    at, shape = 2, ()
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] not in (b"\xda", b""):
        if data[at + 1] in FRAME_MARKERS:
            shape = struct.unpack(">HHB", data[at + 5 : at + 10].ljust(5, b"\0"))
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        at += 1 if data[at + 1] == FILL else 2 if data[at + 1] in BARE_MARKERS else 2 + length
    return data.find(b"\xff\xd9", at) >= 0, shape
