"""Poles, EuroSDR 2013, chapter 4: two published detectors, a better one, and what their rates mean.

``surveys`` scans streets and scores methods; ``factors`` changes one thing at a time; ``reach``
holds the aims; ``figures`` and ``scene`` draw; ``oakland`` is the real counterpart; ``training``
makes the verifier.
"""

import pandas as pd

from mmqa_lab.poles import METHODS
from mmqa_lab.published import eurosdr2013
from mmqa_lab.run import Check
from mmqa_lab.studies.poles import surveys

QUICK = {
    "length": 60.0,
    "speed": 14.0,
    "seeds": (5001,),
    "balcony_seeds": (5001,),
    "balcony_length": 12.0,
    "dense_seeds": (5001,),
    "dense_length": 6.0,
    "density_shares": (0.1,),
    "factor_seeds": (5002,),
    "factor_length": 12.0,
    "factor_names": ("no shrubs",),
    "fgi_changes": {"maximum_width": (0.70,)},
    "tiles": 1,
    "folds": 0,
}
"""Small parameters for the tests."""

CORRIDORS_M = (30.0, 15.0, 12.5)


def compute(*, plan, scanner, seeds, length, speed):
    """Survey streets and score all methods.

    Parameters
    ----------
    plan, scanner : str
        Of :mod:`mmqa_lab.simulate.streets`.
    seeds : tuple of int
        One street each.
    length : float
        Of a street, metres.
    speed : float
        Metres per second.

    Returns
    -------
    list of Survey, DataFrame
        The surveys with the detections of all methods; the rates of each method and corridor
        (:func:`mmqa_lab.studies.poles.surveys.rates`).
    """
    made = surveys.drive_all(plan, scanner, seeds, length=length, speed=speed)
    for survey in made:
        for method in METHODS:
            survey.detect(method)
    return made, surveys.rates(made, corridors=CORRIDORS_M)


def beside_published(rates):
    """Return our rates beside Tables 4-1 and 4-2, with the difference.

    Returns
    -------
    DataFrame
        ``method``, ``quantity``, ``corridor_m``, ``class``, ``published``, ``low``, ``high``,
        ``measured``, ``measured_low``, ``measured_high``, ``difference``.
    """
    rows = []
    tables = {"fgi": eurosdr2013.table_4_1(), "itc": eurosdr2013.table_4_2()}
    for method, table in tables.items():
        for row in table.itertuples():
            mine = rates[
                (rates["method"] == method)
                & (rates["quantity"] == row.quantity)
                & (rates["corridor_m"] == row.corridor_m)
                & (rates["class"] == table.loc[row.Index, "class"])
            ]
            one = mine.iloc[0]
            rows.append(
                {
                    "method": method,
                    "quantity": row.quantity,
                    "corridor_m": row.corridor_m,
                    "class": one["class"],
                    "published": row.value,
                    "low": getattr(row, "low", float("nan")),
                    "high": getattr(row, "high", float("nan")),
                    "measured": one["value"],
                    "measured_low": one["low"],
                    "measured_high": one["high"],
                    "difference": one["value"] - row.value,
                }
            )
    return pd.DataFrame(rows)


def checks(rates):
    """Test what the notebook says."""
    f1 = rates[rates["quantity"] == "f1"].set_index(["method", "corridor_m"])["value"]
    recall = rates[(rates["quantity"] == "recall") & (rates["corridor_m"] == 30.0)]
    by_class = recall[recall["method"] == "fgi"].set_index("class")["value"]
    precision = rates[(rates["quantity"] == "precision") & (rates["method"] == "fgi")]
    precision = precision.set_index("corridor_m")["value"]
    yield from [
        Check(
            "The learned method beats both published ones at 30 m.",
            bool(f1["ours", 30.0] > max(f1["fgi", 30.0], f1["itc", 30.0])),
            ", ".join(f"{m} F1 {f1[m, 30.0]:.3f}" for m in METHODS),
            "an order, no tolerance",
        ),
        Check(
            "The scan-line method finds a smaller share of trees than of lamp posts.",
            bool(by_class["tree"] < by_class["lamp"]),
            f"trees {by_class['tree']:.2f}, lamp posts {by_class['lamp']:.2f}",
            "published .59 and .96; an order, no tolerance",
        ),
        Check(
            "Most false alarms of the scan-line method lie beyond 12.5 m: precision falls with "
            "the corridor.",
            bool(precision[12.5] >= precision[30.0]),
            f"{precision[12.5]:.2f} within 12.5 m, {precision[30.0]:.2f} within 30 m",
            "published .951 and .865; an order, no tolerance",
        ),
    ]
