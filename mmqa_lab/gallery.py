"""The index page of all results: key figure, claims, run record and links of every study."""

import json
from html import escape
from pathlib import Path

import pandas as pd

from mmqa_lab.headless import read_outcome
from mmqa_lab.io import write_atomically
from mmqa_lab.results import FORMATS
from mmqa_lab.studies.catalogue import STUDIES

NO_ANSWER = {"sentence": "", "figure": ""}
"""Of a run that ended before its answer."""


def write_index(folder):
    """Write ``index.html`` over the studies that have results in ``folder``.

    The page is one file with relative links; it needs no network.
    """
    folder = Path(folder)
    cards = [_card(study, folder / study.stem) for study in STUDIES]
    text = PAGE.format(cards="\n".join(card for card in cards if card))
    write_atomically(folder / "index.html", lambda path: path.write_text(text, encoding="utf-8"))


def _card(study, folder):
    """The HTML of one study, empty where it was never run."""
    outcome = read_outcome(folder)
    if outcome is None:
        return ""
    record = _record(folder)
    files, answer = record.get("files", []), record.get("answer", NO_ANSWER)
    pictures = [name for name in files if name.endswith(".png")]
    tables = [name for name in files if name.endswith(".csv")]
    return CARD.format(
        kind="ok" if outcome.ok else "failed",
        page=f"{study.stem}/{study.stem}.html",
        notebook=escape(study.notebook),
        title=escape(study.title),
        question=escape(study.question),
        source=escape(study.source),
        answer=escape(answer["sentence"]),
        verdict=escape(outcome.verdict),
        seconds=outcome.seconds,
        mode="quick run, small parameters" if outcome.quick else "full run",
        picture=_picture(study, f"{answer['figure']}.png") if answer["figure"] else "",
        claims=_claims(folder),
        figures=" · ".join(_figure_links(study, name) for name in pictures),
        tables=" · ".join(_link(study, name, name) for name in tables),
        record=_rows(record.get("parameters", {})),
        versions=_rows({"python": record.get("python", "")} | record.get("versions", {})),
        samples=_rows(record.get("samples", {})),
    )


def _link(study, file, text):
    """A link to a file of a study."""
    return f'<a href="{study.stem}/{escape(file)}">{escape(text)}</a>'


def _figure_links(study, name):
    """A figure's name with links to its formats."""
    stem = name.removesuffix(".png")
    links = " ".join(_link(study, f"{stem}.{form}", form.upper()) for form in FORMATS)
    return f"{escape(stem)} {links}"


def _rows(values):
    """Names and values as the rows of a table."""
    rows = (
        f"<tr><td>{escape(name)}<td>{escape(json.dumps(value).strip(chr(34)))}"
        for name, value in values.items()
    )
    return f"<table>{''.join(rows)}</table>"


def _record(folder):
    """The run record, empty when the run did not get that far."""
    file = folder / "run.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def _picture(study, name):
    """The figure that shows the answer."""
    return f'<img src="{study.stem}/{name}" alt="{escape(study.title)}" loading="lazy">'


def _claims(folder):
    """The claims as a list, those that do not hold marked."""
    file = folder / "claims.csv"
    if not file.is_file():
        return ""
    rows = pd.read_csv(file).fillna("")
    items = [
        f'<li class="{"ok" if row.holds else "failed"}">{escape(str(row.sentence))} '
        f"<small>{escape(str(row.obtained))}</small></li>"
        for row in rows.itertuples()
    ]
    return f"<ul>{''.join(items)}</ul>"


PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>mmqa_lab: results</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{ max-width: 64em; margin: 2em auto; padding: 0 1em; font: 16px/1.5 sans-serif; color: #222 }}
section {{ border-top: 3px solid #009E73; margin: 2em 0; padding-top: .5em }}
section.failed {{ border-color: #D55E00 }} img {{ max-width: 100%; border: 1px solid #eee }}
li.ok::marker {{ content: "✓ " }} li.failed::marker {{ content: "✗ "; color: #D55E00 }}
small, details {{ color: #555; font-size: 13px; overflow-wrap: anywhere }}
td {{ padding: 0 .8em .2em 0; vertical-align: top; overflow-wrap: anywhere }}
.answer {{ font-weight: bold }}
</style></head><body><h1>mmqa_lab: results</h1>
<p>What each study asked and what this run found. Every table says which
of its numbers are published, predicted from specifications, fitted or measured.</p>
{cards}</body></html>
"""

CARD = """<section class="{kind}"><h2><a href="{page}">{notebook}</a> {title}</h2>
<p>{question}<br><small>{source}</small></p><p class="answer">{answer}</p>{picture}
<p>{verdict} <small>{seconds} s, {mode}</small></p>{claims}
<details><summary>Figures and tables</summary><p>{figures}</p><p>{tables}</p></details>
<details><summary>Run record: parameters, versions, samples</summary>{record}{versions}{samples}
</details></section>"""
