"""The simulated test field: where all stands, how high the ground is, what drives see of it."""

from dataclasses import replace

import numpy as np
import pytest

from mmqa_lab.simulate import PRESETS, NavigationErrors, canyon, canyon_houses
from mmqa_lab.simulate import test_field as field
from mmqa_lab.simulate.systems import System
from mmqa_lab.simulate.test_field import drive_test_field, make_test_field

ORIGIN = np.array([380_000.0, 6_672_000.0, 20.0])
STREET = make_test_field(length_m=100, reference_std_m=0.0, seed=4)


def box_of(surface):
    """Least and largest coordinates of a surface."""
    low, high = surface.centre - surface.half, surface.centre + surface.half
    return np.array([low.min(axis=0), high.max(axis=0)])


def boxes_of(surfaces, label):
    found = [box_of(one) for one in surfaces if one.label == label]
    return np.array(sorted(found, key=lambda one: one.ravel().tolist()))


def test_bays_are_six_metres_long_and_begin_every_thirty():
    assert field._bays(100.0).tolist() == [[15, 21], [45, 51], [75, 81]]
    assert field._bays(57.0).tolist() == [[15, 21]]
    assert field._bays(57.1).tolist() == [[15, 21], [45, 51]]


def test_road_and_pavements_lie_where_they_are_stated():
    made = list(field._road(100.0))
    (road,) = boxes_of(made, "road")
    assert road == pytest.approx(np.array([[-5, -30, 0], [5, 130, 0]]))
    found = boxes_of(made, "pavement")
    bays = [[15, 21], [45, 51], [75, 81]]
    expected = [[[-50, -30, 0], [-5, 130, 0.12]], [[5, -30, 0], [9, 130, 0.12]]]
    expected += [[[x, low, 0], [x + 2, high, 0.12]] for low, high in bays for x in (-5, 3)]
    expected = sorted(expected, key=lambda one: np.ravel(one).tolist())
    assert found == pytest.approx(np.array(expected))
    light = {one.label: one.reflectance[0] for one in made}
    assert light == {"road": 0.15, "pavement": 0.3}
    cars = np.array([box_of(one) for one in field._cars(100.0)])
    middles = [(3.9, 10), (-3.9, 32), (3.9, 70)]
    expected = [[[x - 0.9, y - 2.25, 0], [x + 0.9, y + 2.25, 1.5]] for x, y in middles]
    assert cars == pytest.approx(np.array(expected))


def test_houses_stand_along_both_sides_with_gaps_and_corners_at_their_fronts():
    gaps, fronts, depths, heights, starts = [], [], [], [], []
    for seed in range(40):
        houses, corners = field._houses(100.0, np.random.default_rng(seed))
        assert {one.label for one in houses} == {"house"}
        assert {float(one.reflectance[0]) for one in houses} == {0.5}
        ends = np.array([box_of(one) for one in houses])
        low, high = ends[:, 0], ends[:, 1]
        left = high[:, 0] < 0
        front = np.where(left, high[:, 0], low[:, 0])
        assert high[:, 0] - low[:, 0] == pytest.approx(10)
        assert low[:, 2] == pytest.approx(0)
        for k in range(len(houses)):
            (x, y, z, kind), (x_end, y_end, *_) = corners[2 * k : 2 * k + 2]
            assert (x, z, kind) == (pytest.approx(front[k]), 0.12, "building")
            assert (x_end, y, y_end) == pytest.approx((front[k], low[k, 1], high[k, 1]))
        for side in (left, ~left):
            row = np.argsort(low[side, 1])
            first, last = low[side, 1][row], high[side, 1][row]
            starts.append(first[0])
            gaps += (first[1:] - last[:-1]).tolist()
            depths += (last - first)[:-1].tolist()
            assert last[-1] <= 100 + 1e-9
            assert last[-1] > 100 - 8 - 6
            assert first[-1] < 92
        fronts += front.tolist()
        heights += high[:, 2].tolist()
    assert {*np.round(fronts, 6)} == {-36, -45, 9, 17}
    fronts = np.array(fronts)
    for near in (-36, 9):  # two of three stand in front
        side = np.sign(fronts) == np.sign(near)
        assert np.mean(np.isclose(fronts[side], near)) == pytest.approx(2 / 3, abs=0.07)
    for values, low, high in ((gaps, 3, 6), (depths, 10, 16), (heights, 6, 12), (starts, 0, 4)):
        reach = 0.06 * (high - low)
        assert low <= min(values) < low + reach
        assert high - reach < max(values) <= high


