"""The component method of ITC (University of Twente).

The cloud is clipped to a corridor, planar segments are grown and roughly classed (ground, wall,
raised), what is left above ground falls into connected components, and each component is cut into
horizontal slices whose enclosing rectangles are compared up the stack (EuroSDR 2013, chapter 4; Pu
et al. 2011, ISPRS Journal 66, S28-S39, doi:10.1016/j.isprsjprs.2011.08.006). No scan lines needed.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from mmqa_lab.poles.table import drop_duplicates, first_reason, pole_table
from mmqa_lab.poles.walls import RAISED, cells, joined, rough_classes, touching

TURNS = 18
"""Directions tried for the enclosing rectangle, 5 degrees apart."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Thresholds of the component method. All values are ours: the papers' were not at hand.

    Parameters
    ----------
    corridor : float
        Points farther from the trajectory are left out, metres (15 m in Table 4-2).
    plane_cell : float
        Cells in which seed planes are fitted and over which they grow, metres.
    plane_thickness : float
        Largest root mean square distance of a cell's points from its plane, metres.
    plane_angle, plane_offset : float
        Neighbouring cells belong to one plane when their normals differ less (degrees) and their
        centres lie nearer to each other's plane (m).
    wall_length, wall_height : float
        Least extent of an upright plane that is a wall, metres.
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
    crown_width : float
        A component wider than this above its pole-like part is a tree, metres.
    """

    corridor: float = 15.0
    plane_cell: float = 0.4
    plane_thickness: float = 0.03
    plane_angle: float = 12.0
    plane_offset: float = 0.10
    wall_length: float = 1.5
    wall_height: float = 2.0
    ground_height: float = 0.3
    link_distance: float = 0.25
    slice_height: float = 0.3
    maximum_rectangle: float = 0.6
    shift: float = 0.15
    growth: float = 0.25
    minimum_length: float = 1.0
    missing_slices: int = 1
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
        See :func:`mmqa_lab.poles.detect`; with ``is_tree``: a wide crown above the stack.
    """
    rough = rough_classes(points, settings)
    component = components(points, rough == RAISED, settings.link_distance)
    kept = component >= 0
    stacks = _stacks(points[kept], component[kept], settings)
    reason = first_reason(
        len(stacks["length"]),
        slices=stacks["slices"] < 2,
        length=stacks["length"] < settings.minimum_length,
    )
    table = {name: stacks[name] for name in ("x_m", "y_m", "z_base_m", "lean_x", "lean_y")}
    table |= {"height_m": stacks["length"], "diameter_m": stacks["diameter"]}
    table |= {"score": stacks["regularity"], "rejected_by": reason}
    drop_duplicates(table, 2 * settings.shift)
    return pole_table(table | {"is_tree": stacks["is_tree"]}, "itc", explain=explain)


def components(points, chosen, link_distance):
    """Return the connected component of each chosen point, -1 for the others."""
    component = np.full(len(points), -1)
    if chosen.any():
        cell, index = cells(points[chosen], link_distance)
        component[chosen] = joined(*touching(index), len(index))[cell]
    return component


@njit(cache=True)
def _rectangle(xy):
    """Centre and diagonal of the smallest enclosing rectangle among ``TURNS`` directions."""
    best, cx, cy, diagonal = np.inf, 0.0, 0.0, 0.0
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
            diagonal = np.sqrt(width * width + depth * depth)
    return cx, cy, diagonal


@njit(cache=True)
def _rectangles(xy, first):
    """Centre and diagonal of the rectangle of each run of points, (k, 3)."""
    out = np.empty((len(first) - 1, 3))
    for k in range(len(first) - 1):
        out[k] = _rectangle(xy[first[k] : first[k + 1]])
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
    out["diameter"][k] = np.median(stack[:, 2])
    out["slices"][k] = end - begin
    out["regularity"][k] = (end - begin) / len(level)
    above = rectangle[end:, 2]
    out["is_tree"][k] = bool(len(above) and above.max() > settings.crown_width)
