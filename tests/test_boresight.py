"""Boresight and lever arms recovered from simulated two-way drives."""


import numpy as np
import pandas as pd
import pytest

from mmqa_lab import io
from mmqa_lab.boresight import calibrate, corrected
from mmqa_lab.boresight.adjustment import Adjustment, Shots
from mmqa_lab.boresight.features import Feature, from_axis, pole_misfit
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import NavigationErrors, Scanner, System, straight
from mmqa_lab.simulate.testfield import drive_testfield, make_testfield
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    return make_testfield(length_m=48, seed=1)


@pytest.fixture(scope="module")
def drives(street):
    return drive_testfield(street, study.two_heads(NavigationErrors()), seed=4, pulses_per_s=80_000)


@pytest.fixture(scope="module")
def found(street, drives):
    control = street.ground(spacing_m=4.0, seed=2)
    lever = study.two_heads(NavigationErrors()).assumed_lever_arms
    known = {"poles": street.poles, "control": control, "path_std_m": 0}
    return calibrate(drives, lever_arms_m=lever, **known)


def test_mounting_is_recovered(found):
    truth = np.hstack([study.BORESIGHT_DEG, -np.array(study.LEVER_ARM_ERROR_M)])
    assert np.abs(found.values - truth)[:, :3].max() < 0.005
    assert np.abs(found.values - truth)[:, 3:].max() < 0.005
    assert found.planes > 100
    assert np.allclose(np.diag(found.correlation), 1)
    assert found.remarks == ""  # the paths are exact, as stated


def test_arcs_beyond_each_other_are_pushed_back():
    """Of a pole of 6 cm, each side moved by 5 cm along its beams: past the other one."""
    turn, height = np.radians(np.linspace(-60, 60, 41)), np.tile([0.0, 0.5, 1.0], 14)[:41]
    arc = 0.03 * np.column_stack([-np.cos(turn), np.sin(turn)]) + [0.05, 0]
    points = np.column_stack([np.vstack([arc, -arc]), np.tile(height, 2)])
    beams = np.repeat([[1.0, 0.0], [-1.0, 0.0]], 41, axis=0)
    misfit, way, _ = pole_misfit(points, 0.03, beams)
    assert ((way[:, :2] * beams).sum(axis=1) < 0).all()  # outwards is where each is seen from
    assert misfit[[20, 61]] == pytest.approx(-0.05, abs=0.001)


def test_range_noise_across_a_thin_pole_adds_no_distance(rng):
    turn = np.radians(rng.uniform(-70, 70, 200_000))
    arc = 0.03 * np.column_stack([-np.cos(turn), np.sin(turn)])
    arc[:, 0] += rng.normal(0, 0.005, len(arc))
    beams = np.tile([1.0, 0.0], (len(arc), 1))
    free = np.array([0.0, 0.0, 0.0, 0.0, 0.03])
    plain, told = (from_axis(np.c_[arc, turn], 0 * turn, free, beams, s)[0] for s in (0, 0.005))
    across = np.mean(np.sin(turn) ** 2) * 0.005**2 / 0.06
    assert plain.mean() == pytest.approx(across, abs=4e-5)
    assert abs(told.mean()) < 4e-5


def test_correction_takes_points_to_their_surfaces(found, street, drives):
    cloud, path = drives[0]
    road = [k for k, s in enumerate(street.scene.surfaces) if s.label == "road"]
    on_road = np.isin(cloud["surface"], road)
    before = cloud.points[on_road, 2] - street.origin[2]
    after = found.correct(cloud, path).points[on_road, 2] - street.origin[2]
    # 5 mm of range noise is what may be left
    assert np.sqrt(np.mean(after**2)) < 0.006 < np.sqrt(np.mean(before**2))


def test_range_errors_do_not_tilt_planes_seen_at_a_slant(rng):
    """A floor and a wall, 60 cm wide and 3 m away, with 3 cm of noise along the beams."""
    floor = rng.uniform(-0.3, 0.3, (40_000, 3)) * [1, 1, 0] + [2, 0, -2]
    wall = rng.uniform(-0.3, 0.3, (40_000, 3)) * [0, 1, 1] + [3, 0, -0.5]
    vector = np.concatenate([floor, wall])
    vector *= 1 + rng.normal(0, 0.03, (80_000, 1)) / np.linalg.norm(vector, axis=1)[:, None]
    still = np.zeros((80_000, 3)), np.broadcast_to(np.eye(3), (80_000, 3, 3))
    drive = np.zeros(80_000, int)
    shots = Shots(np.zeros((1, 3)), drive, *still, vector, drive)
    features = [Feature("plane", np.arange(40_000)), Feature("plane", np.arange(40_000, 80_000))]
    adjustment = Adjustment(shots, features, False, np.ones(6, dtype=bool))
    tilts = []
    for _ in range(3):
        normal = adjustment.misfits(np.zeros((1, 6)))[1][0]
        tilts.append(np.degrees(np.hypot(*normal[:2])))
        adjustment._take_errors(np.zeros((1, 6)))
    assert tilts[0] > 0.7
    assert tilts[2] < 0.1  # noise tilts it by 0.03 degrees


