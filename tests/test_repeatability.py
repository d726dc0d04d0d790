"""Operators, repeatability and variance components against publications, models and simulation."""

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.repeatability import (
    evaluate_selections,
    operator_polygons,
    repeatability,
    strip_law,
    variance_components,
)

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])

SHROUT_FLEISS = [
    *([9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8]),
    *([7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]),
]
"""Four ratings of six targets: Shrout and Fleiss 1979, doi:10.1037/0033-2909.86.2.420, Table 2."""


def rated():
    """The published ratings as a table, a row per rating."""
    rows = [(target, value) for target, row in enumerate(SHROUT_FLEISS) for value in row]
    return pd.DataFrame(rows, columns=["scan", "f"])


def nested(rng, *, counts=(4, 3, 5, 6), spreads=(0.5, 0.2, 0.1, 0.05)):
    """A balanced nested design with known relative standard deviations."""
    rows = []
    for a, system in enumerate(spreads[0] * rng.standard_normal(counts[0])):
        for b, distance in enumerate(spreads[1] * rng.standard_normal(counts[1])):
            for c, scan in enumerate(spreads[2] * rng.standard_normal(counts[2])):
                errors = spreads[3] * rng.standard_normal(counts[3])
                rows += [(a, b, c, np.exp(system + distance + scan + e)) for e in errors]
    return pd.DataFrame(rows, columns=["system", "distance_m", "scan", "value"])


def test_intraclass_correlation_as_published():
    """ICC(1,1) = 0.17 (Shrout and Fleiss 1979, Table 4); mean squares 11.24 and 6.26 (Table 3)."""
    found = repeatability(rated(), "f")
    assert found.icc == pytest.approx(0.17, abs=0.005)
    assert found.s_r**2 == pytest.approx(6.26, abs=0.005)
    assert 4 * found.s_l**2 + found.s_r**2 == pytest.approx(11.24, abs=0.005)


def test_limit_of_repeatability():
    found = repeatability(rated(), "f")
    assert found.r == pytest.approx(2.8 * np.sqrt(6.26), rel=1e-3)
    assert (found.groups, found.n) == (6, 24)


def test_bootstrap_covers_the_spread_that_was_put_in():
    """95 % intervals of s_r hold the truth in 95 % of 100 trials, or 87 % with four errors."""
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(100):
        values = 10 + 0.3 * rng.standard_normal(60)
        table = pd.DataFrame({"scan": np.repeat([0, 1, 2], 20), "f": values})
        found = repeatability(table, "f")
        hits += found.s_r_low < 0.3 < found.s_r_high
    assert hits >= 87


def test_one_scan_has_no_part_between_scans():
    found = repeatability(rated().query("scan == 0"), "f")
    assert np.isfinite(found.s_r)
    assert np.isnan([found.s_l, found.icc]).all()


def test_components_equal_restricted_maximum_likelihood(rng):
    """On balanced data with positive components both are the same estimates."""
    from statsmodels.regression.mixed_linear_model import MixedLM

    table = nested(rng)
    found = variance_components(table, "value", factors=["system", "distance_m", "scan"])
    data = table.assign(y=np.log(table["value"]), one=1.0)
    cells = table.groupby(["system", "distance_m", "scan"]).ngroup()
    parts = {"distance": "0 + C(distance_m)", "scan": "0 + C(cell)"}
    model = MixedLM.from_formula(
        "y ~ 1", data.assign(cell=cells), groups="system", re_formula="1", vc_formula=parts
    )
    fit = model.fit(reml=True)
    likely = [fit.cov_re.iloc[0, 0], *fit.vcomp, fit.scale]
    # the maximum is found to about a thousandth
    assert found["variance"].to_numpy() == pytest.approx(np.array(likely), rel=0.01)


def test_components_find_what_was_put_in():
    """Means of 16 designs; their own spread says how well."""
    rng = np.random.default_rng(3)
    factors = ["system", "distance_m", "scan"]
    designs = [nested(rng, counts=(3, 2, 3, 4)) for _ in range(16)]
    drawn = [variance_components(design, "value", factors=factors) for design in designs]
    variances = np.array([found["variance"] for found in drawn])
    error = variances.std(axis=0, ddof=1) / np.sqrt(16)
    assert (np.abs(variances.mean(axis=0) - [0.25, 0.04, 0.01, 0.0025]) < 4 * error).all()


def test_strip_between_outlines_has_the_area_of_the_law():
    polygons = operator_polygons(SQUARE, repeats=400, click=0.01, seed=2)[:, :, [0, 2]]
    shapes = shapely.polygons(polygons)
    apart = shapely.area(shapely.symmetric_difference(shapes[:200], shapes[200:]))
    error = apart.std(ddof=1) / np.sqrt(200)
    # half of 0.9158 P click is the law's constant; corners add a few percent of the click error
    assert apart.mean() / 2 == pytest.approx(0.4579 * 4 * 0.01, abs=3 * error / 2 + 0.0002)


def test_law_predicts_the_spread_of_counted_points():
    rng = np.random.default_rng(6)
    ratios = []
    for cloud in range(20):
        points = np.zeros((rng.poisson(3000 * 1.44), 3))
        points[:, [0, 2]] = rng.uniform(-0.1, 1.1, (len(points), 2))
        polygons = operator_polygons(SQUARE, repeats=40, click=0.015, seed=cloud)[:, :, [0, 2]]
        shapes = shapely.polygons(polygons)
        counts = [shapely.contains_xy(s, points[:, 0], points[:, 2]).sum() for s in shapes]
        density = np.array(counts) / shapely.area(shapes)
        ratios.append(density.var(ddof=1) / density.mean() ** 2)
    predicted = strip_law(density=3000, area=1, click=0.015) ** 2
    error = np.std(ratios, ddof=1) / np.sqrt(len(ratios))
    assert abs(np.mean(ratios) - predicted) < 3 * error


