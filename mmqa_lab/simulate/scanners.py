"""Scanners by their data-sheet: 2-D profile scanners and rotating multi-beam scanners.

Mounting: the scanner's frame lies in the vehicle's (x right, y travel, z up) by Rz(heading)
Rx(tilt), tilt about the lateral axis first, both counter-clockwise positive as in MIMIC (Cahalane
et al. 2014, doi 10.3390/s140609471). A profile scanner spins about its own y, so that heading 0,
tilt 0 is the vertical plane across the track; a multi-beam scanner spins about its own z.
"""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.scan_pattern.lattice import rotations


@dataclass(frozen=True)
class Firing:
    """When and where to pulses leave, in the scanner's frame: one entry a pulse.

    Parameters
    ----------
    since_start : array, shape (n,)
        Seconds.
    scan_angle, elevation : array, shape (n,)
        Degrees; see the scanner's class.
    scan_line : array of int, shape (n,)
    ring : array of int, shape (n,), or None
    """

    since_start: np.ndarray
    scan_angle: np.ndarray
    elevation: np.ndarray
    scan_line: np.ndarray
    ring: np.ndarray = None

    def select(self, which):
        """Return the pulses of a mask."""
        ring = None if self.ring is None else self.ring[which]
        arrays = (self.since_start, self.scan_angle, self.elevation, self.scan_line)
        return Firing(*(values[which] for values in arrays), ring)


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """Mounting and errors that all scanners have.

    Parameters
    ----------
    pulse_rate_hz : float
        Measurements per second (PRR).
    field_of_view_deg : tuple of 2
        Scan angles between which pulses leave.
    lever_arm_m : tuple of 3
        Scanner from the vehicle's reference point, in the vehicle's frame.
    heading_deg, tilt_deg : float
        Dual-axis rotation of the mounting.
    boresight_deg : tuple of 3
        What the mounting differs from that in truth and the evaluation does not know: small
        rotations about the vehicle's y (roll), x (pitch) and -z (heading).
    range_noise_m : float
        Standard deviation of the range on a bright target.
    range_noise_weak_m : float
        What is added (in quadrature) where the signal is as weak as at ``max_range_m``; in
        proportion to the inverse square root of the signal.
    angle_noise_deg : float
        Standard deviation of the true scan angle about the recorded one.
    exit_diameter_m, divergence_mrad : float
        Beam at the exit and full angle, both at 1/e2 of the intensity. With both 0 a pulse is a
        line and no pixel is mixed.
    echo_separation_m : float
        Echoes of one pulse closer than that fall into one, which is a mixed pixel where they come
        from two surfaces; of farther ones the strongest is kept.
    min_range_m, max_range_m, max_range_reflectance : float
        Shortest range; range at which half of the pulses on a surface of that reflectance, hit
        square, return (inf: all always).
    fading : float
        Standard deviation of the natural logarithm of the signal.
    dropout_share : float
        Share of pulses lost for no reason of the scene.
    name, source, status : str
        Model, where the numbers come from, and "nominal" (data-sheet) or "calibrated".

    Raises
    ------
    ValueError
        If a field is out of its range.

    Examples
    --------
    >>> scanner = Scanner(pulse_rate_hz=1e6, heading_deg=90)
    >>> (scanner.mounting @ [0, 1, 0]).round(9).tolist()  # its forward is the vehicle's left
    [-1.0, 0.0, 0.0]
    """

    pulse_rate_hz: float
    field_of_view_deg: tuple = (-180.0, 180.0)
    lever_arm_m: tuple = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    tilt_deg: float = 0.0
    boresight_deg: tuple = (0.0, 0.0, 0.0)
    range_noise_m: float = 0.0
    range_noise_weak_m: float = 0.0
    angle_noise_deg: float = 0.0
    exit_diameter_m: float = 0.0
    divergence_mrad: float = 0.0
    echo_separation_m: float = 0.6
    min_range_m: float = 0.0
    max_range_m: float = np.inf
    max_range_reflectance: float = 0.8
    fading: float = 0.2
    dropout_share: float = 0.0
    name: str = ""
    source: str = ""
    status: str = "nominal"

    def __post_init__(self):
        check_positive(self.pulse_rate_hz, "pulse_rate_hz", unit="Hz")
        low, high = self.field_of_view_deg
        check_number(low, "field_of_view_deg", low=-180, high=180)
        check_number(high, "field_of_view_deg", low=low, high=180)
        check_number(self.dropout_share, "dropout_share", low=0, high=1)
        check_number(self.max_range_reflectance, "max_range_reflectance", low=0.01, high=1)
        for name in _NOT_NEGATIVE:
            check_number(getattr(self, name), name, low=0)
        for name in ("lever_arm_m", "boresight_deg"):
            check_points([getattr(self, name)], name=name)

    @property
    def mounting(self):
        """Assumed rotation (3, 3) from the scanner's frame to the vehicle's."""
        a, g = np.radians([self.heading_deg, self.tilt_deg])
        return rotations(*np.array([[0.0], [g], [-a]]))[0]

    @property
    def true_mounting(self):
        """Rotation with the boresight error, (3, 3)."""
        return rotations(*np.radians(self.boresight_deg)[:, None])[0] @ self.mounting

    def _turn(self, pulse, frequency):
        """Turns done and angle now of the pulses within the field of view, and which those are."""
        turns = pulse * (frequency / self.pulse_rate_hz)
        done = np.floor(turns)
        angle = 360 * (turns - done) - 180
        low, high = self.field_of_view_deg
        left = (angle >= low) & (angle <= high)
        return done[left].astype(np.int64), angle[left], left

    @property
    def beam_radius(self):
        """Radius of the beam at the exit (m) and its growth with range (m/m)."""
        return self.exit_diameter_m / 2, np.tan(self.divergence_mrad / 2000)


