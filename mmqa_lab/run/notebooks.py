"""Run notebooks without a screen, each in its own kernel."""

import json
import os
import time
from dataclasses import asdict, replace
from pathlib import Path

import nbformat

from mmqa_lab.io import write_atomically
from mmqa_lab.run import read_record
from mmqa_lab.run.pages import OUTCOME, Outcome, notebook_page

ENVIRONMENT = {
    "MMQA_HEADLESS": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small, so threads would only wait
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    "PYTHONDONTWRITEBYTECODE": "",  # otherwise each kernel compiles its libraries, in 6 s
    "TQDM_DISABLE": "1",
}


def run_study(study, folder, *, quick=False):
    """Run the notebook of a study.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    folder : path
        Results go to ``<folder>/<stem>/``; the page is ``<stem>.html``.
    quick : bool
        Use the study's small parameters.

    Returns
    -------
    Outcome
        Also written to ``outcome.json`` in the folder of the results.
    """
    target = Path(folder).resolve() / study.stem
    outcome = Outcome(study.stem, quick)
    for summary in ("checks.csv", "ledger.csv", f"{study.stem}.html"):  # of an earlier run
        (target / summary).unlink(missing_ok=True)
    write_outcome(outcome, target)
    notebook = nbformat.read(study.path, as_version=4)
    if quick:
        inject(notebook, study.quick)
    began = time.monotonic()
    failure = execute(notebook, study.path.parent, results=target.parent)
    seconds, record = round(time.monotonic() - began, 1), read_record(target)
    write_atomically(target / f"{study.stem}.ipynb", nbformat.writes(notebook))
    seen = record.get("figures", {})
    page = notebook_page(notebook, study.title, figures=seen, failure=failure, quick=quick)
    write_atomically(target / f"{study.stem}.html", page)
    counts = {"checks": record.get("checks", 0), "passed": record.get("checks_passed", 0)}
    outcome = replace(outcome, seconds=seconds, failure=failure, **counts)
    write_outcome(outcome, target)
    return outcome


def write_outcome(outcome, folder):
    """Write the outcome of a run to the folder of its results."""
    write_atomically(folder / OUTCOME, json.dumps(asdict(outcome), indent=1))


def inject(notebook, parameters):
    """Put a cell with other parameters behind the notebook's cell tagged ``parameters``."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells]
    place = next(number for number, found in enumerate(tags) if "parameters" in found)
    lines = [f"{name} = {value!r}" for name, value in parameters.items()]
    cell = nbformat.v4.new_code_cell("\n".join(["# small parameters, for a first look", *lines]))
    notebook.cells.insert(place + 1, cell)


def execute(notebook, folder, *, results):
    """Execute a notebook in place; return its failure in one line, or an empty text."""
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, DeadKernelError

    client = NotebookClient(
        notebook,
        kernel_name="python3",
        extra_arguments=["--log-level=ERROR"],
        resources={"metadata": {"path": str(folder)}},
        timeout=None,
    )
    try:
        client.execute(env={**os.environ, **ENVIRONMENT, "MMQA_RESULTS": str(results)})
    except CellExecutionError as error:
        return f"{error.ename}: {error.evalue}".splitlines()[0]
    except DeadKernelError:  # also if the run is interrupted
        return "the kernel died"
    return ""
