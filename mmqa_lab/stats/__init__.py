"""Rates and errors with their intervals: recall and precision, RMSE, bias, NMAD.

Rates have Wilson intervals, means of independent values Student's, other statistics bootstrap
intervals. NaN means not measurable. ``neighbours`` has intervals of values that depend on their
neighbours.
"""

from mmqa_lab.stats.intervals import (
    CONSISTENT_SCALE,
    Errors,
    Interval,
    Rate,
    bootstrap,
    errors,
    mean_interval,
    rank_correlation,
    student_reach,
    wilson,
)
from mmqa_lab.stats.neighbours import (
    WAVE_PARTS,
    mean_reach,
    median_interval,
    median_ratio_interval,
    order_parts,
)

__all__ = [
    "CONSISTENT_SCALE", "WAVE_PARTS", "Errors", "Interval", "Rate", "bootstrap", "errors",
    "mean_interval", "mean_reach", "median_interval", "median_ratio_interval", "order_parts",
    "rank_correlation", "student_reach", "wilson",
]  # fmt: skip
