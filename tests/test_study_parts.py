"""Steps of several studies: charts, matching, selections, mountings, targets."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import radiometry
from mmqa_lab.chart_image import ChartMap, expected_contrast
from mmqa_lab.charts import LinePairs, imaging_chart
from mmqa_lab.cloud import Cloud
from mmqa_lab.rotations import rotations
from mmqa_lab.simulate import PRESETS, NavigationErrors, System, Trajectory
from mmqa_lab.simulate.targets import ATMOSPHERES
from mmqa_lab.studies import (
    anisotropy,
    chart_images,
    image_radiometry,
    image_resolution,
    repeatability,
    specifications,
    test_field,
)

# --- charts in images


@pytest.mark.parametrize(("sigma", "blur"), [(0.9, 0.0), (0.7, 3.0), (0.1, 0.0)])
def test_a_steps_chart_has_nine_patterns_from_just_below_the_limit_on(sigma, blur):
    layout = chart_images._steps_chart(sigma, blur)
    pairs = layout.of_kind(LinePairs)
    widths = np.array([one.pair for one in pairs])
    assert widths[1:] / widths[:-1] == pytest.approx([1.04] * 8)
    fine = np.geomspace(60, 2.3, 100_000)
    poor = expected_contrast(fine, sigma, blur) < 0.1
    limit = fine[np.argmax(poor)] if poor.any() else 2.3
    assert widths[0] == pytest.approx(max(limit / 1.04, 2.3), rel=2e-3)
    assert [one.y for one in pairs] == pytest.approx(10 + 30 * np.arange(9))
    assert {(one.x, one.length, one.direction) for one in pairs} == {(10, 24, "h")}
    bar = layout["bar"]
    right = 8 * widths[-1] + 20
    assert (bar.x, bar.y, bar.width, bar.height) == pytest.approx((right, 10, 15, 264))
    assert (layout.width, layout.height) == pytest.approx((right + 25, 284))


@pytest.mark.parametrize("view", ["orthogonal", "forward", "backward"])
def test_a_view_has_the_pixels_of_its_row_in_the_middle_of_the_chart(view):
    layout = imaging_chart()
    row = pd.Series({"pixel_v_mm": 8.0, "pixel_h_mm": 10.0})
    middle = [[500.0, 500.0]]
    for seed in range(5):
        there = chart_images._view(row, 10.0, view, layout, np.random.default_rng(seed))
        x, y = there.pixel_sizes_mm(middle)[0]
        expected = (9.0, 9.0) if view == "orthogonal" else (10.0, 8.0)
        assert (x, y) == pytest.approx(expected, rel=0.02)
        left, right = there.pixel_sizes_mm([[0.0, 500.0], [1000.0, 500.0]])[:, 1]
        if view == "orthogonal":
            assert left == pytest.approx(right, rel=2e-3)
        else:  # farther away are pixels larger, on the left or on the right
            assert (left > right) == (view == "forward")
            # at an angle of arccos(.8) a metre goes .6 m into the depth of 10 m
            assert abs(left - right) / y == pytest.approx(0.06, rel=0.1)
    only = pd.Series({"pixel_v_mm": 8.0, "pixel_h_mm": np.nan})
    there = chart_images._view(only, 10.0, "forward", layout, np.random.default_rng(1))
    assert there.pixel_sizes_mm(middle)[0] == pytest.approx([8, 8], rel=0.02)
    turns = []
    for seed in range(60):
        there = chart_images._view(only, 10.0, view, layout, np.random.default_rng(seed))
        along = np.diff(there.pixels([[480.0, 500], [520.0, 500]]), axis=0)[0]
        turns.append(np.degrees(np.arctan2(along[1], along[0])))
    assert -1.05 < min(turns) < -0.85
    assert 0.85 < max(turns) < 1.05


def test_blur_of_a_pattern_is_the_part_of_the_motion_across_its_bars():
    view = ChartMap(np.array([[0.4, 0.1, 5], [0.05, -0.3, 300], [0, 0, 1.0]]))
    for way, across in (("h", [0.4, 0.05]), ("v", [0.1, -0.3])):
        pairs = LinePairs("p", 100.0, 200.0, 10.0, way)
        moved = 12.0 * np.array([0.4, 0.05])
        unit = np.array(across) / np.hypot(*across)
        assert chart_images._blur_px(view, 12.0, pairs) == pytest.approx(abs(moved @ unit))
    seen = SimpleNamespace(pairs=pd.DataFrame({"width_px": [2.73, 2.75]}))
    assert chart_images.enough_pixels(seen).tolist() == [False, True]


# --- ways to Table 2


def test_pairs_of_images_are_asked_for_with_the_fitted_density_and_noise(monkeypatch):
    asked = []

    def chart_cloud(system, distance_m, **known):
        asked.append((system, distance_m, known))
        grid = 0.004 * np.arange(12)
        return Cloud(np.array([[0, y, z] for y in grid for z in grid]))

    monkeypatch.setattr(specifications, "chart_cloud", chart_cloud)
    focal = specifications.systems.SYSTEM_C.focal_px
    specifications.one_pair((10.0, 3))
    system, distance, known = asked.pop()
    assert (system, distance, known.pop("seed")) == ("C", 10.0, 3)
    per_px = known.pop("points_per_px")
    assert per_px * (focal / 5) ** 2 == pytest.approx(28_901)  # of Table 2 at 5 m
    assert known == {"resampled_per_m2": 0, "hard_core": 0.36, "noise_px": 0.69, "floor_m": 0}
    fused = specifications.pairs_fused((10.0, 3))
    assert len(fused) == 4 * 144
    assert [one[2]["seed"] for one in asked] == [300, 301, 302, 303]
    assert len(specifications.pairs_fused((5.0, 3))) == 144
    asked.clear()
    left = specifications.thinned((10.0, 3))
    known = asked[0][2]
    assert known["points_per_px"] * (focal / 10) ** 2 == pytest.approx(75_000)
    assert (known["noise_px"], known["floor_m"], known["correlated_share"]) == (0.15, 0.0113, 0)
    assert (known["hard_core"], known["resampled_per_m2"]) == (0, 0)
    kept = []
    for point in chart_cloud("C", 10.0).points:
        if all(np.linalg.norm(point - other) > 0.0081 for other in kept):
            kept.append(point)
    assert np.array_equal(left.points, kept)
    specifications.resampled((10.0, 3))
    assert asked[-1] == ("C", 10.0, {"seed": 3})
    seen = pd.DataFrame({"f": [105.0], "d1_mm": [3.0]})
    off = specifications.in_tolerances(seen, np.array([[100.0, 2.0]]), ["f", "d1_mm"])
    assert off.to_numpy() == pytest.approx(
        np.array([[5 / np.hypot(0.05, 2), 1 / np.hypot(0.5, 0.04)]])
    )


# --- measures of anisotropy


def test_scatter_and_pairs_are_those_of_loops(rng):
    xy = rng.random((80, 2)) * [3, 1]
    ratios = []
    for point in xy:
        order = np.argsort(np.linalg.norm(xy - point, axis=1))[1:17]
        smallest, largest = np.linalg.eigvalsh((xy[order] - point).T @ (xy[order] - point))
        ratios.append(np.sqrt(largest / smallest))
    assert anisotropy.structure_tensor(xy) == pytest.approx(np.median(ratios))
    line = np.column_stack([np.arange(30.0), np.zeros(30)])
    assert anisotropy.structure_tensor(line) == np.inf
    reach = 2 * np.sqrt(np.prod(np.ptp(xy, axis=0)) / 80)
    angles = [np.arctan2(*(b - a)[::-1]) for i, a in enumerate(xy) for b in xy[i + 1 :]
              if np.linalg.norm(b - a) <= reach]  # fmt: skip
    mean = np.angle(sum(np.exp(2j * np.array(angles)))) / 2
    off = np.abs((np.degrees(np.array(angles) - mean) + 90) % 180 - 90)
    along = (off < 45).sum()
    expected = (along - (len(angles) - along)) / len(angles)
    assert anisotropy.pair_contrast(xy) == pytest.approx(expected)
    assert np.isnan(anisotropy.pair_contrast(np.array([[0.0, 0], [9, 1]])))


# --- selections of surfaces


def test_real_surfaces_have_outlines_of_their_sizes(monkeypatch, rng):
    board = np.column_stack([rng.uniform(-0.5, 0.5, 900), rng.uniform(-0.3, 0.3, 900),
                             0.001 * rng.standard_normal(900)])  # fmt: skip
    monkeypatch.setattr(repeatability, "boards", lambda: {"a board": board})
    repeatability.real_surfaces.cache_clear()
    found = repeatability.real_surfaces()
    repeatability.real_surfaces.cache_clear()
    for name, sides in (("road, two heads", (0.81, 0.62)), ("a board", (0.65, 0.45))):
        ring = found[name].corners
        lengths = np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1)
        assert lengths == pytest.approx([*sides, *sides])
    assert len(np.unique(found["road, two heads"].points, axis=0)) == len(
        found["road, two heads"].points
    )
    (surface, seed), _ = repeatability.make("B", 5.0, 3, seed=7)
    assert seed == [7, 3, 5]
    assert np.abs(surface.corners[:, 0]) == pytest.approx(5)


def test_an_operator_clicks_once_with_his_error(monkeypatch):
    asked = []

    def polygons(corners, **known):
        asked.append(known)
        return np.array([corners, corners + 1])

    plain = dict.fromkeys(("density_polygon_per_m2", "std_mm", "sigma_mad_mm", "f"), 9.0)
    quality = SimpleNamespace(d_mm=(1, 2, 3, 4), **plain)
    seen = []
    monkeypatch.setattr(repeatability, "operator_polygons", polygons)
    monkeypatch.setattr(repeatability, "evaluate_cloud", lambda points, **known: (
        seen.append(known) or quality))  # fmt: skip
    surface = repeatability.Surface(None, np.eye(3))
    found = repeatability.selected(surface, [7])
    assert asked[0] == {"repeats": 1, "click": 0.015, "seed": [7], "vertices": 4}
    assert seen[0]["axes"] == "principal"
    assert np.array_equal(seen[0]["polygon"], np.eye(3))
    assert [found[f"d{k}_mm"] for k in (1, 2, 3, 4)] == [1, 2, 3, 4]
    made = repeatability.operators(0.03)
    made["12 clicks, level axes"]((surface, [8]))
    assert asked[1] == {"repeats": 1, "click": 0.03, "seed": [8], "vertices": 12}
    assert seen[1]["axes"] == "horizontal"
    assert repeatability.operators()["4 clicks, level axes"].__name__
    repeatability.operators()["4 clicks, level axes"]((surface, [9]))
    assert (asked[2]["click"], asked[2]["vertices"]) == (0.015, 4)


# --- predictions of the test field


def test_places_are_looked_at_when_their_profile_is_measured():
    head = PRESETS["vq-250"]
    turned = {"heading_deg": 30.0, "tilt_deg": 20.0, "lever_arm_m": (0.3, -1.0, 0.5)}
    head = replace(head, **turned, boresight_deg=(0.5, -0.3, 0.7))
    tested = System("one", (head,), NavigationErrors(), ((0.01, 0.02, 0.03),))
    path = Trajectory([100.0, 110.0], [[5.0, 0, 2], [5.0, 90, 2]])
    places = np.array([[12.0, 40, 0], [1.0, 60, 1.5], [20.0, 30, 5]])
    (same, time, assumed), fall = test_field._looked_at(path, tested, places)
    assert same is places
    where, turn = path.at(time)
    for k, place in enumerate(places):
        origin = where[k] + turn[k] @ head.lever_arm_m
        beam = turn[k].T @ (place - origin)
        assert beam @ head.plane_normal == pytest.approx(0, abs=1e-9)
        assert fall[k] == pytest.approx(abs(beam[2]) / np.linalg.norm(beam))
        off = rotations(*np.radians([0.5, -0.3, 0.7])[:, None])[0]
        known = np.array([0.3, -1.0, 0.5]) + [0.01, 0.02, 0.03] + beam @ off
        assert assumed[k] == pytest.approx(known)
    early = test_field._looked_at(path, tested, places - [0, 500, 0])[0][1]
    late = test_field._looked_at(path, tested, places + [0, 500, 0])[0][1]
    assert (early == 100).all()
    assert (late == 110).all()
    plain = System("plain", (replace(head, boresight_deg=(0, 0, 0)),))
    (_, time, assumed), _ = test_field._looked_at(path, plain, places)
    assert test_field._carried(path, places, time, assumed) == pytest.approx(0, abs=1e-9)
    moved = Trajectory([100.0, 110.0], [[5.1, 0.2, 2.3], [5.1, 90.2, 2.3]])
    off = test_field._carried(moved, places, time, assumed)
    assert off == pytest.approx(np.tile([0.1, 0.2, 0.3], (3, 1)), abs=1e-9)


def test_two_heads_look_to_both_sides_with_their_errors():
    made = test_field.two_heads(NavigationErrors())
    left, right = made.heads
    assert (left.lever_arm_m, right.lever_arm_m) == ((-0.4, -0.6, 0.3), (0.4, -0.6, 0.3))
    assert (left.heading_deg, right.heading_deg) == (45, -45)
    assert (left.boresight_deg, right.boresight_deg) == test_field.BORESIGHT_DEG
    assert left.divergence_mrad == 0
    errors = made.assumed_lever_arms - [left.lever_arm_m, right.lever_arm_m]
    assert errors == pytest.approx(np.array(test_field.LEVER_ARM_ERROR_M))


# --- targets in images


def test_a_grey_wedge_has_its_targets_side_by_side():
    radiance = np.array([10.0, 40.0, 90.0])
    image, places = image_radiometry.grey_wedge(radiance, 0.5, [1])
    assert image.shape == (24, 72)
    assert places.tolist() == [[0, 24, 0, 24], [0, 24, 24, 48], [0, 24, 48, 72]]
    for (top, end, left, right), light in zip(places, radiance, strict=True):
        part = image[top:end, left:right]
        dn = 60 + 28 * light * 0.5
        assert part.mean() == pytest.approx(dn, abs=4 * np.sqrt(dn / 10 + 4) / 24)
    table, truth = image_radiometry.wedge_targets(0.0, 2)
    assert truth == {"gain": 28, "offset": 60}
    assert len(table) == 90
    for (time, stop), rows in table.groupby(["time_s", "f_number"]):
        exposure = time / 0.005 * (8 / stop) ** 2
        assert rows["exposure"].to_numpy() == pytest.approx(exposure)
        assert rows["setting"].unique().tolist() == [f"{1000 * time:g} ms, f/{stop:g}"]
        seen = rows[rows["saturated_share"] == 0]
        expected = 60 + 28 * seen["radiance"] * exposure
        assert (seen["mean_dn"] - expected).abs().max() < 5 * np.sqrt(4 + 409) / 24 + 0.1
    drawn = [np.log(image_radiometry.wedge_targets(0.1, seed)[0]["mean_dn"].to_numpy()[5::10] - 60)
             for seed in range(25)]  # fmt: skip
    assert np.std(drawn, axis=0).mean() == pytest.approx(0.1, rel=0.2)
    targets = table.assign(std_dn=0.0)
    fit = image_radiometry.calibrated(targets)
    assert fit.gain == pytest.approx(28, rel=0.01)
    air = image_radiometry.air_of("hazy", "green")
    assert air.irradiance == pytest.approx(1.08 * ATMOSPHERES["hazy"].irradiance)
    assert air.path_radiance == pytest.approx(1.5 * ATMOSPHERES["hazy"].path_radiance)


def test_reflectances_by_proportion_and_by_the_darkest_pixel():
    sensor = radiometry.fit_sensor([10, 20, 40, 80], [120, 220, 420, 820])
    air = ATMOSPHERES["clean"]
    known = pd.DataFrame({"reflectance": [0.2, 0.5], "mean_dn": [220.0, 520.0]})
    seen = pd.DataFrame({"mean_dn": [104.0, 312.0]})
    field = SimpleNamespace(references=known, surfaces=seen, darkest_dn=70.0, sensor=sensor,
                            exposure=2.0, standard_air=air)  # fmt: skip
    assert image_radiometry.one_target(field).tolist() == pytest.approx([0.1, 0.3])
    light = (np.array([104.0, 312]) - 70) / 10 / 2
    expected = 0.01 + np.pi * light / (air.irradiance * air.direct)
    assert image_radiometry.dark_pixel(field) == pytest.approx(expected)
    surfaces = pd.DataFrame({"target_class": ["a b", "a b", "c"], "reference": [0.1, 0.2, 0.4]})
    found = image_radiometry.class_errors([0.13, 0.28, 0.38], surfaces)
    assert found == pytest.approx({"a_b_percent": np.sqrt((900 + 1600) / 2), "c_percent": 5})


def test_the_rise_of_an_edge_gives_its_gaussian(rng):
    from mmqa_lab.simulate.targets import render_edge

    patch = render_edge((60, 64), image_resolution.spread_of("gaussian", 0.15), angle_deg=6.0)
    found = image_resolution.rise(patch)
    sigma = np.sqrt(image_resolution.spread_of("gaussian", 0.15).sigma_px ** 2 + 1 / 12 + 1 / 192)
    assert found["fwhm_px"] == pytest.approx(2.355 * sigma, rel=0.02)
    assert found["mtf50"] * found["fwhm_px"] == pytest.approx(
        2.355 * np.sqrt(np.log(2) / 2) / np.pi, rel=1e-6
    )
    cells = pd.DataFrame(
        {"method": "m", "lens": list("aabb"), "mtf50_error_percent": [1.0, -9, 2, 4]}
    )
    table = image_resolution.errors_by_lens(cells).loc["m"]
    assert table.loc["a"].tolist() == pytest.approx([-4, 1 + 0.95 * 8, 2])
    errors = image_resolution.edge_errors({"mtf50": 0.22, "x": 1}, {"mtf50": 0.2})
    assert errors == pytest.approx({"mtf50_error_percent": 10})


def test_a_mounting_is_scored_by_its_largest_errors_and_what_its_clouds_show(monkeypatch):
    asked = []

    def corrected(cloud, path, *, lever_arms_m, values):
        asked.append((cloud, path, lever_arms_m))
        return SimpleNamespace(points=np.full((2, 3), float(len(asked))))

    module = SimpleNamespace(
        height_differences=lambda points, control, radius: (points, control, radius),
        height_accuracy=lambda given: {"std_mm": [1.0, given[0].sum() + given[2]]},
        plan_differences=lambda points, poles: pd.DataFrame({"x": points[:1, 0], "of": poles}),
        plan_accuracy=lambda rows: {"rmse_mm": [0, rows["x"].sum()], "n": [0, len(rows)]},
    )
    monkeypatch.setattr(test_field, "corrected", corrected)
    monkeypatch.setattr(test_field, "test_field", module)
    truth = np.arange(12.0).reshape(2, 6)
    errors = np.array([[0.1, -0.4, 0.2, 0.01, 0.02, -0.03], [0.0, 0.3, 0.1, 0.05, -0.6, 0.01]])
    survey = SimpleNamespace(true_values=truth, lever_arms_m="arms", control="control", poles="all",
                             drives=[("one", "there"), ("two", "back")])  # fmt: skip
    found = test_field.score(truth + errors, survey)
    assert asked == [("one", "there", "arms"), ("two", "back", "arms")]
    assert found["angle_deg"] == pytest.approx(0.4)
    assert found["arm_mm"] == pytest.approx(600)
    assert found["height_std_mm"] == 6 * 1 + 6 * 2 + 0.5  # of both clouds, within half a metre
    assert (found["pole_rmse_mm"], found["poles"]) == (3, 2)
    assert not test_field.as_installed(survey).any()


def test_surveys_of_two_drives_have_the_truth_of_their_heads(monkeypatch):
    asked = []
    street = SimpleNamespace(poles="poles", ground=lambda *, spacing_m, seed: (spacing_m, seed))

    def drive(*given, **known):
        asked.append((given, known))
        return "a", "b"

    monkeypatch.setattr(test_field, "drive_test_field", drive)
    found = test_field.two_drives(street, navigation="good", pulses_per_s=5.0, seed=8)
    (((of, tested), known),) = asked
    assert of is street
    assert tested.navigation is test_field.GOOD_NAVIGATION
    assert known == {"seed": 8, "pulses_per_s": 5.0}
    assert (found.drives, found.poles, found.control) == (("a", "b"), "poles", (2.0, 8))
    assert found.true_values[:, :3] == pytest.approx(np.array(test_field.BORESIGHT_DEG))
    assert found.true_values[:, 3:] == pytest.approx(-np.array(test_field.LEVER_ARM_ERROR_M))
    assert found.lever_arms_m == pytest.approx(tested.assumed_lever_arms)
    assert test_field.two_drives(street, seed=8, drives="there").drives == "there"
    assert len(asked) == 1
