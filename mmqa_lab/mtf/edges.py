"""Edges: the standard's bins, and sigmoids of one width.

The estimate of ISO 12233 is the default: pixels in bins of a quarter pixel over their distance from
the edge, derivative, window, Fourier transform. Beside it stand sigmoids with one width, as in
EuroSDR 2013, image radiometry, section 5.1 and Table 4 (the report does not print the shape of its
sigmoid): a square pixel behind a Gaussian, and the logistic function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit

from mmqa_lab._checks import check_choice, check_image, refuse
from mmqa_lab._results import Shown, about
from mmqa_lab.mtf.edge_doubts import check, remarks_on
from mmqa_lab.mtf.edge_line import fit_line
from mmqa_lab.mtf.edge_profile import by_bins, full_width
from mmqa_lab.mtf.transfer import FREQUENCIES, crossing, spread_edge

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
    remarks = remarks_on(fit, seen["mtf50"], turn, method != "binned")
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
