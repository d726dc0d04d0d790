"""Heights, plan positions, trends and reference points against closed forms and brute force."""

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from scipy.stats import t

from mmqa_lab import io
from mmqa_lab.cloud import path_distance
from mmqa_lab.simulate import test_field as made
from mmqa_lab.test_field import (
    compare_heights,
    drives,
    height_accuracy,
    height_differences,
    heights,
    plan,
    plan_accuracy,
    plan_differences,
    split_drives,
    thinned,
    trend,
)

FAR = np.array([1e7, -1e7, 5e3])


@pytest.fixture
def ground(rng):
    """A rough, tilted ground."""
    xy = rng.uniform(0, 10, (20_000, 2))
    z = 0.02 * xy[:, 0] - 0.01 * xy[:, 1] + rng.normal(0, 0.004, len(xy))
    return np.column_stack([xy, z])


def test_heights_are_those_of_the_whole_triangulation(ground, rng):
    reference = np.column_stack([rng.uniform(1, 9, (200, 2)), np.zeros(200)])
    found = height_differences(ground, reference, radius=0.5)
    mesh = Delaunay(ground[:, :2])
    triangle = mesh.find_simplex(reference[:, :2])
    a, b, c = np.moveaxis(ground[mesh.simplices[triangle]], 1, 0)
    normal = np.cross(b - a, c - a)
    flat = (reference[:, :2] - a[:, :2]) * normal[:, :2]
    expected = a[:, 2] - flat.sum(axis=1) / normal[:, 2]
    assert set(found["reason"]) <= {"", "gross error"}
    assert np.allclose(found["dz_m"], expected, atol=1e-9)


def test_heights_do_not_change_far_from_the_origin(ground):
    reference = np.array([[3.0, 4.0, 0.1], [5.5, 6.5, 0.2]])
    near = height_differences(ground, reference)
    far = height_differences(ground + FAR, reference + FAR)
    # float64 at 1e7 m carries 2e-9 m
    assert np.allclose(near["dz_m"], far["dz_m"], atol=1e-7)
    x, y = np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 4, 0.1))  # four on a circle everywhere
    grid = np.column_stack([x.ravel(), y.ravel(), ground[: x.size, 2]])
    reference = np.column_stack([ground[:40, :2] * 0.3 + 0.5, np.zeros(40)])
    near = height_differences(grid, reference)
    far = height_differences(grid + FAR, reference + FAR)
    assert np.allclose(near["dz_m"], far["dz_m"], atol=1e-7)


def test_a_reference_point_that_is_given_twice_counts_once(ground):
    reference = np.array([[3.0, 4.0, 0.1], [5.5, 6.5, 0.2], [3.0, 4.0, 0.3]])
    given = reference, reference[[0, 1, 2, 1]]
    once, twice = (compare_heights(ground, rows)[0] for rows in given)
    assert "1 reference points are given twice" in twice["remarks"][0]
    columns = [name for name in once if name != "remarks"]
    pd.testing.assert_frame_equal(once[columns], twice[columns])


def test_reasons():
    x, y = np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 4, 0.1))
    z = np.where(y > 3, 2 * (y - 3), 0)
    cloud = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    free = np.array([[0.55, 0.5 + 0.1 * k, 0] for k in range(12)])
    reference = np.vstack([free, [[1, 1, -3], [1.0, 3.55, 1.1], [9, 9, 0], [4.05, 1, 0]]])
    found = height_differences(cloud, reference)["reason"].tolist()
    assert found[:12] == [""] * 12
    assert found[12:] == ["gross error", "slope", "no points", "not surrounded"]


def test_trend_is_covered_as_often_as_it_says(rng):
    distance = np.array([4.0, 6, 7, 9, 12, 13, 16, 18])
    held = 0
    for _ in range(300):
        found = trend(distance, 10 + 0.8 * distance + rng.normal(0, 4, 8))
        held += found.slope_low < 0.8 < found.slope_high
    assert 0.91 < held / 300 < 0.99  # a share of 0.95 from 300 draws scatters by 0.013
    with pytest.raises(ValueError, match="three or more"):
        trend([1, 1, 1], [1, 2, 3])


def arc(centre, radius, towards, rng, n=60, height=(0.0, 6.0)):
    """Points on the side of a pole that faces a direction, radians."""
    turn = towards + rng.uniform(-1.2, 1.2, n)
    xy = centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    xy += rng.normal(0, 0.003, xy.shape)
    return np.column_stack([xy, rng.uniform(*height, n)])


