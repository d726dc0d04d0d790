"""The study of MIMIC: its tables, maps, budgets and drawings."""

import numpy as np
import pytest

from mmqa_lab import plots
from mmqa_lab.scan_pattern import ScanSetup, Target
from mmqa_lab.studies import mimic
from mmqa_lab.studies.mimic import drawings, measuring, surfaces, validation

PIVOTS_M = (-0.2, -0.1, 0.0, 1.5)


@pytest.fixture
def ax():
    """Axes of a figure that is closed again."""
    figure, axes = plots.subplots()
    yield axes
    plots.plt.close(figure)


def test_table_3_is_cast_as_it_is_predicted():
    table = validation.table_3(range_m=4.0)
    assert table["agrees"].all()
    assert table["difference_m"].abs().max() < 1e-9
    assert table["predicted_m"].round(6).tolist() == [0.08165, 0.1, 0.08165, 0.141421, 0.1]
    assert table["perpendicular_m"].round(6).tolist() == [
        *(0.053452, 0.067027, 0.058727, 0.063246, 0.052413)
    ]


def test_table_4_has_no_reading_that_gives_more_than_six_rows():
    readings = validation.table_4_readings(pivots_m=PIVOTS_M)
    assert readings["rows_that_agree"].max() == 6
    best = validation.best_reading(readings)
    assert best.loc[~best["agrees"], "row"].tolist() == [4, 6, 9]
    assert best.loc[~best["possible"], "row"].tolist() == [8, 9]
    assert "fitted_mm" in best
    assert "reproduced" not in " ".join(best.columns)


def test_table_6_has_the_sensitivities_of_the_declared_set_up():
    table = validation.table_6(range_m=8.0).set_index(["quantity", "input"])
    level = table.loc["profile_spacing_horizontal_m"]
    parallel = level["predicted, wall parallel"]
    assert parallel["speed_m_s"] == pytest.approx(0.2, rel=1e-6)  # 2 mm of v / Mf
    assert parallel["mirror_frequency_hz"] == pytest.approx(2.0, rel=1e-3)
    assert np.isinf(parallel["scanner_heading_deg"])  # vanishes on a parallel wall
    assert parallel["target_heading_deg"] == pytest.approx(np.degrees(0.002 / 0.1), rel=1e-3)
    assert np.isinf(level["predicted, wall 15/15"]["scanner_tilt_deg"])
    assert level["published"]["mirror_frequency_hz"] == 4.0


def test_facade_map_is_symmetrical_where_nothing_is_turned():
    plain = ScanSetup(pulse_rate_hz=3e5, mirror_frequency_hz=100, speed_m_s=10)
    found = surfaces.facade(plain, turn_deg=0, distance_m=8, length_m=6, height_m=4, step_m=1)
    density = found["density_per_m2"]
    assert density.attrs["units"] == "1/m2"
    assert np.allclose(density.std("along"), 0, atol=1e-9)  # the same all along the track
    assert float(density.sel(height=1.0)[0]) == pytest.approx(float(density.sel(height=-1.0)[0]))


def test_post_is_seen_from_its_front_alone():
    azimuths = np.arange(0.0, 360.0, 10.0)
    found = surfaces.post(
        validation.SETUP, distance_m=5, radius_m=0.15, heights_m=[0.0], azimuths_deg=azimuths
    )
    seen = found["azimuth"].values[np.isfinite(found["density_per_m2"].values[0])]
    # the horizontal pulse comes along 45 degrees: it sees azimuths about 225
    assert seen.min() > 130
    assert seen.max() < 320


def test_two_heads_add_up_and_cross_on_turned_facades_only():
    table = surfaces.two_heads(
        validation.SETUP, headings_deg=(45, -45), turns_deg=[-50, 0, 30], distance_m=8
    ).set_index("turn_deg")
    assert table.loc[-50, "density_first_per_m2"] == 0
    assert np.isnan(table.loc[-50, "crossing_deg"])
    assert table.loc[0, "crossing_deg"] < 0.2  # equal tilts: parallel but for the motion
    assert table.loc[30, "crossing_deg"] > 20
    parts = table["density_first_per_m2"] + table["density_second_per_m2"]
    assert np.allclose(parts, table["density_per_m2"])


