"""Boresight and lever arm of scan heads, estimated from a drive in both directions.

What a mounting error does changes its sign with the direction of travel: a wall seen on the way
there and on the way back lies in two places. Planes and poles that several drives or heads have
seen are fitted, and the mounting is sought with which they are thinnest (EuroSDR 2013, mobile laser
scanning, chapter 3).

Signs are those of ``simulate``: vehicle frame x right, y travel, z up; boresight rolls about y,
pitches about x and heads about -z, so that the true beam is R(boresight) times the assumed one.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import fit_plane, sigma_mad

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Of each head: boresight, then what is to be added to the assumed lever arm."""

AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""About which roll, pitch and heading turn."""

SAMPLE = 2_000_000
"""Points of a cloud looked at in the search for planes; of larger clouds, so many at random."""

PATCH_GAP_M = 0.3
"""Planes of one cube that lie farther apart, or turned by 5 degrees, are different things."""

BAD_FEATURE = 3.0
"""Features whose points lie so many times farther off than is usual for their kind are left out."""

OUTLIER = 3.5
"""Points so many sigma_MAD from their own group's plane or circle are left out."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The mounting of the heads as estimated.

    Parameters
    ----------
    table : DataFrame
        One row a head and parameter: ``head``, ``parameter`` (see ``PARAMETERS``), ``value``,
        ``std``.
    covariance : array, shape (6 h, 6 h)
        In the order of the table, degrees and metres; from the scatter of what the features say
        (cluster-robust), so that planes that are not quite flat count in.
    sigma0_m : float
        Standard deviation of a point's distance from its plane or pole.
    n, planes, poles, control : int
        Points, and the planes, poles and control points they lie on.
    lever_arms_m : array, shape (h, 3)
        As assumed.
    """

    table: pd.DataFrame
    covariance: np.ndarray
    sigma0_m: float
    n: int
    planes: int
    poles: int
    control: int
    lever_arms_m: np.ndarray

    @property
    def values(self):
        """Array (heads, 6) of the estimates, degrees and metres."""
        return self.table["value"].to_numpy().reshape(-1, len(PARAMETERS))

    @property
    def correlation(self):
        """Correlation matrix of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(std, std)

    def correct(self, cloud, trajectory):
        """Return a drive's cloud as the estimated mounting makes it.

        Parameters
        ----------
        cloud : Cloud
            With ``gps_time`` and, for several heads, ``head``; computed with the assumed mounting.
        trajectory
            The path it was computed from.
        """
        points = np.empty_like(cloud.points)
        heads = _heads(cloud)
        for first in range(0, len(cloud), 200_000):
            part = slice(first, first + 200_000)
            sample = _Sample.of(cloud.points[part], cloud["gps_time"][part], heads[part])
            sample.locate(trajectory, self.lever_arms_m)
            points[part] = sample.origin + sample.placed(_radians(self.values))
        return Cloud(points, cloud.columns, cloud.name)


@dataclass(eq=False)
class _Sample:
    """Points with what places them: time, head, pose of the vehicle, vector from the head."""

    points: np.ndarray
    time: np.ndarray
    head: np.ndarray
    origin: np.ndarray = None
    lever: np.ndarray = None
    offset: np.ndarray = None
    rotation: np.ndarray = None
    vector: np.ndarray = None

    @classmethod
    def of(cls, points, time, head):
        return cls(points, np.asarray(time, dtype=np.float64), np.asarray(head, dtype=int))

    @classmethod
    def joined(cls, samples):
        """Samples of several drives as one; all have the same origin."""
        names = ("points", "time", "head", "offset", "rotation", "vector")
        arrays = {name: np.concatenate([getattr(s, name) for s in samples]) for name in names}
        return cls(**arrays, origin=samples[0].origin, lever=samples[0].lever)

    def locate(self, trajectory, lever_arms, origin=None):
        """Find the vector from the head to each point, in the vehicle's frame."""
        position, self.rotation = trajectory.at(self.time)
        self.origin = position[0].round() if origin is None else origin
        self.lever = np.asarray(lever_arms, dtype=np.float64)
        self.offset = position - self.origin
        from_vehicle = (self.points - self.origin) - self.offset
        self.vector = np.einsum("nij,ni->nj", self.rotation, from_vehicle) - self.lever[self.head]

    def turned(self, values):
        """Vectors under a boresight, (n, 3); ``values`` (heads, 6) in radians and metres."""
        return np.einsum("nij,nj->ni", _rotations(values[:, :3])[self.head], self.vector)

    def placed(self, values):
        """Points from the origin under a mounting, (n, 3)."""
        inside = self.turned(values) + (self.lever + values[:, 3:])[self.head]
        return self.offset + np.einsum("nij,nj->ni", self.rotation, inside)

    def derivatives(self, values, normal):
        """Change of each point along ``normal`` (n, 3) by its own head's parameters, (n, 6)."""
        beam = self.turned(values)
        across = np.einsum("nij,ni->nj", self.rotation, normal)
        turns = np.stack([np.cross(axis, beam) for axis in AXES], axis=1)
        return np.hstack([np.einsum("nkj,nj->nk", turns, across), across])


