"""How far density, sigma_MAD and f vary when the same chart is selected again."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import norm

from mmqa_lab import bench, io, plots, published, samples
from mmqa_lab.chart_cloud import CHART_MARGINS_M, chart_polygon, evaluate_cloud
from mmqa_lab.planes import CONSISTENT_SCALE, fit_plane
from mmqa_lab.published import ledger
from mmqa_lab.repeatability import operator_polygons, repeatability
from mmqa_lab.simulate import chart_corners, systems
from mmqa_lab.studies import NOTES, SMALL, stated

QUICK = SMALL["repeatability"]

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

FIGURES = NOTES["repeatability"]["figures"]
"""What is evaluated, and its name in tables."""

INFLUENCE = {"density_polygon_per_m2": 1.0, "std_mm": np.sqrt(0.5), "sigma_mad_mm": 1.1664}
"""Standard deviation of one point's influence over the value, normal residuals (asymptotic)."""

GROUP = 5
"""Selections of one group; section 4.4 has five, of B at 10 m."""

HALF_DIGIT_MM = 0.5
"""Half of the last digit that Table 2 prints of a spacing."""

REMARKS = NOTES["repeatability"]["remarks"]
"""Numbers of section 4.4 about five selections, and the column of ranges that each is about."""

BOARDS = {"board, VLP-16": "boards/vlp16_pose02.laz", "board, 64 rings": "boards/os64_pose02.laz"}

WALL = "hdl32e_pair/sweep_a.laz"

WALL_CENTRE = (-0.5, 2.54, -0.65)
"""A flat place of the hall's wall, 2.6 m from the scanner, m."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A scan of a surface, ``points`` (n, 3), and ``corners`` (4, 3) of the outline meant, m."""

    points: np.ndarray
    corners: np.ndarray


@lru_cache(maxsize=64)
def chart_scan(system, distance_m, scan, *, seed=5000, margins=CHART_MARGINS_M):
    """Drive a system past a chart.

    Parameters
    ----------
    system : str
        Of ``SENSORS``.
    distance_m : float
        From the path to the chart.
    scan : int
        Drives are counted; each has its own errors and place of the scan pattern.
    seed : int
        Of the first drive.
    margins : tuple
        Left out along the edges, see :func:`mmqa_lab.chart_cloud.chart_polygon`; 0 takes the
        border in.

    Returns
    -------
    Surface
    """
    corners = chart_corners((distance_m, 0, 0), heading=systems.FACING_THE_ROAD)
    cloud = systems.pass_chart(SENSORS[system], distance_m, seed=seed + scan)
    return Surface(cloud.points, chart_polygon(corners, margins=margins))


@lru_cache(maxsize=1)
def real_surfaces():
    """Return the road patch, and boards and a hall's wall where MMQA_DATA has them.

    Returns
    -------
    dict of str to Surface
    """
    road = io.read_cloud(samples.path("road_patch"), columns=()).points
    found = {"road, two heads": _outlined(np.unique(road, axis=0), 0.81, 0.62)}
    for name, relative in BOARDS.items():
        if samples.has_real(relative):
            board = io.read_cloud(samples.real_path(relative), columns=()).points
            found[name] = _outlined(board, 0.65, 0.45)
    if samples.has_real(WALL):
        hall = io.read_cloud(samples.real_path(WALL), columns=()).points
        near = hall[np.linalg.norm(hall - WALL_CENTRE, axis=1) < 1]
        found["hall wall"] = _outlined(near, 0.81, 0.62, centre=WALL_CENTRE)
    return found


def _outlined(points, width, height, centre=None):
    """A real surface with a rectangle about its middle, along its principal axes."""
    plane = fit_plane(points, robust=True)
    middle = np.median(points, axis=0) if centre is None else np.asarray(centre)
    middle = middle - plane.distances(middle) * plane.normal
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return Surface(points, middle + (signs * [width, height]) @ plane.axes)


def selected(surface, seed, *, click_m=0.015, vertices=4, axes="principal"):
    """Figures of one selection of a surface by an operator, a dict of numbers.

    Parameters
    ----------
    surface : Surface
    seed : int or list of int
        Of the clicks.
    click_m : float
        Standard deviation of a vertex in each direction.
    vertices : int
        4 for a quadrilateral, more for a free polygon.
    axes : {"principal", "horizontal"}

    Returns
    -------
    dict
        With the names of ``FIGURES``.
    """
    choices = {"repeats": 1, "click": click_m, "seed": seed, "vertices": vertices}
    polygon = operator_polygons(surface.corners, **choices)[0]
    quality = evaluate_cloud(surface.points, polygon=polygon, axes=axes)
    return {name: float(getattr(quality, name)) for name in FIGURES}


