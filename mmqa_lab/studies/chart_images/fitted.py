"""Point spread and motion blur chosen so that they explain the published widths: fits, in-sample.

Two parameters a system on four to eight cells describe Table 1; they do not reproduce it.
"""

import numpy as np
import pandas as pd
import xarray as xr

from mmqa_lab.studies.chart_images.predicted import (
    ladder_widths,
    limits_mm,
    steps_between,
)

SIGMAS_PX = np.round(np.arange(0.4, 1.101, 0.05), 2)
"""Point spreads tried, pixels."""

BLURS_MM = np.arange(0.0, 5.01, 0.5)
"""Motion blurs tried, millimetres at the chart."""


def one_spread(cells, limits):
    """Return how well one point spread for all systems, without motion, explains the widths.

    Parameters
    ----------
    cells : DataFrame
        Of :func:`mmqa_lab.studies.chart_images.width_cells`.
    limits : DataArray
        Of :func:`mmqa_lab.studies.chart_images.pair_limits`.

    Returns
    -------
    DataFrame
        Per ``sigma_px``: ``exact`` and ``within_one_step``, of ``cells``.
    """
    sigmas = _sigmas(limits)
    steps = _steps(cells, limits, sigmas, [0.0])[:, :, 0]
    return pd.DataFrame(
        {
            "sigma_px": sigmas,
            "exact": (steps == 0).sum(axis=0),
            "within_one_step": (np.abs(steps) <= 1).sum(axis=0),
            "cells": len(cells),
        }
    )


def best_spread(trials, systems):
    """Return the point spread with most cells within one step, of these with most exact ones.

    Returns
    -------
    DataFrame
        ``system``, ``kind`` = fitted, ``sigma_px`` (the same for all) and ``blur_mm`` = 0.
    """
    order = trials.sort_values(["within_one_step", "exact"], ascending=False, kind="stable")
    return same_spread(systems, float(order["sigma_px"].iloc[0]), kind="fitted")


def same_spread(systems, sigma_px, *, kind):
    """Return the model in which all systems have one point spread and no motion."""
    return pd.DataFrame({"system": list(systems)}).assign(kind=kind, sigma_px=sigma_px, blur_mm=0.0)


def fit_systems(cells, limits):
    """Fit a point spread and a horizontal motion blur to each system's published widths.

    Returns
    -------
    DataFrame
        ``system``, ``kind`` = fitted, ``sigma_px``, ``blur_mm``, ``exact``, ``within_one_step``,
        ``cells``. The pair with fewest steps in sum; of equally good ones that with least blur,
        then least spread.
    """
    rows, sigmas = [], _sigmas(limits)
    for system, part in cells.groupby("system"):
        steps = np.abs(_steps(part, limits, sigmas, BLURS_MM))
        total = steps.sum(axis=0).T
        blur, sigma = np.unravel_index(total.argmin(), total.shape)
        best = steps[:, sigma, blur]
        found = sigmas[sigma], BLURS_MM[blur], int((best == 0).sum()), int((best <= 1).sum())
        rows.append((system, "fitted", *found, len(part)))
    names = ["system", "kind", "sigma_px", "blur_mm", "exact", "within_one_step", "cells"]
    return pd.DataFrame(rows, columns=names)


def _sigmas(limits):
    """The point spreads tried, as far as their limits are known."""
    known = limits["sigma_px"].to_numpy()
    return SIGMAS_PX[(known.min() <= SIGMAS_PX) & (known.max() >= SIGMAS_PX)]


def _steps(cells, limits, sigmas_px, blurs_mm):
    """Steps from the published widths, (cells, point spreads, blurs)."""
    sigma = xr.DataArray(sigmas_px, dims="sigma")
    blur = xr.DataArray(np.asarray(blurs_mm), dims="blur")
    finest = limits_mm(cells, limits, sigma, blur).transpose("cell", "sigma", "blur").to_numpy()
    published, directions = cells["published_mm"], cells["direction"]
    flat = finest.reshape(len(cells), -1)
    steps = [steps_between(ladder_widths(one, directions), published, directions) for one in flat.T]
    return np.stack(steps, axis=1).reshape(finest.shape)
