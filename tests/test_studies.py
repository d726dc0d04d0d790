"""Every study runs from top to bottom without a screen, and one that fails says what failed."""

import html
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import guesses
import nbformat
import numpy as np
import pandas as pd
import psutil
import pytest
from pyproj import CRS

from mmqa_lab import commands
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import write_atomically, write_cloud
from mmqa_lab.run import Run, notebooks, pages, parameter_names, read_record, verdict
from mmqa_lab.run.exercises import student_cell
from mmqa_lab.samples import SAMPLES
from mmqa_lab.studies import STUDIES, TOOLS, Study, chosen, notebooks_folder

TESTS = str(Path(__file__).parent)


class Elsewhere(Study):
    """A study whose notebook lies in another folder."""

    folder = None

    @property
    def path(self):
        return self.folder / f"{self.notebook}.ipynb"


def before_the_answers(study, folder):
    """The study with each exercise as a student gets it, untouched, before its answer.

    Guesses and the answer of a neighbour are tried on each check; the cells stop where one passes.
    """
    notebook = nbformat.read(study.path, as_version=4)
    cells, exercises = [], 0
    for cell in notebook.cells:
        if "solution" in cell.metadata.get("tags", []):
            exercise = nbformat.v4.new_code_cell(student_cell(cell.source))
            exercise.metadata["tags"] = ["raises-exception"]
            before, behind = map(nbformat.v4.new_code_cell, guesses.around(cell.source))
            cells += [exercise, before, cell, behind]
            exercises += 1
        else:
            cells.append(cell)
    watch = f"import sys; sys.path.insert(0, {TESTS!r}); import overlaps"
    watch += f"; overlaps.watch({str(folder / 'overlaps.json')!r})"
    notebook.cells = [nbformat.v4.new_code_cell(watch), *cells]
    here = Elsewhere(**vars(study))
    object.__setattr__(here, "folder", folder)
    nbformat.write(notebook, here.path)
    return here, exercises


NEED_MANY = {
    "fitness": {
        "The noise of a mean tells better than f which clouds do for relief, kerb and pothole.",
        "For relief and wire a metric chosen by one half of the clouds beats a coin on the other.",
    },
    "test_field": {"A roll of tenths of a degree costs more in height than all other errors."},
}
"""Checks of the full run that small parameters cannot answer: forty clouds do not tell accuracies
of .54 and .59 apart; drift of 48 m of street alone moves heights by 27 mm."""


@pytest.mark.timeout(0)
@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_notebook_runs_with_small_parameters(study, tmp_path):
    study, exercises = before_the_answers(study, tmp_path)
    record = notebooks.run_study(study, tmp_path / "results", size="quick")
    folder = tmp_path / "results" / study.stem
    assert record["failure"] == ""
    assert record["checks"]
    failed = {check["statement"] for check in record["checks"] if not check["passed"]}
    assert failed <= NEED_MANY.get(study.stem, set())
    assert record == read_record(folder)
    assert list(record["parameters"]) == parameter_names(study.path)
    for name, value in study.quick.items():  # they were injected, and are what is recorded
        assert record["parameters"][name] == json.loads(json.dumps(value, default=list))
    seen = json.loads((tmp_path / "overlaps.json").read_text())
    assert seen["found"] == {}
    assert {"explorer", *record["figures"]} == set(seen["seen"])
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("*.tex")]
    assert not {sign for text in texts for sign in text if ord(sign) > 255}  # pdflatex has none
    answer = record["answer"]
    assert f"{answer['figure']}.png" in record["files"]
    assert record["figures"][answer["figure"]]
    sentences = re.split(r"(?<=[.!?]) ", answer["sentence"])
    assert max(len(one.split()) for one in sentences) <= 26
    assert 5 <= len(answer["sentence"].split()) <= 66
    ran = nbformat.read(folder / f"{study.stem}.ipynb", as_version=4)
    first = next(cell for cell in ran.cells if cell.cell_type == "markdown")
    shown = "\n\n![Answer](attachment:answer.png)\n\n"
    assert f"\n\n**Answer. {answer['short']}** {answer['sentence']}{shown}" in first.source
    assert "answer.png" in first.attachments
    outputs = [one for cell in ran.cells for one in cell.get("outputs", [])]
    assert "".join(one["text"] for one in outputs if one.get("name") == "stderr") == ""
    if (folder / "ledger.csv").is_file():
        ledger = pd.read_csv(folder / "ledger.csv")
        assert set(ledger["source"] + " " + ledger["table"]) == set(study.tables)
    assert {path.name for path in folder.iterdir()} == {*record["files"], "run.json"}
    page = (folder / f"{study.stem}.html").read_text()
    assert "<img" in page
    assert len(re.findall(r"Exercise \d: give \w+ a value", page)) == exercises  # fail unworked
    assert 'src="http' not in page  # nothing comes from the network
    pages.write_pages(tmp_path / "results", [study])
    index = html.unescape((tmp_path / "results" / "index.html").read_text())
    assert study.title in index
    assert f"<b>{answer['short']}</b>" in index  # the details go on from it
    stored = pages.stored_answers(notebooks_folder())[study.stem]
    assert f"<b>Full run:</b> {stored[0]}" in index
    assert "Quick run: " in index
    assert "Quick run: small parameters" in page
    assert all(f'src="{study.stem}/' in part for part in index.split("<img ")[1:])


