"""The pages of a run: the index of all studies, the ledger, and each executed notebook.

A page is one file with relative links and needs no network. The texts around the results are in
``templates/``. A site has the stored notebooks in place of those of a run.
"""

import ast
import base64
import functools
import hashlib
import re
import shutil
from datetime import datetime
from html import escape
from pathlib import Path

import pandas as pd
from jinja2 import Environment, FileSystemLoader
from latex2mathml.converter import convert

import mmqa_lab
from mmqa_lab import __version__
from mmqa_lab._results import digits, printed
from mmqa_lab.io import write_atomically
from mmqa_lab.published import ledger
from mmqa_lab.run.results import read_record, verdict
from mmqa_lab.studies import SIZES, notebooks_folder

__all__ = [
    "ANSWERS", "LEDGER", "LEDGER_COLUMNS", "TEMPLATES", "filled", "notebook_page", "public_names",
    "stored_answers", "write_ledger", "write_pages", "write_report", "write_site", "write_words",
]  # fmt: skip

TEMPLATES = Path(__file__).parent / "templates"

# A formula on a line of its own, or within a text.
FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$])\$(?![\s$])([^$]+?)(?<![\s\\])\$", re.DOTALL)

# What a figure shows, as its cell says, and the headings of a text.
CAPTION = re.compile(r'\bseen="([^"]+)"')
HEADLINE = re.compile(r"^#+ +(.+)", re.MULTILINE)

# File of the stored answers in the folder of the notebooks, see :mod:`mmqa_lab.run.notebooks`.
ANSWERS = "answers.csv"

# File of the stored ledger there.
LEDGER = "ledger.csv"

# The looks of a notebook's page, which a site keeps in one file.
STYLES = re.compile(r"<style.*?</style>", re.DOTALL)

# The names that a module offers.
OFFERED = re.compile(r"^__all__ \+?= \[(.+?)\]", re.DOTALL | re.MULTILINE)

# Columns of the ledger page.
LEDGER_COLUMNS = ["source", "table", "cell", "role", "printed", "ours", "kind", "study", "note"]


def write_pages(folder, studies):
    """Write ``index.html``, ``glossary.html``, ``api.html`` and, of studies, ``ledger.html``.

    Parameters
    ----------
    folder : path
        The folder of all results.
    studies : list of mmqa_lab.studies.Study
        Studies that were never run are left out.
    """
    folder, stored = Path(folder), stored_answers(notebooks_folder())
    records = [(study, read_record(folder / study.stem)) for study in studies]
    ran = [(study, record) for study, record in records if "failure" in record]
    quick = any(record.get("size") == "quick" for _, record in ran)
    missing = [study for study in studies if not (folder / study.stem / "ledger.csv").is_file()]
    counts, not_run = "", [table for study in missing for table in study.tables]
    if len(missing) < len(studies):
        rows = ledger.collect(folder, not_run=not_run)
        counts = write_ledger(folder / "ledger.html", rows, quick)
    write_words(folder)
    shown = {"ran": ran, "stored": stored, "quick": quick, "counts": counts}
    shown |= {"verdict": verdict, "sizes": SIZES}
    write_atomically(folder / "index.html", filled("index.html", **shown))


def stored_answers(notebooks):
    """Return the answers of the last stored run, short and long, by the stems of their studies."""
    file = Path(notebooks) / ANSWERS
    if not file.is_file():
        return {}
    rows = pd.read_csv(file).set_index("study")
    rows = rows if "short" in rows else rows.assign(short=rows["answer"])
    return {study: (row.short, row.answer) for study, row in rows.iterrows()}


def write_words(folder):
    """Write the pages of the field's words and of the package's names."""
    tables = {"glossary": pd.read_csv(TEMPLATES / "glossary.csv"), "api": public_names()}
    for name, table in tables.items():
        page = filled(f"{name}.html", table=table.to_html(index=False, border=0))
        write_atomically(Path(folder) / f"{name}.html", page)


