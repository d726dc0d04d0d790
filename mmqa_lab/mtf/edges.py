"""Resolution from straight edges: ISO 12233 and sigmoids.

An edge is described as a square pixel convolved with three concentric Gaussians of free weights,
plus a smooth deviation where the residuals show one (``isogaussian``), or by a sigmoid with one
width, as in EuroSDR 2013, image radiometry, section 5.1 and Table 4 (``sigmoid``, ``logistic``; the
report does not print the shape of its sigmoid). All pixels are fitted at once. Beside them stands
the standard's own estimate: supersampled edge profile, derivative, window, Fourier transform. It is
noisier; where both differ, the answer says so. Lengths in pixels, frequencies in cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, j1, ndtr

from mmqa_lab._checks import check_choice, check_image
from mmqa_lab._results import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHODS = ("isogaussian", "sigmoid", "logistic", "lens")

LENSES = {"gaussian": 1.0, "disc": 0.55, "diffraction": 0.45}
"""Point spreads that ``lens`` chooses from: deviation of a Gaussian of about the same MTF50 over
their width, which is the disc's radius and one over the highest frequency in diffraction."""

SHARPENED = 0.97
"""Three free Gaussians take a lens's place if their residuals are so much smaller."""

PIXELS_A_RESIDUAL = 20
"""Residuals of print and light are alike in so many pixels."""

FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

WIDTH_RATIO = 1.6
"""Between neighbours of the three Gaussians; the middle one is the best single Gaussian."""

PIXEL_SIGMA = 12**-0.5

SIGMAS_PX = (0.15, 12.0)
"""Limits of the single width that begins the fit."""

FIRST_PIXELS, FIRST_REACH_PX = 1500, 60.0
"""So many pixels, no farther off the edge, give the first, robust values of a fit."""

LENS_PIXELS = 3000
"""About so many pixels, spread evenly, tell one lens from another."""

LARGEST_GAP_ERROR_PX = 1.0

LARGEST_DISAGREEMENT = 0.05
"""Between the MTF50 of fit and binning, relative; beyond, a remark."""

SMALLEST_SIGNAL = 8.0
"""Contrast times the square root of the rows over noise, below which there is no edge."""

SMALLEST_ANGLE_DEG = 3.0

BINS_PER_PIXEL = 4

ENVELOPE = 8.0
"""Deviations die away with the distance from the edge on this many of its widths."""

LENGTHS = (0.5, 0.8, 1.3, 2.2, 4.0)
"""Lengths over which deviations are smooth, in widths of the edge."""

SIZES = np.geomspace(5e-4, 0.3, 14)
"""Sizes of deviations, as shares of the step."""

EVIDENCE = 2.0
"""Logarithm of the likelihood ratio above which deviations are taken for real."""


@dataclass(frozen=True, eq=False)
class EdgeResponse(Shown):
    """What one edge tells: the modulation transfer function (MTF) and the widths that go with it.

    Parameters
    ----------
    method : str
        See :func:`fit_edge`.
    mtf50, mtf50_sigma : float
        Frequency at which the MTF is 0.5, and its standard deviation, cycles per pixel. NaN where
        the MTF does not fall to 0.5 below 1 cycle per pixel.
    mtf50_binned : float
        The same by the standard's binning; NaN where the edge does not cover the phases.
    mtf10 : float
        Frequency at which the MTF is 0.1.
    fwhm_px : float
        Full width at half maximum of the fitted line spread function.
    width_px : float
        Standard deviation of the best single Gaussian, without the pixel itself, or of one about as
        wide as the lens; of a logistic its scale.
    angle_deg : float
        Between the edge and the nearer axis of the image.
    contrast, noise : float
        Step of the edge and standard deviation of the residuals, in the image's unit.
    n : int
        Pixels used.
    frequencies, mtf, mtf_binned : array
        Cycles per pixel and transfer.
    distance_px, esf, lsf : array
        The fitted edge and line spread functions over the distance across the edge.
    remark : str
        What speaks against the value; empty if nothing does.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = fit_edge(spread_edge(distance, 0.7, np.arctan(0.1)))
    >>> round(edge.width_px, 2), round(edge.fwhm_px, 2), edge.remark
    (0.7, 1.79, '')
    """

    method: str
    mtf50: float
    mtf50_sigma: float
    mtf50_binned: float
    mtf10: float
    fwhm_px: float
    width_px: float
    angle_deg: float
    contrast: float
    noise: float
    n: int
    frequencies: np.ndarray
    mtf: np.ndarray
    mtf_binned: np.ndarray
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


