"""Verdicts on any results, and on drives past the test site."""

import json
import sys
from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, command, option, switch
from mmqa_lab.commands._output import print_rows, with_progress

pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
tables = Lazy("mmqa_lab.io.tables")
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


@command(
    "verdicts and one report on drives past the test site",
    option("folder", "FOLDER", "what was delivered", Path),
    option("--site", "FILE", "default FOLDER/site.json", Path),
    option("--criteria", "CRITERIA", "files or names, default all four sets", nargs="+"),
    option("--marks", "FILE", "default FOLDER/marks.csv", Path),
    option("--out", "FOLDER", "default FOLDER/report", Path),
    switch("--example", "make FOLDER by simulation first, then judge it"),
    option("--systems", "SYSTEMS", "of the example, default ABC", str, "ABC"),
    option("--seed", "SEED", "of the example", int, 1),
    *OUTPUT,
    examples=(
        "--example site/",
        "site/ --site site/site.json --out report/",
    ),
)
def accept(options):
    """Judge drives past the test site of Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 4.

    FOLDER has a folder for each system and in it one for each drive: trajectory.csv, clouds,
    images, images.csv and camera.json. images.csv has file; time_s, or easting_m, northing_m,
    height_m; heading_deg, pitch_deg, roll_deg; first_column and first_row where a file is a part of
    its image. camera.json has the width of a panorama, or width, height and focal_px. Without
    orientations the boards are found by their coded targets. The site's file has the boards with
    corners and charts, distances_m, speed_kmh, oblique_distance_m, crs, control_points and a note.

    CRITERIA are CSV or JSON files as for mmqa tender, or pfeifer2021:test, pfeifer2021:1,
    pfeifer2021:2 and pfeifer2021:g, the test with g in place of f; all four where left out. A file
    of marks has a column crop and one for each juror: the first run writes the crops, under names
    that tell nothing, and jury.csv to be filled in, a row for each element of the paper's check
    list in its order. A row with a photograph's crop alone marks all of it.

    A drive may have control.csv: point (its number in the site's file), easting_m, northing_m and
    height_m as seen in its data; the report has the differences.

    With --example the folder is made first: clouds, photographs and the jury's marks are simulated.

    The report has the verdicts with margin and interval, Tables 1 and 2 for this drive, the checks
    of the drives, what could not be judged and why, figures, files and hashes. Exit status 1 when
    no system qualifies under the first set of criteria.
    """
    from mmqa_lab.tender import acceptance, photographs, report
    from mmqa_lab.tender.site import read_site

    folder = options.folder
    if options.example:
        _make_example(options)
    elif not folder.is_dir():
        raise FileNotFoundError(f"Invalid folder {folder}: no such folder. Must exist.")
    site_file = options.site or folder / "site.json"
    site = read_site(site_file)
    names = options.criteria or list(SETS)
    criteria = {SETS.get(name, Path(name).stem): _criteria(name) for name in names}
    inputs = [Path(name) for name in names if name not in SETS]
    marks = options.marks or folder / "marks.csv"
    judged = options.marks is not None or marks.is_file()
    done = acceptance.accept(
        folder,
        site,
        criteria,
        marks=photographs.read_marks(marks) if judged else None,
        progress=lambda drives: with_progress(drives, "drive"),
    )
    out = options.out or folder / "report"
    inputs += [marks] if judged else []
    files = report.write_report(done, site, out, criteria=criteria, root=folder, inputs=inputs)
    for problem in done.problems:
        print(f"mmqa accept: {problem['where']}: {problem['what']}", file=sys.stderr)
    parts = [table.assign(criteria=name) for name, table in done.summaries.items()]
    table = pd.concat(parts, ignore_index=True)
    print_rows(table[["criteria", *table.columns.drop("criteria")]], options)
    if not options.json:
        print(f"report: {files[0]}, {files[1].name}")
    first = next(iter(done.summaries.values()))
    return 0 if (first["verdict"] == "qualifies").any() else 1


def _make_example(options):
    """The simulated delivery; a folder with files stays as it is."""
    from mmqa_lab.simulate.site import VEHICLES, write_site

    for system in options.systems:
        checks.check_choice(system, "system", tuple(VEHICLES))
    if options.folder.exists() and any(options.folder.iterdir()):
        raise ValueError(f"Invalid folder {options.folder}: not empty. Must be new or empty.")
    write_site(options.folder, systems=options.systems, seed=options.seed)


def _criteria(name):
    """The criteria of a name, or of a file."""
    return tender.published_criteria(SETS[name]) if name in SETS else read_table(name, "criteria")
