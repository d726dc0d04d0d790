"""Fit for what? Figures of a chart beside what can be done with a cloud of the same acquisition."""

from dataclasses import replace

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from scipy.stats import qmc, rankdata

from mmqa_lab import bench as benches
from mmqa_lab import poles
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.lines import extract_edges
from mmqa_lab.simulate import PRESETS, Scanner, Scene, cylinder, rectangle, straight, systems
from mmqa_lab.spacing import exempt

RANGES = {
    "speed_kmh": (10, 80),
    "distance_m": (4, 25),
    "pulse_rate_hz": (1e5, 2e6),
    "mirror_frequency_hz": (48, 250),
    "noise_mm": (1, 20),
    "heading_deg": (0, 45),
    "tilt_deg": (0, 45),
    "height_m": (0, 2),
    "turn_deg": (-30, 30),
}
"""From which acquisitions are drawn: those of the five sources, and of heads of today (2 MHz and
250 Hz). They were fixed before any score was computed. Rates are of one head. The scanner is
``height_m`` above the middle of the objects, which are turned from the road by ``turn_deg``."""

BEAMS = {"pulse_rate_hz": (3e5, 1.4e6), "mirror_frequency_hz": (5, 20)}
"""The rates of scanners with 32 beams."""

LOGARITHMIC = ("distance_m", "pulse_rate_hz", "mirror_frequency_hz", "noise_mm")
"""Drawn evenly in their logarithm, the others evenly."""

KINDS = ("one head", "two heads", "32 beams")

BORESIGHT_DEG = 0.02
"""Standard deviation by which a second head is turned against the first, about each axis."""

GOOD = {
    "detail_missed_percent": 5,
    "end_mm": 10,
    "step_mm": 2.5,
    "offset_mm": 3,
    "tilt_deg": 0.5,
    "edge_missed_percent": 10,
    "edge_mm": 10,
    "pole_missed_percent": 0,
    "diameter_mm": 20,
}
"""The tasks, and the largest error with which a cloud is fit for each; fixed beforehand, too."""

STEP_M = 0.01

WALL_M = 1.5 * np.sqrt(0.5)

POSTS_M = {-1.2: 0.06, 0.0: 0.12, 1.2: 0.30}
"""Places along the road from the middle of the posts, and diameters."""

PLACES = {"chart": -6, "board": -4, "stepped": -2, "corner": 1, "posts": 5}
"""Objects in a row along the road: places of their middles, m."""

WORST = {"offset_mm": 100, "tilt_deg": 90, "step_mm": 1000 * STEP_M, "edge_mm": 100}
"""Errors where nothing can be measured."""


def acquisitions(count, *, seed):
    """Draw acquisitions by Latin hypercubes over ``RANGES``, as many of each of ``KINDS``.

    Parameters
    ----------
    count : int
        Acquisitions of each kind.
    seed : int
        Seed of the draw. It becomes the column ``draw``.

    Returns
    -------
    DataFrame
        ``kind``, ``draw``, ``number`` and the names of ``RANGES``.

    Examples
    --------
    >>> acquisitions(2, seed=1)["kind"].tolist()
    ['one head', 'one head', 'two heads', 'two heads', '32 beams', '32 beams']
    """
    parts = []
    for k, kind in enumerate(KINDS):
        limits = RANGES | (BEAMS if kind == "32 beams" else {})
        low, high = np.array(list(limits.values()), dtype=float).T
        logarithmic = np.isin(list(limits), LOGARITHMIC)
        drawn = qmc.LatinHypercube(len(limits), rng=seed * len(KINDS) + k).random(count)
        even = low + drawn * (high - low)
        steady = np.exp(
            np.log(np.maximum(low, 1e-9)) * (1 - drawn) + np.log(np.maximum(high, 1e-9)) * drawn
        )
        values = pd.DataFrame(np.where(logarithmic, steady, even), columns=list(limits))
        values.insert(0, "kind", kind)
        values.insert(1, "draw", seed)
        values.insert(2, "number", range(k * count, (k + 1) * count))
        parts.append(values)
    return pd.concat(parts, ignore_index=True)


