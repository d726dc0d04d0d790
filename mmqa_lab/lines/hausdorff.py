"""The line-segment Hausdorff distance as a result: both directions, its parts, its kinds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmqa_lab._results import NORMAL, Shown
from mmqa_lab.lines.displacement import Displacement, fit_displacement, match_displaced
from mmqa_lab.lines.pairing import Threshold, paired
from mmqa_lab.lines.segments import Components, from_common_origin
from mmqa_lab.stats import student_reach

__all__ = ["LHD", "WAYS", "Directed"]


PAIRING = [
    "one-to-null", "one-to-one", "one-to-multiple", "multiple-to-one", "multiple-to-multiple",
]  # fmt: skip


WAYS = ["test to model", "model to test"]


# Parts of a distance, and their sum.
DISTANCE_PARTS = ["displacement", "position", "direction", "ends", "false pairs", "all"]


@dataclass(frozen=True, eq=False)
class Directed:
    """One direction of the distance: from each source segment to its targets.

    Parameters
    ----------
    threshold : Threshold
        Its delta is NaN if the matcher uses no threshold.
    pairs : array of bool, shape (p, q)
        Test segments in rows, model segments in columns, in either direction.
    parts : Components
        Parts of the distances of the k pairs, in the order of ``np.nonzero(pairs)``.
    share : array, shape (k,)
        Weight of each pair: the length of its target as a share of all pairs' targets, or of the
        whole target set with ``norm="all"``.
    source : array of int, shape (k,)
        Source segment of each pair.
    coverage : float
        Share of the source set's length that is paired.
    """

    threshold: Threshold
    pairs: np.ndarray
    parts: Components
    share: np.ndarray
    source: np.ndarray
    coverage: float

    @property
    def n(self) -> int:
        """Number of pairs."""
        return len(self.share)

    def olhd(self, weight: float) -> float:
        """Mean distance d(W) of the pairs weighted by length, m; NaN without pairs (equation 7)."""
        return float(self.share @ self.parts.distance(weight)) if self.n else np.nan

    @property
    def perpendicular_only(self) -> float:
        """Mean perpendicular distance of the pairs weighted by length, m; NaN without pairs."""
        return float(self.share @ self.parts.perpendicular) if self.n else np.nan


@dataclass(frozen=True, eq=False)
class LHD(Shown):
    """Line-segment Hausdorff distance between a test and a model set.

    Parameters
    ----------
    weight : float
        W.
    matcher : str
        The matcher that made the pairs.
    test_model, model_test : Directed
        Both directions.
    test, model : array, shapes (p, 2, 3) and (q, 2, 3)
        The sets, m.
    remarks : tuple of str
        Reasons to doubt the value.

    Examples
    --------
    >>> from mmqa_lab.lines import lhd
    >>> model = np.array([[[x, 0, 0], [x, 0, 6]] for x in range(0, 60, 10)], dtype=float)
    >>> test = model + [0, 0.1, 0]
    >>> test[-1, :, 1] += 40  # this segment has no partner
    >>> result = lhd(test, model, matcher="mutual")
    >>> round(result.value, 3), round(result.perpendicular_only, 3), result.test_model.n
    (0.1, 0.1, 5)
    """

    weight: float
    matcher: str
    test_model: Directed
    model_test: Directed
    test: np.ndarray
    model: np.ndarray
    remarks: tuple[str, ...]

    @cached_property
    def displacement(self) -> Displacement:
        """Displacement of the test set from the model set, from the pairs of ``test_model``."""
        return fit_displacement(self.test, self.model, self.test_model.pairs)

    @property
    def value(self) -> float:
        """The larger of both directed distances, m (equation 2); NaN without pairs."""
        return self._larger.olhd(self.weight)

    @property
    def perpendicular_only(self) -> float:
        """The larger directed mean of the perpendicular distances alone, m."""
        there, back = self.test_model, self.model_test
        return float(np.fmax(there.perpendicular_only, back.perpendicular_only))

    @property
    def _larger(self):
        """The direction whose distance is the value; a direction without pairs has none."""
        sides = self.test_model, self.model_test
        return max(sides, key=lambda side: np.nan_to_num(side.olhd(self.weight), nan=-1))

    def _ends(self):
        return [("lhd", self.value, *self._interval, "m")]

    @cached_property
    def _interval(self):
        """Interval of the value for fixed pairs and threshold: (low, high), m.

        By bootstrap of the source segments with their pairs, widened by Student's t. It covers the
        choice of the segments, not errors of the pairs. NaN with fewer than two sources.
        """
        side = self._larger
        sources, source = np.unique(side.source, return_inverse=True)
        n = len(sources)
        if n < 2:
            return np.nan, np.nan
        drawn = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), size=1000)
        weights = np.vstack([side.share, drawn[:, source] * side.share])
        # each draw is divided by its own sum of weights, for both norms
        value, *draws = weights @ side.parts.distance(self.weight) / weights.sum(axis=1)
        wider = student_reach(np.sqrt(n / (n - 1)), n - 1) / NORMAL
        ends = value + wider * (np.quantile(draws, (0.025, 0.975)) - value)
        low, high = ends * side.share.sum()
        return float(max(low, 0)), float(high)

    @np.errstate(invalid="ignore")  # there may be no right pair
    def split(self, *, truth: ArrayLike | None = None) -> pd.DataFrame:
        """Return the parts of the value: ``part``, ``value_m``.

        The parts of the larger direction add up to its distance. *displacement*: mean shift of the
        correctly paired lines across themselves, from the displacement and rotation of the set.
        *position*: excess of their perpendicular distance. *direction*: contribution of the angle.
        *ends*: of the distance along the lines. *false pairs*: contribution of the pairs that are
        not in ``truth`` (bool, (p, q); by default the pairs of :func:`match_displaced`). NaN if the
        displacement is unknown.
        """
        truth = match_displaced(self.test, self.model).pairs if truth is None else truth
        side, truth = self._larger, np.asarray(truth)
        rows, columns = np.nonzero(side.pairs)
        if side is self.model_test:  # in the order of its parts
            columns, rows = np.nonzero(side.pairs.T)
        test, model = from_common_origin(self.test, self.model)
        pairs = paired(test, model, rows, columns)
        moved = fit_displacement(self.test, self.model, side.pairs & truth)
        across = np.einsum("nkd,nd->nk", pairs.frame, moved.at(pairs.place))
        parts = side.parts
        squares = parts.perpendicular**2, self.weight * parts.angle**2, parts.parallel**2
        sizes = np.vstack([np.linalg.norm(across, axis=1), np.sqrt(np.cumsum(squares, axis=0))])
        right = side.share * truth[rows, columns]
        steps = [*(sizes @ right / right.sum()), side.share @ sizes[-1] / side.share.sum()]
        return pd.DataFrame(
            {"part": DISTANCE_PARTS, "value_m": [steps[0], *np.diff(steps), steps[-1]]}
        )

    def kinds(self) -> pd.Series:
        """Return the number of groups of each kind of correspondence (section 2.3), Series of int.

        ``one-to-null``: a segment of either set without a partner. ``one-to-one``: a single pair.
        ``one-to-multiple``: a test segment with several partners. ``multiple-to-one``: a model
        segment with several partners. ``multiple-to-multiple``: all other connected groups.
        """
        pairs = self.test_model.pairs
        p, q = pairs.shape
        rows, columns = np.nonzero(pairs)
        graph = coo_array((np.ones(len(rows)), (rows, p + columns)), shape=(p + q, p + q))
        groups, group = connected_components(graph, directed=False)
        tests = np.bincount(group[:p], minlength=groups)
        models = np.bincount(group[p:], minlength=groups)
        kind = np.where(tests + models == 1, 0, 1 + (models > 1) + 2 * (tests > 1))
        return pd.Series(np.bincount(kind, minlength=len(PAIRING)), index=PAIRING, name="groups")

    def to_frame(self) -> pd.DataFrame:
        """Return one row per direction: segments, pairs, threshold, distances, coverage.

        ``lhd`` marks the larger distance of both directions, as the paper's asterisk does.
        """
        both = [self.test_model, self.model_test]
        distances = [side.olhd(self.weight) for side in both]
        return pd.DataFrame(
            {
                "direction": WAYS,
                "p": len(self.test),
                "q": len(self.model),
                "pairs": [side.n for side in both],
                "olhd_m": distances,
                "lhd": ["*" if value == self.value else "" for value in distances],
                "perpendicular_m": [side.perpendicular_only for side in both],
                "threshold_m": [side.threshold.delta for side in both],
                "coverage": [side.coverage for side in both],
            }
        )
