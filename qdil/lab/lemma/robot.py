"""Lemma 1 on a robot: P(m ∈ A_e | π) counted over episodes before and after some PPO updates on 1[m ∈ A_e] alone.

Three things differ from the lemma. The probability is estimated from samples. A robot that falls has a shorter episode
and so collects fewer bonuses. PPO sees rollouts that cut episodes, so a step of an unfinished episode is rewarded for
the measures so far.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import binomtest

from qdil import ppga
from qdil.config import Config, make_config
from qdil.imitation.bonus import is_empty
from qdil.lab.lemma.results import RobotTrial
from qdil.ppga import Search
from qdil.qd.cells import cell_index


class Effort(NamedTuple):
    """How much is computed for a robot."""

    seeds: int
    warmup: int  # PPO updates on the true reward that make the old policy
    known: tuple[float, ...]  # one archive each: the share of the old policy's episodes that fall into filled cells
    updates: int  # PPO updates on the bonus alone
    rounds: int  # times that each policy plays ``num_envs`` episodes


EFFORTS = {
    "smoke": Effort(seeds=2, warmup=2, known=(0.5, 0.9), updates=1, rounds=1),
    "laptop": Effort(seeds=4, warmup=60, known=(0.5, 0.9), updates=15, rounds=3),
    "desk": Effort(seeds=4, warmup=200, known=(0.5, 0.9), updates=15, rounds=3),
    "full": Effort(seeds=5, warmup=200, known=(0.5, 0.9), updates=15, rounds=1),
}


class Sample(NamedTuple):
    """Episodes of one policy."""

    measures: np.ndarray  # (N, k)
    length: np.ndarray  # (N,) steps


def interval(found: int, episodes: int) -> tuple[float, float]:
    """95 % Clopper-Pearson interval of a probability that ``found`` of ``episodes`` trials estimate."""
    low, high = binomtest(found, episodes).proportion_ci(0.95, method="exact")
    return float(low), float(high)


def run_trials(
    env: str, budget: str, report: Callable[[str], object] = print, effort: Effort | None = None
) -> list[RobotTrial]:
    """The trials of Lemma 1 for every seed and archive of ``effort`` (None: the budget's).

    ``report`` is called with a line of text per seed. Raises ConfigError for a budget or robot that does not exist.
    """
    effort = effort or EFFORTS[budget]
    trials: list[RobotTrial] = []
    for seed in range(1, effort.seeds + 1):
        updates = f"{effort.warmup} updates to make a policy, {effort.updates} on the bonus"
        report(f"{env}, seed {seed} of {effort.seeds}: {updates}")
        trials += _trials_of_seed(_config(env, "mbo-zero", budget, seed), effort)
    return trials


def _config(env: str, method: str, budget: str, seed: int) -> Config:
    """The budget's settings, but every robot is evaluated over one sampled episode, so that episodes can be counted."""
    num_envs = make_config(env, method, budget, seed).ppo.num_envs
    changes = {"sample_actions": True, "episodes": 1, "candidates": num_envs, "bonus_p": 0.0, "bonus_q": 1.0}
    return make_config(env, method, budget, seed, **changes)


def _trials_of_seed(config: Config, effort: Effort) -> list[RobotTrial]:
    old = _with_policy_of(_warmed_up(config, effort.warmup), ppga.begin(config, None))
    seen = play(old, effort.rounds, stream=0)
    before = play(old, effort.rounds, stream=1)  # other episodes than those that define the archive
    grids = {known: make_archive(seen, config.ppga.cells, known) for known in effort.known}
    return [_trial(old, before, occupied, known, effort) for known, occupied in grids.items()]


def _trial(old: Search, before: Sample, occupied: np.ndarray, known: float, effort: Effort) -> RobotTrial:
    new = improve(old, occupied, effort.updates)
    after = play(new, effort.rounds, stream=2)
    found_old, found_new = (_found(occupied, episodes) for episodes in (before, after))
    return RobotTrial(
        old.config.seed, known, len(found_old), int(found_old.sum()), int(found_new.sum()),
        float(np.mean(found_old * before.length)), float(np.mean(found_new * after.length)),
        float(before.length.mean()), float(after.length.mean()),
    )  # fmt: skip


def _found(occupied: np.ndarray, episodes: Sample) -> np.ndarray:
    """(N,) 1.0 for every episode with m ∈ A_e."""
    return np.asarray(is_empty(jnp.asarray(occupied), jnp.asarray(episodes.measures)))


def _warmed_up(config: Config, updates: int) -> Search:
    """A search after plain PPO on the true reward."""
    return ppga.warmed_up(ppga.begin(_config(config.env, "true", config.budget, config.seed), None), updates)


def _with_policy_of(teacher: Search, search: Search) -> Search:
    """``search`` with the policy, statistics and robots of ``teacher``, but with its own critic.

    The teacher's critic has learned the true reward, which is not the bonus.
    """
    own, taught = search.state, teacher.state
    train_state = own.train_state._replace(policy=taught.train_state.policy)
    return search._replace(state=own._replace(train_state=train_state, stats=taught.stats, envs=taught.envs))


def improve(search: Search, occupied: np.ndarray, updates: int) -> Search:
    """``updates`` VPPO updates of θ_μ on the fitness reward with its bonus (Algorithm 1's walk with c = (1, 0, …))."""
    fitness_alone = np.eye(search.engine.objectives)[0]
    trained = search.engine.train_policy(search.state, jnp.asarray(occupied), fitness_alone, updates)
    return search._replace(state=trained.state)


def play(search: Search, rounds: int, stream: int) -> Sample:
    """``rounds`` times ``candidates`` whole episodes of θ_μ with sampled actions; diverged episodes are left out.

    Equal ``stream`` numbers draw equal random numbers.
    """
    config, stats = search.config, search.state.stats
    theta = jnp.tile(search.engine.theta_mu(search.state), (config.ppga.candidates, 1))
    policies = search.engine.all_with_normaliser(theta, stats)
    key = jax.random.fold_in(jax.random.key(config.seed), stream)
    played = [ppga.evaluate(search, policies, jax.random.fold_in(key, i)) for i in range(rounds)]
    measures = np.concatenate([episodes.measures[episodes.finite] for episodes in played])
    return Sample(measures, np.concatenate([episodes.length[episodes.finite] for episodes in played]))


def make_archive(seen: Sample, cells: int, known: float) -> np.ndarray:
    """A grid (cells, …) bool whose most visited cells are filled, as many as hold a share ``known`` of the episodes.

    The policy of ``seen`` then finds an empty cell in about 1 - ``known`` of its episodes, like the policy of a search
    that has already filled the cells around it.
    """
    shape = (cells,) * seen.measures.shape[1]
    visits = np.zeros(shape, int)
    np.add.at(visits, tuple(cell_index(seen.measures, shape, np).T), 1)
    order = np.argsort(-visits.reshape(-1), kind="stable")
    held_before = np.cumsum(visits.reshape(-1)[order]) - visits.reshape(-1)[order]
    filled = np.zeros(visits.size, bool)
    filled[order[held_before < known * len(seen.measures)]] = True
    return (filled & (visits.reshape(-1) > 0)).reshape(shape)
