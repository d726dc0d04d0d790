"""Radiometric block adjustment: one least-squares solution over all overlapping images.

EuroSDR 2013, image radiometry, block equalisation: what aerial triangulation is to geometry. A tie
point is a patch of ground that several images show; whatever makes its values differ (exposure,
height of the sun, haze, anisotropic reflectance, falling off to the corners) is estimated from all
of them together. The radiance of tie point k in image i is taken to be

    L = gain_i * (cos(sun_i) * R_k * (1 + b1 v^2 + b2 v cos(a)) + haze) * (1 - radial * r^2)

with Walthall's terms of ``brdf`` (v, a: zenith angle and azimuth of the view; radians) and r, the
distance from the image's centre over that of its corner. With control targets R is reflectance,
without any it is relative.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_count
from mmqa_lab.radiometry._normal_equations import (
    FIXED,
    FREE,
    Priors,
    block_problem,
    iterate,
    misfit_scale,
    sun_cosine,
    surfaces_of,
    view_terms,
)

__all__ = ["FIXED", "FREE", "BlockAdjustment", "Priors", "adjust_block", "tie_spread"]

HUBER = 1.5
"""Residuals beyond so many deviations weigh less (Huber & Ronchetti 2009)."""

REWEIGHTINGS = 6
"""Weights are computed anew in so many iterations and then stay; more would change little."""

AT_REST = 1e-7
"""Largest change of a gain, coefficient or relative reflectance in the last iteration."""


@dataclass(frozen=True, eq=False)
class BlockAdjustment:
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

    def correct(self, observations):
        """Return the nadir reflectance (relative without control) of each observation.

        Parameters
        ----------
        observations : DataFrame
            Columns as for ``adjust_block``; any pixel of any image of the block will do.
        """
        gain = self.gains.set_index("image")["gain"].reindex(observations["image"]).to_numpy()
        coefficients = self.anisotropy.set_index("surface")[["b1", "b2"]]
        b = coefficients.reindex(surfaces_of(observations)).to_numpy()
        radius = observations["radius"].to_numpy()
        light = observations["radiance"].to_numpy() / (gain * (1 - self.radial[0] * radius**2))
        terms = view_terms(observations)
        factor = sun_cosine(observations) * (1 + (terms * b).sum(axis=1))
        return (light - self.haze[0]) / factor


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
        apart, or the iteration does not come to rest.

    Notes
    -----
    In vertical images the view's zenith angle is the radius: falling off to the corners and the
    even part of anisotropy (b1) are one effect and only their sum is determined. Fix one of them or
    give its prior.

    References
    ----------
    EuroSDR 2013, image radiometry: relative and absolute block equalisation.

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
    problem, names = block_problem(observations, control, priors, relative_std)
    step, iteration = np.inf, 0
    while step > AT_REST:
        if iteration == rounds:
            raise ValueError(
                f"Invalid block: not at rest after {rounds} iterations. Must have tie points that "
                "determine the parameters."
            )
        misfit, jacobian, by_ground = problem.linearised()
        scaled = misfit / problem.std
        if iteration < REWEIGHTINGS:
            weight = np.minimum(1, HUBER * misfit_scale(scaled) / np.maximum(np.abs(scaled), 1e-12))
            weight = weight / problem.std**2
        step, inverse = iterate(problem, (misfit, jacobian, by_ground), weight)
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
    sigma0 = float(np.sqrt(np.minimum(scaled**2, (5 * misfit_scale(scaled)) ** 2).sum() / freedom))
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
