"""Siemens stars: contrast over frequency, circle by circle.

A star of 5 degree sectors, half a star of 10 degrees (EuroSDR 2013, image radiometry, section 5.1).
On a circle around its centre a star of n cycles is a wave of n / (2 pi r) cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import least_squares, minimize_scalar

from mmqa_lab._checks import check_count, check_image, check_number, check_positive, refuse
from mmqa_lab._results import Shown, about
from mmqa_lab.mtf.doubts import STAR_PARTS, TAILED, check_cycles, clipped_side, remarks_on_star
from mmqa_lab.mtf.transfer import (
    FITTED_TRANSFERS,
    FREQUENCIES,
    SIGMOID_PX,
    crossing,
    lens_mtf,
    tail_mtf,
)

__all__ = ["StarMtf", "measure_star"]

PLAIN_PX = 3.0
"""Pixels this far from all borders of a sector show its plain grey value."""

NARROWEST_PX = 4.0
"""Width of the sectors at the outline."""

NEARBY = 1.2
"""Contrasts within this ratio of a share tell where the contrast falls to it."""

RING_STEP_PX, RINGS_A_WIDTH = 0.5, 4
"""Distance between the beginnings of rings, which are two pixels wide: four rings share a pixel."""

TAILS_PX, BY_TAIL = (1.0, 1.5, 2.0, 3.0, 4.0), 60.0
"""Widths of tails that may stand beside a lens's own shape; and by how many squares of a ring's
noise one must lessen what is left."""

LEAST_NOISE = 0.007
"""Noise of a pixel, over the step between plain sectors, from which it tells of sharpening."""

LEAST_CONTRAST = 0.3
"""Contrast from which a transfer above the best lens's is sharpening."""