OPERATORS = {
    "4 clicks, principal axes": lambda data: selected(*data),
    "4 clicks, level axes": lambda data: selected(*data, axes="horizontal"),
    "12 clicks, level axes": lambda data: selected(*data, vertices=12, axes="horizontal"),
}
"""Ways to select; each gets a surface and a seed."""


def surface_to_select(system, distance_m, scan, seed):
    """A scan of a chart and the seed of a selection of it, as data without a truth."""
    return (chart_scan(system, distance_m, scan), [seed, scan, int(distance_m)]), None


def comparison(quick=False):
    """Compare operators by how far the figures of their selections vary.

    Returns
    -------
    Comparison
        A method gets a tuple (Surface, seed) and returns a dict of figures.
    """
    scans, repeats = (2, 8) if quick else (4, 50)
    return bench.Comparison(
        bench.grid(system=tuple(SENSORS), distance_m=(5.0, 10.0), scan=range(scans)),
        dict(OPERATORS),
        surface_to_select,
        seeds=range(repeats),
        tables=lambda results: {"repeatability": limits(results)},
        figures=lambda results: {"repeatability": draw_limits(limits(results))},
    )


def limits(results):
    """Repeatability of every figure of every surface and operator.

    Parameters
    ----------
    results : Dataset
        Of :func:`mmqa_lab.bench.run`, with the dimensions ``scan`` and ``seed``.

    Returns
    -------
    DataFrame
        ``method``, ``system``, ``distance_m``, ``figure``, and the fields of
        :class:`mmqa_lab.repeatability.Repeatability` with ``relative_s_r_percent``.
    """
    cells, tables = bench.cell_table(results), []
    keys = [name for name in ("method", "system", "distance_m") if name in cells]
    for surface, part in cells.groupby(keys, sort=False):
        for figure in part.columns.intersection(list(FIGURES)):
            known = part[np.isfinite(part[figure])]
            known = known.groupby("scan").filter(lambda rows: len(rows) > 1)
            if known.empty:
                continue
            found = repeatability(known, figure).to_frame()
            about = dict(zip(keys, surface, strict=True)) | {"figure": figure}
            tables.append(found.assign(**about))
    table = pd.concat(tables, ignore_index=True)
    return table[[*keys, "figure", *table.columns.drop([*keys, "figure"])]]


def draw_limits(table):
    """Draw s_r in percent of the mean: a panel for each operator, a line for each surface."""
    methods, shown = table["method"].unique(), list(FIGURES)
    size = {"width": "double", "height_mm": 70, "sharey": True, "squeeze": False}
    figure, axes = plots.subplots(1, len(methods), **size)
    colours = dict(zip(table["system"].unique(), plots.COLOURS.values(), strict=False))
    dashes = dict(
        zip(sorted(table["distance_m"].unique()), ("o-", "s--", "^:", "v-."), strict=False)
    )
    for ax, method in zip(axes[0], methods, strict=True):
        rows = table[table["method"] == method]
        for (system, distance), part in rows.groupby(["system", "distance_m"], sort=False):
            spread = (
                part.set_index("figure")["relative_s_r_percent"].reindex(shown).clip(lower=0.01)
            )
            label = f"{system}, {distance:g} m"
            look = {"ms": 3, "lw": 0.7, "color": colours[system], "label": label}
            ax.semilogy(range(len(shown)), spread, dashes[distance], **look)
        ax.set_xticks(range(len(shown)), FIGURES.values(), rotation=60)
        ax.set_title(method)
    axes[0, 0].set_ylabel("s_r (% of the mean)")
    axes[0, -1].legend(loc="upper left", bbox_to_anchor=(1, 1))
    return figure


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
    table = bench.cell_table(results)
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
    limits_of = {}
    for name, column in REMARKS.items():
        printed = published.number("pfeifer2021", name)
        limits_of[column] = max(float(printed["value"]), HALF_DIGIT_MM)
    below = ranges[list(limits_of)] < pd.Series(limits_of)
    table = pd.concat([ranges[keys], below], axis=1).groupby(keys, sort=False).mean()
    return table.rename(columns=lambda name: f"{name}_true_share").reset_index()


