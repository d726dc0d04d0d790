"""A street in 3-D with what a method made of its poles."""

import numpy as np

from mmqa_lab import views
from mmqa_lab.plots import COLOURS, subplots
from mmqa_lab.studies.poles import figures

OUTCOMES = (("hit", "blue"), ("miss", "orange"), ("false alarm", "vermilion"))
RADIUS_M = 0.25
"""Of the drawn poles, wide enough to be seen."""


def show_street(survey, name, *, corridor=30.0):
    """Show a street in 3-D: its points in grey, hits, misses and false alarms as coloured poles.

    In JupyterLab the view can be turned; in a run without a screen it is a picture; without OpenGL
    libraries it is the plan.

    Parameters
    ----------
    survey : mmqa_lab.studies.poles.surveys.Survey
    name : str
        Of the method.
    corridor : float
        Metres.

    Returns
    -------
    pyvista viewer or matplotlib figure
    """
    if not views.can_render():
        figure, ax = subplots(width="double", height_mm=95)
        figures.draw_street(survey, name, ax=ax, corridor=corridor)
        return figure
    plotter = plot_street(survey, name, corridor=corridor, off_screen=views.is_headless())
    backend = "static" if views.is_headless() else "trame"
    return plotter.show(jupyter_backend=backend, return_viewer=True)


def plot_street(survey, name, *, corridor, off_screen):
    """Return the pyvista scene of :func:`show_street`."""
    import pyvista

    plotter = pyvista.Plotter(off_screen=off_screen, window_size=(1100, 650))
    plotter.set_background("white")
    points = survey.cloud.points
    near = np.abs(points[:, 0]) < corridor
    near &= (points[:, 1] > 0) & (points[:, 1] < survey.street.length_m)
    plotter.add_points(pyvista.PolyData(points[near]), color="#b0b0b0", point_size=1)
    places = survey.outcomes(name, corridor=corridor)
    for label, colour in OUTCOMES:
        for row in places[label].itertuples():
            middle = (row.x_m, row.y_m, row.z_base_m + row.height_m / 2)
            lean = (row.lean_x, row.lean_y, 1.0)
            size = {"radius": RADIUS_M, "height": max(row.height_m, 1.0)}
            pole = pyvista.Cylinder(center=middle, direction=lean, **size)
            plotter.add_mesh(pole, color=COLOURS[colour])
    legend = [[f"{label} ({len(places[label])})", COLOURS[colour]] for label, colour in OUTCOMES]
    plotter.add_legend(legend, bcolor="white", face="rectangle", loc="upper left", size=(0.3, 0.11))
    _look_along(plotter, survey.street.length_m)
    return plotter


def _look_along(plotter, length):
    """Look down the street from behind and above its beginning."""
    middle = (0.0, 0.45 * length, 0.0)
    plotter.camera_position = [(-0.35 * length, -0.35 * length, 0.35 * length), middle, (0, 0, 1)]
