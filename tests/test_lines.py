"""Segments, their distances and the threshold: golden values, brute force, invariances, rejects."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import find_peaks

from mmqa_lab.lines import (
    Segments,
    components,
    distance_matrix,
    fit_displacement,
    peak_threshold,
)
from mmqa_lab.lines.segments import _first_peak, otsu_threshold

LAMBERT_93 = np.array([651_234.56, 6_862_345.67, 35.0])


def at_random(rng, n, extent=40.0):
    """Segments of 0.5 to 15 m anywhere in a cube."""
    first = rng.uniform(0, extent, (n, 3))
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Segments(np.stack([first, first + direction * rng.uniform(0.5, 15, (n, 1))], axis=1))


def rotation(rng):
    """A random rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.diag(r)) * np.linalg.det(q * np.sign(np.diag(r)))


def transcribed(test, model, weight=1.0):
    """The distance as section 2.2 tells it: turn the test line, sort the ends, compare them."""
    (a, b), (c, d) = test, model
    t, m = b - a, d - c
    lengths = np.linalg.norm(t), np.linalg.norm(m)
    e = m / lengths[1]
    cosine = abs(t @ e) / lengths[0]
    angle = np.arctan2(np.linalg.norm(np.cross(t / lengths[0], e)), cosine)
    d_theta = min(lengths) * np.sin(angle)
    middle = (a + b) / 2
    turned = [middle - e * lengths[0] / 2, middle + e * lengths[0] / 2]  # now parallel to the model
    left, right = sorted((p - c) @ e for p in turned)
    low, high = sorted((p - c) @ e for p in (c, d))
    inside = (left >= low and right <= high) or (low >= left and high <= right)
    d_par = 0.0 if inside else min(abs(left - low), abs(right - high))
    across = (middle - c) - ((middle - c) @ e) * e
    d_perp = np.linalg.norm(across)
    return d_theta, d_par, d_perp, np.sqrt(weight * d_theta**2 + d_par**2 + d_perp**2)


GOLDEN = [
    ("parallel, 1 m apart", [[0, 0, 0, 10, 0, 0]], [[0, 1, 0, 10, 1, 0]], (0, 0, 1, 1)),
    ("contained", [[2, 0.5, 0, 6, 0.5, 0]], [[0, 0, 0, 10, 0, 0]], (0, 0, 0.5, 0.5)),
    ("slipped by 3 m", [[3, 0, 0, 13, 0, 0]], [[0, 0, 0, 10, 0, 0]], (0, 3, 0, 3)),
    ("beyond the end", [[20, 0, 0, 25, 0, 0]], [[0, 0, 0, 10, 0, 0]], (0, 15, 0, 15)),
    ("crossing", [[-2, 0, 0, 2, 0, 0]], [[0, -5, 0, 0, 5, 0]], (4, 0, 0, 12.649111)),
    ("antiparallel", [[0.3, 0.4, 11, 0.3, 0.4, 1]], [[0, 0, 0, 0, 0, 12]], (0, 0, 0.5, 0.5)),
]


@pytest.mark.parametrize(("test", "model", "expected"), [case[1:] for case in GOLDEN])
def test_golden_pairs(test, model, expected):
    parts = components(test, model)
    values = [parts.angle, parts.parallel, parts.perpendicular, parts.distance(10)]
    assert [v.item() for v in values] == pytest.approx(expected, abs=1e-6)
    assert distance_matrix(test, model).item() == pytest.approx(expected[3], abs=1e-6)


def test_one_degree_on_ten_metres_half_a_metre_up():
    half = 5 * np.array([np.cos(np.radians(1)), 0, np.sin(np.radians(1))])
    up = np.array([0, 0, 0.5])
    parts = components([[up - half, up + half]], [[[-5, 0, 0], [5, 0, 0]]])
    values = [parts.angle, parts.parallel, parts.perpendicular, parts.distance(10)]
    assert [v.item() for v in values] == pytest.approx([0.174524, 0, 0.5, 0.744706], abs=1e-6)


