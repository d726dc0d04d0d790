"""Resolution in images: edges, Siemens stars, bars, sharpness without targets, blur over an image.

All take an array of grey values in proportion to light. EuroSDR 2013, image radiometry, section
5.1: a star of 5 degree sectors, half a star of 10 degrees. On a circle around its centre a star of
n cycles is a wave of n / (2 pi r) cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.special import j0, j1

from mmqa_lab._checks import check_count, check_number, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.mtf.edges import SIGMAS_PX, crossing, fit_edge

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

__all__ = [
    "blur_dependence",
    "fit_edge",
    "haar_sharpness",
    "measure_star",
    "read_bars",
    "resolving_power",
]
__dir__ = __all__.copy

SQUARE = np.pi / 4
"""A square wave's amplitude over that of its fundamental."""

PLAIN_PX = 3.0
"""Pixels this far from all borders of a sector show its plain grey value."""

PLAIN_SHARE = 0.3
"""In narrower sectors those do that are farther than this share of the sector's width."""

NARROWEST_PX = 4.0
"""Width of the sectors at the outline."""

OUTLINE_SIGMAS = 3.0
"""Plain pixels are so many deviations of the blur, or more, inside of the outline."""

NEARBY = 1.2
"""Contrasts within this ratio of a share tell where the contrast falls to it."""

LENS_SHARE = 0.0015
"""By which stars err besides noise behind three simulated lenses, level and tilted (rms)."""

RING_STEP_PX, RINGS_A_WIDTH = 0.5, 4
"""Rings are two pixels wide and begin so far apart: four of them share each pixel."""

LARGEST_STRETCH = 0.1
"""A star tilted by 35 degrees is stretched by this share along one axis, shrunk along the other."""

BAR_PERIODS = 2.5
"""Bars are five of their widths long."""

CLEAR = 4.0
"""Detail counts as measurable when its energy is so many times that of the noise."""

SEEN = ("contrast", "phase_deg", "strip_share", "resolved", "reason")
"""What groups of bars take from a pattern's reading."""


