"""How a file is written, and how it is read at all: whole, in the right letters, or a sentence."""

from __future__ import annotations

import codecs
import contextlib
import os
import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from mmqa_lab._checks import check_kind

__all__ = ["plain_text", "reading", "write_atomically"]

# Bytes at the beginning of a text file that tell its letters.
HEAD = 65_536


def write_atomically(path: str | os.PathLike, write: Callable | str | pd.DataFrame) -> None:
    """Call ``write(temporary_path)`` and put the file in its place only when that succeeded.

    Parameters
    ----------
    path : path
        Folders are made where missing; an existing file is replaced, of a symbolic link the file
        that it names.
    write : callable, str or DataFrame
        Takes the path of the temporary file, which has the same ending. A text is written as it
        is, a table as CSV without its index.

    Raises
    ------
    OSError
        If no file can be made there, or something is there that is no file, as a device.
    ValueError
        If a file is there that is of another kind than the ending says.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "f.txt", "whole")
    ...     [path.name for path in Path(folder).iterdir()]
    ['f.txt']
    """
    path = Path(path).resolve()
    check_kind(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise OSError(f"Invalid file {path}: {error.strerror}. Must be writable.") from error
    try:
        if isinstance(write, pd.DataFrame):
            write.to_csv(temporary, index=False, errors="replace")
        elif isinstance(write, str):
            temporary.write_text(write, encoding="utf-8", errors="replace")
        else:
            write(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def reading(path, name, wanted):
    """Turn what a library raises on a damaged file into one sentence.

    Only calls of libraries belong inside: an error of the package is no damaged file. The reader of
    LAZ panics outside of ``Exception``.
    """
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        found = "damaged, cut short or of another kind"
        raise ValueError(f"Invalid {name} {path}: {found}. Must be {wanted}.") from error


def plain_text(path: str | os.PathLike) -> bytes:
    """Return a text file as UTF-8 with line feeds, without a byte order mark.

    UTF-16 and UTF-32 are told by their mark or their zeros; what is no UTF-8 is Windows-1252. A
    file with zero bytes is no text: ValueError.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "a.txt").write_bytes("Höhe 1".encode("utf-16"))
    ...     plain_text(Path(folder) / "a.txt").decode()
    'Höhe 1'
    """
    raw = Path(path).read_bytes()
    code = _letters(raw[:HEAD])
    if code != "utf-8":
        raw = raw.decode(code, errors="replace").encode()
    raw = raw.removeprefix(codecs.BOM_UTF8)
    if (zero := raw.find(b"\0")) >= 0:
        line = raw.count(b"\n", 0, zero) + 1
        raise ValueError(f"Invalid file {path}: a zero byte in line {line}. Must be text.")
    return re.sub(rb"\r\n?", b"\n", raw) if b"\r" in raw else raw


def _letters(head):
    """The encoding of a text file that begins so."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    zeros = [head[k::2].count(0) > len(head) / 8 for k in (0, 1)]
    if any(zeros) and not all(zeros):
        return "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"
