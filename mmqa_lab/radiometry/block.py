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
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.stats import median_abs_deviation

from mmqa_lab._checks import check_count, check_number, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.radiometry.reflectance import walthall_terms

COLUMNS = ("image", "tie", "radiance", "sun_zenith_deg", "view_zenith_deg", "azimuth_deg", "radius")

FREE, FIXED = np.inf, 0.0

HUBER = 1.5
"""Residuals beyond so many deviations weigh less (Huber & Ronchetti 2009)."""

REWEIGHTINGS = 6
"""Weights are computed anew in so many iterations and then stay; more would change little."""

CONVERGED = 1e-7
"""Largest change of a gain, coefficient or relative reflectance in the last iteration."""


@dataclass(frozen=True, eq=False)
class Priors:
    """What is known beforehand of the parameters: a value and a standard deviation each.

    A deviation of 0 (``FIXED``) keeps the parameter at its value, infinity (``FREE``) leaves it to
    the images.

    Parameters
    ----------
    gain_std : float
        Of the natural logarithm of each image's gain about 0.
    anisotropy_std : float
        Of b1 and b2 about 0.
    radial : (float, float)
        Value and deviation, as from a flat-field calibration.
    haze : (float, float)
        In the unit of R. Without control targets haze cannot be told from a brighter ground; it is
        then to be fixed.

    Examples
    --------
    >>> known = Priors(radial=(0.1, 0.02))
    >>> known.gain_std == FREE, known.haze[1] == FIXED
    (True, True)
    """

    gain_std: float = FREE
    anisotropy_std: float = FREE
    radial: tuple = (0.0, FIXED)
    haze: tuple = (0.0, FIXED)


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
    residuals : array, shape (n,)
        Observed minus adjusted, over its standard deviation.
    sigma0 : float
        Standard deviation of unit weight.
    absolute : bool
        Whether control targets gave the scale.
    iterations : int

    Examples
    --------
    >>> rows = [(0, "a", 10.0), (0, "b", 20.0), (1, "a", 11.0), (1, "b", 22.0)]
    >>> seen = pd.DataFrame(rows, columns=["image", "tie", "radiance"]).assign(
    ...     sun_zenith_deg=40.0, view_zenith_deg=10.0, azimuth_deg=0.0, radius=0.0)
    >>> block = adjust_block(seen, priors=Priors(anisotropy_std=FIXED))
    >>> corrected = block.correct(seen)
    >>> bool(np.allclose(corrected[:2], corrected[2:]))
    True
    """

    gains: pd.DataFrame
    anisotropy: pd.DataFrame
    radial: tuple
    haze: tuple
    ties: pd.DataFrame
    residuals: np.ndarray
    sigma0: float
    absolute: bool
    iterations: int

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


def adjust_block(observations, *, control=None, priors=None, relative_std=0.02, rounds=50):
    """Adjust the radiometry of a block of overlapping images.

    Gauss-Newton with the reflectances of the tie points eliminated (each observation has one), so
    that the system to solve has the size of the images. Observations that fit badly are weighed
    down (Huber).

    Parameters
    ----------
    observations : DataFrame
        One row for each tie point in each image: ``image``, ``tie``, ``radiance`` (DN less offset,
        over gain and exposure: ``sensor``), ``sun_zenith_deg``, ``view_zenith_deg``,
        ``azimuth_deg`` (0 with the sun behind the camera), ``radius`` (0 in the centre, 1 in the
        corner). Optionally ``surface``: each gets an anisotropy of its own.
    control : DataFrame, optional
        ``tie``, ``reflectance``, ``std``: targets of known nadir reflectance. Two or more of
        different brightness are needed to estimate haze.
    priors : Priors, optional
        By default gains and anisotropy are free, no radial term, and haze is free with control.
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
    >>> gain = adjust_block(seen, priors=Priors(anisotropy_std=FIXED)).gains["gain"]
    >>> round(float(gain[1] / gain[0]), 6)
    1.1
    """
    check_count(rounds, "rounds")
    problem, names = _block_problem(observations, control, priors, relative_std)
    step, iteration = np.inf, 0
    while step > CONVERGED:
        if iteration == rounds:
            raise ValueError(
                f"Invalid block: still changing after {rounds} iterations. Must have tie points "
                "that determine the parameters."
            )
        misfit, jacobian, by_ground = problem.linearised()
        scaled = misfit / problem.std
        if iteration < REWEIGHTINGS:
            weight = np.minimum(
                1, HUBER * _misfit_scale(scaled) / np.maximum(np.abs(scaled), 1e-12)
            )
            weight = weight / problem.std**2
        step, inverse = _iterate(problem, (misfit, jacobian, by_ground), weight)
        iteration += 1
    return _result(problem, names, observations, inverse, scaled, iteration)


def tie_spread(values, tie):
    """Return the coefficient of variation of each tie point's values, percent.

    Parameters
    ----------
    values, tie : array_like, shape (n,)

    Returns
    -------
    Series
        By tie point; NaN where it has one value.

    Examples
    --------
    >>> tie_spread([0.9, 1.1, 5.0], ["a", "a", "b"]).round(1).tolist()
    [14.1, nan]
    """
    groups = pd.Series(np.asarray(values, dtype=np.float64)).groupby(np.asarray(tie))
    return 100 * groups.std() / groups.mean()


def _result(problem, names, observations, inverse, scaled, iterations):
    """The adjustment as tables."""
    images, ties, surfaces = names
    log_gain, b, radial, haze = problem.split()
    freedom = max(len(scaled) - (~problem.fixed).sum() - len(ties), 1)
    sigma0 = float(np.sqrt(np.minimum(scaled**2, (5 * _misfit_scale(scaled)) ** 2).sum() / freedom))
    std = sigma0 * np.sqrt(np.diag(inverse))
    count = len(images)
    gains = pd.DataFrame(
        {
            "image": images,
            "gain": np.exp(log_gain),
            "gain_std_percent": 100 * std[:count],
            "n": np.bincount(problem.image, minlength=count),
        }
    )
    b_std = std[count:-2].reshape(-1, 2)
    anisotropy = pd.DataFrame(
        {"surface": surfaces, "b1": b[:, 0], "b2": b[:, 1]}
        | {"b1_std": b_std[:, 0], "b2_std": b_std[:, 1]}
    )
    table = pd.DataFrame({"tie": ties, "reflectance": problem.ground})
    table["n"] = np.bincount(problem.tie)
    adjusted = BlockAdjustment(
        gains=gains,
        anisotropy=anisotropy,
        radial=(float(radial), float(std[-2])),
        haze=(float(haze), float(std[-1])),
        ties=table,
        residuals=scaled,
        sigma0=sigma0,
        absolute=bool(problem.control_weight.any()),
        iterations=iterations,
    )
    table["cv_before_percent"] = tie_spread(problem.signal / problem.sun, problem.tie).to_numpy()
    after = tie_spread(adjusted.correct(observations), problem.tie)
    table["cv_after_percent"] = after.to_numpy()
    return adjusted


@dataclass(eq=False)
class _Problem:
    """Arrays of the adjustment: observations, indices, parameters."""

    signal: np.ndarray
    std: np.ndarray
    image: np.ndarray
    tie: np.ndarray
    surface: np.ndarray
    terms: np.ndarray
    sun: np.ndarray
    radius2: np.ndarray
    shape: tuple
    fixed: np.ndarray
    prior: np.ndarray
    prior_weight: np.ndarray
    control: np.ndarray
    control_weight: np.ndarray
    parameters: np.ndarray = field(default=None)
    ground: np.ndarray = field(default=None)

    def split(self):
        """Log gains, anisotropy (surfaces, 2), radial, haze."""
        images, surfaces, _ = self.shape
        p = self.parameters
        return p[:images], p[images : images + 2 * surfaces].reshape(-1, 2), p[-2], p[-1]

    def linearised(self):
        """Misfit, Jacobian of the parameters (sparse), derivative by the tie's reflectance."""
        images, surfaces, _ = self.shape
        log_gain, b, radial, haze = self.split()
        gain, fall = np.exp(log_gain)[self.image], 1 - radial * self.radius2
        lit = self.sun * self.ground[self.tie]
        anisotropy = 1 + (self.terms * b[self.surface]).sum(axis=1)
        light = lit * anisotropy + haze
        by_ground = gain * fall * self.sun * anisotropy
        columns = np.stack(
            [
                self.image,
                images + 2 * self.surface,
                images + 2 * self.surface + 1,
                np.full_like(self.image, images + 2 * surfaces),
                np.full_like(self.image, images + 2 * surfaces + 1),
            ]
        )
        values = np.stack(
            [
                gain * fall * light,
                gain * fall * lit * self.terms[:, 0],
                gain * fall * lit * self.terms[:, 1],
                -gain * light * self.radius2,
                gain * fall,
            ]
        )
        rows = np.broadcast_to(np.arange(len(self.signal)), columns.shape)
        size = (len(self.signal), len(self.parameters))
        jacobian = sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), size)
        return self.signal - gain * fall * light, jacobian, by_ground


