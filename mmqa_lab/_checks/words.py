"""What all checks share: the sentence, names in it, choices; single numbers, and paths of files."""

import contextlib
import difflib
import importlib
import numbers
import textwrap
from collections.abc import Hashable
from pathlib import Path

import numpy as np

__all__ = [
    "check_choice", "check_columns", "check_count", "check_file", "check_kind", "check_known",
    "check_number", "check_outputs", "check_positive", "full_path", "is_file", "listed",
    "needs", "refuse",
]  # fmt: skip


# Letters of a list of names within a sentence.
LETTERS_LISTED = 300


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


def listed(names):
    """Return names as part of a sentence; many of them are cut short.

    Examples
    --------
    >>> listed(["x", "y"]), len(listed(range(1000))) <= LETTERS_LISTED
    ('x, y', True)
    """
    return textwrap.shorten(", ".join(map(str, names)), LETTERS_LISTED, placeholder=" ...")


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
    """Return whether a file is there; a text that can be no path names none.

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
