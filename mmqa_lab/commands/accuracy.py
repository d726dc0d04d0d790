"""Compare the heights of a cloud with reference points or a raster of heights.

At each reference point the cloud around it is triangulated; the height differences are summarised
with their systematic shift kept and removed (EuroSDR 2013, mobile laser scanning, section 3.2).
Reference points without a valid difference are counted by reason. In the words of the ASPRS
Positional Accuracy Standards (edition 2, 2023): check points should be 30 or more; rmse_v_mm is the
vertical accuracy of the product, the RMSE with the shift kept and the standard deviation of the
check points' own survey (--reference-std) together; drive against drive is relative accuracy. The
trend over the distance is that of absolute differences with their shift removed.
"""

import sys

from mmqa_lab.commands._output import add_output_arguments, output_file, print_rows

SUMMARY = "height accuracy of a cloud against reference points or a raster"

EPILOG = """\
example:
  mmqa accuracy street.laz levelled_points.csv --radius 0.5
  mmqa accuracy street.laz airborne.tif --classes 2,11 --thin 1
  mmqa accuracy street.laz airborne.tif --drives --trajectory path.csv --json
"""

CHECKPOINTS = 30
"""Fewest that the ASPRS standards ask for."""

FAR_MM = 1000.0
"""A median beyond this is no error of a scan: said."""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("cloud", metavar="CLOUD", help="LAS, LAZ, COPC, PLY, PCD, E57 or text")
    parser.add_argument(
        "reference",
        metavar="REFERENCE",
        help="points (CSV, text, LAS: x, y, z) or raster (GeoTIFF, Esri ASCII grid, npz)",
    )
    parser.add_argument(
        "--classes",
        metavar="C,C",
        help="take points of these classes only, such as 2,11 (ground, road) of LAS files",
    )
    parser.add_argument(
        "--trajectory",
        metavar="FILE",
        help="CSV of the path: adds the trend of absolute differences, less their shift",
    )
    parser.add_argument(
        "--radius",
        type=float,
        default=0.2,
        metavar="M",
        help="of the triangulated surface, 0.2 m (default) where points are dense, 0.5 m where not",
    )
    parser.add_argument(
        "--slope-limit",
        type=float,
        default=20.0,
        metavar="DEG",
        help="steeper surfaces do not count, default %(default)s degrees",
    )
    parser.add_argument(
        "--gross-limit",
        type=float,
        metavar="M",
        help="differences farther from the median do not count; default five NMAD",
    )
    parser.add_argument(
        "--thin",
        type=float,
        metavar="M",
        help="take one reference point from each square this wide",
    )
    parser.add_argument(
        "--reference-std",
        type=float,
        metavar="M",
        help="standard deviation of the reference's own heights: adds rmse_v_mm",
    )
    parser.add_argument(
        "--drives",
        action="store_true",
        help="each drive on its own, and against the first",
    )
    parser.add_argument(
        "--gap",
        type=float,
        default=3600.0,
        metavar="S",
        help="time without points that separates drives, default %(default).0f s",
    )
    parser.add_argument(
        "--out",
        "--differences",
        type=output_file,
        metavar="FILE",
        help="write each difference to this CSV",
    )
    add_output_arguments(parser)


def run(options):
    """Compare, then print and write."""
    import pandas as pd

    from mmqa_lab.io import read_heights, read_trajectory, write_atomically
    from mmqa_lab.testfield import thinned

    reference = read_heights(options.reference)
    if options.thin is not None:
        reference = thinned(reference, options.thin)
    path = None if options.trajectory is None else read_trajectory(options.trajectory)
    cloud = _read(options)
    tables = _compared(cloud, reference, options)
    _check_overlap(tables, cloud.points, reference)
    rows = [_rows(name, table, path, options.reference_std) for name, table in tables.items()]
    if options.out is not None:
        differences = pd.concat([table.assign(drive=name) for name, table in tables.items()])
        write_atomically(options.out, lambda file: differences.to_csv(file, index=False))
    summary = pd.concat(rows, ignore_index=True)
    _warn(summary)
    print_rows(summary, options)


