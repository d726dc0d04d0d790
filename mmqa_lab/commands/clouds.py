"""The commands on clouds: their content, the figures of a surface, maps, edges and poles."""

import re
import warnings
from functools import partial
from pathlib import Path
from typing import Literal

from mmqa_lab._checks import check_known, check_upright, needs
from mmqa_lab._progress import progress
from mmqa_lab.commands.machine import (
    FIGURE_ENDINGS,
    check_ending,
    each_file,
    say_shown,
    table,
    write_figure,
)

__all__ = ["evaluate", "info", "lhd", "map_", "metrics_of", "pattern", "poles"]


@table
def info(clouds: list[Path], /):
    """List what files are and contain: extent, unit, step, time, columns with counts of values.

    Remarks tell what other commands leave out, count or refuse.

    Parameters
    ----------
    clouds
        Clouds, images, rasters, outlines, paths and tables; and folders of such files.
    """
    import pandas as pd

    from mmqa_lab import io

    inside = [sorted(one.rglob("*")) if one.is_dir() else [one] for one in clouds]
    whole = [one for some in inside for one in some if one.is_file() or one in clouds]
    files = [one for one in whole if not one.name.startswith(".") or one in clouds]
    if not files:
        raise ValueError(f"Invalid folder {clouds[0]}: no file in it. Must contain one.")
    return each_file(files, "file", lambda file: pd.DataFrame([io.describe_file(file)]))


