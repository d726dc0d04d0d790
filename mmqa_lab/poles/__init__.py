"""Poles: versions of two published detectors, a learned one, and scores against a reference.

    from mmqa_lab import poles

    found = poles.detect(cloud, method="ours")              # or "fgi", "itc"
    result = poles.score(found, reference, corridor=15, trajectory=positions)
    result.recall, result.precision, result.by_class()

Methods: ``fgi`` (scan lines; Lehtomaki et al. 2010), ``itc`` (components; Pu et al. 2011) and
``ours`` (learned). Their thresholds are the fields of ``settings_of(method)``.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_plan, check_positive
from mmqa_lab.cloud import Cloud, path_distance
from mmqa_lab.poles.scores import Score, curve, match, score

if TYPE_CHECKING:
    from lightgbm import Booster

    from mmqa_lab.poles import fgi, itc, ours

METHODS = ("ours", "fgi", "itc")

CORRIDORS_M = {"ours": 30.0, "fgi": 30.0, "itc": 15.0}
"""Half width of the corridor where a trajectory comes without one: that of the report's tables."""

__all__ = ["METHODS", "Score", "curve", "detect", "match", "score", "settings_of"]
__dir__ = __all__.copy


def detect(
    points: Cloud | ArrayLike | pd.DataFrame,
    *,
    method: str = "ours",
    trajectory: ArrayLike | None = None,
    corridor: float | None = None,
    explain: bool = False,
    model: Booster | None = None,
    **thresholds,
) -> pd.DataFrame:
    """Detect poles.

    Parameters
    ----------
    points : Cloud, array_like of shape (n, 3), DataFrame or path
        Metres, any origin. The scan-line method needs a cloud with ``scan_line`` and ``pulse`` or
        ``gps_time``, or with ``gps_time`` or ``scan_angle`` from which lines are recovered; without
        them it warns and the component method answers.
    method : {"ours", "fgi", "itc"}
    trajectory : array_like, shape (m, 2) or (m, 3), optional
        Points farther than ``corridor`` from it are left out; where none is left, it warns.
    corridor : float, optional
        Metres; where left out 15 of the component method and 30 of the others.
    explain : bool
        Return every candidate, with the first test it failed in ``rejected_by`` (empty for poles).
    model : lightgbm.Booster, optional
        Verifier of the learned method, one's own for instance; others have none.
    **thresholds
        Fields of the method's settings, see :func:`settings_of`.

    Returns
    -------
    DataFrame
        One row a pole, from south to north: ``id`` from 1; ``x_m``, ``y_m`` (the axis at half the
        height), ``z_base_m``, ``height_m`` (of the pole-like part), ``diameter_m`` (halfway up it),
        ``tilt_deg``, ``score`` (0 to 1), ``method``, ``lean_x``, ``lean_y`` (m/m). NaN where not
        measurable. Of
        ``itc`` also ``is_tree``.

    Raises
    ------
    ValueError
        If a threshold is unknown or not a number, a corridor comes without a trajectory, or a model
        with another method than ``ours``.

    Notes
    -----
    The score of ``ours`` is the probability that its trees give on streets like the training ones;
    on others it is no probability. For the other methods it is the share of points in the inner
    cylinder and the share of slices that are pole-like, which order detections and no more.

    Examples
    --------
    >>> z = np.linspace(0, 3, 60)
    >>> turn = np.arange(60) * 2.4
    >>> post = np.stack([5 + 0.05 * np.cos(turn), 5 + 0.05 * np.sin(turn), z], axis=1)
    >>> floor = np.stack([*np.mgrid[0:10:0.2, 0:10:0.2].reshape(2, -1), np.zeros(2500)], axis=1)
    >>> found = detect(np.vstack([post, floor]), method="itc")
    >>> found[["x_m", "y_m"]].round(1).to_numpy().tolist()
    [[5.0, 5.0]]
    """
    check_choice(method, "method", METHODS)
    if model is not None:
        check_choice(method, "method with a model", ("ours",))
    from mmqa_lab.poles.on_lines import scan_lines

    cloud = points if isinstance(points, Cloud) else Cloud(points)
    inside, origin = _within(cloud, trajectory, corridor, CORRIDORS_M[method])
    lines = scan_lines(cloud)
    if method == "fgi" and lines is None:
        warnings.warn(
            "The scan-line method needs scan lines: columns scan_line and pulse or gps_time, or "
            "gps_time (with pauses) or scan_angle. This cloud has "
            f"{', '.join(cloud.columns) or 'none'}; the component method answers instead.",
            stacklevel=2,
        )
        method, thresholds = "itc", {}
    settings = _settings(import_module(f"mmqa_lab.poles.{method}"), method, thresholds)
    choices = {"explain": explain} | ({"model": model} if method == "ours" else {})
    local = cloud.points[inside] - origin
    lines = None if lines is None else tuple(values[inside] for values in lines)
    choices |= {} if method == "itc" else {"lines": lines}
    detect_with = import_module(f"mmqa_lab.poles.{method}").detect
    found = detect_with(local, settings, **choices)
    found.insert(0, "id", np.arange(1, len(found) + 1))
    shifts = dict(zip(("x_m", "y_m", "z_base_m"), origin, strict=True))
    return found.assign(**{name: found[name] + shift for name, shift in shifts.items()})


def settings_of(method: str) -> fgi.Settings | itc.Settings | ours.Settings:
    """Return the default thresholds of a method; each is documented at the class returned.

    Parameters
    ----------
    method : {"ours", "fgi", "itc"}

    Returns
    -------
    Settings
        Of the method's module.

    Raises
    ------
    ValueError
        If there is no such method.

    Examples
    --------
    >>> settings_of("fgi").minimum_length
    1.0
    """
    check_choice(method, "method", METHODS)
    return import_module(f"mmqa_lab.poles.{method}").Settings()


def _settings(module, method, thresholds):
    """The settings of a method with some thresholds changed."""
    known = vars(module.Settings())
    for name, value in thresholds.items():
        check_choice(name, f"threshold of {method}", tuple(known))
        if not isinstance(known[name], bool):
            check_positive(value, name)
    return module.Settings(**thresholds)


def _within(cloud, trajectory, corridor, usual):
    """Which points lie in the corridor, all without a trajectory, and an origin near them."""
    points, inside = cloud.points, slice(None)
    if corridor is not None and trajectory is None:
        raise ValueError("Invalid trajectory None. Must be given where there is a corridor.")
    if trajectory is not None:
        reach = check_positive(usual if corridor is None else corridor, "corridor", unit="m")
        inside = _near_path(points, check_plan(trajectory, name="trajectory"), reach)
        points = points[inside]
        if len(cloud) and not len(points):
            said = f"No point lies within the corridor of {reach:g} m about the trajectory."
            warnings.warn(said, stacklevel=3)
    return inside, np.floor(points.min(axis=0)) if len(points) else np.zeros(3)


def _near_path(points, path, reach):
    """Which points lie within reach of a path; far ones are told by cells of 1 m."""
    cells, cell = np.unique(np.floor(points[:, :2] - path[0]), axis=0, return_inverse=True)
    distance = path_distance(cells + path[0] + 0.5, path)
    inside = (distance <= reach - 0.71)[cell.ravel()]
    edge = np.flatnonzero((np.abs(distance - reach) < 0.72)[cell.ravel()])
    inside[edge] = path_distance(points[edge, :2], path) <= reach
    return inside
