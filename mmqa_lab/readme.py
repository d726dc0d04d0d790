"""The part of the README that a program writes: the studies' answers with their numbers.

It stands between ``<!-- NAME -->`` and ``<!-- end NAME -->``; nothing there is typed.
"""

import json
import re
from pathlib import Path

from mmqa_lab.headless import read_outcome
from mmqa_lab.studies.catalogue import STUDIES

KEY_FIGURE = "anisotropy/patterns.png"
"""Of a run's results: what the README shows first."""

HEAD = "| study | question | answer | source |\n|---|---|---|---|\n"


def studies_table(folder):
    """Return the table of the studies with the answers of their last full runs.

    Parameters
    ----------
    folder : path
        Of all results.

    Returns
    -------
    str
        Markdown.

    Raises
    ------
    ValueError
        If a study has no full run whose claims all hold.

    Examples
    --------
    >>> studies_table("nowhere")
    Traceback (most recent call last):
    ValueError: Invalid results of chart_tables. Must be of a full run that succeeded.
    """
    return HEAD + "\n".join(_row(study, Path(folder) / study.stem) for study in STUDIES)


def replaced(text, name, content):
    """Return a text with another content between the marks of a name.

    Parameters
    ----------
    text : str
    name : str
        Of the marks: ``<!-- name -->`` and ``<!-- end name -->``.
    content : str

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the marks are missing.

    Examples
    --------
    >>> print(replaced("a\\n<!-- x -->\\nold\\n<!-- end x -->\\nb", "x", "new"))
    a
    <!-- x -->
    new
    <!-- end x -->
    b
    """
    start, end = f"<!-- {name} -->", f"<!-- end {name} -->"
    if not 0 <= text.find(start) < text.find(end):
        raise ValueError(f"Invalid README: no marks {start} and {end}. Must have both, in order.")
    head, rest = text.split(start, 1)
    return f"{head}{start}\n{content}\n{end}{rest.split(end, 1)[1]}"


def masked(text):
    """Return a text with # for every number: what stays the same from run to run.

    Parameters
    ----------
    text : str

    Returns
    -------
    str

    Examples
    --------
    >>> masked("f = 3.26, not -1,200")
    'f = #, not #'
    """
    return re.sub(r"[-−]?\d[\d,.]*\d|[-−]?\d", "#", text)


def _row(study, folder):
    """One study's row."""
    outcome = read_outcome(folder)
    if outcome is None or outcome.quick or not outcome.ok:
        raise ValueError(f"Invalid results of {study.stem}. Must be of a full run that succeeded.")
    answer = json.loads((folder / "run.json").read_text(encoding="utf-8"))["answer"]["sentence"]
    name = f"[{study.number:02d} {study.title}](notebooks/{study.notebook}.ipynb)"
    source = re.sub(r"doi:(\S+\w)", r"[doi:\1](https://doi.org/\1)", study.source)
    source = re.sub(r"(hal-\d+)", r"[\1](https://hal.science/\1)", source)
    return f"| {name} | {study.question} | {answer} | {source} |"