@pytest.mark.timeout(0)
def test_the_tool_runs_on_samples(tmp_path):
    record = notebooks.run_study(TOOLS[0], tmp_path)
    assert record["failure"] == ""
    folder = tmp_path / TOOLS[0].stem
    assert list(record["parameters"]) == parameter_names(TOOLS[0].path)
    table = pd.read_csv(folder / "compared.csv")
    assert set(table["cloud"]) == {"road_patch", "chart_b_5m"}
    given = table.dropna(subset="low")
    assert set(given["figure"]) > {"density", "sigma_MAD"}
    assert (given["low"] <= given["value"] * (1 + 1e-9)).all()
    assert table["answer"].isna().all()  # nothing is asked
    folder = next(folder.glob("*/report.html")).parent
    assert repeated(folder) == pytest.approx(figures_of(folder), rel=1e-6)
    page = (folder / "report.html").read_text()
    parts = SAMPLES["road_patch"].sha256, record["version"], "sigma_MAD", "data:image/png"
    for part in (*parts, "What it supports", "noise_of_a_mean"):
        assert part in page


def figures_of(folder):
    """The figures of the notebook's selection."""
    return pd.read_csv(folder / "figures.csv")["value"].tolist()


def repeated(folder):
    """The same figures by the command that the report names."""
    words = re.search(r"Again: mmqa ([^<]*)", (folder / "report.html").read_text())[1].split()
    words = [str(folder / word) if word.startswith("selection.") else word for word in words]
    assert commands.run([*words, "--intervals", "--csv", str(folder / "again.csv")]) == 0
    return pd.read_csv(folder / "again.csv")["value"].tolist()


TOOL_CELLS = ["own-02", "own-03", "own-04", "own-04-read", "own-16", "own-17", "own-06", "own-08"]
"""From the files to the answers."""


def run_tool(files):
    """Run the tool's cells on other files; return their names."""
    cells = {cell.id: cell.source for cell in nbformat.read(TOOLS[0].path, as_version=4).cells}
    scope = {}
    for name in TOOL_CELLS:
        exec(re.sub(r"(?m)^%.*", "", cells[name]), scope)
        if name == TOOL_CELLS[0]:
            scope["files"], scope["asked"] = tuple(files), {"density": ">= 1700"}
    return scope


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("bush", "Invalid cloud bush: no plane of 0.5 m or more. Must have one."),
        ("none", "Invalid files .*none.laz. Must be clouds in metres, see the lines above."),
    ],
)
def test_no_cloud_of_use_ends_the_tool_with_a_sentence_alone(
    name, sentence, tmp_path, rng, monkeypatch
):
    monkeypatch.setenv("MMQA_HEADLESS", "1")
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    write_cloud(tmp_path / "bush.laz", Cloud(rng.normal(0, 1, (300, 3))), scale=1e-3)
    with pytest.raises(ValueError, match=sentence) as caught:
        run_tool([str(tmp_path / f"{name}.laz")])
    assert caught.value._render_traceback_() == [str(caught.value)]


