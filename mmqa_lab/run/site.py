"""A static site of the stored notebooks: pages that open from a file and need no network."""

import re
from pathlib import Path

import nbformat
import pandas as pd

from mmqa_lab import __version__
from mmqa_lab.io import write_atomically
from mmqa_lab.run.pages import (
    filled,
    notebook_page,
    stored_answers,
    write_ledger,
    write_words,
)
from mmqa_lab.run.store import LEDGER

__all__ = ["write_site"]

STYLES = re.compile(r"<style.*?</style>", re.DOTALL)


def write_site(folder, notebooks, studies):
    """Write the stored notebooks as a site: gallery, pages, ledger, glossary, public names.

    Parameters
    ----------
    folder : path
        Created if missing; pages of an earlier site are replaced.
    notebooks : path
        Folder of the stored notebooks.
    studies : list of mmqa_lab.studies.Study
        Studies and tools, in the order of the gallery.

    Returns
    -------
    Path
        The page ``index.html``.
    """
    folder, notebooks = Path(folder), Path(notebooks)
    for study in studies:
        page = notebook_page(
            nbformat.read(study.path, as_version=4), study.title, above=["[Home](index.html)"]
        )
        styles = "\n".join(STYLES.findall(page))
        page = STYLES.sub("", page).replace(
            "</head>", '<link rel="stylesheet" href="notebook.css"></head>'
        )
        page = re.sub(r'href="(\d\d_\w+)\.ipynb', r'href="\1.html', page)
        page = re.sub(r'href="[^"]*/glossary\.csv', 'href="glossary.html', page)
        write_atomically(folder / f"{study.notebook}.html", page)
    write_atomically(folder / "notebook.css", re.sub(r"</?style[^>]*>", "", styles))
    pictures = sorted(notebooks.glob("thumbnails/*.png"))
    for picture in pictures:
        content = picture.read_bytes()
        write_atomically(
            folder / "thumbnails" / picture.name, lambda path, kept=content: path.write_bytes(kept)
        )
    write_words(folder)
    ledger = notebooks / LEDGER
    if ledger.is_file():
        rows = pd.read_csv(ledger, dtype={"printed": str})
        texts = rows.select_dtypes(exclude=["number", "bool"]).columns
        rows[texts] = rows[texts].fillna("")
        write_ledger(folder / "ledger.html", rows)
    home = filled(
        "site.html",
        studies=studies,
        answers=stored_answers(notebooks),
        thumbnails={picture.stem for picture in pictures},
        ledger=ledger.is_file(),
        version=__version__,
    )
    write_atomically(folder / "index.html", home)
    return folder / "index.html"
