"""The studies of images: what they feed their checks with, and that these can fail."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.radiometry import adjust_block, stability
from mmqa_lab.simulate.targets import ATMOSPHERES, SURFACES, Flight, blocks, fly_block
from mmqa_lab.studies import image_radiometry, image_resolution


@pytest.fixture(scope="module")
def flown():
    block = fly_block(Flight(strips=2), seed=3)
    seen = block.observations
    truth = seen.drop_duplicates("tie").set_index("tie")["reference"].sort_values()
    chosen = truth.iloc[np.linspace(0, len(truth) - 1, 12).astype(int)]
    control = pd.DataFrame({"tie": chosen.index, "reflectance": chosen, "std": 0.002})
    return block, truth, adjust_block(seen, control=control, radial=(block.flight.radial, 0.01))


def test_a_block_without_disturbances_shows_the_ground():
    flight = Flight(strips=2, images=3, gain_std=0.0, radial=0.0, haze=0.0)
    table = fly_block(flight, seed=1).observations
    table = table[table["view_zenith_deg"] < 6]
    seen = table["radiance"] / np.cos(np.radians(table["sun_zenith_deg"]))
    ratio = seen / table["reference"]
    # within 6 degrees of nadir Walthall's odd term is up to 4 % of the strongest surface
    assert abs(ratio.median() - 1) < 0.02
    assert ratio.between(0.93, 1.07).mean() > 0.98


def test_adjusted_block_has_the_true_anisotropy_gains_and_reflectances(flown):
    block, truth, found = flown
    true = SURFACES.set_index("surface").loc[found.anisotropy["surface"]]
    assert np.abs(found.anisotropy["b2"].to_numpy() - true["b2"].to_numpy()).max() < 0.03
    ratio = found.gains["gain"].to_numpy() / block.stations["gain"].to_numpy()
    assert np.std(ratio / ratio.mean()) < 0.005
    assert np.abs(found.ties.set_index("tie")["reflectance"] / truth - 1).median() < 0.01


def test_haze_brightens_dark_ground_more():
    hazy, clean = ATMOSPHERES["hazy"], ATMOSPHERES["clean"]
    dark, bright = (hazy.radiance(rho) / clean.radiance(rho) for rho in (0.03, 0.5))
    assert dark > bright


def test_wedge_saturates_only_where_it_should():
    darkest, brightest = (image_radiometry.SETTINGS[k] for k in (4, 3))
    for setting, some in ((darkest, False), (brightest, True)):
        targets = image_radiometry.wedge_targets(0.0, 1, [setting])[0]
        assert (image_radiometry.calibrated(targets).saturated > 0) == some


def test_stability_grows_with_the_error_of_recorded_exposures():
    means = []
    for exposure_std in (0.0, 0.01, 0.03):
        targets, _ = image_radiometry.wedge_targets(exposure_std, 1)
        groups = targets.groupby("setting")
        fits = {name: image_radiometry.calibrated(rows) for name, rows in groups}
        means.append(stability(fits, [20, 40, 80])["difference_percent"].mean())
    assert means[0] < 0.1
    # the same draws, three times as large
    assert means[2] / means[1] == pytest.approx(3, rel=0.15)


def test_a_field_has_the_published_targets():
    field, surfaces = image_radiometry.field("clean", "green", 0.0, 1)
    assert field.references["reflectance"].tolist() == [0.2, 0.3, 0.5]
    reference = surfaces["reference"]
    assert reference.tolist()[:4] == [0.057, 0.181, 0.261, 0.442]
    assert set(image_radiometry.class_errors(reference, surfaces).values()) == {0.0}
    worse = image_radiometry.class_errors(1.1 * reference, surfaces)
    assert list(worse.values()) == pytest.approx([10.0] * 4)


@pytest.mark.parametrize("air", ["clean", "hazy"])
def test_equation_4_with_the_true_air_gives_the_true_reflectances(air):
    field, surfaces = image_radiometry.field(air, "green", 0.0, 1)
    found = image_radiometry.equation_4(field) / surfaces["reference"].to_numpy()
    assert np.median(found) == pytest.approx(
        1, abs=0.002
    )  # without the air's albedo 1.007 and 1.03


def test_methods_of_ones_own_on_both_benches():
    one = image_resolution.METHODS["Gaussian sigmoid"]
    mine = {"library": one, "mine": lambda patch: 1.1 * one(patch)["mtf50"]}
    results = image_resolution.bench(mine, mtf50s=(0.25,), noises=(0.01,), seeds=(0,)).run()
    library, own = results["mtf50_error_percent"].sel({"method": ["library", "mine"]}).values
    # 1.1 (1 + e) - 1 = 0.1 + 1.1 e
    assert own == pytest.approx(10 + 1.1 * library)
    true = {"true": lambda field: np.array([*image_radiometry.surfaces_of("red")["reference"]])}
    results = image_radiometry.bench(true, airs=("clean",), seeds=(0,)).run()
    assert float(results["uniform_percent"].sel(band="red").max()) == 0
    assert float(results["uniform_percent"].sel(band="green").min()) > 5


def test_the_simplest_rule_is_right_where_its_assumption_is():
    """A Gaussian behind the pixel is about a Gaussian: the rise says its MTF50 within 1 %."""
    patch, truth = image_resolution.edge_patch("gaussian", 0.1, noise=1e-6, seed=1)
    errors = image_resolution.edge_errors(image_resolution.rise(patch), truth)
    assert abs(errors["mtf50_error_percent"]) < 1


def test_edges_agree_with_other_tools_on_real_photographs(real):
    real("images/slanted_edge.tif")
    for name in image_resolution.REAL_EDGES:
        patch, truth = image_resolution.real_patch(name)
        found = image_resolution.METHODS["curve through bins"](patch)
        # the other tools' figures are known to two or three digits
        assert found["mtf50"] == pytest.approx(truth["mtf50"], rel=0.03)


def test_checks_of_both_notebooks_fail_with_other_numbers():
    """Each check, with numbers that would make its statement false and with the true ones."""
    false = {"off": 3.0, "wrong": 0.1, "narrow": 2.0, "wide": 0.5, "logistic": -5.0}
    assert len(spoiled("image_resolution", false | {"largest": 0.1, "taken": 20})) == 5
    true = {"off": 0.2, "wrong": -5.0, "narrow": 0.5, "wide": 2.0, "logistic": -13.0}
    assert not spoiled("image_resolution", true | {"largest": 0.01, "taken": 20})
    false = {"shares": pd.Series({"gain_z": 0.5, "offset_z": 0.9}), "slack": 0.04, "obtained": ""}
    false |= {"with_it": 2.0, "without": 1.0, "before": 5.0, "after": 1.0, "off": 3.0}
    assert len(spoiled("image_radiometry", false)) == 5
    true = {"shares": pd.Series({"gain_z": 0.95, "offset_z": 0.96}), "slack": 0.04, "obtained": ""}
    true |= {"with_it": 0.1, "without": 4.0, "before": 5.0, "after": 0.2, "off": 1.0}
    assert not spoiled("image_radiometry", true)


def test_strips_overlap_as_stated_and_are_flown_there_and_back(rng):
    made = blocks._stations(Flight(strips=3, images=5), rng)
    x, y = (made[name].to_numpy().reshape(3, 5) for name in ("centre_x_m", "centre_y_m"))
    assert x[0] == pytest.approx(blocks.WIDTH_M / 2)
    aside, along = np.diff(x, axis=0), np.diff(y, axis=1)
    assert 1 - aside / blocks.WIDTH_M == pytest.approx(blocks.SIDE_OVERLAP)
    base = blocks.FLIGHT_LENGTH_M * np.array([[1], [-1], [1]])
    assert 1 - along / base == pytest.approx(blocks.FORWARD_OVERLAP)
    assert y.min() == pytest.approx(blocks.FLIGHT_LENGTH_M / 2)
    assert made["image"].tolist() == [*range(15)]
    assert np.diff(made["sun_zenith_deg"]) == pytest.approx(0.5)  # from 40 to 47 degrees
