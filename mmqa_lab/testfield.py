"""The accuracy of point clouds on a test field: heights, plan positions, growth with distance.

EuroSDR 2013, mobile laser scanning, chapter 3 (Finnish Geodetic Institute): five systems on one
field whose ground, poles and corners were surveyed (section 3.1), evaluated after systematic errors
were removed (section 3.2). Start here::

    from mmqa_lab import testfield

    table = testfield.height_differences(cloud, reference)          # why, where there is none
    testfield.height_accuracy(table)                                # shift kept, shift removed
    table["distance_m"] = testfield.distance_to_path(reference, trajectory)
    testfield.trend(table["distance_m"], (table["dz_m"] - table["dz_m"].mean()).abs())
    testfield.plan_accuracy(testfield.plan_differences(cloud, targets))

ASPRS Positional Accuracy Standards (edition 2, 2023) call the RMSE of height with the shift kept
RMSE_V, that of the plan (equation 3-1) RMSE_H, and add to both the uncertainty of the check points'
own survey. They have given up 95 % confidence levels, and ask for 30 check points or more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mmqa_lab._checks import (
    check_choice,
    check_number,
    check_plan,
    check_points,
    check_positive,
)
from mmqa_lab._results import Shown
from mmqa_lab.cloud import Cloud, path_distance
from mmqa_lab.planes import fit_circle, fit_line
from mmqa_lab.stats import blocks, errors, mean_reach

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

__all__ = [
    "Accuracy",
    "compare_heights",
    "compare_plan",
    "distance_to_path",
    "height_accuracy",
    "height_differences",
    "plan_accuracy",
    "plan_differences",
    "split_drives",
    "thinned",
    "trend",
]
__dir__ = __all__.copy

CHECKPOINTS = 30
"""Fewest that the ASPRS standards ask for."""

FAR_MM = 1000.0
"""A median height difference beyond this is no error of a scan: said."""

CHUNK = 5000
"""Reference points worked on at a time, with the points around them."""

GROSS = 5.0
"""Differences so many NMAD from the median are gross errors."""

REASONS = ("", "no points", "not surrounded", "slope", "gross error")
"""Why a reference point has no valid difference; empty where it has."""

SLICES = {
    "pole": ((0.5, 1.5), (4.5, 5.5)),
    "building": ((1.0, 3.0),),
    "curb": ((0.03, 0.10),),
    "mark": ((-0.1, 0.1),),
}
"""Metres above a target's foot between which its points are taken, by its kind: our choice."""

REPORT_SLICES = {
    "pole": ((-0.1, 0.5), (4.5, 5.5)),
    "building": ((-0.1, 0.5), (4.5, 5.5)),
    "curb": ((-0.1, 0.5),),
    "mark": ((-0.1, 0.5),),
}
"""Those of the report, section 3.1.2.3. In the lower one, 0.6 m thick, a distant thin pole has few
points, and the ground is part of it."""

FEWEST = 8
"""Points a circle or a mark needs: on fewer, a circle may fit on the wrong side of them."""

FEWEST_ON_LINE = 10
"""Points each line of a corner needs."""

SMALLEST_ANGLE = 30.0
"""Degrees between the two lines of a corner."""

CORNER_SEARCH_M, CORNER_GATE_M = 2.0, 0.5
"""Points up to the first from a corner in plan are taken; one beyond the second is another one."""

NEAR_LINE_M = 0.03
"""Points up to this far from a line belong to it."""


