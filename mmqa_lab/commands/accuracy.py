"""The commands on accuracy: differences from a survey, and the mounting of scan heads."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from mmqa_lab._checks import check_outputs, check_upright, refuse
from mmqa_lab.commands.machine import (
    check_ending,
    progress,
    table,
)

__all__ = ["accuracy", "calibrate"]


@table
def accuracy(
    cloud: Path,
    reference: Path | None = None,
    /,
    *,
    targets: Path | None = None,
    radius: float = 0.2,
    out: Path | None = None,
):
    """Compare a cloud with surveyed heights, or with surveyed plan positions.

    Heights: at each reference point the cloud around it is triangulated; differences are summarised
    with their shift kept and removed (EuroSDR 2013, mobile laser scanning, section 3.2). Plan:
    poles are circles, corners of buildings and curbs are where two lines meet.

    Parameters
    ----------
    cloud
        Cloud files: LAS, LAZ, COPC, PLY or text.
    reference
        Surveyed heights: points (CSV, LAS) or a raster (GeoTIFF, ESRI grid, NetCDF).
    targets
        CSV file with x, y, z of each target's foot, its kind (pole, building or curb) and, where
        known, its diameter.
    radius
        Radius of the surface around a reference point, m.
    out
        Write every difference into this CSV file.
    """
    from mmqa_lab import io, test_field

    check_ending(out, "file", (".csv",))
    points = io.read_cloud(cloud, columns=())
    if (reference is None) == (targets is None):
        raise ValueError("Invalid request. Must have either REFERENCE or --targets.")
    if reference is not None:
        check_upright(f"cloud {cloud}", points.crs)
        heights = io.read_heights(reference, crs=points.crs)
        summary, differences = test_field.compare_heights(points, heights, radius=radius)
    else:
        differences = test_field.plan_differences(points, _targets(targets))
        summary = test_field.plan_accuracy(differences)
        missing = differences["reason"].value_counts().drop("", errors="ignore")
        summary["remarks"] = " ".join(
            f"{reason.capitalize()}: {n}." for reason, n in missing.items()
        )
    if out is not None:
        io.write_atomically(out, differences)
    return summary


def _targets(path, **columns):
    """Targets of a CSV file as ``test_field.plan_differences`` takes them."""
    from mmqa_lab import io

    frame = io.read_table(path, "targets")
    frame = frame.rename(columns={name: f"{name}_m" for name in ("x", "y", "z", "diameter")})
    return io.with_numbers(frame.assign(**columns), ("x_m", "y_m", "z_m"), f"targets {path}")


@table
def calibrate(
    drives: list[Path],
    /,
    *,
    trajectory: Annotated[list[Path], Parameter(consume_multiple=True)],
    lever_arm: list[str] | None = None,
    control: Path | None = None,
    poles: Path | None = None,
    out: Path | None = None,
):
    """Estimate boresight and lever arms of scan heads from drives in both directions.

    The table tells what to add to the assumed mounting, with its standard error, and what the
    drives do not determine (EuroSDR 2013, mobile laser scanning, section 3.3.3). In the vehicle
    frame x is to the right, y the direction of travel and z up; roll is about y, pitch about x,
    heading about -z. Several heads are told apart by the column head (0, 1, ...) of the clouds.

    Parameters
    ----------
    drives
        Cloud files with GPS time (LAS or LAZ), one for each drive.
    trajectory
        Path (position, roll, pitch, heading), one for each drive or one for all: CSV, SBET, text of
        POSPac or Inertial Explorer, TUM or EuRoC. Its times are brought to those of the clouds.
    lever_arm
        Assumed lever arm X,Y,Z of a head, m, once for each head. Without it, 0,0,0.
    control
        File of ground points whose heights are known.
    poles
        CSV file with a rough x, y, z of each pole's foot, and its diameter where it is known to
        millimetres.
    out
        Write the corrected clouds into this folder.
    """
    import numpy as np

    from mmqa_lab import boresight, io
    from mmqa_lab.simulate import Trajectory

    names = [f"{number}_{file.stem}.laz" for number, file in enumerate(drives, start=1)]
    if out is not None and out.is_dir():
        inputs = [one for one in (*drives, *trajectory, control, poles) if one is not None]
        check_outputs([out / name for name in names], inputs)
    with nullcontext() if out is None else io.own_folder(out):
        clouds = [io.read_cloud(file) for file in progress(drives, "cloud")]
        heads = 1 + max(int(np.max(cloud["head"])) if "head" in cloud else 0 for cloud in clouds)
        arms = lever_arm or ["0,0,0"] * heads
        try:
            arms = np.array([arm.split(",") for arm in arms], np.float64).reshape(len(arms), 3)
        except ValueError:
            raise ValueError(f"Invalid lever-arm {' '.join(arms)}. Must be X,Y,Z.") from None
        files = trajectory * len(clouds) if len(trajectory) == 1 else trajectory
        unlike = len(files) != len(clouds)
        refuse(unlike, "trajectories", str(len(files)), "one, or one for each drive")
        paths = []
        for file, cloud in zip(files, clouds, strict=True):
            times = cloud.columns.get("gps_time")
            path = io.read_trajectory(file, crs=cloud.crs, times=times)
            paths.append(Trajectory.from_table(path))
        found = boresight.calibrate(
            list(zip(clouds, paths, strict=True)),
            lever_arms_m=arms,
            poles=None if poles is None else _targets(poles, kind="pole"),
            control=None if control is None else io.read_heights(control),
        )
        if out is not None:
            for name, cloud, path in zip(names, clouds, paths, strict=True):
                io.write_cloud(out / name, found.correct(cloud, path))
        return found.to_frame()
