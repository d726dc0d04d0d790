"""Tables of text: clouds, paths, segments and lists, as programs and people write them."""

from __future__ import annotations

import csv
import os
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from io import BytesIO

import numpy as np
import pandas as pd

from mmqa_lab._checks import (
    check_columns,
    check_file,
    coordinate_columns,
    listed,
    needs,
    plain_name,
    refuse,
)
from mmqa_lab.cloud import unit_remarks
from mmqa_lab.io.files import plain_text, reading, refuse_unread
from mmqa_lab.io.numbers import parsed

__all__ = [
    "coordinate_columns", "read_segments", "read_table", "text_places",
    "text_table", "with_numbers",
]  # fmt: skip

# Paths of TUM have no header.
TUM_COLUMNS = ["time", "x", "y", "z", "qx", "qy", "qz", "qw"]

SEGMENT_COLUMNS = ["x1", "y1", "z1", "x2", "y2", "z2"]
UNNAMED_SIX = ["x", "y", "z", "column_4", "column_5", "column_6"]

# Numbers as large as this are no heights.
NO_HEIGHT_M = 9999.0

# Squares of numbers as large as this overflow.
NO_NUMBER = 1e100

# What C and Fortran write for no number, besides what pandas knows; what spreadsheets write.
NO_NUMBERS = ("nan(ind)", "-nan(ind)", "nan(snan)", "-nan(snan)")
ERROR_WORDS = re.compile(rb"#([A-Z/0]+[!?]|N/[AD]|NV\b)|-?1\.#[A-Z]+\d*")

# Excel's line that names the separator, and a unit in a row of units.
SEPARATOR_LINE = re.compile(rb'"?sep=."?\s*')
UNIT_WORD = re.compile(
    r"|[(\[].*[)\]]|[kcmd]?m|metres|meters|(us[ -]?|i|s)?ft|feet|foot|in"
    r"|[mun]?s|sec|seconds|deg|degrees|rad|gon"
)

# Cells of a workbook's sheet at most, empty ones before the last counted.
MOST_ENTRIES = 2e7

# Letters of a column's name at most.
LONGEST_HEADER = 200

# Rows of a text that tell its separator, decimal sign and names.
SAMPLE = 60


def text_table(path: str | os.PathLike, name: str, *, header: str = "") -> pd.DataFrame:
    """Read a text file as a table; columns without names are x, y, z, column_4, column_5, ...

    Columns stand between white space, commas, semicolons or tabs. ``#``, ``//`` and ``%`` begin a
    comment: of a line, or behind blank space after the last column. The last one ahead of the rows
    may name x, y and z. A count in the first line (PTS) and the line ``sep=;`` of Excel are passed
    over, a title above the header with a word; a row of units below it becomes part of the names.
    Exponents may be written with D. ``header`` lists what a file must name.
    """
    what, raw = f"{name} {path}", _plain_rows(sheet_text(path, name))
    comment, lines = "", []
    for found in re.finditer(rb"[^\n]+", raw):
        line = found[0].decode(errors="replace").strip()
        if line.startswith("#"):
            comment = comment if lines else line
        elif line and (lines or not SEPARATOR_LINE.fullmatch(found[0])):
            lines.append((found.start(), line.partition(" #")[0].strip()))
        if len(lines) == SAMPLE:
            break
    count = 0
    if len(lines) > 1 and lines[0][1].isdigit() and not lines[1][1].isdigit():
        count = int(lines.pop(0)[1][:LONGEST_HEADER])  # of the points, as in PTS
    refuse(not lines, what, "no rows", "rows of columns")
    words = [_words(line) for _, line in lines]
    usual = Counter(map(len, words)).most_common(1)[0][0]
    above = next((k for k, one in enumerate(words) if len(one) == usual and _is_data(one)), 1)
    first = lines[above][0] if len(lines) > above else len(raw)
    names, separator = _words(comment.lstrip("/# ")), _separator(lines[-1][1])
    if above:
        names, titles = _header(words[:above])
        if titles:
            warnings.warn(f"Passed over what stands above the header of {what}.", stacklevel=4)
    elif len(coordinate_columns(names)) < 3 and not (header and len(names) == usual):
        names = None
    if header and names is None and usual == len(TUM_COLUMNS):
        names = TUM_COLUMNS
    if header and names is None:
        raise ValueError(f"Invalid {what}: no header. Must have one with {header}.")
    layout = {"header": None, "sep": separator, "before": raw.count(b"\n", 0, first)}
    rows = raw[first:]
    if b"#" in rows:
        inside = rb"[^,;\t\n]" if separator != r"\s+" else rb"[^\n]"
        rows = re.sub(rb"(?m)^[ \t]*#.*$|[ \t]#" + inside + rb"*$", b"", rows)
    table = _read_csv(BytesIO(rows), what, **layout)
    split = separator == "," and _has_split_numbers(words[above:], names)
    refuse(split, what, "decimal commas between commas", "told apart")
    if any(b"," in rows and table[k].dtype.kind not in "iufb" for k in table):
        texts = _read_csv(BytesIO(rows), what, dtype=object, keep_default_na=False, **layout)
        table = parsed(texts, what, separator=separator)
    short = f"{len(table)} rows where its first line says {count}"
    refuse(len(table) < count, what, short, "as many")
    return _with_names(table, names, what)