def test_poles_seen_from_one_side_and_far_from_the_origin(rng):
    poles = pd.DataFrame(
        {"x_m": [3.0, 8.0], "y_m": [4.0, 4.0], "z_m": [0.0, 0.0], "diameter_m": [0.14, 0.2]}
    )
    shift = np.array([0.05, -0.03])
    cloud = np.vstack(
        [
            arc(np.array([3.0, 4.0]) + shift, 0.07, -np.pi / 2, rng, n=400),
            arc(np.array([8.0, 4.0]) + shift, 0.10, np.pi / 2, rng, n=400),
        ]
    )
    found = plan_differences(cloud, poles)
    assert (found["reason"] == "").all()
    # 3 mm of noise on some 60 points a circle: well below 3 mm
    assert np.abs(found[["dx_m", "dy_m"]] - shift).to_numpy().max() < 0.003
    far = plan_differences(
        cloud + FAR, poles.assign(x_m=poles["x_m"] + 1e7, y_m=poles["y_m"] - 1e7, z_m=5e3)
    )
    assert np.allclose(far[["dx_m", "dy_m"]], found[["dx_m", "dy_m"]], atol=1e-5)
    nothing = plan_differences(cloud, poles.assign(x_m=100.0))
    assert set(nothing["reason"]) == {"too few points"}


def test_an_arc_that_fits_on_either_side_gives_no_position(rng):
    turn = np.linspace(-0.5, 0.5, 12)
    points = np.column_stack([0.03 * np.cos(turn), 0.03 * np.sin(turn), np.linspace(0.6, 1.4, 12)])
    pole = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "z_m": [0.0], "diameter_m": [0.06]})
    sharp = plan_differences(points, pole).iloc[0]
    assert np.hypot(sharp["dx_m"], sharp["dy_m"]) < 1e-6
    points[:, :2] *= 1 + rng.normal(0, 0.005, 12)[:, None] / 0.03  # the arc is 3.7 mm deep
    assert plan_differences(points, pole)["reason"][0] == "no circle near"


def test_corner_of_two_walls_and_of_one(rng):
    n = 400
    wall = np.column_stack([rng.uniform(0, 2, n), np.zeros(n), rng.uniform(0, 4, n)])
    side = np.column_stack([np.zeros(n), rng.uniform(0, 2, n), rng.uniform(0, 4, n)])
    turn = np.radians(20)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    cloud = np.vstack([wall, side])
    cloud[:, :2] = cloud[:, :2] @ rotation.T + [0.04, 0.02]
    cloud[:, :2] += rng.normal(0, 0.004, (2 * n, 2))
    corners = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "z_m": [0.0], "kind": ["building"]})
    found = plan_differences(cloud, corners).iloc[0]
    assert found["reason"] == ""
    assert (found["dx_m"], found["dy_m"]) == pytest.approx((0.04, 0.02), abs=0.003)
    assert plan_differences(cloud[:n], corners)["reason"].item() == "one line"


def test_gross_errors_in_plan_do_not_count(rng):
    places = np.column_stack([10.0 * np.arange(12), np.zeros(12)])
    errors = rng.normal(0, 0.01, (12, 2))
    errors[5] = [0.2, 0.1]
    posts = [
        arc(place + off, 0.1, 0.0, rng, 400) for place, off in zip(places, errors, strict=True)
    ]
    poles = pd.DataFrame(places, columns=["x_m", "y_m"]).assign(z_m=0.0, diameter_m=0.2)
    found = plan_differences(np.vstack(posts), poles)
    assert set(found.loc[found["reason"] == "gross error", "name"]) == {5}


@pytest.mark.parametrize(("usual_mm", "kept_mm", "gross_mm"), [(5.0, 20.5, 22.0), (0.1, 9.7, 10.3)])
def test_an_error_is_gross_from_five_standard_deviations_and_a_centimetre(
    usual_mm, kept_mm, gross_mm
):
    """Of 5 mm as the median of distances, 5 * 5 / root(2 ln 2) = 21.2 mm."""
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    way = np.append(turn[::2], [0, np.pi] * 2)  # pairs that leave the median where it is
    far = np.append(np.full(20, usual_mm), [kept_mm] * 2 + [gross_mm] * 2) / 1000
    places = np.column_stack([10.0 * np.arange(24), np.zeros(24)])
    centres = places + far[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    rings = 0.1 * np.column_stack([np.cos(turn), np.sin(turn)])
    xy = (centres[:, None] + rings).reshape(-1, 2)
    points = np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (0.8, 1.2)])
    poles = pd.DataFrame(places, columns=["x_m", "y_m"]).assign(z_m=0.0, diameter_m=0.2)
    with pytest.raises(ValueError, match=r"Invalid slices of 'pole'.* low and high"):
        plan_differences(points, poles, slices={"pole": ((0.5,),)})
    found = plan_differences(points, poles, slices={"pole": ((0.5, 1.5),)})
    assert found.loc[found["reason"] == "gross error", "name"].tolist() == [22, 23]
    assert (found["reason"] == "").sum() == 22


