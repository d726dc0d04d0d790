"""Scan patterns measured: in the points of a planar patch, and in a whole street with time.

In place of distances clicked between points (Cahalane et al. 2014, sections 4.1.2 and 4.2.2), all
profiles of a patch are fitted at once, and every figure comes with its standard deviation. The
times of a whole street give the moving plane of the scanner.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.planes import TUKEY, Plane, fit_plane, sigma_mad
from mmqa_lab.scan_pattern.lines import (
    first_direction,
    fit_profiles,
    group_means,
    mean_gap,
    solve_groups,
)
from mmqa_lab.scan_pattern.numbering import (
    mirror_frequency,
    point_spacing,
    profiles_from_pattern,
    pulses_from_pattern,
    pulses_from_time,
    revolutions_from_time,
)

LEVEL = np.sin(np.radians(0.1))
"""A plane closer to level than 0.1 degree has no horizontal line of its own."""


CLEAR = 1 / 3
"""The straightest lines are taken if points stray from others three times as far."""

ENOUGH = 1500
"""Points from which straying from the lines of a family is found."""

PHASES = 1500
"""Parts of a revolution within which the beam is taken to have one direction."""


@dataclass(frozen=True, eq=False)
class PatternMeasurement(Shown):
    """What was measured in a patch; metres and degrees, each with its standard deviation.

    Parameters
    ----------
    plane : Plane
        Of all points given.
    direction : array, shape (3,)
        Unit vector along the profiles.
    numbering : str
        Where profile numbers came from: ``scan_line``, ``gps_time`` or ``pattern``.
    profile : array of int, shape (n,)
        Profile of each point, -1 for those left out.
    profiles, points : int
        Used.
    profile_spacing_perpendicular_m, profile_angle_deg, point_spacing_m : float
        The mean gap between neighbouring profiles over the patch; the angle from the horizontal
        line and the spacing of points along a profile at the reference point.
        NaN where not measurable.
    profile_spacing_perpendicular_std, profile_angle_std, point_spacing_std : float
        Their standard deviations.
    covariance : float
        Of the errors of gap (m) and angle (rad).

    Examples
    --------
    >>> along, line = np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7))
    >>> wall = np.stack([0 * along, 0.05 * line, along], axis=-1).reshape(-1, 3)
    >>> found = measure_pattern(wall)  # upright profiles, 5 cm apart
    >>> round(found.profile_angle_deg, 3), round(float(found.profile_spacing_horizontal_m), 6)
    (90.0, 0.05)
    """

    plane: Plane
    direction: np.ndarray
    numbering: str
    profile: np.ndarray
    profiles: int
    points: int
    profile_spacing_perpendicular_m: float
    profile_spacing_perpendicular_std: float
    profile_angle_deg: float
    profile_angle_std: float
    point_spacing_m: float
    point_spacing_std: float
    covariance: float

    @property
    def profile_spacing_horizontal_m(self):
        """Gap along the horizontal line of the plane."""
        return self.profile_spacing_perpendicular_m / np.sin(np.radians(self.profile_angle_deg))

    @property
    def profile_spacing_vertical_m(self):
        """Gap along the line of greatest slope; badly determined above 75 degrees."""
        return self.profile_spacing_perpendicular_m / np.cos(np.radians(self.profile_angle_deg))

    @property
    def profile_spacing_horizontal_std(self):
        """Standard deviation, that of gap and angle with their covariance."""
        angle = np.radians(self.profile_angle_deg)
        return self._spread(1 / np.sin(angle), -np.cos(angle) / np.sin(angle) ** 2)

    @property
    def profile_spacing_vertical_std(self):
        """Standard deviation, that of gap and angle with their covariance."""
        angle = np.radians(self.profile_angle_deg)
        return self._spread(1 / np.cos(angle), np.sin(angle) / np.cos(angle) ** 2)

    def to_frame(self):
        """Return a DataFrame: ``quantity``, ``measured``, ``std``, ``n`` (profiles or points)."""
        names = ["profile_spacing_perpendicular_m", "profile_spacing_horizontal_m"]
        names += ["profile_spacing_vertical_m", "profile_angle_deg", "point_spacing_m"]
        counts = [self.profiles] * 4 + [self.points]
        rows = [
            (name, getattr(self, name), getattr(self, f"{name.rsplit('_', 1)[0]}_std"), n)
            for name, n in zip(names, counts, strict=True)
        ]
        return pd.DataFrame(rows, columns=["quantity", "measured", "std", "n"])

    def _spread(self, by_gap, by_angle):
        """Standard deviation of a function of gap and angle from its derivatives."""
        angle_std = np.radians(self.profile_angle_std)
        mixed = 2 * by_gap * by_angle * self.profile_spacing_perpendicular_m * self.covariance
        parts = (by_gap * self.profile_spacing_perpendicular_std) ** 2
        parts += (by_angle * self.profile_spacing_perpendicular_m * angle_std) ** 2
        return float(np.sqrt(max(parts + mixed, 0.0)))


def measure_pattern(
    points,
    *,
    gps_time=None,
    scan_line=None,
    mirror_frequency_hz=None,
    pulse_rate_hz=None,
    reference=None,
):
    """Measure the scan pattern of a planar patch.

    Profiles are numbered by ``scan_line`` or from ``gps_time``, else from the pattern alone. One
    direction, one curvature and one way of sliding along the beam (range noise moves points off
    the plane and across the profiles at the same time) are fitted to all profiles at once; the mean
    gap follows from their offsets (``lines.mean_gap``). Points along a profile are counted by
    time and ``pulse_rate_hz`` or by rounding their distances, and spacing is the slope of distance
    over count at the reference point.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        One planar patch, one pass of one scanner head, metres.
    gps_time : array_like, shape (n,), optional
        Seconds.
    scan_line : array_like of int, shape (n,), optional
        Counts profiles; missing ones must be missing in it too.
    mirror_frequency_hz, pulse_rate_hz : float, optional
        Estimated from time where left out.
    reference : array_like, shape (3,), optional
        Where angle and point spacing are given; the centroid where left out.

    Returns
    -------
    PatternMeasurement

    Raises
    ------
    ValueError
        If columns are not as long as the points, or fewer than two profiles of three points and
        twelve points in all are found.

    Warns
    -----
    UserWarning
        If without time and scan line another family of lines fits as well as the one that was
        taken for the profiles.

    Notes
    -----
    Standard deviations contain what shows in the patch: range and angle noise, drop-outs, drift of
    speed, jitter of attitude. They do not contain what turns or stretches the whole patch:
    boresight, attitude bias. Distances between neighbouring points, the obvious measure, are 1 to
    3 mm too long at 5 mm range noise.

    References
    ----------
    Cahalane et al. 2014, sections 4.1.2 and 4.2.2. doi:10.3390/s140609471

    Examples
    --------
    >>> along, line = np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7))
    >>> wall = np.stack([0 * along, 0.05 * line, along + 0.007 * line], axis=-1).reshape(-1, 3)
    >>> found = measure_pattern(wall)
    >>> round(found.profile_spacing_perpendicular_m, 6), round(found.point_spacing_m, 6)
    (0.05, 0.02)
    """
    points = check_points(points, minimum=12)
    time = _column(gps_time, "gps_time", len(points))
    line = _column(scan_line, "scan_line", len(points))
    plane = fit_plane(points, robust=True)
    near = np.abs(plane.residuals) <= TUKEY * max(sigma_mad(plane.residuals), 1e-9)
    flat = fit_plane(points[near])
    centre = flat.centre if reference is None else check_points([reference], name="reference")[0]
    uv = flat.project(points[near]) - flat.project(centre)
    picked = [None if values is None else values[near] for values in (time, line)]
    numbers, numbering = _numbers(uv, flat.residuals, *picked, mirror_frequency_hz)
    fit = fit_profiles(uv, flat.residuals, numbers, turn=first_direction(uv, numbers))
    picked_time = None if time is None else picked[0][fit.used]
    pulse = _pulses(fit, picked_time, pulse_rate_hz)
    return _measurement(plane, flat, near, fit, numbering, pulse)


def _column(values, name, n):
    """A column as float64, one value a point, or None."""
    if values is None:
        return None
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise ValueError(
            f"Invalid {name} of shape {values.shape}. Must have one finite value for each of {n} "
            "points."
        )
    return values


def _numbers(uv, off, time, line, mirror_frequency_hz):
    """Profile of each point, and where that came from."""
    if line is not None:
        return line.astype(np.int64), "scan_line"
    if time is not None:
        numbers = revolutions_from_time(time, mirror_frequency_hz=mirror_frequency_hz)
        return numbers, "gps_time"
    return _straightest(uv, off, profiles_from_pattern(uv)), "pattern"


def _straightest(uv, off, families):
    """The family of lines from which points stray least, or the densest where that is not clear."""
    if len(families) == 1:
        return families[0]
    some = np.random.default_rng(0).permutation(len(uv))[:ENOUGH]
    found = [_stray(uv[some], off[some], numbers[some]) for numbers in families]
    strays, gaps = np.array(found).T
    best, other = np.argsort(strays)[:2]
    if strays[best] < CLEAR * strays[other]:
        return families[best]
    rival = gaps[1:].max()
    if rival > gaps[0] / 2:
        warnings.warn(
            f"Lines {1000 * gaps[0]:.1f} mm apart were taken for the profiles, but others "
            f"{1000 * rival:.1f} mm apart fit as well. Give gps_time or scan_line.",
            stacklevel=4,
        )
    return families[0]


def _stray(uv, off, numbers):
    """Scatter of points about their lines as a share of the lines' gap, and that gap, metres."""
    try:
        fit = fit_profiles(uv, off, numbers, turn=first_direction(uv, numbers))
    except ValueError:  # lines of fewer than three points
        return np.inf, 0.0
    gap = abs(np.polyfit(fit.numbers, fit.offsets, 1)[0])
    return max(np.sqrt(np.median(fit.variances * fit.counts)), 1e-9) / gap, gap


