"""The folder of a run: its path, whether the run is finished, and functions that read it. Does not import JAX.

| file | content |
| --- | --- |
| ``config.json`` | every setting |
| ``metrics.csv`` | a row per QD iteration |
| ``history.npz`` | every elite that ever took a cell, with its iteration |
| ``archive.npz`` | the filled cells at the end |
| ``policies.npz`` | their policies (not in git) |
| ``manifest.json`` | commit, packages, times and the hashes of the other files; written last |
"""

from pathlib import Path
from typing import Any

import numpy as np

from qdil.config import with_current_names
from qdil.errors import ConfigError
from qdil.files import read_json, read_npz

RESULTS = Path("results")


def folder_of(experiment: str, env: str, budget: str, seed: int, root: Path = RESULTS) -> Path:
    """``results/<budget>/<env>/<experiment>/seed-<n>``; see ``studies`` for the names of experiments."""
    return root / budget / env / experiment / f"seed-{seed}"


def demos_path(budget: str, env: str, episodes: int, root: Path = RESULTS) -> Path:
    """The file that ``qdil demos`` writes and that training reads, if no other is given."""
    return root / budget / env / f"demos-{episodes}.npz"


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
