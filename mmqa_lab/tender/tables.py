"""The tables of a tender, criteria and results, as they may be written, and their checks."""

import operator
import re

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice, check_columns, check_known, check_number, refuse
from mmqa_lab.chart_image import MARKS
from mmqa_lab.io.numbers import parsed
from mmqa_lab.metrics import METRICS

__all__ = [
    "CRITERIA", "PLACE", "QUANTITIES", "RELATIONS", "check_quantities", "checked_criteria",
    "checked_results", "doubted", "is_mark", "rank_of",
]  # fmt: skip

RELATIONS = {">=": operator.ge, ">": operator.gt, "<=": operator.le, "<": operator.lt}

SPELT = {"≥": ">=", "≤": "<=", "=>": ">=", "=<": "<=", "≧": ">=", "≦": "<="}
"""Other spellings of relations."""

QUANTITY_UNITS = {
    "_mm": {"mm": 1.0, "cm": 10.0, "m": 1000.0},
    "_per_m2": dict.fromkeys(("1/m2", "1/m²", "points/m2", "/m2", "/m²", "m-2", "per m2"), 1.0),
    "": dict.fromkeys(("1", "-", "mark"), 1.0),
}
"""What quantities that end so may be given in, and its multiple of their own unit."""

SPACINGS_MM = (0.5, 1e5)
"""What spacings can be; a value below it is one in metres."""