def fit_edge(image: ArrayLike, *, method: str = "isogaussian") -> EdgeResponse:
    """Measure the resolution of an image that shows one straight edge.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Linear light: two plain sides and one edge that runs through from side to side; 10 x 10
        pixels or more.
    method : {"isogaussian", "sigmoid", "logistic", "lens"}
        Three Gaussians and a smooth deviation, which follow any profile; one Gaussian behind the
        square pixel; the plain logistic function 1 / (1 + exp(-d / w)), whose line spread function
        has longer tails; or that of a Gaussian, a defocused disc and a lens limited by diffraction
        which fits best, for edges with little ground beside them, where tails are not seen.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If the method is another, the image is too small or shows no edge that stands out from its
        noise.

    Notes
    -----
    The grey values must be linear in light: a display curve changes the MTF. An edge along the
    pixel grid has one phase only; then the binned estimate is NaN and the fit interpolates by its
    model. Sharpening raises MTF50 without showing more detail. A sigmoid cannot overshoot, and
    where the optics are no Gaussian it is wrong by some per cent more than its standard deviation;
    the remark then says that it does not fit.

    References
    ----------
    ISO 12233:2023, edge-based spatial frequency response; van den Bergh 2018,
    doi:10.1364/JOSAA.35.000442 on the accuracy of slanted edges. EuroSDR 2013, image radiometry,
    section 5.1.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> seen = spread_edge(distance, 1.0, np.arctan(0.1))
    >>> edge = fit_edge(seen)
    >>> round(edge.mtf50, 3), round(edge.angle_deg, 1)
    (0.18, 5.7)
    >>> round(fit_edge(seen, method="sigmoid").mtf50, 3)
    0.18
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
    pixels = distance.ravel(), along.ravel(), image.ravel()
    return fit_pixels(*pixels, angle, method=method)


def fit_pixels(distance, along, values, angle, *, order=1, gap=np.inf, method="isogaussian"):
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
    gap : float or array, shape (n,)
        Distance to a second, opposite edge, pixels; infinite for a single edge.
    method : {"isogaussian", "sigmoid", "logistic", "lens"}

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If no edge stands out from the noise.
    """
    if method == "lens":
        return one_lens([lens_fits(distance, along, values, angle, order=order, gap=gap)])[0]
    shape = method if method in ("logistic", *LENSES) else "gaussian"
    model = _Model(angle, gap, shape)
    off = np.abs(distance - np.clip(distance, 0, gap if model.double else 0))
    few = np.flatnonzero(off <= FIRST_REACH_PX)
    few = few[_spread_out(len(few), FIRST_PIXELS)]
    first = model.within(few, ())
    shift, width, wider = _single_width(first, distance[few], along[few], values[few], order)
    model.gap = model.gap + wider
    reach = 12 * np.hypot(width, PIXEL_SIGMA) + 6
    near = off <= reach
    distance, along, values = distance[near], along[near], values[near]
    model = model.within(near, width * WIDTH_RATIO ** np.arange(-1.0, 2.0))
    if method != "isogaussian":
        model.widths = np.array([width])
    for _ in range(4):
        step = model.improve(distance - np.polyval(shift, along), along, values, order)
        shift = shift + step
        if np.abs(step).max() < 1e-5:
            break
    moved = distance - np.polyval(shift, along)
    residuals = model.residuals(moved, values)
    noise, contrast = float(np.std(residuals)), float(model.weights.sum())
    if not contrast * np.sqrt(len(values) / (2 * reach)) > SMALLEST_SIGNAL * noise:
        raise ValueError(
            f"Invalid edge: a step of {contrast:.3g} at a noise of {noise:.3g}. Must stand out."
        )
    extra, binned = _Deviation(np.zeros(0), np.zeros(0), None), np.full(len(FREQUENCIES), np.nan)
    if not model.double:
        extra = _deviation(moved, residuals, contrast, np.hypot(width, PIXEL_SIGMA), reach)
        noise = float(np.sqrt(_bin_means(moved, residuals, reach)[2]))
        binned = _binned_mtf(moved, values, reach)
    parts = [model, extra] if method == "isogaussian" else [model]
    mtf = np.abs(_transfer(parts, FREQUENCIES))
    mtf = mtf / mtf[0]
    mtf50, binned50 = (crossing(FREQUENCIES, curve, 0.5) for curve in (mtf, binned))
    places, esf, lsf, fwhm = model.profile()
    unfit = method != "isogaussian" and extra.covariance is not None
    return EdgeResponse(
        method=method,
        mtf50=mtf50,
        mtf50_sigma=_mtf50_sigma(mtf50, parts),
        mtf50_binned=binned50,
        mtf10=crossing(FREQUENCIES, mtf, 0.1),
        fwhm_px=fwhm,
        width_px=float(model.widths[len(model.widths) // 2]) * LENSES.get(shape, 1.0),
        angle_deg=float(abs(np.degrees(angle))),
        contrast=contrast,
        noise=noise,
        n=len(values),
        frequencies=FREQUENCIES,
        mtf=mtf,
        mtf_binned=binned,
        distance_px=places,
        esf=esf,
        lsf=lsf,
        remark=_remark(mtf50, binned50, angle, mtf, unfit),
    )


def lens_fits(distance, along, values, angle, *, order=1, gap=np.inf):
    """Return the fits of an edge behind each of LENSES, and three free Gaussians at the end."""
    few = _spread_out(len(distance), LENS_PIXELS)
    gap = gap[few] if np.ndim(gap) else gap
    pixels = distance[few], along[few], values[few], angle
    return [fit_pixels(*pixels, order=order, gap=gap, method=one) for one in (*LENSES, METHODS[0])]


def one_lens(edges):
    """Return edges of one image, each with the :func:`lens_fits` of it, behind the lens whose fits
    leave least in all of them; MTF50 and deviation are those of all lenses, by how well they fit.
    """
    if not edges:
        return []
    cost = sum(fits[0].n * np.log([max(fit.noise, 1e-9) for fit in fits]) for fits in edges)
    cost, free = cost[:-1], cost[-1]
    best, count = int(cost.argmin()), sum(fits[0].n for fits in edges)
    if free < cost[best] + count * np.log(SHARPENED):
        return [replace(fits[-1], method="lens") for fits in edges]
    weights = np.exp((cost[best] - cost) / PIXELS_A_RESIDUAL)
    return [_mixed(fits, best, weights) for fits in edges]


def _mixed(fits, best, weights):
    """The best fit with MTF50 and deviation of all."""
    found, best = np.array([fit.mtf50 for fit in fits[:-1]]), fits[best]
    mean, sigma = best.mtf50, best.mtf50_sigma
    if np.isfinite(mean):
        mean, spread = weighted(found, np.where(np.isfinite(found), weights, 0))
        sigma = float(np.hypot(sigma, spread))
    return replace(best, method="lens", mtf50=mean, mtf50_sigma=sigma)


def _spread_out(count, most):
    """Numbers of some of the pixels; a whole step between them would take the same columns of each
    row."""
    return np.linspace(0, count - 1, min(count, most)).astype(int)


def weighted(values, weights):
    """Return the mean and the standard deviation of values with weights; those of none are 0."""
    weights = weights / weights.sum()
    values = np.where(weights > 0, values, 0.0)
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (values - mean) ** 2))


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


