"""Which profile a point belongs to: from time, or from the pattern alone."""

from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_positive

SHARE = 0.35
"""Of the strongest peak: weaker ones are not taken for the fundamental."""


def revolutions_from_time(time, *, mirror_frequency_hz=None):
    """Return the number of the revolution of each point, from 0.

    A revolution ends in the longest pause of its phase: while the beam is off the patch.

    Parameters
    ----------
    time : array_like, shape (n,)
        Seconds.
    mirror_frequency_hz : float, optional
        Estimated from the pauses where left out.

    Returns
    -------
    array of int, shape (n,)

    Raises
    ------
    ValueError
        If the frequency is left out and there are no pauses.

    Examples
    --------
    >>> pulses = np.arange(5) * 1e-5
    >>> revolutions_from_time(np.concatenate([pulses, pulses + 0.01, pulses + 0.03])).tolist()
    [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 3, 3, 3, 3, 3]
    """
    since = np.asarray(time, dtype=np.float64) - np.min(time)
    if mirror_frequency_hz is None:
        frequency = _frequency(since)
    else:
        frequency = check_positive(mirror_frequency_hz, "mirror_frequency_hz", unit="Hz")
    phase = np.sort(since * frequency % 1)
    pause = np.diff(np.append(phase, phase[0] + 1))
    cut = phase[np.argmax(pause)] + pause.max() / 2
    number = np.floor(since * frequency - cut).astype(np.int64)
    return number - number.min()


def _frequency(since):
    """Revolutions per second from the pauses between profiles."""
    order = np.sort(since)
    step = np.diff(order)
    typical = np.median(step[step > 0]) if (step > 0).any() else 0.0
    pauses = np.flatnonzero(step > 20 * typical)
    if typical == 0 or not len(pauses):
        raise ValueError(
            "Invalid time without pauses between profiles. Must have a mirror_frequency_hz or a "
            "scan_line with it."
        )
    edges = np.concatenate([[0], pauses + 1, [len(order)]])
    middles = [(order[i] + order[j - 1]) / 2 for i, j in pairwise(edges)]
    period = np.median(np.diff(middles))
    number = np.concatenate([[0], np.cumsum(np.maximum(np.round(np.diff(middles) / period), 1))])
    return 1 / np.polyfit(number, middles, 1)[0]


def profiles_from_pattern(xy, *, widest=0.5):
    """Return the number of the profile of each point, found from the pattern alone.

    The structure factor |sum exp(i k.p)|^2 / n has its peaks where points lie on lines 2 pi / |k|
    apart. The fundamental is the smallest k whose peak reaches 35 % of the highest.

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
    """
    xy = np.asarray(xy, dtype=np.float64)
    wave = _refined(xy, _coarse_peak(xy, widest))
    power = _power(xy, wave)
    chance = 2 * np.log(len(xy)) + 10
    if power < chance:
        raise ValueError(
            f"Invalid pattern: its strongest lines have power {power:.0f} among {len(xy)} points. "
            f"Must be more than {chance:.0f}, what random points can reach; or give time."
        )
    turns = xy @ wave / (2 * np.pi)
    phase = np.angle(np.exp(2j * np.pi * turns).sum()) / (2 * np.pi)
    return np.round(turns - phase).astype(np.int64)


def _coarse_peak(xy, widest):
    """The fundamental of the structure factor on the grid of a histogram's transform.

    Where rows are denser than they are apart, they are more than 0.9 / sqrt(density) apart; half of
    that makes room for patches that do not fill their box.
    """
    extent = np.ptp(xy, axis=0)
    edge, narrowest = 1.25 * extent.max(), 0.5 * np.sqrt(extent.prod() / len(xy))
    size = int(2 ** np.ceil(np.log2(5 * edge / narrowest)))
    size = min(max(size, 64), 4096)
    cell = np.floor((xy / edge + 1) * size / 2).astype(np.int64)
    counts = np.bincount(cell @ [size, 1], minlength=size**2).reshape(size, size)
    power = np.abs(np.fft.rfft2(counts)) ** 2 / len(xy)
    kx = np.fft.fftfreq(size, 1 / size) * np.pi / edge
    ky = np.arange(power.shape[1]) * np.pi / edge
    length = np.hypot(kx[:, None], ky)
    widest = min(widest, 0.45 * extent.max())
    power[(length < 2 * np.pi / widest) | (length > 2 * np.pi / narrowest)] = 0
    high = np.argwhere(power >= SHARE * power.max())
    i, j = high[np.argmin(length[tuple(high.T)])]
    return np.array([kx[i], ky[j]])


def _refined(xy, wave):
    """The peak of the structure factor near a wave vector."""
    from scipy.optimize import minimize

    step = 2 * np.pi / np.ptp(xy, axis=0).max()
    around = 0.25 * step * np.array([[i, j] for i in range(-4, 5) for j in range(-4, 5)])
    start = max(wave + around, key=lambda k: _power(xy, k))
    simplex = start + 0.2 * step * np.array([[0, 0], [0.5, 0], [0, 0.5]])
    options = {"xatol": 1e-5 * step, "fatol": 1e-9, "initial_simplex": simplex}
    return minimize(lambda k: -_power(xy, k), start, method="Nelder-Mead", options=options).x


def _power(xy, wave):
    """Structure factor at one wave vector."""
    return np.abs(np.exp(1j * (xy @ wave)).sum()) ** 2 / len(xy)
