"""The ledger: every number that the five sources print, beside what the studies find.

A *cell* is one printed number. A study writes its own values into ``ledger.csv`` of its results
folder, a row for each value (:func:`entries`); :func:`collect` joins them with the
cells and gives each one a verdict:

- **reproduced**: our value rounds to what is printed, and no parameter was fitted to it;
- **consistent**: our 95 % interval meets the rounding interval of the printed number, or our value
  satisfies what is printed as a bound, a range or with "about"; no parameter was fitted to it;
- **fitted**: our value or interval meets the printed number, and a parameter was fitted to the
  source's numbers: this shows that a model can give the number, not that it does;
- **differs**: our value or interval does not meet it; the note gives the argument;
- **not comparable**: there is no value of ours; the note gives the reason, by default that of
  ``data/reasons.csv``;
- **not run**: there is no value, because the study that answers this table did not finish.

The rounding interval reaches half a unit of the last printed digit to both sides; with "about" a
whole unit of the last digit that is not zero. Legibility marks count as a = 1, b = 2, c = 3.
"""

import os
from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab import published
from mmqa_lab._checks import check_choice

__all__ = ["cells", "collect", "entries", "summary", "verdict", "verdicts"]
__dir__ = __all__.copy

OUR_KINDS = ("predicted", "measured", "fitted")
CELL_VERDICTS = ("reproduced", "consistent", "fitted", "differs", "not comparable", "not run")
CELL_NUMBERS = ["value", "low", "high"]
CELL = ["source", "table", "cell"]
COLUMNS = [*CELL, *CELL_NUMBERS, "kind", "note"]


def cells() -> pd.DataFrame:
    """Return every printed number of the five sources.

    Returns
    -------
    DataFrame
        A row for each number: ``source``, ``table``, ``cell`` (unique within its table), ``role``
        (result, set-up, threshold or literature), ``relation``, ``printed``, ``value`` (NaN for a
        dash or a range), ``low`` and ``high`` (the values that print as this; NaN where a dash
        gives no bound), ``unit``, ``section``.

    Examples
    --------
    >>> table_2 = cells().query("source == 'pfeifer2021' and table == 'table_2'")
    >>> table_2[["cell", "printed", "low", "high", "unit"]].head(2).to_numpy().tolist()
    [['A 5 m density', '4629', 4628.5, 4629.5, '1/m2'],
     ['A 5 m sigma_mad', '1.1', 1.05, 1.15, 'mm']]
    """
    return _cells().copy()


def entries(rows: pd.DataFrame | list[dict], **same: str) -> pd.DataFrame:
    """Return a study's values of printed numbers, as they stand in its ``ledger.csv``.

    Parameters
    ----------
    rows : DataFrame or list of dict
        ``source``, ``table``, ``cell``: which printed number, as in :func:`cells`. ``value``: ours
        in the cell's unit; NaN where it could not be measured, then the note says why. ``kind``:
        predicted from printed inputs alone; measured on simulated or real data; or fitted, from a
        model of which a parameter was fitted to the source's numbers. ``low`` and ``high``: our
        95 % interval, if there is one. ``note``: one sentence on how the value was found, with the
        argument if it differs. Other columns are left out.
    **same
        Columns that are the same in all rows.

    Returns
    -------
    DataFrame
        With the columns ``COLUMNS``.

    Raises
    ------
    ValueError
        If there is no such cell or kind.

    Examples
    --------
    >>> d1 = {"cell": "A 5 m d1", "value": 4.2, "low": 3.9, "high": 4.5}
    >>> table = entries([d1], source="pfeifer2021", table="table_2", kind="measured")
    >>> table[["cell", "kind", "note"]].to_numpy().tolist()
    [['A 5 m d1', 'measured', '']]
    >>> entries([d1 | {"cell": "D 5 m d1"}], source="pfeifer2021", table="table_2", kind="measured")
    Traceback (most recent call last):
    ValueError: Invalid cell pfeifer2021 table_2 D 5 m d1. Must be one that cells() lists.
    """
    table = pd.DataFrame(rows).assign(**same).reindex(columns=COLUMNS)
    table["note"] = table["note"].astype(object).fillna("")
    known = _cells().set_index(CELL).index
    for place in table.set_index(CELL).index.difference(known, sort=False):
        raise ValueError(f"Invalid cell {' '.join(place)}. Must be one that cells() lists.")
    for kind in table["kind"]:
        check_choice(kind, "kind", OUR_KINDS)
    return table


