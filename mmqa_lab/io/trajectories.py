"""Paths of vehicles, as navigation software and people write them."""

from __future__ import annotations

import os
import re
import warnings

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_columns, check_file, coordinate_columns, listed, refuse
from mmqa_lab.io.path_doubts import (
    DAY_S,
    WEEK_S,
    check_headings,
    check_scales,
    check_upright,
    matched_times,
)
from mmqa_lab.io.systems import named_system
from mmqa_lab.io.tables import text_table, with_numbers

__all__ = ["SBET_ENDINGS", "path_table", "read_trajectory"]

# Columns of a vehicle's path, and other names of them without blanks; the first that is there.
PATH_COLUMNS = ["time_s", "easting_m", "northing_m", "height_m"]
PATH_NAMES = {
    "time_s": ("gpstime", "time", "t", "timestamp", "gpsseconds", "secondsofweek", "sow"),
    "roll_deg": ("roll",),
    "pitch_deg": ("pitch",),
    "heading_deg": ("heading", "yaw"),
}
GLOBE_NAMES = {"longitude": ("longitude", "lon", "long"), "latitude": ("latitude", "lat")}
ELLIPSOID_NAMES = ("ellipsoidheight", "ellipsoidalheight", "hell", "ellheight")

# Seconds and degrees in units that columns of a path name.
PATH_UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
PATH_UNITS |= {"deg": 1.0, "degrees": 1.0, "°": 1.0, "gon": 0.9}
PATH_UNITS |= dict.fromkeys(("rad", "radians"), 180 / np.pi)

PATH_HEADER = "time in seconds; easting, northing, height in metres"
PATH_ORDER = [*PATH_COLUMNS, *[*PATH_NAMES][1:]]

# A record of an SBET file: 17 doubles, the 12th and later of which are rates.
SBET_ENDINGS, SBET_DOUBLES = (".out", ".sbet"), 17

# Rotations of TUM and EuRoC.
QUATERNION = ["qx", "qy", "qz", "qw"]


