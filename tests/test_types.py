"""Types: what is annotated is true, and every name of the public face is annotated."""

import subprocess
import sys
from pathlib import Path

import mmqa_lab

ROOT = Path(mmqa_lab.__file__).parent.parent

LIES = """
from mmqa_lab import spacing

text: str = spacing.quadrants([[0, 0], [1, 0]]).f


def neighbours(xy: list) -> float:
    return spacing.quadrants(xy).d
"""


def test_what_is_annotated_is_true_in_the_package_and_for_its_readers(tmp_path):
    (tmp_path / "lies.py").write_text(LIES, encoding="utf-8")
    files = ["mmqa_lab", "tests/public_face.py", str(tmp_path / "lies.py")]
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path), "--no-error-summary"]
    done = subprocess.run([*command, *files], capture_output=True, text=True, cwd=ROOT)
    found = [line for line in done.stdout.splitlines() if ": note: " not in line]
    assert [line.rpartition("[")[2] for line in found] == ["assignment]", "return-value]"], found
    assert all("lies.py:" in line for line in found)
