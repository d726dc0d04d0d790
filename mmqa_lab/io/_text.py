"""Text tables: their layout is found out from the first lines, their columns from their names."""

from dataclasses import dataclass
from itertools import islice

import pandas as pd

from mmqa_lab._checks import coordinate_columns
from mmqa_lab.io._files import damage_named, first_sentence

SAMPLED_LINES = 8
"""Lines of data that are looked at to find out the layout."""


@dataclass(frozen=True)
class Layout:
    """How the lines of a text file are to be read."""

    skip: int
    separator: str
    decimal: str
    names: list
    coordinates: list


def text_tables(path, chunk):
    """Yield points (n, 3) and attributes of a text file, at most ``chunk`` points at a time."""
    layout = _layout_of(path)
    frames = read_csv(
        path,
        sep={" ": r"\s+"}.get(layout.separator, layout.separator),
        decimal=layout.decimal,
        header=None,
        names=layout.names,
        skiprows=layout.skip,
        comment="#",
        skipinitialspace=True,
        index_col=False,
        chunksize=chunk,
    )
    with damage_named(path, "rows of numbers, x y z first or named in a header"):
        for frame in frames:
            coordinates = frame[layout.coordinates].apply(pd.to_numeric, errors="raise")
            rest = [name for name in layout.names if name not in layout.coordinates]
            attributes = {name: frame[name].to_numpy() for name in rest}
            yield coordinates.to_numpy(dtype="float64"), attributes


def read_csv(path, **choices):
    """``pandas.read_csv`` with one sentence where the file is no table."""
    try:
        return pd.read_csv(path, encoding="utf-8-sig", encoding_errors="replace", **choices)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, ValueError) as error:
        reason = first_sentence(error)
        raise ValueError(f"Invalid table {path}: {reason}. Must be rows of columns.") from error


def _layout_of(path):
    """The layout of a text file, from its first lines of comment, header and data."""
    before, lines = _first_lines(path)
    skip = lines[0][0]
    if len(lines) > 1 and _is_count(lines[0][1], lines[1][1]):
        lines, skip = lines[1:], lines[1][0]
    separator = _separator(lines[-1][1])
    header = None
    if not _is_data(_words(lines[0][1], separator)):
        header, skip = _words(lines[0][1], _separator(lines[0][1])), lines[0][0] + 1
        lines = lines[1:]
    rows = [_words(line, separator) for _, line in lines]
    decimal = "," if separator == ";" and any("," in word for row in rows for word in row) else "."
    names = header or _commented_names(before, rows)
    if names is None:
        names = _numbered(path, rows)
        return Layout(skip, separator, decimal, names, names[:3])
    return Layout(skip, separator, decimal, *_named(path, names, rows))


def _first_lines(path):
    """The comments before the first other line; the first of the others with their numbers."""
    before, lines = [], []
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(islice(file, 1000)):
            if line.startswith("//") and not lines:
                before.append(line)
            elif line.split("#")[0].strip():
                lines.append((number, line.split("#")[0].strip()))
            elif not lines:
                before.append(line)
            if len(lines) > SAMPLED_LINES:
                break
    if not lines:
        raise ValueError(f"Invalid table {path}: no rows. Must be rows of columns.")
    return before, lines


def _is_count(first, second):
    """Whether a first line counts the points that follow, as in PTS files."""
    return first.isdigit() and len(_words(second, _separator(second))) > 1


def _separator(line):
    """What stands between the words of a line."""
    return next((mark for mark in (";", ",", "\t") if mark in line), " ")


def _words(line, separator):
    """The words of a line."""
    words = line.split() if separator == " " else line.split(separator)
    return [word.strip().strip('"') for word in words]


def _is_data(words):
    """Whether a line has numbers rather than names."""
    return all(_is_number(word.replace(",", ".")) for word in words if word)


def _is_number(word):
    try:
        float(word)
    except ValueError:
        return False
    return True


def _commented_names(before, rows):
    """The names of the columns from the last comment, where it has names for x, y, z and all."""
    comments = [line.strip().lstrip("#/").strip() for line in before if line.strip()]
    if not comments or not rows:
        return None
    words = _words(comments[-1], _separator(comments[-1]))
    named = len(words) == len(rows[0]) and len(coordinate_columns(words)) == 3
    return words if named else None


def _named(path, names, rows):
    """The names of the columns, each once, and those of x, y, z."""
    if rows and len(rows[0]) != len(names):
        raise ValueError(
            f"Invalid table {path}: {len(names)} names over {len(rows[0])} columns. "
            "Must be a name for each column."
        )
    unique = [
        name if name and name not in names[:place] else f"{name or 'column'}_{place + 1}"
        for place, name in enumerate(names)
    ]
    coordinates = coordinate_columns(unique)
    if len(coordinates) < 3:
        raise ValueError(
            f"Invalid table {path} with columns {', '.join(unique)}. "
            "Must have x, y, z or easting, northing, height."
        )
    return unique, coordinates


def _numbered(path, rows):
    """Names for columns without any: x, y, z and the numbers of the others."""
    count = len(rows[0])
    if count < 3:
        raise ValueError(
            f"Invalid table {path}: {count} columns. Must be rows of numbers, x y z first."
        )
    first = [row[0] for row in rows]
    counted = [[str(k + start) for k in range(len(rows))] for start in (0, 1)]
    if count > 3 and len(rows) > 2 and first in counted:
        raise ValueError(
            f"Invalid table {path}: its first column numbers the rows. "
            "Must have a header that names x, y, z."
        )
    return ["x", "y", "z", *(f"column_{k + 1}" for k in range(3, count))]
