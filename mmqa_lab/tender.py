"""A tender's verdicts: measured figures against criteria, with margin and uncertainty.

:func:`verdict` is the rule for one figure, :func:`verdicts` compares any figures with any
criteria, :func:`qualification` sums up per system. Of marks a is better than b, and b than c.
:func:`published_criteria` and :func:`published_results` are those of Pfeifer et al. 2021
(doi:10.3390/rs13020237), sections 4.2 and 4.4, Tables 1 and 2.
"""

import operator
import re

import numpy as np
import pandas as pd

from mmqa_lab import published
from mmqa_lab._checks import check_choice, check_columns, check_known, check_number, refuse
from mmqa_lab.chart_image.rules import MARKS, expected_marks
from mmqa_lab.published.ledger import COARSEST_MM
from mmqa_lab.spacing import exempt

__all__ = [
    "QUANTITIES", "published_criteria", "published_results", "qualification", "verdict", "verdicts",
]  # fmt: skip
__dir__ = __all__.copy

RELATIONS = {">=": operator.ge, ">": operator.gt, "<=": operator.le, "<": operator.lt}

VERDICTS = ("met", "exempt", "not met", "undecided", "not certain", "not measured")

SPACINGS_MM = (0.5, 1e5)
"""What spacings can be; a value below it is one in metres."""

QUANTITIES = {
    "density_per_m2": (0.05, 1e7, "density"),
    "sigma_mad_mm": (0.05, 1e4, "sigma_MAD|noise"),
    "std_mm": (0.05, 1e4, "std|noise"),
    **{f"d{k}_mm": (*SPACINGS_MM, f"d{k}") for k in (1, 2, 3, 4)},
    "e95_mm": (*SPACINGS_MM, "e95"),
    "f": (0.1, 1e3, "f|d1|d4"),
    "g": (0.1, 1e3, "g"),
    "pixel_mm": (0.05, 1e4, "pixel_h|pixel_v|pixel size"),
    "w_mm": (0.05, 1e4, "w_h|w_v|width"),
    **{f"legibility{size}": (0, 2, "legibility") for size in ("", "_40mm", "_60mm")},
}
"""Quantities: the least and the largest value above zero that can be, and the words by which a
remark names the figure."""

IMAGE_NAMES = {"pixel size": "pixel_mm", "line-pair width": "w_mm"}

NO_WIDTH = 1e-4
"""An interval narrower than this share of the figure states no uncertainty."""

COVERAGE = 1.96
"""Multiples of a figure's standard deviation within which a threshold leaves it undecided."""

CRITERIA = ("criterion", "quantity", "relation", "threshold")

RESULTS = ("system", "quantity", "value")

PLACE = ["distance_m", "view", "direction"]

OPTIONAL = (*PLACE, "sigma", "low", "high", "remarks", "rho0_per_m2")
"""Columns that criteria or results may have."""

NOTES = ("set", "unit", "n", "source", "note")
"""Columns that say more and decide nothing."""

WORDS = {"view": ("orthogonal", "forward", "backward"), "direction": ("h", "v")}
"""Views of a chart; directions in which lengths in the image are measured."""

SETS = ("test", "scenario 1", "scenario 2")
"""Sets of criteria that Pfeifer et al. 2021 print: the test (section 4.2), two examples (4.4)."""

OWN_SET = "test with g"
"""The test with g in place of f, which the paper does not print."""

RUNGS_MM = (40.0, 30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 4.0)
"""Widths of line pairs that Table 1 shows."""

RANGE_OF_FIVE = 2.326
"""Mean range of five normal values in standard deviations: five selections were compared."""