@dataclass(frozen=True, eq=False)
class StarMtf(Shown):
    """The modulation transfer function that a star shows.

    Parameters
    ----------
    frequency : array, shape (k,)
        Cycles per pixel, rising.
    mtf, std : array, shape (k,)
        Contrast over that of plain sectors, and its standard error; NaN where not measurable.
    radius_px : array, shape (k,)
    centre : (float, float)
        x (column), y (row) in pixels of the given image, the first pixel's centre at 0.
    levels : (float, float)
        Grey values of plain dark and bright sectors, as they would be without blur.
    tilt_deg : float
        Angle under which the star was seen; 0 if it is round.
    levels_std : float
        Standard deviation of the contrast of plain sectors, as a share of it: by how much lenses
        differ that fit the contrasts.

    Examples
    --------
    >>> f = np.linspace(0.02, 0.5, 97)
    >>> seen = np.exp(-2 * (np.pi * 0.8 * f) ** 2)  # a Gaussian of 0.8 px
    >>> star = StarMtf(f, seen, 0 * f, 9 / f, (50.0, 50.0), (20.0, 200.0))
    >>> round(star.mtf50, 3), round(float(star.sigma_px()), 3)
    (0.234, 0.8)
    """

    frequency: np.ndarray
    mtf: np.ndarray
    std: np.ndarray
    radius_px: np.ndarray
    centre: tuple
    levels: tuple
    tilt_deg: float = 0.0
    levels_std: float = 0.0

    def at(self, share: float) -> float:
        """Frequency at which the contrast first falls to a share; NaN where it does not."""
        return self._falls_to(share)[0]

    @property
    def mtf50(self) -> float:
        """Frequency of half the contrast."""
        return self.at(0.5)

    @property
    def mtf10(self) -> float:
        """Frequency of a tenth of the contrast, the limiting resolution."""
        return self.at(0.1)

    @property
    def mtf50_sigma(self) -> float:
        """Standard deviation of the frequency of half the contrast."""
        return self._falls_to(0.5)[1]

    def _falls_to(self, share):
        """Frequency of a share of the contrast and its standard deviation.

        A line through the logarithms of the contrasts nearby over the squared frequency, since the
        first noisy value below the share comes too early.
        """
        ends = share * NEARBY, share / NEARBY
        first, last = (crossing(self.frequency, self.mtf, end) for end in ends)
        near = (self.frequency >= first) & (self.frequency <= last) & (self.mtf > 0)
        if near.sum() < 2:
            return crossing(self.frequency, self.mtf, share), np.nan
        f2, contrast = self.frequency[near] ** 2, self.mtf[near]
        relative = np.maximum(self.std[near] / contrast, 1e-9)
        line, covariance = np.polyfit(
            f2, np.log(contrast / share), 1, w=1 / relative, cov="unscaled"
        )
        place = -line[1] / line[0]
        if not place > 0:
            return crossing(self.frequency, self.mtf, share), np.nan
        terms = np.array([place, 1.0])
        spread = np.sqrt(RINGS_A_WIDTH * terms @ covariance @ terms + self.levels_std**2)
        spread /= abs(line[0])
        found = float(np.sqrt(place))
        return found, float(np.hypot(spread / (2 * found), LENS_SHARE * found))

    def sigma_px(self) -> float:
        """Standard deviation of the Gaussian whose transfer function fits, the pixel included."""
        return _gaussian_sigma(self.frequency, self.mtf)

    def psf(self, distance: ArrayLike) -> np.ndarray:
        """Point spread function of the measured contrast at distances in px, its peak 1.

        The Hankel transform of the contrast, for a function of revolution. Below and above the
        measured frequencies the fitted Gaussian takes the measurement's place.
        """
        f = np.linspace(0, 1.5, 1501)
        gaussian = np.exp(-2 * (np.pi * self.sigma_px() * f) ** 2)
        known = np.isfinite(self.mtf)
        measured = np.interp(f, self.frequency[known], self.mtf[known])
        outside = (f < self.frequency[known][0]) | (f > self.frequency[known][-1])
        contrast = np.where(outside, gaussian, measured)
        distance = np.asarray(distance, dtype=np.float64)
        spread = np.trapezoid(contrast * f * j0(2 * np.pi * distance[..., None] * f), f, axis=-1)
        return spread / np.trapezoid(contrast * f, f)

    @property
    def fwhm_px(self) -> float:
        """Full width at half maximum of the point spread function."""
        distance = np.linspace(0, 5 * self.sigma_px(), 501)
        return float(2 * np.interp(-0.5, -self.psf(distance), distance))

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the MTF with 95 % intervals."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        ax.errorbar(self.frequency, self.mtf, yerr=1.96 * self.std, fmt=".", ms=3)
        ax.set(xlabel="frequency (cycles/px)", ylabel="contrast (MTF)", ylim=(0, None))
        return ax

    def to_frame(self) -> pd.DataFrame:
        """Return ``frequency_per_px``, ``mtf``, ``mtf_std``, ``radius_px``, one row a circle."""
        return pd.DataFrame(
            {"frequency_per_px": self.frequency, "mtf": self.mtf}
            | {"mtf_std": self.std, "radius_px": self.radius_px}
        )