def _pulses(fit, time, pulse_rate_hz):
    """Pulse counts of the points used: by time, by the pattern where time is none or coarse."""
    if time is not None:
        pulse = pulses_from_time(time, fit.profile, pulse_rate_hz=pulse_rate_hz)
        if np.isfinite(pulse).all():
            return pulse
    return pulses_from_pattern(fit.x, fit.y, fit.off, fit.profile)


def _measurement(plane, flat, near, fit, numbering, pulse):
    """The figures and their uncertainty from the fit of all profiles."""
    c, s = np.cos(fit.turn), np.sin(fit.turn)
    along, across = c * flat.axes[0] + s * flat.axes[1], c * flat.axes[1] - s * flat.axes[0]
    spacing, noise, slide = _spacing(fit, pulse)
    tilt = _tilt_covariance(fit)
    bias = _tilt_bias(fit, slide)
    gap, variance, functional = mean_gap(fit.numbers, fit.offsets, fit.variances, fit.counts)
    lever = functional @ fit.means
    by_tilt = np.array([0.0, fit.slide * gap])
    variance += lever @ fit.covariance @ lever + by_tilt @ tilt @ by_tilt
    angle, turn_by_tilt = _angle(flat.normal, along, across, fit.slide)
    angle_variance = fit.covariance[0, 0] + turn_by_tilt @ tilt @ turn_by_tilt
    mixed = turn_by_tilt @ tilt @ by_tilt - fit.covariance[0] @ lever
    gap, angle = gap - by_tilt @ bias, angle - turn_by_tilt @ bias
    spacing_variance = noise + (slide * spacing) ** 2 * tilt[0, 0]
    return PatternMeasurement(
        plane=plane,
        direction=along,
        numbering=numbering,
        profile=_profile_of_points(near, fit),
        profiles=len(fit.numbers),
        points=len(fit.x),
        profile_spacing_perpendicular_m=float(abs(gap)),
        profile_spacing_perpendicular_std=float(np.sqrt(variance)),
        profile_angle_deg=float(np.degrees(np.arccos(abs(np.cos(angle))))),
        profile_angle_std=float(np.degrees(np.sqrt(angle_variance))),
        point_spacing_m=float(spacing * (1 - slide * bias[0])),
        point_spacing_std=float(np.sqrt(spacing_variance)),
        covariance=float(np.sign(np.tan(angle) * gap) * mixed),
    )


