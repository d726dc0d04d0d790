"""Every public name explains itself: what it takes and gives back, its errors, an example."""

import ast
import dataclasses
import importlib
import inspect
import json
import re
import textwrap

import pandas as pd
import pytest

from mmqa_lab.__main__ import main
from mmqa_lab.commands import house

PUBLIC = house.name_table()

SECTION = re.compile(r"^(\w+)\n-{3,}\n", re.MULTILINE)


def member(room, name):
    """The object of a row of the table."""
    return getattr(importlib.import_module(f"mmqa_lab.{room}"), name)


ALL = [pytest.param(member(*row), id=".".join(row)) for row in PUBLIC[["room", "name"]].to_numpy()]


def sections(one):
    """The parts of a docstring by their titles; the summary's title is empty."""
    parts = SECTION.split(inspect.getdoc(one))
    return {"": parts[0]} | dict(zip(parts[1::2], parts[2::2], strict=True))


def own_code(one):
    """The syntax tree of a function, or of what makes an instance of a class."""
    if inspect.isfunction(one):
        return ast.parse(textwrap.dedent(inspect.getsource(one)))
    maker = vars(one).get("__post_init__" if dataclasses.is_dataclass(one) else "__init__")
    return ast.parse("" if maker is None else textwrap.dedent(inspect.getsource(maker)))


def taken(one):
    """Names of the arguments; of a dataclass, without those that its base explains."""
    if dataclasses.is_dataclass(one):
        return [
            f.name
            for f in dataclasses.fields(one)
            if f.init and f.name in vars(one)["__annotations__"]
        ]
    if inspect.isclass(one) and "__init__" not in vars(one):
        return []
    return [name for name in inspect.signature(one).parameters if name != "self"]


def gives_back(tree):
    """Whether a function returns or yields something."""
    nodes = list(ast.walk(tree))
    return any(isinstance(n, ast.Return) and n.value is not None for n in nodes) or any(
        isinstance(n, ast.Yield | ast.YieldFrom) for n in nodes
    )


def refuses(tree):
    """Whether code raises, itself or by the checks that it calls."""
    calls = [n.func for n in ast.walk(tree) if isinstance(n, ast.Call)]
    checks = [getattr(c, "id", getattr(c, "attr", "")).startswith("check_") for c in calls]
    return any(isinstance(n, ast.Raise) and n.exc for n in ast.walk(tree)) or any(checks)


@pytest.mark.parametrize("one", ALL)
def test_public_name_explains_itself(one):
    found, tree = sections(one), own_code(one)
    summary = found[""].split("\n\n")[0].strip()
    assert re.fullmatch(r".*[.:;]", summary), "the summary is no line"
    assert ">>>" in found.get("Examples", "")
    named = re.findall(r"^[\w*][\w*, ]*(?= :|$)", found.get("Parameters", ""), re.MULTILINE)
    named = {name.strip(" *") for names in named for name in names.split(",")}
    assert set(taken(one)) <= named
    if inspect.isfunction(one) and gives_back(tree):
        assert "Returns" in found or "Yields" in found
    if refuses(tree):
        assert "Raises" in found


@pytest.mark.parametrize("one", [one for one in ALL if inspect.isfunction(one.values[0])])
def test_public_function_says_its_types(one):
    signature = inspect.signature(one)
    bare = [
        each.name
        for each in signature.parameters.values()
        if each.annotation is each.empty
        and each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)
    ]
    assert not bare
    assert signature.return_annotation is not signature.empty


def test_names_are_listed_in_one_place(capsys, tmp_path):
    assert main(["names", "--json", "--csv", str(tmp_path / "names.csv")]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert (
        rows == PUBLIC.to_dict("records") == pd.read_csv(tmp_path / "names.csv").to_dict("records")
    )
    listed = {(row["room"], row["name"]) for row in rows}
    assert {("lines", "lhd"), ("published", "table"), ("cloud", "Cloud")} <= listed
    assert not any(room.startswith(("studies", "commands", "_")) for room, _ in listed)


def test_names_are_found_by_a_word(capsys):
    assert main(["names", "HAUSDORFF"]) == 0
    assert "lines" in capsys.readouterr().out
    assert main(["names", "unobtainium"]) == 2
    assert "Invalid word 'unobtainium'" in capsys.readouterr().err
