"""Study of the line-segment Hausdorff distance: weights, thresholds, matchers, known truth."""

import warnings
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import pandas as pd
from scipy.stats import chi2

from mmqa_lab import lines
from mmqa_lab.bench import Comparison, grid
from mmqa_lab.published import table
from mmqa_lab.simulate.canyon import COMPARISONS, canyon
from mmqa_lab.stats import mean_interval

__all__ = [
    "FITTED", "METHODS", "Sets", "Truth", "bench", "measured", "of_scenes", "published_rows",
    "replicas", "scene", "score", "score_directions", "score_vector",
]  # fmt: skip

COURSES = {f"{a}-{b}": (a, b) for pairs in COMPARISONS.values() for a, b in pairs}
"""Test and model survey of each comparison, in the order of Tables 1 and 2."""

# The numbers of segments and true pairs were set for all rows.
FITTED = ("C1-C2", "C1-C3", "C1-TLS", "C2-TLS")
"""Rows whose distances and errors were used to fit the canyon's noise; all others were held out."""


@dataclass(frozen=True, eq=False)
class Sets:
    """The data of a method: ``test`` (p, 2, 3) and ``model`` (q, 2, 3), segments in metres."""

    test: np.ndarray
    model: np.ndarray


@dataclass(frozen=True, eq=False)
class Truth:
    """True pairs (p, q), their displacements (k, 3), m, and directions (k, 3) of their edges."""

    sets: Sets
    pairs: np.ndarray
    displacements: np.ndarray
    axes: np.ndarray

    def mean(self, vectors):
        """Mean length of vectors (k, 3) with the weights of the LHD, m."""
        rows, columns = np.nonzero(self.pairs)
        sizes = np.linalg.norm(vectors, axis=1)
        weights = lines.lengths(self.sets.model)[columns], lines.lengths(self.sets.test)[rows]
        return max(float(np.average(sizes, weights=weight)) for weight in weights)

    @property
    def across(self):
        """The part of the displacements across the edges, (k, 3), m."""
        along = (self.displacements * self.axes).sum(axis=1, keepdims=True)
        return self.displacements - along * self.axes


_canyon = lru_cache(maxsize=256)(canyon)


def scene(comparison="C1-TLS", *, seed, **conditions):
    """Return two surveys of a simulated canyon, and their truth.

    Parameters
    ----------
    comparison : str
        A name in ``COURSES``.
    seed : int
        Seed of the canyon.
    **conditions
        Passed to :func:`~mmqa_lab.simulate.canyon.canyon`.

    Returns
    -------
    tuple of Sets and Truth
    """
    found, names = _canyon(seed, **conditions), COURSES[comparison]
    test, model = (found.surveys[name] for name in names)
    sets, pairs = Sets(test.segments, model.segments), found.pairs(*names)
    axes = lines.directions(found.edges)[test.edge[np.nonzero(pairs)[0]]]
    return sets, Truth(sets, pairs, found.displacements(*names), axes)


