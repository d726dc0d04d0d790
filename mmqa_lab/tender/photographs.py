"""The photographs of a delivered drive: which image counts for which board, and what it says.

Pfeifer et al. 2021 (doi:10.3390/rs13020237), sections 3.2 and 4.1. ``images.csv`` says where and
when images were taken and how the camera was turned, ``camera.json`` which camera it was. Each file
is decoded once, whatever it shows.
"""

import json
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from mmqa_lab._checks import check_columns
from mmqa_lab.chart_image import evaluate_window, legibility, rules
from mmqa_lab.chart_image.geometry import ChartMap, FrameCamera, PanoramaCamera, Pose
from mmqa_lab.chart_image.placing import find_markers, locate
from mmqa_lab.charts import LinePairs, Marker
from mmqa_lab.io import read_grey
from mmqa_lab.io.images import decode, exif_number, image_size, image_tags, read_colours
from mmqa_lab.io.tables import first_sentence, read_table
from mmqa_lab.tender.site import Drive, doubt

IMAGE_ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff")

ANGLES = ["heading_deg", "pitch_deg", "roll_deg"]

ORIGIN = ("first_column", "first_row")
"""Of a file that is a part of its image."""

LIMIT_SHARE = 0.02
"""Share by which the width at which line pairs vanish is uncertain: in 216 ladders of simulated
photographs it was read within 2.3 % of what the same photograph without noise says."""

NEAR_SHARE = 0.15
"""Share of the distance by which targets alone may misplace a camera."""


JURORS = 3
"""Members of a jury (section 3.2)."""


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


def read_marks(path):
    """Return a jury's marks as ``juror``, ``element``, ``mark``.

    The file has ``crop`` and a column for each juror, or the three columns that the form of
    :mod:`mmqa_lab.widgets` writes. A crop is a photograph, or an element of it with its number in
    the check list. Empty cells are no marks.
    """
    table = read_table(path, "marks", dtype=str, keep_default_na=False)
    if "crop" in table:
        table = table.drop(columns="shows", errors="ignore")
        if list(table) == ["crop"]:
            raise ValueError(f"Invalid marks {path}: no jurors. Must have a column for each.")
        table = table.melt("crop", var_name="juror", value_name="mark")
        table = table.rename(columns={"crop": "element"})
    check_columns(table, ("juror", "element", "mark"), f"marks {path}")
    table["mark"] = table["mark"].str.strip().str.lower()
    table = table[table["mark"] != ""]
    rules.agreement(table)  # refuses other marks, and two of one juror
    for name in table["element"].unique():
        _listed(name)
    return table


def _listed(crop):
    """The photograph of a crop, and its element of the check list; none where it is all of it."""
    photo, _, number = crop.partition("_")
    if not number:
        return photo, ""
    if not (number.isdigit() and 0 < int(number) <= len(legibility.CHECK_LIST)):
        raise ValueError(
            f"Invalid crop {crop!r}: element {number}. Must be 1 to {len(legibility.CHECK_LIST)}."
        )
    return photo, legibility.CHECK_LIST[int(number) - 1][0]


def image_rows(drive, site, marks, done):
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
    rows = []
    for file, choices in groupby(sorted(chosen, key=_file_of), key=_file_of):
        photos = _photographs(drive, file, list(choices), camera, gamma, done)
        for photo in photos:
            rows += _image_figures(photo, marks, done)
        done.photographs += photos
    return rows


def _file_of(choice):
    """What choices are sorted by."""
    return str(choice["file"])


def _photographs(drive, file, choices, camera, gamma, done):
    """All boards that one file is to show."""
    try:
        grey = read_grey(file)
    except (ValueError, OSError) as error:
        done.say(drive.name, error)
        return []
    done.files.append(Path(file))
    photos = []
    for choice in choices:
        board, row = choice["board"].board, choice["found"]
        try:
            quality = _evaluated(grey, choice, camera, gamma)
        except ValueError as error:
            done.say(drive.name, f"Board {board!r}: {error}")
            continue
        row["shift_mm"] = _shift(choice, quality)
        about = (board, row["view"], choice["distance"], choice["file"], row)
        photos.append(Photograph(drive, *about, quality))
    return photos


