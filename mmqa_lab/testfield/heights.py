"""Height differences between a cloud and reference points, and what they amount to.

EuroSDR 2013, mobile laser scanning, section 3.2: at each reference point a small triangulated
surface of the laser points around it gives the height. The search radius was 20 cm (RIEGL,
Streetmapper, Lynx) or 50 cm (ROAMER, Sensei).
"""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_number, check_points, check_positive
from mmqa_lab.stats import errors

CHUNK = 5000
"""Reference points worked on at a time, with the points around them."""

GROSS = 5.0
"""Differences so many NMAD from the median are gross errors."""

REASONS = ("", "no points", "not surrounded", "slope", "gross error")
"""Why a reference point has no valid difference; empty where it has."""

GAP_S = 3600.0
"""A drive may pass a place more than once; an hour without points is another drive."""


def height_differences(
    points, reference, *, radius=0.2, slope_limit=20.0, gross_limit=None, progress=False
):
    """Return the height of a cloud above reference points.

    The cloud is triangulated (Delaunay) around the reference points; the triangle about a reference
    point gives the height, where its corners lie within the radius and the surface there (the
    regression plane of all points within the radius) is not steeper than the limit.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Laser points, metres.
    reference : array_like, shape (m, 3)
        Metres.
    radius : float
        Search radius in plan, m.
    slope_limit : float
        Of the surface, degrees: steeper ones are curbs, cars or hedges. Not the triangle's own
        slope, which with centimetres of noise is steep on any dense cloud.
    gross_limit : float, optional
        Largest distance of a difference from the median, m. By default five NMAD of all
        differences, but 1 cm at least.
    progress : bool
        Show a bar.

    Returns
    -------
    DataFrame
        One row a reference point: ``x_m``, ``y_m``, ``reference_m``; ``n`` points within the
        radius; ``dz_m`` cloud minus reference, NaN where there is no surface; ``slope_deg``;
        ``reason`` it does not count, one of ``REASONS``. Rows of a ``slope`` or ``gross error``
        keep their ``dz_m``.

    Raises
    ------
    ValueError
        If an array is not made of finite points or a limit is not above zero.

    Notes
    -----
    A triangulated surface averages little: the difference carries about 0.7 of a single point's
    noise (root of the mean of the sum of squared barycentric coordinates, 1/2).

    Two rules differ from the report. There the slope limit of 20 degrees is that of the
    triangulated model, and gross errors were looked at and removed by hand.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.2.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 2, 0.1), np.arange(0, 2, 0.1))
    >>> cloud = np.stack([x, y, 0.02 * x], axis=-1).reshape(-1, 3)
    >>> table = height_differences(cloud, [[1.03, 1.04, 0.0], [5, 5, 0]])
    >>> table["dz_m"].round(4).tolist(), table["reason"].tolist()
    ([0.0206, nan], ['', 'no points'])
    """
    from tqdm.auto import tqdm

    points, reference = check_points(points), check_points(reference, name="reference points")
    radius = check_positive(radius, "radius", unit="m")
    check_number(slope_limit, "slope_limit", low=0, high=90, unit="degrees")
    origin = reference.mean(axis=0).round()
    local, targets = _nearby(points - origin, reference - origin, radius)
    order = np.argsort(targets[:, 0], kind="stable")
    near, counts = np.full((len(targets), 2), np.nan), np.zeros(len(targets), dtype=int)
    for first in tqdm(range(0, len(order), CHUNK), disable=not progress, unit="chunk"):
        part = order[first : first + CHUNK]
        low, high = targets[part[[0, -1]], 0] + [-radius, radius]
        around = slice(*np.searchsorted(local[:, 0], [low, high]))
        near[part], counts[part] = _surfaces(local[around], targets[part], radius)
    dz, slope = near[:, 0] - targets[:, 2], near[:, 1]
    reason = np.select(
        [counts == 0, np.isnan(dz), slope > slope_limit], REASONS[1:4], default=REASONS[0]
    ).astype(object)
    reason[(reason == "") & _gross(dz, reason == "", gross_limit)] = "gross error"
    table = pd.DataFrame(reference, columns=["x_m", "y_m", "reference_m"])
    return table.assign(n=counts, dz_m=dz, slope_deg=slope, reason=reason)


