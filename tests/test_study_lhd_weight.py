"""The study of the line-segment Hausdorff distance: its scenes, scores, tables and checks."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mmqa_lab import bench, lines
from mmqa_lab.lines.segments import PairingScores
from mmqa_lab.published import ledger
from mmqa_lab.simulate.canyon import Conditions, canyon
from mmqa_lab.studies import lhd_weight as study


@pytest.fixture(scope="module")
def one():
    """Course 1 against the static scanner, and what is true."""
    return study.scene("C1-TLS", seed=5)


@pytest.fixture(scope="module")
def replicated():
    """The published method on the six comparisons of three scenes."""
    cases = bench.grid(comparison=tuple(study.COURSES))
    method = {"published": study.METHODS["published"]}
    scored = {"make": study.scene, "score": study.score_directions}
    return bench.run(cases, method, seeds=range(3), **scored)


def small_runs():
    """What the checks read, on two scenes."""
    by_w = {f"W = {w:g}": lambda sets, w=w: study.measured(sets, weight=w) for w in (0, 10)}
    by_matcher = {
        m: lambda sets, m=m: study.measured(sets, matcher=m) for m in ("all", "displaced")
    }
    both = {name: study.METHODS[name] for name in ("published", "displaced")}
    cases = {
        "by_weight": (by_w, {"comparison": ("C1-C3",)}),
        "by_noise": (by_w, {"comparison": ("C1-C3",), "angle_noise_deg": (0.1, 2.0)}),
        "by_displacement": (by_matcher, {"comparison": ("C1-TLS",), "displacement_m": (0.5, 3.0)}),
        "held_out": (both, {"comparison": ("C1-TLS", "C2-TLS")}),
    }
    scored = {"make": study.scene, "score": study.score, "seeds": range(2)}
    return {name: bench.run(bench.grid(**axes), m, **scored) for name, (m, axes) in cases.items()}


def test_rates_follow_from_the_printed_counts_in_13_of_14_rows():
    rows = study.published_rows()
    off = (rows["rate_from_counts_percent"] - rows["detection_rate_percent"]).abs()
    wrong = rows[off > 0.005 + 1e-9]
    assert len(rows) == 14
    assert wrong["data_sets"].tolist() == ["Course3-TLS"]
    # Table 2, last number: 99.54 in print, 41 x 64 cells, FN 2, FP 9
    assert wrong["rate_from_counts_percent"].item() == pytest.approx(100 * (1 - 11 / 2624))
    absolute = rows["table"] == "table_2"
    assert rows.loc[absolute, "f1"].mean() == pytest.approx(0.780, abs=5e-4)
    assert rows.loc[~absolute, "f1"].mean() == pytest.approx(0.895, abs=5e-4)
    for row in rows.itertuples():
        found = row.pairing_existing - row.false_negative
        rest = row.p_test_segments * row.q_model_segments - row.pairing_existing
        counts = row.false_positive, row.false_negative, rest - row.false_positive
        scores = PairingScores(found, *counts)
        assert row.f1 == pytest.approx(scores.f1)
        assert row.null_rate_percent == pytest.approx(100 * scores.null_rate)
    gain = rows["detection_rate_percent"] - rows["null_rate_percent"]
    assert gain.mean() == pytest.approx(0.90, abs=0.01)
    assert gain.max() == pytest.approx(1.80, abs=0.01)  # Course1-Course3, second extraction


def test_the_mean_over_pairs_is_the_consistent_denominator():
    """Equation 7: left and right agree as means over pairs, not as sums over the whole set."""
    rows = study.published_rows()
    left, right = (rows[rows["position_in_cell"] == s].reset_index() for s in ("left", "right"))
    ratio = np.log(left["olhd_m"] / right["olhd_m"])
    found = [
        one["pairing_existing"] - one["false_negative"] + one["false_positive"]
        for one in (left, right)
    ]
    share = left["q_model_segments"] / found[0] * found[1] / left["p_test_segments"]
    whole = ratio + np.log(share)
    assert np.sqrt((ratio**2).mean()) == pytest.approx(0.106, abs=0.001)
    assert np.sqrt((whole**2).mean()) == pytest.approx(0.450, abs=0.001)
    larger = left["olhd_m"] > right["olhd_m"]
    assert (left["final_lhd_asterisk"] == larger).all()


def test_score_agrees_with_the_distance_itself(one):
    sets, truth = one
    found = lines.lhd(sets.test, sets.model)
    row = study.score(found, truth)
    assert row["lhd_m"] == found.value
    assert row["lhd_bias_m"] == pytest.approx(found.value - truth.mean(truth.displacements))
    forward = lines.pairing_scores(found.test_model.pairs, truth.pairs)
    backward = lines.pairing_scores(found.model_test.pairs, truth.pairs)
    assert row["f1"] == pytest.approx((forward.f1 + backward.f1) / 2)


def test_pairs_and_numbers_are_scored_as_well(one):
    sets, truth = one
    exact = study.score(truth.pairs, truth)
    assert exact["f1"] == 1
    distances = lines.distance_matrix(sets.test, sets.model)
    back = lines.distance_matrix(sets.model, sets.test)
    rows, columns = np.nonzero(truth.pairs)
    by_hand = max(
        np.average(distances[rows, columns], weights=sets.model.lengths[columns]),
        np.average(back[columns, rows], weights=sets.test.lengths[rows]),
    )
    assert exact["lhd_m"] == pytest.approx(by_hand)
    plain = max(distances.min(axis=1).max(), back.min(axis=1).max())  # equations 1 and 2
    found = study.METHODS["plain Hausdorff"](sets)
    assert found == pytest.approx(plain)
    assert study.score(found, truth)["lhd_m"] == found


def test_truth_of_a_pure_displacement():
    quiet = {"drift_m": 0.0, "own_m": 0.0}
    _, truth = study.scene("C1-TLS", seed=7, displacement_m=2.0, **quiet)
    # 2 m and 0.05 degrees about the centre, some 80 m away
    assert truth.mean(truth.displacements) == pytest.approx(2.0, abs=0.15)
    assert truth.mean(truth.across) < truth.mean(truth.displacements)


def test_replicas_and_ledger_cover_both_tables(replicated):
    rows = study.replicas(replicated)
    assert len(rows) == 14
    assert set(rows.loc[rows["kind"] == "fitted", "name"]) == set(study.FITTED)
    assert set(rows.loc[rows["kind"] == "predicted", "name"]) == {"C1-C3", "C2-C3", "C3-TLS"}
    assert (rows["low_m"] <= rows["olhd_simulated_m"]).all()
    entries = study.ledger_entries(replicated)
    wanted = ledger.cells().query("source == 'poreba2013' and role == 'result'")
    found = {(entry["table"], entry["cell"]) for entry in entries}
    missing = set(wanted[["table", "cell"]].itertuples(index=False, name=None)) - found
    second = {("table_1", f"Course1-Course3 second {name}") for name in ("p", "q", "pairs")}
    assert missing == second
    assert len(entries) == len(found)


def test_bench_takes_a_method_of_ones_own():
    comparison = study.comparison(quick=True)
    comparison.seeds = (0,)
    comparison.methods = {
        "published": study.METHODS["published"],
        "none": lambda sets: np.zeros((len(sets.test), len(sets.model)), dtype=bool),
    }
    results = comparison.run()
    assert results["f1"].sel({"method": "none"}).max() == 0
    assert len(comparison.tables(results)["f1"]) == 2
    plt.close(comparison.figures(results)["f1"])


def test_extracted_edges_of_a_canyon_are_the_true_ones():
    from mmqa_lab.simulate.canyon import canyon_cloud

    street = canyon(1)
    cloud = canyon_cloud(street, "TLS", density=12, noise=0.01, seed=1)
    row = study.true_edges(lines.extract_edges(cloud), street).iloc[0]
    assert row["shown"] > 0.4 * row["true_edges"]  # setbacks of 0.25 to 1.2 m hide the others
    assert row["error_median_mm"] < 5
    assert row["cover_95"] > 0.8


def test_checks_hold_or_fall_with_the_numbers(replicated):
    runs = small_runs()
    rows = study.replicas(replicated)
    found = list(study.checks(**runs, rows=rows))
    assert len(found) == 6
    said = study.answer(runs["by_weight"], runs["held_out"], rows)
    assert "for W from 0 to 10, and is" in said
    worse = [
        ("by_weight", "f1", "W = 10", -0.5, 0),
        ("by_weight", "rate_percent", "W = 10", -5.0, 1),
        ("by_displacement", "lhd_bias_m", "all", +5.0, 3),
        ("held_out", "f1", "displaced", -1.0, 4),
    ]
    for run, figure, method, change, number in worse:
        spoiled = runs[run].copy(deep=True)
        spoiled[figure].loc[{"method": method}] += change
        assert not list(study.checks(**(runs | {run: spoiled}), rows=rows))[number].passed
    calm = runs["by_noise"].copy(deep=True)
    calm["f1"].loc[{"method": "W = 10"}] = 1.0
    assert not list(study.checks(**(runs | {"by_noise": calm}), rows=rows))[2].passed
    wide = rows.assign(low_m=0.0, high_m=5.0)
    assert list(study.checks(**runs, rows=wide))[5].passed
    assert not list(study.checks(**runs, rows=wide.assign(low_m=4.0)))[5].passed


def test_conditions_refuse_negative_noise():
    with pytest.raises(ValueError, match="Invalid own_m -1"):
        Conditions(own_m=-1)
