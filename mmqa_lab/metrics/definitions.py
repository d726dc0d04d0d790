"""The metrics: how many points and how noisy, how evenly they lie, how large their gaps are."""

import numpy as np
import shapely

from mmqa_lab.metrics.pattern import Unmeasured
from mmqa_lab.metrics.registry import metric

__all__ = [
    "anps", "clark_evans", "delaunay_q95", "density", "disc_q05", "discrepancy", "dispersion",
    "e50", "e95", "e95_of_3", "e99", "f", "fill_distance", "g", "lacunarity", "mesh_ratio", "mme",
    "mpv", "noise_of_a_mean", "ripley", "roughness", "sigma_mad", "usgs_distribution", "void_5cm",
    "void_10cm", "voronoi_cv", "voronoi_q95",
]  # fmt: skip


PFEIFER = "Pfeifer et al. 2021, section 3.3, doi:10.3390/rs13020237"
USGS = "USGS Lidar Base Specification 2024 rev. A, collection requirements"


@metric("points/m2", "more", PFEIFER, r"\rho = n / A", "Where the points are; copies count.")
def density(chart):
    """Points per area of the outline."""
    return chart.pattern.density


@metric("mm", "less", USGS, r"1 / \sqrt{\rho}", "Where the points are; copies count.")
def anps(chart):
    """Aggregate nominal pulse spacing."""
    return 1000 / np.sqrt(chart.pattern.density)


@metric(
    "mm", "less", PFEIFER, r"1.4826\,\mathrm{median}|r - \mathrm{median}(r)|",
    "An offset of all points; a bent surface counts as noise.",
)  # fmt: skip
def sigma_mad(chart):
    """Dispersion of the distances from the plane."""
    return chart.sigma_mad_mm


@metric(
    "mm m", "less", "Lague et al. 2013, section 3.3, doi:10.1016/j.isprsjprs.2013.04.009",
    r"\sigma_\mathrm{MAD} / \sqrt{\rho}",
    "Errors that neighbours share, copies, noise that hides a thing at any density; times 1/L it "
    "is the error of a mean over L x L.",
)  # fmt: skip
def noise_of_a_mean(chart):
    """Standard error of the mean of a patch of 1 m x 1 m."""
    return chart.sigma_mad_mm / np.sqrt(chart.pattern.density)


@metric(
    "1", "less", PFEIFER, "d_4 / d_1",
    "Holes, density; it is 1 on a grid and 3.26 at random, and depends on the axes of quadrants.",
)  # fmt: skip
def f(chart):
    """Median distance to the farthest of four quadrant neighbours over that to the nearest."""
    return chart.f


@metric(
    "1", "less", "mmqa_lab, notebook 03", r"s_\perp / s_\parallel",
    "Gaps between crossing lines; random points have 1 at any density.",
)  # fmt: skip
def g(chart):
    """Spacing across the lines over that along them."""
    return chart.g


def _ranked(rank):
    """Register the median distance of a rank among the nearest of four quadrants."""

    def distance(chart):
        return chart.d_mm[rank - 1]

    distance.__name__ = f"d{rank}"
    distance.__doc__ = f"Median distance to number {rank} of the nearest points of four quadrants."
    formula = rf"\mathrm{{median}}_i\, d_{{({rank})}}(i)"
    metric("mm", "less", PFEIFER, formula, "Gaps elsewhere; it depends on the axes.")(distance)


for number in range(1, 5):
    _ranked(number)


@metric(
    "1", "more", "Clark and Evans 1954, doi:10.2307/1931034",
    r"2 \sqrt{\rho}\; \mathrm{mean}(d_\mathrm{next})",
    "Density; gaps; points near the border have fewer neighbours.",
)  # fmt: skip
def clark_evans(chart):
    """Mean distance to the next point over that of random points: 1 for them, 2 for a grid."""
    return 2 * np.sqrt(chart.pattern.density) * chart.pattern.nearest.mean()


@metric(
    "mm", "less", "CloudCompare, Compute geometric features: roughness (radius 10 cm)",
    r"\mathrm{mean}\,|\text{point} - \text{plane of its neighbours}|",
    "Errors over more than 10 cm; places with fewer than 5 points.",
)  # fmt: skip
def roughness(chart):
    """Mean distance of a point from the plane of its neighbours."""
    return 1000 * chart.pattern.local[1].mean()


@metric(
    "mm2", "less", "Kornilov et al. 2022, map-metrics, arXiv:2104.14247 (radius 10 cm)",
    r"\mathrm{mean}\,\lambda_\mathrm{min}(\Sigma)",
    "Errors over more than 10 cm; places with fewer than 5 points. Thin clouds look less noisy: a "
    "plane through few points takes noise away.",
)  # fmt: skip
def mpv(chart):
    """Mean plane variance: the mean of the smallest eigenvalues of local covariances."""
    return 1e6 * chart.pattern.local[0][:, 0].mean()


