"""Edges of clouds of the second street generator: recall, true length, ends.

``PYTHONPATH=tests python tests/benchmarks/edges.py`` prints a row for each scene.
"""

import argparse
import time

import numpy as np
import pandas as pd
from facades import covered, score, street_of_facades
from other_street import scan

from mmqa_lab import lines

DENSE = {"windows, 300 points/m2": (300, True), "no windows, 300": (300, False)}
DENSE |= {f"no windows, {density}": (density, False) for density in (5, 10, 20, 60)}


def scene(kind, seed, length):
    """Faces, points and noise of a scene."""
    if kind in DENSE:
        density, windows = DENSE[kind]
        street = street_of_facades(seed, length, windows)
        return street.faces, covered(street, density, 0.01, np.random.default_rng(seed)), 0.01
    street = street_of_facades(seed, length, kind.endswith("windows"))
    return street.faces, scan(street, kind.split(",")[0], seed)[0], 0.006


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="*", default=[*DENSE, "tilted profiler, windows"])
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--length", type=float, default=30.0)
    parser.add_argument("--sizes", type=float, nargs="*", default=[None])
    options = parser.parse_args()
    rows = []
    for kind in options.kinds:
        for seed in options.seeds:
            faces, points, noise = scene(kind, seed, options.length)
            for size in options.sizes:
                began = time.process_time()
                found = lines.extract_edges(points, size=size)
                used = time.process_time() - began
                figures, _, _ = score(found.segments, faces, points, noise)
                head = {"scene": kind, "size": size, "seed": seed, "points": len(points), "s": used}
                rows.append(head | figures)
                last = pd.DataFrame(rows[-1:]).round(3)
                print(last.to_string(index=False, header=len(rows) == 1), flush=True)
    table = (
        pd.DataFrame(rows)
        .groupby(["scene", "size"], sort=False, dropna=False)
        .mean(numeric_only=True)
    )
    print(table.round(3).to_string())


if __name__ == "__main__":
    main()
