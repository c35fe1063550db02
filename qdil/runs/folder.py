"""A run as a folder: where it lies, whether it is finished, and what can be read of it. Does not import JAX.

``config.json`` holds every setting, ``metrics.csv`` a row per QD iteration, ``history.npz`` every elite that ever took
a cell, ``archive.npz`` the filled cells, ``policies.npz`` the policies (not in git), and ``manifest.json``, written
last, what made the run and the hashes of the others.
"""

from pathlib import Path
from typing import Any

import numpy as np

from qdil.config import with_current_names
from qdil.errors import ConfigError
from qdil.files import read_json, read_npz

RESULTS = Path("results")


def folder_of(experiment: str, env: str, budget: str, seed: int, root: Path = RESULTS) -> Path:
    """``results/<budget>/<env>/<experiment>/seed-<n>``; an experiment is a method with the settings that it changes."""
    return root / budget / env / experiment / f"seed-{seed}"


def demos_path(budget: str, env: str, episodes: int, root: Path = RESULTS) -> Path:
    """Where ``qdil demos`` puts demonstrations and where training looks for them."""
    return root / budget / env / f"demos-{episodes}.npz"


def is_finished(folder: Path) -> bool:
    """A folder is a whole run once its manifest is there, which is written last."""
    return (folder / "manifest.json").is_file()


def read_config(folder: Path) -> dict[str, Any]:
    """The settings of the finished run in ``folder``, by flat name. Raises ConfigError if there is none to read."""
    if not is_finished(folder):
        raise ConfigError(f"there is no finished run in {folder}.")
    return with_current_names(read_json(folder / "config.json"))


def read_archive(folder: Path, policies: bool = False) -> dict[str, np.ndarray]:
    """The archive of a finished run, with its policies if asked for. Raises ConfigError where they are missing."""
    read_config(folder)
    names = ["archive.npz", "policies.npz"] if policies else ["archive.npz"]
    content: dict[str, np.ndarray] = {}
    for name in names:
        if not (folder / name).is_file():
            raise ConfigError(f"{folder} has no {name}: remove the folder and train it on this machine to get it.")
        content |= read_npz(folder / name)
    return content
