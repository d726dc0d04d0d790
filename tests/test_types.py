"""Types: what is annotated is true, and every name of the public face is annotated."""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import NumpyVersion

import mmqa_lab

PACKAGE = Path(mmqa_lab.__file__).parent
ROOT = PACKAGE.parent

LIES = """
from mmqa_lab import spacing

text: str = spacing.quadrants([[0, 0], [1, 0]]).f


def neighbours(xy: list) -> float:
    return spacing.quadrants(xy).d
"""


@pytest.mark.skipif(NumpyVersion(np.__version__) < "2.4.0", reason="older stubs know less")
def test_what_is_annotated_is_true_in_the_package_and_for_its_readers(tmp_path):
    (tmp_path / "lies.py").write_text(LIES, encoding="utf-8")
    files = ["mmqa_lab", "tests/public_face.py", str(tmp_path / "lies.py")]
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path), "--no-error-summary"]
    done = subprocess.run([*command, *files], capture_output=True, text=True, cwd=ROOT)
    found = [line for line in done.stdout.splitlines() if ": note: " not in line]
    assert [line.rpartition("[")[2] for line in found] == ["assignment]", "return-value]"], found
    assert all("lies.py:" in line for line in found)


def public():
    """Every function and method that a room's ``__all__`` offers, once."""
    found = {}
    for name in rooms():
        module = importlib.import_module(name)
        for thing in (getattr(module, one) for one in module.__all__):
            parts = vars(thing).values() if inspect.isclass(thing) else [thing]
            for part in (getattr(one, "fget", None) or one for one in parts):
                part = getattr(part, "__func__", part)  # of a class method
                if inspect.isfunction(part) and part.__name__[0] != "_":
                    found[f"{part.__module__}.{part.__qualname__}"] = part
    return found


def rooms():
    """The rooms that a reader enters by name, and the files of those with several subjects."""
    listed = re.findall(r"^- ``([a-z]\w+)``: ", mmqa_lab.__doc__, re.MULTILINE)
    inside = [f"mmqa_lab.{name}" for name in listed if name not in ("studies", "run", "commands")]
    files = [f"mmqa_lab.simulate.{path.stem}" for path in (PACKAGE / "simulate").glob("[a-z]*.py")]
    return [*inside, *files, "mmqa_lab.scan_pattern.mimic"]


def test_every_public_name_is_annotated():
    faces = public()
    assert len(faces) > 250
    for name, face in faces.items():
        hints = inspect.signature(face)
        parameters = [one for one in hints.parameters.values() if one.name not in ("self", "cls")]
        assert hints.return_annotation is not hints.empty, f"{name} returns what?"
        assert not [one.name for one in parameters if one.annotation is one.empty], name
