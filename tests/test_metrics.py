"""Metrics of the field, each against a closed form or a brute force."""

from mmqa_lab import metrics


def test_the_room_is_there():
    assert metrics.__doc__
