"""Which profile and which pulse a point belongs to: from time, or from the pattern alone."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len, rfft2
from scipy.optimize import minimize

from mmqa_lab._checks import check_positive
from mmqa_lab.planes import sigma_mad

PAUSE = 20  # of the typical step of time: longer ones separate runs of points
FEW = 16  # runs whose beginnings are compared for the period
SHARE = 0.35  # of the strongest peak: weaker ones are not taken for the fundamental
# Widest gap between profiles that is looked for, metres; never more than 0.45 of the patch.
WIDEST = 0.5
# Families of lines that are more than so many times closer than the densest are not tried.
CLOSE = 3
SUMS = (
    *((0, 1), (1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2)),
    *((3, 1), (3, -1), (1, 3), (1, -3), (3, 2), (3, -2), (2, 3), (2, -3)),
)
"""Of two waves: the families of lines that are tried."""

# Scatter of the pulses about whole numbers, in pulses, above which they cannot be counted.
UNSURE = 0.2
# Share of neighbours of equal time above which a clock is too coarse for counting pulses.
TIES = 0.02
# Points from which on pulse over place is a polynomial of degree 2, 3, 4, 5.
POINTS_FOR_DEGREE = (60, 150, 600, 2000)


def revolutions_from_time(
    time: ArrayLike, *, mirror_frequency_hz: float | None = None
) -> np.ndarray:
    """Return the number of the revolution of each point, from 0.

    Revolutions are cut in the longest pause of their phase: while the beam is off the patch.

    Parameters
    ----------
    time : array_like, shape (n,)
        Seconds.
    mirror_frequency_hz : float, optional
        ``mirror_frequency`` of the times where left out.

    Returns
    -------
    array of int, shape (n,)

    Raises
    ------
    ValueError
        If the frequency is not above zero, or none shows in the times.

    Examples
    --------
    >>> pulses = np.arange(5) * 1e-5
    >>> revolutions_from_time(np.concatenate([pulses, pulses + 0.01, pulses + 0.03])).tolist()
    [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 3, 3, 3, 3, 3]
    """
    since = np.asarray(time, dtype=np.float64) - np.min(time)
    if mirror_frequency_hz is None:
        frequency = mirror_frequency(since)
    else:
        frequency = check_positive(mirror_frequency_hz, "mirror_frequency_hz", unit="Hz")
    number = np.floor(since * frequency - _longest_pause(since, frequency)[1]).astype(np.int64)
    return number - number.min()


def mirror_frequency(time):
    """Return the revolutions per second that the times of the points show.

    Of the periods between the beginnings of runs of points, that one is taken which leaves the
    longest part of a revolution without any point; then a line is fitted through the middles of the
    revolutions, without the first and the last, which may be cut. Where the patch is not
    symmetrical about the direction of travel its outline shifts from profile to profile, by a few
    pulses of some thousand: the answer is good to 0.1 %.

    Examples
    --------
    >>> round(mirror_frequency(np.add.outer([0, 0.01, 0.03], np.arange(5) * 1e-5).ravel()), 6)
    100.0
    """
    order = np.sort(np.asarray(time, dtype=np.float64) - np.min(time))
    step = np.diff(order)
    typical = np.median(step[step > 0]) if (step > 0).any() else np.inf
    begins = np.append(0.0, order[1:][step > PAUSE * typical])[:FEW]
    periods = np.unique(np.subtract.outer(begins, begins))
    periods = periods[periods > 0]
    if not len(periods):
        raise ValueError(
            "Invalid time without pauses between profiles. Must have a mirror_frequency_hz or a "
            "scan_line with it."
        )
    pauses = np.array([_longest_pause(order, 1 / period)[0] for period in periods])
    frequency = 1 / np.median(periods[pauses > 0.95 * pauses.max()])
    number = revolutions_from_time(order, mirror_frequency_hz=frequency)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    whole = slice(1, -1) if len(first) > 3 else slice(None)
    middles = (order[first] + order[last]) / 2
    return float(1 / np.polyfit(number[first][whole], middles[whole], 1)[0])


def _longest_pause(since, frequency):
    """Longest part of a revolution without points, and the phase in its middle."""
    phase = np.sort(since * frequency % 1)
    pause = np.diff(np.append(phase, phase[0] + 1))
    longest = np.argmax(pause)
    return pause[longest], phase[longest] + pause[longest] / 2


def profiles_from_pattern(xy):
    """Return the number of the profile of each point, found from the pattern alone.

    The structure factor |sum exp(i k.p)|^2 / n, points faded out to the outline, has its peaks
    where points lie on lines 2 pi / |k| apart. The fundamental is the smallest k whose peak reaches
    35 % of the highest: the family of lines with the densest points. Where a second family is up to
    three times as close, the points of a lattice lie on many families of lines, sums of the two.

    Profiles are the densest family only where points lie closer along a profile than profiles to
    each other. Otherwise give time or scan line, or see how far points stray from the lines
    (``measure_pattern`` does): on 30 simulated walls whose points are 1 to 4 times as far apart as
    their profiles the first family is right on 3, that of the straightest lines on 25.

    Parameters
    ----------
    xy : array, shape (n, 2)
        In the plane, metres.

    Returns
    -------
    list of array of int, shape (n,)
        A number for each point, for each family; that with the densest points first.

    Raises
    ------
    ValueError
        If no peak stands out of those that random points make.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(-50, 51) * 0.01, np.arange(-5, 6) * 0.05)
    >>> (number,) = profiles_from_pattern(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> int(np.ptp(number)) + 1
    11
    """
    low, high = xy.min(axis=0), xy.max(axis=0)
    pattern = _Pattern(xy - (low + high) / 2, high - low)
    spectrum = pattern.spectrum()
    first = pattern.refined(_fundamental(*spectrum))
    power, chance = pattern.power(first), 2 * np.log(len(xy)) + 10
    if power < chance:
        raise ValueError(
            f"Invalid pattern: its strongest lines have power {power:.0f} among {len(xy)} points. "
            f"Must be more than {chance:.0f}, what random points can reach; or give time."
        )
    waves = [first]
    others = _off_the_line(*spectrum, first, 12 * np.pi / pattern.extent.max())
    if others.max() >= chance * pattern.total:
        second = pattern.refined(_fundamental(others, *spectrum[1:]))
        waves += [m * first + n * second for m, n in SUMS]
    return [pattern.numbers(wave) for wave in waves if pattern.power(wave) >= chance]


class _Pattern:
    """Points about the middle of their box, faded out to the outline, which has its own pattern."""

    def __init__(self, xy, extent):
        inside = 1 - np.sum((2 * xy / extent) ** 2, axis=1)
        self.xy, self.extent = xy, extent
        self.fading = np.maximum(inside, 0.0) ** 2
        self.total = (self.fading**2).sum()
        self.slowest = 2 * np.pi / min(WIDEST, 0.45 * extent.max())

    def amplitude(self, wave):
        """Sum of exp(i k.p) over the points."""
        return (self.fading * np.exp(1j * (self.xy @ wave))).sum()

    def power(self, wave):
        """Structure factor at one wave vector: about 1 where points are random."""
        return np.abs(self.amplitude(wave)) ** 2 / self.total

    def numbers(self, wave):
        """Number of the line of each point, lines square to a wave."""
        turns = (self.xy @ wave - np.angle(self.amplitude(wave))) / (2 * np.pi)
        return np.round(turns).astype(np.int64)

    def spectrum(self):
        """Power times ``total``, and waves, on the grid of a histogram's transform.

        Where rows are denser than they are apart, they are more than 0.9 / sqrt(density) apart;
        half of that makes room for patches that do not fill their box.
        """
        edge, narrowest = (
            1.25 * self.extent.max(),
            0.5 * np.sqrt(self.extent.prod() / len(self.xy)),
        )
        size = next_fast_len(int(np.clip(5 * edge / narrowest, 64, 4096)), real=True)
        cell = np.floor((self.xy / edge + 1) * size / 2).astype(np.int64)
        counts = np.bincount(cell @ [size, 1], weights=self.fading, minlength=size**2)
        power = np.abs(rfft2(counts.reshape(size, size))) ** 2
        kx = np.fft.fftfreq(size, 1 / size)[:, None] * np.pi / edge
        ky = np.arange(power.shape[1]) * np.pi / edge
        square = kx**2 + ky**2
        power[(square < self.slowest**2) | (square > (2 * np.pi / narrowest) ** 2)] = 0
        return power, kx, ky

    def refined(self, wave):
        """The peak of the structure factor near a wave vector, that of no wave too long."""

        def lack(k):
            return -self.power(k) if np.hypot(*k) >= self.slowest else 0.0

        step = 2 * np.pi / self.extent.max()
        tried = 0.25 * step * np.arange(-4, 5)
        east, north = np.exp(1j * np.multiply.outer(self.xy.T, tried))
        here = self.fading * np.exp(1j * (self.xy @ wave))
        power = np.abs(east.T @ (here[:, None] * north))
        power[np.hypot(wave[0] + tried[:, None], wave[1] + tried) < self.slowest] = 0
        best = np.unravel_index(np.argmax(power), power.shape)
        start = wave + tried[list(best)]
        simplex = start + 0.2 * step * np.array([[0, 0], [0.5, 0], [0, 0.5]])
        options = {"xatol": 1e-3 * step, "fatol": 1.0, "initial_simplex": simplex}
        return minimize(lack, start, method="Nelder-Mead", options=options).x


def _fundamental(power, kx, ky):
    """The smallest wave whose power reaches a share of the highest."""
    i, j = np.nonzero(power >= SHARE * power.max())
    nearest = np.argmin(np.hypot(kx[i, 0], ky[j]))
    return np.array([kx[i[nearest], 0], ky[j[nearest]]])


def _off_the_line(power, kx, ky, first, width):
    """Power of the waves off the line of the first and up to ``CLOSE`` times as large."""
    across = np.abs(first[0] * ky - first[1] * kx) > width * np.hypot(*first)
    near = kx**2 + ky**2 <= CLOSE**2 * (first @ first)
    return np.where(near & across, power, 0.0)


class GroupSolution(NamedTuple):
    """Least squares with a constant for each group."""

    coefficients: np.ndarray
    constants: np.ndarray
    means: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    variance: float


def solve_groups(terms, values, group):
    """Least squares of ``values`` on shared terms and one constant for each group.

    Terms without any spread (distances from a plane without noise) get coefficient and variance 0.
    """
    means, level = group_means(terms, group), group_means(values, group)
    about, target = terms - means[group], values - level[group]
    scale = np.sqrt(np.mean(about**2, axis=0))
    scale[scale <= 1e-9 * scale.max()] = np.inf
    about /= scale
    inverse = np.linalg.pinv(about.T @ about, rcond=1e-12)
    scaled = inverse @ (about.T @ target)
    residuals = target - about @ scaled
    free = max(len(values) - len(level) - np.isfinite(scale).sum(), 1)
    variance = residuals @ residuals / free
    coefficients = scaled / scale
    covariance = variance * inverse / np.outer(scale, scale)
    return GroupSolution(
        coefficients, level - means @ coefficients, means, covariance, residuals, variance
    )


def group_means(values, group):
    """Means of numbers, or of the rows of a matrix, over groups, (m, ...)."""
    if values.ndim == 2:
        return np.stack([group_means(column, group) for column in values.T], axis=1)
    return np.bincount(group, values) / np.bincount(group)


def pulses_from_time(time, profile, *, pulse_rate_hz=None):
    """Return pulse counts from time; not whole where time is coarse, NaN if it does not count."""
    if pulse_rate_hz is None:
        period = pulse_period(time, profile)
    else:
        period = 1 / check_positive(pulse_rate_hz, "pulse_rate_hz", unit="Hz")
    return (time - time.min()) / period


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
    since, group = (time - time.min())[order], np.unique(profile[order], return_inverse=True)[1]
    step, same = np.diff(since), np.diff(group) == 0
    if not same.any() or np.mean(step[same] > 0) < 1 - TIES:
        return np.nan
    period = np.quantile(step[same & (step > 0)], 0.25)
    for _ in range(5):
        count = np.where(same, np.round(step / period), 0.0)
        pulse = np.append(0.0, np.cumsum(count))
        period = solve_groups(pulse[:, None], since, group).coefficients[0]
    return float(period)


def pulses_from_pattern(x, y, off, profile):
    """Return pulse counts within profiles from the points' places, NaN if they blur.

    Neighbours along profiles give a first spacing, and how range noise slides points. From a spot
    in the middle outwards, every point is then rounded to the count that fits a smooth model of
    count over place, with a phase of its own for each profile, and the model fitted again.
    """
    blurred = np.full(len(x), np.nan)
    spacing, slide = _first_spacing(x, off, profile)
    if not spacing > 0:
        return blurred
    terms = np.stack([x, off, x**2, x * y], axis=1)
    model, spread = np.array([1.0, -slide, 0.0, 0.0]) / spacing, np.inf
    place = np.maximum(np.abs(x), np.abs(y))
    reach = 8 * spacing
    while reach <= place.max():
        inside = place <= reach
        if inside.sum() >= 12:
            model, spread = _rounded_fit(model, terms[inside], profile[inside])
        reach *= 1.4
    model, spread = _rounded_fit(model, terms, profile)
    return _rounded(terms @ model, profile) if spread <= UNSURE else blurred


def _rounded_fit(model, terms, profile):
    """Count pulses by the model, fit it to the counts, four times; the model and its scatter."""
    group = np.unique(profile, return_inverse=True)[1]
    for _ in range(4):
        found = solve_groups(terms, _rounded(terms @ model, group), group)
        model = found.coefficients
    return model, np.sqrt(found.variance)


def _rounded(smooth, group):
    """Counts less the part of a pulse by which a profile is late (a mean on the circle), whole."""
    turn = 2 * np.pi * smooth
    late = np.arctan2(*(group_means(part(turn), group) for part in (np.sin, np.cos))) / (2 * np.pi)
    return np.round(smooth - late[group])


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
        single = np.abs(straight - np.median(straight)) <= 2.5 * max(sigma_mad(straight), 1e-12)
        about = shift[single] - shift[single].mean()
        if about @ about > 1e-18 * len(about):
            slide = float(about @ step[single] / (about @ about))
    return float(np.median(step - slide * shift)), slide


def point_spacing(x, y, off, profile, pulse):
    """Return the spacing along x at the origin, its variance, and the slide along the profile.

    The slope of pulse over place: a polynomial along and across the profiles, of a degree that the
    number of points bears, with one constant for each profile. NaN without pulses.
    """
    if not np.isfinite(pulse).all():
        return np.nan, np.nan, 0.0
    degree = 1 + int(np.searchsorted(POINTS_FOR_DEGREE, len(x), side="right"))
    scale = max(np.abs(x).max(), np.abs(y).max())
    u, w = x / scale, y / scale
    terms = [u, off]
    terms += [u**i * w ** (n - i) for n in range(2, degree + 1) for i in range(1, n + 1)]
    if degree > 2:
        terms += [off * u, off * w]
    found = solve_groups(np.stack(terms, axis=1), pulse, profile)
    slope = found.coefficients[0] / scale
    variance = found.covariance[0, 0] / scale**2 / slope**4
    return 1 / abs(slope), variance, -found.coefficients[1] / slope
