"""In the notebook: controls over what studies compute and draw, the polygon tool, the jury's form.

Nothing is computed here. Without a screen (``MMQA_HEADLESS``) controls become the static figure of
their starting values, and forms a picture, because widgets would show nothing there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import ipywidgets
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython.display import Image, Markdown, display

from mmqa_lab._checks import check_choice
from mmqa_lab._figures import finish_figure
from mmqa_lab.chart_image.rules import MARKS, check_marks
from mmqa_lab.io import write_atomically
from mmqa_lab.srgb import encode
from mmqa_lab.views import is_headless
from mmqa_lab.widgets.selection import pick_plane, select_polygon

if TYPE_CHECKING:
    from typing import Any

    from matplotlib.figure import Figure

__all__ = ["JuryForm", "choice", "explore", "pick_plane", "select_polygon", "slider"]
__dir__ = __all__.copy

MEANINGS = {"a": "a: every letter", "b": "b: the text", "c": "c: not legible"}

WIDEST_PX, LARGEST_ZOOM = 800, 12
"""A crop is enlarged by whole numbers up to this width on the screen; nothing is interpolated."""


def explore(
    function: Callable[..., Figure], **controls: ipywidgets.Widget
) -> ipywidgets.VBox | Figure:
    """Draw a figure again whenever a control moves.

    Parameters
    ----------
    function : callable
        Takes the controls' values by name and returns a matplotlib figure.
    **controls
        An ipywidgets control each, such as :func:`slider` makes.

    Returns
    -------
    ipywidgets.VBox or matplotlib.figure.Figure
        The controls with the figure below, or the static figure where there is no screen.

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

    def drawn():
        """The figure of the controls' present values."""
        figure = function(**{name: control.value for name, control in controls.items()})
        finish_figure(figure)
        return figure

    if is_headless():
        return drawn()
    output = ipywidgets.Output()

    def redraw(_=None):
        """That figure in place of the last one."""
        with output, plt.ioff():
            figure = drawn()
            output.clear_output(wait=True)
            display(figure)
            plt.close(figure)

    for control in controls.values():
        control.observe(redraw, names="value")
    redraw()
    return ipywidgets.VBox([*controls.values(), output])


def slider(
    name: str, value: float, low: float, high: float, step: float, *, unit: str = ""
) -> ipywidgets.IntSlider | ipywidgets.FloatSlider:
    """Return a slider whose label has the unit; it reports when it is let go.

    Parameters
    ----------
    name : str
    value, low, high, step : float or int
        Where it starts, its ends and its step; whole numbers where the step is one.
    unit : str

    Returns
    -------
    IntSlider or FloatSlider
        Of ipywidgets.

    Examples
    --------
    >>> speed = slider("speed", 40.0, 10.0, 80.0, 5.0, unit="km/h")
    >>> speed.description, speed.value
    ('speed (km/h)', 40.0)
    """
    kind = ipywidgets.IntSlider if isinstance(step, int) else ipywidgets.FloatSlider
    return kind(
        value=value,
        min=low,
        max=high,
        step=step,
        description=f"{name} ({unit})" if unit else name,
        continuous_update=False,
        style={"description_width": "14em"},
        layout={"width": "34em"},
    )


def choice(name: str, options: Sequence[str]) -> ipywidgets.Dropdown:
    """Return a drop-down list that starts with the first option.

    Parameters
    ----------
    name : str
    options : sequence of str

    Returns
    -------
    Dropdown
        Of ipywidgets.

    Examples
    --------
    >>> choice("pattern", ["lattice", "poisson"]).value
    'lattice'
    """
    return ipywidgets.Dropdown(
        options=options, description=name, style={"description_width": "14em"}
    )


