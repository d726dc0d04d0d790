"""Edges: the standard's bins, and sigmoids of one width.

The estimate of ISO 12233 is the default: pixels in bins of a quarter pixel over their distance from
the edge, derivative, window, Fourier transform. Beside it stand sigmoids with one width, as in
EuroSDR 2013, image radiometry, section 5.1 and Table 4 (the report does not print the shape of its
sigmoid): a square pixel behind a Gaussian, and the logistic function.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import expit

from mmqa_lab._checks import check_choice, check_image, refuse
from mmqa_lab._results import Shown, about
from mmqa_lab.mtf.edge_bins import binned, of_bins, profile, window
from mmqa_lab.mtf.edge_doubts import check, remark_on
from mmqa_lab.mtf.transfer import FREQUENCIES, SIGMOID_PX, crossing, spread_edge

__all__ = ["EdgeResponse", "fit_edge"]
__dir__ = __all__.copy


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
    crooked, second = check(fit, len(rows), image.shape[1])
    seen = _by_bins(fit) if method == "binned" else _by_sigmoid(fit)
    known = {"width_px": fit.width, "angle_deg": turn, "n": len(fit.values)}
    remark = remark_on(fit, turn, seen["mtf50"], crooked, second, method != "binned")
    return EdgeResponse(frequencies=FREQUENCIES, remark=remark, **known, **seen)


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
        self.places, self.means, self.count, _ = profile(self.distance, values)
        self.noise = float(np.sqrt(profile(self.distance, self.residuals)[3]))
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

    @property
    def spread(self):
        """Standard deviation of the edge's Gaussian and the pixel together."""
        return np.hypot(self.width, 12**-0.5)

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
    transfer, places, lsf = binned(fit.distance, fit.values)
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
    terms = np.exp(-2j * np.pi * mtf50 * places) * window(places)
    weight = np.abs(np.gradient(terms)) / np.sqrt(2)
    near = np.abs(FREQUENCIES - mtf50) < max(0.02, mtf50 / 6)
    slope = np.polyfit(FREQUENCIES[near], mtf[near], 1)[0]
    of_transfer = noise * np.sqrt(np.sum(weight**2 / count)) / of_bins(mtf50)
    # besides noise, bins err by .2 %
    return float(np.hypot(of_transfer / abs(slope), 0.002 * mtf50))


def _fwhm(places, lsf):
    """Full width at half maximum, between straight lines."""
    top = int(lsf.argmax())
    left, right = (crossing(places[top::way], lsf[top::way], lsf[top] / 2) for way in (-1, 1))
    return right - left


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
