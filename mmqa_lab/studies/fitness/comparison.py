"""The comparison: metrics of charts by what can be done with the clouds, like with like."""

import numpy as np
import pandas as pd
from scipy.stats import rankdata, t

from mmqa_lab import bench as benches
from mmqa_lab.metrics import METRICS
from mmqa_lab.spacing import exempt
from mmqa_lab.studies.fitness.tasks import FREE, GOOD

__all__ = [
    "FEW", "advice", "by_kind", "contradictions", "correlations", "halves", "matrix", "measured",
    "thresholds", "winners", "written",
]  # fmt: skip

FEW = 10
"""Fewest fit and unfit clouds with which metrics are judged."""

NEAR = 0.03
"""A metric does if its balanced accuracy is less than so much behind the best one's."""

COIN, LEAST_ADVISED = 0.5, 0.6
"""Balanced accuracy of a coin, and that which the interval of an advised metric must pass."""

SETS = 3
"""Real clouds of a task, all ordered better by density, that speak against another metric."""

RHO0 = 3000.0
"""The density of section 4.2 of Pfeifer et al. 2021, with its exemption."""


def measured(results):
    """Return the metrics, turned so that less is better, and the errors of each case, DataFrames.

    ``results`` is the Dataset of a bench. A metric that cannot be measured counts as the worst.
    Figures of one's own are taken as less is better.
    """
    cells, keys = benches.cell_table(results), [d for d in results.dims if d != "method"]
    figures = cells.pivot(index=keys, columns="method", values="value")
    figures = figures[results["method"].to_numpy()]
    for name in figures:
        known = METRICS.get(name, METRICS["anps"])
        figures[name] = known.worst_last(figures[name])
    errors = cells.groupby(keys).first().filter(like="truth_").loc[figures.index]
    errors.columns = errors.columns.str.removeprefix("truth_")
    return figures.reset_index(drop=True), errors.reset_index(drop=True)


def correlations(figures, errors, *, resamples=300):
    """Return the rank correlation of each metric with the error of each task.

    Parameters
    ----------
    figures, errors : DataFrame
        From :func:`measured`, a row for each acquisition, in the same order.
    resamples : int
        Bootstrap samples of the acquisitions.

    Returns
    -------
    DataFrame
        ``method``, ``spearman``, ``low``, ``high`` (95 %), ``task``, ``n``.
    """
    rows, rng = [], np.random.default_rng(0)
    for task in (name for name in errors if name in GOOD):
        known = errors[task].notna().to_numpy()
        values = np.vstack([figures[known].to_numpy().T, errors[task][known]])
        n = values.shape[1]
        if n < 3:
            continue
        drawn = _drawn_spearman(values, rng.integers(n, size=(resamples, n)))
        ends = np.percentile(drawn, (2.5, 97.5), axis=1)
        rows += [(*row, task, n) for row in zip(figures, _spearman(values), *ends, strict=True)]
    return pd.DataFrame(rows, columns=["method", "spearman", "low", "high", "task", "n"])


def _spearman(values):
    """Rank correlation of the last row with the others; 0 without spread.

    It is :func:`mmqa_lab.stats.rank_correlation` of full rows, for thousands of samples.
    """
    ranks = rankdata(values, axis=1)
    ranks -= ranks.mean(axis=1, keepdims=True)
    length = np.sqrt((ranks**2).sum(axis=1))
    return ranks[:-1] @ ranks[-1] / np.maximum(length[:-1] * length[-1], 1e-9)


