"""What a program writes into the README: the studies' answers and the ledger's counts.

It stands between ``<!-- NAME -->`` and ``<!-- end NAME -->``; nothing there is typed.
"""

import re
from pathlib import Path

from mmqa_lab.run.notebooks import read_outcome
from mmqa_lab.run.results import read_record

KEY_FIGURE = "anisotropy/patterns.png"
"""Of a run's results: what the README shows first."""

LEDGER_FIGURE = "![Verdicts on the printed results of each source](notebooks/ledger.png)\n\n"

HEAD = "| study | question | answer | source |\n|---|---|---|---|\n"


def studies_table(folder, studies):
    """Return the table of the studies with the answers of their last full runs as Markdown.

    Raises
    ------
    ValueError
        If a study has no full run that came to its end with all checks passed.
    """
    return HEAD + "\n".join(_row(study, Path(folder) / study.stem) for study in studies)


def ledger_table(ledger):
    """Return the ledger's figure and its counts by source and verdict as Markdown."""
    from mmqa_lab.published.ledger import summary

    counts = summary(ledger)
    lines = [["source", *counts.columns], ["---"] * (1 + len(counts.columns))]
    lines += [[source, *map(str, row)] for source, *row in counts.itertuples()]
    return LEDGER_FIGURE + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ledger_figure(ledger):
    """Return a figure of the verdicts on each source's results."""
    from mmqa_lab.plots import subplots, use_style
    from mmqa_lab.published.ledger import plot

    use_style()
    figure, ax = subplots(width="double", height_mm=60)
    plot(ledger, ax)
    return figure


def replaced(text, name, content):
    """Return a text with another content between the marks of a name.

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

    Examples
    --------
    >>> masked("f = 3.26, not -1,200")
    'f = #, not #'
    """
    return re.sub(r"[-−]?\d[\d,.]*\d|[-−]?\d", "#", text)


def _row(study, folder):
    """One study's row."""
    outcome = read_outcome(folder)
    if outcome is None or outcome.quick or not (outcome.ok and outcome.true):
        raise ValueError(
            f"Invalid results of {study.stem} in {folder.parent}. Must be of a full run that came "
            "to its end with all checks passed."
        )
    answer = read_record(folder)["answer"]["sentence"]
    name = f"[{study.number:02d} {study.title}](notebooks/{study.notebook}.ipynb)"
    source = re.sub(r"doi:(\S+\w)", r"[doi:\1](https://doi.org/\1)", study.source)
    source = re.sub(r"(hal-\d+)", r"[\1](https://hal.science/\1)", source)
    return f"| {name} | {study.question} | {answer} | {source} |"
