"""Scanners by their data-sheet, their drives through a scene, and images that are matched.

Mounting: the scanner's frame lies in the vehicle's (x right, y travel, z up) by Rz(heading)
Rx(tilt), tilt about the lateral axis first, both counter-clockwise positive as in MIMIC (Cahalane
et al. 2014, doi 10.3390/s140609471). A profile scanner spins about its own y, so that heading 0,
tilt 0 is the vertical plane across the track; a multi-beam scanner spins about its own z.

Scanners drive along a trajectory block of time by block of time. Of a pair of images, points are
drawn at random but not closer than a hard core, their rays are cast exactly, and their depths get
the error of stereo matching, which grows with the square of the depth, is shared by neighbours, and
draws ghosts between foreground and background along edges. A matched cloud may be resampled in
object space, so that its density does not depend on the distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates
from tqdm.auto import tqdm

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab._compiled import in_threads
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern.lattice import rotations
from mmqa_lab.simulate.point_patterns import hard_core_points, matern, older_within
from mmqa_lab.simulate.scenes import RAYS_A_THREAD, STACK, Scene, describe, mapped, nearest
from mmqa_lab.simulate.trajectories import Trajectory

FOOTPRINT = 7
"""Rays a beam: its axis and a ring."""

RING = 0.651
"""Radius of the ring over the 1/e2 radius: median of the outer 6/7 of a Gaussian beam."""

SIGNED = ("heading_deg", "tilt_deg", "max_range_m")
"""Numbers of a scanner that are not checked: angles may have any sign, a range may be endless."""

LIMITS = {"dropout_share": (0, 1), "max_range_reflectance": (0.01, 1)}
"""Between which the others lie that have an upper limit."""

FULL_SCALE = 65_535
"""Intensity of a surface of reflectance 1 hit square."""


def scan(
    scene: Scene,
    scanner: Scanner | Sequence[Scanner],
    trajectory: Trajectory,
    *,
    seed: int,
    measured: Trajectory | None = None,
    between: tuple[float, float] | None = None,
    block_s: float = 0.25,
    progress: bool = False,
) -> Iterable[Cloud]:
    """Yield the point cloud of a drive, one ``Cloud`` a block of time.

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
    seed : int
        The same seed gives the same points whatever ``block_s``.
    measured : Trajectory, optional
        The path from which points are computed; the truth where left out.
    between : (float, float), optional
        Drive only from one time to another, seconds after the start. Pulses are counted from the
        start all the same: parts add up to the whole, and an interrupted run can be taken up.
    block_s : float
        Seconds a block; memory grows with it and not with the drive.
    progress : bool
        Show a bar.

    Yields
    ------
    Cloud
        Columns: ``gps_time`` (s), ``scan_angle`` (deg), ``scan_line``, ``pulse`` (both counted
        from the start), ``surface`` (id in the scene), ``range_m`` (before noise),
        ``incidence_deg``, ``range_noise_m`` (added to the range), ``intensity`` (reflectance x
        cos(incidence) x 65535), ``ring`` of a multi-beam scanner, ``head`` where there are several,
        ``mixed`` (1 where the echo comes from two surfaces) where the beam has a width.

    Raises
    ------
    ValueError
        If the measured path does not cover the drive, or ``block_s`` is not above zero.

    Notes
    -----
    The time of flight is neglected: at 100 m and 20 m/s it moves a point by 0.007 mm.

    Examples
    --------
    >>> from mmqa_lab.simulate import ProfileScanner, Scene, ground, straight
    >>> scanner = ProfileScanner(pulse_rate_hz=36_000, mirror_frequency_hz=100)
    >>> drive = straight(5, 10, start=(0, 0, 2))
    >>> blocks = list(scan(Scene([ground()]), scanner, drive, seed=1, block_s=0.25))
    >>> [len(cloud) for cloud in blocks]  # 9 000 pulses each, the upper half into the sky
    [4475, 4475]
    """
    heads = [scanner] if isinstance(scanner, Scanner) else list(scanner)
    if not heads or not all(isinstance(head, Scanner) for head in heads):
        raise TypeError(f"Invalid scanner {scanner!r}. Must be a scanner or a list of them.")
    block = check_positive(block_s, "block_s", unit="s")
    known = trajectory if measured is None else measured
    if known.time[0] > trajectory.time[0] or known.time[-1] < trajectory.time[-1]:
        raise ValueError(
            f"Invalid measured path from {known.time[0]} to {known.time[-1]} s. "
            f"Must cover {trajectory.time[0]} to {trajectory.time[-1]} s."
        )
    start, stop = (0.0, trajectory.duration_s) if between is None else between
    check_number(stop, "between", low=0, high=trajectory.duration_s, unit="s")
    check_number(start, "between", low=0, high=stop, unit="s")
    edges = np.append(np.arange(start, stop, block), stop)
    drive = _blocks(scene, heads, trajectory, known, edges, int(seed))
    bar = {"total": len(edges) - 1, "unit": "block", "desc": "scan"}
    return tqdm(drive, **bar, disable=not progress)


def scan_all(
    scene: Scene,
    scanner: Scanner | Sequence[Scanner],
    trajectory: Trajectory,
    *,
    seed: int,
    **options: Any,
) -> Cloud:
    """Return the whole drive as one ``Cloud``; arguments as for ``scan``.

    Parameters
    ----------
    scene, scanner, trajectory, seed
        See :func:`scan`.
    **options
        See :func:`scan`.

    Returns
    -------
    Cloud

    Examples
    --------
    >>> from mmqa_lab.simulate import ProfileScanner, Scene, ground, straight
    >>> scanner = ProfileScanner(pulse_rate_hz=36_000, mirror_frequency_hz=100)
    >>> cloud = scan_all(Scene([ground()]), scanner, straight(1, 10, start=(0, 0, 2)), seed=1)
    >>> float(abs(cloud.points[:, 2]).max()) < 1e-9, int(cloud["scan_line"].max())
    (True, 9)
    """
    return Cloud.concatenate(scan(scene, scanner, trajectory, seed=seed, **options))


def _blocks(scene, heads, trajectory, known, edges, seed):
    """The clouds of all blocks; heads of a block one after the other."""
    for start, stop in pairwise(edges):
        clouds = []
        for number, head in enumerate(heads):
            first, last = (int(np.ceil(t * head.pulse_rate_hz)) for t in (start, stop))
            pulse = np.arange(first, last)
            cloud = _shoot(scene, head, trajectory, known, pulse, [seed, number])
            if len(heads) > 1:
                cloud.columns["head"] = np.full(len(cloud), number, np.uint8)
            clouds.append(cloud)
        yield Cloud.concatenate(clouds)


def _shoot(scene, scanner, trajectory, known, pulse, seed):
    """The cloud of some pulses of one head."""
    firing, left = scanner.fire(pulse)
    pulse = pulse[left]
    normal, uniform = draws(seed, pulse)
    jitter = scanner.angle_noise_deg * normal[:, 0]
    origin, direction = _rays(trajectory, scanner, firing, scanner.true_mounting, jitter)
    axis = np.zeros((1, 3))
    if scanner.widening:
        along = np.asarray(scanner.AXIS) @ scanner.true_mounting.T
        rotation = rotations(*trajectory.states(firing.since_start)[:, 3:].T)
        axis = scanner.widening * (rotation @ along)
    origin = origin + (trajectory.origin - scene.origin)
    beam = *scanner.beam_radius, uniform[:, 0], scanner.echo_separation_m, axis
    echo = echoes(scene.tree, origin, direction, beam)
    noise, kept = _detected(scanner, echo, normal, uniform)
    firing, echo, noise = chosen(firing, kept), chosen(echo, kept), noise[kept]
    origin, direction = _rays(
        known, scanner, firing, scanner.mounting, 0.0, trajectory.time[0] - known.time[0]
    )
    points = known.origin + (origin + (echo.range_m + noise)[:, None] * direction)
    truth = _columns(scanner, firing, echo)
    times = trajectory.time[0] + firing.since_start
    pulses = {"gps_time": times, "pulse": pulse[kept], "range_noise_m": noise}
    return Cloud(points, pulses | truth, scanner.name)


def _columns(scanner, firing, echo):
    """What is known of each point but for its time and noise."""
    columns = {
        "scan_angle": firing.scan_angle,
        "scan_line": firing.scan_line,
        "surface": echo.surface,
        "range_m": echo.range_m,
        "incidence_deg": np.degrees(np.arccos(np.minimum(echo.cosine, 1))),
        "intensity": np.round(FULL_SCALE * echo.signal * echo.range_m**2).astype(np.uint16),
    }
    if firing.ring is not None:
        columns["ring"] = firing.ring.astype(np.uint8)
    if any(scanner.beam_radius):
        columns["mixed"] = echo.mixed.astype(np.uint8)
    return columns


def _rays(path, scanner, firing, mounting, jitter, shift=0.0):
    """Origins from the path's origin, and directions; ``shift`` seconds to the path's clock."""
    states = path.states(firing.since_start + shift)
    beams = scanner.beams(np.radians(firing.scan_angle + jitter), np.radians(firing.elevation))
    return beam_rays(states, np.asarray(scanner.lever_arm_m, float), mounting, beams)


def _detected(scanner, echo, normal, uniform):
    """Range noise, and which pulses come back."""
    weakest = scanner.max_range_reflectance / scanner.max_range_m**2
    with np.errstate(divide="ignore", invalid="ignore"):
        heard = echo.signal / weakest * np.exp(scanner.fading * normal[:, 2]) > 1
    kept = heard & (echo.range_m >= scanner.min_range_m) & (uniform[:, 1] >= scanner.dropout_share)
    return scanner.range_noise_m * normal[:, 1], kept


def draws(seed, pulse):
    """Standard normal numbers (n, 3) and uniform ones (n, 2) that depend on a pulse's number alone.

    NumPy's generators yield streams: a drive that is cut into blocks and fields of view would have
    to draw for every pulse that it leaves out. SplitMix64 is a counter through a mixing function
    and can be asked for any place of its stream (Steele, Lea & Flood 2014,
    doi:10.1145/2660193.2660195).
    """
    key = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    place = pulse.astype(np.uint64)[:, None] * np.uint64(6) + np.arange(1, 7, dtype=np.uint64)
    z = key + place * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    u = ((z >> np.uint64(11)) + 0.5) * 2.0**-53
    normal = np.empty((len(u), 3))
    in_threads(_normal, len(u), u, normal, least=RAYS_A_THREAD)
    return normal, u[:, 4:]


@njit(cache=True, nogil=True)
def _normal(begin, end, uniform, normal):
    """Three normal numbers by Box and Muller from the first four uniform ones of each row."""
    for k in range(begin, end):
        u = uniform[k]
        radius, turn = np.sqrt(-2 * np.log(u[0])), 2 * np.pi * u[1]
        normal[k, 0], normal[k, 1] = radius * np.cos(turn), radius * np.sin(turn)
        normal[k, 2] = np.sqrt(-2 * np.log(u[2])) * np.cos(2 * np.pi * u[3])


@dataclass(frozen=True, kw_only=True)
class MatchingCamera:
    """A camera on a vehicle whose images are matched along the track.

    Parameters
    ----------
    focal_px : float
        Principal distance in pixels.
    width_px, height_px : int
        Size of the image that is matched.
    base_m : float
        Distance between the two exposures matched, metres.
    points_per_px : float
        Points per pixel that come out of matching and filtering.
    hard_core : float
        Smallest distance of two points, as a share of 1 / sqrt(points_per_px); 0 for a Poisson
        pattern, at most 0.56 (Matern's second process cannot be packed more densely).
    resampled_per_m2 : float
        Points per square metre of surface after resampling in object space, with the hard core as
        a share of their mean distance; 0 for none. Fewer where matching gives fewer.
    noise_px : float
        Standard deviation of the disparity; the depth errs by depth^2 / (base x focal) times it.
    floor_m : float
        Standard deviation of the part of the depth's error that does not grow with the depth.
    correlated_share : float
        Share of that variance which neighbours have in common.
    correlation_px : float
        Distance in the image over which they have it (standard deviation of a Gaussian kernel).
    window_px : float
        Half width of the matching window: where it reaches over an edge, ghosts arise.
    ghost_share : float
        Share of such points that become ghosts, at a depth anywhere between the two surfaces.
    max_incidence_deg : float
        Surfaces seen at a flatter angle do not match.
    heading_deg, tilt_deg : float
        Viewing direction in the vehicle: degrees clockwise from travel, degrees above the horizon.
    lever_arm_m : tuple of 3
        Camera in the vehicle's frame.

    Raises
    ------
    ValueError
        If a field is out of its range.

    Examples
    --------
    >>> camera = MatchingCamera(focal_px=1000, width_px=100, height_px=100, base_m=1.0)
    >>> camera.rays([[0, 0]]).round(9).tolist()  # looks to the right of the vehicle
    [[1.0, 0.0, 0.0]]
    """

    focal_px: float
    width_px: int
    height_px: int
    base_m: float
    points_per_px: float = 0.25
    hard_core: float = 0.4
    resampled_per_m2: float = 0.0
    noise_px: float = 0.3
    floor_m: float = 0.0
    correlated_share: float = 0.7
    correlation_px: float = 8.0
    window_px: float = 3.0
    ghost_share: float = 0.5
    max_incidence_deg: float = 80.0
    heading_deg: float = 90.0
    tilt_deg: float = 0.0
    lever_arm_m: tuple = (0.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("focal_px", "base_m", "points_per_px", "correlation_px"):
            check_positive(getattr(self, name), name)
        for name in ("width_px", "height_px"):
            check_count(getattr(self, name), name)
        for name in ("resampled_per_m2", "noise_px", "floor_m", "window_px"):
            check_number(getattr(self, name), name, low=0)
        for name in ("correlated_share", "ghost_share"):
            check_number(getattr(self, name), name, low=0, high=1)
        check_number(self.hard_core, "hard_core", low=0, high=0.56)
        check_points([self.lever_arm_m], name="lever_arm_m")

    def rays(self, pixels: ArrayLike) -> np.ndarray:
        """Vehicle-frame vectors of depth 1, (n, 3), of pixels (column, row) from the centre."""
        view = rotations(*np.radians([[0.0], [self.tilt_deg], [self.heading_deg]]))[0]
        x, y = (np.asarray(pixels) / self.focal_px).T
        return np.stack([x, np.ones(len(x)), -y], axis=1) @ view.T


def match(
    scene: Scene, camera: MatchingCamera, trajectory: Trajectory, *, times: ArrayLike, seed: int
) -> Iterator[Cloud]:
    """Yield the matched points of one exposure after the other.

    Parameters
    ----------
    scene : Scene
    camera : MatchingCamera
    trajectory : Trajectory
    times : array_like, shape (n,)
        Of the exposures, seconds within the trajectory.
    seed : int

    Yields
    ------
    Cloud
        Columns: ``gps_time`` (s), ``image``, ``surface`` (id in the scene), ``range_m`` (true),
        ``incidence_deg``, ``range_noise_m`` (added along the ray), ``ghost`` (1 where the point
        lies between two surfaces), ``intensity``.

    Examples
    --------
    >>> from mmqa_lab.simulate import Scene, rectangle, straight
    >>> camera = MatchingCamera(focal_px=1000, width_px=100, height_px=100, base_m=1.0)
    >>> wall = Scene([rectangle((5, -9, -9), (0, 20, 0), (0, 0, 20))])
    >>> cloud = next(match(wall, camera, straight(2, 10), times=[0.1], seed=1))
    >>> 2000 < len(cloud) < 3000, float(abs(cloud.points[:, 0] - 5).max()) < 0.05
    (True, True)
    """
    positions, attitudes = trajectory.at(times)
    for image, time in enumerate(np.asarray(times, dtype=np.float64)):
        rng = np.random.default_rng([seed, image])
        origin = positions[image] + attitudes[image] @ np.asarray(camera.lever_arm_m)
        size = np.array([camera.width_px, camera.height_px])
        core = 0.0 if camera.resampled_per_m2 else camera.hard_core
        pixels = hard_core_points(size, camera.points_per_px, core, rng) - size / 2
        rays = camera.rays(pixels) @ attitudes[image].T
        hits = scene.cast(origin, rays)
        scale = np.linalg.norm(rays, axis=1)
        depth, ghost = _ghosts(scene, camera, origin, attitudes[image], pixels, hits, rng)
        depth = depth + _depth_noise(camera, pixels, depth, rng)
        seen = np.isfinite(depth) & (depth > 0) & (hits.incidence_deg <= camera.max_incidence_deg)
        if camera.resampled_per_m2:
            seen[seen] = _resampled(camera, rays[seen], scale[seen], hits, seen, rng)
        bright, cosine = FULL_SCALE * hits.reflectance[seen], np.cos(np.radians(hits.incidence_deg))
        yield Cloud(
            origin + depth[seen, None] * rays[seen],
            {
                "gps_time": np.full(seen.sum(), time),
                "image": np.full(seen.sum(), image, np.int32),
                "surface": hits.surface[seen],
                "range_m": hits.range_m[seen],
                "incidence_deg": hits.incidence_deg[seen],
                "range_noise_m": (depth * scale - hits.range_m)[seen],
                "ghost": ghost[seen].astype(np.uint8),
                "intensity": np.round(bright * cosine[seen]).astype(np.uint16),
            },
        )


def _resampled(camera, rays, scale, hits, seen, rng):
    """Which of the seen points stay so that surfaces have the density asked for, and its core."""
    range_m, incidence = hits.range_m[seen], np.radians(hits.incidence_deg[seen])
    depth = range_m / scale
    matched = camera.points_per_px * (camera.focal_px / depth) ** 2 * np.cos(incidence) * scale
    core, needed = matern(camera.resampled_per_m2, camera.hard_core)
    stays = rng.random(len(rays)) * matched < needed
    stays[stays] = ~older_within((depth[:, None] * rays)[stays], core)
    return stays


def _ghosts(scene, camera, origin, attitude, pixels, hits, rng):
    """Depths with some points along edges drawn to what else their window sees, and which ones."""
    depth = hits.range_m / np.linalg.norm(camera.rays(pixels), axis=1)
    turn, reach = rng.uniform(0, 2 * np.pi, len(pixels)), np.sqrt(rng.random(len(pixels)))
    offset = camera.window_px * reach * np.array([np.cos(turn), np.sin(turn)])
    beside = camera.rays(pixels + offset.T)
    other = scene.cast(origin, beside @ attitude.T)
    other_depth = other.range_m / np.linalg.norm(beside, axis=1)
    edge = (other.surface != hits.surface) & (other.surface >= 0) & (hits.surface >= 0)
    drawn = rng.random((2, len(pixels)))
    ghost = edge & (drawn[0] < camera.ghost_share)
    return np.where(ghost, depth + drawn[1] * (other_depth - depth), depth), ghost


def _depth_noise(camera, pixels, depth, rng):
    """Depth errors, partly shared by neighbours in the image."""
    step = camera.correlation_px / 2
    shape = np.ceil([camera.height_px / step + 1, camera.width_px / step + 1]).astype(int)
    field = gaussian_filter(rng.standard_normal(shape + 16), 2.0)[8:-8, 8:-8] * 4 * np.sqrt(np.pi)
    row = (pixels[:, 1] + camera.height_px / 2) / step
    column = (pixels[:, 0] + camera.width_px / 2) / step
    shared = map_coordinates(field, [row, column], order=3, mode="nearest")
    alone = rng.standard_normal(len(pixels))
    c = camera.correlated_share
    stereo = depth**2 / (camera.base_m * camera.focal_px) * camera.noise_px
    sigma = np.hypot(stereo, camera.floor_m)
    return sigma * (np.sqrt(c) * shared + np.sqrt(1 - c) * alone)


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
        Standard deviation of the range.
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
    def layers(self) -> tuple[ProfileScanner]:
        """The scanner itself: its only beam measures profiles."""
        return (self,)

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

    @property
    def layers(self) -> tuple[ProfileScanner, ...]:
        """Beams from the lowest up, each as the plane that its cone touches level with the scanner.

        For an axis along the track (``tilt_deg`` 90) and elevations of a few degrees.
        """
        mounting = {"lever_arm_m": self.lever_arm_m, "boresight_deg": self.boresight_deg}
        mounting["tilt_deg"] = self.tilt_deg - 90
        pulses = {
            "pulse_rate_hz": self.pulse_rate_hz / len(self.elevations_deg),
            "mirror_frequency_hz": self.spin_hz,
        }
        return tuple(
            ProfileScanner(heading_deg=self.heading_deg - elevation, **mounting, **pulses)
            for elevation in sorted(self.elevations_deg)
        )

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


def beam_rays(states, lever_arm, mounting, beams):
    """Origins and directions of beams in a mounted scanner's frame on a vehicle in given states.

    ``states`` are offsets in metres and roll, pitch, heading in radians, (n, 6).
    """
    origins, directions = np.empty((len(beams), 3)), np.empty((len(beams), 3))
    matrix = np.ascontiguousarray(mounting).ravel()
    rays = origins, directions
    in_threads(_beam_rays, len(beams), states, lever_arm, matrix, beams, *rays, least=RAYS_A_THREAD)
    return rays


@njit(cache=True, nogil=True)
def _beam_rays(begin, end, states, lever_arm, matrix, beams, origins, directions):
    """Write the rays of :func:`beam_rays`."""
    for k in range(begin, end):
        x, y, z = _turned(states[k], lever_arm[0], lever_arm[1], lever_arm[2])
        origins[k, 0], origins[k, 1] = states[k, 0] + x, states[k, 1] + y
        origins[k, 2] = states[k, 2] + z
        x, y, z = mapped(matrix, beams[k, 0], beams[k, 1], beams[k, 2])
        x, y, z = _turned(states[k], x, y, z)
        directions[k, 0], directions[k, 1], directions[k, 2] = x, y, z


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
        across = (ex, ey, ez)
        for j in range(3):
            rays[k + 1, j] = ray[j] + RING * radius * across[j]
            rays[k + 1, j + 3] = (ray[j + 3] + g * across[j]) / length


@njit(cache=True, error_model="numpy")
def _sorted_hits(tree, rays, best, hit, hits):
    """Write range, signal, cosine and surface of the rays that met something, nearest first.

    Returns their number.
    """
    n = 0
    for k in range(len(rays)):
        ray, t, i = rays[k], best[k], hit[k]
        if i < 0:
            continue
        nx, ny, nz, reflectance = describe(tree, ray, t, i)
        cosine = abs(nx * ray[3] + ny * ray[4] + nz * ray[5])
        hits[n, 0], hits[n, 1] = t, reflectance * cosine / (t * t)
        hits[n, 2], hits[n, 3] = cosine, tree.surface[i]
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


def echoes(tree, origins, directions, beam):
    """The ``Echoes`` of pulses along unit directions.

    ``beam`` is (radius, growth, turn, separation, axis). A beam of 1/e2 ``radius`` at the exit that
    grows by ``growth`` a metre is cast as its axis and a ring of six rays, each an equal share of
    its energy, turned by ``turn`` (0 to 1) at random. Hits closer than ``separation`` in range fall
    into one echo: its range is their mean weighted by the signal, its signal their sum, its surface
    and cosine those of its strongest part; it is mixed where they belong to several surfaces. A
    beam that is not round is wider along ``axis`` (n, 3), by the length of that vector as much
    again.
    """
    n = len(origins)
    nothing = np.full((2, n), np.nan)
    surface, mixed = np.full(n, -1, np.int32), np.zeros(n, bool)
    found = Echoes(nothing[0], surface, nothing[1], np.zeros(n), mixed)
    radius, growth, turn, separation, axis = beam
    turn = np.ascontiguousarray(turn)  # compiled for one kind of array
    beam = float(radius), float(growth), turn, float(separation), axis
    in_threads(_echoes, n, tree, origins, directions, *beam, found, least=RAYS_A_THREAD)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _echoes(begin, end, tree, origins, directions, radius, growth, turn, separation, axis, found):
    """Write the echoes of the pulses from ``begin`` to ``end``."""
    wide = radius > 0.0 or growth > 0.0
    parts = FOOTPRINT if wide else 1
    stack, hit = np.empty(STACK, np.int64), np.empty(parts, np.int64)
    rays, best, hits = np.empty((parts, 9)), np.empty(parts), np.empty((parts, 4))
    for k in range(begin, end):
        for j in range(3):
            rays[0, j], rays[0, 3 + j] = origins[k, j], directions[k, j]
        _spread(rays, radius, growth, axis[k % len(axis)], 2 * np.pi * turn[k])
        nearest(tree, stack, rays, best, hit)
        n = _sorted_hits(tree, rays, best, hit, hits)
        if n == 0:
            continue
        first, last = _strongest(hits, n, separation)
        top, signal, weighted = first, 0.0, 0.0
        for j in range(first, last):
            signal += hits[j, 1]
            weighted += hits[j, 1] * (hits[j, 0] - hits[first, 0])
            found.mixed[k] |= hits[j, 3] != hits[first, 3]
            if hits[j, 1] > hits[top, 1]:
                top = j
        found.range_m[k] = hits[first, 0] + (weighted / signal if signal > 0.0 else 0.0)
        found.surface[k], found.cosine[k] = hits[top, 3], hits[top, 2]
        found.signal[k] = signal * (1.0 / parts)