SAME = {"density": "density_per_m2", "sigma_mad": "sigma_mad_mm", "e95": "e95_mm"}
SAME |= {f"d{k}": f"d{k}_mm" for k in (1, 2, 3, 4)}
"""Names of metrics, and the quantities that they are."""

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
remark names the figure. The metrics of :data:`mmqa_lab.metrics.METRICS` are among them."""

DOUBTS = {"noise_of_a_mean": "|sigma_MAD|density", "anps": "|density"}
DOUBTS |= dict.fromkeys(("e50", "e99", "e95_of_3", "fill_distance"), "|e95")
"""More words by which a remark names a metric."""

for name, one in METRICS.items():
    if name not in {*SAME, *QUANTITIES}:
        ends = (0.05, 1e5) if one.unit == "mm" and name != "ripley" else (-1e300, 1e300)
        QUANTITIES[name] = (*ends, name + DOUBTS.get(name, ""))

CRITERIA = ("criterion", "quantity", "relation", "threshold")

RESULTS = ("system", "quantity", "value")

PLACE = ["distance_m", "view", "direction"]

OPTIONAL = (*PLACE, "sigma", "low", "high", "remarks", "rho0_per_m2")
"""Columns that criteria or results may have."""

NOTES = ("set", "n", "source", "note", "better")
"""Columns that say more and decide nothing."""

WORDS = {"view": ("orthogonal", "forward", "backward"), "direction": ("h", "v")}
"""Views of a chart; directions in which lengths in the image are measured."""


def checked_criteria(criteria):
    """Return the criteria checked and with every column."""
    criteria = _whole(criteria, CRITERIA, ("distance_m", "rho0_per_m2"), "criteria")
    criteria["relation"] = criteria["relation"].map(lambda sign: SPELT.get(sign, sign))
    for twice in criteria.loc[criteria["criterion"].duplicated(), "criterion"]:
        refuse(True, "criteria", f"{twice!r} twice", "distinct")
    for row in criteria.itertuples():
        check_choice(row.relation, f"relation of {row.criterion!r}", tuple(RELATIONS))
        name = f"threshold of {row.criterion!r}"
        refuse(np.isnan(rank_of(row.threshold, name)), name, "none", "given")
        _check_unit(row.threshold, row.quantity, name)
        _check_unit(row.rho0_per_m2, "density_per_m2", "rho0_per_m2")
    return criteria


def check_quantities(criteria, results):
    """Raise where a quantity is neither known nor in both tables, by its table and row."""
    for table, other, name in ((criteria, results, "criteria"), (results, criteria, "results")):
        known = (*QUANTITIES, *sorted({*other["quantity"]} - {*QUANTITIES}))
        for row, quantity in table["quantity"].items():
            check_known(quantity, f"quantity in row {row + 1} of {name}", known)


def checked_results(results):
    """Return results checked and with every column."""
    spelt = {"remark": "remarks", "metric": "quantity", "cloud": "system"}
    results = results.rename(columns={a: b for a, b in spelt.items() if b not in results})
    results = _whole(results, RESULTS, ("distance_m", "sigma", "low", "high"), "results")
    for sigma in results["sigma"].dropna():
        check_number(sigma, "sigma", low=0)
    spelt = results["system"].drop_duplicates()
    for system in spelt[spelt.str.casefold().duplicated()]:
        refuse(True, "system", repr(system), "spelt alike in all its rows")
    for row in results.itertuples():
        name = f"{row.quantity} of {row.system}"
        rank = rank_of(row.value, name)
        beyond = rank < row.low or rank > row.high or row.low > row.high
        ends = f"low {row.low:g}, high {row.high:g}"
        refuse(beyond, f"{name} {row.value!r}", ends, "between them")
        _check_unit(row.value, row.quantity, name)
    return results


def _whole(frame, needed, numbers, what):
    """A copy without empty rows and with every column: words empty, numbers NaN where not given."""
    check_columns(frame, needed, what)
    columns = (*needed, *OPTIONAL, "unit", *NOTES)
    for name in frame.columns[~frame.columns.isin(columns)]:
        check_known(name, f"column of {what}", columns)
    frame = frame.reset_index(drop=True)
    frame = frame.map(lambda one: np.nan if not str(one).strip() else one).dropna(how="all")
    noted = frame[needed[0]].astype(str).str.match(r"\s*(#|//)")
    frame = frame[~(noted & frame[list(needed[1:])].isna().all(axis=1))].drop_duplicates()
    refuse(frame.empty, what, "no rows", "one or more")
    words = (*needed[:-1], *WORDS, "remarks", "unit")
    missing = [name for name in (*words, *numbers) if name not in frame]
    frame = frame.assign(**dict.fromkeys(missing, np.nan))
    for name in words:
        empty = frame[name].isna()
        lacks = name in needed and empty.any()
        refuse(lacks, what, f"no {name} in row {empty.idxmax() + 1}", "one")
        frame[name] = frame[name].astype(object).where(~empty, "").astype(str).str.strip()
    for name, known in WORDS.items():
        for word in frame[name].unique():
            check_known(word, name, ("", *known))
    for name in numbers:
        given = _read(frame[name].astype(object).map(_step_of_mark), f"{name} in {what}")
        frame[name] = pd.to_numeric(given, errors="coerce")
        bad = frame[name].isna() & given.notna()
        where = f"{given[bad.idxmax()]!r} in row {bad.idxmax() + 1}"
        refuse(bad.any(), f"{name} in {what}", where, "a number")
    figures = frame[needed[-1]].astype(object).map(_lowered)
    frame[needed[-1]] = _read(figures, f"{needed[-1]} in {what}")
    frame["quantity"] = frame["quantity"].replace(SAME)
    shares = figures.astype(str).str.contains("%") & frame["quantity"].isin([*QUANTITIES])
    row = shares.idxmax()
    where = f"{figures[row]!r} for {frame['quantity'][row]} in row {row + 1}"
    refuse(shares.any(), what, where, "in the unit of its quantity")
    return _in_own_units(frame, [*needed[-1:], *({*numbers} & {"sigma", "low", "high"})], what)


def _in_own_units(frame, figures, what):
    """Figures in the unit of their quantity; a unit that cannot be converted is refused."""
    for row, (quantity, unit) in frame.loc[frame["unit"] != "", ["quantity", "unit"]].iterrows():
        if quantity not in QUANTITIES:
            continue
        own = METRICS[quantity].unit if quantity in METRICS else ""
        full = f"{quantity}_{own}" if own else quantity
        units = next(units for ending, units in QUANTITY_UNITS.items() if full.endswith(ending))
        known = units | ({own.lower(): 1.0} if own else {})
        where = f"unit of {quantity} in row {row + 1} of {what}"
        factor = known[check_choice(unit.lower(), where, tuple(known))]
        if factor != 1:
            found = [factor * rank_of(value, where) for value in frame.loc[row, figures]]
            frame[figures] = frame[figures].astype(object)
            frame.loc[row, figures] = found
    return frame.astype(dict.fromkeys({*figures} & {"sigma", "low", "high"}, float))


def _read(values, name):
    """Numbers for texts that are numbers, as between marks; marks and numbers as they are."""
    texts = values[[isinstance(one, str) and not is_mark(one) for one in values]]
    numbers = parsed(pd.DataFrame({"number": texts}), name, separator=";")["number"]
    return values.where(~values.index.isin(texts.index), numbers.astype(object))


def _lowered(value):
    """A mark in small letters; anything else as it is."""
    return value.strip().lower() if is_mark(value) else value


def _step_of_mark(value):
    """Steps of a mark from a; anything else as it is."""
    return float(MARKS.index(_lowered(value))) if is_mark(value) else value


def is_mark(value):
    """Return whether a value is a mark a, b, c."""
    return isinstance(value, str) and value.strip().lower() in MARKS


def _check_unit(value, quantity, name):
    """Raise where a known quantity cannot have this value, as one in another unit."""
    value = rank_of(value, name)
    low, high, _ = QUANTITIES.get(quantity, (-np.inf, np.inf, ""))
    if value != 0 and not np.isnan(value):
        check_number(value, name, low=low, high=high, unit=f"in the unit of {quantity}")


def doubted(quantity, remarks):
    """Return whether a remark names the figure."""
    words = QUANTITIES.get(quantity, (0, 0, re.escape(quantity) or r"\b\B"))[2]
    return re.search(rf"\b({words})\b", remarks, re.IGNORECASE) is not None


def rank_of(value, name):
    """Return a figure as a number, marks as steps from a; NaN for none."""
    if value is None or value == "":
        return np.nan
    try:
        number = float(_step_of_mark(value))
    except (TypeError, ValueError):
        raise ValueError(f"Invalid {name} {value!r}. Must be a number or a mark a, b, c.") from None
    if np.isinf(number):
        raise ValueError(f"Invalid {name} {value!r}. Must be finite, or empty where not measured.")
    return number
