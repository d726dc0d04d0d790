"""The search for a displacement that changes along the set, in five steps.

1. :func:`_candidates`: pairs of nearly parallel lines within reach.
2. :class:`Search`: each test line votes near its place for the displacements that bring it to a
   model line; the paths with most votes.
3. :func:`_retraced`: each path again in finer steps about the straight line next to it.
4. :func:`refined`: pairs and displacement in turns from there, and the evidence for the pairs.
5. :func:`matched`: the path with most evidence, if no other explains nearly as much.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import islice
from operator import itemgetter

import numpy as np

from mmqa_lab._compiled import njit
from mmqa_lab.lines.pairing import apart, levers, paired
from mmqa_lab.lines.segments import components, lengths, midpoints
from mmqa_lab.rotations import across

__all__ = ["MOST_RADIUS_M", "TURN_RAD", "matched"]

# Constants of a step, and what they were chosen on.

# 1, 2: drifts and turns of mobile scanners in print. Largest angle of paired lines; largest change
# of the displacement with the distance from the middle (a turn of 3.4 degrees), its usual change
# from station to station, m/m, and its largest change in all, m; standard deviation of a turn about
# the vertical, and turns tried between the lines on both sides of the path.
PARALLEL_RAD, CHANGE, USUAL_CHANGE, CHANGED_M = np.radians(8), 0.06, 0.05, 6.0
TURN_RAD, TURNS = np.radians(1.0), np.radians([-3, -1.5, 0, 1.5, 3])

# 2, 3: half the noise of lines; time and memory. Steps of the displacements tried, first and about
# the path found, and how far from it; distance of stations and their number; distance in steps
# within which lines agree; largest radius, and number of votes that is kept in memory.
STEP_M, FINE_M, FINE_RADIUS_M = 0.3, 0.15, 1.5
STATION_M, MOST_STATIONS, AGREE = 5.0, 60, 1.7
MOST_RADIUS_M, MOST_VOTES = 20.0, 3e7

# 2, 4: simulated canyons of other seeds than the reported. Log likelihood ratio of one vote; noise
# with which pairs are sought first; density of unrelated parallel lines; standard deviation of
# drift that neighbours do not show; share of the shorter line that a true pair has in common.
VOTE, FIRST_NOISE_M, CLUTTER_PER_M2, LEFT_M, COMMON = 2.5, 0.3, 0.1, 0.08, 0.18

# 4: gaps of ends in simulated rows of windows. Least share of the ends of true pairs that agree,
# and their mean gap; density of other gaps.
ENDS_AGREE, END_M, CLUTTER_ENDS_PER_M = 0.3, 0.15, 0.4

# 5: simulated canyons, and equal bays, where three paths may be all one wrong answer. Paths
# compared; the most where others have nearly as many votes as the best, this share; least distance
# of paths at each station.
PATHS, MOST_PATHS, LEAST_VOTES, ELSEWHERE_M = 3, 8, 0.75, 0.8

# 5: canyons, and sets without any common line. Least evidence a pair; share of the smaller set
# below which there is a remark.
LEAST_EVIDENCE, FEW_SHARE = 2.2, 0.4

# 5: 300 rows of windows with few common lines, so no score there. Least evidence a pair where few
# lines are paired, and how much less with their share, without the ends or with them; largest
# evidence of other pairs over the best, and the most of it with the share of paired lines.
FEW_EVIDENCE = (7.2, 10.0), (10.0, 16.0)
RIVAL, MOST_RIVAL = 0.45, 0.9


def matched(test, model, radius):
    """Pairs of the displacement that unites most lines, none if it does not stand out; a remark."""
    lines = _candidates(test, model, radius)
    none = np.zeros(lines.shape, dtype=bool)
    if len(lines.rows) < 3:
        return none, f"Fewer than three lines have a parallel one within {radius:g} m."
    outcomes = _outcomes(lines, Search(lines, radius))
    # the others are rivals alone: of many paths one agrees by chance
    evidence, found, ends = max(outcomes[: PATHS * len(TURNS)], key=itemgetter(0))
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


def _outcomes(lines, search):
    """Evidence, pairs and the ends' part of it for paths by votes, each with turns of its sides."""
    found, best, most = [], (0.0, 0.0), 0.0
    for number, (path, votes) in enumerate(islice(search.paths(), MOST_PATHS)):
        most = max(most, votes)
        if number >= PATHS and votes < LEAST_VOTES * most:
            break
        for turn in TURNS if number < PATHS else best[1:]:
            found.append(refined(lines, _retraced(lines, search, path, turn)))
            best = max(best, (found[-1][0], turn))
    return found


