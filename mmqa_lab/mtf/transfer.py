"""Transfer functions: of lenses and pixels, and of the profile of an edge.

ISO 12233 averages pixels in bins across the edge, takes differences, a window and the Fourier
transform. Bins that are empty or hold few pixels, as at slopes of 1:2, and noise far from the edge
need care there. Here a curve is fitted to narrow bins by weighted least squares: a sigmoid, what
the profile adds to it near the edge in steps of half its width, farther away in wider and wider
ones, and on both sides the tail of a lens. That is the noise reduction, and it follows any profile.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.special import j1, ndtr

__all__ = [
    "BINS_PER_PIXEL", "COARSE", "FITTED_TRANSFERS", "FREQUENCIES", "LENS_TRANSFERS",
    "SIGMOID_PX", "by_bins", "crossing", "full_width", "lens_mtf", "profile", "spread_edge",
    "tail_mtf",
]  # fmt: skip


FREQUENCIES = np.linspace(0, 1, 401)
"""Cycles per pixel."""

SIGMOID_PX = (0.15, 12.0)
"""Limits of a sigmoid's width."""

BINS_PER_PIXEL, NARROW_BINS = 4, 16
"""Bins of a pixel: of the profile that is looked at, and of the one through which a curve goes."""

EDGE_PARTS = 10
"""Parts of an edge whose differences show how well the whole is known."""

WIDEST_GAP_PX = 0.75
"""Between places of the profile: an edge of 45 degrees has one in each 0.71 pixels."""

COARSE = 0.01
"""Distance of grey values over the step from which, without noise, no interval is known."""

CORE, KNOT, WIDER = 3.0, 0.5, 1.5
"""Spreads within which knots are dense, their distance in spreads, and its growth farther away."""

PROFILE_ERROR = 0.002
"""By which profiles err besides noise, over the step. Less is not believed: an edge of 45 degrees
has few places, and a curve through all of them is free between them."""

RINGING = 1.3
"""Error of MTF50 over the noise that compression leaves beside the edge: of JPEG 50 to 85."""

LOOSE_NEAR, LOOSE_FAR, TAIL = 0.05, 0.02, 0.2
"""What the curve may add to the sigmoid, standard deviations over the step: near, far, as tail."""


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
    low = -np.abs(distance)  # where integrals are small: the differences of large ones round
    bend = [_double_integral(low + place, sigma) for place in (outer, inner, -inner, -outer)]
    share = (bend[0] - bend[1] - bend[2] + bend[3]) / (wide * narrow)
    return np.where(distance > 0, 1 - share, share)


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


def tail_mtf(x):
    """Return the transfer of a spread that falls by e in each width, as of stray light."""
    return (1 + (2 * np.pi * x) ** 2) ** -1.5


def _gauss(x):
    """Transfer of a Gaussian at cycles per standard deviation."""
    return np.exp(-2 * np.pi**2 * x**2)


LENS_TRANSFERS = {"gaussian": _gauss, "disc": _disc, "diffraction": _diffraction}


"""Transfer functions of lenses at frequencies times their width (cycles per pixel, pixels)."""


FITTED_TRANSFERS = (*LENS_TRANSFERS.values(), tail_mtf)


"""Those of which the one that fits best tells what a lens takes from plain sectors."""


def lens_mtf(transfer, width, frequencies):
    """Return the transfer function of a lens and a square pixel, the mean of all directions."""
    turn = np.radians(np.arange(2.5, 45, 5))[:, None]
    f = np.ravel(frequencies)
    pixel = (np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))).mean(axis=0)
    return (transfer(f * width) * pixel).reshape(np.shape(frequencies))


def profile(distance, values):
    """Return places, means and counts of the bins that have pixels, and the variance within bins.

    Pixels do not fill a bin evenly.
    """
    place = np.round(distance * BINS_PER_PIXEL).astype(int)
    place -= place.min()
    count = np.bincount(place)
    full = np.flatnonzero(count)
    sums = [np.bincount(place, part) / np.maximum(count, 1) for part in (distance, values)]
    variance = np.square(values - sums[1][place]).sum() / max(len(values) - len(full), 1)
    return sums[0][full], sums[1][full], count[full], float(variance)


