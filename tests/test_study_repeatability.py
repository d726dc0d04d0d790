"""The study of selections: its surfaces, groups, laws, and checks that can fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.studies import repeatability as study
from mmqa_lab.studies.repeatability import drawings, selections, surfaces


@pytest.fixture(scope="module")
def charts():
    """One drive of two systems past the chart at 10 m."""
    return surfaces.charts(names=["A", "B tilted"], distances=[10], scans=1, seed=1)


def selected(spread_percent, *, system="A", count=10):
    """A table of selections whose density spreads by so much, and whose medians stand still."""
    table = pd.DataFrame({"selection": np.arange(count)})
    wave = 1 + spread_percent / 100 * (np.arange(count) % 5) / 4
    spacings = {f"d{k}_mm": 10.0 * k for k in range(1, 5)}
    fixed = {"system": system, "distance_m": 10.0, "scan": 0, "kind": "simulated", "f": 4.0}
    density = {"density_polygon_per_m2": 2000 * wave, "density_hull_per_m2": 2000 * wave}
    return table.assign(**fixed, **spacings, **density, std_mm=5.0, sigma_mad_mm=5.0)


def test_charts_are_outlined_half_a_square_metre(charts):
    inner = [evaluate_cloud(chart.points, polygon=chart.corners) for chart in charts]
    # the plane of the points is tilted by tenths of a degree against the outline
    assert [q.area_polygon_m2 for q in inner] == pytest.approx([0.71**2] * 2, rel=1e-4)
    bordered = surfaces.charts(names=["A"], distances=[10], scans=1, seed=1, margin=0)[0]
    whole = evaluate_cloud(bordered.points, polygon=bordered.corners)
    # twice the area; a few points of the edge lie outside by their noise
    assert whole.n == pytest.approx(inner[0].n / 0.71**2, rel=0.03)


def test_the_road_is_always_there():
    road = surfaces.real_surfaces()[0]
    assert (road.name, road.kind) == ("road, two heads", "real")
    assert evaluate_cloud(road.points, polygon=road.corners).n > 2000


@pytest.mark.real
def test_boards_and_the_wall_of_the_hall(real):
    real("hdl32e_pair/a_to_b.txt")
    found = {(s.name, s.scan): s for s in surfaces.real_surfaces()}
    walls = [found["hall wall", scan] for scan in (0, 1)]
    # the same outline in both sweeps: their planes agree to the size of the noise, 2 cm
    for wall in walls:
        assert evaluate_cloud(wall.points, polygon=wall.corners).sigma_mad_mm < 30
    assert found["board, VLP-16", 0].distance_m == pytest.approx(1.78, abs=0.01)


def test_selections_repeat_with_their_seed_and_name_their_axes(charts):
    choices = {"repeats": 3, "click": 0.01, "seed": 4}
    first, again = (selections.compute(charts, **choices) for _ in range(2))
    pd.testing.assert_frame_equal(first, again)
    level = selections.compute(charts[:1], **choices, axes="horizontal")
    assert set(level["system"]) == {"A" + selections.LEVEL}
    assert level["density_polygon_per_m2"].tolist() == first["density_polygon_per_m2"][:3].tolist()


@pytest.mark.parametrize(("spread", "share"), [(0.5, 1.0), (1.5, 0.0)])
def test_the_remark_on_tables_that_are_known(spread, share):
    groups = selections.groups_of_five(selected(spread))
    assert len(groups) == 2
    # the range is the spread over the mean of the group, half of the spread above the smallest
    assert groups["density_range_percent"][0] == pytest.approx(spread / (1 + spread / 200))
    answers = selections.answers(groups).set_index("published")["holds_share"]
    assert answers["density varies below 1 %"] == share
    assert answers["medians show no variation"] == 1


def test_groups_that_are_not_full_are_left_out():
    assert len(selections.groups_of_five(selected(1, count=13))) == 2


def test_the_spread_of_a_random_pattern_follows_the_law():
    table = selections.spread_over("area", (0.2, 0.8), repeats=15, clouds=6, seed=7)
    rows = table[table["figure"] == "density_polygon_per_m2"]
    # six clouds of fifteen: each s_r is known to 1 / sqrt(2 x 84) = 8 %
    assert (rows["relative_s_r"] / rows["predicted"]).to_numpy() == pytest.approx(1, abs=0.3)


def test_strays_and_roundings_of_a_known_surface(charts):
    strays = selections.stray_sweep(charts[1], shares=(0, 0.1), depths=(0.1, 0.5), seeds=(1,))
    clean, dirty = strays.iloc[0], strays.iloc[1]
    assert clean["std_mm"] == pytest.approx(clean["std_predicted_mm"])
    assert dirty["std_mm"] == pytest.approx(dirty["std_predicted_mm"], rel=0.15)
    choices = {"repeats": 3, "click": 0.01, "seed": 1}
    rounded = selections.roundings(charts[0], steps_mm=(0, 10), **choices)
    d1 = rounded[rounded["figure"] == "d1_mm"].set_index("rounding_mm")["mean"]
    # the shortest distances of a 1 cm grid are 10 and 14.14 mm; unrounded it is 12.55 mm
    assert min(abs(d1[10] - 10), abs(d1[10] - 200**0.5)) < 0.1
    assert d1[0] == pytest.approx(12.55, abs=0.05)


def test_the_check_on_strays_fails_where_sigma_mad_follows_std(charts):
    strays = selections.stray_sweep(charts[1], shares=(0, 0.1), depths=(0.1, 0.5), seeds=(1,))
    laws = pd.DataFrame({"figure": ["std_mm", "sigma_mad_mm"], "relative_s_r": [1.0, 1.9]})
    assert all(check.passed for check in study._checks_on_dispersion(strays, laws))
    worse = strays.assign(sigma_mad_mm=strays["std_mm"])
    assert not study._checks_on_dispersion(worse, laws)[0].passed


def test_explorer_draws_one_selection(charts):
    draw = drawings.figure_of_operator(charts[0])
    plain, strays = draw(1.0, 0, 1), draw(1.0, 10, 1)
    assert "points/m²" in plain.axes[0].get_title()
    std = [figure.axes[1].get_legend().get_texts()[0].get_text() for figure in (plain, strays)]
    assert std[0] != std[1]
