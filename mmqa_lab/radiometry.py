"""Radiometry of digital images: radiance, reflectance, even blocks of images.

EuroSDR 2013, image radiometry (project "Radiometric aspects of digital photogrammetric images",
2008-2011, Honkavaara et al.). The functions follow the steps of the report: DN to radiance
(equations 2 and 3), reflectance (equation 4, empirical line, NDVI), one adjustment of overlapping
images. Resolution is in ``mmqa_lab.mtf``. The sum of radiances at the sensor (equation
1) is simulated in ``mmqa_lab.simulate.targets``. Equation 5 defines a bidirectional reflectance and
is no model; the model here is Walthall's, which the report names only where it describes the
software XPro (a modified form). Equations are numbered as in the report.

A linear sensor records DN = offset + gain * radiance * exposure, where exposure is the exposure
time over the squared f-number, relative to that of a reference setting: L = K DN f^2 / t. That
follows from equation 2, in which DN grows with the lens's solid angle and the exposure time.
Equation 3 as printed there, L = K' (t / f) DN, has the ratio upside down and f not squared; this
room deviates from it.

One least-squares solution adjusts all overlapping images of a block, after Pepita in EuroSDR 2013,
image radiometry, sections 6.1 and 6.2, which does for radiometry what aerial triangulation does for
geometry. Pepita is relative and estimates haze for groups of images, here those that a column
names; control targets are an addition. A tie point is a patch of ground that several images
show; all that makes its values differ (exposure, height of the sun, haze, anisotropic reflectance,
falling off to the corners) is estimated from all of them together. The radiance of tie point k in
image i is taken to be

    L = gain_i * (cos(sun_i) * R_k * (1 + b1 v^2 + b2 v cos(a)) + haze) * (1 - radial * r^2)

with Walthall's terms (v, a: zenith angle and azimuth of the view; radians) and r, the distance from
the image's centre over that of its corner. With control targets R is reflectance, without any it is
relative.

Angles in degrees: zenith angles of sun and view from the vertical; the relative azimuth is 0 where
the camera looks at the ground with the sun behind it (backward scattering) and 180 where it looks
against the sun.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.special import stdtrit
from scipy.stats import median_abs_deviation

from mmqa_lab._checks import check_columns, check_count, check_number, check_positive, refuse
from mmqa_lab._results import Shown, sentences

__all__ = [
    "adjust_block", "empirical_line", "fit_sensor", "fit_walthall", "ndvi", "patch_statistics",
    "reflectance_factor", "relative_exposure", "stability",
]  # fmt: skip
__dir__ = __all__.copy

UNDETERMINED = (
    "Invalid block: its parameters cannot be told apart. Must have more overlap, control targets, "
    "or priors (see Notes)."
)

ANGLES = ("sun_zenith_deg", "view_zenith_deg", "azimuth_deg")

OBSERVATION_COLUMNS = ("image", "tie", "radiance", *ANGLES, "radius")

SHADOW, RELATIVE_STD, SMALLEST_STD = 6.0, 0.02, 1e-4
"""Deviations that hardly count; standard deviation of an observation, a share of its radiance: to
begin with, and at least."""

ROUNDS, REWEIGHTINGS = 50, 16
"""Largest number of iterations, and iterations in which weights change."""

FEWEST_PILED, LARGEST_DN = 9, tuple(2**bits - 1 for bits in (8, 10, 12, 14, 16))
"""Pixels of one value that may be chance; the largest digital numbers of sensors and files."""

FALLOFF = (0.0, 0.3)
"""Light lost in the corners of an image of which nothing is known, and its standard deviation."""

LOOSE, FEWEST_TIES = 2.0, 8
"""Spread of an image's observations over that of most from which it is said, and their number."""

RINGS, FALLS_OTHERWISE = 5, 4.0
"""Rings around the centre of an image, and standard errors by which one may differ from others."""


