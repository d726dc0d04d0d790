"""How reflectance depends on directions: Walthall's function and the anisotropy factor.

EuroSDR 2013, image radiometry, equation 5. Angles in degrees: zenith angles of sun and view from
the vertical; the relative azimuth is 0 where the camera looks at the ground with the sun behind it
(backward scattering, the hot-spot side) and 180 where it looks against the sun.
"""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_choice

FORMS = ("walthall", "nilson-kuusk")


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
        Degrees; see the top of this room.
    form : {"walthall", "nilson-kuusk"}
        Walthall et al. 1985: v^2, v cos(a), 1, for one position of the sun. Nilson and Kuusk 1989:
        s^2 v^2, s^2 + v^2, s v cos(a), 1, the same whichever of sun and camera is where.
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
    EuroSDR 2013, image radiometry, equation 5; Walthall et al. 1985, doi:10.1364/AO.24.000383;
    Nilson & Kuusk 1989, doi:10.1016/0034-4257(89)90015-1.

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
