"""Intervals against resampling by hand, exact enumeration and their promises about few seeds."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from qdil.evidence import stats

ARM = st.lists(st.integers(-1000, 1000).map(float), min_size=2, max_size=6)


def test_two_seeds_against_two_span_all_that_can_be_drawn():
    # Each end is one of 16 equally likely resamples, more than the 2.5 % cut off.
    assert stats.difference([5.0, 9.0], [1.0, 2.0]) == pytest.approx((5.5, 5.0 - 2.0, 9.0 - 1.0))


def test_intervals_are_quantiles_of_every_possible_resample():
    ours, reference = np.array([3.0, 7.0, 20.0, 4.0]), np.array([1.0, 6.0, 8.0])
    means = [np.mean(list(itertools.product(arm, repeat=len(arm))), axis=1) for arm in (ours, reference)]
    exact = np.percentile(np.subtract.outer(*means), [2.5, 97.5])
    found = stats.difference(ours, reference)
    assert found.estimate == ours.mean() - reference.mean()
    assert found[1:] == pytest.approx(exact, abs=0.25)


def test_intervals_are_those_of_resampling_by_hand():
    rng = np.random.default_rng(1)
    ours, reference = rng.gamma(2.0, 3.0, 9), rng.normal(4.0, 1.0, 7)
    draws = [rng.choice(ours, len(ours)).mean() - rng.choice(reference, len(reference)).mean() for _ in range(20_000)]
    found = stats.difference(ours, reference)
    assert found[1:] == pytest.approx(np.percentile(draws, [2.5, 97.5]), abs=0.03 * (found.high - found.low))


@given(st.lists(ARM, min_size=1, max_size=3))
def test_intervals_are_scipys(arms):
    def statistic(*samples, axis):
        return sum(factor * np.mean(sample, axis=axis) for factor, sample in enumerate(samples, start=1))

    found = stats.contrast(arms, statistic, seed=3)
    rng = np.random.default_rng(3)
    of_scipy = scipy_stats.bootstrap(
        arms, statistic, n_resamples=stats.RESAMPLES, method="percentile", vectorized=True, rng=rng
    ).confidence_interval
    assert found[1:] == pytest.approx((of_scipy.low, of_scipy.high))


@given(ARM, ARM)
def test_intervals_hold_the_plain_difference_and_swap_sign_with_the_arms(ours, reference):
    found, swapped = stats.difference(ours, reference), stats.difference(reference, ours)
    plain = np.mean(ours) - np.mean(reference)
    assert found.low - 1e-9 <= plain <= found.high + 1e-9
    assert found.estimate == pytest.approx(plain)
    assert ours == reference or swapped == (-found.estimate, -found.high, -found.low)


def test_the_same_runs_always_give_the_same_interval():
    arms = [1.0, 2.0, 4.0], [0.0, 3.0, 5.0]
    first = stats.difference(*arms)
    stats.difference([7.0, 9.0], [1.0, 2.0])  # no state is carried from one to the next
    assert stats.difference(*arms) == first


@pytest.mark.parametrize("ours, reference", [([3.0], [1.0, 2.0]), ([3.0, 4.0], [1.0]), ([3.0], [1.0])])
def test_one_seed_has_an_estimate_and_no_interval(ours, reference):
    found = stats.difference(ours, reference)
    assert found.estimate == np.mean(ours) - np.mean(reference) and not found.known()


@pytest.mark.parametrize("ours", [[], [1.0, np.nan, 2.0], [1.0, np.inf]])
def test_empty_arms_and_values_that_are_not_finite_have_no_estimate(ours):
    assert np.isnan(stats.difference(ours, [1.0, 2.0])).all()
    assert np.isnan(stats.bootstrap_interval(ours)).all()


def test_identical_seeds_have_an_interval_without_width():
    assert stats.difference([2.0] * 3, [5.0] * 3) == (-3.0, -3.0, -3.0)


@given(st.lists(st.integers(-50, 50).map(float), min_size=1, max_size=23))
def test_the_interquartile_mean_drops_a_quarter_from_either_end(values):
    cut = len(values) // 4
    assert stats.iqm(values) == pytest.approx(np.mean(sorted(values)[cut : len(values) - cut]))
    columns = np.outer(values, [1.0, -2.0])
    np.testing.assert_allclose(stats.iqm(columns, axis=0), scipy_stats.trim_mean(columns, 0.25, axis=0), atol=1e-12)


def test_the_best_of_others_is_chosen_anew_in_every_resample():
    # Means of both others are 0 or ±1 and so on; the better one of a resample is never below either.
    found = stats.above_best([10.0, 10.0], [[-4.0, 4.0], [-4.0, 4.0]])
    assert found.estimate == 10.0
    # 4 comes up with probability 1 - (3/4)^2 = 44 %, -4 only if both draw it: 1/16, still above 2.5 %.
    assert (found.low, found.high) == (6.0, 14.0)


def test_strata_keep_their_sizes():
    within = stats.stratified([[1.0, 1.0, 1.0], [5.0, 5.0]], stats.mean)
    assert within == (2.6, 2.6, 2.6)  # drawn from all five together it would be anything from 1 to 5


def test_three_seeds_are_overconfident_as_the_docs_say():
    rng = np.random.default_rng(0)
    found = [stats.difference(*rng.standard_normal((2, 3))) for _ in range(400)]
    hits = np.mean([interval.low <= 0 <= interval.high for interval in found])
    assert hits == pytest.approx(0.82, abs=0.05)
