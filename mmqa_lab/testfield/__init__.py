"""The accuracy of point clouds on a test field: heights, plan positions, growth with distance.

EuroSDR 2013, mobile laser scanning, chapter 3 (Finnish Geodetic Institute): five systems on one
field whose ground, poles and corners were surveyed. Start here::

    from mmqa_lab import testfield

    table = testfield.height_differences(cloud.points, reference)   # why, where there is none
    testfield.height_accuracy(table)                                # shift kept, shift removed
    table["distance_m"] = testfield.distance_to_path(reference, trajectory)
    testfield.trend(table["distance_m"], table["dz_m"])

ASPRS Positional Accuracy Standards (edition 2, 2023) speak of the same numbers as RMSE_V of
non-vegetated checkpoints (the RMSE with the shift kept) and RMSE_H (equation 3-1).
"""

from mmqa_lab.testfield.drives import between_drives, split_drives
from mmqa_lab.testfield.heights import height_accuracy, height_differences
from mmqa_lab.testfield.planimetry import (
    corner_positions,
    plan_accuracy,
    pole_positions,
)
from mmqa_lab.testfield.reference import ground_reference, thinned
from mmqa_lab.testfield.trends import Trend, distance_to_path, trend

__all__ = [
    "Trend",
    "between_drives",
    "corner_positions",
    "distance_to_path",
    "ground_reference",
    "height_accuracy",
    "height_differences",
    "plan_accuracy",
    "pole_positions",
    "split_drives",
    "thinned",
    "trend",
]
