"""How often 95 % intervals contain the truth, over every simulation of ``tests/covered.py``.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/intervals.py`` takes some minutes of
processor time and writes its section of RESULTS.md; with the beginning of a name, as ``board``,
those estimates only, into a section of their own.
"""

import argparse

import pandas as pd
from covered import ESTIMATES, shares, simulated
from results import write_section


def main():
    """Simulate, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="?", default="", help="beginning of estimates' names")
    parser.add_argument("--draws", type=int, help="of each case, instead of the usual number")
    options = parser.parse_args()
    parts = []
    for estimate in ESTIMATES:
        if estimate.name.startswith(options.name):
            rows = simulated(estimate, options.draws or estimate.many)
            parts.append(shares(estimate, rows))
            print(parts[-1].round(3).to_string(index=False, header=False), flush=True)
    title = f"Intervals: {options.name}" if options.name else "Intervals"
    write_section(title, pd.concat(parts))


if __name__ == "__main__":
    main()
