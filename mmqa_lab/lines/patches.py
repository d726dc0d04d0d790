"""Principal planes in a cloud: locally sampled RANSAC with refit.

Chosen over region growing because it needs no normals: the profiles of mobile scanners are dense
along and sparse across, and normals from nearest neighbours then describe one scan line, not the
wall. Sampling three points near each other keeps the number of trials small where a cloud has a
hundred planes (Poreba & Goulette 2012 detect the principal planes of facades by RANSAC as well).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.planes import Plane, fit_plane

SAMPLE = 60_000
"""Points that vote; the others are only assigned."""

SEEDS = 48
NEIGHBOURS = 192
PATIENCE = 12
"""Rounds in a row without a plane after which the search ends."""

CELLS_PER_SIZE = 4
ROUGHEST = 0.48
"""Largest residual standard deviation in tolerances; points without any plane have 0.58."""

LEAST_SPREAD = 0.05
"""Of a trial triangle: twice its area over the squared size."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A connected planar part of a cloud.

    Parameters
    ----------
    plane : Plane
        Fitted to the points that lie on this plane only, not also on a neighbouring one.
    index : array of int, shape (n,)
        Rows of the cloud within the tolerance, nearest to this plane.
    moments : array, shape (2,)
        Sums of the squared coordinates of the fitted points along the plane's axes, square metres.

    Examples
    --------
    >>> flat = np.random.default_rng(0).uniform(0, 5, (4000, 3)) * [1, 1, 0]
    >>> floor = detect_planes(flat)[0]
    >>> len(floor), floor.plane.normal.round(9).tolist()
    (4000, [0.0, 0.0, 1.0])
    """

    plane: Plane
    index: np.ndarray
    moments: np.ndarray

    def __len__(self):
        return len(self.index)

    def offset_variance(self, point):
        """Variance of the plane's height at a point, square metres: independent residuals."""
        square = self.plane.project(point[None])[0] ** 2
        return self.plane.std**2 * (1 / self.plane.n + (square / self.moments).sum())


def detect_planes(points, *, tolerance=0.05, size=2.0, minimum=200, seed=0):
    """Find the principal planes of a cloud.

    Each round draws seed points among those left, fits planes to three neighbours of each, lets
    the sample vote, keeps the part of the best plane that hangs together with its seed, refits,
    and takes its points away. At the end all points go to the nearest plane within the tolerance
    and the planes are fitted again.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    tolerance : float
        Largest distance of a point from its plane, m: about three times the noise.
    size : float
        Extent of the smallest plane sought, m. Points of a plane hang together across gaps up
        to a quarter of it: keep that above the distance of scan lines.
    minimum : int
        Least number of points of a plane.
    seed : int
        Equal seeds give equal planes.

    Returns
    -------
    list of Patch
        The one with the most points first; empty when there is none.

    Raises
    ------
    ValueError
        If a setting is not positive or a coordinate is not finite.

    Notes
    -----
    Curved and rough surfaces come out as several planes or none. Planes closer to each other than
    the tolerance are one.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 3: edges from planes found by RANSAC.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> flat = rng.uniform(0, 5, (1500, 3))
    >>> floor, wall = flat * [1, 1, 0], flat * [1, 0, 1]
    >>> [len(patch) > 1400 for patch in detect_planes(np.concatenate([floor, wall]))]
    [True, True]
    """
    points = check_points(points, minimum=0)
    tolerance = check_positive(tolerance, "tolerance", unit="m")
    size = check_positive(size, "size", unit="m")
    minimum = check_count(minimum, "minimum", low=3)
    rng = np.random.default_rng(check_count(seed, "seed", low=0))
    if len(points) < minimum:
        return []
    local = points - points.mean(axis=0)
    sample = local[np.sort(rng.permutation(len(local))[:SAMPLE])]
    share = len(sample) / len(local)
    found = _search(sample, tolerance, size, max(8, minimum * share), rng)
    return _assigned(points, local, found, tolerance, size, minimum)


