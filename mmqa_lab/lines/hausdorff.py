"""The line-segment Hausdorff distance of two segment sets and what it is made of."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import norm as normal
from scipy.stats import t as student

from mmqa_lab._checks import check_choice, check_count, check_number
from mmqa_lab._results import Shown
from mmqa_lab.lines.displacement import (
    Displacement,
    Pairs,
    fit_displacement,
    match_displaced,
)
from mmqa_lab.lines.segments import (
    MATCHERS,
    Components,
    Threshold,
    check_segments,
    components,
    correspond,
    distance_matrix,
    lengths,
    pairing_scores,
    peak_threshold,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

APART_M = 100.0
"""Sets whose nearest segments are farther apart than this are in different frames."""

KINDS = ["one-to-null", "one-to-one", "one-to-multiple", "multiple-to-one", "multiple-to-multiple"]
PARTS = ["displacement", "position", "direction", "ends", "false pairs", "all"]
"""What a distance is made of, and their sum."""

REPEATS, ENDS = 1000, (0.025, 0.975)
"""Of the bootstrap, and the quantiles of its 95 % interval."""

FEW_PAIRS = 5
AGREED_SHARE = 0.6
"""The displaced matcher gives way when it finds less than this share of the pairs that the
fragments matcher finds."""


@dataclass(frozen=True, eq=False)
class Directed:
    """One direction of the distance: from each source segment to its targets.

    Parameters
    ----------
    threshold : Threshold
        Its delta is NaN where a matcher has none.
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

    def _mean(self, values):
        return float(self.length @ values / self.total) if self.n else np.nan

    def draws(self, repeats, rng):
        """Bootstrap weights of the pairs, source segments drawn with their pairs: (repeats, k)."""
        _, cluster = np.unique(self.source, return_inverse=True)
        n = cluster.max() + 1
        return rng.multinomial(n, np.full(n, 1 / n), size=repeats)[:, cluster] * self.length

    def widened(self, ends, value):
        """Ends of a bootstrap as wide as Student's t asks for, where it takes the normal's."""
        n = len(np.unique(self.source))
        if n < 2:
            return np.full_like(ends, np.nan)
        wider = student.ppf(ENDS[1], n - 1) / normal.ppf(ENDS[1]) * np.sqrt(n / (n - 1))
        return value + wider * (ends - value)


