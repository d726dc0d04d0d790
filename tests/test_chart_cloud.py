"""The evaluation of a chart's cloud: known patterns, brute force, published values, selections."""

import json
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import planes, tender
from mmqa_lab.__main__ import main
from mmqa_lab._checks import check_points
from mmqa_lab._results import digits
from mmqa_lab.chart_cloud import (
    chart_polygon,
    evaluate,
    evaluate_cloud,
    inside_polygon,
)
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_cloud, write_cloud
from mmqa_lab.maps import map_cloud
from mmqa_lab.planes import PAPER_SCALE, fit_plane
from mmqa_lab.spacing import empty

CHART = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], dtype=float)


def fit_plane_area(polygon):
    """Area of a polygon in space by the cross products of its diagonals."""
    return np.linalg.norm(np.cross(polygon[2] - polygon[0], polygon[3] - polygon[1])) / 2


def scan_lines(rng, *, along=0.0046, across=0.047, turn=0.3, noise=0.001):
    """A square metre of scan lines in UTM coordinates, rounded to 2^-20 m."""
    u, v = np.meshgrid(np.arange(0, 1, along), np.arange(0, 1, across))
    u = u + rng.uniform(0, along, (len(v), 1))
    x, y = u.ravel(), v.ravel()
    c, s = np.cos(turn), np.sin(turn)
    points = np.stack([c * x - s * y, s * x + c * y, rng.normal(0, noise, x.size)], axis=1)
    return np.round(points * 2**20) / 2**20


def test_lattice_has_its_steps_for_spacings():
    x, y = np.meshgrid(np.arange(40) * 0.015, np.arange(20) * 0.03)
    points = np.stack([x.ravel(), np.full(x.size, 5.0), y.ravel()], axis=1)
    quality = evaluate_cloud(points, axes="horizontal")
    d = quality.d_mm
    # half-open quadrants of a lattice hold one step each: two short and two long ones
    assert d == pytest.approx([15, 15, 30, 30], rel=1e-9)
    assert quality.f == pytest.approx(2)
    assert quality.area_hull_m2 == pytest.approx(39 * 0.015 * 19 * 0.03)
    assert quality.density_hull_per_m2 == pytest.approx(quality.n / (39 * 0.015 * 19 * 0.03))
    assert quality.n == 800
    assert quality.std_mm < 1e-9


def test_hull_area_is_too_small_by_a_known_amount(rng):
    n, areas = 500, []
    for _ in range(200):
        square = np.column_stack([rng.uniform(0, 1, (n, 2)), np.zeros(n)])
        areas.append(evaluate_cloud(square).area_hull_m2)
    # Rényi and Sulanke 1963: missing area of n points in a square, 8/3 (ln n + c) / n
    constant = np.euler_gamma - np.log(2)
    expected = 1 - 8 / 3 * (np.log(n) + constant) / n
    error = np.std(areas) / np.sqrt(len(areas))
    assert np.mean(areas) == pytest.approx(expected, abs=4 * error + 0.002)
    assert n / np.mean(areas) > 1.02 * n  # the density it gives is too high by over 2 %


@given(
    seed=st.integers(0, 2**32 - 1),
    shift=st.sampled_from([(652_000.0, 6_862_000.0, 60.0), (1e7, -1e7, 1e7), (0.0, 0.0, 0.0)]),
    turn=st.sampled_from([0, 1, 2, 3]),
)
@settings(max_examples=20, deadline=None)
def test_nothing_changes_when_the_cloud_is_moved_and_turned(seed, shift, turn):
    points = scan_lines(np.random.default_rng(seed), along=0.02)
    quarter = np.linalg.matrix_power([[0, -1, 0], [1, 0, 0], [0, 0, 1]], turn)  # exact in float64
    here, there = (evaluate_cloud(p) for p in (points, points @ quarter + shift))
    for name in ("std_mm", "sigma_mad_mm", "area_hull_m2", "d1_mm", "d4_mm", "f"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-9), name


