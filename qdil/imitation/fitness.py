"""The fitness reward that VPPO maximises (eq. 4), episode scores, and one round of the reward model's learning.

The fitness reward is the reward model's reward plus the measure bonus. Candidates, however, are scored by the reward
model alone (Algorithm 1, line 11): ``score_chunk``. The fitness reward is not the true reward, which is the
environment's own and which no imitating model reads.
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

    ``bonus`` (2,) is (p, q) of eq. 2, and (0, 0) for methods without the bonus; ``scope`` as in ``measure_bonus``.
    Also returns the model's memory after the rollout.
    """
    memory, rewards = model.reward(reward, memory, context, transitions)
    return memory, rewards + measure_bonus(transitions, context.occupied, bonus[0], bonus[1], scope)


def begin_scoring(model: RewardModel, reward: RewardState, num_episodes: int) -> RewardSum:
    """A sum of zero, and a fresh memory, for each of ``num_episodes`` episodes (E)."""
    return RewardSum(model.begin(reward, num_episodes), jnp.zeros(num_episodes))


def score_chunk(
    model: RewardModel,
    reward: RewardState,
    so_far: RewardSum,
    context: RewardContext,
    transitions: Transitions,
    counted: jax.Array,
) -> RewardSum:
    """Add the model's own reward, without bonus (Algorithm 1, line 11), for C chunks of evaluation steps.

    ``transitions`` have axes (C, T, E) in front; ``counted`` (C, T, E) bool marks the steps to add. Robots skipped in a
    chunk keep their reward-model memory unchanged.
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
    """One round of the model's learning from demonstrations and fresh policy steps (T, E) (Algorithm 1, line 18).

    If the round produces a number that is not finite, its result is discarded and ``reward_rolled_back`` in the
    returned measurements is 1.
    """
    learned, info = model.update(key, reward, context, demos, transitions)
    healthy = all_finite(learned)
    kept = jax.tree.map(lambda new, old: jnp.where(healthy, new, old), learned, reward)
    return kept, {**info, "reward_rolled_back": 1.0 - healthy}