@dataclass(frozen=True, eq=False)
class Accuracy(Shown):
    """What a comparison with a survey gives.

    Parameters
    ----------
    summary : DataFrame
        From :func:`height_accuracy` or, by kind of target, :func:`plan_accuracy`.
    differences : DataFrame
        From :func:`height_differences` or :func:`plan_differences`.
    remarks : str
        What a reader of the summary should know.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 8, 0.1), np.arange(0, 8, 0.1))
    >>> cloud = np.stack([x, y, 0 * x + 0.02], axis=-1).reshape(-1, 3)
    >>> found = compare_heights(cloud, np.c_[cloud[200::300, :2], np.zeros(21)] + [0.03, 0.04, 0])
    >>> found.summary["mean_mm"].round(3).tolist(), found.remarks[:14]
    ([20.0, 0.0], '21 differences')
    """

    summary: pd.DataFrame
    differences: pd.DataFrame
    remarks: str = ""

    def to_frame(self) -> pd.DataFrame:
        """Return the summary with the remarks."""
        return self.summary.assign(remarks=self.remarks)

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the differences that count: a histogram of heights, or easting and northing."""
        from mmqa_lab import plots

        ax = plots.subplots()[1] if ax is None else ax
        used = self.differences[self.differences["reason"] == ""]
        if "dz_m" in used:
            ax.hist(1000 * used["dz_m"], bins=30)
            ax.set(xlabel="cloud less reference (mm)", ylabel="reference points")
            return ax
        ax.plot(1000 * used["dx_m"], 1000 * used["dy_m"], ".")
        ax.set(xlabel="easting, cloud less reference (mm)", ylabel="northing (mm)", aspect="equal")
        return ax


def compare_heights(
    points: ArrayLike,
    reference: ArrayLike,
    *,
    path: ArrayLike | None = None,
    radius: float = 0.2,
    slope_limit: float = 20.0,
) -> Accuracy:
    """Compare a cloud with surveyed heights: differences, figures, growth with distance, remarks.

    Parameters
    ----------
    points, reference, radius, slope_limit
        As of :func:`height_differences`.
    path : array_like, shape (k, 2 or 3), optional
        Vertices of the trajectory: adds the trend of absolute differences, their shift removed,
        over the distance from it.

    Returns
    -------
    Accuracy
        The summary also counts reference points without a valid difference, by reason.

    Raises
    ------
    ValueError
        As of :func:`height_differences`, and if no difference is valid.
    """
    table = height_differences(points, reference, radius=radius, slope_limit=slope_limit)
    used = table[table["reason"] == ""]
    if used.empty:
        raise ValueError(
            f"Invalid reference: no surface of the cloud ({_extent(points)}) lies around a point "
            f"of it ({_extent(reference)}). Must overlap, in one coordinate system."
        )
    summary = height_accuracy(table)
    for reason in REASONS[1:]:
        summary[reason.replace(" ", "_")] = int((table["reason"] == reason).sum())
    if path is not None:
        size = 1000 * (used["dz_m"] - used["dz_m"].mean()).abs()
        line = trend(distance_to_path(used[["x_m", "y_m"]], path), size)
        for name in ("slope", "slope_low", "slope_high"):
            summary[f"{name.replace('slope', 'trend')}_mm_per_m"] = line[name]
    return Accuracy(summary, table, _height_remarks(table, used))


def compare_plan(points: ArrayLike, targets: pd.DataFrame) -> Accuracy:
    """Compare a cloud with surveyed plan positions: each kind of target, and all together.

    Parameters
    ----------
    points, targets
        As of :func:`plan_differences`.

    Returns
    -------
    Accuracy

    Raises
    ------
    ValueError
        As of :func:`plan_differences`, and if no target is measured.
    """
    table = plan_differences(points, targets)
    missing = table["reason"][table["reason"] != ""]
    if len(missing) == len(table):
        raise ValueError(
            f"Invalid targets: none measured in the cloud ({', '.join(sorted(set(missing)))}). "
            f"Must lie in it ({_extent(points)}), with the height of the foot."
        )
    parts = [*table.groupby("kind", sort=False), ("all", table)]
    summary = pd.concat([plan_accuracy(rows).assign(kind=kind) for kind, rows in parts])
    summary.insert(0, "kind", summary.pop("kind"))
    remark = ""
    if len(missing) > len(table) / 2:
        remark = (
            f"{len(missing)} of {len(table)} slices of targets were not measured (most: "
            f"{missing.mode()[0]}): the heights of the feet or the coordinate systems may differ, "
            "or the cloud is too sparse for them."
        )
    return Accuracy(summary.reset_index(drop=True), table, remark)


def height_differences(
    points: Cloud | ArrayLike,
    reference: ArrayLike,
    *,
    radius: float = 0.2,
    slope_limit: float = 20.0,
    gross_limit: float | None = None,
    rule: str = "triangulation",
    progress: bool = False,
) -> pd.DataFrame:
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
    rule : {"triangulation", "report"}
        As above, or as the report words it: the plane of the three nearest points gives the height,
        and its own slope is limited.
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
        If an array is not made of finite points, a limit is not above zero or the rule is unknown.

    Notes
    -----
    A triangulated surface averages little: the difference carries about 0.7 of a single point's
    noise (root of the mean of the sum of squared barycentric coordinates, 1/2).

    In the report gross errors were looked at and removed by hand.

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
    from tqdm.auto import tqdm

    points, reference = check_points(points), check_points(reference, name="reference points")
    radius = check_positive(radius, "radius", unit="m")
    check_number(slope_limit, "slope_limit", low=0, high=90, unit="degrees")
    rules = {"triangulation": _surfaces, "report": _three_nearest}
    surfaces = rules[check_choice(rule, "rule", rules)]
    origin = reference.mean(axis=0).round()
    local, targets = points - origin, reference - origin
    local = local[np.argsort(local[:, 0], kind="stable")]
    order = np.argsort(targets[:, 0], kind="stable")
    near, counts = np.full((len(targets), 2), np.nan), np.zeros(len(targets), dtype=int)
    for first in tqdm(range(0, len(order), CHUNK), disable=not progress, unit="chunk"):
        part = order[first : first + CHUNK]
        around = _within(local, targets[part], radius)
        if len(around):
            near[part], counts[part] = surfaces(around, targets[part], radius)
    dz, slope = near[:, 0] - targets[:, 2], near[:, 1]
    conditions = [counts == 0, np.isnan(dz), slope > slope_limit]
    reason = np.select(conditions, REASONS[1:4], default=REASONS[0]).astype(object)
    reason[(reason == "") & _gross(dz, reason == "", gross_limit)] = "gross error"
    table = pd.DataFrame(reference, columns=["x_m", "y_m", "reference_m"])
    return table.assign(n=counts, dz_m=dz, slope_deg=slope, reason=reason)


def height_accuracy(table: pd.DataFrame) -> pd.DataFrame:
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
        that 90 % of all stay within; 95 % intervals of the shift and the RMSE (``mean_low_mm``,
        ``mean_high_mm``, ``rmse_low_mm``, ``rmse_high_mm``).

    Raises
    ------
    ValueError
        If a column is missing.

    Notes
    -----
    With the shift kept the figures are absolute accuracy and depend on the height system of the
    reference; with the shift removed they describe the scatter. LE90 is taken from the differences,
    not as 1.645 RMSE, which is right for normal errors without a shift only.

    The intervals are for other reference points on the same drives. They follow from the sums of
    4 x 4 blocks of the field (:func:`mmqa_lab.stats.mean_reach`), that of the RMSE on its
    logarithm; without ``x_m`` and ``y_m`` differences are taken as independent. What errors of the
    path have in common over all of the field, they do not contain.

    Examples
    --------
    >>> table = pd.DataFrame({"dz_m": [0.01, 0.02, 0.03], "reason": ["", "", ""]})
    >>> height_accuracy(table)["rmse_mm"].round(2).tolist()
    [21.6, 8.16]
    """
    if "dz_m" not in table or "reason" not in table:
        raise ValueError("Invalid table. Must have the columns dz_m and reason.")
    used = table[table["reason"] == ""]
    dz = 1000 * used["dz_m"].to_numpy(dtype=np.float64)
    block = np.arange(len(used))
    if {"x_m", "y_m"} <= set(used) and len(used):
        block = blocks(used[["x_m", "y_m"]])
    shift = dz.mean() if len(dz) else np.nan
    kept = {"shift": "kept", **_summary(dz, block), **_mean_ends("mean", shift, dz, block)}
    return pd.DataFrame([kept, {"shift": "removed", **_summary(dz - shift, block)}])


