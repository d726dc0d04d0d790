"""Accuracy against what was surveyed, and the calibration of a mounting."""

import sys
from pathlib import Path

from mmqa_lab.commands import OUTPUT, Lazy, choice, command, numbers, option, output_file, switch
from mmqa_lab.commands._output import print_rows, with_progress

np = Lazy("numpy")
pd = Lazy("pandas")
checks = Lazy("mmqa_lab._checks")
io = Lazy("mmqa_lab.io")
tables = Lazy("mmqa_lab.io")
image_files = Lazy("mmqa_lab.io")
boresight = Lazy("mmqa_lab.boresight")
testfield = Lazy("mmqa_lab.testfield")

CHECKPOINTS = 30
"""Fewest that the ASPRS standards ask for."""

FAR_MM = 1000.0
"""A median beyond this is no error of a scan: said."""

UNUSED = ("no_points", "not_surrounded", "slope", "gross_error")
"""Columns that count reference points without a valid difference."""


@command(
    "accuracy of a cloud against surveyed heights or plan positions",
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
    examples=(
        "street.laz levelled_points.csv --radius 0.5",
        "street.laz airborne.tif --classes 2,11 --thin 1",
        "street.laz airborne.tif --drives --trajectory path.csv --json",
        "street.laz --targets targets.csv",
    ),
)
def accuracy(options):
    """Compare a cloud with surveyed heights (points or a raster), or with surveyed plan positions.

    Heights: at each reference point the cloud around it is triangulated; the height differences are
    summarised with their systematic shift kept and removed (EuroSDR 2013, mobile laser scanning,
    section 3.2). Reference points without a valid difference are counted by reason. In the words of
    the ASPRS Positional Accuracy Standards (edition 2, 2023): check points should be 30 or more;
    rmse_v_mm is the vertical accuracy of the product, the RMSE with the shift kept and the standard
    deviation of the check points' own survey (--reference-std) together; drive against drive is
    relative accuracy. The trend over the distance is that of absolute differences with their shift
    removed.

    Plan positions (--targets): poles are circles, corners of buildings and curbs are where two
    lines meet, marks are bright spots, each in slices of height above its foot. The table has each
    kind and all together, with the shift in easting and northing kept and removed (equation 3-1).

    targets.csv has the columns x, y, z (of the foot, m), kind (pole, building, curb, mark) and,
    where known, name and diameter (of poles, m).

    Columns with low and high are 95 % intervals: what other reference points or targets on the same
    drives would give. What a path has wrong all along the field, they do not contain.
    """
    if (options.reference is None) == (options.targets is None):
        raise ValueError("Invalid request. Must have either REFERENCE or --targets.")
    summary, differences = (_heights if options.targets is None else _plan)(options)
    if options.out is not None:
        from mmqa_lab.io import write_atomically

        write_atomically(options.out, lambda file: differences.to_csv(file, index=False))
    print_rows(summary, options)


def _plan(options):
    """Figures and differences of the targets in plan."""
    targets = read_targets(options.targets)
    cloud = _read(options, also=("intensity",) if (targets["kind"] == "mark").any() else ())
    slices = {"ours": testfield.SLICES, "report": testfield.REPORT_SLICES}[options.slices]
    table = testfield.plan_differences(cloud, targets, slices=slices, search=options.search)
    if (table["reason"] != "").all():
        reasons = ", ".join(sorted(set(table["reason"])))
        raise ValueError(
            f"Invalid targets {options.targets}: none measured in the cloud ({reasons}). Must lie "
            f"in it ({_extent(cloud.points)}), with the height of the foot."
        )
    groups = [*table.groupby("kind", sort=False), ("all", table)]
    rows = [testfield.plan_accuracy(rows).assign(kind=kind) for kind, rows in groups]
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
    table = tables.read_table(path, "targets")
    table = table.rename(columns={name: f"{name}_m" for name in ("x", "y", "z", "diameter")})
    table = table if kind is None else table.assign(kind=kind)
    checks.check_columns(table, ["kind"], f"targets {path}")
    if not len(table):
        raise ValueError(f"Invalid targets {path}: no targets. Must have x, y, z and kind.")
    return tables.with_numbers(table, ("x_m", "y_m", "z_m"), f"targets {path}")


