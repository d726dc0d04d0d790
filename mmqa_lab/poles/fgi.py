"""The scan-line method of the Finnish Geodetic Institute (FGI).

Scan lines are cut into short groups, groups of neighbouring lines that lie over each other form
clusters, coaxial clusters are merged, and a mask of two coaxial cylinders, dense inside and almost
empty between, is moved along each cluster (EuroSDR 2013, chapter 4; Lehtomaki et al. 2010,
doi:10.3390/rs2030641; 2011, ISPRS Archives XXXVIII-5/W12).

It differs from section 4.1 of the report: the inner cylinder has one radius, with a limit, for a
whole cluster; shape and orientation are tested for the cluster and not at each step of the mask;
the longest unbroken stretch that the mask accepts is the pole, not all accepted points together.
With ``as_worded`` the mask does what the report says. In both, duplicates are dropped, and points
of low intensity and isolated points, which section 3.1.3.2 removes, are kept.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from mmqa_lab.poles import common

BIN_M = 0.1
"""Resolution along the axis at which the mask counts points."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Thresholds of the scan-line method.

    The report states the shell of the mask (0.2-0.8 m, as an example), the mask's length (at most
    the least length) and the least length (1 m). The other values are ours: the report prints none.

    Parameters
    ----------
    segment_distance : float
        Two consecutive points of a line farther apart belong to two groups, metres.
    segment_gap : int
        So do points with more missing pulses between them.
    minimum_points : int
        Of a group.
    maximum_width : float
        Longest group, metres.
    overlap : float
        Groups may miss each other in plan by that much and still overlap, metres.
    neighbours : int
        Lines up to so many apart are neighbouring.
    merge_distance, merge_angle, merge_gap : float
        Clusters are coaxial when their axes are nearer (m), more parallel (degrees) and the gap
        along them is smaller (m).
    minimum_length : float
        Of a pole, metres (stated: 1 m).
    minimum_sweeps : int
        Scan lines that meet it.
    maximum_tilt : float
        Degrees from the vertical.
    elongation : float
        Least ratio of the largest to the second eigenvalue.
    mask_length, mask_step : float
        Of the moving mask, metres; the length is at most ``minimum_length``.
    maximum_radius : float
        Of the inner cylinder, metres; the report has no such limit.
    shell : float
        Outer minus inner radius, metres (stated: 0.2 to 0.8).
    mask_share : float
        Least share of the points in both cylinders that lie in the inner one.
    as_worded : bool
        The mask of section 4.1: at each step the inner cylinder is the smallest around the
        cluster's points, what lies in it must be upright and elongated, and all points accepted
        anywhere are one pole.
    mask_elongation : float
        Least ratio of eigenvalues of what lies in the mask, where it is as worded.
    highest_foot : float
        Above the ground; what begins higher is refused, metres. The report asks for no foot (cars
        hide it), so that by default a hanging cylinder passes.
    circle_fit : bool
        Diameters from circles fitted to slices instead of from chords. The report does not say how
        it measures diameters.
    """

    segment_distance: float = 0.10
    segment_gap: int = 2
    minimum_points: int = 3
    maximum_width: float = 0.45
    overlap: float = 0.03
    neighbours: int = 2
    merge_distance: float = 0.20
    merge_angle: float = 12.0
    merge_gap: float = 2.0
    minimum_length: float = 1.0
    minimum_sweeps: int = 4
    maximum_tilt: float = 15.0
    elongation: float = 10.0
    mask_length: float = 0.8
    mask_step: float = 0.2
    maximum_radius: float = 0.35
    shell: float = 0.30
    mask_share: float = 0.85
    as_worded: bool = False
    mask_elongation: float = 4.0
    highest_foot: float = np.inf
    circle_fit: bool = False


def detect(points, settings, *, lines, explain=False):
    """Return the poles of an ordered cloud.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    settings : Settings
    lines : pair of array, shape (n,)
        Scan line, and number of the pulse along it.
    explain : bool
        Return all candidates with the test that rejected them.

    Returns
    -------
    DataFrame
        See :func:`mmqa_lab.poles.detect`.
    """
    order = np.lexsort(lines[::-1])
    points, line, pulse = points[order], lines[0][order], lines[1][order]
    group, groups = segment_lines(points, line, pulse, settings)
    cluster = np.append(_clusters(groups, settings), -1)
    member = cluster[group]  # -1, no group, takes the last: no cluster
    member = _merged(points, member, settings)
    kept = member >= 0
    found = _features(points[kept], line[kept], member[kept])
    return _judged(points, points[kept], line[kept], member[kept], found, settings, explain)


def segment_lines(points, line, pulse, settings):
    """Cut sorted scan lines into groups.

    Returns
    -------
    group : array of int, shape (n,)
        Group of each point, -1 where it was dropped as too long or too small.
    groups : dict of str to array
        ``centre`` (k, 3), ``half`` (k,) half the chord and ``line`` (k,) of each group kept.
    """
    if not len(points):
        return np.empty(0, np.int64), {"centre": np.empty((0, 3)), "half": np.empty(0)}
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > settings.segment_distance
    broken = apart | (np.diff(line) != 0) | (np.diff(pulse) > settings.segment_gap + 1)
    first = np.concatenate([[0], np.flatnonzero(broken) + 1])
    count = np.diff(np.append(first, len(points)))
    last = first + count - 1
    chord = np.linalg.norm(points[last] - points[first], axis=1)
    good = (count >= settings.minimum_points) & (chord <= settings.maximum_width)
    number = np.where(good, np.cumsum(good) - 1, -1)
    centre = np.add.reduceat(points, first, axis=0) / count[:, None]
    kept = {"centre": centre[good], "half": chord[good] / 2, "line": line[first][good]}
    return np.repeat(number, count), kept


def _clusters(groups, settings):
    """Number of the cluster of each group: groups that overlap in plan on neighbouring lines."""
    n = len(groups["half"])
    if n == 0:
        return np.empty(0, np.int64)
    reach = settings.maximum_width + settings.overlap
    lines = (groups["line"] - groups["line"].min()) * (reach / (settings.neighbours + 0.5))
    tree = cKDTree(np.column_stack([groups["centre"][:, :2], lines]))
    pairs = tree.query_pairs(reach, p=np.inf, output_type="ndarray")
    a, b = pairs.T
    distance = np.hypot(*(groups["centre"][a, :2] - groups["centre"][b, :2]).T)
    half = groups["half"][a] + groups["half"][b]
    linked = (groups["line"][a] != groups["line"][b]) & (distance <= half + settings.overlap)
    return common.joined(a[linked], b[linked], n)


def _features(points, line, member):
    """Axis, length, eigenvalue ratio and sweeps of each cluster, and its radius about the axis."""
    n = member.max(initial=-1) + 1
    count, centre, covariance = common.moments(points, member, n)
    values, vectors = np.linalg.eigh(covariance)
    direction = vectors[:, :, 2] * np.where(vectors[:, 2, 2] < 0, -1.0, 1.0)[:, None]
    off = points - centre[member]
    along = np.einsum("ij,ij->i", off, direction[member])
    low, high = common.extremes(along, member, n)
    across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0))
    spread = np.bincount(member, across) / count
    _, radius = common.extremes(np.where(across <= 3 * spread[member], across, 0), member, n)
    seen = np.unique(np.stack([member, line]), axis=1)[0]
    return {
        "centre": centre,
        "direction": direction,
        "length": high - low,
        "low": low,
        "ratio": values[:, 2] / np.maximum(values[:, 1], 1e-12),
        "sweeps": np.bincount(seen, minlength=len(count)),
        "radius": radius,
    }


def _merged(points, member, settings):
    """Members with coaxial close clusters made one; clusters of one line are dropped."""
    kept = np.flatnonzero(member >= 0)
    if not len(kept):
        return member
    n = member.max() + 1
    count, centre, covariance = common.moments(points[kept], member[kept], n)
    low, high = common.extremes(points[kept, 2], member[kept], n)
    direction = np.linalg.eigh(covariance)[1][:, :, 2]
    direction *= np.where(direction[:, 2] < 0, -1.0, 1.0)[:, None]
    tall = np.flatnonzero(high - low >= 2 * BIN_M)
    reach = settings.merge_distance + np.tan(np.radians(settings.merge_angle)) * settings.merge_gap
    pairs = cKDTree(centre[tall, :2]).query_pairs(reach, output_type="ndarray")
    a, b = tall[pairs[:, 0]], tall[pairs[:, 1]]
    gap = np.maximum(low[a], low[b]) - np.minimum(high[a], high[b])
    linked = _coaxial(centre, direction, high - low, a, b, settings) & (gap <= settings.merge_gap)
    part = common.joined(a[linked], b[linked], len(count))
    result = np.full(len(member), -1)
    use = (high - low >= 2 * BIN_M)[member[kept]]
    result[kept[use]] = np.unique(part[member[kept[use]]], return_inverse=True)[1]
    return result


def _coaxial(centre, direction, length, a, b, settings):
    """Whether the axes of clusters a and b agree half way between them."""
    half = (centre[b, 2] - centre[a, 2]) / 2
    slope = direction[:, :2] / np.maximum(direction[:, 2:], 0.5)
    slope = np.where((length >= 0.5)[:, None], slope, 0.0)
    apart = centre[a, :2] + slope[a] * half[:, None] - centre[b, :2] + slope[b] * half[:, None]
    cosine = np.einsum("ij,ij->i", direction[a], direction[b])
    parallel = cosine >= np.cos(np.radians(settings.merge_angle))
    short = np.minimum(length[a], length[b]) < 0.5
    return (np.hypot(*apart.T) <= settings.merge_distance) & (parallel | short)


@njit(cache=True)
def _mask_counts(points, start, first, centre, direction, reach, radius, shell, inner, outer):
    """Points per bin along an axis within the inner cylinder and within the shell around it."""
    n_bins = len(inner)
    slope = np.sqrt(direction[0] ** 2 + direction[1] ** 2) / max(direction[2], 0.1)
    plan = radius + shell + slope * max(abs(reach), abs(reach + n_bins * BIN_M))
    near = common.near_axis(points, start, first, centre[0], centre[1], plan)
    for i in near:
        x = points[i, 0] - centre[0]
        y = points[i, 1] - centre[1]
        z = points[i, 2] - centre[2]
        along = x * direction[0] + y * direction[1] + z * direction[2]
        k = int(np.floor((along - reach) / BIN_M))
        if 0 <= k < n_bins:
            across = np.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
            if across <= radius:
                inner[k] += 1
            elif across <= radius + shell:
                outer[k] += 1


def _mask(sorted_points, found, k, settings):
    """The longest stretch (from, to) along axis ``k`` that the mask accepts, and its share."""
    low, n_bins = found["low"][k], max(int(np.ceil(found["length"][k] / BIN_M)), 1)
    inner, outer = np.zeros(n_bins, np.int64), np.zeros(n_bins, np.int64)
    radius = found["radius"][k] + 0.02
    axis = (found["centre"][k], found["direction"][k], low, radius, settings.shell)
    _mask_counts(*sorted_points[:3], *axis, inner, outer)
    width = max(round(min(settings.mask_length, settings.minimum_length) / BIN_M), 1)
    step = max(round(settings.mask_step / BIN_M), 1)
    accepted = np.zeros(n_bins, dtype=bool)
    for begin in range(0, max(n_bins - width, 0) + 1, step):
        dense, empty = inner[begin : begin + width].sum(), outer[begin : begin + width].sum()
        if dense >= settings.minimum_points and dense >= settings.mask_share * (dense + empty):
            accepted[begin : begin + width] = True
    edges = np.flatnonzero(np.diff(accepted, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        return np.nan, np.nan, 0.0
    begin, end = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    dense, empty = inner[begin:end].sum(), outer[begin:end].sum()
    return low + begin * BIN_M, low + end * BIN_M, float(dense / (dense + empty))


def _about(points, centre, direction):
    """Distances of points along an axis and across it."""
    off = points - centre
    along = off @ direction
    return along, np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0))


def _mask_as_worded(sorted_points, own, line, axis, settings):
    """Ends of all points of a cluster that the moving mask accepts, and their share; NaN where they
    are too few lines."""
    centre, direction = axis
    along, across = _about(own, centre, direction)
    slope = np.hypot(*direction[:2]) / max(direction[2], 0.1)
    reach = across.max() + settings.shell + slope * np.abs(along).max()
    near = sorted_points[0][common.near_axis(*sorted_points[:3], *centre[:2], reach)]
    near_along, near_across = _about(near, centre, direction)
    length = min(settings.mask_length, settings.minimum_length)
    accepted, shares = np.zeros(len(own), dtype=bool), []
    for begin in np.arange(along.min(), along.max() - length + 1e-9, settings.mask_step):
        part = (along >= begin) & (along <= begin + length)
        if part.sum() < settings.minimum_points:
            continue
        between = (near_along >= begin) & (near_along <= begin + length)
        radius = across[part].max() + 1e-6
        inside = between & (near_across <= radius)
        share = inside.sum() / (between & (near_across <= radius + settings.shell)).sum()
        if share >= settings.mask_share and _is_upright(near[inside], settings):
            accepted |= part
            shares.append(share)
    if len(np.unique(line[accepted])) < settings.minimum_sweeps:
        return np.nan, np.nan, 0.0
    return along[accepted].min(), along[accepted].max(), float(np.mean(shares))


def _is_upright(points, settings):
    """Whether points have the orientation and the shape of a pole."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    tilt = np.degrees(np.arccos(min(abs(vectors[2, 2]), 1.0)))
    elongated = values[2] >= settings.mask_elongation * values[1]
    return elongated and tilt <= settings.maximum_tilt


