"""Targets in images: columns that are known, regions that lie right, what is read of them."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

from mmqa_lab import image_targets
from mmqa_lab.charts import encode
from mmqa_lab.mtf import fit_edge, haar_sharpness, measure_star
from mmqa_lab.radiometry import empirical_line, fit_sensor
from mmqa_lab.simulate.targets import PointSpread, render_edge, render_star

KNOWN = [0.05, 0.2, 0.45, np.nan]
PLACES = {"x_px": [0, 20, 40, 60], "y_px": 0, "width_px": 20, "height_px": 20}


def tarps(rng, dn=(600.0, 1200.0, 2200.0, 1000.0)):
    """Four tarps side by side of 16 bits, DN 400 + 4000 reflectance; and their table."""
    values = np.repeat([dn], 20, axis=1).repeat(20, axis=0) + rng.normal(0, 5, (20, 80))
    radiance = [20.0, 80.0, 180.0, np.nan]
    table = pd.DataFrame(
        PLACES | {"reflectance": KNOWN, "radiance": radiance, "name": list("abcd")}
    )
    return values.astype(np.uint16)[None], table


@pytest.mark.parametrize(
    ("column", "nearest"),
    [("height_m", "height_px"), ("anisotropie", "anisotropy"), ("f_numbr", "f_number")],
)
def test_columns_that_are_not_known_are_refused_by_name(column, nearest, rng):
    image, table = tarps(rng)
    with pytest.raises(ValueError, match=f"'{column}'.*'{nearest}' is the nearest"):
        image_targets.measure(image, "reflect", targets=table.assign(**{column: 1.0}))


def test_exposures_and_anisotropy_are_read(rng):
    image, table = tarps(rng)
    plain = image_targets.measure(image, "calibrate", targets=table)
    relative = image_targets.measure(image, "calibrate", targets=table.assign(exposure=0.5))
    assert relative["gain"].item() == pytest.approx(2 * plain["gain"].item())
    settings = table.assign(time_s=0.02, f_number=8.0)  # half the usual exposure
    found = image_targets.measure(image, "calibrate", targets=settings)
    assert found["gain"].item() == pytest.approx(2 * plain["gain"].item())
    seen = image_targets.measure(image, "reflect", targets=table.assign(anisotropy=[1, 1, 1, 1.5]))
    assert seen["reflectance"].item() == pytest.approx(0.1, abs=0.002)
    unsure = image_targets.measure(image, "reflect", targets=table.assign(reflectance_std=0.02))
    width = unsure["reflectance_high"] - unsure["reflectance_low"]
    assert 0.03 < width.item() < 0.08  # 2 x 1.96 x 0.02 over the root of two or three


@pytest.mark.parametrize("measure", ["reflect", "calibrate"])
def test_a_region_half_beside_its_tarp_is_said(measure, rng):
    image, table = tarps(rng)
    assert "not even" not in image_targets.measure(image, measure, targets=table)["remarks"].item()
    for axis, turned in ((0, image), (1, image.transpose(0, 2, 1))):
        moved = table.assign(x_px=[0, 30, 40, 60])
        if axis:
            moved = moved.rename(columns={"x_px": "y_px", "y_px": "x_px"})
        remark = image_targets.measure(turned, measure, targets=moved)["remarks"].item()
        assert "b not even: half beside its target?" in remark


def test_a_target_that_fails_does_not_cost_the_others_their_rows(rng):
    edge = render_edge((60, 80), PointSpread(0.8), angle_deg=5.0)
    image = np.hstack([edge, rng.normal(0.5, 0.01, (60, 80))])[None]
    table = pd.DataFrame({"x_px": [10, 90], "y_px": 0, "width_px": 60, "height_px": 60})
    found = image_targets.measure(image, "edge", targets=table)
    assert found["mtf50_per_px"].notna().tolist() == [True, False]
    assert found["remarks"].iloc[1].startswith("Invalid ")


@pytest.mark.parametrize("bits", [8, 16])
def test_resolution_is_measured_alike_in_8_and_16_bits_and_in_shares(bits, rng):
    edge = render_edge((100, 64), PointSpread(0.8), angle_deg=5.0)
    edge = edge + 0.002 * rng.standard_normal(edge.shape)
    codes = np.round(encode(edge, "srgb") * (2**bits - 1)).astype(f"uint{bits}")
    table = pd.DataFrame({"x_px": [0], "y_px": 0, "width_px": 64, "height_px": 100})
    for values in (codes, codes / (2**bits - 1)):
        found = image_targets.measure(values[None], "edge", targets=table)["mtf50_per_px"].item()
        assert found == pytest.approx(PointSpread(0.8).mtf50(5), rel=0.02)
    for kind in ("int32", "float32"):
        with pytest.raises(ValueError, match=f"{kind} without a full scale. Must be uint8, uint16"):
            image_targets.measure(codes[None].astype(kind), "edge", targets=table)


@pytest.mark.parametrize(("column", "value"), [("x_px", np.nan), ("width_px", np.inf)])
def test_a_place_that_is_no_number_names_its_target(column, value, rng):
    image, table = tarps(rng)
    table[column] = table[column].astype(float).mask(table.index == 2, value)
    with pytest.raises(ValueError, match=f"Invalid {column} of target 3"):
        image_targets.measure(image, "reflect", targets=table)


@pytest.mark.parametrize("falls", [0.0, 0.15])
def test_light_that_falls_along_the_references_is_said_of_a_reflectance(falls, rng):
    known = np.array([0.05, 0.5, 0.1, 0.3, 0.2, 0.4])
    dn = (400 + 4000 * np.append(known, 0.25)) * (1 - falls * np.arange(7) / 6)
    values = np.repeat([dn], 20, axis=1).repeat(20, axis=0) + rng.normal(0, 5, (20, 140))
    table = pd.DataFrame({"x_px": 20 * np.arange(7), "y_px": 0, "width_px": 20, "height_px": 20})
    table = table.assign(reflectance=np.append(known, np.nan), name=list("abcdefg"))
    image = values.astype(np.uint16)[None]
    found = image_targets.measure(image, "reflect", targets=table)
    assert ("the light changes by" in found["remarks"].item()) == (falls > 0)


def test_sharpness_is_the_median_of_its_blocks_with_the_interval_of_a_median(rng):
    image = np.kron(rng.integers(40, 200, (40, 60)), np.ones((8, 8)))
    image = np.roll(image, (3, 3), (0, 1)) + rng.normal(0, 1, (320, 480))
    row = image_targets.measure(np.uint8(image.round())[None], "sharpness", linear=True).iloc[0]
    blocks = np.ravel(haar_sharpness(np.uint8(image.round()))["sharpness"])
    assert row["blocks"] == len(blocks)
    blocks = blocks[np.isfinite(blocks)]
    assert len(blocks) > 10
    low, middle, high = np.quantile(blocks, [0.25, 0.5, 0.75])
    reach = 1.57 * (high - low) / np.sqrt(len(blocks))  # of a box plot's notch
    assert row["sharpness"] == pytest.approx(middle)
    assert row["sharpness_low"] == pytest.approx(middle - reach)
    assert row["sharpness_high"] == pytest.approx(middle + reach)


@pytest.mark.parametrize("what", ["sharpness", "reflect"])
def test_an_image_without_bands_is_refused_by_its_shape(what, rng):
    image, table = tarps(rng)
    with pytest.raises(ValueError, match=r"shape \(20, 80\)\. Must be \(bands, rows, columns\)"):
        image_targets.measure(image[0], what, targets=table)


def spotted(rng, known, std=6.0, wide=20, high=20):
    """Tarps side by side, DN 400 + 4000 reflectance in 16 bits, and their table."""
    dn = np.nan_to_num(known, nan=0.25) * 4000 + 400
    values = np.repeat([dn], wide, axis=1).repeat(high, axis=0)
    image = (values + std * rng.standard_normal(values.shape)).round().astype(np.uint16)
    table = pd.DataFrame({"x_px": wide * np.arange(len(known)), "y_px": 0, "width_px": wide})
    return image, table.assign(height_px=high, reflectance=known)


def statistics(image, table):
    """Means and deviations of the tarps' pixels, rounding with them, one after the other."""
    parts = [image[:, x : x + w] for x, w in zip(table["x_px"], table["width_px"], strict=True)]
    std = np.array([np.hypot(part.std(ddof=1), 12**-0.5) for part in parts])
    return np.array([part.mean() for part in parts]), std, parts[0].size