def calibrate(
    drives,
    *,
    lever_arms_m,
    poles=None,
    control=None,
    cell=1.0,
    patches=500,
    roughness=0.03,
    seed=0,
    rounds=2,
):
    """Estimate boresight and lever arm of every head from planes and poles seen several times.

    The clouds are cut into cubes; where two drives or heads each show a plane in one, it becomes a
    patch. The mounting is found by least squares (scipy): distances of all points from the plane of
    their patch, from the cylinder of their pole, and heights over control points, where the
    patches' and poles' own parameters are eliminated. Patches are cut anew with each mounting
    found.

    Parameters
    ----------
    drives : sequence of (Cloud, trajectory)
        Clouds with ``gps_time`` and, for several heads, ``head``; each with the path it was
        computed from, which has ``at(times)`` as of ``simulate.Trajectory``.
    lever_arms_m : array_like, shape (h, 3)
        Of the heads, as assumed in the computation of the clouds.
    poles : DataFrame, optional
        ``x_m``, ``y_m``, ``z_m`` of feet, roughly.
    control : array_like, shape (m, 3), optional
        Points of the ground whose heights are known. Without them the heights of all heads
        together cannot be told from the ground's, and the mean of z_m is held at 0.
    cell : float
        Side of the cubes, m.
    patches : int
        Patches used at most, shared out over directions of their normals.
    roughness : float
        Largest rms deviation of a drive's points from their own plane, m.
    seed : int
        Of the choice of points.
    rounds : int
        How often patches are cut.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If there are no common planes, or they do not determine the mounting.

    Notes
    -----
    The trajectory is taken as true. An error of it that lasts a whole drive is the same as a
    lever-arm error of opposite sign in the other direction: two drives along one street cannot
    tell them apart, and the standard errors do not contain it.
    """
    lever = check_points(np.atleast_2d(lever_arms_m), name="lever_arms_m")
    check_positive(cell, "cell", unit="m")
    check_positive(roughness, "roughness", unit="m")
    if not drives:
        raise ValueError("Invalid drives: none given. Must be one or more.")
    origin = drives[0][0].points.mean(axis=0).round()
    rng = np.random.default_rng(seed)
    values = np.zeros((len(lever), len(PARAMETERS)))
    for _ in range(check_count(rounds, "rounds")):
        samples, groups = _drive_samples(drives, lever, origin, values, rng)
        features = _patches(samples, groups, cell, patches, roughness, rng)
        features += _pole_features(samples, groups, poles, origin)
        features += _control_features(samples, control, origin)
        if not any(feature.kind == "plane" for feature in features):
            raise ValueError(
                f"Invalid drives: no planes in common within cubes of {cell} m. Must overlap."
            )
        adjustment = _Adjustment.of(samples, features, drives, lever, origin, control is not None)
        found, values = adjustment.solved(values)
    return _calibration(adjustment, found, values, lever)


