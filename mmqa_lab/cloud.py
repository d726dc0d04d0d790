"""The container that every room hands on: points and their named columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from mmqa_lab._checks import (
    check_choice,
    check_columns,
    check_plan,
    check_points,
    check_positive,
    check_same_crs,
    real_array,
    refuse,
    remark_on_map,
)

if TYPE_CHECKING:
    from pyproj import CRS

__all__ = [
    "Cloud", "cells_of", "describe", "extent", "group_axes", "path_distance", "sort_into_cells",
    "step_of", "unit_remarks",
]  # fmt: skip

# More points in a square of one unit's side than any survey in metres has: the unit is degrees.
CROWDED = 1e8

# Neighbours of a mobile mapping cloud lie nearer than this, m.
FARTHEST_NEIGHBOUR_M = 1.5

# Edges of buildings are shorter than this, m.
LONGEST_EDGE_M = 300.0

# Points this share of a cell below a border lie on it.
ON_BORDER = 1e-6

LIKE_DEGREES = "Coordinates look like degrees, but are taken for metres."

# Points below which nothing is said of a unit.
FEWEST_FOR_UNIT = 50


@dataclass(frozen=True, eq=False, repr=False)
class Cloud:
    """Points and the attributes that came with them.

    A cloud is an array (``np.asarray(cloud)``, shape (n, 3)), it is indexed like one (masks,
    slices, index arrays give a cloud; a number gives a point, ``cloud[:, :2]`` coordinates), and
    ``cloud["ring"]`` is a column.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Easting, northing, height in metres, float64.
    columns : dict of str to array, shape (n,)
        Named values of each point, kept as read: ``gps_time``, ``intensity``, ``ring``, ...
    name : str
        Where the cloud comes from, for tables and figures.
    resolution : float
        The step that the coordinates were rounded to when they were stored, m; the coarsest of
        the three axes. NaN where it is not known.
    crs : pyproj.CRS, optional
        The coordinate reference system that the file names; None where it is not known.

    Raises
    ------
    ValueError
        If a coordinate is not finite or a column is not as long as the points.

    Examples
    --------
    >>> cloud = Cloud([[0, 0, 0], [1, 0, 0]], {"ring": [3, 4]})
    >>> len(cloud), cloud["ring"].tolist()
    (2, [3, 4])
    >>> cloud[cloud["ring"] == 4].points.tolist()
    [[1.0, 0.0, 0.0]]
    >>> cloud
    <Cloud '': 2 points, columns ring>
    """

    points: np.ndarray
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    name: str = ""
    resolution: float = np.nan
    crs: CRS | None = None

    if TYPE_CHECKING:  # what is array_like goes in, and arrays come out

        def __init__(
            self, points: ArrayLike, columns: Mapping[str, ArrayLike] = ...,
            name: str = "", resolution: float = ..., crs: CRS | None = None,
        ): ...  # fmt: skip

    def __post_init__(self):
        points = check_points(self.points, minimum=0)
        columns = {key: np.asarray(values) for key, values in self.columns.items()}
        for key, values in columns.items():
            if values.shape[:1] != (len(points),):
                found = f"column {key!r} of shape {values.shape}"
                raise ValueError(f"Invalid {found}. Must have {len(points)} rows.")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.points, dtype=dtype, copy=copy)

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, which: Any) -> Any:
        if isinstance(which, str):
            return self.columns[check_choice(which, "column", self.columns)]
        points = self.points[which]
        if isinstance(which, tuple) or points.ndim == 1:
            return points
        columns = {key: values[which] for key, values in self.columns.items()}
        return Cloud(points, columns, self.name, self.resolution, self.crs)

    def __repr__(self) -> str:
        columns = ", ".join(self.columns) or "none"
        return f"<Cloud {self.name!r}: {len(self)} points, columns {columns}>"

    @classmethod
    def concatenate(cls, clouds: Iterable[Cloud], *, name: str = "") -> Cloud:
        """Return one cloud of several, with the columns that all of them have.

        Raises
        ------
        ValueError
            If they have different coordinate reference systems, or one that is not in metres.
        """
        clouds = list(clouds)
        if not clouds:
            return cls(np.empty((0, 3)), name=name)
        crs = next((cloud.crs for cloud in clouds if cloud.crs is not None), None)
        for cloud in clouds:
            check_same_crs(f"cloud {cloud.name!r}", cloud.crs, "first one", crs)
        shared = [key for key in clouds[0].columns if all(key in cloud for cloud in clouds)]
        columns = {key: np.concatenate([cloud[key] for cloud in clouds]) for key in shared}
        coarsest = float(np.fmax.reduce([cloud.resolution for cloud in clouds]))
        points = np.concatenate([cloud.points for cloud in clouds])
        return cls(points, columns, name, coarsest, crs)


def describe(cloud: Cloud) -> dict:
    """Return what a cloud contains, and what other commands would say of it.

    Columns with more than one value are counted. Coordinates that are not in metres have their
    unit in ``unit`` and none in their names.

    Examples
    --------
    >>> found = describe(Cloud([[0, 0, 0], [1, 2, 0]], {"head": [1, 2], "gps_time": [5, 9]}))
    >>> found["columns"], int(found["time_span_s"])
    ('head (2), gps_time (2)', 4)
    """
    import pandas as pd

    ends = extent(cloud.points if len(cloud) else np.full((1, 3), np.nan))
    units, counts = dict.fromkeys("xyz", "m"), {}
    for axis in () if cloud.crs is None else cloud.crs.axis_info:
        if axis.unit_conversion_factor != 1:
            units |= dict.fromkeys("z" if axis.direction == "up" else "xy", axis.unit_name)
    for name, values in cloud.columns.items():
        counts[name] = len(pd.unique(values)) if values.ndim == 1 else values.shape[1]
    doubts = unit_remarks(cloud.points, crs=cloud.crs)
    if LIKE_DEGREES in doubts:  # in metres their digits would end a hundred metres apart
        units |= dict.fromkeys("xy", "degree?")
    remarks = ["No coordinate system: taken for metres."] if cloud.crs is None else []
    try:
        check_points(cloud.points)
        check_same_crs("cloud", cloud.crs, "", None)
    except ValueError as error:
        remarks = [f"Other commands refuse it: {error}"]
    times = len(cloud) and "gps_time" in cloud
    box = {}
    for axis, (low, high) in zip("xyz", ends.T, strict=True):
        metres = "_m" if units[axis] == "m" else ""
        box |= {f"{axis}_low{metres}": low, f"{axis}_high{metres}": high}
    return {
        "points": len(cloud),
        **box,
        "unit": ", ".join(dict.fromkeys(units.values())),
        "crs": "" if cloud.crs is None else cloud.crs.name,
        "resolution_mm": 1000 * np.fmax(cloud.resolution, step_of(cloud.points)),
        "time_span_s": np.ptp(cloud["gps_time"]) if times else np.nan,
        "columns": ", ".join(f"{name} ({count})" for name, count in counts.items() if count > 1),
        "remarks": " ".join([*remarks, *doubts]),
    }


def step_of(points: np.ndarray) -> float:
    """Return the coarsest step, m, of which all coordinates are multiples, NaN without one.

    Examples
    --------
    >>> step_of(np.arange(60).reshape(20, 3) * 0.0007 + 5_300_000)
    0.0001
    """
    if len(points) <= 10 or not np.isfinite(points).all() or not np.ptp(points):
        return np.nan
    local = points[:: 1 + len(points) // 1000] - points[0]
    steps = np.outer([0.1, 0.01, 0.001, 0.0001], [1, 0.5, 0.2]).ravel()[:-2]  # to 0.1 mm
    places = (local / step for step in steps)
    fits = [np.abs(place - np.round(place)).max() < 1e-4 for place in places]
    return float(max(np.compress(fits, steps), default=np.nan))


def extent(points: np.ndarray) -> np.ndarray:
    """Return the least and the largest coordinates of points (n, d), shape (2, d); NaN for NaN.

    Ten times as fast as reducing the rows of as many points.

    Examples
    --------
    >>> extent(np.array([[0.0, 5.0], [2.0, 3.0]])).tolist()
    [[0.0, 3.0], [2.0, 5.0]]
    """
    axes = real_array(points, "points").T
    refuse(axes.ndim != 2 or not axes.size, "points", f"shape {axes.T.shape}", "rows of numbers")
    return np.array([[axis.min() for axis in axes], [axis.max() for axis in axes]])


def unit_remarks(
    points: ArrayLike,
    *,
    crs: CRS | None = None,
    share: float = 1.0,
    lengths: np.ndarray | None = None,
) -> list[str]:
    """Return what speaks against coordinates in metres with z upwards, a sentence for each.

    Reading warns of it (``io.read_cloud``, ``io.iterate_cloud``), since files often name no
    coordinate system. What cannot be in metres is said: more than a hundred million points in a
    square metre of a cloud higher than wide (degrees), steps of a whole metre, or points that lie
    metres apart (millimetres, centimetres). Feet cannot be told from coordinates. So is a system
    whose map stretches lengths by more than half a per cent, as Web Mercator does.

    Parameters
    ----------
    points : Cloud or array_like, shape (n, 3)
        A cloud, or a part of one.
    crs : pyproj.CRS, optional
        What the file names.
    share : float
        Share of the whole cloud's points: a part may be thinner than the whole.
    lengths : array_like, optional
        Lengths of the edges whose ends the points are: judged in place of distances of neighbours.

    Returns
    -------
    list of str
        Empty where nothing speaks against metres, and for fewer than 50 points.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> in_metres = rng.random((1000, 3))
    >>> unit_remarks(in_metres), unit_remarks(in_metres * 1000)
    ([], ['Points have no neighbour within 1.5 m, as in millimetres, but are taken for metres.'])
    >>> unit_remarks(in_metres / [1e5, 1e5, 1] + [11.5, 48.1, 500])
    ['Coordinates look like degrees, but are taken for metres.']
    """
    points = check_points(points, minimum=0)
    if crs is not None and crs.is_geocentric:
        return [f"Coordinates are geocentric ({crs.name}): z is not upwards."]
    on_map = remark_on_map(crs, np.median(points[:, :2], axis=0)) if len(points) else ""
    said = [on_map] * bool(on_map)
    if len(points) < FEWEST_FOR_UNIT or (crs is not None and crs.is_geographic):
        return said
    few = points[:: len(points) // FEWEST_FOR_UNIT]
    *plan, high = np.ptp(extent(points), axis=0)
    wide = max(plan)
    crowded = len(points) > CROWDED * wide**2 and high > wide > 0
    if crowded and np.abs(few[:, :2]).max() <= 180:
        return [*said, LIKE_DEGREES]
    if lengths is not None:
        odd, told = np.median(lengths) > LONGEST_EDGE_M, "Edges are hundreds of metres long"
    elif (few == np.round(few)).all():
        odd, told = wide > 0, "Coordinates are whole numbers"
    else:
        alone = [not _has_neighbour(points, seed, share) for seed in few[::7]]
        odd, told = np.mean(alone) > 0.5, "Points have no neighbour within 1.5 m"
    return said + [f"{told}, as in millimetres, but are taken for metres."] * bool(odd)


def _has_neighbour(points, seed, share):
    """Whether another point lies near one of them; ``share`` of the points is there."""
    near = points[np.abs(points[:, 0] - seed[0]) < FARTHEST_NEIGHBOUR_M / np.sqrt(share)] - seed
    square = (near**2).sum(axis=1)
    return ((square > 0) & (square < FARTHEST_NEIGHBOUR_M**2 / share)).any()


def path_distance(points: ArrayLike, path: Any) -> np.ndarray:
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
        If the path has fewer than two vertices, a table of it lacks a column, or a value is not
        finite.

    Examples
    --------
    >>> path_distance([[3, 5, 0], [0, 14, 0]], [[0, 0], [0, 10]]).tolist()
    [3.0, 4.0]
    """
    import pandas as pd
    import shapely

    if isinstance(path, pd.DataFrame):
        check_columns(path, ("easting_m", "northing_m"), "path")
    path = check_plan(path, name="path", minimum=2)
    points = check_plan(points, minimum=0)
    origin = path.mean(axis=0).round()
    line = shapely.LineString(path - origin)
    return shapely.distance(shapely.points(points - origin), line)


