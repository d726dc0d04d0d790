"""The pages of a run: the index of all studies, the ledger, and each executed notebook.

A page is one file with relative links and needs no network. The texts around the results are in
``templates/``.
"""

import base64
import copy
import hashlib
import html
import io
import json
import re
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.font_manager import FontProperties

from mmqa_lab import __version__
from mmqa_lab.io import write_atomically
from mmqa_lab.run import FORMATS, four_digits, read_record
from mmqa_lab.studies import notebooks_folder

OUTCOME = "outcome.json"

TEMPLATES = Path(__file__).parent / "templates"

FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$])\$(?![\s$])([^$]+?)(?<![\s\\])\$", re.DOTALL)
"""A formula on a line of its own, or within a text."""

FORMULA_PT = 12.5

HEADING = re.compile(r"^#+ (.+)", re.MULTILINE)

WIDGET = "application/vnd.jupyter.widget-view+json"
"""Type of an output that needs a running kernel."""

SAVED_FIGURE = re.compile(r"""save_figure\(\s*\w+,\s*["'](\w+)["']""")

SENTENCE = re.compile(r"<td>(?!NaN<)(?=[^<]*[A-Za-z]{3})")
"""Begins a table cell with words. Words are aligned left, numbers right."""

ANSWERS = "answers.csv"
"""File of the stored answers in the folder of the notebooks, see :mod:`mmqa_lab.run.store`."""

