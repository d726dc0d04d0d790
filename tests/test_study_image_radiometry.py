"""The image-radiometry study: what it feeds its checks with, and that they can fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab.simulate.blocks import SURFACES, Flight, fly_block
from mmqa_lab.simulate.targets import atmosphere
from mmqa_lab.studies import image_radiometry as study
from mmqa_lab.studies.image_radiometry import blocks, reflectance, resolution


@pytest.fixture(scope="module")
def flown():
    return blocks.fly(strips=2, seed=3)


def test_a_block_without_disturbances_shows_the_ground():
    flight = Flight(strips=2, images=3, gain_std=0.0, radial=0.0, haze=0.0)
    block = fly_block(flight, seed=1)
    table = block.observations()
    table = table[table["view_zenith_deg"] < 6]
    seen = table["radiance"] / np.cos(np.radians(table["sun_zenith_deg"]))
    ratio = seen / table["reference"]
    # within 6 degrees of nadir Walthall's odd term is up to 4 % of the strongest surface
    assert abs(ratio.median() - 1) < 0.02
    assert ratio.between(0.93, 1.07).mean() > 0.98


def test_adjusted_block_has_the_true_anisotropy_and_gains(flown):
    block, observations = flown
    found = blocks.adjust(block, observations, controls=12, seed=1)["absolute"]
    true = SURFACES.set_index("surface").loc[found.anisotropy["surface"]]
    assert np.abs(found.anisotropy["b2"].to_numpy() - true["b2"].to_numpy()).max() < 0.03
    ratio = found.gains["gain"].to_numpy() / block.stations["gain"].to_numpy()
    assert np.std(ratio / ratio.mean()) < 0.005


def test_mosaic_of_the_adjusted_block_is_the_ground(flown):
    block, observations = flown
    found = blocks.adjust(block, observations, controls=12, seed=1)["absolute"]
    even, raw = blocks.mosaic(block, found), blocks.mosaic(block)
    for picture, limit in ((even, 0.999), (raw, 0.98)):
        assert (np.corrcoef(picture.ravel(), block.reflectance.ravel())[0, 1] > 0.999) == (
            limit == 0.999
        )


def test_haze_brightens_dark_ground_more():
    dark, bright = (
        atmosphere("hazy").radiance(r) / atmosphere("clean").radiance(r) for r in (0.03, 0.5)
    )
    assert dark > bright


def test_wedge_saturates_only_where_it_should():
    assert reflectance.calibrate(setting=(0.005, 4.0), seed=1).saturated == 0
    assert reflectance.calibrate(setting=(0.01, 4.0), seed=1).saturated > 0


def test_checks_can_fail():
    edges = pd.DataFrame(
        {
            "method": ["sigmoid: Gaussian", "sigmoid: logistic"],
            "fwhm_error_percent": [2.0, -1.0],
            "mtf50_error_percent": [0.0, 0.0],
        }
    )
    stars = pd.DataFrame({"largest_error": [0.1]})
    assert not any(check.passed for check in study._resolution(edges, stars))
    sensor = pd.DataFrame({"gain_z": [3.0] * 50, "offset_z": [0.0] * 50})
    assert not study._sensor(sensor)[0].passed


def test_real_edges_and_photographs(real):
    real("images/slanted_edge.tif")
    edges = resolution.real_edges()
    found = edges[edges["method"] == "edge method"]
    # the other tools' figures are known to two or three digits
    assert found["mtf50_per_px"].to_numpy() == pytest.approx(found["other_tools"], rel=0.03)
    table, maps = resolution.real_sharpness()
    assert set(maps) == set(table["photograph"])
    assert (table["blurred"] < table["sharpness"]).all()
    assert table["sharpness"].max() > 1.5 * table["blurred"].max()  # the sharp one loses most
    assert (table["not_measurable"] < table["blocks"]).all()
