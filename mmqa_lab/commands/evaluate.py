"""Evaluate the points on one planar surface: density, sigma_MAD, d1..d4 and f.

One row per cloud. The plane is the orthogonal regression plane of the points; density is given for
the selection polygon and for the convex hull of the points; d1..d4 are the medians of the sorted
distances to the nearest point in each of four quadrants, f = d4/d1 (Pfeifer et al. 2021,
doi 10.3390/rs13020237); --sectors and --statistic choose others. With --rho0, f_exempt says that f
does not matter, as d1 and d4 are both at most sqrt(1 / rho0). Without --polygon the whole cloud is
taken for the surface.
"""

import argparse

from mmqa_lab.commands._output import (
    add_output_arguments,
    output_file,
    print_rows,
    with_progress,
    write_figure,
)

SUMMARY = "point density, planarity and point spacing of a surface in a cloud"

EPILOG = """\
example:
  mmqa evaluate data_samples/road_patch.laz --out patch.pdf
  mmqa evaluate chart.laz --polygon "0,0,0; 1,0,0; 1,0,1; 0,0,1" --json
  mmqa evaluate chart.laz --rho0 3000 --intervals
  mmqa evaluate chart.laz --sectors 8 --statistic 90
"""

LEFT_OUT = "linear_point_distance_mm"
"""It follows from the density."""

CHOICES = ("polygon", "thickness", "axes", "radius", "rho0", "sectors", "statistic", "distinct")
"""Options that are handed on under their names."""


NUMBERS = {
    "thickness": (0.1, "M", "take points this near to the polygon's plane, default %(default)s m"),
    "radius": (0.5, "M", "farther neighbours do not count, default %(default)s m"),
    "rho0": (None, "DENSITY", "asked for, points/m2: says where f does not matter"),
    "statistic": (50.0, "PERCENT", "percentile that d1..d4 are, default %(default)g, the median"),
}
"""Options that are numbers: default, unit and meaning."""

FLAGS = {
    "intervals": "a row for each figure, and for g, with its 95 %% interval",
    "distinct": "keep one point of those that share a place",
    "paper-scale": "sigma_MAD with 1.4862",
}


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument(
        "cloud", nargs="+", metavar="CLOUD", help="LAS, LAZ, COPC, PLY, PCD, E57 or text"
    )
    parser.add_argument(
        "--polygon",
        metavar="VERTICES",
        help="CSV or GeoJSON file of 3-D vertices, or 'x,y,z; x,y,z; ...' in metres",
    )
    parser.add_argument(
        "--axes",
        type=_axes,
        default="principal",
        metavar="AXES",
        help="of the quadrants: principal (default), horizontal, or degrees from principal",
    )
    parser.add_argument(
        "--sectors",
        type=lambda text: int(text) if text.isdigit() else text,
        default=4,
        metavar="N",
        help="sectors in place of the 4 quadrants: 6, 8, ..., or 'nearest 8': the 8 nearest points",
    )
    for name, (value, unit, meaning) in NUMBERS.items():
        parser.add_argument(f"--{name}", type=float, default=value, metavar=unit, help=meaning)
    for name, meaning in FLAGS.items():
        parser.add_argument(f"--{name}", action="store_true", help=meaning)
    parser.add_argument(
        "--out",
        "--figure",
        type=output_file,
        metavar="FILE",
        help="draw the last cloud: .pdf, .svg or .png",
    )
    add_output_arguments(parser)


def run(options):
    """Evaluate every cloud, then print, write and draw."""
    import pandas as pd

    from mmqa_lab._checks import check_choice
    from mmqa_lab.chart_cloud import evaluate_cloud
    from mmqa_lab.io import read_cloud
    from mmqa_lab.planes import CONSISTENT_SCALE, PAPER_SCALE

    if options.out is not None:
        check_choice(options.out.suffix.lower(), "figure", (".pdf", ".svg", ".png"))
    scale = PAPER_SCALE if options.paper_scale else CONSISTENT_SCALE
    choices = {name: getattr(options, name) for name in CHOICES}
    rows = []
    for file in with_progress(options.cloud, "cloud"):
        cloud = read_cloud(file, columns=())
        try:
            quality = evaluate_cloud(cloud, scale=scale, **choices)
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None
        table = quality.intervals() if options.intervals else quality.to_frame()
        table.insert(0, "file", str(file))
        rows.append(table.assign(remarks=" ".join(quality.remarks)))
    if options.out is not None:
        from mmqa_lab import plots

        with plots.style():
            write_figure(options.out, quality.plot(), title=f"Quality of {options.cloud[-1]}")
    table = pd.concat(rows).drop(columns=LEFT_OUT, errors="ignore")
    print_rows(table, options, upright=None if options.intervals else "file")


def _axes(text):
    """The axes' name, or a number of degrees."""
    if text in ("principal", "horizontal"):
        return text
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid axes {text!r}. Must be principal, horizontal or degrees."
        ) from None
