"""Images from files."""

from __future__ import annotations

import os
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np


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

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid image {path}: no such file. Must exist.")
    if not _is_complete(path):
        raise ValueError(f"Invalid image {path}: cut short. Must be a complete file.")
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
    """Where a JPEG's coded pixels begin, behind the previews that its first segments may hold."""
    place = 2
    while place < len(whole) and whole[place : place + 2] != b"\xff\xda":
        place += 2 + int.from_bytes(whole[place + 2 : place + 4], "big")
    return place
