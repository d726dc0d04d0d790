"""Hold systems' results against the criteria of a tender.

CRITERIA has a row per criterion: criterion, quantity, relation (>=, >, <=, <), threshold, and
optionally distance_m, view, direction; empty means all. RESULTS has a row per figure: system,
quantity, value, and optionally sigma, distance_m, view, direction; an empty value is not measured.
Both are CSV, or JSON lists of objects. Values are numbers or the marks a, b, c. A figure within
1.96 sigma of its threshold is undecided. Exit status 1 when no system qualifies.

CRITERIA may be pfeifer2021:1 or pfeifer2021:2, RESULTS pfeifer2021: the published scenarios and
tables (doi 10.3390/rs13020237).
"""

import argparse
from pathlib import Path

from mmqa_lab.commands._output import add_output_arguments, print_rows

SUMMARY = "verdict per system and criterion, with margin and uncertainty"

EPILOG = """\
example:
  mmqa tender criteria.csv results.csv
  mmqa tender pfeifer2021:2 pfeifer2021 --details
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("criteria", metavar="CRITERIA", help="CSV or JSON file")
    parser.add_argument("results", metavar="RESULTS", help="CSV or JSON file")
    parser.add_argument(
        "--details",
        action=argparse.BooleanOptionalAction,
        default=False,
        help="a row per figure instead of one per system",
    )
    add_output_arguments(parser)


def run(options):
    """Print the verdicts; return 1 when no system qualifies."""
    from mmqa_lab import tender
    from mmqa_lab.published import pfeifer2021_images

    scenarios = {f"pfeifer2021:{number}": number for number in pfeifer2021_images.SCENARIOS}
    if options.criteria in scenarios:
        criteria = pfeifer2021_images.tender_criteria(scenarios[options.criteria])
    else:
        criteria = _read(options.criteria, "criteria")
    if options.results == "pfeifer2021":
        results = pfeifer2021_images.results()
    else:
        results = _read(options.results, "results")
    table = tender.verdicts(criteria, results)
    summary = tender.qualification(table)
    print_rows(table if options.details else summary, options)
    return 0 if (summary["verdict"] == "qualifies").any() else 1


def _read(file, what):
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
