"""The three detectors: hand-made scenes, a simulated street, invariances, measures, trees."""

import tracemalloc
from functools import cache

import numpy as np
import pandas as pd
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from mmqa_lab import poles
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import axes, common, fgi, itc, learned, measures
from mmqa_lab.poles.learned import FILE, OF_STREETS, read
from mmqa_lab.simulate import streets


def post(x, y, *, radius=0.05, height=3.0, low=0.0, line=0):
    """Front half of a post: a scan line every 0.1 m of height, points every 1.5 cm."""
    rise = np.arange(low, low + height, 0.1)
    turn = np.linspace(0, np.pi, max(int(np.pi * radius / 0.015), 4))
    h, t = np.meshgrid(rise, turn, indexing="ij")
    points = [x + radius * np.cos(t), y - radius * np.sin(t), h]
    lines = line + np.repeat(np.arange(len(rise)), len(turn))
    return np.stack(points, axis=-1).reshape(-1, 3), lines


def floor(size=12.0, step=0.1):
    """Level ground."""
    x, y = np.mgrid[-size / 2 : size / 2 : step, -size / 2 : size / 2 : step]
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def scene(*parts, rng=None):
    """A cloud with scan lines of posts and walls on a floor."""
    points = np.concatenate([floor(), *(p for p, _ in parts)])
    line = np.concatenate([np.full(len(floor()), -1000), *(n for _, n in parts)])
    noise = 0 if rng is None else rng.normal(0, 0.002, points.shape)
    columns_ = {"scan_line": line, "pulse": np.arange(len(points))}
    return Cloud(points + noise, columns_)


def wall(x0, x1, y, height=4.0, line=0):
    """A wall along x, a scan line every 0.1 m, points every 5 cm."""
    rise, along = np.arange(0, height, 0.1), np.arange(x0, x1, 0.05)
    h, a = np.meshgrid(rise, along, indexing="ij")
    points = np.stack([a, np.full_like(a, y), h], axis=-1).reshape(-1, 3)
    return points, line + np.repeat(np.arange(len(rise)), len(along))


@pytest.fixture(scope="module")
def street():
    """A short street, its cloud and its visible targets."""
    made = streets.street("quiet", length=45, seed=3)
    cloud = streets.drive(made, "roamer", seed=3)
    return made, cloud, streets.visible_targets(made, cloud)


@pytest.fixture(scope="module")
def detected(street):
    """What a method finds in the street's cloud."""
    return cache(lambda method: poles.detect(street[1], method=method))


@pytest.mark.parametrize("method", poles.METHODS)
def test_a_post_is_found_and_a_wall_is_not(method, rng):
    cloud = scene(post(1.0, 2.0), wall(-4, 4, -3, line=100), rng=rng)
    one = poles.detect(cloud, method=method).squeeze()
    # the published methods take the middle of what is seen, the front half of a post of 0.1 m
    assert np.hypot(one["x_m"] - 1.0, one["y_m"] - 2.0) < (0.01 if method == "learned" else 0.06)
    assert 2.0 < one["height_m"] <= 3.25
    assert one["tilt_deg"] < 3
    assert one["method"] == method


@pytest.mark.parametrize("method", poles.METHODS)
def test_a_short_post_is_none(method, rng):
    assert len(poles.detect(scene(post(0, 0, height=0.7), rng=rng), method=method)) == 0


@pytest.mark.parametrize("method", poles.METHODS)
def test_order_and_whole_metres_change_nothing(street, detected, method):
    _, cloud, _ = street
    shift = np.array([3e5, 5e6, 128.0])
    order = np.random.default_rng(1).permutation(len(cloud))
    other = poles.detect(Cloud(cloud.points + shift, cloud.columns)[order], method=method)
    found = detected(method).copy()
    assert len(found) == len(other) > 3
    found[["x_m", "y_m", "z_base_m"]] += shift
    numbers = found.select_dtypes("number").columns
    # float64 at 5e6 m keeps 1e-9 m; means of other sums are rounded to 1e-4 before the trees
    assert np.allclose(found[numbers], other[numbers], atol=1e-5, equal_nan=True)


