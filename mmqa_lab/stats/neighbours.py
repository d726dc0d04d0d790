"""Intervals of means and medians of values that depend on their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_plan, check_row, real_array, refuse
from mmqa_lab.stats.intervals import student_reach

__all__ = ["WAVE_PARTS", "mean_reach", "median_interval", "median_ratio_interval", "order_parts"]


HALF_WAVES = np.arange(3, 11)
"""Numbers of half waves over the points, for the errors that neighbours share. A single one would
count a trend as an error. Odd numbers alone are zero in the middle, even ones alone between there
and the edges, where the few lines may lie that decide a median."""


WAVE_PARTS = 256


ORDER_CELLS = 1 << 16  # of the extent of points, in which they are counted


def _waves_over_parts():
    """Waves (k, WAVE_PARTS) without what is a polynomial of second degree; mean 0, mean square 1.

    Neither a trend nor a bowl, as from points at the edges that lack neighbours, is then an error.
    """
    place = (np.arange(WAVE_PARTS) + 0.5) / WAVE_PARTS
    waves, smooth = np.cos(np.pi * HALF_WAVES[:, None] * place), np.vander(place, 3).T
    waves -= waves @ np.linalg.pinv(smooth) @ smooth
    return waves / np.sqrt((waves**2).mean(axis=1, keepdims=True))


COSINES = _waves_over_parts()
"""The waves in parts of equal numbers of points."""


def order_parts(xy: ArrayLike, direction: float) -> np.ndarray:
    """Number the points by their order across a direction and along it, for slow waves.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates in a plane.
    direction : float
        Degrees counter-clockwise from the first axis, the direction of scan lines. The points of a
        line then get nearly the same number across.

    Returns
    -------
    array of int, shape (2, n)
        0 to 255: which of 256 parts of equal numbers of points; points at the same place are in
        the same part. The waves are cosines over these parts, see ``HALF_WAVES``.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(40), np.arange(16))
    >>> order_parts(np.stack([x.ravel(), y.ravel()], axis=1), 0)[:, [0, 39, 639]].tolist()
    [[8, 8, 248], [3, 252, 252]]
    """
    turn = np.radians(direction)
    along = np.array([np.cos(turn), np.sin(turn)])
    places = check_plan(xy, name="xy") @ np.column_stack([[-along[1], along[0]], along])
    return np.array([_parts(way) for way in places.T])


def _parts(places):
    """Part of each place (n,) by their order; without sorting, unless a cell holds a whole part."""
    cells = ((places - places.min()) * (ORDER_CELLS / max(np.ptp(places), 1e-300))).astype(np.intp)
    counts = np.bincount(cells)
    if counts.max() * WAVE_PARTS > len(places):
        _, cells, counts = np.unique(places, return_inverse=True, return_counts=True)
    return ((np.cumsum(counts) - counts / 2) * WAVE_PARTS / len(places)).astype(np.intp)[cells]


def mean_reach(values: ArrayLike, block: ArrayLike) -> float:
    """Return half the 95 % interval of a mean of values that depend on their neighbours.

    The standard error follows from the sums over blocks, which are nearly independent if the
    dependence is short, or from the sums over slow waves (Lazarus et al. 2018). Student's t of the
    number of sums turns it into an interval.

    Parameters
    ----------
    values : array_like, shape (n,)
    block : array_like of int, shape (n,), (2, n) or (4, n)
        The block of each value, see :func:`mmqa_lab.spacing.block_numbers`, or one or two pairs of
        :func:`order_parts`.

    Returns
    -------
    float
        In the unit of the values; NaN with fewer than two blocks.

    References
    ----------
    Lazarus, Lewis, Stock and Watson 2018, HAR inference: recommendations for practice.
    doi:10.1080/07350015.2018.1506926

    Examples
    --------
    >>> bool(mean_reach([1.0, 3.0, 1.0, 3.0], [0, 0, 1, 1]) == 0)  # each block has the mean
    True
    """
    values, block = _in_blocks(block, values)
    n = max(len(values), 1)
    return float(_reach((values - values.sum() / n)[None] / n, block)[0])


def _check_order(values, name, minimum):
    """A row of float64 whose order counts: infinity is a large value, NaN one that is missing."""
    row = real_array(values, name).astype(np.float64)
    check_row(row[np.isfinite(row)] if row.ndim == 1 else row, name, minimum=minimum)
    return row


def _in_blocks(block, *rows, missing=False):
    """Rows of values as float64 and the whole numbers of their blocks, of one length."""
    check = _check_order if missing else check_row
    rows = [check(row, "values", minimum=0) for row in rows]
    block = real_array(block, "block", kinds="iu")
    lengths = {*map(len, rows), block.shape[-1] if block.ndim else -1}
    found = f"lengths {', '.join(map(str, sorted(lengths)))}"
    wrong = len(lengths) > 1 or block.min(initial=0) < 0
    refuse(wrong, "values and blocks", found, "alike, from 0")
    return *rows, block


def median_interval(values: ArrayLike, block: ArrayLike) -> tuple[float, float]:
    """Return the 95 % interval of a median of values that depend on their neighbours.

    The share of values below the median has an interval like a mean, see :func:`mean_reach`. The
    quantiles of the values turn it into an interval of the median.

    Parameters
    ----------
    values : array_like, shape (n,)
        NaN if not measurable; infinity is a large value.
    block : array_like of int, shape (n,), (2, n) or (4, n)
        The block of each value, see :func:`mmqa_lab.spacing.block_numbers`, or one or two pairs of
        :func:`order_parts`.

    Returns
    -------
    low, high : float
        NaN with fewer than two blocks.

    See Also
    --------
    bootstrap : of any statistic, where the values are independent.

    References
    ----------
    Woodruff 1952, Confidence intervals for medians and other position measures.
    doi:10.1080/01621459.1952.10483443

    Examples
    --------
    >>> values = np.random.default_rng(1).normal(5, 1, 1600)
    >>> low, high = median_interval(values, np.arange(1600) % 16)
    >>> bool(low < 5 < high), bool(high - low < 0.2)
    (True, True)
    """
    values, block = _in_blocks(block, values, missing=True)
    known = ~np.isnan(values)
    values, block = values[known], block[..., known]
    return _quantiles_about(values, _reach(_influence(values[None]), block)[0])


def median_ratio_interval(
    top: ArrayLike, bottom: ArrayLike, block: ArrayLike
) -> tuple[float, float]:
    """Return the 95 % interval of median(top) / median(bottom), both of the same places.

    The interval of the logarithm follows from the intervals of both medians and the correlation of
    their errors.

    Parameters
    ----------
    top, bottom : array_like, shape (n,)
        Positive; NaN if not measurable.
    block : array_like of int, shape (n,), (2, n) or (4, n)
        As for :func:`median_interval`.

    Returns
    -------
    low, high : float
        NaN if one of the medians has no interval.

    Examples
    --------
    >>> values = np.random.default_rng(1).uniform(1, 3, 1600)
    >>> low, high = median_ratio_interval(2 * values, values, np.arange(1600) % 16)
    >>> round(low, 6), round(high, 6)
    (2.0, 2.0)
    """
    top, bottom, block = _in_blocks(block, top, bottom, missing=True)
    known = ~(np.isnan(top) | np.isnan(bottom))
    both, block = np.array([top, bottom])[:, known], block[..., known]
    first, second = _influence(both)
    reaches = _reach(np.array([first, second, first - second, first + second]), block)
    ends = np.array([_quantiles_about(*one) for one in zip(both, reaches[:2], strict=True)])
    if not (np.isfinite(ends) & (ends > 0)).all():
        return np.nan, np.nan
    halves = np.log(ends[:, 1] / ends[:, 0]) / 2
    apart, summed = reaches[2:] ** 2
    lengths = 4 * np.prod(reaches[:2])
    together = np.clip((summed - apart) / lengths, -1, 1) if lengths > 0 else 0.0
    reach = np.sqrt(max(halves @ halves - 2 * together * np.prod(halves), 0.0))
    ratio = np.divide(*(np.median(values[~np.isnan(values)]) for values in (top, bottom)))
    return float(ratio * np.exp(-reach)), float(ratio * np.exp(reach))


def _quantiles_about(values, reach):
    """The values at a half less and a half plus a share, which enclose the median."""
    if np.isnan(reach):
        return np.nan, np.nan
    shares = np.clip([0.5 - reach, 0.5 + reach], 0, 1)
    ranks = np.rint(shares * (len(values) - 1)).astype(int)
    low, high = np.partition(values, ranks)[ranks]
    middle = np.median(values)  # between two values where their number is even
    return float(min(low, middle)), float(max(high, middle))


def _influence(rows):
    """The part of each value in the error of the share of its row below the median."""
    if not rows.size:
        return rows
    middles = np.median(rows, axis=1, keepdims=True)
    signs = ((rows > middles) - 1.0 * (rows < middles)) / 2
    return (signs - signs.mean(axis=1, keepdims=True)) / rows.shape[1]


def _reach(rows, block):
    """Half the 95 % interval of each row's sum, zero on average; NaN with fewer than two blocks."""
    ways = np.asarray(block)
    if not rows.size:
        return np.full(len(rows), np.nan)
    if ways.ndim > 1:  # of two pairs of waves, the wider interval counts
        pairs = zip(ways[::2], ways[1::2], strict=True)
        return np.max([_reach_by_waves(rows, *pair) for pair in pairs], axis=0)
    filled = np.bincount(ways) > 0
    count = np.count_nonzero(filled)
    if count < 2:
        return np.full(len(rows), np.nan)
    sums = np.array([np.bincount(ways, row)[filled] for row in rows])
    return student_reach(np.sqrt((sums**2).sum(axis=1) * count / (count - 1)), count - 1)


def _reach_by_waves(rows, across, along):
    """Half the 95 % interval of each row's sum, from its sums over waves.

    The variances by both ways are added, and the variance by the products of their waves, which
    no whole line shares, is subtracted (Cameron, Gelbach and Miller 2011,
    doi:10.1198/jbes.2010.07136).
    """
    places, count = across * WAVE_PARTS + along, len(COSINES)
    table = np.array([np.bincount(places, row, WAVE_PARTS**2) for row in rows])
    table = table.reshape(len(rows), WAVE_PARTS, WAVE_PARTS)
    apart = ((COSINES @ table @ COSINES.T) ** 2).mean(axis=(1, 2))
    sums = sum(((table.sum(axis=way) @ COSINES.T) ** 2).mean(axis=1) for way in (1, 2))
    variances = np.maximum(sums - apart, apart)
    share = 1 - apart / np.maximum(variances, 1e-300)  # of what whole lines share
    freedom = 1 / (share**2 / count + (1 - share) ** 2 / count**2)
    return student_reach(np.sqrt(variances), freedom)
