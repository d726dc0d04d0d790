"""Single changes of operators and numbers, drawn over all rooms: how many do the tests see?

``python tests/benchmarks/random_changes.py FOLDER`` works in a copy of the repository there. It
plants one change after the other and runs the tests that name its function until one fails that
passes without the change. ``changes.csv`` has a row for each; a run that was stopped goes on behind
the last.
What draws, speaks, checks or is a default is left out. ``--rooms`` takes some rooms.
``EQUIVALENT`` has changes that change no answer, each with its reason.
"""

import argparse
import ast
import contextlib
import copy
import csv
import importlib
import os
import random
import re
import resource
import signal
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from mutations import copied

DRAWN = ("plots", "views", "widgets", "run", "commands")
SPOKEN_BY = {"refuse", "warn", "sentences", "ValueError", "TypeError", "OSError", "print", "round"}
UNASKED = ("test_browser", "test_studies", "test_students", "test_stored", "test_notebooks")
UNASKED += ("test_types", "test_house", "test_fuzz", "test_faults", "test_run", "test_view")
UNASKED += ("test_widgets", "test_study_poles", "test_commands", "test_chart_photographs")
UNASKED += ("test_chart_image_files", "test_coverage_of_intervals", "test_silent_images")
LONGEST_S, WHOLE_S = 3, 15  # of a test that is asked, and of all that a change may take
COMPILED_S = 12, 30  # of files whose functions are compiled first
COMPARED = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
COMPARED |= {ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
JOINED = {ast.And: ast.Or, ast.Or: ast.And}
COLUMNS = ["file", "line", "function", "old", "new", "result", "by", "seconds"]
EQUIVALENT = {
    ("planes.py", "fit_circle", "a**2 / 4", "(a ** 2 * 4)"): "where a search begins",
    ("spacing/_search.py", "_select", "0", "(1)"): "another first pivot, the same order",
    ("spacing/_search.py", "_select", "middle - low + 0.5",
     "(middle - low - 0.5)"): "another first pivot, the same order",
    ("boresight/adjustment.py", "Adjustment._fitted", "1", "(0)"): "how much is kept, not what",
    ("lines/displacement.py", "_solved", "10", "(20)"): "when a search ends",
    ("poles/axes.py", "fit_axes", "sums(w) + 1e-9",
     "(sums(w) - 1e-09)"): "it keeps a division finite",
    ("poles/common.py", "rows_near", "2", "(4)"): "more points are looked at in vain",
    ("studies/repeatability.py", "chart_scan", "64", "(128)"): "how much is kept, not what",
    ("test_field/drives.py", "figures", "1e-300", "(2e-300)"): "it keeps a logarithm finite",
    ("simulate/systems.py", "_crowded", "points - points.min(axis=0)",
     "(points + points.min(axis=0))"): "cubes from any other place do",
    ("chart_image/maps.py", "ChartMap.chart", "places - before",
     "(places + before)"): "when a search ends",
    ("lines/displacement_search.py", "_best_path", "path[station + 1] + i * strides[0]",
     "(path[station + 1] - i * strides[0])"): "the same places in another order",
    ("studies/repeatability.py", "_outlined", "middle + (signs * [width, height]) @ plane.axes",
     "(middle - signs * [width, height] @ plane.axes)"): "the same rectangle from another corner",
    ("simulate/scan.py", "_pass_near", "along <= -limit or square - along * along > limit * limit",
     "(along <= -limit and square - along * along > limit * limit)"): "more beams are cast in vain",
    ("cloud.py", "unit_remarks", "7", "(14)"): "how many places are looked at",
    ("simulate/scan.py", "_may_meet", "1e-9", "(2e-09)"): "it keeps a division finite",
    ("simulate/point_patterns.py", "point_pattern", "size * np.sqrt(0.5)",
     "(size / np.sqrt(0.5))"): "a wider field is drawn, of which the same square is cut",
    ("simulate/point_patterns.py", "point_pattern", "5", "(10)"):
        "a wider field is drawn, of which the same square is cut",
    ("mtf/edges.py", "_plausible", "side * across > 0", "(side * across <= 0)"):
        "both sides are asked, in the other order",
    ("simulate/scenes.py", "_hierarchy", "2", "(4)"): "more room than nodes fill",
    ("simulate/systems.py", "_crowded", "3", "(6)"): "smaller cubes do, too",
    ("studies/fitness/tasks.py", "averaged", "uv + off", "(uv - off)"):
        "the same ring from its other side",
    ("studies/fitness/tasks.py", "end_mm", "xy[:, along] - middle", "(xy[:, along] + middle)"):
        "the same parts in another order",
    ("studies/fitness/tasks.py", "step_mm", "uv[:, 0] - side", "(uv[:, 0] + side)"):
        "a step seen from its other side",
    ("simulate/cameras.py", "Optics", "0.5", "(1.0)"): "a default",
    ("simulate/cameras.py", "Sensor", "0.01", "(0.02)"): "a default",
    ("studies/fitness/acquisitions.py", "_matched", "2 * np.pi * rng.random(20)",
     "(2 * np.pi / rng.random(20))"): "phases of waves by chance, as before",
    ("io/outlines.py", "_of_gis", "GDAL_S + path.stat().st_size / 1e6",
     "(GDAL_S - path.stat().st_size / 1000000.0)"): "how long a reader is waited for",
}  # fmt: skip
"""By file, function, old and new text: why no answer changes."""


def changes(path):
    """The single changes of a file: node and its function."""
    for node, function in _working(ast.parse(path.read_text("utf-8")), ""):
        if isinstance(node, ast.Compare):
            possible = type(node.ops[0]) in COMPARED
        elif isinstance(node, ast.BinOp):
            possible = type(node.op) in COUNTED
        else:
            number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
            possible = number or isinstance(node, ast.BoolOp)
        if possible:
            yield node, function


def changed(node):
    """The text that takes a node's place."""
    new = copy.deepcopy(node)
    if isinstance(node, ast.Compare):
        new.ops[0] = COMPARED[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp):
        new.op = COUNTED[type(node.op)]()
    elif isinstance(node, ast.BoolOp):
        new.op = JOINED[type(node.op)]()
    else:
        new.value = node.value * 2 if node.value not in (0, 1) else 1 - node.value
    return f"({ast.unparse(new)})"


def _working(node, function):
    """The nodes that calculate, each with the function in which it stands."""
    for child in ast.iter_child_nodes(node):
        name = getattr(getattr(child, "func", None), "id", getattr(child, "name", ""))
        name = str(name or getattr(getattr(child, "func", None), "attr", ""))
        left_out = ast.Raise | ast.JoinedStr | ast.arguments | ast.Import | ast.ImportFrom
        spoken = isinstance(child, left_out) or name in SPOKEN_BY or "plot" in name
        top = isinstance(node, ast.Module) and not isinstance(child, ast.FunctionDef | ast.ClassDef)
        if not spoken and not top and not name.startswith(("check_", "draw_", "_draw")):
            inner = f"{function}.{name}" if isinstance(child, ast.FunctionDef | ast.ClassDef) else 0
            yield child, function
            yield from _working(child, inner or function)


def late(*_):
    """Leave out a test that takes too long."""
    raise pytest.skip.Exception("too long")


class Timed:
    """Tests end after a while, and the first that fails is named."""

    def __init__(self, file, longest):
        self.file, self.longest = file, longest

    def pytest_runtest_protocol(self, item):
        """Begin to count the processor time of a test."""
        signal.signal(signal.SIGPROF, late)
        signal.setitimer(signal.ITIMER_PROF, self.longest)

    def pytest_runtest_logreport(self, report):
        """Note what fails."""
        if report.failed:
            self.file.write_text(report.nodeid)
        if report.when == "teardown":
            signal.setitimer(signal.ITIMER_PROF, 0)


def failed(tree, tests, longest, whole):
    """The first of the tests that fails on the copy, empty where none does.

    They run in a process of its own, so libraries are loaded once; the package is loaded anew.
    """
    told = tree / "failed.txt"
    told.write_text("")
    child = os.fork() if tests else 0
    if tests and child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (whole, whole))
        os.chdir(tree)
        sys.path[:0] = [str(tree), str(tree / "tests")]
        sys.dont_write_bytecode = True
        sys.stdout.flush()
        os.dup2(os.open(tree / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        os.dup2(1, 2)
        quiet = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:randomly"]
        code = pytest.main([*quiet, "--rootdir", str(tree), *tests], [Timed(told, longest)])
        if code not in (0, 1, 5) and not told.read_text():  # it cannot even be imported
            told.write_text("\n".join(tests))
        os._exit(0)
    if tests:
        os.waitpid(child, 0)
    return told.read_text()


def own_files(tree, room):
    """The test files of a room: those with its name, and those without a room's that import it."""
    rooms = {path.name.split(".")[0] for path in (tree / "mmqa_lab").iterdir()} - {"__init__"}
    stem = {"studies": "study"}.get(room, room.strip("_"))
    for file in sorted((tree / "tests").glob("test_*.py")):
        text, named = file.read_text("utf-8"), any(f"test_{one}" in file.name for one in rooms)
        uses = re.search(rf"mmqa_lab\.{room}\b|from mmqa_lab import [^\n]*\b{room}\b", text)
        own = file.name.startswith(f"test_{stem}") or (not named and uses and "study" not in stem)
        if own and not file.name.startswith(UNASKED):
            yield file, text


def asked(tree, room, file, function):
    """The tests that name a function, or for a private one what its file offers: quick ones first.

    The examples of the file, tests with its own name, the table of kinds, tests with the names of
    its file, then the rest of a test
    file that has one of them, then the room's others, as far as the time goes.
    """
    source = (tree / "mmqa_lab" / file).read_text("utf-8")
    words = [one for one in function.split(".") if one and one[0] != "_"]
    by_name = re.compile(rf"\b{function.split('.')[-1] or room}\b")
    words = words or re.findall(r"^(?:def|class) ([a-zA-Z]\w*)", source, re.MULTILINE)
    words = words or [room]
    naming, kinds = re.compile(rf"\b({'|'.join(words)})\b"), tree / "tests/test_kinds.py"
    rows = re.findall(rf'of\("{room}", "([\w:]+)"', kinds.read_text("utf-8"))
    named = [f"tests/test_kinds.py::test_kinds[{room}.{one}]" for one in rows if naming.search(one)]
    first, rest, others = [], [], [f"tests/test_kinds.py::test_kinds[{room}.{one}]" for one in rows]
    for path, text in own_files(tree, room):
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                within = ast.get_source_segment(text, node)
                place = rest if naming.search(text) else others
                place = named if naming.search(within) else place
                place = first if by_name.search(within) else place
                place.append(f"tests/{path.name}::{node.name}")
    return list(dict.fromkeys([f"mmqa_lab/{file}", *first, *named, *rest, *others]))


def planted(tree, file, node, new, number):
    """The file's bytes with the change, and its bytes as they were."""
    path = tree / "mmqa_lab" / file
    old = path.read_bytes()
    lines = old.splitlines(keepends=True)
    before = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    after = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    path.write_bytes(old[:before] + new.encode() + old[after:])
    os.utime(path, (1e9 + number, 1e9 + number))  # compiled code is not taken for that of another
    return old[before:after].decode(), old


def main(folder, count, seed, only, rooms=None, most=None):
    """Draw, plant, test, note."""
    tree = folder / "copy"
    if not tree.exists():
        tree.mkdir(parents=True)
        copied(tree)
    files = [p.relative_to(tree / "mmqa_lab") for p in sorted((tree / "mmqa_lab").rglob("*.py"))]
    named = {str(one): one.parts[0].split(".")[0] for one in files}
    files = [one for one, room in named.items() if room not in DRAWN and room in (rooms or [room])]
    drawn = [(file, *change) for file in files for change in changes(tree / "mmqa_lab" / file)]
    drawn = random.Random(seed).sample(drawn, min(count, len(drawn)))
    table = folder / "changes.csv"
    rows = pd.read_csv(table).to_dict("records") if table.exists() else []
    if only is not None:
        drawn = [(k, drawn[k]) for k in only]
    else:
        drawn = list(enumerate(drawn))[len(rows) :][:most]
    for number, (file, node, function) in drawn:
        start, path, new = time.time(), tree / "mmqa_lab" / file, changed(node)
        tests = asked(tree, named[str(file)], file, function.strip("."))
        stamp, by = path.stat(), "none yet"
        limits = COMPILED_S if b"njit" in path.read_bytes() else (LONGEST_S, WHOLE_S)
        while by:
            old, text = planted(tree, file, node, new, number)
            try:
                by = failed(tree, tests, *limits)
            finally:
                path.write_bytes(text)
                os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
            if by and not failed(tree, by.splitlines(), *limits):  # it passes on the copy as it is
                break
            tests = [one for one in tests if one not in (*by.splitlines(), by.split("[")[0])]
        key = (str(file), function.strip("."), old, new)
        word = "equivalent" if key in EQUIVALENT else "caught" if by else "passed"
        row = [file, node.lineno, function.strip("."), old, new, word, by]
        row.append(round(time.time() - start, 1))
        new_file = not table.exists()
        with table.open("a", newline="") as out:
            csv.writer(out).writerows([COLUMNS][: int(new_file)] + [row])
        print(number, *row, flush=True)


def report(table):
    """Write the table of RESULTS.md: by room, how many were drawn and caught."""
    from results import write_section  # has the package with it, which children load themselves

    rows = pd.read_csv(table)
    rows["room"] = rows["file"].str.split("/").str[0].str.removesuffix(".py")
    found = pd.crosstab(rows["room"], rows["result"], margins=True, margins_name="all")
    found = found.reindex(columns=["caught", "passed", "equivalent", "all"], fill_value=0)
    write_section("Random changes", found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of changes to test again")
    parser.add_argument("--most", type=int, help="changes that are tested now; others later")
    parser.add_argument("--rooms", nargs="*", help="names of rooms that are changed")
    parser.add_argument("--report", action="store_true", help="write the table of RESULTS.md")
    given = parser.parse_args()
    for name in ("xarray", "scipy.stats", "scipy.optimize", "scipy.spatial", "scipy.ndimage",
                 "scipy.interpolate", "matplotlib.pyplot", "shapely", "pyproj", "laspy", "cv2",
                 "hypothesis", "numba"):  # fmt: skip
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if given.report:
        report(given.folder / "changes.csv")
    else:
        choices = given.only, given.rooms, given.most
        main(given.folder.resolve(), given.count, given.seed, *choices)
