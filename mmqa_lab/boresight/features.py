"""What the points of a calibration lie on: planes, poles and levelled points, and how far off.

Each feature has parameters of its own, which the adjustment eliminates.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_points
from mmqa_lab.planes import fit_plane, sigma_mad

OWN_PARAMETERS = {"plane": 3, "pole": 5, "control": 2}
"""Of a feature itself; they are eliminated from the adjustment."""

COMMON = 2
"""Column of what all points of a control point share: the error of its survey."""

PATCH_GAP_M = 0.3
"""Planes of one cube that lie farther apart, or turned by 5 degrees, are different things."""

HEIGHT_GAP_M = 0.3
"""Points farther above or below a control point do not show its ground."""

LARGEST_GAP = 0.6
"""Of the extent of a plane's points: three scan lines at equal distances leave 0.5."""

LEAST_WIDTH_M = 0.01
"""Points of one scan line are no plane."""

OUTLIER = 3.5
"""Points so many sigma_MAD from their own group's plane or circle are left out."""

BEYOND = 0.5
"""Cosine between beam and outward normal from which a point lies on the far side of a pole."""

MOST_OF_GROUP = 100
"""Points of a drive's head that one plane takes."""


@dataclass(eq=False)
class Feature:
    """What some points lie on: its kind, their numbers, and its known place or radius."""

    kind: str
    index: np.ndarray
    known: object = None

    def __len__(self):
        return len(self.index)

    def inside(self, misfit):
        """Misfit without the part that all points share: of control, the survey's own error."""
        return misfit - np.median(misfit) if self.kind == "control" else misfit


def near_own(misfit):
    """Which points lie near their own feature."""
    return np.abs(misfit) <= OUTLIER * max(sigma_mad(misfit), 1e-6)


def measured(features, points, beams, survey, noise_m):
    """Distances of points from the features fitted to them, planes first.

    Also their directions (n, 3), and an orthonormal basis (n, 5) of what the feature's own
    parameters change in them; columns that a feature does not need are 0. Of control points column
    ``COMMON`` is shorter: it is what their survey's error, common to all their points, takes out.
    """
    counts = np.array([len(feature) for feature in features])
    planes = np.array([feature.kind == "plane" for feature in features])
    misfit, normal = np.empty(len(points)), np.empty((len(points), 3))
    basis = np.zeros((len(points), max(OWN_PARAMETERS.values())))
    flat = counts[planes].sum()
    misfit[:flat], normal[:flat], basis[:flat, :3] = _plane_misfits(points[:flat], counts[planes])
    first = flat
    for feature in np.array(features, dtype=object)[~planes]:
        part = slice(first, first + len(feature))
        if feature.kind == "pole":
            found = pole_misfit(points[part], feature.known, beams[part, :2], noise_m)
        else:
            found = _control_misfit(points[part], feature.known)
        misfit[part], normal[part], derivative = found
        own, size = np.linalg.qr(derivative)
        if feature.kind == "control":
            left = 1 / np.hypot(1, survey * size[COMMON, COMMON])
            own[:, COMMON] *= np.sqrt(1 - left)
        basis[part, : derivative.shape[1]] = own
        first += len(feature)
    return misfit, normal, basis


def _group_planes(points, counts):
    """Centres (k, 3), variances (k, 3) and axes (columns) of groups of points, and points off them.

    Variances rise along the axes: the first is the normal.
    """
    starts = np.cumsum(counts) - counts
    centre = np.add.reduceat(points, starts) / counts[:, None]
    off = points - np.repeat(centre, counts, axis=0)
    scatter = np.add.reduceat(off[:, :, None] * off[:, None, :], starts) / counts[:, None, None]
    variance, axes = np.linalg.eigh(scatter)
    return centre, np.maximum(variance, 0), axes, off


def _plane_misfits(points, counts):
    """Distances from the regression plane of each group, normals, basis of offset and two tilts."""
    _, variance, axes, off = _group_planes(points, counts)
    axes = np.repeat(axes, counts, axis=0)
    along = np.einsum("ni,nij->nj", off, axes)
    # principal axes from the centre are orthogonal to each other and to the constant
    size = np.sqrt(counts[:, None] * np.maximum(variance[:, 1:], 1e-12))
    basis = np.column_stack([np.ones(len(points)), along[:, 1:]])
    basis /= np.repeat(np.column_stack([np.sqrt(counts), size]), counts, axis=0)
    return along[:, 0], axes[:, :, 0], basis


