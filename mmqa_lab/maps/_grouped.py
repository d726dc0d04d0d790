"""Sums, medians and projections over groups of consecutive points, compiled.

Groups are ranges: group g holds the points starts[g]..starts[g + 1]. Sums run in the order of the
points, one after the other, so that a group's figure does not depend on what lies around it.
"""

import math

import numpy as np
from numba import njit

STEP = 2.0**-30
"""Rounding of coordinates in a plane, m: differences of rounded coordinates are exact."""


@njit(cache=True)
def centred_scatter(xyz, starts):
    """Mean (m, 3) and matrix of centred squares and products (m, 3, 3) of each group."""
    groups = len(starts) - 1
    centres, scatter = np.zeros((groups, 3)), np.zeros((groups, 3, 3))
    for g in range(groups):
        start, end = starts[g], starts[g + 1]
        corner = xyz[:, start]
        for a in range(3):
            total = 0.0
            for i in range(start, end):
                total += xyz[a, i] - corner[a]
            centres[g, a] = corner[a] + total / (end - start)
        for a in range(3):
            for b in range(a, 3):
                total = 0.0
                for i in range(start, end):
                    total += (xyz[a, i] - centres[g, a]) * (xyz[b, i] - centres[g, b])
                scatter[g, a, b] = total
                scatter[g, b, a] = total
    return centres, scatter


@njit(cache=True)
def signed_distances(xyz, starts, centres, normals):
    """Distance of each point along its group's normal."""
    heights = np.empty(xyz.shape[1])
    for g in range(len(starts) - 1):
        for i in range(starts[g], starts[g + 1]):
            heights[i] = _along(xyz, i, centres[g], normals[g])
    return heights


@njit(cache=True)
def group_medians(values, starts):
    """Median of each group's numbers, NaN left out; NaN where there are none."""
    medians = np.empty(len(starts) - 1)
    for g in range(len(medians)):
        known = values[starts[g] : starts[g + 1]]
        known = known[~np.isnan(known)]
        medians[g] = np.median(known) if len(known) else np.nan
    return medians


@njit(cache=True)
def group_mads(values, starts, medians):
    """Median distance of each group's numbers from the group's median."""
    mads = np.empty(len(medians))
    for g in range(len(medians)):
        mads[g] = np.median(np.abs(values[starts[g] : starts[g + 1]] - medians[g]))
    return mads


@njit(cache=True)
def occupied_squares(xyz, starts, index, face, cell, side):
    """Squares with a point, of side x side squares on the face of each group's cell."""
    occupied = np.zeros(len(face), np.int64)
    for g in range(len(face)):
        seen = np.zeros((side, side), np.bool_)
        a, b = (0, 1) if face[g] == 2 else (1 - face[g], 2)
        for i in range(starts[g], starts[g + 1]):
            column = int((xyz[a, i] / cell - index[g, a]) * side)
            row = int((xyz[b, i] / cell - index[g, b]) * side)
            seen[min(max(column, 0), side - 1), min(max(row, 0), side - 1)] = True
        occupied[g] = seen.sum()
    return occupied


@njit(cache=True)
def outline_patches(xyz, starts, chosen, centres, axes, thickness):
    """Outline (u low, u high, v low, v high) of each chosen patch's points near its plane."""
    outlines = np.empty((len(chosen), 4))
    for k in range(len(chosen)):
        c = chosen[k]
        outline = outlines[k]
        outline[0], outline[1], outline[2], outline[3] = np.inf, -np.inf, np.inf, -np.inf
        for i in range(starts[c], starts[c + 1]):
            if abs(_along(xyz, i, centres[c], axes[c, 2])) <= thickness:
                u = _along(xyz, i, centres[c], axes[c, 0])
                v = _along(xyz, i, centres[c], axes[c, 1])
                outline[0], outline[1] = min(outline[0], u), max(outline[1], u)
                outline[2], outline[3] = min(outline[2], v), max(outline[3], v)
    return outlines


@njit(cache=True)
def flatten(
    xyz, starts, ranges, chosen, centres, axes, margins, thickness, outlines, shift, xy, rows
):
    """Write the points near each chosen patch's plane, in its outline widened by the margin.

    ``rows`` gets the number of each point of the patch itself, -1 for those around it. Returns how
    many were written for each patch.
    """
    counts = np.zeros(len(chosen), np.int64)
    n = 0
    for k in range(len(chosen)):
        c, before = chosen[k], n
        for r in range(ranges.shape[1]):
            for i in range(ranges[k, r, 0], ranges[k, r, 1]):
                if abs(_along(xyz, i, centres[c], axes[c, 2])) > thickness:
                    continue
                u = _along(xyz, i, centres[c], axes[c, 0])
                v = _along(xyz, i, centres[c], axes[c, 1])
                if _is_within(u, v, outlines[k], margins[k]):
                    xy[n, 0], xy[n, 1] = _rounded(u) + shift[k], _rounded(v)
                    rows[n] = i if starts[c] <= i < starts[c + 1] else -1
                    n += 1
        counts[k] = n - before
    return counts


@njit(cache=True)
def _is_within(u, v, outline, margin):
    """Whether a place lies in the outline widened by the margin."""
    inside = (u >= outline[0] - margin) & (u <= outline[1] + margin)
    return inside & (v >= outline[2] - margin) & (v <= outline[3] + margin)


@njit(cache=True)
def _along(xyz, i, centre, axis):
    """Coordinate of a point along an axis from a centre."""
    dx, dy, dz = xyz[0, i] - centre[0], xyz[1, i] - centre[1], xyz[2, i] - centre[2]
    return dx * axis[0] + dy * axis[1] + dz * axis[2]


@njit(cache=True)
def _rounded(value):
    return math.floor(value / STEP + 0.5) * STEP
