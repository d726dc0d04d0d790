"""The accuracy of point clouds on a test field: heights, plan positions, growth with distance.

EuroSDR 2013, mobile laser scanning, chapter 3 (Finnish Geodetic Institute): five systems on one
field whose ground, poles and corners were surveyed (section 3.1), evaluated after systematic errors
were removed (section 3.2). Start here::

    from mmqa_lab import test_field
    from mmqa_lab.cloud import path_distance

    table = test_field.height_differences(cloud, reference)          # or the reason for none
    test_field.height_accuracy(table)                                # shift kept, shift removed
    table["distance_m"] = path_distance(reference, trajectory)
    test_field.trend(table["distance_m"], (table["dz_m"] - table["dz_m"].mean()).abs())
    test_field.plan_accuracy(test_field.plan_differences(cloud, targets))

ASPRS Positional Accuracy Standards (edition 2, 2023) call the RMSE of height with the shift kept
RMSE_V, that of the plan (equation 3-1) RMSE_H, and add to both the uncertainty of the check points'
own survey. They no longer use 95 % confidence levels, and require 30 check points or more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, QhullError, cKDTree
from threadpoolctl import threadpool_limits

from mmqa_lab._checks import check_choice, check_columns, check_number, check_points, check_positive
from mmqa_lab._results import sentences
from mmqa_lab.planes import fit_circle, fit_line
from mmqa_lab.spacing import block_numbers
from mmqa_lab.stats import errors, mean_reach

__all__ = [
    "FEWEST_ON_CIRCLE", "POLE_SEARCH_M", "REPORT_SLICES", "SLICES", "compare_heights",
    "height_accuracy", "height_differences", "plan_accuracy", "plan_differences", "split_drives",
    "thinned", "trend",
]  # fmt: skip

GROSS, LEAST_GROSS_M = 5.0, 0.01
"""Gross errors are farther than this many NMAD, and farther than 1 cm, from the median."""

REASONS = ("", "no points", "not surrounded", "slope", "gross error")
"""Reasons for a missing difference; empty for a valid difference."""

SLICES = {"pole": ((0.5, 1.5), (4.5, 5.5)), "building": ((1.0, 3.0),), "curb": ((0.03, 0.10),)}
"""Slices of each kind of target: lower and upper height above the foot, m. They are our choice."""

_LOW, _HIGH = (-0.1, 0.5), (4.5, 5.5)
REPORT_SLICES = {"pole": (_LOW, _HIGH), "building": (_LOW, _HIGH), "curb": (_LOW,)}
"""Slices of the report, section 3.1.2.3. The lower slice is 0.6 m thick. A distant thin pole has
few points in it, and the ground is part of it."""

POLE_SEARCH_M, CORNER_SEARCH_M = 0.4, 2.0
"""Largest distance in plan of points from a pole and from a corner."""

FEWEST_ON_CIRCLE, FEWEST_ON_LINE = 8, 10
"""Least number of points for a circle and for a line. A circle through fewer points may lie on
their wrong side."""

NEAR_LINE_M = 0.03
"""Largest distance of a line's points from it."""


