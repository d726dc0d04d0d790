"""Segments, their distances and the threshold: golden values, brute force, invariances, rejects."""

import itertools
import re
import subprocess
import sys
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
import window_rows
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mmqa_lab.lines import (
    components,
    correspond,
    directions,
    fit_displacement,
    lengths,
    match_displaced,
    midpoints,
    pairing_scores,
    peak_threshold,
    segments,
)
from mmqa_lab.lines import displacement_search as search
from mmqa_lab.lines.pairing import MATCHERS, _is_free, paired

LAMBERT_93 = np.array([651_234.56, 6_862_345.67, 35.0])


def at_random(rng, n, extent=40.0):
    """Segments of 0.5 to 15 m anywhere in a cube."""
    first = rng.uniform(0, extent, (n, 3))
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.stack([first, first + direction * rng.uniform(0.5, 15, (n, 1))], axis=1)


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
    test, model = (np.reshape(ends, (1, 2, 3)) for ends in (test, model))
    parts = components(test, model)
    values = [parts.angle, parts.parallel, parts.perpendicular, parts.distance(10)]
    assert [v.item() for v in values] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("weight", [0.0, 1.0, 10.0])
def test_closed_form_is_the_transcription(rng, weight):
    test, model = at_random(rng, 25), at_random(rng, 20)
    parts = components(test, model)
    for i, j in np.ndindex(25, 20):
        expected = transcribed(test[i], model[j], weight)
        found = parts.angle[i, j], parts.parallel[i, j], parts.perpendicular[i, j]
        # both take some twenty roundings of numbers up to 70 m
        assert (*found, parts.distance(weight)[i, j]) == pytest.approx(expected, abs=1e-11)


def test_blocks_of_rows_change_nothing(rng, monkeypatch):
    test, model = at_random(rng, 60), at_random(rng, 50)
    whole = components(test, model).distance(10)
    monkeypatch.setattr("mmqa_lab.lines.segments.BLOCK_PAIRS", 120)
    np.testing.assert_array_equal(components(test, model).distance(10), whole)


def test_shorter_line_turned_is_symmetric(rng):
    test, model = at_random(rng, 30), at_random(rng, 30)
    there = components(test, model, rotate="shorter").distance(10)
    back = components(model, test, rotate="shorter").distance(10)
    np.testing.assert_allclose(there, back.T, atol=1e-11)
    literal = components(test, model).distance(10), components(model, test).distance(10)
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
        components(*turned).distance(10), components(test, model).distance(10), rtol=0, atol=1e-9
    )


@settings(max_examples=40, deadline=None)
@given(ENDS, ENDS, st.integers(0, 1000))
def test_rigid_motion_scale_and_a_far_origin(test, model, seed):
    rng = np.random.default_rng(seed)
    expected = components(test, model).distance(10)
    turn, shift = rotation(rng), rng.uniform(-100, 100, 3)
    moved = [ends @ turn.T + shift for ends in (test, model)]
    np.testing.assert_allclose(components(*moved).distance(10), expected, rtol=0, atol=1e-9)
    far = [ends + LAMBERT_93 for ends in (test, model)]
    # the coordinates themselves are rounded to 5e-10 m; short segments turn by that over 0.1 m
    assert np.abs(components(*far).distance(10) - expected).max() < 1e-8 * 50
    grown = [3 * test, 3 * model]
    np.testing.assert_allclose(components(*grown).distance(10), 3 * expected, rtol=1e-9, atol=1e-9)


def test_a_displacement_of_equal_segments_is_the_distance(rng):
    model = at_random(rng, 12)
    for vector in rng.normal(size=(5, 3)):
        there = components(model + vector, model).distance(10).diagonal()
        np.testing.assert_allclose(there, np.linalg.norm(vector), atol=1e-12)


@pytest.mark.parametrize("nearest", [[], [0.3], [0.3, 0.4], [0.1, 0.2, 0.3, 0.4]])
def test_without_a_jump_the_fallback_is_flagged(nearest):
    found = peak_threshold(nearest)
    assert found.fallback
    np.testing.assert_equal(found.delta, max(nearest, default=np.nan))


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


def test_importing_the_lines_leaves_signal_processing_out():
    code = "import sys, mmqa_lab.lines; sys.exit('scipy.signal' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(MATCHERS), st.floats(0, 1e7))
