"""Checks of paths: files that are read, and outputs that must replace nothing else."""

import contextlib
from pathlib import Path

from mmqa_lab._checks.words import refuse

__all__ = ["check_file", "check_kind", "check_outputs", "full_path", "is_file"]

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
