"""Least squares of the misfits of all kinds, and the variance of what they give."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares

from mmqa_lab.planes import sigma_mad

__all__ = ["PARAMETERS", "Adjustment", "stay_open"]


PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Parameters of each head: boresight, and corrections to the assumed lever arm."""


class Adjustment:
    """Least squares of the misfits of all kinds, each over its scatter."""

    def __init__(self, kinds, free, level):
        self.kinds = [kind for kind in kinds if len(kind.of)]
        self.ways = np.eye(len(free))[:, free]
        if level and free[5]:  # the mean of z_m stays 0
            self.ways = self.ways @ null_space(self.ways[5::6].sum(axis=0, keepdims=True))

    def system(self, values):
        """Misfits and slopes by free parameters and by paths, and the feature of each row."""
        parts, last = [], 0
        for kind in self.kinds:
            misfit, slopes, of = kind.rows(values)
            parts.append((misfit / kind.scatter, slopes / kind.scatter, last + of))
            last += len(kind.known)
        misfit, slopes, of = map(np.concatenate, zip(*parts, strict=True))
        return misfit, slopes[:, : values.size] @ self.ways, slopes[:, values.size :], of

    def solved(self, values):
        """The mounting (heads, 6); after each turn, misfits beyond 3.5 sigma_MAD are left out."""
        parameters = self.ways.T @ values.ravel()
        for turn in range(3):  # misfits leave in between
            for kind in self.kinds if turn else []:
                misfit = kind.rows(values)[0]
                kind.scatter = max(sigma_mad(misfit), 1e-6)
                kind.keep(np.abs(misfit) <= 3.5 * kind.scatter)  # the rule for outliers
            parameters = self._fitted(parameters)
            values = self.values(parameters)
        return values

    def _fitted(self, parameters):
        """Parameters of the least misfits; a place is asked for misfits, then for slopes."""
        at = lru_cache(1)(lambda p: self.system(self.values(np.array(p))))
        return least_squares(
            lambda p: at(tuple(p))[0],
            parameters,
            lambda p: at(tuple(p))[1],
            x_scale="jac",
            xtol=1e-5,
            ftol=1e-6,
            max_nfev=20,
        ).x

    def values(self, parameters):
        """Array (heads, 6), 0 for kept parameters."""
        return (self.ways @ parameters).reshape(-1, len(PARAMETERS))

    def variance(self, values, path_std):
        """Variances of all parameters, and their degrees of freedom.

        V = sum_g u_g u_g' with u_g = N^-1 (I - N_g N^-1)^-1 J_g' r_g: each feature g contributes
        its misfits r_g from the mounting that all other features give (CR3 of Bell and McCaffrey
        2002, a jackknife). J_g are its slopes, N_g = J_g' J_g its part of the normal matrix N. The
        degrees of freedom of a variance are the number of features that would have the same
        variance with equal shares.
        """
        misfit, slopes, paths, of = self.system(values)
        self._refuse_open(slopes)
        starts = np.flatnonzero(np.diff(of, prepend=-1))
        gradients = np.add.reduceat(slopes * misfit[:, None], starts)
        normals = np.array([part.T @ part for part in np.split(slopes, starts[1:])])
        inverse = np.linalg.inv(slopes.T @ slopes)
        without = np.eye(len(inverse)) - normals @ inverse
        influence = self.ways @ inverse @ np.linalg.solve(without, gradients[..., None])[..., 0].T
        solver = self.ways @ inverse
        share = np.einsum("ij,gjk,ik->gi", solver, normals, solver)
        of_paths = solver @ slopes.T @ (paths * np.tile(path_std, paths.shape[1] // 6))
        of_points = (influence**2).sum(axis=1)
        variance = of_points + (of_paths**2).sum(axis=1)
        with np.errstate(invalid="ignore"):  # of kept parameters
            students = share.sum(axis=0) ** 2 / (share**2).sum(axis=0)
            return variance, students * (variance / of_points) ** 2

    def _refuse_open(self, slopes):
        """Refuse a mounting with parameters that can change together without any effect."""
        lengths = np.maximum(np.linalg.norm(slopes, axis=0), np.finfo(float).tiny)
        _, size, ways = np.linalg.svd(slopes / lengths, full_matrices=False)
        if size[-1] < 1e-4:  # of the scaled Jacobian: this combination is open
            raise stay_open(np.abs(self.ways @ ways[-1]) > 0.1)


def stay_open(which):
    """The error that names the parameters that the drives do not determine."""
    names = [f"{PARAMETERS[k % 6]} of head {k // 6 + 1}" for k in np.flatnonzero(which)]
    return ValueError(
        f"Invalid drives: {' with '.join(names)} stays open. Must run in both directions past "
        "walls, poles and control points, or keep one of these as assumed."
    )
