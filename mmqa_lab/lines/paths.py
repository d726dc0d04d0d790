"""Paths of a displacement that changes along the set, through the votes of its lines."""

from __future__ import annotations

import numpy as np

from mmqa_lab._compiled import njit
from mmqa_lab.lines.pairing import levers
from mmqa_lab.lines.segments import midpoints
from mmqa_lab.lines.settings import (
    AGREE,
    CHANGE,
    CHANGED_M,
    ELSEWHERE_M,
    FINE_M,
    MOST_STATIONS,
    MOST_VOTES,
    STATION_M,
    STEP_M,
    USUAL_CHANGE,
    VOTE,
)
from mmqa_lab.rotations import across

__all__ = ["Search", "together"]


def together(places):
    """Which places are not many times as far from the middle as most are."""
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
