"""The results of Lemma 1's experiments as a file, ``results/<budget>/lemma.json``. Does not import JAX.

The file's ``environments`` are ``mdp`` (episodes of equal length, as the lemma's proof assumes), ``mdp-falls``
(episodes that can end early) and the robots that were tried. Each has ``change``, the change of P(m ∈ A_e | π) per
trial. A robot also has the ``seed`` of every trial and ``updates``, the number of PPO updates in a trial.
``qdil.lab.lemma.missing`` computes what the file lacks; notebook 4 and claim C14 read it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdil.errors import ConfigError
from qdil.files import read_json
from qdil.runs.folder import RESULTS

FILE = "lemma.json"
ROUNDING = 1e-9  # a change of the probability or of the objective smaller than this counts as none


class RobotTrial(NamedTuple):
    """One policy of a robot and one archive, before and after PPO on the bonus alone."""

    seed: int
    known: float  # share of the old policy's episodes that fall into filled cells of the archive
    episodes: int  # played by each of the two policies
    found_old: int  # episodes of the old policy with m ∈ A_e
    found_new: int
    return_old: float  # mean sum of bonuses per episode: what PPO maximises, but for the discount
    return_new: float
    length_old: float  # mean steps per episode
    length_new: float

    @property
    def change(self) -> float:
        """The change of the estimated P(m ∈ A_e | π)."""
        return (self.found_new - self.found_old) / self.episodes


def path_of(budget: str, root: Path = RESULTS) -> Path:
    """Where the file of a budget lies."""
    return root / budget / FILE


def read(budget: str, root: Path = RESULTS) -> dict[str, Any]:
    """``environments`` of the file, empty if there is none. Raises ConfigError for a file of another form."""
    path = path_of(budget, root)
    if not path.is_file():
        return {}
    try:
        return dict(read_json(path)["environments"])
    except (ConfigError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{path} is no results file of Lemma 1: remove it to have it made anew.") from None


def trials_of(environment: Mapping[str, Any]) -> list[RobotTrial]:
    """The trials of a robot, of which the file has a list per field."""
    return [RobotTrial(*row) for row in zip(*(environment[name] for name in RobotTrial._fields), strict=True)]


class Changes(NamedTuple):
    """By how much P(m ∈ A_e | π) changed in the trials of one environment, for claim C14."""

    improvement: str  # what changed the policy, such as "15 PPO updates"
    trials: list[float]  # a change per trial
    by_seed: list[float]  # the mean over the trials of a seed; each random problem counts as its own seed


def changes(environment: Mapping[str, Any]) -> Changes:
    """The changes of one of the file's ``environments``.

    A robot's trials with one seed start from the same policy, so only their mean is an independent sample.
    """
    per_trial = [float(change) for change in environment["change"]]
    seeds = environment.get("seed", range(len(per_trial)))
    by_seed: dict[int, list[float]] = {}
    for seed, change in zip(seeds, per_trial, strict=True):
        by_seed.setdefault(int(seed), []).append(change)
    updates = environment.get("updates", "some" if "seed" in environment else 1)  # files of older versions lack it
    improvement = "one PPO update" if updates == 1 else f"{updates} PPO updates"
    return Changes(improvement, per_trial, [float(np.mean(several)) for several in by_seed.values()])
