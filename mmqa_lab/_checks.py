"""Argument checks with one message pattern: what is wrong, its value, what is expected."""

import numbers
import os
import re
from pathlib import Path

import numpy as np

PLAN_NAMES = (
    ("x", "y"),
    ("easting", "northing"),
    ("east", "north"),
    ("e", "n"),
    ("rechtswert", "hochwert"),
)
"""Columns of tables that are taken for coordinates in plan, the first pair that is there."""

FARTHEST_M, WEEK_S = 2000.0, 604_800.0
"""No scanner of a vehicle or helicopter measures farther; a week of GPS, whose seconds begin again.
"""

HEIGHT_NAMES = ("z", "height", "elevation", "altitude", "up", "h", "hoehe", "höhe")
"""Columns of tables that are taken for heights, the first that is there."""


def check_points(points, *, name="points", columns=3, minimum=1):
    """Return ``points`` as finite float64 of shape ``(n, columns)`` with ``n >= minimum``.

    Takes an array, a Cloud, a DataFrame with named coordinates (see :func:`coordinate_columns`), a
    GeoDataFrame of points, the path of a file that ``io`` reads, and an xarray DataArray of heights
    over ``x`` and ``y`` (its cells that have a height). Two columns of them are those in plan.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong, points are too few, a coordinate is not finite, or a cloud's
        coordinate reference system is not in metres.

    Examples
    --------
    >>> check_points([[0, 0, 1]]).shape
    (1, 3)
    >>> check_points([[0, 0]])
    Traceback (most recent call last):
    ValueError: Invalid points of shape (1, 2). Must have shape (n, 3).
    """
    check_metres(getattr(points, "crs", None), name)
    values = np.asarray(_coordinates(points, name, columns))
    if values.dtype.kind not in "fiub":
        raise TypeError(f"Invalid {name} of type {values.dtype}. Must be real numbers.")
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, {columns}).")
    if len(values) < minimum:
        raise ValueError(f"Invalid {name}: {len(values)} given. Must be {minimum} or more.")
    values = values.astype(np.float64, copy=False)
    if not np.isfinite(values).all():
        bad = ~np.isfinite(values).all(axis=1)
        raise ValueError(
            f"Invalid {name}: {bad.sum()} of {len(values)} not finite, the first in row "
            f"{int(np.argmax(bad))}. Must be finite coordinates."
        )
    return values


def check_crs(crs):
    """Return a coordinate reference system as :class:`pyproj.CRS`, or raise where it is unknown.

    Examples
    --------
    >>> check_crs("EPSG:25832").name
    'ETRS89 / UTM zone 32N'
    """
    import pyproj

    try:
        return pyproj.CRS(crs)
    except pyproj.exceptions.CRSError:
        raise ValueError(f"Invalid crs {crs!r}. Must be known, like EPSG:25832.") from None


def check_metres(crs, name):
    """Raise where a coordinate reference system is known and an axis of it is not in metres."""
    axes = getattr(crs, "axis_info", None) or ()
    other = next((axis for axis in axes if axis.unit_conversion_factor != 1), None)
    if other is not None:
        unit = other.unit_name.replace("degree", "degrees")
        raise ValueError(f"Invalid {name} in {unit} ({crs.name}). Must be projected, in metres.")


def check_plan(points, *, name="points", minimum=1):
    """Return the coordinates in plan of points, of a path or of a table of either, shape (n, 2).

    Examples
    --------
    >>> check_plan([[1, 2, 3]]).tolist()
    [[1.0, 2.0]]
    """
    values = np.asarray(_coordinates(points, name, 2))
    in_space = values.ndim == 2 and values.shape[1] == 3
    return check_points(
        values[:, :2] if in_space else values, name=name, columns=2, minimum=minimum
    )


def check_same_crs(name, crs, other_name, other):
    """Raise where two coordinate reference systems are known and differ in plan.

    Heights are not compared, nor datums whose ellipsoids have one major axis (ETRS89, WGS 84).

    Examples
    --------
    >>> check_same_crs("polygon", check_crs("EPSG:4978"), "cloud", check_crs("EPSG:25832"))
    Traceback (most recent call last):
    ValueError: Invalid polygon in WGS 84. Must be in that of the cloud, ETRS89 / UTM zone 32N.
    """
    if crs is not None and other is not None and _in_plan(crs) != _in_plan(other):
        raise ValueError(
            f"Invalid {name} in {crs.name}. Must be in that of the {other_name}, {other.name}."
        )


