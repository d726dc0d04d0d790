"""Rendered edges and line pairs whose truth is known, for tests and benchmarks of images."""

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtr

from mmqa_lab.chart_image import ChartMap, find_tones, read_pattern
from mmqa_lab.charts import Bar, Layout, LinePairs, decode
from mmqa_lab.simulate.cameras import Optics, Sensor, photograph

PIXEL_MM = 2.7


def slanted_edge(sigma, angle, offset, *, shape=(100, 64), levels=(0.1, 0.6), noise=0.0, rng=None):
    """A slanted edge behind a Gaussian and a square pixel, by integration over the pixel's rows.

    The Gaussian edge is integrated exactly along x and by 24-point Gauss quadrature along y, so
    that it shares nothing with the closed form of the package.
    """
    rows, columns = shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    x, y = x - (columns - 1) / 2 - offset, y - (rows - 1) / 2
    nodes, weights = np.polynomial.legendre.leggauss(24)
    seen = np.zeros(shape)
    for node, weight in zip(nodes / 2, weights / 2, strict=True):
        ends = [
            _integral((x + side) * np.cos(angle) + (y + node) * np.sin(angle), sigma)
            for side in (0.5, -0.5)
        ]
        seen += weight * (ends[0] - ends[1]) / np.cos(angle)
    image = levels[0] + (levels[1] - levels[0]) * seen
    return image if rng is None else image + noise * rng.standard_normal(shape)


def step_seen_by_pixel(x, sigma):
    """A step from 0 to 1 at distance x behind a Gaussian, averaged over one pixel."""
    return _integral(x + 0.5, sigma) - _integral(x - 0.5, sigma)


def true_mtf50(sigma, angle):
    """MTF50 of a Gaussian and a square pixel along the normal of an edge."""

    def mtf(f):
        pixel = np.sinc(f * np.cos(angle)) * np.sinc(f * np.sin(angle))
        return np.exp(-2 * (np.pi * sigma * f) ** 2) * pixel - 0.5

    return brentq(mtf, 1e-4, 0.99)


def centre_contrast(width_px, sigma, blur=0.0):
    """Contrast of bars averaged over their middles, by numerical integration of the profile."""
    inside = (np.arange(41) + 0.5) / 41 - 0.5

    def profile(u):
        """Mean over motion and pixel of the blurred square wave, black from 0 to half a period."""
        steps = inside[:, None] * blur + inside[None, :]
        places = u * width_px + steps.ravel()
        edges = np.arange(-12, 13) * width_px / 2
        signs = np.where(np.arange(-12, 13) % 2 == 0, -1.0, 1.0)
        waves = ndtr((places[:, None] - edges) / sigma) * signs
        return float((1 + waves.sum(axis=1)).mean())

    def middle(centre):
        def weighted(u):
            return (1 + np.cos(4 * np.pi * (u - centre))) * profile(u)

        return 2 * quad(weighted, centre - 0.25, centre + 0.25, limit=60)[0]

    return middle(0.75) - middle(0.25)


def pattern_chart(width_mm, *, direction="h", repeats=8):
    """A small chart with one pattern and a plain black bar."""
    pairs = LinePairs("pairs", 60.0, 60.0, width_mm, direction, repeats=repeats)
    bar = Bar("bar", pairs.x + pairs.width + 40, 20.0, 12 * PIXEL_MM, pairs.height + 80)
    size = bar.x + bar.width + 20, pairs.y + pairs.height + 60
    return Layout("one pattern", *size, (pairs, bar))


def pattern_case(
    width_px,
    rng,
    *,
    sigma=0.5,
    defocus=0.0,
    travel=0.0,
    noise=0.01,
    direction="h",
    seen=None,
    error_px=0.1,
    **sensor,
):
    """Photograph one pattern of this width and read it.

    ``travel`` is motion in pairs, ``seen`` the number of pairs actually printed in the place of
    eight; the map is wrong by ``error_px``, roll and place of the pixels are random.
    """
    width = width_px * PIXEL_MM
    layout = pattern_chart(width, direction=direction)
    printed = layout
    if seen is not None:
        other = LinePairs("pairs", 60.0, 60.0, 8 * width / seen, direction, repeats=seen)
        printed = Layout("other", layout.width, layout.height, (other, layout["bar"]))
    roll = np.radians(rng.uniform(-1.5, 1.5))
    c, s = np.cos(roll) / PIXEL_MM, np.sin(roll) / PIXEL_MM
    place = 20 + rng.uniform(0, 1, 2) + [0, layout.height / PIXEL_MM]
    there = ChartMap(np.array([[c, s, place[0]], [s, -c, place[1]], [0, 0, 1.0]]))
    way = np.array([travel * width_px, 0.0])
    way = way if direction == "h" else way[::-1]
    optics = Optics(sigma, defocus, (*way, 0.0))
    photo = photograph(
        printed,
        there,
        optics=optics,
        sensor=Sensor(noise=noise, **sensor),
        margin=3,
        seed=int(rng.integers(2**31)),
    )
    image = grey(photo.image, sensor.get("gamma", "linear"))
    wrong = photo.chart_map.within(*rng.normal(0, error_px, 2))
    return read_pattern(find_tones(image, layout, wrong), layout["pairs"], wrong)


def grey(image, gamma):
    """Linear grey values of a photograph, of 8 bits or unrounded, in colour or not."""
    values = image / 255 if image.dtype == np.uint8 else image
    values = decode(np.asarray(values, dtype=float), gamma)
    return values @ [0.114, 0.587, 0.299] if values.ndim == 3 else values


def _integral(x, sigma):
    """Antiderivative of the normal distribution function."""
    z = x / sigma
    return sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))