def cells_of(points: ArrayLike, size: float) -> np.ndarray:
    """Return the place of the cell of each point: the only rule of which cell a point is in.

    Borders lie at multiples of the size, and belong to the cell above them. A millionth of the size
    below a border is on it, so that rounding of large coordinates moves no point.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Coordinates, in any unit.
    size : float
        Side of the square or cubic cells, in that unit.

    Returns
    -------
    array of int, shape (n, d)
        In cells from the origin.

    Examples
    --------
    >>> cells_of([[0.3, 0.29], [-0.1, 10_000_000.3]], 0.1).tolist()
    [[3, 2], [-1, 100000003]]
    """
    places = check_points(points, columns=None, minimum=0) / check_positive(size, "size")
    places += ON_BORDER
    far = max(places.max(initial=0.0), -places.min(initial=0.0))
    refuse(far > 2**62, f"cells of {size:g}", f"{far:.3g} of them on an axis", "fewer")
    return np.floor(places, out=places).astype(np.int64)


def sort_into_cells(points: np.ndarray, size: float) -> tuple[np.ndarray, ...]:
    """Sort points into their square or cubic cells, those of :func:`cells_of`.

    Parameters
    ----------
    points : array, shape (n, d)
        Coordinates, in any unit; one point or more.
    size : float
        Side of the cells, in that unit.

    Returns
    -------
    order : array of int, shape (n,)
        The points' rows, cell by cell; within a cell as they came.
    starts : array of int, shape (m + 1,)
        Cell k has the points ``order[starts[k]:starts[k + 1]]``.
    places : array of int, shape (m, d)
        Place of each cell with points, in cells from the origin; the last axis runs fastest.

    Raises
    ------
    ValueError
        If the box around the points has too many cells to be numbered.

    Examples
    --------
    >>> order, starts, places = sort_into_cells(np.array([[0.9, 0.2], [0.1, 0.1], [0.8, 0.3]]), 0.5)
    >>> order.tolist(), starts.tolist(), places.tolist()
    ([1, 0, 2], [0, 1, 3], [[0, 0], [1, 0]])
    """
    index = cells_of(points, size)
    refuse(not len(index), "points", "none", "one or more")
    low = np.array([column.min() for column in index.T])
    index -= low
    wide = np.array([column.max() for column in index.T]) + 1
    if np.prod(wide.astype(float)) > 2.0**62:
        raise ValueError(f"Invalid points: too wide for cells of {size:g}. Must lie nearer.")
    key = np.ravel_multi_index(tuple(index.T), tuple(wide))
    key = key.astype(np.min_scalar_type(np.prod(wide)))  # short numbers are sorted faster
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.append(0, np.flatnonzero(key[1:] != key[:-1]) + 1)
    return order, np.append(first, len(order)), index[order[first]] + low


