"""The record of a run: how it began, which files it wrote, whether it came to its end."""

from __future__ import annotations

import ast
import itertools
import json
import re
from pathlib import Path

from mmqa_lab.io import write_atomically

__all__ = [
    "RECORD", "new_record", "parameter_names", "read_record", "verdict", "write_record",
]  # fmt: skip

RECORD = "run.json"

UNFINISHED = "stopped before its end"

# A file that :func:`mmqa_lab.io.write_atomically` was writing when it was killed.
LEFT_OVER = re.compile(r"\..{0,40}\.[0-9a-f]{16}\.\w+")


def new_record(folder):
    """Remove the files of an earlier or a killed run; return the record of a run that begins."""
    before = read_record(folder)
    ours = {one for one in map(str, before.get("files", [])) if Path(one).name == one}
    for left in folder.iterdir() if folder.is_dir() else ():
        if (left.name in ours or LEFT_OVER.fullmatch(left.name)) and not left.is_dir():
            left.unlink()
    answer = {"sentence": "", "short": "", "figure": "", "thumbnail": "", "values": []}
    record = {"quick": before.get("quick", False), "failure": UNFINISHED, "seconds": 0.0}
    return record | {"answer": answer, "checks": [], "files": [], "figures": {}}


def read_record(folder):
    """Return the run record in a study's folder; an empty dict without one that can be read."""
    try:
        record = json.loads((Path(folder) / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):  # none yet, or damaged when the machine lost its power
        return {}
    return record if isinstance(record, dict) else {}


def write_record(folder, record):
    """Write the run record into a study's folder."""
    write_atomically(Path(folder) / RECORD, json.dumps(record, indent=1, default=str))


def verdict(record):
    """Return the reason of a failure, or the count of the checks that passed."""
    passed = sum(check["passed"] for check in record["checks"])
    return record["failure"] or f"{passed} of {len(record['checks'])} checks passed"


def parameter_names(notebook):
    """Return the names that a notebook's cell tagged ``parameters`` sets, in the cell's order.

    Parameters
    ----------
    notebook : path

    Returns
    -------
    list of str

    Examples
    --------
    >>> from mmqa_lab.studies import chosen
    >>> parameter_names(chosen(["mimic"])[0].path)[:2]
    ['ranges_m', 'seeds']
    """
    cells = json.loads(Path(notebook).read_text(encoding="utf-8"))["cells"]
    tagged = [cell["source"] for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
    nodes = ast.walk(ast.parse("".join(itertools.chain(*tagged))))
    return [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
