"""Study 03: its bench, closed forms, real clouds, and checks that can fail."""

import numpy as np
import pandas as pd
import pytest
from conftest import spoiled

from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.spacing import directional, exempt, quadrants
from mmqa_lab.studies import anisotropy as study

SMALL = {"stretches": (5,), "angles": (30,), "counts": (300,), "noises_mm": (0.5,), "seeds": (2,)}


def test_a_cell_of_the_bench_is_that_pattern_and_takes_a_method_of_ones_own():
    methods = {"f": study.METHODS["f"], "g": study.METHODS["g"], "mine": len}
    bench = study.bench(methods=methods, kinds=("scan_lines", "poisson"), **SMALL)
    results = bench.run()
    choices = {"ratio": 5, "angle": 30, "noise": 0.0005, "density": 3000}
    xy = point_pattern("scan_lines", size=np.sqrt(0.1), seed=2, **choices)
    cell = results.sel(kind="scan_lines").squeeze()
    assert float(cell["value"].sel({"method": "f"})) == quadrants(xy).f
    assert float(cell["value"].sel({"method": "g"})) == directional(xy).g
    assert float(cell["value"].sel({"method": "mine"})) == len(xy)
    assert float(cell["truth_ratio"]) == 5
    (table,) = bench.tables(results).values()
    assert set(table["method"]) == set(methods)


def test_every_measure_gives_a_number():
    xy, truth = study.pattern("poisson", 5, 30, 300, 0.5, seed=1)
    assert truth == {"ratio": 1.0}
    for name, method in study.METHODS.items():
        assert np.isfinite(method(xy)), name


def test_the_road_patch_has_two_heads_and_their_union():
    clouds = study.real_clouds()
    sizes = [len(clouds[f"road, {name}"]) for name in ("head A", "head B", "both heads")]
    assert sizes[:2] == [12265, 6373]
    assert max(sizes[:2]) < sizes[2] < sum(sizes[:2])  # places that both heads hit count once


def test_a_random_cloud_is_exempt_once_it_is_dense():
    for share, accepted in ((1, False), (4, True)):
        size = np.sqrt(2000 / (share * 3000))
        xy = point_pattern("poisson", density=share * 3000, size=size, seed=1)
        d1, _, _, d4 = quadrants(xy).d
        assert exempt(d1, d4, 3000) == accepted


def test_each_check_can_fail():
    ranks = pd.DataFrame({"spearman": [0.8, 0.4], "behind_low": [0.0, 0.1]}, ["g", "f"])
    rules = ["e95 ≤ √(1/ρ0)", "g < 2", "f < 2 or exempt", "g < 2 or exempt"]
    ends = {"low": [0.8, 0.4, 0.8, 0.4], "high": [0.9, 0.5, 0.9, 0.5]}
    of_5 = pd.DataFrame({"balanced": [0.85, 0.45, 0.85, 0.45]} | ends, rules)
    heads = pd.DataFrame({"f_smallest": [3.0, 2.9], "f_largest": [3.6, 3.0]})
    whole = {
        "worst": 1.2,
        "distinct": range(13),
        "repeats": 30,
        "uneven": 1.01,
        "pair": ranks,
        "noisy": pd.Series({0.0: 5.7, 45.0: 10.8}),
        "of_5": of_5,
        "heads": heads,
        "both": pd.Series({"f_smallest": 2.2, "f_largest": 2.2}),
        "first": 0.8,
        "second": 0.4,
        "best": rules[0],
        "apart": "intervals apart",
        "of_f": of_5.loc[rules[2]],
        "of_g": of_5.loc[rules[3]],
        "least": 2.9,
    }
    assert spoiled("anisotropy", whole) == []
    changes = {
        "On lattices, scan lines": {"worst": 5.0},
        "f of noisy scan lines": {"noisy": pd.Series({0.0: 10.8, 45.0: 10.8})},
        "f does not see": {"uneven": 1.3},
        "g orders": {"pair": ranks[::-1]},
        "For details of 5 cm e95": {"of_5": of_5.assign(low=[0.4, 0.4, 0.8, 0.4])},
        "For details of 5 cm f": {"of_f": of_5.loc[rules[3]]},
        "Two crossing": {"both": heads.iloc[0]},
    }
    for words, change in changes.items():
        (failed,) = spoiled("anisotropy", whole | change)
        assert failed.startswith(words)


def test_a_fetched_wall_is_a_real_cloud(monkeypatch, tmp_path):
    monkeypatch.setenv("MMQA_CACHE", str(tmp_path))
    assert study.yard() == {}
    xy = np.stack(np.meshgrid(np.arange(0, 9, 0.3), np.arange(0, 9, 0.03)), axis=-1).reshape(-1, 2)
    wall = np.column_stack([xy[:, 1] - 4, np.full(len(xy), study.YARD_M[1]), xy[:, 0]])
    np.savetxt(tmp_path / "sweep.xyz", wall)
    monkeypatch.setattr(study.samples, "has_real", lambda name: name == "hdl32e_target")
    monkeypatch.setattr(study.samples, "real_path", lambda name: tmp_path / "sweep.xyz")
    xy = study.real_clouds()["wall, 32 beams"]
    assert np.ptp(xy, axis=0) == pytest.approx([8.7, 2], abs=0.1)
    assert study.METHODS["f"](xy) == pytest.approx(10, rel=0.1)