def pole_misfit(points, radius=None, beams=None, noise_m=0.0):
    """Distances from the best cylinder, outward normals, derivatives by its parameters.

    With a free radius, noise pushes the two sides of a thin pole apart by a millimetre or two. Of
    ``beams`` (n, 2) come the side on which an arc lies, and what range noise adds to distances from
    the axis: half of its square across, over the radius.
    """
    height = points[:, 2] - points[:, 2].mean()
    middle = np.median(points[:, :2], axis=0)
    spread = np.median(np.hypot(*(points[:, :2] - middle).T))
    axis, free = np.array([*middle, 0.0, 0.0, max(spread, 0.03)]), 5 if radius is None else 4
    if radius is not None:
        axis[4] = radius
        if beams is not None:  # the mean of a half circle is so far from its middle
            axis[:2] += np.pi / 4 * radius * beams.mean(axis=0)
    for _ in range(12):
        misfit, way, derivative = from_axis(points, height, axis, beams, noise_m)
        change = np.linalg.lstsq(derivative[:, :free], -misfit, rcond=1e-8)[0]
        axis[:free] += np.clip(change, -0.1, 0.1)
        axis[4] = np.clip(axis[4], 0.01, 0.5)
        if np.abs(change).max() < 1e-8:
            break
    misfit, way, derivative = from_axis(points, height, axis, beams, noise_m)
    tilt = np.column_stack([way, -(way * axis[2:4]).sum(axis=1)])
    return misfit, tilt, derivative[:, :free]


def from_axis(points, height, axis, beams, noise_m):
    """Distances from a cylinder, unit vectors from its axis in plan, derivatives.

    A point clearly beyond the axis, seen along its beam, is a negative distance away.
    """
    off = points[:, :2] - axis[:2] - height[:, None] * axis[2:4]
    distance = np.maximum(np.hypot(*off.T), 1e-9)
    way = off / distance[:, None]
    if beams is not None:
        side = np.where((way * beams).sum(axis=1) > BEYOND, -1.0, 1.0)
        distance, way = side * distance, side[:, None] * way
        across = way[:, 0] * beams[:, 1] - way[:, 1] * beams[:, 0]
        distance = distance - (noise_m * across) ** 2 / (2 * axis[4])
    derivative = -np.column_stack([way, height[:, None] * way, np.ones(len(points))])
    return distance - axis[4], way, derivative


def _control_misfit(points, known):
    """Heights over a control point, less the slope about the points' middle; tilts, a constant.

    A slope through the control point itself would take up a part of its height's error.
    """
    off = points - known
    tilts = off[:, :2] - off[:, :2].mean(axis=0)
    slope = np.linalg.lstsq(tilts, off[:, 2], rcond=None)[0]
    normal = np.broadcast_to([-slope[0], -slope[1], 1.0], points.shape)
    return off[:, 2] - tilts @ slope, normal, np.column_stack([tilts, np.ones(len(off))])


def shared_planes(placed, groups, *, cell, most, roughness, rng):
    """Planes that two or more groups show around one place.

    Cubes only say where to look: a plane along the side of a cube is cut by it according to the
    noise, so points are taken from a ball around the middle.
    """
    seeds = _seeds(placed, groups, cell, roughness)
    seeds = seeds.iloc[rng.permutation(len(seeds))]
    turn = seeds.groupby("side").cumcount()
    centres = seeds[["x", "y", "z"]].to_numpy()
    taken = np.empty((0, 3))
    found = []
    tree = cKDTree(placed)
    for k in np.lexsort((seeds["side"], turn)):  # sides by turns
        if len(found) == most:
            break
        if len(taken) and np.abs(taken - centres[k]).max(axis=1).min() < 0.7 * cell:
            continue
        near = np.array(tree.query_ball_point(centres[k], cell / 2), dtype=int)
        index = _common_plane(placed, near, groups[near], roughness, rng)
        if index is not None:
            found.append(Feature("plane", index))
            taken = np.vstack([taken, centres[k]])
    return found


