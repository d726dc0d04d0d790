"""Comparison of methods on cases of known truth; any function of the data can be a method.

:func:`run` measures every method on every case and seed. :func:`rank`, :func:`compare` and
:func:`summary` show how the methods differ, with intervals. :func:`failures` lists cells without
a value and the reasons. A study is a :class:`Comparison` of cases, methods, tables and figures.
"""

from __future__ import annotations

import copy
import inspect
import itertools
import numbers
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure
from scipy import stats
from threadpoolctl import ThreadpoolController
from tqdm import tqdm

from mmqa_lab import plots
from mmqa_lab._checks import check_choice

__all__ = [
    "Comparison", "cell_table", "compare", "failures", "figure_names", "grid", "heading", "plot",
    "plot_tables", "rank", "remarked", "run", "split_unit", "summary",
]  # fmt: skip

# Most characters of a reason.
LONGEST_REASON = 300

# Endings of names and their units. The longest ending that fits counts.
UNITS = {
    "_per_m2": "1/m²", "_per_m": "1/m", "_per_mm": "1/mm", "_m_per_s": "m/s", "_m_s": "m/s",
    "_m2": "m²", "_m": "m", "_cm": "cm", "_mm": "mm", "_deg": "deg", "_mrad": "mrad",
    "_per_px": "1/px", "_px": "px", "_percent": "%", "_s": "s", "_ms": "ms",
    "_hz": "Hz", "_kmh": "km/h",
}  # fmt: skip

# Names of the Dataset. No figure may have such a name or begin with ``truth_``.
RESERVED = ("method", "case", "seed", "failure", "truth")

# Bootstrap samples of the cases, for the intervals of ranks.
RESAMPLES = 200

# Exceptions that a method may raise. They cost only the cells of that method.
BROKEN = (Exception, SystemExit)


def grid(**axes: Any) -> list[dict[str, Any]]:
    """Return every combination of the given values as a list of cases.

    Parameters
    ----------
    **axes : tuple, list, range, array or one value
        The values of each parameter. A text, a number or another single value is one value.

    Returns
    -------
    list of dict
        A case for each combination; the last parameter changes fastest.

    Examples
    --------
    >>> grid(kind="lines", ratio=(1, 5))
    [{'kind': 'lines', 'ratio': 1}, {'kind': 'lines', 'ratio': 5}]
    """
    values = {name: _several(value) for name, value in axes.items()}
    return [dict(zip(values, row, strict=True)) for row in itertools.product(*values.values())]


def run(
    cases: Sequence[Mapping[str, Any]] | pd.DataFrame,
    methods: Mapping[str, Callable[..., Any]],
    *,
    make: Callable[..., Any],
    score: Callable[..., Any] | None = None,
    seeds: Iterable[int] = (0,),
    executor: Executor | None = None,
) -> xr.Dataset:
    """Measure every method on every case with every seed.

    Parameters
    ----------
    cases : list of dict, or DataFrame
        A case contains the keyword arguments of ``make``. All cases have the same parameters.
    methods : dict
        Functions of the data by name. A method returns a number, a dict of numbers, or a result
        that ``score`` turns into a number or a dict. Each method gets its own copy of the data.
    make : callable
        ``make(**case, seed=seed)`` returns data, or a tuple (data, truth). It is called once per
        case and seed for all methods. If the data is a tuple of two, ``make`` returns
        ``(data, None)``.
    score : callable, optional
        ``score(result, truth)`` returns a number or a dict of numbers. The truth is None if
        ``make`` returns no truth.
    seeds : iterable of int
        Repetitions of each case.
    executor : concurrent.futures.Executor, optional
        Measures the cases: a process pool, or Dask's ``client.get_executor()``. By default they
        are measured in this process. The results are equal to the last bit. A script that makes a
        process pool needs the usual guard ``if __name__ == "__main__":``; a notebook does not.

    Returns
    -------
    xarray.Dataset
        The dimensions are ``method``, the parameters of the cases, and ``seed``. If the cases are
        not a full grid, the dimension ``case`` replaces the parameters, which become coordinates.
        Each number is a variable; a bare number is ``value``. A truth that is a number becomes
        ``truth``, a dict of numbers becomes ``truth_<name>``; neither has the dimension
        ``method``. The unit at the end of a name stands in ``attrs["units"]``. The variable
        ``failure`` gives the reason of each cell without a value, "" elsewhere. Parameters that
        are not numbers become texts: the name of a function or class, or the result of ``str``.
        Select a method by ``results.sel({"method": name})``, because ``method`` is an option of
        xarray's ``sel``.

    Raises
    ------
    ValueError
        If cases, methods or seeds are missing, if a seed occurs twice, or if the cases differ in
        their parameters.

    Notes
    -----
    If a method raises, or returns NaN, infinity, an array or another type, its cell is NaN. A
    warning reports the first such cell of each method; see :func:`failures`. If ``make`` fails,
    the cells of all methods on this case and seed are NaN.

    BLAS and OpenMP run on one thread, also in workers. Sums then have the same order, and results
    are equal to the last bit on the same machine. A method that draws random numbers must seed its
    own generator.

    Examples
    --------
    >>> def noise(sigma, seed):
    ...     return np.random.default_rng(seed).normal(0, sigma, 1000), sigma
    >>> methods = {"std": np.std, "mad": lambda x: 1.4826 * np.median(np.abs(x - np.median(x)))}
    >>> results = run(grid(sigma=(1.0, 2.0)), methods, make=noise, seeds=range(3))
    >>> dict(results.sizes)
    {'method': 2, 'sigma': 2, 'seed': 3}
    >>> results["value"].mean("seed").sel({"method": "std"}).round(1).values
    array([1., 2.])
    >>> results["truth"].sel(seed=0).values
    array([1., 2.])
    """
    return Comparison(cases, methods, make, score, seeds).run(executor=executor)