@dataclass(frozen=True, eq=False)
class LHD(Shown):
    """Line-segment Hausdorff distance between a test and a model set.

    Parameters
    ----------
    weight : float
        W.
    matcher, asked : str
        The matcher that made the pairs, and the one asked for: the displaced one may give way.
    test_model, model_test : Directed
        Both directions.
    test, model : array, shapes (p, 2, 3) and (q, 2, 3)
        The sets, m.

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
    matcher: str
    asked: str
    test_model: Directed
    model_test: Directed
    test: np.ndarray
    model: np.ndarray

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

    @property
    def _larger(self):
        """The direction whose distance is the value."""
        return max((self.test_model, self.model_test), key=lambda side: side.olhd(self.weight))

    def interval(self, *, seed: int = 0) -> tuple[float, float]:
        """95 % confidence interval of the value for fixed pairs and threshold: (low, high), m.

        By bootstrap of the source segments. Says how far the value depends on the segments that
        happened to be found, not whether the pairs are right. NaN below two sources a direction.
        """
        rng = np.random.default_rng(check_count(seed, "seed", low=0))
        sides = self.test_model, self.model_test
        if min(len(np.unique(side.source)) for side in sides) < 2:
            return np.nan, np.nan
        side = self._larger
        # its own denominator, whatever the norm
        weights = side.draws(REPEATS, rng)
        values = weights @ side.parts.distance(self.weight) / weights.sum(axis=1)
        ends = np.quantile(values, ENDS) * side.length.sum() / side.total
        low, high = side.widened(ends, self.value)
        return float(np.maximum(low, 0)), float(high)

    def split(self, *, truth: ArrayLike | None = None) -> pd.DataFrame:
        """Return the parts of the value: ``part``, ``value_m``, ``low_m``, ``high_m``.

        The parts of the larger direction add up to its distance. *displacement*: mean of what the
        displacement and turn of the set move the rightly paired lines across themselves. *position*
        and *direction*: what their perpendicular distance exceeds that by, and what the angle adds,
        both of the extraction of edges and of drift. *ends*: what the parallel distance adds.
        *false pairs*: what the pairs do that are none of ``truth`` (bool, (p, q); by default the
        pairs that agree on one displacement, of :func:`match_displaced`). 95 % confidence intervals
        by bootstrap of the source segments, with the covariance of the displacement. NaN where
        unknown.
        """
        truth = match_displaced(self.test, self.model).pairs if truth is None else truth
        side, truth = self._larger, np.asarray(truth)
        right = truth[np.nonzero(side.pairs)]
        pairs = Pairs(self.test, self.model, *np.nonzero(side.pairs))
        moved = fit_displacement(self.test, self.model, side.pairs & truth)
        found = pd.DataFrame({"part": PARTS, "value_m": np.nan, "low_m": np.nan, "high_m": np.nan})
        if not np.isfinite(moved.vector).all():
            return found
        rng, repeats = np.random.default_rng(0), REPEATS // 2
        weights = np.concatenate([side.length[None], side.draws(repeats, rng)])
        weights = weights[(weights * right).any(axis=1)]
        shift = rng.multivariate_normal(np.zeros(3), moved.covariance, len(weights), method="eigh")
        shift[0] = 0  # the first row is the measurement, the others are drawn
        across = np.einsum("nkd,nd->nk", pairs.frame, moved.at(pairs.place))
        moves = np.linalg.norm(across + np.einsum("nkd,rd->rnk", pairs.frame, shift), axis=2)
        sums = side.parts.perpendicular**2
        steps = [moves, np.sqrt(sums)]
        for part in (np.sqrt(self.weight) * side.parts.angle, side.parts.parallel):
            sums = sums + part**2
            steps.append(np.sqrt(sums))
        means = [(weights * right * step).sum(axis=1) / (weights @ right) for step in steps]
        means.append(weights @ steps[-1] / weights.sum(axis=1))
        columns = np.column_stack([means[0], np.diff(means, axis=0).T, means[-1]])
        ends = [np.quantile(columns, end, axis=0) for end in ENDS]
        found["value_m"] = columns[0]
        found["low_m"], found["high_m"] = (side.widened(end, columns[0]) for end in ends)
        return found

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
        """Return one row per direction: segments, pairs, threshold, distances, coverage.

        ``lhd`` marks the larger distance of both directions, as the paper's asterisk does.
        """
        both = [self.test_model, self.model_test]
        distances = [side.olhd(self.weight) for side in both]
        return pd.DataFrame(
            {
                "direction": ["test to model", "model to test"],
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

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw both sets from above; pairs in colour, upright lines as dots."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        rows, columns = np.nonzero(self.test_model.pairs)
        for name, segments, paired, look in (
            ("model", self.model, columns, {"color": "0.75", "lw": 3}),
            ("test", self.test, rows, {"color": "black", "lw": 1}),
        ):
            ax.plot(*_from_above(segments), marker=".", ms=3, label=name, **look)
            if name == "test":
                look = {"color": plots.COLOURS["vermilion"], "lw": 1.5}
                ax.plot(*_from_above(segments[paired]), marker=".", ms=4, label="paired", **look)
        ax.set(xlabel="easting (m)", ylabel="northing (m)", aspect="equal")
        ax.legend()
        return ax


def _from_above(segments):
    """x and y of segments in one line each, with gaps between them."""
    gaps = np.full((len(segments), 1, 2), np.nan)
    return np.concatenate([segments[..., :2], gaps], axis=1).reshape(-1, 2).T


def hausdorff(test: ArrayLike, model: ArrayLike, **choices) -> float:
    """Plain Hausdorff distance of two segment sets: the largest of all nearest distances.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
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
    matrices = distance_matrix(test, model, **choices), distance_matrix(model, test, **choices)
    if not matrices[0].size:
        return np.nan
    return float(max(matrix.min(axis=1).max() for matrix in matrices))