@dataclass(eq=False)
class _Feature:
    """What some points lie on: their numbers, and how they are measured against it."""

    kind: str
    index: np.ndarray
    start: np.ndarray = None

    def misfit(self, points):
        """Distances of points from the fitted feature, normals, derivatives by its parameters."""
        return {"plane": _plane_misfit, "pole": _pole_misfit, "control": _control_misfit}[
            self.kind
        ](points, self.start)


@dataclass(eq=False)
class _Adjustment:
    """The points of all features, and the least-squares problem."""

    sample: _Sample
    features: list
    absolute: bool
    last: tuple = None

    @classmethod
    def of(cls, samples, features, drives, lever, origin, absolute):
        """Take the features' points out of the samples and find their poses."""
        index = np.concatenate([feature.index for feature in features])
        starts = np.cumsum([0] + [len(feature.index) for feature in features])
        points, time, head, drive = (samples[name][index] for name in _COLUMNS)
        part = []
        order = np.argsort(drive, kind="stable")
        for number in range(len(drives)):
            of_drive = order[drive[order] == number]
            if len(of_drive):
                piece = _Sample.of(points[of_drive], time[of_drive], head[of_drive])
                piece.locate(drives[number][1], lever, origin)
                part.append(piece)
        sample = _Sample.joined(part)
        back = np.empty(len(order), dtype=int)
        back[order] = np.arange(len(order))
        features = [
            _Feature(f.kind, back[first:last], f.start)
            for f, first, last in zip(features, starts[:-1], starts[1:], strict=True)
        ]
        return cls(sample, features, absolute)

    def system(self, parameters):
        """Misfit of all points and its derivatives, the features' own parameters eliminated."""
        if self.last is not None and np.array_equal(self.last[0], parameters):
            return self.last[1:]
        values = parameters.reshape(-1, len(PARAMETERS))
        points = self.sample.placed(values)
        used = np.concatenate([feature.index for feature in self.features])
        misfit, normal = np.zeros(len(points)), np.zeros_like(points)
        own = []
        for feature in self.features:
            r, n, derivative = feature.misfit(points[feature.index])
            misfit[feature.index], normal[feature.index] = r, n
            own.append(derivative)
        jacobian = np.zeros((len(points), parameters.size))
        columns = self.sample.head[:, None] * len(PARAMETERS) + np.arange(len(PARAMETERS))
        derivatives = self.sample.derivatives(values, normal)
        np.put_along_axis(jacobian, columns, derivatives, axis=1)
        for feature, derivative in zip(self.features, own, strict=True):
            basis = np.linalg.qr(derivative)[0]
            rows = jacobian[feature.index]
            jacobian[feature.index] = rows - basis @ (basis.T @ rows)
        misfit, jacobian = misfit[used], jacobian[used]
        if not self.absolute:
            level = np.zeros((1, parameters.size))
            level[0, 5 :: len(PARAMETERS)] = np.sqrt(len(points))
            misfit, jacobian = np.append(misfit, level @ parameters), np.vstack([jacobian, level])
        self.last = (parameters.copy(), misfit, jacobian)
        return misfit, jacobian

    def solved(self, values):
        """The scipy result, and the estimates (heads, 6); bad features leave on the way."""
        from scipy.optimize import least_squares

        parameters = values.ravel()
        while True:
            self.last = None
            found = least_squares(
                lambda p: self.system(p)[0],
                parameters,
                jac=lambda p: self.system(p)[1],
                x_scale="jac",
                xtol=1e-9,
                ftol=1e-9,
                max_nfev=20,
            )
            parameters = found.x
            good = self.good_features(found.fun)
            kept = [f for f, keep in zip(self.features, good, strict=True) if keep]
            if good.all():
                kept, trimmed = self.trimmed(found.fun)
                if trimmed < 0.001:
                    return found, parameters.reshape(values.shape)
            self.features = kept

    def trimmed(self, misfit):
        """Features without the points far off their own, and the share of those."""
        counts = np.cumsum([len(feature.index) for feature in self.features])
        kept = []
        for feature, part in zip(self.features, np.split(misfit, counts), strict=False):
            near = np.abs(part) <= OUTLIER * max(sigma_mad(part), 1e-6)
            kept.append(_Feature(feature.kind, feature.index[near], feature.start))
        left = sum(len(feature.index) for feature in kept)
        return kept, 1 - left / counts[-1]

    def good_features(self, misfit):
        """Which features lie no farther off than is usual for their kind."""
        counts = np.cumsum([len(feature.index) for feature in self.features])[:-1]
        square = [np.mean(part**2) for part in np.split(misfit[: len(misfit)], counts)]
        table = pd.DataFrame({"kind": [f.kind for f in self.features], "rms": np.sqrt(square)})
        usual = table.groupby("kind")["rms"].transform("median")
        return (table["rms"] <= BAD_FEATURE * np.maximum(usual, 1e-6)).to_numpy()

    @property
    def own_parameters(self):
        """Number of parameters that were eliminated."""
        return sum(_OWN[feature.kind] for feature in self.features)


