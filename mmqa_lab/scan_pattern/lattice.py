"""The scan lattice: scanner, motion and surface, and the two steps that lay the surface out.

Planning with it: the largest speed that will do, how sure a prediction is, what explains an error.

Around a spot of a plane, two successive pulses and two successive revolutions are solved exactly,
with the motion of the vehicle in between. In the equations of Cahalane et al. 2014
(doi 10.3390/s140609471) the scan plane stands still during a revolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_count, check_number, check_points, check_positive
from mmqa_lab._results import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Quantities that have derivatives; d1..d4 and f jump from lattice point to lattice point.
SMOOTH = (
    *(f"profile_spacing_{way}_m" for way in ("perpendicular", "horizontal", "vertical")),
    *("profile_angle_deg", "point_spacing_m", "density_per_m2"),
)
QUANTITIES = (*SMOOTH, "d1_mm", "d2_mm", "d3_mm", "d4_mm", "f")
"""What a lattice predicts, in the order of its table."""

# A surface closer to level than 0.1 degree has no horizontal line of its own.
LEVEL = np.sin(np.radians(0.1))
TRAVEL = np.array([0.0, 1.0, 0.0])  # the vehicle drives along Y
POSITIVE = ("pulse_rate_hz", "mirror_frequency_hz", "speed_m_s")

SLOWEST, FASTEST = 0.01, 100.0  # speeds that are searched, m/s
SPEEDS = 4001  # speeds tried before the last one that will do is refined: a step of 0.23 %
TARGET_NAMES = {"target_heading_deg": "heading_deg", "target_tilt_deg": "tilt_deg"}
TARGET_NAMES |= {name: name for name in ("range_m", "height_difference_m")}
"""Inputs that are fields of the target."""

EXPLAINED = (
    *(f"{side}_{turn}_deg" for side in ("scanner", "target") for turn in ("heading", "tilt")),
    *("mirror_frequency_hz", "speed_m_s"),
)
"""The inputs of Table 6."""

UNITS = {"_deg_s": "deg/s", "_deg": "deg", "_hz": "Hz", "_m_s": "m/s", "_m": "m"}
"""Of inputs, by the ending of their names."""

# Half steps of the central differences where 1e-4 (degree, degree/s, metre) is not apt.
STEPS = {"pulse_rate_hz": 1.0, "mirror_frequency_hz": 1e-3, "speed_m_s": 1e-4}


@dataclass(frozen=True, kw_only=True)
class ScanSetup:
    """A profile scanner on a vehicle that drives along Y.

    Every number may be an array; arrays broadcast, so that a sweep or a Monte-Carlo draw is one
    set-up.

    Parameters
    ----------
    pulse_rate_hz : float
        Pulses per second (PRR).
    mirror_frequency_hz : float
        Revolutions per second, one profile each (Mf).
    speed_m_s : float
        Speed along Y (v).
    scanner_heading_deg, scanner_tilt_deg : float
        Mounting (MIMIC's alpha_scan and gamma_scan), counter-clockwise positive about Z and X;
        tilt first.
    boresight_roll_deg, boresight_pitch_deg, boresight_heading_deg : float
        What the mounting differs from that: signs as for the attitude.
    roll_deg, pitch_deg, heading_deg : float
        Attitude at the moment of the pulse, as navigation reports it: right side down, nose up and
        clockwise seen from above positive. The vehicle travels along Y all the same.
    roll_rate_deg_s, pitch_rate_deg_s, heading_rate_deg_s : float
        Their change per second.
    lever_arm_m : tuple of 3
        Scanner from the point about which the vehicle turns, in the vehicle's frame.
    spin : {1, -1}
        1: pulses run upwards on the +X side; -1: downwards.

    Raises
    ------
    ValueError
        If a rate or the speed is not above zero, a number is not finite, the arrays do not
        broadcast, or the scan plane contains the direction of travel.

    Examples
    --------
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> setup.plane_normal.round(4).tolist(), setup.pulse_step_deg.round(4).item()
    ([-0.5, 0.5, 0.7071], 0.12)
    """

    pulse_rate_hz: float
    mirror_frequency_hz: float
    speed_m_s: float
    scanner_heading_deg: float = 0.0
    scanner_tilt_deg: float = 0.0
    boresight_roll_deg: float = 0.0
    boresight_pitch_deg: float = 0.0
    boresight_heading_deg: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    heading_deg: float = 0.0
    roll_rate_deg_s: float = 0.0
    pitch_rate_deg_s: float = 0.0
    heading_rate_deg_s: float = 0.0
    lever_arm_m: tuple = (0.0, 0.0, 0.0)
    spin: int = 1

    def __post_init__(self):
        for name in NUMBERS:
            check_values(getattr(self, name), name, positive=name in POSITIVE)
        check_points([self.lever_arm_m], name="lever_arm_m")
        check_choice(self.spin, "spin", (1, -1))
        shapes = {name: np.shape(getattr(self, name)) for name in NUMBERS}
        try:
            np.broadcast_shapes(*shapes.values())
        except ValueError:
            arrays = {name: shape for name, shape in shapes.items() if shape}
            raise ValueError(f"Invalid shapes {arrays}. Must broadcast.") from None
        if (np.abs(self.plane_normal[..., 1]) < 1e-9).any():
            raise ValueError(
                f"Invalid scanner_heading_deg {self.scanner_heading_deg} with scanner_tilt_deg "
                f"{self.scanner_tilt_deg}. Must turn the scan plane off the direction of travel."
            )

    @classmethod
    def of_scanner(cls, scanner: Any, *, speed_m_s: float) -> ScanSetup:
        """Return the set-up of a simulated profile scanner, driven at a speed.

        Parameters
        ----------
        scanner : object
            Has ``pulse_rate_hz``, ``mirror_frequency_hz``, ``heading_deg``, ``tilt_deg``,
            ``boresight_deg`` and ``lever_arm_m``, as ``simulate.ProfileScanner`` does.
        speed_m_s : float
        """
        angles = zip(("roll", "pitch", "heading"), scanner.boresight_deg, strict=True)
        return cls(
            pulse_rate_hz=scanner.pulse_rate_hz,
            mirror_frequency_hz=scanner.mirror_frequency_hz,
            speed_m_s=speed_m_s,
            scanner_heading_deg=scanner.heading_deg,
            scanner_tilt_deg=scanner.tilt_deg,
            lever_arm_m=scanner.lever_arm_m,
            **{f"boresight_{name}_deg": angle for name, angle in angles},
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape to which the numbers broadcast; () for plain numbers."""
        return np.broadcast_shapes(*(np.shape(getattr(self, name)) for name in NUMBERS))

    @property
    def pulse_step_deg(self) -> float | np.ndarray:
        """Turn of the mirror from pulse to pulse (theta_A)."""
        return 360 * np.divide(self.mirror_frequency_hz, self.pulse_rate_hz)

    @property
    def plane_normal(self) -> np.ndarray:
        """Normal of the scan plane at the moment of the pulse (n_s), (..., 3)."""
        return self.rotation()[..., :, 1]

    def vehicle_rotation(self, seconds: float | np.ndarray = 0.0) -> np.ndarray:
        """Rotation (..., 3, 3) from the vehicle's frame to the track's, some time after."""
        return turned(
            y=self.roll_deg + np.multiply(self.roll_rate_deg_s, seconds),
            x=self.pitch_deg + np.multiply(self.pitch_rate_deg_s, seconds),
            z=-(self.heading_deg + np.multiply(self.heading_rate_deg_s, seconds)),
        )

    def rotation(self, seconds: float | np.ndarray = 0.0) -> np.ndarray:
        """Rotation (..., 3, 3) from the scanner's frame to the track's, some time after."""
        roll, pitch = self.boresight_roll_deg, self.boresight_pitch_deg
        boresight = turned(y=roll, x=pitch, z=np.negative(self.boresight_heading_deg))
        mounting = boresight @ turned(z=self.scanner_heading_deg, x=self.scanner_tilt_deg)
        return self.vehicle_rotation(seconds) @ mounting

    def origin(self, seconds: float | np.ndarray) -> np.ndarray:
        """Where the scanner is some time after the pulse, (..., 3), m."""
        shift = np.multiply.outer(np.multiply(self.speed_m_s, seconds), TRAVEL)
        turn = self.vehicle_rotation(seconds) - self.vehicle_rotation()
        return shift + turn @ np.asarray(self.lever_arm_m, dtype=np.float64)

    def turn_rate(self) -> np.ndarray:
        """Angular velocity of the vehicle in the track's frame, (..., 3), rad/s."""
        back = np.negative(self.heading_deg)
        level, pitched = (turned(z=back, x=x) for x in (0.0, self.pitch_deg))
        rates = self.pitch_rate_deg_s, self.roll_rate_deg_s, self.heading_rate_deg_s
        pitch, roll, heading = np.radians(np.broadcast_arrays(*rates))[..., None]
        return pitch * level[..., :, 0] + roll * pitched[..., :, 1] - heading * [0.0, 0.0, 1.0]


NUMBERS = tuple(
    field.name for field in fields(ScanSetup) if field.name not in ("lever_arm_m", "spin")
)
"""The fields of a set-up that are numbers and may be arrays."""

INPUTS = (*NUMBERS, *TARGET_NAMES)  # names of what may be in error


@dataclass(frozen=True, eq=False)
class Patch:
    """Small pieces of any surface, each by its place and its normal.

    Parameters
    ----------
    points : array_like, shape (..., 3)
        X and Z from the scanner in metres; Y is free, for the scan comes past every Y.
    normals : array_like, shape (..., 3)
        Of any length, outwards where the surface has an inside.

    Raises
    ------
    ValueError
        If shapes differ, a number is not finite or a normal has no length.

    Examples
    --------
    >>> road = Patch([3.0, 0.0, -2.5], [0, 0, 1])
    >>> road.normals.tolist()
    [0.0, 0.0, 1.0]
    """

    points: np.ndarray
    normals: np.ndarray

    def __post_init__(self):
        points = check_values(self.points, "points")
        normals = check_values(self.normals, "normals")
        if points.shape[-1:] != (3,) or normals.shape[-1:] != (3,):
            raise ValueError(
                f"Invalid patch of points {points.shape} and normals {normals.shape}. "
                "Must have shapes (..., 3)."
            )
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        if not length.all():
            raise ValueError("Invalid normals: one is zero. Must be > 0 long.")
        points, normals = np.broadcast_arrays(points, normals / length)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "normals", normals)

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
        strikes it. That pulse is ``range_m / cos(scanner heading)`` long.
    height_difference_m : float
        Height of the evaluated spot above the scanner (h_targ - h_scan).

    Raises
    ------
    ValueError
        If a value is not finite or the range is not above zero.

    Examples
    --------
    >>> Target(heading_deg=15, tilt_deg=30, range_m=5).normal.round(4).tolist()
    [0.8365, 0.2241, -0.5]
    """

    heading_deg: float = 0.0
    tilt_deg: float = 0.0
    range_m: float
    height_difference_m: float = 0.0

    def __post_init__(self):
        for name in ("heading_deg", "tilt_deg", "height_difference_m"):
            check_values(getattr(self, name), f"target {name}")
        check_values(self.range_m, "range_m", positive=True)

    @property
    def normal(self) -> np.ndarray:
        """Normal of the plane, away from the vehicle (n_t), (..., 3)."""
        return target_normal(self.heading_deg, self.tilt_deg)

    def patch(self, setup: ScanSetup) -> Patch:
        """Return the spot of the plane that is evaluated.

        Raises
        ------
        ValueError
            If the horizontal pulse does not meet the plane's front.
        """
        rotation = turned(z=setup.scanner_heading_deg, x=setup.scanner_tilt_deg)
        level, upward = rotation[..., :, 0], rotation[..., :, 2]
        normal = self.normal
        facing = np.sum(normal * level, axis=-1)
        if (np.minimum(facing, level[..., 0]) < 1e-9).any():
            raise ValueError(
                f"Invalid target heading {self.heading_deg} and tilt {self.tilt_deg} for a scanner "
                f"heading of {setup.scanner_heading_deg}. Must let the horizontal pulse strike the "
                "front: headings less than 90 degrees apart, tilt less than 90."
            )
        lift = self.height_difference_m / upward[..., 2]
        along = self.range_m / level[..., 0] - lift * np.sum(normal * upward, axis=-1) / facing
        points = along[..., None] * level + lift[..., None] * upward
        return Patch(points, -normal)


@dataclass(frozen=True, eq=False)
class Lattice(Shown):
    """Steps on the surface from pulse to pulse and from profile to profile.

    Parameters
    ----------
    setup : ScanSetup
    beam : array, shape (..., 3)
        From the scanner to the spot, metres.
    normal : array, shape (..., 3)
        Unit normal of the surface.
    a : array, shape (..., 3)
        Step from a pulse to the next, motion of vehicle and mirror; the spot is halfway in time.
    b : array, shape (..., 3)
        Step to the same mirror angle one revolution later, the spot halfway in time.
    nearest : array, shape (..., 3)
        Step to the pulse of the next profile that is ``b`` up to half a step of the mirror: with
        ``a`` it spans the points, also where PRR / Mf is not whole.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
    >>> scanner = {"pulse_rate_hz": 1e6, "mirror_frequency_hz": 200, "scanner_tilt_deg": 45}
    >>> setup = ScanSetup(**scanner, speed_m_s=10)
    >>> there = scan_lattice(setup, Target(range_m=5).patch(setup))
    >>> float(there.density_per_m2.round(6)), float(there.profile_spacing_horizontal_m.round(6))
    (4501.581581, 0.05)
    """

    setup: ScanSetup
    beam: np.ndarray
    normal: np.ndarray
    a: np.ndarray
    b: np.ndarray
    nearest: np.ndarray

    @property
    def range_m(self) -> np.ndarray:
        """Length of the beam."""
        return np.linalg.norm(self.beam, axis=-1)

    @property
    def facing(self) -> np.ndarray:
        """Whether the beam comes from the side to which the normal points."""
        return _dot(self.beam, self.normal) < 0

    @property
    def incidence_deg(self) -> np.ndarray:
        """Angle between beam and normal, 0 to 90."""
        cosine = np.abs(_dot(self.beam, self.normal)) / self.range_m
        return np.degrees(np.arccos(np.minimum(cosine, 1)))

    @cached_property
    def axes(self) -> np.ndarray:
        """The horizontal line and the line of greatest slope of the surface, (..., 2, 3).

        On a level surface: across the track and along it.
        """
        level = np.cross([0.0, 0.0, 1.0], self.normal)
        across = np.cross([0.0, 1.0, 0.0], self.normal)
        chosen = np.where(self._level[..., None], across, level)
        chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
        return np.stack([chosen, np.cross(self.normal, chosen)], axis=-2)

    def plane_steps(self) -> np.ndarray:
        """Return ``a``, ``b`` and ``nearest`` along ``axes``, three arrays (..., 2)."""
        steps = (self.a, self.b, self.nearest)
        return tuple((self.axes @ step[..., None])[..., 0] for step in steps)

    @property
    def cell_m2(self) -> np.ndarray:
        """Area of the parallelogram of ``a`` and ``b``."""
        return np.linalg.norm(np.cross(self.a, self.b), axis=-1)

    @property
    def point_spacing_m(self) -> np.ndarray:
        """Distance to the next point of the profile (d_PS)."""
        return np.linalg.norm(self.a, axis=-1)

    @property
    def profile_spacing_perpendicular_m(self) -> np.ndarray:
        """Gap between neighbouring profiles."""
        return self.cell_m2 / self.point_spacing_m

    @property
    def profile_spacing_horizontal_m(self) -> np.ndarray:
        """Gap along the surface's horizontal line (d_PrSH); inf along profiles, NaN if level."""
        return self._spacing_along(1)

    @property
    def profile_spacing_vertical_m(self) -> np.ndarray:
        """Gap along its line of greatest slope (d_PrSV); inf along profiles, NaN if level."""
        return self._spacing_along(0)

    @property
    def profile_angle_deg(self) -> np.ndarray:
        """Angle between profiles and the horizontal line, 0 to 90 (theta_PrA); NaN if level."""
        along, up = np.moveaxis(np.abs(self.plane_steps()[0]), -1, 0)
        return np.where(self._level, np.nan, np.degrees(np.arctan2(up, along)))[()]

    @property
    def density_per_m2(self) -> np.ndarray:
        """Points per square metre at the spot, PRR cos(i) / (2 pi R v |Y.n_s|).

        For a turning vehicle the velocity is that of the scan plane at the spot. The mirror
        frequency does not appear in it.
        """
        setup = self.setup
        lever = setup.vehicle_rotation() @ np.asarray(setup.lever_arm_m, dtype=np.float64)
        velocity = np.multiply.outer(setup.speed_m_s, TRAVEL)
        sweep = velocity + np.cross(setup.turn_rate(), self.beam + lever)
        cosine = np.abs(_dot(self.beam, self.normal)) / self.range_m
        gain = 2 * np.pi * self.range_m * np.abs(_dot(sweep, setup.plane_normal))
        with np.errstate(divide="ignore"):
            return setup.pulse_rate_hz * cosine / gain

    @cached_property
    def distances_m(self) -> np.ndarray:
        """Sorted quadrant distances d1..d4 of the chart's metric along ``axes``, (..., 4)."""
        a, _, nearest = self.plane_steps()
        return lattice_distances(a, nearest)

    @property
    def f(self) -> np.ndarray:
        """Inhomogeneity d4 / d1."""
        return self.distances_m[..., 3] / self.distances_m[..., 0]

    def to_frame(self) -> pd.DataFrame:
        """Return a DataFrame of ``QUANTITIES``, a row per spot."""
        return pd.DataFrame({name: np.ravel(self.quantity(name)) for name in QUANTITIES})

    def points(self, half_width: float = 0.25) -> np.ndarray:
        """Return the points that the steps lay about the spot, along ``axes``, (n, 2), metres."""
        a, _, b = self.plane_steps()
        reach = np.abs(np.linalg.inv(np.array([a, b]).T)).sum(axis=1) * half_width
        i, j = np.meshgrid(*(np.arange(-r, r + 1) for r in np.minimum(np.ceil(reach), 2000)))
        xy = np.multiply.outer(i, a) + np.multiply.outer(j, b)
        return xy[(np.abs(xy) <= half_width).all(axis=-1)]

    def plot(self, *, ax: Axes | None = None, half_width: float = 0.25) -> Axes:
        """Draw the points about a single spot and the two steps, millimetres; return the axes."""
        from mmqa_lab.plots import COLOURS, subplots

        ax = ax or subplots()[1]
        ax.plot(*(1000 * self.points(half_width)).T, ".", ms=2.5, color="0.6", mew=0)
        a, _, b = 1000 * np.array(self.plane_steps())
        for step, name, colour in ((a, "a", COLOURS["vermilion"]), (b, "b", COLOURS["blue"])):
            ax.annotate("", step, (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour})
            ax.annotate(name, step, (4, 4), textcoords="offset points", color=colour)
        ends = (-1000 * half_width, 1000 * half_width)
        ax.set(xlim=ends, ylim=ends, aspect="equal")
        ax.set(xlabel="along the level line (mm)", ylabel="up the slope (mm)")
        return ax

    def quantity(self, name: str) -> np.ndarray:
        """Return one of ``QUANTITIES`` by its name."""
        if name[0] == "d" and name[1:2].isdigit():
            return 1000 * self.distances_m[..., int(name[1]) - 1]
        return getattr(self, name)

    @property
    def _level(self):
        """Whether the surface has no horizontal line of its own."""
        return np.hypot(self.normal[..., 0], self.normal[..., 1]) < LEVEL

    def _spacing_along(self, other):
        """Gap between profiles along one of the axes, from the step along the other."""
        step = np.abs(self.plane_steps()[0][..., other])
        with np.errstate(divide="ignore"):
            return np.where(self._level, np.nan, self.cell_m2 / step)[()]


