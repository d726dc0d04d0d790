"""Least squares of all profiles of a patch at once."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.planes import sigma_mad

OFF_LINE = 4.0
"""Points farther off their profile, in robust standard deviations, are left out."""

MANY = 150
"""Points from which on curvature, twist and the turning of the beam are fitted too."""


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """Parallel profiles in the plane: x along them, y across, both from the reference.

    Parameters
    ----------
    turn : float
        Angle of x from the first axis of the plane, radians.
    x, y, off : array, shape (n,)
        Points used, metres; ``off`` is the distance from the plane.
    profile : array of int, shape (n,)
        Place of each point's profile in ``numbers``.
    used : array of int, shape (n,)
        Which of the given points these are.
    numbers, counts : array, shape (m,)
        The profiles.
    offsets, variances : array, shape (m,)
        y of each profile at x = 0 (metres) and its variance from the scatter along the profile.
    means : array, shape (m, p)
        Means of the shared terms over each profile.
    covariance : array, shape (p, p)
        Of the coefficients of the shared terms; the first is the slope.
    slide : float
        Metres across the profiles for each metre off the plane: how range noise moves points.
    """

    turn: float
    x: np.ndarray
    y: np.ndarray
    off: np.ndarray
    profile: np.ndarray
    used: np.ndarray
    numbers: np.ndarray
    counts: np.ndarray
    offsets: np.ndarray
    variances: np.ndarray
    means: np.ndarray
    covariance: np.ndarray
    slide: float


def fit_profiles(uv, off, numbers, *, turn, fewest=3):
    """Fit one direction to all profiles.

    Parameters
    ----------
    uv : array, shape (n, 2)
        In the plane, from the reference, metres.
    off : array, shape (n,)
        Distances from the plane, metres.
    numbers : array of int, shape (n,)
    turn : float
        First guess of the direction, radians from the first axis.
    fewest : int
        Profiles with fewer points are left out.

    Returns
    -------
    ProfileFit

    Raises
    ------
    ValueError
        If fewer than two profiles are left.
    """
    kept = np.arange(len(uv))
    for _ in range(3):
        kept = kept[_full(numbers[kept], fewest)]
        present, profile, counts = np.unique(numbers[kept], return_inverse=True, return_counts=True)
        if len(present) < 2:
            raise ValueError(
                f"Invalid patch: {len(present)} profiles of {fewest} or more points. Must be 2."
            )
        turn, x, y, off_kept, solution = _aligned(uv[kept], off[kept], profile, turn)
        used = kept
        sigma = max(sigma_mad(solution.residuals), 1e-9)
        kept = kept[np.abs(solution.residuals) <= OFF_LINE * sigma]
        if len(kept) == len(used):
            break
    variance = max(solution.variance, 1e-18)
    return ProfileFit(
        turn=turn,
        x=x,
        y=y,
        off=off_kept,
        profile=profile,
        used=used,
        numbers=present,
        counts=counts,
        offsets=solution.constants,
        variances=variance / counts,
        means=solution.means,
        covariance=solution.covariance,
        slide=solution.coefficients[1],
    )


def _full(numbers, fewest):
    """Which points belong to profiles of enough points."""
    _, place, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    return counts[place] >= fewest


def first_direction(uv, numbers):
    """Direction of the largest pooled scatter within profiles, radians from the first axis."""
    _, place, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    about = uv - group_means(uv, place, counts)[place]
    _, vectors = np.linalg.eigh(about.T @ about)
    return float(np.arctan2(vectors[1, 1], vectors[0, 1]))


@dataclass(frozen=True, eq=False)
class GroupSolution:
    """Least squares with a constant for each group."""

    coefficients: np.ndarray
    constants: np.ndarray
    means: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    variance: float


def solve_groups(terms, values, group):
    """Least squares of ``values`` on shared terms and one constant for each group.

    Terms without any spread (distances from a plane without noise) get coefficient and variance 0.
    """
    counts = np.bincount(group)
    means = group_means(terms, group, counts)
    about = terms - means[group]
    scale = np.sqrt(np.mean(about**2, axis=0))
    alive = scale > 1e-9 * max(np.max(scale), 1e-300)
    about = about[:, alive] / scale[alive]
    level = group_means(values, group, counts)
    target = values - level[group]
    inverse = np.linalg.pinv(about.T @ about, rcond=1e-12)
    scaled = inverse @ (about.T @ target)
    residuals = target - about @ scaled
    free = max(len(values) - len(counts) - alive.sum(), 1)
    variance = residuals @ residuals / free
    coefficients = np.zeros(terms.shape[1])
    coefficients[alive] = scaled / scale[alive]
    covariance = np.zeros((terms.shape[1],) * 2)
    covariance[np.ix_(alive, alive)] = variance * inverse / np.outer(scale[alive], scale[alive])
    constants = level - means @ coefficients
    return GroupSolution(coefficients, constants, means, covariance, residuals, variance)


def group_means(values, group, counts):
    """Means of rows over groups, (m, ...)."""
    total = np.zeros((len(counts), *values.shape[1:]))
    np.add.at(total, group, values)
    return total / counts.reshape(-1, *[1] * (values.ndim - 1))


def _aligned(uv, off, profile, turn):
    """Turn the axes until the profiles' slope is zero; the solution in the last ones."""
    for _ in range(20):
        c, s = np.cos(turn), np.sin(turn)
        x, y = uv @ [c, s], uv @ [-s, c]
        terms = [x, off]
        if len(x) >= MANY:
            terms += [off * x, off * y, x**2, x * y]
        solution = solve_groups(np.stack(terms, axis=1), y, profile)
        slope = solution.coefficients[0]
        if abs(slope) < 1e-9:
            break
        turn += np.arctan(slope)
    return turn, x, y, off, solution
