"""Reflectance from images: equation 4, the empirical line, errors (equations 6-8), NDVI.

EuroSDR 2013, image radiometry, "up to 5 % accuracy" of reflectance in the best cases.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_number, check_positive


@dataclass(frozen=True, eq=False)
class EmpiricalLine:
    """Reflectance as a straight line of DN: reflectance = slope * DN + intercept.

    Parameters
    ----------
    slope, intercept : float
        Reflectance per DN, reflectance.
    covariance : array, shape (2, 2)
        Of (slope, intercept); NaN from two targets without known uncertainty.
    residuals : array, shape (n,)
        Known minus computed reflectance of the targets.

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

    @property
    def n(self):
        """Number of targets."""
        return len(self.residuals)

    def reflectance(self, dn, *, anisotropy=1.0):
        """Nadir reflectance of DN seen where the surface reflects ``anisotropy`` times as much."""
        return (self.slope * np.asarray(dn, np.float64) + self.intercept) / anisotropy

    def std(self, dn, *, std_dn=0.0):
        """Standard deviation of the reflectance: that of the line, and that of the DN."""
        dn = np.asarray(dn, dtype=np.float64)
        terms = np.stack([dn, np.ones_like(dn)], axis=-1)
        line = np.einsum("...i,ij,...j", terms, self.covariance, terms)
        return np.sqrt(line + (self.slope * np.asarray(std_dn)) ** 2)


def reflectance_factor(radiance, irradiance, *, path_radiance=0.0, transmittance=1.0):
    """Return the reflectance factor pi (L - L_path) / (tau E) of a surface.

    Parameters
    ----------
    radiance : array_like
        At the sensor, W m-2 sr-1 um-1.
    irradiance : float
        On the (level) ground, W m-2 um-1: the sun's times the cosine of its zenith angle, and the
        sky's.
    path_radiance : float
        What the air between ground and sensor adds, unit of the radiance.
    transmittance : float
        Of the air between ground and sensor, 0 to 1.

    Returns
    -------
    float or array

    Raises
    ------
    ValueError
        If the irradiance is not above zero or the transmittance lies outside 0 to 1.

    References
    ----------
    EuroSDR 2013, image radiometry, equation 4.

    Examples
    --------
    >>> round(float(reflectance_factor(100.0, 1500.0, path_radiance=10.0, transmittance=0.9)), 3)
    0.209
    """
    irradiance = check_positive(irradiance, "irradiance", unit="W m-2 um-1")
    tau = check_positive(check_number(transmittance, "transmittance", high=1), "transmittance")
    return np.pi * (np.asarray(radiance, np.float64) - path_radiance) / (tau * irradiance)


def empirical_line(dn, reflectance, *, std_dn=None, anisotropy=1.0):
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
        Anisotropy factor of each target as the camera saw it (``brdf``): a target that reflects 5 %
        more that way than at nadir has 1.05.

    Returns
    -------
    EmpiricalLine

    Raises
    ------
    ValueError
        If there are fewer than two targets or all have the same DN.

    Notes
    -----
    With two targets the line passes through both: errors of the targets are not seen, and
    reflectance beyond the brighter one is extrapolated.

    Examples
    --------
    >>> line = empirical_line([200, 1000, 1800], [0.05, 0.25, 0.45])
    >>> round(float(line.reflectance(600)), 3)
    0.15
    """
    dn = np.asarray(dn, dtype=np.float64)
    known = np.broadcast_to(np.asarray(reflectance, np.float64) * anisotropy, dn.shape)
    if dn.ndim != 1 or len(dn) < 2 or not np.isfinite([dn, known]).all() or np.ptp(dn) == 0:
        raise ValueError(
            f"Invalid targets: {dn.size} given. Must be two or more of different, finite DN."
        )
    design = np.stack([dn, np.ones_like(dn)], axis=1)
    slope = np.polyfit(dn, known, 1)[0]
    std = np.ones_like(dn) if std_dn is None else np.abs(slope) * np.broadcast_to(std_dn, dn.shape)
    if (std <= 0).any():
        raise ValueError("Invalid standard errors. Must be > 0 DN.")
    weighted = design / std[:, None]
    inverse = np.linalg.inv(weighted.T @ weighted)
    line = inverse @ weighted.T @ (known / std)
    residuals = known - design @ line
    freedom = len(dn) - 2
    variance = 1.0 if std_dn is not None else residuals @ residuals / freedom if freedom else np.nan
    return EmpiricalLine(float(line[0]), float(line[1]), inverse * variance, residuals)


def reflectance_errors(table, *, by=()):
    """Sum up the errors of computed reflectance.

    Parameters
    ----------
    table : DataFrame
        ``reflectance`` (computed) and ``reference``, one row a target and image.
    by : sequence of str
        Columns that form groups, such as ``band`` and ``target_class``.

    Returns
    -------
    DataFrame
        One row a group: ``n``; ``mean_error`` and ``rmse`` in reflectance units (equations 6 and
        8); ``mean_error_percent`` and ``rmse_percent`` of the reference (equation 7 and its RMSE).

    Raises
    ------
    ValueError
        If a reference is not above zero.

    References
    ----------
    EuroSDR 2013, image radiometry, equations 6-8.

    Examples
    --------
    >>> table = pd.DataFrame({"reflectance": [0.11, 0.19], "reference": [0.1, 0.2]})
    >>> reflectance_errors(table)["rmse_percent"].round(2).item()
    7.91
    """
    if not (table["reference"] > 0).all():
        raise ValueError(f"Invalid reference {table['reference'].min()}. Must be > 0.")
    error = table["reflectance"] - table["reference"]
    percent = 100 * error / table["reference"]
    errors = table.assign(error=error, percent=percent)
    groups = errors.groupby(list(by), sort=False) if len(by) else [((), errors)]
    rows = []
    for key, group in groups:
        of_group = {
            "n": len(group),
            "mean_error": group["error"].mean(),
            "rmse": np.sqrt((group["error"] ** 2).mean()),
            "mean_error_percent": group["percent"].mean(),
            "rmse_percent": np.sqrt((group["percent"] ** 2).mean()),
        }
        rows.append(dict(zip(by, key, strict=True)) | of_group)
    return pd.DataFrame(rows)


def ndvi(near_infrared, red, *, std_near_infrared=0.0, std_red=0.0, correlation=0.0):
    """Return NDVI = (N - R) / (N + R) and its standard deviation.

    Parameters
    ----------
    near_infrared, red : array_like
        Reflectances, not DN: the index of DN depends on both bands' gains.
    std_near_infrared, std_red : array_like
        Their standard deviations.
    correlation : float
        Of the errors of the two bands; errors that both share (illumination) have one near 1, and
        then most of them cancel.

    Returns
    -------
    ndvi, std : array
        First-order propagation.

    Raises
    ------
    ValueError
        If the correlation lies outside -1 to 1.

    Examples
    --------
    >>> value, std = ndvi(0.45, 0.05, std_near_infrared=0.0225, std_red=0.0025)
    >>> round(float(value), 3), round(float(std), 4)
    (0.8, 0.0127)
    """
    n, r = np.asarray(near_infrared, np.float64), np.asarray(red, np.float64)
    check_number(correlation, "correlation", low=-1, high=1)
    total = n + r
    by_n, by_r = 2 * r / total**2 * std_near_infrared, -2 * n / total**2 * std_red
    variance = by_n**2 + by_r**2 + 2 * correlation * by_n * by_r
    return (n - r) / total, np.sqrt(variance)
