"""EuroSDR 2013, benchmark on mobile laser scanning, chapter 4: detection of poles.

Tables 4-1 (Finnish Geodetic Institute, scan-line method) and 4-2 (ITC, component method), test
field Espoonlahti. The numbers of targets are those of Lehtomaki et al. 2011, ISPRS Archives
XXXVIII-5/W12; where a count is not printed it is computed from the printed percentage and its n by
rounding, and marked so.
"""

import pandas as pd

SOURCE = "EuroSDR 2013, mobile laser scanning, chapter 4, Tables 4-1 and 4-2"

FIELD_TARGETS = 577
VISIBLE_TARGETS = 429
"""Poles in the field and those that the cloud shows, 74.3 %; 99 were for tuning, 330 for tests."""


def table_4_1():
    """Return Table 4-1: the scan-line method on the 330 test targets.

    Returns
    -------
    DataFrame
        ``quantity`` (recall, precision), ``corridor_m``, ``class``, ``k``, ``n``, ``value``,
        ``low``, ``high`` (Wilson, 95 %), ``count`` (``printed`` or ``by rounding``), ``kind``.

    Notes
    -----
    "others" is what is left when trees, signs and lamp posts are taken from all.

    Examples
    --------
    >>> table_4_1().query("quantity == 'precision'")["k"].tolist()
    [230, 136]
    """
    rows = [
        ("recall", 30.0, "all", 230, 330),
        ("recall", 12.5, "all", 136, 190),
        ("precision", 30.0, "all", 230, 266),
        ("precision", 12.5, "all", 136, 143),
        ("recall", 30.0, "tree", 75, 127),
        ("recall", 30.0, "sign", 65, 79),
        ("recall", 30.0, "lamp", 44, 46),
        ("recall", 30.0, "other", 46, 78),
    ]
    return _with_intervals(rows, "table_4_1")


def table_4_2():
    """Return Table 4-2: the component method within 15 m, two driving directions together.

    Returns
    -------
    DataFrame
        ``quantity``, ``corridor_m``, ``class``, ``value``, ``kind``.

    Notes
    -----
    The numbers behind the percentages were not at hand: there are no intervals.

    Examples
    --------
    >>> table_4_2()["value"].tolist()
    [0.519, 0.862]
    """
    rows = [("recall", 15.0, "all", 0.519), ("precision", 15.0, "all", 0.862)]
    frame = pd.DataFrame(rows, columns=["quantity", "corridor_m", "class", "value"])
    frame["kind"] = "published"
    frame.attrs["source"] = SOURCE
    return frame


def _with_intervals(rows, name):
    """Counts as a table with rates and Wilson intervals."""
    from statsmodels.stats.proportion import proportion_confint

    frame = pd.DataFrame(rows, columns=["quantity", "corridor_m", "class", "k", "n"])
    frame["value"] = frame["k"] / frame["n"]
    frame["low"], frame["high"] = proportion_confint(frame["k"], frame["n"], method="wilson")
    frame["count"] = "by rounding"
    frame["kind"] = "published"
    frame.attrs["source"] = f"{SOURCE} ({name})"
    return frame


def diameters():
    """Return the errors of pole diameters by the scan-line method, chapter 4.

    Returns
    -------
    DataFrame
        ``method``, ``class``, ``n``, ``bias_mm``, ``rmse_mm`` and ``kind`` = published.

    Examples
    --------
    >>> diameters()["rmse_mm"].item()
    8.3
    """
    row = {"method": "fgi", "class": "all", "n": 41, "bias_mm": -3.1, "rmse_mm": 8.3}
    return pd.DataFrame([{**row, "kind": "published"}])
