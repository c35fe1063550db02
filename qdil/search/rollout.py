"""Driving robots: fresh starts, and a training window in which whoever's episode ends starts again."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.types import Choice, Transitions

# Standard normal noise (E, A) and observations (E, O) -> raw actions (E, A) and their log probabilities (E,).
Act = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


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


def noise_of(key: jax.Array, length: int, size: int) -> jax.Array:
    """Standard normal numbers (length, E, size) for as many steps, each robot's of its own key (E,)."""
    return jax.vmap(lambda k: jax.random.normal(k, (length, size)), out_axes=1)(key)


def where_each(mask: jax.Array, yes, no):
    """Choice by ``mask`` (E,), one per robot (or copy), between two trees whose leaves have axis (E) in front."""
    return jax.tree.map(lambda a, b: jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b), yes, no)


def last(tree):
    """Leaves (E, …) as (…, E), as the physics of many robots lays them in memory (``qdil.robots.robots_last``)."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def first(tree):
    """Undo ``last``."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


def step_each(env: Environment, robot: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
    """``env.step`` of robots laid out as by ``last``. Moved to the front and back, they are not moved at all by XLA."""
    after, outcome = jax.vmap(env.step)(first(robot), action)
    return last(after), outcome


def window(
    env: Environment, act: Act, actors: Actors, length: int, episode_length: int
) -> tuple[Actors, Transitions, Choice]:
    """Drive every robot for ``length`` steps, starting a new random episode wherever one ends.

    One start state is drawn per robot and window, since a reset costs as much as a step: a robot whose episodes end
    twice within a window starts from there twice. (Brax's own wrapper starts all episodes of a robot at its first.)

    A fall is ``terminated``, the step of a robot's time limit ``truncated``; new episodes may last ``episode_length``
    steps. ``next_obs`` is the episode's own last observation, not the reset one. Returns the robots as they are then
    and (length, E) transitions.
    """
    key, noise_key, fresh_key = jax.vmap(lambda k: jax.random.split(k, 3), out_axes=1)(actors.key)
    noise = noise_of(noise_key, length, env.action_size)
    fresh = last(jax.vmap(env.reset)(fresh_key))

    def step(carry, noise):
        robot, steps, limit, proxy_sum = carry
        obs, proxy = first((robot.obs, robot.proxy))
        raw_action, log_prob = act(noise, obs)
        after, outcome = step_each(env, robot, raw_action)
        steps, proxy_sum = steps + 1, proxy_sum + proxy
        truncated = (steps >= limit) & ~outcome.terminated
        ended = outcome.terminated | truncated
        transition = Transitions(
            obs,
            jnp.clip(raw_action, -1.0, 1.0),
            first(after.obs),
            proxy,
            outcome.reward,
            outcome.terminated,
            truncated,
            proxy_sum / steps[:, None],
        )
        carry = (
            jax.tree.map(partial(jnp.where, ended), fresh, after),
            jnp.where(ended, 0, steps),
            jnp.where(ended, episode_length, limit),
            jnp.where(ended[:, None], 0.0, proxy_sum),
        )
        return carry, (transition, Choice(raw_action, log_prob))

    begun = (last(actors.robot), actors.steps, actors.limit, actors.proxy_sum)
    (robot, steps, limit, proxy_sum), (transitions, choices) = jax.lax.scan(step, begun, noise)
    return Actors(first(robot), steps, limit, proxy_sum, key), transitions, choices
