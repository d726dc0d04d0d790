"""Boresight and lever arms recovered from simulated two-way drives."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.boresight import calibrate, corrected
from mmqa_lab.boresight.adjustment import Adjustment, OnPlanes, OnPoles, Shots
from mmqa_lab.boresight.mounting import points_at_control, poles_in_common
from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import straight
from mmqa_lab.simulate.test_field import make_test_field
from mmqa_lab.studies import test_field as study


@pytest.fixture(scope="module")
def street():
    return make_test_field(length_m=48, seed=3)


@pytest.fixture(scope="module")
def survey(street):
    return study.two_drives(street, pulses_per_s=40_000, seed=4)


@pytest.fixture(scope="module")
def found(survey):
    known = {"poles": survey.poles, "control": survey.control}
    known |= {"path_std_m": 0, "path_std_deg": 0}
    return calibrate(survey.drives, lever_arms_m=survey.lever_arms_m, patches=200, **known)


def on_the_road(cloud, street):
    road = [k for k, s in enumerate(street.scene.surfaces) if s.label == "road"]
    return np.isin(cloud["surface"], road)


def test_mounting_is_recovered(found, survey):
    off = np.abs(found.values - survey.true_values)
    assert off[:, :3].max() < 0.01
    assert off[:, 3:].max() < 0.005
    truth = pd.Series(survey.true_values.ravel())
    assert truth.between(found.table["low"], found.table["high"]).sum() >= 10  # of 12
    assert found.remarks == ()  # the paths are exact, as stated


def test_correction_takes_points_to_their_surfaces(found, street, survey):
    cloud, path = survey.drives[0]
    on_road = on_the_road(cloud, street)
    before = cloud.points[on_road, 2] - street.origin[2]
    after = found.correct(cloud, path).points[on_road, 2] - street.origin[2]
    # 5 mm of range noise is what may be left
    assert np.sqrt(np.mean(after**2)) < 0.006 < np.sqrt(np.mean(before**2))


@pytest.mark.parametrize("kind", [OnPlanes, OnPoles])
def test_slopes_are_those_of_the_misfits(kind, rng):
    """Central differences, points of a slope or a pole, seen from vehicles turned at random."""
    xy, known = rng.uniform(-0.4, 0.4, (60, 2)), None
    points = np.column_stack([xy, 0.1 * xy[:, 0]])
    if kind is OnPoles:
        angle = rng.uniform(-np.pi, np.pi, 60)
        known = np.column_stack([np.cos(angle), np.sin(angle)]), 0.05
        points = np.column_stack([0.05 * known[0], rng.uniform(0, 4, 60)])
    turns, place = np.linalg.qr(rng.normal(size=(60, 3, 3)))[0], rng.normal(0, 3, (60, 3))
    arm = np.tile([0.4, -0.6, 0.3], (60, 1))
    beam = np.einsum("nij,ni->nj", turns, points - place) - arm
    shots = Shots(np.zeros(60, int), np.arange(60) % 2, place, turns, arm, beam)
    on = kind(shots, [(np.arange(60), known)])
    slopes = on.rows(np.zeros((1, 6)))[1]
    for k, step in enumerate(1e-5 * np.eye(6)):
        high, low = (on.rows(sign * step[None])[0] for sign in (1, -1))
        off = (high - low) / 2e-5 - slopes[:, k]
        assert np.abs(off).max() < 1e-3 * np.abs(slopes[:, k]).max()


def test_heights_of_the_ground_are_those_of_road_and_pavement_but_not_of_their_edges(street):
    """A build-out reaches 2 m into the road from 15 to 21 m; its ends and all curbs have none."""
    places = [(0, 5), (3.8, 14.5), (3.8, 14.7), (3.8, 21.3), (3.8, 21.5), (3.8, 18), (3.2, 18)]
    places += [(2, 15.1), (2, 18), (7, 18), (-7, 18), (5.2, 5), (8.8, 5)]
    height = street.height(np.array(places) + street.origin[:2]) - street.origin[2]
    none = np.nan
    wanted = [0, 0, none, none, 0, 0.12, none, 0, 0, 0.12, 0.12, none, none]
    assert height == pytest.approx(np.array(wanted), abs=1e-6, nan_ok=True)


def test_poles_whose_arcs_have_passed_each_other_are_brought_together():
    """Of a pole of 6 cm, each side moved by 5 cm along its beams: past the other one."""
    turn, height = np.radians(np.linspace(-60, 60, 41)), np.linspace(0, 3, 41)
    ways = np.column_stack([-np.cos(turn), np.sin(turn)])
    ways = np.vstack([ways, -ways])
    points = np.column_stack([0.03 * ways, np.tile(height, 2)])
    points[:, 0] += np.repeat([0.05, -0.05], 41)
    still = np.zeros((82, 3)), np.broadcast_to(np.eye(3), (82, 3, 3))
    shots = Shots(np.zeros(82, int), np.zeros(82, int), *still, np.zeros((82, 3)), points)
    misfit = OnPoles(shots, [(np.arange(82), (ways, 0.03))]).rows(np.zeros((1, 6)))[0]
    assert misfit[[20, 61]] == pytest.approx(-0.05, abs=0.01)  # both lie behind their side


def test_of_a_pole_its_skin_is_taken_and_what_stands_beside_it_is_left():
    """Two groups of 30 points on a pole of 12 cm, and four of each 20 cm beside its axis."""
    turn = np.tile(np.linspace(0, 6, 30), 2)
    skin = 0.06 * np.column_stack([np.cos(turn), np.sin(turn)])
    aside = np.repeat([[0.2, 0.0], [0.0, 0.2]], 4, axis=0)
    height = np.linspace(0.5, 3, 68)
    placed = np.column_stack([np.vstack([skin, aside]), height])
    group = np.concatenate([np.repeat([0, 1], 30), np.tile([0, 1], 4)])
    poles = pd.DataFrame({"x_m": [0.0], "y_m": 0.0, "z_m": 0.0, "diameter_m": 0.12})
    ((index, (ways, radius)),) = poles_in_common(placed, group, poles, np.zeros(3))
    assert sorted(index) == [*range(60)]
    assert radius == 0.06
    assert ways == pytest.approx(skin[index] / 0.06, abs=0.02)


def test_points_at_a_control_point_lie_near_it_in_plan_and_height():
    """20 points within 10 cm of the second of two, as many above it and as many beside it."""
    around = 0.1 * np.column_stack(
        [*np.random.default_rng(1).uniform(-1, 1, (2, 20)), np.zeros(20)]
    )
    control = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 1.0]])
    moved = [control[1] + step for step in ([0, 0, 0], [0, 0, 0.4], [0.5, 0, 0])]
    ((index, height),) = points_at_control(np.vstack([around + to for to in moved]), control)
    assert sorted(index) == [*range(20)]
    assert height == 1.0


def test_bad_surveys_are_refused_or_said(survey):
    lever, (cloud, path) = survey.lever_arms_m, survey.drives[0]
    known = {"poles": survey.poles, "control": survey.control, "patches": 60}
    with pytest.raises(ValueError, match="none given"):
        calibrate([], lever_arms_m=lever)
    with pytest.raises(ValueError, match="no planes in common"):
        calibrate([(cloud[cloud["head"] == 0], path)], lever_arms_m=lever)
    with pytest.raises(ValueError, match=r"82\.2 m long\. Must be at most 10 m"):
        calibrate(survey.drives, lever_arms_m=[(-35, -70, 25)], **known)
    with pytest.raises(ValueError, match=r"Invalid drives: .* stays open"):
        calibrate(survey.drives, lever_arms_m=lever, control=[(0.0, 0.0, 0.0)])
    one_way = calibrate(survey.drives[:1], lever_arms_m=lever, keep=("x_m", "y_m"), **known)
    said = " ".join(one_way.remarks)
    assert "All drives run in one direction" in said
    assert "positions and attitudes are not given" in said


def test_drives_that_leave_a_parameter_open_are_refused(survey, street):
    """A flat road alone shows roll and height: to what else moves it within itself it is blind."""
    flat = [(cloud[on_the_road(cloud, street)], path) for cloud, path in survey.drives]
    choices = {"lever_arms_m": survey.lever_arms_m, "control": survey.control, "patches": 60}
    with pytest.raises(ValueError, match=r"Invalid drives: .*of head 1"):
        calibrate(flat, **choices)
    kept = calibrate(flat, **choices, keep=("x_m", "y_m", "heading_deg", "pitch_deg"))
    assert (kept.values[:, 1:5] == 0).all()
    assert np.isnan(kept.table["low"].to_numpy().reshape(2, 6)[:, 1:5]).all()
    with pytest.raises(ValueError, match="Invalid keep 'yaw'"):
        calibrate(flat, **choices, keep=("yaw",))


def test_stated_errors_of_paths_widen_the_lever_arms_alone(survey):
    known = {"poles": survey.poles, "control": survey.control, "patches": 60}
    known |= {"lever_arms_m": survey.lever_arms_m}
    exact, east = (calibrate(survey.drives, **known, path_std_m=(e, 0, 0)) for e in (0, 0.01))
    assert "paths' attitudes are not given" in " ".join(east.remarks)
    std = east.table.set_index(["parameter", "head"])["std"]
    # east is x of one drive and -x of the other: their mean difference stays, root of 2 halves
    assert std["x_m"].to_numpy() == pytest.approx(0.01 / np.sqrt(2), rel=0.05)
    assert std["roll_deg"].to_numpy() == pytest.approx(
        exact.table.set_index(["parameter", "head"])["std"]["roll_deg"].to_numpy(), rel=0.2
    )


def test_a_corrected_cloud_keeps_its_coordinate_system():
    cloud = Cloud([[3.0, 5.0, 0.0]], {"gps_time": np.array([0.5])}, crs="EPSG:25832")
    raised = {"lever_arms_m": [[0, 0, 2]], "values": [[0, 0, 0, 0, 0, 0.1]]}
    moved = corrected(cloud, straight(20, 10), **raised)
    assert moved.crs == cloud.crs
    assert moved.points == pytest.approx(np.array([[3.0, 5.0, 0.1]]))


@pytest.mark.parametrize(
    ("column", "change", "sentence"),
    [
        ("head", lambda head: head + 1, "Invalid head 2 of cloud a. Must be 0 to 1: heads count"),
        ("head", lambda head: head - 1, "Invalid head -1 of cloud a. Must be 0 to 1"),
        ("gps_time", lambda time: 0 * time, "Invalid gps_time of cloud a: all 0.0 s. Must be the"),
        ("gps_time", lambda time: time + 1e9, "Invalid cloud a: time 10000"),
    ],
)
def test_heads_and_times_that_fit_nothing_are_named(survey, column, change, sentence):
    (cloud, path), *others = survey.drives
    columns = dict(cloud.columns) | {column: change(cloud[column].astype(float))}
    drives = [(Cloud(cloud.points, columns, "a"), path), *others]
    with pytest.raises(ValueError, match=sentence) as error:
        calibrate(drives, lever_arms_m=survey.lever_arms_m)
    if "time 1" in sentence:
        assert f"Must be between {path.time[0]} and {path.time[-1]} s" in str(error.value)


def test_a_cloud_without_time_is_refused(survey):
    (cloud, path), *others = survey.drives
    with pytest.raises(ValueError, match="Invalid cloud 1: no column 'gps_time'"):
        calibrate([(Cloud(cloud.points), path), *others], lever_arms_m=survey.lever_arms_m)


def test_variances_are_those_of_leaving_each_feature_out(rng):
    of, ways = np.repeat(np.arange(6), 5), np.eye(6)[:, :3]
    slopes, misfit = rng.normal(size=(30, 3)), 0.01 * rng.normal(size=30)
    paths, path_std = rng.normal(size=(30, 12)), np.array([0.02, 0.03, 0.05, 1e-4, 2e-4, 3e-4])
    known = SimpleNamespace(system=lambda _: (misfit, slopes, paths, of), ways=ways,
                            _refuse_open=lambda _: None)  # fmt: skip
    found, freedom = Adjustment.variance(known, None, path_std)
    # each feature moves the answer by what it changes where it is left out
    whole = np.linalg.inv(slopes.T @ slopes)
    moved = []
    for k in range(6):
        one, rest = of == k, of != k
        left = np.linalg.inv(slopes[rest].T @ slopes[rest])
        # the step that the feature's misfits ask for, of the others' normal equations
        moved.append(left @ (slopes[one].T @ misfit[one]))
    of_points = (np.array(moved) ** 2).sum(axis=0)
    of_paths = ((whole @ slopes.T @ (paths * np.tile(path_std, 2))) ** 2).sum(axis=1)
    assert found[:3] == pytest.approx(of_points + of_paths)
    assert (found[3:] == 0).all()
    shares = np.array([np.diag(whole @ slopes[of == k].T @ slopes[of == k] @ whole)
                       for k in range(6)])  # fmt: skip
    students = shares.sum(axis=0) ** 2 / (shares**2).sum(axis=0)
    assert freedom[:3] == pytest.approx(students * (found[:3] / of_points) ** 2)


def test_a_combination_that_has_no_effect_is_refused_and_named(rng):
    slopes = rng.normal(size=(30, 3))
    slopes[:, 2] = slopes[:, 0] + 1e-6 * rng.normal(size=30)
    known = SimpleNamespace(ways=np.eye(6)[:, :3])
    with pytest.raises(ValueError, match="stays open") as error:
        Adjustment._refuse_open(known, slopes)
    assert "of head 1 with" in str(error.value)
    Adjustment._refuse_open(known, rng.normal(size=(30, 3)))
