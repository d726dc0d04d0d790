"""A tender's verdict: measured figures against criteria, with margin and uncertainty."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice
from mmqa_lab.chart_image.legibility import MARKS

RELATIONS = {
    ">=": lambda value, threshold: value >= threshold,
    ">": lambda value, threshold: value > threshold,
    "<=": lambda value, threshold: value <= threshold,
    "<": lambda value, threshold: value < threshold,
}

VERDICTS = ("met", "not met", "undecided", "not measured")

COVERAGE = 1.96
"""Multiples of a figure's standard deviation within which a threshold leaves it undecided."""

CRITERIA = ("criterion", "quantity", "relation", "threshold")

RESULTS = ("system", "quantity", "value")


def check_criteria(criteria):
    """Return criteria as a DataFrame, checked and with every column.

    Parameters
    ----------
    criteria : DataFrame
        A row per criterion: ``criterion`` (name), ``quantity``, ``relation`` (>=, >, <=, <),
        ``threshold`` (a number, or a mark a, b, c); optionally ``distance_m``, ``view`` and
        ``direction``, where empty means all.

    Returns
    -------
    DataFrame

    Raises
    ------
    ValueError
        If a column is missing, a name repeats, a relation is another or a threshold is neither.

    Examples
    --------
    >>> rows = [("density", "density_per_m2", ">=", 3000)]
    >>> names = ["criterion", "quantity", "relation", "threshold"]
    >>> check_criteria(pd.DataFrame(rows, columns=names))["view"].tolist()
    ['']
    """
    criteria = _with_columns(criteria, CRITERIA, "criteria")
    if criteria["criterion"].duplicated().any():
        name = criteria.loc[criteria["criterion"].duplicated(), "criterion"].iloc[0]
        raise ValueError(f"Invalid criteria: {name!r} twice. Must be distinct.")
    for row in criteria.itertuples():
        check_choice(row.relation, f"relation of {row.criterion!r}", tuple(RELATIONS))
        if not np.isfinite(_rank(row.threshold, f"threshold of {row.criterion!r}")):
            raise ValueError(f"Invalid threshold of {row.criterion!r}: none. Must be given.")
    return criteria


def check_results(results):
    """Return results as a DataFrame, checked and with every column.

    Parameters
    ----------
    results : DataFrame
        A row per figure: ``system``, ``quantity``, ``value`` (a number, or a mark a, b, c; empty
        where not measured); optionally ``sigma`` (standard deviation), ``distance_m``, ``view``,
        ``direction``.

    Returns
    -------
    DataFrame

    Raises
    ------
    ValueError
        If a column is missing, or a value is neither number nor mark.

    Examples
    --------
    >>> rows = pd.DataFrame([("A", "f", 2.4)], columns=["system", "quantity", "value"])
    >>> check_results(rows)["sigma"].tolist()  # not known
    [nan]
    """
    results = _with_columns(results, RESULTS, "results")
    for row in results.itertuples():
        _rank(row.value, f"{row.quantity} of {row.system}")
    results["sigma"] = _numbers(results, "sigma")
    if (results["sigma"] < 0).any():
        worst = results["sigma"].min()
        raise ValueError(f"Invalid sigma {worst}. Must be 0 or more.")
    return results


def verdicts(criteria, results):
    """Hold every system's figures against every criterion.

    Parameters
    ----------
    criteria, results : DataFrame
        See :func:`check_criteria` and :func:`check_results`. A criterion with an empty distance,
        view or direction applies to every figure of that quantity that the results list.

    Returns
    -------
    DataFrame
        A row per system, criterion and figure: ``system``, ``criterion``, ``quantity``,
        ``distance_m``, ``view``, ``direction``, ``value``, ``sigma``, ``relation``, ``threshold``,
        ``margin`` (positive inside; in the quantity's unit, for marks in steps) and ``verdict``:
        *met*, *not met*, *undecided* (within 1.96 sigma of the threshold) or *not measured*.

    Raises
    ------
    ValueError
        As :func:`check_criteria` and :func:`check_results`.

    Examples
    --------
    >>> names = ["criterion", "quantity", "relation", "threshold"]
    >>> criteria = pd.DataFrame([("text", "legibility", "<=", "b")], columns=names)
    >>> results = pd.DataFrame(
    ...     [("B", "legibility", "a"), ("C", "legibility", "c")],
    ...     columns=["system", "quantity", "value"],
    ... )
    >>> verdicts(criteria, results)[["system", "margin", "verdict"]].values.tolist()
    [['B', 1.0, 'met'], ['C', -1.0, 'not met']]
    """
    criteria, results = check_criteria(criteria), check_results(results)
    rows = []
    for system in results["system"].drop_duplicates():
        figures = results[results["system"] == system]
        for criterion in criteria.itertuples():
            fitting = figures[_matches(figures, criterion)]
            if fitting.empty:
                rows.append(_row(system, criterion, None))
            rows += [_row(system, criterion, figure) for figure in fitting.itertuples()]
    return pd.DataFrame(rows)