def sheet_text(path, name):
    """Return the text of a file of rows: of a workbook, the first sheet as CSV."""
    path = check_file(path, name)
    if path.suffix.lower() not in (".xlsx", ".xlsm"):
        refuse_unread(path, name, endings=())
        return plain_text(path)
    openpyxl = needs("files", "openpyxl")
    with reading(path, name, "an Excel workbook"):
        book = openpyxl.load_workbook(path, read_only=True)
        first, names, wide = book.worksheets[0], book.sheetnames, 1
        first.reset_dimensions()  # what it states of them is not believed
        for high, row in enumerate(first.iter_rows(values_only=True), 1):
            wide = max(wide, len(row))
            if wide * high > MOST_ENTRIES:
                raise ValueError("a sheet of too many cells")
        book.close()
        rows = pd.read_excel(path, sheet_name=0, header=None, dtype=object, na_filter=False)
    if len(names) > 1:
        warnings.warn(f"Read the first of {len(names)} sheets of {path}.", stacklevel=4)
    return rows.to_csv(index=False, header=False).encode()


def _header(rows):
    """The names of columns in the rows above the first data, and the number of titles above."""
    last = rows[-1] if len(rows) > 1 else ["x"]
    units = (
        last if all(map(UNIT_WORD.fullmatch, last)) or UNIT_WORD.fullmatch(",".join(last)) else []
    )
    *titles, names = rows[:-1] if units else rows
    if len(units) == len(names):
        names = [f"{name} [{unit.strip('()[]')}]" for name, unit in zip(names, units, strict=True)]
    return names, len(titles)


def _plain_rows(raw):
    """A text with # for every comment, numbers as they are written in C and nan for no number."""
    raw = ERROR_WORDS.sub(b"nan", raw) if b"#" in raw else raw
    if b"/" in raw:
        raw = re.sub(rb"(?m)(^|(?<=[ \t]))//", b"#", raw)
    if b"%" in raw or b"!" in raw:
        raw = re.sub(rb"(?m)^[%!]", b"#", raw)
    if b"D" in raw or b"d" in raw:
        raw = re.sub(rb"(?<=[\d.])[dD](?=[+-]\d)", b"e", raw)
    return raw


def _read_csv(stream, what, *, before=0, **layout):
    """A table as pandas reads it; what pandas cannot read gives one sentence."""
    layout = {"skipinitialspace": True, "low_memory": False, "na_values": NO_NUMBERS} | layout
    try:
        return pd.read_csv(stream, encoding_errors="replace", **layout)
    except pd.errors.EmptyDataError:
        found = "no rows"
    except pd.errors.ParserError as error:
        told = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        found = "a quotation mark that does not end"
        if told:
            wanted, line, seen = map(int, told.groups())
            found = f"{seen} columns in line {line + before} after {wanted} before"
    raise ValueError(f"Invalid {what}: {found}. Must be rows of columns.")


