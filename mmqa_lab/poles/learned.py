"""A learned detector with named measures and small decision trees.

The cloud is thinned (``common``), and columns of points become candidates with an axis (``axes``).
Each gets the ``MEASURES`` (``measures``). Shallow trees of two forests, grown on simulated streets,
give the score. The method needs no scan lines.
``python tests/poles_training.py`` grows the forest ``trees.csv`` again.
"""

from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from mmqa_lab._checks import needs
from mmqa_lab._compiled import njit
from mmqa_lab._progress import progress
from mmqa_lab.poles.axes import candidates, fit_axes
from mmqa_lab.poles.common import (
    BIN_M,
    BINS,
    PLACES,
    STRIPE,
    around,
    drop_duplicates,
    first_reason,
    ground,
    lowest,
    stripes,
    table,
    thinned,
)
from mmqa_lab.poles.measures import MEASURES, measure, sections

__all__ = [
    "MEASURES", "Trees", "describe", "detect", "grow", "lessons", "own_frame", "read",
    "shipped", "write",
]  # fmt: skip


LOW_M = 0.1
"""Points lower than this above the ground belong to the ground."""

APART_M = 0.6

THRESHOLD, DOUBT, LENGTH_M = 0.22, 0.02, 1.0
"""The threshold was chosen with the real street of study 06 in sight, where F1 is .82 (components
.77, no difference shown), and with streets full of things that look like poles: on six others of
their kind 62 % of the finds are right. A score is an order, no probability."""


class Described(NamedTuple):
    """Candidates of a cloud: ``axes`` (k, 5), ``measures``, ``shaft``, ``ground`` (a function).

    ``above`` has the points up to 16 m above the ground.
    """

    axes: np.ndarray
    measures: pd.DataFrame
    shaft: dict
    ground: Callable
    above: np.ndarray

    @property
    def middle(self):
        """Place of the axes at half the height of the run, (k, 2), m.

        If the points lie on a circle, the place is its centre.
        """
        half = (self.shaft["low"] + self.shaft["high"]) / 2 - self.axes[:, 4]
        centre, radius = self.shaft["centre"], self.measures["radius_m"].to_numpy()
        is_arc = (self.measures["arc"].to_numpy() > 0.2) & (np.hypot(*centre.T) < 1.3 * radius)
        shift = self.axes[:, 2:4] * half[:, None] + centre * is_arc[:, None]
        return self.axes[:, :2] + shift