def test_places_of_the_grid_and_copies_of_points_change_few_finds(street, detected):
    _, cloud, _ = street
    found = detected("learned")
    axes = found[["x_m", "y_m"]].to_numpy()
    for points, where in (
        (cloud.points + [0.013, 0.017, 0.011], axes + [0.013, 0.017]),
        (np.repeat(cloud.points, 2, axis=0), axes),
    ):
        other = poles.detect(points)[["x_m", "y_m"]].to_numpy()
        assert abs(len(other) - len(found)) <= 1
        away = np.hypot(*(where[:, None] - other).transpose(2, 0, 1))
        assert (away.min(axis=1) < 0.05).mean() > 0.7


@settings(max_examples=5, deadline=None)
@given(st.floats(0, 360), st.floats(-50, 50), st.sampled_from([(), (4e5, -3e5, 20.0)]))
def test_a_turned_and_moved_cloud_has_the_same_finds(street, detected, turn, step, far):
    turn, found = np.radians(turn), detected("learned")
    plan = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = np.vstack([street[1].points, np.reshape(far, (-1, 3))])
    other = poles.detect(np.column_stack([points[:, :2] @ plan + step, points[:, 2]]))
    assert len(other) == len(found) > 3
    there = (other[["x_m", "y_m"]].to_numpy() - step) @ plan.T
    order = cKDTree(there).query(found[["x_m", "y_m"]])[1]
    off = 0.01 if far else 1e-4  # one stray may move the frame by a fraction of a spacing
    assert there[order] == pytest.approx(found[["x_m", "y_m"]].to_numpy(), abs=off)
    lean = other[["lean_x", "lean_y"]].to_numpy()[order] @ plan.T
    assert lean == pytest.approx(found[["lean_x", "lean_y"]].to_numpy(), abs=off)
    same = ["z_base_m", "height_m", "section_m", "score"]
    assert other[same].to_numpy()[order] == pytest.approx(found[same].to_numpy(), abs=10 * off)


@pytest.mark.parametrize(
    ("method", "recall", "precision"), [("fgi", 0.6, 0.5), ("learned", 0.85, 0.8)]
)
def test_rates_on_a_street_never_trained_on(street, detected, method, recall, precision):
    made, _, targets = street
    path = made.trajectory().position
    result = poles.score(detected(method), targets, corridor=15, trajectory=path)
    # about 10 targets: loose on purpose, the study measures
    assert result.recall.value >= recall
    assert result.precision.value >= precision


@pytest.mark.parametrize("radius", [0.05, 0.15, 0.3])
def test_the_axis_is_the_axis_and_not_the_middle_of_what_is_seen(radius, rng):
    found = poles.detect(scene(post(0.5, 1.0, radius=radius), rng=rng)).squeeze()
    # the middle of half a circle lies 2 / pi radii before its centre: 0.19 m for the widest
    assert np.hypot(found["x_m"] - 0.5, found["y_m"] - 1.0) < 0.01
    assert found["diameter_low_m"] <= 2 * radius + 0.005
    assert found["diameter_high_m"] >= 2 * radius - 0.005


def test_explain_names_the_test_that_rejected_and_adds_up(rng):
    cloud = scene(post(0, 0), post(3, 0, height=0.7, line=200), wall(-4, 4, -3, line=400), rng=rng)
    table = poles.detect(cloud, explain=True)
    assert (table["rejected_by"] == "").sum() == 1
    assert set(table["rejected_by"]) <= {"", "score", "length", "tilt", "duplicate"}
    trees = learned.shipped()
    parts = table[[f"adds_{name}" for name in learned.MEASURES]].sum(axis=1)
    odds = parts + trees.parts(table[list(learned.MEASURES)])[1]
    assert np.allclose(1 / (1 + np.exp(-odds)), trees.score(table[list(learned.MEASURES)]))
    reasons = poles.detect(cloud, method="fgi", explain=True)["rejected_by"]
    assert {"", "length"} <= set(reasons)


