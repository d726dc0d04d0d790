"""The profile of an edge in bins of a quarter pixel, and its transfer function."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from mmqa_lab.mtf.transfer import FREQUENCIES

__all__ = ["BINS_PER_PIXEL", "binned", "of_bins", "profile", "window"]
__dir__ = __all__.copy

BINS_PER_PIXEL = 4
"""Bins of the edge profile."""

WIDEST_GAP_PX = 0.75
"""Between places of the profile: an edge of 45 degrees has one in each 0.71 pixels."""


def profile(distance, values):
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


def binned(distance, values):
    """Transfer, NaN where bins at the edge are empty; places and derivative of the profile."""
    centres, means, *_ = profile(distance, values)
    ends = np.round(np.array([distance.min(), distance.max()]) * BINS_PER_PIXEL)
    places = np.arange(ends[0], ends[1] + 1) / BINS_PER_PIXEL
    empty = 1 - len(centres) / len(places)
    # between places farther apart than bins a curve, else straight lines
    curve = PchipInterpolator(centres, means, extrapolate=True)
    seen = curve(places) if empty > 0.1 else np.interp(places, centres, means)
    spread = np.gradient(seen, places) * window(places)
    waves = np.exp(-2j * np.pi * FREQUENCIES[:, None] * places)
    transfer = (waves @ spread) / of_bins(FREQUENCIES)
    if np.diff(centres[np.abs(centres) <= 3]).max(initial=0) > WIDEST_GAP_PX:
        transfer = np.full(len(FREQUENCIES), np.nan)
    transfer = transfer / (BINS_PER_PIXEL * _whole_step(places, seen))
    transfer[0] = 1.0
    return transfer, places, spread


def window(places):
    """One in the middle; the ends fall off as a cosine."""
    half = min(-places[0], places[-1])
    return np.sin(np.pi / 2 * np.clip(10 * (1 - np.abs(places) / half), 0, 1)) ** 2


def of_bins(frequency):
    """Transfer of the central difference, which ISO 12233 takes out, and of the bins' width."""
    steps = frequency / BINS_PER_PIXEL
    return np.sinc(2 * steps) * np.sinc(steps)


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
