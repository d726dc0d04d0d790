"""Charts in photographs by a camera of the tests' own: found, placed and read, or doubted."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from camera import CONDITIONS, linear, shoot
from rendered import step_seen_by_pixel

from mmqa_lab import chart_image, charts
from mmqa_lab.chart_image import align, alignment
from mmqa_lab.studies.chart_images import photo_case

CHART = charts.imaging_chart()

HALF = charts.Layout("half", 1000.0, 1000.0, (charts.Bar("half", 500.0, 0.0, 500.0, 1000.0),))
"""A chart of one edge."""

PLACES = np.stack(np.meshgrid(np.linspace(60, 940, 7), np.linspace(60, 940, 7)), -1).reshape(-1, 2)


@pytest.fixture(scope="module")
def plain():
    """A photograph that nothing speaks against, and what is read of it."""
    return seen(4.0)


def seen(pixel_mm, **changes):
    """A photograph of the chart, and what is read of it."""
    shot = shoot(CHART, pixel_mm, seed=2, **changes)
    there = chart_image.locate(grey(shot.image), CHART)
    return shot, chart_image.evaluate_image(shot.linear, CHART, there)


def grey(image):
    """One grey image of what a file holds."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def away(shot, chart_map):
    """Distances of a map from the truth all over the chart, pixels."""
    return np.linalg.norm(chart_map.pixels(PLACES) - shot.pixels(PLACES), axis=1)


def test_the_camera_blurs_as_its_lens_says():
    sigma = 0.8
    # an upright edge without noise beside the step behind a Gaussian and a pixel
    shot = shoot(HALF, 5.4, seed=1, mono=True, margin=0.15, blur=sigma)
    ends = shot.pixels(np.array([[500.0, 300.0], [500.0, 700.0]]))
    rows = np.arange(int(ends[1, 1]) + 1, int(ends[0, 1]))
    places = np.interp(rows, ends[::-1, 1], ends[::-1, 0])
    columns = np.round(places).astype(int)[:, None] + np.arange(-5, 6)
    light = shot.scene.white - shot.scene.black
    seen = (shot.scene.white - shot.clean[rows[:, None], columns]) / light
    expected = step_seen_by_pixel(columns - places[:, None], sigma)
    assert np.abs(seen - expected).max() < 0.02


@pytest.mark.parametrize(
    ("name", "pixel_mm"),
    [("base", 11.0), ("oblique 50", 8.0), ("shadow 75, two", 8.0), ("phone", 4.0)],
)
def test_charts_are_found_placed_and_read_without_corners(name, pixel_mm):
    shot = shoot(CHART, pixel_mm, seed=1, **CONDITIONS[name])
    there = chart_image.locate(grey(shot.image), CHART)
    quality = chart_image.evaluate_image(shot.linear, CHART, there)
    assert np.median(away(shot, quality.chart_map)) < 0.2
    for direction in "hv":
        found = quality.resolution(direction).width_mm
        assert abs(shot.steps(CHART, found, direction)) <= 1
    for row in quality.sizes.dropna(subset=["length_px"]).itertuples():
        truth = shot.length(CHART[row.name])
        assert abs(row.length_px - truth) < 4 * row.length_sigma_px


def test_shadow_moves_nothing():
    # the same light without and with a shadow over half of the chart
    plain, shaded = (
        shoot(CHART, 5.4, seed=2, **CONDITIONS[name]) for name in ("base", "shadow 75")
    )
    there = chart_image.locate(None, CHART, corners=plain.pixels(CHART.corners()) + 1.0)
    one, two = (align(shot.linear, CHART, there) for shot in (plain, shaded))
    assert np.abs(one.pixels(PLACES) - two.pixels(PLACES)).max() < 0.15


def test_what_a_pole_hides_is_called_hidden():
    shot = shoot(CHART, 4.0, seed=0, **CONDITIONS["pole"])
    there = chart_image.locate(grey(shot.image), CHART)
    quality = chart_image.evaluate_image(shot.linear, CHART, there)
    hidden = quality.pairs[quality.pairs["reason"] == "hidden"]["name"].tolist()
    # the pole stands from 470 to 530 mm
    for name in hidden:
        assert CHART[name].x < 530
        assert CHART[name].x + CHART[name].width > 470
    assert "pairs_h_40" in hidden
    assert "hidden: pairs_h_40" in quality.to_frame()["remarks"].item()


