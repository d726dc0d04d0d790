"""The evaluation of a chart in an image file.

Only the chart's window is evaluated, so that panoramas of 250 megapixels cost little more than
their decoding: a byte per pixel while the file is read, then the window alone.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mmqa_lab._checks import check_choice
from mmqa_lab.chart_image.evaluation import evaluate_image
from mmqa_lab.chart_image.light import GAMMAS, decode
from mmqa_lab.chart_image.locate import locate_corners, locate_markers
from mmqa_lab.chart_image.mapping import ChartMap, FrameCamera, PanoramaCamera, Pose
from mmqa_lab.charts import from_json, imaging_chart
from mmqa_lab.io import read_grey

LAYOUTS = ("grey", "black")
"""Names of the layouts as built: the imaging chart with its lying bar in grey or black."""

MARGIN_PX = 16
"""Around the chart's corners in its window."""

CAMERAS = ("plain", "panorama")


@dataclass(frozen=True, eq=False)
class Window:
    """A part of an image.

    Parameters
    ----------
    values : array of float32, shape (rows, columns)
        Linear light, full scale 1.
    origin : (int, int)
        Column and row of its first pixel in the whole image.
    size : (int, int)
        Columns and rows of the whole image.

    Examples
    --------
    >>> layout, grey = imaging_chart(), np.full((300, 400), 255, np.uint8)
    >>> square = [[100, 200], [200, 200], [200, 100], [100, 100]]
    >>> window, _ = cut(grey, locate_corners(square, layout), layout)
    >>> window.size, window.values.max().item()
    ((400, 300), 1.0)
    """

    values: np.ndarray
    origin: tuple
    size: tuple


def cut(grey, chart_map, layout, *, gamma="srgb"):
    """Return the window of a chart in an image, as linear light, with the map counted from there.

    Parameters
    ----------
    grey : array of uint8 or uint16
        From :func:`mmqa_lab.io.read_grey`.
    chart_map : ChartMap
        For the whole image.
    layout : Layout
    gamma : {"srgb", "linear"}
        How the file's values follow light.

    Returns
    -------
    (Window, ChartMap)

    Raises
    ------
    ValueError
        If the chart is not within the image.

    Examples
    --------
    >>> layout, grey = imaging_chart(), np.zeros((300, 400), np.uint8)
    >>> square = [[100, 200], [200, 200], [200, 100], [100, 100]]
    >>> window, there = cut(grey, locate_corners(square, layout), layout)
    >>> middle = there.pixels([[500, 500]]) + window.origin
    >>> middle.round(6).tolist()
    [[150.0, 150.0]]
    """
    check_choice(gamma, "gamma", GAMMAS)
    corners = chart_map.pixels(layout.corners())
    size = np.array(grey.shape[::-1])
    if not np.isfinite(corners).all() or (corners < -0.5).any() or (corners > size - 0.5).any():
        raise ValueError(
            f"Invalid place of the chart: corners at {corners.round().tolist()}. "
            f"Must lie within {size[0]} x {size[1]} pixels."
        )
    first = np.maximum(np.floor(corners.min(axis=0)).astype(int) - MARGIN_PX, 0)
    last = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + MARGIN_PX + 1, size)
    part = grey[first[1] : last[1], first[0] : last[0]]
    values = decode(part.astype(np.float32) / np.iinfo(grey.dtype).max, gamma)
    origin = int(first[0]), int(first[1])
    return Window(values, origin, tuple(size.tolist())), chart_map.within(*origin)