def test_measures_of_a_post_are_what_was_built(rng):
    points = scene(post(0, 0, radius=0.1, height=3.0), wall(-4, 4, -3), rng=rng).points
    found = learned.describe(points)
    nearest = np.hypot(*found.middle.T).argmin()
    one = found.measures.iloc[nearest]
    assert one["run_m"] == pytest.approx(3.0, abs=0.26)  # a bin of 0.25 m
    assert one["radius_m"] == pytest.approx(0.1, abs=0.01)
    assert one["arc"] == pytest.approx(0.5, abs=0.1)  # half of it is seen
    assert one["beside"] == one["roof"] == one["above_shell"] == 0
    assert one["head"] == pytest.approx(1, abs=0.1)  # as wide at the top as below


def test_trees_follow_their_nodes_as_lightgbm_does(rng):
    x = pd.DataFrame(rng.uniform(0, 3, (3000, len(learned.MEASURES))), columns=[*learned.MEASURES])
    label = (x["run_m"] > 1.5) & (x["beside"] < 1)
    trees = learned.grow(x, label.astype(int), rounds=20)
    score = trees.score(x)
    assert ((score > 0.5) == label).mean() > 0.97
    parts, first = trees.parts(x)
    assert np.allclose(np.log(score / (1 - score)), parts.sum(axis=1) + first)
    used = [[*learned.MEASURES][k] for k in np.abs(parts).mean(axis=0).argsort()[-2:]]
    assert set(used) == {"run_m", "beside"}
    longer = trees.score(x.assign(run_m=x["run_m"] + 1))
    assert (longer >= score).all()  # a longer run is never less a pole
    other = x["points"] > 2
    more = learned.grow(x, other.astype(int), start=trees, rounds=60)
    assert ((more.score(x) > 0.5) == other).mean() > 0.97  # the new trees correct the old
    assert np.allclose(learned.Trees(*(part[: len(trees.left)] for part in more)).score(x), score)
    without = learned.grow(x, label.astype(int), rounds=5, leave=("run_m",))
    assert not (without.feature[without.left >= 0] == [*learned.MEASURES].index("run_m")).any()


def test_trees_are_written_as_they_are_read(tmp_path):
    for file in (FILE, OF_STREETS):
        learned.write(tmp_path / file.name, read(file))
        shipped = file.read_bytes()
        assert (tmp_path / file.name).read_bytes() == shipped
        assert len(shipped) < 200_000


def test_two_forests_have_their_mean_log_odds(rng):
    x = pd.DataFrame(rng.uniform(0, 3, (300, len(learned.MEASURES))), columns=[*learned.MEASURES])
    odds = [read(file).log_odds(x) for file in (FILE, OF_STREETS)]
    assert np.allclose(learned.shipped().log_odds(x), np.mean(odds, axis=0))
    assert np.std(odds[0] - odds[1]) > 0.1


def test_finds_move_with_a_cloud_of_rounded_heights(rng):
    parts = [post(x, y, height=h, line=100 * k) for k, (x, y, h) in enumerate(
        [(0, 0, 3.0), (3, 1, 2.2), (-3, 0.5, 4.0), (6, 0, 1.6)])]  # fmt: skip
    points = np.round(scene(*parts, wall(-8, 8, 3, line=900), rng=rng).points, 2)
    columns = ["x_m", "y_m", "z_base_m", "height_m", "score"]
    here = poles.detect(points)[columns]
    assert len(here) >= 3
    for move in np.array([[0, 0, 100.0], [1e6, -2e6, 0.07]]):
        there = poles.detect(np.round(points + move, 2))[columns]
        there.iloc[:, :3] -= move
        assert np.allclose(np.sort(there, axis=0), np.sort(here, axis=0), atol=0.005, rtol=0)


def test_lessons_leave_out_what_is_neither_near_nor_far(rng):
    points = scene(post(0, 0), post(3, 0, line=200), wall(-4, 4, -3, line=400), rng=rng).points
    pole = {"x_m": [0.0, 3.0], "y_m": 0.0, "z_base_m": 0.0, "height_m": 3.0}
    targets = pd.DataFrame(pole | {"lean_x": 0.0, "lean_y": 0.0, "visible": [True, False]})
    measures, label, weight = learned.lessons(points, targets)
    assert 1 <= label.sum() <= 9  # candidates of all scales near the visible one
    assert len(measures) == len(label) == len(weight) < len(learned.describe(points).axes)
    # a pole counts 2.5 times as much as another, and the cloud as the root of its candidates
    stated = np.where(label == 1, 2.5, 1.0) / np.sqrt(len(label))
    assert weight.to_numpy() == pytest.approx(stated)
    again = learned.lessons(points, targets, weight=3.0, poles=4.0)[2]
    assert again.to_numpy() == pytest.approx(np.where(label == 1, 12, 3) / np.sqrt(len(label)))


