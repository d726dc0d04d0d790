"""The study of anisotropy: its sweep, comparisons, and checks that can fail."""

import numpy as np
import pytest

from mmqa_lab import plots
from mmqa_lab.simulate.point_patterns import KINDS, point_pattern
from mmqa_lab.spacing.directional import directional_spacing
from mmqa_lab.spacing.quadrants import spacing
from mmqa_lab.studies import anisotropy
from mmqa_lab.studies.anisotropy import drawings, sweeps

SMALL = {
    "ratios": (1, 5, 10),
    "angles": (0, 30),
    "counts": (300,),
    "noises_mm": (0.5, 3),
    "seeds": (1, 2),
}


@pytest.fixture(scope="module")
def dataset():
    """A small sweep."""
    return sweeps.compute(**SMALL, density=3000.0)


@pytest.fixture
def ax():
    """Axes of a figure that is closed again."""
    figure, axes = plots.subplots()
    yield axes
    plots.plt.close(figure)


def test_sweep_has_every_pattern_and_its_units(dataset):
    sizes = {"pattern": len(KINDS), "ratio": 3, "angle": 2, "n": 1, "noise": 2, "seed": 2}
    assert dict(dataset.sizes) == sizes
    assert dataset["d1"].attrs["units"] == "mm"
    assert dataset["angle"].attrs["units"] == "degrees"
    assert np.isfinite(dataset["f"]).all()


def test_a_cell_of_the_sweep_is_that_pattern(dataset):
    choices = {"ratio": 5, "angle": 30, "noise": 0.0005, "density": 3000}
    xy = point_pattern("scan_lines", size=np.sqrt(0.1), seed=2, **choices)
    where = {"pattern": "scan_lines", "ratio": 5, "angle": 30, "n": 300, "noise": 0.5, "seed": 2}
    cell = dataset.sel(where)
    assert float(cell["f"]) == spacing(xy).f
    assert float(cell["g"]) == directional_spacing(xy).g
    assert float(cell["true_ratio"]) == 5


def test_interval_is_students_t(dataset):
    cell = {"pattern": "poisson", "ratio": 1, "angle": 0, "n": 300, "noise": 3}
    first, second = dataset["f"].sel(cell).to_numpy()
    found = sweeps.summary(dataset)["f"].sel(cell)
    # t for one degree of freedom is 12.706; the standard error of two is half their difference
    half = 12.706 * abs(first - second) / 2
    mean = (first + second) / 2
    assert found.to_numpy() == pytest.approx([mean, mean - half, mean + half], rel=1e-4)


def test_rank_correlation_against_pandas_and_pairs(dataset):
    ranks = sweeps.rank_correlations(dataset, draws=20).set_index("name")
    table = dataset[["g", "true_ratio"]].to_dataframe()
    by_pandas = table.rank().corr().loc["g", "true_ratio"]
    assert ranks.loc["g", "rank_correlation"] == pytest.approx(by_pandas)
    g, truth = table["g"].to_numpy(), table["true_ratio"].to_numpy()
    apart = truth[:, None] > truth
    right = (g[:, None] > g)[apart].mean()
    assert ranks.loc["g", "right_order"] == pytest.approx(right)
    assert ranks.loc["g", "low"] <= ranks.loc["g", "rank_correlation"] <= ranks.loc["g", "high"]


def test_closed_forms_of_at_least_four_patterns():
    forms = sweeps.closed_forms(ratios=(8,), repeats=5)
    assert forms["pattern"].nunique() >= 4
    assert (forms["z"].abs() < 3).all()


def test_the_road_patch_has_two_heads_and_their_union():
    clouds = sweeps.real_clouds()
    sizes = [len(clouds[f"road, {name}"]) for name in ("head A", "head B", "both heads")]
    assert sizes[:2] == [12265, 6373]
    assert max(sizes[:2]) < sizes[2] < sum(sizes[:2])  # places that both heads hit count once


def test_checks_fail_where_f_is_no_longer_what_was_said(dataset):
    """Checks pass on the sweep, and the ordering fails once f and g are exchanged."""
    choices = {"density": 3000, "size": 1, "seed": 1, "ratio": 10, "noise": 5e-4}
    lines = sweeps.turns({"noise 0.5 mm": point_pattern("scan_lines", **choices)}, step=45)
    real = sweeps.turns(
        {name: xy for name, xy in sweeps.real_clouds().items() if name.startswith("road")}, step=45
    )
    forms = sweeps.closed_forms(ratios=(8,), repeats=5)
    ranks = sweeps.rank_correlations(dataset, draws=20)
    assert all(check.passed for check in anisotropy.checks(dataset, ranks, forms, lines, real))
    swapped = dataset.assign(f=dataset["g"], g=dataset["f"])
    worse = sweeps.rank_correlations(swapped, draws=20)
    broken = [c for c in anisotropy.checks(swapped, worse, forms, lines, real) if not c.passed]
    assert any("orders the patterns" in check.statement for check in broken)
    assert any("axes" in check.statement for check in broken)


def test_drawings_take_and_return_axes(dataset, ax):
    assert drawings.draw_map(dataset, "g", ax=ax, angle=30, noise=0.5) is ax
    written = {float(text.get_text()) for text in ax.texts}
    mean = float(dataset["g"].sel(pattern="lattice", ratio=5, angle=30, noise=0.5).mean())
    assert round(mean, 1) in written


def test_explorer_draws_what_its_controls_say():
    few, many = (drawings.figure_of_pattern("scan_lines", a, 20, 0.5, 400) for a in (2, 8))
    titles = [figure.axes[2].get_title() for figure in (few, many)]
    assert titles[0] != titles[1]
    assert all("along 20°" in title or "along 19°" in title for title in titles)
    for figure in (few, many):
        plots.plt.close(figure)
