"""Paths of vehicles from text files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_choice
from mmqa_lab.io._text import read_csv

TRAJECTORY_COLUMNS = {
    "time_s": ("time_s", "time", "gps_time", "gpstime", "t"),
    "easting_m": ("easting_m", "easting", "east", "x_m", "x"),
    "northing_m": ("northing_m", "northing", "north", "y_m", "y"),
    "height_m": ("height_m", "height", "altitude", "up", "z_m", "z"),
    "roll_deg": ("roll_deg", "roll"),
    "pitch_deg": ("pitch_deg", "pitch"),
    "heading_deg": ("heading_deg", "heading", "yaw"),
}


def read_trajectory(
    path: str | os.PathLike, *, time_unit: str = "s", angle_unit: str = "degrees"
) -> pd.DataFrame:
    """Read a vehicle's path from a CSV file with a header.

    Parameters
    ----------
    path : path
        Needs time, easting, northing and height under any usual name; roll, pitch and heading
        are read when present.
    time_unit : {"s", "ms", "us"}
    angle_unit : {"degrees", "radians"}

    Returns
    -------
    DataFrame
        ``time_s``, ``easting_m``, ``northing_m``, ``height_m`` and, where present,
        ``roll_deg``, ``pitch_deg``, ``heading_deg``; in the order of time.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a needed column is missing, a value is no finite number, or a time repeats.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "path.csv").write_text("time,x,y,z,heading\\n500,0,0,2,90\\n")
    ...     path = read_trajectory(Path(folder) / "path.csv", time_unit="ms")
    >>> path[["time_s", "height_m", "heading_deg"]].to_numpy().tolist()
    [[0.5, 2.0, 90.0]]
    """
    path = Path(path)
    seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
    check_choice(time_unit, "time_unit", tuple(seconds))
    check_choice(angle_unit, "angle_unit", ("degrees", "radians"))
    if not path.is_file():
        raise FileNotFoundError(f"Invalid trajectory {path}: no such file. Must exist.")
    raw = read_csv(path, sep=",", skipinitialspace=True)
    lower = {str(name).strip().lower(): name for name in raw.columns}
    found = {}
    for column, names in TRAJECTORY_COLUMNS.items():
        present = next((lower[name] for name in names if name in lower), None)
        if present is not None:
            found[column] = pd.to_numeric(raw[present], errors="coerce").astype(float)
        elif column in ("time_s", "easting_m", "northing_m", "height_m"):
            raise ValueError(f"Invalid trajectory {path}: no column {column!r}. Must have one.")
    table = pd.DataFrame(found)
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        raise ValueError(
            f"Invalid trajectory {path}: no finite number in line {bad.idxmax() + 2}. "
            "Must be numbers throughout."
        )
    table["time_s"] *= seconds[time_unit]
    if angle_unit == "radians":
        angles = [column for column in table if column.endswith("_deg")]
        table[angles] = np.degrees(table[angles])
    table = table.sort_values("time_s", ignore_index=True)
    if (table["time_s"].diff() <= 0).any():
        raise ValueError(f"Invalid trajectory {path}: a time repeats. Must be distinct times.")
    return table