@dataclass(frozen=True, eq=False)
class SensorFit(Shown):
    """A linear sensor model and how well it is known.

    Parameters
    ----------
    gain, offset : float
        DN per unit of radiance at exposure 1, and DN of darkness.
    std : array, shape (2,)
        Standard errors of (gain, offset).
    r_squared : float
        Share of the (weighted) variance of DN that radiance explains.
    residuals : array, shape (n,)
        DN minus the line for every given target, NaN for the saturated ones.
    saturated : int
        Targets left out because they were saturated.

    Examples
    --------
    >>> fit = fit_sensor([10, 20, 40, 80], [120, 220, 420, 820])
    >>> round(fit.gain, 6), round(fit.offset, 6), round(float(fit.radiance(520)), 6)
    (10.0, 20.0, 50.0)
    """

    gain: float
    offset: float
    std: np.ndarray
    r_squared: float
    residuals: np.ndarray
    saturated: int

    @property
    def n(self) -> int:
        """Number of targets used."""
        return int(np.isfinite(self.residuals).sum())

    def _ends(self):
        reach = stdtrit(self.freedom, 0.975) * self.std
        rows = ("gain", self.gain, reach[0], "DN"), ("offset", self.offset, reach[1], "DN")
        return [(name, value, value - r, value + r, unit) for name, value, r, unit in rows]

    @property
    def freedom(self) -> int:
        """Degrees of freedom: targets less the coefficients that were fitted."""
        return self.n - 1 - int(self.std[1] > 0)

    def radiance(self, dn: ArrayLike, *, exposure: ArrayLike = 1.0) -> np.ndarray:
        """Radiance of digital numbers taken at an exposure relative to the calibration's."""
        exposure = check_positive(exposure, "exposure")
        return (np.asarray(dn, dtype=np.float64) - self.offset) / (self.gain * exposure)

    def to_frame(self) -> pd.DataFrame:
        """Return one row: both coefficients with standard errors, R2 and counts."""
        figures = {"gain": self.gain, "gain_std": self.std[0]}
        figures |= {"offset_dn": self.offset, "offset_std_dn": self.std[1]}
        counts = {"r_squared": self.r_squared, "n": self.n, "saturated": self.saturated}
        return pd.DataFrame([figures | counts])


def relative_exposure(
    time_s: float, f_number: float, *, reference: tuple[float, float] = (0.01, 4.0)
) -> float:
    """Return the exposure time / f-number squared, over that of a reference setting.

    Parameters
    ----------
    time_s, f_number : float
    reference : (float, float)
        Exposure time (s) and f-number at which the relative exposure is 1.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If a setting is not above zero.

    Examples
    --------
    >>> relative_exposure(0.02, 8.0)
    0.5
    """
    for value in (time_s, f_number, *reference):
        check_positive(value, "exposure setting")
    return time_s / reference[0] * (reference[1] / f_number) ** 2


def patch_statistics(
    image: ArrayLike, patches: ArrayLike, *, full_scale: float | None = None
) -> pd.DataFrame:
    """Return the mean DN of targets in an image, and how much of each is saturated.

    Parameters
    ----------
    image : array_like, shape (rows, columns)
        One band.
    patches : array_like of int, shape (m, 4)
        First row, last row (excluded), first column, last column (excluded) of each target.
    full_scale : float, optional
        DN from which a pixel is saturated. When not given it is the highest value, if that is the
        largest of 8, 10, 12, 14 or 16 bits, or if ten pixels, more than 1 in 10,000 and five times
        as many as of any of the ten levels below have it.

    Returns
    -------
    DataFrame
        ``n``, ``mean_dn``, ``std_dn`` (of a pixel), ``std_error_dn`` (of the mean),
        ``saturated_share``.

    Raises
    ------
    ValueError
        If a patch has fewer than two pixels or leaves the image.

    Examples
    --------
    >>> image = np.array([[10.0, 12.0, 255.0, 255.0]] * 2)
    >>> found = patch_statistics(image, [[0, 2, 0, 2], [0, 2, 2, 4]], full_scale=255)
    >>> found["mean_dn"].tolist(), found["saturated_share"].tolist()
    ([11.0, 255.0], [0.0, 1.0])
    """
    image = np.asarray(image, dtype=np.float64)
    full_scale = saturation_level(image) if full_scale is None else full_scale
    rows = []
    for r0, r1, c0, c1 in np.asarray(patches, dtype=int):
        inside = 0 <= r0 < r1 <= image.shape[0] and 0 <= c0 < c1 <= image.shape[1]
        wrong = not inside or (r1 - r0) * (c1 - c0) < 2
        found = f"rows {r0} to {r1}, columns {c0} to {c1}"
        refuse(wrong, "patch", found, f"two or more pixels in an image of {image.shape}")
        dn = image[r0:r1, c0:c1].ravel()
        std = dn.std(ddof=1)
        rows.append((dn.size, dn.mean(), std, std / np.sqrt(dn.size), (dn >= full_scale).mean()))
    columns = ["n", "mean_dn", "std_dn", "std_error_dn", "saturated_share"]
    return pd.DataFrame(rows, columns=columns)