def _spacing(fit, pulse):
    """Point spacing, its variance, the slide along profiles; NaN where pulses were not counted."""
    if not np.isfinite(pulse).all():
        return np.nan, np.nan, 0.0
    return point_spacing(fit.x, fit.y, fit.off, fit.profile, pulse)


def _profile_of_points(near, fit):
    """Profile of each point given, -1 for those left out."""
    profile = np.full(len(near), -1)
    profile[np.flatnonzero(near)[fit.used]] = fit.numbers[fit.profile]
    return profile


def _tilt_covariance(fit):
    """Covariance of the fitted plane's slopes along and across the profiles.

    Distances from the plane have a part of their own and one that a profile shares (attitude); the
    analysis of variance tells them apart. Range noise moves points in the plane as it moves them
    off it, which tilts the fit by a known bias: see ``_tilt_bias``.
    """
    terms = np.stack([np.ones_like(fit.x), fit.x, fit.y], axis=1)
    inverse = np.linalg.inv(terms.T @ terms)
    means = group_means(fit.off, fit.profile, fit.counts)
    about = fit.off - means[fit.profile]
    profiles = len(fit.counts)
    own = about @ about / max(len(fit.off) - profiles, 1)
    shared = 0.0
    if profiles > 3:
        between = fit.counts @ means**2 / (profiles - 3)
        shared = max(between - own, 0.0) / fit.counts.mean()
    sums = fit.counts[:, None] * group_means(terms, fit.profile, fit.counts)
    return (own * inverse + shared * inverse @ (sums.T @ sums) @ inverse)[1:, 1:]


