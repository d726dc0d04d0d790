"""Edges of real clouds: boards of known size seen by a camera too, and two overlapping sweeps."""

import warnings

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from mmqa_lab import lines, samples
from mmqa_lab.io import read_cloud
from mmqa_lab.lines import extract_edges, fit_outline

BOARD_M = np.array([0.85, 0.61])
"""The board's sides (acfr/cam_lidar_calibration)."""

CORNERS = "boards/corners.csv"
SWEEPS = ("hdl32e_pair/sweep_a.laz", "hdl32e_pair/sweep_b.laz", "hdl32e_pair/a_to_b.txt")


def boards_at_hand():
    """Whether the board clouds and corners are there."""
    return samples.has_real(CORNERS)


def sweeps_at_hand():
    """Whether the two sweeps and their pose are there."""
    return all(samples.has_real(name) for name in SWEEPS)


def board_sizes():
    """Measure every board cloud by its outline.

    Returns
    -------
    DataFrame
        ``sensor``, ``pose``, ``n`` (points), ``long_m``, ``short_m``, their deviations from the
        board in ``long_error_mm`` and ``short_error_mm``, ``sigma_long_mm``, and the same errors
        of the data set's own lidar corners (``authors_long_error_mm``, ...).
    """
    rows = []
    for (sensor, pose), corners in _corners("lidar").items():
        outline = _outline(sensor, pose)
        own = 1000 * (outline.size - BOARD_M)
        authors = 1000 * (_sides(corners) - BOARD_M)
        rows.append(
            {
                "sensor": sensor,
                "pose": pose,
                "n": outline.plane.n,
                "long_m": outline.size[0],
                "short_m": outline.size[1],
                "long_error_mm": own[0],
                "short_error_mm": own[1],
                "sigma_long_mm": 1000 * outline.sigma[0],
                "authors_long_error_mm": authors[0],
                "authors_short_error_mm": authors[1],
            }
        )
    return pd.DataFrame(rows)


def board_edges(*, weight=10.0):
    """Compare board edges from the lidar with those of the camera, after one rigid fit of all.

    The boards' centres give a first rigid motion, which tells which corner is which; all corners
    give the final one (Kabsch). Every pose then has four edges in either frame. Poses whose camera
    corners coincide are left out and counted.

    Returns
    -------
    DataFrame
        A row for each ``pose`` and ``method`` (ours, authors): ``lhd_m``, ``perpendicular_m``,
        ``corner_rms_mm``. ``attrs["left_out"]``: poses without usable camera corners.
    """
    camera, lidar = _corners("camera"), _corners("lidar")
    usable = [key for key, corners in camera.items() if _sides(corners).min() > 0.1]
    ours = {key: _outline(*key).corners for key in usable}
    rows = []
    for method, measured in (("ours", ours), ("authors", lidar)):
        fixed = np.array([measured[key] for key in usable])
        moving = np.array([camera[key] for key in usable])
        rough = _fitted(moving, moving.mean(axis=1), fixed.mean(axis=1))
        order = [_order(a, b) for a, b in zip(rough, fixed, strict=True)]
        moving = np.take_along_axis(moving, np.array(order)[..., None], axis=1)
        turned = _fitted(moving, moving.reshape(-1, 3), fixed.reshape(-1, 3))
        for key, corners in zip(usable, turned, strict=True):
            rows.append({"sensor": key[0], "pose": key[1], "method": method})
            rows[-1] |= _edge_row(measured[key], corners, weight)
    table = pd.DataFrame(rows)
    table.attrs["left_out"] = len(camera) - len(usable)
    return table


def sweep_pair(*, tolerance=0.06, size=3.0, minimum=150):
    """Edges of two overlapping sweeps compared before and after the known pose is applied.

    Returns
    -------
    DataFrame
        A row for each ``frame`` (as scanned, pose applied) and matcher: ``n_test``, ``n_model``,
        ``pairs``, ``lhd_m``, ``perpendicular_m``, ``east_m``, ``north_m``, ``up_m`` of the
        displacement, ``sigma_m``.
    """
    first, second, pose = (samples.real_path(name) for name in SWEEPS)
    sizes = {"tolerance": tolerance, "size": size, "minimum": minimum}
    test, model = (
        extract_edges(read_cloud(path, columns=()).points, **sizes).segments
        for path in (first, second)
    )
    matrix = np.loadtxt(pose)
    rows = []
    # the pose takes coordinates of the second sweep into the frame of the first
    for frame, moved in (
        ("as scanned", model),
        ("pose applied", model.transformed(matrix[:3, :3], matrix[:3, 3])),
    ):
        for matcher in ("all", "displaced"):
            result = lines.lhd(test, moved, matcher=matcher)
            east, north, up = result.displacement.vector
            rows.append(
                {
                    "frame": frame,
                    "matcher": matcher,
                    "n_test": len(test),
                    "n_model": len(moved),
                    "pairs": result.test_model.n,
                    "lhd_m": result.value,
                    "perpendicular_m": result.perpendicular_only,
                    "east_m": east,
                    "north_m": north,
                    "up_m": up,
                    "sigma_m": np.sqrt(np.trace(result.displacement.covariance)),
                }
            )
    table = pd.DataFrame(rows)
    table.attrs["test"], table.attrs["model"] = test, moved
    return table


def _corners(source):
    """Corners (4, 3) of each (sensor, pose) by one source."""
    table = pd.read_csv(samples.real_path(CORNERS)).query("source == @source")
    groups = table.sort_values("corner").groupby(["sensor", "pose"])
    return {key: group[["x_m", "y_m", "z_m"]].to_numpy() for key, group in groups}


def _outline(sensor, pose):
    """The outline of one board cloud."""
    cloud = read_cloud(samples.real_path(f"boards/{sensor}_pose{pose:02d}.laz"))
    return fit_outline(cloud.points, lines=cloud["ring"])


def _sides(corners):
    """Mean length of the longer and of the shorter pair of sides, m."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return np.sort([lengths[::2].mean(), lengths[1::2].mean()])[::-1]


def _order(corners, like):
    """The order of corners, forwards or backwards from any of them, that fits others best."""
    turns = [np.roll(order, k) for order in (np.arange(4), np.arange(4)[::-1]) for k in range(4)]
    return min(turns, key=lambda turn: np.linalg.norm(corners[turn] - like))


def _fitted(points, moving, fixed):
    """Points (..., 3) after the rigid motion that takes ``moving`` nearest to ``fixed``."""
    centres = moving.mean(axis=0), fixed.mean(axis=0)
    turn, _ = Rotation.align_vectors(fixed - centres[1], moving - centres[0])
    return (points - centres[0]) @ turn.as_matrix().T + centres[1]


def _edge_row(corners, other, weight):
    """The distance of two boards' edges and of their corners."""
    test, model = (np.stack([c, np.roll(c, -1, axis=0)], axis=1) for c in (corners, other))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # four edges: no jump to find, and few pairs by nature
        result = lines.lhd(test, model, weight=weight)
    return {
        "lhd_m": result.value,
        "perpendicular_m": result.perpendicular_only,
        "corner_rms_mm": 1000 * np.sqrt(((corners - other) ** 2).sum(axis=1).mean()),
    }
