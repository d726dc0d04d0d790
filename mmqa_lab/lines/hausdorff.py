"""The line-segment Hausdorff distance of two segment sets and what it is made of."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri, stdtrit

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.lines.displacement import (
    Displacement,
    across_pairs,
    fit_displacement,
    match_displaced,
)
from mmqa_lab.lines.segments import (
    MATCHERS,
    Components,
    Segments,
    Threshold,
    check_segments,
    components,
    correspond,
    distance_matrix,
    peak_threshold,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

NORMS = ("pairs", "matched", "all")
APART_M = 100.0
"""Sets whose nearest segments are farther apart than this are in different frames."""

KINDS = ["one-to-null", "one-to-one", "one-to-multiple", "multiple-to-one", "multiple-to-multiple"]
PARTS = ("displacement", "position", "direction", "ends", "false pairs", "all")
"""What a distance is made of, and their sum."""

REPEATS, ENDS = 1000, ((1 - 0.95) / 2, (1 + 0.95) / 2)
"""Of the bootstrap of the distance, and half as many of its parts; quantiles of 95 %."""

FEW_PAIRS = 5
AGREED_SHARE, WEAK_EVIDENCE = 0.6, 3.5
"""The displaced matcher gives way when it finds less than this share of the pairs that the
fragments matcher finds, and its own pairs are no likelier than this (log per pair)."""


@dataclass(frozen=True, eq=False)
class Directed:
    """One direction of the distance: from each source segment to its targets.

    Parameters
    ----------
    threshold : Threshold
        Its delta is NaN for the displaced matcher, which has none.
    pairs : array of bool, shape (p, q)
        Test segments in rows, model segments in columns, in either direction.
    parts : Components
        Of the k pairs' distances in the order of ``np.nonzero(pairs)``.
    length : array, shape (k,)
        Length of each pair's target, its weight in the mean, m.
    source : array of int, shape (k,)
        Source segment of each pair.
    coverage : float
        Share of the source set's length that is paired.
    total : float
        What the weighted sum of :meth:`olhd` is divided by, m.
    """

    threshold: Threshold
    pairs: np.ndarray
    parts: Components
    length: np.ndarray
    source: np.ndarray
    coverage: float
    total: float

    @property
    def n(self):
        """Number of pairs."""
        return len(self.length)

    def olhd(self, weight):
        """Mean distance d(W) of the pairs weighted by length, m; NaN without pairs (equation 7)."""
        return self._mean(self.parts.distance(weight))

    @property
    def perpendicular_only(self):
        """Mean perpendicular distance of the pairs weighted by length, m; NaN without pairs."""
        return self._mean(self.parts.perpendicular)

    def resampled(self, weight, repeats, rng):
        """Bootstrap values of :meth:`olhd`, source segments drawn with their pairs, (repeats,)."""
        _, cluster = np.unique(self.source, return_inverse=True)
        sums = np.bincount(cluster, self.length * self.parts.distance(weight))
        lengths = np.bincount(cluster, self.length)
        draws = rng.multinomial(len(sums), np.full(len(sums), 1 / len(sums)), size=repeats)
        return (draws @ sums) / (draws @ lengths) * (lengths.sum() / self.total)

    def _mean(self, values):
        return float(self.length @ values / self.total) if self.n else np.nan


@dataclass(frozen=True, eq=False)
class LHD(Shown):
    """Line-segment Hausdorff distance between a test and a model set.

    Parameters
    ----------
    weight, sensitivity : float
        W and the peak sensitivity, m.
    matcher : str
        The matcher that made the pairs.
    test_model, model_test : Directed
        Both directions.
    test, model : Segments
        The sets.
    asked : str
        The matcher that was asked for; differs when the displaced matcher gave way.

    Raises
    ------
    ValueError
        If a weight is negative.

    Examples
    --------
    >>> model = np.array([[[x, 0, 0], [x, 0, 6]] for x in range(0, 60, 10)], dtype=float)
    >>> test = model + [0, 0.1, 0]
    >>> test[-1, :, 1] += 40  # of this one there is no partner
    >>> result = lhd(test, model, matcher="mutual")
    >>> round(result.value, 3), round(result.perpendicular_only, 3), result.test_model.n
    (0.1, 0.1, 5)
    """

    weight: float
    sensitivity: float
    matcher: str
    test_model: Directed
    model_test: Directed
    test: Segments
    model: Segments
    asked: str

    @cached_property
    def displacement(self) -> Displacement:
        """Displacement of the test set from the model set, from the pairs of ``test_model``."""
        return fit_displacement(self.test, self.model, self.test_model.pairs)

    @property
    def value(self) -> float:
        """The larger of both directed distances, m (equation 2); NaN without pairs."""
        return self.at_weight(self.weight)

    def at_weight(self, weight: float) -> float:
        """The distance of the same pairs under another W, m; W = 0 leaves the angle out."""
        return float(np.fmax(self.test_model.olhd(weight), self.model_test.olhd(weight)))

    @property
    def perpendicular_only(self) -> float:
        """The larger directed mean of the perpendicular distances alone, m."""
        both = self.test_model.perpendicular_only, self.model_test.perpendicular_only
        return float(np.fmax(*both))

    def interval(self, *, seed: int = 0) -> tuple[float, float]:
        """95 % bootstrap interval of the value for fixed pairs and threshold: (low, high), m.

        Says how far the value depends on the segments that happened to be found, not whether the
        pairs are right. NaN below two sources in each direction.
        """
        rng = np.random.default_rng(check_count(seed, "seed", low=0))
        sides = self.test_model, self.model_test
        if any(len(np.unique(side.source)) < 2 for side in sides):
            return np.nan, np.nan
        # both weigh the same pairs: drawn apart, the larger of the two would rise
        larger = max(sides, key=lambda side: side.olhd(self.weight))
        n = len(np.unique(larger.source))
        ends = np.quantile(larger.resampled(self.weight, REPEATS, rng), ENDS)
        low, high = _widened(ends, self.value, n)
        return max(float(low), 0.0), float(high)

    def split(self, *, truth: ArrayLike | None = None) -> pd.DataFrame:
        """Return the parts of the value: ``part``, ``value_m``, ``low_m``, ``high_m``.

        The parts of the larger direction add up to its distance. *displacement*: mean of what the
        displacement field moves the rightly paired lines across themselves. *position* and
        *direction*: what their perpendicular distance exceeds that by, and what the angle adds,
        both of the extraction of edges. *ends*: what the parallel distance adds. *false pairs*:
        what the pairs do that are none of ``truth`` (bool, (p, q); by default the pairs that agree
        on one displacement, of :func:`match_displaced`). 95 % intervals by bootstrap of the source
        segments, with the covariance of the displacement. NaN where it is unknown.
        """
        truth = match_displaced(self.test, self.model).pairs if truth is None else truth
        first = self.test_model.olhd(self.weight) == self.value
        side = self.test_model if first else self.model_test
        columns = self._parts(side, np.asarray(truth))
        if columns is None:
            columns = np.full((1, len(PARTS)), np.nan)
        n = len(np.unique(side.source))
        low, high = _widened(np.quantile(columns, ENDS, axis=0), columns[0], n)
        found = {"part": PARTS, "value_m": columns[0], "low_m": low, "high_m": high}
        return pd.DataFrame(found)

    def _parts(self, side, truth):
        """The parts in columns: measured in the first row, then resampled ones."""
        rng, repeats = np.random.default_rng(0), REPEATS // 2
        rows, columns = np.nonzero(side.pairs)
        right = truth[rows, columns]
        moved = across_pairs(self.test, self.model, side.pairs & truth)
        if moved is None:
            return None
        at, frame, covariance = moved
        across = np.linalg.cholesky(covariance) @ rng.normal(size=(3, repeats + 1))
        across[:, 0] = 0
        steps = np.zeros((3, len(rows)))
        steps[0] = side.parts.perpendicular
        steps[1] = np.hypot(steps[0], np.sqrt(self.weight) * side.parts.angle)
        steps[2] = np.hypot(steps[1], side.parts.parallel)
        _, cluster = np.unique(side.source, return_inverse=True)
        n = cluster.max() + 1
        found = []
        for k in range(repeats + 1):
            draws = rng.multinomial(n, np.full(n, 1 / n)) if k else np.ones(n)
            weights = draws[cluster] * side.length
            if not weights @ right:
                continue
            moves = np.linalg.norm(np.einsum("nkd,nd->nk", frame, at + across[:, k]), axis=1)
            means = [np.average(moves, weights=weights[right])]
            means += [np.average(step[right], weights=weights[right]) for step in steps]
            means.append(np.average(steps[2], weights=weights))
            found.append([means[0], *np.diff(means), means[-1]])
        return np.array(found)

    def kinds(self) -> pd.Series:
        """Return how many segments have which correspondence (section 2.3): Series of int.

        ``one-to-null``: without a partner, in either set. ``one-to-one``; ``one-to-multiple``: a
        test segment with several partners of its own; ``multiple-to-one``: a model segment with
        several; ``multiple-to-multiple``: what remains, as groups that hang together.
        """
        pairs = self.test_model.pairs
        p, q = pairs.shape
        rows, columns = np.nonzero(pairs)
        graph = coo_array((np.ones(len(rows)), (rows, p + columns)), shape=(p + q, p + q))
        groups, group = connected_components(graph, directed=False)
        tests = np.bincount(group[:p], minlength=groups)
        models = np.bincount(group[p:], minlength=groups)
        kind = np.where(tests + models == 1, 0, 1 + (models > 1) + 2 * (tests > 1))
        return pd.Series(np.bincount(kind, minlength=len(KINDS)), index=KINDS, name="groups")

    def to_frame(self) -> pd.DataFrame:
        """Return one row per direction: segments, pairs, threshold, distances, coverage."""
        both = [self.test_model, self.model_test]
        return pd.DataFrame(
            {
                "direction": ["test to model", "model to test"],
                "pairs": [part.n for part in both],
                "threshold_m": [part.threshold.delta for part in both],
                "olhd_m": [part.olhd(self.weight) for part in both],
                "olhd_w0_m": [part.olhd(0) for part in both],
                "perpendicular_m": [part.perpendicular_only for part in both],
                "coverage": [part.coverage for part in both],
            }
        )

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw both sets from above and a line between the midpoints of each pair."""
        ax = self.model.plot(ax=ax, color="0.75", lw=3, solid_capstyle="round")
        self.test.plot(ax=ax)
        for row, column in np.argwhere(self.test_model.pairs):
            link = self.test.midpoints[row], self.model.midpoints[column]
            ax.plot(*np.array(link)[:, :2].T, color="tab:red", lw=0.7)
        return ax

    def to_dict(self) -> dict[str, Any]:
        """Return what ``mmqa lhd --json`` prints."""
        directions = {"test_model": self.test_model, "model_test": self.model_test}
        values = {
            "weight": self.weight,
            "sensitivity_m": self.sensitivity,
            "matcher": self.asked,
            "matcher_used": self.matcher,
            "p": len(self.test),
            "q": len(self.model),
            "lhd_m": self.value,
            "threshold_fallback": [part.threshold.fallback for part in directions.values()],
            "lhd_w0_m": self.at_weight(0),
            "perpendicular_only_m": self.perpendicular_only,
            "displacement_m": self.displacement.vector.tolist(),
            "displacement_covariance_m2": self.displacement.covariance.tolist(),
            "turn_deg": self.displacement.turn_deg,
            "turn_sigma_deg": self.displacement.turn_sigma_deg,
        }
        for name, part in directions.items():
            values[f"olhd_{name}_m"] = part.olhd(self.weight)
            values[f"threshold_{name}_m"] = part.threshold.delta
            values[f"pairs_{name}"] = np.argwhere(part.pairs).tolist()
            values[f"coverage_{name.split('_')[0]}"] = part.coverage
        return values


