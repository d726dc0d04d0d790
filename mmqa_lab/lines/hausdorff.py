"""The line-segment Hausdorff distance of two segment sets and what it is made of."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab.lines.compensation import match_displaced
from mmqa_lab.lines.correspondence import MATCHERS, correspond
from mmqa_lab.lines.displacement import Displacement, fit_displacement
from mmqa_lab.lines.distance import components, distance_matrix
from mmqa_lab.lines.geometry import Segments, check_segments
from mmqa_lab.lines.thresholds import Threshold, peak_threshold

NORMS = ("pairs", "matched", "all")
APART_M = 100.0
"""Sets whose nearest segments are farther apart than this are in different frames."""

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
    angle, parallel, perpendicular : array, shape (k,)
        The parts of the k pairs' distances in the order of ``np.nonzero(pairs)``, m.
    length : array, shape (k,)
        Length of each pair's target, its weight in the mean, m.
    source : array of int, shape (k,)
        Source segment of each pair.
    coverage : float
        Share of the source set's length that is paired.
    total : float
        What the weighted sum of :meth:`olhd` is divided by, m.

    Examples
    --------
    >>> model = np.array([[[x, 0, 0], [x, 0, 6]] for x in range(0, 60, 10)], dtype=float)
    >>> test = model + [0, 0.1, 0]
    >>> test[-1, :, 1] += 40  # of this one there is no partner
    >>> forward = lhd(test, model, matcher="mutual").test_model
    >>> forward.n, round(float(forward.coverage), 3)  # 30 m of 36 m
    (5, 0.833)
    """

    threshold: Threshold
    pairs: np.ndarray
    angle: np.ndarray
    parallel: np.ndarray
    perpendicular: np.ndarray
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
        squares = weight * self.angle**2 + self.parallel**2 + self.perpendicular**2
        return self._mean(np.sqrt(squares))

    @property
    def perpendicular_only(self):
        """Mean perpendicular distance of the pairs weighted by length, m; NaN without pairs."""
        return self._mean(self.perpendicular)

    def shares(self, weight):
        """Shares of angle, parallel and perpendicular part in the sum of squared distances."""
        squares = [weight * self.angle**2, self.parallel**2, self.perpendicular**2]
        sums = np.array([float(self.length @ square) for square in squares])
        return sums / sums.sum() if sums.sum() else np.full(3, np.nan)

    def resampled(self, weight, repeats, rng):
        """Bootstrap values of :meth:`olhd`, source segments drawn with their pairs, (repeats,)."""
        squares = weight * self.angle**2 + self.parallel**2 + self.perpendicular**2
        _, cluster = np.unique(self.source, return_inverse=True)
        sums = np.bincount(cluster, self.length * np.sqrt(squares))
        lengths = np.bincount(cluster, self.length)
        draws = rng.multinomial(len(sums), np.full(len(sums), 1 / len(sums)), size=repeats)
        return (draws @ sums) / (draws @ lengths) * (lengths.sum() / self.total)

    def _mean(self, values):
        return float(self.length @ values / self.total) if self.n else np.nan


