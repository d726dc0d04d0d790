"""Methods compared on cases of known truth: any function of the data enters any study.

:func:`run` measures every method on every case and seed, :func:`rank`, :func:`compare` and
:func:`summary` say how the methods differ and how surely, :func:`failures` says what could not be
measured and why. A study is a :class:`Comparison`: its cases, methods, tables and figures.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import numbers
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import stats
from threadpoolctl import threadpool_limits

from mmqa_lab._checks import check_choice, check_count

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = [
    "Comparison",
    "cell_table",
    "compare",
    "failures",
    "figure_names",
    "grid",
    "plot",
    "rank",
    "run",
    "summary",
]

LONGEST_REASON = 300
"""Characters of a reason that are kept."""

UNITS = {
    "_per_m2": "1/m2", "_per_m": "1/m", "_per_mm": "1/mm", "_m_per_s": "m/s", "_m_s": "m/s",
    "_m2": "m2", "_m": "m", "_cm": "cm", "_mm": "mm", "_deg": "deg", "_mrad": "mrad",
    "_per_px": "1/px", "_px": "px", "_percent": "%", "_share": "1", "_s": "s", "_ms": "ms",
    "_hz": "Hz", "_kmh": "km/h",
}  # fmt: skip
"""Endings of names and the unit that each stands for; the longest that fits counts."""

RESERVED = ("method", "case", "seed", "failure", "truth")
"""Names of the Dataset itself: no parameter or figure may use them, nor begin with ``truth_``."""


def grid(**axes: Any) -> list[dict[str, Any]]:
    """Return every combination of the given values as a list of cases.

    Parameters
    ----------
    **axes : tuple, list, range, array or one value
        The values of each parameter; texts, numbers and other single values are one value each.

    Returns
    -------
    list of dict
        A case for each combination; the last parameter changes fastest.

    Raises
    ------
    ValueError
        If no parameter is given or one has no value.

    Examples
    --------
    >>> grid(kind="lines", ratio=(1, 5))
    [{'kind': 'lines', 'ratio': 1}, {'kind': 'lines', 'ratio': 5}]
    """
    values = {name: _several(value) for name, value in axes.items()}
    empty = [name for name, several in values.items() if not several]
    if empty or not values:
        raise ValueError(f"Invalid axes {', '.join(empty) or 'none'}: no values. Must have some.")
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
        A case is the keyword arguments of ``make``; all cases have the same parameters.
    methods : dict
        Names and functions of the data. A method returns a number, a dict of numbers, or anything
        that ``score`` turns into one of these. Each gets its own copy of the data.
    make : callable
        ``make(**case, seed=seed)`` returns data, or a tuple (data, truth) of exactly two. It is
        called once per case and seed for all methods. Data that is itself a tuple of two is
        returned as ``(data, None)``.
    score : callable, optional
        ``score(result, truth)`` returns a number or a dict of numbers; truth is None where ``make``
        gives none.
    seeds : iterable of int
        Repetitions of each case.
    executor : concurrent.futures.Executor, optional
        Where the cases are measured: a process pool, or Dask's ``client.get_executor()``; without
        it, here. Results are equal to the last bit. A script (not a notebook) that makes a process
        pool needs its usual guard, ``if __name__ == "__main__":``.

    Returns
    -------
    xarray.Dataset
        Dimensions ``method``, the parameters of the cases if the cases are a full grid of them
        (otherwise ``case``, with the parameters as coordinates), and ``seed``. A variable for each
        number: ``value`` where a method returns a bare number. Truth that is a number, or a dict of
        numbers, becomes ``truth`` or ``truth_<name>`` without the dimension ``method``. The unit
        that a name ends with stands in ``attrs["units"]``. The variable ``failure`` has the reason
        of each cell that could not be measured, "" elsewhere. Parameters that are no numbers become
        texts: a function or class its name, another object what ``str`` gives. Select a method by
        ``results.sel({"method": name})``; in ``sel(method=name)`` xarray reads another option.

    Raises
    ------
    TypeError
        If cases, methods, ``make`` or ``score`` are of another type.
    ValueError
        If there are no cases, methods or seeds, cases differ in their parameters, or a parameter
        has a name that the Dataset needs.

    Notes
    -----
    A method that raises, or returns NaN, infinity, another type or an array, costs its own cells
    (NaN), and one sentence, as a warning; see :func:`failures`. A ``make`` that fails costs its
    case and seed for all methods.

    BLAS and OpenMP run on one thread, here and in workers, so that sums have the same order and
    results are equal to the last bit on one machine. Methods that draw random numbers must seed
    their own generator.

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
    cases, methods, seeds = _case_list(cases), _method_dict(methods), _seed_list(seeds)
    reserved = {*RESERVED, *cases[0]}
    bench = _Bench(_callable(make, "make"), methods, score and _callable(score, "score"), reserved)
    jobs = list(itertools.product(range(len(cases)), seeds))
    records = {job: {} for job in jobs}
    with _bar(len(jobs) * len(methods)) as bar:
        for job, name, record in _computed(bench, jobs, cases, executor):
            records[job][name] = record
            bar.update(bool(name))
    results = dataset(cases, list(methods), seeds, records)
    _say_failures(results)
    return results


@dataclass
class Comparison:
    """A study as the bench sees it: what is compared, on what, and what is shown of it.

    Parameters
    ----------
    cases, methods, make, score, seeds
        As :func:`run` takes them. ``methods`` is a dict: add your own to it.
    tables : callable, optional
        ``tables(results)`` returns a dict of DataFrames by name, a row for every method.
    figures : callable, optional
        ``figures(results)`` returns a dict of matplotlib figures by name.

    Examples
    --------
    >>> study = Comparison(grid(n=(3, 4)), {"double": lambda n: 2 * n}, lambda n, seed: n)
    >>> study.methods["square"] = lambda n: n**2
    >>> study.run()["value"].values[:, :, 0].tolist()
    [[6.0, 8.0], [9.0, 16.0]]
    """

    cases: list | pd.DataFrame
    methods: dict
    make: Callable
    score: Callable | None = None
    seeds: Iterable = (0,)
    tables: Callable | None = None
    figures: Callable | None = None

    def run(self, *, executor: Executor | None = None) -> xr.Dataset:
        """Return the results of all methods on all cases; see :func:`run`."""
        whole = {"make": self.make, "score": self.score, "seeds": self.seeds}
        return run(self.cases, self.methods, **whole, executor=executor)


@dataclass(frozen=True)
class _Bench:
    """What is needed to measure a case, here or in another process."""

    make: Callable
    methods: dict
    score: Callable | None
    reserved: set

    def cells(self, case, seed):
        """Yield name and record of the truth, whose name is empty, and of each method."""
        with threadpool_limits(limits=1):
            try:
                made = self.make(**case, seed=seed)
            except (Exception, SystemExit) as error:
                yield from ((name, _failed(error, "make: ")) for name in ("", *self.methods))
                return
            data, truth = made if type(made) is tuple and len(made) == 2 else (made, None)
            yield "", _truth_record(truth)
            for name in self.methods:
                yield name, self.cell(name, data, truth)

    def cell(self, name, data, truth):
        """The record of one method."""
        try:
            result = self.methods[name](_copied(data))
        except (Exception, SystemExit) as error:
            return _failed(error)
        try:
            scored = result if self.score is None else self.score(result, truth)
            return _record(scored, self.reserved)
        except (Exception, SystemExit) as error:
            return _failed(error, "score: ")


def _record(result, reserved):
    """The numbers of a result, and a sentence on those that are none."""
    named = result if isinstance(result, Mapping) else {"value": result}
    figures, wrong = {}, []
    for name, value in named.items():
        if name in reserved or str(name).startswith("truth_"):
            wrong.append(f"{name} is a name that the results need for something else")
            continue
        figures[str(name)], reason = _number(value)
        if reason:
            wrong.append(f"{name} {reason}")
    if not named:
        wrong.append("the dict is empty")
    failure = f"{'; '.join(wrong)}. Must be finite numbers." if wrong else ""
    return {"figures": figures, "failure": failure[:LONGEST_REASON]}


def _number(value):
    """A value as a float, and what is wrong with it."""
    array = None
    with contextlib.suppress(Exception):  # what is no array is no number either
        array = np.asarray(value)
    if array is None or array.dtype.kind not in "fiub":
        return np.nan, f"is of type {type(value).__name__}"
    if array.ndim:
        return np.nan, f"has shape {array.shape}"
    number = float(array)
    return (number, "") if np.isfinite(number) else (np.nan, f"is {number}")


def _truth_record(truth):
    """The numbers of a truth; what is none stays with the score."""
    named = {"": truth} if not isinstance(truth, Mapping) else truth
    read = {name: _number(value) for name, value in named.items()}
    figures = {
        f"truth_{name}" if name else "truth": number
        for name, (number, reason) in read.items()
        if not reason or reason == "is nan"
    }
    return {"figures": figures, "failure": ""}


def _failed(error, where=""):
    """The record of a cell that raised."""
    sentence = " ".join(f"{where}{type(error).__name__}: {error}".split())
    return {"figures": {}, "failure": sentence[:LONGEST_REASON]}


def _copied(data):
    """A copy, so that a method that changes its data leaves the others theirs."""
    try:
        return copy.deepcopy(data)
    except Exception:  # an open file or a lock: shared then
        return data


def _computed(bench, jobs, cases, executor):
    """Yield job, name and record as they come."""
    if executor is None:
        for number, seed in jobs:
            for name, record in bench.cells(cases[number], seed):
                yield (number, seed), name, record
        return
    import cloudpickle

    kit = cloudpickle.dumps(bench)
    futures = {executor.submit(_unpacked, kit, cases[job[0]], job[1]): job for job in jobs}
    for future in as_completed(futures):
        try:
            records = future.result()
        except Exception as error:  # the process died, perhaps for want of memory
            records = [(name, _failed(error)) for name in ("", *bench.methods)]
        for name, record in records:
            yield futures[future], name, record


def _unpacked(kit, case, seed):
    """A task as a worker runs it."""
    import cloudpickle

    return list(cloudpickle.loads(kit).cells(case, seed))


def _bar(total):
    """Progress in notebooks and terminals; none elsewhere and in headless runs."""
    from tqdm.auto import tqdm

    seen = "ipykernel" in sys.modules or sys.stderr.isatty()
    hidden = bool(os.environ.get("MMQA_HEADLESS")) or not seen or not total
    return tqdm(total=total, unit="cell", desc="bench", leave=False, disable=hidden)


def _several(value):
    """The values of an axis."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return [value]
    return list(value)


