"""Boresight and lever arm of scan heads, estimated from drives in both directions.

The effect of a mounting error changes its sign with the direction of travel. So a wall seen on the
way there and on the way back lies in two places. Planes and poles that several drives or heads have
seen are fitted, and the mounting that makes them thinnest is estimated. EuroSDR 2013, mobile laser
scanning, section 3.3.3, names the objects that show each error: the ground for roll, poles and
corners for pitch and heading. The least-squares adjustment is our own. Start here::

    from mmqa_lab.boresight import calibrate

    found = calibrate(drives, lever_arms_m=assumed, poles=poles, control=levelled_points)
    found.table                                        # estimates with standard errors
    [found.correct(cloud, path) for cloud, path in drives]

Signs are those of ``simulate``: vehicle frame x right, y travel, z up; boresight rolls about y,
pitches about x and heads about -z, so that the true beam is R(boresight) times the assumed one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import null_space
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from mmqa_lab._checks import check_choice, check_columns, check_points
from mmqa_lab._results import Shown, sentences
from mmqa_lab.cloud import Cloud, group_axes
from mmqa_lab.planes import fit_circle, sigma_mad
from mmqa_lab.rotations import rotations

__all__ = ["LEAST_POINTS", "Calibration", "calibrate", "corrected"]

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Parameters of each head: boresight, and corrections to the assumed lever arm."""

UNIT = np.array([180 / np.pi] * 3 + [1.0] * 3)
"""Factors from radians and metres to the units of the parameters."""

