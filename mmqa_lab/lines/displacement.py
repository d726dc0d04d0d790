"""Displacement of one set of segments from another, with and without known pairs.

A pair of lines does not determine a displacement along the lines. Across them

    B (t - m) = B u(x) + noise,

with t and m the points of both lines at the middle x of their common stretch, and the rows of B
perpendicular to the model line. The displacement u(x) is a vector and a rotation about the
vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from operator import itemgetter

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import ArrayLike
from scipy import stats

from mmqa_lab._checks import check_number
from mmqa_lab._results import Shown, about
from mmqa_lab.lines.pairing import apart, levers, paired
from mmqa_lab.lines.segments import components, from_common_origin, lengths, midpoints
from mmqa_lab.rotations import across

__all__ = ["Displacement", "fit_displacement", "match_displaced"]

# Prior standard deviation of the rotation about the vertical.
TURN_RAD = np.radians(1.0)

# Steps of the displacements tried, first and about the path found, and how far from it.
STEP_M, FINE_M, FINE_RADIUS_M = 0.3, 0.15, 1.5

# Distance of stations, their number, and the distance in steps within which lines agree.
STATION_M, MOST_STATIONS, AGREE = 5.0, 60, 1.7

# Largest radius, and number of votes at all stations that is kept in memory.
MOST_RADIUS_M, MOST_VOTES = 20.0, 3e7

# Largest change of the displacement with the distance from the middle (a turn of 3.4 degrees), its
# usual change from station to station, m/m, and its largest change in all, m.
CHANGE, USUAL_CHANGE, CHANGED_M = 0.06, 0.05, 6.0

# Turns tried between the lines on both sides of the path.
TURNS = np.radians([-3, -1.5, 0, 1.5, 3])

# Log likelihood ratio of one vote.
VOTE = 2.5

# Deviations from the path with which the pairs are sought first.
FIRST_NOISE_M = 0.3

# Density of unrelated parallel lines; standard deviation of drift that neighbours do not show.
CLUTTER_PER_M2, LEFT_M = 0.1, 0.08

# Least share of the ends of true pairs that agree and their mean gap; density of other gaps.
ENDS_AGREE, END_M, CLUTTER_ENDS_PER_M = 0.3, 0.15, 0.4

# Number of paths compared, and their least distance at each station.
PATHS, ELSEWHERE_M = 3, 0.8

# Least evidence per pair; the share of the smaller set below which there is a remark.
LEAST_EVIDENCE, FEW_SHARE = 2.2, 0.4

# Least evidence per pair where few lines are paired, and how much less with their share: without
# the ends, or with them.
FEW_EVIDENCE = (7.2, 10.0), (10.0, 16.0)

# Largest evidence of a path with other pairs, as a share of the best one's: with few lines, above
# this share by the share of the lines that are paired. These and the evidence with few lines were
# chosen on 300 simulated rows of windows with few common lines, so no score there.
RIVAL, MOST_RIVAL = 0.45, 0.9


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
    remark : str
        Of :func:`match_displaced`: why there are no pairs, or that few lines are paired.
    """

    vector: np.ndarray
    covariance: np.ndarray
    pairs: np.ndarray
    turn_deg: float
    centre: np.ndarray
    remark: str = ""

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

        Where there is a remark it is the last column.
        """
        frame = pd.DataFrame({"axis": [*"xyz"], "value_m": self.vector})
        frame["std_m"] = np.sqrt(np.diag(self.covariance))
        ends = self.intervals()
        frame = frame.assign(low_m=ends["low"], high_m=ends["high"], n=self.n)
        return frame.assign(remark=self.remark) if self.remark else frame


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
    lines = paired(test, model, rows, columns)
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
    as much. Settings were chosen on simulated canyons and rows
    of windows whose seeds differ from the reported seeds. The idea comes from line-based
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
        pairs[np.ix_(rows, columns)], remark = _matched(test[rows], model[columns], radius)
    return replace(fit_displacement(test, model, pairs), remark=remark)


def _distinct(segments):
    """Rows of the segments, the first of equal ones, in an order that only segments decide."""
    sizes = segments @ np.sqrt([1, 2, 3])
    turned = np.where((sizes[:, 0] > sizes[:, 1])[:, None, None], segments[:, ::-1], segments)
    return np.unique(turned, axis=0, return_index=True)[1]


def _matched(test, model, radius):
    """Pairs of the displacement that unites most lines, none if it does not stand out; a remark."""
    lines = _candidates(test, model, radius)
    none = np.zeros(lines.shape, dtype=bool)
    if len(lines.rows) < 3:
        return none, f"Fewer than three lines have a parallel one within {radius:g} m."
    search = _Search(lines, radius)
    paths = islice(search.paths(), PATHS)
    starts = [_retraced(lines, search, path, turn) for path in paths for turn in TURNS]
    outcomes = [_refined(lines, start) for start in starts]
    evidence, found, ends = max(outcomes, key=itemgetter(0))
    number, fewer = found.sum(), min(lines.shape)
    rivals = [other for other, them, _ in outcomes if (them & found).sum() < number / 2]
    share = found.any(axis=1).sum() / fewer
    least = [number * max(LEAST_EVIDENCE, few - less * share) for few, less in FEW_EVIDENCE]
    if evidence - ends <= least[0] and evidence <= least[1]:
        return none, f"The displacement that unites most lines, {number} of {fewer}, may be chance."
    if max(rivals, default=0) > evidence * min(RIVAL + share, MOST_RIVAL):
        return none, "Two displacements with other pairs explain the lines nearly as well."
    few = f"Only {number} of {fewer} lines are paired: look at them." if share < FEW_SHARE else ""
    return found, few


def _candidates(test, model, radius):
    """Pairs of nearly parallel lines within the radius, or farther off the middle within reach."""
    parts, size = components(test, model), (lengths(test)[:, None], lengths(model))
    parallel = parts.angle < np.sin(np.radians(8)) * np.minimum(*size)
    gap = np.abs(parts.shift) - (size[0] + size[1]) / 2
    middles = midpoints(test)
    off = np.linalg.norm(middles - middles[_together(middles)].mean(axis=0), axis=1)
    reach = radius + np.minimum(CHANGE * off, CHANGED_M)[:, None]
    near = parallel & (parts.perpendicular < reach) & (gap < reach)
    return paired(test, model, *np.nonzero(near))


def _together(places):
    """Which places are not many times as far from the middle as most are."""
    off = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    return off <= 5 * np.median(off)


class _Search:
    """Displacement that changes along the test set, the paths with most votes.

    Every test line votes at its station, along the longer side of the set, for the displacements
    that bring it to a model line. Changes cost votes. Dynamic programming finds the best path.
    """

    def __init__(self, lines, radius, moved=None):
        step = STEP_M if moved is None else FINE_M
        places = midpoints(lines.test) - midpoints(lines.model).mean(axis=0)
        together = places[_together(places)]
        self.centre = together.mean(axis=0)
        flat = (together - self.centre)[:, :2]
        self.way = np.linalg.eigh(flat.T @ flat)[1][:, 1]
        along = self.along(together)
        low, high = along.min(), along.max() + 1e-9
        farthest = min(CHANGE * max(-low, high), CHANGED_M) * (moved is None)
        wide, up = (int(most / step) + 2 for most in (radius + farthest, radius))
        shape = 2 * wide + 1, 2 * wide + 1, 2 * up + 1
        number = min(np.ceil((high - low) / STATION_M), MOST_STATIONS, MOST_VOTES // np.prod(shape))
        self.stations, gap = np.linspace(low, high, int(number) + 1, retstep=True)
        # multiples of 1 / 1024 have sums that do not depend on the order of rows
        shares = np.maximum(0, 1 - np.abs(self.along(places) - self.stations[:, None]) / gap)
        shares = np.round(32 * shares).astype(np.float32) / 32
        reach = radius + np.minimum(CHANGE * np.abs(self.stations), farthest)
        self.strides = 1, shape[2], shape[1] * shape[2]
        self.moves = step * (np.indices(shape).reshape(3, -1).T - [wide, wide, up])
        far = np.where(np.abs(self.moves[:, 2]) > radius, np.inf, (self.moves**2).sum(axis=1))
        self.votes = np.where(far > reach[:, None] ** 2, np.float32(-np.inf), np.float32(0))
        _vote(self.votes, lines, moved, self.moves / step, step, shares)
        changes = step * np.arange(1, 3) / gap
        self.costs = ((changes / USUAL_CHANGE) ** 2 / 2 / VOTE).astype(np.float32)

    def paths(self):
        """Yield vectors (stations, 3) of the best path, of the best one elsewhere, and so on."""
        while True:
            path, total = _best_path(self.votes, self.strides, *self.costs)
            if total == -np.inf:
                return
            yield self.moves[path]
            _forbid_around(self.votes, self.moves, path)

    def along(self, places):
        """Position of places along the longer side, m from the middle."""
        return (places - self.centre)[:, :2] @ self.way

    def at(self, places, path, turn):
        """Displacement (n, 3) of a path at places (n, 3), with a turn of what is beside it."""
        along = self.along(places)
        beside = (places - self.centre)[:, :2] - along[:, None] * self.way
        moved = [np.interp(along, self.stations, axis) for axis in path.T]
        return np.stack(moved, axis=1) + turn * levers(beside)


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})
def _best_path(votes, strides, one, two):
    """Place of the best path at each station and its total, for votes (stations, places on a grid).

    From station to station a path may move by one or two places along each axis of the grid, which
    costs votes. The two outer places on each side of the grid have votes of minus infinity.
    """
    best, (stations, n) = votes.copy(), votes.shape
    values, old = np.empty(n, votes.dtype), np.empty(n, votes.dtype)
    for station in range(1, stations):
        values[:] = best[station - 1]
        for a in strides:
            old[:] = values
            # slices, since the compiler does not vectorise sums in an index
            here, out = old[2 * a : n - 2 * a], values[2 * a : n - 2 * a]
            before, after, far_before, far_after = old[a:], old[3 * a :], old, old[4 * a :]
            for i in range(len(out)):
                near, far = max(before[i], after[i]), max(far_before[i], far_after[i])
                out[i] = max(here[i], max(near - one, far - two))
        for i in range(n):
            best[station, i] += values[i]
    path = np.zeros(stations, np.int64)
    path[-1] = best[-1].argmax()
    costs = [two, one, np.float32(0.0), one, two]
    for station in range(stations - 2, -1, -1):
        highest = -np.inf
        for i in range(-2, 3):
            for j in range(-2, 3):
                for k in range(-2, 3):
                    at = path[station + 1] + i * strides[0] + j * strides[1] + k * strides[2]
                    value = best[station, at] - costs[i + 2] - costs[j + 2] - costs[k + 2]
                    if value > highest:
                        highest, path[station] = value, at
    return path, best[-1, path[-1]]


@njit(cache=True, nogil=True)
def _forbid_around(votes, moves, path):
    """Set the votes of moves near a path to minus infinity."""
    for station in range(len(path)):
        x, y, z = moves[path[station]]
        for k in range(len(moves)):
            dx, dy, dz = moves[k, 0] - x, moves[k, 1] - y, moves[k, 2] - z
            if dx * dx + dy * dy + dz * dz < ELSEWHERE_M**2:
                votes[station, k] = -np.inf


def _vote(votes, lines, moved, moves, step, shares):
    """Add the votes of the test lines, which have shares (stations, lines) in stations.

    A line does not feel a displacement along itself. So it votes in a plane, and lines of about one
    direction share this plane. Moves are in steps.
    """
    offset = lines.offset
    if moved is not None:
        offset = offset - np.einsum("nkd,nd->nk", lines.frame, moved)
    beside = int(AGREE) + 1
    stamp = np.indices((2 * beside + 1,) * 2).reshape(2, -1).T - beside
    half = int(np.linalg.norm(moves, axis=1).max()) + 1
    side = 2 * half + 1
    left = np.arange(len(lines.rows)) if moved is None else np.flatnonzero(lines.overlap >= 0.18)
    longest = np.argsort(-lines.half[1], kind="stable")
    while len(left):
        first = longest[np.isin(longest, left)][0]
        alike = np.abs(lines.axis[left] @ lines.axis[first]) > np.cos(np.radians(10))
        mine, left = left[alike], left[~alike]
        frame = across(np.linalg.eigh(lines.axis[mine].T @ lines.axis[mine])[1][:, 2:].T)[0]
        off = np.einsum("nk,nkd,ed->ne", offset[mine], lines.frame[mine], frame) / step
        cells = np.round(off).astype(int)[:, None] + stamp
        value = 1 - ((cells - off[:, None]) ** 2).sum(axis=2) / AGREE**2
        rows, row = np.unique(lines.rows[mine], return_inverse=True)
        inside = (value > 0) & (np.abs(cells) <= half).all(axis=2)
        place = (row[:, None] * side + cells[..., 0] + half) * side + cells[..., 1] + half
        each = np.zeros((len(rows), side * side), dtype=np.float32)
        np.maximum.at(each.ravel(), place[inside], np.round(32 * value[inside]) / 32)
        at = (np.round(moves @ frame.T).astype(int) + half) @ [side, 1]
        for station, plane in zip(votes, shares[:, rows] @ each, strict=True):
            station += plane[at]


def _retraced(lines, search, path, turn):
    """Displacement by the best finer path about the straight one next to a path."""
    powers = np.vander(search.stations, 2)
    straight = powers @ np.linalg.pinv(powers) @ path
    again = lines.again(search.at(lines.place, straight, turn))
    fine = _Search(again, FINE_RADIUS_M, search.at(again.place, straight, turn))
    around = np.pad(straight + next(fine.paths()), ((1, 1), (0, 0)), mode="edge")
    smooth = (around[:-2] + 2 * around[1:-1] + around[2:]) / 4
    return partial(search.at, path=smooth, turn=turn)


def _refined(lines, start):
    """Evidence, pairs, and the ends' part of the evidence, from a start.

    Pairs and displacement are updated in turns.
    """
    lines = lines.again(start(lines.place))
    moved, noise = start(lines.place), FIRST_NOISE_M
    off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
    near = (off**2).sum(axis=1) < FINE_RADIUS_M**2
    lines = paired(lines.test, lines.model, lines.rows[near], lines.columns[near])
    moved = moved[near]
    outcome = 0.0, np.zeros(lines.shape, dtype=bool), 0.0
    for _ in range(10):
        lines = lines.again(moved)
        off = lines.offset - np.einsum("nkd,nd->nk", lines.frame, moved)
        variance = noise**2 + LEFT_M**2
        squares = (off**2).sum(axis=1) / variance
        # true pairs share 0.18 of the shorter line at least, and 99.7 % of them are as near
        allowed = (lines.overlap >= 0.18) & (squares < -2 * np.log(0.003))
        pairs = apart(lines, np.where(allowed, squares, np.inf))
        members = np.flatnonzero(pairs[lines.rows, lines.columns])
        if len(members) < 3:
            break
        # log likelihood ratio of true pairs to unrelated lines
        ratio = -squares[members] / 2 - np.log(2 * np.pi * variance * CLUTTER_PER_M2)
        ends = _agreement(lines)[members].sum()
        same, outcome = (pairs == outcome[1]).all(), (ratio.sum() + ends, pairs, ends)
        before, noise = noise, np.clip(np.median(np.abs(off[members])) * 1.48, 0.03, noise)
        if same and noise > 0.99 * before:
            break
        moved = _field(lines, start(lines.place), members, noise)
    return outcome


def _agreement(lines):
    """Log likelihood ratio of the gaps between the ends of paired lines, zero if they disagree."""
    half_t, half_m = lines.half
    gaps = np.abs(np.stack([lines.along - half_t + half_m, lines.along + half_t - half_m]))
    agree = np.exp(-gaps / END_M) / END_M
    ratio = np.log(1 - ENDS_AGREE + ENDS_AGREE * agree / CLUTTER_ENDS_PER_M)
    return np.maximum(ratio.sum(axis=0), 0)


def _field(lines, path, members, noise):
    """Displacement (n, 3) at all pairs, each from the other pairs: the path and what is left of it.

    What is left is a vector, a turn, and drift with a standard deviation of 0.25 m and a
    correlation length of 20 m.
    """
    frame, place = lines.frame[members], lines.place[members]
    centre = place.mean(axis=0)
    off = lines.offset[members] - np.einsum("nkd,nd->nk", frame, path[members])
    design = lines.design(centre)[members]
    prior = noise**2 * np.diag([1e-6, 1e-6, 1e-6, 1 / TURN_RAD**2])
    normal = np.einsum("nkd,nke->de", design, design) + prior
    mean = np.linalg.solve(normal, np.einsum("nkd,nk->d", design, off))
    off = off - design @ mean
    pulls = np.einsum("nkd,nk->nd", frame, off)
    parts = np.concatenate([frame.swapaxes(1, 2) @ frame, pulls[..., None]], axis=2)
    felt = _felt(lines.place, members, parts.reshape(-1, 12).T.copy()).reshape(-1, 3, 4)
    holds, pulls = felt[..., :3] + (noise / 0.25) ** 2 * np.eye(3), felt[..., 3:]
    steady = path + mean[:3] + mean[3] * levers(lines.place - centre)
    return steady + np.linalg.solve(holds, pulls)[..., 0]


@njit(cache=True, nogil=True, fastmath=True)
def _felt(places, members, parts):
    """Sum (n, 12) of the parts (12, members) of all but the place itself, less with distance."""
    felt, shares = np.zeros((len(places), 12)), np.empty(len(members))
    for n in range(len(places)):
        x, y, z = places[n]
        for m in range(len(members)):
            at = places[members[m]]
            gap = math.sqrt((x - at[0]) ** 2 + (y - at[1]) ** 2 + (z - at[2]) ** 2)
            shares[m] = math.exp(-gap / 20) if members[m] != n else 0.0
        for k in range(12):
            total = 0.0
            for m in range(len(members)):
                total += shares[m] * parts[k, m]
            felt[n, k] = total
    return felt