LARGEST_STRETCH = 0.1
"""A star tilted by 35 degrees is stretched by this share along one axis, shrunk along the other."""


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
    tilt_deg : float
        Angle under which the star was seen; 0 if it is round.
    tail : float
        Share of light in a lens's tails, which the sectors tell badly; below zero what sharpening
        adds to its middle.
    remarks : tuple of str
        Reasons to doubt the figures; empty if there are none.

    Examples
    --------
    >>> f = np.linspace(0.02, 0.5, 97)
    >>> seen = np.exp(-2 * (np.pi * 0.8 * f) ** 2)  # a Gaussian of 0.8 px
    >>> star = StarMtf(f, seen, 0 * f, 9 / f, (50.0, 50.0))
    >>> round(star.mtf50, 3)
    0.234
    """

    frequency: np.ndarray
    mtf: np.ndarray
    std: np.ndarray
    radius_px: np.ndarray
    centre: tuple
    tilt_deg: float = 0.0
    tail: float = 0.0
    remarks: tuple[str, ...] = ()

    def at(self, share: float) -> float:
        """Frequency at which the contrast first falls to a share; NaN where it does not.

        That of a tenth, ``at(0.1)``, is the limiting resolution.
        """
        return self._falls_to(share)[0]

    @property
    def mtf50(self) -> float:
        """Frequency of half the contrast."""
        return self.at(0.5)

    @property
    def mtf50_sigma(self) -> float:
        """Standard deviation of the frequency of half the contrast."""
        return self._falls_to(0.5)[1]

    def _ends(self):
        return [about("mtf50", *self._falls_to(0.5), "1/px")]

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
        weight = {"w": 1 / relative, "cov": "unscaled"}
        line, covariance = np.polyfit(f2, np.log(contrast / share), 1, **weight)
        place = -line[1] / line[0]
        if not place > 0:
            return crossing(self.frequency, self.mtf, share), np.nan
        terms = np.array([place, 1.0])
        spread = np.sqrt(RINGS_A_WIDTH * terms @ covariance @ terms) / abs(line[0])
        found = float(np.sqrt(place))
        # besides noise, stars err by .15 % behind three simulated lenses, level and tilted
        other = TAILED / 2 if self.tail > 0 else 0.0015
        return found, float(np.hypot(spread / (2 * found), other * found))

    def to_frame(self) -> pd.DataFrame:
        """Return ``frequency_per_px``, ``mtf``, ``mtf_std``, ``radius_px``, one row a circle."""
        columns = {"frequency_per_px": self.frequency, "mtf": self.mtf}
        return pd.DataFrame(columns | {"mtf_std": self.std, "radius_px": self.radius_px})


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
    much as a lens takes that fits the transfer function: Gaussian, disc, diffraction or one that
    falls by e, each with or without long tails. The centre,
    and the ellipse that a tilted star is, are refined until the wave has the same phase in all
    rings.

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
        If the star leaves the image, is too small to show plain sectors, shows another number of
        cycles, or is tilted by more than 35 degrees.

    See Also
    --------
    fit_edge : from one edge, which any photograph may have.

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
    grey = check_image(image)
    n = check_count(cycles, "cycles", low=2)
    radius = check_positive(radius_px, "radius_px", unit="px")
    x0, y0 = (check_number(value, "centre", unit="px") for value in centre)
    rows, columns = np.meshgrid(*map(np.arange, grey.shape), indexing="ij")
    used = _sector(rows - y0, columns - x0, azimuth_deg)
    pixels = (columns[used].astype(float), rows[used].astype(float), grey[used])
    place = np.array([x0, y0, 0.0, 0.0])
    _plain_levels(pixels, place, n, radius)
    rings = np.arange(n / np.pi, radius - 1 - PLAIN_PX, RING_STEP_PX)
    place = _refined(pixels, place, n, rings[rings > 1.5 * n / np.pi])
    waves = _outer_parts(pixels, place, n, radius)
    check_cycles(waves, n)
    tilt, most = (f"{_tilt(one):.0f} degrees" for one in (place, [0, 0, LARGEST_STRETCH, 0]))
    tilted = np.hypot(*place[2:]) > LARGEST_STRETCH
    refuse(tilted, "star", f"tilted by {tilt}", f"tilted by {most} or less")
    radius *= 1 - np.hypot(*place[2:])
    rings = rings[rings < radius - 1 - PLAIN_PX][::-1]
    fits = [_ring(pixels, place, n, ring) for ring in rings]
    amplitude, std = np.array([(np.hypot(*fit[0]), fit[1]) for fit in fits]).T
    frequency = n / (2 * np.pi * rings)
    lens, tail = _lens_of(frequency, amplitude)
    # three standard deviations of the Gaussian of the same MTF50
    clear = 0.56 / crossing(FREQUENCIES, lens(FREQUENCIES), 0.5)
    levels, borders, clipped = _plain_levels(pixels, place, n, radius, clear)
    scale, centre = 2 * _plain_level(lens, borders) / np.ptp(levels), tuple(place[:2].tolist())
    outer = 0.8 * radius
    first = lens(n / (2 * np.pi * outer))
    square = [lens(k * n / (2 * np.pi * outer)) / first for k in (2, 3)]
    waves_seen = _harmonics(pixels, place, n, outer)
    model = np.abs(lens(frequency))
    above = scale * (amplitude - 3 * std) - model  # more than noise
    beyond = float(above[model > LEAST_CONTRAST].max(initial=0))
    soft = lens(0.5) < LEAST_CONTRAST / 2  # sharp ones leave waves beside noise
    alike = _neighbours(pixels, place, n, radius, np.ptp(levels)) if soft else (0.0, 1)
    remarks = remarks_on_star(waves, clipped, waves_seen, square, beyond, tail, alike)
    known = {"centre": centre, "tilt_deg": _tilt(place), "tail": tail, "remarks": remarks}
    return StarMtf(frequency, scale * amplitude, scale * std, rings, **known)


def _sector(dy, dx, azimuth_deg):
    """Pixels within the wanted part of the circle, clear of its limits."""
    first, last = (check_number(value, "azimuth_deg", unit="degrees") for value in azimuth_deg)
    if not 0 < last - first <= 360:
        raise ValueError(f"Invalid azimuth_deg {azimuth_deg}. Must span between 0 and 360 degrees.")
    turn = (np.degrees(np.arctan2(dy, dx)) - first) % 360
    to_limits = np.radians(np.clip(np.minimum(turn, last - first - turn), 0, 90))
    return (np.hypot(dx, dy) * np.sin(to_limits) > PLAIN_PX) | (last - first == 360)


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
    small = outer.sum() < 4 * n or np.pi * radius / n < NARROWEST_PX
    must = f"in the image and larger than {NARROWEST_PX * n / np.pi:.0f} px to show plain sectors"
    refuse(small, "star", f"{n} cycles, radius {radius:g} px", must)
    values = pixels[2][outer]
    phase = n * azimuth[outer]
    design = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    _, c, s = np.linalg.lstsq(design, values, rcond=None)[0]
    turned = (phase - np.arctan2(s, c)) / (2 * np.pi)
    from_peak = np.abs(turned - np.round(turned))
    width = np.pi * r[outer] / n
    near = np.abs(from_peak - 0.25) * 2 * width
    plain = near > np.minimum(PLAIN_PX, 0.3 * width)
    bright = from_peak < 0.25
    sides = [values[plain & ~bright], values[plain & bright]]
    levels = np.array([side.mean() for side in sides])
    rounding = float(np.diff(np.unique(pixels[2])).min(initial=np.inf))
    clipped = clipped_side(*sides, rounding)
    return levels, np.stack([near[plain], (width - near)[plain]]), clipped


def _outer_parts(pixels, place, n, radius):
    """The wave of n cycles near the outline in parts of the circle, as complex numbers."""
    r, azimuth = _polar(pixels, place)
    outer = (r > 0.6 * radius) & (r < 0.9 * radius)
    part = np.floor(azimuth[outer] * STAR_PARTS / (2 * np.pi)).astype(int) % STAR_PARTS
    count, values = np.bincount(part, minlength=STAR_PARTS), pixels[2][outer]
    mean = np.bincount(part, values, STAR_PARTS) / np.maximum(count, 1)
    wave = (values - mean[part]) * np.exp(-1j * n * azimuth[outer])
    sums = np.bincount(part, wave.real, STAR_PARTS) + 1j * np.bincount(part, wave.imag, STAR_PARTS)
    full = count > count.max() / 2
    return sums[full] / count[full]


def _lens_of(frequency, contrast):
    """Transfer function of the lens whose shape fits contrasts up to a scale, and its tail's share.

    The contrast of plain sectors is not needed: a lens transfers everything at frequency zero. A
    tail counts where it explains far more than noise does; below zero it is what sharpening adds.
    """
    known = np.isfinite(contrast) & (contrast > 0.05 * np.nanmax(contrast))
    f, seen = frequency[known], contrast[known]

    def parts(log_width, transfer, tail):
        """What the lens leaves, and what its tail does, of a wave; and the best share of both."""
        model = np.abs(lens_mtf(transfer, np.exp(log_width), f))
        model = np.column_stack([model, model * tail_mtf(f * tail)][: 1 + (tail > 0)])
        return model, np.linalg.lstsq(model, seen, rcond=None)[0]

    def misfit(*given):
        """Sum of squares that the best scale leaves."""
        model, share = parts(*given)
        return np.square(seen - model @ share).sum()

    choices = {"bounds": np.log(SIGMOID_PX), "method": "bounded"}
    best = []
    for tails in ((0.0,), TAILS_PX):
        kinds = [(one, tail) for one in FITTED_TRANSFERS for tail in tails]
        fits = {kind: minimize_scalar(misfit, args=kind, **choices) for kind in kinds}
        kind = min(fits, key=lambda one: fits[one].fun)
        best.append((kind, fits[kind]))
    (plain, without), ((transfer, tail), fit) = best
    share = parts(fit.x, transfer, tail)[1]
    share = float(share[1] / share.sum())
    lens = partial(lens_mtf, plain[0], float(np.exp(without.x)))
    if len(f) * (without.fun - fit.fun) < BY_TAIL * fit.fun:
        return lens, 0.0
    if share <= 0:
        return lens, share
    wide = partial(lens_mtf, transfer, float(np.exp(fit.x)))
    return lambda q: wide(q) * (1 - share + share * tail_mtf(np.asarray(q) * tail)), share


def _plain_level(lens, borders):
    """Level in the middle of the sectors behind a lens, of a square wave with fundamental 1."""
    width, total = borders.sum(axis=0), 0.0
    for k in range(1, 22, 2):
        left = lens(k / (2 * width))
        total = total + left * np.sin(np.pi * k * borders[0] / width) / k
    return float(total.mean())


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
    design, values = np.stack(terms, axis=1), pixels[2][inside]
    coefficients = np.linalg.lstsq(design, values, rcond=None)[0]
    residuals = values - design @ coefficients
    variance = residuals @ residuals / max(len(values) - len(terms), 1)
    covariance = variance * np.linalg.pinv(design.T @ design)
    return coefficients[1:3], np.sqrt((covariance[1, 1] + covariance[2, 2]) / 2)


def _neighbours(pixels, place, n, radius, step):
    """Correlation of the noise of neighbouring pixels near the outline, and how many pairs.

    Zero where there is too little noise: of what is left, too much are waves then.
    """
    r, azimuth = _polar(pixels, place)
    outer = (r > 0.6 * radius) & (r < radius - PLAIN_PX)
    x, y = (values[outer].astype(int) for values in pixels[:2])
    r, azimuth, values = r[outer], azimuth[outer], pixels[2][outer]
    left, ring = np.full((y.max() + 1, x.max() + 1), np.nan), np.floor(r / 2).astype(int)
    for one in np.unique(ring):
        part = np.flatnonzero(ring == one)
        turns = np.outer(azimuth[part], n * np.arange(1, 10))
        waves = np.column_stack([np.cos(turns), np.sin(turns)])
        off = (r[part] - r[part].mean())[:, None]
        design = np.column_stack([np.ones(len(part)), waves, off * waves])
        known = np.linalg.lstsq(design, values[part], rcond=None)[0]
        left[y[part], x[part]] = values[part] - design @ known
    beside = np.concatenate([(left[:, 1:] * left[:, :-1]).ravel(), (left[1:] * left[:-1]).ravel()])
    variance, pairs = np.nanmean(left**2), int(np.isfinite(beside).sum())
    enough = variance > (LEAST_NOISE * step) ** 2
    return (float(np.nanmean(beside) / variance) if enough else 0.0), pairs


def _harmonics(pixels, place, n, ring):
    """Amplitudes of waves of two and three times the cycles over the star's own."""
    r, azimuth = _polar(pixels, place)
    inside = np.abs(r - ring) < 2
    turns = np.outer(azimuth[inside], n * np.arange(1, 4))
    design = np.column_stack([np.ones(len(turns)), np.cos(turns), np.sin(turns)])
    found = np.linalg.lstsq(design, pixels[2][inside], rcond=None)[0]
    size = np.hypot(found[1:4], found[4:])
    return size[1:] / size[0]


