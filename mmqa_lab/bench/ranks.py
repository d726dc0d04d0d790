"""How methods differ: means, differences and ranks with intervals, and their drawing."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from mmqa_lab import plots
from mmqa_lab._checks import check_choice
from mmqa_lab.bench.tables import (
    cell_table,
    figure_names,
    heading,
    parameters_of,
    remarked,
    split_unit,
)
from mmqa_lab.stats import mean_interval, rank_correlation

__all__ = ["compare", "plot", "plot_tables", "rank", "summary"]

# Bootstrap samples of the cases, for the intervals of ranks.
RESAMPLES = 200


def summary(
    results: xr.Dataset, figure: str | None = None, *, by: str | Sequence[str] = ()
) -> pd.DataFrame:
    """Return the mean of a figure for each method, with its interval.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figure : str, optional
        Name of the variable; not needed if the results have a single figure.
    by : str or sequence of str
        Parameters of the cases; the table has a row for each of their values.

    Returns
    -------
    DataFrame
        ``method``, the parameters of ``by``, ``mean``, ``low`` and ``high``, ``n`` (cells measured)
        and ``missing`` (cells that are NaN). The names of the first three numbers end with the
        unit of the figure. ``low`` and ``high`` are the 95 % confidence interval of the mean by
        Student's t over the cells, NaN for fewer than two cells. With a method that measured no
        cell, a column ``remarks`` says why, see :func:`remarked`; :func:`compare` and :func:`rank`
        have it, too.

    Raises
    ------
    ValueError
        If the figure or a parameter is unknown.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> results = run(grid(n=(3, 4)), {"d_mm": lambda n: {"d_mm": 2 * n}}, make=lambda n, seed: n)
    >>> summary(results)[["method", "mean_mm", "n", "missing"]].values.tolist()
    [['d_mm', 7.0, 2, 0]]
    """
    figure = _figure(results, figure)
    keys = ["method", *([by] if isinstance(by, str) else by)]
    for name in keys[1:]:
        check_choice(name, "parameter", [*parameters_of(results), "seed"])
    ending, rows = figure.removeprefix(split_unit(figure)[0]), []
    for key, part in cell_table(results).groupby(keys, sort=False, dropna=False):
        rows.append((*key, *_t_interval(part[figure].to_numpy()), part[figure].isna().sum()))
    figures = [f"mean{ending}", f"low{ending}", f"high{ending}", "n", "missing"]
    return remarked(pd.DataFrame(rows, columns=[*keys, *figures]), results)


def plot(results: xr.Dataset, figures: Sequence[str] = (), *, own: Sequence[str] = ()) -> Figure:
    """Draw the mean of each method with its 95 % confidence interval, a panel for each figure.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figures : sequence of str, optional
        Names of the numbers to draw; by default all.
    own : sequence of str
        Methods to highlight with another colour and mark, such as your own.

    Returns
    -------
    matplotlib.figure.Figure
    """
    names = list(figures) or figure_names(results)
    return plot_tables({name: summary(results, name) for name in names}, own=own)


def plot_tables(tables: Mapping[str, pd.DataFrame], *, own: Sequence[str] = ()) -> Figure:
    """Draw tables whose first columns are method, number, low and high, a panel for each.

    Parameters
    ----------
    tables : dict of str to DataFrame
        Tables by the name of the number, from :func:`summary`, :func:`rank` or :func:`compare`.
    own : sequence of str
        Methods to highlight with another colour and mark.

    Returns
    -------
    matplotlib.figure.Figure
    """
    methods = list(dict.fromkeys(name for table in tables.values() for name in table["method"]))
    size, shared = 22 + 5.5 * len(methods), {"sharey": True, "squeeze": False}
    figure, axes = plots.subplots(1, len(tables), width="double", height_mm=size, **shared)
    for ax, (name, table) in zip(axes[0], tables.items(), strict=True):
        for method, mean, low, high in table.iloc[:, :4].to_numpy():
            place = methods.index(method)
            colour = plots.COLOURS["vermilion" if method in own else "blue"]
            ax.hlines(place, low, high, color=colour, lw=1.5)
            ax.plot(mean, place, "D" if method in own else "o", ms=4, color=colour, mfc="white")
        ax.set_xlabel(heading(name))
    axes[0][0].set_yticks(range(len(methods)), methods)
    axes[0][0].set_ylim(len(methods) - 0.5, -0.5)
    return figure


def compare(
    results: xr.Dataset,
    figure: str | None = None,
    *,
    reference: str,
    better: str = "lower",
) -> pd.DataFrame:
    """Return how much each method differs from a reference on the same data.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figure : str, optional
        Name of the variable; not needed if the results have a single figure.
    reference : str
        Name of the method to compare with.
    better : {"lower", "higher"}
        Whether lower or higher figures are better.

    Returns
    -------
    DataFrame
        A row for each other method: ``method``, ``difference`` (mean of method minus reference),
        ``low`` and ``high`` (its 95 % confidence interval by Student's t over the paired
        differences of all cells), ``n`` (pairs measured by both), ``missing`` (other pairs) and
        ``better_share`` (share of pairs in which the method is strictly better). The names of the
        difference and its interval end with the unit of the figure.

    Raises
    ------
    ValueError
        If the figure or the reference is unknown.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> methods = {"old": lambda n: n, "new": lambda n: n - 0.5}
    >>> results = run(grid(n=(3, 4)), methods, make=lambda n, seed: n)
    >>> compare(results, reference="old")[["method", "difference", "better_share"]].values.tolist()
    [['new', -0.5, 1.0]]
    """
    figure = _figure(results, figure)
    sign = {"lower": -1, "higher": 1}[check_choice(better, "better", ("lower", "higher"))]
    values, _ = _by_method(results, figure)
    check_choice(reference, "reference", tuple(values))
    ending, rows = figure.removeprefix(split_unit(figure)[0]), []
    for method in values:
        if method == reference:
            continue
        pairs = pd.Series(values[method] - values[reference])
        mean, low, high, n = _t_interval(pairs.to_numpy())
        share = (sign * pairs.dropna() > 0).mean()
        rows.append((method, mean, low, high, n, len(pairs) - n, share))
    figures = [f"difference{ending}", f"low{ending}", f"high{ending}"]
    columns = ["method", *figures, "n", "missing", "better_share"]
    return remarked(pd.DataFrame(rows, columns=columns), results)


def rank(results: xr.Dataset, truth: str, figure: str | None = None) -> pd.DataFrame:
    """Rank the methods by how well they order the cases.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    truth : str
        A parameter of the cases, or a variable of truth, with or without its ``truth_``.
    figure : str, optional
        Name of the variable; not needed if the results have a single figure.

    Returns
    -------
    DataFrame
        The best method comes first. ``method``; ``spearman``, the rank correlation of figure and
        truth over all cells, ties averaged; ``low`` and ``high``, its 95 % confidence interval;
        ``n``, cells measured; ``missing``, cells that are NaN; ``behind_best``, the absolute
        correlation of the best method minus the absolute correlation of this method;
        ``behind_low`` and ``behind_high``, its paired interval. The intervals are percentiles of a
        bootstrap that draws whole cases with all their seeds, the same cases for all methods. The
        best method has the largest absolute correlation, because a figure that falls as the truth
        rises also orders the cases.

    Raises
    ------
    ValueError
        If the truth or the figure is unknown, or the truth is not a number.

    Notes
    -----
    A method is ranked on the cells that it measured. This favours a method that measures only easy
    cells; ``missing`` shows how many cells it left out.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> methods = {"exact": lambda n: n, "folded": lambda n: abs(n - 3)}
    >>> results = run(grid(n=range(6)), methods, make=lambda n, seed: n)
    >>> rank(results, truth="n")[["method", "spearman"]].round(2).values.tolist()
    [['exact', 1.0], ['folded', -0.44]]
    """
    figure = _figure(results, figure)
    truths = set(results.data_vars) - {*figure_names(results), "failure"}
    truth = f"truth_{truth}" if f"truth_{truth}" in truths else truth
    check_choice(truth, "truth", (*parameters_of(results), *sorted(truths)))
    by_method, cases = _by_method(results, figure)
    true = next(iter(_by_method(results, truth)[0].values()))
    values = np.stack(list(by_method.values()))
    members = [np.flatnonzero(cases == case) for case in np.unique(cases)]
    draws = np.random.default_rng(0).integers(len(members), size=(RESAMPLES, len(members)))
    found = rank_correlation(values, true)
    drawn = []
    for draw in draws:
        pick = np.concatenate([members[case] for case in draw])
        drawn.append(rank_correlation(values[:, pick], true[pick]))
    best = np.argmax(np.nan_to_num(np.abs(found), nan=-1))
    columns = {"method": list(by_method), "spearman": found}
    columns["low"], columns["high"] = _percentiles(np.array(drawn))
    columns["n"] = np.isfinite(values).sum(axis=1)
    columns["missing"] = np.isnan(values).sum(axis=1)
    columns["behind_best"] = np.abs(found[best]) - np.abs(found)
    behind = np.abs(np.array(drawn)[:, [best]]) - np.abs(drawn)
    columns["behind_low"], columns["behind_high"] = _percentiles(behind)
    table = pd.DataFrame(columns).sort_values("behind_best", kind="stable", ignore_index=True)
    return remarked(table, results)


def _percentiles(drawn):
    """The 2.5 and 97.5 % percentiles of each column, NaN left out."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.nanpercentile(drawn, (2.5, 97.5), axis=0)


def _t_interval(values):
    """Mean of the finite values, its 95 % interval by Student's t, and their number."""
    values = values[np.isfinite(values)]
    found = mean_interval(values)
    return found.value, found.low, found.high, len(values)


def _by_method(results, name):
    """Values of a variable by method, all in the same order, and the case of each cell."""
    cells = cell_table(results)
    dims = [dim for dim in results.dims if dim not in ("method", "seed")]
    cells["_case"] = cells.groupby(dims, sort=False, dropna=False).ngroup() if dims else 0
    parts = dict(list(cells.groupby("method", sort=False)))
    values = {method: part[name].to_numpy(float) for method, part in parts.items()}
    return values, next(iter(parts.values()))["_case"].to_numpy()


def _figure(results, figure):
    """The name of a figure; by default the only figure of the results."""
    figures = figure_names(results)
    if figure is None and len(figures) == 1:
        return figures[0]
    return check_choice(figure, "figure", figures)
