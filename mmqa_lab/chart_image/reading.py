"""Readings of the image of a chart: black and white, line pairs, pixel size.

The image is read in units of print: 0 where the black of the chart is, 1 where its white is. Pixels
are taken as they are, at the places on the chart where the map puts them; nothing is resampled.

A pattern of line pairs counts as resolved when *every* gap between its bars stands out, in most of
the strips across it, and when the bars have the number, the frequency and the place that are
printed. Contrast alone is no evidence: aliases, bars doubled by motion and those reversed by
defocus have plenty of it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pandas as pd

from mmqa_lab._checks import check_image, refuse
from mmqa_lab._results import Shown, sentences
from mmqa_lab.chart_image.placing import ChartMap
from mmqa_lab.charts import Bar, Layout, LinePairs, Text, reflectance

__all__ = [
    "HIDDEN", "MOVED", "SMALLEST_GAP", "SMALLEST_PAIR_PX", "PairReading", "Resolution", "Tones",
    "expected_contrast", "find_tones", "hidden_texts", "pixel_sizes", "read_pairs",
    "read_pattern", "resolution",
]  # fmt: skip

SMALLEST_CONTRAST = 3.0
"""Multiples of the noise by which white must differ from black."""

SMALLEST_GAP = 0.10
"""Share of the chart's contrast by which each gap must stand out from both its bars."""

SMALLEST_PAIR_PX = 2.3
"""Narrower pairs are refused: below 2 pixels they alias; up to 2.3 the beat between pairs and
pixels is shorter than eight pairs, so that some of them vanish at every phase."""

HIDDEN, SURE_CONTRAST = "hidden", 0.3
"""Reason of patterns that something hides: also where a finer one is resolved so clearly."""

RIM_PX, RIM_MM, RIM_TONE, RIM_SHARE = 1.5, 12.0, 0.2, 0.04
"""White around a pattern is looked at: so deep in white, so far around. The pattern is hidden where
that share of it is so far from white."""

FEWEST_PIXELS, SMALLEST_SPREAD, LEGIBLE, LOST = 6, 0.02, 0.3, 0.12
"""Parts of a text, half as wide as its capitals are high, that count: pixels, and variance of the
print. Contrast of a text that is seen; a part with that share of it is hidden."""

MESH_PX, TURN_STEPS = 4, 64
"""Pixels between those whose places are calculated; steps of a pair in which waves are sought."""

MOVED = "bars not where they are printed"

END_REACH_PX, END_STEP_PX = 6.0, 0.1
"""Pixels to either side of a bar's end that are read, in these steps: the inner half for the end,
the outer one for black and white."""


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

    def near(self, chart_map, outline):
        """Return the places on the chart, mm, and values of the known pixels around an outline."""
        corners, size = chart_map.pixels(outline), np.array(self.values.shape[::-1])
        first = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, size)
        last = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, size)
        columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        values = self.values[rows.ravel(), columns.ravel()]
        known = np.isfinite(values)
        return chart_map.chart(pixels[known]), values[known]


def find_tones(image, layout, chart_map):
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
    odd = np.where(inside & (to_white >= RIM_PX), np.abs(values - 1), np.nan)
    clipped = float(((plain >= 1) | (plain <= 0)).mean())
    return Tones(values, noise, clipped, odd, np.where(inside, spilt, np.nan))


@dataclass(frozen=True)
class PairReading:
    """The reading of one pattern of line pairs.

    Parameters
    ----------
    name, direction, width_mm
        Of the pattern; ``"h"`` is read in horizontal direction.
    width_px : float
        Width of a pair in the image, at the pattern's narrowest place.
    contrast : float
        Mean difference of the middles of white and black bars as share of that of plain areas;
        negative when reversed. The contrast transfer function at this width.
    modulation : float
        Amplitude of the printed wave in the image as share of that on paper; negative when
        reversed. An estimate of the MTF at one cycle per w.
    worst_gap : float
        Smallest difference between a gap and the brighter of its bars, median over the strips.
    phase_deg : float
        Of the bars seen against those printed.
    bars : float
        Bars counted by their frequency.
    strip_share : float
        Share of the strips in which all gaps stand out: how many of as many readers agree.
    resolved : bool
    reason : str
        Why not; empty when resolved.
    mean : float
        Of black and white bars: a half, however blurred, if the grey values are linear in light.
    """

    name: str
    direction: str
    width_mm: float
    width_px: float
    contrast: float = np.nan
    modulation: float = np.nan
    worst_gap: float = np.nan
    phase_deg: float = np.nan
    bars: float = np.nan
    strip_share: float = 0.0
    resolved: bool = False
    reason: str = ""
    mean: float = np.nan


