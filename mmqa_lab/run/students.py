"""Notebooks for a class: the same studies without the answers, with the assertions left in.

Cells tagged ``solution`` contain an answer and the assertions that test it; cells tagged ``lesson``
are for the teacher. A student's copy keeps only the assertions: they fail until the names in them
are worked out. It has no stored outputs.
"""

import ast
from pathlib import Path

import nbformat

from mmqa_lab.io import write_atomically


def student_cell(source):
    """Return an answer's cell as a student gets it: the names to work out, and the checks.

    Parameters
    ----------
    source : str
        Code of a cell tagged ``solution``; its first line is a comment that begins with the
        exercise's number.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If nothing in it is checked, or nothing that is checked comes from the answer.

    Examples
    --------
    >>> print(student_cell("# 1: four by symmetry\\narea = 2 * 2\\nassert area == 4"))
    # 1: your work
    area = ...
    <BLANKLINE>
    assert area == 4
    """
    body = ast.parse(source).body
    checks = [node for node in body if isinstance(node, ast.Assert)]
    read = {name for check in checks for name in _names(check, ast.Load)}
    read -= {name for check in checks for name in _names(check, ast.Store)}
    answers = [name for name in _names(ast.Module(body, []), ast.Store) if name in read]
    if not answers:
        raise ValueError(
            f"Invalid answer {source.splitlines()[0]!r}. Must be checked by an assert."
        )
    number = source.split(":")[0]
    lines = [f"{name} = ..." for name in dict.fromkeys(answers)]
    kept = [ast.get_source_segment(source, check) for check in checks]
    return "\n".join([f"{number}: your work", *lines, "", *kept])


def _student_notebook(notebook):
    """Return a copy of a notebook without answers, outputs and the teacher's cells."""
    cells = []
    for cell in notebook.cells:
        tags = cell.metadata.get("tags", [])
        if "lesson" in tags:
            continue
        if "solution" in tags:
            cell = nbformat.from_dict({**cell, "source": student_cell(cell.source)})
            cell.metadata = nbformat.from_dict({"tags": ["exercise"]})
        if cell.cell_type == "code":
            cell = nbformat.from_dict({**cell, "outputs": [], "execution_count": None})
        cells.append(cell)
    return nbformat.from_dict({**notebook, "cells": cells})


def write_student_notebooks(studies, folder):
    """Write students' copies of studies' notebooks into a folder.

    Parameters
    ----------
    studies : list of mmqa_lab.studies.catalogue.Study
    folder : path
        Made where missing.

    Returns
    -------
    list of Path

    Raises
    ------
    ValueError
        If a notebook of that name is there already: it may be a student's work.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab.studies.catalogue import chosen
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.name for path in write_student_notebooks(chosen(["mimic"]), folder)]
    ['05_mimic.ipynb']
    """
    targets = [Path(folder) / study.path.name for study in studies]
    there = [path for path in targets if path.exists()]
    if there:
        raise ValueError(
            f"Invalid folder {folder}: it contains {there[0].name}, which may be a student's work. "
            "Must be a folder without notebooks of these names."
        )
    for study, target in zip(studies, targets, strict=True):
        copy = _student_notebook(nbformat.read(study.path, as_version=4))
        write_atomically(target, lambda path, copy=copy: nbformat.write(copy, path))
    return targets


def _names(node, context):
    """Names that a piece of code reads or sets, in the order of their places."""
    found = [n for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, context)]
    return [n.id for n in sorted(found, key=lambda n: (n.lineno, n.col_offset))]
