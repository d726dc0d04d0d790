"""A sum of small decision trees, read from and written to plain text.

The format is JSON: ``features`` (names), ``base`` (log-odds before any tree), ``trees``; a tree is
a list of nodes, a node is ``[feature, threshold, left, right]`` (left where the value is at most
the threshold) or ``[leaf value]``. Whoever reads the file can follow every decision.
"""

import json
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise

import numpy as np
from numba import njit, prange


@dataclass(frozen=True, eq=False)
class Trees:
    """Decision trees whose leaf values add up to log-odds.

    Parameters
    ----------
    features : tuple of str
    base : float
    nodes : array, shape (m, 5)
        Feature (-1 for a leaf), threshold, left, right, value of every node of every tree.
    roots : array of int, shape (t,)
    notes : dict
        How it was trained.
    """

    features: tuple
    base: float
    nodes: np.ndarray
    roots: np.ndarray
    notes: dict

    def probability(self, values):
        """Return the probability of each row of features, (n, len(features)) -> (n,)."""
        values = np.ascontiguousarray(values, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != len(self.features):
            raise ValueError(
                f"Invalid features of shape {values.shape}. Must be (n, {len(self.features)})."
            )
        return 1 / (1 + np.exp(-_sums(values, self.nodes, self.roots, self.base)))

    def to_json(self):
        """Return the text of the file."""
        edges = [*self.roots, len(self.nodes)]
        trees = []
        for low, high in pairwise(edges):
            trees.append([_plain(node, low) for node in self.nodes[low:high]])
        lines = ",\n".join(json.dumps(tree, separators=(",", ":")) for tree in trees)
        head = {"notes": self.notes, "features": list(self.features), "base": self.base}
        return json.dumps(head, indent=1)[:-2] + f',\n "trees": [\n{lines}\n]}}\n'

    @classmethod
    def from_json(cls, text):
        """Return the trees of a text."""
        data = json.loads(text)
        nodes, roots = [], []
        for tree in data["trees"]:
            first = len(nodes)
            roots.append(first)
            for node in tree:
                if len(node) == 1:
                    nodes.append([-1, 0, 0, 0, node[0]])
                else:
                    nodes.append([node[0], node[1], node[2] + first, node[3] + first, 0])
        features = tuple(data["features"])
        return cls(features, data["base"], np.array(nodes, float), np.array(roots), data["notes"])


def read_model():
    """Return the verifier that comes with the package."""
    text = resources.files("mmqa_lab.poles").joinpath("model.json").read_text(encoding="utf-8")
    return Trees.from_json(text)


def _plain(node, first):
    """A node as a short list."""
    feature, threshold, left, right, value = node
    if feature < 0:
        return [round(float(value), 5)]
    return [
        int(feature),
        float(f"{threshold:.9g}"),
        int(left) - int(first),
        int(right) - int(first),
    ]


@njit(cache=True, parallel=True)
def _sums(values, nodes, roots, base):
    """Log-odds of each row."""
    out = np.full(len(values), base)
    for k in prange(len(values)):
        for root in roots:
            node = root
            while nodes[node, 0] >= 0:
                left = values[k, int(nodes[node, 0])] <= nodes[node, 1]
                node = int(nodes[node, 2]) if left else int(nodes[node, 3])
            out[k] += nodes[node, 4]
    return out
