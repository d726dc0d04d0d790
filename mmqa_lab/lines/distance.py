"""Line-segment Hausdorff distance of two sets (Poreba & Goulette 2013)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mmqa_lab._checks import check_choice, check_number, listed
from mmqa_lab._results import sentences
from mmqa_lab.lines.displacement import match_displaced
from mmqa_lab.lines.hausdorff import LHD, WAYS, Directed
from mmqa_lab.lines.pairing import MATCHERS, Threshold, check_pairs, correspond, peak_threshold
from mmqa_lab.lines.segments import Components, check_segments, components, lengths

__all__ = ["LHD", "Directed", "compare", "lhd"]


def lhd(
    test: ArrayLike,
    model: ArrayLike,
    *,
    weight: float = 10.0,
    matcher: str = "all",
    rotate: str = "test",
    within: str = "containment",
    norm: str = "pairs",
    threshold: Callable = peak_threshold,
    pairs: ArrayLike | None = None,
    radius: float = 4.0,
) -> LHD:
    """Return the line-segment Hausdorff distance between a test and a model set.

    In each direction the threshold is at the jump of the sorted nearest distances. Segments within
    the threshold are paired. The directed distance is the mean over the pairs, weighted by the
    length of the target. The larger directed distance is the result.

    Parameters
    ----------
    test, model : array_like, shapes (p, 2, 3) and (q, 2, 3)
        Segments, m.
    weight : float
        W of the angle, >= 0.
    matcher : {"all", "nearest", "mutual", "hungarian", "fragments", "displaced"}
        ``all`` is the published method. ``displaced`` estimates the displacement first
        (:func:`match_displaced`); if it finds no pairs, ``fragments`` is used.
    rotate, within
        As in :func:`components`.
    norm : {"pairs", "all"}
        Divisor of the weighted sum of equation 7: the summed length of all pairs (a mean, which
        agrees with the published numbers), or of all targets (as printed).
    threshold : callable
        Takes the nearest distances of a direction (m) and returns a :class:`Threshold`. For other
        settings of :func:`peak_threshold` use ``functools.partial``.
    pairs : array_like of bool, shape (p, q), optional
        Known pairs, used instead of threshold and matcher.
    radius : float
        Largest displacement that ``displaced`` seeks, m.

    Returns
    -------
    LHD

    Raises
    ------
    ValueError
        If a setting is out of range, or the nearest segments of both sets are more than 100 m
        apart, as in different coordinate systems.

    Warns
    -----
    UserWarning
        If a set is empty, a threshold is a fallback, fewer than five pairs remain, or ``displaced``
        pairs few of the lines, or none and is replaced by ``fragments``.

    See Also
    --------
    match_displaced : the displacement of the sets itself, with its covariance.

    Notes
    -----
    The value is no displacement. Noise of angles and end points and false pairs increase it, and a
    large displacement reduces it. Compare :attr:`LHD.perpendicular_only`, ``displacement`` and the
    coverage. The value is no metric either.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), section 2 and equations 2 to 7.

    Examples
    --------
    >>> both = [[[0, 0, 0], [9, 0, 0]], [[0, 0, 0], [0, 0, 6]], [[9, 0, 0], [9, 0, 7]],
    ...         [[9, 0, 7], [9, 8, 7]], [[0, 0, 6], [0, 8, 6]]]
    >>> model = [*both, [[0, 20, 0], [0, 20, 6]]]
    >>> test = np.array([*both, [[9, 40, 0], [9, 40, 7]]]) + [0.3, 0, 0.1]
    >>> result = lhd(test, model)
    >>> round(result.value, 3), result.test_model.n
    (0.316, 5)
    >>> (result.displacement.vector.round(2) + 0).tolist()
    [0.3, 0.0, 0.1]
    """
    weight = check_number(weight, "weight", low=0)
    check_choice(matcher, "matcher", (*MATCHERS, "displaced"))
    check_choice(norm, "norm", ("pairs", "all"))
    test, model = check_segments(test, "test"), check_segments(model, "model")
    settings = {"weight": weight, "rotate": rotate, "within": within, "norm": norm}
    settings["threshold"], doubts = threshold, []
    if pairs is not None:
        pairs = check_pairs(pairs, (len(test), len(model)))
    elif matcher == "displaced":
        moved = match_displaced(test, model, radius=radius)
        pairs, doubts = moved.pairs, [*moved.remarks] if moved.pairs.size else []
        if pairs.size and not pairs.any():
            pairs, matcher = None, "fragments"
            doubts += ["Matcher 'fragments' is used."]
    there = _one_way(test, model, matcher=matcher, pairs=pairs, **settings)
    turned = None if pairs is None else pairs.T
    back = _one_way(model, test, matcher=matcher, pairs=turned, **settings)
    back = replace(back, pairs=back.pairs.T)
    remarks = *_doubts(test, model, there, back), *doubts
    for remark in remarks:
        warnings.warn(remark, stacklevel=2)
    return LHD(weight, matcher, there, back, test, model, remarks)


def _one_way(source, target, *, threshold, matcher, pairs, weight, rotate, within, norm):
    """Directed distance from source to target, with pairs (source, target)."""
    parts = components(source, target, rotate=rotate, within=within)
    distances = parts.distance(weight)
    nearest = distances.min(axis=1) if len(target) else np.empty(0)
    if len(nearest) and nearest.min() > 100:
        wanted = "segments within 100 m of each other, in one coordinate system"
        raise ValueError(f"Invalid sets {nearest.min():.0f} m apart. Must have {wanted}.")
    found = Threshold(np.nan, False, np.sort(nearest))
    if pairs is None:
        found = threshold(nearest)
        pairs = correspond(distances, found.delta, matcher=matcher, test=source, model=target)
    rows, columns = np.nonzero(pairs)
    own, length = lengths(source), lengths(target)
    total = length[columns].sum() if norm == "pairs" else length.sum()
    return Directed(
        threshold=found,
        pairs=pairs,
        parts=Components(*(part[rows, columns] for part in vars(parts).values())),
        share=length[columns] / total,
        source=rows,
        coverage=float(own[np.unique(rows)].sum() / own.sum()) if len(own) else np.nan,
    )


def _doubts(test, model, there, back):
    """Reasons to doubt a distance, each as a sentence."""
    if empty := [name for name, ends in (("test", test), ("model", model)) if not len(ends)]:
        return [f"No {' and no '.join(empty)} segments, so there is nothing to measure."]
    sides = list(zip(WAYS, (there, back), strict=True))
    return sentences(
        *(
            (
                side.threshold.fallback,
                f"No jump in the nearest distances from {way}. The threshold is the largest "
                f"distance, {side.threshold.delta:.3g} m.",
            )
            for way, side in sides
        ),
        *(
            (side.n < 5, f"Only {side.n} pairs from {way}. The value may be due to chance.")
            for way, side in sides
        ),
    )


def compare(
    sets: Mapping[str, ArrayLike],
    *,
    reference: str | None = None,
    radius: float = 4.0,
    **choices: Any,
) -> pd.DataFrame:
    """Compare several sets of segments with each other in both directions, as in the paper.

    Parameters
    ----------
    sets : dict of str to array_like, shape (n, 2, 3)
        Segments by name, two sets or more, m.
    reference : str, optional
        The reference set, which is always the model.
    radius : float
        Largest displacement that is sought, m.
    **choices
        Passed to :func:`lhd`.

    Returns
    -------
    DataFrame
        A row for each comparison and direction: ``kind`` (repeatability, absolute), ``comparison``,
        the columns of :meth:`LHD.to_frame`, the 95 % confidence interval of the larger distance,
        the displacement (m) with its standard deviations, the number of pairs that
        agree on it (``displaced_pairs``), and ``remarks``.

    Raises
    ------
    ValueError
        If there are fewer than two sets, one is empty, or two have no segments within 100 m.

    References
    ----------
    Poreba & Goulette 2013 (hal-00846334), Tables 1 and 2.

    Examples
    --------
    >>> from mmqa_lab.simulate.canyon import canyon
    >>> scene = canyon(1)
    >>> sets = {name: scene.surveys[name].segments for name in ("TLS", "C1", "C3")}
    >>> compare(sets, reference="TLS")["direction"].tolist()[:3]
    ['C1 to C3', 'C3 to C1', 'C1 to TLS']
    """
    checked = {name: check_segments(segments, name) for name, segments in sets.items()}
    if len(checked) < 2 or not all(map(len, checked.values())):
        told = listed(f"{name} with {len(ends)} segments" for name, ends in checked.items())
        raise ValueError(f"Invalid sets {told or 'of none'}. Must be two or more with segments.")
    check_choice(reference, "reference", (None, *sets))
    courses = [name for name in sets if name != reference]
    pairs = [("repeatability", names) for names in combinations(courses, 2)]
    pairs += [("absolute", (name, reference)) for name in courses if reference is not None]
    tables = [_compared(*pair, checked, radius, choices) for pair in pairs]
    return pd.concat(tables, ignore_index=True)


def _compared(kind, names, sets, radius, choices):
    """The two rows of a comparison."""
    test, model = (sets[name] for name in names)
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        found = lhd(test, model, radius=radius, **choices)
    moved = found.displacement
    if found.matcher != "displaced":
        moved = match_displaced(test, model, radius=radius)
    table, remarks = found.to_frame(), found.remarks
    names = [*map(str, names)]
    table["direction"] = " to ".join(names), " to ".join(names[::-1])
    table.insert(0, "kind", kind)
    table.insert(1, "comparison", "-".join(names))
    table["lhd_low_m"], table["lhd_high_m"] = found.intervals()[["low", "high"]].to_numpy()[0]
    for k, axis in enumerate("xyz"):
        table[f"displacement_{axis}_m"] = moved.vector[k]
        table[f"sigma_{axis}_m"] = np.sqrt(moved.covariance[k, k])
    table["displaced_pairs"] = moved.n
    remarks = *remarks, *(remark for remark in moved.remarks if remark not in remarks)
    open_ways = not np.isfinite(moved.vector).all()
    none = "No displacement: too few lines agree, or all of them are parallel."
    return table.assign(remarks=" ".join([*remarks, *sentences((open_ways, none))]))
