"""Judge drives past the test site of Pfeifer et al. 2021 (doi 10.3390/rs13020237), section 4.

FOLDER has a folder for each system and in it one for each drive: trajectory.csv, clouds, images,
images.csv and camera.json. images.csv has file; time_s, or easting_m, northing_m, height_m;
heading_deg, pitch_deg, roll_deg; first_column and first_row where a file is a part of its image.
camera.json has the width of a panorama, or width, height and focal_px. Without orientations the
boards are found by their coded targets. The site's file has the boards with corners and charts,
distances_m, speed_kmh, oblique_distance_m, crs and control_points.

CRITERIA are CSV or JSON files as for mmqa tender, or pfeifer2021:test, pfeifer2021:1, pfeifer2021:2
and pfeifer2021:g, the test with g in place of f; all four where left out. A file of marks has a
column crop and one for each juror: the first run writes the crops, under names that tell nothing,
and jury.csv to be filled in, a row for each element of the paper's check list in its order. A row
with a photograph's crop alone marks all of it.

A drive may have control.csv: point (its number in the site's file), easting_m, northing_m and
height_m as seen in its data; the report has the differences.

With --example the folder is made first: clouds, photographs and the jury's marks are simulated.

The report has the verdicts with margin and interval, Tables 1 and 2 for this drive, the checks of
the drives, what could not be judged and why, figures, files and hashes. Exit status 1 when no
system qualifies under the first set of criteria.
"""

from pathlib import Path

from mmqa_lab.commands._output import OUTPUT, option, print_rows, switch, with_progress

SUMMARY = "verdicts and one report on drives past the test site"

EPILOG = """\
example:
  mmqa accept --example site/
  mmqa accept site/ --site site/site.json --out report/
"""

SETS = {
    "pfeifer2021:test": "test",
    "pfeifer2021:1": "scenario 1",
    "pfeifer2021:2": "scenario 2",
    "pfeifer2021:g": "test with g",
}


ARGUMENTS = (
    option("folder", "FOLDER", "what was delivered", Path),
    option("--site", "FILE", "default FOLDER/site.json", Path),
    option("--criteria", "CRITERIA", "files or names, default all four sets", nargs="+"),
    option("--marks", "FILE", "default FOLDER/marks.csv", Path),
    option("--out", "FOLDER", "default FOLDER/report", Path),
    switch("--example", "make FOLDER by simulation first, then judge it"),
    option("--systems", "SYSTEMS", "of the example, default ABC", str, "ABC"),
    option("--seed", "SEED", "of the example", int, 1),
    *OUTPUT,
)


def run(options):
    """Judge, write the report, and print who qualifies."""
    import sys

    import pandas as pd

    from mmqa_lab.tender import acceptance, photographs, report
    from mmqa_lab.tender.site import read_site

    folder = options.folder
    if options.example:
        _make_example(options)
    elif not folder.is_dir():
        raise FileNotFoundError(f"Invalid folder {folder}: no such folder. Must exist.")
    site_file = options.site or folder / "site.json"
    site = read_site(site_file)
    criteria, inputs = _criteria(options.criteria or list(SETS))
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
    from mmqa_lab._checks import check_choice
    from mmqa_lab.simulate.site import VEHICLES, write_site

    for system in options.systems:
        check_choice(system, "system", tuple(VEHICLES))
    if options.folder.exists() and any(options.folder.iterdir()):
        raise ValueError(f"Invalid folder {options.folder}: not empty. Must be new or empty.")
    write_site(options.folder, systems=options.systems, seed=options.seed)


def _criteria(names):
    """Sets of criteria by name, and the files that they come from."""
    from mmqa_lab.commands.tender import read_table
    from mmqa_lab.tender import published_criteria

    found, files = {}, []
    for name in names:
        if name in SETS:
            found[SETS[name]] = published_criteria(SETS[name])
            continue
        table = read_table(name, "criteria")
        files.append(Path(name))
        found[Path(name).stem] = table
    return found, files
