"""Single changes of operators and numbers, drawn over all rooms: how many do the tests see?

``python tests/benchmarks/random_changes.py FOLDER`` works in a copy of the repository there. It
notes once which functions each quick test runs (``seen.json``). Then it plants one change after the
other and runs the tests of its function, the quickest first, until one fails. ``changes.csv`` has
a row for each; a run that was stopped goes on behind the last. What draws, speaks, checks or is a
default is left out. ``--rooms`` and ``--tests`` take some rooms, and some files of tests.
``EQUIVALENT`` has changes that change no answer, each with its reason.
"""

import argparse
import ast
import contextlib
import copy
import csv
import importlib
import json
import os
import random
import resource
import signal
import sys
import time
from pathlib import Path

import pandas as pd
from mutations import copied

DRAWN = ("plots", "views", "widgets", "run", "commands")
SPOKEN_BY = {"refuse", "warn", "sentences", "ValueError", "TypeError", "OSError", "print", "round"}
UNASKED = ("test_browser", "test_studies", "test_students", "test_stored", "test_notebooks")
UNASKED += ("test_types", "test_house", "test_fuzz", "test_faults", "test_run", "test_view")
UNASKED += ("test_widgets", "test_study_poles", "test_commands", "test_chart_photographs")
UNASKED += ("test_chart_image_files", "test_coverage_of_intervals")
LONGEST_S, WHOLE_S = 3, 30  # of a test that is asked, and of all that a change may take
COMPARED = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt}
COMPARED |= {ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
JOINED = {ast.And: ast.Or, ast.Or: ast.And}
COLUMNS = ["file", "line", "function", "old", "new", "result", "tests", "seconds"]
EQUIVALENT = {
    ("planes.py", "fit_circle", "a**2 / 4", "(a ** 2 * 4)"): "where a search begins",
    ("spacing/_search.py", "_select", "0", "(1)"): "another first pivot, the same order",
    ("boresight/adjustment.py", "Adjustment._fitted", "1", "(0)"): "how much is kept, not what",
    ("studies/repeatability.py", "chart_scan", "64", "(128)"): "how much is kept, not what",
    ("simulate/point_patterns.py", "point_pattern", "size * np.sqrt(0.5)",
     "(size / np.sqrt(0.5))"): "a wider field is drawn, of which the same square is cut",
}  # fmt: skip
"""By file, function, old and new text: why no answer changes."""


def changes(path):
    """The single changes of a file: node, its function, and the text that takes its place."""
    for node, function in _working(ast.parse(path.read_text("utf-8")), ""):
        new = copy.deepcopy(node)
        if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
            new.ops[0] = COMPARED[type(node.ops[0])]()
        elif isinstance(node, ast.BinOp) and type(node.op) in COUNTED:
            new.op = COUNTED[type(node.op)]()
        elif isinstance(node, ast.BoolOp):
            new.op = JOINED[type(node.op)]()
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            new.value = node.value * 2 if node.value not in (0, 1) else 1 - node.value
        else:
            continue
        yield node, function, f"({ast.unparse(new)})"


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


class Seen:
    """Which functions each test that passes runs, and how long it takes."""

    def __init__(self, tree):
        self.tree, self.tests = str(tree / "mmqa_lab"), {}

    def pytest_runtest_protocol(self, item, nextitem):
        """Note what is called from here on; what takes too long is ended."""
        self.functions, self.start, self.passed = set(), time.process_time(), True
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S + 1)
        sys.setprofile(self.called)

    def called(self, frame, event, _):
        """Keep a function of the package by its file and name."""
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(self.tree):
            file = code.co_filename[len(self.tree) + 1 :]
            self.functions.add(f"{file}:{code.co_qualname.replace('.<locals>', '')}")

    def pytest_runtest_logreport(self, report):
        """A test whose parts have all passed is kept."""
        self.passed &= report.passed
        if report.when == "teardown":
            sys.setprofile(None)
            signal.setitimer(signal.ITIMER_PROF, 0)
            seconds = time.process_time() - self.start
            if self.passed and seconds < LONGEST_S:
                self.tests[report.nodeid] = [round(seconds, 2), sorted(self.functions)]


def late(*_):
    """End a test that takes too long."""
    raise TimeoutError("too long")


