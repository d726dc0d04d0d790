"""Planes in clouds, the edges between them, and outlines of boards."""

import json

import numpy as np
import pytest

from mmqa_lab import samples
from mmqa_lab.__main__ import main
from mmqa_lab.cloud import Cloud
from mmqa_lab.io import read_cloud, write_cloud
from mmqa_lab.lines import extract_edges, fit_outline, intersect_patches
from mmqa_lab.planes import detect_planes
from mmqa_lab.simulate.canyon import canyon
from mmqa_lab.simulate.canyon_cloud import canyon_cloud, canyon_edges, canyon_faces
from mmqa_lab.studies.lhd_weight import clouds


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


def in_order(edges):
    """Edges of a room in the order of its axes, each from the origin."""
    ends = edges.segments.ends
    order = np.abs(edges.segments.directions).argmax(axis=1).argsort()
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
    edges = intersect_patches(points, patches)
    ends, _ = in_order(edges)
    across = ends.copy()
    across[range(3), :, range(3)] = 0
    assert np.abs(across).max() < 0.005
    # the ends lie where both planes have points: within some spacings of 0.1 m
    np.testing.assert_allclose(ends, TRUE_ROOM, atol=0.15)
    np.testing.assert_allclose(edges.angle, 90, atol=0.3)
    frame = edges.to_frame()
    assert frame["length_m"].tolist() == edges.segments.lengths.tolist()


def test_equal_clouds_give_equal_edges(rng):
    points = room(rng)
    first, again = extract_edges(points), extract_edges(points)
    np.testing.assert_array_equal(first.segments.ends, again.segments.ends)


def test_turned_and_far_from_the_origin(rng):
    points = room(rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    shift = np.array([651_234.5, 6_862_345.7, 35.0])
    here, _ = in_order(extract_edges(points))
    found = extract_edges(points @ turn.T + shift)
    back = (found.segments.ends - shift) @ turn
    back = back[np.abs(back[:, 1] - back[:, 0]).argmax(axis=1).argsort()]
    away = np.linalg.norm(back[:, 0], axis=1) > np.linalg.norm(back[:, 1], axis=1)
    back[away] = back[away, ::-1]
    # the bins along an edge start elsewhere: another point, some 0.1 m off, may be its last
    np.testing.assert_allclose(back, here, atol=0.1)
    for axis in range(3):
        other = [k for k in range(3) if k != axis]
        np.testing.assert_allclose(back[axis][:, other], here[axis][:, other], atol=1e-3)


def test_stated_covariance_is_that_of_repeated_clouds():
    normalised, sigma, errors = [], [], []
    for seed in range(40):
        edges = extract_edges(room(np.random.default_rng(seed), n=1500, noise=0.02), tolerance=0.08)
        ends, order = in_order(edges)
        assert len(edges) == 3
        for axis in range(3):
            other = [k for k in range(3) if k != axis]
            covariance = edges.covariance[order[axis], 0][np.ix_(other, other)]
            error = ends[axis, 0][other]
            errors.append(error)
            sigma.append(np.sqrt(np.trace(covariance) / 2))
            normalised.append(error @ np.linalg.solve(covariance, error))
    # independent noise: the statement is a lower limit, reached here to a quarter
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(sigma), rel=0.25)
    assert np.mean(np.array(normalised) < 5.99) > 0.85


def test_profiles_dense_along_and_sparse_across(rng):
    """Scan lines 0.3 m apart, points 5 mm along: normals from neighbours would fail."""
    station, height = np.meshgrid(np.arange(0, 8, 0.3), np.arange(0, 5, 0.005))
    wall = np.stack([station.ravel(), 0 * station.ravel(), height.ravel()], axis=1)
    station, reach = np.meshgrid(np.arange(0, 8, 0.3), np.arange(0, 4, 0.005))
    road = np.stack([station.ravel(), reach.ravel(), 0 * reach.ravel()], axis=1)
    points = np.concatenate([wall, road])
    edges = extract_edges(points + rng.normal(0, 0.005, points.shape), tolerance=0.03)
    assert len(edges) == 1
    assert np.abs(edges.segments.ends[0][:, 1:]).max() < 0.003
    assert edges.segments.lengths[0] == pytest.approx(7.8, abs=0.3)