def _case_list(cases):
    """Cases as a list of dicts with the same parameters."""
    rows = cases.to_dict("records") if isinstance(cases, pd.DataFrame) else list(cases)
    if not rows or not all(isinstance(row, Mapping) and row for row in rows):
        raise ValueError(
            f"Invalid cases {rows[:1]}. Must be dicts of parameters, or a DataFrame with a row for "
            "each case."
        )
    for row in rows:
        if set(row) != set(rows[0]):
            raise ValueError(f"Invalid case {row}. Must have the parameters {', '.join(rows[0])}.")
    taken = [name for name in rows[0] if name in RESERVED or str(name).startswith("truth_")]
    if taken:
        raise ValueError(f"Invalid parameter {taken[0]!r}. Must not be a name of the results.")
    return [dict(row) for row in rows]


def _method_dict(methods):
    """Methods as a dict of functions by their names."""
    if not isinstance(methods, Mapping) or not methods:
        raise TypeError(f"Invalid methods {methods!r}. Must be a dict of names and functions.")
    for name, method in methods.items():
        if not isinstance(name, str) or not name:
            raise TypeError(f"Invalid name of a method {name!r}. Must be a text.")
        _callable(method, f"method {name!r}")
    return dict(methods)


def _callable(value, name):
    """A function, or the sentence that says it is none."""
    if not callable(value):
        raise TypeError(f"Invalid {name} of type {type(value).__name__}. Must be a function.")
    return value