def compare_heights(
    points: ArrayLike, reference: ArrayLike, *, radius: float = 0.2
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare a cloud with surveyed heights.

    Parameters
    ----------
    points, reference, radius
        As of :func:`height_differences`.

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
    used = table[table["reason"] == ""]
    dz = 1000 * used["dz_m"]
    block = np.arange(len(used))
    if {"x_m", "y_m"} <= set(used) and len(used):
        block = block_numbers(used[["x_m", "y_m"]])
    rows = {"kept": _heights(dz, block), "removed": _heights(dz - dz.mean(), block)}
    rows["kept"] |= _mean_ends("mean", dz, block)
    return pd.DataFrame(rows.values(), index=pd.Index(rows, name="shift")).reset_index()


def split_drives(gps_time: ArrayLike, *, gap_s: float = 3600.0) -> np.ndarray:
    """Return the number of each point's drive; a gap in time begins a new drive.

    Parameters
    ----------
    gps_time : array_like, shape (n,)
        Seconds, in any order.
    gap_s : float
        Shortest gap between drives, s. Within an hour, one drive may pass a place more than once.

    Returns
    -------
    array of int, shape (n,)
        Counted from 0 in the order of time.

    Examples
    --------
    >>> split_drives([5.0, 90_000.0, 6.0, 90_001.0]).tolist()
    [0, 1, 0, 1]
    """
    time = np.asarray(gps_time, dtype=np.float64)
    order = np.argsort(time, kind="stable")
    number = np.cumsum(np.diff(time[order], prepend=time[order[0]]) > gap_s)
    return number[np.argsort(order)]


def plan_differences(
    points: ArrayLike,
    targets: pd.DataFrame,
    *,
    slices: dict[str, Sequence[tuple[float, float]]] | None = None,
) -> pd.DataFrame:
    """Measure the plan positions of targets in a cloud.

    In each slice of height a circle is fitted to the points near a pole, robustly (Cauchy loss of
    the distances) and with the reference diameter if it is given. For a corner, two lines are
    fitted to the points of both faces. The first line has the most points within 3 cm, the second
    the most of the remaining points. Both are then fitted robustly (Tukey) to the points on their
    side of the corner.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    targets : DataFrame
        ``x_m``, ``y_m``, ``z_m`` of the foot; ``kind``, pole (where the column is missing),
        building or curb (corners); ``name``; ``diameter_m`` of poles where surveyed.
    slices : dict of str to sequence of (float, float), optional
        Metres above the foot for each kind; ``SLICES`` by default.

    Returns
    -------
    DataFrame
        A row per target and slice: ``name``, ``kind``, ``x_m``, ``y_m``, ``height_m`` (middle of
        the slice), ``n`` points used, ``dx_m``, ``dy_m`` (cloud minus reference), and ``reason`` if
        they are missing. The reason "gross error" marks lines or circles of other things: they are
        farther from the median than five standard deviations (from the median of the distances) and
        than 1 cm. These rows keep their values.

    Raises
    ------
    ValueError
        If a point or target is not finite, a kind is unknown, or there is no target.

    Notes
    -----
    Seen from one side, points cover less than half of a circle. If the diameter is free, centre and
    radius are correlated along the line of sight. The error on a thin pole is a few centimetres.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.1.2.3. There an operator measured curbs in the
    lower slice, and poles and buildings in both slices. Circles were fitted to poles by eye.

    Examples
    --------
    >>> turn, height = np.meshgrid(np.arange(0, 6.2, 0.1), np.arange(0, 6, 0.05))
    >>> post = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), height], axis=-1).reshape(-1, 3)
    >>> pole = pd.DataFrame({"x_m": [0.03], "y_m": 0.0, "z_m": 0.0, "diameter_m": 0.2})
    >>> plan_differences(post, pole)["dx_m"].round(6).unique().tolist()
    [-0.03]
    """
    points = check_points(points)
    check_columns(targets, ("x_m", "y_m", "z_m"), "targets")
    if not len(targets):
        raise ValueError("Invalid targets: none given. Must be one or more.")
    check_points(targets[["x_m", "y_m", "z_m"]], name="targets")
    slices = slices or SLICES
    origin = points[:, :2].mean(axis=0).round()
    local = points[:, :2] - origin
    tree, rows = cKDTree(local), []
    for number, target in enumerate(targets.to_dict("records")):
        kind = check_choice(target.get("kind", "pole"), "kind", slices)
        place = np.array([target["x_m"], target["y_m"]]) - origin
        reach = POLE_SEARCH_M if kind == "pole" else CORNER_SEARCH_M
        near = np.array(tree.query_ball_point(place, reach), dtype=int)
        above = points[near, 2] - target["z_m"]
        for low, high in slices[kind]:
            xy = local[near[(above >= low) & (above <= high)]] - place
            found = _circle(xy, target.get("diameter_m")) if kind == "pole" else _corner(xy)
            named = {"name": target.get("name", number), "kind": kind}
            named |= {"x_m": target["x_m"], "y_m": target["y_m"], "height_m": (low + high) / 2}
            rows.append(named | dict(zip(("dx_m", "dy_m", "n", "reason"), found, strict=True)))
    table = pd.DataFrame(rows)
    used = table["reason"] == ""
    difference = table[["dx_m", "dy_m"]] - table.loc[used, ["dx_m", "dy_m"]].median()
    off = np.hypot(difference["dx_m"], difference["dy_m"])
    # the median of normal errors in two directions is root(2 ln 2) of one
    limit = max(GROSS * off[used].median() / np.sqrt(2 * np.log(2)), LEAST_GROSS_M)
    table.loc[used & (off > limit), "reason"] = "gross error"
    return table


def plan_accuracy(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise plan differences, with the systematic shift in easting and northing and without it.

    Parameters
    ----------
    table : DataFrame
        ``dx_m``, ``dy_m``, ``reason``, from ``plan_differences``.

    Returns
    -------
    DataFrame
        Two rows, ``shift`` = kept and removed: ``n``, ``missing``; ``mean_east_mm``,
        ``mean_north_mm``, ``std_east_mm``, ``std_north_mm``; ``mean_mm``, ``min_mm``, ``max_mm``,
        ``std_mm`` of the distances in plan; ``rmse_mm``, the root of the mean squared distance
        (equation 3-1; ASPRS: RMSE_H). The 95 % confidence intervals of the shift and the RMSE have
        names such as ``mean_east_low_mm`` and ``mean_east_high_mm``.

    Notes
    -----
    The intervals are for other targets on the same drives. All slices of a target count as a single
    value, and targets count as independent. See :func:`height_accuracy`.

    Examples
    --------
    >>> table = pd.DataFrame({"dx_m": [0.03, 0.03], "dy_m": [0.04, 0.04], "reason": ["", ""]})
    >>> plan_accuracy(table)["rmse_mm"].round(6).tolist()
    [50.0, 0.0]
    """
    used = table[table["reason"] == ""]
    target = np.arange(len(used))
    if {"x_m", "y_m"} <= set(used):
        target = used.groupby(["x_m", "y_m"]).ngroup().to_numpy()
    difference = 1000 * used[["dx_m", "dy_m"]]
    counts = {"n": len(used), "missing": len(table) - len(used)}
    rows: list[dict] = [{"shift": "kept"}, {"shift": "removed"}]
    for row, off in zip(rows, (difference, difference - difference.mean()), strict=True):
        east, north = errors(off["dx_m"]), errors(off["dy_m"])
        row |= counts | {"mean_east_mm": east.bias, "mean_north_mm": north.bias}
        row |= {"std_east_mm": east.std, "std_north_mm": north.std}
        row |= _figures(np.hypot(off["dx_m"], off["dy_m"]), target)
    for name, column in (("mean_east", "dx_m"), ("mean_north", "dy_m")):
        rows[0] |= _mean_ends(name, difference[column], target)
    return pd.DataFrame(rows)


def _figures(values, block):
    """The figures that heights and distances in plan share; a series of values in mm."""
    found = errors(values)
    share = mean_reach(values**2, block) / np.maximum(found.rmse**2, 1e-300) / 2
    return {
        "mean_mm": round(found.bias, 9) + 0.0,  # never -0
        "min_mm": values.min(),
        "max_mm": values.max(),
        "std_mm": found.std,
        "rmse_mm": found.rmse,
        "rmse_low_mm": found.rmse * np.exp(-share),
        "rmse_high_mm": found.rmse * np.exp(share),
    }


def _heights(dz, block):
    """The figures of one row of heights, mm."""
    found = errors(dz)
    own = {"median_mm": found.median, "nmad_mm": found.nmad, "le90_mm": dz.abs().quantile(0.9)}
    return {"n": len(dz)} | _figures(dz, block) | own


def _mean_ends(name, values, block):
    """The 95 % interval of a mean, mm."""
    mean, reach = errors(values).bias, mean_reach(values, block)
    return {f"{name}_low_mm": mean - reach, f"{name}_high_mm": mean + reach}


def thinned(points: ArrayLike, side: float) -> np.ndarray:
    """Return a point of each square in plan: the point nearest to its middle.

    Parameters
    ----------
    points : array_like, shape (n, 3)
    side : float
        Side of the squares, m.

    Returns
    -------
    array, shape (m, 3)

    Raises
    ------
    ValueError
        If a point is not finite or the side is not above zero.

    Examples
    --------
    >>> thinned([[0.1, 0.1, 0], [0.4, 0.5, 1], [1.5, 0.5, 2]], 1.0).tolist()
    [[0.4, 0.5, 1.0], [1.5, 0.5, 2.0]]
    """
    points = check_points(points)
    side = check_positive(side, "side", unit="m")
    local = points[:, :2] - np.floor(points[:, :2].min(axis=0) / side) * side
    cell, gap = local // side, np.hypot(*(local % side - side / 2).T)
    order = np.argsort(gap, kind="stable")
    return points[order[np.unique(cell[order], axis=0, return_index=True)[1]]]


def trend(distance: ArrayLike, values: ArrayLike) -> pd.Series:
    """Fit a straight line to errors over distance, as in Figures 3-18 and 3-20 of the report.

    Parameters
    ----------
    distance : array_like, shape (n,)
        Metres from the trajectory.
    values : array_like, shape (n,)
        Errors in any unit; NaN are left out.

    Returns
    -------
    Series
        ``slope`` (errors' unit per metre), ``intercept``, ``slope_low``, ``slope_high`` (95 %),
        ``p`` (of no slope), ``n``.

    Raises
    ------
    ValueError
        If fewer than three values are left or all lie at one distance.

    Notes
    -----
    The interval holds for independent errors. Errors along a drive are not independent: a drift of
    the trajectory moves all points of a stretch together. The true interval is then wider.

    Examples
    --------
    >>> found = trend([5, 10, 15, 20], [6.0, 11.0, 16.0, 21.1])
    >>> found[["slope", "n"]].round(2).tolist()
    [1.01, 4.0]
    """
    from scipy.stats import linregress, t

    distance, values = np.asarray(distance, np.float64), np.asarray(values, np.float64)
    known = np.isfinite(values) & np.isfinite(distance)
    distance, values = distance[known], values[known]
    if len(values) < 3 or np.ptp(distance) == 0:
        raise ValueError(
            f"Invalid errors: {len(values)} at {len(np.unique(distance))} distances. Must be three "
            "or more at different distances."
        )
    line = linregress(distance, values)
    half = t.ppf(0.975, len(values) - 2) * line.stderr
    found = {"slope": line.slope, "intercept": line.intercept, "slope_low": line.slope - half}
    return pd.Series(found | {"slope_high": line.slope + half, "p": line.pvalue, "n": len(values)})


def _surfaces(points, targets, radius):
    """Height of the triangle and slope (degrees) of the plane around each target, number of points.

    Heights are NaN without a triangle.
    """
    height, places = np.full(len(targets), np.nan), cKDTree(targets[:, :2])
    points = points[np.isfinite(places.query(points[:, :2], distance_upper_bound=radius)[0])]
    pairs = cKDTree(points[:, :2]).sparse_distance_matrix(places, radius, output_type="ndarray")
    counts = np.bincount(pairs["j"], minlength=len(targets))
    slope = _slopes(points[pairs["i"]] - targets[pairs["j"]], pairs["j"], len(targets))
    centre = targets[:, :2].mean(axis=0)
    try:
        mesh = Delaunay(points[:, :2] - centre)
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


def _circle(xy, diameter):
    """Centre, number of points, and the reason why there is no centre."""
    if len(xy) < FEWEST_ON_CIRCLE:
        return np.nan, np.nan, len(xy), "too few points"
    circle = fit_circle(xy, diameter=diameter if diameter and diameter > 0 else None)
    if max(np.hypot(*circle.centre), circle.radius) > POLE_SEARCH_M or np.isnan(circle.std):
        return np.nan, np.nan, len(xy), "no circle near"
    return *circle.centre, len(xy), ""


class _NoCorner(Exception):
    """The reason why points have no corner."""


def _corner(xy):
    """The corner where two lines meet, number of points, and the reason if there is no corner."""
    try:
        return *_refined_corner(xy, _two_lines(xy)), ""
    except _NoCorner as reason:
        return np.nan, np.nan, len(xy), str(reason)


def _two_lines(xy):
    """The line with the most points near it, and the line of the points beside it."""
    if len(xy) < FEWEST_ON_LINE:
        raise _NoCorner("too few points")
    first = _line(xy)
    rest = xy[np.abs(first.distances(xy)) > 2 * NEAR_LINE_M]
    if len(rest) < FEWEST_ON_LINE:
        raise _NoCorner("one line")
    return first, _line(rest)


def _refined_corner(xy, lines):
    """Where two lines meet that end there, and the number of points on them."""
    for _ in range(5):
        ways = np.stack([lines[0].direction, -lines[1].direction], axis=1)
        if abs(np.linalg.det(ways)) < np.sin(np.radians(30)):
            raise _NoCorner("one line")
        along = np.linalg.solve(ways, lines[1].centre - lines[0].centre)[0]
        corner = lines[0].centre + along * lines[0].direction
        sides = [_side(xy, corner, *pair) for pair in (lines, lines[::-1])]
        if min(side.sum() for side in sides) < FEWEST_ON_LINE:
            raise _NoCorner("too few points")
        lines = [fit_line(xy[side], robust=True) for side in sides]
    if np.hypot(*corner) > 0.5:  # another corner
        raise _NoCorner("no corner near")
    return *corner, int(sum(side.sum() for side in sides))


def _line(xy):
    """Line with the most points near it, of 300 through pairs of points."""
    start, end = xy[np.random.default_rng(0).integers(len(xy), size=(2, 300))]
    way = end - start
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    inside = np.abs(xy @ normal.T - (start * normal).sum(axis=1)) < NEAR_LINE_M
    inside[:, np.hypot(*way.T) <= 10 * NEAR_LINE_M] = False
    best = inside[:, np.argmax(inside.sum(axis=0))]
    return fit_line(xy[best] if best.any() else xy, robust=True)


def _side(xy, corner, line, other):
    """Mask of the points on a line, on their side of the corner and off the other line."""
    near = np.abs(line.distances(xy)) < NEAR_LINE_M
    near &= np.abs(other.distances(xy)) > 2 * NEAR_LINE_M
    along = (xy - corner) @ line.direction
    return near & (along * along[near].sum() > 0)


def _extent(points):
    """The extent of points in words."""
    points = np.asarray(points)
    (west, south), (east, north) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return f"x {west:.1f} to {east:.1f} m, y {south:.1f} to {north:.1f} m"
