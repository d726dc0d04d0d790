"""The surfaces an operator selects from: simulated charts, and real boards, roads and walls."""

from dataclasses import dataclass, replace

import numpy as np
from tqdm.auto import tqdm

from mmqa_lab import io, samples
from mmqa_lab.chart_cloud import CHART_MARGIN_M, chart_polygon
from mmqa_lab.planes import fit_plane
from mmqa_lab.simulate import systems
from mmqa_lab.simulate.objects import chart_corners
from mmqa_lab.views import is_headless

SENSORS = {
    "A": systems.SYSTEM_A,
    "B": systems.SYSTEM_B,
    "B tilted": replace(systems.SYSTEM_B, tilt_deg=45.0),
    "C": replace(systems.SYSTEM_C, focal_px=2000, width_px=425, height_px=425),
}
"""A and B as stated. B's mounting is not stated: once upright, once tilted by 45 degrees, which
comes close to the published spacings. C is fitted: its resolution gives the published d1 at 5 m."""

BOARDS = {
    "board, VLP-16": "boards/vlp16_pose02.laz",
    "board, 64 rings": "boards/os64_pose02.laz",
}

WALL_CENTRE = (-0.5, 2.54, -0.65)
"""A flat place of the hall's wall, 2.6 m from the scanner, in the frame of sweep A, m."""

SIDE_M = 0.71
"""A square of half a square metre, as on the charts."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A scan of a surface and the outline that an operator means to select.

    Parameters
    ----------
    name : str
        System, or real surface.
    distance_m : float
        From the path or the scanner; NaN where not stated.
    scan : int
        Repeated scans are counted.
    kind : str
        ``simulated`` or ``real``.
    points : array, shape (n, 3)
    corners : array, shape (4, 3)
    """

    name: str
    distance_m: float
    scan: int
    kind: str
    points: np.ndarray
    corners: np.ndarray


def charts(*, names, distances, scans, seed, margin=CHART_MARGIN_M):
    """Drive systems past charts.

    Parameters
    ----------
    names : sequence of str
        Of ``SENSORS``.
    distances : sequence of float
        Metres.
    scans : int
        Drives past each chart, every one with its own errors and place of the scan pattern.
    seed : int
        Of the first drive.
    margin : float
        Width left out along the chart's edges, m; 0 includes the border.

    Returns
    -------
    list of Surface
    """
    found = []
    for name in tqdm(names, desc="systems", disable=is_headless()):
        for distance in distances:
            corners = chart_corners((distance, 0, 0), heading=systems.FACING_THE_ROAD)
            outline = chart_polygon(corners, margins=margin)
            for scan in range(scans):
                cloud = systems.pass_chart(SENSORS[name], distance, seed=seed + scan)
                given = (name, float(distance), scan, "simulated", cloud.points, outline)
                found.append(Surface(*given))
    return found


def real_surfaces():
    """Return the road patch, and boards and a hall's wall where MMQA_DATA has them.

    The wall was swept twice from two places; the others have one scan.

    Returns
    -------
    list of Surface
    """
    road = io.read_cloud(samples.path("road_patch"), columns=()).points
    found = [_outlined("road, two heads", np.nan, 0, np.unique(road, axis=0), SIDE_M, SIDE_M)]
    for name, relative in BOARDS.items():
        if samples.has_real(relative):
            board = io.read_cloud(samples.real_path(relative), columns=()).points
            distance = float(np.linalg.norm(board.mean(axis=0)))
            found.append(_outlined(name, distance, 0, board, 0.65, 0.45))
    if samples.has_real("hdl32e_pair/a_to_b.txt"):
        found.extend(_walls())
    return found


def _walls():
    """The hall's wall in both sweeps, with one outline."""
    pose = np.loadtxt(samples.real_path("hdl32e_pair/a_to_b.txt"))
    first, second = (
        io.read_cloud(samples.real_path(f"hdl32e_pair/sweep_{sweep}.laz"), columns=()).points
        for sweep in "ab"
    )
    moved = second @ pose[:3, :3].T + pose[:3, 3]
    near = [points[np.linalg.norm(points - WALL_CENTRE, axis=1) < 1] for points in (first, moved)]
    distance = float(np.linalg.norm(WALL_CENTRE))
    wall = _outlined("hall wall", distance, 0, near[0], SIDE_M, SIDE_M, centre=WALL_CENTRE)
    return [wall, replace(wall, scan=1, points=near[1])]


def _outlined(name, distance, scan, points, width, height, centre=None):
    """A real surface with a rectangle about its middle, along its principal axes."""
    plane = fit_plane(points, robust=True)
    middle = np.median(points, axis=0) if centre is None else np.asarray(centre)
    middle = middle - plane.distances(middle) * plane.normal
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
    corners = middle + (signs * [width, height]) @ plane.axes
    return Surface(name, distance, scan, "real", points, corners)
