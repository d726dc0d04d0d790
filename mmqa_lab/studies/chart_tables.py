"""Chart metrics: the chart of three systems of Pfeifer et al. 2021, read in several ways.

The paper asks for 40 km/h or more and does not print the speed driven; 40 km/h is assumed.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from mmqa_lab import bench as benches
from mmqa_lab import published
from mmqa_lab.chart_cloud import CHART_MARGINS_M, chart_polygon, evaluate_cloud
from mmqa_lab.cloud import Cloud
from mmqa_lab.planes import CONSISTENT_SCALE, PAPER_SCALE
from mmqa_lab.simulate import chart_corners, systems

FIGURES = {
    "density_per_m2": "density",
    "precision_mm": "sigma_mad",
    "d1_mm": "d1",
    "d4_mm": "d4",
    "f": "f",
}
"""Figures of Table 2, and how the ledger calls them."""

SENSORS = {
    "A": systems.SYSTEM_A,
    "A upright": replace(systems.SYSTEM_A, tilt_deg=0.0),
    "B": systems.SYSTEM_B,
    "C": systems.SYSTEM_C,
}


def table_2():
    """Return the published Table 2, with sigma_MAD as ``precision_mm``.

    Examples
    --------
    >>> table_2().query("system == 'C'")["precision_mm"].tolist()
    [14.0, 23.0]
    """
    printed = published.table("pfeifer2021", "table_2")
    return printed.rename(columns={"sigma_mad_mm": "precision_mm"})


def chart_cloud(system, distance_m, *, seed, height_m=0.0, **changes):
    """Scan the chart with a system of ``SENSORS``: a Cloud in metres from the chart's centre.

    x points away from the path, y along it, z up. The sensor is ``height_m`` above the centre.
    ``changes`` are fields of the sensor.
    """
    sensor = replace(SENSORS[system], **changes)
    cloud = systems.pass_chart(sensor, distance_m, seed=seed, height=height_m)
    return Cloud(cloud.points - [distance_m, 0, 0], cloud.columns)


def make(system, distance_m, *, seed):
    """Scan the chart: a Cloud, and its true density and noise."""
    cloud = chart_cloud(system, distance_m, seed=seed)
    across = cloud["range_noise_m"] * np.cos(np.radians(cloud["incidence_deg"]))
    return cloud, {"density_per_m2": len(cloud), "precision_mm": 1000 * across.std()}


def read(
    cloud,
    *,
    density="hull",
    axes="principal",
    spread="sigma_mad",
    scale=PAPER_SCALE,
    margins=CHART_MARGINS_M,
):
    """Read the figures of Table 2 from a chart, by default as Appendix A of the paper does.

    The density is that of the ``"hull"`` or of the ``"polygon"``, the spread ``"sigma_mad"`` or
    ``"std"``. Axes and scale are those of :func:`mmqa_lab.chart_cloud.evaluate_cloud`, margins
    those of :func:`mmqa_lab.chart_cloud.chart_polygon`. The dict has the keys of ``FIGURES``.
    """
    corners = chart_corners((0, 0, 0), heading=systems.FACING_THE_ROAD)
    polygon = chart_polygon(corners, margins=margins)
    quality = evaluate_cloud(cloud, polygon=polygon, thickness=0.2, axes=axes, scale=scale)
    return {
        "density_per_m2": getattr(quality, f"density_{density}_per_m2"),
        "precision_mm": getattr(quality, f"{spread}_mm"),
        "d1_mm": quality.d1_mm,
        "d4_mm": quality.d4_mm,
        "f": quality.f,
    }


METHODS = {
    "Appendix A": read,
    "section 3.3": partial(read, density="polygon", scale=CONSISTENT_SCALE),
    "std": partial(read, spread="std"),
    "horizontal axes": partial(read, axes="horizontal"),
    "whole chart": partial(read, margins=0.0),
}
"""How the same chart can be read: the area, the axes, the estimator, the selection. Section 3.3
prints no factor of sigma_MAD; its reading here has the consistent one."""


def bench(*, methods=None, systems=tuple(SENSORS), distances_m=(5.0, 10.0), seeds=range(4)):
    """Define the study's bench: readings of the chart of each system at both distances.

    Parameters
    ----------
    methods : dict, optional
        Functions of the chart's Cloud, which return figures; by default ``METHODS``.
    systems : tuple of str
        Of ``SENSORS``.
    distances_m : tuple of float
    seeds : iterable of int

    Returns
    -------
    Comparison
    """
    cases = benches.grid(system=systems, distance_m=distances_m)
    answer = {"tables": lambda results: {"off": differences(results, "truth")}}
    return benches.Comparison(cases, dict(methods or METHODS), make, seeds=seeds, **answer)


def differences(results, reference):
    """Differences of the figures from a reading or, with ``"truth"``, from the truth, in per cent.

    Results are those of :func:`bench`. The table has a row for each ``method`` and ``system``, and
    a column for each figure, named as in the ledger.
    """
    means = benches.cell_table(results).groupby(["method", "system"], sort=False)
    means = means.mean(numeric_only=True)
    if reference == "truth":
        base = means.filter(like="truth_").rename(columns=lambda name: name.removeprefix("truth_"))
    else:
        base = means.loc[reference, list(FIGURES)]
    table = 100 * (means[base.columns] / base - 1)
    return table.rename(columns=lambda name: f"{FIGURES[name]}_percent").reset_index()
