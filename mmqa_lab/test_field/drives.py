"""Drives of a cloud, errors over the distance from the path, and figures of errors."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    check_number,
    check_points,
    check_positive,
    check_row,
    check_together,
    refuse,
)
from mmqa_lab.stats import errors, mean_reach, student_reach

__all__ = ["GROSS", "LEAST_GROSS_M", "figures", "mean_ends", "split_drives", "thinned", "trend"]


GROSS, LEAST_GROSS_M = 5.0, 0.01
"""Gross errors are farther than this many NMAD, and farther than 1 cm, from the median."""


def split_drives(gps_time: ArrayLike, *, gap_s: float = 3600.0) -> np.ndarray:
    """Return the number of each point's drive; a gap in time begins a new drive.

    Parameters
    ----------
    gps_time : array_like, shape (n,)
        Seconds, in any order.
    gap_s : float
        Shortest gap between drives, s. Within an hour, one drive may pass a place more than once.

    Returns
    -------
    array of int, shape (n,)
        Counted from 0 in the order of time.

    Examples
    --------
    >>> split_drives([5.0, 90_000.0, 6.0, 90_001.0]).tolist()
    [0, 1, 0, 1]
    """
    time = check_row(gps_time, "gps_time")
    order = np.argsort(time, kind="stable")
    gap_s = check_number(gap_s, "gap_s", low=0, unit="s")
    number = np.cumsum(np.diff(time[order], prepend=time[order[0]]) > gap_s)
    return number[np.argsort(order)]


def thinned(points: ArrayLike, side: float) -> np.ndarray:
    """Return a point of each square in plan: the point nearest to its middle.

    Parameters
    ----------
    points : array_like, shape (n, 3)
    side : float
        Side of the squares, m.

    Returns
    -------
    array, shape (m, 3)

    Raises
    ------
    ValueError
        If a point is not finite or the side is not above zero.

    Examples
    --------
    >>> thinned([[0.1, 0.1, 0], [0.4, 0.5, 1], [1.5, 0.5, 2]], 1.0).tolist()
    [[0.4, 0.5, 1.0], [1.5, 0.5, 2.0]]
    """
    points = check_points(points)
    side = check_positive(side, "side", unit="m")
    local = points[:, :2] - np.floor(points[:, :2].min(axis=0) / side) * side
    cell, gap = local // side, np.hypot(*(local % side - side / 2).T)
    order = np.lexsort((*points.T, gap.round(9)))  # of points as near the order does not decide
    return points[order[np.unique(cell[order], axis=0, return_index=True)[1]]]


def trend(distance: ArrayLike, values: ArrayLike) -> pd.Series:
    """Fit a straight line to errors over distance, as in Figures 3-18 and 3-20 of the report.

    Parameters
    ----------
    distance : array_like, shape (n,)
        Metres from the trajectory.
    values : array_like, shape (n,)
        Errors in any unit; NaN are left out.

    Returns
    -------
    Series
        ``slope`` (errors' unit per metre), ``intercept``, ``slope_low``, ``slope_high`` (95 %),
        ``p`` (of no slope), ``n``.

    Raises
    ------
    ValueError
        If fewer than three values are left or all lie at one distance.

    Notes
    -----
    The interval holds for independent errors. Errors along a drive are not independent: a drift of
    the trajectory moves all points of a stretch together. The true interval is then wider.

    Examples
    --------
    >>> found = trend([5, 10, 15, 20], [6.0, 11.0, 16.0, 21.1])
    >>> found[["slope", "n"]].round(2).tolist()
    [1.01, 4.0]
    """
    from scipy.stats import linregress

    distance, values = check_together(distance=distance, values=values, missing=True)
    one_row = distance.ndim == 1 and distance.shape == values.shape
    refuse(not one_row, "errors", f"shape {values.shape}", "a row, each with its distance")
    known = np.isfinite(values) & np.isfinite(distance)
    distance, values = distance[known], values[known]
    if len(values) < 3 or np.ptp(distance) == 0:
        raise ValueError(
            f"Invalid errors: {len(values)} at {len(np.unique(distance))} distances. Must be three "
            "or more at different distances."
        )
    line = linregress(distance, values)
    half = student_reach(line.stderr, len(values) - 2)
    found = {"slope": line.slope, "intercept": line.intercept, "slope_low": line.slope - half}
    return pd.Series(found | {"slope_high": line.slope + half, "p": line.pvalue, "n": len(values)})


def figures(values, block):
    """Return the figures that heights and distances in plan share; a series of values in mm."""
    found = errors(values)
    share = mean_reach(values**2, block) / np.maximum(found.rmse**2, 1e-300) / 2
    return {
        "mean_mm": round(found.bias, 9) + 0.0,  # never -0
        "min_mm": values.min(),
        "max_mm": values.max(),
        "std_mm": found.std,
        "rmse_mm": found.rmse,
        "rmse_low_mm": found.rmse * np.exp(-share),
        "rmse_high_mm": found.rmse * np.exp(share),
    }


def mean_ends(name, values, block):
    """Return the 95 % interval of a mean, mm."""
    mean, reach = errors(values).bias, mean_reach(values, block)
    return {f"{name}_low_mm": mean - reach, f"{name}_high_mm": mean + reach}
