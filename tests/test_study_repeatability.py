"""The study of selections: its surfaces, operators, ranges, and checks that can fail."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled
from scipy.spatial.transform import Rotation

from mmqa_lab import bench
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.studies import repeatability as study

FOUR = "4 clicks, principal axes"


@pytest.fixture(scope="module")
def results():
    """Two systems at 10 m, two scans, ten selections, two operators."""
    methods = {name: study.METHODS[name] for name in (FOUR, "4 clicks, level axes")}
    small = {"systems": ("A", "B tilted"), "distances": (10.0,), "scans": 2, "seeds": range(10)}
    return study.bench(methods=methods, **small).run()


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


@pytest.mark.parametrize("spread", [0.5, 1.5])
def test_ranges_of_selections_that_are_known(spread):
    ranges = study.ranges_of_five(known(spread))
    assert len(ranges) == 2
    # the range is the spread over the mean of the group, half of the spread above the smallest
    assert ranges["density_percent"][0] == pytest.approx(spread / (1 + spread / 200))
    assert (ranges[["precision_mm", "medians_mm"]] == 0).all(axis=None)


def test_groups_that_are_not_full_are_left_out():
    assert len(study.ranges_of_five(known(1, count=13))) == 2


def test_each_check_can_fail():
    parts = pd.Series({"density": 0.01, "f": 0.02})
    whole = {
        "of_selections": parts,
        "precise": pd.Series([100.0, 100.0]),
        "dense": pd.Series([40.0, 60.0]),
        "worst": pd.Series({"covered": 0.93, "figure": "f", "pattern": "poisson"}),
        "least": 0.86,
        "others": pd.DataFrame({"covered": [0.93, 0.99]}),
        "coverage_scans": 100,
        "ratio": pd.Series([1.0, 1.05]),
        "ratio_mean": 1.02,
        "grown": 8.0,
        "off": 0.05,
    }
    assert spoiled("repeatability", whole) == []
    changes = {
        "In every metric": {"of_selections": parts + 0.2},
        "Five simulated selections of B at 10 m: sigma_MAD": {"agrees": False},
        "Five simulated selections of B at 10 m: the density": {"dense": pd.Series([95.0, 99.0])},
        "All intervals": {
            "worst": pd.Series({"covered": 0.6, "figure": "f", "pattern": "poisson"})
        },
        "The spread of the density": {"ratio_mean": 1.55},
        "Strays": {"off": 0.4},
    }
    for words, change in changes.items():
        (failed,) = spoiled("repeatability", whole | change)
        assert failed.startswith(words)


def test_a_surface_is_outlined_around_its_middle_along_its_own_axes(rng):
    turn = Rotation.from_euler("xyz", [20, -35, 60], degrees=True).as_matrix()
    local = np.column_stack([rng.uniform(-1, 1, 4000), rng.uniform(-0.4, 0.4, 4000), 0 * turn[0, 0]
                             + 0.002 * rng.standard_normal(4000)])  # fmt: skip
    found = study._outlined(local @ turn.T + [7, 8, 9], 0.8, 0.5)
    corners = (found.corners - [7, 8, 9]) @ turn
    assert np.abs(np.abs(corners[:, 0]) - 0.4).max() < 0.04
    assert np.abs(np.abs(corners[:, 1]) - 0.25).max() < 0.04
    assert np.abs(corners[:, 2]).max() < 0.002
    sides = np.linalg.norm(np.roll(found.corners, -1, axis=0) - found.corners, axis=1)
    assert sides == pytest.approx([0.8, 0.5, 0.8, 0.5])
