"""Rewards without imitation: the environment's own (method ``true``: PPGA, the expert) and zero (method ``zero``)."""

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import RewardModel
from qdil.types import RewardContext, RewardMemory, RewardState, Transitions


def true_reward(config: Config) -> RewardModel:
    """r is the environment's own reward; with it, the search is PPGA and trains the expert."""

    def reward(
        state: RewardState, memory: RewardMemory, context: RewardContext, transitions: Transitions
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, transitions.reward

    return RewardModel(lambda key, demos: (), reward)


def zero_reward(config: Config) -> RewardModel:
    """r = 0 everywhere, so that ``mbo-zero`` maximises the measure bonus alone."""

    def reward(
        state: RewardState, memory: RewardMemory, context: RewardContext, transitions: Transitions
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, jnp.zeros_like(transitions.reward)

    return RewardModel(lambda key, demos: (), reward)