def height_accuracy(table):
    """Summarise height differences with the systematic shift kept, and removed.

    Parameters
    ----------
    table : DataFrame
        From ``height_differences``; rows with a reason do not count.

    Returns
    -------
    DataFrame
        Two rows, ``shift`` = kept and removed: ``n``; ``mean_mm`` (the shift), ``median_mm``,
        ``min_mm``, ``max_mm``, ``std_mm``, ``rmse_mm``, ``nmad_mm`` and ``le90_mm``, the difference
        that 90 % of all stay within.

    Raises
    ------
    ValueError
        If a column is missing.

    Notes
    -----
    With the shift kept the figures are absolute accuracy and depend on the height system of the
    reference; with the shift removed they describe the scatter. LE90 is taken from the differences,
    not as 1.645 RMSE, which is right for normal errors without a shift only.

    Examples
    --------
    >>> table = pd.DataFrame({"dz_m": [0.01, 0.02, 0.03], "reason": ["", "", ""]})
    >>> height_accuracy(table)["rmse_mm"].round(2).tolist()
    [21.6, 8.16]
    """
    if "dz_m" not in table or "reason" not in table:
        raise ValueError("Invalid table. Must have the columns dz_m and reason.")
    dz = 1000 * table.loc[table["reason"] == "", "dz_m"].to_numpy(dtype=np.float64)
    shift = dz.mean() if len(dz) else np.nan
    parts = (("kept", 0), ("removed", shift))
    table = pd.DataFrame([{"shift": name, **_summary(dz - part)} for name, part in parts])
    table["mean_mm"] = table["mean_mm"].round(9) + 0.0  # never -0
    return table


def split_drives(gps_time, *, gap_s=GAP_S):
    """Return the number of the drive of each point: a gap in time begins a new one.

    Parameters
    ----------
    gps_time : array_like, shape (n,)
        Seconds, in any order.
    gap_s : float
        Shortest gap, s.

    Returns
    -------
    array of int, shape (n,)
        Counted from 0 in the order of time.

    Raises
    ------
    ValueError
        If a time is not finite or the gap is not above zero.

    Examples
    --------
    >>> split_drives([5.0, 90_000.0, 6.0, 90_001.0]).tolist()
    [0, 1, 0, 1]
    """
    time = np.asarray(gps_time, dtype=np.float64)
    if time.ndim != 1 or not len(time) or not np.isfinite(time).all():
        raise ValueError(f"Invalid gps_time of shape {time.shape}. Must be finite seconds.")
    gap = check_positive(gap_s, "gap_s", unit="s")
    order = np.argsort(time, kind="stable")
    number = np.empty(len(time), dtype=int)
    number[order] = np.cumsum(np.diff(time[order], prepend=time[order[0]]) > gap)
    return number


def between_drives(first, second):
    """Return the height differences of two drives at the reference points that both have.

    Parameters
    ----------
    first, second : DataFrame
        From ``height_differences`` at the same reference points.

    Returns
    -------
    DataFrame
        As ``first``, with ``dz_m`` of the first drive less that of the second: relative accuracy,
        in which errors of the reference cancel. ``reason`` is that of the drive that has one.

    Raises
    ------
    ValueError
        If the reference points are not the same.

    Examples
    --------
    >>> import pandas as pd
    >>> place = {"x_m": [0.0], "y_m": 0.0, "reference_m": 5.0}
    >>> first = pd.DataFrame(place | {"dz_m": 0.5, "reason": ""})
    >>> between_drives(first, first.assign(dz_m=0.25))["dz_m"].tolist()
    [0.25]
    """
    places = ["x_m", "y_m", "reference_m"]
    if len(first) != len(second) or not np.array_equal(first[places], second[places]):
        raise ValueError("Invalid tables. Must be of the same reference points.")
    reason = first["reason"].where(first["reason"] != "", second["reason"])
    return first.assign(dz_m=first["dz_m"] - second["dz_m"], reason=reason)


def _summary(values):
    """The figures of one row of an accuracy table, in mm, of differences in mm."""
    found = errors(values)
    known = values[np.isfinite(values)]
    known = known if len(known) else np.array([np.nan])
    return {
        "n": found.n,
        "mean_mm": found.bias,
        "median_mm": found.median,
        "min_mm": known.min(),
        "max_mm": known.max(),
        "std_mm": found.std,
        "rmse_mm": found.rmse,
        "nmad_mm": found.nmad,
        "le90_mm": np.quantile(np.abs(known), 0.9),
    }


