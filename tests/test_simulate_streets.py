"""What stands along a street: the sizes that are stated, from many draws, and where houses are."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.cloud import Cloud
from mmqa_lab.simulate import streets

AT, PLAN = np.array([6.0, 20.0, 0.5]), streets.PLANS["quiet"]


def drawn(build, n=300):
    """The truth of many things of a kind, and their surfaces, crowns without their leaves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streets, "crown", lambda *_: None)
        made = [build(np.random.default_rng(k), AT, 1, PLAN) for k in range(n)]
    return pd.DataFrame([truth for _, truth in made]), [parts for parts, _ in made]


def reaches(values, low, high):
    """Whether values lie within their limits and come near both."""
    near = 0.03 * (high - low)
    return (
        low <= values.min() + 1e-9
        and values.min() < low + near
        and (high - near < values.max() <= high + 1e-9)
    )


def extent_of(surface):
    return (surface.centre - surface.half).min(axis=0), (surface.centre + surface.half).max(axis=0)


def test_poles_have_the_sizes_that_are_stated():
    lamp, _ = drawn(streets._lamp)
    assert reaches(lamp["height_m"], 4.5, 9.0)
    assert reaches(lamp["diameter_base_m"], 0.11, 0.2)
    assert reaches(lamp["diameter_top_m"], 0.06, 0.09)
    sign, _ = drawn(streets._sign)
    assert reaches(sign["height_m"], 2.2, 3.4)
    assert set(sign["diameter_base_m"].round(6)) == {0.06, 0.076, 0.09}
    assert (sign["diameter_top_m"] == sign["diameter_base_m"]).all()
    tree, _ = drawn(streets._tree, 500)
    assert reaches(tree["diameter_base_m"], 0.12, 0.4)
    assert reaches(tree["diameter_top_m"] / tree["diameter_base_m"], 0.6, 0.9)
    low = tree["clear_height_m"] < 1.75
    assert low.mean() == pytest.approx(PLAN.low_crown_share, abs=0.05)
    assert reaches(tree["clear_height_m"][low], 0.7, 1.5)
    assert reaches(tree["clear_height_m"][~low], 2.0, 3.5)
    assert reaches(tree["height_m"] - tree["clear_height_m"], 1.25, 2.5)  # half a crown
    other, _ = drawn(streets._other, 500)
    high = other["height_m"] > 2
    assert high.mean() == pytest.approx(0.6, abs=0.07)
    assert reaches(other["height_m"][high], 3.0, 9.0)
    assert reaches(other["diameter_base_m"][high], 0.1, 0.3)
    assert reaches((other["diameter_top_m"] / other["diameter_base_m"])[high], 0.6, 1.0)
    assert reaches(other["height_m"][~high], 1.1, 1.5)
    assert reaches(other["diameter_base_m"][~high], 0.05, 0.18)
    assert (other["diameter_top_m"] == other["diameter_base_m"])[~high].all()


def test_poles_lean_as_much_as_stated():
    for build, degrees in ((streets._lamp, 1.0), (streets._tree, 2.5)):
        truth, _ = drawn(build)
        lean = np.degrees(np.arctan(truth[["lean_x", "lean_y"]].to_numpy()))
        assert lean.std() == pytest.approx(degrees, rel=0.08)
        assert np.abs(lean.mean(axis=0)).max() < 0.15 * degrees


def test_boards_of_signs_face_along_the_road_and_every_third_has_a_second():
    _, parts = drawn(streets._sign)
    boards = [one[1] for one in parts]
    assert np.mean([len(one) > 1 for one in boards]) == pytest.approx(0.35, abs=0.06)
    # a board that faces along the road is wide across it
    ratio = [one.half[0, 1] / one.half[0, 0] for one in boards]
    assert np.median(ratio) < 0.2


