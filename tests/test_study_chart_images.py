"""The study of the charts' images: predictions, fits, rules on the bench, checks that can fail."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from rendered import centre_contrast
from scipy.optimize import brentq

from mmqa_lab import bench, chart_image, published
from mmqa_lab.published import ledger
from mmqa_lab.studies import chart_images as images

DIRECTIONS = st.sampled_from("hv")


@pytest.fixture(scope="module")
def cells():
    return images.width_cells(images.table_1())


@pytest.fixture(scope="module")
def limits():
    """Limits that are linear in both directions."""
    sigma, blur = np.linspace(0.4, 1.1, 8), np.arange(0, 5.0)
    coords = {"sigma_px": sigma, "blur_px": blur}
    values = 1.2 + 2 * sigma[:, None] + 0.5 * blur
    return xr.DataArray(values, coords=coords, dims=("sigma_px", "blur_px"))


@pytest.fixture(scope="module")
def whole(cells):
    """Sizes, errors, trials, fits and rules as in the notebook, with made-up photographs."""
    table = images.table_1()
    sizes = cells[[*images.ROW, "direction"]].copy()
    sizes["published_mm"] = table[["pixel_h_mm", "pixel_v_mm"]].to_numpy().ravel()
    sizes["predicted_mm"] = cells["pixel_mm"] * np.where(sizes["system"] == "A", 0.85, 1.01)
    sizes["low_mm"], sizes["high_mm"] = 0.95 * sizes["predicted_mm"], 1.05 * sizes["predicted_mm"]
    case = [{"row": 1}, {"row": 2}]
    sharp = {"ends fitted": lambda x: {"error_h_percent": 0.2, "error_v_percent": -0.1 * x}}
    errors = bench.run(case, sharp, make=lambda row, seed: row)
    counts = {"every gap": lambda x: {"spurious": 0}, "contrast alone": lambda x: {"spurious": x}}
    rules = bench.run(case, counts, make=lambda row, seed: row)
    best = {"sigma_px": 0.8, "blur_mm": 0.0, "exact": 16, "within_one_step": 22, "cells": 22}
    trials = pd.DataFrame([best, best | {"sigma_px": 0.6, "exact": 14, "within_one_step": 21}])
    fits = pd.DataFrame({"system": list("ABC"), "exact": [5, 7, 7]})
    return sizes, errors, trials, fits, rules


# published


def test_table_1_has_every_printed_cell():
    table = images.table_1()
    printed = published.table("pfeifer2021", "table_1").set_index([*images.ROW, "quantity"])
    assert table["legibility"].value_counts().to_dict() == {"c": 7, "a": 4, "b": 1}
    assert table[["w_h_mm", "w_v_mm"]].notna().to_numpy().sum() == 22
    assert table[["pixel_h_mm", "pixel_v_mm"]].notna().to_numpy().sum() == 23
    for row in table.itertuples():
        both = printed.loc[(row.system, row.distance_m, row.view, "line-pair width")]
        both = both.set_index("direction")["value"]
        assert [row.w_h_mm, row.w_v_mm] == pytest.approx(both[["h", "v"]].tolist(), nan_ok=True)


def test_ladder_of_the_chart_has_every_width_that_was_read():
    table = images.table_1()
    for direction in "hv":
        read = table[f"w_{direction}_mm"].dropna()
        assert set(read) <= set(images.LADDERS_MM[direction])
        widest = published.number("pfeifer2021", f"line_pair_max_{direction}")["value"]
        assert max(images.LADDERS_MM[direction]) == widest
        narrowest = published.number("pfeifer2021", "line_pair_min")["value"]
        assert min(images.LADDERS_MM[direction]) == narrowest


def test_dashes_stay_as_cells_and_use_the_other_pixel_where_none_is_printed(cells):
    dashes = cells[cells["published_mm"].isna()]
    assert dashes[["view", "direction"]].to_numpy().tolist() == [
        ["forward", "v"],
        ["backward", "h"],
    ]
    forward = cells.query("system == 'A' and view == 'forward' and direction == 'h'")
    assert forward["pixel_mm"].item() == 11.1  # of the standing bars: the lying one is a dash


def test_no_single_number_of_pixels_satisfies_all_widths(cells):
    printed = cells.dropna(subset=["published_mm"])
    ladder = images.LADDERS_MM["h"]
    finer = [max((w for w in ladder if w < width), default=0) for width in printed["published_mm"]]
    ratio = np.linspace(1.5, 5, 35_001)[:, None]
    low, high = finer / printed["pixel_mm"].values, printed.eval("published_mm / pixel_mm").values
    satisfied = ((ratio > low) & (ratio <= high)).sum(axis=1)
    assert satisfied.max() == 16
    assert 2.7 < ratio[satisfied.argmax(), 0] < 2.75


def test_pixels_per_capital_part_all_marks_and_the_quality_index_does_not():
    table = images.table_1()
    pixels = (40 / table["pixel_v_mm"]).groupby(table["legibility"]).agg(["min", "max"])
    assert pixels.loc["a", "min"] > pixels.loc["b", "max"]
    assert pixels.loc["b", "min"] > pixels.loc["c", "max"]
    near = table[table["distance_m"] == 5].set_index("system")
    same = [chart_image.quality_index(40, near.loc[name, "w_h_mm"]) for name in "AC"]
    assert same[0] == same[1]
    assert near.loc["A", "legibility"] != near.loc["C", "legibility"]


# predicted


@pytest.mark.parametrize(("sigma", "blur"), [(0.9, 0.0), (0.7, 3.0)])
def test_limit_lies_a_little_above_that_of_the_noise_free_contrast(sigma, blur):
    limit = images.pair_limit(sigma, blur, seed=3)
    free = brentq(lambda width: centre_contrast(width, sigma, blur) - 0.1, blur + 0.2, 8)
    # the worst gap decides, not the mean one; patterns come in steps of 4 %
    assert free < limit < 1.2 * free


def test_limit_never_falls_below_beats():
    assert images.pair_limit(0.1) >= images.SMALLEST_PAIR_PX


def test_motion_counts_for_standing_bars_alone(limits, cells):
    found = images.limits_mm(cells, limits, 0.65, 1.1)
    angle = np.arccos(np.minimum(3.0 / 3.3, 1))
    forward = cells.query("system == 'B' and view == 'forward' and direction == 'h'").index[0]
    # a board across the path moves by the tangent of the angle
    blur = 1.1 * np.tan(angle) / 3.3
    assert found[forward] == pytest.approx((1.2 + 1.3 + 0.5 * blur) * 3.3)
    straight = cells.query("view == 'orthogonal' and direction == 'h'")
    expected = (2.5 + 0.5 * 1.1 / straight["pixel_mm"]) * straight["pixel_mm"]
    assert found[straight.index] == pytest.approx(expected.to_numpy())
    lying = cells["direction"] == "v"
    assert found[lying] == pytest.approx(2.5 * cells["pixel_mm"][lying].to_numpy())


@given(finest=st.floats(1, 60), direction=DIRECTIONS)
def test_ladder_width_is_the_finest_that_is_wide_enough(finest, direction):
    width = images.ladder_widths([finest], [direction])[0]
    wide = [rung for rung in images.LADDERS_MM[direction] if rung >= finest]
    assert (np.isnan(width) and not wide) or (width in wide and width == wide[-1])


@given(st.data(), DIRECTIONS)
def test_steps_count_rungs_and_change_sign(data, direction):
    ladder = images.LADDERS_MM[direction]
    one, two = (data.draw(st.integers(0, len(ladder) - 1)) for _ in range(2))
    pair = [ladder[one]], [ladder[two]], [direction]
    assert images.steps_between(*pair) == one - two
    assert images.steps_between(pair[1], pair[0], pair[2]) == two - one
    assert images.steps_between([np.nan], pair[1], pair[2]) == -1 - two


# fitted


def test_fits_find_the_spread_and_motion_that_made_the_widths(cells, limits):
    made = cells.copy()
    for spread, motion in ((0.8, 0.0), (0.6, 2.5)):
        finest = images.limits_mm(made, limits, spread, motion)
        made["published_mm"] = images.ladder_widths(finest, made["direction"])
        tried = images.spread_trials(made, limits, [0.4, 0.6, 0.8], [0.0, 2.5])
        tried = tried.set_index(["sigma_px", "blur_mm"])
        right = tried.loc[(spread, motion)]
        assert right["exact"] == right["cells"] == made["published_mm"].notna().sum()
        assert right["steps"] == 0 < tried.loc[(0.4, 0.0), "steps"]
    assert (tried["kind"] == "fitted").all()


def test_spreads_without_known_limits_are_not_tried(cells, limits):
    known = limits.sel(sigma_px=slice(0.55, 0.85))
    trials = images.spread_trials(cells, known, np.arange(0.4, 1.1, 0.05))
    assert trials["sigma_px"].between(0.55, 0.85).all()


def test_one_spread_or_motion_alone_stands_for_all(cells, limits):
    one = images.limits_mm(cells, limits.isel(blur_px=[0]), 0.65, 3.0)
    assert one == pytest.approx(2.5 * cells["pixel_mm"].to_numpy())
    single = limits.sel(sigma_px=[0.8], blur_px=[0.0], method="nearest")
    assert images.limits_mm(cells, single, 0.8) == pytest.approx(2.8 * cells["pixel_mm"].to_numpy())


def test_best_trial_has_most_within_one_step_then_most_exact():
    rows = [(0.5, 21, 19), (0.6, 22, 14), (0.7, 22, 16), (0.8, 22, 15)]
    trials = pd.DataFrame(rows, columns=["sigma_px", "within_one_step", "exact"])
    assert images.best_trial(trials)["sigma_px"] == 0.7


# photographs


@pytest.fixture(scope="module")
def moving():
    """A sharp camera of C at 10 m that moves by 16.7 mm during the exposure."""
    return images.photo_case("C", 10.0, "orthogonal", spread_px=0.4, exposure_ms=1.5, seed=1)


def test_photographs_have_the_pixels_they_ask_for(moving):
    truth = moving[1]
    # the mean of 8.2 and 7.9 mm in the orthogonal view
    assert truth["pixel_h_mm"] == pytest.approx(8.05, rel=0.01)
    assert truth["pixel_v_mm"] == pytest.approx(8.05, rel=0.01)
    oblique = images.photo_case("A", 10.0, "backward", seed=1)[1]
    assert oblique["pixel_h_mm"] == pytest.approx(12.8, rel=0.01)
    assert oblique["pixel_v_mm"] == pytest.approx(12.3, rel=0.01)


def test_optics_carry_what_the_integral_over_the_bars_says(moving):
    patterns = moving[1]["patterns"]
    blur = 1.5 * 40 / 3.6 / 8.05
    for row in patterns.itertuples():
        motion = blur if row.direction == "h" else 0.0
        left = centre_contrast(row.width_px, 0.4, motion)
        if abs(left - 0.1) > 0.02:
            assert row.there == (left > 0.1 and row.width_px >= 2), row


def test_rules_are_scored_against_optics_and_table(moving):
    seen, truth = moving
    patterns = truth["patterns"]
    right = images.score_rule(patterns["there"], truth)
    assert (right["spurious"], right["missed"]) == (0, 0)
    every = images.score_rule([True] * len(patterns), truth)
    assert every["spurious"] == (~patterns["there"]).sum()
    # 2 mm instead of 20 mm
    assert every["steps_h"] == images.LADDERS_MM["h"].index(2.0) - images.LADDERS_MM["h"].index(20)
    none = images.score_rule([False] * len(patterns), truth)
    assert none["missed"] == patterns["there"].sum()
    assert none["steps_v"] == -1 - images.LADDERS_MM["v"].index(20.0)
    assert images.score_rule(images.every_gap(seen), truth)["spurious"] == 0
    assert images.score_rule(images.contrast_alone(seen), truth)["spurious"] > 0


def test_cases_are_the_rows_of_table_1_and_then_others():
    cases = images.photo_cases("ABC", (0.4, 0.8), (0, 1))
    assert len(cases) == 12 + 3 * 3  # 0.8 px without motion is in Table 1 already
    assert len({tuple(case.values()) for case in cases}) == len(cases)


def test_a_rule_of_ones_own_enters_the_comparison():
    comparison = images.comparison(quick=True)
    comparison.cases = comparison.cases[:1]
    comparison.methods["mine"] = lambda seen: seen.pairs["width_px"] > 3
    results = comparison.run()
    assert results.sizes["method"] == 3
    assert bench.failures(results).empty


def test_scores_and_figure_have_a_row_for_each_rule():
    rows = images.photo_cases("C", (0.4,), (0.0, 1.0))
    made = {
        name: lambda x: {"spurious": 1, "missed": 0, "steps_h": -1, "steps_v": 0} for name in "ab"
    }
    results = bench.run(rows, made, make=lambda seed, **case: 0)
    scores = images.rule_scores(results)
    assert scores.index.names == ["method", "spread_px", "exposure_ms"]
    assert len(scores) == 2 * 3
    figure = images.draw_rules(results)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]
    # one of two widths of each of four photographs is a step away
    heights = [[bar.get_height() for bar in bars] for bars in figure.axes[2].containers]
    assert heights == [[4, 4], [4, 4]]


# ledger and checks


def test_ledger_has_every_cell_of_table_1(whole, cells):
    sizes = whole[0]
    widths = cells.assign(predicted_mm=15.0, low_mm=10.0, high_mm=20.0, fitted_mm=15.0)
    marks = images.table_1().assign(fitted_mark="c")
    entries = pd.DataFrame(images.ledger_entries(sizes, widths, marks, [0.1, 0.2]))
    printed = ledger.cells().query("source == 'pfeifer2021' and table == 'table_1'")
    assert set(entries.query("table == 'table_1'")["cell"]) == set(printed["cell"])
    assert set(entries.query("kind == 'fitted'")["cell"].str.split().str[-1]) == {
        "legibility",
        "width",
    }
    assert (entries["note"] != "").all()


def test_checks_hold_on_these_numbers(whole):
    broken = [check.statement for check in images.checks(*whole) if not check.passed]
    assert not broken


def test_each_check_can_fail(whole):
    sizes, errors, trials, fits, rules = whole
    coarse = sizes.assign(predicted_mm=sizes["published_mm"])
    changes = {
        "Fits of the bars' ends": {1: xr.zeros_like(errors.drop_vars("failure")) + 2},
        "Megapixels and the site": {0: sizes.assign(high_mm=0.0)},
        "Pixels of A": {0: coarse},
        "One point spread": {2: trials.assign(within_one_step=21)},
        "more widths exactly": {3: fits.assign(exact=5)},
        "Contrast alone": {4: rules.assign(spurious=rules["spurious"] * 0)},
    }
    for words, change in changes.items():
        parts = [change.get(k, part) for k, part in enumerate(whole)]
        check = next(one for one in images.checks(*parts) if words in one.statement)
        assert not check.passed, words