def evaluate_file(path, layout, *, corners=None, orientation=None, camera="plain", gamma="srgb"):
    """Evaluate a chart in an image file.

    Parameters
    ----------
    path : path
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the chart's corners from the lower left counterclockwise.
    orientation : (camera, Pose, array (4, 3)), optional
        From :func:`read_orientation`. Without it and without corners, the coded targets are looked
        for.
    camera : {"plain", "panorama"}
        Whether straight lines stay straight, or the image is a whole equirectangular panorama.
    gamma : {"srgb", "linear"}

    Returns
    -------
    (ImageQuality, Window)

    Raises
    ------
    FileNotFoundError, ValueError
        Also when the chart is not found: by its targets, at the corners, or within the image.

    Examples
    --------
    >>> import tempfile
    >>> import cv2
    >>> from mmqa_lab.charts import reflectance
    >>> layout = imaging_chart()
    >>> tones = np.pad(255 * reflectance(layout, cell=4)[::-1], 20, constant_values=128)
    >>> square = [[19.5, 269.5], [269.5, 269.5], [269.5, 19.5], [19.5, 19.5]]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = cv2.imwrite(f"{folder}/chart.png", tones.astype(np.uint8))
    ...     path = f"{folder}/chart.png"
    ...     quality, _ = evaluate_file(path, layout, corners=square, gamma="linear")
    >>> quality.to_frame()["pixel_h_mm"].round(2).tolist()
    [4.0]
    """
    grey = read_grey(path)
    check_choice(camera, "camera", CAMERAS)
    bends = None if camera == "plain" else panorama_of(grey)
    if orientation is not None:
        there = ChartMap.from_orientation(*orientation, layout)
    elif corners is not None:
        there = locate_corners(corners, layout, camera=bends)
    else:
        there = locate_markers(grey, layout, camera=bends)
    window, there = cut(grey, there, layout, gamma=gamma)
    del grey
    return evaluate_image(window.values, layout, there), window


def panorama_of(grey):
    """Return the panorama camera of a whole equirectangular image.

    Parameters
    ----------
    grey : array, shape (rows, 2 rows)

    Returns
    -------
    PanoramaCamera

    Raises
    ------
    ValueError
        If the image is not twice as wide as high.

    Examples
    --------
    >>> panorama_of(np.zeros((4000, 8000), np.uint8)).width
    8000
    """
    rows, columns = grey.shape
    if columns != 2 * rows:
        raise ValueError(f"Invalid panorama of {columns} x {rows} pixels. Must be 2 : 1.")
    return PanoramaCamera(columns)


def read_layout(source):
    """Return the layout of a chart by its name or from a JSON file that ``mmqa chart`` wrote.

    Parameters
    ----------
    source : str or path
        ``grey`` or ``black``: the imaging chart with its lying bar in that tone; else a file.

    Returns
    -------
    Layout

    Raises
    ------
    FileNotFoundError
        If it is no such name and no file.
    ValueError
        If the file describes no layout.

    Examples
    --------
    >>> read_layout("black").name
    'imaging chart, black bar'
    """
    if str(source) in LAYOUTS:
        return imaging_chart(horizontal_bar=str(source))
    path = Path(source)
    if not path.is_file():
        raise FileNotFoundError(
            f"Invalid chart {source}: no such file. Must exist, or be one of {', '.join(LAYOUTS)}."
        )
    return from_json(path.read_text(encoding="utf-8"))


def read_orientation(path):
    """Read the exterior and interior orientation of an image and the chart's corners.

    Parameters
    ----------
    path : path
        JSON with ``position`` [east, north, height] in metres; ``heading_deg`` (clockwise from
        north), ``pitch_deg`` (up) and ``roll_deg`` (to the right) of the view; ``corners``, four
        [east, north, height] from the chart's lower left counterclockwise; ``camera``, with
        ``width`` alone for a panorama, else ``width``, ``height``, ``focal_px`` and, optionally,
        ``principal`` and ``distortion``.

    Returns
    -------
    (FrameCamera or PanoramaCamera, Pose, array (4, 3))

    Raises
    ------
    FileNotFoundError, ValueError

    Examples
    --------
    >>> import tempfile
    >>> angles = {"heading_deg": 90, "pitch_deg": 0, "roll_deg": 0}
    >>> corners = [[5, 0.5, 1], [5, -0.5, 1], [5, -0.5, 2], [5, 0.5, 2]]
    >>> whole = {"position": [0, 0, 1.5], **angles, "camera": {"width": 8000}, "corners": corners}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "o.json").write_text(json.dumps(whole))
    ...     camera, pose, corners = read_orientation(Path(folder) / "o.json")
    >>> camera.height, pose.to_camera(corners).mean(axis=0).round(6).tolist()
    (4000, [0.0, 0.0, 5.0])
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid orientation {path}: no such file. Must exist.")
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
        angles = [whole[f"{name}_deg"] for name in ("heading", "pitch", "roll")]
        pose = Pose.of_angles(whole["position"], *angles)
        kind = FrameCamera if "focal_px" in whole["camera"] else PanoramaCamera
        return kind(**whole["camera"]), pose, np.array(whole["corners"], dtype=float)
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f"Invalid orientation {path}: {error}. Must have all fields.") from None