def scan_lattice(setup: ScanSetup, patch: Patch | Target) -> Lattice:
    """Return the scan lattice on each piece of a surface.

    The piece is struck when the scan plane comes past it. The pulses half a step before and after,
    and those half a revolution before and after at the same mirror angle, are intersected with the
    piece's plane in closed form, each from its own position and attitude.

    Parameters
    ----------
    setup : ScanSetup
    patch : Patch or Target
        Its shape and the set-up's broadcast.

    Returns
    -------
    Lattice
        NaN where a pulse does not meet the plane.

    Notes
    -----
    The lattice is local: over a wall of some metres range and incidence change, and so do the
    steps. Laid about the spot they are those of the spot; a step from the spot to the next pulse
    differs by half of what spacing changes from step to step (0.2 to 2 %), upwards and downwards
    with opposite signs. 1 / |a x b| is the density up to the square of the mirror's step (1e-5).

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
    if isinstance(patch, Target):
        patch = patch.patch(setup)
    shape = (*np.broadcast_shapes(setup.shape, patch.points.shape[:-1]), 3)
    # from where the scanner is when its plane comes past the points
    normal = setup.plane_normal
    wait = _dot(patch.points, normal) / normal[..., 1]
    beam = np.broadcast_to(patch.points - wait[..., None] * TRAVEL, shape)
    normal = np.broadcast_to(patch.normals, shape)
    pulse_rate, mirror = np.broadcast_arrays(setup.pulse_rate_hz, setup.mirror_frequency_hz)
    whole = np.round(pulse_rate / mirror)
    steps = (
        _step(setup, beam, normal, 1 / pulse_rate, mirror / pulse_rate),
        _step(setup, beam, normal, 1 / mirror, 0.0 * mirror),
        _step(setup, beam, normal, whole / pulse_rate, whole * mirror / pulse_rate - 1),
    )
    return Lattice(setup, beam, normal, *(np.broadcast_to(step, shape) for step in steps))


def lattice_distances(a, b):
    """Return d1..d4 of an endless lattice: the nearest points of the four quadrants, sorted.

    The quadrants are half open, each without the axis on its counter-clockwise side. The basis is
    reduced (Lagrange); then in each quadrant the nearest point lies on one of three rows, next to
    where the row is closest to the origin or enters the quadrant.

    Parameters
    ----------
    a, b : array_like, shape (..., 2)
        Two steps that span the lattice, in the axes of the quadrants.

    Returns
    -------
    array, shape (..., 4)
        In the unit of the steps; NaN where a step is not finite or the two are parallel. d1 = d2
        and d3 = d4, for a lattice looks the same from behind.

    References
    ----------
    Pfeifer et al. 2021, section 3.3. doi:10.3390/rs13020237

    Examples
    --------
    >>> lattice_distances([0.004, 0], [0.001, 0.047]).round(6).tolist()
    [0.004, 0.004, 0.047096, 0.047096]
    """
    a, b = np.broadcast_arrays(*(np.asarray(step, dtype=np.float64) for step in (a, b)))
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    with np.errstate(invalid="ignore"):
        spans = area > 1e-12 * np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    usable = spans[..., None]
    short, long = _reduced(np.where(usable, a, [1.0, 0.0]), np.where(usable, b, [0.0, 1.0]))
    near = np.sort([_nearest(short, long, side) for side in (1, -1)], axis=0)
    near = np.where(spans, near, np.nan)
    return np.stack([near[0], near[0], near[1], near[1]], axis=-1)


def _step(setup, beam, normal, seconds, turns):
    """Step on the plane from half a time and half a turn before to half of both after."""
    before, after = (_hit(setup, beam, normal, s * seconds / 2, s * turns / 2) for s in (-1, 1))
    return after - before


def _hit(setup, beam, normal, seconds, turns):
    """Where on the plane, seen from the spot, a pulse strikes some time and turn later."""
    local = np.swapaxes(setup.rotation(), -1, -2) @ beam[..., None]
    angle = np.arctan2(local[..., 2, 0], local[..., 0, 0]) + setup.spin * 2 * np.pi * turns
    aim = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    direction = (setup.rotation(seconds) @ aim[..., None])[..., 0]
    origin = setup.origin(seconds)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = _dot(beam - origin, normal) / _dot(direction, normal)
    ahead = np.isfinite(reach) & (reach > 0)
    return origin + np.where(ahead, reach, np.nan)[..., None] * direction - beam


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


def _nearest(short, long, side):
    """Distance of the nearest lattice point in the first (1) or second (-1) quadrant.

    A quadrant contains a disc of the covering radius, at most |long| / sqrt(2), within 1.71 |long|
    of the origin; rows are |long| sin(60) or more apart, so that the second row is out of reach.
    """
    u, v = (step[..., None, :] * [side, 1.0] for step in (short, long))
    start = np.array([[-1.0], [0.0], [1.0]]) * v
    foot = -_dot(start, u) / _dot(u, u)
    with np.errstate(divide="ignore", invalid="ignore"):
        enters = -start / u
    places = np.stack([foot, enters[..., 0], enters[..., 1]], axis=-1)
    places = np.where(np.isfinite(places), places, foot[..., None])
    k = np.floor(places)[..., None] + np.arange(-1, 3)
    point = start[..., None, None, :] + k[..., None] * u[..., None, None, :]
    length = np.linalg.norm(point, axis=-1)
    x, y = np.moveaxis(np.where(np.abs(point) <= 1e-9 * length[..., None], 0, point), -1, 0)
    inside = (x > 0) & (y >= 0) if side == 1 else (x >= 0) & (y > 0)
    return np.where(inside, length, np.inf).min(axis=(-3, -2, -1))


def rotations(roll, pitch, heading):
    """Rotations (..., 3, 3) from vehicle to track, Rz(-heading) Rx(pitch) Ry(roll), radians.

    Examples
    --------
    >>> (rotations(0, 0, np.pi / 2) @ [0, 1, 0]).round(12).tolist()
    [1.0, 0.0, 0.0]
    """
    angles = np.array(np.broadcast_arrays(roll, pitch, heading), dtype=np.float64)
    (sr, sp, sh), (cr, cp, ch) = np.sin(angles), np.cos(angles)
    rows = [
        [ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr],
        [-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr],
        [-cp * sr, sp, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def turned(*, z=0.0, x=0.0, y=0.0):
    """Rotations (..., 3, 3) Rz(z) Rx(x) Ry(y), degrees, counter-clockwise positive.

    Examples
    --------
    >>> (turned(z=90) @ [1, 0, 0]).round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    return rotations(np.radians(y), np.radians(x), -np.radians(z))


