"""Edges, Siemens stars and line bars whose point spread function is known.

Coordinates are pixels from the image's centre, x along columns to the right, y along rows downwards
(the flight). Targets are drawn on a grid several times finer than the pixels, filtered with the
exact transfer function of lens and square pixel, and read at the pixels' centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

from mmqa_lab._checks import check_choice, check_count, check_number, check_positive
from mmqa_lab._streams import stream
from mmqa_lab.mtf.transfer import LENS_TRANSFERS, lens_mtf

__all__ = [
    "FINE", "PointSpread", "blur_over_image", "expose", "render_bars", "render_edge",
    "render_star", "texture",
]  # fmt: skip

FINE = 8
"""Samples a pixel of the grid that targets are drawn on."""


READ_NOISE_DN, ELECTRONS_PER_DN = 2.0, 10.0
"""Of simulated sensors: shot noise has the variance DN / electrons per DN."""


@dataclass(frozen=True)
class PointSpread:
    """The point spread function of a camera: a round lens and a square pixel.

    Parameters
    ----------
    sigma_px : float
        Width of the lens: standard deviation of a Gaussian, radius of a disc, or one over the
        highest frequency that diffraction lets through, pixels.
    lens : {"gaussian", "disc", "diffraction"}

    Examples
    --------
    >>> spread = PointSpread(0.5)
    >>> round(float(spread.mtf(0.25, 0.0)), 4), round(spread.mtf50(0), 3)
    (0.6614, 0.323)
    """

    sigma_px: float
    lens: str = "gaussian"

    def __post_init__(self):
        check_positive(self.sigma_px, "sigma_px", unit="px")
        check_choice(self.lens, "lens", tuple(LENS_TRANSFERS))

    def mtf(self, fx: ArrayLike, fy: ArrayLike) -> np.ndarray:
        """Transfer function of lens and pixel at frequencies in cycles per pixel."""
        optics = LENS_TRANSFERS[self.lens](np.hypot(fx, fy) * self.sigma_px)
        return optics * np.sinc(np.asarray(fx)) * np.sinc(np.asarray(fy))

    def mtf_mean(self, f: ArrayLike) -> np.ndarray:
        """Transfer function averaged over all directions."""
        return np.abs(lens_mtf(LENS_TRANSFERS[self.lens], self.sigma_px, f))

    def mtf50(self, angle_deg: float) -> float:
        """Frequency at which the contrast across an edge is halved."""
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        return float(brentq(lambda f: self.mtf(f * c, f * s) - 0.5, 0, 0.7))

    def fwhm(self, angle_deg: float) -> float:
        """Full width at half maximum (px) of the line spread function across an edge."""
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        f = np.linspace(0, 8, 4001)
        mtf = self.mtf(f * c, f * s)

        def above_half(d):
            """Line spread function at a distance, less half of its peak."""
            return np.trapezoid(mtf * (np.cos(2 * np.pi * f * d) - 0.5), f)

        return float(2 * brentq(above_half, 0, 6 * self.sigma_px + 2))


def render_edge(
    shape: tuple[int, int],
    spread: PointSpread,
    *,
    angle_deg: float = 5.0,
    position_px: float = 0.0,
    **levels: float,
) -> np.ndarray:
    """Return an image of one straight edge.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    spread : PointSpread
    angle_deg : float
        Direction from dark to bright, from x towards y.
    position_px : float
        Of the edge along that direction from the image's centre.
    **levels
        ``low``, ``high``: of the two sides, 0.1 and 0.6.
    """
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return _render(shape, spread, lambda x, y: x * c + y * s - position_px, **levels)


def render_star(
    shape: tuple[int, int],
    spread: PointSpread,
    *,
    cycles: int = 36,
    radius_px: float,
    centre: tuple[float, float] = (0.0, 0.0),
    tilt_deg: float = 0.0,
    half: bool = False,
    **levels: float,
) -> np.ndarray:
    """Return an image of a Siemens star on a dark ground.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    spread : PointSpread
    cycles : int
        Pairs of sectors around the full circle: 36 of 5 degree sectors, 18 of 10 degree sectors.
    radius_px : float
        Of the star.
    centre : (float, float)
        x, y from the image's centre, px.
    tilt_deg : float
        Of the star about y: it is seen narrower along x.
    half : bool
        Only the half with y below the centre's (upwards in the image).
    **levels
        ``low``, ``high``: of dark and bright sectors, 0.1 and 0.6.
    """
    n = check_count(cycles, "cycles", low=2)

    shrink = np.cos(np.radians(check_number(tilt_deg, "tilt_deg", low=0, high=80)))

    def distance(x, y):
        """Distance into the bright sectors, cut off at the star's outline."""
        x, y = (x - centre[0]) / shrink, y - centre[1]
        r = np.hypot(x, y)
        phase = n * np.arctan2(y, x) / (2 * np.pi)
        to_border = 0.25 - np.abs(phase - np.round(phase))
        inside = np.minimum(r * np.sin(2 * np.pi * to_border / n), radius_px - r)
        inside = inside * np.sqrt(shrink)
        return np.minimum(inside, -y) if half else inside

    return _render(shape, spread, distance, **levels)