def write_ledger(path, rows, quick=False):
    """Write the page of a ledger; return its counts of verdicts as HTML, empty of a quick run.

    Parameters
    ----------
    path : path
    rows : DataFrame
        Of :func:`mmqa_lab.published.ledger.collect`.
    quick : bool
        Leave the verdicts out.
    """
    counts = ledger.summary(rows).rename_axis(columns=None).reset_index()
    counts = "" if quick else counts.to_html(index=False, border=0)
    ours, low, high = (rows[name].map(digits) for name in ("ours", "ours_low", "ours_high"))
    ours = ours + " (" + low + " to " + high + ")"
    ours = ours.str.replace(r" \(.*nan.*\)|nan", "", regex=True)
    rows = rows.assign(printed=rows["printed"] + " " + rows["unit"], ours=ours)
    decided = rows[rows["decides"] & (rows["role"] == "result")]
    zeros = int(((decided["verdict"] == "reproduced") & (decided["value"] == 0)).sum())
    shown = rows[LEDGER_COLUMNS if quick else ["verdict", *LEDGER_COLUMNS]].to_html(
        index=False, border=0
    )
    shown = shown.replace("<table ", '<table tabindex="0" ', 1)  # for those who scroll by keys
    page = filled("ledger.html", counts=counts, zeros=zeros, table=shown)
    write_atomically(path, page)
    return counts


def notebook_page(notebook, title, *, above=()):
    """Return an executed notebook as a page without the code that keeps books or only draws.

    Of cells that JupyterLab folds the page has the code of solutions alone. The notebook's own
    texts and tags change.

    Parameters
    ----------
    notebook : NotebookNode
    title : str
    above : sequence of str
        Paragraphs in Markdown above the notebook.
    """
    from nbconvert import HTMLExporter
    from nbconvert.preprocessors import TagRemovePreprocessor
    from nbformat.v4 import new_markdown_cell

    heading = title
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            heading = [heading, *HEADLINE.findall(cell.source)][-1]
            cell.source = FORMULA.sub(_mathml, cell.source)
        tags = cell.metadata.setdefault("tags", [])
        if cell.metadata.get("jupyter", {}).get("source_hidden") and "solution" not in tags:
            tags.append("folded")
        seen = CAPTION.findall(cell.source)
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                _name_picture(output, seen.pop(0) if seen else f"Figure, {heading}")
    notebook.cells.insert(0, new_markdown_cell("\n\n".join([filled("notebook.html"), *above])))
    notebook.metadata["title"] = title
    folded = TagRemovePreprocessor(remove_input_tags={"folded"})
    body, _ = HTMLExporter(preprocessors=[folded]).from_notebook_node(notebook)
    return re.sub(r"(?s)<script.*?</script>", "", body)  # they would ask the network


def _name_picture(output, text):
    """Let the picture of an output have a text for readers who do not see it."""
    picture = output["data"]["image/png"].replace("\n", "")
    html = f'<img alt="{escape(text)}" src="data:image/png;base64,{picture}">'
    output["data"] = {"text/html": html}


def _mathml(formula):
    """A LaTeX formula as MathML, which browsers show without a script."""
    return convert(formula[1] or formula[2], display="block" if formula[1] else "inline")


