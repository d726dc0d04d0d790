"""Simulated surveys: streets driven once, detected by each method, scored together."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from tqdm.auto import tqdm

from mmqa_lab import poles, stats
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import itc, walls
from mmqa_lab.poles.table import drop_duplicates
from mmqa_lab.simulate import streets

CLASSES = ("tree", "sign", "lamp", "other")
RANGES_M = (0, 5, 7.5, 10, 12.5, 15, 20, 25, 30)
FACADE_RANGES_M = (0, 10, 15, 20, 25, 30)
FACADE_SCORES = ("completeness", "correctness", "quality")
GATES_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)


@dataclass(frozen=True, eq=False)
class Survey:
    """One street, its cloud, and what methods found.

    Parameters
    ----------
    street : mmqa_lab.simulate.streets.Street
    cloud : Cloud
    targets : DataFrame
        With what the cloud shows of each.
    path : array, shape (m, 3)
        Of the vehicle.
    found : dict of str to DataFrame
        All candidates of each method, with ``rejected_by``.
    """

    street: object
    cloud: Cloud
    targets: pd.DataFrame
    path: np.ndarray
    found: dict = field(default_factory=dict)

    def detect(self, method, *, name=None, **thresholds):
        """Run a method and keep its candidates under its name."""
        made = poles.detect(self.cloud, method=method, explain=True, **thresholds)
        self.found[name or method] = made
        return made

    def poles(self, name):
        """Return the detections: candidates that no test rejected."""
        candidates = self.found[name]
        return candidates[candidates["rejected_by"] == ""].reset_index(drop=True)

    def score(self, name, *, corridor, gate=0.5):
        """Return the score of a method's detections within a corridor."""
        choices = {"corridor": corridor, "gate": gate, "trajectory": self.path}
        return poles.score(self.poles(name), self.targets, **choices)

    def outcomes(self, name, *, corridor):
        """Return the tables of hits, misses and false alarms, duplicates among them, by name."""
        result = self.score(name, corridor=corridor)
        made = result.detections
        missed = result.targets["target"] & ~result.targets["found"]
        return {
            "hit": made[made["outcome"] == "hit"],
            "miss": result.targets[missed],
            "false alarm": made[made["outcome"].isin(["false", "duplicate"])],
        }


def drive_all(plan, scanner, seeds, *, length, speed):
    """Return a ``Survey`` for each seed; arguments as for ``streets.street`` and ``drive``."""
    made = []
    for seed in tqdm(seeds, unit="street", desc="drive", leave=False):
        street = streets.street(plan, length=length, seed=seed)
        cloud = streets.drive(street, scanner, seed=seed, speed=speed)
        targets = streets.visible_targets(street, cloud)
        made.append(Survey(street, cloud, targets, street.trajectory(speed).position))
    return made


def rates(surveys, *, corridors, gate=0.5, names=None):
    """Return recall, precision and F1 of each method within each corridor, all streets together.

    Returns
    -------
    DataFrame
        ``method``, ``quantity`` (recall, precision, f1), ``corridor_m``, ``class``, ``k``, ``n``,
        ``value``, ``low``, ``high`` (Wilson; F1: bootstrap over streets, NaN for one), ``kind``.
    """
    rows = []
    for name in names or surveys[0].found:
        for corridor in corridors:
            scores = [survey.score(name, corridor=corridor, gate=gate) for survey in surveys]
            rows += [{"method": name, "corridor_m": corridor, **row} for row in _pooled(scores)]
    return pd.DataFrame(rows).assign(kind="measured")


def _pooled(scores):
    """Rates of several scores together."""
    counts = np.array([(s.recall.k, s.recall.n, s.precision.n) for s in scores])
    recall = stats.wilson(*counts[:, :2].sum(axis=0))
    precision = stats.wilson(counts[:, 0].sum(), counts[:, 2].sum())
    yield {"quantity": "recall", "class": "all", **vars(recall)}
    yield {"quantity": "precision", "class": "all", **vars(precision)}
    low = high = np.nan
    if len(scores) > 1:
        spread = stats.bootstrap(_f1, counts, repeats=500)
        low, high = spread.low, spread.high
    both = {"quantity": "f1", "class": "all", "k": int(recall.k), "n": int(recall.n)}
    yield {**both, "value": _f1(counts), "low": low, "high": high}
    targets = pd.concat([s.targets[s.targets["target"]] for s in scores])
    for kind in CLASSES:
        own = targets.loc[targets["class"] == kind, "found"]
        rate = stats.wilson(int(own.sum()), len(own))
        yield {"quantity": "recall", "class": kind, **vars(rate)}


