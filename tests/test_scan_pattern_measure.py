"""Measured scan patterns: exact ones, simulated ones with their truth, and real ones."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import sem, t

from mmqa_lab import samples
from mmqa_lab.io import read_cloud
from mmqa_lab.scan_pattern import (
    ScanSetup,
    Target,
    measure,
    measure_pattern,
    scan_lattice,
    timing,
)
from mmqa_lab.scan_pattern.measure import MEASURED, pulse_period
from mmqa_lab.studies.mimic import simulate_patch


def case_of(pulse_rate, mirror, speed, scanner, target, place):
    """A set-up and a target from (heading, tilt) pairs and (range, height difference)."""
    setup = {"pulse_rate_hz": pulse_rate, "mirror_frequency_hz": mirror, "speed_m_s": speed}
    setup |= {"scanner_heading_deg": scanner[0], "scanner_tilt_deg": scanner[1]}
    wall = {"range_m": place[0], "height_difference_m": place[1]}
    return ScanSetup(**setup), Target(heading_deg=target[0], tilt_deg=target[1], **wall)


CASES = {
    "5 m, 45/45": case_of(300e3, 100, 8, (45, 45), (0, 0), (5, 0)),
    "8 m, 45/45, 15/15": case_of(300e3, 100, 10, (45, 45), (15, 15), (8, -1)),
    "12 m, 45/30, -20/30": case_of(500e3, 200, 12, (45, 30), (-20, 30), (12, 1)),
    "16 m, 30/30, 40/10": case_of(300e3, 100, 13, (30, 30), (40, 10), (16, 2)),
    "6 m, 45/20, -10/0": case_of(125e3, 100, 6, (45, 20), (-10, 0), (6, 1)),
}
"""Range, rotations of the scanner and of the target: five set-ups from near to far."""


def simulated(name, **choices):
    """Points of a patch of a case, and the true lattice at the mean speed of the drive."""
    setup, target = CASES[name]
    cloud, driven = simulate_patch(setup, target, **choices)
    return cloud, scan_lattice(driven, target)


@pytest.fixture(scope="module")
def patches():
    """The five set-ups, 8 patches of 1 m and 4 of 2 m each: a row per patch and quantity."""
    tables = []
    for place, case in enumerate(CASES):
        for size, seed in [(1.0, seed) for seed in range(8)] + [(2.0, seed) for seed in range(4)]:
            own = np.random.SeedSequence([place, round(1000 * size), seed]).generate_state(1)[0]
            cloud, truth = simulated(case, size_m=size, seed=int(own))
            found = measure_pattern(cloud, gps_time=cloud["gps_time"], reference=truth.beam)
            rows = found.to_frame()
            rows["error"] = rows["measured"] - [float(getattr(truth, q)) for q in MEASURED]
            tables.append(rows.assign(case=case, size_m=size, z=rows["error"] / rows["std"]))
    return pd.concat(tables, ignore_index=True)


def lattice(angle, gap, spacing, *, shift=0.3, size=1.0, tilt=0.0):
    """Points of a patch whose profiles rise at an angle from its level line, exactly."""
    i, j = np.meshgrid(np.arange(-400, 401), np.arange(-100, 101))
    along, across = spacing * (i + shift * j).ravel(), (gap * j).ravel()
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    u, v = c * along - s * across, s * along + c * across
    inside = np.maximum(np.abs(u), np.abs(v)) < size / 2
    lean = np.radians(tilt)
    axes = np.array([[0, 1, 0], [np.sin(lean), 0, np.cos(lean)]])
    return np.stack([u, v], axis=1)[inside] @ axes


def test_without_noise_measurement_closes_on_the_prediction():
    still = {"range_noise_m": 0, "angle_noise_deg": 0, "speed_share": 0, "dropout_share": 0}
    for name in CASES:
        cloud, truth = simulated(name, size_m=1.0, seed=1, **still)
        found = measure_pattern(cloud, gps_time=cloud["gps_time"], reference=truth.beam)
        # the lattice changes over the patch: second order of its size over the range
        gap = truth.profile_spacing_perpendicular_m
        assert found.profile_spacing_perpendicular_m == pytest.approx(gap, abs=2e-6)
        assert found.profile_angle_deg == pytest.approx(truth.profile_angle_deg, abs=1e-3)
        assert found.point_spacing_m == pytest.approx(truth.point_spacing_m, abs=2e-6)


@pytest.mark.parametrize(
    ("quantity", "limits"),
    [
        ("profile_spacing_perpendicular_m", [2e-4, 1e-4]),  # 7 profiles in 1 m, 12 m off
        ("point_spacing_m", [5e-5, 5e-5]),
        ("profile_angle_deg", [0.13, 0.03]),
    ],
)
def test_errors_at_5_mm_of_noise(patches, quantity, limits):
    """Root mean squares, on patches of 1 m and of 2 m."""
    rows = patches[patches["quantity"] == quantity]
    rms = np.sqrt((rows["error"] ** 2).groupby([rows["case"], rows["size_m"]]).mean()).unstack()
    assert (rms.max() < limits).all()
    assert (rms.median() < 0.5 * np.array(limits)).all()


@pytest.mark.parametrize("name", MEASURED)
def test_intervals_cover_the_truth_though_the_speed_drifts(patches, name):
    z = patches.loc[patches["quantity"] == name, "z"]
    assert len(z) == 60
    assert np.mean(np.abs(z) < 1.959964) >= 0.86  # 95 % less three standard errors of 60
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.35  # 1.07 for Student's t, +- 0.1


def test_time_and_scan_line_give_the_same():
    cloud, _ = simulated("6 m, 45/20, -10/0", size_m=1.0, seed=1)
    with_time = measure_pattern(cloud, gps_time=cloud["gps_time"])
    with_line = measure_pattern(cloud, scan_line=cloud["scan_line"])
    for name in MEASURED[:4]:
        assert getattr(with_time, name) == pytest.approx(getattr(with_line, name), rel=1e-9)
    assert np.isnan(with_line.point_spacing_m)  # pulses are counted by time


def test_clocks_coarser_than_pulses_give_no_point_spacing():
    cloud, truth = simulated("6 m, 45/20, -10/0", size_m=1.0, seed=5)
    tick = 4 / 125e3
    time = np.floor(cloud["gps_time"] / tick) * tick
    assert np.isnan(pulse_period(time, cloud["scan_line"]))
    found = measure_pattern(cloud, gps_time=time)
    assert np.isnan(found.point_spacing_m)
    gap = truth.profile_spacing_perpendicular_m
    assert found.profile_spacing_perpendicular_m == pytest.approx(gap, abs=1e-4)


@pytest.mark.parametrize(
    ("seconds", "other"), [(0, (-45, 45)), (3, (-45, 45)), (0, (45, -45)), (3, (45, 45))]
)
def test_two_heads_or_drives_in_one_patch_are_refused(seconds, other):
    """One wall scanned by two heads or in two drives, the second some seconds after."""
    heads = CASES["5 m, 45/45"], case_of(300e3, 100, 8, other, (0, 0), (5, 0))
    clouds = [simulate_patch(*head, size_m=1.0, seed=seed)[0] for seed, head in enumerate(heads)]
    points = np.vstack([cloud.points - cloud.points.mean(axis=0) for cloud in clouds])
    times = [cloud["gps_time"] - cloud["gps_time"].min() for cloud in clouds]
    with pytest.raises(ValueError, match=r"one pass of one head|profiles of 3 or more"):
        measure_pattern(points, gps_time=np.concatenate([times[0], times[1] + seconds]))


def test_lines_that_count_every_other_revolution_are_refused():
    cloud, _ = simulated("8 m, 45/45, 15/15", size_m=1.0, seed=1)
    with pytest.raises(ValueError, match="profiles"):
        measure_pattern(cloud, scan_line=cloud["scan_line"] // 2)


def test_missing_revolutions_and_drop_outs_do_not_count(rng):
    points = lattice(35, 0.05, 0.018, size=1.4)
    line = np.round(points[:, 1] * -np.sin(np.radians(35)) / 0.05
                    + points[:, 2] * np.cos(np.radians(35)) / 0.05).astype(int)  # fmt: skip
    kept = ~np.isin(line, [-3, -2, 4]) & (rng.random(len(line)) > 0.2)
    found = measure_pattern(points[kept], scan_line=line[kept])
    assert found.profile_spacing_perpendicular_m == pytest.approx(0.05, abs=1e-9)
    assert found.profiles == len(np.unique(line[kept]))


def test_outliers_are_left_out(rng):
    cloud, truth = simulated("8 m, 45/45, 15/15", size_m=1.0, seed=7)
    dirty = cloud.points.copy()
    stray = rng.random(len(dirty)) < 0.04
    dirty[stray] -= rng.uniform(0.1, 1.0, (stray.sum(), 1)) * [1, 0, 0]  # a hedge before the wall
    found = measure_pattern(dirty, gps_time=cloud["gps_time"])
    assert found.points == pytest.approx((~stray).sum(), rel=0.02)
    gap = truth.profile_spacing_perpendicular_m
    assert found.profile_spacing_perpendicular_m == pytest.approx(gap, abs=2e-4)


def test_nothing_changes_when_the_cloud_is_moved_turned_or_shuffled(rng):
    cloud, _ = simulated("5 m, 45/45", size_m=1.0, seed=2)
    points = np.round(cloud.points * 2**20) / 2**20  # exact when moved by 10,000 km
    line = cloud["scan_line"]
    here = measure_pattern(points, scan_line=line)
    order = rng.permutation(len(points))
    c, s = np.cos(0.7), np.sin(0.7)
    turned = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    far = points + [1e7, -6.5e6, 2048.0]
    for other, lines in ((far, line), (turned, line), (points[order], line[order])):
        there = measure_pattern(other, scan_line=lines)
        for name in MEASURED[:4]:
            assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-6)
            assert there.std[name] == pytest.approx(here.std[name], rel=1e-3)


def test_road_patch_of_two_heads():
    road = read_cloud(samples.path("road_patch"))
    time = road["gps_time"]
    order = np.sort(time)
    first = time <= order[np.argmax(np.diff(order))]
    heads = [measure_pattern(road[part], gps_time=time[part]) for part in (first, ~first)]
    assert [head.profiles for head in heads] == [65, 62]
    crossing = np.degrees(np.arccos(abs(heads[0].direction @ heads[1].direction)))
    assert crossing == pytest.approx(89, abs=0.1)
    with pytest.raises(ValueError, match="Must be one pass of one head"):
        measure_pattern(road, gps_time=time)


@pytest.mark.parametrize("name", ["5 m, 45/45", "12 m, 45/30, -20/30"])
def test_standard_deviations_are_those_of_patches_without_each_block(name):
    """The jackknife by its definition: the patch is measured again without each block."""
    cloud, truth = simulated(name, size_m=0.8, seed=3)
    present, group = np.unique(cloud["scan_line"], return_inverse=True)
    count = min(40, len(present))

    def measured(rows):
        columns = {name: cloud[name][rows] for name in ("gps_time", "scan_line")}
        return measure_pattern(cloud.points[rows], **columns, reference=truth.beam)

    parts = [measured(group * count // len(present) != k) for k in range(count)]
    left = [[getattr(one, quantity) for quantity in MEASURED] for one in parts]
    reach = t.ppf(0.975, count - 1) / 1.959964
    expected = reach * np.sqrt((count - 1) * np.var(left, axis=0))
    # figures without a block are linear here; which points are strays may change with it
    std = measured(np.ones(len(cloud), dtype=bool)).std
    np.testing.assert_allclose(list(std.values()), expected, rtol=0.15)


def test_times_that_are_too_few_or_no_numbers_are_told_apart(rng):
    points = rng.random((60, 3))
    with pytest.raises(ValueError, match=r"gps_time of shape \(59,\)\. Must be one per point, 60"):
        measure_pattern(points, gps_time=np.arange(59.0))
    with pytest.raises(ValueError, match="Invalid gps_time: 2 of 60 not finite"):
        measure_pattern(points, gps_time=np.r_[np.arange(58.0), np.nan, np.inf])


def test_the_jackknife_of_a_mean_is_its_standard_error_widened_to_students_interval(rng):
    values = rng.normal(size=(9, 5)) * [1, 2, 3, 4, 5]
    left = [np.delete(values, k, axis=0).mean(axis=0) for k in range(9)]
    expected = sem(values) * t.ppf(0.975, 8) / 1.96
    assert measure._jackknifed(np.array(left)) == pytest.approx(expected)
    assert np.isnan(measure._jackknifed(np.array(left)[:3])).all()
    assert np.isfinite(measure._jackknifed(np.array(left)[:4])).all()


def test_sums_without_a_block_give_least_squares_without_it(rng):
    terms, values = rng.normal(size=(200, 3)), rng.normal(size=200)
    block = rng.integers(0, 5, 200)
    terms[:, 1] *= 1e5
    found = measure._left_out(terms, values, block)
    assert len(found) == 6
    for k, one in enumerate(found, start=-1):
        rows = block != k
        assert one == pytest.approx(np.linalg.lstsq(terms[rows], values[rows])[0], rel=1e-9)
    level = np.column_stack([terms[:, :2], 1e-12 * terms[:, 2]])  # has no spread beside the others
    assert measure._left_out(level, values, block)[:, 2] == pytest.approx(0)
    offsets, weights = rng.normal(size=(3, 12)), rng.integers(1, 9, (3, 12))
    numbers = np.arange(12) * 2 + 5
    expected = [np.polyfit(numbers, row, 1, w=np.sqrt(w))[0]
                for row, w in zip(offsets, weights, strict=True)]  # fmt: skip
    assert measure._slopes(numbers, offsets, weights) == pytest.approx(expected)


def test_groups_share_slopes_and_have_their_own_constants(rng):
    group = rng.integers(0, 4, 90)
    terms, values = rng.normal(size=(90, 2)), rng.normal(size=90) + group
    found, constants, left = timing.solve_groups(terms, values, group)
    rows = np.column_stack([terms, group[:, None] == np.arange(4)])
    expected = np.linalg.lstsq(rows, values)[0]
    assert [*found, *constants] == pytest.approx(expected)
    assert left == pytest.approx(values - rows @ expected)


def test_a_wavy_lattice_has_its_figures_and_their_errors_vanish(rng):
    """Profiles 4 cm apart at 60 degrees on a wall, points each 15 mm, and its plane turned."""
    lines, pulses = np.meshgrid(np.arange(30), np.arange(-40, 41), indexing="ij")
    turn = np.radians(60)
    along, across = 0.015 * pulses + 0.004 * lines, 0.04 * lines
    u = np.cos(turn) * along - np.sin(turn) * across
    v = np.sin(turn) * along + np.cos(turn) * across
    wall = np.column_stack([np.full(u.size, 5.0), u.ravel(), v.ravel()])
    time = (0.01 * lines + 1e-5 * pulses).ravel()
    order = rng.permutation(len(wall))
    found = measure_pattern(wall[order], gps_time=time[order])
    told = [getattr(found, name) for name in MEASURED]
    sides = 0.04 / np.sin(turn), 0.04 / np.cos(turn)
    assert told == pytest.approx([0.04, *sides, 60, 0.015], rel=1e-7)
    assert [found.profiles, found.points] == [30, len(wall)]
    assert abs(found.direction @ [0, np.cos(turn), np.sin(turn)]) == pytest.approx(1)
    assert np.max([*found.std.values()]) < 1e-6
    table = found.to_frame()
    assert table["n"].tolist() == [30] * 4 + [len(wall)]
    assert table["measured"].tolist() == told


@pytest.mark.parametrize(("beside", "kept"), [(0.9e-4, 480), (1.2e-4, 476)])
def test_points_a_tenth_of_a_millimetre_beside_exact_profiles_are_strays(beside, kept):
    lines, pulses = (one.ravel() for one in np.meshgrid(np.arange(12), np.arange(40)))
    off = np.where((pulses == 20) & (lines % 3 == 0), beside, 0)
    local = np.column_stack([0.02 * pulses, 0.1 * lines + off, 0.0 * off])
    given = np.flatnonzero(lines != 40)
    rows, share = measure._without_strays(local, lines, given)
    assert (len(rows), share) == (kept, kept / 480)
    assert not set(rows) & set(np.flatnonzero(off)) or kept == 480
    few = np.where((lines == 5) & (pulses > 1), 99, lines)  # of two points: no profile
    assert len(measure._without_strays(local, np.where(few == 99, -pulses - 1, few), given)[0]) == (
        kept - 40
    )


@pytest.mark.parametrize("shake", [0.0, 0.2])
def test_periods_and_revolutions_are_those_that_were_driven(shake, rng):
    """A seventh of each revolution is seen, some pulses and revolutions are missing."""
    period, pulse = 0.0125, 3.1e-6
    turn = np.repeat(np.delete(np.arange(60), [7, 8, 20]), 500)
    number = np.tile(np.arange(500) * 1.0, 57)
    kept = rng.random(len(turn)) < 0.8
    time = 4e5 + turn * period + number * pulse
    seen = np.unique(turn[kept], return_inverse=True)[1]
    turn, time = turn[kept], time[kept] + shake * pulse * rng.uniform(-0.5, 0.5, kept.sum())
    since = time - time.min()
    assert timing.mirror_frequency(since) == pytest.approx(80, rel=1e-4)
    assert np.array_equal(timing.revolutions_from_time(time), turn)
    assert timing.pulse_period(since, seen) == pytest.approx(pulse, rel=1e-4)
    order = rng.permutation(len(turn))
    assert timing.pulse_period(since[order], seen[order]) == pytest.approx(pulse, rel=1e-4)
    assert np.isnan(timing.pulse_period(np.floor(since / 3e-6 / 2), seen))


def test_the_longest_pause_goes_over_the_end_of_a_revolution():
    length, middle = timing._longest_pause(np.array([0.3, 0.5, 1.6, 2.7, 3.7]), 0.5)
    phases = np.sort(np.array([0.15, 0.25, 0.8, 0.35, 0.85]))  # pause from .35 to .8
    assert (length, middle) == pytest.approx((0.45, 0.575))
    assert np.diff(phases).max() == pytest.approx(length)
    length, middle = timing._longest_pause(np.array([0.3, 0.4, 0.5]), 1.0)
    assert (length, middle) == pytest.approx((0.8, 0.9))
