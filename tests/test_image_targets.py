"""Targets in images: columns that are known, regions that lie right, what is read of them."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import image_targets
from mmqa_lab.charts import encode
from mmqa_lab.mtf import haar_sharpness
from mmqa_lab.simulate.targets import PointSpread, render_edge

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
