"""Finding a chart in an image, and everything that one image of a chart tells about its camera.

Only the chart's window is evaluated, so that panoramas of 250 megapixels cost little more than
their decoding: a byte per pixel while the file is read, then the window alone.
"""

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice
from mmqa_lab._results import Shown
from mmqa_lab.chart_image.geometry import ChartMap, FrameCamera, PanoramaCamera, Pose, four_corners
from mmqa_lab.chart_image.reading import (
    SMALLEST_GAP,
    SMALLEST_PAIR_PX,
    Tones,
    bar_edges,
    find_tones,
    pixel_sizes,
    read_pairs,
    resolution,
)
from mmqa_lab.charts import Layout, LinePairs, Marker, imaging_chart, reflectance
from mmqa_lab.io.images import GAMMAS, check_image, decode, read_grey

LAYOUTS = {
    "grey": {},
    "black": {"horizontal_bar": "black"},
    "revised": {"revised": True},
}
"""Names of the imaging charts: as built, with its lying bar black, and as the authors advise."""

MARGIN_PX = 16
"""Around the chart's outline in its window."""

CAMERAS = ("plain", "panorama")

LARGEST_CLIPPED, LARGEST_RESIDUAL_PX = 0.05, 1.0
"""Beyond these a remark doubts the figures."""

MODEL_SHARE = 0.005
"""Share of MTF50 that the models of edge and chart err by, from simulated photographs."""

OUTLINES = {True: "C5", False: "C1"}
"""Colours of resolved and refused patterns."""

ENLARGEMENTS = (1, 2, 4)
"""Small targets are looked for in the image enlarged so many times."""

ENLARGED_PIXELS = 4e6
"""Larger images than this are not enlarged."""

SMALLEST_OUTLINE_PX = 24
"""Pixels around a target: those of 8 px a side cannot be decoded any more."""

SEARCHED_PIXELS = 12e6
"""Larger images than this are searched in strips."""

OVERLAP_ROWS = 512
"""Of the strips: larger than any target in images that large."""

FINEST_PAIR_PX = 3.0
"""Line pairs narrower than this take no part in the alignment: aliased, they would mislead it."""

SMALLEST_CORRELATION = 0.6
"""Between chart and image after alignment; unrelated pictures stay below 0.3."""

ALIGNMENT_CELL_PX = 0.6
"""Cells of the alignment in pixels: with whole pixels it errs three times as much."""

COARSE_CELLS = 250
"""The alignment begins with about so many cells along a side: quick, also where there is no chart
at all."""

LARGEST_MOVE = 0.03
"""Share of the chart's side by which the alignment may move a corner."""


