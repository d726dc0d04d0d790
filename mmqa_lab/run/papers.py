"""A paper whose numbers, tables and figures come from runs: a skeleton of it, and its PDF."""

from __future__ import annotations

import os
import re
import shutil
from functools import partial
from pathlib import Path

import matplotlib
import pandas as pd

from mmqa_lab._checks import check_file, needs, refuse
from mmqa_lab.bench import heading
from mmqa_lab.io import write_atomically
from mmqa_lab.run.pages import TEMPLATES
from mmqa_lab.run.quotes import escaped, quoted_name
from mmqa_lab.run.results import read_record
from mmqa_lab.studies import Study

__all__ = ["RUNS", "make_paper", "new_paper", "quoted_files"]

RUNS = "from_runs"
"""Folder of a paper with the files of runs that it quotes, by study."""

# How a paper names files of runs: as a figure or table of lab.typ, or by their path.
CALLED = re.compile(r'#(fig|tab)\(\s*"(\w+)",\s*"([\w-]+)"')
NAMED = re.compile(rf"{RUNS}/(\w+)/([\w.-]+)")

# Most columns of a table in a skeleton: more do not fit between the margins.
MOST_COLUMNS = 6

# Figures that are wider go over both columns.
WIDE_PT = 260

# Sources by words of a study's source.
SOURCES = {
    "Pfeifer": "pfeifer2021",
    "Poreba": "poreba2013",
    "Cahalane": "cahalane2014",
    "mobile laser scanning": "eurosdr2013_mls",
    "image radiometry": "eurosdr2013_radiometry",
}


def make_paper(folder: str | os.PathLike, results: str | os.PathLike) -> Path:
    """Make ``paper.pdf`` of ``paper.typ`` in a folder.

    Parameters
    ----------
    folder : path
        Has ``paper.typ`` and, in ``from_runs/``, the files of runs that it quotes.
    results : path
        Folder of results. What a run to its end has written there replaces the kept files first;
        runs that are not there leave the kept ones.

    Returns
    -------
    Path
        The PDF.

    Raises
    ------
    FileNotFoundError
        If there is no ``paper.typ``, or a file that it quotes is in no run.
    ImportError
        If typst is not installed.
    ValueError
        If the text is no Typst.
    """
    typst = needs("paper", "typst")
    source = check_file(Path(folder) / "paper.typ", "paper")
    _bring(source, Path(results))
    fonts = Path(matplotlib.get_data_path()) / "fonts/ttf"  # of the letters in figures
    target = source.with_suffix(".pdf")
    try:
        content = typst.compile(str(source), font_paths=[str(fonts)])
    except RuntimeError as error:  # what typst raises
        said = str(error).splitlines()[0].removeprefix("error: ")
        raise ValueError(f"Invalid paper {source}: {said}. Must be Typst.") from error
    write_atomically(target, lambda path: path.write_bytes(content))
    return target


def quoted_files(text: str) -> list[tuple[str, str]]:
    """Return study and name of the files of runs that a paper's text quotes.

    Examples
    --------
    >>> quoted_files('#fig("mimic", "walls") and from_runs/mimic/values.typ')
    [('mimic', 'captions.csv'), ('mimic', 'values.typ'), ('mimic', 'walls.svg')]
    """
    found = set(NAMED.findall(text))
    for kind, study, name in CALLED.findall(text):
        found |= {(study, f"{name}.csv")} if kind == "tab" else {(study, f"{name}.svg")}
        found |= {(study, "captions.csv")} if kind == "fig" else set()
    return sorted(found)


def _bring(source, results):
    """Bring the files that a paper quotes from runs to its folder; those of no run stay."""
    for study, name in quoted_files(source.read_text(encoding="utf-8")):
        fresh, kept = results / study / name, source.parent / RUNS / study / name
        if read_record(fresh.parent).get("failure", "no run") == "" and fresh.is_file():
            brought = partial(shutil.copyfile, fresh)
            if fresh.suffix == ".csv":  # six digits: a paper and its folder stay small
                brought = pd.read_csv(fresh).to_csv(index=False, float_format="%.6g")
            write_atomically(kept, brought)
        if not kept.is_file():
            what = f"Invalid paper {source}: {name} of the study {study} is not there. Must be in "
            raise FileNotFoundError(f"{what}{results / study}, as after mmqa studies {study}.")