def fit_sensor(
    radiance: ArrayLike,
    dn: ArrayLike,
    *,
    exposure: ArrayLike = 1.0,
    std_dn: ArrayLike | None = None,
    full_scale: float = np.inf,
    through_zero: bool = False,
) -> SensorFit:
    """Fit gain and offset of a sensor to targets of known radiance.

    Weighted regression of DN on radiance times exposure. Targets whose DN comes within three of
    their standard deviations of full scale are left out: a mean of clipped pixels is too low.

    Parameters
    ----------
    radiance : array_like, shape (n,)
        At the sensor, W m-2 sr-1 um-1 or any unit in which the answer is wanted.
    dn : array_like, shape (n,)
        Digital numbers of the targets.
    exposure : float or array_like, shape (n,)
        See ``relative_exposure``.
    std_dn : float or array_like, shape (n,), optional
        Standard deviation of a target's pixels; weights are its inverse square. Without it all
        targets weigh alike, which is right only where noise does not grow with the signal.
    full_scale : float
        DN from which a pixel is saturated.
    through_zero : bool
        Fit a gain alone, as the radiance-based calibration of section 4.2 does: DN of darkness are
        subtracted before. R2 is then of the squares about zero.

    Returns
    -------
    SensorFit

    Raises
    ------
    ValueError
        If fewer than three unsaturated targets are left or all have the same radiance.

    References
    ----------
    EuroSDR 2013, image radiometry, equation 2; for equation 3 see the top of this module.

    Examples
    --------
    >>> fit = fit_sensor([10, 20, 40, 80], [120, 220, 420, 820.4])
    >>> round(fit.gain, 2), round(fit.offset, 1), fit.n
    (10.01, 19.9, 4)
    """
    from statsmodels.regression.linear_model import WLS

    dn = np.asarray(dn, dtype=np.float64)
    signal = np.broadcast_to(np.multiply(radiance, exposure), dn.shape)
    std = np.broadcast_to(1.0 if std_dn is None else np.asarray(std_dn, np.float64), dn.shape)
    if not (np.isfinite(signal).all() and np.isfinite(dn).all() and (std > 0).all()):
        raise ValueError("Invalid targets. Must be finite, their standard deviations > 0 DN.")
    used = dn + 3 * (0 if std_dn is None else std) < full_scale
    few = used.sum() < 3 or np.ptp(signal[used]) == 0
    found = f"{used.sum()} unsaturated of {len(dn)}"
    refuse(few, "targets", found, "three or more, of different radiance")
    terms = 1 if through_zero else 2
    design = np.stack([signal, np.ones_like(signal)], axis=1)[:, :terms]
    fit = WLS(dn[used], design[used], weights=std[used] ** -2).fit()
    gain, offset = np.append(fit.params, 0.0)[:2].tolist()
    residuals = np.where(used, dn - design @ fit.params, np.nan)
    std, saturated = np.append(fit.bse, 0.0)[:2], int((~used).sum())
    return SensorFit(gain, offset, std, float(fit.rsquared), residuals, saturated)


