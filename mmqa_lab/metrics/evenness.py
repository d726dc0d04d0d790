"""How evenly the points lie: counts in discs and boxes, pairs of points, discrepancy."""

import numpy as np

from mmqa_lab.metrics.pattern import Unmeasured
from mmqa_lab.metrics.registry import metric

__all__ = ["disc_q05", "discrepancy", "dispersion", "lacunarity", "ripley"]

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
    import shapely

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
    r"CD(\text{points in the box of the outline})", "Density; which gaps they are.",
)  # fmt: skip
def discrepancy(chart):
    """Centred discrepancy from even points."""
    from scipy.stats import qmc

    if chart.n > MOST_FOR_DISCREPANCY:
        raise Unmeasured(f"more than {MOST_FOR_DISCREPANCY:,} points")
    xy, outline = chart.pattern.framed
    return qmc.discrepancy(np.clip(xy / outline.bounds[2:], 0, 1))
