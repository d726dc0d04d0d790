"""The study of MIMIC: its bench, its readings of Table 4, its checks and its ledger."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.published import table
from mmqa_lab.scan_pattern import Target, explain_error, mimic, scan_lattice
from mmqa_lab.studies import mimic as study


@pytest.fixture(scope="module")
def results():
    """Two walls, seen at 8 m, measured by every method."""
    return study.bench(cases=study.cad_walls((8.0,)).iloc[[0, 7]], seeds=(0, 1)).run()


@pytest.fixture(scope="module")
def field():
    """Three surfaces within the printed limits."""
    names = (study.EQUATIONS[1], "measured", "clicked")
    methods = {name: study.METHODS[name] for name in names}
    return study.bench(methods=methods, cases=study.surfaces(3), seeds=(0, 1)).run()


def test_surfaces_keep_the_printed_limits():
    cases = study.surfaces(16)
    assert cases["range_m"].between(5, 16).all()
    assert cases["heading_deg"].between(-60, 60).all()
    assert cases["tilt_deg"].between(0, 45).all()
    for case in cases.to_dict("records"):
        assert 299 < scan_lattice(*study.parts(case)).density_per_m2 < 1501


def test_equations_and_lattice_are_what_rays_say(results):
    errors = [f"{kind}_error_{unit}" for kind, unit in (name.split("_") for name in study.FIGURES)]
    assert float(results[errors].sel({"method": "scan lattice"}).to_array().max()) < 1e-6
    paper = results["angle_error_deg"].sel({"method": study.EQUATIONS[1]})
    turned = np.degrees(0.1 / (2 * np.pi * 8))
    assert 0.2 * turned < float(paper.max()) < 1.5 * turned  # the motion that the paper leaves out
    assert float(results["point_error_mm"].sel({"method": study.EQUATIONS[0]}).max()) > 1
    assert float(results["horizontal_error_mm"].sel({"method": "measured"}).max()) < 0.2


def test_papers_equations_are_rays_from_a_vehicle_that_stands():
    for case in study.cad_walls((4.0,)).to_dict("records"):
        scan = study.Scan(*study.parts(case), None, None)
        rays = study.cast(scan.setup, scan.target, still=True)
        assert study.paper(scan, ways=(True,)) == pytest.approx(rays, abs=1e-6)


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
    setup, target = study.parts(study.cad_walls((8.0,)).iloc[2].to_dict())
    cloud, driven = study.simulate_patch(setup, target, size_m=1.0, seed=3, range_noise_m=0.0)
    truth = scan_lattice(driven, target)
    uv = (cloud.points - truth.beam) @ truth.axes.T
    assert np.abs(uv).max() < 0.5 + 0.003  # angle noise shifts points by a millimetre or two
    assert np.abs(uv).max() > 0.48
    assert len(cloud) == pytest.approx(0.95 * truth.density_per_m2, rel=0.06)  # 5 % of drop-outs


def test_checks_of_the_notebook_fail_with_other_numbers():
    """Each check, with numbers that would make its statement false and with the true ones."""
    false = {"table_3": pd.DataFrame({"agrees": [True, False]}), "worst": 1e-3, "moving": 1e-3}
    false |= {"most": 7, "together": 9, "off": 0.1, "counted": 9, "expected": 10.0}
    false |= {"shares": pd.Series([0.95, 0.7]), "slack": 0.06, "scans": 290}
    false |= {"printed_cells": []}
    assert len(spoiled("mimic", false)) == 6
    true = false | {"table_3": pd.DataFrame({"agrees": [True]}), "worst": 1e-9, "moving": 1e-9}
    true |= {"most": 6, "off": 0.001, "shares": pd.Series([0.95, 0.93])}
    assert not spoiled("mimic", true)
    assert len(spoiled("mimic", true | {"agrees": False})) == 1
    assert len(spoiled("mimic", true | {"together": 8})) == 1


def test_ledger_says_something_of_every_table(field):
    walls = table("cahalane2014", "table_3")
    walls["predicted_m"] = mimic.profile_spacing_horizontal(0.1, 45, walls["alpha_targ_deg"])
    reading = pd.DataFrame({"no": range(1, 10), "fitted_mm": 6.0})
    table_6 = table("cahalane2014", "table_6").query("quantity != 'error'")
    table_6 = table_6.rename(columns={"quantity": "name", "value": "change_fitted"})
    rows = study.ledger_table(
        table_3=walls.assign(ray_cast_m=walls["predicted_m"]),
        standing=pd.DataFrame({name: np.zeros(14) for name in study.FIGURES}),
        readings={"one": reading, "two": reading.head(8)},
        field=field,
        table_6=table_6.assign(error_fitted=0.0017, note="solved"),
    )
    assert rows.groupby("table").size().to_dict() == {
        "table_2": 2, "table_3": 15, "table_4": 43, "table_5": 18, "table_6": 11, "numbers": 12,
    }  # fmt: skip
    assert rows["value"].notna().all()


def test_table_6_row_is_solved_by_the_set_up_that_the_notebook_names():
    setup = replace(study.SETUP, mirror_frequency_hz=150, speed_m_s=7.7, scanner_heading_deg=11.45)
    wall = Target(heading_deg=50.45, range_m=8)
    now = float(scan_lattice(setup, wall).profile_spacing_horizontal_m)
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
