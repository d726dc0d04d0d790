"""Steps, cells, groups, paths and units of coordinates: plain loops, and limits from both sides."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pyproj
import pytest

from mmqa_lab import cloud
from mmqa_lab.cloud import (
    Cloud,
    cells_of,
    describe,
    group_axes,
    path_distance,
    sort_into_cells,
    step_of,
    unit_remarks,
)


@pytest.mark.parametrize("step", [0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 5e-4, 2e-4, 1e-4])
def test_the_step_of_coordinates_is_the_coarsest_that_fits(step, rng):
    points = np.round(rng.integers(0, 4000, (200, 3)) * step + [4e5, 5e6, 100], 6)
    assert step_of(points) == pytest.approx(step, rel=1e-9)
    off = points.copy()
    off[140, 1] += 0.3 * step
    finer = step_of(off)
    assert not finer >= step  # a finer one, or none
    assert np.isnan(step_of(points[:10]))
    assert step_of(points[:11]) == pytest.approx(step) or step_of(points[:11]) > step
    assert np.isnan(step_of(np.full((20, 3), 7.0)))
    assert np.isnan(step_of(np.where(points == points[3, 1], np.nan, points)))
    many = np.tile(points, (11, 1))  # of more than two thousand a part is looked at
    assert step_of(many) == pytest.approx(step)


def test_no_step_fits_coordinates_of_finer_ones(rng):
    points = rng.integers(0, 4000, (200, 3)) * 3e-5
    assert np.isnan(step_of(points))
    near = rng.integers(0, 40, (200, 3)) * 0.01
    for off, fits in ((0.9e-6, True), (1.1e-6, False)):  # a ten-thousandth of a step
        moved = near.copy()
        moved[100, 0] += off
        assert (step_of(moved) == pytest.approx(0.01)) == fits


@pytest.mark.parametrize("columns", [2, 3])
def test_points_are_sorted_into_cells_as_by_a_loop(columns, rng):
    points = rng.uniform(-3, 3, (300, columns))
    points[:40] = np.round(points[:40] / 0.7) * 0.7  # on borders
    order, starts, places = sort_into_cells(points, 0.7)
    cells = np.floor(points / 0.7 + 1e-6).astype(int)
    assert np.array_equal(cells_of(points, 0.7), cells)
    found = {}
    for row, place in enumerate(map(tuple, cells)):
        found.setdefault(place, []).append(row)
    assert [*map(tuple, places)] == sorted(found)
    for k, place in enumerate(map(tuple, places)):
        assert order[starts[k] : starts[k + 1]].tolist() == found[place]
    for below, cell in ((0.9e-6, 5), (1.1e-6, 4)):
        assert cells_of([[0.7 * (5 - below)]], 0.7) == cell
    with pytest.raises(ValueError, match="too wide for cells of 1"):
        sort_into_cells(np.array([[0.0, 0, 0], [2.0e6, 2e6, 2e6]]), 1.0)
    assert len(sort_into_cells(np.array([[0.0, 0, 0], [1.6e6, 1.6e6, 1.6e6]]), 1.0)[2]) == 2


def test_groups_lie_about_their_centres_as_numpy_says(rng):
    points, starts = rng.normal(size=(40, 3)) * [3, 1, 0.1] + [5, 6, 7], np.array([0, 3, 20])
    counts, off, centres, variances, axes = group_axes(points, starts)
    assert counts.tolist() == [3, 17, 20]
    for k, (low, high) in enumerate(((0, 3), (3, 20), (20, 40))):
        own = points[low:high]
        assert centres[k] == pytest.approx(own.mean(axis=0))
        assert off[low:high] == pytest.approx(own - own.mean(axis=0))
        spread = np.cov(own.T, ddof=0)
        assert variances[k] == pytest.approx(np.linalg.eigvalsh(spread), abs=1e-12)
        assert axes[k].T @ spread @ axes[k] == pytest.approx(np.diag(variances[k]), abs=1e-9)
    assert (variances >= 0).all()


def test_distances_from_a_path_are_those_of_its_nearest_stretch(rng):
    path, points = rng.uniform(-9, 9, (7, 2)) + 5e6, rng.uniform(-12, 12, (50, 3)) + 5e6
    expected = np.full(50, np.inf)
    for a, b in pairwise(path):
        share = np.clip((points[:, :2] - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        away = np.hypot(*(points[:, :2] - a - share[:, None] * (b - a)).T)
        expected = np.minimum(expected, away)
    assert path_distance(points, path) == pytest.approx(expected, abs=1e-8)
    table = pd.DataFrame(path, columns=["easting_m", "northing_m"]).assign(height_m=3.0)
    assert path_distance(points, table) == pytest.approx(expected, abs=1e-8)


def test_a_neighbour_lies_within_a_metre_and_a_half_of_a_thinned_cloud_farther():
    seed = np.zeros(3)
    reach = cloud.FARTHEST_NEIGHBOUR_M
    for away, share, near in ((0.99, 1, True), (1.01, 1, False), (1.99, 0.25, True),
                              (2.01, 0.25, False)):  # fmt: skip
        for way in (np.eye(3)[0], np.eye(3)[1], np.array([0.6, 0, 0.8]), -np.eye(3)[2]):
            points = np.vstack([seed, reach * away * way])
            assert cloud._has_neighbour(points, seed, share) == near
    assert not cloud._has_neighbour(np.zeros((3, 3)), seed, 1.0)  # in its own place


def grid(n, gap):
    """Points of an upright plane, so far apart."""
    x, z = (one.ravel() for one in np.meshgrid(np.arange(n), np.arange(n)))
    return np.column_stack([x * gap + 0.123, 0.4 + 0 * x, z * gap + 0.456])


def test_units_are_doubted_from_their_limits():
    alone, whole = "no neighbour within 1.5 m", "whole numbers"
    assert unit_remarks(grid(9, 1.4)) == []
    assert alone in unit_remarks(grid(9, 1.6))[0]
    assert unit_remarks(grid(9, 2.9), share=0.25) == []
    assert alone in unit_remarks(grid(9, 3.1), share=0.25)[0]
    assert whole in unit_remarks(np.round(grid(9, 2.0)))[0]
    assert unit_remarks(np.round(grid(9, 2.0)) * [0, 0, 1]) == []  # of no width
    assert unit_remarks(grid(7, 1.6)) == []  # 49 points are too few
    points, limit = grid(9, 1.0), cloud.LONGEST_EDGE_M
    for length, told in ((0.99 * limit, False), (1.01 * limit, True)):
        assert bool(unit_remarks(points, lengths=np.full(9, length))) == told
    wide = np.sqrt(10_000 / cloud.CROWDED)  # of ten thousand points
    rng = np.random.default_rng(1)
    for share, told in ((0.97, True), (1.03, False)):
        there = rng.random((10_000, 3)) * [share * wide, share * wide / 2, 1]
        there[:2, 0] = 0, share * wide
        assert ("degrees" in " ".join(unit_remarks(there))) == told
        low = there * [1, 1, 0.9 * share * wide]
        assert "degrees" not in " ".join(unit_remarks(low))  # not higher than wide
        assert "degrees" not in " ".join(unit_remarks(there + [181, 0, 0]))
    assert unit_remarks(grid(9, 9), crs=pyproj.CRS(4326)) == []


def test_what_a_cloud_contains_is_told_axis_by_axis():
    points = np.array([[1.0, 20, 300], [2, 25, 310], [4, 21, 305]])
    columns = {"gps_time": [5.0, 9, 8], "ring": [1, 1, 1], "colour": np.zeros((3, 3))}
    found = describe(Cloud(points, columns))
    ends = [found[f"{axis}_{end}_m"] for axis in "xyz" for end in ("low", "high")]
    assert ends == [1, 4, 20, 25, 300, 310]
    assert (found["points"], found["unit"], found["crs"], found["time_span_s"]) == (3, "m", "", 4)
    assert found["columns"] == "gps_time (3), colour (3)"
    feet = describe(Cloud(points, crs=pyproj.CRS("EPSG:2263+6360")))
    assert feet["unit"] == "US survey foot"
    assert (feet["x_low"], feet["z_high"]) == (1, 310)
    assert "Other commands refuse it" in feet["remarks"]
    mixed = describe(Cloud(points, crs=pyproj.CRS("EPSG:25832+6360")))
    assert mixed["unit"] == "m, US survey foot"
    assert (mixed["x_low_m"], mixed["z_high"]) == (1, 310)
    steps = describe(Cloud(np.arange(60).reshape(20, 3) * 0.05, resolution=0.001))
    assert steps["resolution_mm"] == pytest.approx(50)
    stored = describe(Cloud(np.arange(60).reshape(20, 3) * 0.05, resolution=0.2))
    assert stored["resolution_mm"] == pytest.approx(200)
    assert "No coordinate system: taken for metres." in steps["remarks"]