@dataclass(frozen=True, eq=False)
class ImageQuality(Shown):
    """The quality figures of one image of a chart.

    Parameters
    ----------
    chart_map : ChartMap
    tones : Tones
    sizes : DataFrame
        Of :func:`mmqa_lab.chart_image.reading.pixel_sizes`.
    pairs : DataFrame
        Of :func:`mmqa_lab.chart_image.read_pairs`.
    edges : DataFrame
        Of :func:`mmqa_lab.chart_image.reading.bar_edges`.
    image : array, shape (rows, columns)
        Linear light, full scale 1; of a file, the window around the chart.
    layout : Layout
    origin : (int, int)
        Column and row of the window's first pixel in the file.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, there, aligned=False)
    >>> quality.resolution("h").n, quality.to_frame()["pixel_v_mm"].round(3).item()
    (10, 4.0)
    """

    chart_map: ChartMap
    tones: Tones
    sizes: pd.DataFrame
    pairs: pd.DataFrame
    edges: pd.DataFrame
    image: np.ndarray
    layout: Layout
    origin: tuple = (0, 0)

    def pixel_size(self, direction):
        """Return the pixel size in direction h or v and its standard deviation, mm."""
        bars = self.sizes[self.sizes["direction"] == direction].dropna(subset=["pixel_mm"])
        if bars.empty:
            return np.nan, np.nan
        mean = bars["length_mm"].sum() / bars["length_px"].sum()
        return float(mean), float(np.sqrt((bars["pixel_sigma_mm"] ** 2).sum()) / len(bars))

    def resolution(self, direction):
        """Return the finest resolved line pairs in direction h or v."""
        return resolution(self.pairs, direction)

    def mtf50(self, direction):
        """Return MTF50 in direction h or v and its standard deviation, cycles per pixel."""
        rows = self.edges[self.edges["direction"] == direction].dropna(subset=["mtf50_sigma"])
        if rows.empty:
            return np.nan, np.nan
        weights = 1 / np.maximum(rows["mtf50_sigma"], 1e-6) ** 2
        mean = float((weights * rows["mtf50"]).sum() / weights.sum())
        # edges that differ by more than their deviations widen the interval
        differ = (weights * (rows["mtf50"] - mean) ** 2).sum() / max(len(rows) - 1, 1)
        sigma = np.sqrt(max(differ, 1) / weights.sum())
        return mean, float(np.hypot(sigma, MODEL_SHARE * mean))

    def to_frame(self):
        """Return one row with every figure in the field's units; NaN where not measurable."""
        residual = float(np.sqrt((self.sizes["offset_px"] ** 2).mean()))
        row = {"located_by": self.chart_map.source, "residual_px": residual}
        for direction in "hv":
            size, sigma = self.pixel_size(direction)
            found = self.resolution(direction)
            row[f"pixel_{direction}_mm"], row[f"pixel_{direction}_sigma_mm"] = size, sigma
            bars = self.sizes[self.sizes["direction"] == direction]
            row[f"pixel_{direction}_std_px"] = bars["repeats_std_px"].max() if len(bars) else np.nan
            row[f"w_{direction}_mm"] = found.width_mm
            row[f"w_{direction}_next_mm"] = found.next_mm
            row[f"limit_{direction}_mm"] = found.limit_mm
            mtf50, mtf50_sigma = self.mtf50(direction)
            row[f"mtf50_{direction}_per_px"] = mtf50
            row[f"mtf50_{direction}_sigma_per_px"] = mtf50_sigma
        row["noise_share"] = self.tones.noise
        row["clipped_share"] = self.tones.clipped_share
        return pd.DataFrame([row | {"remark": self._remark(row)}])

    def _remark(self, row):
        """What speaks against the figures of a row."""
        clipped, residual = row["clipped_share"], row["residual_px"]
        doubts = {
            f"{clipped:.0%} of the plain pixels are clipped": clipped > LARGEST_CLIPPED,
            f"bars end {residual:.1f} px from their places": residual > LARGEST_RESIDUAL_PX,
        }
        for direction in "hv":
            refused = f"not even the coarsest line pairs are resolved in direction {direction}"
            doubts[refused] = bool(np.isnan(row[f"w_{direction}_mm"]))
        said = [text for text, true in doubts.items() if true]
        return "; ".join([*said, *sorted(set(self.edges["remark"]) - {""})])

    def plot(self, *, ax):
        """Draw the photograph with its line pairs outlined: resolved or refused.

        Parameters
        ----------
        ax : matplotlib Axes

        Returns
        -------
        Axes
        """
        ax.imshow(self.image, cmap="gray", interpolation="nearest")
        for row in self.pairs.itertuples():
            outline = self.layout[row.name].corners()[[0, 1, 2, 3, 0]]
            ax.plot(*self.chart_map.pixels(outline).T, color=OUTLINES[row.resolved], lw=1)
        for resolved, label in ((True, "resolved"), (False, "refused")):
            ax.plot([], [], color=OUTLINES[resolved], label=label)
        ax.set_axis_off()
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2)
        return ax

    def plot_contrast(self, *, ax):
        """Draw the contrast of line pairs over their width in pixels; resolved ones are filled.

        Parameters
        ----------
        ax : matplotlib Axes

        Returns
        -------
        Axes
        """
        for direction, marker, label in (("h", "o", "standing bars"), ("v", "s", "lying bars")):
            part = self.pairs[self.pairs["direction"] == direction]
            faces = part["resolved"].map({True: "C0", False: "none"})
            shape = {"marker": marker, "s": 18, "facecolors": faces, "edgecolors": "C0"}
            ax.scatter(part["width_px"], part["contrast"], label=label, **shape)
        ax.axhline(SMALLEST_GAP, color="C1", ls="--", lw=0.8)
        ax.axvspan(0.3, SMALLEST_PAIR_PX, color="C1", alpha=0.12, lw=0)
        ax.set(xscale="log", xlabel="width of a line pair (pixels)", ylabel="contrast")
        ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        ax.minorticks_off()
        ax.legend()
        return ax