def test_budget_adds_sources_in_squares():
    target = Target(heading_deg=15, tilt_deg=10, range_m=8)
    table = surfaces.error_budget(validation.SETUP, target, draws=500, seed=1)
    spacing = table.query("quantity == 'profile_spacing_horizontal_m'")
    first = spacing.query("method == 'first_order'").set_index("source")["std"]
    assert np.sqrt((first.drop("all") ** 2).sum()) == pytest.approx(first["all"], rel=1e-9)


def test_largest_speeds_are_missing_where_no_speed_will_do():
    table = surfaces.largest_speeds(
        validation.SETUP, limits={"f": 0.9, "density_per_m2": 500.0}, distances_m=(5, 50)
    )
    assert table.query("quantity == 'f'")["speed_m_s"].isna().all()
    speeds = table.query("quantity == 'density_per_m2'")["speed_m_s"].tolist()
    assert speeds[0] == pytest.approx(10 * speeds[1], rel=1e-6)


def test_simulated_patches_are_square_and_lie_where_they_should():
    setup, target = measuring.CASES["8 m, 45/45, 15/15"]
    cloud, truth = measuring.simulate_patch(setup, target, size=1.0, seed=3, range_noise_m=0.0)
    uv = (cloud.points - truth.beam) @ truth.axes.T
    assert np.abs(uv).max() < 0.5 + 0.003  # angle noise shifts points by a millimetre or two
    assert np.abs(uv).max() > 0.48
    expected = truth.density_per_m2
    assert len(cloud) == pytest.approx(0.95 * expected, rel=0.06)  # 5 % of drop-outs


def test_pattern_fills_the_window_with_the_predicted_density():
    given = {"speed": 10, "mirror_frequency": 100, "pulse_rate_khz": 300}
    rotations = dict.fromkeys(("scanner_heading", "scanner_tilt"), 45)
    rotations |= {"target_heading": 15, "target_tilt": 10}
    lattice, xy = surfaces.pattern(**given, **rotations, range_m=5, half_width=0.5)
    assert len(xy) == pytest.approx(lattice.density_per_m2, rel=0.03)


def test_explorer_draws_and_says_what_cannot_be(ax):
    given = {"speed": 10, "mirror_frequency": 100, "pulse_rate_khz": 300, "range_m": 5}
    given |= {"scanner_heading": 45, "scanner_tilt": 45, "target_tilt": 0}
    figure = drawings.figure_of_pattern(**given, target_heading=15)
    assert "density 1170" in figure.axes[0].texts[-1].get_text()
    blind = drawings.figure_of_pattern(**given, target_heading=-60)
    assert "strike the front" in " ".join(blind.axes[0].texts[-1].get_text().split())
    for drawn in (figure, blind):
        plots.plt.close(drawn)


def test_drawings_have_labels_with_units(ax):
    best = validation.best_reading(validation.table_4_readings(pivots_m=(-0.1,)))
    drawings.draw_table_4(best, ax=ax)
    assert ax.get_ylabel() == "point spacing (mm)"
    drawings.draw_printed_equation(validation.printed_equation_10(n=200, seed=0), ax=ax)
    assert "(%)" in ax.get_ylabel()


def test_checks_fail_where_the_numbers_do():
    table = validation.table_3(range_m=8.0)
    compared = validation.random_set_ups(n=200, seed=1)
    best = validation.best_reading(validation.table_4_readings(pivots_m=(-0.1,)))
    printed = validation.printed_equation_10(n=500, seed=1)
    right = mimic._checks_on_validation(table, compared, best, printed, 0.0796)
    assert all(check.passed for check in right)
    wrong = table.assign(agrees=[True, True, False, True, True])
    off = compared.assign(largest_difference_m=1e-6)
    broken = mimic._checks_on_validation(wrong, off, best, 0 * printed, 0.2)
    assert [check.passed for check in broken] == [False, False, False, False, True, True]
