"""Edges of streets of the second generator: L-shaped houses, dormers, balconies, windows."""

import numpy as np
import pytest
from facades import covered, held_across, score, street_of_facades, true_edges, visible

from mmqa_lab import lines


def test_truth_is_where_faces_touch():
    """Floor and wall of 4 m x 3 m that meet in the middle of the floor, and a plate above both."""
    floor, wall = [0, 0, 0, 6, 0, 0, 0, 4, 0, False], [1, 2, 0, 4, 0, 0, 0, 0, 3, False]
    plate = [0, 0, 5, 6, 0, 0, 0, 4, 0, False]
    edges, normals = true_edges([floor, wall, plate])
    assert np.sort(edges[0, :, 0]) == pytest.approx([1, 5], abs=0.011)
    assert edges[0, :, 1:] == pytest.approx(np.array([[2, 0], [2, 0]]))
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (4000, 3)) * [6, 4, 0]
    upright = rng.uniform(0, 1, (2000, 3)) * [4, 0, 3] + [1, 2, 0]
    found = visible(edges, normals, np.concatenate([points, upright]), 0.0)
    assert found[:, 2] - found[:, 1] == pytest.approx([4.0], abs=0.1)
    hidden = visible(edges, normals, np.concatenate([points, upright + [0, 0, 0.4]]), 0.0)
    assert not len(hidden)


@pytest.fixture(scope="module")
def clutter():
    """A fifth of a street with windows, 300 points per square metre of what is seen, its edges."""
    street = street_of_facades(7, length=6.0)
    points = covered(street, 300, 0.01, np.random.default_rng(7))
    return street, points, lines.extract_edges(points)


def test_edges_of_cluttered_facades_are_found_and_true(clutter):
    """The smallest faces with edges of 1 m are bonnets and dormers; no setting is given."""
    street, points, found = clutter
    figures = score(found.segments, street.faces, points, 0.01)
    assert figures["visible"] > 25
    assert figures["recall"] >= 0.85
    assert figures["true_length"] >= 0.97
    assert figures["ends_median_m"] < 0.1
    assert held_across(found, street.faces).mean() >= 0.85


def test_small_faces_of_a_thin_cloud_have_edges():
    """At 10 points per square metre a face of 1 m2 has 10 points, fewer than 30."""
    found = []
    for seed in (2, 5, 8):
        street = street_of_facades(seed, length=12.0, windows=False)
        points = covered(street, 10, 0.01, np.random.default_rng(seed))
        figures = score(lines.extract_edges(points).segments, street.faces, points, 0.01)
        found.append([figures["recall"], figures["true_length"]])
    recall, true_length = np.mean(found, axis=0)
    assert recall >= 0.85
    assert true_length >= 0.95


def test_what_ends_before_a_line_has_no_edge_there(clutter):
    """Cars stand 0.3 m above the road: their sides meet it nowhere."""
    ends = clutter[2].segments
    level = np.abs(ends[:, :, 2]).max(axis=1) < 0.05
    assert not (level & (np.abs(ends[:, :, 0]).max(axis=1) < 3.3)).any()
