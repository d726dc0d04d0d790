"""Edges of clouds of the second street generator, displacements of the tests' town and the canyon.

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/edges.py`` writes its section of
RESULTS.md; ``--seeds`` and ``--length`` make it smaller.
"""

import argparse
import time

import numpy as np
import pandas as pd
from facades import covered, held_across, score, street_of_facades
from results import write_section
from scipy.stats import chi2
from towns import town

from mmqa_lab import lines
from mmqa_lab.lines.edges import Edges
from mmqa_lab.simulate.canyon import COMPARISONS, canyon

DENSITIES = {(300, True): 1, (60, False): 1, (10, False): 3}
"""Points per square metre, whether walls have windows, and how many times as many streets, since
thin clouds show few edges."""

MOVES = (0.5, 0.0, 0.0), (3.0, 0.0, 0.0), (3.0, 1.5, 0.0), (2.0, 1.5, 0.3)


def edges(density, windows, seed, length):
    """Recall and true length of the edges of one street; whether their ellipses hold the truth."""
    street = street_of_facades(seed, length, windows)
    points = covered(street, density, 0.01, np.random.default_rng(seed))
    began = time.process_time()
    found = lines.extract_edges(points)
    used = time.process_time() - began
    figures = score(found.segments, street.faces, points, 0.01)
    named = {name: figures[name] for name in ("recall", "true_length", "ends_median_m")}
    held = held_across(found, street.faces).mean()
    middle = found.segments.mean(axis=1)
    low = (np.abs(middle[:, 0]) < 3.4) & (middle[:, 2] > 0.02) & (middle[:, 2] < 1.6)
    cars = held_across(Edges(found.segments[low], found.covariance[low]), street.faces).mean()
    held = {"covered": held, "cars' edges covered": cars}
    return {"scene": f"edges, {density} points/m2", **named, "s": used, **held}


def displaced(scene, test, model, truth, moves):
    """F1 of the pairs, 0 where there are none; whether the ellipsoid has their displacement.

    ``moves`` (p, 3) are those of the test segments.
    """
    began = time.process_time()
    match = lines.match_displaced(test, model)
    used = time.process_time() - began
    error = match.vector - moves[np.nonzero(match.pairs)[0]].mean(axis=0)
    square = error @ np.linalg.pinv(np.nan_to_num(match.covariance)) @ error
    inside = np.nan if np.isnan(square) else float(square < chi2.ppf(0.95, 3))
    f1 = np.nan_to_num(lines.pairing_scores(match.pairs, truth).f1)
    return {"scene": scene, "f1": f1, "covered": inside, "s": used}


def main():
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--length", type=float, default=30.0)
    options = parser.parse_args()
    rows = [
        edges(*kind, seed, options.length)
        for kind, times in DENSITIES.items()
        for seed in range(times * options.seeds)
    ]
    for move in MOVES:
        for seed in range(5 * options.seeds):
            test, model, truth, moves = town(seed, *move)
            said = "town, {} m, {} degrees, drift {} m".format(*move)
            rows.append(displaced(said, test, model, truth, moves))
    for seed in range(60000, 60000 + 5 * options.seeds):
        scene = canyon(seed)
        for names in COMPARISONS["absolute"]:
            test, model = (scene.surveys[name] for name in names)
            sets = test.segments, model.segments
            rows.append(displaced("canyon", *sets, scene.pairs(*names), test.displacement))
    table = pd.DataFrame(rows).groupby("scene", sort=False).mean()
    print(table.round(3).to_string())
    write_section("Lines and edges", table)


if __name__ == "__main__":
    main()