def _heights(options):
    """Figures and differences of heights."""
    reference = io.read_heights(options.reference)
    if options.thin is not None:
        reference = testfield.thinned(reference, options.thin)
    path = None if options.trajectory is None else io.read_trajectory(options.trajectory)
    cloud = _read(options)
    if path is not None:
        places = path[["easting_m", "northing_m"]].to_numpy()
        checks.check_passes(places, cloud.points, f"trajectory {options.trajectory}")
    checks.check_same_crs(
        "reference", image_files.heights_crs(options.reference), "cloud", cloud.crs
    )
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
    wanted = {"gps_time": options.drives, "classification": options.classes is not None}
    cloud = io.read_cloud(
        options.cloud, columns=[*also, *(name for name in wanted if wanted[name])]
    )
    checks.check_metres(cloud.crs, f"cloud {options.cloud}")
    if options.classes is None:
        return cloud
    classes = numbers(options.classes, "classes", "whole numbers such as 2,11")
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
    choices = {
        "radius": options.radius,
        "slope_limit": options.slope_limit,
        "gross_limit": options.gross_limit,
        "progress": sys.stderr.isatty(),
    }
    if not options.drives:
        return {"all": testfield.height_differences(cloud.points, reference, **choices)}
    drive = testfield.split_drives(cloud["gps_time"], gap_s=options.gap)
    tables = {}
    for number in range(drive.max() + 1):
        points = cloud.points[drive == number]
        tables[f"drive {number + 1}"] = testfield.height_differences(points, reference, **choices)
    for number in range(1, drive.max() + 1):
        first, other = tables["drive 1"], tables[f"drive {number + 1}"]
        reason = first["reason"].where(first["reason"] != "", other["reason"])
        between = first.assign(dz_m=first["dz_m"] - other["dz_m"], reason=reason)
        tables[f"drive 1 - drive {number + 1}"] = between
    return tables


def _rows(name, table, path, reference_std):
    """The rows of one table of differences."""
    rows = testfield.height_accuracy(table)
    rows.insert(0, "drive", name)
    if reference_std is not None and "-" not in name:
        survey_mm = 1000 * checks.check_number(reference_std, "reference-std", low=0, unit="m")
        rows["rmse_v_mm"] = np.hypot(rows["rmse_mm"], survey_mm).where(rows["shift"] == "kept")
    for reason in testfield.REASONS[1:]:
        rows[reason.replace(" ", "_")] = int((table["reason"] == reason).sum())
    if path is not None:
        used = table[table["reason"] == ""]
        places = used[["x_m", "y_m"]].to_numpy()
        distance = testfield.distance_to_path(places, path) if len(places) else []
        size = 1000 * (used["dz_m"] - used["dz_m"].mean()).abs()
        rows = rows.assign(**_trend(distance, size))
    return rows


def _trend(distance, values_mm):
    """The trend and the ends of its interval, empty of fewer than three differences."""
    names = ("trend_mm_per_m", "trend_low_mm_per_m", "trend_high_mm_per_m")
    try:
        line = testfield.trend(distance, values_mm)
    except ValueError:
        return dict.fromkeys(names, float("nan"))
    return dict(zip(names, line[["slope", "slope_low", "slope_high"]], strict=True))


PATHS = {"nargs": "+", "required": True}

HIGH = 0.95
"""Estimates that correlate more than this can hardly be told apart."""

WEAK = 0.02
"""Degrees or metres: a parameter with a larger standard error is hardly determined."""


@command(
    "boresight and lever arms of scan heads from drives in both directions",
    option("drives", "DRIVE", "LAS or LAZ with GPS time, one each drive", nargs="+"),
    option("--trajectory", "FILE", "CSV of the path of each drive, or one of all", **PATHS),
    choice("--time-unit", ("s", "ms", "us"), "of the trajectories"),
    choice("--angle-unit", ("degrees", "radians"), "of the same"),
    option(
        "--lever-arm",
        "X,Y,Z",
        "assumed lever arm of a head, m; once for each head, default 0,0,0",
        action="append",
    ),
    option("--control", "FILE", "points of the ground whose heights are known"),
    option(
        "--poles", "FILE", "CSV: x, y, z of the foot, roughly; diameter where known to millimetres"
    ),
    option("--keep", "NAME,NAME", "parameters that stay as assumed", str, ""),
    option("--cell", "M", "size of the planes", float, 1.0),
    option("--patches", "N", "most planes used", int, 500),
    option("--path-std", "M,DEG", "standard deviations of the paths over a drive; 0,0: exact"),
    option("--out", "FOLDER", "write corrected clouds and covariance here", Path),
    *OUTPUT,
    examples=(
        "there.laz back.laz --trajectory there.csv back.csv --control levelled.csv",
        "there.laz back.laz --trajectory path.csv --lever-arm 0,-0.5,0.4 --out corrected",
    ),
)
def calibrate_(options):
    """Estimate boresight and lever arms of scan heads from drives in both directions.

    Give the cloud of each drive with its trajectory (position, roll, pitch, heading over the same
    time as the points). Planes that two drives or heads show, poles, and points of known height are
    fitted by least squares; the table has what is to be added to the assumed mounting with its
    standard error, and says what the drives do not determine (EuroSDR 2013, mobile laser scanning,
    section 3.3.3). With --out the corrected clouds and the covariance are written. An error of a
    path that lasts a whole drive looks like an error of the lever arm; standard errors and 95 %
    intervals contain it as --path-std says, without it a usual one that the remarks name.

    Vehicle frame: x right, y travel, z up. Roll is about y, pitch about x, heading about -z.
    Several heads are told apart by the column head (0, 1, ...) of the clouds.
    """
    drives = _drives(options)
    heads = max(int(cloud["head"].max()) + 1 if "head" in cloud else 1 for cloud, _ in drives)
    if len(drives) * heads < 2:
        raise ValueError(
            "Invalid drives: one drive of one head. Must be two, there and back, or several heads."
        )
    wanted = "metres and degrees, such as 0.01,0.005"
    path_std = (None, None)
    if options.path_std is not None:
        path_std = numbers(options.path_std, "path-std", wanted, count=2)
    keep = [name.strip() for name in options.keep.split(",") if name.strip()]
    found = boresight.calibrate(
        drives,
        lever_arms_m=_lever_arms(options.lever_arm, heads),
        poles=None if options.poles is None else read_targets(options.poles, kind="pole"),
        control=None if options.control is None else io.read_heights(options.control),
        keep=keep,
        cell=options.cell,
        patches=options.patches,
        progress=sys.stderr.isatty(),
        path_std_m=path_std[0],
        path_std_deg=path_std[1],
    )
    if options.out is not None:
        _write(options, drives, found)
    print_rows(_table(found, keep).assign(remarks=found.remarks), options)


