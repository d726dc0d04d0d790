"""A part of a surface that stands off the rest is said, and steps of coordinates are no comb."""

import re

import matplotlib.pyplot as plt
import numpy as np
import pytest

from mmqa_lab.chart_cloud import evaluate_cloud
from mmqa_lab.cloud import Cloud


def sill(rng, share):
    """A facade of 4 m x 1.4 m with 10 mm of noise; a share of it at its foot is 6 cm proud."""
    x, y = rng.uniform(0, 1, (2, 6000)) * [[4], [1.4]]
    proud = 0.06 * (y < 1.4 * share)
    return np.stack([x, 0.01 * rng.standard_normal(6000) + proud, y], axis=1)


def test_a_part_that_turns_the_plane_is_said_with_both_figures(rng):
    points = sill(rng, 0.07)
    quality = evaluate_cloud(points)
    (said,) = [one for one in quality.remarks if "turn the plane" in one]
    found = [float(one) for one in re.findall(r"[\d.]+(?= mm)", said)]
    assert found[0] == pytest.approx(quality.sigma_mad_mm, abs=0.06)
    assert found[1] == pytest.approx(10, rel=0.06)
    assert found[1] < 0.9 * found[0]
    assert 0.06 < int(said.split()[0]) / 6000 < 0.08
    turned = np.degrees(np.arccos(abs(quality.plane.normal[1])))
    assert float(re.search(r"by ([\d.]+) degrees", said)[1]) == pytest.approx(turned, rel=0.2)


def test_flat_boards_and_few_strays_turn_no_plane(rng):
    boards = [sill(rng, 0)[: 100 + 9 * k] for k in range(60)]
    boards += [board * [1, rng.exponential(), 1] for board in boards]  # of any noise
    for board in boards[::2]:
        board[: len(board) // 200, 1] += 0.2
    said = [one for board in boards for one in evaluate_cloud(board).remarks]
    assert not [one for one in said if "turn the plane" in one]


def test_bins_of_the_histogram_are_multiples_of_the_step(rng):
    points = np.round(sill(rng, 0) * [1, 0.3, 1], 3)  # 3 mm of noise in steps of 1 mm
    figure, axes = plt.subplots(2)
    evaluate_cloud(points).draw_histograms(*axes)
    x, y = axes[1].patches[0].get_xy().T
    counts = y[(np.abs(x) < 4) & (y > 0)]
    assert counts.min() > 0.3 * counts.max()  # no comb
    plt.close(figure)


@pytest.mark.parametrize("noise", [0, 0.005])
def test_a_polygon_across_its_surface_is_refused(rng, noise):
    wall = rng.random((400, 3)) * [1, 0, 1] + noise * rng.standard_normal((400, 3))
    level = [[-0.5, -2, 0.5], [1.5, -2, 0.5], [1.5, 2, 0.5], [-0.5, 2, 0.5]]
    with pytest.raises(ValueError, match=r"Invalid polygon: (89|90) degrees to the surface"):
        evaluate_cloud(wall, polygon=level, thickness=5)


def test_several_beams_of_a_spinning_scanner_are_said_where_intervals_are_given(rng):
    points = np.column_stack([rng.random((400, 2)), 0.003 * rng.standard_normal(400)])
    ring = np.where(points[:, 0] < 0.5, 7, rng.integers(8, 20, 400))
    left = [[0.1, 0.1, 0], [0.45, 0.1, 0], [0.45, 0.9, 0], [0.1, 0.9, 0]]
    beams = len(set(ring))
    found = evaluate_cloud(Cloud(points, {"ring": ring})).remarks
    (said,) = (one for one in found if "beams" in one)
    assert said.startswith(f"The points come from {beams} beams of a spinning scanner: one pass ")
    assert "hold in about half of the passes, not in 95 %" in said
    for cloud, polygon in (
        (points, None),
        (Cloud(points), None),
        (Cloud(points, {"ring": 0 * ring}), None),
        (Cloud(points, {"ring": ring}), left),  # of one beam alone
        (Cloud(points[:40], {"ring": ring[:40]}), None),  # has no intervals
    ):
        assert not any("beams" in one for one in evaluate_cloud(cloud, polygon=polygon).remarks)


@pytest.mark.parametrize("axis", [2, 1])
def test_steps_of_the_axis_across_a_surface_decide_its_noise(rng, axis):
    """Heights of a text in centimetres, plan in millimetres: the noise of a level surface alone."""
    points = np.insert(rng.random((3000, 2)), axis, rng.normal(0, 0.003, 3000), axis=1)
    points = np.round(points * 1000) / 1000 + [452_000, 5_411_000, 300]
    fine = evaluate_cloud(points)
    assert "sigma_MAD" not in " ".join(fine.remarks)
    points[:, axis] = np.round(points[:, axis], 2)
    coarse = evaluate_cloud(points)
    words = "Coordinates are in steps of 10 mm: too coarse for sigma_MAD"
    assert coarse.remarks[0].startswith(words)
    assert "d1" not in coarse.remarks[0]  # the distances within the surface are as before
    assert not [one for one in coarse.remarks if "stand off" in one or "layers" in one]
    assert coarse.step_mm == pytest.approx(1)
    assert coarse.d1_mm == pytest.approx(fine.d1_mm, rel=0.01)
