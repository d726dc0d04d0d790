"""Run notebooks without a screen, each in its own kernel."""

import os
import subprocess
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, DeadKernelError

from mmqa_lab.io import write_atomically
from mmqa_lab.run import new_record, read_record, write_record
from mmqa_lab.run.pages import notebook_page

__all__ = ["ENVIRONMENT", "execute", "inject", "run_study"]

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
    dict
        The run record: ``quick``, ``seconds``, ``failure`` (in one line, empty if every cell ran),
        ``answer``, ``checks``, ``files`` and more, also in ``run.json``.
    """
    target = Path(folder).resolve() / study.stem
    write_record(target, new_record(target) | {"quick": quick})
    notebook = nbformat.read(study.path, as_version=4)
    if quick:
        inject(notebook, study.quick)
    began = time.monotonic()
    failure = execute(notebook, study.path.parent, results=target.parent)
    seconds = round(time.monotonic() - began, 1)
    above = ["[All studies](../index.html)"]
    above += ["**Quick run: small parameters, for a first look.**"] if quick else []
    above += [f"**Stopped: `{failure}`. The cells below it were not run.**"] if failure else []
    record = read_record(target) | {"seconds": seconds, "failure": failure}
    write_atomically(target / f"{study.stem}.ipynb", nbformat.writes(notebook))
    page = notebook_page(notebook, study.title, above=above)
    write_atomically(target / f"{study.stem}.html", page)
    record["files"] += [f"{study.stem}.ipynb", f"{study.stem}.html"]
    write_record(target, record)
    return record


def inject(notebook, parameters):
    """Put a cell with other parameters behind the notebook's cell tagged ``parameters``."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells]
    place = next(number for number, found in enumerate(tags) if "parameters" in found)
    lines = [f"{name} = {value!r}" for name, value in parameters.items()]
    cell = nbformat.v4.new_code_cell("\n".join(["# small parameters, for a first look", *lines]))
    notebook.cells.insert(place + 1, cell)


def execute(notebook, folder, *, results):
    """Execute a notebook in place; return its failure in one line, or an empty text."""
    client = NotebookClient(
        notebook,
        kernel_name="python3",
        extra_arguments=["--log-level=ERROR"],
        resources={"metadata": {"path": str(folder)}},
    )
    try:
        env = {**os.environ, **ENVIRONMENT, "MMQA_RESULTS": str(results)}
        client.execute(env=env, stderr=subprocess.DEVNULL)  # a kernel that is ended complains
    except CellExecutionError as error:
        return f"{error.ename}: {error.evalue}".splitlines()[0]
    except DeadKernelError as error:  # also if the run is interrupted
        return str(error)
    return ""
