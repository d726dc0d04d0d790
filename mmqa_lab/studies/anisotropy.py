"""Anisotropy: f = d4/d1 beside other measures on patterns of known anisotropy and real clouds."""

import warnings

import numpy as np
from scipy.spatial import cKDTree

from mmqa_lab import bench as benches
from mmqa_lab import io, samples
from mmqa_lab.planes import fit_plane
from mmqa_lab.simulate.point_patterns import KINDS, point_pattern, true_ratio
from mmqa_lab.spacing import directional, quadrants, turned_f

__all__ = [
    "BOARDS", "METHODS", "bench", "boards", "pair_contrast", "pattern", "real_clouds",
    "structure_tensor", "yard",
]  # fmt: skip

BOARDS = {"board, 16 beams": "boards/vlp16_pose02.laz", "board, 64 beams": "boards/os64_pose02.laz"}
YARD_M = (1.1, 2.8)
"""The place of the wall of the yard, from the scanner."""


def structure_tensor(xy):
    """Median of sqrt(largest / smallest eigenvalue) of the scatter of the 16 nearest points.

    ``xy`` has the shape (n, 2), m. Random neighbourhoods are longer than wide: a Poisson pattern
    has about 1.5. If all nearest points lie on the same line, the ratio is infinite.
    """
    near = cKDTree(xy).query(xy, k=min(17, len(xy)))[1][:, 1:]
    offsets = xy[near] - xy[:, None]
    scatter = np.einsum("nki,nkj->nij", offsets, offsets)
    smallest, largest = np.clip(np.linalg.eigvalsh(scatter), 0, None).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.sqrt(largest / smallest)))


def pair_contrast(xy):
    """Contrast of Ripley's K between the directions with most and fewest pairs, from 0 to 1.

    ``xy`` has the shape (n, 2), m. Pairs are at most twice the linear point distance apart. N pairs
    lie within 45 degrees of the direction of their second harmonic, M pairs lie within 45 degrees
    of the direction at a right angle. The contrast is (N - M) / (N + M). Illian et al. 2008,
    section 4.5, doi:10.1002/9780470725160.
    """
    reach = 2 * np.sqrt(np.prod(np.ptp(xy, axis=0)) / len(xy))
    first, second = cKDTree(xy).query_pairs(reach, output_type="ndarray").T
    if not len(first):
        return np.nan
    angle = np.arctan2(*(xy[second] - xy[first]).T[::-1])
    mean = np.angle(np.exp(2j * angle).sum()) / 2
    return float(np.mean(np.where(np.cos(2 * (angle - mean)) > 0, 1.0, -1.0)))


METHODS = {
    "f": lambda xy: quadrants(xy).f,
    "f, smallest over a turn": lambda xy: turned_f(xy, angles=range(0, 90, 15)).min(),
    "g": lambda xy: directional(xy).g,
    "structure tensor": structure_tensor,
    "Ripley's K by direction": pair_contrast,
}
"""f, g and other measures of anisotropy: functions of points, shape (n, 2), m."""


def pattern(kind, stretch, angle, n, noise_mm, *, seed, density=3000.0):
    """Draw a point pattern of n points on average, and state its true ratio across / along."""
    choices = {"ratio": stretch, "angle": angle, "noise": noise_mm / 1000}
    xy = point_pattern(kind, density=density, size=np.sqrt(n / density), seed=seed, **choices)
    return xy, {"ratio": true_ratio(kind, stretch)}


def bench(
    *,
    methods=None,
    kinds=KINDS,
    stretches=(1, 2, 3, 5, 10, 20),
    angles=(0, 30),
    counts=(300, 1500),
    noises_mm=(0.5, 3),
    seeds=range(1000, 1004),
):
    """Define the study's bench: measures on patterns whose ratio across / along is known.

    Parameters
    ----------
    methods : dict, optional
        Functions of points, shape (n, 2), m; by default ``METHODS``.
    kinds : tuple of str
        Names of :data:`mmqa_lab.simulate.point_patterns.KINDS`.
    stretches, angles, counts, noises_mm : tuple of float
        Ratios across / along, directions of the lines in degrees, numbers of points, noise in mm.
    seeds : iterable of int
        Seeds of the patterns.

    Returns
    -------
    Comparison
    """
    cases = benches.grid(kind=kinds, stretch=stretches, angle=angles, n=counts, noise_mm=noises_mm)
    answer = {"tables": lambda results: {"ranks": benches.rank(results, truth="ratio")}}
    return benches.Comparison(cases, dict(methods or METHODS), pattern, seeds=seeds, **answer)


def boards():
    """Return the points of boards, shape (n, 3), m, by name; empty if MMQA_DATA has no boards."""
    found = {name: file for name, file in BOARDS.items() if samples.has_real(file)}
    read = {name: io.read_cloud(samples.real_path(found[name]), columns=()) for name in found}
    return {name: cloud.points for name, cloud in read.items()}


def yard():
    """Return the points of a wall in a yard, shape (n, 3), m, by name; empty if not fetched.

    A scanner of 32 beams stood still: 2 m of the public cloud ``hdl32e_target``.
    """
    if not samples.has_real("hdl32e_target"):
        return {}
    with warnings.catch_warnings(action="ignore"):  # beams without an echo
        points = io.read_cloud(samples.real_path("hdl32e_target"), columns=()).points
    square = points[(np.abs(points[:, :2] - YARD_M) <= 1.0).all(axis=1)]
    wall = fit_plane(square, robust=True)
    return {"wall, 32 beams": square[np.abs((square - wall.centre) @ wall.normal) < 0.1]}


def real_clouds():
    """Return real clouds in their planes without repeated points: shape (n, 2), m, by name.

    They are the two heads of the road patch, both heads together, the boards of MMQA_DATA, and the
    fetched yard.
    """
    clouds = {f"road, {name}": points for name, points in samples.road_patch_heads().items()}
    clouds |= boards() | yard()
    distinct = {name: np.unique(points, axis=0) for name, points in clouds.items()}
    return {name: fit_plane(points).project(points) for name, points in distinct.items()}
