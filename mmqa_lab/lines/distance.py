"""Line-segment Hausdorff distance of two sets (Poreba & Goulette 2013)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmqa_lab._checks import check_choice, check_number, listed
from mmqa_lab._results import Shown
from mmqa_lab.lines.displacement import Displacement, fit_displacement, match_displaced
from mmqa_lab.lines.pairing import (
    MATCHERS,
    Threshold,
    check_pairs,
    correspond,
    paired,
    peak_threshold,
)
from mmqa_lab.lines.segments import (
    Components,
    check_segments,
    components,
    from_common_origin,
    lengths,
)

__all__ = ["LHD", "Directed", "compare", "lhd"]

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
    remarks : list of str
        Reasons to doubt the value.

    Examples
    --------
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
    remarks: list[str]

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
        wider = stats.t.ppf(0.975, n - 1) / stats.norm.ppf(0.975) * np.sqrt(n / (n - 1))
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


def lhd(
    test: ArrayLike,
    model: ArrayLike,
    *,
    weight: float = 10.0,
    matcher: str = "all",
    rotate: str = "test",
    within: str = "containment",
    norm: str = "pairs",
    threshold: Callable = peak_threshold,
    pairs: ArrayLike | None = None,
    radius: float = 4.0,
) -> LHD:
    """Line-segment Hausdorff distance between a test and a model set.

    In each direction the threshold is at the jump of the sorted nearest distances. Segments within
    the threshold are paired. The directed distance is the mean over the pairs, weighted by the
    length of the target. The larger directed distance is the result.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    weight : float
        W of the angle, >= 0.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments", "displaced"}
        ``all`` is the published method. ``displaced`` estimates the displacement first
        (:func:`match_displaced`); if it finds no pairs, ``fragments`` is used.
    rotate, within
        As in :func:`components`.
    norm : {"pairs", "all"}
        Divisor of the weighted sum of equation 7: the summed length of all pairs (a mean, which
        agrees with the published numbers), or of all targets (as printed).
    threshold : callable
        Takes the nearest distances of a direction (m) and returns a :class:`Threshold`. For other
        settings of :func:`peak_threshold` use ``functools.partial``.
    pairs : array_like of bool, shape (p, q), optional
        Known pairs, used instead of threshold and matcher.
    radius : float
        Largest displacement that ``displaced`` seeks, m.

    Returns
    -------
    LHD

    Raises
    ------
    ValueError
        If a setting is out of range, or the nearest segments of both sets are more than 100 m
        apart, as in different coordinate systems.

    Warns
    -----
    UserWarning
        If a set is empty, a threshold is a fallback, fewer than five pairs remain, or ``displaced``
        pairs few of the lines, or none and is replaced by ``fragments``.

    See Also
    --------
    match_displaced : the displacement of the sets itself, with its covariance.

    Notes
    -----
    The value is no displacement. Noise of angles and end points and false pairs increase it, and a
    large displacement reduces it. Compare :attr:`LHD.perpendicular_only`, ``displacement`` and the
    coverage. The value is no metric either.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2 and equations 2 to 7.

    Examples
    --------
    >>> both = [[[0, 0, 0], [9, 0, 0]], [[0, 0, 0], [0, 0, 6]], [[9, 0, 0], [9, 0, 7]],
    ...         [[9, 0, 7], [9, 8, 7]], [[0, 0, 6], [0, 8, 6]]]
    >>> model = [*both, [[0, 20, 0], [0, 20, 6]]]
    >>> test = np.array([*both, [[9, 40, 0], [9, 40, 7]]]) + [0.3, 0, 0.1]
    >>> result = lhd(test, model)
    >>> round(result.value, 3), result.test_model.n
    (0.316, 5)
    >>> (result.displacement.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    weight = check_number(weight, "weight", low=0)
    check_choice(matcher, "matcher", (*MATCHERS, "displaced"))
    check_choice(norm, "norm", ("pairs", "all"))
    test, model = check_segments(test, "test"), check_segments(model, "model")
    settings = {"weight": weight, "rotate": rotate, "within": within, "norm": norm}
    settings["threshold"], doubts = threshold, []
    if pairs is not None:
        pairs = check_pairs(pairs, (len(test), len(model)))
    elif matcher == "displaced":
        moved = match_displaced(test, model, radius=radius)
        pairs, doubts = moved.pairs, [moved.remark] if moved.remark and moved.pairs.size else []
        if pairs.size and not pairs.any():
            pairs, matcher = None, "fragments"
            doubts += ["Matcher 'fragments' is used."]
    there = _one_way(test, model, matcher=matcher, pairs=pairs, **settings)
    turned = None if pairs is None else pairs.T
    back = _one_way(model, test, matcher=matcher, pairs=turned, **settings)
    back = replace(back, pairs=back.pairs.T)
    remarks = [*_doubts(test, model, there, back), *doubts]
    for remark in remarks:
        warnings.warn(remark, stacklevel=2)
    return LHD(weight, matcher, there, back, test, model, remarks)


def _one_way(source, target, *, threshold, matcher, pairs, weight, rotate, within, norm):
    """Directed distance from source to target, with pairs (source, target)."""
    parts = components(source, target, rotate=rotate, within=within)
    distances = parts.distance(weight)
    nearest = distances.min(axis=1) if len(target) else np.empty(0)
    if len(nearest) and nearest.min() > 100:
        wanted = "segments within 100 m of each other, in one coordinate system"
        raise ValueError(f"Invalid sets {nearest.min():.0f} m apart. Must have {wanted}.")
    found = Threshold(np.nan, False, np.sort(nearest))
    if pairs is None:
        found = threshold(nearest)
        pairs = correspond(distances, found.delta, matcher=matcher, test=source, model=target)
    rows, columns = np.nonzero(pairs)
    own, length = lengths(source), lengths(target)
    total = length[columns].sum() if norm == "pairs" else length.sum()
    return Directed(
        threshold=found,
        pairs=pairs,
        parts=Components(*(part[rows, columns] for part in vars(parts).values())),
        share=length[columns] / total,
        source=rows,
        coverage=float(own[np.unique(rows)].sum() / own.sum()) if len(own) else np.nan,
    )


def _doubts(test, model, there, back):
    """Reasons to doubt a distance, each as a sentence."""
    if empty := [name for name, ends in (("test", test), ("model", model)) if not len(ends)]:
        return [f"No {' and no '.join(empty)} segments, so there is nothing to measure."]
    sentences = []
    for way, side in zip(WAYS, (there, back), strict=True):
        if side.threshold.fallback:
            largest = f"The threshold is the largest distance, {side.threshold.delta:.3g} m."
            sentences.append(f"No jump in the nearest distances from {way}. {largest}")
        if side.n < 5:
            sentences.append(f"Only {side.n} pairs from {way}. The value may be due to chance.")
    return sentences


def compare(
    sets: Mapping[str, ArrayLike],
    *,
    reference: str | None = None,
    radius: float = 4.0,
    **choices: Any,
) -> pd.DataFrame:
    """Compare several sets of segments with each other in both directions, as in the paper.

    Parameters
    ----------
    sets : dict of str to array_like, shape (n, 2, 3)
        Segments by name, two sets or more, m.
    reference : str, optional
        The reference set, which is always the model.
    radius : float
        Largest displacement that is sought, m.
    **choices
        Passed to :func:`lhd`.

    Returns
    -------
    DataFrame
        A row for each comparison and direction: ``kind`` (repeatability, absolute), ``comparison``,
        the columns of :meth:`LHD.to_frame`, the 95 % confidence interval of the larger distance,
        the displacement (m) with its standard deviations, the number of pairs that
        agree on it (``displaced_pairs``), and ``remarks``.

    Raises
    ------
    ValueError
        If there are fewer than two sets, one is empty, or two have no segments within 100 m.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), Tables 1 and 2.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> scene = canyon(1)
    >>> sets = {name: scene.surveys[name].segments for name in ("TLS", "C1", "C3")}
    >>> compare(sets, reference="TLS")["direction"].tolist()[:3]
    ['C1 to C3', 'C3 to C1', 'C1 to TLS']
    """
    checked = {name: check_segments(segments, name) for name, segments in sets.items()}
    if len(checked) < 2 or not all(map(len, checked.values())):
        told = listed(f"{name} with {len(ends)} segments" for name, ends in checked.items())
        raise ValueError(f"Invalid sets {told or 'of none'}. Must be two or more with segments.")
    check_choice(reference, "reference", (None, *sets))
    courses = [name for name in sets if name != reference]
    pairs = [("repeatability", names) for names in combinations(courses, 2)]
    pairs += [("absolute", (name, reference)) for name in courses if reference is not None]
    tables = [_compared(*pair, checked, radius, choices) for pair in pairs]
    return pd.concat(tables, ignore_index=True)


def _compared(kind, names, sets, radius, choices):
    """The two rows of a comparison."""
    test, model = (sets[name] for name in names)
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        found = lhd(test, model, radius=radius, **choices)
    moved = found.displacement
    if found.matcher != "displaced":
        moved = match_displaced(test, model, radius=radius)
    table, remarks = found.to_frame(), found.remarks
    table["direction"] = " to ".join(names), " to ".join(names[::-1])
    table.insert(0, "kind", kind)
    table.insert(1, "comparison", "-".join(names))
    table["lhd_low_m"], table["lhd_high_m"] = found.intervals()[["low", "high"]].to_numpy()[0]
    for k, axis in enumerate("xyz"):
        table[f"displacement_{axis}_m"] = moved.vector[k]
        table[f"sigma_{axis}_m"] = np.sqrt(moved.covariance[k, k])
    table["displaced_pairs"] = moved.n
    if moved.remark and moved.remark not in remarks:
        remarks = [*remarks, moved.remark]
    if not np.isfinite(moved.vector).all():
        remarks = [*remarks, "No displacement: too few lines agree, or all of them are parallel."]
    return table.assign(remarks=" ".join(remarks))
