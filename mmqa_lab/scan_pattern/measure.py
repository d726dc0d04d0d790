"""Scan patterns measured: in the points of a planar patch, and in a whole street with time.

In place of distances clicked between points (Cahalane et al. 2014, sections 4.1.2 and 4.2.2), all
profiles of a patch are fitted at once, and every figure comes with its standard deviation. The
times of a whole street give the moving plane of the scanner. Which profile and which pulse a point
belongs to is found from time, or from the pattern alone.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len, rfft2
from scipy.linalg import null_space
from scipy.optimize import minimize

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.planes import TUKEY, Plane, fit_plane, sigma_mad
from mmqa_lab.scan_pattern.lattice import LEVEL, QUANTITIES

PAUSE = 20  # of the typical step of time: longer ones separate runs of points
FEW = 16  # runs whose beginnings are compared for the period
SHARE = 0.35  # of the strongest peak: weaker ones are not taken for the fundamental
# Widest gap between profiles that is looked for, metres; never more than 0.45 of the patch.
WIDEST = 0.5
# Families of lines that are more than so many times closer than the densest are not tried.
CLOSE = 3
SUMS = (
    *((0, 1), (1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2)),
    *((3, 1), (3, -1), (1, 3), (1, -3), (3, 2), (3, -2), (2, 3), (2, -3)),
)
"""Of two waves: the families of lines that are tried."""

# Scatter of the pulses about whole numbers, in pulses, above which they cannot be counted.
UNSURE = 0.2
# Share of neighbours of equal time above which a clock is too coarse for counting pulses.
TIES = 0.02
# Points from which on pulse over place is a polynomial of degree 2, 3, 4, 5.
POINTS_FOR_DEGREE = (60, 150, 600, 2000)

OFF_LINE = 4.0  # points farther off their profile, in robust standard deviations, are left out
ROUNDS = 20  # of leaving out points off the moving plane, at most
MANY = 150  # points from which on curvature, twist and the turning of the beam are fitted too
GRID = 9  # nodes for each of the two unknown variances of the mean gap
# More profiles than that are averaged in so many blocks: matrices are this large at most.
MOST = 300
SPARSEST = 5  # times as far apart as profiles: points along them, in patterns of slow vehicles
DENSEST_TAKEN = (
    "Told from the pattern alone: the lines with the densest points are taken for the profiles. "
    "Where points lie farther apart along a profile than profiles do, they are not: give gps_time "
    "or scan_line."
)
CLEAR = 1 / 3  # the straightest lines are taken if points stray from others three times as far
ENOUGH = 1500  # points from which straying from the lines of a family is found
PHASES = 1500  # parts of a revolution within which the beam is taken to have one direction


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
    profile_spacing_perpendicular_m : float
        The mean gap between neighbouring profiles over the patch.
    profile_spacing_horizontal_m, profile_spacing_vertical_m : float
        The same along the horizontal line of the plane and along its line of greatest slope, the
        latter badly determined above 75 degrees.
    profile_angle_deg, point_spacing_m : float
        The angle from the horizontal line and the spacing of points along a profile at the
        reference point. NaN where not measurable.
    std : dict of str to float
        The standard deviations of these five, by their names.

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
    profile_spacing_horizontal_m: float
    profile_spacing_vertical_m: float
    profile_angle_deg: float
    point_spacing_m: float
    std: dict

    def to_frame(self) -> pd.DataFrame:
        """Return ``quantity``, ``measured``, ``std``, ``n`` (profiles or points), ``remarks``."""
        found = {"quantity": list(self.std), "measured": [getattr(self, one) for one in self.std]}
        counts = [self.profiles] * 4 + [self.points]
        gap, along = self.profile_spacing_perpendicular_m, self.point_spacing_m
        doubtful = self.numbering == "pattern" and along < gap < SPARSEST * along
        remarks = DENSEST_TAKEN if doubtful else ""
        return pd.DataFrame(found | {"std": self.std.values(), "n": counts, "remarks": remarks})


def measure_pattern(
    points: ArrayLike,
    *,
    gps_time: ArrayLike | None = None,
    scan_line: ArrayLike | None = None,
    mirror_frequency_hz: float | None = None,
    pulse_rate_hz: float | None = None,
    reference: ArrayLike | None = None,
) -> PatternMeasurement:
    """Measure the scan pattern of a planar patch.

    Profiles are numbered by ``scan_line`` or from ``gps_time``, else from the pattern alone. One
    direction, one curvature and one way of sliding along the beam (range noise moves points off
    the plane and across the profiles at the same time) are fitted to all profiles at once; the mean
    gap follows from their offsets (``mean_gap``). Points along a profile are counted by
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
    if line is not None:
        numbers, numbering = line[near].astype(np.int64), "scan_line"
    elif time is not None:
        numbers = revolutions_from_time(time[near], mirror_frequency_hz=mirror_frequency_hz)
        numbering = "gps_time"
    else:
        numbers, numbering = _straightest(uv, flat.residuals), "pattern"
    fit = _fit_profiles(uv, flat.residuals, numbers)
    picked = None if time is None else time[near][fit.used]
    profile = np.full(len(points), -1)
    profile[np.flatnonzero(near)[fit.used]] = fit.numbers[fit.profile]
    return PatternMeasurement(
        plane=plane,
        numbering=numbering,
        profile=profile,
        profiles=len(fit.numbers),
        points=len(fit.x),
        **_figures(fit, flat, _pulses(fit, picked, pulse_rate_hz)),
    )


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