def _refined(pixels, place, n, rings):
    """Centre and ellipse about which the wave keeps its phase over the rings and around them."""
    r, _ = _polar(pixels, place)
    near = (r > 0.9 * rings[0] - 1) & (r < 1.1 * min(rings[-1], 6 * rings[0]))
    points = [values[near] for values in pixels]

    def misfit(place, points=points):
        """Residuals of one wave over all rings whose amplitude falls with frequency squared."""
        radius, azimuth = _polar(points, place)
        wave = np.stack([np.cos(n * azimuth), np.sin(n * azimuth)])
        f2 = (n / (2 * np.pi * np.maximum(radius, 1))) ** 2
        design = np.stack([np.ones_like(f2), *wave, *(f2 * wave), *(f2**2 * wave)], axis=1)
        return points[2] - design @ np.linalg.lstsq(design, points[2], rcond=None)[0]

    # a stretch turns the wave by up to n times itself; beyond a radian the fit would lose it
    steps = np.arange(-1, 1.01, min(1.0, 1.2 / (n * LARGEST_STRETCH))) * LARGEST_STRETCH
    some = [values[:: len(r) // 3000 + 1] for values in points]
    starts = [[*place[:2], a, b] for a in steps - steps.mean() for b in steps - steps.mean()]
    best = min(starts, key=lambda start: (misfit(start, some) ** 2).sum())
    scale = np.array([1.0, 1.0, 1 / rings[-1], 1 / rings[-1]])
    found = least_squares(lambda p: misfit(p * scale), best / scale, xtol=1e-7, max_nfev=50)
    return found.x * scale
