"""A paper whose numbers, tables and figures come from runs: a skeleton of it, and its PDF."""

from __future__ import annotations

import os
import re
import shutil
from functools import partial
from pathlib import Path

import matplotlib
import pandas as pd
from jinja2 import Environment, FileSystemLoader

from mmqa_lab import published
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


def make_paper(folder: str | os.PathLike, results: str | os.PathLike) -> Path:
    """Make ``paper.pdf`` of ``paper.typ`` in a folder.

    Parameters
    ----------
    folder : path
        Has ``paper.typ`` and, in ``from_runs/``, the files of runs that it quotes.
    results : path
        Folder of results. What a full run to its end has written there replaces the kept files
        first; runs that are not there leave the kept ones.

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
        if _is_full(read_record(fresh.parent)) and fresh.is_file():
            brought = partial(shutil.copyfile, fresh)
            if fresh.suffix == ".csv":  # six digits: a paper and its folder stay small
                brought = pd.read_csv(fresh).to_csv(index=False, float_format="%.6g")
            write_atomically(kept, brought)
        if not kept.is_file():
            what = f"Invalid paper {source}: {name} of the study {study} is not there. Must be in "
            what += f"{results / study}, as after mmqa studies {study} --full."
            raise FileNotFoundError(what)


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
        Folder of results with a full run of the study.
    latex : bool
        For LaTeX in place of Typst.

    Returns
    -------
    Path
        ``paper.typ`` or ``paper.tex``.

    Raises
    ------
    FileNotFoundError
        If the study has no full run to its end there.
    ValueError
        If the folder has files.
    """
    folder, ran = Path(folder), Path(results) / study.stem
    refuse(folder.exists() and any(folder.iterdir()), f"folder {folder}", "not empty", "new")
    record = read_record(ran)
    if not _is_full(record):
        must = f"Must have one, as after mmqa studies {study.stem} --full."
        raise FileNotFoundError(f"Invalid results {ran}: no full run to its end. {must}")
    ending = "tex" if latex else "typ"
    target = folder / f"paper.{ending}"
    write_atomically(target, _skeleton(f"skeleton.{ending}", study, record, ran))
    for name in ("references.bib", *([] if latex else ["lab.typ"])):
        write_atomically(folder / name, partial(shutil.copyfile, TEMPLATES / "paper" / name))
    _bring(target, Path(results))
    return target


def _is_full(record):
    """Whether a run came to its end and is not of a smaller size, whose figures are none of print.

    >>> _is_full({"failure": "", "size": "middle"}), _is_full({"failure": "", "size": "full"})
    (False, True)
    """
    return record.get("failure", "no run") == "" and record.get("size") == "full"


def _skeleton(name, study, record, ran):
    """The text of a skeleton by its template; what is not there leaves no line."""
    marks = {"variable_start_string": "<<", "variable_end_string": ">>"}
    marks |= {"block_start_string": "<%", "block_end_string": "%>", "comment_start_string": "<!--"}
    look = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    book = Environment(loader=FileSystemLoader(TEMPLATES / "paper"), **marks, **look)
    book.filters |= {"heading": heading, "escaped": escaped}
    known = [*published._strings("sources").itertuples()]
    return book.get_template(name).render(
        study=study,
        runs=RUNS,
        most=MOST_COLUMNS,
        # keys of the study's sources in references.bib
        sources=[row.source for row in known if row.words in study.source]
        or [row.source for row in known],
        values=[*_values(study, ran)],
        figures=[*_figures(record, ran)],
        tables=[*_tables(record, ran)],
    )


def _values(study, ran):
    """Words and quoted names of the values of a run."""
    file = ran / "values.csv"
    for row in pd.read_csv(file).itertuples() if file.is_file() else ():
        yield heading(row.name), quoted_name(study.stem, row.name)


def _figures(record, ran):
    """Names and captions of the figures of a run, and whether they are wider than a column."""
    for name, caption in record["figures"].items():
        if name != record["answer"]["thumbnail"] or name == record["answer"]["figure"]:
            head = (ran / f"{name}.svg").read_text(encoding="utf-8")[:1000]
            yield name, caption, float(re.search(r'width="([\d.]+)pt"', head)[1]) > WIDE_PT


def _tables(record, ran):
    """Names and columns of the tables of a run that are short enough for a page."""
    for name in (one.removesuffix(".tex") for one in record["files"] if one.endswith(".tex")):
        if name != "values":
            columns = pd.read_csv(ran / f"{name}.csv", nrows=1).columns
            yield name, [one for one in columns if one != "kind"]
