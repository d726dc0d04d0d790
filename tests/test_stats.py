"""Rates and errors: known answers, closed forms, invariance, bad input."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata, spearmanr
from scipy.stats import t as student
from statsmodels.stats.proportion import proportion_confint
from statsmodels.stats.weightstats import DescrStatsW

from mmqa_lab import stats
from mmqa_lab.stats import neighbours


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_is_that_of_statsmodels(kn):
    k, n = kn
    rate = stats.wilson(k, n)
    others = proportion_confint(k, n, method="wilson")
    assert (rate.low, rate.high) == pytest.approx(others, abs=1e-9)
    assert 0 <= rate.low <= rate.value <= rate.high <= 1


def test_errors_of_known_values():
    found = stats.errors([0.0, 2.0, 4.0, np.nan])
    assert (found.n, found.missing, found.bias, found.median) == (3, 1, 2.0, 2.0)
    assert found.std == pytest.approx(2.0)
    assert found.rmse == pytest.approx(np.sqrt(20 / 3))
    assert found.nmad == pytest.approx(2 * 1.4826, rel=1e-4)


def test_one_error_has_no_spread_and_none_has_nothing():
    assert np.isnan(stats.errors([1.0]).std)
    nothing = stats.errors([np.nan])
    assert (nothing.n, nothing.missing) == (0, 1)
    with warnings.catch_warnings(action="error"):
        reach = stats.mean_reach([], np.arange(0))
        assert np.isnan([nothing.rmse, stats.wilson(0, 0).value, reach]).all()


def test_bootstrap_interval_of_a_mean_is_that_of_the_normal_theory(rng):
    values = rng.normal(size=400)
    found = stats.bootstrap(np.mean, values, repeats=2000)
    half = 1.96 * values.std() / 20
    # 2000 resamples know a 2.5 % quantile to about 5 % of the half width
    assert found.high - found.value == pytest.approx(half, rel=0.15)
    assert found.value - found.low == pytest.approx(half, rel=0.15)


def test_reach_of_a_mean_is_students_of_independent_values_and_wider_of_dependent_ones(rng):
    values = rng.normal(0, 1, 30)
    low, high = DescrStatsW(values).tconfint_mean()
    assert stats.mean_reach(values, np.arange(30)) == pytest.approx((high - low) / 2)
    twice = stats.mean_reach(np.repeat(values, 2), np.repeat(np.arange(30), 2))
    assert twice == pytest.approx((high - low) / 2)
    assert np.isnan(stats.mean_reach(values, np.zeros(30, int)))


def test_slow_waves_are_blind_to_trends_and_bowls_but_to_no_place():
    """An error of the few lines in the middle, which decide a median, counts like any other."""
    place = np.linspace(-1, 1, neighbours.WAVE_PARTS)
    np.testing.assert_allclose(neighbours.COSINES @ np.vander(place, 3), 0, atol=1e-9)
    np.testing.assert_allclose((neighbours.COSINES**2).mean(axis=1), 1)
    seen = (neighbours.COSINES**2).mean(axis=0)
    assert seen.min() > 0.3
    assert seen[neighbours.WAVE_PARTS // 4 : -neighbours.WAVE_PARTS // 4].max() < 2


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_waves_have_the_freedom_of_what_whole_lines_share(share):
    """With k waves k degrees for what whole lines share, and k^2 for the rest of the variance."""
    parts, waves = neighbours.WAVE_PARTS, neighbours.COSINES
    count = len(waves)
    scale = ((waves @ waves[0]) ** 2).mean()
    rest = np.outer(waves[0], waves[0]) / scale * np.sqrt(1 - share)
    lines = np.outer(waves[0], np.full(parts, np.sqrt(2 - share)))
    lines /= parts * np.sqrt(scale)  # variance of both ways: the rest is subtracted once
    across, along = (one.ravel() for one in np.indices((parts, parts)))
    found = neighbours._reach_by_waves((lines + rest).reshape(1, -1), across, along)
    freedom = 1 / (share**2 / count + (1 - share) ** 2 / count**2)
    assert found[0] == pytest.approx(stats.student_reach(1.0, freedom))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 3000), st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 3]))
def test_parts_hold_equal_numbers_and_follow_the_order_of_places(n, seed, digits):
    xy = np.random.default_rng(seed).random((n, 2)).round(digits)
    xy[0] = [1e6, -1e6]  # far away from the others
    for parts, places in zip(stats.order_parts(xy, 0), (xy[:, 1], xy[:, 0]), strict=True):
        order = np.argsort(places, kind="stable")
        assert (np.diff(parts[order]) >= 0).all()
        assert set(parts) <= set(range(neighbours.WAVE_PARTS))
        alike = np.unique(places, return_counts=True)[1].max()
        assert np.bincount(parts).max() <= n / neighbours.WAVE_PARTS + alike + 1


def test_means_and_the_next_value_have_students_interval(rng):
    values = rng.normal(5, 2, 12)
    low, high = DescrStatsW(values).tconfint_mean()
    found = stats.mean_interval([*values, np.nan])
    assert (found.low, found.high) == pytest.approx((low, high))
    of_next = stats.mean_interval(values, of_next=True)
    assert of_next.high - of_next.low == pytest.approx((high - low) * np.sqrt(13))
    assert np.isnan(stats.mean_interval([3.0]).low)
    assert np.isnan(stats.student_reach(1.0, 0))


def test_rank_correlations_ignore_order_scale_and_gaps(rng):
    rows, true = rng.normal(size=(2, 40)), rng.normal(size=40)
    rows[0, :5] = np.nan
    found = stats.rank_correlation(rows, true)
    order = rng.permutation(40)
    assert stats.rank_correlation(1e6 * rows[:, order], true[order]) == pytest.approx(found)
    assert found[0] == pytest.approx(spearmanr(rows[0, 5:], true[5:])[0])
    assert np.isnan(stats.rank_correlation(np.ones((1, 40)), true)[0])


def test_infinity_is_a_large_value_in_an_interval_of_a_median():
    values = np.random.default_rng(1).normal(5, 1, 1600)
    block, far = np.arange(1600) % 16, values > 7
    assert far.sum() > 20
    found = stats.median_interval(np.where(far, np.inf, values), block)
    assert found == stats.median_interval(np.where(far, 1e9, values), block)
    ratio = stats.median_ratio_interval(np.where(far, np.inf, values), values + 1, block)
    assert np.isfinite(ratio).all()


def test_parts_in_the_error_of_a_median_are_half_a_sign_less_their_mean(rng):
    rows = rng.normal(size=(2, 31))
    found = neighbours._influence(rows)
    for row, parts in zip(rows, found, strict=True):
        signs = [np.sign(value - np.median(row)) / 2 for value in row]
        assert parts == pytest.approx((np.array(signs) - np.mean(signs)) / 31)
        assert sum(parts) == pytest.approx(0)


def test_the_reach_by_waves_is_that_of_sums_over_waves_one_by_one(rng):
    across, along = rng.integers(0, neighbours.WAVE_PARTS, (2, 200))
    row = rng.normal(size=200)
    by_across, by_along, both = [], [], []
    for one in neighbours.COSINES:
        by_across.append((row * one[across]).sum() ** 2)
        by_along.append((row * one[along]).sum() ** 2)
        both += [(row * one[across] * two[along]).sum() ** 2 for two in neighbours.COSINES]
    n = len(neighbours.COSINES)
    sums, apart = np.mean(by_across) + np.mean(by_along), np.mean(both)
    variance = max(sums - apart, apart)
    share = 1 - apart / variance
    freedom = 1 / (share**2 / n + (1 - share) ** 2 / n**2)
    expected = student.ppf(0.975, freedom) * np.sqrt(variance)
    found = neighbours._reach_by_waves(row[None], across, along)
    assert found[0] == pytest.approx(expected, rel=1e-6)


def shares_of(values, block):
    """Sums over blocks of each value's part in the share below the median, by plain loops."""
    middle, sums = np.median(values), {}
    signs = [np.sign(value - middle) / 2 for value in values]
    for sign, one in zip(signs, block, strict=True):
        sums[one] = sums.get(one, 0) + (sign - np.mean(signs)) / len(values)
    return np.array([sums[one] for one in sorted(sums)])


