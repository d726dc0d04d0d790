"""What the five sources print: tables and numbers as data, each with its section and DOI.

The package's studies set their own figures beside these. The data stand in CSV files under
``data/<source>/``; the conventions are:

- ``printed`` is the string in print where it says more than the number (a dash, a range, ``n/a``, a
  unit). ``value`` is the number, and NaN where there is none; ``text`` is a result in words.
- ``status`` says what an empty number means: ``printed``; ``not_resolved`` (a printed dash: coarser
  than the chart, or not measurable); ``not_evaluated`` (an empty cell); ``not_applicable``
  (``n/a``); ``not_available`` (``N/A``); ``not_printed`` (the text announces a number and gives
  none).
- ``relation`` is ``=``, ``<``, ``<=``, ``>``, ``>=``, ``about``, ``within`` (plus or minus),
  ``up to``, or ``range`` (columns ``low`` and ``high``).
- ``role`` separates a ``result`` from the ``set-up`` of the experiment, a ``threshold``, and
  numbers that the source quotes from the ``literature``.
- Units stand in the names of columns, or in the column ``unit``.
- Numbers calculated from printed ones stand only in the tables ``derived``.

:mod:`mmqa_lab.published.ledger` compares every printed result with what the studies find.

Examples
--------
>>> table("pfeifer2021", "table_2").query("system == 'C'")["sigma_mad_mm"].tolist()
[14.0, 23.0]
>>> number("eurosdr2013_mls", "visible_share")["value"]
74.3
"""

from functools import cache
from importlib import resources

import pandas as pd

from mmqa_lab._checks import check_choice

__all__ = ["number", "raw", "table"]
__dir__ = ["ledger", *__all__].copy

DATA = resources.files("mmqa_lab.published") / "data"


def table(source: str, name: str) -> pd.DataFrame:
    """Return one table of a source.

    Parameters
    ----------
    source : str
        ``pfeifer2021``, ``poreba2013``, ``cahalane2014``, ``eurosdr2013_mls`` or
        ``eurosdr2013_radiometry``.
    name : str
        Such as ``table_1``; an unknown name is answered with those that there are.

    Returns
    -------
    DataFrame
        A new frame. Text is a string (empty where nothing is printed), numbers are float (NaN
        where there is none) or int, yes/no columns are bool. Units as the names of the columns say.

    Raises
    ------
    ValueError
        If the source or the table is unknown.

    Examples
    --------
    >>> table("eurosdr2013_mls", "table_3_3")["std_cm"].head(4).tolist()
    [3.9, 3.9, 2.0, 2.0]
    >>> table("pfeifer2021", "table_3")
    Traceback (most recent call last):
    ValueError: Invalid table of pfeifer2021 'table_3'. Must be one of table_1, table_2, criteria,
    systems, numbers, derived.
    """
    frame = raw(source, name)
    types = _strings("columns").set_index("column")["type"]
    for column in frame.columns.intersection(types.index):
        frame[column] = _typed(frame[column], types[column])
    return frame


def raw(source: str, name: str) -> pd.DataFrame:
    """Return one table of a source with every cell as the string that the file contains.

    Trailing zeros are kept, so that the digits in print can be counted.

    Parameters
    ----------
    source, name : str
        As in :func:`table`.

    Returns
    -------
    DataFrame of str
        Empty strings where nothing is printed.

    Raises
    ------
    ValueError
        If the source or the table is unknown.

    Examples
    --------
    >>> raw("poreba2013", "table_1")["detection_rate_percent"].iloc[0]
    '99.90'
    """
    check_choice(source, "source", tuple(_strings("sources")["source"]))
    known = _strings("contents").query("source == @source")["table"]
    check_choice(name, f"table of {source}", tuple(known))
    return _strings(f"{source}/{name}").copy()


def number(source: str, key: str) -> dict:
    """Return one number that stands in the text of a source.

    Parameters
    ----------
    source : str
        As in :func:`table`.
    key : str
        The ``id`` of a row in one of the source's tables (``numbers``, ``statements``, ...).

    Returns
    -------
    dict
        The row: ``quantity``, ``relation``, ``value`` (or ``low`` and ``high``), ``unit``,
        ``section`` and whatever else its table has, with ``table``.

    Raises
    ------
    ValueError
        If the source or the number is unknown.

    Examples
    --------
    >>> precision = number("poreba2013", "precision_text")
    >>> precision["relation"], precision["value"], precision["unit"]
    ('about', 0.3, 'm')
    """
    check_choice(source, "source", tuple(_strings("sources")["source"]))
    rows = {}
    for name in _strings("contents").query("source == @source and kind == 'published'")["table"]:
        frame = table(source, name)
        if "id" in frame:
            rows |= {row["id"]: row for row in frame.assign(table=name).to_dict("records")}
    check_choice(key, f"number of {source}", tuple(filter(None, rows)))
    return rows[key]


@cache
def _strings(path):
    """A CSV file below ``data``, every cell a string; the frame is shared, so leave it as it is."""
    with (DATA / f"{path}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file, dtype=str, keep_default_na=False)


def _typed(cells, kind):
    """Turn strings into the type that the list of columns gives."""
    if kind == "bool":
        return cells.isin(["yes", "1"])
    numbers = pd.to_numeric(cells)
    return numbers.astype(float) if kind == "float" else numbers