def _straightest(uv, off):
    """The family of lines from which points stray least, or the densest where that is not clear."""
    families = profiles_from_pattern(uv)
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
            stacklevel=3,
        )
    return families[0]


def _stray(uv, off, numbers):
    """Scatter of points about their lines as a share of the lines' gap, and that gap, metres."""
    full = _full(numbers)
    present, profile = np.unique(numbers[full], return_inverse=True)
    if len(present) < 2:
        return np.inf, 0.0
    x, y = _along(uv[full], _first_direction(uv[full], profile))
    found = solve_groups(_shared_terms(x, y, off[full]), y, profile)
    gap = abs(np.polyfit(present, found.constants, 1)[0])
    return max(sigma_mad(found.residuals), 1e-9) / gap, gap


class ProfileFit(NamedTuple):
    """Parallel profiles in the plane: x along them, y across, both from the reference."""

    turn: float  # of x from the first axis of the plane, radians
    x: np.ndarray  # of the points used, metres
    y: np.ndarray
    off: np.ndarray  # from the plane
    profile: np.ndarray  # place of each point's profile in numbers
    used: np.ndarray  # which of the given points these are
    numbers: np.ndarray
    offsets: np.ndarray  # y of each profile at x = 0
    variances: np.ndarray  # of the offsets, from the scatter along the profile
    means: np.ndarray  # of the shared terms over each profile
    covariance: np.ndarray  # of the shared terms' coefficients, the first of which is the slope
    slide: float  # metres across the profiles for each metre off the plane: along the beam


def _fit_profiles(uv, off, numbers):
    """Fit one direction to all profiles; points that stray are left out."""
    kept, turn = np.arange(len(uv)), None
    for _ in range(3):
        kept = kept[_full(numbers[kept])]
        present, profile, counts = np.unique(numbers[kept], return_inverse=True, return_counts=True)
        if len(present) < 2:
            raise ValueError(
                f"Invalid patch: {len(present)} profiles of 3 or more points. Must be 2."
            )
        if turn is None:
            turn = _first_direction(uv[kept], profile)
        turn, x, y, found = _aligned(uv[kept], off[kept], profile, turn)
        used, far = kept, OFF_LINE * max(sigma_mad(found.residuals), 1e-9)
        kept = kept[np.abs(found.residuals) <= far]
        if len(kept) == len(used):
            break
    variances, slide = max(found.variance, 1e-18) / counts, found.coefficients[1]
    lines = present, found.constants, variances, found.means, found.covariance
    return ProfileFit(turn, x, y, off[used], profile, used, *lines, slide)


def _full(numbers):
    """Which points belong to profiles of three points or more."""
    _, place, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    return counts[place] >= 3


def _first_direction(uv, profile):
    """Direction of the largest pooled scatter within profiles, radians from the first axis."""
    about = uv - group_means(uv, profile)[profile]
    _, vectors = np.linalg.eigh(about.T @ about)
    return np.arctan2(vectors[1, 1], vectors[0, 1])


def _aligned(uv, off, profile, turn):
    """Turn the axes until the profiles' slope is zero; the solution in the last ones."""
    for _ in range(20):
        x, y = _along(uv, turn)
        found = solve_groups(_shared_terms(x, y, off), y, profile)
        slope = found.coefficients[0]
        if abs(slope) < 1e-9:
            break
        turn += np.arctan(slope)
    return turn, x, y, found


def _along(uv, turn):
    """Coordinates along a direction and across it."""
    c, s = np.cos(turn), np.sin(turn)
    return uv @ [c, s], uv @ [-s, c]


def _shared_terms(x, y, off):
    """What all profiles share: slope and slide; turning of the beam, curvature and twist."""
    terms = [x, off]
    if len(x) >= MANY:
        terms += [off * x, off * y, x**2, x * y]
    return np.stack(terms, axis=1)


