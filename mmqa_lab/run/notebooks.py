"""Run notebooks without a screen, each in its own kernel, and store what full runs leave.

What is stored in the repository: the notebooks with their outputs, the thumbnails of their key
figures, the ledger, the picture of the front page, and the seconds of each run.
"""

import base64
import hashlib
import io
import os
import re
import subprocess
import time
from operator import ne
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from PIL import Image
from scipy.spatial import cKDTree

from mmqa_lab import plots, published
from mmqa_lab.io import write_atomically
from mmqa_lab.metrics.registry import CURVES
from mmqa_lab.published.ledger import collect, summary
from mmqa_lab.run.pages import ANSWERS, LEDGER, notebook_page, stored_answers
from mmqa_lab.run.results import new_record, read_record, write_record
from mmqa_lab.studies import SIZES

__all__ = [
    "ENVIRONMENT", "TIMES", "code_hash", "execute", "inject", "machine_speed", "run_study",
    "show_above", "store", "stored_seconds",
]  # fmt: skip


ENVIRONMENT = {
    "MMQA_HEADLESS": "1",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "OPENBLAS_NUM_THREADS": "1",  # matrices are small, so threads would only wait
    "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    "PYTHONDONTWRITEBYTECODE": "",  # otherwise each kernel compiles its libraries, in 6 s
    "TQDM_DISABLE": "1",
}

# The answer of a run with its figure, on the first screen of a notebook.
ANSWER = re.compile(r"(?m)^\*\*Answer\..*\n+(!\[.*\]\(attachment:.*\)\n+)?")

# Widths of stored figures, which is 178 mm at 143 dpi, of the answer's and of thumbnails.
WIDTH_PX, ANSWER_PX, THUMBNAIL_PX = 1000, 800, 280

# Figures of a chart against tasks, for the metric cards, and the curves behind metrics.supports,
# in the folder of results.
TASKS, SUPPORTED = "fitness/tasks_by_figures.csv", "fitness/supported.csv"

# What the README advises, in the folder of results.
ADVICE = "fitness/advice.csv"

# The figures of the README, in the folder of results, their names there and widths.
FRONT = {
    "fitness/six_clouds.png": ("key_figure.png", 760),
    "fitness/answer.png": ("metrics_by_tasks.png", 500),
}


def run_study(study, folder, *, size="full"):
    """Run the notebook of a study.

    Parameters
    ----------
    study : mmqa_lab.studies.Study
    folder : path
        Results go to ``<folder>/<stem>/``; the page is ``<stem>.html``.
    size : str
        One of :data:`mmqa_lab.studies.SIZES`.

    Returns
    -------
    dict
        The run record: ``size``, ``seconds``, ``failure`` (in one line, empty if every cell ran),
        ``answer``, ``checks``, ``files`` and more, also in ``run.json``.
    """
    target = Path(folder).resolve() / study.stem
    write_record(target, new_record(target) | {"size": size})
    notebook = nbformat.read(study.path, as_version=4)
    if size != "full":
        inject(notebook, getattr(study, size), size)
    began = time.monotonic()
    failure = execute(notebook, study.path.parent, results=target.parent)
    seconds = round(time.monotonic() - began, 1)
    above = ["[All studies](../index.html)"]
    above += [f"**{SIZES[size]}.**"] if size != "full" else []
    above += [f"**Stopped: `{failure}`. The cells below it were not run.**"] if failure else []
    record = read_record(target) | {"seconds": seconds, "failure": failure}
    _answer(notebook, record, target)
    show_above(notebook)
    write_atomically(target / f"{study.stem}.ipynb", nbformat.writes(notebook))
    page = notebook_page(notebook, study.title, above=above)
    write_atomically(target / f"{study.stem}.html", page)
    record["files"] += [f"{study.stem}.ipynb", f"{study.stem}.html"]
    write_record(target, record)
    return record


def inject(notebook, parameters, size="quick"):
    """Put a cell with the parameters of a size behind the cell tagged ``parameters``."""
    tags = [cell.metadata.get("tags", []) for cell in notebook.cells]
    place = next(number for number, found in enumerate(tags) if "parameters" in found)
    lines = [f"{name} = {value!r}" for name, value in parameters.items()]
    cell = nbformat.v4.new_code_cell("\n".join([f"# {SIZES[size]}", *lines]))
    notebook.cells.insert(place + 1, cell)


def _answer(notebook, record, folder):
    """Put a run's answer and the figure that shows it onto the first screen of its notebook."""
    figure = record["answer"]["figure"]
    if figure not in record["figures"]:  # of a tool, or of a run that stopped
        return
    first = next(cell for cell in notebook.cells if cell.cell_type == "markdown")
    content = _shrunk((folder / f"{figure}.png").read_bytes(), ANSWER_PX)
    said = f"**Answer. {record['answer']['short']}** {record['answer']['sentence']}\n\n"
    said += "![Answer](attachment:answer.png)\n\n"
    first.source = ANSWER.sub(lambda _: said, first.source)
    first.attachments = {"answer.png": {"image/png": base64.b64encode(content).decode()}}