def hausdorff(test: Segments, model: Segments, **choices) -> float:
    """Plain Hausdorff distance of two segment sets: the largest of all nearest distances.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    **choices
        Of :func:`mmqa_lab.lines.distance_matrix`: ``weight``, ``rotate``, ``within``.

    Returns
    -------
    float
        The larger of both directions, m; NaN when a set is empty.

    Notes
    -----
    A single segment without a counterpart decides it: hence the mean over pairs of :func:`lhd`.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), equations 1 and 2.

    Examples
    --------
    >>> model = [[[0, 0, 0], [9, 0, 0]], [[0, 5, 0], [9, 5, 0]]]
    >>> hausdorff([[[0, 0.5, 0], [9, 0.5, 0]]], model)
    4.5
    """
    there, back = distance_matrix(test, model, **choices), distance_matrix(model, test, **choices)
    if not there.size:
        return np.nan
    return float(max(there.min(axis=1).max(), back.min(axis=1).max()))


def _widened(ends, value, n):
    """Ends as wide as Student's t asks for where a bootstrap of n takes the normal's quantile."""
    wider = stdtrit(n - 1, ENDS[1]) / ndtri(ENDS[1]) * np.sqrt(n / (n - 1)) if n > 1 else np.nan
    return value + wider * (ends - value)


