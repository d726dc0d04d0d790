"""Planning: uncertainty, the largest speed, and the command ``mmqa plan``."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mmqa_lab import simulate
from mmqa_lab.__main__ import main
from mmqa_lab.scan_pattern import (
    LATTICE_QUANTITIES,
    ScanSetup,
    Target,
    detail_size,
    explain_error,
    largest_speed,
    propagate,
    scan_lattice,
    speeds,
)
from mmqa_lab.spacing import empty_space

HEAD = {"pulse_rate_hz": 300_000, "mirror_frequency_hz": 100, "speed_m_s": 10}
MIMIC = ScanSetup(**HEAD, scanner_heading_deg=45, scanner_tilt_deg=45)


def test_monte_carlo_agrees_with_derivatives_by_differences():
    target = Target(heading_deg=15, tilt_deg=10, range_m=11.8)
    sigmas = {"speed_m_s": 0.05, "scanner_tilt_deg": 0.1, "range_m": 0.1, "target_tilt_deg": 0.2}

    def off_by(name, error):
        """The lattice with one input changed, the plane where it was."""
        if hasattr(MIMIC, name):
            changed = replace(MIMIC, **{name: getattr(MIMIC, name) + error})
            return scan_lattice(changed, target.patch(MIMIC))
        field = name.removeprefix("target_")
        return scan_lattice(MIMIC, replace(target, **{field: getattr(target, field) + error}))

    smooth = list(LATTICE_QUANTITIES[:6])
    squares = np.zeros(len(smooth))
    for name, sigma in sigmas.items():
        low, high = (off_by(name, step * sigma / 10) for step in (-1, 1))
        change = [float(getattr(high, q) - getattr(low, q)) for q in smooth]
        squares += (5 * np.array(change)) ** 2
    drawn = propagate(MIMIC, target, sigmas=sigmas, draws=20_000, seed=3).set_index("quantity")
    # a standard deviation from 20,000 draws is good to 0.5 %; 4 sigma and second order: 3 %
    assert drawn.loc[smooth, "std"].to_numpy() == pytest.approx(np.sqrt(squares), rel=0.03)
    assert (drawn.loc[["d1_mm", "d4_mm", "f"], "std"] > 0).all()


@pytest.mark.parametrize(("quantity", "limit"), [("density_per_m2", 3000.0), ("f", 6.0),
    ("profile_spacing_perpendicular_m", 0.04), ("d4_mm", 60.0)])  # fmt: skip
def test_largest_speed_keeps_the_limit_and_no_larger_one_does(quantity, limit):
    setup = ScanSetup(pulse_rate_hz=1e6, mirror_frequency_hz=200, speed_m_s=1, scanner_tilt_deg=45)
    target = Target(range_m=5)
    speed = largest_speed(setup, target, quantity=quantity, limit=limit)
    at = replace(setup, speed_m_s=speed * np.array([1.0, 1.0001, 1.05, 1.5, 3.0]))
    values = getattr(scan_lattice(at, target.patch(at)), quantity)
    assert values[0] == pytest.approx(limit, rel=1e-6)
    assert ((values[1:] < limit) if quantity == "density_per_m2" else (values[1:] > limit)).all()


def test_explained_errors_are_errors_that_they_explain():
    target = Target(heading_deg=-20, tilt_deg=10, range_m=9, height_difference_m=1)
    quantity = "profile_spacing_vertical_m"
    now = float(getattr(scan_lattice(MIMIC, target.patch(MIMIC)), quantity))
    table = explain_error(MIMIC, target, quantity=quantity, measured=now + 0.002)
    change = table.set_index("input")["change"]
    for name in ("scanner_heading_deg", "scanner_tilt_deg", "mirror_frequency_hz", "speed_m_s"):
        changed = replace(MIMIC, **{name: getattr(MIMIC, name) + change[name]})
        patch = target.patch(MIMIC)
        assert getattr(scan_lattice(changed, patch), quantity) == pytest.approx(now + 0.002)
    assert change["speed_m_s"] > 0 > change["mirror_frequency_hz"]


def test_details_of_any_lattice_are_those_of_a_dense_search():
    rng = np.random.default_rng(4)
    for _ in range(30):
        a, b = rng.normal(0, 10.0 ** rng.uniform(-2, 0), 2), rng.normal(0, 1, 2)
        i, j = np.mgrid[-300:301, -30:31].reshape(2, -1, 1)
        places = rng.random((5000, 2)) @ np.array([a, b])
        third = cKDTree(i * a + j * b).query(places, [3])[0]
        assert detail_size(a, b) == pytest.approx(2 * np.quantile(third, 0.95), rel=0.02)
    assert np.isnan(detail_size([np.nan, 1], [0, 1]))


@pytest.mark.parametrize(("scanner", "range_m"), [("zf-9012", 5), ("zf-9012", 8)])
def test_simulated_drives_show_details_up_to_the_planned_speed(scanner, range_m):
    """95 % of discs of 5 cm on a wall get three points at the speed, fewer at a fifth more."""
    preset = replace(simulate.PRESETS[scanner], range_noise_m=0.0, lever_arm_m=(0, 0, 2.0))
    rates = {name: getattr(preset, name) for name in ("pulse_rate_hz", "mirror_frequency_hz")}
    turns = {f"scanner_{turn}": getattr(preset, turn) for turn in ("heading_deg", "tilt_deg")}
    setup, target = ScanSetup(**rates, **turns, speed_m_s=1), Target(range_m=range_m)
    asked = speeds(setup, target, detail=0.05).set_index("asked")["speed_km_h"]
    wall = simulate.rectangle((range_m, 3, 1.5), along=(0, 1, 0), up=(0, 0, 1))
    shares = []
    for factor in (1.0, 1.2):
        path = simulate.straight(7, asked["detail_mm"] / 3.6 * factor)
        points = simulate.scan(simulate.Scene([wall]), preset, path, seed=1).points
        outline = [[3.05, 1.55], [3.95, 1.55], [3.95, 2.45], [3.05, 2.45]]
        shares.append(empty_space(points[:, 1:], outline=outline, rank=3).share(0.025))
    assert shares[0] == pytest.approx(0.95, abs=0.02)
    assert shares[1] < 0.93


def test_speeds_that_nothing_limits_are_nan_and_the_command_lists_them(capsys):
    target = Target(range_m=5)
    table = speeds(MIMIC, target, detail=0.05, rho0=1e9)
    assert np.isnan(table["speed_km_h"][1])
    words = "plan --range 5 --speed 8 --scanner vq-450 --detail 0.05 --json"
    main(words.split())
    rows = json.loads(capsys.readouterr().out)
    assert [row["asked"] for row in rows] == ["detail_mm", "density_per_m2", "f"]
    assert rows[0]["limit"] == 50


def test_a_draw_that_cannot_be_names_the_sigma_that_was_given():
    with pytest.raises(ValueError, match=r"Invalid sigmas {'speed_m_s': 9}\. Must be small"):
        propagate(MIMIC, Target(range_m=5), sigmas={"speed_m_s": 9})


def test_false_inputs_are_refused_by_their_name():
    wall = Target(range_m=5)
    with pytest.raises(ValueError, match=r"Invalid detail -0\.05"):
        speeds(MIMIC, wall, detail=-0.05)
    for plan in (lambda t: speeds(MIMIC, t, detail=0.05), lambda t: propagate(MIMIC, t, sigmas={})):
        with pytest.raises(ValueError, match="Invalid target heading -120"):
            plan(Target(heading_deg=-120, range_m=5))
