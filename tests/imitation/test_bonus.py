"""The measure bonus against slow loops over episodes, and its grid against pyribs'."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from probes import transitions

from qdil.config import choices, make_config
from qdil.errors import ConfigError
from qdil.imitation.bonus import (
    SCOPES,
    begin_visits,
    episode_measures,
    is_empty,
    measure_bonus,
    visit_bonus,
    visit_shares,
)
from qdil.imitation.fitness import BonusRule, begin_training, bonus_rule, compute_reward
from qdil.imitation.reward_model import RewardModel
from qdil.qd import archive
from qdil.types import Normaliser, RewardContext

TIME, ENVS, BEFORE = 9, 4, 5  # steps in a rollout, robots, steps that were taken before it

jitted_measures = jax.jit(episode_measures)
jitted_empty = jax.jit(is_empty)
jitted_rollout_bonus = jax.jit(partial(measure_bonus, scope="rollout"))


def cut_rollout(proxy, ended):
    """The last ``TIME`` steps of histories (BEFORE + TIME, ENVS), and by plain loops the measure of each one's episode.

    An episode that the rollout cuts counts up to the cut; one begun before the rollout counts from its beginning.
    """
    length, envs, k = proxy.shape
    so_far, expected = np.zeros_like(proxy), np.zeros_like(proxy)
    for e in range(envs):
        begin = 0
        for t in range(length):
            so_far[t, e] = proxy[begin : t + 1, e].mean(axis=0)
            if ended[t, e] or t == length - 1:
                expected[begin : t + 1, e] = proxy[begin : t + 1, e].mean(axis=0)
                begin = t + 1
    fell = ended & (np.arange(length)[:, None] % 2 == 0)
    kept = {"proxy": proxy, "measures_so_far": so_far, "terminated": fell, "truncated": ended & ~fell}
    rollout = transitions(TIME, envs, k=k, **{name: values[-TIME:] for name, values in kept.items()})
    return rollout, expected[-TIME:]


def test_every_scope_that_may_be_set_is_there():
    assert {*SCOPES, "step"} == set(choices("bonus_scope"))


def test_episode_measures_by_hand():
    # One robot, one foot: an episode begun two steps earlier (1, 1 | 0, 1), a whole one (0, 0, 1), one that is cut.
    steps = transitions(
        7,
        1,
        k=1,
        measures_so_far=np.float32([2 / 3, 3 / 4, 0, 0, 1 / 3, 1, 1 / 2]).reshape(7, 1, 1),
        terminated=np.array([0, 1, 0, 0, 0, 0, 0], bool)[:, None],
        truncated=np.array([0, 0, 0, 0, 1, 0, 0], bool)[:, None],
    )
    expected = [3 / 4, 3 / 4, 1 / 3, 1 / 3, 1 / 3, 1 / 2, 1 / 2]
    np.testing.assert_allclose(episode_measures(steps)[:, 0, 0], expected, rtol=1e-6)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_episode_measures_agree_with_a_slow_loop(seed, chance):
    rng = np.random.default_rng(seed)
    shape = (BEFORE + TIME, ENVS)
    rollout, expected = cut_rollout(rng.integers(0, 2, (*shape, 2)).astype(np.float32), rng.random(shape) < chance)
    np.testing.assert_allclose(jitted_measures(rollout), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("cells", [5, 20, 50])
def test_cells_are_pyribs_cells(cells):
    grid = archive.make(cells, 2, 1, 1, 0.5, 0.0).result
    rng = np.random.default_rng(cells)
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1], [0, 0.5], [1, 0.5]])
    measures = np.concatenate([rng.random((2000, 2)), corners]).astype(np.float32)
    occupied = rng.random((cells, cells)) < 0.5
    expected = ~occupied.reshape(-1)[grid.index_of(measures)]
    np.testing.assert_array_equal(jitted_empty(jnp.asarray(occupied), jnp.asarray(measures)), expected)


@pytest.mark.parametrize(("cells", "steps"), [(5, 50), (20, 300), (50, 1000), (50, 250)])
def test_shares_of_an_episode_that_fall_on_grid_lines_are_in_pyribs_cells(cells, steps):
    grid = archive.make(cells, 2, 1, 1, 0.5, 0.0).result
    share = np.arange(steps + 1, dtype=np.float32) / np.float32(steps)
    measures = np.stack([share, share[::-1]], axis=1)
    stripes = np.arange(cells) % 2 == 0
    for occupied in (np.tile(stripes[:, None], (1, cells)), np.tile(stripes, (cells, 1))):
        expected = ~occupied.reshape(-1)[grid.index_of(measures)]
        np.testing.assert_array_equal(jitted_empty(jnp.asarray(occupied), jnp.asarray(measures)), expected)


def test_bonus_is_p_plus_q_in_empty_cells_all_episode_long():
    rng = np.random.default_rng(0)
    shape = (BEFORE + TIME, ENVS)
    rollout, measures = cut_rollout(rng.integers(0, 2, (*shape, 2)).astype(np.float32), rng.random(shape) < 0.3)
    occupied = rng.random((4, 4)) < 0.5
    bonus = measure_bonus(rollout, jnp.asarray(occupied), 0.25, 2.0)
    for t in range(TIME):
        for e in range(ENVS):
            i, j = np.minimum((4 * measures[t, e] + 1e-4).astype(int), 3)
            assert bonus[t, e] == (0.25 if occupied[i, j] else 2.25)
    same_episode = ~np.asarray(rollout.ended[:-1])
    assert {0.25, 2.25} == set(np.unique(bonus))
    np.testing.assert_array_equal(np.asarray(bonus[1:])[same_episode], np.asarray(bonus[:-1])[same_episode])


def test_bonus_of_a_rollout_by_hand():
    # One robot, one foot, four steps in two episodes: down, down | up, down. The rollout's measure is 3/4 throughout.
    steps = transitions(
        4,
        1,
        k=1,
        proxy=np.float32([1, 1, 0, 1]).reshape(4, 1, 1),
        measures_so_far=np.float32([1, 1, 0, 1 / 2]).reshape(4, 1, 1),
        terminated=np.array([0, 1, 0, 0], bool)[:, None],
    )
    only_above_three_quarters = jnp.array([False, False, False, True])
    bonus = measure_bonus(steps, only_above_three_quarters, 0.25, 2.0, scope="rollout")
    assert np.ravel(bonus).tolist() == [0.25] * 4
    by_episode = measure_bonus(steps, only_above_three_quarters, 0.25, 2.0, scope="episode")
    assert np.ravel(by_episode).tolist() == [0.25, 0.25, 2.25, 2.25]


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_bonus_of_a_rollout_agrees_with_a_slow_loop(seed, chance):
    rng = np.random.default_rng(seed)
    shape = (BEFORE + TIME, ENVS)
    rollout, _ = cut_rollout(rng.integers(0, 2, (*shape, 2)).astype(np.float32), rng.random(shape) < chance)
    occupied = rng.random((4, 4)) < 0.5
    bonus = jitted_rollout_bonus(rollout, jnp.asarray(occupied), 0.25, 2.0)
    for e in range(ENVS):
        down = [sum(float(rollout.proxy[t, e, foot]) for t in range(TIME)) for foot in (0, 1)]
        i, j = (min(int(4 * d / TIME), 3) for d in down)  # nine steps: no share falls on a line but 0 and 1
        for t in range(TIME):
            assert bonus[t, e] == (0.25 if occupied[i, j] else 2.25)


# The single-step bonus


def shares_in_numpy(proxy, counts):
    """ρ of every step by a loop over time and robots; ``counts`` of each δ, a dict, is changed."""
    time, envs, _ = proxy.shape
    shares = np.zeros((time, envs))
    for t in range(time):
        before = dict(counts)
        for e in range(envs):
            value = tuple(proxy[t, e])
            shares[t, e] = before[value] / sum(before.values())
            counts[value] += 1
    return shares


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_shares_of_visits_agree_with_a_slow_loop_over_several_rollouts(seed, k):
    rng = np.random.default_rng(seed)
    visits, counts = begin_visits(ENVS, k), dict.fromkeys(np.ndindex(*(2,) * k), 1)
    for _ in range(3):
        proxy = (rng.random((TIME, ENVS, k)) < rng.random(k)).astype(np.float32)
        expected = shares_in_numpy(proxy.astype(int), counts)
        visits, shares = visit_shares(jnp.asarray(proxy), visits)
        np.testing.assert_allclose(shares, expected, rtol=1e-5)
    assert visits.shape == (ENVS, 2**k) and visits.sum() == 3 * TIME * ENVS == sum(counts.values()) - 2**k
    assert (visits.sum(axis=1) == 3 * TIME).all()


def test_a_visits_bonus_by_hand():
    # One foot, one robot. Before the run each δ counts once: ½, then 1 has two of three visits, and so on.
    visits, shares = visit_shares(jnp.float32([1, 1, 0, 0]).reshape(4, 1, 1), begin_visits(1, 1))
    np.testing.assert_allclose(np.ravel(shares), [1 / 2, 2 / 3, 1 / 4, 2 / 5], rtol=1e-6)
    np.testing.assert_allclose(np.ravel(visit_bonus(shares)), [2 / 3, 3 / 5, 4 / 5, 5 / 7], rtol=1e-6)
    assert visits.tolist() == [[2, 2]]


def test_robots_on_two_devices_share_their_visits():
    proxy = (np.random.default_rng(0).random((TIME, 4, 2)) < 0.3).astype(np.float32)
    visits = jnp.arange(16, dtype=jnp.int32).reshape(4, 4)
    alone_visits, alone = visit_shares(jnp.asarray(proxy), visits)
    halves = jnp.asarray(proxy.reshape(TIME, 2, 2, 2).swapaxes(0, 1)), visits.reshape(2, 2, 4)
    split = jax.vmap(partial(visit_shares, axis="halves"), axis_name="halves")
    split_visits, shares = split(*halves)
    np.testing.assert_allclose(np.concatenate(shares, axis=1), alone, rtol=1e-6)
    np.testing.assert_array_equal(split_visits.reshape(4, 4), alone_visits)


def paid(rule, rollout, p, q):
    """What is added (T, E) to a reward of ten, in each of two rollouts, and the visits at the end."""
    model = RewardModel(lambda key, demos: (), lambda state, memory, *_: (memory, jnp.full((TIME, ENVS), 10.0)))
    context = RewardContext(Normaliser(jnp.zeros(1), jnp.ones(1)), jnp.zeros((4, 4), bool).at[0, 0].set(True))
    memory, found = begin_training(model, rule, (), ENVS, 2), []
    for _ in range(2):
        memory, rewards = compute_reward(model, rule, (), memory, context, jnp.array([p, q]), rollout)
        np.testing.assert_array_equal(rewards.learned, 10.0)
        found.append(np.asarray(rewards.fitness) - 10)
    return found, memory.visits


@pytest.mark.parametrize("visits", [False, True])
@pytest.mark.parametrize("scope", choices("bonus_scope"))
def test_the_rule_decides_what_is_added_to_the_models_reward(scope, visits):
    rng = np.random.default_rng(1)
    shape = (BEFORE + TIME, ENVS)
    rollout, _ = cut_rollout(rng.integers(0, 2, (*shape, 2)).astype(np.float32), rng.random(shape) < 0.3)
    found, counted = paid(BonusRule(scope, visits), rollout, 0.25, 2.0)
    counts = dict.fromkeys(np.ndindex(2, 2), 1)
    occupied = jnp.zeros((4, 4), bool).at[0, 0].set(True)
    for bonus in found:
        novelty = 1 / (1 + shares_in_numpy(np.asarray(rollout.proxy).astype(int), counts))
        plain = 0.25 + 2 * novelty if scope == "step" else measure_bonus(rollout, occupied, 0.25, 2.0, scope)
        np.testing.assert_allclose(bonus, plain + visits * novelty, rtol=1e-4)
    if visits or scope == "step":
        assert counted.sum() == 2 * TIME * ENVS
    else:
        assert counted == ()


@pytest.mark.parametrize(
    ("method", "visits"),
    [("mconbo-vail", True), ("mcond-vail-obs", True), ("mbo-vail", False), ("vail", False), ("mconbo-gail", False)],
)
def test_only_measure_conditioned_vail_has_the_released_programs_bonus_for_visits(method, visits):
    assert bonus_rule(make_config("walker2d", method, "smoke", vail_visits=True)) == ("episode", visits)
    assert bonus_rule(make_config("walker2d", method, "smoke", bonus_scope="step")) == ("step", False)


def test_candidates_cannot_be_scored_with_a_bonus_that_belongs_to_no_episode():
    with pytest.raises(ConfigError, match="bonus_in_fitness=True must be false with bonus_scope=step"):
        make_config("walker2d", "mbo-gail", "smoke", bonus_scope="step", bonus_in_fitness=True)
