"""Networks: policies as vectors, and their densities against SciPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import obs_stats
from scipy.stats import norm

from qdil.rl import networks


@pytest.fixture
def policy():
    policy = networks.init_policy(jax.random.key(0), 3, 2, (5, 4), 0.7)
    return policy | {"log_std": jnp.array([-0.3, 0.4])}


def test_flatten_and_unflatten_undo_each_other(policy):
    theta = networks.flatten(policy)
    assert theta.shape == (networks.flat_size(policy),) == (3 * 5 + 5 + 5 * 4 + 4 + 4 * 2 + 2 + 2,)
    blank = jax.tree.map(jnp.zeros_like, policy)
    jax.tree.map(np.testing.assert_array_equal, networks.unflatten(theta, blank), policy)
    other = jnp.asarray(np.random.default_rng(0).normal(size=theta.shape), jnp.float32)
    np.testing.assert_array_equal(networks.flatten(networks.unflatten(other, blank)), other)


def test_log_prob_is_scipys(policy):
    raw, mean = np.random.default_rng(0).normal(size=(2, 6, 2)).astype(np.float32)
    expected = norm.logpdf(raw, mean, np.exp(policy["log_std"])).sum(axis=-1)
    np.testing.assert_allclose(networks.log_prob(policy, mean, raw), expected, rtol=1e-5)


def test_entropy_is_scipys(policy):
    expected = norm.entropy(scale=np.exp(policy["log_std"])).sum()
    np.testing.assert_allclose(networks.entropy(policy), expected, rtol=1e-5)


def test_mean_action_by_hand(policy):
    obs = np.array([[1.0, -2.0, 500.0], [0.0, 0.5, -0.5]], np.float32)
    x = np.clip((obs - [1, 0, 2]) / [2, 1, 0.5], -10, 10)
    first, second, last = policy["mean"]
    hidden = np.tanh(np.tanh(x @ first["w"] + first["b"]) @ second["w"] + second["b"])
    mean = networks.policy_mean(policy, obs_stats([1, 0, 2], [2, 1, 0.5]), obs)
    np.testing.assert_allclose(mean, hidden @ last["w"] + last["b"], rtol=1e-4, atol=1e-6)


def test_a_new_policy_acts_around_zero_with_the_asked_spread():
    policy = networks.init_policy(jax.random.key(1), 3, 2, (64, 64), 0.25)
    obs = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    mean = networks.policy_mean(policy, obs_stats(np.zeros(3), np.ones(3)), obs)
    assert np.abs(mean).max() < 0.1
    np.testing.assert_allclose(np.exp(policy["log_std"]), 0.25, rtol=1e-6)


def test_layers_start_orthogonal():
    first, last = networks.init_mlp(jax.random.key(0), (4, 4, 3), last_scale=0.5)
    np.testing.assert_allclose(first["w"].T @ first["w"], 2 * np.eye(4), atol=1e-5)
    np.testing.assert_allclose(last["w"].T @ last["w"], 0.25 * np.eye(3), atol=1e-5)


def test_one_input_at_a_time_is_all_at_once(policy):
    inputs = jax.random.normal(jax.random.key(5), (6, policy["mean"][0]["w"].shape[0]))
    rows = networks.outputs_in_rows(policy["mean"])
    alone = [networks.mlp_single(rows, x) for x in inputs]
    np.testing.assert_allclose(alone, networks.mlp(policy["mean"], inputs), rtol=1e-5, atol=1e-6)


def test_columns_are_rows_on_their_side(policy):
    layers = policy["mean"]
    rows = np.random.default_rng(0).normal(size=(4, 7, 3)).astype(np.float32)
    columns = networks.as_columns(jnp.asarray(rows))
    np.testing.assert_array_equal(columns, rows.reshape(28, 3).T)
    hidden = rows
    for layer in layers[:-1]:
        hidden = np.tanh(hidden @ layer["w"] + layer["b"])
    expected = hidden @ layers[-1]["w"] + layers[-1]["b"]
    np.testing.assert_allclose(networks.mlp_of_columns(layers, columns).T.reshape(4, 7, 2), expected, atol=1e-6)


def test_columns_learn_what_rows_learn(policy):
    rows = jnp.asarray(np.random.default_rng(0).normal(size=(4, 7, 3)), jnp.float32)

    def by_columns(layers):
        return jnp.sum(jnp.square(networks.mlp_of_columns(layers, networks.as_columns(rows))))

    def by_rows(layers):
        return jnp.sum(jnp.square(networks.mlp(layers, rows)))

    gradients = jax.jit(jax.grad(by_columns))(policy["mean"]), jax.grad(by_rows)(policy["mean"])
    jax.tree.map(lambda ours, expected: np.testing.assert_allclose(ours, expected, rtol=1e-4, atol=1e-6), *gradients)
