"""Resolving power from groups of line bars: the narrowest group that is detectable.

EuroSDR 2013, image radiometry, chapter 5 and Table 4, where the narrowest detectable bars are found
automatically by a criterion that is not printed. The decision here is that of
``chart_image.line_pairs``: every gap must stand out from both its bars, and the bars must have the
number, the frequency and the place that are on the ground, so that aliases do not count.
"""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_positive
from mmqa_lab.chart_image.levels import Tones
from mmqa_lab.chart_image.line_pairs import read_pattern
from mmqa_lab.chart_image.mapping import ChartMap
from mmqa_lab.charts import LinePairs

LENGTH_PERIODS = 2.5
"""Bars are five of their widths long."""


def read_bars(image, groups, *, dark, bright, noise):
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
        ``resolved`` and the ``reason`` why not, as of ``chart_image.line_pairs``.

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
    image = np.asarray(image, dtype=np.float64)
    contrast = check_positive(bright - dark, "contrast of bright and dark")
    noise = check_positive(noise, "noise") / contrast
    # bright bars on a dark ground are the chart's black bars on white, turned round
    turned = (bright - image) / contrast
    rows = []
    for number, group in enumerate(groups.to_dict("records")):
        reading = read_pattern(
            Tones(turned, noise, 0.0, 1.0, 0.0, 0, 0),
            _pairs(group, number),
            _map(group),
        )
        rows.append(
            group
            | {"contrast": reading.contrast, "counted": reading.bars}
            | {"phase_deg": reading.phase_deg, "strip_share": reading.strip_share}
            | {"resolved": reading.resolved, "reason": reading.reason}
        )
    return pd.DataFrame(rows)


def resolving_power(readings):
    """Return the period of the narrowest group resolved with all wider ones, and of the next.

    Parameters
    ----------
    readings : DataFrame
        From ``read_bars``, of one direction.

    Returns
    -------
    period_px, next_px : float
        The resolving power lies between 1 / period and 1 / next line pairs per pixel. NaN where no
        group is resolved, or none is not.

    Examples
    --------
    >>> ladder = pd.DataFrame({"period_px": [6, 4, 3], "resolved": [True, True, False]})
    >>> resolving_power(ladder)
    (4.0, 3.0)
    """
    ladder = readings.sort_values("period_px", ascending=False)
    periods, resolved = ladder["period_px"].to_numpy(np.float64), ladder["resolved"].to_numpy(bool)
    good = len(resolved) if resolved.all() else int(np.argmin(resolved))
    return (
        float(periods[good - 1]) if good else np.nan,
        float(periods[good]) if good < len(periods) else np.nan,
    )


def _pairs(group, number):
    """The group as line pairs in units of pixels, its low end in (0, 0)."""
    period = group["period_px"]
    length = LENGTH_PERIODS * period
    return LinePairs(
        f"group {number}", 0.0, 0.0, period, "h", repeats=int(group["bars"]), length=length
    )


def _map(group):
    """Where the group lies in the image."""
    period, bars = group["period_px"], group["bars"]
    turn = np.radians(group["angle_deg"])
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    size = np.array([(bars - 0.5) * period, LENGTH_PERIODS * period])
    low = np.array([group["x_px"], group["y_px"]]) - across * size[0] / 2 - along * size[1] / 2
    places = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    pixels = low + places[:, :1] * across + places[:, 1:] * along
    return ChartMap.from_points(places, pixels, source="group of bars")
