"""The component method of ITC (University of Twente).

The cloud is clipped to a corridor, planar segments are grown and roughly classed (ground, wall,
raised), what is left above ground falls into connected components, and each component is cut into
horizontal slices whose enclosing rectangles are compared up the stack (EuroSDR 2013, chapter 4; Pu
et al. 2011, ISPRS Journal 66, S28-S39, doi:10.1016/j.isprsjprs.2011.08.006). No scan lines needed.

It differs from section 4.2 of the report: the ground comes from the lowest points and not from
segments and their connectivity; walls are removed before components are formed, not the ground
alone (``only_ground`` does as the report); trees are recognised by the width of their crown, not by
the shapes of sub-components, and signs are not distinguished from other poles.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from mmqa_lab._compiled import in_threads
from mmqa_lab.poles import common

GROUND, WALL, RAISED = 0, 1, 2
"""Rough classes: ground, wall, and everything that is neither."""

LEAST_VOTES = 8
"""Points of a cell that are enough for a Hough transform."""

DIRECTIONS = 200
"""Normals of the planes that each point votes for."""

TURNS = 18
"""Directions tried for the enclosing rectangle, 5 degrees apart."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Thresholds of the component method. All values are ours: the report prints none.

    Parameters
    ----------
    plane_cell : float
        Cells in which seed planes are fitted and over which they grow, metres.
    plane_thickness : float
        Largest root mean square distance of a cell's points from its plane, metres.
    plane_angle, plane_offset : float
        Neighbouring cells belong to one plane when their normals differ less (degrees) and their
        centres lie nearer to each other's plane (m).
    wall_length, wall_height : float
        Least extent of an upright plane that is a wall, metres.
    only_ground : bool
        Components are formed of all that is not ground, walls included, as in section 4.2.
    ground_height : float
        Points lower above the ground belong to it, metres.
    link_distance : float
        Cells of that size that touch are connected, metres.
    slice_height : float
        Metres.
    maximum_rectangle : float
        Longest diagonal of a pole-like slice's enclosing rectangle, metres.
    shift : float
        Largest distance between the centres of rectangles of consecutive slices, metres.
    growth : float
        Largest difference of their diagonals, metres.
    minimum_length : float
        Of consecutive pole-like slices, metres.
    missing_slices : int
        Empty slices that do not end a stack.
    highest_foot : float
        Above the ground; what begins higher is refused, metres. The report removes the ground and
        asks for no foot, so that by default a hanging component passes.
    crown_width : float
        A component wider than this above its pole-like part is a tree, metres.
    """

    plane_cell: float = 0.4
    plane_thickness: float = 0.03
    plane_angle: float = 12.0
    plane_offset: float = 0.10
    wall_length: float = 1.5
    wall_height: float = 2.0
    only_ground: bool = False
    ground_height: float = 0.3
    link_distance: float = 0.25
    slice_height: float = 0.3
    maximum_rectangle: float = 0.6
    shift: float = 0.15
    growth: float = 0.25
    minimum_length: float = 1.0
    missing_slices: int = 1
    highest_foot: float = np.inf
    crown_width: float = 1.2


def detect(points, settings, *, explain=False):
    """Return the poles of a cloud that is already clipped to the corridor.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    settings : Settings
    explain : bool

    Returns
    -------
    DataFrame
        See :func:`mmqa_lab.poles.detect`; the diameter is the longer side of the rectangle; with
        ``is_tree``: a wide crown above the stack.
    """
    rough = rough_classes(points, settings)
    chosen = rough != GROUND if settings.only_ground else rough == RAISED
    component = components(points, chosen, settings.link_distance)
    kept = component >= 0
    stacks = _stacks(points[kept], component[kept], settings)
    reason = common.first_reason(
        len(stacks["length"]),
        slices=stacks["slices"] < 2,
        length=stacks["length"] < settings.minimum_length,
    )
    table = {name: stacks[name] for name in ("x_m", "y_m", "z_base_m", "lean_x", "lean_y")}
    table |= {"height_m": stacks["length"], "diameter_m": stacks["diameter"]}
    table |= {"score": stacks["regularity"], "rejected_by": reason}
    common.drop_hanging(table, points, settings.highest_foot)
    common.drop_duplicates(table, 2 * settings.shift)
    return common.pole_table(table | {"is_tree": stacks["is_tree"]}, "itc", explain=explain)


def components(points, chosen, link_distance):
    """Return the connected component of each chosen point, -1 for the others."""
    component = np.full(len(points), -1)
    if chosen.any():
        cell, index = common.cells(points[chosen], link_distance)
        component[chosen] = common.joined(*_touching(index).T, len(index))[cell]
    return component


@njit(cache=True)
def _rectangle(xy):
    """Centre, diagonal and longer side of the smallest enclosing rectangle of ``TURNS`` ones."""
    best, cx, cy, diagonal, longer = np.inf, 0.0, 0.0, 0.0, 0.0
    for k in range(TURNS):
        turn = 0.5 * np.pi * k / TURNS
        c, s = np.cos(turn), np.sin(turn)
        u_low, u_high, v_low, v_high = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(xy)):
            u, v = c * xy[i, 0] + s * xy[i, 1], c * xy[i, 1] - s * xy[i, 0]
            u_low, u_high = min(u_low, u), max(u_high, u)
            v_low, v_high = min(v_low, v), max(v_high, v)
        width, depth = u_high - u_low, v_high - v_low
        if (width + 1e-3) * (depth + 1e-3) < best:
            best = (width + 1e-3) * (depth + 1e-3)
            u, v = (u_low + u_high) / 2, (v_low + v_high) / 2
            cx, cy = c * u - s * v, s * u + c * v
            diagonal, longer = np.sqrt(width * width + depth * depth), max(width, depth)
    return cx, cy, diagonal, longer


@njit(cache=True)
def _rectangles(xy, first):
    """Centre, diagonal and longer side of the rectangle of each run of points, (k, 4)."""
    out = np.empty((len(first) - 1, 4))
    for k in range(len(first) - 1):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = _rectangle(xy[first[k] : first[k + 1]])
    return out


@njit(cache=True)
def _longest(level, rectangle, largest, shift, growth, missing):
    """First and last of the longest stack of similar small rectangles; (0, 0) for none."""
    best_first, best_last, n = 0, 0, len(level)
    k = 0
    while k < n:
        if rectangle[k, 2] > largest:
            k += 1
            continue
        j = k
        while j + 1 < n and level[j + 1] - level[j] <= missing + 1:
            nearer = np.hypot(
                rectangle[j + 1, 0] - rectangle[j, 0], rectangle[j + 1, 1] - rectangle[j, 1]
            )
            similar = abs(rectangle[j + 1, 2] - rectangle[j, 2]) <= growth
            if rectangle[j + 1, 2] > largest or nearer > shift or not similar:
                break
            j += 1
        if best_last == 0 or level[j] - level[k] > level[best_last - 1] - level[best_first]:
            best_first, best_last = k, j + 1
        k = j + 1
    return best_first, best_last


def _stacks(points, component, settings):
    """What the stack of slices of each component says."""
    names = ("x_m", "y_m", "z_base_m", "lean_x", "lean_y", "length", "diameter", "slices")
    n = component.max(initial=-1) + 1
    out = {name: np.zeros(n) for name in names}
    out |= {"regularity": np.zeros(n), "is_tree": np.zeros(n, dtype=bool)}
    if n == 0:
        return out
    level = np.floor((points[:, 2] - points[:, 2].min()) / settings.slice_height).astype(np.int64)
    order = np.lexsort([level, component])
    points, component, level = points[order], component[order], level[order]
    first = np.flatnonzero(np.diff(component, prepend=-1) | np.diff(level, prepend=-1))
    rectangle = _rectangles(np.ascontiguousarray(points[:, :2]), np.append(first, len(points)))
    owner, levels = component[first], level[first]
    starts = np.searchsorted(owner, np.arange(n + 1))
    limits = (settings.maximum_rectangle, settings.shift, settings.growth, settings.missing_slices)
    for k in range(n):
        part = slice(starts[k], starts[k + 1])
        begin, end = _longest(levels[part], rectangle[part], *limits)
        if end > begin:
            _describe(out, k, levels[part], rectangle[part], begin, end, settings)
    out["z_base_m"] += points[:, 2].min()
    return out


def _describe(out, k, level, rectangle, begin, end, settings):
    """Write the stack of slices begin..end of component ``k``."""
    size, stack = settings.slice_height, rectangle[begin:end]
    height = (level[begin:end] + 0.5) * size
    middle = (height[0] + height[-1]) / 2
    for axis, name in enumerate("xy"):
        slope, value = 0.0, np.median(stack[:, axis])
        if end - begin > 2:
            slope, value = np.polyfit(height - middle, stack[:, axis], 1)
        out[f"{name}_m"][k], out[f"lean_{name}"][k] = value, slope
    out["z_base_m"][k] = level[begin] * size
    out["length"][k] = (level[end - 1] - level[begin] + 1) * size
    out["diameter"][k] = np.median(stack[:, 3])
    out["slices"][k] = end - begin
    out["regularity"][k] = (end - begin) / len(level)
    above = rectangle[end:, 2]
    out["is_tree"][k] = bool(len(above) and above.max() > settings.crown_width)


def rough_classes(points, settings):
    """Return GROUND, WALL or RAISED for each point.

    Planes are fitted to the points of each cell and grown over neighbouring cells whose planes
    agree; upright ones that are long and high enough are walls. The ground is what lies low above
    the ground's own model.

    Parameters
    ----------
    points : array, shape (n, 3)
    settings : Settings

    Returns
    -------
    array of int8, shape (n,)
    """
    rough = np.full(len(points), RAISED, dtype=np.int8)
    if not len(points):
        return rough
    height = common.fit_ground(points).height(points)
    segment, normal, extent = planar_segments(points, settings)
    upright = np.abs(normal[:, 2]) < np.sin(np.radians(15))
    wall = upright & (extent[:, 0] >= settings.wall_length) & (extent[:, 1] >= settings.wall_height)
    inside = segment >= 0
    rough[inside] = np.where(wall[segment[inside]], WALL, RAISED)
    rough[height < settings.ground_height] = GROUND
    return rough


def planar_segments(points, settings):
    """Grow planar segments over cells, from seeds that a Hough transform finds.

    A cell whose points lie on one plane is its own seed. In the others every point votes for the
    planes through it, and the plane with the most votes is the seed, without the points off it.

    Parameters
    ----------
    points : array, shape (n, 3)
    settings : Settings

    Returns
    -------
    segment : array of int, shape (n,)
        Segment of each point, -1 where it lies on no plane of its cell.
    normal : array, shape (k, 3)
        Of each segment.
    extent : array, shape (k, 2)
        Horizontal diagonal and height of each segment, metres.

    Notes
    -----
    A Hough transform and not RANSAC: it tries all directions, so that the same cloud in another
    order gives the same segments, and a cell of 0.4 m needs few (8 degrees apart, then least
    squares).
    """
    cell, index = common.cells(points, settings.plane_cell)
    off = points - (index[cell] + 0.5) * settings.plane_cell - points.min(axis=0)
    on = np.ones(len(points), dtype=bool)
    count, centre, values, normals = _planes(off, cell, on)
    thick = ~_is_flat(count, values, settings) & (count >= LEAST_VOTES)
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(len(index) + 1))
    sorted_on = np.ones(len(points), dtype=bool)
    sorted_off = (off[order], start, thick, _directions(), settings.plane_thickness)
    in_threads(_on_seeds, len(thick), *sorted_off, sorted_on)
    on[order] = sorted_on
    count, centre, values, normals = _planes(off, cell, on)
    centre += (index + 0.5) * settings.plane_cell
    flat = _is_flat(count, values, settings)
    a, b = _touching(index).T
    linked = flat[a] & flat[b] & _agree(centre, normals, a, b, settings)
    part = common.joined(a[linked], b[linked], len(count))
    largest = np.lexsort([-count, part])
    first = largest[np.unique(part[largest], return_index=True)[1]]
    extent = _extents(centre[flat], part[flat], part.max(initial=-1) + 1)
    return np.where(flat[cell] & on, part[cell], -1), normals[first], extent


def _planes(off, cell, on):
    """Count, centre, variances (rising) and normal of the chosen points of each cell."""
    count, centre, covariance = common.moments(off[on], cell[on], int(cell.max()) + 1)
    values, vectors = np.linalg.eigh(covariance)
    return count, centre, values, vectors[:, :, 0]


def _is_flat(count, values, settings):
    """Whether the points of cells with these variances lie on a plane and not on a line."""
    thick = np.sqrt(np.maximum(values[:, 0], 0))
    flat = (count >= 4) & (thick < settings.plane_thickness) & (values[:, 1] > 4 * values[:, 0])
    return flat & (values[:, 1] > (settings.plane_cell / 10) ** 2)


def _agree(centre, normals, a, b, settings):
    """Whether the planes of cells a and b continue each other."""
    joint = centre[b] - centre[a]
    near = np.abs(np.einsum("ij,ij->i", joint, normals[a])) < settings.plane_offset
    near &= np.abs(np.einsum("ij,ij->i", joint, normals[b])) < settings.plane_offset
    cosine = np.abs(np.einsum("ij,ij->i", normals[a], normals[b]))
    return near & (cosine > np.cos(np.radians(settings.plane_angle)))


def _directions():
    """Normals over the half sphere, a spiral about 8 degrees apart."""
    z = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(DIRECTIONS)
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


@njit(cache=True, nogil=True)
def _on_seeds(begin, end, off, start, thick, directions, thickness, on):
    """Which points, sorted by cell, lie on the seed plane of their cell; all of those not thick."""
    for c in range(begin, end):
        if thick[c]:
            _seed(off[start[c] : start[c + 1]], directions, thickness, on[start[c] : start[c + 1]])


@njit(cache=True)
def _seed(part, directions, thickness, on):
    """Write which points lie on the plane with the most votes."""
    most, best, best_bin, farthest = 0, 0, 0, 0.0
    for k in range(len(part)):
        farthest = max(farthest, part[k, 0] ** 2 + part[k, 1] ** 2 + part[k, 2] ** 2)
    reach = int(math.sqrt(farthest) / (2 * thickness)) + 1
    votes = np.empty(2 * reach + 1, np.int64)
    for d in range(len(directions)):
        for top in range(len(votes)):
            votes[top] = 0
        for k in range(len(part)):
            away = _along(part, k, directions, d)
            votes[math.floor(away / (2 * thickness)) + reach] += 1
        for top in range(len(votes)):
            if votes[top] > most:
                most, best, best_bin = votes[top], d, top
    middle = (best_bin - reach + 0.5) * 2 * thickness
    for k in range(len(part)):
        on[k] = abs(_along(part, k, directions, best) - middle) <= 2 * thickness


@njit(cache=True)
def _along(points, k, directions, d):
    """Coordinate of a point along a direction."""
    x, y, z = points[k, 0], points[k, 1], points[k, 2]
    return x * directions[d, 0] + y * directions[d, 1] + z * directions[d, 2]


def _extents(centre, part, n):
    """Horizontal diagonal and height of the cells of each part."""
    low, high = common.extremes(centre, part, n)
    size = np.maximum(high - low, 0)
    return np.column_stack([np.hypot(size[:, 0], size[:, 1]), size[:, 2]])


def _touching(index):
    """Pairs (k, 2) of occupied cells that share a face, an edge or a corner."""
    return cKDTree(index).query_pairs(1.5, p=np.inf, output_type="ndarray")
