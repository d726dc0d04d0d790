"""Pixel size at the object from the lengths of the long bars."""

import numpy as np
import pandas as pd

from mmqa_lab.chart_image.spread import spread_edge
from mmqa_lab.charts import Bar

SLENDERNESS = 5.0
"""A bar is long when it is so many times longer than wide."""

REACH_PX = 7.0
"""Pixels to either side of a bar's end that take part."""

BESIDE_PX = 2.0
"""Pixels beside a bar that take part."""

NEIGHBOUR_PX = 2.5
"""Kept clear of the next element."""

OFFSET_PX = 4.0
"""Largest distance of a bar's end from where the map puts it."""

SMALLEST_STEP = 0.1
"""Share of the chart's contrast that a bar must show."""

FEWEST_PIXELS = 12
"""Around each end."""

COLUMNS = (
    *("name", "direction", "length_mm", "length_px", "length_sigma_px", "repeats_std_px", "n"),
    *("pixel_mm", "pixel_sigma_mm", "expected_mm", "offset_px"),
)


def pixel_sizes(tones, layout, chart_map):
    """Measure the pixel size along every long bar.

    Both ends of a bar are found to a part of a pixel by fitting what pixels see of an edge. Every
    pixel row or column along the bar is a repeat of its own.

    Parameters
    ----------
    tones : Tones
    layout : Layout
        Bars five times longer than wide count.
    chart_map : ChartMap
        Right to a few pixels: it tells where to look, and what geometry expects.

    Returns
    -------
    DataFrame
        A row per bar: ``name``, ``direction`` (h: along x, v: along y), ``length_mm`` as printed,
        ``length_px`` between the ends and its standard deviation ``length_sigma_px``,
        ``repeats_std_px`` (standard deviation of the ``n`` repeats; NaN for one),
        ``pixel_mm`` = length_mm / length_px with ``pixel_sigma_mm``, ``expected_mm``, what
        ``chart_map`` says, and ``offset_px``, how far along the bar its ends lie from there (root
        mean square). NaN where an end is not seen.

    References
    ----------
    Pfeifer et al. 2021, section 4.2. doi:10.3390/rs13020237
    """
    rows = []
    for bar in layout.of_kind(Bar):
        sides = bar.width, bar.height
        if max(sides) >= SLENDERNESS * min(sides):
            rows.append(_measured(tones, layout, bar, chart_map))
    return pd.DataFrame(rows, columns=COLUMNS)


def pixel_size(sizes, direction):
    """Return the pixel size in one direction and its standard deviation, mm, over all bars.

    Parameters
    ----------
    sizes : DataFrame
        From :func:`pixel_sizes`.
    direction : {"h", "v"}

    Returns
    -------
    (float, float)
        NaN where no bar was measured.
    """
    bars = sizes[sizes["direction"] == direction].dropna(subset=["pixel_mm"])
    if bars.empty:
        return np.nan, np.nan
    mean = bars["length_mm"].sum() / bars["length_px"].sum()
    sigma = np.sqrt((bars["pixel_sigma_mm"] ** 2).sum()) / len(bars)
    return float(mean), float(sigma)


def _measured(tones, layout, bar, chart_map):
    """One row of the table."""
    axis = 0 if bar.width > bar.height else 1
    low, size = np.array([bar.x, bar.y]), np.array([bar.width, bar.height])
    ends = np.array([low, low + size], dtype=float)
    ends[:, 1 - axis] = low[1 - axis] + size[1 - axis] / 2
    expected = chart_map.pixels(ends)
    row = {
        "name": bar.name,
        "direction": "hv"[axis],
        "length_mm": float(size[axis]),
        "n": 0,
        "expected_mm": float(size[axis] / np.linalg.norm(expected[1] - expected[0])),
    }
    around = [_End(tones, layout, bar, chart_map, ends[side], axis, side) for side in (0, 1)]
    if any(len(end.values) < FEWEST_PIXELS for end in around):
        return row
    found = _fit_ends(around)
    if found is None:
        return row
    offsets, sigmas, repeats = found
    row["offset_px"] = float(np.sqrt(np.mean(offsets**2)))
    ends[:, axis] += offsets / [end.scale for end in around]
    pixels = chart_map.pixels(ends)
    length_px = float(np.linalg.norm(pixels[1] - pixels[0]))
    sigma_px = float(np.hypot(*sigmas))
    row["n"] = len(repeats)
    row["repeats_std_px"] = float(repeats.std(ddof=1)) if len(repeats) > 1 else np.nan
    row["length_px"], row["length_sigma_px"] = length_px, sigma_px
    row["pixel_mm"] = row["length_mm"] / length_px
    row["pixel_sigma_mm"] = row["pixel_mm"] * sigma_px / length_px
    return row


