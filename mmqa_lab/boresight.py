"""Boresight and lever arm of scan heads, estimated from drives in both directions.

What a mounting error does changes its sign with the direction of travel: a wall seen on the way
there and on the way back lies in two places. Planes and poles that several drives or heads have
seen are fitted, and the mounting is sought with which they are thinnest. EuroSDR 2013, mobile laser
scanning, section 3.3.3, names the objects that show each error (ground for roll, poles and corners
for pitch and heading); the least-squares adjustment is our own. Start here::

    from mmqa_lab.boresight import calibrate

    found = calibrate(drives, lever_arms_m=assumed, poles=poles, control=levelled_points)
    found.table                                        # estimates with standard errors
    [found.correct(cloud, path) for cloud, path in drives]

Signs are those of ``simulate``: vehicle frame x right, y travel, z up; boresight rolls about y,
pitches about x and heads about -z, so that the true beam is R(boresight) times the assumed one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import least_squares, nnls
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from mmqa_lab._checks import check_choice, check_count, check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import CONSISTENT_SCALE, fit_plane, sigma_mad
from mmqa_lab.scan_pattern.lattice import rotations

__all__ = ["Calibration", "calibrate", "corrected"]
__dir__ = __all__.copy

PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Of each head: boresight, then what is to be added to the assumed lever arm."""

UNIT = np.array([180 / np.pi] * 3 + [1.0] * 3)
"""From radians and metres to the units of the parameters."""

AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""About which roll, pitch and heading turn."""

USUAL_PATH_STD = np.array([0.02, 0.02, 0.02, 0.005, 0.005, 0.015])
"""East, north, height, m; roll, pitch, heading, degrees: post-processed with good satellites, as
usually quoted from a maker's sheet (see the system vmx-250)."""

CONTRADICTION = 3.0
"""Drives that disagree so many times as much as given errors of the paths explain: said."""

FARTHEST_DEG, FARTHEST_M = 10.0, 1.0
"""A mounting farther from the assumed one is an adjustment that ran away, no estimate."""

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

BAD_FEATURE = 3.0
"""Features whose points lie so many times farther off than is usual for their kind are left out."""

STEADY = 0.001
"""Share of points left out below which the adjustment ends."""

BEYOND = 0.5
"""Cosine between beam and outward normal from which a point lies on the far side of a pole."""

WEAK = 1e-4
"""Smallest singular value of the scaled Jacobian; a combination of parameters below is open."""

MOST_TURNS = 15
"""Adjustments, points and features left out after each."""

SAMPLE = 2_000_000
"""Points of a cloud looked at in the search for planes; of larger clouds, so many at random."""

MOST_OF_GROUP = 100
"""Points of a drive's head that one plane takes."""

BLOCK = 200_000
"""Points placed at a time."""