def test_a_crown_has_leaves_that_stop_a_ray_as_often_as_stated():
    radii = np.array([1.0, 1.5, 2.0])
    made = streets.crown((0, 0, 5), radii, 1.5, 3)
    low, high = extent_of(made)
    assert np.abs(np.array([low, high]) - ([0, 0, 5] + radii * [[-1], [1]])).max() < 0.25
    # n leaves of one orientation each show half of their area on average to a ray
    shown = len(made) * np.pi * streets.LEAF_RADIUS_M**2 / 2
    assert shown / (4 / 3 * np.pi * np.prod(radii)) == pytest.approx(0.8 * 1.5, rel=0.01)


def test_cars_people_and_hedges_have_their_sizes_and_places():
    rng, at = np.random.default_rng(1), np.array([3.0, 9.0, 0.0])
    cars = np.array([np.ptp(extent_of(streets._car(rng, at)), axis=0) for _ in range(300)])
    vans = cars[:, 0] > 1.9
    assert vans.mean() == pytest.approx(0.25, abs=0.06)
    assert cars[vans, 0] == pytest.approx(2.0)
    assert cars[~vans, 0] == pytest.approx(1.8)
    assert reaches(cars[~vans, 1], 4.0, 5.2)
    assert cars[vans, 1].min() >= 4.8
    assert 5.8 < cars[vans, 1].max() <= 6.0
    assert cars[~vans, 2] == pytest.approx(0.6 + 0.55)
    assert cars[vans, 2].min() >= 1.9
    assert 2.4 < cars[vans, 2].max() <= 2.5
    lows = {round(float(extent_of(streets._car(rng, at))[0][2]), 6) for _ in range(60)}
    assert lows == {0.25, 0.3}  # above the road
    people = [extent_of(streets.pedestrian(rng, at)) for _ in range(400)]
    assert reaches(np.array([high[2] for _, high in people]), 1.55, 1.9)
    wide = np.array([high[0] - low[0] for low, high in people])
    assert wide.min() >= 0.36
    assert wide.max() <= 0.56
    hedges = [extent_of(streets._hedge(rng, at)) for _ in range(8)]
    assert all(abs(low[2]) < 0.3 for low, _ in hedges)
    assert all(1.0 < high[2] < 2.6 for _, high in hedges)
    assert all(4.5 < high[1] - low[1] < 18.7 for low, high in hedges)
    assert all(0.4 < high[0] - low[0] < 1.3 for low, high in hedges)


def test_things_beside_the_road_come_as_often_as_the_plan_says_and_where():
    plan = streets.Plan(cars_per_100m=30, pedestrians_per_100m=20, hedges_per_100m=0)
    made = list(streets._clutter(plan, 400.0, 7))
    kinds = {kind: [one for one in made if one.label == kind] for kind in ("car", "pedestrian")}
    assert len(kinds["car"]) == pytest.approx(120, abs=33)
    assert len(kinds["pedestrian"]) == pytest.approx(80, abs=27)
    for kind, low, high in (("car", 2.6, 3.2), ("pedestrian", 4, 9)):
        middle = np.array([np.mean(extent_of(one), axis=0) for one in kinds[kind]])
        assert low <= np.abs(middle[:, 0]).min()
        assert np.abs(middle[:, 0]).max() <= high
        assert 0.3 < (middle[:, 0] > 0).mean() < 0.7
        assert middle[:, 1].min() + 1 >= 0
        assert middle[:, 1].max() > 380
    assert len(list(streets._clutter(streets.Plan(hedges_per_100m=0), 10.0, 7))) < 5


