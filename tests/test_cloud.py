"""The container of points and the argument checks."""

import numpy as np
import pytest

from mmqa_lab._checks import check_choice, check_count, check_number, check_points, check_positive
from mmqa_lab.cloud import Cloud


def test_columns_follow_their_points():
    cloud = Cloud(np.arange(12.0).reshape(4, 3), {"ring": [1, 2, 3, 4]}, "c")
    part = cloud.select([3, 0])
    assert part["ring"].tolist() == [4, 1]
    assert part.points[:, 0].tolist() == [9, 0]
    assert part.name == "c"


def test_concatenating_keeps_what_all_have():
    a = Cloud(np.zeros((2, 3)), {"ring": [1, 2], "time": [0.0, 1.0]})
    b = Cloud(np.ones((1, 3)), {"ring": [3]})
    both = Cloud.concatenate([a, b])
    assert both["ring"].tolist() == [1, 2, 3]
    assert "time" not in both
    assert len(Cloud.concatenate([])) == 0


def test_frame_has_units_in_its_names():
    frame = Cloud([[1, 2, 3]], {"ring": [7], "rgb": [[1, 2, 3]]}).to_frame()
    assert frame.columns.tolist() == ["x_m", "y_m", "z_m", "ring"]


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Cloud([[0, 0, 0]], {"ring": [1, 2]}), "Invalid column 'ring' of shape (2,)."),
        (lambda: Cloud([[0, 0, 0]])["ring"], "Must be one of those present: none."),
        (lambda: Cloud([[0, 0, np.inf]]), "1 of 1 not finite, the first in row 0"),
        (lambda: check_points([[1, 2, "x"]]), "Must be real numbers."),
        (lambda: check_points(np.zeros((2, 3)), minimum=3), "2 given. Must be 3 or more."),
        (lambda: check_positive(0, "radius", unit="m"), "Invalid radius 0. Must be > 0 m."),
        (lambda: check_positive(True, "radius"), "Invalid radius True. Must be a number."),
        (lambda: check_number("5", "speed"), "Invalid speed '5'. Must be a number."),
        (lambda: check_number(-1, "speed", low=0, unit="m/s"), "Must be >= 0 m/s."),
        (lambda: check_number(9, "share", high=1), "Invalid share 9. Must be <= 1."),
        (lambda: check_number(float("nan"), "speed"), "Invalid speed nan. Must be finite."),
        (lambda: check_count(2.5, "repeats"), "Invalid repeats 2.5. Must be a whole number >= 1."),
        (lambda: check_count(float("nan"), "n"), "Invalid n nan. Must be a whole number >= 1."),
        (lambda: check_choice("x", "axes", ("a", "b")), "Invalid axes 'x'. Must be one of a, b."),
    ],
)
def test_rejects(call, sentence):
    with pytest.raises((ValueError, TypeError)) as error:
        call()
    assert sentence in str(error.value)
