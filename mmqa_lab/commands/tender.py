"""Verdicts on any results."""

import json
from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option, switch
from mmqa_lab.commands._output import print_rows

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
tables = Lazy("mmqa_lab.io")
tender = Lazy("mmqa_lab.tender")


SETS = {
    "pfeifer2021:test": "test",
    "pfeifer2021:1": "scenario 1",
    "pfeifer2021:2": "scenario 2",
    "pfeifer2021:g": "test with g",
}


@command(
    "verdict per system and criterion, with margin and uncertainty",
    option("criteria", "CRITERIA", "CSV or JSON file"),
    option("results", "RESULTS", "CSV or JSON file"),
    switch("--details", "a row per figure instead of one per system"),
    option("--rho0", "POINTS", "density that is asked for, points per m2: exempts f", float),
    *OUTPUT,
    examples=(
        "criteria.csv results.csv",
        "pfeifer2021:2 pfeifer2021 --details",
    ),
)
def tender_(options):
    """Compare systems' results with the criteria of a tender.

    CRITERIA has a row per criterion: criterion, quantity, relation (>=, >, <=, <), threshold, and
    optionally distance_m, view, direction; empty means all. RESULTS has a row per figure: system,
    quantity, value, and optionally sigma or low and high, distance_m, view, direction; an empty
    value is not measured. Both are CSV, or JSON lists of objects. Values are numbers or the marks
    a, b, c. A figure is undecided where its threshold lies within low and high, or within 1.96
    sigma. With --rho0, f does not matter where d1_mm and d4_mm of the same place are small enough
    for that density. Exit status 1 when no system qualifies.

    CRITERIA may be pfeifer2021:test, pfeifer2021:1 or pfeifer2021:2, the test and the two scenarios
    of Pfeifer et al. 2021 (doi 10.3390/rs13020237), or pfeifer2021:g, the test with g in place of
    f. RESULTS may be pfeifer2021, their Tables 1 and 2; pfeifer2021:pixels judges text of 60 mm by
    its pixels; pfeifer2021:repeated adds the repeatability that they print.
    """
    criteria = _criteria(options.criteria)
    if options.rho0 is not None:
        criteria = criteria.assign(rho0_per_m2=options.rho0)
    choices = {
        "pfeifer2021": {},
        "pfeifer2021:pixels": {"by_pixels": True},
        "pfeifer2021:repeated": {"by_pixels": True, "repeatability": True},
    }
    if options.results in choices:
        results = tender.published_results(**choices[options.results])
    else:
        results = read_table(options.results, "results")
    table = tender.verdicts(criteria, results)
    summary = tender.qualification(table)
    print_rows(table if options.details else summary, options)
    return 0 if (summary["verdict"] == "qualifies").any() else 1


def read_table(file, what):
    """A table from CSV or JSON."""
    path = Path(file)
    if path.suffix.lower() != ".json" or not path.is_file():
        return tables.read_table(path, what)
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise ValueError("no list of objects")
    except ValueError as error:
        raise ValueError(f"Invalid {what} {path}: {error}. Must be CSV or JSON.") from None
    return pd.DataFrame(rows)


def _criteria(name):
    """The criteria of a name, or of a file."""
    return tender.published_criteria(SETS[name]) if name in SETS else read_table(name, "criteria")