@pytest.mark.parametrize("side", [1, -1])
def test_a_house_has_its_front_its_ends_and_what_stands_before_it(side):
    plan = streets.Plan(columns_per_100m=20, pipes_per_100m=20)
    heights, columns, pipes = [], 0, 0
    for seed in range(4, 14):
        parts = streets._building(np.random.default_rng(seed), side, 15.0, 30.0, 40.0, plan)
        by = {
            label: [p for p in parts if p.label == label] for label in ("facade", "column", "pipe")
        }
        low, high = (np.array(end) for end in zip(*map(extent_of, by["facade"]), strict=True))
        low, high = low.min(axis=0), high.max(axis=0)
        # from 30 to 70 m, 10 m deep behind the front with its reveals, 20 cm below the road
        assert (low[1], high[1], low[2]) == pytest.approx((30, 70, -0.2))
        ends = sorted([abs(low[0]), abs(high[0])])
        assert ends == pytest.approx([15, 25], abs=1e-9)
        heights.append(round(high[2] + 0.2, 6))
        for column in by["column"]:
            low, high = extent_of(column)
            assert high[2] - low[2] == pytest.approx(2.8, abs=1e-6)
            assert 0.1 <= (high[0] - low[0]) / 2 <= 0.2 + 1e-9
            assert 0.2 - 1e-9 <= 15 - abs(low[0] + high[0]) / 2 <= 1.2
            assert 30.5 <= (low[1] + high[1]) / 2 <= 69.5
        for pipe in by["pipe"]:
            low, high = extent_of(pipe)
            assert (high[0] - low[0]) / 2 == pytest.approx(0.05)
            assert 15 - abs(low[0] + high[0]) / 2 == pytest.approx(0.09)
            assert high[2] + 0.2 == pytest.approx(heights[-1])
        columns, pipes = columns + len(by["column"]), pipes + len(by["pipe"])
    assert {*heights} == {3.8, 6.8, 9.8, 12.8}  # one to four floors of 3 m and 80 cm
    assert columns / 10 == pytest.approx(8, abs=2.5)
    assert pipes / 10 == pytest.approx(8, abs=2.5)


def test_visible_poles_have_points_lines_and_a_height(rng):
    rows = []
    targets = {"surface": [1, 2, 3, 4, 5], "x_m": [3.0, -4, 5, 6, 7], "z_base_m": 0.5}
    targets = pd.DataFrame(targets | {"clear_height_m": [4.0, 4, 4, 4, 0.9]})
    for surface, n, lines, high in ((1, 40, 8, 4), (2, 9, 9, 4), (3, 40, 4, 4), (5, 40, 8, 4)):
        z = np.r_[0.5, 0.5 + high * rng.random(n - 2), 0.5 + high]
        rows += [(surface, k % lines, one) for k, one in enumerate(z)]
    rows += [(1, 50, 4.6), (9, 1, 1.0)]  # in the crown, and of something else
    table = pd.DataFrame(rows, columns=["surface", "scan_line", "z"])
    points = np.column_stack([0 * table["z"], 0 * table["z"], table["z"]])
    cloud = Cloud(points, {name: table[name].to_numpy() for name in ("surface", "scan_line")})
    found = streets.visible_targets(SimpleNamespace(targets=targets), cloud, minimum_sweeps=5)
    assert found["distance_m"].tolist() == [3, 4, 5, 6, 7]
    for row in found.itertuples():
        own = table[table["surface"] == row.surface]
        own = own[own["z"] <= 0.5 + row.clear_height_m]
        span = np.ptp(np.quantile(own["z"], [0.02, 0.98])) if len(own) else 0.0
        assert (row.points, row.sweeps) == (len(own), own["scan_line"].nunique())
        assert row.span_m == pytest.approx(span)
    assert found["visible"].tolist() == [True, False, False, False, False]


def test_signs_face_along_the_road_within_eight_degrees():
    _, parts = drawn(streets._sign, 600)
    normals = np.array([one[1].shape[0, 6:8] for one in parts])
    off = np.degrees(np.arctan(normals[:, 0] / normals[:, 1]))
    assert off.std() == pytest.approx(8, rel=0.1)
    assert abs(off.mean()) < 1.5
    assert np.mean(normals[:, 1] > 0) == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize("kind", ["lamp", "sign", "other", "tree"])
