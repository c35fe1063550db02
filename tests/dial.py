"""A robot whose whole archive is known: dials that its actions turn, one for each measure, and one skill.

A dial's measure is where its action points: with a = 2m − 1 held for an episode, the measure is m. The skill is one
more action, best at ``SKILL``; every policy with the skill earns 1 per step, wherever its dials point. So every cell
can be filled, and the best return of every cell is the episode's length.
"""

import jax
import jax.numpy as jnp
import numpy as np

from qdil.config import make_config
from qdil.imitation.reward_model import Demonstrations
from qdil.robots.environment import Environment, Outcome, RobotState
from qdil.robots.register import register_robot

PERIOD, LENGTH = 10, 20  # steps of the clock's round, and of an episode
SKILL = 0.5


def dial(k: int = 2) -> Environment:
    """k dials. The state is a clock and the last action; δ_j = 1 while the clock is before dial j's pointer.

    The reward is 1 − (a_{k+1} − SKILL)². It never falls. Observations are the clock's cosine and sine.
    """

    def at(clock: jax.Array, action: jax.Array) -> RobotState:
        angle = 2 * jnp.pi * clock / PERIOD
        pointer = (action[:k] + 1) / 2
        proxy = ((clock + 0.5) / PERIOD < pointer).astype(jnp.float32)
        return RobotState((clock, action), jnp.stack([jnp.cos(angle), jnp.sin(angle)]), proxy)

    def reset(key: jax.Array) -> RobotState:
        del key
        return at(jnp.zeros(()), jnp.zeros(k + 1))

    def step(state: RobotState, action: jax.Array) -> tuple[RobotState, Outcome]:
        clock, action = state.physics[0], jnp.clip(action, -1.0, 1.0)
        reward = 1.0 - jnp.square(action[k] - SKILL)
        return at((clock + 1) % PERIOD, action), Outcome(reward, jnp.zeros((), bool), jnp.ones((), bool))

    names = tuple(f"dial {j + 1}" for j in range(k))
    return Environment(f"dial{k}", "probe", 2, k + 1, names, 0.1, reset, step)


for k in (1, 2, 3):
    register_robot(f"dial{k}", environment=dial(k))

# Small enough for seconds a run: networks of 8 units, 16 candidates of one episode, a grid of 5 cells a measure.
SIZE = {
    "episode_length": LENGTH,
    "iterations": 20,
    "warmup_updates": 0,
    "gradient_updates": 3,
    "walk_updates": 2,
    "candidates": 16,
    "episodes": 1,
    "cells": 5,
    "sigma0": 1.0,
    "archive_learning_rate": 1.0,
    "threshold_min": 0.0,
    "sample_actions": False,
    "eval_chunk_steps": LENGTH,
    "eval_chunks_per_sync": 1,
    "actor_hidden": (8,),
    "critic_hidden": (8,),
    "initial_std": 0.5,
    "num_envs": 24,
    "rollout_length": 20,
    "minibatches": 2,
    "epochs": 4,
    "learning_rate": 0.01,
    "target_kl": 0.05,
    "reward_hidden": (16,),
    "reward_steps": 30,
    "reward_batch": 64,
    "gradient_penalty": 1.0,
}


def config_of(method: str = "true", k: int = 2, seed: int = 1, **changes):
    """A run on ``k`` dials."""
    return make_config(f"dial{k}", method, "smoke", seed, **(SIZE | changes))


def demonstrations(k: int = 2, count: int = 4) -> Demonstrations:
    """Steps of ``count`` skilled policies whose dials point to different cells."""
    env, rng = dial(k), np.random.default_rng(0)
    rows = []
    for pointer in rng.uniform(-0.8, 0.8, (count, k)):
        action, state = jnp.asarray([*pointer, SKILL]), env.reset(jax.random.key(0))
        for _ in range(LENGTH):
            after, _ = env.step(state, action)
            rows.append((state.obs, action, after.obs, state.proxy))
            state = after
    return Demonstrations(*(jnp.asarray(np.stack(column), jnp.float32) for column in zip(*rows, strict=True)))