def test_slices_of_one_target_do_not_narrow_its_intervals(rng):
    table = pd.DataFrame(rng.normal(0, 0.01, (12, 2)), columns=["dx_m", "dy_m"])
    table = table.assign(x_m=np.arange(12.0), y_m=0.0, reason="")
    once, twice = (plan_accuracy(pd.concat([table] * k)).iloc[0] for k in (1, 2))
    half = t.ppf(0.975, 11) * 1000 * table["dx_m"].std() / np.sqrt(12)
    squares = 1e6 * (table["dx_m"] ** 2 + table["dy_m"] ** 2).to_numpy()
    for row in (once, twice):
        assert row["mean_east_high_mm"] - row["mean_east_mm"] == pytest.approx(half)
        share = t.ppf(0.975, 11) * squares.std(ddof=1) / np.sqrt(12) / squares.mean() / 2
        ends = row["rmse_mm"] * np.exp([-share, share])
        assert [row["rmse_low_mm"], row["rmse_high_mm"]] == pytest.approx(ends)


def test_heights_that_err_together_have_wider_intervals(rng):
    place = pd.DataFrame(rng.uniform(0, 40, (400, 2)), columns=["x_m", "y_m"])
    errors = rng.normal(0, 0.01, 400)
    together = 0.01 * np.sign(place["x_m"] // 10 % 2 - 0.5) + errors
    ends = [height_accuracy(place.assign(dz_m=dz, reason="")).iloc[0] for dz in (errors, together)]
    alone, common = (row["mean_high_mm"] - row["mean_low_mm"] for row in ends)
    assert common > 2 * alone
    assert ends[0]["rmse_low_mm"] < 10 < ends[0]["rmse_high_mm"]


def test_plan_accuracy_removes_easting_and_northing_separately():
    table = pd.DataFrame({"dx_m": [0.02, 0.04], "dy_m": [0.0, 0.0], "reason": ["", ""]})
    kept, removed = plan_accuracy(table).to_dict("records")
    assert kept["mean_east_mm"] == pytest.approx(30)
    assert kept["rmse_mm"] == pytest.approx(np.sqrt((20**2 + 40**2) / 2))
    assert removed["rmse_mm"] == pytest.approx(10)


def test_real_drives_against_airborne_heights(real):
    cloud = io.read_cloud(real("road_ground/mls_two_drives.laz"), columns=("gps_time",))
    with np.load(real("road_ground/airborne_ground_height.npz")) as file:
        grid = [*np.meshgrid(file["x"], file["y"]), file["ground"]]
    heights = np.stack(grid, axis=-1).reshape(-1, 3)
    heights = heights[np.isfinite(heights[:, 2])]
    drive, reference = split_drives(cloud["gps_time"]), thinned(heights, 0.5)
    tables = [height_differences(cloud[drive == k], reference) for k in (0, 1)]
    first, second = (height_accuracy(table)["mean_mm"][0] for table in tables)
    # measured beforehand with another method: -62 and -48 mm; 900 and 600 points scatter by 1 mm
    assert first == pytest.approx(-62, abs=4)
    assert second == pytest.approx(-48, abs=4)


def test_le90_counts_differences_of_either_sign():
    table = pd.DataFrame({"dz_m": np.arange(-10, 1) / 1000, "reason": ""})
    assert height_accuracy(table)["le90_mm"].tolist() == pytest.approx([9.0, 5.0])


def test_a_table_of_the_path_is_taken_by_its_columns():
    points = [[3.0, 5.0, 0.0]]
    table = pd.DataFrame({"time_s": [0, 1], "easting_m": 0.0, "northing_m": [0, 10.0]})
    assert path_distance(points, table).tolist() == [3.0]
    assert path_distance(points, table.assign(height_m=1.0)).tolist() == [3.0]
    assert path_distance(pd.DataFrame(points), table).tolist() == [3.0]
    with pytest.raises(ValueError, match="no column 'northing_m' beside time_s, easting_m"):
        path_distance(points, table[["time_s", "easting_m"]])


@given(st.permutations(range(5)))
@settings(max_examples=5, deadline=None)
def test_the_order_of_targets_changes_no_corner(order):
    rng = np.random.default_rng(3)
    walls, feet = [], []
    for k in range(5):
        along, height = rng.uniform(0, 2, (2, 400)), rng.uniform(0, 3, (2, 400))
        zero = np.zeros(400)
        walls += [np.c_[along[0], zero, height[0]] + [20 * k, 0, 0]]
        walls += [np.c_[zero, along[1], height[1]] + [20 * k, 0, 0]]
        feet.append({"x_m": 20 * k + 0.05, "y_m": 0.05, "z_m": 0.0, "kind": "building", "name": k})
    cloud = np.vstack(walls)
    cloud[:, :2] += rng.normal(0, 0.02, (len(cloud), 2))
    targets = pd.DataFrame(feet)
    found = plan_differences(cloud, targets).set_index("name")
    other = plan_differences(cloud, targets.iloc[order]).set_index("name").loc[found.index]
    pd.testing.assert_frame_equal(found, other)


def test_targets_without_a_column_or_a_row_are_refused(ground):
    whole = pd.DataFrame({"x_m": [1.0], "y_m": [1.0], "z_m": [0.0]})
    for name in whole:
        with pytest.raises(ValueError, match=f"Invalid targets: no column '{name}'"):
            plan_differences(ground, whole.drop(columns=name))
    with pytest.raises(ValueError, match=r"Invalid targets: none given. Must be one or more."):
        plan_differences(ground, whole[:0])
    with pytest.raises(ValueError, match="Invalid targets: 1 of 1 not finite"):
        plan_differences(ground, whole * np.nan)


def test_a_thinned_cloud_keeps_the_point_next_to_the_middle_of_each_cell():
    cells = np.array([[0.1, 0.1, 0], [0.5, 0.6, 1], [0.9, 0.9, 2], [1.9, 0.1, 3], [1.4, 0.5, 4]])
    assert thinned(cells, 1.0)[:, 2].tolist() == [1, 4]


def test_the_street_of_the_field_has_its_things_where_they_are_stated():
    length, rng = 120.0, np.random.default_rng(2)
    table, shafts = made._poles(length, rng)
    assert len(table) == len(shafts) == 3 * len(np.arange(6, length - 4, 12))
    lamp = table["name"].str.startswith("lamp")
    assert table["diameter_m"].tolist() == np.where(lamp, 0.14, 0.06).tolist()
    tops = np.array([(one.centre + one.half)[:, 2].max() for one in shafts])
    assert tops == pytest.approx(made.CURB_M + np.where(lamp, 8.0, 3.0))
    assert (table["z_m"] == made.CURB_M).all()
    strips = np.repeat([0, 1, 2], len(table) // 3)
    low = np.array([made.ROAD_HALF_M + 0.6] * 2 + [10.0])[strips]
    wide = np.array([2.6, 2.6, 24.0])[strips]
    side = np.array([-1, 1, -1])[strips]
    assert (table["x_m"] * side).between(low, low + wide).all()
    nominal = np.tile(np.arange(6, length - 4, 12.0), 3)
    assert np.abs(table["y_m"] - nominal).max() <= 1.5
    houses, corners = made._houses(length, rng)
    found = np.array([corner[:2] for corner in corners]).reshape(-1, 2, 2)
    assert len(found) == len(houses)
    assert {corner[2:] for corner in corners} == {(made.CURB_M, "building")}
    for sign, front, recess in ((-1, 36.0, 9.0), (1, made.ROAD_HALF_M + made.PAVEMENT_M, 8.0)):
        mine = found[np.sign(found[:, 0, 0]) == sign]
        assert set(np.round(np.abs(mine[:, :, 0]).ravel(), 9)) <= {front, front + recess}
        depth = mine[:, 1, 1] - mine[:, 0, 1]
        assert (depth[:-1] >= 10).all()
        assert (depth <= 16).all()
        gaps = mine[1:, 0, 1] - mine[:-1, 1, 1]
        assert ((gaps >= 3) & (gaps <= 6)).all()
        assert 0 <= mine[0, 0, 1] <= 4
        assert mine[-1, 1, 1] <= length
    for house, (first, second) in zip(houses, found, strict=True):
        low = (house.centre - house.half).min(axis=0)
        high = (house.centre + house.half).max(axis=0)
        assert (low[1], high[1]) == pytest.approx((first[1], second[1]))
        assert sorted(np.abs([low[0], high[0]])) == pytest.approx(
            [abs(first[0]), abs(first[0]) + 10]
        )
        assert 6 <= high[2] <= 12
        assert low[2] == pytest.approx(0)
    road, *boxes = made._road(length)
    wide = np.abs(road.half[0])
    assert wide[:2] == pytest.approx([made.ROAD_HALF_M, (length + 60) / 2])
    ends = [((b.centre - b.half).min(axis=0), (b.centre + b.half).max(axis=0)) for b in boxes]
    assert all((low[2], high[2]) == pytest.approx((0, made.CURB_M)) for low, high in ends)
    sides = sorted((round(low[0], 6), round(high[0], 6)) for low, high in ends)
    reach = made.ROAD_HALF_M + made.PAVEMENT_M
    assert (-50.0, -made.ROAD_HALF_M) in sides
    assert (made.ROAD_HALF_M, reach) in sides
    outs = [one for one in sides if abs(one[1] - one[0] - 2) < 1e-6]
    assert len(outs) == 2 * len(made._bays(length))
    assert made._bays(75.0).tolist() == [[15, 21], [45, 51]]
    cars = list(made._cars(length))
    assert [np.round(np.mean(one.centre, axis=0)[1], 6) for one in cars] == [10, 32, 84]


def test_poles_without_a_diameter_are_said_and_no_others(recwarn):
    turn, height = np.meshgrid(np.arange(0, 2.6, 0.05), np.arange(0, 6, 0.05))
    post = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), height], axis=-1).reshape(-1, 3)
    targets = pd.DataFrame({"x_m": [0.0, 9.0], "y_m": 0.0, "z_m": 0.0, "diameter_m": [0.2, 0.2]})
    plan_differences(post, targets)
    plan_differences(post, targets.assign(kind=["pole", "curb"], diameter_m=[0.2, np.nan]))
    assert not recwarn
    for lacking in (targets.drop(columns="diameter_m"), targets.assign(diameter_m=[0.2, np.nan])):
        n = 2 if "diameter_m" not in lacking else 1
        with pytest.warns(UserWarning, match=f"^{n} of 2 poles have no diameter: seen from one"):
            plan_differences(post, lacking)


