"""The study's sweeps, held-out table and checks, on few scenes."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mmqa_lab import lines
from mmqa_lab.published import poreba2013
from mmqa_lab.simulate.canyon import Conditions, canyon
from mmqa_lab.studies import lhd_weight as study
from mmqa_lab.studies.lhd_weight import comparisons, drawings, heldout, sweeps

SMALL = {
    "sensitivities": (0.5,),
    "displacements": (0.5,),
    "angle_noises": (0.4,),
    "jambs": (0.2,),
    "kinds": ("absolute", "repeatability"),
}


@pytest.fixture(scope="module")
def one():
    """Course 1 against the static scanner."""
    return comparisons.comparisons(canyon(5))[3]


@pytest.fixture(scope="module")
def reached():
    """The held-out table of two scenes."""
    return heldout.evaluate((901, 902), matchers=("all", "displaced"))


@pytest.fixture(scope="module")
def swept():
    """W over two scenes."""
    return sweeps.compute(weights=(0, 10, 100), matchers=("all",), seeds=(1, 2), **SMALL)


def test_published_tables_and_what_follows_from_them():
    check = poreba2013.check()
    wrong = check[~check["agrees"]].iloc[0]
    assert check["agrees"].sum() == 13
    assert (wrong["comparison"], wrong["direction"]) == ("C3-TLS", "model-test")
    # Table 2, last row: 99.54 in print, 41 x 64 cells, FN 2, FP 9
    assert wrong["recomputed_percent"] == pytest.approx(100 * (1 - 11 / 2624), abs=1e-9)
    assert round(wrong["recomputed_percent"], 2) == 99.58
    for row in check.itertuples():
        counts = {"p": row.p, "q": row.q, "pairs": row.pairs, "fn": row.fn, "fp": row.fp}
        scores = lines.scores_from_counts(**counts)
        assert row.f1 == pytest.approx(scores.f1)
        assert row.mcc == pytest.approx(scores.mcc)
        assert row.null_rate_percent == pytest.approx(100 * scores.null_rate)
    absolute = check["comparison"].str.contains("TLS")
    assert check.loc[absolute, "f1"].mean() == pytest.approx(0.780, abs=5e-4)
    assert check.loc[~absolute, "f1"].mean() == pytest.approx(0.895, abs=5e-4)
    assert len(poreba2013.table_1()) + len(poreba2013.table_2()) == 14


def test_sweep_is_the_measure_of_each_comparison(swept):
    found = comparisons.comparisons(
        canyon(2, conditions=Conditions(bias_m=(0.5, 0.5))), kinds=("absolute",)
    )
    rows = [
        comparisons.measure(c, weight=10, threshold=lines.peak_threshold, matcher="all")
        for c in found
    ]
    here = swept.sel(weight=10, kind="absolute", seed=2).squeeze(drop=True)
    for name in ("f1", "fp", "lhd_m", "perpendicular_m", "detection_rate"):
        assert here[name].item() == pytest.approx(np.mean([row[name] for row in rows]))
    assert here["true_m"].item() == pytest.approx(np.mean([c.true_length for c in found]))
    assert swept["lhd_m"].attrs["units"] == "m"


def test_measure_agrees_with_the_distance_itself(one):
    found = lines.lhd(one.test, one.model)
    row = comparisons.measure(one, weight=10, threshold=lines.peak_threshold, matcher="all")
    assert row["lhd_m"] == pytest.approx(found.value)
    assert row["lhd_w0_m"] == pytest.approx(found.at_weight(0))
    assert row["perpendicular_m"] == pytest.approx(found.perpendicular_only)


def test_oracle_is_the_best_of_all_thresholds(one):
    distances = one.directions[0][0].distance(10)
    best = max(
        lines.pairing_scores(distances <= delta, one.truth).f1
        for delta in np.unique(distances)[:400]
    )
    assert comparisons.oracle_f1(distances, one.truth) == pytest.approx(best)


def test_truth_of_a_pure_displacement():
    quiet = Conditions(bias_m=(2.0, 2.0), drift_m=0.0)
    scene = canyon(7, conditions=quiet)
    (one,) = comparisons.comparisons(scene, kinds=("absolute",))[:1]
    # the common 2 m, the course's own 0.1-0.35 m, and 0.05 degrees about the centre
    assert 1.5 < one.true_length < 2.5
    assert one.true_perpendicular < one.true_length
    assert np.linalg.norm(one.true_vector) == pytest.approx(one.true_length, abs=0.05)


def test_bands_and_differences(swept):
    f1 = swept["f1"].sel(kind="absolute").squeeze(drop=True)
    bands = sweeps.bands(f1)
    assert (bands["low"] <= bands["mean"]).all()
    assert (bands["mean"] <= bands["high"]).all()
    versus = sweeps.against(f1).set_index("weight")
    assert versus.loc[10, "difference"] == 0
    expected = float((f1.sel(weight=0) - f1.sel(weight=10)).mean())
    assert versus.loc[0, "difference"] == pytest.approx(expected)


def test_shares_add_up_and_grow_with_the_noise():
    table = sweeps.shares((1, 2), weight=10, angle_noises=(0.2, 1.5))
    np.testing.assert_allclose(table[["angle", "parallel", "perpendicular"]].sum(axis=1), 1)
    angle = table.query("kind == 'absolute'").set_index("angle_noise_deg")["angle"]
    assert angle.loc[1.5] > angle.loc[0.2]


def test_angle_noise_is_estimated_from_pairs():
    found = []
    for seed in range(8):
        scene = canyon(seed, conditions=Conditions(angle_noise_deg=1.0))
        (one,) = comparisons.comparisons(scene, kinds=("absolute",))[:1]
        found.append(sweeps.angle_noise(one.test, one.model, one.truth))
    # course 1 degree, static scanner a quarter of it, both with 0.02 m / length
    assert np.mean(found) == pytest.approx(np.hypot(1.0, 0.25), rel=0.25)


def test_held_out_rows_and_targets(reached):
    table = reached
    assert set(table["condition"]) == set(heldout.CONDITIONS)
    base = table.query("condition == 'as in the paper'")
    assert len(base) == 2 * 6 * 2
    assert base["f1"].between(0, 1).all()
    targets = heldout.targets(table).set_index("quantity")
    row = targets.loc["F1, absolute"]
    ours = base.query("kind == 'absolute' and matcher == 'displaced'")["f1"]
    assert row["displaced"] == pytest.approx(ours.mean())
    assert row["low"] <= row["displaced"] <= row["high"]
    assert row["published"] == pytest.approx(0.780, abs=5e-4)
    assert targets["n"].eq(2).all()


def test_readings_start_from_the_default_and_replicas_stand_beside_the_tables():
    readings = heldout.readings((1,))
    first = readings.groupby("question", sort=False).first()
    assert first["f1"].nunique() == first["olhd_m"].nunique() == 1
    weights = readings.query("question == 'denominator'").set_index("reading")["olhd_m"]
    assert weights["all targets"] < weights["pairs"] < weights["matched targets"]
    replicas = heldout.table_replicas((1,))
    counts = replicas["kind_of_number"].value_counts().to_dict()
    assert counts == {"published": 14, "measured (simulated)": 12}


def test_one_to_one_loses_where_edges_are_split():
    table = heldout.one_to_one((1, 2, 3)).groupby(["segmentation", "matcher"])[["fp", "fn"]].mean()
    split, whole = table.loc["as simulated"], table.loc["whole edges"]
    assert split.loc["mutual", "fp"] < split.loc["all", "fp"]
    assert split.loc["mutual", "fn"] > split.loc["all", "fn"]
    assert whole.loc["mutual", "fn"] < split.loc["mutual", "fn"]


def test_matchers_and_thresholds_cross():
    table = heldout.matcher_table((1,))
    assert len(table) == len(heldout.THRESHOLDS) * len(lines.MATCHERS)
    assert table["f1"].between(0, 1).all()


def test_drawings_take_and_return_their_axes(one, swept):
    pairs = one.directions[0][0].distance(10) < 1
    figure, ax = plt.subplots()
    assert drawings.draw_plan(one, pairs, ax=ax) is ax
    assert drawings.draw_matrix(one, ax=ax, weight=10) is ax
    assert drawings.draw_pairs(one, pairs, ax=ax) is ax
    assert drawings.draw_threshold([0.1, 0.2], ax=ax, sensitivity=0.5) is ax
    assert drawings.draw_distance_over_weight(swept, "absolute", ax=ax) is ax
    plt.close(figure)
    for figure in (
        drawings.figure_of_components(5, 3, 1, 6, 10),
        drawings.figure_of_components(0, 0, 0, 10, 0),
        drawings.settings_of(one)(weight=10, sensitivity=0.5),
    ):
        assert len(figure.axes) == 2
        plt.close(figure)


def test_checks_fail_when_the_numbers_do_not_bear_them_out(reached):
    targets = heldout.targets(reached)
    spoiled = targets.assign(displaced=0.1, reached=False, missed=True, n=study.FEWEST_SCENES)
    found = study._checks_on_targets(spoiled)
    assert not any(check.passed for check in found)
    assert len(found) == 1 + len(targets)
    assert [check.passed for check in study._checks_on_tables(poreba2013.check())] == [True, True]
    spoiled = poreba2013.check().assign(agrees=True)
    assert not study._checks_on_tables(spoiled)[0].passed
