"""Planning: sensitivities, uncertainty, the largest speed, and the command ``mmqa plan``."""

import io
import json
from contextlib import redirect_stdout
from dataclasses import replace

import numpy as np
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.commands import patterns
from mmqa_lab.scan_pattern import (
    QUANTITIES,
    ScanSetup,
    Target,
    explain_error,
    largest_speed,
    propagate,
    scan_lattice,
    sensitivities,
)
from mmqa_lab.simulate import ProfileScanner, Scene, rectangle, scan, straight
from mmqa_lab.simulate.systems import PRESETS, SYSTEMS

MIMIC = ScanSetup(
    pulse_rate_hz=300_000,
    mirror_frequency_hz=100,
    speed_m_s=10,
    scanner_heading_deg=45,
    scanner_tilt_deg=45,
)


def test_yaw_rate_changes_the_spacing_as_much_as_the_radius_turns():
    slant = 11.8
    target = Target(heading_deg=15, tilt_deg=10, range_m=slant * np.cos(np.pi / 4))
    slope = sensitivities(MIMIC, target, inputs=["heading_rate_deg_s"])
    millimetres = abs(1000 * slope["profile_spacing_horizontal_m"].item())
    # a degree a second moves a point 11.8 m off by 2.06 mm in a revolution of 0.01 s
    moved = np.radians(1.0) / 100 * slant * 1000
    assert millimetres == pytest.approx(moved / np.cos(np.radians(30)), rel=0.01)
    assert millimetres == pytest.approx(2.4, abs=0.05)


def test_first_order_and_monte_carlo_agree():
    target = Target(heading_deg=15, tilt_deg=10, range_m=11.8)
    sigmas = {
        **{"speed_m_s": 0.05, "mirror_frequency_hz": 0.1, "range_m": 0.1},
        **{"target_heading_deg": 0.5, "scanner_tilt_deg": 0.1, "boresight_heading_deg": 0.1},
        **{"pitch_deg": 0.05, "heading_rate_deg_s": 0.5, "height_difference_m": 0.1},
    }
    first = propagate(MIMIC, target, sigmas=sigmas).set_index("quantity")["std"]
    drawn = propagate(MIMIC, target, sigmas=sigmas, method="monte_carlo", draws=20_000, seed=3)
    drawn = drawn.set_index("quantity")["std"]
    smooth = list(QUANTITIES[:6])
    # a standard deviation from 20,000 draws is good to 0.5 %; 4 sigma and second order: 3 %
    assert np.allclose(first[smooth], drawn[smooth], rtol=0.03)
    assert first[["d1_mm", "f"]].isna().all()
    assert (drawn[["d1_mm", "d4_mm", "f"]] > 0).all()


@pytest.mark.parametrize(("quantity", "limit"), [("density_per_m2", 3000.0), ("f", 6.0),
    ("profile_spacing_perpendicular_m", 0.04), ("d4_mm", 60.0)])  # fmt: skip
def test_largest_speed_keeps_the_limit_and_no_larger_one_does(quantity, limit):
    setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1, scanner_tilt_deg=45)
    target = Target(range_m=5)
    speed = largest_speed(setup, target, quantity=quantity, limit=limit)
    at = replace(setup, speed_m_s=speed * np.array([1.0, 1.0001, 1.05, 1.5, 3.0]))
    values = scan_lattice(at, target.patch(at)).quantity(quantity)
    assert values[0] == pytest.approx(limit, rel=1e-6)
    assert ((values[1:] < limit) if quantity == "density_per_m2" else (values[1:] > limit)).all()


def test_largest_speed_has_the_closed_form_of_density():
    setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1, scanner_tilt_deg=45)
    speed = largest_speed(setup, Target(range_m=5), quantity="density_per_m2", limit=3000)
    assert speed == pytest.approx(1e6 / (2 * np.pi * 3000 * 5 * np.cos(np.pi / 4)), rel=1e-9)


