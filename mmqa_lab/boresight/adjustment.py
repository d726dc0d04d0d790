"""Least squares of misfits: distances of shots from the planes, poles and points they lie on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares

from mmqa_lab._checks import check_columns
from mmqa_lab._compiled import njit
from mmqa_lab.cloud import group_axes
from mmqa_lab.planes import sigma_mad
from mmqa_lab.rotations import rotations

__all__ = ["PARAMETERS", "Adjustment", "OnGround", "OnPlanes", "OnPoles", "Shots", "stay_open"]


PARAMETERS = ("roll_deg", "pitch_deg", "heading_deg", "x_m", "y_m", "z_m")
"""Parameters of each head: boresight, and corrections to the assumed lever arm."""


class Adjustment:
    """Least squares of the misfits of all kinds, each over its scatter."""

    def __init__(self, kinds, free, level):
        self.kinds = [kind for kind in kinds if len(kind.of)]
        self.ways = np.eye(len(free))[:, free]
        if level and free[5]:  # the mean of z_m stays 0
            self.ways = self.ways @ null_space(self.ways[5::6].sum(axis=0, keepdims=True))

    def system(self, values, paths=False):
        """Misfits and slopes by free parameters and by paths, and the feature of each row.

        Slopes by paths have no columns where they are not asked for.
        """
        parts, last = [], 0
        for kind in self.kinds:
            misfit, slopes, of = kind.rows(values, paths)
            parts.append((misfit / kind.scatter, slopes / kind.scatter, last + of))
            last += len(kind.known)
        misfit, slopes, of = map(np.concatenate, zip(*parts, strict=True))
        return misfit, slopes[:, : values.size] @ self.ways, slopes[:, values.size :], of

    def solved(self, values):
        """The mounting (heads, 6); after each turn, misfits beyond 3.5 sigma_MAD are left out."""
        parameters = self.ways.T @ values.ravel()
        for turn in range(3):  # misfits leave in between
            for kind in self.kinds if turn else []:
                misfit = kind.rows(values, False)[0]
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
        misfit, slopes, paths, of = self.system(values, paths=True)
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
    """Return the error that names the parameters that the drives do not determine."""
    names = [f"{PARAMETERS[k % 6]} of head {k // 6 + 1}" for k in np.flatnonzero(which)]
    return ValueError(
        f"Invalid drives: {' with '.join(names)} stays open. Must run in both directions past "
        "walls, poles and control points, or keep one of these as assumed."
    )


class OnPlanes:
    """Points on features of the same kind, here planes, feature by feature.

    ``scatter`` has a typical value until the misfits are known.
    """

    scatter = 0.005

    def __init__(self, shots, features):
        self.known = [known for _, known in features]
        self.of = np.repeat(np.arange(len(features)), [len(index) for index, _ in features])
        index = [index for index, _ in features]
        self.shots = shots.select(np.concatenate([np.empty(0, int), *index]))

    @property
    def starts(self):
        """First row of each feature that still has points."""
        return np.flatnonzero(np.diff(self.of, prepend=-1))

    def rows(self, values, paths=True):
        """Misfit, slopes (see ``Shots.slopes``) and number of the feature of each row.

        The parameters of the features are eliminated.
        """
        n, off, _, variance, axes = group_axes(self.shots.placed(values), self.starts)
        off = np.einsum("ni,nij->nj", off, np.repeat(axes, n, axis=0))
        slopes = self.shots.slopes(values, np.repeat(axes[:, :, 0], n, axis=0), paths)
        sizes = n[:, None] * np.maximum(variance, 1e-12)
        sizes[:, 0] = n
        ways = np.column_stack([np.ones(len(off)), off[:, 1:]])
        _without(ways, sizes, np.append(self.starts, len(off)), slopes)
        return off[:, 0], slopes, self.of

    def keep(self, good):
        """Leave out the points of the other rows."""
        self.shots, self.of = self.shots.select(good), self.of[good]


class OnPoles(OnPlanes):
    """Points on cylinders with known outward normals and, if given, known radii.

    The normals belong to the circle of each drive and head, since two arcs of a thin pole may have
    moved past each other.
    """

    def __init__(self, shots, features):
        super().__init__(shots, features)
        self.ways = np.concatenate([np.empty((0, 2)), *(known[0] for known in self.known)])

    def rows(self, values, paths=True):
        """See ``OnPlanes``."""
        points = self.shots.placed(values)
        misfit = (self.ways * points[:, :2]).sum(axis=1)
        slopes = self.shots.slopes(values, np.pad(self.ways, ((0, 0), (0, 1))), paths)
        both = np.column_stack([misfit, slopes])
        for run in np.split(np.arange(len(points)), self.starts[1:]):
            way, radius = self.ways[run], self.known[self.of[run[0]]][1]
            height = points[run, 2:] - points[run, 2].mean()
            own = np.hstack([way, height * way, np.ones((len(run), 1))])
            basis = np.linalg.qr(own[:, : 4 if radius else 5])[0]
            both[run, 0] -= radius or 0.0
            both[run] -= basis @ (basis.T @ both[run])
        return both[:, 0], both[:, 1:], self.of

    def keep(self, good):
        """See ``OnPlanes``."""
        super().keep(good)
        self.ways = self.ways[good]


class OnGround(OnPlanes):
    """Points around control points of known height; a row per control point."""

    scatter = 0.01

    def rows(self, values, paths=True):
        """See ``OnPlanes``; a row per control point."""
        numbers, n = np.unique(self.of, return_counts=True)
        up = np.tile([0.0, 0.0, 1.0], (len(self.of), 1))
        both = np.hstack([self.shots.placed(values)[:, 2:], self.shots.slopes(values, up, paths)])
        both = np.add.reduceat(both, self.starts) / n[:, None]
        return both[:, 0] - np.take(self.known, numbers), both[:, 1:], numbers

    def keep(self, good):
        """See ``OnPlanes``."""
        super().keep(np.repeat(good, np.unique(self.of, return_counts=True)[1]))


@dataclass(frozen=True, eq=False)
class Shots:
    """The data of points: head, drive, place and attitude of the vehicle, lever arm, beam."""

    head: np.ndarray
    drive: np.ndarray
    place: np.ndarray
    rotation: np.ndarray
    arm: np.ndarray
    beam: np.ndarray

    @classmethod
    def of(cls, cloud, trajectory, lever, origin, drive=0):
        """The shots of a cloud; places count from the origin."""
        name = f"cloud {cloud.name or drive + 1}"
        if not len(cloud):
            raise ValueError(f"Invalid {name}: no points. Must have at least one.")
        head = cloud["head"] if "head" in cloud else np.zeros(len(cloud), dtype=int)
        wrong = (head < 0) | (head >= len(lever)) | (head % 1 != 0)
        if wrong.any():
            raise ValueError(
                f"Invalid head {head[wrong][0]:g} of {name}. Must be 0 to {len(lever) - 1}: heads "
                "count from 0, with one lever arm each."
            )
        check_columns(dict.fromkeys(cloud.columns), ("gps_time",), name)
        try:
            position, rotation = trajectory.at(np.asarray(cloud["gps_time"], dtype=np.float64))
        except ValueError as error:
            raise ValueError(f"Invalid {name}: {str(error).removeprefix('Invalid ')}") from None
        head = head.astype(int)
        beam = np.einsum("nij,ni->nj", rotation, cloud.points - position) - lever[head]
        drives = np.full(len(cloud), drive)
        return cls(head, drives, position - origin, rotation, lever[head], beam)

    @classmethod
    def sampled(cls, drives, lever, origin, rng):
        """The shots of all drives, at most a million of each cloud, at random."""
        parts = []
        for number, (cloud, path) in enumerate(drives):
            rows = np.sort(rng.permutation(len(cloud))[:1_000_000])
            parts.append(cls.of(cloud[rows], path, lever, origin, number))
            time = cloud["gps_time"]
            if time.min() == time.max():
                raise ValueError(
                    f"Invalid gps_time of cloud {cloud.name or number + 1}: all {time[0]} s. "
                    "Must be the time of each point."
                )
        columns = ([getattr(part, field.name) for part in parts] for field in fields(cls))
        return cls(*map(np.concatenate, columns))

    def select(self, which):
        """The shots of a mask or of row numbers."""
        return Shots(*(getattr(self, field.name)[which] for field in fields(self)))

    def inside(self, values):
        """Beams as the heads' boresight turns them, and points, both in the vehicle's frame."""
        beam = np.einsum("nij,nj->ni", rotations(*values[:, :3].T)[self.head], self.beam)
        return beam, beam + self.arm + values[self.head, 3:]

    def placed(self, values):
        """Points from the origin; ``values`` (heads, 6) in radians and metres."""
        return self.place + np.einsum("nij,nj->ni", self.rotation, self.inside(values)[1])

    def slopes(self, values, way, paths=True):
        """Change of points along ``way`` (n, 3) by heads (6 h columns), then by paths (6 d).

        A path's error lasts its whole drive: place (east, north, height) and angles.
        """
        beam, point = self.inside(values)
        across = np.einsum("nij,ni->nj", self.rotation, way)
        last, rows = 6 * len(values), np.arange(len(way))[:, None]
        table = np.zeros((len(way), last + paths * 6 * (self.drive.max() + 1)))
        _turned(beam, across, 6 * self.head, table)
        table[rows, 6 * self.head[:, None] + [3, 4, 5]] = across
        if paths:
            _turned(point, across, last + 6 * self.drive + 3, table)
            table[rows, last + 6 * self.drive[:, None] + [0, 1, 2]] = way
        return table


@njit(nogil=True)
def _turned(arm, across, first, table):
    """Fill in the slopes by roll, pitch and heading of points at the end of an arm, (n, 3)."""
    for n in range(len(arm)):
        (x, y, z), (a, b, c) = arm[n], across[n]
        table[n, first[n]] = z * a - x * c
        table[n, first[n] + 1] = y * c - z * b
        table[n, first[n] + 2] = y * a - x * b


@njit(nogil=True)
def _without(ways, sizes, starts, slopes):
    """Take from slopes what the parameters of each plane do: its offset and two tilts.

    ``ways`` (n, 3) are their own slopes, orthogonal from the centre, with sums of squares
    ``sizes`` (features, 3). Feature by feature they stay in the cache of the processor.
    """
    share = np.empty(slopes.shape[1])
    for g in range(len(sizes)):
        for k in range(3):
            share[:] = 0.0
            for n in range(starts[g], starts[g + 1]):
                for c in range(len(share)):
                    share[c] += ways[n, k] * slopes[n, c]
            for c in range(len(share)):
                share[c] /= sizes[g, k]
            for n in range(starts[g], starts[g + 1]):
                for c in range(len(share)):
                    slopes[n, c] -= ways[n, k] * share[c]
