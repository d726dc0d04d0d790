"""Tangent planes by the orthogonal regression of the points in cubes."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab.maps._grouped import centred_scatter, signed_distances

LEVEL, UPRIGHT, OTHER = 0, 1, 2
"""Layers: tangent planes up to 45 degrees from the horizontal, steeper ones, and no plane."""

MINIMUM = 5
"""Points that make a plane."""

FLATNESS = 4.0
"""The middle eigenvalue of the scatter is this many times the least, or the points show no plane:
a spread in the plane of twice the spread across. Foliage and single scan lines fall out."""


@dataclass(frozen=True, eq=False)
class Tangents:
    """Tangent planes of cubes.

    Parameters
    ----------
    centres : array, shape (m, 3)
        Means of the points, m.
    axes : array, shape (m, 3, 3)
        Rows u, v, w. The normal w has its largest component positive. Level planes: u as near to
        east as lies in the plane; upright planes: u horizontal. v completes them right-handed.
    layer : array of int, shape (m,)
        ``LEVEL``, ``UPRIGHT`` or ``OTHER``.
    secant : array, shape (m,)
        Area of the plane over a face of the cube, per area of the face.
    face : array of int, shape (m,)
        The axis nearest to the normal: 0 east, 1 north, 2 up.
    """

    centres: np.ndarray
    axes: np.ndarray
    layer: np.ndarray
    secant: np.ndarray
    face: np.ndarray


def tangent_planes(cubes):
    """Fit the plane of each cube: the same one as :func:`mmqa_lab.planes.fit_plane`."""
    centres, scatter = centred_scatter(cubes.xyz, cubes.starts)
    values, vectors = np.linalg.eigh(scatter)
    normals = vectors[:, :, 0]
    face = np.abs(normals).argmax(axis=1)
    largest = np.take_along_axis(normals, face[:, None], axis=1)
    normals = normals * np.where(largest < 0, -1.0, 1.0)
    planar = (cubes.counts >= MINIMUM) & (values[:, 1] > 1e-12 * values[:, 2])
    planar &= values[:, 1] >= FLATNESS * values[:, 0]
    level = np.abs(normals[:, 2]) >= np.sqrt(0.5)
    face = np.where(level, 2, np.abs(normals[:, :2]).argmax(axis=1))
    layer = np.where(planar, np.where(level, LEVEL, UPRIGHT), OTHER)
    secant = 1 / np.abs(np.take_along_axis(normals, face[:, None], axis=1)[:, 0])
    return Tangents(centres, _axes(normals, level), layer, secant, face)


def one_surface(cubes, tangents, thickness):
    """Mask of the cubes, shape (m - 1,), that show one level surface with the cube on top of them.

    A road at the height of a border between cubes has points below it and above it.
    """
    index, centres = cubes.index, tangents.centres
    same = (np.diff(index[:, :2], axis=0) == 0).all(axis=1) & (np.diff(index[:, 2]) == 1)
    same &= (tangents.layer[1:] == LEVEL) & (tangents.layer[:-1] == LEVEL)
    step = np.diff(centres, axis=0)
    for normal in (tangents.axes[:-1, 2], tangents.axes[1:, 2]):
        off = step[:, 0] * normal[:, 0] + step[:, 1] * normal[:, 1] + step[:, 2] * normal[:, 2]
        same &= np.abs(off) <= thickness
    return same


def plane_residuals(cubes, tangents):
    """Signed distance of each point from the plane of its own cube, m."""
    return signed_distances(cubes.xyz, cubes.starts, tangents.centres, tangents.axes[:, 2])


def _axes(normals, level):
    """Rows u, v, w of each plane; sums written out, so that the last bit does not depend on m."""
    x, y, z = normals.T
    zero = np.zeros_like(x)
    # East without its part along the normal, or the horizontal direction across the normal.
    u = np.where(level, np.array([1 - x * x, -x * y, -x * z]), np.array([-y, x, zero]))
    u = u / np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    v = np.array([y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]])
    return np.stack([u.T, v.T, normals], axis=1)
