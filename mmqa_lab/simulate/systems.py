"""The three systems of Pfeifer et al. 2021 and their drive past a chart.

Remote Sensing 13(2), 237, doi:10.3390/rs13020237: a chart of 1 m x 1 m, parallel to the path, is
passed at 5 m and at 10 m by A (Z+F Profiler 9012), B (Velodyne HDL-32E) and C (dense matching).
"""

from dataclasses import replace

import numpy as np

from mmqa_lab._checks import check_number, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import presets
from mmqa_lab.simulate.matching import MatchingCamera, match
from mmqa_lab.simulate.scan import scan
from mmqa_lab.simulate.scanners import MultiBeamScanner, ProfileScanner
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.surfaces import chart, chart_corners
from mmqa_lab.simulate.trajectories import straight

SPEED = 40 / 3.6
"""Metres per second: the least that section 4.1 asks for; the speed driven is not printed."""

DISTANCES = (5.0, 10.0)
"""Metres from the paths of the two drives to the chart."""

FACING_THE_ROAD = 270.0
"""Heading of charts that stand to the right of a drive to the north."""

REACH = 5
"""Chart distances to either side from which points are looked for; 2 % come from beyond."""

SYSTEM_A = replace(presets.ZF_9012, tilt_deg=45)
"""1 MHz and 200 Hz are stated, an inclined plane too, its angle is not: 45 degrees, as is usual."""

SYSTEM_B = presets.HDL_32E
"""0.7 MHz are stated, the mounting is not: upright, as most are."""

SYSTEM_C = MatchingCamera(
    focal_px=1233,
    width_px=280,
    height_px=280,
    base_m=1.0,
    points_per_px=4.0,
    hard_core=0.34,
    resampled_per_m2=29_900,
    noise_px=0.23,
    floor_m=0.0132,
    correlation_px=3.0,
)
"""A panorama of 30 megapixels is stated, so 1233 pixels per radian; which images were matched, and
how, is not. Density, hard core and noise are fitted to Table 2, whose density does not fall with
the distance: it takes more than two points per pixel at 10 m, so several pairs, and resampling."""


def pass_chart(
    sensor: ProfileScanner | MultiBeamScanner | MatchingCamera,
    distance: float,
    *,
    seed: int,
    height: float = 0.0,
    speed: float = SPEED,
    rounding_m: float = 0.0,
) -> Cloud:
    """Return the points of a chart that a sensor drives past.

    Parameters
    ----------
    sensor : ProfileScanner, MultiBeamScanner or MatchingCamera
    distance : float
        From the path to the chart, metres.
    seed : int
        Of the errors, and of the place of a scan pattern on the chart.
    height : float
        Of the sensor above the centre of the chart, metres.
    speed : float
        Metres per second.
    rounding_m : float
        Grid of the coordinates, metres (scanners only).

    Returns
    -------
    Cloud
        The chart's centre lies at (distance, 0, 0), the path runs along +y. As of ``scan`` or
        ``match``; a camera takes its images opposite the chart.

    Examples
    --------
    >>> cloud = pass_chart(SYSTEM_A, 5.0, seed=1)
    >>> 3800 < len(cloud) < 4200
    True
    """
    distance = check_positive(distance, "distance", unit="m")
    height = check_number(height, "height", unit="m")
    scene = Scene([chart((distance, 0, 0), heading=FACING_THE_ROAD)])
    if isinstance(sensor, MatchingCamera):
        path = straight(2.0, speed, start=(0, -1, height))
        return next(match(scene, sensor, path, times=[path.duration_s / 2], seed=seed))
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5)
    path = straight(2 * REACH * distance, speed, start=(0, shift - REACH * distance, height))
    parts = []
    for between, angles in _views(sensor, path, distance):
        looking = replace(sensor, field_of_view_deg=angles)
        parts += scan(
            scene, looking, path, seed=seed, between=between, block_s=1.0, rounding_m=rounding_m
        )
    return Cloud.concatenate(parts)


def _views(scanner, path, distance):
    """Parts of a drive from which beams reach the chart, in seconds, and the scan angles they need.

    Not needed for the result: pulses that can meet nothing are not cast.
    """
    corners = chart_corners((distance, 0, 0), heading=FACING_THE_ROAD)
    times = np.linspace(0, path.duration_s, 40 * REACH + 1)
    vectors = corners - path.at(times)[0][:, None]
    angle, elevation = scanner.angles(vectors @ scanner.mounting)
    low, high = min(scanner.elevations_deg), max(scanner.elevations_deg)
    seen = (elevation.min(axis=1) <= high + 1) & (elevation.max(axis=1) >= low - 1)
    for k in np.flatnonzero(seen[:-1] | seen[1:]):
        ends = angle[k : k + 2]
        view = np.clip([ends.min() - 5, ends.max() + 5], -180, 180)
        yield (times[k], times[k + 1]), tuple(view)
