"""3-D line segments: Hausdorff distance, correspondence, displacement of two sets.

A set is an array (n, 2, 3): the two ends of each segment, in metres. The distance follows Chen,
Leung & Gao 2003. One line is fixed, with direction e. The other line is rotated about its midpoint
until it is parallel. With midpoints c and lengths L of the test (t) and model (m) segments,

    d_theta = min(L_t, L_m) sin(angle between the lines)
    s       = (c_t - c_m) . e
    d_par   = max(0, |s| - |L_t - L_m| / 2)
    d_perp  = |(c_t - c_m) - s e|
    d       = sqrt(W d_theta^2 + d_par^2 + d_perp^2)

(Poreba & Goulette 2013, section 2.2 and equations 3-5). The sine comes from the cross product,
since the arccosine of a scalar product loses angles below 1e-8 rad. Coordinates are subtracted
before they are multiplied.

A pair of lines does not determine a displacement along the lines. Across them

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle x of their common stretch, and the rows of B
perpendicular to the model line. The displacement u(x) is a vector and a rotation about the
vertical. :mod:`mmqa_lab.lines.edges` extracts edges from clouds: the lines where planes meet.
"""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats
from scipy.optimize import linear_sum_assignment
from scipy.signal import find_peaks
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from mmqa_lab._checks import check_choice, check_number, check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.lines.edges import extract_edges as extract_edges
from mmqa_lab.rotations import across

MATCHERS = ("all", "nearest", "mutual", "hungarian", "fragments")
BLOCK_PAIRS = 500_000
"""Number of pairs computed at a time."""

KINDS = ["one-to-null", "one-to-one", "one-to-multiple", "multiple-to-one", "multiple-to-multiple"]
PARTS = ["displacement", "position", "direction", "ends", "false pairs", "all"]
"""Parts of a distance, and their sum."""


def check_segments(segments, name="segments"):
    """Return segments as float64 of shape (n, 2, 3), n >= 0, all finite and with a length.

    Raises ``TypeError`` if they are not real numbers, ``ValueError`` if a segment is invalid.

    Examples
    --------
    >>> check_segments([[[1, 2, 3], [1, 2, 3]]])
    Traceback (most recent call last):
    ValueError: Invalid segments: no length in row 0. Must have two different ends.
    """
    values = np.asarray(segments)
    if values.size and values.shape[1:] != (2, 3):
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, 2, 3).")
    ends = check_points(values.reshape(-1, 3), name=name, minimum=0).reshape(-1, 2, 3)
    # beyond 100 km float32 represents coordinates to 8 mm at best (IEEE 754: 24 bits)
    if values.dtype == np.float32 and np.abs(ends).max(initial=0) > 1e5:
        raise ValueError(f"Invalid {name}: float32 beyond 100 km. Must be float64.")
    points = (ends[:, 0] == ends[:, 1]).all(axis=1)
    if points.any():
        row = int(points.argmax())
        raise ValueError(f"Invalid {name}: no length in row {row}. Must have two different ends.")
    return ends


def lengths(segments: ArrayLike) -> np.ndarray:
    """Lengths of segments (n, 2, 3), shape (n,), m."""
    return np.linalg.norm(np.diff(segments, axis=1)[:, 0], axis=1)


def directions(segments: ArrayLike) -> np.ndarray:
    """Unit vectors of segments (n, 2, 3) from the first end to the second, shape (n, 3)."""
    return np.diff(segments, axis=1)[:, 0] / lengths(segments)[:, None]


def midpoints(segments: ArrayLike) -> np.ndarray:
    """Midpoints of segments (n, 2, 3), shape (n, 3), m."""
    segments = np.asarray(segments)
    return segments[:, 0] + (segments[:, 1] - segments[:, 0]) / 2


def _check_pairs(pairs, shape):
    """Return Boolean pairs of a given shape (p, q) as an array."""
    pairs = np.asarray(pairs)
    if pairs.dtype != bool or pairs.shape != shape:
        raise ValueError(
            f"Invalid pairs of type {pairs.dtype} and shape {pairs.shape}. "
            f"Must be Boolean of shape {shape}."
        )
    return pairs


def _from_common_origin(test, model):
    """Both sets, checked and shifted to a common origin, exact to 1e-9 m."""
    test, model = check_segments(test, "test"), check_segments(model, "model")
    origin = np.concatenate([model, test])[:1, 0]
    return (test, model) if not len(origin) else (test - origin, model - origin)