def _in_plan(crs):
    """What a coordinate reference system is in plan: ellipsoid and projection, or EPSG number."""
    plan = crs.sub_crs_list[0] if crs.is_compound else crs
    size = plan.ellipsoid and round(plan.ellipsoid.semi_major_metre)
    operation = plan.coordinate_operation
    if operation is None:
        return size, plan.to_epsg()
    values = [(one.code, round(one.value, 6)) for one in operation.params]
    unit = plan.axis_info[0].unit_conversion_factor
    return size, operation.method_code, sorted(values), unit


def coordinate_columns(names):
    """Return which of the columns of a table are x, y and z.

    Case, a unit in brackets or behind ``_`` and white space do not count: ``X``, ``x_m`` and
    ``x [m]`` are x. ``easting``, ``northing`` and ``height`` and a few others are known too.

    Parameters
    ----------
    names : sequence
        The columns' names.

    Returns
    -------
    list
        Three of the names; two, of a table without heights; none, of one without coordinates.

    Examples
    --------
    >>> coordinate_columns(["id", "Easting", "Northing", "Height (m)"])
    ['Easting', 'Northing', 'Height (m)']
    >>> coordinate_columns(["x_m", "y_m"]), coordinate_columns(["a", "b", "c"])
    (['x_m', 'y_m'], [])
    """
    plain = {}
    for name in names:
        plain.setdefault(_plain_name(name), name)
    plan = next((pair for pair in PLAN_NAMES if all(name in plain for name in pair)), ())
    height = next((name for name in HEIGHT_NAMES if plan and name in plain), None)
    return [plain[name] for name in (*plan, height) if name is not None]


def is_table(points):
    """Whether something is a DataFrame, asked without importing pandas."""
    return hasattr(points, "columns") and hasattr(points, "to_numpy")


def _from_file(path):
    """The points of a file of points, or of a raster of heights."""
    from mmqa_lab.io import read_cloud, read_heights
    from mmqa_lab.io.images import is_raster

    if os.path.isfile(path) and is_raster(path):
        return read_heights(path)
    cloud = read_cloud(path, columns=())
    check_metres(cloud.crs, str(path))
    return cloud.points


def _cells(heights, name):
    """The middles of a DataArray's cells that have a height, as points."""
    places = [heights.coords[axis] for axis in coordinate_columns(heights.dims)[:2]]
    raster = heights.squeeze(drop=True)
    if len(places) < 2 or raster.ndim != 2:
        return heights.to_numpy()
    x, y = places
    values = raster.transpose(y.dims[0], x.dims[0]).to_numpy().astype(np.float64)
    empty = heights.attrs.get("_FillValue", heights.encoding.get("_FillValue"))
    rows, columns = np.nonzero(np.isfinite(values) & (values != empty))
    return np.column_stack([x.to_numpy()[columns], y.to_numpy()[rows], values[rows, columns]])


def _is_cloud(points):
    """Whether something is a Cloud; that room stands on this one."""
    return type(points).__name__ == "Cloud" and hasattr(points, "points")


def _plain_name(name):
    """A column's name without case, unit and marks of comment."""
    return re.sub(r"(_m|[\[(]m[\])])$", "", str(name).lower().strip("/# \"'")).strip()


def _coordinates(points, name, columns):
    """The coordinates of a table or a file; anything else as it is."""
    if isinstance(points, np.ndarray):
        return points
    if isinstance(points, str | os.PathLike):
        return _from_file(points)[:, :columns]
    if _is_cloud(points):
        return points.points[:, :columns]
    if hasattr(points, "dims") and hasattr(points, "coords"):
        return _cells(points, name) if columns == 3 else points
    if not is_table(points):
        return points
    found = coordinate_columns(points.columns)[:columns]
    if len(found) == columns:
        return np.ascontiguousarray(points[found].to_numpy(dtype=np.float64))
    if not found and hasattr(points, "geometry"):
        return np.column_stack([getattr(points.geometry, axis) for axis in "xyz"[:columns]])
    if found or points.shape[1] != columns:
        listed = ", ".join(str(column) for column in points.columns)
        wanted = ", ".join("xyz"[:columns])
        raise ValueError(f"Invalid {name} with columns {listed}. Must have {wanted}.")
    return points.to_numpy()


