"""The displacement between line sets: a vector with its covariance, a turn, and the pairs.

A pair of lines says nothing about a shift along them; across them it gives two equations,

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle of their common stretch, x that place and the
rows of B perpendicular to the model line. u(x) is a constant, a turn about the vertical, and a
drift: what the neighbours of a line have beyond both, a mean weighted by their distance.

Pairs are found with the displacement. Two parallel neighbours half a metre apart cannot be told
from each other while the whole set is displaced by more than that. But true pairs agree on one
slowly varying displacement, and false ones do not. Shifts that pairs of crossing lines suggest are
scored by how many lines they bring together; the best are refined by turns: the displacement from
the pairs, the pairs from the displacement. The outcome whose pairs agree best stands.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.stats import chi2, f

from mmqa_lab._checks import check_positive
from mmqa_lab._results import Shown
from mmqa_lab.lines.segments import (
    apart,
    common_stretches,
    components,
    directions,
    from_common_origin,
    lengths,
    midpoints,
)

ANGLE_DEG, OVERLAP = 8.0, 0.18
"""Largest angle between the lines of a pair; their least common stretch, of the shorter one."""

ANGLE_NOISE_RAD = np.radians(0.3)
"""Standard deviation of a line's direction, for places away from its midpoint."""

TURN_RAD = np.radians(1.0)
"""Standard deviation of turns about the vertical, before the lines are seen."""

HYPOTHESES, STARTS, STARTS_APART_M = 2000, 5, 0.4
NEAR_M, SCORE_WIDTH_M = 40.0, 0.35
"""Two lines so near to each other are displaced alike; a line so near to another meets it."""

DRIFTS_M, DRIFT_LENGTH_M = (0.15, 0.4), 30.0
"""Drifts that are tried, and how far a neighbour's drift is felt."""

ROUNDS, LEAST_NOISE_M, CLUTTER_PER_M2 = 10, 0.03, 0.1
"""Rounds of refinement, noise of lines at least, density of parallel unrelated lines."""

END_NOISE_M, CUT_M, AGREEING_ENDS = 0.55, 5.0, (0.6, 0.37)
"""Gap between ends at one place, mean gap where a line is cut short, and the share of ends at one
place: of true pairs, and of false ones, which often share the ground or the building."""

WIDER, WIDE_LINES, CLEARLY_MORE = 4.0, 300, 1.3
"""The longest lines are also sought within so many radii; a displacement beyond the radius must
bring together so many times the lines."""

CHANCE_SHARE, CHANCE_EVIDENCE = 0.21, 2.5
"""Unrelated sets pair less of the smaller set, with less evidence per pair: nothing is paired."""

WRONG_WEIGHT, CHOSEN, BLOCK_M = 2.5, 1.3, 15.0
"""Residuals beyond so many standard deviations weigh less in the displacement (Huber). Pairs that
were chosen because they agree do so better than their errors would: factor of the variance. Lines
of such blocks are left out together for the variance of the turn."""


