"""The test site of Pfeifer et al. 2021, driven past twice by each of three systems.

Sections 4.1 and 4.3: six boards on a line, drives 5 m and 10 m beside it at 40 km/h or faster,
panoramas and clouds of systems A, B and C. :func:`write_site` writes what a tender would receive: a
folder for each system and drive with trajectory, oriented images and LAZ. The paper prints neither
how often images are taken nor exposure, noise, errors of the navigation and heights: these are
assumptions, named below.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from mmqa_lab import charts
from mmqa_lab.chart_image.geometry import ChartMap, PanoramaCamera, Pose
from mmqa_lab.chart_image.legibility import CHECK_LIST, JUDGED
from mmqa_lab.chart_image.rules import blind_name, chart_site, choose_images
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_atomically, write_cloud
from mmqa_lab.simulate.cameras import Optics, Sensor, photograph
from mmqa_lab.simulate.scan import MatchingCamera, match
from mmqa_lab.simulate.scenes import Scene
from mmqa_lab.simulate.surfaces import chart
from mmqa_lab.simulate.systems import DISTANCES, SYSTEM_A, SYSTEM_B, SYSTEM_C, scan_chart
from mmqa_lab.simulate.trajectories import (
    NavigationErrors,
    Trajectory,
    measured,
    straight,
    with_speed_variation,
)

CRS = "EPSG:31256"

ORIGIN = np.array([2600.0, 341_200.0, 171.0])
"""Of the site in Vienna's coordinates; the line of boards runs north from here."""

HEIGHT_M = 2.0
"""Of boards, cameras and scanners above the ground; not printed."""

CONTROL = ORIGIN + [[3.0, north, height] for north in (0, 10, 20) for height in (0.0, 3.0)]
"""Control points, which the paper's site has too; places and number are not printed."""

CONTROL_SIGMA_M = 0.003
"""By which a control point is misread in a cloud."""

BEFORE_M, AFTER_M = 30.0, 50.0
"""A drive begins and ends so far from the first pair of boards."""

STATION_STEP_M = 3.0
"""Between images; not printed."""

OBLIQUE_M = 10.0
"""Least distance of the forward and the backward image (section 4.1)."""

NAVIGATION = NavigationErrors(drift_m=(0.01, 0.01, 0.01), drift_deg=(0.005, 0.005, 0.01))

EXPOSURE_S = 0.0005

SPEED_KMH, WANDER = 44.0, 0.01
"""Of a drive, and the share by which its speed wanders."""

SPREAD_PX = 0.8
"""Point spread that explains most widths of Table 1 (study chart_images)."""

SUPERSAMPLING = 4

SENSOR = Sensor(noise=0.01, bayer=True, gamma="srgb", bits=8, jpeg_quality=95)

LEGIBLE_PX = {"a": 11.0, "b": 9.0}
"""Pixels per capital from which a text has a mark: the simulated jury's rule. It gives all twelve
marks of Table 1."""

JUROR_SIGMA_PX = 0.15
"""By which simulated jurors differ; each gives all elements of a photograph one mark."""

JUDGED_NUMBERS = [k for k, (what, _, _) in enumerate(CHECK_LIST, start=1) if what in JUDGED]


@dataclass(frozen=True)
class Vehicle:
    """What a system carries: what its points come from, and the size of its panorama."""

    sensor: object
    megapixels: float

    @property
    def camera(self):
        """The panorama camera."""
        return PanoramaCamera.of_megapixels(self.megapixels)


VEHICLES = {
    "A": Vehicle(SYSTEM_A, 24),
    "B": Vehicle(SYSTEM_B, 250),
    "C": Vehicle(replace(SYSTEM_C, width_px=420, height_px=420), 30),
}
"""Section 4.3."""


@dataclass(frozen=True)
class Drive:
    """One pass: the path driven, the path that the navigation reports, and its images' places."""

    distance_m: float
    path: Trajectory
    reported: Trajectory
    stations: pd.DataFrame


def site_boards() -> pd.DataFrame:
    """The six boards with ``layout``: the targets of each imaging chart have their own numbers."""
    boards = chart_site(height=HEIGHT_M).rename(columns={"chart": "board"})
    boards["corners"] = [corners + ORIGIN for corners in boards["corners"]]
    numbers = boards.groupby("kind").cumcount()
    boards["layout"] = [
        charts.imaging_chart(first_marker=4 * k) if kind == "image" else charts.point_chart(seed=k)
        for k, kind in zip(numbers, boards["kind"], strict=True)
    ]
    return boards


