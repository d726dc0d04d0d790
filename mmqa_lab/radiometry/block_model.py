"""The model of a block's observations and its derivatives."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import sparse

from mmqa_lab._checks import check_columns, check_number, refuse
from mmqa_lab.radiometry.anisotropy import walthall_terms

__all__ = ["Block", "sun_cosine", "surfaces_of", "view_terms"]
__dir__ = __all__.copy

ANGLES = ("sun_zenith_deg", "view_zenith_deg", "azimuth_deg")

OBSERVATION_COLUMNS = ("image", "tie", "radiance", *ANGLES, "radius")


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
    """Walthall's even and odd term of each observation, shape (n, 2)."""
    return walthall_terms(observations["view_zenith_deg"], observations["azimuth_deg"])[:, :2]


def sun_cosine(observations):
    """Cosine of the sun's zenith angle."""
    cosine = np.cos(np.radians(observations["sun_zenith_deg"].to_numpy(dtype=np.float64)))
    if not (cosine > 0).all():
        raise ValueError("Invalid sun_zenith_deg. Must be below 90 degrees.")
    return cosine


def surfaces_of(observations):
    """Surface of each observation; a single surface if none is named."""
    return observations.get("surface", pd.Series(0, observations.index)).to_numpy()


def _phase(observations):
    """Angle between the directions to the sun and to the camera, degrees."""
    sun, view, azimuth = np.radians(observations[list(ANGLES)].to_numpy(dtype=np.float64)).T
    both = np.cos(sun) * np.cos(view) + np.sin(sun) * np.sin(view) * np.cos(azimuth)
    return np.degrees(np.arccos(np.clip(both, -1, 1)))
