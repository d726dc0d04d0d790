"""A part of a surface that stands off the rest is said, and steps of coordinates are no comb."""

import pickle
import re
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from scipy.stats import median_abs_deviation, norm

from mmqa_lab.chart_cloud import chart_polygon, doubts, evaluate_cloud, inside_polygon
from mmqa_lab.chart_cloud.evaluate import outline_on
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import CONSISTENT_SCALE, fit_plane, sigma_mad
from mmqa_lab.rotations import turned


def sill(rng, share):
    """A facade of 4 m x 1.4 m with 10 mm of noise; a share of it at its foot is 6 cm proud."""
    x, y = rng.uniform(0, 1, (2, 6000)) * [[4], [1.4]]
    proud = 0.06 * (y < 1.4 * share)
    return np.stack([x, 0.01 * rng.standard_normal(6000) + proud, y], axis=1)


def test_remarks_are_of_the_points_as_they_were_evaluated(rng):
    points = sill(rng, 0.07)
    read, unread = evaluate_cloud(points), evaluate_cloud(points)
    assert read.remarks
    points[:] = 0  # the caller's own array
    assert pickle.loads(pickle.dumps(unread)).remarks == read.remarks


def test_a_part_that_turns_the_plane_is_said_with_both_figures(rng):
    points = sill(rng, 0.07)
    quality = evaluate_cloud(points)
    (said,) = [one for one in quality.remarks if "turn the plane" in one]
    found = [float(one) for one in re.findall(r"[\d.]+(?= mm)", said)]
    assert found[0] == pytest.approx(quality.sigma_mad_mm, abs=0.06)
    assert found[1] == pytest.approx(10, rel=0.06)
    assert found[1] < 0.9 * found[0]
    assert 0.06 < int(said.split()[0]) / 6000 < 0.08
    turned = np.degrees(np.arccos(abs(quality.plane.normal[1])))
    assert float(re.search(r"by ([\d.]+) degrees", said)[1]) == pytest.approx(turned, rel=0.2)


def test_a_polygon_beside_the_points_says_how_far_the_nearest_is(rng):
    points = sill(rng, 0) + [1e5, 2e5, 300]  # from 0 to 4 m along x
    square = 1e5 + np.array([[6.0, 0, 0], [7, 0, 0], [7, 0, 1], [6, 0, 1]])
    square += [0, 1e5, 300 - 1e5]
    away = np.linalg.norm(points - square.mean(axis=0), axis=1).min()
    with pytest.raises(ValueError, match=f"is {away:.3g} m from its centre"):
        evaluate_cloud(points, polygon=square)