def test_pairs_depend_neither_on_the_order_of_rows_nor_on_the_origin(seed, matcher, shift):
    rng = np.random.default_rng(seed)
    test, model, _, _ = window_rows.scene(seed % 50, share=0.3, length=10.0, shift=0.3)
    rows, columns = rng.permutation(len(test)), rng.permutation(len(model))

    def paired(test, model):
        choices = {"matcher": matcher, "test": test, "model": model}
        return correspond(components(test, model).distance(10), 1.0, **choices)

    once, again = paired(test, model), paired(test[rows] + shift, model[columns] + shift)
    assert (once[np.ix_(rows, columns)] == again).all()


@settings(max_examples=5, deadline=None, phases=[Phase.generate])
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e3, 1e7]), st.sampled_from([1e3, 1e6, 1e9]))
def test_copies_far_lines_order_and_origin_do_not_change_a_displacement(seed, shift, far):
    """Any line given again, either way round; lines far away in each set; rows in any order."""
    rng = np.random.default_rng(seed)
    test, model, _, _ = window_rows.scene(seed % 40, share=0.5, length=12.0, drift=0.2)
    once = match_displaced(test, model)
    kept, others = [], []
    for ends, side in ((test, far), (model, -far)):
        again = rng.integers(0, len(ends), rng.integers(0, 2 * len(ends)))
        away = ends[:2] + far * rng.choice([-1, 0, 1], (2, 1, 3)) * [1, 0, 1] + [0, side, 0]
        more = np.concatenate([ends, ends[again][:, ::-1], away])
        order = rng.permutation(len(more))
        others.append(more[order] + shift)
        kept.append(np.concatenate([np.arange(len(ends)), again, [-1, -1]])[order])
    tracemalloc.start()
    found = match_displaced(*others)
    assert tracemalloc.get_traced_memory()[1] < 2e8
    tracemalloc.stop()
    rows, columns = (kept[k][index] for k, index in enumerate(np.nonzero(found.pairs)))
    pairs = sorted(zip(rows.tolist(), columns.tolist(), strict=True))
    assert pairs == [tuple(pair) for pair in np.argwhere(once.pairs).tolist()]
    np.testing.assert_allclose(found.vector, once.vector, atol=1e-5)
    np.testing.assert_allclose(found.covariance, once.covariance, rtol=1e-3, atol=1e-9)


def test_a_long_street_needs_little_memory():
    """3 km: the displacement sought at its ends does not grow with the street."""
    along = np.arange(0, 3000, 10.0)[:, None, None] * [0, 1, 0]
    posts = (
        along
        + np.array([[0, 0, 0], [0, 0, 5]])
        + np.random.default_rng(1).uniform(0, 3, (300, 1, 3))
    )
    ledges = posts[:, :1] + np.array([[0, 0, 0], [0, 4, 0]])
    model = np.concatenate([posts, ledges])
    tracemalloc.start()
    found = match_displaced(model + [2.0, -1.0, 0.5], model)
    assert tracemalloc.get_traced_memory()[1] < 3e8
    tracemalloc.stop()
    np.testing.assert_allclose(found.vector, [2.0, -1.0, 0.5], atol=1e-3)
    assert found.n >= 590


@pytest.mark.parametrize("radius", [0, -1.0, 21.0, np.nan])
def test_a_radius_that_no_memory_holds_is_refused(radius):
    line = [[[0, 0, 0], [0, 0, 9]]]
    with pytest.raises(ValueError, match="Invalid radius"):
        match_displaced(line, line, radius=radius)


def test_few_common_lines_are_matched_rightly_or_refused_with_a_sentence():
    """A seventh to a quarter of the lines are common, among equal windows."""
    answered = 0
    for seed in range(30_000, 30_008):
        share, length = (0.17, 60.0) if seed % 2 else (0.3, 25.0)
        test, model, truth, _ = window_rows.scene(seed, length=length, share=share)
        found = match_displaced(test, model)
        if found.n:
            answered += 1
            assert pairing_scores(found.pairs, truth).f1 > 0.9
            few = f"Only {found.n} of {min(truth.shape)} lines are paired"
            assert any(one.startswith(few) for one in found.remarks) == (
                found.n < 0.4 * min(truth.shape)
            )
        else:
            assert re.search("may be chance|nearly as well", found.remarks[0])
            assert "remarks" in found.to_frame()
    assert answered >= 4


@pytest.mark.parametrize(("seed", "share"), [(30_001, 0.17), (30_004, 0.1), (30_006, 0.1)])
def test_few_pairs_that_chance_can_give_are_no_answer(seed, share):
    """Without the rule 8 of 37, 4 of 23 and 4 of 30 lines are paired, most of them wrongly."""
    found = match_displaced(*window_rows.scene(seed, length=25.0, share=share)[:2])
    assert found.n == 0
    assert "may be chance" in found.remarks[0]


