"""What all controls share: canvases, explorers with sliders and lists, typed and first polygons."""

from __future__ import annotations

import contextlib
import re
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import ipywidgets
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Javascript, display
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy import ndimage

from mmqa_lab import plots
from mmqa_lab._checks import check_polygon
from mmqa_lab.spacing import quadrant_distances
from mmqa_lab.views import is_headless

__all__ = [
    "LOCK", "SHOWN", "SPOKEN", "WIDE", "Halt", "canvas_of", "choice", "corners_of", "explore",
    "forget_zoom", "in_turn", "labelled", "largest_rectangle", "slider",
]  # fmt: skip


WIDE = {"width": "24em"}

# Gives controls and pictures names for screen readers.
SPOKEN = Path(__file__).with_suffix(".js")

LOCK = threading.RLock()


# Most points drawn, and tried for a rectangle. All are used.
SHOWN = 10_000


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
    """Return a label and its width, and the width of the control."""
    style, layout = {"description_width": "14em"}, {"width": "34em"}
    return {"description": label, "style": style, "layout": layout}


def forget_zoom(figure):
    """Let the button home of a canvas return to the present view."""
    if figure.canvas.toolbar is not None:
        figure.canvas.toolbar.update()


def canvas_of(figure):
    """Return a canvas of ipympl; without a screen, the figure.

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


def explore(
    function: Callable[..., Figure], **controls: ipywidgets.Widget
) -> ipywidgets.VBox | Figure:
    """Draw a figure again whenever a control moves.

    Parameters
    ----------
    function : callable
        Takes the values of the controls by name and returns a matplotlib figure.
    **controls
        Controls of ipywidgets, such as :func:`slider` and :func:`choice` return.

    Returns
    -------
    ipywidgets.VBox or matplotlib.figure.Figure
        The controls with the figure below them; without a screen, the figure alone.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> def draw(speed):
    ...     figure, ax = plt.subplots()
    ...     ax.plot([0, speed])
    ...     return figure
    >>> with patch.dict("os.environ", MMQA_HEADLESS="1"):
    ...     figure = explore(draw, speed=slider("speed", 10, 1, 20, 1, unit="m/s"))
    >>> figure.axes[0].lines[0].get_ydata().tolist()
    [0, 10]
    >>> plt.close(figure)
    """

    def drawn(**values):
        """The figure for values of the controls."""
        figure = function(**values)
        plots.finish_figure(figure)
        plt.close(figure)  # the cell shows it; pyplot would show it again
        return figure

    if is_headless():
        return drawn(**{name: control.value for name, control in controls.items()})
    display(Javascript(filename=SPOKEN))
    output = ipywidgets.interactive_output(lambda **values: display(drawn(**values)), controls)
    return ipywidgets.VBox([*controls.values(), output])


def slider(
    name: str, value: float, low: float, high: float, step: float, *, unit: str = ""
) -> ipywidgets.IntSlider | ipywidgets.FloatSlider:
    """Return a slider with the unit in its label; it reports its value on release.

    Parameters
    ----------
    name : str
        Label of the slider.
    value, low, high, step : float or int
        First value, ends and step. An int as step gives whole numbers.
    unit : str
        Unit of the values.

    Returns
    -------
    ipywidgets.IntSlider or ipywidgets.FloatSlider

    Examples
    --------
    >>> speed = slider("speed", 40.0, 10.0, 80.0, 5.0, unit="km/h")
    >>> speed.description, speed.value
    ('speed (km/h)', 40.0)
    """
    kind = ipywidgets.IntSlider if isinstance(step, int) else ipywidgets.FloatSlider
    limits = {"value": value, "min": low, "max": high, "step": step}
    return kind(**limits, continuous_update=False, **labelled(f"{name} ({unit})" if unit else name))


def choice(name: str, options: Sequence[str]) -> ipywidgets.Dropdown:
    """Return a drop-down list that starts with the first option.

    Parameters
    ----------
    name : str
        Label of the list.
    options : sequence of str
        Texts to choose from.

    Returns
    -------
    ipywidgets.Dropdown

    Examples
    --------
    >>> choice("pattern", ["lattice", "poisson"]).value
    'lattice'
    """
    return ipywidgets.Dropdown(options=options, **labelled(name))


def corners_of(text: str) -> np.ndarray:
    """Return typed corners, shape (m, 3): a line each, decimals behind a point or a comma.

    Examples
    --------
    >>> corners_of("1.5, 2, 3; 4,5 6 7; 0 0 1").tolist()
    [[1.5, 2.0, 3.0], [4.5, 6.0, 7.0], [0.0, 0.0, 1.0]]
    """
    rows = [one.strip(" ,") for one in re.split(r"[;\n]", text) if one.strip(" ,")]
    cut = [re.split(r",?\s+", one) if re.search(r"\s", one) else one.split(",") for one in rows]
    return check_polygon([[float(one.replace(",", ".")) for one in row] for row in cut])


def largest_rectangle(xy: ArrayLike) -> np.ndarray:
    """Return the largest rectangle along the axes without gaps between points.

    Parameters
    ----------
    xy : array_like, shape (n, 2)
        Coordinates, m.

    Returns
    -------
    array, shape (4, 2)
        Its corners, m, in steps of a sixtieth of the longer extent or three times the spacing.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05))
    >>> band = np.column_stack([x.ravel(), y.ravel()])[(abs(x - y) < 1).ravel()]
    >>> corners = largest_rectangle(band)
    >>> bool((np.abs(corners @ [1, -1]) < 1.25).all())
    True
    """
    xy = np.asarray(xy, dtype=np.float64)
    extent = np.ptp(xy, axis=0)
    some = np.arange(len(xy)) % (1 + len(xy) // SHOWN) == 0
    away = quadrant_distances(xy, radius=extent.max() / 4, of=some)[:, -1]
    away = away[~np.isnan(away)]
    edge = max(extent.max() / 60, 3 * np.median(away)) if len(away) else extent.max() / 10
    cells = np.maximum(1, (extent / edge).astype(int))
    counts, x, y = np.histogram2d(xy[:, 0], xy[:, 1], bins=cells)
    filled = ndimage.binary_closing(np.pad(counts > 0, 1))[1:-1, 1:-1] | (counts > 0)
    best, heights = (0, 0, 0, 0, 0), np.zeros(filled.shape[1], dtype=int)
    for end, row in enumerate(filled, 1):
        heights = (heights + 1) * row
        for first in range(len(row)):
            lowest = np.minimum.accumulate(heights[first:])
            areas = lowest * np.arange(1, len(lowest) + 1)
            k = np.argmax(areas)
            best = max(best, (areas[k], end - lowest[k], first, end, first + k + 1))
    _, x0, y0, x1, y1 = best
    return np.array([(x[x0], y[y0]), (x[x1], y[y0]), (x[x1], y[y1]), (x[x0], y[y1])])
