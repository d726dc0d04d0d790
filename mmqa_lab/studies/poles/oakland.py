"""Real clouds with labels: Oakland part 2, and the poles that its labels define.

The clouds have no trajectory, no time and no scan lines, coordinates are rounded to 1 cm, and
points are grouped by class in the file, so that they are shuffled before anything looks at them.
"""

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mmqa_lab import io, poles, samples
from mmqa_lab.cloud import Cloud
from mmqa_lab.poles import ours
from mmqa_lab.poles.trees import read_model
from mmqa_lab.studies.poles import training

PARTS = ("ac", "ad", "ae", "ag", "ah", "ai", "aj", "ak", "al", "ao")
FILES = tuple(f"oakland/part2_{part}.laz" for part in PARTS)

TARGETS = {
    1103: "utility pole",
    1107: "lamp support",
    1110: "post",
    1111: "sign",
    1116: "traffic light support",
    1119: "parking meter",
    1302: "small trunk",
    1303: "large trunk",
}
"""Labels of poles that are asked for."""

UNASKED = (1106, 1109, 1112, 1114, 1115, 1118, 1412)
"""Pole-like, not asked for: support pole, hydrant, pylon, lamp, lights, column."""

UNKNOWN = (1000, 1001, 9999)
"""Points whose class the labels leave open: whether a pole stands there is not known."""

FOOT_M = 2.0
"""A reference is where its lowest 2 m stand: a board or a lamp hangs beside its post."""


def cloud(tiles=None):
    """Return the first or all tiles in the folder of MMQA_DATA, shuffled, with ``label``."""
    parts = [io.read_cloud(samples.real_path(name)) for name in FILES[:tiles]]
    whole = Cloud.concatenate(parts, name="Oakland part 2")
    return whole[np.random.default_rng(0).permutation(len(whole))]


def references(whole, *, link=0.35, minimum_points=8):
    """Return the poles that the labels define.

    Connected components in plan of the points of ``TARGETS``; of ``UNASKED`` and of ``UNKNOWN``
    likewise, to be ignored.

    Parameters
    ----------
    whole : Cloud
        With ``label``.
    link : float
        Points nearer in plan are connected, metres.
    minimum_points : int
        Components with fewer points, or lower than 1 m, are ignored.

    Returns
    -------
    DataFrame
        ``x_m``, ``y_m`` (medians of the lowest 2 m), ``z_base_m``, ``height_m``, ``class``,
        ``points``, ``ignore``.
    """
    tables = []
    for labels, ignored in ((tuple(TARGETS), False), (UNASKED, True), (UNKNOWN, True)):
        chosen = whole[np.isin(whole["label"], labels)]
        if len(chosen):
            tables.append(_components(chosen, link, minimum_points, ignored))
    # what is unknown is ignored where it could be a target: a few stray points are no pole
    small = (tables[-1]["points"] < minimum_points) | (tables[-1]["height_m"] < 1.0)
    tables[-1] = tables[-1][~small]
    return pd.concat(tables, ignore_index=True)


def _components(chosen, link, minimum_points, ignored):
    """One row for each connected component in plan."""
    points = chosen.points
    pairs = cKDTree(points[:, :2]).query_pairs(link, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(len(points),) * 2)
    part = connected_components(graph, directed=False)[1]
    frame = pd.DataFrame(points, columns=["x", "y", "z"]).assign(label=chosen["label"])
    rows = []
    for _, one in frame.groupby(part):
        height = one["z"].max() - one["z"].min()
        few = len(one) < minimum_points or height < 1.0
        foot = one[one["z"] <= one["z"].min() + FOOT_M]
        rows.append(
            {
                "x_m": foot["x"].median(),
                "y_m": foot["y"].median(),
                "z_base_m": one["z"].min(),
                "height_m": height,
                "class": TARGETS.get(int(one["label"].mode().iloc[0]), "unasked"),
                "points": len(one),
                "ignore": ignored or few,
            }
        )
    return pd.DataFrame(rows)


def at_hand():
    """Return whether all clouds are in the folder that MMQA_DATA names."""
    return all(samples.has_real(name) for name in FILES)


def rates(whole, truth, *, folds):
    """Score the methods that need no scan lines, and the learned one trained on the other blocks.

    Parameters
    ----------
    whole : Cloud
    truth : DataFrame
        Of :func:`references`.
    folds : int
        Of the cross-validation; 0 leaves it out.

    Returns
    -------
    DataFrame
        ``method``, ``trained_on``, ``recall``, ``precision`` with intervals, ``f1``, ``kind``.
    """
    found = {
        ("itc", "nothing"): poles.detect(whole, method="itc"),
        ("ours", "simulated streets"): poles.detect(whole, method="ours"),
    }
    if folds:
        found["ours", f"other blocks after simulated streets, {folds} folds"] = cross_validated(
            whole, truth, folds=folds
        )
    rows = []
    for (method, trained), table in found.items():
        score = poles.score(table, truth)
        row = {"method": method, "trained_on": trained, "f1": score.f1}
        for quantity in ("recall", "precision"):
            rate = getattr(score, quantity)
            row |= {
                quantity: rate.value,
                f"{quantity}_low": rate.low,
                f"{quantity}_high": rate.high,
            }
        rows.append(row)
    return pd.DataFrame(rows).assign(kind="measured", n=int((~truth["ignore"]).sum()))


def cross_validated(whole, truth, *, folds, block=40.0):
    """Return the poles that the learned method finds in each block, trained on the others.

    What the verifier trained on simulated streets says is one more feature. Blocks of 40 m are
    dealt out to the folds in turn, so that neighbouring points are never in training and test at
    once but at the blocks' edges.
    """
    origin = np.floor(whole.points.min(axis=0))
    settings = ours.Settings()
    where = ours.described(whole.points - origin, settings)
    features, axes, _ = where
    simulated = read_model().probability(features)
    features = np.column_stack([features, simulated])
    targets = truth.assign(visible=~truth["ignore"], lean_x=0.0, lean_y=0.0)
    moved = axes.copy()
    moved[:, :2] += origin[:2]
    label = training.labels(moved, targets, near=0.4)
    _, number = np.unique(np.floor(axes[:, :2] / block), axis=0, return_inverse=True)
    fold = number.ravel() % folds
    probability = np.zeros(len(axes))
    for k in range(folds):
        learn = (fold != k) & (label >= 0)
        one = np.zeros(learn.sum(), int)
        model = training.fit(features[learn], label[learn], one, more=("simulated",))
        probability[fold == k] = model.probability(features[fold == k])
    found = ours.judged(whole.points - origin, where, probability, settings)
    return found.assign(x_m=found["x_m"] + origin[0], y_m=found["y_m"] + origin[1])
