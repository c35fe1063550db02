"""VAIL: its divergence, loss and penalty against integrals and NumPy, the multiplier β, and the mean latent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import ACTIONS, CONTEXT, OBS, STATS, built, demos_of, forward, in_numpy, steps_of
from scipy.integrate import quad
from scipy.stats import norm

from qdil.config import make_config
from qdil.imitation.rewards.vail import encode, kl_to_standard_normal, loss, next_beta

pytestmark = pytest.mark.compiles

ROWS, FEATURES, LATENT = 6, 4, 3


def config(**settings):
    return make_config("walker2d", "vail", "smoke", vail_latent=LATENT, **settings)


@pytest.fixture
def problem():
    """Parameters of an encoder with one hidden layer and a linear head, and rows of both kinds."""
    rng = np.random.default_rng(0)

    def layer(fan_in, fan_out):
        return {"w": rng.normal(size=(fan_in, fan_out)) / 2, "b": rng.normal(size=fan_out) / 2}

    params = {"encoder": [layer(FEATURES, 5), layer(5, 2 * LATENT)], "head": [layer(LATENT, 1)]}
    expert, policy = rng.normal(size=(2, ROWS, FEATURES))
    return params, expert, policy


# The divergence


def test_divergence_is_the_integral():
    mean, log_std = np.array([0.7, -1.5, 0.0, 3.0]), np.array([-1.0, 0.4, 0.0, -0.2])

    def one(mean, std):
        q, p = norm(mean, std), norm()
        return quad(lambda z: q.pdf(z) * (q.logpdf(z) - p.logpdf(z)), mean - 12 * std, mean + 12 * std)[0]

    by_hand = sum(one(m, np.exp(s)) for m, s in zip(mean, log_std, strict=True))
    assert kl_to_standard_normal(mean, log_std) == pytest.approx(by_hand, rel=1e-5)


def test_divergence_of_many_rows_is_each_rows_own():
    mean, log_std = np.random.default_rng(0).normal(size=(2, 4, 5, LATENT))
    together = kl_to_standard_normal(mean, log_std)
    for at in np.ndindex(4, 5):
        assert together[at] == pytest.approx(float(kl_to_standard_normal(mean[at], log_std[at])), rel=1e-5)
    assert kl_to_standard_normal(np.zeros(LATENT), np.zeros(LATENT)) == 0


# The loss


def loss_in_numpy(params, beta, expert, policy, noise, mix, settings):
    """Eq. 5's Lagrangian with the gradient penalty, by loops over rows; noise (2N, Z), mixing weights (N, 1 or F)."""
    (first, last), (head,) = params["encoder"], params["head"]
    squashed = settings.reward.vail_encoder == "squashed"
    cross_entropy, information, penalty = 0.0, 0.0, 0.0
    for i, x in enumerate([*expert, *policy]):
        mean, log_std = np.split(forward(params["encoder"], x), 2)
        std = np.exp(log_std)
        if squashed:
            mean, std = np.tanh(mean), 1 / (1 + np.exp(-np.tanh(log_std)))
        d = 1 / (1 + np.exp(-((mean + std * noise[i]) @ head["w"] + head["b"])[0]))
        cross_entropy -= np.log(d) / len(expert) if i < len(expert) else np.log(1 - d) / len(policy)
        information += sum((m**2 + s**2 - 1) / 2 - np.log(s) for m, s in zip(mean, std, strict=True))
    information /= len(expert) + len(policy)
    for x, y, share in zip(expert, policy, mix, strict=True):
        hidden = np.tanh((share * x + (1 - share) * y) @ first["w"] + first["b"])
        steepness = 1 - np.tanh(hidden @ last["w"] + last["b"])[:LATENT] ** 2 if squashed else 1
        slope = first["w"] @ ((1 - hidden**2) * (last["w"][:, :LATENT] @ (steepness * head["w"][:, 0])))
        penalty += (np.linalg.norm(slope) - 1) ** 2 / len(expert)
    constraint = beta * (information - settings.reward.vail_information)
    return cross_entropy + constraint + settings.reward.gradient_penalty * penalty, cross_entropy, information


@pytest.mark.parametrize("beta", [0.0, 0.3])
@pytest.mark.parametrize("mixing", ["sample", "element"])
@pytest.mark.parametrize("how", ["adaptive", "fixed"])
@pytest.mark.parametrize("encoder", ["linear", "squashed"])
def test_loss_is_the_papers(problem, beta, mixing, how, encoder):
    settings = config(vail_beta=how, penalty_mixing=mixing, gradient_penalty=2.0, vail_encoder=encoder)
    noise_key, mix_key = jax.random.split(jax.random.key(7))
    noise = np.asarray(jax.random.normal(noise_key, (2 * ROWS, LATENT))) * (how == "adaptive")
    mix = np.asarray(jax.random.uniform(mix_key, (ROWS, 1 if mixing == "sample" else FEATURES)))
    params, expert, policy = problem
    total, cross_entropy, information = loss_in_numpy(params, beta, expert, policy, noise, mix, settings)
    given, info = loss(params, beta, expert, policy, jax.random.key(7), settings)
    assert given == pytest.approx(total, rel=1e-4)
    assert info["discriminator_loss"] == pytest.approx(cross_entropy, rel=1e-4)
    assert info["information"] == pytest.approx(information, rel=1e-4)


def test_only_an_adaptive_bottleneck_draws_the_latent(problem):
    params, expert, policy = problem

    def losses(how):
        settings = config(vail_beta=how, gradient_penalty=0.0)
        return {float(loss(params, 1.0, expert, policy, jax.random.key(i), settings)[0]) for i in range(4)}

    assert len(losses("fixed")) == 1 and len(losses("adaptive")) == 4


