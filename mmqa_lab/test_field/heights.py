"""Heights of a cloud compared with surveyed ones."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, QhullError, cKDTree
from threadpoolctl import threadpool_limits

from mmqa_lab._checks import check_columns, check_number, check_points, check_positive
from mmqa_lab._results import sentences
from mmqa_lab.spacing import block_numbers
from mmqa_lab.stats import errors
from mmqa_lab.test_field.drives import GROSS, LEAST_GROSS_M, figures, mean_ends

__all__ = ["compare_heights", "height_accuracy", "height_differences"]


REASONS = ("", "no points", "not surrounded", "slope", "gross error")
"""Reasons for a missing difference; empty for a valid difference."""


def compare_heights(
    points: ArrayLike, reference: ArrayLike, *, radius: float = 0.2
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare a cloud with surveyed heights.

    Parameters
    ----------
    points, reference, radius
        As of :func:`height_differences`. A reference point that is given twice counts once.

    Returns
    -------
    summary : DataFrame
        From :func:`height_accuracy`, with the number of reference points left out for each reason,
        and ``remarks``.
    differences : DataFrame
        From :func:`height_differences`.

    Raises
    ------
    ValueError
        As of :func:`height_differences`, and if no difference is valid.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 8, 0.1), np.arange(0, 8, 0.1))
    >>> cloud = np.stack([x, y, 0 * x + 0.02], axis=-1).reshape(-1, 3)
    >>> heights = np.c_[cloud[200::300, :2], np.zeros(21)] + [0.03, 0.04, 0]
    >>> summary, _ = compare_heights(cloud, heights)
    >>> summary["mean_mm"].round(3).tolist(), summary["remarks"][0][:14]
    ([20.0, 0.0], '21 differences')
    """
    reference = check_points(reference, name="reference points")
    _, first = np.unique(reference, axis=0, return_index=True)
    twice, reference = len(reference) - len(first), reference[np.sort(first)]
    table = height_differences(points, reference, radius=radius)
    valid = table.loc[table["reason"] == "", "dz_m"]
    if valid.empty:
        raise ValueError(
            f"Invalid reference: no surface of the cloud ({_extent(points)}) lies around a point "
            f"of it ({_extent(reference)}). Must overlap, in one coordinate system."
        )
    counts = {r.replace(" ", "_"): int((table["reason"] == r).sum()) for r in REASONS[1:]}
    apart = counts["no_points"] + counts["not_surrounded"]
    remarks = sentences(
        (
            apart > len(table) / 2,
            f"{apart} of {len(table)} reference points lie where the cloud has no surface: the "
            "units or the coordinate systems may differ.",
        ),
        (twice, f"{twice} reference points are given twice and count once."),
        (len(valid) < 30, f"{len(valid)} differences; the ASPRS standards ask for 30 or more."),
        (
            abs(valid.median()) > 1,
            f"The median difference is {valid.median():+.2f} m; the two height systems may differ "
            "(ellipsoid or geoid).",
        ),
    )
    return height_accuracy(table).assign(**counts, remarks=" ".join(remarks)), table


def height_differences(
    points: ArrayLike, reference: ArrayLike, *, radius: float = 0.2, slope_limit: float = 20.0
) -> pd.DataFrame:
    """Return the height of a cloud above reference points.

    The cloud is triangulated (Delaunay) around the reference points. The triangle around a
    reference point gives the height if its corners lie within the radius. The surface must not be
    steeper than the limit; it is the regression plane of all points within the radius.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Laser points, metres.
    reference : array_like, shape (m, 3)
        Metres.
    radius : float
        Search radius in plan, m.
    slope_limit : float
        Largest slope of the surface, degrees. Steeper surfaces are curbs, cars or hedges. The slope
        of the triangle is not used: with centimetres of noise it is steep in any dense cloud.

    Returns
    -------
    DataFrame
        A row per reference point: ``x_m``, ``y_m``, ``reference_m``; ``n`` points within the
        radius; ``dz_m`` cloud minus reference, NaN without a surface; ``slope_deg``; ``reason``,
        one of ``REASONS``. Rows of a ``slope`` or ``gross error`` keep their ``dz_m``.

    Raises
    ------
    ValueError
        If a point is not finite, or if a limit is not above zero.

    Notes
    -----
    A triangulated surface averages little. The noise of a difference is 0.7 of the noise of a point
    (the root of 1/2, the mean of the sum of squared barycentric coordinates).

    Gross errors are differences more than five NMAD, and more than 1 cm, from the median. In the
    report an operator removed them.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.2. The search radius was 20 cm (RIEGL,
    Streetmapper, Lynx) or 50 cm (ROAMER, Sensei).

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 2, 0.1), np.arange(0, 2, 0.1))
    >>> cloud = np.stack([x, y, 0.02 * x], axis=-1).reshape(-1, 3)
    >>> table = height_differences(cloud, [[1.03, 1.04, 0.0], [5, 5, 0]])
    >>> table["dz_m"].round(4).tolist(), table["reason"].tolist()
    ([0.0206, nan], ['', 'no points'])
    """
    points, reference = check_points(points), check_points(reference, name="reference points")
    radius = check_positive(radius, "radius", unit="m")
    check_number(slope_limit, "slope_limit", low=0, high=90, unit="degrees")
    origin = reference.mean(axis=0).round()
    local, targets = points - origin, reference - origin
    found = np.empty((3, len(targets)))
    order = np.argsort(targets[:, 0], kind="stable")
    for part in np.split(order, range(5000, len(order), 5000)):
        x = targets[part, 0]
        around = local[(local[:, 0] >= x[0] - radius) & (local[:, 0] <= x[-1] + radius)]
        found[:, part] = _surfaces(around, targets[part], radius)
    height, slope, counts = found
    slope[counts == 0] = np.nan
    dz = height - targets[:, 2]
    conditions = [counts == 0, np.isnan(dz), slope > slope_limit]
    reason = np.select(conditions, REASONS[1:4], default="").astype(object)
    valid = errors(dz[reason == ""])
    far = np.abs(dz - valid.median) > max(GROSS * valid.nmad, LEAST_GROSS_M)
    reason[(reason == "") & far] = "gross error"
    table = pd.DataFrame(reference, columns=["x_m", "y_m", "reference_m"])
    return table.assign(n=counts.astype(int), dz_m=dz, slope_deg=slope, reason=reason)


