"""What pixels see of an edge, and what all estimators of resolution share."""

from dataclasses import dataclass

import numpy as np

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
class Deviation:
    """A smooth departure of an edge profile from a fit, at bins of a quarter pixel.

    Parameters
    ----------
    places : array, shape (m,)
        Distances of the bins from the edge, pixels.
    values : array, shape (m,)
        The departure, in the image's unit; zero where nothing speaks for one.
    covariance : array, shape (m, m) or None
        Of the values; None for no departure.
    """

    places: np.ndarray
    values: np.ndarray
    covariance: np.ndarray | None

    def transfer(self, frequencies):
        """Return the matrix that takes values to their part of the optical transfer function."""
        waves = np.exp(-2j * np.pi * frequencies[:, None] * self.places[1:-1])
        steps = frequencies / BINS_PER_PIXEL
        waves /= (2 * np.sinc(2 * steps) * np.sinc(steps))[:, None]
        matrix = np.zeros((len(frequencies), len(self.places)), dtype=complex)
        matrix[:, 2:] += waves
        matrix[:, :-2] -= waves
        return matrix


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


def deviation(distance, residuals, step, width, reach):
    """Return the smooth departure that residuals of an edge show, if any.

    The residuals' means in bins are taken for white noise plus a Gaussian process that is strongest
    at the edge; its size and length maximise the likelihood. Without evidence it is zero, so that
    an edge which the fit describes is not made noisier.

    Parameters
    ----------
    distance, residuals : array, shape (n,)
        Of the pixels.
    step : float
        Height of the edge.
    width : float
        Standard deviation of the edge's slope, pixels.
    reach : float
        Largest distance, pixels.
    """
    count, means, variance = bin_means(distance, residuals, reach)
    places = (np.arange(len(count)) - len(count) // 2) / BINS_PER_PIXEL
    none = Deviation(places, np.zeros(len(places)), None)
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
    return Deviation(places, gains @ means[filled], kernel - gains @ kernel[filled])


def bin_means(distance, values, reach):
    """Return counts and means in bins of a quarter pixel, and the variance within them."""
    bins = int(2 * np.floor(reach * BINS_PER_PIXEL) + 1)
    place = np.round(distance * BINS_PER_PIXEL).astype(int) + bins // 2
    inside = (place >= 0) & (place < bins)
    place, values = place[inside], values[inside]
    count = np.bincount(place, minlength=bins)
    means = np.bincount(place, weights=values, minlength=bins) / np.maximum(count, 1)
    free = max((np.maximum(count, 1) - 1).sum(), 1)
    return count, means, float(((values - means[place]) ** 2).sum() / free)


def crossing(frequencies, mtf, level):
    """Return the first frequency at which an MTF falls below a level, NaN where it does not."""
    below = mtf < level
    if not below.any() or below[0]:
        return np.nan
    k = int(np.argmax(below))
    part = (mtf[k - 1] - level) / (mtf[k - 1] - mtf[k])
    return float(frequencies[k - 1] + part * (frequencies[k] - frequencies[k - 1]))


def _integral(x, sigma):
    """The first antiderivative of the normal distribution function."""
    from scipy.special import ndtr

    z = x / sigma
    return sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


def _double_integral(x, sigma):
    """The second antiderivative of the normal distribution function."""
    from scipy.special import ndtr

    z = x / sigma
    return sigma**2 / 2 * ((z**2 + 1) * ndtr(z) + z * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))
