"""Notebooks run without a screen, in a kernel of their own, and copied for a class.

Cells tagged ``solution`` contain an answer and the assertions that test it; cells tagged ``lesson``
are for the teacher. A student's copy keeps only the assertions: they fail until the names in them
are worked out. It has no stored outputs.
"""

import ast
import asyncio
import hashlib
import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import nbformat

from mmqa_lab.bench._tables import split_unit
from mmqa_lab.io import write_atomically
from mmqa_lab.run import read_record, write_text
from mmqa_lab.run.pages import OUTCOME, Outcome, notebook_page, read_outcome

ENVIRONMENT = {
    "MMQA_HEADLESS": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small: threads would wait for each other
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    "TQDM_DISABLE": "1",
}


def run_study(study, folder, *, quick=False, timeout=None, resume=False):
    """Run one study.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    folder : path
        Results go to ``<folder>/<stem>/``, the page among them as ``<stem>.html``.
    quick : bool
        Run with the small parameters that the study's module calls QUICK.
    timeout : float, optional
        Seconds after which the study is stopped; without it, never.
    resume : bool
        Do nothing where the study ended with today's code and parameters.

    Returns
    -------
    Outcome
        Also written as ``outcome.json`` beside the results.
    """
    target = Path(folder).resolve() / study.stem
    outcome = Outcome(study.stem, quick, _code(study, quick))
    done = read_outcome(target)
    if resume and done is not None and done.ok and done.code == outcome.code:
        return done
    _write(outcome, target)
    notebook = nbformat.read(study.path, as_version=4)
    if quick:
        inject(notebook, study.module.QUICK)
    began = time.monotonic()
    environment = {**os.environ, **ENVIRONMENT, "MMQA_RESULTS": str(target.parent)}
    failure = execute(notebook, study.path.parent, environment=environment, timeout=timeout)
    seconds = round(time.monotonic() - began, 1)
    record = read_record(target)
    page = notebook_page(notebook, study.title, figures=record.get("figures", {}))
    write_text(target / f"{study.stem}.html", page)
    counts = {"checks": record.get("checks", 0), "passed": record.get("checks_passed", 0)}
    outcome = replace(outcome, seconds=seconds, failure=failure, **counts)
    _write(outcome, target)
    return outcome


