"""Maximum-entropy inverse reinforcement learning with a reward network ("Max-Ent" in the paper's figures).

The log likelihood of the demonstrations under p(τ) ∝ exp(Σ r_ψ) has the gradient E_D[∇r_ψ] − E_π[∇r_ψ], where π is the
policy that is optimal for r_ψ. Here π is the policy in training, and its fresh steps estimate the second expectation.

This gradient alone would let r_ψ grow without bound on expert steps and fall without bound on policy steps, so the
network's output passes through tanh: r ∈ (−1, 1).
This is not maximum-entropy reinforcement learning (soft actor-critic), which adds entropy to the return.

References
- B. D. Ziebart, A. Maas, J. A. Bagnell, A. K. Dey, 2008. Maximum Entropy Inverse Reinforcement Learning. AAAI.
- M. Wulfmeier, P. Ondruska, I. Posner, 2015. Maximum Entropy Deep Inverse Reinforcement Learning. arXiv:1507.04888.
"""

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import InputModel, Inputs, features
from qdil.imitation.training import AdamState, by_adam
from qdil.rl.networks import init_mlp, mlp
from qdil.types import Params, RewardMemory


def rewards_of(params: Params, x: jax.Array) -> jax.Array:
    """r_ψ (…,) in (−1, 1) of features (…, F)."""
    return jnp.tanh(mlp(params, x)[..., 0])


def negative_log_likelihood_gap(params: Params, expert: jax.Array, policy: jax.Array) -> jax.Array:
    """E_π[r] − E_D[r] (): its gradient in ψ is that of the demonstrations' negative log likelihood per step.

    ``expert`` and ``policy`` are features (N, F); their numbers of rows may differ.
    """
    return jnp.mean(rewards_of(params, policy)) - jnp.mean(rewards_of(params, expert))


def maxent(config: Config, widths: Inputs) -> InputModel:
    """The reward r_ψ(s, a, δ) ∈ (−1, 1)."""

    def loss(params: Params, key: jax.Array, expert: Inputs, policy: Inputs) -> tuple[jax.Array, dict[str, jax.Array]]:
        gap = negative_log_likelihood_gap(params, features(expert), features(policy))
        return gap, {"reward_gap": -gap}

    begin, update = by_adam(config, loss)

    def init(key: jax.Array, expert: Inputs) -> AdamState:
        return begin(init_mlp(key, (widths.obs + widths.action + widths.proxy, *config.reward.reward_hidden, 1)))

    def reward(
        state: AdamState, memory: RewardMemory, inputs: Inputs, ended: jax.Array
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, rewards_of(state.params, features(inputs))

    return InputModel(init, reward, update=update)