def median_ends(values, block):
    """The interval of a median by its description."""
    sums = shares_of(values, block)
    n = len(sums)
    reach = student.ppf(0.975, n - 1) * np.sqrt((sums**2).sum() * n / (n - 1))
    ranks = [
        round(min(max(share, 0), 1) * (len(values) - 1)) for share in (0.5 - reach, 0.5 + reach)
    ]
    low, high = np.sort(values)[ranks]
    return min(low, np.median(values)), max(high, np.median(values))


@pytest.mark.parametrize("step", [1e-9, 0.5])
def test_intervals_of_medians_and_of_their_ratio_are_those_of_plain_loops(rng, step):
    values = np.round(rng.exponential(3, (2, 402)) / step) * step + 1  # with and without ties
    values[1] += values[0] / 2
    block = rng.choice([0, 1, 2, 3, 4, 6, 7, 9], 402)  # some have none
    for row in values:
        assert stats.median_interval(row, block) == pytest.approx(median_ends(row, block))
    values[0, :20], values[1, 15:40] = np.nan, np.nan
    known = np.isfinite(values).all(axis=0)
    both, own = values[:, known], block[known]
    sums = np.array([shares_of(row, own) for row in both])
    alike = sums[0] @ sums[1] / np.sqrt((sums[0] @ sums[0]) * (sums[1] @ sums[1]))
    one, two = (np.diff(np.log(median_ends(row, own)))[0] / 2 for row in both)
    reach = np.sqrt(one**2 + two**2 - 2 * alike * one * two)
    ratio = np.nanmedian(values[0]) / np.nanmedian(values[1])
    found = stats.median_ratio_interval(*values, block)
    assert found == pytest.approx((ratio * np.exp(-reach), ratio * np.exp(reach)))