def _search(sample, tolerance, size, minimum, rng):
    """Planes (centre, normal, seed point) in the sample, one after the other."""
    tree = cKDTree(sample)
    left = np.ones(len(sample), dtype=bool)
    found, failures = [], 0
    while failures < PATIENCE and left.sum() >= minimum:
        best = _best_trial(sample, tree, left, tolerance, size, rng)
        members = None if best is None else _grown(sample, left, *best, tolerance, size)
        if members is None or len(members) < minimum:
            failures += 1
            continue
        failures = 0
        centre, normal = _fitted(sample[members])
        found.append((centre, normal, best[0]))
        left[members] = False
    return found


def _best_trial(sample, tree, left, tolerance, size, rng):
    """The seed point and normal of the trial with most votes."""
    seeds = rng.choice(np.flatnonzero(left), SEEDS)
    most = min(NEIGHBOURS, len(sample))
    _, near = tree.query(sample[seeds], k=most, distance_upper_bound=size)
    origins, normals = [], []
    for seed, row in zip(seeds, near, strict=True):
        row = row[row < len(sample)]
        row = row[left[row]]
        if len(row) < 3:
            continue
        a, b = sample[rng.choice(row, 2)] - sample[seed]
        normal = np.cross(a, b)
        length = np.linalg.norm(normal)
        if length > LEAST_SPREAD * size**2 / 4:
            origins.append(sample[seed])
            normals.append(normal / length)
    if not origins:
        return None
    origins, normals = np.array(origins), np.array(normals)
    remaining = sample[left]
    offsets = remaining @ normals.T - (origins * normals).sum(axis=1)
    best = np.argmax((np.abs(offsets) <= tolerance).sum(axis=0))
    return origins[best], normals[best]


def _grown(sample, left, origin, normal, tolerance, size):
    """Indices of the sample that the plane through ``origin`` holds together, refitted twice."""
    centre, members = origin, None
    for _ in range(3):
        near = np.flatnonzero(left & (np.abs((sample - centre) @ normal) <= tolerance))
        members = near[_connected(sample[near], normal, origin, size)]
        if len(members) < 3:
            return None
        centre, normal = _fitted(sample[members])
    return members


def _connected(points, normal, origin, size):
    """Points whose cells of the plane hang together with that of ``origin``; bool."""
    cell = size / CELLS_PER_SIZE
    axes = np.linalg.svd(normal[None])[2][1:]
    grid = np.floor((points - origin) @ axes.T / cell + 0.5).astype(int)
    low = np.minimum(grid.min(axis=0, initial=0), 0) - 1
    shape = np.maximum(grid.max(axis=0, initial=0), 0) - low + 2
    occupied = np.zeros(shape, dtype=bool)
    occupied[tuple((grid - low).T)] = True
    labels, _ = ndimage.label(occupied, structure=np.ones((3, 3)))
    home = labels[tuple(-low)]
    return (labels[tuple((grid - low).T)] == home) & (home > 0)


def _fitted(points):
    """Centre and unit normal of the least-squares plane."""
    centre = points.mean(axis=0)
    centred = points - centre
    return centre, np.linalg.eigh(centred.T @ centred)[1][:, 0]


def _assigned(points, local, found, tolerance, size, minimum):
    """Patches of the whole cloud: each point to its nearest plane, then a fit of the clear ones."""
    nearest, owner = np.full(len(local), tolerance), np.full(len(local), -1)
    claims = np.zeros(len(local), dtype=np.int16)
    for number, (centre, normal, seed) in enumerate(found):
        distance = np.abs((local - centre) @ normal)
        inside = np.flatnonzero(distance <= tolerance)
        inside = inside[_connected(local[inside], normal, seed, size)]
        claims[inside] += 1
        closer = inside[distance[inside] <= nearest[inside]]
        nearest[closer], owner[closer] = distance[closer], number
    patches = []
    for number in range(len(found)):
        index = np.flatnonzero(owner == number)
        clear = index[claims[index] == 1]
        if len(index) >= minimum and len(clear) >= 3:
            plane = fit_plane(points[clear])
            moments = (plane.project(points[clear]) ** 2).sum(axis=0)
            if plane.std <= ROUGHEST * tolerance:
                patches.append(Patch(plane, index, moments))
    return sorted(patches, key=len, reverse=True)