def shared_poles(placed, groups, poles, origin, search=0.5, low=0.4, high=6.0, fewest=12):
    """Poles that two or more groups show."""
    if poles is None:
        return []
    tree = cKDTree(placed[:, :2])
    found = []
    for pole in poles.to_dict("records"):
        foot = np.array([pole["x_m"], pole["y_m"], pole["z_m"]]) - origin
        index = np.array(tree.query_ball_point(foot[:2], search), dtype=int)
        above = placed[index, 2] - foot[2]
        index = index[(above > low) & (above < high)]
        members = [
            _round(placed, index[groups[index] == g], fewest) for g in np.unique(groups[index])
        ]
        members = [m for m in members if m is not None]
        if len(members) > 1:
            joined = np.concatenate(members)
            radius = pole.get("diameter_m", np.nan) / 2
            found.append(Feature("pole", joined, radius if radius > 0 else None))
    return found


def known_heights(placed, control, origin, radius=0.3, fewest=12):
    """Heights of the ground at points where it is known."""
    if control is None:
        return []
    known = check_points(control, name="control") - origin
    near = cKDTree(known[:, :2])
    gap, which = near.query(placed[:, :2], distance_upper_bound=radius)
    close = np.isfinite(gap)
    close[close] = np.abs(placed[close, 2] - known[which[close], 2]) < HEIGHT_GAP_M
    order = np.flatnonzero(close)[np.argsort(which[close], kind="stable")]
    found = []
    for run in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
        if len(run) >= fewest:
            found.append(Feature("control", run, known[which[run[0]]]))
    return found


def _seeds(placed, groups, cell, roughness, fewest=20):
    """Cubes in which two or more groups each show a plane: a row of the first group of each."""
    cube = np.floor(placed / cell).astype(np.int64)
    number = np.ravel_multi_index((cube - cube.min(axis=0)).T, np.ptp(cube, axis=0) + 1)
    order = np.lexsort((groups, number))
    key = number[order] * (groups.max() + 1) + groups[order]
    starts = np.append(0, np.flatnonzero(np.diff(key)) + 1)
    n = np.diff(np.append(starts, len(order)))
    centre, variance, axes, _ = _group_planes(placed[order], n)
    rms, narrow = np.sqrt(variance[:, :2]).T
    table = pd.DataFrame(centre, columns=["x", "y", "z"])
    table["side"] = np.abs(axes[:, :, 0]).argmax(axis=1)
    table["cube"] = number[order][starts]
    flat = (rms <= roughness) & (narrow >= np.maximum(5 * rms, 0.1)) & (n >= fewest)
    table = table[flat]
    return table[table["cube"].duplicated(keep=False)].drop_duplicates("cube")


def _common_plane(placed, near, group, roughness, rng, fewest=15):
    """Points of the groups that show one plane there; None where fewer than two do."""
    members, planes = [], []
    for name in np.unique(group):
        run = near[group == name]
        if len(run) < fewest or not _filled(placed[run]):
            continue
        plane = fit_plane(placed[run])
        if plane.rms <= roughness:
            members.append(run)
            planes.append(plane)
    if len(members) < 2:
        return None
    best = max(range(len(members)), key=lambda k: len(members[k]))
    alike = [
        rng.permutation(run[near_own(plane.residuals)])[:MOST_OF_GROUP]
        for run, plane in zip(members, planes, strict=True)
        if abs(plane.normal @ planes[best].normal) > np.cos(np.radians(5))
        and abs(planes[best].distances(plane.centre[None])[0]) < PATCH_GAP_M
    ]
    return np.concatenate(alike) if len(alike) > 1 else None


def _filled(points):
    """Whether no gap takes most of their extent: two scan lines lie on one plane on any surface."""
    off = points - points.mean(axis=0)
    along = np.sort(off @ np.linalg.svd(off, full_matrices=False)[2][:2].T, axis=0)
    gap, extent = np.diff(along, axis=0).max(axis=0), np.ptp(along, axis=0)
    return bool((gap < LARGEST_GAP * extent).all() and extent[1] > LEAST_WIDTH_M)


def _round(placed, index, fewest):
    """Those of a group's points that lie on one pole; None where too few."""
    if len(index) < fewest:
        return None
    misfit = pole_misfit(placed[index])[0]
    if sigma_mad(misfit) > 0.02:
        return None
    return index[near_own(misfit)]