def test_a_pair_without_a_common_stretch_is_free_only_where_nothing_is_taken():
    stretches = np.array([[0.0, 1.0], [1.2, 1.2]])
    order, before = np.array([0]), np.array([-1])
    assert _is_free(stretches, 1, -1, order, before)
    assert not _is_free(stretches, 1, 0, order, before)


def test_reasons_for_no_displacement_are_said():
    rng = np.random.default_rng(0)
    lines = at_random(rng, 12)
    assert match_displaced(lines[:2], lines).remarks == ("Fewer than three lines.",)
    away = match_displaced(lines + [0, 0, 90.0], lines).remarks[0]
    assert away == "Fewer than three lines have a parallel one within 4 m."
    same = match_displaced(lines, lines)
    assert (same.n, same.remarks) == (12, ())
    assert "remarks" not in same.to_frame()


def test_equal_bays_give_no_answer_a_bay_aside():
    """Columns 3.2 m apart, a thin and a dense survey: other bays explain nearly as much."""
    for seed in range(3):
        rng = np.random.default_rng([seed, 32])
        column = np.array([[[0, 0, 0], [0, 0, 3.6]], [[0, 0.5, 0], [0, 0.5, 3.6]]])
        beam = np.array([[[0, 0.9, 4.6], [0, 2.6, 4.6]], [[0, 0.9, 6.4], [0, 2.6, 6.4]]])
        steps = [[side, 3.2 * k, 0] for side in (-7.5, 7.5) for k in range(16)]
        every = np.concatenate([np.concatenate([column, beam]) + step for step in steps])
        model = every[rng.random(len(every)) < 0.85]
        test = every[rng.random(len(every)) < 0.35] + [1.0, -2.4, 0.0]
        test, model = (ends + rng.normal(0, 0.02, ends.shape) for ends in (test, model))
        found = match_displaced(test, model)
        assert found.n == 0 or np.linalg.norm(found.vector - [1.0, -2.4, 0.0]) < 0.3


def test_lines_that_are_there_twice_make_no_displacement_surer(rng):
    model = rng.uniform(0, 20, (12, 2, 3))
    test, pairs = model + [0.3, 0, 0.1] + rng.normal(0, 0.05, model.shape), np.eye(12, dtype=bool)
    once = fit_displacement(test, model, pairs)
    often = fit_displacement(np.tile(test, (3, 1, 1)), model, np.tile(pairs, (3, 1)))
    np.testing.assert_allclose(often.covariance, once.covariance, rtol=0.3)
    with pytest.raises(ValueError, match="Invalid pairs"):
        fit_displacement(test, model, [[0, 0], [1, 1]])


