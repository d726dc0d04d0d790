"""What a scan consists of: scanner, mounting and motion, and the surface that is struck."""

from dataclasses import dataclass, fields

import numpy as np

from mmqa_lab._checks import check_choice, check_points, check_positive

POSITIVE = ("pulse_rate_hz", "mirror_frequency_hz", "speed_m_s")


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
    >>> setup.plane_normal.round(4).tolist(), setup.profile_advance_m.round(4).item()
    ([-0.5, 0.5, 0.7071], 0.05)
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
        self._check_shapes()
        if (np.abs(self.plane_normal[..., 1]) < 1e-9).any():
            raise ValueError(
                f"Invalid scanner_heading_deg {self.scanner_heading_deg} with scanner_tilt_deg "
                f"{self.scanner_tilt_deg}. Must turn the scan plane off the direction of travel."
            )

    def _check_shapes(self):
        """Refuse arrays that do not broadcast."""
        shapes = {name: np.shape(getattr(self, name)) for name in NUMBERS}
        try:
            np.broadcast_shapes(*shapes.values())
        except ValueError:
            arrays = {name: shape for name, shape in shapes.items() if shape}
            raise ValueError(f"Invalid shapes {arrays}. Must broadcast.") from None

    @classmethod
    def of_scanner(cls, scanner, *, speed_m_s, **motion):
        """Return the set-up of a simulated profile scanner, driven at a speed.

        Parameters
        ----------
        scanner : object
            Has ``pulse_rate_hz``, ``mirror_frequency_hz``, ``heading_deg``, ``tilt_deg``,
            ``boresight_deg`` and ``lever_arm_m``, as ``simulate.ProfileScanner`` does.
        speed_m_s : float
        **motion
            Attitude and its rates, as for ``ScanSetup``.
        """
        roll, pitch, heading = scanner.boresight_deg
        return cls(
            pulse_rate_hz=scanner.pulse_rate_hz,
            mirror_frequency_hz=scanner.mirror_frequency_hz,
            speed_m_s=speed_m_s,
            scanner_heading_deg=scanner.heading_deg,
            scanner_tilt_deg=scanner.tilt_deg,
            boresight_roll_deg=roll,
            boresight_pitch_deg=pitch,
            boresight_heading_deg=heading,
            lever_arm_m=scanner.lever_arm_m,
            **motion,
        )

    @property
    def shape(self):
        """Shape to which the numbers broadcast; () for plain numbers."""
        return np.broadcast_shapes(*(np.shape(getattr(self, name)) for name in NUMBERS))

    @property
    def pulses_per_revolution(self):
        """PRR / Mf (PpM); need not be whole."""
        return np.divide(self.pulse_rate_hz, self.mirror_frequency_hz)

    @property
    def pulse_step_deg(self):
        """Turn of the mirror from pulse to pulse (theta_A)."""
        return 360 / self.pulses_per_revolution

    @property
    def velocity(self):
        """Velocity of the vehicle, (..., 3), m/s."""
        return np.multiply.outer(np.asarray(self.speed_m_s, dtype=np.float64), [0.0, 1.0, 0.0])

    @property
    def plane_normal(self):
        """Normal of the scan plane at the moment of the pulse (n_s), (..., 3)."""
        return self.rotation()[..., :, 1]

    @property
    def profile_advance_m(self):
        """Gap between the planes of consecutive profiles, v |Y.n_s| / Mf, for steady attitude."""
        return np.abs(self.plane_normal[..., 1]) * self.speed_m_s / self.mirror_frequency_hz

    @property
    def mounting(self):
        """Rotation (..., 3, 3) from the scanner's frame to the vehicle's, boresight included."""
        error = attitude(
            self.boresight_roll_deg, self.boresight_pitch_deg, self.boresight_heading_deg
        )
        return error @ turned("z", self.scanner_heading_deg) @ turned("x", self.scanner_tilt_deg)

    def vehicle_rotation(self, seconds=0.0):
        """Rotation (..., 3, 3) from the vehicle's frame to the track's, some time after."""
        return attitude(
            self.roll_deg + np.multiply(self.roll_rate_deg_s, seconds),
            self.pitch_deg + np.multiply(self.pitch_rate_deg_s, seconds),
            self.heading_deg + np.multiply(self.heading_rate_deg_s, seconds),
        )

    def rotation(self, seconds=0.0):
        """Rotation (..., 3, 3) from the scanner's frame to the track's, some time after."""
        return self.vehicle_rotation(seconds) @ self.mounting

    def origin(self, seconds):
        """Where the scanner is some time after the pulse, (..., 3), m."""
        shift = self.velocity * np.asarray(seconds, dtype=np.float64)[..., None]
        if not any(self.lever_arm_m):
            return shift
        turn = self.vehicle_rotation(seconds) - self.vehicle_rotation()
        return shift + turn @ np.asarray(self.lever_arm_m, dtype=np.float64)

    def turn_rate(self):
        """Angular velocity of the vehicle in the track's frame, (..., 3), rad/s."""
        axes = turned("z", np.negative(self.heading_deg))
        pitched = axes @ turned("x", self.pitch_deg)
        rates = np.radians(
            np.broadcast_arrays(
                self.pitch_rate_deg_s, self.roll_rate_deg_s, self.heading_rate_deg_s
            )
        )
        pitch, roll, heading = rates[..., None]
        return pitch * axes[..., :, 0] + roll * pitched[..., :, 1] - heading * [0.0, 0.0, 1.0]