@dataclass(frozen=True, eq=False)
class Calibration(Shown):
    """The mounting of the heads as estimated.

    Parameters
    ----------
    table : DataFrame
        One row a head and parameter: ``head``, ``parameter``, ``value``, ``std`` (0 of a parameter
        that was kept), ``low`` and ``high``: 95 % by Student's t, whose degrees of freedom count
        the features that matter (Satterthwaite); NaN where kept.
    covariance : array, shape (6 h, 6 h)
        In the order of the table, degrees and metres; from the scatter of what the features say
        (cluster-robust), so that planes that are not quite flat count in, and from the errors of
        the paths.
    sigma0_m : float
        Standard deviation of a point's distance from its plane or pole.
    n, planes, poles, control : int
        Points, and the planes, poles and control points they lie on.
    lever_arms_m : array, shape (h, 3)
        As assumed.
    remarks : str
        What the standard errors rest on where the errors of the paths were not given, or are
        larger than given.

    Examples
    --------
    >>> rows = [(0, name, 0.0, 0.01) for name in PARAMETERS]
    >>> table = pd.DataFrame(rows, columns=["head", "parameter", "value", "std"])
    >>> found = Calibration(table, np.eye(6) * 1e-4, 0.005, 90_000, 300, 6, 0, np.zeros((1, 3)))
    >>> found.values.shape, found.correlation[0, :2].tolist()
    ((1, 6), [1.0, 0.0])
    """

    table: pd.DataFrame
    covariance: np.ndarray
    sigma0_m: float
    n: int
    planes: int
    poles: int
    control: int
    lever_arms_m: np.ndarray
    remarks: str = ""

    @property
    def values(self) -> np.ndarray:
        """Array (heads, 6) of the estimates, degrees and metres."""
        return self.table["value"].to_numpy().reshape(-1, len(PARAMETERS))

    def to_frame(self) -> pd.DataFrame:
        """Return the table, in degrees and metres, with the remarks."""
        return self.table.assign(remarks=self.remarks)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(std, std)

    def correct(self, cloud: Cloud, trajectory: Any) -> Cloud:
        """Return a drive's cloud as the estimated mounting makes it.

        Parameters
        ----------
        cloud : Cloud
            With ``gps_time`` and, for several heads, ``head``; computed with the assumed mounting.
        trajectory
            The path it was computed from.
        """
        return corrected(cloud, trajectory, lever_arms_m=self.lever_arms_m, values=self.values)


