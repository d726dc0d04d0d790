"""Planes in clouds and the edges between them."""

import numpy as np
import pytest
from facades import covered, street_of_facades
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from mmqa_lab import lines
from mmqa_lab.lines import extract_edges
from mmqa_lab.plane_search import detect_planes, usual_size
from mmqa_lab.simulate.canyon import canyon, canyon_cloud, canyon_edges, canyon_faces


def room(rng, n=3000, noise=0.01):
    """Floor 6 m x 5 m and two walls 4 m high that meet at the origin."""
    a, b = rng.uniform(0, 1, (2, 3, n))
    floor = np.stack([6 * a[0], 5 * b[0], 0 * a[0]], axis=1)
    first = np.stack([6 * a[1], 0 * a[1], 4 * b[1]], axis=1)
    second = np.stack([0 * a[2], 5 * a[2], 4 * b[2]], axis=1)
    points = np.concatenate([floor, first, second])
    return points + rng.normal(0, noise, points.shape)


TRUE_ROOM = np.array(
    [[[0, 0, 0], [6, 0, 0]], [[0, 0, 0], [0, 5, 0]], [[0, 0, 0], [0, 0, 4]]], dtype=float
)


def in_order(ends):
    """Edges of a room in the order of its axes, each from the origin; and that order."""
    order = np.abs(lines.directions(ends)).argmax(axis=1).argsort()
    ends = ends[order]
    away = np.linalg.norm(ends[:, 0], axis=1) > np.linalg.norm(ends[:, 1], axis=1)
    ends[away] = ends[away, ::-1]
    return ends, order


def test_a_room_has_three_planes_and_three_edges(rng):
    points = room(rng)
    patches = detect_planes(points)
    assert len(patches) == 3
    owners = np.concatenate([patch.index for patch in patches])
    assert len(owners) == len(np.unique(owners)) > 0.98 * len(points)
    edges = extract_edges(points)
    np.testing.assert_array_equal(extract_edges(points).segments, edges.segments)
    ends, _ = in_order(edges.segments)
    across = ends.copy()
    across[range(3), :, range(3)] = 0
    assert np.abs(across).max() < 0.005
    # the ends lie where both planes have points: within some spacings of 0.1 m
    np.testing.assert_allclose(ends, TRUE_ROOM, atol=0.15)


