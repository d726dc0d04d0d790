"""The scan lattice against ray casting written here, against the simulator, against counting."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mmqa_lab import plots, simulate
from mmqa_lab.published import table
from mmqa_lab.scan_pattern import (
    Patch,
    ScanSetup,
    Target,
    largest_speed,
    propagate,
    scan_lattice,
)
from mmqa_lab.scan_pattern.lattice import lattice_distances

MIMIC = ScanSetup(
    pulse_rate_hz=300_000,
    mirror_frequency_hz=100,
    speed_m_s=10,
    scanner_heading_deg=45,
    scanner_tilt_deg=45,
)
STEADY = ("roll_rate_deg_s", "pitch_rate_deg_s", "heading_rate_deg_s")


def random_values(rng, n):
    """Set-ups of all kinds, turning vehicles among them."""
    ranges = {
        "pulse_rate_hz": (1e5, 1e6),
        "mirror_frequency_hz": (50, 250),
        "speed_m_s": (1, 30),
        "scanner_heading_deg": (-60, 60),
        "scanner_tilt_deg": (-60, 60),
        "boresight_roll_deg": (-1, 1),
        "boresight_pitch_deg": (-1, 1),
        "boresight_heading_deg": (-1, 1),
        "roll_deg": (-5, 5),
        "pitch_deg": (-5, 5),
        "heading_deg": (-5, 5),
        "roll_rate_deg_s": (-3, 3),
        "pitch_rate_deg_s": (-3, 3),
        "heading_rate_deg_s": (-3, 3),
    }
    return {name: rng.uniform(*limits, n) for name, limits in ranges.items()}


def rays(values, lever_arm, mirror, seconds):
    """Origins and directions of pulses, mirror angle from +x towards +z; written from the text."""

    def turn(axis, degrees):
        return Rotation.from_euler(axis, np.reshape(degrees, (-1, 1)), degrees=True)

    v = values
    vehicle = turn("z", -(v["heading_deg"] + v["heading_rate_deg_s"] * seconds))
    vehicle *= turn("x", v["pitch_deg"] + v["pitch_rate_deg_s"] * seconds)
    vehicle *= turn("y", v["roll_deg"] + v["roll_rate_deg_s"] * seconds)
    mount = turn("z", -v["boresight_heading_deg"]) * turn("x", v["boresight_pitch_deg"])
    mount *= turn("y", v["boresight_roll_deg"])
    mount *= turn("z", v["scanner_heading_deg"]) * turn("x", v["scanner_tilt_deg"])
    aim = np.stack([np.cos(mirror), 0 * mirror, np.sin(mirror)], axis=1)
    track = np.stack([0 * mirror, v["speed_m_s"] * seconds, 0 * mirror], axis=1)
    return track + vehicle.apply(np.tile(lever_arm, (len(mirror), 1))), (vehicle * mount).apply(aim)


def hit(origin, direction, point, normal):
    """Where rays meet the planes through points."""
    reach = np.sum((point - origin) * normal, axis=1) / np.sum(direction * normal, axis=1)
    return origin + reach[:, None] * direction


def straddling(values, lever_arm, mirror, seconds, turns, plane):
    """The step between the pulses half of a time and a turn before and after the spot."""
    ends = []
    for side in (-0.5, 0.5):
        angle = mirror + side * 2 * np.pi * turns
        ends.append(hit(*rays(values, lever_arm, angle, side * seconds), *plane))
    return ends[1] - ends[0]


def random_spots(rng, n):
    """Set-ups, mirror angles and planes that pulses meet at 3 to 40 m, at up to 70 degrees."""
    values, lever_arm = random_values(rng, n), rng.uniform(-1, 1, 3)
    mirror = rng.uniform(-np.pi, np.pi, n)
    origin, direction = rays(values, lever_arm, mirror, np.zeros(n))
    sideways = np.cross(direction, rng.standard_normal((n, 3)))
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    slant = np.radians(rng.uniform(0, 70, n))[:, None]
    normal = -np.cos(slant) * direction + np.sin(slant) * sideways
    reach = rng.uniform(3, 40, n)[:, None] * direction
    return values, lever_arm, mirror, origin, reach, normal


def target_lattice(heading, tilt, range_m=5.0, setup=MIMIC, **options):
    target = Target(heading_deg=heading, tilt_deg=tilt, range_m=range_m, **options)
    return scan_lattice(setup, target.patch(setup))


def test_lattice_is_that_of_ray_casting_for_ten_thousand_set_ups(rng):
    n = 10_000
    values, lever_arm, mirror, origin, reach, normal = random_spots(rng, n)
    setup = ScanSetup(**values, lever_arm_m=tuple(lever_arm))
    along = rng.uniform(-20, 20, (n, 1)) * [0, 1, 0]  # spots anywhere along the track
    lattice = scan_lattice(setup, Patch(reach + along, normal))
    assert np.abs(lattice.beam - reach).max() < 1e-10
    pulse, turn = 1 / values["pulse_rate_hz"], 1 / values["mirror_frequency_hz"]
    plane = (origin + reach, normal)
    a = straddling(values, lever_arm, mirror, pulse, pulse / turn, plane)
    b = straddling(values, lever_arm, mirror, turn, 0 * turn, plane)
    assert np.abs(lattice.a - a).max() < 1e-9
    assert np.abs(lattice.b - b).max() < 1e-9
    gap = np.linalg.norm(np.cross(a, b), axis=1) / np.linalg.norm(a, axis=1)
    assert np.abs(lattice.profile_spacing_perpendicular_m - gap).max() < 1e-9
    assert np.abs(lattice.point_spacing_m - np.linalg.norm(a, axis=1)).max() < 1e-9
    level = np.cross([0, 0, 1], normal)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    slope = np.cross(normal, level)
    up, across = np.abs(np.sum(a * slope, axis=1)), np.abs(np.sum(a * level, axis=1))
    angle = np.degrees(np.arctan2(up, across))
    assert np.abs(lattice.profile_angle_deg - angle).max() < 1e-6
    # along a line that profiles nearly follow the gap grows without end: times the step, the cell
    cell = gap * np.linalg.norm(a, axis=1)
    assert np.abs(lattice.profile_spacing_horizontal_m * up - cell).max() < 1e-10
    assert np.abs(lattice.profile_spacing_vertical_m * across - cell).max() < 1e-10


def test_lattice_is_that_of_the_simulators_ray_caster(rng):
    n = 2000
    values = {**random_values(rng, n), **{name: np.zeros(n) for name in STEADY}}
    normal = np.array([-0.9, 0.3, 0.2]) / np.linalg.norm([-0.9, 0.3, 0.2])
    along, up = 500 * np.cross([0, 0, 1], normal), 500 * np.cross(normal, [0.3, 0.9, 0])
    scene = simulate.Scene(
        [simulate.rectangle(np.array([9, 0, 0]) - along / 2 - up / 2, along, up)]
    )
    setup = ScanSetup(**values)
    mirror = rng.uniform(-0.9, 0.9, n)
    origin, direction = rays(values, np.zeros(3), mirror, np.zeros(n))
    first = scene.cast(origin, direction).range_m
    usable = (first > 1) & (first < 60)
    assert usable.sum() > n / 2
    reach = np.where(usable, first, 10.0)[:, None] * direction
    lattice = scan_lattice(setup, Patch(reach, normal))
    pulse, turn = 1 / values["pulse_rate_hz"], 1 / values["mirror_frequency_hz"]
    for step, seconds, turns in ((lattice.a, pulse, pulse / turn), (lattice.b, turn, 0 * turn)):
        ends = []
        for side in (-0.5, 0.5):
            start, aim = rays(
                values, np.zeros(3), mirror + side * 2 * np.pi * turns, side * seconds
            )
            ends.append(start + scene.cast(start, aim).range_m[:, None] * aim)
        assert np.nanmax(np.abs(step - (ends[1] - ends[0]))[usable]) < 1e-9


def test_lattice_is_that_of_embree_where_it_is_installed(rng):
    trimesh = pytest.importorskip("trimesh", reason="second oracle: pip install trimesh embreex")
    pytest.importorskip("embreex", reason="second oracle: pip install trimesh embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    lattice = target_lattice(15, 10)
    values = {name: np.atleast_1d(getattr(MIMIC, name)) for name in random_values(rng, 1)}
    plane = lattice.beam + 40 * np.array([[-1, -1], [1, -1], [0, 2]]) @ lattice.axes
    caster = RayMeshIntersector(trimesh.Trimesh(plane, [[0, 1, 2]], process=False))
    setups = (("a", 1 / 3e5, 1 / 3000), ("b", 1 / 100, 0.0))
    for name, seconds, turns in setups:
        ends = []
        for side in (-0.5, 0.5):
            local = MIMIC.rotation().T @ lattice.beam
            mirror = np.atleast_1d(np.arctan2(local[2], local[0]) + side * 2 * np.pi * turns)
            origin, aim = rays(values, np.zeros(3), mirror, np.atleast_1d(side * seconds))
            ends.append(caster.intersects_location(origin, aim)[0][0])
        assert np.abs(getattr(lattice, name) - (ends[1] - ends[0])).max() < 1e-5  # float32 inside


@pytest.mark.parametrize(
    "case", list(table("cahalane2014", "table_3").itertuples()), ids=lambda c: f"row {c.no}"
)
def test_table_3_to_the_printed_digits(case):
    exact = [0.081650, 0.100000, 0.081650, 0.141421, 0.100000][case.no - 1]
    for range_m in (4.0, 8.0, 30.0):
        lattice = target_lattice(case.alpha_targ_deg, case.beta_targ_deg, range_m)
        spacing = lattice.profile_spacing_horizontal_m
        assert spacing == pytest.approx(exact, abs=5e-7)
        assert round(spacing, 3) == case.mimic_m


@pytest.mark.parametrize(
    ("case", "horizontal", "angle"),
    [
        ((15, 0), 0.081677, 40.9335),
        ((0, 15), 0.100033, 42.1373),
        ((15, 15), 0.081677, 46.0395),
        ((-15, 0), 0.141468, 26.5978),
        ((0, -15), 0.100033, 31.6408),
    ],
    ids=str,
)
def test_helios_finds_the_same_profiles(case, horizontal, angle):
    # scanned with HELIOS++ at 8 m; its deflector takes 3001 pulses for a revolution of 3000
    lattice = target_lattice(*case, range_m=8.0)
    corrected = horizontal * 3000 / 3001
    assert lattice.profile_spacing_horizontal_m == pytest.approx(corrected, abs=1e-6)
    assert lattice.profile_angle_deg == pytest.approx(angle, abs=1e-3)


def test_density_is_one_over_the_cell_and_independent_of_the_mirror(rng):
    values, lever_arm, *_, reach, normal = random_spots(rng, 500)
    lattice = scan_lattice(ScanSetup(**values, lever_arm_m=tuple(lever_arm)), Patch(reach, normal))
    # the cell is laid about the spot: equal up to the square of the mirror's step over cos(i)
    step = np.radians(lattice.setup.pulse_step_deg) / np.cos(np.radians(lattice.incidence_deg))
    assert (np.abs(lattice.density_per_m2 * lattice.cell_m2 - 1) < 2 * step**2 + 1e-4).all()
    faster = replace(lattice.setup, mirror_frequency_hz=2 * values["mirror_frequency_hz"])
    assert np.allclose(scan_lattice(faster, Patch(reach, normal)).density_per_m2,
                       lattice.density_per_m2, rtol=1e-12)  # fmt: skip


def test_density_is_that_of_the_papers_formula():
    lattice = target_lattice(15, 10, range_m=7, height_difference_m=1.5)
    cosine = np.cos(np.radians(lattice.incidence_deg))
    expected = 3e5 * cosine / (2 * np.pi * 10 * lattice.range_m * 0.5)
    assert lattice.density_per_m2 == pytest.approx(expected, rel=1e-12)


def scan_of(surfaces, scanner, length=12.0):
    path = simulate.straight(length, 10.0, start=(0, -length / 2, 0))
    return simulate.scan_all(simulate.Scene(surfaces), scanner, path, seed=1)


PROFILER = simulate.ProfileScanner(
    pulse_rate_hz=600_000, mirror_frequency_hz=200, heading_deg=20, tilt_deg=30
)
SETUP = ScanSetup.of_scanner(PROFILER, speed_m_s=10.0)


@pytest.mark.parametrize(("turn", "lean"), [(0, 0), (20, 15)])
def test_counted_density_on_a_plane_within_one_per_cent(turn, lean):
    patch = Target(heading_deg=turn, tilt_deg=lean, range_m=6).patch(SETUP)
    level, slope = scan_lattice(SETUP, patch).axes
    corner = patch.points * [1, 0, 1] - 10 * level - 10 * slope
    cloud = scan_of([simulate.rectangle(corner, 20 * level, 20 * slope)], PROFILER)
    u = (cloud.points - patch.points * [1, 0, 1]) @ np.array([level, slope]).T
    counted = (np.abs(u) < [1.0, 0.75]).all(axis=1).sum()
    grid = np.stack(np.meshgrid(np.linspace(-0.95, 0.95, 20), np.linspace(-0.7, 0.7, 15)), -1)
    places = patch.points + grid @ np.array([level, slope])
    lattice = scan_lattice(SETUP, Patch(places, patch.normals))
    assert counted == pytest.approx(3 * lattice.density_per_m2.mean(), rel=0.01)


def brute_distances(a, b):
    """Nearest of many lattice points in each half-open quadrant."""
    i, j = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61))
    x, y = np.multiply.outer([1.0, 0.0], 0 * i) + a[:, None, None] * i + b[:, None, None] * j
    quadrants = [(x > 0) & (y >= 0), (x <= 0) & (y > 0), (x < 0) & (y <= 0), (x >= 0) & (y < 0)]
    return np.sort([np.hypot(x, y)[q].min() for q in quadrants])


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
    assert lattice_distances([1, 0], [0, 1]).tolist() == [1, 1, 1, 1]  # axes belong to one quadrant
    assert np.isnan(lattice_distances([1, 0], [2, 0])).all()
    assert np.isnan(lattice_distances([np.nan, 0], [0, 1])).all()


def test_pulse_rates_that_the_mirror_does_not_divide_shift_profiles():
    wall = Target(range_m=5)
    setup = replace(MIMIC, scanner_heading_deg=0, scanner_tilt_deg=0, pulse_rate_hz=300_050)
    lattice = scan_lattice(setup, wall.patch(setup))
    a, _, nearest = lattice.plane_steps()
    half = 0.5 * np.linalg.norm(a)  # half a pulse a revolution
    assert abs(nearest[1]) == pytest.approx(half, rel=1e-3)
    assert lattice.f == pytest.approx(np.hypot(0.1, half) / np.linalg.norm(a), rel=1e-3)


def test_larger_worlds_look_the_same():
    small = target_lattice(15, 10, range_m=4)
    faster = replace(MIMIC, speed_m_s=30)
    large = target_lattice(15, 10, range_m=12, setup=faster)
    assert np.allclose(large.a, 3 * small.a, rtol=1e-12)
    assert np.allclose(large.b, 3 * small.b, rtol=1e-12)
    assert large.f == pytest.approx(small.f, rel=1e-12)


def test_turning_about_the_scanners_own_axis_changes_nothing():
    plain = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10)
    rolled = replace(plain, boresight_roll_deg=7.0)
    spot = Target(range_m=5, height_difference_m=1).patch(plain)
    first, second = scan_lattice(plain, spot), scan_lattice(rolled, spot)
    assert np.allclose(first.a, second.a, atol=1e-15)
    assert np.allclose(first.b, second.b, atol=1e-15)


def test_a_mirror_that_spins_the_other_way_tilts_profiles_the_other_way():
    plain = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10)
    spot = Target(range_m=5).patch(plain)
    up, down = scan_lattice(plain, spot), scan_lattice(replace(plain, spin=-1), spot)
    assert np.allclose(up.a * [1, 1, -1], down.a, atol=1e-12)
    # MIMIC's plane at rest would lay these profiles upright
    assert 90 - up.profile_angle_deg == pytest.approx(np.degrees(0.1 / (2 * np.pi * 5)), rel=1e-5)


def test_a_lattice_draws_as_many_points_as_it_predicts():
    lattice = target_lattice(15, 10)
    assert len(lattice.points(0.5)) == pytest.approx(lattice.density_per_m2, rel=0.03)
    ax = lattice.plot(half_width=0.5)
    assert len(ax.lines[0].get_xdata()) == len(lattice.points(0.5))
    assert "(mm)" in ax.get_xlabel()
    plots.plt.close(ax.figure)
    assert "density_per_m2" in lattice._repr_html_()


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


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: replace(MIMIC, pulse_rate_hz=0), "Invalid pulse_rate_hz 0. Must be > 0"),
        (lambda: replace(MIMIC, scanner_tilt_deg=np.nan), "Invalid scanner_tilt_deg nan."),
        (lambda: replace(MIMIC, spin=2), "Invalid spin 2."),
        (lambda: replace(MIMIC, speed_m_s="fast"), "Invalid speed_m_s 'fast'."),
        (lambda: replace(MIMIC, speed_m_s=[1, 2], roll_deg=[1, 2, 3]), "Must broadcast."),
        (lambda: Patch([1, 2], [0, 0, 1]), "Must have shapes (..., 3)."),
        (lambda: Patch([1, 2, 3], [0, 0, 0]), "Must be > 0 long."),
        (lambda: propagate(MIMIC, Target(range_m=5), sigmas={"wind": 1}), "Invalid input 'wind'."),
        (lambda: largest_speed(MIMIC, Target(range_m=5), quantity="f", limit=0.5), "it fails at"),
    ],
)  # fmt: skip
def test_rejects(make, sentence):
    with pytest.raises((ValueError, TypeError)) as error:
        make()
    assert sentence in str(error.value)
