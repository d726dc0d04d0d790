"""Resolution in images: edges, Siemens stars, bars, and sharpness without targets.

All take an array of grey values in proportion to light. Lengths in pixels, frequencies in cycles
per pixel.

Edges: the estimate of ISO 12233 is the default: pixels in bins of a quarter pixel over their
distance from the edge, derivative, window, Fourier transform. Beside it stand sigmoids with one
width, as in EuroSDR 2013, image radiometry, section 5.1 and Table 4 (the report does not print the
shape of its sigmoid): a square pixel behind a Gaussian, and the logistic function.

Stars: a star of 5 degree sectors, half a star of 10 degrees (section 5.1). On a circle around its
centre a star of n cycles is a wave of n / (2 pi r) cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import expit, j1, ndtr

from mmqa_lab._checks import (
    check_choice,
    check_count,
    check_image,
    check_number,
    check_positive,
    refuse,
)  # fmt: skip
from mmqa_lab._results import Shown, about, sentences
from mmqa_lab.chart_image.placing import ChartMap
from mmqa_lab.chart_image.reading import Tones, read_pattern, resolution
from mmqa_lab.charts import LinePairs

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["fit_edge", "haar_sharpness", "measure_star", "read_bars", "resolving_power"]
__dir__ = __all__.copy


FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

BINS_PER_PIXEL, EDGE_BLOCKS = 4, 8
"""Bins of the edge profile; parts of an edge that are compared with its line."""

SIGMOID_PX = (0.15, 12.0)
"""Limits of a sigmoid's width."""

SMALLEST_ANGLE_DEG = 3.0

CROOKED, TORN = 0.12, 0.5
"""Deviations of the edge from its line over the width of the edge: remark, and refusal. At a tenth
MTF50 is half a per cent too low, at a half an eighth."""

OTHER_STEP, OTHER_EDGE = 0.03, 0.25
"""A second step beside the edge over the first one: remark, and refusal."""

OVERSHOOT, LOBE_BINS = 0.01, (4, 8, 12, 16)
"""Of both sides of a profile, over the step: only sharpening gives that; bins that are averaged."""

CUT, ONE_SIDED = 0.005, 0.025
"""Share of the step by which the two halves of a profile differ where one is clipped; and where
something else is on one side."""

ODD_SIDES = "the profile is not alike on both sides, as beside a second edge"

WIDEST_GAP_PX = 0.75
"""Between places of the profile: an edge of 45 degrees has one in each 0.71 pixels."""

PLAIN_PX = 3.0
"""Pixels this far from all borders of a sector show its plain grey value."""

NARROWEST_PX = 4.0
"""Width of the sectors at the outline."""

NEARBY = 1.2
"""Contrasts within this ratio of a share tell where the contrast falls to it."""

RING_STEP_PX, RINGS_A_WIDTH = 0.5, 4
"""Distance between the beginnings of rings, which are two pixels wide: four rings share a pixel."""

STAR_PARTS, LARGEST_DRIFT, SEEN_SHARE = 12, 1.5, 0.7
"""Parts of the circle in which the outer wave is compared: its phase may differ by so many radians,
and its contrast in a part that is not hidden is at least this share of the others'."""

LARGEST_STRETCH = 0.1
"""A star tilted by 35 degrees is stretched by this share along one axis, shrunk along the other."""

BAR_PERIODS = 2.5
"""Bars are five of their widths long."""


@dataclass(frozen=True, eq=False)
class EdgeResponse(Shown):
    """The modulation transfer function (MTF) of one edge, and the widths that go with it.

    Parameters
    ----------
    mtf50, mtf50_sigma : float
        Frequency at which the MTF is 0.5, and its standard deviation, cycles per pixel. NaN where
        the MTF does not fall to 0.5 below 1 cycle per pixel, or the bins are not filled.
    fwhm_px : float
        Full width at half maximum of the line spread function.
    width_px : float
        Standard deviation of the best single Gaussian, without the pixel itself; of a logistic its
        scale.
    angle_deg : float
        Between the edge and the nearer axis of the image.
    n : int
        Pixels used.
    frequencies, mtf : array
        Cycles per pixel and transfer.
    distance_px, lsf : array
        The line spread function over the distance across the edge.
    remark : str
        Reasons to doubt the figures; empty if there are none.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = fit_edge(spread_edge(distance, 0.7, np.arctan(0.1)))
    >>> round(edge.width_px, 2), edge.remark
    (0.7, '')
    """

    mtf50: float
    mtf50_sigma: float
    fwhm_px: float
    width_px: float
    angle_deg: float
    n: int
    frequencies: np.ndarray
    mtf: np.ndarray
    distance_px: np.ndarray
    lsf: np.ndarray
    remark: str = ""

    def _ends(self):
        return [about("mtf50", self.mtf50, self.mtf50_sigma, "1/px")]


