"""The displacement between paired line sets: a vector, its covariance, and how it varies in space.

A pair of lines says nothing about a shift along them; across them it gives two equations,

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle of their common stretch, x that place and the
rows of B perpendicular to the model line. u(x) is a constant plus a drift, a Gaussian process of
exponential covariance (a Gauss-Markov process along any straight way). Its size and the noise are
those that the pairs make likely, averaged over a grid of both with their posterior weights.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mmqa_lab.lines.candidates import LinePairs
from mmqa_lab.lines.geometry import check_segments

DRIFT_LENGTH_M = 60.0
CONSTANT_M = 1.0
"""Prior standard deviation of the constant about the start that the pairs give."""

DRIFTS_M = np.array([0.03, 0.06, 0.1, 0.15, 0.22, 0.32, 0.47, 0.7])
NOISES_M = np.array([0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.11, 0.15, 0.25, 0.4, 0.7])
NOISE_PRIOR = (0.06, 0.35)
"""Median, m, and spread of the logarithm: edges are extracted to some centimetres."""

WRONG_SHARE, WRONG_OFFSET_M = 0.04, 0.45
"""One pair in 25 is taken for a wrong one, 0.45 m off: enters the covariance as noise. Set so that
95 % ellipsoids cover 95 % on simulated scenes (seeds 1000-1069)."""

FIELD_PAIRS = 80
"""At most so many pairs, evenly drawn, carry the drift: the cost grows with their cube."""


@dataclass(frozen=True)
class DriftPrior:
    """What is believed of the drift's standard deviation per axis before the pairs are seen.

    Parameters
    ----------
    median_m : float
    spread : float
        Standard deviation of the natural logarithm.

    Examples
    --------
    >>> prior = DriftPrior(median_m=0.2, spread=0.5)
    >>> round(float(prior.median_m * np.exp(prior.spread)), 2)  # one of six drifts is larger
    0.33
    """

    median_m: float = 0.2
    spread: float = 0.5


@dataclass(frozen=True, eq=False)
class Displacement:
    """Mean displacement of the test set from the model set at the paired lines.

    Parameters
    ----------
    vector : array, shape (3,)
        Metres; NaN where the pairs leave a direction open.
    covariance : array, shape (3, 3)
        Square metres.
    drift_m : float
        Standard deviation of the variation in space, per axis.
    noise_m : float
        Standard deviation of a line's place, per axis.
    n : int
        Number of pairs.

    Examples
    --------
    >>> moved = Displacement(np.array([0.3, 0.0, 0.4]), np.eye(3) * 1e-4, 0.05, 0.02, 40)
    >>> moved.length
    0.5
    """

    vector: np.ndarray
    covariance: np.ndarray
    drift_m: float
    noise_m: float
    n: int

    @property
    def length(self):
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))


def fit_displacement(test, model, pairs):
    """Estimate the displacement of one line set from another, given the pairs.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    pairs : array_like of bool, shape (p, q)

    Returns
    -------
    Displacement
        The vector is NaN when there are fewer than three pairs or all of them are parallel.

    Raises
    ------
    ValueError
        If a segment is not finite or has no length.

    Notes
    -----
    False pairs pull the vector; the covariance allows for one in 25. A Gaussian process of 60 m
    correlation length stands for the drift of satellite positioning between buildings.

    Examples
    --------
    >>> from mmqa_lab.lines.geometry import Segments
    >>> ends = [[[0, 0, 0], [0, 0, 9]], [[0, 0, 9], [8, 0, 9]], [[8, 0, 0], [8, 5, 0]]]
    >>> shift = fit_displacement(Segments(ends).moved([0.3, 0, 0.1]), ends, np.eye(3, dtype=bool))
    >>> shift.vector.round(2).tolist()
    [0.3, 0.0, 0.1]
    """
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    rows, columns = np.nonzero(np.asarray(pairs))
    unknown = Displacement(np.full(3, np.nan), np.full((3, 3), np.nan), np.nan, np.nan, len(rows))
    if len(rows) < 3:
        return unknown
    lines = LinePairs(test, model, rows, columns)
    seen = lines.observe(np.zeros(3))
    start = _least_squares(seen)
    if start is None:
        return unknown
    seen = lines.observe(start)
    field = DriftField(seen.select(evenly(len(rows))), start, DriftPrior())
    field.choose()
    vector, covariance = field.mean()
    return Displacement(vector, covariance, field.drift, field.noise, len(rows))


class DriftField:
    """Gaussian process of the displacement about ``start``, given the offsets of line pairs."""

    def __init__(self, seen, start, prior):
        self.seen, self.start, self.prior = seen, start, prior
        n = len(seen.place)
        frames = seen.frame.reshape(2 * n, 3)
        self._constant = CONSTANT_M**2 * frames @ frames.T
        near = _correlation(seen.place, seen.place)
        self._drift = frames @ frames.T * np.repeat(np.repeat(near, 2, axis=0), 2, axis=1)
        self._angles = np.repeat(seen.variance, 2)
        self._offsets = (seen.offset - seen.frame @ start).ravel()

    def __len__(self):
        return len(self.seen.place)

    def set(self, drift, noise):
        """Condition on a drift and a noise, m; return their log posterior."""
        self.drift, self.noise = float(drift), float(noise)
        covariance = drift**2 * self._drift + self._constant
        covariance.flat[:: len(covariance) + 1] += self._angles + noise**2
        self._factor = cho_factor(covariance, lower=True, check_finite=False)
        self._weights = self._solve(self._offsets)
        logs = np.log(np.diag(self._factor[0])).sum() + len(self) * np.log(2 * np.pi)
        self.log_likelihood = -self._offsets @ self._weights / 2 - logs
        return self.log_likelihood + self._log_prior()

    def climb(self, drift, noise):
        """Go uphill on the grid of drift and noise from a start."""
        known = {}

        def height(cell):
            if not (0 <= cell[0] < len(DRIFTS_M) and 0 <= cell[1] < len(NOISES_M)):
                return -np.inf
            if cell not in known:
                known[cell] = self.set(DRIFTS_M[cell[0]], NOISES_M[cell[1]])
            return known[cell]

        here = _nearest(DRIFTS_M, drift), _nearest(NOISES_M, noise)
        while True:
            around = [
                (here[0] + i, here[1] + j) for i, j in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
            ]
            best = max(around, key=height)
            if best == here:
                return self.set(DRIFTS_M[here[0]], NOISES_M[here[1]])
            here = best

    def choose(self):
        """Condition on the most likely drift and noise of the whole grid; keep all weights."""
        self._grid = {(s, n): self.set(s, n) for s in DRIFTS_M for n in NOISES_M}
        return self.set(*max(self._grid, key=self._grid.get))

    def at(self, places):
        """Displacements (m, 3) and their covariances (m, 3, 3) at places (m, 3)."""
        vectors, covariances = [], []
        for first in range(0, len(places), 2000):
            cross = self._cross(places[first : first + 2000])
            flat = cross.reshape(-1, cross.shape[2])
            solved = self._solve(flat.T).T.reshape(cross.shape)
            vectors.append(self.start + cross @ self._weights)
            prior = (self.drift**2 + CONSTANT_M**2) * np.eye(3)
            covariances.append(prior - np.einsum("mdn,men->mde", cross, solved))
        return np.concatenate(vectors), np.concatenate(covariances)

    def left_out(self):
        """Residuals (n, 2) of each pair from the others' prediction, and their covariances."""
        n = len(self)
        inverse = self._solve(np.eye(2 * n)).reshape(n, 2, n, 2)
        each = np.arange(n)
        covariance = np.linalg.inv(inverse[each, :, each])
        return np.einsum("nkl,nl->nk", covariance, self._weights.reshape(n, 2)), covariance

    def mean(self):
        """Mean displacement at the pairs and its covariance, averaged over the grid."""
        cells = list(self._grid)
        heights = np.array([self._grid[cell] for cell in cells])
        shares = np.exp(heights - heights.max())
        likely = shares > 0.003 * shares.sum()
        wrong = WRONG_SHARE * WRONG_OFFSET_M**2 / 2
        vectors, covariances = [], []
        for k in np.flatnonzero(likely):
            self.set(cells[k][0], np.sqrt(cells[k][1] ** 2 + wrong))
            vector, covariance = self._mean()
            vectors.append(vector)
            covariances.append(covariance)
        self.set(*max(self._grid, key=self._grid.get))
        shares = shares[likely] / shares[likely].sum()
        mean = shares @ np.array(vectors)
        spread = np.array(vectors) - mean
        return mean, np.einsum("k,kde->de", shares, covariances) + (spread.T * shares) @ spread

    def _mean(self):
        cross = self._cross(self.seen.place).mean(axis=0)
        near = _correlation(self.seen.place, self.seen.place).mean()
        prior = (near * self.drift**2 + CONSTANT_M**2) * np.eye(3)
        return self.start + cross @ self._weights, prior - cross @ self._solve(cross.T)

    def _cross(self, places):
        """Covariance of displacements (m, 3) at places with the offsets: (m, 3, 2n)."""
        kernel = self.drift**2 * _correlation(places, self.seen.place) + CONSTANT_M**2
        return np.einsum("mn,nkd->mdnk", kernel, self.seen.frame).reshape(len(places), 3, -1)

    def _solve(self, right):
        return cho_solve(self._factor, right, check_finite=False)

    def _log_prior(self):
        drift = np.log(self.drift / self.prior.median_m) / self.prior.spread
        noise = np.log(self.noise / NOISE_PRIOR[0]) / NOISE_PRIOR[1]
        return -(drift**2 + noise**2) / 2


def _correlation(a, b):
    """Correlation of the drift between places (m, 3) and (n, 3)."""
    squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.exp(-np.sqrt(np.maximum(squares, 0)) / DRIFT_LENGTH_M)


def _least_squares(seen):
    """The one displacement nearest to all offsets, or None where a direction is left open."""
    normal = np.einsum("nkd,nke->de", seen.frame, seen.frame)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(seen.frame):
        return None
    return np.linalg.solve(normal, np.einsum("nkd,nk->d", seen.frame, seen.offset))


def evenly(n):
    """Indices of at most FIELD_PAIRS of n, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, FIELD_PAIRS)).round().astype(int))


def _nearest(grid, value):
    return int(np.argmin(np.abs(np.log(grid / value))))
