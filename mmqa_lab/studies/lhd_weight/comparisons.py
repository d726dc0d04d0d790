"""One comparison of two surveys of a simulated canyon, with everything that is known about it."""

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mmqa_lab import lines
from mmqa_lab.simulate.canyon import COMPARISONS, Canyon


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two surveys of one scene.

    Parameters
    ----------
    scene : Canyon
    kind : {"repeatability", "absolute"}
    names : tuple of str
        The test and the model survey.
    """

    scene: Canyon
    kind: str
    names: tuple

    @cached_property
    def test(self):
        """The test segments."""
        return self.scene.surveys[self.names[0]].segments

    @cached_property
    def model(self):
        """The model segments."""
        return self.scene.surveys[self.names[1]].segments

    @cached_property
    def truth(self):
        """True pairs, bool (p, q)."""
        return self.scene.pairs(*self.names)

    @cached_property
    def directions(self):
        """Components, source, target and true pairs of both directions."""
        forward = lines.components(self.test, self.model)
        backward = lines.components(self.model, self.test)
        return (
            (forward, self.test, self.model, self.truth),
            (backward, self.model, self.test, self.truth.T),
        )

    @cached_property
    def vectors(self):
        """True displacements of the true pairs, (pairs, 3), m."""
        return self.scene.displacements(*self.names)

    @cached_property
    def displaced(self):
        """What the displaced matcher makes of it."""
        return self.compared("displaced")

    def compared(self, matcher):
        """The LHD by one matcher; scenes with few pairs are part of the statistics."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return lines.lhd(self.test, self.model, matcher=matcher)

    @property
    def true_vector(self):
        """Mean displacement of the true pairs, (3,), m."""
        return self.vectors.mean(axis=0)

    @property
    def true_length(self):
        """Mean length of the true displacements weighted as the LHD is, m."""
        return self._weighted(np.linalg.norm(self.vectors, axis=1))

    @property
    def true_perpendicular(self):
        """Mean part of the true displacements across the true edges, weighted as the LHD is, m."""
        edges = self.scene.surveys[self.names[0]].edge[np.nonzero(self.truth)[0]]
        axes = self.scene.edges.directions[edges]
        along = (self.vectors * axes).sum(axis=1, keepdims=True)
        return self._weighted(np.linalg.norm(self.vectors - along * axes, axis=1))

    def _weighted(self, values):
        """The larger of the means weighted by model and by test lengths."""
        rows, columns = np.nonzero(self.truth)
        weights = self.model.lengths[columns], self.test.lengths[rows]
        return max(float(np.average(values, weights=weight)) for weight in weights)


def comparisons(scene, kinds=tuple(COMPARISONS)):
    """All comparisons of a scene."""
    return [Comparison(scene, kind, names) for kind in kinds for names in COMPARISONS[kind]]


MEASURES = (
    *("f1", "precision", "recall", "fp", "fn", "detection_rate", "null_rate"),
    *("threshold_m", "lhd_m", "lhd_w0_m", "perpendicular_m", "fallback"),
)


def measure(comparison, *, weight, threshold, matcher):
    """Pair both directions of a comparison and score them.

    Parameters
    ----------
    comparison : Comparison
    weight : float
    threshold : callable
        Takes nearest distances, returns a ``Threshold``.
    matcher : str
        Any of ``segments.MATCHERS``, or ``displaced``.

    Returns
    -------
    dict of str to float
        MEASURES: scores as means of both directions, distances as the larger of both.
    """
    rows = []
    for number, (parts, source, target, truth) in enumerate(comparison.directions):
        distances = parts.distance(weight)
        found = threshold(distances.min(axis=1))
        if matcher == "displaced":
            pairs = comparison.displaced.test_model.pairs
            pairs = pairs.T if number else pairs
        else:
            choices = {"matcher": matcher, "test": source, "model": target}
            pairs = lines.correspond(distances, found.delta, **choices)
        rows.append(_row(parts, target, pairs, truth, found, distances))
    joined = {name: np.array([row[name] for row in rows], dtype=float) for name in MEASURES}
    return {
        name: float(np.fmax(*values)) if name.endswith("_m") else float(np.nanmean(values))
        for name, values in joined.items()
    }


def oracle_f1(distances, truth):
    """Best F1 that any threshold on the distances reaches when every cell below it is a pair."""
    order = np.argsort(distances, axis=None, kind="stable")
    tp = np.cumsum(truth.ravel()[order])
    return float((2 * tp / (np.arange(1, len(tp) + 1) + truth.sum())).max())


def _row(parts, target, pairs, truth, found, distances):
    """The measures of one direction."""
    scores = lines.pairing_scores(pairs, truth)
    lengths = target.lengths
    f1 = 0.0 if np.isnan(scores.f1) else scores.f1
    return {
        "f1": f1,
        "precision": scores.precision,
        "recall": scores.recall,
        "fp": scores.fp,
        "fn": scores.fn,
        "detection_rate": scores.detection_rate,
        "null_rate": scores.null_rate,
        "threshold_m": found.delta,
        "lhd_m": lines.olhd(distances, pairs, lengths),
        "lhd_w0_m": lines.olhd(parts.distance(0), pairs, lengths),
        "perpendicular_m": lines.olhd(parts.perpendicular, pairs, lengths),
        "fallback": found.fallback,
    }
