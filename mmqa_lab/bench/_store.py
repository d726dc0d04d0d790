"""Finished cells in a folder, and the texts by which they are found again."""

import functools
import hashlib
import inspect
import json
import numbers
import types
from pathlib import Path

import numpy as np

from mmqa_lab import __version__
from mmqa_lab.io import write_atomically


class Store:
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