class Pairs:
    """Pairs of lines: ``rows`` of the test set with ``columns`` of the model set.

    ``place`` (n, 3) is the middle of the common stretch on the model line, ``frame`` (n, 2, 3) two
    unit vectors across it, ``offset`` (n, 2) test line minus model line there along them,
    ``variance`` (n,) what uncertain directions add to it, ``overlap`` the common stretch as a part
    of the shorter line. The stretch is where the lines meet once ``moved`` (3,) or (n, 3) is taken
    off the test set. Places count from the middle of the model lines.
    """

    def __init__(self, test, model, rows, columns, moved=0.0):
        self.rows, self.columns, self.shape = rows, columns, (len(test), len(model))
        self.test, self.model = from_common_origin(test, model)
        self.axis = directions(self.model)[columns]
        way = directions(self.test)[rows]
        way *= np.sign((way * self.axis).sum(axis=1) + 1e-300)[:, None]
        self.half = lengths(self.test)[rows] / 2, lengths(self.model)[columns] / 2
        between = midpoints(self.test)[rows] - midpoints(self.model)[columns]
        self.s = ((between - moved) * self.axis).sum(axis=1)
        stretches = common_stretches(self.test, self.model, rows, columns, moved)
        self.stretches, (low, high) = stretches, stretches[1].T
        middle = (low + high) / 2
        helper = np.eye(3)[np.argmin(np.abs(self.axis), axis=1)]
        first = np.cross(self.axis, helper)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.frame = np.stack([first, np.cross(self.axis, first)], axis=1)
        on_axis = middle[:, None] * self.axis
        centre = midpoints(self.model).sum(axis=0) / max(len(model), 1)
        self.place = midpoints(self.model)[columns] + on_axis - centre
        across = between + (middle - self.s)[:, None] * way - on_axis
        self.offset = np.einsum("nkd,nd->nk", self.frame, across)
        self.variance = ANGLE_NOISE_RAD**2 * ((middle - self.s) ** 2 + middle**2)
        self.overlap = (high - low) / (2 * np.minimum(*self.half))

    def __len__(self):
        return len(self.rows)

    def again(self, moved):
        """The same pairs, met at the places of another displacement."""
        return Pairs(self.test, self.model, self.rows, self.columns, moved)

    def likely_ends(self):
        """Log of how much likelier true pairs leave such gaps between their ends than false."""
        gaps = np.abs([self.s + sign * (self.half[0] - self.half[1]) for sign in (-1, 1)])
        agree = np.sqrt(2 / np.pi) / END_NOISE_M * np.exp(-((gaps / END_NOISE_M) ** 2) / 2)
        cut = np.exp(-gaps / CUT_M) / CUT_M
        true, false = (share * agree + (1 - share) * cut for share in AGREEING_ENDS)
        return np.log(true / false).sum(axis=0)


@dataclass(frozen=True, eq=False)
class Displacement(Shown):
    """Mean displacement of the test set from the model set at the paired lines.

    Parameters
    ----------
    vector : array, shape (3,)
        Metres; NaN where the pairs leave a direction open.
    covariance : array, shape (3, 3)
        Square metres, by jackknife over the test lines: noise, drift and false pairs are in it.
    n : int
        Number of pairs.
    turn_deg, turn_sigma_deg : float
        Turn of the test set about the vertical through the middle of the pairs, degrees, counted
        from east to north, and its standard deviation.
    centre : array, shape (3,)
        Middle of the pairs, m from the middle of the model lines.
    """

    vector: np.ndarray
    covariance: np.ndarray
    n: int
    turn_deg: float = np.nan
    turn_sigma_deg: float = np.nan
    centre: np.ndarray | None = None

    @property
    def length(self) -> float:
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))

    def at(self, places):
        """Displacement (m, 3) at places (m, 3) that count from the middle of the model lines."""
        return self.vector + np.radians(self.turn_deg) * _levers(places - self.centre)

    def to_frame(self) -> pd.DataFrame:
        """Return a row for x, y, z (m) and the turn (degrees): value, std, 95 % interval, pairs."""
        value = np.append(self.vector, self.turn_deg)
        std = np.append(np.sqrt(np.diag(self.covariance)), self.turn_sigma_deg)
        found = {"figure": ["x_m", "y_m", "z_m", "turn_deg"], "value": value, "std": std}
        ends = {"low": value - 1.96 * std, "high": value + 1.96 * std, "n": self.n}
        return pd.DataFrame(found | ends)


def _levers(arm):
    """How places (m, 3) beside a vertical axis move per radian of a turn about it."""
    return np.stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))], axis=1)


