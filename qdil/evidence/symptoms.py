"""The numbers of one run that tell whether its imitation works, read from the files that exist. Imports no JAX.

Every reading takes a ``RunFiles`` and returns a number. It raises ``NotRecorded`` if the run's files do not hold what
it needs (an older version, an unfinished run), and ``DoesNotApply`` if the question makes no sense for the run. *Late*
iterations are the second half of those that were run.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from qdil.config import with_current_names
from qdil.errors import ConfigError
from qdil.files import read_json, read_npz
from qdil.methods import Method, parse_method
from qdil.qd.landing import corrected_metrics
from qdil.runs.folder import is_finished

IDLE = 1e-6  # an xNES mean whose coefficients are all smaller moves θ_μ nowhere; after a restart they are 0 ± rounding
FULL = 0.95  # coverage from which hardly a cell is empty
FLOOR = 5  # percentile of the elites' reward per step that even poor elites get
SETTLED = 2  # iterations after a restart from which the reward model has learned from the new elite twice
FEWEST = 3  # late iterations of each kind, below which means over them are not compared


class NotRecorded(Exception):
    """The run's files do not hold what a reading needs."""


class DoesNotApply(Exception):
    """The question makes no sense for the run; the text says why."""


class RunFiles(NamedTuple):
    """What the folder of a run holds; parts that do not exist yet are empty."""

    folder: Path
    settings: dict[str, Any]  # by flat name
    metrics: pd.DataFrame  # a row per QD iteration
    archive: dict[str, np.ndarray]
    finished: bool

    def setting(self, name: str) -> Any:
        """A setting's value. Raises NotRecorded if the run was trained before there was such a setting."""
        if name not in self.settings:
            raise NotRecorded
        return self.settings[name]

    @property
    def method(self) -> Method:
        """The parts of the method's name."""
        return parse_method(self.setting("method"))

    def late(self, *columns: str) -> pd.DataFrame:
        """Columns of the late iterations. Raises NotRecorded if one is missing or no iteration was run."""
        if not len(self.metrics) or not set(columns) <= set(self.metrics):
            raise NotRecorded
        return self.metrics[list(columns)].iloc[len(self.metrics) // 2 :]

    def elites(self, *fields: str) -> list[np.ndarray]:
        """Fields of the elites that are finite in all of them. Raises NotRecorded if one is missing."""
        if not set(fields) <= set(self.archive):
            raise NotRecorded
        values = [np.asarray(self.archive[name], float) for name in fields]
        sound = np.all([np.isfinite(value) for value in values], axis=0)
        if not sound.any():
            raise NotRecorded
        return [value[sound] for value in values]


def read(folder: Path) -> RunFiles:
    """The files of the run in ``folder``, finished or not. Raises ConfigError without one, or for a damaged file."""
    if not (folder / "config.json").is_file():
        raise ConfigError(f"there is no run in {folder}.")
    metrics, archive = folder / "metrics.csv", folder / "archive.npz"
    return RunFiles(
        folder,
        with_current_names(read_json(folder / "config.json")),
        pd.read_csv(metrics) if metrics.is_file() else pd.DataFrame(),
        read_npz(archive) if archive.is_file() else {},
        is_finished(folder),
    )


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's rank correlation of two (n,), ties by mean ranks; not-a-number if either is constant."""
    ranks = [pd.Series(values).rank().to_numpy() for values in (one, other)]
    if min(np.ptp(rank) for rank in ranks) == 0:
        return float("nan")
    return float(np.corrcoef(*ranks)[0, 1])


# The reward


def accuracy(of: str) -> Callable[[RunFiles], float]:
    """The share of late expert or policy rows (``of``) that the discriminator puts on their own side."""

    def reading(run: RunFiles) -> float:
        if len(run.metrics) and f"{of}_accuracy" not in run.metrics:
            raise DoesNotApply("it has no discriminator")
        if run.method.base.name == "diffail":  # some noise no model can find, in any row
            raise DoesNotApply("½ is no natural border for a diffusion loss")
        return float(run.late(f"{of}_accuracy").to_numpy().mean())

    return reading


def heldout_reward(run: RunFiles) -> float:
    """The reward for held-out demonstrations, on a scale from the policy's (0) to that for learned ones (1)."""
    if len(run.metrics) and "reward_rolled_back" not in run.metrics:
        raise DoesNotApply("its reward does not learn during the run")
    usual = {"expert_alignment": "aligned", "expert_obs": "normalised"}  # of runs that do not record them, too
    if any(run.settings.get(name, value) != value for name, value in usual.items()):
        raise DoesNotApply("it learns from altered expert rows, and held-out ones are unaltered")
    expert, heldout, policy = run.late("expert_reward", "heldout_reward", "policy_reward").mean()
    if expert <= policy:
        raise DoesNotApply("the policy's steps get as much reward as demonstrated ones")
    return float((heldout - policy) / (expert - policy))


def order(fitness: str, true_return: str) -> Callable[[RunFiles], float]:
    """The rank correlation of two fields over the elites, learned fitness and true return."""

    def reading(run: RunFiles) -> float:
        learned, true = run.elites(fitness, true_return)
        if np.array_equal(learned, true):
            raise DoesNotApply("its archive compares true returns")
        return _known(rank_correlation(learned, true), "all elites have the same fitness")

    return reading


def survival_share(run: RunFiles) -> float:
    """The share of the training reward that any elite gets for a step, whatever it does: (p + floor) / (p + mean).

    The reward per step of an elite is its fitness divided by its episode's length. ``floor`` is the ``FLOOR``-th
    percentile over elites, or 0 if that is negative: what an elite gets even if it imitates badly. Both are from fresh
    episodes, as far as the run recorded these, because stored fitness may be that of an earlier reward model.
    """
    method = run.method
    if method.base.name == "true" or run.setting("selection") == "true":
        raise DoesNotApply("its archive compares true returns")
    fields = (f"rescored_{name}" if f"rescored_{name}" in run.archive else name for name in ("fitness", "length"))
    fitness, length = run.elites(*fields)
    per_step = fitness / np.maximum(length, 1.0)
    p = run.setting("bonus_p") if method.bonus and not run.setting("bonus_in_fitness") else 0.0
    total = p + per_step.mean()
    if total <= 0:
        raise DoesNotApply("its reward is not positive on average")
    return float((p + max(np.percentile(per_step, FLOOR), 0.0)) / total)


def survival_order(run: RunFiles) -> float:
    """The rank correlation of fitness and episode length over the elites."""
    return _known(rank_correlation(*run.elites("fitness", "length")), "all episodes are equally long")


# The archive


def stale_ratio(run: RunFiles) -> float:
    """The elites' mean fitness as stored, over that of the same elites on fresh episodes under the final reward."""
    stored, fresh = (values.mean() for values in run.elites("fitness", "rescored_fitness"))
    return _ratio(run, stored, fresh)


def stale_order(run: RunFiles) -> float:
    """The rank correlation over elites of stored fitness and fitness on fresh episodes under the final reward."""
    stored, fresh = run.elites("fitness", "rescored_fitness")
    return _known(rank_correlation(stored, fresh), "all elites have the same fitness")


def landing(share: str) -> Callable[[RunFiles], float]:
    """The share of elites that land in their own cell ("relanded"), or in it or a neighbour ("relanded_near")."""

    def reading(run: RunFiles) -> float:
        if not {"index", "cells", "true_return", "rescored_return", "rescored_measures"} <= set(run.archive):
            raise NotRecorded
        return _known(corrected_metrics(run.archive)[share], "its archive is empty")

    return reading


def episode_share(run: RunFiles) -> float:
    """The elites' mean episode length, as a share of the time limit."""
    (length,) = run.elites("length")
    return float(length.mean() / run.setting("episode_length"))


# The search


def ages(run: RunFiles) -> np.ndarray:
    """The age of θ_μ in every iteration's walk: iterations since the last restart, or since the run began.

    Runs of older versions did not record it; all of these restarted at the end of an iteration.
    """
    if "age" in run.metrics:
        return run.metrics["age"].to_numpy()
    run.late("restarts")
    age, found = 0, []
    for restarted in _restarted(run.metrics):
        found.append(age)
        age = 0 if restarted else age + 1
    return np.array(found)


def restart_jump(run: RunFiles) -> float:
    """The learned reward of the first walk after a restart, over that of walks at age ``SETTLED`` or more (late ones).

    Older runs recorded the walk's reward with its bonus; p is taken off it, and q, which few steps get, is not.
    """
    age, late = ages(run), slice(len(run.metrics) // 2, None)
    column = "walk_learned" if "walk_learned" in run.metrics else "walk_reward"
    run.late(column)
    reward = run.metrics[column].to_numpy()
    if column == "walk_reward" and run.method.bonus:
        reward = reward - run.setting("bonus_p")
    seen_restart = np.cumsum((age == 0) & (np.arange(len(age)) > 0)) > 0
    first, later = ((reward[late])[(seen_restart & which)[late]] for which in (age == 0, age >= SETTLED))
    if min(len(first), len(later)) < FEWEST:
        raise DoesNotApply(f"fewer than {FEWEST} late iterations are that long before or after a restart")
    return _ratio(run, first.mean(), later.mean())


def restart_share(run: RunFiles) -> float:
    """The share of late iterations with a restart."""
    run.late("restarts")
    return float(_restarted(run.metrics)[len(run.metrics) // 2 :].mean())


def idle_share(run: RunFiles) -> float:
    """The share of late walks before which the mean of xNES is all 0, so that they follow fitness alone."""
    coefficients = [name for name in run.metrics if name[:1] == "c" and name[1:].isdigit()]
    if not coefficients:
        raise NotRecorded
    return float((run.late(*coefficients).abs().max(axis="columns") < IDLE).mean())


def q_share(phase: str) -> Callable[[RunFiles], float]:
    """The share of steps that get q of the bonus in the late "walk" or "gradient" phases."""

    def reading(run: RunFiles) -> float:
        if not run.method.bonus or run.setting("bonus_q") == 0:
            raise DoesNotApply("it has no q")
        if run.settings.get("bonus_scope") == "step":
            raise DoesNotApply("its bonus counts visits and reads no cell")
        share, coverage = run.late(f"{phase}_q_share", "coverage").mean()
        if coverage >= FULL:
            raise DoesNotApply("hardly a cell is empty")
        return float(share)

    return reading


def discarded_share(run: RunFiles) -> float:
    """The share of training phases and of the reward model's rounds that were discarded for numbers not finite."""
    run.late("rolled_back")
    rounds = 1 if "reward_rolled_back" in run.metrics else 0
    warm_ups = math.ceil(run.setting("warmup_updates") / run.setting("walk_updates"))
    total = len(run.metrics) * (2 + 2 * rounds) + warm_ups * (1 + rounds)
    discarded = run.metrics["rolled_back"].sum() + (run.metrics["reward_rolled_back"].sum() if rounds else 0.0)
    return float(min(discarded / total, 1.0))


def _restarted(metrics: pd.DataFrame) -> np.ndarray:
    """Which iterations had a restart, from the number of restarts so far."""
    return np.diff(metrics["restarts"].to_numpy(), prepend=0) > 0


def _ratio(run: RunFiles, above: float, below: float) -> float:
    """A ratio of two learned rewards. Raises DoesNotApply unless both are positive by the nature of the reward."""
    if run.method.base.signed or min(above, below) <= 0:
        raise DoesNotApply("a reward of either sign has no ratio")
    return float(above / below)


def _known(value: float, otherwise: str) -> float:
    """``value``, unless it is not-a-number. Raises DoesNotApply with the text ``otherwise`` then."""
    if math.isnan(value):
        raise DoesNotApply(otherwise)
    return value
