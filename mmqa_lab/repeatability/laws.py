"""What spread and dispersion to expect, in closed form and as fitted powers."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.planes import CONSISTENT_SCALE

STRIP = 0.4579
"""Half of the mean area between two jittered outlines, per perimeter and click error."""


@dataclass(frozen=True)
class PowerLaw:
    """y = factor x^exponent, fitted to the logarithms, with standard errors of ln and exponent.

    Parameters
    ----------
    exponent, standard_error : float
        The latter of the former.
    factor : float
        y at x = 1.
    n : int
        Pairs fitted.

    Examples
    --------
    >>> law = power_law([1, 2, 4], [5.0, 20.0, 80.0])
    >>> round(law.exponent, 9), round(law.standard_error, 9), round(law.factor, 9)
    (2.0, 0.0, 5.0)
    """

    exponent: float
    standard_error: float
    factor: float
    n: int


def strip_law(*, density, area, click, influence=1.0):
    """Predicted relative s_r of a figure when square selections of one random pattern vary.

    Two selections share all points but those in the strip between their outlines, whose mean area
    is 0.916 P click for the perimeter P. The figure changes by the chance in these points:
    s_r / value = influence sqrt(0.458 P click / density) / area, with P = 4 sqrt(area). So it falls
    with area^(-3/4) and density^(-1/2), not with the number of points alone.

    Parameters
    ----------
    density : float
        Points per square metre.
    area : float
        Of the selection, square metres.
    click : float
        Standard deviation of a vertex in each direction, m.
    influence : float
        Standard deviation of one point's influence over the value: 1 for the density,
        sqrt(1/2) for std, 1.166 for sigma_MAD of normal residuals (asymptotic).

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If density or area is not above zero or ``click`` is negative.

    Notes
    -----
    For a Poisson pattern; points on scan lines come in whole lines and vary otherwise.

    Examples
    --------
    >>> round(100 * strip_law(density=1712, area=0.5, click=0.015), 2)
    0.67
    """
    density = check_positive(density, "density", unit="points per m2")
    area = check_positive(area, "area", unit="m2")
    click = check_number(click, "click", low=0, unit="m")
    return float(influence * np.sqrt(STRIP * 4 * np.sqrt(area) * click / density) / area)


def contaminated_sigma_mad(share):
    """sigma_MAD of normal residuals over their standard deviation, with strays far to one side.

    The median moves to m, Phi(m) (1 - share) = 1/2, and d, half of the points about it, solves
    (1 - share) (Phi(m + d) - Phi(m - d)) = 1/2.

    Parameters
    ----------
    share : float
        Of all points, 0 to below 0.5.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the share lies outside 0 to 0.49.

    Examples
    --------
    >>> [round(contaminated_sigma_mad(share), 3) for share in (0, 0.05, 0.1)]
    [1.0, 1.065, 1.145]
    """
    from scipy.optimize import brentq
    from scipy.stats import norm

    share = check_number(share, "share", low=0, high=0.49)
    half = 0.5 / (1 - share)
    median = norm.ppf(half)
    d = brentq(lambda d: norm.cdf(median + d) - norm.cdf(median - d) - half, 0, 20)
    return float(CONSISTENT_SCALE * d)


def power_law(x, y):
    """Fit y = factor x^exponent by least squares on the logarithms.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        Above zero, n >= 3.

    Returns
    -------
    PowerLaw

    Raises
    ------
    ValueError
        If there are fewer than three pairs or one is not above zero.

    Examples
    --------
    >>> law = power_law([1, 4, 16, 64], [3.0, 1.5, 0.75, 0.375])
    >>> round(law.exponent, 6), round(law.factor, 6), law.n
    (-0.5, 3.0, 4)
    """
    import statsmodels.api as sm

    pairs = check_points(np.stack([x, y], axis=1), name="pairs", columns=2, minimum=3)
    if (pairs <= 0).any():
        raise ValueError(f"Invalid pairs: the smallest is {pairs.min()}. Must be > 0.")
    logarithms = np.log(pairs)
    fit = sm.OLS(logarithms[:, 1], sm.add_constant(logarithms[:, 0])).fit()
    intercept, exponent = fit.params
    return PowerLaw(float(exponent), float(fit.bse[1]), float(np.exp(intercept)), len(pairs))
