"""Edges: the standard's bins, and sigmoids of one width.

The estimate of ISO 12233 is the default: pixels in bins of a quarter pixel over their distance from
the edge, derivative, window, Fourier transform. Beside it stand sigmoids with one width, as in
EuroSDR 2013, image radiometry, section 5.1 and Table 4 (the report does not print the shape of its
sigmoid): a square pixel behind a Gaussian, and the logistic function.

Where an edge lies: its line, the sigmoid across it, the light on both of its sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import expit

from mmqa_lab._checks import check_choice, check_image, refuse
from mmqa_lab._results import Shown, about
from mmqa_lab.mtf.doubts import check, remarks_on
from mmqa_lab.mtf.transfer import (
    FREQUENCIES,
    SIGMOID_PX,
    by_bins,
    crossing,
    full_width,
    profile,
    spread_edge,
)

__all__ = ["EdgeFit", "EdgeResponse", "fit_edge", "fit_line"]


FARTHEST_PX, FARTHEST_SPREADS = 60.0, 24.0
"""Pixels farther from the line are not used: at first, and in spreads of the edge."""

UNEVEN, FAINT = 4.5, 0.003
"""Standard errors from which a slope of the light is taken out; least noise, over all contrast."""

LARGEST_TAIL = 0.5
"""What is missing of a level, times the distance from the edge, over its spread and the step."""

RINGING_PX, FEWEST_NEAR = 6.0, 50
"""Pixels from the edge within which compression rings; least number of pixels that tell."""

HOT, HOT_STEP = 6.0, 0.1
"""Deviations, and share of the step, from which a pixel is left out."""


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
    remarks : tuple of str
        Reasons to doubt the figures; empty if there are none.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :40]
    >>> distance = (columns - 20 + 0.1 * rows - 3) / np.hypot(1, 0.1)
    >>> edge = fit_edge(spread_edge(distance, 0.7, np.arctan(0.1)))
    >>> round(edge.width_px, 2), edge.remarks
    (0.7, ())
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
    remarks: tuple[str, ...] = ()

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
    shape = _logistic if method == "logistic" else spread_edge
    fit = fit_line(image, shape)
    check(fit)
    seen = by_bins(fit) if method == "binned" else _by_sigmoid(fit, shape)
    turn = abs((np.degrees(fit.angle) + 45) % 90 - 45)
    known = {"width_px": fit.width, "angle_deg": float(turn), "n": len(fit.values)}
    mtf50 = seen["mtf50"], seen["mtf50_sigma"]
    remarks = remarks_on(fit, *mtf50, turn, method != "binned")
    return EdgeResponse(frequencies=FREQUENCIES, remarks=remarks, **known, **seen)


def _logistic(distance, width, _):
    return expit(distance / width)


def _by_sigmoid(fit, shape):
    """MTF and profiles of the fitted sigmoid."""
    places = np.arange(-1, 1.0001, 1 / 256) * (12 * np.hypot(fit.width, 0.3) + 2)
    lsf = np.gradient(shape(places, fit.width, fit.angle), places)
    mtf = np.cos(2 * np.pi * FREQUENCIES[:, None] * places) @ lsf / lsf.sum()
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    sigma = mtf50 * fit.log_width_sigma  # a little too large: the pixel's width has no error
    known = {"distance_px": places, "lsf": lsf, "mtf": mtf, "fwhm_px": full_width(places, lsf)}
    return known | {"mtf50": mtf50, "mtf50_sigma": sigma}


@dataclass(frozen=True)
class EdgeFit:
    """Pixels beside an edge, in shares of its step, and the sigmoid of one width that fits best.

    Distances from the line and places along it in pixels; ``grey``: values before the light was
    made even; ``residuals``: what the sigmoid leaves; the step in grey values; ``rounding``: the
    distance of grey values that occur, over the step; ``hot``: count of pixels left out.
    """

    distance: np.ndarray
    along: np.ndarray
    values: np.ndarray
    grey: np.ndarray
    residuals: np.ndarray
    noise: np.ndarray
    angle: float
    width: float
    log_width_sigma: float
    step: float
    rounding: float
    hot: int

    @property
    def spread(self) -> float:
        """Standard deviation of the edge's Gaussian and the pixel together."""
        return float(np.hypot(self.width, 12**-0.5))

    @property
    def length(self) -> float:
        """Of the edge, pixels."""
        return float(np.ptp(self.along))

    @cached_property
    def bins(self) -> tuple:
        """Places, means and counts of the profile's bins, and the variance within them."""
        return profile(self.distance, self.values)

    @cached_property
    def grain(self) -> float:
        """Noise of a pixel: what differs within bins."""
        return float(np.sqrt(profile(self.distance, self.residuals)[3]))

    @cached_property
    def ringing(self) -> float:
        """Noise beside the edge above that far from it and of rounding, as of compression."""
        left = np.square(self.values - np.interp(self.distance, *self.bins[:2]))
        size = np.abs(self.distance)
        near, far = (size > 1.5 * self.spread) & (size < RINGING_PX), size > 2 * RINGING_PX
        sides = [left[far & (side * self.distance > 0)] for side in (-1, 1)]
        if min(int(near.sum()), *map(len, sides)) < FEWEST_NEAR:
            return 0.0
        usual = max(one.mean() for one in sides) * (1 + 4 * np.sqrt(2 / near.sum()))
        return float(np.sqrt(max(left[near].mean() - usual - self.rounding**2 / 12, 0)))

    @property
    def rounded_alike(self) -> bool:
        """Whether noise is too small to even out the rounding of grey values."""
        return self.grain < self.rounding / 2