def height_accuracy(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise height differences, with the systematic shift and without it.

    Parameters
    ----------
    table : DataFrame
        From :func:`height_differences`; rows with a reason do not count.

    Returns
    -------
    DataFrame
        Two rows, ``shift`` = kept and removed: ``n``; ``mean_mm`` (the shift), ``median_mm``,
        ``min_mm``, ``max_mm``, ``std_mm``, ``rmse_mm``, ``nmad_mm`` and ``le90_mm``, the 90 %
        quantile of the absolute differences; 95 % confidence intervals of the shift and the RMSE
        (``mean_low_mm``, ``mean_high_mm``, ``rmse_low_mm``, ``rmse_high_mm``).

    Raises
    ------
    ValueError
        If a column is missing.

    Notes
    -----
    With the shift the figures are absolute accuracy and depend on the height system of the
    reference. Without the shift they describe the scatter. LE90 is a quantile of the differences.
    The formula 1.645 RMSE would hold only for normal errors without a shift.

    The intervals are for other reference points on the same drives. They follow from the sums of
    4 x 4 blocks of the field (:func:`mmqa_lab.stats.mean_reach`); the interval of the RMSE is
    computed for its logarithm. Without ``x_m`` and ``y_m`` the differences count as independent.
    The intervals do not contain errors of the path that are the same all over the field.

    Examples
    --------
    >>> table = pd.DataFrame({"dz_m": [0.01, 0.02, 0.03], "reason": ["", "", ""]})
    >>> height_accuracy(table)["rmse_mm"].round(2).tolist()
    [21.6, 8.16]
    """
    check_columns(table, ("dz_m", "reason"), "table")
    used = table[table["reason"].isin(["", np.nan])]
    dz = 1000 * used["dz_m"]
    block = np.arange(len(used))
    if {"x_m", "y_m"} <= set(used) and len(used):
        block = block_numbers(used[["x_m", "y_m"]])
    rows = {"kept": _heights(dz, block), "removed": _heights(dz - dz.mean(), block)}
    rows["kept"] |= mean_ends("mean", dz, block)
    return pd.DataFrame(rows.values(), index=pd.Index(rows, name="shift")).reset_index()


def _heights(dz, block):
    """The figures of one row of heights, mm."""
    found = errors(dz)
    own = {"median_mm": found.median, "nmad_mm": found.nmad, "le90_mm": dz.abs().quantile(0.9)}
    return {"n": len(dz)} | figures(dz, block) | own


def _surfaces(points, targets, radius):
    """Height of the triangle and slope (degrees) of the plane around each target, number of points.

    Heights are NaN without a triangle.
    """
    height, places = np.full(len(targets), np.nan), cKDTree(targets[:, :2])
    points = points[np.isfinite(places.query(points[:, :2], distance_upper_bound=radius)[0])]
    pairs = cKDTree(points[:, :2]).sparse_distance_matrix(places, radius, output_type="ndarray")
    counts = np.bincount(pairs["j"], minlength=len(targets))
    slope = _slopes(points[pairs["i"]] - targets[pairs["j"]], pairs["j"], len(targets))
    centre = targets[:, :2].mean(axis=0).round()
    points = points[np.lexsort(points.T)]  # of four on a circle the order of rows decides
    try:
        mesh = Delaunay(np.round(points[:, :2] - centre, 6))  # and rounding far from the origin
    except (QhullError, ValueError):  # all on one line, or none
        return height, slope, counts
    with threadpool_limits(1):  # a small system for every triangle, which threads make slow
        triangle = mesh.find_simplex(targets[:, :2] - centre)
    inside = np.flatnonzero(triangle >= 0)
    corners = points[mesh.simplices[triangle[inside]]] - targets[inside, None]
    close = np.hypot(corners[..., 0], corners[..., 1]).max(axis=1) <= radius
    a, b, c = np.moveaxis(corners[close], 1, 0)
    normal = np.cross(b - a, c - a)
    rise = (a[:, :2] * normal[:, :2]).sum(axis=1) / normal[:, 2]
    height[inside[close]] = targets[inside[close], 2] + a[:, 2] + rise
    return height, slope, counts


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


def _extent(points):
    """The extent of points in words."""
    points = np.asarray(points)
    (west, south), (east, north) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return f"x {west:.1f} to {east:.1f} m, y {south:.1f} to {north:.1f} m"
