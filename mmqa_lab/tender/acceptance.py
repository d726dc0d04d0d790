"""The acceptance of drives past the test site: what is found, checked, evaluated and judged.

Pfeifer et al. 2021 (doi:10.3390/rs13020237), sections 3.3, 4.1 and 4.2. What cannot be judged has
its sentence and no value; nothing is guessed.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_same_crs
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.chart_image.rules import AHEAD, ALONG, BEHIND, PLACE, board_frame, board_view
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import CLOUD_ENDINGS
from mmqa_lab.io.clouds import iterate_cloud
from mmqa_lab.io.tables import read_table, with_numbers
from mmqa_lab.tender import COVERAGE, qualification, verdicts
from mmqa_lab.tender.photographs import image_rows
from mmqa_lab.tender.site import doubt, find_drives

AROUND_M = 0.5
"""Points so far beyond a board's corners are kept with it."""

PATH_REACH_M = 50.0
"""So far before and after the board a drive tells how its speed and its heights wander."""

DRAWS = 20
"""Other heights of the path that are tried."""

FIGURES = {
    "density": "density_per_m2",
    "sigma_mad": "sigma_mad_mm",
    "d1": "d1_mm",
    "d4": "d4_mm",
    "f": "f",
    "g": "g",
}
"""Figures of a cloud and the quantities that criteria name."""

VIEWS = (AHEAD, ALONG, BEHIND)

NO_PROOF = "The chart has no text of 60 mm: where that of 40 mm is not legible, it is not judged."


@dataclass(eq=False)
class Acceptance:
    """Everything that was found: figures, verdicts, and what could not be judged."""

    drives: list = field(default_factory=list)
    clouds: list = field(default_factory=list)
    photographs: list = field(default_factory=list)
    control: list = field(default_factory=list)
    results: pd.DataFrame = None
    verdicts: dict = field(default_factory=dict)
    summaries: dict = field(default_factory=dict)
    problems: list = field(default_factory=list)
    files: list = field(default_factory=list)

    def say(self, where, sentence):
        """Keep a sentence about what could not be judged, once."""
        row = {"where": where, "what": str(sentence)}
        if row not in self.problems:
            self.problems.append(row)


def accept(folder, site, criteria, *, marks=None, progress=list):
    """Judge all drives in a folder.

    Parameters
    ----------
    folder : path
    site : Site
    criteria : dict of DataFrame
        By name, as :func:`mmqa_lab.tender.verdicts` takes them.
    marks : DataFrame, optional
        Of :func:`read_marks`.
    progress : callable
        Takes a list of drives and gives them back one after the other.

    Returns
    -------
    Acceptance

    Raises
    ------
    ValueError
        If the folder has no drive past this site.
    """
    done = Acceptance()
    done.drives = find_drives(Path(folder), site, done)
    if not done.drives:
        said = "; ".join(problem["what"] for problem in done.problems)
        raise ValueError(f"Invalid folder {folder}: no drive past the site. {said}".strip())
    _say_missing_charts(site, done)
    rows = []
    for drive in progress(done.drives):
        rows += _cloud_rows(drive, site, done)
        rows += image_rows(drive, site, marks, done)
        done.control += _control_rows(drive, site, done)
    if marks is None:
        done.say("jury", "No marks of a jury: no text is judged. See mmqa accept --help.")
    elif done.photographs and not any(photo.found["mark"] for photo in done.photographs):
        done.say("jury", "No mark counts for these photographs: are they another delivery's?")
    rows = sorted(_with_gaps(rows, site, done), key=_place)
    done.results = pd.DataFrame(rows)
    for name, table in criteria.items():
        found = _doubted(verdicts(table, done.results), done.results)
        done.verdicts[name], done.summaries[name] = found, qualification(found)
        _say_unknown_figures(name, table, site, done)
        larger = found["quantity"].eq("legibility_60mm") & found["verdict"].eq("not measured")
        for system in found.loc[larger, "system"] if marks is not None else []:
            done.say(system, NO_PROOF)
    return done


def _say_missing_charts(site, done):
    """Say which charts of the paper's site this one lacks."""
    for kind, views in (("point", (ALONG,)), ("image", VIEWS)):
        corners = site.boards.loc[site.boards["kind"] == kind, "corners"]
        there = {board_view(one, done.drives[0].path) for one in corners}
        for view in views:
            if view not in there:
                done.say("site", f"It has no {kind} chart for the {view} view.")


def _say_unknown_figures(name, criteria, site, done):
    """Say which criteria ask for what no drive of this site can show."""
    for row in criteria.itertuples():
        quantity = str(row.quantity).replace("60mm", "40mm")  # as legible
        places = [place for figure, place, *_ in _expected(site) if figure == quantity]
        distance = getattr(row, "distance_m", np.nan)
        if not places or (pd.notna(distance) and float(distance) not in places):
            asked = "" if pd.isna(distance) else f" at {float(distance):g} m"
            done.say(f"criteria {name}", f"{row.criterion!r}: no figure {row.quantity!r}{asked}.")