@pytest.mark.parametrize("weight", [0.0, 1.0, 10.0])
def test_closed_form_is_the_transcription(rng, weight):
    test, model = at_random(rng, 25), at_random(rng, 20)
    parts = components(test, model)
    for i, j in np.ndindex(25, 20):
        expected = transcribed(test.ends[i], model.ends[j], weight)
        found = parts.angle[i, j], parts.parallel[i, j], parts.perpendicular[i, j]
        # both take some twenty roundings of numbers up to 70 m
        assert (*found, parts.distance(weight)[i, j]) == pytest.approx(expected, abs=1e-11)


def test_matrix_and_components_agree(rng):
    test, model = at_random(rng, 30), at_random(rng, 41)
    for choices in ({}, {"rotate": "shorter"}, {"within": "overlap"}):
        expected = components(test, model, **choices).distance(7.0)
        found = distance_matrix(test, model, weight=7.0, **choices)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_blocks_of_rows_change_nothing(rng, monkeypatch):
    test, model = at_random(rng, 60), at_random(rng, 50)
    whole = distance_matrix(test, model)
    monkeypatch.setattr("mmqa_lab.lines.segments.BLOCK_PAIRS", 120)
    np.testing.assert_array_equal(distance_matrix(test, model), whole)


def test_shorter_line_turned_is_symmetric(rng):
    test, model = at_random(rng, 30), at_random(rng, 30)
    there = distance_matrix(test, model, rotate="shorter")
    back = distance_matrix(model, test, rotate="shorter")
    np.testing.assert_allclose(there, back.T, atol=1e-11)
    literal = distance_matrix(test, model), distance_matrix(model, test)
    assert np.abs(literal[0] - literal[1].T).max() > 0.1  # the paper's reading is not


def test_any_overlap_has_no_parallel_distance():
    test, model = [[[8, 0, 0], [14, 0, 0]]], [[[0, 0, 0], [10, 0, 0]]]
    assert components(test, model).parallel.item() == 4.0
    assert components(test, model, within="overlap").parallel.item() == 0.0


def lengthened(ends):
    """Segments, those shorter than 0.1 m made 1 m long."""
    short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) <= 0.1
    ends[short, 1] = ends[short, 0] + [1.0, 0.0, 0.0]
    return ends


ENDS = arrays(np.float64, (6, 2, 3), elements=st.floats(-50, 50, allow_nan=False, width=32))
ENDS = ENDS.map(lengthened)


@settings(max_examples=40, deadline=None)
@given(ENDS, ENDS, st.integers(0, 2**12 - 1))
def test_the_order_of_ends_is_of_no_account(test, model, flips):
    flip = np.array([flips >> k & 1 for k in range(12)], dtype=bool)
    turned = [test.copy(), model.copy()]
    turned[0][flip[:6]] = turned[0][flip[:6], ::-1]
    turned[1][flip[6:]] = turned[1][flip[6:], ::-1]
    # the projections change by some roundings of 150 m
    np.testing.assert_allclose(
        distance_matrix(*turned), distance_matrix(test, model), rtol=0, atol=1e-9
    )


@settings(max_examples=40, deadline=None)
@given(ENDS, ENDS, st.integers(0, 1000))
def test_rigid_motion_scale_and_a_far_origin(test, model, seed):
    rng = np.random.default_rng(seed)
    test, model = Segments(test), Segments(model)
    expected = distance_matrix(test, model)
    turn, shift = rotation(rng), rng.uniform(-100, 100, 3)
    moved = [one.transformed(turn, shift) for one in (test, model)]
    np.testing.assert_allclose(distance_matrix(*moved), expected, rtol=0, atol=1e-9)
    far = [one.moved(LAMBERT_93) for one in (test, model)]
    # the coordinates themselves are rounded to 5e-10 m; short segments turn by that over 0.1 m
    assert np.abs(distance_matrix(*far) - expected).max() < 1e-8 * 50
    grown = [Segments(3 * one.ends) for one in (test, model)]
    np.testing.assert_allclose(distance_matrix(*grown), 3 * expected, rtol=1e-9, atol=1e-9)


def test_building_edges_at_lambert_93_keep_their_distance_to_1e_8_m(rng):
    test, model = at_random(rng, 40), at_random(rng, 40)
    far = [one.moved(LAMBERT_93) for one in (test, model)]
    assert np.abs(distance_matrix(*far) - distance_matrix(test, model)).max() < 1e-8


