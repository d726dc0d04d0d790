"""What the learned method was to reach, written down before measuring, and what it reaches."""

import numpy as np
import pandas as pd

from mmqa_lab import stats
from mmqa_lab.run import Check
from mmqa_lab.studies.poles import surveys as tables

POSTS = ("sign", "lamp", "other")
"""Poles without bark: their diameters are asked for."""


QUIET = "ours, quiet"
"""The learned method with the verifier that has seen quiet streets alone."""

RATES = (
    ("chosen street, 30 m", "plain", "ours", 30.0, "all", 0.96, 0.96),
    ("chosen street, 30 m", "plain", "ours", 30.0, "tree", 0.94, None),
    ("chosen street, 15 m", "plain", "ours", 15.0, "all", 0.97, 0.97),
    ("chosen street, 12.5 m", "plain", "ours", 12.5, "all", 0.975, 0.98),
    ("balconies, 30 m", "balconies", "ours", 30.0, "all", 0.94, 0.93),
    ("balconies, trained on quiet streets", "balconies", QUIET, 30.0, "all", 0.94, 0.93),
    ("976 kHz, 30 m", "dense", "ours", 30.0, "all", 0.90, 0.93),
)
"""Setting, surveys, method, corridor (m), class, least recall and least precision."""

REAL_F1 = (("other blocks after simulated streets", 0.88), ("simulated streets", 0.80))
"""What the method was trained on, and the least F1 on the real clouds."""

DIAMETER_MM = (6.0, 1.0)
"""Largest root mean square error and largest bias of posts within 12.5 m."""

SLACK = 0.10
ENOUGH = 30
"""A rate of so many poles may miss its aim by that much before the study says so aloud."""


def table(*, plain, balconies, dense, real=None):
    """Return what was to be reached beside what is obtained.

    Parameters
    ----------
    plain, balconies, dense : list of Survey
        Of the chosen street, of streets with many balconies, and with a dense scanner; with the
        detections of ``ours``, those with balconies also with those of ``QUIET``.
    real : DataFrame, optional
        Of :func:`mmqa_lab.studies.poles.oakland.rates`.

    Returns
    -------
    DataFrame
        ``setting``, ``quantity``, ``aim``, ``value``, ``low``, ``high``, ``n``, ``unit``,
        ``verdict``: ``reached``, ``missed`` or ``not measured``.
    """
    given = {"plain": plain, "balconies": balconies, "dense": dense}
    rows = []
    for setting, which, method, corridor, kind, *aims in RATES:
        found = tables.rates(given[which], corridors=(corridor,), names=(method,))
        for quantity, aim in zip(("recall", "precision"), aims, strict=True):
            if aim is not None:
                chosen = (found["quantity"] == quantity) & (found["class"] == kind)
                one = found[chosen].iloc[0]
                name = quantity if kind == "all" else f"{quantity} of {kind}s"
                rows.append(
                    _row(setting, name, aim, one["value"], one["low"], one["high"], one["n"])
                )
    frame = pd.DataFrame([*rows, *_real(real), *_diameters(plain)])
    sign = np.where(frame["unit"] == "mm", -1, 1)
    good = sign * frame["value"].abs() >= sign * frame["aim"]
    frame["verdict"] = np.where(frame["value"].isna(), "not measured", "missed")
    frame.loc[good, "verdict"] = "reached"
    return frame


def checks(reached):
    """Test that no aim is missed by much, and name those that are missed."""
    rates = reached[(reached["unit"] == "1") & (reached["n"] >= ENOUGH)]
    missed = reached[reached["verdict"] == "missed"]
    named = [
        f"{row.setting}, {row.quantity} {row.value:.3f} for {row.aim:g}"
        for row in missed.itertuples()
    ]
    yield from [
        Check(
            f"No rate of the learned method lies more than {SLACK:.2f} below its aim.",
            bool((rates["value"] >= rates["aim"] - SLACK).all()),
            "; ".join([f"missed {len(named)} of {len(reached)}", *named]),
            f"two standard deviations of a rate of 0.9 of {ENOUGH} poles are 0.11",
        )
    ]


def _row(setting, quantity, aim, value, low=np.nan, high=np.nan, n=0, unit="1"):
    """One row of the table."""
    numbers = {"aim": aim, "value": value, "low": low, "high": high, "n": int(n)}
    return {"setting": setting, "quantity": quantity, **numbers, "unit": unit}


def _real(real):
    """The rows of the real clouds; without values where they are not at hand."""
    for trained, aim in REAL_F1:
        value, n = np.nan, 0
        if real is not None:
            own = real[(real["method"] == "ours") & real["trained_on"].str.startswith(trained)]
            if len(own):
                value, n = own["f1"].iloc[0], own["n"].iloc[0]
        yield _row(f"Oakland, trained on {trained}", "F1", aim, value, n=n)


def _diameters(surveys):
    """The rows of the diameters of posts."""
    residuals = [s.score("ours", corridor=12.5).diameter_residuals(classes=POSTS) for s in surveys]
    found = stats.errors(1000 * np.concatenate(residuals))
    for name, aim, value in zip(
        ("RMSE", "bias"), DIAMETER_MM, (found.rmse, found.bias), strict=True
    ):
        yield _row("diameter of posts, 12.5 m", name, aim, value, n=found.n, unit="mm")