def _doubted(table, results):
    """Verdicts, undecided where the drive was against the rules and may have caused them."""
    keys = ["system", "quantity", "distance_m", "view", "direction"]
    doubts = results[[*keys, "too_good", "too_bad"]].drop_duplicates(keys)
    doubts = table[keys].merge(doubts, how="left", on=keys).set_axis(table.index)
    good = doubts["too_good"].eq(True) & table["verdict"].isin(["met", "exempt"])
    bad = doubts["too_bad"].eq(True) & (table["verdict"] == "not met")
    return table.assign(verdict=table["verdict"].mask(good | bad, "undecided"))


def _cloud_rows(drive, site, done):
    """Figures of the point chart along the path; the other point charts only for the report."""
    boards = site.boards[site.boards["kind"] == "point"]
    points = _points_on(boards, drive, site, done)
    rows = []
    for board in boards.itertuples():
        view = board_view(board.corners, drive.path)
        if board.board not in points:
            if view == ALONG:
                done.say(drive.name, f"No points on the board {board.board!r}.")
            continue
        part, polygon = points[board.board], chart_polygon(board.corners)
        try:
            quality = evaluate_cloud(part, polygon=polygon)
        except ValueError as error:
            done.say(drive.name, f"Board {board.board!r}: {error}")
            continue
        middle, _, normal = board_frame(board.corners)
        offset = 1000 * float((quality.plane.centre - middle) @ normal)
        about = {"board": board.board, "view": view, "n": quality.n, "offset_mm": offset}
        done.clouds.append((drive, about, quality))
        if view == ALONG:
            by_path = _by_path(drive, part, polygon, quality, done)
            rows += _cloud_figures(drive, quality, by_path, part.resolution)
            for remark in quality.remarks:
                done.say(drive.name, f"Board {board.board!r}: {remark}")
    return rows


def _cloud_figures(drive, quality, by_path, step):
    """A row for each figure that criteria may name; intervals of the pattern and of the path.

    Distances are not known better than to half a step of the stored coordinates.
    """
    table = quality.intervals().set_index("figure")
    reach = by_path.reindex(table.index, fill_value=0.0)
    least = 500 * np.nan_to_num(step) * table.index.str.fullmatch(r"d\d")
    for end, sign in (("low", -1), ("high", 1)):
        away = np.hypot(table[end] - table["value"], reach)
        table[end] = np.maximum(table["value"] + sign * np.maximum(away, least), 0)
    place = {"system": drive.system, "distance_m": drive.distance_m, "view": "", "direction": ""}
    place |= doubt(drive, ALONG)
    return [
        {**place, "quantity": quantity, **table.loc[figure, ["value", "low", "high"]].to_dict()}
        for figure, quantity in FIGURES.items()
    ]


def _by_path(drive, cloud, polygon, quality, done):
    """How far each figure moves with speed and heights of the path, by 1.96 standard deviations.

    The points are shifted along the path to where a slightly faster and slower drive would have
    laid them, and the larger change counts; then up and down, as lines of each moment are where the
    path's heights wander otherwise. What one image pair gives at once stays as it is.
    """
    path, board = drive.path, polygon.mean(axis=0)
    if "gps_time" not in cloud:
        done.say(drive.name, "The cloud has no times: its intervals are without the path's part.")
        return pd.Series(dtype=float)
    time = cloud["gps_time"]
    if time.min() < path["time_s"].min() or time.max() > path["time_s"].max():
        done.say(drive.name, "The cloud's times are not the trajectory's: no part of the path.")
        return pd.Series(dtype=float)
    if time.min() == time.max():
        return pd.Series(dtype=float)
    at = np.column_stack([np.interp(time, path["time_s"], path[name]) for name in PLACE])
    faster = COVERAGE * speed_share(path, board) * (at - at.mean(axis=0))
    shifts = (faster, -faster, *_risings(path, board, time))
    moved = [_values(evaluate_cloud(cloud.points + s, polygon=polygon)) for s in shifts]
    away = pd.DataFrame(moved) - _values(quality)
    return np.hypot(away.iloc[:2].abs().max(), COVERAGE * np.sqrt((away.iloc[2:] ** 2).mean()))


def _values(quality):
    """Every figure of a cloud by its name."""
    return quality.intervals().set_index("figure")["value"]


def speed_share(path, board):
    """Standard deviation of the speed over lengths of a board (1 m), as a share of its mean."""
    pace = np.diff(_by_metres(path, board)["time_s"])
    return float(pace.std(ddof=1) / pace.mean())


def _by_metres(path, board):
    """A path at each metre around a board."""
    places = path[PLACE].to_numpy()
    travel = places[-1] - places[0]
    along = (places - board) @ (travel / np.linalg.norm(travel))
    along = np.maximum.accumulate(along)
    ends = max(along[0], -PATH_REACH_M), min(along[-1], PATH_REACH_M)
    metres = np.arange(*ends)
    return {name: np.interp(metres, along, path[name]) for name in ("time_s", PLACE[2])}


