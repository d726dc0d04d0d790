"""The quality figures of one photograph of a chart."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import refuse
from mmqa_lab._results import Shown
from mmqa_lab.chart_image.alignment import align
from mmqa_lab.chart_image.doubts import doubts
from mmqa_lab.chart_image.finding import locate
from mmqa_lab.chart_image.line_pairs import (
    HIDDEN,
    SMALLEST_GAP,
    SMALLEST_PAIR_PX,
    Resolution,
    read_pairs,
    resolution,
)
from mmqa_lab.chart_image.maps import ChartMap, LensCamera, PanoramaCamera
from mmqa_lab.chart_image.tones import Tones, find_tones, pixel_sizes
from mmqa_lab.charts import Layout, decode
from mmqa_lab.io import read_camera, read_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["ImageQuality", "evaluate_file", "evaluate_image"]

OUTLINES = {True: {"color": "C5", "ls": "-"}, False: {"color": "C1", "ls": "--"}}
"""Lines around resolved and refused patterns."""

UNSEEN_PX = 0.5
"""Standard deviation of a bar's length in the map, px, where something hides an end of it."""


def evaluate_image(image: ArrayLike, layout: Layout, chart_map: ChartMap) -> ImageQuality:
    """Measure pixel size and resolved line pairs in one image of a chart.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap
        Where the chart is in this image, to a few pixels; the whole print improves it.

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
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, chart_map)
    >>> quality.to_frame()[["pixel_h_mm", "pixel_v_mm"]].round(2).to_numpy().tolist()
    [[4.0, 4.0]]
    """
    chart_map = align(image, layout, chart_map)
    tones = find_tones(image, layout, chart_map)
    pairs = read_pairs(tones, layout, chart_map)
    sizes = pixel_sizes(tones, layout, chart_map, hidden=(pairs["reason"] == HIDDEN).any())
    return ImageQuality(chart_map, tones, sizes, pairs, np.asarray(image), layout)


