"""Dense matching: spacing, errors that grow with depth squared and hang together, ghosts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mmqa_lab import simulate
from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.simulate import MatchingCamera, Scene
from mmqa_lab.simulate.point_patterns import hard_core_points, thin

CAMERA = MatchingCamera(focal_px=2000, width_px=400, height_px=300, base_m=1.0, noise_px=0.3)
PATH = simulate.straight(10, 10)


def wall(distance):
    return Scene([simulate.rectangle((distance, -60, -60), (0, 120, 0), (0, 0, 120))])


def cloud(scene, camera=CAMERA, seed=1):
    return next(simulate.match(scene, camera, PATH, times=[0.5], seed=seed))


@pytest.mark.parametrize("hard_core", [0.0, 0.3, 0.5])
def test_hard_core_keeps_its_distance_and_density(rng, hard_core):
    points = hard_core_points(np.array([300, 200]), 0.5, hard_core, rng)
    n = 300 * 200 * 0.5
    assert len(points) == pytest.approx(n, abs=4 * np.sqrt(n))
    nearest = cKDTree(points).query(points, k=2)[0][:, 1].min()
    assert nearest >= hard_core / np.sqrt(0.5)
    assert nearest < hard_core / np.sqrt(0.5) + 0.05


def test_poisson_pattern_has_the_spacing_of_its_closed_form():
    exact = replace(CAMERA, hard_core=0.0, noise_px=0.0, width_px=600, height_px=600)
    quality = evaluate_cloud(cloud(wall(5), exact))
    density = exact.points_per_px * (exact.focal_px / 5) ** 2
    assert quality.density_hull_per_m2 == pytest.approx(density, rel=0.02)
    d1, d4 = (1000 * np.sqrt(k / (np.pi * density)) for k in (np.log(2), 4 * 1.8383))
    assert quality.d1_mm == pytest.approx(d1, rel=0.02)
    assert quality.d4_mm == pytest.approx(d4, rel=0.02)


def test_depth_error_grows_with_the_square_of_the_depth():
    spread = {}
    for distance in (5, 10):
        many = [cloud(wall(distance), seed=seed).points[:, 0] - distance for seed in range(12)]
        spread[distance] = np.concatenate(many).std()
    assert spread[5] == pytest.approx(25 / 2000 * 0.3, rel=0.05)
    assert spread[10] == pytest.approx(100 / 2000 * 0.3, rel=0.05)


def test_neighbours_err_together():
    one = cloud(wall(5))
    error = one.points[:, 0] - 5
    distance, near = cKDTree(one.points[:, 1:]).query(one.points[:, 1:], k=2)
    assert np.median(distance[:, 1]) * 400 < 3  # px: much closer than the 8 px of correlation
    paired = np.corrcoef(error, error[near[:, 1]])[0, 1]
    assert paired == pytest.approx(0.7, abs=0.1)
    apart = replace(CAMERA, correlated_share=0.0)
    alone = cloud(wall(5), apart)
    error = alone.points[:, 0] - 5
    near = cKDTree(alone.points[:, 1:]).query(alone.points[:, 1:], k=2)[1]
    assert abs(np.corrcoef(error, error[near[:, 1]])[0, 1]) < 0.05


def test_a_floor_of_noise_adds_in_quadrature():
    noisy = replace(CAMERA, floor_m=0.005)
    errors = [cloud(wall(5), noisy, seed=seed).points[:, 0] - 5 for seed in range(12)]
    stereo = 25 / 2000 * 0.3
    assert np.concatenate(errors).std() == pytest.approx(np.hypot(stereo, 0.005), rel=0.05)


@pytest.mark.parametrize("distance", [5, 8])
def test_resampled_points_have_one_density_and_core_at_any_distance(distance):
    dense = replace(CAMERA, points_per_px=0.5, resampled_per_m2=5000, noise_px=0.0, hard_core=0.4)
    points = cloud(wall(distance), dense).points[:, 1:]
    area = 400 * 300 * (distance / 2000) ** 2
    assert len(points) == pytest.approx(5000 * area, abs=4 * np.sqrt(5000 * area))
    nearest = cKDTree(points).query(points, k=2)[0][:, 1].min()
    core = 0.4 / np.sqrt(5000)
    assert core <= nearest < 1.2 * core


def test_resampling_counts_on_the_surface_not_across_the_view():
    """A wall seen at 45 degrees has the same points per square metre."""
    slanted = Scene([simulate.rectangle((10, 0, -9), (-9, 9, 0), (0, 0, 18))])
    dense = replace(CAMERA, points_per_px=0.5, resampled_per_m2=5000, noise_px=0.0, hard_core=0.0)
    points = cloud(slanted, dense).points
    along = (points[:, 1] - 5) * np.sqrt(2)
    middle = (np.abs(along) < 0.3) & (np.abs(points[:, 2]) < 0.25)
    expected = 5000 * 0.6 * 0.5
    assert middle.sum() == pytest.approx(expected, abs=4 * np.sqrt(expected))


@pytest.mark.parametrize("columns", [2, 3])
def test_thinning_keeps_what_a_loop_keeps(rng, columns):
    points = rng.random((400, columns))
    keep = []
    for point in points:
        if all(np.linalg.norm(point - other) > 0.1 for other in keep):
            keep.append(point)
    assert np.array_equal(points[thin(points, 0.1)], keep)


def test_ghosts_hang_between_surfaces_along_edges():
    front = simulate.rectangle((4, 4.9, -9), (0, 20, 0), (0, 0, 20))
    back = simulate.rectangle((6, -60, -60), (0, 120, 0), (0, 0, 120))
    exact = replace(CAMERA, noise_px=0.0, height_px=3000)
    seen = cloud(Scene([front, back]), exact)
    ghost = seen["ghost"] == 1
    between = (seen.points[:, 0] > 4.001) & (seen.points[:, 0] < 5.999)
    # points per pixel x edge length x mean reach of the window across it (4 w / 3 pi) x share
    expected = 0.25 * 3000 * 4 * 3 / (3 * np.pi) * 0.5
    assert ghost.sum() == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert np.array_equal(between, ghost & between)
    assert between.sum() > 0.95 * ghost.sum()
    column = (seen.points[:, 1] - 5) / seen.points[:, 0] * 2000
    edge = (4.9 - 5) / 4 * 2000
    assert np.abs(column[ghost] - edge).max() <= 3.0 + 1e-6  # the window's half width


def test_only_what_the_camera_sees():
    flat = Scene([simulate.rectangle((5, 0, -9), (20, 20, 0), (0, 0, 20))])
    points = cloud(flat)
    ray = points.points - [0, 5, 0]
    assert (np.abs(ray[:, 1] / ray[:, 0]) <= 0.1 + 1e-9).all()
    assert (np.abs(ray[:, 2] / ray[:, 0]) <= 0.075 + 1e-9).all()
    assert np.allclose(np.linalg.norm(ray, axis=1), points["range_m"] + points["range_noise_m"])
    assert len(cloud(flat, replace(CAMERA, heading_deg=270))) == 0
    assert len(cloud(flat, replace(CAMERA, max_incidence_deg=30))) == 0


def test_images_follow_the_times():
    images = list(simulate.match(wall(5), CAMERA, PATH, times=[0.2, 0.7], seed=1))
    assert [cloud["gps_time"][0] for cloud in images] == [0.2, 0.7]
    middle = [cloud.points[:, 1].mean() for cloud in images]
    assert np.allclose(middle, [2, 7], atol=0.05)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"focal_px": 0}, "Invalid focal_px 0. Must be > 0."),
        ({"hard_core": 0.6}, "Invalid hard_core 0.6. Must be between 0 and 0.56."),
        ({"ghost_share": -1}, "Invalid ghost_share -1. Must be between 0 and 1."),
        ({"width_px": 0.5}, "Invalid width_px 0.5. Must be a whole number >= 1."),
    ],
)
def test_bad_cameras_are_named(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        replace(CAMERA, **change)
