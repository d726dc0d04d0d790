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


def test_trials_are_those_of_plain_vectors(rng):
    """Three seeds, one of them with too few points, one without three points of a plane."""
    parts = [rng.uniform(0, 1, (120, 3)) * [1, 1, 0.15], rng.uniform(5, 6, (5, 3)),
             rng.normal(9, 3, (60, 3))]  # fmt: skip
    points, start = np.concatenate(parts), np.r_[np.arange(0, 120, 4), np.arange(120, 186, 5)]
    owner, counts = np.full(185, -1), np.diff(start)
    cells, seeds = (points, start, None), np.array([0, 30, 31])
    near = np.array([[[0, 30]], [[30, 31]], [[31, 43]]])
    trials, tolerance, edge = rng.random((40, 3)), 0.03, 0.4
    planes, scores = np.zeros((3, 2, 3)), np.zeros(3)
    growth.try_planes(
        0, 3, cells, owner, counts, seeds, near, trials, tolerance, edge, planes, scores
    )
    room, far, known = np.zeros((3, 375)), np.zeros(375), 0
    for s in range(3):
        n = growth._drawn(cells, owner, counts, near[s], seeds[s], room, far)
        local, best = room[:, :n].T.copy(), []
        for a, b, c in (trials * n).astype(int) if n >= 6 else ():
            cross = np.cross(local[b] - local[a], local[c] - local[a])
            if np.linalg.norm(cross) > edge**2 / 2:  # twice the area of the triangle
                off = (local - local[a]) @ cross / np.linalg.norm(cross)
                inside = np.abs(off) <= tolerance
                best = inside if np.sum(inside) > np.sum(best) else best
        if np.sum(best) < 6:
            assert scores[s] == 0
            continue
        known += 1
        taken = local[best]
        values, vectors = np.linalg.eigh(np.cov(taken.T, ddof=0) * len(taken))
        assert scores[s] == pytest.approx(len(taken) - values[0] * 3 / tolerance**2)
        assert planes[s, 0] == pytest.approx(taken.mean(axis=0))
        assert abs(planes[s, 1] @ vectors[:, 0]) == pytest.approx(1)
    assert known == 1


def test_cells_spread_as_by_sets(rng):
    points = rng.uniform(0, 4, (1500, 3)) * [1, 1, 0.25]
    points[:700, 2] = 0.5 + 0.02 * rng.normal(size=700)
    points = points[~((np.abs(points[:, 0] - 2) < 0.6) & (points[:, 1] < 3))]  # nearly two parts
    grid, cells = grid_of(points)
    owner = np.where(rng.random(len(grid.points)) < 0.1, 3, -1)
    plane = np.array([[1.0, 1, 0.5 - grid.low[2]], [0.02, 0, 1]])
    plane[1] /= np.linalg.norm(plane[1])
    off = np.abs((grid.points - plane[0]) @ plane[1])
    cell = np.repeat(np.arange(len(grid.keys)), np.diff(grid.start))
    on = np.bincount(cell[(owner < 0) & (off <= 0.03)], minlength=len(grid.keys))
    wide = np.bincount(cell[(owner < 0) & (off <= 0.09)], minlength=len(grid.keys))
    good = (on > 0) & (on >= np.diff(grid.start) / 4)
    seed = int(np.argmax(on))
    reach, seen_cells, taken_cells = [seed], {seed}, set()
    while reach:
        one = reach.pop()
        if good[one]:
            taken_cells.add(one)
            around = np.abs(grid.places - grid.places[one]).max(axis=1) <= 1
            new = set(np.flatnonzero(around)) - seen_cells
            reach += new
            seen_cells |= new
    marks, seen = np.zeros((2, len(grid.keys)), dtype=np.int64)
    moments = np.ones((4, 4))
    n, taken, beside = growth._spread(cells, owner, seed, plane, 0.03, 9, marks, seen, moments)
    assert set(seen[:n]) == seen_cells
    assert n == len(seen_cells)
    assert taken == len(taken_cells) > 20
    assert set(np.flatnonzero(marks == 10)) == taken_cells
    assert set(np.flatnonzero(marks == 9)) == seen_cells - taken_cells
    of_seen = sum(wide[one] for one in seen_cells) - sum(on[one] for one in taken_cells)
    assert beside == of_seen
    own = np.isin(cell, [*taken_cells]) & (owner < 0) & (off <= 0.03)
    local = np.column_stack([np.ones(own.sum()), grid.points[own] - plane[0]])
    assert moments == pytest.approx(local.T @ local)
    assert not good[[*seen_cells]].all()


def test_the_height_of_a_plane_is_as_sure_as_a_regression_says(rng):
    points = np.column_stack([rng.uniform(-2, 2, (2, 300)).T * [2, 1], 0.01 * rng.normal(size=300)])
    plane, moments, sigma = detection._trimmed(points, np.zeros(3), np.array([0, 0, 1.0]), 0.05)
    part = detection.PlanePart(plane, np.arange(300), np.arange(300), moments, sigma)
    assert sigma == pytest.approx(0.01, rel=0.1)
    core = points[np.abs(plane.distances(points)) <= np.abs(plane.residuals).max() + 1e-12]
    assert len(core) == plane.n
    assert sigma == pytest.approx(
        detection.TRIMMED * np.sqrt((plane.residuals**2).sum() / (plane.n - 3))
    )
    rows = np.column_stack([np.ones(plane.n), core[:, :2]])
    inverse = np.linalg.inv(rows.T @ rows)
    for place in ([0.0, 0, 0], [3.0, 1, 0], [-4.0, 2, 0]):
        at = np.array([1, *place[:2]])
        expected = (detection.TRIMMED * sigma) ** 2 * (at @ inverse @ at)
        assert part.offset_variance(np.array(place)) == pytest.approx(expected, rel=1e-3)
    # far points are trimmed by 2.5 sigma_MAD, those of reveals on one side, too
    points[:20, 2] += 0.045
    plane, _, sigma = detection._trimmed(points, np.zeros(3), np.array([0, 0, 1.0]), 0.05)
    off, away = points[:, 2], points[:, 2]
    for _ in range(2):
        most = 2.5 * 1.482602218505602 * np.median(np.abs(away - np.median(away)))
        core = points[np.abs(off - np.median(away)) <= most]
        middle = core.mean(axis=0)
        normal = np.linalg.eigh(np.cov(core.T))[1][:, 0]
        normal *= np.sign(normal[2])
        off, away = (points - middle) @ normal, (core - middle) @ normal
    assert plane.n == len(core)
    assert plane.centre == pytest.approx(middle)
    assert sigma == pytest.approx(1.05 * np.sqrt((away**2).sum() / (len(core) - 3)))
    exact = points * [1, 1, 0]
    exact[:9, 2], exact[9:18, 2] = 0.0024, 0.0026  # within and beyond a fiftieth of 5 cm, 2.5 times
    assert detection._trimmed(exact, np.zeros(3), np.array([0, 0, 1.0]), 0.05)[0].n == 291


def test_the_usual_size_of_scan_lines_far_apart_is_larger():
    along = np.arange(0, 12, 0.02)
    for gap, size in ((0.8, 1), (0.1, 0)):
        x, y = (one.ravel() for one in np.meshgrid(along, np.arange(0.07, 12, gap)))
        assert usual_size(np.column_stack([x, y, 0 * x])) == detection.USUAL_SIZES[size]