def split_drives(gps_time: ArrayLike, *, gap_s: float = 3600.0) -> np.ndarray:
    """Return the number of the drive of each point: a gap in time begins a new one.

    Parameters
    ----------
    gps_time : array_like, shape (n,)
        Seconds, in any order. A drive over the end of a GPS week, where they begin again, is one.
    gap_s : float
        Shortest gap, s. A drive may pass a place more than once; an hour is another drive.

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
    >>> split_drives([604_799.0, 0.5, 90_000.0]).tolist()
    [1, 1, 0]
    """
    time = np.asarray(gps_time, dtype=np.float64)
    if time.ndim != 1 or not len(time) or not np.isfinite(time).all():
        raise ValueError(f"Invalid gps_time of shape {time.shape}. Must be finite seconds.")
    gap = check_positive(gap_s, "gap_s", unit="s")
    order = np.argsort(time, kind="stable")
    number = np.empty(len(time), dtype=int)
    number[order] = np.cumsum(np.diff(time[order], prepend=time[order[0]]) > gap)
    if time.min() >= 0 and time.max() <= 604_800.0 <= np.ptp(time) + gap:
        number = np.where(number, number, number.max()) - min(number.max(), 1)
    return number


def plan_differences(
    points: Cloud | ArrayLike,
    targets: pd.DataFrame,
    *,
    slices: dict[str, Sequence[tuple[float, float]]] | None = None,
    search: float = 0.4,
    gross_limit: float | None = None,
) -> pd.DataFrame:
    """Measure the plan positions of targets in a cloud.

    In each slice of height the points near a pole get a circle, robustly (Cauchy loss of the
    distances from it), of the reference diameter where one is given. Points of the two faces of a
    corner get two lines: the one with the most points within 3 cm, then that of the rest,
    both fitted robustly (Tukey) to the points on their side of the corner. The centre of a mark is
    that of its points brighter than halfway from dark to bright.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Metres; a ``Cloud`` with ``intensity`` for marks.
    targets : DataFrame
        ``x_m``, ``y_m``, ``z_m`` of the foot; ``kind``, pole (where the column is missing),
        building or curb (corners) or mark; ``name``; ``diameter_m`` of poles where surveyed.
    slices : dict of str to sequence of (float, float), optional
        Metres above the foot for each kind; ``SLICES`` by default.
    search : float
        Points up to this far from a pole or mark in plan are taken, m.
    gross_limit : float, optional
        Largest distance in plan of a difference from the median, m. By default five times the
        standard deviation that the median of these distances stands for, but 1 cm at least.

    Returns
    -------
    DataFrame
        One row a target and slice: ``name``, ``kind``, ``x_m``, ``y_m``, ``height_m`` (middle of
        the slice), ``n`` points used, ``dx_m``, ``dy_m`` (cloud minus reference), ``reason`` there
        are none, or "gross error": a line or circle of something else. Such rows keep their values.

    Raises
    ------
    ValueError
        If a point is not finite, a length is not above zero or a kind is unknown.

    Notes
    -----
    Seen from one side, points cover less than half of a circle: with a free diameter centre and
    radius trade off along the line of sight, and a few centimetres are lost on a thin pole.

    References
    ----------
    EuroSDR 2013, mobile laser scanning, section 3.1.2.3. There an operator measured the targets,
    curbs in the lower slice, poles and buildings in both; circles were fitted to poles by eye.

    Examples
    --------
    >>> turn, height = np.meshgrid(np.arange(0, 6.2, 0.1), np.arange(0, 6, 0.05))
    >>> post = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), height], axis=-1).reshape(-1, 3)
    >>> pole = pd.DataFrame({"x_m": [0.03], "y_m": 0.0, "z_m": 0.0, "diameter_m": 0.2})
    >>> plan_differences(post, pole)["dx_m"].round(6).unique().tolist()
    [-0.03]
    """
    from scipy.spatial import cKDTree

    cloud = points if isinstance(points, Cloud) else Cloud(points)
    check_positive(search, "search", unit="m")
    slices = slices or SLICES
    origin = cloud.points[:, :2].mean(axis=0).round()
    tree = cKDTree(cloud.points[:, :2] - origin)
    rng = np.random.default_rng(0)
    rows = []
    for number, target in enumerate(targets.to_dict("records")):
        kind = check_choice(target.get("kind", "pole"), "kind", slices)
        place = np.array([target["x_m"], target["y_m"]]) - origin
        reach = CORNER_SEARCH_M if kind in ("building", "curb") else search
        near = np.array(tree.query_ball_point(place, reach), dtype=int)
        above = cloud.points[near, 2] - target["z_m"]
        for low, high in slices[kind]:
            index = near[(above >= low) & (above <= high)]
            xy = cloud.points[index, :2] - origin - place
            if kind == "pole":
                found = _circle(xy, target.get("diameter_m", np.nan), search)
            elif kind == "mark":
                found = _mark(xy, cloud["intensity"][index])
            else:
                found = _corner(xy, rng)
            named = {"name": target.get("name", number), "kind": kind}
            named |= {"x_m": target["x_m"], "y_m": target["y_m"], "height_m": (low + high) / 2}
            rows.append(named | dict(zip(("dx_m", "dy_m", "n", "reason"), found, strict=True)))
    table = pd.DataFrame(rows)
    table.loc[_far(table, gross_limit), "reason"] = "gross error"
    return table


