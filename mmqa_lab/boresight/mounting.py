"""The mounting of scan heads, estimated, and clouds corrected by it."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count, check_points, check_positive
from mmqa_lab.boresight.adjustment import PARAMETERS, Adjustment, clustered_covariance
from mmqa_lab.boresight.observations import drive_points, heads, placed_points, radians
from mmqa_lab.boresight.search import known_heights, shared_planes, shared_poles
from mmqa_lab.cloud import Cloud

FARTHEST_DEG, FARTHEST_M = 10.0, 1.0
"""A mounting farther from the assumed one is an adjustment that ran away, no estimate."""


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
        return corrected(cloud, trajectory, lever_arms_m=self.lever_arms_m, values=self.values)


def corrected(cloud, trajectory, *, lever_arms_m, values):
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
    points = placed_points(
        cloud.points,
        np.asarray(cloud["gps_time"], dtype=np.float64),
        heads(cloud),
        trajectory=trajectory,
        lever=np.asarray(lever_arms_m, dtype=np.float64),
        values=radians(np.asarray(values, dtype=np.float64)),
        origin=origin,
    )
    return Cloud(origin + points, cloud.columns, cloud.name)


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

    Examples
    --------
    >>> from mmqa_lab.simulate import NavigationErrors, ProfileScanner
    >>> from mmqa_lab.simulate.testfield import System, drive_testfield, make_testfield
    >>> tilt = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.0, 0.3)}
    >>> head = ProfileScanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **tilt)
    >>> street = make_testfield(length_m=40, seed=1)
    >>> system = System("one head", (head,), NavigationErrors())
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
    if not drives:
        raise ValueError("Invalid drives: none given. Must be one or more.")
    origin = drives[0][0].points.mean(axis=0).round()
    rng = np.random.default_rng(seed)
    values = np.zeros((len(lever), len(PARAMETERS)))
    for _ in range(check_count(rounds, "rounds")):
        samples, groups = drive_points(drives, lever, origin, values, rng)
        choices = {"cell": cell, "most": patches, "roughness": roughness, "rng": rng}
        features = shared_planes(samples, groups, **choices)
        features += shared_poles(samples, groups, poles, origin)
        features += known_heights(samples, control, origin)
        if not any(feature.kind == "plane" for feature in features):
            raise ValueError(
                f"Invalid drives: no planes in common within cubes of {cell} m. Must overlap."
            )
        adjustment = Adjustment.of(samples, features, drives, lever, origin, control is not None)
        found, values = adjustment.solved(values)
    return _calibration(adjustment, found, values, lever)


def _calibration(adjustment, found, values, lever):
    """The result with its covariance."""
    angle, arm = np.abs(values[:, :3]).max(), np.abs(values[:, 3:]).max()
    if angle > np.radians(FARTHEST_DEG) or arm > FARTHEST_M:
        raise ValueError(
            f"Invalid drives: the adjustment moves a head by {arm:.1f} m and "
            f"{np.degrees(angle):.1f} degrees. Must determine the mounting: give poles and control."
        )
    freedom = max(len(found.fun) - values.size - adjustment.own_parameters, 1)
    sigma0 = np.sqrt(2 * found.cost / freedom)
    lengths = np.maximum(np.linalg.norm(found.jac, axis=0), np.finfo(float).tiny)
    if np.linalg.svd(found.jac / lengths, compute_uv=False)[-1] < 1e-4:
        raise ValueError(
            "Invalid drives: they do not determine the mounting. Must run in both directions past "
            "walls and poles."
        )
    unit = np.tile([180 / np.pi] * 3 + [1.0] * 3, len(lever))
    covariance = clustered_covariance(adjustment.features, found) * np.outer(unit, unit)
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
        n=int(adjustment.counts.sum()),
        planes=kinds.count("plane"),
        poles=kinds.count("pole"),
        control=kinds.count("control"),
        lever_arms_m=lever,
    )