def _seed_list(seeds):
    """Seeds as a list without doubles."""
    listed = [check_count(seed, "seed", low=0) for seed in _several(seeds)]
    if not listed or len(set(listed)) < len(listed):
        raise ValueError(f"Invalid seeds {listed}. Must be one or more different whole numbers.")
    return listed


def _say_failures(results):
    """A warning for each method that could not measure all cells."""
    table = failures(results)
    cells = results["failure"][0].size
    for method, part in table.groupby("method", sort=False):
        first = part["reason"].iloc[0]
        said = f"{method}: {part['count'].sum()} of {cells} cells not measured; the first: {first}"
        warnings.warn(said, stacklevel=3)


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


def plot(results: xr.Dataset, figures: Sequence[str] = (), *, own: Sequence[str] = ()) -> Figure:
    """Draw the mean of each method with its 95 % interval, a panel for each figure.

    Parameters
    ----------
    results : Dataset
        From :func:`run`.
    figures : sequence of str, optional
        Names of the numbers shown; all where none is named.
    own : sequence of str
        Methods that get a colour and mark of their own: a reader's.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from mmqa_lab import plots

    names = [figures] if isinstance(figures, str) else list(figures or figure_names(results))
    methods = list(np.atleast_1d(results["method"].values))
    height = 22 + 5.5 * len(methods)
    figure, axes = plots.subplots(
        1, len(names), width="double", height_mm=height, sharey=True, squeeze=False
    )
    for ax, name in zip(axes[0], names, strict=True):
        plain, unit = split_unit(name)
        mean, low, high = summary(results, name).iloc[:, 1:4].to_numpy(float).T
        for place, method in enumerate(methods):
            colour = plots.COLOURS["vermilion" if method in own else "blue"]
            ax.hlines(place, low[place], high[place], color=colour, lw=1.5)
            mark = "D" if method in own else "o"
            ax.plot(mean[place], place, mark, ms=4, color=colour, mfc="white")
        label = plain.replace("_", " ")
        ax.set_xlabel(f"{label} ({unit})" if unit not in ("", "1") else label)
    axes[0][0].set_yticks(range(len(methods)), methods)
    axes[0][0].invert_yaxis()
    return figure


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
    resamples: int = 200,
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
    figure, truth = _figure(results, figure), _truth_name(results, truth)
    by_method, cases = _by_method(results, figure)
    true = next(iter(_by_method(results, truth)[0].values()))
    values = np.stack(list(by_method.values()))
    members = [np.flatnonzero(cases == case) for case in np.unique(cases)]
    draws = np.random.default_rng(seed).integers(len(members), size=(resamples, len(members)))
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
    table = pd.DataFrame(columns)
    return table.sort_values("behind_best", kind="stable").reset_index(drop=True)


def _spearman(rows, true):
    """Spearman's correlation of each row with the truth, over the cells that the row has."""
    found = np.full(len(rows), np.nan)
    for k, values in enumerate(rows):
        there = np.isfinite(values) & np.isfinite(true)
        if there.any() and np.ptp(values[there]) > 0 and np.ptp(true[there]) > 0:
            ranks = stats.rankdata([values[there], true[there]], axis=1)
            found[k] = np.corrcoef(ranks)[0, 1]
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
