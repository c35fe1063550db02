"""Driving robots: fresh starts, and a training rollout in which a robot whose episode ends starts again."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.types import ActionSample, Transitions

Tree = TypeVar("Tree")
# Standard normal noise (E, A) and observations (E, O) -> raw actions (E, A) and their log probabilities (E,).
Act = Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


class EnvBatch(NamedTuple):
    """Robots in the middle of their episodes, axis (E) in front; each owns its random key."""

    robot: RobotState
    steps: jax.Array  # (E,) int32 steps since the episode began
    limit: jax.Array  # (E,) int32 steps at which the time limit ends the episode
    proxy_sum: jax.Array  # (E, k) sum of δ over those steps
    key: jax.Array  # (E,)


def start(env: Environment, key: jax.Array, episode_length: int, in_step: bool = True) -> EnvBatch:
    """Begin one episode of ``episode_length`` steps per key (E,).

    With ``in_step`` False the first episodes have random time limits instead. From then on the robots of a training
    rollout are in different parts of their episodes. Otherwise robots that never fall would all be at the same step.
    """
    key, reset_key = split_each(key)
    robot = jax.vmap(env.reset)(reset_key)
    limit = jnp.full(key.shape, episode_length, jnp.int32)
    if not in_step:
        key, limit_key = split_each(key)
        limit = jax.vmap(lambda k: jax.random.randint(k, (), 1, episode_length + 1))(limit_key)
    return EnvBatch(robot, jnp.zeros(key.shape, jnp.int32), limit, jnp.zeros_like(robot.proxy), key)


def split_each(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split every robot's key (E,) in two, so that its noise does not depend on its device."""
    pair = jax.vmap(jax.random.split)(key)
    return pair[:, 0], pair[:, 1]


def action_noise(key: jax.Array, length: int, size: int) -> jax.Array:
    """Standard normal numbers (length, E, size) for ``length`` steps, each robot's from its own key (E,)."""
    return jax.vmap(lambda k: jax.random.normal(k, (length, size)), out_axes=1)(key)


def where_each(mask: jax.Array, yes: Tree, no: Tree) -> Tree:
    """Choose by ``mask`` (E,), one per robot or copy, between two trees whose leaves have axis (E) in front."""
    return jax.tree.map(lambda a, b: jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b), yes, no)


def to_batch_last(tree: Tree) -> Tree:
    """Leaves (E, …) as (…, E), the layout in which the physics of many robots is fast (``qdil.robots.batched``)."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def to_batch_first(tree: Tree) -> Tree:
    """Undo ``to_batch_last``."""
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


def step_each(env: Environment, robot: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
    """Step robots stored batch-last with actions (E, A).

    The two transposes cancel with those inside ``env.step``, so XLA removes them. The outcome has axis (E).
    """
    after, outcome = jax.vmap(env.step)(to_batch_first(robot), action)
    return to_batch_last(after), outcome


def transition(
    robot: RobotState,
    action: jax.Array,
    after: RobotState,
    outcome: Outcome,
    truncated: jax.Array,
    mean_proxy: jax.Array,
) -> Transitions:
    """One step (E, …) of robots stored batch-last, before and ``after`` it; ``action`` (E, A) as the robot received it.

    ``mean_proxy`` (E, k) is the mean of δ over the episode so far.
    """
    obs, proxy = to_batch_first((robot.obs, robot.proxy))
    next_obs = to_batch_first(after.obs)
    return Transitions(obs, action, next_obs, proxy, outcome.reward, outcome.terminated, truncated, mean_proxy)


def rollout(
    env: Environment, act: Act, envs: EnvBatch, length: int, episode_length: int
) -> tuple[EnvBatch, Transitions, ActionSample]:
    """Drive every robot for ``length`` steps, starting a new random episode wherever one ends.

    One start state is drawn per robot and rollout, since a reset costs as much as a step. If two episodes of a robot
    end within a rollout, the next two start from the same state. (With Brax's own wrapper, all episodes of a robot do.)

    A fall is ``terminated``, the step of a robot's time limit ``truncated``; new episodes may last ``episode_length``
    steps. ``next_obs`` is the episode's own last observation, not the reset one. Returns the robots after the rollout
    and (length, E) transitions.
    """
    key, noise_key, fresh_key = jax.vmap(lambda k: jax.random.split(k, 3), out_axes=1)(envs.key)
    noise = action_noise(noise_key, length, env.action_size)
    fresh = to_batch_last(jax.vmap(env.reset)(fresh_key))

    def step(carry, noise):
        robot, steps, limit, proxy_sum = carry
        obs, proxy = to_batch_first((robot.obs, robot.proxy))
        raw_action, log_prob = act(noise, obs)
        after, outcome = step_each(env, robot, raw_action)
        steps, proxy_sum = steps + 1, proxy_sum + proxy
        truncated = (steps >= limit) & ~outcome.terminated
        ended = outcome.terminated | truncated
        action = jnp.clip(raw_action, -1.0, 1.0)
        record = transition(robot, action, after, outcome, truncated, proxy_sum / steps[:, None])
        carry = (
            jax.tree.map(partial(jnp.where, ended), fresh, after),
            jnp.where(ended, 0, steps),
            jnp.where(ended, episode_length, limit),
            jnp.where(ended[:, None], 0.0, proxy_sum),
        )
        return carry, (record, ActionSample(raw_action, log_prob))

    begun = (to_batch_last(envs.robot), envs.steps, envs.limit, envs.proxy_sum)
    (robot, steps, limit, proxy_sum), (transitions, sample) = jax.lax.scan(step, begun, noise)
    return EnvBatch(to_batch_first(robot), steps, limit, proxy_sum, key), transitions, sample
