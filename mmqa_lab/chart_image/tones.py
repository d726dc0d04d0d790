"""The image of a chart in units of print, 0 black and 1 white, and its pixel size along long bars.

Pixels are taken as they are, at the places on the chart where the map puts them; nothing is
resampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_image, refuse
from mmqa_lab.chart_image.maps import ChartMap
from mmqa_lab.charts import Bar, Layout, reflectance

__all__ = ["WIDE_PX", "Tones", "find_tones", "pixel_sizes"]


SMALLEST_CONTRAST = 3.0
"""Multiples of the noise by which white must differ from black."""

USUAL_PX, WIDE_PX = 0.65, 1.2
"""Point spread, pixel included, and the one from which on an image counts as blurred."""

MESH_PX, RIM_PX = 4, 1.5
"""Pixels between those whose places are calculated; how deep plain white lies in white."""

BAR_COLUMNS = (
    *("name", "direction", "length_mm", "n", "length_px"),
    *("repeats_std_px", "offset_px"),
)

SHARP_SHARE = 1 / 3
"""Error of a length in the map, over that of its two ends as seen, where the image is sharp."""

END_REACH_PX, END_STEP_PX, END_OFF_PX, END_WHITE = 6.0, 0.1, 2.0, 0.35
"""Pixels to either side of a bar's end that are read, in these steps: the inner half for the end,
the outer one for black and white. How far from its place an end may be, and how dark the white
beyond it, which close to the edge of a shadow is half as bright as around."""


@dataclass(frozen=True, eq=False)
class Tones:
    """The image of a chart in units of print.

    Parameters
    ----------
    values : array, shape (rows, columns)
        0 at black, 1 at white; NaN outside of the chart.
    noise : float
        Standard deviation of a pixel, in the same unit: the larger one of black and white.
    clipped_share : float
        Share of the plain pixels at zero or full scale.
    odd, printed : array, optional
        How far plain white is from white, NaN where none is printed; the print, usually blurred.
    """

    values: np.ndarray
    noise: float
    clipped_share: float = 0.0
    odd: np.ndarray | None = None
    printed: np.ndarray | None = None

    def near(self, chart_map: ChartMap, outline: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return the places on the chart, mm, and values of the known pixels around an outline."""
        corners, size = chart_map.pixels(outline), np.array(self.values.shape[::-1])
        first = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, size)
        last = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, size)
        columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        values = self.values[rows.ravel(), columns.ravel()]
        known = np.isfinite(values)
        return chart_map.chart(pixels[known]), values[known]


def find_tones(image: ArrayLike, layout: Layout, chart_map: ChartMap) -> Tones:
    """Bring an image into units of print by the plain areas of the chart.

    White is what the plain white around a place shows: light falls off across a chart, and shadows
    lie on it. Black is one level for the whole chart.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light, full scale 1.
    layout : Layout
    chart_map : ChartMap

    Returns
    -------
    Tones

    Raises
    ------
    ValueError
        If the image is no grey image, or black and white cannot be told apart at these places.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> found = find_tones(0.05 + 0.5 * image, layout, chart_map)
    >>> bool(np.allclose(found.values, image, atol=1e-6))
    True
    """
    image = check_image(image)
    inside, spilt, to_white, to_black = _printed(layout, chart_map, image.shape)
    white, black = _plainest(to_white), _plainest(to_black)
    field = _local(image, white, np.sqrt(inside.sum()))
    # black pixels see some white spilt into them
    ground = float(((image - spilt * field)[black] / (1 - spilt[black])).mean())
    contrast = np.maximum(field - ground, 1e-12)
    values = np.where(inside, (image - ground) / contrast, np.nan)
    noise = max(_spread((values - spilt)[mask]) for mask in (white, black))
    light = float(field[white].mean())
    step = light - ground
    # rounding alone makes a contrast of a plain image without noise
    clear = step > 1e-9 * abs(light) and SMALLEST_CONTRAST * noise < 1
    shown = f"white exceeds black by {step:.3g} at a noise of {noise * step:.3g}"
    must = f"{SMALLEST_CONTRAST:g} times the noise or more (is the chart there?)"
    refuse(not clear, "chart", shown, must)
    plain = image[white | black]
    deep = max(RIM_PX, chart_map.blur_px)  # nearer to the print blur tells, not white
    odd = np.where(inside & (to_white >= deep), np.abs(values - spilt), np.nan)
    clipped = float(((plain >= 1) | (plain <= 0)).mean())
    return Tones(values, noise, clipped, odd, np.where(inside, spilt, np.nan))