def test_a_cloud_that_cannot_be_used_is_a_sentence_beside_the_others(
    tmp_path, rng, monkeypatch, capsys
):
    monkeypatch.setenv("MMQA_HEADLESS", "1")
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    wall = rng.uniform(0, 1, (1000, 3)) * [1, 1, 0]
    clouds = {
        "feet": Cloud(wall, crs=CRS.from_epsg(2992)),
        "turned": Cloud(wall / 1e5 + [12, 48, 0], crs=CRS.from_epsg(4326)),
        "bush": Cloud(rng.normal(0, 1, (300, 3))),
        "wall": Cloud(wall),
    }
    files = [tmp_path / f"{name}.laz" for name in ("feet", "turned", "none", "bush", "wall")]
    for name, cloud in clouds.items():
        write_cloud(tmp_path / f"{name}.laz", cloud, scale=1e-7 if name == "turned" else 1e-3)
    wall[:2] = -9999
    np.savetxt(tmp_path / "gaps.xyz", wall)
    scope = run_tool(map(str, [*files, tmp_path / "gaps.xyz", "no_sample"]))
    said = capsys.readouterr().out
    for part in (
        "'feet' in foot",
        "'turned' in degree",
        "none.laz: no such file",
        "bush: no plane",
        "Invalid sample 'no_sample'",
        "Dropped 2 of 1000 points",
    ):
        assert said.count(part) == 1
    assert scope["tool"].name == "wall"
    assert ">= 1700 is asked" in said
    assert "The smallest detail" in said
    assert "step is not known. noise_of_a_mean lies outside of what was tried" in said


@pytest.fixture
def broken(tmp_path):
    """Run a notebook of the given cells, the first one with the parameters, as a study."""

    def run(*sources):
        cells = [nbformat.v4.new_code_cell(source) for source in sources]
        cells[0].metadata["tags"] = ["parameters"]
        study = Elsewhere(99, "broken", "Broken", "What happens?", "nowhere")
        object.__setattr__(study, "folder", tmp_path)
        nbformat.write(nbformat.v4.new_notebook(cells=cells), study.path)
        return study, notebooks.run_study(study, tmp_path / "results")

    return run


MADE = """
import os
import pandas as pd
import psutil
from mmqa_lab.run import Run
run = Run("broken", parameters=globals())
run.save_table(pd.DataFrame({"f": [2.0]}), "made", kind="measured")
"""


def test_a_failing_cell_is_named_and_what_it_made_is_shown(broken, tmp_path):
    study, record = broken("seed = 1", MADE, "raise ValueError('f is <missing>')", "2 + 2")
    folder = tmp_path / "results"
    assert verdict(record) == "ValueError: f is <missing>"
    assert read_record(folder / "broken") == record
    page = (folder / "broken" / "broken.html").read_text()
    assert "Stopped: <code>ValueError: f is &lt;missing&gt;</code>" in page
    never_run = Study(98, "never", "Never", "?", "nowhere")
    pages.write_pages(folder, [study, never_run])
    index = (folder / "index.html").read_text()
    assert "ValueError: f is &lt;missing&gt;" in index
    assert index.count('href="broken/made.csv"') == 1
    assert "Never" not in index