def test_candidates_do_not_depend_on_tiles():
    posts = [post(x, 0.0, line=100 * k)[0] for k, x in enumerate((-1.0, 58.95, 59.0, 121.0))]
    found = learned.describe(np.vstack([floor() * [12, 1, 1], *posts])).middle
    for x in (-1.0, 59.0, 121.0):
        assert np.hypot(found[:, 0] - x, found[:, 1]).min() < 0.06


def test_pairs_are_the_brute_force(rng):
    points, xy = rng.uniform(-5, 5, (2000, 3)), rng.uniform(-6, 6, (60, 2))
    a, b = common.pairs(xy, points, 0.8)
    distance = np.linalg.norm(xy[:, None] - points[:, :2], axis=2)
    near = np.argwhere(distance < 0.8)
    order = np.lexsort([b, a])
    assert np.array_equal(np.column_stack([a, b])[order], near)


def test_ground_follows_a_slope_without_roofs_and_strays(rng):
    plane = rng.uniform(0, 60, (40_000, 2))
    on_roof = (np.abs(plane - 30) < 2.5).all(axis=1) | (plane[:, 1] > 54.5)  # end of the cloud
    road = np.column_stack([plane, 0.05 * plane[:, 0] - 0.02 * plane[:, 1] + 5 * on_roof])
    strays = np.column_stack([rng.uniform(0, 60, (60, 2)), rng.uniform(-5, -2, 60)])
    height = road[:, 2] - common.ground(np.vstack([road, strays]))(road)
    # the lowest points of a 1 m cell lie up to 0.07 m below its middle on this slope
    assert np.abs(height[~on_roof]).max() < 0.14
    assert np.abs(height[on_roof] - 5).max() < 0.3


