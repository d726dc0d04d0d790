"""Pfeifer's systems past a chart: brute force, the lattice in closed form, fits of known truth."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.published import pfeifer2021
from mmqa_lab.scan_pattern import Patch, ScanSetup, scan_lattice
from mmqa_lab.simulate import presets, systems
from mmqa_lab.studies.chart_tables.systems import compare, hull_bias, model, pulses_per_revolution

EXACT_B = replace(systems.SYSTEM_B, range_noise_m=0.0, tilt_deg=38)


@pytest.mark.parametrize("distance", systems.DISTANCES)
def test_points_of_a_pitched_multi_beam_scanner_equal_brute_force(distance):
    height, seed = 1.0, 5
    cloud = systems.pass_chart(EXACT_B, distance, seed=seed, height=height)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5)
    start = shift - systems.REACH * distance
    pulse = np.arange(int(2 * systems.REACH * distance / systems.SPEED * EXACT_B.pulse_rate_hz))
    time = pulse / EXACT_B.pulse_rate_hz
    azimuth = 2 * np.pi * (10 * time % 1) - np.pi
    elevation = np.radians(np.array(EXACT_B.elevations_deg)[pulse % 32])
    x = np.cos(elevation) * np.sin(azimuth)
    ahead, up = np.cos(elevation) * np.cos(azimuth), np.sin(elevation)
    c, s = np.cos(np.radians(38)), np.sin(np.radians(38))
    y, z = c * ahead - s * up, s * ahead + c * up
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = distance / x
        along, high = start + systems.SPEED * time + reach * y, height + reach * z
    on = (reach > 0) & (np.abs(along) <= 0.5) & (np.abs(high) <= 0.5)
    expected = np.stack([along[on], high[on]], axis=1)
    assert np.array_equal(np.sort(cloud["pulse"]), pulse[on])
    order = np.argsort(cloud["pulse"])
    assert np.abs(cloud.points[order, 1:] - expected).max() < 1e-8


@pytest.mark.parametrize("preset", [systems.SYSTEM_A, presets.ZF_9012_FITTED])
@pytest.mark.parametrize("distance", systems.DISTANCES)
def test_system_a_scans_the_lattice_of_the_closed_form(preset, distance):
    quality = model.evaluate(systems.pass_chart(preset, distance, seed=2), distance)
    setup = ScanSetup.of_scanner(preset, speed_m_s=systems.SPEED)
    lattice = scan_lattice(setup, Patch([distance, 0, 0], [1, 0, 0]))
    # counts of 1000 to 2400 points by lines of 10 to 25: 2 %; off the middle ranges grow by 0.5 %
    assert quality.density_polygon_per_m2 == pytest.approx(lattice.density_per_m2, rel=0.025)
    d = 1000 * lattice.distances_m
    assert quality.d1_mm == pytest.approx(d[0], rel=0.02)
    assert quality.d4_mm == pytest.approx(d[3], rel=0.02)


def test_density_of_system_b_does_not_depend_on_its_spin():
    means = []
    for spin in (10, 20):
        spun = replace(EXACT_B, spin_hz=spin)
        clouds = (systems.pass_chart(spun, 5.0, seed=seed) for seed in range(6))
        means.append(np.mean([model.evaluate(cloud, 5.0).n for cloud in clouds]))
    assert means[1] == pytest.approx(means[0], rel=0.03)  # 1650 points, clumped by revolution


def test_fit_finds_the_parameters_that_made_a_table():
    truth = {"tilt_deg": 50.0, "height_m": 0.4, "mirror_frequency_hz": 150.0}
    figures = model._closed_form(list(truth), np.array([[*truth.values()]]), np.array([5.0, 10.0]))
    target = pd.DataFrame(figures[0], columns=model.FITTED).assign(distance_m=[5.0, 10.0])
    bounds = model.OPEN["A"] | model.RELEASED["A"]
    best, misfit = model._search(model._closed_form, bounds, target, 1, 1000)
    assert misfit < 0.2
    assert best["mirror_frequency_hz"] == pytest.approx(150, rel=0.02)
    assert best["tilt_deg"] == pytest.approx(50, abs=2)


def test_comparison_keeps_kinds_apart_and_gaps_open():
    published = pfeifer2021.table_2()
    rows = published[["system", "distance_m"]].merge(
        pd.DataFrame({"quantity": model.QUANTITIES}), how="cross"
    )
    guess = rows.assign(predicted=5.0, predicted_low=4.0, predicted_high=6.0)
    table = compare(published, guess, rows.assign(fitted=2.0, fitted_released=np.nan))
    assert len(table) == 30
    assert not any("reproduced" in column for column in table)
    gaps = table["published"].isna()
    assert gaps.sum() == int(published[list(model.QUANTITIES)].isna().sum().sum())
    assert table.loc[gaps, "fitted_difference"].isna().all()
    assert table.loc[gaps, "within"].isna().all()
    f = table.query("system == 'A' and distance_m == 10 and quantity == 'f'").iloc[0]
    assert (f["within"], f["fitted_difference"]) == (True, pytest.approx(2.0 - 5.1))


def test_printed_digits_ask_for_seven_thousand_pulses():
    assert pulses_per_revolution(pfeifer2021.table_2()).round().tolist() == [6981, 7392]


def test_hull_bias_is_the_lost_line_spacing():
    bias = hull_bias(turns=(0, 30), seed=1, repeats=6)
    parallel = bias.loc[bias["turn_deg"] == 0, "bias_percent"]
    # lines 1000 v / 200 = 55.6 mm apart: of a crop of 710 mm one spacing is lost on average
    assert parallel.mean() == pytest.approx(100 * 55.6 / (710 - 55.6), abs=3)
    assert (bias.loc[bias["turn_deg"] == 30, "bias_percent"] < 3).all()


def test_scanners_that_see_no_chart_leave_no_points():
    away = replace(systems.SYSTEM_A, field_of_view_deg=(-180, -90), tilt_deg=89)
    assert len(systems.pass_chart(away, 5.0, seed=1, height=80.0)) == 0


def test_bad_distances_are_named():
    with pytest.raises(ValueError, match="Invalid distance -5"):
        systems.pass_chart(systems.SYSTEM_A, -5, seed=1)
