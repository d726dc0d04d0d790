"""Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and symbols
for the legibility and coded targets for its place; the point chart has random cells and two plain
squares (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling; greys and colours are
sRGB. Tiles are to be cut at their marks and mounted edge to edge. With an ending .json the layout
itself is written, for mmqa image --chart.
"""

from functools import partial

from mmqa_lab.commands._output import OUTPUT, option, output_file, print_rows, switch

SUMMARY = "write a test chart to print, as PDF or SVG"

EPILOG = """\
example:
  mmqa chart --out chart.pdf
  mmqa chart --out fine.svg --widths-h 30,24,20,16,12,10 --layout fine.json
  mmqa chart --points --seed 4 --out points.pdf
  mmqa chart --revised --tiles a3 --out tiles.pdf
"""


ARGUMENTS = (
    option("--out", "FILE", ".pdf, .svg or .json", output_file, required=True),
    switch("--points", "the point-distribution chart"),
    switch("--revised", "as the authors advise: pairs of 60 mm, too, and the lying bar black"),
    option("--bar", None, "tone of the lying bar: grey", choices=("grey", "black")),
    option("--widths-h", "MM,MM,...", "widths of line pairs with standing bars, coarse to fine"),
    option("--widths-v", "MM,MM,...", "widths of line pairs with lying bars, coarse to fine"),
    switch("--no-texts", "line pairs and bars alone"),
    switch("--no-targets", "without coded targets"),
    option("--first-target", "N", "number of the lower left target, so that charts differ", int),
    option("--seed", "N", "of the point chart's cells, default 0", int),
    option("--layout", "FILE", "also write the layout as JSON", output_file),
    switch("--crop-marks", "a larger page with marks to cut the chart at"),
    option("--tiles", None, "a page for each part, with marks", choices=("a3", "a4")),
    *OUTPUT,
)


def run(options):
    """Write the chart and, where asked for, its layout, and say what it is."""
    import pandas as pd

    from mmqa_lab import charts
    from mmqa_lab._checks import check_choice
    from mmqa_lab.io import write_atomically

    sheets = {"crop_marks": options.crop_marks, "tiles": options.tiles}
    writers = {
        ".pdf": partial(charts.Layout.to_pdf, **sheets),
        ".svg": charts.Layout.to_svg,
        ".json": lambda layout: layout.to_json().encode(),
    }
    ending = check_choice(options.out.suffix.lower(), "ending", tuple(writers))
    if options.layout is not None:
        check_choice(options.layout.suffix.lower(), "layout's ending", (".json",))
    if any(sheets.values()) and ending != ".pdf":
        raise ValueError(f"Invalid ending {ending} for crop marks or tiles. Must be .pdf.")
    layout = _layout(options)
    for file, write in ((options.out, writers[ending]), (options.layout, writers[".json"])):
        if file is not None:
            text = write(layout)
            write_atomically(file, lambda path, text=text: path.write_bytes(text))
    size = {"width_mm": layout.width, "height_mm": layout.height}
    row = {"file": str(options.out), "chart": layout.name, **size, "elements": len(layout.elements)}
    print_rows(pd.DataFrame([row]), options)


def _layout(options):
    """The layout that the options ask for."""
    from mmqa_lab import charts

    given = {
        "revised": options.revised or None,
        "horizontal_bar": options.bar,
        "widths_h": _numbers(options.widths_h, "widths_h"),
        "widths_v": _numbers(options.widths_v, "widths_v"),
        "first_marker": options.first_target,
        "texts": False if options.no_texts else None,
    }
    choices = {name: value for name, value in given.items() if value is not None}
    if options.points and (choices or options.no_targets):
        raise ValueError("Invalid options for a point chart. Must be --seed alone.")
    if options.points:
        return charts.point_chart(seed=options.seed or 0)
    if options.seed is not None:
        raise ValueError(f"Invalid seed {options.seed}. Must go with --points.")
    if options.no_targets:
        choices["dictionary"] = None
    return charts.imaging_chart(**choices)


def _numbers(text, name):
    """Numbers between commas, None for no text."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"Invalid {name} {text!r}. Must be numbers between commas.") from None
