"""The values that travel between rollout, reward models and learning."""

from typing import Any, NamedTuple

import jax


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


class Choice(NamedTuple):
    """What PPO must remember of how an action was drawn; axes (T, E) in front."""

    raw_action: jax.Array  # (T, E, A) the Gaussian sample before clipping
    log_prob: jax.Array  # (T, E) its log density when it was drawn


class ObsStats(NamedTuple):
    """Running mean and spread of observations (Welford's sums), for normalising."""

    mean: jax.Array  # (O,)
    std: jax.Array  # (O,)
    summed_variance: jax.Array  # (O,)
    seen: jax.Array  # () observations so far


class RewardContext(NamedTuple):
    """What a reward model may look at besides its own state."""

    obs_stats: ObsStats  # the running normaliser, for demonstrations and policy data alike; GIRIL, PWIL keep their own
    occupied: jax.Array  # (cells...) bool grid over the unit measure square: which archive cells are filled


Params = Any  # a pytree of arrays
