"""What is shown of an iteration taken apart is what the search does, and the pictures show those numbers."""

import jax
import numpy as np
import pandas as pd
import pytest
from scipy import stats

from qdil import ppga
from qdil.config import make_config
from qdil.lab import dissect
from qdil.plotting import ppga as pictures
from qdil.qd.xnes import XNES, utilities
from qdil.rl.evaluate import Policies

FEET = ("foot", "foot_left")
physics = pytest.mark.physics


@pytest.fixture(scope="module")
def search():
    return dissect.warmed(make_config("walker2d", "true", "smoke"), 3)


@physics
def test_a_warmed_search_has_seen_its_updates_and_no_iteration(search):
    config = search.config
    assert float(search.state.stats.seen) == pytest.approx(
        3 * config.ppo.rollout_length * config.ppo.num_envs, rel=1e-3
    )
    assert search.archives.result.empty


@physics
def test_policies_are_tried_out_side_by_side_as_candidates_are(search):
    theta = dissect.search_policy(search)
    policies = np.stack([theta, np.zeros_like(theta), theta + 0.5])
    trials = dissect.try_out(search, policies, seed=5)
    repetitions = search.config.ppga.candidates // 3
    assert trials.fitness.shape == (3, repetitions) and trials.measures.shape == (3, repetitions, 2)
    places = np.array([0, 0, 1, 1, 2, 2, 2, 2])  # the last one fills what is left of 8 places
    spread = (np.tile(np.asarray(x), (8, 1)) for x in (search.state.stats.mean, search.state.stats.std))
    direct = ppga.evaluate(search, search.engine.place(Policies(policies[places], *spread)), jax.random.key(5))
    np.testing.assert_array_equal(trials.fitness.ravel(), direct.fitness[:6])
    np.testing.assert_array_equal(trials.measures.reshape(6, 2), direct.measures[:6])


@physics
def test_a_search_policy_is_followed_to_where_it_is(search):
    begun = dissect.warmed(search.config, 2)
    after, followed = dissect.follow(begun, 2)
    assert list(followed.index) == [0, 1, 2] and followed[["c0", "c1", "c2"]].notna().sum().tolist() == [2, 2, 2]
    last = dissect.try_out(after, dissect.search_policy(after)[None], seed=2)
    assert followed["return"].iloc[2] == pytest.approx(last.fitness.mean())
    assert followed[["m1", "m2"]].iloc[2].tolist() == pytest.approx(last.measures[0].mean(axis=0).tolist())


@physics
def test_an_episode_of_the_search_policy_is_whole_and_changes_nothing(search):
    before = jax.random.key_data(search.state.key)
    proxy = dissect.episode(search)
    assert 1 <= len(proxy) <= search.config.simulation.episode_length and proxy.shape[1] == 2
    assert set(np.unique(proxy)) <= {0.0, 1.0}
    np.testing.assert_array_equal(jax.random.key_data(search.state.key), before)
    np.testing.assert_array_equal(dissect.episode(search), proxy)


def test_a_whole_episode_lies_between_two_ends():
    steps = np.arange(8)
    assert steps[dissect.first_whole(np.array([0, 1, 0, 0, 1, 0, 1, 0]))].tolist() == [2, 3, 4]
    with pytest.raises(ValueError, match="no whole episode"):
        dissect.first_whole(np.array([0, 1, 0]))


def test_comparison_gives_means_and_standard_errors():
    rng = np.random.default_rng(0)
    trials = dissect.RepeatedScores(rng.normal(size=(2, 5)), rng.random((2, 5, 2)))
    table = dissect.compare(trials, ["a", "b"], FEET)
    np.testing.assert_allclose(table["return", "error"], stats.sem(trials.fitness, axis=1))
    np.testing.assert_allclose(table["foot_left down", "mean"], trials.measures[:, :, 1].mean(axis=1))
    assert (
        dissect.compare(dissect.RepeatedScores(rng.normal(size=(2, 1)), rng.random((2, 1, 2))), ["a", "b"], FEET)[
            "return", "error"
        ]
        .isna()
        .all()
    )


