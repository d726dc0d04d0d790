"""Reflectance by an empirical line or from radiance, the vegetation index, and anisotropy.

Walthall's function tells how the reflectance of a surface changes with the direction of view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_number, check_positive, check_together, refuse
from mmqa_lab._results import Shown, sentences
from mmqa_lab.radiometry.doubts import looseness, odd_target

__all__ = [
    "EmpiricalLine", "WalthallFit", "empirical_line", "fit_walthall", "ndvi",
    "reflectance_factor", "walthall_terms",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class EmpiricalLine(Shown):
    """Reflectance as a straight line of DN: reflectance = slope * DN + intercept.

    Parameters
    ----------
    slope, intercept : float
        Reflectance per DN, reflectance.
    covariance : array, shape (2, 2)
        Of (slope, intercept); NaN from two targets without known uncertainty.
    residuals : array, shape (n,)
        Known minus computed reflectance of the targets.
    freedom : float
        Degrees of freedom of the covariance: infinite where it follows from stated errors.
    odd : int, optional
        Number of the target, from 0, that leaves the line of the others.
    remarks : tuple of str
        Reasons to doubt the line.

    Examples
    --------
    >>> line = empirical_line([100, 500], [0.05, 0.45])
    >>> round(float(line.reflectance(300)), 6), line.n
    (0.25, 2)
    """

    slope: float
    intercept: float
    covariance: np.ndarray
    residuals: np.ndarray
    freedom: float = np.inf
    odd: int | None = None
    remarks: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of targets."""
        return len(self.residuals)

    def reflectance(self, dn: ArrayLike, *, anisotropy: ArrayLike = 1.0) -> np.ndarray:
        """Nadir reflectance of DN seen where the surface reflects ``anisotropy`` times as much."""
        return np.divide(self.slope * np.asarray(dn, np.float64) + self.intercept, anisotropy)

    def std(self, dn: ArrayLike, *, std_dn: ArrayLike = 0.0) -> np.ndarray:
        """Standard deviation of the reflectance: that of the line, and that of the DN."""
        dn = np.asarray(dn, dtype=np.float64)
        terms = np.stack([dn, np.ones_like(dn)], axis=-1)
        line = np.einsum("...i,ij,...j", terms, self.covariance, terms)
        return np.sqrt(line + (self.slope * np.asarray(std_dn)) ** 2)


def reflectance_factor(
    radiance: ArrayLike,
    irradiance: float,
    *,
    path_radiance: float = 0.0,
    transmittance: float = 1.0,
    spherical_albedo: float = 0.0,
    surroundings: float = 0.0,
) -> float | np.ndarray:
    """Return the reflectance of a target by equation 4.

    rho = pi (L - L_atm) (1 - s rho') / (E tau). In the notation of the report E is S tau_s: the
    irradiance of the sun above the air times the cosine of its zenith angle, times the
    transmittance on its way down.

    Parameters
    ----------
    radiance : array_like
        At the sensor, W m-2 sr-1 um-1.
    irradiance : float
        On level ground, W m-2 um-1, without the light that ground and air throw back and forth.
    path_radiance : float
        All light from elsewhere that the air adds between ground and sensor, unit of the radiance.
    transmittance : float
        Of the air between ground and sensor, 0 to 1.
    spherical_albedo : float
        s, the share of the light from the ground that the air sends back, 0 to 1.
    surroundings : float
        rho', mean reflectance around the target, 0 to 1.

    Returns
    -------
    float or array

    Raises
    ------
    ValueError
        If the irradiance is not above zero or a share is outside 0 to 1.

    Notes
    -----
    With ``spherical_albedo`` left at 0 the factor (1 - s rho') is 1. That is right only for an
    irradiance measured on site, which contains the light thrown back.

    References
    ----------
    EuroSDR 2013, image radiometry, equation 4.

    Examples
    --------
    >>> round(float(reflectance_factor(100.0, 1500.0, path_radiance=10.0, transmittance=0.9)), 3)
    0.209
    >>> air = {"path_radiance": 10.0, "transmittance": 0.9, "spherical_albedo": 0.1}
    >>> round(float(reflectance_factor(100.0, 1500.0, surroundings=0.2, **air)), 3)
    0.205
    """
    irradiance = check_positive(irradiance, "irradiance", unit="W m-2 um-1")
    tau = check_number(transmittance, "transmittance", low=0.001, high=1)
    s = check_number(spherical_albedo, "spherical_albedo", low=0, high=1)
    around = check_number(surroundings, "surroundings", low=0, high=1)
    (radiance,) = check_together(radiance=radiance, missing=True)
    of_ground = radiance - path_radiance
    return np.pi * of_ground * (1 - s * around) / (tau * irradiance)


