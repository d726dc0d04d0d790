"""Tables 4-1 and 4-2 against themselves."""

import pytest

from mmqa_lab.published import eurosdr2013
from mmqa_lab.stats import wilson


def test_classes_add_up_to_all():
    table = eurosdr2013.table_4_1().query("quantity == 'recall' and corridor_m == 30")
    whole = table[table["class"] == "all"].iloc[0]
    parts = table[table["class"] != "all"]
    assert parts["k"].sum() == whole["k"]
    assert parts["n"].sum() == whole["n"]


def test_found_targets_are_the_correct_detections():
    table = eurosdr2013.table_4_1()
    table = table[table["class"] == "all"].set_index(["quantity", "corridor_m"])
    for corridor in (30.0, 12.5):
        assert table.loc[("recall", corridor), "k"] == table.loc[("precision", corridor), "k"]


def test_rates_are_the_printed_percentages():
    table = eurosdr2013.table_4_1()
    # printed with one decimal of a percent (Table 4-1)
    printed = [69.7, 71.6, 86.5, 95.1, 59.1, 82.3, 95.7]
    assert (100 * table["value"][:7]).round(1).tolist() == printed


def test_intervals_are_wilson():
    for row in eurosdr2013.table_4_1().itertuples():
        rate = wilson(row.k, row.n)
        # two implementations of one formula
        assert (row.low, row.high) == pytest.approx((rate.low, rate.high), abs=1e-9)


def test_visible_share():
    assert round(eurosdr2013.VISIBLE_TARGETS / eurosdr2013.FIELD_TARGETS, 3) == 0.744
    assert "Table" in eurosdr2013.table_4_2().attrs["source"]
