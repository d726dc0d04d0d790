"""The results of a comparison: their Dataset, a row for each cell, reasons of failures, units."""

from __future__ import annotations

import numbers

import numpy as np
import pandas as pd
import xarray as xr

__all__ = [
    "RESERVED", "cell_table", "dataset", "failures", "figure_names", "heading", "parameters_of",
    "remarked", "split_unit",
]  # fmt: skip

# Endings of names and their units. The longest ending that fits counts.
UNITS = {
    "_per_m2": "1/m²", "_per_m": "1/m", "_per_mm": "1/mm", "_m_per_s": "m/s", "_m_s": "m/s",
    "_m2": "m²", "_m": "m", "_cm": "cm", "_mm": "mm", "_deg": "deg", "_mrad": "mrad",
    "_per_px": "1/px", "_px": "px", "_percent": "%", "_s": "s", "_ms": "ms",
    "_hz": "Hz", "_kmh": "km/h",
}  # fmt: skip

# Names of the Dataset. No figure may have such a name or begin with ``truth_``.
RESERVED = ("method", "case", "seed", "failure", "truth")


def dataset(cases, methods, seeds, records):
    """Return the Dataset of the records of all cells, in the order of cases, methods and seeds."""
    columns = {name: _labels([case[name] for case in cases]) for name in cases[0]}
    codes, labels = _axes(columns, len(cases))
    truths, rows = [], []
    for name in methods:  # a figure that it returns elsewhere is missing here
        of_method = [found[name] for found in records.values()]
        for one in of_method:
            lacking = sorted(set().union(*of_method) - set(one))
            if lacking and not one["failure"]:
                one["failure"] = f"{', '.join(lacking)}: nothing is returned."
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
    >>> import warnings
    >>> from mmqa_lab.bench import run
    >>> def upset(x):
    ...     raise ArithmeticError("no signal")
    >>> with warnings.catch_warnings(action="ignore"):
    ...     results = run([{"n": 3}], {"mine": upset}, make=lambda n, seed: n, seeds=(4, 5))
    >>> failures(results).values.tolist()
    [['mine', 'ArithmeticError: no signal (line 2 of upset)', 2, 'n=3, seed=4']]
    """
    failed = cell_table(results).query("failure != ''")
    case = [name for name in (*parameters_of(results), "seed") if name in failed]
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
    >>> import warnings
    >>> from mmqa_lab.bench import run
    >>> with warnings.catch_warnings(action="ignore"):
    ...     results = run([{"n": 3}], {"mine": str, "ours": int}, make=lambda n, seed: n)
    >>> remarked(pd.DataFrame({"method": ["ours"]}), results)["remarks"].tolist()
    ['', 'mine: value is of type str. Must be finite numbers.']
    """
    failed = failures(results)
    cells = results["failure"].size / results.sizes.get("method", 1)
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
    for name in RESERVED[:1] + RESERVED[2:3]:  # of a part of the results it is one value
        results = results if name in results.dims else results.expand_dims(name)
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


def parameters_of(results):
    """Return the parameters of the cases, as dimensions or as coordinates."""
    named = [name for name in results.coords if name not in RESERVED]
    return [name for name in named if results[name].ndim == 1]