def measure_star(
    image: ArrayLike,
    centre: tuple[float, float],
    *,
    cycles: int,
    radius_px: float,
    azimuth_deg: tuple = (0.0, 360.0),
) -> StarMtf:
    """Measure the contrast of a Siemens star, circle by circle.

    In rings two pixels wide a constant, a wave of the star's cycles, which may change along the
    radius, and its odd harmonics as far as pixels show them are fitted to all pixels. The wave's
    amplitude over that of plain sectors, times pi/4 for their square shape, is the transfer
    function. What blur takes away in the middle of the sectors is given back to their levels, as
    much as the Gaussian takes that fits the transfer function. The centre, and the ellipse that a
    tilted star is, are refined until the wave has the same phase in all rings.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        Grey values in proportion to light.
    centre : (float, float)
        Rough x (column), y (row) of the star's centre, px, better than a quarter of a sector at
        half the radius.
    cycles : int
        Pairs of dark and bright sectors around the full circle.
    radius_px : float
        Of the star; where it is an ellipse, half of its long axis.
    azimuth_deg : (float, float)
        The part of the circle to use, from x towards y: a half star, or a direction of interest.

    Returns
    -------
    StarMtf

    Raises
    ------
    ValueError
        If the star leaves the image, is too small to show plain sectors, or is tilted by more than
        35 degrees.

    Notes
    -----
    A wrong centre costs contrast in the middle, where frequencies are high: 0.3 px takes a seventh
    of the contrast at 0.4 cycles per pixel, 1 - J0(2 pi 0.4 0.3). Plain sectors are looked for 3 px
    from their borders, where a blur of 1.5 px (sigma) takes 2 % of the contrast; a blur that is far
    from Gaussian is not fully given back.

    References
    ----------
    EuroSDR 2013, image radiometry, sections 5.1 and 5.2.

    Examples
    --------
    >>> y, x = np.mgrid[:160, :160] - 79.5
    >>> star = 100 + 80 * np.sign(np.sin(9 * np.arctan2(y, x)))
    >>> found = measure_star(star, (79.5, 79.5), cycles=9, radius_px=75)
    >>> bool(found.mtf[0] > 0.97), [round(c, 1) for c in found.centre]  # no blur but the pixel
    (True, [79.5, 79.5])
    """
    grey = np.asarray(image, dtype=np.float64)
    n = check_count(cycles, "cycles", low=2)
    radius = check_positive(radius_px, "radius_px", unit="px")
    x0, y0 = (check_number(value, "centre", unit="px") for value in centre)
    rows, columns = np.indices(grey.shape)
    used = _sector(rows - y0, columns - x0, azimuth_deg)
    pixels = (columns[used].astype(float), rows[used].astype(float), grey[used])
    place = np.array([x0, y0, 0.0, 0.0])
    _plain_levels(pixels, place, n, radius)
    rings = np.arange(n / np.pi, radius - 1 - PLAIN_PX, RING_STEP_PX)
    place = _refined(pixels, place, n, rings[rings > 1.5 * n / np.pi])
    radius *= 1 - np.hypot(*place[2:])
    rings = rings[rings < radius - 1 - PLAIN_PX]
    fits = [_ring(pixels, place, n, ring) for ring in rings]
    amplitude, std = np.array([(np.hypot(*fit[0]), fit[1]) for fit in fits]).T
    frequency = n / (2 * np.pi * rings)
    lenses, weights = _lens_of(frequency, amplitude)
    sigma = _gaussian_sigma(frequency, amplitude / amplitude.max())
    levels, borders = _plain_levels(pixels, place, n, radius, OUTLINE_SIGMAS * sigma)
    shares = np.array([_plain_share(lens, borders) for lens in lenses])
    share, differ = _weighted(shares, weights)
    levels = levels.mean() + (levels - levels.mean()) / share
    scale = 2 * SQUARE / np.ptp(levels)
    order = np.argsort(frequency)
    return StarMtf(
        frequency=frequency[order],
        mtf=(scale * amplitude)[order],
        std=(scale * std)[order],
        radius_px=rings[order],
        centre=(float(place[0]), float(place[1])),
        levels=(float(levels[0]), float(levels[1])),
        tilt_deg=_tilt(place),
        levels_std=differ / share,
    )


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
        ``resolved`` and the ``reason`` why not, as of ``chart_image.reading``.

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
    from mmqa_lab.chart_image.reading import Tones, read_pattern
    from mmqa_lab.charts import LinePairs

    image = np.asarray(image, dtype=np.float64)
    contrast = check_positive(bright - dark, "contrast of bright and dark")
    noise = check_positive(noise, "noise") / contrast
    # bright bars on a dark ground are the chart's black bars on white, turned round
    turned = (bright - image) / contrast
    rows = []
    for number, group in enumerate(groups.to_dict("records")):
        period, bars = group["period_px"], int(group["bars"])
        more = {"repeats": bars, "length": BAR_PERIODS * period}
        pairs = LinePairs(f"group {number}", 0.0, 0.0, period, "h", **more)
        reading = read_pattern(Tones(turned, noise), pairs, _place_of_bars(group))
        seen = {name: getattr(reading, name) for name in SEEN}
        rows.append(group | {"counted": reading.bars} | seen)
    return pd.DataFrame(rows)


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
        Over ``y_px``, ``x_px`` (the blocks' centres): ``sharpness``; ``along_x`` and ``along_y``,
        the same of details in one direction only (image motion along y lowers the second). NaN
        where the coarser details do not stand out from the noise.
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

    grey = np.asarray(image, dtype=np.float64)
    side = check_count(block, "block", low=8)
    if grey.ndim != 2 or min(grey.shape) < side or not np.isfinite(grey).all() or side % 4:
        raise ValueError(
            f"Invalid image of shape {grey.shape} for blocks of {side} px. Must be finite and at "
            "least a block large; the block's side must be a multiple of 4."
        )
    rows, columns = (size // side for size in grey.shape)
    approximation, fine = _haar(grey[: rows * side, : columns * side])
    coarse = _haar(approximation)[1]
    if noise_std is None:
        noise_std = float(median_abs_deviation(fine[2], axis=None, scale="normal"))
    noise = check_number(noise_std, "noise_std", low=0) ** 2
    energy = {
        level: [_block_means(part**2, rows, columns) - noise for part in details]
        for level, details in (("fine", fine), ("coarse", coarse))
    }
    # the first detail varies along rows (y), the second along columns (x), the third both
    choices = {"sharpness": (0, 1, 2), "along_x": (1,), "along_y": (0,)}
    maps = {}
    for name, parts in choices.items():
        above, below = (sum(energy[level][k] for k in parts) for level in ("fine", "coarse"))
        clear = below > CLEAR * max(noise, 1e-12) * len(parts)
        ratio = np.sqrt(np.maximum(above, 0) / np.where(clear, below, np.nan))
        maps[name] = (("y_px", "x_px"), ratio)
    centres = {"y_px": (np.arange(rows) + 0.5) * side, "x_px": (np.arange(columns) + 0.5) * side}
    missing = int(np.isnan(maps["sharpness"][1]).sum())
    about = {"noise_std": noise_std, "not_measurable": missing}
    return xr.Dataset(maps, coords=centres, attrs=about)


def _haar(grey):
    """One level of Haar wavelets: the approximation, and the details along y, x and both."""
    a, b = grey[::2, ::2], grey[::2, 1::2]
    c, d = grey[1::2, ::2], grey[1::2, 1::2]
    return (a + b + c + d) / 2, ((a + b - c - d) / 2, (a - b + c - d) / 2, (a - b - c + d) / 2)


def blur_dependence(edges: pd.DataFrame) -> pd.DataFrame:
    """Tell what the blur of edges all over an image depends on.

    The squared width is regressed on the squared distance from the image's centre, separately for
    blur along the radius and across it, and on the share of the edge's normal along the flight
    (image motion): variances of blurs add, widths do not.

    Parameters
    ----------
    edges : DataFrame
        ``x_px``, ``y_px`` from the image's centre, ``angle_deg`` (direction across the edge),
        ``fwhm_px``, one row an edge. The flight is along y.

    Returns
    -------
    DataFrame
        One row each for ``centre`` (squared FWHM there, px2), ``radial``, ``tangential`` (its
        growth per squared radius, px2 per px2) and ``flight`` (added along the flight, px2):
        ``estimate``, ``std``, ``p``, and ``n``.

    Raises
    ------
    ValueError
        If the edges do not tell the terms apart.

    References
    ----------
    EuroSDR 2013, image radiometry, chapter 5: resolution by radial, tangential, flight and
    cross-flight direction. The regression is our own.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> (x, y), angle = rng.uniform(-1, 1, (2, 50)), rng.uniform(0, 180, 50)
    >>> width = np.sqrt(2.0 + 0.5 * np.sin(np.radians(angle)) ** 2)  # motion along the flight
    >>> edges = pd.DataFrame({"x_px": x, "y_px": y, "angle_deg": angle, "fwhm_px": width})
    >>> np.abs(blur_dependence(edges)["estimate"]).round(6).tolist()
    [2.0, 0.0, 0.0, 0.5]
    """
    from statsmodels.regression.linear_model import OLS

    x, y, angle = (edges[name].to_numpy(np.float64) for name in ("x_px", "y_px", "angle_deg"))
    radius2 = x**2 + y**2
    along = np.cos(np.radians(angle) - np.arctan2(y, x)) ** 2
    terms = np.stack(
        [
            np.ones_like(x),
            radius2 * along,
            radius2 * (1 - along),
            np.sin(np.radians(angle)) ** 2,
        ],
        axis=1,
    )
    if len(terms) < 6 or np.linalg.matrix_rank(terms / terms.max(axis=0), tol=1e-6) < 4:
        raise ValueError(
            f"Invalid edges: {len(terms)} of them cannot tell four terms apart. Must lie all over "
            "the image in different directions."
        )
    fit = OLS(edges["fwhm_px"].to_numpy() ** 2, terms).fit()
    return pd.DataFrame(
        {
            "term": ["centre", "radial", "tangential", "flight"],
            "estimate": fit.params,
            "std": fit.bse,
            "p": fit.pvalues,
            "n": len(terms),
        }
    )


def _sector(dy, dx, azimuth_deg):
    """Pixels within the wanted part of the circle, clear of its limits."""
    first, last = (check_number(value, "azimuth_deg", unit="degrees") for value in azimuth_deg)
    if not 0 < last - first <= 360:
        raise ValueError(f"Invalid azimuth_deg {azimuth_deg}. Must span between 0 and 360 degrees.")
    turn = (np.degrees(np.arctan2(dy, dx)) - first) % 360
    if last - first == 360:
        return np.ones(dx.shape, dtype=bool)
    r = np.hypot(dx, dy)
    to_limits = np.radians(np.minimum(turn, last - first - turn))
    return (to_limits > 0) & (r * np.sin(np.minimum(to_limits, np.pi / 2)) > PLAIN_PX)


def _polar(pixels, place):
    """Radius and azimuth of pixels about a centre, on the round star that is seen as an ellipse."""
    x, y, a, b = place
    dx, dy = pixels[0] - x, pixels[1] - y
    dx, dy = (1 + a) * dx + b * dy, b * dx + (1 - a) * dy
    return np.hypot(dx, dy), np.arctan2(dy, dx)


def _tilt(place):
    """The angle under which a star has the axes of this ellipse, degrees."""
    stretch = np.hypot(*place[2:])
    return float(np.degrees(np.arccos((1 - stretch) / (1 + stretch))))


def _plain_levels(pixels, place, n, radius, clear=0.0):
    """Grey values in the middle of the sectors near the outline, and the distances from borders.

    Levels as an array, dark first; of each pixel used the distances from both its borders.
    """
    r, azimuth = _polar(pixels, place)
    outer = (r > 0.75 * radius) & (r < radius - max(PLAIN_PX, clear))
    if outer.sum() < 4 * n or np.pi * radius / n < NARROWEST_PX:
        raise ValueError(
            f"Invalid star of {n} cycles and radius {radius:g} px. Must lie in the image and be "
            f"larger than {NARROWEST_PX * n / np.pi:.0f} px to show plain sectors."
        )
    values = pixels[2][outer]
    phase = n * azimuth[outer]
    design = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    _, c, s = np.linalg.lstsq(design, values, rcond=None)[0]
    turned = (phase - np.arctan2(s, c)) / (2 * np.pi)
    from_peak = np.abs(turned - np.round(turned))
    width = np.pi * r[outer] / n
    near = np.abs(from_peak - 0.25) * 2 * width
    plain = near > np.minimum(PLAIN_PX, PLAIN_SHARE * width)
    bright = from_peak < 0.25
    levels = np.array([values[plain & ~bright].mean(), values[plain & bright].mean()])
    return levels, np.stack([near[plain], (width - near)[plain]])


def _weighted(values, weights):
    """Return the mean and the standard deviation of values with weights; those of none are 0."""
    weights = weights / weights.sum()
    values = np.where(weights > 0, values, 0.0)
    mean = float(weights @ values)
    return mean, float(np.sqrt(weights @ (values - mean) ** 2))


def _disc(x):
    """Transfer of a defocused lens at cycles per radius."""
    turn = 2 * np.pi * np.maximum(x, 1e-9)
    return 2 * j1(turn) / turn


def _diffraction(x):
    """Transfer of a perfect lens at a share of its highest frequency."""
    x = np.minimum(x, 1)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2))


