"""VPPO: advantages and loss against slow NumPy, and whole updates on a bandit whose answer is known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.sharding import PartitionSpec as P
from probes import target, transitions, true_rewards
from scipy.stats import norm

from qdil.config import PPO
from qdil.devices.mesh import AXIS, make_mesh
from qdil.rl import networks, vppo
from qdil.rl.normalise import init_obs_stats
from qdil.rl.rollout import start
from qdil.types import ActionSample, Rewards

EPISODE_LENGTH = 8
K, ENVS = 3, 24  # copies (one per objective), robots
SETTINGS = PPO(
    rollout_length=16,
    minibatches=2,
    gamma=0.9,
    gae_lambda=0.8,
    clip=0.2,
    value_coef=0.5,
    entropy_coef=0.0,
    max_grad_norm=0.5,
    learning_rate=0.02,
    target_kl=1.0,
)


# Advantages


def slow_gae(rewards, values, next_values, terminated, truncated, gamma, lam):
    """A_t = Σ_l (γλ)^l δ_{t+l}, summed from every step to the end of its own episode (Schulman et al., 2016)."""
    advantages = np.zeros_like(rewards)
    for t in range(len(rewards)):
        for later in range(t, len(rewards)):
            future = 0.0 if terminated[later] else next_values[later]
            delta = rewards[later] + gamma * future - values[later]
            advantages[t] += (gamma * lam) ** (later - t) * delta
            if terminated[later] or truncated[later]:
                break
    return advantages


jitted_gae = jax.jit(vppo.gae)


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.6), st.floats(0.5, 1), st.floats(0, 1))
def test_gae_agrees_with_the_sum_it_stands_for(seed, chance, gamma, lam):
    rng = np.random.default_rng(seed)
    time, envs, objectives = 12, 3, 2
    rewards, values, next_values = rng.normal(size=(3, time, envs, objectives))
    ended, fell = rng.random((2, time, envs, 1)) < np.array([chance, 0.5])[:, None, None, None]
    terminated, truncated = (ended & fell).astype(float), (ended & ~fell).astype(float)
    fast = jitted_gae(rewards, values, next_values, terminated, truncated, gamma, lam)
    for e in range(envs):
        for s in range(objectives):
            one = (x[:, e, s] for x in (rewards, values, next_values))
            ends = terminated[:, e, 0], truncated[:, e, 0]
            np.testing.assert_allclose(fast[:, e, s], slow_gae(*one, *ends, gamma, lam), rtol=1e-4, atol=1e-4)


def test_a_fall_has_no_future_and_a_time_limit_has_one():
    rewards, values, next_values = np.ones((1, 1)), np.zeros((1, 1)), np.full((1, 1), 10.0)
    yes, no = np.ones((1, 1)), np.zeros((1, 1))
    assert vppo.gae(rewards, values, next_values, yes, no, 0.9, 0.95).item() == pytest.approx(1)
    assert vppo.gae(rewards, values, next_values, no, yes, 0.9, 0.95).item() == pytest.approx(10)


# Copies


def test_environments_are_dealt_to_the_copies_in_turn():
    dealt = vppo.to_copies(jnp.arange(12), K)
    np.testing.assert_array_equal(dealt, [[0, 3, 6, 9], [1, 4, 7, 10], [2, 5, 8, 11]])


@pytest.mark.parametrize(("shape", "axis"), [((6,), 0), ((6, 2), 0), ((4, 6), 1), ((4, 6, 2), 1)])
def test_from_copies_undoes_to_copies(shape, axis):
    x = np.random.default_rng(0).normal(size=shape)
    dealt = vppo.to_copies(jnp.asarray(x), K, axis)
    assert dealt.shape == (K, *shape[:axis], shape[axis] // K, *shape[axis + 1 :])
    np.testing.assert_array_equal(vppo.from_copies(dealt, axis), jnp.asarray(x))


# Loss


def dense(layers, x):
    """A tanh perceptron in NumPy."""
    for layer in layers[:-1]:
        x = np.tanh(x @ layer["w"] + layer["b"])
    return x @ layers[-1]["w"] + layers[-1]["b"]


def test_loss_is_ppos():
    settings = replace(SETTINGS, value_coef=0.7, entropy_coef=0.3)
    rng = np.random.default_rng(0)
    policy = networks.init_policy(jax.random.key(0), 2, 2, (4,), 0.6)
    critic = networks.init_mlp(jax.random.key(1), (2, 4, K))
    obs, raw = rng.normal(size=(2, 5, 3, 2))
    value, goal = rng.normal(size=(2, 5, 3, K))
    advantage = rng.normal(size=(5, 3))
    mean = dense(policy["mean"], obs)
    new = norm.logpdf(raw, mean, np.exp(policy["log_std"])).sum(axis=-1)
    old = new + rng.normal(scale=0.4, size=new.shape)
    fits = [jnp.asarray(x, jnp.float32) for x in (obs, raw, old, advantage, goal, value)]
    batch = vppo.Batch(fits[0], ActionSample(fits[1], fits[2]), *fits[3:])
    total, (kl, value_loss) = vppo.loss(policy, critic, batch, settings)

    surrogates, errors, kls = [], [], []
    predicted = dense(critic, obs)
    for t in range(5):
        for e in range(3):
            ratio = np.exp(new[t, e] - old[t, e])
            kept = min(max(ratio, 0.8), 1.2)
            surrogates.append(min(ratio * advantage[t, e], kept * advantage[t, e]))
            kls.append(ratio - 1 - np.log(ratio))
            for s in range(K):
                near = value[t, e, s] + min(max(predicted[t, e, s] - value[t, e, s], -0.2), 0.2)
                errors.append(max((predicted[t, e, s] - goal[t, e, s]) ** 2, (near - goal[t, e, s]) ** 2))
    entropy = norm.entropy(scale=np.exp(policy["log_std"])).sum()
    expected = -np.mean(surrogates) + 0.7 * 0.5 * np.mean(errors) - 0.3 * entropy
    assert total == pytest.approx(expected, rel=1e-4)
    assert kl == pytest.approx(np.mean(kls), rel=1e-3)
    assert value_loss == pytest.approx(0.5 * np.mean(errors), rel=1e-4)


# Updates of the bandit. Objective 0 is −(a − ½)², 1 the share of actions above ¾, 2 the share of actions below 0.


def compile_updates(settings=SETTINGS, num_devices=1, copies=K):
    """A function ``(num_updates, weights (copies, K), tied, epochs) -> (train_state, stats, transitions, info)``."""
    env = target()

    def begin():
        policy = networks.init_policy(jax.random.key(0), 1, 1, (8,), 0.5)
        critic = networks.init_mlp(jax.random.key(1), (1, 8, K))
        train_state = vppo.replicate(vppo.init_train_state(settings, policy, critic, K), copies)
        return (
            train_state,
            init_obs_stats(1),
            start(env, jax.random.split(jax.random.key(2), ENVS), EPISODE_LENGTH),
            (),
        )

    def run(state, num_updates, weights, tied, epochs):
        def once(state):
            train_state, stats, envs, carry = state
            length = settings.rollout_length
            envs, steps, sample = vppo.collect(env, length, EPISODE_LENGTH, train_state, stats, envs)
            carry, fitness = true_rewards(carry, stats, steps)
            key = jax.random.fold_in(jax.random.key(3), stats.seen.astype(int))
            experience = vppo.Experience(steps, sample, Rewards(fitness, fitness, 0.0 * fitness))
            weighting = vppo.Weighting(weights, tied)
            train_state, stats, info = vppo.learn(settings, key, train_state, stats, experience, weighting, epochs)
            return train_state, stats, envs, carry, steps, info

        out = jax.eval_shape(once, state)
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), out[4:])
        train_state, stats, _, _, steps, info = jax.lax.fori_loop(
            0, num_updates, lambda _, now: once(now[:4]), (*state, *empty)
        )
        return train_state, stats, steps, info

    specs = (P(), P(), P(AXIS), P())
    sharded = jax.jit(
        jax.shard_map(
            run,
            mesh=make_mesh(num_devices),
            in_specs=(specs, P(), P(), P(), P()),
            out_specs=(P(), P(), P(None, AXIS), P()),
            check_vma=False,
        )
    )
    return lambda num_updates, weights, tied, epochs=4: sharded(begin(), num_updates, weights, tied, epochs)


@pytest.fixture(scope="module")
def updates():
    return compile_updates()


def leaves(tree, copy=None):
    """All numbers of a tree (of one ``copy``) as a vector."""
    return np.concatenate([np.ravel(leaf if copy is None else leaf[copy]) for leaf in jax.tree.leaves(tree)])


def objectives_of(policy):
    """(K, K): by quadrature, the mean of every objective (columns) under every copy's policy at rest (rows)."""
    a = np.linspace(-4, 4, 4001)
    rows = []
    for i in range(K):
        one = jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i], float), policy)
        density = norm.pdf(a, dense(one["mean"], np.zeros(1))[0], np.exp(one["log_std"][0]))
        density /= density.sum()
        rows.append([density @ -((np.clip(a, -1, 1) - 0.5) ** 2), density @ (a > 0.75), density @ (a < 0)])
    return np.array(rows)