def _drives(options):
    """Clouds with their trajectories."""
    from mmqa_lab.simulate import Trajectory

    units = {"time_unit": options.time_unit, "angle_unit": options.angle_unit}
    paths = [
        Trajectory.from_table(io.read_trajectory(path, **units)) for path in options.trajectory
    ]
    files = options.trajectory
    if len(paths) == 1:
        paths, files = paths * len(options.drives), files * len(options.drives)
    if len(paths) != len(options.drives):
        raise ValueError(
            f"Invalid trajectories: {len(paths)} for {len(options.drives)} drives. Must be one "
            "for each drive, or one for all."
        )
    drives = []
    for name, file, path in zip(with_progress(options.drives, "cloud"), files, paths, strict=True):
        cloud = io.read_cloud(name)
        checks.check_metres(cloud.crs, f"cloud {name}")
        time = cloud["gps_time"]
        if any(np.array_equal(time, other["gps_time"]) for other, _ in drives):
            raise ValueError(f"Invalid drives: {name} is given twice. Must be different drives.")
        if time.min() < path.time[0] or time.max() > path.time[-1]:
            raise ValueError(
                f"Invalid trajectory {file}: from {path.time[0]:.2f} to {path.time[-1]:.2f} s, the "
                f"points of {name} from {time.min():.2f} to {time.max():.2f} s. Must cover them, "
                "on the same day and clock."
            )
        checks.check_passes(path.position, cloud.points, f"trajectory {file}")
        drives.append((cloud, path))
    return drives


def _lever_arms(texts, heads):
    """Assumed lever arms, (heads, 3)."""
    if texts is None:
        return np.zeros((heads, 3))
    wanted = f"x,y,z once for each of {heads} heads"
    arms = np.array([numbers(text, "lever-arm", wanted, count=3) for text in texts])
    if arms.shape != (heads, 3):
        raise ValueError(f"Invalid lever-arm {' '.join(texts)}. Must be {wanted}.")
    return arms


def _table(found, kept):
    """The estimates with what is to be said of each."""
    table = found.table.assign(head=found.table["head"] + 1).round(12)
    names = [f"{row.parameter} of head {row.head}" for row in table.itertuples()]
    alike = np.abs(np.nan_to_num(found.correlation - np.eye(len(table))))
    remarks = []
    for number, row in enumerate(table.itertuples()):
        other = int(alike[number].argmax())
        if row.parameter in kept:
            remarks.append("kept as assumed")
        elif row.parameter == "z_m" and not found.control:
            remarks.append("mean of all heads kept at 0: not determined without control")
        elif alike[number, other] > HIGH:
            remarks.append(f"hardly told from {names[other]} (r = {alike[number, other]:.2f})")
        elif row.std > WEAK:
            remarks.append("hardly determined by what these drives show")
        else:
            remarks.append("")
    counts = {"sigma0_mm": 1000 * found.sigma0_m, "planes": found.planes, "poles": found.poles}
    return table.assign(remark=remarks, **counts, control=found.control)


def _write(options, drives, found):
    """Corrected clouds as LAZ, and the covariance as CSV."""
    for number, (name, (cloud, path)) in enumerate(zip(options.drives, drives, strict=True)):
        file = options.out / f"{number + 1}_{Path(name).stem}.laz"
        _write_corrected(file, name, found.correct(cloud, path))
    names = (found.table["parameter"] + "_" + (found.table["head"] + 1).astype(str)).tolist()
    covariance = pd.DataFrame(found.covariance, names, names)
    io.write_atomically(options.out / "covariance.csv", lambda path: covariance.to_csv(path))


def _write_corrected(file, source, cloud):
    """A corrected cloud; of a LAS file, with its coordinate system and all its columns."""
    import laspy

    if Path(source).suffix.lower() in io.LAS_ENDINGS:
        las = laspy.read(source)
        if len(las.points) == len(cloud):
            las.x, las.y, las.z = cloud.points.T
            io.write_atomically(file, lambda path: las.write(str(path)))
            return
    io.write_cloud(file, cloud)
