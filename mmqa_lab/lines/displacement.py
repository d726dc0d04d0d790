"""The displacement between paired line sets: a vector, its covariance, and how it varies in space.

A pair of lines says nothing about a shift along them; across them it gives two equations,

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle of their common stretch, x that place and the
rows of B perpendicular to the model line. u(x) is a constant, a turn about the vertical through the
middle of the pairs, and a drift, a Gaussian process of exponential covariance (a Gauss-Markov
process along any straight way). The drift's size and the noise are those that the pairs make
likely, averaged over a grid of both with their posterior weights.

Pairs are found with the displacement. Two parallel neighbours half a metre apart cannot be told
from each other while the whole set is displaced by more than that. But true pairs agree on one
slowly varying displacement, and false ones do not. Hypotheses from pairs of crossing lines are
scored by how many lines they bring together; the best are refined by turns (a displacement field
from the pairs, pairs from the field); the outcomes are weighed by their evidence, and a pair stands
that more than half of the weight speaks for.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from mmqa_lab._checks import check_positive
from mmqa_lab._results import Shown
from mmqa_lab.lines.segments import LinePairs, Segments, check_segments, components

DRIFT_LENGTH_M = 60.0
CONSTANT_M = 1.0
"""Prior standard deviation of the constant about the start that the pairs give."""

TURN_RAD = np.radians(0.4)
"""Prior standard deviation of the turn about the vertical: headings err by some tenths."""

DRIFTS_M = np.array([0.005, 0.012, 0.03, 0.06, 0.1, 0.15, 0.22, 0.32, 0.47, 0.7])
NOISES_M = np.array([0.003, 0.006, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.11, 0.15, 0.25, 0.4, 0.7])
NOISE_PRIOR = (0.06, 0.35)
"""Median, m, and spread of the logarithm: edges are extracted to some centimetres."""

WRONG_SHARE, WRONG_SIGMAS = 0.04, 3.5
"""One pair in 25 is taken for a wrong one, so many sigmas of drift and noise off, as far as wrong
ones are accepted: enters the covariance as noise. Set so that 95 % ellipsoids cover 95 % on
simulated scenes (seeds 1000-1069, 2000-2019)."""

DRIFT_PRIOR = (0.2, 0.5)
"""The same of the drift per axis, before the pairs are seen."""

FIELD_PAIRS, MEAN_PAIRS = 80, 1000
"""At most so many pairs, evenly drawn, carry the drift (the cost grows with their cube), and the
mean displacement."""

ANGLE_DEG = 8.0
"""Largest angle between the lines of a pair."""

OVERLAP = 0.18
"""Least common stretch, as a part of the shorter line."""

MAHALANOBIS = 11.8
"""99.7 % quantile of chi-squared with two degrees of freedom."""

HYPOTHESES = 2000
WIDER, WIDE_HYPOTHESES = 4.0, 8000
"""Displacements are sought coarsely up to so many radii, by so many hypotheses."""

WIDE_LINES = 300
"""The longest lines of either set take part in the coarse search."""

CHANCE_SHARE, CHANCE_EVIDENCE = 0.21, 2.5
"""Unrelated sets pair less of the smaller set, with less evidence per pair: nothing is paired then
(simulated canyons 25 and 60 m apart: at most 0.20 and 2.5; true pairs: 0.24 and 2.4 at least)."""

CLEARLY_MORE = 1.3
"""A displacement beyond the radius must bring together so many times the lines, and one more."""

STARTS, STARTS_APART_M = 5, 0.4
NEAR_M = 40.0
"""Two lines so near to each other are displaced alike."""

SCORE_WIDTH_M = 0.35
FIRST_ROUNDS, ROUNDS, REFINED = 3, 10, 4
AGREEING_ENDS = (0.6, 0.37)
"""Share of the ends that lie at one place: of true pairs, and of false ones, which often share the
ground or the building."""

END_NOISE_M, CUT_M = 0.55, 5.0
"""Standard deviation of the gap between ends at one place; mean gap where one line is cut short."""

CLUTTER_PER_M2 = 0.1
"""Density of parallel unrelated lines that the evidence of an outcome is reckoned against."""

TEMPER = 4.0
"""Divides the evidence before outcomes are weighed: their pairs are not independent."""


@dataclass(frozen=True, eq=False)
class Displacement(Shown):
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
    turn_deg, turn_sigma_deg : float
        Turn of the test set about the vertical through the middle of the pairs, degrees, counted
        from east to north, and its standard deviation.
    """

    vector: np.ndarray
    covariance: np.ndarray
    drift_m: float
    noise_m: float
    n: int
    turn_deg: float = np.nan
    turn_sigma_deg: float = np.nan

    @property
    def length(self) -> float:
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))

    def to_frame(self) -> pd.DataFrame:
        """Return a row for x, y, z (m) and the turn (degrees): value, std, 95 % interval, pairs."""
        value = np.append(self.vector, self.turn_deg)
        std = np.append(np.sqrt(np.diag(self.covariance)), self.turn_sigma_deg)
        found = {"figure": ["x_m", "y_m", "z_m", "turn_deg"], "value": value, "std": std}
        ends = {"low": value - 1.96 * std, "high": value + 1.96 * std, "n": self.n}
        return pd.DataFrame(found | ends)