def fit_displacement(test: ArrayLike, model: ArrayLike, pairs: ArrayLike) -> Displacement:
    """Estimate the displacement of one line set from another, given the pairs.

    Least squares of a vector and a turn about the vertical; far residuals weigh less (Huber).

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    pairs : array_like of bool, shape (p, q)

    Returns
    -------
    Displacement
        The vector is NaN when fewer than three lines are paired or all of them are parallel.

    Examples
    --------
    >>> model = np.array([[[0, 0, 0], [0, 0, 9]], [[0, 0, 9], [8, 0, 9]], [[8, 0, 0], [8, 5, 0]]])
    >>> shift = fit_displacement(model + [0.3, 0, 0.1], model, np.eye(3, dtype=bool))
    >>> (shift.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    rows, columns = np.nonzero(np.asarray(pairs))
    unknown = Displacement(np.full(3, np.nan), np.full((3, 3), np.nan), len(rows))
    if len(np.unique(rows)) < 3:
        return unknown
    lines, rough = Pairs(test, model, rows, columns), np.zeros(4)
    for _ in range(3):  # where lines overlap depends on the displacement
        solution = _solved(lines, rough)
        if solution is None:
            return unknown
        rough, covariance, centre = solution
        levers = _levers(lines.place - centre)
        lines = lines.again(rough[:3] + rough[3] * levers)
    vector, turn = rough[:3], np.degrees([rough[3], np.sqrt(covariance[3, 3])])
    return Displacement(vector, covariance[:3, :3], len(rows), *map(float, turn), centre)


def _solved(lines, rough):
    """Vector and turn (4,), their jackknife covariance over the test lines, and the centre."""
    centre = lines.place.mean(axis=0)
    design = _design(lines, centre)
    start = np.einsum("nkd,nke->de", design[..., :3], design[..., :3])
    if np.linalg.eigvalsh(start)[0] < 1e-3 * len(lines):
        return None
    off, weights = lines.offset - design @ rough, np.ones(len(lines))
    for _ in range(10):
        scale = np.sqrt((weights[:, None] * off**2).sum() / (2 * weights.sum())) + 1e-6
        prior = np.diag([0, 0, 0, (scale / TURN_RAD) ** 2])
        each = weights[:, None, None] * np.einsum("nkd,nke->nde", design, design)
        right = weights[:, None] * np.einsum("nkd,nk->nd", design, lines.offset)
        solution = np.linalg.solve(each.sum(axis=0) + prior, right.sum(axis=0))
        off = lines.offset - design @ solution
        far = np.linalg.norm(off, axis=1) / np.sqrt(2) / max(np.median(np.abs(off)), 1e-6)
        weights = np.minimum(1, WRONG_WEIGHT / np.maximum(far, 1e-9))
    covariance = _jackknife(lines.rows, each, right, prior, solution)
    # as wide as few lines ask for where chi-squared is taken for their ellipsoid
    freedom = max(len(np.unique(lines.rows)) - 4, 1)
    covariance *= CHOSEN * 3 * f.ppf(0.95, 3, freedom) / chi2.ppf(0.95, 3)
    # neighbours drift alike, which a mean over a street forgives and a turn does not
    block = np.unique(np.floor(lines.place[:, :2] / BLOCK_M), axis=0, return_inverse=True)[
        1
    ].ravel()
    freedom = max(block.max() - 1, 1)
    turn = _jackknife(block, each, right, prior, solution)[3, 3] * CHOSEN
    covariance[3, 3] = max(covariance[3, 3], turn * f.ppf(0.95, 1, freedom) / chi2.ppf(0.95, 1))
    return solution, covariance, centre


def _jackknife(group, each, right, prior, solution):
    """Covariance of a solution by leaving out one group of equations after the other."""
    _, group = np.unique(group, return_inverse=True)
    n = group.max() + 1
    normals, rights = np.zeros((n, 4, 4)), np.zeros((n, 4))
    np.add.at(normals, group, each)
    np.add.at(rights, group, right)
    rest = each.sum(axis=0) + prior - normals + 1e-9 * np.eye(4)
    left_out = np.linalg.solve(rest, (right.sum(axis=0) - rights)[..., None])[..., 0]
    spread = left_out - solution
    return (n - 1) / n * spread.T @ spread


def _design(lines, centre):
    """What a vector and a turn about the vertical through a centre move pairs across: (n, 2, 4)."""
    turned = np.einsum("nkd,nd->nk", lines.frame, _levers(lines.place - centre))
    return np.concatenate([lines.frame, turned[..., None]], axis=2)


@dataclass(frozen=True, eq=False)
class DisplacedMatch(Shown):
    """Pairs and the displacement they agree on.

    Parameters
    ----------
    pairs : array of bool, shape (p, q)
    displacement : Displacement
    evidence : float
        Log of how much likelier the pairs are than chance, by what lies across them and by their
        ends, per pair; NaN without pairs.
    """

    pairs: np.ndarray
    displacement: Displacement
    evidence: float

    def to_frame(self) -> pd.DataFrame:
        """Return the table of the displacement, with the evidence."""
        return self.displacement.to_frame().assign(evidence=self.evidence)


def match_displaced(test: ArrayLike, model: ArrayLike, *, radius: float = 4.0) -> DisplacedMatch:
    """Pair two displaced segment sets by the displacement that brings most of them together.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
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
    test, model = from_common_origin(test, model)
    radius = check_positive(radius, "radius", unit="m")
    reach = _wider(test, model, radius)
    if reach > radius:
        warnings.warn(
            f"Far more lines meet at a displacement beyond the radius of {radius:g} m: "
            f"it is sought within {reach:.1f} m.",
            stacklevel=2,
        )
    lines = _candidates(test, model, reach)
    shifts, scores = _hypotheses(lines, reach, HYPOTHESES)
    outcomes = [
        _refined(lines, start, drift) for start in _starts(shifts, scores) for drift in DRIFTS_M
    ]
    nothing = 0.0, np.zeros((len(test), len(model)), dtype=bool)
    evidence, pairs = max([nothing, *outcomes], key=lambda outcome: outcome[0])
    evidence /= max(pairs.sum(), 1)
    share = pairs.any(axis=1).sum() / max(1, min(pairs.shape))
    if share < CHANCE_SHARE and evidence < CHANCE_EVIDENCE:
        evidence, pairs = np.nan, nothing[1]
    return DisplacedMatch(pairs, fit_displacement(test, model, pairs), float(evidence))


