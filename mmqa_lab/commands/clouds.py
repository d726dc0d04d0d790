"""What a cloud contains, and how good it is: of files, of selections, of whole campaigns."""

import argparse
import sys
from pathlib import Path

from mmqa_lab.commands import CLOUDS, FIGURE, OUTPUT, POLYGON, Lazy, choice, command, option, switch
from mmqa_lab.commands._output import print_rows, with_progress, write_figure

np = Lazy("numpy")
pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
chart_cloud = Lazy("mmqa_lab.chart_cloud")
io = Lazy("mmqa_lab.io")
maps = Lazy("mmqa_lab.maps")
map_campaigns = Lazy("mmqa_lab.maps.campaign")
planes = Lazy("mmqa_lab.planes")

HEADS = ("scanner_channel", "point_source_id", "user_data", "head", "scanner")
"""Columns that may number the heads of a system."""

MOST_HEADS = 16

MISSING = {
    "gps_time": "No time of the points: drives and scan lines cannot be told apart by it.",
    "scan_angle": "No scan angles.",
    "intensity": "No intensities.",
}
"""What is said of a column that is missing or the same for all points."""


@command(
    "what a cloud file contains, and what it cannot tell",
    CLOUDS,
    *OUTPUT,
    examples=(
        "data_samples/road_patch.laz",
        "drive/*.laz --csv files.csv",
    ),
)
def info(options):
    """Say what is in a cloud file: extent, coordinate system, density, time, heads, coincidences.

    One row per file. The density is the median number of points in the square metres that have
    points, counted in plan. The remarks say what the file cannot tell, and with it which commands
    cannot be used on it.
    """
    rows = [describe(file) for file in with_progress(options.cloud, "cloud")]
    print_rows(pd.DataFrame(rows), options, upright="file")


def describe(file):
    """Return what is in a file, a dict."""
    from mmqa_lab.cloud import sort_into_cells

    cloud = io.read_cloud(file)
    row = {"file": str(file), "points": len(cloud)}
    for axis, values in zip("xyz", cloud.points.T, strict=True):
        row |= {f"{axis}_low_m": values.min(), f"{axis}_high_m": values.max()}
    per_cell = np.diff(sort_into_cells(cloud.points[:, :2], 1.0).starts)
    telling = [name for name, values in cloud.columns.items() if len(np.unique(values)) > 1]
    time = np.sort(cloud["gps_time"]) if "gps_time" in telling else np.array([np.nan, np.nan])
    _, together = np.unique(cloud.points, axis=0, return_counts=True)
    return row | {
        "crs": "" if cloud.crs is None else cloud.crs.name,
        "resolution_mm": 1000 * cloud.resolution,
        "area_m2": len(per_cell),
        "density_per_m2": float(np.median(per_cell)),
        "coincident": int(together[together > 1].sum()),
        "time_first_s": time[0],
        "time_span_s": time[-1] - time[0],
        "time_longest_pause_s": np.diff(time).max(),
        "heads": _heads(cloud, telling),
        "columns": " ".join(telling),
        "remarks": " ".join(_remarks(cloud, telling)),
    }


def _heads(cloud, telling):
    """The column that may number the heads, and how many it numbers."""
    for name in HEADS:
        count = len(np.unique(cloud[name])) if name in telling else 1
        if 1 < count <= MOST_HEADS:
            return f"{count} by {name}"
    return ""


def _remarks(cloud, telling):
    """What the file cannot tell."""
    said = [text for name, text in MISSING.items() if name not in telling]
    if cloud.crs is None:
        said.append("No coordinate system: taken for metres.")
    elif any(axis.unit_conversion_factor != 1 for axis in cloud.crs.axis_info):
        said.append("Coordinates are not in metres: other commands refuse the file.")
    if not _heads(cloud, telling):
        said.append("No number of the head.")
    if np.isnan(cloud.resolution):
        said.append("The step of the coordinates is not stated.")
    if "gps_time" in telling and (np.diff(cloud["gps_time"]) < 0).any():
        said.append("Points are not in the order of time.")
    return said


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


@command(
    "point density, planarity and point spacing of a surface in a cloud",
    CLOUDS,
    *POLYGON,
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
    examples=(
        "data_samples/road_patch.laz --out patch.pdf",
        'chart.laz --polygon "0,0,0; 1,0,0; 1,0,1; 0,0,1" --json',
        "chart.laz --rho0 3000 --intervals",
        "chart.laz --sectors 8 --statistic 90",
    ),
)
def evaluate(options):
    """Evaluate the points on one planar surface: density, sigma_MAD, d1..d4 and f.

    One row per cloud. The plane is the orthogonal regression plane of the points; density is given
    for the selection polygon and for the convex hull of the points; d1..d4 are the medians of the
    sorted distances to the nearest point in each of four quadrants, f = d4/d1 (Pfeifer et al. 2021,
    doi 10.3390/rs13020237); --sectors and --statistic choose others. With --rho0, f_exempt says
    that f does not matter, as d1 and d4 are both at most sqrt(1 / rho0). Without --polygon the
    whole cloud is taken for the surface.
    """
    if options.out is not None:
        checks.check_choice(options.out.suffix.lower(), "figure", (".pdf", ".svg", ".png"))
    scale = planes.PAPER_SCALE if options.paper_scale else planes.CONSISTENT_SCALE
    choices = {name: getattr(options, name) for name in CHOICES}
    rows = []
    for file in with_progress(options.cloud, "cloud"):
        cloud = io.read_cloud(file, columns=())
        try:
            quality = chart_cloud.evaluate_cloud(cloud, scale=scale, **choices)
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


