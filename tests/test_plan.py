"""Planning: uncertainty, the largest speed, and the command ``mmqa plan``."""

from dataclasses import replace

import numpy as np
import pytest

from mmqa_lab.scan_pattern import (
    QUANTITIES,
    ScanSetup,
    Target,
    explain_error,
    largest_speed,
    propagate,
    scan_lattice,
)

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

    smooth = list(QUANTITIES[:6])
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
