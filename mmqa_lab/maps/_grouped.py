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
def farthest(xyz, starts, chosen, centres, normals):
    """Largest distance of the points of each chosen group from a plane of its own."""
    most = np.zeros(len(chosen))
    for k in range(len(chosen)):
        for i in range(starts[chosen[k]], starts[chosen[k] + 1]):
            most[k] = max(most[k], abs(_along(xyz, i, centres[k], normals[k])))
    return most


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
def surface_squares(xyz, starts, index, face, centres, normals, extent, cell, side):
    """Squares where a patch's plane lies in it, and how many of those have a point, shape (m, 2).

    Of side x side squares on the face of each patch, those over whose centre the plane is within
    the patch's extent, shape (m, 2), along the axis across the face.
    """
    found = np.zeros((len(face), 2), np.int64)
    for g in range(len(face)):
        c = face[g]
        a, b = (0, 1) if c == 2 else (1 - c, 2)
        centre, normal = centres[g], normals[g]
        seen = np.zeros((side, side), np.bool_)
        for i in range(starts[g], starts[g + 1]):
            column = int((xyz[a, i] / cell - index[g, a]) * side)
            row = int((xyz[b, i] / cell - index[g, b]) * side)
            seen[min(max(column, 0), side - 1), min(max(row, 0), side - 1)] = True
        for column in range(side):
            for row in range(side):
                u = (index[g, a] + (column + 0.5) / side) * cell - centre[a]
                v = (index[g, b] + (row + 0.5) / side) * cell - centre[b]
                place = centre[c] - (normal[a] * u + normal[b] * v) / normal[c]
                if extent[g, 0] <= place <= extent[g, 1]:
                    found[g, 0] += 1
                    found[g, 1] += seen[column, row]
    return found


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