def test_a_display_curve_taken_for_light_is_doubted():
    shot = shoot(CHART, 5.4, seed=3, mono=True)
    there = chart_image.locate(None, CHART, corners=shot.pixels(CHART.corners()))
    right = chart_image.evaluate_image(linear(shot.image), CHART, there)
    wrong = chart_image.evaluate_image(shot.image / 255.0, CHART, there)
    linear_taken_for_srgb = chart_image.evaluate_image(linear(255 * shot.linear), CHART, there)
    assert "gamma" not in right.to_frame()["remarks"].item()
    for doubtful in (wrong, linear_taken_for_srgb):
        assert "is gamma right?" in doubtful.to_frame()["remarks"].item()


def test_texts_of_a_turned_photograph_are_upright():
    shot = shoot(CHART, 4.0, seed=1)
    image, corners = shot.linear, shot.pixels(CHART.corners())
    there = chart_image.locate(None, CHART, corners=corners)
    corners = np.column_stack([corners[:, 1], image.shape[1] - 1 - corners[:, 0]])
    image = np.rot90(image)
    turned = chart_image.locate(None, CHART, corners=corners)
    one = chart_image.text_crops(shot.linear, CHART, there)
    two = chart_image.text_crops(image, CHART, turned)
    assert len(one) == len(two) > 5
    for upright, other in zip(one, two, strict=True):
        rows, columns = (min(pair) for pair in np.stack([upright.image.shape, other.image.shape]).T)
        pair = [crop.image[:rows, :columns].ravel() for crop in (upright, other)]
        assert np.corrcoef(*pair)[0, 1] > 0.97


BEHIND = {
    # what stands before the chart: patterns that are named, or a bar
    "beam over 44 % of a row": ({"strips": ((1, 820.0, 17.6),)}, "hidden: pairs_h_20", 30.0),
    "post on a standing bar": (
        {"strips": ((0, 150.0, 30.0),), "yaw": 25},
        "an end is not seen where the map has it: bar_left",
        20.0,
    ),
    "beam on the ends of both bars": (
        {"strips": ((1, 100.0, 15.0),), "yaw": 30, "pitch": 10},
        "an end is not seen where the map has it: bar_left, bar_right",
        20.0,
    ),
    "nothing": ({}, "", 20.0),
}


@pytest.mark.parametrize("name", BEHIND)
def test_what_is_hidden_is_said_and_moves_no_figure(name, plain):
    changes, remark, coarsest = BEHIND[name]
    shot, quality = seen(5.4, **changes) if changes else plain
    said = "; ".join(quality.remarks)
    assert remark in said
    assert remark or not said
    assert quality.resolution("h").width_mm <= coarsest
    for direction in "hv":
        bars = [CHART[one] for one in quality.sizes.query("direction == @direction")["name"]]
        truth = sum(max(bar.width, bar.height) for bar in bars) / sum(map(shot.length, bars))
        size, sigma = quality.pixel_size(direction)
        assert abs(size - truth) < 2 * sigma  # the other bar alone is off by .6 % and more
        assert sigma < 0.01 * size
        unseen = quality.sizes.query("direction == @direction")["pixel_mm"].isna().any()
        assert not unseen or sigma * shot.length(bars[0]) > 0.5 * size  # half a pixel of the length


def test_a_leaf_on_one_pattern_alone_costs_no_finer_one(plain):
    """The white around the pattern is free, so only finer patterns tell that it is hidden."""
    shot, open_view = plain
    image = shot.linear.copy()
    leaf = shot.pixels(CHART["pairs_h_30"].corners()).round().astype(np.int32)
    cv2.fillPoly(image, [leaf], (float(np.median(image)),) * 3)
    quality = chart_image.evaluate_image(image, CHART, open_view.chart_map)
    assert quality.remarks == ("hidden: pairs_h_30, by a thing, glare or a shadow's edge",)
    assert quality.resolution("h") == open_view.resolution("h")
    assert quality.resolution("h").width_mm < 30


FENCES = {
    "wires": (6.0, tuple((0, x, 5.0) for x in range(20, 1000, 50))),
    "mesh": (4.0, tuple((axis, x, 5.0) for axis in (0, 1) for x in range(30, 1000, 100))),
    "bars": (5.0, tuple((0, x, 20.0) for x in range(30, 1000, 200))),
}
"""Pixel sizes, mm, and what hides about 20 % of a chart."""


