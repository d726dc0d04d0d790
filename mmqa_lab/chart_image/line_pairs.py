"""Which line pairs are definitely resolved.

A pattern counts when *every* gap between its bars stands out, in most of the strips across it, and
when the bars have the number, the frequency and the place that are printed. Contrast alone is no
evidence: aliases, bars doubled by motion and those reversed by defocus have plenty of it.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab.charts import LinePairs

SMALLEST_GAP = 0.10
"""Share of the chart's contrast by which each gap must stand out from both its bars."""

GAP_SIGMAS = 3.0
"""Multiples of the noise by which it must, too."""

SMALLEST_PAIR_PX = 2.3
"""Narrower pairs are refused: below 2 pixels they alias; up to 2.3 the beat between pairs and
pixels is shorter than eight pairs, so that some of them vanish at every phase."""

LARGEST_PHASE_DEG = 50.0
"""Between the bars seen and printed; a reversal is 180 degrees."""

LARGEST_MISCOUNT = 0.6
"""Bars by which the number seen may differ from the number printed."""

STRIPS, STRIP_PX = 8, 2.0
"""Strips along the bars read on their own, and their smallest height."""

STRIP_SHARE = 0.75
"""Share of the strips in which all gaps must stand out."""

END_PX = 1.5
"""Left out at both ends of the bars."""

FREQUENCY_PIXELS = 4000
"""The frequency is found on as many pixels at most."""


@dataclass(frozen=True)
class PairReading:
    """What was seen of one pattern of line pairs.

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

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap, tones
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> reading = read_pattern(tones(image, layout, there), layout["pairs_h_40"], there)
    >>> reading.resolved, round(reading.width_px, 6), round(reading.contrast, 2)
    (True, 10.0, 1.0)
    """

    name: str
    direction: str
    width_mm: float
    width_px: float
    contrast: float
    modulation: float
    worst_gap: float
    phase_deg: float
    bars: float
    strip_share: float
    resolved: bool
    reason: str


@dataclass(frozen=True)
class Resolution:
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
    limit_mm : float
        Width at which the contrast falls to the threshold, interpolated between patterns; NaN
        where the ladder does not enclose it.
    n : int
        Patterns read.

    Examples
    --------
    >>> import pandas as pd
    >>> rows = [("h", 20, True, 0.9, 8.0), ("h", 10, True, 0.5, 4.0), ("h", 5, False, 0.0, 2.0)]
    >>> names = ["direction", "width_mm", "resolved", "contrast", "width_px"]
    >>> found = resolution(pd.DataFrame(rows, columns=names), "h")
    >>> found.width_mm, found.next_mm, found.n
    (10.0, 5.0, 3)
    """

    width_mm: float
    next_mm: float
    limit_mm: float
    n: int


def read_pairs(tones, layout, chart_map):
    """Read every pattern of line pairs on a chart.

    Parameters
    ----------
    tones : Tones
        From :func:`mmqa_lab.chart_image.tones`.
    layout : Layout
    chart_map : ChartMap
        Right to about a fifth of a pixel.

    Returns
    -------
    DataFrame
        A row per pattern with the fields of :class:`PairReading`, by direction from coarse to fine.

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap, tones
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> pairs = read_pairs(tones(image, layout, there), layout, there)
    >>> resolution(pairs, "v").width_mm  # 2.5 pixels; 8 mm are 2
    10.0
    """
    readings = [read_pattern(tones, pairs, chart_map) for pairs in layout.of_kind(LinePairs)]
    table = pd.DataFrame(readings, columns=list(PairReading.__dataclass_fields__))
    order = ["direction", "width_mm"]
    return table.sort_values(order, ascending=[True, False], ignore_index=True)


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
    Pixels are taken as they are, at the places on the chart where the map puts them; nothing is
    resampled. A shift of up to an eighth of a pair or 0.6 pixels counts as error of the map.

    References
    ----------
    Pfeifer et al. 2021, section 3.2 (definitely told apart). doi:10.3390/rs13020237

    Examples
    --------
    >>> from mmqa_lab.chart_image import ChartMap, tones
    >>> from mmqa_lab.charts import imaging_chart, reflectance
    >>> layout = imaging_chart()
    >>> image = reflectance(layout, cell=4)[::-1]  # pixels of 4 mm
    >>> there = ChartMap(np.array([[0.25, 0, -0.5], [0, -0.25, 249.5], [0, 0, 1]]))
    >>> reading = read_pattern(tones(image, layout, there), layout["pairs_v_30"], there)
    >>> round(reading.bars), reading.resolved
    (8, True)
    """
    across, along, values, width_px, length_px = _pixels(tones, pairs, chart_map)
    known = {
        "name": pairs.name,
        "direction": pairs.direction,
        "width_mm": pairs.pair,
        "width_px": width_px,
    }
    if len(values) < 4 * pairs.repeats:
        return _unread(known, "too few pixels")
    modulation, phase, bars = _wave(across, values, pairs, width_px)
    seen = {"modulation": modulation, "phase_deg": phase, "bars": bars}
    shift = np.clip(phase / 360, -1 / 8, 1 / 8) * pairs.pair
    limit = 0.6 / width_px * pairs.pair
    shifted = across - np.clip(shift, -limit, limit)
    strips = int(np.clip(length_px / STRIP_PX, 1, STRIPS))
    gaps, limits, contrast = _gaps(shifted, along, values, pairs, strips, tones.noise)
    passed = (gaps >= limits).all(axis=1)
    worst = gaps.min(axis=1)
    share = float(passed.mean())
    reason = _refusal(width_px, phase, bars, pairs.repeats, share)
    return PairReading(
        **known,
        **seen,
        contrast=contrast,
        worst_gap=float(np.median(worst)),
        strip_share=share,
        resolved=not reason,
        reason=reason,
    )


