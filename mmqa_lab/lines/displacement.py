"""Displacement of one set of segments from another, with and without known pairs.

A pair of lines does not determine a displacement along the lines. Across them

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle x of their common stretch, and the rows of B
perpendicular to the model line. The displacement u(x) is a vector and a rotation about the
vertical.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from mmqa_lab._checks import check_number
from mmqa_lab._results import Shown, about, sentences
from mmqa_lab.lines.displacement_search import MOST_RADIUS_M, TURN_RAD, matched
from mmqa_lab.lines.pairing import check_pairs, levers, paired
from mmqa_lab.lines.segments import check_segments, from_common_origin

__all__ = ["Displacement", "fit_displacement", "match_displaced"]


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
    remarks : tuple of str
        Of :func:`match_displaced`: why there are no pairs, or that few lines are paired.
    """

    vector: np.ndarray
    covariance: np.ndarray
    pairs: np.ndarray
    turn_deg: float
    centre: np.ndarray
    remarks: tuple[str, ...] = ()

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
        """Return a row for x, y and z: value, standard deviation, 95 % interval (m), pairs.

        Where there are remarks they are the last column.
        """
        frame = pd.DataFrame({"axis": [*"xyz"], "value_m": self.vector})
        frame["std_m"] = np.sqrt(np.diag(self.covariance))
        ends = self.intervals()
        frame = frame.assign(low_m=ends["low"], high_m=ends["high"], n=self.n)
        return frame.assign(remarks=" ".join(self.remarks)) if self.remarks else frame


def fit_displacement(test: ArrayLike, model: ArrayLike, pairs: ArrayLike) -> Displacement:
    """Estimate the displacement of one line set from another, given the pairs.

    Least squares for a vector and a rotation about the vertical, with Huber weights.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    pairs : array_like of bool, shape (p, q)
        True where a test and a model segment correspond. Test lines that are there twice count
        once.

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
    test, model = check_segments(test, "test"), check_segments(model, "model")
    pairs = check_pairs(pairs, (len(test), len(model)))
    rows, columns = np.nonzero(pairs)
    same = np.unique(test, axis=0, return_inverse=True)[1].ravel()  # lines that are there twice
    unknown = Displacement(np.full(3, np.nan), np.full((3, 3), np.nan), pairs, np.nan, np.zeros(3))
    if len(np.unique(same[rows])) < 3:
        return unknown
    test, model = from_common_origin(test, model)
    lines = paired(test, model, rows, columns)
    solution = np.zeros(4)
    normal = np.einsum("nkd,nke->de", lines.frame, lines.frame)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(rows):
        return unknown
    for _ in range(3):  # the common stretches depend on the displacement
        centre = lines.place.mean(axis=0)
        solution, covariance = _solved(lines, same[rows], centre, solution)
        lines = lines.again(solution[:3] + solution[3] * levers(lines.place - centre))
    turn = float(np.degrees(solution[3]))
    return Displacement(solution[:3], covariance, pairs, turn, centre)


def _solved(lines, which, centre, solution):
    """Vector and turn (4,), and the vector's covariance by jackknife over the distinct lines."""
    design, prior = lines.design(centre), np.diag([0, 0, 0, (0.1 / TURN_RAD) ** 2])
    for _ in range(10):
        off = lines.offset - design @ solution
        far = np.linalg.norm(off, axis=1) / np.sqrt(2) / max(np.median(np.abs(off)), 1e-6)
        weights = np.minimum(1, 2.5 / np.maximum(far, 1e-9))
        each = np.einsum("n,nkd,nke->nde", weights, design, design)
        right = np.einsum("n,nkd,nk->nd", weights, design, lines.offset)
        solution = np.linalg.solve(each.sum(axis=0) + prior, right.sum(axis=0))
    members = which == np.unique(which)[:, None]
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
        Largest displacement sought in the middle of the lines, 0.1 to 20 m. A turn may move the
        outer lines by another 6 m. A larger radius takes time and admits more false hypotheses.

    Returns
    -------
    Displacement
        It has no pairs and its vector is NaN if fewer than three lines agree, or no more than by
        chance. Most displacements beyond the radius end so.

    Raises
    ------
    ValueError
        If the radius is not between 0.1 and 20 m.

    See Also
    --------
    lhd : one number for the distance of two sets, whatever its cause.
    fit_displacement : where the pairs are known.

    Notes
    -----
    Segments must have two directions at least. The displacement may change along the longer side of
    the test set, as drift does along a drive. Every test line votes near its place for the
    displacements that bring it to a model line. The best three paths of the displacement through
    these votes are compared, since rows of equal windows also agree a window aside. Pairs count by
    how near they are and how well their ends agree. There is no answer if two paths explain nearly
    as much. The idea comes from line-based
    registration (Poreba & Goulette 2015). The distance of the 2013 paper still uses the original
    coordinates.

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
    radius = check_number(radius, "radius", low=0.1, high=MOST_RADIUS_M, unit="m")
    pairs, remark = np.zeros((len(test), len(model)), dtype=bool), "Fewer than three lines."
    if len(test) >= 3 and len(model):
        rows, columns = _distinct(test), _distinct(model)
        pairs[np.ix_(rows, columns)], remark = matched(test[rows], model[columns], radius)
    return replace(fit_displacement(test, model, pairs), remarks=sentences((remark, remark)))


def _distinct(segments):
    """Rows of the segments, the first of equal ones, in an order that only segments decide."""
    sizes = segments @ np.sqrt([1, 2, 3])
    turned = np.where((sizes[:, 0] > sizes[:, 1])[:, None, None], segments[:, ::-1], segments)
    return np.unique(turned, axis=0, return_index=True)[1]
