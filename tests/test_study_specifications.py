"""Study 10: fits of known truth, arithmetic on Table 2, checks that can fail."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.studies import specifications as study

PUBLISHED = study.table_2()


def test_printed_d1_of_a_ask_for_seven_thousand_pulses_a_revolution():
    """Table 2: along a line d1 is range x 2 pi / pulses."""
    rows = PUBLISHED.query("system == 'A'")
    turn = 2 * np.pi * 1000 * rows["distance_m"]
    ends = (turn / (rows["d1_mm"] + 0.5)).max(), (turn / (rows["d1_mm"] - 0.5)).min()
    assert np.round(ends).tolist() == [6981, 7392]


def test_at_10_m_c_has_two_points_for_each_pixel_of_its_panorama():
    """Table 1: 8.2 mm x 7.9 mm; Table 2: 30,915 per square metre."""
    pixels = 1e6 / (8.2 * 7.9)
    density = PUBLISHED.query("system == 'C' and distance_m == 10")["density_per_m2"].item()
    assert density / pixels == pytest.approx(2.0, abs=0.05)


def test_fit_finds_the_parameters_that_made_a_table():
    truth = {"tilt_deg": 50.0, "height_m": 0.4, "mirror_frequency_hz": 150.0}
    figures = study.closed_form(pd.DataFrame([truth]))
    target = pd.DataFrame(figures[0], columns=study.FITTED)
    bounds = study.FITS[1][2]
    best, misfit = study.search(study.closed_form, bounds, target, seed=1, candidates=1000)
    assert misfit < 0.2
    assert best["mirror_frequency_hz"] == pytest.approx(150, rel=0.02)
    assert best["tilt_deg"] == pytest.approx(50, abs=2)


def test_misfits_are_in_tolerances():
    rows = PUBLISHED.query("system == 'C'").set_index("distance_m")[list(study.FIGURES)]
    off = rows + np.hypot([0.5, 0.05, 0.5, 0.5, 0.05], 0.02 * rows)
    tables = {"exact": rows, "off": off}

    def method(name):
        return lambda drive: tables[name].loc[drive[0]].to_dict()

    bench = study.bench(seeds=(0,))
    bench.methods, bench.score = {name: method(name) for name in tables}, None
    found = study.misfits(bench.run()).groupby("model")["misfit"].first()
    assert found["exact"] == pytest.approx(0, abs=1e-12)
    assert found["off"] == pytest.approx(1)


def test_noise_of_c_gives_both_published_precisions():
    noise = study.fitted_noise("C", {}, PUBLISHED.query("system == 'C'"), seed=1)
    camera = study.SENSORS["C"]
    for distance, expected in ((5, 14), (10, 23)):
        stereo = distance**2 / (camera.base_m * camera.focal_px) * noise["noise_px"]
        assert 1000 * np.hypot(stereo, noise["floor_m"]) == pytest.approx(expected)


@pytest.fixture(scope="module")
def comparison():
    """Table 2 with made-up predictions and fits."""
    rows = PUBLISHED.drop(columns="density_per_m2_printed")
    usual = rows[rows["system"] != "C"].copy()
    usual["density_per_m2"] *= 1.5
    for name in ("tilt_deg", "height_m"):
        usual[name] = [study.USUAL[system][name] for system in usual["system"]]
    low = usual.assign(density_per_m2=usual["density_per_m2"] / 2, height_m=9)
    free = [rows.assign(fit="free", f=rows["f"] + 0.1 * k, seed=k) for k in (-1, 1)]
    stated = [each.query("system == 'A'").assign(fit="stated", d1_mm=5.0) for each in free]
    return study.compare(pd.concat([usual, low]), pd.concat([*free, *stated]))


def test_comparison_keeps_kinds_apart_and_gaps_open(comparison):
    assert len(comparison) == 30
    assert comparison["published"].notna().all()
    assert not any("reproduced" in column for column in comparison)
    assert (comparison["predicted"].isna() == (comparison["system"] == "C")).all()
    rows = comparison.set_index(["system", "distance_m", "figure"])
    f = rows.loc["A", 10, "f"]
    # t of one degree of freedom is 12.706; one further pass beside the mean of two
    reach = 12.706 * 0.1 * 2**0.5 * 1.5**0.5
    assert f["fitted"] == pytest.approx(5.1)
    assert f["fitted_high"] - f["fitted"] == pytest.approx(reach, rel=1e-4)
    density = rows.loc["B", 5, "density_per_m2"]
    assert (density["predicted"], density["predicted_low"]) == (3140 * 1.5, 3140 * 0.75)
    d1 = rows.loc["A", 5, "d1_mm"]
    assert (d1["fitted"], d1["fitted_stated"]) == (4, 5)


def test_each_check_can_fail(comparison):
    names = ["system", "fit", "parameter", "fitted", "misfit"]
    rows = [("A", "free", "mirror_frequency_hz", 1e6 / 7000, 0.6), ("B", "free", "tilt_deg", 38, 2)]
    models = ["one pair", "pairs fused", "thinned in space", "resampled on the surface"]
    excess = comparison.query("system == 'B' and figure == 'density_per_m2'")["predicted"]
    wrong = pd.Series([20.0, 3.0, 4.0, 1.2], models)
    whole = {
        "fits": pd.DataFrame(rows, columns=names).set_index(names[:3]),
        "pulses": 7000.0,
        "before": 6.0,
        "after": 1.6,
        "pitch": 38.0,
        "capped": 3390.0,
        "repeats": 4,
        "repeats_percent": 0.8,
        "excess": 0 * excess + 50,
        "wrong": wrong,
        "others": wrong.drop(models[3]),
    }
    assert spoiled("specifications", whole) == []
    changes = {
        "At 1 MHz": {"capped": 4629.0},
        "Without the stated": {"after": 4.0},
        "Upright": {"excess": excess * 0},
        "One stereo pair": {"wrong": wrong.replace(20.0, 1.0)},
    }
    for words, change in changes.items():
        (failed,) = spoiled("specifications", whole | change)
        assert failed.startswith(words)


def test_candidates_of_b_pass_at_both_distances_and_those_of_c_at_5_m(monkeypatch):
    asked = []

    def measured(cases, seeds):
        asked.append((cases, seeds))
        return pd.DataFrame({name: cases["distance_m"] + k for k, name in enumerate(study.FITTED)})

    monkeypatch.setattr(study, "measure", measured)
    values = pd.DataFrame({"tilt_deg": [1.0, 2.0, 3.0]})
    found = study.simulated(values, system="B", seed=4)
    assert found.shape == (3, 2, len(study.FITTED))
    assert found[:, 0, 0].tolist() == [5, 5, 5]
    assert found[:, 1, 1].tolist() == [11, 11, 11]
    assert asked[0][1] == [4]
    assert asked[0][0]["tilt_deg"].tolist() == [1, 1, 2, 2, 3, 3]
    assert study.simulated(values, system="C", seed=4).shape == (3, 1, len(study.FITTED))


def test_noise_of_a_scanner_is_scaled_to_the_published_precision(monkeypatch):
    read = pd.DataFrame({"precision_mm": [2.0, 4.0]})
    monkeypatch.setattr(study, "measure", lambda *_, **__: read)
    target = pd.DataFrame({"precision_mm": [6.0, 9.0]})
    found = study.fitted_noise("A", {}, target, seed=1)
    assert found == {"range_noise_m": pytest.approx(2.5 * study.SENSORS["A"].range_noise_m)}
