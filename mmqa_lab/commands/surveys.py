"""The commands on a user's own clouds, photographs and tables.

A command reads files by ``io``, calls a room's function with arrays and returns a table. Its
signature is its arguments, its docstring its help. Rooms are imported inside the commands, so that
help is quick.
"""

import re
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from mmqa_lab._checks import check_choice, check_outputs, check_upright, refuse
from mmqa_lab.commands.machine import (
    FIGURE_ENDINGS,
    check_ending,
    heard,
    progress,
    sentence_of,
    table,
    write_figure,
)

__all__ = [
    "accuracy", "calibrate", "chart", "evaluate", "image", "info", "lhd", "map_", "pattern",
    "plan", "poles", "radiometry", "tender",
]  # fmt: skip


@table
def info(clouds: list[Path], /):
    """List what files contain: extent, unit, step, time, and columns with counts of their values.

    Remarks tell what other commands leave out, count or refuse.

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, PLY or text; images; outlines; and folders of such files.
    """
    import pandas as pd

    inside = [sorted(one.rglob("*")) if one.is_dir() else [one] for one in clouds]
    files = [one for some in inside for one in some if one.is_file() or one in clouds]
    if not files:
        raise ValueError(f"Invalid folder {clouds[0]}: no file in it. Must contain one.")
    return _each(files, "file", lambda file: pd.DataFrame([_contents(file)]))


def _each(files, unit, measured, *, column="file", remark="remarks"):
    """Tables of files below each other; a file that fails has a row with the reason alone."""
    import pandas as pd

    tables, errors, lost = [], [], []
    for file in progress(files, unit):
        table, said = heard(measured, file)
        if isinstance(table, Exception):
            errors, lost = [*errors, table], [*lost, *said]
            table = pd.DataFrame([{remark: sentence_of(table, file)}])
        own = table[remark].fillna("") if remark in table else [""] * len(table)
        told = [sentence.removeprefix(f"{file}: ") for sentence in said]
        table[remark] = [" ".join([*(s for s in told if s not in o), o]).strip() for o in own]
        table.insert(0, column, file.name)
        tables.append(table)
    if len(errors) == len(files):
        for sentence in lost:
            warnings.warn(sentence, stacklevel=2)
        said = sentence_of(errors[0], files[0])
        if len(files) > 1 and files[0].name not in said:
            said = said.replace("Invalid", f"Invalid {files[0].name},", 1)
        raise ValueError(said) from errors[0]
    whole = pd.concat(tables, ignore_index=True)
    whole.attrs["failed"] = len(errors)
    return whole


def _contents(file):
    """What a file contains, as a row."""
    from dataclasses import replace

    from mmqa_lab import io
    from mmqa_lab.cloud import Cloud, describe

    ending = file.suffix.lower()
    if ending in io.IMAGE_ENDINGS:
        bands, rows, columns = io.read_bands(file).shape
        return {"image": f"{columns} x {rows} pixels, {bands} bands"}
    if ending in io.OUTLINE_ENDINGS:
        return describe(Cloud(io.read_polygon(file)))
    parts = list(io.iterate_cloud(file))
    whole = Cloud.concatenate(replace(part, crs=None) for part in parts)
    return describe(replace(whole, crs=parts[0].crs if parts else None))


