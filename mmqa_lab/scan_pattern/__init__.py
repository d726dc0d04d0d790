"""Scan geometry of 2-D profile scanners on a moving vehicle: prediction and measurement.

The frame is right-handed: X to the target's side, across the track; Y in the direction of travel; Z
up; origin in the scanner at the moment of the pulse. With all rotations zero the scan plane is
vertical across the track (normal Y) and the target is a vertical wall along it (normal X). Scanner
and target are tilted first (scanner about X, target about Y), then turned by their heading about Z.
Angles are counter-clockwise positive. A target of positive heading is turned towards the vehicle; a
target of positive tilt leans away from it. This reading of Cahalane et al. 2014
(doi 10.3390/s140609471, equation 1) reproduces their Table 3.

The scan lattice has two steps on the surface: to the next pulse, and to the next profile.
Example::

    from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice

    setup = ScanSetup(
        pulse_rate_hz=300_000, mirror_frequency_hz=100, speed_m_s=10,
        scanner_heading_deg=45, scanner_tilt_deg=45,
    )
    lattice = scan_lattice(setup, Target(heading_deg=15, range_m=5))
    lattice.profile_spacing_horizontal_m, lattice.density_per_m2, lattice.f

Planning: :func:`largest_speed`, :func:`propagate`, :func:`explain_error`. Measured patterns:
:func:`measure_pattern`. The paper's own equations: :mod:`mmqa_lab.scan_pattern.mimic`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive, check_values
from mmqa_lab._results import Shown
from mmqa_lab.rotations import turned
from mmqa_lab.scan_pattern import mimic
from mmqa_lab.scan_pattern.measure import MEASURED, measure_pattern, revolutions_from_time
from mmqa_lab.scan_pattern.mimic import LEVEL, target_normal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "LATTICE_QUANTITIES", "Lattice", "Patch", "ScanSetup", "Target", "detail_size",
    "explain_error", "largest_speed", "lattice_distances", "measure_pattern", "mimic",
    "propagate", "revolutions_from_time", "scan_lattice", "speeds",
]  # fmt: skip

# Quantities that have derivatives; d1, d4 and f jump from lattice point to lattice point.
SMOOTH = (*MEASURED, "density_per_m2")
LATTICE_QUANTITIES = (*SMOOTH, "d1_mm", "d4_mm", "f")
"""Predicted quantities, in the order of the table of a lattice."""

EXPLAINED = (
    *(f"{side}_{turn}_deg" for side in ("scanner", "target") for turn in ("heading", "tilt")),
    *("mirror_frequency_hz", "speed_m_s"),
)
"""The inputs of Table 6."""

TRAVEL = np.array([0.0, 1.0, 0.0])  # the vehicle drives along Y
FEWEST_PULSES = 100  # pulses per revolution; with fewer, a step on the surface is not small
SPEEDS = np.geomspace(0.01, 100.0, 4001)  # tried before the refinement, m/s
SHOWN_WITH_SPEED = ("density_per_m2", "f", "detail_mm")
SPREAD = np.outer([0.7548776662466927, 0.5698402909980532], np.arange(400))  # over a cell


@dataclass(frozen=True, kw_only=True)
class ScanSetup:
    """A profile scanner on a vehicle that drives along Y: the five inputs of MIMIC.

    Every input may be an array; arrays broadcast. So a single set-up can hold a sweep or a
    Monte-Carlo draw.

    Parameters
    ----------
    pulse_rate_hz : float
        Pulses per second (PRR).
    mirror_frequency_hz : float
        Revolutions per second, each a profile (Mf). Pulses run upwards on the +X side.
    speed_m_s : float
        Speed along Y (v).
    scanner_heading_deg, scanner_tilt_deg : float
        Mounting (MIMIC's alpha_scan and gamma_scan), counter-clockwise positive about Z and X;
        tilt first.

    Raises
    ------
    ValueError
        If a rate or the speed is not above zero, a number is not finite, a revolution has fewer
        than 100 pulses, or the scan plane contains the direction of travel.

    Examples
    --------
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> setup.rotation[:, 1].round(4).tolist()  # the normal of the scan plane
    [-0.5, 0.5, 0.7071]
    """

    pulse_rate_hz: float | np.ndarray
    mirror_frequency_hz: float | np.ndarray
    speed_m_s: float | np.ndarray
    scanner_heading_deg: float | np.ndarray = 0.0
    scanner_tilt_deg: float | np.ndarray = 0.0

    def __post_init__(self):
        for name in SETUP_NAMES:
            check_values(getattr(self, name), name, positive=not name.endswith("_deg"))
        if np.min(np.divide(self.pulse_rate_hz, self.mirror_frequency_hz)) < FEWEST_PULSES:
            raise ValueError(
                f"Invalid pulse_rate_hz {self.pulse_rate_hz} for mirror_frequency_hz "
                f"{self.mirror_frequency_hz}. Must be {FEWEST_PULSES} pulses a revolution or more."
            )
        if (np.abs(self.rotation[..., 1, 1]) < 1e-9).any():
            raise ValueError(
                f"Invalid scanner_heading_deg {self.scanner_heading_deg} with scanner_tilt_deg "
                f"{self.scanner_tilt_deg}. Must turn the scan plane off the direction of travel."
            )

    @property
    def rotation(self) -> np.ndarray:
        """Rotation (..., 3, 3); columns: level line, normal and upward line of the scan plane."""
        return turned(z=self.scanner_heading_deg, x=self.scanner_tilt_deg)


SETUP_NAMES = tuple(field.name for field in fields(ScanSetup))


class Patch(NamedTuple):
    """Small pieces of any surface, each given by its place and normal.

    Parameters
    ----------
    points : array_like, shape (..., 3)
        X and Z from the scanner, metres. Y is free, since the scan passes every Y.
    normals : array_like, shape (..., 3)
        Of any length.
    """

    points: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Target:
    """MIMIC's target: a plane at a distance, tilted, then turned.

    Parameters
    ----------
    heading_deg : float
        alpha_targ: positive turns the wall towards the vehicle, negative away.
    tilt_deg : float
        beta_targ: positive leans its top away from the vehicle.
    range_m : float
        Horizontal range (Hr): X of the plane where the horizontal pulse of the level vehicle
        hits it. That pulse is ``range_m / cos(scanner heading)`` long.
    height_difference_m : float
        Height of the evaluated spot above the scanner (h_targ - h_scan).

    Raises
    ------
    ValueError
        If a value is not finite or the range is not above zero.

    Examples
    --------
    >>> wall = Target(heading_deg=15, tilt_deg=30, range_m=5)
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10)
    >>> wall.patch(setup).normals.round(4).tolist()
    [-0.8365, -0.2241, 0.5]
    """

    heading_deg: float | np.ndarray = 0.0
    tilt_deg: float | np.ndarray = 0.0
    range_m: float | np.ndarray
    height_difference_m: float | np.ndarray = 0.0

    def __post_init__(self):
        for name in TARGET_NAMES.values():
            check_values(getattr(self, name), name, positive=name == "range_m")

    def patch(self, setup: ScanSetup) -> Patch:
        """Return the evaluated spot of the plane as a ``Patch``.

        Raises
        ------
        ValueError
            If the horizontal pulse does not meet the plane's front.
        """
        level, _, upward = np.moveaxis(setup.rotation, -1, 0)
        normal = target_normal(self.heading_deg, self.tilt_deg)
        facing = _dot(normal, level)
        if (np.minimum(facing, level[..., 0]) < 1e-9).any():
            raise ValueError(
                f"Invalid target heading {self.heading_deg} and tilt {self.tilt_deg} for a scanner "
                f"heading of {setup.scanner_heading_deg}. Must let the horizontal pulse strike the "
                "front: headings less than 90 degrees apart, tilt less than 90."
            )
        lift = self.height_difference_m / upward[..., 2]
        along = self.range_m / level[..., 0] - lift * _dot(normal, upward) / facing
        return Patch(along[..., None] * level + lift[..., None] * upward, -normal)


TARGET_NAMES = {"target_heading_deg": "heading_deg", "target_tilt_deg": "tilt_deg"}
TARGET_NAMES |= {name: name for name in ("range_m", "height_difference_m")}
INPUTS = (*SETUP_NAMES, *TARGET_NAMES)  # names of the inputs that may have errors


@dataclass(frozen=True, eq=False)
class Lattice(Shown):
    """Steps on the surface from pulse to pulse and from profile to profile.

    Parameters
    ----------
    beam : array, shape (..., 3)
        From the scanner to the spot, metres.
    incidence_deg : array
        Angle between beam and normal, 0 to 90.
    axes : array, shape (..., 2, 3)
        The horizontal line of the surface and its line of greatest slope; on a level surface,
        across the track and along it.
    a : array, shape (..., 2)
        Step along ``axes`` from a pulse to the next, m; the spot is halfway between them in time.
    b : array, shape (..., 2)
        Step to the next profile, m; the spot is halfway in time. It leads to the same mirror angle
        if PRR / Mf is whole, else to the nearest pulse.
    profile_spacing_perpendicular_m : array
        Gap between neighbouring profiles, m.
    profile_spacing_horizontal_m, profile_spacing_vertical_m : array
        Gap along the horizontal line (d_PrSH) and along the slope (d_PrSV), m; infinite along the
        profiles, NaN on a level surface.
    profile_angle_deg : array
        Angle between profiles and the horizontal line, 0 to 90 (theta_PrA); NaN on a level
        surface.
    point_spacing_m : array
        Distance to the next point of the profile (d_PS), m.
    density_per_m2 : array
        PRR cos(i) / (2 pi R v |Y.n_scan|), independent of the mirror frequency.
    d1_mm, d4_mm, f : array
        Quadrant distances of the chart's metric along ``axes`` and f = d4 / d1. In a lattice
        d2 = d1 and d3 = d4 by symmetry.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> found = scan_lattice(ScanSetup(**scanner, speed_m_s=10), Target(range_m=5))
    >>> float(found.density_per_m2.round(6)), float(found.profile_spacing_horizontal_m.round(6))
    (4501.581581, 0.05)
    """

    beam: np.ndarray
    incidence_deg: np.ndarray
    axes: np.ndarray
    a: np.ndarray
    b: np.ndarray
    profile_spacing_perpendicular_m: np.ndarray
    profile_spacing_horizontal_m: np.ndarray
    profile_spacing_vertical_m: np.ndarray
    profile_angle_deg: np.ndarray
    point_spacing_m: np.ndarray
    density_per_m2: np.ndarray
    d1_mm: np.ndarray
    d4_mm: np.ndarray
    f: np.ndarray

    @cached_property
    def detail_mm(self) -> np.ndarray:
        """Diameter of the smallest details of which 95 % show three points or more, mm."""
        return 1000 * detail_size(self.a, self.b)

    def to_frame(self) -> pd.DataFrame:
        """Return a DataFrame of ``LATTICE_QUANTITIES``, one row per spot."""
        return pd.DataFrame({name: np.ravel(getattr(self, name)) for name in LATTICE_QUANTITIES})

    def points(self, half_width: float = 0.25) -> np.ndarray:
        """Return the lattice points about a single spot, along ``axes``, (n, 2), metres."""
        reach = np.abs(np.linalg.inv(np.array([self.a, self.b]).T)).sum(axis=1) * half_width
        i, j = np.meshgrid(*(np.arange(-r, r + 1) for r in np.minimum(np.ceil(reach), 2000)))
        xy = np.multiply.outer(i, self.a) + np.multiply.outer(j, self.b)
        return xy[(np.abs(xy) <= half_width).all(axis=-1)]

    def plot(self, *, ax: Axes | None = None, half_width: float = 0.25) -> Axes:
        """Draw the points about a single spot and both steps, in millimetres; return the axes."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = ax or subplots()[1]
        ax.plot(*(1000 * self.points(half_width)).T, ".", ms=2.5, color="0.6", mew=0)
        for step, name in ((self.a, "a"), (self.b, "b")):
            colour = COLOURS["vermilion" if name == "a" else "blue"]
            arrow = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", 1000 * step, (0, 0), arrowprops=arrow)
            ax.annotate(name, 1000 * step, (4, 4), textcoords="offset points", color=colour)
        ends = (-1000 * half_width, 1000 * half_width)
        ax.set(xlim=ends, ylim=ends, aspect="equal")
        ax.set(xlabel="along the level line (mm)", ylabel="up the slope (mm)")
        return ax