def fit_edge(image: ArrayLike, *, method: str = "binned") -> EdgeResponse:
    """Measure the resolution of an image that shows one straight edge.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light: two plain sides and one edge that runs through from side to side; 10 x 10
        pixels or more.
    method : {"binned", "sigmoid", "logistic"}
        The standard's bins, which follow any profile; one Gaussian behind the square pixel; the
        plain logistic function 1 / (1 + exp(-d / w)), whose line spread function has longer tails.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If the method is another, the image is too small, shows no edge that stands out from its
        noise, or more than one.

    See Also
    --------
    measure_star : from a Siemens star, all directions at once.

    Notes
    -----
    The grey values must be linear in light: a display curve changes the MTF. An edge along the
    pixel grid has one phase only; then the binned estimate is NaN. Sharpening raises MTF50 without
    showing more detail. A sigmoid cannot overshoot, and where the optics are no Gaussian it is
    wrong by some per cent more than its standard deviation.

    References
    ----------
    ISO 12233:2023, edge-based spatial frequency response. EuroSDR 2013, image radiometry, section
    5.1.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> seen = spread_edge(distance, 1.0, np.arctan(0.1))
    >>> [round(fit_edge(seen, method=name).mtf50, 2) for name in ("binned", "sigmoid")]
    [0.18, 0.18]
    """
    check_choice(method, "method", ("binned", "sigmoid", "logistic"))
    image = check_image(image)
    refuse(min(image.shape) < 10, "edge", f"{image.shape} pixels", "10 x 10 or larger")
    image = _rising(image)
    place, rows, columns = _edge_line(image)
    angle = np.arctan(place[0])
    turn = float(abs(np.degrees(angle)))
    distance = (columns[None, :] - np.polyval(place, rows)[:, None]) * np.cos(angle)
    along = np.broadcast_to((rows / np.abs(rows).max())[:, None], image.shape)
    shape = _logistic if method == "logistic" else spread_edge
    fit = _Sigmoid(distance.ravel(), along.ravel(), image.ravel(), angle, shape)
    crooked, second = fit.check(len(rows), image.shape[1])
    seen = _by_bins(fit) if method == "binned" else _by_sigmoid(fit)
    clipped = [side for side, sign in (("white", 1), ("black", -1)) if fit.clipped(sign)]
    alone = not clipped and second <= OTHER_STEP
    said = sentences(
        (not np.isfinite(seen["mtf50"]), "MTF stays above 0.5"),
        (
            turn < SMALLEST_ANGLE_DEG,
            f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid",
        ),
        (method != "binned" and fit.strange() > 0.02, "no sigmoid of this shape fits"),
        (fit.overshoot() > OVERSHOOT, "sharpened"),
        *((True, f"{side} is clipped: MTF50 is too high") for side in clipped),
        (crooked > CROOKED, f"not straight by {crooked:.0%} of its width: MTF50 is too low"),
        (second > OTHER_STEP, f"a second edge of {second:.0%} of the step"),
        (alone and fit.one_sided() > ONE_SIDED, ODD_SIDES),
    )
    known = {"width_px": fit.width, "angle_deg": turn, "n": len(fit.values)}
    return EdgeResponse(frequencies=FREQUENCIES, remark="; ".join(said), **known, **seen)


