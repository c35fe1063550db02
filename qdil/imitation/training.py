"""How reward models learn: random rows of both sides, Adam on a loss."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.reward_model import Info, Inputs
from qdil.types import Params


class AdamState(NamedTuple):
    """Parameters and their optimiser's state."""

    params: Params
    opt: optax.OptState


def flat(inputs: Inputs) -> Inputs:
    """Inputs with all leading axes joined into rows."""
    return jax.tree.map(lambda x: x.reshape(math.prod(x.shape[:-1]), x.shape[-1]), inputs)


def rows(key: jax.Array, inputs: Inputs, size: int) -> Inputs:
    """``size`` rows drawn evenly with replacement from inputs whose leading axes are flattened first."""
    one = flat(inputs)
    index = jax.random.randint(key, (size,), 0, one.obs.shape[0])
    return jax.tree.map(lambda x: jnp.take(x, index, axis=0), one)


def in_minibatches(
    step: Callable[[jax.Array, Any, Inputs, Inputs], tuple[Any, Info]], steps: int, size: int
) -> Callable[..., tuple[Any, Info]]:
    """An ``update`` of ``steps`` calls of ``step(key, state, expert, policy)``, each on ``size`` rows of both."""

    def update(key: jax.Array, state: Any, expert: Inputs, policy: Inputs) -> tuple[Any, Info]:
        def one(state: Any, key: jax.Array):
            expert_key, policy_key, step_key = jax.random.split(key, 3)
            return step(step_key, state, rows(expert_key, expert, size), rows(policy_key, policy, size))

        state, info = jax.lax.scan(one, state, jax.random.split(key, steps))
        return state, jax.tree.map(lambda x: x[-1], info)

    return update


def by_adam(
    config: Config, loss: Callable[[Params, jax.Array, Inputs, Inputs], tuple[jax.Array, Info]]
) -> tuple[Callable[[Params], AdamState], Callable[..., tuple[AdamState, Info]]]:
    """``(begin, update)`` of a model that lowers ``loss(params, key, expert, policy) -> (value, info)`` by Adam."""
    opt = optax.adam(config.reward.reward_learning_rate)

    def begin(params: Params) -> AdamState:
        return AdamState(params, opt.init(params))

    def step(key: jax.Array, state: AdamState, expert: Inputs, policy: Inputs) -> tuple[AdamState, Info]:
        grads, info = jax.grad(loss, has_aux=True)(state.params, key, expert, policy)
        change, opt_state = opt.update(grads, state.opt)
        return AdamState(optax.apply_updates(state.params, change), opt_state), info

    return begin, in_minibatches(step, config.reward.reward_steps, config.reward.reward_batch)
