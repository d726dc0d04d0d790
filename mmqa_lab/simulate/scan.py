"""Drives through a scene: the points of scanners, and those of images that are matched.

Scanners drive along a trajectory block of time by block of time. Of a pair of images, points are
drawn at random but not closer than a hard core, their rays are cast exactly, and their depths get
the error of stereo matching, which grows with the square of the depth, is shared by neighbours, and
draws ghosts between foreground and background along edges. A matched cloud may be resampled in
object space, so that its density does not depend on the distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab._threads import enough_threads
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern.lattice import rotations
from mmqa_lab.simulate.point_patterns import hard_core_points, matern, older_within
from mmqa_lab.simulate.scanners import Echoes, Scanner, beam_rays, chosen, echoes
from mmqa_lab.simulate.scenes import RAYS_A_THREAD, Scene
from mmqa_lab.simulate.trajectories import Trajectory

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
    rounding_m: float = 0.0,
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
    rounding_m : float
        Grid to which coordinates are rounded, metres; 0 for none.
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
    check_number(rounding_m, "rounding_m", low=0, unit="m")
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
    drive = _blocks(scene, heads, trajectory, known, edges, int(seed), rounding_m)
    if not progress:
        return drive
    from tqdm.auto import tqdm

    return tqdm(drive, total=len(edges) - 1, unit="block", desc="scan")


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


def _blocks(scene, heads, trajectory, known, edges, seed, rounding):
    """The clouds of all blocks; heads of a block one after the other."""
    for start, stop in pairwise(edges):
        clouds = []
        for number, head in enumerate(heads):
            first, last = (int(np.ceil(t * head.pulse_rate_hz)) for t in (start, stop))
            pulse = np.arange(first, last)
            with enough_threads(len(pulse), RAYS_A_THREAD):
                cloud = _shoot(scene, head, trajectory, known, pulse, [seed, number], rounding)
            if len(heads) > 1:
                cloud.columns["head"] = np.full(len(cloud), number, np.uint8)
            clouds.append(cloud)
        yield Cloud.concatenate(clouds)


def _shoot(scene, scanner, trajectory, known, pulse, seed, rounding):
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
    echo = Echoes(*echoes(scene.tree, origin, direction, *beam))
    noise, kept = _detected(scanner, echo, normal, uniform)
    firing, echo, noise = chosen(firing, kept), chosen(echo, kept), noise[kept]
    origin, direction = _rays(
        known, scanner, firing, scanner.mounting, 0.0, trajectory.time[0] - known.time[0]
    )
    points = known.origin + (origin + (echo.range_m + noise)[:, None] * direction)
    if rounding:
        points = np.round(points / rounding) * rounding
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
        strength = echo.signal / weakest
        weak = scanner.range_noise_weak_m / np.sqrt(strength)
        heard = strength * np.exp(scanner.fading * normal[:, 2]) > 1
    spread = np.hypot(scanner.range_noise_m, np.where(np.isfinite(weak), weak, 0.0))
    kept = heard & (echo.range_m >= scanner.min_range_m)
    return spread * normal[:, 1], kept & (uniform[:, 1] >= scanner.dropout_share)


def draws(seed, pulse):
    """Standard normal numbers (n, 3) and uniform ones (n, 2) that depend on a pulse's number alone.

    NumPy's generators yield streams: a drive that is cut into blocks and fields of view would have
    to draw for every pulse that it leaves out. SplitMix64 is a counter through a mixing function
    and can be asked for any place of its stream (Steele, Lea & Flood 2014,
    doi:10.1145/2660193.2660195).
    """
    key = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]
    u = _uniform(key, pulse.astype(np.uint64))
    return _normal(u), u[:, 4:]


@njit(cache=True, parallel=True)
def _uniform(key, pulse):
    """Six numbers between 0 (exclusive) and 1 for each pulse."""
    made = np.empty((len(pulse), 6))
    for k in prange(len(pulse)):
        for j in range(6):
            z = key + (pulse[k] * np.uint64(6) + np.uint64(j + 1)) * np.uint64(0x9E3779B97F4A7C15)
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z = z ^ (z >> np.uint64(31))
            made[k, j] = (np.float64(z >> np.uint64(11)) + 0.5) * 2.0**-53
    return made


@njit(cache=True, parallel=True)
def _normal(uniform):
    """Three normal numbers by Box and Muller from the first four uniform ones of each row."""
    normal = np.empty((len(uniform), 3))
    for k in prange(len(uniform)):
        u = uniform[k]
        radius, turn = np.sqrt(-2 * np.log(u[0])), 2 * np.pi * u[1]
        normal[k, 0], normal[k, 1] = radius * np.cos(turn), radius * np.sin(turn)
        normal[k, 2] = np.sqrt(-2 * np.log(u[2])) * np.cos(2 * np.pi * u[3])
    return normal


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