@dataclass
class Comparison:
    """A comparison of methods: its cases, methods, scores, tables and figures.

    Parameters
    ----------
    cases, methods, make, score, seeds
        See :func:`run`. ``methods`` is a dict, to which you can add your own method.
    tables : callable, optional
        ``tables(results)`` returns a dict of DataFrames by name, with a row for every method. The
        first table answers the study's question.
    figures : sequence of str
        Names of the numbers to draw; by default all.
    costs_cells : tuple of exceptions
        Exceptions that leave a cell empty. Any other exception ends the run.

    Examples
    --------
    >>> study = Comparison(grid(n=(3, 4)), {"double": lambda n: 2 * n}, lambda n, seed: n)
    >>> study.methods["square"] = lambda n: n**2
    >>> study.run()["value"].values[:, :, 0].tolist()
    [[6.0, 8.0], [9.0, 16.0]]
    """

    cases: list | pd.DataFrame
    methods: Mapping[str, Callable]
    make: Callable
    score: Callable | None = None
    seeds: Iterable = (0,)
    tables: Callable | None = None
    figures: Sequence = ()
    costs_cells: tuple = BROKEN

    def run(self, *, executor: Executor | None = None) -> xr.Dataset:
        """Return the results of all methods on all cases; see :func:`run`."""
        seeds, cases = list(self.seeds), self.cases
        cases = cases.to_dict("records") if isinstance(cases, pd.DataFrame) else list(cases)
        _refuse_unusable(cases, self.methods, seeds)
        study = replace(self, cases=cases)
        jobs = list(itertools.product(range(len(cases)), seeds))
        records, found = dict.fromkeys(jobs), _computed(study, jobs, executor)
        bar = {"leave": False, "disable": None, "ncols": 80, "nrows": 24}
        for job, record in tqdm(found, total=len(jobs), unit="case", **bar):
            records[job] = record
        results = _dataset(cases, list(self.methods), seeds, records)
        for method, part in failures(results).groupby("method", sort=False):
            count = f"{part['count'].sum()} of {len(jobs)} cells not measured; the first: "
            warnings.warn(f"{method}: {count}{part['reason'].iloc[0]}", stacklevel=2)
        return results


def _measured(study, number, seed):
    """The records of one case by method; the record of the truth has an empty name."""
    case = study.cases[number]
    with _libraries(len(sys.modules)).limit(limits=1):
        try:
            made = study.make(**case, seed=seed)
        except study.costs_cells as error:
            failed = {"failure": _reason(error, study.make)}
            return {"": {}} | dict.fromkeys(study.methods, failed)
        data, truth = made if type(made) is tuple and len(made) == 2 else (made, None)
        records = {"": _truths(truth)}
        for name, method in study.methods.items():
            records[name] = _record(study, method, data, truth, {*RESERVED, *case})
        return records


