"""Intervals against resampling by hand, exact enumeration and their promises about few seeds."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats as scipy_stats

from qdil.evidence import stats

ARM = st.lists(st.integers(-1000, 1000).map(float), min_size=2, max_size=6)


def test_three_paired_seeds_give_the_quantiles_of_all_27_resamples():
    ours, reference = {1: 5.0, 2: 9.0, 4: 20.0, 7: 0.0}, {4: 1.0, 2: 2.0, 1: 4.0, 8: 100.0}
    differences = [5.0 - 4.0, 9.0 - 2.0, 20.0 - 1.0]  # seeds 7 and 8 have no partner
    exact = np.mean(list(itertools.product(differences, repeat=3)), axis=1)
    found = stats.paired_bootstrap(ours, reference)
    assert len(exact) == 27 and found.estimate == 9.0
    # Each end has a probability of 1/27, more than the 2.5 % that are cut off.
    assert found[1:] == (exact.min(), exact.max()) == (1.0, 19.0)
    drawn = np.sort([stats.contrast([differences], stats.mean, seed=s, resamples=1).low for s in range(3000)])
    np.testing.assert_allclose(np.quantile(drawn, [0.25, 0.5, 0.75]), np.quantile(exact, [0.25, 0.5, 0.75]), atol=1.5)


def test_pairs_stay_together_when_seeds_are_resampled():
    ours, reference = {1: 100.0, 2: 1000.0}, {1: 99.0, 2: 998.0}
    assert stats.paired_bootstrap(ours, reference) == (1.5, 1.0, 2.0)
    assert not stats.paired_bootstrap({1: 1.0, 2: 3.0}, {2: 1.0, 3: 3.0}).known()


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


def test_the_same_runs_always_give_the_same_interval():
    values = [1.0, 2.0, 4.0]
    first = stats.contrast([values], stats.mean)
    stats.contrast([[7.0, 9.0]], stats.mean)  # no state is carried from one to the next
    assert stats.contrast([values], stats.mean) == first


@pytest.mark.parametrize("values", [[], [1.0, np.nan, 2.0], [1.0, np.inf]])
def test_nothing_and_values_that_are_not_finite_have_no_estimate(values):
    assert np.isnan(stats.contrast([values], stats.mean)).all()


def test_one_seed_has_an_estimate_and_no_interval():
    found = stats.contrast([[3.0], [1.0, 2.0]], lambda a, b, axis: a.mean(axis) - b.mean(axis))
    assert found.estimate == 1.5 and not found.known()


@given(st.lists(st.integers(-50, 50).map(float), min_size=1, max_size=23))
def test_the_interquartile_mean_drops_a_quarter_from_either_end(values):
    cut = len(values) // 4
    assert stats.iqm(values) == pytest.approx(np.mean(sorted(values)[cut : len(values) - cut]))
    columns = np.outer(values, [1.0, -2.0])
    np.testing.assert_allclose(stats.iqm(columns, axis=0), scipy_stats.trim_mean(columns, 0.25, axis=0), atol=1e-12)


def test_strata_keep_their_sizes():
    within = stats.stratified([[1.0, 1.0, 1.0], [5.0, 5.0]], stats.mean)
    assert within == (2.6, 2.6, 2.6)  # drawn from all five together it would be anything from 1 to 5