def heads(case, rng):
    """Return the scanners of an acquisition; the second of two is turned against the first."""
    mounting = {"heading_deg": case["heading_deg"], "tilt_deg": case["tilt_deg"]}
    rates = {name: case[name] for name in ("pulse_rate_hz", "mirror_frequency_hz")}
    choices = mounting | rates | {"range_noise_m": case["noise_mm"] / 1000}
    if case["kind"] == "32 beams":
        return [replace(PRESETS["hdl-32e"], **choices)]
    first = Scanner(**choices)
    boresight = tuple(BORESIGHT_DEG * rng.standard_normal(3))
    second = replace(first, heading_deg=-case["heading_deg"], boresight_deg=boresight)
    return [first, second] if case["kind"] == "two heads" else [first]


class Row:
    """A drive past a row of objects beside the road, each turned about its own middle.

    Objects have the coordinates along the road, up, and towards the road, m, from their middle.
    """

    def __init__(self, case):
        turn = np.radians(systems.FACING_THE_ROAD + case["turn_deg"])
        c, s = np.cos(turn), np.sin(turn)
        self.axes = np.array([[-c, s, 0], [0, 0, 1], [s, c, 0]])
        self.middles = {name: (case["distance_m"], y, 0) for name, y in PLACES.items()}
        self.surfaces, self.owners, self.corners = [], [], []

    def add(self, name, surface, corners):
        """Add a surface of an object; ``corners`` (k, 3) say where it ends, m."""
        self.surfaces.append(surface)
        self.owners.append(name)
        self.corners.append(corners)

    def wall(self, name, corner, along, up):
        """Add a rectangle to an object."""
        corner, along, up = np.array([corner, along, up], dtype=float) @ self.axes
        corner = self.middles[name] + corner
        ends = np.array([corner, corner + along, corner + up, corner + along + up])
        self.add(name, rectangle(corner, along, up), ends)

    def scan(self, case, rng):
        """Drive past; return the points of each object, shape (n, 3), and their surfaces."""
        reach = systems.REACH * case["distance_m"] - min(PLACES.values())
        start = (0, rng.uniform(-0.5, 0.5) - reach, case["height_m"])
        path = straight(2 * reach, case["speed_kmh"] / 3.6, start=start)
        drive = Scene(self.surfaces), path, np.concatenate(self.corners)
        clouds = [
            systems.drive_past(drive[0], head, *drive[1:], seed=[int(rng.integers(2**32))])
            for head in heads(case, rng)
        ]
        clouds = [cloud for cloud in clouds if len(cloud)]
        points = np.concatenate([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
        surface = np.concatenate([np.empty(0), *(cloud["surface"] for cloud in clouds)]).astype(int)
        owner = np.array(self.owners)[surface]
        return {
            name: ((points[owner == name] - middle) @ self.axes.T, surface[owner == name])
            for name, middle in self.middles.items()
        }


def detail_missed_percent(xy, size_m=0.05, fewest=3):
    """Return the share of places of a board whose disc has fewer points than ``fewest``, percent.

    ``xy`` has the shape (n, 2), m, from the middle of a board of 1 m; discs are ``size_m`` wide.
    """
    side = np.linspace(-0.45, 0.45, 46)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    far = cKDTree(xy).query(places, k=[fewest])[0] if len(xy) else np.inf
    return 100 * float(np.mean(far > size_m / 2))


def end_mm(xy):
    """Return by how much the points of a board end before its edges, mm (root mean square).

    Each edge of the board of 1 m has five parts, each 16 cm long; a part without points within half
    a metre counts as 0.5 m.
    """
    gaps = []
    for along, across in ((0, 1), (1, 0)):
        for sign in (-1, 1):
            for middle in 0.16 * np.arange(-2, 3):
                near = np.abs(xy[:, along] - middle) <= 0.08
                gaps.append((0.5 - sign * xy[near, across]).clip(0).min(initial=0.5))
    return 1000 * float(np.sqrt(np.mean(np.square(gaps))))


def signs(points):
    """Return the errors of four signs of 0.5 m cut from a board: offset (mm) and tilt (degrees)."""
    errors = []
    for middle in np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]):
        near = (np.abs(points[:, :2] - middle) <= 0.25).all(axis=1)
        design = np.column_stack([points[near, :2] - middle, np.ones(near.sum())])
        (a, b, c), _, rank, _ = np.linalg.lstsq(design, points[near, 2])
        errors.append((1000 * c, np.degrees(np.arctan(np.hypot(a, b)))) if rank == 3 else (100, 90))
    offset, tilt = np.sqrt(np.mean(np.square(errors), axis=0))
    return {"offset_mm": min(offset, WORST["offset_mm"]), "tilt_deg": tilt}


