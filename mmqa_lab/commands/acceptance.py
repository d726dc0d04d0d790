"""The commands before and after a survey: its plan, accuracy, mounting and tender."""

import re
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from mmqa_lab._checks import check_choice, check_outputs, check_upright, refuse
from mmqa_lab._progress import progress
from mmqa_lab.commands.machine import check_ending, table

__all__ = ["accuracy", "calibrate", "plan", "tender"]


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


@table
def tender(criteria: str, results: str, /, *, details: bool = False):
    """Compare systems' results with the criteria of a tender, in a sentence for each system.

    The command judges any figures; it advises none. Which figure goes with which task, the README
    and study 12 say. Neither f nor g says what a cloud is fit for.

    Quantities: each metric of evaluate --metrics all, density_per_m2, sigma_mad_mm, std_mm, d1_mm
    to d4_mm, e95_mm (of a cloud); pixel_mm, w_mm, legibility, legibility_40mm, legibility_60mm (of
    a photograph); or your own, in both files. Legibility has marks, better first: a each letter can
    be read, b the text can be read, c it cannot. At least b is written >= b or <= b: both mean a or
    b. A figure is asked for because of what shall be done with the data.

    Parameters
    ----------
    criteria
        CSV file with criterion, quantity, relation (>=, >, <=, <), threshold and, where they
        matter, distance_m, view (orthogonal, forward, backward), direction (h, v), unit (lengths in
        mm, cm or m), rho0_per_m2 (of f: the density from which it does not matter). Or
        pfeifer2021:test, pfeifer2021:1, pfeifer2021:2: the test and both scenarios of Pfeifer et
        al. 2021 (doi 10.3390/rs13020237).
    results
        CSV file with system, quantity, value and, where known, sigma or low and high, distance_m,
        view, direction, unit, remarks: a remark that names the figure makes it not certain. Or
        pfeifer2021, the paper's Tables 1 and 2.
    details
        Print a row for each figure instead of one for each system.
    """
    from mmqa_lab import io, tender

    sets = {"test": "test", "1": "scenario 1", "2": "scenario 2"}
    paper, _, name = criteria.partition(":")
    if paper == "pfeifer2021" and name in sets:
        wanted = tender.published_criteria(sets[name])
    else:
        wanted = io.read_table(criteria, "criteria")
    if results == "pfeifer2021":
        found = tender.published_results()
    else:
        found = io.read_table(results, "results")
    verdicts = tender.verdicts(wanted, found)
    return verdicts if details else tender.qualification(verdicts)


@table
def plan(
    *,
    range: float,
    speed: float,
    scanner: str | None = None,
    pulse_rate: float | None = None,
    mirror_frequency: float | None = None,
    scanner_heading: float | None = None,
    scanner_tilt: float | None = None,
    target_heading: float = 0.0,
    target_tilt: float = 0.0,
    height_difference: float = 0.0,
    sigma: list[str] | None = None,
    detail: float | None = None,
):
    """Predict the points of a profile scanner on a plane, or the largest speed for a task.

    X is across the track to the target's side, Y the direction of travel, Z up. Angles are
    counter-clockwise, and tilt is applied before heading. With all angles zero, the scan plane is
    vertical and across the track, and the target is a vertical wall along the track. After Cahalane
    et al. 2014 (doi 10.3390/s140609471).

    Parameters
    ----------
    range
        X where the horizontal pulse strikes the plane, m.
    speed
        Speed of the vehicle, m/s.
    scanner
        Name of a profile scanner, such as zf-9012 or vq-450. Without it, give both rates.
    pulse_rate
        Pulses per second.
    mirror_frequency
        Revolutions of the mirror per second.
    scanner_heading
        Turn of the scan plane about the vertical, degrees.
    scanner_tilt
        Tilt of the scan plane about X, degrees.
    target_heading
        Turn of the target about the vertical, degrees.
    target_tilt
        Tilt of the target about Y, degrees.
    height_difference
        Height of the evaluated spot above the scanner, m.
    sigma
        Standard deviations of inputs, such as speed_m_s=0.2 target_heading_deg=1.93.
    detail
        Size of details, m. Print the largest speed at which 95 % of them get three points, beside
        the speeds for 3000 points/m2 and for f = 2.
    """
    from mmqa_lab import scan_pattern

    angles = {"heading_deg": target_heading, "tilt_deg": target_tilt}
    target = scan_pattern.Target(**angles, range_m=range, height_difference_m=height_difference)
    given = {
        "pulse_rate_hz": pulse_rate,
        "mirror_frequency_hz": mirror_frequency,
        "scanner_heading_deg": scanner_heading,
        "scanner_tilt_deg": scanner_tilt,
    }
    setup = _setup(scanner, speed, {name: one for name, one in given.items() if one is not None})
    if detail is not None:
        return scan_pattern.speeds(setup, target, detail=detail)
    lattice = scan_pattern.scan_lattice(setup, target.patch(setup))
    frame = lattice.to_frame().T.reset_index().set_axis(["quantity", "predicted"], axis=1)
    if sigma:
        found = [pair for text in sigma if (pair := re.fullmatch(r"(\w+)=([\d.eE+-]+)", text))]
        if len(found) < len(sigma):
            raise ValueError(f"Invalid sigma {' '.join(sigma)}. Must be like speed_m_s=0.2.")
        sigmas = {pair[1]: float(pair[2]) for pair in found}
        errors = scan_pattern.propagate(setup, target, sigmas=sigmas)
        frame = frame.merge(errors[["quantity", "std", "low", "high"]], on="quantity", how="left")
    return frame


def _setup(scanner, speed, given):
    """The set-up of a scanner with a name, or of given rates and angles."""
    from mmqa_lab import scan_pattern
    from mmqa_lab.simulate import PRESETS

    if scanner is not None:
        profilers = [name for name, one in PRESETS.items() if not one.upright]
        preset = PRESETS[check_choice(scanner, "scanner", profilers)]
        angles = {f"scanner_{turn}": getattr(preset, turn) for turn in ("heading_deg", "tilt_deg")}
        rates = {name: getattr(preset, name) for name in ("pulse_rate_hz", "mirror_frequency_hz")}
        given = angles | rates | given
    if not {"pulse_rate_hz", "mirror_frequency_hz"} <= set(given):
        raise ValueError(
            "Invalid plan. Must have --pulse-rate and --mirror-frequency, or --scanner."
        )
    return scan_pattern.ScanSetup(speed_m_s=speed, **given)
