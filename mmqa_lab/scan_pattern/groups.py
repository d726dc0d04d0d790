"""Least squares of groups of points that share coefficients."""

from __future__ import annotations

import numpy as np

__all__ = ["group_means", "solve_groups", "solved"]


def solved(products, sums):
    """Solutions (..., k) of normal equations; a term without spread gets the coefficient 0."""
    scale = np.sqrt(np.diagonal(products, axis1=-2, axis2=-1))
    scale = np.where(scale <= 1e-9 * scale.max(axis=-1, keepdims=True), np.inf, scale)
    even = products / scale[..., None] / scale[..., None, :]
    solved = np.linalg.pinv(even, rcond=1e-12) @ (sums / scale)[..., None]
    return solved[..., 0] / scale


def solve_groups(
    terms: np.ndarray, values: np.ndarray, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least squares of values (n,) on shared terms (n, k) and a constant per group (n,).

    A term without spread (distances from a plane without noise) gets the coefficient 0.

    Returns
    -------
    tuple of array
        Coefficients (k,), constants of the groups (m,), residuals (n,).
    """
    means, level = group_means(terms, group), group_means(values, group)
    about, target = terms - means[group], values - level[group]
    found = solved(about.T @ about, about.T @ target)
    return found, level - means @ found, target - about @ found


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Means over groups of values (n,) or of rows (n, k): shape (m,) or (m, k)."""
    if values.ndim == 2:
        return np.stack([group_means(column, group) for column in values.T], axis=1)
    return np.bincount(group, values) / np.bincount(group)
