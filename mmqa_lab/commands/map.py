"""Map the quality of a whole campaign: density, spacing, f, sigma_MAD in every cell.

Takes any number of LAS, LAZ and COPC files and folders of them. Spacing is measured in the local
tangent plane, on walls as on the road, and the map has a layer for level surfaces, one for upright
ones, and the count of other points; --surface horizontal measures in the horizontal plane instead.

Beside the map: a summary .csv (area-weighted quantiles, shares below --below), a figure .png, a
report .html, and the run folder .run, from which an interrupted run goes on where it stopped. Until
it has finished, that folder needs 24 bytes a point. A damaged file is named, the others are mapped,
and the exit status is 1. A file with the points of another one counts once. The column remarks of
the summary says so, and how much area without points lies inside the map.
"""

import argparse
from pathlib import Path

from mmqa_lab.commands._output import add_output_arguments, print_rows

SUMMARY = "density, spacing, f and sigma_MAD of a whole campaign, cell by cell"

EPILOG = """\
example:
  mmqa map drive/ --cell 0.5 --out drive.nc --below density=3000,f=2
  mmqa map drive/ --rho0 3000 --out drive.nc
  mmqa map drive/ more.copc.laz --metrics density,void_share --out map.tif --crs EPSG:25832
  mmqa map drive/ --out drive.zarr --scheduler tcp://10.0.0.5:8786

On a cluster the workers need this package, and files and --out under the same paths:
  dask scheduler            # on one machine
  dask worker tcp://10.0.0.5:8786 --nthreads 1 --nworkers 8
"""

IN_MEMORY = 2**30
"""Maps of fewer bytes than this are read once, larger ones piece by piece at each use."""

METRICS = ("density", "linear_point_distance", "spacing", "f", "sigma_mad", "void_share")


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("cloud", nargs="+", metavar="CLOUD_OR_FOLDER", help="LAS, LAZ or COPC")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".nc, .zarr, .tif")
    parser.add_argument(
        "--metrics", type=_names, default=METRICS, metavar="A,B", help=f"of {', '.join(METRICS)}"
    )
    lengths = {
        "cell": (0.5, "side of the cells"),
        "radius": (0.5, "farther neighbours do not count"),
        "thickness": (0.1, "neighbours lie this near to the tangent plane"),
        "void": (0.1, "side of the squares that count as void when empty"),
    }
    for name, (value, meaning) in lengths.items():
        parser.add_argument(
            f"--{name}",
            type=float,
            default=value,
            metavar="M",
            help=f"{meaning}, default %(default)s m",
        )
    parser.add_argument(
        "--surface", choices=("local", "horizontal"), default="local", help="to measure spacing in"
    )
    parser.add_argument(
        "--below",
        type=_thresholds,
        default={},
        metavar="NAME=VALUE,...",
        help="report the share of the area below these values, as density=1000,f=2",
    )
    parser.add_argument(
        "--rho0",
        type=float,
        metavar="DENSITY",
        help="density that is asked for, points/m2: map where f does not matter",
    )
    parser.add_argument("--crs", metavar="EPSG:N", help="of the files, where they do not say")
    parser.add_argument(
        "--tile", type=float, metavar="M", help="side of the tiles; changes no result"
    )
    parser.add_argument("--workers", type=int, metavar="N", help="processes, default one per core")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="of a running Dask cluster")
    add_output_arguments(parser)


def run(options):
    """Map, write everything, and say what is missing."""
    import sys

    from mmqa_lab import maps
    from mmqa_lab._checks import (
        check_choice,
        check_crs,
        check_metres,
        check_positive,
        check_same_crs,
    )
    from mmqa_lab.maps import check_place, check_thresholds, write_report
    from mmqa_lab.maps.campaign import known_crs
    from mmqa_lab.maps.tile import variables

    check_thresholds(options.below, variables(options.metrics))
    if options.rho0 is not None:
        check_positive(options.rho0, "rho0", unit="points per m2")
        check_choice("spacing", "metric for --rho0", options.metrics)
    if options.crs:
        given, stated = check_crs(options.crs), known_crs(options.cloud)
        check_metres(given, "crs")
        check_same_crs("crs", given, "files", check_crs(stated) if stated else None)
    lazily = options.out.suffix == ".tif" and not options.crs
    check_place(options.out, known_crs(options.cloud) if lazily else "given")
    names = ("cell", "surface", "metrics", "radius", "thickness", "void", "tile")
    choices = {name: getattr(options, name) for name in (*names, "workers", "scheduler")}
    folder = options.out.with_suffix(".run")
    outcome = maps.map_campaign(options.cloud, folder, progress=sys.stderr.isatty(), **choices)
    dataset = maps.open_map(folder, crs=options.crs, rho0=options.rho0)
    if dataset.nbytes < IN_MEMORY:
        dataset = dataset.persist()
    table = maps.summarise(dataset, below=options.below)
    maps.write_map(dataset, options.out)
    about = _about(outcome, dataset) | {"problems": outcome.problems}
    write_report(options.out.with_suffix(".html"), dataset, table, **about)
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


def _names(text):
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _thresholds(text):
    """Pairs NAME=VALUE between commas."""
    try:
        pairs = [pair.split("=") for pair in text.split(",")]
        return {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"Invalid thresholds {text!r}. Must be NAME=VALUE,NAME=VALUE,..."
        ) from None