def corrected(
    cloud: Cloud, trajectory: Any, *, lever_arms_m: ArrayLike, values: ArrayLike
) -> Cloud:
    """Return a cloud as another mounting of its heads makes it.

    Parameters
    ----------
    cloud : Cloud
        With ``gps_time`` and, for several heads, ``head``; computed with the assumed mounting.
    trajectory
        The path it was computed from.
    lever_arms_m : array_like, shape (h, 3)
        As assumed.
    values : array_like, shape (h, 6)
        Of each head: boresight in degrees, and metres to add to the assumed lever arm.

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
    origin = cloud.points[0].round() if len(cloud) else np.zeros(3)
    lever = np.asarray(lever_arms_m, dtype=np.float64)
    values = np.asarray(values, dtype=np.float64) / UNIT
    placed = _placed(cloud, trajectory, lever, values, origin)
    return replace(cloud, points=origin + placed)


def calibrate(
    drives: Sequence[tuple[Cloud, Any]],
    *,
    lever_arms_m: ArrayLike,
    poles: pd.DataFrame | None = None,
    control: ArrayLike | None = None,
    keep: Sequence[str] = (),
    cell: float = 1.0,
    patches: int = 500,
    roughness: float = 0.03,
    seed: int = 0,
    rounds: int = 2,
    path_std_m: ArrayLike | None = None,
    path_std_deg: ArrayLike | None = None,
) -> Calibration:
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
        ``x_m``, ``y_m``, ``z_m`` of feet, roughly; ``diameter_m`` where it is known to
        millimetres: a wrong one pulls the two sides of a pole together or apart.
    control : array_like, shape (m, 3), optional
        Points of the ground whose heights are known. Without them the heights of all heads
        together cannot be told from the ground's, and the mean of z_m is kept at 0.
    keep : sequence of str
        Parameters (``roll_deg``, ``pitch_deg``, ``heading_deg``, ``x_m``, ``y_m``, ``z_m``) that
        stay as assumed, of all heads: those that the drives do not determine.
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
    path_std_m, path_std_deg : float or array_like, shape (3,), optional
        Standard deviations of the paths, each error lasting a whole drive: east, north, height, m;
        roll, pitch, heading, degrees; 0 of exact paths. They enter the covariance. Where neither is
        given, usual ones do (``USUAL_PATH_STD``), larger by as much as the drives disagree more
        than these explain, and the result says so.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If there are no common planes, no control point lies at the clouds' ground, or the mounting
        is not determined: the sentence names the parameters that stay open.

    Notes
    -----
    An error of a path that lasts a whole drive is the same as a lever-arm error of opposite sign in
    the other direction: two drives along one street cannot tell them apart. Residuals show only a
    part of it, such as the difference of two drives in height. Standard errors are therefore right
    as far as ``path_std_m`` and ``path_std_deg`` are.

    With a free radius, range noise of 5 mm pushes the two sides of a pole of 6 cm 2.5 mm apart,
    which the standard errors do not contain (headings .003 degrees off in simulated streets); with
    the known radius it is 0.4 mm.

    Examples
    --------
    >>> from mmqa_lab.simulate import ProfileScanner, System
    >>> from mmqa_lab.simulate.testfield import drive_testfield, make_testfield
    >>> tilt = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.0, 0.3)}
    >>> head = ProfileScanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **tilt)
    >>> street = make_testfield(length_m=40, seed=1)
    >>> system = System("one head", (head,))
    >>> drives = drive_testfield(street, system, seed=4, pulses_per_s=20_000)
    >>> known = {"lever_arms_m": system.assumed_lever_arms, "poles": street.poles}
    >>> found = calibrate(drives, **known, patches=100, rounds=1)
    >>> heading = found.table["parameter"] == "heading_deg"
    >>> found.table.loc[heading, "value"].round(2).tolist()
    [0.3]
    """
    lever = check_points(np.atleast_2d(lever_arms_m), name="lever_arms_m")
    check_positive(cell, "cell", unit="m")
    check_positive(roughness, "roughness", unit="m")
    path_std = _path_std(path_std_m, path_std_deg)
    if not drives:
        raise ValueError("Invalid drives: none given. Must be one or more.")
    free = ~np.isin(PARAMETERS, [check_choice(name, "keep", PARAMETERS) for name in keep])
    free = np.tile(free, len(lever))
    origin = drives[0][0].points.mean(axis=0).round()
    rng = np.random.default_rng(seed)
    values = np.zeros((len(lever), len(PARAMETERS)))
    for _ in range(check_count(rounds, "rounds")):
        chosen, placed, groups = _sampled(drives, lever, origin, values, rng)
        features = _shared_planes(placed, groups, cell, patches, roughness, rng)
        features += _shared_poles(placed, groups, poles, origin)
        heights = _known_heights(placed, control, origin)
        if control is not None and not heights:
            raise ValueError(
                f"Invalid control: none of {len(control)} points lies within {HEIGHT_GAP_M} m of "
                "the clouds' ground. Must be heights of it, in the drives' coordinate system."
            )
        features += heights
        if not any(feature.kind == "plane" for feature in features):
            raise ValueError(
                f"Invalid drives: no planes in common within cubes of {cell} m. Must overlap."
            )
        shots = _Shots.of(drives, chosen, features, lever, origin)
        adjustment = _Adjustment(shots, features, control is not None, free)
        found, values = adjustment.solved(values)
    return _calibration(adjustment, found, values, path_std)


def _path_std(metres, degrees):
    """Standard deviations of a path's errors, (6,): metres, radians; None where none are given."""
    if metres is None and degrees is None:
        return None
    parts = [
        np.broadcast_to(np.asarray(0.0 if given is None else given, np.float64), 3)
        for given in (metres, degrees)
    ]
    std = np.concatenate(parts)
    if not (np.isfinite(std).all() and (std >= 0).all()):
        raise ValueError(f"Invalid path_std {metres}, {degrees}. Must be >= 0 m and degrees.")
    return std