@dataclass(frozen=True)
class Resolution(Shown):
    """The width of the finest line pairs that are resolved, with all coarser ones.

    In Pfeifer et al. 2021, section 3.2, people decide instead: w is the smallest width whose bars
    can definitely be told apart.

    Parameters
    ----------
    width_mm : float
        w; NaN when not even the coarsest pattern is resolved.
    next_mm : float
        The next finer pattern, which is not: the limit lies in (next, w]. NaN at the end of the
        ladder.

    Examples
    --------
    >>> import pandas as pd
    >>> rows = [("h", 20, True, 0.9, 8.0), ("h", 10, True, 0.5, 4.0), ("h", 5, False, 0.0, 2.0)]
    >>> names = ["direction", "width_mm", "resolved", "contrast", "width_px"]
    >>> found = resolution(pd.DataFrame(rows, columns=names), "h")
    >>> found.width_mm, found.next_mm
    (10.0, 5.0)
    """

    width_mm: float
    next_mm: float


def read_pairs(tones: Tones, layout: Layout, chart_map: ChartMap) -> pd.DataFrame:
    """Read every pattern of line pairs on a chart.

    Parameters
    ----------
    tones : Tones
        From :func:`find_tones`.
    layout : Layout
    chart_map : ChartMap
        Right to about a fifth of a pixel.

    Returns
    -------
    DataFrame
        A row per pattern with the fields of :class:`PairReading`, by direction from coarse to fine.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> pairs = read_pairs(find_tones(image, layout, chart_map), layout, chart_map)
    >>> resolution(pairs, "v").width_mm  # 2.5 pixels; 8 mm are 2
    10.0
    """
    patterns = layout.of_kind(LinePairs)
    readings = [read_pattern(tones, pairs, chart_map) for pairs in patterns]
    table = pd.DataFrame(readings, columns=list(PairReading.__dataclass_fields__))
    table = table.sort_values(["direction", "width_mm"], ascending=[True, False], ignore_index=True)
    crossed = [pairs.name for pairs in patterns if _crossed(tones, pairs, chart_map)]
    seen = table["resolved"] | (table["width_px"] < SMALLEST_PAIR_PX)
    table.loc[table["name"].isin(crossed) & ~seen, "reason"] = HIDDEN
    for _, ladder in table.groupby("direction"):
        # lobes of defocus and motion stay below that: what is coarser would be seen too
        sure = ladder["resolved"] & (ladder["contrast"] >= SURE_CONTRAST)
        behind = ~ladder["resolved"] & (ladder.index < sure[sure].index.max())
        table.loc[behind[behind].index, "reason"] = HIDDEN
    return table


def read_pattern(tones, pairs, chart_map):
    """Read one pattern of line pairs.

    Parameters
    ----------
    tones : Tones
    pairs : LinePairs
    chart_map : ChartMap

    Returns
    -------
    PairReading

    Notes
    -----
    A shift of up to an eighth of a pair or 0.6 pixels counts as error of the map.

    References
    ----------
    Pfeifer et al. 2021, section 3.2 (definitely told apart). doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> tones = find_tones(image, layout, chart_map)
    >>> reading = read_pattern(tones, layout["pairs_v_30"], chart_map)
    >>> round(reading.bars), reading.resolved
    (8, True)
    """
    across, along, values, width_px, length_px = _pixels(tones, pairs, chart_map)
    known = pairs.name, pairs.direction, pairs.pair, width_px
    if len(values) < 4 * pairs.repeats:
        return PairReading(*known, reason="too few pixels")
    modulation, phase, bars = _wave(across, values, pairs, width_px)
    shift = np.clip(phase / 360, -1 / 8, 1 / 8) * pairs.pair
    limit = 0.6 / width_px * pairs.pair
    shifted = across - np.clip(shift, -limit, limit)
    # up to eight strips along the bars, so high that noise alone fails few of the gaps: three
    # sigmas of a bar's mean then reach a tenth of the contrast
    height = max(2.0, (60 * tones.noise) ** 2 / (width_px / 2))
    strips = int(np.clip(length_px / height, 1, 8))
    gaps, limits, contrast, tone = _gaps(shifted, along, values, pairs, strips, tones.noise)
    share = float((gaps >= limits).all(axis=1).mean())
    worst = float(np.median(gaps.min(axis=1)))
    reasons = sentences(
        (width_px < 2, "below the Nyquist width"),
        (width_px < SMALLEST_PAIR_PX, "beats with the pixels"),
        (abs(bars - pairs.repeats) > 0.6, "wrong number of bars"),
        (abs(phase) > 50, MOVED),  # a reversal is 180 degrees
        (share < 0.75, "gaps do not stand out"),  # of the strips
    )
    reason = reasons[0] if reasons else ""
    mean = float(np.nanmean(tone)) if np.isfinite(tone).any() else np.nan
    seen = contrast, modulation, worst, phase, bars, share
    return PairReading(*known, *seen, resolved=not reason, reason=reason, mean=mean)


