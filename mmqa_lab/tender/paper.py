"""Criteria and results of Pfeifer et al. 2021 (doi:10.3390/rs13020237) as tables of a tender.

``criteria.csv`` and ``results.csv`` give the printed figures under the names of a tender's tables.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice
from mmqa_lab.tender.tables import is_mark

__all__ = ["published_criteria", "published_results"]

RESULT_COLUMNS = [
    *("system", "distance_m", "view", "direction"),
    *("quantity", "value", "low", "high", "sigma"),
]


def published_criteria(name: str, *, cloud_distance_m: float = 5.0) -> pd.DataFrame:
    """Return a set of criteria as Pfeifer et al. 2021 print it.

    Parameters
    ----------
    name : {"test", "scenario 1", "scenario 2"}
        The test of section 4.2, or an example of section 4.4.
    cloud_distance_m : float
        Where no distance is printed for a figure of the cloud: the 5 m of the other criteria.

    Returns
    -------
    DataFrame
        As :func:`verdicts` wants it. Where the paper prints no relation (section 4.4), a
        figure may reach its threshold.

    Raises
    ------
    ValueError
        If the name is another.

    Examples
    --------
    >>> table = published_criteria("scenario 1")
    >>> table[["quantity", "relation", "threshold", "distance_m"]].values.tolist()
    [['legibility_40mm', '<=', 'b', 10.0], ['density_per_m2', '>=', 4000.0, 5.0],
     ['sigma_mad_mm', '<=', 5.0, 5.0]]
    """
    table = _table("criteria.csv", "threshold")
    sets = check_choice(name, "criteria", tuple(table["set"].unique()))
    table = table[table["set"] == sets].drop(columns="set").reset_index(drop=True)
    of_a_cloud = table["distance_m"].isna() & ~table["quantity"].str.startswith("legibility")
    table["distance_m"] = table["distance_m"].mask(of_a_cloud, cloud_distance_m)
    return table


def published_results(*, repeatability: bool = False, by_pixels: bool = False) -> pd.DataFrame:
    """Return Tables 1 and 2 of Pfeifer et al. 2021 in the form that :func:`verdicts` takes.

    Parameters
    ----------
    repeatability : bool
        Add what section 4.4 says of repeated measurements, for all systems and distances: ``sigma``
        of the density (five selections of B at 10 m vary by less than 1 %), of sigma_MAD (by less
        than 1 mm) and of pixel sizes (below 1 px for a bar), and one rung to either side of a
        line-pair width. Upper bounds are printed, so these are too wide.
    by_pixels : bool
        Give texts of 60 mm that were not judged the marks that their pixels per capital height
        allow, between those of the photographs that were judged: the worst one, and the interval
        to the best one.

    Returns
    -------
    DataFrame
        ``system``, ``quantity``, ``value``, ``low``, ``high``, ``sigma``, ``distance_m``, ``view``,
        ``direction``. A dash of a line-pair width is an interval that begins at the coarsest
        pattern of the chart. Texts of 60 mm at 5 m, which the chart does not have, are as legible
        as those of 40 mm where these are (a, b); else empty.

    Examples
    --------
    >>> results = published_results(by_pixels=True)
    >>> texts = results.query("quantity == 'legibility_60mm'")
    >>> texts[["system", "value"]].values.tolist()
    [['A', 'b'], ['B', 'a'], ['C', 'b']]
    """
    table = _table("results.csv", "value", "pixels_value")
    chosen = ["repeated"] * repeatability + ["pixels"] * by_pixels
    for name in (f"{way}_{figure}" for way in chosen for figure in ("value", "low", "high")):
        if name in table:
            figure = name.partition("_")[2]
            table[figure] = table[name].where(table[name].notna(), table[figure])
    table["sigma"] = table["repeated_sigma"] if repeatability else np.nan
    return table[RESULT_COLUMNS]


def _table(name, *mixed):
    """A table of this folder; columns of marks and numbers hold both, words may be empty."""
    texts = dict.fromkeys(mixed, str)
    table = pd.read_csv(Path(__file__).with_name(name), dtype=texts)
    for column in mixed:
        values = [one if pd.isna(one) or is_mark(one) else float(one) for one in table[column]]
        table[column] = pd.Series(values, dtype=object)
    words = table.columns.intersection(["view", "direction"])
    return table.fillna(dict.fromkeys(words, ""))
