"""Files written whole or not at all, and damaged ones named in one sentence."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: str | os.PathLike, write: Callable[[Path], object]) -> None:
    """Call ``write(temporary_path)`` and put the file in its place only when that succeeded.

    The temporary file lies in the same folder and has the same ending; it is removed when
    ``write`` fails.

    Parameters
    ----------
    path : path
        Folders are made where missing; an existing file is replaced.
    write : callable
        Takes the path of the temporary file.

    Raises
    ------
    OSError
        If no file can be made there.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(Path(folder) / "f.txt", lambda file: file.write_text("whole"))
    ...     [path.name for path in Path(folder).iterdir()]
    ['f.txt']
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    _check_writable(path, temporary)
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _check_writable(path, temporary):
    """Raise one sentence where no file can be made beside ``path``; folders are made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
        temporary.unlink()
    except OSError as error:
        raise OSError(
            f"Invalid file {path}: {error.strerror}. Must lie in a folder that can be written to."
        ) from error


@contextlib.contextmanager
def damage_named(path, wanted):
    """Turn whatever a reader raises on a damaged file into one sentence."""
    try:
        yield
    except (GeneratorExit, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # the Rust reader of LAZ panics outside of Exception
        reason = first_sentence(error)
        raise ValueError(f"Invalid cloud {path}: {reason}. Must be {wanted}.") from error


def first_sentence(error):
    """The first line of an error's text, without its full stop."""
    lines = str(error).strip().splitlines()
    return (lines[0] if lines else type(error).__name__).rstrip(". ")