def test_figures_and_ends_of_errors_are_those_of_their_sums(rng):
    """RMSE on a logarithmic scale, and Student's interval of sums over blocks."""
    values, block = pd.Series(rng.normal(3, 2, 40)), np.arange(40) % 8
    found = drives.figures(values, block)
    square, sums = values**2, [(values**2)[block == k].sum() for k in range(8)]
    rmse = np.sqrt(square.mean())
    off = np.array(sums) - 5 * square.mean()
    reach = t.ppf(0.975, 7) * np.sqrt((off**2).sum() * 8 / 7) / 40
    share = reach / rmse**2 / 2
    expected = {"mean_mm": values.mean(), "min_mm": values.min(), "max_mm": values.max()}
    expected |= {"std_mm": values.std(), "rmse_mm": rmse}
    expected |= {"rmse_low_mm": rmse * np.exp(-share), "rmse_high_mm": rmse * np.exp(share)}
    assert found == pytest.approx(expected)
    ends = drives.mean_ends("east", values, block)
    off = np.array([values[block == k].sum() for k in range(8)]) - 5 * values.mean()
    reach = t.ppf(0.975, 7) * np.sqrt((off**2).sum() * 8 / 7) / 40
    mean = values.mean()
    assert ends == pytest.approx({"east_low_mm": mean - reach, "east_high_mm": mean + reach})


