"""Which profile and which pulse a point belongs to: from time, or from the pattern alone."""

import numpy as np

from mmqa_lab._checks import check_positive
from mmqa_lab.planes import flat_points, sigma_mad
from mmqa_lab.scan_pattern.lines import group_means, solve_groups

PAUSE = 20
"""Of the typical step of time: longer ones separate runs of points."""

FEW = 16
"""Runs whose beginnings are compared for the period."""

SHARE = 0.35
"""Of the strongest peak: weaker ones are not taken for the fundamental."""

CLOSE = 3
"""Families of lines that are more than so many times closer than the densest are not tried."""

SUMS = (
    *((0, 1), (1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2)),
    *((3, 1), (3, -1), (1, 3), (1, -3), (3, 2), (3, -2), (2, 3), (2, -3)),
)
"""Of two waves: the families of lines that are tried."""

UNSURE = 0.2
"""Scatter of the pulses about whole numbers, in pulses, above which they cannot be counted."""

TIES = 0.02
"""Share of neighbours of equal time above which a clock is too coarse for counting pulses."""

POINTS_FOR_DEGREE = (60, 150, 600, 2000)
"""Points from which on pulse over place is a polynomial of degree 2, 3, 4, 5."""


def revolutions_from_time(time, *, mirror_frequency_hz=None):
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
    _, cut = _longest_pause(since, frequency)
    number = np.floor(since * frequency - cut).astype(np.int64)
    return number - number.min()


def mirror_frequency(time):
    """Return the revolutions per second that the times of the points show.

    Of the periods between the beginnings of runs of points, that one is taken which leaves the
    longest part of a revolution without any point; then a line is fitted through the middles of the
    revolutions, without the first and the last, which may be cut.

    Parameters
    ----------
    time : array_like, shape (n,)
        Seconds.

    Returns
    -------
    float
        Hz. Where the patch is not symmetrical about the direction of travel its outline shifts from
        profile to profile, by a few pulses of some thousand: 0.1 %.

    Raises
    ------
    ValueError
        If there are no pauses.

    Examples
    --------
    >>> round(mirror_frequency(np.add.outer([0, 0.01, 0.03], np.arange(5) * 1e-5).ravel()), 6)
    100.0
    """
    order = np.sort(np.asarray(time, dtype=np.float64) - np.min(time))
    step = np.diff(order)
    typical = np.median(step[step > 0]) if (step > 0).any() else 0.0
    begins = np.concatenate([[0.0], order[1:][step > PAUSE * typical]])
    if typical == 0 or len(begins) < 2:
        raise ValueError(
            "Invalid time without pauses between profiles. Must have a mirror_frequency_hz or a "
            "scan_line with it."
        )
    begins = begins[:FEW]
    periods = np.subtract.outer(begins, begins)
    shares = [(_longest_pause(order, 1 / p)[0], p) for p in np.unique(periods[periods > 0])]
    longest = max(share for share, _ in shares)
    frequency = 1 / np.median([p for share, p in shares if share > 0.95 * longest])
    _, cut = _longest_pause(order, frequency)
    number = np.floor(order * frequency - cut)
    edges = np.flatnonzero(np.diff(number)) + 1
    first, last = order[np.append(0, edges)], order[np.append(edges, len(order)) - 1]
    whole = slice(1, -1) if len(first) > 3 else slice(None)
    numbers, middles = number[np.append(0, edges)][whole], ((first + last) / 2)[whole]
    return float(1 / np.polyfit(numbers, middles, 1)[0])


def _longest_pause(since, frequency):
    """Longest part of a revolution without points, and the phase in its middle."""
    phase = np.sort(since * frequency % 1)
    pause = np.diff(np.append(phase, phase[0] + 1))
    longest = np.argmax(pause)
    return pause[longest], phase[longest] + pause[longest] / 2


