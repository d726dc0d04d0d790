"""The test-field study: prediction against simulation, and the published tables."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.published import eurosdr2013_testfield as published
from mmqa_lab.simulate.testfield import SURVEY_STD_M, System, make_testfield, systems
from mmqa_lab.studies import test_field as study
from mmqa_lab.studies.test_field import surveys


@pytest.fixture(scope="module")
def street():
    return make_testfield(length_m=48, seed=1)


def test_missing_cells_stay_missing():
    for table in study.published_check().values():
        assert table["agrees"].isna().all()
        assert "all cells" in table.attrs["missing"]
    assert published.statements().attrs["source"].endswith("abstract")


def test_reference_lies_on_the_true_ground(street):
    points = street.ground(spacing_m=1.0, seed=3)
    error = points[:, 2] - street.height(points[:, :2])
    # the standard deviation of n normal errors scatters by 1 / sqrt(2 n)
    assert error.std() == pytest.approx(SURVEY_STD_M, rel=4 / np.sqrt(2 * len(points)))


def test_what_cannot_be_held_against_table_3_3_says_why():
    names = ["system", "direction", "shift", "std_mm", "predicted_std_mm"]
    rows = [("profiler", "both", "removed", 9.0, 8.0), ("profiler", "there", "removed", 7.0, None)]
    found = surveys.against_published(pd.DataFrame(rows, columns=names))
    assert found["measured_std_mm"].tolist() == [9.0]
    assert found["within_20_percent"].tolist() == [None]
    assert "not at hand" in found["reason"].item()


def test_prediction_without_errors_is_the_survey_and_range_noise(street):
    perfect = System("perfect", systems()["profiler"].heads)
    reference = street.ground(spacing_m=1.0, seed=3)
    found = surveys.predicted_std(street, perfect, reference, draws=10, seed=1)
    least, most = 1000 * SURVEY_STD_M, 1000 * np.hypot(SURVEY_STD_M, np.sqrt(0.5) * 0.002)
    assert least * 0.95 < found.mean() < most * 1.02


def test_a_wrong_mounting_has_no_prediction(street):
    reference = street.ground(spacing_m=4.0, seed=3)
    off = systems()["profiler, not calibrated"]
    assert np.isnan(surveys.predicted_std(street, off, reference, draws=3, seed=1)).all()


def test_checks_can_fail():
    repeated = pd.DataFrame({"measured_mm": [9.0] * 30, "predicted_mm": [3.0, 3.1, 2.9] * 10})
    rows = [("profiler", "removed", 9.0, 3.0, 2.0, 4.0), ("other", "removed", 9.0, 3.0, 2.0, 4.0)]
    names = ["system", "shift", "std_mm", "predicted_std_mm"]
    heights = pd.DataFrame(rows, columns=[*names, "predicted_low_mm", "predicted_high_mm"])
    found = study._against_prediction(heights, repeated)
    assert not any(check.passed for check in found)
