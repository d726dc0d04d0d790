"""The Dataset of all cells, and what it says: means, paired differences, ranks, failures."""

from __future__ import annotations

import numbers
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from mmqa_lab import _tables
from mmqa_lab._checks import check_choice, check_count

if TYPE_CHECKING:
    import xarray as xr

RESERVED = ("method", "case", "seed", "failure", "truth")
"""Names of the Dataset itself: no parameter or figure may use them, nor begin with ``truth_``."""


UNITS = _tables(Path(__file__).with_name("units.toml"))
"""Endings of names and the unit that each stands for; the longest that fits counts."""


def dataset(cases, methods, seeds, records):
    """The Dataset of the records of all cells, in the order of cases, methods and seeds."""
    columns = {name: _labels([case[name] for case in cases]) for name in cases[0]}
    codes, labels = _axes(columns, len(cases))
    labels = {"method": methods, **labels, "seed": seeds}
    expected = {method: _names(records, method) for method in methods}
    truths, rows = [], []
    for (number, seed), found in records.items():
        place = {name: code[number] for name, code in codes.items()} | {"seed": seeds.index(seed)}
        truths.append(place | found[""]["figures"])
        for row, method in enumerate(methods):
            failure = {"failure": _reason(found[method], expected[method])}
            rows.append({"method": row, **place, **found[method]["figures"], **failure})
    dims = [*codes, "seed"]
    results = pd.DataFrame(rows).set_index(["method", *dims]).to_xarray()
    results["failure"] = results["failure"].astype(str)
    results = results.merge(pd.DataFrame(truths).set_index(dims).to_xarray())
    results = results.assign_coords({name: labels[name] for name in results.dims})
    if "case" in codes:
        results = results.assign_coords({name: ("case", one) for name, one in columns.items()})
    for name in results.variables:
        if ending := unit_ending(name):
            results[name].attrs["units"] = UNITS[ending]
    return results


def _names(records, method):
    """The figures that a method gave in any cell."""
    return {name for found in records.values() for name in found[method]["figures"]}


def _reason(record, expected):
    """Why figures are missing; also those that the method gave in other cells."""
    absent = sorted(expected - set(record["figures"]))
    if record["failure"] or not absent:
        return record["failure"]
    return f"gave no {', '.join(absent)}. Must give the same figures in every case."


def _axes(columns, count):
    """Each case's place on every axis, and the axes' labels: a full grid, or one axis of cases."""
    # in the order they come; NaN is a value too
    found = {name: pd.factorize(one, use_na_sentinel=False) for name, one in columns.items()}
    codes = {name: code for name, (code, _) in found.items()}
    labels = {name: levels for name, (_, levels) in found.items()}
    different = len(set(zip(*codes.values(), strict=True)))
    if different == count == np.prod([len(levels) for levels in labels.values()]):
        return codes, labels
    return {"case": np.arange(count)}, {"case": np.arange(count)}


def _labels(values):
    """The values of a parameter as a coordinate: numbers as they are, others as text."""
    if all(isinstance(value, numbers.Real | np.bool_) for value in values):
        return np.array(values)
    return np.array([getattr(value, "__name__", None) or str(value) for value in values])


def unit_ending(name):
    """The ending of a name that is a unit, or an empty text."""
    return max((one for one in UNITS if name.endswith(one)), key=len, default="")


def split_unit(name):
    """A column's name without the unit that it ends with, and the unit; empty where none."""
    ending = unit_ending(name)
    return (name.removesuffix(ending), UNITS[ending]) if ending else (name, "")


