"""Points of the drives with what places them: time, head, pose of the vehicle."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.scan_pattern.lattice import rotations

AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""About which roll, pitch and heading turn."""

SAMPLE = 2_000_000
"""Points of a cloud looked at in the search for planes; of larger clouds, so many at random."""

BLOCK = 200_000
"""Points placed at a time."""

POINT_COLUMNS = ("points", "time", "head", "drive")
"""What is known of each point of the drives."""


ARRAYS = ("points", "time", "head", "offset", "rotation", "vector")
"""Of a sample, one row a point."""


@dataclass(eq=False)
class Sample:
    """Points with what places them: time, head, pose of the vehicle, vector from the head."""

    points: np.ndarray
    time: np.ndarray
    head: np.ndarray
    origin: np.ndarray = None
    lever: np.ndarray = None
    offset: np.ndarray = None
    rotation: np.ndarray = None
    vector: np.ndarray = None

    @classmethod
    def of(cls, points, time, head):
        return cls(points, np.asarray(time, dtype=np.float64), np.asarray(head, dtype=int))

    @classmethod
    def joined(cls, samples):
        """Samples of several drives as one; all have the same origin."""
        arrays = {name: np.concatenate([getattr(s, name) for s in samples]) for name in ARRAYS}
        return cls(**arrays, origin=samples[0].origin, lever=samples[0].lever)

    def select(self, which):
        """The sample of some of the points; a mask or their numbers."""
        arrays = {name: getattr(self, name)[which] for name in ARRAYS}
        return Sample(**arrays, origin=self.origin, lever=self.lever)

    def locate(self, trajectory, lever_arms, origin):
        """Find the vector from the head to each point, in the vehicle's frame."""
        position, self.rotation = trajectory.at(self.time)
        self.origin = origin
        self.lever = np.asarray(lever_arms, dtype=np.float64)
        self.offset = position - self.origin
        from_vehicle = (self.points - self.origin) - self.offset
        self.vector = np.einsum("nij,ni->nj", self.rotation, from_vehicle) - self.lever[self.head]

    def turned(self, values):
        """Vectors under a boresight, (n, 3); ``values`` (heads, 6) in radians and metres."""
        return np.einsum("nij,nj->ni", rotations(*values[:, :3].T)[self.head], self.vector)

    def placed(self, values):
        """Points from the origin under a mounting, (n, 3)."""
        inside = self.turned(values) + (self.lever + values[:, 3:])[self.head]
        return self.offset + np.einsum("nij,nj->ni", self.rotation, inside)

    def derivatives(self, values, normal):
        """Change of each point along ``normal`` (n, 3) by its own head's parameters, (n, 6)."""
        beam = self.turned(values)
        across = np.einsum("nij,ni->nj", self.rotation, normal)
        return np.hstack([np.cross(beam, across) @ AXES.T, across])


def drive_points(drives, lever, origin, values, rng):
    """Points of all drives under a mounting, thinned, and the group (drive and head) of each."""
    parts = []
    for number, (cloud, trajectory) in enumerate(drives):
        count = min(len(cloud), SAMPLE)
        chosen = np.sort(rng.choice(len(cloud), count, replace=False))
        points, time = cloud.points[chosen], cloud["gps_time"][chosen]
        head = heads(cloud)[chosen]
        placed = points - origin
        if values.any():
            known = {"trajectory": trajectory, "lever": lever, "origin": origin}
            placed = placed_points(points, time, head, values=values, **known)
        parts.append((points, time, head, np.full(count, number), placed))
    names = (*POINT_COLUMNS, "placed")
    samples = {
        name: np.concatenate(p) for name, p in zip(names, zip(*parts, strict=True), strict=True)
    }
    return samples, samples["drive"] * len(lever) + samples["head"]


def placed_points(points, time, head, *, trajectory, lever, values, origin):
    """Points (n, 3) from the origin, under a mounting whose angles are in radians."""
    placed = np.empty_like(points)
    for first in range(0, len(points), BLOCK):
        part = slice(first, first + BLOCK)
        sample = Sample.of(points[part], time[part], head[part])
        sample.locate(trajectory, lever, origin)
        placed[part] = sample.placed(values)
    return placed


def heads(cloud):
    """Head of each point; all the first where the cloud does not say."""
    return cloud["head"].astype(int) if "head" in cloud else np.zeros(len(cloud), dtype=int)


def radians(values):
    """Estimates (heads, 6) with angles in radians."""
    return values * np.array([np.pi / 180] * 3 + [1.0] * 3)
