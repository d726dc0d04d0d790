"""Sensor calibration, reflectance, anisotropy and block adjustment against known truth."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.optimize import least_squares

from mmqa_lab import image_targets
from mmqa_lab.radiometry import (
    adjust_block,
    coarse_pairs,
    empirical_line,
    fit_sensor,
    fit_walthall,
    ndvi,
    patch_statistics,
    reflectance_factor,
    sensor,
    stability,
)
from mmqa_lab.radiometry.reflectance import walthall_terms
from mmqa_lab.simulate.targets import ATMOSPHERES, PointSpread, render_edge


def test_sensor_fit_is_ordinary_least_squares_where_weights_are_equal(rng):
    radiance = rng.uniform(5, 200, 40)
    dn = 60 + 28 * radiance + rng.normal(0, 3, 40)
    fit = fit_sensor(radiance, dn)
    gain, offset = np.polyfit(radiance, dn, 1)
    assert fit.gain == pytest.approx(gain, rel=1e-9)
    assert fit.offset == pytest.approx(offset, rel=1e-9)
    assert np.allclose(fit.radiance(dn), radiance + fit.residuals / fit.gain)


def test_two_standard_errors_hold_95_percent(rng):
    radiance = np.linspace(5, 250, 120)
    inside = 0
    for _ in range(400):
        noise = np.sqrt(4 + radiance / 5)
        dn = 60 + 28 * radiance + noise * rng.standard_normal(120)
        fit = fit_sensor(radiance, dn, std_dn=noise)
        inside += np.all(np.abs([fit.gain - 28, fit.offset - 60] / fit.std) < [2, np.inf])
    # a share of 0.95 from 400 seeds scatters by 0.011
    assert 0.95 - 0.035 < inside / 400 < 0.95 + 0.035


def test_saturated_targets_are_left_out():
    radiance = np.array([10.0, 50, 100, 150, 200, 250])
    dn = np.minimum(50 + 20 * radiance, 4095)
    fit = fit_sensor(radiance, dn, std_dn=2.0, full_scale=4095)
    assert (fit.saturated, fit.n) == (1, 5)
    assert fit.gain == pytest.approx(20, abs=1e-9)
    image = np.tile(dn, (4, 1))
    patches = [[0, 4, k, k + 1] for k in range(6)]
    share = patch_statistics(image, patches, full_scale=4095)["saturated_share"]
    assert share.tolist() == [0, 0, 0, 0, 0, 1]
    found = patch_statistics(np.arange(1000.0).reshape(20, 50), [[0, 20, 0, 50]])
    assert found["saturated_share"].item() == 0
    found = patch_statistics(np.minimum(np.arange(1000.0), 500).reshape(20, 50), [[0, 20, 0, 50]])
    assert found["saturated_share"].item() == 0.5


@pytest.mark.parametrize("air", ATMOSPHERES.values())
def test_equation_4_inverts_a_lambertian_target_with_its_factor_and_not_without(air):
    known, around = 0.23, 0.15
    path = air.radiance(0.0, surroundings=around)  # path radiance and adjacency
    choices = {"path_radiance": path, "transmittance": air.direct}
    factor = {"spherical_albedo": air.spherical_albedo, "surroundings": around}
    seen = air.radiance(known, surroundings=around)
    found = reflectance_factor(seen, air.irradiance, **choices, **factor)
    assert found == pytest.approx(known, rel=1e-12)
    without = reflectance_factor(seen, air.irradiance, **choices)
    assert without / known == pytest.approx(1 / (1 - air.spherical_albedo * around), rel=1e-12)


def test_empirical_line_passes_two_targets_and_allows_for_their_anisotropy():
    line = empirical_line([300.0, 1500.0], [0.05, 0.40], anisotropy=[1.1, 1.05])
    assert line.reflectance(300.0) == pytest.approx(0.055, abs=1e-12)
    assert line.reflectance(1500.0, anisotropy=1.05) == pytest.approx(0.40, abs=1e-12)
    assert np.isnan(line.covariance).all()
    assert line.remarks == ("two references cannot check each other",)


def test_propagated_deviation_of_reflectance_and_ndvi_agrees_with_monte_carlo(rng):
    dn, known = np.array([200.0, 900.0, 1700.0]), np.array([0.05, 0.22, 0.42])
    noisy = dn + rng.normal(0, 3, (4000, 3))
    lines = [empirical_line(row, known, std_dn=3.0) for row in noisy]
    measured = np.std([line.reflectance(1200.0) for line in lines])
    assert lines[0].std(1200.0) == pytest.approx(measured, rel=0.1)
    n, r = 0.4 + rng.normal(0, 0.01, 20000), 0.06 + rng.normal(0, 0.004, 20000)
    _, std = ndvi(0.4, 0.06, std_near_infrared=0.01, std_red=0.004)
    assert std == pytest.approx(np.std((n - r) / (n + r)), rel=0.03)


def test_walthall_recovers_its_coefficients(rng):
    view, azimuth = rng.uniform(0, 50, 200), rng.uniform(0, 180, 200)
    true = np.array([0.05, 0.03, 0.2])
    seen = walthall_terms(view, azimuth) @ true
    fit = fit_walthall(seen, view, azimuth)
    assert np.allclose(fit.coefficients, true, atol=1e-9)
    assert fit.anisotropy(0, 77) == pytest.approx(1)
    with pytest.raises(ValueError, match="cannot tell"):
        fit_walthall(seen[:10], 0, 0)


def block(rng, noise=0.005, images=8, ties=120):
    """Observations of a block whose parameters are known."""
    rows = [
        (i, k, rng.uniform(0, 1), rng.uniform(0, 180))
        for k in range(ties)
        for i in rng.choice(images, 4, replace=False)
    ]
    table = pd.DataFrame(rows, columns=["image", "tie", "radius", "azimuth_deg"])
    table["sun_zenith_deg"] = 40 + table["image"]
    table["view_zenith_deg"] = np.degrees(np.arctan(0.7 * table["radius"]))
    ground, gain = rng.uniform(0.05, 0.5, ties), np.exp(rng.normal(0, 0.05, images))
    v, a = np.radians(table["view_zenith_deg"]), np.radians(table["azimuth_deg"])
    light = np.cos(np.radians(table["sun_zenith_deg"])) * ground[table["tie"]]
    light = light * (1 + 0.2 * v**2 + 0.3 * v * np.cos(a)) + 0.02
    table["radiance"] = gain[table["image"]] * light * (1 - 0.1 * table["radius"] ** 2)
    table["radiance"] *= 1 + noise * rng.standard_normal(len(table))
    return table, ground, gain


PRIORS = {"radial": (0.1, 0.0), "haze": (0.0, np.inf)}


def test_a_control_target_in_shadow_is_doubted(rng, recwarn):
    table, ground, _ = block(rng)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 0.002})
    adjust_block(table, control=control, **PRIORS)
    assert not recwarn
    dark = np.where(table["tie"] == 3, 0.6, 1.0)
    with pytest.warns(UserWarning, match=r"Control targets .*3.* contradict the others"):
        adjust_block(table.assign(radiance=dark * table["radiance"]), control=control, **PRIORS)


def test_controls_too_dark_for_an_error_to_be_told_are_said(rng, recwarn):
    table, ground, _ = block(rng)
    order = np.argsort(ground)
    dark, bright = order[0], order[[-1, -9, -17, -25, -33]]

    def adjusted(ties):
        adjust_block(
            table, control=pd.DataFrame({"tie": ties, "reflectance": ground[ties], "std": 0.003})
        )

    adjusted(bright)
    assert not recwarn
    with pytest.warns(UserWarning, match=rf"targets {dark} are wrong by 15% cannot be told"):
        adjusted([*bright, dark])


OTHER_FALLS = [(0.2, 4.0, np.inf), (0.1, 1.7, 0.002), (0.1, 1.7, 0.0)]


@pytest.mark.parametrize(("loss", "power", "std"), OTHER_FALLS)
def test_light_that_falls_off_otherwise_is_said(loss, power, std, rng, recwarn):
    table, ground, _ = block(rng, noise=0.002)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 0.002})
    adjust_block(table, control=control, radial=(0.1, std))
    assert not recwarn
    other = (1 - loss * table["radius"] ** power) / (1 - 0.1 * table["radius"] ** 2)
    with pytest.warns(UserWarning, match="falls off to the corners otherwise"):
        adjust_block(
            table.assign(radiance=other * table["radiance"]), control=control, radial=(0.1, std)
        )


def test_shadowed_observations_do_not_move_the_gains(rng):
    table, ground, gain = block(rng)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 0.002})
    shadow = (rng.random(len(table)) < 0.05) & (table["tie"] > 7)
    dark = table["radiance"] * np.where(shadow, 0.35, 1.0)
    with pytest.warns(UserWarning, match="of the observations contradict the others"):
        found = adjust_block(table.assign(radiance=dark), control=control, **PRIORS)
    off = found.gains["gain"] / gain - 1
    std = found.gains["gain_std_percent"] / 100
    assert np.abs(off).max() < 0.02
    assert (np.abs(off) < 1.96 * std).mean() > 0.8


def test_block_recovers_the_truth_without_noise(rng):
    table, ground, gain = block(rng, noise=0.0)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 1e-6})
    found = adjust_block(table, control=control, **PRIORS)
    assert np.allclose(found.gains["gain"], gain, rtol=1e-6)
    assert np.allclose(found.ties["reflectance"], ground, rtol=1e-5)
    assert found.anisotropy[["b1", "b2"]].to_numpy().ravel() == pytest.approx([0.2, 0.3], abs=1e-5)
    assert found.gains["haze"].to_numpy() == pytest.approx(0.02, abs=1e-6)
    assert found.ties["cv_after_percent"].max() < 1e-3
    assert np.allclose(found.correct(table), ground[table["tie"]], rtol=1e-5)


def test_each_group_of_images_has_its_haze(rng):
    table, ground, _ = block(rng, noise=0.0)
    gain = np.exp(rng.normal(0, 0.05, 8))
    group = np.where(table["image"] < 4, "morning", "noon")
    v, a = np.radians(table["view_zenith_deg"]), np.radians(table["azimuth_deg"])
    light = np.cos(np.radians(table["sun_zenith_deg"])) * ground[table["tie"]]
    light = light * (1 + 0.2 * v**2 + 0.3 * v * np.cos(a)) + np.where(group == "noon", 0.05, 0.02)
    light = gain[table["image"]] * light * (1 - 0.1 * table["radius"] ** 2)
    control = pd.DataFrame({"tie": range(12), "reflectance": ground[:12], "std": 1e-6})
    found = adjust_block(table.assign(radiance=light, group=group), control=control, **PRIORS)
    assert found.gains["haze"].to_numpy() == pytest.approx([0.02] * 4 + [0.05] * 4, abs=1e-6)
    mixed = table.assign(group=np.arange(len(table)) % 2)
    with pytest.raises(ValueError, match="two in one image"):
        adjust_block(mixed, control=control, **PRIORS)


def test_a_line_through_zero_is_the_ratio_of_sums():
    radiance, dn = np.array([10.0, 20, 40, 80]), np.array([101.0, 199, 402, 799])
    fit = fit_sensor(radiance, dn, through_zero=True)
    assert fit.gain == pytest.approx((radiance @ dn) / (radiance @ radiance))
    assert (fit.offset, fit.std[1], fit.freedom) == (0, 0, 3)


def test_block_agrees_with_a_dense_solution(rng):
    table, ground, _ = block(rng, images=4, ties=12, noise=0.002)
    control = pd.DataFrame({"tie": range(6), "reflectance": ground[:6], "std": 0.002})
    found = adjust_block(table, control=control, **PRIORS)
    v, a = np.radians(table["view_zenith_deg"]), np.radians(table["azimuth_deg"])
    sun = np.cos(np.radians(table["sun_zenith_deg"]))

    def misfit(p):
        """All residuals over their deviations, all parameters at once."""
        light = sun * p[7:][table["tie"]] * (1 + p[4] * v**2 + p[5] * v * np.cos(a)) + p[6]
        model = np.exp(p[:4])[table["image"]] * light * (1 - 0.1 * table["radius"] ** 2)
        of_ties = (p[7:13] - ground[:6]) / 0.002
        return np.append((table["radiance"] - model) / (0.02 * table["radiance"]), of_ties)

    start = np.concatenate([np.zeros(7), ground])
    dense = least_squares(misfit, start, xtol=1e-12, ftol=1e-12)
    # the block's Huber weights differ from 1 for few of these observations
    assert np.allclose(np.log(found.gains["gain"]), dense.x[:4], atol=2e-3)
    assert np.allclose(found.ties["reflectance"], dense.x[7:], atol=2e-3)


def test_targets_of_an_image_are_measured_band_by_band(rng):
    known = [0.05, 0.2, 0.45, np.nan]
    dn = np.repeat([[600.0, 1200.0, 2200.0, 1000.0]], 20, axis=1)  # 400 + 4000 reflectance
    bands = np.stack([dn, 2 * dn]).repeat(20, axis=1) + rng.normal(0, 5, (2, 20, 80))
    places = {"x_px": [0, 20, 40, 60], "y_px": 0, "width_px": 20, "height_px": 20}
    targets = pd.DataFrame(places | {"reflectance": known, "radiance": dn[0, ::20] / 10})
    found = image_targets.measure(bands.astype(np.uint16), "reflect", targets=targets)
    assert found["band"].tolist() == ["1", "2"]
    assert found["target"].tolist() == [4, 4]
    assert found["reflectance"].to_numpy() == pytest.approx(0.15, abs=0.002)
    assert (found["reflectance_low"] < 0.15).all()
    assert (found["reflectance_high"] > 0.15).all()
    gains = image_targets.measure(bands.astype(np.uint16), "calibrate", targets=targets)
    assert gains["gain"].to_numpy() == pytest.approx([10, 20], rel=0.01)
    edge = render_edge((60, 80), PointSpread(0.8), angle_deg=5.0)
    seen = image_targets.measure(
        edge[None],
        "edge",
        targets=targets.assign(x_px=10, width_px=60, height_px=60)[:1],
        linear=True,
    )
    assert seen["mtf50_per_px"].item() == pytest.approx(PointSpread(0.8).mtf50(5), rel=0.01)


def test_what_gives_no_number_is_refused(rng):
    with pytest.raises(ValueError, match="of different radiance and DN"):
        fit_sensor([10, 20, 40, 80], [100] * 4)
    fit = fit_sensor([10, 20, 40, 80], [120, 221, 420, 822])
    with pytest.raises(ValueError, match="Invalid radiance 0"):
        stability({"a": fit, "b": fit}, [0.0, 10])
    table, _, _ = block(rng, images=4, ties=10)
    with pytest.raises(ValueError, match=r"Invalid prior: radial \(0.2, nan\)"):
        adjust_block(table, radial=(0.2, np.nan))


@pytest.mark.parametrize("column", ["surface", "group", "azimuth_deg", "radius", "tie"])
def test_an_observation_without_a_value_is_named(column, rng):
    table, _, _ = block(rng, images=4, ties=10)
    table = table.assign(surface="road", group=0).astype({"tie": float})
    table[column] = table[column].where(table.index != 6)
    with pytest.raises(ValueError, match=f"no {column} in row 7"):
        adjust_block(table)


def test_a_control_target_that_is_given_twice_counts_by_its_mean_in_any_order(rng):
    table, ground, _ = block(rng, images=4, ties=20)
    control = pd.DataFrame({"tie": range(6), "reflectance": ground[:6], "std": 0.002})
    again = pd.concat([control, control[:1].assign(reflectance=1.01 * ground[0], std=0.001)])
    gains = [
        adjust_block(table, control=one, **PRIORS).gains["gain"] for one in (again, again[::-1])
    ]
    assert np.allclose(*gains, rtol=1e-9)
    mean = (ground[0] + 4 * 1.01 * ground[0]) / 5  # weights 1 and 4
    once = control.assign(reflectance=[mean, *ground[1:6]], std=[0.002 / 5**0.5, *[0.002] * 5])
    assert np.allclose(
        gains[0], adjust_block(table, control=once, **PRIORS).gains["gain"], rtol=1e-9
    )


def test_light_that_falls_off_is_allowed_for_without_a_word_of_it(rng):
    table, ground, gain = block(rng)
    dark = table["radiance"] * (1 - 0.25 * table["radius"] ** 2)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 0.002})
    found = adjust_block(table.assign(radiance=dark), control=control)
    off = (found.gains["gain"] / gain - 1).abs()
    assert off.max() < 0.03
    assert (off < 2.5 * found.gains["gain_std_percent"] / 100).all()


def test_an_image_half_under_a_cloud_is_said(rng):
    table, ground, _ = block(rng)
    control = pd.DataFrame({"tie": range(8), "reflectance": ground[:8], "std": 0.002})
    cloudy = (table["image"] == 5) & (table["azimuth_deg"] > 90)
    for loss in (0.1, 0.3):
        dark = table["radiance"] * np.where(cloudy, 1 - loss, 1.0)
        with pytest.warns(UserWarning, match="images 5 contradict each other"):
            adjust_block(table.assign(radiance=dark), control=control, **PRIORS)


def test_intervals_hold_where_observations_are_better_than_is_taken_at_first(rng):
    inside, widths = [], []
    for _ in range(12):
        table, ground, gain = block(rng, noise=0.005)
        known = ground[:6] + 0.003 * rng.standard_normal(6)
        control = pd.DataFrame({"tie": range(6), "reflectance": known, "std": 0.003})
        found = adjust_block(table, control=control, **PRIORS).gains
        inside += [abs(found["gain"] / gain - 1) < 1.96 * found["gain_std_percent"] / 100]
        widths += [found["gain_std_percent"].mean()]
    assert np.mean(inside) > 0.8
    assert np.mean(widths) < 0.9


REFLECTANCES = np.array([0.03, 0.12, 0.25, 0.4, 0.55])


def references(rng, *, std=0.03, wrong=None, factor=1.0):
    """DN of five references, what is said to be known of them, and its standard error in DN."""
    known = REFLECTANCES * (1 + std * rng.standard_normal(5))
    if wrong is not None:
        known[wrong] *= factor
    return 200 + 4000 * REFLECTANCES, known, 4000 * np.hypot(0.001, 0.03 * REFLECTANCES)


def test_a_reference_with_a_wrong_label_is_named_and_left_out_on_request():
    named, near, silent = 0, [], 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        dn, known, errors = references(rng, wrong=3, factor=0.7)
        line = empirical_line(dn, known, std_dn=errors)
        named += line.odd == 3
        assert line.remarks
        without = empirical_line(dn, known, std_dn=errors, leave_out=True)
        near.append(float(without.reflectance(1400.0)) - 0.3)
        silent += not empirical_line(*references(rng)[:2], std_dn=errors).remarks
    assert named >= 36
    assert np.std(near) < 0.012
    assert silent >= 36


def test_residuals_that_refute_a_stated_error_widen_the_interval_and_are_said(rng):
    inside, said = 0, 0
    for _ in range(60):
        dn, known, _ = references(rng)
        line = empirical_line(dn, known, std_dn=4000 * np.hypot(0.0005, 0.005 * REFLECTANCES))
        reach = stats.t.ppf(0.975, line.freedom) * line.std(1400.0)
        inside += abs(line.reflectance(1400.0) - 0.3) < reach
        said += bool(line.remarks)
    assert said > 50
    assert inside > 48


def test_targets_that_leave_a_sensors_line_are_said(rng):
    radiance = np.array([5.0, 20, 45, 80, 120, 160])
    dn = 60 + 20 * radiance + rng.normal(0, 4, 6)
    assert fit_sensor(radiance, dn).remarks == ()
    assert fit_sensor(radiance, np.where(radiance == 80, 1.3 * dn, dn)).remarks
    assert "target 4" in fit_sensor(radiance, np.where(radiance == 80, 1.3 * dn, dn)).remarks[0]
    assert fit_sensor(radiance, dn[[0, 2, 1, 3, 5, 4]]).remarks  # swapped
    cloudy = fit_sensor(radiance, np.where(radiance > 100, 0.7 * dn, dn)).remarks
    assert any("bent" in remark or "leave the line" in remark for remark in cloudy)


@pytest.mark.parametrize("change", ["none", "hot", "trend"])
def test_hot_pixels_and_light_along_a_row_of_targets(change, rng):
    radiance = np.array([40.0, 10, 120, 80, 20, 160])
    image = np.repeat(60 + 20 * radiance, 20)[None].repeat(20, axis=0)
    image *= np.linspace(1, 0.85 if change == "trend" else 1, 120)
    image += rng.normal(0, 8, image.shape)
    if change == "hot":
        image[rng.random(image.shape) < 0.005] = 4095
    places = {"x_px": np.arange(6) * 20, "y_px": 0, "width_px": 20, "height_px": 20}
    table = pd.DataFrame({**places, "radiance": radiance})
    row = image_targets.measure(image[None], "calibrate", targets=table, linear=True).iloc[0]
    words = {"none": "^$", "hot": "odd pixels left out", "trend": r"the light changes by 1\d%"}
    assert re.search(words[change], row["remarks"])
    if change != "trend":
        assert row["gain_low"] - 0.02 < 20 < row["gain_high"] + 0.02
        assert row["gain"] == pytest.approx(20, rel=0.003)


@pytest.mark.parametrize("seed", [199, 283])
def test_blocks_of_few_noisy_observations_end(seed):
    rng = np.random.default_rng(5000 + seed)
    noise, images = rng.choice([0.002, 0.01, 0.03, 0.06]), int(rng.integers(4, 12))
    table, _, gain = block(rng, noise, images, int(rng.integers(25, 150)))
    assert len(adjust_block(table).gains) == len(gain)


def test_a_control_target_that_is_wrong_by_a_seventh_is_named_and_no_other(rng):
    table, ground, _ = block(rng, noise=0.01)
    place = np.argsort(ground)[[20, 40, 60, 80, 100, 115]]
    control = pd.DataFrame({"tie": place, "reflectance": ground[place], "std": 0.01})
    control.loc[4, "reflectance"] *= 1.15
    with pytest.warns(UserWarning, match=f"Control targets {place[4]} contradict"):
        adjust_block(table, control=control)


def test_surfaces_that_flash_up_against_the_sun_are_said(rng, recwarn):
    table, _, _ = block(rng, ties=400)
    table["view_zenith_deg"] = np.degrees(np.arctan(1.2 * table["radius"]))
    away = [np.radians(table[name]) for name in ("sun_zenith_deg", "view_zenith_deg")]
    cosines = np.cos(away[0]) * np.cos(away[1])
    cosines += np.sin(away[0]) * np.sin(away[1]) * np.cos(np.radians(table["azimuth_deg"]))
    flash = 0.2 * np.exp(-((np.degrees(np.arccos(cosines)) / 6) ** 2))
    with pytest.warns(UserWarning, match="where the sun stands behind the camera"):
        adjust_block(table.assign(radiance=table["radiance"] * (1 + flash)))


def test_coarse_pairs_are_the_image_first_and_the_reference_second(rng):
    light = rng.uniform(10, 90, (12, 9))
    dn, radiance = coarse_pairs(np.kron(200 + 3 * light, np.ones((4, 4))), light)
    assert dn == pytest.approx(200 + 3 * radiance)
    assert radiance.reshape(12, 9)[1, 1] == pytest.approx(np.median(light[:3, :3]))


def test_pixels_pile_up_where_they_are_saturated_and_not_by_chance():
    level = sensor.saturation_level
    spread = np.repeat(np.arange(100, 200), 40)
    assert level(np.r_[spread, np.full(201, 210)]) == 210
    assert level(np.r_[spread, np.full(199, 199)]) == 199  # with those of the spread 239
    assert level(np.r_[np.arange(50), np.full(9, 60)]) == np.inf  # may be chance
    assert level(np.r_[np.arange(50), np.full(10, 60)]) == 60
    # more than five times any of the ten values below
    for value in (59, 50):
        assert level(np.r_[np.full(8, value), np.full(40, 60)]) == np.inf
        assert level(np.r_[np.full(8, value), np.full(41, 60)]) == 60
    assert level(np.r_[np.full(8, 49), np.full(11, 60)]) == 60
    many = np.tile(np.arange(1000), 1000)
    assert level(np.r_[many[:200_000] % 150, np.full(19, 200)]) == np.inf  # of ten thousand one
    assert level(np.r_[many[:200_000] % 150, np.full(22, 200)]) == 200
    for bits in (8, 10, 12, 14, 16):
        assert level(np.array([3, 2**bits - 1])) == 2**bits - 1


def test_a_sensor_is_fitted_to_three_unsaturated_targets_of_different_light():
    light, dn = np.array([10.0, 20, 40, 80]), np.array([120.0, 220, 420, 820])
    assert fit_sensor(light[:3], dn[:3]).gain == pytest.approx(10)
    for some in ((light[:2], dn[:2]), (0 * light + 5, dn), (light, 0 * dn + 7)):
        with pytest.raises(ValueError, match="three or more, of different radiance and DN"):
            fit_sensor(*some)
    # three deviations below full scale a target counts
    assert fit_sensor(light, dn, std_dn=10, full_scale=851).saturated == 0
    assert fit_sensor(light, dn, std_dn=10, full_scale=849).saturated == 1


def test_a_bent_sensor_is_said_from_two_per_cent_of_its_range_on(rng):
    light = np.linspace(10, 90, 12)
    for share, said in ((0.015, False), (0.025, True)):
        # a parabola that leaves its chord by that share of the range in the middle
        off = 1 - ((light - 50) / 40) ** 2
        dn = 10 * light + share * 800 * off + 0.1 * rng.standard_normal(12)
        remarks = " ".join(fit_sensor(light, dn, std_dn=0.1).remarks)
        assert ("bent by" in remarks) == said, (share, remarks)
