"""The study of the charts' images: predictions, rules on the bench, checks that can fail."""

from types import SimpleNamespace

import pandas as pd
import pytest
from conftest import spoiled
from rendered import centre_contrast
from scipy.optimize import brentq

from mmqa_lab import bench, chart_image, published
from mmqa_lab.published import ledger
from mmqa_lab.studies import chart_images as study


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


@pytest.mark.parametrize(("sigma", "blur"), [(0.9, 0.0), (0.7, 3.0)])
def test_limit_lies_a_little_above_that_of_the_noise_free_contrast(sigma, blur):
    limit = study.pair_limit(sigma, blur, seed=3)
    free = brentq(lambda width: centre_contrast(width, sigma, blur) - 0.1, blur + 0.2, 8)
    # the worst gap decides, not the mean one; patterns come in steps of 4 %
    assert free < limit < 1.2 * free


def test_limit_never_falls_below_beats():
    assert study.pair_limit(0.1) >= chart_image.SMALLEST_PAIR_PX


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
    seen, truth = moving
    for row, carried in zip(seen.pairs.itertuples(), truth["carried"], strict=True):
        left = centre_contrast(row.width_px, 0.4, blur if row.direction == "h" else 0.0)
        if abs(left - 0.1) > 0.02:
            assert carried == (left > 0.1 and row.width_px >= 2), row


def test_rules_are_scored_against_optics(moving):
    seen, truth = moving
    carried = truth["carried"]
    assert study.score_rule(carried, truth) == {"spurious": 0, "missed": 0}
    every, none = (study.score_rule([taken] * len(carried), truth) for taken in (True, False))
    assert every == {"spurious": (~carried).sum(), "missed": 0}
    assert none == {"spurious": 0, "missed": carried.sum()}
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


def test_ledger_has_every_pixel_size_and_mark_of_table_1():
    table = study.table_1().assign(ours=1.0, low_mm=0.9, high_mm=1.1)
    sizes = pd.concat([table.assign(direction=direction) for direction in "hv"])
    made = {"value": "ours", "note": "made up"}
    entries = [
        study.ledger_rows(sizes, "pixel size", kind="predicted", **made),
        study.ledger_rows(sizes, "line-pair width", kind="fitted", **made),
        study.ledger_rows(table, "legibility", kind="fitted", **made),
    ]
    printed = ledger.cells().query("source == 'pfeifer2021' and table == 'table_1'")
    assert set(pd.concat(entries)["cell"]) == set(printed["cell"])
    assert [each["low"].notna().all() for each in entries] == [True, False, False]


def test_each_check_of_the_notebook_can_fail():
    counts = pd.DataFrame({"spurious": [0, 2]}, index=["every gap", "contrast alone"])
    right = {
        "inside": pd.Series([False, True, True]),
        "others": pd.Series([False, True, True]),
        "ratio": pd.Series([1.2]),
        "best": {"exact": 16.0},
        "other_systems": 14,
        "baseline": 9,
        "lead_low": 1.0,
        "lead_high": 9.0,
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
        "other_systems": 9,
        "wrong": counts.assign(spurious=0),
        "largest": 2.0,
    }
    for name, value in wrong.items():
        assert len(spoiled("chart_images", right | {name: value})) == 1, name
