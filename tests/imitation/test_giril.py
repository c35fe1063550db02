"""GIRIL: its divergence and loss against integrals and NumPy, and what its model of transitions has learned."""

import jax
import numpy as np
import pytest
from probes import (
    ACTIONS,
    CONTEXT,
    OBS,
    PROXIES,
    area_under_curve,
    built,
    demos_of,
    expert_steps,
    forward,
    in_numpy,
    random_steps,
    steps_of,
)
from scipy.integrate import quad
from scipy.stats import norm

from qdil.imitation.reward_model import Inputs
from qdil.imitation.rewards.giril import LATENT_WITHOUT_ACTIONS, kl, loss
from qdil.rl.networks import init_mlp

pytestmark = pytest.mark.compiles

TRAINED = {"reward_hidden": (32, 32), "giril_steps": 1000, "giril_learning_rate": 3e-3, "reward_batch": 64}


# The divergence


def test_divergence_is_the_integral():
    mean, other_mean = np.array([0.7, -1.5, 2.0]), np.array([0.5, 1.0, 2.0])
    log_std, other_log_std = np.array([-1.0, 0.4, 0.3]), np.array([0.2, -0.3, 0.3])

    def one(mean, std, other_mean, other_std):
        q, p = norm(mean, std), norm(other_mean, other_std)
        return quad(lambda z: q.pdf(z) * (q.logpdf(z) - p.logpdf(z)), mean - 12 * std, mean + 12 * std)[0]

    each = zip(mean, np.exp(log_std), other_mean, np.exp(other_log_std), strict=True)
    by_hand = sum(one(*numbers) for numbers in each)
    assert kl(mean, log_std, other_mean, other_log_std) == pytest.approx(by_hand, rel=1e-5)
    assert kl(mean, log_std, mean, log_std) == pytest.approx(0, abs=1e-6)


# The loss


def gaussian_in_numpy(layers, x):
    mean, log_std = np.split(forward(layers, x), 2)
    return mean, np.exp(np.clip(log_std, -5, 2))


def loss_in_numpy(params, inputs, noise, action_weight):
    """Minus eq. 9 by a loop over rows, given the noise of the latent."""
    total = 0.0
    for obs, action, next_obs, proxy, z in zip(*inputs, noise, strict=True):
        state = np.concatenate([obs, proxy])
        mean, std = gaussian_in_numpy(params["recognition"], np.concatenate([state, next_obs]))
        prior_mean, prior_std = gaussian_in_numpy(params["prior"], state)
        guess = np.tanh(mean + std * z)
        decoded = obs + forward(params["decoder"], np.concatenate([guess, state]))
        total += sum((next_obs - decoded) ** 2) / 2
        total += sum(np.log(prior_std / std) + (std**2 + (mean - prior_mean) ** 2) / (2 * prior_std**2) - 0.5)
        if len(action):
            total += action_weight * sum((guess - action) ** 2) / 2
    return total / len(noise)


@pytest.mark.parametrize("proxies", [0, PROXIES])
@pytest.mark.parametrize(("actions", "weight"), [(ACTIONS, 1.0), (ACTIONS, 0.3), (0, 1.0)])
def test_loss_is_the_papers(proxies, actions, weight):
    rng = np.random.default_rng(0)
    latent = actions or LATENT_WITHOUT_ACTIONS
    sizes = {
        "recognition": (2 * OBS + proxies, 5, 2 * latent),
        "prior": (OBS + proxies, 5, 2 * latent),
        "decoder": (latent + OBS + proxies, 5, OBS),
    }
    params = {name: init_mlp(jax.random.key(i), size) for i, (name, size) in enumerate(sizes.items())}
    inputs = Inputs(*(rng.normal(size=(7, width)) for width in (OBS, actions, OBS, proxies)))
    noise = np.asarray(jax.random.normal(jax.random.key(5), (7, latent)), float)
    expected = loss_in_numpy(in_numpy(params), inputs, noise, weight)
    assert loss(params, jax.random.key(5), inputs, weight) == pytest.approx(expected, rel=1e-4)