def show_above(notebook):
    """Renew pictures of the first cell that have the name of the cell which draws them."""
    first = notebook.cells[0]
    drawn = {cell.id: cell.get("outputs", []) for cell in notebook.cells}
    for name in re.findall(r"\(attachment:([\w-]+)\.png\)", first.source):
        for output in drawn.get(name, []):
            if content := output.get("data", {}).get("image/png"):
                small = _shrunk(base64.b64decode(content), ANSWER_PX)
                picture = {"image/png": base64.b64encode(small).decode()}
                first.attachments = {**first.get("attachments", {}), f"{name}.png": picture}


def execute(notebook, folder, *, results, again=True):
    """Execute a notebook in place; return its failure in one line, or an empty text.

    A kernel that does not begin is tried ``again``: one that begins at the same moment may have
    taken its port.
    """
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
    except RuntimeError as error:  # the kernel died, also if the run is interrupted
        if again and not client.code_cells_executed:
            return execute(notebook, folder, results=results, again=False)
        return str(error)
    return ""


def store(notebooks, folder, studies):
    """Store the outputs of full runs.

    Parameters
    ----------
    notebooks : path
        Folder of the notebooks. They are overwritten with their outputs.
    folder : path
        Folder of the results.
    studies : list of mmqa_lab.studies.Study
        Studies and tools.

    Raises
    ------
    ValueError
        If a study has no complete full run, or if its notebook changed after the run.

    Notes
    -----
    The ledger is renewed where the results have all studies that it names.
    """
    folder, notebooks = Path(folder).resolve(), Path(notebooks)
    answers, seconds = stored_answers(notebooks), stored_seconds(notebooks)
    for study in studies:
        record = read_record(folder / study.stem)
        if record.get("size") != "full" or record["failure"]:
            raise ValueError(f"Invalid results of {study.stem}. Must be of a full run to its end.")
        ran = nbformat.read(folder / study.stem / f"{study.stem}.ipynb", as_version=4)
        plain = nbformat.read(study.path, as_version=4)
        texts = ([ANSWER.sub("", cell.source) for cell in one.cells] for one in (ran, plain))
        if ne(*texts):  # but for the answer, which is renewed
            raise ValueError(f"Invalid results of {study.stem}: the notebook changed. Must be run.")
        text = nbformat.writes(_lightened(ran, plain)).replace(str(folder), "results")
        write_atomically(study.path, text + "\n")
        seconds[study.stem] = record["seconds"]
        if figure := record["answer"]["thumbnail"]:  # a tool has none
            answers[study.stem] = [record["answer"]["short"], record["answer"]["sentence"]]
            thumbnail = notebooks / "thumbnails" / f"{study.notebook}.png"
            _store_figure(folder / study.stem / f"{figure}.png", thumbnail, THUMBNAIL_PX)
    rows = [(stem, *both) for stem, both in answers.items()]
    write_atomically(notebooks / ANSWERS, pd.DataFrame(rows, columns=["study", "short", "answer"]))
    _renew_readme(notebooks.parent / "README.md", answers)
    times = pd.DataFrame(seconds.items(), columns=["study", "seconds"])
    write_atomically(notebooks / TIMES, times)
    for name, place in {TASKS: notebooks / Path(TASKS).name, SUPPORTED: CURVES}.items():
        if (folder / name).is_file():
            write_atomically(place, pd.read_csv(folder / name))
    if (folder / ADVICE).is_file():
        _renew_advice(notebooks.parent / "README.md", pd.read_csv(folder / ADVICE))
    for name, (shown, width) in FRONT.items():
        if (folder / name).is_file():
            _store_figure(folder / name, notebooks / shown, width)
    rows = collect(folder)
    known = notebooks / LEDGER
    if known.is_file() and set(rows["study"]) >= set(pd.read_csv(known)["study"].dropna()):
        write_atomically(known, rows)
        counts = summary(rows)
        _store_ledger(counts, notebooks / "ledger.png")
        _renew_readme(notebooks.parent / "README.md", {}, counts.loc["all"], usual_width(rows))


def usual_width(ledger):
    """The median width of our ranges in which printed results lie, as a share of the result."""
    agree = ledger[ledger["decides"] & (ledger["role"] == "result")]
    agree = agree[agree["verdict"] == "consistent"]
    return ((agree["ours_high"] - agree["ours_low"]) / agree["value"].abs()).median()


