"""Notebooks for a class: students' copies, checks of answers, and solutions for the teacher.

Cells tagged ``solution`` contain an answer and, below a line ``# check``, the code that tests the
answer. Cells tagged ``lesson`` are for the teacher. A student's copy has no stored outputs. Its
tests are compressed, so that nobody reads them at a glance. A failed check does not stop
*Run All*. The cell tagged ``number`` sets the student's number in the class. Exercises take their
values from this number, so each student has another answer. The first exercise stands directly
below the cells that it needs. The teacher gets the solutions and a table of answers by number.
"""

import ast
import base64
import contextlib
import io
import json
import re
import tempfile
import textwrap
import zlib
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd

from mmqa_lab.bench import split_unit
from mmqa_lab.io import write_atomically
from mmqa_lab.run.notebooks import execute, inject
from mmqa_lab.run.pages import notebook_page

ASKED = "# asked for: "
"""Begins the line of an answer that states names, types and units. Students see this line."""

CHECK = "# check"
"""The line of an answer that separates the work from its test."""

NUMBER = "number"
"""Tag of the cell for the student's number in the class, and name of the number."""

SET_HERE = re.compile(r"the (notebook|next cell) sets it")
"""The notebook's words on the number, replaced in copies, where the student sets it."""

NUMBERS = range(1, 31)
"""The numbers of a class in the table of answers."""

FEW = 6
"""Most numbers of an answer in the table of answers."""

PYTHON = {"name": "python", "pygments_lexer": "ipython3"}


def student_cell(source):
    """Return the student's version of an answer's cell: names without values, and the check.

    Parameters
    ----------
    source : str
        Code of a cell tagged ``solution``; its first line is a comment that begins with the
        exercise's number. The code below a line ``# check`` is compressed.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the check reads none of the names that the answer sets.

    Examples
    --------
    >>> print(student_cell("# 1: by symmetry\\narea_m2 = 4\\n# check\\nassert area_m2 == 4")[:70])
    # 1: your work
    area_m2 = ...  # m2
    <BLANKLINE>
    from mmqa_lab.run.students import
    """
    work, _, check = source.partition(f"\n{CHECK}\n")
    read = set(_names(ast.parse(check), ast.Load)) - set(_names(ast.parse(check), ast.Store))
    answers = [name for name in dict.fromkeys(_names(ast.parse(work), ast.Store)) if name in read]
    if not answers:
        raise ValueError(f"Invalid answer {source.splitlines()[0]!r}. Must be checked.")
    kept = [line for line in work.splitlines() if line.startswith((ASKED, "import ", "from "))]
    given = [f"# {_number(source)}: your work", *kept, *map(_blank, answers)]
    needed = [NUMBER, *answers] if NUMBER in read else answers
    sealed = _sealed([_number(source), needed, "\n".join([*kept, check])])
    check = ["from mmqa_lab.run.students import check_answer", "", f"check_answer({sealed})"]
    return "\n".join([*given, "", *check])


def _number(source):
    """The exercise's number, from the first line of its answer."""
    return source.split(":")[0].lstrip("# ")


class NotRight(AssertionError):
    """The error of an answer; a notebook shows only its sentence."""

    def _render_traceback_(self):
        return [f"Exercise {self}"]


def check_answer(sealed, scope):
    """Check a student's work, and state in a sentence what is wrong.

    Parameters
    ----------
    sealed : str
        The check, compressed by :func:`student_cell`.
    scope : dict
        The notebook's ``globals()``.

    Raises
    ------
    NotRight
        If a name has no value yet, or a check does not hold.
    """
    number, answers, check = json.loads(zlib.decompress(base64.b64decode(sealed)))
    missing = [name for name in answers if scope.get(name, ...) is ...]
    if missing:
        raise NotRight(f"{number}: give {missing[0]} a value.")
    try:
        exec(check, dict(scope))
    except AssertionError as error:
        listed = ", ".join(name for name in answers if name != NUMBER)
        usual = f"not right yet. Check the formula, and the unit of {listed}."
        raise NotRight(f"{number}: {str(error) or usual}") from None
    except Exception as error:  # the work may have any type
        what = f"{type(error).__name__}: {error}"
        raise NotRight(f"{number}: the check cannot be worked out with this: {what}.") from None
    print(f"{number}: right.")


