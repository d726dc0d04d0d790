"""The acceptance of drives past the test site: what is found, checked, evaluated and judged.

Pfeifer et al. 2021 (doi:10.3390/rs13020237), sections 3.2, 3.3, 4.1 and 4.2. A drive is a folder
with a ``trajectory.csv``, clouds and images; ``images.csv`` says where and when images were taken
and how the camera was turned, ``camera.json`` which camera it was. What cannot be judged has its
sentence and no value; nothing is guessed.
"""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_crs, check_positive
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.chart_image.evaluation import (
    evaluate_window,
    find_markers,
    locate,
    map_of_markers,
    read_layout,
)
from mmqa_lab.chart_image.geometry import (
    ChartMap,
    FrameCamera,
    PanoramaCamera,
    Pose,
    four_corners,
)
from mmqa_lab.chart_image.rules import (
    AHEAD,
    ALONG,
    BEHIND,
    MARKS,
    PLACE,
    agreement,
    blind_name,
    board_frame,
    board_view,
    check_drive,
    choose_images,
)
from mmqa_lab.charts import LinePairs, Marker
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import CLOUD_ENDINGS, read_grey, read_trajectory
from mmqa_lab.io.clouds import iterate_cloud
from mmqa_lab.io.images import image_size
from mmqa_lab.tender.criteria import qualification, verdicts

IMAGE_ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")

ANGLES = ["heading_deg", "pitch_deg", "roll_deg"]

AROUND_M = 0.5
"""Points so far beyond a board's corners are kept with it."""

NEAR_SITE_M = 100.0
"""A drive that stays farther away from all boards belongs to another site."""

LIMIT_SHARE = 0.08
"""Share by which the width at which line pairs vanish is uncertain."""

CAP_MM = 40.0

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


@dataclass(frozen=True, eq=False)
class Site:
    """The test site: its boards with ``board``, ``kind``, ``corners`` and ``layout``, its rules."""

    boards: pd.DataFrame
    distances_m: tuple
    oblique_m: float
    speed_kmh: float
    crs: object
    control: tuple
    files: tuple


@dataclass(frozen=True, eq=False)
class Drive:
    """One delivered drive: its files, its path, and what the rules say of it."""

    system: str
    name: str
    folder: Path
    path: pd.DataFrame
    distance_m: float
    checks: pd.DataFrame


@dataclass(frozen=True, eq=False)
class Photograph:
    """A board in an image: where, how far, and what was measured."""

    drive: Drive
    board: str
    view: str
    distance_m: float
    file: Path
    found: dict
    quality: object


@dataclass(eq=False)
class Acceptance:
    """Everything that was found: figures, verdicts, and what could not be judged."""

    drives: list = field(default_factory=list)
    clouds: list = field(default_factory=list)
    photographs: list = field(default_factory=list)
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
    rows = []
    for drive in progress(done.drives):
        rows += _cloud_rows(drive, site, done)
        rows += _image_rows(drive, site, marks, done)
    if marks is None:
        done.say("jury", "No marks of a jury: no text is judged. Give them with --marks.")
    done.results = pd.DataFrame(_with_gaps(rows, site, done))
    for name, table in criteria.items():
        found = _doubted(verdicts(table, done.results), done.results)
        done.verdicts[name], done.summaries[name] = found, qualification(found)
    return done


def read_site(path):
    """Return the site that a JSON file describes.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or a field is missing or wrong.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid site {path}: no such file. Must exist.")
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
        rows = [_board(board, path) for board in whole["boards"]]
        distances = [check_positive(d, "distance", unit="m") for d in whole["distances_m"]]
        control = tuple(np.array(place, dtype=float) for place in whole.get("control_points", []))
        rules = [float(whole.get(name, usual)) for name, usual in RULES.items()]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f"Invalid site {path}: {error}. Must have all fields.") from None
    boards = pd.DataFrame(rows)
    if boards.empty or boards["board"].duplicated().any():
        raise ValueError(f"Invalid site {path}: boards must have names, each its own.")
    crs = check_crs(whole["crs"]) if whole.get("crs") else None
    layouts = [path.parent / one["layout"] for one in whole["boards"] if "layout" in one]
    files = (path, *(file for file in layouts if file.is_file()))
    return Site(boards, tuple(sorted(distances)), *rules, crs, control, files)


RULES = {"oblique_distance_m": 10.0, "speed_kmh": 40.0}
"""Of section 4.1, where the site's file does not say otherwise."""


