"""Finds what one cannot read in a figure: texts on texts, names twice, lines alike in grey."""

import itertools
import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import to_rgb

from mmqa_lab import run, widgets
from mmqa_lab.run import Run

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


def alike_in_grey(figure):
    """A sentence for each two series of a panel that one cannot tell apart without colour.

    A line without a name may look like another of its own colour: both show the same thing.
    """
    found = []
    for ax in figure.axes:
        for (one, first), (other, second) in itertools.combinations(_looks(ax), 2):
            (mark, colour), (same, tone) = first, second
            dark, light = sorted((grey(colour), grey(tone)))
            together = not (one and other) and to_rgb(colour) == to_rgb(tone)
            if mark == same and not together and (light + 0.05) / (dark + 0.05) < 2:
                found.append(f"{one!r} and {other!r} are alike in grey")
    return found


def _looks(ax):
    """Name, and what is seen without and with colour, of lines, dots, bars and areas."""
    handles, names = ax.get_legend_handles_labels()
    inside = [part for one in ax.containers for part in one.get_children()]
    for name, handle in zip(names, handles, strict=True):
        yield name, look(handle)
    for line in ax.lines:
        if line not in handles and line not in inside:
            yield "", look(line)


def look(drawn):
    """What is seen of a line, of dots or of areas without its colour, and the colour."""
    if isinstance(drawn, tuple):  # bars, or marks with error bars
        drawn = drawn.patches[0] if hasattr(drawn, "patches") else drawn.lines[0]
    if hasattr(drawn, "get_xydata"):
        joined = drawn.get_linestyle() != "None" and len(drawn.get_xydata()) > 1
        dashes = str(drawn._dash_pattern) if joined else ""
        is_open = drawn.get_markerfacecolor() == "none"
        return ("line", dashes, str(drawn.get_marker()), is_open), drawn.get_color()
    faces, edges = (np.atleast_2d(c) for c in (drawn.get_facecolor(), drawn.get_edgecolor()))
    *colour, alpha = (faces if faces.size and faces[0, 3] > 0 else edges)[0]
    colour = 1 - alpha * (1 - np.array(colour))  # on white
    if hasattr(drawn, "get_offsets") and len(drawn.get_paths()) == 1 and drawn.get_sizes().any():
        return ("dots", str(drawn.get_paths()[0].vertices.round(3).tolist())), colour
    return ("area", drawn.get_hatch() or ""), colour


def of_no_kind(figure, name):
    """A sentence for a figure that does not say which kind of numbers it shows."""
    said = " ".join(text.get_text() for text in figure.findobj(plt.Text))
    kinds = (*run.KINDS, "simulated")
    return [] if name in DRAWINGS or any(kind in said for kind in kinds) else ["no kind is said"]


def not_redrawn(figure, file):
    """A sentence for each line and name of a figure that the README's three lines do not draw."""
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(shown = .*?)```", readme, re.DOTALL)[1]
    assert len(code.splitlines()) == 3
    code = re.sub(r'"notebooks/.*?"', "file", code)
    found = []
    axes = [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]
    for panel, ax in enumerate(axes, 1):
        handles, names = ax.get_legend_handles_labels()
        names = [name for name, one in zip(names, handles, strict=True) if not _is_empty(one)]
        german = {name: f"neu {name}" for name in names}
        scope = {"pd": pd, "plt": plt, "file": file, "german": german}
        again, new = plt.subplots()
        exec(code.replace("== 1", f"== {panel}"), scope)
        said = set(new.get_legend_handles_labels()[1])
        found += [f"{name!r} is not drawn again" for name in names if f"neu {name}" not in said]
        for line in (line for line in ax.lines if line.get_transform() == ax.transData):
            if len(line.get_xydata()) and not any(_same_places(line, one) for one in new.lines):
                found.append(f"the line {line.get_label()!r} is not drawn again")
        plt.close(again)
    return found


def _is_empty(drawn):
    """Whether a line goes through no point."""
    return hasattr(drawn, "get_xydata") and not len(drawn.get_xydata())


def _same_places(line, other):
    """Whether two lines go through the same points."""
    places = [np.nan_to_num(np.array(one.get_xydata(), float)) for one in (line, other)]
    return places[0].shape == places[1].shape and np.allclose(*places, rtol=1e-6, atol=1e-9)


def grey(colour):
    """The relative luminance (WCAG 2.1) of a colour."""
    red, green, blue = (
        ((c + 0.055) / 1.055) ** 2.4 if c > 0.04 else c / 12.92 for c in to_rgb(colour)
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def span(control):
    """The first and the last value that a control can have, perhaps with those between."""
    if hasattr(control, "options"):
        return [one[-1] if isinstance(one, tuple) else one for one in control.options]
    return [control.min, control.max] if hasattr(control, "min") else [False, True]


def watch(file):
    """Write what is found in every figure that a run saves or explores to a JSON file.

    Figures are saved as PNG alone: other tests save in all forms.
    """
    run.FORMATS = ("png",)
    save_figure, explore = Run.save_figure, widgets.explore
    found, seen = {}, []

    def look_at(figure, name, more=()):
        sentences = overlapping_texts(figure) + doubled_names(figure) + alike_in_grey(figure)
        if sentences := [*sentences, *more]:
            found[name] = found.get(name, []) + sentences
        seen.append(name)
        Path(file).write_text(json.dumps({"found": found, "seen": seen}), encoding="utf-8")

    def save(self, figure, name, **choices):
        save_figure(self, figure, name, **choices)
        more = not_redrawn(figure, self.folder / f"{name}_drawn.csv") + of_no_kind(figure, name)
        look_at(figure, name, more)

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
