"""3-D views by pyvista, where the machine can draw with OpenGL.

VTK without OpenGL libraries does not raise, it kills the process; so a child process tries first.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from mmqa_lab import plots
from mmqa_lab._checks import check_points, needs

__all__ = ["is_headless", "show_cloud"]
__dir__ = __all__.copy

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"

TITLES = ("easting (m)", "northing (m)", "height (m)")

PROBE = "import pyvista; pyvista.Plotter(off_screen=True).screenshot()"


@functools.cache
def can_render() -> bool:
    """Return whether VTK can draw off screen here; asked once, takes about 2 s.

    Sets the environment variable that names the window class which works.
    """
    for window in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", ""):
        environment = {**os.environ, WINDOW_VARIABLE: window}
        child = subprocess.run(
            [sys.executable, "-P", "-c", PROBE], env=environment, capture_output=True
        )
        if child.returncode == 0:
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


def show_cloud(
    cloud: ArrayLike, values: ArrayLike, *, label: str, limit: float | None = None
) -> Any:
    """Show a cloud in 3-D, coloured by a value for each point.

    In JupyterLab the view can be turned; in a run without a screen it is a picture; without OpenGL
    libraries a sentence stands in its place.

    Parameters
    ----------
    cloud : array_like, shape (n, 3)
        Metres; the axes show its coordinates.
    values : array_like, shape (n,) or (n, 3)
        Residuals, intensities, f, ...; or colours from 0 to 1.
    label : str
        Name and unit of the values.
    limit : float, optional
        Colour from red to blue between this value and its negative, as pictures of planes do.

    Returns
    -------
    pyvista viewer, picture or sentence

    Raises
    ------
    ValueError
        If a point is not finite or they do not have three coordinates.

    Examples
    --------
    >>> from unittest.mock import patch
    >>> with patch(f"{__name__}.can_render", return_value=False):
    ...     show_cloud([[0, 0, 0], [1, 0, 0.1]], [0.0, 1.0], label="height (m)").data
    'No 3-D view: it needs the OpenGL libraries that the README names.'
    """
    points = check_points(cloud)
    values = np.asarray(values, dtype=np.float64)
    if not can_render():
        return needs("lab", "IPython.display").Markdown(
            "No 3-D view: it needs the OpenGL libraries that the README names."
        )

    choices: dict = {"jupyter_backend": "static"}
    if not is_headless():
        look = {"collapse_menu": True, "width": "100%"}  # of the cell, without a bar to scroll
        choices = {"jupyter_backend": "server", "jupyter_kwargs": look}
        # it would download code from the network when the first view opens
        sys.modules.setdefault("trame.widgets.vtklocal", None)  # type: ignore[arg-type]
    return _plotter(points, values, label, limit).show(return_viewer=True, **choices)


def _plotter(points, values, label, limit=None):
    """The pyvista scene of one cloud; drawn from its lowest corner, as VTK counts in float32."""
    low = points.min(axis=0)
    local = points - low
    pyvista = needs("views", "pyvista")
    # pyvista itself does not find the notebook when a button calls
    place: dict = {
        "notebook": needs("lab", "IPython").get_ipython() is not None,
        "off_screen": is_headless(),
    }
    plotter = pyvista.Plotter(**place, window_size=(900, 650))
    if values.ndim == 2:
        plotter.add_points(pyvista.PolyData(local), scalars=values, rgb=True, point_size=4)
    else:
        _add_shaded(plotter, pyvista.PolyData(local), values, label, limit)
    extent, box, ranges, shown = np.ptp(local, axis=0), [], [], {}
    for k, (axis, title) in enumerate(zip("xyz", TITLES, strict=True)):
        ends, share = low[k] + np.array([0.0, extent[k]]), extent[k] / extent.max()
        ticks = _ticks_in(*ends, share)
        room = len(ticks) > 1  # for numbers
        title = title if room else title.replace(" (", f" {ends[0]:.9g} (") if share > 0.1 else " "
        ranges += [*(ticks[[0, -1]] if room else ends)]
        box += [one - low[k] for one in ranges[-2:]]
        shown |= {f"{axis}title": title, f"show_{axis}axis": share > 0.1}
        shown |= {f"show_{axis}labels": room, f"n_{axis}labels": len(ticks)}
    look = {"font_size": 12, "location": "outer", "fmt": "%.9g"}
    plotter.show_bounds(bounds=box, axes_ranges=ranges, **shown, **look)
    plotter.view_isometric()
    plotter.camera.zoom(0.7)
    plotter.camera.SetWindowCenter(0, -0.15)  # the scale is below, the viewer's buttons are above
    return plotter


def _add_shaded(plotter, points, values, label, limit):
    """Draw points shaded by a value, with a scale."""
    marks, cmap = np.array([-1, 0, 1]) * (limit or 0), plots.DIVERGING_MAP
    if limit is None:
        marks, cmap = _round_ticks(np.nanmin(values), np.nanmax(values)), plots.MAP
    bar = {"title": f"{label}\n", "n_labels": len(marks), "fmt": "%.4g", "position_x": 0.2}
    shades = {"scalars": values, "clim": marks[[0, -1]], "cmap": cmap, "point_size": 4}
    plotter.add_points(points, **shades, scalar_bar_args=bar)


def _ticks_in(low, high, share):
    """Ticks of an axis that is so large a share of the longest, which has 40 characters of room."""
    most = min(5, int(40 * share / (1 + len(f"{high:.9g}".split(".")[0]))))
    if most < 1:
        return np.empty(0)
    ticks = _round_ticks(low, high, most)
    return ticks if len(ticks) <= most + 1 else ticks[[0, -1]]


def _round_ticks(low, high, most=4):
    """Ticks at round numbers, at most so many steps, that reach beyond both ends."""
    locator = MaxNLocator(max(1, most), steps=[1, 2, 2.5, 5, 10])
    return locator.tick_values(low, max(high, low + 1e-9))