def _drawn_spearman(values, draws):
    """:func:`_spearman` of ``values[:, draw]`` for each draw, (rows - 1, draws).

    Each row is sorted once: how often its places are drawn gives all ranks.
    """
    size = values.shape[1]
    times = np.stack([np.bincount(draw, minlength=size) for draw in draws], axis=1)

    def ranks(row):  # from their mean
        order = np.argsort(row)
        below = np.vstack([np.zeros_like(times[:1]), times[order].cumsum(axis=0)])
        first, behind = (np.searchsorted(row, row, side, order) for side in ("left", "right"))
        return (below[first] + below[behind] - size) / 2

    last, found = ranks(values[-1]), []
    for own in map(ranks, values[:-1]):
        squares = ((times * one**2).sum(axis=0) for one in (own, last))
        length = np.prod([np.sqrt(one) for one in squares], axis=0)
        found.append((times * own * last).sum(axis=0) / np.maximum(length, 1e-9))
    return np.array(found)


def matrix(found, value="spearman"):
    """Return a table of :func:`correlations` with a row a metric and a column a task."""
    wide = found.pivot(index="method", columns="task", values=value)
    return wide.loc[found["method"].unique(), found["task"].unique()].reset_index()


def written(figures):
    """Return whether each acquisition is accepted by rules as they are written, by their names.

    ``figures`` comes from :func:`measured`; no threshold is chosen.
    """
    free = exempt(figures["d1"] / 1000, figures["d4"] / 1000, RHO0)
    return {
        "accept all": figures["f"] > -np.inf,
        "density ≥ 3000/m² (Pfeifer et al.)": -figures["density"] >= RHO0,
        "f < 2": figures["f"] < 2,
        "f < 2 or exempt": (figures["f"] < 2) | free,
        "cells of 2 ANPS ≥ 90 % (USGS)": -figures["usgs_distribution"] >= 0.9,
    }


def halves(figures, errors, *, good=GOOD, repeats=100):
    """Judge metrics with thresholds from a random half of the acquisitions on the other half.

    Parameters
    ----------
    figures, errors : DataFrame
        From :func:`measured`.
    good : dict
        Largest error of each task with which a cloud is fit.
    repeats : int
        Random halves.

    Returns
    -------
    DataFrame
        For each ``task`` and ``method``: ``limit`` (median of the thresholds), ``balanced``
        (balanced accuracy on the other halves, the mean) with ``low`` and ``high``; ``behind``, how
        much the best metric of the task has more, with ``behind_low`` and ``behind_high``; ``n``
        and ``fit``; ``picked``, the share of halves whose best metric it is; ``nested``, balanced
        accuracy where each half picks the metric, too, with ``nested_low`` and ``nested_high``
        (the same for all metrics of a task). Tasks with fewer than ``FEW`` fit or unfit clouds are
        left out.

    Notes
    -----
    Random halves share clouds. So the variance of a mean over J of them is taken as (1 / J + 1)
    times the variance between them (Nadeau and Bengio 2003, doi:10.1023/A:1024068626366; the test
    half is as large as the other). Intervals of differences hold together for all metrics of a
    task: their level is 1 - 0.05 / (metrics - 1) (Bonferroni).
    """
    rows, rng = [], np.random.default_rng(0)
    wide = 1 / repeats + 1
    for task, limit in good.items():
        known = errors[task].notna().to_numpy()
        fit, values = (errors[task][known] <= limit).to_numpy(), figures[known].to_numpy()
        if np.bincount(fit, minlength=2).min() < FEW:
            continue
        scores, limits = np.empty((2, repeats, len(figures.columns)))
        picks = np.empty(repeats, dtype=int)
        for k in range(repeats):
            chooses = _half(fit, rng)
            limits[k] = thresholds(values[chooses], fit[chooses])
            picks[k] = _balanced(values[chooses] <= limits[k], fit[chooses]).argmax()
            scores[k] = _balanced(values[~chooses] <= limits[k], fit[~chooses])
        best = np.argmax(scores.mean(axis=0))
        behind = scores[:, [best]] - scores
        single, many = t.ppf([0.975, 1 - 0.025 / max(len(figures.columns) - 1, 1)], repeats - 1)

        def within(of, level=single):
            reach = level * np.sqrt(wide * of.var(ddof=1))
            return of.mean(), of.mean() - reach, of.mean() + reach

        nested = within(scores[np.arange(repeats), picks])
        for k, name in enumerate(figures):
            middle = np.median(limits[:, k]) * (-1 if _is_more(name) else 1)
            mean, low, high = within(scores[:, k])
            ends = low, min(high, 1), *within(behind[:, k], many)
            counts = len(fit), int(fit.sum()), (picks == k).mean()
            rows.append((task, name, middle, mean, *ends, *counts, *nested))
    columns = ["task", "method", "limit", "balanced", "low", "high", "behind", "behind_low"]
    columns += ["behind_high", "n", "fit", "picked", "nested", "nested_low", "nested_high"]
    return pd.DataFrame(rows, columns=columns)