@settings(max_examples=30, deadline=None)
@given(ENDS, ENDS, st.floats(0, 50), st.floats(0, 50))
def test_a_larger_weight_never_shortens(test, model, first, second):
    parts = components(test, model)
    low, high = sorted((first, second))
    assert (parts.distance(low) <= parts.distance(high)).all()


def test_a_displacement_of_equal_segments_is_the_distance(rng):
    model = at_random(rng, 12)
    for vector in rng.normal(size=(5, 3)):
        there = distance_matrix(model.moved(vector), model).diagonal()
        np.testing.assert_allclose(there, np.linalg.norm(vector), atol=1e-12)


def test_accepted_shapes_and_derived_values():
    rows = np.array([[0, 0, 0, 3, 4, 0], [1, 1, 1, 1, 1, 3.0]])
    for values in (rows, rows.reshape(2, 2, 3), rows.tolist()):
        one = Segments(values)
        assert one.lengths.tolist() == [5.0, 2.0]
        assert one.midpoints.tolist() == [[1.5, 2, 0], [1, 1, 2]]
        assert one.directions[0].tolist() == [0.6, 0.8, 0.0]
    flat = Segments([[0, 0, 3, 4]])
    assert flat.ends.shape == (1, 2, 3)
    assert len(Segments(np.empty((0, 2, 3)))) == 0
    assert len(Segments([])) == 0


@pytest.mark.parametrize(
    ("values", "kind", "said"),
    [
        ([[[0, 0, 0], [0, 0, 0]]], ValueError, "no length in row 0"),
        ([[[0, 0, 0], [0, 0, np.inf]]], ValueError, "not finite in row 0"),
        (np.zeros((3, 5)), ValueError, r"shape \(3, 5\)"),
        (np.zeros((3, 3, 2)), ValueError, r"shape \(3, 3, 2\)"),
        (np.zeros(6), ValueError, r"shape \(6,\)"),
        ([["a"] * 6], TypeError, "Must be real numbers"),
        (np.ones((1, 6), dtype=complex), TypeError, "Must be real numbers"),
        (np.float32([[6e6, 0, 0, 6e6, 9, 0]]), ValueError, "float32.*6000000 m"),
    ],
)
def test_bad_segments_are_refused(values, kind, said):
    with pytest.raises(kind, match=said):
        Segments(values)


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ([[0, 0, 0, 5000, 0, 0]], "millimetres"),
        ([[2.35, 48.85, 0, 2.3501, 48.85, 0]], "geographic degrees"),
        ([[651, 6862, 0, 651.003, 6862, 0]], "kilometres"),
    ],
)
def test_other_units_are_suspected(ends, said):
    with pytest.warns(UserWarning, match=said):
        Segments(ends)


@pytest.mark.parametrize("weight", [-1, np.nan, np.inf])
def test_bad_weights_are_refused(weight):
    with pytest.raises(ValueError, match="Invalid weight"):
        distance_matrix([[0, 0, 0, 1, 0, 0]], [[0, 0, 0, 1, 0, 0]], weight=weight)


def test_unknown_choices_are_refused():
    one = [[0, 0, 0, 1, 0, 0]]
    with pytest.raises(ValueError, match="Must be one of test, shorter"):
        components(one, one, rotate="longer")
    with pytest.raises(ValueError, match="Must be one of containment, overlap"):
        components(one, one, within="touch")


NEAREST = [0.31, 0.33, 0.36, 0.40, 0.41, 0.47, 0.52, 0.55, 3.2, 4.1, 7.7]


def test_golden_threshold(rng):
    found = peak_threshold(rng.permutation(NEAREST), sensitivity=0.5)
    assert found.delta == 0.55
    assert not found.fallback


def test_first_differences_see_the_same_jump():
    assert peak_threshold(NEAREST, order=1).delta == 0.55


@given(st.lists(st.integers(-40, 40), max_size=40), st.integers(1, 30))
def test_the_first_peak_is_that_of_scipy(heights, prominence):
    curve = 0.1 * np.array(heights) + 1e-6 * np.arange(len(heights))  # none equal
    padded = np.concatenate([[-np.inf], curve, [0.0]])
    peaks = find_peaks(padded, prominence=0.1 * prominence + 1e-4)[0] - 1
    first = next((peak for peak in peaks if curve[peak] > 0), None)
    assert _first_peak(curve, 0.1 * prominence + 1e-4) == first


