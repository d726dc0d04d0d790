"""Scanner, mounting and motion: everything about the scan that is not the surface."""

from dataclasses import dataclass, fields

import numpy as np

from mmqa_lab._checks import check_choice, check_points

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
