"""Points as they were shot: from where, in which attitude, by which head."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mmqa_lab._checks import check_columns
from mmqa_lab.rotations import rotations

__all__ = ["Shots"]


TURN_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Axes of roll, pitch and heading."""


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
            raise ValueError(f"Invalid {name}: no points. Must have some.")
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

    def slopes(self, values, way):
        """Change of points along ``way`` (n, 3) by heads (6 h columns), then by paths (6 d).

        A path's error lasts its whole drive: place (east, north, height) and angles.
        """
        beam, point = self.inside(values)
        across = np.einsum("nij,ni->nj", self.rotation, way)
        own = np.hstack([np.cross(beam, across) @ TURN_AXES.T, across])
        paths = np.hstack([way, np.cross(point, across) @ TURN_AXES.T])
        heads, count = len(values), self.drive.max() + 1
        table = np.zeros((len(way), heads + count, 6))
        rows = np.arange(len(way))
        table[rows, self.head], table[rows, heads + self.drive] = own, paths
        return table.reshape(len(way), -1)