def _has_split_numbers(rows, names):
    """Whether commas stand between columns and within numbers."""
    if names is not None:
        return all(len(row) == 2 * len(names) for row in rows)
    ends = [word for row in rows for word in row[1::2]]
    whole = all(re.fullmatch(r"-?\d+", word) for row in rows for word in row)
    return whole and any(re.fullmatch(r"0\d+", word) for word in ends)


def _with_names(table, names, what):
    """A table of a text file with the names of its columns."""
    long = max(map(len, names or [""])) > LONGEST_HEADER
    refuse(long, what, f"a name of more than {LONGEST_HEADER} letters", "named shortly")
    names = names and "\0".join(names).rstrip("\0").split("\0")
    count = len(names) if names else len(table.columns)
    if len(table.columns) > count and table.iloc[:, count:].isna().all(axis=None):
        table = table.iloc[:, :count]  # a separator behind each row
    if len(table.columns) != count:
        found = f"{count} names over {len(table.columns)} columns"
        raise ValueError(f"Invalid {what}: {found}. Must agree.")
    if names is None and len(table) > 2 and count > 2:
        numbers = table.iloc[:, :3].apply(pd.to_numeric, errors="coerce")
        words = (numbers.isna() & table.iloc[:, :3].notna()).all()
        counted = count > 3 and (numbers[0].diff()[1:] == 1).all()
        high = count > 3 and (numbers[2].abs() > NO_HEIGHT_M).mean() > 0.5
        other = counted or high or words.any()
        refuse(other, what, "its first columns are not x, y, z", "named by a header")
    names = names or [*"xyz", *(f"column_{k}" for k in range(4, count + 1))][:count]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    refuse(twice, what, f"column {[*twice, ''][0]!r} twice", "distinct names")
    return table.set_axis(names, axis=1)


def _separator(line):
    """The separator of the words of a line; a comma within a number is its decimal sign."""
    for mark in (";", "\t", "|"):
        if mark in line:
            return mark
    words = line.split()
    inside = len(words) > 2 and all(word.strip(",") == word for word in words)
    return "," if "," in line and not (inside and _is_data(words)) else r"\s+"


def _words(line):
    """The words of a line."""
    mark = _separator(line)
    return [word.strip(' "') for word in (line.split(mark) if len(mark) == 1 else line.split())]


def _is_data(words):
    """Whether a line has numbers rather than names: two words or more begin as numbers do."""
    begun = [bool(re.match(r"[+-]?[.,]?\d", word)) for word in words]
    return sum(begun) >= min(2, len(words)) or (len(words) > 0 and words[0].lower() == "nan")


def text_places(path: str | os.PathLike, name: str, *, finite: bool = True) -> tuple:
    """Return the coordinates (n, 3) of a text file, and its other columns {name: values}."""
    what, table = f"{name} {path}", text_table(path, name)
    names = coordinate_columns(table.columns)
    if len(names) < 3:
        found, must = f"columns {listed(table.columns)}", "x, y, z in metres"
        raise ValueError(f"Invalid {what} with {found}. Must have {must}.")
    places = with_numbers(table, names, what, finite=finite)[names].to_numpy()
    return places, {other: table[other].to_numpy() for other in table.columns.drop(names)}


