"""Compare systems' results with the criteria of a tender.

CRITERIA has a row per criterion: criterion, quantity, relation (>=, >, <=, <), threshold, and
optionally distance_m, view, direction; empty means all. RESULTS has a row per figure: system,
quantity, value, and optionally sigma or low and high, distance_m, view, direction; an empty value
is not measured. Both are CSV, or JSON lists of objects. Values are numbers or the marks a, b, c. A
figure is undecided where its threshold lies within low and high, or within 1.96 sigma. With --rho0,
f does not matter where d1_mm and d4_mm of the same place are small enough for that density. Exit
status 1 when no system qualifies.

CRITERIA may be pfeifer2021:test, pfeifer2021:1 or pfeifer2021:2, the test and the two scenarios of
Pfeifer et al. 2021 (doi 10.3390/rs13020237), or pfeifer2021:g, the test with g in place of f.
RESULTS may be pfeifer2021, their Tables 1 and 2; pfeifer2021:pixels judges text of 60 mm by its
pixels; pfeifer2021:repeated adds the repeatability that they print.
"""

from pathlib import Path

from mmqa_lab.commands._output import OUTPUT, option, print_rows, switch

SUMMARY = "verdict per system and criterion, with margin and uncertainty"

EPILOG = """\
example:
  mmqa tender criteria.csv results.csv
  mmqa tender pfeifer2021:2 pfeifer2021 --details
"""


ARGUMENTS = (
    option("criteria", "CRITERIA", "CSV or JSON file"),
    option("results", "RESULTS", "CSV or JSON file"),
    switch("--details", "a row per figure instead of one per system"),
    option("--rho0", "POINTS", "density that is asked for, points per m2: exempts f", float),
    *OUTPUT,
)


def run(options):
    """Print the verdicts; return 1 when no system qualifies."""
    from mmqa_lab import tender

    sets = {"pfeifer2021:test": "test", "pfeifer2021:g": "test with g"}
    sets |= {f"pfeifer2021:{number}": f"scenario {number}" for number in (1, 2)}
    if options.criteria in sets:
        criteria = tender.published_criteria(sets[options.criteria])
    else:
        criteria = read_table(options.criteria, "criteria")
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
    import json

    import pandas as pd

    path = Path(file)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid {what} {path}: no such file. Must exist.")
    try:
        if path.suffix.lower() == ".json":
            rows = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                raise ValueError("no list of objects")
            return pd.DataFrame(rows)
        return pd.read_csv(path, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"Invalid {what} {path}: {error}. Must be CSV or JSON.") from None