def test_each_copy_improves_its_own_objective_the_most(updates):
    before = objectives_of(updates(0, jnp.eye(K), False)[0].policy)
    train_state, *_ = updates(25, jnp.eye(K), False)
    after = objectives_of(train_state.policy)
    assert after.argmax(axis=0).tolist() == [0, 1, 2]
    assert np.all(np.diag(after) > np.diag(before) + 0.1)


def test_the_bandits_answer_is_found(updates):
    train_state, _, _, info = updates(60, jnp.tile(jnp.eye(K)[0], (K, 1)), True)
    rest = dense(jax.tree.map(lambda leaf: np.asarray(leaf[0]), train_state.policy["mean"]), np.zeros(1))
    assert rest[0] == pytest.approx(0.5, abs=0.15)
    assert info.action_std < 0.4
    assert info.fitness_reward == info.true_reward > -0.2


def test_tied_copies_stay_one_policy_and_untied_ones_part(updates):
    same = jnp.tile(jnp.array([1.0, 0.2, -0.3]), (K, 1))
    tied, untied = updates(3, same, True)[0], updates(3, same, False)[0]
    for copy in (1, 2):
        np.testing.assert_array_equal(leaves(tied, copy), leaves(tied, 0))
        assert np.abs(leaves(untied.policy, copy) - leaves(untied.policy, 0)).max() > 1e-3


