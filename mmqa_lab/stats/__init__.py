"""Rates and errors with their intervals: recall and precision, RMSE, bias, NMAD.

Rates have Wilson intervals, statistics of independent values have bootstrap intervals. NaN means
not measurable. ``neighbours`` has intervals of values that depend on their neighbours.
"""

from mmqa_lab.stats.intervals import Interval, bootstrap
from mmqa_lab.stats.neighbours import (
    WAVE_PARTS,
    mean_reach,
    median_interval,
    median_ratio_interval,
    order_parts,
)
from mmqa_lab.stats.rates import CONSISTENT_SCALE, Errors, Rate, errors, wilson

__all__ = [
    "CONSISTENT_SCALE", "WAVE_PARTS", "Errors", "Interval", "Rate", "bootstrap", "errors",
    "mean_reach", "median_interval", "median_ratio_interval", "order_parts", "wilson",
]  # fmt: skip