def test_any_turn_changes_nothing(rng):
    points = scan_lines(rng, along=0.02)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    here, there = (
        evaluate_cloud(each, axes="principal").to_frame() for each in (points, points @ turn)
    )
    numbers = here.columns.drop(["axes", "f_exempt", "remarks"])
    # the points themselves are rounded anew by the turn, to 1e-16 m
    assert np.allclose(here[numbers], there[numbers], rtol=1e-9, atol=1e-9, equal_nan=True)


def test_selection_by_a_concave_polygon(rng):
    points = np.column_stack([rng.uniform(0, 1, 5000), np.zeros(5000), rng.uniform(0, 1, 5000)])
    corner = [[0, 0, 0], [1, 0, 0], [1, 0, 0.5], [0.5, 0, 0.5], [0.5, 0, 1], [0, 0, 1]]
    mask = inside_polygon(points, corner)
    assert np.array_equal(mask, ~((points[:, 0] > 0.5) & (points[:, 2] > 0.5)))


def test_points_behind_the_chart_are_left_out(rng):
    chart = np.column_stack([rng.uniform(0, 1, 900), np.zeros(900), rng.uniform(0, 1, 900)])
    wall = chart + [0, 0.3, 0]
    quality = evaluate_cloud(np.vstack([chart, wall]), polygon=CHART)
    assert quality.n == 900
    assert quality.density_polygon_per_m2 == pytest.approx(900)


def test_chart_polygon_leaves_out_its_margins():
    polygon = chart_polygon(CHART, margins=[0.1, 0.2, 0.3, 0.4])  # lower, right, upper, left
    assert np.allclose(polygon, [[0.4, 0, 0.1], [0.8, 0, 0.1], [0.8, 0, 0.7], [0.4, 0, 0.7]])
    # section 3.3: typically half a square metre
    assert fit_plane_area(chart_polygon(CHART)) == pytest.approx(0.5, abs=0.005)


def test_spacing_of_one_place_is_not_measurable():
    corners = np.repeat([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], 3, axis=0)
    quality = evaluate_cloud(corners)
    assert np.isnan([quality.d1_mm, quality.d4_mm, quality.f]).all()
    assert quality.spacing.incomplete_share == 1
    assert quality.spacing.coincident == 12


def test_road_patch_by_head_as_known(real):
    cloud = read_cloud(real("mls_patch/road_patch_two_heads.laz"))
    time = cloud["gps_time"] - cloud["gps_time"].min()
    known = {"A": (time < 0.32, [10, 10, 14, 36], 3.6), "B": (time > 0.32, [14, 14, 41, 42], 3.0)}
    for mask, spacings, f in known.values():
        points = np.unique(cloud.points[mask], axis=0)
        quality = evaluate_cloud(points, scale=PAPER_SCALE)
        d = quality.d_mm
        assert np.round(d).tolist() == spacings
        assert quality.f == pytest.approx(f, abs=0.05)
    assert evaluate_cloud(np.unique(cloud.points, axis=0)).f == pytest.approx(2.2, abs=0.05)


def test_default_selection_stays_in_the_random_pattern_of_the_printed_chart():
    from mmqa_lab.charts import point_chart

    layout = point_chart()
    polygon = 1000 * chart_polygon(CHART)[:, [0, 2]]
    for square in (layout["black"], layout["white"]):
        assert polygon[:, 1].min() > square.y + square.height + 30


def test_exemption_needs_a_density_that_is_asked_for(rng):
    points = np.column_stack([rng.uniform(0, 1, (8000, 2)), np.zeros(8000)])
    assert evaluate_cloud(points).f_exempt is None
    assert evaluate_cloud(points, rho0=3000).f_exempt is True  # 8000 > 2.34 x 3000
    assert evaluate_cloud(points, rho0=5000).f_exempt is False
    assert evaluate_cloud(points, rho0=3000).to_frame()["f_exempt"].item() is True


RING = np.array([[0.2, 0.2], [2.8, 0.2], [2.8, 2.8], [0.2, 2.8]])
SLOPE = np.array([0.3, -0.2])


def tilted(xy):
    """Points of a tilted plane, with coordinates as large as those of a map."""
    xy = np.asarray(xy, dtype=np.float64)
    return np.column_stack([xy, xy @ SLOPE]) + [4e5, 5e6, 300.0]


