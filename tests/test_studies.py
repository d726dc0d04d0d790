"""Every study runs from top to bottom without a screen, and one that fails says what failed."""

import json
import os
import signal
import subprocess
import sys
import time

import nbformat
import pandas as pd
import pytest

from mmqa_lab.run import Run
from mmqa_lab.run import notebooks as headless
from mmqa_lab.run.readme import masked
from mmqa_lab.run.students import student_cell
from mmqa_lab.studies.catalogue import STUDIES, Study, chosen, notebooks_folder


class Elsewhere(Study):
    """A study whose notebook lies in another folder."""

    folder = None

    @property
    def path(self):
        return self.folder / f"{self.notebook}.ipynb"


def before_the_answers(study, folder):
    """The study with each exercise as a student gets it, untouched, before its answer."""
    notebook = nbformat.read(study.path, as_version=4)
    cells, exercises = [], 0
    for cell in notebook.cells:
        if "solution" in cell.metadata.get("tags", []):
            exercise = nbformat.v4.new_code_cell(student_cell(cell.source))
            exercise.metadata["tags"] = ["raises-exception"]
            cells.append(exercise)
            exercises += 1
        cells.append(cell)
    notebook.cells = cells
    here = Elsewhere(study.number, study.stem, study.title, study.question, study.source)
    object.__setattr__(here, "folder", folder)
    nbformat.write(notebook, here.path)
    return here, exercises


@pytest.mark.timeout(600)
@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_notebook_runs_with_small_parameters(study, tmp_path):
    study, exercises = before_the_answers(study, tmp_path)
    outcome = headless.run_study(study, tmp_path, quick=True)
    assert outcome.verdict == "ok"
    folder = tmp_path / study.stem
    record = json.loads((folder / "run.json").read_text())
    assert record["checks"] == record["claims_that_hold"] > 0
    assert record["overlapping_texts"] == {}
    answer = record["answer"]
    assert f"{answer['figure']}.png" in record["files"]
    readme = (notebooks_folder().parent / "README.md").read_text(encoding="utf-8")
    assert f"| {masked(answer['sentence'])} |" in masked(readme)  # written by mmqa readme
    assert {path.name for path in folder.iterdir()} >= {*record["files"], f"{study.stem}.html"}
    page = (folder / f"{study.stem}.html").read_text()
    assert "<img" in page
    assert page.count("Traceback (most recent call last)") == exercises  # checks fail unworked
    assert 'src="http' not in page  # nothing comes from the network
    gallery.write_index(tmp_path)
    index = (tmp_path / "index.html").read_text()
    assert study.title in index
    assert all(f'src="{study.stem}/' in part for part in index.split("<img ")[1:])


@pytest.fixture
def broken(tmp_path):
    """Run a notebook of the given cells as a study."""

    def run(*sources, tags=()):
        cells = [nbformat.v4.new_code_cell(source) for source in sources]
        cells[0].metadata["tags"] = list(tags)
        study = Elsewhere(99, "broken", "Broken", "What happens?", "nowhere")
        object.__setattr__(study, "folder", tmp_path)
        nbformat.write(nbformat.v4.new_notebook(cells=cells), study.path)
        return headless.run_study(study, tmp_path / "results")

    return run


def test_a_failing_cell_is_named_and_its_page_kept(broken, tmp_path):
    outcome = broken("1 + 1", "assert False, 'Does not hold: f is below 2'")
    assert not outcome.ok
    assert outcome.verdict == "AssertionError: Does not hold: f is below 2"
    assert headless.read_outcome(tmp_path / "results" / "broken") == outcome
    assert "f is below 2" in (tmp_path / "results" / "broken" / "broken.html").read_text()


def test_a_kernel_that_dies_is_reported(broken):
    assert broken("import os; os._exit(1)").verdict == "the kernel died"


def test_a_cell_that_never_ends_is_stopped(tmp_path):
    cell = nbformat.v4.new_code_cell("import time; time.sleep(60)")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / "slow.ipynb")
    _, failure = headless.execute(tmp_path / "slow.ipynb", cell_seconds=1)
    assert failure == "a cell ran longer than 1 s"


def test_studies_are_chosen_by_stem_or_notebook_name():
    assert [study.stem for study in chosen()] == [study.stem for study in STUDIES]
    assert chosen(["01_chart_tables"]) == chosen(["chart_tables"])
    assert STUDIES[0].path.parent == notebooks_folder()


def test_a_killed_run_leaves_whole_files_and_the_next_run_clears_the_rest(tmp_path, monkeypatch):
    command = [sys.executable, "-m", "mmqa_lab", "studies", "mimic", "--quick"]
    study = tmp_path / "mimic"
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], start_new_session=True, stderr=subprocess.DEVNULL
    ) as run:
        while not any(study.glob("*.csv")):
            assert run.poll() is None
            time.sleep(0.02)
        os.killpg(run.pid, signal.SIGKILL)
    assert headless.read_outcome(study) is None  # it is no finished study
    for path in study.glob("[!.]*"):
        if path.suffix == ".csv":
            assert len(pd.read_csv(path)) > 0
        elif path.suffix in (".pdf", ".svg"):
            assert path.read_bytes().rstrip().endswith((b"%%EOF", b"</svg>"))
    (study / ".frame.99.svg").write_text("half a file")
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    Run("mimic", parameters={})
    assert not list(study.glob(".*"))