def _single_width(model, distance, along, values, order):
    """Correction of the distances along the edge, best width of a single profile, and by how much
    the gap to a second edge is wider than it was said to be."""
    from scipy.optimize import least_squares

    def residuals(parameters):
        moved = distance - np.polyval(parameters[: order + 1], along)
        one = _Model(model.angle, model.gap + parameters[-2], model.shape)
        shape = one.bar(moved, np.exp(parameters[-1]))
        design = np.column_stack([np.ones_like(shape), shape])
        fit = np.linalg.lstsq(design, values, rcond=None)[0]
        return values - design @ fit

    low, high = np.log(SIGMAS_PX)
    gap = LARGEST_GAP_ERROR_PX if model.double else 1e-9
    ends = np.array([5.0] * (order + 1) + [gap])
    bounds = np.append(-ends, low), np.append(ends, high)
    start = np.zeros(order + 3)
    scale = max(float(np.ptp(values)), 1e-12) / 10
    found = least_squares(
        residuals, start, bounds=bounds, diff_step=1e-4, f_scale=scale, loss="soft_l1", xtol=1e-7
    )
    return found.x[: order + 1], float(np.exp(found.x[-1])), float(found.x[-2])


def _disc(x):
    """Transfer of a defocused lens at cycles per radius."""
    turn = 2 * np.pi * np.maximum(x, 1e-9)
    return 2 * j1(turn) / turn