def test_parts_of_a_large_cloud_are_handled_as_the_whole(monkeypatch, street):
    points = street[1].points
    whole = learned.detect(points)
    height = common.ground(points)(points)
    monkeypatch.setattr(learned, "PART", len(points) // 7)
    assert learned.detect(points).equals(whole)
    assert learned.describe(points).ground(points) == pytest.approx(height, abs=1e-12)
    # a part holds the cloud's third lowest point of a cell although it is the lowest there
    heights = np.arange(12.0)[::-1, None] * [0, 0, 1]
    low = np.vstack([common.lowest(part) for part in np.split(heights, 4)])
    assert np.sort(low[:, 2])[:3].tolist() == [0, 1, 2] == common.lowest(heights)[:, 2].tolist()


def test_a_large_cloud_is_not_copied(street):
    points = np.tile(street[1].points, (1 + 3_000_000 // len(street[1]), 1))
    tracemalloc.start()
    learned.describe(points, learned.own_frame(points))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1.5 * points.nbytes


def test_the_moving_mask_takes_posts_and_no_shrubs(rng):
    shrub = np.array([4, 0, 1.5]) + rng.uniform(-0.35, 0.35, (4000, 3)) * [1, 1, 4]
    cloud = scene(post(0, 0), (shrub, np.full(len(shrub), 5000)), rng=rng)
    found = poles.detect(cloud, method="fgi")
    assert found[["x_m", "y_m"]].to_numpy() == pytest.approx(np.zeros((1, 2)), abs=0.04)
    # points around the post, two to three in ten, are too many for the mask
    around = rng.uniform([-0.3, -0.3, 0], [0.3, 0.3, 3], (400, 3))
    hedge = scene(post(0, 0), (around, np.full(400, 6000)), rng=rng)
    table = poles.detect(hedge, method="fgi", explain=True)
    assert "mask" in set(table["rejected_by"])
    assert not (table["rejected_by"] == "").any()


def test_segments_are_cut_at_gaps_and_dropped_by_size():
    x = np.r_[0, 0.02, 0.04, 1.0, 1.02, 2.0 + 0.05 * np.arange(12)]
    points = np.column_stack([x, 0 * x, 0 * x])
    group, kept = fgi.segment_lines(points, np.zeros(17), np.arange(17.0))
    # three points within 10 cm; two are too few; twelve are 0.55 m long
    assert group.tolist() == [0, 0, 0, -1, -1] + [-1] * 12
    assert kept["half"].tolist() == [0.02]


def test_scan_lines_are_recovered_from_time(street):
    _, cloud, _ = street
    line, _ = fgi.scan_lines(Cloud(cloud.points, {"gps_time": cloud["gps_time"]}))
    truth, _ = fgi.scan_lines(cloud)
    pairs = np.unique(np.stack([line, truth]), axis=1)[0]
    # the sky above the vehicle is where time cuts, the scanner's own zero where it counts lines:
    # the points between the two belong to the next line
    assert len(pairs) <= 2 * len(np.unique(truth))
    assert abs(len(np.unique(line)) - len(np.unique(truth))) <= 2


def test_lines_of_two_heads_are_no_neighbours():
    columns = {"scan_line": [0, 0, 1, 1], "pulse": [0, 1, 2, 3], "head": [0, 1, 0, 1]}
    line, _ = fgi.scan_lines(Cloud(np.zeros((4, 3)), columns))
    assert abs(line[0] - line[1]) > fgi.NEIGHBOURS
    steady = Cloud(np.zeros((500, 3)), {"gps_time": np.arange(500.0)})
    with pytest.raises(ValueError, match="Invalid time without pauses"):
        fgi.scan_lines(steady)


def test_chord_diameter_on_the_ray_lattice(rng):
    # a ray every 8 mm from a random phase meets a flat 60 mm target 7 or 8 times
    points, line = [], []
    for k in range(401):
        x = np.arange(rng.uniform(0, 0.008), 0.06, 0.008)
        points.append(np.column_stack([x, 0 * x, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    found = fgi.chord_diameter(np.concatenate(points), np.array([0, 0, 1.0]), np.array(line))
    assert found in (pytest.approx(0.056), pytest.approx(0.064))


def test_components_take_a_post_but_not_one_at_a_wall():
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 72), np.arange(0.35, 3, 0.02))
    ring = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), rise], axis=-1).reshape(-1, 3)
    one = poles.detect(np.vstack([floor(), ring]), method="itc").squeeze()
    # corners of 72 in a rectangle: at most 0.4 % short of the diameter
    assert one["diameter_m"] == pytest.approx(0.2, abs=0.001)
    before = np.vstack([floor(), ring, wall(-3, 3, 0.3)[0]])
    assert len(poles.detect(before, method="itc")) == 0  # section 4.2 removes the ground alone


def test_facade_points(rng):
    cloud = scene(wall(-4, 4, -3), post(1, 2, line=300), rng=rng)
    on_wall = (np.abs(cloud.points[:, 1] + 3) < 0.05) & (cloud.points[:, 2] > 0.5)
    on_post = np.hypot(cloud.points[:, 0] - 1, cloud.points[:, 1] - 2) < 0.1
    found = itc.walls(cloud.points)
    assert found[on_wall].mean() > 0.9
    assert not found[on_post & (cloud.points[:, 2] > 0.5)].any()


@pytest.mark.parametrize("method", poles.METHODS)
@pytest.mark.parametrize("n", [0, 1, 50])
def test_hardly_any_points_have_no_poles(method, n, rng):
    columns = {"scan_line": np.arange(n), "pulse": np.arange(n)}
    cloud = Cloud(rng.uniform(0, 30, (n, 3)), columns)
    assert len(poles.detect(cloud, method=method)) == 0


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ({"method": "hough"}, "Invalid method 'hough'. Must be one of learned, fgi, itc."),
        ({"threshold": -0.1}, "Invalid threshold -0.1. Must be > 0."),
        ({"method": "fgi"}, "Invalid cloud: columns none. The scan-line method needs scan_line"),
        (
            {"method": "itc", "threshold": 0.5},
            "Invalid choice for itc 'threshold'. Must be one of method, explain.",
        ),
        (
            {"tress": None},
            "Invalid choice for learned 'tress'. Must be one of method, explain, thr",
        ),
    ],
)
def test_bad_input_gets_a_sentence(choices, sentence):
    with pytest.raises(ValueError, match=sentence.replace(".", r"\.")):
        poles.detect(floor(2.0), **choices)


