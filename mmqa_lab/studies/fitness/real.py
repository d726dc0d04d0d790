"""Real clouds: thinned ones against themselves, a road driven twice, boards of known size."""

import warnings

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from mmqa_lab import io, samples
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.planes import fit_plane
from mmqa_lab.studies.fitness.tasks import relief_errors, shown

__all__ = ["real_boards", "road_squares", "thinned_road"]

ROAD, SIDE_M, FEWEST = "road_ground/mls_two_drives.laz", 1.0, 30
"""A road from two drives, its squares' width, and the fewest points of each drive."""

BOARD_M = (0.61, 0.85)

SHARES = 0.5 ** np.arange(8)
"""Shares of the points that are left of the road patch."""

PLACES_M = ((-0.5, -0.45), (0.5, 0.45))
"""Middles of two squares of 1 m on the road patch: the chart's and the thing's."""


def thinned_road(repeats=3, *, seed=0):
    """Return metrics and errors of thinned real clouds, with what the whole cloud has as the truth.

    The road patch as its two heads saw it, each alone and both together, is thinned by chance, by
    whole stretches of its order, and with holes of 10 to 40 cm. The chart is one square of 1 m, the
    thing is another.
    """
    charts, errors, rng = [], [], np.random.default_rng(seed)
    heads = samples.road_patch_heads()
    heads["both"] = np.concatenate(list(heads.values()))
    for points in heads.values():
        plane = fit_plane(points)
        local = np.column_stack([plane.project(points), plane.residuals])
        smooth = local[:, 2].copy()
        near = cKDTree(local[:, :2]).query_ball_point(local[:, :2], 0.05)
        smooth = np.array([local[one, 2].mean() for one in near])
        local[:, 2] -= smooth
        for share in np.repeat(SHARES, repeats):
            for way in ("chance", "stretches", "holes"):
                keep = rng.random(len(local)) < share
                if way == "stretches":
                    keep = np.repeat(rng.random(-(-len(local) // 40)) < share, 40)[: len(local)]
                if way == "holes":
                    middles = rng.uniform(-1, 1, (8, 2))
                    far = cKDTree(middles).query(local[:, :2])[0] > rng.uniform(0.05, 0.2)
                    keep &= far
                left = local[keep]
                chart, thing = (
                    left[(np.abs(left[:, :2] - place) < 0.5).all(axis=1)] - [*place, 0]
                    for place in PLACES_M
                )
                if min(len(chart), len(thing)) < 10:
                    continue
                ring = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
                charts.append(evaluate_cloud(chart, polygon=ring))
                turn = 2 * np.pi * rng.random()
                c, s = np.cos(turn), np.sin(turn)
                uv = thing[:, :2] @ np.array([[c, -s], [s, c]])
                found = shown(thing[:, :2]) | relief_errors(uv, thing[:, 2], 0.005, [seed])
                errors.append(found | {"cloud_way": way})
    return _figures(charts), pd.DataFrame(errors).drop(columns="cloud_way")


def road_squares():
    """Return the metrics of squares of a road and how far a second drive lies off, or two Nones.

    Metrics are of the first drive; the errors are the differences of the planes of both drives in
    the middle of the square (``offset_mm``) and of their slopes (``tilt_deg``). Squares do not
    adjoin: between two of them lies one that is left out.
    """
    if not samples.has_real(ROAD):
        return None, None
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of later returns
        cloud = io.read_cloud(samples.real_path(ROAD), columns=["gps_time"])
    times = np.sort(cloud["gps_time"])
    second = cloud["gps_time"] > times[np.argmax(np.diff(times))]
    points = cloud.points - np.floor(cloud.points.min(axis=0))
    cells = np.floor(points[:, :2] / SIDE_M).astype(int)
    table = pd.DataFrame(cells).assign(second=second)
    charts, errors = [], []
    for place, rows in table.groupby([0, 1]).groups.items():
        drives = [points[rows][second[rows] == late] for late in (False, True)]
        if min(map(len, drives)) >= FEWEST and sum(place) % 2 == 0:
            middle = SIDE_M * (np.array(place) + 0.5)
            off = np.subtract(*(_height_and_slopes(drive, middle) for drive in drives))
            tilt = np.degrees(np.hypot(*off[1:]))
            errors.append({"offset_mm": 1000 * abs(off[0]), "tilt_deg": tilt})
            charts.append(evaluate_cloud(drives[0]))
    return _figures(charts), pd.DataFrame(errors)


def _height_and_slopes(points, middle):
    """Height of the regression plane above a place, m, and its two slopes, m/m."""
    plane = fit_plane(points)
    slope = -plane.normal[:2] / plane.normal[2]
    return plane.centre[2] + slope @ (middle - plane.centre[:2]), *slope


def real_boards():
    """Return the metrics of boards, and by how much their points end before the edges, or Nones.

    The error ``end_mm`` is half of what lacks of the width and height of ``BOARD_M``, root mean
    square.
    """
    names = [f"boards/{name}_pose{k:02d}.laz" for name in ("vlp16", "os64") for k in range(41)]
    charts, lacks = [], []
    for name in filter(samples.has_real, names):
        charts.append(evaluate_cloud(io.read_cloud(samples.real_path(name), columns=()).points))
        box = shapely.minimum_rotated_rectangle(shapely.multipoints(charts[-1].xy))
        sides = np.linalg.norm(np.diff(shapely.get_coordinates(box)[:3], axis=0), axis=1)
        lacks.append(500 * np.sqrt(np.mean((np.sort(sides) - BOARD_M) ** 2)))
    return (_figures(charts), pd.DataFrame({"end_mm": lacks})) if charts else (None, None)


def _figures(charts):
    """The metrics of charts, turned so that less is better."""
    return pd.DataFrame({
        name: metric.worst_last([metric(chart) for chart in charts])
        for name, metric in METRICS.items()
    })  # fmt: skip
