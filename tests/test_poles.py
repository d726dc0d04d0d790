"""The three detectors: hand-made scenes, a simulated street, invariance, speed of growth, input."""

import itertools
from functools import cache

import numpy as np
import pytest

from mmqa_lab import poles
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import fit_circle
from mmqa_lab.poles import common, features, fgi, itc, on_lines, ours
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
    found = poles.detect(cloud, method=method)
    assert len(found) == 1
    one = found.iloc[0]
    # the centre of the front half lies up to a radius in front of the axis
    assert np.hypot(one["x_m"] - 1.0, one["y_m"] - 2.0) < 0.06
    assert 2.0 < one["height_m"] <= 3.1
    assert one["tilt_deg"] < 3
    assert one["method"] == method


@pytest.mark.parametrize("method", poles.METHODS)
def test_a_short_post_is_none(method, rng):
    assert len(poles.detect(scene(post(0, 0, height=0.7), rng=rng), method=method)) == 0


def test_fgi_finds_the_same_poles_in_another_order(street, detected):
    _, cloud, _ = street
    shuffled = cloud[np.random.default_rng(1).permutation(len(cloud))]
    first, second = detected("fgi"), poles.detect(shuffled, method="fgi")
    assert len(first) > 3
    numbers = first.select_dtypes("number").columns
    # sums in another order differ by rounding of float64 at 100 m
    assert np.allclose(first[numbers], second[numbers], atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("method", ["itc", "ours"])
def test_the_others_need_no_order(street, detected, method):
    _, cloud, _ = street
    shuffled = cloud[np.random.default_rng(1).permutation(len(cloud))]
    first, second = detected(method), poles.detect(shuffled, method=method)
    assert len(first) > 3
    numbers = first.select_dtypes("number").columns
    assert np.allclose(first[numbers], second[numbers], atol=1e-6, equal_nan=True)
    assert "is_tree" not in first or first["is_tree"].equals(second["is_tree"])


@pytest.mark.parametrize("method", poles.METHODS)
def test_nothing_changes_when_the_cloud_is_moved_far(street, detected, method):
    _, cloud, _ = street
    shift = np.array([3e5, 5e6, 128.0])
    far = Cloud(cloud.points + shift, cloud.columns)
    near_found, far_found = detected(method), poles.detect(far, method=method)
    assert len(near_found) == len(far_found)
    # float64 at 5e6 m keeps 1e-9 m; whole metres of shift keep every cell where it was
    offset = far_found[["x_m", "y_m", "z_base_m"]] - near_found[["x_m", "y_m", "z_base_m"]]
    assert np.allclose(offset, shift, atol=1e-6)


@pytest.mark.parametrize(
    ("method", "recall", "precision"), [("fgi", 0.6, 0.5), ("ours", 0.85, 0.8)]
)
def test_rates_on_a_street_never_trained_on(street, detected, method, recall, precision):
    made, _, targets = street
    found = detected(method)
    path = made.trajectory().position
    result = poles.score(found, targets, corridor=15, trajectory=path)
    # about 10 targets: loose on purpose, the study measures
    assert result.recall.value >= recall
    assert result.precision.value >= precision


@pytest.mark.parametrize(("low", "found"), [(0.5, 1), (4.5, 0)])
def test_what_hangs_has_no_foot(low, found, rng):
    cloud = scene(post(1.0, 2.0, low=low), rng=rng)
    assert len(poles.detect(cloud, method="ours")) == found


def test_a_foot_may_stand_where_the_ground_is_hidden(rng):
    points = scene(post(1.0, 2.0, low=4.5), rng=rng).points
    beneath = np.hypot(points[:, 0] - 1.0, points[:, 1] - 2.0) < 1.0
    hidden = points[~(beneath & (points[:, 2] < 1.0))]
    assert len(poles.detect(points, method="ours")) == 0
    assert len(poles.detect(hidden, method="ours")) == 1


def test_what_is_seen_in_pieces_has_a_foot(rng):
    whole = post(1.0, 2.0, height=8.0)
    rise = whole[0][:, 2]
    seen = (rise > 4.6) | ((rise > 0.6) & (rise < 1.6)) | ((rise > 2.6) & (rise < 3.6))
    cloud = scene(tuple(values[seen] for values in whole), rng=rng)
    assert len(poles.detect(cloud, method="ours")) == 1


def test_poles_and_their_diameters_need_no_column_but_time(street, detected):
    _, cloud, _ = street
    alone = poles.detect(Cloud(cloud.points, {"gps_time": cloud["gps_time"]}), method="ours")
    whole = detected("ours")
    assert np.array_equal(alone[["x_m", "y_m", "score"]], whole[["x_m", "y_m", "score"]])
    both = alone["diameter_m"].notna() & whole["diameter_m"].notna()
    assert both.sum() >= 0.9 * whole["diameter_m"].notna().sum() > 1
    assert (alone["diameter_m"] - whole["diameter_m"])[both].abs().max() < 0.01


def test_few_points_that_stand_free_over_less_than_a_metre_are_no_pole():
    names = [*features.NAMES, *features.AROUND_NAMES, *features.ROUND_NAMES]
    row = dict.fromkeys(names, 0.0) | {"column_m": 2.0, "column_high_m": 2.0}
    kept = []
    for run, points, sure in ((1.0, 3, 0.8), (0.75, 7, 0.8), (0.75, 7, 0.95), (0.75, 8, 0.8)):
        made = row | {"run_m": run, "run_points": np.log1p(points)}
        axes = np.array([[0.0, 0.0, 0.0, 0.0, 1.0, 0.25, 0.25 + run, 0.1]])
        where = np.array([list(made.values())]), axes, np.zeros(1)
        found = ours.judged(np.empty((0, 3)), where, np.array([sure]), ours.Settings())
        kept.append(len(found))
    assert kept == [1, 0, 1, 1]


@pytest.mark.parametrize("method", ["fgi", "itc"])
def test_published_methods_ask_for_a_foot_only_when_told(method, rng):
    cloud = scene(post(1.0, 2.0), post(-3.0, 0.0, low=6.0, line=200), rng=rng)
    assert len(poles.detect(cloud, method=method)) == 2
    table = poles.detect(cloud, method=method, highest_foot=4.0, explain=True)
    assert table["rejected_by"].tolist() == ["foot", ""]  # from south to north


def test_explain_names_the_test_that_rejected(rng):
    cloud = scene(post(1, 2), post(3, 3, height=0.7, line=200), rng=rng)
    table = poles.detect(cloud, method="fgi", explain=True)
    near = table[(table["x_m"] - 3).abs() < 0.1]
    assert near["rejected_by"].tolist() == ["length"]
    assert (table["rejected_by"] == "").sum() == 1
    learned = poles.detect(cloud, method="ours", explain=True)
    assert set(learned["rejected_by"]) <= {
        "",
        "probability",
        "length",
        "points",
        "foot",
        "duplicate",
    }


def test_a_shell_that_is_not_empty_rejects(rng):
    shrub = np.array([0, 0, 1.5]) + rng.uniform(-0.35, 0.35, (4000, 3)) * [1, 1, 4]
    lines = np.full(len(shrub), 5000)
    cloud = scene(post(0, 0), (shrub, lines), rng=rng)
    table = poles.detect(cloud, method="fgi", explain=True)
    assert "mask" in set(table["rejected_by"])
    assert not (table["rejected_by"] == "").any()


def test_the_mask_as_worded_takes_posts_and_no_shrubs(rng):
    shrub = np.array([4, 0, 1.5]) + rng.uniform(-0.35, 0.35, (4000, 3)) * [1, 1, 4]
    cloud = scene(post(0, 0), (shrub, np.full(len(shrub), 5000)), rng=rng)
    found = poles.detect(cloud, method="fgi", as_worded=True)
    assert found[["x_m", "y_m"]].to_numpy() == pytest.approx(np.zeros((1, 2)), abs=0.03)
    assert found["height_m"].item() == pytest.approx(
        poles.detect(cloud, method="fgi")["height_m"].item(), abs=0.3
    )


def test_a_post_at_a_wall_is_part_of_it_where_only_the_ground_is_removed():
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 36), np.arange(0.35, 3, 0.04))
    ring = np.stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), rise], axis=-1).reshape(-1, 3)
    x, z = (one.ravel() for one in np.meshgrid(np.arange(-3, 3, 0.05), np.arange(0, 4, 0.05)))
    wall = np.stack([x, 0 * x + 0.4, z], axis=1)
    cloud = np.vstack([floor(), ring, wall])
    assert len(poles.detect(cloud, method="itc")) == 1
    assert len(poles.detect(cloud, method="itc", only_ground=True)) == 0


