"""Record demonstrations of a finished expert run."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from qdil.config import Config, Demos, from_json
from qdil.errors import ConfigError
from qdil.files import sha256
from qdil.imitation import demos as demonstrations
from qdil.imitation.recording import record
from qdil.imitation.selection import fresh, select
from qdil.rl import networks
from qdil.robots import register
from qdil.runs.folder import RESULTS, demos_name, folder_of, read_archive, read_config


def make_demos(
    env: str,
    budget: str,
    episodes: int,
    seed: int,
    expert: Path | None = None,
    out: Path | None = None,
    attempts: int = Demos.demo_attempts,
) -> Path:
    """Choose ``episodes`` elites of a finished expert run, record an episode of each, and return the file's path.

    The elites are spread over the measures: farthest points among the best fifth of the cells, both by fresh episodes
    (section 5.2). Each is simulated ``attempts`` times, and ``recording`` keeps the best of these episodes.
    ``expert``: the run's folder (None: that of ``budget`` and ``seed``). ``out``: the file (None: ``demos_name`` beside
    the runs of the robot, with the expert's own seed). Raises ConfigError if the expert is not finished, is of another
    robot, has no fresh episodes or has too few elites.
    """
    expert = expert or folder_of("true", env, budget, seed)
    archive = read_archive(expert, policies=True)
    config = from_json(read_config(expert))
    if config.env != env:
        raise ConfigError(f"{expert} is a run of {config.env}, not of {env}.")
    try:
        elites = fresh(archive)
        rows = select(elites["true_return"], elites["measures"], int(np.prod(elites["cells"])), episodes)
    except ValueError as error:
        raise ConfigError(f"{expert}: {error}") from None
    recorded = _record(config, elites, rows, attempts) | _origin(config, expert)
    path = out or RESULTS / budget / env / demos_name(episodes, config.seed)
    demonstrations.save(path, recorded, register.make(config.env, config.simulation.backend))
    return path


def _record(config: Config, elites: dict[str, Any], rows: np.ndarray, attempts: int) -> dict[str, np.ndarray]:
    """Episodes of the elites ``rows``, with the fresh values by which these were chosen."""
    robot = register.make(config.env, config.simulation.backend)
    recorded = record(
        robot,
        networks.template_of(robot.obs_size, robot.action_size, config.ppo.actor_hidden),
        {name: elites[name][rows] for name in ("solution", "obs_mean", "obs_std", "measures")},
        jax.random.key(config.seed),
        config.simulation.episode_length,
        config.evaluation.sample_actions,
        attempts,
    )
    return recorded | {
        "elite_index": elites["index"][rows],
        "elite_measures": elites["measures"][rows],
        "elite_return": elites["true_return"][rows],
        "demo_attempts": np.array(attempts),
    }


def _origin(config: Config, expert: Path) -> dict[str, np.ndarray]:
    """The expert's name, seed and archive. Its folder is not named: copies of a run give the same demonstrations."""
    name = folder_of(config.method, config.env, config.budget, config.seed, Path()).as_posix()
    return {
        "expert": np.array(name),
        "expert_seed": np.array(config.seed),
        "expert_archive_sha256": np.array(sha256(expert / "archive.npz")),
    }
