"""How a file is written, what it is by its first bytes, and how it is read at all, if it is."""

from __future__ import annotations

import codecs
import contextlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from mmqa_lab._checks import check_kind, full_path, refuse

__all__ = [
    "PTX_HEAD", "RAW_ENDINGS", "alone", "form_of", "own_folder", "plain_text", "reading",
    "refuse_unread", "write_atomically",
]  # fmt: skip

# Bytes at the beginning of a text file that tell its letters.
HEAD = 65_536

# Constant fields are packed into next to nothing: so many points of a byte are still believed.
MOST_PER_BYTE = 64

# Space below which a library that fails has filled the disk: some leave room as they give up.
FULL_BYTES = 2**20

# The file by which a folder is known as one that the package writes.
MARK = ".mmqa_lab"
MARK_FLAGS = os.O_CREAT | os.O_APPEND | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)

# Columns and rows of a scan, the scanner's place and axes, and the matrix to the common system.
PTX_HEAD = re.compile(
    rb"\s*(\d+)[ \t]*\n[ \t]*(\d+)[ \t]*\n((?:[^\s]+[ \t]+){2}[^\s]+[ \t]*\n){4}"
    rb"(((?:[^\s]+[ \t]+){3}[^\s]+[ \t]*\n){4})"
)

# The readers of clouds by how files begin, whatever their ending says.
BEGUN = {"e57": rb"ASTM-E57", "las": rb"LASF", "ply": rb"(\xef\xbb\xbf)?ply\s"}
BEGUN |= {"pcd": rb"# \.PCD|VERSION \.?\d[^\n]*\n(#.*\n)*FIELDS ", "ptx": PTX_HEAD.pattern}

# Photographs as their sensors saw them; DNG is read.
RAW_ENDINGS = (
    ".cr2 .cr3 .crw .nef .nrw .arw .srf .sr2 .raf .orf .rw2 .pef .srw .x3f .3fr .iiq .erf .mrw"
)

WEB_PAGE = rb"\s*<(!doctype )?html"

# What is not read: how it begins, its endings, its name, and what to do.
UNREAD = (
    (rb"FUJIFILM|IIRO|IIU\0|FOVb|MM\0\*.{4}Ph|II\*\0.{4}CR|....ftypcrx", RAW_ENDINGS,
     "a RAW photograph", "save it as TIFF of 16 bits"),
    (WEB_PAGE, ".html .htm", "a web page", "download the file itself"),
    (None, ".xlsx .xlsm .ods", "a workbook", "save its sheet as CSV"),
    (rb"PK\x03\x04", ".zip .kmz .7z .rar", "a compressed archive", "unpack it"),
    (rb"\x1f\x8b|BZh\d1AY|\xfd7zXZ\0|\x28\xb5\x2f\xfd", ".gz .tgz .bz2 .xz .zst",
     "a compressed archive", "unpack it"),
    (rb"\s*ncols\s+\d+", "", "an ESRI grid", "give it as reference heights"),
    (rb"SQLite format 3", ".gpkg", "a GeoPackage", "give it as --polygon"),
    (rb"\0\0\x27\x0a", ".shp", "a shapefile", "give it as --polygon"),
    (rb"fgb\x03fgb", ".fgb", "a FlatGeobuf", "give it as --polygon"),
    (rb"II\*\0|MM\0\*", "", "a TIFF file", "give it as an image or as reference heights"),
    (rb"\x89HDF|CDF[\1\2]", ".h5 .nc", "an HDF or NetCDF file", "save it as LAS or text"),
    (rb"#ROSBAG|\x89MCAP", ".bag .mcap .db3", "a robot's log", "save its clouds as PCD"),
    (rb"\xd4\xc3\xb2\xa1|\n\r\r\n", ".pcap .pcapng", "packets", "save them as LAS or PCD"),
    (rb"\xd0\xcf\x11\xe0", ".xls", "an old Excel workbook", "save it as XLSX or CSV"),
    (rb"AC10\d\d", ".dwg", "a DWG drawing", "save it as DXF"),
    (rb"\0\0\0.ftyp(heic|heix|mif1)", ".heic .heif", "a HEIC photograph", "save it as JPEG"),
    (rb"(<\?xml[^>]*>\s*)?<gpx", ".gpx", "a GPX track", "save it as a table"),
    (rb"\$[A-Z]{5},", ".nmea", "NMEA sentences", "save them as a table"),
    (rb"<\?xml|<kml", ".kml", "an XML file", "give outlines as --polygon"),
    (rb"%PDF", ".pdf", "a PDF", "save its tables as CSV"),
    (None, ".rcp .rcs .fls .lsproj .zfs .rxp .ptg .bin .cl3 .fws", "a scanner's own format",
     "save it as E57 or LAS"),
    (None, ".obj .stl .off .glb .gltf .fbx", "a mesh", "save its points as PLY"),
    (None, ".npy .npz .mat .pkl .parquet", "an array", "save it as LAS or CSV"),
)  # fmt: skip