def test_the_copy_trained_on_an_objective_is_the_filled_one():
    means = np.arange(12.0).reshape(4, 3)
    columns = pd.MultiIndex.from_tuples([(w, k) for w in ("return", "a down", "b down") for k in ("mean", "error")])
    table = pd.DataFrame(np.repeat(means, 2, axis=1), index=["mu", "f", "1", "2"], columns=columns)
    for i, ax in enumerate(pictures.objectives(table).axes):
        points = [bars.lines[0] for bars in ax.containers]
        assert [float(p.get_ydata()[0]) for p in points] == list(means[:, i])
        assert [p.get_markerfacecolor() != "white" for p in points].index(True) == i + 1


def test_proxies_end_at_the_measures_of_their_episode():
    proxy = np.random.default_rng(2).integers(0, 2, (40, 2))
    below = pictures.proxies(proxy, 0.1, "walker2d").axes[1]
    ends = [line.get_ydata()[-1] for line in below.lines if len(line.get_ydata()) > 1]
    np.testing.assert_allclose(ends, proxy.mean(axis=0))
    assert f"{proxy[:, 1].mean():.2f}" in below.get_legend().texts[1].get_text()


def test_candidates_are_coloured_by_the_size_of_c0_and_the_sign_of_the_others():
    rng = np.random.default_rng(3)
    coefficients, measures = rng.normal(size=(9, 3)), rng.random((9, 2))
    panels = [ax.collections[0] for ax in pictures.candidates(measures, coefficients, (0.5, 0.5)).axes[:3]]
    np.testing.assert_allclose(panels[0].get_array(), np.abs(coefficients[:, 0]))
    np.testing.assert_allclose(panels[2].get_array(), coefficients[:, 2])
    assert panels[1].norm.vmin == -panels[1].norm.vmax


def test_ranking_is_best_first_and_utilities_sum_to_zero():
    improvement = np.array([0.0, 3.0, 1.0, 0.0])
    left, right = pictures.ranking(improvement, utilities(improvement)).axes
    assert [bar.get_height() for bar in left.patches] == [3.0, 1.0, 0.0, 0.0]
    assert sum(bar.get_height() for bar in right.patches) == pytest.approx(0)


def test_ellipses_are_the_distribution_that_xnes_samples_from():
    strategy = XNES(1.0, 3, 8, seed=0)
    strategy.mean, strategy.sigma = np.array([1.0, -2.0, 0.5]), 1.5
    strategy.shape = np.array([[2.0, 0.3, 0], [0, 0.5, 0.2], [0, 0, 1.0]])
    samples = strategy.ask(200_000)
    gaussian = dissect.distribution(strategy)
    figure = pictures.search_distribution(gaussian, gaussian, samples[:8], np.arange(8) - 3.5)
    for ax, plane in zip(figure.axes, ((0, 1), (1, 2)), strict=True):
        inner = ax.patches[0]
        whitened = inner.get_patch_transform().inverted().transform(samples[:, plane])
        assert np.mean(np.hypot(*whitened.T) < 1) == pytest.approx(1 - np.exp(-0.5), abs=0.01)  # χ² with 2 degrees


def test_coefficients_mark_every_restart():
    metrics = pd.DataFrame(
        {"iteration": [1, 2, 3, 4], "restarts": [1, 1, 2, 2], **{f"c{i}": [i] * 4 for i in range(3)}}
    )
    ax = pictures.coefficients_over(metrics).axes[0]
    assert list(ax.lines[3].get_xdata()) == [1, 3] and "2 restarts" in ax.get_xlabel()


def test_a_restart_is_dashed_on_the_path():
    followed = pd.DataFrame({"m1": [0.1, 0.2, 0.8], "m2": [0.1, 0.3, 0.9], "restart": [False, False, True]})
    archive = {"index": [0], "measures": [[0.1, 0.1]], "true_return": [1.0], "cells": [5, 5]}
    arrows = [text.arrow_patch.get_linestyle() for text in pictures.path(followed, archive).axes[0].texts]
    assert arrows == ["-", "--"]