def plan_accuracy(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise plan differences, as measured and with systematic easting and northing removed.

    Parameters
    ----------
    table : DataFrame
        ``dx_m``, ``dy_m``, ``reason``, from ``plan_differences``.

    Returns
    -------
    DataFrame
        Two rows, ``shift`` = kept and removed: ``n``, ``missing``; ``mean_east_mm``,
        ``mean_north_mm``, ``std_east_mm``, ``std_north_mm``; of the distances in plan ``mean_mm``,
        ``min_mm``, ``max_mm``, ``std_mm``; and ``rmse_mm``, the root of the mean squared distance
        (equation 3-1; ASPRS: RMSE_H). 95 % intervals of the shift and the RMSE, as
        ``mean_east_low_mm`` and ``mean_east_high_mm``.

    Notes
    -----
    The intervals are for other targets on the same drives: all slices of a target are one value,
    targets are taken as independent. See :func:`height_accuracy`.

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
    target = np.arange(len(used))
    if {"x_m", "y_m"} <= set(used):
        target = used.groupby(["x_m", "y_m"]).ngroup().to_numpy()
    ends = [
        _mean_ends(name, *given, target)
        for name, *given in zip(("mean_east", "mean_north"), mean, difference.T, strict=True)
    ]
    kept = {"shift": "kept"} | counts | _plan(difference, target) | ends[0] | ends[1]
    return pd.DataFrame([kept, {"shift": "removed"} | counts | _plan(difference - mean, target)])


def _mean_ends(name, mean, values, block):
    """The 95 % interval of a mean, mm."""
    reach = mean_reach(values, block)
    return {f"{name}_low_mm": mean - reach, f"{name}_high_mm": mean + reach}


def _rmse_ends(rmse, values, block):
    """The 95 % interval of an RMSE, on its logarithm, mm."""
    share = mean_reach(values**2, block) / np.maximum(rmse**2, 1e-300) / 2
    return {"rmse_low_mm": rmse * np.exp(-share), "rmse_high_mm": rmse * np.exp(share)}


def _plan(difference, target):
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
        **_rmse_ends(plan.rmse, distance, target),
    }


