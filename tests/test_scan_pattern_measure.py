"""Measured scan patterns: exact ones, simulated ones with their truth, and real ones."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

from mmqa_lab import samples
from mmqa_lab.io import read_cloud
from mmqa_lab.scan_pattern import (
    ScanSetup,
    Target,
    measure_pattern,
    scan_lattice,
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
