"""The modulation transfer function (MTF) from straight edges, ISO 12233's edge method.

Two estimates stand side by side. The *value* describes the edge as a square pixel convolved with
three concentric Gaussians of free weights, on all pixels at once, plus a smooth deviation where the
residuals show one. The *binned* one is the standard's: supersampled edge profile, derivative,
window, Fourier transform. It is noisier; where both differ, the answer says so.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count
from mmqa_lab._results import Shown
from mmqa_lab.chart_image.levels import check_image
from mmqa_lab.mtf.spread import (
    BINS_PER_PIXEL,
    bin_means,
    crossing,
    deviation,
    spread_edge,
)

FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

WIDTH_RATIO = 1.6
"""Between neighbours of the three Gaussians; the middle one is the best single Gaussian."""

PIXEL_SIGMA = 12**-0.5

SIGMAS_PX = (0.15, 12.0)
"""Limits of the single Gaussian that begins the fit."""

LARGEST_DISAGREEMENT = 0.05
"""Between the MTF50 of both estimates, relative; beyond, a remark."""

SMALLEST_SIGNAL = 8.0
"""Contrast times the square root of the rows over noise, below which there is no edge."""

SMALLEST_ANGLE_DEG = 3.0


@dataclass(frozen=True, eq=False)
class EdgeResponse(Shown):
    """The spatial frequency response across one edge.

    Parameters
    ----------
    mtf50, mtf50_sigma : float
        Frequency at which the MTF is 0.5, and its standard deviation, cycles per pixel. NaN where
        the MTF does not fall to 0.5 below 1 cycle per pixel.
    mtf50_binned : float
        The same by the standard's binning; NaN where the edge does not cover the phases.
    mtf10 : float
        Frequency at which the MTF is 0.1.
    sigma_px : float
        Standard deviation of the best single Gaussian, pixels, without the pixel itself.
    angle_deg : float
        Between the edge and the nearer axis of the image.
    contrast, noise : float
        Step of the edge and standard deviation of the residuals, in the image's unit.
    n : int
        Pixels used.
    frequencies, mtf, mtf_binned : array
        Cycles per pixel and transfer.
    remark : str
        What speaks against the value; empty if nothing does.

    Examples
    --------
    >>> from mmqa_lab.mtf.spread import spread_edge
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = edge_response(spread_edge(distance, 0.7, np.arctan(0.1)))
    >>> round(edge.sigma_px, 2), edge.remark
    (0.7, '')
    """

    mtf50: float
    mtf50_sigma: float
    mtf50_binned: float
    mtf10: float
    sigma_px: float
    angle_deg: float
    contrast: float
    noise: float
    n: int
    frequencies: np.ndarray
    mtf: np.ndarray
    mtf_binned: np.ndarray
    remark: str = ""

    def to_frame(self) -> pd.DataFrame:
        """Return ``frequency_per_px``, ``mtf``, ``mtf_binned``, one row a frequency."""
        curves = {"mtf": self.mtf, "mtf_binned": self.mtf_binned}
        return pd.DataFrame({"frequency_per_px": self.frequencies, **curves})


def edge_response(image, *, order: int = 1) -> EdgeResponse:
    """Measure the MTF of an image that shows one straight edge.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light: two plain sides and one edge that runs through from side to side.
    order : int
        Degree of the polynomial along the edge: 2 for edges bent by distortion.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If the image is too small or shows no edge that stands out from its noise.

    Notes
    -----
    The grey values must be linear in light: a display curve changes the MTF. An edge along the
    pixel grid has one phase only; then the binned estimate is NaN and the fit interpolates by its
    model. Sharpening raises MTF50 without showing more detail.

    References
    ----------
    ISO 12233:2023, edge-based spatial frequency response; van den Bergh 2018,
    doi:10.1364/JOSAA.35.000442 on the accuracy of slanted edges.

    Examples
    --------
    >>> from mmqa_lab.mtf.spread import spread_edge
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = edge_response(spread_edge(distance, 1.0, np.arctan(0.1)))
    >>> round(edge.mtf50, 3), round(edge.angle_deg, 1)
    (0.18, 5.7)
    """
    image = check_image(image)
    order = check_count(order, "order")
    if min(image.shape) < 10:
        raise ValueError(f"Invalid edge of {image.shape} pixels. Must be 10 x 10 or larger.")
    if _steepness(image.T) > _steepness(image):
        image = image.T
    if image[:, -3:].mean() < image[:, :3].mean():
        image = image[:, ::-1]
    place, rows, columns = _edge_line(image, order)
    slope = np.polyval(np.polyder(place), 0.0)
    angle = np.arctan(slope)
    distance = (columns[None, :] - np.polyval(place, rows)[:, None]) * np.cos(angle)
    along = np.broadcast_to((rows / np.abs(rows).max())[:, None], image.shape)
    return response(distance.ravel(), along.ravel(), image.ravel(), angle, order=order)


def response(distance, along, values, angle, *, order=1, width=np.inf, terms=3):
    """Measure the MTF from pixels at known distances from an edge, or from a bar's two edges.

    Parameters
    ----------
    distance : array, shape (n,)
        Of the pixels' centres from the edge along its normal, pixels; approximate, a polynomial
        correction along the edge is fitted.
    along : array, shape (n,)
        Place along the edge, -1 to 1.
    values : array, shape (n,)
        Linear light; rises with the distance across the edge.
    angle : float
        Of the normal against the nearer image axis, radians.
    order : int
        Degree of the correction.
    width : float
        Distance to a second, opposite edge, pixels; infinite for a single edge.
    terms : {1, 3}
        Gaussians in the fit.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If no edge stands out from the noise.
    """
    single = not np.isfinite(width)
    shift, sigma = _single_gaussian(distance, along, values, angle, order, width)
    reach = 12 * np.hypot(sigma, PIXEL_SIGMA) + 6
    near = np.abs(distance - np.clip(distance, 0, 0 if single else width)) <= reach
    distance, along, values = distance[near], along[near], values[near]
    powers = np.arange(terms) - (terms - 1) / 2
    fit = _Fit(sigma * WIDTH_RATIO**powers, angle, order, width)
    for _ in range(4):
        moved = distance - np.polyval(shift, along)
        step = fit.improve(moved, along, values)
        shift = shift + step
        if np.abs(step).max() < 1e-5:
            break
    moved = distance - np.polyval(shift, along)
    residuals = fit.residuals(moved, values)
    noise, contrast = float(np.std(residuals)), float(fit.weights.sum())
    if not contrast * np.sqrt(len(values) / (2 * reach)) > SMALLEST_SIGNAL * noise:
        raise ValueError(
            f"Invalid edge: a step of {contrast:.3g} at a noise of {noise:.3g}. Must stand out."
        )
    extra, binned = None, np.full(len(FREQUENCIES), np.nan)
    if single and terms > 1:
        extra = deviation(moved, residuals, contrast, np.hypot(sigma, PIXEL_SIGMA), reach)
        noise = float(np.sqrt(bin_means(moved, residuals, reach)[2]))
        binned = _binned_mtf(moved, values, reach)
    mtf = np.abs(_transfer(fit, extra, FREQUENCIES))
    mtf = mtf / mtf[0]
    mtf50, binned50 = (crossing(FREQUENCIES, curve, 0.5) for curve in (mtf, binned))
    return EdgeResponse(
        mtf50=mtf50,
        mtf50_sigma=_mtf50_sigma(mtf50, fit, extra),
        mtf50_binned=binned50,
        mtf10=crossing(FREQUENCIES, mtf, 0.1),
        sigma_px=sigma,
        angle_deg=float(abs(np.degrees(angle))),
        contrast=contrast,
        noise=noise,
        n=len(values),
        frequencies=FREQUENCIES,
        mtf=mtf,
        mtf_binned=binned,
        remark=_remark(mtf50, binned50, angle, mtf, terms),
    )


def _steepness(image):
    """How clearly the mean row of an image shows an edge."""
    return np.abs(np.diff(image.mean(axis=0))).max()


def _edge_line(image, order):
    """Polynomial column(row) of the edge, both counted from the middle, and those coordinates."""
    import cv2

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
        if clear.sum() < max(5, order + 2) or not total.max() > 0:
            raise ValueError("Invalid image: no edge from side to side. Must show one.")
        centre = (weight @ between)[clear] / total[clear]
        line = np.polyfit(rows[clear], centre, order)
    return line, rows, columns


def _profile(distance, sigma, angle, width):
    """An edge, or a bar of the given width, as a pixel sees it."""
    rising = spread_edge(distance, sigma, angle)
    if not np.isfinite(width):
        return rising
    return rising - spread_edge(distance - width, sigma, angle)


def _single_gaussian(distance, along, values, angle, order, width):
    """Correction of the distances along the edge, and the width of the best single Gaussian."""
    from scipy.optimize import least_squares

    def residuals(parameters):
        moved = distance - np.polyval(parameters[:-1], along)
        shape = _profile(moved, np.exp(parameters[-1]), angle, width)
        design = np.column_stack([np.ones_like(shape), shape])
        fit = np.linalg.lstsq(design, values, rcond=None)[0]
        return values - design @ fit

    low, high = np.log(SIGMAS_PX)
    bounds = np.array([[-5.0] * (order + 1) + [low], [5.0] * (order + 1) + [high]])
    start = np.concatenate([np.zeros(order + 1), [0.0]])
    scale = max(float(np.ptp(values)), 1e-12) / 10
    found = least_squares(
        residuals, start, bounds=bounds, diff_step=1e-4, f_scale=scale, loss="soft_l1", xtol=1e-7
    )
    return found.x[:-1], float(np.exp(found.x[-1]))


class _Fit:
    """Concentric Gaussians of free weights behind a square pixel, and the place of the edge."""

    def __init__(self, sigmas, angle, order, width):
        self.sigmas, self.angle, self.order, self.width = sigmas, angle, order, width

    def _shapes(self, distance):
        """Profiles of the Gaussians."""
        profiles = [_profile(distance, sigma, self.angle, self.width) for sigma in self.sigmas]
        return np.stack(profiles, axis=1)

    def improve(self, distance, along, values):
        """One step of the joint least-squares fit; returns the correction of the edge's place."""
        ones, step = np.ones((len(distance), 1)), 1e-3
        design = np.hstack([ones, self._shapes(distance)])
        weights = np.linalg.lstsq(design, values, rcond=None)[0][1:]
        slope = (self._shapes(distance + step) - self._shapes(distance - step)) @ weights
        powers = along[:, None] ** np.arange(self.order, -1, -1)
        joint = np.hstack([design, -slope[:, None] / (2 * step) * powers])
        if len(self.sigmas) == 1:
            wider = _profile(distance, self.sigmas[0] * (1 + step), self.angle, self.width)
            joint = np.column_stack([joint, (wider - design[:, 1]) * weights[0] / step])
        fit = np.linalg.lstsq(joint, values, rcond=None)[0]
        residuals = values - joint @ fit
        variance = residuals @ residuals / max(len(values) - len(fit), 1)
        terms = slice(1, 1 + len(self.sigmas))
        self.weights = fit[terms]
        covariance = np.linalg.pinv(joint.T @ joint) * variance
        self.covariance, self.log_sigma_variance = covariance[terms, terms], covariance[-1, -1]
        place = slice(terms.stop, terms.stop + self.order + 1)
        return fit[place]

    def residuals(self, distance, values):
        """What is left after weights are fitted at these distances."""
        design = np.hstack([np.ones((len(distance), 1)), self._shapes(distance)])
        return values - design @ np.linalg.lstsq(design, values, rcond=None)[0]

    def transfer(self, frequencies):
        """The matrix that takes weights to the optical transfer function."""
        pixel = np.sinc(frequencies * np.cos(self.angle)) * np.sinc(
            frequencies * np.sin(self.angle)
        )
        spread = np.exp(-2 * (np.pi * frequencies[:, None] * self.sigmas) ** 2)
        return spread * pixel[:, None]


