"""Intervals of statistics of independent values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count
from mmqa_lab._results import Shown

__all__ = ["Interval", "bootstrap"]


@dataclass(frozen=True)
class Interval(Shown):
    """A statistic and its bootstrap percentile interval.

    Parameters
    ----------
    value, low, high : float

    Examples
    --------
    >>> mean = bootstrap(np.mean, [1.0, 2.0, 3.0, 4.0], repeats=200)
    >>> mean.value, mean.low < mean.value < mean.high
    (2.5, True)
    """

    value: float
    low: float
    high: float

    def _ends(self):
        return [("statistic", self.value, self.low, self.high, "")]


def bootstrap(
    statistic: Callable[..., float], *values: ArrayLike, repeats: int = 1000, seed: int = 0
) -> Interval:
    """Return a statistic with a percentile bootstrap interval of 95 %.

    Parameters
    ----------
    statistic : callable
        Takes the arrays and returns a float, NaN if not measurable.
    *values : array_like, shape (n, ...)
        Resampled together by rows. Paired statistics have several arrays.
    repeats : int
    seed : int

    Returns
    -------
    Interval
        ``value`` from all rows; NaN bounds if fewer than half of the resamples are measurable.

    Raises
    ------
    ValueError
        If the arrays have different lengths or none, or ``repeats`` is below 1.

    See Also
    --------
    median_interval : of a median of values that depend on their neighbours.
    mean_reach : of a mean of such values.

    References
    ----------
    Efron 1979, Annals of Statistics 7, 1-26, doi:10.1214/aos/1176344552.

    Examples
    --------
    >>> found = bootstrap(np.mean, np.arange(101.0))
    >>> found.value, found.low < 50 < found.high
    (50.0, True)
    """
    arrays = [np.asarray(v) for v in values]
    lengths = [len(a) for a in arrays]
    if len(set(lengths)) != 1 or not lengths[0]:
        raise ValueError(f"Invalid values of lengths {lengths}. Must be equal and above 0.")
    rng = np.random.default_rng(seed)
    n = lengths[0]
    picked = (rng.integers(n, size=n) for _ in range(check_count(repeats, "repeats")))
    drawn = np.array([statistic(*(a[rows] for a in arrays)) for rows in picked])
    known = drawn[np.isfinite(drawn)]
    low, high = np.quantile(known, [0.025, 0.975]) if 2 * len(known) >= repeats else [np.nan] * 2
    return Interval(float(statistic(*arrays)), float(low), float(high))
