"""Small finished runs for the explorer's tests: policies that were never trained, measures spread over the grid."""

import json
from pathlib import Path

import jax
import numpy as np

from qdil.config import make_config, to_json
from qdil.rl import networks
from qdil.robots import register

CELLS = 5


def policies(
    count: int, env: str = "walker2d", hidden: tuple[int, ...] = (8, 8), seed: int = 0
) -> dict[str, np.ndarray]:
    robot = register.make(env)
    keys = jax.random.split(jax.random.key(seed), count)
    made = [networks.flatten(networks.init_policy(key, robot.obs_size, robot.action_size, hidden, 1.0)) for key in keys]
    theta = np.array(made) * np.linspace(1, 40, count)[:, None]  # the mean action's last layer is small at first
    shape = (count, robot.obs_size)
    return {
        "solution": theta.astype(np.float32),
        "obs_mean": np.zeros(shape, np.float32),
        "obs_std": np.ones(shape, np.float32),
    }


def archive(cells: list[int], seed: int = 0, side: int = CELLS, k: int = 2) -> dict[str, np.ndarray]:
    """Elites in the middle of ``cells`` (numbers, ascending) of a grid of ``side``^k; returns grow with the number."""
    index = np.array(cells, np.int32)
    draw = np.random.default_rng(seed)
    measures = (np.stack(np.unravel_index(index, [side] * k), axis=1) + 0.5) / side
    return {
        "index": index,
        "measures": measures.astype(np.float32),
        "fitness": draw.uniform(0, 100, len(index)).astype(np.float32),
        "true_return": (100 + 10.25 * index).astype(np.float32),
        "length": np.full(len(index), 40, np.float32),
        "cells": np.array([side] * k),
    }


def write(
    folder: Path,
    cells: list[int],
    method: str = "true",
    with_policies: bool = True,
    seed: int = 0,
    side: int = CELLS,
    env: str = "walker2d",
    k: int = 2,
    landing: list[int] | None = None,
) -> Path:
    """A finished run in ``folder`` as ``qdil train`` would have left it.

    ``landing``: the cells where its elites land on fresh episodes, each with a return lower by 10 for every elite
    before it; None: they were not scored again.
    """
    folder.mkdir(parents=True)
    settings = to_json(make_config(env, method, "smoke", 1))
    settings |= {"actor_hidden": [8, 8], "episode_length": 60}
    (folder / "config.json").write_text(json.dumps(settings))
    (folder / "manifest.json").write_text("{}")
    kept = archive(cells, seed, side, k)
    if landing is not None:
        measures = (np.stack(np.unravel_index(landing, [side] * k), axis=1) + 0.5) / side
        returns = 300.0 - 10 * np.arange(len(landing))
        kept |= {"rescored_measures": measures.astype(np.float32), "rescored_return": returns.astype(np.float32)}
    np.savez(folder / "archive.npz", **kept)
    if with_policies:
        np.savez(folder / "policies.npz", index=kept["index"], **policies(len(cells), env, seed=seed))
    return folder


def growing(count: int) -> dict[str, list[float]]:
    """Made-up returns of elites that took their cells one after the other."""
    return {"true_return": [10.5 * i for i in range(count)], "fitness": [2.0 * i for i in range(count)]}


def write_history(folder: Path, iteration: list[int], index: list[int], last: int) -> None:
    """``history.npz`` of a run of ``last`` iterations, with ``growing`` returns."""
    made = {name: np.array(values) for name, values in growing(len(index)).items()}
    np.savez(folder / "history.npz", iteration=iteration, index=index, **made, iterations=last)
