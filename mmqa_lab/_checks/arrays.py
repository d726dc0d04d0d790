"""The door of all that is given as numbers: arrays, tables, images, lines; their systems."""

import contextlib
import numbers
import re
import textwrap
from collections.abc import Iterable

import numpy as np

from mmqa_lab._checks.words import listed, refuse

__all__ = [
    "check_image", "check_plan", "check_points", "check_polygon", "check_row", "check_same_crs",
    "check_together", "check_upright", "check_values", "coordinate_columns", "plain_name",
    "real_array", "remark_on_map", "type_step",
]  # fmt: skip


# No place is as far from the origin, m.
FARTHEST_M = 1e15

# Share by which lengths may differ on a map; in national grids they differ by less than half of it.
MOST_STRETCHED = 0.005

# Names of coordinates in tables.
PLAN_NAMES = (("x", "y"), ("easting", "northing"), ("east", "north"), ("rechtswert", "hochwert"))
PLAN_NAMES += (("e", "n"), ("rechts", "hoch"))

HEIGHT_NAMES = ("z", "height", "elevation", "altitude", "up", "höhe", "hoehe")


def real_array(values, name, *, kinds="fiu"):
    """Return an array of real numbers in its own type; what hides or lacks some is refused.

    The door of all that is given as numbers: a masked array would lose its mask, a missing entry
    and a row of another length are no numbers.

    Examples
    --------
    >>> real_array(np.ma.masked_greater([1.0, 9.0], 5), "widths")
    Traceback (most recent call last):
    ValueError: Invalid widths: 1 of 2 masked. Must be numbers without a mask.
    >>> real_array([1.0, None], "widths")
    Traceback (most recent call last):
    TypeError: Invalid widths: None among them. Must be real numbers.
    """
    if isinstance(values, np.ma.MaskedArray):
        hidden = np.ma.count_masked(values)
        refuse(hidden, name, f"{hidden} of {values.size} masked", "numbers without a mask")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise TypeError(f"Invalid {name}: rows of unlike lengths. Must be real numbers.") from error
    if array.dtype == object:
        odd = [one for one in array.flat if not isinstance(one, numbers.Real)][:1]
        if odd:
            found = textwrap.shorten(repr(odd[0]), 40, placeholder=" ...")
            raise TypeError(f"Invalid {name}: {found} among them. Must be real numbers.")
        array = array.astype(np.float64)
    if array.dtype.kind not in kinds:
        kind = "records" if array.dtype.names else array.dtype
        raise TypeError(f"Invalid {name} of type {kind}. Must be real numbers.")
    return array


def type_step(values):
    """The step, in their unit, in which numbers of this type and size can be told apart at all.

    Examples
    --------
    >>> type_step(np.float32([5_334_000.2])), type_step([5])
    (0.5, 0.0)
    """
    array = np.asarray(values)
    inexact = array.size and array.dtype.kind == "f"
    return float(np.spacing(np.abs(array).max())) if inexact else 0.0


def coordinate_columns(names: Iterable[str]) -> list[str]:
    """Return which of the columns of a table are x, y and z; fewer where it has not all.

    Case, a unit in brackets or behind ``_`` and white space do not count: ``X``, ``x_m`` and
    ``x [m]`` are x. ``easting``, ``northing`` and ``height`` and a few others are known too.

    Examples
    --------
    >>> coordinate_columns(["id", "Easting", "Northing", "Height (m)"])
    ['Easting', 'Northing', 'Height (m)']
    >>> coordinate_columns(["x_m", "y_m"]), coordinate_columns(["a", "b", "c"])
    (['x_m', 'y_m'], [])
    """
    plain = {plain_name(name): name for name in reversed([*names])}
    plan = next((pair for pair in PLAN_NAMES if all(name in plain for name in pair)), ())
    heights = (*HEIGHT_NAMES, "h") if plan != PLAN_NAMES[0] else HEIGHT_NAMES  # y, x, h: x north
    height = next((name for name in heights if plan and name in plain), None)
    return [plain[name] for name in (*plan, height) if name is not None]


def plain_name(name):
    """Return a column's name without case and metres."""
    return re.sub(r"(_m|[\[(]m[\])])$", "", str(name).lower().strip()).strip()


def _by_names(table, columns, name):
    """The coordinates of a table with names for its columns, in the order x, y, z."""
    names = [*table.columns]
    if all(isinstance(one, numbers.Integral) for one in names):
        return table
    found, wanted = coordinate_columns(names)[:columns], ("x", "y", "z")[: columns or 2]
    must = f"{', '.join(wanted)} among them"
    refuse(len(found) < len(wanted), name, f"a table with columns {listed(names)}", must)
    return table[found]


