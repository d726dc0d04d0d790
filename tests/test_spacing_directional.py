"""Measures of anisotropy: known lattices, a brute force, turns and shifts."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import stats
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.spacing import block_numbers, directional, line_parts, quadrants, turned_f
from mmqa_lab.stats import WAVE_PARTS
from mmqa_lab.studies.anisotropy import pair_contrast, structure_tensor


def pattern(kind, seed=1, **choices):
    """About 900 points."""
    return point_pattern(kind, **{"density": 2500, "size": 0.6, "seed": seed, **choices})


def expected_g(kind, ratio):
    """Closed form: the nearer neighbouring line, moved by the smaller of two uniform numbers."""
    forms = {"lattice": ratio, "poisson": 1.0}
    forms["scan_lines"] = np.hypot(ratio, (1 - np.sqrt(1 / 2)) / 2)
    return (forms | {"hexagonal": np.hypot(0.5, np.sqrt(0.75) * ratio)})[kind]


def medians_by_brute_force(xy):
    """The median nearest distance within 30 degrees of 0, 4, ..., 176, pair by pair."""
    offsets = xy[None] - xy[:, None]
    distance = np.linalg.norm(offsets, axis=2)
    distance[distance == 0] = np.inf
    step = np.round(np.degrees(np.arctan2(offsets[..., 1], offsets[..., 0])) / 4)
    apart = [np.abs((step - k + 22) % 45 - 22) for k in range(45)]
    return [np.median(np.where(a <= 7, distance, np.inf).min(axis=1)) for a in apart]


@pytest.mark.parametrize("kind", ["lattice", "hexagonal"])
@pytest.mark.parametrize("ratio", [1.5, 4, 12])
def test_lattices(kind, ratio):
    found = directional(pattern(kind, ratio=ratio, angle=35, size=1))
    assert found.g == pytest.approx(expected_g(kind, ratio))
    assert found.direction_deg == pytest.approx(35, abs=2.1)  # half a step of the directions


def test_scan_lines_have_their_closed_form():
    choices = {"ratio": 5, "angle": 20, "size": 1, "jitter": 0}
    seen = [directional(pattern("scan_lines", s, **choices)).g for s in range(12)]
    error = np.std(seen, ddof=1) / np.sqrt(len(seen))
    assert abs(np.mean(seen) - expected_g("scan_lines", 5)) < 3 * error


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_chance_in_random_patterns_goes_with_the_root_of_n(size):
    seen = [directional(pattern("poisson", s, size=size)).g for s in range(30)]
    chance = (np.mean(seen) - expected_g("poisson", 1)) * np.sqrt(2500) * size
    # 1.6 in the docstring; 30 patterns know it to 3 x 0.9 / sqrt(30) = 0.5
    assert chance == pytest.approx(1.6, abs=0.5)


@pytest.mark.parametrize("angle", [0, 0.01, 10, 45, 89])
def test_g_of_noisy_lines_does_not_know_the_axes_and_f_does(angle):
    xy = pattern("scan_lines", ratio=15, angle=angle, noise=0.0005, size=1)
    found = directional(xy)
    # noise and jitter shorten the spacing along by a tenth
    assert found.g == pytest.approx(15, rel=0.15)
    assert (found.direction_deg - angle + 90) % 180 - 90 == pytest.approx(0, abs=2)
    aligned = min(angle, 90 - angle) < 1
    assert (quadrants(xy).f < 8) == aligned


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), count=st.integers(2, 120), flat=st.sampled_from([0.01, 0.3, 1]))
def test_directional_equals_brute_force(seed, count, flat):
    xy = np.random.default_rng(seed).random((count, 2)) * [0.3, 0.3 * flat]
    expected = np.array(medians_by_brute_force(xy))
    found = directional(xy, radius=10).spacing
    assert found == pytest.approx(np.where(np.isinf(expected), np.nan, expected), nan_ok=True)


def test_turn_and_shift():
    xy = pattern("clusters", ratio=3)
    before = directional(xy)
    turn = np.radians(36)
    c, s = np.cos(turn), np.sin(turn)
    turned = directional(xy @ np.array([[c, s], [-s, c]]))
    assert turned.g == pytest.approx(before.g, rel=1e-9)
    assert (turned.direction_deg - before.direction_deg) % 180 == pytest.approx(36)
    # 10,000 km leave nanometres of a double: medians follow within that
    far = directional(xy + [1e7, -1e7])
    assert far.spacing == pytest.approx(before.spacing, abs=1e-8)


def test_intervals_of_scan_lines_cover_the_closed_form():
    """95 % of 80 windows, or 70 with three standard errors; 20 degrees is a direction tried."""
    choices = {"ratio": 3, "angle": 20, "size": 1, "jitter": 0.2}
    found = [directional(pattern("scan_lines", seed, **choices)) for seed in range(80)]
    low, high = np.array([one.intervals()[["low", "high"]].to_numpy()[2] for one in found]).T
    truth = np.mean([one.g for one in found])  # jitter shortens the spacing along
    assert 70 <= ((low <= truth) & (truth <= high)).sum() <= 80
    assert (high / low < 1.1).all()
    assert found[0].to_frame()["figure"].tolist() == ["along", "across", "g"]


def test_repeated_points_count_once():
    xy = pattern("poisson")
    repeated = directional(np.concatenate([xy, xy[:300]]))
    assert repeated.n == len(xy)
    assert repeated.g == directional(xy).g


def test_not_measurable_is_nan():
    one_line = np.stack([np.arange(20) * 0.01, np.zeros(20)], axis=1)
    found = directional(one_line)
    assert found.along == pytest.approx(0.01)
    assert np.isnan(found.g)
    assert np.isnan(directional([[0, 0], [3, 0]]).g)


def test_turned_f_equals_turned_points():
    xy = pattern("scan_lines", ratio=4, angle=12)
    turn = np.radians(-30)
    c, s = np.cos(turn), np.sin(turn)
    by_hand = quadrants(xy @ np.array([[c, s], [-s, c]])).f
    assert turned_f(xy, angles=[0, 30]) == pytest.approx([quadrants(xy).f, by_hand])


def test_structure_tensor_sees_lines_only_when_it_sees_one():
    assert structure_tensor(pattern("scan_lines", ratio=20, noise=1e-5)) > 100
    assert structure_tensor(pattern("scan_lines", ratio=5)) < 1.5
    assert structure_tensor(pattern("poisson")) == pytest.approx(1.3, abs=0.15)


def test_pair_contrast_of_one_line_and_of_none():
    assert pair_contrast(pattern("scan_lines", ratio=10, noise=1e-5)) > 0.99
    assert abs(pair_contrast(pattern("poisson", size=1))) < 0.05
    assert np.isnan(pair_contrast(np.array([[0, 0], [3, 1]])))


@pytest.mark.parametrize("degrees", [0, 20, 77])
def test_waves_have_whole_lines_whatever_their_direction(degrees):
    x, y = np.meshgrid(np.arange(120) * 0.005, np.arange(24) * 0.02)
    turn = np.radians(degrees)
    c, s = np.cos(turn), np.sin(turn)
    xy = np.column_stack([x.ravel(), y.ravel()]) @ np.array([[c, s], [-s, c]])
    across, along = line_parts(xy).reshape(2, 24, 120)
    assert np.ptp(across, axis=1).max() <= WAVE_PARTS // 24 + 1  # a line is a 24th of the points
    assert np.ptp(along, axis=1).min() >= 0.98 * WAVE_PARTS - 1
    assert len(line_parts(np.random.default_rng(1).random((500, 2)))) == 4  # no direction
    assert line_parts(xy[:20]).tolist() == 20 * [0]


def test_parts_of_lines_follow_a_direction_that_is_no_chance(rng):
    xy = rng.random((400, 2))
    for g, ways in ((1.15, 4), (1.17, 2)):  # 1 + 3.2 / 20
        found = SimpleNamespace(n=400, g=g, direction_deg=30.0)
        parts = line_parts(xy, found)
        assert len(parts) == ways
        expected = [(30.0,), (0, 45)][ways == 4]
        for k, turn in enumerate(expected):
            assert np.array_equal(parts[2 * k : 2 * k + 2], stats.order_parts(xy, turn))
    for n, told in ((49, False), (50, True)):
        assert (line_parts(xy[:n]).ndim == 2) == told
        found = SimpleNamespace(n=n, g=9.0, direction_deg=0.0)
        assert (line_parts(xy, found).ndim == 2) == told
    assert line_parts(np.zeros((90, 2))).tolist() == [0] * 90


def test_blocks_are_squares_of_the_extent(rng):
    xy = rng.uniform(-7, 9, (300, 2)) * [1, 0.2]
    for side in (2, 4, 5):
        share = (xy - xy.min(axis=0)) / np.ptp(xy, axis=0)
        expected = np.minimum(np.floor(share * side), side - 1) @ [side, 1]
        assert np.array_equal(block_numbers(xy, side=side), expected)
    assert block_numbers([[3, 0], [3, 1], [3, 2]], side=2).tolist() == [0, 1, 1]


def test_intervals_of_directions_are_those_of_their_medians(rng):
    found = directional(rng.random((300, 2)) * [1, 4])
    at = round(found.direction_deg / 4) % 45
    along = found.nearest[:, at]
    across = found.nearest[:, round((found.direction_deg + 90) / 4) % 45]
    parts = line_parts(found.xy, found)
    table = found.intervals().set_index("figure")
    for name, values in (("along", along), ("across", across)):
        ends = 1000 * np.array(stats.median_interval(values, parts))
        assert table.loc[name, ["low", "high"]].tolist() == pytest.approx(ends)
        assert table.loc[name, "unit"] == "mm"
    ends = stats.median_ratio_interval(across, along, parts)
    assert table.loc["g", ["low", "high"]].tolist() == pytest.approx(ends)
    assert table.loc["g", "value"] == pytest.approx(found.across / found.along)
    turned = found.at(found.direction_deg + 180)
    assert turned == pytest.approx(found.at(found.direction_deg))
    low, high = found.spacing[[10, 11]]
    assert found.at(41.0) == pytest.approx(0.75 * low + 0.25 * high)
