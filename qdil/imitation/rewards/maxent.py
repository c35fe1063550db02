"""Maximum-entropy IRL (Ziebart et al., 2008; with a network, Wulfmeier et al., 2015).

The likelihood of the demonstrations under p(τ) ∝ exp(Σ r_ψ) has the gradient E_D[∇r_ψ] − E_π[∇r_ψ], with π the policy
that is optimal for r_ψ: here the policy being trained, whose fresh steps stand for that expectation.

A reward that only ever rises on one set and falls on another has no bound, so the network's output goes through tanh:
r ∈ (−1, 1).
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
    """E_π[r] − E_D[r]: its gradient in ψ is that of the demonstrations' negative log likelihood per step."""
    return jnp.mean(rewards_of(params, policy)) - jnp.mean(rewards_of(params, expert))


def maxent(config: Config, widths: Inputs) -> InputModel:
    """Rewards r_ψ(s, a, δ)."""

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