def group_axes(points: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return how the points of each group lie about their centre; a group is a run of rows.

    Parameters
    ----------
    points : array, shape (n, 3)
        Group by group, m; a cloud sorted by :func:`sort_into_cells`, for example.
    starts : array of int, shape (k,)
        First row of each group; none is empty.

    Returns
    -------
    counts : array of int, shape (k,)
    off : array, shape (n, 3)
        The points from the centre of their group, m.
    centres : array, shape (k, 3)
    variances : array, shape (k, 3)
        Along the axes, ascending, m^2.
    axes : array, shape (k, 3, 3)
        Unit vectors in columns.

    Examples
    --------
    >>> counts, _, centres, variances, _ = group_axes(np.array([[0, 0, 0], [0, 0, 2.0]]), [0])
    >>> counts.tolist(), centres.tolist(), variances.tolist()
    ([2], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]])
    """
    counts = np.diff(np.append(starts, len(points)))
    centres = np.add.reduceat(points, starts) / counts[:, None]
    off = points - np.repeat(centres, counts, axis=0)
    scatter = np.add.reduceat(off[:, :, None] * off[:, None, :], starts) / counts[:, None, None]
    variances, axes = np.linalg.eigh(scatter)
    return counts, off, centres, np.maximum(variances, 0), axes
