"""What several drives or heads have seen: planes, poles, ground at control points."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab.cloud import group_axes
from mmqa_lab.planes import fit_circle

__all__ = ["LEAST_POINTS", "planes_in_common", "points_at_control", "poles_in_common"]


CELL_M = 1.0
"""Diameter of the balls in which planes are looked for."""


ROUGHNESS_M, SAME_M, SAME_DEG = 0.03, 0.3, 5.0
"""Largest roughness, distance and angle between planes of a ball that are the same surface."""


LEAST_POINTS, MOST_POINTS = 15, 100
"""Least and largest number of points of a drive's head on a plane; least number on a pole."""


POLE_REACH_M, POLE_HEIGHTS_M, POLE_GATE_M = 0.5, (0.4, 6.0), 0.05
"""Points of a pole: distance in plan, heights above its foot, and distance from its circle."""


CONTROL_M = 0.3
"""Largest distance, in plan and in height, of ground points from a control point."""


def planes_in_common(placed, group, most, rng):
    """Planes that two or more groups show in the same ball.

    Cubes only give the centres of the balls. The points of a plane along the side of a cube would
    be selected by their noise.
    """
    cube = np.floor(placed / CELL_M).astype(np.int64)
    cube = np.ravel_multi_index((cube - cube.min(axis=0)).T, np.ptp(cube, axis=0) + 1)
    seeds = _shared(placed, cube, group).drop_duplicates("place").sample(frac=1, random_state=rng)
    seeds = seeds.iloc[seeds.groupby("side").cumcount().argsort(kind="stable")]  # sides by turns
    centres = np.empty((0, 3))
    for centre in seeds["centre"]:
        if (np.abs(centres - centre).max(axis=1) >= 0.7 * CELL_M).all() and len(centres) < most:
            centres = np.vstack([centres, centre])
    balls = cKDTree(placed).query_ball_point(centres, CELL_M / 2)
    index = np.concatenate([*map(rng.permutation, balls)])
    ball = np.repeat(np.arange(len(balls)), [len(ball) for ball in balls])
    places = _shared(placed[index], ball, group[index]).groupby("place")["rows"]
    return [(index[np.concatenate(rows.tolist())], None) for _, rows in places]


def _shared(points, place, group):
    """Planes of the groups of points at each place if two or more groups show the same plane."""
    order = np.lexsort((group, place))
    starts = np.flatnonzero(np.diff(np.stack([place, group])[:, order], prepend=-1).any(axis=0))
    n, _, centre, variance, axes = group_axes(points[order], starts)
    rough, width = np.sqrt(variance[:, :2]).T
    flat = (n >= LEAST_POINTS) & (rough <= ROUGHNESS_M) & (width >= np.maximum(5 * rough, 0.1))
    flat = np.flatnonzero(flat)
    flat = flat[np.lexsort((-n[flat], place[order][starts[flat]]))]  # the largest group first
    where, centre, normal = place[order][starts[flat]], centre[flat], axes[flat, :, 0]
    first = np.unique(where, return_index=True, return_inverse=True)
    best = first[1][first[2]]
    same = np.abs((normal * normal[best]).sum(axis=1)) > np.cos(np.radians(SAME_DEG))
    same &= np.abs(((centre - centre[best]) * normal[best]).sum(axis=1)) < SAME_M
    columns = {"place": where, "side": np.abs(normal).argmax(axis=1), "centre": list(centre)}
    rows = [
        order[k : k + min(many, MOST_POINTS)] for k, many in zip(starts[flat], n[flat], strict=True)
    ]
    table = pd.DataFrame(columns | {"rows": rows})[same]
    table = table[table["place"].duplicated(keep=False)]
    if table.empty:
        raise ValueError(f"Invalid drives: no planes in common within {CELL_M} m. Must overlap.")
    return table


def points_at_control(placed, control):
    """Points around control points, with the known heights."""
    gap, which = cKDTree(control[:, :2]).query(placed[:, :2], distance_upper_bound=CONTROL_M)
    index = np.flatnonzero(np.isfinite(gap))
    index = index[np.abs(placed[index, 2] - control[which[index], 2]) < CONTROL_M]
    parts = pd.Series(index).groupby(which[index])
    return [(part.to_numpy(), control[k, 2]) for k, part in parts if len(part) >= LEAST_POINTS]


def poles_in_common(placed, group, poles, origin):
    """Poles that two or more groups show: points, with outward normals and a known radius."""
    tree, found = cKDTree(placed[:, :2]), []
    for pole in [] if poles is None else poles.to_dict("records"):
        foot = np.array([pole["x_m"], pole["y_m"], pole["z_m"]]) - origin
        index = np.array(tree.query_ball_point(foot[:2], POLE_REACH_M), dtype=int)
        above = placed[index, 2] - foot[2]
        index = index[(above > POLE_HEIGHTS_M[0]) & (above < POLE_HEIGHTS_M[1])]
        diameter = pole["diameter_m"] if pole.get("diameter_m", 0) > 0 else None
        parts = []
        for part in (index[group[index] == name] for name in np.unique(group[index])):
            if len(part) < LEAST_POINTS:
                continue
            circle = fit_circle(placed[part, :2], diameter=diameter)
            off = placed[part, :2] - circle.centre
            away = np.hypot(*off.T)
            near = np.abs(away - circle.radius) < POLE_GATE_M
            if np.isfinite(circle.std) and near.sum() >= LEAST_POINTS:
                parts.append((part[near], off[near] / away[near, None]))
        if len(parts) > 1:
            index, ways = map(np.concatenate, zip(*parts, strict=True))
            found.append((index, (ways, diameter and diameter / 2)))
    return found