def _calibration(adjustment, found, values, path_std):
    """The result with its covariance."""
    angle, arm = np.abs(values[:, :3]).max(), np.abs(values[:, 3:]).max()
    if angle > np.radians(FARTHEST_DEG) or arm > FARTHEST_M:
        raise ValueError(
            f"Invalid drives: the adjustment moves a head by {arm:.1f} m and "
            f"{np.degrees(angle):.1f} degrees. Must determine the mounting: give poles and control."
        )
    _refuse_open(found.jac, adjustment.free)
    features, free = adjustment.features, adjustment.free
    own = sum(OWN_PARAMETERS[feature.kind] for feature in features)
    freedom = max(len(found.fun) - len(found.x) - own, 1)
    of_points, students = _clustered_covariance(features, found)
    of_paths, remarks = _path_covariance(adjustment, found, values, path_std)
    reach, covariance = np.zeros(values.size), np.zeros((values.size, values.size))
    covariance[np.ix_(free, free)] = of_points + of_paths
    share = np.diag(of_points) / np.diag(of_points + of_paths)
    reach[free] = stdtrit(students / share**2, 0.975)
    unit = np.tile(UNIT, len(values))
    covariance *= np.outer(unit, unit)
    std, value = np.sqrt(np.diag(covariance)), values.ravel() * unit
    half = np.where(std > 0, reach * std, np.nan)
    table = pd.DataFrame(
        {
            "head": np.repeat(np.arange(len(values)), len(PARAMETERS)),
            "parameter": np.tile(PARAMETERS, len(values)),
            **{"value": value, "std": std, "low": value - half, "high": value + half},
        }
    )
    vague = table["std"] > np.tile(np.repeat([FARTHEST_DEG, FARTHEST_M], 3), len(values))
    if vague.any():
        head, name, _, std, *_ = table[vague].iloc[0]
        raise ValueError(
            f"Invalid drives: they leave {name} of head {head + 1} uncertain by {std:.3g}. "
            "Must run in both directions past walls and poles, with dense points."
        )
    kinds = [feature.kind for feature in features]
    counts = (kinds.count(kind) for kind in OWN_PARAMETERS)
    sigma0, n = np.sqrt(2 * found.cost / freedom), sum(map(len, features))
    lever = adjustment.shots.lever
    return Calibration(table, covariance, float(sigma0), n, *counts, lever, remarks)


def _path_covariance(adjustment, found, values, path_std):
    """What errors of the paths add to the covariance, and what is to be said of them."""
    std = USUAL_PATH_STD if path_std is None else path_std
    drives = adjustment.shots.drive.max() + 1
    usual, given = (np.tile(one / UNIT[::-1], drives) for one in (USUAL_PATH_STD, std))
    changes = adjustment.path_changes(values, len(found.fun)) * usual
    effects = -np.linalg.solve(found.jac.T @ found.jac, found.jac.T @ changes)
    apart = _disagreement(adjustment, found, changes + found.jac @ effects, given / usual)
    factor = max(apart, 1.0) if path_std is None else 1.0
    effects *= factor * given / usual
    figures = ", ".join(f"{one:g}" for one in std)
    if path_std is None:
        said = (
            f"The errors of the paths are not given; standard deviations of {figures} (east, "
            f"north, height in m; roll, pitch, heading in degrees) are assumed, times {factor:.1f}."
        )
    elif apart > CONTRADICTION:
        said = (
            f"The drives disagree {apart:.1f} times as much as the given errors of the paths "
            "explain: the standard errors are too small."
        )
    else:
        said = ""
    return effects @ effects.T, said


def _disagreement(adjustment, found, changes, given):
    """How much more the drives disagree than their points and the given paths explain, a ratio.

    Errors of the paths that the mounting cannot take up are fitted to what is left of the misfits.
    """
    starts = np.append(0, np.cumsum(adjustment.counts)[:-1])
    size, ways = np.linalg.eigh(changes.T @ changes)
    ways = ways[:, size > 1e-9 * size[-1]]
    rows = (changes @ ways)[: adjustment.counts.sum()]
    pulls = np.add.reduceat(rows * found.fun[: len(rows), None], starts)
    own = np.add.reduceat(rows**2, starts)
    seen = pulls.sum(axis=0) / own.sum(axis=0)
    noise = ((pulls - own * seen) ** 2).sum(axis=0) / own.sum(axis=0) ** 2
    clear = noise < 1
    if not clear.any():
        return 0.0
    explained = noise + given**2 @ ways**2
    return float(np.sqrt(np.mean((seen**2 / explained)[clear])))