@table
def evaluate(
    clouds: list[Path],
    /,
    *,
    polygon: str | None = None,
    rho0: float | None = None,
    axes: str | None = None,
    radius: float = 0.5,
    intervals: bool = False,
    detail: float | None = None,
    out: Path | None = None,
):
    """Evaluate the points on one planar surface: density, sigma_MAD, d1..d4, f, g and e95.

    The plane is the orthogonal regression plane of the points; d1..d4 are the medians of the sorted
    distances to the nearest point in each of four quadrants, f = d4/d1 (Pfeifer et al. 2021, doi
    10.3390/rs13020237). g compares the spacings across and along scan lines; 95 % of the places of
    the surface have a point within e95. Without a polygon the surface is the whole cloud.

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, PLY or text.
    polygon
        The outline of the surface: a CSV or GeoJSON file, or "x,y,z; x,y,z; x,y,z".
    rho0
        The density asked for, points per m2. The table then says whether f matters.
    axes
        Axes of the quadrants: principal, horizontal, or the principal ones turned by degrees.
    radius
        Largest distance of a neighbour, m.
    intervals
        Print a row for each figure with its 95 % confidence interval, and a doubt where it has one.
    detail
        Size of details, m. Print the share of places that would show one by three points; the
        picture marks the others.
    out
        Draw the last cloud into this file: .pdf, .png or .svg.
    """
    from mmqa_lab import chart_cloud, io

    check_ending(out, "figure", FIGURE_ENDINGS)
    turned = float(axes) if axes and re.fullmatch(r"-?(\d+\.?\d*|\.\d+)", axes) else axes
    choices = {"axes": turned, "radius": radius, "rho0": rho0}
    done = []

    def measured(file):
        cloud = io.read_cloud(file, columns=())
        ring = None if polygon is None else io.read_polygon(polygon, crs=cloud.crs)
        quality = chart_cloud.evaluate_cloud(cloud, polygon=ring, **choices)
        frame = _with_doubts(quality) if intervals else quality.to_frame()
        if detail is not None:
            frame["details_seen"] = quality.details(detail)[0]
        done.append(quality)
        return frame.assign(remarks=" ".join(quality.remarks))

    frame = _each(clouds, "cloud", measured)
    if out is not None:
        write_figure(out, lambda: done[-1].plot(detail=detail))
    return frame


def _with_doubts(quality):
    """The figures with their intervals, and which of them are not certain."""
    from mmqa_lab import tender

    table, said = quality.intervals(), []
    for row in table.itertuples():
        name = next((one for one in tender.QUANTITIES if one.startswith(row.figure)), row.figure)
        known = {"low": row.low, "high": row.high, "remarks": " ".join(quality.remarks)}
        said.append(tender.verdict(row.value, "<=", float("inf"), quantity=name, **known))
    return table.assign(doubt=["" if one == "met" else one for one in said])


@table
def map_(clouds: list[Path], /, *, out: Path, cell: float = 0.5):
    """Map the quality of a campaign: density, d1..d4, f, sigma_MAD in every cell.

    The tiles of the map are kept in a folder beside it, whose name ends in .run. An interrupted
    run continues from there.

    Parameters
    ----------
    clouds
        Cloud files (LAS, LAZ, COPC, PLY or text), and folders of LAS, LAZ or COPC files.
    out
        Write the map into this file: .nc (NetCDF) or .tif (GeoTIFF).
    cell
        Side of the square cells, m.
    """
    from mmqa_lab import maps

    check_ending(out, "map", maps.ENDINGS)
    with warnings.catch_warnings(action="ignore"):  # the map has them as remarks
        folder = maps.map_campaign(clouds, out.with_suffix(".run"), cell=cell)
    dataset = maps.open_map(folder)
    maps.write_map(out, dataset)
    return maps.summarise(dataset).assign(remarks=dataset.attrs["remarks"])


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


@table
def pattern(clouds: list[Path], /, *, polygon: str | None = None):
    """Measure the scan pattern of a planar patch: profile spacing, profile angle, point spacing.

    The patch must come from one pass of one scanner head. Profiles are told apart by scan line or
    GPS time. After Cahalane et al. 2014 (doi 10.3390/s140609471), section 4.

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, PLY or text.
    polygon
        The outline of the patch: a CSV or GeoJSON file, or "x,y,z; x,y,z; x,y,z".
    """
    from mmqa_lab import chart_cloud, io, scan_pattern

    def measured(file):
        cloud = io.read_cloud(file)
        if polygon is not None:
            ring = io.read_polygon(polygon, crs=cloud.crs)
            cloud = cloud[chart_cloud.inside_polygon(cloud, ring)]
        numbers = {name: cloud[name] for name in ("gps_time", "scan_line") if name in cloud}
        return scan_pattern.measure_pattern(cloud, **numbers).to_frame()

    return _each(clouds, "cloud", measured)