def lhd(
    test: Segments,
    model: Segments,
    *,
    weight: float = 10.0,
    sensitivity: float = 0.5,
    matcher: str = "all",
    rotate: str = "test",
    within: str = "containment",
    norm: str = "pairs",
    threshold: Callable | None = None,
    pairs: np.ndarray | None = None,
    radius: float = 4.0,
) -> LHD:
    """Line-segment Hausdorff distance between a test and a model set.

    Each direction takes the distances of all pairs, finds the threshold where the sorted nearest
    distances jump, pairs segments, and averages the pairs' distances weighted by the target's
    length; the larger direction is the distance.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    weight : float
        W of the angle, >= 0.
    sensitivity : float
        Of the peak that gives the threshold, m. Decides more than W.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments", "displaced"}
        ``all`` is the published method. ``displaced`` estimates the displacement first
        (:func:`match_displaced`); where it finds too little it gives way to ``fragments``.
    rotate, within
        As in :func:`components`.
    norm : {"pairs", "matched", "all"}
        What the weighted sum of equation 7 is divided by: the lengths of all pairs (a mean; agrees
        with the published numbers), of each matched target once, or of all targets (as printed).
    threshold : callable, optional
        Takes the nearest distances of one direction and returns a :class:`Threshold`, or its
        delta; by default :func:`peak_threshold` with ``sensitivity``.
    pairs : array_like of bool, shape (p, q), optional
        Pairs that are known, in place of threshold and matcher.
    radius : float
        Largest displacement that ``displaced`` seeks, m.

    Returns
    -------
    LHD

    Raises
    ------
    ValueError
        If a setting is out of range, or the nearest segments of both sets are more than 100 m
        apart: different coordinate systems.

    Warns
    -----
    UserWarning
        If a set is empty, a threshold is a fallback, fewer than five pairs remain, segments
        repeat, or the displaced matcher gave way.

    Notes
    -----
    The value is no displacement: angle and end-point noise add to it, false pairs enlarge and a
    large displacement shrinks it. Look at :attr:`LHD.perpendicular_only`, ``displacement`` and
    the coverage as well. It is no metric either.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2 and equations 2 to 7.

    Examples
    --------
    >>> from mmqa_lab.lines import Segments
    >>> both = [[[0, 0, 0], [9, 0, 0]], [[0, 0, 0], [0, 0, 6]], [[9, 0, 0], [9, 0, 7]],
    ...         [[9, 0, 7], [9, 8, 7]], [[0, 0, 6], [0, 8, 6]]]
    >>> model = Segments([*both, [[0, 20, 0], [0, 20, 6]]])
    >>> test = Segments([*both, [[9, 40, 0], [9, 40, 7]]]).moved([0.3, 0, 0.1])
    >>> result = lhd(test, model)
    >>> round(result.value, 3), result.test_model.n
    (0.316, 5)
    >>> (result.displacement.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    weight = check_number(weight, "weight", low=0)
    sensitivity = check_positive(sensitivity, "sensitivity", unit="m")
    check_choice(matcher, "matcher", (*MATCHERS, "displaced"))
    check_choice(norm, "norm", NORMS)
    threshold = threshold or partial(peak_threshold, sensitivity=sensitivity)
    sets = check_segments(test, name="test"), check_segments(model, name="model")
    orders = sets, sets[::-1]
    parts = [components(*order, rotate=rotate, within=within) for order in orders]
    distances = [part.distance(weight) for part in parts]
    thresholds = [_threshold(threshold, values) for values in distances]
    _refuse_apart(thresholds[0], *sets)
    if pairs is not None:
        pairs, used = np.asarray(pairs), "given"
        matcher, both = used, (pairs, pairs.T)
        if pairs.dtype != bool or pairs.shape != distances[0].shape:
            raise ValueError(
                f"Invalid pairs of type {pairs.dtype} and shape {pairs.shape}. "
                f"Must be Boolean of shape {distances[0].shape}."
            )
    else:
        used, both = _pairs(matcher, orders, distances, thresholds, radius)
    if used in ("displaced", "given"):
        thresholds = [Threshold(np.nan, False, threshold.nearest) for threshold in thresholds]
    forward = _directed(thresholds[0], both[0], parts[0], sets, norm)
    backward = _directed(thresholds[1], both[1].T, parts[1], sets[::-1], norm, turned=True)
    result = LHD(weight, sensitivity, used, forward, backward, *sets, matcher)
    _warn(result, *sets)
    return result


def _threshold(threshold, distances):
    """What a threshold function makes of each row's least distance; a bare number is a delta."""
    nearest = distances.min(axis=1) if distances.shape[1] else np.empty(0)
    found = threshold(nearest)
    if isinstance(found, Threshold):
        return found
    return Threshold(float(found), False, np.sort(nearest))