def _refuse_open(jacobian, free):
    """Name the parameters that can change together without any effect."""
    lengths = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    _, size, ways = np.linalg.svd(jacobian / lengths, full_matrices=False)
    if size[-1] >= WEAK:
        return
    numbers = np.flatnonzero(free)[np.abs(ways[-1]) > 0.1]
    names = [f"{PARAMETERS[k % 6]} of head {k // 6 + 1}" for k in numbers]
    raise ValueError(
        f"Invalid drives: they do not determine the mounting ({' with '.join(names)} stays open). "
        "Must run in both directions past walls and poles; or keep one of these as assumed."
    )


@dataclass(eq=False)
class _Feature:
    """What some points lie on: its kind, their numbers, and its known place or radius."""

    kind: str
    index: np.ndarray
    known: object = None

    def __len__(self):
        return len(self.index)

    def inside(self, misfit):
        """Misfit without the part that all points share: of control, the survey's own error."""
        return misfit - np.median(misfit) if self.kind == "control" else misfit


@dataclass(eq=False)
class _Shots:
    """Points by what places them: head, pose of the vehicle, vector from the head."""

    lever: np.ndarray
    head: np.ndarray
    offset: np.ndarray
    rotation: np.ndarray
    vector: np.ndarray
    drive: np.ndarray = None

    @classmethod
    def of(cls, drives, chosen, features, lever, origin):
        """Those of all features, one feature after the other."""
        index = np.concatenate([feature.index for feature in features])
        ends = np.cumsum([len(numbers) for numbers in chosen])
        drive = np.searchsorted(ends, index, side="right")
        n = len(index)
        whole = cls(
            lever, np.empty(n, int), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), drive
        )
        for number, (cloud, trajectory) in enumerate(drives):
            mine = drive == number
            rows = chosen[number][index[mine] - (ends[number] - len(chosen[number]))]
            part = cls.located(cloud, rows, trajectory, lever, origin)
            for name in ("head", "offset", "rotation", "vector"):
                getattr(whole, name)[mine] = getattr(part, name)
        return whole

    @classmethod
    def located(cls, cloud, rows, trajectory, lever, origin):
        """Those of some rows of a cloud."""
        head = _heads(cloud)[rows]
        position, rotation = trajectory.at(np.asarray(cloud["gps_time"][rows], dtype=np.float64))
        offset = position - origin
        from_vehicle = (cloud.points[rows] - origin) - offset
        vector = np.einsum("nij,ni->nj", rotation, from_vehicle) - lever[head]
        return cls(lever, head, offset, rotation, vector)

    def select(self, which):
        """Some of them."""
        arrays = (self.head, self.offset, self.rotation, self.vector, self.drive)
        return _Shots(self.lever, *(values[which] for values in arrays))

    def turned(self, values):
        """Vectors under a boresight, (n, 3); ``values`` (heads, 6) in radians and metres."""
        return np.einsum("nij,nj->ni", rotations(*values[:, :3].T)[self.head], self.vector)

    def placed(self, values):
        """Points from the origin under a mounting, (n, 3)."""
        inside = self.turned(values) + (self.lever + values[:, 3:])[self.head]
        return self.offset + np.einsum("nij,nj->ni", self.rotation, inside)

    def beams(self, values):
        """Unit vectors from the head to each point, (n, 3)."""
        beam = np.einsum("nij,nj->ni", self.rotation, self.turned(values))
        return beam / np.linalg.norm(beam, axis=1)[:, None]

    def derivatives(self, values, normal):
        """Change of each point along ``normal`` (n, 3) by its own head's parameters, (n, 6)."""
        across = np.einsum("nij,ni->nj", self.rotation, normal)
        return np.hstack([np.cross(self.turned(values), across) @ AXES.T, across])