def lhd(
    test: ArrayLike,
    model: ArrayLike,
    *,
    weight: float = 10.0,
    sensitivity: float = 0.5,
    matcher: str = "all",
    rotate: str = "test",
    within: str = "containment",
    norm: str = "pairs",
    threshold: Callable | None = None,
    pairs: ArrayLike | None = None,
    radius: float = 4.0,
) -> LHD:
    """Line-segment Hausdorff distance between a test and a model set.

    Each direction takes the distances of all pairs, finds the threshold where the sorted nearest
    distances jump, pairs segments, and averages the pairs' distances weighted by the target's
    length; the larger direction is the distance.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    weight : float
        W of the angle, >= 0.
    sensitivity : float
        Of the peak that gives the threshold, m. Decides more than W.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments", "displaced"}
        ``all`` is the published method. ``displaced`` estimates the displacement first
        (:func:`match_displaced`); where it finds too little it gives way to ``fragments``.
    rotate, within
        As in :func:`components`.
    norm : {"pairs", "all"}
        What the weighted sum of equation 7 is divided by: the lengths of all pairs (a mean; agrees
        with the published numbers), or of all targets (as printed).
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
        If a set is empty, a threshold is a fallback, fewer than five pairs remain, or the displaced
        matcher gave way.

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
    sets = check_segments(test, "test"), check_segments(model, "model")
    orders = sets, sets[::-1]
    parts = [components(*order, rotate=rotate, within=within) for order in orders]
    distances = [part.distance(weight) for part in parts]
    threshold = threshold or partial(peak_threshold, sensitivity=sensitivity)
    thresholds = [_threshold(threshold, values) for values in distances]
    if thresholds[0].nearest.min(initial=np.inf) > APART_M and distances[0].size:
        raise ValueError(
            f"Invalid sets {thresholds[0].nearest[0]:.0f} m apart. "
            f"Must have segments within {APART_M:.0f} m of each other, in one coordinate system."
        )
    used = matcher if pairs is None else "given"
    if used == "displaced":
        pairs = match_displaced(*sets, radius=radius).pairs
        fragments = _matched("fragments", orders, distances, thresholds)
        if pairs.sum() < AGREED_SHARE * fragments[0].sum():
            used, pairs = "fragments", None
    if pairs is None:
        both = _matched(used, orders, distances, thresholds)
    else:
        pairs = np.asarray(pairs)
        if pairs.dtype != bool or pairs.shape != distances[0].shape:
            raise ValueError(
                f"Invalid pairs of type {pairs.dtype} and shape {pairs.shape}. "
                f"Must be Boolean of shape {distances[0].shape}."
            )
        both = pairs, pairs.T
        thresholds = [Threshold(np.nan, False, threshold.nearest) for threshold in thresholds]
    sides = [
        _directed(*values, norm)
        for values in zip(thresholds, both, parts, orders, (False, True), strict=True)
    ]
    result = LHD(weight, used, matcher if used != "given" else used, *sides, *sets)
    for doubt in doubts(result):
        warnings.warn(doubt, stacklevel=2)
    return result


def _threshold(threshold, distances):
    """What a threshold function makes of each row's least distance; a bare number is a delta."""
    nearest = distances.min(axis=1) if distances.shape[1] else np.empty(0)
    found = threshold(nearest)
    if isinstance(found, Threshold):
        return found
    return Threshold(float(found), False, np.sort(nearest))


def _matched(matcher, orders, distances, thresholds):
    """The pairs of both directions, each (source, target)."""
    return [
        correspond(values, threshold.delta, matcher=matcher, test=a, model=b)
        for values, threshold, (a, b) in zip(distances, thresholds, orders, strict=True)
    ]


def _directed(threshold, pairs, parts, order, turned, norm):
    """One direction; ``pairs`` and ``parts`` are (source, target), turned if the model is that."""
    cells = np.nonzero(pairs.T if turned else pairs)[:: -1 if turned else 1]
    source, target = (lengths(segments) for segments in order)
    length = target[cells[1]]
    return Directed(
        threshold=threshold,
        pairs=pairs.T if turned else pairs,
        parts=parts.select(cells),
        length=length,
        source=cells[0],
        coverage=float(source[np.unique(cells[0])].sum() / source.sum()) if len(source) else np.nan,
        total=float(length.sum() if norm == "pairs" else target.sum()),
    )


def doubts(result: LHD) -> list[str]:
    """Return sentences on what makes a distance doubtful."""
    said = [
        f"No {name} segments: nothing to measure."
        for name, segments in (("test", result.test), ("model", result.model))
        if not len(segments)
    ]
    if said:
        return said
    sides = {"test to model": result.test_model, "model to test": result.model_test}
    for name, side in sides.items():
        if side.threshold.fallback:
            said.append(
                f"No jump in the nearest distances from {name}: the largest, "
                f"{side.threshold.delta:.3g} m, is the threshold."
            )
        if side.n < FEW_PAIRS:
            said.append(f"Only {side.n} pairs from {name}: a value of chance.")
    if result.matcher != result.asked:
        said.append(f"Too few pairs agree on one displacement: matcher {result.matcher!r} is used.")
    return said


