"""Plan positions of poles and corners in a cloud, near where the reference says they are.

After EuroSDR 2013, mobile laser scanning, section 3.1.2.3 and equation 3-1: centres of poles,
corners of buildings and of curbs. In the report an operator measures them: curbs in a slice from
10 cm below to 50 cm above the ground, poles and buildings there and in a slice of a metre about 5 m
above the ground. Here circles and lines are fitted.
"""

import numpy as np
import pandas as pd

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab.planes import fit_circle, fit_line
from mmqa_lab.stats import errors

POLE_HEIGHTS = ((0.5, 1.5), (4.5, 5.5))
"""Metres above the foot between which points of a pole are taken: near the ground, and 5 m up. In
the lower slice of the report, 0.6 m thick, a distant thin pole has too few points."""

CORNER_HEIGHTS = {"building": (1.0, 3.0), "curb": (0.03, 0.10)}
"""Metres above the corner's foot between which points of its two faces are taken: our choice."""

FEWEST = 8
"""Points a circle needs: on fewer, seen from one side, it may fit on the wrong side of them."""

FEWEST_ON_LINE = 10
"""Points each line of a corner needs."""

SMALLEST_ANGLE = 30.0
"""Degrees between the two lines of a corner."""


def pole_positions(points, poles, *, heights=POLE_HEIGHTS, search=0.4):
    """Measure the centres of poles in a cloud.

    At each height the points near the reference axis get a circle, robustly (Cauchy loss of the
    distances from it), of the reference diameter where one is given, else of a free one.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    poles : DataFrame
        ``x_m``, ``y_m``, ``z_m`` of the foot; ``diameter_m`` where surveyed; ``pole`` (its name).
    heights : sequence of (float, float)
        Metres above the foot.
    search : float
        Points up to this far from the reference axis in plan are taken, m.

    Returns
    -------
    DataFrame
        One row a pole and height: ``pole``, ``height_m`` (middle), ``n``, ``dx_m``, ``dy_m``
        (cloud minus reference), ``std_m`` (of a centre coordinate), ``reason`` there is none.

    Raises
    ------
    ValueError
        If a point is not finite or ``search`` is not above zero.

    Notes
    -----
    Seen from one side, points cover less than half of the circle: with a free diameter centre and
    radius trade off along the line of sight, and a few centimetres are lost on a thin pole.

    Examples
    --------
    >>> turn, height = np.meshgrid(np.arange(0, 6.2, 0.1), np.arange(0, 6, 0.05))
    >>> post = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), height], axis=-1).reshape(-1, 3)
    >>> pole = pd.DataFrame({"x_m": [0.03], "y_m": 0.0, "z_m": 0.0, "diameter_m": 0.2})
    >>> pole_positions(post, pole)["dx_m"].round(6).unique().tolist()
    [-0.03]
    """
    points = check_points(points)
    check_positive(search, "search", unit="m")
    tree, origin = _plan_tree(points)
    rows = []
    for number, pole in enumerate(poles.to_dict("records")):
        place = np.array([pole["x_m"], pole["y_m"]]) - origin
        near = points[tree.query_ball_point(place, search)]
        for low, high in heights:
            above = near[:, 2] - pole["z_m"]
            xy = near[(above >= low) & (above <= high), :2] - origin - place
            centre, std, reason = _circle(xy, pole.get("diameter_m", np.nan), search)
            found = {"pole": pole.get("pole", number), "height_m": (low + high) / 2, "n": len(xy)}
            found |= {"x_m": pole["x_m"], "y_m": pole["y_m"]}
            found |= {"dx_m": centre[0], "dy_m": centre[1], "std_m": std, "reason": reason}
            rows.append(found)
    return pd.DataFrame(rows)