def _candidates(test, model, radius):
    """Pairs of nearly parallel lines within the radius, or farther off the middle within reach."""
    parts, size = components(test, model), (lengths(test)[:, None], lengths(model))
    parallel = parts.angle < np.sin(PARALLEL_RAD) * np.minimum(*size)
    gap = np.abs(parts.shift) - (size[0] + size[1]) / 2
    middles = midpoints(test)
    off = np.linalg.norm(middles - middles[together(middles)].mean(axis=0), axis=1)
    reach = radius + np.minimum(CHANGE * off, CHANGED_M)[:, None]
    near = parallel & (parts.perpendicular < reach) & (gap < reach)
    return paired(test, model, *np.nonzero(near))


def _retraced(lines, search, path, turn):
    """Displacement by the best finer path about the straight one next to a path."""
    powers = np.vander(search.stations, 2)
    straight = powers @ np.linalg.pinv(powers) @ path
    again = lines.again(search.at(lines.place, straight, turn))
    fine = Search(again, FINE_RADIUS_M, search.at(again.place, straight, turn))
    around = np.pad(straight + next(fine.paths())[0], ((1, 1), (0, 0)), mode="edge")
    smooth = (around[:-2] + 2 * around[1:-1] + around[2:]) / 4
    return partial(search.at, path=smooth, turn=turn)


def together(places):
    """Return which places are not many times as far from the middle as most are."""
    off = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    return off <= 5 * np.median(off)


class Search:
    """Displacement that changes along the test set, the paths with most votes.

    Every test line votes at its station, along the longer side of the set, for the displacements
    that bring it to a model line. Changes cost votes. Dynamic programming finds the best path.
    """

    def __init__(self, lines, radius, moved=None):
        step = STEP_M if moved is None else FINE_M
        places = midpoints(lines.test) - midpoints(lines.model).mean(axis=0)
        near = places[together(places)]
        self.centre = near.mean(axis=0)
        flat = (near - self.centre)[:, :2]
        self.way = np.linalg.eigh(flat.T @ flat)[1][:, 1]
        along = self.along(near)
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
        """Yield vectors (stations, 3) of the best path, of the best one elsewhere, and so on.

        With each its number of votes.
        """
        while True:
            path, total = _best_path(self.votes, self.strides, *self.costs)
            if total == -np.inf:
                return
            yield self.moves[path], total
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
    left = np.arange(len(lines.rows)) if moved is None else np.flatnonzero(lines.overlap >= COMMON)
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
        _add_planes(votes, shares[:, rows] @ each, moves, frame, half)


@njit(cache=True, nogil=True)
def _add_planes(votes, planes, moves, frame, half):
    """Add the votes of a plane of each station to the moves that are sought there."""
    at = np.empty(len(moves), np.int64)
    for k in range(len(moves)):
        x, y, z = moves[k]
        across = int(np.rint(x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2])) + half
        up = int(np.rint(x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2])) + half
        at[k] = across * (2 * half + 1) + up
    for station in range(len(votes)):
        for k in range(len(at)):
            if votes[station, k] >= 0:
                votes[station, k] += planes[station, at[k]]


def refined(lines, start):
    """Return the evidence, pairs, and the ends' part of the evidence, from a start.

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
        # true pairs are as near in 99.7 % of cases
        allowed = (lines.overlap >= COMMON) & (squares < -2 * np.log(0.003))
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