def check_points(points, *, name="points", columns=3, minimum=1):
    """Return ``points`` as finite float64 of shape ``(n, columns)`` with ``n >= minimum``.

    ``columns`` None: of two or three. Takes an array or whatever has ``__array__``, a Cloud in
    metres among others; of a DataFrame the columns that are named x, y and z, in whichever order.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong, points are too few, a coordinate is not finite or 1e15 m away, or the
        points have a coordinate reference system that is not in metres.

    Examples
    --------
    >>> check_points([[0, 0, 1]]).shape
    (1, 3)
    >>> check_points([[0, 0]])
    Traceback (most recent call last):
    ValueError: Invalid points of shape (1, 2). Must have shape (n, 3).
    """
    check_same_crs(name, getattr(points, "crs", None), "", None)
    if hasattr(points, "iloc") and hasattr(points, "columns"):
        points = _by_names(points, columns, name)
    values = real_array(points, name, kinds="fiub")
    if values.ndim != 2 or columns not in (None, values.shape[1]):
        shape = f"(n, {'d' if columns is None else columns})"
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape {shape}.")
    if len(values) < minimum:
        raise ValueError(f"Invalid {name}: {len(values)} given. Must be {minimum} or more.")
    step = 1000 * type_step(values) if values.dtype.itemsize < 8 else 0.0
    refuse(step > 1, name, f"{values.dtype} in steps of {step:.3g} mm", "float64 so far away")
    values = values.astype(np.float64, copy=False)
    if not np.isfinite(values).all():
        bad = ~np.isfinite(values).all(axis=1)
        count = f"{bad.sum()} of {len(values)} not finite, the first in row {np.argmax(bad)}"
        raise ValueError(f"Invalid {name}: {count}. Must be finite coordinates.")
    largest = max(values.max(initial=0), -values.min(initial=0))
    refuse(largest > FARTHEST_M, name, f"{largest:.3g} in it", "in metres")
    return values


def check_plan(points, *, name="points", minimum=1):
    """Return the coordinates in plan of points in plan or in space, shape (n, 2).

    Examples
    --------
    >>> check_plan([[1, 2, 3]]).tolist()
    [[1.0, 2.0]]
    """
    check_same_crs(name, getattr(points, "crs", None), "", None)
    if hasattr(points, "iloc") and hasattr(points, "columns"):
        points = _by_names(points, 2, name)
    points = real_array(points, name, kinds="fiub")
    points = points[:, :2] if points.ndim == 2 and points.shape[1] == 3 else points
    return check_points(points, name=name, columns=2, minimum=minimum)


def check_polygon(vertices, *, name="polygon"):
    """Return the vertices of a polygon, shape (m, 3) with m >= 3, none repeated by the next.

    Examples
    --------
    >>> len(check_polygon([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]]))
    3
    """
    ring = check_points(vertices, name=name)
    kept = (ring != np.roll(ring, -1, axis=0)).any(axis=1)
    return check_points(ring[kept], name=name, minimum=3)


def polygon_rings(vertices):
    """Rows of a polygon's rings: its outline, then each hole, which follows the first vertex again.

    Examples
    --------
    >>> square = [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]]
    >>> hole = [[2, 2, 0], [3, 2, 0], [2, 3, 0], [2, 2, 0]]
    >>> [rows.tolist() for rows in polygon_rings(np.array([*square, square[0], *hole]))]
    [[0, 1, 2, 3], [5, 6, 7, 8]]
    """
    starts = np.flatnonzero((vertices == vertices[0]).all(axis=1))
    outline, *others = np.split(np.arange(len(vertices)), starts[1:])
    return [outline, *(rows[1:] for rows in others if len(rows) > 4)]


def check_image(image, *, convert=True):
    """Return a grey image as float64, or in its own type without ``convert``.

    Raises
    ------
    TypeError, ValueError
        If it is no array of real numbers with two dimensions, or has values that are not finite.
    """
    values = real_array(image, "image")
    if values.ndim != 2 or min(values.shape) < 3:
        raise ValueError(f"Invalid image of shape {values.shape}. Must be grey, 3 x 3 or larger.")
    if not np.isfinite(values).all():
        raise ValueError("Invalid image: values that are not finite. Must be finite.")
    return values.astype(np.float64) if convert else values


def check_values(values, name, *, positive=False):
    """Return finite float64 numbers of any shape, checked to be above zero if ``positive``."""
    if isinstance(values, str):
        raise TypeError(f"Invalid {name} {values!r}. Must be a number or an array of numbers.")
    array = real_array(values, name)
    bad = ~np.isfinite(array) | (positive & (array <= 0))
    if bad.any():
        must = "> 0 and finite" if positive else "finite"
        raise ValueError(f"Invalid {name} {array[bad].flat[0]}. Must be {must}.")
    return array.astype(np.float64)


