"""Record demonstrations of a finished expert run."""

from pathlib import Path

import jax
import numpy as np

from qdil.config import from_json
from qdil.errors import ConfigError
from qdil.imitation import demos as demonstrations
from qdil.rl import networks
from qdil.robots import register
from qdil.runs.folder import demos_path, folder_of, read_archive, read_config


def make_demos(
    env: str, budget: str, episodes: int, seed: int, expert: Path | None = None, out: Path | None = None
) -> Path:
    """Choose ``episodes`` elites of a finished expert run, record an episode of each, and return the file's path.

    The elites are spread over the measures: farthest points among the best fifth of the cells by return (section 5.2).
    ``expert``: the run's folder (None: that of ``budget`` and ``seed``). ``out``: the file (None:
    ``folder.demos_path``). Raises ConfigError if the expert is not finished, is of another robot or has too few elites.
    """
    expert = expert or folder_of("true", env, budget, seed)
    elites = read_archive(expert, policies=True)
    config = from_json(read_config(expert))
    if config.env != env:
        raise ConfigError(f"{expert} is a run of {config.env}, not of {env}.")
    try:
        rows = demonstrations.select(elites["true_return"], elites["measures"], int(np.prod(elites["cells"])), episodes)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    robot = register.make(config.env, config.simulation.backend)
    template = networks.template_of(robot.obs_size, robot.action_size, config.ppo.actor_hidden)
    chosen = {name: elites[name][rows] for name in ("solution", "obs_mean", "obs_std")}
    recorded = demonstrations.record(
        robot,
        template,
        chosen,
        jax.random.key(seed),
        config.simulation.episode_length,
        config.evaluation.sample_actions,
    )
    recorded["elite_index"] = elites["index"][rows]
    recorded["elite_measures"] = elites["measures"][rows]
    recorded["elite_return"] = elites["true_return"][rows]
    path = out or demos_path(budget, env, episodes)
    demonstrations.save(path, recorded, robot)
    return path