REPEATED = ("selection_density", "selection_precision", "bar_std")
"""Printed numbers (section 4.4) that say how repeatable a figure is."""


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
    bare = np.isfinite([low, high]).all() and high - low <= NO_WIDTH * abs(value)
    low, high = (value if np.isnan(end) else end for end in (low, high))
    if np.isnan([low, high]).any():
        return "not measured"
    if bare or _doubted(quantity, remarks):
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
        figure of that quantity, and for f ``rho0_per_m2``, the density from which its exemption
        follows (:func:`mmqa_lab.spacing.exempt`). Empty rows do not count.
    results : DataFrame
        A row per figure: ``system``, ``quantity``, ``value`` (a number, or a mark a, b, c; empty
        where not measured); optionally ``sigma`` (standard deviation) or ``low`` and ``high`` (95 %
        interval, or a bound of what could not be measured), ``distance_m``, ``view``,
        ``direction``, ``remarks`` (doubts about the figure, as ``evaluate`` prints them).

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
    criteria, results = _criteria(criteria), _results(results)
    own = set(criteria["quantity"]) & set(results["quantity"])
    for table in (criteria, results):
        for quantity in table["quantity"].unique():
            check_known(quantity, "quantity", (*QUANTITIES, *sorted(own - set(QUANTITIES))))
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

    >>> table = verdicts(published_criteria("scenario 2"), published_results())
    >>> qualification(table)[["system", "verdict", "because"]].values.tolist()
    [['A', 'open', 'legibility'], ['B', 'qualifies', ''], ['C', 'fails', 'precision']]
    >>> qualification(table)["sentence"].iloc[0]
    'A stays open: legibility is not measured.'
    """
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


def published_criteria(name: str, *, cloud_distance_m: float = 5.0) -> pd.DataFrame:
    """Return a set of criteria as Pfeifer et al. 2021 print it.

    Parameters
    ----------
    name : {"test", "scenario 1", "scenario 2", "test with g"}
        The test of section 4.2, an example of section 4.4, or the test with g < 2 in place of
        f < 2, which the paper does not print.
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
    with_g = check_choice(name, "criteria", (*SETS, OWN_SET)) == OWN_SET
    name = "test" if with_g else name
    table = published.table("pfeifer2021", "criteria").query("set == @name").reset_index(drop=True)
    names = IMAGE_NAMES | {"density": "density_per_m2", "sigma_mad": "sigma_mad_mm"}
    text = table["quantity"] == "legibility"
    height = table["text_height_mm"].map("legibility_{:.0f}mm".format)
    table["quantity"] = height.where(text, table["quantity"].replace(names))
    table["threshold"] = table["threshold"].astype(object).where(~text, table["printed"])
    cloud = table["quantity"].isin(["density_per_m2", "sigma_mad_mm", "f"])
    unknown = cloud & table["distance_m"].isna()
    table["distance_m"] = table["distance_m"].mask(unknown, cloud_distance_m)
    table["view"] = np.where(text & table["views"].str.startswith("orthogonal"), "orthogonal", "")
    rho0 = float(table.loc[table["quantity"] == "density_per_m2", "threshold"].iloc[0])
    table["rho0_per_m2"] = np.where(table["quantity"] == "f", rho0, np.nan)
    if with_g:
        table = table.replace({"quantity": {"f": "g"}})
    return table[[*CRITERIA, "distance_m", "view", "rho0_per_m2"]]


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
        allow: the worst one, and the interval to the best one
        (:func:`mmqa_lab.chart_image.rules.expected_marks`).

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
    images = published.table("pfeifer2021", "table_1").query("status != 'not_evaluated'")
    rows = [_image_row(row) for row in images.to_dict("records")]
    rows += _larger_text(images, by_pixels)
    for cloud in published.table("pfeifer2021", "table_2").to_dict("records"):
        place = {"system": cloud["system"], "distance_m": float(cloud["distance_m"])}
        names = ("density_per_m2", "sigma_mad_mm", "d1_mm", "d4_mm", "f")
        rows += [{**place, "quantity": name, "value": float(cloud[name])} for name in names]
    table = pd.DataFrame(rows)
    table[["view", "direction"]] = table[["view", "direction"]].fillna("")
    table["sigma"] = np.nan
    if repeatability:
        of = {name: published.number("pfeifer2021", name)["value"] for name in REPEATED}
        table = table.apply(_repeated, axis=1, of=of)
    return table