def fit_displacement(
    test: Segments | ArrayLike, model: Segments | ArrayLike, pairs: ArrayLike
) -> Displacement:
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
    >>> from mmqa_lab.lines import Segments
    >>> ends = [[[0, 0, 0], [0, 0, 9]], [[0, 0, 9], [8, 0, 9]], [[8, 0, 0], [8, 5, 0]]]
    >>> shift = fit_displacement(Segments(ends).moved([0.3, 0, 0.1]), ends, np.eye(3, dtype=bool))
    >>> (shift.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    field, seen = _fitted(test, model, pairs)
    n = int(np.sum(pairs))
    if field is None:
        return Displacement(np.full(3, np.nan), np.full((3, 3), np.nan), np.nan, np.nan, n)
    vector, covariance = field.mean(seen.place)
    turn = np.degrees(field.turn())
    return Displacement(vector, covariance, field.drift, field.noise, n, *turn)


def across_pairs(test, model, pairs):
    """How far the displacement moves each paired line across itself, with its frame.

    Returns the displacement (k, 3) at the pairs in the order of ``np.nonzero(pairs)``, the frames
    across (k, 2, 3), and the covariance (3, 3) of the mean; None where it is unknown.
    """
    field, seen = _fitted(test, model, pairs)
    if field is None:
        return None
    return field.at(seen.place)[0], seen.frame, field.mean(seen.place)[1]


def _fitted(test, model, pairs):
    """The field of the paired lines on its most likely drift and noise, and their offsets."""
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    rows, columns = np.nonzero(np.asarray(pairs))
    lines = LinePairs(test, model, rows, columns)
    start = _least_squares(lines.observe(np.zeros(3))) if len(rows) > 2 else None
    if start is None:
        return None, None
    seen = lines.observe(start)
    field = _DriftField(seen.select(_evenly(len(rows))), start, DRIFT_PRIOR)
    field.choose()
    return field, seen


class _DriftField:
    """Gaussian process of the displacement about ``start``, given the offsets of line pairs."""

    def __init__(self, seen, start, prior):
        self.seen, self.start, self.prior = seen, start, prior
        n = len(seen.place)
        frames = seen.frame.reshape(2 * n, 3)
        self.centre = seen.place.mean(axis=0)
        self._turns = np.einsum("nkd,nd->nk", seen.frame, self._levers(seen.place)).ravel()
        self._constant = CONSTANT_M**2 * frames @ frames.T
        self._constant += TURN_RAD**2 * np.outer(self._turns, self._turns)
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
        straight = min(1.0, noise / NOISE_PRIOR[0]) ** 2  # quiet lines have quiet directions
        covariance.flat[:: len(covariance) + 1] += straight * self._angles + noise**2
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

        grids = DRIFTS_M / drift, NOISES_M / noise
        here = tuple(int(np.argmin(np.abs(np.log(grid)))) for grid in grids)
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
            levers = self._levers(places[first : first + 2000])
            prior = (self.drift**2 + CONSTANT_M**2) * np.eye(3)
            prior = prior + TURN_RAD**2 * levers[:, :, None] * levers[:, None]
            covariances.append(prior - np.einsum("mdn,men->mde", cross, solved))
        return np.concatenate(vectors), np.concatenate(covariances)

    def left_out(self):
        """Residuals (n, 2) of each pair from the others' prediction, and their covariances."""
        n = len(self)
        inverse = self._solve(np.eye(2 * n)).reshape(n, 2, n, 2)
        each = np.arange(n)
        covariance = np.linalg.inv(inverse[each, :, each])
        return np.einsum("nkl,nl->nk", covariance, self._weights.reshape(n, 2)), covariance

    def mean(self, places):
        """Mean displacement at places (m, 3) and its covariance, averaged over the grid."""
        places = places[_evenly(len(places), MEAN_PAIRS)]
        cells = list(self._grid)
        heights = np.array([self._grid[cell] for cell in cells])
        shares = np.exp(heights - heights.max())
        likely = shares > 0.003 * shares.sum()
        vectors, covariances = [], []
        for k in np.flatnonzero(likely):
            wrong = WRONG_SHARE * WRONG_SIGMAS**2 * (cells[k][0] ** 2 + cells[k][1] ** 2) / 2
            self.set(cells[k][0], np.sqrt(cells[k][1] ** 2 + wrong))
            vector, covariance = self._mean(places)
            vectors.append(vector)
            covariances.append(covariance)
        self.set(*max(self._grid, key=self._grid.get))
        shares = shares[likely] / shares[likely].sum()
        mean = shares @ np.array(vectors)
        spread = np.array(vectors) - mean
        return mean, np.einsum("k,kde->de", shares, covariances) + (spread.T * shares) @ spread

    def turn(self):
        """The turn about the vertical and its standard deviation, rad."""
        row = TURN_RAD**2 * self._turns
        return row @ self._weights, np.sqrt(TURN_RAD**2 - row @ self._solve(row))

    def _mean(self, places):
        cross = self._cross(places).mean(axis=0)
        lever = self._levers(places).mean(axis=0)
        near = _correlation(places, places).mean()
        prior = (near * self.drift**2 + CONSTANT_M**2) * np.eye(3)
        prior += TURN_RAD**2 * np.outer(lever, lever)
        return self.start + cross @ self._weights, prior - cross @ self._solve(cross.T)

    def _cross(self, places):
        """Covariance of displacements (m, 3) at places with the offsets: (m, 3, 2n)."""
        kernel = self.drift**2 * _correlation(places, self.seen.place) + CONSTANT_M**2
        cross = np.einsum("mn,nkd->mdnk", kernel, self.seen.frame).reshape(len(places), 3, -1)
        return cross + TURN_RAD**2 * self._levers(places)[:, :, None] * self._turns

    def _levers(self, places):
        """How places (m, 3) move per radian of the turn."""
        arm = places - self.centre
        return np.stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))], axis=1)

    def _solve(self, right):
        return cho_solve(self._factor, right, check_finite=False)

    def _log_prior(self):
        drift = np.log(self.drift / self.prior[0]) / self.prior[1]
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


