"""Measured figures against the criteria of a tender: the rule, every verdict, and their sum."""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_columns, check_number, real_array, refuse
from mmqa_lab._results import NORMAL
from mmqa_lab.spacing import exempt
from mmqa_lab.tender.tables import (
    PLACE,
    RELATIONS,
    check_quantities,
    checked_criteria,
    checked_results,
    doubted,
    is_mark,
    rank_of,
)  # fmt: skip

__all__ = ["COVERAGE", "qualification", "verdict", "verdicts"]

VERDICTS = ("met", "exempt", "not met", "undecided", "not certain", "not measured")

NO_WIDTH = 1e-4
"""An interval narrower than this share of the figure states no uncertainty."""

COVERAGE = NORMAL
"""Multiples of a figure's standard deviation within which a threshold leaves it undecided."""


def verdict(
    value: float,
    relation: str,
    threshold: float,
    *,
    low: float = np.nan,
    high: float = np.nan,
    quantity: str = "",
    remarks: str = "",
) -> str:
    """Compare one figure with one threshold: the rule of all verdicts.

    Parameters
    ----------
    value, threshold : float
        NaN where the figure is not measured.
    relation : {">=", ">", "<=", "<"}
        Of the figure to the threshold.
    low, high : float
        95 % interval; without one the value alone decides.
    quantity, remarks : str
        Of the figure: a remark that names it, or what it is made of, says that it is not certain.

    Returns
    -------
    str
        *met* or *not met* where the whole interval is; *undecided* where the threshold lies within
        it; *not certain* where a remark doubts the figure or its interval has no width; *not
        measured*.

    Examples
    --------
    >>> verdict(8.6, "<=", 10, low=6.8, high=9.9), verdict(8.6, "<=", 10, low=6.8, high=10.9)
    ('met', 'undecided')
    >>> remark = "Coordinates are in steps of 10 mm: too coarse for sigma_MAD 8.6 mm."
    >>> verdict(8.6, "<=", 10, low=6.8, high=9.9, quantity="sigma_mad_mm", remarks=remark)
    'not certain'
    """
    holds = RELATIONS[check_choice(relation, "relation", tuple(RELATIONS))]
    check_number(threshold, "threshold")
    value, low, high = real_array([value, low, high], "figure").tolist()
    beyond = low > value or value > high or low > high
    refuse(beyond, f"figure {value:g}", f"low {low:g}, high {high:g}", "between them")
    bare = np.isfinite([low, high]).all() and high - low <= NO_WIDTH * abs(value)
    low, high = (value if np.isnan(end) else end for end in (low, high))
    if np.isnan([low, high]).any():
        return "not measured"
    if bare or doubted(quantity, remarks):
        return "not certain"
    met = holds(low, threshold), holds(high, threshold)
    return "met" if all(met) else "undecided" if any(met) else "not met"