def plan(*arguments):
    """Exit status and standard output of ``mmqa plan``."""
    out = io.StringIO()
    with redirect_stdout(out):
        status = main(["plan", *map(str, arguments)])
    return status, out.getvalue()


def test_plan_prints_the_prediction_with_its_keys():
    arguments = "--pulse-rate 300000 --mirror-frequency 100 --speed 10 --scanner-heading 45 "
    arguments += "--scanner-tilt 45 --target-heading 15 --target-tilt 0 --range 5 "
    status, out = plan(*(arguments + "--height-difference 0 --json").split())
    answer = json.loads(out)
    assert status == 0
    assert tuple(answer) == QUANTITIES
    assert answer["profile_spacing_horizontal_m"] == pytest.approx(0.081650, abs=5e-7)
    assert answer["f"] == pytest.approx(answer["d4_mm"] / answer["d1_mm"])


def test_plan_takes_presets_and_plans_speed():
    status, out = plan("--scanner", "zf-9012", "--scanner-tilt", 45, "--range", 5,
                       "--largest-speed", "density_per_m2=3000", "--json")  # fmt: skip
    answer = json.loads(out)
    assert status == 0
    assert answer["speed_m_s"] * 3.6 == pytest.approx(54, abs=0.1)
    assert answer["density_per_m2"] == pytest.approx(3000)


def test_plan_of_a_system_is_that_of_its_heads():
    status, out = plan("--system", "vmx-250", "--speed", 10, "--range", 8, "--json")
    rows = {row["quantity"]: row for row in json.loads(out)}
    assert status == 0
    for number, heading in ((1, 45), (2, -45)):
        given = ("--scanner", "vq-250", "--scanner-heading", heading, "--scanner-tilt", 45)
        alone = json.loads(plan(*given, "--speed", 10, "--range", 8, "--json")[1])
        found = {name: row[f"head_{number}"] for name, row in rows.items()}
        assert found == pytest.approx(alone)
    density = rows["density_per_m2"]
    assert density["together"] == pytest.approx(density["head_1"] + density["head_2"])


def test_plan_of_layers_is_what_a_drive_lays_on_a_wall():
    """On a wall 8 m beside the scanner, turned by 20 degrees, half a metre around its height."""
    _, out = plan(
        "--system", "sensei", "--speed", 8, "--range", 8, "--target-heading", 20, "--json"
    )
    rows = {row["quantity"]: row for row in json.loads(out)}
    head = replace(SYSTEMS["sensei"].heads[0], range_noise_m=0.0, dropout_share=0.0)
    head = replace(head, divergence_mrad=0.0, divergence_axial_mrad=0.0, lever_arm_m=(0, 0, 0))
    along = np.array([-np.sin(np.radians(20)), np.cos(np.radians(20)), 0.0])
    wall = rectangle((8, 40, 0) - 5 * along - [0, 0, 0.5], 10 * along, (0, 0, 1))
    (cloud,) = scan(Scene([wall]), head, straight(80, 8), seed=1, block_s=10)
    assert len(cloud) / 10 == pytest.approx(rows["density_per_m2"]["together"], rel=0.02)
    each = np.unique(cloud["ring"], return_counts=True)[1] / 10
    predicted = [rows["density_per_m2"][f"head_{k}"] for k in (1, 2, 3, 4)]
    assert each == pytest.approx(predicted, rel=0.02)


