"""The command line.

A command is a function of the options that :func:`command` decorates: its
summary (the line in ``mmqa --help``), examples, and arguments. Its docstring is the manual page. It
raises what the rooms raise: one sentence. At the top modules import the standard library alone, so
that help needs no environment.
"""

import argparse
import importlib
from pathlib import Path
from types import SimpleNamespace


def output_file(text):
    """A file to write to; a folder of that name is refused before any work."""
    if Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"Invalid file {text}: a folder. Must be a file.")
    return Path(text)


class Lazy:
    """A module that is imported when it is first used, so that help needs no environment."""

    def __init__(self, name):
        self._name = name

    def __getattr__(self, name):
        return getattr(importlib.import_module(self._name), name)


COMMANDS = {}
"""Commands by their names, each with ``run``, ``summary``, ``arguments`` and ``examples``."""


def command(summary, *arguments, examples=()):
    """Make a command of a function of the options, whose docstring is its manual page.

    The function returns an exit status, or None for success. Examples are what stands
    behind the command's name.
    """

    def made(run):
        name = run.__name__.rstrip("_")
        calls = "\n".join(["example:", *(f"  mmqa {name} {one}".rstrip() for one in examples)])
        about = {"summary": summary, "arguments": arguments, "examples": calls}
        COMMANDS[name] = SimpleNamespace(run=run, **about)
        return run

    return made


def numbers(text, name, wanted, count=None):
    """Numbers between commas, of which there must be so many where a count is given."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or len(found) != (count or len(found)):
        raise ValueError(f"Invalid {name} {text}. Must be {wanted}.")
    return found


def option(names, metavar, text, kind=str, default=None, **more):
    """An argument with a value, as argparse takes it: its names, and the rest; help says a number's
    default with its unit."""
    if kind in (float, int) and default is not None:
        text += f", default {default:g}{UNITS.get(metavar, '')}"
    about = {"metavar": metavar, "help": text, "type": kind, "default": default}
    return names.split(), about | more


def choice(names, choices, text):
    """An argument with one of a few values, the first where it is not given."""
    text = f"{text}, default {choices[0]}"
    return names.split(), {"choices": choices, "default": choices[0], "help": text}


def switch(names, text):
    """An argument without a value."""
    return names.split(), {"action": "store_true", "help": text}


UNITS = {"M": " m", "S": " s", "DEG": " degrees"}
"""What is said behind a default, by the argument's metavar."""

OUTPUT = (
    switch("--json", "print JSON instead of a table"),
    option("--csv", "FILE", "also write the rows to this file", output_file),
)

CLOUDS = option("cloud", "CLOUD", "LAS, LAZ, COPC, PLY, PCD, E57 or text", nargs="+")

POLYGON = (
    option("--polygon", "VERTICES", "CSV or GeoJSON of 3-D vertices, m, or 'x,y,z; x,y,z; ...'"),
    option("--thickness", "M", "take points up to this far from the polygon's plane", float, 0.1),
)

FIGURE = option("--out --figure", "FILE", "draw the last one: .pdf, .svg or .png", output_file)