def check_row(values, name, *, minimum=1, missing=False):
    """Return a row of float64, finite but for the NaN of ``missing``, of ``minimum`` or more.

    Examples
    --------
    >>> check_row([1.0, np.inf], "times")
    Traceback (most recent call last):
    ValueError: Invalid times: 1 of 2 not finite. Must be finite.
    """
    row = real_array(values, name).astype(np.float64)
    if row.ndim != 1:
        raise ValueError(f"Invalid {name} of shape {row.shape}. Must be a row of numbers.")
    refuse(len(row) < minimum, name, f"{len(row)} given", f"{minimum} or more")
    _check_finite(row, name, missing)
    return row


def check_together(*, missing=False, to_first=False, **arrays):
    """Return arrays of float64 whose shapes go together, finite but for the NaN of ``missing``.

    ``to_first``: the others have the shape of the first, or fewer dimensions.

    Examples
    --------
    >>> check_together(dn=[1.0, 2.0], radiance=[1.0, 2.0, 3.0])
    Traceback (most recent call last):
    ValueError: Invalid radiance of shape (3,) beside dn of shape (2,). Must go together.
    """
    names = {key: key.replace("_", " ") for key in arrays}
    found = [real_array(one, names[key]).astype(np.float64) for key, one in arrays.items()]
    first, shape = next(iter(names.values())), found[0].shape
    for name, array in zip(names.values(), found, strict=True):
        together = shape if array.shape == shape else None
        with contextlib.suppress(ValueError):
            together = together or np.broadcast_shapes(shape, array.shape)
        if together is None or (to_first and together != shape):
            beside = f"{name} of shape {array.shape} beside {first} of shape {shape}"
            raise ValueError(f"Invalid {beside}. Must go together.")
        _check_finite(array, name, missing)
    return found


def _check_finite(array, name, missing):
    """Raise where an array has infinite numbers, or NaN that do not stand for what is missing."""
    bad = np.isinf(array) if missing else ~np.isfinite(array)
    if not bad.any():
        return  # without the words
    must = "finite, or NaN where not known" if missing else "finite"
    refuse(bad.any(), name, f"{bad.sum()} of {array.size} not finite", must)


def check_same_crs(name, crs, other_name, other):
    """Raise where a coordinate reference system differs from another or is not in metres.

    What is not known, None, agrees with all; so do heights that one of both does not name.

    Examples
    --------
    >>> import pyproj
    >>> utm32, utm33 = pyproj.CRS("EPSG:25832"), pyproj.CRS("EPSG:25833")
    >>> check_same_crs("polygon", utm33, "cloud", utm32)
    Traceback (most recent call last):
    ValueError: Invalid polygon in ETRS89 / UTM zone 33N. Must be in ETRS89 / UTM zone 32N, the
    cloud's.
    """
    if crs is None:
        return
    ours, theirs = (one.sub_crs_list if one.is_compound else [one] for one in (crs, other or crs))
    for part, wanted in zip(ours, theirs, strict=False):  # in plan, and heights where both name one
        if part.name != wanted.name and not part.equals(wanted, ignore_axis_order=True):
            must = f"{wanted.name}, the {other_name}'s"
            raise ValueError(f"Invalid {name} in {part.name}. Must be in {must}.")
    for axis in crs.axis_info:
        if axis.unit_conversion_factor != 1:
            odd = f"{'with heights ' if axis.direction == 'up' else ''}in {axis.unit_name}"
            raise ValueError(f"Invalid {name} {odd} ({crs.name}). Must be projected, in metres.")


def remark_on_map(crs, place):
    """Return what is said where a map is longer or shorter than the ground at a place (x, y).

    Examples
    --------
    >>> import pyproj
    >>> remark_on_map(pyproj.CRS("EPSG:3857"), (935_000, 6_275_000))  # Karlsruhe
    'Lengths in WGS 84 / Pseudo-Mercator are 52 % longer here than on the ground.'
    >>> remark_on_map(pyproj.CRS("EPSG:25832"), (456_000, 5_429_000))
    ''
    """
    import pyproj

    if crs is None or not crs.is_projected:
        return ""
    try:
        proj = pyproj.Proj(crs)
        off = proj.get_factors(*proj(*place, inverse=True)).tissot_semimajor - 1
    except pyproj.exceptions.ProjError:  # a place that the map does not have
        return ""
    if not MOST_STRETCHED < abs(off) < np.inf:
        return ""
    way = "longer" if off > 0 else "shorter"
    return f"Lengths in {crs.name} are {100 * abs(off):.2g} % {way} here than on the ground."


def check_upright(name, crs):
    """Raise where the third coordinate is not the height: in a geocentric system.

    Examples
    --------
    >>> import pyproj
    >>> check_upright("cloud", pyproj.CRS("EPSG:4978"))
    Traceback (most recent call last):
    ValueError: Invalid cloud in geocentric WGS 84. Must have z upwards.
    """
    if crs is not None and crs.is_geocentric:
        raise ValueError(f"Invalid {name} in geocentric {crs.name}. Must have z upwards.")