def _renew_readme(readme, answers, counts=None, width=None):
    """Write short answers into the README's table, by the notebooks of its rows, and counts."""
    if not readme.is_file():
        return
    text = readme.read_text(encoding="utf-8")
    for stem, (short, _) in answers.items():
        text = re.sub(rf"(_?\d\d_{stem}\.ipynb\) \| )[^|\n]*( \|)", rf"\g<1>{short}\g<2>", text)
    if counts is not None:
        said = f"print {counts.sum()} results. {counts['reproduced']} are reproduced to the "
        said += f"printed digits. {counts['consistent']} are consistent with our ranges, whose "
        said += f"median width is {100 * width:.0f} % of the value; {counts['differs']} differ.\n"
        said += f"{counts['fitted']} served to fit, and {counts['not comparable']} are not "
        said += "comparable"
        text = re.sub(r"(?s)print \d+ results\..*\d+ are not comparable", said, text)
    write_atomically(readme, text)


def _renew_advice(readme, found):
    """Write the advised metrics of tasks into the README's table."""
    rows = ["|task|ask for|kept by|", "|---|---|---|"]
    for row in found[found["advised"] == "yes"].itertuples():
        kept = f"{row.kept_by} of {row.n}"
        rows.append(f"|{row.words}|`{row.method}` {row.ask_for}|{kept}|")
    text = readme.read_text(encoding="utf-8")
    text = re.sub(r"\|task\|ask for(?:[^\n]+\n)+", "\n".join([*rows, ""]), text)
    write_atomically(readme, text)


def code_hash(notebook):
    """SHA-256 of a notebook's code, which tells whether stored outputs belong to this code."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\n\n".join(code).encode()).hexdigest()


def _lightened(ran, kept):
    """The notebook with its outputs, without widgets and stderr, and with small pictures."""
    language = {"language_info": ran.metadata.get("language_info", {})}  # else JupyterLab adds it
    ran.metadata = {**kept.metadata, **language, "mmqa_lab": {"code": code_hash(ran)}}
    for cell, plain in zip(ran.cells, kept.cells, strict=True):
        cell.metadata = plain.metadata
        if cell.cell_type == "code":
            shown = [out for out in cell.outputs if out.get("name") != "stderr"]
            cell.outputs = [_small(out) for out in shown if not _is_representation(out)]
    return ran


def _is_representation(output):
    """Whether an output is an object's name alone, as of a legend or of texts."""
    data = output.get("data", {})
    return set(data) == {"text/plain"} and data["text/plain"].lstrip("[").startswith(("<", "Text("))


def _small(output):
    """An output with a reduced picture."""
    if "image/png" in output.get("data", {}):
        small = _shrunk(base64.b64decode(output["data"]["image/png"]), WIDTH_PX)
        output["data"] = {"image/png": base64.b64encode(small).decode()}
    return output


def _shrunk(content, width):
    """A PNG file, reduced to a width and to 256 colours."""
    picture, small = Image.open(io.BytesIO(content)).convert("RGB"), io.BytesIO()
    picture.thumbnail((width, 10 * width), Image.Resampling.LANCZOS)
    picture.quantize(method=Image.Quantize.MAXCOVERAGE).save(small, "png", optimize=True)
    return small.getvalue()


def _store_figure(path, target, width):
    """Store a figure of a run, reduced to a width."""
    content = _shrunk(path.read_bytes(), width)
    write_atomically(target, lambda file: file.write_bytes(content))


def _store_ledger(counts, target):
    """Draw the verdicts on the results of each source as stacked bars."""
    short = published._strings("sources").set_index("source")["short"]
    counts = counts.rename(index=short, columns={"fitted": "served to fit"})
    with plots.style():
        names = ("green", "sky", "orange", "vermilion", "grey", "black")
        bars = {"stacked": True, "color": [plots.COLOURS[name] for name in names]}
        ax = counts.drop(index="all")[::-1].plot.barh(figsize=(7, 2.4), **bars)
        ax.set(xlabel="printed numbers", ylabel="")
        ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        write_atomically(target, lambda file: ax.figure.savefig(file, dpi=120))


TIMES = "times.csv"
"""Beside the notebooks: the seconds of each study's stored run."""

# Time of the work below where the stored runs were made, beside other work on the same cores, s.
REFERENCE_S = 2.2


def machine_speed():
    """Return how many times as long this machine takes for a fixed work as that of the stored runs.

    Returns
    -------
    float
        Above 1 on a slower machine.
    """
    points = np.random.default_rng(0).random((100_000, 3))
    began = time.process_time()
    for _ in range(3):
        cKDTree(points).query(points, k=4)
        np.linalg.eigvalsh(np.einsum("ni,nj->nij", points, points))
    return (time.process_time() - began) / REFERENCE_S


def stored_seconds(notebooks):
    """Return the seconds of the stored runs by study; empty where nothing is stored.

    Parameters
    ----------
    notebooks : path
        Folder of the notebooks.
    """
    file = Path(notebooks) / TIMES
    return dict(pd.read_csv(file).to_numpy()) if file.is_file() else {}
