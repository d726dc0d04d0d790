"""Each parameter of each notebook reaches a table: its name is followed through the cells."""

import ast

import nbformat
import pytest
from IPython.core.inputtransformer2 import TransformerManager

from mmqa_lab.run import parameter_names
from mmqa_lab.studies import STUDIES

SAVES = {"save_table", "save_value", "save_figure", "save_answer"}

PARAMETERS = [(study, name) for study in STUDIES for name in parameter_names(study.path)]


def statements(path):
    """The statements of a notebook's code cells after the one with the parameters."""
    seen = False
    for cell in nbformat.read(path, as_version=4).cells:
        tags = cell.metadata.get("tags", [])
        if seen and cell.cell_type == "code" and "solution" not in tags:
            yield from ast.parse(TransformerManager().transform_cell(cell.source)).body
        seen = seen or "parameters" in tags


def base(node):
    """The name that an attribute or item belongs to."""
    while isinstance(node, ast.Attribute | ast.Subscript | ast.Call):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.id if isinstance(node, ast.Name) else None


def names(nodes):
    """All names in some pieces of code."""
    inside = [one for node in nodes for one in ast.walk(node)]
    return {one.id for one in inside if isinstance(one, ast.Name)}


def changed_by(statement):
    """Names that a statement sets or whose object it changes: by an item, or by a method."""
    for node in ast.walk(statement):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
            if isinstance(node.ctx, ast.Store):
                yield base(node)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            yield base(node.func)


def imported(body):
    """Names of modules and of what is imported from them, and the run: they carry nothing on."""
    found = [node for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    return {(a.asname or a.name).partition(".")[0] for node in found for a in node.names} | {"run"}


def saves(statement, carriers):
    """Whether a statement saves something that depends on one of the names."""
    for node in ast.walk(statement):
        saving = isinstance(node, ast.Call) and getattr(node.func, "attr", "") in SAVES
        if saving and names([*node.args, *(k.value for k in node.keywords)]) & carriers:
            return True
    return False


def reaches_a_table(name, body):
    """Whether something that is saved depends on a name."""
    carriers, passive = {name}, imported(body)
    for statement in body:
        if names([statement]) & carriers:
            carriers |= set(changed_by(statement)) - passive - {None}
        if saves(statement, carriers):
            return True
    return False


@pytest.mark.parametrize(("study", "name"), PARAMETERS, ids=lambda one: getattr(one, "stem", one))
def test_parameter_reaches_a_table(study, name):
    assert reaches_a_table(name, list(statements(study.path)))


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("x = f(p)\nrun.save_table(x, 't')", True),
        (
            "def f(v):\n    return p * v\nrows = []\nrows.append(f(2))\nrun.save_table(rows, 't')",
            True,
        ),
        ("for k in p:\n    kept[k] = 1\nrun.save_value('n', len(kept), '1', 'measured')", True),
        ("print(p)\nx = 2\nrun.save_table(x, 't')", False),
        ("import a\na.show(p)\nrun.save_table(a.table(), 't')", False),
        ("run.save_table(x, 't')\nx = p", False),
    ],
)
def test_the_flow_of_names(code, expected):
    assert reaches_a_table("p", ast.parse(code).body) == expected
