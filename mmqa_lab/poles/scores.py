"""Scores of detected poles against a reference: one-to-one matching, recall and precision.

Detections and references are matched one to one in plan within a gate. Targets are references that
are visible, long enough and within the corridor. A detection matched to a reference that is no
target is ignored: it is neither right nor wrong. A second hit on a target is a duplicate and wrong.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from statistics import harmonic_mean

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from mmqa_lab._checks import check_points, check_positive
from mmqa_lab._results import Shown
from mmqa_lab.cloud import path_distance
from mmqa_lab.stats import Rate, wilson

__all__ = ["GATE_M", "Score", "match", "score"]

GATE_M = 0.5


def match(
    detections: pd.DataFrame, references: pd.DataFrame, *, gate: float = GATE_M
) -> pd.DataFrame:
    """Match detections and references one to one, as many as possible, then as near as possible.

    Distances are horizontal, between the axes at half the height of the detection. So a leaning
    pole is compared at the height at which it was seen.

    Parameters
    ----------
    detections : DataFrame
        ``x_m``, ``y_m`` at half height; ``z_base_m`` and ``height_m`` if references lean.
    references : DataFrame
        ``x_m``, ``y_m`` at half height. With ``lean_x``, ``lean_y``, ``z_base_m`` and ``height_m``
        they are shifted along the axis to the height of the detection.
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
    distance = _distances(detections, references)
    # a pair outside the gate costs more than all pairs inside it, so the most pairs are matched
    cost = np.where(distance <= gate, distance, 2 * gate * (min(distance.shape) + 1))
    a, b = linear_sum_assignment(cost)
    inside = distance[a, b] <= gate
    found = {"detection": a[inside], "reference": b[inside], "distance_m": distance[a, b][inside]}
    return pd.DataFrame(found)


def _distances(detections, references):
    """Distances between all detections and references, (n, m), metres."""
    xy, others = _plan(detections, "detections"), _plan(references, "references")
    off = xy[:, None] - others
    heights, leans = {"z_base_m", "height_m"}, ["lean_x", "lean_y"]
    if heights <= set(detections) and heights | set(leans) <= set(references):
        middle = [(t["z_base_m"] + t["height_m"] / 2).to_numpy() for t in (detections, references)]
        half = references["height_m"].to_numpy() / 2
        shift = np.clip(middle[0][:, None] - middle[1], -half, half)
        off = off - references[leans].to_numpy() * shift[:, :, None]
    return np.hypot(off[..., 0], off[..., 1])


def _plan(table, name):
    """Coordinates in plan, (n, 2)."""
    if not {"x_m", "y_m"} <= set(table):
        raise ValueError(f"Invalid {name}: columns {list(table)}. Must have x_m and y_m.")
    return check_points(table[["x_m", "y_m"]].to_numpy(float), name=name, columns=2, minimum=0)


