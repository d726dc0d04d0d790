"""Notebooks for a class: students' copies, checks of answers, and solutions for the teacher.

Cells tagged ``solution`` contain an answer and, below a line ``# check``, the code that tests the
answer. Cells tagged ``lesson`` are for the teacher, and cells tagged ``results`` keep the books of
a run; a student's copy has neither, and no stored outputs. Its tests are compressed, so that
nobody reads them at a glance. A failed check does not stop *Run All*. The cell tagged ``number``
sets the student's number in the class. Exercises take their values from this number, so each
student has another answer. The first exercise stands directly below the cells that it needs. The
teacher gets the solutions and a table of answers by number. Cells tagged ``answers`` have what the
answers need; the table is made without the others, most of which take long.
"""

import ast
import json
import os
import re
import tempfile
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import nbformat
import pandas as pd
from IPython.core.inputtransformer2 import TransformerManager
from nbconvert.preprocessors import ClearOutputPreprocessor

from mmqa_lab._progress import progress
from mmqa_lab.io import write_atomically
from mmqa_lab.run.exercises import NUMBER, NUMBERS, answer_parts, names_in, student_cell
from mmqa_lab.run.notebooks import ANSWER, execute, inject
from mmqa_lab.run.pages import notebook_page

__all__ = ["answer_table", "write_solutions", "write_student_notebooks"]

# The notebook's words on the number, replaced in copies, where the student sets it.
SET_HERE = re.compile(r"the (notebook|next cell) sets it")


def _exercise(source):
    """The student's two cells of an answer, work and check, in nbgrader's form."""
    cells = []
    for part, text in zip(("work", "check"), student_cell(source).split("\n\n", 1), strict=True):
        cell = nbformat.v4.new_code_cell(text)
        checks = part == "check"
        cell.metadata["tags"] = ["check", "raises-exception"] if checks else ["exercise"]
        named = {"grade_id": f"exercise-{answer_parts(source)[0]}-{part}", "schema_version": 3}
        graded = {"grade": checks, "locked": checks} | ({"points": 1} if checks else {})
        cell.id = named["grade_id"]  # equal copies are equal to the byte
        cell.metadata["nbgrader"] = named | graded | {"solution": not checks, "task": False}
        cells.append(cell)
    return cells


def _student_notebook(notebook, checks):
    """A notebook without answers, outputs and the teacher's cells."""
    copy, _ = ClearOutputPreprocessor().preprocess(notebook, {})
    cells, copy.cells = copy.cells, []
    for cell in cells:
        cell.pop("attachments", None)  # the answer's figure
        if NUMBER in _tags(cell):
            cell.source = cell.source.replace(f"{NUMBER} = 1", f"{NUMBER} = ...")
        cell.source = SET_HERE.sub("set it in the next cell", ANSWER.sub("", cell.source))
        if "solution" in _tags(cell):
            copy.cells += _exercise(cell.source)[: 2 if checks else 1]
        elif not {"lesson", "results"} & set(_tags(cell)):
            cell.source = _waiting(cell)
            copy.cells.append(cell)
    return copy


def _waiting(cell):
    """The source of a cell; what it makes of the student's number waits until that is set."""
    if cell.cell_type != "code" or NUMBER in _tags(cell):
        return cell.source
    code = TransformerManager().transform_cell(cell.source)
    if NUMBER not in names_in(code, ast.Load):
        return cell.source
    return f"if {NUMBER} is not ...:\n" + textwrap.indent(cell.source, "    ")


def write_student_notebooks(folder, studies, *, quick=False, checks=True):
    """Write students' copies of studies' notebooks into a folder.

    Parameters
    ----------
    folder : path
        Created if missing.
    studies : list of mmqa_lab.studies.Study
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
    ...     [path.name for path in write_student_notebooks(folder, chosen(["mimic"]))]
    ['05_mimic.ipynb']
    """
    copies = {}
    for study in studies:
        copy = _student_notebook(nbformat.read(study.path, as_version=4), checks)
        if quick:
            inject(copy, study.quick)
        copies[Path(folder) / study.path.name] = nbformat.writes(copy) + "\n"
    for target, text in copies.items():  # an equal copy is of a call that was interrupted
        if target.exists() and target.read_text("utf-8") != text:
            work = f"it contains {target.name}, which may be a student's work"
            raise ValueError(f"Invalid folder {folder}: {work}. Must have no such notebooks.")
    for target, text in copies.items():
        write_atomically(target, text)
    return [*copies]


def write_solutions(folder, studies, *, quick=False):
    """Write a page per study with its solutions, answers by number and lesson plan.

    Parameters
    ----------
    folder : path
        The teacher's folder, created if missing.
    studies : list of mmqa_lab.studies.Study
    quick : bool
        Give the answers for each study's small parameters.

    Returns
    -------
    list of Path
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # each notebook is a process
        found = pool.map(lambda study: answer_table(study, quick=quick), studies)
        tables = list(progress(found, "study", total=len(studies)))
    written = []
    for study, answers in zip(studies, tables, strict=True):
        notebook = nbformat.read(study.path, as_version=4)
        shown, task = [notebook.cells[0]], []
        for cell in notebook.cells:
            if cell.cell_type == "markdown":
                task = [nbformat.v4.new_markdown_cell("## " + cell.source.rpartition("## ")[2])]
            elif "solution" in _tags(cell):
                shown += [*task, nbformat.v4.new_code_cell(answer_parts(cell.source)[1])]
                task = []
        table = answers.to_html(index=False, na_rep="")
        shown.append(nbformat.v4.new_markdown_cell(f"## Answers by number\n\n{table}"))
        shown += [cell for cell in notebook.cells if "lesson" in _tags(cell)]
        notebook.cells = shown
        written.append(Path(folder) / f"{study.notebook}_solutions.html")
        write_atomically(written[-1], notebook_page(notebook, f"{study.title}: solutions"))
    return written


def answer_table(study, *, quick=False):
    """Return the numeric answers for each number of the class.

    The cells tagged ``parameters`` and ``answers`` are run, and each solution at its place with
    each number.

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
    ValueError
        If a cell fails; names the notebook and the cell's error.
    """
    notebook = nbformat.read(study.path, as_version=4)
    cells, notebook.cells, asked = notebook.cells, [], []
    for cell in cells:
        if "solution" in _tags(cell):
            task, work, answers, _ = answer_parts(cell.source)
            if NUMBER not in names_in(work, ast.Load):
                continue
            call = f"print(work_out({ {task: (work, answers)}!r}, globals()))"
            cell.source = f"from mmqa_lab.run.exercises import work_out\n\n{call}"
            asked.append(cell)
        elif not {"parameters", "answers"} & set(_tags(cell)):
            continue
        notebook.cells.append(cell)
    if quick:
        inject(notebook, study.quick)
    with tempfile.TemporaryDirectory() as folder:
        failure = execute(notebook, study.path.parent, results=folder)
    if failure:
        cause = f"{study.notebook}.ipynb: {failure}"
        raise ValueError(f"Invalid notebook {cause}. Must run to its end.")
    texts = [cell.outputs[-1]["text"] for cell in asked]
    found = [pd.DataFrame(json.loads(text)).set_index("n") for text in texts]
    numbers = pd.DataFrame(index=pd.Index(NUMBERS, name="n"))
    return pd.concat([numbers, *found], axis=1).dropna(axis=1, thresh=2).reset_index()


def _tags(cell):
    """The tags of a cell."""
    return cell.metadata.get("tags", [])