def test_whole_numbers_have_the_lengths_of_their_values():
    ends = np.array([[[5, 0, 0], [0, 0, 0]]], dtype=np.uint16)
    assert lengths(ends).tolist() == [5]
    assert directions(ends).tolist() == [[-1, 0, 0]]
    assert midpoints(ends).tolist() == [[2.5, 0, 0]]
    with pytest.raises(ValueError, match="Invalid distances"):
        correspond([[np.nan, 1.0]], 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_best_path_is_that_of_all_paths(seed, uncompiled):
    uncompiled(search)
    rng = np.random.default_rng(seed)
    shape, inner = (6, 6, 6), np.s_[2:4, 2:4, 2:4]
    votes = np.full((3, *shape), -np.inf, np.float32)
    votes[(slice(None), *inner)] = rng.integers(0, 8, (3, 2, 2, 2))
    one, two = np.float32(0.5), np.float32(2.5)
    strides = 1, 6, 36
    path, total = search._best_path(votes.reshape(3, -1), strides, one, two)
    places = list(np.argwhere(np.isfinite(votes[0])))

    def worth(way):
        moved = np.abs(np.diff(way, axis=0))
        costs = np.select([moved == 0, moved == 1, moved == 2], [0, one, two], np.inf).sum()
        return sum(votes[(k, *place)] for k, place in enumerate(way)) - costs

    best = max(worth(np.array(way)) for way in itertools.product(places, repeat=3))
    assert total == pytest.approx(best)
    assert worth(np.array(np.unravel_index(path, shape)).T) == pytest.approx(best)


def test_moves_near_a_path_are_forbidden_and_planes_vote_for_moves_across_them(rng, uncompiled):
    uncompiled(search)
    moves = 0.3 * (np.indices((5, 5, 5)).reshape(3, -1).T - 2.0)
    votes = np.zeros((2, 125), np.float32)
    search._forbid_around(votes, moves, np.array([62, 0]))
    for station, middle in enumerate(moves[[62, 0]]):
        near = np.linalg.norm(moves - middle, axis=1) < search.ELSEWHERE_M
        assert np.array_equal(np.isinf(votes[station]), near)
    frame, half = np.array([[0, 0.6, 0.8], [1.0, 0, 0]]), 4
    planes = rng.random((2, 81)).astype(np.float32)
    given = votes.copy()
    search._add_planes(votes, planes, moves / 0.3, frame, half)
    across, up = np.rint(moves / 0.3 @ frame.T).astype(int).T + half
    expected = planes.reshape(2, 9, 9)[:, across, up]
    assert votes == pytest.approx(np.where(np.isinf(given), -np.inf, expected))


def test_what_is_felt_at_a_place_is_less_with_distance_and_comes_from_others(rng, uncompiled):
    uncompiled(search)
    places, members = rng.uniform(0, 60, (7, 3)), np.array([1, 4, 6])
    parts = rng.normal(size=(12, 3))
    found = search._felt(places, members, parts)
    for n in range(7):
        gaps = np.linalg.norm(places[members] - places[n], axis=1)
        shares = np.where(members == n, 0, np.exp(-gaps / 20))
        assert found[n] == pytest.approx(parts @ shares)


def test_ends_that_agree_speak_for_a_pair_as_their_densities_say():
    gaps = np.array([[0.0, 0.1], [0.4, 0.4], [3.0, 9.0]])
    half_t, half_m = np.array([2.0, 2.0, 2.0]), np.array([1.5, 1.5, 1.5])
    # the ends are along - half_t + half_m and along + half_t - half_m apart
    half_m = half_t - (gaps[:, 1] - gaps[:, 0]) / 2
    lines = SimpleNamespace(half=(half_t, half_m), along=gaps.mean(axis=1))
    share = search.ENDS_AGREE

    def ratio(gap):
        agree = np.exp(-gap / search.END_M) / search.END_M
        return np.log((share * agree + (1 - share) * search.CLUTTER_ENDS_PER_M)
                      / search.CLUTTER_ENDS_PER_M)  # fmt: skip

    expected = np.maximum(ratio(gaps).sum(axis=1), 0)
    assert search._agreement(lines) == pytest.approx(expected)
    assert expected[0] > 2.9
    assert expected[2] == 0


def test_a_displacement_that_drifts_and_turns_is_found_between_lines(rng, uncompiled):
    uncompiled(search)
    places = np.column_stack([rng.uniform(0, 120, 40), rng.uniform(-8, 8, 40), np.zeros(40)])
    ends = np.stack([places, places + [0, 0, 4]], axis=1)
    walls = np.stack([places + [0, 0, 4], places + [3, 0, 4]], axis=1)
    model = np.concatenate([ends, walls])
    moved = model.mean(axis=1)
    turn, drift = 0.002, 0.01 * np.sin(moved[:, 0] / 40)[:, None] * [0, 1, 0]
    arm = moved - moved.mean(axis=0)
    shift = [0.2, -0.1, 0.05] + turn * np.column_stack([-arm[:, 1], arm[:, 0], 0 * arm[:, 0]])
    rows = np.arange(len(model))
    lines = paired(model + (shift + drift)[:, None], model, rows, rows)
    found = search._field(lines, np.zeros((len(rows), 3)), rows, 0.03)
    assert np.abs(found - shift - drift).max() < 0.01


def test_parts_of_the_distance_are_those_of_vectors(rng, uncompiled):
    uncompiled(segments)
    test, model = rng.normal(size=(5, 2, 3)), rng.normal(size=(6, 2, 3))
    for shorter, within in ((False, "containment"), (True, "overlap")):
        rotate = "shorter" if shorter else "test"
        parts = components(test, model, rotate=rotate, within=within)
        for i, j in np.ndindex(5, 6):
            (a, u), (b, v) = ((one.mean(axis=0), one[1] - one[0]) for one in (test[i], model[j]))
            p, q = np.linalg.norm(u), np.linalg.norm(v)
            angle = np.arccos(np.clip(abs(u @ v) / p / q, -1, 1))
            fixed = u / p if shorter and q < p else v / q
            s = (a - b) @ fixed
            beside = np.linalg.norm(a - b - s * fixed)
            apart = max(abs(s) - abs(p - q) / 2, 0)
            apart = 0 if within == "overlap" and abs(s) < (p + q) / 2 else apart
            found = [getattr(parts, name)[i, j]
                     for name in ("angle", "parallel", "perpendicular", "shift")]  # fmt: skip
            assert found == pytest.approx([min(p, q) * np.sin(angle), apart, beside, s])