def coarse_pairs(image: ArrayLike, reference: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return DN and radiance of two images of the same ground, one band each, as flat arrays.

    Pixels are averaged to those of the reference, then both pass a median of 3 x 3 (EuroSDR 2013,
    image radiometry, section 4.2: DMC against CASI).
    """
    image, reference = (np.asarray(part, dtype=np.float32) for part in (image, reference))
    coarse = cv2.resize(image, reference.shape[::-1], interpolation=cv2.INTER_AREA)
    return tuple(cv2.medianBlur(part, 3).ravel() for part in (coarse, reference))


def stability(fits: dict[str, SensorFit], radiance: ArrayLike) -> pd.DataFrame:
    """Compare settings: how well the parameters of each fit the images of the others.

    Digital numbers that one setting gives for known radiances are turned into radiance with the
    parameters of another. If exposure time and f-number were what their records say, and nothing
    changed in between, all differences would be zero.

    Parameters
    ----------
    fits : dict of str to SensorFit
        By the name of the setting (exposure time, f-number, date), all at relative exposure.
    radiance : array_like, shape (n,)
        At which they are compared.

    Returns
    -------
    DataFrame
        A row for each ordered pair: ``setting``, ``other`` (whose parameters are used) and
        ``difference_percent``, the mean absolute difference of the radiance.

    Raises
    ------
    ValueError
        If there are fewer than two settings.

    References
    ----------
    EuroSDR 2013, image radiometry, section 4.3; how differences are averaged is not printed.

    Examples
    --------
    >>> one = fit_sensor([10, 20, 40, 80], [120, 220, 420, 820.4])
    >>> two = fit_sensor([10, 20, 40, 80], [122, 224, 428, 836.4])
    >>> stability({"1/100 s": one, "1/200 s": two}, [20, 40, 80])["difference_percent"].round(1)
    0    2.0
    1    2.0
    Name: difference_percent, dtype: float64
    """
    check_count(len(fits), "number of settings", low=2)
    known, rows = np.asarray(radiance, dtype=np.float64), []
    for (name, fit), (other, second) in permutations(fits.items(), 2):
        found = second.radiance(fit.offset + fit.gain * known)
        rows.append((name, other, 100 * np.abs(found / known - 1).mean()))
    return pd.DataFrame(rows, columns=["setting", "other", "difference_percent"])


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
    def n(self) -> int:
        """Number of targets."""
        return len(self.residuals)

    @property
    def remark(self) -> str:
        """Reason to doubt the standard deviations; empty if there is none."""
        return "two references cannot check each other" if self.n == 2 else ""

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
    of_ground = np.asarray(radiance, np.float64) - path_radiance
    return np.pi * of_ground * (1 - s * around) / (tau * irradiance)


def empirical_line(
    dn: ArrayLike,
    reflectance: ArrayLike,
    *,
    std_dn: ArrayLike | None = None,
    anisotropy: ArrayLike = 1.0,
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
    With two targets the line passes through both: their errors are not seen (``remark``), and
    reflectance beyond the brighter one is extrapolated.

    Examples
    --------
    >>> line = empirical_line([200, 1000, 1800], [0.05, 0.25, 0.45])
    >>> round(float(line.reflectance(600)), 3)
    0.15
    """
    dn = np.asarray(dn, dtype=np.float64)
    known = np.broadcast_to(np.multiply(reflectance, anisotropy), dn.shape)
    few = dn.ndim != 1 or len(dn) < 2 or not np.isfinite([dn, known]).all() or np.ptp(dn) == 0
    refuse(few, "targets", f"{dn.size} given", "two or more of different, finite DN")
    for share in np.ravel(reflectance).tolist():
        check_number(share, "reflectance", low=0, high=1)
    slope = np.polyfit(dn, known, 1)[0]
    if not slope * np.ptp(dn) > 1e-9:
        raise ValueError("Invalid targets: brighter ones do not have a larger DN. Must have.")
    std = np.ones_like(dn) if std_dn is None else slope * np.asarray(std_dn)
    if (std <= 0).any():
        raise ValueError("Invalid standard errors. Must be > 0 DN.")
    weight = np.broadcast_to(1 / std, dn.shape)
    line, covariance = np.polyfit(dn, known, 1, w=weight, cov="unscaled")
    left = known - np.polyval(line, dn)
    if std_dn is None:
        covariance = covariance * (left @ left / (len(dn) - 2) if len(dn) > 2 else np.nan)
    slope, intercept = map(float, line)
    return EmpiricalLine(slope, intercept, covariance, left)


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
    n, r = np.asarray(near_infrared, np.float64), np.asarray(red, np.float64)
    total = n + r
    errors = np.hypot(np.multiply(r, std_near_infrared), np.multiply(n, std_red))
    return (n - r) / total, 2 * errors / total**2


def saturation_level(dn: np.ndarray) -> float:
    """Return the digital number on which saturated pixels pile up, infinity where none does.

    The largest number of 8, 10, 12, 14 or 16 bits is that of saturation, if only a pixel has it.
    """
    top = dn.max()
    counts = np.array([np.count_nonzero(dn == top - k) for k in range(11)])
    piled = counts[0] > max(1e-4 * dn.size, 5 * counts[1:].max(), FEWEST_PILED)
    return float(top) if piled or top in LARGEST_DN else np.inf


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
    seen = np.asarray(reflectance, dtype=np.float64)
    terms = np.broadcast_to(walthall_terms(view_zenith, azimuth), (*seen.shape, 3))
    few = len(seen) < 4 or np.linalg.matrix_rank(terms, tol=1e-6 * len(seen)) < 3
    found = f"{len(seen)} observations cannot tell three terms apart"
    refuse(few, "directions", found, "more, from different directions")
    return WalthallFit(np.linalg.lstsq(terms, seen, rcond=None)[0])


def walthall_terms(view_zenith: ArrayLike, azimuth: ArrayLike) -> np.ndarray:
    """Return v^2, v cos(a) and 1 with v and a in radians, shape (..., 3)."""
    v, a = np.radians(np.asarray(np.broadcast_arrays(view_zenith, azimuth), dtype=np.float64))
    return np.stack([v**2, v * np.cos(a), np.ones_like(v)], axis=-1)


@dataclass(frozen=True, eq=False)
class BlockAdjustment(Shown):
    """An adjusted block.

    Parameters
    ----------
    gains : DataFrame
        ``image``, ``gain``, ``gain_std_percent``, ``n`` (its tie points), ``haze``, ``haze_std`` (0
        where fixed), the same in all images of a group.
    anisotropy : DataFrame
        ``surface``, ``b1``, ``b2`` and their standard deviations.
    radial : (float, float)
        Value and standard deviation (0 where fixed).
    ties : DataFrame
        ``tie``, ``reflectance`` (relative without control), ``n``, ``cv_before_percent`` and
        ``cv_after_percent``: coefficient of variation of its values over the images, before
        (radiance over the cosine of the sun's zenith angle) and after.
    absolute : bool
        Whether control targets gave the scale.

    Examples
    --------
    >>> rows = [(0, "a", 10.0), (0, "b", 20.0), (1, "a", 11.0), (1, "b", 22.0)]
    >>> seen = pd.DataFrame(rows, columns=["image", "tie", "radiance"]).assign(
    ...     sun_zenith_deg=40.0, view_zenith_deg=10.0, azimuth_deg=0.0, radius=0.0)
    >>> block = adjust_block(seen, anisotropy=False)
    >>> corrected = block.correct(seen)
    >>> bool(np.allclose(corrected[:2], corrected[2:]))
    True
    """

    gains: pd.DataFrame
    anisotropy: pd.DataFrame
    radial: tuple
    ties: pd.DataFrame
    absolute: bool

    def to_frame(self) -> pd.DataFrame:
        """Return the gains, one row an image."""
        return self.gains.copy()

    def correct(self, observations: pd.DataFrame, *, to_nadir: bool = True) -> pd.DataFrame:
        """Return the reflectance (relative without control) of each observation.

        Parameters
        ----------
        observations : DataFrame
            Columns as for ``adjust_block``; any pixel of any image of the block will do.
        to_nadir : bool
            Whether to divide by the anisotropy factor that was found; without, the result is the
            reflectance factor in the direction of the view.
        """
        of_image = self.gains.set_index("image")[["gain", "haze"]].reindex(observations["image"])
        gain, haze = of_image.to_numpy().T
        coefficients = self.anisotropy.set_index("surface")[["b1", "b2"]]
        b = coefficients.reindex(_surfaces_of(observations)).to_numpy()
        radius = observations["radius"].to_numpy()
        light = observations["radiance"].to_numpy() / (gain * (1 - self.radial[0] * radius**2))
        seen = (light - haze) / _sun_cosine(observations)
        anisotropy = 1 + (_view_terms(observations) * b).sum(axis=1)
        return seen / anisotropy if to_nadir else seen


def adjust_block(
    observations: pd.DataFrame,
    *,
    control: pd.DataFrame | None = None,
    anisotropy: bool = True,
    radial: tuple[float, float] = FALLOFF,
    haze: tuple[float, float] | None = None,
) -> BlockAdjustment:
    """Adjust the radiometry of a block of overlapping images.

    Gauss-Newton on all parameters and reflectances together, whose normal matrix is sparse. The
    standard deviation of an observation is a share of its radiance that the misfits show.
    Observations that fit badly are weighed down (Geman and McClure 1987), and those far off, as in
    shadow, do not count. A prior is a value and a standard deviation: 0 keeps the value, infinity
    leaves it to the images.

    Parameters
    ----------
    observations : DataFrame
        One row for each tie point in each image: ``image``, ``tie``, ``radiance`` (DN less offset,
        over gain and exposure), ``sun_zenith_deg``, ``view_zenith_deg``,
        ``azimuth_deg`` (0 with the sun behind the camera), ``radius`` (0 in the centre, 1 in the
        corner). Optionally ``surface``: each gets an anisotropy of its own; and ``group``, the same
        in all rows of an image: each gets a haze of its own.
    control : DataFrame, optional
        ``tie``, ``reflectance``, ``std``: targets of known nadir reflectance. Two or more of
        different brightness are needed to estimate haze.
    anisotropy : bool
        Estimate b1 and b2 of each surface; else they are 0.
    radial : (float, float)
        Value and deviation, as from a flat-field calibration: (0, 0) if that has removed it all. By
        default it may be up to some tenths.
    haze : (float, float), optional
        Of each group, in the unit of R; by default free with control and 0 without, where it cannot
        be told from a brighter ground.

    Returns
    -------
    BlockAdjustment

    Raises
    ------
    ValueError
        If a column is missing, no tie point lies in two images, the parameters cannot be told
        apart, or the iteration does not converge.

    Warns
    -----
    UserWarning
        If control targets contradict each other, more than a hundredth of the observations do not
        count, or the light falls off to the corners otherwise than with the square of the radius.

    Notes
    -----
    In vertical images the view's zenith angle is the radius: falling off to the corners and the
    even part of anisotropy (b1) are one effect and only their sum is determined. Fix one of them or
    give its prior.

    References
    ----------
    EuroSDR 2013, image radiometry, sections 6.1 and 6.2: Pepita, a relative adjustment.

    Examples
    --------
    >>> rows = [(0, "a", 10.0), (0, "b", 20.0), (1, "a", 11.0), (1, "b", 22.0)]
    >>> seen = pd.DataFrame(rows, columns=["image", "tie", "radiance"]).assign(
    ...     sun_zenith_deg=40.0, view_zenith_deg=10.0, azimuth_deg=0.0, radius=0.0)
    >>> gain = adjust_block(seen, anisotropy=False).gains["gain"]
    >>> round(float(gain[1] / gain[0]), 6)
    1.1
    """
    haze = haze or (0.0, 0.0 if control is None else np.inf)
    block = _Block(observations)
    priors = ((0.0, np.inf), (0.0, np.inf if anisotropy else 0.0), radial, haze)
    value, std = block.priors(priors, control)
    free, images = std > 0, len(block.images)
    with np.errstate(divide="ignore"):
        prior_weight = std[free] ** -2.0
    estimate = block.start(value, std)
    ties, parameters = len(block.ties), int(free.sum()) - len(block.ties)
    # without control only ratios of gains are determined: their sum stays
    gains = sparse.csc_matrix([(np.arange(free.sum()) < images) * float(control is None)])
    share, freedom = RELATIVE_STD, max(len(block.signal) - free.sum(), 1)
    for iteration in range(ROUNDS):
        misfit, jacobian = block.linearised(estimate)
        # a share of what is expected: of what is seen, shadows would weigh more
        expected = np.maximum(block.signal - misfit, block.signal / 10)
        scaled, jacobian = misfit / expected, jacobian[:, free]
        if iteration < REWEIGHTINGS:
            size = np.abs(scaled) / _misfit_scale(scaled)
            if iteration:
                clipped = np.minimum(size, 5) * _misfit_scale(scaled)
                share = max(np.sqrt(clipped @ clipped / freedom), SMALLEST_STD)
            weight = (1 + (size / SHADOW) ** 2) ** -2 / (share * expected) ** 2
        normal = jacobian.T @ sparse.diags(weight) @ jacobian + sparse.diags(prior_weight)
        normal = normal + gains.T @ gains * (normal.diagonal()[:parameters].sum() / images**2)
        right = jacobian.T @ (weight * misfit) + prior_weight * (value - estimate)[free]
        change = _factor(normal).solve(right)
        estimate[free] += change
        change[parameters:] /= np.abs(estimate[-ties:]).mean()
        if np.abs(change).max() <= 1e-7:
            inverse = _covariance(normal, parameters)
            _warn(block, estimate, value, std, scaled)
            return _result(block, estimate, inverse, free, control is not None)
    must = "have tie points that determine the parameters"
    raise ValueError(f"Invalid block: still changing after {ROUNDS} iterations. Must {must}.")


def _tie_spread(values, tie):
    """The coefficient of variation of each tie point's values, percent; NaN for one value."""
    groups = pd.Series(values).groupby(tie)
    return 100 * groups.std() / groups.mean()


class _Block:
    """Arrays of the observations, and indices of their images, ties and surfaces."""

    def __init__(self, observations):
        check_columns(observations, OBSERVATION_COLUMNS, "observations")
        named = [name for name in ("surface", "group") if name in observations]
        missing = observations[[*OBSERVATION_COLUMNS, *named]].isna()
        for row, name in np.argwhere(missing.to_numpy())[:1]:
            found = f"no {missing.columns[name]} in row {row + 1}"
            refuse(True, "observations", found, "given")
        self.observations = observations
        self.signal = observations["radiance"].to_numpy(dtype=np.float64)
        known = np.isfinite(self.signal) & (self.signal > 0)
        refuse(not known.all(), "radiance", np.nanmin(self.signal), "> 0 and finite")
        if not (observations.groupby("tie")["image"].nunique() > 1).any():
            raise ValueError("Invalid observations: no tie point in two images. Must overlap.")
        self.image, self.images = pd.factorize(observations["image"], sort=True)
        self.tie, self.ties = pd.factorize(observations["tie"], sort=True)
        self.surface, self.surfaces = pd.factorize(_surfaces_of(observations), sort=True)
        named = observations.get("group", pd.Series(0, observations.index))
        self.group, self.groups = pd.factorize(named, sort=True)
        self.group_of_image = np.zeros(len(self.images), dtype=int)
        self.group_of_image[self.image] = self.group
        if (self.group_of_image[self.image] != self.group).any():
            raise ValueError("Invalid group: two in one image. Must be the same in its rows.")
        self.terms, self.sun = _view_terms(observations), _sun_cosine(observations)
        self.radius2 = observations["radius"].to_numpy(dtype=np.float64) ** 2

    @property
    def sizes(self):
        """Numbers of gains, anisotropies, radial terms and hazes."""
        return len(self.images), 2 * len(self.surfaces), 1, len(self.groups)

    def priors(self, priors, control):
        """Values and standard deviations of all parameters, the ties' reflectances last."""
        for _, std in priors:
            if np.isfinite(std):
                check_number(std, "prior's standard deviation", low=0)
        counts = *self.sizes, len(self.ties)
        value, std = np.repeat([*priors, (0.0, np.inf)], counts, axis=0).T.copy()
        if control is not None:
            place = pd.Index(self.ties).get_indexer(control["tie"])
            wrong = (place < 0).any() or not (control["std"] > 0).all()
            must = "tie points of the block, each with a std above zero"
            refuse(wrong, "control", f"{len(control)} targets", must)
            # a target that stands there twice counts by its weighted mean
            weight, count = control["std"].to_numpy(dtype=np.float64) ** -2, len(self.ties)
            known = np.bincount(place, weight, count)
            mean = np.bincount(place, weight * control["reflectance"], count)
            place = np.unique(place)
            value[place - count] = mean[place] / known[place]
            std[place - count] = known[place] ** -0.5
        return value, std

    def start(self, value, std):
        """Parameters to begin with: as if all gains were 1, or as control says."""
        estimate, ties = value.copy(), len(self.ties)
        ground = np.bincount(self.tie, self.signal / self.sun) / np.bincount(self.tie)
        known = np.isfinite(std[-ties:])
        scale = np.median(ground[known] / value[-ties:][known]) if known.any() else 1.0
        estimate[-ties:] = ground / scale
        estimate[: len(self.images)] += np.log(scale)
        return estimate

    def split(self, estimate):
        """Log gains, anisotropy (surfaces, 2), radial, hazes, reflectances."""
        log_gain, b, radial, haze, ground = np.split(estimate, np.cumsum(self.sizes))
        return log_gain, b.reshape(-1, 2), radial[0], haze, ground

    def linearised(self, estimate):
        """Misfit and the sparse Jacobian of the model."""
        log_gain, b, radial, haze, ground = self.split(estimate)
        gain, fall = np.exp(log_gain)[self.image], 1 - radial * self.radius2
        lit = self.sun * ground[self.tie]
        anisotropy = 1 + (self.terms * b[self.surface]).sum(axis=1)
        light, scale = lit * anisotropy + haze[self.group], gain * fall
        first = len(self.images)
        last = first + b.size
        derivatives = [
            (self.image, scale * light),
            (first + 2 * self.surface, scale * lit * self.terms[:, 0]),
            (first + 2 * self.surface + 1, scale * lit * self.terms[:, 1]),
            (np.full_like(self.image, last), -gain * light * self.radius2),
            (last + 1 + self.group, scale),
            (last + 1 + len(self.groups) + self.tie, scale * self.sun * anisotropy),
        ]
        columns, values = (np.stack(part) for part in zip(*derivatives, strict=True))
        rows = np.broadcast_to(np.arange(len(self.signal)), columns.shape)
        size = len(self.signal), len(estimate)
        places = rows.ravel(), columns.ravel()
        return self.signal - scale * light, sparse.csc_matrix((values.ravel(), places), size)


def _factor(normal):
    """The factors of a normal matrix."""
    choices = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    try:
        return splu(normal.tocsc(), **choices)
    except RuntimeError:
        raise ValueError(UNDETERMINED) from None


def _covariance(normal, count):
    """The covariance of the first ``count`` unknowns, if they can be told apart."""
    inverse = _factor(normal).solve(np.eye(normal.shape[0], count))[:count]
    sigma = np.sqrt(np.abs(np.diag(inverse)))
    values = np.linalg.eigvalsh(inverse / np.outer(sigma, sigma))
    if not values[0] > 1e-10 * values[-1]:
        raise ValueError(UNDETERMINED)
    return inverse


def _result(block, estimate, inverse, free, absolute):
    """The adjustment as tables."""
    log_gain, b, radial, haze, ground = block.split(estimate)
    std = np.zeros(len(estimate))
    std[np.flatnonzero(free)[: len(inverse)]] = np.sqrt(np.diag(inverse))
    gain_std, b_std, radial_std, haze_std, _ = block.split(std)
    group = block.group_of_image
    of_image = {"gain": np.exp(log_gain), "gain_std_percent": 100 * gain_std}
    of_image |= {"n": np.bincount(block.image), "haze": haze[group], "haze_std": haze_std[group]}
    gains = pd.DataFrame({"image": block.images} | of_image)
    anisotropy = pd.DataFrame(np.hstack([b, b_std]), columns=["b1", "b2", "b1_std", "b2_std"])
    anisotropy.insert(0, "surface", block.surfaces)
    ties = pd.DataFrame({"tie": block.ties, "reflectance": ground, "n": np.bincount(block.tie)})
    fall = float(radial), float(radial_std)
    adjusted = BlockAdjustment(gains, anisotropy, fall, ties, absolute)
    ties["cv_before_percent"] = _tie_spread(block.signal / block.sun, block.tie)
    ties["cv_after_percent"] = _tie_spread(adjusted.correct(block.observations), block.tie)
    return adjusted


def _warn(block, estimate, value, std, share):
    """Warn of known reflectances that contradict the others, and of many odd observations.

    ``share``: misfits as shares of the radiances.
    """
    value, std, estimate = (part[-len(block.ties) :] for part in (value, std, estimate))
    spread = _misfit_scale(share)
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


def _misfit_scale(scaled):
    """Robust standard deviation of the scaled misfit."""
    return max(median_abs_deviation(scaled, scale="normal"), 1e-6)


def _view_terms(observations):
    """Walthall's even and odd term of each observation, shape (n, 2)."""
    return walthall_terms(observations["view_zenith_deg"], observations["azimuth_deg"])[:, :2]


def _sun_cosine(observations):
    """Cosine of the sun's zenith angle."""
    cosine = np.cos(np.radians(observations["sun_zenith_deg"].to_numpy(dtype=np.float64)))
    if not (cosine > 0).all():
        raise ValueError("Invalid sun_zenith_deg. Must be below 90 degrees.")
    return cosine


def _surfaces_of(observations):
    """Surface of each observation; a single surface if none is named."""
    return observations.get("surface", pd.Series(0, observations.index)).to_numpy()