def verdict(printed: Mapping, ours: Mapping) -> str:
    """Return the verdict on one value of ours.

    Parameters
    ----------
    printed : mapping
        ``relation``, ``low``, ``high`` of a row of :func:`cells`. An interval with one infinite
        end is open at the other; others are closed.
    ours : mapping
        ``value``, ``low``, ``high`` of an entry; the value stands for an end that is NaN. What
        agrees with a ``kind`` of fitted is fitted: a fit is no reproduction.

    Returns
    -------
    str
        One of ``CELL_VERDICTS``. A dash without a bound is reproduced by a value that could not be
        measured either (NaN) and differs by one that could.

    Examples
    --------
    >>> width = {"relation": "=", "low": 14.5, "high": 15.5}
    >>> verdict(width, {"value": 15.3, "low": np.nan, "high": np.nan})
    'reproduced'
    >>> verdict(width, {"value": 17.0, "low": 15.2, "high": 18.8})
    'consistent'
    >>> verdict(width, {"value": 17.0, "low": 16.2, "high": 17.8})
    'differs'
    """
    value, fitted = ours["value"], ours.get("kind") == "fitted"
    if np.isnan(printed["low"]):
        return "differs" if not np.isnan(value) else "fitted" if fitted else "reproduced"
    if np.isnan(value):
        return "not comparable"
    low, high = (value if np.isnan(ours[end]) else ours[end] for end in ("low", "high"))
    equal = _meets(printed, value, value)
    if not equal and not _meets(printed, low, high):
        return "differs"
    if fitted:
        return "fitted"
    return "reproduced" if equal and printed["relation"] == "=" else "consistent"


def collect(folder: str | os.PathLike, *, not_run: Collection[str] = ()) -> pd.DataFrame:
    """Return the whole ledger of a run.

    Parameters
    ----------
    folder : path
        Results of a run; every ``<study>/ledger.csv`` below it is read.
    not_run : collection of str
        Source and table, such as ``"pfeifer2021 table_2"``, of studies that left no ledger.

    Returns
    -------
    DataFrame
        The columns of :func:`cells`, and ``ours``, ``ours_low``, ``ours_high``, ``kind``,
        ``study``, ``note``, ``verdict``, ``decides``. A cell has a row for each of our values, or
        one row without. Exactly one row of a cell *decides*: predicted before measured before
        fitted, then in the order of studies and of their rows.

    Raises
    ------
    ValueError
        If a ``ledger.csv`` names a cell or a kind that does not exist.

    Examples
    --------
    >>> ledger = collect("no/such/folder")
    >>> bool(ledger["decides"].all()), ledger["verdict"].unique().tolist()
    (True, ['not comparable'])
    """
    rules = published._strings("reasons").to_dict("records")
    reasons = [_reason(cell, rules) for cell in cells().to_dict("records")]
    ledger = cells().assign(reason=reasons)
    ledger = ledger.merge(_entries(folder), on=CELL, how="left")
    ledger["verdict"] = [_verdict_of_row(row, not_run) for row in ledger.to_dict("records")]
    silent = (ledger["verdict"] == "not comparable") & (ledger["note"].fillna("") == "")
    ledger["note"] = ledger["note"].fillna("").where(~silent, ledger["reason"])
    ledger["decides"] = ~ledger.duplicated(CELL)
    return ledger.fillna({"kind": "", "study": ""}).drop(columns="reason")