def step_mm(points, stepped):
    """Return the error of a step between patches of 20 cm on a plain and a stepped board, mm."""
    errors = []
    for board, true in ((points, 0.0), (stepped, 1000 * STEP_M)):
        for middle in 0.2 * np.arange(-2, 3):
            row = board[np.abs(board[:, 1] - middle) <= 0.1]
            left = row[(row[:, 0] > -0.2) & (row[:, 0] < 0), 2]
            right = row[(row[:, 0] < 0.2) & (row[:, 0] > 0), 2]
            known = len(left) and len(right)
            errors.append(1000 * (left.mean() - right.mean()) - true if known else WORST["step_mm"])
    return float(np.sqrt(np.mean(np.square(errors))))


def corner(points, wall):
    """Return how much of a corner of walls 2 m high is not found, and how far off it lies, mm.

    The walls are 1.5 m wide and meet the road at 45 degrees. The corner is not visible, NaN, if a
    wall is struck at so flat an angle that it has less than a tenth of the points of the other.
    """
    counts = np.unique(wall, return_counts=True)[1]
    if len(counts) < 2 or counts.min() < counts.max() / 10:
        return {"edge_missed_percent": np.nan, "edge_mm": np.nan}
    ends = extract_edges(points).segments
    off = np.linalg.norm(ends[..., [0, 2]], axis=-1)
    found = off.max(axis=1, initial=0) < 0.1
    heights = np.linspace(-0.975, 0.975, 40)
    low, high = np.sort(ends[found, :, 1], axis=1).T[..., None]
    covered = ((heights >= low) & (heights <= high)).any(axis=0)
    offset = 1000 * np.sqrt(np.mean(off[found] ** 2)) if found.any() else WORST["edge_mm"]
    return {"edge_missed_percent": 100 * (1 - covered.mean()), "edge_mm": offset}


def posts(points):
    """Return the share of three posts that are missed, percent, and the error of their diameters.

    They are 3 m high; 0.06, 0.12 and 0.3 m wide. A missed one counts with its whole diameter, mm.
    """
    found = poles.detect(points[:, [0, 2, 1]] * [1, -1, 1], method="itc")
    errors = []
    for along, diameter in POSTS_M.items():
        off = np.hypot(found["x_m"] - along, found["y_m"])
        near = off < 0.3
        size = found["diameter_m"][off.idxmin()] if near.any() else 0
        errors.append((np.nan_to_num(size) - diameter, not near.any()))
    errors = np.array(errors)
    diameter = 1000 * np.sqrt(np.mean(errors[:, 0] ** 2))
    return {"pole_missed_percent": 100 * errors[:, 1].mean(), "diameter_mm": diameter}


def make(draw, number, *, seed, **case):
    """Return the chart of an acquisition, a CloudQuality, and the errors of its tasks."""
    rng = np.random.default_rng([seed, draw, number])
    row = Row(case)
    for name in ("chart", "board"):
        row.wall(name, (-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0))
    row.wall("stepped", (-0.5, -0.5, 0), (0.5, 0, 0), (0, 1, 0))
    row.wall("stepped", (0, -0.5, -STEP_M), (0.5, 0, 0), (0, 1, 0))
    for sign in (-1, 1):
        row.wall("corner", (0, -1, 0), (sign * WALL_M, 0, -WALL_M), (0, 2, 0))
    row.wall("posts", (-2, -1.5, -0.6), (4, 0, 0), (0, 0, 1.2))
    for along, diameter in POSTS_M.items():
        foot = row.middles["posts"] + np.array([along, -1.5, 0]) @ row.axes
        top = foot + [0, 0, 3]
        row.add("posts", cylinder(foot, top, diameter / 2), np.array([foot, top]))
    found = row.scan(case, rng)
    board = found["board"][0]
    errors = {
        "detail_missed_percent": detail_missed_percent(board[:, :2]),
        "end_mm": end_mm(board[:, :2]),
        "step_mm": step_mm(board, found["stepped"][0]),
        **signs(board),
        **corner(*found["corner"]),
        **posts(found["posts"][0]),
    }
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    chart, outline = found["chart"][0] @ row.axes, chart_polygon(square @ row.axes)
    return evaluate_cloud(chart, polygon=outline), errors