def _sealed(task):
    """The arguments of ``check_answer``: the compressed check and the scope."""
    text = base64.b64encode(zlib.compress(json.dumps(task).encode(), 9)).decode()
    lines = "\n".join(f'    "{part}"' for part in textwrap.wrap(text, 80))
    return f"\n{lines},\n    globals(),\n"


def _blank(name):
    """The line in which a student sets a name, with the unit from the end of the name."""
    unit = split_unit(name)[1]
    return f"{name} = ...  # {unit}" if unit else f"{name} = ..."


def _exercise(source):
    """Yield the student's two cells of an answer, work and check, in nbgrader's form."""
    for part, text in zip(("work", "check"), student_cell(source).split("\n\n", 1), strict=True):
        grading = {
            "grade_id": f"exercise-{_number(source)}-{part}",
            "schema_version": 3,
            "task": False,
        }
        grading |= {"solution": part == "work", "grade": part == "check"}
        grading |= {"locked": part == "check"} | ({"points": 1} if part == "check" else {})
        cell = nbformat.v4.new_code_cell(text, metadata={"nbgrader": grading})
        cell.metadata["tags"] = ["exercise"] if part == "work" else ["check", "raises-exception"]
        yield cell


def _student_notebook(notebook, checks):
    """A copy of a notebook without answers, outputs and the teacher's cells."""
    cells = []
    for cell in notebook.cells:
        tags = _tags(cell)
        if "solution" in tags:
            cells += list(_exercise(cell.source))[: 2 if checks else 1]
        elif NUMBER in tags:
            blank = cell.source.replace(f"{NUMBER} = 1", f"{NUMBER} = ...")
            cells.append(nbformat.v4.new_code_cell(blank, metadata=cell.metadata))
        elif cell.cell_type == "code":
            cells.append(nbformat.from_dict({**cell, "outputs": [], "execution_count": None}))
        elif "lesson" not in tags:
            text = SET_HERE.sub("set it in the next cell", cell.source)
            cells.append(nbformat.from_dict({**cell, "source": text}))
    return nbformat.from_dict({**notebook, "cells": cells})