def _pulses(fit, time, pulse_rate_hz):
    """Pulse counts of the points used: by time, by the pattern where time is none or coarse."""
    if time is not None:
        pulse = pulses_from_time(time, fit.profile, pulse_rate_hz=pulse_rate_hz)
        if np.isfinite(pulse).all():
            return pulse
    return pulses_from_pattern(fit.x, fit.y, fit.off, fit.profile)


def _figures(fit, flat, pulse):
    """The figures with their standard deviations, and the direction, from the fit of all profiles.

    A plane that is fitted with wrong slopes (``tilt`` is their covariance, ``bias`` what they are
    wrong by on average) stretches spacings and turns profiles, since points slide to it along the
    beam.
    """
    along, across = np.array(_along(np.eye(2), fit.turn)) @ flat.axes
    spacing, noise, slide = point_spacing(fit.x, fit.y, fit.off, fit.profile, pulse)
    tilt, bias = _tilt(fit, slide)
    gap, variance, functional = mean_gap(
        fit.numbers, fit.offsets, fit.variances, np.bincount(fit.profile)
    )
    angle, turn_by_tilt = _angle(flat.normal, along, across, fit.slide)
    by_tilt = np.stack([[0.0, fit.slide * gap], turn_by_tilt])
    lever = functional @ fit.means
    mixed = -fit.covariance[0] @ lever
    own = [[variance + lever @ fit.covariance @ lever, mixed], [mixed, fit.covariance[0, 0]]]
    gap, angle = np.array([gap, angle]) - by_tilt @ bias
    folded = np.diag([np.copysign(1.0, gap), np.copysign(1.0, np.tan(angle))])
    covariance = folded @ (own + by_tilt @ tilt @ by_tilt.T) @ folded
    gap, angle = abs(gap), np.arccos(abs(np.cos(angle)))
    c, s = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = [gap, gap / s, gap / c, np.degrees(angle), spacing * (1 - slide * bias[0])]
        slopes = [[1, 0], [1 / s, -gap * c / s**2], [1 / c, gap * s / c**2], [0, 180 / np.pi]]
    variances = [row @ covariance @ row for row in np.array(slopes)]
    variances += [noise + (slide * spacing) ** 2 * tilt[0, 0]]
    stds = np.sqrt(np.maximum(variances, 0.0)).tolist()
    figures = dict(zip(QUANTITIES, map(float, values), strict=False))
    return {"direction": along, "std": dict(zip(QUANTITIES, stds, strict=False)), **figures}


def _tilt(fit, slide):
    """Covariance of the fitted plane's slopes along and across the profiles, and their bias.

    Distances from the plane have a part of their own and one that a profile shares (attitude); the
    analysis of variance tells them apart. The bias comes from noise along the beam in place of the
    normal: it moves points in the plane as it moves them off it.
    """
    terms = np.stack([np.ones_like(fit.x), fit.x, fit.y], axis=1)
    inverse = np.linalg.inv(terms.T @ terms)
    counts, means = np.bincount(fit.profile), group_means(fit.off, fit.profile)
    about = fit.off - means[fit.profile]
    own = about @ about / max(len(about) - len(counts), 1)
    shared = 0.0
    if len(counts) > 3:
        between = counts @ means**2 / (len(counts) - 3)
        shared = max(between - own, 0.0) / counts.mean()
    sums = counts[:, None] * group_means(terms, fit.profile)
    covariance = own * inverse + shared * inverse @ (sums.T @ sums) @ inverse
    place = np.stack([fit.x - fit.x.mean(), fit.y - fit.y.mean()])
    noise = fit.off @ fit.off * np.array([slide, fit.slide])
    return covariance[1:, 1:], np.linalg.solve(place @ place.T, noise)


def _angle(normal, along, across, slide):
    """Angle of the profiles from the horizontal line, and its derivatives by the plane's slopes.

    A plane that is fitted too steep shears the points, which slide to it along the beam, and turns
    its own horizontal line.
    """
    level = np.cross([0.0, 0.0, 1.0], normal)
    size = np.linalg.norm(level)
    shear = np.array([slide, 0.0])
    if size < LEVEL:
        return np.nan, shear
    level = level / size
    slope = np.cross(normal, level)
    turning = np.cross([0.0, 0.0, 1.0], level) @ slope / size
    angle = np.arctan2(along @ slope, along @ level)
    return angle, shear + turning * np.array([level @ along, level @ across])