def e95_mm(chart):
    """Return the distance within which 95 % of the places of a chart have a point, mm."""
    low, high = np.reshape(chart.outline.bounds, (2, 2))
    side = (np.arange(120) + 0.5) / 120
    places = np.stack(np.meshgrid(*(low + (high - low) * side[:, None]).T), -1).reshape(-1, 2)
    places = places[shapely.contains_xy(chart.outline, *places.T)]
    return 1000 * float(np.quantile(cKDTree(chart.xy).query(places)[0], 0.95))


METHODS = {
    "density": lambda chart: 1000 / np.sqrt(chart.density_polygon_per_m2),
    "sigma_MAD": lambda chart: chart.sigma_mad_mm,
    **{f"d{k + 1}": lambda chart, k=k: chart.d_mm[k] for k in range(4)},
    "f": lambda chart: chart.f,
    "g": lambda chart: chart.directional.g,
    "e95": e95_mm,
}
"""Figures of a chart, of which less is better: functions of a
:class:`~mmqa_lab.chart_cloud.CloudQuality`. The density enters as the mean spacing 1 / sqrt(density),
mm."""

RHO0 = 3000.0

WRITTEN = {
    "accept all": lambda figures: figures["f"] < np.inf,
    "density ≥ 3000": lambda figures: figures["density"] <= 1000 / np.sqrt(RHO0),
    "f < 2": lambda figures: figures["f"] < 2,
    "f < 2 or exempt": lambda figures: (figures["f"] < 2) | _exempt(figures),
    "g < 2": lambda figures: figures["g"] < 2,
    "g < 2 or exempt": lambda figures: (figures["g"] < 2) | _exempt(figures),
}
"""Rules without a free threshold, as tenders write them; the exemption is that of ``RHO0``."""


def _exempt(figures):
    return exempt(figures["d1"] / 1000, figures["d4"] / 1000, RHO0)


def bench(*, methods=None, count=30, draws=(1, 2), seed=1000):
    """Define the study's bench: figures of charts, and the tasks of the same acquisitions.

    Parameters
    ----------
    methods : dict, optional
        Functions of a :class:`~mmqa_lab.chart_cloud.CloudQuality`; by default ``METHODS``.
    count : int
        Acquisitions of each kind in each draw.
    draws : tuple of int
        Seeds of the acquisitions: thresholds are chosen on the first and scored on the others.
    seed : int
        Seed of the drives.

    Returns
    -------
    Comparison
    """
    cases = pd.concat([acquisitions(count, seed=draw) for draw in draws], ignore_index=True)

    def tables(results):
        found = correlations(*measured(results))
        return {"tasks": matrix(found), "correlations": found}

    choices = {"seeds": [seed], "tables": tables}
    return benches.Comparison(cases, dict(methods or METHODS), make, **choices)


def measured(results):
    """Return the figures and the errors of each acquisition, two DataFrames.

    ``results`` is the Dataset of :func:`bench`. A figure that is not measurable counts as the worst.
    """
    cells = benches.cell_table(results)
    figures = cells.pivot(index="case", columns="method", values="value")
    figures = figures[results["method"].to_numpy()].fillna(np.inf)
    truths = cells.groupby("case").first().filter(like="truth_")
    return figures, truths.rename(columns=lambda name: name.removeprefix("truth_"))


def correlations(figures, errors, *, bands=1, resamples=300):
    """Return the rank correlation of each figure with the error of each task.

    Parameters
    ----------
    figures, errors : DataFrame
        From :func:`measured`, a row for each acquisition.
    bands : int
        Correlations are within so many bands of equal numbers of acquisitions by density, averaged.
    resamples : int
        Bootstrap samples of the acquisitions.

    Returns
    -------
    DataFrame
        ``method``, ``spearman``, ``low``, ``high`` (95 %), ``task``, ``n``.
    """
    rows = []
    for task in errors:
        known = errors[task].notna()
        values = np.vstack([figures[known].to_numpy().T, errors.loc[known, task]])
        n = values.shape[1]
        band = np.zeros(n, dtype=int)
        if bands > 1:
            band[np.argsort(figures.loc[known, "density"], kind="stable")] = (
                np.arange(n) * bands // n
            )
        draws = np.random.default_rng(0).integers(n, size=(resamples, n))
        drawn = [_spearman(values[:, draw], band[draw]) for draw in draws]
        ends = np.percentile(drawn, (2.5, 97.5), axis=0)
        found = zip(figures, _spearman(values, band), *ends, strict=True)
        rows += [(*row, task, n) for row in found]
    return pd.DataFrame(rows, columns=["method", "spearman", "low", "high", "task", "n"])


