"""Finds texts in a figure that overlap one another or leave the figure."""

import json
from pathlib import Path

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


def watch(file):
    """Write what is found in every figure that a run saves from now on to a JSON file."""
    save_figure, found = Run.save_figure, {}

    def save(run, figure, name, **choices):
        save_figure(run, figure, name, **choices)
        if sentences := overlapping_texts(figure):
            found[name] = sentences
        Path(file).write_text(json.dumps(found), encoding="utf-8")

    Run.save_figure = save


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