def test_plan_of_a_system_leaves_out_heads_that_look_away():
    drive = ("--system", "vmx-250", "--speed", 10, "--range", 8)
    _, out = plan(*drive, "--target-heading", -60, "--json")
    assert set(json.loads(out)[0]) == {"quantity", "head_2", "together"}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--system gem --speed 9 --range 5", "Invalid system 'gem'."),
        ("--system lynx --range 5", "Invalid plan without --speed. Must have it."),
        ("--system lynx --speed 9 --range 5 --sigma speed_m_s=1", "Invalid --sigma with --system."),
        ("--range 5", "Invalid plan without --pulse-rate."),
        ("--scanner vq-450 --range 5", "Invalid plan without --speed. Must have it."),
        ("--scanner vq-450 --speed 9 --range -5", "Invalid range_m -5.0. Must be > 0"),
        ("--scanner vq-450 --speed 0 --range 5", "Invalid speed_m_s 0.0. Must be > 0"),
        ("--scanner hdl-32e --speed 9 --range 5", "Invalid scanner 'hdl-32e'."),
        ("--scanner vq-450 --speed 9 --range 5 --target-heading -60", "strike the front"),
        ("--scanner zf-9012 --speed 9 --range 5 --scanner-heading 90", "the direction of travel"),
        ("--scanner zf-9012 --speed 9 --range 5 --target-tilt 89.99999 --height-difference 90",
         "less obliquely"),
    ],
)  # fmt: skip
def test_plan_rejects_in_one_sentence(arguments, sentence, capsys):
    assert main(["plan", *arguments.split()]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert len(error.strip().splitlines()) == 1


def test_plan_prints_uncertainty_and_sensitivities():
    arguments = "--scanner vq-250 --speed 10 --range 8 --sigma speed_m_s=0.2 --sensitivities --json"
    status, out = plan(*arguments.split())
    rows = {row["quantity"]: row for row in json.loads(out)}
    level = rows["profile_spacing_horizontal_m"]
    assert status == 0
    assert level["std"] == pytest.approx(0.002, rel=1e-3)  # v / Mf of 0.2 m/s and 100 Hz
    assert level["per_speed_m_s"] == pytest.approx(0.01, rel=1e-3)
    assert rows["f"]["std"] is None  # jumps from point to point: no derivative


def test_explained_errors_are_errors_that_they_explain():
    target = Target(heading_deg=-20, tilt_deg=10, range_m=9, height_difference_m=1)
    quantity = "profile_spacing_vertical_m"
    now = float(scan_lattice(MIMIC, target.patch(MIMIC)).quantity(quantity))
    table = explain_error(MIMIC, target, quantity=quantity, measured=now + 0.002)
    change = table.set_index("input")["change"]
    for name in ("scanner_heading_deg", "scanner_tilt_deg", "mirror_frequency_hz", "speed_m_s"):
        changed = replace(MIMIC, **{name: getattr(MIMIC, name) + change[name]})
        patch = target.patch(MIMIC)
        assert scan_lattice(changed, patch).quantity(quantity) == pytest.approx(now + 0.002)
    assert change["speed_m_s"] > 0 > change["mirror_frequency_hz"]
    with pytest.raises(ValueError, match="Invalid quantity 'f'"):
        explain_error(MIMIC, target, quantity="f", measured=2.0)


def test_pattern_measures_a_patch_from_the_shell(tmp_path, capsys):
    from mmqa_lab.io import write_cloud
    from mmqa_lab.studies.mimic import simulate_patch

    setup = replace(MIMIC, speed_m_s=8)
    cloud, truth = simulate_patch(setup, Target(range_m=5), size=1.0, seed=1)
    file = tmp_path / "wall.laz"
    write_cloud(file, cloud, scale=1e-5)
    assert main(["pattern", str(file), "--json"]) == 0
    rows = {row["quantity"]: row for row in json.loads(capsys.readouterr().out)}
    gap = rows["profile_spacing_perpendicular_m"]
    assert gap["numbering"] != "pattern"
    assert gap["measured"] == pytest.approx(truth.profile_spacing_perpendicular_m, abs=2e-4)
    assert main(["pattern", str(file), "--alone", "--csv", str(tmp_path / "p.csv")]) == 0
    assert (tmp_path / "p.csv").read_text().count(",pattern\n") == 5


def test_the_scanners_and_systems_named_are_all_that_measure_profiles():
    profilers = {key for key, one in PRESETS.items() if isinstance(one, ProfileScanner)}
    assert profilers == set(patterns.SCANNERS)
    assert set(patterns.HEADS) == set(SYSTEMS)