def _wanted(drive, site, done):
    """Boards that a drive is to show, with the distance asked for.

    Forward and backward views count from the nearest drive of a system; which drive the paper took
    is not printed.
    """
    own = [one.distance_m for one in done.drives if one.system == drive.system]
    wanted = []
    for board in site.boards[site.boards["kind"] == "image"].itertuples():
        view = rules.board_view(board.corners, drive.path)
        if view == rules.ALONG:
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
        return _readable(pd.DataFrame({"file": [file.name for file in listed]}), drive, done)
    done.files.append(table)
    try:
        images = read_table(table, "list", ("file",), encoding_errors="replace")
    except ValueError as error:
        done.say(drive.name, error)
        return pd.DataFrame({"file": []})
    images = _readable(images, drive, done)
    if not set(rules.PLACE) <= set(images) and "time_s" in images:
        within = images["time_s"].between(*drive.path["time_s"].iloc[[0, -1]])
        if not within.all():
            done.say(drive.name, f"Images with times outside of the path's: {(~within).sum()}.")
        images = images[within].reset_index(drop=True)
        for name in rules.PLACE:
            images[name] = np.interp(images["time_s"], drive.path["time_s"], drive.path[name])
    return images


def _readable(images, drive, done):
    """The images that can be opened and whose columns are numbers, with their ``size``."""
    names = [name for name in (*rules.PLACE, *ANGLES, "time_s", *ORIGIN) if name in images]
    images[names] = images[names].apply(pd.to_numeric, errors="coerce")
    images["size"] = [_size(drive, str(file), done) for file in images["file"]]
    known = images[names].notna().all(axis=1)
    for file in images.loc[~known, "file"]:
        done.say(drive.name, f"Image {file}: a number is missing in images.csv. Must have all.")
    return images[known & images["size"].notna()].reset_index(drop=True)


def _size(drive, file, done):
    """Columns and rows of an image; None where it cannot be opened."""
    try:
        return image_size(drive.folder / file)
    except (ValueError, OSError) as error:
        done.say(f"{drive.name}/{file}", error)
        return None


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
        reason = first_sentence(error)
        done.say(drive.name, f"Invalid camera.json: {reason}. Must describe the camera.")
        return None, "srgb"


def _chosen(drive, images, wanted, camera, done):
    """For each wanted board the image that the rules ask for, and where the board is in it."""
    oriented = camera is not None and set(rules.PLACE + ANGLES) <= set(images)
    maps = {}
    if oriented:
        maps = {board.board: _predicted(images, board, camera, drive) for board, _ in wanted}
    elif not set(rules.PLACE) <= set(images):
        images, maps = _searched(drive, images, wanted, camera, done)
    chosen = []
    for board, distance in wanted:
        shown = maps.get(board.board, dict.fromkeys(images.index))
        found = _nearest(drive, images, board, distance, shown)
        if found["station"] is None:
            how = "" if oriented else ", as far as its targets can be found"
            done.say(drive.name, _nothing_shown(board, found["view"], distance, shown, how))
            continue
        image = images.loc[found["station"]]
        origin = tuple(int(image.get(name, 0)) for name in ORIGIN)
        place = {"file": drive.folder / image["file"], "origin": origin}
        place |= {"map": shown[found["station"]], "distance": distance, "board": board}
        chosen.append(place | {"found": found.to_dict()})
    return chosen


def _nearest(drive, images, board, distance, shown):
    """The image that the rules choose among those that show a board."""
    ends = drive.path[rules.PLACE].iloc[[0, -1]].set_axis(["first", "last"])
    stations = pd.concat([ends[:1], images.reindex(columns=rules.PLACE), ends[1:]])
    among = stations.index.isin(list(shown)) & stations.notna().all(axis=1)
    return rules.choose_images(stations, board.corners, distance=distance, among=among).iloc[0]


def _nothing_shown(board, view, distance, shown, how):
    """Why no image counts for a board."""
    if not shown:
        return f"No image shows the board {board.board!r}{how}."
    rule = "from its front" if view == rules.ALONG else f"from {distance:g} m or farther"
    return f"Images that may show the board {board.board!r}: {len(shown)}, none of them {rule}."


