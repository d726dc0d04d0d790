"""Walls in a cloud: planar segments, rough classes, and how well they agree with known facades.

The first half of the component method (EuroSDR 2013, chapter 4; Pu et al. 2011): planes are grown
over cells from seeds, upright ones that are large enough are walls, what is low is the ground.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmqa_lab.poles.ground import height_above_ground

GROUND, WALL, RAISED = 0, 1, 2
"""Rough classes: ground, wall, and everything that is neither."""

LEAST_VOTES = 8
"""Points of a cell that are enough for a Hough transform."""

DIRECTIONS = 200
"""Normals of the planes that each point votes for."""


def rough_classes(points, settings):
    """Return GROUND, WALL or RAISED for each point.

    Planes are fitted to the points of each cell and grown over neighbouring cells whose planes
    agree; upright ones that are long and high enough are walls. The ground is what lies low above
    the ground's own model.

    Parameters
    ----------
    points : array, shape (n, 3)
    settings : mmqa_lab.poles.itc.Settings

    Returns
    -------
    array of int8, shape (n,)
    """
    rough = np.full(len(points), RAISED, dtype=np.int8)
    if not len(points):
        return rough
    height = height_above_ground(points)
    segment, normal, extent = planar_segments(points, settings)
    upright = np.abs(normal[:, 2]) < np.sin(np.radians(15))
    wall = upright & (extent[:, 0] >= settings.wall_length) & (extent[:, 1] >= settings.wall_height)
    inside = segment >= 0
    rough[inside] = np.where(wall[segment[inside]], WALL, RAISED)
    rough[height < settings.ground_height] = GROUND
    return rough


@dataclass(frozen=True)
class FacadeScore:
    """How well points classed as wall agree with points on facades; counts of points.

    Parameters
    ----------
    right, missed, wrong : int
        On a facade and classed as wall; on a facade and not; classed as wall and on none.
    """

    right: int
    missed: int
    wrong: int

    @property
    def completeness(self):
        """Share of the facades' points that are classed as wall; NaN without facades."""
        return self._share(self.right + self.missed)

    @property
    def correctness(self):
        """Share of the wall's points that lie on facades; NaN without walls."""
        return self._share(self.right + self.wrong)

    @property
    def quality(self):
        """Share of right points among all that are a facade's, a wall's or both."""
        return self._share(self.right + self.missed + self.wrong)

    def _share(self, n):
        """Share of the right points in ``n``."""
        return self.right / n if n else float("nan")


def facade_score(rough, on_facade, *, counted=None):
    """Score the class of walls against points that are known to lie on facades.

    Parameters
    ----------
    rough : array, shape (n,)
        Of :func:`rough_classes`.
    on_facade : array of bool, shape (n,)
    counted : array of bool, shape (n,), optional
        Points that count; all where left out.

    Returns
    -------
    FacadeScore

    Notes
    -----
    Points of one facade are not independent: there is no interval.

    References
    ----------
    Heipke et al. 1997, IAPRS 32 (3-4W2), 151-160 (completeness, correctness, quality).

    Examples
    --------
    >>> score = facade_score(np.array([1, 1, 0, 2]), np.array([True, False, False, True]))
    >>> score.completeness, score.correctness, round(score.quality, 2)
    (0.5, 0.5, 0.33)
    """
    wall, true = np.asarray(rough) == WALL, np.asarray(on_facade, dtype=bool)
    counted = np.ones(len(wall), dtype=bool) if counted is None else counted
    both = (wall & true, ~wall & true, wall & ~true)
    return FacadeScore(*(int((one & counted).sum()) for one in both))


def planar_segments(points, settings):
    """Grow planar segments over cells, from seeds that a Hough transform finds.

    A cell whose points lie on one plane is its own seed. In the others every point votes for the
    planes through it, and the plane with the most votes is the seed, without the points off it.

    Parameters
    ----------
    points : array, shape (n, 3)
    settings : mmqa_lab.poles.itc.Settings

    Returns
    -------
    segment : array of int, shape (n,)
        Segment of each point, -1 where it lies on no plane of its cell.
    normal : array, shape (k, 3)
        Of each segment.
    extent : array, shape (k, 2)
        Horizontal diagonal and height of each segment, metres.

    Notes
    -----
    A Hough transform and not RANSAC: it tries all directions, so that the same cloud in another
    order gives the same segments, and a cell of 0.4 m needs few (8 degrees apart, then least
    squares).
    """
    cell, index = cells(points, settings.plane_cell)
    off = points - (index[cell] + 0.5) * settings.plane_cell - points.min(axis=0)
    on = np.ones(len(points), dtype=bool)
    count, centre, values, normals = _planes(off, cell, on)
    thick = ~_is_flat(count, values, settings) & (count >= LEAST_VOTES)
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(len(index) + 1))
    on[order] = _on_seeds(off[order], start, thick, _directions(), settings.plane_thickness)
    count, centre, values, normals = _planes(off, cell, on)
    centre += (index + 0.5) * settings.plane_cell
    flat = _is_flat(count, values, settings)
    a, b = touching(index)
    linked = flat[a] & flat[b] & _agree(centre, normals, a, b, settings)
    part = joined(a[linked], b[linked], len(count))
    largest = np.lexsort([-count, part])
    first = largest[np.unique(part[largest], return_index=True)[1]]
    extent = _extents(centre[flat], part[flat], part.max(initial=-1) + 1)
    return np.where(flat[cell] & on, part[cell], -1), normals[first], extent


