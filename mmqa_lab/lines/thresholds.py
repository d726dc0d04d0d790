"""Where the nearest distances of true pairs end: the threshold on the similarity matrix."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice, check_count, check_positive

PLACES = ("below", "index", "middle", "value")
MAD_FACTOR = 3 * 1.482602218505602
"""Median + 3 sigma_MAD."""


@dataclass(frozen=True, eq=False)
class Threshold:
    """A threshold and how it was found.

    Parameters
    ----------
    delta : float
        Pairs with d <= delta correspond, m; NaN when there is no distance.
    fallback : bool
        No jump was found: delta is the largest nearest distance and accepts every row's nearest.
    nearest : array, shape (n,)
        The nearest distances in ascending order, m.
    peak : int or None
        Index of the peak in the differences of ``nearest``.

    Examples
    --------
    >>> found = peak_threshold([0.3, 0.4, 0.5])
    >>> found.delta, found.fallback  # no jump: the largest
    (0.5, True)
    """

    delta: float
    fallback: bool
    nearest: np.ndarray
    peak: int | None = None


def peak_threshold(nearest, *, sensitivity=0.5, order=2, at="below", sort_again=False):
    """Threshold at the first peak of the differences of the sorted nearest distances.

    The distances are sorted, differenced ``order`` times, and searched for the first maximum
    that stands out by ``sensitivity`` (a running maximum is a peak once the curve falls by more
    than that; the curve returns to zero behind its end). The threshold is the last distance before
    the jump. Peaks at or below zero are no jumps.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.
    sensitivity : float
        How far a peak must stand out, m. The paper gives no value; 0.4-0.8 m work alike on the
        simulated canyon, 0.1 m or 2 m do not. It decides more than W does.
    order : {2, 1}
        Second differences as in the paper, or first.
    at : {"below", "index", "middle", "value"}
        The distance before the jump (our reading), the first that the difference spans, the middle
        of the jump, or the value of the difference itself, which is what the paper says literally.
    sort_again : bool
        Sort the first differences before they are differenced again, another reading of "the new
        list".

    Returns
    -------
    Threshold

    Raises
    ------
    ValueError
        If the sensitivity is not above zero, or ``order`` or ``at`` is another.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2.3 and figure 3.

    Examples
    --------
    >>> nearest = [0.31, 0.33, 0.36, 0.40, 0.41, 0.47, 0.52, 0.55, 3.2, 4.1, 7.7]
    >>> peak_threshold(nearest).delta
    0.55
    """
    nearest = _sorted(nearest)
    sensitivity = check_positive(sensitivity, "sensitivity", unit="m")
    check_choice(order, "order", (1, 2))
    check_choice(at, "at", PLACES)
    curve = np.diff(np.sort(np.diff(nearest))) if sort_again else np.diff(nearest, order)
    peak = _first_peak(curve, sensitivity)
    if peak is None:
        return _without_jump(nearest)
    jump = peak + order - 1
    values = {
        "below": nearest[jump],
        "index": nearest[peak],
        "middle": (nearest[jump] + nearest[jump + 1]) / 2,
        "value": curve[peak],
    }
    return Threshold(float(values[at]), False, nearest, peak)


def fixed_threshold(nearest, *, delta):
    """A threshold chosen beforehand, m.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.
    delta : float
        Metres.

    Returns
    -------
    Threshold

    Raises
    ------
    ValueError
        If ``delta`` is not above zero.

    Examples
    --------
    >>> fixed_threshold([0.7, 0.2, 3.0], delta=1.0).nearest.tolist()
    [0.2, 0.7, 3.0]
    """
    return Threshold(check_positive(delta, "delta", unit="m"), False, _sorted(nearest))


def mad_threshold(nearest):
    """Median plus three sigma_MAD; fails where fewer than half of the rows have a partner.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.

    Returns
    -------
    Threshold

    Examples
    --------
    >>> round(mad_threshold([0.1, 0.2, 0.3, 0.4, 9.0]).delta, 3)  # 0.3 + 3 x 1.4826 x 0.1
    0.745
    """
    nearest = _sorted(nearest)
    if not len(nearest):
        return _without_jump(nearest)
    median = np.median(nearest)
    delta = median + MAD_FACTOR * np.median(np.abs(nearest - median))
    return Threshold(float(delta), False, nearest)


def otsu_threshold(nearest):
    """Split of the logarithms of the distances with the largest variance between the classes.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.

    Returns
    -------
    Threshold

    References
    ----------
    Otsu 1979, doi:10.1109/TSMC.1979.4310076, on the sample instead of a histogram.

    Examples
    --------
    >>> otsu_threshold([0.1, 0.2, 0.15, 0.18, 5.0, 6.0, 7.0]).delta
    0.2
    """
    nearest = _sorted(nearest)
    if len(nearest) < 2:
        return _without_jump(nearest)
    logs = _logs(nearest)
    below = np.cumsum(logs)[:-1]
    count = np.arange(1, len(logs))
    between = (logs.mean() * count - below) ** 2 / (count * (len(logs) - count))
    return Threshold(float(nearest[np.argmax(between)]), False, nearest)


def mixture_threshold(nearest, *, rounds=200):
    """Where the nearer of two normal distributions of the log distances ceases to be the likelier.

    Expectation-maximisation from the split of :func:`otsu_threshold`; ``rounds`` at most.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.
    rounds : int
        Most iterations.

    Returns
    -------
    Threshold

    Raises
    ------
    ValueError
        If ``rounds`` is below one.

    Examples
    --------
    >>> mixture_threshold([0.1, 0.2, 0.15, 0.18, 5.0, 6.0, 7.0]).delta
    0.2
    """
    rounds = check_count(rounds, "rounds")
    start = otsu_threshold(nearest)
    nearest, near = start.nearest, start.nearest <= start.delta
    if start.fallback or near.all() or len(nearest) < 4:
        return start
    logs, share = _logs(nearest), near.astype(float)
    for _ in range(rounds):
        previous, share = share, _responsibilities(logs, share)
        if np.abs(share - previous).max() < 1e-6:
            break
    accepted = (share >= 0.5) & (logs <= np.average(logs, weights=1 - share + 1e-12))
    if not accepted.any():
        return start
    return Threshold(float(nearest[accepted].max()), False, nearest)


def _sorted(nearest):
    """Finite distances in ascending order."""
    nearest = np.asarray(nearest, dtype=np.float64)
    if nearest.ndim != 1 or not np.isfinite(nearest).all() or (nearest < 0).any():
        raise ValueError(
            f"Invalid nearest distances of shape {nearest.shape}. "
            "Must be a row of finite numbers >= 0 m."
        )
    return np.sort(nearest)


def _without_jump(nearest):
    """All rows accepted with their nearest."""
    return Threshold(float(nearest[-1]) if len(nearest) else np.nan, True, nearest)


def _first_peak(curve, sensitivity):
    """Index of the first positive maximum that the curve falls below by the sensitivity."""
    high, low, place, climbing = -np.inf, np.inf, 0, True
    for index, value in enumerate([*curve, 0.0]):
        low = min(low, value)
        if value > high:
            high, place = value, index
        if climbing and value < high - sensitivity:
            if high > 0:
                return place
            low, climbing = value, False
        elif not climbing and value > low + sensitivity:
            high, place, climbing = value, index, True
    return None


def _logs(nearest):
    """Logarithms, with a micrometre for identical segments."""
    return np.log(np.maximum(nearest, 1e-6))


def _responsibilities(logs, share):
    """One round of expectation-maximisation for two normal distributions."""
    densities = []
    for weights in (share, 1 - share):
        total = weights.sum() + 1e-12
        mean = weights @ logs / total
        variance = max(weights @ (logs - mean) ** 2 / total, 1e-4)
        exponent = -((logs - mean) ** 2) / (2 * variance)
        densities.append(total * np.exp(exponent) / np.sqrt(variance) + 1e-300)
    return densities[0] / (densities[0] + densities[1])