@table
def evaluate(
    clouds: list[Path],
    /,
    *,
    polygon: str | None = None,
    scan: str | None = None,
    rho0: float | None = None,
    axes: str | None = None,
    radius: float = 0.5,
    thickness: float = 0.1,
    intervals: bool = False,
    detail: float | None = None,
    metrics: str | None = None,
    supports: bool = False,
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
        Cloud files: LAS, LAZ, COPC, E57, PCD, PLY, PTX or text; or http addresses of COPC files, of
        which only what the polygon needs is fetched.
    polygon
        Outlines of one or more surfaces: GeoPackage, shapefile, KML, DXF, GeoJSON, WKT or CSV, or
        "x,y,z; x,y,z; x,y,z". Those without heights are laid onto the cloud.
    scan
        The scan of an E57 or PTX file, by its number from 0, or by its name. Without it, all.
    rho0
        The density asked for, points per m2. The table then says whether f matters.
    axes
        Axes of the quadrants: principal, horizontal, or the principal ones turned by degrees.
    radius
        Largest distance of a neighbour, m.
    thickness
        Largest distance of a point from the plane of the outline, m.
    intervals
        Print a row for each figure with its 95 % confidence interval, and a doubt where it has one.
    detail
        Size of details, m. Print the share of places that would show one by three points; the
        picture marks the others.
    metrics
        Print a row for each of these metrics of the field, such as e95_of_3,noise_of_a_mean, for
        all of them (all), or for one of your own, a function of the chart (MODULE:FUNCTION).
    supports
        Print the smallest step, tilt, detail and volume that such a surface supports: each was kept
        by 95 % of simulated drives of study 12, with ten kinds of scanners.
    out
        Draw the last cloud into this file: .pdf, .png or .svg.
    """
    import pandas as pd

    from mmqa_lab import chart_cloud, io
    from mmqa_lab.metrics import METRICS
    from mmqa_lab.metrics import supports as supported_by
    from mmqa_lab.metrics import table as table_of

    check_ending(out, "figure", FIGURE_ENDINGS)
    turned = float(axes) if axes and re.fullmatch(r"-?(\d+\.?\d*|\.\d+)", axes) else axes
    chosen = metrics_of(metrics)
    choices = {"axes": turned, "radius": radius, "rho0": rho0, "thickness": thickness}
    done = []

    def measured(file):
        cloud = io.read_cloud(file, columns=(), scan=scan, within=polygon)
        rings = [("", None)]
        if polygon is not None:
            rings = io.read_outlines(polygon, crs=cloud.crs, points=cloud)
        frames = [_figures(name if len(rings) > 1 else "", ring, cloud) for name, ring in rings]
        return pd.concat(frames, ignore_index=True)

    def _figures(name, ring, cloud):
        quality = chart_cloud.evaluate_cloud(cloud, polygon=ring, **choices)
        frame = _with_doubts(quality) if intervals else quality.to_frame()
        if chosen:
            own = {name: one for name, one in chosen.items() if METRICS.get(name) is not one}
            frame = table_of(quality, chosen, own=own)
        if supports:
            frame = supported_by(quality)
        if detail is not None:
            frame["details_seen"] = quality.details(detail)[0]
        done.append(quality)
        if name:
            frame.insert(0, "outline", name)
        said = " ".join(quality.remarks)
        own = frame.get("remarks", [said] * len(frame))
        return frame.assign(
            remarks=[one if said in one else f"{one} {said}".strip() for one in own]
        )

    frame = each_file(clouds, "cloud", measured)
    if out is not None and done:
        say_shown(out, frame)
        write_figure(out, lambda: done[-1].plot(detail=detail))
    return frame


def _with_doubts(quality):
    """The figures with their intervals, and which of them are not certain."""
    from mmqa_lab import tender

    table, said = quality.intervals(), []
    for row in table.itertuples():
        name = next((one for one in tender.QUANTITIES if one.startswith(row.figure)), row.figure)
        known = {"low": row.low, "high": row.high, "remarks": " ".join(quality.remarks)}
        said.append(tender.verdict(row.value, "<=", 1e300, quantity=name, **known))
    return table.assign(doubt=["" if one == "met" else one for one in said])


@table
def pattern(clouds: list[Path], /, *, polygon: str | None = None):
    """Measure the scan pattern of a planar patch: profile spacing, profile angle, point spacing.

    The patch must come from one pass of one scanner head. Profiles are told apart by scan line or
    GPS time. After Cahalane et al. 2014 (doi 10.3390/s140609471), section 4.

    Parameters
    ----------
    clouds
        Cloud files: LAS, LAZ, COPC, E57, PCD, PLY, PTX or text.
    polygon
        The outline of the patch, of the same forms.
    """
    from mmqa_lab import chart_cloud, io, scan_pattern

    def measured(file):
        cloud = io.read_cloud(file)
        if polygon is not None:
            ring = io.read_polygon(polygon, crs=cloud.crs, points=cloud)
            cloud = cloud[chart_cloud.inside_polygon(cloud, ring)]
        numbers = {name: cloud[name] for name in ("gps_time", "scan_line") if name in cloud}
        return scan_pattern.measure_pattern(cloud, **numbers).to_frame()

    return each_file(clouds, "cloud", measured)


@table
def map_(
    clouds: list[Path],
    /,
    *,
    out: Path,
    cell: float = 0.5,
    polygon: str | None = None,
    metrics: str | None = None,
):
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
    polygon
        Outlines of areas, of the forms that evaluate reads; each has its own rows in the table.
    metrics
        More metrics, such as e95_of_3,noise_of_a_mean,MODULE:FUNCTION, or all; see evaluate.
    """
    from mmqa_lab import maps

    check_ending(out, "map", maps.ENDINGS)
    if out.suffix.lower() == ".tif":
        needs("files", "rasterio")
    chosen = metrics_of(metrics)
    with warnings.catch_warnings(action="ignore"):  # the map has them as remarks
        folder = maps.map_campaign(clouds, out.with_suffix(".run"), cell=cell, metrics=chosen)
    dataset = maps.open_map(folder)
    maps.write_map(out, dataset)
    summary = maps.summarise(dataset) if polygon is None else _by_areas(dataset, polygon)
    return summary.assign(remarks=dataset.attrs["remarks"])


def _by_areas(dataset, polygon):
    """The summary of the cells whose middles lie within each outline."""
    import numpy as np
    import pandas as pd
    import pyproj
    import xarray as xr

    from mmqa_lab import chart_cloud, io, maps

    axes = [dataset["x"].values, dataset["y"].values, [0.0]]
    middles = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    place = dataset.get("spatial_ref")
    crs = None if place is None else pyproj.CRS(place.attrs["crs_wkt"])
    parts = []
    for name, ring in io.read_outlines(polygon, crs=crs, points=middles):
        inside = chart_cloud.inside_polygon(middles, ring * [1, 1, 0])
        within = inside.reshape(len(axes[1]), -1)
        part = maps.summarise(dataset.where(xr.DataArray(within, dims=("y", "x"))))
        parts.append(part.assign(outline=name))
    return pd.concat(parts, ignore_index=True)


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
        path = io.read_trajectory(trajectory, crs=parts[0].crs)[["easting_m", "northing_m"]]
    found = poles.detect(Cloud.concatenate(parts), method=method)
    if reference is None:
        return found
    known = io.read_table(reference, "reference", ("x_m", "y_m"))
    return poles.score(found, known, trajectory=path, corridor=corridor).to_frame()


def metrics_of(text):
    """Functions of a chart by their names, from "all" or "NAME,MODULE:FUNCTION"; none for None."""
    from mmqa_lab.commands.laboratory import named_function
    from mmqa_lab.metrics import METRICS

    if text is None:
        return {}
    found = {}
    for word in METRICS if text == "all" else text.split(","):
        if ":" in word:
            name, function = named_function(word)
            function = partial(_own_value, word, function)
        else:
            name = check_known(word.strip(), "metric", METRICS)
            function = METRICS[name]
        found[name] = function
    return found


def _own_value(word, function, chart):
    """What a reader's own metric gives for a chart."""
    from mmqa_lab.metrics.pattern import Unmeasured

    try:
        return float(function(chart))
    except Unmeasured:
        raise
    except Exception as error:  # the function of a reader may raise anything
        found = f"{word}: {type(error).__name__}: {error}"
        raise ValueError(f"Invalid metric {found}. Must give a number for a chart.") from error
