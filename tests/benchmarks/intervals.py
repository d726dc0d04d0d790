"""How often 95 % intervals contain the truth, over every simulation of ``tests/covered.py``.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/intervals.py`` takes some minutes of
processor time and writes its section of RESULTS.md; with names of estimates it prints only these.
"""

import argparse

import pandas as pd
from covered import ESTIMATES, shares, simulated
from results import write_section


def main():
    """Simulate, print, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="estimates; all where none")
    parser.add_argument("--draws", type=int, help="of each case, instead of the usual number")
    options = parser.parse_args()
    parts = []
    for estimate in ESTIMATES:
        if not options.names or estimate.name in options.names:
            rows = simulated(estimate, options.draws or estimate.many)
            parts.append(shares(estimate, rows))
            print(parts[-1].round(3).to_string(index=False, header=False), flush=True)
    if not options.names:
        write_section("Intervals", pd.concat(parts))


if __name__ == "__main__":
    main()