def _evenly(n, most=FIELD_PAIRS):
    """Indices of at most so many of n, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))


class _Search(NamedTuple):
    """How firmly the refinement keeps to a steady displacement.

    Parameters
    ----------
    prior : tuple of two floats
        Median of the drift, m, and spread of its logarithm.
    start_m : float
        Uncertainty of a hypothesis, per axis.
    least_drift_m : float
        The drift is taken to be this large at least when pairs are accepted.
    reach_m : float
        Largest remaining offset.
    clutter_per_m2 : float
        A pair is accepted where its density, times the ratio of its ends, exceeds this.
    ease : float
        Factor of the clutter in the first round, doubled each round up to one.
    """

    prior: tuple
    start_m: float
    least_drift_m: float
    reach_m: float
    clutter_per_m2: float
    ease: float


STEADY = _Search((0.2, 0.5), 0.2, 0.15, 0.5, 0.4, 0.05)
DRIFTING = _Search((0.3, 0.8), 0.4, 0.4, 1.2, 0.1, 0.02)


@dataclass(frozen=True, eq=False)
class DisplacedMatch(Shown):
    """Pairs and the displacement they agree on.

    Parameters
    ----------
    pairs : array of bool, shape (p, q)
    displacement : Displacement
    evidence : float
        Log of how much likelier the pairs of the best outcome are than chance, by what lies across
        them and by their ends, per pair; NaN without pairs.
    """

    pairs: np.ndarray
    displacement: Displacement
    evidence: float

    def to_frame(self) -> pd.DataFrame:
        """Return the table of the displacement, with the evidence."""
        return self.displacement.to_frame().assign(evidence=self.evidence)


def match_displaced(
    test: Segments | ArrayLike,
    model: Segments | ArrayLike,
    *,
    radius: float = 4.0,
) -> DisplacedMatch:
    """Pair two displaced segment sets by the displacement that brings most of them together.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    radius : float
        Largest displacement sought, m. A larger one costs time and admits more false hypotheses.
        Where far more lines come together beyond it, up to four times as far, it is enlarged.

    Returns
    -------
    DisplacedMatch
        Without pairs, and with an unknown displacement, when fewer than three lines agree or no
        more than chance would bring together.

    Raises
    ------
    ValueError
        If the radius is not positive.

    Warns
    -----
    UserWarning
        If the displacement lies beyond the radius.

    Notes
    -----
    Segments must run in two directions at least. Settings were chosen on simulated canyons with
    other seeds than those reported. The idea is that of line-based registration (Poreba & Goulette
    2015); the distance of the 2013 paper is then taken at the original coordinates.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> scene = canyon(1)
    >>> test, model = scene.surveys["C1"].segments, scene.surveys["TLS"].segments
    >>> match = match_displaced(test, model)
    >>> truth = scene.pairs("C1", "TLS")
    >>> bool((match.pairs & truth).sum() > 0.9 * truth.sum())
    True
    """
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    radius = check_positive(radius, "radius", unit="m")
    reach = _wider(test, model, radius)
    if reach > radius:
        warnings.warn(
            f"Far more lines meet at a displacement beyond the radius of {radius:g} m: "
            f"it is sought within {reach:.1f} m.",
            stacklevel=2,
        )
    lines = _candidates(test, model, reach)
    starts = _starts(*_hypotheses(lines, reach, HYPOTHESES)) if len(lines) > 2 else []
    outcomes = _refined(starts, lines, STEADY) + _refined(starts, lines, DRIFTING)
    pairs, evidence = _agreed(outcomes) if outcomes else (np.zeros((len(test), len(model))), 0)
    share = pairs.any(axis=1).sum() / max(1, min(pairs.shape))
    if share < CHANCE_SHARE and evidence < CHANCE_EVIDENCE:
        pairs, evidence = np.zeros(pairs.shape, dtype=bool), np.nan
    return DisplacedMatch(pairs, fit_displacement(test, model, pairs), evidence)


def _wider(test, model, radius):
    """The radius, or a larger one where far more lines come together beyond it."""
    few = [one.select(np.argsort(-one.lengths)[:WIDE_LINES]) for one in (test, model)]
    lines = _candidates(*few, WIDER * radius)
    if len(lines) < 3:
        return radius
    shifts, scores = _hypotheses(lines, WIDER * radius, WIDE_HYPOTHESES)
    lengths = np.linalg.norm(shifts, axis=1)
    within = scores[lengths <= radius].max(initial=0)
    if scores.max(initial=0) <= CLEARLY_MORE * within + 1:
        return radius
    return max(radius, 1.2 * lengths[scores.argmax()])


class _Refinement:
    """Pairs and displacement field, each from the other by turns."""

    def __init__(self, start, lines, search):
        self.start, self.lines, self.search = start, lines, search
        self.expected = np.broadcast_to(start, (len(lines), 3))
        uncertainty = search.start_m**2 * np.eye(3)
        self.covariance = np.broadcast_to(uncertainty, (len(lines), 3, 3))
        self.members = np.empty(0, dtype=int)
        self.drift, self.noise, self.field = search.prior[0], 0.06, None
        self.rounds, self.settled = 0, False

    def round(self):
        """One turn; False when fewer than three pairs remain."""
        seen = self.lines.observe(self.expected)
        self.ends = _log_ratio_of_ends(self.lines.end_gaps(self.expected))
        density = self._log_densities(seen) + self.ends
        clutter = self.search.clutter_per_m2 * min(1.0, self.search.ease * 2.0**self.rounds)
        allowed = np.flatnonzero(density > np.log(clutter))
        self.pairs = self.lines.accepted(allowed, -density[allowed], self.expected)
        members = np.flatnonzero(self.pairs[self.lines.rows, self.lines.columns])
        if len(members) < 3:
            return False
        self.settled = np.array_equal(members, self._accepted) if self.rounds else False
        self._accepted = members
        self.members = members[_evenly(len(members))]
        self._update(seen)
        self.rounds += 1
        return True

    def _log_densities(self, seen):
        """Log density of each candidate's offset, members left out of their own prediction."""
        residual = seen.offset - np.einsum("nkd,nd->nk", seen.frame, self.expected)
        covariance = np.einsum("nkd,nde,nle->nkl", seen.frame, self.covariance, seen.frame)
        covariance += (self.noise**2 + seen.variance)[:, None, None] * np.eye(2)
        if self.field is not None:
            residual[self.members], covariance[self.members] = self.field.left_out()
        inverse, determinant = np.linalg.inv(covariance), np.linalg.det(covariance)
        squares = np.einsum("nk,nkl,nl->n", residual, inverse, residual)
        density = -squares / 2 - np.log(2 * np.pi) - np.log(determinant) / 2
        far = np.linalg.norm(residual, axis=1) > self.search.reach_m
        density[(squares > MAHALANOBIS) | far | (seen.overlap < OVERLAP)] = -np.inf
        return density

    def _update(self, seen):
        """The field of the present members and what it expects of all candidates."""
        self.field = _DriftField(seen.select(self.members), self.start, self.search.prior)
        posterior = self.field.climb(self.drift, self.noise)
        self.drift, self.noise = self.field.drift, self.field.noise
        per_pair = posterior / len(self.members) - np.log(CLUTTER_PER_M2)
        self.evidence = per_pair * len(self._accepted) + self.ends[self._accepted].sum()
        if self.field.drift < self.search.least_drift_m:
            self.field.set(self.search.least_drift_m, self.noise)
        self.expected, self.covariance = self.field.at(seen.place)


