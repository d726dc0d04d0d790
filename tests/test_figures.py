"""What every figure gets: letters of panels, lines that one can tell apart without colour."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from overlaps import doubled_names

from mmqa_lab import plots
from mmqa_lab._figures import finish_figure


@pytest.fixture
def figure():
    """Two panels in the house style, nine lines of nine colours, a picture with its colour bar."""
    with plots.style():
        figure, axes = plots.subplots(1, 2, width="double")
        for k, colour in enumerate((*plots.COLOURS.values(), "#777777")):
            axes[0].plot([0, 1, 2], np.arange(3) * k, color=colour, label=f"line {k}")
        axes[0].legend(loc="upper left", ncols=3)
        axes[0].set(title="lines", ylim=(-1, 40))
        figure.colorbar(axes[1].imshow(np.eye(3)), ax=axes[1], label="value")
        yield figure
    plt.close(figure)


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


def test_panels_have_letters_once_and_colour_bars_none(figure):
    for _ in range(2):
        finish_figure(figure)
    letters = [[text.get_text() for text in ax.texts] for ax in figure.axes]
    assert letters == [["(a)"], ["(b)"], []]
    single, ax = plots.subplots()
    finish_figure(single)
    assert not ax.texts
    plt.close(single)


def test_a_name_that_is_in_the_legend_twice_is_found():
    figure, ax = plots.subplots()
    ax.plot([1, 2], label="f")
    ax.legend()
    assert doubled_names(figure) == []
    ax.plot([2, 3], label="f")
    ax.legend()
    assert doubled_names(figure) == ["'f' is in the legend twice"]
    plt.close(figure)
