"""3-D views: k3d draws them in the notebook's browser, matplotlib in a run without a screen.

Nothing comes from the network and no port is opened: the points go to the browser with the cells'
other outputs, so the views also work offline and through a hub.
"""

import os

import numpy as np

from mmqa_lab import plots
from mmqa_lab._checks import check_points

HEIGHT_PX = 560

AXES = [r"easting\ (m)", r"northing\ (m)", r"height\ (m)"]
"""In LaTeX, where a space needs its backslash."""


def is_headless():
    """Return whether this runs where nobody can turn a view: a notebook run as a batch job.

    Returns
    -------
    bool
        Whether the environment variable ``MMQA_HEADLESS`` is set.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> with patch.dict(os.environ, MMQA_HEADLESS="1"):
    ...     is_headless()
    True
    """
    return bool(os.environ.get("MMQA_HEADLESS"))


def show_cloud(cloud, values, *, label):
    """Show a cloud in 3-D, coloured by a value for each point.

    In JupyterLab the view can be turned; in a run without a screen it is a matplotlib figure.

    Parameters
    ----------
    cloud : Cloud or array_like, shape (n, 3)
        Metres.
    values : array_like, shape (n,)
        Residuals, intensities, f, ... Points whose value is NaN are left out.
    label : str
        Name and unit of the values.

    Returns
    -------
    k3d.plot.Plot or matplotlib.figure.Figure

    Examples
    --------
    >>> from unittest.mock import patch
    >>> with patch.dict(os.environ, MMQA_HEADLESS="1"):
    ...     figure = show_cloud([[0, 0, 0], [1, 0, 0.1]], [0.0, 1.0], label="height (m)")
    >>> figure.axes[-1].get_ylabel()
    'height (m)'
    """
    points = check_points(cloud)
    values = np.asarray(values, dtype=np.float64)
    known = np.isfinite(values)
    local = points[known] - points.mean(axis=0)
    if is_headless():
        return _figure(local, values[known], label)
    plot = empty_view()
    points = add_points(plot, local, values[known])
    plot.colorbar_object_id = points.id
    add_label(plot, label)
    reach = 1.1 * np.ptp(local, axis=0).max()
    plot.camera = [-0.5 * reach, -reach, 0.6 * reach, 0, 0, 0, 0, 0, 1]
    return plot


def empty_view():
    """Return an empty 3-D view with named axes.

    Returns
    -------
    k3d.plot.Plot

    Examples
    --------
    >>> empty_view().objects
    []
    """
    import k3d

    choices = {"menu_visibility": False, "axes_helper": 0, "camera_up_axis": "z"}
    return k3d.plot(height=HEIGHT_PX, axes=AXES, camera_auto_fit=False, **choices)


def add_points(plot, local, values=None):
    """Add points to a view, grey or coloured by a value, and return them.

    Parameters
    ----------
    plot : k3d.plot.Plot
    local : ndarray, shape (n, 3)
        Metres, near the origin: the browser has single precision.
    values : ndarray, shape (n,), optional

    Returns
    -------
    k3d.objects.Points

    Examples
    --------
    >>> add_points(empty_view(), np.zeros((2, 3)), np.array([0.0, 1.0])).color_range
    [0.0, 1.0]
    """
    import k3d

    size = float(max(0.8 * np.ptp(local, axis=0).max() / np.sqrt(len(local)), 1e-3))
    look = {"color": 0xB0B0B0} if values is None else _shades(values)
    points = k3d.points(local.astype(np.float32), point_size=size, shader="flat", **look)
    plot += points
    return points


def add_label(plot, text):
    """Write a text (HTML) into the upper left corner of a view.

    Examples
    --------
    >>> plot = empty_view()
    >>> add_label(plot, "f")
    >>> plot.objects[0].text
    'f'
    """
    import k3d

    plot += k3d.text2d(text, (0.02, 0.02), reference_point="lt", color=0, size=0.8, is_html=True)


def _shades(values):
    """The colours of values from the least to the largest."""
    import matplotlib as mpl

    steps = np.linspace(0, 1, 64)
    colours = np.column_stack([steps, mpl.colormaps[plots.MAP](steps)[:, :3]])
    return {
        "attribute": values.astype(np.float32),
        "color_map": colours.ravel().tolist(),
        "color_range": [float(values.min()), float(values.max())],
    }


def _figure(local, values, label, limit=20_000):
    """The matplotlib picture of one cloud, thinned to what it can draw."""
    step = max(1, len(local) // limit)
    figure, ax = plots.subplots(width="double", height_mm=110, subplot_kw={"projection": "3d"})
    dots = ax.scatter(*local[::step].T, c=values[::step], s=1, rasterized=True, cmap=plots.MAP)
    ax.set(xlabel="easting (m)", ylabel="northing (m)", zlabel="height (m)", aspect="equal")
    if _flat(local):
        ax.set(zticks=[], zlabel="")
    figure.colorbar(dots, ax=ax, label=label, shrink=0.6)
    return figure


def _flat(local):
    """Whether heights vary too little for an axis of their own."""
    extent = np.ptp(local, axis=0)
    return extent[2] < 0.1 * extent[:2].max()
