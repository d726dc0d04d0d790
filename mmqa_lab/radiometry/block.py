"""Radiometric block adjustment: one least-squares solution over all overlapping images.

After Pepita in EuroSDR 2013, image radiometry, sections 6.1 and 6.2, which does for radiometry what
aerial triangulation does for geometry. Pepita is relative and estimates haze for blocks of images;
here haze is the same in all images, and control targets are an addition. A tie point is a patch of
ground that several images show; all that makes its values differ (exposure,
height of the sun, haze, anisotropic reflectance, falling off to the corners) is estimated from all
of them together. The radiance of tie point k in image i is taken to be

    L = gain_i * (cos(sun_i) * R_k * (1 + b1 v^2 + b2 v cos(a)) + haze) * (1 - radial * r^2)

with Walthall's terms (v, a: zenith angle and azimuth of the view; radians) and r, the distance from
the image's centre over that of its corner. With control targets R is reflectance, without any it is
relative.

Angles in degrees: zenith angles of sun and view from the vertical; the relative azimuth is 0 where
the camera looks at the ground with the sun behind it (backward scattering) and 180 where it looks
against the sun.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.stats import median_abs_deviation

from mmqa_lab._checks import check_count, check_number, check_positive
from mmqa_lab._results import Shown

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

UNDETERMINED = (
    "Invalid block: its parameters cannot be told apart. Must have more overlap, control targets, "
    "or priors (see Notes)."
)

COLUMNS = ("image", "tie", "radiance", "sun_zenith_deg", "view_zenith_deg", "azimuth_deg", "radius")

FREE, FIXED = np.inf, 0.0
"""Deviations of a prior: the parameter is left to the images, or keeps its value."""

HUBER = 1.5
"""Residuals beyond so many deviations weigh less (Huber & Ronchetti 2009)."""

REWEIGHTINGS = 6
"""Weights are computed anew in so many iterations and then stay; more would change little."""

CONVERGED = 1e-7
"""Largest change of a gain, coefficient or relative reflectance in the last iteration."""


@dataclass(frozen=True, eq=False)
class WalthallFit:
    """A fitted Walthall function: ``coefficients`` of v^2, v cos(a), 1, ``rms`` and ``n``."""

    coefficients: np.ndarray
    rms: float
    n: int

    def reflectance(self, view_zenith, azimuth):
        """Reflectance factor in a direction."""
        return walthall_terms(view_zenith, azimuth) @ self.coefficients

    def anisotropy(self, view_zenith, azimuth):
        """Anisotropy factor: the reflectance factor over that at nadir."""
        return self.reflectance(view_zenith, azimuth) / self.reflectance(0.0, 0.0)


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
    from statsmodels.regression.linear_model import OLS

    seen = np.asarray(reflectance, dtype=np.float64)
    terms = np.broadcast_to(walthall_terms(view_zenith, azimuth), (*seen.shape, 3))
    if len(seen) < 4 or np.linalg.matrix_rank(terms, tol=1e-6 * len(seen)) < 3:
        raise ValueError(
            f"Invalid directions: {len(seen)} observations cannot tell three terms apart. Must be "
            "more, from different directions."
        )
    fit = OLS(seen, terms).fit()
    return WalthallFit(fit.params, float(np.sqrt(fit.scale)), len(seen))


def walthall_terms(view_zenith, azimuth):
    """Return v^2, v cos(a) and 1 with v and a in radians, shape (..., 3)."""
    v, a = np.radians(np.asarray(np.broadcast_arrays(view_zenith, azimuth), dtype=np.float64))
    return np.stack([v**2, v * np.cos(a), np.ones_like(v)], axis=-1)


@dataclass(frozen=True, eq=False)
class BlockAdjustment(Shown):
    """An adjusted block.

    Parameters
    ----------
    gains : DataFrame
        ``image``, ``gain``, ``gain_std_percent``, ``n`` (its tie points).
    anisotropy : DataFrame
        ``surface``, ``b1``, ``b2`` and their standard deviations.
    radial, haze : (float, float)
        Value and standard deviation (0 where fixed).
    ties : DataFrame
        ``tie``, ``reflectance`` (relative without control), ``n``, ``cv_before_percent`` and
        ``cv_after_percent``: coefficient of variation of its values over the images, before
        (radiance over the cosine of the sun's zenith angle) and after.
    sigma0 : float
        Standard deviation of unit weight.
    absolute : bool
        Whether control targets gave the scale.

    Examples
    --------
    >>> rows = [(0, "a", 10.0), (0, "b", 20.0), (1, "a", 11.0), (1, "b", 22.0)]
    >>> seen = pd.DataFrame(rows, columns=["image", "tie", "radiance"]).assign(
    ...     sun_zenith_deg=40.0, view_zenith_deg=10.0, azimuth_deg=0.0, radius=0.0)
    >>> block = adjust_block(seen, anisotropy_std=FIXED)
    >>> corrected = block.correct(seen)
    >>> bool(np.allclose(corrected[:2], corrected[2:]))
    True
    """

    gains: pd.DataFrame
    anisotropy: pd.DataFrame
    radial: tuple
    haze: tuple
    ties: pd.DataFrame
    sigma0: float
    absolute: bool

    def to_frame(self) -> pd.DataFrame:
        """Return the gains, one row an image."""
        return self.gains.copy()

    def correct(self, observations, *, to_nadir: bool = True):
        """Return the reflectance (relative without control) of each observation.

        Parameters
        ----------
        observations : DataFrame
            Columns as for ``adjust_block``; any pixel of any image of the block will do.
        to_nadir : bool
            Whether to divide by the anisotropy factor that was found; without, the result is the
            reflectance factor in the direction of the view.
        """
        gain = self.gains.set_index("image")["gain"].reindex(observations["image"]).to_numpy()
        coefficients = self.anisotropy.set_index("surface")[["b1", "b2"]]
        b = coefficients.reindex(_surfaces_of(observations)).to_numpy()
        radius = observations["radius"].to_numpy()
        light = observations["radiance"].to_numpy() / (gain * (1 - self.radial[0] * radius**2))
        seen = (light - self.haze[0]) / _sun_cosine(observations)
        anisotropy = 1 + (_view_terms(observations) * b).sum(axis=1)
        return seen / anisotropy if to_nadir else seen


def adjust_block(
    observations: pd.DataFrame,
    *,
    control: pd.DataFrame | None = None,
    gain_std: float = FREE,
    anisotropy_std: float = FREE,
    radial: tuple[float, float] = (0.0, FIXED),
    haze: tuple[float, float] | None = None,
    relative_std: float = 0.02,
    rounds: int = 50,
) -> BlockAdjustment:
    """Adjust the radiometry of a block of overlapping images.

    Gauss-Newton on all parameters and reflectances together, whose normal matrix is sparse.
    Observations that fit badly are weighed down (Huber). A prior is a value and a standard
    deviation: 0 (``FIXED``) keeps the value, infinity (``FREE``) leaves it to the images.

    Parameters
    ----------
    observations : DataFrame
        One row for each tie point in each image: ``image``, ``tie``, ``radiance`` (DN less offset,
        over gain and exposure), ``sun_zenith_deg``, ``view_zenith_deg``,
        ``azimuth_deg`` (0 with the sun behind the camera), ``radius`` (0 in the centre, 1 in the
        corner). Optionally ``surface``: each gets an anisotropy of its own.
    control : DataFrame, optional
        ``tie``, ``reflectance``, ``std``: targets of known nadir reflectance. Two or more of
        different brightness are needed to estimate haze.
    gain_std : float
        Of the natural logarithm of each image's gain about 0.
    anisotropy_std : float
        Of b1 and b2 about 0.
    radial : (float, float)
        Value and deviation, as from a flat-field calibration.
    haze : (float, float), optional
        In the unit of R; by default free with control and 0 without, where it cannot be told from
        a brighter ground.
    relative_std : float
        Standard deviation of an observation, as a share of its radiance.
    rounds : int
        Most iterations.

    Returns
    -------
    BlockAdjustment

    Raises
    ------
    ValueError
        If a column is missing, no tie point lies in two images, the parameters cannot be told
        apart, or the iteration does not converge.

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
    >>> gain = adjust_block(seen, anisotropy_std=FIXED).gains["gain"]
    >>> round(float(gain[1] / gain[0]), 6)
    1.1
    """
    check_count(rounds, "rounds")
    haze = haze or (0.0, FIXED if control is None else FREE)
    block = _Block(observations, relative_std)
    priors = ((0.0, gain_std), (0.0, anisotropy_std), radial, haze)
    value, std = block.priors(priors, control)
    free, images = std > 0, len(block.images)
    with np.errstate(divide="ignore"):
        prior_weight = np.where(free, std, np.inf)[free] ** -2.0
    estimate = block.start(value, std)
    # without control only ratios of gains are determined: their sum stays
    together = sparse.csc_matrix(np.ones((images, images)) * (control is None))
    ties, parameters = len(block.ties), int(free.sum()) - len(block.ties)
    for iteration in range(rounds):
        misfit, jacobian = block.linearised(estimate)
        scaled, jacobian = misfit / block.std, jacobian[:, free]
        if iteration < REWEIGHTINGS:
            limit = HUBER * _misfit_scale(scaled)
            weight = np.minimum(1, limit / np.maximum(np.abs(scaled), 1e-12)) / block.std**2
        normal = jacobian.T @ sparse.diags(weight) @ jacobian + sparse.diags(prior_weight)
        if control is None and gain_std > 0:
            gauge = together * (normal.diagonal()[:parameters].sum() / images**2)
            size = parameters + ties - images
            normal = normal + sparse.block_diag([gauge, sparse.csc_matrix((size, size))])
        right = jacobian.T @ (weight * misfit) + prior_weight * (value - estimate)[free]
        change = _factor(normal).solve(right)
        estimate[free] += change
        change[parameters:] /= np.abs(estimate[-ties:]).mean()
        if np.abs(change).max() <= CONVERGED:
            inverse = _covariance(normal, parameters)
            adjusted = _result(block, observations, estimate, inverse, free, scaled)
            return replace(adjusted, absolute=control is not None)
    raise ValueError(
        f"Invalid block: still changing after {rounds} iterations. Must have tie points that "
        "determine the parameters."
    )


def _tie_spread(values, tie):
    """The coefficient of variation of each tie point's values, percent; NaN for one value."""
    groups = pd.Series(np.asarray(values, dtype=np.float64)).groupby(np.asarray(tie))
    return 100 * groups.std() / groups.mean()


class _Block:
    """Arrays of the observations, and indices of their images, ties and surfaces."""

    def __init__(self, observations, relative_std):
        missing = [name for name in COLUMNS if name not in observations]
        if missing:
            raise ValueError(f"Invalid observations: no column {missing[0]!r}. Must have it.")
        check_positive(relative_std, "relative_std")
        self.signal = observations["radiance"].to_numpy(dtype=np.float64)
        if not (np.isfinite(self.signal).all() and (self.signal > 0).all()):
            raise ValueError(f"Invalid radiance {np.nanmin(self.signal)}. Must be > 0 and finite.")
        if not (observations.groupby("tie")["image"].nunique() > 1).any():
            raise ValueError("Invalid observations: no tie point in two images. Must overlap.")
        self.image, self.images = pd.factorize(observations["image"], sort=True)
        self.tie, self.ties = pd.factorize(observations["tie"], sort=True)
        self.surface, self.surfaces = pd.factorize(_surfaces_of(observations), sort=True)
        self.std = relative_std * self.signal
        self.terms, self.sun = _view_terms(observations), _sun_cosine(observations)
        self.radius2 = observations["radius"].to_numpy(dtype=np.float64) ** 2

    def priors(self, priors, control):
        """Values and standard deviations of all parameters, the ties' reflectances last."""
        for _, std in priors:
            if std != FREE:
                check_number(std, "prior's standard deviation", low=0)
        counts = len(self.images), 2 * len(self.surfaces), 1, 1, len(self.ties)
        value, std = np.repeat([*priors, (0.0, FREE)], counts, axis=0).T.copy()
        if control is not None:
            place = pd.Index(self.ties).get_indexer(control["tie"])
            if (place < 0).any() or not (control["std"] > 0).all():
                raise ValueError(
                    "Invalid control. Must be tie points of the block, each with a std above zero."
                )
            place = place - len(self.ties)
            value[place], std[place] = control["reflectance"], control["std"]
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
        """Log gains, anisotropy (surfaces, 2), radial, haze, reflectances."""
        ends = np.cumsum([len(self.images), 2 * len(self.surfaces), 1, 1])
        log_gain, b, radial, haze, ground = np.split(estimate, ends)
        return log_gain, b.reshape(-1, 2), radial[0], haze[0], ground

    def linearised(self, estimate):
        """Misfit and the sparse Jacobian of the model."""
        log_gain, b, radial, haze, ground = self.split(estimate)
        gain, fall = np.exp(log_gain)[self.image], 1 - radial * self.radius2
        lit = self.sun * ground[self.tie]
        anisotropy = 1 + (self.terms * b[self.surface]).sum(axis=1)
        light, scale = lit * anisotropy + haze, gain * fall
        first = len(self.images)
        last = first + b.size
        derivatives = [
            (self.image, scale * light),
            (first + 2 * self.surface, scale * lit * self.terms[:, 0]),
            (first + 2 * self.surface + 1, scale * lit * self.terms[:, 1]),
            (np.full_like(self.image, last), -gain * light * self.radius2),
            (np.full_like(self.image, last + 1), scale),
            (last + 2 + self.tie, scale * self.sun * anisotropy),
        ]
        columns, values = (np.stack(part) for part in zip(*derivatives, strict=True))
        rows = np.broadcast_to(np.arange(len(self.signal)), columns.shape)
        size = len(self.signal), len(estimate)
        places = rows.ravel(), columns.ravel()
        return self.signal - scale * light, sparse.csc_matrix((values.ravel(), places), size)


def _factor(normal):
    """The factors of a normal matrix."""
    from scipy.sparse.linalg import splu

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


def _result(block, observations, estimate, inverse, free, scaled):
    """The adjustment as tables."""
    log_gain, b, radial, haze, ground = block.split(estimate)
    freedom = max(len(scaled) - free.sum(), 1)
    clipped = np.minimum(scaled**2, (5 * _misfit_scale(scaled)) ** 2)
    sigma0 = float(np.sqrt(clipped.sum() / freedom))
    std = np.zeros(len(estimate))
    std[np.flatnonzero(free)[: len(inverse)]] = sigma0 * np.sqrt(np.diag(inverse))
    gain_std, b_std, radial_std, haze_std, _ = block.split(std)
    gains = pd.DataFrame({"image": block.images, "gain": np.exp(log_gain)})
    gains = gains.assign(gain_std_percent=100 * gain_std, n=np.bincount(block.image))
    anisotropy = pd.DataFrame(np.hstack([b, b_std]), columns=["b1", "b2", "b1_std", "b2_std"])
    anisotropy.insert(0, "surface", block.surfaces)
    ties = pd.DataFrame({"tie": block.ties, "reflectance": ground, "n": np.bincount(block.tie)})
    adjusted = BlockAdjustment(
        gains=gains,
        anisotropy=anisotropy,
        radial=(float(radial), float(radial_std)),
        haze=(float(haze), float(haze_std)),
        ties=ties,
        sigma0=sigma0,
        absolute=False,
    )
    ties["cv_before_percent"] = _tie_spread(block.signal / block.sun, block.tie).to_numpy()
    after = _tie_spread(adjusted.correct(observations), block.tie)
    ties["cv_after_percent"] = after.to_numpy()
    return adjusted


def _misfit_scale(scaled):
    """Robust standard deviation of the scaled misfit."""
    return max(median_abs_deviation(scaled, scale="normal"), 1e-12)


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
    """Surface of each observation; one for all where none is named."""
    if "surface" in observations:
        return observations["surface"].to_numpy()
    return np.zeros(len(observations), dtype=int)
