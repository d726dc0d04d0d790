"""What speaks against an adjusted block."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy.stats import median_abs_deviation

from mmqa_lab._results import sentences

__all__ = ["RELATIVE_STD", "SHADOW", "misfit_scale", "warn"]
__dir__ = __all__.copy

SHADOW, RELATIVE_STD = 6.0, 0.02
"""Deviations that hardly count; standard deviation of an observation, a share of its radiance, to
begin with."""

LOOSE, FEWEST_TIES = 2.0, 8
"""Spread of an image's observations over that of most from which it is said, and their number."""

RINGS, FALLS_OTHERWISE = 5, 4.0
"""Rings around the centre of an image, and standard errors by which one may differ from others."""


def warn(block, estimate, value, std, share):
    """Warn of known reflectances that contradict the others, and of many odd observations.

    ``share``: misfits as shares of the radiances.
    """
    value, std, estimate = (part[-len(block.ties) :] for part in (value, std, estimate))
    spread = misfit_scale(share)
    # by how much images and control differ, and may differ
    of_ties = pd.Series(share).groupby(block.tie).median().abs().to_numpy() * estimate
    limit = 3 * np.hypot(std, spread * estimate)
    doubtful = block.ties[np.isfinite(std) & (np.abs(estimate - value) + of_ties > limit)]
    counts = np.abs(share) <= SHADOW * spread
    odd = 1 - counts.mean()
    # means of rings of one area, in their standard errors
    ring = np.minimum(RINGS * block.radius2[counts], RINGS - 1).astype(int)
    rings = pd.Series(share[counts]).groupby(ring)
    uneven = rings.mean().abs() > FALLS_OTHERWISE * spread / np.sqrt(rings.size())
    of_image = pd.Series(np.abs(share)).groupby(block.image)
    wide = of_image.quantile(0.75)
    loose = (wide > LOOSE * max(wide.median(), RELATIVE_STD / 10)) & (
        of_image.size() >= FEWEST_TIES
    )
    known, images = (", ".join(map(str, part)) for part in (doubtful, block.images[loose]))
    gains = "the gains may be wrong by more than their deviations."
    shaded = f"{odd:.0%} of the observations contradict the others, as those in shadow do"
    clouded = f"The observations of images {images} contradict each other"
    falls = "The light falls off to the corners otherwise than radial and its square say"
    for text in sentences(
        (known, f"Control targets {known} contradict the others, as one in shadow does: {gains}"),
        (odd > 0.01, f"{shaded}: they do not count."),
        (images, f"{clouded}, as where a part lies under a cloud: their gains may be wrong."),
        (uneven.any(), f"{falls}: {gains}"),
    ):
        warnings.warn(text, stacklevel=3)


def misfit_scale(scaled):
    """Robust standard deviation of the scaled misfit."""
    return max(median_abs_deviation(scaled, scale="normal"), 1e-6)