LENS_TRANSFERS = {
    "gaussian": lambda x: np.exp(-2 * (np.pi * x) ** 2),
    "disc": _disc,
    "diffraction": _diffraction,
}


def _lens_mtf(shape, width, frequencies):
    """Return the transfer function of a lens and a square pixel, the mean of all directions."""
    turn = np.radians(np.arange(2.5, 45, 5))[:, None]
    f = np.ravel(frequencies)
    pixel = (np.sinc(f * np.cos(turn)) * np.sinc(f * np.sin(turn))).mean(axis=0)
    return (LENS_TRANSFERS[shape](f * width) * pixel).reshape(np.shape(frequencies))


def _lens_of(frequency, contrast):
    """Transfer functions of the lenses whose shape fits contrasts up to a scale, and weights.

    The contrast of plain sectors is not needed: a lens transfers everything at frequency zero.
    """
    from scipy.optimize import minimize_scalar

    known = np.isfinite(contrast) & (contrast > 0.05 * np.nanmax(contrast))
    f, seen = frequency[known], contrast[known]

    def misfit(log_width, shape):
        """What is left of the contrasts with the best scale."""
        model = np.abs(_lens_mtf(shape, np.exp(log_width), f))
        return ((seen - model * (model @ seen) / (model @ model)) ** 2).sum()

    fits = [
        minimize_scalar(misfit, bounds=np.log(SIGMAS_PX), args=(shape,), method="bounded")
        for shape in LENS_TRANSFERS
    ]
    left = np.array([max(fit.fun, 1e-12) for fit in fits])
    weights = np.exp(-len(f) / RINGS_A_WIDTH * (left / left.min() - 1) / 2)
    lenses = [
        partial(_lens_mtf, shape, float(np.exp(fit.x)))
        for shape, fit in zip(LENS_TRANSFERS, fits, strict=True)
    ]
    return lenses, weights