def thinned(points: Cloud | ArrayLike, side: float) -> np.ndarray:
    """Return one point of each square in plan: the one nearest its middle.

    Parameters
    ----------
    points : array_like, shape (n, 3)
    side : float
        Of the squares, m.

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
    column, row = (local // side).astype(np.int64).T
    gap = np.hypot(*(local % side - side / 2).T)
    nearest = pd.Series(gap).groupby(column * (row.max() + 1) + row).idxmin()
    return points[nearest.to_numpy()]


def trend(distance: ArrayLike, values: ArrayLike) -> pd.Series:
    """Fit a straight line of errors over distance, robustly.

    Huber's estimator (statsmodels RLM), so that a few far poles do not tilt the line; its standard
    error with Student's t of n - 2, which few poles need.

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
    The interval takes errors as independent. Along one drive they are not: a drift of the
    trajectory moves all points of a stretch together, and the true interval is wider.

    Examples
    --------
    >>> found = trend([5, 10, 15, 20], [6.0, 11.0, 16.0, 21.1])
    >>> found[["slope", "n"]].round(2).tolist()
    [1.01, 4.0]
    """
    from scipy.stats import t
    from statsmodels.robust.robust_linear_model import RLM

    distance, values = np.asarray(distance, np.float64), np.asarray(values, np.float64)
    known = np.isfinite(values) & np.isfinite(distance)
    distance, values = distance[known], values[known]
    if len(values) < 3 or np.ptp(distance) == 0:
        raise ValueError(
            f"Invalid errors: {len(values)} at {len(np.unique(distance))} distances. Must be three "
            "or more at different distances."
        )
    design = np.stack([np.ones_like(distance), distance], axis=1)
    names = ("slope", "intercept", "slope_low", "slope_high", "p", "n")
    slope, intercept = np.polyfit(distance, values, 1)
    if np.ptp(values - slope * distance) < 1e-12:  # robust scale 0
        return pd.Series([slope, intercept, slope, slope, 0.0, len(values)], names)
    fit = RLM(values, design).fit()
    (intercept, slope), std = fit.params, fit.bse[1]
    half = t.isf((1 - 0.95) / 2, len(values) - 2) * std
    p = 2 * t.sf(np.abs(slope) / std, len(values) - 2)
    return pd.Series([slope, intercept, slope - half, slope + half, p, len(values)], names)


def distance_to_path(points: Cloud | ArrayLike, path: ArrayLike | pd.DataFrame) -> np.ndarray:
    """Return the distance in plan of points from a path.

    Parameters
    ----------
    points : array_like, shape (n, 2 or 3)
        Metres.
    path : array_like, shape (m, 2 or 3), or DataFrame
        Vertices in order, m >= 2, or a table with ``easting_m`` and ``northing_m``.

    Returns
    -------
    array, shape (n,)

    Raises
    ------
    ValueError
        If the path has fewer than two vertices or a value is not finite.

    Examples
    --------
    >>> distance_to_path([[3, 5, 0], [0, 14, 0]], [[0, 0], [0, 10]]).tolist()
    [3.0, 4.0]
    """
    path = check_plan(path, name="path", minimum=2)
    points = check_plan(points)
    origin = path.mean(axis=0).round()
    return path_distance(points - origin, path - origin)


def _summary(values, block):
    """The figures of one row of an accuracy table, in mm, of differences in mm."""
    found = errors(values)
    known = values if len(values) else np.array([np.nan])
    return {
        "n": found.n,
        "mean_mm": round(found.bias, 9) + 0.0,  # never -0
        "median_mm": found.median,
        "min_mm": known.min(),
        "max_mm": known.max(),
        "std_mm": found.std,
        "rmse_mm": found.rmse,
        "nmad_mm": found.nmad,
        "le90_mm": np.quantile(np.abs(known), 0.9),
        **_rmse_ends(found.rmse, values, block),
    }


def _gross(dz, valid, limit):
    """Which valid differences lie too far from their median."""
    if not valid.any():
        return np.zeros(len(dz), dtype=bool)
    found = errors(dz[valid])
    if limit is None:
        limit = max(GROSS * found.nmad, 0.01)
    return np.abs(dz - found.median) > check_positive(limit, "gross_limit", unit="m")


def _within(local, targets, radius):
    """Points within the radius of the x and y range of targets, both in the order of x."""
    low, high = targets[:, :2].min(axis=0) - radius, targets[:, :2].max(axis=0) + radius
    points = local[slice(*np.searchsorted(local[:, 0], [low[0], high[0]]))]
    return points[(points[:, 1] >= low[1]) & (points[:, 1] <= high[1])]


def _three_nearest(points, targets, radius):
    """Height and slope (degrees) of the plane of the three nearest points, and points near."""
    from scipy.spatial import cKDTree

    tree, places = cKDTree(points[:, :2]), targets[:, :2]
    counts = tree.query_ball_point(places, radius, return_length=True)
    found = np.full((len(targets), 2), np.nan)
    if len(points) >= 3:
        enough = counts >= 3
        corners = points[tree.query(places[enough], 3)[1]] - targets[enough, None]
        found[enough] = _facets(corners)
        found[enough, 0] += targets[enough, 2]
    return found, counts


def _facets(corners):
    """Height at the origin and slope (degrees) of triangles (n, 3, 3), NaN of upright ones."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = a[:, 2] + (a[:, :2] * normal[:, :2]).sum(axis=1) / normal[:, 2]
        slope = np.degrees(np.arctan(np.hypot(*normal[:, :2].T) / np.abs(normal[:, 2])))
    return np.column_stack([np.where(np.isfinite(height), height, np.nan), slope])


