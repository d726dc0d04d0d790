"""The form of the notebooks: short cells and paragraphs, bookkeeping apart, figures with words."""

import ast
import re

import nbformat
import pandas as pd
import pytest
from conftest import loaded, stored
from IPython.core.inputtransformer2 import TransformerManager

from mmqa_lab.run.notebooks import execute
from mmqa_lab.studies import STUDIES, TOOLS, notebooks_folder

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
        if "solution" in cell.metadata.get("tags", []) and not folded:
            yield f"{here}: a solution is folded, so that a reader may try before"
        for call in books:
            given = {one.arg: one.value for one in call.keywords}
            if call.func.attr == "save_figure":
                seen = ast.unparse(given.get("seen", ast.Constant("")))
                if len(seen.split()) < 8 or not seen.rstrip("'\")").endswith("."):
                    yield f"{here}: {ast.unparse(call.args[1])} has no caption"


@pytest.mark.parametrize("study", ALL, ids=lambda study: study.stem)
def test_one_idea_a_cell_and_a_sentence_for_each_figure(study):
    assert list(faults(nbformat.read(study.path, as_version=4))) == []


@pytest.mark.parametrize("study", ALL, ids=lambda study: study.stem)
def test_a_notebook_is_short_and_shows_no_representation(study):
    cells, between, words = nbformat.read(study.path, as_version=4).cells, 0, 0
    for cell in cells[1:]:  # the first says what the notebook is about
        if cell.cell_type == "markdown" and "lesson" not in cell.metadata.get("tags", []):
            words += len(cell.source.split())
            between += len(cell.source.split())
            assert between <= WORDS, cell.source[:50]
        between *= cell.cell_type != "code"
        texts = [out.get("data", {}) for out in cell.get("outputs", [])]
        alone = [str(d.get("text/plain")) for d in texts if len(d) == 1]
        assert not any(text.startswith(("<matplotlib", "Text(")) for text in alone)
    assert words + len(cells[0].source.split()) <= 1500


def test_the_template_has_the_form_and_runs(tmp_path):
    path = notebooks_folder() / "template/NN_template.ipynb"
    template = nbformat.read(path, as_version=4)
    assert list(faults(template)) == []
    assert execute(template, path.parent, results=tmp_path) == ""
    checks = pd.read_csv(tmp_path / "template/checks.csv")
    assert len(checks) == 2
    assert checks["passed"].all()


def test_what_has_not_the_form_is_found():
    code = nbformat.v4.new_code_cell
    long = nbformat.v4.new_markdown_cell("word " * 121)
    cells = [long, code("a = 1\n" * 26), code("a = " + "1" * 97), code("run.check(1)")]
    cells.append(code('run.save_figure(figure, "f", seen="Points.")'))
    cells[-1].metadata = {"tags": ["results"], "jupyter": {"source_hidden": True}}
    found = list(faults(nbformat.v4.new_notebook(cells=cells)))
    assert len(found) == len(cells)


SAYS_PRINT = re.compile(r"\b(print|prints|printed|published|ledger|Tables? \d)\b")
"""Words of a check that speaks of printed numbers."""

READS_PRINT = re.compile(r"\bpublished\.(?!ledger)\w+\(|\[\[?'\w*(published|printed)\w*'")
"""Code that reads printed numbers: of the package's tables, or a column of them."""

READS_VERDICT = re.compile(r"\b(agrees|verdicts)\(")

NO_VERDICT = {
    "Every printed f is d4/d1": "print against print",
    "Five simulated selections of B at 10 m: the density": "the print is a limit that is drawn",
    "Far off, the published distance": "a method that is published, against the truth",
    "Estimating the displacement first": "methods against each other",
    "Each row of Table 4": "counts of two readings; the ledger has one",
    "On streets of the kind it was trained on": "methods against each other",
    "The street was chosen for it": "Wilson intervals of both, and it says so",
    "The scan-line method finds a smaller share": "ours against ours",
    "Sheets meet more heights": "a prediction against a constant",
    "Pixels of A are coarser": "how far, where the ledger says that they differ",
    "One number of pixels a pair": "rules against each other",
    "Contrast alone accepts": "bars that are printed on a chart",
    "Upright, at 40 km/h, B": "how far, where the ledger says that it differs",
    "At 1 MHz and 200 Hz, A's": "what goes with a printed value, not the value",
    "One stereo pair misses": "models against each other",
    "The adjustment removes nine tenths": "simulated with printed noise",
    "With ten control targets": "simulated with printed noise",
}
"""How checks begin that speak of print, or are worked out with it, and have no verdict on a cell:
what they compare instead."""


def leading_to(nodes, place, names):
    """The code of the statements above a place that lead to the values of names there."""
    found, waiting = set(), [(name, place) for name in names]
    for name, before in waiting:  # it grows
        for k in range(before - 1, -1, -1):
            if name in stored(nodes[k]):
                found.add(k)
                waiting += [new for n in loaded(nodes[k]) if (new := (n, k)) not in waiting]
                if isinstance(nodes[k], ast.Assign | ast.FunctionDef):
                    break
    return "\n".join(ast.unparse(nodes[k]) for k in sorted(found))


