"""VAIL (eqs. 5, 6, 8): GAIL whose discriminator sees a step through an information bottleneck.

It is also known as the variational discriminator bottleneck. An encoder E'(z|s, a, δ) = N(μ, diag σ²) maps a step to a
latent vector z, and the discriminator D reads z alone. With expert and policy steps in equal parts as the mixture,
min_{D,E'} max_{β≥0} E_D[−log D(z)] + E_π[−log(1−D(z))] + β (E_mixture[KL(E'(z|·) ‖ N(0, I))] − I_c),  z ~ E'.
Signs are as in GAIL; the reward is −log(1−D(μ)) ≥ 0.

Eqs. 5 and 8 print the expert's term as log(−D(z)), which is undefined for D ∈ (0, 1). We take −log D(z), as in Peng et
al. The gradient penalty is GAIL's, taken through the mean latent μ.
Departures from the authors' released program: β adapts and z is sampled (``vail_beta=fixed``: β = 1 and z = μ, as in
that program). μ and log σ are linear functions of the last hidden layer; the program takes μ ∈ (−1, 1) and
σ = sigmoid(·) from the two halves of that layer itself, 50 units each (``vail_encoder=squashed``).
Its measure-conditioned VAIL adds a bonus for rarely visited δ to the reward (``vail_visits``, in
``qdil.imitation.fitness``).

Reference
- X. B. Peng, A. Kanazawa, S. Toyer, P. Abbeel, S. Levine, 2018. Variational Discriminator Bottleneck: Improving
  Imitation Learning, Inverse RL, and GANs by Constraining Information Flow. arXiv:1810.00821.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features
from qdil.imitation.rewards.gail import cross_entropy, gradient_penalty, logits, mixing_weights
from qdil.imitation.training import in_minibatches
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory


class VailState(NamedTuple):
    """Weights of encoder and discriminator, their optimiser's state, and the multiplier β of the constraint."""

    params: Params
    opt: optax.OptState
    beta: jax.Array  # ()


def encode(params: Params, x: jax.Array, how: str = "linear") -> tuple[jax.Array, jax.Array]:
    """Mean μ and log deviation log σ, both (…, Z), of E'(z|x) for features ``x`` (…, F).

    ``how`` "squashed": one more tanh, whose halves are μ ∈ (−1, 1) and the logit of σ ∈ (0.27, 0.73).
    """
    mean, log_std = jnp.split(mlp(params["encoder"], x), 2, axis=-1)
    if how == "squashed":
        return jnp.tanh(mean), jax.nn.log_sigmoid(jnp.tanh(log_std))
    return mean, jnp.clip(log_std, -10.0, 5.0)


def encoder_sizes(config: Config, inputs: int) -> tuple[int, ...]:
    """Widths of the encoder's layers; the last is 2 Z. A squashed encoder splits the last of ``reward_hidden``."""
    hidden = config.reward.reward_hidden
    if config.reward.vail_encoder == "squashed":
        return (inputs, *hidden[:-1], 2 * max(1, hidden[-1] // 2))
    return (inputs, *hidden, 2 * config.reward.vail_latent)


def kl_to_standard_normal(mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """KL(N(μ, diag σ²) ‖ N(0, I)) (…,) in nats, from μ and log σ (…, Z)."""
    return 0.5 * jnp.sum(jnp.square(mean) + jnp.exp(2.0 * log_std) - 1.0 - 2.0 * log_std, axis=-1)


def next_beta(beta: jax.Array, information: jax.Array, limit: float, rate: float) -> jax.Array:
    """β after one step of dual ascent: it rises while ``information`` exceeds ``limit`` (nats), and stays ≥ 0."""
    return jnp.maximum(0.0, beta + rate * (information - limit))


def loss(
    params: Params, beta: jax.Array, expert: jax.Array, policy: jax.Array, key: jax.Array, config: Config
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The Lagrangian of eq. 5 at ``beta``, plus the gradient penalty, on features (N, F) of expert and policy steps."""
    noise_key, mix_key = jax.random.split(key)
    how = config.reward.vail_encoder
    mean, log_std = encode(params, jnp.concatenate([expert, policy]), how)
    noise = jax.random.normal(noise_key, mean.shape) if config.reward.vail_beta == "adaptive" else 0.0
    expert_logit, policy_logit = jnp.split(logits(params["head"], mean + jnp.exp(log_std) * noise), 2)
    total, info = cross_entropy(expert_logit, policy_logit)
    information = jnp.mean(kl_to_standard_normal(mean, log_std))
    mix = mixing_weights(mix_key, expert, config.reward.penalty_mixing)
    penalty = gradient_penalty(lambda x: logits(params["head"], encode(params, x, how)[0]), expert, policy, mix)
    constraint = beta * (information - config.reward.vail_information)
    return total + constraint + config.reward.gradient_penalty * penalty, {**info, "information": information}


def vail(config: Config, widths: Inputs) -> InputModel:
    """The reward −log(1−D(μ(s, a, δ))) ≥ 0 (eq. 6)."""
    opt = optax.adam(config.reward.reward_learning_rate)
    sizes = encoder_sizes(config, widths.obs + widths.action + widths.proxy)
    fixed = config.reward.vail_beta == "fixed"

    def init(key: jax.Array, expert: Inputs) -> VailState:
        encoder_key, head_key = jax.random.split(key)
        params = {
            "encoder": init_mlp(encoder_key, sizes),
            "head": init_mlp(head_key, (sizes[-1] // 2, 1)),
        }
        return VailState(params, opt.init(params), jnp.asarray(1.0 if fixed else 0.0))

    def reward(
        state: VailState, memory: RewardMemory, inputs: Inputs, ended: jax.Array
    ) -> tuple[RewardMemory, jax.Array]:
        mean, _ = encode(state.params, features(inputs), config.reward.vail_encoder)
        return memory, jax.nn.softplus(logits(state.params["head"], mean))

    def step(key: jax.Array, state: VailState, expert: Inputs, policy: Inputs):
        grads, info = jax.grad(loss, has_aux=True)(
            state.params, state.beta, features(expert), features(policy), key, config
        )
        change, opt_state = opt.update(grads, state.opt)
        beta = state.beta
        if not fixed:
            beta = next_beta(beta, info["information"], config.reward.vail_information, config.reward.vail_beta_rate)
        return VailState(optax.apply_updates(state.params, change), opt_state, beta), {**info, "beta": beta}

    update = in_minibatches(step, config)
    return InputModel(init, reward, update=update)
