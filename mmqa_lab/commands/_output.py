"""What all commands share: what is printed, what is written, what is said meanwhile."""

import re
import sys
import textwrap

PLACE = re.compile(r"([xyz]|easting|northing)(_low|_high|_base)?_m")
"""Columns of coordinates, which are printed to centimetres: they have more than four figures."""


def with_progress(items, unit):
    """Go through items under a bar on stderr; there is none where that is no terminal."""
    from tqdm import tqdm

    return tqdm(items, unit=unit, disable=None, leave=False)


def print_rows(frame, options, *, upright=None):
    """Print a DataFrame as a table or as JSON, and write it where ``--csv`` says.

    JSON is a list with an object for each row, null where a figure is not measurable. ``upright``
    names the column that heads the table where each row is printed as a column, because that is
    narrower. What stands in the column ``remarks`` is printed below the table.
    """
    write_rows(frame, options)
    if options.json:
        print_json(frame.astype(object).to_dict(orient="records"))
        return
    remarks = _remarks(frame)
    frame = frame.drop(columns="remarks", errors="ignore")
    if frame.empty:
        print(f"{' '.join(frame.columns)}\nnone")
        return
    places = [name for name in frame if PLACE.fullmatch(name)]
    tables = [frame.assign(**{name: frame[name].map("{:.2f}".format) for name in places})]
    if upright is not None:
        tables.append(tables[0].set_index(upright).T.rename_axis("figure").reset_index())
    texts = [_texts_left(table).to_string(index=False, float_format=_figure) for table in tables]
    print(min(texts, key=lambda text: len(text.splitlines()[0])))
    for remark in remarks:
        print(textwrap.fill(remark, 99))


def _remarks(frame):
    """What the rows remark, each sentence once, behind the file that it is about."""
    rows = frame[frame["remarks"] != ""] if "remarks" in frame else frame[:0]
    names = rows["file"] if "file" in rows else [""] * len(rows)
    said = (
        f"{name}: {text}".removeprefix(": ")
        for name, text in zip(names, rows.get("remarks", []), strict=True)
    )
    return list(dict.fromkeys(said))


def write_rows(frame, options):
    """Write a DataFrame where ``--csv`` says."""
    if options.csv is not None:
        from mmqa_lab.io import write_atomically

        write_atomically(options.csv, frame)


def write_figure(file, figure, *, title):
    """Write a figure as all others are finished, with its title and our version as metadata."""
    from mmqa_lab import __version__
    from mmqa_lab._figures import finish_figure
    from mmqa_lab.io import write_atomically

    finish_figure(figure)
    details = {"Title": title, "Creator": f"mmqa_lab {__version__}"}
    write_atomically(file, lambda path: figure.savefig(path, metadata=details))


def print_json(value):
    """Print a value as JSON, null for what is not a finite number."""
    import json

    json.dump(_plain(value), sys.stdout, indent=1, allow_nan=False)
    print()


def _texts_left(frame):
    """The table with texts, and their headings, at the left of their columns."""
    import pandas as pd

    columns = []
    for name, column in frame.items():  # a file given twice has two columns of its name
        if len(column) and all(isinstance(value, str) for value in column):
            width = max(len(name), column.str.len().max())
            column = column.str.ljust(width).rename(name.ljust(width))
        columns.append(column)
    return pd.concat(columns, axis=1)


def _figure(value):
    """A number with four figures, without an exponent where it is large."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _plain(value):
    """Dicts, lists and NumPy values as JSON knows them."""
    import numpy as np

    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