def _balanced(accepted, fit):
    """Balanced accuracy of rules that accept clouds, (n, k), of which some are fit, (n,)."""
    return (accepted[fit].mean(axis=0) + (~accepted)[~fit].mean(axis=0)) / 2


def by_kind(figures, errors, kinds, groups, **choices):
    """Return :func:`halves` of groups of acquisitions, with a column ``scanners``.

    ``kinds`` has the kind of each acquisition, ``groups`` the kinds of each group.
    """
    parts = []
    for name, members in groups.items():
        of = np.isin(kinds, members)
        parts.append(halves(figures[of], errors[of], **choices).assign(scanners=name))
    return pd.concat(parts, ignore_index=True)


def winners(table, groups):
    """Return the best metric of each task in each group, and which metrics do for all of them.

    A metric does if it is less than ``NEAR`` behind the best one in each group.

    Parameters
    ----------
    table : DataFrame
        From :func:`by_kind`.
    groups : iterable of str
        Their order.

    Returns
    -------
    DataFrame
        A row a task: a column a group, ``wins all`` and ``near the best in all`` (metrics; empty
        where a single group judges the task).
    """
    table = table.reset_index(drop=True)
    best = table.loc[table.groupby(["task", "scanners"])["balanced"].idxmax()]
    wide = best.pivot(index="task", columns="scanners", values="method")
    wide = wide.reindex(index=table["task"].unique(), columns=groups)
    several = wide.notna().sum(axis=1) > 1
    wide["wins all"] = (
        wide.bfill(axis=1).iloc[:, 0].where(several & (wide.nunique(axis=1) == 1), "")
    )
    behind = table.groupby(["task", "method"], sort=False)["behind"].max()
    close = behind[behind < NEAR].reset_index().groupby("task")["method"].agg(", ".join)
    wide["near the best in all"] = close.reindex(wide.index).where(several).fillna("")
    return wide


def contradictions(real):
    """Return which metrics real clouds show to be behind another one.

    ``real`` has :func:`correlations` of real clouds, with their names as ``data``. A metric is
    behind if its interval ends below that of the best one of the cloud.
    """
    keys = ["data", "task"]
    best = real.loc[real.groupby(keys, sort=False)["spearman"].idxmax()]
    both = real.merge(best, on=keys, suffixes=("", "_best"))
    columns = [*keys, "method", "spearman", "high", "method_best", "spearman_best", "low_best"]
    return both.loc[both["high"] < both["low_best"], columns].reset_index(drop=True)


