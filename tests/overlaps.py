"""Finds what one cannot read in a figure: texts on texts, names twice, lines alike in grey."""

import json
from pathlib import Path

import matplotlib.pyplot as plt

from mmqa_lab import widgets
from mmqa_lab.run import Run, results

TOUCHING_PX = 1.5
"""Boxes of texts include the room of letters that are not there; so much of it may be shared."""

DRAWINGS = ("chart", "frame")
"""Figures that show no numbers of any kind."""


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


def of_no_kind(figure, name):
    """A sentence for a figure that does not say which kind of numbers it shows."""
    said = " ".join(text.get_text() for text in figure.findobj(plt.Text))
    kinds = (*results.NUMBER_KINDS, "simulated")
    return [] if name in DRAWINGS or any(kind in said for kind in kinds) else ["no kind is said"]


def span(control):
    """The first and the last value that a control can have, perhaps with those between."""
    if hasattr(control, "options"):
        return [one[-1] if isinstance(one, tuple) else one for one in control.options]
    return [control.min, control.max] if hasattr(control, "min") else [False, True]


def watch(file):
    """Write what is found in every figure that a run saves or explores to a JSON file.

    Figures are saved as PNG alone: other tests save in all forms.
    """
    results.FORMATS = {"png": {}}
    save_figure, explore = Run.save_figure, widgets.explore
    found, seen = {}, []

    def look_at(figure, name, more=()):
        sentences = overlapping_texts(figure) + doubled_names(figure)
        if sentences := [*sentences, *more]:
            found[name] = found.get(name, []) + sentences
        seen.append(name)
        Path(file).write_text(json.dumps({"found": found, "seen": seen}), encoding="utf-8")

    def save(self, figure, name, **choices):
        save_figure(self, figure, name, **choices)
        look_at(figure, name, of_no_kind(figure, name))

    def explored(function, **controls):
        start = {name: control.value for name, control in controls.items()}
        ends = [{name: span(one)[end] for name, one in controls.items()} for end in (0, -1)]
        for values in (*ends, start):
            for name, value in values.items():
                controls[name].value = value
            figure = explore(function, **controls)
            look_at(figure, "explorer")
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
