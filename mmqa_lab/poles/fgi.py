"""The scan-line method of the Finnish Geodetic Institute (FGI).

Scan lines are cut into short groups. Groups on neighbouring lines that overlap in plan form
clusters. Coaxial clusters are merged. A mask of two coaxial cylinders then moves along each
cluster: the inner cylinder must be dense, the shell around it almost empty (EuroSDR 2013, section
4.1; Lehtomaki et al. 2010, doi:10.3390/rs2030641; 2011, ISPRS Archives XXXVIII-5/W12).

The report states the shell of the mask (0.2 to 0.8 m, as an example), the least length of a pole
(1 m), and that the mask is at most as long as the shortest pole. All other values and the treatment
of duplicates are ours. Section 3.1.3.2 removes isolated points and points of low intensity; this
method keeps them.
"""

import warnings

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab.poles.common import drop_duplicates, first_reason, joined, principal_axes, table
from mmqa_lab.scan_pattern import revolutions_from_time

__all__ = ["chord_diameter", "detect", "scan_lines", "segment_lines"]

GROUP_M, MISSING_PULSES = 0.10, 2
"""A line is cut where neighbours are farther apart (m), or more pulses are missing between them."""

LONGEST_GROUP_M, FEWEST_IN_GROUP = 0.45, 3
"""Longest group on a scan line; fewest points of a group and of a position of the mask."""

OVERLAP_M, NEIGHBOURS = 0.03, 2
"""Largest gap in plan (m) and largest difference of line numbers between groups of a cluster."""

STEEP = 0.8
"""Rise by length of a steep stretch of a scan line."""

MERGE_M, MERGE_DEG, MERGE_GAP_M, SHORT_M = 0.20, 12.0, 2.0, 0.5
"""Largest distance (m), angle (degrees) and gap (m) of coaxial clusters. A cluster shorter than
half a metre has no direction."""

LEAST_LENGTH_M, SWEEPS, LARGEST_TILT_DEG, ELONGATION = 1.0, 4, 15.0, 10.0
"""Limits of a pole: least length and number of lines, largest tilt, least eigenvalue ratio."""

MASK_M, MASK_STEP_M, MASK_SHELL_M, MASK_SHARE, MASK_ELONGATION = 0.8, 0.2, 0.30, 0.85, 4.0
"""Length and step of the mask; outer minus inner radius; least share of the points in both
cylinders that lie in the inner one; least eigenvalue ratio of the points in the inner one."""


def detect(points, lines, *, explain=False):
    """Return the poles of an ordered cloud, as :func:`mmqa_lab.poles.detect` does.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    lines : pair of array, shape (n,)
        Scan line of each point, and number of its pulse along the line.
    explain : bool
        Return all candidates with the test that rejected them.

    Returns
    -------
    DataFrame
        The columns of :func:`mmqa_lab.poles.common.table`, in the origin of ``points``.
    """
    order = np.lexsort(lines[::-1])
    points, line, pulse = points[order], lines[0][order], lines[1][order]
    group, groups = segment_lines(points, line, pulse)
    _warn_of_upright(groups)
    member = np.append(_clusters(groups), -1)[group]  # -1, no group, takes the last
    everything, kept = cKDTree(points), member >= 0
    points, line = points[kept], line[kept]
    member = _merged(points, member[kept])
    axes = _axes(points, member)
    n = len(axes["ratio"])
    reason = first_reason(
        length=np.ptp(axes["ends"], axis=1) < LEAST_LENGTH_M,
        sweeps=pd.Series(line).groupby(member).nunique() < SWEEPS,
        tilt=axes["direction"][:, 2] < np.cos(np.radians(LARGEST_TILT_DEG)),
        elongation=axes["ratio"] < ELONGATION,
    )
    share, diameter = np.zeros(n), np.full(n, np.nan)
    for k in np.flatnonzero(reason == ""):
        own, axis = np.flatnonzero(member == k), (axes["centre"][k], axes["direction"][k])
        accepted, share[k] = _mask(everything, points[own], axis)
        part = own[accepted]
        along = _about(points[part], axis)[0]
        if len(np.unique(line[part])) < SWEEPS or np.ptp(along) < LEAST_LENGTH_M:
            reason[k] = "mask"
            continue
        axes["ends"][k] = along.min(), along.max()
        diameter[k] = chord_diameter(points[part], axis[1], line[part])
    low, high = (axes["centre"] + end[:, None] * axes["direction"] for end in axes["ends"].T)
    x, y, _ = (low + high).T / 2
    drop_duplicates(np.column_stack([x, y]), share, reason, 2 * MERGE_M)
    lean = axes["direction"][:, :2] / np.maximum(axes["direction"][:, 2:], 1e-6)
    rows = {"x_m": x, "y_m": y, "z_base_m": low[:, 2], "height_m": high[:, 2] - low[:, 2]}
    rows |= {"diameter_m": diameter, "lean_x": lean[:, 0], "lean_y": lean[:, 1]}
    return table(rows | {"score": share, "rejected_by": reason}, "fgi", explain=explain)