def test_tied_copies_are_one_copy_that_has_all_environments(updates):
    weights = jnp.array([1.0, 0.2, -0.3])
    three, one = updates(2, jnp.tile(weights, (K, 1)), True), compile_updates(copies=1)(2, weights[None], False)
    np.testing.assert_allclose(leaves(three[0].policy, 0), leaves(one[0].policy), atol=2e-4)
    np.testing.assert_allclose(leaves(three[0].critic, 0), leaves(one[0].critic), atol=2e-4)
    np.testing.assert_allclose(leaves(three[0].returns, 0), leaves(one[0].returns), rtol=1e-4, atol=1e-5)


@pytest.mark.skipif(jax.local_device_count() < 2, reason="one device only")
@pytest.mark.parametrize("tied", [False, True])
def test_two_devices_do_what_one_does(updates, two_devices, tied):
    weights = jnp.tile(jnp.array([1.0, 0.2, -0.3]), (K, 1)) if tied else jnp.eye(K)
    one, two = updates(2, weights, tied), two_devices(2, weights, tied)
    begun = updates(0, weights, tied)
    assert np.abs(leaves(one[0].policy) - leaves(begun[0].policy)).max() > 0.02
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=5e-4)


@pytest.fixture(scope="module")
def two_devices():
    return compile_updates(num_devices=2)


def test_copies_scaled_together_share_one_norm_and_one_spread():
    """The released program's reading: the mean loss over all copies, one norm of all gradients, one spread."""
    rng = np.random.default_rng(0)
    grads = {"w": rng.normal(size=(K, 4, 2)).astype(np.float32), "b": rng.normal(size=(K, 3)).astype(np.float32)}
    mean_loss = {name: grad / K for name, grad in grads.items()}
    norm = np.sqrt(sum(np.square(grad).sum() for grad in mean_loss.values()))
    for limit in (0.1 * norm, 10.0 * norm):
        expected = {name: grad * min(1.0, limit / norm) for name, grad in mean_loss.items()}
        clipped = vppo._clipped_together(grads, jnp.asarray(False), limit)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), clipped, expected)
        jax.tree.map(np.testing.assert_array_equal, vppo._clipped_together(grads, jnp.asarray(True), limit), grads)
    nothing = vppo._clipped_together(jax.tree.map(np.zeros_like, grads), jnp.asarray(False), 1.0)
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(nothing))

    advantage = rng.normal([[[[0.0]]], [[[5.0]]], [[[-1.0]]]], 2.0, (K, 2, 6, 7)).swapaxes(0, 1).astype(np.float32)
    mesh = make_mesh(1)
    normalise = jax.shard_map(
        lambda x, together: vppo._normalised(x, together), mesh=mesh, in_specs=P(), out_specs=P(), check_vma=False
    )
    for together, axes in ((True, (1, 2, 3)), (False, (2, 3))):
        mean, std = advantage.mean(axis=axes, keepdims=True), advantage.std(axis=axes, keepdims=True)
        found = normalise(jnp.asarray(advantage), jnp.asarray(together))
        np.testing.assert_allclose(found, (advantage - mean) / std, atol=1e-4)