def verdicts(rows: pd.DataFrame) -> pd.Series:
    """Return the verdict on each cell of a study's entries, by its name: of the row that decides.

    It is the row that decides in :func:`collect`, whatever the order of the table.

    Parameters
    ----------
    rows : DataFrame
        Of :func:`entries`.

    Returns
    -------
    Series of str

    Examples
    --------
    >>> d1 = {"cell": "A 5 m d1", "value": 4.2, "low": 3.9, "high": 4.5}
    >>> table = entries([d1], source="pfeifer2021", table="table_2", kind="measured")
    >>> verdicts(table).to_dict()
    {'pfeifer2021 table_2 A 5 m d1': 'reproduced'}
    """
    printed, ours = _cells().set_index(CELL), _by_rank(rows).drop_duplicates(CELL).sort_index()
    ours = ours.set_index(CELL)
    found = {
        " ".join(place): verdict(printed.loc[place], row)
        for place, row in zip(ours.index, ours.to_dict("records"), strict=True)
    }
    return pd.Series(found, dtype=object)


def summary(ledger: pd.DataFrame) -> pd.DataFrame:
    """Return how many results of each source have which verdict.

    Parameters
    ----------
    ledger : DataFrame
        Of :func:`collect`.

    Returns
    -------
    DataFrame
        Sources by verdicts, with a row ``all``; without ``not run`` where all studies have run.

    Examples
    --------
    >>> int(summary(collect("no/such/folder")).loc["poreba2013"].sum())
    80
    """
    rows = ledger[ledger["decides"] & (ledger["role"] == "result")]
    sources = published._strings("sources")["source"]
    counts = pd.crosstab(rows["source"], rows["verdict"])
    counts = counts.reindex(index=sources, columns=CELL_VERDICTS, fill_value=0)
    counts.loc["all"] = counts.sum()
    return counts if counts["not run"].any() else counts.drop(columns="not run")


@cache
def _cells():
    """All cells, read once."""
    found = published._strings("cells").copy()
    found[CELL_NUMBERS] = found[CELL_NUMBERS].replace("", "nan").astype(float)
    return found


def _meets(printed, low, high):
    """Whether an interval of ours and the printed one have a value in common."""
    if np.isinf(printed["high"]):
        return bool(high > printed["low"])
    if np.isinf(printed["low"]):
        return bool(low < printed["high"])
    slack = 1e-9 * max(1.0, abs(printed["high"]))
    return bool(low <= printed["high"] + slack and high >= printed["low"] - slack)


def _reason(cell, rules):
    """The reason of the first rule whose patterns fit a cell."""
    keys = (*CELL, "role")
    fitting = (rule for rule in rules if all(fnmatchcase(cell[k], rule[k]) for k in keys))
    return next((rule["reason"] for rule in fitting), "")


def _entries(folder):
    """All entries below a folder, those that decide first."""
    found = [pd.DataFrame(columns=[*COLUMNS, "study"])]
    for file in sorted(Path(folder).glob("*/ledger.csv")):
        found.append(entries(pd.read_csv(file)).assign(study=file.parent.name))
    found = pd.concat(found[1:] or found).astype(dict.fromkeys(CELL_NUMBERS, float))
    renamed = {"value": "ours", "low": "ours_low", "high": "ours_high"}
    return _by_rank(found).rename(columns=renamed)


def _by_rank(entries):
    """Entries in the order in which they decide: predicted, measured, fitted."""
    return entries.sort_values("kind", key=lambda kind: kind.map(OUR_KINDS.index), kind="stable")


def _verdict_of_row(row, not_run):
    """The verdict of one row of the joined table."""
    if pd.isna(row["kind"]):
        waits = row["role"] == "result" and f"{row['source']} {row['table']}" in not_run
        return "not run" if waits else "not comparable"
    ours = {"value": row["ours"], "low": row["ours_low"], "high": row["ours_high"]}
    return verdict(row, ours | {"kind": row["kind"]})