def compare(
    sets: Mapping[str, ArrayLike],
    *,
    reference: str | None = None,
    truth: Mapping[tuple[str, str], ArrayLike] | None = None,
    radius: float = 4.0,
    **choices,
) -> pd.DataFrame:
    """Compare several sets of segments with each other, both ways, as the paper's tables do.

    Parameters
    ----------
    sets : dict of str to array_like, shape (n, 2, 3)
        Segments by name, two sets or more, m.
    reference : str, optional
        The set that the others are measured against: it is always the model.
    truth : dict of (str, str) to array_like of bool, shape (p, q), optional
        True pairs by test and model set.
    radius : float
        Largest displacement that is sought, m.
    **choices
        Of :func:`lhd`.

    Returns
    -------
    DataFrame
        A row for each comparison and direction: ``kind`` (repeatability, absolute), ``comparison``,
        the columns of :meth:`LHD.to_frame`, the 95 % confidence interval of the larger distance,
        the displacement (m) with its standard deviations and ``displaced_pairs`` that agree on it,
        the errors of the pairs where the truth is known, and ``remarks``.

    Raises
    ------
    ValueError
        If there are fewer than two sets, one is empty, or two have no segments within the radius.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), Tables 1 and 2.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> scene = canyon(1)
    >>> sets = {name: scene.surveys[name].segments for name in ("TLS", "C1", "C3")}
    >>> table = compare(sets, reference="TLS", truth={("C1", "C3"): scene.pairs("C1", "C3")})
    >>> table["direction"].tolist()[:3]
    ['C1 to C3', 'C3 to C1', 'C1 to TLS']
    """
    sets = {name: check_segments(segments, name) for name, segments in sets.items()}
    empty = [name for name, segments in sets.items() if not len(segments)]
    if len(sets) < 2 or empty:
        raise ValueError(
            f"Invalid sets {', '.join(sets)}: {len(sets)}, empty {', '.join(empty) or 'none'}. "
            "Must be two or more with segments."
        )
    names = [name for name in sets if name != reference]
    pairs = [*combinations(names, 2)]
    if reference is not None:
        check_choice(reference, "reference", sets)
        pairs += [(name, reference) for name in names]
    tables = []
    for pair in pairs:
        test, model = (sets[name] for name in pair)
        nearest = distance_matrix(test, model, weight=0, within="overlap").min()
        if nearest > radius:
            raise ValueError(
                f"Invalid {' and '.join(pair)}: the nearest segments are {nearest:.1f} m apart. "
                f"Must be within {radius:g} m of each other, in one coordinate system."
            )
        table = _compared(pair, test, model, (truth or {}).get(pair), radius, choices)
        tables.append(table.assign(kind="absolute" if reference in pair else "repeatability"))
    table = pd.concat(tables, ignore_index=True)
    return table[["kind", "comparison", *table.columns.drop(["kind", "comparison"])]]


def _compared(names, test, model, truth, radius, choices):
    """The two rows of a comparison."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = lhd(test, model, radius=radius, **choices)
        moved = match_displaced(test, model, radius=radius).displacement
    table = found.to_frame().assign(comparison="-".join(names))
    table["direction"] = " to ".join(names), " to ".join(names[::-1])
    table["lhd_low_m"], table["lhd_high_m"] = found.interval()
    for k, axis in enumerate("xyz"):
        table[f"displacement_{axis}_m"] = moved.vector[k]
        table[f"sigma_{axis}_m"] = np.sqrt(moved.covariance[k, k])
    table["displaced_pairs"], said = moved.n, doubts(found)
    if truth is not None:
        sides = found.test_model, found.model_test
        scores = [pairing_scores(side.pairs, truth) for side in sides]
        table["false_negative"] = [one.fn for one in scores]
        table["false_positive"] = [one.fp for one in scores]
        table["rate_percent"] = [100 * one.detection_rate for one in scores]
        table["f1"] = [one.f1 for one in scores]
    if not np.isfinite(moved.vector).all():
        said.append("No displacement: too few lines, or lines of one direction, agree on one.")
    return table.assign(remarks=" ".join(said))
