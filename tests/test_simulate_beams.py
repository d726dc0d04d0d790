"""Steps of scanners, matching cameras, trajectories and patterns: boxes, rings, echoes, loops."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mmqa_lab import simulate
from mmqa_lab.rotations import rotations
from mmqa_lab.simulate import PRESETS, Scanner, Scene, Trajectory, point_patterns, systems
from mmqa_lab.simulate.trajectories import _course

module = import_module("mmqa_lab.simulate.scan")  # the package offers its function by this name


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_merge_fills_in_the_strongest_echo(uncompiled, rng):
    uncompiled(module)
    ranges = rng.choice([5.0, 5.3, 5.8, 7.0, np.inf], (60, 5)) + rng.normal(0, 0.05, (60, 5))
    met = np.isfinite(ranges)
    surface = np.where(met, rng.integers(0, 3, ranges.shape), -1)
    signal = np.where(met, rng.uniform(0.1, 1, ranges.shape), 0.0)
    range_m, sums = np.zeros((2, 60))
    top, mixed = np.zeros(60, int), np.zeros(60, bool)
    module._merge(ranges, signal, surface, range_m, sums, top, mixed)
    for n in np.flatnonzero(met.any(axis=1)):
        order = np.argsort(ranges[n])[: met[n].sum()]
        cuts = np.flatnonzero(np.diff(ranges[n, order]) > 0.6) + 1
        echo = max(np.split(order, cuts), key=lambda rays: signal[n, rays].sum())
        assert sums[n] == pytest.approx(signal[n, echo].sum())
        assert range_m[n] == pytest.approx(np.average(ranges[n, echo], weights=signal[n, echo]))
        assert top[n] == echo[signal[n, echo].argmax()]
        assert mixed[n] == (len({*surface[n, echo]}) > 1)
    assert not sums[~met.any(axis=1)].any()
    assert not mixed[~met.any(axis=1)].any()


def test_pass_near_is_whether_a_beam_crosses_the_widened_box(uncompiled, rng):
    uncompiled(module)
    n, count = 3, {True: 0, False: 0}
    for _ in range(60):
        centre = rng.normal(0, 4, (2, n, 3))
        turn = rotations(*rng.uniform(-3, 3, (3, n)))
        frames = np.empty((2, n, 4, 3))
        frames[:, :, 0], frames[:, :, 1:] = centre, turn
        half = rng.uniform(0.05, 1.0, (n, 3))
        sizes = np.column_stack([np.linalg.norm(half, axis=1), half])
        place = rng.random()
        way = unit(centre[0, 0] + 0.7 * rng.normal(size=3))
        slack, growth = 0.2, 0.03
        found = module._pass_near(np.array([place]), way[None], frames, sizes, slack, growth)[0]
        t = np.linspace(-12, 12, 6001)[:, None]
        near, sure = False, True
        for k in range(n):
            middle = centre[0, k] + place * (centre[1, k] - centre[0, k])
            wide = slack + growth * (np.linalg.norm(middle) + sizes[k, 0])
            off = np.abs((t * way - middle) @ turn[k].T) - (half[k] + wide)
            limit = sizes[k, 0] + wide
            ahead = middle @ way
            beside = np.linalg.norm(middle - ahead * way)
            close = ahead > -limit and beside <= limit
            near |= bool(close and (off <= 0).all(axis=1).any())
            sure &= min(abs(off.max(axis=1).min()), abs(ahead + limit), abs(beside - limit)) > 0.01
        if sure:
            assert found == near
            count[near] += 1
    assert min(count.values()) > 15
    behind = np.tile(np.eye(4)[None, None, :, 1:], (2, 1, 1, 1))
    behind[:, 0, 0] = [-5.0, 0, 0]
    sizes = np.array([[1.0, 0.5, 0.5, 0.5]])
    ways = np.array([[1.0, 0, 0], [-1, 0, 0]])
    assert module._pass_near(np.zeros(2), ways, behind, sizes, 0.1, 0.0).tolist() == [False, True]
    three = np.concatenate([behind, behind[:1]])  # each beam between the nodes of its own time
    three[:, 0, 0] = [[5.0, 0, 0], [0, 5.0, 0], [0, 0, 5.0]]
    places = np.array([0.0, 1.0, 2.0, 0.5, 1.5])
    aims = unit(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1]]))
    assert module._pass_near(places, aims, three, sizes, 0.1, 0.0).all()
    assert not module._pass_near(places, np.roll(aims, 2, axis=0), three, sizes, 0.1, 0.0).any()


def test_boxes_are_seen_from_the_scanner_at_nodes_a_hundredth_of_a_second_apart(monkeypatch, rng):
    seen = []
    monkeypatch.setattr(module, "_pass_near", lambda *given: seen.append(given))
    place = np.array([600_000.0, 4_800_000, 150])
    things = [simulate.cylinder(place, place + [1, 2, 3], 0.3), simulate.board(place + 5, 2, 1)]
    scene = Scene(things)
    scanner = Scanner(pulse_rate_hz=1e4, mirror_frequency_hz=10, heading_deg=30, tilt_deg=-20,
                      lever_arm_m=(0.3, -1, 0.5), boresight_deg=(1, 2, 3), divergence_mrad=2.0,
                      exit_diameter_m=0.04)  # fmt: skip
    time = np.linspace(0, 0.2, 21)
    path = Trajectory(time, place + rng.normal(0, 1, (21, 3)).cumsum(axis=0),
                      roll=3 + 9 * time, pitch=-2.0, heading=40 * time)  # fmt: skip
    since = np.linspace(0.0331, 0.0979, 50)
    beams = unit(rng.normal(size=(50, 3)))
    module._may_meet(scene, scanner, path, since, beams)
    places, given, frames, sizes, slack, growth = seen[0]
    assert given is beams
    assert (slack, growth) == (pytest.approx(0.05 + 0.04), pytest.approx(0.002))
    radii = [np.linalg.norm(one.half) for one in things]
    assert sizes == pytest.approx(np.column_stack([radii, scene.boxes[1]]))
    nodes = np.linspace(since[0], since[-1], len(frames))
    assert nodes[1] - nodes[0] <= 0.01 + 1e-12
    assert len(nodes) <= 9
    assert places == pytest.approx((since - since[0]) / (nodes[1] - nodes[0]))
    where, turn = path.at(nodes)
    for k, one in enumerate(things):
        for node in range(len(nodes)):
            origin = where[node] + turn[node] @ scanner.lever_arm_m
            whole = turn[node] @ scanner.true_mounting
            assert frames[node, k, 0] == pytest.approx((one.centre[0] - origin) @ whole, abs=1e-7)
            assert frames[node, k, 1:] == pytest.approx(scene.boxes[0][k] @ whole)
    assert module._may_meet(scene, scanner, path, since[:0], beams[:0]).shape == (0,)
    one = module._may_meet(scene, scanner, path, since[:1], beams[:1])
    assert one is None  # of one pulse two nodes at one time
    assert seen[-1][0].tolist() == [0]
    many = SimpleNamespace(balls=np.zeros((65, 4)))
    assert module._may_meet(many, scanner, path, since, beams).all()


@pytest.mark.parametrize(("exit_m", "mrad"), [(0.02, 0.0), (0.0, 3.0), (0.01, 2.0)])
def test_footprint_is_a_ring_of_651_thousandths_of_the_beam(exit_m, mrad, rng):
    scanner = Scanner(pulse_rate_hz=1e4, mirror_frequency_hz=10, exit_diameter_m=exit_m,
                      divergence_mrad=mrad)  # fmt: skip
    origin, way = rng.normal(size=(4, 3)), unit(rng.normal(size=(4, 3)))
    turn = rng.random(4)
    starts, aims = module._footprint(scanner, origin, way, turn)
    assert starts.shape == aims.shape == (4, 7, 3)
    for far in (0.0, 10.0):
        ends = starts + far * aims / (aims * way[:, None]).sum(axis=2, keepdims=True)
        off = ends - origin[:, None] - far * way[:, None]
        radius = 0.651 * (exit_m / 2 + far * np.tan(mrad / 2000))
        assert np.linalg.norm(off[:, 0], axis=1) == pytest.approx(0, abs=1e-12)
        assert np.linalg.norm(off[:, 1:], axis=2) == pytest.approx(radius)
    ring = unit(
        (starts if exit_m else aims - aims[:, :1])[:, 1:] - (starts[:, :1] if exit_m else 0)
    )
    turned = (ring * np.roll(ring, 1, axis=1)).sum(axis=2)
    assert turned == pytest.approx(0.5, abs=1e-4)  # sixths of a turn
    again = module._footprint(scanner, origin, way, turn + 1 / 6)  # of a whole turn
    assert again[1][:, 1:6] == pytest.approx(aims[:, 2:])
    assert again[0][:, 1:6] == pytest.approx(starts[:, 2:])
    line = module._footprint(
        replace(scanner, exit_diameter_m=0, divergence_mrad=0), origin, way, turn
    )
    assert [one.shape for one in line] == [(4, 1, 3)] * 2


def test_shoot_tells_each_pulse_with_its_echo(rng):
    wall = Scene([simulate.rectangle((5, -60, -20), (0, 120, 0), (0, 0, 40), reflectance=0.4)])
    scanner = Scanner(pulse_rate_hz=3600, mirror_frequency_hz=10, elevations_deg=(10, -10),
                      range_noise_m=0.02, min_range_m=5.2, max_range_m=8.0)  # fmt: skip
    path = simulate.straight(2, 10, start_time=500.0)
    known = Trajectory(path.time - 0.0, path.position + [0.1, 0.2, 0.3], heading=1.0)
    pulse = np.arange(100, 700)
    cloud = module._shoot(wall, scanner, path, known, pulse, np.random.default_rng(1))
    fired = scanner.fire(cloud["pulse"])
    for name in ("scan_angle", "scan_line", "ring"):
        assert np.array_equal(cloud[name], fired[name])
    assert cloud["gps_time"] == pytest.approx(500 + cloud["pulse"] / 3600)
    angle = np.radians(cloud["scan_angle"])
    level = np.cos(np.radians(10))
    assert cloud["range_m"] == pytest.approx(5 / np.sin(angle) / level)
    cosine = 5 / cloud["range_m"]
    assert np.cos(np.radians(cloud["incidence_deg"])) == pytest.approx(cosine)
    assert cloud["intensity"] == pytest.approx(65_535 * 0.4 * cosine, abs=0.51)
    assert cloud["range_m"].min() >= 5.2
    # half of the pulses return where 0.4 cos(i) (8 / r)^2 is 0.8: at 5.4 m, and fade by a fifth
    fade = np.log(0.4 * cosine * 64 / cloud["range_m"] ** 2 / 0.8)
    assert fade.min() > -0.8
    assert fade.min() < 0.1
    beams = scanner.beams(angle, np.radians(np.array([-10, 10])[cloud["ring"]]))
    turned = (
        Scanner.beams(angle, np.radians(np.array([-10, 10])[cloud["ring"]])) @ scanner.mounting.T
    )
    where = known.position[0] + np.outer(cloud["pulse"] / 3600, [0, 10, 0])
    c, s = np.cos(np.radians(1)), np.sin(np.radians(1))
    rays = turned @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]).T
    ranges = (cloud["range_m"] + cloud["range_noise_m"])[:, None]
    assert cloud.points == pytest.approx(where + ranges * rays, abs=1e-9)
    assert len(beams) == len(cloud)
    noise = cloud["range_noise_m"]
    assert noise.std() == pytest.approx(0.02, rel=0.25)
    assert "mixed" not in cloud


def test_fading_is_a_fifth_of_the_signal_on_the_logarithm():
    wall = Scene([simulate.rectangle((5, -900, -0.1), (0, 1800, 0), (0, 0, 0.2), reflectance=0.5)])
    base = Scanner(pulse_rate_hz=36_000, mirror_frequency_hz=100, field_of_view_deg=(89.5, 90.5))
    path = simulate.straight(200, 10)
    every = len(simulate.scan(wall, base, path, seed=1))
    for fade, share in ((-0.2, 0.1587), (0.0, 0.5), (0.2, 0.8413)):
        reach = 5 * np.exp(fade / 2) * np.sqrt(0.8 / 0.5)
        scanner = replace(base, max_range_m=reach)
        kept = len(simulate.scan(wall, scanner, path, seed=1)) / every
        assert kept == pytest.approx(share, abs=0.02)


def test_pulses_leave_in_turns_of_their_beams_and_within_their_view():
    scanner = Scanner(pulse_rate_hz=3600, mirror_frequency_hz=10, elevations_deg=(5, -7, 1),
                      field_of_view_deg=(-90.0, 45.0))  # fmt: skip
    pulse = np.arange(0, 2000)
    fired = scanner.fire(pulse)
    turn = pulse % 360 - 180.0
    left = (turn >= -90) & (turn <= 45)
    assert fired["pulse"].tolist() == pulse[left].tolist()
    assert fired["scan_angle"] == pytest.approx(turn[left])
    ring = np.array([2, 0, 1])[pulse[left] % 3]  # counted from the lowest
    assert fired["ring"].tolist() == ring.tolist()
    assert fired["scan_line"].tolist() == (pulse[left] // 360 * 3 + ring).tolist()
    for h, t in ((0, 0), (30, 0), (0, 40), (25, -35)):
        one = Scanner(pulse_rate_hz=1, mirror_frequency_hz=1, heading_deg=h, tilt_deg=t)
        a, g = np.radians([h, t])
        about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        about_x = np.array([[1, 0, 0], [0, np.cos(g), -np.sin(g)], [0, np.sin(g), np.cos(g)]])
        assert one.mounting == pytest.approx(about_z @ about_x)
        assert one.plane_normal == pytest.approx((about_z @ about_x)[:, 1])
        upright = replace(one, tilt_deg=t - 90, upright=True)
        assert upright.mounting == pytest.approx(one.mounting)


def test_views_hold_every_beam_that_reaches_the_corners():
    corners = simulate.chart_corners((5, 0, 1), heading=systems.FACING_THE_ROAD)
    path = simulate.straight(40, 10, start=(0, -20, 0))
    level = Scanner(pulse_rate_hz=1e5, mirror_frequency_hz=100)
    for scanner in (systems.SYSTEM_A, replace(systems.SYSTEM_B, heading_deg=10), level):
        found = list(systems._views(scanner, path, corners))
        times = np.linspace(0, 4, 201)
        away = corners - path.at(times)[0][:, None]
        angle, elevation = scanner.angles(away @ scanner.mounting)
        low, high = min(scanner.elevations_deg) - 1, max(scanner.elevations_deg) + 1
        sees = (elevation.min(axis=1) <= high) & (elevation.max(axis=1) >= low)
        expected = []
        for first in range(0, 200, 4):
            some = slice(first, first + 5)
            if sees[some].any():
                view = angle[some].min() - 5, angle[some].max() + 5
                expected.append((times[first], times[first + 4], *np.clip(view, -180, 180)))
        assert np.array([(*a, *b) for a, b in found]) == pytest.approx(np.array(expected))
    assert len(found) == 2  # of the plane across the path


def test_matched_points_have_their_rays_and_the_error_of_their_depth(monkeypatch):
    camera = systems.MatchingCamera(
        focal_px=1000, base_m=2.0, points_per_px=0.5, hard_core=0.3, resampled_per_m2=3000,
        noise_px=0.4, floor_m=0.003, correlation_px=8.0, correlated_share=0.36,
    )  # fmt: skip
    places = np.random.default_rng(0).random((500, 2))
    asked = []

    def points(size, density, core, rng):
        asked.append((size.tolist(), density, core))
        return places

    monkeypatch.setattr(systems, "hard_core_points", points)
    monkeypatch.setattr(systems, "_shared", lambda *_: np.full(500, 2.0))
    alone = SimpleNamespace(standard_normal=lambda n: np.full(n, -1.0))
    cloud = systems._matched(camera, 10.0, 1.5, alone)
    assert asked == [([1, 1], 3000, 0.3)]
    sigma = np.hypot(100 / (2 * 1000) * 0.4, 0.003)
    depth = 10 + sigma * (0.6 * 2.0 - 0.8)
    aims = np.column_stack([np.full(500, 10.0), places[:, 0] - 0.5, places[:, 1] - 2.0])
    assert cloud.points == pytest.approx(depth / 10 * aims + [0, 0, 1.5])
    length = np.linalg.norm(aims, axis=1)
    assert cloud["range_m"] == pytest.approx(length)
    assert np.cos(np.radians(cloud["incidence_deg"])) == pytest.approx(10 / length)
    assert cloud["range_noise_m"] == pytest.approx((depth - 10) * length / 10)
    for other in (replace(camera, resampled_per_m2=0), replace(camera, resampled_per_m2=9000)):
        systems._matched(other, 10.0, 1.5, alone)
        assert asked.pop()[1] == pytest.approx(0.5 * 100**2)


def test_what_neighbours_share_falls_with_their_distance_in_the_image():
    camera = replace(systems.SYSTEM_C, correlation_px=20.0, focal_px=1000)
    places = np.array([[0.3, 0.4], [0.4, 0.4], [0.3, 0.7], [0.9, 0.9]])
    rng = np.random.default_rng(2)
    drawn = np.array([systems._shared(camera, 5.0, places, rng) for _ in range(3000)])
    assert drawn.std(axis=0) == pytest.approx(1, abs=0.06)
    # white noise behind a Gaussian of 20 px, 0.1 m at 5 m
    apart = np.linalg.norm(places - places[0], axis=1)
    expected = np.exp(-((apart / (2 * 0.1)) ** 2))
    assert np.corrcoef(drawn.T)[0] == pytest.approx(expected, abs=0.05)


def test_crowded_points_have_enough_others_around_them(rng):
    points = np.concatenate([rng.uniform(0, 4, (300, 3)), rng.uniform(0, 12, (200, 3))]) + [9, 8, 7]
    others = (np.linalg.norm(points[:, None] - points, axis=2) <= 1.5).sum(axis=1) - 1
    for fewest in (1, 5, 20):
        found = systems._crowded(points, fewest, 1.5)
        assert np.array_equal(found, others >= fewest)
        assert 0 < found.sum() < 500
    arms = systems.System("two", (PRESETS["vq-250"],) * 2, lever_arm_error_m=((1, 2, 3), (4, 5, 6)))
    assert arms.assumed_lever_arms == pytest.approx(np.array([[1, 2, 3], [4, 5, 6.0]]))


def test_course_is_the_direction_between_places_three_decimetres_apart():
    time = np.arange(6.0)
    place = np.array([[0, 0], [0.2, 0.2], [0.25, 0.25], [0.5, 0.5], [0.5, 0.79], [0.5, 1.5]])
    found = _course(time, np.column_stack([place, np.zeros(6)]))
    # kept: 0; (.25, .25) is .354 from it; (.5, .5) is .354; (.5, 1.5); .29 is too little
    kept = place[[0, 2, 3, 5]]
    way = np.degrees(np.arctan2(*np.gradient(kept, axis=0).T))
    assert found == pytest.approx(np.interp(time, time[[0, 2, 3, 5]], way))
    with pytest.raises(ValueError, match="Must move"):
        _course(time[:3], np.column_stack([0.2 * place[:3], np.zeros(3)]))
    with pytest.raises(ValueError, match="in row 2"):
        Trajectory([0, 1, 1], np.zeros((3, 3)))
    circle = np.radians(np.arange(0, 720, 10))
    round_ = np.column_stack([9 * np.sin(circle), -9 * np.cos(circle), 0 * circle])
    turned = _course(np.arange(72.0), round_)
    assert np.diff(turned)[1:-1] == pytest.approx(-10, abs=1e-6)  # a heading may pass 360


def test_patterns_in_their_own_frame_have_their_density_and_their_rule():
    half, rng = np.array([20.0, 12.0]), np.random.default_rng(5)
    window = 4 * half.prod()

    def inner(xy):
        return (np.abs(xy) < half).all(axis=1)

    for drawn, step in ((point_patterns._lattice, 0.5), (point_patterns._hexagonal, None)):
        xy = drawn(rng, 4.0, half)
        assert inner(xy).sum() == pytest.approx(4 * window, rel=0.02)
        near, _ = cKDTree(xy).query(xy[inner(xy)], k=7)
        if step:
            assert near[:, 1:5] == pytest.approx(step)
        else:  # six neighbours as far as the densest packing has them
            assert near[:, 1:] == pytest.approx(np.sqrt(2 / np.sqrt(3) / 4))
    lines = point_patterns._scan_lines(rng, 4.0, half, 0.1)
    rows = np.unique(lines[:, 1].round(9))
    assert np.diff(rows) == pytest.approx(0.5)
    off, jitter = [], []
    for row in rows:
        along = np.sort(lines[np.isclose(lines[:, 1], row), 0])
        number = np.arange(len(along))
        shift = np.median(along - 0.5 * number)
        off.append(shift / 0.5 % 1)
        jitter.append(np.std(along - 0.5 * number))
    assert 0.15 < np.std(off) < 0.4  # each line has an offset of its own
    assert np.mean(jitter) == pytest.approx(0.05, rel=0.1)
    assert inner(lines).sum() == pytest.approx(4 * window, rel=0.02)
    hard = point_patterns._hard_core(rng, 4.0, half)
    assert len(hard) == 4 * window
    assert cKDTree(hard).query(hard, k=2)[0][:, 1].min() >= 0.35
    assert inner(hard).all()
    assert hard.max(axis=0) == pytest.approx(half, abs=0.2)
    many = point_patterns._clusters(rng, 40.0, half)
    assert inner(many).sum() == pytest.approx(40 * window, rel=0.06)
    # pairs of one cloud of eight: K(r) - pi r^2 = (1 - exp(-r^2 / 4 s^2)) 8 / density
    spread = 0.6 / np.sqrt(40)
    middle = many[(np.abs(many) < half - 1).all(axis=1)]
    for r in (spread, 3 * spread):
        pairs = np.array([*map(len, cKDTree(many).query_ball_point(middle, r))]).mean() - 1
        expected = 40 * np.pi * r**2 + 8 * (1 - np.exp(-((r / 2 / spread) ** 2)))
        assert pairs == pytest.approx(expected, rel=0.05)
    slope = point_patterns._gradient(rng, 40.0, half)
    assert len(slope) == pytest.approx(40 * window, rel=0.02)
    assert slope[:, 0].mean() == pytest.approx(0.8 * half[0] / 3, rel=0.06)
    holes = [point_patterns._holes(rng, 40.0, half) for _ in range(12)]
    assert np.mean([*map(len, holes)]) == pytest.approx(40 * window, rel=0.05)
    spots = rng.uniform(-half, half, (3000, 2))
    empty = np.mean([cKDTree(xy).query(spots)[0] > 0.7 * 4 / np.sqrt(40) for xy in holes])
    # of centres within 30 % of the radius, as far as holes may also join
    assert empty > 1 - 0.8 ** (0.3**2)
    random = point_patterns._poisson(rng, 40.0, half)
    assert len(random) == pytest.approx(40 * window, abs=5 * np.sqrt(40 * window))
    assert random.std(axis=0) == pytest.approx(half / np.sqrt(3), rel=0.02)


def test_placed_patterns_are_stretched_and_turned_over_their_disc():
    got = []

    def drawn(_, density, half):
        got.append((density, half))
        return np.array([[1.0, 0], [0, 1.0], [2.0, 3.0]])

    found = point_patterns._placed(drawn, None, 7.0, 5.0, 4.0, 30.0)
    assert got[0][0] == 7
    assert got[0][1] == pytest.approx([10, 2.5])
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    # along the angle half as far, across it twice
    local = np.array([[0.5, 0], [0, 2.0], [1.0, 6.0]])
    assert found == pytest.approx(local @ [[c, s], [-s, c]])
    noise = [point_patterns.point_pattern("lattice", density=9, size=20, seed=1, noise=sigma)
             for sigma in (0.0, 0.02)]  # fmt: skip
    inner = (np.abs(noise[1] - 10) < 9).all(axis=1)
    off = cKDTree(noise[0]).query(noise[1][inner])[0]
    assert np.sqrt((off**2).mean() / 2) == pytest.approx(0.02, rel=0.08)
    turned = point_patterns.point_pattern("lattice", density=9, size=20, seed=1, angle=90, ratio=4)
    assert np.unique(turned[:, 0].round(6)).size == 30  # lines 2/3 m apart run along y
    two = point_patterns.point_pattern("two_heads", density=100, size=9, seed=1, ratio=6, jitter=0)
    rows = [np.unique(two[:, k].round(6), return_counts=True)[1] for k in (0, 1)]
    assert all((one > 50).sum() == pytest.approx(9 / np.sqrt(6 / 50), abs=2) for one in rows)
    assert np.isnan(point_patterns.expected_f("clusters", 4))
    assert point_patterns.expected_f("hexagonal", 2) == pytest.approx(np.sqrt(0.25 + 3))
    assert point_patterns.expected_f("scan_lines", 3) == pytest.approx(np.sqrt(9 + 1 / 8))
