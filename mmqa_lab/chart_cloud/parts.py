"""A part of a surface that stands off the rest and turns the regression plane."""

from __future__ import annotations

import numpy as np

from mmqa_lab.planes import checked_plane, sigma_mad

__all__ = ["part_off", "remark_on_part"]

OFF_SIGMAS = 4.0
"""Points farther than so many sigma_MAD from the plane of most points stand off it."""

OFF_SHARES = 0.01, 0.3
"""Least and largest share of such points: fewer are strays, more are a layer."""

MISLED = 1.1
"""Ratio of sigma_MAD with and without such points from which they mislead the plane."""

MOST_FITTED = 10_000
"""Points that the plane of most points is fitted to."""


def part_off(points, scale, step_mm=0.0):
    """The mask of the points that mislead the regression plane, and the plane of the others.

    The plane of most points is the robust one; without such points the plane is None. Within two
    steps of the coordinates no point stands off.
    """
    plane = checked_plane(points[:: 1 + len(points) // MOST_FITTED], robust=True)
    away = plane.distances(points)
    least = max(OFF_SIGMAS * sigma_mad(away, scale), 0.002 * step_mm)
    off = np.abs(away - np.median(away)) > least
    if not OFF_SHARES[0] <= off.mean() <= OFF_SHARES[1]:
        return np.zeros(len(points), dtype=bool), None
    return off, checked_plane(points[~off])


def remark_on_part(points, plane, sigma_mm, scale, step_mm):
    """A remark if a part that stands off turns the regression plane or widens sigma_MAD."""
    off, without = part_off(points, scale, step_mm)
    if without is None:
        return ()
    alone_mm = 1000 * sigma_mad(without.residuals, scale)
    if sigma_mm <= MISLED * alone_mm + 1e-6:
        return ()
    turn = np.degrees(np.arccos(min(1.0, abs(plane.normal @ without.normal))))
    return (
        f"{off.sum()} points ({100 * off.mean():.2g} %) stand off the others and turn the plane by "
        f"{turn:.2g} degrees: sigma_MAD is {sigma_mm:.1f} mm with them, {alone_mm:.1f} mm without.",
    )