@pytest.mark.parametrize("side", [0, 90, 200])
def test_an_arc_of_known_radius_lies_on_its_own_side(side):
    angle = np.radians(side + np.linspace(-60, 60, 40))
    height = np.tile([0.0, 0.5, 1.0, 1.5], 10)
    arc = np.column_stack([0.07 * np.cos(angle), 0.07 * np.sin(angle), height])
    beams = np.tile([-np.cos(np.radians(side)), -np.sin(np.radians(side))], (40, 1))
    misfit, way, derivative = pole_misfit(arc, 0.07, beams)
    assert np.abs(misfit).max() < 1e-6  # the circle behind the arc is 2 cm off
    assert np.allclose(way[:, :2] * 0.07, arc[:, :2], atol=1e-6)
    assert derivative.shape == (40, 4)


def test_rejects(drives, street):
    lever = study.two_heads(NavigationErrors()).assumed_lever_arms
    with pytest.raises(ValueError, match="none given"):
        calibrate([], lever_arms_m=lever)
    cloud, path = drives[0]
    lone = cloud[cloud["head"] == 0]
    with pytest.raises(ValueError, match="no planes in common"):
        calibrate([(lone, path)], lever_arms_m=lever)


def test_drives_that_leave_a_parameter_open_are_refused(street):
    head = Scanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, heading_deg=45, tilt_deg=30)
    system = System("one head", (head,), NavigationErrors())
    drives = drive_testfield(street, system, seed=4, pulses_per_s=20_000)
    choices = {"lever_arms_m": system.assumed_lever_arms, "patches": 100, "rounds": 1}
    with pytest.raises(ValueError, match=r"do not determine the mounting \(.*of head 1.* open\)"):
        calibrate(drives, **choices)
    kept = calibrate(drives, **choices, keep=("x_m", "y_m", "z_m", "pitch_deg"))
    assert kept.values[0, [1, 3, 4, 5]].tolist() == [0, 0, 0, 0]
    assert np.abs(kept.values[0, [0, 2]]).max() < 0.05
    with pytest.raises(ValueError, match="Invalid keep 'yaw'"):
        calibrate(drives, **choices, keep=("yaw",))


@pytest.fixture(scope="module")
def files(street, tmp_path_factory):
    """Two drives of one head with a wrong heading as files: clouds, paths, poles, control."""
    folder = tmp_path_factory.mktemp("drives")
    mounting = {"heading_deg": 45, "tilt_deg": 30, "boresight_deg": (0.0, 0.0, 0.3)}
    head = Scanner(pulse_rate_hz=2e5, mirror_frequency_hz=100, **mounting)
    drives = drive_testfield(street, System("one head", (head,)), seed=4, pulses_per_s=20_000)
    for name, (cloud, path) in zip(("there", "back"), drives, strict=True):
        io.write_cloud(folder / f"{name}.laz", cloud, scale=0.0001)
        columns = {"time": path.time, "roll": path.roll, "pitch": path.pitch}
        columns |= {"heading": path.heading, **dict(zip("xyz", path.position.T, strict=True))}
        pd.DataFrame(columns).to_csv(folder / f"{name}.csv", index=False)
    poles = street.poles.rename(columns=lambda name: name.removesuffix("_m"))
    poles.to_csv(folder / "poles.csv", index=False)
    control = street.ground(spacing_m=4.0, seed=2)
    for name, up in (("control", 0.0), ("geoid", 17.0)):
        raised = pd.DataFrame(control + [0, 0, up], columns=list("xyz"))
        raised.to_csv(folder / f"{name}.csv", index=False)
    return folder


def test_a_corrected_cloud_keeps_its_coordinate_system():
    cloud = Cloud([[3.0, 5.0, 0.0]], {"gps_time": np.array([0.5])}, crs="EPSG:25832")
    moved = corrected(
        cloud, straight(20, 10), lever_arms_m=[[0, 0, 2]], values=[[0, 0, 0, 0, 0, 0.1]]
    )
    assert moved.crs == cloud.crs
    assert moved.points == pytest.approx(np.array([[3.0, 5.0, 0.1]]))
