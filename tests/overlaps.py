"""Finds what one cannot read in a figure: texts on texts, names twice, lines alike in grey."""

import itertools
import json
from pathlib import Path

from matplotlib.colors import to_rgb

from mmqa_lab import widgets
from mmqa_lab.run import Run

TOUCHING_PX = 1.5
"""Boxes of texts include the room of letters that are not there; so much of it may be shared."""


def overlapping_texts(figure):
    """A sentence for each pair of texts that overlap, and for each that leaves the figure."""
    figure.draw_without_rendering()
    hidden = _ticks_out_of_view(figure)
    texts = [text for text in figure.findobj(_is_shown_text) if text not in hidden]
    shown = [(text, text.get_window_extent()) for text in texts if text.get_text().strip()]
    edge = figure.bbox.padded(1.0)
    found = [
        f"{text.get_text()!r} leaves the figure"
        for text, box in shown
        if not (edge.contains(box.x0, box.y0) and edge.contains(box.x1, box.y1))
    ]
    for k, (text, box) in enumerate(shown):
        for other, there in shown[:k]:
            width = min(box.x1, there.x1) - max(box.x0, there.x0)
            height = min(box.y1, there.y1) - max(box.y0, there.y0)
            if width > TOUCHING_PX and height > TOUCHING_PX:
                found.append(f"{other.get_text()!r} and {text.get_text()!r} overlap")
    return found


def doubled_names(figure):
    """A sentence for each name that the legends of a figure give twice."""
    legends = [*figure.legends, *filter(None, (ax.get_legend() for ax in figure.axes))]
    names = [text.get_text() for legend in legends for text in legend.get_texts()]
    return [
        f"{name!r} is in the legend twice" for name in sorted(set(names)) if names.count(name) > 1
    ]


def alike_in_grey(figure):
    """A sentence for each two named lines of a panel that one cannot tell apart without colour."""
    found = []
    for ax in figure.axes:
        lines = [line for line in ax.lines if not str(line.get_label()).startswith("_")]
        for one, other in itertools.combinations(lines, 2):
            dark, light = sorted(grey(line.get_color()) for line in (one, other))
            if look(one) == look(other) and (light + 0.05) / (dark + 0.05) < 2:
                found.append(f"{one.get_label()!r} and {other.get_label()!r} are alike in grey")
    return found


def look(line):
    """What is seen of a line without its colour."""
    dashes = str(line._dash_pattern) if line.get_linestyle() != "None" else ""
    return dashes, str(line.get_marker()), line.get_markerfacecolor() == "none"


def grey(colour):
    """The relative luminance (WCAG 2.1) of a colour."""
    red, green, blue = (
        ((c + 0.055) / 1.055) ** 2.4 if c > 0.04 else c / 12.92 for c in to_rgb(colour)
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def watch(file):
    """Write what is found in every figure that a run saves or explores to a JSON file."""
    save_figure, explore, found = Run.save_figure, widgets.explore, {}

    def look_at(figure, name):
        if sentences := overlapping_texts(figure) + doubled_names(figure) + alike_in_grey(figure):
            found[name] = sentences
        Path(file).write_text(json.dumps(found), encoding="utf-8")

    def save(run, figure, name, **choices):
        save_figure(run, figure, name, **choices)
        look_at(figure, name)

    def explored(function, **controls):
        figure = explore(function, **controls)
        look_at(figure, f"explorer {function.__name__}")
        return figure

    Run.save_figure, widgets.explore = save, explored


def _is_shown_text(artist):
    """Whether an artist is a text that one can read, in axes that are shown.

    Slanting texts are left out: their upright boxes say little about where they are.
    """
    if not hasattr(artist, "get_fontsize") or not artist.get_visible():
        return False
    if artist.get_rotation() % 90:
        return False
    axes = artist.axes
    return axes is None or (axes.get_visible() and (axes.axison or artist in axes.texts))


def _ticks_out_of_view(figure):
    """Labels of ticks beyond the limits of their axis: they exist but are not drawn."""
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not low - slack <= tick.get_loc() <= high + slack:
                    hidden |= {tick.label1, tick.label2}
    return hidden