def test_a_jump_in_the_last_place_is_found():
    assert peak_threshold([0.1, 0.12, 0.13, 0.15, 9.0]).delta == 0.15


@pytest.mark.parametrize("nearest", [[], [0.3], [0.3, 0.4], [0.1, 0.2, 0.3, 0.4]])
def test_without_a_jump_the_fallback_is_flagged(nearest):
    found = peak_threshold(nearest)
    assert found.fallback
    np.testing.assert_equal(found.delta, max(nearest, default=np.nan))


def test_two_clusters_are_split(rng):
    near, far = rng.lognormal(-1, 0.3, 40), rng.lognormal(2, 0.4, 25)
    both = np.concatenate([near, far])
    assert near.max() <= otsu_threshold(both).delta < far.min()
    assert otsu_threshold([]).fallback


def peak_by_hand(curve, sensitivity):
    """A running maximum is a peak once the curve, zero behind its end, falls by more than that."""
    high, low, place, climbing = -np.inf, np.inf, 0, True
    for index, value in enumerate([*curve, 0.0]):
        low = min(low, value)
        if value > high:
            high, place = value, index
        if climbing and value < high - sensitivity:
            if high > 0:
                return place
            low, climbing = value, False
        elif not climbing and value > low + sensitivity:
            high, place, climbing = value, index, True
    return None


@pytest.mark.parametrize("sensitivity", [0.1, 0.5, 2.0])
def test_the_peak_is_that_of_a_running_maximum(rng, sensitivity):
    for _ in range(100):
        nearest = np.sort(rng.lognormal(0, 1.2, 30))
        peak = peak_by_hand(np.diff(nearest, 2), sensitivity)
        found = peak_threshold(nearest, sensitivity=sensitivity)
        assert found.fallback == (peak is None)
        assert found.delta == nearest[-1 if peak is None else peak + 1]


def test_three_values_are_split_where_the_classes_differ_most(rng):
    values = np.sort(rng.lognormal(0, 1.2, 3))
    logs = np.log(values)

    def between(k):
        low, high = logs[:k], logs[k:]
        return len(low) * len(high) * (low.mean() - high.mean()) ** 2

    best = max(range(1, 3), key=between)
    assert otsu_threshold(values).delta == values[best - 1]


@pytest.mark.parametrize("nearest", [[0.1, np.nan], [-0.1, 0.2], [[0.1, 0.2]]])
def test_bad_nearest_distances_are_refused(nearest):
    with pytest.raises(ValueError, match="Invalid nearest distances"):
        peak_threshold(nearest)


@pytest.mark.parametrize(
    "choices", [{"sensitivity": 0}, {"sensitivity": -1}, {"order": 3}, {"at": "top"}]
)
def test_bad_threshold_settings_are_refused(choices):
    with pytest.raises(ValueError, match="Invalid"):
        peak_threshold(NEAREST, **choices)


def test_warnings_name_no_unit_for_plain_buildings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Segments([[0, 0, 0, 0, 0, 12]])


def test_segments_and_their_displacement_are_tables_and_pictures():
    ends = np.array([[[0, 0, 0], [0, 0, 7]], [[5, 0, 0], [5, 9, 0]], [[9, 0, 4], [1, 0, 4.0]]])
    sets = Segments(ends), Segments(ends).moved([0.3, 0, 0.1])
    assert sets[0].to_frame()["length_m"].tolist() == [7, 9, 8]
    assert len(sets[0].plot().lines) == 3
    found = fit_displacement(sets[1], sets[0], np.eye(3, dtype=bool)).to_frame().set_index("figure")
    assert found["value"].iloc[:3].to_numpy() == pytest.approx([0.3, 0, 0.1])
    assert (found["high"] - found["low"]).to_numpy() == pytest.approx(2 * 1.96 * found["std"])
    parts = components(*sets).to_frame()
    assert parts.query("test_segment == model_segment")["angle_m"].max() == pytest.approx(0)