def _risings(path, board, time):
    """How far up points of each time lie if the heights of the path wander otherwise, metres.

    Drawn with the spectrum of the height's own steps (surrogate data); their mean, which slope and
    mounting share with slow errors, strays about its own as the slowest waves do.
    """
    time_s, height = _by_metres(path, board).values()
    waves = np.fft.rfft(np.diff(height))
    size = np.abs(waves) / np.sqrt(2)
    size[0] = np.sqrt(2) * size[1:4].mean()
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        drawn = size * (rng.standard_normal((2, len(size))).T @ [1, 1j])
        drawn[0] += waves[0]
        other = np.cumsum(np.fft.irfft(drawn, len(height) - 1))
        up = np.interp(time, time_s[1:], other - (height[1:] - height[0]))
        yield np.outer(up - up.mean(), [0, 0, 1])


def _control_rows(drive, site, done):
    """Differences of control points as seen in a drive's data from their survey, mm."""
    file = drive.folder / "control.csv"
    if not file.is_file():
        return []
    done.files.append(file)
    try:
        table = with_numbers(read_table(file, "control"), ["point", *PLACE], "control")
        numbers = table["point"].astype(int)
        if not numbers.between(1, len(site.control)).all():
            raise ValueError("no such point")
        away = table[PLACE].to_numpy() - site.control[numbers - 1]
    except ValueError:
        needed = f"point, 1 to {len(site.control)}, and {', '.join(PLACE)}"
        done.say(drive.name, f"Invalid control.csv. Must have {needed}, all numbers.")
        return []
    return [
        {"drive": drive.name, "control point": number, **dict(zip(PLACE, 1000 * row, strict=True))}
        for number, row in zip(numbers, away, strict=True)
    ]


def _points_on(boards, drive, site, done):
    """Points near each board, of all clouds of a drive that are in the site's coordinates."""
    parts = {}
    endings = {file for file in drive.folder.iterdir() if file.suffix.lower() in CLOUD_ENDINGS}
    for file in sorted(endings - set(drive.folder.glob("*.csv"))):
        done.files.append(file)
        try:
            found = _points_of(file, boards, site)
        except (ValueError, OSError) as error:
            done.say(f"{drive.name}/{file.name}", error)
            continue
        for name, cloud in found.items():
            parts.setdefault(name, []).append(cloud)
    return {name: Cloud.concatenate(clouds) for name, clouds in parts.items()}


def _points_of(file, boards, site):
    """Points near each board in one file; an error where it is in other coordinates."""
    parts, low, high = {}, np.full(3, np.inf), np.full(3, -np.inf)
    for cloud in iterate_cloud(file):
        check_same_crs("cloud", cloud.crs, "site", site.crs)
        low, high = np.fmin(low, cloud.points.min(axis=0)), np.fmax(high, cloud.points.max(axis=0))
        for board in boards.itertuples():
            near = board.corners.min(axis=0) - AROUND_M, board.corners.max(axis=0) + AROUND_M
            inside = ((cloud.points >= near[0]) & (cloud.points <= near[1])).all(axis=1)
            if inside.any():
                parts.setdefault(board.board, []).append(cloud[inside])
    if np.isinf(low).any():
        raise ValueError("The cloud has no points.")
    if not parts:
        extent = ", ".join(f"{a:.1f} to {b:.1f}" for a, b in zip(low, high, strict=True))
        raise ValueError(f"The cloud has no points on any board; it extends over {extent} m.")
    return {name: Cloud.concatenate(clouds) for name, clouds in parts.items()}


def _with_gaps(rows, site, done):
    """All rows, and one without a value for each figure that the test asks for and is missing."""
    known = {(r["system"], r["quantity"], r["distance_m"], r["view"], r["direction"]) for r in rows}
    blank = {"value": None, "too_good": False, "too_bad": False}
    blank |= dict.fromkeys(("low", "high", "sigma"), np.nan)
    systems = dict.fromkeys(drive.system for drive in done.drives)
    for system in systems:
        own = {drive.distance_m for drive in done.drives if drive.system == system}
        for distance in sorted(set(site.distances_m) - own):
            done.say(system, f"No drive {distance:g} m beside the boards.")
        for quantity, distance, view, direction in _expected(site):
            if (system, quantity, distance, view, direction) not in known:
                place = {"system": system, "quantity": quantity, "distance_m": distance}
                rows = [*rows, {**place, "view": view, "direction": direction, **blank}]
    return rows


def _place(row):
    """What figures are sorted by; those of one place stay in their order."""
    views = ("", *VIEWS)
    return row["system"], row["distance_m"], views.index(row["view"])


def _expected(site):
    """Quantity, distance, view and direction of every figure of Tables 1 and 2."""
    for distance in site.distances_m:
        yield from ((quantity, distance, "", "") for quantity in FIGURES.values())
    places = {(distance, ALONG) for distance in site.distances_m}
    places |= {(site.oblique_m, view) for view in VIEWS if view != ALONG}
    for distance, view in sorted(places):
        yield "legibility_40mm", distance, view, ""
        for direction in "hv":
            yield "pixel_mm", distance, view, direction
            yield "w_mm", distance, view, direction