def segment_lines(points, line, pulse):
    """Cut sorted scan lines into groups.

    Points (n, 3), line (n,) and pulse (n,) are sorted by line, then pulse; lengths in metres.

    Returns
    -------
    group : array of int, shape (n,)
        Group of each point, -1 where the group was too long or too small.
    groups : dict of str to array
        Of each accepted group: ``centre`` (k, 3), half its chord ``half`` (k,), ``line`` (k,); of
        each group that is too long its rise by its length, ``rise`` (m,).
    """
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > GROUP_M
    broken = apart | (np.diff(line) != 0) | (np.diff(pulse) > MISSING_PULSES + 1)
    first = np.flatnonzero(np.append(True, broken)[: len(points)])
    count = np.diff(np.append(first, len(points)))
    way = points[first + count - 1] - points[first]
    chord = np.linalg.norm(way, axis=1)
    good = (count >= FEWEST_IN_GROUP) & (chord <= LONGEST_GROUP_M)
    number = np.where(good, np.cumsum(good) - 1, -1)
    centre = np.add.reduceat(points, first, axis=0) / count[:, None]
    kept = {"centre": centre[good], "half": chord[good] / 2, "line": line[first][good]}
    too_long = chord > LONGEST_GROUP_M
    kept["rise"] = np.abs(way[too_long, 2]) / chord[too_long]
    return np.repeat(number, count), kept


def _warn_of_upright(groups):
    """Warn if the steep among the long groups are upright: then poles lie along scan lines."""
    steep = groups["rise"][groups["rise"] > STEEP]
    upright = steep > np.cos(np.radians(LARGEST_TILT_DEG))
    if len(steep) >= FEWEST_IN_GROUP and upright.mean() > 0.5:
        warnings.warn(
            f"{upright.sum()} upright stretches of scan lines are longer than {LONGEST_GROUP_M} m: "
            "profiles run along poles, where the scan-line method finds none.",
            stacklevel=2,
        )


def _clusters(groups):
    """Cluster of each group: groups that overlap in plan on neighbouring lines are linked."""
    reach = LONGEST_GROUP_M + OVERLAP_M
    lines = groups["line"] * (reach / (NEIGHBOURS + 0.5))
    tree = cKDTree(np.column_stack([groups["centre"][:, :2], lines]))
    a, b = tree.query_pairs(reach, p=np.inf, output_type="ndarray").T
    distance = np.hypot(*(groups["centre"][a, :2] - groups["centre"][b, :2]).T)
    linked = groups["line"][a] != groups["line"][b]
    linked &= distance <= groups["half"][a] + groups["half"][b] + OVERLAP_M
    return joined(a[linked], b[linked], len(lines))


def _axes(points, member):
    """Centre, direction, ends along the axis and eigenvalue ratio of each cluster."""
    centre, values, vectors = principal_axes(points, member)
    direction = vectors[:, :, 2] * np.where(vectors[:, 2, 2] < 0, -1.0, 1.0)[:, None]
    along = pd.Series(((points - centre[member]) * direction[member]).sum(axis=1)).groupby(member)
    ends = np.column_stack([along.min(), along.max()])
    ratio = values[:, 2] / np.maximum(values[:, 1], 1e-12)
    return {"centre": centre, "direction": direction, "ends": ends, "ratio": ratio}


def _merged(points, member):
    """Cluster of each point after the merger of coaxial clusters that rise by 0.2 m or more."""
    axes = _axes(points, member)
    centre, direction = axes["centre"], axes["direction"]
    low, high = centre[:, 2] + axes["ends"].T * direction[:, 2]
    tall = np.flatnonzero(high - low >= 0.2)
    reach = MERGE_M + np.tan(np.radians(MERGE_DEG)) * MERGE_GAP_M
    a, b = tall[cKDTree(centre[tall, :2]).query_pairs(reach, output_type="ndarray").T]
    gap = np.maximum(low[a], low[b]) - np.minimum(high[a], high[b])
    half = (centre[b, 2] - centre[a, 2])[:, None] / 2
    slope = direction[:, :2] / np.maximum(direction[:, 2:], 0.5)
    slope *= (high - low >= SHORT_M)[:, None]
    apart = centre[a, :2] + slope[a] * half - centre[b, :2] + slope[b] * half
    parallel = (direction[a] * direction[b]).sum(axis=1) >= np.cos(np.radians(MERGE_DEG))
    parallel |= np.minimum((high - low)[a], (high - low)[b]) < SHORT_M
    linked = (np.hypot(*apart.T) <= MERGE_M) & parallel & (gap <= MERGE_GAP_M)
    return joined(a[linked], b[linked], len(low))[member]


