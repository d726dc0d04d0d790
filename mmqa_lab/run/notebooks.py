"""Notebooks run without a screen, in a kernel of their own."""

import asyncio
import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import nbformat

from mmqa_lab.run import read_record, write_text
from mmqa_lab.run.pages import OUTCOME, UNFINISHED, Outcome, notebook_page

ENVIRONMENT = {
    "MMQA_HEADLESS": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small: threads would wait for each other
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    "PYTHONDONTWRITEBYTECODE": "",  # or every kernel compiles its libraries anew, some 6 s
    "TQDM_DISABLE": "1",
}


def run_study(study, folder, *, quick=False, timeout=None):
    """Run one study.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    folder : path
        Results go to ``<folder>/<stem>/``, the page among them as ``<stem>.html``.
    quick : bool
        Run with its small parameters.
    timeout : float, optional
        Seconds after which the study is stopped; without it, never.

    Returns
    -------
    Outcome
        Also written as ``outcome.json`` beside the results.
    """
    target = Path(folder).resolve() / study.stem
    outcome = Outcome(study.stem, quick)
    for summary in ("checks.csv", "ledger.csv", f"{study.stem}.html"):  # of an earlier run
        (target / summary).unlink(missing_ok=True)
    _write(outcome, target)
    notebook = nbformat.read(study.path, as_version=4)
    if quick:
        inject(notebook, study.quick)
    began = time.monotonic()
    environment = {**os.environ, **ENVIRONMENT, "MMQA_RESULTS": str(target.parent)}
    failure = UNFINISHED
    try:
        failure = execute(notebook, study.path.parent, environment=environment, timeout=timeout)
    finally:  # where it is interrupted, too
        seconds = round(time.monotonic() - began, 1)
        record = read_record(target)
        seen = record.get("figures", {})
        write_text(target / f"{study.stem}.ipynb", nbformat.writes(notebook))
        page = notebook_page(notebook, study.title, figures=seen, failure=failure, quick=quick)
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
    """Ctrl-C and ``kill`` stop all studies; the client alone would stop this kernel and go on."""
    task = asyncio.current_task()

    def stop():
        interrupted.set()
        task.cancel()

    # Windows has no such handlers, and no thread but the first has them
    with suppress(NotImplementedError, RuntimeError, ValueError):
        for one in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(one, stop)


def _write(outcome, folder):
    """Write the outcome beside the results."""
    write_text(folder / OUTCOME, json.dumps(asdict(outcome), indent=1))
