"""Walthall's function: how the reflectance of a surface changes with the direction of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_together, refuse
from mmqa_lab._results import Shown

__all__ = ["WalthallFit", "fit_walthall", "walthall_terms"]
__dir__ = __all__.copy


@dataclass(frozen=True, eq=False)
class WalthallFit(Shown):
    """A fitted Walthall function: ``coefficients`` of v^2, v cos(a) and 1."""

    coefficients: np.ndarray

    def anisotropy(self, view_zenith: ArrayLike, azimuth: ArrayLike) -> np.ndarray:
        """Anisotropy factor: the reflectance factor over that at nadir."""
        return walthall_terms(view_zenith, azimuth) @ self.coefficients / self.coefficients[2]


def fit_walthall(reflectance: ArrayLike, view_zenith: ArrayLike, azimuth: ArrayLike) -> WalthallFit:
    """Fit Walthall's function to reflectances of one surface from many directions.

    Parameters
    ----------
    reflectance : array_like, shape (n,)
    view_zenith, azimuth : array_like, shape (n,) or float
        Degrees, for one position of the sun.

    Returns
    -------
    WalthallFit

    Raises
    ------
    ValueError
        If the directions do not tell the terms apart: too few, or all at nadir.

    References
    ----------
    Walthall et al. 1985, doi:10.1364/AO.24.000383.

    Examples
    --------
    >>> view, azimuth = np.array([0, 30, 30, 30.0, 50]), np.array([0, 0, 90, 180.0, 45])
    >>> fit = fit_walthall(walthall_terms(view, azimuth) @ [0.1, 0.05, 0.2], view, azimuth)
    >>> fit.coefficients.round(6).tolist(), float(fit.anisotropy(30, 0)) > 1
    ([0.1, 0.05, 0.2], True)
    """
    given = {"reflectance": reflectance, "view_zenith": view_zenith, "azimuth": azimuth}
    seen, view_zenith, azimuth = check_together(**given, to_first=True)
    refuse(seen.ndim != 1, "reflectance", f"shape {seen.shape}", "a row")
    terms = np.broadcast_to(walthall_terms(view_zenith, azimuth), (*seen.shape, 3))
    few = len(seen) < 4 or np.linalg.matrix_rank(terms, tol=1e-6 * len(seen)) < 3
    found = f"{len(seen)} observations cannot tell three terms apart"
    refuse(few, "directions", found, "more, from different directions")
    return WalthallFit(np.linalg.lstsq(terms, seen, rcond=None)[0])


def walthall_terms(view_zenith: ArrayLike, azimuth: ArrayLike) -> np.ndarray:
    """Return v^2, v cos(a) and 1 with v and a in radians, shape (..., 3)."""
    v, a = np.radians(np.asarray(np.broadcast_arrays(view_zenith, azimuth), dtype=np.float64))
    return np.stack([v**2, v * np.cos(a), np.ones_like(v)], axis=-1)