@dataclass(frozen=True, eq=False, repr=False)
class Score(Shown):
    """How well detections agree with a reference.

    Parameters
    ----------
    recall, precision : Rate
        Each with its 95 % Wilson interval.
    detections : DataFrame
        The given detections with ``outcome`` (``hit``, ``false``, ``duplicate``, ``ignored``,
        ``outside``), ``reference`` (row, -1 for none) and ``distance_m``.
    targets : DataFrame
        The references with ``target`` (whether the reference counts) and ``found``.

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

    def to_frame(self) -> pd.DataFrame:
        """Return recall and precision: ``quantity``, ``k``, ``n``, ``value``, ``low``, ``high``."""
        rates = {"recall": self.recall, "precision": self.precision}
        return pd.DataFrame([{"quantity": name, **vars(rate)} for name, rate in rates.items()])

    def _ends(self):
        rates = (("recall", self.recall), ("precision", self.precision))
        return [(name, rate.value, rate.low, rate.high, "1") for name, rate in rates]

    @property
    def f1(self) -> float:
        """Harmonic mean of recall and precision."""
        return float(harmonic_mean([self.recall.value, self.precision.value]))

    @property
    def hits(self) -> pd.DataFrame:
        """The correct detections, with ``true_diameter_m`` at the height of measurement.

        The true diameter is ``diameter_m`` of the reference. If the reference tapers, it is
        interpolated from ``diameter_base_m`` to ``diameter_top_m`` at half the height of the
        detection.
        """
        hits = self.detections[self.detections["outcome"] == "hit"]
        truth = self.targets.loc[hits["reference"]].set_index(hits.index)
        if "diameter_base_m" not in truth:
            return hits.assign(true_diameter_m=truth.get("diameter_m", np.nan))
        share = hits["z_base_m"] + hits["height_m"] / 2 - truth["z_base_m"]
        share = (share / truth["height_m"]).clip(0, 1)
        low, high = truth["diameter_base_m"], truth["diameter_top_m"]
        return hits.assign(true_diameter_m=low + share * (high - low))


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
        ``x_m``, ``y_m``. Optional columns: ``height_m`` (less than 1 m: no target), ``visible``
        (true or false, or 1 or 0; false: no target), ``lean_x``, ``lean_y``, diameters.
    gate : float
        Largest distance of a match, metres.
    corridor : float, optional
        Half width, metres. Targets and detections farther from the trajectory do not count.
    trajectory : array_like, shape (m, 2 or 3), optional
        Metres; needed with a corridor.

    Returns
    -------
    Score

    Raises
    ------
    ValueError
        If a table has no ``x_m`` and ``y_m``, ``visible`` is neither true nor false, the gate or
        the corridor is not above zero, or a corridor comes without a trajectory.

    Examples
    --------
    >>> found = pd.DataFrame({"x_m": [0.1, 9.0], "y_m": [0.0, 0.0]})
    >>> truth = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": [0.0, 0.0], "class": ["lamp", "sign"]})
    >>> result = score(found, truth)
    >>> result.recall.value, result.precision.value
    (0.5, 0.5)
    """
    twice = int(pd.DataFrame(_plan(references, "references")).duplicated().sum())
    if twice:
        told = f"{twice} of {len(references)} references stand at the place of another"
        warnings.warn(f"{told}: they are left out.", stacklevel=2)
        references = references.drop_duplicates(["x_m", "y_m"])
    references, found = (part.reset_index(drop=True) for part in (references, detections))
    given = (references, ("target", "found")), (found, ("outcome", "reference", "distance_m"))
    if lost := [name for part, names in given for name in names if name in part]:
        told = f"The tables have columns {', '.join(lost)} of their own"
        warnings.warn(f"{told}: those of the score take their place.", stacklevel=2)
    target = ~(references.get("height_m", pd.Series(9.0, references.index)) < 1.0).to_numpy()
    if "visible" in references:
        unclear = ~references["visible"].isin([True, False]).to_numpy()
        if unclear.any():
            row = unclear.argmax()
            raise ValueError(
                f"Invalid references: visible is {references['visible'][row]!r} in row {row}. "
                "Must be true or false."
            )
        target &= references["visible"].to_numpy(bool)
    inside = np.ones(len(found), dtype=bool)
    if corridor is not None:
        if trajectory is None:
            raise ValueError("Invalid trajectory None. Must be given with a corridor.")
        corridor = check_positive(corridor, "corridor", unit="m")
        target &= path_distance(_plan(references, "references"), trajectory) <= corridor
        inside = path_distance(_plan(found, "detections"), trajectory) <= corridor
    pairs = match(found, references, gate=gate).set_index("detection").reindex(found.index)
    reference = pairs["reference"].fillna(-1).astype(int).to_numpy()
    hit = np.append(target, False)[reference]  # -1, no reference, takes the last
    near = _distances(found, references) <= gate
    cases = hit, ~inside, reference >= 0, near[:, target].any(axis=1), near.any(axis=1)
    names = "hit", "outside", "ignored", "duplicate", "ignored"
    outcome = np.select(cases, names, "false").astype(object)
    right, wrong = int(hit.sum()), int(np.isin(outcome, ("false", "duplicate")).sum())
    return Score(
        wilson(right, int(target.sum())),
        wilson(right, right + wrong),
        found.assign(outcome=outcome, reference=reference, distance_m=pairs["distance_m"]),
        references.assign(target=target, found=np.isin(references.index, reference)),
    )
