"""Point clouds of dense image matching: random points whose depths err together.

Points are drawn in the image at random but not closer than a hard core, their rays are cast
exactly, and their depths get the error of stereo matching, which grows with the square of the
depth, is shared by neighbours, and draws ghosts between foreground and background along edges.
A cloud may be resampled in object space, so that its density does not depend on the distance.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates

from mmqa_lab._checks import check_count, check_number, check_points, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern.lattice import rotations
from mmqa_lab.simulate.point_patterns import hard_core_points, matern, older_within
from mmqa_lab.simulate.scan import FULL_SCALE
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.trajectories import Trajectory


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

    def rays(self, pixels):
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
