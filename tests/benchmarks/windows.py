"""Displaced line sets of streets with rows of windows: are they matched, and is a failure said?

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/windows.py`` writes its section of
RESULTS.md; ``--scenes FIRST NUMBER`` makes it smaller. An answer is silently wrong if its F1 is
below 0.5 or the displacement is off by more than 0.5 m, and nothing is said.
"""

import argparse
import time

import numpy as np
import pandas as pd
import window_rows
from results import write_section

from mmqa_lab import lines

KINDS = {
    "shifts to 3 m, 3 degrees, drift to 0.8 m": {},
    "the same without drift": {"drift": 0.0},
    "few lines: 20 m, 15 to 35 % seen": {"length": 20.0, "share": None},
}


def outcome(seed, choices):
    """F1 of a scene, whether it was answered, whether the answer is wrong, processor time (s)."""
    choices = dict(choices)
    if "share" in choices:
        choices["share"] = np.random.default_rng(seed).uniform(0.15, 0.35)
    test, model, truth, _ = window_rows.scene(seed, **choices)
    began = time.process_time()
    match = lines.match_displaced(test, model)
    used = time.process_time() - began
    f1 = np.nan_to_num(lines.pairing_scores(match.pairs, truth).f1)
    right = lines.fit_displacement(test, model, truth)
    off = np.linalg.norm(match.vector - right.vector)
    return {"F1": f1, "answered": match.n > 0, "wrong": match.n > 0 and (f1 < 0.5 or off > 0.5),
            "s": used}  # fmt: skip


def main():
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs=2, type=int, default=(10_000, 200))
    first, number = parser.parse_args().scenes
    rows = []
    for scenes, choices in KINDS.items():
        n = number if not choices else number // 4
        found = pd.DataFrame([outcome(seed, choices) for seed in range(first, first + n)])
        row = {"scenes": scenes, "n": n, "F1, mean": found["F1"].mean(), "least": found["F1"].min()}
        row |= {"answered": found["answered"].sum(), "silently wrong": found["wrong"].sum()}
        rows.append({**row, "s": found["s"].mean()})
    write_section("Lines of rows of windows, displaced", pd.DataFrame(rows))


if __name__ == "__main__":
    main()
