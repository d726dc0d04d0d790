"""Study 01: fits of known truth, arithmetic on Table 2, checks that can fail, the bench."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench
from mmqa_lab.published import ledger
from mmqa_lab.studies import chart_tables as study

PUBLISHED = study.table_2()


def test_printed_d1_of_a_ask_for_seven_thousand_pulses_a_revolution():
    """Table 2: along a line d1 is range x 2 pi / pulses."""
    rows = PUBLISHED.query("system == 'A'")
    turn = 2 * np.pi * 1000 * rows["distance_m"]
    ends = (turn / (rows["d1_mm"] + 0.5)).max(), (turn / (rows["d1_mm"] - 0.5)).min()
    assert np.round(ends).tolist() == [6981, 7392]


def test_at_10_m_c_has_two_points_for_each_pixel_of_its_panorama():
    """Table 1: 8.2 mm x 7.9 mm; Table 2: 30,915 per square metre."""
    pixels = 1e6 / (8.2 * 7.9)
    density = PUBLISHED.query("system == 'C' and distance_m == 10")["density_per_m2"].item()
    assert density / pixels == pytest.approx(2.0, abs=0.05)


def test_fit_finds_the_parameters_that_made_a_table():
    truth = {"tilt_deg": 50.0, "height_m": 0.4, "mirror_frequency_hz": 150.0}
    distances = np.array([5.0, 10.0])
    figures = study.closed_form(list(truth), np.array([[*truth.values()]]), distances)
    target = pd.DataFrame(figures[0], columns=study.FITTED).assign(distance_m=distances)
    bounds = study.FITS[1][2]
    best, misfit = study.search(study.closed_form, bounds, target, seed=1, candidates=1000)
    assert misfit < 0.2
    assert best["mirror_frequency_hz"] == pytest.approx(150, rel=0.02)
    assert best["tilt_deg"] == pytest.approx(50, abs=2)


def test_misfit_is_in_tolerances():
    target = PUBLISHED.query("system == 'C'")
    exact = target[study.FITTED].to_numpy()
    assert study.misfit(exact[None], target).item() == 0
    off = exact + np.hypot([0.5, 0.5, 0.5, 0.05], 0.02 * exact)
    assert study.misfit(off[None], target).item() == pytest.approx(1)


def test_noise_of_c_gives_both_published_precisions():
    target = PUBLISHED.query("system == 'C'")
    noise = study.fitted_noise("C", {}, target, seed=1)
    camera = study.SENSORS["C"]
    for distance, expected in ((5, 14), (10, 23)):
        stereo = distance**2 / (camera.base_m * camera.focal_px) * noise["noise_px"]
        assert 1000 * np.hypot(stereo, noise["floor_m"]) == pytest.approx(expected)


def test_hull_loses_a_line_spacing_where_lines_run_along_the_crop():
    cells = bench.cell_table(
        bench.run(
            [{"system": "A upright", "distance_m": 5.0}],
            {name: study.READINGS[name] for name in ("Appendix A", "section 3.3")},
            make=study.chart_with_truth,
            seeds=range(8),
        )
    )
    hull, polygon = cells.groupby("method")["density_per_m2"].mean()[["Appendix A", "section 3.3"]]
    # lines 1000 v / 200 = 55.6 mm apart: of a crop of 812 mm one spacing is lost on average
    assert 100 * (hull / polygon - 1) == pytest.approx(100 * 55.6 / (812 - 55.6), abs=3)


@pytest.fixture(scope="module")
def readings():
    """The bench with one pass of a case each, and a method of one's own."""
    comparison = study.comparison(quick=True)
    comparison.cases = bench.grid(system=("A", "A upright", "B", "C"), distance_m=5.0)
    comparison.seeds = [0]
    comparison.methods["mine"] = lambda cloud: {"precision_mm": 0.5}
    return comparison.run()


def test_a_method_of_ones_own_enters_the_table_and_the_figure(readings):
    table = study.readings_table(readings).set_index(["method", "system"])
    assert (table.loc["Appendix A"] == 0).all(axis=None)
    assert (table.loc["mine", "sigma_mad_percent"] < 0).all()
    assert table.loc["mine", "f_percent"].isna().all()
    assert len(study.plot_readings(readings).axes) == len(study.FIGURES)


def test_truth_is_what_was_drawn(readings):
    exact = readings.sel({"method": "section 3.3"})
    assert exact["density_per_m2"].sel(system="C").item() == pytest.approx(
        exact["truth_density_per_m2"].sel(system="C").item(), rel=0.02
    )
    std = readings.sel({"method": "std"})["precision_mm"]
    assert std.sel(system="A").item() == pytest.approx(
        exact["truth_precision_mm"].sel(system="A").item(), rel=0.1
    )


