"""Every method on every case and seed: the run of a comparison."""

from __future__ import annotations

import copy
import inspect
import itertools
import numbers
import pickle
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from threadpoolctl import ThreadpoolController

from mmqa_lab._checks import needs
from mmqa_lab._progress import progress
from mmqa_lab.bench.tables import RESERVED, dataset, failures

__all__ = ["Comparison", "grid", "run"]

# Most characters of a reason.
LONGEST_REASON = 300

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
        for job, record in progress(found, "case", total=len(jobs)):
            records[job] = record
        results = dataset(cases, list(self.methods), seeds, records)
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
    if own and not Path(own[-1].filename).is_relative_to(Path(__file__).parents[1]):
        place = f" (line {own[-1].lineno} of {own[-1].name})"
    sentence = " ".join(f"{type(error).__name__}: {error}".split())
    return sentence[:LONGEST_REASON] + place


def _computed(study, jobs, executor):
    """Yield each job with its records, in the order of completion."""
    if executor is None:
        yield from ((job, _measured(study, *job)) for job in jobs)
        return
    kit = needs("dask", "cloudpickle").dumps(study)
    futures = {executor.submit(_unpacked, kit, job): job for job in jobs}
    yield from ((futures[future], future.result()) for future in as_completed(futures))


def _unpacked(kit, job):
    """Measure a job in a worker."""
    return _measured(pickle.loads(kit), *job)


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
