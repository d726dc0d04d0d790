"""Methods compared on cases of known truth: any function of the data enters any study.

:func:`run` measures every method on every case and seed, :func:`rank`, :func:`compare` and
:func:`summary` say how the methods differ and how surely, :func:`failures` says what could not be
measured and why. A study is a :class:`Comparison`: its cases, methods, tables and figures.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import hashlib
import inspect
import itertools
import json
import logging
import numbers
import os
import sys
import types
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mmqa_lab import __version__
from mmqa_lab._checks import check_count
from mmqa_lab.bench._tables import (
    RESERVED,
    cell_table,
    compare,
    dataset,
    failures,
    figure_names,
    rank,
    summary,
)
from mmqa_lab.io import write_atomically

if TYPE_CHECKING:
    import distributed
    import xarray as xr

__all__ = [
    "Comparison",
    "cell_table",
    "compare",
    "failures",
    "figure_names",
    "grid",
    "rank",
    "run",
    "summary",
]
__dir__ = __all__.copy

PASSING = (ImportError, MemoryError, OSError)
"""Failures of the machine, not of the method: never stored, so the next run tries again."""


LONGEST_REASON = 300
"""Characters of a reason that are kept."""


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
    workers: int = 1,
    client: distributed.Client | None = None,
    folder: str | os.PathLike | None = None,
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
    workers : int
        Processes on this machine, by Dask; 1 runs in this process. A script (not a notebook) then
        needs its usual guard, ``if __name__ == "__main__":``.
    client : distributed.Client, optional
        A Dask cluster to run on instead.
    folder : path, optional
        Where finished cells are kept, one file each, written whole. A run that was interrupted, or
        that has more cases, seeds or methods, computes only what is missing.

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

    A finished cell is found again by a hash of the case, the seed, the method's name and code, the
    code of ``make`` and ``score``, and the package's version. Noticed are the function's own code,
    that of functions of the same module or notebook that it names, names of functions elsewhere,
    and the plain values (numbers, texts, tuples, arrays) among its defaults, closure and named
    globals. Not noticed are changes inside another module, a list, dict or other object, a class,
    or a file that is read: delete the folder then. Another version of Python computes anew. A cell
    that failed is kept too, except after ImportError, MemoryError and OSError.

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
    store = _Store(folder, bench)
    jobs = list(itertools.product(range(len(cases)), seeds))
    records = {(number, seed): store.read(cases[number], seed) for number, seed in jobs}
    names = ("", *methods)
    missing = {job: [name for name in names if name not in records[job]] for job in jobs}
    tasks = [(job, cases[job[0]], names) for job, names in missing.items() if names]
    computed = _computed(bench, tasks, check_count(workers, "workers"), client)
    with _bar(sum(len(task[2]) for task in tasks)) as bar, contextlib.closing(computed):
        for job, name, record in computed:
            records[job][name] = record
            store.write(cases[job[0]], job[1], name, record)
            bar.update()
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

    def run(
        self, *, workers: int = 1, client: Any = None, folder: str | os.PathLike | None = None
    ) -> xr.Dataset:
        """Return the results of all methods on all cases; see :func:`run`."""
        how = {"workers": workers, "client": client, "folder": folder}
        whole = {"make": self.make, "score": self.score, "seeds": self.seeds}
        return run(self.cases, self.methods, **whole, **how)


@dataclass(frozen=True)
class _Bench:
    """What is needed to measure a case, here or in another process."""

    make: Callable
    methods: dict
    score: Callable | None
    reserved: set

    def cells(self, case, seed, names):
        """Yield name and record of the truth, whose name is empty, and of each named method."""
        with _pools(len(sys.modules)).limit(limits=1):
            try:
                made = self.make(**case, seed=seed)
            except (Exception, SystemExit) as error:
                yield from ((name, _failed(error, "make: ")) for name in names)
                return
            data, truth = made if type(made) is tuple and len(made) == 2 else (made, None)
            for name in names:
                yield name, self.cell(name, data, truth) if name else _truth_record(truth)

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


@functools.lru_cache(maxsize=1)
def _pools(modules):
    """The thread pools of the loaded libraries, found anew when modules were imported since."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


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
    return {"figures": figures, "failure": failure[:LONGEST_REASON], "passing": False}


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
    return {"figures": figures, "failure": "", "passing": False}


def _failed(error, where=""):
    """The record of a cell that raised."""
    sentence = " ".join(f"{where}{type(error).__name__}: {error}".split())
    passing = isinstance(error, PASSING)
    return {"figures": {}, "failure": sentence[:LONGEST_REASON], "passing": passing}


def _copied(data):
    """A copy, so that a method that changes its data leaves the others theirs."""
    try:
        return copy.deepcopy(data)
    except Exception:  # an open file or a lock: shared then
        return data


def _computed(bench, tasks, workers, client):
    """Yield job, name and record as they come."""
    if client is None and (workers == 1 or not tasks):
        for job, case, names in tasks:
            yield from ((job, *found) for found in bench.cells(case, job[1], names))
        return
    with contextlib.ExitStack() as stack:
        if client is None:
            client = stack.enter_context(_processes(workers))
        yield from _there(bench, tasks, client)


