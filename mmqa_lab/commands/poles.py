"""Detect poles in a cloud, and score them where a reference is given.

Methods: ours (a learned verdict, any cloud), fgi (scan lines, Lehtomaki et al. 2010; as recorded,
or recovered from gps_time or scan_angle) and itc (components, Pu et al. 2011). A row a pole: the
axis at half the height of the pole-like part (x_m, y_m), z_base_m, height_m, diameter_m, tilt_deg,
score, method; of itc also is_tree. A reference is a CSV file with x_m, y_m and, where known, class,
height_m (below 1 m: no target), diameter_m, visible and ignore (no target where False and True);
detections and references are matched one to one within --gate. Where there is a trajectory, points,
detections and references beyond the corridor do not count.
"""

from pathlib import Path

from mmqa_lab.commands._output import (
    add_output_arguments,
    output_file,
    print_json,
    print_rows,
    with_progress,
    write_rows,
)

SUMMARY = "detect poles, and score them against a reference"

EPILOG = """\
example:
  mmqa poles street.laz --method fgi --trajectory path.csv --csv poles.csv
  mmqa poles street.laz --reference poles_field.csv --json
"""

COLUMNS = ["x_m", "y_m", "z_base_m", "height_m", "diameter_m", "tilt_deg", "score", "method"]


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("cloud", metavar="CLOUD", help="LAS, LAZ, COPC, PLY, PCD, E57 or text")
    parser.add_argument("--method", choices=("ours", "fgi", "itc"), default="ours")
    parser.add_argument("--trajectory", metavar="FILE", help="positions; clips the cloud")
    parser.add_argument(
        "--corridor",
        type=float,
        metavar="M",
        help="half width about the trajectory, default 15 m for itc and 30 m for the others",
    )
    parser.add_argument("--reference", type=Path, metavar="FILE", help="CSV of known poles")
    parser.add_argument(
        "--gate", type=float, default=0.5, metavar="M", help="of a match, default %(default)s m"
    )
    parser.add_argument(
        "--explain", action="store_true", help="list every candidate and what rejected it"
    )
    parser.add_argument(
        "--out", "--geojson", type=output_file, metavar="FILE", help="write the poles as GeoJSON"
    )
    add_output_arguments(parser)


def run(options):
    """Detect, write, score and print."""
    from mmqa_lab import poles
    from mmqa_lab._checks import check_metres, check_positive
    from mmqa_lab.io import read_cloud, read_trajectory

    path, gate = None, check_positive(options.gate, "gate", unit="m")
    if options.trajectory is not None:
        table = read_trajectory(options.trajectory)
        path = table[["easting_m", "northing_m"]].to_numpy()
    reference = None if options.reference is None else _read_reference(options.reference)
    corridor = options.corridor
    if path is not None and corridor is None:
        corridor = poles.CORRIDORS_M[options.method]
    scope = {"trajectory": path, "corridor": corridor}
    for file in with_progress([options.cloud], "cloud"):
        cloud = read_cloud(file)
        check_metres(cloud.crs, f"cloud {file}")
        found = poles.detect(cloud, method=options.method, explain=options.explain, **scope)
    shown = found[[*COLUMNS, *found.columns.intersection(["is_tree", "rejected_by"])]]
    if options.out is not None:
        _write_geojson(options.out, shown)
    if reference is None:
        print_rows(shown, options)
        return
    accepted = found[found["rejected_by"] == ""] if options.explain else found
    scores = poles.score(accepted, reference, gate=gate, **scope)
    if not options.json:
        print_rows(shown, options)
        print(
            f"recall     {scores.recall}\nprecision  {scores.precision}\nF1         {scores.f1:.3f}"
        )
        if "class" in reference:
            print(scores.by_class().to_string(index=False, float_format="%.3f"))
        return
    rates = {"recall": vars(scores.recall), "precision": vars(scores.precision), "f1": scores.f1}
    rates["duplicates"] = scores.duplicates
    write_rows(shown, options)
    print_json({"poles": shown.astype(object).to_dict(orient="records"), "scores": rates})


def _read_reference(path):
    """A reference table, with its columns checked."""
    import pandas as pd

    if not path.is_file():
        raise FileNotFoundError(f"Invalid reference {path}: no such file. Must exist.")
    try:
        table = pd.read_csv(path)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError):
        raise ValueError(f"Invalid reference {path}: not a table. Must be a CSV file.") from None
    if not {"x_m", "y_m"} <= set(table):
        raise ValueError(
            f"Invalid reference {path}: columns {', '.join(table)}. Must have x_m and y_m."
        )
    return table


def _write_geojson(path, table):
    """Write the poles as GeoJSON points in the coordinates of the cloud; null: not measurable."""
    import json

    from mmqa_lab.io import write_atomically

    rows = table.astype(object).where(table.notna(), None).to_dict(orient="records")
    features = []
    for row in rows:
        place = [round(float(row[name]), 4) for name in ("x_m", "y_m", "z_base_m")]
        rest = {name: value for name, value in row.items() if name not in ("x_m", "y_m")}
        geometry = {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": geometry, "properties": rest})
    text = json.dumps({"type": "FeatureCollection", "features": features}, indent=1)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
