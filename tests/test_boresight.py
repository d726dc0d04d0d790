"""Boresight and lever arms recovered from simulated two-way drives."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

from mmqa_lab.boresight import calibrate, corrected
from mmqa_lab.boresight.adjustment import Adjustment, OnGround, OnPlanes, OnPoles, Shots
from mmqa_lab.boresight.mounting import (
    _result,
    _shared,
    planes_in_common,
    points_at_control,
    poles_in_common,
)
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import fit_plane
from mmqa_lab.rotations import rotations, turned
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
    known = SimpleNamespace(system=lambda *_, **__: (misfit, slopes, paths, of), ways=ways,
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


def line_kind(slopes, target, of, scatter):
    """A kind of misfits that are linear in the parameters, as the adjustment asks for one."""
    kind = SimpleNamespace(slopes=slopes, target=target, of=of, scatter=scatter)
    kind.known = [None] * (of.max() + 1)
    paths = np.zeros((len(slopes), 6))
    kind.rows = lambda values, _: (
        kind.slopes @ values.ravel() - kind.target,
        np.hstack([kind.slopes, paths[: len(kind.slopes)]]),
        kind.of,
    )

    def keep(good):
        kind.slopes, kind.target, kind.of = kind.slopes[good], kind.target[good], kind.of[good]

    kind.keep = keep
    return kind


@pytest.mark.parametrize("level", [False, True])
@pytest.mark.parametrize("kept", [(), (5,), (3, 4)])
def test_free_parameters_span_what_may_change(level, kept):
    """Of two heads; without control points the mean of z_m stays, where it is free."""
    free = np.tile(~np.isin(np.arange(6), kept), 2)
    kind = SimpleNamespace(of=np.zeros(1))
    adjusted = Adjustment([kind, SimpleNamespace(of=np.zeros(0))], free, level)
    assert adjusted.kinds == [kind]
    expected = np.diag(free * 1.0)
    if level and 5 not in kept:
        mean = np.eye(12)[[5, 11]].sum(axis=0) / np.sqrt(2)
        expected -= np.outer(mean, mean)
    assert adjusted.ways @ adjusted.ways.T == pytest.approx(expected)
    assert adjusted.values(adjusted.ways.T @ np.arange(12.0)) == pytest.approx(
        (expected @ np.arange(12)).reshape(2, 6)
    )


def test_the_mounting_is_least_squares_over_the_scatter_without_outliers(rng):
    truth, kinds, rows = rng.normal(size=6), [], []
    for scatter, n in ((0.01, 200), (0.05, 100)):
        slopes = rng.normal(size=(n, 6))
        target = slopes @ truth + scatter * rng.normal(size=n)
        target[:: n // 20] += 30 * scatter  # outliers
        kinds.append(line_kind(slopes, target, np.arange(n) // 5, 0.02))
        rows.append((slopes, target))
    adjusted = Adjustment(kinds, np.ones(6, bool), False)
    found = adjusted.solved(np.zeros((1, 6)))
    weights, at = [0.02, 0.02], np.zeros(6)
    for turn in range(3):
        for k, (slopes, target) in enumerate(rows) if turn else ():
            off = slopes @ at - target
            weights[k] = 1.482602218505602 * np.median(np.abs(off - np.median(off)))
            good = np.abs(off) <= 3.5 * weights[k]
            rows[k] = slopes[good], target[good]
        both = [np.concatenate([part[i] / w for part, w in zip(rows, weights, strict=True)])
                for i in (0, 1)]  # fmt: skip
        at = np.linalg.lstsq(*both)[0]
    assert found[0] == pytest.approx(at, abs=1e-6)
    assert [kind.scatter for kind in kinds] == pytest.approx(weights, rel=1e-4)
    assert sum(len(kind.target) for kind in kinds) == sum(len(part[1]) for part in rows) <= 260
    misfit, slopes, _, of = adjusted.system(found)
    assert (len(misfit), slopes.shape[1]) == (len(of), 6)
    assert len(set(of)) == 60  # the second kind counts on


def shots_of(points, rng, heads=1, drives=1):
    """Shots whose points lie there, seen from vehicles at random places."""
    n = len(points)
    turns, place = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0], rng.normal(0, 3, (n, 3))
    turns *= np.linalg.det(turns)[:, None, None]
    arm = np.array([[0.4, -0.6, 0.3], [-0.2, 0.5, 0.1]])[np.arange(n) % heads]
    beam = np.einsum("nij,ni->nj", turns, points - place) - arm
    return Shots(np.arange(n) % heads, np.arange(n) % drives, place, turns, arm, beam)


def test_slopes_of_shots_are_changes_of_points_by_heads_and_by_paths(rng):
    shots = shots_of(rng.normal(size=(12, 3)), rng, heads=2, drives=3)
    values, way = rng.normal(0, 0.01, (2, 6)), rng.normal(size=(12, 3))
    values[:, :3] = 0  # of small angles
    slopes, step = shots.slopes(values, way), 1e-6
    assert slopes.shape == (12, 6 * (2 + 3))
    assert np.array_equal(shots.slopes(values, way, paths=False), slopes[:, :12])
    for k in range(12):  # of heads
        change = step * np.eye(12)[k].reshape(2, 6)
        moved = (shots.placed(values + change) - shots.placed(values - change)) / (2 * step)
        assert slopes[:, k] == pytest.approx((moved * way).sum(axis=1), abs=1e-5)
    point = shots.inside(values)[1]
    for drive in range(3):
        own = shots.drive == drive
        for k in range(6):
            column = slopes[:, 12 + 6 * drive + k]
            moved = np.eye(3)[k] if k < 3 else None
            if moved is None:  # the vehicle is turned about its axes, as a head is
                turn = rotations(*(step * np.eye(3)[k - 3]))
                moved = np.einsum("nij,nj->ni", shots.rotation, (point @ turn.T - point) / step)
            assert column == pytest.approx(own * (moved * way).sum(axis=1), abs=1e-4)


def test_points_of_planes_and_poles_have_the_distances_from_fits_through_them(rng):
    flat = np.column_stack([rng.uniform(-1, 1, (50, 2)), 0.01 * rng.normal(size=50)])
    of = np.repeat([0, 1], [20, 30])
    points = np.where(of[:, None] == 0, flat, flat @ turned(x=70).T + [3, 4, 5])
    on = OnPlanes(shots_of(points, rng), [(np.arange(20), None), (np.arange(20, 50), None)])
    misfit, _, found = on.rows(np.zeros((1, 6)))
    assert np.array_equal(found, of)
    for k in (0, 1):
        own = np.abs(fit_plane(points[of == k]).residuals)
        assert np.abs(misfit[of == k]) == pytest.approx(own, abs=1e-9)
    on.keep(np.arange(50) % 3 > 0)
    assert on.starts.tolist() == [0, 13]
    for radius in (0.1, None):
        turn, height = rng.uniform(0, 6, 40), rng.uniform(0, 3, 40)
        ways = np.column_stack([np.cos(turn), np.sin(turn)])
        plan = ways * (0.1 + 0.003 * rng.normal(size=(40, 1))) + 0.02 * height[:, None] + [5, 6]
        pole = shots_of(np.column_stack([plan, height]), rng)
        misfit = OnPoles(pole, [(np.arange(40), (ways, radius))]).rows(np.zeros((1, 6)))[0]
        terms = np.column_stack([ways, ways * height[:, None], np.ones(40)])[:, : 4 + (not radius)]
        right = (ways * plan).sum(axis=1) - (radius or 0)
        assert misfit == pytest.approx(right - terms @ np.linalg.lstsq(terms, right)[0], abs=1e-9)


def test_rows_of_the_ground_are_mean_heights_over_control_points(rng):
    points, of = rng.normal(size=(30, 3)), np.repeat([0, 1, 2], 10)
    shots = shots_of(points, rng)
    on = OnGround(shots, [(np.flatnonzero(of == k), height) for k, height in enumerate((1, 2, 5))])
    misfit, slopes, numbers = on.rows(np.zeros((1, 6)))
    means = points[:, 2].reshape(3, 10).mean(axis=1)
    assert misfit == pytest.approx(means - [1, 2, 5])
    up = np.tile([0.0, 0, 1], (30, 1))
    each = shots.slopes(np.zeros((1, 6)), up).reshape(3, 10, -1).mean(axis=1)
    assert slopes == pytest.approx(each)
    on.keep(np.array([True, False, True]))
    misfit, _, numbers = on.rows(np.zeros((1, 6)))
    assert numbers.tolist() == [0, 2]
    assert misfit == pytest.approx(means[[0, 2]] - [1, 5])


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("turn", 4.5, 5.5), ("off", 0.28, 0.32), ("rough", 0.028, 0.032), ("few", 15, 14),
     ("wide", 6.0, 4.4), ("narrow", 0.105, 0.095)],
)  # fmt: skip
def test_planes_are_the_same_within_limits(kind, inside, outside, rng):
    """Two groups of 225 points in a ball, which differ by one thing."""
    first = np.stack([*np.mgrid[-7:8, -7:8] / 20, np.zeros((15, 15))], axis=-1).reshape(-1, 3)
    for value, same in ((inside, True), (outside, False)):
        other = first.copy()
        if kind == "turn":
            other = other @ turned(x=value).T
        elif kind == "off":
            other[:, 2] += value
        elif kind == "rough":
            other[:, 2] = value * np.where(np.arange(225) % 2, 1, -1)
        elif kind == "few":
            other = other[rng.permutation(225)[:value]]
        elif kind == "wide":  # beside its roughness of 2 cm
            other[:, 2] = 0.02 * np.where(np.arange(225) % 2, 1, -1)
            other[:, 1] *= value * 0.02 / other[:, 1].std()
        elif kind == "narrow":
            other[:, 1] *= value / other[:, 1].std()
        points = np.vstack([first, other])
        group, place = np.repeat([0, 1], [225, len(other)]), np.zeros(225 + len(other), int)
        if same:
            found = _shared(points, place, group)
            assert found["rows"].map(len).tolist() == [100, min(100, len(other))]
            assert found["side"].tolist() == [2, 2]
            assert sorted({*np.concatenate(found["rows"].tolist())} - {*range(225)}) != []
        else:
            with pytest.raises(ValueError, match="no planes in common within 1"):
                _shared(points, place, group)


def result_of(values, variance, students, *, std=(None, None), drives=(0, 0, 1, 1), ways=(1, 1)):
    """A calibration from what an adjustment gives, and the errors of paths that it was given."""
    asked = []
    turns = np.zeros((4, 3, 3))
    turns[:, 1, 1] = np.repeat(ways, 2)
    kinds = [SimpleNamespace(shots=SimpleNamespace(rotation=turns, drive=np.array(drives)))]

    def told(found, path_std):
        asked.append((found, path_std))
        return np.asarray(variance, float), np.asarray(students, float)

    adjusted = SimpleNamespace(variance=told, kinds=kinds)
    lever = np.zeros((len(values), 3))
    return _result(adjusted, np.asarray(values, float), lever, *std), asked


def test_a_calibration_has_degrees_and_metres_with_students_ends_and_remarks():
    values = np.array([[0.01, -0.02, 0.03, 0.4, -0.5, 0.6], [0, 0, 0, 0.1, 0.2, 0]])
    variance = np.array([1e-6, 4e-6, 9e-6, 1e-4, 4e-4, 9e-4, 0, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    students = np.arange(3.0, 15)
    found, ((same, path_std),) = result_of(values, variance, students, std=(0.02, (0.1, 0.2, 0.3)))
    assert same is not None
    assert path_std == pytest.approx([0.02] * 3 + np.radians([0.1, 0.2, 0.3]).tolist())
    unit = np.tile([180 / np.pi] * 3 + [1] * 3, 2)
    assert found.table["value"].to_numpy() == pytest.approx(values.ravel() * unit)
    assert found.table["std"].to_numpy() == pytest.approx(np.sqrt(variance) * unit)
    half = t.ppf(0.975, students) * np.sqrt(variance) * unit
    half[6] = np.nan  # kept as assumed
    for end, sign in (("low", -1), ("high", 1)):
        expected = values.ravel() * unit + sign * half
        assert found.table[end].to_numpy() == pytest.approx(expected, nan_ok=True)
    assert found.table["head"].tolist() == [0] * 6 + [1] * 6
    assert found.table["parameter"].tolist()[:6] == list(found.table["parameter"][6:])
    assert found.values == pytest.approx((values.ravel() * unit).reshape(2, 6))
    assert len(found.remarks) == 1
    assert found.remarks[0].startswith("All drives run in one direction")
    both, _ = result_of(values, variance, students, ways=(1, -1))
    assert both.remarks == (
        "Errors of the paths' positions and attitudes are not given: the intervals lack them.",
    )
    one, _ = result_of(values, variance, students, std=(0.0, None), ways=(1, -1))
    assert one.remarks[0].startswith("Errors of the paths' attitudes are not given")


@pytest.mark.parametrize("k", range(6))
def test_values_and_deviations_beyond_ten_degrees_or_a_metre_are_no_estimate(k):
    limit = np.radians(10) if k < 3 else 1.0
    for share, open_ in ((0.99, False), (-0.99, False), (1.01, True), (-1.01, True)):
        values, variance = np.zeros((1, 6)), np.full(6, 1e-8)
        values[0, k] = share * limit
        wide = variance.copy()
        wide[k] = (share * limit) ** 2
        for given in ((values, variance), (np.zeros((1, 6)), wide)):
            if open_:
                with pytest.raises(ValueError, match="stays open"):
                    result_of(*given, np.full(6, 9.0))
            else:
                result_of(*given, np.full(6, 9.0))


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("low", 0.41, 0.39), ("high", 5.9, 6.1), ("gate", 0.049, 0.051),
     ("few", 15, 14), ("groups", 2, 1)],
)  # fmt: skip
def test_poles_in_common_are_taken_within_limits(kind, inside, outside):
    """Rings of 60 points about a pole of 20 cm from 1 to 3 m; what differs is one ring of 15."""
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])
    for value, taken in ((inside, True), (outside, False)):
        points = [np.column_stack([ring, np.linspace(1, 3, 60)]) for _ in range(2)]
        poles = pd.DataFrame({"x_m": [105.0], "y_m": 200.0, "z_m": 10.0, "diameter_m": 0.2})
        few = points[1][::4].copy()
        if kind in ("low", "high"):
            few[7, 2] = value
        if kind == "gate":
            few = np.vstack([few, few[3] + [*(value * ring[12] / 0.1), 0]])
        if kind == "few":
            few = points[1][:: 60 // value][:value]
        if kind == "groups":
            few = points[1][: 60 * (value - 1)]
        placed = np.vstack([points[0], few]) + [5, 0, 10]
        group = np.repeat([3, 7], [60, len(few)])
        found = poles_in_common(placed, group, poles, np.array([100.0, 200, 0]))
        if kind in ("few", "groups", "low", "high") and not taken:
            assert found == []  # fewer than fifteen, or no second group
            continue
        ((index, (ways, radius)),) = found
        n = 60 + (15 + taken if kind == "gate" else len(few))
        assert (len(index), radius) == (n, 0.1)
        off = placed[index, :2] - [5, 0]
        assert ways == pytest.approx(off / np.hypot(*off.T)[:, None], abs=0.02)
    free = poles.drop(columns="diameter_m")
    both = np.vstack([points[0], points[0]]) + [5, 0, 10]
    ((index, (_, radius)),) = poles_in_common(
        both, np.repeat([0, 1], 60), free, np.array([100.0, 200, 0])
    )
    assert (len(index), radius) == (120, None)


def test_points_at_control_are_told_by_thirty_centimetres_and_fifteen():
    control = np.array([[0.0, 0, 5], [10, 0, 7]])
    for n, known in ((15, True), (14, False)):
        ring = np.column_stack([0.29 * np.cos(np.arange(n)), 0.29 * np.sin(np.arange(n))])
        near = np.column_stack([ring, 5 + 0.29 * np.where(np.arange(n) % 2, 1, -1)])
        others = [[0.31, 0, 5], [0, 0, 5.31], [0, 0, 4.69], [10, 0.2, 7]]
        found = points_at_control(np.vstack([near, others]), control)
        assert bool(found) == known
        if known:
            ((index, height),) = found
            assert (sorted(index), height) == ([*range(15)], 5)


def test_planes_in_common_lie_in_balls_about_the_centres_of_cubes(rng):
    """Two groups on a floor of 4 m: balls of half a metre, their centres 70 cm apart or more."""
    n = 6000
    placed = np.column_stack([rng.uniform(0, 4, (2 * n, 2)), 0.002 * rng.normal(size=2 * n)])
    group = np.repeat([0, 1], n)
    found = planes_in_common(placed, group, 500, np.random.default_rng(1))
    middles = np.array([placed[index].mean(axis=0) for index, _ in found])
    apart = np.abs(middles[:, None] - middles).max(axis=2) + 9 * np.eye(len(found))
    assert apart.min() > 0.6
    assert 10 < len(found) <= 25
    for index, known in found:
        assert known is None
        away = np.linalg.norm(placed[index] - placed[index].mean(axis=0), axis=1)
        assert 0.35 < away.max() < 0.6
        assert np.bincount(group[index]).tolist() == [100, 100]
    assert len(planes_in_common(placed, group, 3, np.random.default_rng(1))) == 3