def corner_positions(points, corners, *, search=2.0, gate=0.5, tolerance=0.03, seed=0):
    """Measure corners of buildings and curbs in a cloud, as intersections of two lines in plan.

    Points of the faces near the reference get two lines: the one with the most points within the
    tolerance, then that of the rest, both fitted robustly (Tukey) to the points on their side of
    the corner.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres.
    corners : DataFrame
        ``x_m``, ``y_m``, ``z_m`` of the foot; ``kind`` (building or curb); ``corner`` (its name).
    search : float
        Points up to this far from the reference in plan are taken, m.
    gate : float
        A corner farther from the reference is another one, m.
    tolerance : float
        Points up to this far from a line belong to it, m.
    seed : int
        Of the pairs of points that lines are tried through.

    Returns
    -------
    DataFrame
        ``corner``, ``kind``, ``n`` (points of both lines), ``dx_m``, ``dy_m``, ``angle_deg``
        between the lines, ``reason`` there is no corner.

    Raises
    ------
    ValueError
        If a point is not finite, or tolerance or gate is not above zero.

    Examples
    --------
    >>> along, height = np.meshgrid(np.arange(0, 2, 0.02), np.arange(0.5, 4, 0.1))
    >>> face = np.stack([along, 0 * along, height], axis=-1).reshape(-1, 3)
    >>> cloud = np.concatenate([face, face[:, [1, 0, 2]]]) + [0.02, 0.0, 0.0]
    >>> corner = pd.DataFrame({"x_m": [0.0], "y_m": 0.0, "z_m": 0.0, "kind": "building"})
    >>> corner_positions(cloud, corner)[["dx_m", "dy_m", "angle_deg"]].round(6).to_numpy().tolist()
    [[0.02, 0.0, 90.0]]
    """
    points = check_points(points)
    check_positive(tolerance, "tolerance", unit="m")
    check_positive(gate, "gate", unit="m")
    tree, origin = _plan_tree(points)
    rng = np.random.default_rng(seed)
    rows = []
    for number, corner in enumerate(corners.to_dict("records")):
        low, high = CORNER_HEIGHTS[corner["kind"]]
        place = np.array([corner["x_m"], corner["y_m"]]) - origin
        near = points[tree.query_ball_point(place, search)]
        above = near[:, 2] - corner["z_m"]
        xy = near[(above >= low) & (above <= high), :2] - origin - place
        crossing, n, angle, reason = _corner(xy, tolerance, gate, rng)
        found = {"corner": corner.get("corner", number), "kind": corner["kind"], "n": n}
        found |= {"x_m": corner["x_m"], "y_m": corner["y_m"]}
        found |= {"dx_m": crossing[0], "dy_m": crossing[1], "angle_deg": angle, "reason": reason}
        rows.append(found)
    return pd.DataFrame(rows)


def plan_accuracy(table):
    """Summarise plan differences, as measured and with systematic easting and northing removed.

    Parameters
    ----------
    table : DataFrame
        ``dx_m``, ``dy_m``, ``reason``, from ``pole_positions`` or ``corner_positions``.

    Returns
    -------
    DataFrame
        Two rows, ``shift`` = kept and removed: ``n``, ``missing``; ``mean_east_mm``,
        ``mean_north_mm``, ``std_east_mm``, ``std_north_mm``; of the distances in plan ``mean_mm``,
        ``min_mm``, ``max_mm``, ``std_mm``; and ``rmse_mm``, the root of the mean squared distance
        (equation 3-1; ASPRS: RMSE_H).

    Examples
    --------
    >>> table = pd.DataFrame({"dx_m": [0.03, 0.03], "dy_m": [0.04, 0.04], "reason": ["", ""]})
    >>> plan_accuracy(table)["rmse_mm"].round(6).tolist()
    [50.0, 0.0]
    """
    used = table[table["reason"] == ""]
    difference = 1000 * used[["dx_m", "dy_m"]].to_numpy(dtype=np.float64)
    mean = difference.mean(axis=0) if len(used) else np.full(2, np.nan)
    counts = {"n": len(used), "missing": len(table) - len(used)}
    parts = (("kept", 0), ("removed", mean))
    return pd.DataFrame([{"shift": name} | counts | _plan(difference - p) for name, p in parts])


