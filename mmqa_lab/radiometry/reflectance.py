"""Reflectance from images: equation 4, the empirical line, directions, errors (6-8), NDVI.

EuroSDR 2013, image radiometry. Equation 5 of the report is the definition of a bidirectional
reflectance, radiance over irradiance as functions of the angles; it is no model. The model here is
Walthall's, which the report names only where it describes the software XPro (a modified form).

Angles in degrees: zenith angles of sun and view from the vertical; the relative azimuth is 0 where
the camera looks at the ground with the sun behind it (backward scattering) and 180 where it looks
against the sun.
"""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice, check_number, check_positive

FORMS = ("walthall", "nilson-kuusk")


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


def reflectance_factor(
    radiance,
    irradiance: float,
    *,
    path_radiance: float = 0.0,
    transmittance: float = 1.0,
    spherical_albedo: float = 0.0,
    surroundings: float = 0.0,
):
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
    tau = check_positive(check_number(transmittance, "transmittance", high=1), "transmittance")
    s = check_number(spherical_albedo, "spherical_albedo", low=0, high=1)
    around = check_number(surroundings, "surroundings", low=0, high=1)
    of_ground = np.asarray(radiance, np.float64) - path_radiance
    return np.pi * of_ground * (1 - s * around) / (tau * irradiance)


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
        Anisotropy factor of each target as the camera saw it: a target that reflects 5 %
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
    >>> import pandas as pd
    >>> table = pd.DataFrame({"reflectance": [0.11, 0.19], "reference": [0.1, 0.2]})
    >>> reflectance_errors(table)["rmse_percent"].round(2).item()
    7.91
    """
    if not (table["reference"] > 0).all():
        raise ValueError(f"Invalid reference {table['reference'].min()}. Must be > 0.")
    error = table["reflectance"] - table["reference"]
    errors = table.assign(error=error, percent=100 * error / table["reference"])
    groups = errors.groupby(list(by) if len(by) else np.zeros(len(errors)), sort=False)
    found = groups.agg(
        n=("error", "size"),
        mean_error=("error", "mean"),
        rmse=("error", _rms),
        mean_error_percent=("percent", "mean"),
        rmse_percent=("percent", _rms),
    )
    return found.reset_index(drop=not len(by))


def _rms(values):
    """Root mean square."""
    return np.sqrt((values**2).mean())


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


@dataclass(frozen=True, eq=False)
class WalthallFit:
    """A fitted Walthall function.

    Parameters
    ----------
    coefficients : array
        In the order of ``walthall_terms``; the last is the constant.
    covariance : array
    form : str
        See ``walthall_terms``.
    rms : float
        Of the residuals, in reflectance, with the degrees of freedom taken off.
    n : int
        Observations.

    Examples
    --------
    >>> fit = WalthallFit(np.array([0.1, 0.05, 0.3]), np.zeros((3, 3)), "walthall", 0.0, 20)
    >>> round(float(fit.reflectance(45, 0, 0)), 6), float(fit.anisotropy(45, 30, 0)) > 1
    (0.3, True)
    """

    coefficients: np.ndarray
    covariance: np.ndarray
    form: str
    rms: float
    n: int

    def reflectance(self, sun_zenith, view_zenith, azimuth):
        """Reflectance factor in a direction."""
        terms = walthall_terms(sun_zenith, view_zenith, azimuth, form=self.form)
        return terms @ self.coefficients

    def anisotropy(self, sun_zenith, view_zenith, azimuth):
        """Anisotropy factor: the reflectance factor over that at nadir, under the same sun."""
        nadir = self.reflectance(sun_zenith, 0.0, 0.0)
        return self.reflectance(sun_zenith, view_zenith, azimuth) / nadir


def walthall_terms(sun_zenith, view_zenith, azimuth, *, form="walthall"):
    """Return the terms that Walthall's function is a sum of, shape (..., 3 or 4).

    Parameters
    ----------
    sun_zenith, view_zenith, azimuth : array_like
        Degrees; see the top of this module.
    form : {"walthall", "nilson-kuusk"}
        Walthall et al. 1985: v^2, v cos(a), 1, for one position of the sun. Nilson and Kuusk 1989:
        s^2 v^2, s^2 + v^2, s v cos(a), 1, which does not change when sun and camera are exchanged.
        s, v, a are the sun's zenith, the view's zenith, the azimuth, in radians.

    Returns
    -------
    array, shape (..., 3 or 4)

    Raises
    ------
    ValueError
        If the form is another.

    References
    ----------
    Walthall et al. 1985, doi:10.1364/AO.24.000383; Nilson & Kuusk 1989,
    doi:10.1016/0034-4257(89)90015-1.

    Examples
    --------
    >>> walthall_terms(45, 0, 0).tolist()
    [0.0, 0.0, 1.0]
    """
    check_choice(form, "form", FORMS)
    angles = np.broadcast_arrays(sun_zenith, view_zenith, azimuth)
    s, v, a = np.radians(np.asarray(angles, dtype=np.float64))
    one = np.ones_like(s)
    if form == "walthall":
        return np.stack([v**2, v * np.cos(a), one], axis=-1)
    return np.stack([s**2 * v**2, s**2 + v**2, s * v * np.cos(a), one], axis=-1)


def fit_walthall(reflectance, sun_zenith, view_zenith, azimuth, *, form="walthall"):
    """Fit Walthall's function to reflectances of one surface from many directions.

    Parameters
    ----------
    reflectance : array_like, shape (n,)
    sun_zenith, view_zenith, azimuth : array_like, shape (n,) or float
        Degrees.
    form : {"walthall", "nilson-kuusk"}

    Returns
    -------
    WalthallFit

    Raises
    ------
    ValueError
        If the directions do not tell the terms apart: too few, all at nadir, or one sun only for
        the second form.

    Examples
    --------
    >>> view, azimuth = np.array([0, 30, 30, 30.0, 50]), np.array([0, 0, 90, 180.0, 45])
    >>> seen = walthall_terms(40, view, azimuth) @ [0.1, 0.05, 0.2]
    >>> fit_walthall(seen, 40, view, azimuth).coefficients.round(6).tolist()
    [0.1, 0.05, 0.2]
    """
    seen = np.asarray(reflectance, dtype=np.float64)
    terms = np.broadcast_to(
        walthall_terms(sun_zenith, view_zenith, azimuth, form=form),
        (*seen.shape, 3 if form == "walthall" else 4),
    )
    freedom = len(seen) - terms.shape[1]
    if freedom < 1 or np.linalg.matrix_rank(terms, tol=1e-6 * len(seen)) < terms.shape[1]:
        raise ValueError(
            f"Invalid directions: {len(seen)} observations cannot tell {terms.shape[1]} terms "
            "apart. Must be more, from different directions."
        )
    coefficients, *_ = np.linalg.lstsq(terms, seen, rcond=None)
    residuals = seen - terms @ coefficients
    variance = residuals @ residuals / freedom
    covariance = variance * np.linalg.inv(terms.T @ terms)
    return WalthallFit(coefficients, covariance, form, float(np.sqrt(variance)), len(seen))
