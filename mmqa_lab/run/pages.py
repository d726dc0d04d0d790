"""The pages of a run: an index of all studies, the ledger, and each notebook as it was executed.

A page is one file with relative links and needs nothing from the network. The texts around the
results are in ``templates/``.
"""

import re
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
    ledger = _ledger(folder)
    if ledger is not None:
        write_text(folder / "ledger.html", _filled("ledger.html", ledger=ledger))
    text = _filled("index.html", cards=cards, ledger=ledger, formats=FORMATS)
    write_text(folder / "index.html", text)


def notebook_page(notebook, title, *, figures):
    """Return an executed notebook as a page.

    Parameters
    ----------
    notebook : NotebookNode
    title : str
    figures : dict
        Of the run record; what is seen in a figure becomes the text in place of the picture.
    """
    from nbconvert import HTMLExporter
    from pygments.formatters import HtmlFormatter

    for cell in notebook.cells:
        names = [name for name in SAVED_FIGURE.findall(cell.source) if name in figures]
        seen = ". ".join(figures[name]["seen"] for name in names)
        cell.metadata["alt"] = seen or f"Figure of {title}"
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
        "seen": record.get("figures", {}).get(figure, {}),
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

    return {"counts": summary(rows), "rows": [_shown(row) for row in rows.to_dict("records")]}


def _shown(row):
    """What the ledger's page shows of a row."""
    ours, low, high = (f"{row[name]:.4g}" for name in ("ours", "ours_low", "ours_high"))
    interval = "" if low == "nan" or high == "nan" else f" ({low} to {high})"
    return {
        **{name: row[name] for name in ("source", "role", "kind", "study", "verdict", "note")},
        "printed number": f"{row['table']}: {row['cell']}",
        "printed": f"{row['printed']} {row['unit']}",
        "ours": "" if ours == "nan" else ours + interval,
    }
