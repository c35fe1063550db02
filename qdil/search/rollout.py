"""Driving robots: fresh starts, and a training window in which whoever's episode ends starts again."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.robots.environment import Environment, RobotState
from qdil.types import Choice, Transitions

RESET_POOL = 4  # fresh start states prepared per robot and window; drawing one costs nothing inside the loop

Act = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]  # keys (E,), obs (E, O) -> raw action, log prob


class Actors(NamedTuple):
    """Robots in the middle of their episodes, axis (E) in front; each owns its random key."""

    robot: RobotState
    steps: jax.Array  # (E,) int32 steps since the episode began
    limit: jax.Array  # (E,) int32 steps at which the time limit ends the episode
    proxy_sum: jax.Array  # (E, k) sum of δ over those steps
    key: jax.Array  # (E,)


def start(env: Environment, key: jax.Array, episode_length: int, in_step: bool = True) -> Actors:
    """Begin one episode of ``episode_length`` steps per key (E,).

    With ``in_step`` False the first episodes have random limits instead, so that the robots of a training window are
    in all parts of their episodes from then on; otherwise robots that never fall would go through them together.
    """
    key, reset_key = split_each(key)
    robot = jax.vmap(env.reset)(reset_key)
    limit = jnp.full(key.shape, episode_length, jnp.int32)
    if not in_step:
        key, limit_key = split_each(key)
        limit = jax.vmap(lambda k: jax.random.randint(k, (), 1, episode_length + 1))(limit_key)
    return Actors(robot, jnp.zeros(key.shape, jnp.int32), limit, jnp.zeros_like(robot.proxy), key)


def split_each(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split every robot's key (E,) in two, so that its noise does not depend on which device it lives on."""
    pair = jax.vmap(jax.random.split)(key)
    return pair[:, 0], pair[:, 1]


def where_each(mask: jax.Array, yes, no):
    """Per-robot choice by ``mask`` (E,) between two trees whose leaves have axis (E) in front."""
    return jax.tree.map(lambda a, b: jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b), yes, no)


def window(
    env: Environment, act: Act, actors: Actors, length: int, episode_length: int
) -> tuple[Actors, Transitions, Choice]:
    """Drive every robot for ``length`` steps, starting a new random episode wherever one ends.

    A robot that falls more than ``RESET_POOL`` times within one window meets its own start states again.

    A fall is ``terminated``, the step of a robot's time limit ``truncated``; new episodes may last ``episode_length``
    steps. ``next_obs`` is the episode's own last observation, not the reset one. Returns the robots as they are then
    and (length, E) transitions.
    """
    key, pool_key = split_each(actors.key)
    pool_keys = jax.vmap(lambda k: jax.random.split(k, RESET_POOL))(pool_key)
    starts = jax.vmap(env.reset)(pool_keys.reshape(-1))  # one vmap: a second would take as long to trace as the first
    pool = jax.tree.map(lambda leaf: leaf.reshape(*pool_keys.shape, *leaf.shape[1:]), starts)
    actors = actors._replace(key=key)
    resets = jnp.zeros(actors.steps.shape, jnp.int32)

    def step(carry, _):
        (robot, steps, limit, proxy_sum, key), resets = carry
        key, act_key = split_each(key)
        raw_action, log_prob = act(act_key, robot.obs)
        after, outcome = jax.vmap(env.step)(robot, raw_action)
        steps, proxy_sum = steps + 1, proxy_sum + robot.proxy
        truncated = (steps >= limit) & ~outcome.terminated
        ended = outcome.terminated | truncated
        transition = Transitions(
            robot.obs,
            jnp.clip(raw_action, -1.0, 1.0),
            after.obs,
            robot.proxy,
            outcome.reward,
            outcome.terminated,
            truncated,
            proxy_sum / steps[:, None],
        )
        fresh = jax.tree.map(lambda leaf: jax.vmap(lambda slots, i: slots[i % RESET_POOL])(leaf, resets), pool)
        actors = Actors(
            where_each(ended, fresh, after),
            jnp.where(ended, 0, steps),
            jnp.where(ended, episode_length, limit),
            jnp.where(ended[:, None], 0.0, proxy_sum),
            key,
        )
        return (actors, resets + ended), (transition, Choice(raw_action, log_prob))

    (actors, _), (transitions, choices) = jax.lax.scan(step, (actors, resets), None, length)
    return actors, transitions, choices