def _judged(everything, points, line, member, found, settings, explain):
    """The table of clusters, judged by features and mask."""
    n = len(found["length"])
    tilt = np.degrees(np.arccos(np.clip(found["direction"][:, 2], -1, 1)))
    failed = {
        "length": found["length"] < settings.minimum_length,
        "sweeps": found["sweeps"] < settings.minimum_sweeps,
        "tilt": tilt > settings.maximum_tilt,
        "elongation": found["ratio"] < settings.elongation,
        "width": (found["radius"] > settings.maximum_radius) & (not settings.as_worded),
    }
    reason = common.first_reason(n, **failed)
    stretch = np.column_stack([found["low"], found["low"] + found["length"]])
    share = np.zeros(n)
    sorted_points = common.rows(everything) if (reason == "").any() else None
    for k in np.flatnonzero(reason == ""):
        if settings.as_worded:
            own, axis = member == k, (found["centre"][k], found["direction"][k])
            ends = _mask_as_worded(sorted_points, points[own], line[own], axis, settings)
        else:
            ends = _mask(sorted_points, found, k, settings)
        begin, end, share[k] = ends
        if not end - begin >= settings.minimum_length - 1e-9:
            reason[k] = "mask"
        else:
            stretch[k] = begin, end
    low, high = (found["centre"] + part[:, None] * found["direction"] for part in stretch.T)
    lean = found["direction"][:, :2] / np.maximum(found["direction"][:, 2:], 1e-6)
    height = high[:, 2] - low[:, 2]
    middle = low[:, :2] + lean * height[:, None] / 2
    table = common.axis_rows(middle, low[:, 2], lean, height)
    table |= {"score": share, "rejected_by": reason}
    common.drop_hanging(table, everything, settings.highest_foot)
    fit = common.circle_diameter if settings.circle_fit else common.shaft_diameter
    table["diameter_m"] = _diameters(points, line, member, found, stretch, reason, fit)
    common.drop_duplicates(table, 2 * settings.merge_distance)
    return common.pole_table(table, "fgi", explain=explain)


def _diameters(points, line, member, found, stretch, reason, fit):
    """Diameters of the accepted candidates, NaN for the others."""
    diameter = np.full(len(reason), np.nan)
    wanted = reason[member] == ""
    points, line, member = points[wanted], line[wanted], member[wanted]
    along = np.einsum("ij,ij->i", points - found["centre"][member], found["direction"][member])
    inside = (along >= stretch[member, 0]) & (along <= stretch[member, 1])
    points, line, member = points[inside], line[inside], member[inside]
    order = np.argsort(member, kind="stable")
    cuts = np.flatnonzero(np.diff(member[order])) + 1
    for part in np.split(order, cuts):
        if len(part):
            k = member[part[0]]
            diameter[k] = fit(points[part], found["direction"][k], line[part])
    return diameter
