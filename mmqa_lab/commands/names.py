"""List the public names of the library: room, name, and what it is for in a line.

With WORD only those in which it occurs. What a name takes and gives back, its units, errors and
source: help(mmqa_lab.ROOM.NAME) in Python, or NAME? in a notebook.
"""

import importlib
import inspect
import pkgutil

import mmqa_lab
from mmqa_lab.commands._output import add_output_arguments, print_rows

SUMMARY = "list the public names of the library"

EPILOG = """\
example:
  mmqa names
  mmqa names density --json
"""

# A room that is a package makes public what is in its __all__; one that only gathers modules what
# those make public; a module its functions and classes, or its __all__ where it has one.
NO_LIBRARY = ("__main__", "commands", "studies")


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("word", nargs="?", default="", metavar="WORD", help="all names if none")
    add_output_arguments(parser)


def run(options):
    """Print the names and write them where asked for."""
    print_rows(table(options.word), options)


def table(word=""):
    """Return every public function and class: room, name and the first line of its docstring."""
    import pandas as pd

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