def test_of_two_pairs_of_waves_and_of_few_blocks_the_wider_interval_counts(rng):
    values, ways = rng.normal(size=300), rng.integers(0, neighbours.WAVE_PARTS, (4, 300))
    reaches = [stats.mean_reach(values, pair) for pair in (ways[:2], ways[2:])]
    assert abs(reaches[1] - reaches[0]) > 0.05 * reaches[0]
    assert stats.mean_reach(values, ways) == max(reaches)
    assert stats.mean_reach(values, ways[[2, 3, 0, 1]]) == max(reaches)
    by_hand = stats.mean_reach([1.0, 2, 6], [0, 0, 4])  # sums -1 and 1
    assert by_hand == pytest.approx(student.ppf(0.975, 1) * 2)
    assert np.isnan(stats.median_interval([1.0, 2], [3, 3])).all()
    assert np.isnan(stats.median_ratio_interval([1.0, 2], [3.0, 4], [3, 3])).all()


def test_parts_are_those_of_the_middle_ranks_of_places(rng):
    parts = neighbours.WAVE_PARTS
    for places in (rng.permutation(1500) * 2.0, np.append(rng.integers(0, 40, 900), 1e9)):
        expected = np.floor((rankdata(places) - 0.5) * parts / len(places))
        found = stats.order_parts(np.column_stack([places, 7 - 3 * places]), 90)
        # along the second axis, and across it to the left
        assert np.array_equal(found[1], np.floor((rankdata(-places) - 0.5) * parts / len(places)))
        assert np.array_equal(found[0], np.floor((rankdata(-places) - 0.5) * parts / len(places)))
        turned = stats.order_parts(np.column_stack([places, 7 - 3 * places]), 0)
        assert np.array_equal(turned[1], expected)


def test_a_bootstrap_draws_rows_together_and_takes_the_quantiles_of_what_is_known(rng):
    values, drawn = rng.normal(size=50), []

    def kept(one, other):
        drawn.append(float(np.mean(one)))
        assert np.array_equal(one + 1, other)
        return drawn[-1]

    found = stats.bootstrap(kept, values, values + 1, repeats=400)
    assert drawn[-1] == found.value == values.mean()
    assert (found.low, found.high) == pytest.approx(tuple(np.quantile(drawn[:-1], [0.025, 0.975])))
    assert len(drawn) == 401
    assert len(set(drawn)) > 390
    for known, told in ((49, False), (50, True), (80, True)):
        turns = iter([*[1.0] * known, *[np.nan] * (100 - known), 1.0])
        found = stats.bootstrap(lambda one, turns=turns: next(turns), values, repeats=100)
        assert (found.low == found.high == 1) == told
    assert np.isnan(stats.bootstrap(np.mean, [3.0]).low)


def test_no_trials_have_no_rate_and_no_successes_one():
    assert (stats.wilson(0, 0).k, stats.wilson(0, 0).n) == (0, 0)
    assert (stats.wilson(0, 3).k, stats.wilson(0, 3).value) == (0, 0)
