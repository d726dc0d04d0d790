"""The records of all cells as one Dataset."""

import numbers

import numpy as np
import pandas as pd
import xarray as xr

RESERVED = ("method", "case", "seed", "failure", "truth")
"""Names of the Dataset itself: no parameter or figure may use them, nor begin with ``truth_``."""


UNITS = {
    "_per_m2": "1/m2",
    "_per_m": "1/m",
    "_per_mm": "1/mm",
    "_m_per_s": "m/s",
    "_m2": "m2",
    "_m": "m",
    "_cm": "cm",
    "_mm": "mm",
    "_deg": "deg",
    "_mrad": "mrad",
    "_px": "px",
    "_percent": "%",
    "_share": "1",
    "_s": "s",
    "_hz": "Hz",
    "_kmh": "km/h",
}
"""Endings of names and the unit that each stands for; the longest that fits counts."""


def dataset(cases, methods, seeds, records):
    """The Dataset of all records."""
    shape = (len(methods), len(cases), len(seeds))
    failures = np.full(shape, "", dtype=object)
    figures, truths = {}, {}
    expected = {method: _names(records, method) for method in methods}
    for (number, seed), found in records.items():
        place = (number, seeds.index(seed))
        _enter(truths, found[""], place, shape[1:])
        for row, method in enumerate(methods):
            _enter(figures, found[method], (row, *place), shape)
            failures[(row, *place)] = _reason(found[method], expected[method])
    dims, sizes, coordinates, order = _axes(cases)

    def arranged(values):
        """Values over cases as they lie on the parameters' axes."""
        lead = values.shape[: values.ndim - 2]
        return np.take(values, order, axis=-2).reshape(*lead, *sizes, len(seeds))

    variables = {
        name: (("method", *dims, "seed"), arranged(values)) for name, values in figures.items()
    }
    variables |= {name: ((*dims, "seed"), arranged(values)) for name, values in truths.items()}
    variables["failure"] = (("method", *dims, "seed"), arranged(failures).astype(str))
    coordinates = {"method": methods, **coordinates, "seed": seeds}
    return _with_units(xr.Dataset(variables, coordinates))


def _names(records, method):
    """The figures that a method gave in any cell."""
    return {name for found in records.values() for name in found[method]["figures"]}


def _enter(arrays, record, place, shape):
    """Put the figures of a record in their places."""
    for name, value in record["figures"].items():
        arrays.setdefault(name, np.full(shape, np.nan))[place] = value


def _reason(record, expected):
    """Why figures are missing; also those that the method gave in other cells."""
    absent = sorted(expected - set(record["figures"]))
    if record["failure"] or not absent:
        return record["failure"]
    return f"gave no {', '.join(absent)}. Must give the same figures in every case."


def _axes(cases):
    """Dimensions of the cases, their sizes, their coordinates, and the order of cases on them."""
    columns = {name: _labels([case[name] for case in cases]) for name in cases[0]}
    codes, levels = zip(*map(_factorized, columns.values()), strict=True)
    sizes = tuple(len(level) for level in levels)
    if np.prod(sizes) == len(cases):
        flat = np.ravel_multi_index(codes, sizes)
        if len(np.unique(flat)) == len(cases):
            return (*columns,), sizes, dict(zip(columns, levels, strict=True)), np.argsort(flat)
    along = {name: ("case", column) for name, column in columns.items()}
    along["case"] = np.arange(len(cases))
    return ("case",), (len(cases),), along, np.arange(len(cases))


def _factorized(column):
    """Codes and levels in the order they come; NaN is a level too."""
    return pd.factorize(column, use_na_sentinel=False)


def _labels(values):
    """The values of a parameter as a coordinate: numbers as they are, others as text."""
    if all(isinstance(value, numbers.Real | np.bool_) for value in values):
        return np.array(values)
    return np.array([_name_of(value) for value in values])


def _name_of(value):
    """A value as text; functions and classes by their name."""
    return value.__name__ if hasattr(value, "__name__") else str(value)


def _with_units(results):
    """Units as the names say them."""
    for name in results.variables:
        ending = suffix(name)
        if ending:
            results[name].attrs["units"] = UNITS[ending]
    return results


def suffix(name):
    """The ending of a name that is a unit, or an empty text."""
    fitting = [ending for ending in UNITS if name.endswith(ending)]
    return max(fitting, key=len, default="")