def _plain_share(lens, borders):
    """Share of the contrast that a lens leaves in the middle of the sectors, a square wave."""
    width, total = borders.sum(axis=0), 0.0
    for k in range(1, 22, 2):
        left = lens(k / (2 * width))
        total = total + left * np.sin(np.pi * k * borders[0] / width) / (SQUARE * k)
    return float(total.mean())


def _gaussian_sigma(frequency, mtf):
    """Standard deviation (px) of the Gaussian whose transfer function fits best."""
    good = (mtf > 0.1) & np.isfinite(mtf)
    f2, weight = frequency[good] ** 2, mtf[good] ** 2
    slope = (weight * f2) @ -np.log(mtf[good]) / ((weight * f2) @ f2)
    return float(np.sqrt(max(slope, 1e-12) / (2 * np.pi**2)))


def _ring(pixels, place, n, ring):
    """Cosine and sine amplitude of the wave at a radius, and their standard error."""
    r, azimuth = _polar(pixels, place)
    inside = np.abs(r - ring) < 1
    wave = np.stack([np.cos(n * azimuth[inside]), np.sin(n * azimuth[inside])])
    off = r[inside] - ring
    terms = [np.ones_like(off), *wave, *(off * wave)]
    for k in (3, 5):
        if k * n / (2 * np.pi * ring) < 0.45:
            terms += [np.cos(k * n * azimuth[inside]), np.sin(k * n * azimuth[inside])]
    design = np.stack(terms, axis=1)
    values = pixels[2][inside]
    coefficients, *_ = np.linalg.lstsq(design, values, rcond=None)
    residuals = values - design @ coefficients
    variance = residuals @ residuals / max(len(values) - len(terms), 1)
    covariance = variance * np.linalg.pinv(design.T @ design)
    return coefficients[1:3], np.sqrt((covariance[1, 1] + covariance[2, 2]) / 2)


