"""Which line pairs of a chart are resolved.

A pattern of line pairs counts as resolved when *every* gap between its bars stands out, in most of
the strips across it, and when the bars have the number, the frequency and the place that are
printed. Contrast alone is no evidence: aliases, bars doubled by motion and those reversed by
defocus have plenty of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_columns, check_values, refuse
from mmqa_lab._results import Shown, sentences
from mmqa_lab.chart_image.maps import ChartMap
from mmqa_lab.chart_image.tones import Tones
from mmqa_lab.charts import Bar, Layout, LinePairs

__all__ = [
    "HIDDEN", "MOVED", "SMALLEST_GAP", "SMALLEST_PAIR_PX", "PairReading", "Resolution",
    "expected_contrast", "is_crossed", "read_pairs", "read_pattern", "resolution",
]  # fmt: skip

SMALLEST_GAP = 0.10
"""Share of the chart's contrast by which each gap must stand out from both its bars."""

SMALLEST_PAIR_PX = 2.3
"""Narrower pairs are refused: below 2 pixels they alias; up to 2.3 the beat between pairs and
pixels is shorter than eight pairs, so that some of them vanish at every phase."""

HIDDEN, SURE_CONTRAST = "hidden", 0.3
"""Reason of patterns that something hides: also where a finer one is resolved so clearly."""

MOVED = "bars not where they are printed"

RIM_MM, RIM_TONE, RIM_NOISE, RIM_SHARE = 12.0, 0.2, 4.0, 0.04
"""White around a pattern is looked at, so far around. The pattern is hidden where that share of it
is so far from white, and by so many times the noise."""

TURN_STEPS = 64
"""Steps of a pair in which waves are sought."""


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
    >>> from mmqa_lab.chart_image import ChartMap, find_tones
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
    crossed = [pairs.name for pairs in patterns if is_crossed(tones, pairs, chart_map)]
    # what is finer than all that is resolved may be too fine, whatever is around it
    finest = table.loc[table["resolved"], "width_px"].min()
    seen = table["resolved"] | (table["width_px"] < np.fmax(finest, SMALLEST_PAIR_PX))
    # where motion leaves nothing of a direction, it leaves no plain white either
    some = table.groupby("direction")["resolved"].transform("any")
    free = some | (table["contrast"] >= SURE_CONTRAST)
    table.loc[table["name"].isin(crossed) & ~seen & free, "reason"] = HIDDEN
    for _, ladder in table.groupby("direction"):
        # lobes of defocus and motion stay below that: what is coarser would be seen too
        sure = ladder["resolved"] & (ladder["contrast"] >= SURE_CONTRAST)
        behind = ~ladder["resolved"] & (ladder.index < sure[sure].index.max())
        table.loc[behind[behind].index, "reason"] = HIDDEN
    return table


def read_pattern(tones: Tones, pairs: LinePairs, chart_map: ChartMap) -> PairReading:
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
    >>> from mmqa_lab.chart_image import ChartMap, find_tones
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
    check_columns(readings, ("direction", "width_mm", "resolved"), "readings")
    odd = ~readings["resolved"].isin([True, False])
    refuse(odd.any(), "readings", "resolved is neither", "True or False")
    ladder = readings[readings["direction"] == direction].sort_values("width_mm", ascending=False)
    if "reason" in ladder:
        ladder = ladder[ladder["resolved"].astype(bool) | (ladder["reason"] != HIDDEN)]
    widths, resolved = ladder["width_mm"].to_numpy(), ladder["resolved"].to_numpy(dtype=bool)
    good = int(np.argmin(resolved)) if not resolved.all() else len(widths)
    return Resolution(
        width_mm=float(widths[good - 1]) if good else np.nan,
        next_mm=float(widths[good]) if good < len(widths) else np.nan,
    )


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


def expected_contrast(
    width_px: ArrayLike, sigma_px: float, blur_px: float = 0.0
) -> float | np.ndarray:
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
    total, width_px = 0.0, check_values(width_px, "width_px", positive=True)
    for order in (1, 3, 5, 7):
        rate = order / width_px
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


def is_crossed(tones, pairs, chart_map):
    """Whether the white around a pattern is not white everywhere: something hides part of it."""
    if tones.odd is None:
        return False
    low, high = pairs.corners()[[0, 2]]
    outline = Bar("rim", *(low - RIM_MM), *(high - low + 2 * RIM_MM)).corners()
    places, odd = replace(tones, values=tones.odd).near(chart_map, outline)
    rim = ((places < low) | (places > high)).any(axis=1)
    return rim.sum() > 10 and (odd[rim] > max(RIM_TONE, RIM_NOISE * tones.noise)).mean() > RIM_SHARE


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