def _surfaces(points, targets, radius):
    """Height of the triangle and slope (degrees) of the plane about each target, and points near.

    Returns arrays of shape (m, 2), NaN where there is no such triangle, and (m,).
    """
    from scipy.spatial import cKDTree

    found, nothing = np.full((len(targets), 2), np.nan), np.zeros(len(targets), dtype=int)
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
    heights[inside[close]] = _facets(corners[close])[:, 0] + targets[inside[close], 2]
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


def _far(table, limit):
    """Which measured differences in plan lie too far from their median."""
    used = table["reason"] == ""
    off = np.hypot(*(table[["dx_m", "dy_m"]] - table.loc[used, ["dx_m", "dy_m"]].median()).T.values)
    if limit is None:  # the median of normal errors in two directions is root(2 ln 2) of one
        limit = max(GROSS * np.median(off[used]) / np.sqrt(2 * np.log(2)), 0.01) if any(used) else 1
    return used & (off > check_positive(limit, "gross_limit", unit="m"))


def _circle(xy, diameter, search):
    """Centre, points, and the reason there is none."""
    if len(xy) < FEWEST:
        return np.nan, np.nan, len(xy), "too few points"
    circle = fit_circle(xy, diameter=diameter if np.isfinite(diameter) else None)
    far = np.hypot(*circle.centre) > search or circle.radius > search
    if far or np.isnan(circle.std):
        return np.nan, np.nan, len(xy), "no circle near"
    return *circle.centre, len(xy), ""