# The reward


@pytest.mark.parametrize("method", ["giril", "mcond-giril", "giril-obs"])
def test_reward_is_the_decoders_squared_error(method):
    model, demos = built(method, giril_steps=5), demos_of(steps_of(np.random.default_rng(0), shift=0.5))
    steps = steps_of(np.random.default_rng(1), time=3, envs=4)
    state = jax.jit(model.init)(jax.random.key(0), demos)
    _, reward = model.reward(state, (), CONTEXT, steps)
    params = in_numpy(state.inner)
    raw = np.asarray(demos.obs, float)
    for t, e in np.ndindex(*reward.shape):
        obs, next_obs = ((np.asarray(o[t, e]) - raw.mean(0)) / raw.std(0) for o in (steps.obs, steps.next_obs))
        given = np.concatenate([obs, steps.proxy[t, e]]) if method == "mcond-giril" else obs
        action = steps.action[t, e]
        if method == "giril-obs":
            action = np.tanh(gaussian_in_numpy(params["recognition"], np.concatenate([given, next_obs]))[0])
        decoded = obs + forward(params["decoder"], np.concatenate([action, given]))
        assert reward[t, e] == pytest.approx(np.linalg.norm(decoded - next_obs) ** 2, rel=1e-3)


# Learning


@pytest.fixture(scope="module", params=["giril", "mcond-giril"])
def trained(request):
    model = built(request.param, **TRAINED)
    state = jax.jit(model.init)(jax.random.key(0), demos_of(expert_steps(np.random.default_rng(0))))
    return model, state


def surprise(trained, steps):
    model, state = trained
    return np.asarray(model.reward(state, (), CONTEXT, steps)[1])


def test_it_is_surprised_by_what_the_expert_would_not_do(trained):
    held_out, random = expert_steps(np.random.default_rng(1)), random_steps(np.random.default_rng(2))
    assert area_under_curve(-surprise(trained, held_out), -surprise(trained, random)) > 0.9


def test_it_knows_transitions_and_not_only_where_the_expert_is(trained):
    # The expert's own states and actions, with next states of other steps: only their connection is wrong.
    held_out = expert_steps(np.random.default_rng(1))
    mixed = held_out._replace(next_obs=np.roll(held_out.next_obs, 7, axis=1))
    assert area_under_curve(-surprise(trained, held_out), -surprise(trained, mixed)) > 0.9


def test_its_decoder_is_the_forward_model_of_the_experts_world(trained):
    # Its error is that of the noise, 0.1 deviations in each of three places, plus a little model error.
    held_out = expert_steps(np.random.default_rng(1))
    spread = np.asarray(held_out.obs).reshape(-1, OBS).std(0)
    noise = np.sum(np.square(0.1 * np.array([2.0, 0.5, 1.0]) / spread))
    assert noise / 2 < surprise(trained, held_out).mean() < 3 * noise


def test_it_learns_before_the_run_and_then_no_more(trained):
    model, state = trained
    expert, policy = (demos_of(steps_of(np.random.default_rng(3))), steps_of(np.random.default_rng(4)))
    after, info = model.update(jax.random.key(0), state, CONTEXT, expert, policy)
    assert not model.learns and info == {}
    for leaf, other_leaf in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(leaf, other_leaf)


def test_without_actions_it_is_blind_to_them():
    model = built("giril-obs", giril_steps=5)
    rng = np.random.default_rng(0)
    demos, steps = demos_of(steps_of(rng)), steps_of(rng)
    init = jax.jit(model.init)
    state, other = (init(jax.random.key(0), d) for d in (demos, demos._replace(action=-demos.action)))
    for leaf, other_leaf in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(leaf, other_leaf)
    rewards, other_rewards = (
        model.reward(state, (), CONTEXT, s)[1] for s in (steps, steps._replace(action=-steps.action))
    )
    np.testing.assert_array_equal(rewards, other_rewards)
