"""Correspondence of two sets of segments: threshold, matchers, pairs of lines, scores."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from mmqa_lab._checks import check_choice, check_positive, check_together, real_array, refuse
from mmqa_lab._compiled import njit
from mmqa_lab._results import Shown
from mmqa_lab.lines.segments import directions, from_common_origin, lengths, midpoints
from mmqa_lab.rotations import across

__all__ = [
    "MATCHERS", "PairingScores", "Pairs", "Threshold", "apart", "check_pairs", "correspond",
    "levers", "paired", "pairing_scores", "peak_threshold",
]  # fmt: skip

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments")


@dataclass(frozen=True, eq=False)
class Threshold:
    """A threshold of the distance, its origin, and the sorted nearest distances.

    Parameters
    ----------
    delta : float
        Pairs with d <= delta correspond, m; NaN if there are no distances.
    fallback : bool
        True if no jump was found. delta is then the largest nearest distance, so that the nearest
        partner of every segment is accepted.
    nearest : array, shape (n,)
        The nearest distances in ascending order, m.
    """

    delta: float
    fallback: bool
    nearest: np.ndarray


def peak_threshold(
    nearest: ArrayLike,
    *,
    sensitivity: float = 0.5,
    order: int = 2,
    at: str = "below",
    sort_again: bool = False,
) -> Threshold:
    """Return the threshold at the first peak of the differences of the sorted nearest distances.

    The distances are sorted and differenced ``order`` times. The first maximum that stands out by
    ``sensitivity`` on both sides is the jump (beyond its end the curve counts as zero). The
    threshold is the last distance before the jump. Peaks at or below zero are no jumps.

    Parameters
    ----------
    nearest : array_like, shape (n,)
        The least distance of each segment to the other set, m.
    sensitivity : float
        Least prominence of a peak, m. The paper gives no value. On the simulated canyon 0.4 to
        0.8 m work equally well, 0.1 m and 2 m do not. It affects the result more than W.
    order : {2, 1}
        Second differences as in the paper, or first.
    at : {"below", "value"}
        The distance before the jump (our reading), or the value of the difference itself (the
        literal text of the paper).
    sort_again : bool
        Sort the first differences before the second differencing: another reading of "the new
        list".

    Returns
    -------
    Threshold

    Raises
    ------
    ValueError
        If a distance is negative or not finite, the sensitivity is not above zero, or ``order`` or
        ``at`` is unknown.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2.3 and figure 3.

    Examples
    --------
    >>> nearest = [0.31, 0.33, 0.36, 0.40, 0.41, 0.47, 0.52, 0.55, 3.2, 4.1, 7.7]
    >>> peak_threshold(nearest).delta
    0.55
    """
    from scipy.signal import find_peaks  # slow to import, and known pairs do not need it

    nearest = np.sort(np.atleast_1d(real_array(nearest, "nearest distances")).astype(np.float64))
    if nearest.ndim != 1 or not np.isfinite(nearest).all() or (nearest < 0).any():
        raise ValueError(f"Invalid nearest distances {nearest}. Must be a row of numbers >= 0 m.")
    sensitivity = check_positive(sensitivity, "sensitivity", unit="m")
    check_choice(order, "order", (1, 2))
    check_choice(at, "at", ("below", "value"))
    curve = np.diff(np.sort(np.diff(nearest))) if sort_again else np.diff(nearest, order)
    # low before the curve, zero after it, so that a peak at either end is found as well
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
        From test (rows) to model segments (columns), m.
    delta : float
        Threshold, m; NaN pairs nothing.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments"}
        ``all``: every cell (equation 6 of the paper). ``nearest``: the nearest model segment of
        each test segment. ``mutual``: nearest both ways. ``hungarian``: one-to-one, with the
        largest sum of ``delta - d``. ``fragments``: nearest first; a segment takes several partners
        only if they cover different stretches of it, like the pieces of a split edge.
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        The segments, m; only ``fragments`` uses them.

    Returns
    -------
    array of bool, shape (p, q)

    Raises
    ------
    ValueError
        If the matcher is unknown.

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
    (distances,) = check_together(distances=distances)
    refuse(distances.ndim != 2, "distances", f"shape {distances.shape}", "a table")
    near = distances <= delta
    if matcher == "fragments":
        test, model = from_common_origin(np.asarray(test), np.asarray(model))
        return apart(paired(test, model, *np.nonzero(near)), distances[near])
    if matcher == "all" or not near.any():
        return near
    if matcher == "hungarian":  # a cell at the threshold still counts
        cost = np.where(near, distances - delta * (1 + 1e-9) - 1e-12, 0.0)
        pairs = np.zeros_like(near)
        pairs[linear_sum_assignment(cost)] = True
        return pairs & near
    columns = np.arange(near.shape[1])
    nearest = near & (distances.argmin(axis=1, keepdims=True) == columns)
    if matcher == "nearest":
        return nearest
    return nearest & (distances.argmin(axis=0) == np.arange(len(near))[:, None])


def apart(lines: Pairs, costs: np.ndarray) -> np.ndarray:
    """Accept pairs in the order of finite costs if their stretches do not overlap; bool (p, q)."""
    order = np.argsort(costs, kind="stable")[: np.isfinite(costs).sum()]
    pairs = np.zeros(lines.shape, dtype=bool)
    _accept(order, lines.rows, lines.columns, *lines.stretches, pairs)
    return pairs


@njit(cache=True, nogil=True)
def _accept(order, rows, columns, on_test, on_model, pairs):
    """Accept pairs in order if each stretch overlaps each one already taken by at most 30 %."""
    before = np.empty((2, len(order)), np.int64)  # the pair taken before on the same line
    last_t, last_m = np.full(pairs.shape[0], -1), np.full(pairs.shape[1], -1)
    for k in range(len(order)):
        pair = order[k]
        row, column = rows[pair], columns[pair]
        free = _is_free(on_test, pair, last_t[row], order, before[0])
        if free and _is_free(on_model, pair, last_m[column], order, before[1]):
            pairs[row, column] = True
            before[0, k], before[1, k] = last_t[row], last_m[column]
            last_t[row] = last_m[column] = k


@njit(cache=True, nogil=True)
def _is_free(stretches, pair, last, order, before):
    """Whether a stretch overlaps each stretch taken on its line by at most 30 % of its length."""
    low, high = stretches[pair]
    if last >= 0 and high <= low:
        return False
    while last >= 0:
        other = stretches[order[last]]
        if min(high, other[1]) - max(low, other[0]) > 0.3 * (high - low):
            return False
        last = before[last]
    return True


@dataclass(frozen=True)
class PairingScores(Shown):
    """Counts over all p x q cells and their rates; NaN where a denominator is zero.

    Parameters
    ----------
    tp, fp, fn, tn : int
        Numbers of true and false positives and negatives.
    detection_rate, null_rate : float
        (TP + TN) / (p q), the paper's rate, as a share; and the same rate if nothing is paired.
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
    With some tens of pairs nearly all of the p q cells are true negatives. On the paper's tables
    the detection rate is at least 97.8 % even if nothing is paired. Use F1 instead.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3.1: detection rate.

    Examples
    --------
    >>> scores = pairing_scores([[True, True, False]], [[True, False, False]])
    >>> scores.tp, scores.fp, scores.fn, scores.tn, scores.precision, round(scores.null_rate, 3)
    (1, 1, 0, 1, 0.5, 0.667)
    """
    truth = check_pairs(truth, np.shape(truth))
    pairs = check_pairs(pairs, truth.shape)
    tp, fp, fn = (int(n.sum()) for n in (pairs & truth, pairs & ~truth, ~pairs & truth))
    tn = pairs.size - tp - fp - fn
    parts = np.array([tp + tn, tn + fp, tp, tp, 2 * tp], dtype=float)
    wholes = np.array([pairs.size, pairs.size, tp + fp, tp + fn, 2 * tp + fp + fn], dtype=float)
    rates = np.divide(parts, wholes, out=np.full(5, np.nan), where=wholes > 0)
    return PairingScores(tp, fp, fn, tn, *rates.tolist())


def check_pairs(pairs: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
    """Return Boolean pairs of a given shape (p, q) as an array."""
    pairs = np.asarray(pairs)
    if pairs.dtype != bool or pairs.shape != shape:
        found = f"of type {pairs.dtype} and shape {pairs.shape}"
        raise ValueError(f"Invalid pairs {found}. Must be Boolean of shape {shape}.")
    return pairs


# What :meth:`Pairs.again` fills in.
UNKNOWN: Any = None


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of lines: ``rows`` of the test set with ``columns`` of the model set.

    Of each pair: ``axis`` and ``way`` (n, 3) are the unit vectors of the model line and of the test
    line, which is turned round where it ran ``against`` the axis; ``half`` are both half lengths,
    ``between`` (n, 3) leads from the model line's midpoint to the test line's, ``middle`` (n, 3) is
    the model line's from the mean of them all. ``frame`` (n, 2, 3) has two unit vectors across the
    axis. What depends on the common stretch is filled in by :meth:`again`: ``along`` (n,) is how
    far the test line's midpoint is along the model line, m; ``stretches`` are two arrays (n, 2):
    the ends of the stretch on the test and on the model line, m from their midpoints, low > high
    across a gap; ``place`` (n, 3) is its middle on the model line; ``offset`` (n, 2) is test line
    minus model line there, along the frame; ``overlap`` (n,) is the common stretch as a share of
    the shorter line.
    """

    test: np.ndarray
    model: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    axis: np.ndarray
    way: np.ndarray
    against: np.ndarray
    half: tuple[np.ndarray, np.ndarray]
    between: np.ndarray
    middle: np.ndarray
    frame: np.ndarray
    along: np.ndarray = UNKNOWN
    stretches: tuple[np.ndarray, np.ndarray] = UNKNOWN
    place: np.ndarray = UNKNOWN
    offset: np.ndarray = UNKNOWN
    overlap: np.ndarray = UNKNOWN

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of lines of both sets."""
        return len(self.test), len(self.model)

    def again(self, moved: Any) -> Pairs:
        """The same pairs, with their common stretches after the test set is moved back, (n, 3)."""
        half_t, half_m = self.half
        along = ((self.between - moved) * self.axis).sum(axis=1)
        low, high = np.maximum(along - half_t, -half_m), np.minimum(along + half_t, half_m)
        on_model = np.stack([low, high], axis=1)
        on_test = on_model - along[:, None]
        on_test[self.against] = -on_test[self.against, ::-1]
        at = (low + high) / 2
        on_axis = at[:, None] * self.axis
        apart = self.between + (at - along)[:, None] * self.way - on_axis
        return replace(
            self,
            along=along,
            stretches=(on_test, on_model),
            place=self.middle + on_axis,
            offset=np.einsum("nkd,nd->nk", self.frame, apart),
            overlap=(high - low) / (2 * np.minimum(half_t, half_m)),
        )

    def design(self, centre: np.ndarray) -> np.ndarray:
        """Design matrix (n, 2, 4) of offsets for a vector and a rotation about a vertical axis."""
        turned = np.einsum("nkd,nd->nk", self.frame, levers(self.place - centre))
        return np.concatenate([self.frame, turned[..., None]], axis=2)


def paired(test: np.ndarray, model: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Pairs:
    """Pairs of lines of two sets (p, 2, 3) and (q, 2, 3), with the stretches that they share."""
    axis, way = directions(model)[columns], directions(test)[rows]
    against = (way * axis).sum(axis=1) < 0
    way[against] *= -1
    half = lengths(test)[rows] / 2, lengths(model)[columns] / 2
    middles = midpoints(model)
    between = midpoints(test)[rows] - middles[columns]
    middle = (middles - middles.sum(axis=0) / max(len(model), 1))[columns]
    pairs = rows, columns, axis, way, against, half, between, middle, across(axis)
    return Pairs(test, model, *pairs).again(0.0)


def levers(arm: np.ndarray) -> np.ndarray:
    """Return the movement of places (m, 3) per radian of rotation about a vertical axis."""
    return np.stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))], axis=1)