def qualification(table):
    """Sum verdicts up per system.

    Parameters
    ----------
    table : DataFrame
        From :func:`verdicts`.

    Returns
    -------
    DataFrame
        ``system``, ``verdict`` (*qualifies* when all figures meet their criteria; *fails* when one
        does not; else *open*), the numbers of figures ``met``, ``not_met``, ``undecided``,
        ``not_measured``, and ``because``: the criteria that are not met, or leave it open.

    Examples
    --------
    >>> from mmqa_lab.published import pfeifer2021_images as published
    >>> table = qualification(verdicts(published.tender_criteria(2), published.results()))
    >>> int((table["verdict"] == "qualifies").sum())
    2
    """
    rows = []
    for system, part in table.groupby("system", sort=False):
        counts = part["verdict"].value_counts().reindex(VERDICTS, fill_value=0)
        if counts["not met"]:
            verdict, deciding = "fails", part["verdict"] == "not met"
        elif counts["met"] == len(part):
            verdict, deciding = "qualifies", np.zeros(len(part), dtype=bool)
        else:
            verdict, deciding = "open", part["verdict"] != "met"
        because = ", ".join(part.loc[deciding, "criterion"].drop_duplicates())
        rows.append((system, verdict, *counts, because))
    names = [verdict.replace(" ", "_") for verdict in VERDICTS]
    return pd.DataFrame(rows, columns=["system", "verdict", *names, "because"])


def _with_columns(frame, needed, what):
    """A copy with the optional columns, all missing words empty."""
    missing = [name for name in needed if name not in frame.columns]
    if missing:
        raise ValueError(f"Invalid {what}: no column {missing[0]!r}. Must have one.")
    if frame.empty:
        raise ValueError(f"Invalid {what}: no rows. Must have one or more.")
    frame = frame.copy()
    for name in ("view", "direction"):
        words = frame[name] if name in frame else pd.Series("", index=frame.index)
        frame[name] = words.fillna("").astype(str)
    frame["distance_m"] = _numbers(frame, "distance_m")
    return frame


def _numbers(frame, name):
    """A column of numbers, NaN where it is empty or there is none."""
    values = frame[name] if name in frame else pd.Series(np.nan, frame.index)
    numbers = pd.to_numeric(values, errors="coerce")
    wrong = numbers.isna() & values.notna() & (values.astype(str).str.strip() != "")
    if wrong.any():
        raise ValueError(f"Invalid {name} {values[wrong].iloc[0]!r}. Must be a number.")
    return numbers


def _rank(value, name):
    """A figure as a number, marks as steps from a; NaN for none."""
    if value is None or (isinstance(value, str) and not value.strip()):
        return np.nan
    if isinstance(value, str) and value.strip() in MARKS:
        return float(MARKS.index(value.strip()))
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"Invalid {name} {value!r}. Must be a number or a mark a, b, c.") from None
    if np.isinf(number):
        raise ValueError(f"Invalid {name} {value!r}. Must be finite, or empty where not measured.")
    return number


def _matches(figures, criterion):
    """The figures that a criterion applies to."""
    fits = figures["quantity"] == criterion.quantity
    if np.isfinite(criterion.distance_m):
        fits &= figures["distance_m"] == criterion.distance_m
    for name in ("view", "direction"):
        if getattr(criterion, name):
            fits &= figures[name] == getattr(criterion, name)
    return fits


def _row(system, criterion, figure):
    """The verdict on one figure, or on a criterion without one."""
    same_kind, rank, sigma = True, np.nan, np.nan
    limit = _rank(criterion.threshold, "threshold")
    if figure is not None:
        rank, sigma = _rank(figure.value, criterion.quantity), figure.sigma
        is_mark = isinstance(figure.value, str) and figure.value.strip() in MARKS
        same_kind = not np.isfinite(rank) or is_mark == (str(criterion.threshold) in MARKS)
    if not same_kind:
        raise ValueError(
            f"Invalid {criterion.quantity} {figure.value!r} of {system}. Must be of the kind of "
            f"the threshold {criterion.threshold!r}."
        )
    margin = (rank - limit) * (1 if criterion.relation.startswith(">") else -1)
    if not np.isfinite(rank):
        verdict = "not measured"
    elif np.isfinite(sigma) and sigma > 0 and abs(margin) <= COVERAGE * sigma:
        verdict = "undecided"
    else:
        verdict = "met" if RELATIONS[criterion.relation](rank, limit) else "not met"
    place = criterion if figure is None else figure
    return {
        "system": system,
        "criterion": criterion.criterion,
        "quantity": criterion.quantity,
        "distance_m": place.distance_m,
        "view": place.view,
        "direction": place.direction,
        "value": None if figure is None else figure.value,
        "sigma": sigma,
        "relation": criterion.relation,
        "threshold": criterion.threshold,
        "margin": margin,
        "verdict": verdict,
    }