@dataclass(frozen=True, eq=False)
class LHD:
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
        If a weight is negative, or level or repeats of :meth:`interval` are out of range.

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
    def value(self):
        """The larger of both directed distances, m (equation 2); NaN without pairs."""
        return self.at_weight(self.weight)

    def at_weight(self, weight):
        """The distance of the same pairs under another W, m; W = 0 leaves the angle out."""
        return _larger(self.test_model.olhd(weight), self.model_test.olhd(weight))

    @property
    def perpendicular_only(self):
        """The larger directed mean of the perpendicular distances alone, m."""
        return _larger(self.test_model.perpendicular_only, self.model_test.perpendicular_only)

    def interval(self, *, level=0.95, repeats=1000, seed=0):
        """Bootstrap interval of the value for fixed pairs and threshold: (low, high), m.

        Says how far the value depends on the segments that happened to be found, not whether the
        pairs are right. NaN below two sources in each direction.
        """
        level = check_number(level, "level", low=0, high=1)
        repeats, seed = check_count(repeats, "repeats"), check_count(seed, "seed", low=0)
        rng = np.random.default_rng(seed)
        directions = [self.test_model, self.model_test]
        if any(len(np.unique(direction.source)) < 2 for direction in directions):
            return np.nan, np.nan
        values = np.max([d.resampled(self.weight, repeats, rng) for d in directions], axis=0)
        low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)

    def kinds(self):
        """Return how many segments have which correspondence (section 2.3): Series of int.

        ``one-to-null``: without a partner, in either set. ``one-to-one``; ``one-to-multiple``: a
        test segment with several partners of its own; ``multiple-to-one``: a model segment with
        several; ``multiple-to-multiple``: what remains, as groups that hang together.
        """
        pairs = self.test_model.pairs
        p, q = pairs.shape
        rows, columns = np.nonzero(pairs)
        graph = coo_array((np.ones(len(rows)), (rows, p + columns)), shape=(p + q, p + q))
        _, group = connected_components(graph, directed=False)
        tests, models = np.bincount(group[:p]), np.bincount(group[p:])
        size = max(len(tests), len(models))
        tests, models = (np.pad(n, (0, size - len(n))) for n in (tests, models))
        counts = {
            "one-to-null": (tests + models == 1).sum(),
            "one-to-one": ((tests == 1) & (models == 1)).sum(),
            "one-to-multiple": ((tests == 1) & (models > 1)).sum(),
            "multiple-to-one": ((tests > 1) & (models == 1)).sum(),
            "multiple-to-multiple": ((tests > 1) & (models > 1)).sum(),
        }
        return pd.Series(counts, name="groups")

    def to_frame(self):
        """Return one row per direction: segments, pairs, threshold, distances, coverage."""
        rows = []
        for name, part in (("test to model", self.test_model), ("model to test", self.model_test)):
            rows.append(
                {
                    "direction": name,
                    "pairs": part.n,
                    "threshold_m": part.threshold.delta,
                    "olhd_m": part.olhd(self.weight),
                    "olhd_w0_m": part.olhd(0),
                    "perpendicular_m": part.perpendicular_only,
                    "coverage": part.coverage,
                }
            )
        return pd.DataFrame(rows)

    def _repr_html_(self):
        return self.to_frame()._repr_html_()

    def plot(self, *, ax=None):
        """Draw both sets from above and a line between the midpoints of each pair."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        for ends in self.model.ends:
            ax.plot(ends[:, 0], ends[:, 1], color="0.75", lw=3, solid_capstyle="round")
        for ends in self.test.ends:
            ax.plot(ends[:, 0], ends[:, 1], color="black", lw=1)
        for row, column in np.argwhere(self.test_model.pairs):
            link = self.test.midpoints[row], self.model.midpoints[column]
            ax.plot(*np.array(link)[:, :2].T, color="tab:red", lw=0.7)
        ax.set(xlabel="easting (m)", ylabel="northing (m)", aspect="equal")
        return ax

    def to_dict(self):
        """Return what ``mmqa lhd --json`` prints; NaN becomes None."""
        forward, backward = self.test_model, self.model_test
        values = {
            "weight": self.weight,
            "sensitivity_m": self.sensitivity,
            "matcher": self.asked,
            "matcher_used": self.matcher,
            "p": forward.pairs.shape[0],
            "q": forward.pairs.shape[1],
            "lhd_m": self.value,
            "olhd_test_model_m": forward.olhd(self.weight),
            "olhd_model_test_m": backward.olhd(self.weight),
            "threshold_test_model_m": forward.threshold.delta,
            "threshold_model_test_m": backward.threshold.delta,
            "threshold_fallback": [forward.threshold.fallback, backward.threshold.fallback],
            "pairs_test_model": np.argwhere(forward.pairs).tolist(),
            "pairs_model_test": np.argwhere(backward.pairs).tolist(),
            "lhd_w0_m": self.at_weight(0),
            "perpendicular_only_m": self.perpendicular_only,
            "displacement_m": self.displacement.vector.tolist(),
            "displacement_covariance_m2": self.displacement.covariance.tolist(),
            "coverage_test": forward.coverage,
            "coverage_model": backward.coverage,
        }
        return {key: _none_for_nan(value) for key, value in values.items()}


def hausdorff(
    test: Segments,
    model: Segments,
    *,
    weight: float = 10.0,
    rotate: str = "test",
    within: str = "containment",
) -> float:
    """Plain Hausdorff distance of two segment sets: the largest of all nearest distances.

    Parameters
    ----------
    test, model : Segments or array_like
        p and q segments, m.
    weight, rotate, within
        As in :func:`mmqa_lab.lines.distance_matrix`.

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
    choices = {"weight": weight, "rotate": rotate, "within": within}
    there, back = distance_matrix(test, model, **choices), distance_matrix(model, test, **choices)
    if not there.size:
        return np.nan
    return float(max(there.min(axis=1).max(), back.min(axis=1).max()))


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
        As in :func:`olhd`.
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
    >>> from mmqa_lab.lines.geometry import Segments
    >>> both = [[[0, 0, 0], [9, 0, 0]], [[0, 0, 0], [0, 0, 6]], [[9, 0, 0], [9, 0, 7]],
    ...         [[9, 0, 7], [9, 8, 7]], [[0, 0, 6], [0, 8, 6]]]
    >>> model = Segments([*both, [[0, 20, 0], [0, 20, 6]]])
    >>> test = Segments([*both, [[9, 40, 0], [9, 40, 7]]]).moved([0.3, 0, 0.1])
    >>> result = lhd(test, model)
    >>> round(result.value, 3), result.test_model.n, result.displacement.vector.round(2).tolist()
    (0.316, 5, [0.3, 0.0, 0.1])
    """
    weight = check_number(weight, "weight", low=0)
    sensitivity = check_positive(sensitivity, "sensitivity", unit="m")
    check_choice(matcher, "matcher", (*MATCHERS, "displaced"))
    check_choice(norm, "norm", NORMS)
    threshold = threshold or partial(peak_threshold, sensitivity=sensitivity)
    test, model = check_segments(test, name="test"), check_segments(model, name="model")
    forward = components(test, model, rotate=rotate, within=within)
    backward = components(model, test, rotate=rotate, within=within)
    thresholds = [
        _as_threshold(threshold, _nearest(parts.distance(weight))) for parts in (forward, backward)
    ]
    _refuse_apart(thresholds[0], test, model)
    if pairs is None:
        used, both = _pairs(
            matcher, (test, model), (forward, backward), thresholds, weight=weight, radius=radius
        )
    else:
        used, both = "given", _given(pairs, forward.angle.shape)
    if used in ("displaced", "given"):
        thresholds = [Threshold(np.nan, False, threshold.nearest) for threshold in thresholds]
    result = LHD(
        weight=weight,
        sensitivity=sensitivity,
        matcher=used,
        test_model=_directed(thresholds[0], both[0], forward, test, model, norm=norm),
        model_test=_directed(
            thresholds[1], both[1].T, backward, model, test, norm=norm, turned=True
        ),
        test=test,
        model=model,
        asked=matcher if pairs is None else used,
    )
    _warn(result, test, model)
    return result


def olhd(distances, pairs, lengths, *, norm="pairs"):
    """Oriented distance: mean of the pairs' distances weighted by their targets' lengths.

    Parameters
    ----------
    distances : array_like, shape (p, q)
        From source (rows) to target segments (columns), m.
    pairs : array_like of bool, shape (p, q)
    lengths : array_like, shape (q,) or (p, q)
        Weights: the lengths of the targets, m.
    norm : {"pairs", "matched", "all"}
        What the weighted sum is divided by: the weights of all pairs (a mean; agrees with the
        published numbers), of each matched target once, or of all targets (as printed).

    Returns
    -------
    float
        Metres; NaN without pairs.

    Raises
    ------
    ValueError
        If the norm is another.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), equation 7. Its denominator is printed as a sum over the
    model set; the text calls the result a weighted average.

    Examples
    --------
    >>> olhd([[0.2, 9.0], [0.4, 9.0]], [[True, False], [True, False]], [5.0, 15.0])
    0.3
    """
    check_choice(norm, "norm", NORMS)
    distances, pairs = np.asarray(distances, dtype=np.float64), np.asarray(pairs, dtype=bool)
    weights = np.broadcast_to(np.asarray(lengths, dtype=np.float64), distances.shape)
    if not pairs.any():
        return np.nan
    total = {
        "pairs": weights[pairs].sum(),
        "matched": weights.max(axis=0, where=pairs, initial=0).sum(),
        "all": weights.mean(axis=0).sum(),
    }
    return float((weights * distances)[pairs].sum() / total[norm])


def _pairs(matcher, sets, parts, thresholds, *, weight, radius):
    """The matcher used and the pairs of both directions, each (source, target)."""
    if matcher == "displaced":
        match = match_displaced(*sets, radius=radius)
        both = [match.pairs, match.pairs.T]
        others = _pairs("fragments", sets, parts, thresholds, weight=weight, radius=radius)[1]
        few = match.pairs.sum() < AGREED_SHARE * others[0].sum()
        if few and not match.evidence > WEAK_EVIDENCE:
            return "fragments", others
        return matcher, both
    orders = (sets, sets[::-1])
    both = [
        correspond(part.distance(weight), threshold.delta, matcher=matcher, test=a, model=b)
        for part, threshold, (a, b) in zip(parts, thresholds, orders, strict=True)
    ]
    return matcher, both


def _given(pairs, shape):
    """Known pairs of both directions, each (source, target)."""
    pairs = np.asarray(pairs)
    if pairs.dtype != bool or pairs.shape != shape:
        raise ValueError(
            f"Invalid pairs of type {pairs.dtype} and shape {pairs.shape}. "
            f"Must be Boolean of shape {shape}."
        )
    return pairs, pairs.T


def _as_threshold(threshold, nearest):
    """What a threshold function returns, a bare number made one."""
    found = threshold(nearest)
    return (
        found if isinstance(found, Threshold) else Threshold(float(found), False, np.sort(nearest))
    )


def _directed(threshold, pairs, parts, source, target, *, norm, turned=False):
    """One direction; ``pairs`` are (test, model), turned where the model is the source."""
    rows, columns = np.nonzero(pairs)
    here = (columns, rows) if turned else (rows, columns)
    matched = np.isin(np.arange(len(source)), here[0])
    whole = source.lengths.sum()
    totals = {
        "pairs": target.lengths[here[1]].sum(),
        "matched": target.lengths[np.unique(here[1])].sum(),
        "all": target.lengths.sum(),
    }
    return Directed(
        threshold=threshold,
        pairs=pairs,
        angle=parts.angle[here],
        parallel=parts.parallel[here],
        perpendicular=parts.perpendicular[here],
        length=target.lengths[here[1]],
        source=here[0],
        coverage=float(source.lengths[matched].sum() / whole) if whole else np.nan,
        total=float(totals[norm]),
    )


def _nearest(distances):
    """Least distance of each row; none where there are no columns."""
    return distances.min(axis=1) if distances.shape[1] else np.empty(0)


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


def _larger(a, b):
    """The larger of two numbers, the other where one is NaN."""
    return float(np.fmax(a, b))


def _none_for_nan(value):
    """None wherever a number is NaN, in lists too."""
    if isinstance(value, list):
        return [_none_for_nan(item) for item in value]
    return None if isinstance(value, float) and np.isnan(value) else value
