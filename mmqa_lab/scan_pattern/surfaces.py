"""Surfaces that are scanned: patches given by point and normal, MIMIC's plane among them."""

from dataclasses import dataclass

import numpy as np

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab.scan_pattern.setups import check_values, turned


@dataclass(frozen=True, eq=False)
class Patch:
    """Small pieces of any surface, each by its place and its normal.

    Parameters
    ----------
    points : array_like, shape (..., 3)
        X and Z from the scanner in metres; Y is free, for the scan comes past every Y.
    normals : array_like, shape (..., 3)
        Of any length, outwards where the surface has an inside.

    Raises
    ------
    ValueError
        If shapes differ, a number is not finite or a normal has no length.

    Examples
    --------
    >>> road = Patch([3.0, 0.0, -2.5], [0, 0, 1])
    >>> road.normals.tolist()
    [0.0, 0.0, 1.0]
    """

    points: np.ndarray
    normals: np.ndarray

    def __post_init__(self):
        points = check_values(self.points, "points")
        normals = check_values(self.normals, "normals")
        if points.shape[-1:] != (3,) or normals.shape[-1:] != (3,):
            raise ValueError(
                f"Invalid patch of points {points.shape} and normals {normals.shape}. "
                "Must have shapes (..., 3)."
            )
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        if not length.all():
            raise ValueError("Invalid normals: one is zero. Must be > 0 long.")
        points, normals = np.broadcast_arrays(points, normals / length)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "normals", normals)


@dataclass(frozen=True, kw_only=True)
class Target:
    """MIMIC's target: a plane at a distance, tilted, then turned.

    Parameters
    ----------
    heading_deg : float
        alpha_targ: positive turns the wall towards the vehicle, negative away.
    tilt_deg : float
        beta_targ: positive leans its top away from the vehicle.
    range_m : float
        Horizontal range (Hr): X of the plane where the horizontal pulse of the level vehicle
        strikes it. That pulse is ``range_m / cos(scanner heading)`` long.
    height_difference_m : float
        Height of the evaluated spot above the scanner (h_targ - h_scan).

    Raises
    ------
    ValueError
        If a value is not finite or the range is not above zero.

    Examples
    --------
    >>> Target(heading_deg=15, tilt_deg=30, range_m=5).normal.round(4).tolist()
    [0.8365, 0.2241, -0.5]
    """

    heading_deg: float = 0.0
    tilt_deg: float = 0.0
    range_m: float
    height_difference_m: float = 0.0

    def __post_init__(self):
        for name in ("heading_deg", "tilt_deg", "height_difference_m"):
            check_values(getattr(self, name), f"target {name}")
        check_values(self.range_m, "range_m", positive=True)

    @property
    def normal(self):
        """Normal of the plane, away from the vehicle (n_t), (..., 3)."""
        return target_normal(self.heading_deg, self.tilt_deg)

    def patch(self, setup):
        """Return the spot of the plane that is evaluated.

        Raises
        ------
        ValueError
            If the horizontal pulse does not meet the plane's front.
        """
        rotation = turned("z", setup.scanner_heading_deg) @ turned("x", setup.scanner_tilt_deg)
        level, upward = rotation[..., :, 0], rotation[..., :, 2]
        normal = self.normal
        facing = np.sum(normal * level, axis=-1)
        if (np.minimum(facing, level[..., 0]) < 1e-9).any():
            raise ValueError(
                f"Invalid target heading {self.heading_deg} and tilt {self.tilt_deg} for a scanner "
                f"heading of {setup.scanner_heading_deg}. Must let the horizontal pulse strike the "
                "front: headings less than 90 degrees apart, tilt less than 90."
            )
        lift = self.height_difference_m / upward[..., 2]
        along = self.range_m / level[..., 0] - lift * np.sum(normal * upward, axis=-1) / facing
        points = along[..., None] * level + lift[..., None] * upward
        return Patch(points, -normal)


def target_normal(heading, tilt):
    """Normal Rz(heading) Ry(tilt) X of a target plane, (..., 3), of angles in degrees."""
    return (turned("z", heading) @ turned("y", tilt))[..., :, 0]


def cylinder_patch(axis_point, radius, *, azimuths_deg, heights_m):
    """Return the surface of an upright post as patches.

    Parameters
    ----------
    axis_point : array_like, shape (2,)
        X and Y of the axis, metres from the scanner.
    radius : float
        Metres.
    azimuths_deg : array_like, shape (n,)
        Directions from the axis, counter-clockwise from X.
    heights_m : array_like, shape (m,)
        Above the scanner.

    Returns
    -------
    Patch
        Of shape (m, n, 3), normals outwards.

    Raises
    ------
    ValueError
        If the radius is not above zero or a place is not finite.

    Examples
    --------
    >>> post = cylinder_patch([5, 0], 0.15, azimuths_deg=[180], heights_m=[0])
    >>> post.points.round(9).tolist(), post.normals.round(9).tolist()
    ([[[4.85, 0.0, 0.0]]], [[[-1.0, 0.0, 0.0]]])
    """
    radius = check_positive(radius, "radius", unit="m")
    axis = check_points([axis_point], name="axis_point", columns=2)[0]
    azimuth, height = np.meshgrid(
        np.radians(check_values(azimuths_deg, "azimuths_deg")),
        check_values(heights_m, "heights_m"),
    )
    normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    places = np.stack(np.broadcast_arrays(axis[0], axis[1], height), axis=-1)
    return Patch(places + radius * normals, normals)


def mesh_patch(vertices, faces):
    """Return the triangles of a mesh as patches, and their areas.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Metres from the scanner.
    faces : array_like of int, shape (m, 3)
        Counter-clockwise seen from outside.

    Returns
    -------
    Patch, array of shape (m,)
        Centroids with outward normals; areas in m2. Density times area is the expected count.

    Raises
    ------
    ValueError
        If a vertex is not finite or a face names one that is not there.

    Examples
    --------
    >>> patch, areas = mesh_patch([[5, 0, 0], [5, 0, 1], [5, 1, 0]], [[0, 1, 2]])
    >>> patch.normals.tolist(), areas.tolist()
    ([[-1.0, 0.0, 0.0]], [0.5])
    """
    vertices = check_points(vertices, name="vertices", minimum=3)
    faces = np.asarray(faces)
    whole = faces.dtype.kind in "iu" and faces.ndim == 2 and faces.shape[1] == 3
    if not whole or faces.min(initial=0) < 0 or faces.max(initial=0) >= len(vertices):
        raise ValueError(
            f"Invalid faces of shape {faces.shape}. Must be rows of three vertex numbers below "
            f"{len(vertices)}."
        )
    first, second, third = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(second - first, third - first)
    areas = np.linalg.norm(normals, axis=1) / 2
    return Patch((first + second + third) / 3, normals), areas