def failures(results: xr.Dataset) -> pd.DataFrame:
    """Return what could not be measured, with its reasons.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    DataFrame
        ``method``, ``reason``, ``count`` (cells) and ``first_case`` (its parameters and seed); the
        most frequent reason of each method first. No rows if all was measured.

    Examples
    --------
    >>> from mmqa_lab.bench import run
    >>> def upset(x):
    ...     raise ArithmeticError("no signal")
    >>> with warnings.catch_warnings(action="ignore"):
    ...     results = run([{"n": 3}], {"mine": upset}, make=lambda n, seed: n, seeds=(4, 5))
    >>> failures(results).values.tolist()
    [['mine', 'ArithmeticError: no signal', 2, 'n=3, seed=4']]
    """
    cells = cell_table(results)
    failed = cells[cells["failure"] != ""]
    case = [name for name in (*_parameters(results), "seed") if name in cells]
    rows = []
    for (method, reason), part in failed.groupby(["method", "failure"], sort=False):
        first = ", ".join(f"{name}={part[name].iloc[0]}" for name in case)
        rows.append((method, reason, len(part), first))
    table = pd.DataFrame(rows, columns=["method", "reason", "count", "first_case"])
    order = list(np.atleast_1d(results["method"].values))
    place = table["method"].map(order.index)
    return table.iloc[np.lexsort((-table["count"], place))].reset_index(drop=True)


def cell_table(results: xr.Dataset) -> pd.DataFrame:
    """Return a row for each cell: method, parameters, seed, and all numbers.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    DataFrame
        Rows of one method stand together, in the order of cases and seeds.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> results = run(grid(n=(3, 4)), {"double": lambda n: 2 * n}, make=lambda n, seed: n)
    >>> cell_table(results)[["method", "n", "seed", "value"]].values.tolist()
    [['double', 3, 0, 6.0], ['double', 4, 0, 8.0]]
    """
    if "method" not in results.dims:
        results = results.expand_dims("method")
    others = [name for name in results.dims if name != "method"]
    return results.to_dataframe(dim_order=["method", *others]).reset_index()


def figure_names(results: xr.Dataset) -> tuple[str, ...]:
    """Return the names of the numbers that methods were measured by.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    tuple of str
        The variables without truth and failures.

    Examples
    --------
    >>> from mmqa_lab.bench import run
    >>> figure_names(run([{"n": 1}], {"one": lambda n: {"a": 1, "b": 2}}, make=lambda n, seed: n))
    ('a', 'b')
    """
    truths = [name for name in results.data_vars if name == "truth" or name.startswith("truth_")]
    return tuple(name for name in results.data_vars if name not in (*truths, "failure"))