def _refined(pixels, place, n, rings):
    """Centre and ellipse about which the wave keeps its phase over the rings and around them."""
    from scipy.optimize import least_squares

    r, _ = _polar(pixels, place)
    near = (r > 0.9 * rings[0] - 1) & (r < 1.1 * min(rings[-1], 6 * rings[0]))
    points = [values[near] for values in pixels]

    def misfit(place, points=points):
        """Residuals of one wave over all rings whose amplitude falls with frequency squared."""
        radius, azimuth = _polar(points, place)
        wave = np.stack([np.cos(n * azimuth), np.sin(n * azimuth)])
        f2 = (n / (2 * np.pi * np.maximum(radius, 1))) ** 2
        design = np.stack([np.ones_like(f2), *wave, *(f2 * wave), *(f2**2 * wave)], axis=1)
        coefficients, *_ = np.linalg.lstsq(design, points[2], rcond=None)
        return points[2] - design @ coefficients

    # a stretch turns the wave by up to n times itself; beyond a radian the fit would lose it
    steps = np.arange(-1, 1.01, min(1.0, 1.2 / (n * LARGEST_STRETCH))) * LARGEST_STRETCH
    some = [values[:: len(r) // 3000 + 1] for values in points]
    starts = [[*place[:2], a, b] for a in steps - steps.mean() for b in steps - steps.mean()]
    best = min(starts, key=lambda start: (misfit(start, some) ** 2).sum())
    scale = np.array([1.0, 1.0, 1 / rings[-1], 1 / rings[-1]])
    found = least_squares(lambda p: misfit(p * scale), best / scale, xtol=1e-7).x * scale
    if np.hypot(*found[2:]) > LARGEST_STRETCH:
        raise ValueError(
            f"Invalid star, tilted by {_tilt(found):.0f} degrees. Must be tilted by "
            f"{_tilt([0, 0, LARGEST_STRETCH, 0]):.0f} degrees or less."
        )
    return found


def _place_of_bars(group):
    """Where the group lies in the image."""
    from mmqa_lab.chart_image.geometry import ChartMap

    period, bars = group["period_px"], group["bars"]
    turn = np.radians(group["angle_deg"])
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    size = np.array([(bars - 0.5) * period, BAR_PERIODS * period])
    low = np.array([group["x_px"], group["y_px"]]) - across * size[0] / 2 - along * size[1] / 2
    places = np.array([[0, 0], [size[0], 0], size, [0, size[1]]])
    pixels = low + places[:, :1] * across + places[:, 1:] * along
    return ChartMap.from_points(places, pixels, source="group of bars")


def _block_means(values, rows, columns):
    """Means over the blocks of an array, shape (rows, columns)."""
    high, wide = values.shape[0] // rows, values.shape[1] // columns
    return values.reshape(rows, high, columns, wide).mean(axis=(1, 3))