@metric(
    "1", "less", "Droeschel, Stückler and Behnke 2014, ICRA (radius 10 cm)",
    r"\mathrm{mean}\,\tfrac12 \ln |2 \pi e \Sigma|",
    "It counts the spread in the plane with the noise across it. Thin clouds look better: a plane "
    "through few points takes noise away.",
)  # fmt: skip
def mme(chart):
    """Mean map entropy: of local covariances, in m2."""
    values = chart.pattern.local[0]
    if not values.all():
        raise Unmeasured("neighbours lie in a plane without noise")
    return np.mean(0.5 * np.log(2 * np.pi * np.e * values).sum(axis=1))


RIPLEY_M = 0.01 * np.arange(1, 11)
"""Distances at which pairs of points are counted, m."""

MOST_FOR_DISCREPANCY = 20_000
"""Most points whose discrepancy is measured; its time grows with their square."""


@metric(
    "points", "more", "CloudCompare, surface density (radius 5 cm), at places of the surface",
    r"q_{05}(k), \quad k \text{ points within 5 cm}", "Noise; gaps within the disc.",
)  # fmt: skip
def disc_q05(chart):
    """95 % of the places have more points within 5 cm."""
    return np.quantile(chart.pattern.discs, 0.05)


@metric(
    "1", "less", "Fisher et al. 1922, doi:10.1111/j.1744-7348.1922.tb05962.x (discs of 5 cm)",
    r"\mathrm{var}(k) / \mathrm{mean}(k)", "Density; order within the disc.",
)  # fmt: skip
def dispersion(chart):
    """Index of dispersion of the counts within 5 cm of places: 1 for random points."""
    counts = chart.pattern.discs
    return counts.var() / counts.mean()


@metric(
    "mm", "less", "Ripley 1977, doi:10.1111/j.2517-6161.1977.tb01615.x (1 to 10 cm)",
    r"\max_r\, (L(r) - r), \quad L = \sqrt{K / \pi}", "Gaps without clusters; density.",
)  # fmt: skip
def ripley(chart):
    """Largest excess of pairs over random points, from points 10 cm within the outline."""
    pattern = chart.pattern
    inner = shapely.buffer(pattern.outline, -RIPLEY_M[-1])
    centres = pattern.xy[shapely.contains_xy(inner, *pattern.xy.T)]
    if not len(centres):
        raise Unmeasured("no point lies 10 cm within the outline")
    from scipy.spatial import cKDTree

    pairs = cKDTree(centres).count_neighbors(pattern.tree, RIPLEY_M) - len(centres)
    return 1000 * np.max(np.sqrt(pairs / (len(centres) * pattern.density * np.pi)) - RIPLEY_M)


@metric(
    "1", "less", "Plotnick et al. 1996, doi:10.1103/PhysRevE.53.5461 (boxes of 10 cm)",
    r"\mathrm{E}[k^2] / \mathrm{E}[k]^2", "Order within the box; noise.",
)  # fmt: skip
def lacunarity(chart):
    """Second moment of the counts in boxes over the square of the first."""
    counts = chart.pattern.counts(0.1).astype(float)
    return np.mean(counts**2) / np.mean(counts) ** 2


@metric(
    "1", "less", "Hickernell 1998, doi:10.1090/S0025-5718-98-00894-1; scipy.stats.qmc.discrepancy",
    r"CD(\text{points in the box of the outline})",
    "Density; which gaps they are. A grid may look worse than random points.",
)  # fmt: skip
def discrepancy(chart):
    """Centred discrepancy from even points."""
    from scipy.stats import qmc

    if chart.n > MOST_FOR_DISCREPANCY:
        raise Unmeasured(f"more than {MOST_FOR_DISCREPANCY:,} points")
    xy, outline = chart.pattern.framed
    return qmc.discrepancy(np.clip(xy / outline.bounds[2:], 0, 1))


DIGGLE = "Diggle 2013, section 2.3; Baddeley and Gill 1997, doi:10.1214/aos/1034276629"
WENDLAND = "Wendland 2005, Scattered Data Approximation, section 4.1, doi:10.1017/CBO9780511617539"
OKABE = "Okabe et al. 2000, Spatial Tessellations, section 5, doi:10.1002/9780470317013"
BLIND = "Noise across the plane."


@metric(
    "1", "more", USGS + ": spatial distribution",
    r"\text{share of cells of } 2/\sqrt{\rho} \text{ with a point}",
    "Density; gaps smaller than a cell.",
)  # fmt: skip
def usgs_distribution(chart):
    """Share of cells of twice the nominal spacing with a point; at least 0.9 is asked for."""
    return np.mean(chart.pattern.counts(2 / np.sqrt(chart.pattern.density)) > 0)


