"""The house rules as data: who may import whom, and that what is delivered is whole."""

import ast
import importlib
import importlib.util
import re
import runpy
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from rooms import with_rooms

import mmqa_lab
from mmqa_lab.studies import STUDIES, TOOLS

ROOT = Path(mmqa_lab.__file__).parent.parent
PACKAGE, TESTS = ROOT / "mmqa_lab", ROOT / "tests"

LAYERS = (
    "__init__ _data _checks _compiled _progress _results _streams rotations",
    "cloud published",
    "stats spacing planes plane_search io",
    "scan_pattern charts samples metrics chart_cloud test_field lines radiometry repeatability",
    "boresight poles chart_image mtf tender image_targets",
    "simulate",
    "bench plots views maps widgets",
    "studies run",
    "commands __main__",
)
"""A room may import rooms of its own layer and of those above in this table."""

NO_FILES = set(" ".join((*LAYERS[:2], *LAYERS[3:6])).split()) - {"samples", "chart_image", "tender"}
"""Rooms of methods take arrays: they do not import io. Texts in tables of tenders are read as io
reads them."""

OTHER_TESTS = {
    "__main__": "commands",
    "_checks": "bad_inputs",
    "_compiled": "spacing",
    "_progress": "commands",
    "_data": "house",
    "_streams": "kinds",
    "plots": "figures",
}
"""Rooms of one file whose tests stand in a file of another name: test_<name>.py."""

LIBRARIES = ("matplotlib", "pyvista", "ipywidgets", "IPython")
PICTURES = {"plots", "views", *(f"library {name}" for name in LIBRARIES)}
"""Imported below the layer of bench only when a result is asked to draw itself."""