@pytest.mark.parametrize("stds", [None, 0.004])
def test_a_reflectance_is_that_of_its_empirical_line_with_students_interval(stds, rng):
    known = np.array([0.05, 0.2, 0.45, 0.3, np.nan])
    image, table = spotted(rng, known)
    table["anisotropy"] = [1.1, 1.0, 0.9, 1.0, 1.25]
    if stds:
        table["reflectance_std"] = [stds] * 4 + [np.nan]
    row = image_targets.measure(image[None], "reflect", targets=table).iloc[0]
    mean, std, n = statistics(image, table)
    seen_as = (known * table["anisotropy"])[:4].to_numpy()
    error = std / np.sqrt(n)
    if stds:
        slope = np.polyfit(mean[:4], known[:4], 1)[0]
        stated = np.hypot(error[:4], stds / slope)
    line = empirical_line(mean[:4], known[:4], anisotropy=table["anisotropy"][:4],
                          **({"std_dn": stated} if stds else {}))  # fmt: skip
    assert row["references"] == 4
    value = (line.slope * mean[4] + line.intercept) / 1.25
    assert row["reflectance"] == pytest.approx(value)
    reach = float(line.std(mean[4], std_dn=error[4])) / 1.25
    factor = t.ppf(0.975, line.freedom) if np.isfinite(line.freedom) else 1.95996398
    assert row["reflectance_high"] - value == pytest.approx(factor * reach, rel=1e-6)
    assert value - row["reflectance_low"] == pytest.approx(factor * reach, rel=1e-6)
    assert len(seen_as) == 4
    assert row["target"] == 5