def scan_lattice(setup: ScanSetup, patch: Patch | Target) -> Lattice:
    """Return the scan lattice on each piece of a surface.

    A piece is hit when the scan plane passes it. The pulses half a step and half a revolution
    before and after that moment are intersected with the plane of the piece in closed form, each
    from the position of the scanner at its own time.

    Parameters
    ----------
    setup : ScanSetup
        Scanner and speed.
    patch : Patch or Target
        Pieces of the surface. Their shape and the shape of the set-up broadcast.

    Returns
    -------
    Lattice
        NaN where a pulse does not hit the plane.

    Raises
    ------
    ValueError
        If a place or normal is not finite, or if shapes do not fit.

    Notes
    -----
    The lattice is local: over a wall of some metres range and incidence change, and so do the
    steps. Each step has the spot in its middle. A step from the spot to the next pulse differs from
    it by half of the change of spacing from step to step (0.2 to 2 %), with opposite signs upwards
    and downwards. 1 / |a x b| equals the density up to the square of the mirror's step (1e-5).

    References
    ----------
    Cahalane et al. 2014, equations 2-10. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> lattice = scan_lattice(setup, Target(heading_deg=15, range_m=5))
    >>> round(lattice.profile_spacing_horizontal_m.item(), 6)
    0.08165
    """
    patch = patch.patch(setup) if isinstance(patch, Target) else patch
    points, normal = (check_values(values, name) for name, values in patch._asdict().items())
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    pulse_rate, mirror = np.broadcast_arrays(setup.pulse_rate_hz, setup.mirror_frequency_hz)
    speed = np.asarray(setup.speed_m_s, dtype=np.float64)
    level, plane, upward = np.moveaxis(setup.rotation, -1, 0)
    # from the position of the scanner when its plane passes the points
    beam = points - (_dot(points, plane) / plane[..., 1])[..., None] * TRAVEL
    scan_angle = np.arctan2(_dot(beam, upward), _dot(beam, level))

    def strike(seconds, turns):
        """Hit on the plane of the pulse after a time and a number of turns of the mirror."""
        angle = scan_angle + 2 * np.pi * turns
        aim = np.cos(angle)[..., None] * level + np.sin(angle)[..., None] * upward
        start = (speed * seconds)[..., None] * TRAVEL
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = _dot(beam - start, normal) / _dot(aim, normal)
        ahead = np.isfinite(reach) & (reach > 0)
        return start + np.where(ahead, reach, np.nan)[..., None] * aim

    def step(pulses):
        """Step along the axes over a number of pulses, about the spot, without whole turns."""
        seconds, turns = pulses / pulse_rate, pulses * mirror / pulse_rate
        turns = turns - np.round(turns)
        ends = [strike(side * seconds, side * turns) for side in (-0.5, 0.5)]
        return (axes @ (ends[1] - ends[0])[..., None])[..., 0]

    axes, flat = _axes(normal)
    a, b = step(1.0), step(np.round(pulse_rate / mirror))
    length, reach = np.linalg.norm(a, axis=-1), np.linalg.norm(beam, axis=-1)
    cosine = np.abs(_dot(beam, normal)) / reach
    density = pulse_rate * cosine / (2 * np.pi * reach * speed * np.abs(plane[..., 1]))
    d1, d4 = lattice_distances(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        cell = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
        along, up = np.moveaxis(np.where(flat[..., None], np.nan, np.abs(a)), -1, 0)
        return Lattice(
            beam=beam,
            incidence_deg=np.degrees(np.arccos(np.minimum(cosine, 1))),
            axes=axes,
            a=a,
            b=b,
            profile_spacing_perpendicular_m=cell / length,
            profile_spacing_horizontal_m=cell / up,
            profile_spacing_vertical_m=cell / along,
            profile_angle_deg=np.degrees(np.arctan2(up, along)),
            point_spacing_m=length,
            density_per_m2=np.broadcast_to(density, length.shape)[()],
            d1_mm=1000 * d1,
            d4_mm=1000 * d4,
            f=d4 / d1,
        )


def lattice_distances(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, ...]:
    """Return d1 = d2 and d3 = d4 of an infinite lattice: nearest points of its quadrants.

    The quadrants are half open, each without the axis on its counter-clockwise side. The basis is
    reduced (Lagrange); the nearest point of each quadrant is then within three steps.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice, in the axes of the quadrants.

    Returns
    -------
    tuple of array
        In the unit of the steps; NaN where a step is not finite or the two are parallel.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> [round(d.item(), 6) for d in lattice_distances([0.004, 0], [0.001, 0.047])]
    [0.004, 0.047096]
    """
    a, b = np.broadcast_arrays(*(np.asarray(step, dtype=np.float64) for step in (a, b)))
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    with np.errstate(invalid="ignore"):
        spans = area > 1e-12 * np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    short, long = _reduced(
        np.where(spans[..., None], a, [1.0, 0.0]), np.where(spans[..., None], b, [0.0, 1.0])
    )
    i, j = np.mgrid[-3:4, -3:4].reshape(2, -1, 1)
    near = i * short[..., None, :] + j * long[..., None, :]
    length = np.linalg.norm(near, axis=-1)
    x, y = np.moveaxis(np.where(np.abs(near) <= 1e-9 * length[..., None], 0, near), -1, 0)
    nearest = [
        np.where(inside, length, np.inf).min(axis=-1)
        for inside in ((x > 0) & (y >= 0), (x <= 0) & (y > 0))
    ]
    return tuple(np.where(spans, each, np.nan) for each in np.sort(nearest, axis=0))


def detail_size(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return the diameter of the smallest discs of which 95 % contain three points of a lattice.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice.

    Returns
    -------
    array
        In the unit of the steps, accurate to 1 %; NaN where a step is not finite.

    Notes
    -----
    It is twice the 95 % quantile of the distance from a place to its third nearest point, over the
    places of a cell. With the reduced basis this point is one of five on one of the four nearest
    rows.

    Examples
    --------
    >>> float(detail_size([0.001, 0], [0, 0.04]).round(4))  # close points: 95 % of the gap
    0.0379
    """
    short, long = _reduced(*(np.asarray(step, dtype=np.float64) for step in (a, b)))
    length = np.linalg.norm(short, axis=-1)[..., None, None]
    gap = np.abs(short[..., 0] * long[..., 1] - short[..., 1] * long[..., 0])[..., None, None]
    shift = _dot(short, long)[..., None, None] / length
    u, v = (SPREAD % 1)[..., None]
    i, j = np.mgrid[-2:3, -1:3].reshape(2, -1)
    place = u - j * shift / length
    away = np.hypot((place - np.round(place) + i) * length, (v - j) * gap / length)
    return 2 * np.quantile(np.partition(away, 2, axis=-1)[..., 2], 0.95, axis=-1)


def _axes(normal):
    """Level line and line of greatest slope of a surface, and whether the surface is level."""
    flat = np.hypot(normal[..., 0], normal[..., 1]) < LEVEL
    level = np.where(flat[..., None], np.cross(TRAVEL, normal), np.cross([0.0, 0.0, 1.0], normal))
    level /= np.linalg.norm(level, axis=-1, keepdims=True)
    return np.stack([level, np.cross(normal, level)], axis=-2), flat


def _dot(a, b):
    """Inner products over the last axis."""
    return np.sum(a * b, axis=-1)


def _reduced(a, b):
    """The shortest basis of the lattice, the shorter step first (Lagrange)."""
    for _ in range(64):
        swap = (_dot(a, a) > _dot(b, b))[..., None]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        times = np.round(_dot(a, b) / _dot(a, a))
        if not times.any():
            break
        b = b - times[..., None] * a
    return a, b


def largest_speed(
    setup: ScanSetup, target: Target | Patch, *, quantity: str, limit: float
) -> float:
    """Return the largest speed at which a predicted quantity still keeps a limit.

    The limit is a minimum for the density, and a maximum for spacings, distances and f. Speeds
    between 0.01 and 100 m/s are tried in steps of 0.23 %. The last speed that keeps the limit is
    refined to 1e-9 m/s. So the result is also correct for f, which may rise, fall and rise again
    with speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed is ignored.
    target : Target or Patch
        A single spot.
    quantity : str
        One of ``LATTICE_QUANTITIES`` except the profile angle, or detail_mm: the largest size of
        details of which 95 % shall show three points or more.
    limit : float
        In the unit of the quantity.

    Returns
    -------
    float
        Speed, m/s.

    Raises
    ------
    ValueError
        If no speed in the range keeps the limit, or even the fastest keeps it.

    Notes
    -----
    For a density the speed is PRR cos(i) / (2 pi density R |Y.n_s|). For a perpendicular profile
    spacing it is spacing x Mf |n_s x n_t| / |Y.n_s| up to the motion of the scan plane during a
    revolution.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1,
    ...                   scanner_tilt_deg=45)
    >>> speed = largest_speed(setup, Target(range_m=5), quantity="density_per_m2", limit=3000)
    >>> round(3.6 * speed)
    54
    """
    allowed = [*(one for one in LATTICE_QUANTITIES if one != "profile_angle_deg"), "detail_mm"]
    check_choice(quantity, "quantity", allowed)
    limit = check_positive(limit, "limit")

    def margin(speed):
        """Margin of the quantity to its limit, as a share of the limit; -1 if undefined."""
        values = getattr(scan_lattice(replace(setup, speed_m_s=speed), target), quantity)
        share = values / limit - 1 if quantity == "density_per_m2" else 1 - values / limit
        return np.where(np.isnan(share), -1.0, share)

    margins = [margin(speeds) for speeds in np.array_split(SPEEDS, 50)]
    kept = np.flatnonzero(np.concatenate(margins) >= 0)
    if not len(kept) or kept[-1] == len(SPEEDS) - 1:
        raise ValueError(f"Invalid limit {limit}. Must be reached between 0.01 and 100 m/s.")
    return float(brentq(margin, *SPEEDS[kept[-1] : kept[-1] + 2], xtol=1e-9))


def speeds(
    setup: ScanSetup, target: Target | Patch, *, detail: float, rho0: float = 3000.0, f: float = 2.0
) -> pd.DataFrame:
    """Return the largest speed for a task, and for what tenders ask, with what each gives.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed is ignored.
    target : Target or Patch
        A single spot.
    detail : float
        Diameter of details, m; 95 % of them shall show three points or more.
    rho0, f : float
        Required density (points per m2) and inhomogeneity.

    Returns
    -------
    DataFrame
        A row for the details, the density and f: ``asked``, ``limit``, ``speed_km_h`` (NaN if no
        speed from 0.01 to 100 m/s is the largest that keeps the limit), and at this speed
        ``density_per_m2``, ``f``, ``detail_mm``.

    Examples
    --------
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> found = speeds(ScanSetup(**scanner, speed_m_s=1), Target(range_m=5), detail=0.05)
    >>> found["speed_km_h"].round().tolist()
    [51.0, 54.0, 13.0]
    """
    rows = []
    for asked, limit in (("detail_mm", 1000 * detail), ("density_per_m2", rho0), ("f", f)):
        rows.append({"asked": asked, "limit": limit, "speed_km_h": np.nan})
        with suppress(ValueError):
            speed = largest_speed(setup, target, quantity=asked, limit=limit)
            found = scan_lattice(replace(setup, speed_m_s=speed), target)
            figures = {name: float(getattr(found, name)) for name in SHOWN_WITH_SPEED}
            rows[-1] |= {"speed_km_h": 3.6 * speed} | figures
    return pd.DataFrame(rows)


def propagate(
    setup: ScanSetup,
    target: Target,
    *,
    sigmas: dict[str, float],
    draws: int = 2_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Propagate errors of set-up and target to the prediction, by Monte Carlo.

    Independent normal errors are drawn, and the pattern is predicted for each draw. The plane stays
    at the spot of the nominal set-up. A target with an error of rotation turns about that spot.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
        The nominal target.
    sigmas : dict of str to float
        Standard deviations of inputs by name: fields of ``ScanSetup``, ``target_heading_deg``,
        ``target_tilt_deg``, ``range_m``, ``height_difference_m``; in the unit of the input.
    draws, seed : int
        Number of draws (100 or more) and seed.

    Returns
    -------
    DataFrame
        One row per quantity: ``quantity``, ``predicted``, ``std``, the 95 % interval ``low`` and
        ``high``, and the number of draws ``n``.

    Raises
    ------
    ValueError
        If an input is unknown, a deviation negative or so large that a draw is impossible, or
        ``draws`` below 100.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = propagate(setup, Target(range_m=8), sigmas={"speed_m_s": 0.1})
    >>> print(table.set_index("quantity").loc["profile_spacing_horizontal_m", "std"].round(4))
    0.001
    """
    for name, sigma in sigmas.items():
        check_choice(name, "input", INPUTS)
        check_number(sigma, f"sigma of {name}", low=0)
    draws, rng = check_count(draws, "draws", low=100), np.random.default_rng(seed)
    errors = {name: sigma * rng.standard_normal(draws) for name, sigma in sigmas.items()}
    try:
        drawn = _with_errors(setup, target, errors).to_frame()
    except ValueError:
        raise ValueError(
            f"Invalid sigmas {sigmas}. Must be small enough: a draw is an impossible set-up."
        ) from None
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    predicted = scan_lattice(setup, target).to_frame().iloc[0].to_numpy()
    table = {"quantity": LATTICE_QUANTITIES, "predicted": predicted, "std": drawn.std().to_numpy()}
    return pd.DataFrame({**table, "low": low, "high": high, "n": draws})


def explain_error(
    setup: ScanSetup, target: Target, *, quantity: str, measured: float
) -> pd.DataFrame:
    """Return the change of each input, one at a time, that turns the prediction into a measurement.

    Table 6 of Cahalane et al. 2014 gives such changes for an error of 2 mm. The result is the
    smallest change within 15 degrees, or within a fifth of a rate or speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    quantity : str
        A spacing, the angle or the density, as in the table of :func:`propagate`.
    measured : float
        In the unit of the quantity.

    Returns
    -------
    DataFrame
        ``input`` (the inputs of Table 6), ``change`` (signed, in the unit of the input; NaN if no
        change in the range explains the error), ``predicted`` and ``measured``.

    Raises
    ------
    ValueError
        If the quantity is unknown or the measured value not finite.

    References
    ----------
    Cahalane et al. 2014, section 4.3, Table 6. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = explain_error(setup, Target(range_m=8), measured=0.102,
    ...                       quantity="profile_spacing_horizontal_m").set_index("input")
    >>> print(table.loc["speed_m_s", "change"].round(6))
    0.2
    """
    check_choice(quantity, "quantity", SMOOTH)
    check_number(measured, "measured")
    changes = [_change(setup, target, quantity, measured, name) for name in EXPLAINED]
    predicted = float(getattr(scan_lattice(setup, target), quantity))
    table = {"input": EXPLAINED, "change": changes}
    return pd.DataFrame({**table, "predicted": predicted, "measured": measured})


def _change(setup, target, quantity, measured, name):
    """The smallest change of an input that explains the error; NaN if none or every change does."""
    reach = 15.0 if name.endswith("_deg") else 0.2 * getattr(setup, name)

    def lack(change):
        """Excess of the prediction over the measurement after a change of the input."""
        return getattr(_with_errors(setup, target, {name: change}), quantity) - measured

    tried = np.linspace(-reach, reach, 601)
    values = lack(tried)
    crossed = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
    if not len(crossed) or np.ptp(values) < 1e-12:
        return np.nan
    nearest = crossed[np.argmin(np.abs(tried[crossed] + tried[crossed + 1]))]
    return float(brentq(lack, tried[nearest], tried[nearest + 1]))


def _with_errors(setup, target, errors):
    """The lattice with errors added to the named inputs, at the spot of the nominal set-up."""
    changed = {name: getattr(setup, name) + errors[name] for name in errors if name in SETUP_NAMES}
    moved = {
        own: getattr(target, own) + errors.get(name, 0.0) for name, own in TARGET_NAMES.items()
    }
    normal = -target_normal(moved.pop("heading_deg"), moved.pop("tilt_deg"))
    points = replace(target, **moved).patch(setup).points
    return scan_lattice(replace(setup, **changed), Patch(points, normal))
