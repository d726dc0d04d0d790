"""The pixel size: how long the long bars of a chart are in an image."""

import cv2
import numpy as np
import pandas as pd

from mmqa_lab.chart_image.maps import ChartMap
from mmqa_lab.chart_image.tones import WIDE_PX, Tones
from mmqa_lab.charts import Bar, Layout

__all__ = ["pixel_sizes"]

BAR_COLUMNS = (
    *("name", "direction", "length_mm", "n", "length_px"),
    *("repeats_std_px", "offset_px"),
)

SHARP_SHARE = 1 / 3
"""Error of a length in the map, over that of its two ends as seen, where the image is sharp."""

END_REACH_PX, END_STEP_PX, END_OFF_PX = 6.0, 0.1, 2.0
"""Pixels to either side of a bar's end that are read, in these steps: the inner half for the end,
the outer one for black and white. How far from its place an end may be."""


def pixel_sizes(
    tones: Tones, layout: Layout, chart_map: ChartMap, *, hidden: bool = False
) -> pd.DataFrame:
    """Measure the pixel size along every long bar that is seen.

    The length of a bar is that between its ends in the map. Every pixel row or column along the
    bar looks for both ends itself, half-way between bar and white: these repeats say whether the
    ends are seen, and how far they lie from the map.

    Parameters
    ----------
    tones : Tones
    layout : Layout
        Bars five times longer than wide count.
    chart_map : ChartMap
        Aligned: right to a fifth of a pixel.
    hidden : bool
        Something stands before the chart, so that its map is no better than the ends of bars.

    Returns
    -------
    DataFrame
        A row per bar: ``name``, ``direction`` (h: along x, v: along y), ``length_mm`` as printed,
        ``length_px`` between the ends and its standard deviation ``length_sigma_px``,
        ``repeats_std_px`` (standard deviation of the ``n`` repeats; NaN for one),
        ``pixel_mm`` = length_mm / length_px with ``pixel_sigma_mm``, and ``offset_px``, how far
        along the bar its ends lie from the map (root mean square). Where an end is not seen, ``n``
        is 0 and the last three are NaN.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap, find_tones
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> sizes = pixel_sizes(find_tones(image, layout, chart_map), layout, chart_map)
    >>> sizes[["length_mm", "length_px", "pixel_mm"]].round(2).iloc[0].tolist()
    [800.0, 200.0, 4.0]
    """
    bars = [bar for bar in layout.of_kind(Bar) if not 0.2 < bar.width / bar.height < 5]
    rows = [_measured(tones, bar, chart_map) for bar in bars]
    table = pd.DataFrame(rows, columns=BAR_COLUMNS)
    # ends of all bars tell how far the map may be off, and it is better where they are sharp
    share = 1.0 if hidden or chart_map.blur_px > WIDE_PX else SHARP_SHARE
    table["length_sigma_px"] = share * np.sqrt(2 * (table["offset_px"] ** 2).mean())
    table["pixel_mm"] = (table["length_mm"] / table["length_px"]).where(table["n"] > 0)
    table["pixel_sigma_mm"] = table["pixel_mm"] * table["length_sigma_px"] / table["length_px"]
    return table


def _measured(tones, bar, chart_map):
    """Length of a bar in the image, and how its ends were seen: a row of the table."""
    axis = 0 if bar.width > bar.height else 1
    ends = bar.corners()[[0, 2]]
    size = ends[1] - ends[0]
    ends[:, 1 - axis] = ends[:, 1 - axis].mean()
    row = {"name": bar.name, "direction": "hv"[axis], "length_mm": float(size[axis]), "n": 0}
    row["length_px"] = float(np.linalg.norm(np.subtract(*chart_map.pixels(ends))))
    row |= {"repeats_std_px": np.nan, "offset_px": np.nan}
    across_px = size[1 - axis] / chart_map.pixel_sizes_mm(ends)[:, 1 - axis].max()
    count = max(int(across_px) - 1, 1)
    lanes = ((np.arange(count) + 0.5) / count - 0.5) * (1 - 1 / across_px) * size[1 - axis]
    low_end = _crossings(tones, chart_map, ends[0], axis, -1, lanes)
    high_end = _crossings(tones, chart_map, ends[1], axis, 1, lanes)
    if np.isfinite([low_end, high_end]).mean(axis=1).min() < 0.6:
        return row
    repeats = pd.Series(low_end + high_end).dropna()
    offset = float(np.sqrt((np.nanmean([low_end, high_end], axis=1) ** 2).mean()))
    return row | {"n": len(repeats), "repeats_std_px": repeats.std(), "offset_px": offset}


def _crossings(tones, chart_map, end, axis, sign, lanes):
    """How far outside of its place the pixels across a bar see the bar's end, pixels.

    NaN where no end is seen there.
    """
    pixel_mm = chart_map.pixel_sizes_mm(end[None])[0][axis]
    steps = np.arange(-END_REACH_PX, END_REACH_PX + END_STEP_PX / 2, END_STEP_PX)
    places = np.empty((len(lanes), len(steps), 2))
    places[..., axis] = end[axis] + sign * steps * pixel_mm
    places[..., 1 - axis] = (end[1 - axis] + lanes)[:, None]
    pixels = chart_map.pixels(places.reshape(-1, 2)).astype(np.float32).reshape(places.shape)
    beyond = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": np.nan}
    seen = cv2.remap(tones.values.astype(np.float32), pixels, None, cv2.INTER_LINEAR, **beyond)
    near = np.abs(steps) < END_REACH_PX / 2
    inside, outside = (np.median(seen[:, ~near & (sign * steps > 0)], axis=1) for sign in (-1, 1))
    dark = seen[:, near] < (inside + outside)[:, None] / 2
    place = dark.mean(axis=1) * END_REACH_PX - END_REACH_PX / 2
    # else it is the end of something else
    good = (outside - inside > 0.2) & (outside > 0.6) & (np.abs(place) < END_OFF_PX)
    return np.where(good, place, np.nan)
