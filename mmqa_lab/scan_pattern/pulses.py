"""Counting pulses along profiles, and their spacing."""

import numpy as np

from mmqa_lab._checks import check_positive
from mmqa_lab.planes import sigma_mad
from mmqa_lab.scan_pattern.lines import group_means, solve_groups

UNSURE = 0.2
"""Scatter of the pulses about whole numbers, in pulses, above which they cannot be counted."""

TIES = 0.02
"""Share of neighbours of equal time above which a clock is too coarse for counting pulses."""

POINTS_FOR_DEGREE = (60, 150, 600, 2000)
"""Points from which on pulse over place is a polynomial of degree 2, 3, 4, 5."""


def pulse_period(time, profile):
    """Return the time from pulse to pulse, seconds, from the times of the points of profiles.

    NaN where points of a profile share times: the clock is then coarser than the pulses.

    Examples
    --------
    >>> time = np.array([0, 1, 2, 4, 5, 7, 8]) * 1e-5
    >>> round(pulse_period(time, np.zeros(7, dtype=int)), 9)
    1e-05
    """
    order = np.lexsort((time, profile))
    since, group = (time - time.min())[order], profile[order]
    step = np.diff(since)
    same = np.diff(group) == 0
    if not same.any() or np.mean(step[same] > 0) < 1 - TIES:
        return np.nan
    same &= step > 0
    period = np.quantile(step[same], 0.25)
    for _ in range(5):
        count = np.where(same, np.round(step / period), 0)
        pulse = np.concatenate([[0], np.cumsum(count)])
        _, place, counts = np.unique(group, return_inverse=True, return_counts=True)
        p = pulse - group_means(pulse, place, counts)[place]
        period = p @ since / (p @ p)
    return float(period)


def pulses_from_time(time, profile, *, pulse_rate_hz=None):
    """Return pulse counts from time; not whole where time is coarse, NaN if it does not count."""
    if pulse_rate_hz is None:
        period = pulse_period(time, profile)
    else:
        period = 1 / check_positive(pulse_rate_hz, "pulse_rate_hz", unit="Hz")
    return (time - time.min()) / period


def pulses_from_pattern(x, y, off, profile):
    """Return pulse counts within profiles from the points' places, NaN if they blur.

    Neighbours along profiles give a first spacing, and how range noise slides points. From a spot
    in the middle outwards, every point is then rounded to the count that fits a smooth model of
    count over place, with a phase of its own for each profile, and the model fitted again.
    """
    spacing, slide = _first_spacing(x, off, profile)
    if not spacing > 0:
        return np.full(len(x), np.nan)
    model = np.array([1.0, -slide, 0.0, 0.0]) / spacing
    reach, whole = 8 * spacing, np.abs([x, y]).max()
    while True:
        inside = np.maximum(np.abs(x), np.abs(y)) <= reach
        if inside.sum() >= 12:
            model, spread = _rounded_fit(model, x[inside], y[inside], off[inside], profile[inside])
        if reach > whole:
            break
        reach *= 1.4
    if not inside.sum() >= 12 or spread > UNSURE:
        return np.full(len(x), np.nan)
    smooth = _terms(x, y, off) @ model
    return np.round(smooth - _phases(smooth, profile)[profile])


def point_spacing(x, y, off, profile, pulse):
    """Return the spacing along x at the origin, its variance, and the slide along the profile.

    The slope of pulse over place: a polynomial along and across the profiles, of a degree that the
    number of points bears, with one constant for each profile.
    """
    degree = 1 + int(np.searchsorted(POINTS_FOR_DEGREE, len(x), side="right"))
    scale = max(np.abs(x).max(), np.abs(y).max())
    u, w = x / scale, y / scale
    terms = [u, off]
    terms += [u**i * w**k for n in range(2, degree + 1) for i in range(1, n + 1) for k in [n - i]]
    if degree > 2:
        terms += [off * u, off * w]
    found = solve_groups(np.stack(terms, axis=1), pulse, profile)
    slope = found.coefficients[0] / scale
    variance = found.covariance[0, 0] / scale**2 / slope**4
    return 1 / abs(slope), variance, -found.coefficients[1] / slope


def _terms(x, y, off):
    """What the count of pulses is made of, besides the phase of each profile."""
    return np.stack([x, off, x**2, x * y], axis=1)


def _rounded_fit(model, x, y, off, profile):
    """Count pulses by the model, fit it to the counts, four times; the model and its scatter."""
    _, group = np.unique(profile, return_inverse=True)
    terms = _terms(x, y, off)
    for _ in range(4):
        smooth = terms @ model
        pulse = np.round(smooth - _phases(smooth, group)[group])
        found = solve_groups(terms, pulse, group)
        model = found.coefficients
    return model, np.sqrt(found.variance)


def _phases(smooth, group):
    """The part of a pulse by which the points of each profile are late, as a mean on the circle."""
    turning = np.exp(2j * np.pi * smooth)
    total = np.zeros(group.max() + 1, dtype=complex)
    np.add.at(total, group, turning)
    return np.angle(total) / (2 * np.pi)


def _first_spacing(x, off, profile):
    """Median step between neighbours, slid along the beam, and that slide."""
    slide = 0.0
    for _ in range(4):
        order = np.lexsort((x - slide * off, profile))
        same = np.diff(profile[order]) == 0
        step, shift = np.diff(x[order])[same], np.diff(off[order])[same]
        if len(step) < 8:
            return np.nan, 0.0
        straight = step - slide * shift
        typical = np.median(straight)
        spread = max(sigma_mad(straight), 1e-12)
        single = np.abs(straight - typical) <= 2.5 * spread
        about = shift[single] - shift[single].mean()
        if about @ about > 1e-18 * len(about):
            slide = float(about @ step[single] / (about @ about))
    return float(np.median(step - slide * shift)), slide