def summary(
    results: xr.Dataset, figure: str | None = None, *, by: str | Sequence[str] = ()
) -> pd.DataFrame:
    """Return the mean of a figure for each method, with its interval.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figure : str, optional
        Name of the variable; may be left out if there is only one.
    by : str or sequence of str
        Parameters of the cases; a row for each of their values.

    Returns
    -------
    DataFrame
        ``method``, the parameters of ``by``, ``mean``, ``low`` and ``high`` with the unit that the
        figure's name ends with (95 % interval of the mean by Student's t over the cells, NaN for
        fewer than two), ``n`` cells measured, ``missing`` cells that are NaN.

    Raises
    ------
    ValueError
        If there is no such figure or parameter.

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
        check_choice(name, "parameter", [*_parameters(results), "seed"])
    ending, rows = unit_ending(figure), []
    for key, part in cell_table(results).groupby(keys, sort=False, dropna=False):
        rows.append((*key, *_t_interval(part[figure].to_numpy()), part[figure].isna().sum()))
    figures = [f"mean{ending}", f"low{ending}", f"high{ending}", "n", "missing"]
    return pd.DataFrame(rows, columns=[*keys, *figures])


def compare(
    results: xr.Dataset,
    figure: str | None = None,
    *,
    reference: str,
    better: str = "lower",
    over: str = "cells",
) -> pd.DataFrame:
    """Return how much each method differs from a reference on the same data.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figure : str, optional
        Name of the variable; may be left out if there is only one.
    reference : str
        Name of the method to compare with.
    better : {"lower", "higher"}
        Which figure is the better one.
    over : {"cells", "cases"}
        What varies independently: every case and seed, or only cases, each with the mean over its
        seeds. Take cases if the question is how methods differ on other cases than these.

    Returns
    -------
    DataFrame
        For each other method: ``method``, ``difference``, ``low`` and ``high`` with the figure's
        unit (mean of method minus reference and its 95 % interval by Student's t over the paired
        differences), ``n`` pairs measured by both, ``missing`` pairs that were not, and
        ``better_share``, the share of pairs in which the method is strictly better.

    Raises
    ------
    ValueError
        If there is no such figure or method.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> methods = {"old": lambda n: n, "new": lambda n: n - 0.5}
    >>> results = run(grid(n=(3, 4)), methods, make=lambda n, seed: n)
    >>> compare(results, reference="old")[["method", "difference", "better_share"]].values.tolist()
    [['new', -0.5, 1.0]]
    """
    figure = _figure(results, figure)
    check_choice(over, "over", ("cells", "cases"))
    sign = {"lower": -1, "higher": 1}[check_choice(better, "better", ("lower", "higher"))]
    values, cases = _by_method(results, figure)
    check_choice(reference, "reference", tuple(values))
    ending, rows = unit_ending(figure), []
    for method in values:
        if method == reference:
            continue
        pairs = pd.Series(values[method] - values[reference])
        pairs = pairs if over == "cells" else pairs.groupby(cases).mean()
        mean, low, high, n = _t_interval(pairs.to_numpy())
        share = (sign * pairs.dropna() > 0).mean()
        rows.append((method, mean, low, high, n, len(pairs) - n, share))
    figures = [f"difference{ending}", f"low{ending}", f"high{ending}"]
    return pd.DataFrame(rows, columns=["method", *figures, "n", "missing", "better_share"])


def rank(
    results: xr.Dataset,
    truth: str,
    figure: str | None = None,
    *,
    resamples: int = 999,
    seed: int = 0,
) -> pd.DataFrame:
    """Return which method orders the cases best.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    truth : str
        A parameter of the cases, or a variable of truth (its ``truth_`` may be left out).
    figure : str, optional
        Name of the variable; may be left out if there is only one.
    resamples : int
        Bootstrap samples of the cases.
    seed : int
        Of the bootstrap.

    Returns
    -------
    DataFrame
        The best method first: ``method``, ``spearman`` (rank correlation of figure and truth over
        all cells, ties averaged), ``low`` and ``high`` (95 % percentile interval of a bootstrap
        that draws whole cases with all their seeds, the same for all methods), ``n`` cells
        measured, ``missing`` cells that are NaN, ``behind_best`` (absolute correlation of the best
        minus that of the method) and ``behind_low``, ``behind_high`` (its paired interval). The
        best has the largest absolute correlation: a figure that falls as the truth rises orders
        the cases as well.

    Raises
    ------
    ValueError
        If there is no such truth or figure, or the truth is no number.

    Notes
    -----
    A method is ranked on the cells that it measured; one that measures only easy cells is favoured,
    and ``missing`` shows it.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> methods = {"exact": lambda n: n, "folded": lambda n: abs(n - 3)}
    >>> results = run(grid(n=range(6)), methods, make=lambda n, seed: n)
    >>> rank(results, truth="n")[["method", "spearman"]].round(2).values.tolist()
    [['exact', 1.0], ['folded', -0.44]]
    """
    check_count(resamples, "resamples")
    figure, truth = _figure(results, figure), _truth_name(results, truth)
    by_method, cases = _by_method(results, figure)
    true = next(iter(_by_method(results, truth)[0].values()))
    values = np.stack(list(by_method.values()))
    picks = _picks(cases, resamples, np.random.default_rng(seed))
    places, true_places = np.array([_places(one) for one in values]), _places(true)
    found = _rank_correlations(places, true_places)
    drawn = [_rank_correlations(places[:, pick], true_places[pick]) for pick in picks]
    drawn = np.array(drawn)
    best = np.argmax(np.nan_to_num(np.abs(found), nan=-1))
    columns = {"method": list(by_method), "spearman": found}
    columns["low"], columns["high"] = _percentiles(drawn)
    columns["n"] = np.isfinite(values).sum(axis=1)
    columns["missing"] = np.isnan(values).sum(axis=1)
    columns["behind_best"] = np.abs(found[best]) - np.abs(found)
    behind = np.abs(drawn[:, [best]]) - np.abs(drawn)
    columns["behind_low"], columns["behind_high"] = _percentiles(behind)
    table = pd.DataFrame(columns)
    return table.sort_values("behind_best", kind="stable").reset_index(drop=True)


def _picks(cases, resamples, rng):
    """Yield the cells of as many cases as there are, drawn with replacement."""
    members = [np.flatnonzero(cases == case) for case in np.unique(cases)]
    for _ in range(resamples):
        draw = rng.integers(len(members), size=len(members))
        yield np.concatenate([members[case] for case in draw])


def _places(values):
    """Each value's place among the different ones, -1 where it is not finite."""
    here, places = np.isfinite(values), np.full(len(values), -1)
    places[here] = np.unique(values[here], return_inverse=True)[1]
    return places


