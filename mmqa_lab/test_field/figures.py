"""The figures that heights and plan positions share."""

from __future__ import annotations

import numpy as np

from mmqa_lab.stats import errors, mean_reach

__all__ = ["GROSS", "LEAST_GROSS_M", "figures", "mean_ends"]


GROSS, LEAST_GROSS_M = 5.0, 0.01
"""Gross errors are farther than this many NMAD, and farther than 1 cm, from the median."""


def figures(values, block):
    """The figures that heights and distances in plan share; a series of values in mm."""
    found = errors(values)
    share = mean_reach(values**2, block) / np.maximum(found.rmse**2, 1e-300) / 2
    return {
        "mean_mm": round(found.bias, 9) + 0.0,  # never -0
        "min_mm": values.min(),
        "max_mm": values.max(),
        "std_mm": found.std,
        "rmse_mm": found.rmse,
        "rmse_low_mm": found.rmse * np.exp(-share),
        "rmse_high_mm": found.rmse * np.exp(share),
    }


def mean_ends(name, values, block):
    """The 95 % interval of a mean, mm."""
    mean, reach = errors(values).bias, mean_reach(values, block)
    return {f"{name}_low_mm": mean - reach, f"{name}_high_mm": mean + reach}
