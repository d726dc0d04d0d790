"""Real clouds: thinned ones against themselves, a road driven twice, boards of known size."""

import warnings
from contextlib import suppress

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree

from mmqa_lab import io, samples
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.metrics import METRICS
from mmqa_lab.planes import fit_plane
from mmqa_lab.studies.fitness.acquisitions import SQUARE
from mmqa_lab.studies.fitness.tasks import relief_errors, shown

__all__ = ["real_boards", "road_squares", "thinned"]

ROAD, TWICE_M, FEWEST = "road_ground/mls_two_drives.laz", 0.75, 30
"""A road from two drives, the width of squares that both saw, and each drive's fewest points."""

SIDE_M = 1.0
"""Width of a square of a thinned cloud."""

BOARD_M = (0.61, 0.85)

FLAT_M = 0.03
"""Largest standard deviation of a stretch about its plane."""


SHARES = 0.5 ** np.arange(8)
"""Shares of the points that are left."""

STREETS = {
    "road, thinned": ROAD,
    "street, profiles (Oakland)": "oakland/part2_ac.laz",
    "street, solid state": "public/livox_source.pcd",
    "street, profiles (Lille)": "lille_street",
}
"""Real clouds whose densest stretch is thinned, beside the road patch of the samples; the last is
one of ``samples.PUBLIC``."""

PLACES_M = ((-0.5, -0.45), (0.5, 0.45))
"""Middles of two squares of 1 m on the road patch: the chart's and the thing's."""

ALONG_M = ((-1.0, 0.0), (1.0, 0.0))
"""The same on a stretch of three squares of another cloud."""

NEAR = 20
"""Points over which a dense cloud is averaged to the surface from which noise is counted."""


def thinned(repeats=2):
    """Return metrics and errors of thinned real clouds, with what the whole cloud has as the truth.

    Clouds are the road patch as its two heads saw it, each alone and both together, and the densest
    stretches of ``STREETS``. Each is thinned by chance, by whole stretches of its order, and with
    holes of 10 to 40 cm. The chart is one square of 1 m, the thing is another.

    Returns
    -------
    dict
        Name -> DataFrames of metrics and of errors.
    """
    heads, found = samples.road_patch_heads(), {}
    heads["both"] = np.concatenate(list(heads.values()))
    clouds = {"road patch": [(points, PLACES_M) for points in heads.values()]}
    for name, file in STREETS.items():
        if samples.has_real(file):
            with warnings.catch_warnings(action="ignore", category=UserWarning):
                cloud = io.read_cloud(samples.real_path(file), columns=())
            clouds[name] = [(_densest(cloud.points), ALONG_M)]
    for number, (name, parts) in enumerate(clouds.items()):
        rng = np.random.default_rng([0, number])
        pairs = [pair for one in parts for pair in _thinned(*one, repeats, rng)]
        charts, errors = zip(*pairs, strict=True)
        found[name] = _figures(charts), pd.DataFrame(errors)
    return found


def _densest(points):
    """The points of three squares in a row along x, flat to 3 cm, the sparser end the densest."""
    points = points - np.floor(points.min(axis=0))
    cells = pd.DataFrame(np.floor(points[:, :2] / SIDE_M).astype(int))
    counts = cells.value_counts()
    other = counts.reindex(counts.index.map(lambda cell: (cell[0] + 2, cell[1])))
    least = pd.Series(np.minimum(counts, other.to_numpy()), counts.index).dropna()
    for cell in least.sort_values(ascending=False).index:
        low = SIDE_M * np.array(cell)
        inside = ((points[:, :2] >= low) & (points[:, :2] < low + [3 * SIDE_M, SIDE_M])).all(axis=1)
        patch = points[inside]
        if fit_plane(patch).std < FLAT_M:
            return patch - [*(low + [1.5 * SIDE_M, 0.5 * SIDE_M]), patch[:, 2].mean()]
    raise ValueError("Invalid cloud: no flat stretch of 3 m. Must have one.")


def _thinned(points, places, repeats, rng):
    """Charts and errors of a cloud that is thinned in three ways."""
    plane = fit_plane(points)
    local = np.column_stack([plane.project(points), plane.residuals])
    if places is ALONG_M:
        local = np.column_stack([points[:, :2], plane.residuals])
    _, near = cKDTree(local[:, :2]).query(local[:, :2], NEAR)
    local[:, 2] -= local[near, 2].mean(axis=1)
    half = np.ptp(local[:, :2], axis=0) / 2
    for share in np.repeat(SHARES, repeats):
        for way in ("chance", "stretches", "holes"):
            keep = rng.random(len(local)) < share
            if way == "stretches":
                keep = np.repeat(rng.random(-(-len(local) // 40)) < share, 40)[: len(local)]
            if way == "holes":
                middles = rng.uniform(-half, half, (8, 2))
                keep &= cKDTree(middles).query(local[:, :2])[0] > rng.uniform(0.05, 0.2)
            left = local[keep]
            chart, thing = (
                left[(np.abs(left[:, :2] - place) < 0.5).all(axis=1)] - [*place, 0]
                for place in places
            )
            if min(len(chart), len(thing)) < 10:
                continue
            turn = 2 * np.pi * rng.random()
            c, s = np.cos(turn), np.sin(turn)
            uv = thing[:, :2] @ np.array([[c, -s], [s, c]])
            errors = shown(thing[:, :2]) | relief_errors(uv, thing[:, 2], 0.005, [7])
            with suppress(ValueError):  # what is left on a line has no plane along the ring
                yield evaluate_cloud(chart, polygon=SQUARE), errors


def road_squares():
    """Return the metrics of squares of a road and how far a second drive lies off, or two Nones.

    Metrics are of the first drive; the errors are the differences of the planes of both drives in
    the middle of the square (``offset_mm``) and of their slopes (``tilt_deg``). Squares share
    neither side nor corner: between two of them lies one that is left out.
    """
    if not samples.has_real(ROAD):
        return None, None
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of later returns
        cloud = io.read_cloud(samples.real_path(ROAD), columns=["gps_time"])
    times = np.sort(cloud["gps_time"])
    second = cloud["gps_time"] > times[np.argmax(np.diff(times))]
    points = cloud.points - np.floor(cloud.points.min(axis=0))
    table = pd.DataFrame(np.floor(points[:, :2] / TWICE_M).astype(int)).assign(second=second)
    counts = table.groupby([0, 1])["second"].agg(["size", "sum"])
    seen = counts[np.minimum(counts["sum"], counts["size"] - counts["sum"]) >= FEWEST]
    groups = pd.DataFrame(seen.index.to_list(), columns=["a", "b"]).mod(2)
    odd = groups.value_counts().idxmax()  # of four sets of squares that do not adjoin, the largest
    charts, errors = [], []
    for place, rows in table.groupby([0, 1]).groups.items():
        drives = [points[rows][second[rows] == late] for late in (False, True)]
        if place in seen.index and tuple(np.mod(place, 2)) == odd:
            middle = TWICE_M * (np.array(place) + 0.5)
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