def _predicted(images, board, camera, drive):
    """Maps of a board in the images whose pixels it lies in, by row."""
    maps = {}
    for index, image in images.iterrows():
        try:
            pose = Pose.of_angles(image[rules.PLACE].to_numpy(float), *image[ANGLES])
            there = ChartMap.from_orientation(camera, pose, board.corners, board.layout)
        except ValueError:  # behind the camera
            continue
        there = there.within(image.get("first_column", 0), image.get("first_row", 0))
        pixels = there.outline(board.layout.corners())
        if ((pixels > -0.5) & (pixels < np.array(image["size"]) - 0.5)).all():
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
    images = images.assign(**dict.fromkeys(rules.PLACE, np.nan))
    for index, image in images.iterrows():
        origin = tuple(int(image.get(name, 0)) for name in ORIGIN)
        try:
            grey = read_grey(drive.folder / image["file"])
        except (ValueError, OSError) as error:
            done.say(f"{drive.name}/{image['file']}", error)
            continue
        grey, top = _level(grey, camera, origin[1])
        try:
            found = find_markers(grey, [board.layout for board, _ in wanted])
        except ValueError:  # no board in this image
            continue
        for board, _ in wanted:
            there = _located(grey, found, board.layout, camera, (origin[0], origin[1] + top))
            if there is not None:
                there = maps[board.board][index] = there.within(0, -top)
                images.loc[index, rules.PLACE] = _camera_place(there, board)
    return images, maps


