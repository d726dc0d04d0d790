"""Store the results of a full run in the repository: ``python -m mmqa_lab.run.store``.

From ``notebooks/results`` it stores the notebooks with their outputs, the thumbnails of their key
figures, the counts of the ledger and the picture of the front page.
"""

import base64
import copy
import hashlib
import io
import sys
from pathlib import Path

import nbformat
import pandas as pd
from PIL import Image

from mmqa_lab import plots
from mmqa_lab.io import write_atomically
from mmqa_lab.run import read_record
from mmqa_lab.run.notebooks import execute
from mmqa_lab.run.pages import ANSWERS, WIDGET, read_outcome
from mmqa_lab.studies import STUDIES, TOOLS, notebooks_folder, results_folder

WIDTHS_PX, THUMBNAIL_PX = (700, 560, 420, 320), 280
"""Possible widths of stored figures, from 178 mm at 100 dpi down, and width of thumbnails."""

KEY_FIGURE = "anisotropy/patterns.png"
"""The first figure of the README, in the folder of results."""

VERDICT_COLOURS = ("#009E73", "#56B4E9", "#D55E00", "#BBBBBB")

LARGEST_BYTES = 1_000_000
"""Largest size of a notebook with its outputs."""


def store(notebooks, folder, studies):
    """Store the outputs of full runs.

    Parameters
    ----------
    notebooks : path
        Folder of the notebooks. They are overwritten with their outputs.
    folder : path
        Folder of the results.
    studies : list of mmqa_lab.studies.Study

    Raises
    ------
    ValueError
        If a study has no complete full run, if its notebook changed after the run, or if its
        outputs are too large.
    """
    from mmqa_lab.published.ledger import collect, summary

    folder, notebooks = Path(folder), Path(notebooks)
    kept = notebooks / ANSWERS
    answers = dict(pd.read_csv(kept).to_numpy()) if kept.is_file() else {}
    for study in studies:
        outcome = read_outcome(folder / study.stem)
        if outcome is None or outcome.quick or not outcome.ok:
            raise ValueError(f"Invalid results of {study.stem}. Must be of a full run to its end.")
        ran = nbformat.read(folder / study.stem / f"{study.stem}.ipynb", as_version=4)
        plain = nbformat.read(study.path, as_version=4)
        if [cell.source for cell in ran.cells] != [cell.source for cell in plain.cells]:
            raise ValueError(
                f"Invalid results of {study.stem}: the notebook changed. Run it again."
            )
        write_atomically(study.path, nbformat.writes(_lightened(ran, plain)) + "\n")
        answer = read_record(folder / study.stem)["answer"]
        answers[study.stem] = answer["sentence"]
        picture = Image.open(folder / study.stem / f"{answer['figure']}.png")
        _save(picture, notebooks / "thumbnails" / f"{study.notebook}.png", THUMBNAIL_PX, colours=64)
    write_atomically(kept, pd.DataFrame(answers.items(), columns=["study", "answer"]))
    if not (folder / KEY_FIGURE).is_file():
        return
    _save(Image.open(folder / KEY_FIGURE), notebooks / "key_figure.png", 1000, colours=128)
    figure = _ledger_figure(summary(collect(folder)))
    write_atomically(notebooks / "ledger.png", lambda file: figure.savefig(file, dpi=120))


def store_tool(study, folder):
    """Run a notebook that is a tool without a screen, and store the outputs of its start.

    Raises
    ------
    ValueError
        If a cell fails.
    """
    folder, plain = Path(folder).resolve(), nbformat.read(study.path, as_version=4)
    ran = copy.deepcopy(plain)
    failure = execute(ran, study.path.parent, results=folder)
    if failure:
        raise ValueError(f"Invalid notebook {study.notebook}: {failure}. Must run to its end.")
    text = nbformat.writes(_lightened(ran, plain)).replace(str(folder), "results")
    write_atomically(study.path, text + "\n")


def code_hash(notebook):
    """SHA-256 of a notebook's code, which tells whether stored outputs belong to this code."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\n\n".join(code).encode()).hexdigest()


def _lightened(ran, kept):
    """The notebook with its outputs, without widgets and stderr, and with small pictures."""
    ran.metadata = {**kept.metadata, "mmqa_lab": {"code": code_hash(ran)}}
    for width in WIDTHS_PX:
        for cell, plain in zip(ran.cells, kept.cells, strict=True):
            cell.metadata = plain.metadata
            if cell.cell_type == "code":
                cell.outputs = [_small(one, width) for one in cell.outputs if _is_kept(one)]
        if len(nbformat.writes(ran)) < LARGEST_BYTES:
            return ran
    raise ValueError(
        f"Invalid outputs: {len(nbformat.writes(ran))} bytes. Must be less than a million."
    )


def _is_kept(output):
    """Whether an output can be read without a kernel."""
    return output.get("name") != "stderr" and WIDGET not in output.get("data", ())


def _small(output, width):
    """An output with its picture reduced to a width."""
    data = output.get("data", {})
    if "image/png" in data:
        stream = io.BytesIO()
        picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"])))
        _shrunk(picture, width, 256).save(stream, "png", optimize=True)
        output["data"] = {"image/png": base64.b64encode(stream.getvalue()).decode()}
    return output


def _shrunk(picture, width, colours):
    """A picture on white, reduced to a width and to a number of colours."""
    picture = picture.convert("RGBA")
    white = Image.new("RGBA", picture.size, "white")
    picture = Image.alpha_composite(white, picture).convert("RGB")
    size = min(width, picture.width), round(picture.height * min(width / picture.width, 1))
    picture = picture.resize(size, Image.Resampling.LANCZOS)
    return picture.quantize(colours, method=Image.Quantize.MAXCOVERAGE)  # keeps rare colours


def _save(picture, path, width, *, colours):
    """Write a reduced picture as PNG."""
    path.parent.mkdir(exist_ok=True)
    small = _shrunk(picture, width, colours)
    write_atomically(path, lambda file: small.save(file, "png", optimize=True))


def _ledger_figure(counts):
    """The verdicts on each source's results, as stacked bars."""
    with plots.style():
        figure, ax = plots.subplots(width="double", height_mm=60)
        shown = counts.drop(index="all")[::-1]
        shown.plot.barh(stacked=True, ax=ax, color=VERDICT_COLOURS, width=0.7)
        ax.set(xlabel="printed numbers", ylabel="")
        ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


if __name__ == "__main__":
    try:
        results = results_folder(notebooks_folder())
        store(notebooks_folder(), results, STUDIES)
        for tool in TOOLS:
            store_tool(tool, results)
    except (ValueError, OSError) as error:
        sys.exit(f"mmqa_lab.run.store: {error}")
