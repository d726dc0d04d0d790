"""The test-field study: prediction, fit, published tables, ledger, bench, and checks that fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench
from mmqa_lab.simulate.testfield import REFERENCE_STD_M, System, make_testfield, systems
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    return make_testfield(length_m=48, seed=1)


@pytest.fixture(scope="module")
def ground(street):
    return dict.fromkeys(study.DIRECTIONS, street.ground(spacing_m=2.0, seed=3))


@pytest.fixture(scope="module")
def targets(street):
    return dict.fromkeys(
        study.DIRECTIONS, street.poles[["x_m", "y_m", "z_m"]].to_numpy() + [0, 0, 1]
    )


def test_reference_lies_on_the_true_ground(street):
    points = street.ground(spacing_m=1.0, seed=3)
    error = points[:, 2] - street.height(points[:, :2])
    # the standard deviation of n normal errors scatters by 1 / sqrt(2 n)
    assert error.std() == pytest.approx(REFERENCE_STD_M, rel=4 / np.sqrt(2 * len(points)))
    left = street.origin[0] - 2.5
    assert 34 < left - points[:, 0].min() < 35


def test_prediction_without_errors_is_the_survey_and_range_noise(street, ground, targets):
    perfect = System("perfect", systems()["profiler"].heads)
    found = study.predicted(street, perfect, ground, targets, draws=10, seed=1)
    least, most = 1000 * REFERENCE_STD_M, 1000 * np.hypot(REFERENCE_STD_M, np.sqrt(0.5) * 0.002)
    height = found["height_std_mm"].mean()
    assert least * 0.95 < height < most * 1.02
    # Rayleigh: root of the sum of two variances; two means are removed from a dozen poles
    assert found["plan_rmse_mm"].mean() == pytest.approx(
        1000 * np.sqrt(2) * REFERENCE_STD_M, rel=0.15
    )


def test_prediction_of_a_wrong_roll_is_its_lever(street, ground, targets):
    exact = System("exact", systems()["profiler"].heads)
    rolled = study._with_boresight(exact, (0.2, 0.0, 0.0))
    found = study.predicted(street, rolled, ground, targets, draws=3, seed=1)
    across = ground["there"][:, 0].std()
    expected = 1000 * np.hypot(np.radians(0.2) * across, REFERENCE_STD_M)
    assert found["height_std_mm"].mean() == pytest.approx(expected, rel=0.02)


def test_fit_gives_the_two_figures_it_is_fitted_to(street, ground, targets):
    choices = {"draws": 10, "seed": 1}
    fitted = study.fitted_system(street, ground, targets, **choices)
    roll, pitch, heading = fitted.heads[0].boresight_deg
    found = study.predicted(street, fitted, {"there": ground["there"]}, targets, **choices).median(
        numeric_only=True
    )
    assert roll > 0.05
    assert pitch == 0
    assert heading > 0.05
    # the roll was fitted before the heading, which changes heights of flat ground little
    assert found["height_std_mm"] == pytest.approx(39, abs=0.5)
    assert found["plan_rmse_mm"] == pytest.approx(39, abs=0.1)


def test_published_rows_are_those_of_the_tables():
    rows = study.published_rows().set_index("cell")
    assert len(rows) == 14 + 12 * 3
    # printed: Table 3-3, ROAMER II CCW, 2.0 cm; Table 3-4, Optech Lynx CW, RMSE 4.3 cm
    assert rows["published_mm"]["ROAMER II CCW std"].max() == 20
    assert rows["published_mm"]["Optech Lynx CW rmse"] == 43
    assert rows["direction"]["Optech Lynx CW rmse"] == "back"


def test_ledger_says_which_rows_are_fitted(street, ground, targets):
    drawn = study.predicted(street, systems()["profiler"], ground, targets, draws=5, seed=1)
    table = study.prediction_table({"profiler": drawn, "profiler, not calibrated": drawn})
    nothing = pd.DataFrame(columns=["system", "direction", "figure", "measured_mm"])
    entries = pd.DataFrame(study.ledger_entries(study.against_published(table, nothing)))
    # two systems, two directions, one figure of heights and three in plan
    assert len(entries) == 16
    kinds = entries.groupby(entries["cell"].str.startswith("ROAMER II"))["kind"].unique()
    assert kinds[True].tolist() == ["predicted"]
    assert kinds[False].tolist() == ["fitted"]
    row = entries[entries["cell"] == "ROAMER II CCW rmse"].iloc[0]
    middle = drawn[drawn["direction"] == "there"]["plan_rmse_mm"].median()
    assert row["value"] == pytest.approx(middle / 10)


def test_bench_scores_a_true_mounting_and_none():
    comparison = study.comparison(quick=True)
    survey, _ = comparison.make("exact", 0.003, seed=1)
    none = comparison.score(study.as_installed(survey), survey)
    true = comparison.score(survey.true_values, survey)
    assert none["angle_deg"] == 0.25
    assert none["arm_mm"] == pytest.approx(40)
    assert true["angle_deg"] == 0
    assert true["pole_rmse_mm"] < 8 < none["pole_rmse_mm"]


HEIGHTS = pd.DataFrame(
    [("profiler, not calibrated", 39.0), ("profiler", 11.0)], columns=["system", "std_mm"]
).assign(shift="removed", direction="there")
PREDICTIONS = pd.DataFrame(
    [("profiler, not calibrated", 37.0, 41.0), ("profiler", 10.0, 12.0)],
    columns=["system", "low_mm", "high_mm"],
).assign(direction="there", figure="height_std")
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
        (1, {"predictions": PREDICTIONS.assign(low_mm=50.0, high_mm=60.0)}),
        (2, {"drives": DRIVES.assign(measured_mm=9.0)}),
        (3, {"calibrations": CALIBRATIONS.assign(angle_deg=0.02)}),
        (4, {"calibrations": CALIBRATIONS.assign(pole_rmse_mm=[50.0, 30.0])}),
        (5, {"real": REAL.assign(mean_mm=[-62.0, -48.0, -40.0])}),
    ],
)
def test_each_check_can_fail(number, changed):
    assert all(passed())
    assert not passed(**changed)[number]