def _mark(xy, intensity):
    """Centre of the bright points, their number, and the reason there is none."""
    if len(xy) < FEWEST or np.ptp(intensity) == 0:
        return np.nan, np.nan, 0, "too few points"
    bright = xy[intensity > np.quantile(intensity, [0.02, 0.98]).mean()]
    return *((bright.min(axis=0) + bright.max(axis=0)) / 2), len(bright), ""


def _corner(xy, rng):
    """Intersection of the two lines, their points, and the reason there is none."""
    nothing = np.nan, np.nan, 0
    if len(xy) < 2 * FEWEST_ON_LINE:
        return *nothing, "too few points"
    first = _line(xy, rng)
    rest = xy[np.abs(first.distances(xy)) > 2 * NEAR_LINE_M]
    if len(rest) < FEWEST_ON_LINE:
        return *nothing, "one line"
    second = _line(rest, rng)
    for _ in range(5):
        crossing, angle = _crossing(first, second)
        if angle < SMALLEST_ANGLE:
            return *nothing, "one line"
        masks = _sides(xy, first, second, crossing)
        if min(mask.sum() for mask in masks) < FEWEST_ON_LINE:
            return *nothing, "too few points"
        first, second = (fit_line(xy[mask], robust=True) for mask in masks)
    crossing = _crossing(first, second)[0]
    if np.hypot(*crossing) > CORNER_GATE_M:
        return *nothing, "no corner near"
    return *crossing, int(sum(mask.sum() for mask in masks)), ""


def _line(xy, rng):
    """Line with the most points near it, of 300 through pairs of points."""
    pairs = rng.integers(len(xy), size=(300, 2))
    start, way = xy[pairs[:, 0]], xy[pairs[:, 1]] - xy[pairs[:, 0]]
    length = np.hypot(*way.T)
    long = length > 10 * NEAR_LINE_M
    if not long.any():
        return fit_line(xy, robust=True)
    normal = np.stack([-way[long, 1], way[long, 0]], axis=1) / length[long, None]
    off = xy @ normal.T - (start[long] * normal).sum(axis=1)
    inside = np.abs(off) < NEAR_LINE_M
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


def _sides(xy, first, second, crossing):
    """Points of each line on its side of the corner, and clear of the other line."""
    masks = []
    for line, other in ((first, second), (second, first)):
        near = np.abs(line.distances(xy)) < NEAR_LINE_M
        clear = np.abs(other.distances(xy)) > 2 * NEAR_LINE_M
        along = (xy - crossing) @ line.direction
        side = np.sign(np.median(along[near & clear])) if (near & clear).any() else 1
        masks.append(near & clear & (along * side > 0))
    return masks


def _extent(points):
    """Where points lie, in words."""
    points = np.asarray(points)
    (west, south), (east, north) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return f"x {west:.1f} to {east:.1f} m, y {south:.1f} to {north:.1f} m"


def _height_remarks(table, used):
    """What a reader of the figures of heights should know."""
    apart = int(table["reason"].isin(REASONS[1:3]).sum())
    far = used["dz_m"].median()
    doubts = {
        f"{apart} of {len(table)} reference points lie where the cloud has no surface: the units "
        "or the coordinate systems may differ.": apart > len(table) / 2,
        f"{len(used)} differences; the ASPRS standards ask for {CHECKPOINTS} check points or "
        "more.": len(used) < CHECKPOINTS,
        f"The median difference is {far:+.2f} m; the two height systems may differ (ellipsoid or "
        "geoid).": abs(1000 * far) > FAR_MM,
    }
    return " ".join(text for text, true in doubts.items() if true)
