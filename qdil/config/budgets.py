"""The budgets ``smoke``, ``laptop``, ``desk`` and ``full``, their changes for robots, and ``make_config``."""

from typing import Any

from qdil.config.checks import from_settings
from qdil.config.protocols import PROTOCOLS
from qdil.config.settings import PPGA, PPO, Config, Simulation
from qdil.errors import ConfigError
from qdil.methods import parse_method
from qdil.robots.register import backends_of, count_measures

# What the budgets for two cores share: few robots, and a search that they can drive.
TWO_CORES: dict[str, Any] = {
    "sigma0": 2.0,
    "archive_learning_rate": 1.0,
    "sample_actions": False,
    "eval_chunk_steps": 25,
    "eval_chunks_per_sync": 4,
    "eval_batch_size": 48,
    "num_envs": 192,
    "gamma": 0.993,
    "target_kl": 0.02,
    "threshold_min": 0.0,
}

LAPTOP: dict[str, Any] = {
    **TWO_CORES,
    "iterations": 240,
    "warmup_updates": 300,
    "gradient_updates": 3,
    "walk_updates": 3,
    "candidates": 96,
    "episodes": 4,
    "cells": 20,
    "actor_hidden": (64, 64),
    "critic_hidden": (64, 64),
    "rollout_length": 64,
    "episode_length": 300,
    "reward_steps": 20,
}

SMOKE: dict[str, Any] = {
    **LAPTOP,
    "iterations": 2,
    "warmup_updates": 2,
    "gradient_updates": 1,
    "walk_updates": 1,
    "candidates": 8,
    "episodes": 2,
    "cells": 5,
    "actor_hidden": (16, 16),
    "critic_hidden": (16, 16),
    "num_envs": 24,
    "rollout_length": 16,
    "episode_length": 50,
    "gamma": 0.99,
    "minibatches": 2,
    "epochs": 2,
    "demo_episodes": 1,
    "reward_steps": 4,
    "giril_steps": 200,
}

# The paper's units (episodes of 1000 steps, 50 x 50 cells, its networks) with few robots and short searches.
DESK: dict[str, Any] = {
    **TWO_CORES,
    "iterations": 200,
    "warmup_updates": 200,
    "gradient_updates": 5,
    "walk_updates": 5,
    "candidates": 192,
    "episodes": 4,
    "reward_steps": 30,
}

# The settings in which each budget differs from the defaults.
BUDGETS: dict[str, dict[str, Any]] = {"smoke": SMOKE, "laptop": LAPTOP, "desk": DESK, "full": {}}

# Further changes for some robots, by budget and robot.
PER_ROBOT: dict[tuple[str, str], dict[str, Any]] = {
    # A step of the cheetah is 0.05 s (walker2d: 0.008 s): it needs fewer steps and a nearer horizon. It cannot fall.
    # Its measures differ much from episode to episode, so its candidates play more episodes for fewer cells.
    ("laptop", "halfcheetah"): {
        "gamma": 0.99,
        "episode_length": 200,
        "eval_chunk_steps": 200,
        "num_envs": 96,
        "iterations": 140,
        "warmup_updates": 400,
        "candidates": 64,
        "episodes": 6,
        "cells": 15,
        "threshold_min": -100.0,
    },  # fmt: skip
    # With a nearer horizon, or less warm-up, the humanoid dives or stands.
    ("laptop", "humanoid"): {"gamma": 0.995, "warmup_updates": 800, "iterations": 130, "episodes": 3},
    ("desk", "halfcheetah"): {
        "gamma": 0.99,
        "num_envs": 96,
        "eval_chunk_steps": 200,
        "warmup_updates": 100,
        "threshold_min": -500.0,
    },  # fmt: skip
    ("desk", "humanoid"): {"learning_rate": 3e-4},
    ("full", "humanoid"): {"sigma0": 0.5, "archive_learning_rate": 0.1, "learning_rate": 3e-4},
}

# Threshold of an empty cell, return per step, for rewards that may be negative: so low that any first elite enters.
SIGNED_THRESHOLD = -10.0


def make_config(env: str, method: str, budget: str, seed: int = 1, **changes: Any) -> Config:
    """The checked configuration of one run: a budget, adapted to the robot, with ``changes`` by flat name on top.

    ``env`` names a robot (``qdil.robots.register``), ``method`` a method (``qdil.methods``), ``budget`` one of
    ``BUDGETS``. Raises ConfigError, in one sentence that names the setting, for anything that cannot run.
    """
    if budget not in BUDGETS:
        raise ConfigError(f"unknown budget '{budget}'; choose one of {', '.join(BUDGETS)}.")
    base = parse_method(method).base
    chosen = BUDGETS[budget] | _for_measures(budget, count_measures(env)) | PER_ROBOT.get((budget, env), {})
    chosen |= {"backend": backends_of(env)[0]}
    if env == "halfcheetah" and base.imitates and budget == "full":
        chosen |= {"threshold_min": -500.0}  # authors, with imitation rewards
    if base.signed:
        length = changes.get("episode_length", chosen.get("episode_length", Simulation.episode_length))
        if isinstance(length, int):  # any other length is refused below
            chosen |= {"threshold_min": SIGNED_THRESHOLD * length}
    chosen |= PROTOCOLS.get(changes.get("protocol", "paper"), {})  # an unknown protocol is refused below
    identity = {"env": env, "method": method, "budget": budget, "seed": seed}
    return from_settings(identity | chosen | changes)


def _for_measures(budget: str, k: int) -> dict[str, Any]:
    """A budget's counts for a robot of ``k`` measures; unchanged for the paper's robots, which have two.

    ``num_envs`` becomes the smallest multiple of 4 (1 + k) that is not below the budget's, so that the 1 + k copies of
    VPPO can be shared by four devices. ``cells`` per measure shrinks if k > 2, so that the grid's cells^k cells stay
    near the budget's number. It grows if k = 1, to the power of 3/2: a fifth of the cells must hold the demonstrators,
    and a share of an episode's steps cannot fill as many cells as a square has.
    """
    chosen = BUDGETS[budget]
    envs, cells = chosen.get("num_envs", PPO.num_envs), chosen.get("cells", PPGA.cells)
    per_copy = 4 * -(-envs // (4 * (1 + k)))
    power = {1: 3 / 2, 2: 1}.get(k, 2 / k)
    return {"num_envs": per_copy * (1 + k), "cells": max(2, round(cells**power))}
