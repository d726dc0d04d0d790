"""Variation of density, sigma_MAD and f when the same chart is selected again."""

from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from mmqa_lab import bench as benches
from mmqa_lab import io, samples
from mmqa_lab.chart_cloud import chart_polygon, evaluate_cloud
from mmqa_lab.planes import fit_plane
from mmqa_lab.repeatability import operator_polygons, repeatability
from mmqa_lab.simulate import chart_corners, systems
from mmqa_lab.studies.anisotropy import boards

__all__ = [
    "FIGURES", "KEYS", "METHODS", "SENSORS", "UPRIGHT", "Surface", "bench", "chart_scan",
    "figures", "limits", "make", "operators", "ranges_of_five", "real_surfaces", "selected",
]  # fmt: skip

UPRIGHT = replace(systems.SYSTEM_B, range_noise_m=0.01)
"""B's range noise is fitted to the published sigma_MAD of 9.2 mm."""

SENSORS = {
    "A": systems.SYSTEM_A,
    "B": UPRIGHT,
    "B tilted": replace(UPRIGHT, tilt_deg=45.0),
    "C": systems.SYSTEM_C,
}
"""A and B have the specifications of the paper and of data sheets, except B's noise. A's noise and
its tilt of 45 degrees are assumed. B's mounting is not stated. It is simulated upright and tilted
by 45 degrees, which comes close to the published spacings. C is fitted to Table 2."""

FIGURES = {"density_polygon_per_m2": "density", "std_mm": "std", "sigma_mad_mm": "sigma_MAD"}
FIGURES |= {name: name.removesuffix("_mm") for name in ("d1_mm", "d2_mm", "d3_mm", "d4_mm", "f")}
"""Figures and their names in tables."""

KEYS = ["method", "system", "distance_m"]
"""Columns that name an operator and a surface."""


class Surface(NamedTuple):
    """A scan of a surface, ``points`` (n, 3), and ``corners`` (4, 3) of the intended outline, m."""

    points: np.ndarray
    corners: np.ndarray


@lru_cache(maxsize=64)
def chart_scan(system, distance_m, scan, *, seed=5000):
    """Drive a system of ``SENSORS`` past a chart; return a Surface.

    The number ``scan`` of the drive is added to ``seed``. Each drive has its own errors and its own
    position of the scan pattern.
    """
    corners = chart_corners((distance_m, 0, 0), heading=systems.FACING_THE_ROAD)
    cloud = systems.pass_chart(SENSORS[system], distance_m, seed=seed + scan)
    return Surface(cloud.points, chart_polygon(corners))


@lru_cache(maxsize=1)
def real_surfaces():
    """Return the road patch and, if MMQA_DATA has them, boards: a dict of Surface by name."""
    road = io.read_cloud(samples.path("road_patch"), columns=()).points
    found = {"road, two heads": _outlined(np.unique(road, axis=0), 0.81, 0.62)}
    return found | {name: _outlined(points, 0.65, 0.45) for name, points in boards().items()}


def _outlined(points, width, height):
    """A real surface with a rectangle around its middle, along its principal axes."""
    plane = fit_plane(points, robust=True)
    middle = np.median(points, axis=0)
    middle = middle - plane.distances(middle) * plane.normal
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    return Surface(points, middle + (signs * [width, height]) @ plane.axes)


def selected(surface, seed, *, click_m=0.015, vertices=4, axes="principal"):
    """Evaluate an operator's selection of a surface; return a dict with the keys of ``FIGURES``.

    Clicks have the standard deviation ``click_m`` in each direction, m. ``vertices`` is 4 for a
    quadrilateral and a multiple of 4 for a free polygon. For ``axes`` see
    :func:`mmqa_lab.chart_cloud.evaluate_cloud`.
    """
    choices = {"repeats": 1, "click": click_m, "seed": seed, "vertices": vertices}
    polygon = operator_polygons(surface.corners, **choices)[0]
    return figures(evaluate_cloud(surface.points, polygon=polygon, axes=axes))


