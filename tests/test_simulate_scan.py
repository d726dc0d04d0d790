"""Scans with known truth: lattice and density in closed form, errors one by one, same seeds."""

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mmqa_lab import io, simulate
from mmqa_lab.simulate import Scanner, Scene, Trajectory
from mmqa_lab.simulate.scan import _strongest
from mmqa_lab.simulate.scenes import Hits

module = import_module("mmqa_lab.simulate.scan")  # the package offers its function by this name

SPEED = 10.0
PROFILER = Scanner(pulse_rate_hz=300_000, mirror_frequency_hz=100)
UTM = np.array([600_123.4, 4_800_456.7, 150.2])


def drive(length=2.0, **options):
    return simulate.straight(length, SPEED, **options)


@cache
def wall():
    """Made by the first test, not where tests are collected: it waits for the compiler."""
    return Scene([simulate.rectangle((5, -60, -20), (0, 120, 0), (0, 0, 40))])


def scan(scene=None, scanner=PROFILER, path=None, **options):
    return simulate.scan(scene or wall(), scanner, path or drive(), **{"seed": 1, **options})


def test_point_spacing_and_profile_spacing_on_a_parallel_wall():
    cloud = scan()
    line = cloud["scan_line"]
    one = cloud[line == line[len(line) // 2]]
    down = np.radians(one["scan_angle"])
    step = 2 * np.pi * 100 / 300_000
    gap = np.linalg.norm(np.diff(one.points[:, [0, 2]], axis=0), axis=1)
    exact = 5 / np.tan(down[:-1]) - 5 / np.tan(down[1:])  # z = -R cos, 5 = R sin
    assert np.abs(gap - exact).max() < 1e-9
    middle = np.argmin(np.abs(down - np.pi / 2))
    assert gap[middle] == pytest.approx(5 * step, rel=1e-5)  # d_PS = R dphi, hit square
    level = np.abs(cloud["scan_angle"] - 90) < 0.06
    along = np.diff(np.sort(cloud.points[level, 1]))
    assert np.abs(along - SPEED / 100).max() < 1e-9  # profiles v / Mf apart


def test_points_lie_in_the_scan_plane_at_their_range_on_their_surface():
    scene = Scene([simulate.ground(-2), simulate.cylinder((4, 1, -2), (4.3, 1, 4), 0.1)])
    scanner = replace(PROFILER, heading_deg=30, tilt_deg=-20, lever_arm_m=(0.3, -1, 0.5))
    cloud = scan(scene, scanner, drive(2, roll=2, pitch=-3, heading=10))
    h, p, r, a, g = np.radians([10, -3, 2, 30, -20])
    turn = Rotation.from_euler
    body = (turn("z", -h) * turn("x", p) * turn("y", r)).as_matrix()
    arm = body @ scanner.lever_arm_m
    origin = np.outer(SPEED * cloud["pulse"] / 3e5, [np.sin(h), np.cos(h), 0]) + arm
    ray = cloud.points - origin
    assert np.abs(np.linalg.norm(ray, axis=1) - cloud["range_m"]).max() < 1e-9
    normal = body @ (turn("z", a) * turn("x", g)).apply([0, 1, 0])
    assert np.abs(ray @ normal).max() < 1e-9
    ground = cloud["surface"] == 0
    assert ground.any()
    assert (~ground).any()
    assert np.abs(cloud.points[ground, 2] + 2).max() < 1e-9
    incidence = np.degrees(np.arccos(-ray[ground, 2] / cloud["range_m"][ground]))
    assert np.abs(incidence - cloud["incidence_deg"][ground]).max() < 1e-5


def test_a_seed_gives_the_same_points_and_another_one_others():
    noisy = replace(PROFILER, range_noise_m=0.01, angle_noise_deg=0.01, divergence_mrad=0.5)
    noisy = replace(noisy, dropout_share=0.1)
    first, again, other = (scan(scanner=noisy, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.points, again.points)
    lost = scan(scanner=replace(noisy, dropout_share=0.3))
    shared = np.isin(first["pulse"], lost["pulse"])
    assert np.array_equal(first["range_noise_m"][shared], lost["range_noise_m"])
    assert not np.array_equal(first.points, other.points[: len(first)])


def test_moving_to_utm_and_to_gps_time_changes_nothing():
    scene = [simulate.rectangle(UTM + [5, -60, -20], (0, 120, 0), (0, 0, 40))]
    moved, still = scan(Scene(scene), path=drive(start=UTM)), scan()
    assert np.array_equal(moved["pulse"], still["pulse"])
    assert np.abs(moved.points - UTM - still.points).max() < 5e-9  # float64 steps at 4.8e6 m
    late = scan(path=drive(start_time=1.4e9))
    assert np.abs(late.points - still.points).max() < 1e-6  # the end time is rounded to 2.4e-7 s
    assert late["gps_time"][0] == pytest.approx(1.4e9 + still["gps_time"][0], abs=1e-6)


def test_range_noise_angle_noise_and_dropouts_have_their_size():
    scanner = replace(PROFILER, range_noise_m=0.01, angle_noise_deg=0.02, dropout_share=0.2)
    cloud, clean = scan(scanner=scanner), scan()
    n = len(cloud)
    assert cloud["range_noise_m"].std() == pytest.approx(0.01, rel=4 / np.sqrt(2 * n))
    assert n / len(clean) == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / len(clean)))
    near = np.abs(cloud["scan_angle"] - 90) < 20
    true_angle = np.degrees(np.arcsin(np.minimum(5 / cloud["range_m"][near], 1)))
    shift = true_angle - np.minimum(cloud["scan_angle"], 180 - cloud["scan_angle"])[near]
    steep = np.abs(cloud["scan_angle"][near] - 90) > 5  # where the range shows the angle
    assert shift[steep].std() == pytest.approx(0.02, rel=0.05)


def test_weak_signals_get_lost():
    """Half of the pulses return where cos(i) (20 / r)^2 is 1; the wall's reflectance is 0.5 too."""
    scanner = replace(PROFILER, max_range_m=20, max_range_reflectance=0.5)
    kept, all_ = scan(scanner=scanner, path=drive(20.0)), scan(path=drive(20.0))
    limit = 2000 ** (1 / 3)  # cos(i) = 5 / r
    rates = []
    for low, high in ((5, 8), (limit * 0.98, limit * 1.02), (18, 30)):
        counts = [((c["range_m"] > low) & (c["range_m"] < high)).sum() for c in (kept, all_)]
        rates.append(counts[0] / counts[1])
    assert rates == pytest.approx([1, 0.5, 0], abs=0.03)


def edge(gap):
    """The top of a wall, and a higher one behind it."""
    front = simulate.rectangle((5, -60, -20), (0, 120, 0), (0, 0, 20))
    return Scene([front, simulate.rectangle((5 + gap, -60, -20), (0, 120, 0), (0, 0, 40))])


def test_beam_over_an_edge_mixes_near_surfaces_and_keeps_far_ones_apart():
    wide = replace(PROFILER, exit_diameter_m=0.02, divergence_mrad=2.0)
    near, far = (scan(edge(gap), wide) for gap in (0.3, 2.0))
    near, far = (cloud[np.abs(cloud["scan_angle"] - 90) < 3] for cloud in (near, far))
    between = (near.points[:, 0] > 5.02) & (near.points[:, 0] < 5.28)
    assert between.any()
    assert (near["mixed"][between] == 1).all()
    height = np.abs(near.points[near["mixed"] == 1, 2])
    assert height.max() < 0.02  # beam radius 15 mm at 5 m plus what z = 0 cuts
    assert not far["mixed"].any()
    assert not ((far.points[:, 0] > 5.02) & (far.points[:, 0] < 6.98)).any()


def test_mixed_share_is_footprint_over_spacing():
    # a pulse rate that the mirror frequency does not divide: pulses lie anywhere about the edge
    wide = replace(PROFILER, exit_diameter_m=0.06, pulse_rate_hz=299_987)
    cloud = scan(edge(0.3), wide, drive(20.0))
    # six rays on a ring of radius r reach r cos(u) high, u uniform within 30 degrees of the top
    reach = 0.651 * 0.03 * np.sin(np.pi / 6) / (np.pi / 6)
    expected = 2 * reach / (5 * 2 * np.pi * 100 / 3e5) * 200  # profiles
    assert cloud["mixed"].sum() == pytest.approx(expected, rel=0.05)


def test_two_heads_are_told_apart_and_cross():
    heads = [replace(PROFILER, heading_deg=h, tilt_deg=0) for h in (45, -45)]
    cloud = scan(scanner=heads, path=drive(6))
    assert set(cloud["head"]) == {0, 1}
    alone = scan(scanner=heads[0], path=drive(6))
    assert np.array_equal(cloud.points[cloud["head"] == 0], alone.points)


def test_measured_path_moves_points_and_not_rays():
    path = drive()
    known = replace(path, position=path.position + [0.1, -0.2, 0.05])
    truth, seen = scan(path=path), scan(path=path, measured=known)
    assert np.allclose(seen.points - truth.points, [0.1, -0.2, 0.05], atol=1e-9)
    assert np.array_equal(seen["range_m"], truth["range_m"])
    with pytest.raises(ValueError, match="Must cover 0"):
        scan(measured=drive(1.0))


def test_boresight_error_turns_the_cloud_about_the_scanner():
    off = replace(PROFILER, boresight_deg=(0, 0, 0.5))
    cloud = scan(scanner=off)
    level = np.abs(cloud["scan_angle"] - 90) < 1
    # true beams run 0.5 degrees clockwise; their ranges are put where none are expected
    assert cloud["range_m"][level].min() == pytest.approx(5 / np.cos(np.radians(0.5)), rel=1e-9)
    assert cloud.points[level, 0].min() == pytest.approx(5 / np.cos(np.radians(0.5)), rel=1e-9)


def test_hdl_32e_fires_its_beams_in_order_all_round():
    scanner = replace(simulate.PRESETS["hdl-32e"], range_noise_m=0, lever_arm_m=(0, 0, 2))
    room = Scene([simulate.box((0, 0, -20), (40, 40, 40))])
    cloud = scan(room, scanner, Trajectory([0, 0.2], [[0, 0, 0], [0, 0, 0]]))
    ray = cloud.points - [0, 0, 2]
    elevation = np.degrees(np.arcsin(ray[:, 2] / cloud["range_m"]))
    assert np.allclose(elevation, -92 / 3 + 4 / 3 * cloud["ring"], atol=1e-6)
    assert np.round(elevation[:4], 2).tolist() == [-30.67, -9.33, -29.33, -8.0]
    assert len(cloud) == pytest.approx(0.2 * 694_444, abs=1)
    azimuth = np.degrees(np.arctan2(ray[:, 0], ray[:, 1]))
    assert np.allclose((azimuth - cloud["scan_angle"] + 180) % 360, 180, atol=1e-6)
    assert len(np.unique(cloud["scan_line"])) == 64


@pytest.mark.real
def test_hdl_32e_fires_as_the_real_one(real):
    points = io.read_cloud(real("hdl32e_pair/sweep_a.laz")).points
    elevation = np.degrees(np.arcsin(points[:, 2] / np.linalg.norm(points, axis=1)))
    ring = np.round((elevation + 92 / 3) * 3 / 4)
    spread = elevation - (-92 / 3 + 4 / 3 * ring)
    assert np.median(np.abs(spread)) < 0.02
    order = simulate.PRESETS["hdl-32e"].fire(np.arange(32))["ring"]
    step = (np.argsort(order)[ring[1:].astype(int)] - np.argsort(order)[ring[:-1].astype(int)]) % 32
    assert (step == 1).mean() > 0.9  # the rest are pulses without an echo
    azimuth = np.degrees(np.unwrap(np.arctan2(points[:, 0], points[:, 1])))
    assert azimuth[-1] - azimuth[0] > 300  # clockwise from +y, as ours


def test_parts_of_a_drive_add_up_to_the_whole():
    whole = scan()
    first, second = (scan(between=b) for b in ((0, 0.0731), (0.0731, 0.2)))
    assert np.array_equal(whole.points, np.concatenate([first.points, second.points]))
    narrow = scan(scanner=replace(PROFILER, field_of_view_deg=(60, 110)))
    inside = (whole["scan_angle"] >= 60) & (whole["scan_angle"] <= 110)
    assert np.array_equal(whole["pulse"][inside], narrow["pulse"])


def test_angles_undo_beams(rng):
    angle, elevation = rng.uniform(-180, 180, 500), rng.uniform(-31, 11, 500)
    beams = Scanner.beams(np.radians(angle), np.radians(elevation))
    assert np.allclose(np.linalg.norm(beams, axis=1), 1)
    assert np.allclose(Scanner.angles(7 * beams), [angle, elevation])


def test_an_upright_scanner_is_a_profile_scanner_turned():
    """Heading and tilt turn both alike; the profile scanner's y is the upright one's down."""
    profiler = replace(PROFILER, heading_deg=20, tilt_deg=100)
    upright = replace(PROFILER, heading_deg=20, tilt_deg=10, upright=True)
    assert np.allclose(scan(scanner=profiler).points, scan(scanner=upright).points)


def test_the_strongest_echo_is_that_of_a_loop_over_the_rays(rng):
    ranges = rng.choice([5.0, 5.3, 5.8, 7.0, 7.5, np.nan], (500, 7)) + rng.normal(0, 0.05, (500, 7))
    met = np.isfinite(ranges)
    surface = np.where(met, rng.integers(0, 3, ranges.shape), -1)
    cosine, reflectance = np.where(met, rng.uniform(0.1, 1, (2, 500, 7)), np.nan)
    found = _strongest(Hits(ranges, surface, cosine, reflectance))
    signal = reflectance * cosine / ranges**2
    for row in np.flatnonzero(met.any(axis=1)):
        order = np.argsort(ranges[row])[: met[row].sum()]
        gaps = np.flatnonzero(np.diff(ranges[row, order]) > 0.6) + 1
        best = max(np.split(order, gaps), key=lambda rays: signal[row, rays].sum())
        weight, top = signal[row, best], best[signal[row, best].argmax()]
        assert found["range_m"][row] == pytest.approx(np.average(ranges[row, best], weights=weight))
        assert found["signal"][row] == pytest.approx(weight.sum() / 7)
        assert found["surface"][row] == surface[row, top]
        assert found["mixed"][row] == (len(set(surface[row, best])) > 1)
    assert not found["signal"][~met.any(axis=1)].any()


@given(
    turned=st.tuples(*[st.floats(-90, 90)] * 2),
    place=st.tuples(st.floats(-8, 8), st.floats(-1, 4), st.floats(-4, 4)),
    roll=st.floats(-10, 10),
    wide=st.sampled_from([0.0, 20.0]),
    stack=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_beams_that_are_not_cast_would_meet_nothing(turned, place, roll, wide, stack):
    base = simulate.PRESETS["hdl-32e"] if stack else PROFILER
    mounted = {"heading_deg": turned[0], "tilt_deg": turned[1], "pulse_rate_hz": 60_000}
    scanner = replace(base, divergence_mrad=wide, boresight_deg=(1, -2, 3), **mounted)
    scanner = replace(scanner, lever_arm_m=(0.3, -1, 0.5))
    corners = np.add(place, np.stack(np.meshgrid(*[np.arange(-2, 3, 2)] * 3), -1).reshape(-1, 3))
    small = [simulate.rectangle(corner, (0.1, 0.1, 0), (0, 0, 0.15)) for corner in corners]
    objects = Scene([*small, simulate.cylinder(place, np.add(place, (0, 0, 3)), 0.05)])
    time, way = np.linspace(0, 0.3, 31), np.radians(np.linspace(0, 40, 31))  # a sharp bend
    position = UTM + 4 * np.stack([1 - np.cos(way), np.sin(way), 0 * way], axis=1)
    path = Trajectory(time, position, roll=roll + 0 * way, heading=np.degrees(way))
    objects.origin = objects.origin + UTM
    asked = scan(objects, scanner, path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FEW_SURFACES", 0)
        every = scan(objects, scanner, path)
    assert np.array_equal(asked.points, every.points)
    assert all(np.array_equal(asked[name], every[name]) for name in every.columns)


@pytest.mark.parametrize("view", [(-180, 180), (-40, 95), (10, 12)])
def test_pulses_in_view_are_all_there_and_hardly_any_others(view):
    scanner = replace(PROFILER, pulse_rate_hz=3600.5, field_of_view_deg=view)
    for first, last in ((0, 500), (37, 91), (1000, 1003)):
        found = module._in_view(scanner, first, last)
        assert (np.diff(found) == 1).all() or view != (-180, 180)
        assert len(np.unique(found)) == len(found)
        angle = 360 * (np.arange(first, last) * 100 / 3600.5 % 1) - 180
        wanted = np.arange(first, last)[(angle >= view[0]) & (angle <= view[1])]
        assert set(wanted) <= set(found)
        assert ((found >= first) & (found < last)).all()
        assert len(found) - len(wanted) <= 5 * (1 + (last - first) / 36)


def test_intensity_is_reflectance_times_cosine_of_incidence_in_16_bits():
    side = simulate.rectangle((5, -60, -20), (0, 120, 0), (0, 0, 40), reflectance=0.4)
    cloud = scan(Scene([side]))
    expected = 65_535 * 0.4 * np.cos(np.radians(cloud["incidence_deg"]))
    assert np.abs(cloud["intensity"] - expected).max() <= 0.51


def test_rays_of_a_beam_lie_on_a_ring_that_grows(uncompiled, rng):
    uncompiled(module)
    origin, direction = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sides = module.across(direction)
    starts, aims = np.empty((2, 4, 7, 3))
    module._spread(origin, direction, sides, rng.random(4), 0.01, 0.003, starts, aims)
    assert starts[:, 0] == pytest.approx(origin)
    assert aims[:, 0] == pytest.approx(direction)
    ring = starts[:, 1:] - origin[:, None]
    assert np.linalg.norm(ring, axis=2) == pytest.approx(0.01)
    assert (ring * direction[:, None]).sum(axis=2) == pytest.approx(0)
    assert ring.sum(axis=1) == pytest.approx(0)  # six, evenly around
    assert np.linalg.norm(aims, axis=2) == pytest.approx(1)
    steep = (aims[:, 1:] * direction[:, None]).sum(axis=2)
    assert steep == pytest.approx(1 / np.hypot(1, 0.003))
    away = aims[:, 1:] - steep[..., None] * direction[:, None]
    assert (away * ring).sum(axis=2) / 0.01 == pytest.approx(0.003 / np.hypot(1, 0.003))
