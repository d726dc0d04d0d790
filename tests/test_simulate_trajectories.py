"""Trajectories: signs of attitude, errors of the size asked for, bad tables named."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mmqa_lab import simulate
from mmqa_lab.rotations import rotations
from mmqa_lab.simulate import NavigationErrors, Trajectory
from mmqa_lab.simulate.trajectories import gauss_markov

ANGLES = st.floats(-180, 180)


@given(roll=ANGLES, pitch=ANGLES, heading=ANGLES)
def test_rotations_equal_scipy(roll, pitch, heading):
    r, p, h = np.radians([roll, pitch, heading])
    expected = Rotation.from_euler("ZXY", [-h, p, r]).as_matrix()
    assert np.abs(rotations(*np.array([[r], [p], [h]]))[0] - expected).max() < 1e-12


def test_a_circle_is_followed_between_its_rows():
    time = np.arange(0, 20.01, 0.1)
    angle = 0.3 * time
    position = 25 * np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    path = Trajectory(time, position, heading=np.degrees(angle) + 90)
    between = np.linspace(1, 19, 777)
    where, rotation = path.at(between)
    assert np.abs(np.linalg.norm(where, axis=1) - 25).max() < 1e-6  # (h^4/384) w^4 R = 5e-8
    tangent = np.stack([np.cos(0.3 * between), -np.sin(0.3 * between), 0 * between], axis=1)
    assert np.abs(rotation[:, :, 1] - tangent).max() < 1e-9


def test_headings_wrap_without_a_turn():
    path = Trajectory([0, 1], np.eye(3)[:2], heading=[359, 1])
    assert np.allclose(path.at([0.5])[1][0], np.eye(3), atol=1e-12)


def test_attitude_of_a_table_is_taken_and_without_heading_it_looks_where_it_moves():
    table = pd.DataFrame(
        {"time_s": [0, 2], "easting_m": [0, 9], "northing_m": [0, 9], "height_m": 2}
    )
    path = Trajectory.from_table(table)
    assert np.allclose([path.heading, path.roll], [[45, 45], [0, 0]])
    path = Trajectory.from_table(table.assign(heading_deg=[0, 3], pitch_deg=[1, 2]))
    assert [path.heading.tolist(), path.pitch.tolist()] == [[0, 3], [1, 2]]


def test_a_standing_vehicle_keeps_its_heading(rng):
    east = np.r_[np.arange(0, 20, 0.5), np.full(200, 20.0), np.arange(20, 40, 0.5)]
    place = np.c_[east, 0 * east, 0 * east]
    names = ["easting_m", "northing_m", "height_m"]
    for noise in (0, 0.01):
        table = pd.DataFrame(place + noise * rng.normal(size=place.shape), columns=names)
        path = Trajectory.from_table(table.assign(time_s=0.1 * np.arange(len(east))))
        assert np.abs(path.heading - 90).max() <= 600 * noise
    with pytest.raises(ValueError, match="Must move, or have a heading_deg"):
        Trajectory.from_table(table.iloc[45:55].assign(time_s=range(10)))


def test_drawn_errors_of_one_seed_are_independent():
    path = simulate.straight(400, 10)
    varied = simulate.with_speed_variation(path, share=0.02, seed=3)
    known = simulate.measured(path, NavigationErrors(drift_m=0.1, correlation_s=0.5), seed=3)
    pace = np.diff(varied.position[:, 1]) / np.diff(varied.time)
    n = min(len(pace), len(known.time))
    # 80 independent halves of a second
    assert abs(np.corrcoef(pace[:n], known.position[:n, 0])[0, 1]) < 0.4


def test_speed_variation_has_its_size_and_keeps_the_path():
    path = simulate.straight(4000, 10, heading=30)
    varied = simulate.with_speed_variation(path, share=0.02, seed=5)
    speed = np.linalg.norm(np.diff(varied.position, axis=0), axis=1) / np.diff(varied.time)
    assert speed.std() / speed.mean() == pytest.approx(0.02, rel=0.1)  # 800 independent halves
    assert np.allclose(varied.position[-1], path.position[-1], atol=1e-9)
    assert np.allclose(np.cross(varied.position, path.position[-1]), 0, atol=1e-6)


def test_gauss_markov_forgets_at_the_correlation_time(rng):
    values = gauss_markov(400_000, 0.01, 0.5, rng)
    assert values.std() == pytest.approx(1, abs=0.03)
    assert np.mean(values[:-50] * values[50:]) == pytest.approx(np.exp(-1), abs=0.04)


def test_navigation_errors_have_their_size_and_drift_slowly():
    path = simulate.straight(12_000, 10)
    errors = NavigationErrors(drift_m=(0.1, 0.0, 0.2), drift_deg=(0, 0, 0.3), correlation_s=5)
    known = simulate.measured(path, errors, seed=1)
    shift = known.position - path.at(known.time)[0]
    # 1200 s are 120 times twice the correlation time
    assert np.allclose(shift.std(axis=0), [0.1, 0, 0.2], rtol=0.2)
    assert known.heading.std() == pytest.approx(0.3, rel=0.2)
    assert not known.roll.any()
    jump = np.diff(shift[:, 0])
    assert jump.std() == pytest.approx(0.1 * np.sqrt(2 * 0.01 / 5), rel=0.05)
    assert path.position.tolist() == [[0, 0, 0], [0, 12_000, 0]]


def test_a_varying_speed_has_its_share_and_its_time_of_correlation():
    path = simulate.with_speed_variation(simulate.straight(20_000, 10), share=0.1, seed=1)
    speed = np.hypot(*np.diff(path.position[:, :2], axis=0).T) / np.diff(path.time)
    off = speed / speed.mean() - 1
    assert off.std() == pytest.approx(0.1, rel=0.05)
    assert np.corrcoef(off[:-50], off[50:])[0, 1] == pytest.approx(np.exp(-1), abs=0.05)


def test_navigation_adds_drifts_of_the_size_and_length_that_are_stated():
    path = simulate.straight(4000, 10, heading=30)
    size = np.array([0.02, 0.03, 0.05]), np.array([0.01, 0.02, 0.04])
    known = NavigationErrors(drift_m=size[0], drift_deg=size[1], correlation_s=2.0)
    found = simulate.measured(path, known, seed=5, interval_s=0.1)
    place, _ = path.at(found.time)
    off = found.position - place
    angles = np.column_stack([found.roll, found.pitch, found.heading - 30])
    for drift, stated in ((off, size[0]), (angles, size[1])):
        assert drift.std(axis=0) == pytest.approx(stated, rel=0.2)
        assert np.abs(np.corrcoef(drift[:-20].T, drift[20:].T)[:3, 3:].diagonal()
                      - np.exp(-1)).max() < 0.25  # fmt: skip
    both = np.corrcoef(np.column_stack([off, angles]).T)
    assert np.abs(both - np.eye(6)).max() < 0.25
    assert len(found.time) == 4001
    assert np.ptp(np.diff(found.time)) < 1e-9


def test_the_speed_varies_by_its_share_within_half_a_second():
    path = simulate.straight(6000, 10)
    found = simulate.with_speed_variation(path, share=0.1, seed=2)
    speed = np.diff(found.position[:, 1]) / np.diff(found.time)
    assert np.std(speed) / 10 == pytest.approx(0.1, rel=0.12)
    pairs = np.corrcoef(speed[:-50], speed[50:])[0, 1]
    assert pairs == pytest.approx(np.exp(-1), abs=0.12)
    assert np.median(np.diff(found.time)) == pytest.approx(0.01, rel=0.02)
