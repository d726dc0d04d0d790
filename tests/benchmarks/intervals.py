"""How often 95 % intervals contain the truth: write the table of the README.

``PYTHONPATH=tests python tests/benchmarks/intervals.py`` runs every simulation of
``tests/covered.py`` in full, some minutes of processor time. ``--folder`` keeps finished draws, so
that a run that was stopped goes on; names of estimates run only these and replace their rows.
"""

import argparse
from pathlib import Path

import pandas as pd
from covered import ESTIMATES, shares, simulated

from mmqa_lab.io import write_atomically
from mmqa_lab.run.pages import markdown_table, replaced

README = Path(__file__).resolve().parents[2] / "README.md"


def main():
    """Simulate, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="estimates; all where none")
    parser.add_argument("--folder", type=Path, help="where finished draws are kept")
    parser.add_argument("--draws", type=int, help="of each case, instead of the usual number")
    options = parser.parse_args()
    parts = []
    for estimate in ESTIMATES:
        if options.names and estimate.name not in options.names:
            continue
        folder = options.folder and options.folder / estimate.name.replace(" ", "_")
        rows = simulated(estimate, options.draws or estimate.many, folder)
        parts.append(shares(estimate, rows))
        print(parts[-1].round(3).to_string(index=False, header=False), flush=True)
    write(pd.concat(parts))


def write(found):
    """Put rows into the table of the README, those of the same estimates make room."""
    table = found.rename(columns={"low": "from", "high": "to"})
    for name in ("coverage", "from", "to", "least case", "largest case"):
        table[name] = table[name].map("{:.3f}".format)
    new = {"head": markdown_table(table).splitlines()[:2]}
    text = README.read_text(encoding="utf-8")
    old = text.split("<!-- coverage -->")[1].split("<!-- end coverage -->")[0]
    for line in old.strip().splitlines()[2:]:
        new.setdefault(line.split(" | ")[0], []).append(line)
    fresh = {}
    for line in markdown_table(table).splitlines()[2:]:
        fresh.setdefault(line.split(" | ")[0], []).append(line)
    new |= fresh
    order = ["head", *(f"| {one.name}" for one in ESTIMATES)]
    lines = [line for name in order for line in new.get(name, [])]
    text = replaced(text, "coverage", "\n".join(lines))
    write_atomically(README, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