@pytest.mark.parametrize("method", ["learned", "itc"])
@pytest.mark.parametrize("far", [(2e6, 0, 0), (-3e5, 8e5, 50)])
def test_one_point_far_away_changes_nothing_and_costs_no_memory(method, far, rng):
    points = scene(post(0.5, 1.0), post(3.5, 1.0, line=200), wall(-4, 4, -3), rng=rng).points
    found = poles.detect(points, method=method)
    other = poles.detect(np.vstack([points, far]), method=method)
    assert len(found) == len(other) == 2
    # borders of voxels are rounded to 1e-10 m, so a point may change its voxel
    for columns, step in ((["x_m", "y_m"], 2e-3), (["score"], 1e-2)):
        assert np.allclose(found[columns], other[columns], atol=step)


@pytest.mark.parametrize("turn", [0, 20, 45])
def test_square_shafts_have_a_section_and_no_diameter(turn, rng):
    turn, side = np.radians(turn), np.linspace(-0.1, 0.1, 14)
    faces = np.concatenate(
        [np.column_stack([side, 0 * side - 0.1]), np.column_stack([0 * side - 0.1, side])]
    )
    plan = faces @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]] + [0.5, 1.0]
    shaft = np.column_stack([np.tile(plan, (120, 1)), np.repeat(np.arange(120) * 0.025, len(plan))])
    found = poles.detect(
        np.vstack([floor(), shaft]) + rng.normal(0, 0.002, (len(floor()) + len(shaft), 3))
    )
    one = found.squeeze()
    assert np.isnan(one[["diameter_m", "diameter_low_m"]].astype(float)).all()
    assert 0.19 < one["section_m"] < 0.29  # a side to the diagonal
    round_ = poles.detect(scene(post(0.5, 1.0, radius=0.1), rng=rng)).squeeze()
    assert round_["section_m"] == round_["diameter_m"]


@pytest.mark.parametrize(("wide", "reason"), [(0.16, ""), (0.5, "section")])
def test_what_is_less_than_five_times_as_high_as_wide_is_no_pole(wide, reason, rng):
    sure = learned.Trees(*(np.array([value]) for value in (0, 0.0, -1, -1, 5.0)))
    cloud = scene(post(0.5, 1.0, radius=wide / 2, height=2.0), rng=rng)
    every = poles.detect(cloud, trees=sure, explain=True)
    best = np.hypot(every["x_m"] - 0.5, every["y_m"] - 1.0).argmin()
    assert every["score"][best] > 0.99
    assert set(every["rejected_by"]) - {"duplicate", "length", "tilt"} == {reason}


def test_a_flat_face_has_a_section_and_no_diameter(rng):
    side, rise = np.meshgrid(np.linspace(-0.04, 0.04, 15), np.arange(0, 3, 0.05))
    face = np.column_stack([side.ravel() + 0.5, 0 * side.ravel() + 1, rise.ravel()])
    points = np.vstack([floor(), face])
    one = poles.detect(points + rng.normal(0, 0.002, points.shape)).squeeze()
    assert np.isnan(one["diameter_m"])
    assert one["section_m"] == pytest.approx(0.08, abs=0.01)


def test_poles_that_are_high_as_in_feet_are_said():
    posts = [post(2.0 * k - 5, 0, radius=0.2, height=10.0)[0] for k in range(6)]
    points = np.concatenate([floor(16.0), *posts])
    with pytest.warns(UserWarning, match=r"Half of the 6 poles are higher .* coordinates in feet"):
        poles.detect(points, method="itc")


def test_profiles_along_poles_are_said():
    rise, place = np.meshgrid(np.arange(0, 3, 0.05), np.linspace(-0.5, 0.5, 8))
    points = np.column_stack([place.ravel(), 0 * rise.ravel(), rise.ravel()])
    columns = {"scan_line": np.repeat(np.arange(8), 60), "pulse": np.tile(np.arange(60), 8)}
    with pytest.warns(UserWarning, match="8 upright stretches .* profiles run along poles"):
        poles.detect(Cloud(points, columns), method="fgi")