class JuryForm:
    """A form in which one juror marks how well texts can be read.

    Each juror sees the same crops in the same order, without knowing where they come from, and
    gives a mark a (every letter), b (the text) or c (not legible). Every mark is on disk before the
    next crop is shown; a form on the same file goes on where it was left.

    Parameters
    ----------
    crops : dict of str to array, shape (rows, columns)
        Linear light by name of the element, such as ``"photo 3, text_1"``.
    juror : str
        Who marks.
    file : path
        CSV with ``juror``, ``element``, ``mark``; shared by all jurors, made when missing.
    order : sequence of str, optional
        Names of the crops in the order shown; the order of ``crops`` when not given.

    Attributes
    ----------
    box : ipywidgets.Widget
        What a notebook displays.

    Raises
    ------
    ValueError
        If a name in ``order`` is no crop or repeats, or the file has no marks.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "marks.csv"
    >>> form = JuryForm({"sign": np.ones((4, 9))}, juror="first", file=file)
    >>> form.mark("a")
    >>> pd.read_csv(file)["mark"].tolist(), form.element is None
    (['a'], True)
    """

    def __init__(
        self,
        crops: Mapping[str, Any],
        *,
        juror: str,
        file: str | os.PathLike,
        order: Sequence[str] | None = None,
    ):
        self._crops = dict(crops)
        self._order = list(self._crops if order is None else order)
        for name in self._order:
            check_choice(name, "crop in order", tuple(self._crops))
        if len(set(self._order)) < len(self._order):
            raise ValueError("Invalid order: a crop repeats. Must show each once.")
        if not str(juror).strip():
            raise ValueError(f"Invalid juror {juror!r}. Must have a name.")
        self._juror, self._file = str(juror).strip(), Path(file)
        self._picture = ipywidgets.Image(format="png", layout={"object_fit": "none"})
        self._line = ipywidgets.Label()
        self._buttons = {
            mark: ipywidgets.Button(description=text) for mark, text in MEANINGS.items()
        }
        for mark, button in self._buttons.items():
            button.on_click(lambda _, mark=mark: self.mark(mark))
        self._back = ipywidgets.Button(description="back", icon="arrow-left")
        self._back.on_click(lambda _: self.back())
        row = ipywidgets.HBox([*self._buttons.values(), self._back])
        self.box = ipywidgets.VBox([self._line, row, self._picture])  # buttons stay in place
        self._show()

    @property
    def marks(self) -> pd.DataFrame:
        """All marks in the file so far, of every juror."""
        if not self._file.is_file():
            return pd.DataFrame(columns=["juror", "element", "mark"])
        return check_marks(pd.read_csv(self._file, dtype=str, keep_default_na=False))

    @property
    def element(self) -> str | None:
        """Name of the crop shown; None when all are marked."""
        marks = self.marks
        done = set(marks.loc[marks["juror"] == self._juror, "element"])
        return next((name for name in self._order if name not in done), None)

    def mark(self, mark: str) -> None:
        """Give the crop shown a mark, write it down and show the next one."""
        check_choice(mark, "mark", MARKS)
        element = self.element
        if element is None:
            return
        row = {"juror": self._juror, "element": element, "mark": mark}
        self._write(pd.concat([self.marks, pd.DataFrame([row])]))

    def back(self) -> None:
        """Take this juror's last mark back and show its crop again."""
        marks = self.marks
        own = marks.index[(marks["juror"] == self._juror) & marks["element"].isin(self._order)]
        if len(own):
            self._write(marks.drop(own[-1]))

    def _ipython_display_(self):
        """The form, or the crop it shows where there is no screen."""
        shown = Image(self._picture.value) if self._picture.value else Markdown(self._line.value)
        display(shown if is_headless() else self.box)

    def _write(self, marks):
        """Replace the file by these marks, then show what is next."""
        write_atomically(self._file, marks)
        self._show()

    def _show(self):
        """Bring the form up to date."""
        element, total = self.element, len(self._order)
        place = total if element is None else self._order.index(element)
        for button in self._buttons.values():
            button.disabled = element is None
        self._back.disabled = place == 0
        if element is None:
            self._line.value = f"{self._juror}: all {total} are marked, thank you."
            self._picture.value = b""
        else:
            self._line.value = f"{self._juror}: {place + 1} of {total}"
            self._picture.value = _png(self._crops[element])


def _png(crop):
    """A crop as PNG, each pixel a square."""
    import cv2

    low, high = np.percentile(crop, [0.5, 99.5])
    shown = encode(np.clip((crop - low) / max(high - low, 1e-9), 0, 1), "srgb")
    zoom = int(np.clip(WIDEST_PX // crop.shape[1], 1, LARGEST_ZOOM))
    pixels = np.kron(np.round(shown * 255).astype(np.uint8), np.ones((zoom, zoom), np.uint8))
    return cv2.imencode(".png", pixels)[1].tobytes()