def check_bytes(path, what, found, n, must, *, few=0, most=MOST_PER_BYTE):
    """Refuse n things that were found to stand in fewer bytes than they need, but for a few."""
    refuse(n > max(few, most * path.stat().st_size), what, f"{found} in so few bytes", must)


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
    path = full_path(path)
    with contextlib.ExitStack() as left, _writing(path):
        path = path.resolve()
        check_kind(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.stem[:40]}.{secrets.token_hex(8)}{path.suffix}")
        temporary.touch(exist_ok=False)  # no link that somebody has laid there is followed
        left.callback(temporary.unlink, missing_ok=True)  # when it is known whether it filled all
        if isinstance(write, pd.DataFrame):
            write.to_csv(temporary, index=False, errors="replace")
        elif isinstance(write, str):
            temporary.write_text(write, encoding="utf-8", errors="replace")
        else:
            write(temporary)
        with temporary.open("rb+") as file:
            os.fsync(file)
        if path.exists():
            shutil.copymode(path, temporary)
        temporary.replace(path)


@contextlib.contextmanager
def _writing(path):
    """Say of which file it is what a system, or a library on a full disk, raises."""
    try:
        yield
    except Exception as error:
        if str(error).startswith("Invalid"):
            raise
        full = path.parent.is_dir() and shutil.disk_usage(path.parent).free < FULL_BYTES
        if not isinstance(error, OSError) and not full:
            raise
        told = getattr(error, "strerror", None)  # none, as numpy says of a write that ended early
        found = told or "no space is left"
        raise OSError(f"Invalid file {path}: {found}. Must be writable.") from error


@contextlib.contextmanager
def alone(path: str | os.PathLike, seconds: float = 10.0) -> Iterator[None]:
    """Hold a file that others read, change and write as well, by a lock beside it.

    A lock that is older than so many seconds was left behind, and is taken over.
    """
    lock, until = Path(f"{path}.lock"), time.monotonic() + seconds
    lock.parent.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            lock.touch(exist_ok=False)
            break
        except FileExistsError:
            if time.monotonic() > until:
                lock.unlink(missing_ok=True)
            time.sleep(0.01)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)


@contextlib.contextmanager
def own_folder(folder: str | os.PathLike, *, ours: bool = False) -> Iterator[Path]:
    """Hold a folder whose files a run may replace: new, empty, or marked by an earlier run.

    Whatever else lies in it stays: such a folder is refused. So is one that another run holds. A
    folder that is empty in the end, as after a mistake, is removed if it was made here.

    Parameters
    ----------
    folder : path
        Made where missing.
    ours : bool
        The folder needs no mark, as that of a repository's results.

    Raises
    ------
    OSError
        If no file can be made there.
    ValueError
        If it has files of others, or another run writes into it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     with own_folder(f"{place}/results") as folder:
    ...         write_atomically(folder / "f.csv", "whole")
    ...     [path.name for path in sorted(folder.iterdir())]
    ['.mmqa_lab', 'f.csv']
    """
    folder, made = Path(folder), not Path(folder).exists()
    inside = sorted(folder.iterdir()) if folder.is_dir() else []
    if inside and not ours and not (folder / MARK).is_file():
        found = f"{inside[0].name} in it is not from mmqa"
        raise ValueError(f"Invalid folder {folder}: {found}. Must be new, empty or of such a run.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        opened = os.open(folder / MARK, MARK_FLAGS, 0o666)
    except OSError as error:
        raise OSError(f"Invalid folder {folder}: {error.strerror}. Must be writable.") from error
    try:
        with os.fdopen(opened, "a", encoding="utf-8") as file:
            _lock(file, folder)
            if not file.tell():
                file.write("mmqa_lab writes into this folder and may replace its files.\n")
                file.flush()
            yield folder
    finally:
        if made and [path.name for path in folder.iterdir()] == [MARK]:
            (folder / MARK).unlink()
            folder.rmdir()


def _lock(file, folder):
    """Keep other runs out of a folder; the lock of its file ends with this process."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        found = "another run writes into it"
        raise ValueError(f"Invalid folder {folder}: {found}. Must be another one.") from error
    except OSError:  # a file system without locks
        pass


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
    if re.match(WEB_PAGE, raw, re.IGNORECASE):
        raise ValueError(f"Invalid file {path}: a web page. Must be the file that it links.")
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


def form_of(path):
    """Return which reader of clouds a file belongs to by its first bytes; "" if they tell none."""
    with Path(path).open("rb") as file:
        head = file.read(4096)
    return next((name for name, mark in BEGUN.items() if re.match(mark, head)), "")


def refuse_unread(path, name, *, endings=None):
    """Raise a sentence that names the format of a file that is not read, if it is known.

    Its first bytes tell it or its ending: one of ``endings``, by default any of the table.
    """
    with Path(path).open("rb") as file:
        head = file.read(4096)
    ending = Path(path).suffix.lower()
    for mark, ends, what, instead in UNREAD:
        begins = mark is not None and re.match(mark, head, re.DOTALL | re.IGNORECASE)
        if begins or (ending in ends.split() and endings in (None, ends)):
            raise ValueError(f"Invalid {name} {path}: {what}. Must be another; {instead}.")
