"""Rewards that imitate nobody: the environment's own (PPGA, the expert), and none at all."""

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.imitation.reward_model import RewardModel
from qdil.types import RewardContext, RewardMemory, RewardState, Transitions


def true_reward(config: Config) -> RewardModel:
    """r is the environment's own."""

    def reward(
        state: RewardState, memory: RewardMemory, context: RewardContext, transitions: Transitions
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, transitions.reward

    return RewardModel(lambda key, demos: (), reward)


def zero_reward(config: Config) -> RewardModel:
    """r = 0, so that ``mbo-zero`` is the bonus alone."""

    def reward(
        state: RewardState, memory: RewardMemory, context: RewardContext, transitions: Transitions
    ) -> tuple[RewardMemory, jax.Array]:
        return memory, jnp.zeros_like(transitions.reward)

    return RewardModel(lambda key, demos: (), reward)
