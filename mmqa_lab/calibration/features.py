"""What points lie on: planes, poles and control points, and how far off they are."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.planes import fit_plane

OWN_PARAMETERS = {"plane": 3, "pole": 5, "control": 2}
"""Of a feature itself; they are eliminated from the adjustment."""


@dataclass(eq=False)
class Feature:
    """What some points lie on: their numbers, and how they are measured against it."""

    kind: str
    index: np.ndarray
    start: np.ndarray = None

    def misfit(self, points):
        """Distances of points from the fitted feature, normals, derivatives by its parameters."""
        return {"plane": _plane_misfit, "pole": pole_misfit, "control": _control_misfit}[self.kind](
            points, self.start
        )


def _plane_misfit(points, _):
    """Distances from the regression plane, its normal, derivatives by offset and two tilts."""
    plane = fit_plane(points)
    flat = plane.project(points)
    derivative = np.column_stack([np.ones(len(points)), flat])
    return plane.residuals, np.broadcast_to(plane.normal, points.shape), derivative


def pole_misfit(points, start, steps=12):
    """Distances from the best cylinder, outward normals, derivatives by its five parameters."""
    axis = np.array(start, dtype=np.float64)
    height = points[:, 2] - points[:, 2].mean()
    for _ in range(steps):
        misfit, way, derivative = _from_axis(points, height, axis)
        change = np.linalg.lstsq(derivative, -misfit, rcond=1e-8)[0]
        axis = axis + np.clip(change, -0.1, 0.1)
        axis[4] = np.clip(axis[4], 0.01, 0.5)
        if np.abs(change).max() < 1e-8:
            break
    misfit, way, derivative = _from_axis(points, height, axis)
    tilt = np.column_stack([way, -(way * axis[2:4]).sum(axis=1)])
    return misfit, tilt, derivative


def _from_axis(points, height, axis):
    """Distances from a cylinder, unit vectors from its axis in plan, derivatives."""
    off = points[:, :2] - axis[:2] - height[:, None] * axis[2:4]
    distance = np.maximum(np.hypot(*off.T), 1e-9)
    way = off / distance[:, None]
    derivative = -np.column_stack([way, height[:, None] * way, np.ones(len(points))])
    return distance - axis[4], way, derivative


def _control_misfit(points, known):
    """Heights over a control point, less a tilted surface through it; two tilts eliminated."""
    off = points - known
    tilts = off[:, :2]
    slope = np.linalg.lstsq(tilts, off[:, 2], rcond=None)[0]
    normal = np.broadcast_to([-slope[0], -slope[1], 1.0], points.shape)
    return off[:, 2] - tilts @ slope, normal, tilts
