"""Plan positions of poles and corners in a cloud compared with surveyed ones."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_choice, check_columns, check_points, refuse
from mmqa_lab.planes import fit_circle, fit_line
from mmqa_lab.stats import errors
from mmqa_lab.test_field.drives import GROSS, LEAST_GROSS_M, figures, mean_ends

__all__ = [
    "FEWEST_ON_CIRCLE", "POLE_SEARCH_M", "REPORT_SLICES", "SLICES", "plan_accuracy",
    "plan_differences",
]  # fmt: skip


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
        pairs = len(slices[kind]) and all(np.shape(one) == (2,) for one in slices[kind])
        refuse(
            not pairs, f"slices of {kind!r}", slices[kind] or "none", "one or more, low and high"
        )
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
    _say_free(targets)
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
    check_columns(table, ("dx_m", "dy_m", "reason"), "table")
    used = table[table["reason"].isin(["", np.nan])]
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
        row |= figures(np.hypot(off["dx_m"], off["dy_m"]), target)
    for name, column in (("mean_east", "dx_m"), ("mean_north", "dy_m")):
        rows[0] |= mean_ends(name, difference[column], target)
    return pd.DataFrame(rows)


def _say_free(targets):
    """Say how many poles have no diameter: seen from one side their centres are off by some mm."""
    poles = targets.get("kind", pd.Series("pole", targets.index)) == "pole"
    sizes = targets.get("diameter_m", pd.Series(np.nan, targets.index))
    free = int((poles & ~(sizes > 0)).sum())
    if free:
        told = f"{free} of {poles.sum()} poles have no diameter: seen from one side alone, their"
        warnings.warn(
            f"{told} centres lie some millimetres too far from the scanner.", stacklevel=3
        )


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