UNFINISHED = "stopped before its end"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run of a study: finished, failed or stopped before its end."""

    study: str
    quick: bool
    seconds: float = 0.0
    failure: str = UNFINISHED
    checks: int = 0
    passed: int = 0

    @property
    def ok(self):
        """Whether every cell ran."""
        return not self.failure

    @property
    def true(self):
        """Whether all checks passed."""
        return self.passed == self.checks

    @property
    def verdict(self):
        """The count of passed checks, or the failure."""
        return self.failure or f"{self.passed} of {self.checks} checks passed"


def read_outcome(folder):
    """Return the outcome of the last run in a study's folder, or None."""
    file = Path(folder) / OUTCOME
    return Outcome(**json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else None


def write_pages(folder, studies):
    """Write ``index.html``, ``glossary.html`` and, if a study has a ledger, ``ledger.html``.

    Parameters
    ----------
    folder : path
        The folder of all results.
    studies : list of mmqa_lab.studies.Study
        Studies that were never run are left out.
    """
    folder, file = Path(folder), notebooks_folder() / ANSWERS
    stored = dict(pd.read_csv(file).to_numpy()) if file.is_file() else {}
    ran = [study for study in studies if read_outcome(folder / study.stem) is not None]
    cards = [_card(study, folder / study.stem, stored.get(study.stem, "")) for study in ran]
    ledger = _ledger(folder, studies)
    if ledger is not None:
        write_atomically(folder / "ledger.html", filled("ledger.html", ledger=ledger))
    write_atomically(folder / "glossary.html", filled("glossary.html", rows=glossary_rows()))
    shown = {"cards": cards, "ledger": ledger, "formats": FORMATS}
    write_atomically(folder / "index.html", filled("index.html", **shown))


def glossary_rows():
    """Return the glossary, a list of dicts: english, german, meaning, studies (stems)."""
    return pd.read_csv(TEMPLATES / "glossary.csv", keep_default_na=False).to_dict("records")


def notebook_page(notebook, title, *, figures, failure="", alone=False, quick=False):
    """Return an executed notebook as a page.

    Parameters
    ----------
    notebook : NotebookNode
    title : str
    figures : dict
        The figures of the run record; their captions become the alternative texts.
    failure : str
        The reason why the run stopped. The page begins with it and links to the failed cell.
    alone : bool
        Leave out the link to the index of all studies.
    quick : bool
        State on the page that the parameters are small.
    """
    from nbconvert import HTMLExporter
    from pygments.formatters import HtmlFormatter

    notebook, place = copy.deepcopy(notebook), title
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            place = (HEADING.findall(cell.source) or [place])[-1]
            cell.source = FORMULA.sub(_typeset, cell.source)
            continue
        names = [name for name in SAVED_FIGURE.findall(cell.source) if name in figures]
        seen = ". ".join(figures[name]["seen"] for name in names)
        cell.metadata["alt"] = seen or f"What the section {place} draws"
        cell.outputs = [one for one in cell.get("outputs", []) if WIDGET not in one.get("data", ())]
    exporter = HTMLExporter(
        template_name="study", extra_template_basedirs=[str(TEMPLATES)], embed_images=True
    )
    body, _ = exporter.from_notebook_node(notebook)
    style = HtmlFormatter(style="default").get_style_defs(".highlight")
    body = body.replace("<table ", '<table tabindex="0" ')  # wide tables scroll, also by keys
    if failure and 'output_error"' in body:
        body = 'output_error" id="stopped"'.join(body.rsplit('output_error"', 1))
    body = SENTENCE.sub('<td class="text">', body)
    shown = {"body": body, "style": style, "failure": failure, "alone": alone, "quick": quick}
    return filled("notebook.html", title=title, **shown)


def _typeset(found):
    """A LaTeX formula as a picture, with its source as alternative text."""
    from matplotlib import mathtext

    formula, picture = (found[1] or found[2]).replace("\n", " "), io.BytesIO()
    formula = re.sub(r"\\[lr]vert(?![a-z])", "|", formula)  # mathtext lacks these commands
    size = FORMULA_PT * (1.2 if found[1] else 1)
    font = FontProperties(size=size)
    with mpl.rc_context({"mathtext.fontset": "cm", "svg.fonttype": "path"}):
        try:
            depth = mathtext.math_to_image(f"${formula}$", picture, prop=font, dpi=72, format="svg")
        except ValueError:
            return found[0]
    coded = base64.b64encode(picture.getvalue()).decode()
    height = float(re.search(rb'height="([\d.]+)pt"', picture.getvalue())[1])
    in_em = (one / FORMULA_PT for one in (height, depth))  # as large as the text around it
    place = "height: {:.2f}em; vertical-align: -{:.2f}em".format(*in_em)
    text = html.escape(formula, quote=True)
    image = f'<img src="data:image/svg+xml;base64,{coded}" alt="{text}" style="{place}">'
    return f'<p style="text-align: center">{image}</p>' if found[1] else image


def write_report(path, *, title, sentences=(), tables=None, figures=None, files=()):
    """Write a report page: sentences, tables, figures, and the SHA-256 of the files read.

    Parameters
    ----------
    path : path
        The HTML file. It needs no network and can be printed.
    title : str
    sentences : sequence of str
        Findings and remarks.
    tables : dict of str to DataFrame, optional
        Tables by heading.
    figures : dict of str to path, optional
        Figures as PNG by caption.
    files : sequence of path
        The files that were read.

    Examples
    --------
    >>> import tempfile
    >>> page = Path(tempfile.mkdtemp()) / "report.html"
    >>> write_report(page, title="A wall", tables={"Figures": pd.DataFrame({"f": [3.2]})})
    >>> "<h2>Figures</h2>" in page.read_text()
    True
    """
    pictures = {
        caption: base64.b64encode(Path(file).read_bytes()).decode()
        for caption, file in (figures or {}).items()
    }
    rows = {
        heading: table.to_html(index=False, border=0, na_rep="", float_format=four_digits)
        for heading, table in (tables or {}).items()
    }
    hashes = {
        Path(file).name: hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in files
    }
    whole = {"title": title, "sentences": sentences, "tables": rows, "pictures": pictures}
    write_atomically(path, filled("report.html", **whole, files=hashes, version=__version__))


def filled(name, **values):
    """Return the text of a template in ``templates/`` with values filled in."""
    from jinja2 import Environment, FileSystemLoader

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template(name).render(**values)


def _card(study, folder, stored):
    """The entry of a study on the index page, from the files of its run."""
    record, outcome, file = read_record(folder), read_outcome(folder), folder / "checks.csv"
    checks = pd.read_csv(file, keep_default_na=False) if file.is_file() else pd.DataFrame()
    figures, answer = record.get("figures", {}), record.get("answer", {})
    shown = answer.get("figure") or next(reversed(figures), "")  # if no answer was saved
    return {
        "study": study,
        "outcome": outcome,
        "stored": stored if outcome.quick else "",
        "page": (folder / f"{study.stem}.html").is_file(),
        "record": record,
        "answer": answer.get("sentence", ""),
        "figure": shown,
        "seen": figures.get(shown, {}),
        "figures": list(figures),
        "tables": [name for name in record.get("files", []) if name.endswith(".csv")],
        "checks": checks.to_dict("records"),
    }


def _ledger(folder, studies):
    """The ledger of the studies' results; None without a ledger file."""
    if not any(folder.glob("*/ledger.csv")):
        return None
    from mmqa_lab.published import ledger

    missing = [one for one in studies if not (folder / one.stem / "ledger.csv").is_file()]
    rows = ledger.collect(folder, not_run=[table for one in missing for table in one.tables])
    outcomes = [read_outcome(folder / study.stem) for study in studies]
    quick = any(one is not None and one.quick for one in outcomes)
    shown = [_shown(row) for row in rows.to_dict("records")]
    return {"counts": ledger.summary(rows), "rows": shown, "quick": quick}


def _shown(row):
    """A row of the ledger with its numbers as texts."""
    ours, low, high = (four_digits(row[name]) for name in ("ours", "ours_low", "ours_high"))
    interval = "" if "nan" in (low, high) else f" ({low} to {high})"
    return row | {
        "printed number": f"{row['table']}: {row['cell']}",
        "printed": f"{row['printed']} {row['unit']}",
        "ours": "" if ours == "nan" else ours + interval,
    }
