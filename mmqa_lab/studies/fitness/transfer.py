"""Transfer: what a chart says of things elsewhere on its street, predicted beside realised."""

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
from mmqa_lab.studies.fitness.acquisitions import acquisitions, drive

__all__ = ["CHART_AT", "METRICS_MOVED", "PREDICTIONS", "STREET", "predicted", "street", "summary"]

CHART_AT = (8.0, 0.0)
"""Distance of the chart, m, and its turn from the road, degrees."""

STREET = tuple((far, turn) for far in (4.0, 8.0, 12.0, 18.0, 25.0) for turn in (0.0, 30.0, -50.0))
"""Distances and turns of the things along the street."""

METRICS_MOVED = ("noise_of_a_mean", "e95")

PREDICTIONS = ("the chart's", "by distance and turn", "by the lattice")
"""Ways of a prediction: the chart's value as it is; density as cos(turn) / distance (of images
cos(turn) / distance squared); the density of the scan lattice of one head."""


def predicted(case, far, turn_deg):
    """Return what a chart's metric is multiplied with to hold elsewhere, by ``PREDICTIONS``.

    Both metrics go with the root of the mean area of a point, for noise and shape of the pattern
    are taken to stay; by the lattice e95 is that of its steps.
    """
    near, own = CHART_AT
    power = 2 if case["kind"] == "images" else 1
    sparser = (far / near) ** power * np.cos(np.radians(own)) / np.cos(np.radians(turn_deg))
    moved = [1.0, np.sqrt(sparser), np.nan]
    found = {name: dict(zip(PREDICTIONS, moved, strict=True)) for name in METRICS_MOVED}
    if case["kind"] in ("one head", "two drives"):
        setup = ScanSetup(
            pulse_rate_hz=case["pulse_rate_hz"], mirror_frequency_hz=case["mirror_frequency_hz"],
            speed_m_s=case["speed_kmh"] / 3.6, scanner_heading_deg=case["heading_deg"],
            scanner_tilt_deg=case["tilt_deg"],
        )  # fmt: skip
        two = [
            scan_lattice(setup, Target(heading_deg=-turn, range_m=distance))
            for distance, turn in (CHART_AT, (far, turn_deg))
        ]
        ratio = two[0].density_per_m2 / two[1].density_per_m2
        found["noise_of_a_mean"]["by the lattice"] = float(np.sqrt(ratio))
        found["e95"]["by the lattice"] = _lattice_e95(two[1]) / _lattice_e95(two[0])
    return found


def _lattice_e95(lattice):
    """95 % of the places between the points of a lattice have one this near, m."""
    steps = np.stack([lattice.a, lattice.b])
    places = np.outer(np.arange(2000), (0.7548776662, 0.5698402910)) % 1
    reach = np.arange(-30, 31)
    corners = np.stack(np.meshgrid(reach, reach[27:34]), axis=-1).reshape(-1, 2) @ steps
    return float(np.quantile(cKDTree(corners).query(places @ steps)[0], 0.95))


def street(count=1, *, draw=51, seed=3000):
    """Return metrics of things along streets, predicted from a chart and realised.

    Parameters
    ----------
    count : int
        Acquisitions of each kind; distances and turns are those of ``STREET``.
    draw, seed : int
        Of the acquisitions and of the drives.

    Returns
    -------
    DataFrame
        ``kind``, ``number``, ``distance_m``, ``turn_deg``, ``metric``, ``prediction`` (its name),
        ``predicted`` and ``realised``.
    """
    rows = []
    for case in acquisitions(count, seed=draw).to_dict("records"):
        rng = np.random.default_rng([seed, case["number"]])
        chart, known = _board(case, *CHART_AT, rng), {}
        for far, turn in STREET:
            thing = _board(case, far, turn, rng)
            factors = predicted(case, far, turn)
            for name in METRICS_MOVED:
                known = {"kind": case["kind"], "number": case["number"], "distance_m": far}
                known |= {"turn_deg": turn, "metric": name, "realised": thing[name]}
                for way, factor in factors[name].items():
                    rows.append(known | {"prediction": way, "predicted": factor * chart[name]})
    return pd.DataFrame(rows)


def _board(case, far, turn_deg, rng):
    """The metrics of a board of 1 m; NaN with fewer than ten points."""
    placed = case | {"distance_m": far, "turn_deg": turn_deg, "elsewhere": False}
    points, _, axes = drive(placed, rng, only="board")
    if len(points["board"]) < 10:
        return dict.fromkeys(METRICS_MOVED, np.nan)
    ring = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    chart = evaluate_cloud(points["board"] @ axes["board"], polygon=ring @ axes["board"])
    return {name: METRICS[name](chart) for name in METRICS_MOVED}


def summary(table, by=("metric", "prediction")):
    """Return how realised values lie about predicted ones.

    Returns
    -------
    DataFrame
        For each group: ``ratio``, the median of realised over predicted, with ``low`` and ``high``
        (95 % of the things), ``within_20_percent`` and ``n``.
    """
    known = table.dropna(subset=["predicted", "realised"])
    ratio = (known["realised"] / known["predicted"]).rename("ratio")
    groups = ratio.groupby([known[name] for name in by], sort=False)
    found = (
        groups.quantile([0.5, 0.025, 0.975]).unstack().set_axis(["ratio", "low", "high"], axis=1)
    )
    share = groups.apply(lambda one: ((one > 1 / 1.2) & (one < 1.2)).mean())
    return found.assign(within_20_percent=share, n=groups.size()).reset_index()