def _iterate(problem, linearised, weight):
    """One step: its largest change, and the inverse of the reduced system."""
    misfit, jacobian, by_ground = linearised
    ties = problem.shape[2]
    ground_normal = np.bincount(problem.tie, weight * by_ground**2, ties) + problem.control_weight
    ground_right = np.bincount(problem.tie, weight * by_ground * misfit, ties)
    ground_right += problem.control_weight * (problem.control - problem.ground)
    select = sparse.csr_matrix(
        (weight * by_ground, (problem.tie, np.arange(len(misfit)))), (ties, len(misfit))
    )
    mixed = (select @ jacobian).tocsr()
    normal = (jacobian.T @ sparse.diags(weight) @ jacobian).toarray()
    normal += np.diag(problem.prior_weight)
    right = jacobian.T @ (weight * misfit)
    right += problem.prior_weight * (problem.prior - problem.parameters)
    if not problem.control_weight.any():
        images = problem.shape[0]
        normal[:images, :images] += np.trace(normal) / images**2
    reduced = normal - (mixed.T @ sparse.diags(1 / ground_normal) @ mixed).toarray()
    change, inverse = _solved(
        reduced, right - mixed.T @ (ground_right / ground_normal), problem.fixed
    )
    problem.parameters = problem.parameters + change
    ground_change = (ground_right - mixed @ change) / ground_normal
    problem.ground = problem.ground + ground_change
    relative = np.abs(ground_change) / np.abs(problem.ground).mean()
    return max(np.abs(change).max(), relative.max()), inverse