def own_frame(points):
    """Return an origin (3,) and axes in columns (3, 3) that turn and move with points (n, 3), m.

    The third axis is upright. The second follows the longest extent in plan, as in the streets of
    the lessons, so directions are told from the street and not from north. Far points hardly count.
    The origin lies below the lowest point, by less than a step of any coordinates: so no rounded
    height is on the border of two cells, wherever the cloud lies.

    Examples
    --------
    >>> origin, axes = own_frame(np.array([[0, 0, 5], [3, 3, 5], [6, 6, 5.0]]))
    >>> origin.round(9).tolist(), np.abs(axes[:, 1]).round(3).tolist()
    ([3.0, 3.0, 4.99963], [0.707, 0.707, 0.0])
    """
    level = (points[:, 2] - np.median(points[:, 2])) % LEVEL_M
    asked = level * max(len(points) // MOST_ASKED, 1) <= LEVEL_M
    plan, first = (points[asked, :2] - points[0, :2]) @ [1, 1j], points[0, :2]
    centre = np.median(plan.real) + 1j * np.median(plan.imag)
    for _ in range(60):
        away = np.abs(plan - centre)
        weight = (1 + (away / (2 * np.median(away) + LOW_M)) ** 2) ** -2.0
        centre = np.average(plan, weights=weight)
    off = plan - centre
    angle = np.angle((weight * off**2).sum()) / 2
    angle += np.pi * ((weight * (off * np.exp(-1j * angle)).real ** 3).sum() < 0)
    along = np.array([np.cos(angle), np.sin(angle), 0])
    axes = np.column_stack([np.cross(along, [0, 0, 1]), along, [0, 0, 1]])
    return np.array([*first + [centre.real, centre.imag], points[:, 2].min() - BELOW_M]), axes


def describe(points, frame=None):
    """Return the ``Described`` candidates of points (n, 3), m, in a frame such as ``own_frame``."""
    origin, turn = frame or (0.0, np.eye(3))

    def parts():
        """The points in that frame, a part at a time: a large cloud is held once."""
        for first in progress(range(0, len(points), PART), "part"):
            yield (points[first : first + PART] - origin) @ turn

    def over_ground(part):
        height = part[:, 2] - height_of(part)
        return part[(height > LOW_M) & (height < BINS * BIN_M)]

    height_of = ground(np.concatenate([lowest(part) for part in parts()]))
    above = np.concatenate([over_ground(part) for part in parts()])
    thin = thinned(above, height_of)
    xy, scatter = candidates(thin) if len(above) else np.empty((2, 0, 2))
    found = [measure(thin, np.empty((0, 5)))]
    for rows, part in progress(stripes(thin, xy), "stripe", total=-(-len(xy) // STRIPE)):
        found.append(measure(part, fit_axes(part, xy[rows], scatter[rows])))
    axes, measures, shafts = zip(*found, strict=True)
    shaft = {name: np.concatenate([one[name] for one in shafts]) for name in shafts[0]}
    measures = pd.concat(measures[len(measures) > 1 :], ignore_index=True)
    return Described(np.concatenate(axes), measures, shaft, height_of, above)


PART, MOST_ASKED, LEVEL_M, BELOW_M = 1_000_000, 50_000, 0.0161803, 0.00037


"""Points that are handled at a time while the ground is sought; about so many give the frame, those
in the lowest part of each level, whose height is no multiple of a step that coordinates have; from
the lowest point down to the origin."""


@threadpool_limits.wrap(limits=1)  # products with a small matrix, which threads make slow
def detect(points, *, threshold=THRESHOLD, trees=None, explain=False):
    """Return the poles of points (n, 3) as :func:`mmqa_lab.poles.detect` does.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    threshold : float
        Least score of a pole.
    trees : Trees, optional
        By default the trees of the package.
    explain : bool
        Return all candidates with the test that rejected them, the measures, and the contribution
        of each measure to the log odds.

    Returns
    -------
    DataFrame
        The columns of :func:`mmqa_lab.poles.common.table`, the interval of the diameter, and
        ``section_m``.
    """
    trees = shipped() if trees is None else trees
    points = points if len(points) else np.zeros((1, 3))  # ground without poles
    origin, turned = own_frame(points)
    found = describe(points, (origin, turned))
    axes, height_of = found.axes, found.ground
    score = trees.score(found.measures)
    doubtful = score > DOUBT
    near, before = around(found.above, axes[doubtful]), found.measures[doubtful]
    for place in PLACES[1:]:
        for rows, part in stripes(thinned(near, height_of, place), axes[doubtful]):
            again = measure(part, axes[doubtful][rows], before.iloc[rows])[1]
            score[np.flatnonzero(doubtful)[rows]] += trees.score(again)
    score[doubtful] /= len(PLACES)
    low, high = found.shaft["low"], found.shaft["high"]
    short = found.measures["column_m"].to_numpy() < LENGTH_M
    tilted = np.hypot(*axes[:, 2:4].T) > np.tan(np.radians(TILT_DEG))
    reason = first_reason(score=score < threshold, length=short, tilt=tilted)
    xy = found.middle
    drop_duplicates(xy, score, reason, APART_M)
    kept = reason == ""
    sizes = pd.DataFrame(sections(found, kept), index=np.flatnonzero(kept))
    top = found.measures["top_m"].to_numpy()[kept] + BIN_M
    reason[kept] = np.where(top < STOUT * sizes["section_m"], "section", "")
    foot = np.column_stack([xy, height_of(axes) + low]) @ turned.T + origin
    lean = axes[:, 2:4] @ turned[:2, :2].T
    rows = dict(zip(("x_m", "y_m", "z_base_m"), foot.T, strict=True))
    rows |= {"height_m": high - low} | dict(sizes.reindex(range(len(axes))))
    rows |= {"lean_x": lean[:, 0], "lean_y": lean[:, 1], "score": score, "rejected_by": reason}
    if explain:
        parts = pd.DataFrame(trees.parts(found.measures)[0], columns=[*MEASURES])
        rows |= dict(found.measures) | dict(parts.add_prefix("adds_"))
    return table(rows, "learned", explain=explain)


SLENDER, STOUT, TILT_DEG = 6.0, 5.0, 12.0


"""A pole is at least six times as high as wide, what it carries counted as height, and leans at
most so far: guy wires lean more. A find is dropped below five, since scatter widens a section."""


def lessons(points, targets, *, weight=1.0, poles=2.5):
    """Return the training data of a cloud: measures, labels (1 for visible poles), weights.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres.
    targets : DataFrame
        Poles: ``x_m``, ``y_m`` at half height, ``lean_x``, ``lean_y``, ``z_base_m``, ``height_m``,
        ``visible``.
    weight : float
        Weight of the cloud. It is spread so that a cloud of k candidates counts as sqrt(k).
    poles : float
        Weight of a pole beside that of another candidate, since scores of sparse and rough poles of
        real streets are too low otherwise.

    Returns
    -------
    DataFrame, Series, Series
        Candidates nearer than 0.3 m to a visible pole count as poles. Other candidates within 0.6 m
        of any pole are left out.
    """
    origin = np.floor(points.min(axis=0))
    found = describe(points - origin)
    half = targets["height_m"].to_numpy() / 2
    height = found.ground(found.axes) + (found.shaft["low"] + found.shaft["high"]) / 2 + origin[2]
    rise = np.clip(height[:, None] - targets["z_base_m"].to_numpy() - half, -half, half)
    off = found.middle[:, None] + origin[:2] - targets[["x_m", "y_m"]].to_numpy()
    away = np.linalg.norm(off - targets[["lean_x", "lean_y"]].to_numpy() * rise[..., None], axis=2)
    right = ((away < 0.3) & targets["visible"].to_numpy()).any(axis=1)
    use = right | (away > 0.6).all(axis=1)
    label = pd.Series(right[use].astype(int))
    return (
        found.measures[use],
        label,
        (1 + (poles - 1) * label) * weight / np.sqrt(max(use.sum(), 1)),
    )


class Trees(NamedTuple):
    """Nodes of all trees in arrays of shape (n,).

    If ``feature`` is at most ``limit`` the next node is ``left``, else ``right``; leaves have -1 in
    both. ``value`` is the contribution of the node to the log odds.
    """

    feature: np.ndarray
    limit: np.ndarray
    left: np.ndarray
    right: np.ndarray
    value: np.ndarray

    def parts(self, measures):
        """Return the contribution of each measure to the log odds, (k, measures), and the offset.

        A candidate passes from node to node of a tree. Each change of the value counts for the
        measure that the node tests.
        """
        roots = np.setdiff1d(np.arange(len(self.left)), [self.left, self.right])
        return _passed(np.asarray(measures, float), roots, *self), self.value[roots].sum()

    def log_odds(self, measures):
        """Return the log odds (k,) that each candidate is a pole."""
        parts, first = self.parts(measures)
        return parts.sum(axis=1) + first

    def score(self, measures):
        """Return the score (k,) of each candidate, from 0 to 1."""
        return 1 / (1 + np.exp(-self.log_odds(measures)))


@njit(cache=True)
def _passed(x, roots, feature, limit, left, right, value):
    """What the tests of each measure add to candidates (k, measures) that pass all trees."""
    parts = np.zeros(x.shape)
    for row in range(len(x)):
        for node in roots:
            while left[node] >= 0:
                asked = feature[node]
                new = left[node] if x[row, asked] <= limit[node] else right[node]
                parts[row, asked] += value[new] - value[node]
                node = new
    return parts


DEPTH = 6


def grow(measures, label, weight=None, *, start=None, rounds=200, leaves=16, rate=0.08, leave=()):
    """Return ``Trees`` grown by gradient boosting of the log loss.

    Parameters
    ----------
    measures : DataFrame
        From :func:`measure`, k rows.
    label : array, shape (k,)
        1 for poles, 0 for others.
    weight : array, shape (k,), optional
        Weights of the candidates; equal by default.
    start : Trees, optional
        Trees that come first; the new ones correct their score.
    rounds, leaves, rate : int, int, float
        Number of new trees, leaves per tree, learning rate.
    leave : tuple of str
        Measures that the new trees may not use.
    """
    lightgbm = needs("poles", "lightgbm")

    x = measures.to_numpy(float) * ~np.isin(list(MEASURES), leave)
    fewest = int(np.clip(len(label) / 280, 5, 100))  # of candidates in a leaf
    choices = {"objective": "binary", "num_leaves": leaves, "learning_rate": rate}
    choices |= {"max_depth": DEPTH, "min_data_in_leaf": fewest, "lambda_l2": fewest / 5}
    choices |= {"feature_fraction_bynode": 0.4, "deterministic": True, "force_row_wise": True}
    choices |= {"num_threads": 1, "seed": 0, "verbose": -1}
    choices["monotone_constraints"] = [way for _, way in MEASURES.values()]
    first = None if start is None else start.log_odds(measures)
    weight = None if weight is None else weight / np.mean(weight)
    data = lightgbm.Dataset(x, label, weight=weight, init_score=first)
    nodes = lightgbm.train(choices, data, num_boost_round=rounds).trees_to_dataframe()
    before = 0 if start is None else len(start.left)
    row_of = pd.Series(nodes.index + before, nodes["node_index"])
    left, right = (row_of.reindex(nodes[f"{side}_child"]).fillna(-1) for side in ("left", "right"))
    feature = nodes["split_feature"].fillna("Column_0").str.removeprefix("Column_").astype(int)
    columns = feature, nodes["threshold"].fillna(0), left.astype(int), right.astype(int)
    trees = Trees(*(column.to_numpy() for column in (*columns, nodes["value"])))
    return trees if start is None else Trees(*map(np.concatenate, zip(start, trees, strict=True)))


HERE = resources.files("mmqa_lab.poles")


FILE, OF_STREETS = HERE.joinpath("trees.csv"), HERE.joinpath("trees_streets.csv")


"""Two forests. The first was grown on lessons of which half look like poles, the second
on streets and posts alone (version 0.3). On real streets the first misses poles near other things,
the second finds them and more that are none: their log odds are averaged."""


def write(path, trees):
    """Write ``Trees`` to a text file, one node per row."""
    frame = pd.DataFrame(trees._asdict()).round({"value": 6})
    frame.to_csv(path, index=False, float_format="%.10g", lineterminator="\n")


def read(file):
    """Return ``Trees`` from a text file that :func:`write` wrote."""
    with file.open() as lines:
        return Trees(*(column.to_numpy() for _, column in pd.read_csv(lines).items()))


@cache
def shipped():
    """Return the trees that come with the package: both forests, with half of their log odds."""
    one, other = read(FILE), read(OF_STREETS)
    left, right = (np.where(side < 0, side, side + len(one.left)) for side in other[2:4])
    moved = other._replace(left=left, right=right)
    both = Trees(*map(np.concatenate, zip(one, moved, strict=True)))
    return both._replace(value=both.value / 2)
