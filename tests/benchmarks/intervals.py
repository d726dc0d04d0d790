"""How often 95 % intervals contain the truth: write the table of the README.

``PYTHONPATH=tests python tests/benchmarks/intervals.py`` runs every simulation of
``tests/covered.py`` in full, some minutes of processor time. ``--folder`` keeps finished draws, so
that a run that was stopped goes on; names of estimates run only these and print their rows.
"""

import argparse
from pathlib import Path

import pandas as pd
from covered import ESTIMATES, shares, simulated

from mmqa_lab.io import write_atomically
from mmqa_lab.run.pages import replaced

README = Path(__file__).resolve().parents[2] / "README.md"


def main():
    """Simulate, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="estimates; all, and the README, where none")
    parser.add_argument("--folder", type=Path, help="where finished draws are kept")
    options = parser.parse_args()
    parts = []
    for estimate in ESTIMATES:
        if options.names and estimate.name not in options.names:
            continue
        folder = options.folder and options.folder / estimate.name.replace(" ", "_")
        parts.append(shares(estimate, simulated(estimate, estimate.many, folder)))
        print(parts[-1].round(3).to_string(index=False, header=False), flush=True)
    if options.names:
        return
    table = pd.concat(parts).rename(columns={"low": "from", "high": "to"})
    for name in ("coverage", "from", "to", "least case", "largest case"):
        table[name] = table[name].map("{:.3f}".format)
    text = replaced(README.read_text(encoding="utf-8"), "coverage", table.to_markdown(index=False))
    write_atomically(README, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    main()
