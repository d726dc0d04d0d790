"""Whatever takes points takes a cloud, an array, a table and a file, and says the same of each."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from mmqa_lab import (
    chart_cloud,
    io,
    lines,
    maps,
    planes,
    plots,
    poles,
    repeatability,
    scan_pattern,
    spacing,
    testfield,
    views,
)
from mmqa_lab.cloud import Cloud

POLES = pd.DataFrame({"x_m": [1.0], "y_m": 1.0, "z_m": 0.0, "diameter_m": 0.2})
CORNER = pd.DataFrame({"x_m": [0.0], "y_m": 0.0, "z_m": 0.0, "kind": "building"})
SQUARE = np.array([[0.2, 0.2, 0.0], [2.2, 0.2, 0.0], [2.2, 2.2, 0.0], [0.2, 2.2, 0.0]])


def scene():
    """A floor, two walls that meet, a post, in whole millimetres; few enough to be quick."""
    rng = np.random.default_rng(4)
    flat = rng.uniform(0, 3, (1000, 3))
    turn, height = np.meshgrid(np.arange(0, 6.2, 0.2), np.arange(0, 3, 0.1))
    post = np.stack([1 + 0.1 * np.cos(turn), 1 + 0.1 * np.sin(turn), height], axis=-1)
    parts = [flat * [1, 1, 0], flat * [1, 0, 1], flat * [0, 1, 1], post.reshape(-1, 3)]
    return np.round(np.concatenate(parts), 3)


SCENE = scene()
FLOOR = np.round(np.random.default_rng(5).uniform(0, 3, (600, 3)) * [1, 1, 0.002], 3)
TILTED = np.round(FLOOR @ [[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]], 3)
REFERENCE = np.array([[1.5, 1.5, 0.0], [2.0, 0.5, 0.0]])
TIME = np.linspace(0, 0.05, len(FLOOR))
CORNERS_TIME = np.linspace(0, 0.05, len(SCENE))

CALLS = {
    "evaluate_cloud": (TILTED, chart_cloud.evaluate_cloud),
    "inside_polygon": (FLOOR, lambda p: chart_cloud.inside_polygon(p, SQUARE)),
    "fit_plane": (TILTED, planes.fit_plane),
    "fit_line": (FLOOR, lambda p: planes.fit_line(np.asarray(p)[:, :2] if is_bare(p) else p)),
    "project": (TILTED, lambda p: planes.fit_plane(p).project(p)),
    "distances": (TILTED, lambda p: planes.fit_plane(p).distances(p)),
    "flat_points": (TILTED, planes.flat_points),
    "quadrant_distances": (TILTED, spacing.quadrant_distances),
    "quadrants": (TILTED, spacing.quadrants),
    "directional": (TILTED, spacing.directional),
    "turned_f": (TILTED, lambda p: spacing.turned_f(p, angles=[0, 20])),
    "detect_planes": (SCENE, planes.detect_planes),
    "extract_edges": (SCENE, lines.extract_edges),
    "measure_pattern": (FLOOR, lambda p: scan_pattern.measure_pattern(p, scan_line=LINES)),
    "fit_scan_planes": (
        SCENE,
        lambda p: scan_pattern.fit_scan_planes(p, CORNERS_TIME, mirror_frequency_hz=100),
    ),
    "poles.detect": (SCENE, lambda p: poles.detect(p, method="itc")),
    "thinned": (SCENE, lambda p: testfield.thinned(p, 0.5)),
    "plan_differences": (SCENE, lambda p: testfield.plan_differences(p, POLES)),
    "corners": (SCENE, lambda p: testfield.plan_differences(p, CORNER)),
    "height_differences": (FLOOR, lambda p: testfield.height_differences(p, REFERENCE)),
    "distance_to_path": (SCENE, lambda p: testfield.distance_to_path(p, REFERENCE)),
    "evaluate_selections": (FLOOR, lambda p: repeatability.evaluate_selections(p, [SQUARE])),
    "map_cloud": (FLOOR, lambda p: maps.map_cloud(p, cell=1.0)["d4"].values),
    "draw_points": (TILTED, lambda p: drawn(p)),
}

LINES = np.arange(len(FLOOR)) // 50


def is_bare(points):
    """Whether points are an array of numbers alone."""
    return isinstance(points, np.ndarray)


def drawn(points):
    """Where a plot puts the points."""
    figure, ax = plots.subplots()
    plots.draw_points(points, ax=ax)
    offsets = ax.collections[0].get_offsets()
    plots.plt.close(figure)
    return np.asarray(offsets)


def plain(result):
    """A result as nested lists of numbers, to be compared."""
    if dataclasses.is_dataclass(result):
        return [plain(getattr(result, field.name)) for field in dataclasses.fields(result)]
    if isinstance(result, pd.DataFrame):
        return [result.columns.tolist(), *(plain(result[c].to_numpy()) for c in result)]
    if isinstance(result, dict):
        return [list(result), *(plain(value) for value in result.values())]
    if isinstance(result, list | tuple):
        return [plain(value) for value in result]
    return result.tolist() if hasattr(result, "tolist") else result


@pytest.mark.parametrize("name", CALLS)
def test_clouds_arrays_tables_and_files_give_the_same(name, tmp_path):
    points, call = CALLS[name]
    path = str(tmp_path / "c.laz")
    io.write_cloud(path, points)
    cloud = io.read_cloud(path)
    table = pd.DataFrame(cloud.points, columns=["Easting", "Northing", "Height"])
    table.insert(0, "id", np.arange(len(points)))
    expected = plain(call(np.array(cloud)))
    for kind in (cloud, table, cloud.to_frame(), path):
        np.testing.assert_equal(plain(call(kind)), expected)


def test_views_take_clouds_and_tables(monkeypatch):
    monkeypatch.setattr(views, "can_render", lambda: False)
    for kind in (FLOOR, Cloud(FLOOR), Cloud(FLOOR).to_frame()):
        assert views.show_cloud(kind, FLOOR[:, 2], label="height (m)").axes


def test_heights_are_taken_as_points_rasters_arrays_and_files(tmp_path):
    x, y = np.arange(0.5, 3), np.arange(2.5, 0, -1)
    heights = xr.DataArray(np.zeros((3, 3)), {"y": y, "x": x}, ("y", "x"))
    points = np.stack([*(v.ravel() for v in np.meshgrid(x, y)), np.zeros(9)], axis=1)
    pd.DataFrame(points, columns=["x", "y", "z"]).to_csv(tmp_path / "h.csv", index=False)
    np.savez(tmp_path / "h.npz", x=x, y=y, z=heights)
    expected = testfield.height_differences(FLOOR, points)
    for kind in (heights, heights.T, tmp_path / "h.csv", tmp_path / "h.npz", Cloud(points)):
        found = testfield.height_differences(FLOOR, kind)
        pd.testing.assert_frame_equal(found, expected)


def test_a_trajectory_is_a_table_an_array_or_a_cloud():
    table = pd.DataFrame(REFERENCE, columns=["easting_m", "northing_m", "height_m"])
    table.insert(0, "time_s", [0.0, 1.0])
    expected = poles.detect(SCENE, method="itc", trajectory=REFERENCE, corridor=1.2)
    assert len(expected) > 0
    for kind in (table, REFERENCE[:, :2], Cloud(REFERENCE)):
        found = poles.detect(SCENE, method="itc", trajectory=kind, corridor=1.2)
        pd.testing.assert_frame_equal(found, expected)


def test_a_result_shows_itself_as_a_table():
    quality = chart_cloud.evaluate_cloud(FLOOR)
    assert "<th>high</th>" in quality._repr_html_()  # every figure with its interval
    assert f"<td>{quality.f:.4g}</td>" in quality._repr_html_()
