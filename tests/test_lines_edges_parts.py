"""Steps from planes to edges, each against a closed form or plain loops."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from mmqa_lab.lines import edges
from mmqa_lab.plane_search import growth


@pytest.mark.parametrize("n", [1.0, 7.5, 300.0])
def test_one_gap_in_so_many_is_longer_than_the_length_beyond(n):
    """Of an exponential gap in units of its mean from n gaps: a share (1 + x / n)^-n is longer."""
    for draws in (2, 40, 4000):
        assert (1 + edges._beyond(n, draws) / n) ** -n == pytest.approx(1 / draws)


def test_ranges_are_counted_one_after_the_other(rng):
    first = rng.integers(0, 50, 20)
    last = first + rng.integers(0, 4, 20)
    which, found = edges._ranges(first, last)
    assert found.tolist() == [k for a, b in zip(first, last, strict=True) for k in range(a, b)]
    assert which.tolist() == [i for i in range(20) for _ in range(first[i], last[i])]


def reached(side, first, last, cell):
    """Ends of a side by the law of its gaps."""
    near = [s for s in side if first - cell <= s <= last + cell]
    core = [k for k, s in enumerate(near) if first <= s <= last]
    within = [b - a for a, b in pairwise(near) if a >= first and b <= last]
    gap = sum(one**2 for one in within) / (2 * sum(within))
    n = max(sum(within) / (2 * gap), 1)
    most = gap * n * ((40 * (len(near) - 1)) ** (1 / n) - 1)
    a, b = core[0], core[-1]
    a = max([k + 1 for k in range(a) if near[k + 1] - near[k] > most], default=0)
    b = min([k for k in range(b, len(near) - 1) if near[k + 1] - near[k] > most],
            default=len(near) - 1)  # fmt: skip
    spread = gap * (n * (40 ** (1 / n) - 1) - 1) / 1.96
    return (near[a] - gap, spread), (near[b] + gap, spread), b - a + 1


def test_a_side_reaches_a_gap_beyond_its_last_point_and_is_cut_at_gaps_that_are_no_chance(rng):
    cut = 0
    for _ in range(40):
        core = np.cumsum(rng.exponential(0.05, 60)) + 1
        before, behind = 1 - np.cumsum(rng.exponential(0.2, (2, 4)), axis=1)
        side = np.sort(np.concatenate([core, before, core[-1] + 1 - behind]))
        found = edges._reached(side, 1.0, core[-1], 0.5)
        expected = reached(side, 1.0, core[-1], 0.5)
        assert np.hstack(found) == pytest.approx(np.hstack(expected))
        cut += found[2] < np.sum((side >= 0.5) & (side <= core[-1] + 0.5))
    assert 5 < cut < 40
    (low, spread), (high, _), n = edges._reached(np.array([0.2]), 1.0, 2.0, 0.9)
    assert (low, high, n) == pytest.approx((0.2 - 0.9, 0.2 + 0.9, 1))
    assert spread == pytest.approx(0.9 * 38 / 1.96)


def test_bins_are_full_where_points_are_usual_and_reach_the_line(rng):
    stops = np.arange(0, 6.1, 0.5)
    many = rng.choice([0, 2, 9, 14, 20], 12)
    station = np.concatenate([rng.uniform(-1, 0, 5), *(rng.uniform(a, a + 0.5, n) for a, n in zip(
        stops, many, strict=False)), rng.uniform(6.1, 7, 5)])  # fmt: skip
    depth = rng.uniform(0.02, 1.0, len(station)) ** 2 * rng.choice([-1, 1], len(station))
    side, clear = np.array([station, depth, 0 * depth]), 0.03
    found = edges._full(side, stops, 0.5, clear)
    usual = np.median([n for n in many if n])
    apart = np.diff(np.sort(np.abs(depth))).max()
    for k, n in enumerate(many):
        own = (station >= stops[k]) & (station < stops[k] + 0.5)
        away = max(0.125, apart, 4 / (n + 1))
        fair = n >= max(1, usual / 4 - usual**0.5)
        assert found[k] == (fair and np.abs(depth[own]).min() <= clear + away)
    far = side + np.array([[0], [0.3], [0]]) * np.sign(depth)
    assert edges._full(far, stops, 0.5, clear).sum() < found.sum()
    assert not edges._full(side[:, :0], stops, 0.5, clear).any()
    for nearest, reached in ((0.15, True), (0.16, False)):  # of many points a quarter of a bin
        many = np.linspace(0, 0.999, 300), nearest + np.arange(300) % 100 / 100, np.zeros(300)
        assert (
            edges._full(np.array(many), np.array([0, 0.5, 1]), 0.5, clear).tolist() == [reached] * 2
        )


def test_heights_beside_an_edge_count_where_they_are_more_than_chance(rng):
    station, depth = rng.uniform(0, 5, 80), rng.uniform(-1.5, 1.5, 80)
    height = 0.01 * rng.normal(size=80) + np.where(depth > 0, 0.002 * station, 0.004)
    side = np.array([station, depth, height])
    found = edges._misfits(side, 0.5, 4.5, 1.0)
    expected = np.zeros(2)
    for half in (depth > 0, depth < 0):
        own = half & (np.abs(depth) <= 1) & (station >= 0.5) & (station <= 4.5)
        part = (station[own] - 0.5) / 4
        rows = np.column_stack([1 - part, part, depth[own]])
        at, squares, *_ = np.linalg.lstsq(rows, height[own])
        std = np.sqrt(squares[0] / (own.sum() - 3) * np.diag(np.linalg.inv(rows.T @ rows)))
        off = np.abs(at[:2])
        expected = np.maximum(expected, np.where(off > 0.5 * std[:2], off, 0))
    assert found == pytest.approx(expected)
    assert (found > 0).any()
    few = np.array([[1.0, 2, 3, 3.5], [0.1, 0.2, 0.15, 0.3], [0.5, 0.5, 0.5, 0.5]])
    assert edges._misfits(few, 0, 5, 1.0).tolist() == [0, 0]  # four points leave one degree
    more = np.column_stack([few, [4.0, 0.1, 0.5]])
    assert edges._misfits(more, 0, 5, 1.0) == pytest.approx([0.5, 0.5])


def test_edges_run_where_both_sides_have_points():
    """Two faces with a point each 4 cm from 0 to 6 m; one has a window from 2 to 4 m."""
    station = np.arange(0, 6.01, 0.04)
    whole = np.array([station, 0 * station + 0.01, 0 * station])
    window = whole[:, (station < 2) | (station > 4)]
    runs = list(edges._runs([whole, window], 0.4, 0.05))
    ends = np.array([(low[0], high[0]) for low, high, _ in runs])
    assert ends == pytest.approx(np.array([[0, 2], [4, 6]]), abs=0.05)
    for low, high, counts in runs:
        each = [edges._reached(side[0], *stops, 0.4) for side in (whole, window)
                for stops in [(round(low[0] / 0.4) * 0.4, round(high[0] / 0.4) * 0.4)]]  # fmt: skip
        assert len(counts) == len(each) == 2
        assert min(counts) == pytest.approx(50, abs=2)
    assert list(edges._runs([whole, whole[:, :1] + 9], 0.4, 0.05)) == []
    thin = whole[:, ::10]  # a point each 40 cm: bins of four mean gaps
    ((low, high, counts),) = edges._runs([thin, thin], 0.4, 0.05)
    assert (low[0], high[0]) == pytest.approx((0, 6), abs=0.3)
    assert counts == (16, 16)


def planes(normals, places):
    """Lines between planes through some places."""
    found = object.__new__(edges._Lines)
    found.normals, found.centres = np.array(normals), np.array(places)
    found.origin, found.least = np.array([100.0, 200, 300]), np.sin(np.radians(20))
    return found


def test_lines_lie_in_both_planes_and_their_foot_is_next_to_the_first_centre(rng):
    normals = rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals[5] = normals[0] + 0.1 * normals[1]
    normals[5] /= np.linalg.norm(normals[5])
    found = planes(normals, rng.normal(size=(6, 3)))
    pairs = np.array([(a, b) for a in range(6) for b in range(a)])
    found._intersect(pairs)
    angles = np.degrees(np.arccos(np.abs((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1))))
    assert np.array_equal(found.pairs, pairs[angles >= 20])
    assert len(found.pairs) < len(pairs)
    for (a, b), way, foot, sine2 in zip(
        found.pairs, found.direction, found.foot, found.sine2, strict=True
    ):
        assert np.linalg.norm(way) == pytest.approx(1)
        assert sine2 == pytest.approx(1 - (normals[a] @ normals[b]) ** 2)
        rows = np.array([normals[a], normals[b], way])
        start = found.centres[a]
        right = [normals[a] @ start, normals[b] @ found.centres[b], way @ start]
        assert foot == pytest.approx(np.linalg.solve(rows, right))
        assert rows[:2] @ way == pytest.approx([0, 0], abs=1e-12)


def patch(variance, sigma=0.01):
    """A plane with this variance of its height everywhere."""
    return SimpleNamespace(offset_variance=lambda _: variance, sigma=sigma)


def test_an_end_moves_to_a_corner_with_a_third_plane_within_reach():
    slant = np.array([0.6, 0.0, 0.8])
    found = planes([[0, 0, 1], [0, 1, 0], slant], [[0.0, 0, 0], [0, 0, 0], [3, 0, 0]])
    found.near, found.patches = [np.array([1, 2]), np.array([0, 2]), np.array([0, 1])], [
        patch(1e-6), patch(4e-6), patch(9e-6)]  # fmt: skip
    found._intersect(np.array([[0, 1]]))
    x = found.direction[0, 0]
    end = (2.5 * x, 0.2)
    assert found._corner(0, end, 0.4) == end
    station, spread = found._corner(0, end, 0.6)
    assert (station * x, spread) == pytest.approx((3, 0.003 / 0.6))
    found.normals[2] = [0.3, 0.0, np.sqrt(1 - 0.09)]  # too flat: 17 degrees
    assert found._corner(0, end, 9.0) == end


@pytest.mark.parametrize("degrees", [90, 60])
def test_ends_of_an_edge_have_the_covariance_of_both_planes(degrees):
    turn = np.radians(degrees)
    found = planes([[0, 0, 1], [0, np.sin(turn), np.cos(turn)]], np.zeros((2, 3)))
    found.patches, found.tolerance = [patch(1e-6, 0.01), patch(4e-6, 0.02)], 0.05
    found.near = [np.array([1]), np.array([0])]
    found._intersect(np.array([[0, 1]]))
    way = found.direction[0]
    sides = [np.zeros((3, 0))] * 2
    ends, covariance = found.edge(0, (1.0, 0.03), (4.0, 0.05), sides, 2.0)
    assert ends == pytest.approx(found.origin + np.outer([1, 4], way))
    for along, part in zip((0.03, 0.05), covariance, strict=True):
        assert way @ part @ way == pytest.approx(along**2 + 0.02**2)
        for normal, variance in zip(found.normals, (1e-6, 4e-6), strict=True):
            assert normal @ part @ normal == pytest.approx(variance)
        assert found.normals[0] @ part @ found.normals[1] == pytest.approx(0, abs=1e-12)
    # points that lie 5 mm off one plane at the first end add their square
    station = np.tile(np.linspace(1, 4, 21), 3)
    depth = np.repeat([0.2, 0.4, 0.6], 21)
    off = np.array([station, depth, 0.005 * (4 - station) / 3])
    _, (first, last) = found.edge(0, (1.0, 0.03), (4.0, 0.05), [off, sides[0]], 2.0)
    normal = found.normals[0]
    assert normal @ first @ normal == pytest.approx(1e-6 + 25e-6)
    assert normal @ last @ normal == pytest.approx(1e-6)


def test_planes_meet_in_neighbouring_cells_and_their_points_there_lie_beside_the_line(
    rng, uncompiled
):
    """A floor, two walls on it and one elsewhere: by all pairs of cells."""
    uncompiled(growth)
    flat = rng.uniform(0, 4, (4, 300, 3))
    faces = [
        flat[0] * [1, 1, 0],
        flat[1] * [1, 0, 1],
        flat[2] * [0, 1, 1],
        flat[3] * [1, 1, 0] + 20,
    ]
    points = np.vstack(faces) + [50.0, 60, 70]
    normals = np.eye(3)[[2, 1, 0, 2]]
    patches = []
    for k, own in enumerate(np.split(np.arange(1200), 4)):
        plane = SimpleNamespace(normal=normals[k], centre=points[own].mean(axis=0))
        patches.append(SimpleNamespace(clear=rng.permutation(own)[:280], plane=plane))
    found = edges._Lines(points, patches, 0.5, 0.05)
    assert sorted(map(tuple, found.pairs.tolist())) == [(0, 1), (0, 2), (1, 2)]
    kept = np.concatenate([one.clear for one in patches])
    low = points[kept].min(axis=0)
    cell = np.floor((points - low) / 0.5 + 1e-6)
    meets = {}
    for own in range(3):
        for other in {0, 1, 2} - {own}:
            mine, theirs = patches[own].clear, patches[other].clear
            near = np.abs(cell[mine][:, None] - cell[theirs]).max(axis=2).min(axis=1) <= 1
            meets[own, other] = points[mine[near]] - found.origin
    assert [set(one.tolist()) for one in found.near] == [{1, 2}, {0, 2}, {0, 1}, set()]
    for line, sides in found.supported():
        pair = found.pairs[line]
        for (own, other), side in zip((pair, pair[::-1]), sides, strict=True):
            way, normal = found.direction[line], found.normals[own]
            off = meets[own, other] - found.foot[line]
            told = np.column_stack([off @ way, off @ np.cross(normal, way), off @ normal])
            told = told[np.abs(told[:, 1]) <= 0.5]
            assert np.transpose(side) == pytest.approx(told[np.argsort(told[:, 0])], abs=1e-9)
            assert side.shape[1] > 20