def entries(ranges):
    """What the run says of the numbers of section 4.4: medians of the groups and their 95 %.

    Returns
    -------
    list of dict
        For :meth:`mmqa_lab.run.Run.save_ledger`; B tilted at 10 m, none where it was not run.
    """
    rows = ranges.query("system == 'B tilted' and distance_m == 10")
    rows = rows[rows["method"] == rows["method"].iloc[0]] if len(rows) else rows
    told = NOTES["repeatability"]["notes"]
    note = told["groups"].format(n=len(rows))
    found = []
    for cell, column in REMARKS.items():
        if len(rows):
            low, middle, high = rows[column].quantile([0.025, 0.5, 0.975])
            text = f"{note} {told.get(column, '')}".strip()
            given = {"kind": "measured", "low": low, "high": high, "note": text}
            found.append(ledger.entry("pfeifer2021", "numbers", cell, middle, **given))
    return found


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
        ``share``, ``seed``, ``std_mm``, ``sigma_mad_mm``; ``std_predicted_mm`` of the mixture,
        ``sigma_mad_predicted_mm`` by
        :func:`contaminated_sigma_mad`.
    """
    clean = evaluate_cloud(surface.points, polygon=surface.corners)
    mean, variance = np.mean(depths), (depths[1] - depths[0]) ** 2 / 12
    rows = []
    for share in shares:
        mixed = (clean.std_mm / 1000) ** 2 + share * (variance + (1 - share) * mean**2)
        expected = 1000 * np.sqrt(mixed), clean.sigma_mad_mm * contaminated_sigma_mad(share)
        for seed in seeds:
            points = with_strays(surface.points, share=share, depths=depths, seed=seed)
            found = evaluate_cloud(points, polygon=surface.corners, thickness=1.0)
            rows.append((share, seed, found.std_mm, found.sigma_mad_mm, *expected))
    names = ["std_mm", "sigma_mad_mm", "std_predicted_mm", "sigma_mad_predicted_mm"]
    return pd.DataFrame(rows, columns=["share", "seed", *names])


check = stated("repeatability")


def checks(*, shares, cover, scans, laws, strays, components):
    """Compare what the notebook says with this run.

    Parameters
    ----------
    shares, cover, laws, strays, components : DataFrame
        Of :func:`remarks`, the notebook's coverage and laws, :func:`stray_sweep`, and
        :func:`mmqa_lab.repeatability.variance_components`.
    scans : int
        Behind the coverage.

    Yields
    ------
    mmqa_lab.run.Check
    """
    of_b = shares.query("system in ('B', 'B tilted') and distance_m == 10")
    precise = 100 * of_b["precision_mm_true_share"].min()
    yield check("precision", precise > 90, f"in {precise:.0f} % of the groups or more")
    dense = 100 * of_b["density_percent_true_share"]
    yield check(
        "density", dense.max() < 90, f"in {dense.min():.0f} to {dense.max():.0f} % of the groups"
    )
    worst = cover.drop(columns="density").min().min()
    least = 0.95 - 4 * np.sqrt(0.95 * 0.05 / scans)
    yield check(
        "intervals",
        worst > least,
        f"{100 * worst:.0f} % or more; of the density {100 * cover['density'].min():.0f} % or more",
        scans=scans,
    )
    known = laws[laws["figure"] == "density_polygon_per_m2"]
    ratio = np.exp(np.log(known["relative_s_r"] / known["predicted"]).mean())
    yield check(
        "strip_law",
        0.85 < ratio < 1.15,
        f"measured over predicted, mean of {len(known)}: {ratio:.2f}",
    )
    means = strays.groupby("share").mean()
    off = (means["sigma_mad_mm"] / means["sigma_mad_predicted_mm"] - 1).abs().max()
    grown = means["std_mm"].iloc[-1] / means["std_mm"].iloc[0]
    yield check(
        "strays",
        grown > 3 and off < 0.15,
        f"std x {grown:.1f}, sigma_MAD within {100 * off:.0f} % of the closed form",
    )
    parts = components[components["factor"] == "selection"].set_index("figure")["share"]
    yield check(
        "selections",
        (parts < 0.1).all(),
        f"selections have {100 * parts.max():.1f} % of the variance at most ({parts.idxmax()})",
    )


def answer(rows, *, click_m, name, distance):
    """The study's answer in one sentence, from rows of :func:`limits` by figure."""
    r = rows["r"]
    return (
        f"With vertices off by {100 * click_m:.1f} cm, {name} at {distance:g} m repeats to r = "
        f"{r['density_polygon_per_m2']:.0f} points/m² in density, "
        f"{r['sigma_mad_mm']:.1f} mm in sigma_MAD and {r['f']:.2f} in f (simulated)."
    )