def test_two_references_give_a_line_with_the_errors_of_their_pixels(rng):
    image, table = spotted(rng, np.array([0.05, 0.45, np.nan]))
    row = image_targets.measure(image[None], "reflect", targets=table).iloc[0]
    mean, std, n = statistics(image, table)
    share = (mean[2] - mean[0]) / (mean[1] - mean[0])
    slope = 0.4 / (mean[1] - mean[0])
    error = std / np.sqrt(n) * slope
    reach = 1.95996398 * np.sqrt(
        ((1 - share) * error[0]) ** 2 + (share * error[1]) ** 2 + error[2] ** 2
    )
    assert row["reflectance"] == pytest.approx(0.05 + 0.4 * share)
    assert row["reflectance_high"] - row["reflectance"] == pytest.approx(reach, rel=1e-3)
    assert "two references cannot check each other" in row["remarks"]
    with pytest.raises(ValueError, match="1 unsaturated with a known reflectance"):
        image_targets.measure(
            image[None], "reflect", targets=table.assign(reflectance=[0.1, None, None])
        )
    beyond = image_targets.measure(
        image[None], "reflect", targets=table.assign(reflectance=[0.05, np.nan, 0.25])
    ).iloc[0]
    assert "beyond the reference targets" in beyond["remarks"]
    assert "beyond" not in row["remarks"]
    image[:, 40:] = 65_535
    full = image_targets.measure(image[None], "reflect", targets=table).iloc[0]
    assert np.isnan(full["reflectance"])
    assert full["remarks"].startswith("saturated")


def test_a_gain_has_students_interval_of_weighted_least_squares(rng):
    image, table = spotted(rng, np.array([0.05, 0.2, 0.45, 0.3, 0.1]))
    table = table.rename(columns={"reflectance": "radiance_1"}).assign(exposure=[1, 1, 0.5, 1, 2.0])
    row = image_targets.measure(image[None], "calibrate", targets=table).iloc[0]
    mean, std, _ = statistics(image, table)
    signal = (table["radiance_1"] * table["exposure"]).to_numpy()
    fit = fit_sensor(signal, mean, std_dn=std)
    assert (row["gain"], row["offset_dn"]) == pytest.approx((fit.gain, fit.offset))
    reach = t.ppf(0.975, 3) * fit.std
    assert row["gain_high"] - row["gain"] == pytest.approx(reach[0])
    assert row["offset_dn"] - row["offset_low_dn"] == pytest.approx(reach[1])
    assert row["r_squared"] == pytest.approx(fit.r_squared)
    assert row["n"] == 5
    timed = table.drop(columns="exposure").assign(time_s=[0.01, 0.01, 0.005, 0.01, 0.02])
    again = image_targets.measure(image[None], "calibrate", targets=timed).iloc[0]
    assert again["gain"] == pytest.approx(row["gain"])


