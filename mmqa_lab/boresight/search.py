"""The search for features: planes, poles and control points that several drives or heads show."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_points
from mmqa_lab.boresight.features import Feature, group_planes, pole_misfit
from mmqa_lab.planes import fit_plane, sigma_mad

PATCH_GAP_M = 0.3
"""Planes of one cube that lie farther apart, or turned by 5 degrees, are different things."""

OUTLIER = 3.5
"""Points so many sigma_MAD from their own group's plane or circle are left out."""


def shared_planes(samples, groups, *, cell, most, roughness, rng):
    """Planes that two or more groups show around one place.

    Cubes only say where to look: a plane along the side of a cube is cut by it according to the
    noise, so points are taken from a ball around the middle.
    """
    from scipy.spatial import cKDTree

    placed = samples["placed"]
    seeds = _seeds(placed, groups, cell, roughness)
    seeds = seeds.iloc[rng.permutation(len(seeds))]
    sides = np.abs(seeds[["nx", "ny", "nz"]].to_numpy()).argmax(axis=1)
    centres = seeds[["x", "y", "z"]].to_numpy()
    taken = np.empty((0, 3))
    found = []
    tree = cKDTree(placed)
    for k in _by_turns(sides):
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


def shared_poles(samples, groups, poles, origin, search=0.5, low=0.4, high=6.0, fewest=12):
    """Poles that two or more groups show."""
    if poles is None:
        return []
    from scipy.spatial import cKDTree

    placed = samples["placed"]
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
            start = _first_axis(placed[joined])
            found.append(Feature("pole", joined, start))
    return found


def known_heights(samples, control, origin, radius=0.3, fewest=12):
    """Heights of the ground at points where it is known."""
    if control is None:
        return []
    from scipy.spatial import cKDTree

    known = check_points(control, name="control") - origin
    placed = samples["placed"]
    near = cKDTree(known[:, :2])
    gap, which = near.query(placed[:, :2], distance_upper_bound=radius)
    close = np.isfinite(gap)
    close[close] = np.abs(placed[close, 2] - known[which[close], 2]) < 0.3
    order = np.flatnonzero(close)[np.argsort(which[close], kind="stable")]
    found = []
    for run in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
        if len(run) >= fewest:
            found.append(Feature("control", run, known[which[run[0]]]))
    return found


def _seeds(placed, groups, cell, roughness):
    """Cubes in which two or more groups each show a plane: a row of the first group of each."""
    planes = _planes_by_cube(placed, groups, cell)
    flat = (planes["rms"] <= roughness) & (planes["narrow"] >= 5 * planes["rms"])
    planes = planes[flat & (planes["narrow"] >= 0.1)]
    shared = planes.groupby("cube")["n"].transform("size") > 1
    return planes[shared].drop_duplicates("cube")


def _common_plane(placed, near, group, roughness, rng, fewest=15):
    """Points of the groups that show one plane there; None where fewer than two do."""
    members, planes = [], []
    for name in np.unique(group):
        run = near[group == name]
        if len(run) < fewest:
            continue
        plane = fit_plane(placed[run])
        if plane.rms <= roughness:
            members.append(run)
            planes.append(plane)
    if len(members) < 2:
        return None
    best = max(range(len(members)), key=lambda k: len(members[k]))
    alike = [
        _inliers(run, plane, rng)
        for run, plane in zip(members, planes, strict=True)
        if abs(plane.normal @ planes[best].normal) > np.cos(np.radians(5))
        and abs(planes[best].distances(plane.centre[None])[0]) < PATCH_GAP_M
    ]
    return np.concatenate(alike) if len(alike) > 1 else None


def _planes_by_cube(placed, groups, cell, fewest=20):
    """Table of the regression planes of the points of each cube and group."""
    cube = np.floor(placed / cell).astype(np.int64)
    cube -= cube.min(axis=0)
    size = cube.max(axis=0) + 1
    number = (cube[:, 0] * size[1] + cube[:, 1]) * size[2] + cube[:, 2]
    order = np.lexsort((groups, number))
    key = number[order] * (groups.max() + 1) + groups[order]
    starts = np.append(0, np.flatnonzero(np.diff(key)) + 1)
    n = np.diff(np.append(starts, len(order)))
    centre, variance, axes, _ = group_planes(placed[order], n)
    table = pd.DataFrame(centre, columns=["x", "y", "z"])
    table[["nx", "ny", "nz"]] = axes[:, :, 0]
    table["rms"], table["narrow"] = np.sqrt(variance[:, :2]).T
    table["cube"], table["n"] = number[order][starts], n
    return table[table["n"] >= fewest]


def _inliers(run, plane, rng, share=100):
    """Some of a group's points, those off their own plane left out."""
    keep = np.abs(plane.residuals) <= OUTLIER * max(sigma_mad(plane.residuals), 1e-6)
    run = run[keep]
    return rng.choice(run, min(len(run), share), replace=False)


def _by_turns(sides):
    """Numbers in turns over the sides: the first of each, the second of each, ..."""
    place = pd.Series(sides).groupby(sides).cumcount().to_numpy()
    return np.lexsort((sides, place))


def _round(placed, index, fewest):
    """Those of a group's points that lie on one pole; None where too few."""
    if len(index) < fewest:
        return None
    axis = _first_axis(placed[index])
    misfit = pole_misfit(placed[index], axis)[0]
    keep = np.abs(misfit) <= OUTLIER * max(sigma_mad(misfit), 1e-6)
    if keep.sum() < fewest or sigma_mad(misfit) > 0.02:
        return None
    return index[keep]


def _first_axis(points):
    """Upright axis to begin with: x, y, tilt x, tilt y, radius at the mean height."""
    middle = np.median(points[:, :2], axis=0)
    spread = np.median(np.hypot(*(points[:, :2] - middle).T))
    return np.array([*middle, 0.0, 0.0, max(spread, 0.03)])
