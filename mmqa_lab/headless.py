"""Running a study's notebook without a screen, in a child process that may fail alone.

``python -m mmqa_lab.headless`` is that child. It executes the notebook with a time limit for each
cell, writes the page with what the cells showed, and prints how it went as one line of JSON.
"""

import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from mmqa_lab.io import write_atomically

CELL_SECONDS = 1200
STUDY_SECONDS = 3600
OUTCOME = "outcome.json"

ENVIRONMENT = {
    "MMQA_HEADLESS": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small: threads would wait for each other
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    "TQDM_DISABLE": "1",
}


@dataclass(frozen=True)
class Outcome:
    """How one run of a study ended."""

    study: str
    seconds: float
    quick: bool
    failure: str

    @property
    def ok(self):
        """Whether every cell ran and every claim held."""
        return not self.failure

    @property
    def verdict(self):
        """``ok``, or what failed."""
        return self.failure or "ok"


def run_study(study, folder, *, quick=False):
    """Run one study in a child process.

    Parameters
    ----------
    study : mmqa_lab.studies.catalogue.Study
    folder : path
        Results go to ``<folder>/<stem>/``, the page among them as ``<stem>.html``.
    quick : bool
        Run with the small parameters that the study's module calls QUICK.

    Returns
    -------
    Outcome
        Also written as ``outcome.json`` beside the results.
    """
    target = Path(folder) / study.stem
    command = [sys.executable, "-m", "mmqa_lab.headless", str(study.path), str(target)]
    environment = {**os.environ, **ENVIRONMENT, "MMQA_RESULTS": str(folder)}
    began = time.monotonic()
    failure = _failure(command + ["quick"] * quick, environment)
    outcome = Outcome(study.stem, round(time.monotonic() - began, 1), quick, failure)
    text = json.dumps(asdict(outcome), indent=1)
    write_atomically(target / OUTCOME, lambda path: path.write_text(text, encoding="utf-8"))
    return outcome


def read_outcome(folder):
    """Return the outcome that a run left in a study's folder, or None."""
    file = Path(folder) / OUTCOME
    return Outcome(**json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else None


def _failure(command, environment):
    """Run the child; return what failed in one sentence, empty for nothing."""
    try:
        child = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=STUDY_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"not finished after {STUDY_SECONDS} s"
    lines = child.stdout.strip().splitlines()
    if child.returncode == 0 and lines:
        return json.loads(lines[-1])["failure"]
    said = child.stderr.strip().splitlines()
    return f"ended with status {child.returncode}: {said[-1] if said else 'no message'}"


def execute(path, *, quick=False, cell_seconds=CELL_SECONDS):
    """Execute a notebook; return it with its outputs, and what failed in one line (or nothing)."""
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    path = Path(path)
    notebook = nbformat.read(path, as_version=4)
    if quick:
        _insert_quick(notebook, path.stem.lstrip("0123456789_"))
    client = NotebookClient(
        notebook,
        timeout=cell_seconds,
        kernel_name="python3",
        resources={"metadata": {"path": str(path.parent)}},
    )
    try:
        client.execute()
    except CellExecutionError as error:
        return notebook, f"{error.ename}: {error.evalue}".splitlines()[0]
    except CellTimeoutError:
        return notebook, f"a cell ran longer than {cell_seconds} s"
    except DeadKernelError:
        return notebook, "the kernel died"
    return notebook, ""


def page(notebook, title):
    """Return an executed notebook as one HTML page that needs nothing from the network."""
    from nbconvert import HTMLExporter

    exporter = HTMLExporter(template_name="basic", embed_images=True)
    body, _ = exporter.from_notebook_node(notebook)
    return PAGE.format(title=title, body=body)


PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{ max-width: 60em; margin: 2em auto; padding: 0 1em; font: 16px/1.5 sans-serif; color: #222 }}
pre {{ overflow-x: auto; background: #f6f6f6; padding: .6em; font-size: 13px; line-height: 1.35 }}
table {{ border-collapse: collapse; font-size: 13px; display: block; overflow-x: auto }}
td, th {{ border-bottom: 1px solid #ddd; padding: .2em .6em; text-align: right }}
img {{ max-width: 100% }} .prompt, .anchor-link {{ display: none }}
.output_stderr pre {{ background: #fff4e5 }} .output_error pre {{ background: #fdecea }}
</style></head><body><p><a href="../index.html">All studies</a></p>{body}</body></html>
"""


def _insert_quick(notebook, stem):
    """Put a cell with the study's small parameters behind the one tagged ``parameters``."""
    import nbformat

    tagged = [
        number
        for number, cell in enumerate(notebook.cells)
        if "parameters" in cell.metadata.get("tags", [])
    ]
    if not tagged:
        raise ValueError(f"Invalid notebook {stem}. Must have a cell tagged parameters.")
    code = f"from mmqa_lab.studies.{stem} import QUICK\n\nglobals().update(QUICK)"
    notebook.cells.insert(tagged[0] + 1, nbformat.v4.new_code_cell(code))


def main(arguments):
    """Execute, write the page, print the outcome."""
    path, target, *rest = arguments
    notebook, failure = execute(path, quick=rest == ["quick"])
    stem = Path(target).name
    html = page(notebook, stem)
    file = Path(target) / f"{stem}.html"
    write_atomically(file, lambda temporary: temporary.write_text(html, encoding="utf-8"))
    print(json.dumps({"failure": failure}))


if __name__ == "__main__":
    main(sys.argv[1:])