def write_report(path, *, title, sentences=(), tables=(), figures=(), files=()):
    """Write a report page: sentences, tables, figures, and the SHA-256 of the files read.

    Parameters
    ----------
    path : path
        The HTML file. It needs no network and can be printed.
    title : str
    sentences : sequence of str
        Findings and remarks.
    tables : dict of str to DataFrame
        Tables by heading.
    figures : dict of str to path
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
    contents = {caption: Path(file).read_bytes() for caption, file in dict(figures).items()}
    pictures = {caption: base64.b64encode(png).decode() for caption, png in contents.items()}
    tables, files = dict(tables), map(Path, files)
    rows = [(str(file.resolve()), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files]
    if rows:
        tables["Files"] = pd.DataFrame(rows, columns=["file", "SHA-256"])
    style = {"index": False, "border": 0, "na_rep": ""}
    rows = {heading: printed(table).to_html(**style) for heading, table in tables.items()}
    whole = {"title": title, "sentences": sentences, "tables": rows, "pictures": pictures}
    whole |= {"date": f"{datetime.now():%Y-%m-%d %H:%M}", "version": __version__}
    write_atomically(path, filled("report.html", **whole))


def filled(name, **values):
    """Return the text of a template in ``templates/`` with values filled in."""
    choices = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(loader=FileSystemLoader(TEMPLATES), **choices)
    return environment.get_template(name).render(**values)


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
    import nbformat

    folder, notebooks = Path(folder), Path(notebooks)
    for study in studies:
        notebook = nbformat.read(study.path, as_version=4)
        page = notebook_page(notebook, study.title, above=["[Home](index.html)"])
        styles = "\n".join(STYLES.findall(page))
        looks = '<link rel="stylesheet" href="notebook.css"></head>'
        page = STYLES.sub("", page).replace("</head>", looks)
        page = re.sub(r'href="(\d\d_\w+)\.ipynb', r'href="\1.html', page)
        page = re.sub(r'href="[^"]*/glossary\.csv', 'href="glossary.html', page)
        page = re.sub(r"<a href=.results/[^>]*>(.*?)</a>", r"\1", page)  # a run's, not kept here
        write_atomically(folder / f"{study.notebook}.html", page)
    write_atomically(folder / "notebook.css", re.sub(r"</?style[^>]*>", "", styles))
    pictures = sorted(notebooks.glob("thumbnails/*.png"))
    for picture in pictures:
        copy = functools.partial(shutil.copyfile, picture)
        write_atomically(folder / "thumbnails" / picture.name, copy)
    write_words(folder)
    stored = notebooks / LEDGER
    if stored.is_file():
        rows = pd.read_csv(stored, dtype={"printed": str})
        texts = rows.select_dtypes(exclude=["number", "bool"]).columns
        rows[texts] = rows[texts].fillna("")
        write_ledger(folder / "ledger.html", rows)
    shown = {"answers": stored_answers(notebooks), "ledger": stored.is_file(), "studies": studies}
    shown |= {"thumbnails": {picture.stem for picture in pictures}, "version": __version__}
    write_atomically(folder / "index.html", filled("site.html", **shown))
    return folder / "index.html"


def public_names() -> pd.DataFrame:
    """Return the public names of the package, in the order of its rooms.

    They are read from the source, so nothing is imported. A room's names are those of ``__all__``
    in its module, or in the modules of its folder.

    Returns
    -------
    DataFrame of str
        ``module``, ``name`` and ``purpose``, the first sentence of the docstring.

    Examples
    --------
    >>> names = public_names()
    >>> names[names["name"] == "fit_plane"].values.tolist()[0][:2]
    ['mmqa_lab.planes', 'fit_plane']
    """
    rooms = re.findall(r"^- ``(\w+)``: ", mmqa_lab.__doc__, re.MULTILINE)
    package, rows = TEMPLATES.parents[1], []
    for room in rooms:
        folder = package / room
        for file in sorted(folder.rglob("*.py")) if folder.is_dir() else [package / f"{room}.py"]:
            parts = file.relative_to(package.parent).with_suffix("").parts
            module = ".".join(parts).removesuffix(".__init__")
            if not any(part.startswith("_") for part in module.split(".")):
                rows += [(module, *row) for row in _names_of(file)]
    return pd.DataFrame(rows, columns=["module", "name", "purpose"])


def _names_of(file):
    """The names that a file defines and offers, with their first sentences."""
    source = file.read_text(encoding="utf-8")
    offered = set(re.findall(r"\w+", " ".join(OFFERED.findall(source))))
    for node in ast.parse(source).body:
        if getattr(node, "name", None) in offered:
            text = " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
            text = re.sub(r":\w+:`~?([^`]*)`|``", lambda found: found[1] or "", text)
            yield node.name, re.split(r"(?<=[.;])\s", text)[0].rstrip(";")
