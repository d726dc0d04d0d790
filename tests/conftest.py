"""What several test modules share."""

import os

# without compiled imports every process that a test starts takes some 6 s more
os.environ["PYTHONDONTWRITEBYTECODE"] = ""
os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("MMQA_HEADLESS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads would wait for each other
if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 0)):  # each has its share of cores
    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))

import ast
import contextlib
import functools
import ipaddress
import socket
from pathlib import Path

import nbformat
import numpy as np
import pytest
from IPython.core.inputtransformer2 import TransformerManager

from mmqa_lab import samples
from mmqa_lab.studies import chosen

collect_ignore = ["public_face.py"]  # what mypy reads is not run

TOGETHER = ("poles", "browser")
"""Files with these words are one share: one process compiles the detectors, one starts a server."""

SLOW = (
    *("poles", "browser", "[test_field]", "[chart_tables]", "[image_resolution]"),
    *("[specifications]", "[image_radiometry]", "[repeatability]", "test_lines_edges.py"),
    *("[anisotropy]", "[chart_images]", "[mimic]", "[lhd_weight]", "[fitness]", "[poles]"),
    *("test_chart_image.py", "test_commands.py", "test_students.py"),
)
"""How the names of shares end that take long: they come first, so that all processes end together.

The browser starts beside the detectors, for it needs no scanner, which these compile; the notebook
about poles comes late, when the detectors are compiled.
"""


LONG = (
    *("test_studies", "test_study_poles", "test_study_fitness", "test_students", "test_stored"),
    *("test_notebooks_shape", "test_run", "test_commands", "test_poles", "test_boresight"),
    *("test_lines_edges", "test_lines_lhd", "test_facades", "test_coverage_of_intervals"),
    *("test_chart_photographs", "test_chart_image_files", "test_chart_bent", "test_silent_images"),
    "test_types",
)
"""How the names of files begin that ``test --fast`` leaves out."""


def share(nodeid):
    """What one process tests in one go: a notebook, a file, or files that belong together."""
    if "test_notebook_runs" in nodeid:
        return nodeid
    file = nodeid.split("::")[0]
    return next((word for word in TOGETHER if word in file), file)


def pytest_itemcollected(item):
    """Mark what takes long."""
    if item.path.name.startswith(LONG):
        item.add_marker("long")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Put what takes long first."""

    def rank(item):
        name = share(item.nodeid)
        return next((k for k, end in enumerate(SLOW) if name.endswith(end)), len(SLOW))

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let processes take one share after the other."""
    from xdist.scheduler import LoadScopeScheduling

    class ByShare(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return share(nodeid)

    config.option.loadscopereorder = False  # by the number of tests
    return ByShare(config, log)


@pytest.fixture(scope="session", autouse=True)
def no_network():
    """Refuse connections beyond this machine: everything works without a network."""
    connect = socket.socket.connect

    def connect_here(self, address):
        here = self.family == socket.AF_UNIX or address[0] == "localhost"
        if not here and not ipaddress.ip_address(address[0].split("%")[0]).is_loopback:
            raise OSError(f"Invalid address {address}. Must be on this machine.")
        return connect(self, address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", connect_here)
        yield


@pytest.fixture
def real():
    """Path of a real cloud under MMQA_DATA by its relative name; skips where it is not there."""

    def find(relative):
        if not samples.has_real(relative):
            pytest.skip(f"needs {relative} in the folder that MMQA_DATA names")
        return samples.real_path(relative)

    return find


@pytest.fixture
def rng():
    """A seeded random generator."""
    return np.random.default_rng(20210112)


@pytest.fixture
def uncompiled(monkeypatch):
    """Let the compiled functions of some modules run as plain Python, for small data at once."""

    def plain(*modules):
        for module in modules:
            for name, one in list(vars(module).items()):
                if hasattr(one, "py_func"):
                    monkeypatch.setattr(module, name, one.py_func)

    return plain


def spoiled(stem, names):
    """Return which checks of a study's notebook fail where its names have these values.

    Its imports and every top-level statement with a ``run.check(...)`` are executed; a check that
    needs a name which is not given is left out.

    Parameters
    ----------
    stem : str
    names : dict
        Tables and numbers that the checks look at, some of them spoiled.

    Returns
    -------
    list of str
        Their statements.
    """
    failed = []

    class Recorder:
        def check(self, statement, passed, obtained, reason):
            if not passed:
                failed.append(statement)

        def agrees(self, *cells):
            return names.get("agrees", True)  # the ledger's verdict

        def save_table(self, *_, **__):
            pass

    known = {**names, "run": Recorder()}
    for node in _statements(stem):
        is_import = isinstance(node, ast.Import | ast.ImportFrom)
        code = compile(ast.Module([node], []), stem, "exec")
        if is_import or "run.check(" in ast.unparse(node):
            with contextlib.suppress(*(() if is_import else (NameError,))):
                exec(code, known)
    return failed


def _statements(stem):
    """The top-level statements of a study's notebook, without magics."""
    path = chosen([stem])[0].path if "." not in str(stem) else Path(stem)
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code":
            yield from ast.parse(TransformerManager().transform_cell(cell.source)).body


def targets(node, *kinds):
    """The names that parts of these kinds bind for their own statement alone."""
    bound = [part for part in ast.walk(node) if isinstance(part, kinds)]
    bound = [getattr(part, "target", None) or part.optional_vars for part in bound]
    bound = [one for one in bound if one]
    return {n.id for one in bound for n in ast.walk(one) if isinstance(n, ast.Name)}


@functools.cache
def stored(node):
    """The names that a statement sets or fills."""
    if isinstance(node, ast.FunctionDef):
        return {node.name}
    parts = list(ast.walk(node))
    places = [part for part in parts if isinstance(getattr(part, "ctx", None), ast.Store)]
    calls = [part.func for part in parts if isinstance(part, ast.Call)]
    filled = {"append", "extend", "update"}
    places += [c.value for c in calls if isinstance(c, ast.Attribute) and c.attr in filled]
    names = {getattr(getattr(place, "value", place), "id", "") for place in places}
    return names - targets(node, ast.comprehension)


@functools.cache
def loaded(node):
    """The names that a statement reads from above."""
    parts = list(ast.walk(node))
    own = {part.arg for part in parts if isinstance(part, ast.arg)}
    own |= targets(node, ast.comprehension, ast.For, ast.withitem)
    if isinstance(node, ast.FunctionDef):
        own |= {n.id for n in parts if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    read = {n.id for n in parts if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
    return read - own