METRICS = ("density", "linear_point_distance", "spacing", "f", "sigma_mad", "void_share")


def names(text):
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def thresholds(text):
    """Pairs NAME=VALUE between commas."""
    try:
        pairs = [pair.split("=") for pair in text.split(",")]
        return {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid thresholds {text!r}. Must be NAME=VALUE,NAME=VALUE,..."
        ) from None


@command(
    "density, spacing, f and sigma_MAD of a whole campaign, cell by cell",
    option("cloud", "CLOUD_OR_FOLDER", "LAS, LAZ or COPC", nargs="+"),
    option("--out", "FILE", ".nc, .zarr, .tif", Path, required=True),
    option("--metrics", "A,B", f"of {', '.join(METRICS)}", names, METRICS),
    option("--cell", "M", "side of the cells", float, 0.5),
    option("--radius", "M", "farther neighbours do not count", float, 0.5),
    option("--thickness", "M", "neighbours lie this near to the tangent plane", float, 0.1),
    option("--void", "M", "side of the squares that count as void when empty", float, 0.1),
    choice("--surface", ("local", "horizontal"), "to measure spacing in"),
    option(
        "--below",
        "NAME=VALUE,...",
        "report the share of the area below these, as density=1000,f=2",
        thresholds,
        {},
    ),
    option("--rho0", "DENSITY", "points/m2 asked for: map where f does not matter", float),
    option("--crs", "EPSG:N", "of the files, where they do not say"),
    option("--tile", "M", "side of the tiles; changes no result", float),
    option("--workers", "N", "processes, default by points, up to the cores", int),
    option("--scheduler", "tcp://HOST:PORT", "of a running Dask cluster"),
    *OUTPUT,
    examples=(
        "drive/ --cell 0.5 --out drive.nc --below density=3000,f=2",
        "drive/ --rho0 3000 --out drive.nc",
        "drive/ more.copc.laz --metrics density,void_share --out map.tif --crs EPSG:25832",
        "drive/ --out drive.zarr --scheduler tcp://10.0.0.5:8786",
    ),
)
def map_(options):
    """Map the quality of a whole campaign: density, spacing, f, sigma_MAD in every cell.

    Takes any number of LAS, LAZ and COPC files and folders of them. Spacing is measured in the
    local tangent plane, on walls as on the road, and the map has a layer for level surfaces, one
    for upright ones, and the count of other points; --surface horizontal measures in the horizontal
    plane instead.

    Beside the map: a summary .csv (area-weighted quantiles, shares below --below), a figure .png, a
    report .html, and the run folder .run, from which an interrupted run goes on where it stopped.
    Until it has finished, that folder needs 24 bytes a point. A damaged file is named, the others
    are mapped, and the exit status is 1. A file with the points of another one counts once. The
    column remarks of the summary says so, and how much area without points lies inside the map.

    On a cluster the workers need this package, and files and --out under the same paths:
      dask scheduler            # on one machine
      dask worker tcp://10.0.0.5:8786 --nthreads 1 --nworkers 8
    """
    from mmqa_lab.maps.tile import variables

    maps.check_thresholds(options.below, variables(options.metrics))
    if options.rho0 is not None:
        checks.check_positive(options.rho0, "rho0", unit="points per m2")
        checks.check_choice("spacing", "metric for --rho0", options.metrics)
    if options.crs:
        given, stated = checks.check_crs(options.crs), map_campaigns.known_crs(options.cloud)
        checks.check_metres(given, "crs")
        checks.check_same_crs("crs", given, "files", checks.check_crs(stated) if stated else None)
    lazily = options.out.suffix == ".tif" and not options.crs
    maps.check_place(options.out, map_campaigns.known_crs(options.cloud) if lazily else "given")
    names = ("cell", "surface", "metrics", "radius", "thickness", "void", "tile")
    choices = {name: getattr(options, name) for name in (*names, "workers", "scheduler")}
    folder = options.out.with_suffix(".run")
    outcome = maps.map_campaign(options.cloud, folder, progress=sys.stderr.isatty(), **choices)
    dataset = maps.open_map(folder, crs=options.crs, rho0=options.rho0)
    table = maps.summarise(dataset, below=options.below)
    maps.write_map(dataset, options.out)
    about = _about(outcome, dataset) | {"problems": outcome.problems}
    maps.write_report(options.out.with_suffix(".html"), dataset, table, **about)
    options.csv = options.csv or options.out.with_suffix(".csv")
    print_rows(table, options)
    for problem in outcome.problems:
        print(f"mmqa map: {problem}", file=sys.stderr)
    return 1 if outcome.problems else 0


def _about(outcome, dataset):
    """Title and lines of the report."""
    points = dataset["n"].sum(dim=("y", "x")).to_series()
    lines = [
        f"{outcome.points} points, {outcome.tiles} tiles",
        *(f"points in layer {layer}: {n}" for layer, n in points.items()),
        *(f"{name}: {value}" for name, value in dataset.attrs.items()),
    ]
    return {"title": f"Map {outcome.folder.stem}", "lines": lines}
