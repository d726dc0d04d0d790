"""What all checks share: the sentence, names within it, and choices among words."""

import difflib
import importlib
import textwrap
from collections.abc import Hashable

__all__ = ["check_choice", "check_columns", "check_known", "listed", "needs", "refuse"]

# Letters of a list of names within a sentence.
LETTERS_LISTED = 300


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
    """Names as part of a sentence; many of them are cut short.

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
