"""Rewards that imitate nobody: the environment's own (PPGA, the expert), and none at all."""

from typing import Any

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import RewardModel
from qdil.registry import register
from qdil.types import RewardContext, Transitions


def _without_learning(reward: Any) -> RewardModel:
    def update(key, state, context, demos, transitions):
        return state, {}

    return RewardModel(lambda key, demos: (), lambda state, num_envs: (), reward, update, learns=False)


@register("true", "the environment's own reward: PPGA, the expert", imitates=False)
def true_reward(config: Config) -> RewardModel:
    """r is the environment's own."""

    def reward(state: Any, carry: Any, context: RewardContext, transitions: Transitions) -> tuple[Any, jax.Array]:
        return carry, transitions.reward

    return _without_learning(reward)


@register("zero", "no reward at all: how far the measure bonus alone gets", imitates=False, signed=True)
def zero_reward(config: Config) -> RewardModel:
    """r = 0, so that ``mbo-zero`` is the bonus alone."""

    def reward(state: Any, carry: Any, context: RewardContext, transitions: Transitions) -> tuple[Any, jax.Array]:
        return carry, jnp.zeros_like(transitions.reward)

    return _without_learning(reward)
