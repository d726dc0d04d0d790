"""Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and symbols
for the legibility and coded targets for its place; the point chart has random cells and two plain
squares (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling; greys and colours are
sRGB. Tiles are to be cut at their marks and mounted edge to edge. With an ending .json the layout
itself is written, for mmqa image --chart.
"""

from functools import partial

from mmqa_lab.commands._output import add_output_arguments, output_file, print_rows

SUMMARY = "write a test chart to print, as PDF or SVG"

EPILOG = """\
example:
  mmqa chart --out chart.pdf
  mmqa chart --out fine.svg --widths-h 30,24,20,16,12,10 --layout fine.json
  mmqa chart --points --seed 4 --out points.pdf
  mmqa chart --revised --tiles a3 --out tiles.pdf
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument(
        "--out", type=output_file, required=True, metavar="FILE", help=".pdf, .svg or .json"
    )
    parser.add_argument("--points", action="store_true", help="the point-distribution chart")
    parser.add_argument(
        "--revised",
        action="store_true",
        help="as the authors advise: pairs of 60 mm, too, and the lying bar black",
    )
    parser.add_argument("--bar", choices=("grey", "black"), help="tone of the lying bar: grey")
    for direction, words in (("h", "standing"), ("v", "lying")):
        parser.add_argument(
            f"--widths-{direction}",
            metavar="MM,MM,...",
            help=f"widths of the line pairs with {words} bars, from coarse to fine",
        )
    parser.add_argument("--no-texts", action="store_true", help="line pairs and bars alone")
    parser.add_argument("--no-targets", action="store_true", help="without coded targets")
    parser.add_argument(
        "--first-target",
        type=int,
        metavar="N",
        help="number of the lower left target, so that charts differ",
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="of the point chart's cells, default 0"
    )
    parser.add_argument(
        "--layout", type=output_file, metavar="FILE", help="also write the layout as JSON"
    )
    parser.add_argument(
        "--crop-marks", action="store_true", help="a larger page with marks to cut the chart at"
    )
    parser.add_argument("--tiles", choices=("a3", "a4"), help="a page for each part, with marks")
    add_output_arguments(parser)


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
