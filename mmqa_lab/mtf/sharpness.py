"""Sharpness of images without targets, and bars read by the rule of the chart's line pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import (
    check_columns,
    check_count,
    check_image,
    check_number,
    check_positive,
    refuse,
)
from mmqa_lab.chart_image import ChartMap, Tones, read_pattern, resolution
from mmqa_lab.charts import LinePairs

__all__ = ["haar_sharpness", "read_bars", "resolving_power"]


if TYPE_CHECKING:
    import xarray as xr

BAR_PERIODS = 2.5
"""Bars are five of their widths long."""


def haar_sharpness(
    image: ArrayLike, *, block: int = 64, noise_std: float | None = None
) -> xr.Dataset:
    """Map the sharpness of an image, block by block.

    Two levels of the Haar transform; in each block the root mean square of the details of the
    finest level over that of the next, each less what noise adds. On the same scene a blurred image
    gives less.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    block : int
        Side of the blocks, px, a multiple of 4; the rest at the right and lower edge is left out.
    noise_std : float, optional
        Standard deviation of the noise, in grey values. Estimated from the finest diagonal details
        where left out, which takes fine texture for noise.

    Returns
    -------
    Dataset
        ``sharpness`` over ``y_px``, ``x_px`` (the blocks' centres); NaN where the coarser details
        do not stand out from the noise.
        ``attrs``: ``noise_std`` used, ``not_measurable`` (count of blocks).

    Raises
    ------
    ValueError
        If the image is smaller than a block or not finite.

    Notes
    -----
    A sharp edge has as much detail at both levels, fine texture has more at the finest: values
    about 0.5 to 1 are usual. Compare images of the same ground, or take the median of many images
    at each place of the image plane, so that the scenes even out.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(size=(64, 64))
    >>> haar_sharpness(noise, noise_std=0)["sharpness"].round(1).item()
    1.0
    """
    import xarray as xr
    from scipy.stats import median_abs_deviation

    grey, side = check_image(image), check_count(block, "block", low=8)
    found = f"{grey.shape} pixels for blocks of {side} px"
    must = "at least a block large; the block's side must be a multiple of 4"
    refuse(min(grey.shape) < side or side % 4, "image", found, must)
    rows, columns = (size // side for size in grey.shape)
    approximation, fine = _haar(grey[: rows * side, : columns * side])
    coarse = _haar(approximation)[1]
    if noise_std is None:
        noise_std = float(median_abs_deviation(fine[2], axis=None, scale="normal"))
    noise = check_number(noise_std, "noise_std", low=0) ** 2
    above, below = (
        sum(cv2.resize(part**2, (columns, rows), interpolation=cv2.INTER_AREA) for part in details)
        - 3 * noise
        for details in (fine, coarse)
    )
    rounding = (1e-12 * np.abs(grey).max()) ** 2
    clear = below > 4 * max(noise, rounding) * len(fine)
    ratio = np.sqrt(np.maximum(above, 0) / np.where(clear, below, np.nan))
    centres = {"y_px": (np.arange(rows) + 0.5) * side, "x_px": (np.arange(columns) + 0.5) * side}
    about = {"noise_std": noise_std, "not_measurable": int((~clear).sum())}
    return xr.Dataset({"sharpness": (("y_px", "x_px"), ratio)}, coords=centres, attrs=about)


def _haar(grey):
    """One level of Haar wavelets: the approximation, and the details along y, x and both."""
    a, b = grey[::2, ::2], grey[::2, 1::2]
    c, d = grey[1::2, ::2], grey[1::2, 1::2]
    return (a + b + c + d) / 2, ((a + b - c - d) / 2, (a - b + c - d) / 2, (a - b - c + d) / 2)


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
    check_columns(readings, ("period_px", "resolved"), "readings")
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
