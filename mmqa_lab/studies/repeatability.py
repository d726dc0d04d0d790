"""How far density, sigma_MAD and f vary when the same chart is selected again."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import norm

from mmqa_lab import bench as benches
from mmqa_lab import io, published, samples
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.planes import CONSISTENT_SCALE, fit_plane
from mmqa_lab.published import ledger
from mmqa_lab.repeatability import operator_polygons, repeatability
from mmqa_lab.simulate import chart_corners, systems
from mmqa_lab.studies.anisotropy import boards

UPRIGHT = replace(systems.SYSTEM_B, range_noise_m=0.01)
"""B's range noise is fitted: it gives about the published sigma_MAD of 9.2 mm."""

SENSORS = {
    "A": systems.SYSTEM_A,
    "B": UPRIGHT,
    "B tilted": replace(UPRIGHT, tilt_deg=45.0),
    "C": systems.SYSTEM_C,
}
"""A and B with the specifications of the paper and of data sheets, except B's noise. A's tilt of 45
degrees and noise are assumed. B's mounting is not stated: once upright, once tilted by 45 degrees,
which comes close to the published spacings. C is fitted to Table 2."""

FIGURES = {"density_polygon_per_m2": "density", "std_mm": "std", "sigma_mad_mm": "sigma_MAD"}
FIGURES |= {name: name.removesuffix("_mm") for name in ("d1_mm", "d2_mm", "d3_mm", "d4_mm", "f")}
"""What is evaluated, and its name in tables."""

INFLUENCE = {"density_polygon_per_m2": 1.0, "std_mm": np.sqrt(0.5), "sigma_mad_mm": 1.1664}
"""Standard deviation of one point's influence over the value, normal residuals (asymptotic)."""

GROUP = 5
"""Selections of one group; section 4.4 has five, of B at 10 m."""

REMARKS = {
    "selection_density": "density_percent",
    "selection_precision": "precision_mm",
    "selection_distances": "medians_mm",
}
"""Numbers of section 4.4 about five selections, and the column of ranges that each is about."""

HALF_DIGIT_MM = 0.5
"""Half of the last digit that Table 2 prints of a spacing."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A scan of a surface, ``points`` (n, 3), and ``corners`` (4, 3) of the outline meant, m."""

    points: np.ndarray
    corners: np.ndarray


@lru_cache(maxsize=64)
def chart_scan(system, distance_m, scan, *, seed=5000):
    """Drive a system of ``SENSORS`` past a chart: a Surface.

    Drives are counted by ``scan`` from that of ``seed``; each has its own errors and place of the
    scan pattern.
    """
    corners = chart_corners((distance_m, 0, 0), heading=systems.FACING_THE_ROAD)
    cloud = systems.pass_chart(SENSORS[system], distance_m, seed=seed + scan)
    return Surface(cloud.points, chart_polygon(corners))


@lru_cache(maxsize=1)
def real_surfaces():
    """Return the road patch, and boards where MMQA_DATA has them: a dict of Surface by name."""
    road = io.read_cloud(samples.path("road_patch"), columns=()).points
    found = {"road, two heads": _outlined(np.unique(road, axis=0), 0.81, 0.62)}
    return found | {name: _outlined(points, 0.65, 0.45) for name, points in boards().items()}


def _outlined(points, width, height):
    """A real surface with a rectangle about its middle, along its principal axes."""
    plane = fit_plane(points, robust=True)
    middle = np.median(points, axis=0)
    middle = middle - plane.distances(middle) * plane.normal
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return Surface(points, middle + (signs * [width, height]) @ plane.axes)


def selected(surface, seed, *, click_m=0.015, vertices=4, axes="principal"):
    """Figures of one selection of a surface by an operator, a dict with the names of ``FIGURES``.

    The clicks have the standard deviation ``click_m`` in each direction; ``vertices`` is 4 for a
    quadrilateral and more for a free polygon; ``axes`` as for ``evaluate_cloud``.
    """
    choices = {"repeats": 1, "click": click_m, "seed": seed, "vertices": vertices}
    polygon = operator_polygons(surface.corners, **choices)[0]
    quality = evaluate_cloud(surface.points, polygon=polygon, axes=axes)
    return quality.to_frame()[list(FIGURES)].iloc[0].to_dict()


METHODS = {
    "4 clicks, principal axes": lambda data: selected(*data),
    "4 clicks, level axes": lambda data: selected(*data, axes="horizontal"),
    "12 clicks, level axes": lambda data: selected(*data, vertices=12, axes="horizontal"),
}
"""Operators: ways to select; each gets a surface and a seed, and returns figures."""


def make(system, distance_m, scan, *, seed):
    """A scan of a chart, or a real surface, and the seed of a selection of it."""
    real = real_surfaces()
    surface = real[system] if system in real else chart_scan(system, distance_m, scan)
    return (surface, [seed, scan, int(distance_m)]), None