def _log_ratio_of_ends(gaps):
    """How much likelier true pairs leave these gaps (n, 2) between their ends than false ones."""
    agree = np.sqrt(2 / np.pi) / END_NOISE_M * np.exp(-((gaps / END_NOISE_M) ** 2) / 2)
    cut = np.exp(-gaps / CUT_M) / CUT_M
    true, false = (share * agree + (1 - share) * cut for share in AGREEING_ENDS)
    return np.log(true / false).sum(axis=1)


def _candidates(test, model, radius):
    """The pairs of nearly parallel lines within the radius of each other."""
    parts = components(test, model)
    shorter = np.minimum(test.lengths[:, None], model.lengths)
    gap = np.abs(parts.shift) - (test.lengths[:, None] + model.lengths) / 2
    parallel = parts.angle < np.sin(np.radians(ANGLE_DEG)) * shorter
    near = parallel & (parts.perpendicular < radius) & (gap < radius)
    return LinePairs(test, model, *np.nonzero(near))


def _hypotheses(lines, radius, most):
    """Displacements of pairs of crossing lines, and how many lines each brings together."""
    seen = lines.observe(np.zeros(3))
    normal = np.einsum("nkd,nke->nde", seen.frame, seen.frame)
    right = np.einsum("nkd,nk->nd", seen.frame, seen.offset)
    a, b = np.random.default_rng(0).integers(len(lines), size=(2, 8 * most))
    apart = (lines.rows[a] != lines.rows[b]) & (lines.columns[a] != lines.columns[b])
    apart &= np.linalg.norm(seen.place[a] - seen.place[b], axis=1) < NEAR_M
    a, b = a[apart], b[apart]
    crossing = np.linalg.norm(np.cross(lines.axis[a], lines.axis[b]), axis=1) > 0.5
    a, b = a[crossing][:most], b[crossing][:most]
    shifts = np.linalg.solve(normal[a] + normal[b], (right[a] + right[b])[..., None])[..., 0]
    shifts = shifts[np.linalg.norm(shifts, axis=1) < radius]
    return shifts, _scores(shifts, normal, right, lines)


