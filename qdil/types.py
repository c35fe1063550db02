"""The values that rollouts, reward models and learning pass to each other."""

from typing import Any, NamedTuple

import jax

Pytree = Any  # a tree of arrays whose structure is known to its owner alone
Params = Pytree  # weights of a network
RewardState = Pytree  # ψ: whatever a reward model has learned
RewardMemory = Pytree  # what a reward model remembers within episodes, axis (E) in front; () for most


class Transitions(NamedTuple):
    """Steps of many robots, axes (T, E) in front: time, environment."""

    obs: jax.Array  # (T, E, O) s_t
    action: jax.Array  # (T, E, A) a_t as the robot received it, in [-1, 1]
    next_obs: jax.Array  # (T, E, O) s_{t+1} of the same episode, never the reset one
    proxy: jax.Array  # (T, E, k) δ(s_t)
    reward: jax.Array  # (T, E) the environment's own reward
    terminated: jax.Array  # (T, E) bool, the episode ended by itself
    truncated: jax.Array  # (T, E) bool, the time limit ended it
    measures_so_far: jax.Array  # (T, E, k) mean of δ over the episode up to and including this step

    @property
    def ended(self) -> jax.Array:
        """(T, E) bool, True on an episode's last step."""
        return self.terminated | self.truncated


class Rewards(NamedTuple):
    """The rewards of a training rollout, axes (T, E), per step."""

    fitness: jax.Array  # (T, E) what VPPO maximises: the reward model's reward with the measure bonus (eq. 4)
    learned: jax.Array  # (T, E) the reward model's reward alone
    q_share: (
        jax.Array
    )  # (T, E) the factor of q: 1 where eq. 2 adds q, otherwise 0; 1 / (1 + ρ) in the single-step bonus


class ActionSample(NamedTuple):
    """How an action was drawn, for PPO; axes (T, E) in front."""

    raw_action: jax.Array  # (T, E, A) the Gaussian sample before clipping
    log_prob: jax.Array  # (T, E) its log density when it was drawn


class Normaliser(NamedTuple):
    """The mean and spread that normalise observations."""

    mean: jax.Array  # (O,)
    std: jax.Array  # (O,)


class ObsStats(NamedTuple):
    """Running mean and spread of observations (Welford's sums)."""

    mean: jax.Array  # (O,)
    std: jax.Array  # (O,)
    summed_variance: jax.Array  # (O,)
    seen: jax.Array  # () observations so far

    @property
    def normaliser(self) -> Normaliser:
        """The present mean and spread."""
        return Normaliser(self.mean, self.std)


class RewardContext(NamedTuple):
    """What a reward model may read besides its own state."""

    normaliser: Normaliser  # the policy's, for demonstrations and policy data alike; GIRIL and PWIL keep their own
    occupied: jax.Array  # (cells, …) bool grid over the unit measure cube, True for filled archive cells