_COLUMNS = ("points", "time", "head", "drive")
_OWN = {"plane": 3, "pole": 5, "control": 2}


def _calibration(adjustment, found, values, lever):
    """The result with its covariance."""
    freedom = max(len(found.fun) - values.size - adjustment.own_parameters, 1)
    sigma0 = np.sqrt(2 * found.cost / freedom)
    singular = np.linalg.svd(found.jac / np.linalg.norm(found.jac, axis=0), compute_uv=False)
    if not np.isfinite(singular).all() or singular[-1] < 1e-4:
        raise ValueError(
            "Invalid drives: they do not determine the mounting. Must run in both directions past "
            "walls and poles."
        )
    unit = np.tile([180 / np.pi] * 3 + [1.0] * 3, len(lever))
    covariance = _clustered(adjustment.features, found) * np.outer(unit, unit)
    table = pd.DataFrame(
        {
            "head": np.repeat(np.arange(len(lever)), len(PARAMETERS)),
            "parameter": np.tile(PARAMETERS, len(lever)),
            "value": values.ravel() * unit,
            "std": np.sqrt(np.diag(covariance)),
        }
    )
    kinds = [feature.kind for feature in adjustment.features]
    return Calibration(
        table=table,
        covariance=covariance,
        sigma0_m=float(sigma0),
        n=sum(len(feature.index) for feature in adjustment.features),
        planes=kinds.count("plane"),
        poles=kinds.count("pole"),
        control=kinds.count("control"),
        lever_arms_m=lever,
    )


def _clustered(features, found):
    """Covariance from what each feature pulls at the estimates (cluster-robust sandwich)."""
    counts = np.cumsum([len(feature.index) for feature in features])
    starts = np.append(0, counts[:-1])
    pulls = np.add.reduceat((found.jac * found.fun[:, None])[: counts[-1]], starts)
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    share = len(features) / max(len(features) - found.x.size, 1)
    return share * inverse @ (pulls.T @ pulls) @ inverse


def _drive_samples(drives, lever, origin, values, rng):
    """Points of all drives under a mounting, thinned, and the group (drive and head) of each."""
    parts = []
    for number, (cloud, trajectory) in enumerate(drives):
        count = min(len(cloud), SAMPLE)
        chosen = np.sort(rng.choice(len(cloud), count, replace=False))
        points, time = cloud.points[chosen], cloud["gps_time"][chosen]
        head = _heads(cloud)[chosen]
        placed = points - origin
        if values.any():
            for first in range(0, count, 200_000):
                part = slice(first, first + 200_000)
                sample = _Sample.of(points[part], time[part], head[part])
                sample.locate(trajectory, lever, origin)
                placed[part] = sample.placed(values)
        parts.append((points, time, head, np.full(count, number), placed))
    names = (*_COLUMNS, "placed")
    samples = {
        name: np.concatenate(p) for name, p in zip(names, zip(*parts, strict=True), strict=True)
    }
    return samples, samples["drive"] * len(lever) + samples["head"]