@lru_cache(maxsize=1)
def _libraries(modules):  # noqa: ARG001
    """The libraries with threads, found again only where modules were imported since."""
    return ThreadpoolController()


def _record(study, method, data, truth, reserved):
    """The numbers that a method returns, and a sentence on invalid values."""
    try:
        result = method(copy.deepcopy(data))  # a method may change its copy
        if result is None:
            raise TypeError("nothing is returned")
        result = result if study.score is None else study.score(result, truth)
    except study.costs_cells as error:
        return {"failure": _reason(error, method)}
    named = result if isinstance(result, Mapping) else {"value": result}
    figures, wrong = {}, [] if named else ["the dict is empty"]
    for name, value in named.items():
        if name in reserved or str(name).startswith("truth_"):
            wrong.append(f"{name} is a name that the results need for something else")
            continue
        figures[str(name)], reason = _number(value)
        wrong += [f"{name} {reason}"] if reason else []
    failure = f"{'; '.join(wrong)}. Must be finite numbers"[:LONGEST_REASON] + _place(method) + "."
    return figures | {"failure": failure if wrong else ""}


def _number(value):
    """A value as a float, and the reason if it is invalid."""
    if hasattr(value, "dtype") and np.ndim(value) == 0:
        value = value.item()
    if not isinstance(value, numbers.Real):
        return np.nan, f"is of type {type(value).__name__}"
    return (float(value), "") if np.isfinite(value) else (np.nan, f"is {value}")


def _truths(truth):
    """The numbers of a truth; other parts of the truth are only for the score."""
    figures = {}
    for name, value in (truth if isinstance(truth, Mapping) else {"": truth}).items():
        number, wrong = _number(value)
        if wrong in ("", "is nan"):
            figures[f"truth_{name}" if name else "truth"] = number
    return figures


def _place(method):
    """Where a function is defined, in brackets; empty where Python does not know."""
    own = inspect.unwrap(getattr(method, "func", method))  # of a partial or decorated function
    code = getattr(own, "__code__", getattr(type(own).__call__, "__code__", None))
    return f" (line {code.co_firstlineno} of {code.co_name})" if code else ""


def _reason(error, method):
    """The sentence on a cell that raised, with the line of the user's function."""
    frames = traceback.extract_tb(error.__traceback__)[1:]
    own = [frame for frame in frames if frame.filename == frames[0].filename]
    place = _place(method)  # of a call with other arguments than it has
    if own and not Path(own[-1].filename).is_relative_to(Path(__file__).parent):
        place = f" (line {own[-1].lineno} of {own[-1].name})"
    sentence = " ".join(f"{type(error).__name__}: {error}".split())
    return sentence[:LONGEST_REASON] + place


def _computed(study, jobs, executor):
    """Yield each job with its records, in the order of completion."""
    if executor is None:
        yield from ((job, _measured(study, *job)) for job in jobs)
        return
    kit = cloudpickle.dumps(study)
    futures = {executor.submit(_unpacked, kit, job): job for job in jobs}
    yield from ((futures[future], future.result()) for future in as_completed(futures))


def _unpacked(kit, job):
    """Measure a job in a worker."""
    return _measured(cloudpickle.loads(kit), *job)


def _several(value):
    """The values of an axis."""
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        return [value]
    return list(value)


def _refuse_unusable(cases, methods, seeds):
    """Raise if the cases, methods or seeds are invalid."""
    if not cases or not methods or not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"Invalid bench of {len(cases)} cases, {len(methods)} methods and seeds {seeds}. "
            "Must have some of each, and different seeds."
        )
    for case in cases:
        if set(case) != set(cases[0]):
            raise ValueError(f"Invalid case {case}. Must have {', '.join(cases[0])}.")