def _there(bench, tasks, client):
    """All tasks on the cluster."""
    import cloudpickle
    from distributed import CancelledError, KilledWorker, as_completed

    kit = cloudpickle.dumps(bench)
    futures = {
        client.submit(_unpacked, kit, case, job[1], names, pure=False): (job, names)
        for job, case, names in tasks
    }
    try:
        for future in as_completed(futures):
            job, names = futures[future]
            try:
                records = future.result()
            except KilledWorker:
                died = MemoryError("the process died, perhaps for want of memory.")
                records = [(name, _failed(died)) for name in names]
            except CancelledError as error:
                raise OSError("Lost the Dask scheduler. Must run until the end.") from error
            yield from ((job, *record) for record in records)
    finally:
        client.cancel(list(futures))


def _unpacked(kit, case, seed, names):
    """A task as a worker runs it."""
    import cloudpickle

    return list(cloudpickle.loads(kit).cells(case, seed, names))


@contextlib.contextmanager
def _processes(workers):
    """A Dask client with processes of one thread on this machine."""
    import dask
    from distributed import Client, LocalCluster

    one = {"distributed.nanny.environ.NUMBA_NUM_THREADS": 1}  # in the workers alone
    quiet = {"memory_limit": 0, "dashboard_address": ":0", "silence_logs": logging.ERROR}
    with (
        dask.config.set(one),
        LocalCluster(n_workers=workers, threads_per_worker=1, **quiet) as cluster,
        Client(cluster, timeout=600) as client,  # it runs, however slowly it starts
    ):
        yield client


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


class _Store:
    """Finished cells in a folder, a JSON file each; nothing without a folder."""

    def __init__(self, folder, bench):
        self.folder = folder and Path(folder)
        if self.folder is None:
            return
        common = [__version__, _lasting_text(bench.make, "make")]
        common.append(_lasting_text(bench.score, "score"))
        self.sources = {"": common}
        for name, method in bench.methods.items():
            self.sources[name] = [*common, name, _lasting_text(method, name)]

    def read(self, case, seed):
        """The records of a case and seed that are there, by name."""
        if self.folder is None:
            return {}
        found = {name: _read_record(self._path(case, seed, name)) for name in self.sources}
        return {name: record for name, record in found.items() if record is not None}

    def write(self, case, seed, name, record):
        """Keep a record, unless it failed for a passing reason."""
        if self.folder is None or record["passing"]:
            return
        text = json.dumps(record)
        path = self._path(case, seed, name)
        write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))

    def _path(self, case, seed, name):
        """The file of a cell, named by the hash of all that decides it."""
        known = [(key, _lasting_text(value, key)) for key, value in sorted(case.items())]
        text = json.dumps([known, seed, self.sources[name]])
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.json"


def _read_record(path):
    """A record, or None if there is none that can be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _lasting_text(value, name):
    """A text that stands for a value or function in this run and the next."""
    try:
        return _text_of(value)
    except RuntimeError as error:
        raise ValueError(
            f"Invalid {name} {value}: another in every run. Must be plain values for a folder."
        ) from error


def _text_of(value, known=None):
    """A text that changes when a value, or the code of a function, does.

    ``known`` are the functions on the way to it, which may name each other.
    """
    from dask.base import tokenize

    known = set() if known is None else known
    if isinstance(value, functools.partial):
        value = (value.func, value.args, tuple(sorted(value.keywords.items())))
    if isinstance(value, tuple):
        return " ".join(_text_of(part, known) for part in value)
    function = getattr(value, "py_func", getattr(value, "__func__", value))  # of numba, of methods
    function = inspect.unwrap(function)
    if inspect.isfunction(function):
        return _function_text(function, known)
    if _is_named(value):
        return _full_name(value)
    value = value.item() if isinstance(value, np.generic) else value
    return tokenize(value, ensure_deterministic=True)


def _function_text(function, known):
    """The code of a function, and what it names in its own module."""
    if function in known:
        return function.__qualname__
    known.add(function)
    codes = list(_nested(function.__code__))
    names = sorted({name for code in codes for name in code.co_names})
    values = [function.__globals__[name] for name in names if name in function.__globals__]
    values += [cell.cell_contents for cell in function.__closure__ or ()]
    values += [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    named = (_named_text(value, function.__module__, known) for value in values)
    return " ".join([*map(_code_text, codes), *named])


def _named_text(value, module, known):
    """What counts of a value that a function names: of a function elsewhere, its name alone."""
    plain = numbers.Number | str | tuple | np.ndarray | np.generic | functools.partial | None
    own = inspect.isfunction(value) and value.__module__ == module
    if own or isinstance(value, plain):
        return _text_of(value, known)
    return _full_name(value) if _is_named(value) else ""


def _is_named(value):
    """Whether a value is a function or class with a name."""
    return callable(value) and hasattr(value, "__name__")


def _full_name(value):
    """Module and name of a function or class."""
    return f"{getattr(value, '__module__', '')}.{value.__name__}"


def _nested(code):
    """A code object and those of the functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _nested(constant)


def _code_text(code):
    """What a code object does, without its place in a file."""
    constants = [_constant_text(one) for one in code.co_consts]
    return f"{code.co_name} {code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"


def _constant_text(constant):
    """A constant; the order within a set differs from process to process."""
    if isinstance(constant, frozenset):
        return str(sorted(map(repr, constant)))
    return "" if isinstance(constant, types.CodeType) else repr(constant)
