"""Scores of detected poles against a reference: one-to-one matching, recall and precision.

The protocol: detections and references are matched one to one in plan under a gate; targets are
references that are visible, long enough and within the corridor; a detection matched to another
reference is ignored, neither right nor wrong; a second hit on a pole is a duplicate and wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import harmonic_mean

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from mmqa_lab._checks import check_plan, check_points, check_positive
from mmqa_lab.cloud import path_distance
from mmqa_lab.poles.common import joined
from mmqa_lab.stats import Rate, wilson

GATE_M = 0.5


def match(
    detections: pd.DataFrame, references: pd.DataFrame, *, gate: float = GATE_M
) -> pd.DataFrame:
    """Match detections and references one to one, as many as possible, then as near as possible.

    Distances are horizontal, between the axes at half the height of the detection: a leaning pole
    is where it is at the height at which it was seen.

    Parameters
    ----------
    detections : DataFrame
        ``x_m``, ``y_m`` at half height; ``z_base_m`` and ``height_m`` where references lean.
    references : DataFrame
        ``x_m``, ``y_m``; with ``lean_x``, ``lean_y``, ``z_base_m``, ``height_m`` they are taken at
        half height and followed along the axis.
    gate : float
        Largest distance, metres.

    Returns
    -------
    DataFrame
        ``detection``, ``reference`` (row numbers), ``distance_m``; ordered by detection.

    Raises
    ------
    ValueError
        If a table has no ``x_m`` and ``y_m`` or the gate is not above zero.

    Notes
    -----
    The Hungarian assignment runs within groups of detections and references that the gate connects:
    the same optimum as over all, without an n x n matrix.

    References
    ----------
    Kuhn 1955, Naval Research Logistics 2, 83-97, doi:10.1002/nav.3800020109.

    Examples
    --------
    >>> found = pd.DataFrame({"x_m": [0.1, 0.2], "y_m": [0.0, 0.0]})
    >>> truth = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": [0.0, 0.0]})
    >>> match(found, truth).to_dict("records")
    [{'detection': 0, 'reference': 0, 'distance_m': 0.1}]
    """
    gate = check_positive(gate, "gate", unit="m")
    a, b, distance = _pairs(detections, references, gate)
    n = len(detections)
    part = joined(a, n + b, n + len(references))[a]
    chosen = []
    order = np.argsort(part, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        if len(rows):
            chosen += list(rows[_assigned(a[rows], b[rows], distance[rows], gate)])
    found = pd.DataFrame({"detection": a, "reference": b, "distance_m": distance})
    return found.iloc[chosen].sort_values("detection", ignore_index=True)


def _pairs(detections, references, gate):
    """Numbers and distances of detections and references within the gate."""
    xy, others = _plan(detections, "detections"), _plan(references, "references")
    if not len(xy) or not len(others):
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    leaning = {"lean_x", "lean_y", "z_base_m", "height_m"} <= set(references)
    leaning = leaning and {"z_base_m", "height_m"} <= set(detections)
    lean = references[["lean_x", "lean_y"]].to_numpy() if leaning else np.zeros_like(others)
    slack = 0.0
    if leaning:
        height = references["height_m"].to_numpy()
        slack = float(np.nanmax(np.hypot(*lean.T) * height, initial=0.0))
    near = cKDTree(others).query_ball_point(xy, gate + slack)
    a = np.repeat(np.arange(len(xy)), [len(found) for found in near])
    b = np.concatenate([np.asarray(found, np.int64) for found in near])
    shift = np.zeros(len(a))
    if leaning:
        middle = [(t["z_base_m"] + t["height_m"] / 2).to_numpy() for t in (detections, references)]
        half = references["height_m"].to_numpy()[b] / 2
        shift = np.clip(middle[0][a] - middle[1][b], -half, half)
    distance = np.hypot(*(xy[a] - others[b] - lean[b] * shift[:, None]).T)
    inside = distance <= gate
    return a[inside], b[inside], distance[inside]


def _plan(table, name):
    """Coordinates in plan, (n, 2)."""
    if not {"x_m", "y_m"} <= set(table):
        raise ValueError(f"Invalid {name}: columns {list(table)}. Must have x_m and y_m.")
    return check_points(table[["x_m", "y_m"]].to_numpy(float), name=name, columns=2, minimum=0)


def _assigned(a, b, distance, gate):
    """Rows of the pairs that the assignment chooses: most pairs first, then least distance."""
    if len(a) == 1:
        return np.array([0])
    left, i = np.unique(a, return_inverse=True)
    right, j = np.unique(b, return_inverse=True)
    cost = np.zeros((len(left), len(right)))
    cost[i, j] = distance - 2 * gate * min(len(left), len(right)) - gate
    row = np.full(cost.shape, -1)
    row[i, j] = np.arange(len(a))
    picked = row[linear_sum_assignment(cost)]
    return picked[picked >= 0]


@dataclass(frozen=True, eq=False, repr=False)
class Score:
    """How well detections agree with a reference.

    Parameters
    ----------
    recall, precision : Rate
        With Wilson intervals.
    detections : DataFrame
        The given ones with ``outcome`` (``hit``, ``false``, ``duplicate``, ``ignored``,
        ``outside``), ``reference`` (row, -1 for none) and ``distance_m``.
    targets : DataFrame
        The references with ``target`` (whether it counts), ``found`` and ``detection`` (row, -1).

    Examples
    --------
    >>> poles = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": 0.0})
    >>> score(poles[:1], poles)
    <Score: recall 0.500 [0.095, 0.905] (1/2), precision 1.000 [0.207, 1.000] (1/1), F1 0.667>
    """

    recall: Rate
    precision: Rate
    detections: pd.DataFrame
    targets: pd.DataFrame

    def __repr__(self) -> str:
        return f"<Score: recall {self.recall}, precision {self.precision}, F1 {self.f1:.3f}>"

    def _repr_html_(self) -> str:
        return self.to_frame()._repr_html_()

    def to_frame(self) -> pd.DataFrame:
        """Return recall and precision: ``quantity``, ``k``, ``n``, ``value``, ``low``, ``high``."""
        rates = {"recall": self.recall, "precision": self.precision}
        return pd.DataFrame([{"quantity": name, **vars(rate)} for name, rate in rates.items()])

    @property
    def f1(self) -> float:
        """Harmonic mean of recall and precision."""
        return float(harmonic_mean([self.recall.value, self.precision.value]))

    @property
    def duplicates(self) -> int:
        """Number of detections that hit a pole which another one hit better."""
        return int((self.detections["outcome"] == "duplicate").sum())

    def by_class(self) -> pd.DataFrame:
        """Return recall for each class of targets: ``class``, ``k``, ``n``, value and interval."""
        counted = self.targets[self.targets["target"]]
        rows = []
        for name, part in counted.groupby("class"):
            rate = wilson(int(part["found"].sum()), len(part))
            rows.append({"class": name, **vars(rate)})
        columns = ["class", "k", "n", "value", "low", "high"]
        return pd.DataFrame(rows, columns=columns).rename(columns={"value": "recall"})

    def diameter_residuals(self, *, classes: Sequence[str] | None = None) -> np.ndarray:
        """Return the errors of the diameters of hits, metres; NaN where not measured.

        The truth is ``diameter_m`` of the reference, or its taper between ``diameter_base_m`` and
        ``diameter_top_m`` at half the height of the detection. ``classes`` chooses references.
        """
        hits = self.detections[self.detections["outcome"] == "hit"]
        truth = self.targets.loc[hits["reference"]]
        if classes is not None:
            chosen = truth["class"].isin(classes).to_numpy()
            hits, truth = hits[chosen], truth[chosen]
        return hits["diameter_m"].to_numpy() - _true_diameter(hits, truth)


def _true_diameter(hits, truth):
    """Diameter of the references at half the height of the detections."""
    if "diameter_base_m" not in truth:
        return truth["diameter_m"].to_numpy(float)
    middle = (hits["z_base_m"] + hits["height_m"] / 2).to_numpy()
    share = (middle - truth["z_base_m"].to_numpy()) / truth["height_m"].to_numpy()
    low, high = truth["diameter_base_m"].to_numpy(), truth["diameter_top_m"].to_numpy()
    return low + np.clip(share, 0, 1) * (high - low)


def score(
    detections: pd.DataFrame,
    references: pd.DataFrame,
    *,
    gate: float = GATE_M,
    corridor: float | None = None,
    trajectory: ArrayLike | None = None,
) -> Score:
    """Score detections against references.

    Parameters
    ----------
    detections : DataFrame
        As :func:`mmqa_lab.poles.detect` returns it.
    references : DataFrame
        ``x_m``, ``y_m``; where present, ``class``, ``height_m`` (shorter than 1 m: no target),
        ``visible`` (False: no target), ``ignore`` (True: no target), ``radius_m`` of an ignored
        region (0 for a pole), ``lean_x``, ``lean_y``, diameters.
    gate : float
        Largest distance of a match, metres.
    corridor : float, optional
        Targets and detections farther from the trajectory do not count, metres.
    trajectory : array_like, shape (m, 2 or 3), optional
        Needed for a corridor.

    Returns
    -------
    Score

    Raises
    ------
    ValueError
        If a table has no ``x_m`` and ``y_m``, the gate or the corridor is not above zero, or a
        corridor comes without a trajectory.

    Examples
    --------
    >>> found = pd.DataFrame({"x_m": [0.1, 9.0], "y_m": [0.0, 0.0]})
    >>> truth = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": [0.0, 0.0], "class": ["lamp", "sign"]})
    >>> result = score(found, truth)
    >>> result.recall.value, result.precision.value
    (0.5, 0.5)
    """
    references = references.reset_index(drop=True)
    found = detections.reset_index(drop=True)
    target = _is_target(references)
    inside = np.ones(len(found), dtype=bool)
    if corridor is not None:
        if trajectory is None:
            raise ValueError("Invalid trajectory None. Must be given where there is a corridor.")
        path = check_plan(trajectory, name="trajectory")
        corridor = check_positive(corridor, "corridor", unit="m")
        target &= path_distance(_plan(references, "references"), path) <= corridor
        inside = path_distance(_plan(found, "detections"), path) <= corridor
    pairs = match(found, references, gate=gate)
    matched = np.full(len(found), -1)
    matched[pairs["detection"]] = pairs["reference"]
    distance = np.full(len(found), np.nan)
    distance[pairs["detection"]] = pairs["distance_m"]
    outcome = _outcomes(found, references, target, matched, inside, gate)
    hit = np.full(len(references), -1)
    hit[pairs["reference"]] = pairs["detection"]
    right, wrong = (outcome == "hit").sum(), np.isin(outcome, ("false", "duplicate")).sum()
    return Score(
        wilson(int((hit[target] >= 0).sum()), int(target.sum())),
        wilson(int(right), int(right + wrong)),
        found.assign(outcome=outcome, reference=matched, distance_m=distance),
        references.assign(target=target, found=hit >= 0, detection=hit),
    )


def _is_target(references):
    """Which references count."""
    target = np.ones(len(references), dtype=bool)
    if "visible" in references:
        target &= references["visible"].to_numpy(bool)
    if "ignore" in references:
        target &= ~references["ignore"].to_numpy(bool)
    if "height_m" in references:
        target &= ~(references["height_m"].to_numpy(float) < 1.0)
    return target


def _outcomes(found, references, target, matched, inside, gate):
    """What each detection is."""
    outcome = np.full(len(found), "false", dtype=object)
    near = _pairs(found, references, gate)
    duplicate = np.zeros(len(found), dtype=bool)
    duplicate[near[0][target[near[1]]]] = True
    unasked = np.zeros(len(found), dtype=bool)
    unasked[near[0][~target[near[1]]]] = True
    unasked |= _in_regions(found, references)
    outcome[duplicate] = "duplicate"
    outcome[unasked & ~duplicate] = "ignored"
    hits = matched >= 0
    outcome[hits] = np.where(target[matched[hits]], "hit", "ignored")
    outcome[~inside & (outcome != "hit")] = "outside"
    return outcome


def _in_regions(found, references):
    """Which detections lie within an ignored region."""
    if "radius_m" not in references or not len(found):
        return np.zeros(len(found), dtype=bool)
    regions = references[references["radius_m"] > 0]
    places = regions[["x_m", "y_m"]].to_numpy(float)
    off = _plan(found, "detections")[:, None] - places
    return (np.hypot(*np.moveaxis(off, -1, 0)) <= regions["radius_m"].to_numpy()).any(axis=1)


def curve(detections: pd.DataFrame, references: pd.DataFrame, **choices) -> pd.DataFrame:
    """Return recall and precision over the threshold of the score.

    Parameters
    ----------
    detections : DataFrame
        With ``score``, one for each candidate that any threshold would accept.
    references : DataFrame
    **choices
        As for :func:`score`.

    Returns
    -------
    DataFrame
        ``threshold`` (falling), ``recall``, ``precision``, ``hits``, ``false``.

    Notes
    -----
    Matching is done once, of all candidates; a threshold then drops detections, so that recall
    cannot fall along the curve.

    Examples
    --------
    >>> found = pd.DataFrame({"x_m": [0.1, 9.0], "y_m": 0.0, "score": [0.9, 0.4]})
    >>> truth = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": 0.0})
    >>> curve(found, truth)[["recall", "precision"]].to_numpy().tolist()
    [[0.5, 1.0], [0.5, 0.5]]
    """
    result = score(detections, references, **choices)
    counted = result.detections[~result.detections["outcome"].isin(["ignored", "outside"])]
    counted = counted.sort_values("score", ascending=False)
    hits = (counted["outcome"] == "hit").to_numpy().cumsum()
    n = np.arange(1, len(counted) + 1)
    frame = pd.DataFrame(
        {"threshold": counted["score"].to_numpy(), "hits": hits, "false": n - hits}
    )
    frame = frame.groupby("threshold", sort=False).last().reset_index()
    total = max(result.recall.n, 1)
    frame["recall"] = frame["hits"] / total if result.recall.n else np.nan
    frame["precision"] = frame["hits"] / (frame["hits"] + frame["false"])
    return frame