def _dataset(cases, methods, seeds, records):
    """The Dataset of the records of all cells, in the order of cases, methods and seeds."""
    columns = {name: _labels([case[name] for case in cases]) for name in cases[0]}
    codes, labels = _axes(columns, len(cases))
    truths, rows = [], []
    for (number, seed), found in records.items():
        place = {name: code[number] for name, code in codes.items()} | {"seed": seeds.index(seed)}
        truths.append(place | found[""])
        rows += [{"method": k, **place, **found[name]} for k, name in enumerate(methods)]
    dims = [*codes, "seed"]
    results = pd.DataFrame(rows).set_index(["method", *dims]).to_xarray()
    results = results.merge(pd.DataFrame(truths).set_index(dims).to_xarray())
    results = results.assign_coords({"method": methods, **labels, "seed": seeds})
    results["failure"] = results["failure"].astype(str)
    if "case" in codes:
        results = results.assign_coords(
            {name: ("case", column) for name, column in columns.items()}
        )
    for name in results.variables:
        if split_unit(name)[1]:
            results[name].attrs["units"] = split_unit(name)[1]
    return results


def _axes(columns, count):
    """The place of each case on the axes, and their labels: a full grid or a list of cases."""
    # in the order of the cases; NaN is a value too
    found = {key: pd.factorize(column, use_na_sentinel=False) for key, column in columns.items()}
    different = len(set(zip(*(code for code, _ in found.values()), strict=True)))
    if different == count == np.prod([len(levels) for _, levels in found.values()]):
        return tuple({name: pair[part] for name, pair in found.items()} for part in (0, 1))
    return {"case": np.arange(count)}, {"case": np.arange(count)}


def _labels(values):
    """The values of a parameter as a coordinate: numbers, or texts for other values."""
    if all(isinstance(value, numbers.Real | np.bool_) for value in values):
        return np.array(values)
    return np.array([getattr(value, "__name__", None) or str(value) for value in values])


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the ending of its unit, and the unit, or an empty text."""
    ending = max((one for one in UNITS if name.endswith(one)), key=len, default="")
    return name.removesuffix(ending), UNITS.get(ending, "")


def heading(name: str) -> str:
    """Return a name in words with its unit in brackets, for a column or an axis."""
    plain, unit = split_unit(name)
    return plain.replace("_", " ") + (f" ({unit})" if unit else "")


def failures(results: xr.Dataset) -> pd.DataFrame:
    """Return the reasons of cells without a value, with their counts.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    DataFrame
        ``method``, ``reason``, ``count`` (cells) and ``first_case`` (its parameters and seed). The
        table is empty if every cell has a value.

    Examples
    --------
    >>> from mmqa_lab.bench import run
    >>> def upset(x):
    ...     raise ArithmeticError("no signal")
    >>> with warnings.catch_warnings(action="ignore"):
    ...     results = run([{"n": 3}], {"mine": upset}, make=lambda n, seed: n, seeds=(4, 5))
    >>> failures(results).values.tolist()
    [['mine', 'ArithmeticError: no signal (line 2 of upset)', 2, 'n=3, seed=4']]
    """
    failed = cell_table(results).query("failure != ''")
    case = [name for name in (*_parameters(results), "seed") if name in failed]
    rows = []
    for (method, reason), part in failed.groupby(["method", "failure"], sort=False):
        first = ", ".join(f"{name}={part[name].iloc[0]}" for name in case)
        rows.append((method, reason, len(part), first))
    return pd.DataFrame(rows, columns=["method", "reason", "count", "first_case"])


def remarked(table: pd.DataFrame, results: xr.Dataset) -> pd.DataFrame:
    """Return a table of methods with a remark on each method that measured no cell.

    Parameters
    ----------
    table : DataFrame
        A table with a column ``method``, such as :func:`summary` returns.
    results : Dataset
        From :func:`run`.

    Returns
    -------
    DataFrame
        The column ``remarks`` names the method, its first reason, and the line of its code; it is
        added only if there is such a method. A method without a row gets one, empty but for it.

    Examples
    --------
    >>> with warnings.catch_warnings(action="ignore"):
    ...     results = run([{"n": 3}], {"mine": str, "ours": int}, make=lambda n, seed: n)
    >>> remarked(pd.DataFrame({"method": ["ours"]}), results)["remarks"].tolist()
    ['', 'mine: value is of type str. Must be finite numbers.']
    """
    failed = failures(results)
    cells = results["failure"].size / results.sizes["method"]
    failed = failed[failed.groupby("method")["count"].transform("sum") == cells]
    failed = failed.drop_duplicates("method").set_index("method", drop=False)
    if failed.empty:
        return table
    pd.set_option("display.max_colwidth", None)  # a notebook would cut a reason after 50 letters
    absent = failed.loc[~failed["method"].isin(table["method"]), ["method"]]
    whole = pd.concat([table, absent], ignore_index=True)
    remarks = failed["method"] + ": " + failed["reason"]
    return whole.assign(remarks=whole["method"].map(remarks).fillna(""))


def cell_table(results: xr.Dataset) -> pd.DataFrame:
    """Return a row for each cell: method, parameters, seed, and all numbers.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    DataFrame
        The rows are ordered by method, case and seed.

    Examples
    --------
    >>> from mmqa_lab.bench import grid, run
    >>> results = run(grid(n=(3, 4)), {"double": lambda n: 2 * n}, make=lambda n, seed: n)
    >>> cell_table(results)[["method", "n", "seed", "value"]].values.tolist()
    [['double', 3, 0, 6.0], ['double', 4, 0, 8.0]]
    """
    others = [name for name in results.dims if name != "method"]
    return results.to_dataframe(dim_order=["method", *others]).reset_index()


def figure_names(results: xr.Dataset) -> tuple[str, ...]:
    """Return the names of the numbers that the methods returned.

    Parameters
    ----------
    results : Dataset
        From :func:`run`, or a part of it.

    Returns
    -------
    tuple of str
        The variables other than truth and failure.

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
        check_choice(name, "parameter", [*_parameters(results), "seed"])
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
    methods = next(iter(tables.values()))["method"].tolist()
    size, shared = 22 + 5.5 * len(methods), {"sharey": True, "squeeze": False}
    figure, axes = plots.subplots(1, len(tables), width="double", height_mm=size, **shared)
    for ax, (name, table) in zip(axes[0], tables.items(), strict=True):
        for place, (method, mean, low, high) in enumerate(table.iloc[:, :4].to_numpy()):
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
    check_choice(truth, "truth", (*_parameters(results), *sorted(truths)))
    by_method, cases = _by_method(results, figure)
    true = next(iter(_by_method(results, truth)[0].values()))
    values = np.stack(list(by_method.values()))
    members = [np.flatnonzero(cases == case) for case in np.unique(cases)]
    draws = np.random.default_rng(0).integers(len(members), size=(RESAMPLES, len(members)))
    found = _spearman(values, true)
    drawn = []
    for draw in draws:
        pick = np.concatenate([members[case] for case in draw])
        drawn.append(_spearman(values[:, pick], true[pick]))
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


