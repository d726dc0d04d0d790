"""Small decision trees that turn measures into a score, and how they are grown."""

from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
import pandas as pd

from mmqa_lab._compiled import njit
from mmqa_lab.poles.measures import MEASURES

__all__ = ["Trees", "grow", "read", "shipped", "write"]


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
    import lightgbm

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