@pytest.mark.parametrize("name", FENCES)
def test_a_chart_behind_a_fence_is_found_and_what_it_hides_is_said(name):
    pixel_mm, strips = FENCES[name]
    shot = shoot(CHART, pixel_mm, seed=100, margin=0.3, strips=strips)
    there = chart_image.locate(grey(shot.image), CHART)
    quality = chart_image.evaluate_image(shot.linear, CHART, there)
    assert np.median(away(shot, quality.chart_map)) < 0.4
    assert "hidden: " in "; ".join(quality.remarks)
    off = [row.length_px - shot.length(CHART[row.name]) for row in quality.sizes.itertuples()]
    assert (np.abs(off) < 2.5 * quality.sizes["length_sigma_px"]).all()


@pytest.mark.parametrize("condition", ["blur 2", "motion 4", "base"])
def test_blur_does_not_change_the_pixel_size(condition):
    """The chart's edges bleed into what is around; sharp ones give an interval a third as wide."""
    for seed in (1, 2, 3):
        shot = shoot(CHART, 2.7, seed=seed, margin=0.15, **CONDITIONS[condition])
        there = chart_image.locate(None, CHART, corners=shot.pixels(CHART.corners()) + 0.5)
        quality = chart_image.evaluate_image(shot.linear, CHART, there)
        sizes = quality.sizes.set_index("name")
        off = sizes["length_px"] - [shot.length(CHART[name]) for name in sizes.index]
        assert (off.abs() < 1.96 * sizes["length_sigma_px"]).all()
        assert off.abs().max() < 0.08  # 0.17 with the edges
        if seed == 1 and condition == "base":
            assert sizes["length_sigma_px"].max() < 0.5 * quality.residual_px


@pytest.mark.parametrize("blur", [1.0, 1.5, 2.0, 2.5])
def test_bars_of_several_photographs_are_neither_long_nor_short(blur):
    """Greys that are printed darker than a chart says must not turn blur into length."""
    off, sigma = [], []
    for seed in (1, 2, 3, 4):
        shot = shoot(CHART, 2.7, seed=seed, margin=0.15, blur=blur)
        there = chart_image.locate(None, CHART, corners=shot.pixels(CHART.corners()) + 0.5)
        sizes = chart_image.evaluate_image(shot.linear, CHART, there).sizes
        off.append(sizes["length_px"] - [shot.length(CHART[name]) for name in sizes["name"]])
        sigma.append(sizes["length_sigma_px"].max())
    # with greys as the chart says: 0.018, 0.024, 0.047 and 0.2 px
    assert np.sqrt(np.mean(np.square(off))) < 0.017
    assert np.abs(np.mean(off, axis=0)).max() < 0.02
    assert abs(np.mean(off)) < 1.96 * np.mean(sigma) / 2


def test_greys_are_taken_as_the_photograph_shows_them(plain):
    shot, quality = plain
    seen = alignment.Level(shot.linear, CHART, quality.chart_map, 250)
    places = (slice(10, 15), slice(70, 180)), (slice(138, 148), 149)  # the bar, and a panel's rim
    assert [np.median(seen.print[place]) for place in places] == pytest.approx([0.5, 0.6])
    bars = seen.behind(0.7).as_seen(quality.chart_map).print
    # this camera's printer takes the numbers of light for numbers of a display
    printed = [((tone + 0.055) / 1.055) ** 2.4 for tone in (0.5, 0.6)]
    assert [np.median(bars[place]) for place in places] == pytest.approx(printed, abs=0.03)
    colours = [CHART[name] for name in ("panel_blue", "panel_yellow")]
    for one, tone in zip(colours, (0.094, 0.528), strict=True):
        place = slice(int(one.y / 4) + 2, int(one.y / 4) + 13), int(one.x / 4) + 2
        assert np.median(bars[place]) == pytest.approx(tone, abs=0.06)


def test_a_chart_of_greys_alone_keeps_them():
    corners = ((200, 300), (500, 200), (600, 700), (80, 60), (820, 860))
    sizes = ((120, 500), (300, 90), (200, 90), (100, 90), (100, 90))
    bars = [charts.Bar(str(k), *one, *sizes[k], tone=0.4) for k, one in enumerate(corners)]
    layout = charts.Layout("grey", 1000, 1000, tuple(bars))
    image = np.pad(charts.reflectance(layout, cell=4)[::-1], 20, constant_values=0.5)
    view = chart_image.ChartMap(np.array([[0.25, 0, 19.5], [0, -0.25, 269.5], [0, 0, 1]]))
    level = alignment.Level(image, layout, view, 250).as_seen(view)
    assert np.median(level.print[80:190, 55:75]) == pytest.approx(0.4, abs=0.02)
    moved = replace(view, matrix=view.matrix + [[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]])
    off = align(image, layout, moved).pixels(layout.corners()) - view.pixels(layout.corners())
    assert np.abs(off).max() < 0.1