def _starts(shifts, scores):
    """The displacements that bring most lines together, apart from each other."""
    starts = []
    for shift in shifts[np.argsort(-scores, kind="stable")]:
        if all(np.linalg.norm(shift - other) > STARTS_APART_M for other in starts):
            starts.append(shift)
        if len(starts) == STARTS:
            break
    return starts


def _scores(shifts, normal, right, lines):
    """How many test lines each shift brings to a model line, long ones counting more."""
    products = np.einsum("nd,ne->nde", shifts, shifts).reshape(-1, 9)
    unknowns = np.concatenate([np.ones((len(shifts), 1)), -2 * shifts, products], axis=1)
    knowns = np.concatenate([(right**2).sum(axis=1)[:, None], right, normal.reshape(-1, 9)], axis=1)
    weight = np.minimum(1, 2 * np.minimum(lines.test_half, lines.model_half) / 3)
    first = np.flatnonzero(np.r_[True, np.diff(lines.rows) > 0])
    scores = np.empty(len(shifts))
    for at in range(0, len(shifts), 200):
        squares = unknowns[at : at + 200] @ knowns.T
        near = np.maximum(0, 1 - squares / SCORE_WIDTH_M**2) * weight
        scores[at : at + 200] = np.maximum.reduceat(near, first, axis=1).sum(axis=1)
    return scores


def _refined(starts, lines, search):
    """The best outcomes of one search, a short trial of every start first."""
    trials = []
    for start in starts:
        trial = _Refinement(start, lines, search)
        if all(trial.round() for _ in range(FIRST_ROUNDS)):
            trials.append(trial)
    trials.sort(key=lambda trial: -trial.evidence)
    outcomes = []
    for trial in trials[:REFINED]:
        while trial.rounds < ROUNDS and not (trial.settled and trial.rounds > 6):
            if not trial.round():
                break
        else:
            outcomes.append(trial)
    return outcomes


def _agreed(outcomes):
    """The pairs that outcomes with more than half of the weight share (the best one's, if few).

    With them the evidence per pair of the best outcome.
    """
    best = max(outcomes, key=lambda outcome: outcome.evidence)
    different = {outcome.pairs.tobytes(): outcome for outcome in outcomes}.values()
    weights = [np.exp((outcome.evidence - best.evidence) / TEMPER) for outcome in different]
    shares = np.average([outcome.pairs for outcome in different], axis=0, weights=weights)
    pairs = shares > 0.5
    evidence = best.evidence / best.pairs.sum()
    return (pairs if pairs.sum() >= 3 else best.pairs), evidence