def _criteria(criteria):
    """Criteria checked and with every column."""
    criteria = _whole(criteria, CRITERIA, ("distance_m", "rho0_per_m2"), "criteria")
    for twice in criteria.loc[criteria["criterion"].duplicated(), "criterion"]:
        refuse(True, "criteria", f"{twice!r} twice", "distinct")
    for row in criteria.itertuples():
        check_choice(row.relation, f"relation of {row.criterion!r}", tuple(RELATIONS))
        name = f"threshold of {row.criterion!r}"
        refuse(np.isnan(_rank(row.threshold, name)), name, "none", "given")
        _check_unit(row.threshold, row.quantity, name)
        _check_unit(row.rho0_per_m2, "density_per_m2", "rho0_per_m2")
    return criteria


def _results(results):
    """Results checked and with every column."""
    results = results.rename(columns={"remark": "remarks"})
    results = _whole(results, RESULTS, ("distance_m", "sigma", "low", "high"), "results")
    for sigma in results["sigma"].dropna():
        check_number(sigma, "sigma", low=0)
    spelt = results["system"].drop_duplicates()
    for system in spelt[spelt.str.casefold().duplicated()]:
        refuse(True, "system", repr(system), "spelt alike in all its rows")
    for row in results.itertuples():
        name = f"{row.quantity} of {row.system}"
        rank = _rank(row.value, name)
        beyond = rank < row.low or rank > row.high or row.low > row.high
        ends = f"low {row.low:g}, high {row.high:g}"
        refuse(beyond, f"{name} {row.value!r}", ends, "between them")
        _check_unit(row.value, row.quantity, name)
    return results


def _whole(frame, needed, numbers, what):
    """A copy without empty rows and with every column: words empty, numbers NaN where not given."""
    check_columns(frame, needed, what)
    for name in frame.columns[~frame.columns.isin([*needed, *OPTIONAL, *NOTES])]:
        check_known(name, f"column of {what}", (*needed, *OPTIONAL, *NOTES))
    frame = frame.reset_index(drop=True).replace(r"^\s*$", np.nan, regex=True).dropna(how="all")
    refuse(frame.empty, what, "no rows", "one or more")
    missing = [name for name in (*WORDS, "remarks", *numbers) if name not in frame]
    frame = frame.assign(**dict.fromkeys(missing, np.nan))
    for name in [*needed[:2], *WORDS, "remarks"]:
        empty = frame[name].isna()
        lacks = name in needed and empty.any()
        refuse(lacks, what, f"no {name} in row {empty.idxmax() + 1}", "one")
        frame[name] = frame[name].astype(object).where(~empty, "").astype(str).str.strip()
    for name, known in WORDS.items():
        for word in frame[name].unique():
            check_known(word, name, ("", *known))
    for name in numbers:
        given = frame[name].astype(object).map(_step_of_mark)
        frame[name] = pd.to_numeric(given, errors="coerce")
        bad = frame[name].isna() & given.notna()
        where = f"{given[bad.idxmax()]!r} in row {bad.idxmax() + 1}"
        refuse(bad.any(), f"{name} in {what}", where, "a number")
    return frame


def _step_of_mark(value):
    """Steps of a mark from a; anything else as it is."""
    return float(MARKS.index(value.strip())) if _is_mark(value) else value


def _is_mark(value):
    return isinstance(value, str) and value.strip() in MARKS


def _check_unit(value, quantity, name):
    """Raise where a known quantity cannot have this value, as one in another unit."""
    value = _rank(value, name)
    low, high, _ = QUANTITIES.get(quantity, (-np.inf, np.inf, ""))
    if value != 0 and not np.isnan(value):
        check_number(value, name, low=low, high=high, unit=f"in the unit of {quantity}")


def _doubted(quantity, remarks):
    """Whether a remark names the figure."""
    words = QUANTITIES.get(quantity, (0, 0, re.escape(quantity) or r"\b\B"))[2]
    return re.search(rf"\b({words})\b", remarks) is not None