def read_table(path: str | os.PathLike, name: str, columns: Sequence[str] = ()) -> pd.DataFrame:
    """Return a CSV file or a workbook as a table, or raise a sentence where it is none.

    Semicolons or tabs between columns are read too. Columns of nothing but numbers are numbers
    (:func:`mmqa_lab.io.numbers.parsed` says how they may be written), but for names of systems,
    criteria, images and the like; others are texts as they stand. Rows without any entry and a
    title above the header are passed over.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If rows and names do not agree, a column is missing, or thousands cannot be told from
        decimals.
    """
    what, raw = f"{name} {path}", sheet_text(path, name)
    lines = [line for line in raw.split(b"\n") if line.strip(b",;\t ")]
    lines = lines[1:] if lines and SEPARATOR_LINE.fullmatch(lines[0]) else lines
    refuse(not lines, what, "no rows", "rows of columns")
    separator = max(b",;\t", key=lambda mark: sorted(row.count(mark) for row in lines[:2]))
    inside = [line.strip(b",;\t ").count(separator) for line in lines[:2]]
    if inside[0] == 0 < inside[-1]:
        told = f"Passed over the title {lines.pop(0).decode(errors='replace').strip(',; ')!r}"
        warnings.warn(f"{told} of {what}.", stacklevel=2)
    names, *_ = csv.reader([lines[0].decode(errors="replace")], delimiter=chr(separator))
    most = max(line.count(separator) for line in lines) + 1
    layout = {"names": range(max(most, len(names))), "index_col": False, "sep": chr(separator)}
    layout |= {"dtype": object, "keep_default_na": False}
    rows = _read_csv(BytesIO(b"\n".join(lines[1:])), what, **layout) if lines[1:] else []
    table = pd.DataFrame(rows, columns=layout["names"]).replace("", np.nan)
    table = _with_names(table, [name.strip() for name in names], what)
    table = parsed(table.dropna(how="all", ignore_index=True), what, separator=chr(separator))
    check_columns(table, columns, what)
    return table


def with_numbers(
    table: pd.DataFrame,
    columns: Sequence[str],
    name: str,
    *,
    finite: bool = True,
    wanted: str = "numbers",
) -> pd.DataFrame:
    """Return a table with numbers in these columns; a sentence names the first bad entry."""
    check_columns(table, columns, name)
    found = table[list(columns)].apply(pd.to_numeric, errors="coerce").astype(float)
    bad = ~(found.abs() < NO_NUMBER) if finite else found.isna() & table[list(columns)].notna()
    if bad.any(axis=None):
        row = int(bad.any(axis=1).to_numpy().argmax())
        column = bad.columns[bad.iloc[row].to_numpy().argmax()]
        entry = table[column].iloc[row]
        told = "nothing" if pd.isna(entry) else repr(str(entry)[:30])
        grouped = re.fullmatch(r"[+-]?\d{1,3}([.,' ]\d{3})+([.,]\d+)?", str(entry))
        wanted += " without thousands separators" if grouped else ""
        found = f"no finite number in row {row + 1} of column {column}, {told}"
        raise ValueError(f"Invalid {name}: {found}. Must be {wanted}.")
    return table.assign(**found)


def read_segments(path: str | os.PathLike) -> np.ndarray:
    """Read line segments from a CSV or text file.

    Parameters
    ----------
    path : path
        A segment in a line: x1, y1, z1, x2, y2, z2 in metres, between commas, semicolons or white
        space. A header is optional; these names may stand in any order among others.

    Returns
    -------
    array, shape (n, 2, 3)
        Both ends of each.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a line lacks six finite numbers; names it.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> file = Path(tempfile.mkdtemp()) / "edges.csv"
    >>> _ = file.write_text("x1,y1,z1,x2,y2,z2\\n0,0,0,0,0,12\\n0,0,12,9,0,12\\n")
    >>> read_segments(file)[1].tolist()
    [[0.0, 0.0, 12.0], [9.0, 0.0, 12.0]]
    """
    what, table = f"segments {path}", text_table(path, "segments")
    table = table.rename(columns={name: plain_name(name) for name in table})
    if [*table.columns] == UNNAMED_SIX:
        table = with_numbers(table.set_axis(SEGMENT_COLUMNS, axis=1), SEGMENT_COLUMNS, what)
        first, last = np.split(table.to_numpy(), 2, axis=1)
        colours = (last == np.round(last)).all() and (last >= 0).all() and last.max() <= 65_535
        units = np.abs(np.linalg.norm(last, axis=1) - 1).max() < 1e-2
        doubted = len(table) > 2 and (units or (colours and (first != np.round(first)).any()))
        found = "six columns that look like points with colours or normals"
        refuse(doubted, what, found, "with a header x1, y1, z1, x2, y2, z2")
    numbers = with_numbers(table, SEGMENT_COLUMNS, what)
    ends = numbers[SEGMENT_COLUMNS].to_numpy().reshape(-1, 2, 3)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    for remark in unit_remarks(ends.reshape(-1, 3), lengths=lengths):
        warnings.warn(f"{path}: {remark}", stacklevel=2)
    return ends