VOID_SOURCE = "ASPRS Positional Accuracy Standards 2023, section on data voids; density rasters"


@metric("1", "less", VOID_SOURCE, r"P(k_{5\,\mathrm{cm}} = 0)", BLIND)
def void_5cm(chart):
    """Share of cells of 5 cm without a point."""
    return np.mean(chart.pattern.counts(0.05) == 0)


@metric("1", "less", VOID_SOURCE, r"P(k_{10\,\mathrm{cm}} = 0)", BLIND)
def void_10cm(chart):
    """Share of cells of 10 cm without a point."""
    return np.mean(chart.pattern.counts(0.1) == 0)


@metric("mm", "less", DIGGLE, r"F(e_{50}) = 0.5", "The few large gaps; noise.")
def e50(chart):
    """Half of the places have a point this near."""
    return 1000 * chart.pattern.empty().quantile(0.5)


@metric("mm", "less", DIGGLE, r"F(e_{95}) = 0.95", BLIND)
def e95(chart):
    """95 % of the places have a point this near."""
    return 1000 * chart.pattern.empty().quantile(0.95)


@metric("mm", "less", DIGGLE, r"F(e_{99}) = 0.99", BLIND)
def e99(chart):
    """99 % of the places have a point this near."""
    return 1000 * chart.pattern.empty().quantile(0.99)


@metric(
    "mm", "less", "Diggle 2013, section 2.3; Chiu et al. 2013, doi:10.1002/9781118658222",
    r"F_3(e) = 0.95, \text{ of the third point}", BLIND,
)  # fmt: skip
def e95_of_3(chart):
    """95 % of the places have three points this near."""
    return 1000 * chart.pattern.empty(3).quantile(0.95)


@metric(
    "mm", "less", WENDLAND, r"h = \sup_{x \in \Omega} \min_j |x - x_j|",
    "How many gaps there are: one decides.",
)  # fmt: skip
def fill_distance(chart):
    """Largest distance of a place of the outline from its nearest point."""
    pattern = chart.pattern
    sides = shapely.get_coordinates(shapely.segmentize(shapely.boundary(pattern.outline), 0.002))
    corners = pattern.triangles.points[pattern.triangles.simplices]
    # circumcentres, from the first corner of each triangle
    b, c = (corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)
    twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    squares = np.stack([(c**2).sum(axis=1), (b**2).sum(axis=1)], axis=1)
    x = (c[:, 1] * squares[:, 1] - b[:, 1] * squares[:, 0]) / twice
    y = (b[:, 0] * squares[:, 0] - c[:, 0] * squares[:, 1]) / twice
    centres = corners[:, 0] + np.stack([x, y], axis=1)
    centres = centres[shapely.contains_xy(pattern.outline, *centres.T)]
    return 1000 * pattern.tree.query(np.concatenate([sides, centres]))[0].max()


@metric(
    "1", "less", WENDLAND, r"h / \min_{i \ne j} |x_i - x_j|",
    "Two points that lie close by chance decide.",
)  # fmt: skip
def mesh_ratio(chart):
    """Fill distance over the smallest distance of two points."""
    if not chart.pattern.nearest.min():
        raise Unmeasured("two points share their place")
    return fill_distance(chart) / (1000 * chart.pattern.nearest.min())


@metric("mm", "less", OKABE, r"q_{95}(\sqrt{a}), \text{ by area}", "Cells cut by the outline.")
def voronoi_q95(chart):
    """95 % of the area lies in Voronoi cells of at most this square root of area."""
    areas = chart.pattern.cells
    return 1000 * np.sqrt(_by_area(areas, areas))


@metric("1", "less", OKABE, r"\mathrm{std}(a) / \mathrm{mean}(a)", "Density; noise.")
def voronoi_cv(chart):
    """Coefficient of variation of the areas of Voronoi cells."""
    return chart.pattern.cells.std(ddof=1) / chart.pattern.cells.mean()


@metric(
    "mm", "less", "Shewchuk 2002, What is a good linear element?, 11th Int. Meshing Roundtable",
    r"q_{95}(\text{longest edge}), \text{ by area}", BLIND,
)  # fmt: skip
def delaunay_q95(chart):
    """95 % of the area lies in triangles whose longest edge is at most this."""
    pattern = chart.pattern
    corners = pattern.triangles.points[pattern.triangles.simplices]
    inside = shapely.contains_xy(pattern.outline, *corners.mean(axis=1).T)
    sides = corners[inside] - np.roll(corners[inside], 1, axis=1)
    areas = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    return 1000 * _by_area(np.hypot(*sides.transpose(2, 0, 1)).max(axis=1), areas)


def _by_area(values, areas):
    """The value up to which 95 % of the area lies."""
    order = np.argsort(values)
    share = np.cumsum(areas[order])
    return values[order][np.searchsorted(share, 0.95 * share[-1])]
