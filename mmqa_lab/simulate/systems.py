"""Mobile mapping systems by name, and the drive of three of them past a chart.

The five systems of EuroSDR 2013, mobile laser scanning (section 3.1.3, Table 3-2) and two of
Cahalane et al. 2014 (doi:10.3390/s140609471) come from :func:`system`. The three systems of
Pfeifer et al. 2021 (Remote Sensing 13(2), 237, doi:10.3390/rs13020237) pass a chart of 1 m x 1 m,
parallel to the path, at 5 m and at 10 m: A (Z+F Profiler 9012), B (Velodyne HDL-32E) and C (dense
matching).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_choice, check_number, check_positive
from mmqa_lab._data import read_toml
from mmqa_lab._streams import stream
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate.point_patterns import hard_core_points
from mmqa_lab.simulate.scan import Scanner, scan
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.surfaces import board, chart_corners
from mmqa_lab.simulate.trajectories import NavigationErrors, Trajectory, straight

__all__ = [
    "FACING_THE_ROAD", "PRESETS", "REACH", "SPEED", "SYSTEM_A", "SYSTEM_B", "SYSTEM_C",
    "MatchingCamera", "System", "drive_past", "pass_chart", "system",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MatchingCamera:
    """A camera whose images are matched along the track, opposite a chart.

    Points lie at random on the chart but not closer than a hard core; their depths have the error
    of stereo matching, which grows with the square of the distance and is shared by neighbours.

    Parameters
    ----------
    focal_px : float
        Principal distance in pixels.
    base_m : float
        Distance between the two exposures matched, metres.
    points_per_px : float
        Points per pixel that come out of matching and filtering.
    hard_core : float
        Smallest distance of two points, as a share of their mean distance; 0 for a Poisson
        pattern, at most 0.56 (Matern's second process cannot be packed more densely).
    resampled_per_m2 : float
        Points per square metre after resampling in object space; 0 for none. Fewer where matching
        gives fewer.
    noise_px : float
        Standard deviation of the disparity; the depth errs by depth^2 / (base x focal) times it.
    floor_m : float
        Standard deviation of the part of the depth's error that does not grow with the depth.
    correlated_share : float
        Share of that variance which neighbours have in common.
    correlation_px : float
        Distance in the image over which they have it (standard deviation of a Gaussian kernel).
    """

    focal_px: float
    base_m: float
    points_per_px: float
    hard_core: float
    resampled_per_m2: float
    noise_px: float
    floor_m: float
    correlation_px: float
    correlated_share: float = 0.7


@dataclass(frozen=True)
class System:
    """A mobile mapping system: scan heads and navigation.

    Parameters
    ----------
    name : str
    heads : tuple of Scanner
        With the lever arms and boresight errors that they truly have.
    navigation : NavigationErrors
    lever_arm_error_m : tuple of tuple of 3, optional
        Assumed minus true lever arm of each head.
    least_intensity : float
        Darker points are not delivered, on the scale of :func:`mmqa_lab.simulate.scan`.
    fewest_near : float
        Of the others, those with fewer points than this within 2 m are not delivered.
    source : str
        Where the numbers come from, and what is assumed.

    Examples
    --------
    >>> System("one head", (PRESETS["vq-250"],)).assumed_lever_arms.tolist()
    [[0.0, 0.0, 0.0]]
    """

    name: str
    heads: tuple
    navigation: NavigationErrors = field(default_factory=NavigationErrors)
    lever_arm_error_m: tuple = ()
    least_intensity: float = 0.0
    fewest_near: float = 0.0
    source: str = ""

    @property
    def assumed_lever_arms(self) -> np.ndarray:
        """Lever arms that the evaluation uses, (heads, 3)."""
        true = np.array([head.lever_arm_m for head in self.heads], dtype=np.float64)
        return true + (np.array(self.lever_arm_error_m) if self.lever_arm_error_m else 0.0)

    def delivered(self, cloud: Cloud, *, share: float = 1.0) -> Cloud:
        """Return what is left of a cloud when dark points, then isolated ones, are removed.

        Parameters
        ----------
        cloud : Cloud
            With ``intensity``.
        share : float
            Share of the system's pulses that were simulated. The number of neighbours asked for
            shrinks by the same share.

        Returns
        -------
        Cloud
        """
        if self.least_intensity:
            cloud = cloud[cloud["intensity"] >= self.least_intensity]
        fewest = int(np.ceil(share * self.fewest_near))
        return cloud[_crowded(cloud.points, fewest, 2.0)] if fewest else cloud


def _crowded(points, fewest, radius):
    """Which points have at least ``fewest`` other points within the radius."""
    # all points of one cube lie within the radius of each other: only the others are counted
    cube = np.floor((points - points.min(axis=0)) / (radius / np.sqrt(3))).astype(np.int64)
    _, which, counts = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
    crowded = counts[which.ravel()] > fewest
    distance, _ = cKDTree(points).query(points[~crowded], k=[fewest + 1])
    crowded[~crowded] = distance[:, 0] <= radius
    return crowded


def _with_scanners(entries, known=()):
    """Scanners by name, known ones and those of entries, each perhaps ``like`` one before it."""
    found = dict(known)
    for name, entry in entries.items():
        like = entry.pop("like", None)
        found[name] = replace(found[like], **entry) if like else Scanner(**entry)
    return found


def _systems(tables):
    """Systems by name."""
    scanners = _with_scanners(tables["heads"], PRESETS)
    found = {}
    for name, entry in tables["systems"].items():
        heads = tuple(scanners[head] for head in entry.pop("heads"))
        navigation = NavigationErrors(**entry.pop("navigation", {}))
        found[name] = System(heads=heads, navigation=navigation, **entry)
    return found


PRESETS = _with_scanners(read_toml(Path(__file__).with_name("presets.toml")))
"""Scanners as their makers describe them, by the name that the command line knows. Mount and vary
them with ``dataclasses.replace``. Each says where its numbers come from and whether they are
nominal or calibrated."""

_TABLES = read_toml(Path(__file__).with_name("systems.toml"))

SYSTEMS = _systems(_TABLES)
"""Of Cahalane et al. 2014: ``xp1`` and ``lynx-m1``, without navigation errors; of EuroSDR 2013: the
others."""


def system(name: str) -> System:
    """Return a mobile mapping system by its name.

    Parameters
    ----------
    name : {"roamer", "vmx-250", "streetmapper-360", "lynx", "sensei", "xp1", "lynx-m1"}

    Returns
    -------
    System
        Its ``source`` says where each number comes from and what is assumed.

    Raises
    ------
    ValueError
        If there is no such system.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.1.3 and Table 3-2; Cahalane et al. 2014.

    Examples
    --------
    >>> [head.heading_deg for head in system("vmx-250").heads]
    [45, -45]
    """
    return SYSTEMS[check_choice(name, "system", SYSTEMS)]


SPEED = 40 / 3.6
"""Metres per second: the least that section 4.1 asks for; the speed driven is not printed."""

FACING_THE_ROAD = 270.0
"""Heading of charts that stand to the right of a drive to the north."""

REACH = 5
"""Chart distances to either side from which points are looked for; 2 % come from beyond."""

SYSTEM_A = replace(PRESETS["zf-9012"], tilt_deg=45)
"""1 MHz and 200 Hz are stated, an inclined plane too, its angle is not: 45 degrees, as is usual."""

SYSTEM_B = PRESETS["hdl-32e"]
"""0.7 MHz are stated, the mounting is not: upright, as most are."""

SYSTEM_C = MatchingCamera(**_TABLES["cameras"]["C"])
"""A panorama of 30 megapixels is stated, so 1233 pixels per radian; which images were matched, and
how, is not. Density, hard core and noise are fitted to Table 2, whose density does not fall with
the distance: it takes more than two points per pixel at 10 m, so several pairs, and resampling."""


def pass_chart(
    sensor: Scanner | MatchingCamera, distance: float, *, seed: int, height: float = 0.0
) -> Cloud:
    """Return the points of a chart that a sensor drives past.

    Parameters
    ----------
    sensor : Scanner or MatchingCamera
    distance : float
        From the path to the chart, metres.
    seed : int
        Of the errors, and of the place of a scan pattern on the chart.
    height : float
        Of the sensor above the centre of the chart, metres.

    Returns
    -------
    Cloud
        The chart's centre lies at (distance, 0, 0), the path runs along +y. As of ``scan``; of a
        camera ``range_m``, ``incidence_deg`` and ``range_noise_m``.

    Examples
    --------
    >>> cloud = pass_chart(SYSTEM_A, 5.0, seed=1)
    >>> 3800 < len(cloud) < 4200
    True
    """
    distance = check_positive(distance, "distance", unit="m")
    height = check_number(height, "height", unit="m")
    if isinstance(sensor, MatchingCamera):
        return _matched(sensor, distance, height, stream(seed, "matching"))
    chart = board((distance, 0, 0), 1, 1, heading=FACING_THE_ROAD, label="chart")
    corners = chart_corners((distance, 0, 0), heading=FACING_THE_ROAD)
    shift = stream(seed, "pass_chart").uniform(-0.5, 0.5)
    path = straight(2 * REACH * distance, SPEED, start=(0, shift - REACH * distance, height))
    return drive_past(Scene([chart]), sensor, path, corners, seed=[seed])


def drive_past(
    scene: Scene, scanner: Scanner, path: Trajectory, corners: ArrayLike, *, seed: list[int]
) -> Cloud:
    """Return the points of a part of a scene; only beams that may reach it are fired.

    Parameters
    ----------
    scene : Scene
    scanner : Scanner
    path : Trajectory
    corners : array_like, shape (k, 3)
        Corners of the part of the scene, m.
    seed : list of int

    Returns
    -------
    Cloud
        As of :func:`mmqa_lab.simulate.scan`, with some points around the part.

    Examples
    --------
    >>> corners = chart_corners((5, 0, 0), heading=FACING_THE_ROAD)
    >>> wall = Scene([board((5, 0, 0), 4, 4, heading=FACING_THE_ROAD)])
    >>> path = straight(50, 10, start=(0, -25, 0))
    >>> cloud = drive_past(wall, SYSTEM_A, path, corners, seed=[1])
    >>> bool(4400 < (np.abs(cloud.points[:, 1:]) < 0.5).all(axis=1).sum() < 4500)
    True
    """
    parts = []
    for k, (between, angles) in enumerate(_views(scanner, path, np.asarray(corners))):
        looking = replace(scanner, field_of_view_deg=angles)
        parts.append(scan(scene, looking, path, seed=[*seed, k], between=between))
    return Cloud.concatenate(parts)


def _views(scanner, path, corners):
    """Parts of a drive from which beams reach the corners (s), and the scan angles they need."""
    times = np.linspace(0, path.duration_s, 40 * REACH + 1)
    vectors = corners - path.at(times)[0][:, None]
    angle, elevation = scanner.angles(vectors @ scanner.mounting)
    low, high = min(scanner.elevations_deg), max(scanner.elevations_deg)
    seen = (elevation.min(axis=1) <= high + 1) & (elevation.max(axis=1) >= low - 1)
    for first in range(0, len(times) - 1, 4):
        part = slice(first, first + 5)
        if seen[part].any():
            view = np.clip([angle[part].min() - 5, angle[part].max() + 5], -180, 180)
            yield (times[part][0], times[part][-1]), tuple(view)


def _matched(camera, distance, height, rng):
    """Points of the chart from images that are taken opposite it."""
    supply = camera.points_per_px * (camera.focal_px / distance) ** 2
    density = min(camera.resampled_per_m2 or supply, supply)
    places = hard_core_points(np.ones(2), density, camera.hard_core, rng)
    rays = np.column_stack([np.full(len(places), distance), places - [0.5, 0.5 + height]])
    stereo = distance**2 / (camera.base_m * camera.focal_px) * camera.noise_px
    common = np.sqrt(camera.correlated_share) * _shared(camera, distance, places, rng)
    alone = np.sqrt(1 - camera.correlated_share) * rng.standard_normal(len(places))
    depth = distance + np.hypot(stereo, camera.floor_m) * (common + alone)
    scale = np.linalg.norm(rays, axis=1) / distance
    columns = {
        "range_m": distance * scale,
        "incidence_deg": np.degrees(np.arccos(1 / scale)),
        "range_noise_m": (depth - distance) * scale,
    }
    return Cloud(depth[:, None] / distance * rays + [0, 0, height], columns)


def _shared(camera, distance, places, rng):
    """Normal numbers that neighbours on the chart have in common, those of a smoothed field."""
    step = camera.correlation_px / 2 * distance / camera.focal_px
    cells = int(np.ceil(1 / step)) + 1
    white = rng.standard_normal((cells + 16, cells + 16))
    field = gaussian_filter(white, 2.0)[8:-8, 8:-8] * 4 * np.sqrt(np.pi)
    return map_coordinates(field, (places / step).T, order=3, mode="nearest")
