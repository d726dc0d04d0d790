"""3-D views by pyvista, with a matplotlib picture where the machine cannot draw with OpenGL.

VTK without OpenGL libraries does not raise, it kills the process; so a child process tries first.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from mmqa_lab import plots
from mmqa_lab._checks import check_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mmqa_lab.cloud import Cloud

__all__ = [
    "is_headless",
    "show_cloud",
]
__dir__ = __all__.copy

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"

TITLES = ("easting (m)", "northing (m)", "height (m)")

PROBE = (
    "import vtkmodules.vtkRenderingOpenGL2, vtkmodules.vtkRenderingCore as core;"
    "window = core.vtkRenderWindow(); window.SetOffScreenRendering(1); window.SetSize(32, 32);"
    "window.AddRenderer(core.vtkRenderer()); window.Render(); print('drawn')"
)


@functools.cache
def can_render():
    """Return whether VTK can draw off screen here; asked once, takes about 2 s.

    Sets the environment variable that names the window class which works, so that this process
    draws as the child did.
    """
    settings = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "")
    for window in settings if not os.environ.get("DISPLAY") else reversed(settings):
        environment = {**os.environ, WINDOW_VARIABLE: window}
        child = subprocess.run(
            [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True
        )
        if child.returncode == 0 and "drawn" in child.stdout:
            os.environ[WINDOW_VARIABLE] = window
            return True
    return False


def is_headless() -> bool:
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


def show_cloud(cloud: Cloud | ArrayLike, values: ArrayLike, *, label: str) -> Any:
    """Show a cloud in 3-D, coloured by a value for each point.

    In JupyterLab the view can be turned; in a run without a screen it is a picture; without OpenGL
    libraries it is a matplotlib figure.

    Parameters
    ----------
    cloud : Cloud or array_like, shape (n, 3)
        Metres.
    values : array_like, shape (n,)
        Residuals, intensities, f, ...
    label : str
        Name and unit of the values.

    Returns
    -------
    pyvista viewer or matplotlib figure

    Raises
    ------
    ValueError
        If a point is not finite or they do not have three coordinates.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> with patch(f"{__name__}.can_render", return_value=False):
    ...     figure = show_cloud([[0, 0, 0], [1, 0, 0.1]], [0.0, 1.0], label="height (m)")
    >>> figure.axes[-1].get_ylabel()
    'height (m)'
    """
    points = check_points(cloud)
    local = points - points.min(axis=0)  # counted from the corner: no tick is -0.0
    if not can_render():
        return _figure(local, values, label)
    plotter = _plotter(local, values, label, off_screen=is_headless())
    if is_headless():
        return plotter.show(jupyter_backend="static", return_viewer=True)
    _serve_locally()
    folded = {"collapse_menu": True}
    return plotter.show(jupyter_backend="server", return_viewer=True, jupyter_kwargs=folded)


def _serve_locally():
    """Draw here and send pictures, through a hub's proxy where there is one."""
    import pyvista

    # it would download code from the network when the first view opens
    sys.modules.setdefault("trame.widgets.vtklocal", None)
    if hub := os.environ.get("JUPYTERHUB_SERVICE_PREFIX"):
        pyvista.global_theme.trame.server_proxy_enabled = True
        pyvista.global_theme.trame.server_proxy_prefix = f"{hub}proxy/"


def _plotter(local, values, label, *, off_screen):
    """The pyvista scene of one cloud."""
    import pyvista

    plotter = pyvista.Plotter(off_screen=off_screen, window_size=(900, 650))
    plotter.set_background("white")
    values = np.asarray(values, dtype=np.float64)
    largest, span = np.nanmax(np.abs(values)), np.nanmax(values) - np.nanmin(values)
    digits = 3 + max(0, int(np.log10(largest / span))) if span > 0 else 3  # no label twice
    bar = {
        **{"title": f"{label}\n", "color": "black", "n_labels": 4, "fmt": f"%.{digits}g"},
        **{"vertical": False, "position_x": 0.25, "position_y": 0.03, "width": 0.5},
        **{"title_font_size": 18, "label_font_size": 16},
    }
    plotter.add_points(
        pyvista.PolyData(local),
        scalars=values,
        point_size=4,
        cmap=plots.MAP,
        scalar_bar_args=bar,
    )
    shown = {}
    for axis, title, thin in zip("xyz", TITLES, _thin(local), strict=True):
        shown |= {f"{axis}title": " " if thin else title, f"show_{axis}axis": not thin}
        shown[f"show_{axis}labels"] = not thin
    plotter.show_bounds(**shown, color="black", font_size=9, location="outer")
    plotter.view_isometric()
    plotter.camera.zoom(0.95)
    plotter.camera.SetWindowCenter(0, -0.12)  # the scale is below, the viewer's buttons are above
    return plotter


def _figure(local, values, label, limit=20_000):
    """The matplotlib picture of one cloud, thinned to what it can draw."""
    step = max(1, len(local) // limit)
    with plots.style():
        figure, ax = plots.subplots(width="double", height_mm=110, subplot_kw={"projection": "3d"})
        shades = {"c": np.asarray(values)[::step], "cmap": plots.MAP, "s": 1, "rasterized": True}
        dots = ax.scatter(*local[::step].T, **shades)
        ax.set(aspect="equal")
        ax.locator_params(nbins=4)
        for axis, title, thin in zip("xyz", TITLES, _thin(local), strict=True):
            getattr(ax, f"set_{axis}label")("" if thin else title, labelpad=8)
            if thin:
                ax.set(**{f"{axis}ticks": []})
        figure.colorbar(dots, ax=ax, label=label, shrink=0.6, pad=0.12)
    plots.plt.close(figure)  # the caller shows it; left open, a notebook would show it twice
    return figure


def _thin(local):
    """Which of easting, northing, height vary too little for an axis of their own."""
    extent = np.ptp(local, axis=0)
    return extent < 0.1 * extent.max()
