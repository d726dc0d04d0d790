"""Scan patterns measured in the points of a planar patch.

Cahalane et al. 2014 (sections 4.1.2 and 4.2.2) click distances between points. Here all profiles of
a patch are fitted at once. The time or the scan line of a point gives its profile and its pulse.
Standard deviations come from a jackknife over blocks of profiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_points, refuse
from mmqa_lab._results import NORMAL, Shown, about
from mmqa_lab.planes import TUKEY, fit_plane, sigma_mad
from mmqa_lab.scan_pattern.mimic import LEVEL
from mmqa_lab.scan_pattern.timing import (
    group_means,
    mirror_frequency,
    pulse_period,
    revolutions_from_time,
    solve_groups,
    solved,
)
from mmqa_lab.stats import student_reach

__all__ = [
    "PatternMeasurement", "measure_pattern", "mirror_frequency", "pulse_period",
    "revolutions_from_time",
]  # fmt: skip


OFF_LINE = 4.0
"""Points farther off their profile are left out: in sigma_MAD of the sizes of their distances,
which is .59 of the standard deviation, so that normal ones are cut at 2.4."""


LEAST_OFF_M = 1e-4  # points nearer to their profile are always kept


MANY = 150  # least number of points for a fit of curvature and of the turn of the beam


TURNED = 1e-7  # a direction is final once it turns by less, radians


PROFILE_BLOCKS = 40  # blocks of profiles left out in turn; single profiles if there are fewer


LONGEST_S = 300_000.0  # a longer span of times passes the end of a GPS week


CROSSED = 0.3  # largest scatter as a share of the gap, and largest share of points left out


UNEVEN_GAP = 0.2  # largest relative difference of the median gap from the mean gap


MEASURED = (
    *(f"profile_spacing_{way}_m" for way in ("perpendicular", "horizontal", "vertical")),
    *("profile_angle_deg", "point_spacing_m"),
)


@dataclass(frozen=True, eq=False)
class PatternMeasurement(Shown):
    """The measured pattern of a patch in metres and degrees, with standard deviations.

    Parameters
    ----------
    direction : array, shape (3,)
        Unit vector along the profiles.
    profiles, points : int
        Numbers of profiles and points used.
    profile_spacing_perpendicular_m : float
        The mean gap between neighbouring profiles over the patch.
    profile_spacing_horizontal_m, profile_spacing_vertical_m : float
        The gap along the horizontal line of the plane and along its line of greatest slope. The
        vertical gap is poorly determined for profile angles above 75 degrees.
    profile_angle_deg, point_spacing_m : float
        The angle of the profiles from the horizontal line, and the spacing of points along a
        profile, both at the reference point. NaN if not measurable.
    std : dict of str to float
        Standard deviations of these five quantities by name; NaN with fewer than four profiles.

    Examples
    --------
    >>> along, line = np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7))
    >>> wall = np.stack([0 * along, 0.05 * line, along], axis=-1).reshape(-1, 3)
    >>> found = measure_pattern(wall, scan_line=line.ravel())  # upright profiles, 5 cm apart
    >>> round(found.profile_angle_deg, 3), round(float(found.profile_spacing_horizontal_m), 6)
    (90.0, 0.05)
    """

    direction: np.ndarray
    profiles: int
    points: int
    profile_spacing_perpendicular_m: float
    profile_spacing_horizontal_m: float
    profile_spacing_vertical_m: float
    profile_angle_deg: float
    point_spacing_m: float
    std: dict

    def _ends(self):
        rows = ((name, getattr(self, name), std) for name, std in self.std.items())
        return [about(*row, "deg" if row[0].endswith("_deg") else "m") for row in rows]

    def to_frame(self) -> pd.DataFrame:
        """Return ``quantity``, ``measured``, ``std``, ``n`` (profiles or points)."""
        found = {"quantity": list(self.std), "measured": [getattr(self, one) for one in self.std]}
        counts = [self.profiles] * 4 + [self.points]
        return pd.DataFrame(found | {"std": self.std.values(), "n": counts})


def measure_pattern(
    points: ArrayLike,
    *,
    gps_time: ArrayLike | None = None,
    scan_line: ArrayLike | None = None,
    reference: ArrayLike | None = None,
) -> PatternMeasurement:
    """Measure the scan pattern of a planar patch.

    Profiles are numbered by ``scan_line`` or from ``gps_time``. All profiles share a direction, a
    curvature and a slide along the beam, since range noise moves points off the plane and across
    the profiles at the same time. The gap is the slope of the offsets of the profiles over their
    numbers. Pulses are counted by time. The point spacing is the slope of place over pulse count at
    the reference point.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        A single planar patch from a single pass of one scanner head, metres.
    gps_time : array_like, shape (n,), optional
        Seconds. The point spacing is NaN without times, or if their clock is coarser than the
        pulses.
    scan_line : array_like of int, shape (n,), optional
        Number of the profile; missing profiles must leave gaps in the numbers.
    reference : array_like, shape (3,), optional
        Where angle and point spacing are evaluated, metres; by default the centroid.

    Returns
    -------
    PatternMeasurement

    Raises
    ------
    ValueError
        If there is neither time nor scan line, times pass the end of a GPS week, a column has the
        wrong length, there are fewer than twelve points or fewer than two profiles of three points,
        or the points do not lie on a single family of parallel profiles.

    Notes
    -----
    Standard deviations contain errors that vary within the patch: range and angle noise, drop-outs,
    drift of speed, jitter of attitude. They do not contain errors that turn or stretch the whole
    patch: boresight, attitude bias, and noise along the beam that tilts the fitted plane (0.13
    degrees of profile angle for noise of 2 cm, 0.01 degrees for 5 mm). Plain distances between
    neighbouring points are 1 to 3 mm too long at 5 mm range noise.

    References
    ----------
    Cahalane et al. 2014, sections 4.1.2 and 4.2.2. doi:10.3390/s140609471

    Examples
    --------
    >>> along, line = np.meshgrid(np.arange(-20, 21) * 0.02, np.arange(-6, 7))
    >>> wall = np.stack([0 * along, 0.05 * line, along + 0.007 * line], axis=-1).reshape(-1, 3)
    >>> time = line * 0.01 + np.arange(41) * 1e-5
    >>> found = measure_pattern(wall, gps_time=time.ravel())
    >>> round(found.profile_spacing_perpendicular_m, 6), round(found.point_spacing_m, 6)
    (0.05, 0.02)
    """
    points = check_points(points, minimum=12)
    time = _column(gps_time, "gps_time", len(points))
    line = _column(scan_line, "scan_line", len(points))
    if time is None and line is None:
        raise ValueError("Invalid patch without gps_time and scan_line. Must have one of them.")
    if time is not None and np.ptp(time) > LONGEST_S:
        raise ValueError(f"Invalid gps_time over {np.ptp(time):.0f} s. Must not pass a week's end.")
    plane = fit_plane(points, robust=True)
    near = np.abs(plane.residuals) <= TUKEY * max(sigma_mad(plane.residuals), 1e-9)
    local = points - points.mean(axis=0)
    centre = local[near].mean(axis=0)
    if reference is not None:
        centre = check_points([reference], name="reference")[0] - points.mean(axis=0)
    numbers = np.full(len(points), -1)
    numbers[near] = revolutions_from_time(time[near]) if line is None else line[near]
    used, share = _without_strays(local, numbers, np.flatnonzero(near))
    fit = _fitted(local[used], numbers[used], centre)
    _check_one_head(fit, share)
    found, *left = _figures(fit, _pulses(time, numbers, used))
    return PatternMeasurement(
        direction=fit.along,
        profiles=len(fit.numbers),
        points=len(used),
        std=dict(zip(MEASURED, _jackknifed(np.array(left)), strict=True)),
        **dict(zip(MEASURED, found.tolist(), strict=True)),
    )


def _column(values, name, n):
    """A column as float64, one value per point, or None."""
    if values is None:
        return None
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (n,):
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must be one per point, {n}.")
    odd = ~np.isfinite(values)
    refuse(odd.any(), name, f"{odd.sum()} of {n} not finite", "finite")
    return values


def _without_strays(local, numbers, kept):
    """Rows of profiles of three points or more, without stray points, and the share kept."""
    whole = 0
    for _ in range(3):
        _, group, counts = np.unique(numbers[kept], return_inverse=True, return_counts=True)
        kept, full = kept[counts[group] >= 3], (counts >= 3).sum()
        if full < 2:
            raise ValueError(f"Invalid patch: {full} profiles of 3 or more points. Must be 2.")
        whole = whole or len(kept)
        off = np.abs(_fitted(local[kept], numbers[kept], local[kept].mean(axis=0)).beside)
        inside = off <= max(OFF_LINE * sigma_mad(off), LEAST_OFF_M)
        if inside.all():
            break
        kept = kept[inside]
    return kept, len(kept) / whole


class _Fit(NamedTuple):
    """Parallel profiles in the plane: x along them, y across, both from the reference, metres."""

    x: np.ndarray
    y: np.ndarray
    off: np.ndarray  # from the plane
    group: np.ndarray  # index of each point's profile in numbers
    numbers: np.ndarray
    offsets: np.ndarray  # of the profiles across
    gap: float  # mean gap between neighbours: slope of offsets over numbers
    beside: np.ndarray  # distances of points beside their profile
    along: np.ndarray  # unit vectors in space along the profiles, across them, off the plane
    across: np.ndarray
    normal: np.ndarray


def _fitted(local, numbers, centre):
    """Fit a plane, and profiles with a common direction, curvature and slide along the beam."""
    flat = fit_plane(local)
    uv, off = flat.project(local) - flat.project(centre), flat.residuals
    present, group = np.unique(numbers, return_inverse=True)
    about = uv - group_means(uv, group)[group]
    first = np.linalg.eigh(about.T @ about)[1][:, 1]  # the largest scatter within profiles
    turn = np.arctan2(first[1], first[0])
    for _ in range(4):
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        x, y = axes @ uv.T
        slopes, offsets, beside = solve_groups(_profile_terms(x, y, off), y, group)
        turn += np.arctan(slopes[0])
        if abs(slopes[0]) < TURNED:
            break
    gap = abs(_slopes(present, offsets, np.bincount(group)))
    return _Fit(x, y, off, group, present, offsets, gap, beside, *axes @ flat.axes, flat.normal)


def _profile_terms(x, y, off):
    """What the place of a point across its profile depends on: direction, slide, curvature."""
    terms = [x, off] if len(x) < MANY else [x, off, off * x, off * y, x**2, x * y]
    return np.stack(terms, axis=1)


def _pulse_terms(x, y, off):
    """What the pulse of a point depends on: its place, and the slide along the beam."""
    degree = 1 if len(x) < MANY else 3
    powers = [(i, j) for i in range(1, degree + 1) for j in range(degree + 1 - i)]
    return np.stack([*(x**i * y**j for i, j in powers), off], axis=1)


def _slopes(numbers, offsets, weights):
    """Slopes of offsets (..., m) over numbers (m,) by weighted least squares."""
    share = weights / weights.sum(axis=-1, keepdims=True)
    about = numbers - (share @ numbers)[..., None]
    return (share * about * offsets).sum(axis=-1) / (share * about**2).sum(axis=-1)


def _check_one_head(fit, share):
    """Refuse points that are not on a family of parallel, evenly numbered profiles."""
    steps = np.abs(np.diff(fit.offsets) / np.diff(fit.numbers))
    crossed = np.std(fit.beside) > CROSSED * fit.gap or share < 1 - CROSSED
    if crossed or abs(np.median(steps) / fit.gap - 1) > UNEVEN_GAP:
        raise ValueError(
            f"Invalid patch: points lie {np.std(fit.beside):.2g} m beside profiles {fit.gap:.2g} m "
            f"apart, {share:.0%} of them near. Must be one pass of one head, profiles numbered "
            "one by one."
        )


def _figures(fit, pulse):
    """The five quantities of ``MEASURED``, of all points and without each block: (1 + blocks, 5).

    Sums over a block are taken from the sums over all. Without a block the plane turns by a small
    angle, to which all other figures are linear.
    """
    count = min(PROFILE_BLOCKS, len(fit.numbers))
    block_of = np.arange(len(fit.numbers)) * count // len(fit.numbers)
    blocks = block_of[fit.group]
    ones, terms = np.ones_like(fit.x), _profile_terms(fit.x, fit.y, fit.off)
    _, rise, fall = _left_out(np.stack([ones, fit.x, fit.y], axis=1), fit.off, blocks).T
    means, level = group_means(terms, fit.group), group_means(fit.y, fit.group)
    slopes = _left_out(terms - means[fit.group], fit.y - level[fit.group], blocks)
    used = block_of != np.arange(-1, count)[:, None]
    gap = np.abs(_slopes(fit.numbers, level - slopes @ means.T, used * np.bincount(fit.group)))
    gap *= 1 + slopes[:, 1] * fall
    turn = slopes[:, 0] + slopes[:, 1] * rise
    along = fit.along + np.outer(turn, fit.across) + np.outer(rise, fit.normal)
    normal = fit.normal - np.outer(rise, fit.along) - np.outer(fall, fit.across)
    flat = np.cross([0.0, 0.0, 1.0], normal)
    size, angle, spacing = np.linalg.norm(flat, axis=1), np.nan, np.nan
    if size[0] >= LEVEL:
        cosine = np.abs((along * flat).sum(axis=1)) / (size * np.linalg.norm(along, axis=1))
        angle = np.arccos(np.minimum(cosine, 1.0))
    if np.isfinite(pulse).all():
        terms = _pulse_terms(fit.x, fit.y, fit.off)
        terms -= group_means(terms, fit.group)[fit.group]
        rates = _left_out(terms, pulse - group_means(pulse, fit.group)[fit.group], blocks)
        spacing = np.abs(1 / (rates[:, 0] + rates[:, -1] * rise))
    with np.errstate(divide="ignore", invalid="ignore"):
        figures = gap, gap / np.sin(angle), gap / np.cos(angle), np.degrees(angle), spacing
    return np.stack(np.broadcast_arrays(*figures), axis=1)


def _left_out(terms, values, block):
    """Least squares of values (n,) on terms (n, k), with all rows and without each block."""
    rows = np.column_stack([terms, values])[np.argsort(block, kind="stable")]
    parts = np.split(rows, np.cumsum(np.bincount(block))[:-1])
    sums = np.array([np.zeros([rows.shape[1]] * 2), *(part.T @ part for part in parts)])
    sums = sums.sum(axis=0) - sums
    return solved(sums[:, :-1, :-1], sums[:, :-1, -1])


def _jackknifed(left):
    """Standard deviations of the five quantities from their values without each block.

    They are widened so that 1.96 of them are the 95 % interval by Student's t.
    """
    if len(left) < 4:
        return [np.nan] * 5
    reach = student_reach(1 / NORMAL, len(left) - 1)
    return (reach * np.sqrt((len(left) - 1) * np.var(left, axis=0))).tolist()


def _pulses(time, numbers, used):
    """Pulses since the first point, by time; NaN if the clock is too coarse to count them."""
    if time is None:
        return np.full(len(used), np.nan)
    since = time[used] - time[used].min()
    return since / pulse_period(since, np.unique(numbers[used], return_inverse=True)[1])
