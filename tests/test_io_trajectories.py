"""Paths of navigation software: the same drive in every form, and headings against the movement."""

import json
import re
import warnings

import numpy as np
import pandas as pd
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from mmqa_lab import io
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.rotations import rotations
from mmqa_lab.simulate import Scanner, System
from mmqa_lab.simulate.test_field import drive_test_field, make_test_field

ZONE = pyproj.CRS(25832)
N = 40
TIME = 302_400 + np.arange(N) / 2
TURN = np.radians(np.linspace(30, 80, N))
STEPS = 5 * np.column_stack([np.sin(TURN), np.cos(TURN), np.full(N, 0.01)])
PLACES = np.array([448_000.0, 5_411_000.0, 101.5]) + np.cumsum(STEPS, axis=0)
ANGLES = np.column_stack([np.full(N, 1.5), np.full(N, -0.75), np.degrees(TURN)])
DRIVE = np.column_stack([TIME, PLACES, ANGLES])


def degrees_north():
    """Longitude, latitude, and the headings from true north."""
    globe = pyproj.Transformer.from_crs(ZONE, 4326, always_xy=True).transform(*PLACES[:, :2].T)
    turn = pyproj.Proj(ZONE).get_factors(*globe).meridian_convergence
    return *globe, ANGLES[:, 2] + turn


def write_sbet(path):
    """Write the drive as SBET, with a wander angle."""
    longitude, latitude, heading = degrees_north()
    rows = np.zeros((N, 17))
    rows[:, 0], rows[:, 3] = TIME, PLACES[:, 2]
    rows[:, [1, 2, 7, 8]] = np.radians(np.column_stack([latitude, longitude, ANGLES[:, :2]]))
    rows[:, 10] = 0.3
    rows[:, 9] = np.radians(heading) + 0.3
    rows.tofile(path)


def write_pospac(path):
    """Write the drive as POSPac does."""
    head = "POSPac export\nProject: a street of 2025\n\n TIME, DISTANCE, EASTING, NORTHING, "
    head += "ELLIPSOID HEIGHT, ROLL, PITCH, HEADING\n (time in Sec, distance in Meters)\n\n"
    rows = [f"{r[0]:.4f} 0.000 " + " ".join(f"{v:.6f}" for v in r[1:]) + "\n" for r in DRIVE]
    path.write_text(head + "".join(rows))


def write_explorer(path):
    """Write the drive as Inertial Explorer does: latitudes, a row of units."""
    longitude, latitude, heading = degrees_north()
    columns = [TIME, latitude, longitude, PLACES[:, 2], ANGLES[:, 0], ANGLES[:, 1], heading]
    head = "Project: street\nDatum: ETRS89\nGPSTime Latitude Longitude H-Ell Roll Pitch Heading\n"
    head += "(sec) (deg) (deg) (m) (deg) (deg) (deg)\n"
    rows = [" ".join(f"{v:.11f}" for v in row) + "\n" for row in np.column_stack(columns)]
    path.write_text(head + "".join(rows))


def body(path):
    """The drive's rotations of a body with x forwards, as quaternions x, y, z, w."""
    right, front, up = np.moveaxis(rotations(*np.radians(ANGLES).T), 2, 0)
    return Rotation.from_matrix(np.stack([front, -right, up], axis=2)).as_quat()


def write_tum(path):
    """Write the drive as TUM."""
    np.savetxt(path, np.column_stack([TIME, PLACES, body(path)]), fmt="%.12f")


def write_euroc(path):
    """Write the drive as EuRoC, in nanoseconds."""
    names = [*(f"p_RS_R_{axis} [m]" for axis in "xyz"), *(f"q_RS_{axis} []" for axis in "wxyz")]
    table = pd.DataFrame(np.column_stack([PLACES, body(path)[:, [3, 0, 1, 2]]]), columns=names)
    table.insert(0, "#timestamp [ns]", (TIME * 1e9).astype(np.int64))
    table.to_csv(path, index=False)


@pytest.mark.parametrize(("write", "name"), [
    (write_sbet, "sbet.out"), (write_pospac, "p.txt"), (write_explorer, "e.txt"),
    (write_tum, "t.txt"), (write_euroc, "data.csv"),
])  # fmt: skip
def test_a_drive_is_the_same_in_every_form(tmp_path, write, name):
    write(tmp_path / name)
    with warnings.catch_warnings(action="ignore"):
        found = io.read_trajectory(tmp_path / name, crs=ZONE)
    np.testing.assert_allclose(found, DRIVE, rtol=0, atol=2e-5)


@pytest.mark.parametrize("write", [write_sbet, write_explorer])
def test_latitudes_need_a_projected_cloud(tmp_path, write):
    write(tmp_path / "p.sbet" if write is write_sbet else tmp_path / "p.txt")
    (file,) = tmp_path.iterdir()
    with warnings.catch_warnings(action="ignore"):
        for crs in (None, pyproj.CRS(4326)):
            with pytest.raises(ValueError, match="Must be beside a projected cloud"):
                io.read_trajectory(file, crs=crs)
    (tmp_path / "cut.out").write_bytes(file.read_bytes()[:-9])
    with pytest.raises(ValueError, match="SBET of 136 bytes a record"):
        io.read_trajectory(tmp_path / "cut.out", crs=ZONE)


