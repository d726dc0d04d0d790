"""The mean gap of profiles whose vehicle does not keep its speed, with an honest uncertainty."""

import numpy as np

GRID = 9
"""Nodes for each of the two unknown variances."""

MOST = 300
"""More profiles than that are averaged in so many blocks: matrices are this large at most."""


def mean_gap(numbers, offsets, variances, weights):
    """Return the mean gap between profiles over a patch, and its variance.

    What is wanted is the mean over all points of the gap that holds where they lie, not the slope
    of a line through the offsets: where speed drifts, the two differ. Offsets are taken as a
    straight line, plus what a randomly changing speed adds to it (an integrated random walk), plus
    white errors of known variance, plus white errors that all points of a profile share (attitude).
    The mean gap is the best linear prediction from them (universal kriging of the slope). The
    variances of the second and the fourth are unknown: their restricted likelihood weighs the
    answers of a grid of them, and the spread of the answers adds to the variance.

    Parameters
    ----------
    numbers : array, shape (n,)
        Number of each profile, increasing; numbers may be missing. n >= 2.
    offsets : array, shape (n,)
        Across the profiles, metres.
    variances : array, shape (n,)
        Of the offsets, m2, above zero.
    weights : array, shape (n,)
        Points of each profile.

    Returns
    -------
    gap : float
        Metres; negative if offsets fall.
    variance : float
        m2.
    functional : array, shape (n,)
        What the gap changes by when an offset does, m/m.

    Examples
    --------
    >>> gap, variance, _ = mean_gap([0, 1, 3], [0.0, 0.05, 0.15], [1e-8] * 3, [60, 60, 60])
    >>> round(gap, 4)
    0.05
    """
    numbers, offsets, variances, weights = (
        np.asarray(values, dtype=np.float64) for values in (numbers, offsets, variances, weights)
    )
    if len(numbers) > MOST:
        blocks = np.arange(len(numbers)) * MOST // len(numbers)
        share = weights / np.bincount(blocks, weights)[blocks]
        parts = (numbers * share, offsets * share, variances * share**2, weights)
        gap, variance, functional = mean_gap(*(np.bincount(blocks, part) for part in parts))
        return gap, variance, functional[blocks] * share
    length = numbers[-1] - numbers[0]
    x = (numbers - numbers[0]) / length
    if len(numbers) == 2:
        functional = np.array([-1.0, 1.0]) / length
        return float(functional @ offsets), float(functional**2 @ variances), functional
    line = np.stack([np.ones_like(x), x], axis=1)
    walk = _Walk(x, weights / weights.sum(), line)
    fitted = np.linalg.lstsq(line, offsets, rcond=None)[0]
    residual = offsets - line @ fitted
    answers = [
        walk.predict(residual, variances + shared**2, speed**2)
        for shared, speed in _grid(residual, variances)
    ]
    likelihood, gaps, spread = np.array([answer[:3] for answer in answers]).T
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    gap = fitted[1] + share @ gaps
    variance = share @ spread + share @ (fitted[1] + gaps - gap) ** 2
    functional = share @ np.array([answer[3] for answer in answers])
    # without bias but for rounding: a shift adds nothing, a gap adds itself
    functional += np.linalg.pinv(line).T @ ([0.0, 1.0] - line.T @ functional)
    return float(gap / length), float(variance / length**2), functional / length


class _Walk:
    """An integrated random walk from x = 0, and the weighted mean of its slope."""

    def __init__(self, x, share, line):
        low, high = np.minimum.outer(x, x), np.maximum.outer(x, x)
        walk = low**2 * (3 * high - low) / 6
        about = walk - line @ np.linalg.lstsq(line, walk, rcond=None)[0]
        about = about - (line @ np.linalg.lstsq(line, about.T, rcond=None)[0]).T
        scale = len(x) / np.trace(about)
        self.line = line
        self.offsets = scale * walk
        slope_first = np.where(x[:, None] <= x, x[:, None] * (x - x[:, None] / 2), x**2 / 2)
        self.slope_offsets = scale * share @ slope_first
        self.slope = scale * share @ low @ share

    def predict(self, residual, errors, speed):
        """Restricted log-likelihood, what residuals add to the mean slope, its variance, and how.

        The last is the derivative of the mean slope by each offset.
        """
        inverse = np.linalg.inv(np.diag(errors) + speed * self.offsets)
        weighted = inverse @ self.line
        normal = np.linalg.inv(self.line.T @ weighted)
        project = inverse - weighted @ normal @ weighted.T
        _, log_inverse = np.linalg.slogdet(inverse)
        _, log_normal = np.linalg.slogdet(normal)
        likelihood = 0.5 * (log_inverse + log_normal - residual @ project @ residual)
        cross = speed * self.slope_offsets
        gap = np.array([0.0, 1.0]) - weighted.T @ cross
        functional = project @ cross + weighted @ normal @ [0.0, 1.0]
        variance = speed * self.slope - cross @ inverse @ cross + gap @ normal @ gap
        return likelihood, functional @ residual, variance, functional


def _grid(residual, variances):
    """Pairs of standard deviations: of what profiles share, of the drift about a line."""
    largest = 3 * np.sqrt(np.mean(residual**2) + np.mean(variances))
    smallest = 0.05 * min(np.sqrt(np.median(variances)), largest)
    nodes = np.append(0.0, np.geomspace(smallest, largest, GRID - 1))
    return [(shared, speed) for shared in nodes for speed in nodes]
