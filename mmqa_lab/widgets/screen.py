"""What all controls share: canvases, looks, turns between threads, sentences that end a run."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import matplotlib

from mmqa_lab.views import is_headless

__all__ = [
    "LOCK",
    "SPOKEN",
    "WIDE",
    "Halt",
    "canvas_of",
    "forget_zoom",
    "in_turn",
    "labelled",
]

WIDE = {"width": "24em"}

# Gives controls and pictures names for screen readers.
SPOKEN = Path(__file__).with_suffix(".js")

LOCK = threading.RLock()


class Halt(ValueError):
    """A sentence that ends a notebook's run; a notebook shows no traceback with it.

    Examples
    --------
    >>> Halt("Invalid cloud bush. Must have a plane.")._render_traceback_()
    ['Invalid cloud bush. Must have a plane.']
    """

    def _render_traceback_(self):
        return [str(self)]


@contextlib.contextmanager
def in_turn():
    """Let changes and drawings take turns: JupyterLab handles each widget in its own thread."""
    with LOCK:
        yield


def labelled(label):
    """A label and its width, and the width of the control."""
    style, layout = {"description_width": "14em"}, {"width": "34em"}
    return {"description": label, "style": style, "layout": layout}


def forget_zoom(figure):
    """Let the button home of a canvas return to the present view."""
    if figure.canvas.toolbar is not None:
        figure.canvas.toolbar.update()


def canvas_of(figure):
    """A canvas of ipympl; without a screen, the figure.

    The import of ipympl changes the backend of the whole session, so the backend is set back.
    """
    if is_headless():
        return figure
    backend = matplotlib.get_backend()
    from ipympl.backend_nbagg import Canvas, FigureManager

    matplotlib.use(backend)
    canvas = Canvas(figure)
    canvas.draw = in_turn()(canvas.draw)  # or a half changed figure would be drawn
    canvas.header_visible, canvas.toolbar_visible = False, True
    canvas.toolbar_position = "right"  # below, it would hide the coordinates of the mouse
    canvas.keep = FigureManager(canvas, 0)  # without its manager the toolbar disappears
    canvas.toolbar.layout.width = "3em"
    return canvas