def checks_on_print(notebook):
    """The statement of each check that speaks of print or reads it, and if it reads a verdict."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    code = [TransformerManager().transform_cell(text) for text in code]
    nodes = [node for text in code for node in ast.parse(text).body]
    nodes = [node for node in nodes if not isinstance(node, ast.Import | ast.ImportFrom)]
    for place, node in enumerate(nodes):
        for call in (part for part in ast.walk(node) if isinstance(part, ast.Call)):
            if ast.unparse(call.func) == "run.check":
                statement, passed, *others = call.args
                work = leading_to(nodes, place, loaded(passed) - {"run"}) + ast.unparse(passed)
                words = " ".join(map(ast.unparse, (statement, *others)))
                if SAYS_PRINT.search(words) or READS_PRINT.search(work):
                    yield ast.unparse(statement).strip("'\""), bool(READS_VERDICT.search(work))


def test_a_check_on_print_reads_the_verdict_of_the_ledger():
    found = [one for study in STUDIES for one in checks_on_print(nbformat.read(study.path, 4))]
    own = [statement for statement, verdict in found if not verdict]
    assert [one for one in own if not one.startswith(tuple(NO_VERDICT))] == []
    assert [one for one in NO_VERDICT if not any(s.startswith(one) for s in own)] == []
    assert sum(verdict for _, verdict in found) >= 6


@pytest.mark.parametrize(
    ("passed", "verdict"),
    [
        ("abs(ours - said) < 1", False),
        ("right.all()", False),
        ("near", False),
        ("run.agrees('pfeifer2021 table_2 A 5 m d1')", True),
        ("reached.all()", True),
    ],
)
def test_a_check_with_a_comparison_of_its_own_is_found(passed, verdict):
    work = """table = published.table("pfeifer2021", "table_2")
said = published.number("pfeifer2021", "f_threshold")["value"]
ours = 3
right = pd.Series([(table["d1"] - ours).abs() < 1])
reached = pd.Series([run.agrees(cell) for cell in cells])
def close(x):
    return x - said < 1
near = close(ours)"""
    check = f'run.check("d1 is 4 mm.", {passed}, f"{{ours}} mm", "rounding")'
    cells = [nbformat.v4.new_code_cell(text) for text in (work, check)]
    found = list(checks_on_print(nbformat.v4.new_notebook(cells=cells)))
    assert found == ([] if "agrees" in passed or "reached" in passed else [("d1 is 4 mm.", False)])
    named = check.replace("d1 is", "The printed d1 is")
    cells[1].source = named
    found = list(checks_on_print(nbformat.v4.new_notebook(cells=cells)))
    assert found == [("The printed d1 is 4 mm.", verdict)]


TWO_DIGITS = re.compile(r"(?<![\w.,/=-])(?:[1-9]\d*\.\d+|0\.0*[1-9]\d+)(?![\w.]*\d)")
"""Numbers with a decimal part and two digits that count, where no name or version goes on."""

NO_RESULT = re.compile(
    r"\*\*Answer\..*|doi\S+|https?\S+|\$[^$]*\$|`[^`]*`"
    r"|(?i:sections?|tables?|figures?|equations?|chapters?) [\d., andto()-]+"
)
"""What is no result of a run, or renewed with it: answers, links, formulas, code, places."""

TYPED = {
    "own-00": "the size of the sample, and the paper's threshold",
    "rep22": "follows from a quantile of the normal distribution",
    "aniso00": "the paper's threshold",
    "lhd20": "worked out by hand from the formula",
    "pol27-text": "the report's corridor",
    "resolution-05": "the frequency asked for",
    "resolution-27": "published",
    "cell-07": "a width that the cell sets",
    "spec03": "worked out by hand from the formula",
    "spec15": "published",
    "radiometry-05": "given in the example by hand",
    "radiometry-14": "a parameter of the cases",
}
"""Cells of text with numbers that a table of the notebook has too, and why they are typed."""


def typed_results(notebook):
    """The cell and the number for each number of the text that an output has, to its digits."""
    outputs = [one for cell in notebook.cells for one in cell.get("outputs", [])]
    said = [one.get("text") or one.get("data", {}).get("text/plain", "") for one in outputs]
    table = set(re.findall(r"\d+\.\d+", " ".join(said)))
    for cell in notebook.cells:
        text = NO_RESULT.sub(" ", cell.source) if cell.cell_type == "markdown" else ""
        if not re.search("References|Exercise|Lesson", text):
            for number in TWO_DIGITS.findall(text):
                places = len(number.partition(".")[2])
                if any(
                    len(one) >= len(number) and f"{float(one):.{places}f}" == number
                    for one in table
                ):
                    yield cell.id, number


def test_results_stand_in_tables_not_in_typed_sentences():
    notebooks = [nbformat.read(study.path, as_version=4) for study in ALL]
    found = [one for notebook in notebooks for one in typed_results(notebook)]
    assert [one for one in found if one[0] not in TYPED] == []
    assert len(notebooks) == len(DONE)
    shown = nbformat.v4.new_output("stream", text="f 3.2571")
    cells = [nbformat.v4.new_code_cell("f", outputs=[shown])]
    cells.append(nbformat.v4.new_markdown_cell("Version 3.26.1 has f = 3.26 ([2.1](a)).", id="t"))
    assert [*typed_results(nbformat.v4.new_notebook(cells=cells))] == [("t", "3.26")]