def mean_gap(numbers, offsets, variances, weights):
    """Return the mean gap between profiles over a patch, its variance, and how offsets change it.

    What is wanted is the mean over all points of the gap where they lie, not the slope of a line
    through the offsets: where speed drifts, the two differ. Offsets are taken as a straight line,
    plus what a randomly changing speed adds to it (an integrated random walk), plus white errors of
    known variance, plus white errors that all points of a profile share (attitude). The mean gap is
    the best linear prediction from them. The variances of the second and the fourth are unknown:
    their restricted likelihood weighs the answers of a grid of them, and the spread of the answers
    adds to the variance.

    A weighted slope with a standard error after Newey and West is simpler, but of speeds that
    wander by 1 % over 0.5 s its 95 % intervals contain 24 to 74 % of the true means, and on patches
    of 2 m its errors are twice as large.

    Parameters
    ----------
    numbers : array, shape (n,)
        Number of each profile, increasing; numbers may be missing. n >= 2.
    offsets : array, shape (n,)
        Across the profiles, metres.
    variances : array, shape (n,)
        Of the offsets, m2, above zero.
    weights : array, shape (n,)
        Points of each profile.

    Returns
    -------
    gap : float
        Metres; negative if offsets fall.
    variance : float
        m2.
    functional : array, shape (n,)
        What the gap changes by when an offset does, m/m.

    Examples
    --------
    >>> gap, variance, _ = mean_gap([0, 1, 3], [0.0, 0.05, 0.15], [1e-8] * 3, [60, 60, 60])
    >>> round(gap, 4)
    0.05
    """
    x, offsets, variances, weights = (
        np.asarray(values, dtype=np.float64) for values in (numbers, offsets, variances, weights)
    )
    if len(x) > MOST:
        blocks = np.arange(len(x)) * MOST // len(x)
        share = weights / np.bincount(blocks, weights)[blocks]
        parts = (x * share, offsets * share, variances * share**2, weights)
        gap, variance, functional = mean_gap(*(np.bincount(blocks, part) for part in parts))
        return gap, variance, functional[blocks] * share
    line = np.stack([np.ones_like(x), x - x.mean()], axis=1)
    slope = np.linalg.pinv(line)[1]
    if len(x) == 2:
        return float(slope @ offsets), float(slope**2 @ variances), slope
    contrasts = null_space(line.T)
    walk, both, own = _walk(x - x[0], weights / weights.sum())
    seen, noise = contrasts.T @ offsets, (contrasts.T * variances) @ contrasts
    # what the mean slope differs by from that of the line: its variance, and how contrasts tell it
    noisy, drifting = -contrasts.T @ (variances * slope), contrasts.T @ (both - walk @ slope)
    spread = slope**2 @ variances, own - 2 * slope @ both + slope @ walk @ slope
    walk = contrasts.T @ walk @ contrasts
    shared, speeds = _grid(seen, variances, np.ptp(x))
    answers = []
    for speed in speeds**2:
        values, vectors = np.linalg.eigh(noise + speed * walk)
        power = np.maximum(values, variances.min()) + shared[:, None] ** 2
        residual, tells = vectors.T @ seen, vectors.T @ (noisy + speed * drifting)
        likelihood = -0.5 * (np.log(power) + residual**2 / power).sum(axis=1)
        left = spread[0] + shared**2 * (slope @ slope) + speed * spread[1]
        answers.append(
            (likelihood, left - (tells**2 / power).sum(axis=1), tells / power @ vectors.T)
        )
    likelihood, left, telling = (np.concatenate(part) for part in zip(*answers, strict=True))
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    added = telling @ seen
    gap = slope @ offsets + share @ added
    variance = share @ left + share @ (added - share @ added) ** 2
    return float(gap), float(variance), slope + contrasts @ (share @ telling)


def _walk(x, share):
    """Covariance of offsets of an integrated random walk, of its mean slope with them, own."""
    low, high = np.minimum.outer(x, x), np.maximum.outer(x, x)
    offsets = low**2 * (3 * high - low) / 6
    return offsets, share @ (low * x - low**2 / 2), share @ low @ share


def _grid(seen, variances, length):
    """Standard deviations of what profiles share, and of the speed's change in a profile.

    A walk with 420 d^2 / length^3 for the variance of that drifts by d from a line fitted to it.
    """
    largest = 3 * np.sqrt(np.mean(seen**2) + np.mean(variances))
    smallest = max(0.05 * min(np.sqrt(np.median(variances)), largest), largest / 500)
    nodes = np.append(0.0, np.geomspace(smallest, largest, GRID - 1))
    return nodes, nodes * np.sqrt(420 / length**3)