def _pairs(matcher, orders, distances, thresholds, radius):
    """The matcher used and the pairs of both directions, each (source, target)."""
    if matcher == "displaced":
        match = match_displaced(*orders[0], radius=radius)
        others = _pairs("fragments", orders, distances, thresholds, radius)
        few = match.pairs.sum() < AGREED_SHARE * others[1][0].sum()
        if few and not match.evidence > WEAK_EVIDENCE:
            return others
        return matcher, [match.pairs, match.pairs.T]
    both = [
        correspond(values, threshold.delta, matcher=matcher, test=a, model=b)
        for values, threshold, (a, b) in zip(distances, thresholds, orders, strict=True)
    ]
    return matcher, both


def _directed(threshold, pairs, parts, order, norm, turned=False):
    """One direction; ``pairs`` are (test, model), turned where the model is the source."""
    source, target = order
    here = np.nonzero(pairs)[:: -1 if turned else 1]
    matched = np.unique(here[0])
    whole = source.lengths.sum()
    totals = {
        "pairs": target.lengths[here[1]].sum(),
        "matched": target.lengths[np.unique(here[1])].sum(),
        "all": target.lengths.sum(),
    }
    return Directed(
        threshold=threshold,
        pairs=pairs,
        parts=Components(*(part[here] for part in vars(parts).values())),
        length=target.lengths[here[1]],
        source=here[0],
        coverage=float(source.lengths[matched].sum() / whole) if whole else np.nan,
        total=float(totals[norm]),
    )