def write_student_notebooks(studies, folder, *, quick=False, checks=True):
    """Write students' copies of studies' notebooks into a folder.

    Parameters
    ----------
    studies : list of mmqa_lab.studies.Study
    folder : path
        Created if missing.
    quick : bool
        Use each study's small parameters.
    checks : bool
        Include the compressed checks.

    Returns
    -------
    list of Path

    Raises
    ------
    ValueError
        If the folder already contains a notebook of that name: it may be a student's work.

    Examples
    --------
    >>> import tempfile
    >>> from mmqa_lab.studies import chosen
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
        copy = _student_notebook(nbformat.read(study.path, as_version=4), checks)
        if quick:
            inject(copy, study.quick)
        write_atomically(target, lambda path, copy=copy: nbformat.write(copy, path))
    return targets


def write_solutions(studies, folder, *, quick=False):
    """Write a page per study with its solutions, answers by number and lesson plan.

    Parameters
    ----------
    studies : list of mmqa_lab.studies.Study
    folder : path
        The teacher's folder, created if missing.
    quick : bool
        Give the answers for each study's small parameters.

    Returns
    -------
    list of Path
    """
    written = []
    for study in studies:
        cells = nbformat.read(study.path, as_version=4).cells
        texts = [k for k, cell in enumerate(cells) if cell.cell_type == "markdown"]
        tagged = [k for k, cell in enumerate(cells) if "solution" in _tags(cell)]
        above = dict.fromkeys(max(place for place in texts if place < k) for k in tagged)
        tasks = ["## " + cells[k].source.rpartition("## ")[2] for k in above]
        exercises = [nbformat.v4.new_markdown_cell(task) for task in tasks]
        answers = [
            nbformat.v4.new_code_cell(cells[k].source.split(f"\n{CHECK}")[0]) for k in tagged
        ]
        answers.append(nbformat.v4.new_markdown_cell("## Answers by number"))
        shown = {"text/html": answer_table(study, quick=quick).to_html(index=False, na_rep="")}
        output = nbformat.v4.new_output("display_data", data=shown)
        answers.append(nbformat.v4.new_code_cell("", outputs=[output]))
        lesson = [cell for cell in cells if "lesson" in _tags(cell)]
        chosen = [cells[0], *exercises, *answers, *lesson]
        book = nbformat.v4.new_notebook(cells=chosen, metadata={"language_info": PYTHON})
        page = notebook_page(book, f"{study.title}: solutions", figures={}, alone=True)
        written.append(Path(folder) / f"{study.notebook}_solutions.html")
        write_atomically(written[-1], page)
    return written


def answer_table(study, *, quick=False):
    """Return the numeric answers for each number of the class.

    The notebook is run without the solutions, then each solution is run with each number.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    quick : bool
        Use the study's small parameters.

    Returns
    -------
    DataFrame
        ``n``, the number in the class, and a column for each answer that depends on it.

    Raises
    ------
    RuntimeError
        If a cell fails.
    """
    notebook = nbformat.read(study.path, as_version=4)
    if quick:
        inject(notebook, study.quick)
    tasks = {}
    for source in [cell.source for cell in notebook.cells if "solution" in _tags(cell)]:
        work = ast.parse(source.split(f"\n{CHECK}")[0])
        if NUMBER in _names(work, ast.Load):
            blanks = re.findall(r"^(\w+) = \.\.\.", student_cell(source), re.MULTILINE)
            tasks[_number(source)] = ast.unparse(work), blanks
    call = f"from mmqa_lab.run.students import work_out\nprint(work_out({tasks!r}, globals()))"
    tail = nbformat.v4.new_code_cell(call)
    notebook.cells = [cell for cell in notebook.cells if "solution" not in _tags(cell)] + [tail]
    with tempfile.TemporaryDirectory() as folder:
        failure = execute(notebook, study.path.parent, results=folder)
    if failure:
        raise RuntimeError(f"{study.notebook}: {failure}")
    table = pd.DataFrame(json.loads(tail.outputs[-1]["text"]))
    return table.dropna(axis=1, thresh=2)


def work_out(tasks, scope):
    """Return the numeric answers for each number of the class, as JSON.

    Parameters
    ----------
    tasks : dict
        Code and names of the answers by the exercise's number.
    scope : dict
        A notebook's ``globals()``.

    Examples
    --------
    >>> work_out({"1": ("side = number / 2", ["side"])}, {})[:56]
    '[{"n": 1, "1: side": "0.5"}, {"n": 2, "1: side": "1"}, {'
    """
    rows = {number: {"n": number} for number in NUMBERS}
    for task, (code, names) in tasks.items():
        for number, row in rows.items():
            scope[NUMBER] = number
            with contextlib.redirect_stdout(io.StringIO()):
                exec(code, scope)
            row |= {f"{task}: {name}": _short(scope[name]) for name in names}
            if not any(row[f"{task}: {name}"] for name in names):
                break  # the answer is a table or a curve
    return json.dumps(list(rows.values()))


def _short(answer):
    """A number or a few numbers as text; None for other answers."""
    try:
        values = np.atleast_1d(np.asarray(answer))
    except ValueError:  # a list of unlike items
        return None
    if values.ndim > 1 or len(values) > FEW or values.dtype.kind not in "fiub":
        return None
    return ", ".join(f"{value:.4g}" for value in values.astype(float))


def _tags(cell):
    """The tags of a cell."""
    return cell.metadata.get("tags", [])


def _names(node, context):
    """Names that code reads or sets, in the order of the code."""
    found = [n for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, context)]
    return [n.id for n in sorted(found, key=lambda n: (n.lineno, n.col_offset))]