def _printed(layout, chart_map, shape):
    """Whether each pixel lies on the chart, the tone it would see, its depth in white and black.

    Depths are in pixels.
    """
    # places at every fourth pixel, one beyond the image too, and lines between them
    rows, columns = (np.arange(-MESH_PX, side + MESH_PX, MESH_PX) for side in shape)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1) + (MESH_PX - 1) / 2
    mesh = chart_map.chart(grid.reshape(-1, 2)).reshape(grid.shape)
    places = cv2.resize(mesh, None, fx=MESH_PX, fy=MESH_PX, interpolation=cv2.INTER_LINEAR)
    places = places[MESH_PX : MESH_PX + shape[0], MESH_PX : MESH_PX + shape[1]]
    sizes = chart_map.pixel_sizes_mm([[layout.width / 2, layout.height / 2]])
    cell = max(sizes.min() / 4, layout.width / 4000)
    printed = reflectance(layout, cell=cell)
    # a usual point spread, pixel included: white spills into black where bars are thin
    blur = chart_map.blur_px if chart_map.blur_px > WIDE_PX else USUAL_PX
    seen = cv2.GaussianBlur(printed, (0, 0), blur * sizes.max() / cell)
    depths = [_depth(np.abs(printed - tone) < 1e-3) * (cell / sizes.max()) for tone in (1.0, 0.0)]
    places = np.float32(places / cell - 0.5)
    constant = {"interpolation": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_CONSTANT}
    constant["borderValue"] = -1.0
    at_pixels = [cv2.remap(part, places, None, **constant) for part in (seen, *depths)]
    return (at_pixels[0] > -1e-3, *at_pixels)  # blurred black may fall below 0


def _depth(mask):
    """Distance of each cell from the nearest one outside of the mask or of the chart, cells."""
    framed = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return cv2.distanceTransform(framed, cv2.DIST_L2, 5)[1:-1, 1:-1]


def _plainest(depth):
    """The pixels that lie deepest in a tone, enough of them if possible."""
    for clearance in (3.0, 2.5, 2.0, 1.5, 1.2, 1.0, 0.7, 0.5, 0.3):
        plain = depth >= clearance
        if plain.sum() >= 30:
            break
    return plain


def _local(image, white, side):
    """The level of white at every pixel: weighted means of the white pixels around it.

    Near ones count, as far as there are some; the farther ones fill the gaps between them.
    """
    # light changes slowly: a hundred cells along the chart tell enough
    size = [max(int(100 * length / side), 2) for length in image.shape[::-1]]
    small = {"dsize": [min(pair) for pair in zip(size, image.shape[::-1], strict=True)]}
    small |= {"interpolation": cv2.INTER_AREA}
    share = cv2.resize(white.astype(float), **small)
    light = cv2.resize(np.where(white, image, 0.0), **small)
    field = np.full(share.shape, image[white].mean())
    for reach in (25.0, 8.0, 3.0):  # hundredths of the chart's side
        weight, total = (cv2.GaussianBlur(part, (0, 0), reach) for part in (share, light))
        few = 0.5 / (2 * np.pi * reach**2)  # half a cell outweighs what is farther away
        field = (total + few * field) / (weight + few)
    return cv2.resize(field, image.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _spread(residuals):
    """Standard deviation by the median absolute deviation."""
    return float(1.4826 * np.median(np.abs(residuals - np.median(residuals))))


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
    good = (outside - inside > 0.2) & (outside > END_WHITE) & (np.abs(place) < END_OFF_PX)
    return np.where(good, place, np.nan)
