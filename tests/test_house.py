"""The house rules as data: who may import whom, and that nothing stands alone."""

import ast
import hashlib
import importlib
import inspect
import json
import pkgutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import mmqa_lab
from mmqa_lab import samples
from mmqa_lab.studies import STUDIES, TOOLS

ROOT = Path(mmqa_lab.__file__).parent.parent
PACKAGE = ROOT / "mmqa_lab"

LAYERS = {
    "_checks": 0,
    "_compiled": 0,
    "_polygons": 0,
    "_results": 0,
    "cloud": 0,
    "published": 0,
    "spacing": 1,
    "planes": 1,
    "scan_pattern": 1,
    "stats": 1,
    "chart_cloud": 2,
    "charts": 2,
    "io": 2,
    "chart_image": 2,
    "mtf": 2,
    "boresight": 2,
    "lines": 2,
    "poles": 2,
    "radiometry": 2,
    "repeatability": 2,
    "testfield": 2,
    "simulate": 3,
    "bench": 3,
    "samples": 3,
    "_figures": 4,
    "plots": 4,
    "views": 4,
    "maps": 4,
    "run": 4,
    "tender": 4,
    "studies": 5,
    "widgets": 6,
    "commands": 6,
    "__main__": 6,
}
"""A room may import rooms of its own layer and of those below."""

LAZY = {
    **{"_checks": {"io"}, "_polygons": {"io"}, "cloud": {"io"}, "chart_cloud": {"plots"}},
    **{room: {"plots"} for room in ("lines", "mtf", "scan_pattern", "spacing")},
}
"""Whatever takes points takes the path of a file of points, and reads it when it gets one. A result
draws itself with the room of plots, which it imports when asked to."""

PLOTTING = {"charts", "cloud"}
"""Rooms that draw their own objects, with matplotlib imported when called."""

DRAWING = {"matplotlib", "pyvista", "ipywidgets", "IPython"}

MODULES = sorted(PACKAGE.rglob("*.py"))


def room(path):
    """The first name below the package: the room a file stands in."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def is_for_types(node):
    """Whether this is a block that type checkers alone read."""
    return isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"


def imports(path):
    """Every dotted name that a module imports, functions' own imports too; none for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    tree.body = [node for node in tree.body if not is_for_types(node)]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def rooms_imported(path):
    """The rooms of this package that a module imports."""
    names = {name.split(".")[1] for name in imports(path) if name.startswith("mmqa_lab.")}
    return names & set(LAYERS)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_down(path):
    here = room(path)
    if here == "__init__":
        return
    assert here in LAYERS, f"{here} has no layer in the table of this test"
    upward = {name for name in rooms_imported(path) if LAYERS[name] > LAYERS[here]}
    assert not upward - LAZY.get(here, set())
    if LAYERS[here] <= 3 and here not in PLOTTING:
        assert not DRAWING & {name.split(".")[0] for name in imports(path)}


def test_no_study_imports_another():
    for path in (PACKAGE / "studies").rglob("*.py"):
        own = path.relative_to(PACKAGE / "studies").parts[0].removesuffix(".py")
        others = {study.stem for study in STUDIES} - {own}
        named = {name.split(".")[2] for name in imports(path) if name.count(".") >= 2}
        assert own == "__init__" or not others & named


def test_commands_start_with_the_standard_library_alone():
    for path in [*(PACKAGE / "commands").glob("*.py"), PACKAGE / "__main__.py"]:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module]
            else:
                continue
            for name in names:
                ours = name == "mmqa_lab" or name.startswith("mmqa_lab.commands")
                assert ours or name.split(".")[0] in sys.stdlib_module_names, f"{path}: {name}"


@pytest.mark.parametrize("path", sorted((PACKAGE / "commands").glob("*.py")), ids=lambda p: p.stem)
def test_commands_name_modules_within_rooms_themselves(path):
    """A room has no attribute for a module of it that nothing has imported yet."""
    tree = ast.parse(path.read_text())
    lazy = {
        node.targets[0].id: node.value.args[0].value.replace(".", "/")
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.value, "func", None)
        if getattr(node.value.func, "id", "") == "Lazy"
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") in lazy:
            assert not (ROOT / lazy[node.value.id] / f"{node.attr}.py").exists(), node.lineno


def test_importing_the_package_is_light():
    code = "import sys, mmqa_lab; print({'numpy', 'numba', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


def test_catalogue_notebooks_modules_and_readme_agree():
    notebooks = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert notebooks == {study.notebook for study in (*TOOLS, *STUDIES)}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"notebooks/{one.notebook}.ipynb" in readme for one in (*TOOLS, *STUDIES))
    for study in STUDIES:
        assert isinstance(study.quick, dict)


def notebook_cells(path):
    """The cells of a notebook file, each with its source as one text."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [{**cell, "source": "".join(cell["source"])} for cell in cells]


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.stem)
def test_notebook_keeps_the_template(study):
    cells = notebook_cells(study.path)
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert 14 <= len(cells) <= 75
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    assert max(len(cell["source"].splitlines()) for cell in code) <= 25
    tags = [tag for cell in cells for tag in cell["metadata"].get("tags", [])]
    assert tags.count("parameters") == 1
    assert 2 <= tags.count("solution") <= 4
    assert "doi" in cells[0]["source"].lower()
    assert "save_checks" in code[-1]["source"] or any("save_checks" in c["source"] for c in code)


def test_samples_are_registered_with_hash_and_licence():
    registered = {sample.file: sample for sample in samples.SAMPLES}
    present = {path.name for path in samples.FOLDER.iterdir()}
    assert present - {"README.md"} - {n for n in present if n.startswith("LICENSE")} == set(
        registered
    )
    readme = (samples.FOLDER / "README.md").read_text(encoding="utf-8")
    for name, sample in registered.items():
        content = (samples.FOLDER / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == sample.sha256
        assert sample.licence
        assert sample.sha256 in readme


def public_functions():
    """Every public function and class of the package that is defined where it is found."""
    for found in pkgutil.walk_packages([str(PACKAGE)], "mmqa_lab."):
        if any(part.startswith("_") for part in found.name.split(".")):
            continue
        module = importlib.import_module(found.name)
        for name, member in vars(module).items():
            own = getattr(member, "__module__", None) == found.name
            if own and not name.startswith("_") and callable(member):
                yield f"{found.name}.{name}", member


def test_public_names_have_docstrings():
    bare = [name for name, member in public_functions() if not inspect.getdoc(member)]
    assert not bare


def test_at_most_five_required_arguments():
    for name, member in public_functions():
        if not inspect.isfunction(member):
            continue
        required = [
            parameter
            for parameter in inspect.signature(member).parameters.values()
            if parameter.default is parameter.empty
            and parameter.kind is parameter.POSITIONAL_OR_KEYWORD
        ]
        assert len(required) <= 5, name


def test_no_test_reaches_beyond_this_machine():
    # 192.0.2.1 belongs to nobody (RFC 5737).
    with pytest.raises(OSError, match=r"Must be on this machine\."):
        socket.create_connection(("192.0.2.1", 80), timeout=1)
