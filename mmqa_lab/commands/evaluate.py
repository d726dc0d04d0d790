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
    CLOUDS,
    FIGURE,
    OUTPUT,
    SELECTION,
    option,
    print_rows,
    switch,
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


def axes(text):
    """The axes' name, or a number of degrees."""
    if text in ("principal", "horizontal"):
        return text
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid axes {text!r}. Must be principal, horizontal or degrees."
        ) from None


def sectors(text):
    """A number of sectors, or nearest points."""
    return int(text) if text.isdigit() else text


ARGUMENTS = (
    CLOUDS,
    *SELECTION,
    option(
        "--axes",
        "AXES",
        "of the quadrants: principal (default), horizontal, or degrees from principal",
        axes,
        "principal",
    ),
    option("--radius", "M", "farther neighbours do not count", float, 0.5),
    option("--rho0", "DENSITY", "points/m2 asked for: says where f does not matter", float),
    switch("--intervals", "a row for each figure, and for g, with its 95 %% interval"),
    option("--sectors", "N", "instead of quadrants: 6, 8, ..., or 'nearest 8' points", sectors, 4),
    option("--statistic", "PERCENT", "percentile of the distances that d1..d4 are", float, 50.0),
    switch("--distinct", "keep one point of those that share a place"),
    switch("--paper-scale", "sigma_MAD with 1.4862"),
    FIGURE,
    *OUTPUT,
)


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
        quality = evaluate_cloud(cloud, scale=scale, **choices)
        table = quality.intervals() if options.intervals else quality.to_frame()
        table.insert(0, "file", str(file))
        rows.append(table.assign(remarks=" ".join(quality.remarks)))
    if options.out is not None:
        from mmqa_lab import plots

        with plots.style():
            write_figure(options.out, quality.plot(), title=f"Quality of {options.cloud[-1]}")
    table = pd.concat(rows).drop(columns=LEFT_OUT, errors="ignore")
    print_rows(table, options, upright=None if options.intervals else "file")
