"""What a user asks of each pole: its class, height, diameter, lean, and how much the cloud shows.

Measured alike for the poles of every method, from the points around each axis. Classes come from
small decision trees, ``classes.txt`` in the text format of LightGBM, trained on simulated streets
alone; ``python -m mmqa_lab.studies.poles_training`` grows them anew.
"""

import numpy as np
from scipy.stats import t as student

from mmqa_lab.poles import common
from mmqa_lab.poles.features import BIN_M, REACH_M, describe
from mmqa_lab.poles.ours import WIDEST_M, chord_points, read_model

CLASSES = ("lamp or utility pole", "sign or signal", "trunk", "bollard or post", "other")

BREAST_M = 1.3
"""Height above ground of the diameter that foresters and surveyors give."""

GIRTH = ("diameter_13_m", "diameter_13_low_m", "diameter_13_high_m")

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
"""How well the ends of a chord are known beside its scatter, in ray spacings: chosen so that on
simulated streets nine in ten intervals contain the true diameter."""


def with_attributes(points, found, lines=None):
    """Return a table of poles with what is measured about each.

    Parameters
    ----------
    points : array, shape (n, 3)
        Metres from an origin nearby.
    found : DataFrame
        Of :func:`mmqa_lab.poles.common.pole_table`; of rejected candidates nothing is measured.
    lines : pair of array, shape (n,), optional
        Scan line and place along it of each point.

    Returns
    -------
    DataFrame
        With the columns that :func:`mmqa_lab.poles.detect` names.
    """
    made = found.assign(total_height_m=np.nan, **dict.fromkeys(GIRTH, np.nan), points=0)
    made["class"], made["class_probability"] = "", np.nan
    made["lean_azimuth_deg"] = np.degrees(np.arctan2(made["lean_x"], made["lean_y"])) % 360
    kept = np.flatnonzero(made.get("rejected_by", np.full(len(made), "")) == "")
    if not len(kept):
        return made
    around = _Around(points, made.iloc[kept], lines)
    for row, pole in zip(kept, around.poles(), strict=True):
        for name, value in pole.items():
            made.loc[row, name] = value
    probability = read_model("classes.txt").predict(around.features())
    made.loc[kept, "class"] = np.array(CLASSES)[probability.argmax(axis=1)]
    made.loc[kept, "class_probability"] = probability.max(axis=1)
    return made


class _Around:
    """The points around the axes of a table of poles."""

    def __init__(self, points, table, lines):
        self.lines = lines
        self.middle = np.ascontiguousarray(table[["x_m", "y_m"]])  # compiled for one layout
        self.lean = table[["lean_x", "lean_y"]].to_numpy()
        self.low, self.length = table["z_base_m"].to_numpy(), table["height_m"].to_numpy()
        self.width = table["diameter_m"].to_numpy()
        foot = self.middle - self.lean * (self.length / 2)[:, None]
        ends = np.column_stack([foot, self.low])
        self.ground = common.fit_ground(points)
        self.base = self.ground.height(ends)  # of the lower end
        reach = REACH_M + np.hypot(*self.lean.T).max() * self.length.max()
        self.chosen = common.beside(points, self.middle, reach)
        self.near = points[self.chosen]
        self.reach = reach

    def poles(self):
        """Yield what is measured about each pole."""
        found = common.rows(self.near)
        for k in range(len(self.low)):
            which = common.near_axis(*found[:3], *self.middle[k], self.reach)
            part, number = found.points[which], self.chosen[found.order[which]]
            h = part[:, 2] - self.low[k]
            off = part[:, :2] - self.middle[k] - self.lean[k] * (h - self.length[k] / 2)[:, None]
            across, inside = np.hypot(*off.T), (h >= 0) & (h <= self.length[k])
            seen = inside & (across <= self._radius(k) + SURFACE_M)
            top = _top(h[across <= AROUND_M], self.length[k])
            close = inside & (across <= WIDEST_M)
            lines = None if self.lines is None else [v[number[close]] for v in self.lines]
            girth = self._girth(k, part[close], off[close], lines)
            total = {"total_height_m": self.base[k] + top, "points": int(seen.sum())}
            yield total | dict(zip(GIRTH, girth, strict=True))

    def _radius(self, k):
        """Radius of a shaft, 5 cm where it is not known."""
        return self.width[k] / 2 if np.isfinite(self.width[k]) else 0.05

    def _girth(self, k, part, off, lines):
        """Diameter at 1.3 m above ground and its interval; NaN where it is not measurable."""
        z = self.low[k] - self.base[k] + BREAST_M
        if lines is None:
            near = np.abs(part[:, 2] - z) <= OUTSIDE_M
            return _mean_width(common.slice_widths(off[near], part[near, 2]))
        direction = np.array([*self.lean[k], 1.0])
        direction /= np.linalg.norm(direction)
        which, line = chord_points(part, off, *lines)
        return _diameter_at(z, common.shaft_chords(part[which], direction, line))

    def features(self):
        """What the trees of the classes judge, (k, n)."""
        thin = common.thinned(self.near, VOXEL_M)
        height = self.ground.height(thin)
        found = common.rows(thin)
        half = self.base + self.length / 2
        given = np.column_stack([self.middle, self.lean, half])
        where = (found.points, height[found.order], found.start, found.base)
        return np.round(describe(*where, self.middle, given)[0], 5)


def _top(h, length):
    """Height of what goes on upwards from the shaft without a gap, from its lower end."""
    bins = np.unique(np.floor(h[h >= 0] / BIN_M))
    bins = bins[bins >= np.floor(length / BIN_M) - 1]
    gaps = np.flatnonzero(np.diff(bins) > GAP_BINS)
    last = bins[gaps[0]] if len(gaps) else bins.max(initial=0)
    return max(h[h < (last + 1) * BIN_M].max(initial=0), length)


def _mean_width(widths):
    """Median of the widths of slices and the interval of their mean, metres."""
    if len(widths) < 2:
        return np.nan, np.nan, np.nan
    middle = float(np.median(widths))
    half = _quantile(len(widths) - 1) * np.std(widths, ddof=1) / np.sqrt(len(widths))
    return middle, max(middle - half, 0.0), middle + half


def _diameter_at(z, shaft):
    """Diameter at the height ``z`` from chords that agree, and its interval, metres."""
    n, heights = len(shaft.chords), shaft.heights
    if not n or not heights.min() - OUTSIDE_M <= z <= heights.max() + OUTSIDE_M:
        return np.nan, np.nan, np.nan
    upright = shaft.chords + shaft.taper * (heights - z) + shaft.spacing
    value, spread = upright.mean(), upright.std(ddof=2)
    off = heights - heights.mean()
    share = 1 / n + (z - heights.mean()) ** 2 / max(off @ off, 1e-9)
    half = np.hypot(_quantile(n - 2) * spread * np.sqrt(share), SPACING_SHARE * shaft.spacing)
    return value, max(value - half, 0.0), value + half


def _quantile(freedom):
    """Half width of an interval in standard errors."""
    return student.ppf((1 + CONFIDENCE) / 2, freedom)
