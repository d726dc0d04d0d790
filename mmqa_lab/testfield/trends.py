"""Errors as a function of the distance from the trajectory."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_number, check_plan
from mmqa_lab._polygons import path_distance


@dataclass(frozen=True)
class Trend:
    """A robust straight line through errors over distance.

    Parameters
    ----------
    slope, intercept : float
        Errors' unit per metre, errors' unit at distance 0.
    slope_low, slope_high : float
        Confidence interval of the slope.
    p : float
        P-value of no slope.
    n : int

    Examples
    --------
    >>> line = trend([0, 10, 20, 30], [1.0, 2.0, 3.0, 4.0])
    >>> round(line.slope, 6), round(float(line.at(50)), 6)
    (0.1, 6.0)
    """

    slope: float
    intercept: float
    slope_low: float
    slope_high: float
    p: float
    n: int

    def at(self, distance):
        """The line at distances in metres."""
        return self.intercept + self.slope * np.asarray(distance, dtype=np.float64)


def trend(distance, values, *, confidence=0.95):
    """Fit a straight line of errors over distance, robustly.

    Huber's estimator (statsmodels RLM), so that a few far poles do not tilt the line; its standard
    error with Student's t of n - 2, which few poles need.

    Parameters
    ----------
    distance : array_like, shape (n,)
        Metres from the trajectory.
    values : array_like, shape (n,)
        Errors in any unit; NaN are left out.
    confidence : float
        Of the slope's interval.

    Returns
    -------
    Trend

    Raises
    ------
    ValueError
        If fewer than three values are left or all lie at one distance.

    Notes
    -----
    The interval takes errors as independent. Along one drive they are not: a drift of the
    trajectory moves all points of a stretch together, and the true interval is wider.

    Examples
    --------
    >>> found = trend([5, 10, 15, 20], [6.0, 11.0, 16.0, 21.1])
    >>> round(found.slope, 2), found.n
    (1.01, 4)
    """
    from scipy.stats import t
    from statsmodels.robust.robust_linear_model import RLM

    distance, values = np.asarray(distance, np.float64), np.asarray(values, np.float64)
    known = np.isfinite(values) & np.isfinite(distance)
    distance, values = distance[known], values[known]
    if len(values) < 3 or np.ptp(distance) == 0:
        raise ValueError(
            f"Invalid errors: {len(values)} at {len(np.unique(distance))} distances. Must be three "
            "or more at different distances."
        )
    outside = 1 - check_number(confidence, "confidence", low=0, high=1)
    design = np.stack([np.ones_like(distance), distance], axis=1)
    if np.ptp(values - np.poly1d(np.polyfit(distance, values, 1))(distance)) < 1e-12:
        intercept, slope = np.linalg.lstsq(design, values, rcond=None)[0]
        return Trend(float(slope), float(intercept), float(slope), float(slope), 0.0, len(values))
    fit = RLM(values, design).fit()
    (intercept, slope), std = fit.params, fit.bse[1]
    half = t.isf(outside / 2, len(values) - 2) * std
    p = 2 * t.sf(np.abs(slope) / std, len(values) - 2)
    numbers = (slope, intercept, slope - half, slope + half, p)
    return Trend(*(float(number) for number in numbers), len(values))


def distance_to_path(points, path):
    """Return the distance in plan of points from a path.

    Parameters
    ----------
    points : array_like, shape (n, 2 or 3)
        Metres.
    path : array_like, shape (m, 2 or 3), or DataFrame
        Vertices in order, m >= 2, or a table with ``easting_m`` and ``northing_m``.

    Returns
    -------
    array, shape (n,)

    Raises
    ------
    ValueError
        If the path has fewer than two vertices or a value is not finite.

    Examples
    --------
    >>> distance_to_path([[3, 5, 0], [0, 14, 0]], [[0, 0], [0, 10]]).tolist()
    [3.0, 4.0]
    """
    path = check_plan(path, name="path", minimum=2)
    points = check_plan(points)
    origin = path.mean(axis=0).round()
    return path_distance(points - origin, path - origin)