def _planes(off, cell, on):
    """Count, centre, variances (rising) and normal of the chosen points of each cell."""
    n = int(cell.max()) + 1
    cell, off = cell[on], off[on]
    count = np.bincount(cell, minlength=n)
    centre = np.stack([np.bincount(cell, off[:, k], n) for k in range(3)], axis=1)
    centre /= np.maximum(count, 1)[:, None]
    off = off - centre[cell]
    covariance = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            sums = np.bincount(cell, off[:, i] * off[:, j], n) / np.maximum(count, 1)
            covariance[:, i, j] = covariance[:, j, i] = sums
    values, vectors = np.linalg.eigh(covariance)
    return count, centre, values, vectors[:, :, 0]


def _is_flat(count, values, settings):
    """Whether the points of cells with these variances lie on a plane and not on a line."""
    thick = np.sqrt(np.maximum(values[:, 0], 0))
    flat = (count >= 4) & (thick < settings.plane_thickness) & (values[:, 1] > 4 * values[:, 0])
    return flat & (values[:, 1] > (settings.plane_cell / 10) ** 2)


def _agree(centre, normals, a, b, settings):
    """Whether the planes of cells a and b continue each other."""
    joint = centre[b] - centre[a]
    near = np.abs(np.einsum("ij,ij->i", joint, normals[a])) < settings.plane_offset
    near &= np.abs(np.einsum("ij,ij->i", joint, normals[b])) < settings.plane_offset
    cosine = np.abs(np.einsum("ij,ij->i", normals[a], normals[b]))
    return near & (cosine > np.cos(np.radians(settings.plane_angle)))


def _directions():
    """Normals over the half sphere, a spiral about 8 degrees apart."""
    z = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(DIRECTIONS)
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


@njit(cache=True, parallel=True)
def _on_seeds(off, start, thick, directions, thickness):
    """Which points, sorted by cell, lie on the seed plane of their cell; all of those not thick."""
    on = np.ones(len(off), np.bool_)
    for c in prange(len(thick)):
        if thick[c]:
            part = off[start[c] : start[c + 1]]
            on[start[c] : start[c + 1]] = _seed(part, directions, thickness)
    return on


@njit(cache=True)
def _seed(part, directions, thickness):
    """Which points lie on the plane with the most votes."""
    most, best, best_bin = 0, 0, 0
    reach = int(np.sqrt((part**2).sum(axis=1).max()) / (2 * thickness)) + 1
    votes = np.zeros(2 * reach + 1, np.int64)
    for d in range(len(directions)):
        votes[:] = 0
        for k in range(len(part)):
            away = (part[k] * directions[d]).sum()
            votes[int(np.floor(away / (2 * thickness))) + reach] += 1
        top = votes.argmax()
        if votes[top] > most:
            most, best, best_bin = votes[top], d, top
    middle = (best_bin - reach + 0.5) * 2 * thickness
    on = np.empty(len(part), np.bool_)
    for k in range(len(part)):
        on[k] = abs((part[k] * directions[best]).sum() - middle) <= 2 * thickness
    return on


def _extents(centre, part, n):
    """Horizontal diagonal and height of the cells of each part."""
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, part, centre)
    np.maximum.at(high, part, centre)
    size = np.maximum(high - low, 0)
    return np.column_stack([np.hypot(size[:, 0], size[:, 1]), size[:, 2]])


def cells(points, size):
    """Number of the occupied cell of each point, and the cells' indices, (k, 3)."""
    index = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    spans = index.max(axis=0) + 3
    key = (index[:, 0] * spans[1] + index[:, 1]) * spans[2] + index[:, 2]
    keys, cell = np.unique(key, return_inverse=True)
    rest, z = np.divmod(keys, spans[2])
    x, y = np.divmod(rest, spans[1])
    return cell, np.stack([x, y, z], axis=1)


def touching(index):
    """Pairs of occupied cells that share a face, an edge or a corner."""
    spans = index.max(axis=0) + 3
    key = ((index[:, 0] + 1) * spans[1] + index[:, 1] + 1) * spans[2] + index[:, 2] + 1
    order = np.argsort(key)
    sorted_key = key[order]
    first, second = [], []
    for step in _HALF:
        other = key + (step[0] * spans[1] + step[1]) * spans[2] + step[2]
        at = np.minimum(np.searchsorted(sorted_key, other), len(key) - 1)
        found = np.flatnonzero(sorted_key[at] == other)
        first.append(found)
        second.append(order[at[found]])
    return np.concatenate(first), np.concatenate(second)


_HALF = [
    (dx, dy, dz)
    for dx in (-1, 0, 1)
    for dy in (-1, 0, 1)
    for dz in (-1, 0, 1)
    if (dx, dy, dz) > (0, 0, 0)
]


def joined(a, b, n):
    """Number of the connected component of each of n things."""
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
