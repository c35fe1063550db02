"""Maximum-entropy IRL: the likelihood's gradient, its direction, and the reward's bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import CONTEXT, STATS, built, demos_of, forward, in_numpy, steps_of

from qdil.imitation.rewards.maxent import negative_log_likelihood_gap


def gap_in_numpy(params, expert, policy):
    """E_π[r] − E_D[r], r = tanh of the network's output, by loops over rows."""
    on_expert, on_policy = ([np.tanh(forward(params, x)[0]) for x in some] for some in (expert, policy))
    return sum(on_policy) / len(on_policy) - sum(on_expert) / len(on_expert)


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    params = [
        {"w": rng.normal(size=(4, 5)) / 2, "b": rng.normal(size=5)},
        {"w": rng.normal(size=(5, 1)) / 2, "b": rng.normal(size=1)},
    ]
    return params, rng.normal(size=(6, 4)), rng.normal(size=(9, 4))


def test_gradient_agrees_with_finite_differences(problem):
    params, *data = problem
    value, slopes = jax.jit(jax.value_and_grad(negative_log_likelihood_gap))(params, *data)
    assert value == pytest.approx(gap_in_numpy(params, *data), rel=1e-4)
    leaves, tree = jax.tree.flatten(params)
    for which, (leaf, slope) in enumerate(zip(leaves, jax.tree.leaves(slopes), strict=True)):
        for at in np.ndindex(leaf.shape):
            values = []
            for move in (1e-5, -1e-5):
                moved = leaf.copy()
                moved[at] += move
                others = [*leaves[:which], moved, *leaves[which + 1 :]]
                values.append(gap_in_numpy(jax.tree.unflatten(tree, others), *data))
            assert slope[at] == pytest.approx((values[0] - values[1]) / 2e-5, rel=1e-3, abs=1e-5)


def test_gradient_is_that_of_a_likelihood():
    # A world of three points and a linear-tanh reward: p(x) = exp r(x) / Σ exp r. The gradient of the demonstrations'
    # negative log likelihood is the gap's, once the policy's rows are spread as p.
    points, demonstrated = np.array([[1.0, 0.5], [-0.5, 1.0], [0.2, -1.0]]), np.array([0, 0, 1])
    params = [{"w": jnp.array([[0.6], [-0.4]]), "b": jnp.array([0.1])}]

    def negative_log_likelihood(params):
        r = jnp.tanh(points @ params[0]["w"] + params[0]["b"])[:, 0]
        return jnp.mean(jax.scipy.special.logsumexp(r) - r[demonstrated])

    r = np.tanh(points @ np.array([0.6, -0.4]) + 0.1)
    times = np.round(1000 * np.exp(r) / np.exp(r).sum()).astype(int)
    policy = np.repeat(points, times, axis=0)
    given = jax.grad(negative_log_likelihood_gap)(params, points[demonstrated], policy)
    expected = jax.grad(negative_log_likelihood)(params)
    np.testing.assert_allclose(given[0]["w"], expected[0]["w"], atol=2e-3)
    assert np.abs(expected[0]["w"]).max() > 0.1


def test_reward_rises_on_demonstrations_and_falls_on_the_policy():
    model = built("maxent", reward_steps=20, reward_batch=256, reward_learning_rate=3e-3)
    rng = np.random.default_rng(0)
    expert, policy = steps_of(rng, shift=0.7), steps_of(rng)
    state = model.init(jax.random.key(0), demos_of(expert))

    def mean_rewards(state):
        return [float(model.reward(state, (), CONTEXT, steps)[1].mean()) for steps in (expert, policy)]

    before, update = mean_rewards(state), jax.jit(model.update)
    gaps = [before[0] - before[1]]
    for i in range(4):
        state, info = update(jax.random.key(i), state, CONTEXT, demos_of(expert), policy)
        after = mean_rewards(state)
        gaps.append(after[0] - after[1])
    assert after[0] > before[0] + 0.1 and after[1] < before[1] - 0.1
    assert gaps == sorted(gaps) and info["reward_gap"] == pytest.approx(gaps[-1], abs=0.1)


def test_reward_is_the_networks_output_through_tanh():
    model, steps = built("maxent"), steps_of(np.random.default_rng(1), time=3, envs=8)
    state = model.init(jax.random.key(0), demos_of(steps))
    _, reward = model.reward(state, (), CONTEXT, steps)
    for t, e in np.ndindex(*reward.shape):
        x = np.concatenate([(steps.obs[t, e] - STATS.mean) / STATS.std, steps.action[t, e]])
        assert reward[t, e] == pytest.approx(np.tanh(forward(in_numpy(state.inner.params), x)[0]), rel=1e-3, abs=1e-5)


def test_reward_is_bounded_however_long_it_learns():
    model, steps = built("maxent"), steps_of(np.random.default_rng(1), time=3, envs=8)
    state = model.init(jax.random.key(0), demos_of(steps))
    loud = state._replace(inner=state.inner._replace(params=jax.tree.map(lambda w: 1e4 * w, state.inner.params)))
    reward = np.asarray(model.reward(loud, (), CONTEXT, steps)[1])
    assert reward.min() == -1 and reward.max() == 1  # float32's tanh reaches its bounds