def _patches(samples, groups, cell, most, roughness, rng):
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
            found.append(_Feature("plane", index))
            taken = np.vstack([taken, centres[k]])
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
    p = placed[order]
    centre = np.add.reduceat(p, starts) / n[:, None]
    off = p - np.repeat(centre, n, axis=0)
    scatter = np.add.reduceat(off[:, :, None] * off[:, None, :], starts) / n[:, None, None]
    values, vectors = np.linalg.eigh(scatter)
    table = pd.DataFrame(centre, columns=["x", "y", "z"])
    table[["nx", "ny", "nz"]] = vectors[:, :, 0]
    table["rms"], table["narrow"] = np.sqrt(np.maximum(values[:, :2], 0)).T
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


def _pole_features(samples, groups, poles, origin, search=0.5, low=0.4, high=6.0, fewest=12):
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
            found.append(_Feature("pole", joined, start))
    return found


def _round(placed, index, fewest):
    """Those of a group's points that lie on one pole; None where too few."""
    if len(index) < fewest:
        return None
    axis = _first_axis(placed[index])
    misfit = _pole_misfit(placed[index], axis)[0]
    keep = np.abs(misfit) <= OUTLIER * max(sigma_mad(misfit), 1e-6)
    if keep.sum() < fewest or sigma_mad(misfit) > 0.02:
        return None
    return index[keep]


def _first_axis(points):
    """Upright axis to begin with: x, y, tilt x, tilt y, radius at the mean height."""
    middle = np.median(points[:, :2], axis=0)
    spread = np.median(np.hypot(*(points[:, :2] - middle).T))
    return np.array([*middle, 0.0, 0.0, max(spread, 0.03)])


def _control_features(samples, control, origin, radius=0.3, fewest=12):
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
            found.append(_Feature("control", run, known[which[run[0]]]))
    return found


def _plane_misfit(points, _):
    """Distances from the regression plane, its normal, derivatives by offset and two tilts."""
    plane = fit_plane(points)
    flat = plane.project(points)
    derivative = np.column_stack([np.ones(len(points)), flat])
    return plane.residuals, np.broadcast_to(plane.normal, points.shape), derivative


def _pole_misfit(points, start, steps=12):
    """Distances from the best cylinder, outward normals, derivatives by its five parameters."""
    axis = np.array(start, dtype=np.float64)
    height = points[:, 2] - points[:, 2].mean()
    for _ in range(steps):
        misfit, way, derivative = _from_axis(points, height, axis)
        change = np.linalg.lstsq(derivative, -misfit, rcond=1e-8)[0]
        axis = axis + np.clip(change, -0.1, 0.1)
        axis[4] = np.clip(axis[4], 0.01, 0.5)
        if np.abs(change).max() < 1e-8:
            break
    misfit, way, derivative = _from_axis(points, height, axis)
    tilt = np.column_stack([way, -(way * axis[2:4]).sum(axis=1)])
    return misfit, tilt, derivative


def _from_axis(points, height, axis):
    """Distances from a cylinder, unit vectors from its axis in plan, derivatives."""
    off = points[:, :2] - axis[:2] - height[:, None] * axis[2:4]
    distance = np.maximum(np.hypot(*off.T), 1e-9)
    way = off / distance[:, None]
    derivative = -np.column_stack([way, height[:, None] * way, np.ones(len(points))])
    return distance - axis[4], way, derivative


def _control_misfit(points, known):
    """Heights over a control point, less a tilted surface through it; two tilts eliminated."""
    off = points - known
    tilts = off[:, :2]
    slope = np.linalg.lstsq(tilts, off[:, 2], rcond=None)[0]
    normal = np.broadcast_to([-slope[0], -slope[1], 1.0], points.shape)
    return off[:, 2] - tilts @ slope, normal, tilts


def _heads(cloud):
    """Head of each point; all the first where the cloud does not say."""
    return cloud["head"].astype(int) if "head" in cloud else np.zeros(len(cloud), dtype=int)


def _radians(values):
    """Estimates (heads, 6) with angles in radians."""
    return values * np.array([np.pi / 180] * 3 + [1.0] * 3)


def _rotations(angles):
    """Rotation matrices (h, 3, 3) of roll, pitch, heading in radians."""
    from scipy.spatial.transform import Rotation

    roll, pitch, heading = np.atleast_2d(angles).T
    turns = np.stack([-heading, pitch, roll], axis=1)
    return Rotation.from_euler("ZXY", turns).as_matrix()