def _about(points, axis):
    """Distances of points along an axis (from its centre) and across it."""
    off = points - axis[0]
    along = off @ axis[1]
    return along, np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0))


def _mask(everything, own, axis):
    """Points of a cluster that the moving mask accepts, and the mean share in its inner cylinder.

    At each step the inner cylinder is the smallest around the cluster's points. The points in it
    must form an upright, elongated shape.
    """
    along, across = _about(own, axis)
    reach = np.hypot(np.abs(along).max(), across.max() + MASK_SHELL_M)
    near = everything.data[everything.query_ball_point(axis[0], reach)]
    near_along, near_across = _about(near, axis)
    accepted, shares = np.zeros(len(own), dtype=bool), []
    for begin in np.arange(along.min(), along.max() - MASK_M + 1e-9, MASK_STEP_M):
        part = (along >= begin) & (along <= begin + MASK_M)
        if part.sum() < FEWEST_IN_GROUP:
            continue
        between = (near_along >= begin) & (near_along <= begin + MASK_M)
        radius = across[part].max() + 1e-6
        inside = between & (near_across <= radius)
        share = inside.sum() / (between & (near_across <= radius + MASK_SHELL_M)).sum()
        if share >= MASK_SHARE and _is_upright(near[inside]):
            accepted |= part
            shares.append(share)
    return accepted, float(np.mean(shares)) if shares else 0.0


def _is_upright(points):
    """Whether points have the orientation and the shape of a pole."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    upright = abs(vectors[2, 2]) >= np.cos(np.radians(LARGEST_TILT_DEG))
    return upright and values[2] >= MASK_ELONGATION * values[1]


def chord_diameter(points, direction, line):
    """Return the diameter of a shaft from the chords that scan lines cut, metres.

    With a ray every s metres a post of diameter d gets d / s hits on average. The chord from the
    first to the last hit is shorter than d by one spacing, so the estimate is the median chord plus
    the median spacing. NaN where fewer than five lines have two hits. The report names no
    estimator; this one is ours.

    Parameters
    ----------
    points : array, shape (n, 3)
        Points of the shaft, sorted by scan line, metres.
    direction : array, shape (3,)
        Unit vector along the axis.
    line : array of int, shape (n,)
        Scan line of each point.
    """
    flat = points - np.outer(points @ direction, direction)
    parts = np.split(flat, np.flatnonzero(np.diff(line)) + 1)
    parts = [part for part in parts if len(part) >= 2]
    if len(parts) < 5:
        return np.nan
    chords = np.array([np.linalg.norm(part[-1] - part[0]) for part in parts])
    spacing = np.median(chords / [len(part) - 1 for part in parts])
    return float(np.median(chords) + spacing)


def scan_lines(cloud):
    """Return the scan line (n,) and the number of the pulse (n,) of each point of a cloud.

    Lines are those of ``scan_line``. Without it a line ends in the pause of ``gps_time`` that all
    revolutions share. Pulses are those of ``pulse``. Without it they are counted from ``gps_time``,
    in steps of its median. Lines of different ``head`` are no neighbours.

    Raises
    ------
    ValueError
        If the cloud has neither ``gps_time`` nor both others, or the times show no pause.
    """
    if "gps_time" not in cloud and not {"scan_line", "pulse"} <= set(cloud.columns):
        columns = ", ".join(cloud.columns) or "none"
        raise ValueError(
            f"Invalid cloud: columns {columns}. The scan-line method needs scan_line and pulse or "
            "gps_time, or gps_time with pauses."
        )
    if not len(cloud):
        return np.zeros(0, np.int64), np.zeros(0)
    heads = [cloud[name] for name in ("head", "point_source_id") if name in cloud]
    head = np.unique([*heads, np.zeros(len(cloud))], axis=1, return_inverse=True)[1]
    if "scan_line" in cloud:
        line = np.asarray(cloud["scan_line"], np.int64)
    else:
        times = pd.Series(np.asarray(cloud["gps_time"], np.float64))
        line = times.groupby(head).transform(revolutions_from_time).to_numpy()
    line = line - line.min() + head * (np.ptp(line) + NEIGHBOURS + 1)
    if "pulse" in cloud:
        return line, np.asarray(cloud["pulse"], np.float64)
    time = np.asarray(cloud["gps_time"], np.float64)
    order = np.lexsort([time, line])
    steps = np.diff(time[order])[np.diff(line[order]) == 0]
    step = np.median(steps[steps > 0]) if (steps > 0).any() else 1.0
    return line, np.round((time - time.min()) / step)
