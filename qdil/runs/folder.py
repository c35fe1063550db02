"""The folder of a run: its path, whether the run is finished, and functions that read it. Does not import JAX.

| file | content |
| --- | --- |
| ``config.json`` | every setting |
| ``metrics.csv`` | a row per QD iteration |
| ``history.npz`` | every elite that ever took a cell, with its iteration |
| ``archive.npz`` | the filled cells at the end |
| ``policies.npz`` | their policies (not in git) |
| ``summary.json`` | the metrics, as claimed and corrected |
| ``manifest.json`` | commit, packages, times and the hashes of the other files; written last |

Demonstrations lie beside the runs of their robot, not in the folder of their expert: a run's folder is complete once
its manifest is written, and whoever trains an expert anew keeps the demonstrations that its imitators learned from.
"""

from pathlib import Path
from typing import Any

import numpy as np

from qdil.config import Config, with_current_names
from qdil.errors import ConfigError
from qdil.files import read_json, read_npz

RESULTS = Path("results")


def folder_of(experiment: str, env: str, budget: str, seed: int, root: Path = RESULTS) -> Path:
    """``results/<budget>/<env>/<experiment>/seed-<n>``; see ``studies`` for the names of experiments."""
    return root / budget / env / experiment / f"seed-{seed}"


def demos_name(episodes: int, expert_seed: int) -> str:
    """The name of the file of ``episodes`` demonstrations of the expert with this seed."""
    return f"demos-{episodes}-seed-{expert_seed}.npz"


def demos_of(config: Config, root: Path = RESULTS) -> Path:
    """The file that a run learns from, if no other is given: demonstrations of the expert of the run's own seed.

    With the setting ``expert_seed``, all seeds learn from one expert, as in the paper.
    """
    return root / config.budget / config.env / demos_name(config.demos.demo_episodes, expert_seed_of(config))


def expert_seed_of(config: Config) -> int:
    """The seed of the expert that a run learns from."""
    return config.demos.expert_seed or config.seed


def is_finished(folder: Path) -> bool:
    """Whether ``folder`` holds a finished run: one with a manifest, which is written last."""
    return (folder / "manifest.json").is_file()


def read_config(folder: Path) -> dict[str, Any]:
    """The settings of the finished run in ``folder``, by flat name. Raises ConfigError if there is no such run."""
    if not is_finished(folder):
        raise ConfigError(f"there is no finished run in {folder}.")
    return with_current_names(read_json(folder / "config.json"))


def read_archive(folder: Path, policies: bool = False) -> dict[str, np.ndarray]:
    """The arrays of a finished run's archive, with ``policies`` also those of its policies.

    Raises ConfigError if the run is not finished or a file is missing.
    """
    read_config(folder)
    names = ["archive.npz", "policies.npz"] if policies else ["archive.npz"]
    content: dict[str, np.ndarray] = {}
    for name in names:
        if not (folder / name).is_file():
            raise ConfigError(f"{folder} has no {name}: remove the folder and train it on this machine to get it.")
        content |= read_npz(folder / name)
    return content