def _f1(counts):
    """F1 of rows of hits, targets, detections."""
    hits, targets, detections = counts.sum(axis=0)
    return 2 * hits / (targets + detections) if targets + detections else np.nan


def operating_curves(surveys, *, corridor):
    """Return the precision-recall curve of each method over its score.

    Returns
    -------
    DataFrame
        ``method``, ``threshold``, ``recall``, ``precision``; ``attrs["average_precision"]`` by
        method. For ``ours`` any threshold down to 0.05 is followed; the others order what they
        accept.
    """
    parts, area = [], {}
    for name in surveys[0].found:
        merged_found, merged_targets = [], []
        for number, survey in enumerate(surveys):
            candidates = accepted_at(survey.found[name], 0.05)
            shift = 1e4 * number
            merged_found.append(candidates.assign(x_m=candidates["x_m"] + shift))
            targets = survey.targets[survey.targets["distance_m"] <= corridor]
            merged_targets.append(targets.assign(x_m=targets["x_m"] + shift))
            near = merged_found[-1]["x_m"].sub(shift).abs() <= corridor
            merged_found[-1] = merged_found[-1][near]
        curve = poles.curve(pd.concat(merged_found), pd.concat(merged_targets))
        area[name] = curve.attrs["average_precision"]
        parts.append(curve.assign(method=name))
    frame = pd.concat(parts, ignore_index=True)
    frame.attrs["average_precision"] = area
    return frame


def accepted_at(candidates, threshold):
    """Return what a threshold of the learned method accepts, the best candidate of each place.

    Candidates of the other methods stay as they were judged.
    """
    accepted = candidates["rejected_by"].isin(["", "duplicate"])
    accepted |= candidates["rejected_by"] == "probability"
    accepted &= (candidates["score"] >= threshold) | (candidates["method"] != "ours")
    rows = {name: candidates.loc[accepted, name].to_numpy() for name in candidates}
    rows["rejected_by"] = np.full(accepted.sum(), "", dtype=object)
    drop_duplicates(rows, 0.6)
    frame = pd.DataFrame(rows)
    return frame[frame["rejected_by"] == ""]


def by_range(surveys, names, *, edges=RANGES_M):
    """Return recall and the median position error of each method by distance from the vehicle."""
    rows = []
    for name in names:
        scores = [survey.score(name, corridor=30.0) for survey in surveys]
        targets = pd.concat([s.targets[s.targets["target"]] for s in scores])
        hits = pd.concat([s.detections[s.detections["outcome"] == "hit"] for s in scores])
        for low, high in pairwise(edges):
            inside = (targets["distance_m"] > low) & (targets["distance_m"] <= high)
            rate = stats.wilson(int(targets.loc[inside, "found"].sum()), int(inside.sum()))
            near = (hits["x_m"].abs() > low) & (hits["x_m"].abs() <= high)
            error = stats.errors(hits.loc[near, "distance_m"])
            rows.append(
                {
                    "method": name,
                    "range_m": (low + high) / 2,
                    **vars(rate),
                    "position_error_m": error.median,
                }
            )
    return pd.DataFrame(rows).rename(columns={"value": "recall"})


def causes(surveys, names, *, corridor=30.0, radius=0.4):
    """Return the false alarms of each method by what stands there: ``n`` and ``per_100m``.

    The cause is the most frequent label of the points within ``radius`` (m) of the detection's
    middle; a second hit on a pole is called ``duplicate``.
    """
    rows = []
    for survey in surveys:
        tree = cKDTree(survey.cloud.points)
        labels = survey.street.labels[survey.cloud["surface"]]
        for name in names:
            wrong = survey.score(name, corridor=corridor).detections
            wrong = wrong[wrong["outcome"].isin(["false", "duplicate"])]
            for one in wrong.itertuples():
                middle = [one.x_m, one.y_m, one.z_base_m + one.height_m / 2]
                near = labels[tree.query_ball_point(middle, radius)]
                cause = "nothing"
                if len(near):
                    kinds, count = np.unique(near, return_counts=True)
                    cause = str(kinds[count.argmax()])
                cause = "duplicate" if one.outcome == "duplicate" else cause
                rows.append({"method": name, "cause": cause})
    frame = pd.DataFrame(rows, columns=["method", "cause"])
    frame = frame.value_counts().rename("n").reset_index()
    driven = sum(survey.street.length_m for survey in surveys)
    return frame.assign(per_100m=100 * frame["n"] / driven)


