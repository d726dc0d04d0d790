"""Clouds in PTX files: grids of scans with their poses, as text."""

from __future__ import annotations

import re
from io import BytesIO
from itertools import islice

import numpy as np
import pandas as pd

from mmqa_lab._checks import refuse
from mmqa_lab.io.files import plain_text, reading
from mmqa_lab.io.marks import Piece

__all__ = ["PTX_HEAD", "ptx_pieces"]

PTX = "a complete PTX file"

# Columns and rows of a scan, the scanner's place and axes, and the matrix to the common system.
PTX_HEAD = re.compile(
    rb"\s*(\d+)[ \t]*\n[ \t]*(\d+)[ \t]*\n((?:[^\s]+[ \t]+){2}[^\s]+[ \t]*\n){4}"
    rb"(((?:[^\s]+[ \t]+){3}[^\s]+[ \t]*\n){4})"
)
ROW = re.compile(rb"[^\n]*\S[^\n]*(?:\n|$)")


def ptx_pieces(path, scan=None):
    """The scans of a PTX file, or the one of this number; numbers in a column ``scan``."""
    text, at, number = plain_text(path), 0, 0
    while text[at:].strip():
        head = PTX_HEAD.match(text, at)
        refuse(head is None, f"cloud {path}", f"no header of scan {number}", PTX)
        wide, high, at = int(head[1]), int(head[2]), head.end()
        ends = [found.end() for found in islice(ROW.finditer(text, at), wide * high)]
        found = f"{len(ends)} rows where the header of scan {number} says {wide * high}"
        refuse(len(ends) < wide * high, f"cloud {path}", found, "as many")
        end = ends[-1] if ends else at
        with reading(path, "cloud", PTX):
            matrix = np.array(head[4].split(), dtype=float).reshape(4, 4)
            rows = pd.read_csv(BytesIO(text[at:end]), sep=r"\s+", header=None, dtype=float)
            names = ["x", "y", "z", "intensity", "red", "green", "blue"][: rows.shape[1]]
            rows = rows.set_axis(names, axis=1)
            own = rows[["x", "y", "z"]].to_numpy()
        columns = {name: rows[name].to_numpy() for name in names[3:]}
        columns["scan"] = np.full(len(rows), number)
        columns["column"], columns["row"] = np.divmod(np.arange(len(rows)), high)
        none = {"have no return": (own == 0).all(axis=1)}
        if scan in (None, number, str(number)):
            yield Piece(own @ matrix[:3, :3] + matrix[3, :3], columns, left=none)
        at, number = end, number + 1