@table
def lhd(
    files: list[Path],
    /,
    *,
    reference: Path | None = None,
    weight: float = 10.0,
    radius: float = 4.0,
    matcher: str = "all",
):
    """Line-segment Hausdorff distances between sets of 3-D edges, both ways.

    Every set is compared with every other, and with the reference. The published method pairs all
    segments below a threshold (Poreba & Goulette 2013, hal-00846334). The value contains the noise
    of angles and ends, and false pairs, as well as displacement: compare it with the perpendicular
    part and the displacement beside it.

    Parameters
    ----------
    files
        Segments (CSV with x1,y1,z1,x2,y2,z2, m) or clouds, whose edges are extracted first.
    reference
        Edges or cloud of the static survey, the reference.
    weight
        Weight of the angle in the distance.
    radius
        Largest displacement that is searched for, m.
    matcher
        How segments are paired: all, nearest, mutual, hungarian, fragments or displaced.
    """
    from mmqa_lab import io, lines

    files = [*files, *([] if reference is None else [reference])]
    names = [file.stem for file in files]
    names = names if len(set(names)) == len(names) else [str(file) for file in files]
    sets = {}
    for name, file in zip(names, progress(files, "file"), strict=True):
        if file.suffix.lower() in (".csv", ".txt"):
            sets[name] = io.read_segments(file)
        else:
            sets[name] = lines.extract_edges(io.read_cloud(file, columns=()).points).segments
    wanted = None if reference is None else names[-1]
    return lines.compare(sets, reference=wanted, radius=radius, weight=weight, matcher=matcher)


@table
def poles(
    clouds: list[Path],
    /,
    *,
    method: Literal["learned", "fgi", "itc"] = "learned",
    trajectory: Path | None = None,
    corridor: float | None = None,
    reference: Path | None = None,
):
    """Detect poles in clouds of one street, and score them against a reference.

    Method learned takes any cloud. Method fgi follows scan lines (Lehtomaki et al. 2010), itc
    connected components (Pu et al. 2011).

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, PLY or text.
    method
        The detector.
    trajectory
        CSV file of the path. Known poles and finds beyond the corridor along it do not count.
    corridor
        Half of the corridor's width, m.
    reference
        CSV file of known poles with x_m, y_m. Prints recall and precision.
    """
    import numpy as np

    from mmqa_lab import io, poles
    from mmqa_lab.cloud import Cloud

    parts = []
    for number, file in enumerate(progress(clouds, "cloud")):
        cloud = io.read_cloud(file)
        check_upright(f"cloud {file}", cloud.crs)
        head = {"head": np.full(len(cloud), number)} if len(clouds) > 1 else {}
        parts.append(Cloud(cloud.points, head | dict(cloud.columns), file.stem, crs=cloud.crs))
    path = None
    if trajectory is not None:
        path = io.read_trajectory(trajectory)[["easting_m", "northing_m"]].to_numpy()
    found = poles.detect(Cloud.concatenate(parts), method=method)
    if reference is None:
        return found
    known = io.read_table(reference, "reference", ("x_m", "y_m"))
    return poles.score(found, known, trajectory=path, corridor=corridor).to_frame()


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
        Surveyed heights: points (CSV, LAS) or a raster (GeoTIFF).
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
        CSV file of the path (position, roll, pitch, heading), one for each drive or one for all.
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
        paths = [Trajectory.from_table(io.read_trajectory(file)) for file in trajectory]
        paths = paths * len(clouds) if len(paths) == 1 else paths
        unlike = len(paths) != len(clouds)
        refuse(unlike, "trajectories", str(len(paths)), "one, or one for each drive")
        heads = 1 + max(int(np.max(cloud["head"])) if "head" in cloud else 0 for cloud in clouds)
        arms = lever_arm or ["0,0,0"] * heads
        try:
            arms = np.array([arm.split(",") for arm in arms], np.float64).reshape(len(arms), 3)
        except ValueError:
            raise ValueError(f"Invalid lever-arm {' '.join(arms)}. Must be X,Y,Z.") from None
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
def chart(*, out: Path, chart: Literal["grey", "revised", "points"] = "grey", seed: int = 0):
    """Write a test chart to print, 1 m x 1 m at true size, as PDF or SVG.

    The imaging chart has long bars for the pixel size, line pairs for the resolution, texts and
    symbols for the legibility, and coded targets that place it. The point chart has random cells
    (Pfeifer et al. 2021, doi 10.3390/rs13020237). Print without scaling. The second page of the
    imaging chart's PDF says how to use it.

    Parameters
    ----------
    out
        Write the chart into this file: .pdf or .svg.
    chart
        The chart: grey and revised are imaging charts, points is the point chart.
    seed
        Seed of the point chart's random cells.
    """
    import pandas as pd

    from mmqa_lab import charts
    from mmqa_lab.io import write_atomically

    ending = check_choice(out.suffix.lower(), "ending", (".pdf", ".svg"))
    points = chart == "points"
    layout = charts.point_chart(seed=seed) if points else charts.imaging_chart(chart)
    notes = "" if points else charts.how_to_use()
    content = layout.to_pdf(notes=notes) if ending == ".pdf" else layout.to_svg()
    write_atomically(out, lambda path: path.write_bytes(content))
    size = {"width_mm": layout.width, "height_mm": layout.height}
    return pd.DataFrame([{"file": out.name, **size, "elements": len(layout.elements)}])


