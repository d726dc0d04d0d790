"""Dense matching of a chart: spacing, and errors that grow with depth squared and hang together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.simulate.point_patterns import hard_core_points, thin
from mmqa_lab.simulate.systems import MatchingCamera, pass_chart

CAMERA = MatchingCamera(
    focal_px=2000,
    base_m=1.0,
    points_per_px=0.05,
    hard_core=0.4,
    resampled_per_m2=0,
    noise_px=0.3,
    floor_m=0.0,
    correlation_px=8.0,
)


@pytest.mark.parametrize("hard_core", [0.0, 0.3, 0.5])
def test_hard_core_keeps_its_distance_and_density(rng, hard_core):
    points = hard_core_points(np.array([300, 200]), 0.5, hard_core, rng)
    n = 300 * 200 * 0.5
    assert len(points) == pytest.approx(n, abs=4 * np.sqrt(n))
    nearest = cKDTree(points).query(points, k=2)[0][:, 1].min()
    assert nearest >= hard_core / np.sqrt(0.5)
    assert nearest < hard_core / np.sqrt(0.5) + 0.05


def test_poisson_pattern_has_the_spacing_of_its_closed_form():
    quality = evaluate_cloud(
        pass_chart(replace(CAMERA, hard_core=0.0, noise_px=0.0), 5.0, seed=1, height=0.5)
    )
    density = 0.05 * (2000 / 5) ** 2
    assert quality.density_hull_per_m2 == pytest.approx(density, rel=0.03)
    d1, d4 = (1000 * np.sqrt(k / (np.pi * density)) for k in (np.log(2), 4 * 1.8383))
    assert quality.d1_mm == pytest.approx(d1, rel=0.03)
    assert quality.d4_mm == pytest.approx(d4, rel=0.03)


@pytest.mark.parametrize("floor_m", [0.0, 0.005])
def test_depth_error_grows_with_the_square_of_the_depth_and_has_a_floor(floor_m):
    noisy = replace(CAMERA, floor_m=floor_m)
    for distance in (5.0, 10.0):
        clouds = [pass_chart(noisy, distance, seed=seed) for seed in range(12)]
        errors = np.concatenate([cloud.points[:, 0] - distance for cloud in clouds])
        expected = np.hypot(distance**2 / 2000 * 0.3, floor_m)
        assert errors.std() == pytest.approx(expected, rel=0.05)
    rays = clouds[0].points
    lengths = clouds[0]["range_m"] + clouds[0]["range_noise_m"]
    assert np.allclose(np.linalg.norm(rays, axis=1), lengths)


@pytest.mark.parametrize(("share", "expected"), [(0.7, 0.7), (0.0, 0.0)])
def test_neighbours_err_together(share, expected):
    cloud = pass_chart(replace(CAMERA, correlated_share=share, hard_core=0.1), 5.0, seed=1)
    error = cloud.points[:, 0] - 5
    distance, near = cKDTree(cloud.points[:, 1:]).query(cloud.points[:, 1:], k=2)
    assert np.median(distance[:, 1]) * 400 < 3  # px: much closer than the 8 px of correlation
    assert np.corrcoef(error, error[near[:, 1]])[0, 1] == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("distance", [5.0, 8.0])
def test_resampled_points_have_one_density_and_core_at_any_distance(distance):
    dense = replace(CAMERA, points_per_px=0.5, resampled_per_m2=5000, noise_px=0.0)
    points = pass_chart(dense, distance, seed=1).points[:, 1:]
    assert len(points) == pytest.approx(5000, abs=4 * np.sqrt(5000))
    core = 0.4 / np.sqrt(5000)
    assert core <= cKDTree(points).query(points, k=2)[0][:, 1].min() < 1.2 * core


@pytest.mark.parametrize("columns", [2, 3])
def test_thinning_keeps_what_a_loop_keeps(rng, columns):
    points = rng.random((400, columns))
    keep = []
    for point in points:
        if all(np.linalg.norm(point - other) > 0.1 for other in keep):
            keep.append(point)
    assert np.array_equal(points[thin(points, 0.1)], keep)
