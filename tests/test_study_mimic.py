"""The study of MIMIC: its bench, its readings of Table 4, its checks and its ledger."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench, plots
from mmqa_lab.published import table
from mmqa_lab.scan_pattern import Target, explain_error, mimic, scan_lattice
from mmqa_lab.studies import mimic as study

DUAL = {"gamma_scan": -45, "through_m": (4, 4, -3.2)}
SINGLE = {"gamma_scan": 0, "through_m": (4.12, 0.89, -2.76), "height_m": 1.82}


@pytest.fixture(scope="module")
def results():
    """Two walls, seen at 8 m, measured by every method."""
    cases = study.cad_walls((8.0,)).iloc[[0, 7]]
    return bench.run(cases, study.METHODS, make=study.make, score=study.score, seeds=(0, 1))


@pytest.fixture(scope="module")
def field():
    """Three surfaces within the printed limits."""
    names = (study.EQUATIONS[1], "measured", "clicked")
    methods = {name: study.METHODS[name] for name in names}
    return bench.run(study.surfaces(3), methods, make=study.make, score=study.score, seeds=(0, 1))


@pytest.fixture(scope="module")
def given(results, field):
    """What the notebook hands to checks and ledger, small."""
    table_3 = table("cahalane2014", "table_3").rename(columns={"mimic_m": "published_m"})
    table_3["predicted_m"] = mimic.profile_spacing_horizontal(0.1, 45, table_3["alpha_targ_deg"])
    walls = [
        Target(heading_deg=row.alpha_targ_deg, tilt_deg=row.beta_targ_deg, range_m=8)
        for row in table_3.itertuples()
    ]
    rays = [study.cast(study.SETUP, wall)["horizontal_mm"] / 1000 for wall in walls]
    table_3["ray_cast_m"] = rays
    table_3["agrees"] = table_3["predicted_m"].round(3) == table_3["published_m"]
    still = []
    for case in study.cad_walls((4.0,)).to_dict("records"):
        scan = study.Scan(*study.parts(case), None, None)
        paper, cast = (
            study.paper(scan, ways=(True,)),
            study.cast(scan.setup, scan.target, still=True),
        )
        still.append({name: paper[name] - cast[name] for name in study.FIGURES})
    counted = pd.DataFrame({"counted": [1000, 500], "predicted": [1001.0, 499.0]})
    readings = [study.table_4(**DUAL), study.table_4(**SINGLE)]
    return {"table_3": table_3, "results": results, "still": pd.DataFrame(still),
            "readings": readings, "field": field, "counted": counted}  # fmt: skip


def test_walls_of_the_bench_are_the_fourteen_of_the_tables():
    walls = study.cad_walls((4.0, 8.0))
    assert len(walls) == 28
    assert walls.query("table == 'table_4' and no == 9")[["alpha", "beta"]].iloc[0].tolist() == [
        *(-30, -30)
    ]


def test_surfaces_keep_the_printed_limits():
    cases = study.surfaces(16)
    assert cases["range_m"].between(5, 16).all()
    assert cases["alpha"].between(-60, 60).all()
    assert cases["beta"].between(0, 45).all()
    for case in cases.to_dict("records"):
        setup, target = study.parts(case)
        density = scan_lattice(setup, target.patch(setup)).density_per_m2
        assert 299 < density < 1501


def test_equations_and_lattice_are_what_rays_say(results):
    lattice = np.abs(results[list(study.FIGURES)].sel({"method": "scan lattice"}))
    assert float(lattice.to_array().max()) < 1e-6
    paper = np.abs(results["angle_deg"].sel({"method": study.EQUATIONS[1]}))
    turned = np.degrees(0.1 / (2 * np.pi * 8))
    assert 0.2 * turned < float(paper.max()) < 1.5 * turned  # the motion that the paper leaves out
    printed = np.abs(results["point_mm"].sel({"method": study.EQUATIONS[0]}))
    assert float(printed.max()) > 1
    measured = np.abs(results["horizontal_mm"].sel({"method": "measured"}))
    assert float(measured.max()) < 0.2


def test_each_row_of_table_4_comes_out_in_one_of_two_readings():
    dual, single = study.table_4(**DUAL), study.table_4(**SINGLE)
    assert dual.loc[~dual["agrees"], "no"].tolist() == [4, 6, 9]
    assert single.loc[~single["agrees"], "no"].tolist() == [1, 5, 7]
    assert single["fitted_mm"].round(1).tolist() == [
        *(11.6, 19.7, 16.4, 10.4, 31.8, 21.4, 25.9, 5.8, 5.8)
    ]


def test_a_plane_4_m_away_cannot_be_struck_more_closely_than_the_bound():
    rng = np.random.default_rng(1)
    normal = np.array([np.cos(np.radians(30)), 0, np.sin(np.radians(30))])
    aim = rng.standard_normal((200_000, 3))
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    side = np.cross(aim, rng.standard_normal((200_000, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    step = np.radians(0.12)
    ahead = aim @ normal > 0.05
    ends = []
    for direction in (aim[ahead], (np.cos(step) * aim + np.sin(step) * side)[ahead]):
        ends.append(direction * (4 * normal[0] / (direction @ normal))[:, None])
    smallest = 1000 * np.linalg.norm(ends[1] - ends[0], axis=1).min()
    bound = 8000 * np.tan(step / 2) * np.cos(np.radians(30))
    assert bound == pytest.approx(7.255, abs=1e-3)
    assert bound - 1e-9 < smallest < 1.01 * bound


def test_simulated_patches_are_square_and_lie_where_they_should():
    case = study.cad_walls((8.0,)).iloc[2].to_dict()
    setup, target = study.parts(case)
    cloud, truth = study.simulate_patch(setup, target, size=1.0, seed=3, range_noise_m=0.0)
    uv = (cloud.points - truth.beam) @ truth.axes.T
    assert np.abs(uv).max() < 0.5 + 0.003  # angle noise shifts points by a millimetre or two
    assert np.abs(uv).max() > 0.48
    assert len(cloud) == pytest.approx(0.95 * truth.density_per_m2, rel=0.06)  # 5 % of drop-outs


def test_an_own_equation_enters_tables_and_figures():
    comparison = study.comparison(quick=True)
    comparison.cases = comparison.cases.iloc[:2]
    comparison.methods = {"scan lattice": study.lattice, "mine": lambda scan: {"point_mm": 5.0}}
    results = comparison.run()
    found = comparison.tables(results)["errors"].set_index("method")
    assert found.loc["mine", "point_mm"] > 1
    assert np.isnan(found.loc["mine", "angle_deg"])
    figure = comparison.figures(results)["errors"]
    assert "mine" in [text.get_text() for text in figure.legends[0].get_texts()]
    plots.plt.close(figure)


def test_checks_pass_and_each_fails_where_its_numbers_do(given):
    names = ("table_3", "still", "readings", "counted")
    right = {name: given[name] for name in names}
    right["benches"] = walls, field = given["results"], given["field"]
    assert [check for check in study.checks(**right) if not check.passed] == []
    off, sure = walls.copy(deep=True), [bench.copy(deep=True) for bench in (walls, field)]
    off["point_mm"].loc[{"method": "scan lattice"}] = 0.01
    for part in sure:
        part["std_point_mm"].loc[{"method": "measured"}] /= 10
    readings, wrong = given["readings"], [True, True, False, True, True]
    changes = [
        {"table_3": given["table_3"].assign(agrees=wrong)},
        {"still": given["still"] + 1e-3},
        {"benches": (off, field)},
        {"readings": [readings[0], readings[0]]},
        {"counted": given["counted"].assign(counted=900)},
        {"benches": sure},
    ]
    for place, change in enumerate(changes):
        assert not list(study.checks(**right | change))[place].passed, change


def test_ledger_says_something_of_every_table(given):
    table_6 = table("cahalane2014", "table_6").query("quantity != 'error'")
    table_6 = table_6.rename(columns={"quantity": "name", "value": "change_fitted"})
    parts = {name: given[name] for name in ("table_3", "still", "readings", "field")}
    entries = study.ledger_entries(**parts, table_6=table_6.assign(error_fitted=0.0017))
    rows = pd.DataFrame(entries)
    assert set(rows["table"]) == {"table_2", "table_3", "table_4", "table_5", "table_6", "numbers"}
    assert rows.query("table == 'table_3'").shape[0] == 15
    assert len(rows.query("table == 'table_6'")) == 11
    assert (rows["kind"] != "").all()
    assert rows["value"].notna().all()


def test_table_6_row_is_solved_by_the_set_up_that_the_notebook_names():
    setup = replace(study.SETUP, mirror_frequency_hz=150, speed_m_s=7.7, scanner_heading_deg=11.45)
    wall = Target(heading_deg=50.45, range_m=8)
    now = float(scan_lattice(setup, wall.patch(setup)).profile_spacing_horizontal_m)
    quantity = "profile_spacing_horizontal_m"
    found = explain_error(setup, wall, quantity=quantity, measured=now - 0.00168)
    change = found.set_index("input")["change"].abs()
    assert change["scanner_heading_deg"] == pytest.approx(1.50, abs=0.01)
    assert change["target_heading_deg"] == pytest.approx(1.93, abs=0.01)
    assert change["mirror_frequency_hz"] == pytest.approx(4.00, abs=0.02)
    assert change["speed_m_s"] == pytest.approx(0.200, abs=0.002)
    assert change[["scanner_tilt_deg", "target_tilt_deg"]].isna().all()  # n/a in print


def test_no_set_up_gives_gamma_scan_of_row_d_prsv_in_table_6():
    share = 1.5 / 98.5  # of the spacing, by 1.5 Hz at 100 Hz or more
    tilt, change = np.meshgrid(np.radians(np.arange(1, 89, 0.25)), np.radians([-0.45, 0.45]))
    made = np.abs(np.tan(tilt) / np.tan(tilt + change) - 1)
    assert made.min() > share