def make_drive(distance_m, *, seed) -> Drive:
    """Drive north past the boards."""
    rng = np.random.default_rng([seed, int(distance_m)])
    start = ORIGIN + [-distance_m, -BEFORE_M + rng.uniform(-0.5, 0.5), HEIGHT_M]
    path = straight(BEFORE_M + AFTER_M, SPEED_KMH / 3.6, start=start)
    path = with_speed_variation(path, share=WANDER, seed=seed)
    reported = measured(path, NAVIGATION, seed=seed + int(distance_m))
    step = STATION_STEP_M * 3.6 / SPEED_KMH
    times = np.arange(rng.uniform(0, step), path.duration_s, step)
    return Drive(distance_m, path, reported, _table(reported, times))


def drive_cloud(vehicle, drive, boards, *, seed) -> Cloud:
    """The points that a drive lays on the point charts."""
    parts = []
    for number, board in enumerate(boards.query("kind == 'point'").itertuples()):
        front = np.cross(*np.diff(board.corners[:3], axis=0))
        heading = np.degrees(np.arctan2(front[0], front[1]))
        middle = board.corners.mean(axis=0)
        scene = Scene([chart(middle, heading=heading, layout=board.layout)])
        drawn = _drawn(seed, number, drive.distance_m)
        if isinstance(vehicle.sensor, MatchingCamera):
            parts.append(_matched(scene, vehicle.sensor, drive, middle, front, drawn))
        else:
            way = {"measured": drive.reported, "seed": drawn}
            parts.append(scan_chart(scene, vehicle.sensor, drive.path, board.corners, **way))
    cloud = Cloud.concatenate([part for part in parts if len(part)])
    order = np.argsort(cloud["gps_time"], kind="stable")
    columns = {name: cloud[name][order] for name in ("gps_time", "intensity")}
    return Cloud(cloud.points[order], columns, crs=CRS)


def station_map(vehicle, drive, time, board) -> ChartMap:
    """Where a board truly is in the panorama that was taken at a time."""
    position, turn = drive.path.at([time])
    pose = Pose(position[0], _camera_axes(turn[0]))
    return ChartMap.from_orientation(vehicle.camera, pose, board.corners, board.layout)


def take_photo(vehicle, drive, time, board, *, seed, sensor=SENSOR):
    """The panorama's part around a board: a :class:`mmqa_lab.simulate.cameras.Photo`."""
    position, turn = drive.path.at([time - EXPOSURE_S / 2, time + EXPOSURE_S / 2])
    travel = _camera_axes(turn.mean(axis=0)) @ (position[1] - position[0])
    there = station_map(vehicle, drive, time, board)
    choices = {"sensor": sensor, "margin": 40, "supersampling": SUPERSAMPLING, "seed": seed}
    return photograph(
        board.layout, there, optics=Optics(SPREAD_PX, travel=tuple(travel)), **choices
    )


def _camera_axes(turn):
    """Right, down and ahead of a vehicle as rows, from its rotation."""
    right, ahead, up = turn.T
    return np.stack([right, -up, ahead])


def photographed(drive, boards) -> pd.DataFrame:
    """Which board is photographed from which station: the one to choose, and the next nearer one.

    Forward and backward views come from the nearest drive; the paper does not print which.
    """
    rows = []
    for board in boards.query("kind == 'image'").itertuples():
        if drive.distance_m > min(DISTANCES) and board.view != "orthogonal":
            continue
        least = drive.distance_m if board.view == "orthogonal" else OBLIQUE_M
        found = choose_images(drive.stations, board.corners, distance=least).iloc[0]
        step = -1 if board.view == "backward" else 1
        rows += [(board.board, int(found["station"])), (board.board, int(found["station"]) + step)]
    return pd.DataFrame(rows, columns=["board", "station"])


def write_site(folder, *, systems="ABC", seed=1, images=True):
    """Write the site, its criteria, and what systems deliver, with the marks of a simulated jury.

    Parameters
    ----------
    folder : path
    systems : str
        Of A, B and C.
    seed : int
    images : bool
        Without them clouds and trajectories alone, which take a tenth of the time.
    """
    folder, boards = Path(folder), site_boards()
    _write_plan(folder, boards)
    marks = []
    for system in systems:
        for distance in DISTANCES:
            drive = make_drive(distance, seed=seed + 1000 * ord(system))
            place = folder / system / f"drive_{distance:02.0f}m"
            first, last = drive.reported.time[[0, -1]]
            times = np.append(np.arange(first, last, 0.05), last)
            write_atomically(place / "trajectory.csv", _table(drive.reported, times))
            _write_control(place, drive, seed)
            cloud = drive_cloud(VEHICLES[system], drive, boards, seed=seed)
            write_cloud(place / "cloud.laz", cloud, scale=0.0001)
            if images:
                marks += _write_images(place, VEHICLES[system], drive, boards, seed)
    if not images:
        return
    jury = [f"juror_{number}" for number in (1, 2, 3)]
    table = pd.DataFrame(marks, columns=["crop", *jury]).sort_values("crop")
    write_atomically(folder / "marks.csv", table)


def _drawn(*numbers):
    """A seed drawn by numbers."""
    return int(np.random.default_rng([int(number) for number in numbers]).integers(2**31))