def target_normal(heading, tilt):
    """Normal Rz(heading) Ry(tilt) X of a target plane, (..., 3), of angles in degrees."""
    return turned(z=heading, y=tilt)[..., :, 0]


def check_values(values, name, *, positive=False):
    """Return finite float64 numbers of any shape, above zero if they must be."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"Invalid {name} {values!r}. Must be a number or an array of numbers.")
    bad = ~np.isfinite(array) | (positive & (array <= 0))
    if bad.any():
        must = "> 0 and finite" if positive else "finite"
        raise ValueError(f"Invalid {name} {array[bad].flat[0]}. Must be {must}.")
    return array.astype(np.float64)


def largest_speed(
    setup: ScanSetup, target: Target | Patch, *, quantity: str, limit: float
) -> float:
    """Return the largest speed at which a predicted quantity still keeps to a limit.

    Density must be the limit or more, spacings, distances and f the limit or less. The speeds
    between 0.01 and 100 m/s are tried in steps of 0.23 %, and the last one that will do is refined
    to 1e-9 m/s; so the answer is right also for f, which may rise, fall and rise again with speed.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers; its own speed does not matter.
    target : Target or Patch
        A target is laid out for the set-up; a patch must be a single spot.
    quantity : str
        One of ``QUANTITIES`` except the profile angle.
    limit : float
        In the quantity's unit.

    Returns
    -------
    float
        m/s.

    Raises
    ------
    ValueError
        If no speed in the range keeps to the limit, or the fastest still does.

    Notes
    -----
    For steady attitude a density has the closed form PRR cos(i) / (2 pi density R |Y.n_s|) and
    a perpendicular profile spacing is spacing x Mf |n_s x n_t| / |Y.n_s| up to the motion of the
    scan plane during a revolution.

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1,
    ...                   scanner_tilt_deg=45)
    >>> speed = largest_speed(setup, Target(range_m=5), quantity="density_per_m2", limit=3000)
    >>> round(3.6 * speed)
    54
    """
    check_choice(quantity, "quantity", [q for q in QUANTITIES if q != "profile_angle_deg"])
    limit = check_positive(limit, "limit")
    patch = target.patch(setup) if hasattr(target, "patch") else target
    if patch.points.ndim != 1:
        raise ValueError(f"Invalid patch of shape {patch.points.shape}. Must be a single spot.")
    speeds = np.geomspace(SLOWEST, FASTEST, SPEEDS)

    def margin(speed):
        """How far the quantity keeps to its limit, as a share of it; -1 if not defined."""
        values = scan_lattice(replace(setup, speed_m_s=speed), patch).quantity(quantity)
        share = values / limit - 1 if quantity == "density_per_m2" else 1 - values / limit
        return np.where(np.isnan(share), -1.0, share)

    kept = np.flatnonzero(margin(speeds) >= 0)
    if not len(kept) or kept[-1] == SPEEDS - 1:
        fails, value = ("fails", SLOWEST) if not len(kept) else ("is kept", FASTEST)
        raise ValueError(
            f"Invalid limit {limit} for {quantity}: it {fails} at every speed tried, {value} m/s "
            f"included. Must be reached between {SLOWEST} and {FASTEST} m/s."
        )
    return float(brentq(margin, *speeds[kept[-1] : kept[-1] + 2], xtol=1e-9))


def propagate(
    setup: ScanSetup,
    target: Target,
    *,
    sigmas: dict[str, float],
    draws: int = 2_000,
    seed: int = 0,
) -> pd.DataFrame:
    """Propagate errors of set-up and target to the prediction, by Monte Carlo.

    Independent normal errors are drawn, and the pattern is predicted each time. The plane stays
    where the nominal set-up finds it; a turned target turns about that spot.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    sigmas : dict of str to float
        Standard deviation of inputs by their names: fields of ``ScanSetup``;
        ``target_heading_deg``, ``target_tilt_deg``, ``range_m``, ``height_difference_m``.
    draws, seed : int

    Returns
    -------
    DataFrame
        A row per quantity: ``quantity``, ``predicted``, ``std``, ``low`` and ``high`` (2.5 % and
        97.5 %), ``n`` draws.

    Raises
    ------
    ValueError
        If an input is unknown, a deviation negative, or ``draws`` below 100.

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
    predicted = {key: values[0] for key, values in _predicted(setup, target, {}).items()}
    table = pd.DataFrame({"quantity": list(QUANTITIES), "predicted": predicted.values()})
    draws = check_count(draws, "draws", low=100)
    rng = np.random.default_rng(seed)
    errors = {name: sigma * rng.standard_normal(draws) for name, sigma in sigmas.items()}
    drawn = pd.DataFrame(_predicted(setup, target, errors)).to_numpy()
    table["std"] = np.std(drawn, axis=0, ddof=1)
    table["low"], table["high"] = np.quantile(drawn, (0.025, 0.975), axis=0)
    return table.assign(n=draws)


