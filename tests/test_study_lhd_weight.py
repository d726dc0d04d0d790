"""The study of the line-segment Hausdorff distance: its scenes, scores, tables and checks."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab import lines
from mmqa_lab.simulate.canyon import canyon, canyon_cloud, canyon_edges
from mmqa_lab.studies import lhd_weight as study


@pytest.fixture(scope="module")
def one():
    """Course 1 against the static scanner, and what is true."""
    return study.scene("C1-TLS", seed=5)


@pytest.fixture(scope="module")
def replicated():
    """The published method on the six comparisons of three scenes."""
    method = {"published": study.METHODS["published"]}
    return study.bench(methods=method, seeds=range(3), scored=study.score_directions).run()


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
        right = row.pairing_existing - row.false_negative
        precision, recall = right / (right + row.false_positive), right / row.pairing_existing
        assert row.f1 == pytest.approx(2 / (1 / precision + 1 / recall))
        cells = row.p_test_segments * row.q_model_segments
        assert row.null_rate_percent == pytest.approx(100 - 100 * row.pairing_existing / cells)
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
    distances = lines.components(sets.test, sets.model).distance(10)
    back = lines.components(sets.model, sets.test).distance(10)
    rows, columns = np.nonzero(truth.pairs)
    by_hand = max(
        np.average(distances[rows, columns], weights=lines.lengths(sets.model)[columns]),
        np.average(back[columns, rows], weights=lines.lengths(sets.test)[rows]),
    )
    assert exact["lhd_m"] == pytest.approx(by_hand)
    plain = max(distances.min(axis=1).max(), back.min(axis=1).max())  # equations 1 and 2
    found = study.METHODS["plain Hausdorff"](sets)
    assert found == pytest.approx(plain)
    assert study.score(found, truth)["lhd_m"] == found


def test_truth_of_a_pure_displacement():
    _, truth = study.scene("C1-TLS", seed=7, displacement_m=2.0)
    # 2 m, 0.09 m of the course, a drift of 0.08 m and 0.05 degrees about the centre, 80 m away
    assert truth.mean(truth.displacements) == pytest.approx(2.0, abs=0.25)
    assert truth.mean(truth.across) < truth.mean(truth.displacements)


def test_replicas_cover_both_tables(replicated):
    rows = study.replicas(replicated)
    assert len(rows) == 14
    assert set(rows.loc[rows["kind"] == "fitted", "name"]) == set(study.FITTED)
    assert set(rows.loc[rows["kind"] == "predicted", "name"]) == {"C1-C3", "C2-C3", "C3-TLS"}
    assert (rows["low_m"] <= rows["simulated_m"]).all()


def test_bench_takes_a_method_of_ones_own():
    own = {"none": lambda sets: np.zeros((len(sets.test), len(sets.model)), dtype=bool)}
    results = study.bench(methods=own, seeds=(0,), comparison=("C1-C3",)).run()
    assert results["f1"].sel({"method": "none"}).max() == 0


def test_extracted_edges_of_a_canyon_lie_on_the_true_ones():
    street = canyon(1)
    cloud = canyon_cloud(street, "TLS", density=12, noise=0.01, seed=1)
    true = canyon_edges(street)
    found = lines.match_displaced(lines.extract_edges(cloud).segments, true)
    assert found.pairs.any(axis=0).sum() > 0.4 * len(true)  # setbacks under 1.2 m hide the others
    assert np.abs(found.vector).max() < 0.002


def test_surveys_split_cut_and_invent_as_many_edges_as_they_should():
    """Of edges: 35 % are cut short, of long ones 12 % in two; 8 % as many are clutter."""
    counts = np.zeros(3)
    for scene in (canyon(1), canyon(2), canyon(3)):
        sizes = lines.lengths(scene.edges)
        for survey in scene.surveys.values():
            real = survey.edge >= 0
            rows = pd.DataFrame(survey.interval[real]).groupby(survey.edge[real])
            low, high, pieces = rows[0].min(), rows[1].max(), rows.size()
            long = high - low >= 3
            shares = (high - low < sizes[low.index] - 1e-9).mean(), (pieces[long] == 2).mean()
            counts += np.array([*shares, (~real).sum() / len(rows)]) / 12
    assert counts == pytest.approx([0.35, 0.12, 0.08 * 1.1], abs=0.06)


def test_canyon_refuses_negative_noise():
    with pytest.raises(ValueError, match=r"Invalid angle_noise_deg -0\.1"):
        canyon(1, angle_noise_deg=-0.1)


def test_checks_of_the_notebook_fail_with_other_numbers():
    """Each check, with numbers that would make its statement false and with the true ones."""
    false = {"plateau": 0.2, "tolerance": 0.03, "moved": 3.0, "saturated": 0.1, "across": 0.2}
    false |= {"others": pd.Series({"W = 1": 0.8})}
    false |= {"loud": pd.Series({"W = 10": 0.8})}
    false |= {"gain": pd.Series([0.1, 0.2]), "factor": 2.0, "least": -0.1}
    false |= {"rows": range(14), "blind": np.arange(14) > 7, "follow": [True] * 14}
    assert len(spoiled("lhd_weight", false | {"reached": np.zeros(14, dtype=bool)})) == 7
    true = false | {"plateau": 0.01, "moved": 0.1, "saturated": -0.9, "across": 0.01, "least": 0.1}
    true |= {"loud": pd.Series({"W = 10": 0.7, "W = 0": 0.8}), "follow": [True] * 13 + [False]}
    assert not spoiled("lhd_weight", true | {"reached": np.ones(14, dtype=bool)})


def test_plain_hausdorff_is_the_largest_nearest_distance(one):
    """Equations 1 and 2, by brute force."""
    sets = one[0]
    there = lines.components(sets.test, sets.model).distance(10).tolist()
    back = lines.components(sets.model, sets.test).distance(10).tolist()
    directed = [max(min(row) for row in matrix) for matrix in (there, back)]
    assert study.METHODS["plain Hausdorff"](sets) == pytest.approx(max(directed))