def _sampled(drives, lever, origin, values, rng):
    """Rows taken of each drive, their points under a mounting, and the group of each."""
    chosen, placed, groups = [], [], []
    for number, (cloud, trajectory) in enumerate(drives):
        count = min(len(cloud), SAMPLE)
        rows = np.sort(rng.choice(len(cloud), count, replace=False))
        part = cloud[rows]
        moved = part.points - origin
        if values.any():
            moved = _placed(part, trajectory, lever, values, origin)
        chosen.append(rows)
        placed.append(moved)
        groups.append(number * len(lever) + _heads(part))
    return chosen, np.concatenate(placed), np.concatenate(groups)


def _placed(cloud, trajectory, lever, values, origin):
    """Points of a cloud (n, 3) from the origin, under a mounting whose angles are in radians."""
    placed = np.empty_like(cloud.points)
    for first in range(0, len(cloud), BLOCK):
        rows = slice(first, first + BLOCK)
        placed[rows] = _Shots.located(cloud, rows, trajectory, lever, origin).placed(values)
    return placed


def _heads(cloud):
    """Head of each point; all the first where the cloud does not say."""
    return cloud["head"].astype(int) if "head" in cloud else np.zeros(len(cloud), dtype=int)


@dataclass(eq=False)
class _Adjustment:
    """The points of all features, one feature after the other, and the least-squares problem.

    ``survey`` is the standard deviation of a control point's height over that of a laser point,
    ``noise_m`` that of ranges. Vectors in ``shots`` are without the range errors that the last
    turn found (``error``), so that planes tilt about where the beams meet them: a range error moves
    a point along its plane too, which would tilt the plane. ``left`` is what these errors are in
    misfits, without what the features' own parameters take out.
    """

    shots: _Shots
    features: list
    absolute: bool
    free: np.ndarray
    survey: float = 0.0
    noise_m: float = 0.0
    last: tuple = None

    def __post_init__(self):
        self.error = self.left = np.zeros(len(self.shots.head))

    @property
    def counts(self):
        """Points of each feature."""
        return np.array([len(feature) for feature in self.features])

    def measured(self, values):
        """Misfits, directions and basis of :func:`_measured` under a mounting."""
        points, beams = self.shots.placed(values), self.shots.beams(values)
        found = _measured(self.features, points, beams, self.survey, self.noise_m)
        return found[0] + self.left, *found[1:]

    def system(self, parameters):
        """Misfit of all points and its derivatives, the features' own parameters eliminated."""
        if self.last is not None and np.array_equal(self.last[0], parameters):
            return self.last[1:]
        values = self.values(parameters)
        misfit, normal, basis = self.measured(values)
        self._eliminate(misfit[:, None], basis[:, COMMON], first=self._first("control"))
        jacobian = np.zeros((len(misfit), values.size))
        columns = self.shots.head[:, None] * len(PARAMETERS) + np.arange(len(PARAMETERS))
        derivatives = self.shots.derivatives(values, normal)
        np.put_along_axis(jacobian, columns, derivatives, axis=1)
        for number, column in enumerate(basis.T):
            # the first columns are all that planes, which come first, have
            self._eliminate(jacobian, column, first=0 if number < 3 else self._first("pole"))
        if not self.absolute:
            level = np.zeros((1, values.size))
            level[0, 5 :: len(PARAMETERS)] = np.sqrt(len(misfit))
            misfit = np.append(misfit, level @ values.ravel())
            jacobian = np.vstack([jacobian, level])
        self.last = (parameters.copy(), misfit, jacobian[:, self.free])
        return self.last[1:]

    def path_changes(self, values, rows):
        """Change of the misfits by errors of the drives' paths, (rows, 6 drives): place, angles.

        An error that lasts the whole drive moves and turns its points together.
        """
        shots, placed = self.shots, self.shots.placed(values)
        _, normal, basis = self.measured(values)
        arm = np.einsum("nij,ni->nj", shots.rotation, placed - shots.offset)
        across = np.einsum("nij,ni->nj", shots.rotation, normal)
        effects = np.column_stack([normal, np.cross(arm, across) @ AXES.T])
        change = np.zeros((len(placed), 6 * (shots.drive.max() + 1)))
        columns = shots.drive[:, None] * 6 + np.arange(6)
        np.put_along_axis(change, columns, effects, axis=1)
        for column in basis.T:
            self._eliminate(change, column, first=0)
        return np.pad(change, ((0, rows - len(change)), (0, 0)))

    def values(self, parameters):
        """Array (heads, 6), 0 where a parameter is kept."""
        values = np.zeros(len(self.free))
        values[self.free] = parameters
        return values.reshape(-1, len(PARAMETERS))

    def _first(self, kind):
        """Number of the first feature that is of a kind or a later one."""
        kinds = list(OWN_PARAMETERS)
        return sum(kinds.index(feature.kind) < kinds.index(kind) for feature in self.features)

    def _eliminate(self, jacobian, column, first):
        """Take a column of unit length in each feature out of the rows from a feature on."""
        counts = self.counts[first:]
        rows = slice(self.counts[:first].sum(), None)
        column = column[rows, None]
        if len(counts):
            share = np.add.reduceat(column * jacobian[rows], np.cumsum(counts) - counts)
            jacobian[rows] -= column * np.repeat(share, counts, axis=0)

    def solved(self, values):
        """The scipy result, and the estimates (heads, 6); bad features leave on the way."""
        parameters = values.ravel()[self.free]
        _refuse_open(self.system(parameters)[1], self.free)
        limits = {"x_scale": "jac", "xtol": 1e-5, "ftol": 1e-6, "max_nfev": 20}
        for left in reversed(range(MOST_TURNS)):
            self.last = None
            found = least_squares(
                lambda p: self.system(p)[0], parameters, jac=lambda p: self.system(p)[1], **limits
            )
            parameters, values = found.x, self.values(found.x)
            misfit = self.measured(values)[0]
            by_feature = np.split(misfit, np.cumsum(self.counts)[:-1])
            good = self._usual(by_feature)
            near = [
                _near(feature.inside(part)) & keep
                for feature, part, keep in zip(self.features, by_feature, good, strict=True)
            ]
            survey, seen = self.survey, self._survey_error(by_feature)
            # halfway: weights and medians of few heights could change to and fro for ever
            self.survey = (survey + seen) / 2 if survey else seen
            settled = np.abs(self.survey - survey) <= 0.1 * self.survey
            steady = good.all() and np.concatenate(near).mean() > 1 - STEADY and settled
            if (steady and self.noise_m) or not left:
                return found, values
            self._keep(near)
            self._take_errors(values)

    def _survey_error(self, by_feature):
        """Standard deviation of the control points' heights over that of a laser point."""
        first = self._first("control")
        if first == len(by_feature):
            return 0.0
        noise = max(np.sqrt(np.mean(np.concatenate(by_feature[:first]) ** 2)), 1e-6)
        heights = np.array([part.mean() for part in by_feature[first:]])
        inside = np.mean([noise**2 / len(part) for part in by_feature[first:]])
        return np.sqrt(max(sigma_mad(heights) ** 2 - inside, 0)) / noise

    def _usual(self, by_feature):
        """Which features lie no farther off than is usual for their kind.

        Of heights over control points, most of which is one survey error, three deviations count.
        """
        rms = [np.sqrt(np.mean(part**2)) for part in by_feature]
        table = pd.DataFrame({"kind": [f.kind for f in self.features], "rms": rms})
        usual = table.groupby("kind")["rms"].transform("median")
        usual = usual.where(table["kind"] != "control", CONSISTENT_SCALE * usual)
        return (table["rms"] <= BAD_FEATURE * np.maximum(usual, 1e-6)).to_numpy()

    def _take_errors(self, values):
        """Take the range errors that explain the misfits out of the vectors."""
        misfit, normal, _ = self.measured(values)
        planes, poles = (self.counts[: self._first(kind)].sum() for kind in ("pole", "control"))
        along = (normal * self.shots.beams(values)).sum(axis=1)
        design = np.column_stack([np.ones(planes), along[:planes] ** 2])
        surface, ranges = nnls(design, misfit[:planes] ** 2)[0]
        self.noise_m = max(np.sqrt(ranges), 1e-9)
        means = np.add.reduceat(misfit, np.cumsum(self.counts) - self.counts) / self.counts
        error = misfit - np.repeat(means, self.counts)
        error *= ranges * along / np.maximum(surface + ranges * along**2, 1e-300)
        error[planes:poles] = 0.0
        length = np.linalg.norm(self.shots.vector, axis=1)
        self.shots.vector *= (1 + (self.error - error) / length)[:, None]
        self.error, self.left = error, error * along
        basis = self.measured(values)[2]
        for column in basis.T:
            self._eliminate(self.left[:, None], column, first=0)

    def _keep(self, near):
        """Leave out points, and features of which none is left."""
        inside = np.concatenate(near)
        self.shots = self.shots.select(inside)
        self.error, self.left = self.error[inside], self.left[inside]
        self.features = [
            replace(feature, index=feature.index[inside])
            for feature, inside in zip(self.features, near, strict=True)
            if inside.any()
        ]


