"""Chart metrics: the chart of Pfeifer et al. 2021 for three systems, read in several ways.

The paper requires 40 km/h or more and does not print the driven speed. Here it is 40 km/h.
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

__all__ = [
    "FIGURES", "METHODS", "SENSORS", "bench", "chart_cloud", "differences", "make", "read",
    "table_2",
]  # fmt: skip

FIGURES = {
    "density_per_m2": "density",
    "precision_mm": "sigma_mad",
    "d1_mm": "d1",
    "d4_mm": "d4",
    "f": "f",
}
"""Figures of Table 2, and their names in the ledger."""

SENSORS = {
    "A": systems.SYSTEM_A,
    "A upright": replace(systems.SYSTEM_A, tilt_deg=0.0),
    "B": systems.SYSTEM_B,
    "C": systems.SYSTEM_C,
}


def table_2():
    """Return the published Table 2 with sigma_MAD as ``precision_mm``.

    Examples
    --------
    >>> table_2().query("system == 'C'")["precision_mm"].tolist()
    [14.0, 23.0]
    """
    printed = published.table("pfeifer2021", "table_2")
    return printed.rename(columns={"sigma_mad_mm": "precision_mm"})


def chart_cloud(system, distance_m, *, seed, height_m=0.0, **changes):
    """Scan the chart with a system of ``SENSORS``; return a Cloud, m, with the centre as origin.

    x points away from the path, y along the path, and z up. The sensor is ``height_m`` above the
    centre. ``changes`` are other values for fields of the sensor.
    """
    sensor = replace(SENSORS[system], **changes)
    cloud = systems.pass_chart(sensor, distance_m, seed=seed, height=height_m)
    return Cloud(cloud.points - [distance_m, 0, 0], cloud.columns)


def make(system, distance_m, *, seed):
    """Scan the chart; return the Cloud, and its true density and noise as a dict."""
    cloud = chart_cloud(system, distance_m, seed=seed)
    across = cloud["range_noise_m"] * np.cos(np.radians(cloud["incidence_deg"]))
    return cloud, {"density_per_m2": len(cloud), "precision_mm": 1000 * across.std()}


def read(cloud, *, density="hull", spread="sigma_mad", scale=PAPER_SCALE, margins=CHART_MARGINS_M):
    """Read the figures of Table 2 from a chart, by default by Appendix A of the paper.

    The density is the points per area of the ``"hull"`` or of the ``"polygon"``. The spread is
    ``"sigma_mad"`` or ``"std"``. For the scale see :func:`mmqa_lab.chart_cloud.evaluate_cloud`, for
    margins :func:`mmqa_lab.chart_cloud.chart_polygon`. The dict has the keys of ``FIGURES``.
    """
    corners = chart_corners((0, 0, 0), heading=systems.FACING_THE_ROAD)
    polygon = chart_polygon(corners, margins=margins)
    quality = evaluate_cloud(cloud, polygon=polygon, thickness=0.2, axes="principal", scale=scale)
    return {
        "density_per_m2": getattr(quality, f"density_{density}_per_m2"),
        "precision_mm": getattr(quality, f"{spread}_mm"),
        "d1_mm": quality.d1_mm,
        "d4_mm": quality.d4_mm,
        "f": quality.f,
    }


METHODS = {
    "hull (Appendix A)": read,
    "polygon (section 3.3)": partial(read, density="polygon", scale=CONSISTENT_SCALE),
    "hull, std": partial(read, spread="std"),
    "whole chart": partial(read, margins=0.0),
}
"""Readings of the same chart. They differ in area, estimator or selection. Section 3.3 prints
no factor of sigma_MAD; its reading here has the consistent factor."""


def bench(*, methods=None, systems=tuple(SENSORS), distances_m=(5.0, 10.0), seeds=range(4)):
    """Define the study's bench: readings of the chart of each system at both distances.

    Parameters
    ----------
    methods : dict, optional
        Functions of the chart's Cloud that return a dict of figures; by default ``METHODS``.
    systems : tuple of str
        Names of ``SENSORS``.
    distances_m : tuple of float
        Distances from the path to the chart, m.
    seeds : iterable of int
        Seeds of the passes.

    Returns
    -------
    Comparison
    """
    cases = benches.grid(system=systems, distance_m=distances_m)
    answer = {"tables": lambda results: {"off": differences(results, "truth")}}
    return benches.Comparison(cases, dict(methods or METHODS), make, seeds=seeds, **answer)


def differences(results, reference):
    """Return differences of figures from a reading or from the ``"truth"``, in percent.

    ``results`` is the Dataset of :func:`bench`. The table has a row for each ``method`` and
    ``system``, and a column for each figure with its name in the ledger.
    """
    means = benches.cell_table(results).groupby(["method", "system"], sort=False)
    means = means.mean(numeric_only=True)
    if reference == "truth":
        base = means.filter(like="truth_").rename(columns=lambda name: name.removeprefix("truth_"))
    else:
        base = means.loc[reference, list(FIGURES)]
    table = 100 * (means[base.columns] / base - 1)
    return table.rename(columns=lambda name: f"{FIGURES[name]}_percent").reset_index()
