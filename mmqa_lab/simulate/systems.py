"""Mobile mapping systems by name, and the drive of three of them past a chart.

The five systems of EuroSDR 2013, mobile laser scanning (section 3.1.3, Table 3-2) and two of
Cahalane et al. 2014 (doi:10.3390/s140609471) are had with :func:`system`. The three systems of
Pfeifer et al. 2021 (Remote Sensing 13(2), 237, doi:10.3390/rs13020237) pass a chart of 1 m x 1 m,
parallel to the path, at 5 m and at 10 m: A (Z+F Profiler 9012), B (Velodyne HDL-32E) and C (dense
matching).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from mmqa_lab._checks import check_choice, check_number, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import presets
from mmqa_lab.simulate.matching import MatchingCamera, match
from mmqa_lab.simulate.scan import scan
from mmqa_lab.simulate.scanners import MultiBeamScanner, ProfileScanner
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.surfaces import chart, chart_corners
from mmqa_lab.simulate.trajectories import NavigationErrors, straight


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
    source : str
        Where the numbers come from, and what is assumed.

    Examples
    --------
    >>> System("one head", (presets.VQ_250,)).assumed_lever_arms.tolist()
    [[0.0, 0.0, 0.0]]
    """

    name: str
    heads: tuple
    navigation: NavigationErrors = field(default_factory=NavigationErrors)
    lever_arm_error_m: tuple = ()
    source: str = ""

    @property
    def assumed_lever_arms(self):
        """Lever arms that the evaluation uses, (heads, 3)."""
        true = np.array([head.lever_arm_m for head in self.heads], dtype=np.float64)
        return true + (np.array(self.lever_arm_error_m) if self.lever_arm_error_m else 0.0)


def _two_heads(base, height, **numbers):
    """Two heads of one kind, turned by 45 degrees to either side, 0.8 m apart."""
    return tuple(
        replace(
            base,
            heading_deg=-45 * side,
            tilt_deg=45,
            lever_arm_m=(0.4 * side, -0.6, height),
            **numbers,
        )
        for side in (-1, 1)
    )


def _drift(plan_m, height_m, level_deg, heading_deg):
    """Navigation whose errors change over a minute."""
    errors = {"drift_m": (plan_m, plan_m, height_m)}
    return NavigationErrors(**errors, drift_deg=(level_deg, level_deg, heading_deg))


RIEGL_HEADS = _two_heads(
    presets.VQ_250,
    0.3,
    name="RIEGL VQ-250",
    range_noise_m=0.010,
    exit_diameter_m=0.007,
    divergence_mrad=0.3,
    max_range_m=500,
    source="Table 3-2: 300 kHz, 100 profiles a second, 500 m, 0.3 mrad, 7 mm, 10 mm at 150 m",
)

LYNX_HEADS = _two_heads(
    presets.LYNX_M1,
    0.5,
    name="Optech Lynx",
    pulse_rate_hz=200_000,
    mirror_frequency_hz=200,
    range_noise_m=0.008,
    max_range_m=200,
    source="Table 3-2: 200 kHz, 200 profiles a second, 200 m, 8 mm; beam N/A, so a line",
)

IBEO_LUX = MultiBeamScanner(
    name="Ibeo Lux",
    pulse_rate_hz=38_000 * 360 / 110,
    spin_hz=50,
    elevations_deg=(-1.2, -0.4, 0.4, 1.2),
    field_of_view_deg=(35.0, 145.0),
    tilt_deg=90.0,
    lever_arm_m=(0.4, -0.5, 0.3),
    range_noise_m=0.1,
    divergence_mrad=1.4,
    divergence_axial_mrad=14.0,
    min_range_m=0.3,
    max_range_m=50.0,
    max_range_reflectance=0.1,
    source="Table 3-2, section 3.1.3.4: 38 kHz, 50 scans a second, four layers, 1.4 x 14 mrad, "
    "100 mm, 0.3 to 200 m, 50 m at 10 %; the body upright on one side, so that the 14 mrad lie "
    "along the track; layers 0.8 degrees apart and 110 degrees of view assumed",
)

MOUNTED = "Mounting of 45/45 degrees, lever arms and correlation of 60 s assumed."
SHEET = "as usually quoted from the maker's sheet, which was not seen"

