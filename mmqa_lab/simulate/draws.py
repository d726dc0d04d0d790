"""Random numbers by pulse: what a pulse draws depends on its number alone.

NumPy's generators yield streams; a drive that is cut into blocks, parts and fields of view would
have to draw for every pulse that it leaves out. SplitMix64 is a counter through a mixing function
and can be asked for any place of its stream (Steele, Lea & Flood 2014,
doi:10.1145/2660193.2660195).
"""

import numpy as np
from numba import njit, prange

from mmqa_lab._threads import enough_threads
from mmqa_lab.simulate.raycast import RAYS_A_THREAD

STEP = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
A_PULSE = 6


def draws(seed, pulse):
    """Return standard normal numbers (n, 3) and uniform numbers (n, 2) of pulses.

    Parameters
    ----------
    seed : int or sequence of int
        The same seed and pulse give the same numbers.
    pulse : array of int, shape (n,)

    Examples
    --------
    >>> normal, uniform = draws(1, np.arange(10))
    >>> bool((draws(1, np.arange(5, 10))[0] == normal[5:]).all())
    True
    """
    key = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    with enough_threads(len(pulse), RAYS_A_THREAD):
        return _draws(key, pulse.astype(np.uint64))


@njit(cache=True)
def _uniform(key, place):
    """Number between 0 (exclusive) and 1 at a place of the stream."""
    z = key + (place + np.uint64(1)) * STEP
    z = (z ^ (z >> np.uint64(30))) * FIRST
    z = (z ^ (z >> np.uint64(27))) * SECOND
    z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 0.5) * 2.0**-53


@njit(cache=True, parallel=True)
def _draws(key, pulse):
    """Normal numbers by Box and Muller from the first four of a pulse's six, then uniform ones."""
    normal, uniform = np.empty((len(pulse), 3)), np.empty((len(pulse), 2))
    for k in prange(len(pulse)):
        place = pulse[k] * np.uint64(A_PULSE)
        radius = np.sqrt(-2 * np.log(_uniform(key, place)))
        turn = 2 * np.pi * _uniform(key, place + np.uint64(1))
        normal[k, 0], normal[k, 1] = radius * np.cos(turn), radius * np.sin(turn)
        radius = np.sqrt(-2 * np.log(_uniform(key, place + np.uint64(2))))
        normal[k, 2] = radius * np.cos(2 * np.pi * _uniform(key, place + np.uint64(3)))
        uniform[k, 0] = _uniform(key, place + np.uint64(4))
        uniform[k, 1] = _uniform(key, place + np.uint64(5))
    return normal, uniform