def _spearman(rows, true):
    """Spearman's correlation of each row with the truth, over the finite cells."""
    with warnings.catch_warnings(action="ignore"):  # a constant row has none
        return pd.DataFrame(rows.T).corrwith(pd.Series(true), method="spearman").to_numpy()


def _percentiles(drawn):
    """The 2.5 and 97.5 % percentiles of each column, NaN left out."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.nanpercentile(drawn, (2.5, 97.5), axis=0)


def _t_interval(values):
    """Mean of the finite values, its 95 % interval by Student's t, and their number."""
    values = values[np.isfinite(values)]
    n = len(values)
    if n < 2:
        return (values[0] if n else np.nan), np.nan, np.nan, n
    half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)
    return values.mean(), values.mean() - half, values.mean() + half, n


def _by_method(results, name):
    """Values of a variable by method, all in the same order, and the case of each cell."""
    cells = cell_table(results)
    dims = [dim for dim in results.dims if dim not in ("method", "seed")]
    cells["_case"] = cells.groupby(dims, sort=False).ngroup() if dims else 0
    parts = dict(list(cells.groupby("method", sort=False)))
    values = {method: part[name].to_numpy(float) for method, part in parts.items()}
    return values, next(iter(parts.values()))["_case"].to_numpy()


def _parameters(results):
    """The parameters of the cases, as dimensions or as coordinates."""
    named = [name for name in results.coords if name not in RESERVED]
    return [name for name in named if results[name].ndim == 1]


def _figure(results, figure):
    """The name of a figure; by default the only figure of the results."""
    figures = figure_names(results)
    if figure is None and len(figures) == 1:
        return figures[0]
    return check_choice(figure, "figure", figures)