@pytest.mark.parametrize("dies", [1, 2])
def test_a_kernel_that_does_not_begin_is_tried_again_and_then_said(broken, monkeypatch, dies):
    begin, tried = notebooks.NotebookClient.execute, []

    def execute(client, **options):
        tried.append(client)
        client.code_cells_executed = 0
        if len(tried) <= dies:
            raise RuntimeError("Kernel died before replying to kernel_info")
        return begin(client, **options)

    monkeypatch.setattr(notebooks.NotebookClient, "execute", execute)
    _, record = broken("seed = 1", MADE)
    said = ["", "", "Kernel died before replying to kernel_info"]
    assert (record["failure"], len(tried)) == (said[dies], 2)


def test_a_study_that_is_interrupted_shows_what_it_made(broken, tmp_path):
    record = broken("seed = 1", MADE, "print('so far')", "import os; os._exit(1)")[1]
    assert verdict(record) == "Kernel died"
    page = (tmp_path / "results" / "broken" / "broken.html").read_text()
    assert "Stopped: <code>Kernel died</code>" in page
    assert "so far" in page


def test_a_check_that_fails_stops_nothing(broken, tmp_path):
    check = "run.check('f is below 2', False, 'f = 3.257', ''); run.finish()"
    study, record = broken("seed = 1", MADE, check)
    assert verdict(record) == "0 of 1 checks passed"
    pages.write_pages(tmp_path / "results", [study])
    assert "Not true of this run: f is below 2" in (tmp_path / "results/index.html").read_text()


def test_studies_are_chosen_by_stem_or_notebook_name():
    assert [study.stem for study in chosen()] == [study.stem for study in STUDIES]
    assert chosen(["01_chart_tables"]) == chosen(["chart_tables"])
    assert STUDIES[0].path.parent == notebooks_folder()


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_a_study_asks_the_same_wherever_it_is_listed(study):
    first = nbformat.read(study.path, as_version=4).cells[0].source
    assert study.question in " ".join(first.replace("*", "").split())


def test_a_killed_run_leaves_whole_files_and_the_next_run_clears_the_rest(tmp_path, monkeypatch):
    command = [sys.executable, "-m", "mmqa_lab", "studies", "mimic", "--quick"]
    study = tmp_path / "mimic"
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], start_new_session=True, stderr=subprocess.DEVNULL
    ) as run:
        while not any(study.glob("*.csv")):
            assert run.poll() is None
            time.sleep(0.02)
        workers = psutil.Process(run.pid).children(recursive=True)
        for process in (run, *workers):
            process.kill()
    psutil.wait_procs(workers, timeout=60)
    assert verdict(read_record(study)) == "running, or stopped before its end"
    assert set(read_record(study)["files"]) <= {path.name for path in study.iterdir()}
    for path in study.glob("[!.]*"):
        if path.suffix == ".csv":
            assert len(pd.read_csv(path)) > 0
        elif path.suffix in (".pdf", ".svg"):
            assert path.read_bytes().rstrip().endswith((b"%%EOF", b"</svg>"))
    parts = []
    write_atomically(study / "frame.svg", lambda part: parts.append(part) or part.touch())
    parts[0].write_text("half a file")
    (study / "frame.svg").unlink()
    monkeypatch.setenv("MMQA_RESULTS", str(tmp_path))
    Run("mimic", parameters={})
    assert not list(study.glob(".*"))


@pytest.mark.timeout(0)
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal")
def test_studies_that_are_ended_leave_no_process(tmp_path):
    order = [sys.executable, "-m", "mmqa_lab", "studies", "--quick", "--workers", "2"]
    run = subprocess.Popen([*order, "--out", str(tmp_path)], stderr=subprocess.DEVNULL)
    whole = psutil.Process(run.pid)
    while sum("ipykernel_launcher" in one.cmdline() for one in whole.children(True)) < 2:
        time.sleep(0.2)
    started = whole.children(True)
    run.terminate()
    assert run.wait() == 130
    alive = psutil.wait_procs(started, timeout=120)[1]
    assert not alive
