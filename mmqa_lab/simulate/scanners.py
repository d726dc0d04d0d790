"""Scanners by their data-sheet, and the echoes that their pulses bring.

Mounting: the scanner's frame lies in the vehicle's (x right, y travel, z up) by Rz(heading)
Rx(tilt), tilt about the lateral axis first, both counter-clockwise positive as in MIMIC (Cahalane
et al. 2014, doi 10.3390/s140609471). A profile scanner spins about its own y, so that heading 0,
tilt 0 is the vertical plane across the track; a multi-beam scanner spins about its own z.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit, prange

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.scan_pattern.lattice import rotations
from mmqa_lab.simulate.scenes import STACK, TASK, describe, mapped, nearest

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

FOOTPRINT = 7
"""Rays a beam: its axis and a ring."""

RING = 0.651
"""Radius of the ring over the 1/e2 radius: median of the outer 6/7 of a Gaussian beam."""

SIGNED = ("heading_deg", "tilt_deg", "max_range_m")
"""Numbers of a scanner that are not checked: angles may have any sign, a range may be endless."""

LIMITS = {"dropout_share": (0, 1), "max_range_reflectance": (0.01, 1)}
"""Between which the others lie that have an upper limit."""


class Firing(NamedTuple):
    """When and where to pulses leave, in the scanner's frame: one entry a pulse.

    Seconds; degrees, see the scanner's class; numbers of the scan line and of the beam.
    """

    since_start: np.ndarray
    scan_angle: np.ndarray
    elevation: np.ndarray
    scan_line: np.ndarray
    ring: np.ndarray = None


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
    divergence_axial_mrad : float
        Full angle towards the axis of rotation, where the beam is not round; 0 where it is.
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
    divergence_axial_mrad: float = 0.0
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
        numbers = [one.name for one in fields(Scanner) if isinstance(one.default, float)]
        for name in numbers:
            if name not in SIGNED:
                least, most = LIMITS.get(name, (0, None))
                check_number(getattr(self, name), name, low=least, high=most)
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

    @property
    def widening(self):
        """What the beam is wider by towards the axis of rotation, as a share of its growth."""
        if not self.divergence_axial_mrad:
            return 0.0
        return self.divergence_axial_mrad / self.divergence_mrad - 1


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

    AXIS = (0.0, 1.0, 0.0)
    """Of rotation, in the scanner's frame."""

    def __post_init__(self):
        super().__post_init__()
        check_positive(self.mirror_frequency_hz, "mirror_frequency_hz", unit="Hz")

    @property
    def elevations_deg(self) -> tuple[float]:
        """Elevation of the only beam above the scan plane."""
        return (0.0,)

    @property
    def plane_normal(self) -> np.ndarray:
        """Normal of the scan plane in the vehicle's frame, (3,)."""
        return self.mounting[:, 1]

    def fire(self, pulse: ArrayLike) -> tuple[Firing, np.ndarray]:
        """Return the ``Firing`` of pulses counted from the start, and which of them left."""
        line, angle, left = self._turn(pulse, self.mirror_frequency_hz)
        since = pulse[left] / self.pulse_rate_hz
        return Firing(since, angle, np.zeros(len(since)), line), left

    @staticmethod
    def beams(angle: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Unit vectors in the scanner's frame, (n, 3), of angles in radians."""
        return np.stack([np.sin(angle), np.sin(elevation), -np.cos(angle)], axis=1)

    @staticmethod
    def angles(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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

    AXIS = (0.0, 0.0, 1.0)
    """Of rotation, in the scanner's frame."""

    def __post_init__(self):
        super().__post_init__()
        check_positive(self.spin_hz, "spin_hz", unit="Hz")
        for elevation in self.elevations_deg:
            check_number(elevation, "elevations_deg", low=-90, high=90, unit="degrees")

    def fire(self, pulse: ArrayLike) -> tuple[Firing, np.ndarray]:
        """Return the ``Firing`` of pulses counted from the start, and which of them left."""
        turn, angle, left = self._turn(pulse, self.spin_hz)
        elevations = np.asarray(self.elevations_deg, dtype=np.float64)
        beam = pulse[left] % len(elevations)
        ring = np.argsort(np.argsort(elevations))[beam]
        line = turn * len(elevations) + ring
        return Firing(pulse[left] / self.pulse_rate_hz, angle, elevations[beam], line, ring), left

    @staticmethod
    def beams(angle: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Unit vectors in the scanner's frame, (n, 3), of angles in radians."""
        level = np.cos(elevation)
        return np.stack([level * np.sin(angle), level * np.cos(angle), np.sin(elevation)], axis=1)

    @staticmethod
    def angles(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scan angle and elevation above the plane of rotation, degrees, of vectors, (..., 3)."""
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.degrees(np.arctan2(x, y)), np.degrees(np.arctan2(z, np.hypot(x, y)))


@njit(cache=True)
def _turned(state, x, y, z):
    """Rz(-heading) Rx(pitch) Ry(roll), the angles at the end of ``state``, applied to a vector."""
    s, c = np.sin(state[3]), np.cos(state[3])
    x, z = c * x + s * z, c * z - s * x
    s, c = np.sin(state[4]), np.cos(state[4])
    y, z = c * y - s * z, s * y + c * z
    s, c = np.sin(state[5]), np.cos(state[5])
    return c * x + s * y, c * y - s * x, z


@njit(cache=True, parallel=True)
def beam_rays(states, lever_arm, mounting, beams):
    """Origins and directions of beams in a mounted scanner's frame on a vehicle in given states.

    ``states`` are offsets in metres and roll, pitch, heading in radians, (n, 6).
    """
    n = len(beams)
    origins, directions = np.empty((n, 3)), np.empty((n, 3))
    matrix = np.ascontiguousarray(mounting).ravel()
    for k in prange(n):
        x, y, z = _turned(states[k], lever_arm[0], lever_arm[1], lever_arm[2])
        origins[k, 0], origins[k, 1] = states[k, 0] + x, states[k, 1] + y
        origins[k, 2] = states[k, 2] + z
        x, y, z = mapped(matrix, beams[k, 0], beams[k, 1], beams[k, 2])
        x, y, z = _turned(states[k], x, y, z)
        directions[k, 0], directions[k, 1], directions[k, 2] = x, y, z
    return origins, directions


@njit(cache=True, error_model="numpy")
def _perpendicular(dx, dy, dz, turn):
    """Unit vector square to a unit vector, at a turn about it in radians."""
    if abs(dx) < 0.6:
        ax, ay, az = 0.0, dz, -dy
    else:
        ax, ay, az = -dz, 0.0, dx
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    c, s = np.cos(turn), np.sin(turn)
    return c * ax + s * bx, c * ay + s * by, c * az + s * bz


@njit(cache=True, error_model="numpy")
def _echo(tree, ray, t, i, echo):
    """Write range, signal, cosine and surface of a ray that meets primitive ``i`` at ``t``."""
    c = tree.centre[i]
    x, y, z = ray[0] - c[0] + t * ray[3], ray[1] - c[1] + t * ray[4], ray[2] - c[2] + t * ray[5]
    nx, ny, nz, reflectance = describe(tree, i, x, y, z)
    cosine = abs(nx * ray[3] + ny * ray[4] + nz * ray[5])
    echo[0], echo[1] = t, reflectance * cosine / (t * t)
    echo[2], echo[3] = cosine, tree.surface[i]


@njit(cache=True, error_model="numpy")
def _strongest(hits, n, separation):
    """First and last of the sorted hits that make the strongest echo."""
    best, first, last = -1.0, 0, 0
    start = 0
    while start < n:
        stop, signal = start, 0.0
        while stop < n and (stop == start or hits[stop, 0] - hits[stop - 1, 0] <= separation):
            signal += hits[stop, 1]
            stop += 1
        if signal > best:
            best, first, last = signal, start, stop
        start = stop
    return first, last


@njit(cache=True, error_model="numpy")
def _spread(rays, radius, growth, axis, turn):
    """Write the ring of rays that stand for equal shares of a Gaussian beam about the first one.

    ``axis`` is a vector across the beam: along it the beam grows by its length as much again.
    """
    ray, g = rays[0], RING * growth
    more = axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]
    length = np.sqrt(1 + g * g)
    for k in range(len(rays) - 1):
        ex, ey, ez = _perpendicular(ray[3], ray[4], ray[5], turn + 2 * np.pi * k / (FOOTPRINT - 1))
        if more > 0.0:
            along = (ex * axis[0] + ey * axis[1] + ez * axis[2]) / np.sqrt(more)
            ex, ey, ez = ex + along * axis[0], ey + along * axis[1], ez + along * axis[2]
        part = rays[k + 1]
        part[0] = ray[0] + RING * radius * ex
        part[1] = ray[1] + RING * radius * ey
        part[2] = ray[2] + RING * radius * ez
        part[3] = (ray[3] + g * ex) / length
        part[4] = (ray[4] + g * ey) / length
        part[5] = (ray[5] + g * ez) / length


@njit(cache=True, error_model="numpy")
def _sorted_hits(tree, rays, best, hit, hits):
    """Write what the rays met, nearest first, and return how many met something."""
    n = 0
    for k in range(len(rays)):
        if hit[k] < 0:
            continue
        _echo(tree, rays[k], best[k], hit[k], hits[n])
        j = n
        while j > 0 and hits[j, 0] < hits[j - 1, 0]:
            for m in range(4):
                hits[j, m], hits[j - 1, m] = hits[j - 1, m], hits[j, m]
            j -= 1
        n += 1
    return n


class Echoes(NamedTuple):
    """The strongest echo of each pulse, NaN and surface -1 where there is none.

    ``signal`` is reflectance x cosine(incidence) / range2, summed over the parts of the beam.
    """

    range_m: np.ndarray
    surface: np.ndarray
    cosine: np.ndarray
    signal: np.ndarray
    mixed: np.ndarray


def chosen(columns, which):
    """The rows of a mask of a ``Firing`` or of ``Echoes``."""
    return type(columns)(*(None if values is None else values[which] for values in columns))


@njit(cache=True, parallel=True, error_model="numpy")
def echoes(tree, origins, directions, radius, growth, turn, separation, axis):
    """The arrays of the ``Echoes`` of pulses along unit directions.

    A beam of 1/e2 ``radius`` at the exit that grows by ``growth`` a metre is cast as its axis and a
    ring of six rays, each an equal share of its energy, turned by ``turn`` (0 to 1) at random. Hits
    closer than ``separation`` in range fall into one echo: its range is their mean weighted by the
    signal, its signal their sum, its surface and cosine those of its strongest part; it is mixed
    where they belong to several surfaces. A beam that is not round is wider along ``axis`` (n, 3),
    by the length of that vector as much again.
    """
    n = len(origins)
    wide = radius > 0.0 or growth > 0.0
    parts = FOOTPRINT if wide else 1
    ranges, surface = np.full(n, np.nan), np.full(n, -1, np.int32)
    cosine, signal = np.full(n, np.nan), np.zeros(n)
    mixed = np.zeros(n, np.bool_)
    for task in prange((n + TASK - 1) // TASK):
        stack, hit = np.empty(STACK, np.int64), np.empty(parts, np.int64)
        rays, best, hits = np.empty((parts, 9)), np.empty(parts), np.empty((parts, 4))
        for k in range(task * TASK, min((task + 1) * TASK, n)):
            rays[0, :3], rays[0, 3:6] = origins[k], directions[k]
            _spread(rays, radius, growth, axis[k % len(axis)], 2 * np.pi * turn[k])
            nearest(tree, stack, rays, best, hit)
            found = _sorted_hits(tree, rays, best, hit, hits)
            if found == 0:
                continue
            first, last = _strongest(hits, found, separation)
            top, weighted = first, 0.0
            for j in range(first, last):
                signal[k] += hits[j, 1]
                weighted += hits[j, 1] * (hits[j, 0] - hits[first, 0])
                mixed[k] |= hits[j, 3] != hits[first, 3]
                if hits[j, 1] > hits[top, 1]:
                    top = j
            ranges[k] = hits[first, 0] + (weighted / signal[k] if signal[k] > 0.0 else 0.0)
            surface[k], cosine[k] = hits[top, 3], hits[top, 2]
            signal[k] *= 1.0 / parts
    return ranges, surface, cosine, signal, mixed
