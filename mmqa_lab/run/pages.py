"""The pages of a run: an index of all studies, the ledger, and each notebook as it was executed.

A page is one file with relative links and needs nothing from the network. The texts around the
results are in ``templates/``.
"""

import re
from pathlib import Path

import pandas as pd

from mmqa_lab.run.results import FORMATS, read_record, write_text

TEMPLATES = Path(__file__).parent / "templates"

SHOWN = [
    "source",
    "table",
    "cell",
    "role",
    "printed",
    "unit",
    "ours",
    "ours_low",
    "ours_high",
    "kind",
    "study",
    "verdict",
    "note",
]
"""Columns of the ledger's page."""

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
    ledger = _ledger(folder)
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
    return pd.read_csv(file, keep_default_na=False).to_dict("records") if file.is_file() else []


def read_ledger(folder):
    """Return the ledger of the studies' results in a folder; None before one was written."""
    folder = Path(folder)
    if not any(folder.glob("*/ledger.csv")):
        return None
    from mmqa_lab.published import ledger

    return ledger.collect(folder)


def _ledger(folder):
    """What the pages show of the ledger: counts and rows, numbers with four digits."""
    rows = read_ledger(folder)
    if rows is None:
        return None
    from mmqa_lab.published.ledger import summary

    texts = rows[SHOWN].map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
    return {
        "counts": summary(rows),
        "rows": texts.astype(object).where(rows[SHOWN].notna(), "").to_dict("records"),
        "columns": SHOWN,
    }