def test_poles_stand_on_their_strips_with_their_sizes():
    lamps, offsets = [], []
    for seed in range(40):
        table, shafts = field._poles(100.0, np.random.default_rng(seed))
        assert len(table) == len(shafts) == 24
        x, y = table["x_m"].to_numpy(), table["y_m"].to_numpy()
        strips = np.repeat([-5.6, 5.6, -10.0], 8)
        width = np.repeat([2.6, 2.6, 24.0], 8)
        share = 0.618 * np.arange(24) % 1
        assert x == pytest.approx(strips + np.sign(strips) * width * share)
        offsets += (y - np.tile(np.arange(6.0, 96, 12), 3)).tolist()
        assert (table["z_m"] == 0.12).all()
        for k, (row, shaft) in enumerate(zip(table.itertuples(), shafts, strict=True)):
            lamp = shaft.label == "lamp"
            assert row.name == f"{shaft.label} {k}"
            assert row.diameter_m == (0.14 if lamp else 0.06)
            radius = row.diameter_m / 2
            expected = [[row.x_m, row.y_m, 0.12]] * np.ones((2, 1))
            expected += [[-radius, -radius, 0], [radius, radius, 8.0 if lamp else 3.0]]
            assert box_of(shaft) == pytest.approx(expected)
            lamps.append(lamp)
    assert np.mean(lamps) == pytest.approx(0.6, abs=0.05)
    assert -1.5 <= min(offsets) < -1.45
    assert 1.45 < max(offsets) <= 1.5


def test_field_has_all_things_at_its_origin_and_targets_with_the_surveys_errors():
    plain = STREET
    low = np.array([box_of(one)[0] for one in plain.scene.surfaces]).min(axis=0)
    assert (low - ORIGIN)[1:] == pytest.approx([-30, 0], abs=1e-6)
    assert low[0] - ORIGIN[0] <= -50
    curbs = plain.targets[plain.targets["kind"] == "curb"]
    expected = {(x, y, 0.0) for y in (15, 21, 45, 51, 75, 81) for x in (-3.0, 3.0)}
    places = (curbs[["x_m", "y_m", "z_m"]].to_numpy() - ORIGIN).round(6)
    assert {tuple(one) for one in places} == expected
    assert len(curbs) == 12
    assert (plain.poles["kind"] == "pole").all()
    assert len(plain.poles) == 24
    assert plain.targets["name"].is_unique
    corners = plain.targets[plain.targets["kind"] == "building"]
    assert (corners["z_m"] == 20.12).all()
    assert ((corners["x_m"] - ORIGIN[0]).round(6).isin([-36, -45, 9, 17])).all()
    off = []
    for seed in range(8):
        exact = make_test_field(length_m=100, reference_std_m=0.0, seed=seed)
        noisy = make_test_field(length_m=100, reference_std_m=0.2, seed=seed)
        apart = make_test_field(length_m=100, reference_std_m=0.2, plan_std_m=0.5, seed=seed)
        both = [one.targets[["x_m", "y_m", "z_m"]].to_numpy() - exact.targets[["x_m", "y_m", "z_m"]]
                for one in (noisy, apart)]  # fmt: skip
        off.append([one.to_numpy() for one in both])
        assert (noisy.reference_std_m, noisy.plan_std_m, apart.plan_std_m) == (0.2, 0.2, 0.5)
    for k, std in enumerate((0.2, 0.5)):
        each = np.concatenate([one[k] for one in off])
        assert each[:, :2].std(axis=0) == pytest.approx([std, std], rel=0.12)
        assert not each[:, 2].any()
    with pytest.raises(ValueError, match="Must be >= 40 m"):
        make_test_field(length_m=39.9)
    assert make_test_field(length_m=40).length_m == 40


def test_heights_of_the_ground_are_known_but_at_curbs_and_in_houses():
    y = np.array([5.0, 14.59, 14.61, 18.0, 21.39, 21.41, 30.0])
    bay = [False, False, True, True, True, False, False]
    for side in (-1, 1):
        outer = 37.5 if side < 0 else 8.7
        for along, within in zip(y, bay, strict=True):
            built_out = 15 < along < 21
            edge = 3.0 if built_out else 5.0
            near = min(abs(along - end) for end in (15, 21)) < 0.4
            for x in (0.0, 2.4, 2.6, 2.69, 2.71, 3.29, 3.31, 4.69, 4.71, 5.29, 5.31, 5.49, 5.51,
                      8.69, 8.71, 37.49, 37.51):  # fmt: skip
                expected = np.nan
                if x < edge - 0.3:
                    expected = 20.0
                elif edge + 0.3 < x < outer:
                    expected = 20.12
                if near and abs(x - 4) < 1.5:
                    expected = np.nan
                place = ORIGIN[:2] + [side * x, along]
                found = STREET.height(place[None])[0]
                assert found == pytest.approx(expected, nan_ok=True), (side * x, along)
            assert within in (True, False)


def test_surveyed_ground_is_a_grid_with_errors_of_height_alone():
    ground = STREET.ground(spacing_m=2.0, seed=1)
    x, y = np.arange(-37.5, 9, 2) + 1, np.arange(1, 99, 2) + 1.0
    grid = np.array([(a, b) for b in y for a in x]) + ORIGIN[:2]
    height = STREET.height(grid)
    known = np.isfinite(height)
    off = ground - np.column_stack([grid, height])[known]
    assert np.abs(off).max() < 1e-6
    noisy = make_test_field(length_m=100, reference_std_m=0.3, seed=4).ground(spacing_m=1.0, seed=2)
    plain = STREET.ground(spacing_m=1.0, seed=2)
    assert np.array_equal(noisy[:, :2], plain[:, :2])
    off = noisy[:, 2] - plain[:, 2]
    assert off.std() == pytest.approx(0.3, rel=0.05)
    assert abs(off.mean()) < 0.02


