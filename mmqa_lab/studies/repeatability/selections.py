"""Selections of surfaces, their spread, and how it answers the paper and the law."""

import numpy as np
import pandas as pd
from tqdm.auto import tqdm

from mmqa_lab.chart_cloud import evaluate_cloud, inside_polygon
from mmqa_lab.planes import fit_plane
from mmqa_lab.repeatability import (
    contaminated_sigma_mad,
    evaluate_selections,
    operator_polygons,
    power_law,
    repeatability,
    strip_law,
    variance_components,
    with_strays,
)
from mmqa_lab.simulate.point_patterns import point_pattern
from mmqa_lab.spacing import quadrant_distances
from mmqa_lab.views import is_headless

FIGURES = {
    "density_polygon_per_m2": "density, polygon",
    "density_hull_per_m2": "density, hull",
    "std_mm": "std",
    "sigma_mad_mm": "sigma_MAD",
    "d1_mm": "d1",
    "d2_mm": "d2",
    "d3_mm": "d3",
    "d4_mm": "d4",
    "f": "f",
}
"""What is evaluated, as a reader writes it."""

INFLUENCE = {"density_polygon_per_m2": 1.0, "std_mm": np.sqrt(0.5), "sigma_mad_mm": 1.1664}
"""Standard deviation of one point's influence over the value, normal residuals (asymptotic)."""

LEVEL = ", level axes"
"""Behind a system's name: evaluated with horizontal axes."""

GROUP = 5
"""Selections of one group, as in the paper."""

HALF_DIGIT_MM = 0.5
"""Half of the last digit that the paper prints of a spacing."""

THROUGH_M = 1.0
"""Thickness of a selection that reaches through the surface, as a 3-D editor's does."""


def compute(surfaces, *, repeats, click, seed, vertices=4, axes="principal"):
    """Select every surface again and again, and evaluate each selection.

    Parameters
    ----------
    surfaces : list of Surface
    repeats : int
        Selections of each scan.
    click : float
        Standard deviation of a vertex in each direction, m.
    seed : int
    vertices : int
        4 for quadrilaterals, 8 or more for free polygons.
    axes : {"principal", "horizontal"}
        Horizontal ones stay where they are when the selection changes; ``LEVEL`` then stands
        behind the system's name.

    Returns
    -------
    DataFrame
        A row per selection: ``system``, ``distance_m``, ``scan``, ``kind``, ``selection`` and the
        figures of ``CloudQuality``.
    """
    suffix = LEVEL if axes == "horizontal" else ""
    tables = []
    for number, surface in enumerate(tqdm(surfaces, desc="selections", disable=is_headless())):
        choices = {"click": click, "seed": [seed, number], "vertices": vertices}
        polygons = operator_polygons(surface.corners, repeats=repeats, **choices)
        found = evaluate_selections(_near(surface, polygons), polygons, axes=axes)
        named = {"system": surface.name + suffix, "distance_m": surface.distance_m}
        tables.append(found.assign(**named, scan=surface.scan, kind=surface.kind))
    return pd.concat(tables, ignore_index=True)


def _near(surface, polygons):
    """The points that any of the polygons can reach."""
    centre = surface.corners.mean(axis=0)
    reach = np.linalg.norm(polygons - centre, axis=2).max() + THROUGH_M
    return surface.points[np.linalg.norm(surface.points - centre, axis=1) < reach]


def limits(table):
    """Repeatability of every figure on every surface.

    Returns
    -------
    DataFrame
        ``system``, ``distance_m``, ``kind``, ``figure``, ``mean``, ``s_r``, ``r`` = 2.8 s_r,
        ``s_l``, ``icc`` with its interval, ``relative_s_r_percent`` with its bootstrap
        interval, ``scans``, ``n``. Figures that a selection has not are left out.
    """
    rows = []
    keys = ["system", "distance_m", "kind"]
    for surface, part in table.groupby(keys, dropna=False, sort=False):
        for figure in FIGURES:
            if not np.isfinite(part[figure]).all():
                continue
            found = repeatability(part, figure)
            percent = 100 / found.mean
            rows.append(
                {
                    **dict(zip(keys, surface, strict=True)),
                    "figure": figure,
                    "mean": found.mean,
                    "s_r": found.s_r,
                    "r": found.r,
                    "s_l": found.s_l,
                    "icc": found.icc,
                    "icc_low": found.icc_low,
                    "icc_high": found.icc_high,
                    "relative_s_r_percent": percent * found.s_r,
                    "low_percent": percent * found.s_r_low,
                    "high_percent": percent * found.s_r_high,
                    "scans": found.groups,
                    "n": found.n,
                }
            )
    return pd.DataFrame(rows)


