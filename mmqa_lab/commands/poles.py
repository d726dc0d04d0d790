"""Poles in clouds, delivered and scored."""

import sys
from pathlib import Path

from mmqa_lab.commands import CLOUDS, OUTPUT, Lazy, choice, command, option, output_file, switch
from mmqa_lab.commands._output import print_json, print_rows, with_progress, write_rows

np = Lazy("numpy")
checks = Lazy("mmqa_lab._checks")
io = Lazy("mmqa_lab.io")
poles = Lazy("mmqa_lab.poles")
delivery = Lazy("mmqa_lab.poles.delivery")

SHOWN = [
    *("id", "x_m", "y_m", "class", "class_probability", "total_height_m", "diameter_13_m"),
    *("tilt_deg", "points", "score"),
]
"""Columns of the printed table; files and JSON have all."""

MANY = 5_000_000

TILE_M = 100.0
"""Clouds with more points are searched in squares of that side."""


@command(
    "detect poles, and score them against a reference",
    CLOUDS,
    choice("--method", ("ours", "fgi", "itc"), "see above"),
    option("--trajectory", "FILE", "positions; clips the cloud"),
    option(
        "--corridor",
        "M",
        "half width about the trajectory, default 15 m for itc and 30 m for the others",
        float,
    ),
    option("--reference", "FILE", "CSV of known poles", Path),
    option("--gate", "M", "of a match", float, 0.5),
    switch("--explain", "list every candidate and what rejected it"),
    option("--out --geojson", "FILE", "write the poles as .csv, .geojson or .gpkg", output_file),
    option("--crs", "EPSG:N", "of the clouds, where they do not say"),
    option("--report", "FILE", "a page to check them", output_file),
    option("--decisions", "FILE", "of a page: leave out what was rejected", Path),
    option("--tile", "M", "side of the squares that are searched in turn", float),
    *OUTPUT,
    examples=(
        "street.laz --method fgi --trajectory path.csv --csv poles.csv",
        "street.laz --reference poles_field.csv --json",
        "drive/*.laz --crs EPSG:25832 --out poles.gpkg --report poles.html",
        "drive/*.laz --decisions decisions.csv --out poles.gpkg",
    ),
)
def poles_(options):
    """Detect poles in a cloud, deliver them, and score them where a reference is given.

    Methods: ours (a learned verdict, any cloud), fgi (scan lines, Lehtomaki et al. 2010; as
    recorded, or recovered from gps_time or scan_angle) and itc (components, Pu et al. 2011). A row
    a pole: id, the axis at half the height of the pole-like part (x_m, y_m), z_base_m, height_m,
    diameter_m, tilt_deg and lean_azimuth_deg (from north), score, method, class with
    class_probability, total_height_m, diameter_13_m (1.3 m above ground) with its interval, points
    on the shaft; of itc also is_tree. Clouds must be in metres; --crs says so where the files do
    not.

    --out writes CSV, GeoJSON or GeoPackage. --report writes a page with a map and a picture of each
    pole, the doubtful ones first, on which each is accepted or rejected; --decisions reads what the
    page saved and leaves out what was rejected. A reference is a CSV file with x_m, y_m and, where
    known, class, height_m (below 1 m: no target), diameter_m, visible and ignore (no target where
    False and True); detections and references are matched one to one within --gate. Where there is
    a trajectory, points, detections and references beyond the corridor do not count. More than five
    million points are searched in squares of 100 m; poles on borders are found once.
    """
    if options.out is not None:
        delivery.check_ending(options.out)
    path, gate = None, checks.check_positive(options.gate, "gate", unit="m")
    if options.trajectory is not None:
        table = io.read_trajectory(options.trajectory)
        path = table[["easting_m", "northing_m"]].to_numpy()
    reference = None
    if options.reference is not None:
        reference = delivery.read_table(options.reference, "reference", ("x_m", "y_m"))
    decisions = None if options.decisions is None else delivery.read_decisions(options.decisions)
    scope = {"trajectory": path, "corridor": options.corridor}
    if options.corridor is not None:
        checks.check_positive(options.corridor, "corridor", unit="m")
    cloud = _read_clouds(options)
    if path is not None:
        checks.check_passes(path, cloud.points, f"trajectory {options.trajectory}")
    tile = TILE_M if options.tile is None and len(cloud) > MANY else options.tile
    found = poles.detect(cloud, method=options.method, explain=options.explain, tile=tile, **scope)
    found = found.drop(columns=["lean_x", "lean_y"])
    accepted = found[found["rejected_by"] == ""] if options.explain else found
    if decisions is not None:
        accepted, unused = delivery.with_decisions(accepted.reset_index(drop=True), decisions)
        if unused:
            print(f"mmqa poles: {unused} decisions are about no pole found here", file=sys.stderr)
    if options.report is not None:
        lines = _about(cloud, options)
        delivery.write_report(options.report, cloud.points, accepted, title="Poles", lines=lines)
    if decisions is not None:
        found = accepted = accepted[accepted["decision"] != "reject"].reset_index(drop=True)
    if options.out is not None:
        poles.write_poles(options.out, found, crs=cloud.crs)
    if reference is None:
        _print_poles(found, options)
        return
    if path is not None and scope["corridor"] is None:
        scope["corridor"] = poles.CORRIDORS_M[options.method]
    _print_scores(found, poles.score(accepted, reference, gate=gate, **scope), reference, options)


def _read_clouds(options):
    """All clouds as one; the lines of different files are kept apart."""
    from mmqa_lab.cloud import Cloud

    crs = None if options.crs is None else checks.check_crs(options.crs)
    checks.check_metres(crs, "coordinate system")
    clouds = []
    for number, file in enumerate(with_progress(options.cloud, "cloud")):
        cloud = io.read_cloud(file)
        checks.check_metres(cloud.crs, f"cloud {file}")
        columns = dict(cloud.columns)
        if len(options.cloud) > 1:
            columns.setdefault("head", np.full(len(cloud), number))
        known = cloud.crs or crs
        checks.check_metres(known, f"cloud {file}")
        clouds.append(Cloud(cloud.points, columns, cloud.name, cloud.resolution, known))
    return Cloud.concatenate(clouds) if len(clouds) > 1 else clouds[0]


def _about(cloud, options):
    """What the page says at its top."""
    names = ", ".join(Path(file).name for file in options.cloud)
    crs = "not known" if cloud.crs is None else cloud.crs.name
    return [f"{names}: {len(cloud)} points", f"Method {options.method}", f"Coordinates: {crs}"]


def _print_poles(found, options):
    """Print all as JSON, or the columns that fit a line; the file has all."""
    shown = [*SHOWN, *found.columns.intersection(["rejected_by", "decision"])]
    print_rows(found if options.json else found[shown], options)
    write_rows(found, options)


def _print_scores(found, scores, reference, options):
    """Print the poles and their scores."""
    if not options.json:
        _print_poles(found, options)
        print(
            f"recall     {scores.recall}\nprecision  {scores.precision}\nF1         {scores.f1:.3f}"
        )
        if "class" in reference:
            print(scores.by_class().to_string(index=False, float_format="%.3f"))
        return
    rates = {"recall": vars(scores.recall), "precision": vars(scores.precision), "f1": scores.f1}
    rates["duplicates"] = scores.duplicates
    write_rows(found, options)
    print_json({"poles": found.astype(object).to_dict(orient="records"), "scores": rates})
