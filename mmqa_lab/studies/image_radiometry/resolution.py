"""Spatial resolution on rendered targets of known point spread, and on a real photograph."""

import numpy as np
import pandas as pd

from mmqa_lab import io, samples
from mmqa_lab.chart_image.light import decode
from mmqa_lab.mtf.bars import read_bars, resolving_power
from mmqa_lab.mtf.chart_edge import edge_response
from mmqa_lab.mtf.edge import dependence, fit_edge
from mmqa_lab.mtf.sharpness import haar_sharpness, mean_sharpness
from mmqa_lab.mtf.star import measure_star
from mmqa_lab.simulate.targets import (
    PointSpread,
    blur_over_image,
    render_bars,
    render_edge,
    render_star,
    texture,
)

LOW, HIGH = 0.1, 0.6
"""Levels of all targets: the noise is a share of their difference."""

HIGHEST = 0.45
"""Cycles per pixel, 0.9 of the Nyquist frequency."""

PHOTOGRAPHS = (
    "images/panorama.jpg",
    "images/street_signs_french.jpg",
    "images/iso_chart_mono.jpg",
    "images/line_pairs_44.png",
)

REAL_EDGES = (
    ("images/slanted_edge.tif", "whole", (slice(None), slice(None)), 0.285),
    ("images/iso_chart_mono.jpg", "left", (slice(478, 652), slice(380, 490)), 0.34),
    ("images/iso_chart_mono.jpg", "top", (slice(353, 440), slice(478, 761)), 0.28),
)
"""Photograph, edge, its rows and columns, and MTF50 (cycles per pixel) by other tools.

Those tools were given the codes of the files, not light: so are ours.
"""


def edge_trials(*, sigmas_px, edges, noise, seed):
    """Measure edges by three methods.

    Parameters
    ----------
    sigmas_px : sequence of float
        Of the Gaussian before the pixel.
    edges : int
        Of each, at random angles (3 to 11.5 degrees) and places.
    noise : float
        Standard deviation over contrast.
    seed : int

    Returns
    -------
    DataFrame
        ``sigma_px``, ``method``, ``fwhm_error_percent`` (NaN for the edge method, which has no
        FWHM), ``mtf50_error_percent``.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for sigma in sigmas_px:
        spread = PointSpread(sigma)
        for _ in range(edges):
            angle = rng.uniform(3, 11.5)
            place = rng.uniform(-1, 1)
            image = _noisy(
                render_edge((100, 64), spread, angle_deg=angle, position_px=place), noise, rng
            )
            fwhm, mtf50 = spread.fwhm(angle), spread.mtf50(angle)
            for name in ("Gaussian", "logistic"):
                fit = fit_edge(image, shape=name.lower())
                rows.append((sigma, f"sigmoid: {name}", fit.fwhm_px / fwhm, fit.mtf50 / mtf50))
            rows.append((sigma, "edge method", np.nan, edge_response(image).mtf50 / mtf50))
    table = pd.DataFrame(rows, columns=["sigma_px", "method", "fwhm", "mtf50"])
    for name in ("fwhm", "mtf50"):
        table[f"{name}_error_percent"] = 100 * (table.pop(name) - 1)
    return table


def star_trials(*, cycles, sigmas_px, noise, seed):
    """Measure full and half Siemens stars.

    Returns
    -------
    DataFrame
        ``cycles``, ``star`` (full, half), ``sigma_px``, ``largest_error`` of the contrast up to 0.9
        Nyquist, ``mtf50_error_percent``, ``centre_error_px``.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for n in cycles:
        radius = 2.6 * n + 20
        for star in ("full", "half"):
            for sigma in sigmas_px:
                spread = PointSpread(sigma)
                image, middle = _star(n, radius, spread, star, noise, rng)
                found = measure_star(
                    image,
                    middle + rng.uniform(-0.5, 0.5, 2),
                    cycles=n,
                    radius_px=radius,
                    azimuth_deg=(0, 360) if star == "full" else (-180, 0),
                )
                low = found.frequency <= HIGHEST
                error = found.mtf - spread.mtf_mean(found.frequency)
                off = np.hypot(*(np.array(found.centre) - middle))
                true = _mtf50(spread)
                rows.append((n, star, sigma, np.abs(error[low]).max(), found.mtf50 / true - 1, off))
    names = ["cycles", "star", "sigma_px", "largest_error", "mtf50", "centre_error_px"]
    table = pd.DataFrame(rows, columns=names)
    table["mtf50_error_percent"] = 100 * table.pop("mtf50")
    return table


