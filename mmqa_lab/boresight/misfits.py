"""Distances of points from the planes, poles and control points that they lie on."""

from __future__ import annotations

import numpy as np

from mmqa_lab.cloud import group_axes

__all__ = ["OnGround", "OnPlanes", "OnPoles"]


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

    def rows(self, values):
        """Misfit, slopes (see ``Shots.slopes``) and number of the feature of each row.

        The parameters of the features are eliminated.
        """
        n, off, _, variance, axes = group_axes(self.shots.placed(values), self.starts)
        off = np.einsum("ni,nij->nj", off, np.repeat(axes, n, axis=0))
        slopes = self.shots.slopes(values, np.repeat(axes[:, :, 0], n, axis=0))
        for k in range(3):  # offset and two tilts: from the centre they are orthogonal
            size = n if k == 0 else n * np.maximum(variance[:, k], 1e-12)
            column = (np.ones(len(off)) if k == 0 else off[:, k])[:, None]
            share = np.add.reduceat(column * slopes, self.starts) / size[:, None]
            slopes -= column * np.repeat(share, n, axis=0)
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

    def rows(self, values):
        """See ``OnPlanes``."""
        points = self.shots.placed(values)
        misfit = (self.ways * points[:, :2]).sum(axis=1)
        slopes = self.shots.slopes(values, np.pad(self.ways, ((0, 0), (0, 1))))
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

    def rows(self, values):
        """See ``OnPlanes``; a row per control point."""
        numbers, n = np.unique(self.of, return_counts=True)
        up = np.tile([0.0, 0.0, 1.0], (len(self.of), 1))
        both = np.hstack([self.shots.placed(values)[:, 2:], self.shots.slopes(values, up)])
        both = np.add.reduceat(both, self.starts) / n[:, None]
        return both[:, 0] - np.take(self.known, numbers), both[:, 1:], numbers

    def keep(self, good):
        """See ``OnPlanes``."""
        super().keep(np.repeat(good, np.unique(self.of, return_counts=True)[1]))