def new_paper(
    folder: str | os.PathLike, study: Study, results: str | os.PathLike, *, latex: bool = False
) -> Path:
    """Lay a skeleton of a paper on a study: its question, values, figures, tables, sources.

    Parameters
    ----------
    folder : path
        A new or empty folder.
    study : mmqa_lab.studies.Study
    results : path
        Folder of results with a run of the study.
    latex : bool
        For LaTeX in place of Typst.

    Returns
    -------
    Path
        ``paper.typ`` or ``paper.tex``.

    Raises
    ------
    FileNotFoundError
        If the study has no run to its end there.
    ValueError
        If the folder has files.
    """
    folder, ran = Path(folder), Path(results) / study.stem
    refuse(folder.exists() and any(folder.iterdir()), f"folder {folder}", "not empty", "new")
    record = read_record(ran)
    if record.get("failure", "no run") != "":
        must = f"Must have one, as after mmqa studies {study.stem}."
        raise FileNotFoundError(f"Invalid results {ran}: no run to its end. {must}")
    write = _latex_parts if latex else _typst_parts
    target = folder / ("paper.tex" if latex else "paper.typ")
    write_atomically(target, "\n".join(write(study, record, ran)))
    for name in ("references.bib", *([] if latex else ["lab.typ"])):
        write_atomically(folder / name, partial(shutil.copyfile, TEMPLATES / "paper" / name))
    _bring(target, Path(results))
    return target


def _values(study, ran):
    """Words and quoted names of the values of a run."""
    file = ran / "values.csv"
    for row in pd.read_csv(file).itertuples() if file.is_file() else ():
        yield heading(row.name), quoted_name(study.stem, row.name)


def _tables(record):
    """Names of the tables of a run that are short enough for a page."""
    names = [name.removesuffix(".tex") for name in record["files"] if name.endswith(".tex")]
    return [name for name in names if name != "values"]


def _figures(record, ran):
    """Names and captions of the figures of a run, and whether they are wider than a column."""
    for name, caption in record["figures"].items():
        if name != record["answer"]["thumbnail"] or name == record["answer"]["figure"]:
            head = (ran / f"{name}.svg").read_text(encoding="utf-8")[:1000]
            yield name, caption, float(re.search(r'width="([\d.]+)pt"', head)[1]) > WIDE_PT


def _sources(study):
    """Keys of a study's sources in references.bib."""
    return [key for words, key in SOURCES.items() if words in study.source] or [*SOURCES.values()]


def _typst_parts(study, record, ran):
    """The lines of a skeleton in Typst."""
    yield '#import "lab.typ": fig, paper, stated, tab'
    yield f'#import "{RUNS}/{study.stem}/values.typ": *\n'
    yield f'#show: paper.with(title: "{study.title}", abstract: [{study.question}])\n'
    cited = " ".join(f"@{key}" for key in _sources(study))
    yield f"= Introduction\n\n{study.question} The study follows {cited}.\n"
    yield "= Results\n\nThe values of the run, to be quoted by their names:\n"
    for words, name in _values(study, ran):
        yield f'- #"{words}": #{name}'
    for name, _, is_wide in _figures(record, ran):
        wide = ", wide: true" if is_wide else ""
        yield f'\n#fig("{study.stem}", "{name}"{wide}) <fig-{name}>'
    for name in _tables(record):
        columns = [one for one in pd.read_csv(ran / f"{name}.csv", nrows=1) if one != "kind"]
        heads = ", ".join(f'"{one}": "{heading(one)}"' for one in columns[:MOST_COLUMNS])
        wide = ", wide: true" if len(columns) > MOST_COLUMNS // 2 else ""
        yield f'\n#tab("{study.stem}", "{name}", columns: ({heads}){wide}) <tab-{name}>'
    yield '\n#bibliography("references.bib")\n'


def _latex_parts(study, record, ran):
    """The lines of a skeleton in LaTeX."""
    values = f"\\input{{{RUNS}/{study.stem}/values.tex}}"
    yield f"\\documentclass[twocolumn]{{article}}\n\\usepackage{{booktabs,graphicx}}\n{values}"
    yield f"\\title{{{study.title}}}\n\\begin{{document}}\n\\maketitle"
    yield f"\\begin{{abstract}}\n{study.question}\n\\end{{abstract}}"
    yield f"\\section{{Introduction}}\nThe study follows \\cite{{{','.join(_sources(study))}}}."
    yield "\\section{Results}\nThe values of the run, to be quoted by their names:"
    yield "\\begin{itemize}"
    for words, name in _values(study, ran):
        yield f"\\item {escaped(words)}: \\{name}"
    yield "\\end{itemize}"
    for name, caption, is_wide in _figures(record, ran):
        star = "*" if is_wide else ""
        picture = f"\\includegraphics[width=\\linewidth]{{{RUNS}/{study.stem}/{name}.pdf}}"
        said = f"\\caption{{{escaped(caption)}}}"
        yield f"\\begin{{figure{star}}}\n{picture}\n{said}\n\\end{{figure{star}}}"
    for name in _tables(record):
        yield f"\\input{{{RUNS}/{study.stem}/{name}.tex}}"
    yield "\\bibliographystyle{plain}\n\\bibliography{references}\n\\end{document}\n"
