"""The test-field study: prediction, fit, published tables, ledger, bench, and checks that fail."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.published import ledger
from mmqa_lab.rotations import rotations
from mmqa_lab.simulate import System, system
from mmqa_lab.simulate.test_field import REFERENCE_STD_M, make_test_field
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    # a surveyed position is known to about 2 cm (section 3.3.2), in both coordinates together
    return make_test_field(length_m=48, plan_std_m=0.02 / np.sqrt(2), seed=1)


@pytest.fixture(scope="module")
def known(street):
    ground = dict.fromkeys(study.DIRECTIONS, street.ground(spacing_m=2.0, seed=3))
    poles = street.poles[["x_m", "y_m", "z_m"]].to_numpy() + [0, 0, 1]
    return {"ground": ground, "targets": dict.fromkeys(study.DIRECTIONS, poles), "seed": 1}


EXACT = System("exact", system("roamer").heads)


def test_prediction_without_errors_is_the_survey_and_range_noise(street, known):
    found = study.predicted(street, EXACT, **known, draws=10)
    least, most = 1000 * REFERENCE_STD_M, 1000 * np.hypot(REFERENCE_STD_M, np.sqrt(0.5) * 0.002)
    assert least * 0.95 < found["height_std_mm"].mean() < most * 1.02
    # Rayleigh: root of the sum of two variances; two means are removed from a dozen poles
    assert found["plan_rmse_mm"].mean() == pytest.approx(20, rel=0.15)


def test_prediction_of_a_wrong_roll_is_its_lever(street, known):
    head = replace(EXACT.heads[0], boresight_deg=(0.2, 0, 0))
    found = study.predicted(street, System("rolled", (head,)), **known, draws=3)
    across = known["ground"]["there"][:, 0].std()
    expected = 1000 * np.hypot(np.radians(0.2) * across, REFERENCE_STD_M)
    assert found["height_std_mm"].mean() == pytest.approx(expected, rel=0.02)


def test_places_are_those_in_view(street):
    path = street.origin[0] + 2.5
    both = study.places(street, EXACT)
    assert 38 < np.abs(both["targets"]["there"][:, 0] - path).max() <= 45.0
    assert np.ptp(both["ground"]["there"][:, 0]) < study.STRIP_M
    right = study.places(street, system("sensei"))["ground"]
    # 35 degrees from the nadir of a head 2.5 m up and 0.4 m to the right
    nearest = 0.4 + 2.5 * np.tan(np.radians(35))
    assert nearest <= right["there"][:, 0].min() - path < nearest + 4
    assert right["back"][:, 0].max() < street.origin[0] - 2.5


def test_published_rows_are_those_of_the_tables():
    rows = study.published_rows().set_index("cell")
    assert len(rows) == 14 + 12 * 3
    # printed: Table 3-3, ROAMER II CCW, 2.0 cm; Table 3-4, Optech Lynx CW, RMSE 4.3 cm
    assert rows["published_mm"]["ROAMER II CCW std"].max() == 20
    assert rows["published_mm"]["Optech Lynx CW rmse"] == 43
    assert rows["direction"]["Optech Lynx CW rmse"] == "back"


def test_every_printed_figure_stands_beside_its_prediction(street, known):
    drawn = study.predicted(street, EXACT, **known, draws=5)
    table = study.prediction_table(dict.fromkeys(study.STANDS_FOR.values(), drawn))
    every = study.against_published(table)
    columns = study.columns(every)
    assert len(columns) == 26
    off = columns["predicted_mm"] / columns["published_mm"] - 1
    assert (columns["close"] == (off.abs() <= 0.25)).all()
    wanted = ledger.cells().query("source == 'eurosdr2013_mls' and role == 'result'")
    wanted = wanted[wanted["table"].isin(["table_3_3", "table_3_4"])]
    found = set(every[["table", "cell"]].itertuples(index=False, name=None))
    assert found <= set(wanted[["table", "cell"]].itertuples(index=False, name=None))
    assert len(found) == 14 + 12 * 3
    fitted = every["kind"] == "fitted"
    assert every.loc[fitted, "cell"].tolist() == ["ROAMER I CCW std", "ROAMER I CW std"]
    row = every[every["cell"] == "ROAMER II CCW rmse"].iloc[0]
    middle = drawn[drawn["direction"] == "there"]["plan_rmse_mm"].median()
    assert row["predicted_mm"] == pytest.approx(middle)


def test_bench_scores_a_true_mounting_and_none():
    methods = {"as installed": study.as_installed, "true": lambda survey: survey.true_values}
    choices = {"navigation": ("exact",), "reference_std_m": (0.003,), "pulses_per_s": 60_000}
    results = study.bench(methods=methods, **choices).run()
    table = study.calibration_tables(results)["calibrations"].set_index("method")
    none, true = table.loc["as installed"], table.loc["true"]
    assert none["angle_deg"] == 0.25
    assert none["arm_mm"] == pytest.approx(40)
    assert true["angle_deg"] == 0
    assert true["pole_rmse_mm"] < 8 < none["pole_rmse_mm"]


def test_each_check_can_fail():
    baseline = pd.DataFrame({"columns": [14]}, ["height_std"])
    rest = pd.Series({0.003: 4.0})
    real = {"relative": 19.0, "absolute": 48.0, "samples": None}
    whole = {"agree": 0.1, "by_sheets": 14, "by_constant": 8, "baseline": baseline}
    whole |= {"off": {False: 0.001, True: 0.001}}
    whole |= {"passed": True, "covered": pd.Series([True]), "largest": 1.1, "rest": rest}
    whole |= {"before": 10 * rest, "mean": {"I": 30.0, "II": 13.0}} | real
    whole |= {"held": 10, "of_drives": 10, "strict": 9, "strict_constant": 8}
    assert spoiled("test_field", whole) == []
    changes = {
        "The root of squares": {"agree": 0.4},
        "Simulated heights fall": {"held": 7},
        "Sheets meet": {"by_sheets": 8},
        "Sheets meet more heights": {"strict": 8},
        "Two drives determine": {"passed": False},
        "Calibration makes": {"largest": 3.0},
        "A roll of tenths": {"mean": {"I": 15.0, "II": 13.0}},
    }
    for words, change in changes.items():
        (failed,) = spoiled("test_field", whole | change)
        assert failed.startswith(words)


def test_public_sweeps_are_moved_onto_each_other_and_their_heights_compared(monkeypatch, tmp_path):
    rng = np.random.default_rng(1)
    plan = rng.uniform(-4, 4, (40_000, 2))
    ground = np.column_stack([plan, rng.normal(-1.9, 0.003, len(plan))])
    turn = rotations(0.01, -0.005, 0.7)
    there = (ground - [0.0, 0.0, 0.015] - [2.0, 1.0, 0.1]) @ turn  # 15 mm lower
    monkeypatch.setenv("MMQA_CACHE", str(tmp_path))
    assert not any(map(study.samples.has_real, study.SWEEPS))
    files = {name: tmp_path / f"{name}.xyz" for name in study.SWEEPS}
    pose = np.vstack([np.column_stack([turn, [2.0, 1.0, 0.1]]), [0, 0, 0, 1]])
    for file, rows in zip(files.values(), (ground, there, pose), strict=True):
        np.savetxt(file, rows)
    monkeypatch.setattr(study.samples, "real_path", files.get)
    kept = study.sweep_heights(spacing=0.5).set_index("shift").loc["kept"]
    assert kept["n"] > 100
    assert kept["mean_mm"] == pytest.approx(-15, abs=0.5)
    assert kept["std_mm"] < 2


def test_drives_are_adjusted_once_for_all_surveys(monkeypatch):
    asked = []

    def calibrate(drives, lever_arms_m):
        asked.append(drives)
        return SimpleNamespace(values=np.zeros((2, 6)))

    monkeypatch.setattr(study, "calibrate", calibrate)
    small = {"length_m": 40, "pulses_per_s": 2_000, "navigation": ("exact",)}
    with warnings.catch_warnings(action="ignore"):  # so few points show no pole
        study.bench({"planes": study.from_planes}, **small, reference_std_m=(0.003, 0.011)).run()
    assert len(asked) == 1
