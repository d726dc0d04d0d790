"""What speaks against a line through targets of known brightness: its residuals."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, t

__all__ = ["looseness", "odd_target", "unlikely_term"]
__dir__ = __all__.copy

SURELY = 0.001
"""Probability of a residual below which its target is named, over the number of targets."""


def looseness(left, std, freedom):
    """Residuals over their stated errors where that is more than chance, else 1."""
    square = float(np.sum(np.square(left / std)))
    loose = freedom > 0 and chi2.sf(square, freedom) < 0.01
    return np.sqrt(square / freedom) if loose else 1.0


def odd_target(design, seen, std, *, stated):
    """The target that leaves the line of all others by more than its error, or None.

    ``stated``: the standard deviations are known; else only their ratios, and the others tell.
    """
    count, terms = design.shape
    freedom = count - 1 - terms
    if freedom < 1:
        return None
    chance = np.ones(count)
    for k in range(count):
        others = np.arange(count) != k
        scaled = design[others] / std[others, None]
        inverse = np.linalg.pinv(scaled.T @ scaled)
        known = inverse @ (scaled.T @ (seen[others] / std[others]))
        left = (seen[others] - design[others] @ known) / std[others]
        variance = std[k] ** 2 + design[k] @ inverse @ design[k]
        if not stated:
            variance *= max(left @ left / freedom, 1e-24)
        size = abs(seen[k] - design[k] @ known) / np.sqrt(variance)
        chance[k] = 2 * t.sf(size, np.inf if stated else freedom)
    odd = int(chance.argmin())
    return odd if chance[odd] < SURELY / count else None


def unlikely_term(design, term, seen, std):
    """What a term adds to a line where that is more than chance (1 %), else 0."""
    both = np.column_stack([design, term]) / std[:, None]
    freedom = len(seen) - both.shape[1]
    if freedom < 2 or np.linalg.matrix_rank(both) < both.shape[1]:
        return 0.0
    inverse = np.linalg.inv(both.T @ both)
    known = inverse @ (both.T @ (seen / std))
    left = seen / std - both @ known
    error = np.sqrt(max(left @ left / freedom, 1e-24) * inverse[-1, -1])
    return float(known[-1]) if 2 * t.sf(abs(known[-1]) / error, freedom) < 0.01 else 0.0
