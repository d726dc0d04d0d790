"""The test-field study: prediction, fit, published tables, ledger, bench, and checks that fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench
from mmqa_lab.simulate import System, system
from mmqa_lab.simulate.testfield import PLAN_STD_M, REFERENCE_STD_M, make_testfield
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    return make_testfield(length_m=48, plan_std_m=PLAN_STD_M, seed=1)


@pytest.fixture(scope="module")
def known(street):
    ground = dict.fromkeys(study.DIRECTIONS, street.ground(spacing_m=2.0, seed=3))
    poles = street.poles[["x_m", "y_m", "z_m"]].to_numpy() + [0, 0, 1]
    return {"ground": ground, "targets": dict.fromkeys(study.DIRECTIONS, poles), "seed": 1}


EXACT = System("exact", system("roamer").heads)


def test_reference_lies_on_the_true_ground_but_where_snow_is(street):
    points = street.ground(spacing_m=1.0, seed=3)
    error = points[:, 2] - street.height(points[:, :2])
    # the standard deviation of n normal errors scatters by 1 / sqrt(2 n)
    assert error.std() == pytest.approx(REFERENCE_STD_M, rel=4 / np.sqrt(2 * len(points)))
    left = street.origin[0] - 2.5
    assert 34 < left - points[:, 0].min() < 35
    snowy = street.ground(spacing_m=1.0, seed=3, snow_share=0.5)
    assert 0.3 < len(snowy) / len(points) < 0.7


def test_targets_reach_45_m_from_the_paths():
    street = make_testfield(length_m=120, seed=1)
    x = street.targets["x_m"] - street.origin[0]
    assert 45 < (2.5 - x).max() < 48
    assert set(street.targets["kind"]) == {"pole", "building", "curb"}


def test_prediction_without_errors_is_the_survey_and_range_noise(street, known):
    found = study.predicted(street, EXACT, **known, draws=10)
    least, most = 1000 * REFERENCE_STD_M, 1000 * np.hypot(REFERENCE_STD_M, np.sqrt(0.5) * 0.002)
    height = found["height_std_mm"].mean()
    assert least * 0.95 < height < most * 1.02
    # Rayleigh: root of the sum of two variances; two means are removed from a dozen poles
    assert found["plan_rmse_mm"].mean() == pytest.approx(20, rel=0.15)


def test_prediction_of_a_wrong_roll_is_its_lever(street, known):
    found = study.predicted(street, study._rolled(EXACT, 0.2), **known, draws=3)
    across = known["ground"]["there"][:, 0].std()
    expected = 1000 * np.hypot(np.radians(0.2) * across, REFERENCE_STD_M)
    assert found["height_std_mm"].mean() == pytest.approx(expected, rel=0.02)


def test_fit_gives_the_figure_it_is_fitted_to(street, known):
    fitted = study.fitted_system(street, **known, draws=10)
    roll, *others = fitted.heads[0].boresight_deg
    assert roll > 0.05
    assert others == [0, 0]
    there = {"ground": {"there": known["ground"]["there"]}, "targets": known["targets"], "seed": 1}
    found = study.predicted(street, fitted, **there, draws=10)
    assert found["height_std_mm"].median() == pytest.approx(39, abs=0.5)


def test_places_are_those_within_reach_and_in_view(street):
    both = study.places(street, EXACT, {"there": 11.0, "back": 20.0})
    path = street.origin[0] + 2.5
    assert 9 < np.abs(both["ground"]["there"][:, 0] - path).max() <= 11.0
    assert 38 < np.abs(both["targets"]["there"][:, 0] - path).max() <= 45.0
    right = study.places(street, system("sensei"))
    # 35 degrees from the nadir of a head 2.5 m up and 0.4 m to the right
    nearest = 0.4 + 2.5 * np.tan(np.radians(35))
    assert right["ground"]["there"][:, 0].min() - path == pytest.approx(nearest, abs=4)
    assert (right["ground"]["there"][:, 0] - path >= nearest).all()
    assert right["ground"]["there"][:, 0].min() > path
    assert right["ground"]["back"][:, 0].max() < street.origin[0] - 2.5


def test_published_rows_are_those_of_the_tables():
    rows = study.published_rows().set_index("cell")
    assert len(rows) == 14 + 12 * 3
    # printed: Table 3-3, ROAMER II CCW, 2.0 cm; Table 3-4, Optech Lynx CW, RMSE 4.3 cm
    assert rows["published_mm"]["ROAMER II CCW std"].max() == 20
    assert rows["published_mm"]["Optech Lynx CW rmse"] == 43
    assert rows["direction"]["Optech Lynx CW rmse"] == "back"


def test_ledger_says_which_rows_are_fitted(street, known):
    drawn = study.predicted(street, EXACT, **known, draws=5)
    names = set(study.TOLD["stands_for"].values())
    table = study.prediction_table(dict.fromkeys(names, drawn))
    nothing = pd.DataFrame(columns=["system", "direction", "figure", "measured_mm"])
    every = study.against_published(table, nothing)
    entries = pd.DataFrame(study.ledger_entries(every))
    assert len(entries) == 14 + 12 * 3
    fitted = entries["kind"] == "fitted"
    assert entries.loc[fitted, "cell"].tolist() == ["ROAMER I CCW std", "ROAMER I CW std"]
    row = entries[entries["cell"] == "ROAMER II CCW rmse"].iloc[0]
    middle = drawn[drawn["direction"] == "there"]["plan_rmse_mm"].median()
    assert row["value"] == pytest.approx(middle / 10)


def test_columns_are_close_within_a_quarter_or_explained():
    rows = study.published_rows().assign(kind="predicted", off=0.2, predicted_mm=25.8)
    rows.loc[rows["cell"] == "Optech Lynx CW rmse", "off"] = -0.4
    found = study.columns(rows)
    assert len(found) == 26
    assert found["close"].sum() == 25
    # root of 43^2 - 25.8^2
    assert found["missing_mm"].dropna().tolist() == pytest.approx([34.4])
    assert found.loc[~found["close"], "missing"].item() == study.TOLD["missing"]["Optech Lynx"]


def test_bench_scores_a_true_mounting_and_none():
    comparison = study.comparison(quick=True)
    survey, _ = comparison.make("exact", 0.003, seed=1)
    none = comparison.score(study.as_installed(survey), survey)
    true = comparison.score(survey.true_values, survey)
    assert none["angle_deg"] == 0.25
    assert none["arm_mm"] == pytest.approx(40)
    assert true["angle_deg"] == 0
    assert true["pole_rmse_mm"] < 8 < none["pole_rmse_mm"]


HEIGHTS = pd.DataFrame([("roamer I", 39.0), ("roamer", 11.0)], columns=["system", "std_mm"]).assign(
    shift="removed", direction="there"
)
PREDICTIONS = pd.DataFrame(
    [("roamer I", 37.0, 41.0), ("roamer", 10.0, 12.0)],
    columns=["system", "low_mm", "high_mm"],
).assign(direction="there", figure="height_std")
COMPARED = pd.DataFrame({"close": [True] * 21 + [False] * 5, "kind": "predicted"})
DRIVES = pd.DataFrame({"measured_mm": [3.0] * 30, "predicted_mm": [3.0, 3.1, 2.9] * 10})
CALIBRATIONS = pd.DataFrame(
    [("as installed", 0.25, 40.0, 50.0), ("planes, poles, control", 0.002, 2.0, 15.0)],
    columns=["method", "angle_deg", "arm_mm", "pole_rmse_mm"],
).assign(navigation="exact", reference_std_m=0.003)
REAL = pd.DataFrame(
    {"comparison": ["drive 1", "drive 2", "drive 1 - drive 2"], "mean_mm": [-62.0, -48.0, -14.0]}
).assign(shift="kept")


def passed(**changed):
    given = {
        "heights": HEIGHTS,
        "compared": COMPARED,
        "predictions": PREDICTIONS,
        "drives": DRIVES,
        "calibrations": CALIBRATIONS,
        "real": REAL,
    }
    return [check.passed for check in study.checks(**{**given, **changed})]


def test_tables_and_figure_of_a_calibration_that_failed():
    def broken(survey):
        raise ValueError("Invalid drives: they do not determine the mounting.")

    cases = bench.grid(navigation=("exact", "good"), reference_std_m=(0.003, 0.011))
    methods = {"as installed": lambda _: 70.0, "planes, poles, control": lambda _: 4.0}
    choices = {
        "make": lambda navigation, reference_std_m, seed: navigation,
        "score": lambda value, _: {"pole_rmse_mm": value, "angle_deg": 0.0, "arm_mm": 0.0},
    }
    with pytest.warns(UserWarning, match="do not determine"):
        results = bench.run(cases, methods | {"broken": broken}, **choices)
    table = study.calibration_tables(results)["calibrations"]
    assert table.set_index("method")["pole_rmse_mm"]["broken"].isna().all()
    assert list(study.calibration_figures(results)) == ["calibrations"]
    assert all(check.passed for check in study._calibrated(table))


@pytest.mark.parametrize(
    ("number", "changed"),
    [
        (0, {"heights": HEIGHTS.assign(std_mm=[14.0, 11.0])}),
        (1, {"compared": COMPARED.assign(close=[True] * 19 + [False] * 7)}),
        (2, {"predictions": PREDICTIONS.assign(low_mm=50.0, high_mm=60.0)}),
        (3, {"drives": DRIVES.assign(measured_mm=9.0)}),
        (4, {"calibrations": CALIBRATIONS.assign(angle_deg=0.02)}),
        (5, {"calibrations": CALIBRATIONS.assign(pole_rmse_mm=[50.0, 30.0])}),
        (6, {"real": REAL.assign(mean_mm=[-62.0, -48.0, -40.0])}),
    ],
)
def test_each_check_can_fail(number, changed):
    assert all(passed())
    assert not passed(**changed)[number]