def test_segments_are_cut_at_gaps_and_dropped_by_size():
    x = np.r_[0, 0.02, 0.04, 1.0, 1.02, 2.0 + 0.05 * np.arange(12)]
    points = np.column_stack([x, 0 * x, 0 * x])
    settings = fgi.Settings()
    group, kept = fgi.segment_lines(points, np.zeros(17), np.arange(17.0), settings)
    # three points within 10 cm; two are too few; twelve are 0.55 m long
    assert group.tolist() == [0, 0, 0, -1, -1] + [-1] * 12
    assert kept["half"].tolist() == [0.02]


def test_without_scan_lines_the_component_method_answers(rng):
    cloud = scene(post(1, 2), rng=rng)
    with pytest.warns(UserWarning, match="needs scan lines"):
        found = poles.detect(cloud.points, method="fgi")
    assert found["method"].tolist() == ["itc"]


def test_scan_lines_are_recovered_from_time_and_angle(street):
    _, cloud, _ = street
    kept = {name: cloud[name] for name in ("gps_time", "scan_angle")}
    line, _ = on_lines.scan_lines(Cloud(cloud.points, kept))
    truth, _ = on_lines.scan_lines(cloud)
    # same partition, whatever the numbers
    assert len(np.unique(np.stack([line, truth]), axis=1)[0]) == len(np.unique(truth))
    assert len(np.unique(line)) == len(np.unique(truth))


