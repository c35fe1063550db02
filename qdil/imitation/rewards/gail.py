"""GAIL (eq. 7) and, with δ(s) among its inputs, measure-conditioned GAIL (eq. 3).

Signs: D_ψ = sigmoid(logit) is the probability that a step is the *expert's*. The discriminator minimises
E_D[−log D] + E_π[−log(1−D)]. The reward of a step is −log(1−D) = softplus(logit) ≥ 0: higher for steps that look like
the expert's, and never negative, so a robot gains by staying alive whatever it does.
AIRL's reward is another one: log D − log(1−D), which has either sign.

Departures from the authors' released program: expert and policy observations share one normaliser (``expert_obs``).
Expert rows are drawn at random; the program always takes the same batch (``expert_batches``). The gradient penalty,
which the paper does not mention, mixes per sample; the program mixes per element (``penalty_mixing``).

References
- J. Ho, S. Ermon, 2016. Generative Adversarial Imitation Learning. arXiv:1606.03476.
- I. Gulrajani, F. Ahmed, M. Arjovsky, V. Dumoulin, A. Courville, 2017. Improved Training of Wasserstein GANs.
  arXiv:1704.00028 (the gradient penalty).
"""

from typing import Any

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features
from qdil.imitation.training import AdamState, by_adam
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory


def logits(params: Params, x: jax.Array) -> jax.Array:
    """The logit log D − log(1−D) (…,) of features (…, F)."""
    return mlp(params, x)[..., 0]


def mixing_weights(key: jax.Array, x: jax.Array, mixing: str) -> jax.Array:
    """Weights in [0, 1) that mix two batches like ``x`` (N, F): one per "sample" (N, 1) or per "element" (N, F)."""
    return jax.random.uniform(key, (len(x), 1 if mixing == "sample" else x.shape[1]))


def gradient_penalty(logit: Any, expert: jax.Array, policy: jax.Array, mix: jax.Array, *others: Any) -> jax.Array:
    """The mean of (‖∇_x logit(x̂)‖ − 1)² at x̂ = mix·expert + (1−mix)·policy (Gulrajani et al., 2017).

    ``expert`` and ``policy`` (N, F); ``logit`` is a function of one row (F,), and a row of each of ``others`` (N, …).
    """
    between = mix * expert + (1.0 - mix) * policy
    slopes = jax.vmap(jax.grad(logit))(between, *others)
    return jnp.mean(jnp.square(jnp.sqrt(jnp.sum(jnp.square(slopes), axis=-1) + 1e-12) - 1.0))


def cross_entropy(expert_logit: jax.Array, policy_logit: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
    """E_D[−log D] + E_π[−log(1−D)], from logits (N,) of expert and policy rows; also the shares that D gets right."""
    total = jnp.mean(jax.nn.softplus(-expert_logit)) + jnp.mean(jax.nn.softplus(policy_logit))
    info = {
        "discriminator_loss": total,
        "expert_accuracy": jnp.mean(expert_logit > 0),
        "policy_accuracy": jnp.mean(policy_logit <= 0),
    }
    return total, info


def discriminator_loss(
    params: Params, expert: jax.Array, policy: jax.Array, mix: jax.Array, penalty: float
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The discriminator's loss of eq. 3 (eq. 7 without δ) plus ``penalty`` times the gradient penalty.

    ``expert`` and ``policy`` are features (N, F), ``mix`` weights of ``mixing_weights``.
    """
    total, info = cross_entropy(logits(params, expert), logits(params, policy))
    return total + penalty * gradient_penalty(lambda x: logits(params, x), expert, policy, mix), info


def gail(config: Config, widths: Inputs) -> InputModel:
    """The reward −log(1−D(s, a, δ)) ≥ 0."""

    def loss(params: Params, key: jax.Array, expert: Inputs, policy: Inputs) -> tuple[jax.Array, dict[str, jax.Array]]:
        x, y = features(expert), features(policy)
        return discriminator_loss(
            params, x, y, mixing_weights(key, x, config.reward.penalty_mixing), config.reward.gradient_penalty
        )

    begin, update = by_adam(config, loss)

    def init(key: jax.Array, expert: Inputs) -> AdamState:
        return begin(init_mlp(key, (widths.obs + widths.action + widths.proxy, *config.reward.reward_hidden, 1)))

    def reward(
        state: AdamState, memory: RewardMemory, inputs: Inputs, ended: jax.Array
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, jax.nn.softplus(logits(state.params, features(inputs)))

    return InputModel(init, reward, update=update)
