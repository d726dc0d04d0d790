"""Anisotropy: f = d4/d1 beside other measures on patterns of known anisotropy and real clouds."""

from itertools import product

import numpy as np
import pandas as pd
from scipy.spatial import ConvexHull, cKDTree

from mmqa_lab import bench as benches
from mmqa_lab import io, samples
from mmqa_lab.planes import fit_plane
from mmqa_lab.simulate.point_patterns import (
    KINDS,
    aligned_lines_f,
    expected_f,
    point_pattern,
    true_ratio,
)
from mmqa_lab.spacing import directional, quadrant_distances, quadrants, turned_f

LEAST_NOISE, EXACT = 1e-10, 1e-6
"""Noise that only decides on which side of an axis a point lies, and its largest effect on f, m."""

KNOWN = ("lattice", "hexagonal", "scan_lines", "poisson")

CLOSED = {(kind, "turned by 25°"): {"angle": 25} for kind in KNOWN}
CLOSED["scan_lines", "along, least noise"] = {"noise": LEAST_NOISE}
"""Patterns whose f has a closed form, with their position relative to the axes."""

BOARDS = {"board, 16 beams": "boards/vlp16_pose02.laz", "board, 64 beams": "boards/os64_pose02.laz"}


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


def clark_evans(xy):
    """Clark and Evans's index: mean nearest distance over its expectation for a random pattern.

    ``xy`` has the shape (n, 2), m. The index is 2.149 for a hexagonal lattice, 1 for a random
    pattern, and less for clusters. Donnelly's correction for the edges of the hull is applied. The
    index does not depend on direction. Ecology 35 (1954), doi:10.2307/1931034.
    """
    nearest = cKDTree(xy).query(xy, k=2)[0][:, 1]
    hull = ConvexHull(xy - xy.mean(axis=0))
    n, area, outline = len(xy), hull.volume, hull.area
    expected = 0.5 * np.sqrt(area / n) + (0.0514 + 0.041 / np.sqrt(n)) * outline / n
    return float(nearest.mean() / expected)


METHODS = {
    "f": lambda xy: quadrants(xy).f,
    "f, smallest over a turn": lambda xy: turned_f(xy, angles=range(0, 90, 15)).min(),
    "g": lambda xy: directional(xy).g,
    "structure tensor": structure_tensor,
    "Ripley's K by direction": pair_contrast,
    "Clark-Evans index": clark_evans,
}
"""f, g and other measures of anisotropy or regularity: functions of points, shape (n, 2), m."""


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


def closed_forms(*, stretches, repeats, density=3000.0, size=1.5, guard=0.2):
    """Compare f with its closed forms on patterns without edges.

    Parameters
    ----------
    stretches : sequence of float
        Ratios across / along, above 5, so that lines along an axis have their closed form.
    repeats : int
        Patterns of each kind. Their spread gives the standard error.
    density : float
        Points per m2.
    size, guard : float
        Width of the window, and width of its edge, whose points are only neighbours, m.

    Returns
    -------
    DataFrame
        ``pattern``, ``axes``, ``stretch``, ``f_predicted``, ``f_measured``, ``standard_error``,
        ``z`` (difference in standard errors; 0 if the difference is below 1e-6, the effect of
        the least noise), ``n`` (patterns).
    """
    rows = []
    for ratio, ((kind, axes), turn) in product(stretches, CLOSED.items()):
        choices = {"density": density, "size": size, "ratio": ratio, "jitter": 0, **turn}
        windows = [point_pattern(kind, seed=2000 + k, **choices) for k in range(repeats)]
        seen = np.array([_interior_f(xy, guard) for xy in windows])
        predicted = expected_f(kind, ratio) if "angle" in turn else aligned_lines_f()
        error = seen.std(ddof=1) / np.sqrt(repeats)
        off = seen.mean() - predicted
        z = off / error if abs(off) > EXACT else 0.0
        rows.append((kind, axes, ratio, predicted, seen.mean(), error, z, repeats))
    names = ["pattern", "axes", "stretch", "f_predicted", "f_measured", "standard_error", "z", "n"]
    return pd.DataFrame(rows, columns=names)


def _interior_f(xy, guard):
    """Inhomogeneity f of the points outside the edge of their window."""
    low, high = xy.min(axis=0) + guard, xy.max(axis=0) - guard
    inside = ((xy > low) & (xy < high)).all(axis=1)
    medians = np.median(quadrant_distances(xy)[inside], axis=0)
    return medians[3] / medians[0]


def boards():
    """Return the points of boards, shape (n, 3), m, by name; empty if MMQA_DATA has no boards."""
    found = {
        name: samples.real_path(file) for name, file in BOARDS.items() if samples.has_real(file)
    }
    return {name: io.read_cloud(path, columns=()).points for name, path in found.items()}


def real_clouds():
    """Return real clouds in their planes without repeated points: shape (n, 2), m, by name.

    They are the two heads of the road patch, both heads together, and the boards of MMQA_DATA.
    """
    clouds = {f"road, {name}": points for name, points in samples.road_patch_heads().items()}
    clouds |= boards()
    distinct = {name: np.unique(points, axis=0) for name, points in clouds.items()}
    return {name: fit_plane(points).project(points) for name, points in distinct.items()}
