"""The form of the notebooks: short cells and paragraphs, bookkeeping apart, figures with words."""

import ast
import re

import nbformat
import pytest

from mmqa_lab.studies import STUDIES, TOOLS

DONE = {
    "chart_tables", "repeatability", "anisotropy", "lhd_weight", "mimic", "test_field",
    "image_resolution", "chart_images", "specifications", "image_radiometry", "fitness",
    "metric_cards", "poles", "your_own_cloud",
}  # fmt: skip
"""Stems of the notebooks that have this form."""

LINES, WIDTH, WORDS = 25, 100, 120
"""Most lines of a cell, characters of a line of code, and words of a paragraph."""

ALL = [study for study in (*TOOLS, *STUDIES) if study.stem in DONE]


def keeps_books(call):
    """Whether a call writes results: ``run.`` followed by anything."""
    return isinstance(call.func, ast.Attribute) and getattr(call.func.value, "id", "") == "run"


def calls_in(source, *, at_once=False):
    """The calls of a cell; ``at_once`` leaves out those of functions, which buttons call."""
    tree = ast.parse(re.sub(r"^%.*$", "", source, flags=re.MULTILINE))
    if at_once:
        tree.body = [node for node in tree.body if not isinstance(node, ast.FunctionDef)]
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def faults(notebook):
    """A sentence for each place of a notebook that has not the form."""
    for cell in notebook.cells:
        here = cell.source.splitlines()[0][:50]
        if cell.cell_type == "markdown":
            blocks = re.split(r"\n\s*\n|\n\s*(?=[-|]|\d+\. )", cell.source)
            longest = max(blocks, key=lambda block: len(block.split()))
            if len(longest.split()) > WORDS:
                yield f"{here}: a paragraph of {len(longest.split())} words"
            continue
        lines = cell.source.splitlines()
        if len(lines) > LINES:
            yield f"{here}: {len(lines)} lines"
        yield from (f"{here}: wide: {line}" for line in lines if len(line) > WIDTH)
        books = [call for call in calls_in(cell.source, at_once=True) if keeps_books(call)]
        folded = cell.metadata.get("jupyter", {}).get("source_hidden", False)
        results = "results" in cell.metadata.get("tags", [])
        if bool(books) != results or folded < results:
            yield f"{here}: bookkeeping has cells of its own, tagged results and folded"
        for call in books:
            given = {one.arg: one.value for one in call.keywords}
            if call.func.attr == "save_figure":
                seen = ast.unparse(given.get("seen", ast.Constant("")))
                if len(seen.split()) < 8 or not seen.rstrip("'\")").endswith("."):
                    yield f"{here}: {ast.unparse(call.args[1])} has no caption"


@pytest.mark.parametrize("study", ALL, ids=lambda study: study.stem)
def test_one_idea_a_cell_and_a_sentence_for_each_figure(study):
    assert list(faults(nbformat.read(study.path, as_version=4))) == []


def test_what_has_not_the_form_is_found():
    code = nbformat.v4.new_code_cell
    long = nbformat.v4.new_markdown_cell("word " * 121)
    cells = [long, code("a = 1\n" * 26), code("a = " + "1" * 97), code("run.check(1)")]
    cells.append(code('run.save_figure(figure, "f", seen="Points.")'))
    cells[-1].metadata = {"tags": ["results"], "jupyter": {"source_hidden": True}}
    found = list(faults(nbformat.v4.new_notebook(cells=cells)))
    assert len(found) == len(cells)
