"""What every figure gets: letters of panels, lines that one can tell apart without colour."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from overlaps import alike_in_grey, doubled_names, overlapping_texts
from PIL import Image

from mmqa_lab import __version__, plots
from mmqa_lab._figures import finish_figure
from mmqa_lab.commands._output import write_figure


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


def test_lines_are_told_apart_without_colour(figure):
    assert len(alike_in_grey(figure)) > 5
    finish_figure(figure)
    assert alike_in_grey(figure) == []
    assert overlapping_texts(figure) == []


def test_bars_dots_and_error_bars_are_told_apart_without_colour():
    figure, axes = plots.subplots(1, 3, width="double")
    for k, colour in enumerate(("#0072B2", "#D55E00", "#009E73")):
        axes[0].bar([k], [1 + k], color=colour, label=f"bar {k}")
        axes[1].scatter([0, 1], [k, k], color=colour, label=f"dots {k}")
        axes[2].errorbar([0, 1], [k, k], 0.3, fmt="o", capsize=2, color=colour, label=f"error {k}")
    for ax in axes:
        ax.legend()
    assert len(alike_in_grey(figure)) == 9
    finish_figure(figure)
    assert alike_in_grey(figure) == []
    ends = [line.get_marker() for line in axes[2].lines if line.get_marker() == "_"]
    assert len(ends) == 6  # those of the error bars stay
    plt.close(figure)


def test_a_name_looks_the_same_in_all_panels():
    figure, axes = plots.subplots(1, 2)
    for ax, names in zip(axes, ("abc", "ac"), strict=True):
        for name, colour in zip("abc", ("#0072B2", "#D55E00", "#009E73"), strict=True):
            if name in names:
                ax.bar(0, 1, color=colour, label=name)
    finish_figure(figure)
    looks = [{one.get_label(): one[0].get_hatch() for one in ax.containers} for ax in axes]
    assert looks[0]["c"] == looks[1]["c"] != looks[0]["b"]
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


def test_the_legend_shows_the_lines_as_they_are(figure):
    finish_figure(figure)
    ax = figure.axes[0]
    for line, shown in zip(ax.lines, ax.get_legend().legend_handles, strict=True):
        assert shown.get_marker() == line.get_marker()
        assert shown._dash_pattern == line._dash_pattern


def test_in_a_grey_picture_the_lines_differ(figure):
    """The pixels of two lines that were alike are at other places along the same course."""
    ax = figure.axes[0]
    ax.clear()
    ax.set_axis_off()
    drawn = []
    for colour in ("#0072B2", "#D55E00"):
        ax.plot([0, 1], [0, 0], color=colour, label=colour)
    finish_figure(figure)
    for line in ax.lines:
        line.set_color("black")
        line.set_visible(False)
    for line in ax.lines:
        line.set_visible(True)
        figure.canvas.draw()
        drawn.append(np.asarray(figure.canvas.buffer_rgba()).copy())
        line.set_visible(False)
    assert np.abs(drawn[0].astype(int) - drawn[1]).max() > 100


def test_panels_have_letters_once_and_colour_bars_none(figure):
    for _ in range(2):
        finish_figure(figure)
    letters = [[text.get_text() for text in ax.texts] for ax in figure.axes]
    assert letters == [["(a)"], ["(b)"], []]
    single, ax = plots.subplots()
    finish_figure(single)
    assert not ax.texts
    plt.close(single)


def test_marks_alone_get_other_marks():
    figure, ax = plots.subplots()
    ax.plot([1, 2], [[1, 2, 3], [2, 3, 4]], "o", color="black", label=["a", "b", "c"])
    finish_figure(figure)
    assert len({line.get_marker() for line in ax.lines}) == 3
    assert {line.get_linestyle() for line in ax.lines} == {"None"}
    plt.close(figure)


def test_a_name_that_is_in_the_legend_twice_is_found():
    figure, ax = plots.subplots()
    ax.plot([1, 2], label="f")
    ax.legend()
    assert doubled_names(figure) == []
    ax.plot([2, 3], label="f")
    ax.legend()
    assert doubled_names(figure) == ["'f' is in the legend twice"]
    plt.close(figure)


def test_figures_of_commands_name_their_subject_and_version(figure, tmp_path):
    for ending in ("png", "pdf", "svg"):
        write_figure(tmp_path / f"f.{ending}", figure, title="Quality of c.laz")
    said = Image.open(tmp_path / "f.png").text
    assert said["Title"] == "Quality of c.laz"
    assert said["Creator"] == f"mmqa_lab {__version__}"
    assert b"Quality of c.laz" in (tmp_path / "f.pdf").read_bytes()
    assert b"Quality of c.laz" in (tmp_path / "f.svg").read_bytes()
    assert [text.get_text() for text in figure.axes[0].texts] == ["(a)"]
