"""One least-squares adjustment of the radiometry of overlapping images.

After Pepita in EuroSDR 2013, image radiometry, sections 6.1 and 6.2, which does for radiometry what
aerial triangulation does for geometry. Pepita is relative and estimates haze for groups of images,
here those that a column names; control targets are an addition. A tie point is a patch of ground
that several images show; all that makes its values differ (exposure, height of the sun, haze,
anisotropic reflectance, falling off to the corners) is estimated from all of them together. The
radiance of tie point k in image i is taken to be

    L = gain_i * (cos(sun_i) * R_k * (1 + b1 v^2 + b2 v cos(a)) + haze) * (1 - radial * r^2)

with Walthall's terms (v, a: zenith angle and azimuth of the view; radians) and r, the distance from
the image's centre over that of its corner. With control targets R is reflectance, without any it is
relative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.sparse.linalg import splu

from mmqa_lab._checks import check_columns, check_number, refuse
from mmqa_lab._results import Shown
from mmqa_lab.radiometry.doubts import RELATIVE_STD, SHADOW, misfit_scale, warn
from mmqa_lab.radiometry.reflectance import walthall_terms

__all__ = ["Block", "BlockAdjustment", "adjust_block", "sun_cosine", "surfaces_of", "view_terms"]


UNDETERMINED = (
    "Invalid block: its parameters cannot be told apart. Must have more overlap, control targets, "
    "or priors (see Notes)."
)

SMALLEST_STD = 1e-4
"""Least standard deviation of an observation, a share of its radiance."""

ROUNDS, REWEIGHTINGS = 50, 16
"""Largest number of iterations, and iterations in which weights change."""

FALLOFF = (0.0, 0.3)
"""Light lost in the corners of an image of which nothing is known, and its standard deviation."""

ANGLES = ("sun_zenith_deg", "view_zenith_deg", "azimuth_deg")

OBSERVATION_COLUMNS = ("image", "tie", "radiance", *ANGLES, "radius")


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

    def correct(self, observations: pd.DataFrame, *, to_nadir: bool = True) -> np.ndarray:
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
        b = coefficients.reindex(surfaces_of(observations)).to_numpy()
        radius = observations["radius"].to_numpy()
        light = observations["radiance"].to_numpy() / (gain * (1 - self.radial[0] * radius**2))
        seen = (light - haze) / sun_cosine(observations)
        anisotropy = 1 + (view_terms(observations) * b).sum(axis=1)
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
        If control targets contradict each other, or are too dark or too few for an error of 15 % to
        be told, more than a hundredth of the observations do not count, or the light falls off to
        the corners otherwise than with the square of the radius.

    Notes
    -----
    In vertical images the view's zenith angle is the radius: falling off to the corners and the
    even part of anisotropy (b1) are one effect and only their sum is determined. Fix one of them or
    give its prior. A control target that is wrong by less than about eight of its standard
    deviations may stay unnamed, since it draws gains and haze: of six, one that is wrong by five is
    named in a third to three quarters of the blocks. Those of which an error of 15 % would be named
    in fewer than nine of ten blocks are said: dark ones, or too few.

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
    block = Block(observations)
    priors = ((0.0, np.inf), (0.0, np.inf if anisotropy else 0.0), radial, haze)
    refuse(np.isnan(priors).any(), "prior", f"radial {radial}, haze {haze}", "numbers")
    value, std = block.priors(priors, control)
    free, images = std > 0, len(block.images)
    with np.errstate(divide="ignore"):
        prior_weight = std[free] ** -2.0
    estimate = block.start(value, std)
    ties, parameters = len(block.ties), int(free.sum()) - len(block.ties)
    # without control only ratios of gains are determined: their sum stays
    gains = sparse.csc_matrix([(np.arange(free.sum()) < images) * float(control is None)])
    step, before = 1.0, np.ones(int(free.sum()))
    share, freedom = RELATIVE_STD, max(len(block.signal) - free.sum(), 1)
    for iteration in range(ROUNDS):
        misfit, jacobian = block.linearised(estimate)
        # a share of what is expected: of what is seen, shadows would weigh more
        expected = np.maximum(block.signal - misfit, block.signal / 10)
        scaled, jacobian = misfit / expected, jacobian[:, free]
        if iteration < REWEIGHTINGS:
            size = np.abs(scaled) / misfit_scale(scaled)
            if iteration:
                clipped = np.minimum(size, 5) * misfit_scale(scaled)
                share = max(np.sqrt(clipped @ clipped / freedom), SMALLEST_STD)
            weight = (1 + (size / SHADOW) ** 2) ** -2 / (share * expected) ** 2
        normal = jacobian.T @ sparse.diags(weight) @ jacobian + sparse.diags(prior_weight)
        normal = normal + gains.T @ gains * (normal.diagonal()[:parameters].sum() / images**2)
        right = jacobian.T @ (weight * misfit) + prior_weight * (value - estimate)[free]
        change = _factor(normal).solve(right)
        if iteration > REWEIGHTINGS:  # a step too long turns round, one too short goes on
            kept = (change @ before) / (before @ before)
            step = np.clip(step / max(1 - kept, 0.2), 0.1, 3)
        before = change.copy()
        estimate[free] += step * change
        change[parameters:] /= np.abs(estimate[-ties:]).mean()
        if np.abs(change).max() <= 1e-7:
            inverse = _covariance(normal, parameters)
            ties_std = _std_of_known(normal, parameters, std[-ties:])
            warn(block, estimate, value, std, scaled, ties_std)
            return _result(block, estimate, inverse, free, control is not None)
    must = "have more observations or less noise"
    raise ValueError(f"Invalid block: still changing after {ROUNDS} iterations. Must {must}.")


def _tie_spread(values, tie):
    """The coefficient of variation of each tie point's values, percent; NaN for one value."""
    groups = pd.Series(values).groupby(tie)
    return 100 * groups.std() / groups.mean()


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


