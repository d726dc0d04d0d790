"""Compiled: planes tried among three points, and grown over occupied cells of a cube grid."""

from __future__ import annotations

import math

import numpy as np

from mmqa_lab._compiled import njit
from mmqa_lab.cloud import extent, sort_into_cells

__all__ = ["CELLS_PER_SIZE", "LEAST_AREA", "LEAST_TRIAL", "Grid", "assign", "grow", "try_planes"]


# Cells of the grid along the smallest plane, and its least area in squared sizes (1 m2 at 2 m).
# Points of a plane are connected across one cell.
CELLS_PER_SIZE, LEAST_AREA = 4, 0.25

# Least number of points of a trial; the most from one cell, so that dense and sparse parts count
# alike; the most in all, the nearest ones.
LEAST_TRIAL, DRAWN, NEAREST = 6, 3, 64


@njit(cache=True)
def _off(points, p, plane):
    """Signed distance of a point from a plane."""
    x, y, z = points[p, 0] - plane[0, 0], points[p, 1] - plane[0, 1], points[p, 2] - plane[0, 2]
    return x * plane[1, 0] + y * plane[1, 1] + z * plane[1, 2]


@njit(cache=True)
def _add(moments, points, p, plane):
    """Add a point to the moments (4, 4): products of 1, x, y and z about a plane's centre."""
    x, y, z = points[p, 0] - plane[0, 0], points[p, 1] - plane[0, 1], points[p, 2] - plane[0, 2]
    place = 1.0, x, y, z
    for i in range(4):
        for j in range(4):
            moments[i, j] += place[i] * place[j]


@njit(cache=True)
def _fit(moments, plane):
    """Write the least-squares plane of moments about its centre; return the sums of squares."""
    n, sums, scatter = moments[0, 0], moments[0, 1:], moments[1:, 1:].copy()
    for i in range(3):
        plane[0, i] += sums[i] / n
        for j in range(3):
            scatter[i, j] -= sums[i] * sums[j] / n
    values, vectors = np.linalg.eigh(scatter)
    plane[1] = vectors[:, 0]
    return values


@njit(cache=True)
def _drawn(cells, owner, counts, near, seed, local, far):
    """Write free points around a seed cell, evenly drawn, as columns; return their number."""
    points, start, _ = cells
    n, middle = 0, start[seed]
    for first, last in near:
        for cell in range(first, last):
            stride, free = (counts[cell] + DRAWN - 1) // DRAWN, 0
            for p in range(start[cell], start[cell + 1]):
                if owner[p] < 0:
                    if free % stride == 0:
                        far[n] = 0.0
                        for i in range(3):
                            local[i, n] = points[p, i]
                            far[n] = max(far[n], abs(points[p, i] - points[middle, i]))
                        n += 1
                    free += 1
    if n > NEAREST:
        reach, k = np.sort(far[:n])[NEAREST - 1], 0
        for j in range(n):
            for i in range(3):
                local[i, k] = local[i, j]
            k += far[j] <= reach
        n = k
    return n


@njit(cache=True, nogil=True)
def try_planes(
    begin, end, cells, owner, counts, seeds, near, trials, tolerance, edge, planes, scores
):
    """Write the plane fitted to what the best plane of three points takes, and its score."""
    room, far = np.empty((3, DRAWN * 125)), np.empty(DRAWN * 125)
    for s in range(begin, end):
        n, best, plane = _drawn(cells, owner, counts, near[s], seeds[s], room, far), 0, planes[s]
        if n < LEAST_TRIAL:
            continue
        x, y, z = room[0, :n], room[1, :n], room[2, :n]
        for t in range(len(trials)):
            a, b, c = int(trials[t, 0] * n), int(trials[t, 1] * n), int(trials[t, 2] * n)
            ux, uy, uz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
            vx, vy, vz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area = math.sqrt(nx * nx + ny * ny + nz * nz)
            if area <= 0.5 * edge**2:
                continue
            nx, ny, nz = nx / area, ny / area, nz / area
            offset, votes = x[a] * nx + y[a] * ny + z[a] * nz, 0
            for k in range(n):
                votes += abs(x[k] * nx + y[k] * ny + z[k] * nz - offset) <= tolerance
            if votes > best:
                best = votes
                plane[0, 0], plane[0, 1], plane[0, 2] = x[a], y[a], z[a]
                plane[1, 0], plane[1, 1], plane[1, 2] = nx, ny, nz
        if best < LEAST_TRIAL:
            continue
        moments = np.zeros((4, 4))
        for k in range(n):
            if abs(_off(room.T, k, plane)) <= tolerance:
                _add(moments, room.T, k, plane)
        # points without any plane have a mean square residual of a third of the squared tolerance
        number = moments[0, 0]
        scores[s] = number - _fit(moments, plane)[0] / (tolerance**2 / 3)


