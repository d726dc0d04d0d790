"""The compiled steps of the search for planes, run as plain Python, beside numpy."""

from itertools import pairwise

import numpy as np
import pytest

from mmqa_lab.plane_search import detect_planes, detection, growth, usual_size

PLANE = np.array([[1.0, -2.0, 0.5], [2 / 3, -1 / 3, 2 / 3]])


@pytest.fixture(autouse=True)
def _plain(uncompiled):
    uncompiled(growth, detection)


def board(rng, n, sigma=0.0):
    """Points on a slanted board of 2 m x 2 m, its normal, and their distances from it."""
    normal = PLANE[1]
    axes = np.linalg.svd(normal[None])[2][1:]
    off = sigma * rng.standard_normal(n)
    return rng.uniform(0, 2, (n, 2)) @ axes + off[:, None] * normal + [3, 4, 5], normal, off


def test_distances_moments_and_the_fitted_plane_are_those_of_numpy(rng):
    points, plane, moments = rng.normal(size=(40, 3)) + [1, -2, 1], PLANE.copy(), np.zeros((4, 4))
    for p in range(40):
        assert growth._off(points, p, plane) == pytest.approx((points[p] - plane[0]) @ plane[1])
        growth._add(moments, points, p, plane)
    local = np.column_stack([np.ones(40), points - PLANE[0]])
    assert moments == pytest.approx(local.T @ local)
    found = growth._fit(moments, plane)
    values, vectors = np.linalg.eigh(np.cov(points.T, ddof=0) * 40)
    assert found == pytest.approx(values)
    assert plane[0] == pytest.approx(points.mean(axis=0))
    assert abs(plane[1] @ vectors[:, 0]) == pytest.approx(1)


