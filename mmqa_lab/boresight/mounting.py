"""The mounting of scan heads, estimated from what several drives or heads have seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_choice, check_columns, check_count, check_number, check_points
from mmqa_lab._results import Shown, sentences
from mmqa_lab.boresight.adjustment import (
    PARAMETERS,
    Adjustment,
    OnGround,
    OnPlanes,
    OnPoles,
    Shots,
    stay_open,
)
from mmqa_lab.cloud import Cloud, group_axes
from mmqa_lab.planes import fit_circle
from mmqa_lab.stats import student_reach

__all__ = [
    "LEAST_POINTS", "Calibration", "calibrate", "corrected", "planes_in_common",
    "points_at_control", "poles_in_common",
]  # fmt: skip


UNIT = np.array([180 / np.pi] * 3 + [1.0] * 3)
"""Factors from radians and metres to the units of the parameters."""

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


@dataclass(frozen=True, eq=False)
class Calibration(Shown):
    """The estimated mounting of the heads.

    Parameters
    ----------
    table : DataFrame
        A row per head and parameter: ``head``, ``parameter``, ``value``, ``std`` (0 if the
        parameter was kept), and the 95 % confidence interval ``low`` and ``high`` by Student's t
        (NaN if kept). The degrees of freedom count the features that matter (Satterthwaite). They
        contain the scatter between features (cluster-robust), also of planes that are not quite
        flat, and stated errors of the paths.
    lever_arms_m : array, shape (h, 3)
        Assumed lever arms, m.
    remarks : tuple of str
        Errors that the intervals do not contain.
    """

    table: pd.DataFrame
    lever_arms_m: np.ndarray
    remarks: tuple[str, ...] = ()

    @property
    def values(self) -> np.ndarray:
        """Array (heads, 6) of the estimates, degrees and metres."""
        return self.table["value"].to_numpy().reshape(-1, len(PARAMETERS))

    def _ends(self):
        table = self.table
        names = table["parameter"] + " of head " + table["head"].astype(str)
        units = np.where(table["parameter"].str.endswith("_deg"), "deg", "m")
        return zip(names, table["value"], table["low"], table["high"], units, strict=True)

    def to_frame(self) -> pd.DataFrame:
        """Return the table, in degrees and metres, with the remarks."""
        return self.table.assign(remarks=" ".join(self.remarks))

    def correct(self, cloud: Cloud, trajectory: Any) -> Cloud:
        """Return the cloud of a drive with the estimated mounting, see :func:`corrected`."""
        return corrected(cloud, trajectory, lever_arms_m=self.lever_arms_m, values=self.values)


def corrected(
    cloud: Cloud, trajectory: Any, *, lever_arms_m: ArrayLike, values: ArrayLike
) -> Cloud:
    """Return a cloud computed with another mounting of its heads.

    Parameters
    ----------
    cloud : Cloud
        Computed with the assumed mounting; has ``gps_time`` and, for several heads, ``head``.
    trajectory
        The path that the cloud was computed with.
    lever_arms_m : array_like, shape (h, 3)
        Assumed lever arms, m.
    values : array_like, shape (h, 6)
        Boresight (degrees) of each head, and correction of its lever arm (m).

    Returns
    -------
    Cloud

    Examples
    --------
    >>> from mmqa_lab.simulate import straight
    >>> cloud = Cloud(np.array([[3.0, 5.0, 0.0]]), {"gps_time": np.array([0.5])})
    >>> raised = {"lever_arms_m": [[0, 0, 2]], "values": [[0, 0, 0, 0, 0, 0.1]]}
    >>> corrected(cloud, straight(20, 10), **raised).points.round(6).tolist()
    [[3.0, 5.0, 0.1]]
    """
    lever, values = np.asarray(lever_arms_m, np.float64), np.asarray(values, np.float64) / UNIT
    points = cloud.points.copy()
    origin = points[0].round() if len(points) else np.zeros(3)
    for rows in np.array_split(np.arange(len(points)), len(points) // 200_000 + 1):
        shots = Shots.of(cloud[rows], trajectory, lever, origin)
        points[rows] = origin + shots.placed(values)
    return replace(cloud, points=points)


def calibrate(
    drives: Sequence[tuple[Cloud, Any]],
    *,
    lever_arms_m: ArrayLike,
    poles: pd.DataFrame | None = None,
    control: ArrayLike | None = None,
    keep: Sequence[str] = (),
    patches: int = 500,
    path_std_m: ArrayLike | None = None,
    path_std_deg: ArrayLike | None = None,
) -> Calibration:
    """Estimate boresight and lever arm of every head from planes and poles seen several times.

    A plane that two drives or heads show in a ball becomes a patch. The mounting is estimated by
    least squares from three kinds of misfits: distances of points from the plane of their patch,
    distances from the cylinder of their pole, and mean heights around control points. The
    parameters of planes and poles are eliminated. Each kind is weighted by its scatter. Misfits
    beyond 3.5 sigma_MAD of their kind are left out as outliers. Then patches are selected again
    with the estimated mounting.

    Parameters
    ----------
    drives : sequence of (Cloud, trajectory)
        Clouds with ``gps_time`` and, for several heads, ``head``, each with its path. A path has
        ``at(times)`` like ``simulate.Trajectory``.
    lever_arms_m : array_like, shape (h, 3)
        Lever arms that were assumed when the clouds were computed, m.
    poles : DataFrame, optional
        Approximate ``x_m``, ``y_m``, ``z_m`` of feet, and ``diameter_m`` if it is known to
        millimetres. A wrong diameter pulls the two sides of a pole together or apart.
    control : array_like, shape (m, 3), optional
        Ground points with known heights. Without them a height error of all heads cannot be told
        from the height of the ground, and the mean of z_m is kept at 0.
    keep : sequence of str
        Parameters (``roll_deg``, ``pitch_deg``, ``heading_deg``, ``x_m``, ``y_m``, ``z_m``) that
        keep their assumed values in all heads, because the drives do not determine them.
    patches : int
        Largest number of patches, shared between directions of their normals.
    path_std_m, path_std_deg : float or array_like, shape (3,), optional
        Standard deviations of errors of the paths that last a whole drive: east, north, height, m;
        roll, pitch, heading, degrees; 0 for exact paths. They enter the covariance. Without them a
        remark states that the intervals do not contain these errors.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If a head has no lever arm, times are all the same or outside the path's, there are no
        common planes, a lever arm is longer than 10 m, or the mounting is not
        determined, for example because no control point lies on the clouds' ground: the sentence
        names the parameters that stay open.

    Notes
    -----
    An error of a path that lasts a whole drive has the same effect as a lever-arm error of opposite
    sign in the other direction. Two drives along one street cannot tell them apart.

    If the radius is free, range noise of 5 mm pushes the two sides of a pole of 6 cm apart by
    2.5 mm. The standard errors do not contain this error. With the known radius it is 0.4 mm.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scanner, System
    >>> from mmqa_lab.simulate.test_field import drive_test_field, make_test_field
    >>> tilt = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.0, 0.3)}
    >>> head = Scanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **tilt)
    >>> street = make_test_field(length_m=40, seed=1)
    >>> system = System("one head", (head,))
    >>> drives = drive_test_field(street, system, seed=4, pulses_per_s=20_000)
    >>> known = {"lever_arms_m": system.assumed_lever_arms, "poles": street.poles}
    >>> found = calibrate(drives, **known, patches=100)
    >>> heading = found.table["parameter"] == "heading_deg"
    >>> found.table.loc[heading, "value"].round(1).tolist()
    [0.3]
    """
    lever = check_points(np.atleast_2d(lever_arms_m), name="lever_arms_m")
    patches = check_count(patches, "patches")
    paths = {"path_std_m": path_std_m, "path_std_deg": path_std_deg}
    for name, std in paths.items():
        for one in () if std is None else np.ravel(std):
            check_number(float(one), name, low=0)
    if poles is not None:
        check_columns(poles, ("x_m", "y_m", "z_m"), "poles")
    longest = np.linalg.norm(lever, axis=1).max()
    if longest > 10:  # not in metres, or from another point
        raise ValueError(f"Invalid lever_arms_m: {longest:.1f} m long. Must be at most 10 m.")
    if not drives:
        raise ValueError("Invalid drives: none given. Must be one or more.")
    kept = np.isin(PARAMETERS, [check_choice(name, "keep", PARAMETERS) for name in keep])
    free, rng = np.tile(~kept, len(lever)), np.random.default_rng(0)
    origin = check_points(drives[0][0].points, name="cloud 1").mean(axis=0).round()
    shots = Shots.sampled(drives, lever, origin, rng)
    level = control is None
    control = np.empty((0, 3)) if level else check_points(control, name="control") - origin
    values = np.zeros((len(lever), len(PARAMETERS)))
    group = shots.drive * len(lever) + shots.head
    for _ in range(2):  # features are looked for again with the better mounting
        placed = shots.placed(values)
        kinds = [
            OnPlanes(shots, planes_in_common(placed, group, patches, rng)),
            OnPoles(shots, poles_in_common(placed, group, poles, origin)),
            OnGround(shots, points_at_control(placed, control)),
        ]
        adjustment = Adjustment(kinds, free, level)
        values = adjustment.solved(values)
    return _result(adjustment, values, lever, path_std_m, path_std_deg)


def _result(adjustment, values, lever, path_std_m, path_std_deg):
    """The result with its covariance and remarks."""
    given = {"positions": path_std_m, "attitudes": path_std_deg}
    missing = " and ".join(name for name, std in given.items() if std is None)
    path_std = np.zeros(6)
    path_std[:3], path_std[3:] = (0.0 if std is None else std for std in given.values())
    variance, students = adjustment.variance(values, path_std / UNIT[::-1])
    unit, limits = np.tile(UNIT, len(values)), np.repeat([10.0, 1.0], 3)  # beyond: no estimate
    std, value = np.sqrt(variance) * unit, values.ravel() * unit
    wild = np.maximum(np.abs(value), std) > np.tile(limits, len(values))
    if wild.any():
        raise stay_open(wild)
    half = np.where(std > 0, student_reach(std, students), np.nan)
    table = {"head": np.repeat(np.arange(len(values)), 6), "parameter": PARAMETERS * len(values)}
    table |= {"value": value, "std": std, "low": value - half, "high": value + half}
    ways = pd.DataFrame(adjustment.kinds[0].shots.rotation[:, :2, 1])
    ways = ways.groupby(adjustment.kinds[0].shots.drive).mean().to_numpy()
    remarks = sentences(
        (missing, f"Errors of the paths' {missing} are not given: the intervals lack them."),
        (
            (ways @ ways.T).min() > 0,
            "All drives run in one direction: an error of the mounting and one of the path look "
            "alike there, so do not rely on these values.",
        ),
    )
    return Calibration(pd.DataFrame(table), lever, remarks)


def planes_in_common(placed, group, most, rng):
    """Return planes that two or more groups show in the same ball.

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
    """Return points around control points, with the known heights."""
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
