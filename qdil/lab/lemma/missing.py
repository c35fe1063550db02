"""Computes the experiments of Lemma 1 that the results file lacks and adds them (see ``qdil.lab.lemma.results``)."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qdil.files import write_json
from qdil.lab.lemma import results, robot, trials
from qdil.lab.lemma.ppo import TabularPPO
from qdil.lab.lemma.results import RobotTrial
from qdil.runs import manifest
from qdil.runs.folder import RESULTS

PROBLEMS = {"smoke": 50, "laptop": 400, "desk": 400, "full": 400}  # random MDPs, each with its own policy and archive
SEED = 1  # of the random problems
FALLS = 0.5  # largest probability of a fall in a step, where episodes can end early


def compute_missing(
    env: str,
    budget: str,
    root: Path = RESULTS,
    report: Callable[[str], object] = print,
    settings: TabularPPO | None = None,
    effort: robot.Effort | None = None,
) -> dict[str, Any]:
    """Add the missing results of the small problems and of the robot ``env``; return the file's ``environments``.

    ``settings`` and ``effort`` None: the defaults. Existing results stay as they are. ``report`` is called with a line
    of text per seed. Raises ConfigError for a budget or robot that does not exist.
    """
    settings = settings or TabularPPO()
    environments = results.read(budget, root)
    for name, falls in (("mdp", 0.0), ("mdp-falls", FALLS)):
        if name not in environments:
            environments[name] = of_mdp(budget, settings, falls)
            _save(environments, budget, root)
    if env not in environments:
        effort = effort or robot.EFFORTS[budget]
        environments[env] = of_robot(robot.run_trials(env, budget, report, effort), effort.updates)
        _save(environments, budget, root)
    return environments


def of_mdp(budget: str, settings: TabularPPO, falls: float) -> dict[str, Any]:
    """One iteration of PPO on each of the budget's random problems."""
    improved = trials.by_ppo(SEED, PROBLEMS[budget], settings, falls)
    changes = {"change": improved.change, "objective_change": improved.objective_change}
    return {"falls": falls, "settings": settings._asdict(), **{k: _numbers(v) for k, v in changes.items()}}


def of_robot(several: Sequence[RobotTrial], updates: int) -> dict[str, Any]:
    """Trials of a robot, a list per field, and ``change``; each after ``updates`` of PPO."""
    columns = {name: [getattr(trial, name) for trial in several] for name in RobotTrial._fields}
    return {"updates": updates, "change": _numbers([trial.change for trial in several]), **columns}


def _numbers(values: Any) -> list[float]:
    """Values rounded to the digits of single precision, which keeps the file readable."""
    return [float(f"{value:.6g}") for value in np.asarray(values, float)]


def _save(environments: Mapping[str, Any], budget: str, root: Path) -> None:
    write_json(results.path_of(budget, root), {"commit": manifest.commit(), "environments": dict(environments)})