def _near(misfit):
    """Which points lie near their own feature."""
    return np.abs(misfit) <= OUTLIER * max(sigma_mad(misfit), 1e-6)


def _clustered_covariance(features, found):
    """Covariance from what each feature pulls at the estimates (cluster-robust, jackknife).

    Each pull is that of the feature's misfit under the mounting that the others give. Also the
    degrees of freedom of each variance: as many as features that share alike in it would have.
    """
    ends = np.cumsum([len(feature) for feature in features])
    starts, jacobian = np.append(0, ends[:-1]), found.jac[: ends[-1]]
    pulls = np.add.reduceat(jacobian * found.fun[: ends[-1], None], starts)
    inverse = np.linalg.inv(found.jac.T @ found.jac)
    own = np.array([part.T @ part for part in np.split(jacobian, ends[:-1])])
    others = np.eye(len(inverse)) - own @ inverse
    effects = inverse @ np.linalg.solve(others, pulls[..., None])[..., 0].T
    share = np.einsum("ij,gjk,ki->gi", inverse, own, inverse)
    return effects @ effects.T, share.sum(axis=0) ** 2 / (share**2).sum(axis=0)


def _measured(features, points, beams, survey, noise_m):
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
            found = _pole_misfit(points[part], feature.known, beams[part, :2], noise_m)
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