def components(table, *, systems):
    """Variance of every figure by system, distance, scan and selection (logarithms, nested).

    Returns
    -------
    DataFrame
        As :func:`mmqa_lab.repeatability.variance_components`, with ``figure``.
    """
    part = table[table["system"].isin(systems)]
    factors = ["system", "distance_m", "scan"]
    found = [
        variance_components(part, name, factors=factors).assign(figure=name) for name in FIGURES
    ]
    return pd.concat(found, ignore_index=True)


def groups_of_five(table):
    """Split the selections of each scan into groups of five, as the paper had, and look at ranges.

    Returns
    -------
    DataFrame
        A row per group: ``density_range_percent`` (of the group's mean, polygon area),
        ``precision_range_mm`` (of sigma_MAD) and ``spacing_range_mm`` (the widest of d1..d4).
    """
    spacings = ["d1_mm", "d2_mm", "d3_mm", "d4_mm"]
    keys = ["system", "distance_m", "kind", "scan", "group"]
    table = table.assign(group=table["selection"] // GROUP)
    groups = table.groupby(keys, dropna=False, sort=False)
    ranges = groups[["density_polygon_per_m2", "sigma_mad_mm", *spacings]].agg(np.ptp)
    mean = groups["density_polygon_per_m2"].mean()
    found = pd.DataFrame(
        {
            "density_range_percent": 100 * ranges["density_polygon_per_m2"] / mean,
            "precision_range_mm": ranges["sigma_mad_mm"],
            "spacing_range_mm": ranges[spacings].max(axis=1),
        }
    )
    return found[groups.size() == GROUP].reset_index()


SENTENCES = {
    "density varies below 1 %": lambda group: group["density_range_percent"] < 1,
    "precision ranges below 1 mm": lambda group: group["precision_range_mm"] < 1,
    "medians show no variation": lambda group: group["spacing_range_mm"] < HALF_DIGIT_MM,
}
"""What Pfeifer et al. 2021 report of five selections of B at 10 m (section 4.2), as tests."""


def answers(groups):
    """Hold the paper's remark against groups of five selections of every surface.

    Returns
    -------
    DataFrame
        ``published`` (the remark), ``system``, ``distance_m``, ``kind``, ``holds_share`` of the
        groups, ``groups``.
    """
    rows = []
    keys = ["system", "distance_m", "kind"]
    for surface, part in groups.groupby(keys, dropna=False, sort=False):
        for sentence, test in SENTENCES.items():
            rows.append((sentence, *surface, test(part).mean(), len(part)))
    return pd.DataFrame(rows, columns=["published", *keys, "holds_share", "groups"])


def roundings(surface, *, steps_mm, repeats, click, seed):
    """Round a surface's coordinates to grids, and select it again.

    Returns
    -------
    DataFrame
        ``rounding_mm`` (0 for none), ``figure``, ``mean``, ``s_r``, ``n``.
    """
    polygons = operator_polygons(surface.corners, repeats=repeats, click=click, seed=seed)
    rows = []
    for step in steps_mm:
        points = surface.points
        if step:
            points = step / 1000 * np.round(points * 1000 / step)
        table = evaluate_selections(points, polygons).assign(scan=0)
        for figure in FIGURES:
            found = repeatability(table, figure, draws=2)
            rows.append((step, figure, found.mean, found.s_r, found.n))
    return pd.DataFrame(rows, columns=["rounding_mm", "figure", "mean", "s_r", "n"])


def spread_over(varied, values, *, repeats, clouds, seed, density=3000.0, area=0.5, click=0.015):
    """Vary one of area, density and click error, and look how the spread of selections follows.

    Selections are upright squares of random patterns with normal distances from the plane.

    Parameters
    ----------
    varied : {"area", "density", "click"}
    values : sequence of float
        Square metres, points per square metre, or metres.
    repeats, clouds : int
        Selections of each cloud, and clouds of each value.
    seed : int

    Returns
    -------
    DataFrame
        ``varied``, ``value``, ``axes``, ``figure``, ``relative_s_r``, ``predicted`` by
        :func:`mmqa_lab.repeatability.strip_law` (NaN for spacings and f), ``n``.
    """
    rows = []
    for value in values:
        given = {"density": density, "area": area, "click": click} | {varied: float(value)}
        patterns = [_upright_pattern(given, repeats, [seed, k]) for k in range(clouds)]
        for axes in ("principal", "horizontal"):
            tables = [evaluate_selections(*pattern, axes=axes) for pattern in patterns]
            table = pd.concat(tables, keys=range(clouds), names=["scan"]).reset_index("scan")
            for figure in ("density_polygon_per_m2", "std_mm", "sigma_mad_mm", "d1_mm", "d4_mm"):
                found = repeatability(table, figure, draws=2)
                influence = INFLUENCE.get(figure)
                law = np.nan if influence is None else strip_law(influence=influence, **given)
                spread = found.s_r / found.mean
                rows.append((varied, value, axes, figure, spread, law, found.n))
    names = ["varied", "value", "axes", "figure", "relative_s_r", "predicted", "n"]
    return pd.DataFrame(rows, columns=names)


def _upright_pattern(given, repeats, seed):
    """A random pattern on an upright wall, and an operator's polygons."""
    side = np.sqrt(given["area"])
    size = side + 12 * given["click"]
    xy = point_pattern("poisson", density=given["density"], size=size, seed=seed) - size / 2
    depth = 0.005 * np.random.default_rng([*seed, 1]).standard_normal(len(xy))
    signs = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    choices = {"repeats": repeats, "click": given["click"], "seed": [*seed, 2]}
    polygons = operator_polygons(side / 2 * signs, **choices)
    return np.stack([xy[:, 0], depth, xy[:, 1]], axis=1), polygons


def exponents(laws):
    """Fit the exponent of the spread over each varied quantity.

    Returns
    -------
    DataFrame
        ``varied``, ``axes``, ``figure``, ``exponent``, ``standard_error`` (fitted), ``predicted``
        = -3/4 for the area, -1/2 for the density, 1/2 for the click error; ``n`` values.
    """
    predicted = {"area": -0.75, "density": -0.5, "click": 0.5}
    rows = []
    keys = ["varied", "axes", "figure"]
    for case, part in laws.groupby(keys, sort=False):
        law = power_law(part["value"], part["relative_s_r"])
        rows.append((*case, law.exponent, law.standard_error, predicted[case[0]], law.n))
    return pd.DataFrame(rows, columns=[*keys, "exponent", "standard_error", "predicted", "n"])


def stray_sweep(surface, *, shares, depths, seeds):
    """Catch points behind a surface by mistake, and evaluate with std and sigma_MAD.

    Parameters
    ----------
    surface : Surface
    shares : sequence of float
        Of strays among all points, 0 to 0.1.
    depths : pair of float
        Their distances from the plane, m.
    seeds : sequence of int

    Returns
    -------
    DataFrame
        ``share``, ``seed``, ``std_mm``, ``sigma_mad_mm``, ``f``; ``std_predicted_mm`` of the
        mixture, ``sigma_mad_predicted_mm`` by
        :func:`mmqa_lab.repeatability.contaminated_sigma_mad`.
    """
    clean = evaluate_cloud(surface.points, polygon=surface.corners)
    mean, variance = np.mean(depths), (depths[1] - depths[0]) ** 2 / 12
    rows = []
    for share in shares:
        mixed = (clean.std_mm / 1000) ** 2 + share * (variance + (1 - share) * mean**2)
        factor = contaminated_sigma_mad(share)
        for seed in seeds:
            points = with_strays(surface.points, share=share, depths=depths, seed=seed)
            found = evaluate_cloud(points, polygon=surface.corners, thickness=THROUGH_M)
            rows.append(
                {
                    "share": share,
                    "seed": seed,
                    "std_mm": found.std_mm,
                    "sigma_mad_mm": found.sigma_mad_mm,
                    "f": found.f,
                    "std_predicted_mm": 1000 * np.sqrt(mixed),
                    "sigma_mad_predicted_mm": clean.sigma_mad_mm * factor,
                }
            )
    return pd.DataFrame(rows)


def variants(surface, bordered, *, repeats, click, seed):
    """Compare ways to select: quadrilateral, free polygon, border included, one percent of strays.

    Parameters
    ----------
    surface, bordered : Surface
        The same scan, outlined without and with the chart's border.
    repeats, click, seed
        See :func:`compute`.

    Returns
    -------
    DataFrame
        ``way``, ``figure``, ``mean``, ``relative_s_r_percent``, ``n``.
    """
    strays = with_strays(surface.points, share=0.01, depths=(0.03, 0.09), seed=seed)
    ways = {
        "quadrilateral": (surface.points, surface.corners, 4),
        "free polygon": (surface.points, surface.corners, 12),
        "border included": (bordered.points, bordered.corners, 4),
        "1 % strays": (strays, surface.corners, 4),
    }
    rows = []
    for way, (points, corners, vertices) in ways.items():
        choices = {"click": click, "seed": seed, "vertices": vertices}
        polygons = operator_polygons(corners, repeats=repeats, **choices)
        table = evaluate_selections(points, polygons).assign(scan=0)
        for figure in FIGURES:
            found = repeatability(table, figure, draws=2)
            rows.append((way, figure, found.mean, 100 * found.s_r / found.mean, found.n))
    return pd.DataFrame(rows, columns=["way", "figure", "mean", "relative_s_r_percent", "n"])


def shades(surface):
    """Values to colour a surface by, each point's own.

    Returns
    -------
    points, dict of str to array
        Points inside the outline; their distance from the plane (mm) and local f = d4/d1 (NaN
        where a quadrant is empty).
    """
    points = surface.points[inside_polygon(surface.points, surface.corners)]
    plane = fit_plane(points)
    gaps = quadrant_distances(plane.project(points))
    return points, {
        "distance from plane (mm)": 1000 * plane.residuals,
        "local f": gaps[:, 3] / gaps[:, 0],
    }