def _plan(difference):
    """The figures of one row, in mm, of differences in easting and northing (n, 2) in mm."""
    distance = np.hypot(*difference.T)
    east, north, plan = (errors(values) for values in (*difference.T, distance))
    ends = (distance.min(), distance.max()) if len(distance) else (np.nan, np.nan)
    return {
        "mean_east_mm": east.bias,
        "mean_north_mm": north.bias,
        "std_east_mm": east.std,
        "std_north_mm": north.std,
        "mean_mm": plan.bias,
        "min_mm": ends[0],
        "max_mm": ends[1],
        "std_mm": plan.std,
        "rmse_mm": plan.rmse,
    }


def _plan_tree(points):
    """Search tree over the plan, and the origin taken off."""
    from scipy.spatial import cKDTree

    origin = points[:, :2].mean(axis=0).round()
    return cKDTree(points[:, :2] - origin), origin


def _circle(xy, diameter, search):
    """Centre, its standard deviation and the reason there is none."""
    nothing = np.full(2, np.nan), np.nan
    if len(xy) < FEWEST:
        return *nothing, "too few points"
    circle = fit_circle(xy, diameter=diameter if np.isfinite(diameter) else None)
    far = np.hypot(*circle.centre) > search or circle.radius > search
    if far or np.isnan(circle.std):
        return *nothing, "no circle near"
    return circle.centre, circle.std, ""


def _corner(xy, tolerance, gate, rng):
    """Intersection of the two lines, their points, the angle between them, the reason of none."""
    nothing = np.full(2, np.nan), 0, np.nan
    if len(xy) < 2 * FEWEST_ON_LINE:
        return *nothing, "too few points"
    first = _line(xy, tolerance, rng)
    rest = xy[np.abs(first.distances(xy)) > 2 * tolerance]
    if len(rest) < FEWEST_ON_LINE:
        return *nothing, "one line"
    second = _line(rest, tolerance, rng)
    for _ in range(5):
        crossing, angle = _crossing(first, second)
        if angle < SMALLEST_ANGLE:
            return *nothing, "one line"
        masks = _sides(xy, first, second, crossing, tolerance)
        if min(mask.sum() for mask in masks) < FEWEST_ON_LINE:
            return *nothing, "too few points"
        first, second = (fit_line(xy[mask], robust=True) for mask in masks)
    crossing, angle = _crossing(first, second)
    if np.hypot(*crossing) > gate:
        return *nothing, "no corner near"
    return crossing, int(sum(mask.sum() for mask in masks)), angle, ""


def _line(xy, tolerance, rng, tries=300):
    """Line with the most points within the tolerance, of those through pairs of points."""
    pairs = rng.integers(len(xy), size=(tries, 2))
    start, way = xy[pairs[:, 0]], xy[pairs[:, 1]] - xy[pairs[:, 0]]
    length = np.hypot(*way.T)
    long = length > 10 * tolerance
    if not long.any():
        return fit_line(xy, robust=True)
    normal = np.stack([-way[long, 1], way[long, 0]], axis=1) / length[long, None]
    off = xy @ normal.T - (start[long] * normal).sum(axis=1)
    inside = np.abs(off) < tolerance
    best = np.argmax(inside.sum(axis=0))
    return fit_line(xy[inside[:, best]], robust=True)


def _crossing(first, second):
    """Where two lines meet, and the angle between them in degrees."""
    ways = np.stack([first.direction, -second.direction], axis=1)
    turn = abs(np.linalg.det(ways))
    angle = float(np.degrees(np.arcsin(min(turn, 1.0))))
    if turn < 1e-6:
        return np.full(2, np.nan), angle
    along = np.linalg.solve(ways, second.centre - first.centre)
    return first.centre + along[0] * first.direction, angle


def _sides(xy, first, second, crossing, tolerance):
    """Points of each line on its side of the corner, and clear of the other line."""
    masks = []
    for line, other in ((first, second), (second, first)):
        near = np.abs(line.distances(xy)) < tolerance
        clear = np.abs(other.distances(xy)) > 2 * tolerance
        along = (xy - crossing) @ line.direction
        side = np.sign(np.median(along[near & clear])) if (near & clear).any() else 1
        masks.append(near & clear & (along * side > 0))
    return masks