def _level(grey, camera, first):
    """The rows of a panorama within 45 degrees of the horizon, where boards are, and their first.

    ``first``: the row of the panorama at which the image begins.
    """
    if not isinstance(camera, PanoramaCamera):
        return grey, 0
    top, end = np.clip(np.array([1, 3]) * camera.height // 4 - first, 0, len(grey))
    return grey[top:end], int(top)


def _located(grey, found, layout, camera, origin):
    """The map of a chart around those of its targets that were found; None where it has none."""
    own = [one for one in layout.of_kind(Marker) if one.identifier in found]
    if not own:
        return None
    seen = np.stack([found[one.identifier] for one in own])
    reach = layout.width * np.ptp(seen, axis=1).max() / own[0].width
    first = np.maximum(seen.min(axis=(0, 1)) - reach, 0).astype(int)
    last = (seen.max(axis=(0, 1)) + reach).astype(int)
    window = np.ascontiguousarray(grey[first[1] : last[1], first[0] : last[0]])
    try:
        there = locate(window, layout, camera=camera, offset=tuple(first + origin))
    except ValueError:
        return None
    return there.within(*-first)


def _same_targets(boards):
    """A sentence where coded targets cannot tell two boards apart."""
    owners = {}
    for board in boards:
        for marker in board.layout.of_kind(Marker):
            other = owners.setdefault((marker.dictionary, marker.identifier), board.board)
            if other != board.board:
                return (
                    f"Boards {other!r} and {board.board!r} have the same targets: images "
                    "without orientation cannot tell them apart."
                )
    return ""


def _camera_place(there, board):
    """Where the camera stands in the world, from the map of a board of known size and place."""
    layout = board.layout
    places = layout.corners() - [layout.width / 2, layout.height / 2]
    rays = np.column_stack([layout.corners(), np.ones(4)]) @ there.matrix.T
    turn = Rotation.align_vectors([[0, 0, 1]], rays.mean(axis=0)[None])[0]
    rays = turn.apply(rays)
    solid, flat = np.column_stack([places / 1000, np.zeros(4)]), rays[:, :2] / rays[:, 2:]
    # a rigid board: the tilt that a few targets leave open does not change its distance
    _, turned, away = cv2.solvePnP(solid, flat, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE)
    local = -Rotation.from_rotvec(turned.ravel()).inv().apply(away.ravel())
    centre, right, normal = rules.board_frame(board.corners)
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
    if camera is not None:
        _check_board(there, choice)
    return evaluate_window(grey, layout, there, gamma=gamma)


def _shift(choice, quality):
    """How far right of and above the place that survey and orientation give a board is seen, mm."""
    if choice["map"] is None or choice["map"].source != "orientation":
        return None
    layout = quality.layout
    middle = np.array([[layout.width / 2, layout.height / 2]])
    seen = quality.chart_map.pixels(middle) + quality.origin
    right, down = (seen - choice["map"].pixels(middle))[0]
    across, upright = quality.chart_map.pixel_sizes_mm(middle)[0]
    return right * across, -down * upright


def _check_board(there, choice):
    """Raise where targets are seen from elsewhere than they should be: those of another board."""
    board, expected = choice["board"], choice["found"]["distance_m"]
    seen = np.linalg.norm(_camera_place(there, board) - board.corners.mean(axis=0))
    if abs(seen / expected - 1) > NEAR_SHARE:
        raise ValueError(
            f"Invalid place of the chart: its targets are seen from {seen:.1f} m. Must be seen "
            f"from {expected:.1f} m; are they another board's?"
        )


def _image_figures(photo, marks, done):
    """Rows of pixel size, line pairs and legibility of one photograph."""
    drive, quality = photo.drive, photo.quality
    place = {"system": drive.system, "distance_m": photo.distance_m, "view": photo.view}
    place |= doubt(drive, photo.view)
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
    ladder.append(float("inf"))  # coarser than the chart's coarsest pattern
    found = quality.resolution(direction)
    width = float(np.nan_to_num(found.width_mm, nan=np.inf))
    limit = width if np.isnan(found.limit_mm) else found.limit_mm
    shares = (1 - LIMIT_SHARE, 1 + LIMIT_SHARE)
    low, high = (next(rung for rung in ladder if rung >= share * limit) for share in shares)
    low = min(low, width, float(np.nextafter(ladder[-2], np.inf)))
    return {"value": found.width_mm, "low": low, "high": max(high, width)}


def _legibility(photo, place, marks, done):
    """The jury's mark of a photograph; text of 60 mm is as legible where that of 40 mm is."""
    crop = rules.blind_name(photo.file, photo.board)
    pixels = photo.quality.pixel_size("v")[0]
    photo.found.update(crop=crop, cap_px=legibility.TEXT_MM / pixels, mark="", marks="", because="")
    rows = {"value": None, "low": np.nan, "high": np.nan}
    if marks is not None:
        rows |= _jury(photo, marks, done)
    place = {**place, "direction": ""}
    texts = [{**place, "quantity": "legibility_40mm", **rows}]
    larger = rows if rows["high"] < rules.MARKS.index("c") else dict.fromkeys(rows)
    if photo.view == rules.ALONG:
        texts.append({**place, "quantity": "legibility_60mm", **larger})
    return texts


def _jury(photo, marks, done):
    """Mark of the majority, and the range of the jurors; of elements the worst that counts."""
    crop = photo.found["crop"]
    listed = [_listed(name) for name in marks["element"]]
    own = marks.assign(element=[element for _, element in listed])
    own = own[np.array([name == crop for name, _ in listed], dtype=bool)]
    own = own[own["element"].isin(["", *legibility.JUDGED])]
    if own.empty:
        done.say(photo.drive.name, f"Board {photo.board!r}: the jury did not mark crop {crop}.")
        return {}
    if (own["element"] == "").any():
        own = own[own["element"] == ""]
        mark, because = rules.agreement(own).verdict["mark"].item(), ""
    else:
        mark, because = legibility.photo_marks(own.assign(photo=crop)).loc[0, ["mark", "because"]]
    jurors = sorted(own.groupby("juror")["mark"].max())
    fewest = own.groupby("element")["juror"].nunique().min()
    if fewest < JURORS:
        few = f"Crop {crop}: an element has {fewest} of {JURORS} jurors' marks."
        done.say(photo.drive.name, few)
    photo.found.update(mark=mark or "", marks="".join(jurors), because=because)
    if mark is None:
        where = f" of {because!r}" if because else ""
        done.say(photo.drive.name, f"Crop {crop}: the jury has no majority{where}, or left it out.")
        return {}
    ranks = [rules.MARKS.index(one) for one in (*jurors, mark)]
    return {"value": mark, "low": float(min(ranks)), "high": float(max(ranks))}


def exif_texts(file):
    """Camera, date, aperture and exposure as the EXIF of an image says them; empty where not."""
    tags = image_tags(file)
    camera = " ".join(filter(None, (tags.get("Make", ""), tags.get("Model", ""))))
    date = tags.get("DateTimeOriginal", tags.get("DateTime", ""))
    texts = {"camera": camera, "date": date}
    for name, tag in (("f-number", "FNumber"), ("exposure (s)", "ExposureTime")):
        number = exif_number(tags.get(tag, ""))
        texts[name] = "" if number is None else f"{number:g}"
    return texts


def fringes(photo, gamma="srgb"):
    """Colours of the line pairs at the limit of resolution, by direction; empty of a grey file."""
    quality = photo.quality
    last = np.add(quality.origin, quality.image.shape[::-1])
    colours = read_colours(photo.file, quality.origin, last)
    if colours is None:
        return {}
    values = decode(colours.astype(np.float32) / np.iinfo(colours.dtype).max, gamma)
    table = legibility.colour_fringes(values, quality.layout, quality.chart_map)
    found = {}
    for direction, part in table.groupby("direction"):
        width = quality.resolution(direction).width_mm
        finer = part[part["width_mm"] <= (np.inf if np.isnan(width) else width)]
        found[direction] = finer.nlargest(1, "width_mm")["fringe"].iloc[0]
    return found
