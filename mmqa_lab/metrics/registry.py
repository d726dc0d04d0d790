"""The registry of metrics: each with its source and what it misses; what a surface supports.

A metric is called with a chart, a :class:`~mmqa_lab.chart_cloud.CloudQuality`. What cannot be
measured is NaN; :meth:`Metric.measure` gives the reason as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from mmqa_lab._checks import check_known
from mmqa_lab.metrics.pattern import Pattern, Unmeasured

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["CURVES", "METRICS", "Metric", "metric", "supports", "table"]

CURVES = Path(__file__).with_name("curves.csv")
"""Of the stored run of study 12: its table ``supported``, written when the run is stored."""


@dataclass(frozen=True)
class Metric:
    """A metric of a chart.

    Parameters
    ----------
    name, unit : str
        The unit is "1" for a ratio.
    better : {"less", "more"}
    source : str
        With a DOI, or a document and its section.
    formula : str
        As LaTeX.
    misses : str
        What it does not see, or when it misleads.
    function : callable
        Of a CloudQuality; it returns a number.

    Examples
    --------
    >>> METRICS["density"].unit, METRICS["density"].better
    ('points/m2', 'more')
    """

    name: str
    unit: str
    better: str
    source: str
    formula: str
    misses: str
    function: Callable[[Any], float] = field(repr=False)

    def __call__(self, chart: Any) -> float:
        """Return the metric of a chart; NaN if it cannot be measured."""
        return self.measure(chart)[0]

    def measure(self, chart: Any) -> tuple[float, str]:
        """Return the metric of a chart, and the reason if it is NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            try:
                value = float(self.function(chart))
            except Unmeasured as reason:
                return np.nan, f"{self.name} is not measured: {reason}."
        if np.isfinite(value):
            return value, ""
        return np.nan, f"{self.name} is not measured: too few points have what it needs."

    def worst_last(self, values: Any) -> np.ndarray:
        """Return values such that less is better, the worst where there is none."""
        signed = np.asarray(values, dtype=np.float64) * (1 if self.better == "less" else -1)
        return np.where(np.isnan(signed), np.inf, signed)


METRICS: dict[str, Metric] = {}
"""The metrics by their names, in groups: density, noise, neighbours, gaps, evenness."""


def metric(unit: str, better: str, source: str, formula: str, misses: str) -> Callable:
    """Register a function of a chart by its name."""

    def registered(function):
        name = function.__name__
        METRICS[name] = Metric(name, unit, better, source, formula, misses, function)
        return function

    return registered


def table(
    chart: Any, names: Iterable[str] | None = None, *, own: Mapping[str, Callable] | None = None
) -> pd.DataFrame:
    """Return metrics of a chart as a table.

    Parameters
    ----------
    chart : CloudQuality
    names : iterable of str, optional
        Of ``METRICS``; all by default.
    own : mapping, optional
        More functions of the chart by their names.

    Returns
    -------
    DataFrame
        ``metric``, ``value``, ``low``, ``high`` (95 %), ``unit``, ``better``, ``source`` and
        ``remarks`` (why there is no value). Intervals are those of
        :meth:`~mmqa_lab.chart_cloud.CloudQuality.intervals`, from waves over the scan lines, for
        the figures that it has. The other metrics have none: lines that a bootstrap draws twice
        fall onto each other, which changes every gap.

    Raises
    ------
    ValueError
        If there is no metric of a name.

    Examples
    --------
    >>> from mmqa_lab.chart_cloud import evaluate_cloud
    >>> points = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * [2, 1, 0.01]
    >>> table(evaluate_cloud(points), ["anps", "f"])["unit"].tolist()
    ['mm', '1']
    """
    import pandas as pd

    own = dict(own or {})
    names = [*METRICS] if names is None else list(names)
    for name in names:
        check_known(name, "metric", [*METRICS, *own])
    known = chart.intervals().set_index("figure")[["low", "high"]]
    rows = []
    for name in names:
        nothing = Metric(name, "1", "less", "", "", "", own[name]) if name in own else None
        one = nothing or METRICS[name]
        value, remark = one.measure(chart)
        ends = known.loc[name] if name in known.index and not remark else (np.nan, np.nan)
        rows.append((name, value, *ends, one.unit, one.better, one.source, remark))
    columns = ["metric", "value", "low", "high", "unit", "better", "source", "remarks"]
    return pd.DataFrame(rows, columns=columns)


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
    stood elsewhere than the thing. Errors of the navigation are not in them. Points that share
    their place count once, for they say nothing more of the surface.

    Examples
    --------
    >>> from mmqa_lab.chart_cloud import evaluate_cloud
    >>> points = np.random.default_rng(1).uniform(0, 1, (3000, 3)) * [1, 1, 0.01]
    >>> supports(evaluate_cloud(points))["thing"].tolist()
    ['step', 'tilt', 'detail', 'volume']
    """
    import pandas as pd

    table = pd.read_csv(CURVES)
    kept = np.unique(np.column_stack([quality.xy, quality.plane.residuals]), axis=0)
    once = quality
    if len(kept) < quality.n:
        pattern = Pattern(kept[:, :2], quality.outline, kept[:, 2])
        once = SimpleNamespace(pattern=pattern, sigma_mad_mm=quality.sigma_mad_mm)
    measured = np.array([METRICS[name](once) for name in table["metric"]])
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
