"""The container of points and the argument checks."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.cloud import Cloud

CLOUD = Cloud(np.arange(12.0).reshape(4, 3), {"ring": [1, 2, 3, 4]}, "c", 0.001)


def test_a_cloud_is_an_array():
    assert np.array_equal(np.asarray(CLOUD), CLOUD.points)
    assert np.asarray(CLOUD) is CLOUD.points
    assert np.array(CLOUD) is not CLOUD.points
    assert np.asarray(CLOUD, dtype=np.float32).dtype == np.float32
    assert np.mean(CLOUD, axis=0).tolist() == [4.5, 5.5, 6.5]
    assert [point.tolist() for point in CLOUD] == CLOUD.points.tolist()
    assert CLOUD[-1].tolist() == [9, 10, 11]


@pytest.mark.parametrize(
    "which",
    [[False, True, True, False], slice(1, 3), [1, 2], np.array([1, 2]), pd.Series([1, 2])],
    ids=["mask", "slice", "list", "indices", "series"],
)
def test_masks_slices_and_indices_give_a_cloud(which):
    part = CLOUD[which]
    assert part.points.tolist() == [[3, 4, 5], [6, 7, 8]]
    assert part["ring"].tolist() == [2, 3]
    assert (part.name, part.resolution) == ("c", 0.001)


def test_an_empty_selection_is_an_empty_cloud():
    none = CLOUD[CLOUD["ring"] > 9]
    assert len(none) == 0
    assert none["ring"].tolist() == []
    assert "0 points" in repr(none)


def test_a_missing_column_lists_those_present():
    with pytest.raises(ValueError, match=r"Invalid column 'gps_time'\. Must be one of ring\."):
        CLOUD["gps_time"]


def test_concatenating_keeps_what_all_have():
    a = Cloud(np.zeros((2, 3)), {"ring": [1, 2], "time": [0.0, 1.0]})
    b = Cloud(np.ones((1, 3)), {"ring": [3]})
    both = Cloud.concatenate([a, b])
    assert both["ring"].tolist() == [1, 2, 3]
    assert "time" not in both
    steps = [Cloud(np.zeros((1, 3)), resolution=one) for one in (0.02, np.nan, 0.001)]
    assert Cloud.concatenate(steps).resolution == 0.02
    assert len(Cloud.concatenate([])) == 0
