"""Say what is in a cloud file: extent, coordinate system, density, time, heads, coincident points.

One row per file. The density is the median number of points in the square metres that have points,
counted in plan. The remarks say what the file cannot tell, and with it which commands cannot be
used on it.
"""

from mmqa_lab.commands._output import CLOUDS, OUTPUT, print_rows, with_progress

SUMMARY = "what a cloud file contains, and what it cannot tell"

EPILOG = """\
example:
  mmqa info data_samples/road_patch.laz
  mmqa info drive/*.laz --csv files.csv
"""

HEADS = ("scanner_channel", "point_source_id", "user_data", "head", "scanner")
"""Columns that may number the heads of a system."""

MOST_HEADS = 16

MISSING = {
    "gps_time": "No time of the points: drives and scan lines cannot be told apart by it.",
    "scan_angle": "No scan angles.",
    "intensity": "No intensities.",
}
"""What is said of a column that is missing or the same for all points."""


ARGUMENTS = (CLOUDS, *OUTPUT)


def run(options):
    """Describe every file, then print and write."""
    import pandas as pd

    rows = [describe(file) for file in with_progress(options.cloud, "cloud")]
    print_rows(pd.DataFrame(rows), options, upright="file")


def describe(file):
    """Return what is in a file, a dict."""
    import numpy as np

    from mmqa_lab.cloud import sort_into_cells
    from mmqa_lab.io import read_cloud

    cloud = read_cloud(file)
    row = {"file": str(file), "points": len(cloud)}
    for axis, values in zip("xyz", cloud.points.T, strict=True):
        row |= {f"{axis}_low_m": values.min(), f"{axis}_high_m": values.max()}
    per_cell = np.diff(sort_into_cells(cloud.points[:, :2], 1.0).starts)
    telling = [name for name, values in cloud.columns.items() if len(np.unique(values)) > 1]
    time = np.sort(cloud["gps_time"]) if "gps_time" in telling else np.array([np.nan, np.nan])
    _, together = np.unique(cloud.points, axis=0, return_counts=True)
    return row | {
        "crs": "" if cloud.crs is None else cloud.crs.name,
        "resolution_mm": 1000 * cloud.resolution,
        "area_m2": len(per_cell),
        "density_per_m2": float(np.median(per_cell)),
        "coincident": int(together[together > 1].sum()),
        "time_first_s": time[0],
        "time_span_s": time[-1] - time[0],
        "time_longest_pause_s": np.diff(time).max(),
        "heads": _heads(cloud, telling),
        "columns": " ".join(telling),
        "remarks": " ".join(_remarks(cloud, telling)),
    }


def _heads(cloud, telling):
    """The column that may number the heads, and how many it numbers."""
    import numpy as np

    for name in HEADS:
        count = len(np.unique(cloud[name])) if name in telling else 1
        if 1 < count <= MOST_HEADS:
            return f"{count} by {name}"
    return ""


def _remarks(cloud, telling):
    """What the file cannot tell."""
    import numpy as np

    said = [text for name, text in MISSING.items() if name not in telling]
    if cloud.crs is None:
        said.append("No coordinate system: taken for metres.")
    elif cloud.crs.axis_info and cloud.crs.axis_info[0].unit_conversion_factor != 1:
        said.append("Coordinates are not in metres: other commands refuse the file.")
    if not _heads(cloud, telling):
        said.append("No number of the head.")
    if np.isnan(cloud.resolution):
        said.append("The step of the coordinates is not stated.")
    if "gps_time" in telling and (np.diff(cloud["gps_time"]) < 0).any():
        said.append("Points are not in the order of time.")
    return said
