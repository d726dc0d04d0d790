"""Curves instead of one threshold: how surely a task is done, and what a surface supports."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import needs
from mmqa_lab._results import NORMAL
from mmqa_lab.studies.fitness.acquisitions import KINDS

__all__ = ["curve", "limit_for", "supported"]

SUPPORTED = {
    "step": ("step_mm", "noise_of_a_mean", 4, "mm", "between patches of 20 cm x 20 cm"),
    "tilt": ("tilt_deg", "noise_of_a_mean", 1, "deg", "of a plane of 50 cm x 50 cm"),
    "detail": ("detail_mm", "e95_of_3", 1, "mm", "with three points at 95 % of the places"),
    "volume": ("pothole_percent", "noise_of_a_mean", 0.49, "l", "of a hole of 50 cm, to 10 %"),
}
"""What is supported: the error that is not exceeded in 95 % of the acquisitions times a factor. A
step is told from none if its error stays below a quarter; 10 % of 4.9 l are 0.49 l."""


def curve(values, fit, at):
    """Return P(task done | metric) with its 95 % band, by logistic regression on the logarithm.

    Parameters
    ----------
    values : array, shape (n,)
        The metric, above zero; infinite values are left out.
    fit : array of bool, shape (n,)
    at : array, shape (k,)
        Where the curve is wanted.

    Returns
    -------
    array, shape (3, k)
        Probability, lower and upper end; NaN where the metric divides the clouds perfectly.
    """
    models = needs("lab", "statsmodels.api")
    known = np.isfinite(values) & (values > 0)
    x, done = np.log(values[known]), np.asarray(fit, bool)[known]
    ends = np.array([[part.min(), part.max()] for part in (x[done], x[~done]) if len(part)])
    if len(ends) < 2 or ends[:, 0].max() >= ends[:, 1].min():
        return np.full((3, len(at)), np.nan)
    found = models.Logit(done.astype(float), models.add_constant(x)).fit(disp=0)
    rows = models.add_constant(np.log(at), has_constant="add")
    odds = rows @ found.params
    reach = NORMAL * np.sqrt(np.einsum("ij,jk,ik->i", rows, found.cov_params(), rows))
    return 1 / (1 + np.exp(-np.array([odds, odds - reach, odds + reach])))


def limit_for(values, fit, share):
    """Return the metric at which a share of clouds does the task, by :func:`curve`.

    NaN where that lies beyond the metrics of the clouds.
    """
    values = np.asarray(values)
    known = values[np.isfinite(values) & (values > 0)]
    if not len(known):
        return np.nan
    at = np.geomspace(known.min(), known.max(), 2000)
    off = np.abs(curve(values, fit, at)[0] - share)
    return at[off.argmin()] if off.min() < 0.01 else np.nan


def supported(figures, errors):
    """Return the curves behind :func:`mmqa_lab.metrics.supports`, fitted on simulated drives.

    Parameters
    ----------
    figures, errors : DataFrame
        From :func:`~mmqa_lab.studies.fitness.comparison.measured`.

    Returns
    -------
    DataFrame
        ``thing``, ``metric``, ``intercept`` and ``slope`` of the logarithm of the error's 95 %
        quantile over that of the metric (regression of quantiles), ``factor``, ``unit``, ``of``,
        ``low`` and ``high`` of the metric, ``n``, ``kinds``.
    """
    models, rows = needs("lab", "statsmodels.api"), []
    for thing, (task, metric, factor, unit, words) in SUPPORTED.items():
        values, off = figures[metric].to_numpy(), errors[task].to_numpy()
        known = np.isfinite(values) & np.isfinite(off) & (off > 0)
        design = models.add_constant(np.log(values[known]))
        intercept, slope = models.QuantReg(np.log(off[known]), design).fit(q=0.95).params
        ends = np.quantile(values[known], [0, 1])
        row = thing, metric, intercept, slope, factor, unit, words, *ends, known.sum()
        rows.append((*row, ", ".join(KINDS)))
    columns = ["thing", "metric", "intercept", "slope", "factor", "unit", "of", "low", "high", "n"]
    return pd.DataFrame(rows, columns=[*columns, "kinds"])
