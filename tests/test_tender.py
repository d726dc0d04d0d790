"""A tender's verdicts: written out by hand, and the two published scenarios."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import tender
from mmqa_lab.published import pfeifer2021_images as published

CRITERIA = pd.DataFrame(
    [
        ("density", "density_per_m2", ">=", 3000, 5, "", ""),
        ("pairs", "w_mm", "<=", 20, 10, "", ""),
        ("pairs ahead", "w_mm", "<=", 15, 10, "forward", "h"),
        ("text", "legibility", "<=", "b", None, "", ""),
    ],
    columns=["criterion", "quantity", "relation", "threshold", "distance_m", "view", "direction"],
)

RESULTS = pd.DataFrame(
    [
        ("X", "density_per_m2", 4000, 100, 5, "", ""),
        ("X", "density_per_m2", 10, 1, 10, "", ""),  # no criterion at 10 m
        ("X", "w_mm", 20, 0, 10, "forward", "h"),
        ("X", "w_mm", 10, 0, 10, "forward", "v"),
        ("X", "legibility", "a", None, 5, "", ""),
        ("Y", "density_per_m2", 3100, 100, 5, "", ""),
        ("Y", "w_mm", 8, 0, 10, "forward", "h"),
        ("Y", "legibility", "b", None, 5, "", ""),
        ("Z", "density_per_m2", 3300, 100, 5, "", ""),
        ("Z", "w_mm", 15, 0, 10, "forward", "h"),
        ("Z", "legibility", "b", None, 10, "", ""),
        ("V", "density_per_m2", 3300, 100, 5, "", ""),
        ("V", "w_mm", None, None, 10, "forward", "h"),
        ("V", "legibility", "a", None, 10, "", ""),
    ],
    columns=["system", "quantity", "value", "sigma", "distance_m", "view", "direction"],
)


def test_verdicts_and_margins_as_written_out_by_hand():
    table = tender.verdicts(CRITERIA, RESULTS)
    found = table[["system", "criterion", "margin", "verdict"]].values.tolist()
    assert found[:4] == [
        ["X", "density", 1000.0, "met"],
        ["X", "pairs", 0.0, "met"],
        ["X", "pairs", 10.0, "met"],
        ["X", "pairs ahead", -5.0, "not met"],
    ]
    assert ["Y", "density", 100.0, "undecided"] in found  # within 1.96 times 100
    assert ["Z", "density", 300.0, "met"] in found
    assert ["Y", "text", 0.0, "met"] in found
    summary = tender.qualification(table).set_index("system")
    assert summary["verdict"].to_dict() == {
        "X": "fails",
        "Y": "open",
        "Z": "qualifies",
        "V": "open",
    }
    assert summary["because"].to_dict() == {
        "X": "pairs ahead",
        "Y": "density",
        "Z": "",
        "V": "pairs, pairs ahead",
    }
    assert summary.loc["V", "not_measured"] == 2


def test_a_criterion_without_any_figure_leaves_it_open():
    results = RESULTS[RESULTS["quantity"] == "density_per_m2"]
    table = tender.verdicts(CRITERIA, results)
    assert (table.query("criterion == 'text'")["verdict"] == "not measured").all()
    assert "qualifies" not in tender.qualification(table)["verdict"].tolist()


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([">=", ">", "<=", "<"]),
    st.integers(-5, 5),
    st.integers(-5, 5),
    st.integers(0, 3),
)
def test_a_verdict_is_the_comparison_unless_sigma_reaches_the_threshold(
    relation, value, threshold, sigma
):
    criteria = pd.DataFrame(
        [("c", "q", relation, threshold)],
        columns=["criterion", "quantity", "relation", "threshold"],
    )
    results = pd.DataFrame(
        [("S", "q", value, sigma)], columns=["system", "quantity", "value", "sigma"]
    )
    row = tender.verdicts(criteria, results).iloc[0]
    holds = {
        ">=": value >= threshold,
        ">": value > threshold,
        "<=": value <= threshold,
        "<": value < threshold,
    }[relation]
    if sigma and abs(value - threshold) <= 1.96 * sigma:
        assert row["verdict"] == "undecided"
    else:
        assert row["verdict"] == ("met" if holds else "not met")
        # on the threshold the margin is 0 whatever the relation
        assert (row["margin"] > 0) == (holds and value != threshold)


def test_order_of_rows_changes_nothing():
    first = tender.qualification(tender.verdicts(CRITERIA, RESULTS)).set_index("system")
    shuffled = tender.verdicts(
        CRITERIA.sample(frac=1, random_state=2), RESULTS.sample(frac=1, random_state=3)
    )
    second = tender.qualification(shuffled).set_index("system").loc[first.index]
    assert (first["verdict"] == second["verdict"]).all()
    assert (first["met"] == second["met"]).all()


def test_the_first_published_scenario_has_no_winner_and_says_why():
    # section 4.4: no system meets every criterion
    table = tender.verdicts(published.tender_criteria(1), published.results())
    summary = tender.qualification(table).set_index("system")
    assert (summary["verdict"] == "fails").all()
    assert "inhomogeneity" in summary.loc["B", "because"]  # f 2.5 and 2.6, above 2.0
    assert summary.loc["B", "not_met"] == 2
    for criterion in ("pixel_size", "legibility"):
        for system in "AC":
            assert criterion in summary.loc[system, "because"]


def test_the_second_published_scenario_has_two_winners():
    # section 4.4: two systems qualify
    table = tender.verdicts(published.tender_criteria(2), published.results())
    summary = tender.qualification(table).set_index("system")
    assert summary["verdict"].to_dict() == {"A": "fails", "B": "qualifies", "C": "qualifies"}
    assert summary.loc["A", "because"] == "line_pairs_orthogonal, legibility_5_m"
    tight = table[(table["system"] == "C") & (table["margin"] == 0)]
    assert set(tight["criterion"]) == {"line_pairs_orthogonal", "legibility_5_m"}


@pytest.mark.parametrize(
    ("criteria", "results", "sentence"),
    [
        (CRITERIA.drop(columns="relation"), RESULTS, "no column 'relation'"),
        (CRITERIA, RESULTS.drop(columns="system"), "no column 'system'"),
        (CRITERIA[:0], RESULTS, "criteria: no rows"),
        (CRITERIA, RESULTS[:0], "results: no rows"),
        (pd.concat([CRITERIA, CRITERIA]), RESULTS, "'density' twice"),
        (CRITERIA.assign(relation="="), RESULTS, "relation of 'density'"),
        (CRITERIA.assign(threshold=np.nan), RESULTS, "threshold of 'density'"),
        (CRITERIA.assign(threshold="d"), RESULTS, "Must be a number or a mark a, b, c"),
        (CRITERIA, RESULTS.assign(value="good"), "Must be a number or a mark a, b, c"),
        (CRITERIA, RESULTS.assign(sigma=-1.0), "Invalid sigma -1.0"),
        (CRITERIA, RESULTS.assign(sigma="wide"), "Invalid sigma 'wide'"),
        (CRITERIA, RESULTS.assign(distance_m="near"), "Invalid distance_m 'near'"),
        (CRITERIA, RESULTS.replace({"value": {"a": 1.0}}), "Must be of the kind"),
        (CRITERIA, RESULTS.assign(value=np.inf), "Must be finite"),
    ],
)
def test_rejects(criteria, results, sentence):
    with pytest.raises(ValueError, match=sentence):
        tender.verdicts(criteria, results)
