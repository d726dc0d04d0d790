"""The test site of a tender and the drives past it: read, found, and checked against the rules.

A drive is a folder with a ``trajectory.csv`` (Pfeifer et al. 2021, section 4.1).
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_crs, check_file, check_points, check_positive
from mmqa_lab.chart_image import read_layout
from mmqa_lab.chart_image.geometry import four_corners
from mmqa_lab.chart_image.rules import ALONG, PLACE, board_frame, board_view, check_drive
from mmqa_lab.io import read_trajectory
from mmqa_lab.io.tables import first_sentence

NEAR_SITE_M = 100.0
"""A drive that stays farther away from all boards belongs to another site."""

SHORTEST_M = 10.0
"""A path that passes a pair of boards and tells its speed."""

RULES = {"oblique_distance_m": 10.0, "speed_kmh": 40.0}
"""Of section 4.1, where the site's file does not say otherwise."""


@dataclass(frozen=True, eq=False)
class Site:
    """The test site: its boards with ``board``, ``kind``, ``corners`` and ``layout``, its rules."""

    boards: pd.DataFrame
    distances_m: tuple
    oblique_m: float
    speed_kmh: float
    crs: object
    control: np.ndarray
    files: tuple
    note: str


@dataclass(frozen=True, eq=False)
class Drive:
    """One delivered drive: its files, its path, and what the rules say of it."""

    system: str
    name: str
    folder: Path
    path: pd.DataFrame
    distance_m: float
    checks: pd.DataFrame


def read_site(path):
    """Return the site that a JSON file describes.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or a field is missing or wrong.
    """
    path = check_file(path, "site")
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
        rows = [_board(board, path) for board in whole["boards"]]
        distances = [check_positive(d, "distance", unit="m") for d in whole["distances_m"]]
        control = np.array(whole.get("control_points") or np.empty((0, 3)))
        check_points(control, name="control_points", minimum=0)
        rules = [check_positive(whole.get(name, usual), name) for name, usual in RULES.items()]
        crs = check_crs(whole["crs"]) if whole.get("crs") else None
    except KeyError as error:
        raise ValueError(f"Invalid site {path}: no field {error}. Must have one.") from None
    except (ValueError, TypeError, AttributeError) as error:
        reason = first_sentence(error)
        raise ValueError(f"Invalid site {path}: {reason}. Must be a site as JSON.") from None
    boards = pd.DataFrame(rows)
    if boards.empty or boards["board"].duplicated().any() or not distances:
        raise ValueError(
            f"Invalid site {path}: boards, distances_m. Must have one or more, and boards each "
            "its own name."
        )
    layouts = [path.parent / one["layout"] for one in whole["boards"] if "layout" in one]
    files = (path, *(file for file in layouts if file.is_file()))
    note = str(whole.get("note", ""))
    return Site(boards, tuple(sorted(distances)), *rules, crs, control, files, note)


def find_drives(folder, site, done):
    """The drives in a folder: each has a trajectory that passes the site."""
    drives = []
    for file in sorted(folder.rglob("trajectory.csv")):
        parts = file.parent.relative_to(folder).parts
        system = parts[0] if len(parts) > 1 else folder.resolve().name
        name = "/".join(parts) or folder.resolve().name
        try:
            drive = _drive(system, name, file, site, done)
        except (ValueError, OSError) as error:
            done.say(name, error)
            continue
        same = [d.name for d in drives if (d.system, d.distance_m) == (system, drive.distance_m)]
        if same:
            done.say(name, f"It is {drive.distance_m:g} m beside the boards, as {same[0]} is.")
        else:
            drives.append(drive)
    if not drives and not done.problems:
        done.say(str(folder), "It has no trajectory.csv.")
    return drives


def sha256(path):
    """The SHA-256 of a file, read piece by piece."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def doubt(drive, view):
    """Which verdicts a drive against the rules cannot bear: it makes figures better or worse."""
    broken = drive.checks[~drive.checks["passed"]].set_index("quantity")
    better, worse = "speed_kmh" in broken.index, False
    if view == ALONG and "distance_m" in broken.index:
        row = broken.loc["distance_m"]
        better |= row["low"] < row["at_least"]
        worse |= row["high"] > row["at_most"]
    return {"too_good": bool(better), "too_bad": bool(worse)}


def _board(board, path):
    """A row of the site's boards, checked."""
    kind = board["kind"]
    if kind not in ("image", "point"):
        raise ValueError(f"Invalid kind {kind!r} of board in {path}. Must be image or point.")
    source = board.get("layout", "grey")
    file = path.parent / source
    layout = read_layout(file if file.is_file() else source) if kind == "image" else None
    name, corners = str(board["board"]), four_corners(np.array(board["corners"], float), columns=3)
    if corners[:2, 2].sum() >= corners[2:, 2].sum():
        raise ValueError(f"corners of {name!r}: must begin lower left, then lower right")
    return {"board": name, "kind": kind, "corners": corners, "layout": layout}


def _drive(system, name, file, site, done):
    """A drive whose distance, speed and attitude are compared with the rules."""
    path = read_trajectory(file)
    done.files.append(file)
    length = np.linalg.norm(np.ptp(path[PLACE], axis=0))
    if length < SHORTEST_M:
        raise ValueError(f"The drive is {length:.1f} m long. Must be {SHORTEST_M:g} m or more.")
    along = _along(site, path)
    middle, right, normal = board_frame(along)
    away = path[PLACE].to_numpy() - middle
    nearest = np.linalg.norm(away, axis=1).min()
    if nearest > NEAR_SITE_M:
        raise ValueError(
            f"The drive stays {nearest:.0f} m away from the boards: is it of another site?"
        )
    # where it passes the board
    beside = float((away @ normal)[np.argmin(np.abs(away @ right))])
    if beside < 0:
        raise ValueError(f"The drive passes {-beside:.1f} m behind the boards. Must pass in front.")
    distance = min(site.distances_m, key=lambda one: abs(one - beside))
    checks = check_drive(path, along, distance=distance, speed_kmh=site.speed_kmh)
    for row in checks[~checks["passed"]].itertuples():
        done.say(name, _broken_rule(row))
    return Drive(system, name, file.parent, path, distance, checks)


def _along(site, path):
    """Corners of a board that stands along a drive."""
    for board in site.boards.itertuples():
        if board_view(board.corners, path) == ALONG:
            return board.corners
    raise ValueError("No board stands along the drive: its distance cannot be checked.")


def _broken_rule(row):
    """What a drive did against a rule."""
    name, unit = row.quantity.rsplit("_", 1)
    unit = {"kmh": "km/h", "deg": "degrees"}.get(unit, unit)
    limits = f"at least {row.at_least:g}"
    if np.isfinite(row.at_most):
        limits = f"between {row.at_least:g} and {row.at_most:g}"
    what = name.replace("_", " ").capitalize()
    return f"{what} was {row.low:.2f} to {row.high:.2f} {unit}; must be {limits}."