def explain_error(
    setup: ScanSetup,
    target: Target,
    *,
    quantity: str,
    measured: float,
    inputs: Sequence[str] = EXPLAINED,
) -> pd.DataFrame:
    """Return the change of each input, one at a time, that turns the prediction into a measurement.

    What Table 6 of Cahalane et al. 2014 gives for an error of 2 mm: of the changes that do it, the
    smallest, found within a tenth of a rate, 15 degrees or a fifth of a range.

    Parameters
    ----------
    setup : ScanSetup
        Of plain numbers.
    target : Target
    quantity : str
        One of the spacings, the angle or the density, see :func:`propagate`.
    measured : float
        In the quantity's unit.
    inputs : sequence of str
        As for :func:`propagate`; those of Table 6 where left out.

    Returns
    -------
    DataFrame
        ``input``, ``unit``, ``change`` (signed; NaN where no change in the range will do),
        ``predicted`` and ``measured``.

    Raises
    ------
    ValueError
        If quantity or input is unknown, or the measured value not finite.

    References
    ----------
    Cahalane et al. 2014, section 4.3, Table 6. doi:10.3390/s140609471

    Examples
    --------
    >>> from mmqa_lab.scan_pattern import ScanSetup, Target
    >>> setup = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10,
    ...                   scanner_heading_deg=45, scanner_tilt_deg=45)
    >>> table = explain_error(setup, Target(range_m=8), measured=0.102,
    ...                       quantity="profile_spacing_horizontal_m", inputs=["speed_m_s"])
    >>> print(table["change"].round(6).item())
    0.2
    """
    check_choice(quantity, "quantity", SMOOTH)
    check_number(measured, "measured")
    rows = []
    for name in inputs:
        check_choice(name, "input", INPUTS)
        change = _change(setup, target, quantity, measured, name)
        unit = next(unit for ending, unit in UNITS.items() if name.endswith(ending))
        rows.append((name, unit, change))
    table = pd.DataFrame(rows, columns=["input", "unit", "change"])
    predicted = _predicted(setup, target, {}, [quantity])[quantity][0]
    return table.assign(predicted=predicted, measured=measured)


