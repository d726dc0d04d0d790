"""Surfaces made of primitives: rectangles, discs, round shafts. Lengths are metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.rotations import across

__all__ = [
    "DISC", "RECTANGLE", "SHAFT", "Surface", "discs", "group", "planar_shape", "surface", "vector",
]  # fmt: skip


RECTANGLE, DISC, SHAFT = range(3)
"""Kinds of primitives; ``scenes.Tree`` says what their nine shape numbers mean."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Primitives that share an id and a label.

    Made by the functions of ``surfaces`` (``rectangle``, ``cylinder``, ...), not by hand.

    Parameters
    ----------
    label : str
        What it is, in words of your choice: ``"wall"``, ``"lamp"``.
    kind, centre, shape, half : arrays, shapes (n,), (n, 3), (n, 9), (n, 3)
        Kind of each primitive, its centre, its shape numbers (``scenes.Tree``), the half
        extents of its box.
    reflectance : array, shape (n,)
        Between 0 and 1.

    Examples
    --------
    >>> from mmqa_lab.simulate.surfaces import box
    >>> car = box((0, 0, 0), (1.8, 4.2, 1.5))
    >>> len(car), car.label, car.centre[:, 2].max().item()  # six faces
    (6, 'car', 1.5)
    """

    label: str
    kind: np.ndarray
    centre: np.ndarray
    shape: np.ndarray
    half: np.ndarray
    reflectance: np.ndarray

    def __len__(self):
        return len(self.kind)


def group(surfaces: Sequence[Surface], *, label: str) -> Surface:
    """Return one surface, with one id, of several.

    Parameters
    ----------
    surfaces : sequence of Surface
    label : str

    Returns
    -------
    Surface

    Examples
    --------
    >>> from mmqa_lab.simulate.surfaces import box, cylinder
    >>> mast = [cylinder((0, 0, 0), (0, 0, 5), 0.1), box((0, 0, 5), (0.3, 0.3, 0.2))]
    >>> lamp = group(mast, label="lamp")
    >>> len(lamp), lamp.label
    (7, 'lamp')
    """
    names = [field.name for field in fields(Surface)[1:]]
    return Surface(label, *(np.concatenate([getattr(s, name) for s in surfaces]) for name in names))


def surface(
    label: str,
    kind: int,
    centre: ArrayLike,
    shape: ArrayLike,
    half: ArrayLike,
    reflectance: float,
) -> Surface:
    """Return a surface of primitives of one kind."""
    check_number(reflectance, "reflectance", low=0, high=1)
    centre, shape, half = (np.atleast_2d(numbers) for numbers in (centre, shape, half))
    n = len(centre)
    return Surface(label, np.full(n, kind), centre, shape, half, np.full(n, float(reflectance)))


def discs(
    label: str, centres: ArrayLike, normals: np.ndarray, radius: float, reflectance: float
) -> Surface:
    """Return a surface of discs."""
    check_positive(radius, "radius", unit="m")
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    dual = across(normals) / radius
    shape = np.concatenate([dual[:, 0], dual[:, 1], normals], axis=1)
    half = radius * np.sqrt(np.maximum(1 - normals**2, 0))
    return surface(label, DISC, np.asarray(centres, float), shape, half, reflectance)


def vector(values: ArrayLike, name: str) -> np.ndarray:
    """Return three finite numbers as float64."""
    return check_points(np.atleast_2d(values), name=name)[0]


def planar_shape(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the dual vectors and normal of the half sides ``u`` and ``v``."""
    normal = np.cross(u, v)
    area = np.linalg.norm(normal)
    if area <= 1e-12 * np.linalg.norm(u) * np.linalg.norm(v):
        raise ValueError(f"Invalid sides {2 * u} and {2 * v}. Must not be parallel or zero.")
    normal = normal / area
    return np.concatenate([np.cross(v, normal) / area, np.cross(normal, u) / area, normal])