def read_marks(path):
    """Return a jury's marks as ``juror``, ``element``, ``mark``.

    The file has ``crop`` and a column for each juror, or the three columns that the form of
    :mod:`mmqa_lab.widgets` writes. Empty cells are no marks.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Invalid marks {path}: no such file. Must exist.")
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    if "crop" in table:
        table = table.melt("crop", var_name="juror", value_name="mark")
        table = table.rename(columns={"crop": "element"})
    missing = {"juror", "element", "mark"} - set(table)
    if missing:
        raise ValueError(f"Invalid marks {path}: no column {sorted(missing)[0]!r}. Must have one.")
    table = table[table["mark"].str.strip() != ""]
    agreement(table)  # refuses other marks, and two of one juror
    return table


def find_drives(folder, site, done):
    """The drives in a folder: each has a trajectory that passes the site."""
    drives = []
    for file in sorted(folder.rglob("trajectory.csv")):
        parts = file.parent.relative_to(folder).parts
        system = parts[0] if len(parts) > 1 else folder.resolve().name
        name = "/".join(parts) or folder.resolve().name
        try:
            drives.append(_drive(system, name, file, site, done))
        except (ValueError, OSError) as error:
            done.say(name, error)
    if not drives and not done.problems:
        done.say(str(folder), "It has no trajectory.csv.")
    return drives


def sha256(path):
    """The SHA-256 of a file, read piece by piece."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _board(board, path):
    """A row of the site's boards, checked."""
    kind = board["kind"]
    if kind not in ("image", "point"):
        raise ValueError(f"Invalid kind {kind!r} of board in {path}. Must be image or point.")
    source = board.get("layout", "grey")
    file = path.parent / source
    layout = read_layout(file if file.is_file() else source) if kind == "image" else None
    corners = four_corners(board["corners"], columns=3)
    return {"board": str(board["board"]), "kind": kind, "corners": corners, "layout": layout}


def _drive(system, name, file, site, done):
    """A drive whose distance, speed and attitude are compared with the rules."""
    path = read_trajectory(file)
    done.files.append(file)
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


def _doubt(drive, view):
    """Which verdicts a drive against the rules cannot bear: it makes figures better or worse."""
    broken = drive.checks[~drive.checks["passed"]].set_index("quantity")
    better, worse = "speed_kmh" in broken.index, False
    if view == ALONG and "distance_m" in broken.index:
        row = broken.loc["distance_m"]
        better |= row["low"] < row["at_least"]
        worse |= row["high"] > row["at_most"]
    return {"too_good": bool(better), "too_bad": bool(worse)}


def _doubted(table, results):
    """Verdicts, undecided where the drive was against the rules and may have caused them."""
    keys = ["system", "quantity", "distance_m", "view", "direction"]
    doubts = results[[*keys, "too_good", "too_bad"]].drop_duplicates(keys)
    doubts = table[keys].merge(doubts, how="left", on=keys).set_axis(table.index)
    good = doubts["too_good"].eq(True) & table["verdict"].isin(["met", "exempt"])
    bad = doubts["too_bad"].eq(True) & (table["verdict"] == "not met")
    return table.assign(verdict=table["verdict"].mask(good | bad, "undecided"))


# --- clouds


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
        try:
            quality = evaluate_cloud(points[board.board], polygon=chart_polygon(board.corners))
        except ValueError as error:
            done.say(drive.name, f"Board {board.board!r}: {error}")
            continue
        middle, _, normal = board_frame(board.corners)
        offset = 1000 * float((quality.plane.centre - middle) @ normal)
        about = {"board": board.board, "view": view, "n": quality.n, "offset_mm": offset}
        done.clouds.append((drive, about, quality))
        for remark in quality.remarks:
            done.say(drive.name, f"Board {board.board!r}: {remark}")
        if view == ALONG:
            rows += _cloud_figures(drive, quality)
    return rows