@pytest.fixture(scope="module")
def slope():
    """A grid of points on that plane, every 2 cm."""
    x, y = np.meshgrid(np.arange(0.01, 3, 0.02), np.arange(0.01, 3, 0.02))
    return tilted(np.stack([x.ravel(), y.ravel()], axis=1))


def test_a_vertex_far_off_the_plane_is_refused(slope):
    off = tilted(RING)
    off[0, 2] += 0.15
    assert inside_polygon(slope, off).sum() > 16_000
    off[0, 2] += 0.15
    with pytest.raises(ValueError, match=r"73 mm off the plane of all\. Must be at most 50 mm"):
        inside_polygon(slope, off)


def noisy(rng, n=4000):
    """Random points of a board, 2 m x 1 m, 4 mm of noise."""
    return np.column_stack([rng.random((n, 2)) * [2, 1], rng.normal(0, 0.004, n)])


def test_coarse_coordinates_and_coincident_points_are_remarked_on(rng):
    points = noisy(rng)
    assert evaluate_cloud(Cloud(points, resolution=0.001)).remarks == ()
    assert evaluate_cloud(points).remarks == ()
    coarse = "in steps of 10 mm: too coarse for sigma_MAD"
    (said,) = evaluate_cloud(Cloud(points, resolution=0.01)).remarks
    assert coarse in said
    said, twice = evaluate_cloud(points.round(2)).remarks  # no header says it
    assert coarse in said
    assert "share their place with another" in twice
    table = evaluate_cloud(points.round(2)).to_frame()
    assert table["remarks"][0] == f"{said} {twice}"


def test_two_points_in_one_place_of_thousands_are_not_said_and_leave_the_density_certain(rng):
    points = noisy(rng)
    for copies, certain in ((2, True), (40, False)):
        quality = evaluate_cloud(np.concatenate([points, points[:copies]]))
        known = {"quantity": "density_per_m2", "remarks": " ".join(quality.remarks)}
        assert ("share their place" in known["remarks"]) != certain
        said = tender.verdict(2001, "<=", 900, **known)
        assert said == ("not met" if certain else "not certain")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: np.vstack([p, p + [1e-3, 2e-4, 0]]), "d2 is 12 times d1: points come in pairs"),
        (lambda p: np.vstack([p, p.round(3)]), "points come in pairs"),
        (lambda p: np.vstack([p, [9, 0, 0]]), "1 points lie far from the others, up to 8"),
        (lambda p: p[:5], "Fewer than 50 points: no confidence intervals."),
        (lambda p: p[p[:, 0] < 1], "principal axes, and f, are by chance"),
    ],
)
def test_what_the_points_cannot_tell_is_said(rng, change, said):
    quality = evaluate_cloud(change(noisy(rng)))
    assert said in " ".join(quality.remarks)
    table = quality.intervals()
    assert quality.n >= 50 or table[["low", "high"]].isna().all(axis=None)
    assert "<td>" + digits(table["value"][0]) + "</td>" in quality._repr_html_()


def test_axes_are_horizontal_on_upright_boards(rng):
    points = scan_lines(rng)
    assert evaluate_cloud(points).axes == "principal"
    upright = points @ np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0.0]])
    default = evaluate_cloud(upright)
    assert default.axes == "horizontal"
    assert default.f == evaluate_cloud(upright, axes="horizontal").f
    assert default.remarks == ()


def test_a_polygon_at_an_angle_has_the_area_that_it_selects(rng):
    points = np.column_stack([rng.random((40_000, 2)) * 2, np.zeros(40_000)])
    ring = np.array([[0.5, 0.5], [1.5, 0.5], [1.5, 1.5], [0.5, 1.5]])
    lean = np.column_stack([ring, (ring[:, 0] - 1) * np.tan(np.radians(9.5))])
    quality = evaluate_cloud(points, polygon=lean, thickness=0.2)
    # 10,000 points a square metre, with four standard errors
    assert quality.density_polygon_per_m2 == pytest.approx(10_000, rel=0.012)