def test_deviations_stay_within_what_floats_can_hold(problem):
    params, expert, _ = problem
    wild = {**params, "encoder": [params["encoder"][0], {"w": params["encoder"][1]["w"] * 1e4, "b": np.zeros(6)}]}
    mean, log_std = encode(wild, expert)
    assert np.abs(mean).max() > 1e3 and np.isfinite(kl_to_standard_normal(mean, log_std)).all()
    assert log_std.min() == -10 and log_std.max() == 5


# The multiplier


def test_beta_by_hand():
    assert next_beta(0.5, 3.0, 1.0, 0.1) == pytest.approx(0.7)
    assert next_beta(0.5, 0.5, 1.0, 0.1) == pytest.approx(0.45)
    assert next_beta(0.01, 0.5, 1.0, 0.1) == 0
    assert next_beta(0.25, 1.0, 1.0, 0.1) == 0.25


def learned(beta, **settings):
    """What one update makes of ``beta``, and the information before its last step, in nats."""
    model = built("vail", vail_latent=LATENT, vail_beta_rate=0.01, reward_learning_rate=3e-3, **settings)
    rng = np.random.default_rng(0)
    expert, policy = demos_of(steps_of(rng)), steps_of(rng)
    state = model.init(jax.random.key(0), expert)
    state = state._replace(inner=state.inner._replace(beta=jnp.asarray(beta)))
    state, info = jax.jit(model.update)(jax.random.key(1), state, CONTEXT, expert, policy)
    assert info["beta"] == state.inner.beta
    return float(state.inner.beta), float(info["information"])


@pytest.mark.parametrize(("limit", "way"), [(0.5, 1), (10.0, -1)])
def test_beta_takes_a_step_along_the_constraint(limit, way):
    beta, information = learned(0.25, vail_information=limit, reward_steps=1)
    assert beta == pytest.approx(0.25 + 0.01 * (information - limit), rel=1e-5)
    assert (beta - 0.25) * way > 0.001


def test_beta_rises_to_hold_information_back_and_else_rests_at_nothing():
    rising, held_back = learned(0.0, vail_information=0.0, reward_steps=100)
    resting, let_through = learned(0.5, vail_information=100.0, reward_steps=100)
    assert rising > 0.3 and resting == 0
    assert held_back < 0.5 * let_through


@pytest.mark.parametrize(("how", "first"), [("fixed", 1.0), ("adaptive", 0.0)])
def test_where_beta_begins(how, first):
    rng = np.random.default_rng(0)
    state = built("vail", vail_beta=how).init(jax.random.key(0), demos_of(steps_of(rng)))
    assert state.inner.beta == first


def test_a_fixed_beta_stays_one():
    assert learned(1.0, vail_information=100.0, vail_beta="fixed")[0] == 1


# The reward


@pytest.mark.parametrize("method", ["vail", "mcond-vail"])
def test_reward_is_of_the_mean_latent(method):
    model = built(method, vail_latent=LATENT)
    steps = steps_of(np.random.default_rng(1), time=3, envs=4)
    state = model.init(jax.random.key(0), demos_of(steps))
    _, reward = model.reward(state, (), CONTEXT, steps)
    params = in_numpy(state.inner.params)
    assert len(params["encoder"][0]["w"]) == OBS + ACTIONS + (2 if method == "mcond-vail" else 0)
    for t, e in np.ndindex(*reward.shape):
        x = np.concatenate([(steps.obs[t, e] - STATS.mean) / STATS.std, steps.action[t, e]])
        x = np.concatenate([x, steps.proxy[t, e]]) if method == "mcond-vail" else x
        mean = forward(params["encoder"], x)[:LATENT]
        d = 1 / (1 + np.exp(-forward(params["head"], mean)[0]))
        assert reward[t, e] == pytest.approx(-np.log(1 - d), rel=1e-3)


def test_a_squashed_encoders_latent_is_half_of_its_last_hidden_layer():
    # The released program's: 100 units, of which 50 are the mean and 50 give deviations below 1.
    model = built("mcond-vail", reward_hidden=(7, 100), vail_encoder="squashed", vail_latent=LATENT)
    steps = steps_of(np.random.default_rng(1), time=3, envs=4)
    state = model.init(jax.random.key(0), demos_of(steps))
    params = in_numpy(state.inner.params)
    widths = [layer["w"].shape for layer in (*params["encoder"], *params["head"])]
    assert widths == [(OBS + ACTIONS + 2, 7), (7, 100), (50, 1)]
    _, reward = model.reward(state, (), CONTEXT, steps)
    for at in np.ndindex(*reward.shape):
        x = np.concatenate([(steps.obs[at] - STATS.mean) / STATS.std, steps.action[at], steps.proxy[at]])
        layers = [np.tanh(forward(params["encoder"][:1], x))]
        mean = np.tanh(layers[0] @ params["encoder"][1]["w"] + params["encoder"][1]["b"])[:50]
        d = 1 / (1 + np.exp(-forward(params["head"], mean)[0]))
        assert reward[at] == pytest.approx(-np.log(1 - d), rel=1e-3)


def test_deviations_of_a_squashed_encoder_are_sigmoids_of_its_other_half():
    layer = {"w": np.diag([1.0, 2.0, 3.0, -100.0]), "b": np.zeros(4)}
    mean, log_std = encode({"encoder": [layer]}, np.ones(4), "squashed")
    np.testing.assert_allclose(mean, np.tanh([1, 2]), rtol=1e-6)
    np.testing.assert_allclose(np.exp(log_std), [1 / (1 + np.exp(-np.tanh(3))), 1 / (1 + np.e)], rtol=1e-6)