def resolution(readings, direction):
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
    widths, resolved = ladder["width_mm"].to_numpy(), ladder["resolved"].to_numpy(dtype=bool)
    good = int(np.argmin(resolved)) if not resolved.all() else len(widths)
    return Resolution(
        width_mm=float(widths[good - 1]) if good else np.nan,
        next_mm=float(widths[good]) if good < len(widths) else np.nan,
        limit_mm=_limit(widths, ladder["contrast"].to_numpy(), ladder["width_px"].to_numpy()),
        n=len(widths),
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


def _pixels(tones, pairs, chart_map):
    """Place across and along the bars in mm and value of the pixels inside a pattern."""
    low = np.array([pairs.x, pairs.y])
    high = low + [pairs.width, pairs.height]
    outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    corners = chart_map.pixels(outline)
    size = np.array(tones.values.shape[::-1])
    first = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, size)
    last = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, size)
    columns, rows = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    places = chart_map.chart(np.column_stack([columns.ravel(), rows.ravel()])) - low
    values = tones.values[first[1] : last[1], first[0] : last[0]].ravel()
    axis = 0 if pairs.direction == "h" else 1
    scales = 1 / chart_map.pixel_sizes_mm(np.vstack([outline, outline.mean(axis=0)]))
    across, along = places[:, axis], places[:, 1 - axis]
    end = END_PX / scales[:, 1 - axis].min()
    # the last white bar has no edge of its own
    inside = (across >= 0) & (across <= pairs.extent - pairs.pair / 2)
    inside &= (along >= end) & (along <= pairs.length - end) & np.isfinite(values)
    length_px = (pairs.length - 2 * end) * scales[:, 1 - axis].min()
    width_px = pairs.pair * scales[:, axis].min()
    return across[inside], along[inside], values[inside], float(width_px), length_px


def _wave(across, values, pairs, width_px):
    """Modulation and phase of the printed wave, and the bars of the strongest one."""
    turns = across / pairs.pair - 0.25
    level, slope = np.ones_like(turns), turns - turns.mean()
    design = np.column_stack([level, slope, np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    fit = np.linalg.lstsq(design, values, rcond=None)[0]
    in_phase, quadrature = -fit[2], -fit[3]
    phase = float(np.degrees(np.arctan2(quadrature, in_phase)))
    step = len(values) // FREQUENCY_PIXELS + 1
    rest = (values - design[:, :2] @ fit[:2])[::step]
    # up to the Nyquist frequency, where all waves look alike
    highest = min(2.5, 0.499 * width_px)
    rates = np.arange(0.3, max(highest, 0.4), 0.01)
    waves = np.exp(-2j * np.pi * rates[:, None] * turns[::step])
    power = np.abs(waves @ rest) ** 2
    # printed bars from 0 to 1 have a first harmonic of 2/pi
    return float(in_phase * np.pi / 2), phase, float(rates[power.argmax()] * pairs.repeats)


def _gaps(across, along, values, pairs, strips, noise):
    """How far each gap stands out in each strip, how far it must, and the mean contrast."""
    strip = np.floor((along - along.min()) / (np.ptp(along) + 1e-9) * strips).astype(int)
    half = across / (pairs.pair / 2) - 0.5
    centre = np.round(half).astype(int)
    weight = 1 + np.cos(2 * np.pi * (half - centre))
    bars = 2 * pairs.repeats - 1
    used = (centre >= 0) & (centre < bars)
    slot = (strip * bars + centre)[used]
    total, square, mean = (
        np.bincount(slot, weights=part[used], minlength=strips * bars).reshape(strips, bars)
        for part in (weight, weight**2, weight * values)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, variance = mean / total, noise**2 * square / total**2
    black, white = mean[:, ::2], mean[:, 1::2]
    gaps = white - np.maximum(black[:, :-1], black[:, 1:])
    around = np.maximum(variance[:, 0:-1:2], variance[:, 2::2])
    limits = np.maximum(SMALLEST_GAP, GAP_SIGMAS * np.sqrt(variance[:, 1::2] + around))
    known = np.isfinite(black).any() and np.isfinite(white).any()
    contrast = float(np.nanmean(white) - np.nanmean(black)) if known else np.nan
    return np.nan_to_num(gaps, nan=-np.inf), np.nan_to_num(limits, nan=np.inf), contrast


def _refusal(width_px, phase, bars, repeats, share):
    """Why a pattern does not count as resolved."""
    if width_px < 2:
        return "below the Nyquist width"
    if width_px < SMALLEST_PAIR_PX:
        return "beats with the pixels"
    if abs(bars - repeats) > LARGEST_MISCOUNT:
        return "wrong number of bars"
    if abs(phase) > LARGEST_PHASE_DEG:
        return "bars not where they are printed"
    if share < STRIP_SHARE:
        return "gaps do not stand out"
    return ""


def _limit(widths, contrast, width_px):
    """Width at which the contrast falls to the threshold, or at which beats begin."""
    below = contrast < SMALLEST_GAP
    if below.all() or not below.any():
        return np.nan
    k = int(np.argmax(below))
    if k == 0:
        return np.nan
    part = (contrast[k - 1] - SMALLEST_GAP) / (contrast[k - 1] - contrast[k])
    between = widths[k - 1] + part * (widths[k] - widths[k - 1])
    return float(max(between, SMALLEST_PAIR_PX * widths[k - 1] / width_px[k - 1]))


def _unread(known, reason):
    """A pattern that could not be read."""
    nothing = dict.fromkeys(("contrast", "modulation", "worst_gap", "phase_deg", "bars"), np.nan)
    return PairReading(**known, **nothing, strip_share=0.0, resolved=False, reason=reason)