def test_a_polygon_without_points_says_how_far_the_cloud_is(slope):
    with pytest.raises(ValueError, match=r"0 given.* is [\d.e+]+ m from its centre"):
        evaluate_cloud(slope, polygon=tilted(RING) + [1000, 0, 0])


def test_the_plot_says_the_figures(rng):
    points = scan_lines(rng)
    quality = evaluate_cloud(points)
    frame = fit_plane([[0, 0, 0], [0, 3, 0], [1, 0, 0], [1, 3, 0.0]])
    figure = quality.plot(frame)
    places = figure.axes[0].collections[0].get_offsets()
    assert np.allclose(places, frame.project(points), atol=1e-4)
    said = [text.get_text() for ax in figure.axes if (key := ax.get_legend()) for text in key.texts]
    plt.close(figure)
    assert said[:2] == [f"median $d_{k}$ = {quality.d_mm[k - 1]:.1f} mm" for k in (1, 4)]
    assert said[2] == f"places: $e_{{95}}$ = {quality.e95_mm:.1f} mm"
    assert said[3] == f"±std = {quality.std_mm:.1f} mm"


@pytest.mark.parametrize(("ratio", "said"), [(1.5, False), (10, True)])
def test_points_that_are_denser_on_one_side_are_said(rng, ratio, said):
    points = noisy(rng, 12_000)
    points = points[rng.random(len(points)) < ratio ** (-points[:, 0] / 2)]
    (sentence,) = evaluate_cloud(points).remarks or ("",)
    assert sentence.startswith("Points are uneven: ") == said
    if said:  # the middles of the outer columns of blocks are 3/4 apart
        low, high = map(float, re.findall(r"(\d+)(?: per m2)? in the", sentence))
        assert high / low == pytest.approx(ratio**0.75, rel=0.25)


def test_a_polygon_that_is_mostly_empty_is_said(rng):
    points = rng.random((4000, 3)) * [10, 2, 0]
    square = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0.0]])
    remarks = evaluate_cloud(points, polygon=square).remarks
    assert "Points lie on 20 % of the polygon: its density counts the rest too." in remarks


@pytest.mark.parametrize(("apart_m", "said"), [(0, False), (0.1, True)])
def test_two_layers_are_said(rng, apart_m, said):
    points = rng.random((4000, 3)) * [1, 1, 0] + [0, 0, 1] * rng.normal(0, 0.01, (4000, 1))
    points[::2, 2] += apart_m
    remarks = " ".join(evaluate_cloud(points).remarks)
    assert ("two layers" in remarks) == said


@pytest.mark.parametrize(("rise_m", "said"), [(0, False), (0.2, True)])
def test_a_bent_surface_is_said_with_the_noise_about_it(rng, rise_m, said):
    points = rng.uniform(-1, 1, (4000, 3)) * [2, 1, 0] + [0, 0, 1] * rng.normal(0, 0.01, (4000, 1))
    points[:, 2] += rise_m * points[:, 1] ** 2
    remarks = " ".join(evaluate_cloud(points).remarks)
    assert ("The surface is bent" in remarks and "sigma_MAD is 10." in remarks) == said


@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.parametrize("place", [0.3, 0.5])
@pytest.mark.parametrize("n", [800, 20_000])
def test_a_step_across_a_surface_is_said_with_the_noise_beside_it(rng, turn, place, n):
    points = rng.random((n, 3)) * [1, 1, 0] + [0, 0, 1] * rng.normal(0, 0.0041, (n, 1))
    assert "stepped" not in " ".join(evaluate_cloud(points).remarks)
    along = points[:, :2] @ [np.cos(turn), np.sin(turn)]
    points[:, 2] += 0.03 * (along > place * (np.cos(turn) + np.sin(turn)))
    quality = evaluate_cloud(points)
    (said,) = (one for one in quality.remarks if "stepped" in one)
    noise_mm = float(said.split("sigma_MAD is ")[1].split()[0])
    assert quality.sigma_mad_mm > 8.5
    assert 4 < noise_mm < 6


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(60, 3000), st.floats(0.2, 5))
def test_noise_alone_is_neither_bent_nor_stepped(seed, n, wide):
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.random((n, 2)) * [wide, 1], rng.normal(0, 0.004, n)])
    assert not any("surface is" in one for one in evaluate_cloud(points).remarks)