def imported(path):
    """Rooms and libraries that a module imports: at its top, and within its functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    tree.body = [one for one in tree.body if getattr(getattr(one, "test", 0), "id", "") == ""]
    for node in ast.walk(tree):
        names = [alias.name for alias in getattr(node, "names", []) if hasattr(alias, "asname")]
        if isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{name}" for name in names)]
        elif not isinstance(node, ast.Import):
            continue
        for name in names:
            ours = name.startswith("mmqa_lab.")
            parts = name.split(".")
            yield parts[1] if ours else f"library {parts[0]}", node in tree.body


@pytest.mark.parametrize(
    "path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_imports_point_down(path):
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    layer = {name: number for number, row in enumerate(LAYERS) for name in row.split()}
    for name, at_top in imported(path):
        drawn = name in PICTURES and not at_top
        assert drawn or layer.get(name, 0) <= layer[room], f"{room} imports {name}"
        assert drawn or name not in PICTURES or layer[room] >= layer["bench"]
        assert name != "io" or room not in NO_FILES


def test_the_package_and_the_contributors_page_list_each_room_once():
    listed = re.findall(r"^- ``(\w+)``: ", mmqa_lab.__doc__, re.MULTILINE)
    inside = {"__init__", "__main__", "_compiled", "_progress", "_results", "_streams"}
    assert sorted(listed) == sorted({*" ".join(LAYERS).split()} - inside)
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert with_rooms(page) == page  # python tests/rooms.py writes it


@pytest.mark.parametrize(
    "path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_each_module_says_what_it_offers(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    module = importlib.import_module(".".join(parts).removesuffix(".__init__"))
    assert set(module.__all__) <= set(vars(module))


def test_no_file_is_longer_than_one_reads_at_a_time():
    lines = {str(p): p.read_text("utf-8").count("\n") for p in sorted(PACKAGE.rglob("*.py"))}
    assert {path: n for path, n in lines.items() if n > 450} == {}


def test_each_room_has_a_test_file_by_its_name():
    missing = set()
    for path in PACKAGE.iterdir():
        room = path.stem.strip("_") if path.suffix == ".py" else path.name
        if room == "init" or not (path.suffix == ".py" or (path / "__init__.py").is_file()):
            continue
        if not [*TESTS.glob(f"test_{room}.py"), *TESTS.glob(f"test_{room}_*.py")]:
            missing.add(path.stem)
    assert missing == set(OTHER_TESTS)
    for name in OTHER_TESTS.values():
        assert (TESTS / f"test_{name}.py").is_file()


GONE = {
    "chart_image.quality_index": "three quarters of the capitals over w",
    "chart_image.rules.quality_index": "three quarters of the capitals over w",
    "chart_image.rules.colour_fringes": "the range of find_tones of the three colours",
    "chart_image.rules.expected_marks": "tender.published_results(by_pixels=True)",
    "studies.poles_training.calibrated": "tests/poles_training.py",
    "studies.poles_training.example": "tests/poles_training.py",
    "studies.poles_training.lessons": "tests/poles_training.py",
    "studies.poles_training.yard": "tests/poles_training.py",
    "run.students.needed_statements": "the tag answers of a notebook's cells",
    "studies.fitness.METHODS": "metrics.METRICS",
    "studies.fitness.rules": "studies.fitness.halves",
    "studies.fitness_text.GOOD": "chart_image.resolution",
    "studies.fitness_text.METHODS": "chart_image.resolution",
    "studies.fitness_text.PHOTOGRAPHS": "chart_image.resolution",
    "studies.fitness_text.TEXT_CHART": "chart_image.resolution",
    "studies.fitness_text.bench": "chart_image.resolution",
    "studies.fitness_text.misread_percent": "chart_image.resolution",
    "studies.fitness_text.photographed": "chart_image.resolution",
    "commands.surveys": "commands",
    "io.clouds.write_cloud": "io.write_cloud",
    "io.images.read_heights": "io.read_heights",
    "io.ply.read_ply": "io.read_cloud",
    "io.tables.read_trajectory": "io.read_trajectory",
}
"""Public names of 0.4 that are no more, each with what takes its place, as in CHANGELOG.md."""


def test_public_names_of_the_version_before_are_there():
    names = (TESTS / "names_of_0_4.txt").read_text(encoding="utf-8").split()
    missing = set()
    for name in names:
        room, _, thing = name.rpartition(".")
        while importlib.util.find_spec(room) is None:  # a file that is a part of its room now
            room = room.rpartition(".")[0]
        if not hasattr(importlib.import_module(room), thing):
            missing.add(name.removeprefix("mmqa_lab."))
    assert missing == set(GONE)
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert not [name for name in GONE if f"`{name}`" not in changes]


def test_a_constant_has_a_name_of_its_own():
    # Studies share the names of what each of them has: METHODS, SOURCE, FIGURES.
    homes = {}
    for path in PACKAGE.rglob("*.py"):
        if "studies" in path.parts or path.name == "__main__.py":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            for target in ast.walk(node) if isinstance(node, ast.Assign) else ():
                if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store):
                    homes.setdefault(target.id, set()).add(path.relative_to(PACKAGE))
    capitals = {name: where for name, where in homes.items() if name.isupper()}
    assert len(capitals) > 300
    assert not {name: where for name, where in capitals.items() if len(where) > 1}


def test_faults_made_by_hand_still_stand_in_their_rooms():
    for room, text, _, tests in runpy.run_path(str(ROOT / "tests/benchmarks/mutations.py"))[
        "FAULTS"
    ]:
        inside = [PACKAGE / f"{room}.py", *(PACKAGE / room).rglob("*.py")]
        assert any(text in path.read_text("utf-8") for path in inside if path.is_file()), text
        assert all((ROOT / "tests" / name).is_file() for name in tests.split()), tests


def test_importing_the_package_is_light():
    code = "import sys, mmqa_lab; print({'numpy', 'numba', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("room", ["commands", "chart_cloud"])
def test_help_and_a_chart_load_no_tables_before_they_need_them(room):
    code = f"import sys, mmqa_lab.{room}; print({{'pandas', 'scipy', 'numba'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


def test_catalogue_and_notebooks_agree():
    notebooks = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert notebooks == {study.notebook for study in (*TOOLS, *STUDIES)}


def test_no_test_reaches_beyond_this_machine():
    # 192.0.2.1 belongs to nobody (RFC 5737).
    with pytest.raises(OSError, match=r"Must be on this machine\."):
        socket.create_connection(("192.0.2.1", 80), timeout=1)