def _diffraction(x):
    """Transfer of a perfect lens at a share of its highest frequency."""
    x = np.minimum(x, 1)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2))


LENS_TRANSFERS = {
    "gaussian": lambda x: np.exp(-2 * (np.pi * x) ** 2),
    "disc": _disc,
    "diffraction": _diffraction,
}


def lens_mtf(shape, width, frequencies):
    """Return the transfer function of a lens and a square pixel, the mean of all directions."""
    turn = np.radians(np.arange(2.5, 45, 5))[:, None]
    f = np.ravel(frequencies)
    pixel = (np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))).mean(axis=0)
    return (LENS_TRANSFERS[shape](f * width) * pixel).reshape(np.shape(frequencies))


@cache
def _waves():
    """Frequencies, distances and the matrix that takes a transfer function to half an edge."""
    rates, places = np.arange(0, 5, 0.01), np.arange(0, 40, 0.05)
    waves = 2 * places[:, None] * np.sinc(2 * rates * places[:, None]) * 0.01
    waves[:, 0] /= 2
    return rates, places, waves


class _Model:
    """Concentric profiles of free weights behind a square pixel, and the place of the edge."""

    def __init__(self, angle, gap, shape, widths=()):
        self.angle, self.gap, self.shape, self.widths = angle, gap, shape, np.asarray(widths)
        self.double = bool(np.isfinite(gap).all())

    def within(self, used, widths):
        """The model with these widths for some of the pixels."""
        gap = self.gap[used] if np.ndim(self.gap) else self.gap
        return _Model(self.angle, gap, self.shape, widths)

    def edge(self, distance, width):
        """One edge as a pixel sees it."""
        if self.shape == "logistic":
            return expit(distance / width)
        if self.shape == "gaussian":
            return spread_edge(distance, width, self.angle)
        rates, places, waves = _waves()
        half = waves @ self._optics(rates, np.array([width]))[:, 0]
        return 0.5 + np.sign(distance) * np.interp(np.abs(distance), places, half)

    def bar(self, distance, width):
        """The edge, less the opposite one if there is one."""
        rising = self.edge(distance, width)
        return rising - self.edge(distance - self.gap, width) if self.double else rising

    def _shapes(self, distance):
        """Profiles of all widths."""
        return np.stack([self.bar(distance, width) for width in self.widths], axis=1)

    def improve(self, distance, along, values, order):
        """One step of the joint least-squares fit; returns the correction of the edge's place."""
        ones, step = np.ones((len(distance), 1)), 1e-3
        design = np.hstack([ones, self._shapes(distance)])
        weights = np.linalg.lstsq(design, values, rcond=None)[0][1:]
        slope = (self._shapes(distance + step) - self._shapes(distance - step)) @ weights
        powers = along[:, None] ** np.arange(order, -1, -1)
        joint = np.hstack([design, -slope[:, None] / (2 * step) * powers])
        if self.double:
            wider = _Model(self.angle, self.gap + step, self.shape, self.widths)._shapes(distance)
            joint = np.column_stack([joint, (wider - design[:, 1:]) @ weights / step])
        if len(self.widths) == 1:
            wider = self.bar(distance, self.widths[0] * (1 + step))
            joint = np.column_stack([joint, (wider - design[:, 1]) * weights[0] / step])
        fit = np.linalg.lstsq(joint, values, rcond=None)[0]
        residuals = values - joint @ fit
        variance = residuals @ residuals / max(len(values) - len(fit), 1)
        covariance = np.linalg.pinv(joint.T @ joint) * variance
        terms = slice(1, 1 + len(self.widths))
        self.weights, self.values = fit[terms], fit[terms]
        self.covariance, self.log_width_variance = covariance[terms, terms], covariance[-1, -1]
        if len(self.widths) == 1:
            self.widths = self.widths * np.exp(np.clip(fit[-1], -0.2, 0.2))
        shift = slice(terms.stop, terms.stop + order + 1)
        if self.double:
            self.gap = self.gap + fit[shift.stop]
        return fit[shift]

    def residuals(self, distance, values):
        """What is left after weights are fitted at these distances."""
        design = np.hstack([np.ones((len(distance), 1)), self._shapes(distance)])
        return values - design @ np.linalg.lstsq(design, values, rcond=None)[0]

    def transfer(self, frequencies):
        """The matrix that takes weights to the optical transfer function."""
        if self.shape == "logistic":
            x = 2 * np.pi**2 * self.widths * np.maximum(frequencies[:, None], 1e-12)
            return x / np.sinh(x)
        return self._optics(frequencies, self.widths)

    def _optics(self, frequencies, widths):
        """Transfer of a lens and the square pixel: a Gaussian of that deviation, a disc of that
        radius, or diffraction up to one over the width."""
        pixel = np.sinc(frequencies * np.cos(self.angle)) * np.sinc(
            frequencies * np.sin(self.angle)
        )
        x = np.abs(frequencies[:, None] * widths)
        return LENS_TRANSFERS[self.shape](x) * pixel[:, None]

    def profile(self):
        """Distances, edge and line spread function, and the full width at half maximum."""
        middle = self.widths[len(self.widths) // 2]
        places = np.linspace(-8, 8, 3201) * np.hypot(middle, PIXEL_SIGMA)
        edges = np.stack([self.edge(places, width) for width in self.widths], axis=1)
        esf = edges @ self.weights / self.weights.sum()
        lsf = np.gradient(esf, places)
        half = len(places) // 2
        return places, esf, lsf, float(2 * np.interp(-lsf.max() / 2, -lsf[half:], places[half:]))


@dataclass(frozen=True, eq=False)
class _Deviation:
    """A smooth departure of an edge from a fit at bins of a quarter pixel, with its covariance."""

    places: np.ndarray
    values: np.ndarray
    covariance: np.ndarray | None

    def transfer(self, frequencies):
        """The matrix that takes values to their part of the optical transfer function."""
        waves = np.exp(-2j * np.pi * frequencies[:, None] * self.places[1:-1])
        steps = frequencies / BINS_PER_PIXEL
        waves /= (2 * np.sinc(2 * steps) * np.sinc(steps))[:, None]
        matrix = np.zeros((len(frequencies), len(self.places)), dtype=complex)
        matrix[:, 2:] += waves
        matrix[:, :-2] -= waves
        return matrix


def _deviation(distance, residuals, step, width, reach):
    """The smooth departure that residuals of an edge of this width show, if any.

    The residuals' means in bins are taken for white noise plus a Gaussian process that is strongest
    at the edge; its size and length maximise the likelihood. Without evidence it is zero, so that
    an edge which the fit describes is not made noisier.
    """
    count, means, variance = _bin_means(distance, residuals, reach)
    places = (np.arange(len(count)) - len(count) // 2) / BINS_PER_PIXEL
    none = _Deviation(places, np.zeros(len(places)), None)
    filled = count > 0
    if not variance > 0:
        return none
    noise = np.sqrt(variance / count[filled])
    scaled = means[filled] / noise
    envelope = np.exp(-np.abs(places) / (ENVELOPE * width))
    best = (scaled @ scaled / 2 - EVIDENCE, None)
    for length in LENGTHS:
        kernel = np.exp(-((places[:, None] - places) ** 2) / (2 * (length * width) ** 2))
        kernel *= envelope[:, None] * envelope * step**2
        inner = kernel[np.ix_(filled, filled)] / np.outer(noise, noise)
        strengths, axes = np.linalg.eigh(inner)
        along = axes.T @ scaled
        for size in SIZES:
            gain = 1 + size**2 * np.clip(strengths, 0, None)
            cost = (np.log(gain).sum() + (along**2 / gain).sum()) / 2
            if cost < best[0]:
                best = (cost, size**2 * kernel)
    if best[1] is None:
        return none
    kernel = best[1]
    inner = kernel[np.ix_(filled, filled)] + np.diag(noise**2)
    gains = np.linalg.solve(inner, kernel[filled]).T
    return _Deviation(places, gains @ means[filled], kernel - gains @ kernel[filled])


def _bin_means(distance, values, reach):
    """Counts and means in bins of a quarter pixel, and the variance within them."""
    bins = int(2 * np.floor(reach * BINS_PER_PIXEL) + 1)
    place = np.round(distance * BINS_PER_PIXEL).astype(int) + bins // 2
    inside = (place >= 0) & (place < bins)
    place, values = place[inside], values[inside]
    count = np.bincount(place, minlength=bins)
    means = np.bincount(place, weights=values, minlength=bins) / np.maximum(count, 1)
    free = max((np.maximum(count, 1) - 1).sum(), 1)
    return count, means, float(((values - means[place]) ** 2).sum() / free)


def _transfer(parts, frequencies):
    """The optical transfer function of fit and deviation, not yet 1 at zero."""
    return sum(part.transfer(frequencies) @ part.values for part in parts if len(part.values))


def _mtf50_sigma(mtf50, parts):
    """Standard deviation of MTF50, to first order in weights and deviation, or in the width."""
    if not np.isfinite(mtf50):
        return np.nan
    model = parts[0]
    if len(model.widths) == 1:
        wider = _Model(model.angle, model.gap, model.shape, model.widths * 1.001)
        change = 1000 * (mtf50 - crossing(FREQUENCIES, wider.transfer(FREQUENCIES)[:, 0], 0.5))
        return float(change * np.sqrt(model.log_width_variance))
    at = np.array([0.0, mtf50, mtf50 + 1e-4])
    zero, here, next_one = _transfer(parts, at)
    slope = (abs(next_one) - abs(here)) / abs(zero) / 1e-4
    variance = 0.0
    for part in parts:
        if part.covariance is not None:
            matrix = part.transfer(at[:2])
            turned = np.real(np.conj(here) / abs(here) * matrix[1])
            turned -= 0.5 * np.real(np.conj(zero) / abs(zero) * matrix[0])
            variance += turned @ part.covariance @ turned / abs(zero) ** 2
    return float(np.sqrt(max(variance, 0)) / abs(slope)) if slope else np.nan


def _binned_mtf(distance, values, reach):
    """The standard's estimate: bins of a quarter pixel, derivative, window, Fourier transform."""
    count, means, _ = _bin_means(distance, values, reach)
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


def _remark(mtf50, binned50, angle, mtf, unfit):
    """What speaks against a value."""
    doubts = {
        "MTF stays above 0.5": not np.isfinite(mtf50),
        f"edge within {SMALLEST_ANGLE_DEG:g} degrees of the pixel grid": abs(np.degrees(angle))
        < SMALLEST_ANGLE_DEG,
        "fit and binning differ": abs(binned50 / mtf50 - 1) > LARGEST_DISAGREEMENT,
        "no sigmoid of this shape fits": unfit,
        "sharpened": mtf.max() > 1.05,
    }
    return "; ".join(text for text, true in doubts.items() if true)


def _integral(x, sigma):
    """The first antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


def _double_integral(x, sigma):
    """The second antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma**2 / 2 * ((z**2 + 1) * ndtr(z) + z * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))
