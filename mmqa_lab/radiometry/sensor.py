"""Linear sensors: gain and offset from targets of known radiance.

A linear sensor records DN = offset + gain * radiance * exposure, where exposure is the exposure
time over the squared f-number, relative to that of a reference setting: L = K DN f^2 / t. That
follows from equation 2, in which DN grows with the lens's solid angle and the exposure time.
Equation 3 as printed there, L = K' (t / f) DN, has the ratio upside down and f not squared; this
room deviates from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from mmqa_lab._checks import (
    check_count,
    check_image,
    check_positive,
    check_together,
    check_values,
    needs,
    real_array,
    refuse,
)
from mmqa_lab._results import Shown, sentences
from mmqa_lab.radiometry.doubts import odd_target, unlikely_term

__all__ = [
    "SensorFit", "coarse_pairs", "fit_sensor", "patch_statistics", "relative_exposure",
    "saturation_level", "stability",
]  # fmt: skip

FEWEST_PILED, LARGEST_DN = 9, tuple(2**bits - 1 for bits in (8, 10, 12, 14, 16))
"""Pixels of one value that may be chance; the largest digital numbers of sensors and files."""


BENT_LINE, LOOSE_LINE = 0.02, 0.03
"""Shares of the range of DN by which a line is bent, or left by its targets, when it is said."""

HOT_DEVIATIONS, MOST_HOT = 6.0, 0.05
"""Deviations from which a pixel of a target is left out, and the largest share of such pixels."""


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
    remarks : tuple of str
        Reasons to doubt the line.

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
    remarks: tuple[str, ...] = ()

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

    def radiance(self, dn: ArrayLike, *, exposure: float = 1.0) -> np.ndarray:
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
        ``saturated_share``, ``hot``: pixels farther than six deviations, which are left out.

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
    image = real_array(image, "image").astype(np.float64)
    finite = image.ndim == 2 and image.size and np.isfinite(image).all()
    refuse(not finite, "image", f"shape {image.shape}", "one band of finite numbers")
    full_scale = saturation_level(image) if full_scale is None else full_scale
    rows = []
    for r0, r1, c0, c1 in np.round(np.asarray(patches, dtype=float)).astype(int):
        inside = 0 <= r0 < r1 <= image.shape[0] and 0 <= c0 < c1 <= image.shape[1]
        wrong = not inside or (r1 - r0) * (c1 - c0) < 2
        found = f"rows {r0} to {r1}, columns {c0} to {c1}"
        refuse(wrong, "patch", found, f"two or more pixels in an image of {image.shape}")
        dn = image[r0:r1, c0:c1].ravel()
        hot, share = _hot(dn), (dn >= full_scale).mean()
        dn = dn[~hot]
        std = dn.std(ddof=1)
        rows.append((dn.size, dn.mean(), std, std / np.sqrt(dn.size), share, hot.sum()))
    columns = ["n", "mean_dn", "std_dn", "std_error_dn", "saturated_share", "hot"]
    return pd.DataFrame(rows, columns=columns)


def _hot(dn):
    """Pixels far from all others of a target, if they are few."""
    off = np.abs(dn - np.median(dn))
    usual = np.median(off) / 0.6745
    hot = (off > HOT_DEVIATIONS * usual) & (usual > 0)
    return hot & (hot.mean() <= MOST_HOT)


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
    models = needs("lab", "statsmodels.regression.linear_model")

    given = {"dn": dn, "radiance": radiance, "exposure": exposure}
    dn, radiance, exposure = check_together(**given, to_first=True)
    refuse(dn.ndim != 1, "targets", f"dn of shape {dn.shape}", "a row")
    signal = np.broadcast_to(radiance * exposure, dn.shape)
    std = np.broadcast_to(1.0 if std_dn is None else np.asarray(std_dn, np.float64), dn.shape)
    if not (np.isfinite(signal).all() and np.isfinite(dn).all() and (std > 0).all()):
        raise ValueError("Invalid targets. Must be finite, their standard deviations > 0 DN.")
    used = dn + 3 * (0 if std_dn is None else std) < full_scale
    few = used.sum() < 3 or np.ptp(signal[used]) == 0 or np.ptp(dn[used]) == 0
    found = f"{used.sum()} unsaturated of {len(dn)}"
    refuse(few, "targets", found, "three or more, of different radiance and DN")
    terms = 1 if through_zero else 2
    design = np.stack([signal, np.ones_like(signal)], axis=1)[:, :terms]
    fit = models.WLS(dn[used], design[used], weights=std[used] ** -2).fit()
    gain, offset = np.append(fit.params, 0.0)[:2].tolist()
    residuals = np.where(used, dn - design @ fit.params, np.nan)
    remarks = _remarks_on(design[used], dn[used], std[used], np.flatnonzero(used))
    std, saturated = np.append(fit.bse, 0.0)[:2], int((~used).sum())
    return SensorFit(gain, offset, std, float(fit.rsquared), residuals, saturated, remarks)


def _remarks_on(design, dn, std, numbers):
    """What residuals say: one target is odd, the sensor bends, or all leave the line."""
    odd, reach = odd_target(design, dn, std, stated=False), np.ptp(dn)
    signal, scaled = design[:, 0], design / std[:, None]
    bent = abs(unlikely_term(design, signal**2, dn, std)) * np.ptp(signal) ** 2 / 4 / reach
    left = dn - design @ np.linalg.lstsq(scaled, dn / std, rcond=None)[0]
    loose = np.sqrt(left @ left / max(len(dn) - design.shape[1], 1)) / reach
    said = sentences(
        (odd is not None, lambda: f"target {numbers[odd] + 1} leaves the line of the others"),
        (bent > BENT_LINE, f"the line is bent by {bent:.0%} of its range"),
        (loose > LOOSE_LINE, f"targets leave the line by {loose:.0%} of its range"),
    )
    return tuple(said)


def coarse_pairs(image: ArrayLike, reference: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return DN and radiance of two images of the same ground, one band each, as flat arrays.

    Pixels are averaged to those of the reference, then both pass a median of 3 x 3 (EuroSDR 2013,
    image radiometry, section 4.2: DMC against CASI).
    """
    image, reference = (check_image(part).astype(np.float32) for part in (image, reference))
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
    known, rows = check_values(radiance, "radiance", positive=True), []
    for (name, fit), (other, second) in permutations(fits.items(), 2):
        found = second.radiance(fit.offset + fit.gain * known)
        rows.append((name, other, 100 * np.abs(found / known - 1).mean()))
    return pd.DataFrame(rows, columns=["setting", "other", "difference_percent"])


def saturation_level(dn: np.ndarray) -> float:
    """Return the digital number on which saturated pixels pile up, infinity where none does.

    The largest number of 8, 10, 12, 14 or 16 bits is that of saturation, if only a pixel has it.
    """
    top = dn.max()
    counts = np.array([np.count_nonzero(dn == top - k) for k in range(11)])
    piled = counts[0] > max(1e-4 * dn.size, 5 * counts[1:].max(), FEWEST_PILED)
    return float(top) if piled or top in LARGEST_DN else np.inf