def _read(options):
    """The cloud, or its points of the classes asked for."""
    import numpy as np

    from mmqa_lab.io import read_cloud

    wanted = {"gps_time": options.drives, "classification": options.classes is not None}
    cloud = read_cloud(options.cloud, columns=[name for name in wanted if wanted[name]])
    if options.classes is None:
        return cloud
    try:
        classes = [int(text) for text in options.classes.split(",")]
    except ValueError:
        raise ValueError(
            f"Invalid classes {options.classes!r}. Must be whole numbers such as 2,11."
        ) from None
    chosen = np.isin(cloud["classification"], classes)
    if not chosen.any():
        there = ", ".join(str(number) for number in np.unique(cloud["classification"]))
        raise ValueError(f"Invalid classes {options.classes}: no points. Must be some of {there}.")
    return cloud[chosen]


def _check_overlap(tables, points, reference):
    """Refuse a reference that lies elsewhere."""
    if any((table["n"] > 0).any() for table in tables.values()):
        return
    cloud, other = (
        f"x {xyz[:, 0].min():.1f} to {xyz[:, 0].max():.1f} m, "
        f"y {xyz[:, 1].min():.1f} to {xyz[:, 1].max():.1f} m"
        for xyz in (points, reference)
    )
    raise ValueError(
        f"Invalid reference: no point of the cloud ({cloud}) lies near one of it ({other}). "
        "Must overlap, in one coordinate system."
    )


def _warn(summary):
    """Say what a reader of the table should know."""
    if summary["n"].min() < CHECKPOINTS:
        print(
            f"mmqa accuracy: {summary['n'].min()} differences in a row; the ASPRS standards ask "
            f"for {CHECKPOINTS} check points or more.",
            file=sys.stderr,
        )
    median = summary.loc[summary["shift"] == "kept", "median_mm"]
    if median.abs().max() > FAR_MM:
        far = median[median.abs().idxmax()] / 1000
        print(
            f"mmqa accuracy: the median difference is {far:+.2f} m; the two height systems may "
            "differ (ellipsoid or geoid).",
            file=sys.stderr,
        )


def _compared(cloud, reference, options):
    """Tables of differences by name: the whole cloud, or each drive and drive against drive."""
    from mmqa_lab.testfield import between_drives, height_differences, split_drives

    choices = {
        "radius": options.radius,
        "slope_limit": options.slope_limit,
        "gross_limit": options.gross_limit,
        "progress": sys.stderr.isatty(),
    }
    if not options.drives:
        return {"all": height_differences(cloud.points, reference, **choices)}
    drive = split_drives(cloud["gps_time"], gap_s=options.gap)
    tables = {}
    for number in range(drive.max() + 1):
        points = cloud.points[drive == number]
        tables[f"drive {number + 1}"] = height_differences(points, reference, **choices)
    for number in range(1, drive.max() + 1):
        name = f"drive {number + 1}"
        tables[f"drive 1 - {name}"] = between_drives(tables["drive 1"], tables[name])
    return tables


def _rows(name, table, path, reference_std):
    """The rows of one table of differences."""
    import numpy as np

    from mmqa_lab._checks import check_number
    from mmqa_lab.testfield import distance_to_path, height_accuracy
    from mmqa_lab.testfield.heights import REASONS

    rows = height_accuracy(table)
    rows.insert(0, "drive", name)
    if reference_std is not None and "-" not in name:
        survey_mm = 1000 * check_number(reference_std, "reference-std", low=0, unit="m")
        rows["rmse_v_mm"] = np.hypot(rows["rmse_mm"], survey_mm).where(rows["shift"] == "kept")
    for reason in REASONS[1:]:
        rows[reason.replace(" ", "_")] = int((table["reason"] == reason).sum())
    if path is not None:
        used = table[table["reason"] == ""]
        places = used[["x_m", "y_m"]].to_numpy()
        distance = distance_to_path(places, path) if len(places) else []
        size = 1000 * (used["dz_m"] - used["dz_m"].mean()).abs()
        rows = rows.assign(**_trend(distance, size))
    return rows


def _trend(distance, values_mm):
    """The trend and the ends of its interval, empty of fewer than three differences."""
    from mmqa_lab.testfield import trend

    names = ("trend_mm_per_m", "trend_low_mm_per_m", "trend_high_mm_per_m")
    try:
        line = trend(distance, values_mm)
    except ValueError:
        return dict.fromkeys(names, float("nan"))
    return dict(zip(names, (line.slope, line.slope_low, line.slope_high), strict=True))
