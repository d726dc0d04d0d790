"""Pixel size at the object from the lengths of the long bars."""

import numpy as np
import pandas as pd

from mmqa_lab.charts import Bar
from mmqa_lab.mtf.spread import spread_edge

SLENDERNESS = 5.0
"""A bar is long when it is so many times longer than wide."""

REACH_PX = 7.0
"""Pixels beyond a bar's end that take part."""

INWARD_PX = 30.0
"""Pixels of the bar before its end that take part: they tell levels, spread and place across."""

BESIDE_PX = 2.0
"""Pixels beside a bar that take part."""

NEIGHBOUR_PX = 2.0
"""Kept clear of the next element and of the chart's edge."""

OFFSET_PX = 4.0
"""Largest distance of a bar's end from where the map puts it."""

SPREADS_PX = (0.25, 3.0)
"""Limits of the point spread's standard deviation along and across the bar."""

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

    Both ends of a bar are found to a part of a pixel by fitting what pixels see of it: they share
    levels and point spread, which the long sides tell. Every pixel row or column along the bar is
    a repeat of its own.

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

    Notes
    -----
    Noise limits what any method can find: an end w pixels wide, with a step of c times the noise
    behind a spread of s pixels, is known to about (2 sqrt(pi) s / (w - 1.1 s))^(1/2) / c pixels. At
    13 mm and 10 % noise the length of a black bar is uncertain by 0.15 px, that of the grey one,
    with half the contrast, by 0.3 px. The paper measures between two corners of a bar, by hand.

    References
    ----------
    Pfeifer et al. 2021, sections 3.2 and 4.2. doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap, tones
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> sizes = pixel_sizes(tones(image, layout, there), layout, there)
    >>> sizes[["length_mm", "length_px", "pixel_mm"]].round(2).iloc[0].tolist()
    [800.0, 200.0, 4.0]
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

    Examples
    --------
    >>> rows = [("h", 100.0, 25.0, 4.0, 0.01), ("h", 100.0, 25.0, 4.0, 0.01)]
    >>> names = ["direction", "length_mm", "length_px", "pixel_mm", "pixel_sigma_mm"]
    >>> size, sigma = pixel_size(pd.DataFrame(rows, columns=names), "h")
    >>> size, round(sigma, 4)
    (4.0, 0.0071)
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
    offsets, sigma_px, repeats = found
    row["offset_px"] = float(np.sqrt(np.mean(offsets**2)))
    ends[:, axis] += offsets / [end.scale for end in around]
    pixels = chart_map.pixels(ends)
    length_px = float(np.linalg.norm(pixels[1] - pixels[0]))
    row["n"] = len(repeats)
    row["repeats_std_px"] = float(repeats.std(ddof=1)) if len(repeats) > 1 else np.nan
    row["length_px"], row["length_sigma_px"] = length_px, float(sigma_px)
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
        length, self.width = (
            np.array([bar.width, bar.height])[[axis, 1 - axis]] * scales[[axis, 1 - axis]]
        )
        inward = min(INWARD_PX, length / 2)
        places, values = _pixels_around(tones, chart_map, middle, inward + self.width)
        along, across = places[:, axis] * scales[axis], places[:, 1 - axis] * scales[1 - axis]
        outward = along if side else -along
        used = (outward <= REACH_PX) & (outward >= -inward)
        used &= np.abs(across) <= self.width / 2 + BESIDE_PX
        inside = (outward <= 0) & (np.abs(across) <= self.width / 2)
        used &= inside | _clear(places + middle, layout, bar, NEIGHBOUR_PX / scales)
        self.along, self.across, self.values = along[used], across[used], values[used]

    def shape(self, offset, aside, spreads):
        """What the pixels see of the bar: 1 inside, 0 outside."""
        low, high = (
            spread_edge(self.across - aside + place, spreads[1], self.angles[1])
            for place in (self.width / 2, -self.width / 2)
        )
        sign = -1 if self.side else 1
        return (low - high) * spread_edge(sign * (self.along - offset), spreads[0], self.angles[0])


def _clear(places, layout, bar, margin):
    """Whether places, mm, keep a margin from the chart's edge and from all elements but the bar.

    What lies on the bar, or under it, does not count.
    """
    clear = ((places >= margin) & (places <= [layout.width, layout.height] - margin)).all(axis=1)
    box = np.array([bar.x, bar.y, bar.x + bar.width, bar.y + bar.height])
    for other in layout.elements:
        low = np.array([other.x, other.y])
        high = low + [other.width, other.height]
        if (low < box[2:]).all() and (high > box[:2]).all():
            continue
        clear &= ~((places > low - margin) & (places < high + margin)).all(axis=1)
    return clear


def _fit_ends(ends):
    """Offsets of both ends, the length's sigma and the repeats, all in pixels.

    Both ends share levels and point spread; offsets along and across are their own.
    """
    from scipy.optimize import least_squares

    values = np.concatenate([end.values for end in ends])

    def levels(parameters):
        """Ground and contrast that fit best at these parameters, and residuals."""
        spreads = np.exp(parameters[4:])
        shapes = [
            end.shape(offset, aside, spreads)
            for end, offset, aside in zip(ends, parameters[:2], parameters[2:4], strict=True)
        ]
        design = np.column_stack([np.ones_like(values), np.concatenate(shapes)])
        fit = np.linalg.lstsq(design, values, rcond=None)[0]
        return fit, values - design @ fit

    limits = np.log(SPREADS_PX)
    bounds = tuple(
        [sign * OFFSET_PX] * 4 + [limit] * 2 for sign, limit in zip((-1, 1), limits, strict=True)
    )
    start = [0.0] * 4 + [np.log(0.6)] * 2
    found = least_squares(lambda p: levels(p)[1], start, bounds=bounds, diff_step=1e-4)
    fit, residuals = levels(found.x)
    if abs(fit[1]) < SMALLEST_STEP or np.abs(found.x[:4]).max() > 0.99 * OFFSET_PX:
        return None
    variance = residuals @ residuals / max(len(values) - len(start) - 2, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * variance
    sigma = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
    split = [len(ends[0].values)]
    lanes = [
        _lanes(end, rest, -jacobian[:, k], found.x[k])
        for k, (end, rest, jacobian) in enumerate(
            zip(ends, np.split(residuals, split), np.split(found.jac, split), strict=True)
        )
    ]
    common = sorted(lanes[0].keys() & lanes[1].keys())
    repeats = np.array([lanes[1][one] - lanes[0][one] for one in common])
    return found.x[:2], sigma, repeats


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
