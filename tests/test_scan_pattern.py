"""The scan lattice against ray casting written here, against the simulator, against counting."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mmqa_lab import simulate
from mmqa_lab.scan_pattern import (
    Patch,
    ScanSetup,
    Target,
    lattice_distances,
    scan_lattice,
)

HEAD = {"pulse_rate_hz": 300_000, "mirror_frequency_hz": 100, "speed_m_s": 10}
MIMIC = ScanSetup(**HEAD, scanner_heading_deg=45, scanner_tilt_deg=45)


def random_values(rng, n):
    """Set-ups of all kinds, with pulse rates that their mirrors do not divide."""
    ranges = {
        "pulse_rate_hz": (1e5, 1e6),
        "mirror_frequency_hz": (50, 250),
        "speed_m_s": (1, 30),
        "scanner_heading_deg": (-60, 60),
        "scanner_tilt_deg": (-60, 60),
    }
    return {name: rng.uniform(*limits, n) for name, limits in ranges.items()}


def rays(values, mirror, seconds):
    """Origins and directions of pulses, mirror angle from +x towards +z; written from the text."""
    v = values
    angles = np.stack([v["scanner_heading_deg"], v["scanner_tilt_deg"]], axis=1)
    mount = Rotation.from_euler("ZX", angles, degrees=True)
    aim = np.stack([np.cos(mirror), 0 * mirror, np.sin(mirror)], axis=1)
    track = np.stack([0 * mirror, v["speed_m_s"] * seconds, 0 * mirror], axis=1)
    return track, mount.apply(aim)


def hit(origin, direction, point, normal):
    """Where rays meet the planes through points."""
    reach = np.sum((point - origin) * normal, axis=1) / np.sum(direction * normal, axis=1)
    return origin + reach[:, None] * direction


def straddling(values, mirror, pulses, strike):
    """The step between the pulses half of some pulses before and after the spot."""
    seconds = pulses / values["pulse_rate_hz"]
    turns = seconds * values["mirror_frequency_hz"]
    turn = 2 * np.pi * (turns - np.round(turns))  # whole ones change nothing
    ends = [strike(*rays(values, mirror + side * turn, side * seconds)) for side in (-0.5, 0.5)]
    return ends[1] - ends[0]


def random_spots(rng, n):
    """Set-ups, mirror angles and planes that pulses meet at 3 to 40 m, at up to 70 degrees."""
    values = random_values(rng, n)
    mirror = rng.uniform(-np.pi, np.pi, n)
    _, direction = rays(values, mirror, np.zeros(n))
    sideways = np.cross(direction, rng.standard_normal((n, 3)))
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    slant = np.radians(rng.uniform(0, 70, n))[:, None]
    normal = -np.cos(slant) * direction + np.sin(slant) * sideways
    return values, mirror, rng.uniform(3, 40, n)[:, None] * direction, normal


def target_lattice(heading, tilt, range_m=5.0, setup=MIMIC, **options):
    return scan_lattice(
        setup, Target(heading_deg=heading, tilt_deg=tilt, range_m=range_m, **options)
    )


def test_lattice_is_that_of_ray_casting_for_ten_thousand_set_ups(rng):
    n = 10_000
    values, mirror, reach, normal = random_spots(rng, n)
    along = rng.uniform(-20, 20, (n, 1)) * [0, 1, 0]  # spots anywhere along the track
    lattice = scan_lattice(ScanSetup(**values), Patch(reach + along, normal))
    assert np.abs(lattice.beam - reach).max() < 1e-10
    whole = np.round(values["pulse_rate_hz"] / values["mirror_frequency_hz"])
    level = np.cross([0, 0, 1], normal)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    axes = np.stack([level, np.cross(normal, level)], axis=1)
    steps = []
    for pulses in (np.ones(n), whole):
        step = straddling(values, mirror, pulses, lambda o, d: hit(o, d, reach, normal))
        steps.append((axes @ step[:, :, None])[:, :, 0])
    a, b = steps
    assert np.abs(lattice.a - a).max() < 1e-9
    assert np.abs(lattice.b - b).max() < 1e-9
    cell, across, up = np.abs(np.linalg.det(np.stack(steps, axis=1))), *np.abs(a.T)
    assert np.abs(lattice.point_spacing_m - np.hypot(across, up)).max() < 1e-9
    gap = lattice.profile_spacing_perpendicular_m
    assert np.abs(gap * np.hypot(across, up) - cell).max() < 1e-9
    assert np.abs(lattice.profile_angle_deg - np.degrees(np.arctan2(up, across))).max() < 1e-6
    # along a line that profiles nearly follow the gap grows without end: times the step, the cell
    assert np.abs(lattice.profile_spacing_horizontal_m * up - cell).max() < 1e-10
    assert np.abs(lattice.profile_spacing_vertical_m * across - cell).max() < 1e-10
    # the cell is laid about the spot: equal up to the square of the mirror's step over cos(i)
    step = 2 * np.pi / whole / np.cos(np.radians(lattice.incidence_deg))
    assert (np.abs(lattice.density_per_m2 * cell - 1) < 2 * step**2 + 1e-4).all()


@pytest.mark.parametrize(
    ("heading", "tilt", "horizontal", "angle"),
    [(15, 0, 0.081677, 40.9335), (0, 15, 0.100033, 42.1373), (15, 15, 0.081677, 46.0395),
     (-15, 0, 0.141468, 26.5978), (0, -15, 0.100033, 31.6408)],
)  # fmt: skip
def test_helios_finds_the_same_profiles(heading, tilt, horizontal, angle):
    # scanned with HELIOS++ at 8 m; its deflector takes 3001 pulses for a revolution of 3000
    lattice = target_lattice(heading, tilt, range_m=8.0)
    corrected = horizontal * 3000 / 3001
    assert lattice.profile_spacing_horizontal_m == pytest.approx(corrected, abs=1e-6)
    assert lattice.profile_angle_deg == pytest.approx(angle, abs=1e-3)


def test_counted_density_on_a_plane_within_one_per_cent():
    rates, head = (
        {"pulse_rate_hz": 6e5, "mirror_frequency_hz": 200},
        {"heading_deg": 20, "tilt_deg": 30},
    )
    scanner = simulate.Scanner(**rates, **head)
    mounting = {f"scanner_{name}": angle for name, angle in head.items()}
    setup = ScanSetup(**rates, **mounting, speed_m_s=10.0)
    patch = Target(heading_deg=20, tilt_deg=15, range_m=6).patch(setup)
    level, slope = scan_lattice(setup, patch).axes
    corner = patch.points * [1, 0, 1] - 10 * level - 10 * slope
    wall = simulate.Scene([simulate.rectangle(corner, 20 * level, 20 * slope)])
    cloud = simulate.scan(wall, scanner, simulate.straight(12, 10, start=(0, -6, 0)), seed=1)
    u = (cloud.points - patch.points * [1, 0, 1]) @ np.array([level, slope]).T
    counted = (np.abs(u) < [1.0, 0.75]).all(axis=1).sum()
    grid = np.stack(np.meshgrid(np.linspace(-0.95, 0.95, 20), np.linspace(-0.7, 0.7, 15)), -1)
    places = patch.points + grid @ np.array([level, slope])
    lattice = scan_lattice(setup, Patch(places, patch.normals))
    assert counted == pytest.approx(3 * lattice.density_per_m2.mean(), rel=0.01)


def brute_distances(a, b):
    """Nearest of many lattice points in each half-open quadrant."""
    i, j = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61))
    x, y = np.multiply.outer([1.0, 0.0], 0 * i) + a[:, None, None] * i + b[:, None, None] * j
    quadrants = [(x > 0) & (y >= 0), (x <= 0) & (y > 0), (x < 0) & (y <= 0), (x >= 0) & (y < 0)]
    return np.sort([np.hypot(x, y)[q].min() for q in quadrants])[[0, 3]]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.3, 1.0]))
@settings(max_examples=60, deadline=None)
def test_quadrant_distances_of_lattices_are_those_of_brute_force(seed, thin):
    rng = np.random.default_rng(seed)
    a, b = thin * rng.standard_normal(2), rng.standard_normal(2)
    b -= a * np.round(a @ b / (a @ a))  # so that 60 multiples reach round the origin
    if abs(a[0] * b[1] - a[1] * b[0]) < 0.02 * np.linalg.norm(a) * np.linalg.norm(b):
        return
    skewed = b + rng.integers(-500, 500) * a  # another basis of the same lattice
    expected = brute_distances(a, b)
    assert lattice_distances(a, b) == pytest.approx(expected, rel=1e-9)
    assert lattice_distances(a, skewed) == pytest.approx(expected, rel=1e-9)


def test_quadrant_distances_known():
    assert lattice_distances([1, 0], [0, 1]) == (1, 1)  # axes belong to one quadrant
    assert np.isnan(lattice_distances([1, 0], [2, 0])).all()
    assert np.isnan(lattice_distances([np.nan, 0], [0, 1])).all()


def test_a_lattice_draws_as_many_points_as_it_predicts():
    lattice = target_lattice(15, 10)
    assert len(lattice.points(0.5)) == pytest.approx(lattice.density_per_m2, rel=0.03)


def test_crossing_profiles_of_two_heads_on_a_level_road():
    road = Patch([0.0, 0.0, -2.0], [0, 0, 1])
    left, right = (
        scan_lattice(replace(MIMIC, scanner_heading_deg=heading, scanner_tilt_deg=0), road)
        for heading in (45, -45)
    )
    # profiles lie along the headings, 90 degrees apart, turned by d / (2 pi R) with the motion
    crossing = np.degrees(
        np.arccos(left.a @ right.a / left.point_spacing_m / right.point_spacing_m)
    )
    assert crossing == pytest.approx(90, abs=0.7)
    assert np.isnan(left.profile_spacing_horizontal_m)  # a level road has no slope
    assert np.isnan(left.profile_angle_deg)
    assert left.profile_spacing_perpendicular_m == pytest.approx(0.1 / np.sqrt(2), rel=0.01)