def _matched(scene, camera, drive, middle, front, seed):
    """Points of one pair of images, aimed at a board's middle from its own side of it."""
    along = middle[1] + 1.5 * drive.distance_m * front[1] / np.linalg.norm(front)
    time = np.interp(along, drive.path.position[:, 1], drive.path.time)
    position = drive.path.at([time])[0][0]
    away = middle - position
    camera = replace(camera, heading_deg=float(np.degrees(np.arctan2(away[0], away[1]))))
    cloud = next(match(scene, camera, drive.path, times=[time], seed=seed))
    shift = drive.reported.at([time])[0][0] - position
    return Cloud(cloud.points + shift, cloud.columns)


def _table(path, times):
    """Time, place and attitude of a path at times, as trajectory files have them."""
    states = path.states(times - path.time[0])
    angles = np.degrees(states[:, 3:]).T
    return Trajectory(times, path.origin + states[:, :3], *angles).to_frame()


def _write_plan(folder, boards):
    """The files that the site's owner hands out: boards, control points, drives."""
    rows = []
    for board in boards.itertuples():
        file = f"charts/{board.board.replace(' ', '_')}.json"
        write_atomically(folder / file, board.layout.to_json())
        about = {"board": board.board, "kind": board.kind, "layout": file}
        rows.append(about | {"corners": board.corners.round(4).tolist()})
    site = {
        "note": "Clouds, photographs and marks of this delivery are simulated.",
        "crs": CRS,
        "distances_m": list(DISTANCES),
        "oblique_distance_m": OBLIQUE_M,
        "speed_kmh": 40.0,
        "boards": rows,
        "control_points": CONTROL.tolist(),
    }
    write_atomically(folder / "site.json", json.dumps(site, indent=1))


def _write_control(place, drive, seed):
    """Control points as read in a drive's cloud: off by what the navigation is where it passes."""
    rng = np.random.default_rng([seed, int(drive.distance_m)])
    times = np.interp(CONTROL[:, 1], drive.path.position[:, 1], drive.path.time)
    off = drive.reported.at(times)[0] - drive.path.at(times)[0]
    seen = CONTROL + off + CONTROL_SIGMA_M * rng.standard_normal(CONTROL.shape)
    table = pd.DataFrame(seen.round(4), columns=["easting_m", "northing_m", "height_m"])
    table.insert(0, "point", np.arange(1, len(table) + 1))
    write_atomically(place / "control.csv", table)


def _write_jpeg(file, image, camera):
    """An image whose EXIF says camera, date, aperture (section 4.1 asks for them) and exposure."""
    from PIL.ExifTags import IFD, Base
    from PIL.Image import Exif, fromarray

    exif = Exif()
    exif[Base.Make], exif[Base.Model] = "mmqa_lab", f"panorama, {camera.width} columns"
    taken = {Base.FNumber: 8.0, Base.DateTimeOriginal: "2021:01:12 10:00:00"}
    exif.get_ifd(IFD.Exif).update(taken | {Base.ExposureTime: EXPOSURE_S})
    options = {"quality": SENSOR.jpeg_quality, "exif": exif}
    image = fromarray(np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image)
    write_atomically(file, lambda path: image.save(path, "JPEG", **options))


def _write_images(place, vehicle, drive, boards, seed):
    """Images with their orientations; return the crops' names and marks."""
    rows, marks = [], []
    boards = boards.set_index("board", drop=False)
    for number, shot in enumerate(photographed(drive, boards).itertuples()):
        station, board = drive.stations.iloc[shot.station], boards.loc[shot.board]
        noise = _drawn(seed, number, drive.distance_m, vehicle.megapixels)
        photo = take_photo(vehicle, drive, station["time_s"], board, seed=noise)
        file = f"image_{shot.station:03d}_{number}.jpg"
        _write_jpeg(place / file, photo.image, vehicle.camera)
        window = {"first_column": photo.origin[0], "first_row": photo.origin[1]}
        rows.append({"file": file, **station, **window, "exposure_s": EXPOSURE_S})
        crop = blind_name(place / file, board["board"])
        given = _judged(photo, np.random.default_rng(noise))
        marks += [(f"{crop}_{number:02d}", *given) for number in JUDGED_NUMBERS]
    write_atomically(place / "images.csv", pd.DataFrame(rows))
    write_atomically(place / "camera.json", json.dumps({"width": vehicle.camera.width}))
    return marks


def _judged(photo, rng):
    """The marks of three simulated jurors for text of 40 mm."""
    pixels = 40 / photo.chart_map.pixel_sizes_mm([[500.0, 500.0]])[0, 1]
    jurors = pixels + JUROR_SIGMA_PX * rng.standard_normal(3)
    return np.select([jurors >= least for least in LEGIBLE_PX.values()], [*LEGIBLE_PX], "c")
