"""A street in 3-D with what a method made of its poles."""

import numpy as np

from mmqa_lab import views
from mmqa_lab.plots import COLOURS, subplots
from mmqa_lab.studies.poles import figures

OUTCOMES = (("hit", "blue"), ("miss", "orange"), ("false alarm", "vermilion"))
WIDTH_M = 0.4
"""Of the drawn poles, wide enough to be seen."""


def show_street(survey, name, *, corridor=30.0):
    """Show a street in 3-D: its points in grey, hits, misses and false alarms as coloured poles.

    In JupyterLab the view can be turned; in a run without a screen it is the plan.

    Parameters
    ----------
    survey : mmqa_lab.studies.poles.surveys.Survey
    name : str
        Of the method.
    corridor : float
        Metres.

    Returns
    -------
    k3d.plot.Plot or matplotlib.figure.Figure
    """
    if views.is_headless():
        figure, ax = subplots(width="double", height_mm=95)
        figures.draw_street(survey, name, ax=ax, corridor=corridor)
        return figure
    plot = views.empty_view()
    points = survey.cloud.points
    near = np.abs(points[:, 0]) < corridor
    near &= (points[:, 1] > 0) & (points[:, 1] < survey.street.length_m)
    views.add_points(plot, points[near])
    places = survey.outcomes(name, corridor=corridor)
    for label, colour in OUTCOMES:
        _add_poles(plot, places[label], COLOURS[colour])
    legend = [
        f'<span style="color: {COLOURS[colour]}">■</span> {label} ({len(places[label])})'
        for label, colour in OUTCOMES
    ]
    views.add_label(plot, "<br>".join(legend))
    length = survey.street.length_m
    plot.camera = [-0.35 * length, -0.35 * length, 0.35 * length, 0, 0.45 * length, 0, 0, 0, 1]
    return plot


def _add_poles(plot, poles, colour):
    """Poles as thick lines from their base along their lean."""
    import k3d

    if poles.empty:
        return
    base = poles[["x_m", "y_m", "z_base_m"]].to_numpy()
    lean = poles[["lean_x", "lean_y"]].assign(up=1.0).to_numpy()
    top = base + lean * poles["height_m"].clip(lower=1.0).to_numpy()[:, None]
    ends = np.stack([base, top], axis=1).reshape(-1, 3).astype(np.float32)
    pairs = np.arange(len(ends), dtype=np.uint32).reshape(-1, 2)
    choices = {"indices_type": "segment", "shader": "mesh", "width": WIDTH_M}
    plot += k3d.lines(ends, pairs, color=int(colour.lstrip("#"), 16), **choices)