def changed(path, **columns):
    """The drive as CSV with other columns."""
    names = ["time", "x", "y", "z", "roll", "pitch", "heading"]
    pd.DataFrame(DRIVE, columns=names).assign(**columns).to_csv(path, index=False)
    return path


HEADINGS = {
    "angles from east, anticlockwise": 90 - ANGLES[:, 2],
    "directions against the movement": ANGLES[:, 2] + 180,
    "radians": TURN,
}


@pytest.mark.parametrize("reading", [*HEADINGS])
@pytest.mark.parametrize("turn", [0, 125])
def test_headings_of_another_reading_are_refused_by_its_name(tmp_path, reading, turn):
    """Also of a drive in another direction, where headings from east lie elsewhere."""
    cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    x, y = (PLACES - PLACES[0])[:, :2].T
    turned = {"x": x * cos + y * sin, "y": y * cos - x * sin}
    heading = ANGLES[:, 2] + turn
    given = {"radians": np.radians(heading), "angles from east, anticlockwise": 90 - heading}
    given = given.get(reading, heading + 180)
    with pytest.raises(
        ValueError, match=f"headings lie .* off the movement, and look like {reading}"
    ):
        io.read_trajectory(changed(tmp_path / "p.csv", heading=given, **turned))


@pytest.mark.parametrize("off", [-1.62, 0.5, 1.62, 10])
def test_headings_a_little_off_the_movement_are_said_from_one_degree(tmp_path, off):
    file = changed(tmp_path / "p.csv", heading=ANGLES[:, 2] + off)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        io.read_trajectory(file)
    assert bool(told) == (abs(off) > 1)
    assert all("off the movement" in str(one.message) for one in told)


@pytest.mark.parametrize(("columns", "part"), [
    ({"time": np.arange(N) * 500 + 302_400_000}, "times that look like ms"),
    ({"time": np.arange(N) * 500_000_000 + 1_741_169_700_000_000_000}, "as of ns or us"),
    (dict(zip("xyz", 1000 * PLACES.T, strict=True)), "as in mm"),
    (dict(zip("xy", degrees_north()[:2], strict=True)), "it looks like degrees"),
    ({"time": (86_390 + np.arange(N) / 2) % 86_400}, "the day ends within it"),
])  # fmt: skip
def test_paths_in_other_units_are_refused(tmp_path, columns, part):
    with pytest.raises(ValueError, match=part):
        io.read_trajectory(changed(tmp_path / "p.csv", **columns))


ADJUSTED = 2300 * 604_800 - 1e9  # the week of the drive, in adjusted standard time
UNIX = 2300 * 604_800 + 315_964_800  # in Unix time that counts no leap seconds