def test_a_copy_past_its_kl_target_stops_alone():
    # Copy 1 has no reward, so its policy never moves and only its critic goes on learning.
    run = compile_updates(replace(SETTINGS, target_kl=1e-9))
    weights = jnp.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1.0]])
    (once, _, _, info_once), (four_times, _, _, info) = run(1, weights, False, 1), run(1, weights, False, 4)
    assert info.approx_kl == pytest.approx(info_once.approx_kl)  # at which they stopped, and 0 of copy 1
    for copy in (0, 2):
        np.testing.assert_array_equal(leaves(four_times, copy), leaves(once, copy))
    np.testing.assert_array_equal(leaves(four_times.policy, 1), leaves(once.policy, 1))
    assert np.abs(leaves(four_times.critic, 1) - leaves(once.critic, 1)).max() > 1e-3


def test_within_its_kl_target_a_copy_uses_every_epoch(updates):
    once, four_times = updates(1, jnp.eye(K), False, 1)[0], updates(1, jnp.eye(K), False, 4)[0]
    for copy in range(K):
        assert np.abs(leaves(four_times.policy, copy) - leaves(once.policy, copy)).max() > 1e-3


def test_no_epochs_collect_a_rollout_and_teach_nothing(updates):
    begun, (train_state, stats, steps, _) = updates(0, jnp.eye(K), False), updates(1, jnp.eye(K), False, 0)
    np.testing.assert_array_equal(leaves(train_state.policy), leaves(begun[0].policy))
    np.testing.assert_array_equal(leaves(train_state.critic), leaves(begun[0].critic))
    np.testing.assert_allclose(steps.reward, -np.square(steps.action[..., 0] - 0.5), atol=1e-6)
    np.testing.assert_allclose(stats.mean[0], np.mean(steps.obs), atol=1e-5)


def test_the_critic_finds_the_known_value(updates):
    # A bandit's value is its mean reward for ever: r̄ / (1 − γ), and time limits must not cut it short. A weighting of
    # zeros leaves the policy alone, so that the critic has something to converge to.
    train_state, stats, steps, _ = updates(60, jnp.zeros((K, K)), True)
    one = jax.tree.map(lambda leaf: np.asarray(leaf[0]), train_state)
    obs = (np.asarray(steps.obs) - np.asarray(stats.mean)) / np.asarray(stats.std)
    output = dense(one.critic, obs) * one.returns.std + one.returns.mean
    known = np.asarray(steps.reward).mean() / (1 - SETTINGS.gamma)
    assert output[..., 0].mean() == pytest.approx(known, rel=0.1)


def test_clipping_is_measured_from_the_critics_output():
    # Returns far from zero change the statistics much. With ``value`` in the new ones, nothing would be learned.
    critic = networks.init_mlp(jax.random.key(1), (1, 8, K))
    policy = networks.init_policy(jax.random.key(0), 1, 1, (8,), 0.5)
    train_state = vppo.init_train_state(SETTINGS, policy, critic, K)
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(16, 4, 1)), jnp.float32)
    steps = transitions(16, 4, obs=obs, next_obs=obs)
    sample = ActionSample(steps.action, steps.reward)
    rewards = jnp.full((16, 4, K), 7.0)

    def run(train_state):
        rollout = jax.tree.map(lambda x: x[None], (steps, sample, rewards))
        weighting = vppo.Weighting(jnp.ones((1, K)), jnp.array(True))
        return vppo._prepare(train_state, *rollout, weighting, init_obs_stats(1), SETTINGS)

    sharded = jax.shard_map(run, mesh=make_mesh(1), in_specs=P(), out_specs=P(), check_vma=False)
    after, batch = jax.jit(sharded)(vppo.replicate(train_state, 1))
    assert np.abs(after.returns.mean).min() > 5
    np.testing.assert_allclose(batch.value[0], dense(critic, steps.obs), atol=1e-5)
    expected = slow_gae(
        *[np.asarray(x, float) for x in (rewards, *[dense(critic, steps.obs)] * 2)], *np.zeros((2, 16)), 0.9, 0.8
    )
    returns = expected + dense(critic, steps.obs)
    np.testing.assert_allclose(batch.target[0] * after.returns.std[0] + after.returns.mean[0], returns, rtol=1e-3)