def test_feet_stand_at_the_road_or_among_the_yards_as_often_as_the_plan_says(kind):
    plan = streets.Plan(far_share=0.6)
    rng = np.random.default_rng(3)
    feet = np.array([streets._foot(rng, kind, side, 80.0, plan) for side in (1, -1) * 1500])
    assert (feet[::2, 0] > 0).all()
    assert (feet[1::2, 0] < 0).all()
    assert not feet[:, 2].any()
    assert reaches(feet[:, 1], 0, 80)
    across = np.abs(feet[:, 0])
    far = across > streets.FAR_M
    assert reaches(across[far], 12.5, 29)
    beside = kind in ("lamp", "sign")
    assert reaches(across[~far], 4, 7 if beside else 12)
    assert far.mean() == pytest.approx(0.18 if beside else 0.6, abs=0.03)


@pytest.mark.parametrize("side", [1, -1])
def test_a_foot_is_inside_a_building_up_to_eight_decimetres_from_it(side):
    block = side, 15.0, 30.0, 12.0
    within = [(14.21, 36), (40, 36), (20, 29.21), (20, 42.79)]
    beside = [(14.19, 36), (20, 29.19), (20, 42.81), (-20, 36)]
    for x, y in within + beside:
        inside = (x, y) in within
        assert streets._inside((side * x, y), block) == inside


def test_buildings_stand_in_rows_with_gaps_at_their_setbacks():
    plan = streets.Plan(building_share=0.5, setback_m=(12.0, 26.0))
    found = [streets._buildings(plan, 200.0, seed) for seed in range(40)]
    every = streets._buildings(streets.Plan(building_share=1.0), 200.0, 1)
    sizes, setbacks = (np.array([[one[k] for made in found for one in made]][0]) for k in (3, 1))
    assert reaches(sizes, 10, 26)
    assert reaches(setbacks, 12, 26)
    for side in (-1, 1):
        row = [(start, size) for one, _, start, size in every if one == side]
        assert row[0][0] == -20
        assert row[-1][0] < 220 <= row[-1][0] + row[-1][1] + 10
        gaps = [b[0] - a[0] - a[1] for a, b in pairwise(row)]
        assert 2 <= min(gaps) <= max(gaps) <= 10
    # a house and a gap take 24 m on average, the last one begins before 220 m
    count = np.mean([len(made) for made in found])
    assert count == pytest.approx(0.5 * 2 * (240 / 24 + 0.7), rel=0.08)


def test_poles_keep_clear_of_buildings_and_of_each_other_and_have_shrubs(monkeypatch):
    monkeypatch.setattr(streets, "crown", lambda *given: SimpleNamespace(label=given[-1]))
    plan = streets.Plan(trees_per_100m=60, signs_per_100m=40, lamps_per_100m=40,
                        others_per_100m=60, shrub_share=0.35, thicket_share=0.6)  # fmt: skip
    block = (1, 15.0, 30.0, 60.0)
    bushes, kinds, sides = [], [], []
    for seed in range(6):
        found = list(streets._poles(plan, 120.0, seed, [block]))
        feet = []
        for parts, truth in found:
            height = truth["height_m"]
            foot = np.array([truth["x_m"] - truth["lean_x"] * height / 2,
                             truth["y_m"] - truth["lean_y"] * height / 2])  # fmt: skip
            feet.append(foot)
            assert not streets._inside(foot, block)
            labels = [one.label for one in parts]
            bushes.append(("shrub" in labels, "thicket" in labels, abs(foot[0]) >= 12.5))
            assert parts[0].label == truth["class"]
            kinds.append(truth["class"])
            sides.append(np.sign(foot[0]))
        apart = np.linalg.norm(np.array(feet)[:, None] - feet, axis=2)
        assert apart[np.triu_indices(len(feet), 1)].min() >= 1
    bushes = np.array(bushes)
    assert bushes[:, 0].mean() == pytest.approx(0.35, abs=0.06)
    assert bushes[bushes[:, 2], 1].mean() == pytest.approx(0.6, abs=0.08)
    assert not bushes[~bushes[:, 2], 1].any()
    open_ = np.array(kinds)[np.array(sides) < 0]  # where no building stands; some are crowded
    for kind, rate in (("lamp", 40), ("sign", 40), ("other", 60), ("tree", 60)):
        expected = 6 * 0.5 * rate * 1.2
        assert 0.7 * expected < (open_ == kind).sum() < 1.15 * expected


