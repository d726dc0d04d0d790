"""Marks of points: what is no point of a surface, and what of one is to be said."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mmqa_lab._checks import FARTHEST_M
from mmqa_lab.cloud import extent

__all__ = ["FLAGS", "Piece", "marked", "without_height"]

# Columns that tell which records are no points of a surface (LAS 1.4 R15).
FLAGS = ("withheld", "classification", "synthetic", "overlap", "return_number", "number_of_returns")

NOISE = (7, 18)
OLD_OVERLAP = 12

# Heights that stand for none; the first only if no other lies so near.
NO_DATA = (-999.0, -9999.0, -99999.0, -999999.0, -32767.0, -32768.0)
NEAR_M = 100.0

# As many records at 0, 0, 0 are no points, and a single one where the others lie this far away.
MOST_ZEROS = 10
FAR_FROM_ZERO_M = 1000.0


class Piece(NamedTuple):
    """A part of a file: its points, columns, ``about`` the cloud; points in all if these are not.

    ``left`` are masks of points to leave out by the reason, ``said`` of points to mention.
    """

    points: np.ndarray
    columns: dict
    about: Mapping = MappingProxyType({})
    total: int = 0
    left: Mapping = MappingProxyType({})
    said: Mapping = MappingProxyType({})


def marked(piece):
    """Masks of the points of a piece to leave out, and of those to mention, by the reason."""
    points, none = piece.points, np.zeros(1, np.uint8)
    numbers = {name.lower(): v for name, v in piece.columns.items() if v.dtype.kind in "biuf"}
    withheld, kind, synthetic, overlap, number, returns = (numbers.get(n, none) for n in FLAGS)
    several = number.max(initial=0) > 1 and ((number == 1) & (returns > 1)).any()
    old = kind == OLD_OVERLAP if "overlap" not in numbers else none
    left = {
        **piece.left,
        **_no_points(points),
        "are marked as withheld": withheld > 0,
        "are of a noise class, 7 or 18": (kind == NOISE[0]) | (kind == NOISE[1]),
    }
    said = {
        **piece.said,
        "are marked as synthetic": synthetic > 0,
        "are marked as overlap": (overlap > 0) | (old > 0),
        "are later returns of their pulses": (number > 1) & several,
    }
    whole = len(points)
    return [
        {why: np.broadcast_to(m, whole) for why, m in one.items() if m.any()}
        for one in (left, said)
    ]


def without_height(z):
    """Return whether heights stand for none, as -9999; -999, too, if no other is near it."""
    near = (np.abs(z - NO_DATA[0]) < NEAR_M) & (z != NO_DATA[0])
    return np.isin(z, NO_DATA[int(near.any()) :])


def _no_points(points):
    """Masks of rows that are not finite, and of those that stand for no point.

    These have -9999 and the like as height or as easting and northing, or 0, 0, 0 far from others.
    """
    if not len(points):
        return {}
    low, high = extent(points)
    inside = (low > -FARTHEST_M).all() and (high < FARTHEST_M).all()  # false for NaN
    if inside and low.min() > max(NO_DATA) and not ((low <= 0) & (high >= 0)).all():
        return {}
    finite = np.isfinite(points).all(axis=1)
    x, y, z = points.T
    none = without_height(z) | ((x == y) & np.isin(x, NO_DATA))
    none |= finite & (np.abs(points) > FARTHEST_M).any(axis=1)
    zeros = (points == 0).all(axis=1)
    others = points[finite & ~zeros & ~none]
    if zeros.any() and len(others):
        middle = np.median(others, axis=0)
        spread = np.median(np.abs(others - middle), axis=0)
        far = (np.abs(middle) > FAR_FROM_ZERO_M + 20 * spread).any()
        none |= zeros & (far or zeros.sum() > MOST_ZEROS)
    return {
        "are not finite": ~finite,
        "stand for no data (-9999 and the like, or 0, 0, 0 far from others)": none,
    }
