"""Displacement of one set of segments from another, with and without known pairs.

A pair of lines does not determine a displacement along the lines. Across them

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle x of their common stretch, and the rows of B
perpendicular to the model line. The displacement u(x) is a vector and a rotation about the
vertical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats
from scipy.spatial.distance import cdist

from mmqa_lab._checks import check_positive
from mmqa_lab._results import Shown, about
from mmqa_lab.lines.pairing import Pairs, apart, levers
from mmqa_lab.lines.segments import components, from_common_origin, lengths, midpoints

__all__ = ["Displacement", "fit_displacement", "match_displaced"]

TURN_RAD = np.radians(1.0)
"""Prior standard deviation of the rotation about the vertical."""

HYPOTHESES = 2000
"""Number of displacements tried."""

CLUTTER_PER_M2, LEFT_M = 0.1, 0.08
"""Density of unrelated parallel lines; standard deviation of drift that neighbours do not show."""

LEAST_SHARE, LEAST_EVIDENCE = 0.18, 2.2
"""Least share of the smaller set that is paired, and least evidence per pair. Chosen on simulated
canyons and rows of windows: 8 of 435 right answers are refused, and 6 of 424 are accepted where the
sets are displaced by another 8 to 25 m."""


@dataclass(frozen=True, eq=False)
class Displacement(Shown):
    """Mean displacement of the test set from the model set at the paired lines.

    Parameters
    ----------
    vector : array, shape (3,)
        Metres; NaN if the pairs do not determine all directions.
    covariance : array, shape (3, 3)
        Square metres, by jackknife over the test lines. It includes noise, drift and false pairs.
    pairs : array of bool, shape (p, q)
        True where a test and a model segment correspond.
    turn_deg : float
        Rotation of the test set about the vertical through the middle of the pairs, degrees, from
        east to north. It is part of the fit and has no interval.
    centre : array, shape (3,)
        Middle of the pairs, m from the middle of the model lines.
    """

    vector: np.ndarray
    covariance: np.ndarray
    pairs: np.ndarray
    turn_deg: float
    centre: np.ndarray

    @property
    def n(self) -> int:
        """Number of pairs."""
        return int(self.pairs.sum())

    def at(self, places: np.ndarray) -> np.ndarray:
        """Displacement (m, 3) at places (m, 3) relative to the middle of the model lines, m."""
        return self.vector + np.radians(self.turn_deg) * levers(places - self.centre)

    def _ends(self):
        names, std = [f"displacement_{axis}" for axis in "xyz"], np.sqrt(np.diag(self.covariance))
        return [about(*row, "m") for row in zip(names, self.vector, std, strict=True)]

    def to_frame(self) -> pd.DataFrame:
        """Return a row for x, y and z: value, standard deviation, 95 % interval (m), pairs."""
        frame = pd.DataFrame({"axis": [*"xyz"], "value_m": self.vector})
        frame["std_m"] = np.sqrt(np.diag(self.covariance))
        ends = self.intervals()
        return frame.assign(low_m=ends["low"], high_m=ends["high"], n=self.n)


def fit_displacement(test: ArrayLike, model: ArrayLike, pairs: ArrayLike) -> Displacement:
    """Estimate the displacement of one line set from another, given the pairs.

    Least squares for a vector and a rotation about the vertical, with Huber weights.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    pairs : array_like of bool, shape (p, q)
        True where a test and a model segment correspond.

    Returns
    -------
    Displacement
        The vector is NaN if fewer than three lines are paired or all of them are parallel.

    Examples
    --------
    >>> model = np.array([[[0, 0, 0], [0, 0, 9]], [[0, 0, 9], [8, 0, 9]], [[8, 0, 0], [8, 5, 0]]])
    >>> shift = fit_displacement(model + [0.3, 0, 0.1], model, np.eye(3, dtype=bool))
    >>> (shift.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    pairs = np.asarray(pairs)
    rows, columns = np.nonzero(pairs)
    unknown = Displacement(np.full(3, np.nan), np.full((3, 3), np.nan), pairs, np.nan, np.zeros(3))
    if len(np.unique(rows)) < 3:
        return unknown
    test, model = from_common_origin(test, model)
    lines = Pairs(test, model, rows, columns)
    solution = np.zeros(4)
    normal = np.einsum("nkd,nke->de", lines.frame, lines.frame)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(rows):
        return unknown
    for _ in range(3):  # the common stretches depend on the displacement
        centre = lines.place.mean(axis=0)
        solution, covariance = _solved(lines, centre, solution)
        lines = lines.again(solution[:3] + solution[3] * levers(lines.place - centre))
    turn = float(np.degrees(solution[3]))
    return Displacement(solution[:3], covariance, pairs, turn, centre)


def _solved(lines, centre, solution):
    """Vector and turn (4,), and the vector's covariance by jackknife over the test lines."""
    design, prior = lines.design(centre), np.diag([0, 0, 0, (0.1 / TURN_RAD) ** 2])
    for _ in range(10):
        off = lines.offset - design @ solution
        far = np.linalg.norm(off, axis=1) / np.sqrt(2) / max(np.median(np.abs(off)), 1e-6)
        weights = np.minimum(1, 2.5 / np.maximum(far, 1e-9))
        each = np.einsum("n,nkd,nke->nde", weights, design, design)
        right = np.einsum("n,nkd,nk->nd", weights, design, lines.offset)
        solution = np.linalg.solve(each.sum(axis=0) + prior, right.sum(axis=0))
    members = lines.rows == np.unique(lines.rows)[:, None]
    rest = (~members @ each.reshape(-1, 16)).reshape(-1, 4, 4) + prior + 1e-9 * np.eye(4)
    spread = np.linalg.solve(rest, (~members @ right)[..., None])[:, :3, 0] - solution[:3]
    n = len(members)
    # ellipsoids are drawn by chi-squared, so few lines (F distribution) widen the covariance;
    # pairs were selected for their agreement, which makes the variance too small by 1.3
    wider = 1.3 * 3 * stats.f.ppf(0.95, 3, max(n - 4, 1)) / stats.chi2.ppf(0.95, 3)
    return solution, wider * (n - 1) / n * spread.T @ spread


def match_displaced(test: ArrayLike, model: ArrayLike, *, radius: float = 4.0) -> Displacement:
    """Pair two displaced segment sets by the displacement that unites most of their lines.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    radius : float
        Largest displacement sought in the middle of the lines, m. A turn may move the outer lines
        farther. A larger radius takes time and admits more false hypotheses.

    Returns
    -------
    Displacement
        It has no pairs and its vector is NaN if fewer than three lines agree, or no more than by
        chance. Most displacements beyond the radius end so.

    Raises
    ------
    ValueError
        If the radius is not positive.

    See Also
    --------
    lhd : one number for the distance of two sets, whatever its cause.
    fit_displacement : where the pairs are known.

    Notes
    -----
    Segments must have two directions at least. Settings were chosen on simulated canyons whose
    seeds differ from the reported seeds. The idea comes from line-based registration (Poreba &
    Goulette 2015). The distance of the 2013 paper still uses the original coordinates.

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
    lines = _candidates(test, model, radius)
    shifts, scores = _hypotheses(lines, radius)
    outcomes = [_refined(lines, start) for start in _starts(shifts, scores)]
    nothing = 0.0, np.zeros((len(test), len(model)), dtype=bool)
    evidence, pairs = max([nothing, *outcomes], key=lambda outcome: outcome[0])
    by_chance = evidence < LEAST_EVIDENCE * pairs.sum()
    if by_chance or pairs.any(axis=1).sum() < LEAST_SHARE * min(pairs.shape):
        pairs = nothing[1]
    return fit_displacement(test, model, pairs)


def _candidates(test, model, radius):
    """Pairs of nearly parallel lines within the radius, or within reach of a turn beyond it."""
    parts, size = components(test, model), (lengths(test)[:, None], lengths(model))
    parallel = parts.angle < np.sin(np.radians(8)) * np.minimum(*size)
    gap = np.abs(parts.shift) - (size[0] + size[1]) / 2
    # a turn about the vertical moves the outer lines farther than their middle
    centre = midpoints(test).sum(axis=0) / max(len(test), 1)
    reach = radius + 2 * TURN_RAD * np.linalg.norm(midpoints(test) - centre, axis=1)[:, None]
    near = parallel & (parts.perpendicular < reach) & (gap < reach)
    return Pairs(test, model, *np.nonzero(near))


def _hypotheses(lines, radius):
    """Displacements (k, 3) from pairs of crossing lines, and the number of lines each unites."""
    if len(lines.rows) < 3:
        return np.empty((0, 3)), np.empty(0)
    normal = np.einsum("nkd,nke->nde", lines.frame, lines.frame)
    right = np.einsum("nkd,nk->nd", lines.frame, lines.offset)
    a, b = np.random.default_rng(0).integers(len(lines.rows), size=(2, 8 * HYPOTHESES))
    use = (lines.rows[a] != lines.rows[b]) & (lines.columns[a] != lines.columns[b])
    # lines within 40 m of each other have a similar displacement
    use &= np.linalg.norm(lines.place[a] - lines.place[b], axis=1) < 40
    use &= np.linalg.norm(np.cross(lines.axis[a], lines.axis[b]), axis=1) > 0.5
    a, b = a[use][:HYPOTHESES], b[use][:HYPOTHESES]
    shifts = np.linalg.solve(normal[a] + normal[b], (right[a] + right[b])[..., None])[..., 0]
    shifts = shifts[np.linalg.norm(shifts, axis=1) < radius]
    first = np.flatnonzero(np.r_[True, np.diff(lines.rows) > 0])
    scores = []
    for part in np.array_split(shifts, len(shifts) // 200 + 1):
        off = lines.offset[..., None] - lines.frame @ part.T
        # lines within 0.35 m agree; each test line counts once
        agree = np.maximum(0, 1 - (off**2).sum(axis=1) / 0.35**2)
        scores.append(np.maximum.reduceat(agree, first).sum(axis=0))
    return shifts, np.concatenate(scores)


def _starts(shifts, scores):
    """The five displacements that unite most lines, at least 0.4 m apart."""
    starts, left = [], shifts[np.argsort(-scores, kind="stable")]
    while len(left) and len(starts) < 5:
        starts.append(left[0])
        left = left[np.linalg.norm(left - left[0], axis=1) > 0.4]
    return starts


def _refined(lines, start):
    """Evidence and pairs from a start, by alternate updates of pairs and displacement."""
    moved, noise = np.broadcast_to(start, (len(lines.rows), 3)), 0.3
    outcome = 0.0, np.zeros(lines.shape, dtype=bool)
    for _ in range(10):
        lines = lines.again(moved)
        off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
        variance = noise**2 + LEFT_M**2
        squares = (off**2).sum(axis=1) / variance
        # true pairs share 0.18 of the shorter line at least, and 99.7 % of them are as near
        allowed = (lines.overlap >= 0.18) & (squares < stats.chi2.ppf(0.997, 2))
        pairs = apart(lines, np.where(allowed, squares, np.inf))
        members = np.flatnonzero(pairs[lines.rows, lines.columns])
        if len(members) < 3:
            break
        # log likelihood ratio of true pairs to unrelated lines
        ratio = -squares[members] / 2 - np.log(2 * np.pi * variance * CLUTTER_PER_M2)
        outcome = ratio.sum(), pairs
        noise = np.clip(np.median(np.abs(off[members])) * 1.48, 0.03, noise)
        moved = _field(lines, members, noise)
    return outcome


def _field(lines, members, noise):
    """Displacement (n, 3) at all pairs, each from the other pairs.

    Drift has a standard deviation of 0.25 m and a correlation length of 30 m.
    """
    frame, place = lines.frame[members], lines.place[members]
    centre = place.mean(axis=0)
    design = lines.design(centre)[members]
    prior = noise**2 * np.diag([1e-6, 1e-6, 1e-6, 1 / TURN_RAD**2])
    normal = np.einsum("nkd,nke->de", design, design) + prior
    mean = np.linalg.solve(normal, np.einsum("nkd,nk->d", design, lines.offset[members]))
    steady = mean[:3] + mean[3] * levers(lines.place - centre)
    felt = np.exp(-cdist(lines.place, place) / 30)
    felt[members, np.arange(len(members))] = 0
    pulls = felt @ np.einsum("nkd,nk->nd", frame, lines.offset[members] - design @ mean)
    holds = np.tensordot(felt, frame.swapaxes(1, 2) @ frame, 1)
    holds += (noise / 0.25) ** 2 * np.eye(3)
    return steady + np.linalg.solve(holds, pulls[..., None])[..., 0]