@pytest.fixture(scope="module")
def comparison():
    """Table 2 with made-up predictions and fits."""
    rows = PUBLISHED.drop(columns="density_per_m2_printed")
    usual = rows[rows["system"] != "C"].copy()
    usual["density_per_m2"] *= 1.5
    usual["tilt_deg"] = usual["system"].map(lambda name: study.USUAL[name]["tilt_deg"])
    usual["height_m"] = usual["system"].map(lambda name: study.USUAL[name]["height_m"])
    low = usual.assign(density_per_m2=usual["density_per_m2"] / 2, height_m=9)
    passes = [rows.assign(fit="open", f=rows["f"] + 0.1 * k, seed=k) for k in (-1, 1)]
    passes += [each.query("system == 'A'").assign(fit="released", d1_mm=5.0) for each in passes]
    return study.compare(pd.concat([usual, low]), pd.concat(passes))


def test_comparison_keeps_kinds_apart_and_gaps_open(comparison):
    assert len(comparison) == 30
    assert comparison["published"].notna().all()
    assert not any("reproduced" in column for column in comparison)
    gaps = comparison["system"] == "C"
    assert (comparison["predicted"].isna() == gaps).all()
    rows = comparison.set_index(["system", "distance_m", "figure"])
    f = rows.loc["A", 10, "f"]
    # t of one degree of freedom is 12.706; one further pass beside the mean of two
    reach = 12.706 * 0.1 * 2**0.5 * 1.5**0.5
    assert f["fitted"] == pytest.approx(5.1)
    assert f["fitted_high"] - f["fitted"] == pytest.approx(reach, rel=1e-4)
    density = rows.loc["B", 5, "density_per_m2"]
    assert (density["predicted"], density["predicted_low"]) == (3140 * 1.5, 3140 * 0.75)
    d1 = rows.loc["A", 5, "d1_mm"]
    assert (d1["fitted"], d1["fitted_stated"]) == (5, 4)


def test_every_printed_cell_of_table_2_and_both_scenarios_have_an_entry(comparison):
    chosen = pd.DataFrame(
        {"set": ["test", "scenario 1", "scenario 2"], "fewest": 0, "likely": [0, 0, 2], "most": 2}
    )
    entries = pd.DataFrame(study.ledger_entries(comparison, chosen))
    cells = ledger.cells().query("source == 'pfeifer2021'")
    printed = set(cells.query("table == 'table_2'")["cell"])
    printed |= {"scenario_1_systems", "scenario_2_systems"}
    assert set(entries["cell"]) == printed
    assert (entries["note"] != "").all()


@pytest.fixture(scope="module")
def whole(comparison):
    """Tables for which every check passes."""
    fits = [
        ("A", "open", "tilt_deg", 45.0, 6.0),
        ("A", "released", "tilt_deg", 54.0, 0.6),
        ("A", "released", "mirror_frequency_hz", 1e6 / 7000, 0.6),
        ("B", "open", "tilt_deg", 38.0, 2.0),
    ]
    parameters = pd.DataFrame(fits, columns=["system", "fit", "parameter", "fitted", "misfit"])
    models = {"one pair": 20.0, "pairs fused": 3.0, "resampled on the surface": 1.2}
    models = pd.DataFrame({"model": models.keys(), "misfit": models.values()})
    systems = ["A", "A upright", "B", "C"]
    readings = pd.DataFrame({"system": systems, "density_percent": [-1.5, -5.4, -15.0, -0.2]})
    patch = pd.DataFrame({"cloud": ["head A", "head B", "both heads"], "f": [3.0, 2.9, 2.2]})
    return comparison, parameters, 3390.0, models, readings.assign(method="section 3.3"), patch


def checks(parts):
    """All checks of the study."""
    return [*study.checks(*parts[:4]), *study.reading_checks(*parts[4:])]


def test_checks_pass_on_these_tables(whole):
    assert [check.statement for check in checks(whole) if not check.passed] == []


@pytest.mark.parametrize(
    ("number", "position", "change"),
    [
        (0, 2, lambda capped: 4629.0),
        (1, 1, lambda table: table.assign(misfit=1.0)),
        (2, 0, lambda table: table.assign(predicted=table["published"])),
        (3, 3, lambda table: table.assign(misfit=[20.0, 1.0, 1.2])),
        (4, 4, lambda table: table.assign(density_percent=-3.5)),
        (5, 5, lambda table: table.assign(f=[3.0, 2.9, 2.95])),
    ],
)
def test_each_check_can_fail(whole, number, position, change):
    parts = [change(part) if k == position else part for k, part in enumerate(whole)]
    failed = [k for k, check in enumerate(checks(parts)) if not check.passed]
    assert failed == [number]