def _rank(value, name):
    """A figure as a number, marks as steps from a; NaN for none."""
    if value is None or value == "":
        return np.nan
    try:
        number = float(_step_of_mark(value))
    except (TypeError, ValueError):
        raise ValueError(f"Invalid {name} {value!r}. Must be a number or a mark a, b, c.") from None
    if np.isinf(number):
        raise ValueError(f"Invalid {name} {value!r}. Must be finite, or empty where not measured.")
    return number


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
    ends = np.array([_interval(row, _rank(row["value"], "spacing")) for row in rows]) / 1000
    maybe, surely = exempt(*ends, criterion.rho0_per_m2).tolist()
    return maybe, surely and not any(_doubted(row["quantity"], row["remarks"]) for row in rows)


def _row(system, criterion, figure):
    """The verdict on one figure, or on a criterion without one."""
    limit, relation = _rank(criterion.threshold, "threshold"), criterion.relation
    marks = _is_mark(criterion.threshold)
    if marks:  # better marks are fewer steps from a
        relation = relation.replace(">", "<")
    place = criterion if figure is None else figure
    rank, low, high = (np.nan,) * 3 if figure is None else _ends(criterion, figure, marks)
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


def _ends(criterion, figure, marks):
    """A figure as a number, and the ends of its interval; NaN where it was not measured."""
    rank = _rank(figure.value, criterion.quantity)
    other = np.isfinite(rank) and marks != _is_mark(figure.value)
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


def _image_row(row):
    """A cell of Table 1 as a result."""
    names = {"legibility": "legibility_40mm"} | IMAGE_NAMES
    result = {name: row[name] for name in ("system", "distance_m", "view", "direction")}
    result["quantity"] = names[row["quantity"]]
    result["value"] = row["printed"] if row["quantity"] == "legibility" else row["value"]
    if row["status"] == "not_resolved" and row["quantity"] == "line-pair width":
        coarsest = COARSEST_MM[row["direction"]]
        result |= {"low": np.nextafter(coarsest, np.inf), "high": np.inf}
    return result


def _larger_text(images, by_pixels):
    """Results for text of 60 mm in the orthogonal view at 5 m."""
    place = {"distance_m": 5.0, "view": "orthogonal", "quantity": "legibility_60mm"}
    keys = ["system", "distance_m", "view"]
    marks = images.query("quantity == 'legibility'").set_index(keys)["printed"]
    pixels = images.query("quantity == 'pixel size' and direction == 'v'").set_index(keys)["value"]
    rows = []
    for system in "ABC":
        key = (system, 5.0, "orthogonal")
        row = {**place, "system": system, "value": marks[key]}
        if marks[key] == "c":
            found = expected_marks(60 / pixels[key]).iloc[0]
            ends = {"low": MARKS.index(found["best"]), "high": MARKS.index(found["worst"])}
            row |= {"value": found["worst"], **ends} if by_pixels else {"value": None}
        rows.append(row)
    return rows


def _repeated(row, of):
    """A result with the repeatability that section 4.4 prints."""
    row = row.copy()
    if row["quantity"] == "density_per_m2":
        row["sigma"] = of["selection_density"] / 100 * row["value"] / RANGE_OF_FIVE
    elif row["quantity"] == "sigma_mad_mm":
        row["sigma"] = of["selection_precision"] / RANGE_OF_FIVE
    elif row["quantity"] == "pixel_mm":  # of a bar of L: pixel / (L / pixel); v is a mean of two
        bar, count = (600, 1) if row["direction"] == "h" else (800, 2)
        row["sigma"] = of["bar_std"] * row["value"] ** 2 / bar / np.sqrt(count)
    elif row["quantity"] == "w_mm" and np.isfinite(row["value"]):
        rung = RUNGS_MM.index(row["value"])
        row["low"] = RUNGS_MM[min(rung + 1, len(RUNGS_MM) - 1)]
        row["high"] = RUNGS_MM[rung - 1] if rung else np.inf
    return row
