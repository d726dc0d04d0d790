"""Paths of vehicles, as navigation software and people write them."""

from __future__ import annotations

import os
import re
import warnings

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_columns, coordinate_columns, listed, refuse
from mmqa_lab.io.tables import text_table, with_numbers

__all__ = ["read_trajectory"]

# Columns of a vehicle's path, and other names of them without blanks; the first that is there.
PATH_COLUMNS = ["time_s", "easting_m", "northing_m", "height_m"]
PATH_NAMES = {
    "time_s": ("gpstime", "time", "t", "timestamp", "gpsseconds", "secondsofweek", "sow"),
    "roll_deg": ("roll",),
    "pitch_deg": ("pitch",),
    "heading_deg": ("heading", "yaw"),
}

# Seconds and degrees in units that columns of a path name.
PATH_UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
PATH_UNITS |= {"deg": 1.0, "degrees": 1.0, "°": 1.0, "gon": 0.9}
PATH_UNITS |= dict.fromkeys(("rad", "radians"), 180 / np.pi)

WEEK_S = 604_800.0

PATH_HEADER = "time in seconds, easting, northing, height"
PATH_ORDER = [*PATH_COLUMNS, *[*PATH_NAMES][1:]]


def read_trajectory(path: str | os.PathLike) -> pd.DataFrame:
    """Read a vehicle's path from a CSV file with a header.

    Parameters
    ----------
    path : path
        Needs time in seconds, easting, northing and height in metres under any usual name; roll,
        pitch and heading in degrees are read when present.

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
        If a needed column is missing, a value is no finite number or a time repeats.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "path.csv").write_text("time,x,y,z,heading\\n0.5,0,0,2,90\\n")
    ...     path = read_trajectory(Path(folder) / "path.csv")
    >>> path[["time_s", "height_m", "heading_deg"]].to_numpy().tolist()
    [[0.5, 2.0, 90.0]]
    """
    what, raw = f"trajectory {path}", text_table(path, "trajectory", header=PATH_HEADER)
    used = coordinate_columns(raw.columns)
    table = raw[used].set_axis(PATH_COLUMNS[1 : 1 + len(used)], axis=1)
    plain = {_name_and_unit(column): column for column in reversed(raw.columns)}
    for name, spellings in PATH_NAMES.items():
        for key in [key for one in spellings for key in plain if key[0] == one][:1]:
            odd = key[1] not in PATH_UNITS
            refuse(odd, what, f"column {plain[key]!r}", "in s or degrees")
            used = [*used, plain[key]]
            unit = "seconds" if name == "time_s" else "degrees"
            numbers = with_numbers(raw, used[-1:], what, wanted=unit)[plain[key]]
            table[name] = numbers * PATH_UNITS[key[1]]
    if not {*PATH_COLUMNS} <= {*table}:
        found = f"columns {listed(raw.columns)}"
        raise ValueError(f"Invalid {what} with {found}. Must have {PATH_HEADER}.")
    table = with_numbers(table, table.columns, what)
    unread = listed(raw.columns.drop(used))
    absent = [name.partition("_")[0] for name in [*PATH_NAMES][1:] if name not in table]
    if unread and absent:
        warnings.warn(f"No {', '.join(absent)} in {what}: not read are {unread}.", stacklevel=2)
    _check_heading(table, what)
    wrapped = (table["time_s"].diff() < -WEEK_S / 2).any()
    table = table.sort_values("time_s", ignore_index=True)
    refuse((table["time_s"].diff() <= 0).any(), what, "a time repeats", "distinct times")
    if wrapped:
        check_columns(table, ["heading_deg"], f"{what}, in which the GPS week ends")
        warnings.warn(f"The GPS week ends within {what}: its times are in two parts.", stacklevel=2)
    return table[[name for name in PATH_ORDER if name in table]]


def _check_heading(table, what):
    """Raise where headings agree with the movement only if they are taken for radians."""
    if "heading_deg" not in table or table["heading_deg"].abs().max() > 2 * np.pi:
        return
    east, north = (table[name].diff()[1:] for name in PATH_COLUMNS[1:3])
    heading, course = table["heading_deg"][1:], np.degrees(np.arctan2(east, north))
    in_degrees, in_radians = (
        (((taken - course + 180) % 360 - 180).abs()).median()
        for taken in (heading, np.degrees(heading))
    )
    refuse(in_radians < 15 < 45 < in_degrees, what, "headings look like radians", "in degrees")


def _name_and_unit(name):
    """A column's name in small letters and digits, and the unit behind it."""
    units = "|".join(filter(None, PATH_UNITS))
    found = re.fullmatch(rf"(.*?)(?:\s*[\[(](.*)[\])]|_({units}))?", str(name).lower().strip())
    return re.sub(r"[\W_]+", "", found[1]), found[2] or found[3] or ""
