"""What the repository keeps of a full run: ``python -m mmqa_lab.run.store``.

Notebooks with their outputs, thumbnails of their key figures, the ledger's counts and the picture
of the front page, from ``notebooks/results``.
"""

import base64
import io
import sys
from pathlib import Path

import nbformat
from PIL import Image

from mmqa_lab.io import write_atomically
from mmqa_lab.run import read_record
from mmqa_lab.run.pages import KEY_FIGURE, WIDGET, ledger_figure, read_outcome
from mmqa_lab.studies import STUDIES, notebooks_folder, results_folder

WIDEST_PX, THUMBNAIL_PX = 700, 280
"""Widths of stored figures (178 mm at 100 dpi) and of thumbnails."""

LARGEST_BYTES = 1_000_000
"""Of a notebook with its outputs."""


def store(notebooks, folder, studies):
    """Store the outputs of full runs.

    Parameters
    ----------
    notebooks : path
        Folder of the notebooks, which are written with their outputs.
    folder : path
        Of the results.
    studies : list of mmqa_lab.studies.Study

    Raises
    ------
    ValueError
        If a study has no full run to its end, or its notebook changed since.
    """
    from mmqa_lab.published.ledger import collect

    folder, notebooks = Path(folder), Path(notebooks)
    for study in studies:
        outcome = read_outcome(folder / study.stem)
        if outcome is None or outcome.quick or not outcome.ok:
            raise ValueError(f"Invalid results of {study.stem}. Must be of a full run to its end.")
        ran = nbformat.read(folder / study.stem / f"{study.stem}.ipynb", as_version=4)
        kept = nbformat.read(study.path, as_version=4)
        if [cell.source for cell in ran.cells] != [cell.source for cell in kept.cells]:
            raise ValueError(
                f"Invalid results of {study.stem}: the notebook changed. Run it again."
            )
        write_atomically(study.path, nbformat.writes(_lightened(ran, kept)) + "\n")
        figure = read_record(folder / study.stem)["answer"]["figure"]
        picture = Image.open(folder / study.stem / f"{figure}.png").convert("RGB")
        _save(picture, notebooks / "thumbnails" / f"{study.notebook}.png", THUMBNAIL_PX, colours=64)
    _save(Image.open(folder / KEY_FIGURE), notebooks / "key_figure.png", 1000, colours=128)
    figure = ledger_figure(collect(folder))
    write_atomically(notebooks / "ledger.png", lambda file: figure.savefig(file, dpi=120))


def _lightened(ran, kept):
    """The notebook with the outputs of its run: no widgets, no stderr, pictures made small."""
    for cell, plain in zip(ran.cells, kept.cells, strict=True):
        cell.metadata = plain.metadata
        if cell.cell_type == "code":
            cell.outputs = [_small(output) for output in cell.outputs if _is_kept(output)]
    ran.metadata = kept.metadata
    if len(nbformat.writes(ran)) > LARGEST_BYTES:
        raise ValueError(f"Invalid outputs: {len(nbformat.writes(ran))} bytes. Must be a million.")
    return ran


def _is_kept(output):
    """Whether an output can be read without a kernel."""
    return output.get("name") != "stderr" and WIDGET not in output.get("data", ())


def _small(output):
    """An output with its picture at most as wide as a page at 100 dpi."""
    data = output.get("data", {})
    if "image/png" in data:
        stream = io.BytesIO()
        picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"])))
        _shrunk(picture, WIDEST_PX, 128).save(stream, "png", optimize=True)
        output["data"] = {"image/png": base64.b64encode(stream.getvalue()).decode()}
    return output


def _shrunk(picture, width, colours):
    """A picture at most that wide, on white, with few colours."""
    picture = picture.convert("RGBA")
    white = Image.new("RGBA", picture.size, "white")
    picture = Image.alpha_composite(white, picture).convert("RGB")
    size = min(width, picture.width), round(picture.height * min(width / picture.width, 1))
    return picture.resize(size, Image.Resampling.LANCZOS).quantize(colours)


def _save(picture, path, width, *, colours):
    """Write a picture made small."""
    path.parent.mkdir(exist_ok=True)
    small = _shrunk(picture, width, colours)
    write_atomically(path, lambda file: small.save(file, "png", optimize=True))


if __name__ == "__main__":
    try:
        store(notebooks_folder(), results_folder(notebooks_folder()), STUDIES)
    except (ValueError, OSError) as error:
        sys.exit(f"mmqa_lab.run.store: {error}")
