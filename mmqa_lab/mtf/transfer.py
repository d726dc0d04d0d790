"""Transfer functions: of lenses and pixels, and where one falls to a level."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j1, ndtr

__all__ = [
    "FITTED_TRANSFERS",
    "FREQUENCIES",
    "LENS_TRANSFERS",
    "SIGMOID_PX",
    "crossing",
    "lens_mtf",
    "spread_edge",
]
__dir__ = __all__.copy

FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

SIGMOID_PX = (0.15, 12.0)
"""Limits of a sigmoid's width."""


def crossing(frequencies, mtf, level):
    """Return the first frequency (or place) at which values fall below a level; NaN without one."""
    below = mtf < level
    if not below.any() or below[0]:
        return np.nan
    k = int(np.argmax(below))
    part = (mtf[k - 1] - level) / (mtf[k - 1] - mtf[k])
    return float(frequencies[k - 1] + part * (frequencies[k] - frequencies[k - 1]))


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


def _double_integral(x, sigma):
    """The second antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma**2 / 2 * ((z**2 + 1) * ndtr(z) + z * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


def _disc(x):
    """Transfer of a defocused lens at cycles per radius."""
    turn = 2 * np.pi * np.maximum(x, 1e-9)
    return 2 * j1(turn) / turn


def _diffraction(x):
    """Transfer of a perfect lens at a share of its highest frequency."""
    x = np.minimum(x, 1)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2))


def _exponential(x):
    """Transfer of a spread that falls by e in each width, as of stray light."""
    return (1 + (2 * np.pi * x) ** 2) ** -1.5


def _gauss(x):
    """Transfer of a Gaussian at cycles per standard deviation."""
    return np.exp(-2 * np.pi**2 * x**2)


LENS_TRANSFERS = {"gaussian": _gauss, "disc": _disc, "diffraction": _diffraction}
"""Transfer functions of lenses at frequencies times their width (cycles per pixel, pixels)."""

FITTED_TRANSFERS = (*LENS_TRANSFERS.values(), _exponential)
"""Those of which the one that fits best tells what a lens takes from plain sectors."""


def lens_mtf(transfer, width, frequencies):
    """Return the transfer function of a lens and a square pixel, the mean of all directions."""
    turn = np.radians(np.arange(2.5, 45, 5))[:, None]
    f = np.ravel(frequencies)
    pixel = (np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))).mean(axis=0)
    return (transfer(f * width) * pixel).reshape(np.shape(frequencies))
