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
from scipy.special import stdtrit
from tqdm.auto import tqdm

from mmqa_lab._checks import check_choice, check_count, check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.boresight.adjustment import (
    PARAMETERS,
    Adjustment,
    Shots,
    clustered_covariance,
    placed_points,
    refuse_open,
    sampled,
)
from mmqa_lab.boresight.features import (
    HEIGHT_GAP_M,
    OWN_PARAMETERS,
    known_heights,
    shared_planes,
    shared_poles,
)
from mmqa_lab.cloud import Cloud

__all__ = ["Calibration", "calibrate", "corrected"]
__dir__ = __all__.copy

UNIT = np.array([180 / np.pi] * 3 + [1.0] * 3)
"""From radians and metres to the units of the parameters."""

USUAL_PATH_STD = np.array([0.02, 0.02, 0.02, 0.005, 0.005, 0.015])
"""East, north, height, m; roll, pitch, heading, degrees: post-processed with good satellites, as
usually quoted from a maker's sheet (see the system vmx-250)."""

CONTRADICTION = 3.0
"""Drives that disagree so many times as much as given errors of the paths explain: said."""

FARTHEST_DEG, FARTHEST_M = 10.0, 1.0
"""A mounting farther from the assumed one is an adjustment that ran away, no estimate."""


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
    placed = placed_points(cloud, trajectory, lever, values, origin)
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
    progress: bool = False,
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
    progress : bool
        Show a bar.

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
    >>> from mmqa_lab.simulate import Scanner, System
    >>> from mmqa_lab.simulate.testfield import drive_testfield, make_testfield
    >>> tilt = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.0, 0.3)}
    >>> head = Scanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **tilt)
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
    turns = range(check_count(rounds, "rounds"))
    for _ in tqdm(turns, unit="round", disable=not progress):
        chosen, placed, groups = sampled(drives, lever, origin, values, rng)
        features = shared_planes(
            placed, groups, cell=cell, most=patches, roughness=roughness, rng=rng
        )
        features += shared_poles(placed, groups, poles, origin)
        heights = known_heights(placed, control, origin)
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
        shots = Shots.of(drives, chosen, features, lever, origin)
        adjustment = Adjustment(shots, features, control is not None, free)
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
    refuse_open(found.jac, adjustment.free)
    features, free = adjustment.features, adjustment.free
    own = sum(OWN_PARAMETERS[feature.kind] for feature in features)
    freedom = max(len(found.fun) - len(found.x) - own, 1)
    of_points, students = clustered_covariance(features, found)
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