def test_drives_go_there_and_back_on_their_lanes():
    there, back = STREET.drives()
    assert there.position - ORIGIN == pytest.approx(np.array([[2.5, 0, 2.2], [2.5, 100, 2.2]]))
    assert back.position - ORIGIN == pytest.approx(np.array([[-2.5, 100, 2.2], [-2.5, 0, 2.2]]))
    assert there.time.tolist() == [0, 10]
    assert back.time.tolist() == [1000, 1010]
    assert (there.heading[0], back.heading[0]) == (0, 180)


def test_clouds_of_a_drive_have_their_heads_rates_and_the_errors_of_lever_arms():
    head = replace(PRESETS["vq-250"], pulse_rate_hz=600.0, range_noise_m=0.0, divergence_mrad=0.0,
                   exit_diameter_m=0.0, angle_noise_deg=0.0, mirror_frequency_hz=25.0)  # fmt: skip
    still = NavigationErrors()
    one = drive_test_field(STREET, System("one", (head,), still), seed=3)
    assert [cloud["drive"].tolist()[:2] for cloud, _ in one] == [[0, 0], [1, 1]]
    assert not one[0][0]["head"].any()
    error = ((0.1, 0.2, 0.3), (0.0, 0.0, 0.0))
    two = replace(head, heading_deg=90.0)
    plain = drive_test_field(STREET, System("two", (head, two), still), seed=3)
    known = drive_test_field(STREET, System("off", (head, two), still, error), seed=3)
    for number, sign in ((0, 1), (1, -1)):
        cloud, moved = plain[number][0], known[number][0]
        first = cloud["head"] == 0
        assert 0 < first.mean() < 1
        shift = moved.points - cloud.points
        assert shift[first] == pytest.approx(np.array([[0.1 * sign, 0.2 * sign, 0.3]]) * np.ones(
            (first.sum(), 1)), abs=1e-6)  # fmt: skip
        assert np.abs(shift[~first]).max() < 1e-9
    few = drive_test_field(STREET, System("two", (head, two), still), seed=3, pulses_per_s=300)
    assert few[0][0]["pulse"].max() == pytest.approx(1500, rel=0.02)  # of 10 s, for each head
    assert len(few[0][0]) == pytest.approx(len(plain[0][0]) / 4, rel=0.08)
    assert plain[0][0]["pulse"].max() == pytest.approx(6000, rel=0.02)


def test_faces_of_houses_and_walls_between_them_are_those_of_their_outlines():
    made = canyon.canyon(3)
    rows = list(made.buildings[(made.buildings["street"] == 1) & (made.buildings["side"] == -1)]
                .itertuples())  # fmt: skip
    a, b = rows[:2]
    half = canyon_houses.STREETS["width_m"][1] / 2
    near, far = -(half + a.setback_m), -(half + b.setback_m)
    left, right, top = a.start_m, a.start_m + a.width_m, a.height_m
    front, pavement, soffit = canyon_houses.house_faces(a)
    assert front == ((left, near, 0), (right, near, 0), (left, near, top))
    assert pavement == ((left, 0, 0), (right, 0, 0), (left, near, 0))
    assert soffit == ((left, near, top), (right, near, top), (left, pytest.approx(near + 0.6), top))
    # the wall between two neighbours is that of the one in front
    closer, behind, high = (near, far, a.height_m) if near > far else (far, near, b.height_m)
    expected = ((b.start_m, closer, 0), (b.start_m, behind, 0), (b.start_m, closer, high))
    assert canyon_houses.side_face(a, b) == expected
    assert canyon_houses.side_face(None, a) == ((left, near, 0), (left, near - 3, 0),
                                                (left, near, top))  # fmt: skip
    assert canyon_houses.side_face(a, None)[0] == (right, near, 0)
    assert canyon_houses._extent(a) == (left, right, top, near)
    faces, streets = canyon.canyon_faces(made)
    assert len(faces) == 4 * len(made.buildings) + 6  # and one more at the end of each row
    assert np.bincount(streets).sum() == len(faces)
    ends = canyon.canyon_edges(made)
    assert len(ends) == 4 * len(made.buildings)
    assert (ends[::4, :, 2] == 0).all()


def test_drifts_of_a_course_reach_to_the_end_of_every_street():
    found = canyon.positionings((0.7, 0.7), np.random.default_rng(1))
    for course in found.values():
        longest = canyon_houses.STREETS["length_m"].max()
        assert longest <= 5.0 * (course.drift.shape[1] - 1) < longest + 10
    way = canyon._unit_vector(np.random.default_rng(2))
    assert np.linalg.norm(way) == pytest.approx(1)


def test_strays_of_a_survey_are_those_beyond_its_pieces():
    made = canyon.canyon(5).surveys["C2"]
    stray = made.edge < 0
    assert len(made.segments) == len(made.edge) == len(made.interval) == len(made.displacement)
    assert np.isnan(made.interval[stray]).all()
    assert np.isfinite(made.interval[~stray]).all()
