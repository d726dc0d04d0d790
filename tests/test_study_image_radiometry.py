"""The image-radiometry study: what it feeds its checks with, and that they can fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench
from mmqa_lab.radiometry import adjust_block, stability
from mmqa_lab.simulate.targets import ATMOSPHERES, SURFACES, Flight, fly_block
from mmqa_lab.stats import Interval
from mmqa_lab.studies import image_radiometry as study


@pytest.fixture(scope="module")
def flown():
    block = fly_block(Flight(strips=2), seed=3)
    seen = block.observations()
    truth = seen.drop_duplicates("tie").set_index("tie")["reference"].sort_values()
    chosen = truth.iloc[np.linspace(0, len(truth) - 1, 12).astype(int)]
    control = pd.DataFrame({"tie": chosen.index, "reflectance": chosen, "std": 0.002})
    radial = (block.flight.radial, 0.01)
    return block, adjust_block(seen, control=control, radial=radial)


def test_a_block_without_disturbances_shows_the_ground():
    flight = Flight(strips=2, images=3, gain_std=0.0, radial=0.0, haze=0.0)
    table = fly_block(flight, seed=1).observations()
    table = table[table["view_zenith_deg"] < 6]
    seen = table["radiance"] / np.cos(np.radians(table["sun_zenith_deg"]))
    ratio = seen / table["reference"]
    # within 6 degrees of nadir Walthall's odd term is up to 4 % of the strongest surface
    assert abs(ratio.median() - 1) < 0.02
    assert ratio.between(0.93, 1.07).mean() > 0.98


def test_adjusted_block_has_the_true_anisotropy_and_gains(flown):
    block, found = flown
    true = SURFACES.set_index("surface").loc[found.anisotropy["surface"]]
    assert np.abs(found.anisotropy["b2"].to_numpy() - true["b2"].to_numpy()).max() < 0.03
    ratio = found.gains["gain"].to_numpy() / block.stations["gain"].to_numpy()
    assert np.std(ratio / ratio.mean()) < 0.005


def test_mosaic_of_the_adjusted_block_is_the_ground(flown):
    block, found = flown
    truth = block.reflectance.ravel()
    even, raw = (np.corrcoef(study.mosaic(block, a).ravel(), truth)[0, 1] for a in (found, None))
    assert even > 0.999 > raw


def test_haze_brightens_dark_ground_more():
    dark, bright = (
        ATMOSPHERES["hazy"].radiance(r) / ATMOSPHERES["clean"].radiance(r) for r in (0.03, 0.5)
    )
    assert dark > bright


def test_wedge_saturates_only_where_it_should():
    darkest, brightest = study.SETTINGS[4], study.SETTINGS[3]
    assert study.calibrated(study.wedge_targets(0.0, 1, [darkest])[0]).saturated == 0
    assert study.calibrated(study.wedge_targets(0.0, 1, [brightest])[0]).saturated > 0


def test_stability_grows_with_the_error_of_the_labels():
    means = []
    for label_std in (0.0, 0.01, 0.03):
        targets, _ = study.wedge_targets(label_std, 1)
        fits = {name: study.calibrated(rows) for name, rows in targets.groupby("setting")}
        means.append(stability(fits, [20, 40, 80])["difference_percent"].mean())
    assert means[0] < 0.1
    # the same draws, three times as large
    assert means[2] / means[1] == pytest.approx(3, rel=0.15)


def test_a_field_has_the_published_targets():
    field, truth = study.field("clean", "green", 0.0, 1)
    assert field.references["reflectance"].tolist() == [0.2, 0.3, 0.5]
    reference = truth["surfaces"]["reference"]
    assert reference.tolist()[:4] == [0.057, 0.181, 0.261, 0.442]
    perfect = study.class_errors(reference, truth)
    assert set(perfect.values()) == {0.0}
    worse = study.class_errors(1.1 * reference, truth)
    assert list(worse.values()) == pytest.approx([10.0] * 4)


def test_the_comparison_takes_an_estimator_of_ten_lines():
    comparison = study.comparison(quick=True)
    one = comparison.methods["Gaussian sigmoid"]
    comparison.methods = {"Gaussian sigmoid": one, "mine": lambda patch: 1.1 * one(patch)["mtf50"]}
    comparison.cases, comparison.seeds = comparison.cases[:1], (0,)
    results = comparison.run()
    (table,) = comparison.tables(results).values()
    medians = table.set_index("method")["mtf50_error_percent_median"]
    # 1.1 (1 + e) - 1 = 0.1 + 1.1 e
    assert medians["mine"] == pytest.approx(10 + 1.1 * medians["Gaussian sigmoid"])
    (figure,) = comparison.figures(results).values()
    assert len(figure.axes) == 2


@pytest.fixture(scope="module")
def fed():
    """What the checks are fed with, small and made up: all of them pass."""
    rng = np.random.default_rng(1)
    errors = {"Gaussian sigmoid": (0.1, 0.1), "logistic sigmoid": (0.1, -13.0)}
    names = ("mtf50_error_percent", "fwhm_px_error_percent")
    edges = bench.run(
        [{"sigma_px": 1.0, "noise": 0.01}],
        {name: lambda _, e=e: dict(zip(names, e, strict=True)) for name, e in errors.items()},
        make=lambda sigma_px, noise, seed: 0,
    )
    stars = bench.run([{"n": 1}], {"full": lambda _: {"mtf_error": 0.01}}, make=lambda n, seed: 0)
    z = rng.standard_normal((400, 2))
    sensors = pd.DataFrame(z, columns=["gain_z", "offset_z"])
    sensors = sensors.assign(method="weighted, without saturated targets", label_std=0.0)
    reflectance = pd.DataFrame({"method": ["empirical line", "line, anisotropy ignored"]})
    reflectance = reflectance.assign(air="clean", reference_std=0.0, uniform_percent=[0.1, 4.0])
    block = pd.DataFrame({"adjustment": ["absolute"], "cv_before_percent": 5.0})
    block = block.assign(cv_after_percent=0.2, rmse_percent=0.5)
    return {"edges": edges, "stars": stars, "sensors": sensors, "reflectance": reflectance} | {
        "block": block
    }


def passed(fed):
    return [check.passed for check in study.checks(**fed)]


WRONG = {
    0: ("edges", lambda d: d + 0.95),  # 0.1 % becomes 1.05 %
    1: ("edges", lambda d: d * 0.5),  # -13 % becomes -6.5 %
    2: ("stars", lambda d: d * 3),
    3: ("sensors", lambda t: t.assign(gain_z=1.5 * t["gain_z"])),
    4: ("reflectance", lambda t: t.assign(uniform_percent=1.5)),
    5: ("block", lambda t: t.assign(cv_after_percent=1.0)),
}


@pytest.mark.parametrize("number", WRONG)
def test_each_check_can_fail(fed, number):
    assert passed(fed) == [True] * 6
    name, change = WRONG[number]
    data = fed[name]
    if isinstance(data, pd.DataFrame):
        changed = change(data)
    else:
        figures = list(bench.figure_names(data))
        changed = data.assign({figure: change(data[figure]) for figure in figures})
    assert not passed(fed | {name: changed})[number]


def test_ledger_entries_are_cells_of_the_report_and_say_how_comparable_they_are():
    sensors = pd.DataFrame({"r_squared": [0.999], "offset_dn": [60.1], "offset_std_dn": [0.1]})
    classes = {"uniform_percent": 4.0, "bright_tarps_percent": 1.0, "black_tarp_percent": 2.0}
    methods = ["empirical line", "dark pixel", "equation 4"]
    laboratory = pd.DataFrame(
        {"target_class": ["black tarp", "bright tarps"], "low": 11, "high": 22}
    )
    rows = study.ledger_entries(
        corner=Interval(1.5, 1.4, 1.6, 100),
        sensors=sensors,
        stable=pd.Series([3.0, 4.0]),
        reflectance=pd.DataFrame({"method": methods, **classes}),
        laboratory=laboratory,
    )
    found = pd.DataFrame(rows).set_index("cell")
    assert len(found) == 20
    # half the diagonal of 166 mm x 92 mm behind 120 mm
    angle = np.degrees(np.arctan(np.hypot(165.888, 92.16) / 240))
    assert found.loc["brf_view_angles", "value"] == pytest.approx(angle)
    assert (found["note"] != "").all()
    assert found.loc["corner_factor", ["low", "value", "high"]].tolist() == [1.4, 1.5, 1.6]
    assert found.loc["dmc_intercept", "value"] == pytest.approx(0.1)
    assert found.loc["theoretical_resolution", "value"] == pytest.approx(1 / 0.012)
    fitted = found.index[found["kind"] == "fitted"]
    assert len(fitted) == 6
    assert all(cell.startswith("stability_") for cell in fitted)


def test_edge_method_agrees_with_other_tools_on_real_photographs(real):
    real("images/slanted_edge.tif")
    for name in study.REAL_EDGES:
        patch, truth = study.real_patch(name)
        # the other tools' figures are known to two or three digits
        assert study.METHODS["edge method, binned"](patch) == pytest.approx(
            truth["mtf50"], rel=0.03
        )