def _gross(dz, valid, limit):
    """Which valid differences lie too far from their median."""
    if not valid.any():
        return np.zeros(len(dz), dtype=bool)
    found = errors(dz[valid])
    if limit is None:
        limit = max(GROSS * found.nmad, 0.01)
    return np.abs(dz - found.median) > check_positive(limit, "gross_limit", unit="m")


def _nearby(points, targets, radius):
    """Points within the radius of any target's x and y range, in the order of x; the targets."""
    low, high = targets[:, :2].min(axis=0) - radius, targets[:, :2].max(axis=0) + radius
    inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
    points = points[inside]
    return points[np.argsort(points[:, 0], kind="stable")], targets


def _surfaces(points, targets, radius):
    """Height of the triangle and slope (degrees) of the plane about each target, and points near.

    Returns arrays of shape (m, 2), NaN where there is no such triangle, and (m,).
    """
    from scipy.spatial import cKDTree

    found, nothing = np.full((len(targets), 2), np.nan), np.zeros(len(targets), dtype=int)
    if not len(points):
        return found, nothing
    tree = cKDTree(targets[:, :2])
    points = points[np.isfinite(tree.query(points[:, :2], distance_upper_bound=radius)[0])]
    if not len(points):
        return found, nothing
    pairs = cKDTree(points[:, :2]).sparse_distance_matrix(tree, radius, output_type="ndarray")
    counts = np.bincount(pairs["j"], minlength=len(targets))
    found[:, 0] = _triangle_heights(points, targets, radius)
    found[:, 1] = _slopes(points[pairs["i"]] - targets[pairs["j"]], pairs["j"], len(targets))
    return found, counts


def _triangle_heights(points, targets, radius):
    """Height above each target in the triangulation of the points, NaN where there is none."""
    from scipy.spatial import Delaunay, QhullError

    heights = np.full(len(targets), np.nan)
    centre = targets.mean(axis=0)
    try:
        mesh = Delaunay(points[:, :2] - centre[:2])
    except QhullError:  # fewer than three points, or all on one line
        return heights
    triangle = _located(mesh, targets[:, :2] - centre[:2])
    inside = np.flatnonzero(triangle >= 0)
    corners = points[mesh.simplices[triangle[inside]]] - targets[inside, None]
    close = np.hypot(corners[..., 0], corners[..., 1]).max(axis=1) <= radius
    a, b, c = np.moveaxis(corners[close], 1, 0)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        above = a[:, 2] + (a[:, :2] * normal[:, :2]).sum(axis=1) / normal[:, 2]
    heights[inside[close]] = np.where(np.isfinite(above), above, np.nan) + targets[inside[close], 2]
    return heights


def _located(mesh, places):
    """Number of the triangle about each place, -1 outside of all.

    Walks from a corner nearby across the edge that the place lies beyond. scipy's own search calls
    a threaded solver for every triangle, which on a busy machine takes a hundred times as long.
    """
    from scipy.spatial import cKDTree

    triangle = mesh.vertex_to_simplex[cKDTree(mesh.points).query(places)[1]].copy()
    walking = np.flatnonzero(triangle >= 0)
    for _ in range(len(mesh.simplices)):
        if not len(walking):
            break
        a, b, c = np.moveaxis(mesh.points[mesh.simplices[triangle[walking]]], 1, 0)
        p = places[walking]
        beyond = np.stack([_turn(b, c, p), _turn(c, a, p), _turn(a, b, p)], axis=1)
        beyond *= np.where(_turn(a, b, c) < 0, -1, 1)[:, None]
        worst = beyond.argmin(axis=1)
        on = beyond[np.arange(len(worst)), worst] < 0
        walking, worst = walking[on], worst[on]
        triangle[walking] = mesh.neighbors[triangle[walking], worst]
        walking = walking[triangle[walking] >= 0]
    return triangle


def _turn(a, b, p):
    """Twice the signed area of triangles a, b, p."""
    ab, ap = b - a, p - a
    return ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]


def _slopes(offsets, group, count):
    """Slope in degrees of the regression plane of each group's points."""
    x, y, z = offsets.T
    ones = np.ones_like(x)
    terms = np.stack([ones, x, y])
    normal = np.array([[np.bincount(group, p * q, count) for p in terms] for q in terms])
    right = np.array([np.bincount(group, p * z, count) for p in terms])
    normal = np.moveaxis(normal, -1, 0) + 1e-12 * np.eye(3)
    plane = np.linalg.solve(normal, right.T[..., None])[..., 0]
    return np.degrees(np.arctan(np.hypot(plane[:, 1], plane[:, 2])))
