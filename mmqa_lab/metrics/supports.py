"""What a surface supports: the smallest step, tilt, detail and volume, with 95 %."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mmqa_lab.metrics.registry import METRICS

__all__ = ["supports"]

CURVES = Path(__file__).with_name("curves.csv")
"""Of the stored run of study 12: its table ``supported``, written when the run is stored."""


def supports(quality: Any) -> pd.DataFrame:
    """Return what can be measured on surfaces like that of a chart, with 95 %.

    Parameters
    ----------
    quality : CloudQuality

    Returns
    -------
    DataFrame
        For the smallest ``thing`` (step, tilt, detail, volume): ``value`` (NaN where the chart's
        metric lies outside of what was tried), ``unit``, ``of`` what, the ``metric`` it follows
        from with its ``measured`` value, ``n`` simulated acquisitions of the ``kinds`` of
        scanners, and ``remarks``.

    Notes
    -----
    The curves are fitted on simulated drives of study 12 (notebook 12), in half of which the chart
    stood elsewhere than the thing. Errors of the navigation are not in them.

    Examples
    --------
    >>> from mmqa_lab.chart_cloud import evaluate_cloud
    >>> points = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * [1, 1, 0.01]
    >>> supports(evaluate_cloud(points))["thing"].tolist()
    ['step', 'tilt', 'detail', 'volume']
    """
    table = pd.read_csv(CURVES)
    measured = np.array([METRICS[name](quality) for name in table["metric"]])
    with np.errstate(divide="ignore"):
        values = table["factor"] * np.exp(table["intercept"] + table["slope"] * np.log(measured))
    inside = (measured >= table["low"]) & (measured <= table["high"])
    said = [
        f"Fitted on simulated acquisitions (n = {n})."
        if known
        else f"{metric} lies outside of what was tried, {low:.3g} to {high:.3g}."
        for n, metric, low, high, known in zip(
            table["n"], table["metric"], table["low"], table["high"], inside, strict=True
        )
    ]
    found = {"thing": table["thing"], "value": values.where(inside), "unit": table["unit"]}
    found |= {"of": table["of"], "metric": table["metric"], "measured": measured}
    return pd.DataFrame(found | {"n": table["n"], "kinds": table["kinds"], "remarks": said})