class _Sigmoid:
    """The sigmoid of one width that fits best, and the distances that go with it."""

    def __init__(self, distance, along, values, angle, shape):
        self.angle, self.shape, self.rows = angle, shape, np.arange(len(values))
        known, limits = np.zeros(3), np.log(SIGMOID_PX)
        ends = [-5, -5, limits[0]], [5, 5, limits[1]]
        for reach in (60.0, None):
            near = np.abs(distance) <= (reach or 24 * np.hypot(self.width, 0.3) + 6)
            distance, along, values = distance[near], along[near], values[near]
            self.rows = self.rows[near]
            scale = max(float(np.ptp(values)), 1e-12) / 10
            how = {"bounds": ends, "loss": "soft_l1", "f_scale": scale, "x_scale": [1, 1, 0.3]}
            found = least_squares(self._left, known, args=(distance, along, values), **how)
            known, self.width = found.x, float(np.exp(found.x[2]))
        self.distance, self.values = distance - np.polyval(known[:2], along), values
        self.contrast, self.residuals = self._fitted(self.distance, self.width, values)
        self.places, self.means, self.count, _ = _profile(self.distance, values)
        self.noise = float(np.sqrt(_profile(self.distance, self.residuals)[3]))
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.mean(self.residuals**2)
        self.log_width_sigma = float(np.sqrt(covariance[2, 2]))

    def _left(self, known, distance, along, values):
        """What a sigmoid about a line leaves of the grey values."""
        distance = distance - np.polyval(known[:2], along)
        return self._fitted(distance, np.exp(known[2]), values)[1]

    def _fitted(self, distance, width, values):
        """The step of a sigmoid, its two levels by least squares, and what it leaves."""
        shape = self.shape(distance, width, self.angle)
        design = np.column_stack([np.ones_like(shape), shape])
        levels = np.linalg.lstsq(design, values, rcond=None)[0]
        return float(levels[1]), values - design @ levels

    def strange(self):
        """Largest share of the step by which the binned profile leaves the sigmoid."""
        _, means, count, _ = _profile(self.distance, self.residuals)
        return float((np.abs(means) - 4 * self.noise / np.sqrt(count)).max() / self.contrast)

    @property
    def spread(self):
        """Standard deviation of the edge's Gaussian and the pixel together."""
        return np.hypot(self.width, 12**-0.5)

    def check(self, rows, columns):
        """Raise if there is no edge, or more than one; how crooked it is, and a second step."""
        faint = not self.contrast * np.sqrt(rows) > 8 * self.noise
        step = f"a step of {self.contrast:.3g} at a noise of {self.noise:.3g}"
        refuse(faint, "edge", step, "one that stands out")
        row = self.rows // columns
        crooked = max(self.crooked(row // size) for size in (1, 4, max(rows // EDGE_BLOCKS, 5)))
        leaves = f"it leaves a straight line by {crooked:.0%} of its width"
        refuse(crooked > TORN, "edge", leaves, "straight, neither bent nor torn")
        strange = self.strange()
        several = strange > OTHER_EDGE and self.overshoot() <= OVERSHOOT
        leaves = f"the profile leaves a single step by {strange:.0%} of it"
        refuse(several, "edge", leaves, "one edge between two plain sides")
        return crooked, max(self.second_step(-1), self.second_step(1))

    def crooked(self, part):
        """Standard deviation of the edge's place in parts of its length over its width.

        What noise gives, and four standard deviations of that, is taken off.
        """
        left = self.values - np.interp(self.distance, self.places, self.means)
        noise = np.var(left[np.abs(self.distance) > 4 * self.spread + 2])
        slope = np.exp(-((self.distance / self.spread) ** 2) / 2)
        slope *= self.contrast / (np.sqrt(2 * np.pi) * self.spread)
        weight = np.bincount(part, slope**2)
        shift = np.bincount(part, slope * left) / np.maximum(weight, 1e-12)
        full = np.flatnonzero(weight > np.median(weight) / 2)
        if len(full) < 4:
            return 0.0
        shift = shift[full] - np.polyval(np.polyfit(full, shift[full], 1), full)
        by_noise = np.mean(noise / weight[full]) * (1 + 4 * np.sqrt(2 / len(full)))
        return float(np.sqrt(max((shift @ shift) / (len(full) - 2) - by_noise, 0)) / self.spread)

    def second_step(self, side):
        """Largest step on one side of the edge that stands out, over the edge's own.

        The side's level, slope and the long tail of a lens, which falls with the inverse of the
        distance, are estimated with it.
        """
        beside = self.places * side > 3 * self.spread + 2
        far = self.places[beside] * side
        weight = np.sqrt(self.count[beside]) / max(self.noise, 1e-9)
        if len(far) < 4 * BINS_PER_PIXEL:
            return 0.0
        plain = np.column_stack([np.ones_like(far), 1 / far, far]) * weight[:, None]
        beyond = (far[:, None] > np.arange(far.min() + 2, far.max() - 2, 0.5)) * weight[:, None]
        basis, seen = np.linalg.qr(plain)[0], weight * self.means[beside]
        beyond = beyond - basis @ (basis.T @ beyond)
        square = np.square(beyond).sum(axis=0)
        steps = np.abs(beyond.T @ seen) / square  # of least squares, beside the plain side
        return float(steps[steps**2 * square > 25].max(initial=0) / self.contrast)

    def clipped(self, side):
        """Whether one side is cut off: its pixels share a value, and the profile is one-sided."""
        beside = side * self.values[side * self.distance > 4 * self.spread + 1]
        levels = np.unique(side * self.values)[-2:]
        if len(levels) < 2 or np.mean(beside == levels[1]) < 0.1:
            return False
        # noise on one side of a wall
        noisy = beside.std() > max(np.diff(levels)[0], CUT / 2 * self.contrast)
        return noisy or self.one_sided() > CUT

    def one_sided(self):
        """By how much both halves of the profile differ, over the step, less what noise gives."""
        share, noise = self.shares()
        reach = np.linspace(0, 4 * self.spread + 1, 60)
        middle = np.linspace(-0.6, 0.6, 61)[:, None] * self.spread
        curve = PchipInterpolator(self.places, share)
        halves = curve(middle + reach) + curve(middle - reach) - 1
        least = np.sqrt(np.square(halves).mean(axis=1)).min()
        return float(np.sqrt(max(least**2 - (1.3 * noise) ** 2, 0)))

    def overshoot(self):
        """By how much both sides pass their levels where it is more than noise, over the step."""
        share, noise = self.shares()
        end, found = min(3 * self.spread + 6, -self.places[0], self.places[-1]), 0.0
        reach = np.arange(0, end, 1 / BINS_PER_PIXEL)
        past = [sign * np.interp(sign * reach, self.places, share - (sign > 0)) for sign in (-1, 1)]
        for bins in LOBE_BINS:
            sides = np.stack([np.convolve(one, np.full(bins, 1 / bins), "valid") for one in past])
            mean = sides.mean(axis=0)
            clear = (mean > 4 * noise / np.sqrt(2 * bins)) & (sides.min(axis=0) > mean / 4)
            found = max(found, float(mean[clear].max(initial=0)))
        return found

    def shares(self):
        """Profile between the levels of both sides as 0 and 1, and the noise of a place."""
        far = 4 * self.spread + 1
        low, high = (np.median(self.values[way * self.distance > far]) for way in (-1, 1))
        noise = self.noise / (self.contrast * np.sqrt(np.median(self.count)))
        return (self.means - low) / (high - low), noise


def _logistic(distance, width, _):
    return expit(distance / width)


def _by_sigmoid(fit):
    """MTF and profiles of the fitted sigmoid."""
    places = np.arange(-1, 1.0001, 1 / 256) * (12 * np.hypot(fit.width, 0.3) + 2)
    lsf = np.gradient(fit.shape(places, fit.width, fit.angle), places)
    mtf = np.cos(2 * np.pi * FREQUENCIES[:, None] * places) @ lsf / lsf.sum()
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    sigma = mtf50 * fit.log_width_sigma  # a little too large: the pixel's width has no error
    known = {"distance_px": places, "lsf": lsf, "mtf": mtf, "fwhm_px": _fwhm(places, lsf)}
    return known | {"mtf50": mtf50, "mtf50_sigma": sigma}


def _by_bins(fit):
    """MTF and profiles by the standard's binning; the interval from the noise of the bins."""
    transfer, places, lsf = _binned(fit.distance, fit.values)
    mtf = np.abs(transfer)
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    sigma = _sigma_of_bins(fit, mtf, mtf50) if np.isfinite(mtf50) else np.nan
    known = {"distance_px": places, "lsf": lsf / np.trapezoid(lsf, places), "mtf": mtf}
    # noise outlives the signal: from twice the frequency of a tenth of the contrast on it fades
    fade = np.clip(2 - FREQUENCIES / crossing(FREQUENCIES, mtf, 0.1) / 2, 0, 1)
    fine = np.linspace(-20, 20, 4001)
    waves = np.cos(2 * np.pi * fine[:, None] * FREQUENCIES)
    spread = np.trapezoid(waves * transfer.real * fade, FREQUENCIES, axis=1)
    fwhm = _fwhm(fine, spread) if np.isfinite(mtf50) else np.nan
    return known | {"mtf50": mtf50, "mtf50_sigma": sigma, "fwhm_px": fwhm}


def _sigma_of_bins(fit, mtf, mtf50):
    """Standard deviation of MTF50 that the noise of the profile gives."""
    places, count = fit.places, fit.count
    beside = np.abs(places) > 4 * fit.spread + 2
    # of the plain sides: neighbouring pixels of a photograph share a part of their noise
    noise = ((fit.shares()[0] - (places > 0))[beside] * np.sqrt(count[beside])).std()
    terms = np.exp(-2j * np.pi * mtf50 * places) * _window(places)
    weight = np.abs(np.gradient(terms)) / np.sqrt(2)
    near = np.abs(FREQUENCIES - mtf50) < max(0.02, mtf50 / 6)
    slope = np.polyfit(FREQUENCIES[near], mtf[near], 1)[0]
    of_transfer = noise * np.sqrt(np.sum(weight**2 / count)) / _of_bins(mtf50)
    # besides noise, bins err by .2 %
    return float(np.hypot(of_transfer / abs(slope), 0.002 * mtf50))


def _window(places):
    """One in the middle; the ends fall off as a cosine."""
    half = min(-places[0], places[-1])
    return np.sin(np.pi / 2 * np.clip(10 * (1 - np.abs(places) / half), 0, 1)) ** 2


def _of_bins(frequency):
    """Transfer of the central difference, which ISO 12233 takes out, and of the bins' width."""
    steps = frequency / BINS_PER_PIXEL
    return np.sinc(2 * steps) * np.sinc(steps)


def _profile(distance, values):
    """Places, means and counts of the bins that have pixels, and the variance within bins.

    Pixels do not fill a bin evenly.
    """
    place = np.round(distance * BINS_PER_PIXEL).astype(int)
    place -= place.min()
    count = np.bincount(place)
    full = np.flatnonzero(count)
    sums = [np.bincount(place, part) / np.maximum(count, 1) for part in (distance, values)]
    variance = np.square(values - sums[1][place]).sum() / max(len(values) - len(full), 1)
    return sums[0][full], sums[1][full], count[full], float(variance)


def _binned(distance, values):
    """Transfer, NaN where bins at the edge are empty; places and derivative of the profile."""
    centres, means, *_ = _profile(distance, values)
    ends = np.round(np.array([distance.min(), distance.max()]) * BINS_PER_PIXEL)
    places = np.arange(ends[0], ends[1] + 1) / BINS_PER_PIXEL
    empty = 1 - len(centres) / len(places)
    # between places farther apart than bins a curve, else straight lines
    curve = PchipInterpolator(centres, means, extrapolate=True)
    profile = curve(places) if empty > 0.1 else np.interp(places, centres, means)
    spread = np.gradient(profile, places) * _window(places)
    waves = np.exp(-2j * np.pi * FREQUENCIES[:, None] * places)
    transfer = (waves @ spread) / _of_bins(FREQUENCIES)
    if np.diff(centres[np.abs(centres) <= 3]).max(initial=0) > WIDEST_GAP_PX:
        transfer = np.full(len(FREQUENCIES), np.nan)
    transfer = transfer / (BINS_PER_PIXEL * _whole_step(places, profile))
    transfer[0] = 1.0
    return transfer, places, spread


def _whole_step(places, profile):
    """The step between both plain sides, as far as a lens spreads light.

    Behind a lens limited by diffraction the profile nears its levels with the inverse of the
    distance: the window would cut a part of the step off, and the transfer would be too high.
    """
    half = min(-places[0], places[-1])
    outer = (np.abs(places) > half / 2) & (np.abs(places) <= half)
    far = places[outer]
    design = np.column_stack([np.ones_like(far), np.sign(far) / 2, 1 / far])
    return float(np.linalg.lstsq(design, profile[outer], rcond=None)[0][1])


def _fwhm(places, lsf):
    """Full width at half maximum, between straight lines."""
    top = int(lsf.argmax())
    left, right = (crossing(places[top::way], lsf[top::way], lsf[top] / 2) for way in (-1, 1))
    return right - left


def spread_edge(distance: ArrayLike, sigma: float, angle: float) -> np.ndarray:
    """Return what a pixel sees of a step from 0 to 1, closed form.

    Parameters
    ----------
    distance : array_like
        Of the pixel's centre from the edge, along the edge's normal, pixels.
    sigma : float
        Standard deviation of the Gaussian point spread, pixels.
    angle : float
        Of the normal against an image axis, radians: a square pixel is a trapezoid from there.

    Examples
    --------
    >>> spread_edge([-9.0, 0.0, 9.0], 0.7, 0.1).round(6).tolist()
    [0.0, 0.5, 1.0]
    """
    narrow, wide = np.sort(np.abs([np.cos(angle), np.sin(angle)]))
    narrow, distance = max(narrow, 1e-3), np.asarray(distance, dtype=float)
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    bend = [_double_integral(distance + place, sigma) for place in (outer, inner, -inner, -outer)]
    return (bend[0] - bend[1] - bend[2] + bend[3]) / (wide * narrow)


def crossing(frequencies, mtf, level):
    """Return the first frequency (or place) at which values fall below a level; NaN without one."""
    below = mtf < level
    if not below.any() or below[0]:
        return np.nan
    k = int(np.argmax(below))
    part = (mtf[k - 1] - level) / (mtf[k - 1] - mtf[k])
    return float(frequencies[k - 1] + part * (frequencies[k] - frequencies[k - 1]))


def _rising(image):
    """The image turned so that its rows cross the edge from dark to bright."""
    by_row, by_column = np.gradient(cv2.GaussianBlur(image, (0, 0), 1.5))
    if (by_row**2).sum() > (by_column**2).sum():
        image = image.T
    return image[:, ::-1] if image[:, -3:].mean() < image[:, :3].mean() else image


def _edge_line(image):
    """Line column(row) of the edge, both counted from the middle, and those coordinates."""
    rows = np.arange(image.shape[0]) - (image.shape[0] - 1) / 2
    columns = np.arange(image.shape[1]) - (image.shape[1] - 1) / 2
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    slope = np.clip(np.diff(smooth, axis=1), 0, None)
    between = (columns[1:] + columns[:-1]) / 2
    line = np.polyfit(rows, between[slope.argmax(axis=1)], 1)
    for reach in (20.0, 10.0, 6.0, 6.0):
        gap = np.abs(between[None, :] - np.polyval(line, rows)[:, None])
        weight = slope * np.clip(1 - (gap / reach) ** 2, 0, None)
        total = weight.sum(axis=1)
        clear = total > 0.2 * np.median(total)
        if clear.sum() < 5 or not total.max() > 0:
            raise ValueError("Invalid image: no edge from side to side. Must show one.")
        centre = (weight @ between)[clear] / total[clear]
        line = np.polyfit(rows[clear], centre, 1)
    return line, rows, columns


def _double_integral(x, sigma):
    """The second antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma**2 / 2 * ((z**2 + 1) * ndtr(z) + z * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


@dataclass(frozen=True, eq=False)
class StarMtf(Shown):
    """The modulation transfer function that a star shows.

    Parameters
    ----------
    frequency : array, shape (k,)
        Cycles per pixel, rising.
    mtf, std : array, shape (k,)
        Contrast over that of plain sectors, and its standard error; NaN where not measurable.
    radius_px : array, shape (k,)
    centre : (float, float)
        x (column), y (row) in pixels of the given image, the first pixel's centre at 0.
    tilt_deg : float
        Angle under which the star was seen; 0 if it is round.
    remark : str
        Reasons to doubt the figures; empty if there are none.

    Examples
    --------
    >>> f = np.linspace(0.02, 0.5, 97)
    >>> seen = np.exp(-2 * (np.pi * 0.8 * f) ** 2)  # a Gaussian of 0.8 px
    >>> star = StarMtf(f, seen, 0 * f, 9 / f, (50.0, 50.0))
    >>> round(star.mtf50, 3)
    0.234
    """

    frequency: np.ndarray
    mtf: np.ndarray
    std: np.ndarray
    radius_px: np.ndarray
    centre: tuple
    tilt_deg: float = 0.0
    remark: str = ""

    def at(self, share: float) -> float:
        """Frequency at which the contrast first falls to a share; NaN where it does not.

        That of a tenth, ``at(0.1)``, is the limiting resolution.
        """
        return self._falls_to(share)[0]

    @property
    def mtf50(self) -> float:
        """Frequency of half the contrast."""
        return self.at(0.5)

    @property
    def mtf50_sigma(self) -> float:
        """Standard deviation of the frequency of half the contrast."""
        return self._falls_to(0.5)[1]

    def _ends(self):
        return [about("mtf50", *self._falls_to(0.5), "1/px")]

    def _falls_to(self, share):
        """Frequency of a share of the contrast and its standard deviation.

        A line through the logarithms of the contrasts nearby over the squared frequency, since the
        first noisy value below the share comes too early.
        """
        ends = share * NEARBY, share / NEARBY
        first, last = (crossing(self.frequency, self.mtf, end) for end in ends)
        near = (self.frequency >= first) & (self.frequency <= last) & (self.mtf > 0)
        if near.sum() < 2:
            return crossing(self.frequency, self.mtf, share), np.nan
        f2, contrast = self.frequency[near] ** 2, self.mtf[near]
        relative = np.maximum(self.std[near] / contrast, 1e-9)
        weight = {"w": 1 / relative, "cov": "unscaled"}
        line, covariance = np.polyfit(f2, np.log(contrast / share), 1, **weight)
        place = -line[1] / line[0]
        if not place > 0:
            return crossing(self.frequency, self.mtf, share), np.nan
        terms = np.array([place, 1.0])
        spread = np.sqrt(RINGS_A_WIDTH * terms @ covariance @ terms) / abs(line[0])
        found = float(np.sqrt(place))
        # besides noise, stars err by .15 % behind three simulated lenses, level and tilted
        return found, float(np.hypot(spread / (2 * found), 0.0015 * found))

    def to_frame(self) -> pd.DataFrame:
        """Return ``frequency_per_px``, ``mtf``, ``mtf_std``, ``radius_px``, one row a circle."""
        columns = {"frequency_per_px": self.frequency, "mtf": self.mtf}
        return pd.DataFrame(columns | {"mtf_std": self.std, "radius_px": self.radius_px})


def measure_star(
    image: ArrayLike,
    centre: tuple[float, float],
    *,
    cycles: int,
    radius_px: float,
    azimuth_deg: tuple = (0.0, 360.0),
) -> StarMtf:
    """Measure the contrast of a Siemens star, circle by circle.

    In rings two pixels wide a constant, a wave of the star's cycles, which may change along the
    radius, and its odd harmonics as far as pixels show them are fitted to all pixels. The wave's
    amplitude over that of plain sectors, times pi/4 for their square shape, is the transfer
    function. What blur takes away in the middle of the sectors is given back to their levels, as
    much as a lens takes that fits the transfer function: Gaussian, disc or diffraction. The centre,
    and the ellipse that a tilted star is, are refined until the wave has the same phase in all
    rings.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    centre : (float, float)
        Rough x (column), y (row) of the star's centre, px, better than a quarter of a sector at
        half the radius.
    cycles : int
        Pairs of dark and bright sectors around the full circle.
    radius_px : float
        Of the star; where it is an ellipse, half of its long axis.
    azimuth_deg : (float, float)
        The part of the circle to use, from x towards y: a half star, or a direction of interest.

    Returns
    -------
    StarMtf

    Raises
    ------
    ValueError
        If the star leaves the image, is too small to show plain sectors, shows another number of
        cycles, or is tilted by more than 35 degrees.

    See Also
    --------
    fit_edge : from one edge, which any photograph may have.

    Notes
    -----
    A wrong centre costs contrast in the middle, where frequencies are high: 0.3 px takes a seventh
    of the contrast at 0.4 cycles per pixel, 1 - J0(2 pi 0.4 0.3). Plain sectors are looked for 3 px
    from their borders, where a blur of 1.5 px (sigma) takes 2 % of the contrast; a blur that is far
    from Gaussian is not fully given back.

    References
    ----------
    EuroSDR 2013, image radiometry, sections 5.1 and 5.2.

    Examples
    --------
    >>> y, x = np.mgrid[:160, :160] - 79.5
    >>> star = 100 + 80 * np.sign(np.sin(9 * np.arctan2(y, x)))
    >>> found = measure_star(star, (79.5, 79.5), cycles=9, radius_px=75)
    >>> bool(found.mtf[0] > 0.97), [round(c, 1) for c in found.centre]  # no blur but the pixel
    (True, [79.5, 79.5])
    """
    grey = np.asarray(image, dtype=np.float64)
    n = check_count(cycles, "cycles", low=2)
    radius = check_positive(radius_px, "radius_px", unit="px")
    x0, y0 = (check_number(value, "centre", unit="px") for value in centre)
    rows, columns = np.meshgrid(*map(np.arange, grey.shape), indexing="ij")
    used = _sector(rows - y0, columns - x0, azimuth_deg)
    pixels = (columns[used].astype(float), rows[used].astype(float), grey[used])
    place = np.array([x0, y0, 0.0, 0.0])
    _plain_levels(pixels, place, n, radius)
    rings = np.arange(n / np.pi, radius - 1 - PLAIN_PX, RING_STEP_PX)
    place = _refined(pixels, place, n, rings[rings > 1.5 * n / np.pi])
    waves = _outer_parts(pixels, place, n, radius)
    _check_cycles(waves, n)
    tilt, most = (f"{_tilt(one):.0f} degrees" for one in (place, [0, 0, LARGEST_STRETCH, 0]))
    tilted = np.hypot(*place[2:]) > LARGEST_STRETCH
    refuse(tilted, "star", f"tilted by {tilt}", f"tilted by {most} or less")
    radius *= 1 - np.hypot(*place[2:])
    rings = rings[rings < radius - 1 - PLAIN_PX][::-1]
    fits = [_ring(pixels, place, n, ring) for ring in rings]
    amplitude, std = np.array([(np.hypot(*fit[0]), fit[1]) for fit in fits]).T
    frequency = n / (2 * np.pi * rings)
    lens = _lens_of(frequency, amplitude)
    # three standard deviations of the Gaussian of the same MTF50
    clear = 0.56 / crossing(FREQUENCIES, lens(FREQUENCIES), 0.5)
    levels, borders, clipped = _plain_levels(pixels, place, n, radius, clear)
    faintest = np.abs(waves).min() / np.median(np.abs(waves))
    hidden = f"a part of the star is hidden: contrast {faintest:.0%} of the others'"
    clips = f"{clipped} is clipped: MTF50 is too high"
    remark = "; ".join(sentences((faintest < SEEN_SHARE, hidden), (clipped, clips)))
    scale, centre = 2 * _plain_level(lens, borders) / np.ptp(levels), tuple(place[:2].tolist())
    known = {"centre": centre, "tilt_deg": _tilt(place), "remark": remark}
    return StarMtf(frequency, scale * amplitude, scale * std, rings, **known)


def read_bars(
    image: ArrayLike, groups: pd.DataFrame, *, dark: float, bright: float, noise: float
) -> pd.DataFrame:
    """Read groups of bright bars on a dark ground.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    groups : DataFrame
        One row a group, as far as known from its place on the ground: ``period_px`` (a bright and a
        dark bar), ``x_px``, ``y_px`` (column and row of its middle, the first pixel's centre at 0),
        ``angle_deg`` (direction across the bars from x towards y), ``bars``.
    dark, bright : float
        Grey values of wide dark and bright areas.
    noise : float
        Standard deviation of a pixel, in grey values.

    Returns
    -------
    DataFrame
        The groups with ``contrast``, ``counted`` (bars), ``phase_deg``, ``strip_share``,
        ``resolved`` and the ``reason`` why not, as of ``chart_image.reading``.

    Raises
    ------
    ValueError
        If bright is not above dark or the noise is not above zero.

    Examples
    --------
    >>> x = np.arange(80)[None, :].repeat(40, axis=0)
    >>> bright = 20 + 60 * ((x - 10) // 4 % 2 == 0) * (x >= 10) * (x < 50)
    >>> group = {"period_px": 8.0, "x_px": 27.5, "y_px": 20.0, "angle_deg": 0.0, "bars": 5}
    >>> found = read_bars(bright, pd.DataFrame([group]), dark=20, bright=80, noise=1.0)
    >>> bool(found["resolved"].item()), round(found["counted"].item())
    (True, 5)
    """
    contrast = check_positive(bright - dark, "contrast of bright and dark")
    # bright bars on a dark ground are the chart's black bars on white, turned round
    dimness = (bright - np.asarray(image, dtype=np.float64)) / contrast
    tones, readings = Tones(dimness, check_positive(noise, "noise") / contrast), []
    for group in groups.to_dict("records"):
        size = {"repeats": int(group["bars"]), "length": BAR_PERIODS * group["period_px"]}
        pairs = LinePairs("group", 0.0, 0.0, group["period_px"], "h", **size)
        readings.append(read_pattern(tones, pairs, _place_of_bars(group)))
    seen = pd.DataFrame(readings).rename(columns={"bars": "counted"})
    figures = ["counted", "contrast", "phase_deg", "strip_share", "resolved", "reason"]
    return groups.reset_index(drop=True).join(seen[figures])


def resolving_power(readings: pd.DataFrame) -> tuple[float, float]:
    """Return the period of the narrowest group resolved with all wider ones, and of the next.

    Parameters
    ----------
    readings : DataFrame
        From ``read_bars``, of one direction.

    Returns
    -------
    period_px, next_px : float
        The resolving power lies between 1 / period and 1 / next line pairs per pixel. NaN where no
        group is resolved, or all are.

    Examples
    --------
    >>> ladder = pd.DataFrame({"period_px": [6, 4, 3], "resolved": [True, True, False]})
    >>> resolving_power(ladder)
    (4.0, 3.0)
    """
    ladder = readings[["period_px", "resolved"]].rename(columns={"period_px": "width_mm"})
    found = resolution(ladder.assign(direction="h"), "h")
    return found.width_mm, found.next_mm


def haar_sharpness(
    image: ArrayLike, *, block: int = 64, noise_std: float | None = None
) -> xr.Dataset:
    """Map the sharpness of an image, block by block.

    Two levels of the Haar transform; in each block the root mean square of the details of the
    finest level over that of the next, each less what noise adds. On the same scene a blurred image
    gives less.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    block : int
        Side of the blocks, px, a multiple of 4; the rest at the right and lower edge is left out.
    noise_std : float, optional
        Standard deviation of the noise, in grey values. Estimated from the finest diagonal details
        where left out, which takes fine texture for noise.

    Returns
    -------
    Dataset
        ``sharpness`` over ``y_px``, ``x_px`` (the blocks' centres); NaN where the coarser details
        do not stand out from the noise.
        ``attrs``: ``noise_std`` used, ``not_measurable`` (count of blocks).

    Raises
    ------
    ValueError
        If the image is smaller than a block or not finite.

    Notes
    -----
    A sharp edge has as much detail at both levels, fine texture has more at the finest: values
    about 0.5 to 1 are usual. Compare images of the same ground, or take the median of many images
    at each place of the image plane, so that the scenes even out.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(64, 64))
    >>> haar_sharpness(noise, noise_std=0)["sharpness"].round(1).item()
    1.0
    """
    import xarray as xr
    from scipy.stats import median_abs_deviation

    grey, side = check_image(image), check_count(block, "block", low=8)
    found = f"{grey.shape} pixels for blocks of {side} px"
    must = "at least a block large; the block's side must be a multiple of 4"
    refuse(min(grey.shape) < side or side % 4, "image", found, must)
    rows, columns = (size // side for size in grey.shape)
    approximation, fine = _haar(grey[: rows * side, : columns * side])
    coarse = _haar(approximation)[1]
    if noise_std is None:
        noise_std = float(median_abs_deviation(fine[2], axis=None, scale="normal"))
    noise = check_number(noise_std, "noise_std", low=0) ** 2
    above, below = (
        sum(cv2.resize(part**2, (columns, rows), interpolation=cv2.INTER_AREA) for part in details)
        - 3 * noise
        for details in (fine, coarse)
    )
    clear = below > 4 * max(noise, 1e-12) * len(fine)
    ratio = np.sqrt(np.maximum(above, 0) / np.where(clear, below, np.nan))
    centres = {"y_px": (np.arange(rows) + 0.5) * side, "x_px": (np.arange(columns) + 0.5) * side}
    about = {"noise_std": noise_std, "not_measurable": int((~clear).sum())}
    return xr.Dataset({"sharpness": (("y_px", "x_px"), ratio)}, coords=centres, attrs=about)


def _haar(grey):
    """One level of Haar wavelets: the approximation, and the details along y, x and both."""
    a, b = grey[::2, ::2], grey[::2, 1::2]
    c, d = grey[1::2, ::2], grey[1::2, 1::2]
    return (a + b + c + d) / 2, ((a + b - c - d) / 2, (a - b + c - d) / 2, (a - b - c + d) / 2)


def _sector(dy, dx, azimuth_deg):
    """Pixels within the wanted part of the circle, clear of its limits."""
    first, last = (check_number(value, "azimuth_deg", unit="degrees") for value in azimuth_deg)
    if not 0 < last - first <= 360:
        raise ValueError(f"Invalid azimuth_deg {azimuth_deg}. Must span between 0 and 360 degrees.")
    turn = (np.degrees(np.arctan2(dy, dx)) - first) % 360
    to_limits = np.radians(np.clip(np.minimum(turn, last - first - turn), 0, 90))
    return (np.hypot(dx, dy) * np.sin(to_limits) > PLAIN_PX) | (last - first == 360)


def _polar(pixels, place):
    """Radius and azimuth of pixels about a centre, on the round star that is seen as an ellipse."""
    x, y, a, b = place
    dx, dy = pixels[0] - x, pixels[1] - y
    dx, dy = (1 + a) * dx + b * dy, b * dx + (1 - a) * dy
    return np.hypot(dx, dy), np.arctan2(dy, dx)


def _tilt(place):
    """The angle under which a star has the axes of this ellipse, degrees."""
    stretch = np.hypot(*place[2:])
    return float(np.degrees(np.arccos((1 - stretch) / (1 + stretch))))


def _plain_levels(pixels, place, n, radius, clear=0.0):
    """Grey values in the middle of the sectors near the outline, and the distances from borders.

    Levels as an array, dark first; of each pixel used the distances from both its borders.
    """
    r, azimuth = _polar(pixels, place)
    outer = (r > 0.75 * radius) & (r < radius - max(PLAIN_PX, clear))
    small = outer.sum() < 4 * n or np.pi * radius / n < NARROWEST_PX
    must = f"in the image and larger than {NARROWEST_PX * n / np.pi:.0f} px to show plain sectors"
    refuse(small, "star", f"{n} cycles, radius {radius:g} px", must)
    values = pixels[2][outer]
    phase = n * azimuth[outer]
    design = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    _, c, s = np.linalg.lstsq(design, values, rcond=None)[0]
    turned = (phase - np.arctan2(s, c)) / (2 * np.pi)
    from_peak = np.abs(turned - np.round(turned))
    width = np.pi * r[outer] / n
    near = np.abs(from_peak - 0.25) * 2 * width
    plain = near > np.minimum(PLAIN_PX, 0.3 * width)
    bright = from_peak < 0.25
    sides = [values[plain & ~bright], values[plain & bright]]
    levels = np.array([side.mean() for side in sides])
    return levels, np.stack([near[plain], (width - near)[plain]]), _clipped_side(*sides)


def _clipped_side(black, white):
    """Which side's pixels share one value though the other side's have noise; empty if neither."""
    least = CUT / 10 * (white.mean() - black.mean())
    both = ("black", black, np.min, white), ("white", white, np.max, black)
    for name, side, end, other in both:
        piled = np.mean(side == end(side)) > 0.1
        if piled and (side.std() > 5 * least or other.std() > max(4 * side.std(), least)):
            return name
    return ""


def _outer_parts(pixels, place, n, radius):
    """The wave of n cycles near the outline in parts of the circle, as complex numbers."""
    r, azimuth = _polar(pixels, place)
    outer = (r > 0.6 * radius) & (r < 0.9 * radius)
    part = np.floor(azimuth[outer] * STAR_PARTS / (2 * np.pi)).astype(int) % STAR_PARTS
    count, values = np.bincount(part, minlength=STAR_PARTS), pixels[2][outer]
    mean = np.bincount(part, values, STAR_PARTS) / np.maximum(count, 1)
    wave = (values - mean[part]) * np.exp(-1j * n * azimuth[outer])
    sums = np.bincount(part, wave.real, STAR_PARTS) + 1j * np.bincount(part, wave.imag, STAR_PARTS)
    full = count > count.max() / 2
    return sums[full] / count[full]


def _check_cycles(waves, n):
    """Raise where the wave's phase turns around the circle: it has another number of cycles."""
    seen_well = np.abs(waves) > np.median(np.abs(waves)) / 2
    phase = np.unwrap(np.angle(waves[seen_well]))
    if np.ptp(phase) > LARGEST_DRIFT:
        slope = np.polyfit(np.arange(len(phase)), phase, 1)[0]
        seen = n + round(slope * STAR_PARTS / (2 * np.pi))
        shows = f"it shows about {seen}" if seen != n else "its wave is not regular"
        raise ValueError(f"Invalid star of {n} cycles: {shows}. Must have the cycles stated.")


def _disc(x):
    """Transfer of a defocused lens at cycles per radius."""
    turn = 2 * np.pi * np.maximum(x, 1e-9)
    return 2 * j1(turn) / turn


def _diffraction(x):
    """Transfer of a perfect lens at a share of its highest frequency."""
    x = np.minimum(x, 1)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2))


def _gauss(x):
    """Transfer of a Gaussian at cycles per standard deviation."""
    return np.exp(-2 * np.pi**2 * x**2)


LENS_TRANSFERS = {"gaussian": _gauss, "disc": _disc, "diffraction": _diffraction}
"""Transfer functions of lenses at frequencies times their width (cycles per pixel, pixels)."""


def lens_mtf(transfer, width, frequencies):
    """Return the transfer function of a lens and a square pixel, the mean of all directions."""
    turn = np.radians(np.arange(2.5, 45, 5))[:, None]
    f = np.ravel(frequencies)
    pixel = (np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))).mean(axis=0)
    return (transfer(f * width) * pixel).reshape(np.shape(frequencies))


