"""Argument checks with one message pattern: what is wrong, its value, what is expected."""

import contextlib
import difflib
import importlib
import numbers
import re
import textwrap
from collections.abc import Hashable, Iterable
from pathlib import Path

import numpy as np

__all__ = [
    "check_choice", "check_columns", "check_count", "check_file", "check_image", "check_kind",
    "check_known", "check_number", "check_outputs", "check_plan", "check_points", "check_polygon",
    "check_positive", "check_same_crs", "check_upright", "check_values", "coordinate_columns",
    "full_path", "is_file", "listed", "needs", "plain_name", "real_array", "refuse", "type_step",
]  # fmt: skip

# How files of a kind begin. Of text only that it has no zero byte is known.
BEGINNINGS = {
    ".html": (b"<",),
    ".svg": (b"<",),
    ".pdf": (b"%PDF",),
    ".png": (b"\x89PNG",),
    ".nc": (b"CDF", b"\x89HDF"),
    ".tif": (b"II", b"MM"),
    ".las": (b"LASF",),
    ".laz": (b"LASF",),
    ".csv": (b"",),
}

# No place is as far from the origin, m.
FARTHEST_M = 1e15

# Letters of a list of names within a sentence.
LETTERS_LISTED = 300

# Names of coordinates in tables.
PLAN_NAMES = (("x", "y"), ("easting", "northing"), ("east", "north"), ("rechtswert", "hochwert"))
HEIGHT_NAMES = ("z", "height", "elevation", "altitude", "up", "höhe", "hoehe")


def refuse(wrong, what, found, must):
    """Raise the sentence of something that is wrong: what it is, what was found, what must be.

    Examples
    --------
    >>> refuse(True, "cloud a.ply", "no header", "a PLY file")
    Traceback (most recent call last):
    ValueError: Invalid cloud a.ply: no header. Must be a PLY file.
    """
    if wrong:
        raise ValueError(f"Invalid {what}: {found}. Must be {must}.")


def needs(extra, module):
    """Return a module of one of the package's extras.

    Examples
    --------
    >>> needs("files", "no_such_module")
    Traceback (most recent call last):
    ImportError: Missing no_such_module: install mmqa_lab[files].
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(f"Missing {module}: install mmqa_lab[{extra}].") from error


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
    hidden = np.ma.count_masked(values) if isinstance(values, np.ma.MaskedArray) else 0
    refuse(hidden, name, f"{hidden} of {np.size(values)} masked", "numbers without a mask")
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
    height = next((name for name in HEIGHT_NAMES if plan and name in plain), None)
    return [plain[name] for name in (*plan, height) if name is not None]


def plain_name(name):
    """A column's name without case and metres."""
    return re.sub(r"(_m|[\[(]m[\])])$", "", str(name).lower().strip()).strip()


def _by_names(table, columns, name):
    """The coordinates of a table with names for its columns, in the order x, y, z."""
    names = [*table.columns]
    if all(isinstance(one, numbers.Integral) for one in names):
        return table
    found, wanted = coordinate_columns(names)[:columns], ("x", "y", "z")[:columns]
    must = f"{', '.join(wanted)} among them"
    refuse(len(found) != columns, name, f"a table with columns {listed(names)}", must)
    return table[found]


def check_points(points, *, name="points", columns=3, minimum=1):
    """Return ``points`` as finite float64 of shape ``(n, columns)`` with ``n >= minimum``.

    Takes an array or whatever has ``__array__``, a Cloud among others; of a DataFrame the columns
    that are named x, y and z, in whichever order they stand.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong, points are too few or a coordinate is not finite.

    Examples
    --------
    >>> check_points([[0, 0, 1]]).shape
    (1, 3)
    >>> check_points([[0, 0]])
    Traceback (most recent call last):
    ValueError: Invalid points of shape (1, 2). Must have shape (n, 3).
    """
    if hasattr(points, "iloc") and hasattr(points, "columns"):
        points = _by_names(points, columns, name)
    values = real_array(points, name, kinds="fiub")
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"Invalid {name} of shape {values.shape}. Must have shape (n, {columns}).")
    if len(values) < minimum:
        raise ValueError(f"Invalid {name}: {len(values)} given. Must be {minimum} or more.")
    values = values.astype(np.float64, copy=False)
    if not np.isfinite(values).all():
        bad = ~np.isfinite(values).all(axis=1)
        count = f"{bad.sum()} of {len(values)} not finite, the first in row {np.argmax(bad)}"
        raise ValueError(f"Invalid {name}: {count}. Must be finite coordinates.")
    return values


def check_plan(points, *, name="points", minimum=1):
    """Return the coordinates in plan of points in plan or in space, shape (n, 2).

    Examples
    --------
    >>> check_plan([[1, 2, 3]]).tolist()
    [[1.0, 2.0]]
    """
    if not hasattr(points, "iloc"):  # of a table x and y are taken by their names
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
    largest = np.abs(ring).max()
    refuse(largest > FARTHEST_M, name, f"{largest:.3g} in it", "in metres")
    kept = (ring != np.roll(ring, -1, axis=0)).any(axis=1)
    return check_points(ring[kept], name=name, minimum=3)


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


def full_path(path):
    """Return a path, "~" in it replaced by the home folder.

    Examples
    --------
    >>> full_path("~/a.csv").is_absolute(), str(full_path("a~.csv"))
    (True, 'a~.csv')
    """
    with contextlib.suppress(RuntimeError):  # nobody has this name, or no home
        return Path(path).expanduser()
    return Path(path)


def is_file(path):
    """Whether a file is there; a text that can be no path names none.

    Examples
    --------
    >>> is_file(10_000 * "1,2,3;")
    False
    """
    with contextlib.suppress(OSError, ValueError):  # longer than names are, a zero byte
        return Path(path).is_file()
    return False


