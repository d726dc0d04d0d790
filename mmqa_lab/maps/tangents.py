"""Tangent planes by the orthogonal regression of the points in cubes."""

from dataclasses import dataclass, fields

import numpy as np

from mmqa_lab.maps._grouped import centred_scatter, farthest, signed_distances

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

    def select(self, chosen):
        """Return the planes at these indices."""
        return Tangents(*(getattr(self, field.name)[chosen] for field in fields(self)))


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


def fuller_parts(cubes, tangents, thickness):
    """The cube that each cube's points belong to, shape (m,): mostly itself.

    A wall on a border between cubes has points to either side of it. The cube with fewer of them
    gives its points to the other one where all of them are near the border and near the other's
    plane, no farther than ``thickness``.
    """
    own = np.arange(len(cubes.counts))
    target = own.copy()
    for axis in (0, 1):
        place, begin = cubes.xyz[axis], cubes.index[:, axis] * cubes.cell
        high = np.maximum.reduceat(place, cubes.starts[:-1]) - begin
        low = np.minimum.reduceat(place, cubes.starts[:-1]) - begin
        for side, depth in ((-1, high), (1, cubes.cell - low)):
            other = cubes.find(cubes.index + side * np.eye(3, dtype=np.int64)[axis])
            here = own[(other >= 0) & (depth <= thickness) & (tangents.layer != LEVEL)]
            there = other[here]
            wall = (tangents.layer[there] == UPRIGHT) & (tangents.face[there] == axis)
            more = cubes.counts[there] - cubes.counts[here]
            wall &= (more > 0) | ((more == 0) & (side < 0))
            here, there = here[wall], there[wall]
            planes = tangents.centres[there], tangents.axes[there, 2]
            near = farthest(cubes.xyz, cubes.starts, here, *planes) <= thickness
            target[here[near]] = there[near]
    gives = target != own
    return np.where(gives & ~gives[target], target, own)


def plane_residuals(cubes, tangents):
    """Signed distance of each point from the plane of its own cube, m."""
    return signed_distances(cubes.xyz, cubes.starts, tangents.centres, tangents.axes[:, 2])


def surface_areas(tangents, index, extent, cell):
    """Area of each plane within its patch, m2.

    Over the square face of the patch, of side ``cell``, where the plane is within ``extent``, shape
    (m, 2), along the axis across the face.
    """
    take = np.arange(len(index))
    a, b = np.where(tangents.face == 0, 1, 0), np.where(tangents.face == 2, 1, 2)
    normal, centre = tangents.axes[:, 2], tangents.centres
    across = normal[take, tangents.face]
    slopes = [-cell * normal[take, axis] / across for axis in (a, b)]
    corner = centre[take, tangents.face]
    for axis, slope in zip((a, b), slopes, strict=True):
        start = np.where(slope < 0, index[take, axis] + 1, index[take, axis]) * cell
        corner = corner + slope / cell * (start - centre[take, axis])
    share = _share_below(extent[:, 1] - corner, *slopes)
    share = share - _share_below(extent[:, 0] - corner, *slopes)
    return cell**2 * tangents.secant * share


def _share_below(height, first, second):
    """Share of the unit square where |first| u + |second| v is below the height."""
    # At least a tenth of a millimetre over the face, to divide by.
    first, second = np.maximum(np.abs(first), 1e-4), np.maximum(np.abs(second), 1e-4)
    corners = (height, height - first, height - second, height - first - second)
    squares = [np.maximum(corner, 0.0) ** 2 for corner in corners]
    share = (squares[0] - squares[1] - squares[2] + squares[3]) / (2 * first * second)
    return np.where(corners[3] >= 0, 1.0, share)


def _axes(normals, level):
    """Rows u, v, w of each plane; sums written out, so that the last bit does not depend on m."""
    x, y, z = normals.T
    zero = np.zeros_like(x)
    # East without its part along the normal, or the horizontal direction across the normal.
    u = np.where(level, np.array([1 - x * x, -x * y, -x * z]), np.array([-y, x, zero]))
    u = u / np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    v = np.array([y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]])
    return np.stack([u.T, v.T, normals], axis=1)
