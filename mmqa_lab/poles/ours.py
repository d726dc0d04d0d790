"""A learned detector.

Many candidates, features of the whole surroundings, a learned verdict.

Works without scan lines: the cloud is thinned, columns that have points over many heights become
candidates (``candidates``), each is described by its emptiness over height and azimuth, by what
stands around it and by the round shaft that explains it best (``features``), and small decision
trees, trained on simulated scenes alone, give the probability that it is a pole. Scan lines, where
there are any, give diameters.

The trees stand in ``model.txt`` in the text format of LightGBM. They were grown on 504 simulated
streets and yards (528,074 candidates, 78,146 of them poles) by
``python -m mmqa_lab.studies.poles_training FOLDER``.
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from mmqa_lab.poles import common
from mmqa_lab.poles.features import (
    AROUND_NAMES,
    BIN_M,
    MAX_LEAN,
    NAMES,
    ROUND_NAMES,
    candidates,
    describe,
    describe_around,
    describe_rounds,
)

FEATURES = NAMES + AROUND_NAMES + ROUND_NAMES
"""Of a candidate."""

WIDEST_M = 0.45
"""Radius about the axis in which scan lines are looked at for their chords, and longest chord."""

WITHIN_M, STEPS, LEAST_SLICES = 0.15, 8, 4
"""An accepted axis is straightened: a line through the middles of slices of 0.25 m, four or more,
of the points within 0.15 m of it, or within the core where that is wider, eight times over."""

BELOW = 1 / 3
"""What begins high above ground does not hang where points lie on its axis in so many of the height
bins below it: the rest is hidden or a gap between scan lines."""

FOOT_M, GROUND_M = 0.6, 0.3
"""Nor does it hang where no point within 0.6 m of the axis is within 0.3 m of the ground: what
hides the ground may hide a foot."""

SURE = 0.9
"""Few points are enough for what is a pole with this probability."""

GROUP_GAP_M = 0.10
"""Two consecutive points of a line farther apart belong to two things."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Choices of the learned method; all are ours.

    Parameters
    ----------
    threshold : float
        Least probability of a pole: the operating point. On twelve streets beside the training
        ones, of the kind ``table-4-1``, F1 is within 0.003 of its largest at 0.4.
    voxel : float
        Points are thinned to one a cube of that size, metres: what makes a dense scanner look like
        a sparse one.
    minimum_length : float
        Of the column of points, metres.
    minimum_points : float
        What stands free over less than that length needs so many points, after thinning, where it
        does, or a probability of 0.9: foliage and facades that a sparse scanner hits here and there
        have fewer.
    highest_foot : float
        Above the ground that is seen; what begins higher hangs, metres. Lower than 4 m it would
        refuse poles whose foot hides behind cars and hedges: 1 of 183 on those streets at 3 m.
    apart : float
        Two poles are at least that far apart, metres.
    """

    threshold: float = 0.4
    voxel: float = 0.03
    minimum_length: float = 1.0
    minimum_points: float = 8.0
    highest_foot: float = 4.0
    apart: float = 0.6


def detect(points, settings, *, lines=None, explain=False, model=None):
    """Return the poles of a cloud as :func:`mmqa_lab.poles.detect` does.

    ``points`` (n, 3) are metres from an origin nearby; from ``lines``, scan line and pulse of each,
    come chords; ``model`` is a ``lightgbm.Booster``, the package's where left out.
    """
    features, axes, ground = described(points, settings)
    model = read_model() if model is None else model
    probability = model.predict(features) if len(features) else np.empty(0)
    where = (features, axes, ground)
    return judged(points, where, probability, settings, lines=lines, explain=explain)


@cache
def read_model():
    """Return trees that come with the package, a ``lightgbm.Booster``."""
    from lightgbm import Booster

    text = resources.files("mmqa_lab.poles").joinpath("model.txt").read_text(encoding="utf-8")
    return Booster(model_str=text)


def judged(points, where, probability, settings, *, lines=None, explain=False):
    """Return the table of candidates with given probabilities; ``where`` is from ``described``."""
    features, axes, ground = where
    names = "column_m", "column_high_m", "below_core", "run_m", "run_points"
    column, top, below, run, seen = (features[:, NAMES.index(name)] for name in names)
    low, high = axes[:, 5], axes[:, 6]
    hangs = np.minimum(top - column, low) > settings.highest_foot
    hangs &= (below < BELOW) & (probability >= settings.threshold)
    hangs[hangs] = _ground_seen(points, axes[hangs], ground[hangs])
    reason = common.first_reason(
        len(axes),
        probability=probability < settings.threshold,
        length=column < settings.minimum_length,
        points=(run < settings.minimum_length)
        & (seen < np.log1p(settings.minimum_points))
        & (probability < SURE),
        foot=hangs,
    )
    middle = axes[:, :2] + axes[:, 2:4] * ((low + high) / 2 - axes[:, 4])[:, None]
    table = common.axis_rows(middle, ground + low, axes[:, 2:4], high - low)
    table |= {"score": probability, "rejected_by": reason}
    common.drop_duplicates(table, settings.apart)
    _measure(points, lines, table, axes[:, 7])
    return common.pole_table(table, "ours", explain=explain)


def _ground_seen(points, axes, ground):
    """Whether the points (n, 3) show the ground, heights (k,), at the foot of axes (k, 8)."""
    feet = axes[:, :2] - axes[:, 2:4] * axes[:, 4:5]
    found = common.rows(points[common.beside(points, feet, FOOT_M)])
    seen = np.zeros(len(feet), dtype=bool)
    for k, (x, y) in enumerate(feet):
        near = common.near_axis(found.points, found.start, found.base, x, y, FOOT_M)
        seen[k] = (np.abs(found.points[near, 2] - ground[k]) < GROUND_M).any()
    return seen


def described(points, settings):
    """Return features (k, len(FEATURES)), axes (k, 8) and ground heights (k,) of all candidates."""
    if not len(points):
        return np.empty((0, len(FEATURES))), np.empty((0, 8)), np.empty(0)
    thin = common.thinned(points, settings.voxel)
    ground = common.fit_ground(thin)
    height = ground.height(thin)
    xy = candidates(thin, height)
    found = common.rows(thin)
    where = (found.points, height[found.order], found.start, found.base)
    features, axes = describe(where, xy, np.full((len(xy), 5), np.nan))
    parts = features, describe_around(thin, height, axes), describe_rounds(where, axes)
    level = -ground.height(np.column_stack([axes[:, :2], np.zeros(len(axes))]))
    # rounded, so that a sum in another order of the points falls on the same side of a threshold
    return np.round(np.column_stack(parts), 5), axes, level


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
            widths = common.slice_widths(off[own], part[own, 2])[:, 0]
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


def chord_points(points, off, line, pulse):
    """Points of the group nearest to the axis on each scan line, and their lines.

    A group counts where the pulses right before and after it hit nothing nearby: what stands in
    front cuts a chord short, what touches it makes it longer.
    """
    if not len(points):
        return np.empty(0, np.int64), line
    order = np.lexsort([pulse, line])
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
    nearest = nearest[~_touched(line[order], pulse[order], first, last)[nearest]]
    which = order[np.isin(group, nearest)]
    return which, line[which]


def _touched(line, pulse, first, last):
    """Whether a pulse right before or after each group of a sorted line hits something nearby."""
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(line) - 1)
    left = (first > 0) & (line[before] == line[first]) & (pulse[first] - pulse[before] <= 2)
    right = (last < len(line) - 1) & (line[after] == line[last])
    return left | (right & (pulse[after] - pulse[last] <= 2))


# What a user asks of each pole, measured alike for the poles of every method, from the points
# around each axis: class, height, diameter, lean, and how much the cloud shows.

CLASSES = ("lamp or utility pole", "sign or signal", "trunk", "bollard or post", "other")

BREAST_M = 1.3
"""Height above ground of the diameter that foresters and surveyors give."""

OUTSIDE_M = 0.5
"""That height may lie so far beyond the measured part of the shaft."""

GAP_BINS = 2
AROUND_M = 0.5
"""A pole goes on upwards while points within half a metre of its axis leave no gap of half a
metre: lantern, board and crown belong to its total height."""

SURFACE_M = 0.05
"""Points so near to the surface of the shaft count as seen on it."""

VOXEL_M = 0.03
"""Points are thinned to that before the class is judged, as in the training."""

CONFIDENCE = 0.95

SPACING_SHARE = 0.5
"""How well the ends of a chord or slice are known beside its scatter, in ray spacings: chosen so
that on simulated streets nine in ten intervals contain the true diameter."""
