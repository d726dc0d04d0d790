"""Paths of navigation software: the same drive in every form, and headings against the movement."""

import warnings

import numpy as np
import pandas as pd
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from mmqa_lab import io
from mmqa_lab.rotations import rotations

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
