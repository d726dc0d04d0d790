"""Scanning: drive scanners along a trajectory through a scene, block of time by block of time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit, prange

from mmqa_lab._checks import check_number, check_positive
from mmqa_lab._threads import enough_threads
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern.lattice import rotations
from mmqa_lab.simulate.scanners import Scanner, beam_rays, echoes
from mmqa_lab.simulate.scenes import RAYS_A_THREAD, Scene

if TYPE_CHECKING:
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
    radius, growth = scanner.beam_radius
    axis = None
    if scanner.widening:
        along = np.asarray(scanner.AXIS) @ scanner.true_mounting.T
        rotation = rotations(*trajectory.states(firing.since_start)[:, 3:].T)
        axis = scanner.widening * (rotation @ along)
    echo = echoes(
        scene.tree,
        origin + (trajectory.origin - scene.origin),
        direction,
        radius=radius,
        growth=growth,
        turn=uniform[:, 0],
        separation=scanner.echo_separation_m,
        axis=axis,
    )
    noise, kept = _detected(scanner, echo, normal, uniform)
    firing, echo, noise = firing.select(kept), echo.select(kept), noise[kept]
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
    with enough_threads(len(pulse), RAYS_A_THREAD):
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