def _ranks(places):
    """Ranks of values by their places, ties averaged, without sorting them again."""
    count = np.bincount(places)
    return (np.cumsum(count) - (count - 1) / 2)[places]


def _rank_correlations(places, true):
    """Spearman's correlation of each row with the truth, over the cells that the row has."""
    found = np.full(len(places), np.nan)
    for row, one in enumerate(places):
        here = (one >= 0) & (true >= 0)
        a, b = _ranks(one[here]), _ranks(true[here])
        if here.any() and np.ptp(a) > 0 and np.ptp(b) > 0:
            found[row] = np.corrcoef(a, b)[0, 1]
    return found


def _percentiles(drawn):
    """The limits of 95 % of the samples of each column, without those not measurable."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.nanpercentile(drawn, (2.5, 97.5), axis=0)


def _t_interval(values):
    """Mean, limits of its 95 % interval by Student's t, and number of the finite values."""
    values = values[np.isfinite(values)]
    n = len(values)
    if n < 2:
        return (values[0] if n else np.nan), np.nan, np.nan, n
    half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)
    return values.mean(), values.mean() - half, values.mean() + half, n


def _by_method(results, name):
    """Values of a variable by method, in one order of cells, and each cell's case."""
    cells = cell_table(results)
    dims = [dim for dim in results.dims if dim not in ("method", "seed")]
    cells["_case"] = cells.groupby(dims, sort=False).ngroup() if dims else 0
    parts = dict(list(cells.groupby("method", sort=False)))
    values = {method: part[name].to_numpy(float) for method, part in parts.items()}
    return values, next(iter(parts.values()))["_case"].to_numpy()


def _parameters(results):
    """The parameters of the cases, whether they are dimensions or coordinates of cases."""
    named = [name for name in results.coords if name not in RESERVED]
    return [name for name in named if results[name].ndim == 1]


def _figure(results, figure):
    """The name of a figure that is there; the only one if none is named."""
    figures = figure_names(results)
    if figure is None and len(figures) == 1:
        return figures[0]
    return check_choice(figure, "figure", figures)


def _truth_name(results, truth):
    """The parameter or variable of truth of that name."""
    figures = figure_names(results)
    variables = [name for name in results.data_vars if name not in (*figures, "failure")]
    known = (*_parameters(results), *variables)
    name = f"truth_{truth}" if f"truth_{truth}" in known and truth not in known else truth
    check_choice(name, "truth", known)
    if results[name].dtype.kind not in "fiub":
        raise ValueError(f"Invalid truth {truth!r} of type {results[name].dtype}. Must be numbers.")
    return name
