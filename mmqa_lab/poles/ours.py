"""A learned detector: many candidates, features of the whole surroundings, a learned verdict.

Works without scan lines: the cloud is thinned, columns that have points over many heights become
candidates (``candidates``), each is described by its emptiness over height and azimuth and by what
stands around it (``features``), on scan lines also by how its points stack up and by the rays that
it stops (``on_lines``), and small decision trees, trained on simulated streets alone, give the
probability that it is a pole.

The trees stand in ``model.txt`` in the text format of LightGBM. They were grown on 240 simulated
streets (393,102 candidates, 50,671 of them poles) by the histogram gradient boosting of
scikit-learn and written in this format once; ``python -m mmqa_lab.studies.poles_training FOLDER``
grows new ones on the same streets.
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from mmqa_lab.poles import common, on_lines
from mmqa_lab.poles.features import (
    BIN_M,
    FACADE_NAMES,
    MAX_LEAN,
    NAMES,
    candidates,
    describe,
    describe_facades,
)

FEATURES = NAMES + FACADE_NAMES + on_lines.STACK_NAMES + on_lines.RAY_NAMES
"""Of a candidate; those of stacks and rays on scan lines are -1 where there are no lines."""

WIDEST_M = 0.45
"""Radius about the axis in which scan lines are looked at for their chords, and longest chord."""

WITHIN_M, STEPS, LEAST_SLICES = 0.15, 8, 4
"""An accepted axis is straightened: a line through the middles of slices of 0.25 m, four or more,
of the points within 0.15 m of it, or within the core where that is wider, eight times over."""

GROUP_GAP_M = 0.10
"""Two consecutive points of a line farther apart belong to two things."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Choices of the learned method; all are ours.

    Parameters
    ----------
    threshold : float
        Least probability of a pole: the operating point. On twelve streets beside the training
        ones, of the kind ``table-4-1``, F1 is within 0.005 of its largest at 0.4.
    voxel : float
        Points are thinned to one a cube of that size, metres: what makes a dense scanner look like
        a sparse one.
    minimum_length : float
        Of the pole-like part, metres.
    apart : float
        Two poles are at least that far apart, metres.
    """

    threshold: float = 0.4
    voxel: float = 0.03
    minimum_length: float = 1.0
    apart: float = 0.6


def detect(points, settings, *, lines=None, explain=False, model=None):
    """Return the poles of a cloud.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    settings : Settings
    lines : pair of array, shape (n,), optional
        Scan line and place along it: where known, diameters come from chords.
    explain : bool
    model : lightgbm.Booster, optional
        The one that comes with the package where left out.

    Returns
    -------
    DataFrame
        See :func:`mmqa_lab.poles.detect`.
    """
    features, axes, ground = described(points, settings, lines=lines)
    model = read_model() if model is None else model
    probability = model.predict(features) if len(features) else np.empty(0)
    where = (features, axes, ground)
    return judged(points, where, probability, settings, lines=lines, explain=explain)


@cache
def read_model(name="model.txt"):
    """Return trees that come with the package, a ``lightgbm.Booster``."""
    from lightgbm import Booster

    text = resources.files("mmqa_lab.poles").joinpath(name).read_text(encoding="utf-8")
    return Booster(model_str=text)


def judged(points, where, probability, settings, *, lines=None, explain=False):
    """Return the table of candidates with given probabilities; ``where`` is from ``described``."""
    features, axes, ground = where
    reason = common.first_reason(
        len(axes),
        probability=probability < settings.threshold,
        length=features[:, NAMES.index("column_m")] < settings.minimum_length,
    )
    low, high = axes[:, 5], axes[:, 6]
    middle = axes[:, :2] + axes[:, 2:4] * ((low + high) / 2 - axes[:, 4])[:, None]
    table = common.axis_rows(middle, ground + low, axes[:, 2:4], high - low)
    table |= {"score": probability, "rejected_by": reason}
    common.drop_duplicates(table, settings.apart)
    _measure(points, lines, table, axes[:, 7])
    return common.pole_table(table, "ours", explain=explain)


def described(points, settings, *, lines=None):
    """Return features (k, len(FEATURES)), axes (k, 8) and ground heights (k,) of all candidates."""
    if not len(points):
        return np.empty((0, len(FEATURES))), np.empty((0, 8)), np.empty(0)
    thin = common.thinned(points, settings.voxel)
    ground = common.fit_ground(thin)
    height = ground.height(thin)
    xy = candidates(thin, height)
    given = np.full((len(xy), 5), np.nan)
    ordered = stacks = None
    if lines is not None:
        ordered = on_lines.in_order(points, *lines)
        stacks = on_lines.line_groups(ordered, ground.height)
        xy, given = _with_stacks(xy, given, stacks)
    sorted_thin = common.rows(thin)
    where = (sorted_thin.points, height[sorted_thin.order], sorted_thin.start, sorted_thin.base)
    features, axes = describe(*where, xy, given)
    level = -ground.height(np.column_stack([axes[:, :2], np.zeros(len(axes))]))
    features = np.column_stack([features, describe_facades(thin, height, axes)])
    evidence = np.full((len(xy), len(on_lines.STACK_NAMES + on_lines.RAY_NAMES)), -1.0)
    if stacks is not None:
        beside, ends = on_lines.describe_stacks(stacks, axes)
        evidence = np.column_stack([beside, on_lines.describe_rays(ordered, axes, level)])
        longer = ends[:, 1] - ends[:, 0] > axes[:, 6] - axes[:, 5]
        axes[longer, 5:7] = ends[longer]
    # rounded, so that a sum in another order of the points falls on the same side of a threshold
    return np.round(np.column_stack([features, evidence]), 5), axes, level


def _with_stacks(xy, given, stacks):
    """Candidates and known axes, with those of stacked groups."""
    more = on_lines.stack_candidates(stacks)
    axes = on_lines.axes_of(*stacks[:4], more)
    return np.concatenate([xy, axes[:, :2]]), np.concatenate([given, axes])


def _measure(points, lines, table, radius):
    """Straighten the axes of the accepted candidates and write their diameters.

    Diameters come from chords of scan lines, or from the narrowest quarter of the widths in plan:
    boards are wider than their post.
    """
    table["diameter_m"] = np.full(len(radius), np.nan)
    accepted = np.flatnonzero(table["rejected_by"] == "")
    xy = np.column_stack([table["x_m"], table["y_m"]])[accepted]
    reaches = WIDEST_M + np.hypot(table["lean_x"], table["lean_y"]) * table["height_m"] / 2
    chosen = common.beside(points, xy, reaches[accepted].max(initial=0))
    found = common.rows(points[chosen])
    for k in accepted:
        x, y, z, h = (table[name][k] for name in ("x_m", "y_m", "z_base_m", "height_m"))
        near = common.near_axis(found.points, found.start, found.base, x, y, reaches[k])
        part = found.points[near]
        inside = (part[:, 2] >= z) & (part[:, 2] <= z + h)
        part, number = part[inside], chosen[found.order[near[inside]]]
        axis = np.array([[x, y], [table["lean_x"][k], table["lean_y"][k]]])
        rise = part[:, 2] - z - h / 2
        axis = _straightened(part[:, :2], rise, axis, max(radius[k], WITHIN_M))
        (table["x_m"][k], table["y_m"][k]), lean = axis
        table["lean_x"][k], table["lean_y"][k] = lean
        off = part[:, :2] - axis[0] - lean * rise[:, None]
        if lines is None:
            own = np.hypot(*off.T) <= max(radius[k], WITHIN_M)
            widths = common.slice_widths(off[own], part[own, 2])
            table["diameter_m"][k] = np.quantile(widths, 0.25) if len(widths) else np.nan
        else:
            direction = np.array([*lean, 1.0]) / np.sqrt(1 + lean @ lean)
            which, line = chord_points(part, off, *(values[number] for values in lines))
            table["diameter_m"][k] = common.shaft_diameter(part[which], direction, line)


def _straightened(xy, rise, axis, within):
    """Axis (place and lean) through the middles of the slices of what lies within that distance."""
    for _ in range(STEPS):
        place, lean = axis
        near = np.hypot(*(xy - place - lean * rise[:, None]).T) <= within
        level = np.floor(rise[near] / BIN_M).astype(np.int64)
        _, level, count = np.unique(level, return_inverse=True, return_counts=True)
        if len(count) < LEAST_SLICES:
            return axis
        centre = [np.bincount(level, values) / count for values in (*xy[near].T, rise[near])]
        lean, place = np.polyfit(centre[2], np.stack(centre[:2], axis=1), 1)
        if np.abs(lean).max() > MAX_LEAN:
            return axis
        axis = np.array([place, lean])
    return axis


def chord_points(points, off, line, place):
    """Points of the group nearest to the axis on each scan line, and their lines.

    A group counts where the pulses right before and after it hit nothing nearby: what stands in
    front cuts a chord short, what touches it makes it longer.
    """
    if not len(points):
        return np.empty(0, np.int64), line
    order = np.lexsort([place, line])
    gap = np.linalg.norm(np.diff(points[order], axis=0), axis=1) > GROUP_GAP_M
    broken = np.concatenate([[False], gap | (np.diff(line[order]) != 0)])
    group = np.cumsum(broken)
    count = np.bincount(group, minlength=1)
    centre = [np.bincount(group, off[order, k]) / np.maximum(count, 1) for k in range(2)]
    away = np.hypot(*centre)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    owner = line[order[first]]
    ranked = np.lexsort([away, owner])
    nearest = ranked[np.unique(owner[ranked], return_index=True)[1]]
    last = first + count - 1
    chord = np.linalg.norm(off[order[first]] - off[order[last]], axis=1)
    nearest = nearest[(away[nearest] <= WIDEST_M / 2) & (chord[nearest] <= WIDEST_M)]
    nearest = nearest[~_touched(line[order], place[order], first, last)[nearest]]
    which = order[np.isin(group, nearest)]
    return which, line[which]


def _touched(line, place, first, last):
    """Whether a pulse right before or after each group of a sorted line hits something nearby."""
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(line) - 1)
    left = (first > 0) & (line[before] == line[first]) & (place[first] - place[before] <= 2)
    right = (last < len(line) - 1) & (line[after] == line[last])
    return left | (right & (place[after] - place[last] <= 2))
