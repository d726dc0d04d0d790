"""The accuracy of point clouds on a test field: heights, plan positions, growth with distance.

EuroSDR 2013, mobile laser scanning, chapter 3 (Finnish Geodetic Institute): five systems on one
field whose ground, poles and corners were surveyed (section 3.1), evaluated after systematic errors
were removed (section 3.2). Start here::

    from mmqa_lab import testfield

    table = testfield.height_differences(cloud.points, reference)   # why, where there is none
    testfield.height_accuracy(table)                                # shift kept, shift removed
    table["distance_m"] = testfield.distance_to_path(reference, trajectory)
    testfield.trend(table["distance_m"], (table["dz_m"] - table["dz_m"].mean()).abs())

ASPRS Positional Accuracy Standards (edition 2, 2023) call the RMSE of height with the shift kept
RMSE_V, that of the plan (equation 3-1) RMSE_H, and add to both the uncertainty of the check points'
own survey. They have given up 95 % confidence levels, and ask for 30 check points or more.
"""

from mmqa_lab.testfield.heights import (
    between_drives,
    height_accuracy,
    height_differences,
    split_drives,
)
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