def _tilt_bias(fit, slide):
    """Slopes that the plane gets because its noise lies along the beam and not along its normal."""
    place = np.stack([fit.x, fit.y]) - np.array([[fit.x.mean()], [fit.y.mean()]])
    noise = fit.off @ fit.off * np.array([slide, fit.slide])
    return np.linalg.solve(place @ place.T, noise)


def _angle(normal, along, across, slide):
    """Angle of the profiles from the horizontal line, and its derivatives by the plane's slopes.

    A plane that is fitted too steep shears the points, which slide to it along the beam, and turns
    its own horizontal line.
    """
    level = np.cross([0.0, 0.0, 1.0], normal)
    size = np.linalg.norm(level)
    if size < LEVEL:
        return np.nan, np.array([slide, 0.0])
    level = level / size
    slope = np.cross(normal, level)
    turning = np.cross([0.0, 0.0, 1.0], level) @ slope / size
    shear = np.array([slide, 0.0])
    return np.arctan2(along @ slope, along @ level), shear + turning * np.array(
        [level @ along, level @ across]
    )


@dataclass(frozen=True, eq=False)
class ScanPlanes:
    """Profiles of a scan as planes that follow each other.

    Parameters
    ----------
    normal : array, shape (3,)
        Of the scan plane, in the direction in which it moves.
    speed_m_s : float
        Of the plane along its normal, the vehicle taken to move without turning.
    scatter_m : float
        Robust standard deviation of the points about that plane.
    mirror_frequency_hz : float
    centre : array, shape (3,)
        Where the advance is ``advance_m``.
    advance_m, advance_std : float
        How far points at the same mirror angle move along the normal in a revolution.
    turning, turning_std : array, shape (3,)
        Change of that per metre of place, within the plane: a turn of the vehicle, m/m.
    points : int

    Examples
    --------
    >>> y, x = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    >>> still = {"turning": np.zeros(3), "turning_std": np.zeros(3), "points": 1000}
    >>> drive = {"speed_m_s": 10.0, "mirror_frequency_hz": 100.0, "advance_m": 0.1}
    >>> found = ScanPlanes(y, scatter_m=0.0, centre=x, advance_std=0.0, **drive, **still)
    >>> float(found.spacing_on(x, [1, 0, 0]))  # a wall beside the track
    0.1
    """

    normal: np.ndarray
    speed_m_s: float
    scatter_m: float
    mirror_frequency_hz: float
    centre: np.ndarray
    advance_m: float
    advance_std: float
    turning: np.ndarray
    turning_std: np.ndarray
    points: int

    @property
    def turn_rate_deg_s(self):
        """Turn of the plane about an axis in it, degrees per second."""
        return float(np.degrees(np.linalg.norm(self.turning) * self.mirror_frequency_hz))

    def advance_at(self, places):
        """How far the plane moves along its normal in a revolution at places (..., 3), metres."""
        return self.advance_m + (np.asarray(places, dtype=np.float64) - self.centre) @ self.turning

    def spacing_on(self, places, surface_normal):
        """Profile spacing, square to the profiles, on a surface through places, metres.

        Parameters
        ----------
        places : array_like, shape (..., 3)
        surface_normal : array_like, shape (3,)
        """
        normal = np.asarray(surface_normal, dtype=np.float64)
        crossing = np.linalg.norm(np.cross(self.normal, normal / np.linalg.norm(normal)))
        return self.advance_at(places) / crossing