def figures(quality):
    """Return the figures of a CloudQuality by the keys of ``FIGURES``."""
    known = {f"d{k}_mm": distance for k, distance in enumerate(quality.d_mm, 1)}
    return {name: known[name] if name in known else getattr(quality, name) for name in FIGURES}


def operators(click_m=0.015):
    """Return operators with a click error, m: functions of a tuple (Surface, seed) by name."""
    chosen = partial(selected, click_m=click_m)
    return {
        "4 clicks, principal axes": lambda data: chosen(*data),
        "4 clicks, level axes": lambda data: chosen(*data, axes="horizontal"),
        "12 clicks, level axes": lambda data: chosen(*data, vertices=12, axes="horizontal"),
    }


METHODS = operators()


def make(system, distance_m, scan, *, seed):
    """Return a scan of a chart or a real surface, and the seed of its selection."""
    real = real_surfaces()
    surface = real[system] if system in real else chart_scan(system, distance_m, scan)
    return (surface, [seed, scan, int(distance_m)]), None


def bench(*, methods=None, systems=tuple(SENSORS), distances=(5.0, 10.0), scans=4, seeds=range(50)):
    """Define the study's bench: operators who select the same scans again and again.

    Parameters
    ----------
    methods : dict, optional
        Functions of a tuple (Surface, seed) that return a dict of figures; by default ``METHODS``.
    systems : tuple of str
        Names of ``SENSORS`` or of :func:`real_surfaces`.
    distances : tuple of float
        Distances from the path to the chart, m.
    scans : int
        Number of drives past each chart.
    seeds : iterable of int
        Seeds of the selections.

    Returns
    -------
    Comparison
    """
    cases = benches.grid(system=systems, distance_m=distances, scan=range(scans))
    answer = {"tables": lambda results: {"repeatability": limits(results)}}
    return benches.Comparison(cases, dict(methods or METHODS), make, seeds=seeds, **answer)


def limits(results):
    """Return the repeatability of every figure for each surface and operator.

    ``results`` is the Dataset of :func:`bench`. A row has ``method``, ``system``, ``distance_m``,
    ``figure`` and the columns of :meth:`mmqa_lab.repeatability.Repeatability.to_frame`.
    """
    cells = benches.cell_table(results).set_index([*KEYS, "scan"])
    values = cells[cells.columns.intersection(list(FIGURES))].stack().dropna()
    values = values.rename_axis([*KEYS, "scan", "figure"]).rename("value").reset_index()
    several = values.groupby([*KEYS, "scan", "figure"])["value"].transform("size") > 1
    parts = values[several].groupby([*KEYS, "figure"], sort=False)
    tables = {key: repeatability(rows, "value").to_frame() for key, rows in parts}
    return pd.concat(tables, names=[*KEYS, "figure"]).droplevel(-1).reset_index()


def ranges_of_five(results):
    """Return the ranges of figures over groups of five selections of a scan, as in section 4.4.

    ``results`` is the Dataset of :func:`bench`. Each group has a row with ``density_percent`` (in
    percent of the group's mean), ``precision_mm`` (range of sigma_MAD) and ``medians_mm`` (the
    widest range of d1..d4).
    """
    table = benches.cell_table(results)
    groups = table.groupby([*KEYS, "scan", (table["seed"] // 5).rename("group")], sort=False)
    density = groups["density_polygon_per_m2"]
    found = {
        "density_percent": 100 * density.agg(np.ptp) / density.mean(),
        "precision_mm": groups["sigma_mad_mm"].agg(np.ptp),
        "medians_mm": groups[["d1_mm", "d2_mm", "d3_mm", "d4_mm"]].agg(np.ptp).max(axis=1),
    }
    return pd.DataFrame(found)[groups.size() == 5].reset_index()
