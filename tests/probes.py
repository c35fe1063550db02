"""Robots so simple that every quantity can be worked out by hand, and small helpers around them."""

import jax
import jax.numpy as jnp
import numpy as np

from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.types import ObsStats, Transitions

SPEED_LIMIT = 1.0  # actions are clipped to ± this, as every robot does


def counter(bound: float, diverges_above: float = np.inf) -> Environment:
    """A point that its action pushes along a line, s' = s + a, and that falls once it has reached ``bound``.

    Starts evenly in [0, 1); reward s' + a/4; δ(s) = (s ≥ 1, s ≥ 2). It diverges where s' passes ``diverges_above``.
    """

    def at(position: jax.Array) -> RobotState:
        proxy = (position >= jnp.array([1.0, 2.0])).astype(jnp.float32)
        return RobotState(position, position[None], proxy)

    def reset(key: jax.Array) -> RobotState:
        return at(jax.random.uniform(key))

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        push = jnp.clip(action[0], -SPEED_LIMIT, SPEED_LIMIT)
        position = state.physics + push
        finite = position <= diverges_above
        return at(position), Outcome(position + push / 4, (position >= bound) | ~finite, finite)

    return Environment("counter", "probe", 1, 1, ("past one", "past two"), 0.1, reset, step)


def target(best: float = 0.5) -> Environment:
    """A bandit: reward −(a − ``best``)², whatever the state; δ(s) = (last a > ¾, last a < 0). It never falls."""

    def at(position: jax.Array) -> RobotState:
        return RobotState(position, position[None], jnp.stack([position > 0.75, position < 0]).astype(jnp.float32))

    def reset(key: jax.Array) -> RobotState:
        return at(jnp.zeros(()))

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        push = jnp.clip(action[0], -SPEED_LIMIT, SPEED_LIMIT)
        return at(push), Outcome(-jnp.square(push - best), jnp.zeros((), bool), jnp.ones((), bool))

    return Environment("target", "probe", 1, 1, ("right", "left"), 0.1, reset, step)


def true_rewards(carry, stats, transitions):
    """The environment's own reward, in the form that VPPO and evaluation ask for."""
    return carry, transitions.reward


def transitions(time: int, envs: int, obs_size: int = 1, action_size: int = 1, k: int = 2, **fields) -> Transitions:
    """Steps (time, envs) that are zero everywhere but in ``fields``."""
    rows = (time, envs)
    no = np.zeros(rows, bool)
    obs, proxy = np.zeros((*rows, obs_size), np.float32), np.zeros((*rows, k), np.float32)
    blank = Transitions(obs, np.zeros((*rows, action_size), np.float32), obs, proxy, obs[..., 0], no, no, proxy)
    return jax.tree.map(jnp.asarray, blank._replace(**fields))


def obs_stats(mean, std) -> ObsStats:
    """A normaliser with this mean and spread."""
    mean, std = jnp.asarray(mean, jnp.float32), jnp.asarray(std, jnp.float32)
    return ObsStats(mean, std, jnp.square(std), jnp.ones(()))