@pytest.mark.parametrize(("path", "cloud", "shift", "words"), [
    (TIME, TIME, 0, ""),
    (TIME, TIME + ADJUSTED, ADJUSTED, "seconds of the GPS week"),
    (TIME + ADJUSTED, TIME, -ADJUSTED, "adjusted GPS time"),
    (TIME + ADJUSTED + 1e9, TIME, -ADJUSTED - 1e9, "GPS time since 1980"),
    (TIME + ADJUSTED + 1e9, TIME + ADJUSTED, -1e9, "GPS time since 1980"),
    (TIME - 18 + UNIX, TIME + ADJUSTED, ADJUSTED + 18 - UNIX, "Unix time in UTC"),
    (TIME - 259_200, TIME, 259_200, "seconds of the day in GPS time"),
    ((604_790 + TIME - 302_400) % 604_800, TIME + 302_390 + ADJUSTED, ADJUSTED, "the GPS week"),
    ((86_390 + TIME - 302_400) % 86_400, TIME + 43_190, 3 * 86_400, "the day in GPS time"),
])  # fmt: skip
def test_times_of_a_path_are_brought_to_those_of_its_cloud(tmp_path, path, cloud, shift, words):
    """Also over the ends of a week and of a day; the cloud lies within the path."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = io.read_trajectory(changed(tmp_path / "p.csv", time=path), times=cloud[2:-2])
    assert np.allclose(np.diff(found["time_s"]), 0.5)
    assert found["time_s"].iloc[0] == pytest.approx(path[0] + shift, abs=1e-3)
    assert np.allclose(found[["easting_m", "northing_m"]], PLACES[:, :2], atol=1e-3)
    assert any(words in str(one.message) for one in told) == bool(words)


def test_times_of_two_readings_or_of_another_drive_are_refused(tmp_path):
    day = changed(tmp_path / "day.csv", time=np.linspace(43_200, 43_400, N), z=0)
    with pytest.raises(ValueError, match=r"may be seconds of the day in GPS time or .* in UTC"):
        io.read_trajectory(day, times=[302_400 + 50, 302_400 + 60])
    unix = changed(tmp_path / "unix.csv", time=np.linspace(0, 200, N) + TIME[0] + UNIX)
    with pytest.raises(ValueError, match="may be Unix time in GPS seconds or Unix time in UTC"):
        io.read_trajectory(unix, times=TIME[:2] + ADJUSTED + 50)
    other = changed(tmp_path / "other.csv", time=np.arange(N))
    with pytest.raises(ValueError, match=r"0 to 39 s, the cloud's are 100 to 130\. Must be around"):
        io.read_trajectory(other, times=[100, 130])


def test_an_sbet_with_its_las_calibrates_a_head(tmp_path, capsys):
    """Two drives: LAS in adjusted standard time, SBET in seconds of the week and in degrees."""
    tilt = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.4, 0.3)}
    system = System("one", (Scanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **tilt),))
    street, zone = make_test_field(length_m=40, seed=1), pyproj.CRS(25835)
    to = pyproj.Transformer.from_crs(zone, 4326, always_xy=True)
    drives = drive_test_field(street, system, seed=4, pulses_per_s=20_000)
    for number, (cloud, path) in enumerate(drives):
        since = np.linspace(0, path.duration_s, 400)
        states = path.states(since)
        places = states[:, :3] + path.origin
        globe = to.transform(*places[:, :2].T)
        rows = np.zeros((len(since), 17))
        rows[:, 0], rows[:, 3], rows[:, 10] = TIME[0] + path.time[0] + since, places[:, 2], 0.2
        rows[:, 2], rows[:, 1] = np.radians(globe)
        rows[:, 7:10] = states[:, 3:]
        rows[:, 9] += 0.2 + np.radians(pyproj.Proj(zone).get_factors(*globe).meridian_convergence)
        rows.tofile(tmp_path / f"{number}.out")
        times = TIME[0] + cloud["gps_time"] + ADJUSTED
        timed = Cloud(cloud.points, {"gps_time": times}, crs=zone)
        io.write_cloud(tmp_path / f"{number}.las", timed, scale=0.0001)
    street.poles.to_csv(tmp_path / "poles.csv", index=False)
    clouds, paths = ([str(tmp_path / f"{n}.{end}") for n in (0, 1)] for end in ("las", "out"))
    arm = ",".join(map(str, system.assumed_lever_arms[0]))
    given = ["calibrate", *clouds, "--trajectory", *paths, "--lever-arm", arm, "--json"]
    assert main([*given, "--poles", str(tmp_path / "poles.csv")]) == 0
    said = capsys.readouterr()
    found = pd.DataFrame(json.loads(said.out))
    assert found["value"][:3].to_numpy() == pytest.approx([0, 0.4, 0.3], abs=0.002)
    assert "seconds of the GPS week" in found["remarks"][0]


def test_a_path_in_kilometres_is_said(tmp_path):
    time = np.arange(0, 20, 0.5)
    rows = np.column_stack([time, 448 + 0.008 * time, 5411 + 0 * time, 0.1 + 0 * time])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,x,y,z", comments="")
    with pytest.warns(UserWarning, match=r"moves at 0\.008 m/s: are its coordinates in metres"):
        io.read_trajectory(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("roll", "pitch", "words"),
    [
        (180.0, 1.0, "middle roll of .* is 180 degrees: the vehicle would lie over"),
        (0.5, -90.0, "middle pitch of .* is 90 degrees"),
        (359.5, 1.0, ""),  # counted from 0 to 360
        (30.0, -20.0, ""),
    ],
)
def test_a_vehicle_on_its_back_is_said(tmp_path, roll, pitch, words):
    east = np.arange(20.0)
    rows = {"time_s": east, "easting_m": 5 * east, "northing_m": 0.0, "height_m": 2.0}
    rows |= {"roll_deg": roll, "pitch_deg": pitch, "heading_deg": 90.0}
    pd.DataFrame(rows).to_csv(tmp_path / "p.csv", index=False)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        table = io.read_trajectory(tmp_path / "p.csv")
    said = " ".join(str(one.message) for one in told)
    assert re.search(words, said) if words else not said
    assert table["roll_deg"].tolist() == [roll] * 20


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("$GPGGA,120000.00,4848.0,N,00818.0,E,4,12,0.8,115.0,M,48.0,M,,*5C", "NMEA sentences"),
        ('<?xml version="1.0"?>\n<gpx><trk></trk></gpx>', "a GPX track"),
        ("<kml></kml>", "an XML file"),
        ("<html></html>", "a web page"),
    ],
)
def test_paths_that_are_not_read_are_named(tmp_path, content, words):
    (tmp_path / "p.txt").write_text(f"{content}\n" * 3)
    with pytest.raises(
        ValueError, match=rf"Invalid trajectory .*p\.txt: {words}\. Must be another"
    ):
        io.read_trajectory(tmp_path / "p.txt")
