"""Sets of 3-D line segments, their distances, and which of two sets belong together.

A set is an array (n, 2, 3): the two ends of each segment, in metres. The distance is that of Chen,
Leung & Gao 2003. With e the direction of the line that stays, c the midpoints and L the lengths,
rotating the other line about its midpoint until it is parallel leaves

    d_theta = min(L_t, L_m) sin(angle between the lines)
    s       = (c_t - c_m) . e
    d_par   = max(0, |s| - |L_t - L_m| / 2)
    d_perp  = |(c_t - c_m) - s e|
    d       = sqrt(W d_theta^2 + d_par^2 + d_perp^2)

(Poreba & Goulette 2013, section 2.2 and equations 3-5). The sine comes from the cross product: the
arccosine of a scalar product is lost below 1e-8 rad. Differences are taken before products.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from scipy.signal import find_peaks

from mmqa_lab._checks import check_choice, check_number, check_positive
from mmqa_lab._results import Shown

ROTATE = ("test", "shorter")
RANGE = ("containment", "overlap")
MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments")
BLOCK_PAIRS = 500_000
"""Pairs that are computed at a time."""

FRAGMENT_OVERLAP = 0.3
"""Partners of one segment may share this part of their stretches on it."""

FLOAT32_LIMIT_M = 1e5
"""Beyond this, float32 represents coordinates to 8 mm at best (IEEE 754: 24 bits)."""


def check_segments(segments, name="segments"):
    """Return segments as float64 of shape (n, 2, 3), n >= 0, all finite and with a length.

    Examples
    --------
    >>> check_segments([[[1, 2, 3], [1, 2, 3]]])
    Traceback (most recent call last):
    ValueError: Invalid segments: no length in row 0. Must have two different ends.
    """
    values = np.asarray(segments)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"Invalid {name} of type {values.dtype}. Must be real numbers.")
    if values.size and values.shape[1:] != (2, 3):
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, 2, 3).")
    ends = values.astype(np.float64).reshape(-1, 2, 3)
    largest = np.abs(ends[np.isfinite(ends)]).max(initial=0)
    if values.dtype in (np.float16, np.float32) and largest > FLOAT32_LIMIT_M:
        raise ValueError(
            f"Invalid {name} of type {values.dtype} with a coordinate of {largest:.0f} m. "
            "Must be float64."
        )
    _refuse(~np.isfinite(ends).all(axis=(1, 2)), f"{name}: not finite", "be finite coordinates")
    empty = (ends[:, 0] == ends[:, 1]).all(axis=1)
    _refuse(empty, f"{name}: no length", "have two different ends")
    return ends


def _refuse(bad, what, wanted):
    """Raise with the first of the rows that are bad."""
    if bad.any():
        raise ValueError(f"Invalid {what} in row {int(bad.argmax())}. Must {wanted}.")


def lengths(segments: ArrayLike) -> np.ndarray:
    """Lengths of segments (n, 2, 3), shape (n,), m."""
    return np.linalg.norm(np.diff(segments, axis=1)[:, 0], axis=1)


def directions(segments: ArrayLike) -> np.ndarray:
    """Unit vectors from the first end to the second, shape (n, 3)."""
    return np.diff(segments, axis=1)[:, 0] / lengths(segments)[:, None]


def midpoints(segments: ArrayLike) -> np.ndarray:
    """Midpoints of segments (n, 2, 3), shape (n, 3), m."""
    segments = np.asarray(segments)
    return segments[:, 0] + (segments[:, 1] - segments[:, 0]) / 2


def from_common_origin(test, model):
    """Both sets, checked, less one end: what remains is exact to 1e-9 m."""
    test, model = check_segments(test, "test"), check_segments(model, "model")
    origin = np.concatenate([model, test])[:1, 0]
    return (test, model) if not len(origin) else (test - origin, model - origin)


@dataclass(frozen=True, eq=False)
class Components(Shown):
    """The parts of the distance for p x q pairs.

    Parameters
    ----------
    angle, parallel, perpendicular : array, shape (p, q)
        d_theta, d_par and d_perp, m.
    shift : array, shape (p, q)
        Midpoint of the test segment along the line that stays, from the model's midpoint, m.

    Examples
    --------
    >>> parts = components([[[0, 0, 0], [4, 0, 0]]], [[[0, 3, 0], [4, 3, 0]]])
    >>> float(parts.perpendicular[0, 0]), float(parts.distance(10)[0, 0])
    (3.0, 3.0)
    """

    angle: np.ndarray
    parallel: np.ndarray
    perpendicular: np.ndarray
    shift: np.ndarray

    def distance(self, weight: float) -> np.ndarray:
        """Return d for a weight W >= 0 of the angle, shape (p, q), m (equation 5)."""
        weight = check_number(weight, "weight", low=0)
        return np.sqrt(weight * self.angle**2 + self.parallel**2 + self.perpendicular**2)

    def select(self, cells):
        """Return the parts of some pairs."""
        return Components(*(part[cells] for part in vars(self).values()))

    def to_frame(self) -> pd.DataFrame:
        """Return one row per pair: its segments by number, and the parts in metres."""
        rows, columns = np.indices(self.angle.shape).reshape(2, -1)
        parts = {f"{name}_m": values.ravel() for name, values in vars(self).items()}
        return pd.DataFrame({"test_segment": rows, "model_segment": columns} | parts)


def components(
    test: ArrayLike, model: ArrayLike, *, rotate: str = "test", within: str = "containment"
) -> Components:
    """Angle, parallel and perpendicular distances of every test to every model segment.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    rotate : {"test", "shorter"}
        Which line is turned about its midpoint: always the one of the test set (Poreba & Goulette
        2013, section 2.2) or the shorter one of each pair (Gao & Leung 2002).
    within : {"containment", "overlap"}
        When the parallel distance vanishes: one segment lies within the range of the other (figure
        2 of the paper), or they overlap at all.

    Returns
    -------
    Components

    Raises
    ------
    ValueError
        If segments are not (n, 2, 3), not finite or without length, or a choice is unknown.

    Notes
    -----
    The distance is not a metric: nested collinear segments are at distance zero, the triangle
    inequality fails, and with ``rotate="test"`` it is not symmetric.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2.2, equations 3 and 4.

    Examples
    --------
    >>> parts = components([[[0, 0, 0], [4, 0, 0]]], [[[2, -5, 0], [2, 5, 0]]])
    >>> [float(part[0, 0]) for part in (parts.angle, parts.parallel, parts.perpendicular)]
    [4.0, 0.0, 0.0]
    """
    return Components(*_in_blocks(test, model, rotate, within, 4, _parts))


def distance_matrix(
    test: ArrayLike,
    model: ArrayLike,
    *,
    weight: float = 10.0,
    rotate: str = "test",
    within: str = "containment",
) -> np.ndarray:
    """Distances d(W) of every test to every model segment: the similarity matrix.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    weight : float
        W of equation 5, >= 0: a larger W punishes angles more. (In Gao & Leung 2002 the angle's
        square is *divided* by W: there a larger W punishes them less.)
    rotate, within
        As in :func:`components`.

    Returns
    -------
    array, shape (p, q)
        Metres. Nothing larger than this array is kept in memory.

    Examples
    --------
    >>> d = distance_matrix([[[0, 0, 0], [4, 0, 0]]], [[[2, -5, 0], [2, 5, 0]]])
    >>> round(float(d[0, 0]), 6)
    12.649111
    """
    weight = check_number(weight, "weight", low=0)

    def distances(*block):
        return [Components(*_parts(*block)).distance(weight)]

    return _in_blocks(test, model, rotate, within, 1, distances)[0]


def _in_blocks(test, model, rotate, within, n, function):
    """The n arrays (p, q) of a function, computed for some rows at a time."""
    check_choice(rotate, "rotate", ROTATE)
    check_choice(within, "within", RANGE)
    test, model = (
        (midpoints(ends), directions(ends), lengths(ends))
        for ends in from_common_origin(test, model)
    )
    p, q = len(test[0]), len(model[0])
    found, rows = np.empty((n, p, q)), max(1, BLOCK_PAIRS // max(1, q))
    for first in range(0, p, rows):
        block = [values[first : first + rows, None] for values in test]
        found[:, first : first + rows] = function(
            block, model, rotate == "shorter", within == "overlap"
        )
    return found


def _parts(test, model, turn_shorter, overlap):
    """d_theta, d_par, d_perp and s of a block of test segments (midpoint, direction, length)."""
    (middle_t, way_t, length_t), (middle_m, way_m, length_m) = test, model
    angle = np.minimum(length_t, length_m) * np.linalg.norm(np.cross(way_t, way_m), axis=-1)
    stays = (turn_shorter & (length_m < length_t))[..., None]
    axis = np.where(stays, way_t, way_m)
    apart = middle_t - middle_m
    s = (apart * axis).sum(axis=-1)
    parallel = np.maximum(0, np.abs(s) - np.abs(length_t - length_m) / 2)
    if overlap:
        parallel[np.abs(s) < (length_t + length_m) / 2] = 0
    return angle, parallel, np.linalg.norm(apart - s[..., None] * axis, axis=-1), s


@dataclass(frozen=True, eq=False)
class Threshold(Shown):
    """A threshold, how it was found, and the distances.

    Parameters
    ----------
    delta : float
        Pairs with d <= delta correspond, m; NaN when there is no distance.
    fallback : bool
        No jump was found: delta is the largest nearest distance and accepts every row's nearest.
    nearest : array, shape (n,)
        The nearest distances in ascending order, m.
    """

    delta: float
    fallback: bool
    nearest: np.ndarray

    _metres = ("delta",)


def peak_threshold(
    nearest: ArrayLike,
    *,
    sensitivity: float = 0.5,
    order: int = 2,
    at: str = "below",
    sort_again: bool = False,
) -> Threshold:
    """Threshold at the first peak of the differences of the sorted nearest distances.

    The distances are sorted, differenced ``order`` times, and searched for the first maximum
    that stands out by ``sensitivity`` on both sides (the curve returns to zero behind its end). The
    threshold is the last distance before the jump. Peaks at or below zero are no jumps.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.
    sensitivity : float
        How far a peak must stand out, m. The paper gives no value; 0.4-0.8 m work alike on the
        simulated canyon, 0.1 m or 2 m do not. It decides more than W does.
    order : {2, 1}
        Second differences as in the paper, or first.
    at : {"below", "value"}
        The distance before the jump (our reading), or the value of the difference itself, which is
        what the paper says literally.
    sort_again : bool
        Sort the first differences before they are differenced again, another reading of "the new
        list".

    Returns
    -------
    Threshold

    Raises
    ------
    ValueError
        If a distance is negative or not finite, the sensitivity is not above zero, or ``order`` or
        ``at`` is another.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2.3 and figure 3.

    Examples
    --------
    >>> nearest = [0.31, 0.33, 0.36, 0.40, 0.41, 0.47, 0.52, 0.55, 3.2, 4.1, 7.7]
    >>> peak_threshold(nearest).delta
    0.55
    """
    nearest = np.sort(np.asarray(nearest, dtype=np.float64))
    if nearest.ndim != 1 or not np.isfinite(nearest).all() or (nearest < 0).any():
        raise ValueError(f"Invalid nearest distances {nearest}. Must be a row of numbers >= 0 m.")
    sensitivity = check_positive(sensitivity, "sensitivity", unit="m")
    check_choice(order, "order", (1, 2))
    check_choice(at, "at", ("below", "value"))
    curve = np.diff(np.sort(np.diff(nearest))) if sort_again else np.diff(nearest, order)
    # low before the curve, zero behind it: a peak at either end is seen as well
    padded = np.concatenate([[curve.min(initial=0) - 2 * sensitivity], curve, [0.0]])
    peaks = find_peaks(padded, prominence=sensitivity)[0] - 1
    peaks = peaks[curve[peaks] > 0]
    if not len(peaks):
        return Threshold(float(nearest[-1]) if len(nearest) else np.nan, True, nearest)
    delta = curve[peaks[0]] if at == "value" else nearest[peaks[0] + order - 1]
    return Threshold(float(delta), False, nearest)


def correspond(
    distances: ArrayLike,
    delta: float,
    *,
    matcher: str = "all",
    test: ArrayLike | None = None,
    model: ArrayLike | None = None,
) -> np.ndarray:
    """Pair segments whose distance is at most ``delta``.

    Parameters
    ----------
    distances : array_like, shape (p, q)
        Of test (rows) to model segments (columns), m.
    delta : float
        Threshold, m; NaN pairs nothing.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments"}
        ``all``: every cell (equation 6 of the paper). ``nearest``: the nearest model of each test.
        ``mutual``: nearest both ways. ``hungarian``: one-to-one, with the largest sum of
        ``delta - d``. ``fragments``: nearest first; a segment takes several partners only where
        they cover different stretches of it, as the pieces of a split edge do.
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        The segments; ``fragments`` needs them.

    Returns
    -------
    array of bool, shape (p, q)

    Raises
    ------
    ValueError
        If the matcher is unknown, or ``fragments`` lacks the segments of the matrix.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), equation 6.

    Examples
    --------
    >>> d = [[0.1, 0.4], [0.3, 5.0]]
    >>> correspond(d, 0.5).sum(), correspond(d, 0.5, matcher="mutual").sum()
    (np.int64(3), np.int64(1))
    """
    check_choice(matcher, "matcher", MATCHERS)
    distances = np.asarray(distances, dtype=np.float64)
    near = distances <= delta
    if matcher == "fragments":
        if test is None or model is None or near.shape != (len(test), len(model)):
            raise ValueError(
                f"Invalid segments for {near.shape} distances and matcher 'fragments'. "
                "Must be test and model of these numbers."
            )
        rows, columns = np.nonzero(near)
        stretches = common_stretches(*from_common_origin(test, model), rows, columns)
        return apart(near.shape, rows, columns, stretches, distances[near])
    if matcher == "all" or not near.any():
        return near
    if matcher == "hungarian":  # a cell at the very threshold still counts
        cost = np.where(near, distances - delta * (1 + 1e-9) - 1e-12, 0.0)
        pairs = np.zeros_like(near)
        pairs[linear_sum_assignment(cost)] = True
        return pairs & near
    nearest = near & _is_argmin(distances, 1)
    return nearest if matcher == "nearest" else nearest & _is_argmin(distances, 0)


def _is_argmin(distances, axis):
    """Cells that are the first least of their row (axis 1) or column (axis 0)."""
    cells = np.zeros(distances.shape, dtype=bool)
    np.put_along_axis(cells, np.argmin(distances, axis=axis, keepdims=True), True, axis=axis)
    return cells


def common_stretches(test, model, rows, columns, moved=0.0):
    """Which stretch each of n pairs covers of its test and its model segment: (n, 2) each, m.

    They count from the midpoints along the segments; low > high across a gap. ``moved`` (3,) or
    (n, 3) is what the test set is displaced by.
    """
    axis, way = directions(model)[columns], directions(test)[rows]
    half_t, half_m = lengths(test)[rows] / 2, lengths(model)[columns] / 2
    s = ((midpoints(test)[rows] - midpoints(model)[columns] - moved) * axis).sum(axis=1)
    on_model = np.stack([np.maximum(s - half_t, -half_m), np.minimum(s + half_t, half_m)], axis=1)
    on_test = on_model - s[:, None]
    against = (way * axis).sum(axis=1) < 0
    on_test[against] = -on_test[against, ::-1]
    return on_test, on_model


def apart(shape, rows, columns, stretches, costs):
    """Accept pairs in the order of their costs while their stretches stay apart; bool (p, q)."""
    pairs, taken = np.zeros(shape, dtype=bool), defaultdict(list)
    places = list(zip(rows, columns, *stretches, strict=True))
    for k in np.argsort(costs, kind="stable"):
        row, column, on_test, on_model = places[k]
        others = taken["test", row], taken["model", column]
        if _free(on_test, others[0]) and _free(on_model, others[1]):
            pairs[row, column] = True
            others[0].append(on_test)
            others[1].append(on_model)
    return pairs


def _free(stretch, taken):
    """Whether a stretch leaves those already taken alone, but for a part of it."""
    if not taken:
        return True
    length = stretch[1] - stretch[0]
    shared = max(min(stretch[1], other[1]) - max(stretch[0], other[0]) for other in taken)
    return length > 0 and shared <= FRAGMENT_OVERLAP * length


@dataclass(frozen=True)
class PairingScores(Shown):
    """Counts over all p x q cells and the rates that follow from them; NaN where nothing is there.

    Parameters
    ----------
    tp, fp, fn, tn : int
        True and false, positives and negatives.
    detection_rate, null_rate : float
        (TP + TN) / (p q), the paper's rate, as a share, and that of pairing nothing at all.
    precision, recall, f1 : float
        Share of the proposed pairs that are true, share of the true pairs that are proposed, and
        the harmonic mean of both.
    """

    tp: int
    fp: int
    fn: int
    tn: int
    detection_rate: float
    null_rate: float
    precision: float
    recall: float
    f1: float


def pairing_scores(pairs: ArrayLike, truth: ArrayLike) -> PairingScores:
    """Score proposed pairs against true ones, cell by cell.

    Parameters
    ----------
    pairs, truth : array_like of bool, shape (p, q)
        Test segments in rows, model segments in columns.

    Returns
    -------
    PairingScores

    Raises
    ------
    ValueError
        If they are not Boolean or their shapes differ.

    Notes
    -----
    With p q cells and some tens of pairs nearly all cells are true negatives: pairing nothing has a
    detection rate of 97.8 to 99.1 % on the paper's tables. Look at F1.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3.1: detection rate.

    Examples
    --------
    >>> scores = pairing_scores([[True, True, False]], [[True, False, False]])
    >>> scores.tp, scores.fp, scores.fn, scores.tn, scores.precision, round(scores.null_rate, 3)
    (1, 1, 0, 1, 0.5, 0.667)
    """
    pairs, truth = np.asarray(pairs), np.asarray(truth)
    if pairs.dtype != bool or truth.dtype != bool or pairs.shape != truth.shape:
        raise ValueError(
            f"Invalid pairs of type {pairs.dtype} and shape {pairs.shape}. "
            f"Must be Boolean and of the truth's shape, {truth.shape}."
        )
    tp, fp, fn = (int(n.sum()) for n in (pairs & truth, pairs & ~truth, ~pairs & truth))
    tn = pairs.size - tp - fp - fn
    rates = (tp + tn, pairs.size), (tn + fp, pairs.size), (tp, tp + fp), (tp, tp + fn)
    rates = [
        part / whole if whole else np.nan for part, whole in (*rates, (2 * tp, 2 * tp + fp + fn))
    ]
    return PairingScores(tp, fp, fn, tn, *rates)
