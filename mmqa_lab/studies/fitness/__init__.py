"""Fit for what? Metrics of a chart beside what can be done with a cloud of the same acquisition."""

from functools import lru_cache

import numpy as np
import pandas as pd

from mmqa_lab import bench as benches
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.studies.fitness.acquisitions import (
    RANGES,
    SQUARE,
    acquisitions,
    beam_radius,
    drive,
)  # fmt: skip
from mmqa_lab.studies.fitness.comparison import (
    advice,
    by_kind,
    contradictions,
    correlations,
    halves,
    matrix,
    measured,
    thresholds,
    winners,
    written,
)  # fmt: skip
from mmqa_lab.studies.fitness.real import real_boards, road_squares
from mmqa_lab.studies.fitness.tasks import FREE, GOOD, TASKS, errors_of

__all__ = [
    "FREE", "GOOD", "RANGES", "TASKS", "acquisitions", "advice", "bench", "by_kind",
    "contradictions", "correlations", "drive", "halves", "make", "matrix", "measured",
    "real_boards", "road_squares", "thresholds", "winners", "written",
]  # fmt: skip


@lru_cache(maxsize=1000)
def make(draw, number, *, seed, **case):
    """Return the chart of an acquisition, a CloudQuality, and the errors of its tasks, a dict."""
    rng = np.random.default_rng([seed, draw, number])
    points, surface, axes = drive(case, rng)
    again = drive(case, rng, only="corner")[0]["corner"]
    beam_m = beam_radius(case)
    choices = {"beam_m": beam_m, "turn": 2 * np.pi * rng.random(), "seed": [draw, number]}
    errors = errors_of(points, surface, again, **choices)
    ring = chart_polygon(SQUARE @ axes["chart"])
    chart = evaluate_cloud(points["chart"] @ axes["chart"], polygon=ring)
    chart.pattern  # noqa: B018 made here, it is shared by the copies that metrics get
    return chart, errors


def bench(*, methods=None, count=8, draws=(41, 42), seed=2000):
    """Define the study's bench: metrics of charts, and the tasks of the same acquisitions.

    Parameters
    ----------
    methods : dict, optional
        Functions of a :class:`~mmqa_lab.chart_cloud.CloudQuality`; by default
        :data:`mmqa_lab.metrics.METRICS`. Of others less is better.
    count : int
        Acquisitions of each kind in each draw.
    draws : tuple of int
        Seeds of the acquisitions.
    seed : int
        Seed of the drives.

    Returns
    -------
    Comparison
    """
    tables = [acquisitions(count, seed=draw) for draw in draws]
    cases = pd.concat(tables, ignore_index=True)

    def told(results):
        found = correlations(*measured(results))
        return {"tasks": matrix(found), "correlations": found}

    choices = {"seeds": [seed], "tables": told}
    return benches.Comparison(cases, dict(methods or METRICS), make, **choices)