@pytest.mark.parametrize(("kind", "limits"), streets.BUSHES.items())
def test_bushes_grow_around_a_foot(kind, limits, monkeypatch):
    given = []
    monkeypatch.setattr(streets, "crown", lambda *args: given.append(args))
    for seed in range(400):
        streets._bush(np.random.default_rng(seed), AT, kind)
    middles, radii = (np.array([one[k] for one in given]) for k in (0, 1))
    assert np.array_equal(radii[:, 0], radii[:, 1])
    low, high = limits
    assert reaches(radii[:, 0], low[0], high[0])
    assert reaches(2 * radii[:, 2], low[1], high[1])
    assert reaches(np.array([one[2] for one in given]), low[2], high[2])
    assert middles[:, 2] == pytest.approx(AT[2] + radii[:, 2])
    off = middles[:, :2] - AT[:2]
    assert off.std(axis=0) == pytest.approx([0.2, 0.2], rel=0.12)
    assert np.abs(off.mean(axis=0)).max() < 0.03
    assert {one[4] for one in given} == {kind}


def test_leaves_of_a_tree_fill_its_crown_above_the_clear_height(monkeypatch):
    given = []
    monkeypatch.setattr(streets, "crown", lambda *args: given.append(args))
    for seed in range(300):
        _, truth = streets._tree(np.random.default_rng(seed), AT, 1, PLAN)
        middle, radii, density, _ = given[-1]
        assert middle == pytest.approx(AT + [0, 0, truth["clear_height_m"] + radii[2]])
        assert radii[0] == radii[1]
        assert density == 1
        assert truth["height_m"] == pytest.approx(truth["clear_height_m"] + radii[2])
    radii = np.array([one[1] for one in given])
    assert reaches(radii[:, 0], 1.0, 2.4)
    assert reaches(2 * radii[:, 2], 2.5, 5.0)


def test_lamps_reach_over_the_road_and_their_head_hangs_there():
    arms = []
    for side in (1, -1):
        for seed in range(200):
            (post, head), truth = streets._lamp(np.random.default_rng(seed), AT, side, None)
            top = AT + truth["height_m"] * np.array([truth["lean_x"], truth["lean_y"], 1])
            tip = head.centre[1:].mean(axis=0) + [0, 0, 0.025]  # of a box of 15 cm, 10 cm lower
            reach = (top - tip) * [side, 1, 1]
            assert reach[1:] == pytest.approx([0, -0.2], abs=1e-9)
            arms.append(reach[0])
            assert post.reflectance[0] == 0.35
            assert np.ptp(head.centre[1:, 0]) == pytest.approx(0.6)
            assert np.ptp(head.centre[1:, 1]) == pytest.approx(0.25)
            assert np.ptp(head.centre[1:, 2]) == pytest.approx(0.15)
    assert reaches(np.array(arms), 0.3, 2.0)


def test_panes_lie_five_to_thirty_centimetres_from_their_front():
    depths = []
    for seed in range(150):
        parts = streets._building(np.random.default_rng(seed), 1, 15.0, 0.0, 12.0, PLAN)
        panes = [one for one in parts if one.label == "pane"]
        depths += [abs(one.centre[0, 0] - 15) for one in panes[:1]]
    assert reaches(np.array(depths), 0.05, 0.3)


def test_a_crown_has_a_leaf_at_least():
    assert len(streets.crown((0, 0, 0), (0.05, 0.05, 0.05), 0.1, 1)) == 1