@pytest.mark.parametrize("name", ["gps_time", "scan_angle"])
def test_scan_lines_are_recovered_from_one_of_them_alone(street, name):
    _, cloud, _ = street
    line, _ = on_lines.scan_lines(Cloud(cloud.points, {name: cloud[name]}))
    truth, _ = on_lines.scan_lines(cloud)
    pairs = np.unique(np.stack([line, truth]), axis=1, return_counts=True)[1]
    # the sky above the vehicle is where time cuts, the scanner's own zero where it counts lines:
    # the points between the two belong to the next line
    assert pairs.size <= 2 * len(np.unique(truth))
    assert abs(len(np.unique(line)) - len(np.unique(truth))) <= 2
    assert poles.detect(Cloud(cloud.points, {name: cloud[name]}), method="fgi").shape[0] > 3


def test_time_without_pauses_has_no_lines():
    steady = Cloud(np.zeros((500, 3)), {"gps_time": np.arange(500.0)})
    assert on_lines.scan_lines(steady) is None


def test_lines_of_two_heads_are_no_neighbours():
    columns_ = {"scan_line": [0, 0, 1, 1], "pulse": [0, 1, 2, 3], "head": [0, 1, 0, 1]}
    line, _ = on_lines.scan_lines(Cloud(np.zeros((4, 3)), columns_))
    assert abs(line[0] - line[1]) > fgi.Settings().neighbours