def _change(setup, target, quantity, measured, name):
    """The smallest change of an input that does it; NaN where none does or all do."""
    given = getattr(target, TARGET_NAMES[name]) if name in TARGET_NAMES else getattr(setup, name)
    reach = 15.0 if name.endswith(("_deg", "_deg_s")) else 0.2 * abs(given) or 1.0

    def lack(change):
        """By how much the prediction exceeds the measurement once the input is changed."""
        return _predicted(setup, target, {name: change}, [quantity])[quantity] - measured

    tried = np.linspace(-reach, reach, 601)
    values = lack(tried)
    crossed = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) <= 0)
    if not len(crossed) or np.ptp(values) < 1e-12:
        return np.nan
    nearest = crossed[np.argmin(np.abs(tried[crossed] + tried[crossed + 1]))]
    return float(brentq(lambda x: lack(x)[0], tried[nearest], tried[nearest + 1]))


def _predicted(setup, target, errors, names=QUANTITIES):
    """Quantities, as arrays, with errors added to the named inputs."""
    shift = {name: np.atleast_1d(values) for name, values in errors.items()}
    changed = {name: getattr(setup, name) + shift[name] for name in shift if name in NUMBERS}
    moved = {
        field: getattr(target, field) + shift.get(name, np.zeros(1))
        for name, field in TARGET_NAMES.items()
    }
    normal = target_normal(moved.pop("heading_deg"), moved.pop("tilt_deg"))
    points = replace(target, **moved).patch(setup).points
    lattice = scan_lattice(replace(setup, **changed), Patch(points, -normal))
    return {name: np.atleast_1d(lattice.quantity(name)) for name in names}