def empirical_line(
    dn: ArrayLike,
    reflectance: ArrayLike,
    *,
    std_dn: ArrayLike | None = None,
    anisotropy: ArrayLike = 1.0,
    leave_out: bool = False,
) -> EmpiricalLine:
    """Fit reflectance as a line of DN through targets of known reflectance.

    Parameters
    ----------
    dn : array_like, shape (n,)
        Mean DN of the targets, n >= 2.
    reflectance : array_like, shape (n,)
        Known reflectance at nadir.
    std_dn : float or array_like, shape (n,), optional
        Standard error of each mean DN. Where given, targets weigh by its inverse square, and the
        covariance follows from it; where not, it follows from the residuals (n >= 3).
    anisotropy : float or array_like, shape (n,)
        Anisotropy factor of each target as the camera saw it: a target that reflects 5 %
        more that way than at nadir has 1.05.
    leave_out : bool
        Leave out the target that leaves the line of all others by more than its error, if there is
        one. It is named in any case.

    Returns
    -------
    EmpiricalLine

    Raises
    ------
    ValueError
        If there are fewer than two targets or all have the same DN, a reflectance is not between 0
        and 1, or reflectance does not grow with DN.

    Notes
    -----
    With two targets the line passes through both: their errors are not seen (``remarks``), and
    reflectance beyond the brighter one is extrapolated. Residuals larger than stated errors allow
    (1 %) widen the covariance to what they show.

    Examples
    --------
    >>> line = empirical_line([200, 1000, 1800], [0.05, 0.25, 0.45])
    >>> round(float(line.reflectance(600)), 3)
    0.15
    """
    dn, reflectance, anisotropy = check_together(
        dn=dn, reflectance=reflectance, anisotropy=anisotropy, to_first=True
    )
    refuse(dn.ndim != 1, "targets", f"dn of shape {dn.shape}", "a row")
    known = np.broadcast_to(reflectance * anisotropy, dn.shape)
    few = len(dn) < 2 or np.ptp(dn) == 0
    refuse(few, "targets", f"{dn.size} given", "two or more of different, finite DN")
    for share in np.ravel(reflectance).tolist():
        check_number(share, "reflectance", low=0, high=1)
    slope = np.polyfit(dn, known, 1)[0]
    if not slope * np.ptp(dn) > 1e-9:
        raise ValueError("Invalid targets: brighter ones do not have a larger DN. Must have.")
    stated = std_dn is not None
    std = slope * np.asarray(std_dn) * np.ones_like(dn) if stated else np.ones_like(dn)
    refuse(not (std > 0).all(), "standard errors", "one of them is not", "> 0 DN")
    odd = odd_target(np.stack([dn, np.ones_like(dn)], axis=1), known, std, stated=stated)
    used = np.arange(len(dn)) != (odd if leave_out else None)
    line, covariance = np.polyfit(dn[used], known[used], 1, w=1 / std[used], cov="unscaled")
    left = known - np.polyval(line, dn)
    freedom = int(used.sum()) - 2
    loose = looseness(left[used], std[used], freedom) if stated else 1.0
    if stated:
        covariance = covariance * loose**2
    else:
        square = left[used] @ left[used]
        covariance = covariance * (square / freedom if freedom else np.nan)
    named = "" if odd is None else f"reference {odd + 1} of {len(dn)} leaves the line of the others"
    wide = f"residuals are {loose:.1f} times the stated errors, the interval is wider by that"
    remarks = sentences(
        (len(dn) == 2, "two references cannot check each other"),
        (odd is not None, f"{named} and is left out" if leave_out else named),
        (loose > 1, wide),
    )
    slope, intercept = map(float, line)
    freedom = np.inf if stated and loose == 1 else freedom
    return EmpiricalLine(slope, intercept, covariance, left, freedom, odd, tuple(remarks))


def ndvi(
    near_infrared: ArrayLike,
    red: ArrayLike,
    *,
    std_near_infrared: ArrayLike = 0.0,
    std_red: ArrayLike = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return NDVI = (N - R) / (N + R) and its standard deviation.

    Parameters
    ----------
    near_infrared, red : array_like
        Reflectances, not DN: the index of DN depends on both bands' gains.
    std_near_infrared, std_red : array_like
        Their standard deviations. Errors that both bands share, as of the light, nearly cancel.

    Returns
    -------
    ndvi, std : array
        First-order propagation of independent errors.

    Examples
    --------
    >>> value, std = ndvi(0.45, 0.05, std_near_infrared=0.0225, std_red=0.0025)
    >>> round(float(value), 3), round(float(std), 4)
    (0.8, 0.0127)
    """
    n, r = check_together(near_infrared=near_infrared, red=red, missing=True)
    total = n + r
    errors = np.hypot(np.multiply(r, std_near_infrared), np.multiply(n, std_red))
    return (n - r) / total, 2 * errors / total**2


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