def verdicts(criteria: pd.DataFrame, results: pd.DataFrame) -> pd.DataFrame:
    """Compare every system's figures with every criterion.

    Parameters
    ----------
    criteria : DataFrame
        A row per criterion: ``criterion`` (name), ``quantity`` (of ``QUANTITIES``, or your own in
        both tables), ``relation`` (>=, >, <=, <), ``threshold`` (a number, or a mark a, b, c: >= b
        and <= b both mean b or better, > b and < b better than b); optionally ``distance_m``,
        ``view`` (orthogonal, forward, backward) and ``direction`` (h, v), where empty means every
        figure of that quantity, ``unit`` (lengths in mm, cm or m, which are converted), and for f
        ``rho0_per_m2``, the density from which its exemption follows
        (:func:`mmqa_lab.spacing.exempt`). Empty rows do not count.
    results : DataFrame
        A row per figure: ``system``, ``quantity``, ``value`` (a number, or a mark a, b, c; empty
        where not measured); optionally ``sigma`` (standard deviation) or ``low`` and ``high`` (95 %
        interval, or a bound of what could not be measured), ``distance_m``, ``view``,
        ``direction``, ``unit``, ``remarks`` (doubts about the figure, as ``evaluate`` prints them).

    Returns
    -------
    DataFrame
        A row per system, criterion and figure: ``system``, ``criterion``, ``quantity``,
        ``distance_m``, ``view``, ``direction``, ``value``, ``low``, ``high``, ``relation``,
        ``threshold``, ``margin`` (positive inside; in the quantity's unit, for marks in steps) and
        ``verdict``: that of :func:`verdict` (sigma gives an interval of 1.96 of it), or *exempt* (f
        where d1 and d4, with their intervals, are small enough for the density asked for; where
        only a part of the intervals is, or a remark doubts them, *not met* is *undecided*).

    Raises
    ------
    ValueError
        If a column is missing or misspelled, a name repeats, a quantity, relation, view or
        direction is not known, a system is spelt in two ways, a value or threshold is neither a
        number nor a mark or cannot be in its unit, or a value lies outside of its own interval.

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
    criteria, results = checked_criteria(criteria), checked_results(results)
    check_quantities(criteria, results)
    rows = []
    for system in results["system"].drop_duplicates():
        figures = results[results["system"] == system]
        for criterion in criteria.itertuples():
            fitting = figures[_matches(figures, criterion)]
            if fitting.empty:
                rows.append(_row(system, criterion, None))
            for figure in fitting.itertuples():
                row = _row(system, criterion, figure)
                maybe, surely = _exemption(figures, criterion, figure)
                if surely and row["verdict"] != "not certain":
                    row["verdict"] = "exempt"
                elif maybe and row["verdict"] == "not met":
                    row["verdict"] = "undecided"
                rows.append(row)
    return pd.DataFrame(rows)


def qualification(table: pd.DataFrame) -> pd.DataFrame:
    """Sum up the verdicts of each system.

    Parameters
    ----------
    table : DataFrame
        From :func:`verdicts`.

    Returns
    -------
    DataFrame
        ``system``, ``verdict`` (*qualifies* when all figures meet their criteria or are exempt;
        *fails* when one does not; else *open*), the numbers of figures ``met``, ``exempt``,
        ``not_met``, ``undecided``, ``not_certain``, ``not_measured``, ``because``: the criteria
        that are not met, or leave it open, and ``sentence``: what follows and why.

    Examples
    --------
    Scenario 2 of the paper on its printed figures: A depends on a text that was not judged.

    >>> from mmqa_lab.tender import published_criteria, published_results
    >>> table = verdicts(published_criteria("scenario 2"), published_results())
    >>> qualification(table)[["system", "verdict", "because"]].values.tolist()
    [['A', 'open', 'legibility'], ['B', 'qualifies', ''], ['C', 'fails', 'precision']]
    >>> qualification(table)["sentence"].iloc[0]
    'A stays open: legibility is not measured.'
    """
    check_columns(table, ("system", "criterion", "verdict"), "table")
    rows = []
    for system, part in table.groupby("system", sort=False):
        counts = part["verdict"].value_counts().reindex(VERDICTS, fill_value=0)
        open_ones = ["undecided", "not certain", "not measured"]
        undecided = "open" if counts[open_ones].any() else "qualifies"
        verdict = "fails" if counts["not met"] else undecided
        deciding = part[part["verdict"].isin(["not met"] if verdict == "fails" else open_ones)]
        because = ", ".join(deciding["criterion"].drop_duplicates())
        sentence = _sentence(system, verdict, counts, deciding)
        rows.append((system, verdict, *counts, because, sentence))
    names = [verdict.replace(" ", "_") for verdict in VERDICTS]
    return pd.DataFrame(rows, columns=["system", "verdict", *names, "because", "sentence"])


def _sentence(system, verdict, counts, deciding):
    """The verdict on a system and its reasons, as a sentence."""
    if verdict == "qualifies":
        exempt = f", {counts['exempt']} of them by exemption" if counts["exempt"] else ""
        return f"{system} qualifies: all {counts.sum()} figures meet their criteria{exempt}."
    reasons = []
    for reason, part in deciding.groupby("verdict", sort=False):
        which = list(part["criterion"].drop_duplicates())
        reasons.append(f"{', '.join(which)} {'is' if len(which) == 1 else 'are'} {reason}")
    return f"{system} {'fails' if verdict == 'fails' else 'stays open'}: {'; '.join(reasons)}."


def _matches(figures, criterion):
    """The figures that a criterion applies to."""
    fits = figures["quantity"] == criterion.quantity
    for name in PLACE:
        wanted = getattr(criterion, name)
        fits &= (figures[name] == wanted) | (wanted == "") | pd.isna(wanted)
    return fits


def _exemption(figures, criterion, figure):
    """Whether d1 and d4 may, and whether they surely do, reach the density that exempts f."""
    if criterion.quantity != "f" or np.isnan(criterion.rho0_per_m2):
        return False, False
    here = pd.Series({name: getattr(figure, name) for name in PLACE})
    same = figures[PLACE].eq(here) | (figures[PLACE].isna() & here.isna())
    here = figures[same.all(axis=1)]
    spacings = [here[here["quantity"] == name] for name in ("d1_mm", "d4_mm")]
    if any(len(found) != 1 for found in spacings):
        return False, False
    rows = [found.iloc[0] for found in spacings]
    ends = np.array([_interval(row, rank_of(row["value"], "spacing")) for row in rows]) / 1000
    maybe, surely = exempt(*ends, criterion.rho0_per_m2).tolist()
    return maybe, surely and not any(doubted(row["quantity"], row["remarks"]) for row in rows)


def _row(system, criterion, figure):
    """The verdict on one figure, or on a criterion without one."""
    limit, relation = rank_of(criterion.threshold, "threshold"), criterion.relation
    marks = is_mark(criterion.threshold)
    if marks:  # better marks are fewer steps from a
        relation = relation.replace(">", "<")
    place = criterion if figure is None else figure
    rank, low, high = (np.nan,) * 3 if figure is None else _ranked(criterion, figure, marks)
    row = {"system": system, "criterion": criterion.criterion, "quantity": criterion.quantity}
    row |= {name: getattr(place, name) for name in PLACE}
    row |= {"value": None if figure is None else figure.value, "low": low, "high": high}
    row |= {"relation": criterion.relation, "threshold": criterion.threshold}
    sign = 1 if relation.startswith(">") else -1
    row["margin"] = sign * (rank - limit) + 0.0  # no negative zero
    known = {"quantity": criterion.quantity, "remarks": getattr(figure, "remarks", "")}
    if low != high or (not marks and np.isfinite([figure.low, figure.high]).all()):
        known |= {"low": low, "high": high}
    return row | {"verdict": verdict(rank, relation, limit, **known)}


def _ranked(criterion, figure, marks):
    """A figure as a number, and the ends of its interval; NaN where it was not measured."""
    rank = rank_of(figure.value, criterion.quantity)
    other = np.isfinite(rank) and marks != is_mark(figure.value)
    what, must = f"{criterion.quantity} of {figure.system}", f"threshold {criterion.threshold!r}"
    refuse(other, what, repr(figure.value), f"of the kind of the {must}")
    low, high = _interval(figure, rank)
    if np.isnan(rank) and not (np.isnan(low) and np.isnan(high)):  # a bound of one side
        low, high = np.nan_to_num(low, nan=-np.inf), np.nan_to_num(high, nan=np.inf, posinf=np.inf)
    return rank, low, high


def _interval(figure, rank):
    """The stated ends of a figure, or those that its standard deviation gives."""
    reach = COVERAGE * figure.sigma if figure.sigma > 0 else 0.0
    low = rank - reach if np.isnan(figure.low) else figure.low
    return low, rank + reach if np.isnan(figure.high) else figure.high