@settings(max_examples=25, deadline=None)
@given(
    click=st.floats(0, 0.03),
    vertices=st.sampled_from([4, 8, 16]),
    heading=st.floats(0, 360),
    seed=st.integers(0, 2**32),
)
def test_polygons_stay_in_the_plane_about_the_outline(click, vertices, heading, seed):
    turn = np.radians(heading)
    corners = SQUARE @ [[np.cos(turn), np.sin(turn), 0], [0, 1, 0], [0, 0, 1]] + [5e5, 5e6, 100]
    polygons = operator_polygons(corners, repeats=3, click=click, seed=seed, vertices=vertices)
    assert polygons.shape == (3, vertices, 3)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    # UTM coordinates keep a nanometre
    assert np.abs((polygons - corners[0]) @ normal).max() < 1e-8
    assert np.abs(polygons[:, :: vertices // 4] - corners).max() < 8 * click + 1e-8


def test_click_error_is_the_standard_deviation_of_each_vertex():
    polygons = operator_polygons(SQUARE, repeats=2000, click=0.02, seed=1)
    spread = (polygons - SQUARE)[:, :, [0, 2]].std(axis=0)
    assert spread == pytest.approx(np.full((4, 2), 0.02), rel=4 / np.sqrt(2 * 2000))


def test_each_selection_is_evaluated_as_study_01_does(rng):
    points = rng.random((2000, 3)) * [1, 0.01, 1]
    corners = [0.2, 0, 0.2] + 0.6 * SQUARE
    polygons = operator_polygons(corners, repeats=3, click=0.01, seed=4)
    table = evaluate_selections(points, polygons)
    single = evaluate_cloud(points, polygon=polygons[1]).to_frame().iloc[0]
    assert table.loc[1, "selection"] == 1
    pd.testing.assert_series_equal(table.loc[1].drop("selection"), single, check_names=False)
    moved = evaluate_selections(points + [1e7, -1e7, 0], polygons + [1e7, -1e7, 0])
    figures = ["n", "density_polygon_per_m2", "sigma_mad_mm", "d1_mm", "d4_mm"]
    # a metre coordinate at 10,000 km keeps two nanometres
    assert moved[figures].to_numpy() == pytest.approx(table[figures].to_numpy(), rel=1e-4)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda t: repeatability(t, "g"), r"Invalid table: no column 'g' beside scan, f\."),
        (lambda t: variance_components(t, "g", factors=["scan"]), "no column 'g'"),
        (lambda t: variance_components(t, "f", factors=["head"]), "no column 'head'"),
        (
            lambda t: operator_polygons(
                np.eye(5, 3) + np.eye(5, 3, -2), repeats=1, click=0.1, seed=1
            ),
            r"Invalid corners: 5 given\. Must be four",
        ),
    ],
)
def test_what_a_table_or_outline_lacks_is_named(call, said):
    with pytest.raises(ValueError, match=said):
        call(pd.DataFrame({"scan": [1, 1, 2, 2], "f": [2.0, 2.1, 4.0, 4.2]}))


def test_a_share_of_a_mean_of_zero_is_not_measurable():
    found = repeatability(pd.DataFrame({"bias": [-1.0, 1.0]}), "bias").to_frame()
    assert np.isnan(found["relative_s_r_percent"].item())
    assert found["s_r"].item() == pytest.approx(2**0.5)


def test_rows_that_do_not_name_their_scan_are_refused_and_means_may_be_negative():
    table = pd.DataFrame({"scan": [1, 1, np.nan, 2, 2], "f": [2.0, 2.2, 3.0, 3.1, 3.3]})
    with pytest.raises(ValueError, match="Invalid scan in row 2: none"):
        repeatability(table, "f")
    with pytest.raises(ValueError, match="Invalid scan in row 2: none"):
        variance_components(table, "f", factors=["scan"])
    below = repeatability(table.dropna().assign(f=lambda one: -one["f"]), "f").to_frame().iloc[0]
    assert 0 < below["low_percent"] < below["relative_s_r_percent"] < below["high_percent"]


def test_unequal_groups_and_their_intervals_by_hand():
    """Mean squares 48 and 5.5, 8 / 3 selections a scan; Bonett's interval by the kurtosis."""
    values = pd.DataFrame({"scan": [1] * 2 + [2] * 4, "f": [0.0, 2, 4, 6, 8, 10]})
    found = repeatability(values, "f")
    assert found.s_l**2 == pytest.approx((48 - 5.5) / (8 / 3))
    assert found.icc == pytest.approx(15.9375 / 21.4375)
    off = np.concatenate([np.random.default_rng(k).standard_t(3, 20) for k in range(2)])
    table = pd.DataFrame({"scan": np.repeat([1, 2], 20), "f": off})
    off -= np.repeat(off.reshape(2, 20).mean(axis=1), 20)
    freedom = 2 / (2 / 38 + stats.kurtosis(off) / 40)
    assert stats.kurtosis(off) > 1
    found = repeatability(table, "f")
    ends = found.s_r * np.sqrt(freedom / stats.chi2.ppf([0.975, 0.025], freedom))
    assert [found.s_r_low, found.s_r_high] == pytest.approx(ends)