TURN_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Axes of roll, pitch and heading."""

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
    remarks : str
        Errors that the intervals do not contain.
    """

    table: pd.DataFrame
    lever_arms_m: np.ndarray
    remarks: str = ""

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
        return self.table.assign(remarks=self.remarks)

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
        shots = _Shots.of(cloud[rows], trajectory, lever, origin)
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
    >>> found.table.loc[heading, "value"].round(2).tolist()
    [0.3]
    """
    lever = check_points(np.atleast_2d(lever_arms_m), name="lever_arms_m")
    longest = np.linalg.norm(lever, axis=1).max()
    if longest > 10:  # not in metres, or from another point
        raise ValueError(f"Invalid lever_arms_m: {longest:.1f} m long. Must be at most 10 m.")
    if not drives:
        raise ValueError("Invalid drives: none given. Must be one or more.")
    kept = np.isin(PARAMETERS, [check_choice(name, "keep", PARAMETERS) for name in keep])
    free, rng = np.tile(~kept, len(lever)), np.random.default_rng(0)
    origin = drives[0][0].points.mean(axis=0).round()
    shots = _Shots.sampled(drives, lever, origin, rng)
    level = control is None
    control = np.empty((0, 3)) if level else check_points(control, name="control") - origin
    values = np.zeros((len(lever), len(PARAMETERS)))
    group = shots.drive * len(lever) + shots.head
    for _ in range(2):  # features are looked for again with the better mounting
        placed = shots.placed(values)
        kinds = [
            _OnPlanes(shots, _planes(placed, group, patches, rng)),
            _OnPoles(shots, _poles(placed, group, poles, origin)),
            _OnGround(shots, _heights(placed, control)),
        ]
        adjustment = _Adjustment(kinds, free, level)
        values = adjustment.solved(values)
    return _result(adjustment, values, lever, path_std_m, path_std_deg)


@dataclass(frozen=True, eq=False)
class _Shots:
    """The data of points: head, drive, place and attitude of the vehicle, lever arm, beam."""

    head: np.ndarray
    drive: np.ndarray
    place: np.ndarray
    rotation: np.ndarray
    arm: np.ndarray
    beam: np.ndarray

    @classmethod
    def of(cls, cloud, trajectory, lever, origin, drive=0):
        """The shots of a cloud; places count from the origin."""
        head = cloud["head"].astype(int) if "head" in cloud else np.zeros(len(cloud), dtype=int)
        name, wrong = f"cloud {cloud.name or drive + 1}", (head < 0) | (head >= len(lever))
        if wrong.any():
            raise ValueError(
                f"Invalid head {head[wrong][0]} of {name}. Must be 0 to {len(lever) - 1}: heads "
                "count from 0, with one lever arm each."
            )
        check_columns(dict.fromkeys(cloud.columns), ("gps_time",), name)
        try:
            position, rotation = trajectory.at(np.asarray(cloud["gps_time"], dtype=np.float64))
        except ValueError as error:
            raise ValueError(f"Invalid {name}: {str(error).removeprefix('Invalid ')}") from None
        beam = np.einsum("nij,ni->nj", rotation, cloud.points - position) - lever[head]
        drives = np.full(len(cloud), drive)
        return cls(head, drives, position - origin, rotation, lever[head], beam)

    @classmethod
    def sampled(cls, drives, lever, origin, rng):
        """The shots of all drives, at most a million of each cloud, at random."""
        parts = []
        for number, (cloud, path) in enumerate(drives):
            rows = np.sort(rng.permutation(len(cloud))[:1_000_000])
            parts.append(cls.of(cloud[rows], path, lever, origin, number))
            time = cloud["gps_time"]
            if time.min() == time.max():
                raise ValueError(
                    f"Invalid gps_time of cloud {cloud.name or number + 1}: all {time[0]} s. "
                    "Must be the time of each point."
                )
        columns = ([getattr(part, field.name) for part in parts] for field in fields(cls))
        return cls(*map(np.concatenate, columns))

    def select(self, which):
        """The shots of a mask or of row numbers."""
        return _Shots(*(getattr(self, field.name)[which] for field in fields(self)))

    def inside(self, values):
        """Beams as the heads' boresight turns them, and points, both in the vehicle's frame."""
        beam = np.einsum("nij,nj->ni", rotations(*values[:, :3].T)[self.head], self.beam)
        return beam, beam + self.arm + values[self.head, 3:]

    def placed(self, values):
        """Points from the origin; ``values`` (heads, 6) in radians and metres."""
        return self.place + np.einsum("nij,nj->ni", self.rotation, self.inside(values)[1])

    def slopes(self, values, way):
        """Change of points along ``way`` (n, 3) by heads (6 h columns), then by paths (6 d).

        A path's error lasts its whole drive: place (east, north, height) and angles.
        """
        beam, point = self.inside(values)
        across = np.einsum("nij,ni->nj", self.rotation, way)
        own = np.hstack([np.cross(beam, across) @ TURN_AXES.T, across])
        paths = np.hstack([way, np.cross(point, across) @ TURN_AXES.T])
        heads, count = len(values), self.drive.max() + 1
        table = np.zeros((len(way), heads + count, 6))
        rows = np.arange(len(way))
        table[rows, self.head], table[rows, heads + self.drive] = own, paths
        return table.reshape(len(way), -1)


def _planes(placed, group, most, rng):
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


def _heights(placed, control):
    """Points around control points, with the known heights."""
    gap, which = cKDTree(control[:, :2]).query(placed[:, :2], distance_upper_bound=CONTROL_M)
    index = np.flatnonzero(np.isfinite(gap))
    index = index[np.abs(placed[index, 2] - control[which[index], 2]) < CONTROL_M]
    parts = pd.Series(index).groupby(which[index])
    return [(part.to_numpy(), control[k, 2]) for k, part in parts if len(part) >= LEAST_POINTS]


def _poles(placed, group, poles, origin):
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


class _OnPlanes:
    """Points on features of the same kind, here planes, feature by feature.

    ``scatter`` has a typical value until the misfits are known.
    """

    scatter = 0.005

    def __init__(self, shots, features):
        self.known = [known for _, known in features]
        self.of = np.repeat(np.arange(len(features)), [len(index) for index, _ in features])
        index = [index for index, _ in features]
        self.shots = shots.select(np.concatenate([np.empty(0, int), *index]))

    @property
    def starts(self):
        """First row of each feature that still has points."""
        return np.flatnonzero(np.diff(self.of, prepend=-1))

    def rows(self, values):
        """Misfit, slopes (see ``_Shots.slopes``) and number of the feature of each row.

        The parameters of the features are eliminated.
        """
        n, off, _, variance, axes = group_axes(self.shots.placed(values), self.starts)
        off = np.einsum("ni,nij->nj", off, np.repeat(axes, n, axis=0))
        slopes = self.shots.slopes(values, np.repeat(axes[:, :, 0], n, axis=0))
        for k in range(3):  # offset and two tilts: from the centre they are orthogonal
            size = n if k == 0 else n * np.maximum(variance[:, k], 1e-12)
            column = (np.ones(len(off)) if k == 0 else off[:, k])[:, None]
            share = np.add.reduceat(column * slopes, self.starts) / size[:, None]
            slopes -= column * np.repeat(share, n, axis=0)
        return off[:, 0], slopes, self.of

    def keep(self, good):
        """Leave out the points of the other rows."""
        self.shots, self.of = self.shots.select(good), self.of[good]


class _OnPoles(_OnPlanes):
    """Points on cylinders with known outward normals and, if given, known radii.

    The normals belong to the circle of each drive and head, since two arcs of a thin pole may have
    moved past each other.
    """

    def __init__(self, shots, features):
        super().__init__(shots, features)
        self.ways = np.concatenate([np.empty((0, 2)), *(known[0] for known in self.known)])

    def rows(self, values):
        points = self.shots.placed(values)
        misfit = (self.ways * points[:, :2]).sum(axis=1)
        slopes = self.shots.slopes(values, np.pad(self.ways, ((0, 0), (0, 1))))
        both = np.column_stack([misfit, slopes])
        for run in np.split(np.arange(len(points)), self.starts[1:]):
            way, radius = self.ways[run], self.known[self.of[run[0]]][1]
            height = points[run, 2:] - points[run, 2].mean()
            own = np.hstack([way, height * way, np.ones((len(run), 1))])
            basis = np.linalg.qr(own[:, : 4 if radius else 5])[0]
            both[run, 0] -= radius or 0.0
            both[run] -= basis @ (basis.T @ both[run])
        return both[:, 0], both[:, 1:], self.of

    def keep(self, good):
        super().keep(good)
        self.ways = self.ways[good]


class _OnGround(_OnPlanes):
    """Points around control points of known height; a row per control point."""

    scatter = 0.01

    def rows(self, values):
        numbers, n = np.unique(self.of, return_counts=True)
        up = np.tile([0.0, 0.0, 1.0], (len(self.of), 1))
        both = np.hstack([self.shots.placed(values)[:, 2:], self.shots.slopes(values, up)])
        both = np.add.reduceat(both, self.starts) / n[:, None]
        return both[:, 0] - np.take(self.known, numbers), both[:, 1:], numbers

    def keep(self, good):
        super().keep(np.repeat(good, np.unique(self.of, return_counts=True)[1]))


class _Adjustment:
    """Least squares of the misfits of all kinds, each over its scatter."""

    def __init__(self, kinds, free, level):
        self.kinds = [kind for kind in kinds if len(kind.of)]
        self.ways = np.eye(len(free))[:, free]
        if level and free[5]:  # the mean of z_m stays 0
            self.ways = self.ways @ null_space(self.ways[5::6].sum(axis=0, keepdims=True))

    def system(self, values):
        """Misfits and slopes by free parameters and by paths, and the feature of each row."""
        parts, last = [], 0
        for kind in self.kinds:
            misfit, slopes, of = kind.rows(values)
            parts.append((misfit / kind.scatter, slopes / kind.scatter, last + of))
            last += len(kind.known)
        misfit, slopes, of = map(np.concatenate, zip(*parts, strict=True))
        return misfit, slopes[:, : values.size] @ self.ways, slopes[:, values.size :], of

    def solved(self, values):
        """The mounting (heads, 6); after each turn, misfits beyond 3.5 sigma_MAD are left out."""
        parameters = self.ways.T @ values.ravel()
        for turn in range(3):  # misfits leave in between
            for kind in self.kinds if turn else []:
                misfit = kind.rows(values)[0]
                kind.scatter = max(sigma_mad(misfit), 1e-6)
                kind.keep(np.abs(misfit) <= 3.5 * kind.scatter)  # the rule for outliers
            parameters = self._fitted(parameters)
            values = self.values(parameters)
        return values

    def _fitted(self, parameters):
        """Parameters of the least misfits; a place is asked for misfits, then for slopes."""
        at = lru_cache(1)(lambda p: self.system(self.values(np.array(p))))
        return least_squares(
            lambda p: at(tuple(p))[0],
            parameters,
            lambda p: at(tuple(p))[1],
            x_scale="jac",
            xtol=1e-5,
            ftol=1e-6,
            max_nfev=20,
        ).x

    def values(self, parameters):
        """Array (heads, 6), 0 for kept parameters."""
        return (self.ways @ parameters).reshape(-1, len(PARAMETERS))

    def variance(self, values, path_std):
        """Variances of all parameters, and their degrees of freedom.

        V = sum_g u_g u_g' with u_g = N^-1 (I - N_g N^-1)^-1 J_g' r_g: each feature g contributes
        its misfits r_g from the mounting that all other features give (CR3 of Bell and McCaffrey
        2002, a jackknife). J_g are its slopes, N_g = J_g' J_g its part of the normal matrix N. The
        degrees of freedom of a variance are the number of features that would have the same
        variance with equal shares.
        """
        misfit, slopes, paths, of = self.system(values)
        self._refuse_open(slopes)
        starts = np.flatnonzero(np.diff(of, prepend=-1))
        gradients = np.add.reduceat(slopes * misfit[:, None], starts)
        normals = np.array([part.T @ part for part in np.split(slopes, starts[1:])])
        inverse = np.linalg.inv(slopes.T @ slopes)
        without = np.eye(len(inverse)) - normals @ inverse
        influence = self.ways @ inverse @ np.linalg.solve(without, gradients[..., None])[..., 0].T
        solver = self.ways @ inverse
        share = np.einsum("ij,gjk,ik->gi", solver, normals, solver)
        of_paths = solver @ slopes.T @ (paths * np.tile(path_std, paths.shape[1] // 6))
        of_points = (influence**2).sum(axis=1)
        variance = of_points + (of_paths**2).sum(axis=1)
        with np.errstate(invalid="ignore"):  # of kept parameters
            students = share.sum(axis=0) ** 2 / (share**2).sum(axis=0)
            return variance, students * (variance / of_points) ** 2

    def _refuse_open(self, slopes):
        """Refuse a mounting with parameters that can change together without any effect."""
        lengths = np.maximum(np.linalg.norm(slopes, axis=0), np.finfo(float).tiny)
        _, size, ways = np.linalg.svd(slopes / lengths, full_matrices=False)
        if size[-1] < 1e-4:  # of the scaled Jacobian: this combination is open
            raise _stay_open(np.abs(self.ways @ ways[-1]) > 0.1)


def _stay_open(which):
    """The error that names the parameters that the drives do not determine."""
    names = [f"{PARAMETERS[k % 6]} of head {k // 6 + 1}" for k in np.flatnonzero(which)]
    return ValueError(
        f"Invalid drives: {' with '.join(names)} stays open. Must run in both directions past "
        "walls, poles and control points, or keep one of these as assumed."
    )


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
        raise _stay_open(wild)
    half = np.where(std > 0, stdtrit(students, 0.975) * std, np.nan)
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
    return Calibration(pd.DataFrame(table), lever, " ".join(remarks))