def bench(*, methods=None, systems=tuple(SENSORS), distances=(5.0, 10.0), scans=4, seeds=range(50)):
    """Define the study's bench: operators who select the same scans again and again.

    Parameters
    ----------
    methods : dict, optional
        Functions of a tuple (Surface, seed), which return a dict of figures; by default
        ``METHODS``.
    systems : tuple of str
        Of ``SENSORS`` or of :func:`real_surfaces`.
    distances : tuple of float
        From the path to the chart, m.
    scans : int
        Drives past each chart.
    seeds : iterable of int
        Of the selections.

    Returns
    -------
    Comparison
    """
    cases = benches.grid(system=systems, distance_m=distances, scan=range(scans))
    return benches.Comparison(
        cases,
        dict(methods or METHODS),
        make,
        seeds=seeds,
        tables=lambda results: {"repeatability": limits(results)},
    )


def limits(results):
    """Return the repeatability of every figure of every surface and operator.

    Parameters
    ----------
    results : Dataset
        Of :func:`bench`.

    Returns
    -------
    DataFrame
        ``method``, ``system``, ``distance_m``, ``figure``, and the fields of
        :class:`mmqa_lab.repeatability.Repeatability` with ``relative_s_r_percent``.
    """
    cells, tables = benches.cell_table(results), {}
    keys = ["method", "system", "distance_m"]
    for surface, part in cells.groupby(keys, sort=False):
        for figure in part.columns.intersection(list(FIGURES)):
            known = part[np.isfinite(part[figure])]
            known = known.groupby("scan").filter(lambda rows: len(rows) > 1)
            if len(known):
                tables[*surface, figure] = repeatability(known, figure).to_frame()
    return pd.concat(tables, names=[*keys, "figure"]).droplevel(-1).reset_index()


def ranges_of_five(results):
    """Ranges of the figures over groups of five selections of a scan, as in section 4.4.

    Returns
    -------
    DataFrame
        A row for each group: ``density_percent`` (of the group's mean), ``precision_mm`` (of
        sigma_MAD) and ``medians_mm`` (the widest of d1..d4).
    """
    spacings = ["d1_mm", "d2_mm", "d3_mm", "d4_mm"]
    keys = ["method", "system", "distance_m", "scan", "group"]
    table = benches.cell_table(results)
    groups = table.assign(group=table["seed"] // GROUP).groupby(keys, sort=False)
    widths = groups[["density_polygon_per_m2", "sigma_mad_mm", *spacings]].agg(np.ptp)
    mean = groups["density_polygon_per_m2"].mean()
    found = pd.DataFrame(
        {
            "density_percent": 100 * widths["density_polygon_per_m2"] / mean,
            "precision_mm": widths["sigma_mad_mm"],
            "medians_mm": widths[spacings].max(axis=1),
        }
    )
    return found[groups.size() == GROUP].reset_index()


def remarks(ranges):
    """Compare groups of five with what section 4.4 says of them.

    Returns
    -------
    DataFrame
        ``method``, ``system``, ``distance_m``, and of each remark the share of groups for which it
        is true: density below 1 %, precision below 1 mm, medians within half of a printed digit.
    """
    keys = ["method", "system", "distance_m"]
    printed = [published.number("pfeifer2021", name)["value"] for name in REMARKS]
    allowed = pd.Series(np.maximum(printed, HALF_DIGIT_MM), REMARKS.values())
    below = ranges[allowed.index] < allowed
    table = pd.concat([ranges[keys], below], axis=1).groupby(keys, sort=False).mean()
    return table.rename(columns=lambda name: f"{name}_true_share").reset_index()


def ledger_table(ranges):
    """Return the ledger's entries on the numbers of section 4.4: medians of the groups and 95 %.

    Parameters
    ----------
    ranges : DataFrame
        Of :func:`ranges_of_five`; B tilted at 10 m counts, by the first operator.
    """
    rows = ranges.query("system == 'B tilted' and distance_m == 10")
    rows = rows[rows["method"].isin(rows["method"].head(1))]
    note = (
        f"Median and 95 % of {len(rows)} groups of five simulated selections of B, tilted by 45 "
        "degrees, with assumed clicks. Medians of irregular spacings move with the selection."
    )
    found = rows[list(REMARKS.values())].quantile([0.025, 0.5, 0.975]).T
    found = found.set_axis(["low", "value", "high"], axis=1).assign(cell=list(REMARKS)).dropna()
    same = {"source": "pfeifer2021", "table": "numbers", "kind": "measured", "note": note}
    return ledger.entries(found, **same)


def with_strays(points, *, share, depths, seed):
    """Points of a surface and copies of some, moved between two distances (m) behind it.

    ``share`` is that of the copies among all points afterwards.
    """
    rng = np.random.default_rng(seed)
    count = round(len(points) * share / (1 - share))
    depth = rng.uniform(*depths, count)[:, None]
    strays = points[rng.integers(len(points), size=count)] + depth * fit_plane(points).normal
    return np.concatenate([points, strays])


def contaminated_sigma_mad(share):
    """sigma_MAD of normal residuals over their standard deviation, with strays far to one side.

    The median moves to m, Phi(m) (1 - share) = 1/2, and d, half of the points about it, solves
    (1 - share) (Phi(m + d) - Phi(m - d)) = 1/2; for shares below 0.5.

    >>> [round(contaminated_sigma_mad(share), 3) for share in (0, 0.05, 0.1)]
    [1.0, 1.065, 1.145]
    """
    half = 0.5 / (1 - share)
    median = norm.ppf(half)
    d = brentq(lambda d: norm.cdf(median + d) - norm.cdf(median - d) - half, 0, 20)
    return float(CONSISTENT_SCALE * d)
