"""EuroSDR 2013, mobile laser scanning, chapter 3: accuracy on the test field.

Tables 3-2 (the systems), 3-3 (elevation) and 3-4 (planimetry) of the report were not at hand when
this module was written: what is known of them from elsewhere is filled in, every other cell is NaN,
and ``attrs["missing"]`` counts them. What the article on the same test says in words is in
``statements``.
"""

import numpy as np
import pandas as pd

SOURCE = "EuroSDR 2013, mobile laser scanning, chapter 3"

ARTICLE = (
    "Kaartinen et al. 2012, Benchmarking the performance of mobile laser scanning systems using a "
    "permanent test field, Sensors 12(9), 12814-12835, doi:10.3390/s120912814, abstract"
)

SYSTEMS = ("ROAMER I", "ROAMER II")
"""Rows of the accuracy tables whose names are known here: one system, two states of calibration."""


def table_3_2():
    """Return Table 3-2, the systems, as far as known.

    Returns
    -------
    DataFrame
        ``system``, ``pulse_rate_hz``, ``lines_per_s``, ``tilt_deg``, ``kind`` = published.
        ``attrs["source"]``, ``attrs["missing"]``.

    Examples
    --------
    >>> table_3_2()["lines_per_s"].tolist()
    [48.0]
    """
    names = ["system", "pulse_rate_hz", "lines_per_s", "tilt_deg"]
    table = pd.DataFrame([("ROAMER", 120_000.0, 48.0, 45.0)], columns=names)
    return _published(table, "Table 3-2", "the rows of the other systems")


def table_3_3():
    """Return Table 3-3, elevation accuracy; all its cells are missing here.

    Returns
    -------
    DataFrame
        ``system``, ``direction``, ``mean_mm``, ``min_mm``, ``max_mm``, ``std_mm``, ``rmse_mm``.

    Examples
    --------
    >>> int(table_3_3()["std_mm"].notna().sum())
    0
    """
    names = ["direction", "mean_mm", "min_mm", "max_mm", "std_mm", "rmse_mm"]
    return _empty(names, "Table 3-3")


def table_3_4():
    """Return Table 3-4, planimetric accuracy; all its cells are missing here.

    Returns
    -------
    DataFrame
        ``system``, ``object``, ``mean_mm``, ``min_mm``, ``max_mm``, ``std_mm``, ``rmse_mm``.

    Examples
    --------
    >>> bool(table_3_4()["rmse_mm"].isna().all())
    True
    """
    names = ["object", "mean_mm", "min_mm", "max_mm", "std_mm", "rmse_mm"]
    return _empty(names, "Table 3-4")


def statements():
    """Return what the abstract of the article on the same test states in numbers.

    Returns
    -------
    DataFrame
        ``statement``, ``quantity`` (elevation or planimetry), ``bound_mm``, ``range_m``, ``kind``.

    Examples
    --------
    >>> statements()["bound_mm"].tolist()
    [35.0, 25.0]
    """
    rows = [
        ("all professional systems, calibrated: better than", "elevation", 35.0, 35.0),
        ("the best system", "planimetry", 25.0, 45.0),
    ]
    table = pd.DataFrame(rows, columns=["statement", "quantity", "bound_mm", "range_m"])
    table["kind"] = "published"
    table.attrs["source"] = ARTICLE
    return table


def _empty(names, number):
    """A table of the known systems without values."""
    table = pd.DataFrame({"system": SYSTEMS} | dict.fromkeys(names, np.nan))
    return _published(table, number, "all cells, and the rows of the other systems")


def _published(table, number, missing):
    """The table with kind and source."""
    table["kind"] = "published"
    table.attrs["source"] = f"{SOURCE}, {number}"
    table.attrs["missing"] = missing
    return table