def evaluate_image(
    image: ArrayLike, layout: Layout, chart_map: ChartMap, *, aligned: bool = True
) -> ImageQuality:
    """Measure pixel size, resolved line pairs and MTF in one image of a chart.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap
        Where the chart is in this image, to a few pixels.
    aligned : bool
        Improve the map by the whole printed chart first.

    Returns
    -------
    ImageQuality

    Raises
    ------
    ValueError
        If the chart is not found there, or black and white cannot be told apart.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, there, aligned=False)
    >>> quality.to_frame()[["pixel_h_mm", "pixel_v_mm"]].round(3).to_numpy().tolist()
    [[4.0, 4.0]]
    """
    if aligned:
        chart_map = align(image, layout, chart_map)
    tones = find_tones(image, layout, chart_map)
    tables = [read(tones, layout, chart_map) for read in (pixel_sizes, read_pairs, bar_edges)]
    return ImageQuality(chart_map, tones, *tables, np.asarray(image), layout)


def evaluate_file(
    path: str | os.PathLike,
    layout: Layout,
    *,
    corners: ArrayLike | None = None,
    orientation: str | os.PathLike | None = None,
    camera: str = "plain",
    gamma: str = "srgb",
) -> ImageQuality:
    """Evaluate a chart in an image file.

    Parameters
    ----------
    path : path
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the chart's corners from the lower left counterclockwise.
    orientation : path, optional
        JSON with ``position`` [east, north, height] in metres; ``heading_deg`` (clockwise from
        north), ``pitch_deg`` (up) and ``roll_deg`` (to the right) of the view; ``corners``, four
        [east, north, height] from the chart's lower left counterclockwise; ``camera``, with
        ``width`` alone for a panorama, else ``width``, ``height``, ``focal_px`` and, optionally,
        ``principal`` and ``distortion``. Without it and without corners, the coded targets are
        looked for.
    camera : {"plain", "panorama"}
        Whether straight lines stay straight, or the image is a whole equirectangular panorama.
    gamma : {"srgb", "linear"}

    Returns
    -------
    ImageQuality

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
    ...     quality = evaluate_file(path, layout, corners=square, gamma="linear")
    >>> quality.to_frame()["pixel_h_mm"].round(2).tolist()
    [4.0]
    """
    grey = read_grey(path)
    check_choice(gamma, "gamma", GAMMAS)
    bends = None
    if check_choice(camera, "camera", CAMERAS) == "panorama":
        rows, columns = grey.shape
        if columns != 2 * rows:
            raise ValueError(f"Invalid panorama of {columns} x {rows} pixels. Must be 2 : 1.")
        bends = PanoramaCamera(columns)
    if orientation is not None:
        there = ChartMap.from_orientation(*read_orientation(orientation), layout)
    else:
        there = locate(grey, layout, corners=corners, camera=bends)
    return evaluate_window(grey, layout, there, gamma=gamma)


def evaluate_window(grey, layout, there, *, gamma):
    """Evaluate a chart in the grey values of a file, whose map is known to a few pixels."""
    origin, last = _window(there, layout, grey.shape)
    part = grey[origin[1] : last[1], origin[0] : last[0]].astype(np.float32)
    values = decode(part / np.iinfo(grey.dtype).max, gamma)
    return replace(evaluate_image(values, layout, there.within(*origin)), origin=origin)