def check_file(path, name):
    """Return the path of a file that exists.

    Examples
    --------
    >>> check_file("none.csv", "marks")
    Traceback (most recent call last):
    FileNotFoundError: Invalid marks none.csv: no such file. Must exist.
    """
    place = full_path(path)
    if is_file(place):
        return place
    with contextlib.suppress(OSError, ValueError):
        if place.is_dir():
            raise FileNotFoundError(f"Invalid {name} {path}: a folder. Must be a file.")
    raise FileNotFoundError(f"Invalid {name} {path}: no such file. Must exist.")


def check_outputs(outputs, inputs=()):
    """Raise where writing these files would replace an input, each other, or other kinds of files.

    Files are compared by what they are: a link or another spelling of a path is the same file. A
    file may be replaced by one of its own kind; a folder is no file.

    Examples
    --------
    >>> check_outputs(["table.csv"], ["cloud.laz", "./table.csv"])
    Traceback (most recent call last):
    ValueError: Invalid output table.csv: it is an input. Must be another file.
    """
    for number, path in enumerate(map(Path, outputs)):
        what, other = f"output {path}", "another file"
        refuse(any(_is_same(path, one) for one in inputs), what, "it is an input", other)
        refuse(any(_is_same(path, one) for one in outputs[:number]), what, "given twice", other)
        if not path.absolute().parent.is_dir():
            raise ValueError(f"Invalid output {path}: no folder {path.parent}. Must exist.")
        if path.suffix.lower() in BEGINNINGS:
            check_kind(path)
        else:
            refuse(path.is_file(), what, "a file of another kind is there", "another name")


def check_kind(path):
    """Raise where something is at a path that is no file of the kind that its ending says.

    Examples
    --------
    >>> check_kind(Path("."))
    Traceback (most recent call last):
    OSError: Invalid output .: a folder or device. Must be a file.
    """
    path, ending = Path(path), Path(path).suffix.lower()
    if path.exists() and not path.is_file():
        raise OSError(f"Invalid output {path}: a folder or device. Must be a file.")
    if not path.is_file() or ending not in BEGINNINGS:
        return
    with path.open("rb") as file:
        head = file.read(1024).lstrip(b"\xef\xbb\xbf \n\r")
    zero = b"\0" in head and ending in (".csv", ".html", ".svg")
    wrong = head and (zero or not head.startswith(BEGINNINGS[ending]))
    refuse(wrong, f"output {path}", f"no {ending} file is there", "another name")


def _is_same(path, other):
    """Whether two paths name one file, which need not exist."""
    path, other = full_path(path), full_path(other)
    with contextlib.suppress(OSError, ValueError):  # a text that can be no path names none
        if path.exists() and other.exists():
            return path.samefile(other)
        return path.resolve() == other.resolve()
    return False


def listed(names):
    """Names as part of a sentence; many of them are cut short.

    Examples
    --------
    >>> listed(["x", "y"]), len(listed(range(1000))) <= LETTERS_LISTED
    ('x, y', True)
    """
    return textwrap.shorten(", ".join(map(str, names)), LETTERS_LISTED, placeholder=" ...")


def check_columns(table, columns, name):
    """Raise where a table lacks a column.

    Examples
    --------
    >>> check_columns({"juror": [1]}, ("juror", "mark"), "marks")
    Traceback (most recent call last):
    ValueError: Invalid marks: no column 'mark' beside juror. Must have one.
    """
    for column in columns:
        if column not in table:
            beside = f"beside {there}" if (there := listed(table)) else "at all"
            raise ValueError(f"Invalid {name}: no column {column!r} {beside}. Must have one.")


def check_number(value, name, *, low=-np.inf, high=np.inf, unit=""):
    """Return ``value`` as a finite float within ``[low, high]``.

    Examples
    --------
    >>> check_number(5, "amount", low=0, high=1)
    Traceback (most recent call last):
    ValueError: Invalid amount 5. Must be between 0 and 1.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"Invalid {name} {value!r}. Must be a number.")
    if not abs(value) <= np.finfo(float).max:
        raise ValueError(f"Invalid {name} {value}. Must be finite.")
    if not low <= value <= high:
        bounds = f">= {low}" if high == np.inf else f"between {low} and {high}"
        raise ValueError(f"Invalid {name} {value}. Must be {bounds} {unit}".strip() + ".")
    return float(value)


def check_positive(value, name, *, unit=""):
    """Return ``value`` as a finite float above zero.

    Examples
    --------
    >>> check_positive(-0.2, "radius", unit="m")
    Traceback (most recent call last):
    ValueError: Invalid radius -0.2. Must be > 0 m.
    """
    number = check_number(value, name)
    if number <= 0:
        raise ValueError(f"Invalid {name} {value}. Must be > 0 {unit}".strip() + ".")
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
    if not isinstance(value, Hashable) or value not in choices:
        names = ", ".join(map(str, choices))
        raise ValueError(f"Invalid {name} {value!r}. Must be one of {names}.")
    return value


def check_known(value, name, known):
    """Return ``value`` if it is one of many known words; else name the nearest of them.

    Examples
    --------
    >>> check_known("densty", "quantity", ("density", "f"))
    Traceback (most recent call last):
    ValueError: Invalid quantity 'densty'. Must be one of density, f; 'density' is the nearest.
    """
    if value not in known:
        words = [word for word in known if word]
        nearest = difflib.get_close_matches(str(value), words, 1, 0.0)
        names = f"{', '.join(words)}; {nearest[0]!r} is the nearest"
        raise ValueError(f"Invalid {name} {value!r}. Must be one of {names}.")
    return value


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