@dataclass(frozen=True, eq=False)
class ScanPlanes(Shown):
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
    advance_m : float
        How far points at the same mirror angle move along the normal in a revolution.
    turning : array, shape (3,)
        Change of that per metre of place, within the plane: a turn of the vehicle, m/m.

    Examples
    --------
    >>> y, x = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    >>> found = ScanPlanes(y, 10.0, 0.0, 100.0, centre=x, advance_m=0.1, turning=np.zeros(3))
    >>> float(found.spacing_on(x, [1, 0, 0]))  # a wall beside the track
    0.1
    """

    normal: np.ndarray
    speed_m_s: float
    scatter_m: float
    mirror_frequency_hz: float
    centre: np.ndarray
    advance_m: float
    turning: np.ndarray

    def spacing_on(self, places: ArrayLike, surface_normal: ArrayLike) -> np.ndarray:
        """Profile spacing, square to the profiles, on a surface through places, metres.

        Parameters
        ----------
        places : array_like, shape (..., 3)
        surface_normal : array_like, shape (3,)
        """
        normal = np.asarray(surface_normal, dtype=np.float64)
        crossing = np.linalg.norm(np.cross(self.normal, normal / np.linalg.norm(normal)))
        from_centre = np.asarray(places, dtype=np.float64) - self.centre
        return (self.advance_m + from_centre @ self.turning) / crossing


def fit_scan_planes(
    points: ArrayLike, gps_time: ArrayLike, *, mirror_frequency_hz: float | None = None
) -> ScanPlanes:
    """Fit the moving plane of a profile scanner to points of many surfaces.

    First n.P - v t = c, a plane in uniform motion (Tukey's weights). Then, for
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
    since = _column(gps_time, "gps_time", len(points))
    since = since - since.min()
    number = revolutions_from_time(since, mirror_frequency_hz=mirror_frequency_hz)
    if number.max() < 1:
        raise ValueError("Invalid gps_time within one revolution. Must span two or more.")
    frequency = mirror_frequency_hz or mirror_frequency(since)
    centre = points.mean(axis=0)
    local = points - centre
    velocity, plane = _moving_plane(local, since)
    normal = plane.normal * np.sign(plane.normal @ velocity)
    phase = np.floor(since * frequency % 1 * PHASES)
    advance, *turning = _displacement(local, local @ normal, number, phase, plane.axes)
    return ScanPlanes(
        normal=normal,
        speed_m_s=float(normal @ velocity),
        scatter_m=sigma_mad(plane.residuals),
        mirror_frequency_hz=float(frequency),
        centre=centre,
        advance_m=float(advance),
        turning=turning @ plane.axes,
    )


def _moving_plane(local, since):
    """Velocity of points of a plane in uniform motion, and the plane to which that brings them."""
    inside = np.ones(len(local), dtype=bool)
    for _ in range(ROUNDS):
        velocity = np.polyfit(since[inside], local[inside], 1)[0]
        plane = fit_plane(local - np.outer(since - since.mean(), velocity), robust=True)
        near = np.abs(plane.residuals) <= TUKEY * max(sigma_mad(plane.residuals), 1e-9)
        if (near == inside).all():
            break
        inside = near
    return velocity, plane


def _displacement(local, height, number, phase, axes):
    """Displacement per revolution and its slopes, from points of the same mirror angle."""
    place = number[:, None] * np.column_stack([np.ones(len(local)), local @ axes.T])
    kept = np.arange(len(local))
    for _ in range(4):
        group = np.unique(phase[kept], return_inverse=True)[1]
        found = solve_groups(place[kept], height[kept], group)
        kept = kept[np.abs(found.residuals) <= OFF_LINE * max(sigma_mad(found.residuals), 1e-9)]
    return found.coefficients


def revolutions_from_time(
    time: ArrayLike, *, mirror_frequency_hz: float | None = None
) -> np.ndarray:
    """Return the number of the revolution of each point, from 0.

    Revolutions are cut in the longest pause of their phase: while the beam is off the patch.

    Parameters
    ----------
    time : array_like, shape (n,)
        Seconds.
    mirror_frequency_hz : float, optional
        ``mirror_frequency`` of the times where left out.

    Returns
    -------
    array of int, shape (n,)

    Raises
    ------
    ValueError
        If the frequency is not above zero, or none shows in the times.

    Examples
    --------
    >>> pulses = np.arange(5) * 1e-5
    >>> revolutions_from_time(np.concatenate([pulses, pulses + 0.01, pulses + 0.03])).tolist()
    [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 3, 3, 3, 3, 3]
    """
    since = np.asarray(time, dtype=np.float64) - np.min(time)
    if mirror_frequency_hz is None:
        frequency = mirror_frequency(since)
    else:
        frequency = check_positive(mirror_frequency_hz, "mirror_frequency_hz", unit="Hz")
    number = np.floor(since * frequency - _longest_pause(since, frequency)[1]).astype(np.int64)
    return number - number.min()


def mirror_frequency(time):
    """Return the revolutions per second that the times of the points show.

    Of the periods between the beginnings of runs of points, that one is taken which leaves the
    longest part of a revolution without any point; then a line is fitted through the middles of the
    revolutions, without the first and the last, which may be cut. Where the patch is not
    symmetrical about the direction of travel its outline shifts from profile to profile, by a few
    pulses of some thousand: the answer is good to 0.1 %.

    Examples
    --------
    >>> round(mirror_frequency(np.add.outer([0, 0.01, 0.03], np.arange(5) * 1e-5).ravel()), 6)
    100.0
    """
    order = np.sort(np.asarray(time, dtype=np.float64) - np.min(time))
    step = np.diff(order)
    typical = np.median(step[step > 0]) if (step > 0).any() else np.inf
    begins = np.append(0.0, order[1:][step > PAUSE * typical])[:FEW]
    periods = np.unique(np.subtract.outer(begins, begins))
    periods = periods[periods > 0]
    if not len(periods):
        raise ValueError(
            "Invalid time without pauses between profiles. Must have a mirror_frequency_hz or a "
            "scan_line with it."
        )
    pauses = np.array([_longest_pause(order, 1 / period)[0] for period in periods])
    frequency = 1 / np.median(periods[pauses > 0.95 * pauses.max()])
    number = revolutions_from_time(order, mirror_frequency_hz=frequency)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    whole = slice(1, -1) if len(first) > 3 else slice(None)
    middles = (order[first] + order[last]) / 2
    return float(1 / np.polyfit(number[first][whole], middles[whole], 1)[0])


def _longest_pause(since, frequency):
    """Longest part of a revolution without points, and the phase in its middle."""
    phase = np.sort(since * frequency % 1)
    pause = np.diff(np.append(phase, phase[0] + 1))
    longest = np.argmax(pause)
    return pause[longest], phase[longest] + pause[longest] / 2


def profiles_from_pattern(xy):
    """Return the number of the profile of each point, found from the pattern alone.

    The structure factor |sum exp(i k.p)|^2 / n, points faded out to the outline, has its peaks
    where points lie on lines 2 pi / |k| apart. The fundamental is the smallest k whose peak reaches
    35 % of the highest: the family of lines with the densest points. Where a second family is up to
    three times as close, the points of a lattice lie on many families of lines, sums of the two.

    Profiles are the densest family only where points lie closer along a profile than profiles to
    each other. Otherwise give time or scan line, or see how far points stray from the lines
    (``measure_pattern`` does): on 30 simulated walls whose points are 1 to 4 times as far apart as
    their profiles the first family is right on 3, that of the straightest lines on 25.

    Parameters
    ----------
    xy : array, shape (n, 2)
        In the plane, metres.

    Returns
    -------
    list of array of int, shape (n,)
        A number for each point, for each family; that with the densest points first.

    Raises
    ------
    ValueError
        If no peak stands out of those that random points make.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(-50, 51) * 0.01, np.arange(-5, 6) * 0.05)
    >>> (number,) = profiles_from_pattern(np.stack([x.ravel(), y.ravel()], axis=1))
    >>> int(np.ptp(number)) + 1
    11
    """
    low, high = xy.min(axis=0), xy.max(axis=0)
    pattern = _Pattern(xy - (low + high) / 2, high - low)
    spectrum = pattern.spectrum()
    first = pattern.refined(_fundamental(*spectrum))
    power, chance = pattern.power(first), 2 * np.log(len(xy)) + 10
    if power < chance:
        raise ValueError(
            f"Invalid pattern: its strongest lines have power {power:.0f} among {len(xy)} points. "
            f"Must be more than {chance:.0f}, what random points can reach; or give time."
        )
    waves = [first]
    others = _off_the_line(*spectrum, first, 12 * np.pi / pattern.extent.max())
    if others.max() >= chance * pattern.total:
        second = pattern.refined(_fundamental(others, *spectrum[1:]))
        waves += [m * first + n * second for m, n in SUMS]
    return [pattern.numbers(wave) for wave in waves if pattern.power(wave) >= chance]


class _Pattern:
    """Points about the middle of their box, faded out to the outline, which has its own pattern."""

    def __init__(self, xy, extent):
        inside = 1 - np.sum((2 * xy / extent) ** 2, axis=1)
        self.xy, self.extent = xy, extent
        self.fading = np.maximum(inside, 0.0) ** 2
        self.total = (self.fading**2).sum()
        self.slowest = 2 * np.pi / min(WIDEST, 0.45 * extent.max())

    def amplitude(self, wave):
        """Sum of exp(i k.p) over the points."""
        return (self.fading * np.exp(1j * (self.xy @ wave))).sum()

    def power(self, wave):
        """Structure factor at one wave vector: about 1 where points are random."""
        return np.abs(self.amplitude(wave)) ** 2 / self.total

    def numbers(self, wave):
        """Number of the line of each point, lines square to a wave."""
        turns = (self.xy @ wave - np.angle(self.amplitude(wave))) / (2 * np.pi)
        return np.round(turns).astype(np.int64)

    def spectrum(self):
        """Power times ``total``, and waves, on the grid of a histogram's transform.

        Where rows are denser than they are apart, they are more than 0.9 / sqrt(density) apart;
        half of that makes room for patches that do not fill their box.
        """
        edge, narrowest = (
            1.25 * self.extent.max(),
            0.5 * np.sqrt(self.extent.prod() / len(self.xy)),
        )
        size = next_fast_len(int(np.clip(5 * edge / narrowest, 64, 4096)), real=True)
        cell = np.floor((self.xy / edge + 1) * size / 2).astype(np.int64)
        counts = np.bincount(cell @ [size, 1], weights=self.fading, minlength=size**2)
        power = np.abs(rfft2(counts.reshape(size, size))) ** 2
        kx = np.fft.fftfreq(size, 1 / size)[:, None] * np.pi / edge
        ky = np.arange(power.shape[1]) * np.pi / edge
        square = kx**2 + ky**2
        power[(square < self.slowest**2) | (square > (2 * np.pi / narrowest) ** 2)] = 0
        return power, kx, ky

    def refined(self, wave):
        """The peak of the structure factor near a wave vector, that of no wave too long."""

        def lack(k):
            return -self.power(k) if np.hypot(*k) >= self.slowest else 0.0

        step = 2 * np.pi / self.extent.max()
        tried = 0.25 * step * np.arange(-4, 5)
        east, north = np.exp(1j * np.multiply.outer(self.xy.T, tried))
        here = self.fading * np.exp(1j * (self.xy @ wave))
        power = np.abs(east.T @ (here[:, None] * north))
        power[np.hypot(wave[0] + tried[:, None], wave[1] + tried) < self.slowest] = 0
        best = np.unravel_index(np.argmax(power), power.shape)
        start = wave + tried[list(best)]
        simplex = start + 0.2 * step * np.array([[0, 0], [0.5, 0], [0, 0.5]])
        options = {"xatol": 1e-3 * step, "fatol": 1.0, "initial_simplex": simplex}
        return minimize(lack, start, method="Nelder-Mead", options=options).x


def _fundamental(power, kx, ky):
    """The smallest wave whose power reaches a share of the highest."""
    i, j = np.nonzero(power >= SHARE * power.max())
    nearest = np.argmin(np.hypot(kx[i, 0], ky[j]))
    return np.array([kx[i[nearest], 0], ky[j[nearest]]])


def _off_the_line(power, kx, ky, first, width):
    """Power of the waves off the line of the first and up to ``CLOSE`` times as large."""
    across = np.abs(first[0] * ky - first[1] * kx) > width * np.hypot(*first)
    near = kx**2 + ky**2 <= CLOSE**2 * (first @ first)
    return np.where(near & across, power, 0.0)


class GroupSolution(NamedTuple):
    """Least squares with a constant for each group."""

    coefficients: np.ndarray
    constants: np.ndarray
    means: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    variance: float


def solve_groups(terms, values, group):
    """Least squares of ``values`` on shared terms and one constant for each group.

    Terms without any spread (distances from a plane without noise) get coefficient and variance 0.
    """
    means, level = group_means(terms, group), group_means(values, group)
    about, target = terms - means[group], values - level[group]
    scale = np.sqrt(np.mean(about**2, axis=0))
    scale[scale <= 1e-9 * scale.max()] = np.inf
    about /= scale
    inverse = np.linalg.pinv(about.T @ about, rcond=1e-12)
    scaled = inverse @ (about.T @ target)
    residuals = target - about @ scaled
    free = max(len(values) - len(level) - np.isfinite(scale).sum(), 1)
    variance = residuals @ residuals / free
    coefficients = scaled / scale
    covariance = variance * inverse / np.outer(scale, scale)
    return GroupSolution(
        coefficients, level - means @ coefficients, means, covariance, residuals, variance
    )


def group_means(values, group):
    """Means of numbers, or of the rows of a matrix, over groups, (m, ...)."""
    if values.ndim == 2:
        return np.stack([group_means(column, group) for column in values.T], axis=1)
    return np.bincount(group, values) / np.bincount(group)


def pulses_from_time(time, profile, *, pulse_rate_hz=None):
    """Return pulse counts from time; not whole where time is coarse, NaN if it does not count."""
    if pulse_rate_hz is None:
        period = pulse_period(time, profile)
    else:
        period = 1 / check_positive(pulse_rate_hz, "pulse_rate_hz", unit="Hz")
    return (time - time.min()) / period


def pulse_period(time, profile):
    """Return the time from pulse to pulse, seconds, from the times of the points of profiles.

    NaN where points of a profile share times: the clock is then coarser than the pulses.

    Examples
    --------
    >>> time = np.array([0, 1, 2, 4, 5, 7, 8]) * 1e-5
    >>> round(pulse_period(time, np.zeros(7, dtype=int)), 9)
    1e-05
    """
    order = np.lexsort((time, profile))
    since, group = (time - time.min())[order], np.unique(profile[order], return_inverse=True)[1]
    step, same = np.diff(since), np.diff(group) == 0
    if not same.any() or np.mean(step[same] > 0) < 1 - TIES:
        return np.nan
    period = np.quantile(step[same & (step > 0)], 0.25)
    for _ in range(5):
        count = np.where(same, np.round(step / period), 0.0)
        pulse = np.append(0.0, np.cumsum(count))
        period = solve_groups(pulse[:, None], since, group).coefficients[0]
    return float(period)


def pulses_from_pattern(x, y, off, profile):
    """Return pulse counts within profiles from the points' places, NaN if they blur.

    Neighbours along profiles give a first spacing, and how range noise slides points. From a spot
    in the middle outwards, every point is then rounded to the count that fits a smooth model of
    count over place, with a phase of its own for each profile, and the model fitted again.
    """
    blurred = np.full(len(x), np.nan)
    spacing, slide = _first_spacing(x, off, profile)
    if not spacing > 0:
        return blurred
    terms = np.stack([x, off, x**2, x * y], axis=1)
    model, spread = np.array([1.0, -slide, 0.0, 0.0]) / spacing, np.inf
    place = np.maximum(np.abs(x), np.abs(y))
    reach = 8 * spacing
    while reach <= place.max():
        inside = place <= reach
        if inside.sum() >= 12:
            model, spread = _rounded_fit(model, terms[inside], profile[inside])
        reach *= 1.4
    model, spread = _rounded_fit(model, terms, profile)
    return _rounded(terms @ model, profile) if spread <= UNSURE else blurred


def _rounded_fit(model, terms, profile):
    """Count pulses by the model, fit it to the counts, four times; the model and its scatter."""
    group = np.unique(profile, return_inverse=True)[1]
    for _ in range(4):
        found = solve_groups(terms, _rounded(terms @ model, group), group)
        model = found.coefficients
    return model, np.sqrt(found.variance)


def _rounded(smooth, group):
    """Counts less the part of a pulse by which a profile is late (a mean on the circle), whole."""
    turn = 2 * np.pi * smooth
    late = np.arctan2(*(group_means(part(turn), group) for part in (np.sin, np.cos))) / (2 * np.pi)
    return np.round(smooth - late[group])


def _first_spacing(x, off, profile):
    """Median step between neighbours, slid along the beam, and that slide."""
    slide = 0.0
    for _ in range(4):
        order = np.lexsort((x - slide * off, profile))
        same = np.diff(profile[order]) == 0
        step, shift = np.diff(x[order])[same], np.diff(off[order])[same]
        if len(step) < 8:
            return np.nan, 0.0
        straight = step - slide * shift
        single = np.abs(straight - np.median(straight)) <= 2.5 * max(sigma_mad(straight), 1e-12)
        about = shift[single] - shift[single].mean()
        if about @ about > 1e-18 * len(about):
            slide = float(about @ step[single] / (about @ about))
    return float(np.median(step - slide * shift)), slide


def point_spacing(x, y, off, profile, pulse):
    """Return the spacing along x at the origin, its variance, and the slide along the profile.

    The slope of pulse over place: a polynomial along and across the profiles, of a degree that the
    number of points bears, with one constant for each profile. NaN without pulses.
    """
    if not np.isfinite(pulse).all():
        return np.nan, np.nan, 0.0
    degree = 1 + int(np.searchsorted(POINTS_FOR_DEGREE, len(x), side="right"))
    scale = max(np.abs(x).max(), np.abs(y).max())
    u, w = x / scale, y / scale
    terms = [u, off]
    terms += [u**i * w ** (n - i) for n in range(2, degree + 1) for i in range(1, n + 1)]
    if degree > 2:
        terms += [off * u, off * w]
    found = solve_groups(np.stack(terms, axis=1), pulse, profile)
    slope = found.coefficients[0] / scale
    variance = found.covariance[0, 0] / scale**2 / slope**4
    return 1 / abs(slope), variance, -found.coefficients[1] / slope