def test_a_trend_is_that_of_ordinary_least_squares(rng):
    distance, values = rng.uniform(0, 30, (2, 25))
    values[3], distance[9] = np.nan, np.nan
    known = np.isfinite(values) & np.isfinite(distance)
    fit = sm.OLS(values[known], sm.add_constant(distance[known])).fit()
    found = trend(distance, values)
    low, high = fit.conf_int()[1]
    expected = [fit.params[1], fit.params[0], low, high, fit.pvalues[1], 23]
    names = ["slope", "intercept", "slope_low", "slope_high", "p", "n"]
    assert found[names].tolist() == pytest.approx(expected)
    for few in ([1.0, 2.0], [1.0, 1.0, 1.0]):
        with pytest.raises(ValueError, match="Must be three or more at different distances"):
            trend(few, few)


def test_a_square_keeps_the_point_next_to_its_middle_by_a_loop(rng):
    points = rng.uniform(-5, 5, (400, 3))
    found = {tuple(row) for row in thinned(points, 0.8)}
    low = np.floor(points[:, :2].min(axis=0) / 0.8) * 0.8
    place = np.floor((points[:, :2] - low) / 0.8)
    expected = set()
    for one in np.unique(place, axis=0):
        own = points[(place == one).all(axis=1)]
        away = np.hypot(*(own[:, :2] - low - 0.8 * (one + 0.5)).T)
        expected.add(tuple(own[away.argmin()]))
    assert found == expected


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [("angle", 32, 28), ("aside", 0.47, 0.53), ("few", 1.0, 0.0), ("single", 1.0, 0.0)],
)
def test_corners_are_those_of_two_lines_within_limits(kind, inside, outside, rng):
    """Walls of 1 m that meet at 90 degrees or less, with points each 2 cm and some strays."""
    for value, known in ((inside, True), (outside, False)):
        turn = np.radians(value if kind == "angle" else 75)
        along = np.arange(0.01, 1.0, 0.02)
        corner = np.array([0.05, -0.03]) if kind != "aside" else value * np.array([0.6, 0.8])
        first = corner + along[:, None] * [1, 0]
        second = corner + along[:, None] * [np.cos(turn), np.sin(turn)]
        if not value and kind == "few":
            first, second = first[:3], second[:2]
        if not value and kind == "single":
            second = first + [0, 0.01]
        xy = np.vstack([first, second])
        x, y, n, reason = plan._corner(rng.permutation(xy))
        assert (reason == "") == known, (value, reason)
        if known:
            assert (x, y) == pytest.approx(corner, abs=1e-6)
            assert 60 < n <= len(xy)  # those near the other line do not count
            off = 2 * plan.NEAR_LINE_M / np.sin(turn)
            assert n == pytest.approx(2 * (along > off).sum(), abs=2)
    assert plan._corner(np.zeros((2, 2)))[2:] == (2, "too few points")


