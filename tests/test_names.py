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


def says_types(function):
    """Every argument and what is returned must have a type."""
    signature = inspect.signature(function)
    bare = [
        each.name
        for each in signature.parameters.values()
        if each.annotation is each.empty
        and each.name not in ("self", "cls")
        and each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)
    ]
    assert not bare, function.__qualname__
    given = function.__name__ == "__init__" or signature.return_annotation is not signature.empty
    assert given, function.__qualname__


@pytest.mark.parametrize("one", [one for one in ALL if inspect.isfunction(one.values[0])])
def test_public_function_says_its_types(one):
    says_types(one)


def all_results():
    """Public classes, and the classes of the package that public functions return."""
    members = [one.values[0] for one in ALL]
    found = {one for one in members if inspect.isclass(one)}
    for function in filter(inspect.isfunction, members):
        said = function.__annotations__["return"]
        words = re.findall(
            r"\w+", said if isinstance(said, str) else inspect.formatannotation(said)
        )
        ours = [getattr(inspect.getmodule(function), word, None) for word in words]
        found |= {one for one in ours if inspect.isclass(one)}
    ours = [one for one in found if one.__module__.startswith("mmqa_lab.")]
    return sorted((one for one in ours if not one.__name__.startswith("_")), key=str)


RESULTS = all_results()

NO_RESULTS = {
    *("Comparison", "ChartMap", "FrameCamera", "PanoramaCamera", "Layout", "Bar", "LinePairs"),
    *("Marker", "Text", "Journal", "Run", "Check", "Patch", "ScanSetup", "Target", "Scene"),
    *("MatchingCamera", "MultiBeamScanner", "NavigationErrors", "ProfileScanner", "System"),
    *("Surface", "JuryForm", "PlanePicker", "SelectionTool", "Settings", "Crop"),
}
"""Classes of what goes into a measurement or controls one."""

WITHOUT_PLOT = {
    *("Agreement", "BlockAdjustment", "Calibration", "Circle", "Components", "DisplacedMatch"),
    *("Displacement", "EmpiricalLine", "Errors", "Interval", "Line", "Outcome", "Outline"),
    *("PairingScores", "PatternMeasurement", "Plane", "Rate", "Repeatability", "Resolution"),
    *("ScanPlanes", "Score", "SensorFit", "Threshold", "Trajectory", "WalthallFit"),
}
"""Results of a few numbers, without the points or the curve that one would see."""


def methods(one):
    """Public methods and properties of a class, by what says their types."""
    for name, member in vars(one).items():
        inner = getattr(member, "__func__", None) or getattr(member, "func", member)
        inner = member.fget if isinstance(member, property) else inner
        if inspect.isfunction(inner) and (name == "__init__" or not name.startswith("_")):
            yield inner


@pytest.mark.parametrize("one", RESULTS, ids=lambda one: one.__name__)
def test_methods_say_their_types(one):
    for method in methods(one):
        if method.__module__ == one.__module__:  # a dataclass writes its own __init__
            says_types(method)


@pytest.mark.parametrize("one", RESULTS, ids=lambda one: one.__name__)
def test_a_result_is_a_table_and_a_picture(one):
    result = one.__name__ not in NO_RESULTS
    assert (hasattr(one, "to_frame") and hasattr(one, "_repr_html_")) == result
    assert hasattr(one, "plot") == (result and one.__name__ not in WITHOUT_PLOT)


@pytest.mark.parametrize("room", sorted(set(PUBLIC["room"])))
def test_a_room_shows_its_public_names_alone(room):
    module = importlib.import_module(f"mmqa_lab.{room}")
    assert set(dir(module)) >= set(PUBLIC["name"][PUBLIC["room"] == room])
    imported = [name for name in ("np", "pd", "annotations", "dataclass") if name in dir(module)]
    assert not imported


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