def _transfer(fit, extra, frequencies):
    """The optical transfer function of fit and deviation, not yet 1 at zero."""
    found = fit.transfer(frequencies) @ fit.weights
    return found if extra is None else found + extra.transfer(frequencies) @ extra.values


def _mtf50_sigma(mtf50, fit, extra):
    """Standard deviation of MTF50, to first order in weights and deviation."""
    if not np.isfinite(mtf50):
        return np.nan
    if len(fit.sigmas) == 1:
        # in frequencies relative to the Gaussian's width; the pixel itself does not vary
        pixel = np.hypot(1, PIXEL_SIGMA / fit.sigmas[0])
        return float(mtf50 * np.sqrt(fit.log_sigma_variance) / pixel**2)
    at = np.array([0.0, mtf50, mtf50 + 1e-4])
    zero, here, next_one = _transfer(fit, extra, at)
    slope = (abs(next_one) - abs(here)) / abs(zero) / 1e-4
    variance = 0.0
    for part in (fit, extra):
        if part is None or part.covariance is None:
            continue
        matrix = part.transfer(at[:2])
        turned = np.real(np.conj(here) / abs(here) * matrix[1]) - 0.5 * np.real(
            np.conj(zero) / abs(zero) * matrix[0]
        )
        variance += turned @ part.covariance @ turned / abs(zero) ** 2
    return float(np.sqrt(max(variance, 0)) / abs(slope)) if slope else np.nan


