"""The accuracy of point clouds on a test field: heights, plan positions, growth with distance.

EuroSDR 2013, mobile laser scanning, chapter 3 (Finnish Geodetic Institute): five systems on one
field whose ground, poles and corners were surveyed (section 3.1), evaluated after systematic errors
were removed (section 3.2). Start here::

    from mmqa_lab import test_field
    from mmqa_lab.cloud import path_distance

    table = test_field.height_differences(cloud, reference)          # or the reason for none
    test_field.height_accuracy(table)                                # shift kept, shift removed
    table["distance_m"] = path_distance(reference, trajectory)
    test_field.trend(table["distance_m"], (table["dz_m"] - table["dz_m"].mean()).abs())
    test_field.plan_accuracy(test_field.plan_differences(cloud, targets))

ASPRS Positional Accuracy Standards (edition 2, 2023) call the RMSE of height with the shift kept
RMSE_V, that of the plan (equation 3-1) RMSE_H, and add to both the uncertainty of the check points'
own survey. They no longer use 95 % confidence levels, and require 30 check points or more.
"""

from mmqa_lab.test_field.drives import split_drives, thinned, trend
from mmqa_lab.test_field.heights import compare_heights, height_accuracy, height_differences
from mmqa_lab.test_field.plan import (
    FEWEST_ON_CIRCLE,
    POLE_SEARCH_M,
    REPORT_SLICES,
    SLICES,
    plan_accuracy,
    plan_differences,
)

__all__ = [
    "FEWEST_ON_CIRCLE", "POLE_SEARCH_M", "REPORT_SLICES", "SLICES", "compare_heights",
    "height_accuracy", "height_differences", "plan_accuracy", "plan_differences", "split_drives",
    "thinned", "trend",
]  # fmt: skip
