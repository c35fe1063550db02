"""Maximum-entropy IRL (Ziebart et al., 2008; with a network, Wulfmeier et al., 2015).

The likelihood of the demonstrations under p(τ) ∝ exp(Σ r_ψ) has the gradient E_D[∇r_ψ] − E_π[∇r_ψ], with π the policy
that is optimal for r_ψ: here the policy being trained, whose fresh steps stand for that expectation.

A reward that only ever rises on one set and falls on another has no bound, so the network's output goes through tanh:
r ∈ (−1, 1).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.registry import register
from qdil.imitation.reward_model import InputModel, Inputs, features, in_minibatches
from qdil.search.networks import init_mlp, mlp
from qdil.types import Params


class MaxEntState(NamedTuple):
    """The reward network and its optimiser."""

    params: Params
    opt: optax.OptState


def rewards_of(params: Params, x: jax.Array) -> jax.Array:
    """r_ψ (…,) in (−1, 1) of features (…, F)."""
    return jnp.tanh(mlp(params, x)[..., 0])


def negative_log_likelihood_gap(params: Params, expert: jax.Array, policy: jax.Array) -> jax.Array:
    """E_π[r] − E_D[r]: its gradient in ψ is that of the demonstrations' negative log likelihood per step."""
    return jnp.mean(rewards_of(params, policy)) - jnp.mean(rewards_of(params, expert))


@register("maxent", "a reward network raised on demonstrations and lowered on the policy", signed=True)
def maxent(config: Config, widths: Inputs) -> InputModel:
    """Rewards r_ψ(s, a, δ)."""
    opt = optax.adam(config.reward_learning_rate)
    size = widths.obs + widths.action + widths.proxy

    def init(key: jax.Array, expert: Inputs) -> MaxEntState:
        params = init_mlp(key, (size, *config.reward_hidden, 1))
        return MaxEntState(params, opt.init(params))

    def reward(state: MaxEntState, carry: Any, inputs: Inputs, ended: jax.Array) -> tuple[Any, jax.Array]:
        return carry, rewards_of(state.params, features(inputs))

    def step(key: jax.Array, state: MaxEntState, expert: Inputs, policy: Inputs):
        gap, grads = jax.value_and_grad(negative_log_likelihood_gap)(state.params, features(expert), features(policy))
        change, opt_state = opt.update(grads, state.opt)
        return MaxEntState(optax.apply_updates(state.params, change), opt_state), {"reward_gap": -gap}

    update = in_minibatches(step, config.reward_steps, config.reward_batch)
    return InputModel(init, lambda state, num_envs: (), reward, update)
