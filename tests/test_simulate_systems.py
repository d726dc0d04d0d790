"""Pfeifer's systems past a chart: brute force, the lattice in closed form, the published rows."""

from dataclasses import replace

import numpy as np
import pytest

from mmqa_lab import published, simulate
from mmqa_lab._streams import stream
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.scan_pattern import Patch, ScanSetup, scan_lattice
from mmqa_lab.simulate import PRESETS, chart_corners, systems

EXACT_B = replace(systems.SYSTEM_B, range_noise_m=0.0, tilt_deg=38)


def read(cloud, distance):
    """The chart's middle, as it is evaluated by default."""
    corners = chart_corners((distance, 0, 0), heading=systems.FACING_THE_ROAD)
    return evaluate_cloud(cloud, polygon=chart_polygon(corners), thickness=0.2)


def test_points_of_a_pitched_multi_beam_scanner_equal_brute_force():
    distance, height, seed = 5.0, 1.0, 5
    cloud = systems.pass_chart(EXACT_B, distance, seed=seed, height=height)
    shift = stream(seed, "pass_chart").uniform(-0.5, 0.5)
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


@pytest.mark.parametrize("preset", [systems.SYSTEM_A, PRESETS["zf-9012-fitted"]])
@pytest.mark.parametrize("distance", [5.0, 10.0])
def test_system_a_scans_the_lattice_of_the_closed_form(preset, distance):
    quality = read(systems.pass_chart(preset, distance, seed=2), distance)
    rates = {name: getattr(preset, name) for name in ("pulse_rate_hz", "mirror_frequency_hz")}
    angles = {"scanner_heading_deg": preset.heading_deg, "scanner_tilt_deg": preset.tilt_deg}
    setup = ScanSetup(**rates, **angles, speed_m_s=systems.SPEED)
    lattice = scan_lattice(setup, Patch([distance, 0, 0], [1, 0, 0]))
    # counts of 1000 to 2400 points by lines of 10 to 25: 2 %; off the middle ranges grow by 0.5 %
    assert quality.density_polygon_per_m2 == pytest.approx(lattice.density_per_m2, rel=0.025)
    assert quality.d1_mm == pytest.approx(lattice.d1_mm, rel=0.02)
    assert quality.d4_mm == pytest.approx(lattice.d4_mm, rel=0.02)


def test_system_c_keeps_its_density_and_pattern_at_any_distance():
    """Table 2: d1 = 3 mm, d4 = 8 mm, f = 2.6 at 5 m and at 10 m; 28,901 and 30,915 points/m2."""
    for distance in (5.0, 10.0):
        quality = read(systems.pass_chart(systems.SYSTEM_C, distance, seed=3), distance)
        # 15,000 points: the count repeats to 1 %, d1 and d4 to 1 %
        assert quality.density_polygon_per_m2 == pytest.approx(29_900, rel=0.03)
        assert quality.d1_mm == pytest.approx(3, abs=0.5)
        assert quality.d4_mm == pytest.approx(8, abs=0.7)
        assert quality.f == pytest.approx(2.6, abs=0.1)


def test_scanners_that_see_no_chart_leave_no_points():
    away = replace(systems.SYSTEM_A, field_of_view_deg=(-180, -90), tilt_deg=89)
    assert len(systems.pass_chart(away, 5.0, seed=1, height=80.0)) == 0


def test_five_systems_have_the_numbers_of_table_3_2():
    printed = published.table("eurosdr2013_mls", "table_3_2")
    as_tested = ~printed["condition"].str.contains("not tested")
    rows = printed[as_tested].set_index(["system", "quantity"])["value"]
    names = {"roamer": "ROAMER", "sensei": "Sensei"}
    names |= dict.fromkeys(("vmx-250", "streetmapper-360"), "RIEGL VMX-250 and Streetmapper 360")
    names["lynx"] = "Optech Lynx Mobile Mapper (TerraTec AS)"
    for name, system in names.items():
        head = simulate.system(name).heads[0]
        low, high = head.field_of_view_deg
        assert head.pulse_rate_hz * (high - low) / 360 == pytest.approx(
            float(rows[system, "points_per_s_max"])
        )
        assert 1000 * head.range_noise_m == pytest.approx(float(rows[system, "distance_accuracy"]))
    assert [len(simulate.system(name).heads) for name in names] == [1, 1, 2, 2, 2]


def test_roamer_delivers_neither_dark_nor_isolated_points():
    rng = np.random.default_rng(3)
    near, sparse = rng.uniform(0, 3, (300, 3)), rng.uniform(-20, 20, (400, 3))
    points = np.vstack([near, sparse]) + [380_000, 6_672_000, 20]
    cloud = Cloud(points, {"intensity": np.where(np.arange(700) % 7, 9000, 200)})
    found = simulate.system("roamer").delivered(cloud)
    left = points[cloud["intensity"] >= 257]
    others = (np.linalg.norm(left[:, None] - left, axis=2) <= 2).sum(axis=1) - 1
    assert 0 < len(found) < len(left)
    assert np.array_equal(found.points, left[others >= 50])
    assert len(simulate.system("lynx").delivered(cloud)) == 700
