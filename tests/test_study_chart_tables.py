"""Study 01: readings of a chart against known truth, checks that can fail."""

import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.studies import chart_tables as study


@pytest.fixture(scope="module")
def readings():
    """One pass of each system at 5 m, with a method of one's own."""
    methods = {**study.METHODS, "mine": lambda cloud: {"precision_mm": 0.5}}
    return study.bench(methods=methods, distances_m=(5.0,), seeds=(0,)).run()


def test_hull_loses_a_line_spacing_where_lines_run_along_the_crop():
    methods = {name: study.METHODS[name] for name in ("hull (Appendix A)", "polygon (section 3.3)")}
    bench = study.bench(methods=methods, systems=("A upright",), distances_m=(5,), seeds=range(8))
    table = study.differences(bench.run(), "polygon (section 3.3)").set_index("method")
    # lines 1000 v / 200 = 55.6 mm apart: of a crop of 812 mm one spacing is lost on average
    expected = 100 * 55.6 / (812 - 55.6)
    assert table.loc["hull (Appendix A)", "density_percent"] == pytest.approx(expected, abs=3)


def test_a_method_of_ones_own_enters_the_table(readings):
    table = study.differences(readings, "hull (Appendix A)").set_index(["method", "system"])
    assert (table.loc["hull (Appendix A)"] == 0).all(axis=None)
    assert (table.loc["mine", "sigma_mad_percent"] < 0).all()
    assert table.loc["mine", "f_percent"].isna().all()


def test_truth_is_what_was_drawn(readings):
    off = study.differences(readings, "truth").set_index(["method", "system"])
    assert off.loc[("polygon (section 3.3)", "C"), "density_percent"] == pytest.approx(0, abs=2)
    assert off.loc[("hull, std", "A"), "sigma_mad_percent"] == pytest.approx(0, abs=10)


def test_each_check_can_fail():
    places = pd.MultiIndex.from_product([["A", "A upright", "B", "C"], [5.0, 10.0]])
    lost = pd.Series([2.6, 2.7, 6.8, 7.8, 1.0, 35.3, 0.2, 0.2], places)
    whole = {
        "f": pd.Series({"head A": 3.0, "head B": 2.9, "both heads": 2.2}),
        "lost": lost,
        "along": lost["A upright"],
        "within": pd.Series([True] * 6),
        "table": study.table_2(),
    }
    assert spoiled("chart_tables", whole) == []
    changes = {
        "Two scan heads": {"f": whole["f"].replace(2.2, 2.95)},
        "The polygon's density": {"lost": lost.where(lost != 2.7, 8)},
        "Every printed f": {"within": pd.Series([True] * 5 + [False])},
    }
    for words, change in changes.items():
        (failed,) = spoiled("chart_tables", whole | change)
        assert failed.startswith(words)