def _cloud_figures(drive, quality):
    """A row for each figure that criteria may name."""
    table = quality.intervals().set_index("figure")
    place = {"system": drive.system, "distance_m": drive.distance_m, "view": "", "direction": ""}
    place |= _doubt(drive, ALONG)
    return [
        {**place, "quantity": quantity, **table.loc[figure, ["value", "low", "high"]].to_dict()}
        for figure, quantity in FIGURES.items()
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
    for cloud in iterate_cloud(file, columns=()):
        if None not in (cloud.crs, site.crs) and not _same_crs(cloud.crs, site.crs):
            raise ValueError(f"The cloud is in {cloud.crs.name}, the site in {site.crs.name}.")
        low, high = np.fmin(low, cloud.points.min(axis=0)), np.fmax(high, cloud.points.max(axis=0))
        for board in boards.itertuples():
            near = board.corners.min(axis=0) - AROUND_M, board.corners.max(axis=0) + AROUND_M
            inside = ((cloud.points >= near[0]) & (cloud.points <= near[1])).all(axis=1)
            if inside.any():
                parts.setdefault(board.board, []).append(cloud[inside])
    if not parts:
        extent = ", ".join(f"{a:.1f} to {b:.1f}" for a, b in zip(low, high, strict=True))
        raise ValueError(f"The cloud has no points on any board; it extends over {extent} m.")
    return {name: Cloud.concatenate(clouds) for name, clouds in parts.items()}


def _same_crs(one, other):
    """Whether two coordinate systems have the same plan, whatever they say of heights."""
    plans = [crs.sub_crs_list[0] if crs.is_compound else crs for crs in (one, other)]
    return plans[0].equals(plans[1], ignore_axis_order=True)


# --- images


def _image_rows(drive, site, marks, done):
    """Figures of the imaging charts that this drive is to show."""
    wanted = _wanted(drive, site, done)
    images = _images(drive, done)
    if not wanted:
        return []
    if images.empty:
        done.say(drive.name, "There are no images.")
        return []
    camera, gamma = _camera(drive, done)
    chosen = _chosen(drive, images, wanted, camera, done)
    rows, file, grey = [], None, None
    for choice in sorted(chosen, key=lambda one: (str(one["file"]), one["board"].board)):
        try:
            if choice["file"] != file:  # decoded once, whatever it shows
                file, grey = choice["file"], None
                grey = read_grey(file)
                done.files.append(file)
            if grey is None:
                continue
            quality = _evaluated(grey, choice, camera, gamma)
        except (ValueError, OSError) as error:
            done.say(drive.name, f"Board {choice['board'].board!r}: {error}")
            continue
        board, row = choice["board"].board, choice["found"]
        photo = Photograph(drive, board, row["view"], choice["distance"], file, row, quality)
        done.photographs.append(photo)
        rows += _image_figures(photo, marks, done)
    return rows


def _wanted(drive, site, done):
    """Boards that a drive is to show, with the distance asked for.

    Forward and backward views count from the nearest drive of a system; which drive the paper took
    is not printed.
    """
    own = [one.distance_m for one in done.drives if one.system == drive.system]
    wanted = []
    for board in site.boards[site.boards["kind"] == "image"].itertuples():
        view = board_view(board.corners, drive.path)
        if view == ALONG:
            wanted.append((board, drive.distance_m))
        elif drive.distance_m == min(own):
            wanted.append((board, site.oblique_m))
    return wanted


def _images(drive, done):
    """Images of a drive with what is known of them; their places from the path where needed."""
    table, listed = (
        drive.folder / "images.csv",
        [file for file in sorted(drive.folder.iterdir()) if file.suffix.lower() in IMAGE_ENDINGS],
    )
    if not table.is_file():
        if listed:
            done.say(drive.name, "No images.csv: boards are looked for by their coded targets.")
        return pd.DataFrame({"file": [file.name for file in listed]})
    done.files.append(table)
    images = pd.read_csv(table)
    if "file" not in images:
        done.say(drive.name, "Invalid images.csv: no column 'file'. Must have one.")
        return pd.DataFrame({"file": []})
    there = [(drive.folder / str(file)).is_file() for file in images["file"]]
    for file in images.loc[~np.array(there, dtype=bool), "file"]:
        done.say(drive.name, f"Image {file}: no such file.")
    images = images[there].reset_index(drop=True)
    if not set(PLACE) <= set(images) and "time_s" in images:
        for name in PLACE:
            images[name] = np.interp(images["time_s"], drive.path["time_s"], drive.path[name])
    return images


def _camera(drive, done):
    """The camera of a drive's images, None where it is not described, and their gamma."""
    file = drive.folder / "camera.json"
    if not file.is_file():
        return None, "srgb"
    done.files.append(file)
    try:
        fields = json.loads(file.read_text(encoding="utf-8"))
        gamma = fields.pop("gamma", "srgb")
        return (FrameCamera if "focal_px" in fields else PanoramaCamera)(**fields), gamma
    except (ValueError, TypeError, AttributeError) as error:
        done.say(drive.name, f"Invalid camera.json: {error}")
        return None, "srgb"


def _chosen(drive, images, wanted, camera, done):
    """For each wanted board the image that the rules ask for, and where the board is in it."""
    oriented = camera is not None and set(PLACE + ANGLES) <= set(images)
    maps = {}
    if oriented:
        maps = {board.board: _predicted(images, board, camera, drive) for board, _ in wanted}
    elif not set(PLACE) <= set(images):
        images, maps = _searched(drive, images, wanted, camera, done)
    chosen = []
    for board, distance in wanted:
        shown = maps.get(board.board, dict.fromkeys(images.index))
        found = _nearest(drive, images, board, distance, shown)
        if found["station"] is None:
            done.say(drive.name, _nothing_shown(board, found["view"], distance, shown))
            continue
        image = images.loc[found["station"]]
        origin = tuple(int(image.get(name, 0)) for name in ("first_column", "first_row"))
        place = {"file": drive.folder / image["file"], "origin": origin}
        place |= {"map": shown[found["station"]], "distance": distance, "board": board}
        chosen.append(place | {"found": found.to_dict()})
    return chosen


def _nearest(drive, images, board, distance, shown):
    """The image that the rules choose among those that show a board."""
    ends = drive.path[PLACE].iloc[[0, -1]].set_axis(["first", "last"])
    stations = pd.concat([ends[:1], images.reindex(columns=PLACE), ends[1:]])
    among = stations.index.isin(list(shown)) & stations.notna().all(axis=1)
    return choose_images(stations, board.corners, distance=distance, among=among).iloc[0]


def _nothing_shown(board, view, distance, shown):
    """Why no image counts for a board."""
    if not shown:
        return f"No image shows the board {board.board!r}."
    rule = "from its front" if view == ALONG else f"from {distance:g} m or farther"
    return f"None of the {len(shown)} images that may show the board {board.board!r} is {rule}."


def _predicted(images, board, camera, drive):
    """Maps of a board in the images whose pixels it lies in, by row."""
    maps = {}
    for index, image in images.iterrows():
        pose = Pose.of_angles(image[PLACE].to_numpy(float), *image[ANGLES])
        try:
            there = ChartMap.from_orientation(camera, pose, board.corners, board.layout)
            size = image_size(drive.folder / image["file"])
        except (ValueError, OSError):  # behind the camera, or no image: the others count
            continue
        there = there.within(image.get("first_column", 0), image.get("first_row", 0))
        pixels = there.outline(board.layout.corners())
        if ((pixels > -0.5) & (pixels < np.array(size) - 0.5)).all():
            maps[index] = there
    return maps


def _searched(drive, images, wanted, camera, done):
    """Images without places: boards by their coded targets, the camera's place from the board."""
    maps = {board.board: {} for board, _ in wanted}
    if camera is None:
        done.say(drive.name, "No camera.json: images without orientation tell no distance.")
        return images.iloc[:0], maps
    same = _same_targets([board for board, _ in wanted])
    if same:
        done.say(drive.name, same)
        return images.iloc[:0], maps
    images = images.assign(**dict.fromkeys(PLACE, np.nan))
    for index, image in images.iterrows():
        origin = tuple(int(image.get(name, 0)) for name in ("first_column", "first_row"))
        try:
            grey = read_grey(drive.folder / image["file"])
            found = find_markers(grey, [board.layout for board, _ in wanted])
        except (ValueError, OSError) as error:
            done.say(f"{drive.name}/{image['file']}", error)
            continue
        for board, _ in wanted:
            bent = {"camera": camera, "offset": origin}
            try:
                there = map_of_markers(found, board.layout, **bent)
            except ValueError:  # not in this image
                continue
            maps[board.board][index] = there
            images.loc[index, PLACE] = _camera_place(there, board)
    return images, maps


def _same_targets(boards):
    """A sentence where coded targets cannot tell two boards apart."""
    owners = {}
    for board in boards:
        for marker in board.layout.of_kind(Marker):
            other = owners.setdefault((marker.dictionary, marker.identifier), board.board)
            if other != board.board:
                return (
                    f"Boards {other!r} and {board.board!r} have the same coded targets: images "
                    "without orientation cannot tell them apart."
                )
    return ""


def _camera_place(there, board):
    """Where the camera stands in the world, from the map of a board of known size and place."""
    scale = 2000 / np.linalg.norm(there.matrix[:, :2], axis=0).sum() / 1000
    matrix = scale * there.matrix
    middle = matrix @ [board.layout.width / 2, board.layout.height / 2, 1]
    across, up = (matrix[:, k] / np.linalg.norm(matrix[:, k]) for k in (0, 1))
    local = -np.array([middle @ across, middle @ up, middle @ np.cross(across, up)])
    centre, right, normal = board_frame(board.corners)
    return centre + local @ np.stack([right, np.cross(normal, right), normal])


def _evaluated(grey, choice, camera, gamma):
    """What one image of a board says; by its targets where the orientation is not good enough."""
    layout, there = choice["board"].layout, choice["map"]
    if there is not None:
        try:
            return evaluate_window(grey, layout, there, gamma=gamma)
        except ValueError:
            pass
    there = locate(grey, layout, camera=camera, offset=choice["origin"])
    return evaluate_window(grey, layout, there, gamma=gamma)


def _image_figures(photo, marks, done):
    """Rows of pixel size, line pairs and legibility of one photograph."""
    drive, quality = photo.drive, photo.quality
    place = {"system": drive.system, "distance_m": photo.distance_m, "view": photo.view}
    place |= _doubt(drive, photo.view)
    rows = []
    for direction in "hv":
        here = {**place, "direction": direction}
        size, sigma = quality.pixel_size(direction)
        rows.append({**here, "quantity": "pixel_mm", "value": size, "sigma": sigma})
        rows.append({**here, "quantity": "w_mm", **width_interval(quality, direction)})
    rows += _legibility(photo, place, marks, done)
    return rows


def width_interval(quality, direction):
    """The finest resolved width and its neighbours that a slightly other limit would give."""
    ladder = sorted({p.pair for p in quality.layout.of_kind(LinePairs) if p.direction == direction})
    found = quality.resolution(direction)
    width, limit = found.width_mm, found.limit_mm
    if np.isnan(width):  # coarser than the chart's coarsest pattern
        return {"value": np.nan, "low": float(np.nextafter(ladder[-1], np.inf)), "high": np.inf}
    limit = width if np.isnan(limit) else limit
    ends = [
        next((rung for rung in ladder if rung >= share * limit), np.inf)
        for share in (1 - LIMIT_SHARE, 1 + LIMIT_SHARE)
    ]
    return {"value": width, "low": min(ends[0], width), "high": max(ends[1], width)}


def _legibility(photo, place, marks, done):
    """The jury's mark of a photograph; text of 60 mm is as legible where that of 40 mm is."""
    crop = blind_name(photo.file, photo.board)
    photo.found["crop"] = crop
    pixels = photo.quality.pixel_size("v")[0]
    photo.found["cap_px"] = CAP_MM / pixels
    rows = {"value": None, "low": np.nan, "high": np.nan}
    given = [] if marks is None else marks.loc[marks["element"] == crop, "mark"].tolist()
    if marks is not None and not given:
        done.say(photo.drive.name, f"Board {photo.board!r}: the jury did not mark crop {crop}.")
    if given:
        ranks = sorted(MARKS.index(mark) for mark in given)
        mark = agreement(marks[marks["element"] == crop]).verdict["mark"].item()
        rows = {"value": mark, "low": float(ranks[0]), "high": float(ranks[-1])}
    photo.found.update(mark=rows["value"] or "", marks="".join(sorted(given)))
    place = {**place, "direction": ""}
    texts = [{**place, "quantity": "legibility_40mm", **rows}]
    larger = rows if rows["high"] < MARKS.index("c") else dict.fromkeys(rows)
    if photo.view == ALONG:
        texts.append({**place, "quantity": "legibility_60mm", **larger})
        if given and larger["value"] is None:
            done.say(photo.drive.name, "Text of 60 mm is not on the chart, and 40 mm is no proof.")
    return texts


def _with_gaps(rows, site, done):
    """All rows, and one without a value for each figure that the test asks for and is missing."""
    known = {(r["system"], r["quantity"], r["distance_m"], r["view"], r["direction"]) for r in rows}
    blank = {"value": None, "too_good": False, "too_bad": False}
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