def fit_scan_planes(points, gps_time, *, mirror_frequency_hz=None, phases=PHASES):
    """Fit the moving plane of a profile scanner to points of many surfaces.

    First n.P - v t = c, a plane in uniform motion (total least squares, Tukey's weights). Then, for
    points of the same mirror angle in successive revolutions, the displacement along n as
    a linear function of place: what MIMIC leaves out, the turn of the vehicle, is its slope.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Two revolutions or more of one scanner head, metres.
    gps_time : array_like, shape (n,)
        Seconds.
    mirror_frequency_hz : float, optional
        From the pauses of the times where left out.
    phases : int
        Parts of a revolution within which points are compared.

    Returns
    -------
    ScanPlanes

    Raises
    ------
    ValueError
        If there are fewer than two revolutions, or no points at the same angle in them.

    Examples
    --------
    >>> from mmqa_lab.simulate import ProfileScanner, Scene, ground, scan_all, straight, wall
    >>> street = Scene([ground(), wall((5, 9, 0), (0, -20, 0), 8)])
    >>> scanner = ProfileScanner(pulse_rate_hz=36_000, mirror_frequency_hz=100, heading_deg=60)
    >>> cloud = scan_all(street, scanner, straight(1, 10, start=(0, 0, 2)), seed=1)
    >>> found = fit_scan_planes(cloud.points, cloud["gps_time"], mirror_frequency_hz=100)
    >>> round(found.speed_m_s, 3)  # of the plane along its normal: 10 cos(60 degrees)
    5.0
    """
    points = check_points(points, minimum=20)
    time = np.asarray(gps_time, dtype=np.float64)
    if time.shape != (len(points),) or not np.isfinite(time).all():
        raise ValueError(f"Invalid gps_time of shape {time.shape}. Must be {len(points)} seconds.")
    since = time - time.min()
    number = revolutions_from_time(since, mirror_frequency_hz=mirror_frequency_hz)
    if number.max() < 1:
        raise ValueError("Invalid gps_time within one revolution. Must span two or more.")
    frequency = mirror_frequency_hz or mirror_frequency(since)
    centre = points.mean(axis=0)
    local = points - centre
    normal, speed, residuals = _moving_plane(local, since)
    if speed < 0:
        normal, speed = -normal, -speed
    axes = np.linalg.svd(normal[None])[2][1:]
    frequency = check_positive(frequency, "mirror_frequency_hz", unit="Hz")
    phase = np.floor(since * frequency % 1 * phases)
    found, used = _displacement(local, local @ normal, number, phase, axes)
    spread = np.sqrt(np.diag(found.covariance))
    return ScanPlanes(
        normal=normal,
        speed_m_s=float(speed),
        scatter_m=sigma_mad(residuals),
        mirror_frequency_hz=float(frequency),
        centre=centre,
        advance_m=float(found.coefficients[0]),
        advance_std=float(spread[0]),
        turning=found.coefficients[1:3] @ axes,
        turning_std=spread[1:3] @ np.abs(axes),
        points=used,
    )


def _moving_plane(local, since, rounds=50):
    """Normal and speed of a plane in uniform motion, and the points' distances from it."""
    weights = np.ones(len(local))
    for _ in range(rounds):
        share = weights / weights.sum()
        time, place = since - share @ since, local - share @ local
        velocity = (share * time) @ place / (share @ time**2)
        still = place - np.outer(time, velocity)
        normal = np.linalg.eigh((still * share[:, None]).T @ still)[1][:, 0]
        residuals = still @ normal
        sigma = max(sigma_mad(residuals), 1e-9)
        u = residuals / (TUKEY * sigma)
        previous, weights = weights, np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)
        if np.abs(weights - previous).max() < 1e-6:
            break
    return normal, normal @ velocity, residuals


def _displacement(local, height, number, phase, axes, rounds=4):
    """Displacement per revolution and its slopes, from points of the same mirror angle."""
    place = number[:, None] * np.column_stack([np.ones(len(local)), local @ axes.T])
    kept = np.arange(len(local))
    for _ in range(rounds):
        group = np.unique(phase[kept], return_inverse=True)[1]
        found = solve_groups(place[kept], height[kept], group)
        sigma = max(sigma_mad(found.residuals), 1e-9)
        inside = np.abs(found.residuals) <= 4 * sigma
        if inside.all():
            break
        kept = kept[inside]
    return found, len(found.residuals)