def _lens_of(frequency, contrast):
    """Transfer function of the lens whose shape fits contrasts up to a scale.

    The contrast of plain sectors is not needed: a lens transfers everything at frequency zero.
    """
    known = np.isfinite(contrast) & (contrast > 0.05 * np.nanmax(contrast))
    f, seen = frequency[known], contrast[known]

    def misfit(log_width, transfer):
        """Sum of squares that the best scale leaves."""
        model = np.abs(lens_mtf(transfer, np.exp(log_width), f))
        return ((seen - model * (model @ seen) / (model @ model)) ** 2).sum()

    choices = {"bounds": np.log(SIGMOID_PX), "method": "bounded"}
    lenses = LENS_TRANSFERS.values()
    fits = {lens: minimize_scalar(misfit, args=(lens,), **choices) for lens in lenses}
    best = min(fits, key=lambda lens: fits[lens].fun)
    return partial(lens_mtf, best, float(np.exp(fits[best].x)))


def _plain_level(lens, borders):
    """Level in the middle of the sectors behind a lens, of a square wave with fundamental 1."""
    width, total = borders.sum(axis=0), 0.0
    for k in range(1, 22, 2):
        left = lens(k / (2 * width))
        total = total + left * np.sin(np.pi * k * borders[0] / width) / k
    return float(total.mean())