def resolution(readings: pd.DataFrame, direction: str) -> Resolution:
    """Return the resolved width in one direction from a table of readings.

    Parameters
    ----------
    readings : DataFrame
        From :func:`read_pairs`.
    direction : {"h", "v"}

    Returns
    -------
    Resolution

    Examples
    --------
    >>> import pandas as pd
    >>> rows = [("v", 20, True, 0.9, 8.0), ("v", 10, False, 0.1, 4.0), ("v", 5, True, 0.2, 2.0)]
    >>> names = ["direction", "width_mm", "resolved", "contrast", "width_px"]
    >>> resolution(pd.DataFrame(rows, columns=names), "v").width_mm  # 5 mm does not count
    20.0
    """
    ladder = readings[readings["direction"] == direction].sort_values("width_mm", ascending=False)
    if "reason" in ladder:
        ladder = ladder[ladder["resolved"].astype(bool) | (ladder["reason"] != HIDDEN)]
    widths, resolved = ladder["width_mm"].to_numpy(), ladder["resolved"].to_numpy(dtype=bool)
    good = int(np.argmin(resolved)) if not resolved.all() else len(widths)
    return Resolution(
        width_mm=float(widths[good - 1]) if good else np.nan,
        next_mm=float(widths[good]) if good < len(widths) else np.nan,
    )


def expected_contrast(width_px, sigma_px, blur_px=0.0):
    """Return the contrast that :func:`read_pattern` finds without noise, closed form.

    A square wave behind a Gaussian, a square pixel and a motion blur, averaged over the phases of
    the pixels and over the middles of the bars; its first four harmonics.

    Parameters
    ----------
    width_px : float or array_like
        Width of a pair, pixels.
    sigma_px : float
        Standard deviation of the point spread, pixels, without the pixel itself.
    blur_px : float
        Length of the motion blur, pixels.

    Returns
    -------
    float or array

    Examples
    --------
    >>> round(float(expected_contrast(100.0, 0.5)), 2), round(float(expected_contrast(2.5, 0.5)), 2)
    (1.0, 0.37)
    """
    total = 0.0
    for order in (1, 3, 5, 7):
        rate = order / np.asarray(width_px, dtype=float)
        transfer = np.exp(-2 * (np.pi * rate * sigma_px) ** 2) * np.sinc(rate)
        # mean of the harmonic over a bar's middle, weighted by the same raised cosine
        ends = np.sin(np.pi / 2 * np.array([order, order + 2, order - 2]))
        parts = ends / (np.pi * np.array([order, order + 2, order - 2]))
        middle = 2 * parts[0] + parts[1] + parts[2]
        sign = 1 if order % 4 == 1 else -1
        total = total + sign * 4 / (np.pi * order) * middle * transfer * np.sinc(rate * blur_px)
    return total