def read_layout(source):
    """Return the layout of a chart by its name or from a JSON file that ``mmqa chart`` wrote.

    Parameters
    ----------
    source : str or path
        ``grey`` or ``black``: the imaging chart with its lying bar in that tone; ``revised``: the
        one that the authors advise; else a file.

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
        return imaging_chart(**LAYOUTS[str(source)])
    path = Path(source)
    if not path.is_file():
        raise FileNotFoundError(
            f"Invalid chart {source}: no such file. Must exist, or be one of {', '.join(LAYOUTS)}."
        )
    return Layout.from_json(path.read_text(encoding="utf-8"))


def locate(
    image: ArrayLike | None,
    layout: Layout,
    *,
    corners: ArrayLike | None = None,
    camera: FrameCamera | PanoramaCamera | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> ChartMap:
    """Find a chart by its coded targets, or at its corners.

    OpenCV finds and decodes the targets; all their corners together give the map.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values, any unit. None will do where corners are given.
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the lower left, lower right, upper right and upper left corner of the
        printed chart. Without them the layout must have targets,
        :class:`mmqa_lab.charts.Marker`.
    camera : FrameCamera or PanoramaCamera, optional
        What bends rays into pixels, for distorted images and panoramas.
    offset : (float, float)
        Column and row of the whole image where this window begins.

    Returns
    -------
    ChartMap

    Raises
    ------
    ValueError
        If there are not four corners in this order; or the layout has no targets or none of them
        is found.

    Notes
    -----
    The six modules of a target need about 2.5 pixels each. Of nine simulated views between -45 and
    45 degrees, all four targets of 90 mm were found in five and some of them in all at pixels of
    5.4 mm, some in six at 8 mm. Two targets alone extrapolate badly; :func:`evaluate_image` then
    says that the chart is not there.

    Examples
    --------
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()  # 1000 mm x 1000 mm
    >>> image = np.pad(255 * reflectance(layout, cell=4)[::-1], 20, constant_values=255)
    >>> found = locate(image.astype(np.uint8), layout)
    >>> found.source, bool(np.abs(found.pixels([[0, 0]]) - [19.5, 269.5]).max() < 0.5)
    ('4 coded targets', True)
    >>> there = locate(None, layout, corners=[[100, 350], [350, 350], [350, 100], [100, 100]])
    >>> there.pixels([[0, 0], [500, 500]]).round(6).tolist()
    [[100.0, 350.0], [225.0, 225.0]]
    """
    bent = {"camera": camera, "offset": offset}
    if corners is not None:
        corners = four_corners(corners, columns=2)
        return ChartMap.from_points(layout.corners(), corners, source="corners", **bent)
    return map_of_markers(find_markers(image, [layout]), layout, **bent)


def map_of_markers(found, layout, **bent):
    """Return the map of a chart from those of its coded targets that were found."""
    markers = {marker.identifier: marker for marker in layout.of_kind(Marker)}
    own = [key for key in found if key in markers]
    if not own:
        raise ValueError(f"Invalid image: no coded target of {layout.name!r}. Must show them.")
    # OpenCV counts from the upper left corner, clockwise
    places = np.concatenate([markers[key].corners()[::-1] for key in own])
    seen, source = np.concatenate([found[key] for key in own]), f"{len(own)} coded targets"
    return ChartMap.from_points(places, seen, source=source, **bent)


def align(image, layout, chart_map):
    """Improve a map by the whole printed chart.

    The image is brought to the chart's frame, where OpenCV maximises its correlation with the
    printed tones over the eight parameters of a homography (ECC). Fine line pairs are left out.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light.
    layout : Layout
    chart_map : ChartMap
        Right to a few pixels.

    Returns
    -------
    ChartMap
        Without residuals: :func:`mmqa_lab.chart_image.pixel_sizes` measures how far the ends of
        the long bars lie from where it puts them.

    Raises
    ------
    ValueError
        If the chart is not found there: no convergence, a correlation below 0.6, or corners that
        moved by more than 3 % of the chart's side.

    References
    ----------
    Evangelidis and Psarakis 2008, doi:10.1109/TPAMI.2008.113.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> wrong = ChartMap(there.matrix + [[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]])
    >>> right = align(image, layout, wrong)
    >>> off = np.abs(right.pixels(layout.corners()) - there.pixels(layout.corners()))
    >>> bool(off.max() < 0.1)
    True
    """
    import cv2

    image = check_image(image)
    pixel_mm = float(np.median(chart_map.pixel_sizes_mm(layout.corners())))
    cell = max(ALIGNMENT_CELL_PX * pixel_mm, layout.width / 1500)
    printed = cv2.GaussianBlur(reflectance(layout, cell=cell), (0, 0), 0.55 * pixel_mm / cell)
    seen, inside = _rectified(image, layout, chart_map, cell, printed.shape)
    mask = inside & _trusted(layout, chart_map, cell, printed.shape)
    to_cells = np.array([[1 / cell, 0, -0.5], [0, 1 / cell, -0.5], [0, 0, 1]])
    change = np.linalg.inv(to_cells) @ _change(printed, seen, mask) @ to_cells
    aligned = chart_map.corrected(change / change[2, 2])
    moved = np.linalg.norm(
        aligned.pixels(layout.corners()) - chart_map.pixels(layout.corners()), axis=1
    ).max()
    limit = max(LARGEST_MOVE * layout.width / pixel_mm, 4)
    if moved > limit:
        raise ValueError(
            f"Invalid place of the chart: a corner lies {moved:.1f} px away. Must be given to "
            f"{limit:.1f} px."
        )
    return aligned


def read_orientation(path):
    """Camera, pose and corners (4, 3) of a chart from a JSON file."""
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


def _window(chart_map, layout, shape):
    """First and last column and row of a chart's surroundings in an image."""
    outline, size = chart_map.outline(layout.corners()), np.array(shape[::-1])
    if not np.isfinite(outline).all() or (outline < -0.5).any() or (outline > size - 0.5).any():
        corners = chart_map.pixels(layout.corners()).round().tolist()
        raise ValueError(
            f"Invalid place of the chart: corners at {corners}. "
            f"Must lie within {size[0]} x {size[1]} pixels."
        )
    first = np.maximum(np.floor(outline.min(axis=0)).astype(int) - MARGIN_PX, 0)
    last = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + MARGIN_PX + 1, size)
    return tuple(first.tolist()), tuple(last.tolist())


