"""Measure commands beside another version of this package, and write the table of the README.

Processor time (user and system) of whole processes and their children: warm, the least of the
repeats, and once with an empty cache of compiled code. The other version runs in the environment
that it made in its checkout, or else in this one.

    git worktree add /tmp/before a7a4e3e
    (cd /tmp/before && python3 -m mmqa_lab names)
    python tests/benchmarks/versions.py /tmp/before --markdown README.md
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from mmqa_lab.io import write_cloud
from mmqa_lab.run.pages import replaced
from mmqa_lab.simulate.canyon import canyon, canyon_cloud

HERE = Path(__file__).resolve().parents[2]

SAMPLES = HERE / "data_samples"

CALLS = {
    "mmqa --help": ["--help"],
    "mmqa evaluate, 4,014 points": ["evaluate", str(SAMPLES / "chart_a_5m.laz")],
    "mmqa evaluate, 28,185 points": ["evaluate", str(SAMPLES / "road_patch.laz")],
    "mmqa map": ["map", str(SAMPLES / "road_patch.laz"), "--out", "map.nc"],
    "mmqa lhd, 2 x 100,000 points": ["lhd", "{folder}/C1.laz", "{folder}/TLS.laz"],
    "mmqa poles": ["poles", str(SAMPLES / "road_patch.laz")],
}


def spent(root, words, cache):
    """Processor seconds of a command in a version, children included."""
    place = {**os.environ, "PYTHONPATH": str(root), "NUMBA_CACHE_DIR": cache}
    place.pop("PYTHONDONTWRITEBYTECODE", None)  # a user's Python keeps compiled imports
    python = root / ".venv" / "bin" / "python"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        command = [str(python) if python.exists() else sys.executable, "-m", "mmqa_lab", *words]
        done = subprocess.run(command, cwd=folder, env=place, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def canyons(folder):
    """Write a pass through a simulated street and its reference."""
    scene = canyon(1)
    for name in ("C1", "TLS"):
        write_cloud(f"{folder}/{name}.laz", canyon_cloud(scene, name, density=100_000 / 14_770))


def compare(before, names, repeats, data):
    """Rows (command, state, seconds before, seconds now); both versions in turn."""
    for name in names:
        words = [word.format(folder=data) for word in CALLS[name]]
        with tempfile.TemporaryDirectory() as old, tempfile.TemporaryDirectory() as new:
            versions = ((before, old), (HERE, new))
            first = [spent(root, words, cache) for root, cache in versions]
            warm = [[spent(root, words, cache) for root, cache in versions] for _ in range(repeats)]
        least = [min(costs) for costs in zip(*warm, strict=True)]
        for state, cost in (("first call", first), ("warm", least)):
            print(f"{name:32}{state:12}{cost[0]:7.2f} s{cost[1]:7.2f} s", flush=True)
            yield name, state, *cost


def markdown(rows):
    """The rows as a table for the README."""
    lines = ["| command | call | 0.1 (s) | now (s) | ratio |", "|---|---|---|---|---|"]
    lines += [
        f"| `{name}` | {state} | {old:.2f} | {new:.2f} | {new / old:.2f} |"
        for name, state, old, new in rows
    ]
    return "\n".join(lines)


def main():
    """Print the rows, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", type=Path, metavar="FOLDER", help="checkout of the other version")
    parser.add_argument("--only", nargs="+", choices=CALLS, metavar="COMMAND")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write between its marks")
    options = parser.parse_args()
    names, rows = [name for name in CALLS if not options.only or name in options.only], []
    with tempfile.TemporaryDirectory() as data:
        canyons(data)
        for row in compare(options.before.resolve(), names, options.repeats, data):
            rows.append(row)
            if options.markdown:  # a run that is stopped leaves what it has measured
                text = options.markdown.read_text(encoding="utf-8")
                text = replaced(text, "versions", markdown(rows))
                options.markdown.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