def test_slopes_and_differences_are_those_of_fitted_planes(rng):
    offsets, group = rng.uniform(-1, 1, (90, 3)), np.repeat([0, 2, 3], 30)
    found = heights._slopes(offsets, group, 4)
    for k in (0, 2, 3):
        own = offsets[group == k]
        _, a, b = np.linalg.lstsq(np.column_stack([np.ones(30), own[:, :2]]), own[:, 2])[0]
        assert found[k] == pytest.approx(np.degrees(np.arctan(np.hypot(a, b))), rel=1e-6)
    cloud = rng.uniform(-2, 2, (3000, 3))
    cloud[:, 2] = 100 + np.tan(np.radians(14)) * cloud[:, 0]
    spots = np.array([[0.3, 0.2, 100.0], [-0.5, 0.7, 99.9]])
    for limit, reason in ((14.1, ""), (13.9, "slope")):
        table = height_differences(cloud, spots, radius=0.3, slope_limit=limit)
        expected = 100 + np.tan(np.radians(14)) * spots[:, 0] - spots[:, 2]
        assert table["dz_m"].to_numpy() == pytest.approx(expected)
        assert table["slope_deg"].to_numpy() == pytest.approx(14)
        assert table["reason"].tolist() == [reason] * 2
        near = np.hypot(*(cloud[:, None, :2] - spots[:, :2]).transpose(2, 0, 1)) <= 0.3
        assert table["n"].tolist() == near.sum(axis=0).tolist()
    accuracy = height_accuracy(pd.DataFrame({"dz_m": [0.01, -0.03, 0.02, 0.05], "reason": ""}))
    assert accuracy["mean_mm"].tolist() == pytest.approx([12.5, 0])
    assert accuracy["median_mm"].tolist() == pytest.approx([15, 2.5])
    assert accuracy["le90_mm"].tolist() == pytest.approx([44, 41])
    assert accuracy["nmad_mm"].tolist() == pytest.approx([1.4826 * 20] * 2, rel=1e-4)
    assert accuracy["std_mm"].tolist() == pytest.approx([np.std([10, -30, 20, 50], ddof=1)] * 2)
