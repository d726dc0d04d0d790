"""The normal equations of a block: its observations as arrays, and one step of the solution."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy import sparse

from mmqa_lab._checks import check_number, check_positive
from mmqa_lab.radiometry.brdf import walthall_terms

COLUMNS = ("image", "tie", "radiance", "sun_zenith_deg", "view_zenith_deg", "azimuth_deg", "radius")

FREE, FIXED = np.inf, 0.0


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


@dataclass(eq=False)
class Problem:
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


def iterate(problem, linearised, weight):
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


def misfit_scale(scaled):
    """Robust standard deviation of the scaled misfit about zero."""
    return max(1.4826 * np.median(np.abs(scaled)), 1e-12)


def block_problem(observations, control, priors, relative_std):
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
    surface, surfaces = pd.factorize(surfaces_of(observations), sort=True)
    if not (observations.groupby("tie")["image"].nunique() > 1).any():
        raise ValueError("Invalid observations: no tie point in two images. Must overlap.")
    if priors is None:
        priors = Priors(haze=(0.0, FIXED if control is None else FREE))
    value, std = _prior_arrays(priors, len(images), len(surfaces))
    known, known_weight = _control(control, ties)
    sun, radius = sun_cosine(observations), observations["radius"].to_numpy(dtype=np.float64)
    with np.errstate(divide="ignore"):
        weight = np.where(std > 0, std**-2.0, 0.0)
    problem = Problem(
        **{"signal": signal, "std": relative_std * signal, "image": image, "tie": tie},
        **{"surface": surface, "terms": view_terms(observations), "sun": sun, "radius2": radius**2},
        **{"shape": (len(images), len(surfaces), len(ties)), "fixed": std == 0},
        **{"prior": value, "prior_weight": weight},
        **{"control": known, "control_weight": known_weight},
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


def view_terms(observations):
    """Walthall's even and odd term of each observation, shape (n, 2)."""
    angles = (observations[f"{name}_deg"] for name in ("sun_zenith", "view_zenith", "azimuth"))
    return walthall_terms(*angles)[:, :2]


def sun_cosine(observations):
    """Cosine of the sun's zenith angle."""
    cosine = np.cos(np.radians(observations["sun_zenith_deg"].to_numpy(dtype=np.float64)))
    if not (cosine > 0).all():
        raise ValueError("Invalid sun_zenith_deg. Must be below 90 degrees.")
    return cosine


def surfaces_of(observations):
    """Surface of each observation; one for all where none is named."""
    if "surface" in observations:
        return observations["surface"].to_numpy()
    return np.zeros(len(observations), dtype=int)
