"""Rates, errors and means with their intervals. NaN means not measurable."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_count, check_row, check_together, real_array, refuse
from mmqa_lab._results import Shown
from mmqa_lab._streams import stream

__all__ = [
    "CONSISTENT_SCALE", "Errors", "Interval", "Rate", "bootstrap", "errors", "mean_interval",
    "rank_correlation", "student_reach", "wilson",
]  # fmt: skip


@dataclass(frozen=True)
class Interval(Shown):
    """A statistic and its 95 % interval.

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
        ``value`` from all rows; NaN bounds of a single row, or if fewer than half of the resamples
        are measurable.

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
    arrays = [real_array(v, "values", kinds="fiub") for v in values]
    if not all(a.ndim for a in arrays):
        raise ValueError("Invalid values without rows. Must be rows of equal lengths.")
    lengths = [len(a) for a in arrays]
    if len(set(lengths)) != 1 or not lengths[0]:
        raise ValueError(f"Invalid values of lengths {lengths}. Must be equal and above 0.")
    rng = stream(seed, "bootstrap")
    n = lengths[0]
    picked = (rng.integers(n, size=n) for _ in range(check_count(repeats, "repeats")))
    drawn = np.array([statistic(*(a[rows] for a in arrays)) for rows in picked])
    known = drawn[np.isfinite(drawn)]
    low, high = (
        np.quantile(known, [0.025, 0.975]) if 2 * len(known) >= repeats and n > 1 else [np.nan] * 2
    )
    return Interval(float(statistic(*arrays)), float(low), float(high))


def student_reach(std: ArrayLike, freedom: ArrayLike) -> np.ndarray:
    """Return half the 95 % interval of normal values with these standard deviations, by Student.

    Parameters
    ----------
    std : array_like
        Standard errors, in any unit.
    freedom : array_like
        Degrees of freedom with which they are known; below one there is no interval.

    Returns
    -------
    array
        In the unit of ``std``; NaN without freedom.

    Examples
    --------
    >>> student_reach(1.0, [1, 9, 1000]).round(3).tolist()
    [12.706, 2.262, 1.962]
    """
    std, freedom = real_array(std, "std"), real_array(freedom, "freedom")
    apart = {np.shape(std), np.shape(freedom)} - {()}
    refuse(len(apart) > 1, "std", f"shape {np.shape(std)}", f"as freedom, {np.shape(freedom)}")
    from scipy.special import stdtrit  # a third of the time in which a chart is imported

    return stdtrit(np.where(np.greater(freedom, 0), freedom, np.nan), 0.975) * std


def mean_interval(values: ArrayLike, *, of_next: bool = False) -> Interval:
    """Return the mean of independent values with its 95 % interval by Student's t.

    Parameters
    ----------
    values : array_like, shape (n,)
        NaN if not measurable.
    of_next : bool
        The interval of one more value in place of that of the mean.

    Returns
    -------
    Interval
        NaN ends with fewer than two values.

    Raises
    ------
    ValueError
        If a value is infinite.

    See Also
    --------
    mean_reach : of values that depend on their neighbours.

    Examples
    --------
    >>> found = mean_interval([1.0, 2.0, 3.0, np.nan])
    >>> found.value, round(found.low, 3), round(found.high, 3)
    (2.0, -0.484, 4.484)
    """
    values = check_row(np.ravel(real_array(values, "values")), "values", minimum=0, missing=True)
    values = values[~np.isnan(values)]
    n = len(values)
    if n < 2:
        return Interval(float(values[0]) if n else np.nan, np.nan, np.nan)
    mean, share = float(values.mean()), of_next + 1 / n
    reach = float(student_reach(values.std(ddof=1) * np.sqrt(share), n - 1))
    return Interval(mean, mean - reach, mean + reach)


def rank_correlation(rows: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Return Spearman's correlation of each row with the truth, over the cells that both have.

    Parameters
    ----------
    rows : array_like, shape (k, n)
        NaN if not measurable.
    truth : array_like, shape (n,)

    Returns
    -------
    array, shape (k,)
        NaN of a row without spread.

    Examples
    --------
    >>> rank_correlation([[1, 2, 4], [3, 2, np.nan]], [0.1, 0.5, 0.9]).round(9).tolist()
    [1.0, -1.0]
    """
    import pandas as pd

    rows, truth = check_together(rows=rows, truth=truth, missing=True)
    refuse((rows.ndim, truth.ndim) != (2, 1), "rows", f"shape {rows.shape}", "a table")
    with warnings.catch_warnings(action="ignore"):  # a row without spread has none
        found = pd.DataFrame(np.transpose(rows)).corrwith(pd.Series(truth), method="spearman")
    return found.to_numpy()


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
    import pandas as pd

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
