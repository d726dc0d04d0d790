"""What points lie on: planes, poles and control points, and how far off they are."""

from dataclasses import dataclass

import numpy as np

OWN_PARAMETERS = {"plane": 3, "pole": 5, "control": 2}
"""Of a feature itself; they are eliminated from the adjustment."""


@dataclass(eq=False)
class Feature:
    """What some points lie on: its kind, their numbers, and where its own search begins."""

    kind: str
    index: np.ndarray
    start: np.ndarray = None

    def __len__(self):
        return len(self.index)


def measured(features, points):
    """Distances of points from the features fitted to them.

    Parameters
    ----------
    features : list of Feature
        Planes first.
    points : array, shape (n, 3)
        Those of the first feature, of the second, ..., m.

    Returns
    -------
    misfit, normal, basis : arrays, shapes (n,), (n, 3), (n, 5)
        Distances, their directions, and an orthonormal basis of what the feature's own parameters
        change in them; columns that a feature does not need are 0.
    """
    counts = np.array([len(feature) for feature in features])
    planes = np.array([feature.kind == "plane" for feature in features])
    misfit, normal, basis = (
        np.empty(len(points)),
        np.empty((len(points), 3)),
        np.zeros((len(points), max(OWN_PARAMETERS.values()))),
    )
    flat = counts[planes].sum()
    misfit[:flat], normal[:flat], basis[:flat, :3] = _plane_misfits(points[:flat], counts[planes])
    first = flat
    for feature in np.array(features, dtype=object)[~planes]:
        part = slice(first, first + len(feature))
        distances = pole_misfit if feature.kind == "pole" else _control_misfit
        misfit[part], normal[part], derivative = distances(points[part], feature.start)
        basis[part, : derivative.shape[1]] = np.linalg.qr(derivative)[0]
        first += len(feature)
    return misfit, normal, basis


def group_planes(points, counts):
    """Regression planes of groups of points that follow each other.

    Returns
    -------
    centre, variance, axes, off : arrays, shapes (k, 3), (k, 3), (k, 3, 3), (n, 3)
        Variances along the axes (columns), rising: the first is the normal; points less centre.
    """
    starts = np.cumsum(counts) - counts
    centre = np.add.reduceat(points, starts) / counts[:, None]
    off = points - np.repeat(centre, counts, axis=0)
    scatter = np.add.reduceat(off[:, :, None] * off[:, None, :], starts) / counts[:, None, None]
    variance, axes = np.linalg.eigh(scatter)
    return centre, np.maximum(variance, 0), axes, off


def _plane_misfits(points, counts):
    """Distances from the regression plane of each group, normals, basis of offset and two tilts."""
    _, variance, axes, off = group_planes(points, counts)
    axes = np.repeat(axes, counts, axis=0)
    along = np.einsum("ni,nij->nj", off, axes)
    # principal axes from the centre are orthogonal to each other and to the constant
    size = np.sqrt(counts[:, None] * np.maximum(variance[:, 1:], 1e-12))
    basis = np.column_stack([np.ones(len(points)), along[:, 1:]])
    basis /= np.repeat(np.column_stack([np.sqrt(counts), size]), counts, axis=0)
    return along[:, 0], axes[:, :, 0], basis


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