def measured(sets, **choices):
    """Return the LHD of the sets, without warnings of few pairs, since the figures count them."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return lines.lhd(sets.test, sets.model, **choices)


def score(result, truth):
    """Return the figures of one comparison.

    Parameters
    ----------
    result : LHD, array of bool (p, q), or float
        Result of a method: the full result, pairs alone, or a distance (m) alone.
    truth : Truth
        From :func:`scene`.

    Returns
    -------
    dict of str to float
        ``f1``, ``false_pairs``, ``missed_pairs``, ``rate_percent`` (means of both directions);
        ``lhd_m``; the excess of the distance and of its part across the edges over the true
        displacement (``lhd_bias_m``, ``across_bias_m``). Figures of NaN are left out.
    """
    if np.isscalar(result):
        return {"lhd_m": result, "lhd_bias_m": result - truth.mean(truth.displacements)}
    if not isinstance(result, lines.LHD):
        result = measured(truth.sets, pairs=result)
    both = (result.test_model, result.model_test)
    scores = [lines.pairing_scores(part.pairs, truth.pairs) for part in both]
    figures = {
        "f1": np.mean([np.nan_to_num(s.f1) for s in scores]),
        "false_pairs": np.mean([s.fp for s in scores]),
        "missed_pairs": np.mean([s.fn for s in scores]),
        "rate_percent": 100 * np.mean([s.detection_rate for s in scores]),
        "lhd_m": result.value,
        "lhd_bias_m": result.value - truth.mean(truth.displacements),
        "across_bias_m": result.perpendicular_only - truth.mean(truth.across),
    }
    return {name: value for name, value in figures.items() if np.isfinite(value)}


def score_directions(result, truth):
    """Return the figures of Tables 1 and 2 for both directions; left means test to model."""
    figures = {"p": len(truth.sets.test), "q": len(truth.sets.model)}
    figures["pairs"] = int(truth.pairs.sum())
    for side, part in (("left", result.test_model), ("right", result.model_test)):
        counts = lines.pairing_scores(part.pairs, truth.pairs)
        found = {"false_negative": counts.fn, "false_positive": counts.fp}
        found["olhd_m"] = part.olhd(result.weight)
        figures |= {f"{side}_{name}": value for name, value in found.items()}
    return figures


def score_vector(result, truth):
    """Return :func:`score`, the displacement, its error, and whether its ellipsoid covers it."""
    found, figures = result.displacement, score(result, truth)
    error = found.vector - truth.displacements.mean(axis=0)
    if np.isfinite(error).all():
        square = error @ np.linalg.solve(found.covariance, error)
        figures["inside"] = float(square <= chi2.ppf(0.95, 3))
        figures["vector_error_m"] = np.linalg.norm(error)
        figures["vector_length_m"] = np.linalg.norm(found.vector)
    return figures


def _by_peak(**choices):
    """The published method with another reading of its threshold."""
    return partial(measured, threshold=partial(lines.peak_threshold, **choices))


def _hausdorff(sets):
    """The largest of all nearest distances in either direction, m (equations 1 and 2)."""
    there = lines.components(sets.test, sets.model).distance(10.0)
    back = lines.components(sets.model, sets.test).distance(10.0)
    return float(max(there.min(axis=1).max(), back.min(axis=1).max()))


METHODS = {
    "published": measured,
    "plain Hausdorff": _hausdorff,
    "peak's value": _by_peak(at="value"),
    "differences sorted again": _by_peak(sort_again=True),
    "first differences": _by_peak(order=1),
    "sensitivity 0.1 m": _by_peak(sensitivity=0.1),
    "sensitivity 2 m": _by_peak(sensitivity=2.0),
    "shorter line turned": partial(measured, rotate="shorter"),
    "any overlap": partial(measured, within="overlap"),
    "all targets": partial(measured, norm="all"),
    "hungarian": partial(measured, matcher="hungarian"),
    "fragments": partial(measured, matcher="fragments"),
    "displaced": partial(measured, matcher="displaced"),
}
"""The published method, its other readings and other methods, as functions of :class:`Sets`."""


def bench(*, methods=None, seeds=range(30), scored=score, comparison=tuple(COURSES), **conditions):
    """Define the study's bench: methods on comparisons of simulated canyons.

    Parameters
    ----------
    methods : dict, optional
        Functions of :class:`Sets` that return an ``LHD``, pairs or a distance; by default
        ``METHODS``.
    seeds : iterable of int
        Each seed gives a canyon.
    scored : callable
        :func:`score`, :func:`score_directions` or :func:`score_vector`.
    comparison : tuple of str
        Names in ``COURSES``.
    **conditions : tuple
        Values of the conditions of :func:`scene`.

    Returns
    -------
    Comparison
    """
    cases = grid(comparison=comparison, **conditions)
    figures = ("f1",) if scored is score else ()
    return Comparison(cases, dict(methods or METHODS), scene, scored, seeds, figures=figures)


def published_rows():
    """Return both printed tables, with rates and F1 computed from the printed counts.

    Returns
    -------
    DataFrame
        The printed columns, with ``name`` (as in ``COURSES``), ``rate_from_counts_percent``,
        ``null_rate_percent`` (rate if nothing is paired) and ``f1``.
    """
    tables = [table("poreba2013", name).assign(table=name) for name in ("table_1", "table_2")]
    rows = pd.concat(tables, ignore_index=True)
    rows["name"] = (rows["test_set"] + "-" + rows["model_set"]).str.replace("Course", "C")
    cells = rows["p_test_segments"] * rows["q_model_segments"]
    wrong = rows["false_negative"] + rows["false_positive"]
    rows["rate_from_counts_percent"] = 100 * (1 - wrong / cells)
    rows["null_rate_percent"] = 100 * (1 - rows["pairing_existing"] / cells)
    right = rows["pairing_existing"] - rows["false_negative"]
    rows["f1"] = 2 * right / (2 * right + wrong)
    return rows


def replicas(results):
    """Return the simulated means beside the printed distances.

    Parameters
    ----------
    results : Dataset
        Results of the published method with :func:`score_directions`.

    Returns
    -------
    DataFrame
        One row per printed distance (14 rows): the columns of :func:`published_rows`, ``side``,
        ``kind`` (fitted or predicted), ``simulated_m``, and ``low_m`` and ``high_m``, the 95 %
        range of single scenes.
    """
    rows = published_rows().rename(columns={"position_in_cell": "side"})
    second = rows["comparison"].str.contains("second")
    rows["kind"] = np.where(rows["name"].isin(FITTED) & ~second, "fitted", "predicted")
    published = results.sel({"method": "published"})
    cells = zip(rows["name"], rows["side"], strict=True)
    scenes = [published.sel({"comparison": name})[f"{side}_olhd_m"] for name, side in cells]
    rows[["simulated_m", "low_m", "high_m"]] = [list(of_scenes(one).values()) for one in scenes]
    return rows


def of_scenes(values):
    """Return the mean of simulated scenes and the 95 % range of one more.

    Parameters
    ----------
    values : DataArray
        A figure of each scene; NaN if not measurable.

    Returns
    -------
    dict of str to float
        ``value``, ``low`` and ``high``, by Student's t; ``low`` is not below 0.
    """
    found = mean_interval(values, of_next=True)
    return {"value": found.value, "low": max(found.low, 0.0), "high": found.high}