NUMBERS = tuple(
    field.name for field in fields(ScanSetup) if field.name not in ("lever_arm_m", "spin")
)
"""The fields of a set-up that are numbers and may be arrays."""


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

    @classmethod
    def cylinder(cls, axis_point, radius, *, azimuths_deg, heights_m):
        """Return the surface of an upright post as patches.

        Parameters
        ----------
        axis_point : array_like, shape (2,)
            X and Y of the axis, metres from the scanner.
        radius : float
            Metres.
        azimuths_deg : array_like, shape (n,)
            Directions from the axis, counter-clockwise from X.
        heights_m : array_like, shape (m,)
            Above the scanner.

        Returns
        -------
        Patch
            Of shape (m, n, 3), normals outwards.

        Raises
        ------
        ValueError
            If the radius is not above zero or a place is not finite.

        Examples
        --------
        >>> post = Patch.cylinder([5, 0], 0.15, azimuths_deg=[180], heights_m=[0])
        >>> post.points.round(9).tolist(), post.normals.round(9).tolist()
        ([[[4.85, 0.0, 0.0]]], [[[-1.0, 0.0, 0.0]]])
        """
        radius = check_positive(radius, "radius", unit="m")
        axis = check_points([axis_point], name="axis_point", columns=2)[0]
        azimuth, height = np.meshgrid(
            np.radians(check_values(azimuths_deg, "azimuths_deg")),
            check_values(heights_m, "heights_m"),
        )
        normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
        places = np.stack(np.broadcast_arrays(axis[0], axis[1], height), axis=-1)
        return cls(places + radius * normals, normals)


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
    def normal(self):
        """Normal of the plane, away from the vehicle (n_t), (..., 3)."""
        return target_normal(self.heading_deg, self.tilt_deg)

    def patch(self, setup):
        """Return the spot of the plane that is evaluated.

        Raises
        ------
        ValueError
            If the horizontal pulse does not meet the plane's front.
        """
        rotation = turned("z", setup.scanner_heading_deg) @ turned("x", setup.scanner_tilt_deg)
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


def target_normal(heading, tilt):
    """Normal Rz(heading) Ry(tilt) X of a target plane, (..., 3), of angles in degrees."""
    return (turned("z", heading) @ turned("y", tilt))[..., :, 0]


def attitude(roll, pitch, heading):
    """Rotation (..., 3, 3) from vehicle to track, Rz(-heading) Rx(pitch) Ry(roll), degrees."""
    return rotations(*(np.radians(angle) for angle in (roll, pitch, heading)))


def rotations(roll, pitch, heading):
    """Rotations (..., 3, 3) as of ``attitude``, of angles in radians that broadcast.

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


def turned(axis, degrees):
    """Rotations (..., 3, 3) about a coordinate axis, counter-clockwise positive.

    Examples
    --------
    >>> (turned("z", 90) @ [1, 0, 0]).round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    angle = np.radians(np.asarray(degrees, dtype=np.float64))
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.zeros((*angle.shape, 3, 3))
    k = 3 - i - j
    matrix[..., k, k] = 1
    matrix[..., i, i] = matrix[..., j, j] = c
    matrix[..., i, j], matrix[..., j, i] = -s, s
    return matrix


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