def render_bars(
    shape: tuple[int, int],
    spread: PointSpread,
    *,
    period_px: float,
    bars: int = 4,
    angle_deg: float = 0.0,
    offset_px: float = 0.0,
    **levels: float,
) -> np.ndarray:
    """Return an image of bright line bars on a dark ground, as long as five of their widths.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    spread : PointSpread
    period_px : float
        Width of a bright and a dark bar.
    bars : int
        Bright bars.
    angle_deg : float
        Direction across the bars, from x towards y.
    offset_px : float
        Of the group's centre along that direction.
    **levels
        ``low``, ``high``: of dark and bright bars, 0.1 and 0.6.
    """
    period = check_positive(period_px, "period_px", unit="px")
    count = check_count(bars, "bars")
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def distance(x, y):
        """Distance into the bars."""
        u, v = (x * c + y * s - offset_px) / period, -x * s + y * c
        place = u + (count - 1) / 2
        near = np.clip(np.round(place), 0, count - 1)
        return np.minimum((0.25 - np.abs(place - near)) * period, 1.25 * period - np.abs(v))

    return _render(shape, spread, distance, **levels)


def texture(shape: tuple[int, int], *, seed: int) -> np.ndarray:
    """Return a random scene with as much detail as natural ones have, values 0 to 1.

    Its amplitude spectrum falls off with the frequency, about as in photographs of natural scenes.
    """
    rng = stream(seed, "texture")
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    f = np.hypot(fx, fy)
    f[0, 0] = np.inf
    noise = np.fft.rfft2(rng.standard_normal(shape))
    scene = np.fft.irfft2(noise * (1 / f), shape)
    return np.clip(0.5 + 0.15 * scene / scene.std(), 0, 1)


def blur_over_image(scene: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return a scene blurred by a Gaussian whose width changes over the image.

    Parameters
    ----------
    scene, sigma : array, shape (rows, columns)
        Grey values; standard deviation at each pixel, px.

    Notes
    -----
    Interpolated between nine evenly blurred images, in the variance.
    """
    variance = np.asarray(sigma, dtype=np.float64) ** 2
    steps = np.linspace(variance.min(), variance.max() + 1e-9, 9)
    stack = np.stack([gaussian_filter(scene, np.sqrt(step), mode="reflect") for step in steps])
    place = (variance - steps[0]) / (steps[1] - steps[0])
    lower = np.minimum(place.astype(int), len(steps) - 2)
    share = place - lower
    rows, columns = np.indices(scene.shape)
    return (1 - share) * stack[lower, rows, columns] + share * stack[lower + 1, rows, columns]


def expose(
    light: ArrayLike, *, gain: float, offset: float = 0.0, bits: int = 12, seed: int
) -> np.ndarray:
    """Return the digital numbers that a linear sensor with shot and read noise would record.

    Parameters
    ----------
    light : array_like
        Radiance times relative exposure, per pixel.
    gain, offset : float
        DN per unit of it, DN.
    bits : int
        Values are rounded and clipped to 0 .. 2**bits - 1.
    seed : int

    Returns
    -------
    array of float
        Whole numbers.
    """
    rng = stream(seed, "expose")
    signal = gain * np.asarray(light, dtype=np.float64)
    shot = np.maximum(signal, 0) / ELECTRONS_PER_DN
    noisy = signal + offset + np.sqrt(shot + READ_NOISE_DN**2) * rng.standard_normal(signal.shape)
    return np.clip(np.round(noisy), 0, 2 ** check_count(bits, "bits") - 1)


def _render(shape, spread, distance, low=0.1, high=0.6):
    """Draw where ``distance`` (px into the bright parts) is positive; filter; read at pixels."""
    rows, columns = (check_count(size, "image size", low=4) for size in shape)
    margin = 8 + int(np.ceil(6 * spread.sigma_px))  # what the filter wraps around stays outside
    fine = [next_fast_len((size + 2 * margin) * FINE, real=True) for size in (rows, columns)]
    y, x = (
        np.arange(count)[:, None] / FINE - margin - (size - 1) / 2
        for count, size in zip(fine, (rows, columns), strict=True)
    )
    bright = np.clip(0.5 + FINE * distance(x.T, y), 0, 1)
    fy, fx = FINE * np.fft.fftfreq(fine[0])[:, None], FINE * np.fft.rfftfreq(fine[1])
    # the drawn edges rise over one fine sample: that much of the blur is there already
    drawn = np.exp(np.pi**2 * (fx**2 + fy**2) / (6 * FINE**2))
    seen = irfft2(rfft2(bright) * np.minimum(drawn, 4) * spread.mtf(fx, fy), fine)
    begin = margin * FINE
    image = seen[begin : begin + rows * FINE : FINE, begin : begin + columns * FINE : FINE]
    return low + (high - low) * image
