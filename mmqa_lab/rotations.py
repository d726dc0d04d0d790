"""Rotations of a vehicle, of scanners and of targets, and directions across an axis."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_together

__all__ = ["across", "fixed", "rotations", "turned"]


def rotations(roll: ArrayLike, pitch: ArrayLike, heading: ArrayLike) -> np.ndarray:
    """Return rotations (..., 3, 3) from vehicle to track, Rz(-heading) Rx(pitch) Ry(roll), radians.

    Examples
    --------
    >>> (rotations(0, 0, np.pi / 2) @ [0, 1, 0]).round(12).tolist()
    [1.0, 0.0, 0.0]
    """
    angles = check_together(roll=roll, pitch=pitch, heading=heading)
    angles = np.array(np.broadcast_arrays(*angles))
    (sr, sp, sh), (cr, cp, ch) = np.sin(angles), np.cos(angles)
    rows = [
        [ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr],
        [-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr],
        [-cp * sr, sp, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@lru_cache(maxsize=256)
def fixed(roll: float, pitch: float, heading: float) -> np.ndarray:
    """Return :func:`rotations` of three angles, worked out once and not to be written.

    >>> (fixed(0.0, 0.0, 0.0) == np.eye(3)).all().item()
    True
    """
    found = rotations(roll, pitch, heading)
    found.flags.writeable = False
    return found


def turned(*, z: ArrayLike = 0.0, x: ArrayLike = 0.0, y: ArrayLike = 0.0) -> np.ndarray:
    """Return rotations (..., 3, 3) Rz(z) Rx(x) Ry(y), degrees, counter-clockwise positive.

    Examples
    --------
    >>> (turned(z=90) @ [1, 0, 0]).round(12).tolist()
    [0.0, 1.0, 0.0]
    """
    return rotations(np.radians(y), np.radians(x), -np.radians(z))


def across(axes: np.ndarray) -> np.ndarray:
    """Return two perpendicular unit vectors across each of n unit vectors (n, 3), shape (n, 2, 3).

    Examples
    --------
    >>> across(np.array([[0.0, 0.0, 1.0]])).tolist()
    [[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]]
    """
    helper = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)], axis=1)