def _refuse_apart(threshold, test, model):
    """Raise when the sets do not meet anywhere."""
    if not len(threshold.nearest) or threshold.nearest[0] <= APART_M:
        return
    boxes = " and ".join(f"{name} {_box(s)}" for name, s in (("test", test), ("model", model)))
    raise ValueError(
        f"Invalid sets {threshold.nearest[0]:.0f} m apart: {boxes}. "
        f"Must have segments within {APART_M:.0f} m of each other, in one coordinate system."
    )


def _box(segments):
    """The bounding box in words, m."""
    low, high = segments.ends.min(axis=(0, 1)), segments.ends.max(axis=(0, 1))
    return f"{low.round(1).tolist()} to {high.round(1).tolist()}"


def _warn(result, test, model):
    """Say what makes the value doubtful."""
    said = []
    for name, segments in (("test", test), ("model", model)):
        if not len(segments):
            said.append(f"No {name} segments: nothing to measure.")
        elif len(np.unique(np.sort(segments.ends, axis=1), axis=0)) < len(segments):
            said.append(f"Some {name} segments repeat and count twice.")
    if len(test) and len(model):
        directions = {"test to model": result.test_model, "model to test": result.model_test}
        for name, direction in directions.items():
            if direction.threshold.fallback:
                said.append(
                    f"No jump in the nearest distances from {name}: the largest, "
                    f"{direction.threshold.delta:.3g} m, is the threshold."
                )
            if direction.n < FEW_PAIRS:
                said.append(f"Only {direction.n} pairs from {name}: a value of chance.")
    if result.matcher != result.asked:
        said.append(f"Too few pairs agree on one displacement: matcher {result.matcher!r} is used.")
    for sentence in said:
        warnings.warn(sentence, stacklevel=3)