def _binned_mtf(distance, values, reach):
    """The standard's estimate: bins of a quarter pixel, derivative, window, Fourier transform."""
    count, means, _ = bin_means(distance, values, reach)
    middle = len(count) // 2
    if (count == 0).mean() > 0.1 or (count[middle - 8 : middle + 9] == 0).any():
        return np.full(len(FREQUENCIES), np.nan)
    bins = np.arange(len(count))
    profile = np.interp(bins, bins[count > 0], means[count > 0])
    # a quarter of the window at each end falls off as a cosine
    window = np.clip(2 * (1 - np.abs(bins - middle) / (middle + 1)), 0, 1)
    spread = np.gradient(profile) * np.sin(np.pi / 2 * window) ** 2
    waves = np.exp(-2j * np.pi * FREQUENCIES[:, None] * (bins - middle) / BINS_PER_PIXEL)
    steps = FREQUENCIES / BINS_PER_PIXEL
    # ISO 12233 takes out the central difference; the bins' width likewise
    transfer = np.abs(waves @ spread) / (np.sinc(2 * steps) * np.sinc(steps))
    return transfer / transfer[0]


def _remark(mtf50, binned50, angle, mtf, terms):
    """What speaks against a value."""
    remarks = []
    if not np.isfinite(mtf50):
        remarks.append("MTF stays above 0.5")
    if abs(np.degrees(angle)) < SMALLEST_ANGLE_DEG:
        remarks.append(f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid")
    if np.isfinite(binned50) and abs(binned50 / mtf50 - 1) > LARGEST_DISAGREEMENT:
        remarks.append("fit and binning differ")
    if terms == 1:
        remarks.append("taken for Gaussian")
    if mtf.max() > 1.05:
        remarks.append("sharpened")
    return "; ".join(remarks)