def test_an_edge_and_a_star_have_the_intervals_of_their_measures(rng):
    edge = render_edge((60, 60), PointSpread(0.8), angle_deg=5.0)
    edge = edge + 0.004 * rng.standard_normal((60, 60))
    image = np.pad(edge, ((10, 5), (20, 30)), constant_values=0.1)
    table = pd.DataFrame({"x_px": [20], "y_px": 10, "width_px": 60, "height_px": 60, "name": "e"})
    row = image_targets.measure(image[None], "edge", targets=table, linear=True).iloc[0]
    fit = fit_edge(edge)
    assert (row["mtf50_per_px"], row["fwhm_px"]) == pytest.approx((fit.mtf50, fit.fwhm_px))
    reach = 1.95996398 * fit.mtf50_sigma
    assert row["mtf50_high_per_px"] - fit.mtf50 == pytest.approx(reach, rel=1e-4)
    # the width is known as well as MTF50, as shares of both
    assert row["fwhm_high_px"] - fit.fwhm_px == pytest.approx(
        reach / fit.mtf50 * fit.fwhm_px, rel=1e-4
    )
    assert (row["angle_deg"], row["n"], row["target"], row["band"]) == (
        fit.angle_deg,
        fit.n,
        "e",
        "1",
    )
    star = render_star((120, 110), PointSpread(0.8), cycles=18, radius_px=50)
    star = star + 0.003 * rng.standard_normal(star.shape)
    table = pd.DataFrame({"x_px": [54.5], "y_px": 59.5, "radius_px": 50.0, "cycles": 18})
    row = image_targets.measure(star[None], "star", targets=table, linear=True).iloc[0]
    found = measure_star(star, (54.5, 59.5), cycles=18, radius_px=50.0)
    assert (row["mtf50_per_px"], row["mtf10_per_px"]) == pytest.approx((found.mtf50, found.at(0.1)))
    reach = row["mtf50_high_per_px"] - row["mtf50_per_px"]
    assert reach == pytest.approx(1.95996398 * found.mtf50_sigma, rel=1e-4)


@pytest.mark.parametrize("place", [(-1, 0), (61, 0), (60, -1), (60, 1)])
def test_a_region_must_lie_within_the_image_to_the_pixel(place, rng):
    image, table = spotted(rng, np.array([0.05, 0.2, 0.45, np.nan]))
    fine = table.assign(x_px=[0, 20, 40, 60.4])
    assert len(image_targets.measure(image[None], "reflect", targets=fine)) == 1
    wrong = table.assign(x_px=[0, 20, 40, place[0]], y_px=[0, 0, 0, place[1]])
    with pytest.raises(ValueError, match=r"Invalid (region of a target|patch)"):
        image_targets.measure(image[None], "reflect", targets=wrong)
    edges = table.rename(columns={"reflectance": "name"})[3:].assign(x_px=place[0], y_px=place[1])
    with pytest.raises(ValueError, match="Invalid region of a target"):
        image_targets.measure(image[None], "edge", targets=edges.assign(name="e"), linear=True)


@pytest.mark.parametrize(("step", "noise", "said"), [
    (0.049, 0.0, False), (0.051, 0.0, True), (0.2, 0.0, True),
    (0.07, 200.0, False), (0.14, 200.0, True),
])  # fmt: skip
def test_a_region_is_uneven_where_its_quarters_differ_by_a_twentieth_and_six_errors(
    step, noise, said, rng
):
    image, table = spotted(rng, np.array([0.05, 0.2, 0.45, np.nan]), std=3.0)
    level = 400 + 4000 * 0.25
    image[:, 70:] = level * (1 + step / 2)  # half of the last tarp
    image[:, 60:70] = level * (1 - step / 2)
    image[:, 60:] += (noise * rng.standard_normal((20, 20))).astype(np.int16).astype(np.uint16)
    remark = image_targets.measure(image[None], "reflect", targets=table)["remarks"].item()
    assert ("4 not even" in remark) == said
    turned = table.rename(columns={"x_px": "y_px", "y_px": "x_px", "width_px": "height_px",
                                   "height_px": "width_px"})  # fmt: skip
    remark = image_targets.measure(image.T[None], "reflect", targets=turned)["remarks"].item()
    assert ("4 not even" in remark) == said


def test_light_along_targets_is_told_by_its_share(rng):
    known = np.array([0.05, 0.5, 0.1, 0.3, 0.2, 0.4, 0.25, 0.35])
    image, table = spotted(rng, known, std=0.0)
    values = image - 400.0
    for falls in (0.1, 0.2):
        ends = np.repeat(1 - falls * np.arange(8) / 7, 20)
        dim = np.round(400 + values * ends).astype(np.uint16)
        dim[::2, ::2] += 1
        light = table.rename(columns={"reflectance": "radiance"})
        remark = image_targets.measure(dim[None], "calibrate", targets=light)["remarks"].item()
        told = int(remark.split("the light changes by ")[1].split("%")[0])
        assert told == pytest.approx(100 * falls, abs=100 * falls**2)