def test_flat_boards_and_few_strays_turn_no_plane(rng):
    boards = [sill(rng, 0)[: 100 + 9 * k] for k in range(60)]
    boards += [board * [1, rng.exponential(), 1] for board in boards]  # of any noise
    for board in boards[::2]:
        board[: len(board) // 200, 1] += 0.2
    said = [one for board in boards for one in evaluate_cloud(board).remarks]
    assert not [one for one in said if "turn the plane" in one]


def test_bins_of_the_histogram_are_multiples_of_the_step(rng):
    points = np.round(sill(rng, 0) * [1, 0.3, 1], 3)  # 3 mm of noise in steps of 1 mm
    figure, axes = plt.subplots(2)
    evaluate_cloud(points).draw_histograms(*axes)
    x, y = axes[1].patches[0].get_xy().T
    counts = y[(np.abs(x) < 4) & (y > 0)]
    assert counts.min() > 0.3 * counts.max()  # no comb
    plt.close(figure)


@pytest.mark.parametrize("noise", [0, 0.005])
def test_a_polygon_across_its_surface_is_refused(rng, noise):
    wall = rng.random((400, 3)) * [1, 0, 1] + noise * rng.standard_normal((400, 3))
    level = [[-0.5, -2, 0.5], [1.5, -2, 0.5], [1.5, 2, 0.5], [-0.5, 2, 0.5]]
    with pytest.raises(ValueError, match=r"Invalid polygon: (89|90) degrees to the surface"):
        evaluate_cloud(wall, polygon=level, thickness=5)


def test_several_beams_of_a_spinning_scanner_are_said_where_intervals_are_given(rng):
    points = np.column_stack([rng.random((400, 2)), 0.003 * rng.standard_normal(400)])
    ring = np.where(points[:, 0] < 0.5, 7, rng.integers(8, 20, 400))
    left = [[0.1, 0.1, 0], [0.45, 0.1, 0], [0.45, 0.9, 0], [0.1, 0.9, 0]]
    beams = len(set(ring))
    found = evaluate_cloud(Cloud(points, {"ring": ring})).remarks
    (said,) = (one for one in found if "beams" in one)
    assert said.startswith(f"The points come from {beams} beams of a spinning scanner: one pass ")
    assert "hold in about half of the passes, not in 95 %" in said
    for cloud, polygon in (
        (points, None),
        (Cloud(points), None),
        (Cloud(points, {"ring": 0 * ring}), None),
        (Cloud(points, {"ring": ring}), left),  # of one beam alone
        (Cloud(points[:40], {"ring": ring[:40]}), None),  # has no intervals
    ):
        assert not any("beams" in one for one in evaluate_cloud(cloud, polygon=polygon).remarks)


@pytest.mark.parametrize("axis", [2, 1])
def test_steps_of_the_axis_across_a_surface_decide_its_noise(rng, axis):
    """Heights of a text in centimetres, plan in millimetres: the noise of a level surface alone."""
    points = np.insert(rng.random((3000, 2)), axis, rng.normal(0, 0.003, 3000), axis=1)
    points = np.round(points * 1000) / 1000 + [452_000, 5_411_000, 300]
    fine = evaluate_cloud(points)
    assert "sigma_MAD" not in " ".join(fine.remarks)
    points[:, axis] = np.round(points[:, axis], 2)
    coarse = evaluate_cloud(points)
    words = "Coordinates are in steps of 10 mm: too coarse for sigma_MAD"
    assert coarse.remarks[0].startswith(words)
    assert "d1" not in coarse.remarks[0]  # the distances within the surface are as before
    assert not [one for one in coarse.remarks if "stand off" in one or "layers" in one]
    assert coarse.step_mm == pytest.approx(1)
    assert coarse.d1_mm == pytest.approx(fine.d1_mm, rel=0.01)


@pytest.mark.parametrize(
    ("share", "step_mm", "times", "off"),
    [(0.05, 0, 4.15, False), (0.05, 0, 4.4, True), (0.008, 0, 20, False), (0.012, 0, 20, True),
     (0.29, 0, 20, True), (0.31, 0, 20, False), (0.05, 9, 17, False), (0.05, 9, 19, True)],
)  # fmt: skip
def test_what_stands_off_is_told_by_sigmas_by_its_share_and_by_steps(share, step_mm, times, off):
    """Quantiles of a normal distribution about 2 m, some farther: with 5 % sigma is 6 % more."""
    n = 4000
    x, y = np.random.default_rng(2).uniform(0, 4, (2, n))
    quantiles = norm.ppf((np.random.default_rng(3).permutation(n) + 0.5) / n)
    z = 2 + 0.001 * np.clip(quantiles, -3, 3)
    part = np.arange(n) < share * n
    spread = sigma_mad(z[~part])  # about as of all
    z[part] = 2 + np.where(np.arange(n) % 2, 1, -1)[part] * times * (0.001 if step_mm else spread)
    mask, plane = doubts.part_off(np.column_stack([x, y, z]), CONSISTENT_SCALE, step_mm)
    assert (plane is not None) == off
    assert mask.sum() == (part.sum() if off else 0)
    if off:
        assert np.array_equal(mask, part)
        assert plane.n == n - part.sum()


def test_what_stands_off_counts_from_the_median_of_the_distances(rng):
    """Most points lie exactly in a plane, a quarter up to 2 mm above: their median is not zero."""
    points = np.column_stack([rng.uniform(0, 4, (2, 3000)).T, 0.002 * rng.random(3000) ** 4])
    points[:150, 2] += 0.02
    away = fit_plane(points, robust=True).distances(points)
    expected = np.abs(away - np.median(away)) > 4 * sigma_mad(away)
    mask, _ = doubts.part_off(points, CONSISTENT_SCALE)
    assert np.array_equal(mask, expected)
    assert np.count_nonzero(np.abs(away + np.median(away)) > 4 * sigma_mad(away)) != mask.sum()


def test_a_part_is_said_with_the_turn_of_the_plane_and_both_sigmas(rng):
    points = sill(rng, 0.1)
    plane = fit_plane(points)
    mask, without = doubts.part_off(points, CONSISTENT_SCALE)
    turn = np.degrees(np.arccos(plane.normal @ without.normal))
    both = [1000 * sigma_mad(one.residuals) for one in (plane, without)]
    local = np.column_stack([plane.project(points), plane.residuals])
    (said,) = doubts._part(local, CONSISTENT_SCALE, 0.0)
    assert said == (
        f"{mask.sum()} points ({100 * mask.mean():.2g} %) stand off the others and turn the plane "
        f"by {turn:.2g} degrees: sigma_MAD is {both[0]:.1f} mm with them, {both[1]:.1f} mm without."
    )
    points = sill(rng, 0.02)
    plane = fit_plane(points)
    without = doubts.part_off(points, CONSISTENT_SCALE)[1]
    assert 1 < sigma_mad(plane.residuals) / sigma_mad(without.residuals) < 1.1  # misleads little
    local = np.column_stack([plane.project(points), plane.residuals])
    assert doubts._part(local, CONSISTENT_SCALE, 0.0) == ()


@pytest.mark.parametrize(("bow_mm", "bent"), [(1.85, False), (2.15, True)])
def test_a_surface_is_bent_from_half_of_the_variance(bow_mm, bent, rng):
    x, y = rng.uniform(-1, 1, (2, 4000)) * [[3], [1]]
    bow = (x - y) ** 2 - x
    height = bow_mm / 2 * (bow - bow.mean()) / bow.std() + rng.permutation(
        norm.ppf((np.arange(4000) + 0.5) / 4000)
    )
    terms = np.column_stack([x**i * y**j for i in range(3) for j in range(3 - i)])
    rest = height - terms @ np.linalg.lstsq(terms, height)[0]
    share, block = 1 - rest.var() / height.var(), np.zeros(4000, int)
    said = doubts._form(np.column_stack([x, y]), height, block, 0.0, CONSISTENT_SCALE)
    sigma = 1.482602218505602 * median_abs_deviation(rest)
    told = f"The surface is bent: its form is {100 * share:.0f} % of the variance of the "
    told += f"distances. Without it sigma_MAD is {sigma:.1f} mm."
    assert list(said) == [told] * bent
    for step, known in ((3.9 * np.std(height), bent), (4.1 * np.std(height), False)):
        found = doubts._form(np.column_stack([x, y]), height, block, step, CONSISTENT_SCALE)
        assert bool(found) == known
    assert doubts._form(np.column_stack([x, y])[:40], height[:40], block[:40], 0, 1.0) == []


@pytest.mark.parametrize(("high_mm", "told"), [(0.7, False), (1.2, True), (4.0, True)])
def test_a_stepped_surface_is_said_with_its_noise_within_blocks(high_mm, told, rng):
    block = np.repeat(np.arange(16), 100)
    xy = np.column_stack([block % 4 + rng.random(1600), block // 4 + rng.random(1600)])
    noise = rng.normal(size=1600)
    height = noise + high_mm * np.where((block % 4 + block // 4) % 2, 1, -1.0)
    said = doubts._form(xy, height, block, 0.0, CONSISTENT_SCALE)
    assert bool(said) == told
    if told:
        means = pd.Series(height).groupby(block).transform("mean")
        within = 1.482602218505602 * median_abs_deviation(height - means) * np.sqrt(1600 / 1584)
        assert said[0].endswith(f"Within 16 blocks sigma_MAD is {within:.1f} mm.")


@pytest.mark.parametrize(
    ("first", "between", "second", "told"),
    [(1000, 475, 1000, True), (1000, 520, 1000, False), (60, 27, 60, True), (60, 31, 60, False),
     (1000, 0, 55, True), (1000, 0, 50, False), (50, 0, 51, True), (49, 0, 50, False)],
)  # fmt: skip
def test_layers_are_two_peaks_with_a_dip_of_half_and_not_by_chance(first, between, second, told):
    """Bins of 3 mm, one and a half steps: two are full, 18 mm apart, and five between are less."""
    counts = [first, *[between] * 5, second]
    heights = np.concatenate([3 * k + 3 * (np.arange(n) + 0.5) / n for k, n in enumerate(counts)])
    assert np.std(heights) < 12  # a quarter of it is no wider bin
    said = doubts._layers(heights, 2.0)
    assert bool(said) == told
    if told:
        a, b = map(int, re.findall(r"(-?\d+) (?:and|mm)", said[0]))
        assert (a, b) == pytest.approx((1.5, 19.5), abs=0.6)
        assert doubts._layers(heights, 3.6) == []  # the bins are too wide


def test_uneven_points_are_said_with_the_densities_of_blocks():
    """16 blocks of 100 places on 8 m2 have 20 to 95 points, two are hardly in the outline."""
    of, n = [100] * 14 + [40, 60], [*range(20, 90, 5), 500, 95]
    block = np.concatenate([np.repeat(np.arange(16), of), np.repeat(np.arange(16), n)])
    places = sum(of)
    density = np.delete(np.divide(n, of), 14) * places / 8
    low, high = np.percentile(density, [10, 90])
    said = f"Points are uneven: {low:.0f} per m2 in the sparse tenth, {high:.0f} in the dense one."
    assert doubts._uneven(block, places, 8.0) == (said,) * bool(high > 3 * low)
    assert high > 3 * low
    level = np.concatenate(
        [np.repeat(np.arange(16), 100), np.repeat(np.arange(16), [20] * 8 + [58] * 8)]
    )
    assert doubts._uneven(level, 1600, 8.0) == ()  # 2.9 times
    few = np.repeat(np.arange(16), [5] * 8 + [44] * 8)
    for more, told in ((0, False), (8, True)):  # from 25 points a block on
        given = np.concatenate([np.repeat(np.arange(16), 100), few, np.zeros(more, int)])
        assert bool(doubts._uneven(given, 1600, 8.0)) == told


@pytest.mark.parametrize("has_polygon", [True, False])
@pytest.mark.parametrize(("empty", "told"), [(19, False), (21, True)])
def test_gaps_are_said_from_a_fiftieth_of_places_farther_than_four_medians(
    empty, told, has_polygon
):
    away = np.concatenate(
        [np.full(1000 - empty - 100, 0.01), np.full(100, 0.039), np.full(empty, 0.041)]
    )
    for within, ends in ((0.03, True), (0.0389, False)):
        said = doubts._gaps(SimpleNamespace(distances=away, e95=within), has_polygon)
        assert len(said) == told * (1 + (ends if has_polygon else 1))
        if told:
            what = "polygon" if has_polygon else "hull of the points"
            assert said[0].startswith(f"2 % of the {what} lies more than 40 mm from any point")
        if told and has_polygon and ends:
            assert "e95 is 39 mm" in said[1]


def test_limits_of_steps_pairs_turns_and_chance():
    assert [doubts.is_coarse(d1, 1.0) for d1 in (4.9, 5.1)] == [True, False]
    assert [doubts.is_coarse(0.0, step) for step in (0.0011, 0.0009)] == [True, False]
    assert doubts.is_below_step([4.9, 5.1], 10).tolist() == [True, False]
    assert [doubts.of_pairs(1.0, d2)[0] for d2 in (4.9, 5.1)] == [False, True]
    assert doubts.of_pairs(2.0, 14.0)[1]().startswith("d2 is 7 times d1")
    assert [doubts.of_turns(beams)[0] for beams in (1, 2)] == [False, True]
    assert doubts.of_copies(3, 400).startswith("3 points (0.75 %) share")
    # across the surface a step counts as such from four of those along it
    assert not doubts.of_steps(1.0, 3.5, 100.0, 3.9)[0]
    assert doubts.of_steps(1.0, 3.5, 100.0, 4.1)[0] == ["sigma_MAD 3.5 mm"]
    assert doubts.of_steps(1.0, 0.9, 4.9, 1.0)[0] == ["sigma_MAD 0.9 mm", "d1 4.9 mm"]
    assert "in steps of 4.1 mm: too coarse for sigma_MAD" in doubts.of_steps(1.0, 3.5, 100, 4.1)[1]
    assert not doubts.of_steps(9e-4, 1e-4, 1e-3, 9e-4)[0]
    ways = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    for wide, alike in ((1.09, True), (1.11, False)):
        xy = ways * [wide**0.5, 1] @ turned(z=30)[:2, :2].T
        assert doubts.is_by_chance(xy, "principal") == alike
        assert not doubts.is_by_chance(xy, "horizontal")


def test_the_outline_of_a_chart_lies_within_its_corners_as_a_stretched_square(rng):
    """Corners of a board that is no rectangle: its square in the plane is mapped bilinearly."""
    corners = np.array([[5.0, 1, 2], [7, 1.5, 2.2], [7.2, 1.5, 4], [4.8, 1, 3.4]])
    margins = 0.3, 0.5, 0.1, 0.2  # lower, right, upper, left
    wide, high = (np.linalg.norm(corners[k] - corners[0]) for k in (1, 3))
    u, v = np.array([0.2, wide - 0.5]) / wide, np.array([0.3, high - 0.1]) / high
    expected = []
    for s, t in ((u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1])):
        low, top = (
            corners[0] + s * (corners[1] - corners[0]),
            corners[3] + s * (corners[2] - corners[3]),
        )
        expected.append(low + t * (top - low))
    flat = chart_polygon(corners, margins=margins)
    assert flat == pytest.approx(np.array(expected))
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert chart_polygon(square, margins=0.25)[:, :2] == pytest.approx(square[:, :2] / 2 + 0.25)
    for none in ((0, 0.5, 0, 0.5), (0.5, 0, 0.5, 0), (-0.1, 0, 0, 0)):
        with pytest.raises(ValueError, match=r"Must be >= 0 m and leave some of the chart\."):
            chart_polygon(square, margins=none)
    chart_polygon(square, margins=(0.4, 0.5, 0.5, 0.4))


def test_a_polygon_aside_of_its_plane_is_projected_along_its_own_normal():
    square = np.array([[0.0, 0, 3], [2, 0, 3], [2, 1, 3], [0, 1, 3]])
    for degrees in (0, 30, 59):
        tilt = np.radians(degrees)
        plane = fit_plane(square @ turned(x=degrees).T)
        outline = outline_on(square, plane, np.array([0, 0, 1.0]))
        assert outline.area == pytest.approx(2 / np.cos(tilt))
        where = outline.centroid.coords[0] @ plane.axes + plane.centre
        assert where[:2] == pytest.approx([1, 0.5])
    with pytest.raises(ValueError, match="Invalid polygon: 61 degrees to the surface"):
        outline_on(square, fit_plane(square @ turned(x=61).T), np.array([0, 0, 1.0]))


@pytest.mark.parametrize(("off_mm", "known"), [(98, True), (102, False)])
def test_points_are_selected_within_the_thickness_and_vertices_within_its_half(off_mm, known):
    """Two vertices up and two down: each is as far from the plane of all."""
    twisted = np.array([[0.0, 0, 1], [1, 0, -1], [1, 1, 1], [0, 1, -1]]) * [1, 1, off_mm / 1000]
    points = np.array([[0.5, 0.5, z] for z in (-0.21, -0.19, 0.19, 0.21)])
    if known:
        assert inside_polygon(points, twisted, thickness=0.2).tolist() == [False, True, True, False]
    else:
        with pytest.raises(ValueError, match=r"a vertex is 102 mm off .* at most 100 mm"):
            inside_polygon(points, twisted, thickness=0.2)