def find_markers(image, layouts):
    """Return the corners of the coded targets of one or more charts that are seen, by number."""
    image = check_image(image, convert=False)
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32)
    markers = {m.identifier: m for layout in layouts for m in layout.of_kind(Marker)}
    if not markers:
        name = layouts[0].name
        raise ValueError(f"Invalid chart {name!r}: no coded targets. Must have some.")
    dictionary = next(iter(markers.values())).dictionary
    step = 1 + int(np.sqrt(image.size / 1e6))
    limits = np.percentile(image[::step, ::step], [0.5, 99.5]).astype(image.dtype)
    found = {}
    for enlargement in ENLARGEMENTS:
        if enlargement > 1 and image.size > ENLARGED_PIXELS:
            break
        seen = _detected(image, limits, dictionary, enlargement)
        seen = {key: corners for key, corners in seen.items() if key in markers}
        found = seen if len(seen) > len(found) else found
        if len(found) == len(markers):
            break
    if not found:
        raise ValueError(
            f"Invalid image: none of the {len(markers)} coded targets of {dictionary} found. "
            "Must show them, or the corners of the chart must be given."
        )
    return found


def _detected(image, limits, dictionary, enlargement):
    """Corners of the coded targets by number, in pixels of the image."""
    import cv2

    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    found = {}
    for first, strip in _strips(image):
        low, high = (float(limit) for limit in limits)
        scale = 255 / max(high - low, 1e-12)
        strip = cv2.convertScaleAbs(np.clip(strip, *limits), alpha=scale, beta=-low * scale)
        if enlargement > 1:
            size = (strip.shape[1] * enlargement, strip.shape[0] * enlargement)
            strip = cv2.resize(strip, size, interpolation=cv2.INTER_CUBIC)
        # of the longer side; every smaller contour of a textured image would cost its time
        settings.minMarkerPerimeterRate = SMALLEST_OUTLINE_PX * enlargement / max(strip.shape)
        detector = cv2.aruco.ArucoDetector(book, settings)
        corners, identifiers, _ = detector.detectMarkers(strip)
        for one, key in zip(corners, () if identifiers is None else identifiers, strict=False):
            places = (one.reshape(4, 2).astype(float) + 0.5) / enlargement - 0.5
            found[int(np.ravel(key)[0])] = places + [0, first]
    return found