def profiles_from_pattern(xy, *, widest=0.5):
    """Return the numbers of the profiles of each point, found from the pattern alone.

    The structure factor |sum exp(i k.p)|^2 / n, points faded out to the outline, has its peaks
    where points lie on lines 2 pi / |k| apart. The fundamental is the smallest k whose peak reaches
    35 % of the highest: the family of lines with the densest points. Where a second family is up to
    three times as close, the points of a lattice lie on many families of lines, sums of the two.

    Parameters
    ----------
    xy : array_like of shape (n, 2), or points in space (laid onto their regression plane)
        In the plane, metres, about their centre.
    widest : float
        Widest gap between profiles that is looked for, metres; never more than 0.45 of the patch.

    Returns
    -------
    list of array of int, shape (n,)
        A number for each point, for each family; that with the densest points first.

    Raises
    ------
    ValueError
        If no peak stands out of those that random points make.

    Notes
    -----
    Profiles are the densest family only where points lie closer along a profile than profiles to
    each other. Otherwise give time or scan line, or see how far points stray from the lines
    (``measure_pattern`` does): on 30 simulated walls whose points are 1 to 4 times as far apart as
    their profiles the first family is right on 3, that of the straightest lines on 25.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(-50, 51) * 0.01, np.arange(-5, 6) * 0.05)
    >>> (number,) = profiles_from_pattern(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> int(np.ptp(number)) + 1
    11
    """
    xy = flat_points(xy)
    low, high = xy.min(axis=0), xy.max(axis=0)
    centred = xy - (low + high) / 2
    # points are faded out towards the outline, which has a pattern of its own
    inside = 1 - np.sum((2 * centred / (high - low)) ** 2, axis=1)
    fading = np.maximum(inside, 0.0) ** 2
    extent = (high - low).max()
    slowest = 2 * np.pi / min(widest, 0.45 * extent)
    spectrum = _spectrum(centred, fading, slowest)
    first = _refined(centred, fading, _fundamental(*spectrum), slowest)
    power, chance = _power(centred, fading, first), 2 * np.log(len(xy)) + 10
    if power < chance:
        raise ValueError(
            f"Invalid pattern: its strongest lines have power {power:.0f} among {len(xy)} points. "
            f"Must be more than {chance:.0f}, what random points can reach; or give time."
        )
    waves = [first]
    second = _second(*spectrum, first, 12 * np.pi / extent, chance * (fading**2).sum())
    if second is not None:
        second = _refined(centred, fading, second, slowest)
        waves += [m * first + n * second for m, n in SUMS]
    return [
        _numbered(centred, fading, wave)
        for wave in waves
        if _power(centred, fading, wave) >= chance
    ]


def _numbered(xy, fading, wave):
    """Number of the line of each point, lines square to a wave."""
    turns = xy @ wave / (2 * np.pi)
    phase = np.angle((fading * np.exp(2j * np.pi * turns)).sum()) / (2 * np.pi)
    return np.round(turns - phase).astype(np.int64)


def _spectrum(xy, fading, slowest):
    """Power times the sum of squared weights, and waves, on the grid of a histogram's transform.

    Where rows are denser than they are apart, they are more than 0.9 / sqrt(density) apart; half of
    that makes room for patches that do not fill their box.
    """
    extent = np.ptp(xy, axis=0)
    edge, narrowest = 1.25 * extent.max(), 0.5 * np.sqrt(extent.prod() / len(xy))
    size = int(2 ** np.ceil(np.log2(5 * edge / narrowest)))
    size = min(max(size, 64), 4096)
    cell = np.floor((xy / edge + 1) * size / 2).astype(np.int64)
    counts = np.bincount(cell @ [size, 1], weights=fading, minlength=size**2)
    power = np.abs(np.fft.rfft2(counts.reshape(size, size))) ** 2
    kx = np.fft.fftfreq(size, 1 / size)[:, None] * np.pi / edge
    ky = np.arange(power.shape[1]) * np.pi / edge
    length = np.hypot(kx, ky)
    power[(length < slowest) | (length > 2 * np.pi / narrowest)] = 0
    return power, kx, ky


def _fundamental(power, kx, ky):
    """The smallest wave whose power reaches a share of the highest."""
    i, j = np.nonzero(power >= SHARE * power.max())
    nearest = np.argmin(np.hypot(kx[i, 0], ky[j]))
    return np.array([kx[i[nearest], 0], ky[j[nearest]]])


def _second(power, kx, ky, first, width, least):
    """The smallest wave off the line of the first, up to ``CLOSE`` times as large, or None."""
    across = np.abs(first[0] * ky - first[1] * kx) / np.hypot(*first)
    near = np.hypot(kx, ky) <= CLOSE * np.hypot(*first)
    power = np.where(near & (across > width), power, 0.0)
    return _fundamental(power, kx, ky) if power.max() >= least else None


def _refined(xy, fading, wave, slowest):
    """The peak of the structure factor near a wave vector."""
    from scipy.optimize import minimize

    def lack(k):
        """What is to be made small: no power where waves are too long."""
        return -_power(xy, fading, k) if np.hypot(*k) >= slowest else 0.0

    step = 2 * np.pi / np.ptp(xy, axis=0).max()
    around = 0.25 * step * np.array([[i, j] for i in range(-4, 5) for j in range(-4, 5)])
    start = min(wave + around, key=lack)
    simplex = start + 0.2 * step * np.array([[0, 0], [0.5, 0], [0, 0.5]])
    options = {"xatol": 1e-5 * step, "fatol": 1e-9, "initial_simplex": simplex}
    return minimize(lack, start, method="Nelder-Mead", options=options).x


def _power(xy, fading, wave):
    """Structure factor at one wave vector: about 1 where points are random."""
    return np.abs((fading * np.exp(1j * (xy @ wave))).sum()) ** 2 / (fading**2).sum()


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