def check_passes(path, points, name):
    """Raise where a path in plan does not come near points.

    Examples
    --------
    >>> check_passes(np.array([[5e6, 0], [5e6, 9]]), np.zeros((1, 3)), "trajectory far.csv")
    Traceback (most recent call last):
    ValueError: Invalid trajectory far.csv: 5000.0 km from the points. Must pass them within 2 km.
    """
    boxes = [(np.min(one, axis=0), np.max(one, axis=0)) for one in (path[:, :2], points[:, :2])]
    away = np.maximum(boxes[0][0] - boxes[1][1], boxes[1][0] - boxes[0][1])
    gap = float(np.linalg.norm(np.maximum(away, 0)))
    if gap > FARTHEST_M:
        raise ValueError(
            f"Invalid {name}: {gap / 1000:.1f} km from the points. Must pass them within "
            f"{FARTHEST_M / 1000:g} km."
        )


def check_file(path, name):
    """Return the path of a file that exists.

    Examples
    --------
    >>> check_file("none.csv", "marks")
    Traceback (most recent call last):
    FileNotFoundError: Invalid marks none.csv: no such file. Must exist.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"Invalid {name} {path}: no such file. Must exist.")
    return Path(path)


def check_columns(table, columns, name):
    """Raise where a table lacks a column.

    Examples
    --------
    >>> check_columns({"juror": [1]}, ("juror", "mark"), "marks")
    Traceback (most recent call last):
    ValueError: Invalid marks: no column 'mark'. Must have one.
    """
    for column in columns:
        if column not in table:
            raise ValueError(f"Invalid {name}: no column {column!r}. Must have one.")


def check_number(value, name, *, low=None, high=None, unit=""):
    """Return ``value`` as a finite float within ``[low, high]``.

    Examples
    --------
    >>> check_number(5, "amount", low=0, high=1)
    Traceback (most recent call last):
    ValueError: Invalid amount 5. Must be between 0 and 1.
    """
    number = _finite(value, name)
    below = low is not None and number < low
    above = high is not None and number > high
    if below or above:
        raise ValueError(f"Invalid {name} {value}. Must be {_bounds(low, high)}{_spaced(unit)}.")
    return number


def check_positive(value, name, *, unit=""):
    """Return ``value`` as a finite float above zero.

    Examples
    --------
    >>> check_positive(-0.2, "radius", unit="m")
    Traceback (most recent call last):
    ValueError: Invalid radius -0.2. Must be > 0 m.
    """
    number = _finite(value, name)
    if number <= 0:
        raise ValueError(f"Invalid {name} {value}. Must be > 0{_spaced(unit)}.")
    return number


def check_count(value, name, *, low=1):
    """Return ``value`` as an int of at least ``low``.

    Examples
    --------
    >>> check_count(0, "repeats")
    Traceback (most recent call last):
    ValueError: Invalid repeats 0. Must be a whole number >= 1.
    """
    whole = isinstance(value, numbers.Real) and not isinstance(value, bool) and value % 1 == 0
    if not whole or value < low:
        raise ValueError(f"Invalid {name} {value}. Must be a whole number >= {low}.")
    return int(value)


def check_choice(value, name, choices):
    """Return ``value`` if it is one of ``choices``.

    Examples
    --------
    >>> check_choice("up", "axes", ("principal", "horizontal"))
    Traceback (most recent call last):
    ValueError: Invalid axes 'up'. Must be one of principal, horizontal.
    """
    if value not in choices:
        listed = ", ".join(str(choice) for choice in choices)
        raise ValueError(f"Invalid {name} {value!r}. Must be one of {listed}.")
    return value


def _finite(value, name):
    """``value`` as a finite float, or the sentence that says why not."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"Invalid {name} {value!r}. Must be a number.")
    if not np.isfinite(value):
        raise ValueError(f"Invalid {name} {value}. Must be finite.")
    return float(value)


def _bounds(low, high):
    """The interval in words."""
    if low is None:
        return f"<= {high}"
    if high is None:
        return f">= {low}"
    return f"between {low} and {high}"


def _spaced(unit):
    """A unit as it follows a number."""
    return f" {unit}" if unit else ""