def test_a_cloud_of_too_many_cells_is_refused(monkeypatch):
    monkeypatch.setattr(common, "MOST_GROUND_CELLS", 100)
    with pytest.raises(ValueError, match=r"Invalid cloud of 1\d m by 1\d m without its"):
        poles.detect(floor())


def test_feet_are_refused_by_the_coordinate_system():
    cloud = Cloud(floor(2.0), crs=pyproj.CRS("EPSG:2263"))
    with pytest.raises(ValueError, match="Invalid cloud in US survey foot"):
        poles.detect(cloud)


def test_a_width_is_that_of_the_inner_points_across_the_widest_way():
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])
    bar = np.column_stack([np.linspace(-0.2, 0.2, 401), np.zeros(401)])
    of, off = np.repeat([0, 2, 3], [400, 401, 1]), np.concatenate([ring, bar, [[0.3, 0.4]]])
    assert measures._width(of, off, 5) == pytest.approx([0.2, 0, 0.95 * 0.4, 0, 0], abs=1e-3)


def test_measures_of_a_section_are_those_of_plain_loops(rng):
    a = rng.integers(0, 3, 400)
    off = rng.normal(size=(400, 2)) * [[0.1, 0.03]] + [[0.2, -0.1]]
    mean, turn, size = measures._scatter(a, off, 4)
    arcs = measures._arcs(a, off, 4)
    away = measures._off_line(a, off, 4)
    height = rng.uniform(0, 3, 400)
    across = np.hypot(*off.T)
    head = measures._head(a, across, height, 4)
    for k in range(3):
        own = off[a == k]
        values, vectors = np.linalg.eigh(np.cov(own.T, ddof=0))
        assert mean[k] == pytest.approx(own.mean(axis=0))
        assert size[k] == pytest.approx(np.sqrt(values[1]))
        way = [np.cos(turn[k]), np.sin(turn[k])]
        assert abs(way @ vectors[:, 1]) == pytest.approx(1)
        assert away[k] == pytest.approx(abs(own.mean(axis=0) @ [-way[1], way[0]]))
        sector = np.floor(np.degrees(np.arctan2(own[:, 1], own[:, 0])) % 360 / 360 * measures.ARCS)
        assert arcs[k] == len(set(sector)) / measures.ARCS
        below = height[a == k].max() - height[a == k]
        upper, lower = (below > 0.08) & (below < 0.28), below >= 0.28
        assert head[k] == pytest.approx(across[a == k][upper].mean() / across[a == k][lower].mean())
    assert arcs[3] == 0
    assert (head[3], away[3]) == (1, measures.REACH_M)


def test_what_stands_one_to_four_metres_away_is_seen_by_direction_and_height(rng, uncompiled):
    uncompiled(measures)
    coarse = np.column_stack([rng.uniform(-6, 6, (300, 2)), rng.uniform(0, 12, 300)])
    axes = np.column_stack([rng.uniform(-2, 2, (3, 2)), np.zeros((3, 3))])
    found = measures._wide(coarse, axes)
    bands = np.digitize(coarse[:, 2], measures.BANDS_M)
    for k in range(3):
        off = coarse[:, :2] - axes[k, :2]
        away = np.hypot(*off.T)
        near = (away > 1) & (away < measures.WIDE_M)
        turn = np.degrees(np.arctan2(off[:, 1], off[:, 0])) % 360
        sector = (turn / 360 * measures.ARCS).astype(int)
        for band, name in enumerate(("low", "mid", "high", "top")):
            seen = len(set(sector[near & (bands == band)]))
            assert found[f"around_{name}"][k] == pytest.approx(seen / measures.ARCS)


@pytest.mark.parametrize("covered", [2 * np.pi, 2.2])
def test_circles_of_candidates_are_those_of_a_search(covered, rng):
    a, off = np.repeat([0, 1], 80), np.zeros((160, 2))
    for k, radius in enumerate((0.08, 0.25)):
        turn = rng.uniform(0, covered, 80)
        ways = np.column_stack([np.cos(turn), np.sin(turn)])
        off[a == k] = [0.1, -0.2 * k] + (radius + 1e-4 * rng.normal(size=80))[:, None] * ways
    centre, radius, rough = axes.circles(a, off, 3, steps=40, hold=1e-6)
    assert radius[:2] == pytest.approx([0.08, 0.25], abs=5e-4)
    assert centre[:2] == pytest.approx(np.array([[0.1, 0], [0.1, -0.2]]), abs=5e-4)
    assert rough[:2] == pytest.approx([1e-4, 1e-4], rel=0.4)
    loose = axes.circles(a[:80], np.column_stack([np.linspace(-1, 1, 80), np.zeros(80)]), 1)
    assert loose[1][0] <= axes.WIDEST_M