_NOT_NEGATIVE = (
    "range_noise_m",
    "range_noise_weak_m",
    "angle_noise_deg",
    "exit_diameter_m",
    "divergence_mrad",
    "echo_separation_m",
    "min_range_m",
    "fading",
)


@dataclass(frozen=True, kw_only=True)
class ProfileScanner(Scanner):
    """A 2-D scanner: one beam that turns in a plane.

    The scan angle is 0 towards the scanner's -z (nadir), 90 towards its +x (right of the vehicle),
    180 = -180 towards +z, where a new scan line begins; pulses run through it upwards.

    Parameters
    ----------
    mirror_frequency_hz : float
        Revolutions per second, one profile each (Mf).
    **scanner
        See ``Scanner``.

    Raises
    ------
    ValueError
        If a field is out of its range.

    Examples
    --------
    >>> scanner = ProfileScanner(pulse_rate_hz=4e5, mirror_frequency_hz=100, tilt_deg=30)
    >>> scanner.plane_normal[1:].round(3).tolist()
    [0.866, 0.5]
    """

    mirror_frequency_hz: float

    def __post_init__(self):
        super().__post_init__()
        check_positive(self.mirror_frequency_hz, "mirror_frequency_hz", unit="Hz")

    @property
    def elevations_deg(self):
        """Elevation of the only beam above the scan plane."""
        return (0.0,)

    @property
    def plane_normal(self):
        """Normal of the scan plane in the vehicle's frame, (3,)."""
        return self.mounting[:, 1]

    def fire(self, pulse):
        """Return the ``Firing`` of pulses counted from the start, and which of them left."""
        line, angle, left = self._turn(pulse, self.mirror_frequency_hz)
        since = pulse[left] / self.pulse_rate_hz
        return Firing(since, angle, np.zeros(len(since)), line), left

    @staticmethod
    def beams(angle, elevation):
        """Unit vectors in the scanner's frame, (n, 3), of angles in radians."""
        return np.stack([np.sin(angle), np.sin(elevation), -np.cos(angle)], axis=1)

    @staticmethod
    def angles(vectors):
        """Scan angle and elevation above the scan plane, degrees, of vectors, (..., 3)."""
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.degrees(np.arctan2(x, -z)), np.degrees(np.arctan2(y, np.hypot(x, z)))


@dataclass(frozen=True, kw_only=True)
class MultiBeamScanner(Scanner):
    """A stack of beams that turns about the scanner's z.

    The scan angle is the azimuth: 0 towards the scanner's +y, clockwise positive seen from above,
    -180 to 180. Pulses leave one after the other, from the first beam to the last, then again. A
    scan line is one beam's revolution; ``ring`` counts the beams from the lowest.

    Parameters
    ----------
    spin_hz : float
        Revolutions per second.
    elevations_deg : tuple of float
        Of the beams in the order of firing, degrees above the plane of rotation.
    **scanner
        See ``Scanner``.

    Raises
    ------
    ValueError
        If a field is out of its range.

    Examples
    --------
    >>> scanner = MultiBeamScanner(pulse_rate_hz=3600, spin_hz=10, elevations_deg=(-10, 10))
    >>> firing, _ = scanner.fire(np.arange(4))
    >>> firing.ring.tolist(), firing.elevation.tolist()
    ([0, 1, 0, 1], [-10.0, 10.0, -10.0, 10.0])
    """

    spin_hz: float
    elevations_deg: tuple

    def __post_init__(self):
        super().__post_init__()
        check_positive(self.spin_hz, "spin_hz", unit="Hz")
        for elevation in self.elevations_deg:
            check_number(elevation, "elevations_deg", low=-90, high=90, unit="degrees")

    def fire(self, pulse):
        """Return the ``Firing`` of pulses counted from the start, and which of them left."""
        turn, angle, left = self._turn(pulse, self.spin_hz)
        elevations = np.asarray(self.elevations_deg, dtype=np.float64)
        beam = pulse[left] % len(elevations)
        ring = np.argsort(np.argsort(elevations))[beam]
        line = turn * len(elevations) + ring
        return Firing(pulse[left] / self.pulse_rate_hz, angle, elevations[beam], line, ring), left

    @staticmethod
    def beams(angle, elevation):
        """Unit vectors in the scanner's frame, (n, 3), of angles in radians."""
        level = np.cos(elevation)
        return np.stack([level * np.sin(angle), level * np.cos(angle), np.sin(elevation)], axis=1)

    @staticmethod
    def angles(vectors):
        """Scan angle and elevation above the plane of rotation, degrees, of vectors, (..., 3)."""
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.degrees(np.arctan2(x, y)), np.degrees(np.arctan2(z, np.hypot(x, y)))
