"""The study of anisotropy: its bench, closed forms, real clouds, and checks that can fail."""

import numpy as np
import pandas as pd
import pytest

from mmqa_lab import bench, plots
from mmqa_lab.simulate.point_patterns import KINDS, point_pattern
from mmqa_lab.spacing import directional, exempt, quadrants
from mmqa_lab.studies import anisotropy as study

CASES = {"kind": KINDS, "stretch": (1, 5, 10), "angle": (0, 30), "n": 300, "noise_mm": (0.5, 3)}
RIGHT = {"f < 2": 0.4, "f < 2 or exempt": 0.7, "g < 2": 0.8}


@pytest.fixture(scope="module")
def results():
    """A small run of f and g."""
    methods = {name: study.METHODS[name] for name in ("f", "g")}
    return bench.run(bench.grid(**CASES), methods, make=study.pattern, seeds=(1, 2))


@pytest.fixture(scope="module")
def others():
    """The other tables that the checks look at."""
    choices = {"density": 3000, "size": 1, "seed": 1, "ratio": 10, "noise": 5e-4}
    road = {name: xy for name, xy in study.real_clouds().items() if name.startswith("road")}
    lines = {"noise 0.5 mm": point_pattern("scan_lines", **choices)}
    return {
        "forms": study.closed_forms(stretches=(8,), repeats=5),
        "lines": study.turns(lines, step=45),
        "real": study.turns(road, step=45),
        "verdicts": verdicts(RIGHT),
    }


def verdicts(right):
    """A run of rules that are right in the given shares of 40 cases, and never surely."""
    rules = {
        name: lambda data, share=share: {"right": data < 40 * share}
        for name, share in right.items()
    }
    return bench.run(
        bench.grid(case_number=range(40)), rules, make=lambda case_number, seed: case_number
    )


def failed(results, others, **changed):
    """The statements that do not hold."""
    checks = study.checks(results=results, **(others | changed))
    return [check.statement for check in checks if not check.passed]


def test_a_cell_of_the_bench_is_that_pattern(results):
    choices = {"ratio": 5, "angle": 30, "noise": 0.0005, "density": 3000}
    xy = point_pattern("scan_lines", size=np.sqrt(0.1), seed=2, **choices)
    where = {"kind": "scan_lines", "stretch": 5, "angle": 30, "noise_mm": 0.5, "seed": 2}
    cell = results.sel(where).squeeze()
    assert float(cell["value"].sel({"method": "f"})) == quadrants(xy).f
    assert float(cell["value"].sel({"method": "g"})) == directional(xy).g
    assert float(cell["truth_ratio"]) == 5


def test_every_measure_of_the_comparison_gives_a_number():
    comparison = study.comparison(quick=True)
    xy, truth = comparison.make(**comparison.cases[0], seed=1)
    assert truth == {"ratio": 1.0}
    for name, method in comparison.methods.items():
        assert np.isfinite(method(xy)), name


def test_a_method_of_ones_own_enters_the_studys_table_and_figure():
    comparison = study.comparison(quick=True)
    comparison.methods = {"f": comparison.methods["f"], "mine": len}
    comparison.cases = comparison.cases[:6]
    results = comparison.run()
    (table,) = comparison.tables(results).values()
    assert set(table["method"]) == {"f", "mine"}
    (figure,) = comparison.figures(results).values()
    assert {label.get_text() for label in figure.axes[0].get_yticklabels()} == {"f", "mine"}
    plots.plt.close(figure)


def test_closed_forms_of_four_patterns():
    forms = study.closed_forms(stretches=(8,), repeats=5)
    assert forms["pattern"].nunique() == 4
    assert (forms["z"].abs() < 3).all()


def test_the_road_patch_has_two_heads_and_their_union():
    clouds = study.real_clouds()
    sizes = [len(clouds[f"road, {name}"]) for name in ("head A", "head B", "both heads")]
    assert sizes[:2] == [12265, 6373]
    assert max(sizes[:2]) < sizes[2] < sum(sizes[:2])  # places that both heads hit count once


def test_checks_pass_on_what_they_speak_of(results, others):
    assert failed(results, others) == []


def test_each_check_can_fail(results, others):
    forms = others["forms"].assign(z=4.0)
    assert "f has its closed form" in failed(results, others, forms=forms)[0]
    lines = others["lines"].assign(f=10.0)
    assert "axes follow the lines" in failed(results, others, lines=lines)[0]
    exchanged = results.assign(
        value=results["value"].isel({"method": [1, 0]}).assign_coords(results.coords)
    )
    assert any("g orders the patterns" in said for said in failed(exchanged, others))
    kinds = results["kind"].isin(["gradient", "holes"])
    uneven = results.assign(value=results["value"] * xr_where(kinds, 1.3, 1.0))
    assert any("gradients and holes" in said for said in failed(uneven, others))
    same = verdicts(dict.fromkeys(RIGHT, 0.4))
    assert "With the exemption" in failed(results, others, verdicts=same)[0]
    real = others["real"].assign(f=3.0)
    assert "Two crossing scan heads" in failed(results, others, real=real)[0]


def xr_where(condition, yes, no):
    """Numbers by a condition."""
    return condition.astype(float) * (yes - no) + no


def test_a_random_cloud_is_exempt_once_it_is_dense():
    for share, accepted in ((1, False), (4, True)):
        size = np.sqrt(2000 / (share * 3000))
        xy = point_pattern("poisson", density=share * 3000, size=size, seed=1)
        d1, _, _, d4 = quadrants(xy).d
        assert exempt(d1, d4, 3000) == accepted


def test_the_answer_has_the_runs_numbers(others):
    ranks = pd.DataFrame({"method": ["g", "f"], "spearman": [0.81, 0.42]})
    said = study.answer(ranks, others["verdicts"])
    for number in ("0.42", "0.81", "40 %", "70 %", "80 %"):
        assert number in said