def in_child(tree, arguments, plugin=None):
    """The code with which pytest ends on the copy, in a process of its own; below 0 if it is ended.

    Libraries are loaded here once; the package is loaded by each child.
    """
    child = os.fork()
    if child == 0:
        if not plugin:
            resource.setrlimit(resource.RLIMIT_CPU, (WHOLE_S, WHOLE_S))
        os.chdir(tree)
        sys.path[:0] = [str(tree), str(tree / "tests")]
        sys.dont_write_bytecode = plugin is None
        sys.stdout.flush()
        os.dup2(os.open(tree / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        os.dup2(1, 2)
        import pytest

        signal.signal(signal.SIGPROF, late)
        quiet = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "--durations=0"]
        quiet = [*quiet[:1], *quiet[1 + (plugin is not None) :], "--rootdir", str(tree)]
        os._exit(int(pytest.main([*quiet, *arguments], [plugin] if plugin else [])))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class Kept(Seen):
    """Seen, written into the folder when all is done."""

    def pytest_sessionfinish(self, session):
        """Write what each test runs."""
        (Path(self.tree).parent / "seen.json").write_text(json.dumps(self.tests))


def asked(seen, file, function):
    """The tests of a function, the quickest first, within the time; then its files' others."""
    name = f"{file}:{function}"
    direct = [(s, test) for test, (s, names) in seen.items() if name in names]
    if not direct:  # a compiled function is not seen: all that runs its file
        inside = [(s, t, [one.startswith(f"{file}:") for one in n]) for t, (s, n) in seen.items()]
        direct = [(s, test) for s, test, runs in inside if any(runs)]
    files = {test.split("::")[0] for _, test in direct} | {f"mmqa_lab/{file}"}
    chosen = {test for _, test in direct}
    others = [(s, t) for t, (s, _) in seen.items() if t not in chosen and t.split("::")[0] in files]
    total, tests = 0.0, []
    for seconds, test in sorted(direct) + sorted(others):
        total += seconds
        if total < WHOLE_S / 2:
            tests.append(test)
    return tests


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


def main(folder, count, seed, only, rooms=None, tests=("test_",)):
    """Draw, plant, test, note."""
    tree = folder / "copy"
    if not (tree / "seen.json").exists():
        tree.mkdir(parents=True, exist_ok=True)
        copied(tree)
        files = sorted(p.name for p in (tree / "tests").glob("test_*.py"))
        files = [name for name in files if name.startswith(tests) and not name.startswith(UNASKED)]
        files = [f"tests/{name}" for name in files] + ["mmqa_lab"] * (tests == ("test_",))
        print("tests on the copy as it is:", in_child(tree, files, Kept(tree)))
    seen = json.loads((tree / "seen.json").read_text())
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
        drawn = list(enumerate(drawn))[len(rows) :]
    for number, (file, node, function, new) in drawn:
        start, tests = time.time(), asked(seen, file, function.strip("."))
        path = tree / "mmqa_lab" / file
        stamp = path.stat()
        old, text = planted(tree, file, node, new, number)
        try:
            code = in_child(tree, tests) if tests else 0
        finally:
            path.write_bytes(text)
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        key = (file, function.strip("."), old, new)
        word = "equivalent" if key in EQUIVALENT else "caught" if code else "passed"
        row = [file, node.lineno, function.strip("."), old, new, word, len(tests)]
        row.append(round(time.time() - start, 1))
        new_file = not table.exists()
        with table.open("a", newline="") as out:
            csv.writer(out).writerows([COLUMNS][: int(new_file)] + [row])
        print(number, *row, code, flush=True)


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
    parser.add_argument("--rooms", nargs="*", help="names of rooms that are changed")
    parser.add_argument("--tests", nargs="*", default=["test_"], help="how their files begin")
    parser.add_argument("--report", action="store_true", help="write the table of RESULTS.md")
    given = parser.parse_args()
    for name in ("pytest", "IPython", "nbformat", "xarray", "scipy.stats", "scipy.optimize",
                 "scipy.spatial", "scipy.ndimage", "scipy.interpolate", "matplotlib.pyplot",
                 "shapely", "pyproj", "laspy", "cv2", "hypothesis", "numba"):  # fmt: skip
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    if given.report:
        report(given.folder / "changes.csv")
    else:
        choices = given.only, given.rooms, tuple(given.tests)
        main(given.folder.resolve(), given.count, given.seed, *choices)