def _spearman(values, band):
    """Rank correlation of the last row with the others, averaged over bands; 0 without spread."""
    total = 0.0
    for name, size in zip(*np.unique(band, return_counts=True), strict=True):
        ranks = rankdata(values[:, band == name], axis=1)
        ranks -= ranks.mean(axis=1, keepdims=True)
        length = np.sqrt((ranks**2).sum(axis=1))
        spread = np.maximum(length[:-1] * length[-1], 1e-9)
        total = total + ranks[:-1] @ ranks[-1] / spread * size / len(band)
    return total


def matrix(found):
    """Return the correlations of :func:`correlations` with a row a figure and a column a task."""
    wide = found.pivot(index="method", columns="task", values="spearman")
    return wide.loc[found["method"].unique(), found["task"].unique()].reset_index()


def rules(figures, errors, first, *, good=GOOD, resamples=1000):
    """Judge rules for each task: thresholds chosen on some acquisitions, scored on the others.

    Parameters
    ----------
    figures, errors : DataFrame
        From :func:`measured`.
    first : array of bool, shape (n,)
        The acquisitions on which thresholds are chosen, by the largest balanced accuracy.
    good : dict
        Largest error of each task with which a cloud is fit.
    resamples : int
        Bootstrap samples of the others, the same for all rules.

    Returns
    -------
    DataFrame
        ``task``, ``rule``, ``limits`` (of its figures), ``chosen`` (balanced accuracy where
        thresholds were chosen), ``balanced`` and its 95 % interval ``low``, ``high``; the same of
        its gain over the density alone: ``gain``, ``gain_low``, ``gain_high``; ``right`` (share),
        ``n`` and ``fit`` (number of fit clouds) where it was scored.
    """
    singles = [(name,) for name in figures]
    pairs = [("density", name) for name in figures if name != "density"]
    rows = []
    for task, limit in good.items():
        known = errors[task].notna().to_numpy()
        fit = (errors[task] <= limit).to_numpy()
        chooses, scores = first & known, ~first & known
        found = {name: (rule(figures).to_numpy(), ()) for name, rule in WRITTEN.items()}
        for names in (*singles, *pairs):
            values = figures[list(names)].to_numpy()
            limits = _thresholds(values[chooses], fit[chooses])
            found[" and ".join(names)] = (values <= limits).all(axis=1), limits
        draws = np.random.default_rng(0).integers(scores.sum(), size=(resamples, scores.sum()))
        drawn = {}
        for name, (accepted, _) in found.items():
            right = accepted == fit
            drawn[name] = _balanced(right[scores][draws], fit[scores][draws])
        for name, (accepted, limits) in found.items():
            right = accepted == fit
            balanced = [_balanced(right[part], fit[part]) for part in (chooses, scores)]
            base = _balanced((found["density"][0] == fit)[scores], fit[scores])
            ends = np.nanpercentile(drawn[name], (2.5, 97.5))
            gains = np.nanpercentile(drawn[name] - drawn["density"], (2.5, 97.5))
            row = (task, name, limits, *balanced, *ends, balanced[1] - base, *gains)
            rows.append((*row, right[scores].mean(), scores.sum(), fit[scores].sum()))
    names = ["task", "rule", "limits", "chosen", "balanced", "low", "high"]
    names += ["gain", "gain_low", "gain_high", "right", "n", "fit"]
    return pd.DataFrame(rows, columns=names)


def _balanced(right, fit):
    """Mean of the shares of fit and of unfit clouds judged rightly, over the last axis."""
    with np.errstate(invalid="ignore"):
        shares = [(right & part).sum(axis=-1) / part.sum(axis=-1) for part in (fit, ~fit)]
    return np.mean(shares, axis=0)


def _thresholds(values, fit):
    """The upper limits of figures, (n, k), that judge best which clouds are fit."""
    steps = 120 if values.shape[1] == 1 else 40
    finite = np.where(np.isfinite(values), values, np.nan)
    levels = np.nanquantile(finite, np.linspace(0, 1, steps), axis=0).T
    grids = np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1).reshape(-1, values.shape[1])
    accepted = (values <= grids[:, None]).all(axis=2)
    return grids[np.argmax(_balanced(accepted == fit, np.broadcast_to(fit, accepted.shape)))]
