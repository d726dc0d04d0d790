"""Transfer: what a chart says of things elsewhere on its street, predicted beside realised."""

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.scan_pattern import ScanSetup, Target, scan_lattice
from mmqa_lab.studies.fitness.acquisitions import KINDS, SQUARE, acquisitions, drive

__all__ = ["CHART_AT", "FACADES", "METRICS_MOVED", "PREDICTIONS", "STREET", "predicted", "reach"]
__all__ += ["street", "summary"]

CHART_AT = (8.0, 0.0)
"""Distance of the chart, m, and its turn from the road, degrees."""

STREET = tuple(
    (far, turn) for far in (4.0, 6.0, 8.0, 10.0, 14.0, 20.0) for turn in (0.0, 30.0, -50.0)
)
"""Distances and turns of the things along the street."""

FACADES = tuple(
    (far, turn)
    for far in (8.0, 5.0, 12.0, 6.5, 16.0, 10.0, 20.0, 8.0)
    for turn in (0.0, 30.0, -50.0)
)
"""Distances and turns of the facades on the map, in their order along the street."""

METRICS_MOVED = ("noise_of_a_mean", "e95")

PREDICTIONS = ("the chart's", "by distance", "by distance and turn", "by the lattice")
"""Ways of a prediction: the chart's value as it is; density as 1 / distance (of images 1 / distance
squared); the same times cos(turn); the density of the scan lattice of one head."""

WITHIN = 0.2
"""A chart speaks for a thing whose metric lies within so much of the prediction."""


def predicted(case, far, turn_deg):
    """Return what a chart's metric is multiplied with to hold elsewhere, by ``PREDICTIONS``.

    Both metrics go with the root of the mean area of a point, for noise and shape of the pattern
    are taken to stay; by the lattice e95 is that of its steps.
    """
    near, own = CHART_AT
    power = 2 if case["kind"] == "images" else 1
    farther, turned = (far / near) ** power, np.cos(np.radians(own)) / np.cos(np.radians(turn_deg))
    moved = [1.0, np.sqrt(farther), np.sqrt(farther * turned), np.nan]
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


def street(count=1, *, places=STREET, seed=3001, kinds=None):
    """Return metrics of things along streets, predicted from a chart and realised.

    Parameters
    ----------
    count : int
        Acquisitions of each kind.
    places : sequence of (float, float)
        Distances and turns of the things.
    seed : int
        Of the drives.
    kinds : sequence of str, optional
        Of the acquisitions; by default all.

    Returns
    -------
    DataFrame
        ``kind``, ``number``, ``distance_m``, ``turn_deg``, ``metric``, ``prediction`` (its name),
        ``predicted`` and ``realised``.
    """
    rows = []
    # that density goes with distance alone was seen on draw 51, so another one is scored
    cases = acquisitions(count, seed=52)
    for case in cases[cases["kind"].isin(kinds or KINDS)].to_dict("records"):
        rng = np.random.default_rng([seed, case["number"]])
        chart, known = _board(case, *CHART_AT, rng), {}
        for far, turn in places:
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
    chart = evaluate_cloud(points["board"] @ axes["board"], polygon=SQUARE @ axes["board"])
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
    share = groups.apply(lambda one: (np.abs(np.log(one)) < np.log(1 + WITHIN)).mean())
    return found.assign(within_20_percent=share, n=groups.size()).reset_index()


def reach(table):
    """Return between which distances each prediction speaks for its street, at each turn.

    Returns
    -------
    DataFrame
        ``metric``, ``prediction``, ``turn_deg``, ``from_m`` and ``to_m``: the ends of the distances
        about the chart's own at which at least 80 % of the things lie within
        ``WITHIN`` of the prediction; NaN where not even those at its own distance do.
    """
    rows = []
    found = summary(table, ("metric", "prediction", "turn_deg", "distance_m"))
    for names, part in found.groupby(["metric", "prediction", "turn_deg"], sort=False):
        part = part.sort_values("distance_m")
        good, far = part["within_20_percent"].to_numpy() >= 0.8, part["distance_m"].to_numpy()
        bad = np.concatenate([[0], far[~good], [np.inf]])
        low, high = bad[bad <= CHART_AT[0]].max(), bad[bad >= CHART_AT[0]].min()
        same = far[(far > low) & (far < high)]
        rows.append((*names, *(same[[0, -1]] if len(same) else (np.nan, np.nan))))
    return pd.DataFrame(rows, columns=["metric", "prediction", "turn_deg", "from_m", "to_m"])