def one_star(*, cycles, sigma_px, noise, seed):
    """Return a star's image, its measurement and the point spread it was rendered with."""
    rng = np.random.default_rng(seed)
    spread = PointSpread(sigma_px)
    radius = 2.6 * cycles + 20
    image, middle = _star(cycles, radius, spread, "full", noise, rng)
    return image, measure_star(image, middle, cycles=cycles, radius_px=radius), spread


def bar_ladder(*, sigma_px, noise, seed, step=0.891, rungs=14):
    """Read a ladder of bar groups, each a tenth finer than the one before.

    Returns
    -------
    DataFrame, list of array
        The readings with the theoretical contrast ``mtf`` at the bars' frequency; the images.
    """
    rng = np.random.default_rng(seed)
    spread = PointSpread(sigma_px)
    images, rows = [], []
    for period in 9.0 * step ** np.arange(rungs):
        size = int(6 * period) + 12
        offset = rng.uniform(-0.5, 0.5)
        clean = render_bars((size, size), spread, period_px=period, offset_px=offset)
        image = _noisy(clean, noise, rng)
        middle = (size - 1) / 2
        group = {"period_px": period, "x_px": middle + offset, "y_px": middle}
        groups = pd.DataFrame([group | {"angle_deg": 0.0, "bars": 4}])
        reading = read_bars(image, groups, dark=LOW, bright=HIGH, noise=noise * (HIGH - LOW))
        rows.append(reading.assign(mtf=float(spread.mtf(1 / period, 0))))
        images.append(image)
    return pd.concat(rows, ignore_index=True), images


def bar_summary(*, sigmas_px, noise, seed):
    """Return the resolving power of bars beside MTF10, for several blurs."""
    rows = []
    for sigma in sigmas_px:
        readings, _ = bar_ladder(sigma_px=sigma, noise=noise, seed=seed)
        period, finer = resolving_power(readings)
        f = np.linspace(0, 1.5, 3001)
        mtf10 = np.interp(-0.1, -PointSpread(sigma).mtf(f, 0), f)
        rows.append((sigma, 1 / period, 1 / finer, mtf10))
    names = ["sigma_px", "resolved_per_px", "not_resolved_per_px", "mtf10_per_px"]
    return pd.DataFrame(rows, columns=names)


def edges_over_image(*, seed, noise=0.01, half_px=(1500, 2000), motion_px=0.6):
    """Measure edges all over an image whose blur grows outwards, more so along the radius.

    Returns
    -------
    DataFrame, DataFrame
        The edges (``x_px``, ``y_px``, ``angle_deg``, ``fwhm_px``) and what they depend on, with
        ``truth``.
    """
    rng = np.random.default_rng(seed)
    places = [(x, y) for y in np.linspace(-1, 1, 5) for x in np.linspace(-1, 1, 5)]
    centre, radial, tangential = 0.45, 0.35, 0.15
    corner2 = half_px[0] ** 2 + half_px[1] ** 2
    rows = []
    for x, y in places:
        x_px, y_px = x * half_px[1], y * half_px[0]
        share = (x_px**2 + y_px**2) / corner2
        spread = PointSpread(
            np.sqrt(centre**2 + radial * share),
            np.sqrt(centre**2 + tangential * share),
            float(np.degrees(np.arctan2(y_px, x_px))),
            motion_px,
        )
        for angle in (5.0, 95.0):
            fit = fit_edge(_noisy(render_edge((60, 60), spread, angle_deg=angle), noise, rng))
            rows.append((x_px, y_px, angle, fit.fwhm_px, spread.fwhm(angle)))
    names = ["x_px", "y_px", "angle_deg", "fwhm_px", "true_fwhm_px"]
    edges = pd.DataFrame(rows, columns=names)
    terms = dependence(edges)
    true = dependence(edges.assign(fwhm_px=edges["true_fwhm_px"]))
    return edges, terms.assign(truth=true["estimate"])


