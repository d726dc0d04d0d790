"""The canyon: where its houses and edges are, how its courses err, what its surveys cut and add."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.simulate import canyon, canyon_houses

MADE = canyon.canyon(3)


def lengths(ends):
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def test_houses_stand_side_by_side_along_both_sides_of_their_streets():
    houses, streets = MADE.buildings, canyon_houses.STREETS
    assert houses["width_m"].between(8.9, 22).all()
    assert houses["height_m"].between(12, 21).all()
    for (street, _), row in houses.groupby(["street", "side"]):
        ends = row["start_m"] + row["width_m"]
        assert 0 <= row["start_m"].iloc[0] <= 5
        assert row["start_m"].to_numpy()[1:] == pytest.approx(ends.to_numpy()[:-1])
        assert streets["length_m"][street] - 9 <= ends.iloc[-1] <= streets["length_m"][street]
        assert (np.diff(row["setback_m"]) != 0).all()


def test_the_outline_of_a_house_is_its_facade():
    house = next(MADE.buildings.itertuples())
    offset = house.side * (canyon_houses.STREETS["width_m"][house.street] / 2 + house.setback_m)
    left, right = house.start_m, house.start_m + house.width_m
    low, high, *corners = canyon_houses.house_outline(house)
    assert low == ((left, offset, 0), (right, offset, 0))
    assert high == ((left, offset, house.height_m), (right, offset, house.height_m))
    assert corners == [(low[0], high[0]), (low[1], high[1])]


def test_edges_of_a_facade_lie_in_it_with_a_level_above_the_ground_floor():
    house = max(MADE.buildings.itertuples(), key=lambda one: one.width_m)
    offset = house.side * (canyon_houses.STREETS["width_m"][house.street] / 2 + house.setback_m)
    outline, levels, jambs = canyon_houses.house_outline(house), [], 0
    for seed in range(400):
        for line in canyon_houses._building_edges(house, np.random.default_rng(seed)):
            (a, off_a, low), (b, off_b, high) = line
            assert off_a == off_b == offset
            if line in outline:
                continue
            if low == high:
                levels.append(low)
                assert (a, b) == (house.start_m, house.start_m + house.width_m)
            else:
                jambs += 1
                assert a == b
                assert house.start_m + 1 <= a <= house.start_m + house.width_m - 1
                assert 1 <= low <= house.height_m - 4
                assert 1.5 <= high - low <= 2.5
    assert 3.5 <= min(levels) < 3.55 < 4.45 < max(levels) <= 4.5
    assert jambs / 400 == pytest.approx(canyon_houses.JAMBS, abs=0.08)


def test_places_along_a_street_are_found_again_from_their_coordinates(rng):
    street = rng.integers(0, len(canyon_houses.STREETS), 50)
    places = rng.uniform(0, 20, (50, 1, 3))
    points = canyon_houses.located(street, places)[:, 0]
    assert canyon_houses.station_along(points, street) == pytest.approx(places[:, 0, 0])
    assert points[:, 2] == pytest.approx(places[:, 0, 2])
    origin = canyon_houses.STREETS.loc[street, ["x_m", "y_m"]].to_numpy()
    assert np.abs(points[:, :2] - origin).sum(axis=1) == pytest.approx(places[:, 0, :2].sum(axis=1))


def test_twins_are_parallel_three_to_eleven_decimetres_aside(rng):
    ends = rng.normal(size=(300, 2, 3)) * 5
    moved = canyon_houses._twins(ends, rng) - ends
    assert moved[:, 0] == pytest.approx(moved[:, 1])
    away = np.linalg.norm(moved[:, 0], axis=1)
    assert 0.3 <= away.min() < 0.32 < 1.08 < away.max() <= 1.1
    along = ((ends[:, 1] - ends[:, 0]) * moved[:, 0]).sum(axis=1)
    assert np.abs(along).max() < 1e-9


def test_a_course_errs_by_its_bias_its_drift_between_nodes_and_its_turn(rng):
    drift = rng.normal(size=(3, 40, 3))
    course = canyon.Positioning(np.array([0.5, -0.2, 0.1]), drift, 0.01)
    street = np.array([0, 1, 2, 1])
    station = np.array([12.0, 0.0, 7.5, 33.0])
    points = canyon_houses.located(
        street, np.column_stack([station, 0 * station, station])[:, None]
    )
    points = points[:, 0]
    found = course.at(points, street)
    for k in range(4):
        between = [np.interp(station[k], 5.0 * np.arange(40), drift[street[k], :, j])
                   for j in range(3)]  # fmt: skip
        x, y = points[k, :2] - canyon.CENTRE_M[:2]
        turned = [-0.01 * y, 0.01 * x, 0]
        assert found[k] == pytest.approx(np.array([0.5, -0.2, 0.1]) + between + turned)


def test_pieces_lie_in_their_edge_and_are_cut_as_often_as_stated():
    rng = np.random.default_rng(4)
    pieces = [canyon._pieces(10.0, rng) for _ in range(8000)]
    whole = np.array([[one[0][0], one[-1][1]] for one in pieces])
    assert whole.min() >= 0
    assert whole.max() <= 10
    cut = np.ptp(whole, axis=1) < 10
    assert cut.mean() == pytest.approx(canyon.TRUNCATIONS, abs=0.02)
    kept = np.ptp(whole[cut], axis=1)
    assert 4 <= kept.min() < 4.05 < 8.95 < kept.max() <= 9
    two = np.array([[*a, *b] for a, b in (one for one in pieces if len(one) == 2)])
    assert len(two) / 8000 == pytest.approx(canyon.SPLITS, abs=0.015)
    gaps, middle = two[:, 2] - two[:, 1], (two[:, 1] + two[:, 2]) / 2
    assert 0.2 <= gaps.min() < 0.22 < 0.98 < gaps.max() <= 1.0
    share = (middle - two[:, 0]) / (two[:, 3] - two[:, 0])
    assert 0.3 <= share.min() < 0.31 < 0.69 < share.max() <= 0.7
    assert all(len(canyon._pieces(2.9, rng)) == 1 for _ in range(200))


def test_clutter_is_level_or_upright_in_three_of_four_and_anywhere():
    ends = canyon._clutter(4000, np.random.default_rng(1))
    middle, way = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
    assert middle.max(axis=0) == pytest.approx([130, 120, 12], rel=0.02)
    assert middle.min(axis=0) == pytest.approx([0, 0, 0], abs=0.3)
    assert 1.5 <= lengths(ends).min() < 1.55 < 9.95 < lengths(ends).max() <= 10
    along = np.abs(way).max(axis=1) / lengths(ends) > 1 - 1e-9
    assert along.mean() == pytest.approx(0.75, abs=0.03)


def test_noise_turns_ends_and_places_by_what_is_stated():
    rng = np.random.default_rng(2)
    ends = np.tile([[[0.0, 0, 0], [8, 0, 0]]], (20_000, 1, 1))
    found = canyon._noisy(ends, 0.5, 0.04, rng)
    way = found[:, 1] - found[:, 0]
    angle = np.arctan2(np.hypot(way[:, 1], way[:, 2]), way[:, 0])
    # in space both parts together have the angle's deviation, and places move by less than it
    stated = np.hypot(np.radians(0.5), canyon.ANGLE_FROM_POSITION_M / 8)
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(stated, rel=0.02)
    end = lengths(found) - 8
    assert end.std() == pytest.approx(np.sqrt(2) * canyon.END_NOISE_M, rel=0.03)
    assert abs(end.mean()) < 0.01
    beside = found.mean(axis=1)[:, 2]
    assert beside.std() == pytest.approx(0.04, rel=0.03)
    short = canyon._noisy(ends[:500] / 80, 0.5, 0.04, rng)
    assert lengths(short).min() >= 0.5 - 1e-9


def test_surveys_find_their_shares_and_the_courses_share_their_way():
    seen = canyon.seen(60_000, np.random.default_rng(5))
    both = canyon.SHARED_COURSE * canyon.SHARED_SEEN
    shares = {"C1": both, "C3": both, **canyon.SEEN}
    for name, share in shares.items():
        assert seen[name].mean() == pytest.approx(share, abs=0.01), name
    assert (seen["C1"] & seen["C3"]).mean() == pytest.approx(both * canyon.SHARED_SEEN, abs=0.01)
    # prominence is uniform about 1 by .75, so two surveys meet in 1 + .75^2 / 3 of chance
    twice = seen["C2"] & seen["TLS"]
    expected = canyon.SEEN["C2"] * canyon.SEEN["TLS"] * (1 + 0.75**2 / 3)
    assert twice.mean() == pytest.approx(expected, rel=0.04)


def test_courses_share_a_displacement_and_have_one_of_their_own():
    found = [canyon.positionings((0.7, 0.7), np.random.default_rng(k)) for k in range(200)]
    for one in found:
        own = {name: np.linalg.norm(course.bias) for name, course in one.items()}
        assert own["TLS"] == 0 == np.abs(one["TLS"].drift).max() == one["TLS"].yaw
        assert abs(own["C1"] - 0.7) <= canyon.OWN_BIAS_M + 1e-9
        assert abs(own["C2"] - 0.7 - canyon.COURSE2_M) <= canyon.OWN_BIAS_M + 1e-9
    apart = [np.linalg.norm(one["C1"].bias - one["C3"].bias) for one in found]
    assert np.sqrt(np.mean(np.square(apart))) == pytest.approx(
        np.sqrt(2) * canyon.OWN_BIAS_M, rel=0.1
    )
    yaw = [np.degrees(one[name].yaw) for one in found for name in ("C1", "C2", "C3")]
    assert np.std(yaw) == pytest.approx(canyon.YAW_DEG, rel=0.1)
    drift = np.array([one["C1"].drift for one in found])
    assert drift.std() == pytest.approx(canyon.DRIFT_M, rel=0.05)
    # a Gauss-Markov process of 60 m: neighbours 5 m apart have exp(-1/12) in common
    pairs = drift[:, :, :-1].ravel(), drift[:, :, 1:].ravel()
    assert np.corrcoef(*pairs)[0, 1] == pytest.approx(np.exp(-1 / 12), abs=0.02)


def test_found_segments_are_parts_of_their_edges_but_for_the_stated_errors():
    survey = MADE.surveys["C1"]
    own = survey.edge >= 0
    assert 0.02 < 1 - own.mean() < 0.2
    edges, interval = MADE.edges[survey.edge[own]], survey.interval[own]
    along = (edges[:, 1] - edges[:, 0]) / lengths(edges)[:, None]
    part = edges[:, :1] + interval[:, :, None] * along[:, None]
    off = survey.segments[own].mean(axis=1) - survey.displacement[own] - part.mean(axis=1)
    across = off - (off * along).sum(axis=1, keepdims=True) * along
    noise = canyon.POSITION_NOISE_M["C1"]
    assert np.sqrt((across**2).sum(axis=1).mean() / 2) == pytest.approx(noise, rel=0.2)
    assert np.isnan(survey.interval[~own]).all()


def test_clouds_lie_on_their_faces_with_the_density_asked_for():
    cloud = canyon.canyon_cloud(MADE, "TLS", density=0.5, noise=0.0)
    faces, _ = canyon.canyon_faces(MADE)
    corner, along, up = faces[cloud["face"]].transpose(1, 0, 2)[:3]
    along, up, local = along - corner, up - corner, cloud.points - corner
    normal = np.cross(along, up)
    assert np.abs((local * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)).max() < 1e-9
    # faces are parallelograms: both shares run evenly from 0 to 1
    shares = [np.linalg.lstsq(np.stack([a, b], axis=1), c)[0]
              for a, b, c in zip(along[::20], up[::20], local[::20], strict=True)]  # fmt: skip
    shares = np.array(shares)
    assert shares.min() > -1e-9
    assert shares.max() < 1 + 1e-9
    assert shares.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.03)
    sizes = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    assert len(cloud) == pytest.approx(0.5 * sizes.sum(), abs=4 * np.sqrt(0.5 * sizes.sum()))
    counts = pd.Series(cloud["face"]).value_counts().reindex(range(len(faces)), fill_value=0)
    large = sizes > 200
    assert np.abs(counts[large] / sizes[large] - 0.5).max() < 0.4


def test_a_terrestrial_survey_turns_its_edges_a_quarter_as_much_as_a_mobile_one():
    ends = np.tile([[[0.0, 50, 1], [200, 50, 1]]], (3000, 1, 1))
    still = canyon.Positioning(np.zeros(3), np.zeros((len(canyon_houses.STREETS), 60, 3)), 0.0)
    turns = {}
    for name in ("TLS", "C1"):
        made = canyon.survey(name, ends, np.zeros(3000, int), np.arange(3000), still, 2.0,
                             np.random.default_rng(7))  # fmt: skip
        found = made.segments[made.edge >= 0]
        way = found[:, 1] - found[:, 0]
        turns[name] = np.degrees(np.hypot(way[:, 1], way[:, 2]) / np.abs(way[:, 0]))
        assert (made.edge < 0).mean() == pytest.approx(
            canyon.CLUTTER / (1 + canyon.CLUTTER), abs=0.02
        )
        assert np.sort(np.unique(made.edge[made.edge >= 0])).tolist() == [*range(3000)]
    assert np.sqrt(np.mean(turns["C1"] ** 2)) == pytest.approx(2.0, rel=0.05)
    assert np.sqrt(np.mean(turns["TLS"] ** 2)) == pytest.approx(0.5, rel=0.05)