def read_trajectory(
    path: str | os.PathLike, *, crs: object = None, times: ArrayLike | None = None
) -> pd.DataFrame:
    """Read a vehicle's path.

    Parameters
    ----------
    path : path
        A CSV or text file with a header, as POSPac and Inertial Explorer write it, too: time in
        seconds, easting, northing and height in metres, or latitude and longitude in degrees, under
        any usual name; roll, pitch and heading in degrees are read when present. Lines above the
        header are passed over, a row of units below it is heeded. Or an SBET file (``.out``,
        ``.sbet``), TUM or EuRoC; in the last two the x axis of the body points forwards, z upwards.
    crs : pyproj.CRS, optional
        Of the cloud: latitude and longitude are projected to it, and headings turned from true
        north to the north of its grid. Heights stay.
    times : array_like, optional
        Of the cloud's points, s: seconds of the GPS week or of a day, adjusted and plain GPS time
        and Unix time are told apart, and brought to the cloud's.

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
        If a needed column is missing, a value is no finite number, a time repeats, latitudes have
        no system to go to, headings lie 45 degrees off the movement or are radians, gon or counted
        from east, the speed is none of a vehicle in metres and seconds, or its times may be two
        kinds of seconds or do not lie around the cloud's.

    Warns
    -----
    UserWarning
        If headings lie a degree or more off the movement, if the vehicle would lie over, of what
        seconds the times are taken for, and of what is not read.

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
    what, raw = f"trajectory {path}", path_table(path)
    what += " (SBET)" if str(path).lower().endswith(SBET_ENDINGS) else ""
    used = coordinate_columns(raw.columns)
    table = raw[used].set_axis(PATH_COLUMNS[1 : 1 + len(used)], axis=1)
    plain = {_name_and_unit(column): column for column in reversed(raw.columns)}
    for name, spellings in (PATH_NAMES | GLOBE_NAMES).items():
        for key in [key for one in spellings for key in plain if key[0] == one][:1]:
            odd = key[1] not in PATH_UNITS
            refuse(odd, what, f"column {plain[key]!r}", "in s or degrees")
            used = [*used, plain[key]]
            unit = "seconds" if name == "time_s" else "degrees"
            numbers = with_numbers(raw, used[-1:], what, wanted=unit)[plain[key]]
            table[name] = numbers * PATH_UNITS[key[1]]
    if {*GLOBE_NAMES} <= {*table} and not {*PATH_COLUMNS[1:3]} <= {*table}:
        high = next((one for one in raw if _plain_height(one)), None)
        check_columns(raw, ["height"] if high is None else [], what)
        table["height_m"] = raw[high]
        table = _projected(with_numbers(table, [*table], what), crs, what)
    if not {*PATH_COLUMNS} <= {*table}:
        found = f"columns {listed(raw.columns)}"
        raise ValueError(f"Invalid {what} with {found}. Must have {PATH_HEADER}.")
    if {*QUATERNION} <= {*raw}:
        table = table.assign(**_attitude(with_numbers(raw, QUATERNION, what)))
        used = [*used, *QUATERNION]
    table = with_numbers(table, table.columns, what)
    unread = listed(raw.columns.drop(used))
    absent = [name.partition("_")[0] for name in [*PATH_NAMES][1:] if name not in table]
    if unread and absent:
        warnings.warn(f"No {', '.join(absent)} in {what}: not read are {unread}.", stacklevel=2)
    if times is not None:
        table["time_s"] = matched_times(table["time_s"].to_numpy(), np.asarray(times), what)
    back = table["time_s"].diff().min()
    wrapped = back < -WEEK_S / 2
    midnight = -DAY_S - 1 < back < -DAY_S / 2 and table["time_s"].max() < DAY_S + 1
    refuse(midnight, what, "the day ends within it", "of one day, or in seconds of the week")
    table = table.sort_values("time_s", ignore_index=True)
    refuse((table["time_s"].diff() <= 0).any(), what, "a time repeats", "distinct times")
    late = table["time_s"] + WEEK_S * (wrapped & (table["time_s"] < WEEK_S / 2))
    driven = table.assign(time_s=late).sort_values("time_s", ignore_index=True)
    check_scales(driven, what)
    check_headings(driven, what)
    check_upright(driven, what)
    if wrapped:
        check_columns(table, ["heading_deg"], f"{what}, in which the GPS week ends")
        warnings.warn(f"The GPS week ends within {what}: its times are in two parts.", stacklevel=2)
    return table[[name for name in PATH_ORDER if name in table]]


def path_table(path: str | os.PathLike) -> pd.DataFrame:
    """Return the rows of a path as they stand in its file, with usual names."""
    file = check_file(path, "trajectory")
    if file.suffix.lower() in SBET_ENDINGS:
        return _sbet(file, f"trajectory {path}")
    return _named(text_table(path, "trajectory", header=PATH_HEADER))


def _sbet(file, what):
    """The records of an SBET file, angles in degrees, headings from true north."""
    raw = file.read_bytes()
    size = 8 * SBET_DOUBLES
    refuse(not raw or len(raw) % size, what, f"{len(raw)} bytes", f"SBET of {size} bytes a record")
    rows = np.frombuffer(raw, "<f8").reshape(-1, SBET_DOUBLES)
    globe = np.isfinite(rows).all() and (np.abs(rows[:, 1:3]) <= [np.pi / 2, np.pi]).all()
    refuse(not globe, what, "no latitudes and longitudes", "an SBET file")
    degrees = np.degrees(rows[:, [1, 2, 7, 8]])
    names = ["latitude", "longitude", "roll", "pitch"]
    heading = np.degrees(rows[:, 9] - rows[:, 10])  # the platform's, from the wander frame
    table = pd.DataFrame(degrees, columns=names)
    return table.assign(time=rows[:, 0], height=rows[:, 3], heading=heading)


def _named(table):
    """A table with the usual names for columns of TUM and EuRoC, and for heights above."""
    names = [_name_and_unit(column) for column in table]
    new = {}
    for column, (name, unit) in zip(table, names, strict=True):
        axis = re.fullmatch(r"(?:t|prsr)([xyz])|(q)(?:rs)?([wxyz])", name)
        if axis:
            new[column] = axis[1] or axis[2] + axis[3]
        elif name in ELLIPSOID_NAMES and unit in ("", "m"):
            new[column] = "height"
    return table.rename(columns=new)


def _plain_height(name):
    """Whether a column is named as heights are."""
    return len(coordinate_columns(["e", "n", name])) > 2


def _projected(table, crs, what):
    """A table whose latitudes and longitudes are eastings and northings of the cloud's system."""
    import pyproj

    found = "latitude and longitude, and the cloud names no coordinate system"
    refuse(crs is None or not crs.to_2d().is_projected, what, found, "beside a projected cloud")
    globe = table["longitude"].to_numpy(), table["latitude"].to_numpy()
    to = pyproj.Transformer.from_crs(named_system("OGC:CRS84", what), crs.to_2d(), always_xy=True)
    plan = np.array(to.transform(*globe))
    refuse(not np.isfinite(plan).all(), what, "places outside of its system", "where the cloud is")
    table = table.assign(easting_m=plan[0], northing_m=plan[1])
    if "heading_deg" in table:
        turn = pyproj.Proj(crs.to_2d()).get_factors(*globe).meridian_convergence
        table["heading_deg"] = (table["heading_deg"] - turn) % 360
    return table


def _attitude(table):
    """Roll, pitch and heading of rotations from a body with x forwards, z upwards."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_quat(table[QUATERNION].to_numpy()).as_matrix()
    front, left, up = np.moveaxis(turned, 2, 0)
    return {
        "roll_deg": np.degrees(np.arctan2(left[:, 2], up[:, 2])),
        "pitch_deg": np.degrees(np.arcsin(np.clip(front[:, 2], -1, 1))),
        "heading_deg": np.degrees(np.arctan2(front[:, 0], front[:, 1])) % 360,
    }


def _name_and_unit(name):
    """A column's name in small letters and digits, and the unit behind it."""
    units = "|".join(filter(None, PATH_UNITS))
    found = re.fullmatch(rf"(.*?)(?:\s*[\[(](.*)[\])]|_({units}))?", str(name).lower().strip())
    return re.sub(r"[\W_]+", "", found[1]), found[2] or found[3] or ""
