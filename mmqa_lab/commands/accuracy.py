"""Compare a cloud with surveyed heights (points or a raster), or with surveyed plan positions.

Heights: at each reference point the cloud around it is triangulated; the height differences are
summarised with their systematic shift kept and removed (EuroSDR 2013, mobile laser scanning,
section 3.2). Reference points without a valid difference are counted by reason. In the words of the
ASPRS Positional Accuracy Standards (edition 2, 2023): check points should be 30 or more; rmse_v_mm
is the vertical accuracy of the product, the RMSE with the shift kept and the standard deviation of
the check points' own survey (--reference-std) together; drive against drive is relative accuracy.
The trend over the distance is that of absolute differences with their shift removed.

Plan positions (--targets): poles are circles, corners of buildings and curbs are where two lines
meet, marks are bright spots, each in slices of height above its foot. The table has each kind and
all together, with the shift in easting and northing kept and removed (equation 3-1).
"""

import sys

from mmqa_lab.commands._output import OUTPUT, choice, option, output_file, print_rows, switch

SUMMARY = "accuracy of a cloud against surveyed heights or plan positions"

EPILOG = """\
examples:
  mmqa accuracy street.laz levelled_points.csv --radius 0.5
  mmqa accuracy street.laz airborne.tif --classes 2,11 --thin 1
  mmqa accuracy street.laz airborne.tif --drives --trajectory path.csv --json
  mmqa accuracy street.laz --targets targets.csv

targets.csv has the columns x, y, z (of the foot, m), kind (pole, building, curb, mark) and, where
known, name and diameter (of poles, m).
"""

CHECKPOINTS = 30
"""Fewest that the ASPRS standards ask for."""

FAR_MM = 1000.0
"""A median beyond this is no error of a scan: said."""

UNUSED = ("no_points", "not_surrounded", "slope", "gross_error")
"""Columns that count reference points without a valid difference."""

ARGUMENTS = (
    option("cloud", "CLOUD", "LAS, LAZ, COPC, PLY, PCD, E57 or text"),
    option("reference", "REFERENCE", "points (CSV, LAS) or raster (GeoTIFF)", nargs="?"),
    option("--targets", "FILE", "CSV of poles, corners and marks: accuracy in plan"),
    choice("--slices", ("ours", "report"), "of height above the foot"),
    option("--classes", "C,C", "take points of these classes only, such as 2,11"),
    option("--trajectory", "FILE", "CSV of the path: adds the trend over the distance"),
    option("--radius", "M", "of the surface, 0.5 where points are not dense", float, 0.2),
    option("--slope-limit", "DEG", "steeper surfaces do not count", float, 20.0),
    option("--gross-limit", "M", "differences beyond do not count, default five NMAD", float),
    option("--thin", "M", "take one reference point from each square this wide", float),
    option("--reference-std", "M", "standard deviation of the reference's own heights", float),
    option("--gap", "S", "time without points that separates drives", float, 3600.0),
    option("--search", "M", "points of poles and marks lie this near to the target", float, 0.4),
    switch("--drives", "each drive on its own, and against the first"),
    option("--out --differences", "FILE", "write each difference here", output_file),
    *OUTPUT,
)


def run(options):
    """Compare, then print and write."""
    if (options.reference is None) == (options.targets is None):
        raise ValueError("Invalid request. Must have either REFERENCE or --targets.")
    summary, differences = (_heights if options.targets is None else _plan)(options)
    if options.out is not None:
        from mmqa_lab.io import write_atomically

        write_atomically(options.out, lambda file: differences.to_csv(file, index=False))
    print_rows(summary, options)


def _plan(options):
    """Figures and differences of the targets in plan."""
    import pandas as pd

    from mmqa_lab.testfield import REPORT_SLICES, SLICES, plan_accuracy, plan_differences

    targets = read_targets(options.targets)
    cloud = _read(options, also=("intensity",) if (targets["kind"] == "mark").any() else ())
    slices = {"ours": SLICES, "report": REPORT_SLICES}[options.slices]
    table = plan_differences(cloud, targets, slices=slices, search=options.search)
    if (table["reason"] != "").all():
        reasons = ", ".join(sorted(set(table["reason"])))
        raise ValueError(
            f"Invalid targets {options.targets}: none measured in the cloud ({reasons}). Must lie "
            f"in it ({_extent(cloud.points)}), with the height of the foot."
        )
    groups = [*table.groupby("kind", sort=False), ("all", table)]
    rows = [plan_accuracy(rows).assign(kind=kind) for kind, rows in groups]
    summary = pd.concat(rows, ignore_index=True)
    summary.insert(0, "kind", summary.pop("kind"))
    return summary.assign(remarks=_plan_remark(table["reason"])), table


def _plan_remark(reason):
    """What a reader should know where most of the targets could not be measured."""
    missing = reason[reason != ""]
    if len(missing) <= len(reason) / 2:
        return ""
    return (
        f"{len(missing)} of {len(reason)} slices of targets were not measured (most: "
        f"{missing.mode()[0]}): the heights of the feet or the coordinate systems may differ, or "
        "the cloud is too sparse for them."
    )