@njit(cache=True)
def _spread(cells, owner, seed, plane, tolerance, mark, marks, seen, moments):
    """Cells seen from those that a plane takes, from a seed on: their number and that of taken.

    ``moments`` become those of its free points there. ``marks`` of cells seen become ``mark``, of
    those taken one more. The last number returned is that of free points beside the plane.
    """
    points, start, near = cells
    marks[seed], seen[0] = mark, seed
    done, n, taken, beside = 0, 1, 0, 0
    moments[:] = 0
    while done < n:
        cell, on = seen[done], 0
        done += 1
        for p in range(start[cell], start[cell + 1]):
            if owner[p] < 0:
                off = abs(_off(points, p, plane))
                on += off <= tolerance
                beside += off <= 3 * tolerance
        # tails of a noisy wall and strips of a floor have a smaller share
        if on == 0 or on < 0.25 * (start[cell + 1] - start[cell]):
            continue
        taken, beside, marks[cell] = taken + 1, beside - on, mark + 1
        for p in range(start[cell], start[cell + 1]):
            if owner[p] < 0 and abs(_off(points, p, plane)) <= tolerance:
                _add(moments, points, p, plane)
        for first, last in near[cell]:
            for other in range(first, last):
                if marks[other] < mark:
                    marks[other], seen[n] = mark, other
                    n += 1
    return n, taken, beside


@njit(cache=True)
def grow(cells, owner, number, seeds, planes, limits, done, marks, seen):
    """Grow planes until one is large enough, which gets the number.

    Returns the number of seeds done and that of cells around the plane, 0 if there is none.
    """
    (points, start, _), moments = cells, np.zeros((4, 4))
    tolerance, least = limits
    for s in range(done, len(seeds)):
        grown, enough = 0, True
        for turn in range(4):
            mark = 8 * s + 2 * turn + 1
            if turn:
                _fit(moments, planes[s])
            n, taken, beside = _spread(
                cells, owner, seeds[s], planes[s], tolerance, mark, marks, seen, moments
            )
            enough = taken >= LEAST_AREA * CELLS_PER_SIZE**2 and moments[0, 0] >= least
            if not enough or taken <= grown:
                break
            grown = taken
        # a filled volume has twice as many points beside
        if not enough or moments[0, 0] < 1.5 * beside:
            continue
        for cell in seen[:n]:
            for p in range(start[cell], start[cell + 1] if marks[cell] > mark else 0):
                if owner[p] < 0 and abs(_off(points, p, planes[s])) <= tolerance:
                    owner[p] = number
        return s + 1, n
    return len(seeds), 0


@njit(cache=True)
def assign(cells, around, bounds, planes, tolerance, owner, height, clear):
    """Write the owner of each point, its height above that plane and whether it is the only one.

    The planes are then fitted to those points. Returns their sums of squares (planes, 3) about the
    centre, along the normal first.
    """
    (points, start, _), n = cells, len(planes)
    for k in range(n):
        for cell in around[bounds[k] : bounds[k + 1]]:
            for p in range(start[cell], start[cell + 1]):
                off = _off(points, p, planes[k])
                if abs(off) <= abs(height[p]):
                    owner[p], height[p] = k, off
    for k in range(n):
        for cell in around[bounds[k] : bounds[k + 1]]:
            for p in range(start[cell], start[cell + 1]):
                own = owner[p]
                if own >= 0 and own != k:
                    cosine = 0.0
                    for i in range(3):
                        cosine += planes[k, 1, i] * planes[own, 1, i]
                    clear[p] &= abs(_off(points, p, planes[k]) - cosine * height[p]) > tolerance
    moments, values = np.zeros((n, 4, 4)), np.zeros((n, 3))
    for p in range(len(points)):
        if owner[p] >= 0 and clear[p]:
            _add(moments[owner[p]], points, p, planes[owner[p]])
    for k in range(n):
        if moments[k, 0, 0] >= 3:
            values[k] = _fit(moments[k], planes[k])
    return values


class Grid:
    """Points sorted into the cubic cells that they occupy.

    ``points`` are relative to their lowest corner ``low`` and in the order of the cells; ``order``
    has their rows in the cloud. ``start`` bounds the cells and ``places`` has their indices.
    """

    def __init__(self, points, edge):
        self.edge, self.low = edge, extent(points)[0]
        points = points - self.low
        self.order, self.start, self.places = sort_into_cells(points, edge)
        self.points = points[self.order]
        # with five more places no cell follows one that it does not touch
        self.shape = self.places.max(axis=0) + 5
        self.keys = np.ravel_multi_index((self.places + 2).T, self.shape)

    def near(self, cells: np.ndarray, reach: int) -> np.ndarray:
        """Runs (first, last + 1) of cells within ``reach`` of ascending cells, (n, columns, 2)."""
        side = np.arange(-reach, reach + 1)
        column = (side[:, None] * self.shape[1] + side).ravel() * self.shape[2]
        runs = np.empty((len(cells), len(column), 2), np.int32)
        _find_runs(self.keys, cells, column, reach, runs)
        return runs


@njit(cache=True)
def _find_runs(keys, cells, column, reach, runs):
    """Write the cells with keys within ``reach`` of each cell's key and what leads to a column."""
    for j in range(len(column)):
        first, last = 0, 0
        for k in range(len(cells)):
            middle = keys[cells[k]] + column[j]
            while first < len(keys) and keys[first] < middle - reach:
                first += 1
            while last < len(keys) and keys[last] <= middle + reach:
                last += 1
            runs[k, j, 0], runs[k, j, 1] = first, last
