"""The public names of the laboratory, derived from its rooms: there is no list to keep.

A room that is a package makes public what stands in its ``__all__``; one that only gathers modules
(``published``, ``radiometry``) what those make public; a module its functions and classes, or its
``__all__`` where it has one. Studies, commands and what runs them are no library.
"""

import importlib
import inspect
import pkgutil

import pandas as pd

import mmqa_lab

NO_LIBRARY = ("__main__", "commands", "gallery", "headless", "studies")


def table(word=""):
    """Return every public function and class with the first line of its docstring.

    Parameters
    ----------
    word : str
        Only names with this word in room, name or line; upper and lower case are one.

    Returns
    -------
    DataFrame
        ``room``, ``name``, ``summary``, in the order of the rooms.

    Raises
    ------
    ValueError
        If the word occurs nowhere.

    Examples
    --------
    >>> found = table("hausdorff")
    >>> ("lines", "lhd") in found[["room", "name"]].itertuples(index=False, name=None)
    True
    """
    rows = [
        (room, name, inspect.getdoc(member).splitlines()[0])
        for room in _rooms()
        for name, member in _members(importlib.import_module(f"mmqa_lab.{room}"))
    ]
    rows = [row for row in rows if word.lower() in " ".join(row).lower()]
    if not rows:
        raise ValueError(f"Invalid word {word!r}. Must occur in a room, a name or its summary.")
    return pd.DataFrame(rows, columns=["room", "name", "summary"])


def _rooms():
    """Dotted names of the modules that make names public."""
    for found in pkgutil.iter_modules(mmqa_lab.__path__):
        if found.name.startswith("_") or found.name in NO_LIBRARY:
            continue
        yield found.name
        room = importlib.import_module(f"mmqa_lab.{found.name}")
        if found.ispkg and not hasattr(room, "__all__"):
            for inner in pkgutil.iter_modules(room.__path__):
                if not inner.name.startswith("_"):
                    yield f"{found.name}.{inner.name}"


def _members(module):
    """Names and objects that a module makes public."""
    given = getattr(module, "__all__", None)
    for name in vars(module) if given is None else given:
        member = getattr(module, name)
        own = getattr(member, "__module__", None) == module.__name__ and not name.startswith("_")
        if (given is not None or own) and (inspect.isfunction(member) or inspect.isclass(member)):
            yield name, member