def by_bins(fit):
    """Return MTF, line spread and the standard deviation of MTF50 from the pixels of an edge."""
    place, seen, weight, part = _narrow_bins(fit)
    ends = float(place.min()), float(place.max())
    design, prior = _terms(place, fit, ends)
    parts = [part == k for k in np.unique(part)]
    normal = [(design[k].T * weight[k]) @ design[k] for k in parts]
    right = [(design[k].T * weight[k]) @ seen[k] for k in parts]
    whole = sum(normal) + np.diag(prior), sum(right)
    inverse = np.linalg.inv(whole[0])
    known = inverse @ whole[1]
    grid = np.arange(np.floor(ends[0]), np.ceil(ends[1]) + 1e-9, 1 / NARROW_BINS)
    curve = _terms(np.clip(grid, *ends), fit, ends)[0]
    spread = np.diff(curve @ known)
    middle = (grid[1:] + grid[:-1]) / 2
    mtf = np.abs(_waves(FREQUENCIES, middle) @ spread) / known[1]
    gap = np.diff(np.sort(fit.distance[np.abs(fit.distance) <= 3])).max(initial=0)
    if gap > WIDEST_GAP_PX:
        mtf = np.full(len(FREQUENCIES), np.nan)
    mtf[0] = 1.0
    lsf = {"distance_px": middle, "lsf": spread / spread.sum() * NARROW_BINS, "mtf": mtf}
    mtf50 = crossing(FREQUENCIES, mtf, 0.5)
    if np.isnan(mtf50):
        return lsf | {"mtf50": np.nan, "mtf50_sigma": np.nan, "fwhm_px": np.nan}
    terms = _waves(np.array([mtf50]), middle)[0] @ np.diff(curve, axis=0)
    near = np.abs(FREQUENCIES - mtf50) < max(0.02, mtf50 / 6)
    slope = np.polyfit(FREQUENCIES[near], mtf[near], 1)[0]
    others = []
    for one, other in zip(normal, right, strict=True):
        without = np.linalg.solve(whole[0] - one, whole[1] - other)
        others.append(np.abs(terms @ without) / without[1])
    by_parts = np.var(others) * (len(others) - 1)
    turned = np.real(terms * np.conj(terms @ known)) / np.abs(terms @ known) / known[1]
    turned[1] -= 0.5 / known[1]
    by_noise = turned @ inverse @ turned
    # profiles err by as much, too, as grey values that are rounded alike, and by compression
    known_errors = PROFILE_ERROR, fit.rounding * fit.rounded_alike, RINGING * fit.ringing
    least = np.linalg.norm(known_errors) * mtf50
    sigma = float(np.hypot(np.sqrt(max(by_parts, by_noise)) / slope, least))
    if fit.rounding * fit.rounded_alike > COARSE:
        sigma = np.nan
    width = full_width(middle, spread)
    return lsf | {"mtf50": mtf50, "mtf50_sigma": sigma, "fwhm_px": width}


def _narrow_bins(fit):
    """Mean place and value, weight and part of the edge, of all narrow bins that have pixels."""
    part = np.clip((fit.along - fit.along.min()) / fit.length * EDGE_PARTS, 0, EDGE_PARTS - 1)
    place = np.round(fit.distance * NARROW_BINS).astype(int)
    place -= place.min()
    cell = part.astype(int) * (place.max() + 1) + place
    count = np.bincount(cell)
    full = np.flatnonzero(count)
    sums = [np.bincount(cell, one)[full] / count[full] for one in (fit.distance, fit.values)]
    weight = np.bincount(cell, np.maximum(fit.noise, PROFILE_ERROR) ** -2.0)[full]
    return *sums, weight, full // (place.max() + 1)


def _terms(place, fit, ends):
    """Terms of the curve at some places, and one over the variance that each may have.

    A level, the sigmoid, a tail on either side, and splines that end at zero.
    """
    s, columns = fit.spread, [np.ones_like(place), spread_edge(place, fit.width, fit.angle)]
    for side in (-1, 1):
        away = np.maximum(side * place, 0) / (2 * s)
        columns.append(-side * away**3 / (1 + away**2) ** 2 / (2 * s))
    knots = _knots(s, ends)
    splines = BSpline.design_matrix(np.clip(place, *ends), knots, 3).toarray()[:, 2:-2]
    middle = np.array([knots[k + 1 : k + 4].mean() for k in range(len(knots) - 4)])[2:-2]
    loose = np.where(np.abs(middle) < 2 * CORE * s, LOOSE_NEAR, LOOSE_FAR)
    prior = np.concatenate([[0, 0, TAIL**-2, TAIL**-2], loose**-2.0])
    return np.column_stack([*columns, splines]), prior


def _knots(spread, ends):
    """Knots of the splines, those at the ends four times."""
    half = [0.0]
    while half[-1] < max(-ends[0], ends[1]):
        step = KNOT * spread if half[-1] < CORE * spread - 1e-9 else (half[-1] - half[-2]) * WIDER
        half.append(half[-1] + max(step, 0.3))
    half = np.array(half[1:])
    inner = np.concatenate([-half[::-1], [0], half])
    inner = inner[(inner > ends[0] + 0.3) & (inner < ends[1] - 0.3)]
    return np.concatenate([[ends[0]] * 4, inner, [ends[1]] * 4])


def _waves(frequencies, places):
    """The Fourier transform of differences over narrow bins, one row a frequency."""
    waves = np.exp(-2j * np.pi * frequencies[:, None] * places)
    return waves / np.sinc(frequencies / NARROW_BINS)[:, None]


def full_width(places, lsf):
    """Return the full width at half maximum, between straight lines."""
    top = int(lsf.argmax())
    left, right = (crossing(places[top::way], lsf[top::way], lsf[top] / 2) for way in (-1, 1))
    return right - left