def pixel_sizes(tones, layout, chart_map):
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
    >>> from mmqa_lab.chart_image import ChartMap
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> chart_map = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> sizes = pixel_sizes(find_tones(image, layout, chart_map), layout, chart_map)
    >>> sizes[["length_mm", "length_px", "pixel_mm"]].round(2).iloc[0].tolist()
    [800.0, 200.0, 4.0]
    """
    bars = [bar for bar in layout.of_kind(Bar) if not 0.2 < bar.width / bar.height < 5]
    table = pd.DataFrame([_measured(tones, bar, chart_map) for bar in bars])
    # ends of all bars tell how far the map is off
    table["length_sigma_px"] = np.sqrt(2 * (table["offset_px"] ** 2).mean())
    table["pixel_mm"] = (table["length_mm"] / table["length_px"]).where(table["n"] > 0)
    table["pixel_sigma_mm"] = table["pixel_mm"] * table["length_sigma_px"] / table["length_px"]
    return table


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
    seen = cv2.GaussianBlur(printed, (0, 0), 0.65 * sizes.max() / cell)
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


def _pixels(tones, pairs, chart_map):
    """Place across and along the bars in mm and value of the pixels inside a pattern."""
    outline = pairs.corners()
    places, values = tones.near(chart_map, outline)
    places, axis = places - outline[0], "hv".index(pairs.direction)
    scales = 1 / chart_map.pixel_sizes_mm(np.vstack([outline, outline.mean(axis=0)]))
    across, along = places[:, axis], places[:, 1 - axis]
    end = 1.5 / scales[:, 1 - axis].min()  # blurred
    # the last white bar has no edge of its own
    inside = (across >= 0) & (across <= pairs.extent - pairs.pair / 2)
    inside &= (along >= end) & (along <= pairs.length - end)
    length_px = (pairs.length - 2 * end) * scales[:, 1 - axis].min()
    width_px = float(pairs.pair * scales[:, axis].min())
    return across[inside], along[inside], values[inside], width_px, length_px


def hidden_texts(tones, layout, chart_map):
    """Names of the texts of which a part does not look like the print, though the others do."""
    names = []
    for text in (one for one in layout.of_kind(Text) if one.name.startswith("text_")):
        places, seen = tones.near(chart_map, text.corners())
        _, printed = replace(tones, values=tones.printed).near(chart_map, text.corners())
        part = np.maximum((places[:, 0] - text.x) / (text.cap / 2), 0).astype(int)
        n = np.maximum(np.bincount(part), 1)
        level, light, square, both = (
            np.bincount(part, values) / n for values in (printed, seen, printed**2, printed * seen)
        )
        spread = square - level**2
        clear = (n >= FEWEST_PIXELS) & (spread > SMALLEST_SPREAD)
        gain = ((both - level * light) / np.maximum(spread, 1e-9))[clear]
        typical = np.median(gain) if len(gain) else 0
        if typical > LEGIBLE and gain.min() < LOST * typical:
            names.append(text.name)
    return names


def _crossed(tones, pairs, chart_map):
    """Whether the white around a pattern is not white everywhere: something hides part of it."""
    if tones.odd is None:
        return False
    low, high = pairs.corners()[[0, 2]]
    outline = Bar("rim", *(low - RIM_MM), *(high - low + 2 * RIM_MM)).corners()
    places, odd = replace(tones, values=tones.odd).near(chart_map, outline)
    rim = ((places < low) | (places > high)).any(axis=1)
    return rim.sum() > 10 and (odd[rim] > RIM_TONE).mean() > RIM_SHARE


def _wave(across, values, pairs, width_px):
    """Modulation and phase of the printed wave, and the bars of the strongest one."""
    turns = across / pairs.pair - 0.25
    level, slope = np.ones_like(turns), turns - turns.mean()
    design = np.column_stack([level, slope, np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    fit = np.linalg.lstsq(design, values, rcond=None)[0]
    in_phase, quadrature = -fit[2], -fit[3]
    phase = float(np.degrees(np.arctan2(quadrature, in_phase)))
    rest = values - design[:, :2] @ fit[:2]
    place = np.round(TURN_STEPS * turns).astype(int)
    sums = np.bincount(place - place.min(), rest)
    places = (np.arange(len(sums)) + place.min()) / TURN_STEPS
    # up to the Nyquist frequency, where all waves look alike
    highest = min(2.5, 0.499 * width_px)
    rates = np.arange(0.3, max(highest, 0.4), 0.01)
    power = np.abs(np.exp(-2j * np.pi * rates[:, None] * places) @ sums)
    # printed bars from 0 to 1 have a first harmonic of 2/pi
    return float(in_phase * np.pi / 2), phase, float(rates[power.argmax()] * pairs.repeats)


def _gaps(across, along, values, pairs, strips, noise):
    """How far each gap stands out in each strip and how far it must, mean contrast, mean tones.

    A tone is that of a gap with half of both its bars.
    """
    strip = np.floor((along - along.min()) / (np.ptp(along) + 1e-9) * strips).astype(int)
    half = across / (pairs.pair / 2) - 0.5
    centre = np.round(half).astype(int)
    weight = 1 + np.cos(2 * np.pi * (half - centre))
    bars = 2 * pairs.repeats - 1
    used = (centre >= 0) & (centre < bars)
    slot = (strip * bars + centre)[used]
    parts = [part[used] for part in (weight, weight**2, weight * values)]
    sums = [np.bincount(slot, part, strips * bars) for part in parts]
    total, square, mean = np.reshape(sums, (3, strips, bars))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, variance = mean / total, noise**2 * square / total**2
    black, white = mean[:, ::2], mean[:, 1::2]
    gaps = white - np.maximum(black[:, :-1], black[:, 1:])
    around = np.maximum(variance[:, 0:-1:2], variance[:, 2::2])
    limits = np.maximum(SMALLEST_GAP, 3 * np.sqrt(variance[:, 1::2] + around))
    known = np.isfinite(black).any() and np.isfinite(white).any()
    light, dark = (np.nanmean(white), np.nanmean(black)) if known else (np.nan, np.nan)
    gaps, limits = np.nan_to_num(gaps, nan=-np.inf), np.nan_to_num(limits, nan=np.inf)
    tone = (2 * white + black[:, :-1] + black[:, 1:]) / 4
    return gaps, limits, float(light - dark), tone


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
    good = (outside - inside > 0.2) & (outside > 0.6) & (np.abs(place) < 2)
    return np.where(good, place, np.nan)
