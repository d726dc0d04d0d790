"""The study of the charts' images: predictions, rules on the bench, checks that can fail."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled
from hypothesis import given
from hypothesis import strategies as st
from rendered import centre_contrast
from scipy.optimize import brentq

from mmqa_lab import bench, published
from mmqa_lab.published import ledger
from mmqa_lab.studies import chart_images as study

DIRECTIONS = st.sampled_from("hv")


@pytest.fixture(scope="module")
def cells():
    return study.width_cells(study.table_1())


def test_table_1_has_every_printed_cell():
    table = study.table_1()
    printed = published.table("pfeifer2021", "table_1").set_index([*study.ROW, "quantity"])
    assert table["legibility"].value_counts().to_dict() == {"c": 7, "a": 4, "b": 1}
    assert table[["w_h_mm", "w_v_mm"]].notna().to_numpy().sum() == 22
    assert table[["pixel_h_mm", "pixel_v_mm"]].notna().to_numpy().sum() == 23
    for row in table.itertuples():
        key = (row.system, row.distance_m, row.view)
        widths = printed.loc[(*key, "line-pair width")].set_index("direction")["value"]
        assert widths.to_dict() == pytest.approx({"h": row.w_h_mm, "v": row.w_v_mm}, nan_ok=True)


def test_cells_without_a_pixel_size_take_that_of_the_other_direction(cells):
    row = cells.query("system == 'A' and view == 'forward' and direction == 'h'").iloc[0]
    assert row["pixel_mm"] == 11.1


@pytest.mark.parametrize(("sigma", "blur"), [(0.9, 0.0), (0.7, 3.0)])
def test_limit_lies_a_little_above_that_of_the_noise_free_contrast(sigma, blur):
    limit = study.pair_limit(sigma, blur, seed=3)
    free = brentq(lambda width: centre_contrast(width, sigma, blur) - 0.1, blur + 0.2, 8)
    # the worst gap decides, not the mean one; patterns come in steps of 4 %
    assert free < limit < 1.2 * free


def test_limit_never_falls_below_beats():
    assert study.pair_limit(0.1) >= study.reading.SMALLEST_PAIR_PX


@given(finest=st.floats(1, 60), direction=DIRECTIONS)
def test_ladder_width_is_the_finest_that_is_wide_enough(finest, direction):
    width = study.ladder_widths([finest], [direction])[0]
    wide = [rung for rung in study.LADDERS_MM[direction] if rung >= finest]
    assert (np.isnan(width) and not wide) or (width in wide and width == wide[-1])


@given(st.data(), DIRECTIONS)
def test_steps_count_rungs_and_change_sign(data, direction):
    ladder = study.LADDERS_MM[direction]
    one, two = (data.draw(st.integers(0, len(ladder) - 1)) for _ in range(2))
    pair = [ladder[one]], [ladder[two]], [direction]
    assert study.steps_between(*pair) == one - two
    assert study.steps_between(pair[1], pair[0], pair[2]) == two - one
    assert study.steps_between([np.nan], pair[1], pair[2]) == -1 - two


@pytest.fixture(scope="module")
def moving():
    """A sharp camera of C at 10 m that moves by 16.7 mm during the exposure."""
    return study.photo_case("C", 10.0, "orthogonal", spread_px=0.4, exposure_ms=1.5, seed=1)


def test_photographs_have_the_pixels_they_ask_for(moving):
    # the mean of 8.2 and 7.9 mm in the orthogonal view
    assert moving[1]["pixel_h_mm"] == pytest.approx(8.05, rel=0.01)
    assert moving[1]["pixel_v_mm"] == pytest.approx(8.05, rel=0.01)
    oblique = study.photo_case("A", 10.0, "backward", seed=1)[1]
    assert oblique["pixel_h_mm"] == pytest.approx(12.8, rel=0.01)
    assert oblique["pixel_v_mm"] == pytest.approx(12.3, rel=0.01)


def test_optics_carry_what_the_integral_over_the_bars_says(moving):
    blur = 1.5 * 40 / 3.6 / 8.05
    for row in moving[1]["patterns"].itertuples():
        left = centre_contrast(row.width_px, 0.4, blur if row.direction == "h" else 0.0)
        if abs(left - 0.1) > 0.02:
            assert row.there == (left > 0.1 and row.width_px >= 2), row


def test_rules_are_scored_against_optics_and_table(moving):
    seen, truth = moving
    patterns = truth["patterns"]
    right = study.score_rule(patterns["there"], truth)
    assert (right["spurious"], right["missed"]) == (0, 0)
    every = study.score_rule([True] * len(patterns), truth)
    assert every["spurious"] == (~patterns["there"]).sum()
    # 2 mm instead of 20 mm
    assert every["steps_h"] == study.LADDERS_MM["h"].index(2.0) - study.LADDERS_MM["h"].index(20)
    none = study.score_rule([False] * len(patterns), truth)
    assert none["missed"] == patterns["there"].sum()
    assert none["steps_v"] == -1 - study.LADDERS_MM["v"].index(20.0)
    assert study.score_rule(study.every_gap(seen), truth)["spurious"] == 0
    assert study.score_rule(study.contrast_alone(seen), truth)["spurious"] > 0


def test_the_bench_has_the_rows_of_table_1_then_others_and_takes_a_rule_of_ones_own():
    comparison = study.bench("ABC", (0.4, 0.8), (0, 1))
    assert len(comparison.cases) == 12 + 3 * 3  # 0.8 px without motion is in Table 1 already
    assert len({tuple(case.values()) for case in comparison.cases}) == len(comparison.cases)
    comparison = study.bench("C", (0.4,), (0,))
    comparison.cases = comparison.cases[:1]
    comparison.methods["mine"] = lambda seen: seen.pairs["width_px"] > 3
    results = comparison.run()
    assert results.sizes["method"] == 4
    assert bench.failures(results).empty


def test_ledger_has_every_cell_of_table_1(cells):
    table = study.table_1()
    sizes = cells[[*study.ROW, "direction"]].copy()
    sizes["published_mm"] = table[["pixel_h_mm", "pixel_v_mm"]].to_numpy().ravel()
    sizes["predicted_mm"] = cells["pixel_mm"]
    sizes["low_mm"], sizes["high_mm"] = 0.9 * cells["pixel_mm"], 1.1 * cells["pixel_mm"]
    widths = cells.assign(predicted_mm=15.0, low_mm=10.0, high_mm=20.0, fitted_mm=15.0)
    entries = study.ledger_table(sizes, widths, table.assign(fitted_mark="c"), [0.1, 0.2])
    printed = ledger.cells().query("source == 'pfeifer2021' and table == 'table_1'")
    assert set(entries.query("table == 'table_1'")["cell"]) == set(printed["cell"])
    assert entries.query("table == 'numbers'")["value"].tolist() == pytest.approx([0.2, 0.8])
    assert (entries["note"] != "").all()
    assert entries["kind"].isin(ledger.KINDS).all()


def test_each_check_of_the_notebook_can_fail():
    counts = pd.DataFrame({"spurious": [0, 2]}, index=["every gap", "contrast alone"])
    rivals = pd.DataFrame({"exact": [7]}, index=["one width a distance"])
    right = {
        "inside": pd.Series([False, True, True]),
        "others": pd.Series([False, True, True]),
        "ratio": pd.Series([1.2]),
        "best": {"exact": 16.0},
        "rivals": rivals,
        "n": 22,
        "fitted_px": 2.77,
        "comparison": SimpleNamespace(cases=[1]),
        "wrong": counts,
        "largest": 0.3,
    }
    assert not spoiled("chart_images", right)
    wrong = {
        "inside": pd.Series([False, True, False]),
        "ratio": pd.Series([1.0]),
        "best": {"exact": 7.0},
        "wrong": counts.assign(spurious=0),
        "largest": 2.0,
    }
    for name, value in wrong.items():
        assert len(spoiled("chart_images", right | {name: value})) == 1, name
