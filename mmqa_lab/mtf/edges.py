"""Resolution from straight edges: ISO 12233 and sigmoids.

The standard's estimate is the default: pixels in bins of a quarter pixel over their distance from
the edge, derivative, window, Fourier transform. Beside it stand sigmoids with one width, as in
EuroSDR 2013, image radiometry, section 5.1 and Table 4 (the report does not print the shape of its
sigmoid): a square pixel behind a Gaussian, and the logistic function. Lengths in pixels,
frequencies in cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import expit, ndtr

from mmqa_lab._checks import check_choice, check_image
from mmqa_lab._results import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHODS = ("binned", "sigmoid", "logistic")

FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

BINS_PER_PIXEL, BLOCKS = 4, 8
"""Bins of the edge profile; blocks of rows that are left out in turn for the interval."""

SIGMAS_PX = (0.15, 12.0)
"""Limits of a sigmoid's width."""

SMALLEST_SIGNAL = 8.0
"""Contrast times the square root of the rows over noise, below which there is no edge."""

SMALLEST_ANGLE_DEG = 3.0

STRANGE = 0.25
"""Share of the step by which the profile may leave the best sigmoid: more are two edges."""


@dataclass(frozen=True, eq=False)
class EdgeResponse(Shown):
    """What one edge tells: the modulation transfer function (MTF) and the widths that go with it.

    Parameters
    ----------
    method : str
        See :func:`fit_edge`.
    mtf50, mtf50_sigma : float
        Frequency at which the MTF is 0.5, and its standard deviation, cycles per pixel. NaN where
        the MTF does not fall to 0.5 below 1 cycle per pixel, or the bins are not filled.
    mtf10 : float
        Frequency at which the MTF is 0.1.
    fwhm_px : float
        Full width at half maximum of the line spread function.
    width_px : float
        Standard deviation of the best single Gaussian, without the pixel itself; of a logistic its
        scale.
    angle_deg : float
        Between the edge and the nearer axis of the image.
    contrast, noise : float
        Step of the edge and standard deviation of the residuals, in the image's unit.
    n : int
        Pixels used.
    frequencies, mtf : array
        Cycles per pixel and transfer.
    distance_px, esf, lsf : array
        The edge and line spread functions over the distance across the edge.
    remark : str
        What speaks against the value; empty if nothing does.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = fit_edge(spread_edge(distance, 0.7, np.arctan(0.1)))
    >>> round(edge.width_px, 2), edge.remark
    (0.7, '')
    """

    method: str
    mtf50: float
    mtf50_sigma: float
    mtf10: float
    fwhm_px: float
    width_px: float
    angle_deg: float
    contrast: float
    noise: float
    n: int
    frequencies: np.ndarray
    mtf: np.ndarray
    distance_px: np.ndarray
    esf: np.ndarray
    lsf: np.ndarray
    remark: str = ""

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the MTF, and MTF50 with its 95 % interval."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        ax.plot(self.frequencies, self.mtf)
        ax.errorbar(self.mtf50, 0.5, xerr=1.96 * self.mtf50_sigma, fmt="o", ms=3, capsize=2)
        ax.set(xlabel="frequency (cycles/px)", ylabel="contrast (MTF)", xlim=(0, 1))
        return ax


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
    check_choice(method, "method", METHODS)
    image = check_image(image)
    if min(image.shape) < 10:
        raise ValueError(f"Invalid edge of {image.shape} pixels. Must be 10 x 10 or larger.")
    image = _rising(image)
    place, rows, columns = _edge_line(image)
    angle = np.arctan(place[0])
    distance = (columns[None, :] - np.polyval(place, rows)[:, None]) * np.cos(angle)
    along = np.broadcast_to((rows / np.abs(rows).max())[:, None], image.shape)
    block = np.broadcast_to((np.arange(len(rows)) * BLOCKS // len(rows))[:, None], image.shape)
    shape = _logistic if method == "logistic" else _gaussian
    fit = _Sigmoid(distance.ravel(), along.ravel(), image.ravel(), angle, shape)
    fit.check(len(rows))
    seen = _by_bins(fit, block.ravel()) if method == "binned" else _by_sigmoid(fit)
    mtf50 = seen.pop("mtf50")
    doubts = {
        "MTF stays above 0.5": not np.isfinite(mtf50),
        f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid": abs(np.degrees(angle))
        < SMALLEST_ANGLE_DEG,
        "no sigmoid of this shape fits": method != "binned" and fit.strange() > 0.02,
        "sharpened": seen["mtf"].max() > 1.05,
    }
    return EdgeResponse(
        method=method,
        mtf50=mtf50,
        mtf10=crossing(FREQUENCIES, seen["mtf"], 0.1),
        width_px=fit.width,
        angle_deg=float(abs(np.degrees(angle))),
        contrast=fit.contrast,
        noise=fit.noise,
        n=len(fit.values),
        frequencies=FREQUENCIES,
        remark="; ".join(text for text, true in doubts.items() if true),
        **seen,
    )


class _Sigmoid:
    """The sigmoid of one width that fits best, and the distances that go with it."""

    def __init__(self, distance, along, values, angle, shape):
        self.angle, self.shape, self.rows = angle, shape, np.arange(len(values))
        start = np.array([0.0, 0.0, 0.0])
        for reach in (60.0, None):
            near = np.abs(distance) <= (reach or 24 * np.hypot(self.width, 0.3) + 6)
            distance, along, values = distance[near], along[near], values[near]
            self.rows = self.rows[near]

            def residuals(known, distance=distance, along=along, values=values):
                return values - self._levels(known, distance, along, values)

            scale = max(float(np.ptp(values)), 1e-12) / 10
            low, high = np.log(SIGMAS_PX)
            ends = [-5, -5, low], [5, 5, high]
            how = {"bounds": ends, "loss": "soft_l1", "f_scale": scale, "x_scale": [1, 1, 0.3]}
            found = least_squares(residuals, start, **how)
            start, self.width = found.x, float(np.exp(found.x[2]))
        self.distance, self.values = distance - np.polyval(start[:2], along), values
        step = self._step(self.distance, self.width)
        self.low, self.contrast = map(float, np.linalg.lstsq(step, values, rcond=None)[0])
        self.residuals = values - step @ [self.low, self.contrast]
        self.noise = float(np.sqrt(_bins(self.distance, self.residuals)[2]))
        covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.mean(self.residuals**2)
        self.log_width_sigma = float(np.sqrt(covariance[2, 2]))

    def _step(self, distance, width):
        """Design of a level and a step."""
        shape = self.shape(distance, width, self.angle)
        return np.column_stack([np.ones_like(shape), shape])

    def _levels(self, known, distance, along, values):
        """What the sigmoid of these numbers shows, its levels by least squares."""
        step = self._step(distance - np.polyval(known[:2], along), np.exp(known[2]))
        return step @ np.linalg.lstsq(step, values, rcond=None)[0]

    def strange(self):
        """Largest share of the step by which the binned profile leaves the sigmoid."""
        count, means, variance = _bins(self.distance, self.residuals)
        noise = np.sqrt(variance / np.maximum(count, 1))
        return float((np.abs(means) - 4 * noise)[count > 0].max() / self.contrast)

    def check(self, rows):
        """Raise where there is no edge, or more than one."""
        if not self.contrast * np.sqrt(rows) > SMALLEST_SIGNAL * self.noise:
            raise ValueError(
                f"Invalid edge: a step of {self.contrast:.3g} at a noise of {self.noise:.3g}. Must "
                "stand out."
            )
        if self.strange() > STRANGE:
            raise ValueError(
                f"Invalid edge: the profile leaves a single step by {self.strange():.0%} of it. "
                "Must show one edge between two plain sides."
            )


def _gaussian(distance, width, angle):
    return spread_edge(distance, width, angle)


def _logistic(distance, width, angle):
    return expit(distance / width)


def _by_sigmoid(fit):
    """MTF and profiles of the fitted sigmoid."""
    places = np.arange(-1, 1.0001, 1 / 256) * (12 * np.hypot(fit.width, 0.3) + 2)
    esf = fit.shape(places, fit.width, fit.angle)

    def of_width(width):
        lsf = np.gradient(fit.shape(places, width, fit.angle), places)
        waves = np.cos(2 * np.pi * FREQUENCIES[:, None] * places)
        return lsf, waves @ lsf / lsf.sum()

    lsf, mtf = of_width(fit.width)
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    change = 1000 * (crossing(FREQUENCIES, of_width(1.001 * fit.width)[1], 0.5) - mtf50)
    known = {"distance_px": places, "esf": esf, "lsf": lsf, "mtf": mtf, "mtf50": mtf50}
    return known | {"mtf50_sigma": abs(change) * fit.log_width_sigma, "fwhm_px": _fwhm(places, lsf)}


def _by_bins(fit, block):
    """MTF and profiles by the standard's binning; the interval from leaving out blocks of rows."""
    mtf, places, esf, lsf = _binned(fit.distance, fit.values)
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    parts = block[fit.rows]
    left = [
        crossing(FREQUENCIES, _binned(fit.distance[parts != k], fit.values[parts != k])[0], 0.5)
        for k in range(BLOCKS)
    ]
    # 2.36 is Student's quantile of seven degrees of freedom
    sigma = float(np.sqrt((BLOCKS - 1) * np.var(left))) * 2.365 / 1.96
    known = {"distance_px": places, "esf": (esf - fit.low) / fit.contrast, "mtf": mtf}
    lsf = lsf / np.trapezoid(lsf, places)
    # noise outlives the signal: from a tenth of the contrast on a Gaussian takes its place
    mtf10 = crossing(FREQUENCIES, mtf, 0.1)
    tail = np.exp(np.log(0.1) * (FREQUENCIES / mtf10) ** 2)
    known_mtf = np.where(FREQUENCIES < mtf10, mtf, tail)
    fine = np.linspace(-20, 20, 4001)
    waves = np.cos(2 * np.pi * fine[:, None] * FREQUENCIES)
    spread = np.trapezoid(waves * known_mtf, FREQUENCIES, axis=1)
    fwhm = _fwhm(fine, spread) if np.isfinite(mtf50) else np.nan
    return known | {"lsf": lsf, "mtf50": mtf50, "mtf50_sigma": sigma, "fwhm_px": fwhm}


def _bins(distance, values):
    """Counts and means in bins of a quarter pixel, and the variance within them."""
    place = np.round(distance * BINS_PER_PIXEL).astype(int)
    place -= place.min()
    count = np.bincount(place)
    means = np.bincount(place, weights=values) / np.maximum(count, 1)
    free = max((np.maximum(count, 1) - 1).sum(), 1)
    return count, means, float(((values - means[place]) ** 2).sum() / free)


def _binned(distance, values):
    """Transfer, places, edge profile and its derivative; NaN where bins at the edge are empty."""
    count, means, _ = _bins(distance, values)
    first = np.round(distance.min() * BINS_PER_PIXEL)
    places = (np.arange(len(count)) + first) / BINS_PER_PIXEL
    filled = count > 0
    centres = _bins(distance, distance)[1]  # pixels do not fill a bin evenly
    profile = np.interp(places, centres[filled], means[filled])
    half = min(-places[0], places[-1])
    # the ends of the window fall off as a cosine; what they cut of long tails raises the transfer
    window = np.clip(10 * (1 - np.abs(places) / half), 0, 1)
    spread = np.gradient(profile, places) * np.sin(np.pi / 2 * window) ** 2
    waves = np.exp(-2j * np.pi * FREQUENCIES[:, None] * places)
    steps = FREQUENCIES / BINS_PER_PIXEL
    # ISO 12233 takes out the central difference; the bins' width likewise
    transfer = np.abs(waves @ spread) / (np.sinc(2 * steps) * np.sinc(steps))
    if (~filled).mean() > 0.1 or not filled[np.abs(places) <= 2].all():
        transfer = np.full(len(FREQUENCIES), np.nan)
    return transfer / transfer[0], places, profile, spread


def _fwhm(places, lsf):
    """Full width at half maximum, between straight lines."""
    half, top = lsf.max() / 2, int(lsf.argmax())
    right = top + int(np.argmax(lsf[top:] < half))
    left = top - int(np.argmax(lsf[top::-1] < half))
    ends = [
        places[a] + (lsf[a] - half) / (lsf[a] - lsf[b]) * (places[b] - places[a])
        for a, b in ((left + 1, left), (right - 1, right))
    ]
    return float(ends[1] - ends[0])


def spread_edge(distance, sigma, angle):
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
    wide, narrow = np.sort(np.abs([np.cos(angle), np.sin(angle)]))[::-1]
    distance = np.asarray(distance, dtype=float)
    if narrow < 1e-3:
        ramp = _integral(distance + wide / 2, sigma) - _integral(distance - wide / 2, sigma)
        return ramp / wide
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    bend = [_double_integral(distance + place, sigma) for place in (outer, inner, -inner, -outer)]
    return (bend[0] - bend[1] - bend[2] + bend[3]) / (wide * narrow)


def crossing(frequencies, mtf, level):
    """Return the first frequency at which an MTF falls below a level, NaN where it does not."""
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


def _integral(x, sigma):
    """The first antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


def _double_integral(x, sigma):
    """The second antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma**2 / 2 * ((z**2 + 1) * ndtr(z) + z * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))