def _std_of_known(normal, first, std):
    """Adjusted standard deviation of the ties of known reflectance, NaN for all others."""
    known = np.flatnonzero(np.isfinite(std))
    found = np.full(len(std), np.nan)
    if len(known):
        wanted = np.zeros((normal.shape[0], len(known)))
        wanted[first + known, np.arange(len(known))] = 1
        solved = _factor(normal).solve(wanted)[first + known]
        found[known] = np.sqrt(np.diag(solved))
    return found


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


class Block:
    """Arrays of the observations, and indices of their images, ties and surfaces."""

    def __init__(self, observations):
        check_columns(observations, OBSERVATION_COLUMNS, "observations")
        refuse(not len(observations), "observations", "no row", "of one image or more")
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
        self.surface, self.surfaces = pd.factorize(surfaces_of(observations), sort=True)
        named = observations.get("group", pd.Series(0, observations.index))
        self.group, self.groups = pd.factorize(named, sort=True)
        self.group_of_image = np.zeros(len(self.images), dtype=int)
        self.group_of_image[self.image] = self.group
        if (self.group_of_image[self.image] != self.group).any():
            raise ValueError("Invalid group: two in one image. Must be the same in its rows.")
        self.terms, self.sun = view_terms(observations), sun_cosine(observations)
        self.phase_deg = _phase(observations)
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
            check_columns(control, ("tie", "reflectance", "std"), "control")
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


def view_terms(observations):
    """Return Walthall's even and odd term of each observation, shape (n, 2)."""
    return walthall_terms(observations["view_zenith_deg"], observations["azimuth_deg"])[:, :2]


def sun_cosine(observations):
    """Return the cosine of the sun's zenith angle."""
    cosine = np.cos(np.radians(observations["sun_zenith_deg"].to_numpy(dtype=np.float64)))
    if not (cosine > 0).all():
        raise ValueError("Invalid sun_zenith_deg. Must be below 90 degrees.")
    return cosine


def surfaces_of(observations):
    """Return the surface of each observation; a single surface if none is named."""
    return observations.get("surface", pd.Series(0, observations.index)).to_numpy()


def _phase(observations):
    """Angle between the directions to the sun and to the camera, degrees."""
    sun, view, azimuth = np.radians(observations[list(ANGLES)].to_numpy(dtype=np.float64)).T
    both = np.cos(sun) * np.cos(view) + np.sin(sun) * np.sin(view) * np.cos(azimuth)
    return np.degrees(np.arccos(np.clip(both, -1, 1)))