def read_targets(path, kind=None):
    """Targets of a CSV file as ``plan_differences`` takes them; all of a kind where it is given."""
    import numpy as np
    import pandas as pd

    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except FileNotFoundError:
        raise FileNotFoundError(f"Invalid targets {path}: no such file. Must exist.") from None
    except (ValueError, UnicodeDecodeError):
        raise ValueError(f"Invalid targets {path}: no table. Must be a CSV file.") from None
    table = table.rename(columns={name: f"{name}_m" for name in ("x", "y", "z", "diameter")})
    table = table if kind is None else table.assign(kind=kind)
    missing = [name for name in ("x_m", "y_m", "z_m", "kind") if name not in table]
    if missing or not len(table):
        lacks = f"no column {missing[0].removesuffix('_m')!r}" if missing else "no targets"
        raise ValueError(f"Invalid targets {path}: {lacks}. Must have x, y, z and kind.")
    xyz = table[["x_m", "y_m", "z_m"]].apply(pd.to_numeric, errors="coerce")
    bad = ~np.isfinite(xyz).all(axis=1)
    if bad.any():
        line = bad.idxmax() + 2
        raise ValueError(f"Invalid targets {path}: no finite number in line {line}. Must be three.")
    return table.assign(**xyz)


def _heights(options):
    """Figures and differences of heights."""
    import pandas as pd

    from mmqa_lab._checks import check_same_crs
    from mmqa_lab.io import read_heights, read_trajectory
    from mmqa_lab.io.images import heights_crs
    from mmqa_lab.testfield import thinned

    reference = read_heights(options.reference)
    if options.thin is not None:
        reference = thinned(reference, options.thin)
    path = None if options.trajectory is None else read_trajectory(options.trajectory)
    cloud = _read(options)
    check_same_crs("reference", heights_crs(options.reference), "cloud", cloud.crs)
    tables = _compared(cloud, reference, options)
    if not any((table["reason"] == "").any() for table in tables.values()):
        raise ValueError(
            f"Invalid reference: no surface of the cloud ({_extent(cloud.points)}) lies around a "
            f"point of it ({_extent(reference)}). Must overlap, in one coordinate system."
        )
    rows = [_rows(name, table, path, options.reference_std) for name, table in tables.items()]
    summary = pd.concat(rows, ignore_index=True)
    summary = summary.assign(remarks=_remarks(summary))
    return summary, pd.concat([table.assign(drive=name) for name, table in tables.items()])


def _read(options, also=()):
    """The cloud, or its points of the classes asked for."""
    import numpy as np

    from mmqa_lab._checks import check_metres
    from mmqa_lab.io import read_cloud

    wanted = {"gps_time": options.drives, "classification": options.classes is not None}
    cloud = read_cloud(options.cloud, columns=[*also, *(name for name in wanted if wanted[name])])
    check_metres(cloud.crs, f"cloud {options.cloud}")
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


def _extent(xyz):
    """Where points lie, in words."""
    (west, south), (east, north) = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    return f"x {west:.1f} to {east:.1f} m, y {south:.1f} to {north:.1f} m"


def _remarks(summary):
    """What a reader of the table should know."""
    said = []
    apart = int((summary["no_points"] + summary["not_surrounded"]).max())
    count = int(summary.filter(["n", *UNUSED]).sum(axis=1).max())
    if apart > count / 2:
        said.append(
            f"{apart} of {count} reference points lie where the cloud has no surface: the units or "
            "the coordinate systems may differ."
        )
    if summary["n"].min() < CHECKPOINTS:
        said.append(
            f"{summary['n'].min()} differences in a row; the ASPRS standards ask for {CHECKPOINTS} "
            "check points or more."
        )
    median = summary.loc[summary["shift"] == "kept", "median_mm"]
    if median.abs().max() > FAR_MM:
        far = median[median.abs().idxmax()] / 1000
        said.append(
            f"The median difference is {far:+.2f} m; the two height systems may differ (ellipsoid "
            "or geoid)."
        )
    return " ".join(said)


def _compared(cloud, reference, options):
    """Tables of differences by name: the whole cloud, or each drive and drive against drive."""
    from mmqa_lab.testfield import height_differences, split_drives

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
        first, other = tables["drive 1"], tables[f"drive {number + 1}"]
        reason = first["reason"].where(first["reason"] != "", other["reason"])
        between = first.assign(dz_m=first["dz_m"] - other["dz_m"], reason=reason)
        tables[f"drive 1 - drive {number + 1}"] = between
    return tables


def _rows(name, table, path, reference_std):
    """The rows of one table of differences."""
    import numpy as np

    from mmqa_lab._checks import check_number
    from mmqa_lab.testfield import REASONS, distance_to_path, height_accuracy

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
    return dict(zip(names, line[["slope", "slope_low", "slope_high"]], strict=True))
