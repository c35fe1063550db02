"""What a reward model is: a value of four pure functions; and the inputs it may see, with their transformations."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdil.search.normalise import normalise_obs
from qdil.types import ObsStats, RewardContext, Transitions


class Inputs(NamedTuple):
    """What a learned reward may read of a step; expert and policy batches take the same form."""

    obs: jax.Array  # (…, O) s_t, normalised
    action: jax.Array  # (…, A) a_t in [-1, 1]; width 0 for observation-only models
    next_obs: jax.Array  # (…, O) s_{t+1}, normalised
    proxy: jax.Array  # (…, k) δ(s_t); width 0 without measure conditioning


class Demonstrations(NamedTuple):
    """Expert steps, rows (N): state, action, next state and proxy of the same step."""

    obs: jax.Array  # (N, O) raw
    action: jax.Array  # (N, A)
    next_obs: jax.Array  # (N, O) raw
    proxy: jax.Array  # (N, k)


class RewardModel(NamedTuple):
    """r(s, a, s', δ) as a value. State and carry are pytrees of arrays; every function is pure.

    ``init(key, demonstrations) -> state``;
    ``begin(state, num_envs) -> carry``, what a reward must remember within episodes (nothing for most);
    ``reward(state, carry, context, transitions) -> (carry, r)``, r (T, E) for transitions (T, E), without bonus;
    ``update(key, state, context, demonstrations, transitions) -> (state, info)``, one round of learning.
    """

    init: Callable[[jax.Array, Demonstrations | None], Any]
    begin: Callable[[Any, int], Any]
    reward: Callable[[Any, Any, RewardContext, Transitions], tuple[Any, jax.Array]]
    update: Callable[..., tuple[Any, dict[str, jax.Array]]]
    learns: bool  # False: ``update`` does nothing and needs no data


Select = Callable[[Inputs], Inputs]


def without_proxy(inputs: Inputs) -> Inputs:
    """Plain imitation: hide δ(s)."""
    return inputs._replace(proxy=inputs.proxy[..., :0])


def with_proxy(inputs: Inputs) -> Inputs:
    """Measure conditioning (eq. 3): δ(s) is one more input."""
    return inputs


def policy_inputs(transitions: Transitions, stats: ObsStats) -> Inputs:
    """Inputs of policy steps."""
    obs, next_obs = normalise_obs(stats, transitions.obs), normalise_obs(stats, transitions.next_obs)
    return Inputs(obs, transitions.action, next_obs, transitions.proxy)


def expert_inputs(demos: Demonstrations, stats: ObsStats) -> Inputs:
    """Inputs of expert steps, through the very normaliser that policy steps go through."""
    return Inputs(normalise_obs(stats, demos.obs), demos.action, normalise_obs(stats, demos.next_obs), demos.proxy)


def true_reward() -> RewardModel:
    """The environment's own reward: PPGA itself, the expert."""

    def reward(state: Any, carry: Any, context: RewardContext, transitions: Transitions) -> tuple[Any, jax.Array]:
        return carry, transitions.reward

    def update(key, state, context, demos, transitions):
        return state, {}

    return RewardModel(lambda key, demos: (), lambda state, num_envs: (), reward, update, learns=False)


def rows(key: jax.Array, inputs: Inputs, size: int) -> Inputs:
    """``size`` rows drawn evenly with replacement from inputs whose leading axes are flattened first."""
    flat = jax.tree.map(lambda x: x.reshape(math.prod(x.shape[:-1]), x.shape[-1]), inputs)
    index = jax.random.randint(key, (size,), 0, flat.obs.shape[0])
    return jax.tree.map(lambda x: jnp.take(x, index, axis=0), flat)
