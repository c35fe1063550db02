"""The fitness reward that VPPO maximises (eq. 4), episode scores, and one round of the reward model's learning.

The fitness reward is the reward model's reward plus the measure bonus. Candidates, however, are scored by the reward
model alone (Algorithm 1, line 11): ``score_chunk``. The fitness reward is not the true reward, which is the
environment's own and which no imitating model reads.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from qdil.config import Config
from qdil.finite import all_finite
from qdil.imitation.bonus import begin_visits, measure_bonus, visit_bonus, visit_shares
from qdil.imitation.reward_model import Demonstrations, RewardModel
from qdil.methods import parse_method
from qdil.rl.evaluate import RewardSum, sum_counted
from qdil.rl.rollout import where_each
from qdil.types import RewardContext, RewardMemory, Rewards, RewardState, Transitions

Rows = TypeVar("Rows")
MEASURED = 256  # about so many steps of each kind are enough to measure a mean reward, and cost next to nothing


class BonusRule(NamedTuple):
    """What a run adds to the model's reward; p and q are arguments."""

    scope: str  # the value of ``bonus_scope``
    visits: bool  # whether 1 / (1 + ρ) of ``visit_bonus`` is added besides (``vail_visits``)

    @property
    def counts_visits(self) -> bool:
        """Whether the visits of δ must be counted."""
        return self.visits or self.scope == "step"


def bonus_rule(config: Config) -> BonusRule:
    """The rule of a run. Only measure-conditioned VAIL, with or without the measure bonus, reads ``vail_visits``.

    In the authors' released program the reward of that model, and of no other in use, has a bonus for visits.
    """
    method = parse_method(config.method)
    visits = config.reward.vail_visits and method.base.name == "vail" and method.conditioned
    return BonusRule(config.bonus.bonus_scope, visits)


class TrainingMemory(NamedTuple):
    """What is remembered of the training robots, axis (E) in front."""

    model: RewardMemory  # what the reward model remembers within their episodes
    visits: jax.Array | tuple[()]  # (E, 2^k) visits of each δ since the run began; () if they are not counted


def begin_training(model: RewardModel, rule: BonusRule, reward: RewardState, num_envs: int, k: int) -> TrainingMemory:
    """The memory of ``num_envs`` training robots (E) before their first step."""
    visits = begin_visits(num_envs, k) if rule.counts_visits else ()
    return TrainingMemory(model.begin(reward, num_envs), visits)


def compute_reward(
    model: RewardModel,
    rule: BonusRule,
    reward: RewardState,
    memory: TrainingMemory,
    context: RewardContext,
    bonus: jax.Array,
    transitions: Transitions,
    axis: str | None = None,
) -> tuple[TrainingMemory, Rewards]:
    """The fitness reward (T, E) of a training rollout: the model's reward plus the measure bonus (eq. 4); its parts.

    ``bonus`` (2,) is (p, q) of eq. 2, and (0, 0) for methods without the bonus. ``axis`` as in ``visit_shares``.
    Also returns the memory after the rollout.
    """
    p, q, visits = bonus[0], bonus[1], memory.visits
    of_model, learned = model.reward(reward, memory.model, context, transitions)
    if rule.counts_visits:
        assert not isinstance(visits, tuple), "begin_training counts visits by the same rule"
        visits, shares = visit_shares(transitions.proxy, visits, axis)
    if rule.scope == "step":
        q_share = visit_bonus(shares)
    else:
        q_share = measure_bonus(transitions, context.occupied, 0.0, 1.0, rule.scope)
    rewards = learned + (p + q * q_share)
    if rule.visits:
        rewards += visit_bonus(shares)
    return TrainingMemory(of_model, visits), Rewards(rewards, learned, q_share)


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


def calibration(
    model: RewardModel,
    reward: RewardState,
    context: RewardContext,
    demos: Demonstrations,
    heldout: Demonstrations | None,
    transitions: Transitions,
) -> dict[str, jax.Array]:
    """The model's mean reward per step () for demonstrated steps, for held-out ones, and for the policy's (T, E).

    A reward that generalises is nearly as high for the held-out steps as for those that it learned from; one that has
    learned the demonstrations by heart is not. Each row counts as an episode of one step. Both kinds of rows are
    normalised as the policy's are, because the question is what a policy would earn by such steps. Of many steps, about
    ``MEASURED`` in equal distances are taken. Without held-out rows their measurement is left out.
    """
    rows = {"expert_reward": demos} | ({} if heldout is None else {"heldout_reward": heldout})
    steps = {name: as_steps(_every(len(these.obs) // MEASURED, these)) for name, these in rows.items()}
    length, robots = transitions.reward.shape
    steps["policy_reward"] = _every(min(length * robots // MEASURED, length), transitions)

    def mean_reward(some: Transitions) -> jax.Array:
        return jnp.mean(model.reward(reward, model.begin(reward, some.obs.shape[1]), context, some)[1])

    return {name: mean_reward(some) for name, some in steps.items()}


def _every(stride: int, rows: Rows) -> Rows:
    """Every ``stride``-th row of a tree of arrays; all rows for a stride of 0."""
    return jax.tree.map(lambda x: x[:: max(stride, 1)], rows)


def as_steps(demos: Demonstrations) -> Transitions:
    """Expert rows (N) as steps (1, N) of as many robots, each the only step of its episode. Their true reward is 0."""
    obs, action, next_obs, proxy = (x[None] for x in demos)
    zero, never = jnp.zeros(obs.shape[:2]), jnp.zeros(obs.shape[:2], bool)
    return Transitions(obs, action, next_obs, proxy, zero, never, ~never, proxy)