@dataclass(frozen=True, eq=False)
class Components:
    """The parts of the distance for p x q pairs.

    Parameters
    ----------
    angle, parallel, perpendicular : array, shape (p, q)
        d_theta, d_par and d_perp, m.
    shift : array, shape (p, q)
        Midpoint of the test segment along the fixed line, from the model's midpoint, m.

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


def components(
    test: ArrayLike, model: ArrayLike, *, rotate: str = "test", within: str = "containment"
) -> Components:
    """Angle, parallel and perpendicular distances of every test to every model segment.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    rotate : {"test", "shorter"}
        The line that is rotated about its midpoint: always the test segment (Poreba & Goulette
        2013, section 2.2) or the shorter segment of each pair (Gao & Leung 2002).
    within : {"containment", "overlap"}
        Condition for a parallel distance of zero: the range of one segment contains the other
        (figure 2 of the paper), or the two overlap at all.

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
    check_choice(rotate, "rotate", ("test", "shorter"))
    check_choice(within, "within", ("containment", "overlap"))
    test, model = (
        (midpoints(ends), directions(ends), lengths(ends))
        for ends in _from_common_origin(test, model)
    )
    rows = max(1, BLOCK_PAIRS // max(1, len(model[0])))
    blocks = [
        _parts([part[k : k + rows, None] for part in test], model, rotate, within)
        for k in range(0, max(1, len(test[0])), rows)
    ]
    return Components(*np.concatenate(blocks, axis=1))


def _parts(test, model, rotate, within):
    """d_theta, d_par, d_perp and s of a block of test segments (midpoint, direction, length)."""
    (middle_t, way_t, length_t), (middle_m, way_m, length_m) = test, model
    angle = np.minimum(length_t, length_m) * np.linalg.norm(np.cross(way_t, way_m), axis=-1)
    stays = ((rotate == "shorter") & (length_m < length_t))[..., None]
    axis = np.where(stays, way_t, way_m)
    apart = middle_t - middle_m
    s = (apart * axis).sum(axis=-1)
    parallel = np.maximum(0, np.abs(s) - np.abs(length_t - length_m) / 2)
    if within == "overlap":
        parallel[np.abs(s) < (length_t + length_m) / 2] = 0
    return np.stack([angle, parallel, np.linalg.norm(apart - s[..., None] * axis, axis=-1), s])


def distance_matrix(
    test: ArrayLike, model: ArrayLike, *, weight: float = 10.0, **choices
) -> np.ndarray:
    """Distances d(W) of every test to every model segment: the similarity matrix.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    weight : float
        W of equation 5, >= 0. A larger W gives angles more weight. (Gao & Leung 2002 *divide* the
        square of the angle distance by W, so that a larger W gives angles less weight.)
    **choices
        ``rotate`` and ``within`` as in :func:`components`.

    Returns
    -------
    array, shape (p, q)
        Metres.

    Raises
    ------
    ValueError
        As :func:`components`, or if the weight is negative.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), equation 5.

    Examples
    --------
    >>> d = distance_matrix([[[0, 0, 0], [4, 0, 0]]], [[[2, -5, 0], [2, 5, 0]]])
    >>> round(float(d[0, 0]), 6)
    12.649111
    """
    return components(test, model, **choices).distance(weight)


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
    """Threshold at the first peak of the differences of the sorted nearest distances.

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
    nearest = np.sort(np.asarray(nearest, dtype=np.float64))
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
    distances = np.asarray(distances, dtype=np.float64)
    near = distances <= delta
    if matcher == "fragments":
        lines = Pairs(*_from_common_origin(test, model), *np.nonzero(near))
        return _apart(lines, distances[near])
    if matcher == "all" or not near.any():
        return near
    if matcher == "hungarian":  # a cell at the threshold still counts
        cost = np.where(near, distances - delta * (1 + 1e-9) - 1e-12, 0.0)
        pairs = np.zeros_like(near)
        pairs[linear_sum_assignment(cost)] = True
        return pairs & near
    rows, columns = np.indices(near.shape, sparse=True)
    nearest = near & (distances.argmin(axis=1, keepdims=True) == columns)
    if matcher == "nearest":
        return nearest
    return nearest & (distances.argmin(axis=0) == rows)


def _apart(lines, costs):
    """Accept pairs in the order of finite costs if their stretches do not overlap; bool (p, q)."""
    pairs, taken = np.zeros(lines.shape, dtype=bool), defaultdict(list)
    for k in np.argsort(costs, kind="stable")[: np.isfinite(costs).sum()]:
        row, column = lines.rows[k], lines.columns[k]
        stretches = [part[k] for part in lines.stretches]
        others = taken["test", row], taken["model", column]
        if all(map(_free, stretches, others)):
            pairs[row, column] = True
            for stretch, other in zip(stretches, others, strict=True):
                other.append(stretch)
    return pairs


def _free(stretch, taken):
    """Whether a stretch overlaps each stretch already taken by at most 30 % of its length."""
    length = stretch[1] - stretch[0]
    shared = [min(stretch[1], other[1]) - max(stretch[0], other[0]) for other in taken]
    return not taken or (length > 0 and max(shared) <= 0.3 * length)


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
    truth = _check_pairs(truth, np.shape(truth))
    pairs = _check_pairs(pairs, truth.shape)
    tp, fp, fn = (int(n.sum()) for n in (pairs & truth, pairs & ~truth, ~pairs & truth))
    tn = pairs.size - tp - fp - fn
    parts = np.array([tp + tn, tn + fp, tp, tp, 2 * tp], dtype=float)
    wholes = np.array([pairs.size, pairs.size, tp + fp, tp + fn, 2 * tp + fp + fn], dtype=float)
    rates = np.divide(parts, wholes, out=np.full(5, np.nan), where=wholes > 0)
    return PairingScores(tp, fp, fn, tn, *rates.tolist())


TURN_RAD = np.radians(1.0)
"""Prior standard deviation of the rotation about the vertical."""

HYPOTHESES = 2000
"""Number of displacements tried."""

CLUTTER_PER_M2, LEFT_M = 0.1, 0.08
"""Density of unrelated parallel lines; standard deviation of drift that neighbours do not show."""


class Pairs:
    """Pairs of lines: ``rows`` of the test set with ``columns`` of the model set.

    ``place`` (n, 3) is the middle of the common stretch on the model line. ``frame`` (n, 2, 3) has
    two unit vectors across the line. ``offset`` (n, 2) is test line minus model line at that place,
    along the frame. ``overlap`` (n,) is the common stretch as a share of the shorter line.
    ``stretches`` are two arrays (n, 2): the ends of the common stretch on the test and on the model
    line, m from their midpoints, low > high across a gap. ``moved`` (3,) or (n, 3) is subtracted
    from the test set before the common stretch is found. Places are relative to the mean midpoint
    of the model lines.
    """

    def __init__(self, test, model, rows, columns, moved=0.0):
        self.rows, self.columns, self.shape = rows, columns, (len(test), len(model))
        self.test, self.model = test, model
        self.axis, way = directions(self.model)[columns], directions(self.test)[rows]
        against = (way * self.axis).sum(axis=1) < 0
        way[against] *= -1
        half_t, half_m = self.half = lengths(test)[rows] / 2, lengths(model)[columns] / 2
        between = midpoints(self.test)[rows] - midpoints(self.model)[columns]
        self.s = ((between - moved) * self.axis).sum(axis=1)
        low = np.maximum(self.s - half_t, -half_m)
        high = np.minimum(self.s + half_t, half_m)
        on_model = np.stack([low, high], axis=1)
        on_test = on_model - self.s[:, None]
        on_test[against] = -on_test[against, ::-1]
        self.stretches = on_test, on_model
        middle = (low + high) / 2
        self.frame, on_axis = across(self.axis), middle[:, None] * self.axis
        centre = midpoints(self.model).sum(axis=0) / max(len(model), 1)
        self.place = midpoints(self.model)[columns] + on_axis - centre
        apart = between + (middle - self.s)[:, None] * way - on_axis
        self.offset = np.einsum("nkd,nd->nk", self.frame, apart)
        self.overlap = (high - low) / (2 * np.minimum(*self.half))

    def again(self, moved):
        """The same pairs, with their common stretches after another displacement."""
        return Pairs(self.test, self.model, self.rows, self.columns, moved)

    def design(self, centre):
        """Design matrix (n, 2, 4) of offsets for a vector and a rotation about a vertical axis."""
        turned = np.einsum("nkd,nd->nk", self.frame, _levers(self.place - centre))
        return np.concatenate([self.frame, turned[..., None]], axis=2)


def _levers(arm):
    """Movement of places (m, 3) per radian of rotation about a vertical axis."""
    return np.stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))], axis=1)


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

    def at(self, places):
        """Displacement (m, 3) at places (m, 3) relative to the middle of the model lines, m."""
        return self.vector + np.radians(self.turn_deg) * _levers(places - self.centre)

    def to_frame(self) -> pd.DataFrame:
        """Return a row for x, y and z: value, standard deviation, 95 % interval (m), pairs."""
        frame = pd.DataFrame({"axis": [*"xyz"], "value_m": self.vector})
        frame["std_m"] = np.sqrt(np.diag(self.covariance))
        frame["low_m"] = frame["value_m"] - 1.96 * frame["std_m"]
        frame["high_m"] = frame["value_m"] + 1.96 * frame["std_m"]
        return frame.assign(n=self.n)


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
    lines = Pairs(*_from_common_origin(test, model), rows, columns)
    solution = np.zeros(4)
    normal = np.einsum("nkd,nke->de", lines.frame, lines.frame)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(rows):
        return unknown
    for _ in range(3):  # the common stretches depend on the displacement
        centre = lines.place.mean(axis=0)
        solution, covariance = _solved(lines, centre, solution)
        lines = lines.again(solution[:3] + solution[3] * _levers(lines.place - centre))
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
    test, model = _from_common_origin(test, model)
    radius = check_positive(radius, "radius", unit="m")
    lines = _candidates(test, model, radius)
    shifts, scores = _hypotheses(lines, radius)
    outcomes = [_refined(lines, start) for start in _starts(shifts, scores)]
    nothing = 0.0, np.zeros((len(test), len(model)), dtype=bool)
    pairs = max([nothing, *outcomes], key=lambda outcome: outcome[0])[1]
    # in 170 trials sets displaced by more than the radius paired a false share of 0.194 at most
    if pairs.any(axis=1).sum() < 0.2 * min(pairs.shape):
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
        pairs = _apart(lines, np.where(allowed, squares, np.inf))
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
    steady = mean[:3] + mean[3] * _levers(lines.place - centre)
    felt = np.exp(-cdist(lines.place, place) / 30)
    felt[members, np.arange(len(members))] = 0
    pulls = felt @ np.einsum("nkd,nk->nd", frame, lines.offset[members] - design @ mean)
    holds = np.tensordot(felt, frame.swapaxes(1, 2) @ frame, 1)
    holds += (noise / 0.25) ** 2 * np.eye(3)
    return steady + np.linalg.solve(holds, pulls[..., None])[..., 0]


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
    def n(self):
        """Number of pairs."""
        return len(self.share)

    def olhd(self, weight):
        """Mean distance d(W) of the pairs weighted by length, m; NaN without pairs (equation 7)."""
        return float(self.share @ self.parts.distance(weight)) if self.n else np.nan

    @property
    def perpendicular_only(self):
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
        sides = self.test_model, self.model_test
        return float(np.fmax(*(side.perpendicular_only for side in sides)))

    @property
    def _larger(self):
        """The direction whose distance is the value; a direction without pairs has none."""
        sides = self.test_model, self.model_test
        return max(sides, key=lambda side: np.nan_to_num(side.olhd(self.weight), nan=-1))

    def interval(self, *, seed: int = 0) -> tuple[float, float]:
        """95 % confidence interval of the value for fixed pairs and threshold: (low, high), m.

        By bootstrap of the source segments with their pairs, widened by Student's t. It covers the
        choice of the segments, not errors of the pairs. NaN with fewer than two sources.
        """
        side = self._larger
        sources, source = np.unique(side.source, return_inverse=True)
        n = len(sources)
        if n < 2:
            return np.nan, np.nan
        drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=1000)
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
        pairs = Pairs(*_from_common_origin(self.test, self.model), rows, columns)
        moved = fit_displacement(self.test, self.model, side.pairs & truth)
        across = np.einsum("nkd,nd->nk", pairs.frame, moved.at(pairs.place))
        parts = side.parts
        squares = parts.perpendicular**2, self.weight * parts.angle**2, parts.parallel**2
        sizes = np.vstack([np.linalg.norm(across, axis=1), np.sqrt(np.cumsum(squares, axis=0))])
        right = side.share * truth[rows, columns]
        steps = [*(sizes @ right / right.sum()), side.share @ sizes[-1] / side.share.sum()]
        return pd.DataFrame({"part": PARTS, "value_m": [steps[0], *np.diff(steps), steps[-1]]})

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


def hausdorff(test: ArrayLike, model: ArrayLike, **choices) -> float:
    """Plain Hausdorff distance of two segment sets: the largest of all nearest distances.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    **choices
        Passed to :func:`mmqa_lab.lines.distance_matrix`: ``weight``, ``rotate``, ``within``.

    Returns
    -------
    float
        The larger of both directions, m; NaN if a set is empty.

    Notes
    -----
    A single segment without a counterpart determines the value. For this reason :func:`lhd` takes
    the mean over pairs.

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
        (:func:`match_displaced`); if it finds too few pairs, ``fragments`` is used.
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
        was replaced by ``fragments``.

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
    one_way = partial(_one_way, threshold=threshold, **settings)
    asked = matcher
    if pairs is not None:
        pairs = _check_pairs(pairs, (len(test), len(model)))
    elif matcher == "displaced":
        pairs = match_displaced(test, model, radius=radius).pairs
        # too few pairs: less than three fifths of those found by fragments
        if pairs.sum() < 0.6 * one_way(test, model, matcher="fragments", pairs=None).n:
            pairs, matcher = None, "fragments"
    there = one_way(test, model, matcher=matcher, pairs=pairs)
    back = one_way(model, test, matcher=matcher, pairs=None if pairs is None else pairs.T)
    back = replace(back, pairs=back.pairs.T)
    remarks = _doubts(test, model, there, back)
    if matcher != asked:
        remarks.append(f"Too few pairs agree on a displacement. Matcher {matcher!r} is used.")
    for remark in remarks:
        warnings.warn(remark, stacklevel=2)
    return LHD(weight, matcher, there, back, test, model, remarks)


def _one_way(source, target, *, threshold, matcher, pairs, weight, rotate, within, norm):
    """Directed distance from source to target, with pairs (source, target)."""
    parts = components(source, target, rotate=rotate, within=within)
    distances = parts.distance(weight)
    nearest = distances.min(axis=1) if len(target) else np.empty(0)
    if len(nearest) and nearest.min() > 100:
        raise ValueError(
            f"Invalid sets {nearest.min():.0f} m apart. "
            "Must have segments within 100 m of each other, in one coordinate system."
        )
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
    empty = [name for name, ends in (("test", test), ("model", model)) if not len(ends)]
    if empty:
        return [f"No {' and no '.join(empty)} segments, so there is nothing to measure."]
    sentences = []
    for name, side in (("test to model", there), ("model to test", back)):
        if side.threshold.fallback:
            sentences.append(
                f"No jump in the nearest distances from {name}. "
                f"The threshold is the largest distance, {side.threshold.delta:.3g} m."
            )
        if side.n < 5:
            sentences.append(f"Only {side.n} pairs from {name}. The value may be due to chance.")
    return sentences


def compare(
    sets: Mapping[str, ArrayLike],
    *,
    reference: str | None = None,
    radius: float = 4.0,
    **choices,
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
    sets = {name: check_segments(segments, name) for name, segments in sets.items()}
    numbers = {name: len(segments) for name, segments in sets.items()}
    if len(sets) < 2 or not all(numbers.values()):
        raise ValueError(f"Invalid sets {numbers}. Must be two or more sets with segments.")
    check_choice(reference, "reference", (None, *sets))
    courses = [name for name in sets if name != reference]
    pairs = [*combinations(courses, 2)]
    pairs += [(name, reference) for name in courses if reference is not None]
    tables = []
    for names in pairs:
        table = _compared(names, *(sets[name] for name in names), radius, choices)
        table.insert(0, "kind", "absolute" if reference in names else "repeatability")
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def _compared(names, test, model, radius, choices):
    """The two rows of a comparison."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        found = lhd(test, model, radius=radius, **choices)
    moved = match_displaced(test, model, radius=radius)
    table, remarks = found.to_frame(), found.remarks
    table["direction"] = " to ".join(names), " to ".join(names[::-1])
    table.insert(0, "comparison", "-".join(names))
    table["lhd_low_m"], table["lhd_high_m"] = found.interval()
    for k, axis in enumerate("xyz"):
        table[f"displacement_{axis}_m"] = moved.vector[k]
        table[f"sigma_{axis}_m"] = np.sqrt(moved.covariance[k, k])
    table["displaced_pairs"] = moved.n
    if not np.isfinite(moved.vector).all():
        remarks = [*remarks, "No displacement: too few lines agree, or all of them are parallel."]
    return table.assign(remarks=" ".join(remarks))