def test_axes_lean_as_their_points_do_whatever_stands_aside(rng):
    rise = rng.uniform(0, 4, 300)
    post = np.column_stack([5 + 0.1 * rise, 7 - 0.05 * rise, rise])
    post[:, :2] += 0.004 * rng.normal(size=(300, 2))
    aside = np.column_stack([5.4 + 0 * rise[:60], 7 + 0 * rise[:60], rise[:60]])
    points = np.concatenate([post, aside])
    thin = common.Thin(points, points[:, 2], points)
    near = np.array([[5.2, 6.9]])
    (found,) = axes.fit_axes(thin, near, np.array([0.06]))
    middle = found[4]
    assert found[2:4] == pytest.approx([0.1, -0.05], abs=0.01)
    assert found[:2] == pytest.approx([5 + 0.1 * middle, 7 - 0.05 * middle], abs=0.02)
    assert middle == pytest.approx(2, abs=0.2)


def test_thinned_points_are_the_means_of_voxels_with_their_heights(rng):
    points = rng.uniform(0, 2, (3000, 3)) * [1, 1, 9] + [10, 20, 3]
    thin = common.thinned(points, lambda xy: 2.0 + 0 * xy[:, 0])
    size = common.VOXEL_M
    voxel = np.floor((points + size * np.array(common.PLACES[0][:3])) / size)
    means = pd.DataFrame(points).groupby([*voxel.T]).mean().to_numpy()
    order = np.lexsort(means.T)
    assert thin.points[np.lexsort(thin.points.T)] == pytest.approx(means[order])
    assert thin.height == pytest.approx(np.clip(thin.points[:, 2] - 2, 0, 16 - 1e-6), abs=1e-5)
    coarse = np.column_stack([np.floor(thin.points[:, :2] / common.COARSE_M),
                              np.floor(thin.height / 0.5)])  # fmt: skip
    expected = (np.unique(coarse, axis=0) + 0.5) * [common.COARSE_M, common.COARSE_M, 0.5]
    assert np.array_equal(np.unique(thin.coarse.round(6), axis=0), expected.round(6))


def test_points_on_the_plots_around_an_axis_are_all_there(rng):
    points = rng.uniform(-20, 20, (4000, 3))
    spots = np.array([[3.0, -4.0], [11.0, 9.0]])
    kept = common.around(points, spots)
    plot = np.floor(points[:, :2] / common.PLOT_M)
    near = (np.abs(plot[:, None] - np.floor(spots / common.PLOT_M)) <= 1).all(axis=2).any(axis=1)
    assert {*map(tuple, points[near])} <= {*map(tuple, kept)}
    assert len(kept) <= near.sum() + 40


def test_stretches_of_one_pole_are_merged_and_those_aside_are_not(rng):
    def stretch(x, low, high):
        z = np.linspace(low, high, 40)
        return np.column_stack([x + 0.03 * rng.normal(size=40), 0.03 * rng.normal(size=40), z])

    parts = [stretch(0, 0, 1.5), stretch(0, 1.9, 3.5), stretch(1.5, 0, 1.5), stretch(0, 30, 32)]
    points, member = np.concatenate(parts), np.repeat(np.arange(4), 40)
    found = fgi._merged(points, member)
    first = [found[member == k][0] for k in range(4)]
    assert first[0] == first[1]
    assert len({first[0], first[2], first[3]}) == 3
    axis = np.array([1.0, 2, 3]), np.array([0.6, 0, 0.8])
    along, across = fgi._about(np.array([[1.6, 2, 3.8], [1.0, 5, 3]]), axis)
    assert along == pytest.approx([1, 0])
    assert across == pytest.approx([0, 3])