def test_points_around_a_cell_are_drawn_evenly_and_the_nearest_are_kept(rng):
    points = rng.random((300, 3))
    start = np.array([0, 100, 101, 300])
    owner, counts = np.full(300, -1), np.array([60, 1, 199])
    owner[40:80] = 7  # of the first cell 60 points are free
    local, far = np.zeros((3, 375)), np.zeros(375)
    near = np.array([[0, 2], [2, 3]])
    n = growth._drawn((points, start, None), owner, counts, near, 0, local, far)
    free = [np.flatnonzero(owner[a:b] < 0) + a for a, b in pairwise(start)]
    chosen = np.concatenate([one[:: -(-len(one) // growth.DRAWN)] for one in free])
    assert n == len(chosen) <= 3 * growth.DRAWN
    assert np.array_equal(local[:, :n].T, points[chosen])
    many = np.column_stack([np.arange(0, 4, 0.02), np.zeros(200), np.zeros(200)])
    each = np.arange(201)
    owner[:] = -1
    n = growth._drawn((many, each, None), owner, np.ones(200, int), [[0, 200]], 0, local, far)
    assert n == growth.NEAREST
    assert np.array_equal(local[0, :n], many[: growth.NEAREST, 0])


def test_a_trial_finds_the_plane_and_its_score_is_its_points_less_their_misfit(rng):
    points, normal, _ = board(rng, 60, sigma=0.002)
    points = points / 4
    points[50:] += 0.5 * normal  # a tenth lies beside
    cells = points, np.array([0, 20, 40, 60]), None
    counts, owner = np.array([20, 20, 20]), np.full(60, -1)
    planes, scores = np.zeros((1, 2, 3)), np.zeros(1)
    trials, near = rng.random((32, 3)), np.array([[[0, 3]]])
    growth.try_planes(0, 1, cells, owner, counts, [0], near, trials, 0.01, 0.1, planes, scores)
    assert abs(planes[0, 1] @ normal) > 0.999
    room, far = np.zeros((3, 375)), np.zeros(375)
    n = growth._drawn(cells, owner, counts, near[0], 0, room, far)
    mine = room[:, :n].T
    mine = mine[np.abs((mine - mine.mean(axis=0)) @ normal) < 0.2]
    least = np.linalg.eigvalsh(np.cov(mine.T, ddof=0) * len(mine))[0]
    assert scores[0] == pytest.approx(len(mine) - least / (0.01**2 / 3), abs=1e-6)


def grid_of(points, edge=0.5):
    """Cells of a grid as the growth takes them."""
    grid = growth.Grid(points, edge)
    return grid, (grid.points, grid.start, grid.near(np.arange(len(grid.keys)), 1))


def test_a_plane_grows_over_connected_cells_alone(rng):
    points, normal, _ = board(rng, 800)
    other = points[:200] + [20, 0, 0]
    beside = points[:40] + 0.02 * normal
    grid, cells = grid_of(np.concatenate([points, other, beside]))
    owner = np.full(len(grid.points), -1)
    marks, seen = np.zeros((2, len(grid.keys)), dtype=np.int64)
    plane, moments = np.stack([points.mean(axis=0) - grid.low, normal]), np.zeros((4, 4))
    rows = grid.order
    seed = int(np.searchsorted(grid.start, np.flatnonzero(rows == 0)[0], side="right") - 1)
    n, taken, off = growth._spread(cells, owner, seed, plane, 0.01, 1, marks, seen, moments)
    assert moments[0, 0] == 800
    assert n >= taken >= 16
    assert off == 40
    planes, limits = plane[None].copy(), (0.01, 20)
    done, around = growth.grow(cells, owner, 5, [seed], planes, limits, 0, 0 * marks, seen)
    assert (done, around > 0) == (1, True)
    assert np.array_equal(np.sort(rows[owner == 5]), np.arange(800))


def test_points_belong_to_the_nearest_plane_and_the_clear_ones_to_one_alone(rng):
    flat = rng.uniform(0, 4, (1200, 3))
    floor, wall = flat[:600] * [1, 1, 0], flat[600:] * [1, 0, 1]
    points = np.concatenate([floor, wall])
    grid, cells = grid_of(points)
    planes = np.array([[[2, 2, 0.004], [0, 0, 1]], [[2, 0.004, 2], [0, 1, 0]]], dtype=float)
    everywhere = np.arange(len(grid.keys))
    around, bounds = np.tile(everywhere, 2), np.array([0, len(everywhere), 2 * len(everywhere)])
    owner, height = np.full(1200, -1), np.full(1200, 0.05)
    clear = np.full(1200, True)
    shifted = planes.copy()
    growth.assign(cells, around, bounds, shifted, 0.05, owner, height, clear)
    local = grid.points
    off = np.stack([local[:, 2] - 0.004, local[:, 1] - 0.004])
    nearest = np.abs(off).argmin(axis=0)
    assert np.array_equal(owner, np.where(np.abs(off).min(axis=0) <= 0.05, nearest, -1))
    assert height == pytest.approx(off[owner, np.arange(1200)])
    # the foot on the own plane, seen from the other one, which stands upright on it
    assert np.array_equal(clear, np.abs(off[1 - owner, np.arange(1200)]) > 0.05)
    assert np.abs(shifted[:, 1]) == pytest.approx(planes[:, 1], abs=1e-9)
    assert shifted[0, 0, 2] == pytest.approx(0, abs=1e-9)


def test_cells_nearby_are_those_of_a_loop_over_all_pairs(rng):
    grid = growth.Grid(rng.uniform(0, 3, (150, 3)), 0.5)
    for reach in (1, 2):
        runs = grid.near(np.arange(len(grid.keys)), reach)
        for cell, own in enumerate(runs):
            found = np.concatenate([np.arange(*run) for run in own])
            apart = np.abs(grid.places - grid.places[cell]).max(axis=1)
            assert np.array_equal(np.sort(found), np.flatnonzero(apart <= reach))


def test_the_mean_of_a_cell_counts_the_empty_ones():
    rng = np.random.default_rng(2)
    for mean in (0.7, 1.5, 2.4, 6.0):
        counts = rng.poisson(mean, 40_000)
        starts = np.cumsum([0, *counts[counts > 0]])
        found = detection._points_per_cell(starts)
        assert found == pytest.approx(mean, abs=0.06 if mean < 3 else 0.5)


def test_the_usual_size_follows_the_spacing_of_a_surface():
    rng = np.random.default_rng(3)
    sizes = []
    for density in (1000, 300, 100, 1):
        xy = rng.uniform(0, 12, (density * 144, 2))
        sizes.append(usual_size(np.insert(xy, 2, 0, axis=1)))
    small, usual, largest = detection.USUAL_SIZES
    expected = small * np.sqrt(3.2 / (np.array([1000, 300, 100, 1]) * (small / 4) ** 2))
    assert sizes == pytest.approx(np.clip(expected, small, largest), rel=0.05)
    assert usual_size(np.zeros((0, 3))) == usual


def test_a_noisy_wall_has_its_plane_and_a_filled_volume_has_none(rng):
    points, normal, off = board(rng, 1500, sigma=0.006)
    (part,) = detect_planes(points, tolerance=0.05, size=1.0)
    assert abs(part.plane.normal @ normal) > 0.9999
    assert part.sigma == pytest.approx(off.std(), rel=0.1)
    assert detect_planes(rng.uniform(0, 1, (1500, 3)), tolerance=0.05, size=1.0) == []
