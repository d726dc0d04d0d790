"""Is the metric that README advises the best one on boards of another generator?

``PYTHONPATH=tests:tests/benchmarks python tests/benchmarks/fitness.py`` writes its section of
RESULTS.md. Thresholds come from a random half of the boards, scores from the other half, as in
study 12; ``behind`` is how much the best of all metrics has more. In brackets stands what is not
advised, since real clouds contradict it.
"""

import warnings

import numpy as np
import other_clouds
import pandas as pd
from results import write_section

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.studies.fitness import halves

COUNT = 30
RING = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])


def measured(count=COUNT, seed=2):
    """The metrics of charts, less being better, and the errors of tasks on other boards."""
    values, errors = [], []
    for k, kind in enumerate(other_clouds.KINDS):
        for number in range(count):
            rng = np.random.default_rng([seed, k, number])
            case = other_clouds.draw(kind, rng)
            places, noise = other_clouds.board(kind, case, *case["chart"], rng)
            thing = other_clouds.board(kind, case, case["far"], case["turn"], rng)
            errors.append(other_clouds.tasks(*thing, case["wide"] * case["far"] / 2, rng))
            enough = len(places) >= 10
            chart = evaluate_cloud(np.column_stack([places, noise]), polygon=RING) if enough else 0
            values.append({n: m(chart) if enough else np.nan for n, m in METRICS.items()})
    figures, errors = pd.DataFrame(values), pd.DataFrame(errors)
    return figures.apply(lambda one: METRICS[one.name].worst_last(one)), errors


def main():
    """Write the table."""
    with warnings.catch_warnings(action="ignore"):
        figures, errors = measured()
    found = halves(figures, errors, good=other_clouds.LIMITS)
    rows = []
    for task, part in found.groupby("task", sort=False):
        part = part.set_index("method")
        best = part["balanced"].idxmax()
        own = part.loc[other_clouds.ADVISED.get(task, "noise_of_a_mean")]
        advised = own.name if task in other_clouds.ADVISED else f"({own.name})"
        row = {"task": task, "fit": f"{own['fit']} of {own['n']}", "advised": advised}
        row |= {"balanced accuracy": own["balanced"], "low": own["low"], "high": own["high"]}
        row |= {"best": best, "of the best": part["balanced"].max(), "behind": own["behind"]}
        row |= {name: part.loc[name, "balanced"] for name in ("density", "sigma_mad", "f")}
        rows.append(row)
    table = pd.DataFrame(rows)
    print((table["behind"] <= 0.03).sum(), "of", len(table), "within .03 of the best")
    write_section("Metrics on another generator", table)


if __name__ == "__main__":
    main()
