"""How many points, how near to each other, how noisy: density, neighbours and noise."""

import numpy as np

from mmqa_lab.metrics.pattern import Unmeasured
from mmqa_lab.metrics.registry import metric

__all__ = ["anps", "clark_evans", "density", "f", "g", "mme", "mpv", "noise_of_a_mean"]
__all__ += ["roughness", "sigma_mad"]

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
    "Errors that neighbours share; times 1/L it is the error of a mean over L x L.",
)  # fmt: skip
def noise_of_a_mean(chart):
    """Standard error of the mean of a patch of 1 m x 1 m."""
    return chart.sigma_mad_mm / np.sqrt(chart.pattern.density)


@metric("1", "less", PFEIFER, "d_4 / d_1", "Holes, density; it depends on the axes of quadrants.")
def f(chart):
    """Inhomogeneity."""
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
    "Errors over more than 10 cm; places with fewer than 5 points.",
)  # fmt: skip
def mpv(chart):
    """Mean plane variance: of the smallest eigenvalue of local covariances."""
    return 1e6 * chart.pattern.local[0][:, 0].mean()


@metric(
    "1", "less", "Droeschel and Behnke 2014, doi:10.1109/ICRA.2014.6907651 (radius 10 cm)",
    r"\mathrm{mean}\,\tfrac12 \ln |2 \pi e \Sigma|",
    "It counts the spread in the plane with the noise across it.",
)  # fmt: skip
def mme(chart):
    """Mean map entropy: of local covariances, in m2."""
    values = chart.pattern.local[0]
    if not values.all():
        raise Unmeasured("neighbours lie in a plane without noise")
    return np.mean(0.5 * np.log(2 * np.pi * np.e * values).sum(axis=1))
