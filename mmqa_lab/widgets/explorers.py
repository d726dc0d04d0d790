"""Explorers of figures: a figure is drawn again whenever a slider or a list changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import ipywidgets
import matplotlib.pyplot as plt
from IPython.display import Javascript, display
from matplotlib.figure import Figure

from mmqa_lab import plots
from mmqa_lab.views import is_headless
from mmqa_lab.widgets.screen import SPOKEN, labelled

__all__ = ["choice", "explore", "slider"]


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