class _End:
    """The pixels around one end of a bar, in pixels along and across the bar from its middle."""

    def __init__(self, tones, layout, bar, chart_map, middle, axis, side):
        vectors = chart_map.scale(middle[None])[0]
        scales = np.linalg.norm(vectors, axis=1)
        self.scale, self.side = scales[axis], side
        self.angles = [np.arctan2(*np.sort(np.abs(vectors[k]))) for k in (axis, 1 - axis)]
        self.width = (bar.width, bar.height)[1 - axis] * scales[1 - axis]
        reach = np.array([REACH_PX, BESIDE_PX])[[axis, 1 - axis]] / scales
        clear = layout.clearance(bar, reach) * scales[:, None]
        clear = np.clip(clear - NEIGHBOUR_PX, 0, (reach * scales)[:, None])
        places, values = _pixels_around(tones, chart_map, middle, REACH_PX + self.width)
        along, across = places[:, axis] * scales[axis], places[:, 1 - axis] * scales[1 - axis]
        outward = along if side else -along
        used = (outward <= clear[axis, side]) & (outward >= -REACH_PX)
        beside = clear[1 - axis] + self.width / 2
        used &= (across >= -beside[0]) & (across <= beside[1])
        self.along, self.across, self.values = along[used], across[used], values[used]

    def shape(self, offset, sigma):
        """What the pixels see of the bar: 1 inside, 0 outside, and the slope by the offset."""
        across = [
            spread_edge(self.across + place, sigma, self.angles[1])
            for place in (self.width / 2, -self.width / 2)
        ]
        sign, step = (-1 if self.side else 1), 0.05
        low, here, high = (
            spread_edge(sign * (self.along - offset) + s, sigma, self.angles[0])
            for s in (-step, 0, step)
        )
        beside = across[0] - across[1]
        return beside * here, -sign * beside * (high - low) / (2 * step)


def _fit_ends(ends):
    """Offsets of both ends, their sigmas and the lengths of the repeats, all in pixels."""
    from scipy.optimize import least_squares

    values = np.concatenate([end.values for end in ends])

    def levels(parameters):
        """Ground and contrast that fit best at these offsets and this spread, and residuals."""
        shapes = [
            end.shape(offset, np.exp(parameters[2]))[0]
            for end, offset in zip(ends, parameters[:2], strict=True)
        ]
        design = np.column_stack([np.ones_like(values), np.concatenate(shapes)])
        fit = np.linalg.lstsq(design, values, rcond=None)[0]
        return fit, values - design @ fit

    bounds = ([-OFFSET_PX] * 2 + [np.log(0.25)], [OFFSET_PX] * 2 + [np.log(3.0)])
    start = [0.0, 0.0, np.log(0.6)]
    found = least_squares(lambda p: levels(p)[1], start, bounds=bounds, diff_step=1e-4).x
    fit, residuals = levels(found)
    if abs(fit[1]) < SMALLEST_STEP or np.abs(found[:2]).max() > 0.99 * OFFSET_PX:
        return None
    variance = residuals @ residuals / max(len(values) - 5, 1)
    sigmas, lanes = [], []
    first = 0
    for end, offset in zip(ends, found[:2], strict=True):
        rest = residuals[first : first + len(end.values)]
        first += len(end.values)
        slope = fit[1] * end.shape(offset, np.exp(found[2]))[1]
        sigmas.append(np.sqrt(variance / (slope @ slope)))
        lanes.append(_lanes(end, rest, slope, offset))
    common = sorted(lanes[0].keys() & lanes[1].keys())
    repeats = np.array([lanes[1][one] - lanes[0][one] for one in common])
    return found[:2], sigmas, repeats


def _lanes(end, residuals, slope, offset):
    """Offsets of an end as the single lanes of pixels inside the bar see it."""
    lane = np.round(end.across).astype(int)
    inside = np.unique(lane[np.abs(end.across) <= max(end.width / 2 - 0.5, 0.5)])
    return {
        int(one): float(offset + (residuals * slope)[lane == one].sum() / weight)
        for one in inside
        if (weight := (slope[lane == one] ** 2).sum()) > 0
    }


def _pixels_around(tones, chart_map, middle, radius):
    """Places on the chart from a point, mm, and values of the pixels around it."""
    centre = chart_map.pixels(middle[None])[0]
    shape = np.array(tones.values.shape[::-1])
    first = np.clip(np.floor(centre - radius).astype(int), 0, shape)
    last = np.clip(np.ceil(centre + radius).astype(int) + 1, 0, shape)
    columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    places = chart_map.chart(np.column_stack([columns.ravel(), rows.ravel()])) - middle
    values = tones.values[first[1] : last[1], first[0] : last[0]].ravel()
    known = np.isfinite(values)
    return places[known], values[known]
