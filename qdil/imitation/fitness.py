"""The fitness reward (eq. 4): a reward model's reward plus the measure bonus; and a reward model's round of learning.

Candidates are scored by the reward model alone (Algorithm 1, line 11): ``score_chunk``.
"""

import jax
import jax.numpy as jnp

from qdil.finite import all_finite
from qdil.imitation.bonus import measure_bonus
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.rl.evaluate import RewardSum, sum_counted
from qdil.rl.rollout import where_each
from qdil.types import RewardContext, RewardMemory, RewardState, Transitions


def compute_reward(
    model: RewardModel,
    scope: str,
    reward: RewardState,
    memory: RewardMemory,
    context: RewardContext,
    bonus: jax.Array,
    transitions: Transitions,
) -> tuple[RewardMemory, jax.Array]:
    """The fitness reward (T, E) of a training rollout: the model's reward plus the measure bonus (eq. 4).

    ``bonus`` is (p, q) of eq. 2, (0, 0) for methods without; ``scope`` as in ``measure_bonus``.
    """
    memory, rewards = model.reward(reward, memory, context, transitions)
    return memory, rewards + measure_bonus(transitions, context.occupied, bonus[0], bonus[1], scope)


def begin_scoring(model: RewardModel, reward: RewardState, num_episodes: int) -> RewardSum:
    """A sum of zero for each of ``num_episodes`` episodes that are about to begin."""
    return RewardSum(model.begin(reward, num_episodes), jnp.zeros(num_episodes))


def score_chunk(
    model: RewardModel,
    reward: RewardState,
    so_far: RewardSum,
    context: RewardContext,
    transitions: Transitions,
    counted: jax.Array,
) -> RewardSum:
    """Add the reward model's own reward (Algorithm 1, line 11) over the counted steps (C, T, E) of C chunks.

    Robots skipped in a chunk keep their reward-model memory unchanged.
    """

    def chunk(so_far: RewardSum, steps: tuple[Transitions, jax.Array]) -> tuple[RewardSum, None]:
        transitions, counted = steps
        memory, rewards = model.reward(reward, so_far.memory, context, transitions)
        memory = where_each(counted[0], memory, so_far.memory)
        return RewardSum(memory, so_far.fitness + sum_counted(rewards, counted)), None

    return jax.lax.scan(chunk, so_far, (transitions, counted))[0]


def update_reward(
    model: RewardModel,
    key: jax.Array,
    reward: RewardState,
    context: RewardContext,
    demos: Demonstrations,
    transitions: Transitions,
) -> tuple[RewardState, dict[str, jax.Array]]:
    """One round of the reward model's learning from demonstrations and fresh steps (Algorithm 1, line 18).

    A round that ends in numbers that are not finite is discarded and reported as ``reward_rolled_back``.
    """
    learned, info = model.update(key, reward, context, demos, transitions)
    healthy = all_finite(learned)
    kept = jax.tree.map(lambda new, old: jnp.where(healthy, new, old), learned, reward)
    return kept, {**info, "reward_rolled_back": 1.0 - healthy}