def by_gate(surveys, names, *, gates=GATES_M, corridor=30.0):
    """Return recall and precision of each method over the gate of a match; columns of ``rates``."""
    parts = []
    for gate in gates:
        table = rates(surveys, corridors=(corridor,), gate=gate, names=names)
        parts.append(table[table["class"] == "all"].assign(gate_m=gate))
    return pd.concat(parts, ignore_index=True)


def by_density(surveys, names, shares, *, corridor=30.0, seed=0):
    """Return recall and precision of each method where only a share of the pulses is kept.

    Targets stay those that the whole cloud shows: what a sparser cloud does not show is missed.

    Returns
    -------
    DataFrame
        As ``rates``, with ``share`` and ``density_per_m2``: points per square metre of ground
        within 5 m of the path.
    """
    parts = []
    for share in sorted(shares):
        thinned = [_thinned(survey, share, seed) for survey in surveys]
        for survey in thinned:
            for name in [name for name in names if name not in survey.found]:
                survey.detect(name)
        table = rates(thinned, corridors=(corridor,), names=names)
        density = np.median([_ground_density(survey) for survey in thinned])
        parts.append(table.assign(share=share, density_per_m2=density))
    table = pd.concat(parts, ignore_index=True)
    return table[table["class"] == "all"].reset_index(drop=True)


def _thinned(survey, share, seed):
    """The same survey with a share of its points, drawn at random."""
    if share == 1:
        return survey
    kept = np.random.default_rng(seed).random(len(survey.cloud)) < share
    return replace(survey, cloud=survey.cloud[kept], found={})


def _ground_density(survey):
    """Points on the ground per square metre within 5 m of the path."""
    points = survey.cloud.points
    ground = survey.street.labels[survey.cloud["surface"]] == "ground"
    length = survey.street.length_m
    near = (np.abs(points[:, 0]) < 5) & (points[:, 1] > 0) & (points[:, 1] < length)
    return (ground & near).sum() / (10 * length)


def facades(surveys, *, edges=FACADE_RANGES_M):
    """Return how well the component method's class of walls agrees with the facades.

    Facades are the walls and window reveals of buildings; the panes behind them do not count.

    Returns
    -------
    DataFrame
        For each range of distances from the path, and for all (``range_m`` NaN): ``completeness``,
        ``correctness``, ``quality`` and ``n``, the facades' points.
    """
    bands = [*pairwise(edges), (0, edges[-1])]
    counts = np.zeros((len(bands), 3), dtype=np.int64)
    for survey in surveys:
        points = survey.cloud.points
        rough = walls.rough_classes(points, itc.Settings())
        label = survey.street.labels[survey.cloud["surface"]]
        away = np.abs(points[:, 0])
        for k, (low, high) in enumerate(bands):
            counted = (away > low) & (away <= high) & (label != "pane")
            score = walls.facade_score(rough, label == "facade", counted=counted)
            counts[k] += score.right, score.missed, score.wrong
    rows = []
    for (low, high), count in zip(bands, counts, strict=True):
        score = walls.FacadeScore(*(int(n) for n in count))
        row = {"range_m": (low + high) / 2, "n": score.right + score.missed}
        rows.append(row | {name: getattr(score, name) for name in FACADE_SCORES})
    rows[-1]["range_m"] = np.nan
    return pd.DataFrame(rows)


def diameters(surveys, names, *, corridor=12.5):
    """Return the diameter errors of hits by method and class, millimetres."""
    rows = []
    for name in names:
        scores = [survey.score(name, corridor=corridor) for survey in surveys]
        for kind in CLASSES:
            values = np.concatenate([s.diameter_residuals(classes=[kind]) for s in scores])
            found = stats.errors(1000 * values)
            row = {"method": name, "class": kind, "n": found.n, "bias_mm": found.bias}
            rows.append(row | {"rmse_mm": found.rmse, "nmad_mm": found.nmad})
    return pd.DataFrame(rows)
