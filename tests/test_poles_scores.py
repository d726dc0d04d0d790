"""Matching and scores: hand-made cases, brute force, protocol, invariance, bad input."""

from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmqa_lab import poles
from mmqa_lab.poles import scores


def table(xy, **columns):
    """A table of plan positions."""
    x, y = np.reshape(xy, (-1, 2)).T
    return pd.DataFrame({"x_m": x, "y_m": y, **columns})


def brute_force(found, truth, gate):
    """Most pairs, then least total distance, over all assignments."""
    if len(found) > len(truth):
        return brute_force(truth, found, gate)
    distance = np.hypot(*(found[:, None] - truth[None]).transpose(2, 0, 1))
    best = (0, 0.0)
    for order in permutations(range(len(truth)), len(found)):
        kept = [distance[i, j] for i, j in enumerate(order) if distance[i, j] <= gate]
        best = max(best, (len(kept), -sum(kept)))
    return best


coordinates = st.tuples(st.floats(0, 2), st.floats(0, 2))


@settings(max_examples=60, deadline=None)
@given(st.lists(coordinates, min_size=1, max_size=5), st.lists(coordinates, min_size=1, max_size=5))
def test_match_is_the_best_of_all_assignments(found, truth):
    found, truth = np.array(found), np.array(truth)
    pairs = scores.match(table(found), table(truth), gate=0.7)
    n, total = brute_force(found, truth, 0.7)
    assert len(pairs) == n
    assert pairs["distance_m"].sum() == pytest.approx(-total, abs=1e-9)
    assert pairs["detection"].is_unique
    assert pairs["reference"].is_unique


def test_two_near_poles_are_not_matched_greedily():
    # the nearest pair first would leave the other two 0.6 m apart
    pairs = scores.match(table([[0.3, 0], [0.8, 0]]), table([[0, 0], [0.4, 0]]), gate=0.5)
    assert pairs[["detection", "reference"]].to_numpy().tolist() == [[0, 0], [1, 1]]


def test_a_second_hit_is_a_duplicate_and_not_a_pole():
    result = poles.score(table([[0, 0], [0.2, 0], [9, 0]]), table([[0, 0], [5, 0]]))
    assert list(result.detections["outcome"]) == ["hit", "duplicate", "false"]
    assert (result.recall.k, result.recall.n) == (1, 2)
    assert (result.precision.k, result.precision.n) == (1, 3)


def test_what_is_no_target_is_neither_right_nor_wrong():
    truth = table([[0, 0], [5, 0], [10, 0]], visible=[True, False, True], height_m=[2.0, 2.0, 0.9])
    result = poles.score(table([[0, 0], [5, 0], [10, 0]]), truth)
    assert list(result.detections["outcome"]) == ["hit", "ignored", "ignored"]
    assert result.precision.value == 1.0
    assert result.recall.n == 1
    assert result.to_frame()["n"].tolist() == [1, 1]
    assert "recall" in result._repr_html_()
    assert repr(result).startswith("<Score: recall 1.000")


def test_the_corridor_is_about_the_whole_path():
    path = np.array([[0, 0, 0], [0, 50, 1], [50, 50, 2]])
    truth = table([[3, 20], [30, 52], [30, 20]])
    result = poles.score(truth, truth, corridor=5, trajectory=path)
    assert list(result.detections["outcome"]) == ["hit", "hit", "outside"]


def test_a_leaning_pole_is_where_it_is_at_the_height_of_the_detection():
    truth = table([[0, 0]], z_base_m=[0.0], height_m=[8.0], lean_x=[0.2], lean_y=[0.0])
    low = table([[-0.6, 0]], z_base_m=[0.5], height_m=[1.0])
    assert scores.match(low, truth)["distance_m"].item() == pytest.approx(0.0)
    assert len(scores.match(low, truth[["x_m", "y_m"]])) == 0


def test_scores_do_not_change_when_moved_far():
    rng = np.random.default_rng(3)
    truth = rng.uniform(0, 50, (40, 2))
    found = truth[:30] + rng.normal(0, 0.1, (30, 2))
    near = poles.score(table(found), table(truth))
    far = poles.score(table(found + 1e7), table(truth + 1e7))
    assert near.recall == far.recall
    # 1e7 m leaves 2e-9 m of float64
    assert np.allclose(near.detections["distance_m"], far.detections["distance_m"], atol=1e-8)


def test_diameters_are_compared_where_they_were_measured():
    truth = table([[0, 0]], z_base_m=[0.0], height_m=[8.0], **{"class": ["lamp"]})
    truth = truth.assign(diameter_base_m=0.20, diameter_top_m=0.10, lean_x=0.0, lean_y=0.0)
    found = table([[0, 0]], z_base_m=[1.0], height_m=[2.0], diameter_m=[0.17])
    # at half height of the detection, 2 m of 8 m, the taper leaves 0.175 m
    assert poles.score(found, truth).hits["true_diameter_m"].item() == pytest.approx(0.175)


def test_nothing_found_and_nothing_to_find():
    nothing = table(np.empty((0, 2)))
    result = poles.score(nothing, table([[0, 0]]))
    assert result.recall.value == 0
    assert np.isnan(result.precision.value)
    assert np.isnan(poles.score(nothing, nothing).recall.value)


@pytest.mark.parametrize("said", ["no", "false", 2, None])
def test_visible_is_true_or_false_and_nothing_else(said):
    with pytest.raises(ValueError, match=r"Invalid references: visible is .* in row 1\. Must be"):
        poles.score(table([[0, 0]]), table([[0, 0], [5, 0]]).assign(visible=[True, said]))
    numbers = table([[0, 0], [5, 0]]).assign(visible=[1, 0])
    assert poles.score(table([[0, 0]]), numbers).recall.n == 1


def test_a_reference_that_is_listed_twice_counts_once():
    truth = table([[0, 0], [5, 0], [0, 0]])
    with pytest.warns(UserWarning, match="1 of 3 references stand at the place of another"):
        found = poles.score(table([[0.1, 0]]), truth)
    assert (found.recall.value, found.recall.n, found.precision.value) == (0.5, 2, 1)


def test_columns_of_the_tables_that_the_score_needs_itself_are_said(recwarn):
    found = pd.DataFrame({"x_m": [0.1, 9.0], "y_m": [0.0, 0.0], "name": ["p", "q"]})
    truth = pd.DataFrame({"x_m": [0.0, 5.0], "y_m": [0.0, 0.0], "seen": ["2021", "2019"]})
    plain = poles.score(found, truth)
    assert not recwarn
    assert plain.targets["seen"].tolist() == ["2021", "2019"]
    own = truth.rename(columns={"seen": "found"}), found.rename(columns={"name": "outcome"})
    with pytest.warns(UserWarning, match="columns found, outcome of their own: those of the score"):
        again = poles.score(own[1], own[0])
    assert again.targets["found"].tolist() == plain.targets["found"].tolist() == [True, False]
