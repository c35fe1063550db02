"""How reward models learn during the run: minibatches of expert and policy steps, Adam on a loss."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from qdil.config import Config
from qdil.imitation.reward_model import Info, Inputs
from qdil.types import Params

SUBSAMPLED = 20  # the released program learns from one in so many steps of a demonstration


class AdamState(NamedTuple):
    """Parameters ψ and the state of their optimiser."""

    params: Params
    opt: optax.OptState


def as_rows(inputs: Inputs) -> Inputs:
    """Inputs (…) as rows (N): all leading axes joined."""
    return jax.tree.map(lambda x: x.reshape(math.prod(x.shape[:-1]), x.shape[-1]), inputs)


def sample_rows(key: jax.Array, inputs: Inputs, size: int) -> Inputs:
    """``size`` rows drawn uniformly, with replacement, from inputs with any leading axes (…)."""
    rows = as_rows(inputs)
    index = jax.random.randint(key, (size,), 0, rows.obs.shape[0])
    return jax.tree.map(lambda x: jnp.take(x, index, axis=0), rows)


def first_batch(inputs: Inputs, size: int) -> Inputs:
    """Every ``SUBSAMPLED``th row of inputs (N), at most ``size`` of them: the one batch of the released program."""
    return jax.tree.map(lambda x: x[::SUBSAMPLED][:size], inputs)


def in_minibatches(
    step: Callable[[jax.Array, Any, Inputs, Inputs], tuple[Any, Info]], config: Config
) -> Callable[..., tuple[Any, Info]]:
    """The ``update`` that calls ``step(key, state, expert, policy)`` ``reward_steps`` times.

    Each step gets ``reward_batch`` expert rows, drawn at random, or with ``expert_batches=first`` the rows of
    ``first_batch``; and equally many policy rows, drawn at random. The measurements are those of the last step.
    """
    settings, first = config.reward, config.demos.expert_batches == "first"

    def update(key: jax.Array, state: Any, expert: Inputs, policy: Inputs) -> tuple[Any, Info]:
        def minibatch(state: Any, key: jax.Array) -> tuple[Any, Info]:
            expert_key, policy_key, step_key = jax.random.split(key, 3)
            size = settings.reward_batch
            expert_rows = first_batch(expert, size) if first else sample_rows(expert_key, expert, size)
            policy_rows = sample_rows(policy_key, policy, len(expert_rows.obs))
            return step(step_key, state, expert_rows, policy_rows)

        state, info = jax.lax.scan(minibatch, state, jax.random.split(key, settings.reward_steps))
        return state, jax.tree.map(lambda x: x[-1], info)

    return update


def by_adam(
    config: Config, loss: Callable[[Params, jax.Array, Inputs, Inputs], tuple[jax.Array, Info]]
) -> tuple[Callable[[Params], AdamState], Callable[..., tuple[AdamState, Info]]]:
    """``(begin, update)`` of a model that minimises ``loss(params, key, expert, policy) -> (value, info)`` by Adam.

    ``begin(params)`` is the state before any learning. Step size, number and size of minibatches are the
    ``reward_learning_rate``, ``reward_steps`` and ``reward_batch`` of ``config``.
    """
    opt = optax.adam(config.reward.reward_learning_rate)

    def begin(params: Params) -> AdamState:
        return AdamState(params, opt.init(params))

    def step(key: jax.Array, state: AdamState, expert: Inputs, policy: Inputs) -> tuple[AdamState, Info]:
        grads, info = jax.grad(loss, has_aux=True)(state.params, key, expert, policy)
        change, opt_state = opt.update(grads, state.opt)
        return AdamState(optax.apply_updates(state.params, change), opt_state), info

    return begin, in_minibatches(step, config)
