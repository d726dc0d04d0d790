"""Resolution: edges of known blur, real photographs, and the report's numbers on resolution.

The images of the report (EuroSDR 2013, image radiometry) are airborne and not published. All images
here are simulated, except the photographs of ``REAL_EDGES``.
"""

from functools import lru_cache, partial

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from mmqa_lab import io, samples
from mmqa_lab.bench import Comparison, cell_table, grid
from mmqa_lab.mtf import fit_edge
from mmqa_lab.simulate.targets import PointSpread, render_edge

__all__ = [
    "HIGH", "LENSES", "LOW", "METHODS", "REAL_EDGES", "SOURCE", "bench", "edge_errors",
    "edge_patch", "errors_by_lens", "estimate", "noisy", "real_patch", "rise", "spread_of",
]  # fmt: skip

SOURCE = "eurosdr2013_radiometry"

LOW, HIGH = 0.1, 0.6
"""Levels of all targets. The noise is a share of their difference."""

LENSES = ("gaussian", "disc", "diffraction")

# The other tools read the codes of the files, not linear light, so our methods do too.
REAL_EDGES = {
    "slanted edge": ("images/slanted_edge.tif", (slice(None), slice(None)), 0.285),
    "ISO chart, left": ("images/iso_chart_mono.jpg", (slice(478, 652), slice(380, 490)), 0.34),
    "ISO chart, top": ("images/iso_chart_mono.jpg", (slice(353, 440), slice(478, 761)), 0.28),
}
"""File, rows and columns of an edge, and MTF50 (cycles per pixel) by other tools."""


def noisy(image, noise, rng):
    """Return an image with noise, which is a share of the targets' contrast."""
    return image + noise * (HIGH - LOW) * rng.standard_normal(image.shape)


@lru_cache
def spread_of(lens, mtf50):
    """Return the point spread of a lens with a given MTF50 (cycles per pixel).

    Examples
    --------
    >>> round(spread_of("gaussian", 0.25).sigma_px, 2)
    0.69
    """
    width = brentq(lambda width: PointSpread(width, lens=lens).mtf50(0) - mtf50, 0.05, 6)
    return PointSpread(width, lens=lens)


def edge_patch(lens, mtf50, noise, seed):
    """Return a noisy patch with an edge at a random angle (3 to 11.5 degrees), and the truth."""
    rng = np.random.default_rng(seed)
    angle, place = rng.uniform(3, 11.5), rng.uniform(-1, 1)
    spread = spread_of(lens, mtf50)
    image = noisy(_drawn_edge(lens, mtf50, angle, place), noise, rng)
    return image, {"mtf50": spread.mtf50(angle), "fwhm_px": spread.fwhm(angle)}


@lru_cache(maxsize=1000)
def _drawn_edge(lens, mtf50, angle, place):
    """An edge before noise, which is drawn once for all noises and methods."""
    choices = {"angle_deg": angle, "position_px": place, "low": LOW, "high": HIGH}
    return render_edge((100, 64), spread_of(lens, mtf50), **choices)


def real_patch(photograph, **_):
    """Return an edge of a real photograph, and its MTF50 by other tools."""
    name, part, other = REAL_EDGES[photograph]
    return io.read_image(samples.real_path(name))[part] / 255, {"mtf50": other}


def edge_errors(found, truth):
    """Return the errors of MTF50, or of the numbers of a dict, in percent of the truth."""
    named = found if isinstance(found, dict) else {"mtf50": found}
    known = [name for name in named if name in truth]
    return {f"{name}_error_percent": 100 * (named[name] / truth[name] - 1) for name in known}


def estimate(patch, method):
    """Return MTF50 and FWHM (px) of a patch with an edge by ``fit_edge``."""
    found = fit_edge(patch, method=method)
    return {"mtf50": found.mtf50, "fwhm_px": found.fwhm_px}


def rise(patch):
    """Return MTF50 and FWHM (px) of a Gaussian blur from the 10 to 90 % rise of an edge."""
    low, high = patch[:, :8].mean(), patch[:, -8:].mean()
    level = (patch - low) / (high - low)
    row, column = np.indices(patch.shape)
    edge = np.polyfit(row[:, 0], (1 - level).sum(axis=1) - 0.5, 1)
    distance = (column - np.polyval(edge, row)) * np.cos(np.arctan(edge[0]))
    bins = np.round(4 * distance.ravel()) / 4
    profile = pd.Series(level.ravel()).groupby(bins).mean().loc[-6:6]
    start, end = np.interp([0.1, 0.9], profile, profile.index)
    sigma = (end - start) / 2.563
    return {"mtf50": np.sqrt(np.log(2) / 2) / (np.pi * sigma), "fwhm_px": 2.355 * sigma}


METHODS = {
    "rise 10-90 %": rise,
    "curve through bins": partial(estimate, method="binned"),
    "Gaussian sigmoid": partial(estimate, method="sigmoid"),
    "logistic sigmoid": partial(estimate, method="logistic"),
}
"""Estimators of resolution: functions of a patch, grey values (rows, columns) with an edge."""


def errors_by_lens(cells, name="mtf50"):
    """Return the median error, and the absolute error that 95 % of edges do not exceed.

    Parameters
    ----------
    cells : DataFrame
        From :func:`mmqa_lab.bench.cell_table`.
    name : {"mtf50", "fwhm_px"}

    Returns
    -------
    DataFrame
        ``median_percent``, ``largest_95_percent``, ``n`` (edges), by method and lens.
    """
    errors = cells.groupby(["method", "lens"], sort=False)[f"{name}_error_percent"]
    table = pd.DataFrame({"median_percent": errors.median()})
    table["largest_95_percent"] = errors.agg(lambda one: one.abs().quantile(0.95))
    return table.assign(n=errors.count())


def bench(methods=None, mtf50s=(0.1, 0.15, 0.2, 0.3, 0.4), noises=(0.01, 0.03), seeds=range(10)):
    """Return the study's comparison: estimators of resolution on edges of known blur.

    Parameters
    ----------
    methods : dict, optional
        Functions of a patch; by default ``METHODS``. A method returns MTF50 in
        cycles per pixel, or a dict with ``mtf50`` and ``fwhm_px``.
    mtf50s, noises : sequence of float
        True MTF50 of each of ``LENSES``, cycles per pixel, and noise as a share of the contrast.
    seeds : iterable of int
        Seeds of the patches.

    Examples
    --------
    >>> len(bench().cases)
    30
    """

    def tables(results):
        return {"errors": errors_by_lens(cell_table(results)).reset_index()}

    cases = grid(lens=LENSES, mtf50=mtf50s, noise=noises)
    shown = {"tables": tables, "figures": ("mtf50_error_percent",)}
    return Comparison(cases, dict(methods or METHODS), edge_patch, edge_errors, seeds, **shown)