def test_points_are_checked_once_on_their_way(monkeypatch):
    checked = []

    def counted(points, **choices):
        checked.append(len(points))
        return check_points(points, **choices)

    for room in (evaluate, planes, empty):
        monkeypatch.setattr(room, "check_points", counted)
    points = np.random.default_rng(3).random((400, 3)) * [3, 1, 0.002]
    evaluate_cloud(points, rho0=3000.0)
    evaluate_cloud(points, polygon=[[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
    assert [n for n in checked if n > 4] == [400, 400]


def test_a_number_turns_the_axes_counter_clockwise_about_the_normal():
    points = np.random.default_rng(3).random((400, 3)) * [3, 1, 0.002]
    straight, turned = (evaluate_cloud(points, axes=one).plane.axes for one in ("principal", 20.0))
    sine = np.cross(straight[0], turned[0]) @ np.cross(*straight)
    assert sine == pytest.approx(np.sin(np.radians(20)))
    assert np.cross(*turned) @ np.cross(*straight) == pytest.approx(1)


def test_axes_by_chance_give_no_interval_of_what_depends_on_them(rng):
    """Two heads crossing on the ground: f follows from axes that the next scan has elsewhere."""
    along, line = np.meshgrid(np.arange(0, 1, 0.01), np.arange(0, 1, 0.05))
    one = np.column_stack([along.ravel(), line.ravel()])
    points = np.column_stack([np.vstack([one, one[:, ::-1]]), rng.normal(0, 0.004, 2 * len(one))])
    points[:, :2] += rng.normal(0, 1e-4, (len(points), 2))
    points[:, 2] += 0.02 * points[:, 1]
    for axes, known in (("principal", False), (30.0, False), ("horizontal", True)):
        table = evaluate_cloud(points, axes=axes).intervals().set_index("figure")
        assert table.loc[["d1", "d2", "d3", "d4", "f"], "low"].notna().all() == known
        assert table.loc[["density", "sigma_mad", "g"], ["low", "high"]].notna().all(axis=None)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0.0, 1e5, -1e7]))
def test_no_figure_and_no_interval_depends_on_the_order_of_points(seed, in_rows, shift):
    rng = np.random.default_rng(seed)
    points = scan_lines(rng, along=0.02)[:1500]
    if in_rows:  # many points at the same distance across
        points[:, 1] = points[:, 1].round(2)
    points = points + shift
    one, other = (evaluate_cloud(p).intervals() for p in (points, rng.permutation(points)))
    figures = ["value", "low", "high"]
    np.testing.assert_allclose(one[figures], other[figures], rtol=1e-6)


def test_details_are_missed_between_lines_and_marked_there(rng, tmp_path, capsys):
    """Discs of 5 cm between lines 10 cm apart; the middle half of each gap shows nothing."""
    x, y = np.meshgrid(np.arange(0, 1, 0.004), np.arange(0, 1.01, 0.1))
    points = np.column_stack([x.ravel(), y.ravel(), rng.normal(0, 0.003, x.size)])
    ring = [[0.02, 0.03, 0], [0.97, 0.03, 0], [0.97, 0.97, 0], [0.02, 0.97, 0]]
    quality = evaluate_cloud(points, polygon=ring)
    share, missed = quality.details(0.05)
    # 48 mm of 100 have three points, 4 mm apart, within 25 mm
    assert share == pytest.approx(0.48, abs=0.02)
    place = quality.plane.centre + missed @ quality.plane.axes
    assert (np.abs((place[:, 1] + 0.05) % 0.1 - 0.05) > 0.024).all()
    figure = quality.plot(detail=0.05)
    marked = figure.axes[0].lines[0].get_xydata()
    plt.close(figure)
    np.testing.assert_allclose(marked, missed, atol=1e-9)
    write_cloud(tmp_path / "lines.laz", Cloud(points))
    words = "; ".join(",".join(map(str, corner)) for corner in ring)
    main(["evaluate", str(tmp_path / "lines.laz"), "--polygon", words, "--detail=0.05", "--json"])
    assert json.loads(capsys.readouterr().out)[0]["details_seen"] == pytest.approx(share, abs=0.01)
    with pytest.raises(ValueError, match=r"Invalid size 0\. Must be > 0 m"):
        quality.details(0)


