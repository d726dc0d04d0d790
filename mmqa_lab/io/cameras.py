"""Files of calibrated cameras, as OpenCV and Python programs write them."""

from __future__ import annotations

import os
import re

import numpy as np

from mmqa_lab._checks import check_count, check_file, refuse
from mmqa_lab.io.files import plain_text, reading

__all__ = ["read_camera"]

# Names of what a calibration has, without capitals, hyphens and underscores.
OF_CAMERA = {
    "matrix": ("cameramatrix", "intrinsicmatrix", "mtx", "k"),
    "distortion": ("distortioncoefficients", "distcoeffs", "distcoeff", "dist", "d"),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "model": ("distortionmodel", "model"),
}

# Bytes of a camera's file, and how deep its parts lie in each other.
LARGEST_CAMERA, DEEPEST = 1_000_000, 20

# Numbers of distortion coefficients; names of OpenCV's model that has them.
COEFFICIENTS = (4, 5, 8, 12, 14)
BROWN = ("plumbbob", "rationalpolynomial", "brown", "pinhole", "opencv")

CALIBRATION = "OpenCV's camera_matrix (3 x 3) and distortion_coefficients (k1, k2, p1, p2, k3, ...)"


def read_camera(path: str | os.PathLike) -> tuple[np.ndarray, np.ndarray, tuple[int, int] | None]:
    """Read the calibration of a camera: OpenCV's YAML, XML or JSON, or plain YAML or JSON.

    Parameters
    ----------
    path : path

    Returns
    -------
    matrix : array, shape (3, 3)
        Focal lengths and principal point, pixels; the first pixel's centre is (0, 0).
    distortion : array, shape (n,)
        Radial and tangential coefficients in OpenCV's order, n of 4, 5, 8, 12 or 14.
    size : (int, int) or None
        Columns and rows of the images, if they are stated.

    Raises
    ------
    FileNotFoundError, ValueError
        Also if matrix or coefficients are missing, or the lens is a fisheye's.

    Examples
    --------
    >>> import tempfile
    >>> text = '{"mtx": [[900, 0, 320], [0, 900, 240], [0, 0, 1]], "dist": [-0.1, 0, 0, 0]}'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/camera.json", "w") as file:
    ...         _ = file.write(text)
    ...     matrix, distortion, size = read_camera(f"{folder}/camera.json")
    >>> matrix[0].tolist(), distortion.tolist(), size
    ([900.0, 0.0, 320.0], [-0.1, 0.0, 0.0, 0.0], None)
    """
    path = check_file(path, "camera")
    small = path.stat().st_size <= LARGEST_CAMERA
    refuse(not small, f"camera {path}", "more than 1 MB", CALIBRATION)
    text = plain_text(path).decode()
    known = {}
    with reading(path, "camera", CALIBRATION):
        _check_depth(text)
        found = _of_xml(text) if text.lstrip().startswith("<") else _of_yaml(text)
        for name, value in found.items():
            known |= {what: value for what, names in OF_CAMERA.items() if _short(name) in names}
    model = _short(known.get("model", BROWN[0]))
    if model not in BROWN:
        raise ValueError(f"Invalid camera {path}: its lens is {model!r}. Must be {CALIBRATION}.")
    values = []
    for what, sizes in (("matrix", (9,)), ("distortion", COEFFICIENTS)):
        value = known.get(what)
        value = value.get("data") if isinstance(value, dict) else value
        try:
            numbers = np.array(value, dtype=float).ravel()
        except (TypeError, ValueError):
            numbers = np.array([])
        if len(numbers) not in sizes or not np.isfinite(numbers).all():
            raise ValueError(f"Invalid camera {path}: no usable {what}. Must have {CALIBRATION}.")
        values.append(numbers)
    matrix = values[0].reshape(3, 3)
    usual = np.diag(np.diag(matrix)) + np.outer([1, 1, 0], [0, 0, 1]) * matrix
    if (matrix != usual).any() or not (np.diag(matrix) > 0).all() or matrix[2, 2] != 1:
        wanted = "fx, 0, cx; 0, fy, cy; 0, 0, 1"
        raise ValueError(f"Invalid camera {path}: matrix {matrix.tolist()}. Must be {wanted}.")
    size = [known[side] for side in ("width", "height") if known.get(side) is not None]
    if len(size) < 2:
        return matrix, values[1], None
    with reading(path, "camera", "calibrated for a picture of whole pixels"):
        width, height = (check_count(float(side), "side") for side in size)
    return matrix, values[1], (width, height)


def _check_depth(text):
    """Raise where parts of XML lie in each other so deep that a parser would end the process."""
    depth = 0
    for tag in re.finditer(r"<(/?)[A-Za-z][^<>]*?(/?)>", text):
        depth += -1 if tag[1] else not tag[2]
        if depth > DEEPEST:
            raise ValueError("too deep")


def _short(name):
    """A name without capitals, hyphens, underscores and blanks."""
    return str(name).lower().translate(dict.fromkeys(map(ord, "-_ ")))


def _of_yaml(text):
    """The top of a YAML or JSON file; OpenCV's matrices are mappings."""
    import yaml

    class Loader(yaml.SafeLoader):
        """Plain values, and OpenCV's tags as what they stand on; no aliases, which multiply."""

        def compose_node(self, parent, index):
            if self.check_event(yaml.events.AliasEvent):
                raise ValueError("an alias")
            return super().compose_node(parent, index)

    Loader.add_multi_constructor("", lambda loader, _, node: loader.construct_mapping(node, True))
    lines = [line for line in text.expandtabs().splitlines() if not line.startswith("%")]
    return dict(yaml.load("\n".join(lines), Loader))


def _of_xml(text):
    """The top of OpenCV's XML."""
    import cv2

    store = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    nodes = {name: store.getNode(name) for name in store.root().keys()}  # noqa: SIM118
    return {
        name: node.mat() if node.isMap() else node.string() if node.isString() else node.real()
        for name, node in nodes.items()
    }