def _candidates(test, model, radius):
    """The pairs of nearly parallel lines within the radius of each other."""
    parts, size = components(test, model), (lengths(test)[:, None], lengths(model))
    parallel = parts.angle < np.sin(np.radians(ANGLE_DEG)) * np.minimum(*size)
    gap = np.abs(parts.shift) - (size[0] + size[1]) / 2
    near = parallel & (parts.perpendicular < radius) & (gap < radius)
    return Pairs(test, model, *np.nonzero(near))


def _wider(test, model, radius):
    """The radius, or a larger one where far more lines come together beyond it."""
    few = [ends[np.argsort(-lengths(ends))[:WIDE_LINES]] for ends in (test, model)]
    lines = _candidates(*few, WIDER * radius)
    shifts, scores = _hypotheses(lines, WIDER * radius, 4 * HYPOTHESES)
    far = np.linalg.norm(shifts, axis=1)
    if scores.max(initial=0) <= CLEARLY_MORE * scores[far <= radius].max(initial=0) + 1:
        return radius
    return max(radius, 1.2 * far[scores.argmax()])


def _hypotheses(lines, radius, most):
    """Displacements (k, 3) that pairs of crossing lines suggest, and how many lines each unites."""
    if len(lines) < 3:
        return np.empty((0, 3)), np.empty(0)
    normal = np.einsum("nkd,nke->nde", lines.frame, lines.frame)
    right = np.einsum("nkd,nk->nd", lines.frame, lines.offset)
    a, b = np.random.default_rng(0).integers(len(lines), size=(2, 8 * most))
    use = (lines.rows[a] != lines.rows[b]) & (lines.columns[a] != lines.columns[b])
    use &= np.linalg.norm(lines.place[a] - lines.place[b], axis=1) < NEAR_M
    use &= np.linalg.norm(np.cross(lines.axis[a], lines.axis[b]), axis=1) > 0.5
    a, b = a[use][:most], b[use][:most]
    shifts = np.linalg.solve(normal[a] + normal[b], (right[a] + right[b])[..., None])[..., 0]
    shifts = shifts[np.linalg.norm(shifts, axis=1) < radius]
    weight = np.minimum(1, 2 * np.minimum(*lines.half) / 3)
    first = np.flatnonzero(np.r_[True, np.diff(lines.rows) > 0])
    # |offset - frame shift|^2 as one product of matrices
    products = np.einsum("kd,ke->kde", shifts, shifts).reshape(-1, 9)
    unknowns = np.column_stack([np.ones(len(shifts)), -2 * shifts, products])
    knowns = np.column_stack([(right**2).sum(axis=1), right, normal.reshape(-1, 9)]).T
    scores = [
        np.maximum.reduceat(np.maximum(0, 1 - part @ knowns / SCORE_WIDTH_M**2) * weight, first, 1)
        for part in np.array_split(unknowns, len(unknowns) // 200 + 1)
    ]
    return shifts, np.concatenate(scores).sum(axis=1)


def _starts(shifts, scores):
    """The displacements that bring most lines together, apart from each other."""
    starts = []
    for shift in shifts[np.argsort(-scores, kind="stable")]:
        if all(np.linalg.norm(shift - other) > STARTS_APART_M for other in starts):
            starts.append(shift)
        if len(starts) == STARTS:
            break
    return starts


def _refined(lines, start, drift):
    """Evidence and pairs that a start leads to, pairs and displacement by turns."""
    moved, noise = np.broadcast_to(start, (len(lines), 3)), 0.25
    spread = np.broadcast_to(0.04 * np.eye(3), (len(lines), 3, 3))
    outcome = 0.0, np.zeros(lines.shape, dtype=bool)
    for k in range(ROUNDS):
        lines = lines.again(moved)
        density, off = _log_density(lines, moved, spread, noise)
        density += lines.likely_ends()
        ease = np.log(CLUTTER_PER_M2 * min(1.0, 0.05 * 2.0**k))
        allowed = np.flatnonzero(density > ease)
        stretches = [part[allowed] for part in lines.stretches]
        rows, columns = lines.rows[allowed], lines.columns[allowed]
        pairs = apart(lines.shape, rows, columns, stretches, -density[allowed])
        members = np.flatnonzero(pairs[lines.rows, lines.columns])
        if len(members) < 3:
            break
        outcome = (density[members] - np.log(CLUTTER_PER_M2)).sum(), pairs
        noise = np.clip(np.median(np.abs(off[members])) * 1.48, LEAST_NOISE_M, noise)
        moved, spread = _field(lines, members, noise, drift)
    return outcome


def _log_density(lines, moved, spread, noise):
    """Log density of each pair's offset from the displacement expected there, and the residual."""
    off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
    covariance = lines.frame @ spread @ lines.frame.swapaxes(1, 2)
    covariance = covariance + (noise**2 + lines.variance)[:, None, None] * np.eye(2)
    squares = (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=1)
    density = -squares / 2 - np.log(2 * np.pi) - np.log(np.linalg.det(covariance)) / 2
    density[(lines.overlap < OVERLAP) | (squares > chi2.ppf(0.997, 2))] = -np.inf
    return density, off


def _field(lines, members, noise, drift):
    """Displacement (n, 3) and covariance (n, 3, 3) at all pairs, each member's from the others."""
    frame, place = lines.frame[members], lines.place[members]
    weight = 1 / (noise**2 + lines.variance[members])
    centre = place.mean(axis=0)
    design = _design(lines, centre)[members]
    prior = np.diag([1e-6, 1e-6, 1e-6, 1 / TURN_RAD**2])
    normal = np.einsum("n,nkd,nke->de", weight, design, design) + prior
    mean = np.linalg.solve(normal, np.einsum("n,nkd,nk->d", weight, design, lines.offset[members]))
    steady = mean[:3] + mean[3] * _levers(lines.place - centre)
    rest = lines.offset[members] - design @ mean
    felt = np.exp(-cdist(lines.place, place) / DRIFT_LENGTH_M)
    felt[members, np.arange(len(members))] = 0
    pulls = np.einsum("n,nkd,nk->nd", weight, frame, rest)
    holds = np.einsum("n,nkd,nke->nde", weight, frame, frame)
    spread = np.linalg.inv(np.tensordot(felt, holds, 1) + np.eye(3) / drift**2)
    return steady + np.einsum("nde,ne->nd", spread, felt @ pulls), spread