def test_f_is_not_stated_below_the_step_of_coordinates():
    local = np.random.default_rng(2).random((500, 3)) * [1.2, 1, 0.01]
    far = np.float32(local + [500_000, 5_400_000, 100]).astype(float)
    quality = evaluate_cloud(Cloud(far, resolution=0.5))
    table = quality.intervals().set_index("figure")
    assert np.isnan(quality.f)
    assert table.loc["f", ["value", "low", "high"]].isna().all()
    assert any("f is not measured" in remark for remark in quality.remarks)
    dataset = map_cloud(Cloud(far, resolution=0.5))
    assert dataset["f"].isnull().all()
    assert "f is not measured in" in dataset.attrs["remarks"]
    assert np.isfinite(evaluate_cloud(Cloud(local, resolution=0.5e-6)).f)


def test_three_points_without_neighbours_are_drawn(tmp_path):
    quality = evaluate_cloud(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]))
    quality.plot(detail=0.1).savefig(tmp_path / "f.png")
    plt.close("all")


def board(n, seed=0, noise=0.005):
    """Random points of a board of 1 m with normal noise."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.random((n, 2)), rng.normal(0, noise, n)])


@pytest.mark.parametrize(
    ("left", "has_polygon", "words"),
    [
        (lambda x, y: x < 0.9, True, "e95 is 56 mm if places there count"),
        (lambda x, y: x < 0.7, True, "e95 is 25"),
        (lambda x, y: (x < 0.5) | (y < 0.5), False, "hull of the points lies more than"),
        (lambda x, y: np.hypot(x - 0.5, y - 0.5) > 0.3, False, "Give a polygon"),
    ],
)
def test_what_is_empty_of_a_surface_is_said(left, has_polygon, words):
    points = board(3000)
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] if has_polygon else None
    whole = evaluate_cloud(points, polygon=square)
    assert not any("more than" in one for one in whole.remarks)
    found = evaluate_cloud(points[left(*points[:, :2].T)], polygon=square)
    assert any(words in one for one in found.remarks), found.remarks


def test_coarse_coordinates_and_repeated_places_have_no_intervals():
    steps = evaluate_cloud(np.round(board(3000) * [2, 1, 1], 2)).intervals().set_index("figure")
    assert steps.loc[["d1", "d4", "f", "g"], ["low", "high"]].isna().all(axis=None)
    assert steps.loc["density", ["low", "high"]].notna().all()
    few = evaluate_cloud(np.repeat(board(10), 6, axis=0))
    assert few.intervals()[["low", "high"]].isna().all(axis=None)


@pytest.mark.parametrize("n", [100, 127, 200, 400])
def test_a_flat_board_has_no_layers_and_two_have(n):
    for seed in range(12):
        points = board(n, seed)
        assert not any("two layers" in one for one in evaluate_cloud(points).remarks)
    two = board(400) + np.outer(np.arange(400) % 2, [0, 0, 0.03])
    assert any("two layers" in one for one in evaluate_cloud(two).remarks)


def test_the_interval_of_the_density_does_not_turn_with_the_axes():
    points = board(2000) * [2, 0.5, 1]
    widths = []
    for turn in np.radians([0, 20, 45]):
        c, s = np.cos(turn), np.sin(turn)
        ring = np.array([[0, 0], [2, 0], [2, 0.5], [0, 0.5]]) @ [[c, s], [-s, c]]
        turned = points @ [[c, s, 0], [-s, c, 0], [0, 0, 1]]
        row = evaluate_cloud(turned, polygon=np.column_stack([ring, 0 * ring[:, 0]])).intervals()
        widths.append(np.diff(row.loc[0, ["low", "high"]].to_numpy(float))[0])
    assert np.ptp(widths) < 0.1 * np.mean(widths)