def _solved(reduced, right, fixed):
    """Change and covariance of the parameters that are not fixed."""
    free = np.flatnonzero(~fixed)
    part = reduced[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.maximum(np.diag(part), 1e-300))
    values = np.linalg.eigvalsh(part * np.outer(scale, scale))
    if values[0] < 1e-10 * values[-1]:
        raise ValueError(
            "Invalid block: its parameters cannot be told apart. Must have more overlap, control "
            "targets, or priors (see Notes)."
        )
    inverse = np.zeros_like(reduced)
    inverse[np.ix_(free, free)] = np.linalg.inv(part)
    return inverse @ right, inverse


def _misfit_scale(scaled):
    """Robust standard deviation of the scaled misfit."""
    return max(median_abs_deviation(scaled, scale="normal"), 1e-12)


def _block_problem(observations, control, priors, relative_std):
    """The arrays of a block, and the names of its images, ties and surfaces."""
    missing = [name for name in COLUMNS if name not in observations]
    if missing:
        raise ValueError(f"Invalid observations: no column {missing[0]!r}. Must have it.")
    check_positive(relative_std, "relative_std")
    signal = observations["radiance"].to_numpy(dtype=np.float64)
    if not (np.isfinite(signal).all() and (signal > 0).all()):
        raise ValueError(f"Invalid radiance {np.nanmin(signal)}. Must be > 0 and finite.")
    image, images = pd.factorize(observations["image"], sort=True)
    tie, ties = pd.factorize(observations["tie"], sort=True)
    surface, surfaces = pd.factorize(_surfaces_of(observations), sort=True)
    if not (observations.groupby("tie")["image"].nunique() > 1).any():
        raise ValueError("Invalid observations: no tie point in two images. Must overlap.")
    if priors is None:
        priors = Priors(haze=(0.0, FIXED if control is None else FREE))
    value, std = _prior_arrays(priors, len(images), len(surfaces))
    known, known_weight = _control(control, ties)
    sun, radius = _sun_cosine(observations), observations["radius"].to_numpy(dtype=np.float64)
    with np.errstate(divide="ignore"):
        weight = np.where(std > 0, std**-2.0, 0.0)
    problem = _Problem(
        signal=signal,
        std=relative_std * signal,
        image=image,
        tie=tie,
        surface=surface,
        terms=_view_terms(observations),
        sun=sun,
        radius2=radius**2,
        shape=(len(images), len(surfaces), len(ties)),
        fixed=std == 0,
        prior=value,
        prior_weight=weight,
        control=known,
        control_weight=known_weight,
    )
    problem.parameters = value.copy()
    problem.ground = np.bincount(tie, signal / sun) / np.bincount(tie)
    if control is not None:
        measured = known_weight > 0
        scale = np.median(problem.ground[measured] / known[measured])
        problem.ground = problem.ground / scale
        problem.parameters[: len(images)] += np.log(scale)
    return problem, (images, ties, surfaces)


def _prior_arrays(priors, images, surfaces):
    """Values and standard deviations of all parameters in their order."""
    stds = (priors.gain_std, priors.anisotropy_std, priors.radial[1], priors.haze[1])
    for std in stds:
        if std != FREE:
            check_number(std, "prior's standard deviation", low=0)
    counts = (images, 2 * surfaces, 1, 1)
    values = (0.0, 0.0, priors.radial[0], priors.haze[0])
    return np.repeat(values, counts), np.repeat(stds, counts)


def _control(control, ties):
    """Known reflectance of each tie point and its weight, 0 where it is not known."""
    known, weight = np.zeros(len(ties)), np.zeros(len(ties))
    if control is None:
        return known, weight
    place = pd.Index(ties).get_indexer(control["tie"])
    if (place < 0).any() or not (control["std"] > 0).all():
        raise ValueError(
            "Invalid control. Must be tie points of the block, each with a std above zero."
        )
    known[place], weight[place] = control["reflectance"], control["std"] ** -2.0
    return known, weight


def _view_terms(observations):
    """Walthall's even and odd term of each observation, shape (n, 2)."""
    angles = (observations[f"{name}_deg"] for name in ("sun_zenith", "view_zenith", "azimuth"))
    return walthall_terms(*angles)[:, :2]


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