def test_turned_and_far_from_the_origin(rng):
    points = room(rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    shift = np.array([651_234.5, 6_862_345.7, 35.0])
    here, _ = in_order(extract_edges(points).segments)
    found = extract_edges(points @ turn.T + shift)
    back, _ = in_order((found.segments - shift) @ turn)
    # the bins along an edge start elsewhere: another point, some 0.1 m off, may be its last
    np.testing.assert_allclose(back, here, atol=0.1)
    off = back - here
    off[range(3), :, range(3)] = 0
    assert np.abs(off).max() < 1e-3


def test_profiles_dense_along_and_sparse_across(rng):
    """Scan lines 0.3 m apart, points 5 mm along: normals from neighbours would fail."""
    station, height = np.meshgrid(np.arange(0, 8, 0.3), np.arange(0, 5, 0.005))
    wall = np.stack([station.ravel(), 0 * station.ravel(), height.ravel()], axis=1)
    station, reach = np.meshgrid(np.arange(0, 8, 0.3), np.arange(0, 4, 0.005))
    road = np.stack([station.ravel(), reach.ravel(), 0 * reach.ravel()], axis=1)
    points = np.concatenate([wall, road])
    edges = extract_edges(points + rng.normal(0, 0.005, points.shape), tolerance=0.03)
    assert len(edges) == 1
    assert np.abs(edges.segments[0][:, 1:]).max() < 0.003
    assert lines.lengths(edges.segments)[0] == pytest.approx(7.8, abs=0.3)


def test_a_gap_parts_an_edge_and_planes_meet_at_20_degrees(rng):
    points = room(rng)
    kept = points[(points[:, 0] < 2) | (points[:, 0] > 4.5)]
    edges = extract_edges(kept)
    along = np.abs(lines.directions(edges.segments)[:, 0]) > 0.9
    assert along.sum() == 2
    for rise, number in ((0.2, 0), (0.5, 1)):  # 11 and 27 degrees
        slope = points[:3000] * [1, 1, 0] + points[:3000, 1:2] * [0, 0, rise]
        flat = np.concatenate([points[:3000] * [1, -1, 0], slope])
        assert len(extract_edges(flat)) == number


def test_hardly_any_planes_in_a_tree(rng):
    """In a third of such clouds some ten of 4,000 points lie near a plane by chance."""
    found = [detect_planes(rng.normal(0, 1.5, (4000, 3))) for _ in range(10)]
    assert sum(len(part) for parts in found for part in parts) < 200
    assert detect_planes(np.empty((0, 3))) == []
    empty = extract_edges(rng.normal(0, 1.5, (4000, 3)))
    assert (len(empty), empty.segments.shape) == (0, (0, 2, 3))


@settings(max_examples=40, deadline=None, phases=[Phase.generate])
@given(st.integers(0, 10**6))
def test_strays_beside_a_wire_or_a_flat_face_are_no_error(seed):
    """Points exactly on one line, or in one plane of rounded coordinates, and a fifth beside."""
    rng = np.random.default_rng(seed)
    n = rng.integers(12, 60)
    wire = np.stack([rng.normal(0, 0.04, n), rng.random(n) * 1.5, rng.random(n) / 2], axis=1)
    wire[rng.random(n) < 0.8, ::2] = 0
    detect_planes(wire, size=1.0)
    face = np.column_stack([1.5 * rng.random((200, 2)).round(1), np.zeros(200)])
    face[rng.random(200) < 0.2, 2] = 0.04
    (part,) = detect_planes(face, size=1.0)
    assert abs(part.plane.normal[2]) > 0.999


def test_canyon_points_lie_on_their_displaced_faces():
    scene = canyon(2)
    cloud = canyon_cloud(scene, "C1", density=0.5, noise=0.0, seed=1)
    corner, along, up = canyon_faces(scene)[0].swapaxes(0, 1)
    along, up = along - corner, up - corner
    face, street = cloud["face"], cloud["street"]
    moved = scene.surveys["C1"].positioning.at(cloud.points, street)
    local = cloud.points - moved - corner[face]
    normal = np.cross(along, up)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # the displacement is taken at the displaced point, 0.9 m further: it drifts 2 % along a street
    assert np.abs((local * normal[face]).sum(axis=1)).max() < 0.03
    assert len(canyon_edges(scene)) == 4 * len(scene.buildings)


def boxes(side, density=10, noise=0.01):
    """Walls 15 m high of side x side houses, 20 m x 20 m, 20 m apart: no ground."""
    rng = np.random.default_rng(side)
    houses = []
    for x, y in np.ndindex(side, side):
        n = 4 * 20 * 15 * density
        along, height, wall = rng.uniform(0, 20, n), rng.uniform(0, 15, n), rng.integers(4, size=n)
        east = np.choose(wall, [along, 20 + 0 * along, along, 0 * along])
        north = np.choose(wall, [0 * along, along, 20 + 0 * along, along])
        houses.append(np.stack([40 * x + east, 40 * y + north, height], axis=1))
    cloud = np.concatenate(houses)
    return cloud + rng.normal(0, noise, cloud.shape)


@pytest.mark.parametrize("side", [2, 5])
def test_edges_survive_the_size_of_the_cloud(side):
    """4,800 and 30,000 m2 of wall; a fixed sample of points lost nearly all of the larger."""
    edges = extract_edges(boxes(side))
    upright = lines.lengths(edges.segments)[np.abs(lines.directions(edges.segments)[:, 2]) > 0.99]
    assert len(upright) >= 4 * side**2
    assert upright.sum() == pytest.approx(4 * side**2 * 15, rel=0.03)


def wall_on_ground(rng, density, noise):
    """Ground of 20 m x 20 m and in its middle a wall of 4 m x 3 m."""
    ground = rng.uniform(0, 20, (400 * density, 3)) * [1, 1, 0]
    wall = rng.uniform(0, 1, (12 * density, 3)) * [4, 0, 3] + [8, 10, 0]
    points = np.concatenate([ground, wall])
    return points + rng.normal(0, noise, points.shape)


@pytest.mark.parametrize(("density", "noise"), [(10, 0.01), (300, 0.003), (300, 0.02)])
def test_an_edge_is_no_longer_than_its_wall(rng, density, noise):
    """Ground near the wall's plane is nearer to it than to its own: it supports no edge."""
    edges = extract_edges(wall_on_ground(rng, density, noise))
    # the ends are known to the distance of points in a strip of 1 m beside the edge
    assert lines.lengths(edges.segments) == pytest.approx([4.0], abs=0.1 + 5 / density)


@pytest.mark.parametrize(("density", "noise"), [(12, 0.005), (50, 0.02), (200, 0.01)])
def test_stated_uncertainty_covers_the_errors(density, noise):
    """Across the edge and along it, on rooms whose three edges are known."""
    across, along = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        edges = extract_edges(room(rng, n=25 * density, noise=noise))
        ends, order = in_order(edges.segments)
        for axis in range(3):
            other = [k for k in range(3) if k != axis]
            covariance = edges.covariance[order[axis], 0]
            across.append(
                ends[axis, 0, other]
                @ np.linalg.solve(covariance[np.ix_(other, other)], ends[axis, 0, other])
            )
            length = TRUE_ROOM[axis, 1, axis]
            from_origin = np.abs(edges.segments[order[axis], :, axis]).argsort()
            sigma = np.sqrt(edges.covariance[order[axis], from_origin, axis, axis])
            along += list(np.abs(ends[axis, :, axis] - [0, length]) / sigma)
    # 75 edges: two standard errors are 5 %
    assert 0.88 <= np.mean(np.array(across) < 5.99) <= 1.0
    assert 0.85 <= np.mean(np.array(along) < 1.96) <= 1.0


def test_a_cloud_too_thin_for_the_size_is_said_to_be():
    thin = boxes(1, density=2)
    with pytest.warns(UserWarning, match=r"second point\. Planes of 2 m may be missing"):
        detect_planes(thin)


def test_an_edge_ends_at_the_corner_of_three_planes():
    """The gap behind the last point leaves 7 cm open: 12 points/m2 in a strip of 0.95 m."""
    corner, open_end = [], []
    for seed in range(10):
        ends, _ = in_order(
            extract_edges(room(np.random.default_rng(seed), n=300, noise=0.005)).segments
        )
        corner += np.linalg.norm(ends[:, 0], axis=1).tolist()
        open_end += np.abs(ends[range(3), 1, range(3)] - [6, 5, 4]).tolist()
    assert np.median(corner) < 0.01
    assert np.median(open_end) > 0.02


@pytest.mark.parametrize(("density", "size"), [(2, 3.0), (5, 2.9), (10, 2.3), (16, 1.8), (60, 1.5)])
def test_the_default_size_grows_in_thin_clouds(rng, density, size):
    points = rng.uniform(0, 20, (400 * density, 3)) * [1, 1, 0]
    assert usual_size(points) == pytest.approx(size, rel=0.1)
    # lines of points 0.9 m apart do not fill the cells, however dense they are
    assert usual_size(points // [0.9, 1e-6, 1] * [0.9, 1e-6, 1]) >= 2.0
    far = np.arange(3)[:, None] * [100.0, 0, 0]
    assert usual_size(far) == usual_size(far[:1]) == 3.0


@settings(max_examples=2, deadline=None, phases=[Phase.generate])
@given(st.integers(0, 10**6))
def test_edges_do_not_depend_on_the_order_of_points(seed):
    rng = np.random.default_rng(seed)
    street = street_of_facades(seed % 20, 6.0, False)
    points = covered(street, 15, 0.01, rng)
    rows = rng.permutation(len(points))
    once, again = extract_edges(points), extract_edges(points[rows])
    assert np.array_equal(once.segments, again.segments)
    assert np.array_equal(once.covariance, again.covariance)
    parts, others = detect_planes(points), detect_planes(points[rows])
    assert {frozenset(part.index) for part in parts} == {
        frozenset(rows[other.index]) for other in others
    }