def _pole_misfit(points, radius=None, beams=None, noise_m=0.0):
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
        misfit, way, derivative = _from_axis(points, height, axis, beams, noise_m)
        change = np.linalg.lstsq(derivative[:, :free], -misfit, rcond=1e-8)[0]
        axis[:free] += np.clip(change, -0.1, 0.1)
        axis[4] = np.clip(axis[4], 0.01, 0.5)
        if np.abs(change).max() < 1e-8:
            break
    misfit, way, derivative = _from_axis(points, height, axis, beams, noise_m)
    tilt = np.column_stack([way, -(way * axis[2:4]).sum(axis=1)])
    return misfit, tilt, derivative[:, :free]


def _from_axis(points, height, axis, beams, noise_m):
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


def _shared_planes(placed, groups, cell, most, roughness, rng):
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
            found.append(_Feature("plane", index))
            taken = np.vstack([taken, centres[k]])
    return found


def _shared_poles(placed, groups, poles, origin, search=0.5, low=0.4, high=6.0, fewest=12):
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
            found.append(_Feature("pole", joined, radius if radius > 0 else None))
    return found


def _known_heights(placed, control, origin, radius=0.3, fewest=12):
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
            found.append(_Feature("control", run, known[which[run[0]]]))
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
        rng.permutation(run[_near(plane.residuals)])[:MOST_OF_GROUP]
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
    misfit = _pole_misfit(placed[index])[0]
    if sigma_mad(misfit) > 0.02:
        return None
    return index[_near(misfit)]
