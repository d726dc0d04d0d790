"""Estimate boresight and lever arms of scan heads from drives in both directions.

Give the cloud of each drive with its trajectory (position, roll, pitch, heading over the same time
as the points). Planes that two drives or heads show, poles, and points of known height are fitted
by least squares; the table has what is to be added to the assumed mounting with its standard error,
and says what the drives do not determine (EuroSDR 2013, mobile laser scanning, section 3.3.3). With
--out the corrected clouds and the covariance are written. An error of a path that lasts a whole
drive looks like an error of the lever arm; standard errors contain it where --path-std is given.
"""

from pathlib import Path

from mmqa_lab.commands._output import OUTPUT, choice, option, print_rows, with_progress

SUMMARY = "boresight and lever arms of scan heads from drives in both directions"

EPILOG = """\
examples:
  mmqa calibrate there.laz back.laz --trajectory there.csv back.csv --control levelled.csv
  mmqa calibrate there.laz back.laz --trajectory path.csv --lever-arm 0,-0.5,0.4 --out corrected

Vehicle frame: x right, y travel, z up. Roll is about y, pitch about x, heading about -z. Several
heads are told apart by the column head (0, 1, ...) of the clouds.
"""

PATHS = {"nargs": "+", "required": True}

HIGH = 0.95
"""Estimates that correlate more than this can hardly be told apart."""

WEAK = 0.02
"""Degrees or metres: a parameter with a larger standard error is hardly determined."""

NO_PATH_STD = (
    "The standard errors do not contain errors of the paths, which can be many times larger: give "
    "--path-std."
)


ARGUMENTS = (
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
    option("--path-std", "M,DEG", "standard deviations of the paths over a drive: metres, degrees"),
    option("--out", "FOLDER", "write corrected clouds and covariance here", Path),
    *OUTPUT,
)


def run(options):
    """Calibrate, print and write."""
    from mmqa_lab.boresight import calibrate
    from mmqa_lab.commands.accuracy import read_targets
    from mmqa_lab.io import read_heights

    drives = _drives(options)
    heads = max(int(cloud["head"].max()) + 1 if "head" in cloud else 1 for cloud, _ in drives)
    if len(drives) * heads < 2:
        raise ValueError(
            "Invalid drives: one drive of one head. Must be two, there and back, or several heads."
        )
    path_std = _path_std(options.path_std)
    keep = [name.strip() for name in options.keep.split(",") if name.strip()]
    found = calibrate(
        drives,
        lever_arms_m=_lever_arms(options.lever_arm, heads),
        poles=None if options.poles is None else read_targets(options.poles, kind="pole"),
        control=None if options.control is None else read_heights(options.control),
        keep=keep,
        cell=options.cell,
        patches=options.patches,
        path_std_m=path_std[0],
        path_std_deg=path_std[1],
    )
    if options.out is not None:
        _write(options, drives, found)
    remarks = "" if any(path_std) else NO_PATH_STD
    print_rows(_table(found, keep).assign(remarks=remarks), options)


def _path_std(text):
    """Standard deviations of the paths: metres, degrees."""
    try:
        metres, degrees = map(float, (text or "0,0").split(","))
    except ValueError:
        raise ValueError(
            f"Invalid path-std {text!r}. Must be metres and degrees, such as 0.01,0.005."
        ) from None
    return metres, degrees


def _drives(options):
    """Clouds with their trajectories."""
    import numpy as np

    from mmqa_lab._checks import check_metres
    from mmqa_lab.io import read_cloud, read_trajectory
    from mmqa_lab.simulate import Trajectory

    units = {"time_unit": options.time_unit, "angle_unit": options.angle_unit}
    paths = [Trajectory.from_table(read_trajectory(path, **units)) for path in options.trajectory]
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
        cloud = read_cloud(name)
        check_metres(cloud.crs, f"cloud {name}")
        time = cloud["gps_time"]
        if any(np.array_equal(time, other["gps_time"]) for other, _ in drives):
            raise ValueError(f"Invalid drives: {name} is given twice. Must be different drives.")
        if time.min() < path.time[0] or time.max() > path.time[-1]:
            raise ValueError(
                f"Invalid trajectory {file}: from {path.time[0]:.2f} to {path.time[-1]:.2f} s, the "
                f"points of {name} from {time.min():.2f} to {time.max():.2f} s. Must cover them, "
                "on the same day and clock."
            )
        drives.append((cloud, path))
    return drives


def _lever_arms(texts, heads):
    """Assumed lever arms, (heads, 3)."""
    import numpy as np

    if texts is None:
        return np.zeros((heads, 3))
    try:
        arms = np.array([[float(part) for part in text.split(",")] for text in texts])
    except ValueError:
        arms = np.empty((0, 0))
    if arms.shape != (heads, 3):
        raise ValueError(
            f"Invalid lever-arm {' '.join(texts)}. Must be x,y,z once for each of {heads} heads."
        )
    return arms


def _table(found, kept):
    """The estimates with what is to be said of each."""
    import numpy as np

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
    import pandas as pd

    from mmqa_lab.io import write_atomically

    for number, (name, (cloud, path)) in enumerate(zip(options.drives, drives, strict=True)):
        file = options.out / f"{number + 1}_{Path(name).stem}.laz"
        _write_corrected(file, name, found.correct(cloud, path))
    names = (found.table["parameter"] + "_" + (found.table["head"] + 1).astype(str)).tolist()
    covariance = pd.DataFrame(found.covariance, names, names)
    write_atomically(options.out / "covariance.csv", lambda path: covariance.to_csv(path))


def _write_corrected(file, source, cloud):
    """A corrected cloud; of a LAS file, with its coordinate system and all its columns."""
    import laspy

    from mmqa_lab.io import LAS_ENDINGS, write_atomically, write_cloud

    if Path(source).suffix.lower() in LAS_ENDINGS:
        las = laspy.read(source)
        if len(las.points) == len(cloud):
            las.x, las.y, las.z = cloud.points.T
            write_atomically(file, lambda path: las.write(str(path)))
            return
    write_cloud(file, cloud)
