"""Rates and errors: recall and precision, RMSE, bias, NMAD. NaN means not measurable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count, real_array
from mmqa_lab._results import Shown

__all__ = ["CONSISTENT_SCALE", "Errors", "Rate", "errors", "wilson"]


CONSISTENT_SCALE = 1.482602218505602
"""1 / Phi^-1(3/4): the standard deviation of normal errors over their median absolute deviation."""


@dataclass(frozen=True)
class Rate(Shown):
    """A share of successes and its Wilson interval.

    Parameters
    ----------
    k, n : int
        Successes and trials.
    value, low, high : float
        k / n and the ends of the interval; NaN for n = 0.

    Examples
    --------
    >>> found = wilson(8, 10)
    >>> found.value, found.low < 0.5 < found.high
    (0.8, True)
    """

    k: int
    n: int
    value: float
    low: float
    high: float

    def _ends(self):
        return [("share", self.value, self.low, self.high, "1")]

    def __str__(self):
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}] ({self.k}/{self.n})"


def wilson(k: int, n: int) -> Rate:
    """Return the rate k / n with its Wilson score interval of 95 %.

    Parameters
    ----------
    k, n : int
        Successes and trials; n may be 0.

    Returns
    -------
    Rate

    Raises
    ------
    ValueError
        If k > n, or if k or n is not a count.

    Notes
    -----
    The interval never leaves [0, 1] and is not empty at k = 0 or k = n. It holds for independent
    trials. Poles of the same street are not quite independent.

    References
    ----------
    Wilson 1927, Journal of the American Statistical Association 22, 209-212,
    doi:10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> print(wilson(230, 330))
    0.697 [0.645, 0.744] (230/330)
    """
    from scipy.stats import binomtest

    n, k = check_count(n, "n", low=0), check_count(k, "k", low=0)
    if k > n:
        raise ValueError(f"Invalid k {k}. Must be <= n = {n}.")
    if n == 0:
        return Rate(0, 0, np.nan, np.nan, np.nan)
    return Rate(k, n, k / n, *map(float, binomtest(k, n).proportion_ci(method="wilson")))


@dataclass(frozen=True)
class Errors(Shown):
    """Statistics of errors, in the unit of the errors; NaN if there are too few.

    Parameters
    ----------
    n, missing : int
        Number of errors used, and number of NaN.
    bias : float
        Mean.
    std : float
        Standard deviation about the mean, n - 1; NaN below two.
    rmse : float
        Root of the mean square.
    median, nmad : float
        Median, and 1.4826 times the median absolute deviation from it.

    Examples
    --------
    >>> found = errors([3.0, -3.0, np.nan])
    >>> found.n, found.missing, found.bias, found.rmse
    (2, 1, 0.0, 3.0)
    """

    n: int
    missing: int
    bias: float
    std: float
    rmse: float
    median: float
    nmad: float


def errors(values: ArrayLike) -> Errors:
    """Return the statistics of errors (obtained minus reference).

    Parameters
    ----------
    values : array_like, shape (n,)
        NaN if not measured; these are counted in ``missing``.

    Returns
    -------
    Errors

    Raises
    ------
    ValueError
        If an error is infinite.

    See Also
    --------
    mmqa_lab.planes.sigma_mad : the noise of points about a fitted plane.

    Examples
    --------
    >>> errors([1.0, -1.0, 3.0]).bias, round(errors([1.0, -1.0, 3.0]).rmse, 3)
    (1.0, 1.915)
    """
    values = real_array(values, "errors").astype(np.float64).ravel()
    if np.isinf(values).any():
        raise ValueError("Invalid errors: infinite. Must be finite, or NaN where not measured.")
    known = pd.Series(values).dropna()
    return Errors(
        n=len(known),
        missing=len(values) - len(known),
        bias=float(known.mean()),
        std=float(known.std(ddof=1)),
        rmse=float(np.sqrt((known**2).mean())),
        median=float(known.median()),
        nmad=float(CONSISTENT_SCALE * (known - known.median()).abs().median()),
    )
