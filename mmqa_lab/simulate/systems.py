"""The three systems of Pfeifer et al. 2021 and their drive past a chart.

Remote Sensing 13(2), 237, doi:10.3390/rs13020237: charts of 1 m x 1 m, parallel to the path, 5 m
and 10 m from it, passed at 40 km/h by A (Z+F Profiler 9012), B (Velodyne HDL-32E) and C (dense
matching).
"""

from dataclasses import replace

import numpy as np

from mmqa_lab._checks import check_number, check_positive
from mmqa_lab.simulate import presets
from mmqa_lab.simulate.matching import MatchingCamera, match
from mmqa_lab.simulate.objects import chart, chart_corners
from mmqa_lab.simulate.scan import scan_all
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.trajectories import straight

SPEED = 40 / 3.6
"""Metres per second."""

DISTANCES = (5.0, 10.0)
"""Metres from the path to the two charts."""

FACING_THE_ROAD = 270.0
"""Heading of charts that stand to the right of a drive to the north."""

REACH = 5
"""Chart distances to either side from which points are looked for; 2 % come from beyond."""

SYSTEM_A = replace(presets.ZF_9012, tilt_deg=45)
"""1 MHz and 200 Hz are stated, an inclined plane too, its angle is not: 45 degrees, as is usual."""

SYSTEM_B = presets.HDL_32E
"""0.7 MHz are stated, the mounting is not: upright, as most are."""

SYSTEM_C = MatchingCamera(focal_px=4000, width_px=850, height_px=850, base_m=1.0)
"""Nothing is stated of the images; only the pattern, not its density, can be predicted."""


def pass_chart(sensor, distance, *, seed, height=0.0, speed=SPEED, rounding_m=0.0):
    """Return the points of a chart that a sensor drives past, moved along by chance.

    Parameters
    ----------
    sensor : Scanner or MatchingCamera
    distance : float
        From the path to the chart, metres.
    seed : int
        Of the errors and of the place of the chart within the scan pattern.
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
        ``match``; of a camera, the one stereo pair taken opposite the chart.

    Examples
    --------
    >>> cloud = pass_chart(SYSTEM_A, 5.0, seed=1)
    >>> 7000 < len(cloud) < 9000
    True
    """
    distance = check_positive(distance, "distance", unit="m")
    height = check_number(height, "height", unit="m")
    scene = Scene([chart((distance, 0, 0), heading=FACING_THE_ROAD)])
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5)
    if isinstance(sensor, MatchingCamera):
        path = straight(2.0, speed, start=(0, shift - 1, height))
        return next(match(scene, sensor, path, times=[path.duration_s / 2], seed=seed))
    first, last, angles = _stretch(sensor, distance, height)
    path = straight(last - first + 1, speed, start=(0, first + shift - 0.5, height))
    sensor = replace(sensor, field_of_view_deg=angles)
    return scan_all(scene, sensor, path, seed=seed, rounding_m=rounding_m)


def _stretch(scanner, distance, height):
    """Stretch of the path from which beams reach the chart, and the scan angles it takes."""
    along = np.linspace(-REACH * distance, REACH * distance, 100 * REACH + 1)
    origin = np.stack([0 * along, along, 0 * along + height], axis=1)
    corners = chart_corners((distance, 0, 0), heading=FACING_THE_ROAD)
    angle, elevation = scanner.angles((corners - origin[:, None]) @ scanner.mounting)
    low, high = min(scanner.elevations_deg), max(scanner.elevations_deg)
    seen = (elevation.min(axis=1) <= high) & (elevation.max(axis=1) >= low)
    if not seen.any():
        raise ValueError(f"Invalid scanner {scanner.name!r}. Must see the chart from the path.")
    view = np.clip([angle[seen].min() - 5, angle[seen].max() + 5], -180, 180)
    step = along[1] - along[0]
    return along[seen].min() - step, along[seen].max() + step, tuple(view)