def _ring(pixels, place, n, ring):
    """Cosine and sine amplitude of the wave at a radius, and their standard error."""
    r, azimuth = _polar(pixels, place)
    inside = np.abs(r - ring) < 1
    wave = np.stack([np.cos(n * azimuth[inside]), np.sin(n * azimuth[inside])])
    off = r[inside] - ring
    terms = [np.ones_like(off), *wave, *(off * wave)]
    for k in (3, 5):
        if k * n / (2 * np.pi * ring) < 0.45:
            terms += [np.cos(k * n * azimuth[inside]), np.sin(k * n * azimuth[inside])]
    design, values = np.stack(terms, axis=1), pixels[2][inside]
    coefficients = np.linalg.lstsq(design, values, rcond=None)[0]
    residuals = values - design @ coefficients
    variance = residuals @ residuals / max(len(values) - len(terms), 1)
    covariance = variance * np.linalg.pinv(design.T @ design)
    return coefficients[1:3], np.sqrt((covariance[1, 1] + covariance[2, 2]) / 2)


def _refined(pixels, place, n, rings):
    """Centre and ellipse about which the wave keeps its phase over the rings and around them."""
    r, _ = _polar(pixels, place)
    near = (r > 0.9 * rings[0] - 1) & (r < 1.1 * min(rings[-1], 6 * rings[0]))
    points = [values[near] for values in pixels]

    def misfit(place, points=points):
        """Residuals of one wave over all rings whose amplitude falls with frequency squared."""
        radius, azimuth = _polar(points, place)
        wave = np.stack([np.cos(n * azimuth), np.sin(n * azimuth)])
        f2 = (n / (2 * np.pi * np.maximum(radius, 1))) ** 2
        design = np.stack([np.ones_like(f2), *wave, *(f2 * wave), *(f2**2 * wave)], axis=1)
        return points[2] - design @ np.linalg.lstsq(design, points[2], rcond=None)[0]

    # a stretch turns the wave by up to n times itself; beyond a radian the fit would lose it
    steps = np.arange(-1, 1.01, min(1.0, 1.2 / (n * LARGEST_STRETCH))) * LARGEST_STRETCH
    some = [values[:: len(r) // 3000 + 1] for values in points]
    starts = [[*place[:2], a, b] for a in steps - steps.mean() for b in steps - steps.mean()]
    best = min(starts, key=lambda start: (misfit(start, some) ** 2).sum())
    scale = np.array([1.0, 1.0, 1 / rings[-1], 1 / rings[-1]])
    found = least_squares(lambda p: misfit(p * scale), best / scale, xtol=1e-7, max_nfev=50)
    return found.x * scale


def _place_of_bars(group):
    """Where the group lies in the image."""
    period, bars = group["period_px"], group["bars"]
    turn = np.radians(group["angle_deg"])
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    low = np.array([group["x_px"], group["y_px"]]) - across * (bars - 0.5) * period / 2
    low -= along * BAR_PERIODS * period / 2
    matrix = np.vstack([np.column_stack([across, along, low]), [0, 0, 1]])
    return ChartMap(matrix, source="group of bars")