def test_a_gap_parts_an_edge_and_an_angle_is_asked_for(rng):
    points = room(rng)
    kept = points[(points[:, 0] < 2) | (points[:, 0] > 4.5)]
    edges = extract_edges(kept)
    along = np.abs(edges.segments.directions[:, 0]) > 0.9
    assert along.sum() == 2
    slope = points[:3000] * [1, 1, 0] + points[:3000, 1:2] * [0, 0, 0.2]
    flat = np.concatenate([points[:3000] * [1, -1, 0], slope])
    assert len(extract_edges(flat, angle=20)) == 0
    assert len(extract_edges(flat, angle=5)) == 1


def test_no_planes_in_a_tree(rng):
    assert detect_planes(rng.normal(0, 1.5, (4000, 3))) == []
    assert detect_planes(np.empty((0, 3))) == []
    empty = extract_edges(rng.normal(0, 1.5, (4000, 3)))
    assert (len(empty), len(empty.to_frame()), empty.sigma.shape) == (0, 0, (0, 2))


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"tolerance": 0}, "Invalid tolerance 0. Must be > 0 m"),
        ({"size": -1}, "Invalid size -1"),
        ({"minimum": 2}, "Invalid minimum 2. Must be a whole number >= 3"),
        ({"angle": 120}, "Invalid angle 120"),
        ({"support": 0}, "Invalid support 0"),
    ],
)
def test_bad_settings_are_refused(rng, choices, said):
    with pytest.raises(ValueError, match=said):
        extract_edges(room(rng, n=300), **choices)
    with pytest.raises(ValueError, match="not finite"):
        extract_edges([[0, 0, np.nan]] * 300)


def test_canyon_points_lie_on_their_displaced_faces():
    scene = canyon(2)
    cloud = canyon_cloud(scene, "C1", density=0.5, noise=0.0, seed=1)
    faces = canyon_faces(scene)
    corner, along, up = (np.stack(faces[name].to_numpy()) for name in ("corner", "along", "up"))
    face, street = cloud["face"], cloud["street"]
    moved = scene.surveys["C1"].positioning.at(cloud.points, street)
    local = cloud.points - moved - corner[face]
    normal = np.cross(along, up)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # the displacement is taken at the displaced point, 0.9 m further: it drifts 2 % along a street
    assert np.abs((local * normal[face]).sum(axis=1)).max() < 0.03
    assert len(canyon_edges(scene)) == 4 * len(scene.buildings)
    with pytest.raises(ValueError, match="Invalid density 0"):
        canyon_cloud(scene, "C1", density=0)


def test_edges_of_a_simulated_canyon_are_the_true_ones():
    row = clouds.extraction(seed=1, density=8, noise=0.01).iloc[0]
    assert row["n_found"] > 30
    assert row["error_median_mm"] < 2
    assert row["cover_95"] > 0.8


def test_chain_from_clouds_to_the_displacement():
    table = clouds.chain(seeds=(1,), density=15, noise=0.02)
    row = table.query("comparison == 'C2-TLS' and matcher == 'displaced'").iloc[0]
    assert row["pairs"] > 15
    assert row["vector_error_m"] < 0.1
    assert row["perpendicular_m"] < row["true_m"] < row["lhd_m"] + 0.1