@table
def image(
    images: list[Path],
    /,
    *,
    chart: Literal["grey", "revised"] = "grey",
    printed_mm: float = 800.0,
    corners: str | None = None,
    panorama: bool = False,
    camera: Path | None = None,
    linear: bool = False,
    out: Path | None = None,
):
    """Measure photographs of the imaging chart: pixel size, resolved line pairs, noise.

    The chart is found by its coded targets and long bars, or at its corners (Pfeifer et al. 2021,
    doi 10.3390/rs13020237). What cannot be measured is empty; the remark tells what speaks against
    the figures. A photograph that cannot be measured has a row with the reason alone.

    Parameters
    ----------
    images
        Photographs: JPEG, PNG or TIFF.
    chart
        The chart that was printed.
    printed_mm
        Length of its standing bars by a rule, after printing.
    corners
        Corners of the chart in pixels, "X,Y; X,Y; X,Y; X,Y": lower left, lower right, upper right,
        upper left.
    panorama
        The image is equirectangular, 2 : 1.
    camera
        Calibration of a lens that bends lines, as OpenCV writes it: YAML, XML or JSON.
    linear
        Grey values are linear in light.
    out
        Draw the last image into this file: .pdf, .png or .svg.
    """
    from mmqa_lab import chart_image, charts

    check_ending(out, "figure", FIGURE_ENDINGS)
    choices = {
        "corners": None if corners is None else _corners(corners),
        "panorama": panorama,
        "calibration": camera,
        "gamma": "linear" if linear else "srgb",
    }
    layout, done = charts.imaging_chart(chart).printed(printed_mm), []

    def measured(file):
        done.append(chart_image.evaluate_file(file, layout, **choices))
        return done[-1].to_frame()

    frame = _each(images, "image", measured, remark="remark")
    if out is not None:
        write_figure(out, lambda: _two_panels(done[-1]))
    return frame


def _two_panels(quality):
    """A photograph of the chart, and the contrasts of its line pairs."""
    from mmqa_lab import plots

    figure, axes = plots.subplots(1, 2, width="double", height_mm=85)
    quality.plot(ax=axes[0])
    quality.plot_contrast(ax=axes[1])
    return figure


