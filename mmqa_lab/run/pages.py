"""The pages of a run: an index of all studies, the ledger, and each notebook as it was executed.

A page is one file with relative links and needs nothing from the network. The texts around the
results are in ``templates/``.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from mmqa_lab.run.results import FORMATS, read_record, write_text

TEMPLATES = Path(__file__).parent / "templates"

SAVED_FIGURE = re.compile(r"""save_figure\(\s*\w+,\s*["'](\w+)["']""")


def write_pages(folder, studies, outcomes):
    """Write ``index.html`` and, where a study left a ledger, ``ledger.html``.

    Parameters
    ----------
    folder : path
        Of all results.
    studies : list of mmqa_lab.studies.catalogue.Study
    outcomes : list of Outcome or None
        One for each study; None for one that was never run.
    """
    folder = Path(folder)
    cards = [
        _card(study, outcome, folder / study.stem)
        for study, outcome in zip(studies, outcomes, strict=True)
        if outcome is not None
    ]
    ledger = read_ledger(folder)
    if ledger is not None:
        write_text(folder / "ledger.html", _filled("ledger.html", ledger=ledger))
    text = _filled("index.html", cards=cards, ledger=ledger, formats=FORMATS)
    write_text(folder / "index.html", text)


def notebook_page(notebook, title, *, seen):
    """Return an executed notebook as a page.

    Parameters
    ----------
    notebook : NotebookNode
    title : str
    seen : dict of str
        What is seen in the figures, by their names; it becomes the text in place of the picture.
    """
    from nbconvert import HTMLExporter
    from pygments.formatters import HtmlFormatter

    for cell in notebook.cells:
        texts = [seen[name] for name in SAVED_FIGURE.findall(cell.source) if seen.get(name)]
        cell.metadata["alt"] = ". ".join(texts) or f"Figure of {title}"
    exporter = HTMLExporter(
        template_name="study", extra_template_basedirs=[str(TEMPLATES)], embed_images=True
    )
    body, _ = exporter.from_notebook_node(notebook)
    style = HtmlFormatter(style="default").get_style_defs(".highlight")
    return _filled("notebook.html", title=title, body=body, style=style)


def _filled(name, **values):
    """A template with its values."""
    from jinja2 import Environment, FileSystemLoader

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name).render(**values)


def _card(study, outcome, folder):
    """What the index shows of one study, from what its run left on the disk."""
    record = read_record(folder)
    files = record.get("files", [])
    figure = record.get("answer", {}).get("figure") or _last_figure(files)
    return {
        "study": study,
        "outcome": outcome,
        "record": record,
        "answer": record.get("answer", {}).get("sentence", ""),
        "figure": figure,
        "seen": record.get("seen", {}).get(figure, "") or study.title,
        "figures": [name.removesuffix(".png") for name in files if name.endswith(".png")],
        "tables": [name for name in files if name.endswith(".csv")],
        "checks": _checks(folder),
    }


def _last_figure(files):
    """The last figure that a run made, for a run that did not come to its answer."""
    figures = [name.removesuffix(".png") for name in files if name.endswith(".png")]
    return figures[-1] if figures else ""


def _checks(folder):
    """The checks of a run."""
    file = folder / "checks.csv"
    return pd.read_csv(file).fillna("").to_dict("records") if file.is_file() else []


@dataclass(frozen=True)
class Ledger:
    """The rows of all studies' ledgers, and their counts by source and verdict with sums."""

    rows: pd.DataFrame
    counts: pd.DataFrame

    @property
    def records(self):
        """The rows as dicts of texts, numbers with four digits."""
        texts = self.rows.map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
        return texts.astype(object).where(self.rows.notna(), "").to_dict("records")


def read_ledger(folder):
    """Return the ledger of the studies' results in a folder; None before one was written."""
    folder = Path(folder)
    if not any(folder.glob("*/ledger.csv")):
        return None
    from mmqa_lab.published import ledger

    rows = ledger.collect(folder)
    counts = pd.crosstab(rows["source"], rows["verdict"], margins=True, margins_name="all")
    return Ledger(rows, counts)
