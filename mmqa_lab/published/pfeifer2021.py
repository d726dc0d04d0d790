"""Pfeifer et al. 2021, point-cloud part: Table 2 and the thresholds of the tender.

Remote Sensing 13(2), 237, doi:10.3390/rs13020237. Cells that were not at hand when this module was
written are NaN; ``attrs["missing"]`` says so. Nothing is filled in by calculation.
"""

import numpy as np
import pandas as pd

SOURCE = "Pfeifer et al. 2021, Table 2, doi:10.3390/rs13020237"

F_THRESHOLD = 2.0
"""Largest inhomogeneity f = d4/d1 the tender accepts (section 4.4)."""

DENSITY_THRESHOLD_PER_M2 = 3000.0
"""Smallest density the tender accepts at 5 m (section 4.4)."""

SIGMA_MAD_THRESHOLD_MM = 15.0
"""Largest sigma_MAD the tender accepts (section 4.4)."""


def table_2():
    """Return Table 2: the three systems at 5 m and 10 m.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``density_per_m2``, ``precision_mm``, ``d1_mm``, ``d4_mm`` and
        ``f`` as printed, and ``kind`` = published. ``attrs["source"]``, ``attrs["missing"]``.

    Notes
    -----
    The spacings are printed in whole millimetres: at d1 = 4 mm half a millimetre is 12 %, so the
    third digit of f = 11.8 carries nothing (:func:`rounding_check`). The precisions of systems A
    and B are known here only without their distance and are therefore left out of the table:
    about 1.1 mm for A and 9.2 mm for B.

    Examples
    --------
    >>> table_2().query("system == 'A' and distance_m == 5")["density_per_m2"].item()
    4629.0
    """
    nan = np.nan
    rows = [
        ("A", 5, 4629, nan, 4, 47, 11.8),
        ("A", 10, 2437, nan, 9, 46, 5.1),
        ("B", 5, 3140, nan, 10, 25, 2.5),
        ("B", 10, 1712, nan, 14, 36, 2.6),
        ("C", 5, nan, nan, 3, 8, nan),
        ("C", 10, nan, nan, nan, nan, nan),
    ]
    names = ["system", "distance_m", "density_per_m2", "precision_mm", "d1_mm", "d4_mm", "f"]
    table = pd.DataFrame(rows, columns=names)
    table["kind"] = "published"
    table.attrs["source"] = SOURCE
    table.attrs["missing"] = f"{int(table[names].isna().sum().sum())} cells not at hand"
    return table


def rounding_check(table=None):
    """Check f = d4/d1 and density = 1/(d1 d4) against the digits printed.

    Each printed value stands for an interval of half a unit of its last digit to either side. f is
    *consistent* when its interval meets that of d4/d1. On a rectangular lattice 1/(d1 d4) is
    the density; where the density lies outside of its interval, the pattern is no such lattice or a
    printed value is wrong.

    Parameters
    ----------
    table : DataFrame, optional
        :func:`table_2`, by default.

    Returns
    -------
    DataFrame
        ``f``, ``f_low``, ``f_high``, ``f_consistent``; ``density_per_m2``,
        ``lattice_low_per_m2``, ``lattice_high_per_m2``, ``lattice_consistent`` (None where a cell
        is missing).

    Examples
    --------
    >>> check = rounding_check()
    >>> check["f_consistent"].tolist()[:4]
    [True, True, True, True]
    """
    table = table_2() if table is None else table
    d1, d4 = table["d1_mm"], table["d4_mm"]
    check = table[["system", "distance_m", "d1_mm", "d4_mm", "f"]].copy()
    check["f_low"], check["f_high"] = (d4 - 0.5) / (d1 + 0.5), (d4 + 0.5) / (d1 - 0.5)
    check["f_consistent"] = _within(table["f"], check["f_low"], check["f_high"], 0.05)
    check["density_per_m2"] = table["density_per_m2"]
    check["lattice_low_per_m2"] = 1e6 / ((d1 + 0.5) * (d4 + 0.5))
    check["lattice_high_per_m2"] = 1e6 / ((d1 - 0.5) * (d4 - 0.5))
    low, high = check["lattice_low_per_m2"], check["lattice_high_per_m2"]
    check["lattice_consistent"] = _within(table["density_per_m2"], low, high, 0.5)
    check.attrs["source"] = SOURCE
    return check


def _within(value, low, high, half_unit):
    """Whether printed values reach into intervals; None where any of them is missing."""
    inside = ((value + half_unit >= low) & (value - half_unit <= high)).astype(object)
    return inside.where(value.notna() & low.notna(), None)
