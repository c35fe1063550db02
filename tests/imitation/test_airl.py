"""AIRL: reward and loss against NumPy, and what it reads."""

import jax
import numpy as np
import pytest
from probes import ACTIONS, CONTEXT, OBS, PROXIES, STATS, built, demos_of, forward, in_numpy, steps_of

from qdil.imitation.reward_model import expert_inputs, hide, policy_inputs
from qdil.imitation.training import sample_rows

SIZE = 16  # rows of each kind in a step of learning


def begun(method="airl", **settings):
    model = built(method, reward_batch=SIZE, **settings)
    rng = np.random.default_rng(1)
    expert, policy = demos_of(steps_of(rng, shift=1.0)), steps_of(rng)
    return model, model.init(jax.random.key(0), expert), expert, policy


@pytest.mark.parametrize("method", ["airl", "mcond-airl", "airl-obs"])
def test_reward_is_the_log_odds_of_state_action_and_next_state(method):
    model, state, _, _ = begun(method)
    steps = steps_of(np.random.default_rng(2), time=3, envs=8)
    _, reward = model.reward(state, (), CONTEXT, steps)
    params = in_numpy(state.inner.params)
    signs = set()
    for t, e in np.ndindex(*reward.shape):
        obs, next_obs = ((o[t, e] - STATS.mean) / STATS.std for o in (steps.obs, steps.next_obs))
        action = steps.action[t, e] if method != "airl-obs" else np.zeros(0)
        proxy = steps.proxy[t, e] if method == "mcond-airl" else np.zeros(0)
        logit = forward(params, np.concatenate([obs, action, proxy, next_obs]))[0]
        d = 1 / (1 + np.exp(-logit))
        assert reward[t, e] == pytest.approx(np.log(d) - np.log(1 - d), rel=1e-3, abs=1e-5)
        assert reward[t, e] == pytest.approx(logit, rel=1e-3, abs=1e-5)
        signs.add(np.sign(logit))
    assert signs == {-1, 1}


def drawn(method, expert, policy):
    """The rows, as the discriminator sees them, of an update of one step with key 1."""
    select = hide(actions=method.endswith("-obs"), proxy="mcond" not in method)
    expert_key, policy_key, _ = jax.random.split(jax.random.split(jax.random.key(1), 1)[0], 3)
    expert = sample_rows(expert_key, select(expert_inputs(expert, STATS)), SIZE)
    policy = sample_rows(policy_key, select(policy_inputs(policy, STATS)), SIZE)
    return [np.concatenate([x.obs, x.action, x.proxy, x.next_obs], axis=1).astype(float) for x in (expert, policy)]


def loss_in_numpy(params, expert, policy):
    """E_D[−log D] + E_π[−log(1−D)] by loops over rows."""
    on_expert = [-np.log(1 / (1 + np.exp(-forward(params, x)[0]))) for x in expert]
    on_policy = [-np.log(1 - 1 / (1 + np.exp(-forward(params, x)[0]))) for x in policy]
    return sum(on_expert) / len(on_expert) + sum(on_policy) / len(on_policy)


@pytest.mark.parametrize("method", ["airl", "mcond-airl-obs"])
def test_a_step_of_learning_descends_the_cross_entropy(method):
    rate = 1e-4
    model, state, expert, policy = begun(method, reward_steps=1, reward_learning_rate=rate)
    after, info = jax.jit(model.update)(jax.random.key(1), state, CONTEXT, expert, policy)
    data = drawn(method, expert, policy)
    params = in_numpy(state.inner.params)
    assert info["discriminator_loss"] == pytest.approx(loss_in_numpy(params, *data), rel=1e-4)
    leaves, tree = jax.tree.flatten(params)
    checked = 0
    for which, (leaf, moved_to) in enumerate(zip(leaves, jax.tree.leaves(after.inner.params), strict=True)):
        for at in np.ndindex(leaf.shape):
            losses = []
            for move in (1e-5, -1e-5):
                moved = leaf.copy()
                moved[at] += move
                others = [*leaves[:which], moved, *leaves[which + 1 :]]
                losses.append(loss_in_numpy(jax.tree.unflatten(tree, others), *data))
            slope = (losses[0] - losses[1]) / 2e-5
            if abs(slope) > 1e-3:  # the first step of Adam goes its full length against the slope
                assert moved_to[at] - leaf[at] == pytest.approx(-rate * np.sign(slope), rel=0.02)
                checked += 1
    assert checked > 40


def test_it_reads_the_next_state():
    model, state, expert, policy = begun()
    other = policy._replace(next_obs=policy.next_obs + 0.1)
    assert len(state.inner.params[0]["w"]) == 2 * OBS + ACTIONS
    assert len(begun("mcond-airl")[1].inner.params[0]["w"]) == 2 * OBS + ACTIONS + PROXIES
    rewards, other_rewards = (model.reward(state, (), CONTEXT, steps)[1] for steps in (policy, other))
    assert np.abs(np.asarray(rewards - other_rewards)).min() > 0
    update = jax.jit(model.update)
    learned, other_learned = (
        update(jax.random.key(1), state, CONTEXT, expert, steps)[0].inner.params for steps in (policy, other)
    )
    assert not np.array_equal(learned[0]["w"], other_learned[0]["w"])