def test_shaft_diameter_is_unbiased_on_the_ray_lattice(rng):
    # a ray every 8 mm from a random phase meets a flat 60 mm target 7 or 8 times
    points, line = [], []
    for k in range(400):
        x = np.arange(rng.uniform(0, 0.008), 0.06, 0.008)
        points.append(np.column_stack([x, 0 * x, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    found = common.shaft_diameter(np.concatenate(points), np.array([0, 0, 1.0]), np.array(line))
    # the standard error of the mean of 400 coin flips of 8 mm is 0.2 mm
    assert found == pytest.approx(0.06, abs=0.0008)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_chords_through_a_board_do_not_count(rng, share):
    points, line = [], []
    for k in range(40):
        # a round board of 0.6 m, cut at any height
        width = 0.6 * np.sqrt(1 - rng.uniform(-0.95, 0.95) ** 2) if k < 40 * share else 0.06
        x = np.arange(rng.uniform(0, 0.008), width, 0.008) - width / 2
        points.append(np.column_stack([x, 0 * x, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    found = common.shaft_diameter(np.concatenate(points), np.array([0, 0, 1.0]), np.array(line))
    # sixteen coin flips of 8 mm or more: standard error 1 mm
    assert found == pytest.approx(0.06, abs=0.004)


def test_chords_that_leaves_cut_short_do_not_count(rng):
    points, line = [], []
    for k in range(45):
        low, high = (-0.15, 0.15) if k % 3 else np.sort(rng.uniform(-0.15, 0.15, 2))
        x = np.arange(-0.15 + rng.uniform(0, 0.02), 0.15, 0.02)
        x = x[(x >= low) & (x <= high)]
        points.append(np.column_stack([x, 0 * x, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    found = common.shaft_diameter(np.concatenate(points), np.array([0, 0, 1.0]), np.array(line))
    # a few of the short ones are nearly whole
    assert found == pytest.approx(0.30, abs=0.015)


def test_chords_beside_which_something_stands_do_not_count():
    chord = np.column_stack([np.arange(5) * 0.02, np.zeros(5), np.zeros(5)])
    points, line, place = [], [], []
    for k in range(4):
        points.append(chord + [0, 0, 0.1 * k])
        line += [k] * 5
        place += [*range(10, 15)]
    # line 1: the next pulse hits a leaf in front; line 2: a thing that many pulses lie between
    points.append(np.array([[0.1, -0.3, 0.1], [0.3, 0, 0.2]]))
    line, place = np.array([*line, 1, 2]), np.array([*place, 15, 40])
    points = np.concatenate(points)
    which, lines = ours.chord_points(points, points[:, :2] - [0.04, 0], line, place)
    assert sorted(set(lines)) == [0, 2, 3]
    assert len(which) == 15


def test_a_box_on_its_post_does_not_widen_the_post():
    rng = np.random.default_rng(5)
    points, line = [], []
    for k in range(40):
        width = 0.10 if k < 14 else 0.35  # the box has the most chords
        x = np.arange(-width / 2 + rng.uniform(0, 0.02), width / 2, 0.02)
        points.append(np.column_stack([x, 0 * x, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    given = np.concatenate(points), np.array([0, 0, 1.0]), np.array(line)
    assert common.shaft_diameter(*given) == pytest.approx(0.10, abs=0.006)


@pytest.mark.parametrize("cut", [0.0, 0.3])
def test_a_tapering_shaft_has_its_diameter_halfway_up(cut):
    rng = np.random.default_rng(6)
    points, line = [], []
    for k in range(60):
        width = 0.16 - 0.012 * 0.1 * k  # 160 mm to 89 mm over 5.9 m
        low = -width / 2 + (0.05 * rng.random() if rng.random() < cut else 0)  # something in front
        x = np.arange(low + rng.uniform(0, 0.008), width / 2, 0.008)
        noise = rng.normal(0, 0.002, len(x))
        points.append(np.column_stack([x, noise, np.full(len(x), 0.1 * k)]))
        line += [k] * len(x)
    given = np.concatenate(points), np.array([0, 0, 1.0]), np.array(line)
    # sixty coin flips of 8 mm: standard error 0.5 mm; chords cut a little still agree
    halfway = (0.16 + 0.16 - 0.012 * 5.9) / 2
    assert common.shaft_diameter(*given) == pytest.approx(halfway, abs=0.002 if cut == 0 else 0.006)
    few = given[2] < 2
    assert np.isnan(common.shaft_diameter(given[0][few], given[1], given[2][few]))


def test_circle_diameter_of_a_whole_circle_is_exact():
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.01 * turn])
    assert common.circle_diameter(ring, np.array([0, 0, 1.0])) == pytest.approx(0.2, rel=1e-3)


def test_circle_of_a_third_of_a_pole_lies_within_its_standard_deviation(rng):
    centres, stds = [], []
    for _ in range(60):
        turn = rng.uniform(-1, 1, 40)
        arc = 0.07 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        arc += rng.normal(0, 0.003, arc.shape)
        arc[:3] += 0.1  # a board
        found = fit_circle(arc + [1e6, 2e6], diameter=0.14)
        centres.append(found.centre - [1e6, 2e6])
        stds.append(found.std)
    scatter = np.sqrt(np.mean(np.square(centres)))
    # 120 coordinates: their scatter is known to 1 / sqrt(240); the robust loss adds some
    assert scatter == pytest.approx(np.mean(stds), rel=0.35)
    assert scatter < 0.002


def test_ground_follows_a_slope_and_ignores_what_stands_on_it(rng):
    plane = rng.uniform(0, 60, (40_000, 2))
    z = 0.05 * plane[:, 0] - 0.02 * plane[:, 1]
    on_roof = (np.abs(plane - 30) < 2.5).all(axis=1)
    points = np.column_stack([plane, z + 5 * on_roof])
    height = common.fit_ground(points).height(points)
    # the lowest point of a 1 m cell lies up to 0.07 m below its middle on this slope
    assert np.abs(height[~on_roof]).max() < 0.12
    assert np.abs(height[on_roof] - 5).max() < 0.3


def test_single_points_below_the_road_are_not_the_ground(rng):
    plane = rng.uniform(0, 60, (40_000, 2))
    road = np.column_stack([plane, 0.02 * plane[:, 0]])
    strays = np.column_stack([rng.uniform(0, 60, (60, 2)), rng.uniform(-5, -1, 60)])
    points = np.vstack([road, strays])
    height = common.fit_ground(points).height(points)
    assert np.abs(height[:40_000]).max() < 0.12
    assert height[40_000:].max() < -0.9


def test_a_column_of_equal_values_says_nothing_about_lines(street):
    _, cloud, _ = street
    unset = np.zeros(len(cloud))
    given = {"scan_angle": unset, "gps_time": cloud["gps_time"]}
    line, _ = on_lines.scan_lines(Cloud(cloud.points, given))
    alone, _ = on_lines.scan_lines(Cloud(cloud.points, {"gps_time": cloud["gps_time"]}))
    assert (line == alone).all()
    assert len(np.unique(line)) > 100
    assert (
        on_lines.scan_lines(Cloud(cloud.points, {"scan_angle": unset, "gps_time": unset})) is None
    )


def test_near_axis_is_the_brute_force(rng):
    points = rng.uniform(0, 10, (3000, 3))
    found = common.rows(points)
    for x, y, radius in rng.uniform([0, 0, 0.05], [10, 10, 2], (30, 3)):
        near = common.near_axis(*found[:3], x, y, radius)
        inside = np.hypot(points[:, 0] - x, points[:, 1] - y) <= radius
        assert set(found.order[near]) == set(np.flatnonzero(inside))


def test_no_point_near_a_place_is_left_out(rng):
    points = rng.uniform([-5, -7, 0], [6, 4, 3], (3000, 3))
    xy = rng.uniform([-7, -7], [6, 5], (6, 2))  # some lie beyond the points
    for reach in (0.4, 1.0, 1.7):
        chosen = common.beside(points, xy, reach)
        away = np.hypot(*(points[:, None, :2] - xy).transpose(2, 0, 1)).min(axis=1)
        assert set(np.flatnonzero(away <= reach)) <= set(chosen)
        # two cells' diagonals at most beside the reach
        assert away[chosen].max() < np.ceil(reach) * 2**0.5 + 2**0.5
    assert len(common.beside(points, xy[:0], 1.0)) == 0


def test_candidates_do_not_depend_on_tiles(rng):
    spots = rng.uniform(0, 200, (60, 2))
    points = np.concatenate([post(x, y)[0] for x, y in spots])
    found = features.candidates(points, points[:, 2])
    gap = np.hypot(*(spots[:, None] - found[None]).transpose(2, 0, 1)).min(axis=1)
    assert gap.max() < 0.2


def test_a_point_just_at_the_reach_has_no_part_in_the_axis():
    shaft = post(0.5, 0.5)[0] + [0.0, 0.05, 0.0]  # coordinates of centimetres lie on the circle
    at, axes = np.array([0.5, 0.5]), []
    for away in (0.5, 0.51, 0.49):
        rim = np.column_stack([np.full(5, 0.5 + away), np.full(5, 0.5), np.linspace(0.5, 2.5, 5)])
        found = common.rows(np.vstack([shaft, rim]))
        out = np.zeros(5)
        where = found.points, np.ascontiguousarray(found.points[:, 2]), found.start, found.base
        features.fit_axis(*where, at, out)
        axes.append(out)
    assert np.array_equal(axes[0], axes[1])
    assert not np.array_equal(axes[0], axes[2])


def test_what_stands_around_an_axis_is_counted_in_cells_and_arcs(rng):
    points = rng.uniform([-7, -7, -1], [7, 7, 18], (3000, 3))
    axis = np.array([[0.33, -0.71, 0.0, 0.0, 1.0]])
    row = features.describe_around(points, points[:, 2], axis)[0]
    cell = 0.2 * (np.floor(points[:, :2] / 0.2) + 0.5) - axis[0, :2]
    away, turn = np.hypot(*cell.T), np.degrees(np.arctan2(cell[:, 1], cell[:, 0])) % 360
    measured = dict(zip(features.AROUND_NAMES, row, strict=True))
    rings, bands = [0.6, 1.5, 3, 5], [0.1, 1, 2.5, 5, 9, 16]
    for ring, (near, far) in enumerate(itertools.pairwise(rings)):
        for band, (low, high) in enumerate(itertools.pairwise(bands)):
            there = (away >= near) & (away < far) & (points[:, 2] > low) & (points[:, 2] < high)
            places, arcs = np.unique(cell[there].round(3), axis=0), np.unique(turn[there] // 15)
            name = f"band{band}_ring{ring}"
            assert measured[f"cells_{name}"] == pytest.approx(np.log1p(len(places)))
            assert measured[f"arcs_{name}"] == pytest.approx(len(arcs) / 24)
    assert not features.describe_around(points[:0], points[:0, 2], axis).any()


@pytest.mark.parametrize("radius", [0.06, 0.25, 0.45])
def test_a_round_shaft_is_told_from_a_body_and_a_strip(radius, rng):
    turn, h = rng.uniform(0.1 * np.pi, 0.9 * np.pi, 400), rng.uniform(0.2, 1.9, 400)
    side = np.column_stack([np.cos(turn), -np.sin(turn)])
    shaft = np.column_stack([radius * side, h])
    body = np.column_stack([0.25 * side * np.sqrt(1 - ((h - 1) / 1) ** 2)[:, None], h])
    strip = np.column_stack([rng.uniform(-0.25, 0.25, 400), 0 * h, h])
    measured = []
    for points in (shaft, body, strip):
        found = common.rows(points + rng.normal(0, 0.003, points.shape))
        height = np.ascontiguousarray(found.points[:, 2])
        where = (found.points, height, found.start, found.base)
        axis = np.array([[*found.points[:, :2].mean(axis=0), 0.0, 0.0, 1.0]])
        row = features.describe_rounds(where, axis)[0]
        measured.append(dict(zip(features.ROUND_NAMES, row, strict=True)))
    true, bulging, flat = measured
    assert true["round_radius_m"] == pytest.approx(radius, abs=0.03)
    assert true["round_m"] == pytest.approx(2.0)  # bins that are touched
    assert true["round_share"] > 0.95
    assert true["round_width"] == pytest.approx(1.0, abs=0.2)
    assert bulging["round_m"] < 1.75
    assert flat["round_arc"] < true["round_arc"]


def test_a_wall_behind_leaves_is_still_a_plane(rng):
    bare = wall(-4, 4, -3)[0]
    leaves = rng.uniform([-4, -3 + 0.05, 0], [4, -3 + 0.4, 4], (2500, 3))
    points = np.vstack([floor(), bare, leaves])
    rough = itc.rough_classes(points, itc.Settings())
    on = np.zeros(len(points), dtype=bool)
    on[len(floor()) : len(floor()) + len(bare)] = True
    wall_class, high = rough == itc.WALL, points[:, 2] > 0.5
    # least squares through wall and leaves alike would be 0.1 m thick: no plane, no wall
    assert wall_class[on & high].mean() > 0.9
    assert on[wall_class & high].mean() > 0.85
    order = rng.permutation(len(points))
    assert (itc.rough_classes(points[order], itc.Settings()) == rough[order]).all()


def test_facade_classes(rng):
    cloud = scene(wall(-4, 4, -3), post(1, 2, line=300), rng=rng)
    rough = itc.rough_classes(cloud.points, itc.Settings())
    on_wall = (np.abs(cloud.points[:, 1] + 3) < 0.05) & (cloud.points[:, 2] > 0.5)
    on_post = np.hypot(cloud.points[:, 0] - 1, cloud.points[:, 1] - 2) < 0.1
    assert (rough[on_wall] == itc.WALL).mean() > 0.9
    assert (rough[on_post & (cloud.points[:, 2] > 0.5)] == itc.RAISED).all()


def test_the_model_file_says_what_is_decided():
    model = ours.read_model()
    assert tuple(model.feature_name()) == ours.FEATURES
    values = np.random.default_rng(0).uniform(0, 5, (3, len(ours.FEATURES)))
    for row, given in zip(values, model.predict(values), strict=True):
        odds = 0.0
        for tree in model.dump_model()["tree_info"]:
            node = tree["tree_structure"]
            while "leaf_value" not in node:
                left = row[node["split_feature"]] <= node["threshold"]
                node = node["left_child" if left else "right_child"]
            odds += node["leaf_value"]
        assert given == pytest.approx(1 / (1 + np.exp(-odds)))


def test_the_component_method_measures_the_width_of_a_post():
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 72), np.arange(0.35, 3, 0.02))
    ring = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), rise], axis=-1).reshape(-1, 3)
    one = poles.detect(np.vstack([floor(), ring]), method="itc").iloc[0]
    # 36 directions of the rectangle, 5 degrees apart: at most 0.4 % short of the diameter
    assert one["diameter_m"] == pytest.approx(0.2, abs=0.001)


def test_thinning_keeps_one_point_a_cube(rng):
    points = rng.uniform(0, 1, (5000, 3))
    thin = common.thinned(points, 0.1)
    cells = np.unique(np.floor(points / 0.1), axis=0)
    assert len(thin) == len(cells)


@pytest.mark.parametrize("method", poles.METHODS)
def test_an_empty_cloud_has_no_poles(method):
    cloud = Cloud(np.empty((0, 3)), {"scan_line": [], "pulse": []})
    assert len(poles.detect(cloud, method=method)) == 0


@pytest.mark.parametrize("method", poles.METHODS)
def test_points_too_sparse_for_any_group_have_no_poles(method, rng):
    columns_ = {"scan_line": np.arange(50), "pulse": np.arange(50)}
    assert len(poles.detect(Cloud(rng.uniform(0, 30, (50, 3)), columns_), method=method)) == 0


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ({"method": "hough"}, "Invalid method 'hough'. Must be one of ours, fgi, itc."),
        ({"corridor": 10}, "Invalid trajectory None."),
        ({"voxel": -0.1}, "Invalid voxel -0.1. Must be > 0."),
        ({"shell": 0.2}, "Invalid threshold of ours 'shell'."),
        ({"corridor": -1, "trajectory": [[0, 0], [1, 1]]}, "Invalid corridor -1. Must be > 0 m."),
    ],
)
def test_bad_input_gets_a_sentence(choices, sentence):
    with pytest.raises(ValueError, match=sentence.replace(".", r"\.")):
        poles.detect(floor(2.0), **choices)
