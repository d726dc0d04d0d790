"""How large the places without a point are: cells, empty space, Voronoi cells, triangles."""

import numpy as np
import shapely

from mmqa_lab.metrics.amount import USGS
from mmqa_lab.metrics.pattern import Unmeasured
from mmqa_lab.metrics.registry import metric

__all__ = ["delaunay_q95", "e50", "e95", "e95_of_3", "e99", "fill_distance", "mesh_ratio"]
__all__ += ["usgs_distribution", "void_5cm", "void_10cm", "voronoi_cv", "voronoi_q95"]

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
