"""Which profile a point belongs to: from time, or from the pattern alone."""

import numpy as np

from mmqa_lab._checks import check_positive
from mmqa_lab.planes import flat_points

PAUSE = 20
"""Of the typical step of time: longer ones separate runs of points."""

FEW = 16
"""Runs whose beginnings are compared for the period."""

SHARE = 0.35
"""Of the strongest peak: weaker ones are not taken for the fundamental."""


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
    """Return the number of the profile of each point, found from the pattern alone.

    The structure factor |sum exp(i k.p)|^2 / n, points faded out to the outline, has its peaks
    where points lie on lines 2 pi / |k| apart. The fundamental is the smallest k whose peak reaches
    35 % of the highest.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        In the plane, metres, about their centre.
    widest : float
        Widest gap between profiles that is looked for, metres; never more than 0.45 of the patch.

    Returns
    -------
    array of int, shape (n,)

    Raises
    ------
    ValueError
        If no peak stands out of those that random points make.

    Notes
    -----
    The lines with the densest points win. Where points lie farther apart along a profile than
    profiles from each other, that is not the profile: give time or scan line then.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(-50, 51) * 0.01, np.arange(-5, 6) * 0.05)
    >>> number = profiles_from_pattern(np.stack([x.ravel(), y.ravel()], axis=1))
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
    coarse = _coarse_peak(centred, fading, slowest)
    wave = _refined(centred, fading, coarse, slowest)
    power = _power(centred, fading, wave)
    chance = 2 * np.log(len(xy)) + 10
    if power < chance:
        raise ValueError(
            f"Invalid pattern: its strongest lines have power {power:.0f} among {len(xy)} points. "
            f"Must be more than {chance:.0f}, what random points can reach; or give time."
        )
    turns = centred @ wave / (2 * np.pi)
    phase = np.angle((fading * np.exp(2j * np.pi * turns)).sum()) / (2 * np.pi)
    return np.round(turns - phase).astype(np.int64)


def _coarse_peak(xy, fading, slowest):
    """The fundamental of the structure factor on the grid of a histogram's transform.

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
    kx = np.fft.fftfreq(size, 1 / size) * np.pi / edge
    ky = np.arange(power.shape[1]) * np.pi / edge
    length = np.hypot(kx[:, None], ky)
    power[(length < slowest) | (length > 2 * np.pi / narrowest)] = 0
    high = np.argwhere(power >= SHARE * power.max())
    i, j = high[np.argmin(length[tuple(high.T)])]
    return np.array([kx[i], ky[j]])


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
