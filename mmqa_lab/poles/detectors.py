"""The three detectors behind one function."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_points, check_positive
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import fgi, itc, learned

__all__ = ["METHODS", "detect"]

METHODS = {"learned": "learned", "fgi": "scan lines (FGI)", "itc": "components (ITC)"}
"""The detectors by name, with their labels in figures."""

CHOICES = {"learned": ("threshold", "trees"), "fgi": (), "itc": ()}
"""Further choices of each detector."""

TALL_M, SEVERAL = 9.0, 5
"""Half of so many poles are rarely higher: are the coordinates in feet?"""


def detect(
    points: Cloud | ArrayLike, *, method: str = "learned", explain: bool = False, **choices: Any
) -> pd.DataFrame:
    """Detect poles.

    Parameters
    ----------
    points : Cloud or array_like of shape (n, 3)
        Metres, any origin. ``fgi`` needs a cloud with scan lines: the columns ``scan_line`` and
        ``pulse`` (or ``gps_time``). Without ``scan_line`` it recovers the lines from ``gps_time``.
    method : {"learned", "fgi", "itc"}
        The detector.
    explain : bool
        Return every candidate, with the first test it failed in ``rejected_by`` (empty for poles);
        ``learned`` adds the measures and the contribution of each to the log odds (``adds_...``).
    **choices
        For ``learned``: ``threshold`` and ``trees`` (:func:`mmqa_lab.poles.learned.detect`).

    Returns
    -------
    DataFrame
        One row per pole, from south to north: ``id`` from 1; ``x_m``, ``y_m`` (the axis at half the
        height), ``z_base_m``, ``height_m`` (of the pole-like part), ``diameter_m`` (halfway up it),
        ``tilt_deg``, ``lean_x``, ``lean_y`` (m/m), ``score`` (0 to 1), ``method``. NaN where a
        value is not measurable. ``learned`` adds ``diameter_low_m`` and ``diameter_high_m``, a 95 %
        confidence interval; square shafts have no diameter. It adds ``section_m``, the diameter
        or else the width of what is seen: ``found[found["section_m"] < 0.35]`` leaves pillars out.

    Raises
    ------
    ValueError
        If a choice is unknown or not a number, the coordinate system is not in metres, or ``fgi``
        gets a cloud without scan lines.

    Notes
    -----
    Scores are an order, no probability: ``learned`` averages the log odds of two forests, ``fgi``
    has the share of points in the inner cylinder, ``itc`` the share of pole-like slices.

    ``learned`` looks along the cloud's longest extent in plan (``learned.own_frame``), so a cloud
    that is turned about the vertical or moved has the same poles. On a real street every second
    point changed 28 % of the finds.

    On 12 streets with gates and wires 95 % of the axes of version 0.4 were within 2.7 cm where
    ``learned`` told a diameter. Without one the axis is the middle of what is seen: within 16 cm,
    mostly trees between stakes.

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
    check_choice(method, "method", tuple(METHODS))
    module = {"learned": learned, "fgi": fgi, "itc": itc}[method]
    for name in choices:
        check_choice(name, f"choice for {method}", ("method", "explain", *CHOICES[method]))
    if "threshold" in choices:
        check_positive(choices["threshold"], "threshold")
    cloud = points if isinstance(points, Cloud) else Cloud(points)
    check_points(cloud, minimum=0, name="cloud")
    origin = np.floor(cloud.points.min(axis=0)) if len(cloud) else np.zeros(3)
    if method == "learned":
        given, origin = (cloud.points,), 0.0
    else:
        lines = (fgi.scan_lines(cloud),) if method == "fgi" else ()
        given = cloud.points - origin, *lines
    found = module.detect(*given, explain=explain, **choices)
    if not explain and len(found) >= SEVERAL and found["height_m"].median() > TALL_M:
        warnings.warn(
            f"Half of the {len(found)} poles are higher than {found['height_m'].median():.1f} m. "
            "Are the coordinates in feet? They are taken for metres.",
            stacklevel=2,
        )
    found.insert(0, "id", np.arange(1, len(found) + 1))
    found[["x_m", "y_m", "z_base_m"]] += origin
    return found
