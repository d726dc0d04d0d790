"""What every figure gets: letters of panels, symbols set as formulas."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from overlaps import doubled_names, overlapping_texts

from mmqa_lab import plots
from mmqa_lab.plots import finish_figure, laid_out


def test_symbols_are_set_as_formulas_by_one_rule():
    figure, ax = plots.subplots()
    ax.bar(["d1", "f", "sigma_mad"], [1, 2, 3])
    ax.set(xlabel="f = d4/d1 and g", ylabel="sigma_MAD (mm)", title="f(x) of two_heads, wolf")
    finish_figure(figure)
    ticks = [text.get_text() for text in ax.get_xticklabels()]
    assert ticks == ["$d_1$", "$f$", r"$\sigma_\mathrm{MAD}$"]
    assert ax.get_xlabel() == "$f$ = $d_4$/$d_1$ and $g$"
    assert ax.get_ylabel() == r"$\sigma_\mathrm{MAD}$ (mm)"
    assert ax.get_title() == "f(x) of two heads, wolf"
    plt.close(figure)


def test_panels_have_letters_once_and_colour_bars_none():
    figure, axes = plots.subplots(1, 2)
    figure.colorbar(axes[1].imshow(np.eye(3)), ax=axes[1])
    for _ in range(2):
        finish_figure(figure)
    letters = [[text.get_text() for text in ax.texts] for ax in figure.axes]
    assert letters == [["(a)"], ["(b)"], []]
    single, ax = plots.subplots()
    finish_figure(single)
    assert not ax.texts
    plt.close("all")


def test_a_name_that_is_in_the_legend_twice_is_found():
    figure, ax = plots.subplots()
    ax.plot([1, 2], label="f")
    ax.legend()
    assert doubled_names(figure) == []
    ax.plot([2, 3], label="f")
    ax.legend()
    assert doubled_names(figure) == ["'f' is in the legend twice"]
    plt.close(figure)


LONG = {"x": np.arange(10_000, 10_012), "y": np.arange(20)}


@pytest.mark.parametrize("along", LONG)
def test_labels_of_ticks_that_overlap_get_smaller_and_others_stay(along):
    with plt.style.context(plots.STYLE):
        figure, ax = plots.subplots(height_mm=50)
        ax.set(**{f"{along}ticks": LONG[along], f"{along}lim": LONG[along][[0, -1]]})
        other = {"x": ax.yaxis, "y": ax.xaxis}[along]
        before = other.get_majorticklabels()[0].get_fontsize()
        assert overlapping_texts(figure)
        with laid_out(figure):
            assert overlapping_texts(figure) == []
            assert other.get_majorticklabels()[0].get_fontsize() == before
    plt.close(figure)


@pytest.mark.parametrize("projection", ["polar", "3d"])
def test_axes_without_x_and_y_are_laid_out_as_they_are(projection):
    figure = plt.figure(layout="constrained")
    figure.add_subplot(projection=projection)
    with laid_out(figure):
        assert figure.get_layout_engine() is None
    plt.close(figure)