def sharpness_maps(*, images, seed, size=(384, 512), noise=2.0):
    """Map the sharpness of scenes whose blur grows from 0.4 px in the centre to 1.2 px outside.

    Returns
    -------
    Dataset, DataFrame
        The mean map; and each block's ``radius``, ``sharpness`` and true ``sigma_px``.
    """
    rows, columns = np.indices(size)
    dy, dx = rows - size[0] / 2, columns - size[1] / 2
    radius = np.hypot(dx, dy) / np.hypot(*size) * 2
    sigma = 0.4 + 0.8 * radius**2
    rng = np.random.default_rng(seed)
    maps = []
    for k in range(images):
        scene = 200 * blur_over_image(texture(size, seed=seed + k), sigma)
        maps.append(haar_sharpness(scene + rng.normal(0, noise, size), block=32, noise_std=noise))
    mean = mean_sharpness(maps)
    y, x = np.meshgrid(mean["y_px"], mean["x_px"], indexing="ij")
    at = y.astype(int), x.astype(int)
    table = pd.DataFrame(
        {
            "radius": radius[at].ravel(),
            "sharpness": mean["sharpness"].to_numpy().ravel(),
            "sigma_px": sigma[at].ravel(),
        }
    )
    return mean, table


def real_edges():
    """Measure edges on real photographs by all methods; None where none are at hand.

    Returns
    -------
    DataFrame or None
        ``photograph``, ``edge``, ``method``, ``mtf50_per_px``, ``fwhm_px`` (NaN for the edge
        method), ``misfit`` (rms of the sigmoid's residuals over the contrast), ``other_tools``
        (MTF50 by the tools that come with the photograph), ``kind`` = measured.
    """
    rows = []
    for name, edge, part, other in REAL_EDGES:
        if not samples.has_real(name):
            continue
        grey = io.read_grey(samples.real_path(name))[part] / 255
        for shape in ("Gaussian", "logistic"):
            fit = fit_edge(grey, shape=shape.lower())
            misfit = fit.rms / abs(fit.high - fit.low)
            rows.append((name, edge, f"sigmoid: {shape}", fit.mtf50, fit.fwhm_px, misfit, other))
        rows.append((name, edge, "edge method", edge_response(grey).mtf50, np.nan, np.nan, other))
    names = ["photograph", "edge", "method", "mtf50_per_px", "fwhm_px", "misfit", "other_tools"]
    return pd.DataFrame(rows, columns=names).assign(kind="measured") if rows else None


def real_sharpness(*, block=64):
    """Map the sharpness of real photographs.

    Returns
    -------
    DataFrame, dict of str to Dataset
        ``photograph``, ``rows``, ``columns``, ``noise_std`` (estimated), ``sharpness``,
        ``along_x``, ``along_y`` (medians of the blocks), ``blurred`` (the same median after a blur
        of 1 px), ``blocks``, ``not_measurable``, ``kind`` = measured; and the maps by name. Empty
        where no photographs are at hand.
    """
    from scipy.ndimage import gaussian_filter

    rows, maps = [], {}
    for name in PHOTOGRAPHS:
        if not samples.has_real(name):
            continue
        grey = decode(io.read_grey(samples.real_path(name)) / 255, "srgb")
        found = haar_sharpness(grey, block=block)
        noise = found.attrs["noise_std"]
        # a blur of 1 px leaves 1 / (2 sqrt(pi)) of white noise
        blurred = haar_sharpness(gaussian_filter(grey, 1.0), block=block, noise_std=0.282 * noise)
        medians = [float(found[key].median()) for key in ("sharpness", "along_x", "along_y")]
        soft = float(blurred["sharpness"].median())
        counts = found["sharpness"].size, found.attrs["not_measurable"]
        rows.append((name, *grey.shape, noise, *medians, soft, *counts))
        maps[name] = found
    names = ["photograph", "rows", "columns", "noise_std", "sharpness", "along_x", "along_y"]
    names += ["blurred", "blocks", "not_measurable"]
    return pd.DataFrame(rows, columns=names).assign(kind="measured"), maps


def _noisy(image, noise, rng):
    """An image with noise of a share of the targets' contrast."""
    return image + noise * (HIGH - LOW) * rng.standard_normal(image.shape)


def _star(cycles, radius, spread, star, noise, rng):
    """A noisy star and its true centre in pixels of the image."""
    size = 2 * int(radius + 8)
    centre = rng.uniform(-0.5, 0.5, 2)
    clean = render_star(
        (size, size), spread, cycles=cycles, radius_px=radius, centre=centre, half=star == "half"
    )
    return _noisy(clean, noise, rng), centre + (size - 1) / 2


def _mtf50(spread):
    """Frequency of half the contrast, averaged over all directions."""
    f = np.linspace(0, 1, 4001)
    return float(np.interp(-0.5, -spread.mtf_mean(f), f))