SYSTEMS = {
    "roamer": System(
        "ROAMER",
        (replace(presets.ROAMER, lever_arm_m=(0.0, -0.5, 0.4)),),
        _drift(0.02, 0.04, 0.013, 0.027),
        source="EuroSDR 2013, section 3.1.3.2, Table 3-2. Navigation SPAN with HG1700: positions "
        "by VRS, 2 cm and 4 cm (section 3.1.2.2); heading 0.027 degrees (3.1.2.1); roll and pitch "
        f"0.013 degrees {SHEET}. Lever arm and correlation of 60 s assumed.",
    ),
    "vmx-250": System(
        "RIEGL VMX-250",
        RIEGL_HEADS,
        _drift(0.02, 0.02, 0.005, 0.015),
        source="EuroSDR 2013, section 3.1.3.3, Table 3-2. Navigation: 20 mm, 0.005 and 0.015 "
        f"degrees {SHEET}. {MOUNTED}",
    ),
    "streetmapper-360": System(
        "Streetmapper 360",
        RIEGL_HEADS,
        _drift(0.017, 0.017, 0.004, 0.010),
        source="EuroSDR 2013, section 3.1.3.5, Table 3-2. Navigation AEROcontrol: 30 mm of points "
        "(3D) with good GNSS (Haala et al. 2008 in section 2.2), 17 mm an axis; 0.004 and 0.010 "
        f"degrees {SHEET}. {MOUNTED}",
    ),
    "lynx": System(
        "Optech Lynx",
        LYNX_HEADS,
        _drift(0.02, 0.05, 0.015, 0.02),
        source="EuroSDR 2013, section 3.1.3.6, Table 3-2, heads 2.7 m up. Navigation POS LV 420: "
        f"20 mm, 50 mm, 0.015 and 0.020 degrees {SHEET}. {MOUNTED}",
    ),
    "sensei": System(
        "Sensei",
        (IBEO_LUX,),
        _drift(0.02, 0.04, 0.015, 0.03),
        source="EuroSDR 2013, section 3.1.3.4, Table 3-2. Navigation SPAN-CPT: positions by VRS, "
        f"2 cm and 4 cm (section 3.1.2.2); 0.015 and 0.030 degrees {SHEET}. Lever arm and "
        "correlation of 60 s assumed.",
    ),
    "xp1": System("XP1", (presets.VQ_250,), source=presets.VQ_250.source),
    "lynx-m1": System(
        "Lynx M1", (presets.LYNX_M1, presets.LYNX_M1_SECOND), source=presets.LYNX_M1.source
    ),
}
"""Of Cahalane et al. 2014: ``xp1`` and ``lynx-m1``, without navigation errors; of EuroSDR 2013: the
others."""

WITHOUT_GNSS = 1.0 / 0.03
"""Position errors with bad GNSS over those with good: up to 1 m beside 30 mm (Haala et al. 2008,
quoted in EuroSDR 2013, section 2.2)."""

SECTIONS = {"A": 1.0, "B": 1.0, "C": WITHOUT_GNSS, "D": 1.0}
"""Of the field of Espoonlahti: in C trees hide the satellites (section 3.1.1)."""


def system(name: str, *, section: str = "A") -> System:
    """Return a mobile mapping system by its name.

    Parameters
    ----------
    name : {"roamer", "vmx-250", "streetmapper-360", "lynx", "sensei", "xp1", "lynx-m1"}
    section : {"A", "B", "C", "D"}
        Of the field of Espoonlahti: with good GNSS but for C, where position errors are 33 times as
        large.

    Returns
    -------
    System
        Its ``source`` says where each number comes from and what is assumed.

    Raises
    ------
    ValueError
        If there is no such system or section.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.1.3 and Table 3-2; Cahalane et al. 2014.

    Examples
    --------
    >>> [head.heading_deg for head in system("vmx-250").heads]
    [45, -45]
    """
    found = SYSTEMS[check_choice(name, "system", SYSTEMS)]
    factor = SECTIONS[check_choice(section, "section", SECTIONS)]
    if factor == 1:
        return found
    drift = tuple(factor * value for value in np.broadcast_to(found.navigation.drift_m, 3).tolist())
    return replace(found, navigation=replace(found.navigation, drift_m=drift))


SPEED = 40 / 3.6
"""Metres per second: the least that section 4.1 asks for; the speed driven is not printed."""

DISTANCES = (5.0, 10.0)
"""Metres from the paths of the two drives to the chart."""

FACING_THE_ROAD = 270.0
"""Heading of charts that stand to the right of a drive to the north."""

REACH = 5
"""Chart distances to either side from which points are looked for; 2 % come from beyond."""

STEPS_A_VIEW = 4
"""Steps of a drive that are scanned at once: more take more pulses beside the chart, fewer more
calls."""

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
    corners = chart_corners((distance, 0, 0), heading=FACING_THE_ROAD)
    return scan_chart(scene, sensor, path, corners, seed=seed, rounding_m=rounding_m)


def scan_chart(scene, scanner, path, corners, **options):
    """Scan from a straight drive what lies about a chart: pulses that cannot meet it are not cast.

    Parameters
    ----------
    scene, scanner, path, **options
        As :func:`mmqa_lab.simulate.scan` takes them.
    corners : array, shape (4, 3)
        Of the chart, metres.
    """
    parts = []
    for between, angles in _views(scanner, path, corners):
        looking = replace(scanner, field_of_view_deg=angles)
        parts += scan(scene, looking, path, between=between, block_s=1.0, **options)
    return Cloud.concatenate(parts)


def _views(scanner, path, corners):
    """Parts of a drive from which beams reach a chart (s), and the scan angles they need."""
    times = np.linspace(0, path.duration_s, 40 * REACH + 1)
    vectors = corners - path.at(times)[0][:, None]
    angle, elevation = scanner.angles(vectors @ scanner.mounting)
    low, high = min(scanner.elevations_deg), max(scanner.elevations_deg)
    seen = (elevation.min(axis=1) <= high + 1) & (elevation.max(axis=1) >= low - 1)
    steps = np.flatnonzero(seen[:-1] | seen[1:])
    for run in np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1):
        for k in range(0, len(run), STEPS_A_VIEW):
            first, last = run[k], run[min(k + STEPS_A_VIEW, len(run)) - 1] + 1
            ends = angle[first : last + 1]
            view = np.clip([ends.min() - 5, ends.max() + 5], -180, 180)
            yield (times[first], times[last]), tuple(view)