def test_a_mirrored_chart_whose_bars_look_alike_is_named_by_its_targets(plain):
    with pytest.raises(ValueError, match="the chart is mirrored"):
        chart_image.locate(grey(plain[0].image)[:, ::-1], CHART)


def test_clear_line_pairs_that_are_not_resolved_are_said(plain):
    _, quality = plain
    assert not quality.remarks
    pairs = quality.pairs
    lost = pairs["name"].isin(["pairs_h_15", "pairs_h_20"])
    pairs = pairs.assign(resolved=pairs["resolved"] & ~lost)
    doubted = replace(quality, pairs=pairs)
    assert doubted.resolution("h").width_mm == 30
    (said,) = doubted.remarks
    assert "pairs_h_20, pairs_h_15" in said
    assert "w_h may be coarse" in said


@lru_cache(maxsize=2)
def one_of_two(pixel_mm, blur):
    """A photograph without colours of a chart that stands beside another."""
    return shoot(CHART, pixel_mm, seed=1, mono=True, margin=0.2, blur=blur).image


@pytest.mark.parametrize(
    ("blur", "other_mm", "other_blur", "charts_seen"),
    [
        (0.5, 5.5, 0.5, 2),
        (0.5, 12.0, 1.5, 2),  # its targets cannot be decoded
        (0.5, 40.0, 0.5, 1),  # a chart of 25 pixels is not seen
        (4.0, 5.0, 0.5, 2),  # only those of the smaller one can
    ],
)
def test_of_two_charts_the_larger_is_measured_and_both_are_said(
    blur, other_mm, other_blur, charts_seen
):
    small, large = one_of_two(other_mm, other_blur), one_of_two(4.0, blur)
    image = np.full((len(large), large.shape[1] + small.shape[1]), 90, np.uint8)
    image[: len(small), : small.shape[1]] = small
    image[:, small.shape[1] :] = large
    there = chart_image.locate(image, CHART)
    assert there.pixel_sizes_mm([[500, 500]]) == pytest.approx(4.0, rel=0.02)
    assert there.charts == charts_seen


def test_a_flat_chart_of_other_pairs_gets_no_bend():
    kept = [one for one in charts.imaging_chart().elements if one.name.startswith(("bar_", "mark"))]
    x, y, pairs = 200.0, 90.0, []
    for width in (50.0, 42.0, 35.0, 30.0, 25.0, 21.0, 17.5, 15.0, 12.5, 10.5, 9.0):
        x, y = (x, y) if y + 8 * width < 980 else (x + 100, 90.0)
        pairs.append(charts.LinePairs(f"pairs_v_{width:g}", x, y, width, "v"))
        y += 8 * width + 20
    layout = charts.Layout("finer steps", 1000, 1000, (*kept, *pairs))
    seen, _ = photo_case("C", 5.0, "orthogonal", seed=1, layout=layout)
    assert seen.chart_map.bend is None
    assert seen.resolution("v").width_mm in (10.5, 12.5)  # one step, by the draw of the noise


@pytest.mark.parametrize(
    ("changes", "pixel_mm"),
    [
        (CONDITIONS["pole"], 3.2),
        ({"strips": ((1, 620.0, 9.0),)}, 4.0),
        (CONDITIONS["shadow 75"], 5.4),
        (CONDITIONS["blur 2"], 5.4),
    ],
)
def test_texts_that_something_stands_before_are_named(changes, pixel_mm):
    shot = shoot(CHART, pixel_mm, seed=3, **changes)
    there = chart_image.locate(None, CHART, corners=shot.pixels(CHART.corners()))
    quality = chart_image.evaluate_image(shot.linear, CHART, there)
    named = {one for one in "; ".join(quality.remarks).replace(",", "").split() if "text_" in one}
    axis, middle, half = (*changes.get("strips", ()), (0, -99.0, 0.0))[0]
    across = {}
    for text in CHART.of_kind(charts.Text):
        low, high = text.corners()[[0, 2], axis]
        if text.name.startswith("text_"):
            across[text.name] = min(high, middle + half) - max(low, middle - half)
    assert named <= {name for name, wide in across.items() if wide > 0}
    surely = {name for name, wide in across.items() if wide > 15}
    assert len(surely - named) <= len(surely) / 3
