"""Interactive controls over what the studies compute and draw.

Nothing is computed here. Without a screen (``MMQA_HEADLESS``) controls become the static figure
of its starting values, because widgets would show nothing there.
"""

import ipywidgets
import matplotlib.pyplot as plt
from IPython.display import display

from mmqa_lab.views import is_headless


def explore(function, **controls):
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
    if is_headless():
        return function(**{name: control.value for name, control in controls.items()})
    output = ipywidgets.Output()

    def redraw(_=None):
        """The figure of the controls' present values, in place of the last one."""
        with output, plt.ioff():
            figure = function(**{name: control.value for name, control in controls.items()})
            output.clear_output(wait=True)
            display(figure)
            plt.close(figure)

    for control in controls.values():
        control.observe(redraw, names="value")
    redraw()
    return ipywidgets.VBox([*controls.values(), output])


def slider(name, value, low, high, step, *, unit=""):
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


def choice(name, options):
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