def inject(notebook, parameters):
    """Put a cell with other parameters behind the notebook's cell tagged ``parameters``."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells]
    place = next(number for number, found in enumerate(tags) if "parameters" in found)
    lines = [f"{name} = {value!r}" for name, value in parameters.items()]
    cell = nbformat.v4.new_code_cell("\n".join(["# small parameters, for a first look", *lines]))
    notebook.cells.insert(place + 1, cell)


def execute(notebook, folder, *, environment, timeout=None):
    """Execute a notebook in place; return what stopped it in one line, or nothing."""
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    ends = time.monotonic() + (timeout or 0.0)
    interrupted = asyncio.Event()
    client = NotebookClient(
        notebook,
        timeout_func=lambda cell: None if timeout is None else max(0.1, ends - time.monotonic()),
        kernel_name="python3",
        extra_arguments=["--log-level=ERROR"],
        resources={"metadata": {"path": str(folder)}},
        on_notebook_start=lambda notebook: _let_interrupt(interrupted),
    )
    try:
        _run(client.async_execute(env=environment))
    except CellExecutionError as error:
        return f"{error.ename}: {error.evalue}".splitlines()[0]
    except CellTimeoutError:
        return f"not finished after {timeout:g} s"
    except (DeadKernelError, asyncio.CancelledError):
        if interrupted.is_set():
            raise KeyboardInterrupt from None
        return "the kernel died"
    return ""


def _run(coroutine):
    """Run a coroutine to its end, in a thread of its own where a loop runs already (JupyterLab)."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(coroutine)
    with ThreadPoolExecutor(max_workers=1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


def _let_interrupt(interrupted):
    """Ctrl-C stops all studies; the client alone would stop this kernel and go on."""
    task = asyncio.current_task()

    def stop():
        interrupted.set()
        task.cancel()

    # Windows has no such handlers, and no thread but the first has them
    with suppress(NotImplementedError, RuntimeError, ValueError):
        asyncio.get_running_loop().add_signal_handler(signal.SIGINT, stop)


def _code(study, quick):
    """A hash of what determines a study's results: package, notebook, mode and real data."""
    package = Path(__file__).parents[1]
    files = [path for path in package.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    digest = hashlib.sha256(f"{quick} {os.environ.get('MMQA_DATA')}".encode())
    for path in [study.path, *sorted(files)]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _write(outcome, folder):
    """Write the outcome beside the results."""
    write_text(folder / OUTCOME, json.dumps(asdict(outcome), indent=1))


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
    >>> print(student_cell("# 1: by symmetry\\narea_m2 = 2 * 2\\nassert area_m2 == 4"))
    # 1: your work
    area_m2 = ...  # m2
    <BLANKLINE>
    assert area_m2 is not ..., "1: give area_m2 a value."
    assert area_m2 == 4, "1: not right yet. Check the formula, and the unit of area_m2."
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
    number = source.split(":")[0].lstrip("# ")
    answers = list(dict.fromkeys(answers))
    listed = ", ".join(answers)
    said = f'"{number}: not right yet. Check the formula, and the unit of {listed}."'
    work = [f"# {number}: your work", *map(_blank, answers)]
    asked = [f'assert {name} is not ..., "{number}: give {name} a value."' for name in answers]
    kept = [ast.get_source_segment(source, check) for check in checks]
    told = [
        text if check.msg else f"{text}, {said}" for text, check in zip(kept, checks, strict=True)
    ]
    return "\n".join([*work, "", *asked, *told])


def _blank(name):
    """The line in which a student gives a name its value, with the unit that the name ends with."""
    unit = split_unit(name)[1]
    return f"{name} = ...  # {unit}" if unit else f"{name} = ..."


def _exercise(number, source):
    """An answer as a student's two cells, work and checks, as nbgrader knows them."""
    for part, text in zip(("work", "check"), student_cell(source).split("\n\n", 1), strict=True):
        grading = {"grade_id": f"exercise-{number}-{part}", "schema_version": 3, "task": False}
        grading |= {"solution": part == "work", "grade": part == "check"}
        grading |= {"locked": part == "check"} | ({"points": 1} if part == "check" else {})
        cell = nbformat.v4.new_code_cell(text, metadata={"nbgrader": grading})
        cell.metadata["tags"] = ["exercise"] if part == "work" else ["check"]
        yield cell


def _student_notebook(notebook):
    """Return a copy of a notebook without answers, outputs and the teacher's cells."""
    cells = []
    for number, cell in enumerate(notebook.cells):
        tags = cell.metadata.get("tags", [])
        if "solution" in tags:
            cells += _exercise(number, cell.source)
        elif cell.cell_type == "code":
            cells.append(nbformat.from_dict({**cell, "outputs": [], "execution_count": None}))
        elif "lesson" not in tags:
            cells.append(cell)
    return nbformat.from_dict({**notebook, "cells": cells})


def write_student_notebooks(studies, folder, *, quick=False):
    """Write students' copies of studies' notebooks into a folder.

    Parameters
    ----------
    studies : list of mmqa_lab.studies.Study
    folder : path
        Made where missing.
    quick : bool
        With the small parameters that each study's module calls QUICK.

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
        copy = _student_notebook(nbformat.read(study.path, as_version=4))
        if quick:
            inject(copy, study.module.QUICK)
        write_atomically(target, lambda path, copy=copy: nbformat.write(copy, path))
    return targets


def _names(node, context):
    """Names that a piece of code reads or sets, in the order of their places."""
    found = [n for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, context)]
    return [n.id for n in sorted(found, key=lambda n: (n.lineno, n.col_offset))]