def _corners(text):
    """Four corners from 'x,y; x,y; x,y; x,y'."""
    import numpy as np

    try:
        return np.array([corner.split(",") for corner in text.split(";")], float).reshape(4, 2)
    except ValueError:
        raise ValueError(f"Invalid corners {text!r}. Must be four times x,y between ;.") from None


@table
def radiometry(
    measure: Literal["edge", "star", "sharpness", "calibrate", "reflect"],
    images: list[Path],
    /,
    *,
    targets: Path | None = None,
    linear: bool = False,
):
    """Measure a camera in your own images: resolution, sensor and reflectance, band by band.

    edge and star measure the resolution on targets; sharpness needs none. calibrate fits gain and
    offset of the sensor to targets of known radiance. reflect turns digital numbers into
    reflectance by the empirical line (EuroSDR 2013, image radiometry). Intervals are of 95 %.

    A row of the targets has image (name of the file; without the column it is in every one), name,
    and for edge, calibrate and reflect x_px, y_px, width_px, height_px (a region); for star x_px,
    y_px, radius_px, cycles; for calibrate radiance, for reflect reflectance (empty where sought),
    or radiance_1, radiance_2, ... by band. Optionally exposure, or time_s and f_number (calibrate);
    reflectance_std, anisotropy (reflect). Other columns are refused. Pixels count in the upright
    image, the first one's centre at 0.

    Parameters
    ----------
    measure
        What to measure.
    images
        Images with any number of bands: JPEG, PNG or TIFF.
    targets
        CSV file of the targets, see above.
    linear
        Values are linear in light, as of RAW files; else edge, star and sharpness decode sRGB.
    """
    from mmqa_lab import image_targets, io

    known = None if targets is None else io.read_table(targets, "targets")
    if known is None and measure != "sharpness":
        raise ValueError(f"Invalid {measure} without targets. Must have --targets.")

    def measured(file):
        values = io.read_bands(file)
        shown = known
        if known is not None and "image" in known:
            shown = known[known["image"].isin([file.name, file.stem])]
        return image_targets.measure(values, measure, targets=shown, linear=linear)

    return _each(images, "image", measured, column="image")


@table
def tender(criteria: str, results: str, /, *, details: bool = False):
    """Compare systems' results with the criteria of a tender, in a sentence for each system.

    The command judges any figures; it advises none. Which figure goes with which task, study 12
    says: the density with small details, e95 with gaps and the ends of surfaces, sigma_MAD with
    steps and planes. Neither f nor g says what a cloud is fit for.

    Quantities: density_per_m2, sigma_mad_mm, std_mm, d1_mm to d4_mm, e95_mm, f, g (of a cloud);
    pixel_mm, w_mm, legibility, legibility_40mm, legibility_60mm (of a photograph); or your own, in
    both files. Legibility has marks, better first: a each letter can be read, b the text can be
    read, c it cannot. At least b is written >= b or <= b: both mean a or b. Which quantity tells
    what depends on the task: a figure is asked for because of what shall be done with the data.

    Parameters
    ----------
    criteria
        CSV file with criterion, quantity, relation (>=, >, <=, <), threshold and, where they
        matter, distance_m, view (orthogonal, forward, backward), direction (h, v), rho0_per_m2 (of
        f: the density from which it does not matter). Or pfeifer2021:test, pfeifer2021:1,
        pfeifer2021:2: the test and both scenarios of Pfeifer et al. 2021 (doi
        10.3390/rs13020237); or pfeifer2021:g, the test with g in place of f.
    results
        CSV file with system, quantity, value and, where known, sigma or low and high, distance_m,
        view, direction, remarks: a remark that names the figure makes it not certain. Or
        pfeifer2021, the paper's Tables 1 and 2.
    details
        Print a row for each figure instead of one for each system.
    """
    from mmqa_lab import io, tender

    sets = {"test": "test", "1": "scenario 1", "2": "scenario 2", "g": "test with g"}
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