def fit_line(image, shape):
    """Return the line of an image's edge, its width, and the pixels beside it under even light.

    ``shape``: the sigmoid, a function of distance, width and angle.
    """
    unit = float(np.ptp(image)) or 1.0
    scaled = (image - image.min()) / unit
    values, (across, along, angle) = scaled.ravel(), _line(scaled)
    alone = np.abs(scaled - cv2.medianBlur(np.float32(scaled), 3)).ravel() > HOT_STEP / 2
    near = np.abs(across) <= FARTHEST_PX
    across, along, values = across[near], along[near], values[near]
    across, width, *_ = _sigmoid(across, along, values, angle, shape)
    kept = _plausible(across, values) | ~alone[near]
    hot = int((~kept).sum())
    near = kept & (np.abs(across) <= FARTHEST_SPREADS * np.hypot(width, 0.3) + 6)
    across, along, values = across[near], along[near], values[near]
    even, step = _under_even_light(across, along, values, np.hypot(width, 12**-0.5))
    across, width, sigma, left = _sigmoid(across, along, even, angle, shape, width)
    noise = _noise(across, even, np.hypot(width, 12**-0.5))
    pixels = across, along, even, values / step, left, noise
    rounding = float(np.diff(np.unique(scaled)).min(initial=np.inf)) / step
    return EdgeFit(*pixels, angle, width, sigma, step * unit, rounding, hot)


def _line(image):
    """Distance of all pixels from the edge and place along it, and the angle of its normal.

    Steep pixels weigh most: first their gradients say how the edge is turned, then a straight line
    is fitted to their places, of fewer and fewer about it.
    """
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    by_y, by_x = np.gradient(smooth)
    size = np.hypot(by_x, by_y)
    angle = np.arctan2((size * by_y).sum(), (size * by_x).sum())
    y, x = (part.ravel() - part.mean() for part in np.indices(image.shape, dtype=float))
    by_x, by_y, offset = by_x.ravel(), by_y.ravel(), None
    for reach in (40.0, 20.0, 10.0, 6.0, 6.0, 6.0):
        c, s = np.cos(angle), np.sin(angle)
        across, along = x * c + y * s, y * c - x * s
        weight = np.clip(by_x * c + by_y * s, 0, None) ** 2
        if offset is None:
            total = np.bincount(np.round(across - across.min()).astype(int), weight)
            offset = np.argmax(np.convolve(total, np.ones(5), "same")) + across.min()
        weight *= np.clip(1 - ((across - offset) / reach) ** 2, 0, None)
        few = (weight > 0).sum() < 5 or not weight.sum() > 0
        refuse(few, "image", "no edge from side to side", "one that shows one")
        slope, offset = np.polyfit(along, across, 1, w=np.sqrt(weight))
        angle -= np.arctan(slope)
        offset *= np.cos(np.arctan(slope))
    c, s = np.cos(angle), np.sin(angle)
    return x * c + y * s - offset, y * c - x * s, float(angle)