def board(rng, *, turn, lines=14, step=0.006, noise=0.003):
    """A 0.85 m x 0.61 m board, turned in its plane, as level scan lines see it."""
    z, y = np.meshgrid(np.linspace(-0.6, 0.6, lines), np.arange(-0.7, 0.7, step), indexing="ij")
    line = np.repeat(np.arange(lines), y.shape[1])
    y, z = y.ravel() + rng.uniform(0, step), z.ravel()
    c, s = np.cos(turn), np.sin(turn)
    inside = (np.abs(c * y + s * z) < 0.425) & (np.abs(c * z - s * y) < 0.305)
    points = np.stack([3 + 0.28 * y, 0.96 * y, z], axis=1)  # 0.28, 0.96: a unit vector
    return (points + rng.normal(0, noise, points.shape))[inside], line[inside]


@pytest.mark.parametrize("turn", [0.6, 0.8, 1.2])
def test_outline_of_a_board(rng, turn):
    points, line = board(rng, turn=turn)
    found = fit_outline(points, lines=line)
    # line ends are known to half a spacing, 3 mm; 10 and more of them on each side
    np.testing.assert_allclose(found.size, [0.85, 0.61], atol=0.006)
    lengths = found.segments.lengths
    assert np.sort(lengths)[::2] == pytest.approx(np.sort(found.size), abs=1e-9)
    far = fit_outline(points + [651_234.5, 6_862_345.7, 0], lines=line)
    np.testing.assert_allclose(far.size, found.size, atol=1e-5)


def test_outline_from_the_hull_and_refusals(rng):
    points, line = board(rng, turn=0.8, lines=120)
    np.testing.assert_allclose(fit_outline(points).size, [0.85, 0.61], atol=0.015)
    with pytest.raises(ValueError, match="Invalid lines of shape"):
        fit_outline(points, lines=line[:-1])
    with pytest.raises(ValueError, match="Invalid outline of 2 points"):
        fit_outline(points, lines=np.zeros(len(points)))


def test_command_extracts_edges_of_clouds(tmp_path, capsys, rng):
    points = room(rng)
    files = [tmp_path / "test.laz", tmp_path / "model.laz"]
    write_cloud(files[0], Cloud(points + [0.05, 0, 0]))
    write_cloud(files[1], Cloud(points))
    arguments = ["lhd", *map(str, files), "--json", "--edges", str(tmp_path / "edges")]
    assert main(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["p"], printed["q"]) == (3, 3)
    np.testing.assert_allclose(printed["displacement_m"], [0.05, 0, 0], atol=0.02)
    assert (tmp_path / "edges" / "test_edges.csv").is_file()
    write_cloud(files[0], Cloud(rng.normal(0, 2, (3000, 3))))
    assert main(arguments) == 2
    assert "no edges between planes" in capsys.readouterr().err


@pytest.mark.real
def test_real_boards_have_their_size(real):
    for name in ("vlp16_pose08", "vlp16_pose24", "os64_pose04"):
        cloud = read_cloud(real(f"boards/{name}.laz"))
        size = fit_outline(cloud.points, lines=cloud["ring"]).size
        # half the beam's footprint at 3 m is 1 cm on each side
        np.testing.assert_allclose(size, [0.85, 0.61], atol=0.02)


@pytest.mark.real
def test_real_sweeps_show_their_pose(real):
    real("hdl32e_pair/a_to_b.txt")
    from mmqa_lab.studies.lhd_weight.real import sweep_pair

    table = sweep_pair().set_index(["frame", "matcher"])
    pose = np.loadtxt(samples.real_path("hdl32e_pair/a_to_b.txt"))
    row = table.loc[("as scanned", "displaced")]
    found = row[["east_m", "north_m", "up_m"]].to_numpy(float)
    # before the pose is applied the shift at the edges is its translation and its turn of 0.6
    # degrees about a scanner some metres away
    np.testing.assert_allclose(found, pose[:3, 3], atol=0.1)
    left = table.loc[("pose applied", "displaced"), ["east_m", "north_m", "up_m"]]
    assert np.linalg.norm(left.to_numpy(float)) < 0.06
