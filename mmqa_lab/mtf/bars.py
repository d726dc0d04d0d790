"""Groups of bars, read by the rule of the chart's line pairs."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_positive
from mmqa_lab.chart_image import ChartMap, Tones, read_pattern, resolution
from mmqa_lab.charts import LinePairs

__all__ = ["read_bars", "resolving_power"]
__dir__ = __all__.copy

BAR_PERIODS = 2.5
"""Bars are five of their widths long."""


def read_bars(
    image: ArrayLike, groups: pd.DataFrame, *, dark: float, bright: float, noise: float
) -> pd.DataFrame:
    """Read groups of bright bars on a dark ground.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    groups : DataFrame
        One row a group, as far as known from its place on the ground: ``period_px`` (a bright and a
        dark bar), ``x_px``, ``y_px`` (column and row of its middle, the first pixel's centre at 0),
        ``angle_deg`` (direction across the bars from x towards y), ``bars``.
    dark, bright : float
        Grey values of wide dark and bright areas.
    noise : float
        Standard deviation of a pixel, in grey values.

    Returns
    -------
    DataFrame
        The groups with ``contrast``, ``counted`` (bars), ``phase_deg``, ``strip_share``,
        ``resolved`` and the ``reason`` why not, as of ``chart_image.read_pairs``.

    Raises
    ------
    ValueError
        If bright is not above dark or the noise is not above zero.

    Examples
    --------
    >>> x = np.arange(80)[None, :].repeat(40, axis=0)
    >>> bright = 20 + 60 * ((x - 10) // 4 % 2 == 0) * (x >= 10) * (x < 50)
    >>> group = {"period_px": 8.0, "x_px": 27.5, "y_px": 20.0, "angle_deg": 0.0, "bars": 5}
    >>> found = read_bars(bright, pd.DataFrame([group]), dark=20, bright=80, noise=1.0)
    >>> bool(found["resolved"].item()), round(found["counted"].item())
    (True, 5)
    """
    contrast = check_positive(bright - dark, "contrast of bright and dark")
    # bright bars on a dark ground are the chart's black bars on white, turned round
    dimness = (bright - np.asarray(image, dtype=np.float64)) / contrast
    tones, readings = Tones(dimness, check_positive(noise, "noise") / contrast), []
    for group in groups.to_dict("records"):
        size = {"repeats": int(group["bars"]), "length": BAR_PERIODS * group["period_px"]}
        pairs = LinePairs("group", 0.0, 0.0, group["period_px"], "h", **size)
        readings.append(read_pattern(tones, pairs, _place_of_bars(group)))
    seen = pd.DataFrame(readings).rename(columns={"bars": "counted"})
    figures = ["counted", "contrast", "phase_deg", "strip_share", "resolved", "reason"]
    return groups.reset_index(drop=True).join(seen[figures])


def resolving_power(readings: pd.DataFrame) -> tuple[float, float]:
    """Return the period of the narrowest group resolved with all wider ones, and of the next.

    Parameters
    ----------
    readings : DataFrame
        From ``read_bars``, of one direction.

    Returns
    -------
    period_px, next_px : float
        The resolving power lies between 1 / period and 1 / next line pairs per pixel. NaN where no
        group is resolved, or all are.

    Examples
    --------
    >>> ladder = pd.DataFrame({"period_px": [6, 4, 3], "resolved": [True, True, False]})
    >>> resolving_power(ladder)
    (4.0, 3.0)
    """
    ladder = readings[["period_px", "resolved"]].rename(columns={"period_px": "width_mm"})
    found = resolution(ladder.assign(direction="h"), "h")
    return found.width_mm, found.next_mm


def _place_of_bars(group):
    """Where the group lies in the image."""
    period, bars = group["period_px"], group["bars"]
    turn = np.radians(group["angle_deg"])
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    low = np.array([group["x_px"], group["y_px"]]) - across * (bars - 0.5) * period / 2
    low -= along * BAR_PERIODS * period / 2
    matrix = np.vstack([np.column_stack([across, along, low]), [0, 0, 1]])
    return ChartMap(matrix, source="group of bars")
