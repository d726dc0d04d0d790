"""Scanners by their data-sheet, and their drives through a scene.

Mounting: the scanner's frame lies in the vehicle's (x right, y travel, z up) by Rz(heading)
Rx(tilt), tilt about the lateral axis first, both counter-clockwise positive as in MIMIC (Cahalane
et al. 2014, doi 10.3390/s140609471). A scanner spins about its own y, so that heading 0, tilt 0 is
the vertical plane across the track. A scanner that spins about the vertical is the same, turned up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from mmqa_lab._checks import check_number, check_points, check_positive, check_values
from mmqa_lab._compiled import njit
from mmqa_lab._streams import stream
from mmqa_lab.cloud import Cloud
from mmqa_lab.rotations import across, fixed, rotations
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.trajectories import Trajectory

__all__ = ["RING", "Scanner", "scan"]

RING = 0.651
"""Radius of the ring over the 1/e2 radius: median of the outer 6/7 of a Gaussian beam."""

FEW_SURFACES, NODE_S, SLACK_M = 64, 0.01, 0.05
"""Scenes with at most so many primitives are first asked which beams may meet their boxes: from
places of the scanner so many seconds apart, with so many metres of slack for its way in between."""


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """A scanner whose beams turn about one axis: one beam measures profiles, several are a stack.

    The scan angle is 0 towards the scanner's -z, 90 towards its +x, 180 = -180 towards +z, where a
    new scan line begins: nadir, right of the vehicle and zenith of a profile scanner without tilt,
    ahead, right and back of an upright stack. Pulses leave one after the other, from the first beam
    to the last, then again.

    Parameters
    ----------
    pulse_rate_hz : float
        Measurements per second (PRR), of all beams together.
    mirror_frequency_hz : float
        Revolutions per second (Mf).
    elevations_deg : tuple of float
        Of the beams in the order of firing, degrees from the plane of rotation towards the axis.
    field_of_view_deg : tuple of 2
        Scan angles between which pulses leave.
    lever_arm_m : tuple of 3
        Scanner from the vehicle's reference point, in the vehicle's frame.
    heading_deg, tilt_deg : float
        Dual-axis rotation of the mounting.
    upright : bool
        Whether the scanner without tilt spins about the vertical, not about the track.
    boresight_deg : tuple of 3
        By which the true mounting differs from the assumed one: small rotations about the vehicle's
        y (roll), x (pitch) and -z (heading).
    range_noise_m : float
        Standard deviation of the range.
    angle_noise_deg : float
        Standard deviation of the true scan angle about the recorded one.
    exit_diameter_m, divergence_mrad : float
        Beam at the exit and full angle, both at 1/e2 of the intensity. With both 0 a pulse is a
        line and no pixel is mixed. Of several echoes the strongest is kept; those closer than
        0.6 m fall into one, a mixed pixel where they come from two surfaces.
    min_range_m, max_range_m, max_range_reflectance : float
        Shortest range; range at which half of the pulses on a surface of that reflectance, hit
        square, return (inf: all always).
    dropout_share : float
        Share of pulses lost for no reason of the scene.
    name, source : str
        Model, and where the numbers come from.

    Raises
    ------
    ValueError
        If a field is out of its range.

    Examples
    --------
    >>> scanner = Scanner(pulse_rate_hz=4e5, mirror_frequency_hz=100, tilt_deg=30)
    >>> scanner.plane_normal[1:].round(3).tolist()
    [0.866, 0.5]
    >>> pair = Scanner(pulse_rate_hz=3600, mirror_frequency_hz=10, elevations_deg=(10, -10))
    >>> pair.fire(np.arange(4))["ring"].tolist()
    [1, 0, 1, 0]
    """

    pulse_rate_hz: float
    mirror_frequency_hz: float
    elevations_deg: tuple = (0.0,)
    field_of_view_deg: tuple = (-180.0, 180.0)
    lever_arm_m: tuple = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    tilt_deg: float = 0.0
    upright: bool = False
    boresight_deg: tuple = (0.0, 0.0, 0.0)
    range_noise_m: float = 0.0
    angle_noise_deg: float = 0.0
    exit_diameter_m: float = 0.0
    divergence_mrad: float = 0.0
    min_range_m: float = 0.0
    max_range_m: float = np.inf
    max_range_reflectance: float = 0.8
    dropout_share: float = 0.0
    name: str = ""
    source: str = ""

    def __post_init__(self):
        for name in ("pulse_rate_hz", "mirror_frequency_hz"):
            check_positive(getattr(self, name), name, unit="Hz")
        low, high = self.field_of_view_deg
        check_number(low, "field_of_view_deg", low=-180, high=180)
        check_number(high, "field_of_view_deg", low=low, high=180)
        sizes = "range_noise_m", "angle_noise_deg", "exit_diameter_m", "divergence_mrad"
        for name in (*sizes, "min_range_m"):
            check_number(getattr(self, name), name, low=0)
        check_number(self.dropout_share, "dropout_share", low=0, high=1)
        check_values([self.heading_deg, self.tilt_deg], "heading_deg and tilt_deg")
        if not self.max_range_m > 0:
            raise ValueError(f"Invalid max_range_m {self.max_range_m}. Must be > 0 m.")
        for name in ("lever_arm_m", "boresight_deg"):
            check_points([getattr(self, name)], name=name)

    @cached_property
    def mounting(self) -> np.ndarray:
        """Assumed rotation (3, 3) from the scanner's frame to the vehicle's."""
        return fixed(0.0, *np.radians([self.tilt_deg + 90 * self.upright, -self.heading_deg]))

    @cached_property
    def true_mounting(self) -> np.ndarray:
        """Rotation with the boresight error, (3, 3)."""
        return fixed(*np.radians(self.boresight_deg)) @ self.mounting

    @property
    def plane_normal(self) -> np.ndarray:
        """Axis of rotation, the normal of the scan plane, in the vehicle's frame, (3,)."""
        return self.mounting[:, 1]

    def fire(self, pulse: np.ndarray) -> dict[str, np.ndarray]:
        """Return ``pulse``, ``scan_angle``, ``scan_line`` and ``ring`` of the pulses that leave.

        Pulses are counted from the start, a scan line is one beam's revolution, and ``ring`` counts
        the beams from the lowest.
        """
        turns = pulse * (self.mirror_frequency_hz / self.pulse_rate_hz)
        revolution = np.floor(turns)
        angle = 360 * (turns - revolution) - 180
        low, high = self.field_of_view_deg
        left = (angle >= low) & (angle <= high)
        beams = len(self.elevations_deg)
        ring = np.argsort(np.argsort(self.elevations_deg))[pulse[left] % beams]
        line = revolution[left].astype(np.int64) * beams + ring
        return {"pulse": pulse[left], "scan_angle": angle[left], "scan_line": line, "ring": ring}

    @staticmethod
    def beams(angle: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Unit vectors in the scanner's frame, (n, 3), of angles in radians."""
        level = np.cos(elevation)
        aside, down = level * np.sin(angle), level * np.cos(angle)
        return np.stack([aside, np.sin(elevation) + 0 * aside, -down], axis=1)

    @staticmethod
    def angles(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scan angle and elevation above the scan plane, degrees, of vectors, (..., 3)."""
        x, y, z = np.moveaxis(vectors, -1, 0)
        return np.degrees(np.arctan2(x, -z)), np.degrees(np.arctan2(y, np.hypot(x, z)))


def scan(
    scene: Scene,
    scanner: Scanner | list[Scanner],
    trajectory: Trajectory,
    *,
    seed: int | Sequence[int],
    measured: Trajectory | None = None,
    between: tuple[float, float] | None = None,
) -> Cloud:
    """Return the point cloud of a drive.

    Every pulse is cast from the true trajectory and the true mounting; its point is computed from
    what a user knows: the measured trajectory, the assumed mounting, the recorded angle, the noisy
    range. Pulses without an echo leave no point.

    Parameters
    ----------
    scene : Scene
    scanner : Scanner or list of Scanner
        Several heads are told apart by the column ``head``.
    trajectory : Trajectory
        The truth. Pulses are counted from its first row; it is driven to its last.
    seed : int or sequence of int
    measured : Trajectory, optional
        The path from which points are computed; the truth where left out.
    between : (float, float), optional
        Drive only from one time to another, seconds after the start. Pulses are counted from the
        start all the same.

    Returns
    -------
    Cloud
        Head after head, in the order of time. Columns: ``gps_time`` (s), ``scan_angle`` (deg),
        ``scan_line``, ``pulse`` (both counted from the start), ``surface`` (id in the scene),
        ``range_m`` (before noise), ``incidence_deg``, ``range_noise_m`` (added to the range),
        ``intensity`` (reflectance x cos(incidence) x 65535), ``ring`` of a scanner with several
        beams, ``head`` where there are several, ``mixed`` (1 where the echo comes from two
        surfaces) where the beam has a width.

    Raises
    ------
    ValueError
        If the measured path does not cover the drive.

    Notes
    -----
    The time of flight is neglected: at 100 m and 20 m/s it moves a point by 0.007 mm.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene, ground, straight
    >>> scanner = Scanner(pulse_rate_hz=36_000, mirror_frequency_hz=100)
    >>> cloud = scan(Scene([ground()]), scanner, straight(1, 10, start=(0, 0, 2)), seed=1)
    >>> len(cloud), int(cloud["scan_line"].max())  # of 3 600 pulses, the upper half into the sky
    (1790, 9)
    """
    heads = [scanner] if isinstance(scanner, Scanner) else list(scanner)
    known = trajectory if measured is None else measured
    if known.time[0] > trajectory.time[0] or known.time[-1] < trajectory.time[-1]:
        raise ValueError(
            f"Invalid measured path from {known.time[0]} to {known.time[-1]} s. "
            f"Must cover {trajectory.time[0]} to {trajectory.time[-1]} s."
        )
    start, stop = (0.0, trajectory.duration_s) if between is None else between
    check_number(stop, "between", low=0, high=trajectory.duration_s, unit="s")
    check_number(start, "between", low=0, high=stop, unit="s")
    pulses = []
    for number, head in enumerate(heads):
        first, last = (int(np.ceil(t * head.pulse_rate_hz)) for t in (start, stop))
        cuts = np.append(np.arange(first, max(last, first + 1), 100_000), last)
        pulses += [(number, _in_view(head, *ends)) for ends in pairwise(cuts)]
    streams = [stream(seed, f"scan by head {n}") for n in range(len(heads))]
    clouds = []
    for number, pulse in pulses:
        cloud = _shoot(scene, heads[number], trajectory, known, pulse, streams[number])
        if len(heads) > 1:
            cloud.columns["head"] = np.full(len(cloud), number, np.uint8)
        clouds.append(cloud)
    return Cloud.concatenate(clouds)


def _in_view(scanner, first, last):
    """The pulses of one block, in order, but for most of those outside the field of view."""
    turn = scanner.pulse_rate_hz / scanner.mirror_frequency_hz
    low, high = (np.array(scanner.field_of_view_deg) + 180) / 360
    lines = np.arange(np.floor(first / turn), last / turn + 1)
    starts = np.clip(np.floor((lines + low) * turn) - 1, first, last).astype(np.int64)
    ends = np.clip(np.ceil((lines + high) * turn) + 2, first, last).astype(np.int64)
    counts = np.maximum(np.minimum(ends, np.append(starts[1:], last)) - starts, 0)
    return np.repeat(starts - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())


def _shoot(scene, scanner, trajectory, known, pulse, rng):
    """The cloud of some pulses of one head."""
    fired = scanner.fire(pulse)
    n = len(fired["pulse"])
    jitter, noise, fading = rng.standard_normal((3, n))
    turn, lost = rng.random((2, n))
    since = fired["pulse"] / scanner.pulse_rate_hz
    angle = np.radians(fired["scan_angle"])
    elevation = np.radians(np.sort(scanner.elevations_deg))[fired["ring"]]
    beams = scanner.beams(angle + np.radians(scanner.angle_noise_deg) * jitter, elevation)
    near = _may_meet(scene, scanner, trajectory, since, beams)
    fired = {name: values[near] for name, values in fired.items()}
    beams, noise, fading, turn, lost, since, angle, elevation = (
        values[near] for values in (beams, noise, fading, turn, lost, since, angle, elevation)
    )
    origin, direction = _rays(trajectory, since, scanner, scanner.true_mounting, beams)
    start = origin + (trajectory.origin - scene.origin)
    echo = _strongest(scene.cast_beams(*_footprint(scanner, start, direction, turn)))
    weakest = scanner.max_range_reflectance / scanner.max_range_m**2
    # fading: the natural logarithm of the signal has a standard deviation of 0.2
    kept = (echo["signal"] * np.exp(0.2 * fading) > weakest) & (lost >= scanner.dropout_share)
    kept &= echo["range_m"] >= scanner.min_range_m
    columns = {name: values[kept] for name, values in (fired | echo).items()}
    columns["gps_time"] = trajectory.time[0] + since[kept]
    columns["range_noise_m"] = scanner.range_noise_m * noise[kept]
    signal, ring, mixed = (columns.pop(name) for name in ("signal", "ring", "mixed"))
    strength = 65_535 * signal * columns["range_m"] ** 2
    columns["intensity"] = np.round(strength).astype(np.uint16)
    if len(scanner.elevations_deg) > 1:
        columns["ring"] = ring.astype(np.uint8)
    if scanner.exit_diameter_m or scanner.divergence_mrad:
        columns["mixed"] = mixed.astype(np.uint8)
    since = since[kept] + (trajectory.time[0] - known.time[0])
    beams = scanner.beams(angle[kept], elevation[kept])
    origin, direction = _rays(known, since, scanner, scanner.mounting, beams)
    ranges = columns["range_m"] + columns["range_noise_m"]
    return Cloud(known.origin + (origin + ranges[:, None] * direction), columns, scanner.name)


def _may_meet(scene, scanner, trajectory, since, beams):
    """Which beams may meet a scene of few surfaces: those that pass near the boxes around them.

    The boxes are seen from the scanner every ``NODE_S`` seconds, and in between on straight lines.
    """
    if len(scene.balls) > FEW_SURFACES or not len(since):
        return np.ones(len(since), dtype=bool)
    nodes = np.linspace(since[0], since[-1], int(np.ptp(since) / NODE_S) + 2)
    states, (axes, half) = trajectory.states(nodes), scene.boxes
    turn = rotations(*states[:, 3:].T)
    centre = scene.balls[:, :3] - (trajectory.origin - scene.origin) - states[:, None, :3]
    frames = np.empty((len(nodes), *axes.shape[:1], 4, 3))
    frames[:, :, 0] = (centre @ turn - scanner.lever_arm_m) @ scanner.true_mounting
    frames[:, :, 1:] = axes @ (turn @ scanner.true_mounting)[:, None]
    place = (since - since[0]) / max(nodes[1] - nodes[0], 1e-9)
    sizes = np.column_stack([scene.balls[:, 3], half])
    slack = SLACK_M + scanner.exit_diameter_m
    return _pass_near(place, beams, frames, sizes, slack, scanner.divergence_mrad / 1000)


@njit(cache=True, nogil=True)
def _pass_near(place, beams, frames, sizes, slack, growth):
    """Whether each beam passes within ``slack`` of a box; it widens by ``growth``.

    ``frames`` are centres and axes of boxes, (nodes, n, 4, 3), ``sizes`` the radius of the ball
    around each and its half sizes, (n, 4).
    """
    near, offset = np.zeros(len(beams), np.bool_), np.empty(3)
    for n in range(len(beams)):
        node = min(int(place[n]), len(frames) - 2)
        part = place[n] - node
        for k in range(len(sizes)):
            along, square = 0.0, 0.0
            for j in range(3):
                start, end = frames[node, k, 0, j], frames[node + 1, k, 0, j]
                offset[j] = start + part * (end - start)
                along += offset[j] * beams[n, j]
                square += offset[j] * offset[j]
            wide = slack + growth * (np.sqrt(square) + sizes[k, 0])
            limit = sizes[k, 0] + wide
            if along <= -limit or square - along * along > limit * limit:
                continue
            enter, leave = -np.inf, np.inf
            for i in range(1, 4):
                aside, ahead = 0.0, 1e-300
                for j in range(3):
                    start, end = frames[node, k, i, j], frames[node + 1, k, i, j]
                    axis = start + part * (end - start)
                    aside += axis * offset[j]
                    ahead += axis * beams[n, j]
                reach = (sizes[k, i] + wide) / abs(ahead)
                enter = max(enter, aside / ahead - reach)
                leave = min(leave, aside / ahead + reach)
            if enter <= leave:
                near[n] = True
                break
    return near


def _rays(path, since, scanner, mounting, beams):
    """Starts of beams from the path's origin, and their directions, (n, 3)."""
    states = path.states(since)
    rotation = rotations(*states[:, 3:].T)
    origin = states[:, :3] + rotation @ np.asarray(scanner.lever_arm_m, np.float64)
    return origin, np.einsum("nij,nj->ni", rotation, beams @ mounting.T)


def _footprint(scanner, origin, direction, turn):
    """Rays of equal shares of a Gaussian beam: its axis and a ring of six, (n, k, 3)."""
    axis = origin[:, None], direction[:, None]
    if not (scanner.exit_diameter_m or scanner.divergence_mrad):
        return axis
    rays = np.empty((2, len(origin), 7, 3))
    growth = RING * np.tan(scanner.divergence_mrad / 2000)
    sides, radius = across(direction), RING * scanner.exit_diameter_m / 2
    _spread(origin, direction, sides, 2 * np.pi * turn, radius, growth, *rays)
    return tuple(rays)


@njit(cache=True, nogil=True)
def _spread(origin, direction, sides, turn, radius, growth, starts, aims):
    """Fill in starts and aims (n, 7, 3) of the axis and a ring of rays, from its two ``sides``."""
    for n in range(len(origin)):
        for j in range(3):  # arrays that are assigned take 8 s to compile
            starts[n, 0, j], aims[n, 0, j] = origin[n, j], direction[n, j]
        for ray in range(6):
            angle = turn[n] + np.pi / 3 * ray
            c, s = np.cos(angle), np.sin(angle)
            for j in range(3):
                ring = c * sides[n, 0, j] + s * sides[n, 1, j]
                starts[n, ray + 1, j] = origin[n, j] + radius * ring
                aims[n, ray + 1, j] = (direction[n, j] + growth * ring) / np.hypot(1.0, growth)


def _strongest(hits):
    """Columns of the strongest echo of each pulse; no signal where there is none.

    Hits closer than 0.6 m in range fall into one echo: its range is their mean weighted by the
    signal (reflectance x cosine / range2), its signal their sum over the rays, its surface and
    cosine those of its strongest part; it is mixed where they belong to several surfaces.
    """
    ranges = np.nan_to_num(hits.range_m, nan=np.inf)
    signal = np.nan_to_num(hits.reflectance * hits.cosine / hits.range_m**2)
    (range_m, sums), rows = np.zeros((2, len(ranges))), np.arange(len(ranges))
    top, mixed = np.zeros(len(ranges), np.int64), np.zeros(len(ranges), np.bool_)
    _merge(ranges, signal, hits.surface, range_m, sums, top, mixed)
    cosine = np.minimum(hits.cosine[rows, top], 1)
    return {
        "range_m": range_m,
        "surface": hits.surface[rows, top],
        "incidence_deg": np.degrees(np.arccos(cosine)),
        "signal": sums / ranges.shape[1],
        "mixed": mixed,
    }


@njit(cache=True, nogil=True)
def _merge(ranges, signal, surface, range_m, sums, top, mixed):
    """Fill in range, signal, strongest ray of each pulse's strongest echo, and if it is mixed."""
    order, end = np.zeros(ranges.shape[1], np.int64), ranges.shape[1]
    for n in range(len(ranges)):
        for k in range(end):  # by insertion
            place = k
            while place > 0 and ranges[n, order[place - 1]] > ranges[n, k]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = k
        best, first, last, start, total = -1.0, 0, 0, 0, 0.0
        for k in range(end):
            total += signal[n, order[k]]
            if k + 1 == end or ranges[n, order[k + 1]] - ranges[n, order[k]] > 0.6:
                if total > best:
                    best, first, last = total, start, k
                start, total = k + 1, 0.0
        nearest, beyond, most, top[n] = ranges[n, order[first]], 0.0, 0.0, order[0]
        for ray in order[first : last + 1]:
            if surface[n, ray] >= 0:
                sums[n] += signal[n, ray]
                beyond += signal[n, ray] * (ranges[n, ray] - nearest)
                if signal[n, ray] > most:
                    most, top[n] = signal[n, ray], ray
        for ray in order[first : last + 1]:
            mixed[n] |= surface[n, ray] >= 0 and surface[n, ray] != surface[n, top[n]]
        range_m[n] = nearest + (beyond / sums[n] if sums[n] > 0 else 0.0)
