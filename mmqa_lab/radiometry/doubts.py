"""What speaks against an adjusted block of images, and against an empirical line."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy.stats import chi2, median_abs_deviation, t

from mmqa_lab._results import sentences

__all__ = [
    "RELATIVE_STD", "SHADOW", "looseness", "misfit_scale", "odd_target", "unlikely_term",
    "warn",
]  # fmt: skip


SHADOW, RELATIVE_STD = 6.0, 0.02
"""Deviations that hardly count; standard deviation of an observation, a share of its radiance, to
begin with."""

CONTRADICTS, HOT_SPOT_DEG = 3.2, 10.0
"""Standard deviations by which a control target differs, with six by chance in a hundredth of the
blocks; angle between sun and view within which surfaces flash up."""

LOOSE, FEWEST_TIES = 2.0, 8
"""Spread of an image's observations over that of most from which it is said, and their number."""

RINGS, FALLS_OTHERWISE = 5, 4.0
"""Rings around the centre of an image, and standard errors by which one may differ from others."""

WRONG, POWER = 0.15, 1.28
"""Share of its value by which a control target is wrong that should be named, and the quantile of
the probability, nine in ten, with which it is."""

SURELY = 0.001
"""Probability of a residual below which its target is named, over the number of targets."""


def warn(block, estimate, value, std, share, adjusted_std):
    """Warn of known reflectances that contradict the others, and of many odd observations.

    ``share``: misfits as shares of the radiances; ``adjusted_std``: of known reflectances after the
    adjustment.
    """
    value, std, estimate = (part[-len(block.ties) :] for part in (value, std, estimate))
    spread = misfit_scale(share)
    # what control leaves over its own standard deviation (Baarda); one that is wrong draws others
    free = np.sqrt(np.maximum(std**2 - adjusted_std**2, 1e-4 * std**2))
    # images that agree with each other against it do not count, and leave it as it is
    of_ties = pd.Series(share).groupby(block.tie).median().abs().to_numpy() * estimate
    left = np.maximum(np.abs(estimate - value) / free, of_ties / np.hypot(std, spread * estimate))
    left = np.where(np.isfinite(std), left, 0)
    doubtful = block.ties[(left > CONTRADICTS) & (left == left.max())]
    # the least error of a control that is named (Baarda's internal reliability)
    least = np.where(np.isfinite(std), (CONTRADICTS + POWER) * std**2 / free, 0)
    unseen = block.ties[least > WRONG * value]
    counts = np.abs(share) <= SHADOW * spread
    odd = 1 - counts.mean()
    # means of rings of one area, in their standard errors
    ring = np.minimum(RINGS * block.radius2[counts], RINGS - 1).astype(int)
    rings = pd.Series(share[counts]).groupby(ring)
    uneven = rings.mean().abs() > FALLS_OTHERWISE * spread / np.sqrt(rings.size())
    behind = counts & (block.phase_deg < HOT_SPOT_DEG)
    peak = share[behind].mean() if behind.sum() >= FEWEST_TIES else 0.0
    hot_spot = abs(peak) > FALLS_OTHERWISE * spread / np.sqrt(max(behind.sum(), 1))
    of_image = pd.Series(np.abs(share)).groupby(block.image)
    wide = of_image.quantile(0.75)
    loose = (wide > LOOSE * max(wide.median(), RELATIVE_STD / 10)) & (
        of_image.size() >= FEWEST_TIES
    )
    known, blind, images = (
        ", ".join(map(str, part)) for part in (doubtful, unseen, block.images[loose])
    )
    gains = "the gains may be wrong by more than their deviations."
    shaded = f"{odd:.0%} of the observations contradict the others, as those in shadow do"
    clouded = f"The observations of images {images} contradict each other"
    falls = "The light falls off to the corners otherwise than radial and its square say"
    for text in sentences(
        (known, f"Control targets {known} contradict the others, as one in shadow does: {gains}"),
        (blind, f"Whether control targets {blind} are wrong by {WRONG:.0%} cannot be told here."),
        (odd > 0.01, f"{shaded}: they do not count."),
        (images, f"{clouded}, as where a part lies under a cloud: their gains may be wrong."),
        (uneven.any(), f"{falls}: {gains}"),
        (hot_spot, f"Light is {peak:+.1%} off where the sun stands behind the camera: {gains}"),
    ):
        warnings.warn(text, stacklevel=3)


def misfit_scale(scaled):
    """Return the robust standard deviation of the scaled misfit."""
    return max(median_abs_deviation(scaled, scale="normal"), 1e-6)


def looseness(left, std, freedom):
    """Return residuals over their stated errors where that is more than chance, else 1."""
    square = float(np.sum(np.square(left / std)))
    loose = freedom > 0 and chi2.sf(square, freedom) < 0.01
    return np.sqrt(square / freedom) if loose else 1.0


def odd_target(design, seen, std, *, stated):
    """Return the target that leaves the line of all others by more than its error, or None.

    ``stated``: the standard deviations are known; else only their ratios, and the others tell.
    """
    count, terms = design.shape
    freedom = count - 1 - terms
    if freedom < 1:
        return None
    scaled, target = design / std[:, None], seen / std
    basis = np.linalg.qr(scaled)[0]
    apart = 1 - np.square(basis).sum(axis=1)  # what the others do not settle of each
    apart = np.maximum(apart, 1e-12)
    left = target - basis @ (basis.T @ target)
    beyond = np.square(left) / apart  # what the misfit loses without each
    variance = np.ones(count)
    if not stated:
        rounding = np.square(1e-13 * np.abs(target).max())
        variance = np.maximum((np.square(left).sum() - beyond) / freedom, rounding)
    chance = 2 * t.sf(np.sqrt(beyond / variance), np.inf if stated else freedom)
    odd = int(chance.argmin())
    return odd if chance[odd] < SURELY / count else None


def unlikely_term(design, term, seen, std):
    """Return what a term adds to a line where that is more than chance (1 %), else 0."""
    both = np.column_stack([design, term]) / std[:, None]
    freedom = len(seen) - both.shape[1]
    if freedom < 2 or np.linalg.matrix_rank(both) < both.shape[1]:
        return 0.0
    inverse = np.linalg.inv(both.T @ both)
    known = inverse @ (both.T @ (seen / std))
    left = seen / std - both @ known
    error = np.sqrt(max(left @ left / freedom, 1e-24) * inverse[-1, -1])
    return float(known[-1]) if 2 * t.sf(abs(known[-1]) / error, freedom) < 0.01 else 0.0
