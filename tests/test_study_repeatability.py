"""The study of selections: its surfaces, operators, ranges, and checks that can fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench, plots
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.planes import sigma_mad
from mmqa_lab.published import ledger
from mmqa_lab.studies import repeatability as study

FOUR = "4 clicks, principal axes"


@pytest.fixture(scope="module")
def results():
    """Two systems at 10 m, two scans, ten selections, two operators."""
    operators = {name: study.OPERATORS[name] for name in (FOUR, "4 clicks, level axes")}
    cases = bench.grid(system=("A", "B tilted"), distance_m=10.0, scan=range(2))
    return bench.run(cases, operators, make=study.surface_to_select, seeds=range(10))


@pytest.fixture(scope="module")
def tables():
    """Tables of which every check speaks well."""
    shares = pd.DataFrame({"system": ["B", "B tilted"], "distance_m": 10.0})
    strays = pd.DataFrame({"share": [0.0, 0.1], "std_mm": [5.0, 50.0], "sigma_mad_mm": [5.0, 5.5]})
    laws = {"figure": ["density_polygon_per_m2"], "relative_s_r": [1.0], "predicted": [1.02]}
    return {
        "shares": shares.assign(precision_mm_true_share=1.0, density_percent_true_share=0.5),
        "cover": pd.DataFrame({"density": [1.0, 0.9], "d1": [0.94, 0.96]}),
        "scans": 100,
        "laws": pd.DataFrame(laws),
        "strays": strays.assign(sigma_mad_predicted_mm=[5.0, 5.6]),
        "components": pd.DataFrame({"factor": ["selection"], "figure": ["f"], "share": [0.01]}),
    }


def known(spread_percent, *, count=10):
    """Selections whose density spreads by so much, and whose medians stand still."""

    def selection(seed):
        wave = 1 + spread_percent / 100 * (seed % 5) / 4
        fixed = {f"d{k}_mm": 10.0 * k for k in range(1, 5)} | {"std_mm": 5.0, "f": 4.0}
        return fixed | {"sigma_mad_mm": 5.0, "density_polygon_per_m2": 2000 * wave}

    cases = bench.grid(system="B tilted", distance_m=10.0, scan=0)
    made = {"make": lambda system, distance_m, scan, seed: seed}
    return bench.run(cases, {FOUR: selection}, **made, seeds=range(count))


def test_charts_are_outlined_half_a_square_metre():
    for system in ("A", "B tilted"):
        chart = study.chart_scan(system, 10.0, 0)
        found = evaluate_cloud(chart.points, polygon=chart.corners)
        # the plane of the points is tilted by tenths of a degree against the outline
        assert found.area_polygon_m2 == pytest.approx(0.812 * 0.616, rel=1e-4)
    whole = study.chart_scan("A", 10.0, 0, margins=0)
    chart = study.chart_scan("A", 10.0, 0)
    inner = evaluate_cloud(chart.points, polygon=chart.corners)
    bordered = evaluate_cloud(whole.points, polygon=whole.corners)
    # twice the area; a few points of the edge lie outside by their noise
    assert bordered.n == pytest.approx(inner.n / (0.812 * 0.616), rel=0.04)


def test_the_fitted_noise_gives_the_published_precision():
    from mmqa_lab import published

    table = published.table("pfeifer2021", "table_2").set_index(["system", "distance_m"])
    chart = study.chart_scan("B tilted", 10.0, 0)
    found = evaluate_cloud(chart.points, polygon=chart.corners).sigma_mad_mm
    # sigma_MAD of 700 points is known to 4 %
    assert found == pytest.approx(table.loc[("B", 10), "sigma_mad_mm"], rel=0.15)


def test_the_road_is_always_there():
    road = study.real_surfaces()["road, two heads"]
    assert evaluate_cloud(road.points, polygon=road.corners).n > 2000


@pytest.mark.real
def test_the_wall_of_the_hall(real):
    real("hdl32e_pair/sweep_a.laz")
    wall = study.real_surfaces()["hall wall"]
    # a flat wall: its dispersion is the noise, 2 cm
    assert evaluate_cloud(wall.points, polygon=wall.corners).sigma_mad_mm < 30


def test_operators_differ_in_their_axes_alone(results):
    cells = bench.cell_table(results).set_index(["method", "system", "scan", "seed"])
    density = cells["density_polygon_per_m2"]
    pd.testing.assert_series_equal(density[FOUR], density["4 clicks, level axes"])
    assert (cells.loc[FOUR, "d4_mm"] != cells.loc["4 clicks, level axes", "d4_mm"]).any()


def test_limits_are_those_of_the_library(results):
    from mmqa_lab.repeatability import repeatability

    table = study.limits(results).set_index(["method", "system", "figure"])
    cells = bench.cell_table(results).query("method == @FOUR and system == 'B tilted'")
    assert table.loc[(FOUR, "B tilted", "f"), "s_r"] == repeatability(cells, "f").s_r
    lacking = results.copy()
    lacking["f"] = results["f"].where(results["method"] != FOUR)  # as of a method without f
    rest = study.limits(lacking)
    assert len(rest) == len(table) - len(rest["system"].unique()) * rest["distance_m"].nunique()
    figure = study.draw_limits(rest)
    assert len(figure.axes) == 2
    plots.plt.close(figure)


@pytest.mark.parametrize(("spread", "share"), [(0.5, 1.0), (1.5, 0.0)])
def test_the_remark_on_selections_that_are_known(spread, share):
    ranges = study.ranges_of_five(known(spread))
    assert len(ranges) == 2
    # the range is the spread over the mean of the group, half of the spread above the smallest
    assert ranges["density_percent"][0] == pytest.approx(spread / (1 + spread / 200))
    found = study.remarks(ranges).iloc[0]
    assert found["density_percent_true_share"] == share
    assert found["medians_mm_true_share"] == 1


def test_groups_that_are_not_full_are_left_out():
    assert len(study.ranges_of_five(known(1, count=13))) == 2


@pytest.mark.parametrize(("spread", "verdict"), [(0.5, "consistent"), (1.5, "differs")])
def test_ledger_of_known_selections(spread, verdict):
    cells = ledger.cells().set_index(["table", "cell"])
    entries = {row["cell"]: row for row in study.entries(study.ranges_of_five(known(spread)))}
    assert set(entries) == {"selection_density", "selection_precision", "selection_distances"}
    printed = cells.loc[("numbers", "selection_density")]
    assert ledger.verdict(printed, entries["selection_density"]) == verdict
    printed = cells.loc[("numbers", "selection_distances")]
    assert ledger.verdict(printed, entries["selection_distances"]) == "reproduced"
    assert study.entries(study.ranges_of_five(known(1)).query("system == 'A'")) == []


def test_strays_of_a_known_surface():
    chart = study.chart_scan("B tilted", 10.0, 0)
    strays = study.stray_sweep(chart, shares=(0, 0.1), depths=(0.1, 0.5), seeds=(1,))
    clean, dirty = strays.iloc[0], strays.iloc[1]
    assert clean["std_mm"] == pytest.approx(clean["std_predicted_mm"])
    assert dirty["std_mm"] == pytest.approx(dirty["std_predicted_mm"], rel=0.15)


def test_checks_pass_on_what_they_speak_of(tables):
    assert all(check.passed for check in study.checks(**tables))


@pytest.mark.parametrize(
    ("name", "column", "value"),
    [
        ("shares", "precision_mm_true_share", 0.5),
        ("shares", "density_percent_true_share", 0.95),
        ("cover", "d1", 0.8),
        ("laws", "relative_s_r", 2.0),
        ("strays", "sigma_mad_mm", 9.0),
        ("components", "share", 0.3),
    ],
)
def test_each_check_can_fail(tables, name, column, value):
    worse = tables | {name: tables[name].assign(**{column: value})}
    assert sum(not check.passed for check in study.checks(**worse)) == 1


def test_answer_and_explorer(results):
    table = study.limits(results).query("system == 'B tilted' and method == @FOUR")
    said = study.answer(table.set_index("figure"), click_m=0.003, name="B tilted", distance=10.0)
    assert said.startswith("With vertices off by 0.3 cm, B tilted at 10 m")


@pytest.mark.parametrize("share", [0.0, 0.05, 0.1, 0.3])
def test_contaminated_sigma_mad_by_drawing(share):
    rng = np.random.default_rng(8)
    residuals = rng.standard_normal(200_000)
    residuals[: int(share * len(residuals))] = 50
    # sigma_MAD of 200,000 residuals is known to 0.3 %
    assert sigma_mad(residuals) == pytest.approx(study.contaminated_sigma_mad(share), rel=0.01)


def test_strays_are_as_many_and_as_far_as_said(rng):
    points = np.column_stack([rng.random((900, 2)), np.zeros(900)])
    mixed = study.with_strays(points, share=0.1, depths=(0.2, 0.4), seed=1)
    assert len(mixed) == 1000
    assert np.array_equal(mixed[:900], points)
    assert ((mixed[900:, 2] > 0.2) & (mixed[900:, 2] < 0.4)).all()