def advice(table, real):
    """Return which metric to ask for in each task by somebody who does not know the scanner.

    Of the metrics that are less than ``NEAR`` behind the best of the task over all acquisitions,
    it is the one that fewest real clouds contradict, and of these the one that is least behind in
    the group of scanners where it does worst.

    Parameters
    ----------
    table : DataFrame
        From :func:`by_kind`, with all acquisitions as the group ``pooled``.
    real : DataFrame
        As of :func:`contradictions`.

    Returns
    -------
    DataFrame
        The rows of ``pooled`` with ``worst``, how much the best of a group has more at most, NaN
        where no group is judged;
        ``near_in``, the groups in which that is less than ``NEAR``; ``limits``, the best limit
        within each group, as text, where it is shown to be better than a coin;
        ``contradicted_by``; ``density_ahead``, how many real clouds density orders better;
        ``advised``, ``yes`` unless a metric defines the task, a real cloud contradicts, density
        orders each of ``SETS`` real clouds or more better, the metric is near the best for no
        group, or hardly better than a coin.
    """
    keys = ["task", "method"]
    whole = table["scanners"] == "pooled"
    pooled, groups = table[whole], table[~whole]
    worst = groups.groupby(keys)["behind"].max().rename("worst")
    close = groups[groups["behind"] < NEAR].groupby(keys)["scanners"].agg(", ".join)
    against = contradictions(real).groupby(keys)["data"].agg(["size", ", ".join])
    against.columns = ["sets", "contradicted_by"]
    found = pooled[pooled["behind"] < NEAR].join(worst, on=keys).join(against, on=keys)
    told = groups.assign(limit=groups["limit"].where(groups["low"] > COIN))
    within = told.pivot(index=keys, columns="scanners", values="limit")
    within = within[groups["scanners"].unique()].map(lambda one: f"{float(f'{one:.2g}'):g}")
    within = within.replace("nan", "none").agg(", ".join, axis=1)
    found = found.join(close.rename("near_in"), on=keys).join(within.rename("limits"), on=keys)
    nothing = dict.fromkeys(("contradicted_by", "near_in", "limits"), "none")
    found = found.fillna(nothing | {"sets": 0})
    found = found.sort_values(["sets", "worst", "behind"], kind="stable")
    found = found.drop_duplicates("task").sort_index()
    known = found["task"].isin(FREE) & (found["low"] > LEAST_ADVISED)
    known &= (found["near_in"] != "none") & (found["contradicted_by"] == "none")
    ranks = real.pivot(index=["task", "data"], columns="method", values="spearman")
    ahead = ranks.lt(ranks.get("density", np.nan), axis=0).groupby("task").sum()
    clouds = found["task"].map(ranks.groupby("task").size()).fillna(0)
    found = found.join(ahead.stack().rename("density_ahead"), on=keys).fillna({"density_ahead": 0})
    known &= (found["density_ahead"] < clouds) | (clouds < SETS)
    found["advised"] = np.where(known, "yes", "no")
    return found.drop(columns=["scanners", "sets"]).reset_index(drop=True)


def _is_more(name):
    """Whether more of a metric is better."""
    return name in METRICS and METRICS[name].better == "more"


def _half(fit, rng):
    """Half of the fit and half of the unfit clouds, by chance."""
    chosen = np.zeros(len(fit), dtype=bool)
    for part in (np.flatnonzero(fit), np.flatnonzero(~fit)):
        chosen[rng.permutation(part)[: (len(part) + rng.integers(2)) // 2]] = True
    return chosen


def thresholds(values, fit):
    """Return the upper limits, (k,), with the largest balanced accuracy.

    ``values`` is (n, k), ``fit`` (n,). A limit lies half-way to the next value; of
    several as good the middle one is taken.
    """
    order = np.argsort(values, axis=0, kind="stable")
    ranked = np.take_along_axis(values, order, axis=0)
    fits = fit[order]
    gain = np.cumsum(np.where(fits, 1 / max(fit.sum(), 1), -1 / max((~fit).sum(), 1)), axis=0)
    last = np.vstack([ranked[1:] > ranked[:-1], np.ones(values.shape[1], bool)])
    gain = np.where(last & np.isfinite(ranked), gain, -np.inf)
    top = gain >= gain.max(axis=0) - 1e-12
    middle = np.argmax(np.cumsum(top, axis=0) >= (top.sum(axis=0) + 1) // 2, axis=0)
    at = np.arange(values.shape[1])
    low, high = ranked[middle, at], ranked[np.minimum(middle + 1, len(values) - 1), at]
    return np.where(np.isfinite(high), (low + np.where(np.isfinite(high), high, 0)) / 2, low)
