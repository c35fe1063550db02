"""The results of Lemma 1's experiments as a file, ``results/<budget>/lemma.json``, which claims and notebook read.

``environments`` has ``mdp`` (episodes of equal length, as the lemma's proof assumes), ``mdp-falls`` (episodes that can
end early) and the robots that were tried; each with ``change``, the change of P(m ∈ A_e | π) per trial. A robot's
also name the ``seed`` of every trial and the ``updates`` of PPO between before and after.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdil.config import ConfigError
from qdil.files import write_json
from qdil.lab.lemma import robot, trials
from qdil.lab.lemma.ppo import Settings
from qdil.lab.lemma.robot import Trial
from qdil.runs import manifest
from qdil.runs.folder import RESULTS

PROBLEMS = {"smoke": 50, "laptop": 400, "full": 400}  # random MDPs, each with a policy and an archive of its own
SEED = 1  # that the random problems are drawn from
FALLS = 0.5  # largest probability of a fall in a step, where episodes can end early


def path_of(budget: str, root: Path = RESULTS) -> Path:
    """Where the file lies."""
    return root / budget / "lemma.json"


def read(budget: str, root: Path = RESULTS) -> dict[str, Any]:
    """``environments`` of the file, nothing where there is none. ConfigError for a file that is not one."""
    path = path_of(budget, root)
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text())["environments"])
    except (ValueError, KeyError, TypeError):
        raise ConfigError(f"{path} is no results file of Lemma 1: remove it to have it made anew.") from None


def write(
    env: str,
    budget: str,
    root: Path = RESULTS,
    say: Callable[[str], object] = print,
    settings: Settings | None = None,
    size: robot.Size | None = None,
) -> dict[str, Any]:
    """Do what is missing in the file for the small problems and for ``env``, add it there, and return ``environments``.

    ``settings`` and ``size`` None: the defaults. What is in the file already is kept as it is. Raises ConfigError for a
    budget or robot that does not exist.
    """
    settings = settings or Settings()
    there = read(budget, root)
    for name, falls in (("mdp", 0.0), ("mdp-falls", FALLS)):
        if name not in there:
            there[name] = of_mdp(budget, settings, falls)
            _save(there, budget, root)
    if env not in there:
        size = size or robot.SIZES[budget]
        there[env] = of_robot(robot.run(env, budget, say, size), size.updates)
        _save(there, budget, root)
    return there


def of_mdp(budget: str, settings: Settings, falls: float) -> dict[str, Any]:
    """One iteration of PPO on each of the budget's random problems."""
    done = trials.by_ppo(SEED, PROBLEMS[budget], settings, falls)
    changes = {"change": done.change, "objective_change": done.objective_change}
    return {"falls": falls, "settings": settings._asdict(), **{k: _numbers(v) for k, v in changes.items()}}


def of_robot(done: list[Trial], updates: int) -> dict[str, Any]:
    """Trials of a robot, a list per field, and ``change``; each after ``updates`` of PPO."""
    columns = {name: [getattr(trial, name) for trial in done] for name in Trial._fields}
    return {"updates": updates, "change": _numbers([trial.change for trial in done]), **columns}


def trials_of(environment: Mapping[str, Any]) -> list[Trial]:
    """Undo ``of_robot``."""
    return [Trial(*row) for row in zip(*(environment[name] for name in Trial._fields), strict=True)]


class Changes(NamedTuple):
    """By how much P(m ∈ A_e | π) changed, for claim C14."""

    done: str  # between before and after, in words
    trials: list[float]  # every one
    by_seed: list[float]  # means over the trials of a seed, or of a random problem, which has one


def changes(environment: Mapping[str, Any]) -> Changes:
    """A robot's trials with one seed start from the same policy, so only their mean is a sample of its own."""
    trials_ = [float(change) for change in environment["change"]]
    seeds = environment.get("seed", range(len(trials_)))
    by_seed: dict[int, list[float]] = {}
    for seed, change in zip(seeds, trials_, strict=True):
        by_seed.setdefault(int(seed), []).append(change)
    updates = environment.get("updates", "some" if "seed" in environment else 1)  # older files don't say
    done = "one PPO update" if updates == 1 else f"{updates} PPO updates"
    return Changes(done, trials_, [float(np.mean(several)) for several in by_seed.values()])


def _numbers(values: Any) -> list[float]:
    """Rounded to what single precision holds, so that the file stays readable."""
    return [float(f"{value:.6g}") for value in np.asarray(values, float)]


def _save(environments: Mapping[str, Any], budget: str, root: Path) -> None:
    write_json(path_of(budget, root), {"commit": manifest.commit(), "environments": dict(environments)})