def evaluate_file(
    path: str | os.PathLike,
    layout: Layout,
    *,
    corners: ArrayLike | None = None,
    panorama: bool = False,
    calibration: str | os.PathLike | None = None,
    gamma: str = "srgb",
) -> ImageQuality:
    """Evaluate a chart in an image file.

    Parameters
    ----------
    path : path
    layout : Layout
    corners : array_like, shape (4, 2), optional
        Column and row of the chart's corners from the lower left counterclockwise; without them
        the chart is looked for by its coded targets and long bars.
    panorama : bool
        The image is a whole equirectangular panorama.
    calibration : path, optional
        File of a lens that bends lines, see :func:`mmqa_lab.io.read_camera`. Without it lines may
        be bent by some per cent.
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
    >>> from mmqa_lab.charts import imaging_chart, reflectance
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
    grey = read_image(path)
    rows, columns = grey.shape
    pixels = f"{columns} x {rows} pixels"
    refuse(panorama and columns != 2 * rows, "panorama", pixels, "2 : 1")
    camera = PanoramaCamera(columns) if panorama else None
    if calibration is not None:
        matrix, distortion, size = read_camera(calibration)
        other = panorama or size not in (None, (columns, rows))
        of = "a panorama" if panorama else pixels
        refuse(other, f"camera {calibration}", f"given for {of}", "of this image's lens")
        camera = LensCamera(matrix, distortion)
    chart_map = locate(grey, layout, corners=corners, camera=camera)
    origin, last = _window(chart_map, layout, grey.shape)
    part = grey[origin[1] : last[1], origin[0] : last[0]].astype(np.float32)
    values = decode(part / np.iinfo(grey.dtype).max, gamma)
    return replace(evaluate_image(values, layout, chart_map.within(*origin)), origin=origin)


@dataclass(frozen=True, eq=False)
class ImageQuality(Shown):
    """The quality figures of one image of a chart.

    Parameters
    ----------
    chart_map : ChartMap
    tones : Tones
    sizes : DataFrame
        Of :func:`mmqa_lab.chart_image.pixel_sizes`.
    pairs : DataFrame
        Of :func:`mmqa_lab.chart_image.read_pairs`.
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
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> quality = evaluate_image(image, layout, chart_map)
    >>> quality.resolution("h").width_mm, quality.to_frame()["pixel_v_mm"].round(2).item()
    (10.0, 4.0)
    """

    chart_map: ChartMap
    tones: Tones
    sizes: pd.DataFrame
    pairs: pd.DataFrame
    image: np.ndarray
    layout: Layout
    origin: tuple = (0, 0)

    @property
    def residual_px(self) -> float:
        """Root mean square distance of the bars' ends from their places, pixels."""
        return float(np.sqrt((self.sizes["offset_px"] ** 2).mean()))

    def pixel_size(self, direction: str) -> tuple[float, float]:
        """Return the pixel size in direction h or v and its standard deviation, mm.

        Bars of one direction share their bias, so that the mean of two is no better than one. A bar
        whose end is hidden counts with its length in the map, which the whole print gives.
        """
        bars = self.sizes[self.sizes["direction"] == direction]
        seen = self.sizes["pixel_mm"].notna()
        if bars.empty or not seen.any():
            return np.nan, np.nan
        mean = bars["length_mm"].sum() / bars["length_px"].sum()
        hidden = bars["pixel_mm"].isna().any()
        sigma = np.hypot(self.sizes["length_sigma_px"].max(), UNSEEN_PX * hidden)
        return float(mean), float(mean * sigma / bars["length_px"].mean())

    def resolution(self, direction: str) -> Resolution:
        """Return the finest resolved line pairs in direction h or v."""
        return resolution(self.pairs, direction)

    def to_frame(self) -> pd.DataFrame:
        """Return one row with every figure in the field's units; NaN where not measurable."""
        row = {"located_by": self.chart_map.source, "residual_px": self.residual_px}
        for direction in "hv":
            size, sigma = self.pixel_size(direction)
            found = self.resolution(direction)
            row[f"pixel_{direction}_mm"], row[f"pixel_{direction}_sigma_mm"] = size, sigma
            row[f"w_{direction}_mm"] = found.width_mm
            row[f"w_{direction}_next_mm"] = found.next_mm
        row["noise_share"] = self.tones.noise
        row["clipped_share"] = self.tones.clipped_share
        return pd.DataFrame([row | {"remarks": "; ".join(self.remarks)}])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Reasons to doubt pixel sizes and widths."""
        return doubts(self)

    def plot(self, *, ax: Axes) -> Axes:
        """Draw the photograph with its line pairs outlined: resolved or refused."""
        ax.imshow(self.image, cmap="gray", interpolation="nearest")
        for row in self.pairs.itertuples():
            outline = self.layout[row.name].corners()[[0, 1, 2, 3, 0]]
            ax.plot(*self.chart_map.pixels(outline).T, **OUTLINES[row.resolved], marker="", lw=1)
        for resolved, label in ((True, "resolved"), (False, "refused")):
            ax.plot([], [], **OUTLINES[resolved], marker="", lw=1, label=label)
        ax.set_axis_off()
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2)
        return ax

    def plot_contrast(self, *, ax: Axes) -> Axes:
        """Draw the contrast of line pairs over their width in pixels; resolved ones are filled."""
        for direction, marker, label in (("h", "o", "standing bars"), ("v", "s", "lying bars")):
            part = self.pairs[self.pairs["direction"] == direction]
            faces = part["resolved"].map({True: "C0", False: "none"})
            shape = {"marker": marker, "s": 18, "facecolors": faces, "edgecolors": "C0"}
            ax.scatter(part["width_px"], part["contrast"], label=label, **shape)
        least = {"color": "C1", "ls": "--", "lw": 0.8, "label": "what each gap must reach"}
        ax.axhline(SMALLEST_GAP, **least)
        ax.axvspan(0.3, SMALLEST_PAIR_PX, color="C1", alpha=0.12, lw=0)
        ax.set(xscale="log", xlabel="width of a line pair (pixels)", ylabel="contrast")
        ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        ax.minorticks_off()
        ax.legend()
        return ax


def _window(chart_map, layout, shape):
    """First and last column and row of a chart's surroundings in an image."""
    outline, size = chart_map.outline(layout.corners()), np.array(shape[::-1])
    inside = (outline >= -0.5).all() and (outline <= size - 0.5).all()
    corners = f"corners at {chart_map.pixels(layout.corners()).round().tolist()}"
    within = f"within {size[0]} x {size[1]} pixels"
    refuse(not inside, "place of the chart", corners, within)
    margin = np.maximum(0.05 * np.ptp(outline, axis=0), 16).astype(int)
    first = np.maximum(np.floor(outline.min(axis=0)).astype(int) - margin, 0)
    last = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + margin + 1, size)
    return tuple(first.tolist()), tuple(last.tolist())