def _strips(image):
    """An image as strips of rows that overlap, with their first rows."""
    rows = max(int(SEARCHED_PIXELS / image.shape[1]), 4 * OVERLAP_ROWS)
    for first in range(0, max(len(image) - OVERLAP_ROWS, 1), rows - OVERLAP_ROWS):
        yield first, image[first : first + rows]


def _change(printed, seen, mask):
    """The homography of cells that brings print and image together, coarsely first."""
    change = np.eye(3)
    for step, smoothing in ((max(1, max(printed.shape) // COARSE_CELLS), 11), (1, 5)):
        to_coarse = np.array([[1, 0, (1 - step) / 2], [0, 1, (1 - step) / 2], [0, 0, step]]) / step
        start = to_coarse @ change @ np.linalg.inv(to_coarse)
        coarse = [_coarser(one, step) for one in (printed, seen, mask)]
        correlation, found = _maximised(*coarse, start, smoothing)
        if not correlation >= SMALLEST_CORRELATION:
            raise ValueError(
                f"Invalid place of the chart: its print correlates by {correlation:.2f} with the "
                f"image. Must be {SMALLEST_CORRELATION} or more; is the chart there?"
            )
        change = np.linalg.inv(to_coarse) @ found @ to_coarse
    return change


def _coarser(values, step):
    """Means of squares of cells; those beyond the last whole square are left out."""
    import cv2

    rows, columns = (side // step for side in values.shape)
    whole = values[: rows * step, : columns * step]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)


def _maximised(printed, seen, mask, start, smoothing):
    """The largest correlation, 0 without convergence, and the homography that reaches it."""
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-7)
    start, mask = start.astype(np.float32), np.uint8(mask == 255) * 255
    try:
        correlation, found = cv2.findTransformECC(
            printed, seen, start, cv2.MOTION_HOMOGRAPHY, stop, mask, smoothing
        )
    except cv2.error:
        return 0.0, start
    return correlation, found.astype(float)


def _rectified(image, layout, chart_map, cell, shape):
    """The image in the chart's frame, and where it is known."""
    import cv2

    rows, columns = np.indices(shape)
    places = np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5]) * cell
    pixels = chart_map.pixels(places).astype(np.float32).reshape(*shape, 2)
    image = image.astype(np.float32)
    seen = cv2.remap(image, pixels, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    limit = np.array(image.shape[::-1]) - 1
    inside = ((pixels >= 0) & (pixels <= limit)).all(axis=2)
    return seen, inside.astype(np.uint8) * 255


def _trusted(layout, chart_map, cell, shape):
    """The cells that may take part in the alignment."""
    trusted = np.full(shape, 255, dtype=np.uint8)
    for pairs in layout.of_kind(LinePairs):
        outline = pairs.corners()
        axis = 0 if pairs.direction == "h" else 1
        size = chart_map.pixel_sizes_mm(outline.mean(axis=0)[None])[0, axis]
        if pairs.pair / size < FINEST_PAIR_PX:
            low = np.maximum(np.floor(outline[0] / cell - 2), 0).astype(int)
            high = np.ceil(outline[2] / cell + 2).astype(int)
            trusted[low[1] : high[1], low[0] : high[0]] = 0
    return trusted