def _sigmoid(across, along, values, angle, shape, width=1.0):
    """Distances from the line of the best sigmoid, its width, deviation of its log, residuals."""
    half = np.abs(along).max()
    scale = max(float(np.ptp(values)), 1e-12) / 10

    def left(known):
        """What a sigmoid of two levels about a line leaves of the grey values."""
        step = shape(across - known[0] - known[1] * along / half, np.exp(known[2]), angle)
        step = step - step.mean()
        square = step @ step
        return values - values.mean() - step * ((step @ values) / max(square, 1e-12))

    limits = np.log(SIGMOID_PX)
    ends = [-5, -5, limits[0]], [5, 5, limits[1]]
    how = {"bounds": ends, "loss": "soft_l1", "f_scale": scale, "x_scale": [1, 1, 0.3]}
    how |= {"ftol": 1e-6, "xtol": 1e-6}
    found = least_squares(left, [0, 0, np.log(width)], **how)
    residuals = left(found.x)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * np.mean(residuals**2)
    across = across - found.x[0] - found.x[1] * along / half
    return across, float(np.exp(found.x[2])), float(np.sqrt(covariance[2, 2])), residuals


def _plausible(across, values):
    """Which pixels lie near the median of those at the same distance, as no hot pixel does."""
    place = np.round(2 * across).astype(int)
    place -= place.min()
    order = np.lexsort((values, place))
    count = np.bincount(place)
    first = np.cumsum(count) - count
    median = values[order][first + count // 2 - (count == 0)]
    left = np.abs(values - median[place])
    steep = np.abs(np.gradient(median))[place]
    usual = max(np.median(left[side * across > 0]) for side in (-1, 1)) / 0.6745
    return left <= max(HOT * usual, HOT_STEP * np.ptp(median)) + steep


def _under_even_light(across, along, values, spread):
    """Values in shares of the step at their place, and the step in the middle.

    A plane on either side: a level, slopes along and across where they stand out, and the tail of a
    lens, which falls with the inverse of the distance.
    """
    least = (FAINT * float(np.ptp(values))) ** 2
    largest, levels = LARGEST_TAIL * spread * float(np.ptp(values)), []
    for side in (-1, 1):
        far = side * across > 4 * spread + 1
        if far.sum() < 20:
            far = side * across > 0
        place, seen = across[far], values[far]
        terms = np.column_stack([np.ones_like(place), along[far], place, -side / (side * place)])
        used = np.arange(4 if np.ptp(place) > 10 else 2)
        while True:
            inverse = np.linalg.pinv(terms[:, used].T @ terms[:, used])
            known = inverse @ (terms[:, used].T @ seen)
            left = seen - terms[:, used] @ known
            noise = max(left @ left / max(len(left) - len(used), 1), least)
            clear = np.abs(known[1:]) / np.sqrt(noise * np.diag(inverse)[1:])
            # light that sharpening adds, or a second edge, is no tail
            odd = np.abs(known[1:] / largest - 0.5) > 0.5
            clear[(used[1:] == 3) & odd] = 0
            if not len(clear) or clear.min() > UNEVEN:
                break
            used = np.delete(used, 1 + np.argmin(clear))
        plane = np.zeros(4)
        plane[used] = known
        levels.append(plane[0] + plane[1] * along + plane[2] * across)
    low, high = levels
    step = float(np.median(high - low))
    refuse(not step > 0, "image", "no edge from side to side", "one that shows one")
    return (values - low) / (high - low), step


def _noise(across, values, spread):
    """Standard deviation of each pixel's noise, from that of both sides."""
    sides = []
    for side in (-1, 1):
        far = side * across > 4 * spread + 1
        seen = values[far] if far.sum() > 10 else values[side * across > spread]
        sides.append(float(seen.std()) if len(seen) > 1 else 0.0)
    both = np.maximum(sides, max(max(sides) / 10, 1e-6))
    return np.sqrt(np.interp(across, [-spread, spread], both**2))
