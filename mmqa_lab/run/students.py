"""Notebooks for a class: copies without answers, checks that answer in sentences, sheets to print.

Cells tagged ``solution`` contain an answer and, below a line ``# check``, the code that tests it;
cells tagged ``lesson`` are for the teacher. A student's copy has the test compressed, so that it
cannot be read at a glance, and no stored outputs; a check that fails does not stop *Run All*. The
cell tagged ``number`` sets the student's number in the class, from which exercises take their
numbers: everyone has another answer. The first exercise stands behind what it needs, so that a
class reaches it at once. A teacher gets the solutions with a table of answers by number.
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
"""Begins the line of an answer that says names, types and units; students get it too."""

CHECK = "# check"
"""The line of an answer below which everything is the test of it."""

NUMBER = "number"
"""Tag of the cell for the student's number in the class, and the number's name."""

SET_HERE = re.compile(r"the (notebook|next cell) sets it")
"""What the notebook says of n; in a copy it is the student who sets it."""

NUMBERS = range(1, 31)
"""The numbers of a class, in the table of answers."""

FEW = 6
"""Numbers of an answer that a table of answers has room for."""

PYTHON = {"name": "python", "pygments_lexer": "ipython3"}


def student_cell(source):
    """Return an answer's cell as a student gets it: the names to work out, and the check.

    Parameters
    ----------
    source : str
        Code of a cell tagged ``solution``; its first line is a comment that begins with the
        exercise's number. All that stands below a line ``# check`` is sealed.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If nothing that the answer sets is checked.

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
    """The exercise's number, which its answer begins with."""
    return source.split(":")[0].lstrip("# ")


class NotRight(AssertionError):
    """What is wrong with an answer; a notebook shows the sentence alone."""

    def _render_traceback_(self):
        return [f"Exercise {self}"]


def check_answer(sealed, scope):
    """Check a student's work, and say in a sentence what is wrong with it.

    Parameters
    ----------
    sealed : str
        The checks as :func:`student_cell` compresses them.
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
    except Exception as error:  # of any kind: the work may be of any type
        what = f"{type(error).__name__}: {error}"
        raise NotRight(f"{number}: the check cannot be worked out with this: {what}.") from None
    print(f"{number}: right.")


def _sealed(task):
    """What is checked, as arguments of a call: text not read at a glance, and the scope."""
    text = base64.b64encode(zlib.compress(json.dumps(task).encode(), 9)).decode()
    lines = "\n".join(f'    "{part}"' for part in textwrap.wrap(text, 80))
    return f"\n{lines},\n    globals(),\n"


def _blank(name):
    """The line in which a student gives a name its value, with the unit that the name ends with."""
    unit = split_unit(name)[1]
    return f"{name} = ...  # {unit}" if unit else f"{name} = ..."


def _exercise(source):
    """An answer as a student's two cells, work and checks, as nbgrader knows them."""
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
    """Return a copy of a notebook without answers, outputs and the teacher's cells."""
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
        Made where missing.
    quick : bool
        With each study's small parameters.
    checks : bool
        With the sealed checks; without them the copies only ask.

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
    """Write each study's solutions with answers by number and lesson plan: a page to print.

    Parameters
    ----------
    studies : list of mmqa_lab.studies.Study
    folder : path
        The teacher's; made where missing.
    quick : bool
        Answers for each study's small parameters.

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
    """Return the answers that are numbers, for each number of the class.

    The notebook is run without the solutions, then each solution with each number.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    quick : bool
        With its small parameters.

    Returns
    -------
    DataFrame
        ``n``, and a column for each answer that depends on it.

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
    """Return the answers that are numbers for each number of the class, as JSON.

    Parameters
    ----------
    tasks : dict
        Code and names of answers by the exercise's number.
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
                break  # a table or a curve
    return json.dumps(list(rows.values()))


def _short(answer):
    """A number, or a few, as text; None for what is more than that."""
    try:
        values = np.atleast_1d(np.asarray(answer))
    except ValueError:  # a list of unlike things
        return None
    if values.ndim > 1 or len(values) > FEW or values.dtype.kind not in "fiub":
        return None
    return ", ".join(f"{value:.4g}" for value in values.astype(float))


def _tags(cell):
    """The tags of a cell."""
    return cell.metadata.get("tags", [])


def _names(node, context):
    """Names that a piece of code reads or sets, in the order of their places."""
    found = [n for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, context)]
    return [n.id for n in sorted(found, key=lambda n: (n.lineno, n.col_offset))]
